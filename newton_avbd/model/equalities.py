# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's equality constraints: JOINT constraints that no mimic stands for, and what rows switch.

A JOINT constraint leads an axis by a polynomial of another:

    q1 = a0 + a1 q2 + a2 q2^2 + a3 q2^3 + a4 q2^4,

both counted from the reference pose, as Newton's coordinates are; q1 = a0 without a second joint.
Newton's importer makes a mimic of each that ties two joints of one axis, which has the first two
coefficients, and leaves the others as they are. Of CONNECT and WELD constraints it makes joints.
The rows of the constraints decide: a mimic acts while its row is enabled, and follows by the
coefficients of its row, and a disabled row disables its joint. Where no joint stands for a row, the
solver makes one (:mod:`.model.row_joints`).
"""

from dataclasses import dataclass
from typing import Any

import newton
import numpy as np

from ..rows.joint import KINDS

_CONNECT, WELD, _JOINT = range(3)
"""Types of constraints, as in ``EqType``."""
_TO_JOINT = 1
"""What rows have a joint for target by, ``MjcEqualityTargetKind.JOINT``."""
_TO_MIMIC = 2
"""What rows have a mimic for target by, ``MjcEqualityTargetKind.MIMIC``."""


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


def row_count(model: newton.Model) -> int:
    """How many equality constraints of MuJoCo's a model has."""
    return int(model.custom_frequency_counts.get("mujoco:equality_constraint", 0))


def joints_of_rows(model: newton.Model) -> np.ndarray:
    """The joint that stands for each row of a CONNECT or WELD constraint, -1 without.

    Args:
        model: The user's, or a :class:`.setup.joined.JoinedModel`, whose own joints stand last.
    """
    target = model.mujoco.equality_constraint_target.numpy()
    found = np.where(_converted(model, _TO_JOINT), target, -1)
    own = getattr(model, "own_rows", np.zeros(0, dtype=int))
    found[own] = model.joint_count - own.size + np.arange(own.size)
    return found


def _converted(model: newton.Model, kind: int) -> np.ndarray:
    """Which rows an importer has made a joint or a mimic of, by the kind of that target."""
    if not row_count(model):
        return np.zeros(0, dtype=bool)
    mujoco: Any = model.mujoco
    target = mujoco.equality_constraint_target.numpy()
    return (mujoco.equality_constraint_target_kind.numpy() == kind) & (target >= 0)


def _exceeds_mimic(model: newton.Model) -> np.ndarray:
    """Which rows have more than the two coefficients of a mimic, or tie a slide and a hinge."""
    mujoco: Any = model.mujoco
    is_curved = np.any(mujoco.equality_constraint_polycoef.numpy()[:, 2:] != 0.0, axis=1)
    dims = getattr(model, "user_model", model).joint_dof_dim.numpy()
    ends = [getattr(mujoco, f"equality_constraint_joint{end}").numpy() for end in (1, 2)]
    return is_curved | np.any(dims[ends[0]] != dims[ends[1]], axis=1)


def mimic_laws(model: newton.Model) -> dict[int, tuple[float, float] | None]:
    """Offset and multiplier of each mimic constraint that stands for an equality constraint.

    None for one that does not act: its row is disabled, or says more than a mimic can, so that the
    equality acts in its place.
    """
    if not row_count(model):
        return {}
    mujoco: Any = model.mujoco
    rows = np.flatnonzero(_converted(model, _TO_MIMIC))
    if rows.size == 0:
        return {}
    acts = mujoco.equality_constraint_enabled.numpy() & ~_exceeds_mimic(model)
    targets = mujoco.equality_constraint_target.numpy()
    offset, multiplier = mujoco.equality_constraint_polycoef.numpy()[:, :2].T.tolist()
    return {
        int(targets[row]): (offset[row], multiplier[row]) if acts[row] else None
        for row in rows.tolist()
    }


def may_hold(model: newton.Model) -> np.ndarray:
    """Which joints of the user's model hold something where ``joint_enabled`` says so.

    All but those that stand for equality constraints whose rows are disabled, or have joints of
    their own. Of a :class:`.setup.joined.JoinedModel` these stand last.
    """
    model = getattr(model, "user_model", model)
    found = np.ones(model.joint_count, dtype=bool)
    if row_count(model):
        mujoco: Any = model.mujoco
        is_on = mujoco.equality_constraint_enabled.numpy()
        own = getattr(model, "own_rows", np.zeros(0, dtype=int))
        is_off = ~is_on
        is_off[own] = True
        is_off &= _converted(model, _TO_JOINT)
        found[mujoco.equality_constraint_target.numpy()[is_off]] = False
        found[found.size - own.size :] = is_on[own]
    return found


def lonely_rows(model: newton.Model) -> np.ndarray:
    """Rows of CONNECT and WELD constraints that no enabled joint stands for, of two bodies."""
    if not row_count(model):
        return np.zeros(0, dtype=int)
    mujoco: Any = model.mujoco
    ends = [getattr(mujoco, f"equality_constraint_body{end}").numpy() for end in (1, 2)]
    rows = np.flatnonzero(
        np.isin(mujoco.equality_constraint_type.numpy(), (_CONNECT, WELD)) & (ends[0] != ends[1])
    )
    is_joint = _converted(model, _TO_JOINT)[rows]
    targets = mujoco.equality_constraint_target.numpy()[rows[is_joint]]
    is_joint[is_joint] = model.joint_enabled.numpy()[targets]
    return rows[~is_joint]


def unheard_rows(model: newton.Model, own: np.ndarray) -> np.ndarray:
    """Rows that are enabled, and their joint is not, so that nothing acts.

    Args:
        model: The model.
        own: Rows that have joints of their own.
    """
    rows = np.setdiff1d(lonely_rows(model), own)
    return rows[model.mujoco.equality_constraint_enabled.numpy()[rows]] if rows.size else rows


def moved_rows(model: newton.Model, before: np.ndarray) -> np.ndarray:
    """Rows that are joints, and whose anchor or relpose is no longer as in :func:`places`."""
    return np.flatnonzero(_converted(model, _TO_JOINT) & np.any(places(model) != before, axis=1))


def places(model: newton.Model) -> np.ndarray:
    """Anchor and relpose of each row, shape (rows, 10)."""
    if not row_count(model):
        return np.zeros((0, 10))
    mujoco: Any = model.mujoco
    given = (mujoco.equality_constraint_anchor, mujoco.equality_constraint_relpose)
    return np.hstack([values.numpy() for values in given])


def _own_rows(model: newton.Model) -> np.ndarray:
    """Rows of JOINT constraints that are enabled and no mimic stands for."""
    if not row_count(model):
        return np.zeros(0, dtype=int)
    mujoco: Any = model.mujoco
    is_joint = mujoco.equality_constraint_type.numpy() == _JOINT
    if not is_joint.any():
        return np.zeros(0, dtype=int)
    is_own = (mujoco.equality_constraint_target.numpy() < 0) | _exceeds_mimic(model)
    return np.flatnonzero(is_joint & is_own & mujoco.equality_constraint_enabled.numpy())


def equalities(model: newton.Model) -> list[Equality]:
    """These constraints of a model, or of what a :class:`.setup.solved.SolvedModel` makes of it.

    Left out are those of joints that have no axes of their own, as BALL and FREE.
    """
    rows = _own_rows(model)
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
