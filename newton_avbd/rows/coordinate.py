# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Coordinates of a joint along its free axes, by where its anchors are, and their velocities."""

import functools

import warp as wp

from ..algebra.so3 import angle_of
from ..data import JointModel
from ..functions import Functions, together
from .angle import counted, turn_about, wrapped
from .euler import make_euler, nearest_angles
from .free_axes import LEAST_SPREAD, make_free_axes
from .joint import BALL, ROD, JointKinds, is_skew, linear_axis, make_counts
from .rod import rod_turn


@functools.cache
def make_joint_coordinates(kinds: JointKinds) -> Functions:
    """Device functions: coordinates of joints, their velocities, and how far a turn takes one."""
    counts = make_counts(kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    euler = make_euler(kinds)
    euler_axes, euler_middle, chain_angles = (
        euler.euler_axes,
        euler.euler_middle,
        euler.chain_angles,
    )
    torque_axis = make_free_axes(kinds).torque_axis

    @wp.func
    def angles(
        joints: wp.ref[JointModel],
        joint: int,
        q_p: wp.quat,
        q_c: wp.quat,
        known: wp.vec3,
        is_carried: bool,
    ) -> wp.vec3:
        """Coordinates of the angular axes of a joint, less whole turns [rad]; zero of a ball.

        Those of a gimbal are the :func:`nearest_angles` to the ``known`` ones.
        """
        free = angular_count(joints, joint)
        if free == 0:
            return wp.vec3(0.0)
        if wp.static(kinds.balls):
            if joints.type[joint] == BALL:
                return wp.vec3(0.0)
        if wp.static(kinds.rods):
            if joints.type[joint] == ROD:
                return rod_turn(joints, joint, q_p, q_c)
        if wp.static(kinds.skew):
            if free == 3:
                if is_skew(joints, joints.dof_start[joint] + linear_count(joints, joint)):
                    return chain_angles(joints, joint, q_p, q_c, known)
        if wp.static(kinds.euler):
            if free > 1:
                sine, middle = euler_middle(joints, joint, q_p, q_c)
                a0, a1, a2 = euler_axes(joints, joint)
                first = turn_about(wp.quat_rotate(q_p, a0), wp.quat_rotate(q_p, a1), middle)
                last = turn_about(wp.quat_rotate(q_c, a2), middle, wp.quat_rotate(q_c, a1))
                if free == 2:
                    return wp.vec3(first, last, 0.0)
                if wp.static(kinds.gimbals):
                    parallel = wp.dot(wp.quat_rotate(q_p, a0), wp.quat_rotate(q_c, a2))
                    across = wp.cross(wp.quat_rotate(q_p, a0), wp.quat_rotate(q_c, a2))
                    found = wp.vec3(first, angle_of(sine, wp.length(across)), last)
                    return nearest_angles(found, known, parallel, is_carried)
        axis = joints.axis[joints.dof_start[joint] + linear_count(joints, joint)]
        q = wp.quat_inverse(q_p) * q_c
        half = angle_of(wp.dot(wp.vec3(q[0], q[1], q[2]), axis), q[3])
        return wp.vec3(wrapped(2.0 * half), 0.0, 0.0)

    @wp.func
    def coordinate(
        joints: wp.ref[JointModel],
        joint: int,
        dof: int,
        q_p: wp.quat,
        turns: wp.vec3,
        offset: wp.vec3,
        known: wp.float64,
    ) -> wp.float64:
        """Coordinate of a degree of freedom [m or rad]; zero for a ball.

        ``turns`` are the joint's :func:`angles`; ``offset`` leads from the parent anchor to the
        child anchor. An angle is the one nearest to the ``known`` one, so that turns are counted.
        """
        linear = linear_count(joints, joint)
        if dof < linear:
            return wp.float64(wp.dot(linear_axis(joints, joint, dof, q_p), offset))
        if joints.type[joint] == BALL:
            return wp.float64(0.0)
        return counted(turns[dof - linear], known)

    @wp.func
    def velocity(
        joints: wp.ref[JointModel],
        joint: int,
        dof: int,
        q_p: wp.quat,
        q_c: wp.quat,
        known: wp.vec3,
        relative: wp.spatial_vector,
    ) -> float:
        """Velocity of a degree of freedom [m/s or rad/s].

        ``relative`` is the velocity of the child anchor against the parent, world frame; ``known``
        are the :func:`known_angles`.
        """
        linear = linear_count(joints, joint)
        if dof < linear:
            return wp.dot(linear_axis(joints, joint, dof, q_p), wp.spatial_top(relative))
        spin = wp.spatial_bottom(relative)
        axis = torque_axis(joints, joint, dof - linear, q_p, q_c, known, LEAST_SPREAD)
        return wp.dot(axis, spin)

    @wp.func
    def advance(
        joints: wp.ref[JointModel],
        joint: int,
        dof: int,
        q_p: wp.quat,
        q_c: wp.quat,
        known: wp.vec3,
        turn: wp.vec3,
    ) -> wp.float64:
        """About how far a turn of the child against the parent [rad] takes an angle of a joint that
        is no ball, where that may go round: the bends of a rod do not."""
        if wp.static(kinds.rods):
            if joints.type[joint] == ROD and dof != linear_count(joints, joint) + 2:
                return wp.float64(0.0)
        relative = wp.spatial_vector(wp.vec3(0.0), turn)
        return wp.float64(velocity(joints, joint, dof, q_p, q_c, known, relative))

    return together(angles, coordinate, velocity, advance)
