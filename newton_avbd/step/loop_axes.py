# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Free axes of a joint outside of trees: their coordinates, and what acts along them."""

import warp as wp

from ..data import Solver, Step
from ..effects import Effects
from ..functions import Functions, together
from ..rows import axis as axis_rows
from ..rows.contact import PENALTY
from ..rows.coordinate import make_joint_coordinates
from ..rows.dahl import dahl_response, keep_dahl
from ..rows.euler import make_euler
from ..rows.joint import BALL, ROD, ball_away, make_counts
from .anchors import parent_slot
from .axes import make_axis
from .rotations import ball_turn, full_turns
from .slopes import make_inputs


@wp.func
def turn_of(i: int, s: wp.ref[Solver]) -> wp.vec3:
    """As :func:`.rotations.full_turns` [rad]."""
    joint = s.loops.joints[i]
    parent = parent_slot(s.joints, joint, s.work.inv_mass.shape[0] - 1)
    return full_turns(s.joints.child[joint], parent, s.work)


@wp.struct
class BallAway:
    """How far the child of a BALL joint is turned away; zero for others [rad]."""

    target: wp.vec3
    """From where its drive wants it."""
    rest: wp.vec3
    """From where its spring is at rest."""


def make_loop_axes(effects: Effects) -> Functions:
    """Device functions of the free axes of joints outside of trees."""
    inputs = make_inputs(effects)
    ahead_along, keep_input = inputs.ahead_along, inputs.keep_input
    linear_count = make_counts(effects.kinds).linear_count
    known_angles = make_euler(effects.kinds).known_angles
    coordinates = make_joint_coordinates(effects.kinds)
    advance, angles = coordinates.advance, coordinates.angles
    coordinate = coordinates.coordinate
    axes = make_axis(effects)
    linear_force, limited_drive, stops = axes.linear_force, axes.limited_drive, axes.stops

    @wp.func(inline=effects.inline)
    def coordinate_of(
        i: int,
        dof: int,
        q_p: wp.quat,
        q_c: wp.quat,
        offset: wp.vec3,
        known: wp.float64,
        s: wp.ref[Solver],
    ) -> wp.float64:
        """Coordinate of a degree of freedom after the increments; a ball's turn in the step."""
        joint = s.loops.joints[i]
        if wp.static(effects.kinds.balls and effects.coordinates):
            if s.joints.type[joint] == BALL:
                parent = parent_slot(s.joints, joint, s.work.inv_mass.shape[0] - 1)
                turn = ball_turn(s.joints.child[joint], parent, q_p, s)
                return wp.float64(turn[dof])
        about = wp.float64(known)
        started = known_angles(s.joints, joint, s.loops.start_coordinate, s.joints.dof_start[joint])
        if dof >= linear_count(s.joints, joint):
            turn = turn_of(i, s)
            if wp.length_sq(turn) > 0.0:
                about += advance(s.joints, joint, dof, q_p, q_c, started, turn)
        turns = angles(s.joints, joint, q_p, q_c, started, False)
        return coordinate(s.joints, joint, dof, q_p, turns, offset, about)

    @wp.func
    def away_of(
        joint: int, q_p: wp.quat, q_c: wp.quat, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> BallAway:
        """As :class:`BallAway`, of the rotations of the parent's and the child's frame."""
        away = BallAway()
        if wp.static(effects.kinds.balls):
            if s.joints.type[joint] == BALL:
                if wp.static(effects.drives):
                    away.target = ball_away(step.control.target_q, s.joints, joint, q_p, q_c)
                if wp.static(effects.springs):
                    away.rest = ball_away(s.joints.rest_q, s.joints, joint, q_p, q_c)
        return away

    @wp.func
    def rod_force(joint: int, dof: int, q: wp.float64, moved: float, h: float, s: wp.ref[Solver]):
        """What a rod answers a stretch, shear, bend or twist with [N or N m], and its curvature."""
        index = s.joints.dof_start[joint] + dof
        pull, stiffness = axis_rows.rod_response(s.joints, index, wp.float32(q), moved, h)
        if wp.static(effects.dahl):
            if dof > 2:
                # its block stays the same all step long: the steepest slope
                held, _slope, steepest = dahl_response(
                    joint, dof - 3, wp.float32(q), moved, s.joints, s.history
                )
                pull += held
                stiffness += steepest
        return pull, stiffness

    @wp.func
    def axis_force(
        i: int,
        dof: int,
        q: wp.float64,
        away: BallAway,
        recovery: float,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Generalized force along a free axis without its stops, its curvature, what friction has
        in it, and what stops push with. Both are held by multipliers, stops of joints that are
        solved with a tree by rows of it (:mod:`.stop_rows`).

        In the recovery a limit that the last step has passed is where it belongs.
        """
        joint = s.loops.joints[i]
        index = s.joints.dof_start[joint] + dof
        moved = wp.float32(q - s.loops.start_coordinate[index])
        force = float(step.control.joint_f[index])
        stiffness = float(0.0)
        friction = float(0.0)
        stop = float(0.0)
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                pull, k_rod = rod_force(joint, dof, q, moved, h, s)
                return pull, k_rod, friction, stop
        if wp.static(effects.coordinates):
            start_velocity = float(0.0)
            if wp.static(effects.axis_rates):
                start_velocity = s.tree.start_velocity[index]
            pull, k = linear_force(
                s.joints,
                step.control,
                joint,
                dof,
                q,
                moved,
                start_velocity,
                away.target,
                away.rest,
                h,
            )
            force += pull
            stiffness += k
        force += ahead_along(index, s.history)
        inertia = wp.where(dof < linear_count(s.joints, joint), s.loops.k_l[i], s.loops.k_a[i])
        inertia /= wp.static(PENALTY)
        bound_force = float(0.0)
        if wp.static(effects.effort_limits):
            pull, k, least, most = limited_drive(
                s.joints, step.control, joint, dof, q, moved, away.target, h
            )
            bound_force = pull
            force += wp.clamp(pull, least, most)
            if pull > least and pull < most:
                stiffness += k
        share = inertia / (inertia + stiffness)
        keep_input(index, inertia, share, bound_force, 1.0 / (h * h), s.history)
        if wp.static(effects.joint_friction or effects.stops):
            is_linear = dof < linear_count(s.joints, joint)
            penalty = wp.where(is_linear, s.loops.k_l[i], s.loops.k_a[i])
            if wp.static(effects.joint_friction):
                most = axis_rows.most_friction(s.joints, joint, index)
                held = s.history.friction_force[index]
                friction = wp.clamp(held - penalty * moved, -most, most)
                force += friction
                # what slides faster than friction stops in a step is not held back
                if wp.abs(held) < most or penalty * wp.abs(moved) < wp.static(2.0 * PENALTY) * most:
                    stiffness += penalty
            if wp.static(effects.stops):
                held = s.history.limit_force[index]
                stop = held
                if not s.loops.is_exact[i]:
                    lower, upper = stops(s.joints, index, q, moved, recovery, h)
                    stop = wp.max(held + penalty * lower, 0.0)
                    if stop == 0.0:
                        stop = wp.min(held + penalty * upper, 0.0)
                    reach = wp.where(is_linear, s.loops.reach[i], s.loops.turn_reach[i])
                    if held != 0.0 or -reach < lower or reach > upper:
                        stiffness += penalty
        return force, stiffness, friction, stop

    @wp.func
    def count_turns(i: int, s: wp.ref[Solver]):
        """Remembers turns of a joint in the step that orientations do not tell, and hysteresis."""
        if wp.static(effects.dahl):
            joint = s.loops.joints[i]
            if s.joints.type[joint] == ROD:
                first = s.joints.dof_start[joint] + 3
                keep_dahl(
                    joint, first, s.loops.coordinate, s.loops.start_coordinate, s.joints, s.history
                )
        if wp.length_sq(turn_of(i, s)) > 0.0:
            for dof in range(
                s.joints.dof_start[s.loops.joints[i]], s.joints.dof_start[s.loops.joints[i] + 1]
            ):
                s.history.joint_angle[dof] = s.loops.coordinate[dof]

    return together(away_of, coordinate_of, rod_force, axis_force, count_turns)
