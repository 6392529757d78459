# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Masses and moments of inertia of MJCF and USD files that make no sense.

Newton's importers set them to zero, and a body without mass stays where it is.
"""

import math
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

_OF_MJCF = {
    "inertial": {"mass": 1, "diaginertia": 3, "fullinertia": 3},
    "geom": {"mass": 1, "density": 1},
}
"""Attributes of elements, and how many of their numbers may not be negative."""

_OF_USD = ("physics:mass", "physics:density", "physics:diagonalInertia")


def check_mjcf_masses(root: ElementTree.Element) -> None:
    """Raise a ``ValueError`` for the first mass of an MJCF file that is negative or not finite."""
    for owner in root.iter():
        for element in owner:
            for name, count in _OF_MJCF.get(element.tag, {}).items():
                value = element.get(name, "")
                wrong = _wrong(map(float, value.split()), count)
                if wrong:
                    called = owner.get("name") or owner.get("class") or ""
                    raise ValueError(
                        f"<{element.tag} {name}={value!r}> of {owner.tag} {called!r} {wrong}"
                    )


def check_usd_masses(path: Path) -> None:
    """Raise a ``ValueError`` for the first mass of a USD file that is negative or not finite."""
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        for name in _OF_USD:
            attribute = prim.GetAttribute(name)
            value = attribute.Get() if attribute.HasAuthoredValue() else None
            if value is None:
                continue
            wrong = _wrong(value if name == _OF_USD[-1] else (value,), 3)
            if wrong:
                raise ValueError(f"{name} = {value} of prim {prim.GetPath()} {wrong}")


def _wrong(numbers: Iterable[float], count: int) -> str:
    """What is wrong with numbers of which the first ones may not be negative; empty for nothing."""
    for i, number in enumerate(numbers):
        if not math.isfinite(number):
            return "is not finite"
        if i < count and number < 0.0:
            return "is negative"
    return ""
