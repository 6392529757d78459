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
_MAIN = ""
"""The default class of what names none."""


@dataclass
class Body:
    """A body of a file, with attributes of what it has, those of default classes among them.

    Attributes:
        name: Its name; empty where it has none.
        parent: The body that it is in; None where that is the world.
        is_mocap: Whether the file says so.
        inertial: Its ``<inertial>``; None where it has none.
        joints: Its joints.
        geoms: Its geoms.
    """

    name: str
    parent: "Body | None"
    is_mocap: bool
    inertial: Attributes | None
    joints: list[Attributes] = field(default_factory=list)
    geoms: list[Attributes] = field(default_factory=list)

    def label(self, item: Attributes) -> str:
        """What to call one of its joints or geoms."""
        return label(item, self.called)

    @property
    def called(self) -> str:
        """What to call it."""
        return f"body {self.name!r}" if self.name else "a body without a name"

    @property
    def moves(self) -> bool:
        """Whether it or a body that it is in has a joint."""
        return bool(self.joints) or (self.parent is not None and self.parent.moves)


def bodies(root: ElementTree.Element) -> list[Body]:
    """The bodies of a file, each after those in it."""
    classes = _classes(root)
    found: list[Body] = []

    def walk(parent: ElementTree.Element, body: Body | None, ambient: str) -> None:
        for item in parent:
            inner = item.get("childclass", ambient)
            if item.tag == "body":
                inertial = item.find("inertial")
                said = None if inertial is None else inertial.attrib
                is_mocap = item.get("mocap", "false") == "true"
                walk(item, child := Body(item.get("name", ""), body, is_mocap, said), inner)
                found.append(child)
            elif item.tag == "frame":
                walk(item, body, inner)
            elif body is not None and item.tag == "freejoint":
                body.joints.append(item.attrib | {"type": "free"})
            elif body is not None and item.tag in ("joint", "geom"):
                own = classes.get(item.get("class", ambient), {}).get(item.tag, {})
                (body.joints if item.tag == "joint" else body.geoms).append(own | item.attrib)

    for world in root.iter("worldbody"):
        walk(world, None, _MAIN)
    return found


def _classes(root: ElementTree.Element) -> dict[str, dict[str, Attributes]]:
    """Attributes by default class and tag, with those that a class inherits."""
    found: dict[str, dict[str, Attributes]] = {}

    def walk(default: ElementTree.Element, inherited: dict[str, Attributes], name: str) -> None:
        own = found[name] = found.get(name, {}) | inherited
        for item in default:
            if item.tag != "default":
                own[item.tag] = own.get(item.tag, {}) | item.attrib
        for item in default:
            if item.tag == "default":
                walk(item, own, item.get("class", ""))

    for default in root.findall("default"):
        walk(default, {}, _MAIN)
        found.setdefault(default.get("class", "main"), found[_MAIN])
    return found


def of_group(root: ElementTree.Element, group: str, tag: str) -> Iterator[tuple[str, Attributes]]:
    """Labels and attributes of elements that are in no body."""
    classes = _classes(root)
    for parent in root.iter(group):
        for item in parent.findall(tag):
            attributes = classes.get(item.get("class", _MAIN), {}).get(tag, {}) | item.attrib
            owner = next((attributes[key] for key in _OWNERS if key in attributes), "the file")
            yield label(attributes, owner), attributes


def label(attributes: Attributes, owner: str) -> str:
    """What to call an element: by its name, or by whose it is."""
    return f"'{attributes['name']}'" if attributes.get("name") else f"that of {owner}"


def numbers(attributes: Attributes, name: str) -> np.ndarray:
    """Numbers of an attribute, zeros where it is not there."""
    return np.array(attributes.get(name, "0 0 0").split(), dtype=float)
