# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Reading MJCF files by Newton's importer, and what it leaves to be found."""

import importlib.util
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import newton
import numpy as np
import warp as wp

from newton_avbd.rows.actuator import MUSCLE_BIAS, MUSCLE_GAIN

UNREAD = ("adhesion", "cylinder", "orientation", "pid", "plugin")
"""Kinds of MuJoCo's actuators that Newton's importer leaves out without a word."""


def add_mjcf(builder: newton.ModelBuilder, path: Path, **options: Any) -> tuple[str, ...]:
    """``builder.add_mjcf`` for a file, also one that chooses MuJoCo's PGS solver.

    Muscles get the length ranges that MuJoCo's compiler finds, where the file says none.

    Returns:
        What the user should know of it, a sentence each.
    """
    known = len(_values(builder, "label"))
    source = _without_pgs(path)
    if source is None:
        builder.add_mjcf(str(path), **options)
    else:
        builder.add_mjcf(source, path_resolver=partial(_beside, path.parent), **options)
    return (*_unread_actuators(path), *_find_length_ranges(builder, path, known))


def _unread_actuators(path: Path) -> tuple[str, ...]:
    """A sentence on the actuators of a file that are of :data:`UNREAD` kinds, if any."""
    found = [
        f"'{element.get('name', '')}' (<{element.tag}>)"
        for group in ElementTree.parse(path).getroot().iter("actuator")
        for element in group
        if element.tag in UNREAD
    ]
    if not found:
        return ()
    names = ", ".join(found)
    return (
        f"{path.name} goes on without the actuator{'s' * (len(found) > 1)} {names}: Newton's "
        "importer does not read such. Write a <general> one of the same law.",
    )


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
    kinds = (
        (_values(builder, "gaintype"), int(MUSCLE_GAIN)),
        (
            _values(builder, "biastype"),
            int(MUSCLE_BIAS),
        ),
    )
    missing = [
        row
        for row in range(first, len(labels))
        if any(values[row] == muscle for values, muscle in kinds)
        and ranges[row][0] >= ranges[row][1]
    ]
    if not missing or importlib.util.find_spec("mujoco") is None:
        return ()
    import mujoco

    try:
        native = mujoco.MjModel.from_xml_path(str(path))
    except ValueError:  # it may lack what Newton does without
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


def _without_pgs(path: Path) -> str | None:
    """Text of an MJCF file without its choice of MuJoCo's PGS solver; None for no such choice.

    Newton's importer refuses the name, which says nothing about the scene.
    """
    root = ElementTree.parse(path).getroot()
    options = [item for item in root.iter("option") if item.get("solver", "").lower() == "pgs"]
    for option in options:
        del option.attrib["solver"]
    return ElementTree.tostring(root, encoding="unicode") if options else None


def _beside(folder: Path, base: str | None, name: str) -> str:
    """Path of a file that an MJCF text names, relative to the folder of its file."""
    return str((Path(base) if base else folder) / name)
