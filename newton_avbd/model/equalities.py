# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's JOINT equality constraints that no mimic stands for: an axis by a polynomial of another.

    q1 = a0 + a1 q2 + a2 q2^2 + a3 q2^3 + a4 q2^4,

both counted from the reference pose, as Newton's coordinates are; q1 = a0 without a second joint.
Newton's importer makes a mimic of each that ties two joints of one axis, which has the first two
coefficients, and leaves the others as they are.
"""

from dataclasses import dataclass
from typing import Any

import newton
import numpy as np

from ..rows.joint import KINDS

_JOINT = 2
"""The type of these constraints, ``EqType.JOINT``."""
_MIMIC = 2
"""What those have a mimic for target by, ``MjcEqualityTargetKind.MIMIC``."""


@dataclass(frozen=True)
class Equality:
    """One of these constraints, in terms of the joints of a model."""

    row: int
    """Row of ``mujoco:equality_constraint``."""
    joint: int
    dof: int
    """Axis of the joint that follows."""
    leader: int
    """The joint that it follows; itself where it is held."""
    leader_dof: int
    """Axis of that joint, -1 where there is none to follow."""


def _rows(model: newton.Model) -> np.ndarray:
    """Rows of JOINT constraints that are enabled and no mimic stands for."""
    if not model.custom_frequency_counts.get("mujoco:equality_constraint", 0):
        return np.zeros(0, dtype=int)
    mujoco: Any = model.mujoco
    is_joint = mujoco.equality_constraint_type.numpy() == _JOINT
    is_own = (mujoco.equality_constraint_target.numpy() < 0) | _exceeds_mimic(model)
    return np.flatnonzero(is_joint & is_own & mujoco.equality_constraint_enabled.numpy())


def _exceeds_mimic(model: newton.Model) -> np.ndarray:
    """Which rows have more than the two coefficients of a mimic, or tie a slide and a hinge."""
    mujoco: Any = model.mujoco
    is_curved = np.any(mujoco.equality_constraint_polycoef.numpy()[:, 2:] != 0.0, axis=1)
    dims = getattr(model, "user_model", model).joint_dof_dim.numpy()
    ends = [getattr(mujoco, f"equality_constraint_joint{end}").numpy() for end in (1, 2)]
    return is_curved | np.any(dims[ends[0]] != dims[ends[1]], axis=1)


def replaced_mimics(model: newton.Model) -> set[int]:
    """Mimic constraints in whose place an equality acts, which says more than they can."""
    mujoco: Any = getattr(model, "mujoco", None)
    rows = _rows(model)
    rows = rows[[mujoco.equality_constraint_target_kind.numpy()[row] == _MIMIC for row in rows]]
    return set(mujoco.equality_constraint_target.numpy()[rows].tolist()) if rows.size else set()


def equalities(model: newton.Model) -> list[Equality]:
    """These constraints of a model, or of what a :class:`.setup.solved.SolvedModel` makes of it.

    Left out are those of joints that have no axes of their own, as BALL and FREE.
    """
    rows = _rows(model)
    if rows.size == 0:
        return []
    mujoco: Any = model.mujoco
    welds = getattr(model, "welds", None)
    number = np.arange(model.joint_count)
    if welds is not None and welds.any:
        number = np.full(welds.joint.max(initial=-1) + 2, -1)
        number[welds.joint] = np.arange(welds.joint.size)
    starts, kinds = model.joint_qd_start.numpy(), model.joint_type.numpy()
    dims = model.joint_dof_dim.numpy().sum(axis=1)
    found = []
    for row in rows.tolist():
        ends: list[tuple[int, int]] = []
        is_known = True
        for end in (1, 2):
            joint = int(getattr(mujoco, f"equality_constraint_joint{end}").numpy()[row])
            if joint < 0:
                continue
            joint = int(number[joint]) if joint < number.size else -1
            dof = int(getattr(mujoco, f"equality_constraint_joint{end}_dof").numpy()[row])
            dof = dof - int(starts[joint]) if dof >= 0 else 0
            is_axis = joint >= 0 and KINDS[int(kinds[joint])].has_axes and dof < dims[joint]
            is_known &= is_axis
            ends.append((joint, dof))
        if not is_known or not ends:
            continue
        joint, dof = ends[0]
        leader, leader_dof = ends[1] if len(ends) > 1 else (joint, -1)
        found.append(Equality(row, joint, dof, leader, leader_dof))
    return found
