# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""ROD joints: how a rod bends and twists, and the torque and stiffness of what answers that."""

import warp as wp

from ..algebra.so3 import angle_of
from ..data import JointModel
from .angle import wrapped


@wp.func
def tangent(q: wp.quat) -> wp.vec3:
    """Direction of a rod at an anchor: its local Z."""
    return wp.quat_rotate(q, wp.vec3(0.0, 0.0, 1.0))


@wp.func
def bend_and_twist(q: wp.quat) -> wp.vec3:
    """Bends about X and Y and twist about Z [rad] of a rod whose end is turned by q to its start.

    The bend is the curvature binormal 2 tan(theta/2) of the angle theta between the two tangents
    (Bergou et al., "Discrete Elastic Rods", 2008), the twist what turns the child about its tangent
    after the start has been carried along without twisting.
    """
    end = tangent(q)
    along = wp.max(1.0 + end[2], 1.0e-3)
    # z x t = (-t_y, t_x, 0)
    return wp.vec3(-2.0 * end[1] / along, 2.0 * end[0] / along, 2.0 * angle_of(q[2], q[3]))


@wp.func
def rod_turn(joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat) -> wp.vec3:
    """Bends and twist of a rod beyond those at rest [rad]."""
    start = joints.coord_start[joint] + 3
    rest = wp.quat(
        joints.rest_q[start],
        joints.rest_q[start + 1],
        joints.rest_q[start + 2],
        joints.rest_q[start + 3],
    )
    out = bend_and_twist(wp.quat_inverse(q_p) * q_c) - bend_and_twist(rest)
    out[2] = wrapped(out[2])
    return out


@wp.func
def rod_torque(q_p: wp.quat, q_c: wp.quat, response: wp.vec3) -> wp.vec3:
    """Torque on the child [N m], world frame, of what answers the bends and the twist [N m].

    That is J^T response: a bend changes by 1 + kb^2/4 times the turn, the twist by the turn about
    the mean tangent.
    """
    start = tangent(q_p)
    end = tangent(q_c)
    along = wp.max(1.0 + wp.dot(start, end), 1.0e-3)
    bend = wp.cross(start, end)
    growth = 1.0 + wp.length_sq(bend) / (along * along)
    across = wp.quat_rotate(q_p, wp.vec3(response[0], response[1], 0.0))
    return growth * across + (response[2] / along) * (start + end)


@wp.func
def rod_stiffness(q_p: wp.quat, q_c: wp.quat, stiffness: wp.vec3) -> wp.vec3:
    """Bound of J^T K J about each axis of the parent frame [N m/rad], J as in :func:`rod_torque`.

    The twist of a bent rod couples the axes: each gets the sum of its row (Gershgorin).
    """
    start = tangent(q_p)
    end = tangent(q_c)
    along = wp.max(1.0 + wp.dot(start, end), 1.0e-3)
    growth = 1.0 + wp.length_sq(wp.cross(start, end)) / (along * along)
    mean = wp.quat_rotate_inv(q_p, start + end) / along
    row = wp.vec3(wp.abs(mean[0]), wp.abs(mean[1]), wp.abs(mean[2]))
    bend = growth * growth * wp.vec3(stiffness[0], stiffness[1], 0.0)
    return bend + (stiffness[2] * (row[0] + row[1] + row[2])) * row
