# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's tendons of a model, fixed and spatial, from its ``mujoco`` namespace.

What acts along them is in :mod:`.rows.tendon`, how they are solved in :mod:`.step.tendons`.
"""

from dataclasses import dataclass
from typing import Any

import newton
import numpy as np

from ..rows import path as rules

_ONE_AXIS = (int(newton.JointType.REVOLUTE), int(newton.JointType.PRISMATIC))
_GEOMS = {
    int(newton.GeoType.SPHERE): int(rules.SPHERE),
    int(newton.GeoType.CYLINDER): int(rules.CYLINDER),
}
"""Geoms that a path wraps around."""
_SITE, _GEOM, _PULLEY = 0, 1, 2
"""``mujoco:tendon_wrap_type``."""
_TENDON = 3
"""The type of equality constraints between tendons, ``EqType.TENDON``."""
_AUTO = 2
"""A limit that holds where a range is given."""


@dataclass(frozen=True)
class Element:
    """An element of a tendon's path."""

    kind: int
    """See :mod:`.rows.path`."""
    index: int
    """The joint of a fixed tendon, or the shape; -1 for a pulley."""
    value: float = 0.0
    """Coefficient, radius [m] or divisor."""

    @property
    def is_held(self) -> bool:
        """Whether a body holds ends of spans there."""
        return self.kind in (int(rules.SITE), int(rules.SPHERE), int(rules.CYLINDER))


@dataclass(frozen=True)
class Tendon:
    """A tendon that acts."""

    row: int
    """Row of its ``mujoco:tendon`` attributes."""
    path: tuple[Element, ...]

    @property
    def is_fixed(self) -> bool:
        """Whether it combines joint coordinates."""
        return self.path[0].kind == int(rules.JOINT)


@dataclass(frozen=True)
class TendonEquality:
    """A tendon whose length is a polynomial of that of another one."""

    row: int
    """Row of ``mujoco:equality_constraint``."""
    tendon: Tendon
    other: Tendon | None
    """The one that it follows; None where it keeps its length."""


def pulled(cord: Tendon | TendonEquality) -> tuple[Tendon, ...]:
    """The tendons whose lengths a row is about."""
    if isinstance(cord, Tendon):
        return (cord,)
    return (cord.tendon,) if cord.other is None else (cord.tendon, cord.other)


def tendon_count(model: newton.Model) -> int:
    """How many tendons of MuJoCo's a model authors."""
    return int(model.custom_frequency_counts.get("mujoco:tendon", 0))


def tendon_name(model: newton.Model, row: int) -> str:
    """What messages call a tendon."""
    label = list(getattr(model.mujoco, "tendon_label", ()))[row : row + 1]
    return f"MuJoCo tendon {row} ('{label[0] if label else ''}')"


def tendons(model: newton.Model) -> list[Tendon]:
    """The tendons that act, in the order of their rows.

    Of a joint with several axes Newton's importer does not say which one a tendon combines. As in
    SolverMuJoCo the tendon goes without it then, and a tendon of such joints only does not act.

    Raises:
        ValueError: If a path makes no sense.
    """
    found = []
    mujoco: Any = getattr(model, "mujoco", None)
    user_model = getattr(model, "user_model", model)
    for row in range(tendon_count(model)):
        is_fixed = int(mujoco.tendon_type.numpy()[row]) == 0
        path = _joints(user_model, row) if is_fixed else _path(user_model, row)
        if path:
            found.append(Tendon(row, tuple(path)))
    return found


def left_joints(model: newton.Model) -> list[tuple[int, int]]:
    """Rows of fixed tendons that act, each with a joint of several axes that it goes without."""
    fixed = [tendon.row for tendon in tendons(model) if tendon.is_fixed]
    kinds = model.joint_type.numpy() if fixed else np.zeros(0)
    return [
        (row, joint)
        for row in fixed
        for joint, _ in _combined(model, row)
        if kinds[joint] not in _ONE_AXIS
    ]


def _joints(model: newton.Model, row: int) -> list[Element]:
    """Elements of a fixed tendon."""
    kinds = model.joint_type.numpy()
    return [
        Element(int(rules.JOINT), joint, coefficient)
        for joint, coefficient in _combined(model, row)
        if kinds[joint] in _ONE_AXIS
    ]


def _combined(model: newton.Model, row: int) -> list[tuple[int, float]]:
    """Joints that a fixed tendon combines, with their coefficients."""
    mujoco: Any = model.mujoco
    first, count = (int(getattr(mujoco, f"tendon_joint_{n}").numpy()[row]) for n in ("adr", "num"))
    if count <= 0:
        return []
    joints = mujoco.tendon_joint.numpy()[first : first + count].tolist()
    coefficients = mujoco.tendon_coef.numpy()[first : first + count].tolist()
    if len(joints) < count or min(joints) < 0 or max(joints) >= model.joint_count:
        raise ValueError(
            f"{tendon_name(model, row)} combines joints that do not exist: {joints}, of "
            f"{model.joint_count}. Correct mujoco:tendon_joint."
        )
    return list(zip(joints, coefficients, strict=True))


def _path(model: newton.Model, row: int) -> list[Element]:
    """Elements of a spatial tendon; each geom that has a side site is followed by that."""
    mujoco: Any = model.mujoco
    first, count = (int(getattr(mujoco, f"tendon_wrap_{n}").numpy()[row]) for n in ("adr", "num"))
    name = tendon_name(model, row)
    kinds, shapes, sides, values = (
        getattr(mujoco, f"tendon_wrap_{key}").numpy()[first : first + max(count, 0)].tolist()
        for key in ("type", "shape", "sidesite", "prm")
    )
    if sum(kind == _SITE for kind in kinds) < 2:
        raise ValueError(
            f"{name} has fewer than two sites to run through. Give its path two <site> elements "
            "at least (mujoco:tendon_wrap_type, tendon_wrap_shape)."
        )

    def known(shape: int, what: str) -> int:
        if not 0 <= shape < model.shape_count:
            raise ValueError(
                f"{name} runs through {what} {shape}, which is none of the model's "
                f"{model.shape_count} shapes. Correct mujoco:tendon_wrap_*, and leave out no shape "
                "of a tendon when a file is imported."
            )
        return shape

    path: list[Element] = []
    before = _PULLEY
    for kind, shape, side, value in zip(kinds, shapes, sides, values, strict=True):
        if kind == _SITE:
            path.append(Element(int(rules.SITE), known(shape, "site")))
        elif kind == _GEOM:
            if before != _SITE:
                raise ValueError(
                    f"{name} reaches a geom, '{model.shape_label[known(shape, 'geom')]}', from no "
                    "site. Put a <site> before and after each <geom> of its path."
                )
            geom = int(model.shape_type.numpy()[known(shape, "geom")])
            if geom not in _GEOMS:
                raise ValueError(
                    f"{name} wraps around '{model.shape_label[shape]}', which is a "
                    f"{newton.GeoType(geom).name}. Take a sphere or a cylinder, which can be."
                )
            radius = float(model.shape_scale.numpy()[shape][0])
            path.append(Element(_GEOMS[geom], shape, radius))
            if side >= 0:
                path.append(Element(int(rules.SIDE), known(side, "side site")))
        elif kind == _PULLEY:
            if not value > 0.0:
                raise ValueError(
                    f"{name} has a pulley whose divisor is {value}. It must be above zero "
                    "(mujoco:tendon_wrap_prm)."
                )
            path.append(Element(int(rules.PULLEY), -1, value))
        else:
            raise ValueError(f"{name} has an element of unknown type {kind} (tendon_wrap_type).")
        if before == _GEOM and kind != _SITE:
            break
        before = kind
    if path[-1].kind != int(rules.SITE):
        raise ValueError(
            f"{name} ends at no site, or a geom of it is followed by none. Put a <site> before and "
            "after each <geom> of its path."
        )
    return path


def tendon_equalities(model: newton.Model, found: list[Tendon]) -> list[TendonEquality]:
    """Equality constraints between tendons that act, which are enabled."""
    if not found or not model.custom_frequency_counts.get("mujoco:equality_constraint", 0):
        return []
    mujoco: Any = model.mujoco
    by_row = {tendon.row: tendon for tendon in found}
    is_tendon = mujoco.equality_constraint_type.numpy() == _TENDON
    ends = [getattr(mujoco, f"equality_constraint_tendon{end}").numpy() for end in (1, 2)]
    return [
        TendonEquality(row, by_row[ends[0][row]], by_row.get(ends[1][row]))
        for row in np.flatnonzero(is_tendon & mujoco.equality_constraint_enabled.numpy()).tolist()
        if ends[0][row] in by_row and (ends[1][row] < 0 or ends[1][row] in by_row)
    ]


def is_limited(model: newton.Model, found: list[Tendon]) -> np.ndarray:
    """Which of some tendons keep to their range; MuJoCo's ``autolimits``."""
    mujoco: Any = model.mujoco
    rows = [tendon.row for tendon in found]
    limited, ends = mujoco.tendon_limited.numpy()[rows], mujoco.tendon_range.numpy()[rows]
    is_auto = (limited == _AUTO) & bool(mujoco.autolimits.numpy()[0])
    return (limited == 1) | (is_auto & (ends[:, 0] < ends[:, 1]))


def force_ranges(model: newton.Model, found: list[Tendon]) -> np.ndarray:
    """Least and most that the actuators of some tendons may pull with together, (tendons, 2)."""
    mujoco: Any = model.mujoco
    rows = [tendon.row for tendon in found]
    limited = mujoco.tendon_actuator_force_limited.numpy()[rows]
    ends = mujoco.tendon_actuator_force_range.numpy()[rows].astype(float)
    is_auto = (limited == _AUTO) & bool(mujoco.autolimits.numpy()[0])
    is_bound = (limited == 1) | (is_auto & (ends[:, 0] < ends[:, 1]))
    return np.where(is_bound[:, None], ends, [[-np.inf, np.inf]])
