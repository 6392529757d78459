# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Reading the text of a URDF file: what is mended in it, and which of its mistakes are named.

Newton's importer takes well-formed files. Files that other programs read are not all so: without a
check they end in an error that does not say where, or are read as something else.
"""

import math
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

JOINTS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
"""Types of joints that URDF has, and that Newton's importer reads."""

NUMBERS = {
    ("origin", "xyz"): (3,),
    ("origin", "rpy"): (3,),
    ("axis", "xyz"): (3,),
    ("mesh", "scale"): (1, 3),
    ("box", "size"): (3,),
    ("sphere", "radius"): (1,),
    ("cylinder", "radius"): (1,),
    ("cylinder", "length"): (1,),
    ("capsule", "radius"): (1,),
    ("capsule", "length"): (1,),
    ("mass", "value"): (1,),
    ("limit", "effort"): (1,),
    ("limit", "velocity"): (1,),
    ("limit", "lower"): (1,),
    ("limit", "upper"): (1,),
    ("dynamics", "damping"): (1,),
    ("dynamics", "friction"): (1,),
    ("mimic", "multiplier"): (1,),
    ("mimic", "offset"): (1,),
    **{("inertia", f"i{pair}"): (1,) for pair in ("xx", "xy", "xz", "yy", "yz", "zz")},
}
"""How many numbers each attribute holds that Newton's importer reads."""

POINT = 1.0e-5
"""Radius of a sphere that stands for a point [m]."""

_UNBOUNDED = ("limit",)
"""Elements whose numbers may be infinite."""


def parse(path: Path) -> ElementTree.Element:
    """Read a URDF file, mend what can be, and check the rest.

    Args:
        path: The file.

    Returns:
        Its root element.

    Raises:
        xml.etree.ElementTree.ParseError: The file is no XML.
        ValueError: It is no URDF file that can be read; the message says where and why.
    """
    # Editors leave blank lines before the declaration, and zeros after the end.
    root = _read_tree(path.read_bytes().strip(b"\0\t\n\r "))
    _mend(root, path)
    _check_xacro(root, path)
    _drop_foreign(root)
    _check_numbers(root)
    _check_tree(root)
    _grow_points(root)
    return root


def massless_root(root: ElementTree.Element) -> str | None:
    """Name of the root link if it cannot float: if nothing of it has mass, and links hang on it.

    What FIXED joints weld to the root is of it. Many files call such a root ``world``; PyBullet
    takes a base of mass zero for fixed. A link by itself stays where its user puts it.
    """
    joints = [(joint.get("type") == "fixed", *_ends(joint)) for joint in root.findall("joint")]
    links = {str(link.get("name")): link for link in root.findall("link")}
    first = str(_root_link(root).get("name"))
    of_root = {first}
    for _ in joints:
        of_root |= {child for fixed, parent, child in joints if fixed and parent in of_root}
    return first if joints and not any(_has_mass(links[name]) for name in of_root) else None


def take_empty_root(root: ElementTree.Element) -> tuple[list[float], list[float]] | None:
    """Take away a root that holds nothing and on which one link floats: this link becomes the root.

    Files for MuJoCo, in which a root is the world, say so that a robot floats. A joint that floats
    on a link is none that MuJoCo has.

    Returns:
        Position [m] and roll, pitch and yaw [rad] of that link; None where nothing was taken away.
    """
    hanging: dict[str, list[ElementTree.Element]] = {}
    for joint in root.findall("joint"):
        hanging.setdefault(_ends(joint)[0], []).append(joint)
    first = _root_link(root)
    joints = hanging.get(str(first.get("name")), [])
    holds = any(first.find(what) is not None for what in ("inertial", "collision", "visual"))
    if holds or [joint.get("type") for joint in joints] != ["floating"]:
        return None
    root.remove(first)
    root.remove(joints[0])
    place = {} if (origin := joints[0].find("origin")) is None else origin.attrib
    xyz, rpy = ([float(n) for n in place.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
    return xyz, rpy


def free_crossed(root: ElementTree.Element) -> list[str]:
    """Take the limits from joints whose lower one is above the upper one; returns their names.

    PyBullet, whose files write lower="1" upper="-1", takes these for no limits.
    """
    freed = []
    for joint in root.findall("joint"):
        for limit in joint.findall("limit"):
            if float(limit.get("lower", -math.inf)) > float(limit.get("upper", math.inf)):
                del limit.attrib["lower"], limit.attrib["upper"]
                freed.append(str(joint.get("name")))
    return freed


def _read_tree(text: bytes) -> ElementTree.Element:
    """Read XML as if it had no namespaces, as other readers of URDF do.

    Files have ``xmlns="..."`` at ``<robot>``, or a prefix for which they declare no namespace.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ElementTree.ParseError(str(error)) from error
    return builder.close()


def _drop_foreign(root: ElementTree.Element) -> None:
    """Take away what other programs have added: elements and attributes with a prefix."""
    for element in root.iter():
        for child in list(element):
            if ":" in child.tag:
                element.remove(child)
        for name in list(element.attrib):
            if ":" in name or name == "xmlns":
                del element.attrib[name]


def _has_mass(link: ElementTree.Element) -> bool:
    """Whether a link has mass; shapes give mass to links without ``<inertial>``."""
    inertial = link.find("inertial")
    if inertial is None:
        return link.find("collision") is not None
    mass = inertial.find("mass")
    return mass is not None and float(mass.get("value", 0.0)) > 0.0


def _mend(root: ElementTree.Element, path: Path) -> None:
    """Write what Newton's importer asks for and files leave out or say to no effect.

    A robot gets a name, and a FIXED joint, which cannot move, mimics nothing. The importer reads
    the length of a capsule from ``height``, where URDF has ``length``.
    """
    if root.tag == "robot" and not root.get("name"):
        root.set("name", path.stem)
    if root.find("link") is None:
        raise ValueError("it holds no links")
    for joint in root.iter("joint"):
        if joint.get("type") == "fixed":
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
    for capsule in root.iter("capsule"):
        length = capsule.get("length")
        if length is not None:
            capsule.set("height", length)


def _grow_points(root: ElementTree.Element) -> None:
    """Give spheres and boxes of size zero :data:`POINT` for a radius, and no mass.

    By them files have points: the soles of Atlas and Valkyrie are eight each. SolverMuJoCo refuses
    a shape of size zero.
    """
    for link in root.findall("link"):
        points = 0
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            for tag, name, size in (("sphere", "radius", 1), ("box", "size", 3)):
                for element in shape.iter(tag):
                    words = element.get(name, "").split()
                    if words and not any(map(float, words)):
                        element.set(name, " ".join([str(POINT if size == 1 else 2 * POINT)] * size))
                        points += shape.tag == "collision"
        if points and points == len(link.findall("collision")) and link.find("inertial") is None:
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "mass", value="0")


def _check_xacro(root: ElementTree.Element, path: Path) -> None:
    for element in root.iter():
        for name, value in element.attrib.items():
            if name != "filename" and ("$(" in value or "${" in value):
                raise ValueError(
                    f"<{element.tag} {name}={value!r}> is to be expanded: "
                    f"xacro {path.name} > expanded.urdf"
                )


def _check_numbers(root: ElementTree.Element) -> None:
    """Raise a ``ValueError`` for the first attribute that does not hold its numbers."""
    for owner in (*root.findall("link"), *root.findall("joint")):
        for element in owner.iter():
            for name, value in element.attrib.items():
                counts = NUMBERS.get((element.tag, name))
                if counts is None:
                    continue
                wrong = _wrong(element.tag, value.split(), counts)
                if wrong:
                    raise ValueError(
                        f"<{element.tag} {name}={value!r}> of {owner.tag} "
                        f"{owner.get('name')!r} {wrong}"
                    )


def _wrong(tag: str, words: list[str], counts: tuple[int, ...]) -> str:
    """What is wrong with the numbers of an attribute; empty for nothing."""
    if len(words) not in counts and words:
        wanted = " or ".join(f"{count}" for count in counts)
        return f"has {len(words)} numbers: write {wanted}, apart by spaces"
    for word in words:
        try:
            number = float(word)
        except ValueError:
            return f"has {word!r}, which is no number"
        if math.isnan(number) or (math.isinf(number) and tag not in _UNBOUNDED):
            return "is not finite"
        if tag == "mass" and number < 0.0:
            return "is negative"
    return ""


def _check_tree(root: ElementTree.Element) -> None:
    """Raise a ``ValueError`` unless joints and links make one tree."""
    links = Counter(str(link.get("name")) for link in root.findall("link"))
    joints = root.findall("joint")
    parent_of: dict[str, str] = {}
    for joint in joints:
        called = f"joint {joint.get('name')!r}"
        if joint.get("type") not in JOINTS:
            raise ValueError(
                f"{called} is of type {joint.get('type')!r}: Newton's importer reads "
                f"{', '.join(JOINTS)}. A ball is three revolute joints with two links between them"
            )
        for side, name in zip(("parent", "child"), _ends(joint), strict=True):
            if not name:
                raise ValueError(f"{called} has no <{side} link=...>")
            if name not in links:
                raise ValueError(f"{called} names a {side} link {name!r} that is not in the file")
        parent, child = _ends(joint)
        if child in parent_of:
            raise ValueError(
                f"link {child!r} hangs on {parent_of[child]!r} and on {parent!r}: URDF has no loops"
            )
        parent_of[child] = parent
    twice = [name for name, count in links.items() if count > 1]
    if twice:
        raise ValueError(f"link {twice[0]!r} is there {links[twice[0]]} times")
    roots = [name for name in links if name not in parent_of]
    if not roots:
        raise ValueError("its joints go round in a circle: no link is the root")
    if len(roots) > 1:
        raise ValueError(
            f"{len(roots)} links hang on nothing, {', '.join(map(repr, roots[:4]))}: "
            "connect them by joints, or put them into files of their own"
        )


def _root_link(root: ElementTree.Element) -> ElementTree.Element:
    """The first link that hangs on no other."""
    children = {_ends(joint)[1] for joint in root.findall("joint")}
    return next(link for link in root.findall("link") if link.get("name") not in children)


def _ends(joint: ElementTree.Element) -> tuple[str, str]:
    """Names of the parent and of the child of a joint; empty where the joint has none."""
    parent, child = joint.find("parent"), joint.find("child")
    return (
        "" if parent is None else parent.get("link", ""),
        "" if child is None else child.get("link", ""),
    )
