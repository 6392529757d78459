# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Coordinates of joints, measured from the poses of their bodies, with revolutions counted."""

import functools

import warp as wp

from ..data import Solver
from ..effects import Effects
from ..functions import Functions, together
from ..rows.angle import counted
from ..rows.coordinate import make_joint_coordinates
from ..rows.euler import make_euler
from ..rows.joint import BALL, linear_axis, make_counts
from .anchors import Anchors, anchor_arm, anchor_offset, is_put, make_anchors_of
from .bodies import nonnegative
from .rotations import ball_turn, full_turns, relative_turn

HINGE_NEAR = wp.constant(0.1)
"""Sine of half the turn of a hinge in a step up to which a series tells the turn."""


@functools.cache
def make_coordinates(effects: Effects) -> Functions:
    """Device functions that measure the coordinates of joints."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_gimbal = counts.is_gimbal
    euler = make_euler(effects.kinds)
    known_angles, gimbal_tilt = euler.known_angles, euler.gimbal_tilt
    joint_coordinates = make_joint_coordinates(effects.kinds)
    advance, angles = joint_coordinates.advance, joint_coordinates.angles
    anchors_of = make_anchors_of(effects.flipped)

    @wp.func
    def tilt_beyond(body: int, first: int, s: wp.ref[Solver]) -> wp.vec3:
        """Turn of the body [rad] beyond where the coordinates of its gimbal have it, which stand
        from ``first`` on."""
        joint = s.tree.joint[body]
        anchors = anchors_of(body, s)
        known = known_angles(s.joints, joint, s.history.joint_angle, first)
        return anchors.sign * gimbal_tilt(s.joints, joint, anchors.q_p, anchors.q_c, known)

    @wp.func(inline=effects.inline)
    def read_coordinates(
        body: int,
        anchors: Anchors,
        first: int,
        turn: wp.vec3,
        known: wp.array[wp.float64],
        coordinates: wp.array[wp.float64],
        static_slot: int,
        s: wp.ref[Solver],
    ):
        """As :func:`measure_coordinates`, by the ``anchors`` of the joint, into ``coordinates``."""
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        sign = anchors.sign
        q_p = anchors.q_p
        q_c = anchors.q_c
        linear = linear_count(s.joints, joint)
        dofs = linear + angular_count(s.joints, joint)
        if wp.static(effects.kinds.balls):
            if s.joints.type[joint] == BALL:
                turns = sign * ball_turn(body, parent, q_p, s)
                for dof in range(dofs):
                    coordinates[first + dof] = wp.float64(turns[dof])
                return
        if linear > 0:
            arm_p = anchor_arm(parent, anchors.frame_p, static_slot, s)
            arm_c = anchor_arm(body, anchors.frame_c, static_slot, s)
            offset = sign * anchor_offset(s.tree.apart[body], s.work, body, parent, arm_c, arm_p)
            for dof in range(linear):
                q = wp.dot(linear_axis(s.joints, joint, dof, q_p), offset)
                coordinates[first + dof] = wp.float64(q)
        if dofs > linear:
            has_turned = wp.length_sq(turn) > 0.0
            started = known_angles(s.joints, joint, known, first)
            near = wp.vec3(started)
            if wp.static(effects.kinds.gimbals):
                if has_turned and is_gimbal(s.joints, joint):
                    for i in range(3):
                        ahead = advance(s.joints, joint, linear + i, q_p, q_c, started, sign * turn)
                        near[i] = started[i] + wp.float32(ahead)
            turns = angles(s.joints, joint, q_p, q_c, near, True)
            for dof in range(linear, dofs):
                about = known[first + dof]
                if has_turned:
                    about += advance(s.joints, joint, dof, q_p, q_c, started, sign * turn)
                coordinates[first + dof] = counted(turns[dof - linear], about)

    @wp.func(inline=effects.inline)
    def measure_coordinates(
        body: int,
        first: int,
        turn: wp.vec3,
        known: wp.array[wp.float64],
        static_slot: int,
        s: wp.ref[Solver],
    ):
        """Coordinates of the body's joint as ``tree`` has it [m or rad]; of a ball its turn in the
        step.

        They and the ``known`` ones stand in their arrays from ``first`` on. An angle is the one
        nearest to the known one, and what the joint's ``turn`` since then [rad, world frame] adds
        to it, so that revolutions are counted.
        """
        anchors = anchors_of(body, s)
        read_coordinates(body, anchors, first, turn, known, s.tree.coordinate, static_slot, s)

    @wp.func(inline=effects.inline)
    def measure_moved(body: int, static_slot: int, s: wp.ref[Solver]):
        """Coordinates of the body's joint after the increments, by those at the start."""
        measure_coordinates(
            body,
            s.tree.axis_start[body],
            full_turns(body, s.tree.parent[body], s.work),
            s.tree.start_coordinate,
            static_slot,
            s,
        )

    @wp.func
    def follow_hinge(body: int, s: wp.ref[Solver]) -> bool:
        """Angle of the body's hinge, by that at the start and how far it has turned since.

        Returns false, and leaves the angle as it is, if the joint is no hinge or has turned far, or
        if its parent is kinematic and has been put ahead.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        if angular_count(s.joints, joint) != 1 or linear_count(s.joints, joint) != 0:
            return False
        anchors = anchors_of(body, s)
        if anchors.sign < 0.0 or is_put(parent, s.work):
            return False
        if wp.length_sq(full_turns(body, parent, s.work)) > 0.0:
            return False
        index = nonnegative(s.joints.dof_start[joint])
        axis = wp.quat_rotate(anchors.q_p, s.joints.axis[index])
        turn = relative_turn(body, parent, s.tree)
        sine = wp.dot(axis, wp.vec3(turn[0], turn[1], turn[2]))
        x = sine * sine
        if x > HINGE_NEAR * HINGE_NEAR:
            return False
        # 2 asin(sine), by a series that is exact in float32
        series = wp.static(3 / 20) + x * (wp.static(5 / 56) + x * wp.static(35 / 576))
        angle = sine * (2.0 + x * (wp.static(1 / 3) + x * series))
        s.tree.coordinate[s.tree.axis_start[body]] = s.history.joint_angle[index] + wp.float64(
            angle
        )
        return True

    @wp.func
    def measure_guess(body: int, static_slot: int, s: wp.ref[Solver]):
        """Coordinates of the body's joint where the guess of the increments has the bodies."""
        if wp.static(1 in effects.kinds.angular):
            if follow_hinge(body, s):
                return
        measure_moved(body, static_slot, s)

    @wp.func
    def count_turns(body: int, s: wp.ref[Solver]):
        """Remembers what orientations do not tell: turns of the body's joint in the step, and the
        coordinates of a gimbal."""
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        if wp.static(effects.kinds.gimbals):
            if is_gimbal(s.joints, joint):
                for dof in range(s.joints.dof_start[joint + 1] - s.joints.dof_start[joint]):
                    known = s.tree.coordinate[s.tree.axis_start[body] + dof]
                    s.history.joint_angle[s.joints.dof_start[joint] + dof] = known
                return
        turn = full_turns(body, parent, s.work)
        if wp.length_sq(turn) > 0.0:
            anchors = anchors_of(body, s)
            turn = anchors.sign * turn
            linear = linear_count(s.joints, joint)
            for dof in range(linear, linear + angular_count(s.joints, joint)):
                about = advance(s.joints, joint, dof, anchors.q_p, anchors.q_c, wp.vec3(0.0), turn)
                index = nonnegative(s.joints.dof_start[joint] + dof)
                s.history.joint_angle[index] = s.history.joint_angle[index] + about

    return together(
        tilt_beyond,
        read_coordinates,
        measure_coordinates,
        measure_moved,
        measure_guess,
        count_turns,
    )
