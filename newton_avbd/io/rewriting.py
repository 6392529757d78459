# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""MJCF elements that Newton's importer does not read, in terms of those that it reads."""

import importlib.util
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import numpy as np

from newton_avbd.measure.overlaps import LIGHT
from newton_avbd.model.welds import IDENTITY, multiply

from .elements import (
    MAIN,
    Attributes,
    Body,
    bodies,
    by_class,
    has_fluid,
    in_tree,
    numbers,
    of_group,
    world_geoms,
)

Element = ElementTree.Element

_COPIED = ("replicate", "attach", "composite")
"""Elements that stand for bodies elsewhere or for several."""
_ACTUATORS = ("adhesion", "cylinder")
"""Actuators that MuJoCo writes as ``<general>``, which the importer reads."""
_SHARING = (
    *("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle"),
    *("adhesion", "dcmotor"),
)
"""Kinds of actuators, which share their defaults in MuJoCo and not in the importer."""
_INHERITING = ("general", "position", "intvelocity")
"""Actuators that may take the range of what they push for their own."""
_SPANNED = ("box", "ellipsoid")
"""Geoms of which the importer does not read ``fromto``."""
_OF_PLACE = ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "childclass")
"""Attributes that say where a body is, and what is in it."""
_OF_ACTUATOR = (
    *("name", "group", "gear", "ctrlrange", "ctrllimited", "damping", "armature"),
    *("joint", "jointinparent", "tendon", "site", "refsite", "body"),
    *("cranksite", "slidersite", "cranklength"),
)
"""What an actuator of a disabled group still has: its control and its transmission, with what that
adds to the damping and the inertia of what it drives."""
_SILENT = {
    "dyntype": "none",
    "gaintype": "fixed",
    "gainprm": "0",
    "biastype": "none",
    "biasprm": "0",
    "forcelimited": "false",
}
"""A ``<general>`` actuator that exerts no force."""
_GROUPS = range(31)
"""Groups of actuators that MuJoCo can disable."""
_OF_TENDON = ("stiffness", "damping", "armature", "frictionloss", "range")
"""What a tendon pushes or holds with by itself."""
_MOVED = 1.0e-6
"""By how much the axis of a hinge is elsewhere [m]: files round."""
# MuJoCo takes no body without mass, and Newton adds 1e-6 kg m^2 to less than 1e-10
_LIGHT = {"pos": "0 0 0", "mass": f"{LIGHT:g}", "diaginertia": "2e-10 2e-10 2e-10"}


def hidden(root: Element) -> list[str]:
    """What of a file the importer does not read though MuJoCo can write it otherwise, by name."""
    found = [f"<{tag}>" for tag in _COPIED if any(in_tree(root, tag))]
    found += [f"<{tag}>" for tag in _ACTUATORS if any(of_group(root, "actuator", tag))]
    if any(numbers(said, "timeconst").any() for _, said in of_group(root, "actuator", "position")):
        found.append("timeconst of <position>")
    if any(inheriting(root)):
        found.append("inheritrange of actuators")
    if total_mass(root):
        found.append("settotalmass of <compiler>")
    geoms = world_geoms(root) + [geom for body in bodies(root) for geom in body.geoms]
    if any("fromto" in geom and geom.get("type") in _SPANNED for geom in geoms):
        found.append("fromto of a box or an ellipsoid")
    if any(body.framed for body in bodies(root)):
        found.append("joints in a <frame>")
    if _has_shared_defaults(root):
        found.append("a <default> of actuators of another kind")
    return [*found, *_late_defaults(root)]


def inheriting(root: Element) -> Iterator[str]:
    """Actuators with ``inheritrange``: the range of what they push is that of their control."""
    for tag in _INHERITING:
        for name, said in of_group(root, "actuator", tag):
            if numbers(said, "inheritrange").any():
                yield name


def total_mass(root: Element) -> float:
    """What the bodies of a file are to weigh together [kg]; 0 where the file does not say it."""
    said: Attributes = {}
    for item in root.iter("compiler"):
        said |= item.attrib
    return max(0.0, float(said.get("settotalmass", "0")))


def _has_shared_defaults(root: Element) -> bool:
    """Whether an actuator has a default of another kind, such as a motor one of ``<general>``."""
    classes = by_class(root)
    return any(
        kind in classes.get(item.get("class", MAIN), {})
        for item in root.iterfind("actuator/*")
        for kind in _SHARING
        if kind != item.tag
    )


def _late_defaults(root: Element) -> Iterator[str]:
    """The first default of all elements that comes after a class, which does without it."""
    said: dict[tuple[str, str], str] = {}
    classes: list[str] = []
    for default in root.findall("default"):
        own = [item for item in default if item.tag != "default"]
        new = {(item.tag, key): value for item in own for key, value in item.attrib.items()}
        late = [(*key, value) for key, value in new.items() if said.get(key) != value]
        if classes and late:
            tag, key, value = late[0]
            yield (
                f'<{tag} {key}="{value}"/> in a <default> below the one that has class '
                f"'{classes[0]}' (MuJoCo gives a class what stands above it, and not this: move it "
                "above the class if that should have it)"
            )
            return
        said |= new
        classes += [inner.get("class", "") for inner in default.iterfind("default")]


def written_out(root: Element, read: Callable[[Path], Element]) -> Element:
    """A file as MuJoCo's compiler writes it: each body once, actuators as ``<general>``.

    Args:
        root: Its root element, with what it includes and with absolute paths.
        read: Reads another file like that.

    Returns:
        Its root element. Numbers have six digits.

    Raises:
        ValueError: If MuJoCo's compiler refuses the file.
    """
    import mujoco

    with TemporaryDirectory() as folder:
        _place_models(root, read, Path(folder))
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
        spec.compile()
        return ElementTree.fromstring(spec.to_xml())


def has_mujoco() -> bool:
    """Whether MuJoCo's compiler is installed."""
    return importlib.util.find_spec("mujoco") is not None


def compiled(path: Path) -> Any:
    """What MuJoCo's compiler makes of a file; None where it is not installed or refuses it."""
    if not has_mujoco():
        return None
    import mujoco

    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError:  # it may lack what Newton does without
        return None


def _place_models(root: Element, read: Callable[[Path], Element], folder: Path) -> None:
    """Puts the files that a file attaches into a folder, with absolute paths of their meshes.

    MuJoCo forgets in which folder the meshes of such a file are.
    """
    for model in root.iterfind("asset/model"):
        path = Path(model.get("file", ""))
        if path.suffix.lower() != ".xml" or not path.is_file():
            continue  # MuJoCo reads it or says what is wrong
        inner = read(path)
        _place_models(inner, read, folder)
        place = folder / f"{len([*folder.iterdir()])}.xml"
        ElementTree.ElementTree(inner).write(place)
        model.set("file", str(place))


def merge_defaults(root: Element) -> None:
    """Writes the default classes of a file as the importer understands them.

    MuJoCo calls the outermost class ``main``, whether the file does or not, and several elements
    of one class add up. Newton's importer takes one with a name for a class like others, and the
    last element of a kind for all.
    """
    outer = root.findall("default")
    called = any(MAIN in (item.get("class"), item.get("childclass")) for item in root.iter())
    if not called and len(outer) <= 1:
        return
    own: dict[str, Element] = {}
    inner: list[Element] = []
    for default in outer:
        for item in default:
            if item.tag == "default":
                inner.append(item)
            elif item.tag in own:
                own[item.tag].attrib |= item.attrib
                own[item.tag].extend(item)
            else:
                own[item.tag] = item
        root.remove(default)
    for name, items in (({}, [*own.values(), *inner]), ({"class": MAIN}, [*own.values()])):
        whole = ElementTree.SubElement(root, "default", name)
        whole.extend(items)


def leave_frames(root: Element) -> None:
    """Takes joints out of the frames of their bodies.

    Args:
        root: Root element of a file that :func:`written_out` returned: its frames have ``pos`` and
            ``quat`` alone.
    """
    classes = by_class(root)

    def lift(parent: Element, pose: np.ndarray, ambient: str) -> list[Element]:
        """Joints of a frame in a pose of its body; those in frames of a body stay in the body."""
        lifted: list[Element] = []
        for item in [*parent]:
            inner = item.get("childclass", ambient)
            if item.tag == "frame":
                found = lift(item, multiply(pose, _pose(item)), inner)
                if parent.tag == "frame":
                    lifted += found
                else:
                    place = [*parent].index(item)
                    parent[place:place] = found
            elif item.tag == "body":
                lift(item, IDENTITY[None], inner)
            elif item.tag == "joint" and parent.tag == "frame":
                parent.remove(item)
                own = item.get("class", ambient)
                said = classes.get(own, {}).get("joint", {}) | item.attrib
                item.set("pos", _text(multiply(pose, _place(numbers(said, "pos")))))
                axis = multiply(pose, _place(numbers({"axis": "0 0 1"} | said, "axis")))
                item.set("axis", _text(axis - pose))
                if own:
                    item.set("class", own)
                lifted.append(item)
        return lifted

    for world in root.iter("worldbody"):
        lift(world, IDENTITY[None], "")


def _pose(frame: Element) -> np.ndarray:
    """Where a frame is in the one around it, shape (1, 7)."""
    pose = _place(numbers(frame.attrib, "pos"))
    pose[0, 3:] = np.roll(numbers({"quat": "1 0 0 0"} | frame.attrib, "quat"), -1)
    pose[0, 3:] /= np.linalg.norm(pose[0, 3:])
    return pose


def _place(position: np.ndarray) -> np.ndarray:
    """A pose that is not turned, shape (1, 7)."""
    pose = IDENTITY[None].copy()
    pose[0, :3] = position
    return pose


def _text(pose: np.ndarray) -> str:
    """A position as an attribute."""
    return " ".join(f"{value:.9g}" for value in pose[0, :3])


def silence_actuators(root: Element) -> list[str]:
    """Takes the force of actuators whose group the file disables, which the importer does not read.

    They stay where they are among the actuators: ``ctrl`` has a value for each of them in MuJoCo,
    too.

    Args:
        root: Root element of the file.

    Returns:
        What to call these actuators.

    Raises:
        ValueError: If the file disables a group that MuJoCo does not have.
    """
    disabled = _disabled_groups(root)
    if not disabled:
        return []
    sections = [*root.iter("actuator")]
    tags = dict.fromkeys(item.tag for section in sections for item in section)
    silent = []
    for tag in tags:
        items = [item for section in sections for item in section.findall(tag)]
        for item, (name, said) in zip(items, of_group(root, "actuator", tag), strict=True):
            if int(said.get("group", "0")) in disabled:
                silent.append((item, name, said))
    for item, _, said in silent:
        item.clear()
        item.tag = "general"
        item.attrib = {key: said[key] for key in _OF_ACTUATOR if key in said} | _SILENT
    return [name for _, name, _ in silent]


def _disabled_groups(root: Element) -> set[int]:
    """Groups of actuators that a file disables.

    Raises:
        ValueError: If there is no such group.
    """
    groups = set()
    for option in root.iter("option"):
        for word in option.get("actuatorgroupdisable", "").split():
            if not word.isdecimal() or int(word) not in _GROUPS:
                raise ValueError(
                    f'<option actuatorgroupdisable="{option.get("actuatorgroupdisable")}"> '
                    f"disables group {word} of actuators. Write groups from {_GROUPS[0]} to "
                    f"{_GROUPS[-1]}."
                )
            groups.add(int(word))
    return groups


def has_springdamper(joint: Attributes) -> bool:
    """Whether a joint has its spring and damper by a time constant and a damping ratio."""
    return bool(np.all(numbers({"springdamper": "0 0"} | joint, "springdamper") > 0.0))


def find_springs(root: Element, native: Any) -> list[str]:
    """Writes the stiffness and damping of joints with ``springdamper``, which go by inertia.

    Args:
        root: Root element of the file.
        native: What MuJoCo's compiler makes of it.

    Returns:
        What to call these joints; one without a name stays as it is.
    """
    numbered = {native.joint(i).name: i for i in range(native.njnt)}
    found = []
    for body in bodies(root):
        items = [item for item in body.element if item.tag in ("joint", "freejoint")]
        for item, joint in zip(items, body.joints, strict=True):
            if has_springdamper(joint) and joint.get("name") in numbered:
                number = numbered[joint["name"]]
                damping = native.dof_damping[native.jnt_dofadr[number]]
                values = {"stiffness": native.jnt_stiffness[number], "damping": damping}
                item.attrib |= {name: f"{np.ravel(value)[0]:.9g}" for name, value in values.items()}
                item.set("springdamper", "0 0")
                found.append(body.label(joint))
    return found


def separate_joints(root: Element) -> list[str]:
    """Gives joints bodies of their own where the importer reads several of one body otherwise.

    It has hinges turn about the anchor of the first joint, slides before hinges, and nothing beside
    a ball joint; and fixed tendons do not say which joint of a body they mean. The joints but the
    last one get bodies of next to no mass between the body and what it is in. In a fluid they would
    not be without drag, so that joints stay as they are there.

    Returns:
        What to call the bodies whose joints these are.
    """
    if has_fluid(root):
        return []
    combined = _combined(root)
    inside = {item: parent for parent in root.iter() for item in parent}
    taken = {item.get("name", "") for item in root.iter("body")}
    found = []
    for body in bodies(root):
        joints = [item for item in body.element if item.tag == "joint"]
        _place_slides(body, joints)
        names = {joint.get("name") for joint in joints}
        if len(joints) < 2 or not (names & combined or is_read_otherwise(body)):
            continue
        found.append(body.among)
        own = body.element
        parent = inside[own]
        place = [*parent].index(own)
        parent.remove(own)
        moved = {key: own.attrib.pop(key) for key in _OF_PLACE if key in own.attrib}
        for number, joint in enumerate(joints[:-1]):
            own.remove(joint)
            light = ElementTree.Element("body", moved)
            if body.name:
                light.set("name", _unused(f"{body.name}_{joint.get('name', number)}", taken))
            ElementTree.SubElement(light, "inertial", _LIGHT)
            light.append(joint)
            parent.insert(place, light)
            parent, place, moved = light, 2, {}
        parent.insert(place, own)
    return found


def _unused(name: str, taken: set[str]) -> str:
    """A name that no body has, which is taken from now on."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _place_slides(body: Body, joints: list[Element]) -> None:
    """Puts slides, whose place says nothing, where the hinges of their body are if that is one."""
    hinges = [joint for joint in body.joints if joint.get("type", "hinge") == "hinge"]
    if hinges and not any(is_moved(hinge, hinges[0]) for hinge in hinges):
        for item, said in zip(joints, body.joints, strict=False):
            if said.get("type") == "slide":
                said["pos"] = hinges[0].get("pos", "0 0 0")
                item.set("pos", said["pos"])


def _combined(root: Element) -> set[str | None]:
    """Names of joints that fixed tendons combine which push or hold."""
    pulled = {
        item.get(key)
        for group in ("actuator", "equality")
        for item in root.iterfind(f"{group}/*")
        for key in ("tendon", "tendon1", "tendon2")
    }
    tendons = [*root.iterfind("tendon/fixed")]
    said = [attributes for _, attributes in of_group(root, "tendon", "fixed")]
    return {
        item.get("joint")
        for tendon, has in zip(tendons, said, strict=True)
        if any(numbers(has, key).any() for key in _OF_TENDON) or has.get("name") in pulled
        for item in tendon.iter("joint")
    }


def is_read_otherwise(body: Body) -> bool:
    """Whether the importer takes joints of a body for others than they are."""
    kinds = [joint.get("type", "hinge") for joint in body.joints]
    has_ball = "ball" in kinds and len(kinds) > 1
    hinges = [joint for joint, kind in zip(body.joints, kinds, strict=True) if kind == "hinge"]
    is_turned = "hinge" in kinds and "slide" in kinds[kinds.index("hinge") :]
    return has_ball or is_turned or any(is_moved(hinge, body.joints[0]) for hinge in hinges)


def is_moved(hinge: Attributes, first: Attributes) -> bool:
    """Whether a hinge turns about another line where it has the pos of another joint."""
    axis = np.array(hinge.get("axis", "0 0 1").split(), dtype=float)
    off = np.cross(numbers(hinge, "pos") - numbers(first, "pos"), axis)
    return bool(np.linalg.norm(off) > _MOVED * np.linalg.norm(axis))
