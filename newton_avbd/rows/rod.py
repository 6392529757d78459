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
def bend_row(across: wp.vec3, start: wp.vec3, end: wp.vec3) -> wp.vec3:
    """How the bend about an axis across the start's tangent changes by a turn of the child.

    By 1 + kb^2/4 times the turn about that axis, carried along to the end's tangent without
    twisting.
    """
    along = wp.max(1.0 + wp.dot(start, end), 1.0e-3)
    growth = 1.0 + wp.length_sq(wp.cross(start, end)) / (along * along)
    return growth * (across - (wp.dot(across, end) / along) * (start + end))


@wp.func
def rod_torque(q_p: wp.quat, q_c: wp.quat, response: wp.vec3) -> wp.vec3:
    """Torque on the child [N m], world frame, of what answers the bends and the twist [N m].

    That is J^T response, the derivative of what they store: a bend changes as in :func:`bend_row`,
    the twist by the turn about the mean tangent.
    """
    start = tangent(q_p)
    end = tangent(q_c)
    along = wp.max(1.0 + wp.dot(start, end), 1.0e-3)
    across = wp.quat_rotate(q_p, wp.vec3(response[0], response[1], 0.0))
    return bend_row(across, start, end) + (response[2] / along) * (start + end)


@wp.func
def row_bound(row: wp.vec3) -> wp.vec3:
    """Diagonal that bounds row^T row: each axis gets the sum of its row (Gershgorin)."""
    size = wp.vec3(wp.abs(row[0]), wp.abs(row[1]), wp.abs(row[2]))
    return (size[0] + size[1] + size[2]) * size


@wp.func
def rod_stiffness(q_p: wp.quat, q_c: wp.quat, stiffness: wp.vec3) -> wp.vec3:
    """Bound of J^T K J about each axis of the parent frame [N m/rad], J as in :func:`rod_torque`.

    The bends and the twist of a bent rod couple the axes (:func:`row_bound`).
    """
    start = wp.vec3(0.0, 0.0, 1.0)
    end = wp.quat_rotate_inv(q_p, tangent(q_c))
    along = wp.max(1.0 + end[2], 1.0e-3)
    bound = stiffness[0] * row_bound(bend_row(wp.vec3(1.0, 0.0, 0.0), start, end))
    bound += stiffness[1] * row_bound(bend_row(wp.vec3(0.0, 1.0, 0.0), start, end))
    return bound + stiffness[2] * row_bound((start + end) / along)
