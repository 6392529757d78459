# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The end of a step of fourth order: whether it may stand, and what it leaves."""

import warp as wp

from ..algebra.so3 import exp_quat, rotation_between
from ..data import Solver
from ..effects import Effects
from ..functions import Functions, together
from ..rows import contact as contact_rows
from ..rows.joint import NO_LIMIT
from .anchors import is_linked, make_frames_of
from .block_start import UNKNOWN
from .bodies import nonnegative
from .smoothness import external_wrench
from .stage_axes import make_stage_axes

BESIDE = wp.constant(1.0e-5)
"""How close to a limit a coordinate counts as held by it [m or rad]."""


def make_stage_end(effects: Effects) -> Functions:
    """Device functions of a body after the stages of a step."""
    axes = make_stage_axes(effects)
    is_ball, axis_count = axes.is_ball, axes.axis_count
    frames_of = make_frames_of(effects.flipped)

    @wp.func
    def allows_coordinate(index: int, q: wp.float64, s: wp.ref[Solver]) -> bool:
        """Whether a coordinate is within the limits of a degree of freedom of the model."""
        if wp.static(effects.limits):
            at = wp.float32(q)
            beside = float(BESIDE)
            if wp.static(effects.limit_impedance):
                if s.joints.limit_mobility[index] > 0.0:
                    beside += s.joints.limit_margin[index]
            if at < s.joints.limit_lower[index] + beside:
                return False
            if at > s.joints.limit_upper[index] - beside:
                return False
        return True

    @wp.func
    def allows_rate(k: int, index: int, s: wp.ref[Solver]) -> bool:
        """Whether a rate is within its limit, and friction goes on.

        Args:
            k: Entry of the axis in ``tree.axes``.
            index: Degree of freedom of the model.
            s: The solver.
        """
        if wp.static(effects.velocity_limits or effects.joint_friction):
            rate = wp.float32(s.tree.runge_kutta.rate[k])
            if wp.static(effects.velocity_limits):
                most = s.joints.velocity_limit[index]
                if most > 0.0 and most < NO_LIMIT and wp.abs(rate) >= most:
                    return False
            if wp.static(effects.joint_friction):
                began = wp.float32(s.tree.runge_kutta.start_rate[k])
                if s.joints.friction[index] > 0.0 and rate * began <= 0.0:
                    return False
        return True

    @wp.func
    def allows_axes(body: int, ahead: float, s: wp.ref[Solver]) -> bool:
        """Whether nothing holds the axes of the body's joint where they are some time ahead [s]."""
        if wp.static(effects.limits or effects.velocity_limits or effects.joint_friction):
            joint = nonnegative(s.tree.joint[body])
            first = nonnegative(s.tree.axis_start[body])
            for dof in range(axis_count(body, s)):
                k = first + dof
                index = s.joints.dof_start[joint] + dof
                if not allows_rate(k, index, s):
                    return False
                if not is_ball(joint, s):
                    q = s.tree.coordinate[k] + wp.float64(ahead) * s.tree.runge_kutta.rate[k]
                    if not allows_coordinate(index, q, s):
                        return False
        return True

    @wp.func
    def allows_rows(body: int, s: wp.ref[Solver]) -> bool:
        """Whether all contacts that a body owns are open, at the start and at the end."""
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            row = s.rows.rows[i]
            span = s.work.com[row.a] - s.work.com[row.b]
            u = contact_rows.slip(row, s.work.increment[row.a], s.work.increment[row.b], span)
            if wp.min(row.gap, row.gap + wp.dot(row.normal, u)) <= 0.0:
                return False
        return True

    @wp.func
    def end_body(body: int, static_slot: int, s: wp.ref[Solver]):
        """Increment of a body, from the start of the step to where it is placed."""
        place = s.work.com[body]
        if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
            joint = nonnegative(s.tree.joint[body])
            parent = nonnegative(s.tree.parent[body])
            _sign, frame_p, _frame_c = frames_of(body, joint, s.joints)
            held = wp.transform_get_translation(frame_p)
            if parent != static_slot:
                held = s.tree.runge_kutta.place[parent]
            shift = (held - place) + s.tree.span[body]
            place = held + s.tree.span[body]
            before = wp.transform_get_rotation(s.work.pose[body])
            turn = rotation_between(before, s.tree.rotation[body])
            s.work.increment[body] = wp.spatial_vector(shift, turn)
            s.tree.swing[body] = s.tree.rotation[body] * wp.quat_inverse(before)
        elif s.work.inv_mass[body] > 0.0:
            s.tree.swing[body] = exp_quat(wp.spatial_bottom(s.work.increment[body]))
            place += s.history.lost[body] + wp.spatial_top(s.work.increment[body])
        s.tree.runge_kutta.place[body] = place

    @wp.func
    def leave_body(body: int, h: float, s: wp.ref[Solver]):
        """Keeps what a body does for the next step, of whichever order."""
        began = s.tree.runge_kutta.start_velocity[body]
        velocity = s.tree.runge_kutta.velocity[body]
        gained = (velocity - began) / h
        wrench = external_wrench(body, s)
        given = s.model.inv_mass[body] * wp.spatial_top(wrench)
        s.history.acceleration[body] = gained
        s.history.gained[body] = wp.spatial_top(gained)
        s.history.joint_force[body] = wp.vec3(0.0)
        if is_linked(body, s):
            s.history.lost[body] = wp.vec3(0.0)
        s.history.last[body].velocity = began
        s.history.last[body].acceleration = gained - wp.spatial_vector(given, wp.vec3(0.0))
        s.history.flying[body] = 0
        s.work.lead[body] = wp.spatial_vector()

    @wp.func
    def leave_joint(body: int, body_qd_out: wp.array[wp.spatial_vector], s: wp.ref[Solver]):
        """Likewise of the coordinates of its joint, after the poses."""
        joint = nonnegative(s.tree.joint[body])
        first = nonnegative(s.tree.axis_start[body])
        has_ball = is_ball(joint, s)
        for dof in range(axis_count(body, s)):
            index = s.joints.dof_start[joint] + dof
            rate = wp.float32(s.tree.runge_kutta.rate[first + dof])
            if wp.static(effects.axis_rates):
                s.history.axis_velocity[index] = wp.where(s.joints.enabled[joint], rate, UNKNOWN)
            if not s.joints.enabled[joint]:
                continue
            # no stop and no limit of effort holds, and friction slips
            s.history.piece[index] = wp.vec3i(0, 0, wp.where(rate < 0.0, 1, -1))
            if not has_ball:
                s.history.joint_angle[index] = s.tree.coordinate[first + dof]
            s.history.coordinate[index].start = s.tree.start_coordinate[first + dof]
        if wp.static(effects.axis_rates):
            for end in range(2):
                other = wp.where(end == 0, s.joints.child[joint], s.joints.parent[joint])
                if other >= 0:
                    s.history.joined_qd[joint, end] = body_qd_out[other]

    return together(allows_axes, allows_rows, end_body, leave_body, leave_joint)
