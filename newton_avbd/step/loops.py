# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints outside of trees, held by multipliers and a penalty, as contacts are.

Those are the joints that close loops, DISTANCE joints, and with ``blocks="body"`` all joints. What
is solved with a tree (``is_exact``, see :mod:`.step.closures`) has no penalty. Of the others, with
the misfit e = (e_l, e_a) beyond that of the start of the step, a joint pushes its child with

    F = P_l lambda_l - k_l e_l at the anchor,   tau = P_a lambda_a - k_a e_a,

where P projects to what the joint locks, and its parent with the opposite. The dual update is
lambda <- F, tau, after each sweep. What acts along its free axes, drives and limits, is
rows of one dimension: friction and stops have multipliers, too.
"""

from dataclasses import dataclass

import warp as wp

from ..blocks.tree import geometric_stiffness
from ..data import LoopWork, Solver, Step, WorldScale
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows.contact import PENALTY
from ..rows.coordinate import make_joint_coordinates
from ..rows.dahl import dahl_response, keep_dahl
from ..rows.euler import make_euler
from ..rows.free_axes import make_free_axes
from ..rows.joint import BALL, DISTANCE, ROD, ball_away, is_string, make_counts
from ..rows.lock import make_locks
from ..rows.rod import rod_stiffness, rod_torque
from .anchors import (
    ROUNDING,
    anchor_arm,
    anchor_offset,
    anchor_rotation,
    carried_misfit,
    parent_slot,
    start_span,
)
from .axes import make_axis
from .rotations import ball_turn, full_turns
from .slopes import begin_axis, make_inputs

STALE = wp.constant(0.5)
"""Turn of an end in a step from which a joint that is solved with a tree forgets what it pushed
with [rad]: what rows that imply each other push each other with would turn against others."""
MOST_TURNED = wp.constant(0.2)
"""By how much closing an open joint may turn its bodies, or a string, in a step [rad], unless it is
solved with a tree: blocks stay those of the start of the step, and what turns further diverges."""
ASIDE = wp.constant(1.0e3)
"""Length of a DISTANCE joint, as a multiple of what the recovery closes elsewhere, from which its
curvature is along itself only. Others are pulled aside: with 30 chains of five diverge."""
COINCIDENT = wp.constant(1.0e-9)
"""Anchors of a DISTANCE joint that are closer have no direction [m]."""


@wp.func
def mean_inverse(inv_inertia: wp.mat33) -> float:
    """What a torque does to the spin, in the mean over all directions [1/(kg m^2)]."""
    return wp.static(1 / 3) * wp.trace(inv_inertia)


@wp.func
def has_loops(loops: wp.ref[LoopWork], body: int) -> bool:
    """Whether a joint outside of the trees acts on the body."""
    return loops.body_start[body] < loops.body_start[body + 1]


@wp.func
def has_outer_loops(body: int, loops: wp.ref[LoopWork]) -> bool:
    """Whether a joint acts on the body that is not solved with its tree."""
    for k in range(loops.body_start[body], loops.body_start[body + 1]):
        if not loops.is_exact[loops.items[k] / 2]:
            return True
    return False


@wp.func
def ties(i: int, s: wp.ref[Solver]) -> bool:
    """Whether a joint outside of the trees makes one island of its bodies: no slack string does."""
    joint = s.loops.joints[i]
    if is_string(s.joints, joint):
        return wp.length_sq(s.history.loop_force[i]) > 0.0
    return s.joints.enabled[joint]


@wp.func
def loop_geometry(i: int, s: wp.ref[Solver]):
    """Rotations of a joint's anchors after the increments, arms, and child anchor from parent's."""
    static_slot = s.work.inv_mass.shape[0] - 1
    joint = s.loops.joints[i]
    child = s.joints.child[joint]
    parent = parent_slot(s.joints, joint, static_slot)
    frame_p = s.joints.parent_frame[joint]
    frame_c = s.joints.child_frame[joint]
    arm_p = anchor_arm(parent, frame_p, static_slot, s)
    arm_c = anchor_arm(child, frame_c, static_slot, s)
    offset = anchor_offset(s.loops.apart[i], s.work, child, parent, arm_c, arm_p)
    q_p = anchor_rotation(s.tree, parent, frame_p)
    q_c = anchor_rotation(s.tree, child, frame_c)
    return q_p, q_c, arm_p, arm_c, offset


@wp.func
def reach_farther(i: int, closing: float, s: wp.ref[Solver]):
    """Expects that the recovery pulls at a DISTANCE joint where joints of its world close [m]."""
    if s.joints.type[s.loops.joints[i]] == DISTANCE:
        s.loops.reach[i] += ASIDE * closing


@wp.func
def left_open(i: int, recovery: float, loops: wp.ref[LoopWork]) -> float:
    """Share of how far a joint was open at the start of the step that a sweep leaves.

    The motion leaves all of it, so that it does not enter the velocity; the recovery takes it out.
    """
    return wp.where(recovery > 0.0, 1.0 - loops.recovered[i], 1.0)


@wp.func
def share_recovered(
    shift: float,
    turn: float,
    length: float,
    arm_c: wp.vec3,
    arm_p: wp.vec3,
    child: int,
    parent: int,
    s: wp.ref[Solver],
) -> float:
    """Share of an open joint that a step closes: what turns nothing by :data:`MOST_TURNED`.

    Args:
        shift: How far the joint is open [m].
        turn: By what angle [rad].
        length: What a DISTANCE joint is to have then [m]; infinite for others.
        arm_c: From the COM of the child to its anchor [m].
        arm_p: Likewise of the parent.
        child: Slot of the child.
        parent: Slot of the parent.
        s: The solver.
    """
    turns_c = mean_inverse(s.work.inv_inertia[child])
    turns_p = mean_inverse(s.work.inv_inertia[parent])
    yields = s.work.inv_mass[child] + turns_c * wp.length_sq(arm_c)
    yields += s.work.inv_mass[parent] + turns_p * wp.length_sq(arm_p)
    rate = wp.max(turns_c * wp.length(arm_c), turns_p * wp.length(arm_p)) / yields
    joints_c = s.loops.body_start[child + 1] - s.loops.body_start[child]
    joints = wp.max(joints_c, s.loops.body_start[parent + 1] - s.loops.body_start[parent])
    if joints > 1:
        # others pull the string aside
        rate = float(joints) * wp.max(rate, 1.0 / wp.max(length, 1.0e-12))
    return wp.min(1.0, MOST_TURNED / wp.max(rate * shift + turn, 1.0e-30))


@wp.func
def bound_of(i: int, limit: float, start: float, recovery: float, loops: wp.ref[LoopWork]) -> float:
    """Where a bound of a DISTANCE joint holds it that started at or beyond it [m]."""
    return limit + left_open(i, recovery, loops) * (start - limit)


@wp.func
def beyond_bounds(i: int, s: wp.ref[Solver]) -> float:
    """How much longer than its upper bound a DISTANCE joint starts [m]; negative where shorter than
    its lower one."""
    index = s.joints.dof_start[s.loops.joints[i]]
    start = wp.float32(s.loops.start_coordinate[index])
    if start < s.joints.limit_lower[index]:
        return start - s.joints.limit_lower[index]
    # an upper bound of 0 is no direction to pull in, but locked
    if s.joints.limit_upper[index] > 0.0 and start > s.joints.limit_upper[index]:
        return start - s.joints.limit_upper[index]
    return 0.0


@wp.func
def distance_force(i: int, length: float, held: float, recovery: float, s: wp.ref[Solver]) -> float:
    """Force of a DISTANCE joint that pushes its anchors apart [N], negative where it pulls.

    ``held`` is its multiplier.
    """
    index = s.joints.dof_start[s.loops.joints[i]]
    start = wp.float32(s.loops.start_coordinate[index])
    force = float(0.0)
    lower = s.joints.limit_lower[index]
    if lower >= 0.0:
        bound = bound_of(i, lower, wp.min(start, lower), recovery, s.loops)
        force = wp.max(held + s.loops.k_l[i] * (bound - length), 0.0)
    upper = s.joints.limit_upper[index]
    if force == 0.0 and upper > 0.0:
        bound = bound_of(i, upper, wp.max(start, upper), recovery, s.loops)
        force = wp.min(held + s.loops.k_l[i] * (bound - length), 0.0)
    return force


@wp.func
def string_direction(q_p: wp.quat, arm_c: wp.vec3, offset: wp.vec3) -> wp.vec3:
    """From the parent's anchor of a DISTANCE joint to the child's.

    Where they coincide: from there to the COM of the child, and where that is there, too, the X
    axis of the parent's anchor, as in SolverXPBD.
    """
    if wp.length_sq(offset) > COINCIDENT * COINCIDENT:
        return wp.normalize(offset)
    if wp.length_sq(arm_c) > COINCIDENT * COINCIDENT:
        return -wp.normalize(arm_c)
    return wp.quat_rotate(q_p, wp.vec3(1.0, 0.0, 0.0))


@wp.func
def turn_of(i: int, s: wp.ref[Solver]) -> wp.vec3:
    """As :func:`.rotations.full_turns` [rad]."""
    joint = s.loops.joints[i]
    parent = parent_slot(s.joints, joint, s.work.inv_mass.shape[0] - 1)
    return full_turns(s.joints.child[joint], parent, s.work)


@dataclass(frozen=True)
class LoopFunctions:
    """Device functions of joints outside of trees, compiled for the joints of a scene."""

    begin_loop: wp.Function
    loop_wrench: wp.Function
    loop_curvature: wp.Function
    count_turns: wp.Function


def make_loops(effects: Effects) -> LoopFunctions:
    """Device functions: how a joint stands, its wrench on its child, its share of a block."""
    ahead_along, keep_input = make_inputs(effects)[2:]
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    known_angles = make_euler(effects.kinds).known_angles
    locks = make_locks(effects.kinds)
    linear_misfit, linear_lock = locks.linear_misfit, locks.linear_lock
    angular_misfit, angular_lock = locks.angular_misfit, locks.angular_lock
    axis_of = make_free_axes(effects.kinds).axis_of
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

    @wp.func(inline=effects.inline)
    def begin_loop(i: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Misfit, coordinates and penalties of a joint at the start of the step.

        Expects increments of zero and rotations at the start of the step. Returns whether the joint
        is open by more than rounding.
        """
        h = scale.step
        joint = s.loops.joints[i]
        static_slot = scale.static_slot
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, static_slot)
        s.loops.apart[i] = start_span(child, parent, s.joints.parent_frame[joint], static_slot, s)
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        shift = linear_misfit(s.joints, joint, q_p, offset)
        turn = angular_misfit(s.joints, joint, q_p, q_c)
        if s.work.inv_mass[parent] == 0.0:
            misfit = carried_misfit(parent, arm_p, shift, turn, s)
            shift = linear_misfit(s.joints, joint, q_p, wp.spatial_top(misfit))
            turn = angular_lock(s.joints, joint, q_p, q_c) * wp.spatial_bottom(misfit)
        s.loops.misfit[i] = wp.spatial_vector(shift, turn)
        s.loops.closing[i] = 0.0
        open_by = wp.length(shift)
        span = float(wp.inf)
        turning = wp.length(wp.spatial_bottom(s.work.target[child]))
        turning += wp.length(wp.spatial_bottom(s.work.target[parent]))
        moving = wp.length(wp.spatial_top(s.work.target[child]))
        moving += wp.length(wp.spatial_top(s.work.target[parent]))
        s.loops.turn_reach[i] = 2.0 * turning
        s.loops.reach[i] = 2.0 * (moving + turning * (wp.length(arm_c) + wp.length(arm_p)))
        inv_mass = s.work.inv_mass[child] + s.work.inv_mass[parent]
        inv_inertia = mean_inverse(s.work.inv_inertia[child] + s.work.inv_inertia[parent])
        s.loops.k_l[i] = 0.0
        s.loops.k_a[i] = 0.0
        if not s.joints.enabled[joint] or inv_mass == 0.0:
            s.history.loop_force[i] = wp.vec3(0.0)
            s.history.loop_torque[i] = wp.vec3(0.0)
            return False
        turn_c = wp.length_sq(wp.spatial_bottom(s.work.target[child]))
        turn_p = wp.length_sq(wp.spatial_bottom(s.work.target[parent]))
        if s.loops.is_exact[i] and wp.max(turn_c, turn_p) > STALE * STALE:
            s.history.loop_force[i] = wp.vec3(0.0)
            s.history.loop_torque[i] = wp.vec3(0.0)
        s.loops.kept_force[i] = s.history.loop_force[i]
        s.loops.kept_torque[i] = s.history.loop_torque[i]
        s.loops.k_l[i] = PENALTY / (inv_mass * h * h)
        s.loops.k_a[i] = PENALTY / (inv_inertia * h * h)
        # one end kinematic, the other where the last step left it
        is_carried = parent != static_slot
        if s.work.inv_mass[parent] == 0.0:
            is_carried = is_carried and s.tree.is_left[child]
        elif s.work.inv_mass[child] == 0.0:
            is_carried = is_carried and s.tree.is_left[parent]
        else:
            is_carried = False
        is_open = bool(False)
        linear = linear_count(s.joints, joint)
        if s.joints.type[joint] == DISTANCE:
            index = s.joints.dof_start[joint]
            length = wp.length(offset)
            s.loops.start_coordinate[index] = wp.float64(length)
            rounding = ROUNDING * (wp.length(s.work.com[child]) + length)
            lower = s.joints.limit_lower[index]
            upper = s.joints.limit_upper[index]
            is_open = length < lower - rounding or (upper >= 0.0 and length > upper + rounding)
            beyond = beyond_bounds(i, s)
            open_by = wp.max(open_by, wp.abs(beyond))
            span = length - beyond
        else:
            known = known_angles(s.joints, joint, s.history.joint_angle, s.joints.dof_start[joint])
            turns = angles(s.joints, joint, q_p, q_c, known, False)
            for dof in range(linear + angular_count(s.joints, joint)):
                index = s.joints.dof_start[joint] + dof
                q = coordinate(
                    s.joints, joint, dof, q_p, turns, offset, s.history.joint_angle[index]
                )
                s.history.joint_angle[index] = q
                if is_carried and s.joints.type[joint] != BALL:
                    # a kinematic body has been put elsewhere since: what damps feels its motion
                    q = s.loops.coordinate[index]
                if wp.static(effects.second_order):
                    q = begin_axis(index, q, scale, s.history.coordinate)
                s.loops.start_coordinate[index] = q
        s.loops.recovered[i] = 1.0
        if not s.loops.is_exact[i]:
            s.loops.recovered[i] = share_recovered(
                open_by, wp.length(turn), span, arm_c, arm_p, child, parent, s
            )
        reach = wp.length(arm_c) + wp.length(arm_p)
        s.loops.closing[i] = s.loops.recovered[i] * (open_by + reach * wp.length(turn))
        allowed = ROUNDING * (wp.length(s.work.com[child]) + reach)
        error = wp.length_sq(shift) + reach * reach * wp.length_sq(turn)
        return is_open or error > allowed * allowed

    @wp.func
    def axis_force(
        i: int,
        dof: int,
        q: wp.float64,
        turn_away: wp.vec3,
        rest_away: wp.vec3,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Generalized force along a free axis, its curvature, and what friction and stops have in
        it, which are held by multipliers."""
        joint = s.loops.joints[i]
        index = s.joints.dof_start[joint] + dof
        moved = wp.float32(q - s.loops.start_coordinate[index])
        force = float(step.control.joint_f[index])
        stiffness = float(0.0)
        friction = float(0.0)
        stop = float(0.0)
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                pull, k_rod = axis_rows.rod_response(s.joints, index, wp.float32(q), moved, h)
                if wp.static(effects.dahl):
                    if dof > 2:
                        # its block stays the same all step long: the steepest slope
                        held, _slope, steepest = dahl_response(
                            joint, dof - 3, wp.float32(q), moved, s.joints, s.history
                        )
                        pull += held
                        k_rod += steepest
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
                turn_away,
                rest_away,
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
                s.joints, step.control, joint, dof, q, moved, turn_away, h
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
                lower, upper = stops(s.joints, index, q, moved, 0.0, h)
                held = s.history.limit_force[index]
                stop = wp.max(held + penalty * lower, 0.0)
                if stop == 0.0:
                    stop = wp.min(held + penalty * upper, 0.0)
                force += stop
                reach = wp.where(is_linear, s.loops.reach[i], s.loops.turn_reach[i])
                if held != 0.0 or -reach < lower or reach > upper:
                    stiffness += penalty
        return force, stiffness, friction, stop

    @wp.func(inline=effects.inline)
    def loop_wrench(
        i: int,
        recovery: float,
        h: float,
        has_dual: bool,
        is_whole: bool,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Force [N] at the anchor and torque [N m] of a joint on its child, and the two arms [m].

        With ``has_dual`` they become the joint's multipliers. What a joint locks whose rows are
        solved with the tree counts only if ``is_whole``: otherwise its rows are to find it.
        """
        joint = s.loops.joints[i]
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        if s.loops.k_l[i] == 0.0:
            return wp.vec3(0.0), wp.vec3(0.0), arm_c, arm_p
        if wp.static(effects.kinds.distances):
            if is_string(s.joints, joint):
                along = string_direction(q_p, arm_c, offset)
                pull = wp.dot(s.history.loop_force[i], along)
                if s.loops.is_exact[i]:
                    pull = wp.where(is_whole, pull, 0.0)
                elif has_dual or not is_whole:
                    pull = distance_force(i, wp.length(offset), pull, recovery, s)
                if has_dual:
                    s.history.loop_force[i] = pull * along
                return pull * along, wp.vec3(0.0), arm_c, arm_p
        shift = linear_misfit(s.joints, joint, q_p, offset)
        arm_p += offset - shift
        turn = angular_misfit(s.joints, joint, q_p, q_c)
        kept = left_open(i, recovery, s.loops) * s.loops.misfit[i]
        force = linear_misfit(s.joints, joint, q_p, s.history.loop_force[i])
        torque = angular_lock(s.joints, joint, q_p, q_c) * s.history.loop_torque[i]
        if not s.loops.is_exact[i]:
            force -= s.loops.k_l[i] * (shift - wp.spatial_top(kept))
            torque -= s.loops.k_a[i] * (turn - wp.spatial_bottom(kept))
        if has_dual:
            s.history.loop_force[i] = force
            s.history.loop_torque[i] = torque
        if s.loops.is_exact[i] and not is_whole:
            force = wp.vec3(0.0)
            torque = wp.vec3(0.0)
        turn_away = wp.vec3(0.0)
        rest_away = wp.vec3(0.0)
        if wp.static(effects.kinds.balls and effects.drives):
            if s.joints.type[joint] == BALL:
                turn_away = ball_away(step.control.target_q, s.joints, joint, q_p, q_c)
        if wp.static(effects.kinds.balls and effects.springs):
            if s.joints.type[joint] == BALL:
                rest_away = ball_away(s.joints.rest_q, s.joints, joint, q_p, q_c)
        if s.joints.type[joint] == DISTANCE:
            return force, torque, arm_c, arm_p
        linear = linear_count(s.joints, joint)
        started = known_angles(s.joints, joint, s.loops.start_coordinate, s.joints.dof_start[joint])
        turned = angles(s.joints, joint, q_p, q_c, started, False)
        response = wp.vec3(0.0)
        for dof in range(linear + angular_count(s.joints, joint)):
            index = s.joints.dof_start[joint] + dof
            known = s.loops.start_coordinate[index]
            q = coordinate_of(i, dof, q_p, q_c, offset, known, s)
            push, _, friction, stop = axis_force(i, dof, q, turn_away, rest_away, h, step, s)
            if has_dual and recovery == 0.0:
                s.history.limit_force[index] = stop
                if wp.static(effects.joint_friction):
                    s.history.friction_force[index] = friction
                s.loops.coordinate[index] = q
            axis = axis_of(s.joints, joint, dof, q_p, q_c, turned)
            if dof < linear:
                force += push * axis
            elif s.joints.type[joint] == ROD:
                response[dof - linear] = push
            else:
                torque += push * axis
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                torque += rod_torque(q_p, q_c, response)
        return force, torque, arm_c, arm_p

    @wp.func(inline=effects.inline)
    def loop_curvature(item: int, doubled: bool, h: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """What a joint adds to the block of one of its bodies: H_ll, H_al and H_aa."""
        i = item / 2
        joint = s.loops.joints[i]
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        shift = linear_misfit(s.joints, joint, q_p, offset)
        arm = arm_c
        sign = float(1.0)
        if item % 2 == 1:
            arm = arm_p + (offset - shift)
            sign = -1.0
        linear_k = wp.mat33(0.0)
        angular_k = wp.mat33(0.0)
        is_soft = not s.loops.is_exact[i]
        if is_soft:
            linear_k = s.loops.k_l[i] * linear_lock(s.joints, joint, q_p)
            angular_k = s.loops.k_a[i] * angular_lock(s.joints, joint, q_p, q_c)
        pulled = wp.mat33(0.0)
        if s.joints.type[joint] == DISTANCE:
            length = wp.length(offset)
            reach = s.loops.reach[i]
            along = string_direction(q_p, arm_c, offset)
            held = wp.dot(s.history.loop_force[i], along)
            beyond = beyond_bounds(i, s)
            if is_soft and (
                distance_force(i, length + reach, held, 0.0, s) != 0.0
                or distance_force(i, length - reach, held, 0.0, s) != 0.0
            ):
                # what takes out of the length what is beyond its bounds
                beyond *= s.loops.recovered[i]
                held -= (s.loops.k_l[i] / PENALTY) * beyond
                shortest = wp.min(length, length - beyond)
                curvature = wp.outer(along, along)
                if shortest < reach:
                    # within the step it may come to point anywhere
                    curvature = wp.identity(n=3, dtype=float)
                linear_k += s.loops.k_l[i] * curvature
                # what pulls turns with the string
                square = wp.identity(n=3, dtype=float) - wp.outer(along, along)
                linear_k += (wp.max(-held, 0.0) / wp.max(shortest, reach)) * square
                pulled = geometric_stiffness((sign * held) * along, arm)
        elif s.loops.k_l[i] > 0.0:
            linear = linear_count(s.joints, joint)
            started = known_angles(
                s.joints, joint, s.loops.start_coordinate, s.joints.dof_start[joint]
            )
            turned = angles(s.joints, joint, q_p, q_c, started, False)
            stiff = wp.vec3(0.0)
            for dof in range(linear + angular_count(s.joints, joint)):
                index = s.joints.dof_start[joint] + dof
                known = s.loops.start_coordinate[index]
                q = coordinate_of(i, dof, q_p, q_c, offset, known, s)
                _, stiffness, _, _ = axis_force(i, dof, q, wp.vec3(0.0), wp.vec3(0.0), h, step, s)
                is_soft = is_soft or stiffness > 0.0
                axis = axis_of(s.joints, joint, dof, q_p, q_c, turned)
                if dof < linear:
                    linear_k += stiffness * wp.outer(axis, axis)
                elif s.joints.type[joint] == ROD:
                    stiff[dof - linear] = stiffness
                else:
                    angular_k += stiffness * wp.outer(axis, axis)
            if wp.static(effects.rods):
                if s.joints.type[joint] == ROD:
                    bound = rod_stiffness(q_p, q_c, stiff)
                    for dof in range(3):
                        axis = axis_of(s.joints, joint, linear + dof, q_p, q_c, turned)
                        angular_k += bound[dof] * wp.outer(axis, axis)
        s.loops.is_soft[i] = is_soft
        if doubled:
            linear_k *= 2.0
            angular_k *= 2.0
        r = wp.skew(arm)
        al = r * linear_k
        aa = al * wp.transpose(r) + angular_k
        if not s.loops.is_exact[i]:
            aa += geometric_stiffness(sign * s.history.loop_force[i], arm) + pulled
        return linear_k, al, aa

    return LoopFunctions(begin_loop, loop_wrench, loop_curvature, count_turns)
