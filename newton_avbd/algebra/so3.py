# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations by rotation vectors [rad], the unknowns of a body's orientation."""

import warp as wp


@wp.func
def exp_quat(theta: wp.vec3) -> wp.quat:
    """Unit quaternion of the rotation vector theta [rad]: exp(theta)."""
    half = 0.5 * wp.length(theta)
    # sin(x)/x by its series where the quotient would lose digits
    s = 0.5 * (1.0 - half * half / 6.0)
    if half > 1.0e-2:
        s = 0.5 * wp.sin(half) / half
    return wp.quat(s * theta[0], s * theta[1], s * theta[2], wp.cos(half))


@wp.func
def right_jacobian(theta: wp.vec3) -> wp.mat33:
    """Right Jacobian of SO(3): d exp(theta) = exp(theta) [J_r dtheta].

    Source: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", eq. 143.
    """
    angle2 = wp.dot(theta, theta)
    b = 0.5 - angle2 / 24.0
    c = 1.0 / 6.0 - angle2 / 120.0
    if angle2 > 1.0e-2:
        angle = wp.sqrt(angle2)
        b = (1.0 - wp.cos(angle)) / angle2
        c = (angle - wp.sin(angle)) / (angle2 * angle)
    skew = wp.skew(theta)
    return wp.identity(n=3, dtype=float) - b * skew + c * (skew * skew)


@wp.func
def world_inertia(rotation: wp.quat, inertia: wp.mat33) -> wp.mat33:
    """Inertia tensor [kg m^2] turned from body to world axes: R I R^T."""
    r = wp.quat_to_matrix(rotation)
    return r * inertia * wp.transpose(r)
