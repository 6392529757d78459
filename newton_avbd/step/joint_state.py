# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joint coordinates of a state beside the poses of its bodies: which of the two a user wrote."""

import newton
import warp as wp

from ..data import History, JointModel
from ..rows.angle import turn_about
from ..rows.joint import has_axes
from .actuation import base_rotation
from .kernels import KERNEL
from .resetting import is_selected


@wp.struct
class StateArrays:
    """Joint coordinates, and poses and velocities of bodies: of a state, or as a step left them."""

    joint_q: wp.array[float]
    joint_qd: wp.array[float]
    body_q: wp.array[wp.transform]
    body_qd: wp.array[wp.spatial_vector]


@wp.kernel(**KERNEL)
def find_written(
    # Model:
    joints: JointModel,
    articulation_start: wp.array[int],
    articulation_end: wp.array[int],
    rest_q: wp.array[wp.transform],
    rest_qd: wp.array[wp.spatial_vector],
    # State in:
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    # In:
    left: StateArrays,
    # Out:
    history: History,
    is_written: wp.array[wp.bool],
):
    """Finds articulations whose joint coordinates a user wrote, and no pose of their bodies.

    A body counts as not written if it has the pose and velocity that the last step left or that the
    model has. The turns of written angles are taken as written. One thread an articulation.
    """
    articulation = wp.tid()
    first = articulation_start[articulation]
    end = articulation_end[articulation]
    written = bool(False)
    for coord in range(joints.coord_start[first], joints.coord_start[end]):
        written = written or joint_q[coord] != left.joint_q[coord]
    for dof in range(joints.dof_start[first], joints.dof_start[end]):
        written = written or joint_qd[dof] != left.joint_qd[dof]
    if written:
        for joint in range(first, end):
            body = joints.child[joint]
            is_left = body_q[body] == left.body_q[body] and body_qd[body] == left.body_qd[body]
            is_rest = body_q[body] == rest_q[body] and body_qd[body] == rest_qd[body]
            written = written and (is_left or is_rest)
    is_written[articulation] = written
    if written:
        for joint in range(first, end):
            if has_axes(joints, joint):
                start = joints.dof_start[joint]
                for dof in range(start, joints.dof_start[joint + 1]):
                    angle = joint_q[joints.coord_start[joint] + dof - start]
                    history.joint_angle[dof] = wp.float64(angle)


@wp.kernel(**KERNEL)
def measure_joints(
    # Model:
    joints: JointModel,
    found: wp.array[wp.int32],
    # State:
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    # Out:
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
):
    """What Newton's ``eval_ik`` does not tell of joints; one thread for each of them.

    Angles and rates of two axes that are not square to each other, which it takes them to be; and
    rates of three axes at the pole, where it divides by zero. The outer two are parallel there, and
    have half of what they turn together each.
    """
    joint = found[wp.tid()]
    linear = joints.dof_dim[joint, 0]
    dof = joints.dof_start[joint] + linear
    coord = joints.coord_start[joint] + linear
    child = joints.child[joint]
    parent = joints.parent[joint]
    start = base_rotation(joint, joints.parent, joints.parent_frame, body_q)
    end = base_rotation(joint, joints.child, joints.child_frame, body_q)
    first = wp.quat_rotate(start, joints.axis[dof])
    spin = wp.spatial_bottom(body_qd[child])
    if parent >= 0:
        spin -= wp.spatial_bottom(body_qd[parent])
    if joints.dof_dim[joint, 1] == 3:
        if wp.isfinite(joint_qd[dof] + joint_qd[dof + 1] + joint_qd[dof + 2]):
            return
        swung = start * wp.quat_from_axis_angle(joints.axis[dof], joint_q[coord])
        last = wp.quat_rotate(end, joints.axis[dof + 2])
        half = 0.5 * wp.dot(spin, first)
        joint_qd[dof] = half
        joint_qd[dof + 1] = wp.dot(spin, wp.quat_rotate(swung, joints.axis[dof + 1]))
        joint_qd[dof + 2] = wp.sign(wp.dot(first, last)) * half
        return
    across = wp.cross(joints.axis[dof], joints.axis[dof + 1])
    last = wp.quat_rotate(end, joints.axis[dof + 1])
    middle = wp.cross(first, last)
    joint_q[coord] = turn_about(first, wp.quat_rotate(start, across), middle)
    joint_q[coord + 1] = turn_about(last, middle, wp.quat_rotate(end, across))
    along = wp.dot(first, last)
    joint_qd[dof] = wp.dot(spin, first - along * last) / wp.length_sq(middle)
    joint_qd[dof + 1] = wp.dot(spin, last - along * first) / wp.length_sq(middle)


@wp.kernel(**KERNEL)
def keep_left(
    # State out:
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    # Out:
    left: StateArrays,
):
    """Keeps what the step leaves, for :func:`find_written`; a thread for each of the most items."""
    i = wp.tid()
    if i < joint_q.shape[0]:
        left.joint_q[i] = joint_q[i]
    if i < joint_qd.shape[0]:
        left.joint_qd[i] = joint_qd[i]
    if i < body_q.shape[0]:
        left.body_q[i] = body_q[i]
        left.body_qd[i] = body_qd[i]


@wp.kernel(**KERNEL)
def reset_joints(
    # Model:
    joints: JointModel,
    joint_world: wp.array[int],
    rest_q: wp.array[float],
    rest_qd: wp.array[float],
    # In:
    mask: wp.array[wp.bool],
    flags: int,
    # Out:
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
    left: StateArrays,
):
    """Puts the joints of the masked worlds back; one thread a joint.

    They count as written, so that the next step puts bodies where they say.
    """
    joint = wp.tid()
    if mask.shape[0] > 0:
        if not is_selected(joint_world[joint], mask):
            return
    if (flags & wp.static(int(newton.StateFlags.JOINT_Q))) != 0:
        for coord in range(joints.coord_start[joint], joints.coord_start[joint + 1]):
            joint_q[coord] = rest_q[coord]
            left.joint_q[coord] = wp.NAN
    if (flags & wp.static(int(newton.StateFlags.JOINT_QD))) != 0:
        for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
            joint_qd[dof] = rest_qd[dof]
            left.joint_qd[dof] = wp.NAN
