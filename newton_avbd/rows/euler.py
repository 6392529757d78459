# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints of two or three angular axes: Euler angles, whose axes carry each other.

Those of a gimbal, which has three, are known from step to step: a pose has two solutions, and at
the pole, where the first and the last axis are parallel, more.
"""

import functools
import math

import warp as wp

from ..algebra.so3 import rotation_vector
from ..data import JointModel
from ..functions import Functions, together
from .angle import reduced, wrapped
from .joint import SKEW, JointKinds, is_skew, make_counts

NEAR_POLE = wp.constant(4.0e-2)
"""Square of the cosine of the middle angle below which a gimbal is near its pole, where its first
and last axis are nearly parallel: within 0.2 rad of a right angle."""
POLE = wp.constant(4.0e-4)
"""Square of the cosine below which the pose of a gimbal that is not solved with a tree is not asked
how the two turn against each other: 0.02 rad."""


@wp.func
def is_near_pole(middle: float) -> bool:
    """Whether a gimbal of this middle angle [rad] is near its pole."""
    cosine = wp.cos(middle)
    return cosine * cosine < NEAR_POLE


@wp.func
def nearest_angles(found: wp.vec3, known: wp.vec3, parallel: float, is_carried: bool) -> wp.vec3:
    """Angles of a gimbal that the pose allows, those nearest to the known ones [rad].

    A pose has two solutions: (a, b, c) and (a + pi, pi - b, c + pi). At the pole, where the middle
    angle is a right one, it tells the sum of the outer angles (their difference where the axes are
    opposite) and nothing else. What they turn against each other is then that of the known angles,
    and blends into that of the pose on the way out, so that no angle ever jumps.

    Args:
        found: A solution, with the middle angle within a right one.
        known: Angles to be near to.
        parallel: Above zero where the first and the last axis point alike, below where opposite.
        is_carried: Whether the known angles already have what the axes turned. Then the pose is
            asked from far enough from the pole on only, for that is what it follows.
    """
    other = other_solution(found)
    a = found - known
    b = other - known
    for i in range(3):
        a[i] = wrapped(a[i])
        b[i] = wrapped(b[i])
    cosine = wp.cos(found[1])
    beside = cosine * cosine
    if beside < NEAR_POLE:
        side = wp.where(parallel < 0.0, -1.0, 1.0)
        pole = wp.where(found[1] < 0.0, wp.static(-0.5 * math.pi), wp.static(0.5 * math.pi))
        ahead = found[1] - pole
        both = wrapped(a[0] + side * a[2])
        against = wrapped(a[0] - side * a[2])
        if wp.length_sq(b) < wp.length_sq(a):
            ahead = -ahead
            both = wrapped(b[0] + side * b[2])
            against = wrapped(b[0] - side * b[2])
        share = beside / (beside + POLE * (1.0 - beside / NEAR_POLE))
        if is_carried:
            share = wp.max(2.0 * beside / NEAR_POLE - 1.0, 0.0)
        left = (1.0 - share) * against
        against -= left
        # the azimuth about the pole is off by half of what is left
        middle = pole + ahead * wp.cos(0.5 * left)
        return known + wp.vec3(
            0.5 * (both + against), wrapped(middle - known[1]), 0.5 * side * (both - against)
        )
    if wp.length_sq(b) < wp.length_sq(a):
        return known + b
    return known + a


@wp.func
def other_solution(angles: wp.vec3) -> wp.vec3:
    """The other angles of a gimbal that have its child in the same pose, in [-pi, pi] [rad]."""
    half = wp.static(math.pi)
    return wp.vec3(wrapped(angles[0] + half), wrapped(half - angles[1]), wrapped(angles[2] + half))


@wp.func
def beyond_limits(joints: wp.ref[JointModel], first: int, angles: wp.vec3) -> float:
    """How far angles are beyond the limits of the degrees of freedom from ``first`` on [rad]."""
    lower = wp.vec3(
        joints.limit_lower[first], joints.limit_lower[first + 1], joints.limit_lower[first + 2]
    )
    upper = wp.vec3(
        joints.limit_upper[first], joints.limit_upper[first + 1], joints.limit_upper[first + 2]
    )
    return wp.max(wp.max(wp.max(lower - angles), wp.max(angles - upper)), 0.0)


@functools.cache
def make_euler(kinds: JointKinds) -> Functions:
    """Device functions: the Euler axes of a joint, and the angles that a gimbal keeps."""
    counts = make_counts(kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_gimbal = counts.is_gimbal

    @wp.func
    def euler_axes(joints: wp.ref[JointModel], joint: int):
        """The three axes of a joint with two or three angular axes, in the parent anchor frame.

        With two, the locked rotation is the middle one, as in Newton.
        """
        first = joints.dof_start[joint] + linear_count(joints, joint)
        a0 = joints.axis[first]
        a1 = joints.axis[first + 1]
        if angular_count(joints, joint) == 2:
            return a0, wp.cross(a0, a1), a1
        return a0, a1, joints.axis[first + 2]

    @wp.func(inline=False)
    def euler_middle(joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat):
        """Sine of the middle Euler angle of a joint with two or three axes, and its axis."""
        a0, a1, a2 = euler_axes(joints, joint)
        first = wp.quat_rotate(q_p, a0)
        last = wp.quat_rotate(q_c, a2)
        # The middle axis is square to both; the angle is how far the last leaves the plane
        # across the first.
        middle = wp.cross(last, first)
        if wp.dot(wp.cross(a2, a0), a1) < 0.0:
            middle = -middle
        if wp.length_sq(middle) < 1.0e-8:
            middle = wp.quat_rotate(q_p, a1)
        middle = wp.normalize(middle)
        sine = wp.dot(first, last)
        if wp.dot(wp.cross(a0, a1), a2) < 0.0:
            sine = -sine
        return wp.clamp(sine, -1.0, 1.0), middle

    @wp.func(inline=False)
    def middle_axis(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """Middle Euler axis; of a gimbal as its ``known`` angles have it [rad], since the pose has
        two solutions, and at the pole more."""
        if wp.static(kinds.gimbals):
            if angular_count(joints, joint) == 3:
                if is_led(joints, joint, known):
                    a0, a1, _last = euler_axes(joints, joint)
                    return wp.quat_rotate(q_p * wp.quat_from_axis_angle(a0, known[0]), a1)
        _sine, middle = euler_middle(joints, joint, q_p, q_c)
        if wp.static(kinds.gimbals):
            if angular_count(joints, joint) == 3 and wp.cos(known[1]) < 0.0:
                middle = -middle
        return middle

    @wp.func
    def is_led(joints: wp.ref[JointModel], joint: int, known: wp.vec3) -> bool:
        """Whether the angles of a gimbal lead its pose: near the pole, or with skew axes."""
        if wp.static(kinds.skew):
            if is_skew(joints, joints.dof_start[joint] + linear_count(joints, joint)):
                return True
        return is_near_pole(known[1])

    @wp.func
    def known_angles(
        joints: wp.ref[JointModel], joint: int, values: wp.array[wp.float64], first: int
    ) -> wp.vec3:
        """Angles of a gimbal less whole revolutions [rad], by coordinates of its joint.

        They stand from ``first`` on.
        """
        if wp.static(kinds.gimbals):
            if is_gimbal(joints, joint):
                k = first + linear_count(joints, joint)
                return wp.vec3(reduced(values[k]), reduced(values[k + 1]), reduced(values[k + 2]))
        return wp.vec3(0.0)

    @wp.func(inline=False)
    def gimbal_tilt(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """Turn of the child [rad], world frame, beyond where the angles of a gimbal have it.

        Near its pole a gimbal locks the turn square to its axes as a hinge does. Elsewhere the
        angles follow the pose (but for skew axes).
        """
        if not is_led(joints, joint, known):
            return wp.vec3(0.0)
        a0, a1, a2 = euler_axes(joints, joint)
        turn = wp.quat_from_axis_angle(a0, known[0]) * wp.quat_from_axis_angle(a1, known[1])
        turn = q_p * turn * wp.quat_from_axis_angle(a2, known[2])
        return rotation_vector(q_c * wp.quat_inverse(turn))

    @wp.func(inline=False)
    def chain_angles(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """Angles of a chain of three hinges whose axes are not square to each other [rad].

        By Newton's method from the known ones, damped where the axes lie in a plane.
        """
        a0, a1, a2 = euler_axes(joints, joint)
        pose = wp.quat_inverse(q_p) * q_c
        out = wp.vec3(known)
        for _i in range(4):
            first = wp.quat_from_axis_angle(a0, out[0])
            second = first * wp.quat_from_axis_angle(a1, out[1])
            turn = second * wp.quat_from_axis_angle(a2, out[2])
            left = rotation_vector(pose * wp.quat_inverse(turn))
            axes = wp.matrix_from_cols(a0, wp.quat_rotate(first, a1), wp.quat_rotate(second, a2))
            square = axes * wp.transpose(axes) + wp.diag(wp.vec3(SKEW))
            out += wp.transpose(axes) * (wp.inverse(square) * left)
        return out

    return together(
        euler_axes, euler_middle, middle_axis, is_led, known_angles, gimbal_tilt, chain_angles
    )
