# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What Newton's importer of MJCF files leaves out without a word: a sentence for each kind."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.etree import ElementTree

import newton
import numpy as np
import warp as wp

from newton_avbd.model.welds import inverse, multiply

UNREAD = ("adhesion", "cylinder", "orientation", "pid", "plugin")
"""Kinds of MuJoCo's actuators that it leaves out."""
_MOST_NAMES = 3
"""Names in a sentence."""
_APART = 1.0e-4
"""From which distance [m], and half of the angle [rad], on two sites do not meet: files round to a
few digits."""
_OF_FREE = ("damping", "armature", "frictionloss", "stiffness")
"""What a free joint may have in MuJoCo."""

_OWNERS = ("joint", "tendon", "site", "body", "site1", "body1")
"""Attributes that say whose an element without a name is."""

_Attributes = dict[str, str]


@dataclass
class _Body:
    """A body of a file, with attributes of what it has, those of default classes among them."""

    name: str
    is_mocap: bool
    joints: list[_Attributes] = field(default_factory=list)
    geoms: list[_Attributes] = field(default_factory=list)

    def label(self, joint: _Attributes) -> str:
        """What to call one of its joints."""
        return _label(joint, f"body {self.name}")


def refuse(root: ElementTree.Element) -> None:
    """Refuses joints that the importer fails at, by name.

    Raises:
        ValueError: If a joint's damping or stiffness is a polynomial, or a ball joint comes after
            another joint of its body.
    """
    for body in _bodies(root):
        for number, joint in enumerate(body.joints):
            label = f"joint '{joint['name']}'" if "name" in joint else f"a joint of {body.name}"
            for name in ("damping", "stiffness"):
                if len(joint.get(name, "").split()) > 1:
                    raise ValueError(
                        f'{label} has {name}="{joint[name]}", a polynomial, and Newton\'s '
                        "importer reads one number. Write the first one alone."
                    )
            if number and joint.get("type") == "ball":
                raise ValueError(
                    f"{label} is a ball after another joint of its body, and Newton's "
                    "importer takes a ball alone. Give it a body of its own."
                )


def unread(name: str, root: ElementTree.Element, builder: newton.ModelBuilder) -> Iterator[str]:
    """What the importer has left out of a file, a sentence for each kind.

    Args:
        name: What to call the file.
        root: Its root element, with what it includes.
        builder: Has read it.
    """
    bodies = list(_bodies(root))
    for kind in (*_of_actuators(root), *_of_joints(bodies), *_of_bodies(root, bodies, builder)):
        if kind.names:
            yield f"{name} goes on without {kind}"
    yield from _other_gravity(name, root, builder)


@dataclass(frozen=True)
class _Kind:
    """One kind of what is left out."""

    what: str
    """What is left out of each; empty where that is all of it."""
    noun: str
    names: list[str]
    instead: str
    """What acts instead."""
    remedy: str

    def __str__(self) -> str:
        """The sentence, as it goes on after "goes on without"."""
        count, noun = len(self.names), self.noun
        nouns = noun if count == 1 else noun[:-1] + "ies" if noun.endswith("y") else noun + "s"
        names = ", ".join(self.names[:_MOST_NAMES]) + ", ..." * (count > _MOST_NAMES)
        what = f"the {self.what} of {count}" if self.what else str(count)
        return (
            f"{what} {nouns} ({names}), which Newton's importer does not read: {self.instead}. "
            f"{self.remedy}."
        )


def _of_actuators(root: ElementTree.Element) -> Iterator[_Kind]:
    """What is left out of actuators."""
    found = [f"{label} (<{tag}>)" for tag in UNREAD for label, _ in _said(root, "actuator", tag)]
    yield _Kind("", "actuator", found, "nothing acts", "Write a <general> one of the same law")
    found = [
        label
        for label, said in _said(root, "actuator", "position")
        if _numbers(said, "timeconst").any()
    ]
    remedy = (
        'Write <general dyntype="filterexact" dynprm="timeconst" gainprm="kp" biastype="affine" '
        'biasprm="0 -kp -kv"/>'
    )
    yield _Kind("timeconst", "position actuator", found, "ctrl acts at once", remedy)


def _of_joints(bodies: list[_Body]) -> Iterator[_Kind]:
    """What is left out of joints."""
    balls: list[str] = []
    free: list[str] = []
    moved: list[str] = []
    turned: list[str] = []
    beside: list[str] = []
    sided: list[str] = []
    of_free: dict[str, None] = {}
    for body in bodies:
        kinds = [joint.get("type", "hinge") for joint in body.joints]
        if len(kinds) > 1 and kinds[0] == "ball":
            beside.append(f"'{body.name}'")
        if "hinge" in kinds and "slide" in kinds[kinds.index("hinge") :]:
            turned.append(f"'{body.name}'")
        for joint, kind in zip(body.joints, kinds, strict=True):
            label = body.label(joint)
            if kind == "ball" and _is_limited(joint, "range"):
                balls.append(label)
            if kind == "free" and (has := [key for key in _OF_FREE if _numbers(joint, key).any()]):
                free.append(label)
                of_free |= dict.fromkeys(has)
            first = body.joints[0]
            if kind == "hinge" and np.any(_numbers(joint, "pos") != _numbers(first, "pos")):
                moved.append(label)
            is_sided = kind in ("hinge", "slide") and _numbers(joint, "actuatorfrcrange").sum()
            if is_sided and _is_limited(joint, "actuatorfrcrange", "actuatorfrclimited"):
                sided.append(label)
    own = "Give each joint a body of its own, of little mass"
    yield _Kind("range", "ball joint", balls, "no limit acts", "Hinges have ranges")
    remedy = "Three slides and three hinges have it"
    yield _Kind(" and ".join(of_free), "free joint", free, "none acts", remedy)
    instead = "hinges turn about the pos of the first joint of a body"
    yield _Kind("pos", "joint", moved, instead, own)
    yield _Kind("order of the joints", "body", turned, "slides come before hinges", own)
    instead = "the ball joint is the only one"
    yield _Kind("joints after the ball joint", "body", beside, instead, own)
    instead, remedy = "the larger end bounds both ways", "Bound the actuators by forcerange"
    yield _Kind("smaller end of the actuatorfrcrange", "joint", sided, instead, remedy)


def _of_bodies(
    root: ElementTree.Element, bodies: list[_Body], builder: newton.ModelBuilder
) -> Iterator[_Kind]:
    """What is left out of geoms, bodies and what ties them."""
    found = [
        _label(geom, f"body {body.name}")
        for body in bodies
        for geom in body.geoms
        if geom.get("fluidshape") == "ellipsoid" and _has_fluid(root)
    ]
    instead = "the drag is that of boxes which have the inertia of the bodies"
    yield _Kind("fluidshape", "geom", found, instead, "SolverAVBD has no other drag")
    found = [f"'{body.name}'" for body in bodies if body.is_mocap]
    remedy = (
        "A program sets builder.body_flags[body] to int(newton.BodyFlags.KINEMATIC) before "
        "finalize(), and writes body_q in each step"
    )
    yield _Kind("mocap", "body", found, "such a body stays where it is", remedy)
    found = _open_ties(root, builder)
    instead = "site1 is held to where it is on the second body in the file"
    remedy = "Let the two sites meet there"
    yield _Kind("frame of site2", "equality constraint", found, instead, remedy)


def _bodies(root: ElementTree.Element) -> Iterator[_Body]:
    """The bodies of a file."""
    classes = _classes(root)

    def walk(parent: ElementTree.Element, body: _Body | None, ambient: str) -> Iterator[_Body]:
        for item in parent:
            inner = item.get("childclass", ambient)
            if item.tag == "body":
                is_mocap = item.get("mocap", "false") == "true"
                yield from walk(item, child := _Body(item.get("name", ""), is_mocap), inner)
                yield child
            elif item.tag == "frame":
                yield from walk(item, body, inner)
            elif body is not None and item.tag in ("joint", "geom"):
                own = classes.get(item.get("class", ambient), {}).get(item.tag, {})
                (body.joints if item.tag == "joint" else body.geoms).append(own | item.attrib)

    for world in root.iter("worldbody"):
        yield from walk(world, None, _MAIN)


_MAIN = ""
"""The default class of what names none."""


def _classes(root: ElementTree.Element) -> dict[str, dict[str, _Attributes]]:
    """Attributes by default class and tag, with those that a class inherits."""
    found: dict[str, dict[str, _Attributes]] = {}

    def walk(default: ElementTree.Element, inherited: dict[str, _Attributes], name: str) -> None:
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


def _said(root: ElementTree.Element, group: str, tag: str) -> Iterator[tuple[str, _Attributes]]:
    """Names and attributes of elements that are in no body."""
    classes = _classes(root)
    for parent in root.iter(group):
        for item in parent.findall(tag):
            own = classes.get(item.get("class", _MAIN), {}).get(tag, {})
            said = own | item.attrib
            owner = next((said[key] for key in _OWNERS if key in said), "the file")
            yield _label(said, owner), said


def _label(said: _Attributes, owner: str) -> str:
    """What to call an element: by its name, or by whose it is."""
    return f"'{said['name']}'" if said.get("name") else f"that of {owner}"


def _numbers(said: _Attributes, name: str) -> np.ndarray:
    """Numbers of an attribute, zeros where it is not there."""
    return np.array(said.get(name, "0 0 0").split(), dtype=float)


def _is_limited(said: _Attributes, name: str, limited: str = "limited") -> bool:
    """Whether a range holds."""
    return said.get(limited, "auto") != "false" and bool(_numbers(said, name).any())


def _has_fluid(root: ElementTree.Element) -> bool:
    """Whether there is a fluid around the bodies."""
    options = [item.attrib for item in root.iter("option")]
    return any(_numbers(said, name).any() for said in options for name in ("density", "viscosity"))


def _open_ties(root: ElementTree.Element, builder: newton.ModelBuilder) -> list[str]:
    """Names of connects and welds whose two sites do not meet where the builder has the bodies."""
    sites = {
        label.rpartition("/")[2]: place
        for place, label in enumerate(builder.shape_label)
        if builder.shape_flags[place] & newton.ShapeFlags.SITE
    }

    def where(site: str) -> np.ndarray:
        body = builder.shape_body[sites[site]]
        pose = builder.body_q[body] if body >= 0 else wp.transform_identity()
        return multiply(np.array([pose]), np.array([builder.shape_transform[sites[site]]]))

    found = []
    for tag, numbers in (("connect", 3), ("weld", 6)):
        for label, said in _said(root, "equality", tag):
            ends = [said.get(f"site{end}", "") for end in (1, 2)]
            if all(end in sites for end in ends):
                apart = multiply(inverse(where(ends[0])), where(ends[1]))[0, :numbers]
                if np.abs(apart).max() > _APART:
                    found.append(label)
    return found


def _other_gravity(
    name: str, root: ElementTree.Element, builder: newton.ModelBuilder
) -> Iterator[str]:
    """Says where a file has another gravity than the builder, to which it makes no difference."""
    said = [item.get("gravity") for item in root.iter("option") if item.get("gravity")]
    is_off = any(flag.get("gravity") == "disable" for flag in root.iter("flag"))
    if not said or is_off:
        return
    own, has = _numbers({"gravity": said[-1] or ""}, "gravity"), np.array(builder.gravity) + 0.0
    if np.abs(own - has).max() > 1.0e-3:
        values = ", ".join(f"{value:g}" for value in own)
        yield (
            f"{name} goes on without its gravity ({values}), which Newton's importer does not "
            f"read: that of the builder acts, ({', '.join(f'{value:.4g}' for value in has)}). A "
            f"program passes newton.ModelBuilder(gravity=({values}))."
        )
