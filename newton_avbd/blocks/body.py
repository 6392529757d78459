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
GYRO_CLOSE = wp.constant(3.0e-2)
"""Relative residual r from which one more iteration does: it leaves about (h |w| r)^2 / 2."""

KINEMATIC = wp.constant(int(newton.BodyFlags.KINEMATIC))


@wp.func
def is_mobile(model: BodyModel, body: int) -> bool:
    """Whether the solver moves the body: it has mass and is not kinematic."""
    return model.inv_mass[body] > 0.0 and (model.flags[body] & KINEMATIC) == 0


@wp.func
def target_translation(v: wp.vec3, acceleration: wp.vec3, h: float) -> wp.vec3:
    """dx* = h v + h^2 a [m]: where the COM goes without constraints."""
    return h * v + (h * h) * acceleration


@wp.func
def target_spin(inertia: wp.mat33, inv_inertia: wp.mat33, momentum: wp.vec3, h: float) -> wp.vec3:
    """Angular velocity w [rad/s] that keeps the angular momentum over a step, all in body axes.

    Solves I w = exp(-h w) L by Newton's method: the momentum L [N m s] of the start of the step,
    seen from axes that have turned by h w. The implicit form keeps |I w| = |L| and so stays
    bounded at any spin, where the explicit gyroscopic torque blows up.
    """
    spin = inv_inertia * momentum
    w = spin
    scale = wp.dot(momentum, momentum)
    # the determinant of a millimetre's inertia would underflow
    unit = 1.0 / wp.trace(inertia)
    most = int(GYRO_ITERATIONS)  # not a constant: one copy of the loop's body, not five
    for _ in range(most):
        turned = wp.quat_rotate_inv(exp_quat(h * w), momentum)
        residual = inertia * w - turned
        jacobian = inertia - h * (wp.skew(turned) * right_jacobian(h * w))
        w = w - wp.inverse(unit * jacobian) * (unit * residual)
        if wp.dot(residual, residual) <= GYRO_CLOSE * GYRO_CLOSE * scale:
            return w
    # No solution in reach: more than about a turn a step. The mean motion is a turn about the
    # momentum at the rate 2 E / |L|, which keeps the energy, too.
    return wp.dot(spin, wp.normalize(momentum)) * wp.normalize(momentum)


@wp.func
def free_rotation(
    inertia: wp.mat33,
    inv_inertia: wp.mat33,
    rotation: wp.quat,
    omega: wp.vec3,
    torque: wp.vec3,
    h: float,
):
    """dtheta* [rad] with the gyroscopic torque, and what of the spin it leaves out [rad/s].

    The spin belonging to the momentum after the turn is dtheta*/h plus a remainder that vanishes
    as the solve converges; handing the remainder to the velocity keeps the momentum exact.

    Args:
        inertia: Inertia about the COM, body axes [kg m^2].
        inv_inertia: Its inverse.
        rotation: Orientation at the start of the step.
        omega: Angular velocity, world frame [rad/s].
        torque: External torque, world frame [N m].
        h: Time step [s].
    """
    momentum = inertia * wp.quat_rotate_inv(rotation, omega) + h * wp.quat_rotate_inv(
        rotation, torque
    )
    w = target_spin(inertia, inv_inertia, momentum, h)
    kept = inv_inertia * wp.quat_rotate_inv(exp_quat(h * w), momentum)
    return h * wp.quat_rotate(rotation, w), wp.quat_rotate(rotation, kept - w)


@wp.func
def renormalised(q: wp.quat) -> wp.quat:
    """Unit quaternion from one that is a few roundings off.

    wp.normalize rounds to a mean length above 1, which feeds the angular momentum at each step; the
    residual of the length needs float64.
    """
    excess = wp.float64(-1.0)
    for i in range(4):
        excess += wp.float64(q[i]) * wp.float64(q[i])
    return q - q * float(wp.float64(0.5) * excess)


@wp.func
def moved_pose(pose: wp.transform, com: wp.vec3, increment: wp.spatial_vector) -> wp.transform:
    """Pose of the body origin after the increment (dx, dtheta) of its COM."""
    r0 = wp.transform_get_rotation(pose)
    r1 = renormalised(exp_quat(wp.spatial_bottom(increment)) * wp.normalize(r0))
    shift = wp.quat_rotate(r0, com) - wp.quat_rotate(r1, com)
    return wp.transform(wp.transform_get_translation(pose) + wp.spatial_top(increment) + shift, r1)
