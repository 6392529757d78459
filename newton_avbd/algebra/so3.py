# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations by rotation vectors [rad], the unknowns of a body's orientation."""

import warp as wp


@wp.func
def exp_quat(theta: wp.vec3) -> wp.quat:
    """Unit quaternion of the rotation vector theta [rad]: exp(theta)."""
    x2 = 0.25 * wp.dot(theta, theta)
    # sin(x)/x and cos(x) of the half angle x; below 0.5 their series is exact in float32
    s = 1.0 - x2 / 6.0 * (1.0 - x2 / 20.0 * (1.0 - x2 / 42.0))
    c = 1.0 - x2 / 2.0 * (1.0 - x2 / 12.0 * (1.0 - x2 / 30.0 * (1.0 - x2 / 56.0)))
    if x2 > 0.25:
        x = wp.sqrt(x2)
        s = wp.sin(x) / x
        c = wp.cos(x)
    return wp.quat(0.5 * s * theta[0], 0.5 * s * theta[1], 0.5 * s * theta[2], c)


@wp.func
def right_jacobian(theta: wp.vec3) -> wp.mat33:
    """Right Jacobian of SO(3): d exp(theta) = exp(theta) [J_r dtheta].

    Source: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", eq. 143.
    """
    a2 = wp.dot(theta, theta)
    b = 0.5 - a2 / 24.0 * (1.0 - a2 / 30.0 * (1.0 - a2 / 56.0))
    c = 1.0 / 6.0 - a2 / 120.0 * (1.0 - a2 / 42.0 * (1.0 - a2 / 72.0))
    if a2 > 1.0:
        a = wp.sqrt(a2)
        b = (1.0 - wp.cos(a)) / a2
        c = (a - wp.sin(a)) / (a2 * a)
    skew = wp.skew(theta)
    return wp.identity(n=3, dtype=float) - b * skew + c * (skew * skew)


@wp.func
def world_inertia(rotation: wp.quat, inertia: wp.mat33) -> wp.mat33:
    """Inertia tensor [kg m^2] turned from body to world axes: R I R^T."""
    r = wp.quat_to_matrix(rotation)
    return r * inertia * wp.transpose(r)
