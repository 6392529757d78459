# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The law of an axis for the effects of a scene: what of :mod:`.rows.axis` acts there."""

import warp as wp

from ..data import AxisLaw, ControlInput, History, JointModel
from ..effects import Effects
from ..functions import Functions, together
from ..rows.axis import (
    LEAN,
    LEAN_RATE,
    LEANING,
    YIELDING,
    away_from,
    drive,
    held_step,
    is_held,
    left_beyond,
    limit_at,
    make_next_piece,
    most_effort,
    most_friction,
    passive,
    pushed,
    pushed_within,
    ranged,
    reflected,
    soft_limit,
    yielding_limit,
)
from ..rows.joint import NO_LIMIT


def make_axis(effects: Effects) -> Functions:
    """Device functions: the law F(q) of an axis, and its solution."""
    next_piece = make_next_piece(
        friction=effects.joint_friction,
        stops=effects.stops,
        limits=effects.effort_limits,
        closures=effects.closures,
    )

    @wp.func
    def compliant_limit(
        joints: wp.ref[JointModel],
        dof: int,
        q: float,
        moved: float,
        start_velocity: float,
        h: float,
    ):
        """Generalized force of a compliant limit [N or N m] and its curvature."""
        if wp.static(effects.limit_impedance):
            if joints.limit_mobility[dof] > 0.0:
                return yielding_limit(joints, dof, q, moved, start_velocity, h)
        return soft_limit(joints, dof, q, moved, h)

    @wp.func
    def linear_force(
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        joint: int,
        dof: int,
        q: wp.float64,
        moved: float,
        start_velocity: float,
        turn_away: wp.vec3,
        rest_away: wp.vec3,
        h: float,
    ):
        """What is linear in the coordinate, ``joint_f`` aside, and its curvature."""
        index = joints.dof_start[joint] + dof
        force = 0.0
        stiffness = 0.0
        if wp.static(effects.drives and not effects.effort_limits):
            away = away_from(control.target_q, joints, joint, dof, q, turn_away)
            pull, k = drive(joints, control, index, away, moved, h)
            force += pull
            stiffness += k
        if wp.static(effects.pushed_axes):
            pull, k = pushed(control, index, q, moved, h)
            force += pull
            stiffness += k
        if wp.static(effects.springs):
            rest = away_from(joints.rest_q, joints, joint, dof, q, rest_away)
            pull, k = passive(joints, index, rest, moved, h)
            force += pull
            stiffness += k
        if wp.static(effects.armature):
            pull, k = reflected(joints, index, start_velocity, moved, h)
            force += pull
            stiffness += k
        if wp.static(effects.limits and effects.compliance):
            pull, k = compliant_limit(joints, index, wp.float32(q), moved, start_velocity, h)
            force += pull
            stiffness += k
        return force, stiffness

    @wp.func
    def limited_drive(
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        joint: int,
        dof: int,
        q: wp.float64,
        moved: float,
        turn_away: wp.vec3,
        h: float,
    ):
        """Generalized force of what has a limit [N or N m], its curvature, and the limit's ends."""
        index = joints.dof_start[joint] + dof
        pull = 0.0
        stiffness = 0.0
        if wp.static(effects.drives):
            away = away_from(control.target_q, joints, joint, dof, q, turn_away)
            pull, stiffness = drive(joints, control, index, away, moved, h)
        most = most_effort(joints, index)
        least = -most
        if wp.static(effects.pushed_axes):
            more, k = pushed_within(control, index, q, moved, h)
            pull += more
            stiffness += k
            if wp.static(effects.force_ranges):
                more, k = ranged(control, index, q, moved, h)
                pull += more
                stiffness += k
            least = wp.max(least, control.pushes[index].least)
            most = wp.min(most, control.pushes[index].most)
        return pull, stiffness, least, most

    @wp.func
    def stops(
        joints: wp.ref[JointModel], dof: int, q: wp.float64, moved: float, recovery: float, h: float
    ):
        """Steps from the coordinate to the ends of the interval that it is held in [m or rad].

        Limits beat velocity limits.
        """
        lower = float(-wp.inf)
        upper = float(wp.inf)
        if wp.static(effects.velocity_limits):
            limit = joints.velocity_limit[dof]
            if limit > 0.0 and limit < NO_LIMIT:
                lower = -h * limit - moved
                upper = h * limit - moved
        if wp.static(effects.hard_limits):
            # what a difference of angles rounds is a velocity in a short step
            to_lower = wp.float32(wp.float64(joints.limit_lower[dof]) - q)
            to_upper = wp.float32(wp.float64(joints.limit_upper[dof]) - q)
            least = to_lower - left_beyond(to_lower + moved, recovery)
            most = to_upper + left_beyond(-moved - to_upper, recovery)
            lower = wp.clamp(lower, least, most)
            upper = wp.clamp(upper, least, most)
        return lower, upper

    @wp.func
    def law_of(
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        history: wp.ref[History],
        joint: int,
        dof: int,
        q: wp.float64,
        moved: float,
        turn_away: wp.vec3,
        recovery: float,
        h: float,
    ) -> AxisLaw:
        """The law of an axis about its coordinate, and the piece that it is taken to be on.

        A piece says which stop holds (-1 the lower, 1 the upper; times :data:`LEANING` one that has
        let go), which limit the drive is at and which way friction pushes; 0 where none does, for
        friction where it holds.
        """
        index = joints.dof_start[joint] + dof
        known = history.piece[index]
        side = 0
        limit = 0
        slip = 1
        law = AxisLaw()
        law.least = -wp.inf
        law.most = wp.inf
        if wp.static(effects.stops or (effects.joint_friction and effects.closures)):
            law.slack = wp.min(LEAN * wp.max(1.0, wp.abs(wp.float32(q))), LEAN_RATE * h * h)
        if wp.static(effects.stops):
            lower, upper = stops(joints, index, q, moved, recovery, h)
            law.lower = lower
            law.upper = upper
            side = known[0]
            if wp.abs(side) == LEANING:
                away = wp.where(side < 0, law.lower, law.upper)
                if wp.abs(away) > law.slack:
                    side = 0
                    history.piece[index] = wp.vec3i(0, known[1], known[2])
            if side == 0 and law.lower > 0.0:
                side = -1
            if side == 0 and law.upper < 0.0:
                side = 1
        if wp.static(effects.joint_friction):
            law.hold = wp.float32(history.held_at[index] - q)
            law.friction = most_friction(joints, joint, index)
            if law.friction > 0.0:
                slip = known[2]
                if recovery > 0.0 and slip == 0 and wp.abs(side) != 1:
                    # old errors go whatever friction holds
                    slip = int(YIELDING)
        if wp.static(effects.effort_limits):
            pull, stiffness, least, most = limited_drive(
                joints, control, joint, dof, q, moved, turn_away, h
            )
            law.drive = pull
            law.drive_stiffness = stiffness
            law.least = least
            law.most = most
            if wp.isfinite(least) or wp.isfinite(most):
                limit = known[1]
        law.piece = wp.vec3i(side, limit, slip)
        if wp.static(effects.effort_limits):
            if is_held(law):
                # where it is held the force of the drive is known
                law.piece = wp.vec3i(side, limit_at(law, held_step(law)), slip)
        return law

    return together(
        linear_force, limited_drive, compliant_limit, stops, law_of, next_piece=next_piece
    )
