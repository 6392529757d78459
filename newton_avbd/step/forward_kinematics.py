# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints of a world that did not settle: closed, and put back to their limits, body by body."""

import warp as wp

from ..algebra.so3 import exp_quat, rotation_vector
from ..data import Solver
from ..effects import Effects
from ..functions import Functions, together
from ..rows import axis as axis_rows
from ..rows.euler import make_euler
from ..rows.free_axes import make_free_axes
from ..rows.joint import has_axes, linear_axis, make_counts
from ..rows.lock import make_locks
from .anchors import anchor_arm, anchor_offset, is_linked, joint_shift, make_anchors_of
from .bodies import body_at, nonnegative
from .coordinates import make_coordinates


def make_forward_kinematics(effects: Effects) -> Functions:
    """Device functions that close joints, and have their limits hold."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    known_angles = make_euler(effects.kinds).known_angles
    locks = make_locks(effects.kinds)
    linear_misfit, angular_misfit = locks.linear_misfit, locks.angular_misfit
    angular_axis = make_free_axes(effects.kinds).angular_axis
    anchors_of = make_anchors_of(effects.flipped)
    measure_coordinates = make_coordinates(effects).measure_coordinates

    @wp.func
    def put_together(body: int, static_slot: int, s: wp.ref[Solver]):
        """Moves the body to where its joint is closed, whatever that takes; parents go first."""
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        anchors = anchors_of(body, s)
        tilt = anchors.sign * angular_misfit(s.joints, joint, anchors.q_p, anchors.q_c)
        s.tree.rotation[body] = exp_quat(-tilt) * s.tree.rotation[body]
        arm_p = anchor_arm(parent, anchors.frame_p, static_slot, s)
        arm_c = anchor_arm(body, anchors.frame_c, static_slot, s)
        offset = anchor_offset(s.tree.apart[body], s.work, body, parent, arm_c, arm_p)
        misfit = linear_misfit(s.joints, joint, anchors.q_p, offset)
        s.work.increment[body] = s.work.increment[body] - wp.spatial_vector(misfit, wp.vec3(0.0))

    @wp.func
    def put_back(body: int, static_slot: int, s: wp.ref[Solver]):
        """Puts the coordinates of the body's joint back to the limits that the step has passed.

        What was beyond at the start of the step may stay. The body goes along with its parent, of
        which ``tree.update`` says how it has been put back; parents go first.
        """
        back = wp.quat_identity()
        shift = wp.vec3(0.0)
        if is_linked(body, s):
            joint = s.tree.joint[body]
            parent = s.tree.parent[body]
            if s.work.inv_mass[parent] > 0.0:
                shift = wp.spatial_top(s.tree.update[parent])
                turn = wp.spatial_bottom(s.tree.update[parent])
                if wp.length_sq(turn) > 0.0:
                    back = exp_quat(turn)
                    span = s.tree.apart[body] + joint_shift(s.work, body)
                    span -= joint_shift(s.work, parent) - shift
                    shift += wp.quat_rotate(back, span) - span
                    s.tree.rotation[body] = back * s.tree.rotation[body]
            known = known_angles(s.joints, joint, s.tree.coordinate, s.tree.axis_start[body])
            linear = linear_count(s.joints, joint)
            dofs = linear + angular_count(s.joints, joint)
            if not has_axes(s.joints, joint):
                dofs = 0
            for dof in range(dofs):
                k = nonnegative(s.tree.axis_start[body] + dof)
                excess = axis_rows.passed_limit(
                    s.joints,
                    s.joints.dof_start[joint] + dof,
                    s.tree.coordinate[k],
                    s.tree.start_coordinate[k],
                )
                if excess != 0.0:
                    anchors = anchors_of(body, s)
                    sign = anchors.sign
                    s.tree.coordinate[k] = s.tree.coordinate[k] - wp.float64(excess)
                    if dof < linear:
                        shift -= excess * sign * linear_axis(s.joints, joint, dof, anchors.q_p)
                    else:
                        axis = sign * angular_axis(
                            s.joints, joint, dof - linear, anchors.q_p, anchors.q_c, known
                        )
                        step = exp_quat(-excess * axis)
                        arm = anchor_arm(body, anchors.frame_c, static_slot, s)
                        shift += arm - wp.quat_rotate(step, arm)
                        back = step * back
                        s.tree.rotation[body] = step * s.tree.rotation[body]
        s.work.increment[body] = s.work.increment[body] + wp.spatial_vector(shift, wp.vec3(0.0))
        s.tree.update[body] = wp.spatial_vector(shift, rotation_vector(back))

    @wp.func
    def stop_coordinates(first: int, end: int, static_slot: int, s: wp.ref[Solver]):
        """Has the limits of joints hold after sweeps that were cut off, in visiting order.

        An axis may be on the wrong piece of its law, and coordinates that have followed many turns
        are off by their squares.
        """
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                measure_coordinates(
                    body, s.tree.axis_start[body], wp.vec3(0.0), s.tree.coordinate, static_slot, s
                )
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                put_back(body, static_slot, s)

    return together(put_together, stop_coordinates)
