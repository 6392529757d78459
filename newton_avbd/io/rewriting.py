# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""MJCF elements that Newton's importer does not read, in terms of those that it reads."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import numpy as np

from newton_avbd.model.welds import IDENTITY, multiply

from .elements import bodies, by_class, in_tree, numbers, of_group

Element = ElementTree.Element

_COPIED = ("replicate", "attach", "composite")
"""Elements that stand for bodies elsewhere or for several."""
_ACTUATORS = ("adhesion", "cylinder")
"""Actuators that MuJoCo writes as ``<general>``, which the importer reads."""
_MAIN = "main"
"""MuJoCo's name of the default class of what names none."""


def hidden(root: Element) -> list[str]:
    """What of a file the importer does not read though MuJoCo can write it otherwise, by name."""
    found = [f"<{tag}>" for tag in _COPIED if any(in_tree(root, tag))]
    found += [f"<{tag}>" for tag in _ACTUATORS if any(of_group(root, "actuator", tag))]
    if any(numbers(said, "timeconst").any() for _, said in of_group(root, "actuator", "position")):
        found.append("timeconst of <position>")
    if any(body.framed for body in bodies(root)):
        found.append("joints in a <frame>")
    if _has_late_defaults(root):
        found.append("a <default> that does not act on classes before it")
    return found


def _has_late_defaults(root: Element) -> bool:
    """Whether defaults of all elements change after a class has taken them on."""
    said: dict[tuple[str, str], str] = {}
    has_class = False
    for default in root.findall("default"):
        own = [item for item in default if item.tag != "default"]
        new = {(item.tag, key): value for item in own for key, value in item.attrib.items()}
        if has_class and any(said.get(key) != value for key, value in new.items()):
            return True
        said |= new
        has_class |= default.find("default") is not None
    return False


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


def merge_defaults(root: Element) -> bool:
    """Writes the default classes of a file as the importer understands them; whether it had to.

    MuJoCo calls the outermost class ``main``, whether the file does or not, and several elements
    of one class add up. Newton's importer takes one with a name for a class like others, and the
    last element of a kind for all.
    """
    outer = root.findall("default")
    called = any(_MAIN in (item.get("class"), item.get("childclass")) for item in root.iter())
    if not called and len(outer) <= 1:
        return False
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
    for name, items in (({}, [*own.values(), *inner]), ({"class": _MAIN}, [*own.values()])):
        whole = ElementTree.SubElement(root, "default", name)
        whole.extend(items)
    return True


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
