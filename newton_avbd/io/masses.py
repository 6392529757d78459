# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Masses and moments of inertia of files: what makes no sense, and what is small.

Newton's importers set to zero what is negative or not finite in MJCF and USD files, and a body
without mass stays where it is. What weighs no body may have any value, as in MuJoCo.
"""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import newton
import numpy as np

from .elements import Attributes, Body, bodies, numbers

_OF_INERTIAL = {"mass": 1, "diaginertia": 3, "fullinertia": 3}
"""Attributes, and how many of their numbers may not be negative."""

_ROUNDED = 1.0e-5
"""Share by which moments of inertia may miss what a body can have."""


def check_mjcf_masses(root: ElementTree.Element) -> None:
    """Raise a ``ValueError`` for the first mass of an MJCF file that is negative or not finite."""
    compiler: Attributes = {}
    for item in root.iter("compiler"):
        compiler |= item.attrib
    weighs_geoms = compiler.get("inertiafromgeom", "auto").lower()
    for body in bodies(root):
        if weighs_geoms != "true" and body.inertial is not None:
            if body.moves:
                _check_inertial(body, body.inertial, compiler)
        else:
            _check_geoms(body, compiler)


def _check_inertial(body: Body, inertial: Attributes, compiler: Attributes) -> None:
    for name, count in _OF_INERTIAL.items():
        bound = compiler.get("boundmass" if name == "mass" else "boundinertia", "0")
        _check("inertial", name, inertial, body, 0 if float(bound) > 0.0 else count)


def _check_geoms(body: Body, compiler: Attributes) -> None:
    first, last = map(int, compiler.get("inertiagrouprange", "0 5").split())
    for geom in body.geoms:
        if first <= int(geom.get("group", "0")) <= last:
            _check("geom", "mass" if "mass" in geom else "density", geom, body, 1)


def _check(tag: str, name: str, said: Attributes, body: Body, count: int) -> None:
    """Raise a ``ValueError`` if an attribute makes no sense.

    Args:
        tag: Of the element.
        name: Of the attribute.
        said: Attributes of the element.
        body: Whose it is.
        count: How many of its numbers may not be negative.
    """
    wrong = _wrong(numbers(said, name), count)
    if wrong:
        raise ValueError(f"<{tag} {name}={said[name]!r}> of {body.called} {wrong}")


def check_usd_masses(path: Path) -> None:
    """Raise a ``ValueError`` for the first mass of a USD file that is negative or not finite."""
    from pxr import Usd, UsdPhysics

    stage = Usd.Stage.Open(str(path))
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        api = UsdPhysics.MassAPI(prim)
        if not api:
            continue
        mass = api.GetMassAttr().Get() or 0.0
        values = {"mass": mass, "diagonalInertia": api.GetDiagonalInertiaAttr().Get() or 0.0}
        if not mass > 0.0:
            values["density"] = api.GetDensityAttr().Get() or 0.0
        for name, value in values.items():
            wrong = _wrong((value,) if isinstance(value, float) else value, 3)
            if wrong:
                raise ValueError(f"physics:{name} = {value} of prim {prim.GetPath()} {wrong}")


def finalized(builder: newton.ModelBuilder, **options: Any) -> newton.Model:
    """``builder.finalize``, which leaves small moments of inertia as they are.

    Newton takes less than 1e-10 kg m^2 for an error and adds 1e-6 kg m^2: to a thumb of 1 g, the
    tail of a rat. Where all bodies have moments of inertia that a body can have, it is not asked to
    correct them.
    """
    inertia = np.array(builder.body_inertia, dtype=float).reshape(-1, 3, 3)
    mass = np.array(builder.body_mass, dtype=float)
    return builder.finalize(skip_validation_inertia=_is_sound(mass, inertia), **options)


def _is_sound(mass: np.ndarray, inertia: np.ndarray) -> bool:
    """Whether bodies can have these masses and moments of inertia, the triangle inequality too."""
    if not (np.all(np.isfinite(mass)) and np.all(np.isfinite(inertia)) and np.all(mass >= 0.0)):
        return False
    largest = np.abs(inertia).max(axis=(1, 2))
    if np.any(np.abs(inertia - np.swapaxes(inertia, 1, 2)).max(axis=(1, 2)) > _ROUNDED * largest):
        return False
    moments = np.linalg.eigvalsh(inertia)
    has_inertia = (moments[:, 0] > _ROUNDED * largest) & (
        moments[:, 2] <= (1.0 + _ROUNDED) * moments[:, :2].sum(axis=1)
    )
    return bool(np.all(np.where(mass > 0.0, has_inertia, largest == 0.0)))


def _wrong(values: Iterable[float], count: int) -> str:
    """What is wrong with numbers of which the first ones may not be negative; empty for nothing."""
    for i, number in enumerate(values):
        if not math.isfinite(number):
            return "is not finite"
        if i < count and number < 0.0:
            return "is negative"
    return ""
