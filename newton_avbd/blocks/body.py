# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""One rigid body as a block of six unknowns: its inertial target and its final pose.

Backward Euler in pose increments: m/h^2 (dx - dx*) = F and R I R^T/h^2 (dtheta - dtheta*) = tau,
with the external forces inside the targets dx* and dtheta*.
"""

import newton
import warp as wp

from ..algebra.so3 import exp_quat, right_jacobian
from ..data import BodyModel

GYRO_ITERATIONS = wp.constant(5)
"""Most Newton iterations of the gyroscopic solve; one does below 0.1 rad a step."""
GYRO_SLOW = wp.constant(2.0e-2)
"""Relative change c of the spin within a step from which a fixed-point step does: it leaves c^2."""
GYRO_TURN = wp.constant(0.25)
"""Turn of a step [rad] up to which: a wobble gains the share turn^4/8 by it."""
GYRO_FINE = wp.constant(1.0e-3)
"""Turn of half a step [rad] from which the midpoint rule is solved further: what is left would add
up to a gain of 3e-3 of the energy in 100 s at 0.07 rad a step."""
GYRO_COARSE = wp.constant(0.1)
"""Likewise up to which: beyond, the series is not exact."""
GYRO_CONTRACTS = wp.constant(0.5)
"""Bound on how much of its error a fixed-point step leaves up to which that is done: for a needle
it is large, and further steps would diverge."""
GYRO_CLOSE = wp.constant(3.0e-3)
"""Turn of a step [rad] times relative residual from which one more iteration does: it leaves about
half of the square."""

KINEMATIC = wp.constant(int(newton.BodyFlags.KINEMATIC))


@wp.func
def is_mobile(model: wp.ref[BodyModel], body: int) -> bool:
    """Whether the solver moves the body: it has mass and is not kinematic."""
    return model.inv_mass[body] > 0.0 and (model.flags[body] & KINEMATIC) == 0


@wp.func
def target_translation(v: wp.vec3, acceleration: wp.vec3, h: float) -> wp.vec3:
    """dx* = h v + h^2 a [m]: where the COM goes without constraints."""
    return h * v + (h * h) * acceleration


@wp.func(inline=True)
def target_spin(inertia: wp.mat33, inv_inertia: wp.mat33, momentum: wp.vec3, h: float) -> wp.vec3:
    """Angular velocity w [rad/s] that keeps the angular momentum over a step, all in body axes.

    Solves I w = exp(-h w) L by Newton's method: the momentum L [N m s] of the start of the step,
    seen from axes that have turned by h w. The implicit form keeps |I w| = |L| and so stays
    bounded at any spin, where the explicit gyroscopic torque blows up.
    """
    spin = inv_inertia * momentum
    # exp(-h w) L to second order
    turned = momentum - h * wp.cross(spin, momentum - (0.5 * h) * wp.cross(spin, momentum))
    w = inv_inertia * turned
    if wp.length_sq(w - spin) <= GYRO_SLOW * GYRO_SLOW * wp.length_sq(spin):
        if h * wp.length(spin) <= GYRO_TURN:
            return w
    w = spin
    momentum_size = wp.length(momentum)
    # the determinant of a millimetre's inertia would underflow
    unit = 1.0 / wp.trace(inertia)
    most = int(GYRO_ITERATIONS)  # not a constant: one copy of the loop's body, not five
    for _ in range(most):
        turned = wp.quat_rotate_inv(exp_quat(h * w), momentum)
        residual = inertia * w - turned
        jacobian = inertia - h * (wp.skew(turned) * right_jacobian(h * w))
        turn = h * wp.length(w)
        w = w - wp.inverse(unit * jacobian) * (unit * residual)
        if turn * wp.length(residual) <= GYRO_CLOSE * momentum_size:
            return w
    # No solution in reach: more than about a turn a step. The mean motion is a turn about the
    # momentum at the rate 2 E / |L|, which keeps the energy, too.
    return wp.dot(spin, wp.normalize(momentum)) * wp.normalize(momentum)


@wp.func
def start_momentum(
    inertia: wp.mat33, rotation: wp.quat, omega: wp.vec3, torque: wp.vec3, h: float
) -> wp.vec3:
    """Angular momentum [N m s] at the start of the step with what the torque adds, body axes."""
    spin = inertia * wp.quat_rotate_inv(rotation, omega)
    return spin + h * wp.quat_rotate_inv(rotation, torque)


@wp.func
def renormalised(q: wp.quat) -> wp.quat:
    """Unit quaternion from one of any length.

    wp.normalize rounds to a mean length above 1, which feeds the angular momentum at each step; a
    correction found in float64 does not.
    """
    excess = wp.float64(-1.0)
    for i in range(4):
        excess += wp.float64(q[i]) * wp.float64(q[i])
    correction = float(wp.float64(-0.5) * excess)
    if wp.abs(correction) > 1.0e-4:
        correction = float(wp.float64(1.0) / wp.sqrt(wp.float64(1.0) + excess) - wp.float64(1.0))
    return q + q * correction


@wp.func(inline=True)
def midpoint_spin(
    inertia: wp.mat33, inv_inertia: wp.mat33, momentum: wp.vec3, half: float
) -> wp.vec3:
    """Angular velocity w [rad/s] of the implicit midpoint rule, in body axes of the start.

    Args:
        inertia: Inertia about the COM, body axes [kg m^2].
        inv_inertia: Its inverse.
        momentum: Angular momentum of the middle, in axes of the start [N m s].
        half: Half of the time step [s].
    """
    w = target_spin(inertia, inv_inertia, momentum, half)
    turn = half * wp.length(w)
    if turn > GYRO_FINE and turn < GYRO_COARSE:
        if half * wp.length(momentum) * wp.trace(inv_inertia) <= GYRO_CONTRACTS:
            for _round in range(2):
                # exp(-half w) L to third order
                a = half * w
                turned = wp.cross(a, momentum - wp.static(1 / 3) * wp.cross(a, momentum))
                w = inv_inertia * (momentum - wp.cross(a, momentum - 0.5 * turned))
    return w


@wp.func
def turn_in_parts(
    inertia: wp.mat33,
    inv_inertia: wp.mat33,
    start: wp.vec3,
    push: wp.vec3,
    h: float,
    parts: int,
) -> wp.quat:
    """Turn of a step in parts, each by the implicit midpoint rule, in body axes of the start.

    So are the momentum ``start`` [N m s] and the torque ``push`` [N m].
    """
    turn = wp.quat_identity()
    each = h / float(parts)
    for i in range(parts):
        momentum = wp.quat_rotate_inv(turn, start + ((float(i) + 0.5) * each) * push)
        w = midpoint_spin(inertia, inv_inertia, momentum, 0.5 * each)
        turn = renormalised(turn * exp_quat(each * w))
    return turn


@wp.func(inline=True)
def free_turn(
    inertia: wp.mat33,
    inv_inertia: wp.mat33,
    rotation: wp.quat,
    omega: wp.vec3,
    torque: wp.vec3,
    h: float,
    parts: int,
):
    """How a body turns with the gyroscopic torque.

    Returns the turn in body axes of its start, and the spin that belongs to the momentum after the
    turn [rad/s] in the body axes of its end: as the body's velocity it keeps the momentum exact.

    Args:
        inertia: Inertia about the COM, body axes [kg m^2].
        inv_inertia: Its inverse.
        rotation: Rotation at the start of the step.
        omega: Angular velocity, world frame [rad/s].
        torque: External torque, world frame [N m].
        h: Time step [s].
        parts: In how many parts by the implicit midpoint rule; 0 for backward Euler.
    """
    start = inertia * wp.quat_rotate_inv(rotation, omega)
    push = wp.quat_rotate_inv(rotation, torque)
    end = start + h * push
    turn = wp.quat_identity()
    if parts > 1:
        turn = turn_in_parts(inertia, inv_inertia, start, push, h, parts)
    elif parts == 1:
        half = 0.5 * h
        turn = exp_quat(h * midpoint_spin(inertia, inv_inertia, start + half * push, half))
    else:
        turn = exp_quat(h * target_spin(inertia, inv_inertia, end, h))
    return turn, inv_inertia * wp.quat_rotate_inv(turn, end)


@wp.func
def turned(pose: wp.transform, increment: wp.spatial_vector) -> wp.quat:
    """Orientation after the increment (dx, dtheta)."""
    turn = exp_quat(wp.spatial_bottom(increment))
    return renormalised(turn * wp.transform_get_rotation(pose))


@wp.func
def needle_roll(dtheta: wp.vec3, inv_inertia: wp.mat33) -> wp.vec3:
    """Part of a turn dtheta [rad] about the long axis of a needle.

    (I^-1 / tr I^-1)^8 dtheta: all of it at principal moments 1:1000 and beyond, half of it at 1:20,
    a twentieth for a plank of 6:3:1. For a sphere it is along dtheta and changes nothing.

    Args:
        dtheta: Rotation vector [rad], world frame.
        inv_inertia: Inverse of the inertia tensor, world frame [1/(kg m^2)].
    """
    share = (1.0 / wp.trace(inv_inertia)) * inv_inertia
    share = share * share
    share = share * share
    share = share * share
    return share * dtheta


@wp.func
def rolled(pose: wp.transform, increment: wp.spatial_vector, inv_inertia: wp.mat33) -> wp.quat:
    """Orientation after the increment, where contacts have made it (dx, dtheta).

    Their slip dx + dtheta x r is linear in the turn. A needle that friction rolls by a radian about
    its long axis while it tilts would tilt elsewhere by exp(dtheta); its ends, where contacts are,
    do as linearised if it rolls first.
    """
    dtheta = wp.spatial_bottom(increment)
    roll = needle_roll(dtheta, inv_inertia)
    turn = exp_quat(dtheta - roll) * exp_quat(roll)
    return renormalised(turn * wp.transform_get_rotation(pose))


@wp.func
def carried_roll(dtheta: wp.vec3, inv_inertia: wp.mat33) -> wp.vec3:
    """By how much the roll of :func:`rolled` changes as its axis tilts [rad]."""
    roll = needle_roll(dtheta, inv_inertia)
    return wp.quat_rotate(exp_quat(dtheta - roll), roll) - roll


@wp.func
def origin_shift(
    pose: wp.transform, com: wp.vec3, increment: wp.spatial_vector, rotation: wp.quat
) -> wp.vec3:
    """How far the increment of its COM moves the origin of a body [m]; ``rotation`` is after it."""
    shift = wp.spatial_top(increment)
    if wp.length_sq(com) > 0.0:
        shift += wp.quat_rotate(wp.transform_get_rotation(pose), com)
        shift -= wp.quat_rotate(rotation, com)
    return shift
