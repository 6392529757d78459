# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""CONNECT and WELD constraints of MuJoCo's that give way: those of links that nothing moves.

What the user puts somewhere (a mocap body, kinematic, or fixed to the world by Newton's importer)
can be where the others cannot follow. A rigid row would then ask for more and more, and throw links
about where an arm is nearly straight: with ``solimp`` above 0.999 it does so in MuJoCo, too. So
these rows are as soft as their file says. The law is in :mod:`.step.loop_start`. A row that ties a
link to the world itself is rigid.
"""

from dataclasses import dataclass
from typing import Any

import newton
import numpy as np

from .equalities import joints_of_rows, row_count
from .inertia import mobility_along, reference_moments
from .limits import impedance_rates
from .welds import is_kinematic


@dataclass(frozen=True)
class Yielding:
    """How the joint of a row gives way; MuJoCo's "Solver parameters"."""

    impedance: tuple[float, ...]
    """``eq_solimp``."""
    rates: tuple[float, float]
    """k [1/s^2] and b [1/s] of ``eq_solref``, as :func:`.limits.impedance_rates` has them."""
    turn: float
    """How many radians of turn count as much as a meter: 2 over the row's torquescale."""
    mobility: tuple[float, float]
    """How a unit force and a unit torque accelerate its links in the reference pose [1/kg,
    1/(kg m^2)], as ``body_invweight0``: the mean over all directions, at the COM."""


def yielding_joints(model: newton.Model) -> dict[int, Yielding]:
    """How joints of rows give way, where they do.

    Args:
        model: The user's model, or what the solver makes of it.

    Returns:
        That by joint of a :class:`.setup.joined.JoinedModel`.
    """
    whole = getattr(model, "user_model", model)
    user = getattr(whole, "model", whole)
    if not row_count(user) or not hasattr(user.mujoco, "eq_solimp"):
        return {}
    mujoco: Any = user.mujoco
    ends = np.stack([getattr(mujoco, f"equality_constraint_body{end}").numpy() for end in (1, 2)])
    joints = joints_of_rows(whole)
    is_put = is_kinematic(user)
    if whole is not model:
        is_put |= model.welds.is_static[: is_put.size]
    rows = np.flatnonzero(np.any(np.append(is_put, False)[ends], axis=0) & (joints >= 0))
    if rows.size == 0:
        return {}
    impedance = mujoco.eq_solimp.numpy()[rows].astype(float)
    rates = impedance_rates(mujoco.eq_solref.numpy()[rows].astype(float), impedance)
    scale = np.abs(mujoco.equality_constraint_torquescale.numpy()[rows].astype(float))
    turn = 2.0 / np.where(scale > 0.0, scale, 1.0)
    mobility = np.vstack([_link_mobility(user, is_put), np.zeros(2)])[ends[:, rows]].sum(axis=0)
    return {
        int(joints[row]): Yielding(
            tuple(impedance[k].tolist()),
            (float(rates[k, 0]), float(rates[k, 1])),
            float(turn[k]),
            (float(mobility[k, 0]), float(mobility[k, 1])),
        )
        for k, row in enumerate(rows.tolist())
    }


def _link_mobility(model: newton.Model, is_put: np.ndarray) -> np.ndarray:
    """Mobility of each link as :class:`Yielding` has it; none of what is put somewhere."""
    moments = reference_moments(model, lambda state: state.body_qd.numpy().ravel())
    along = mobility_along(model, moments)[0].reshape(-1, 2, 3).mean(axis=2)
    along[is_put] = 0.0
    return along
