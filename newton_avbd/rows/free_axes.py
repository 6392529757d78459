# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Where the free axes of a joint point, and what a generalized force along one of them turns."""

import functools

import warp as wp

from ..data import JointModel
from ..functions import Functions, together
from .euler import make_euler
from .joint import BALL, ROD, JointKinds, is_skew, linear_axis, make_counts

LEAST_SPREAD = wp.constant(1.0e-6)
"""Share by which rates of the outer axes of a gimbal count as error beside the spin that they miss:
rounding of the axes makes none of more than 350 times the spin."""

LOOP_SPREAD = wp.constant(1.0e-3)
"""Likewise for torques of joints outside of trees: they grow to 16 times what turns the axis."""


@wp.func
def across_first(axis: wp.vec3, first: wp.vec3) -> float:
    """Share of the inertia about an angular axis that is its own, square to the first one.

    In exact arithmetic no coordinate meets less than that share of what turns the body itself. An
    axis that is parallel to the first has next to none, and not zero, by which it is divided.
    """
    along = wp.dot(axis, first)
    return wp.max(1.0 - along * along, 0.0) + 1.0e-6


@functools.cache
def make_free_axes(kinds: JointKinds) -> Functions:
    """Device functions: the angular axes of joints, and the directions of forces along axes."""
    counts = make_counts(kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_gimbal = counts.is_gimbal
    middle_axis = make_euler(kinds).middle_axis

    @wp.func
    def angular_axis(
        joints: wp.ref[JointModel], joint: int, dof: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """World frame's axis of angular coordinate ``dof``, counted from the first angular one.

        ``known`` are the :func:`known_angles`.
        """
        if wp.static(kinds.balls):
            kind = joints.type[joint]
            if kind == BALL or kind == ROD:
                unit = wp.vec3(0.0)
                unit[dof] = 1.0
                return wp.quat_rotate(q_p, unit)
        axis = joints.axis[joints.dof_start[joint] + linear_count(joints, joint) + dof]
        if wp.static(kinds.euler):
            if dof > 0:
                if dof == angular_count(joints, joint) - 1:
                    return wp.quat_rotate(q_c, axis)
                return middle_axis(joints, joint, q_p, q_c, known)
        return wp.quat_rotate(q_p, axis)

    @wp.func
    def torque_axis(
        joints: wp.ref[JointModel],
        joint: int,
        dof: int,
        q_p: wp.quat,
        q_c: wp.quat,
        known: wp.vec3,
        least: float,
    ) -> wp.vec3:
        """World frame's torque of a unit generalized force along angular coordinate ``dof``.

        By it a spin has the rate of the coordinate. The first and the last Euler axis are not
        square to each other, and at the pole both rates are undetermined: least squares leave the
        two the least rates, where a rate counts ``least`` beside the spin that it misses.
        """
        axis = angular_axis(joints, joint, dof, q_p, q_c, known)
        if wp.static(kinds.skew):
            if is_gimbal(joints, joint):
                if is_skew(joints, joints.dof_start[joint] + linear_count(joints, joint)):
                    second = angular_axis(joints, joint, (dof + 1) % 3, q_p, q_c, known)
                    third = angular_axis(joints, joint, (dof + 2) % 3, q_p, q_c, known)
                    across = wp.cross(second, third)
                    volume = wp.dot(axis, across)
                    return (volume / (volume * volume + least)) * across
        if wp.static(kinds.oblique):
            if angular_count(joints, joint) == 2:
                other = angular_axis(joints, joint, 1 - dof, q_p, q_c, known)
                along = wp.dot(axis, other)
                return (axis - along * other) / wp.length_sq(wp.cross(axis, other))
        if wp.static(kinds.gimbals):
            if dof != 1 and is_gimbal(joints, joint):
                other = angular_axis(joints, joint, 2 - dof, q_p, q_c, known)
                along = wp.dot(axis, other)
                spread = wp.length_sq(wp.cross(axis, other)) + least * (2.0 + least)
                return ((1.0 + least) * axis - along * other) / spread
        return axis

    @wp.func
    def axis_of(
        joints: wp.ref[JointModel], joint: int, dof: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """World axis along which a generalized force of a degree of freedom pushes or turns."""
        linear = linear_count(joints, joint)
        if dof < linear:
            return linear_axis(joints, joint, dof, q_p)
        return torque_axis(joints, joint, dof - linear, q_p, q_c, known, LOOP_SPREAD)

    return together(angular_axis, torque_axis, axis_of)
