# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How joints of trees stand at the start of a step: misfit, coordinates, velocities of these."""

import functools

import warp as wp

from ..blocks import tree as algebra
from ..data import Solver, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows.coordinate import make_joint_coordinates
from ..rows.euler import beyond_limits, make_euler, other_solution
from ..rows.joint import BALL, is_skew, make_counts
from ..rows.lock import make_locks
from .anchors import (
    ROUNDING,
    Anchors,
    anchor_arm,
    anchor_rotation,
    carried_misfit,
    joint_shift,
    make_anchors_of,
    start_span,
)
from .bodies import nonnegative
from .coordinates import make_coordinates
from .slopes import begin_axis


@functools.cache
def make_joint_start(effects: Effects) -> Functions:
    """Device functions that measure joints at the start of a step."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_gimbal = counts.is_gimbal
    known_angles = make_euler(effects.kinds).known_angles
    locks = make_locks(effects.kinds)
    linear_misfit, angular_misfit = locks.linear_misfit, locks.angular_misfit
    angular_lock = locks.angular_lock
    velocity = make_joint_coordinates(effects.kinds).velocity
    anchors_of = make_anchors_of(effects.flipped)
    coordinates = make_coordinates(effects)
    read_coordinates, tilt_beyond = coordinates.read_coordinates, coordinates.tilt_beyond

    @wp.func
    def measure_misfit(body: int, anchors: Anchors, static_slot: int, s: wp.ref[Solver]) -> bool:
        """Misfit of the body's joint at the start of the step, by its ``anchors``.

        Expects increments of zero, the guess of them in ``tree.update``, and rotations at the
        start. Returns whether the misfit is beyond rounding.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        q_p = anchors.q_p
        q_c = anchors.q_c
        arm_p = anchor_arm(parent, anchors.frame_p, static_slot, s)
        arm_c = anchor_arm(body, anchors.frame_c, static_slot, s)
        apart = start_span(body, parent, anchors.frame_p, static_slot, s)
        s.tree.apart[body] = apart
        linear = linear_misfit(s.joints, joint, q_p, apart + (arm_c - arm_p))
        angular = anchors.sign * angular_misfit(s.joints, joint, q_p, q_c)
        misfit = carried_misfit(parent, arm_p, linear, angular, s)
        if s.work.inv_mass[parent] == 0.0:
            # only what the joint locks
            linear = linear_misfit(s.joints, joint, q_p, wp.spatial_top(misfit))
            lock = angular_lock(s.joints, joint, q_p, q_c)
            angular = lock * wp.spatial_bottom(misfit)
        s.tree.misfit[body] = wp.spatial_vector(linear, angular)
        reach = wp.length(arm_c) + wp.length(arm_p)
        s.tree.rounding[body] = ROUNDING * reach
        allowed = ROUNDING * (wp.length(s.work.com[body]) + reach)
        return wp.length_sq(linear) + reach * reach * wp.length_sq(angular) > allowed * allowed

    @wp.func
    def take_allowed(first: int, s: wp.ref[Solver]):
        """Of the two solutions for the angles of a gimbal whose pose was written since the last
        step, takes the one within the limits; they stand from ``first`` on."""
        if wp.static(effects.kinds.skew):
            if is_skew(s.joints, first):
                return
        angles = wp.vec3()
        for i in range(3):
            angles[i] = wp.float32(s.history.joint_angle[first + i])
        other = other_solution(angles)
        least = beyond_limits(s.joints, first, other)
        if least < beyond_limits(s.joints, first, angles):
            for i in range(3):
                s.history.joint_angle[first + i] = wp.float64(other[i])

    @wp.func(inline=effects.inline)
    def read_start(body: int, anchors: Anchors, static_slot: int, s: wp.ref[Solver]):
        """Reads the coordinates of the body's joint at the start of the step, by its anchors."""
        joint = nonnegative(s.tree.joint[body])
        start = s.joints.dof_start[joint]
        read_coordinates(
            body,
            anchors,
            start,
            wp.vec3(0.0),
            s.history.joint_angle,
            s.history.joint_angle,
            static_slot,
            s,
        )
        if wp.static(effects.kinds.gimbals):
            if is_gimbal(s.joints, joint):
                if wp.static(effects.limits):
                    if not s.tree.is_left[body]:
                        take_allowed(start + linear_count(s.joints, joint), s)
                # what the pose has beyond the angles was there before
                tilt = tilt_beyond(body, start, s)
                none = wp.vec3(0.0)
                s.tree.misfit[body] = s.tree.misfit[body] + wp.spatial_vector(none, tilt)

    @wp.func(inline=effects.inline)
    def begin_coordinates(
        body: int, anchors: Anchors, scale: WorldScale, s: wp.ref[Solver]
    ) -> bool:
        """Coordinates of the body's joint at the start of the step, by its anchors.

        Returns whether one is beyond its limits by more than rounding.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        is_open = bool(False)
        is_carried = (
            parent != scale.static_slot and s.work.inv_mass[parent] == 0.0 and s.tree.is_left[body]
        )
        start = s.joints.dof_start[joint]
        read_start(body, anchors, scale.static_slot, s)
        for dof in range(linear_count(s.joints, joint) + angular_count(s.joints, joint)):
            index = start + dof
            q = s.history.joint_angle[index]
            at = wp.float32(q)
            rounding = s.tree.rounding[body] + 2.0 * ROUNDING * wp.abs(at)
            if dof >= linear_count(s.joints, joint):
                rounding = 2.0 * ROUNDING * (2.0 + wp.abs(at))
            if wp.static(effects.hard_limits):
                lower = s.joints.limit_lower[index] - rounding
                if at < lower or at > s.joints.limit_upper[index] + rounding:
                    is_open = True
            if is_carried and s.joints.type[joint] != BALL:
                # a kinematic parent has been put elsewhere since: what damps feels its motion
                q = s.tree.coordinate[s.tree.axis_start[body] + dof]
            if wp.static(effects.second_order):
                q = begin_axis(index, q, scale, s.history.coordinate)
            if wp.static(effects.joint_friction):
                # what rounding moves, friction brings back; a ball's coordinates start anew
                drift = wp.float32(wp.abs(q - s.history.held_at[index]))
                is_off = drift > rounding + 2.0 * ROUNDING * wp.length(s.work.com[body])
                is_off = is_off or s.joints.type[joint] == BALL
                if is_off or s.history.piece[index][2] != 0:
                    s.history.held_at[index] = q
            s.tree.start_coordinate[s.tree.axis_start[body] + dof] = q
        return is_open

    @wp.func(inline=effects.inline)
    def measure_start(body: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Misfit and coordinates of the body's joint at the start of the step.

        Expects what :func:`measure_misfit` does. Returns whether the misfit, or a coordinate beyond
        its limits, is more than rounding.
        """
        anchors = anchors_of(body, s)
        is_open = measure_misfit(body, anchors, scale.static_slot, s)
        if wp.static(effects.coordinates):
            if begin_coordinates(body, anchors, scale, s):
                is_open = True
        return is_open

    @wp.func(inline=effects.inline)
    def measure_velocity(
        joint: int,
        static_slot: int,
        velocity_c: wp.spatial_vector,
        velocity_p: wp.spatial_vector,
        s: wp.ref[Solver],
    ):
        """Velocities of a joint's coordinates [m/s or rad/s], by those of its child and its parent
        at their present poses."""
        child = s.joints.child[joint]
        parent = s.joints.parent[joint]
        frame_c = s.joints.child_frame[joint]
        arm = anchor_arm(child, frame_c, static_slot, s)
        relative = algebra.carried(arm, velocity_c)
        if parent >= 0:
            # of the parent where the child's anchor is
            span = arm + (s.work.com[child] - s.work.com[parent])
            span += joint_shift(s.work, child) - joint_shift(s.work, parent)
            relative -= algebra.carried(span, velocity_p)
        slot = wp.where(parent < 0, static_slot, parent)
        q_p = anchor_rotation(s.tree, slot, s.joints.parent_frame[joint])
        q_c = anchor_rotation(s.tree, child, frame_c)
        known = known_angles(s.joints, joint, s.history.joint_angle, s.joints.dof_start[joint])
        for dof in range(linear_count(s.joints, joint) + angular_count(s.joints, joint)):
            s.tree.start_velocity[s.joints.dof_start[joint] + dof] = velocity(
                s.joints, joint, dof, q_p, q_c, known, relative
            )

    return together(measure_misfit, read_start, measure_start, measure_velocity)
