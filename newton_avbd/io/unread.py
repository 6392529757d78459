# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What Newton's importer of MJCF files leaves out without a word: a sentence for each kind."""

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

import newton
import numpy as np
import warp as wp

from newton_avbd.model.welds import inverse, multiply

from .elements import Attributes, Body, bodies, has_fluid, in_tree, numbers, of_group
from .rewriting import has_springdamper, inheriting, is_moved, total_mass

UNREAD = ("adhesion", "cylinder", "orientation", "pid", "plugin")
"""Kinds of MuJoCo's actuators that it leaves out."""
_MOST_NAMES = 3
"""Names in a sentence."""
_APART = 1.0e-4
"""From which distance [m], and half of the angle [rad], on two sites do not meet: files round to a
few digits."""
_OF_FREE = ("damping", "armature", "frictionloss", "stiffness")
"""What a free joint may have in MuJoCo."""
_SAVE = 'Load the file that mujoco.mj_saveLastXML("FILE", model) writes'
_SOFT = "SolverVBD simulates what builder.add_cloth_grid() and add_soft_grid() make"
_OF_TREE = {"replicate": _SAVE, "attach": _SAVE, "composite": _SAVE, "flexcomp": _SOFT}
"""Elements in the tree of bodies that are left out with all that they stand for, and remedies."""


def refuse(root: ElementTree.Element) -> None:
    """Refuses joints and tendons that the importer fails at, by name.

    Raises:
        ValueError: If damping or stiffness is a polynomial, or a ball joint comes after another
            joint of its body.
    """
    for tag in ("spatial", "fixed"):
        for _, said in of_group(root, "tendon", tag):
            called = f"tendon '{said['name']}'" if said.get("name") else "a tendon without a name"
            _refuse_polynomials(called, said)
    for body in bodies(root):
        for number, joint in enumerate(body.joints):
            kind = joint.get("type", "hinge")
            if kind == "free":  # the importer reads no number of it, and no joint after it
                break
            label = f"joint '{joint['name']}'" if joint.get("name") else f"a joint of {body.called}"
            _refuse_polynomials(label, joint)
            if kind == "ball":
                if number:
                    raise ValueError(
                        f"{label} is a ball after another joint of its body, and Newton's "
                        "importer takes a ball alone. Give it a body of its own."
                    )
                break  # it reads none after it


def _refuse_polynomials(label: str, said: Attributes) -> None:
    """Refuses damping or stiffness that is more than a number."""
    for name in ("damping", "stiffness"):
        if len(said.get(name, "").split()) > 1:
            raise ValueError(
                f'{label} has {name}="{said[name]}", a polynomial, and Newton\'s importer '
                "reads one number. Write the first one alone."
            )


def unread(name: str, root: ElementTree.Element, builder: newton.ModelBuilder) -> Iterator[str]:
    """What the importer has left out of a file, a sentence for each kind.

    Args:
        name: What to call the file.
        root: Its root element, with what it includes.
        builder: Has read it.
    """
    found = bodies(root)
    of_bodies = _of_bodies(root, found, builder)
    for kind in (*_of_tree(root, found), *_of_actuators(root), *_of_joints(found), *of_bodies):
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
        what = f"the {self.what} of {count}" if self.what else str(count)
        return (
            f"{what} {nouns} ({listed(self.names)}), which Newton's importer does not read: "
            f"{self.instead}. {self.remedy}."
        )


def listed(names: list[str]) -> str:
    """The first of some names."""
    return ", ".join(names[:_MOST_NAMES]) + ", ..." * (len(names) > _MOST_NAMES)


def _of_tree(root: ElementTree.Element, bodies: list[Body]) -> Iterator[_Kind]:
    """What is left out with all that is in it."""
    for tag, remedy in _OF_TREE.items():
        names = [*in_tree(root, tag)]
        yield _Kind("", f"<{tag}> element", names, "nothing of it is there", remedy)
    names = [f"{body.label(joint)} (in a <frame>)" for body in bodies for joint in body.framed]
    instead = "a body without another joint is fixed"
    yield _Kind("", "joint", names, instead, "Write it in the body, outside of the <frame>")
    names = [label for label, _ in of_group(root, "deformable", "flex")]
    instead = "nothing holds the bodies at its vertices together"
    yield _Kind("", "flex", names, instead, _SOFT)
    names = [*in_tree(root, "plugin", parents="body")]
    remedy = "builder.add_rod() makes a cable that resists bending"
    yield _Kind("", "plugin", names, "a cable of such bodies does not resist bending", remedy)


def _of_actuators(root: ElementTree.Element) -> Iterator[_Kind]:
    """What is left out of actuators."""
    found = [f"{label} (<{tag}>)" for tag in UNREAD for label, _ in of_group(root, "actuator", tag)]
    yield _Kind("", "actuator", found, "nothing acts", "Write a <general> one of the same law")
    found = [
        label
        for label, said in of_group(root, "actuator", "position")
        if numbers(said, "timeconst").any()
    ]
    remedy = (
        'Write <general dyntype="filterexact" dynprm="timeconst" gainprm="kp" biastype="affine" '
        'biasprm="0 -kp -kv"/>'
    )
    yield _Kind("timeconst", "position actuator", found, "ctrl acts at once", remedy)
    found = [*inheriting(root)]
    remedy = "Write ctrlrange, and actrange of <intvelocity>"
    yield _Kind("inheritrange", "actuator", found, "ctrl has no range", remedy)


def _of_joints(bodies: list[Body]) -> Iterator[_Kind]:
    """What is left out of joints."""
    balls: list[str] = []
    free: list[str] = []
    moved: list[str] = []
    turned: list[str] = []
    beside: list[str] = []
    sided: list[str] = []
    sprung: list[str] = []
    of_free: dict[str, None] = {}
    for body in bodies:
        kinds = [joint.get("type", "hinge") for joint in body.joints]
        if len(kinds) > 1 and kinds[0] == "ball":
            beside.append(body.among)
        if "hinge" in kinds and "slide" in kinds[kinds.index("hinge") :]:
            turned.append(body.among)
        for joint, kind in zip(body.joints, kinds, strict=True):
            label = body.label(joint)
            if has_springdamper(joint):
                sprung.append(label)
            if kind == "ball" and _is_limited(joint, "range"):
                balls.append(label)
            if kind == "free" and (has := [key for key in _OF_FREE if numbers(joint, key).any()]):
                free.append(label)
                of_free |= dict.fromkeys(has)
            if kind == "hinge" and is_moved(joint, body.joints[0]):
                moved.append(label)
            is_sided = kind in ("hinge", "slide") and numbers(joint, "actuatorfrcrange").sum()
            if is_sided and _is_limited(joint, "actuatorfrcrange", "actuatorfrclimited"):
                sided.append(label)
    remedy = "Write stiffness and damping"
    yield _Kind("springdamper", "joint", sprung, "stiffness and damping act", remedy)
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
    root: ElementTree.Element, bodies: list[Body], builder: newton.ModelBuilder
) -> Iterator[_Kind]:
    """What is left out of geoms, bodies and what ties them."""
    found = [
        body.label(geom)
        for body in bodies
        for geom in body.geoms
        if geom.get("fluidshape") == "ellipsoid" and has_fluid(root)
    ]
    instead = "the drag is that of boxes which have the inertia of the bodies"
    yield _Kind("fluidshape", "geom", found, instead, "SolverAVBD has no other drag")
    found = [body.among for body in bodies if body.is_mocap]
    remedy = (
        "A program sets builder.body_flags[body] to int(newton.BodyFlags.KINEMATIC) before "
        "finalize(), and writes body_q and body_qd in each step"
    )
    yield _Kind("mocap", "body", found, "such a body stays where it is", remedy)
    mass = total_mass(root)
    found = [f"{mass:g} kg"] if mass else []
    instead = "bodies weigh what their geoms and <inertial> say"
    yield _Kind("settotalmass", "<compiler>", found, instead, f"{_SAVE}, or scale the masses")
    found = _open_ties(root, builder)
    instead = "site1 is held to where it is on the second body in the file"
    remedy = "Let the two sites meet there"
    yield _Kind("frame of site2", "equality constraint", found, instead, remedy)


def _is_limited(said: Attributes, name: str, limited: str = "limited") -> bool:
    """Whether a range holds."""
    return said.get(limited, "auto") != "false" and bool(numbers(said, name).any())


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
    for tag in ("connect", "weld"):
        for label, said in of_group(root, "equality", tag):
            ends = [said.get(f"site{end}", "") for end in (1, 2)]
            if said.get("active") != "false" and all(end in sites for end in ends):
                turns = tag == "weld" and float(said.get("torquescale", "1")) != 0.0
                apart = multiply(inverse(where(ends[0])), where(ends[1]))[0, : 6 if turns else 3]
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
    own, has = numbers({"gravity": said[-1] or ""}, "gravity"), np.array(builder.gravity) + 0.0
    if np.abs(own - has).max() > 1.0e-3:
        values = ", ".join(f"{value:g}" for value in own)
        yield (
            f"{name} goes on without its gravity ({values}), which Newton's importer does not "
            f"read: that of the builder acts, ({', '.join(f'{value:.4g}' for value in has)}). A "
            f"program passes newton.ModelBuilder(gravity=({values}))."
        )
