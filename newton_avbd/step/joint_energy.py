# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a joint adds to the energy balance of its island: work along its axes, and its rotors."""

import warp as wp

from ..data import Balance, Solver, Step
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows.coordinate import make_joint_coordinates
from ..rows.free_axes import make_free_axes
from ..rows.joint import BALL, ROD, ball_away, linear_axis, make_counts
from .anchors import anchor_arm, anchor_rotation, parent_slot
from .balance import squared_overlap, touch_fixed, with_work


def make_axis_work(effects: Effects) -> wp.Function:
    """Device function: the work of what acts along an axis of a joint."""

    @wp.func
    def axis_work(
        joint: int,
        dof: int,
        q: wp.float64,
        moved: float,
        start_velocity: float,
        turn_away: wp.vec3,
        rest_away: wp.vec3,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Work of what acts along an axis that has moved to q, ``joint_f`` aside [J]."""
        index = s.joints.dof_start[joint] + dof
        total = float(0.0)
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                total -= s.joints.target_ke[index] * moved * (wp.float32(q) - 0.5 * moved)
                if wp.static(effects.dahl):
                    if dof >= 3:
                        # what friction has stored is at most what it pushed with before
                        total += wp.max(-s.history.dahl_sigma[joint][dof - 3] * moved, 0.0)
                return total
        if wp.static(effects.drives):
            # the mean force of the spring over the way, and of a damper what a motor gives
            away = axis_rows.away_from(step.control.target_q, s.joints, joint, dof, q, turn_away)
            away += 0.5 * moved
            damping, _k = axis_rows.drive(s.joints, step.control, index, 0.0, moved, h)
            whole, _k = axis_rows.drive(s.joints, step.control, index, away, moved, h)
            given = (whole - damping) * moved + wp.max(damping * moved, 0.0)
            most = axis_rows.most_effort(s.joints, index)
            if wp.isfinite(most):
                given = wp.clamp(given, -most * wp.abs(moved), most * wp.abs(moved))
            total += given
        if wp.static(effects.pushed_axes):
            push = step.control.pushes[index]
            middle = wp.float32(q) - 0.5 * moved
            total += (push.force - push.stiffness * middle) * moved
            given = push.drive - push.drive_stiffness * middle
            if wp.static(effects.force_ranges):
                pull, _k = axis_rows.ranged(step.control, index, wp.float64(middle), 0.0, h)
                given += pull
            effort = axis_rows.most_effort(s.joints, index)
            least = wp.max(push.least, -effort)
            most = wp.min(push.most, effort)
            # dampers only take, also within limits
            total += wp.clamp(given, least, most) * moved
        if wp.static(effects.springs):
            away = axis_rows.away_from(s.joints.rest_q, s.joints, joint, dof, q, rest_away)
            total += s.joints.stiffness[index] * moved * (away + 0.5 * moved)
        if wp.static(effects.limit_impedance):
            if s.joints.limit_mobility[index] > 0.0:
                # what returns to it beyond the inertia is given by the limit
                pull, _k = axis_rows.yielding_limit(
                    s.joints, index, wp.float32(q), moved, start_velocity, h
                )
                return total + wp.max(pull * moved, 0.0)
        if wp.static(effects.limits and effects.compliance):
            at = wp.float32(q)
            lower = at - s.joints.limit_lower[index]
            upper = s.joints.limit_upper[index] - at
            less = squared_overlap(lower - moved) - squared_overlap(lower)
            less += squared_overlap(upper + moved) - squared_overlap(upper)
            total += 0.5 * s.joints.limit_ke[index] * less
        return total

    return axis_work


def make_add_joint(effects: Effects) -> wp.Function:
    """Device function: adds a joint to the balance of its island."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_gimbal = counts.is_gimbal
    angular_axis = make_free_axes(effects.kinds).angular_axis
    angles = make_joint_coordinates(effects.kinds).angles
    axis_work = make_axis_work(effects)

    @wp.func
    def add_joint(
        joint: int,
        first: int,
        coordinate: wp.array[wp.float64],
        start_coordinate: wp.array[wp.float64],
        h: float,
        static_slot: int,
        sum: Balance,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> Balance:
        """Adds a joint: its rotors, and the work of what acts along its axes."""
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, static_slot)
        out = touch_fixed(child, True, s.work, touch_fixed(parent, True, s.work, sum))
        for side in range(2):
            slot = wp.where(side == 0, child, parent)
            if s.work.inv_mass[slot] == 0.0 and slot != static_slot and not s.tree.is_left[slot]:
                out.is_pushed = True  # its pose has been written since the last step
        q_p = anchor_rotation(s.tree, parent, s.joints.parent_frame[joint])
        q_c = anchor_rotation(s.tree, child, s.joints.child_frame[joint])
        arm = anchor_arm(child, s.joints.child_frame[joint], static_slot, s)
        moved_c = s.work.increment[child]
        moved_p = s.work.increment[parent]
        turn = wp.spatial_bottom(moved_c - moved_p)
        shift = wp.spatial_top(moved_c - moved_p) + wp.cross(turn, arm)
        shift += wp.cross(wp.spatial_bottom(moved_p), s.work.com[parent] - s.work.com[child])
        turn_away = wp.vec3(0.0)
        rest_away = wp.vec3(0.0)
        if wp.static(effects.kinds.balls and effects.drives):
            if s.joints.type[joint] == BALL:
                turn_away = ball_away(step.control.target_q, s.joints, joint, q_p, q_c)
        if wp.static(effects.kinds.balls and effects.springs):
            if s.joints.type[joint] == BALL:
                rest_away = ball_away(s.joints.rest_q, s.joints, joint, q_p, q_c)
        linear = linear_count(s.joints, joint)
        bent = wp.vec3(0.0)
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                # how far sweeps have bent it counts along the axes of the start
                bent = angles(s.joints, joint, q_p, q_c, wp.vec3(0.0), False)
        for dof in range(linear + angular_count(s.joints, joint)):
            index = s.joints.dof_start[joint] + dof
            moved = float(0.0)
            q = wp.float64(0.0)
            if wp.static(effects.coordinates):
                q = coordinate[first + dof]
                if wp.static(effects.rods):
                    if s.joints.type[joint] == ROD and dof >= linear:
                        q = wp.float64(bent[dof - linear])
                begun = start_coordinate[first + dof]
                if wp.static(effects.second_order):
                    # steps of second order start ahead
                    begun = s.history.coordinate[index].start
                moved = wp.float32(q - begun)
            if s.joints.type[joint] != ROD and step.control.joint_f[index] != 0.0:
                along = float(moved)
                if dof < linear:
                    along = wp.dot(linear_axis(s.joints, joint, dof, q_p), shift)
                elif not is_gimbal(s.joints, joint):
                    axis = angular_axis(s.joints, joint, dof - linear, q_p, q_c, wp.vec3(0.0))
                    along = wp.dot(axis, turn)
                out.before += step.control.joint_f[index] * along
            if wp.static(effects.coordinates):
                given = axis_work(
                    joint,
                    dof,
                    q,
                    moved,
                    s.tree.start_velocity[index],
                    turn_away,
                    rest_away,
                    h,
                    step,
                    s,
                )
                out = with_work(out, given)
            if wp.static(effects.armature):
                inertia = s.joints.armature[index]
                start = s.tree.start_velocity[index]
                end = s.history.axis_velocity[index]
                if inertia > 0.0:
                    out = with_work(out, 0.5 * inertia * start * start)
                    out.after += 0.5 * inertia * end * end
        return out

    return add_joint
