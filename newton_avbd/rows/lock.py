# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a joint locks: by how much its anchor frames part, and in which directions they may not."""

import functools

import warp as wp

from ..algebra.so3 import rotation_vector, turned_from
from ..data import JointModel
from ..functions import Functions, together
from .euler import make_euler
from .joint import CONNECT, JointKinds, is_point, linear_axis, make_counts


@functools.cache
def make_locks(kinds: JointKinds) -> Functions:
    """Device functions: misfits, what of a motion is locked, and the projections to that."""
    linear, angular = kinds.linear, kinds.angular
    counts = make_counts(kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    euler_middle = make_euler(kinds).euler_middle

    @wp.func
    def linear_misfit(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, offset: wp.vec3
    ) -> wp.vec3:
        """Part [m] of the offset between the anchors that the joint locks."""
        free = linear_count(joints, joint)
        if wp.static(0 in linear):
            if free == 0:
                return offset
        if wp.static(kinds.distances):
            if is_point(joints, joint):
                return offset
        if wp.static(1 in linear):
            if free == 1:
                axis = linear_axis(joints, joint, 0, q_p)
                return offset - wp.dot(axis, offset) * axis
        if wp.static(2 in linear):
            if free == 2:
                normal = wp.normalize(
                    wp.cross(linear_axis(joints, joint, 0, q_p), linear_axis(joints, joint, 1, q_p))
                )
                return wp.dot(normal, offset) * normal
        return wp.vec3(0.0)

    @wp.func
    def angular_misfit(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat
    ) -> wp.vec3:
        """Turn [rad] of the child against the parent that the joint locks, world frame."""
        if wp.static(kinds.connects):
            if joints.type[joint] == CONNECT:
                return wp.vec3(0.0)
        free = angular_count(joints, joint)
        if wp.static(0 in angular):
            if free == 0:
                return rotation_vector(q_c * wp.quat_inverse(q_p))
        if wp.static(1 in angular):
            if free == 1:
                axis = joints.axis[joints.dof_start[joint] + linear_count(joints, joint)]
                return wp.cross(wp.quat_rotate(q_p, axis), wp.quat_rotate(q_c, axis))
        if wp.static(2 in angular):
            if free == 2:
                sine, middle = euler_middle(joints, joint, q_p, q_c)
                tilt = wp.asin(sine)
                if wp.static(kinds.oblique):
                    first = joints.dof_start[joint] + linear_count(joints, joint)
                    cosine = wp.dot(joints.axis[first], joints.axis[first + 1])
                    tilt += wp.asin(wp.clamp(cosine, -1.0, 1.0))
                return tilt * middle
        return wp.vec3(0.0)

    @wp.func
    def locked_shift(
        joints: wp.ref[JointModel],
        joint: int,
        q_p: wp.quat,
        turn_p: wp.quat,
        shift: wp.vec3,
        offset: wp.vec3,
    ) -> wp.vec3:
        """Of a shift [m] of the child anchor against the parent's what the joint locks.

        With the turn of the parent meanwhile, and what lies between the anchors after it: seen from
        the parent the child was at ``turn_p (offset - shift)``. Of a small shift nothing is lost,
        as it is where two misfits are subtracted.
        """
        turned = turned_from(wp.quat_inverse(turn_p), offset - shift)
        return linear_misfit(joints, joint, q_p, shift + turned)

    @wp.func
    def locked_turn(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat, turn: wp.quat
    ) -> wp.vec3:
        """Likewise, of a turn of the child against the parent that led to these rotations [rad]."""
        if wp.static(kinds.connects):
            if joints.type[joint] == CONNECT:
                return wp.vec3(0.0)
        free = angular_count(joints, joint)
        if wp.static(0 in angular):
            if free == 0:
                return rotation_vector(turn)
        if wp.static(1 in angular):
            if free == 1:
                first = joints.dof_start[joint] + linear_count(joints, joint)
                axis = wp.quat_rotate(q_p, joints.axis[first])
                return wp.cross(turned_from(wp.quat_inverse(turn), axis), axis)
        if wp.static(2 in angular):
            if free == 2:
                # of the middle angle, whose sine is that of the two axes
                i = joints.dof_start[joint] + linear_count(joints, joint)
                axis_p = wp.quat_rotate(q_p, joints.axis[i])
                axis_c = wp.quat_rotate(q_c, joints.axis[i + 1])
                whole, middle = euler_middle(joints, joint, q_p, q_c)
                sine = -wp.dot(axis_p, turned_from(turn, axis_c))
                cosine = wp.sqrt((1.0 - whole) * (1.0 + whole))
                return (sine / wp.max(cosine, 1.0e-4)) * middle
        return wp.vec3(0.0)

    @wp.func
    def linear_lock(joints: wp.ref[JointModel], joint: int, q_p: wp.quat) -> wp.mat33:
        """Projection of a shift to what the joint locks."""
        return wp.matrix_from_cols(
            linear_misfit(joints, joint, q_p, wp.vec3(1.0, 0.0, 0.0)),
            linear_misfit(joints, joint, q_p, wp.vec3(0.0, 1.0, 0.0)),
            linear_misfit(joints, joint, q_p, wp.vec3(0.0, 0.0, 1.0)),
        )

    @wp.func
    def angular_lock(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat
    ) -> wp.mat33:
        """Projection of a turn to what the joint locks."""
        if wp.static(kinds.connects):
            if joints.type[joint] == CONNECT:
                return wp.mat33(0.0)
        free = angular_count(joints, joint)
        if wp.static(0 in angular):
            if free == 0:
                return wp.identity(n=3, dtype=float)
        if wp.static(1 in angular):
            if free == 1:
                axis = wp.quat_rotate(
                    q_p, joints.axis[joints.dof_start[joint] + linear_count(joints, joint)]
                )
                return wp.identity(n=3, dtype=float) - wp.outer(axis, axis)
        if wp.static(2 in angular):
            if free == 2:
                _, middle = euler_middle(joints, joint, q_p, q_c)
                return wp.outer(middle, middle)
        return wp.mat33(0.0)

    return together(
        linear_misfit, angular_misfit, locked_shift, locked_turn, linear_lock, angular_lock
    )
