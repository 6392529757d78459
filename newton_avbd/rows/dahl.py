# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Dahl friction of a rod: hysteresis of its bends and its twist, as SolverVBD has it.

Along each of the three angles kappa [rad] a torque sigma follows the way that the angle goes,

    d sigma / d kappa = (sigma_max - sigma s) / tau,  s = sign(d kappa),

with sigma_max = eps_max ke (Dahl, "A solid friction model", 1968). Over a step the solution is in
closed form, sigma = s sigma_max + (sigma_0 - s sigma_max) exp(-|kappa - kappa_0| / tau).
"""

import math

import warp as wp

from ..data import History, JointModel

UNKNOWN = wp.constant(math.inf)
"""Angle at the end of the last step where there was none."""
SMALL = wp.constant(0.03)
"""Argument below which a series is exact in float32 and a difference is not."""


@wp.func
def rising(x: float) -> float:
    """(1 - exp(-x)) / x for x of at least zero."""
    if x < SMALL:
        return 1.0 - x * (0.5 - x * (wp.static(1 / 6) - x * wp.static(1 / 24)))
    return (1.0 - wp.exp(-x)) / x


@wp.func
def dahl_slope(sigma: float, change: float, most: float, tau: float) -> float:
    """Slope of the chord of the torque over a change of the angle [N m/rad].

    Args:
        sigma: Torque at the start of the step [N m].
        change: Change of the angle in the step [rad].
        most: Torque that it tends to [N m].
        tau: Angle over which it does [rad].
    """
    side = wp.where(change < 0.0, -1.0, 1.0)
    return wp.max(most - side * sigma, 0.0) * rising(wp.abs(change) / tau) / tau


@wp.func
def change_of(start: float, q: float, moved: float) -> float:
    """Change of an angle since the last step; in the first one, since its start [rad]."""
    return wp.where(wp.isinf(start), moved, q - start)


@wp.func
def dahl_response(
    joint: int,
    dof: int,
    q: float,
    moved: float,
    joints: wp.ref[JointModel],
    history: wp.ref[History],
):
    """Torque along angle ``dof`` of a rod [N m], its slope, and the steepest that it may be.

    Takes the coordinate and how far it has moved in the step [rad].
    """
    most = joints.target_ke[joints.dof_start[joint] + 3 + dof] * joints.dahl_eps_max[joint]
    tau = joints.dahl_tau[joint]
    if most <= 0.0 or tau <= 0.0:
        return 0.0, 0.0, 0.0
    sigma = history.dahl_sigma[joint]
    start = history.dahl_kappa[joint]
    change = change_of(start[dof], q, moved)
    slope = dahl_slope(sigma[dof], change, most, tau)
    return -sigma[dof] - slope * change, slope, (most + wp.abs(sigma[dof])) / tau


@wp.func
def keep_dahl(
    joint: int,
    first: int,
    coordinate: wp.array[wp.float64],
    start_coordinate: wp.array[wp.float64],
    joints: wp.ref[JointModel],
    history: wp.ref[History],
):
    """Keeps torques and angles of a rod at the end of a step; its bends are at ``first``."""
    if not joints.enabled[joint]:
        forget_dahl(joint, history)
        return
    sigma = wp.vec3(0.0)
    kappa = wp.vec3(0.0)
    for dof in range(3):
        q = coordinate[first + dof]
        moved = wp.float32(q - start_coordinate[first + dof])
        torque, _slope, _most = dahl_response(joint, dof, wp.float32(q), moved, joints, history)
        sigma[dof] = -torque
        kappa[dof] = wp.float32(q)
    history.dahl_sigma[joint] = sigma
    history.dahl_kappa[joint] = kappa


@wp.func
def forget_dahl(joint: int, history: wp.ref[History]):
    """Takes a rod to have been bent by nothing so far."""
    history.dahl_sigma[joint] = wp.vec3(0.0)
    history.dahl_kappa[joint] = wp.vec3(UNKNOWN)
