# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Reading MJCF files by Newton's importer, and what it leaves to be found."""

import copy
import re
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree

import newton
import numpy as np
import warp as wp

from newton_avbd.rows.actuator import MUSCLE_BIAS, MUSCLE_GAIN

from .elements import bodies
from .masses import check_mjcf_masses
from .rewriting import (
    LIGHT,
    compiled,
    find_springs,
    has_mujoco,
    has_springdamper,
    hidden,
    leave_frames,
    merge_defaults,
    separate_joints,
    silence_actuators,
    written_out,
)
from .unread import listed, refuse, unread

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


def add_mjcf(
    builder: newton.ModelBuilder, path: Path, *, light_links: bool = True, **options: Any
) -> tuple[str, ...]:
    """``builder.add_mjcf`` for a file, also for what that leaves out of it.

    MuJoCo's compiler, where it is installed, writes out what is replicated, attached or composed.
    Geoms whose meshes are not there are left out. Muscles get the length ranges that MuJoCo's
    compiler finds, where the file says none, and joints the springs that it makes of
    ``springdamper``. Mocap bodies become kinematic. Actuators of groups that the file disables
    exert no force.

    Args:
        builder: What to add to.
        path: The file.
        light_links: Whether joints get bodies of their own, of next to no mass, where the importer
            reads several joints of one body otherwise.
        **options: Of ``builder.add_mjcf``.

    Returns:
        What the user should know of it, a sentence each; what the importer leaves out among it.

    Raises:
        ValueError: If the file is no MJCF, has joints that the importer cannot read, a mass or
            moment of inertia is negative or not finite, or a group of actuators is disabled that
            there cannot be; and whatever that raises.
    """
    known = len(_values(builder, "label"))
    root, absent = read_mjcf(path)
    if root.tag != "mujoco":
        raise ValueError(f"its root element is <{root.tag}>, not <mujoco> as in MJCF")
    root, notes = _written_out(path, root)
    if any(has_springdamper(joint) for body in bodies(root) for joint in body.joints):
        native = compiled(path)
        if native is not None and (names := find_springs(root, native)):
            notes.append(
                f"{path.name} goes on with the stiffness and damping that MuJoCo's compiler finds "
                f"for joints with springdamper: {listed(names)}"
            )
    if light_links and (names := separate_joints(root)):
        notes.append(
            f"{path.name} gets bodies of {LIGHT:g} kg for joints of {listed(names)}: Newton's "
            "importer takes several joints of one body for others than they are"
        )
    if names := silence_actuators(root):
        is_one = len(names) == 1
        notes.append(
            f"{path.name} disables the groups of {len(names)} actuator{'s' * (not is_one)} "
            f"({listed(names)}), which exert{'s' * is_one} no force"
        )
    refuse(root)
    check_mjcf_masses(root)
    merge_defaults(root)
    _drop_pgs(root)
    text = ElementTree.tostring(root, encoding="unicode")
    first = builder.body_count
    builder.add_mjcf(text, path_resolver=partial(_beside, path.parent), **options)
    _mark_mocap(root, builder, first)
    return (
        *notes,
        *(_left_out(path, root, absent, builder) if absent else ()),
        *unread(path.name, root, builder),
        *_find_length_ranges(builder, path, known),
    )


def _written_out(path: Path, root: ElementTree.Element) -> tuple[ElementTree.Element, list[str]]:
    """A file as MuJoCo's compiler writes it, if it has what the importer does not read.

    Returns:
        Its root element, and a sentence on it if that is another one or could not be made.
    """
    names = hidden(root)
    if not names or not has_mujoco():
        return root, []
    what = f"{', '.join(names)}, which Newton's importer does not read"
    try:
        root = written_out(copy.deepcopy(root), lambda other: read_mjcf(other)[0])
    except (ValueError, ElementTree.ParseError) as error:
        reason = str(error).strip().splitlines()[0]
        return root, [f"{path.name} has {what}, and MuJoCo's compiler refuses it: {reason}"]
    leave_frames(root)
    return root, [f"{path.name} is read as MuJoCo's compiler writes it: it has {what}"]


def _mark_mocap(root: ElementTree.Element, builder: newton.ModelBuilder, first: int) -> None:
    """Makes mocap bodies kinematic, which Newton's importer fixes to the world, from a body on."""
    names = {body.name for body in bodies(root) if body.is_mocap and body.name}
    for body in range(first, builder.body_count):
        if builder.body_label[body].rpartition("/")[2] in names:
            builder.body_flags[body] = int(newton.BodyFlags.KINEMATIC)


def _left_out(
    path: Path, root: ElementTree.Element, absent: dict[str, str], builder: newton.ModelBuilder
) -> Iterator[str]:
    """Says which meshes are not there, and what is weighed without them."""
    files = ", ".join(dict.fromkeys(absent.values()))
    yield f"{path.name} goes on without the geoms of meshes that are not there: {files}"
    weighs_geoms = any(
        item.get("inertiafromgeom", "").lower() == "true" for item in root.iter("compiler")
    )
    bare = {
        body.get("name")
        for body in root.iter("body")
        if (weighs_geoms or body.find("inertial") is None)
        and any(geom.get("mesh") in absent for geom in body.findall("geom"))
    }
    named = zip(builder.body_label, builder.body_mass, strict=True)
    masses = [(label.rpartition("/")[2], mass) for label, mass in named]
    weights = [f"{name!r} {mass:.3g} kg" for name, mass in masses if name in bare]
    if weights:
        yield (
            f"{path.name}: bodies of these geoms have no <inertial>, and weigh what the others of "
            f"their geoms do: {', '.join(weights)}"
        )


def read_mjcf(
    path: Path,
    main: Path | None = None,
    folders: Mapping[str, str] = MappingProxyType({}),
    absent: dict[str, str] | None = None,
) -> tuple[ElementTree.Element, dict[str, str]]:
    """Read a file with what it includes, and with absolute paths of the files that it names.

    Files are looked for as Newton's importer does: beside the main file, then beside the file that
    names them, each in the folder that ``<compiler>`` names.

    Args:
        path: The file.
        main: Folder of the file that includes it; by default its own.
        folders: Folders of assets that the including file names, by tag.
        absent: Where to note what is not there.

    Returns:
        The file's root element, without the meshes that were not found; and the names of these
        meshes, with their files as the file writes them.
    """
    main, absent = main or path.parent, {} if absent is None else absent
    # MuJoCo reads over comments with "--" inside, which are no XML
    text = _COMMENT.sub(lambda found: b"\n" * found[0].count(b"\n"), path.read_bytes())
    root = ElementTree.fromstring(text)
    compiler = root.find("compiler")
    own = {} if compiler is None else compiler.attrib
    meshes = own.pop("meshdir", own.get("assetdir", folders.get("mesh", "")))
    textures = own.pop("texturedir", own.pop("assetdir", folders.get("texture", "")))
    folders = {"mesh": meshes, "hfield": meshes, "texture": textures}
    is_stripped = own.pop("strippath", "").lower() == "true"

    def find(tag: str, name: str) -> tuple[Path, bool]:
        """Where a file is or should be, and whether it is there."""
        name = name.replace("\\", "/").rpartition("/")[2] if is_stripped else name
        inner = Path(folders.get(tag, "")) / name
        places = (main / inner, path.parent / name, path.parent / inner)
        found = next((place for place in places if place.is_file()), None)
        return (found or places[0]).absolute(), found is not None

    # what is included within <asset> has none around it
    for group in [*root.iter()]:
        for asset in [*group]:
            if asset.tag not in folders and asset.tag != "model":
                continue
            for key in [key for key in asset.attrib if key.startswith("file")]:
                named, is_there = find(asset.tag, asset.attrib[key])
                if asset.tag == "mesh" and not is_there:
                    absent[asset.get("name") or named.stem] = asset.attrib[key]
                    group.remove(asset)
                else:
                    asset.set(key, str(named))
    for parent in [*root.iter()]:
        for place, item in reversed([*enumerate(parent)]):
            if item.tag == "include":
                file = path.parent / item.get("file", "")
                file = file if file.is_file() else main / item.get("file", "")
                if not file.is_file():
                    continue  # the importer names it
                parent.remove(item)
                for child in reversed(read_mjcf(file, main, folders, absent)[0]):
                    parent.insert(place, child)
    return root, absent


def _values(builder: newton.ModelBuilder, name: str) -> Any:
    """What a builder holds of an attribute of MuJoCo's actuators, by row."""
    attribute = builder.custom_attributes.get(f"mujoco:actuator_{name}")
    return [] if attribute is None else attribute.values or []


def _find_length_ranges(builder: newton.ModelBuilder, path: Path, first: int) -> tuple[str, ...]:
    """Gives muscles the length ranges that MuJoCo's compiler finds where the file says none.

    Args:
        builder: Has read the file.
        path: The file.
        first: Row of the file's first actuator.

    Returns:
        A sentence on it, if there are such muscles and MuJoCo can read the file.
    """
    ranges, labels = _values(builder, "lengthrange"), _values(builder, "label")
    gains, biases = _values(builder, "gaintype"), _values(builder, "biastype")
    missing = [
        row
        for row in range(first, len(labels))
        if (gains[row] == int(MUSCLE_GAIN) or biases[row] == int(MUSCLE_BIAS))
        and ranges[row][0] >= ranges[row][1]
    ]
    native = compiled(path) if missing else None
    if native is None:
        return ()
    rows = {native.actuator(row).name: row for row in range(native.nu)}
    for row in missing:
        # those without a name come in the order of the file
        known = rows.get(labels[row].rpartition("/")[2], row - first)
        ranges[row] = wp.vec2(*native.actuator_lengthrange[known].astype(np.float32))
    return (
        f"{path.name} goes on with the length ranges that MuJoCo's compiler finds for "
        f"{len(missing)} muscle{'s' * (len(missing) > 1)}: the file says none.",
    )


def _drop_pgs(root: ElementTree.Element) -> None:
    """Takes the choice of MuJoCo's PGS solver out of a file.

    Newton's importer refuses the name, which says nothing about the scene.
    """
    for option in root.iter("option"):
        if option.get("solver", "").lower() == "pgs":
            del option.attrib["solver"]


def _beside(folder: Path, base: str | None, name: str) -> str:
    """Path of a file that an MJCF text names, relative to the folder of its file."""
    return str((Path(base) if base else folder) / name)
