# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations by rotation vectors [rad], the unknowns of a body's orientation."""

import math

import warp as wp


@wp.func
def exp_quat(theta: wp.vec3) -> wp.quat:
    """Unit quaternion of the rotation vector theta [rad]: exp(theta)."""
    x2 = 0.25 * wp.dot(theta, theta)
    # sin(x)/x and cos(x) of the half angle x; below 0.5 their series is exact in float32
    s = 1.0 - x2 * (wp.static(1 / 6) - x2 * (wp.static(1 / 120) - x2 * wp.static(1 / 5040)))
    c = 1.0 - x2 * (
        0.5 - x2 * (wp.static(1 / 24) - x2 * (wp.static(1 / 720) - x2 * wp.static(1 / 40320)))
    )
    if x2 > 0.25:
        x = wp.sqrt(x2)
        s = wp.sin(x) / x
        c = wp.cos(x)
    return wp.quat(0.5 * s * theta[0], 0.5 * s * theta[1], 0.5 * s * theta[2], c)


@wp.func
def angle_of(sine: float, cosine: float) -> float:
    """atan2(sine, cosine) [rad] to the rounding of float32, without a call of the C library.

    Between 0 and 45 degrees by a polynomial, which is off by 2.4e-9 of the angle: least squares,
    reweighted until its error was level.
    """
    s = wp.abs(sine)
    c = wp.abs(cosine)
    t = wp.min(s, c) / wp.max(wp.max(s, c), 1.0e-30)
    x = t * t
    high = 0.0575519017 + x * (-0.0308043984 + x * (0.0107268377 - x * 0.00175390647))
    low = 0.19998266 + x * (-0.142619323 + x * (0.109420266 + x * (-0.083773037 + x * high)))
    angle = t + t * (x * (-0.333332836 + x * low))
    if s > c:
        angle = wp.static(0.5 * math.pi) - angle
    if cosine < 0.0:
        angle = wp.static(math.pi) - angle
    return wp.where(sine < 0.0, -angle, angle)


@wp.func
def turned_from(q: wp.quat, arm: wp.vec3) -> wp.vec3:
    """By how much a turn ``q`` that led to an arm [m] has moved its end: arm - q^-1 arm q.

    Of a small turn nothing is lost, as it is where two arms are subtracted.
    """
    axis = wp.vec3(q[0], q[1], q[2])
    across = wp.cross(axis, arm)
    return 2.0 * (q[3] * across - wp.cross(axis, across))


@wp.func
def turned_by(q: wp.quat, arm: wp.vec3) -> wp.vec3:
    """By how much a turn ``q`` moves the end of an arm [m]: q arm q^-1 - arm; see above."""
    return -turned_from(wp.quat_inverse(q), arm)


@wp.func
def right_jacobian(theta: wp.vec3) -> wp.mat33:
    """Right Jacobian of SO(3): d exp(theta) = exp(theta) [J_r dtheta].

    Source: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", eq. 143.
    """
    a2 = wp.dot(theta, theta)
    b = 0.5 - a2 * (wp.static(1 / 24) - a2 * (wp.static(1 / 720) - a2 * wp.static(1 / 40320)))
    c = wp.static(1 / 6) - a2 * (
        wp.static(1 / 120) - a2 * (wp.static(1 / 5040) - a2 * wp.static(1 / 362880))
    )
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


@wp.func
def turned_inertia(rotation: wp.quat, inertia: wp.mat33, v: wp.vec3) -> wp.vec3:
    """R I R^T v, for less than the matrix of :func:`world_inertia` costs."""
    return wp.quat_rotate(rotation, inertia * wp.quat_rotate_inv(rotation, v))


@wp.func
def rotation_vector(q: wp.quat) -> wp.vec3:
    """Rotation vector of a unit quaternion [rad], of length up to pi."""
    v = wp.vec3(q[0], q[1], q[2])
    w = q[3]
    if w < 0.0:
        v = -v
        w = -w
    sine = wp.length(v)
    if sine < 1.0e-3:
        # atan2(s, w)/s to third order
        return (2.0 + wp.static(1 / 3) * sine * sine) * v
    return (2.0 * angle_of(sine, w) / sine) * v


@wp.func
def rotation_between(a: wp.quat, b: wp.quat) -> wp.vec3:
    """Rotation vector [rad] of the turn from ``a`` to ``b``, unit quaternions; 0 from a to a.

    The vector of b a^-1 is that of (b - a) a^-1, of which nothing cancels where the turn is small.
    """
    c = wp.dot(a, b)
    end = wp.where(c < 0.0, -b, b)
    turn = (end - a) * wp.quat_inverse(a)
    return rotation_vector(wp.quat(turn[0], turn[1], turn[2], wp.abs(c)))
