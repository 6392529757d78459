# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Elements of MJCF files, with the attributes that default classes give them."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.etree import ElementTree

import numpy as np

Attributes = dict[str, str]

_OWNERS = ("joint", "tendon", "site", "body", "site1", "body1")
"""Attributes that say whose an element without a name is."""
MAIN = "main"
"""MuJoCo's name of the outermost default class, which is that of what names none."""
_OUTERMOST = ""
"""The same class where it stands for what an element is in: that may have named none."""
_SHARED = ("equality", "tendon")
"""Groups whose elements share one element in a default class, of the group's name."""


@dataclass
class Body:
    """A body of a file, with attributes of what it has, those of default classes among them.

    Attributes:
        element: What it is in the file.
        name: Its name; empty where it has none.
        parent: The body that it is in; None where that is the world.
        is_mocap: Whether the file says so.
        inertial: Its ``<inertial>``; None where it has none.
        joints: Its joints, but for those in a ``<frame>``.
        framed: Its joints in a ``<frame>``.
        geoms: Its geoms.
    """

    element: ElementTree.Element
    name: str
    parent: "Body | None"
    is_mocap: bool
    inertial: Attributes | None
    joints: list[Attributes] = field(default_factory=list)
    framed: list[Attributes] = field(default_factory=list)
    geoms: list[Attributes] = field(default_factory=list)

    def label(self, item: Attributes) -> str:
        """What to call one of its joints or geoms."""
        return label(item, self.called)

    @property
    def called(self) -> str:
        """What to call it."""
        return called(self.name)

    @property
    def among(self) -> str:
        """What to call it in a list of bodies."""
        return f"'{self.name}'" if self.name else "one without a name"

    @property
    def moves(self) -> bool:
        """Whether it or a body that it is in has a joint."""
        return bool(self.joints or self.framed) or (self.parent is not None and self.parent.moves)


def bodies(root: ElementTree.Element) -> list[Body]:
    """The bodies of a file, each after those in it."""
    classes = by_class(root)
    found: list[Body] = []

    def walk(
        parent: ElementTree.Element, body: Body | None, ambient: str, joints: list[Attributes]
    ) -> None:
        for item in parent:
            inner = item.get("childclass", ambient)
            if item.tag == "body":
                inertial = item.find("inertial")
                said = None if inertial is None else inertial.attrib
                is_mocap = item.get("mocap", "false") == "true"
                child = Body(item, item.get("name", ""), body, is_mocap, said)
                walk(item, child, inner, child.joints)
                found.append(child)
            elif item.tag == "frame":
                walk(item, body, inner, body.framed if body else joints)
            elif item.tag == "freejoint":
                joints.append(item.attrib | {"type": "free"})
            elif body is not None and item.tag in ("joint", "geom"):
                own = classes.get(item.get("class", ambient), {}).get(item.tag, {})
                (joints if item.tag == "joint" else body.geoms).append(own | item.attrib)

    for world in root.iter("worldbody"):
        walk(world, None, _OUTERMOST, [])
    return found


def world_geoms(root: ElementTree.Element) -> list[Attributes]:
    """The geoms of the world, with attributes of default classes."""
    classes = by_class(root)

    def walk(parent: ElementTree.Element, ambient: str) -> Iterator[Attributes]:
        for item in parent:
            if item.tag == "frame":
                yield from walk(item, item.get("childclass", ambient))
            elif item.tag == "geom":
                own = classes.get(item.get("class", ambient), {}).get("geom", {})
                yield own | item.attrib

    return [geom for world in root.iter("worldbody") for geom in walk(world, _OUTERMOST)]


def by_class(root: ElementTree.Element) -> dict[str, dict[str, Attributes]]:
    """Attributes by default class and tag, with those that a class inherits."""
    found: dict[str, dict[str, Attributes]] = {}

    def walk(default: ElementTree.Element, inherited: dict[str, Attributes], name: str) -> None:
        own = found.setdefault(name, {})
        for tag, attributes in inherited.items():
            own[tag] = attributes | own.get(tag, {})
        for item in default:
            if item.tag != "default":
                own[item.tag] = own.get(item.tag, {}) | item.attrib
        for item in default:
            if item.tag == "default":
                walk(item, own, item.get("class", ""))

    for default in root.findall("default"):
        walk(default, {}, _OUTERMOST)
    return found | {MAIN: found.get(_OUTERMOST, {})}


def in_tree(root: ElementTree.Element, tag: str, *, parents: str = "") -> Iterator[str]:
    """Labels of elements in the tree of bodies: by their names, or by the body that has them.

    With ``parents`` those only that are directly in elements of that tag.
    """

    def walk(parent: ElementTree.Element, owner: str) -> Iterator[str]:
        for item in parent:
            if item.tag == tag and parents in ("", parent.tag):
                names = (item.get(key) for key in ("name", "model", "prefix"))
                yield label({"name": next(filter(None, names), "")}, owner)
            yield from walk(item, called(item.get("name", "")) if item.tag == "body" else owner)

    for world in root.iter("worldbody"):
        yield from walk(world, "the world")


def of_group(root: ElementTree.Element, group: str, tag: str) -> Iterator[tuple[str, Attributes]]:
    """Labels and attributes of elements that are in no body."""
    classes = by_class(root)
    shared = group if group in _SHARED else tag
    for parent in root.iter(group):
        for item in parent.findall(tag):
            attributes = (
                classes.get(item.get("class", _OUTERMOST), {}).get(shared, {}) | item.attrib
            )
            owner = next((attributes[key] for key in _OWNERS if key in attributes), "the file")
            yield label(attributes, owner), attributes


def has_fluid(root: ElementTree.Element) -> bool:
    """Whether there is a fluid around the bodies."""
    options = [item.attrib for item in root.iter("option")]
    return any(numbers(said, name).any() for said in options for name in ("density", "viscosity"))


def called(name: str) -> str:
    """What to call a body of a name, which may be empty."""
    return f"body '{name}'" if name else "a body without a name"


def label(attributes: Attributes, owner: str) -> str:
    """What to call an element: by its name, or by whose it is."""
    return f"'{attributes['name']}'" if attributes.get("name") else f"that of {owner}"


def numbers(attributes: Attributes, name: str) -> np.ndarray:
    """Numbers of an attribute, zeros where it is not there."""
    return np.array(attributes.get(name, "0 0 0").split(), dtype=float)
