# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Masses and moments of inertia of files that make no sense.

Newton's importers set to zero what is negative or not finite in MJCF and USD files, and a body
without mass stays where it is. What weighs no body may have any value, as in MuJoCo.
"""

import math
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

from .elements import Attributes, Body, bodies, numbers

_OF_INERTIAL = {"mass": 1, "diaginertia": 3, "fullinertia": 3}
"""Attributes, and how many of their numbers may not be negative."""


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
    """Raise a ``ValueError`` if an attribute of an element of a body makes no sense, of whose
    numbers so many may not be negative."""
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


def _wrong(values: Iterable[float], count: int) -> str:
    """What is wrong with numbers of which the first ones may not be negative; empty for nothing."""
    for i, number in enumerate(values):
        if not math.isfinite(number):
            return "is not finite"
        if i < count and number < 0.0:
            return "is negative"
    return ""
