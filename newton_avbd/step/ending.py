# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a step does after its sweeps: it keeps what rows push with, then velocities, then poses."""

import warp as wp

from ..algebra.so3 import exp_quat, turned_inertia
from ..blocks.body import carried_roll, origin_shift, renormalised, rolled, turned
from ..data import History, Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows import contact as contact_rows
from ..rows import ramp as ramp_rows
from ..rows import spin as spin_rows
from ..rows.dahl import keep_dahl
from ..rows.joint import ROD
from .anchors import is_linked
from .beginning import is_in_tree, make_coasting
from .block_start import UNKNOWN
from .bodies import body_at, has_rows, pose_sum, report_held
from .carrying import carry_flight, carry_turn, carry_velocity, is_short, less_one
from .contacts import size_of
from .islands import TOUCHING, is_alone, is_moved_island, turn_with_island
from .loops import has_loops
from .needles import is_needle
from .piles import lasting_share, row_count, row_of
from .slopes import end_axis

HELD = wp.constant(0.5)
"""Share of its free acceleration below which a body is held by what it pushes."""


def make_remember(
    effects: Effects, contact_force: wp.Function, gap_of: wp.Function, join: wp.Function
) -> wp.Function:
    """Device function that keeps what a body's rows push with for the next step.

    ``join`` notes that two bodies push each other.
    """
    coasting_increment = make_coasting(effects)

    @wp.func
    def remember_rows(
        body: int,
        side: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        s: wp.ref[Solver],
    ):
        """The last dual update of the rows that a body owns, kept for the next step."""
        h = scale.step
        s.history.start[side, body] = s.rows.owned_start[body]
        s.history.end[side, body] = s.rows.owned_end[body]
        joined = int(-1)
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            row = s.rows.rows[i]
            span = s.work.com[body] - s.work.com[row.b]
            u = contact_rows.slip(row, s.work.increment[body], s.work.increment[row.b], span)
            if wp.static(effects.drift):
                u += s.rows.drift[i]
            if wp.static(effects.ramp):
                push, _k = ramp_rows.force_and_stiffness(row, u, s.rows.damping[i], h)
                s.history.records[side, i].penalty = row.k_n
                s.rows.rows[i].force = push
            else:
                push = contact_force(row, u, gap_of(row.gap, 0.0, 0.0))
                s.rows.rows[i].force = push
                f_n = wp.dot(row.normal, push)
                if wp.static(effects.angular_friction):
                    turn = wp.spatial_bottom(s.work.increment[row.b] - s.work.increment[body])
                    if wp.static(effects.second_order):
                        turn -= wp.spatial_bottom(s.work.lead[row.b] - s.work.lead[body])
                    if wp.static(effects.put_bodies):
                        turn += wp.spatial_bottom(s.work.put[row.b])
                    torque = spin_rows.torque(s.rows.spin[i], row.normal, turn, f_n)
                    s.rows.spin[i].torque = torque
                if wp.static(effects.pairs):
                    # a row that has let go by now may have pushed one of them in the last sweep
                    is_joining = wp.length_sq(push) > 0.0
                    is_joining = is_joining or (row.k_n > 0.0 and s.work.inv_mass[row.b] > 0.0)
                    if row.b != joined and is_joining:
                        joined = row.b
                        join(body, joined, TOUCHING, s)
                if wp.static(not effects.compliance):
                    coasting = contact_rows.slip(
                        row,
                        coasting_increment(s.work, body_qd, row.a, h),
                        coasting_increment(s.work, body_qd, row.b, h),
                        span,
                    )
                    change = wp.dot(row.normal, u - coasting)
                    if change > scale.slop:
                        mass = contact_rows.effective_mass(
                            row.normal,
                            row.arm,
                            row.arm + span,
                            s.work.inv_mass[row.a] + s.work.inv_mass[row.b],
                            s.work.inv_inertia[row.a],
                            s.work.inv_inertia[row.b],
                        )
                        push = contact_rows.lasting_force(row.normal, push, mass, change, h)
                    if wp.static(effects.piles):
                        most = f_n * lasting_share(row, s)
                        kept = wp.dot(row.normal, push)
                        if kept > most:
                            push *= most / kept
                if wp.static(effects.restitution):
                    if s.rows.impacts[i].total > 0.0:
                        push = wp.vec3(0.0)
                if wp.static(effects.angular_friction):
                    lasting = wp.dot(row.normal, push) / wp.max(f_n, 1.0e-30)
                    s.history.torque[side, i] = lasting * s.rows.spin[i].torque
                size = size_of(s.work, body, row.arm)
                s.history.records[side, i].force = contact_rows.kept_force(push, size, scale)

    return remember_rows


def make_end(effects: Effects, count_turns: wp.Function) -> Functions:
    """Device functions that read velocities and poses off increments.

    ``count_turns`` remembers turns of a body's joint that its pose does not tell.
    """
    coasting_increment = make_coasting(effects)

    @wp.func
    def has_no_joints(rank: int, s: wp.ref[Solver]) -> bool:
        """Whether no joint holds the body of this rank."""
        result = bool(True)
        if wp.static(effects.joints):
            result = not is_in_tree(rank, s)
        if wp.static(effects.loops):
            result = result and not has_loops(s.loops, body_at(rank, s.worlds))
        return result

    @wp.func
    def would_touch(body: int, s: wp.ref[Solver]) -> bool:
        """Whether a body that goes where it would without contacts is held by one."""
        target = s.work.target[body]
        for k in range(row_count(body, s.rows)):
            row = s.rows.rows[row_of(body, k, s.rows)]
            span = s.work.com[row.a] - s.work.com[row.b]
            u = wp.vec3(0.0)
            if row.a == body:
                u = contact_rows.slip(row, target, s.work.increment[row.b], span)
            else:
                u = contact_rows.slip(row, s.work.increment[row.a], target, span)
            if wp.dot(row.normal, u) + wp.max(row.gap, 0.0) < 0.0:
                return True
        return False

    @wp.func
    def is_touched_by(body: int, s: wp.ref[Solver]) -> bool:
        """Whether contacts have pushed a body, or a needle should have been pushed."""
        if wp.static(not effects.contact):
            return False
        if wp.static(effects.ramp):
            return has_rows(s.rows, body)
        if wp.static(effects.needles):
            if is_needle(body, wp.inf, s):
                if would_touch(body, s):
                    return True
        if wp.static(effects.pairs):
            return has_rows(s.rows, body) and not is_alone(s.islands, body)
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            if wp.length_sq(s.rows.rows[i].force) > 0.0:
                return True
        return False

    @wp.func
    def pushes_others(body: int, s: wp.ref[Solver]) -> bool:
        """Whether a body and others that move push each other."""
        for k in range(row_count(body, s.rows)):
            row = s.rows.rows[row_of(body, k, s.rows)]
            if s.work.inv_mass[row.b] > 0.0 and wp.length_sq(row.force) > 0.0:
                return True
        return False

    @wp.func
    def flies(body: int, h: float, history: wp.ref[History]) -> bool:
        """Whether a body flew in a step in which rounding is carried."""
        if wp.static(effects.carried_rounding):
            return is_short(h) and history.flying[body] != 0
        return False

    @wp.func
    def end_velocity(
        rank: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        has_islands: bool,
        s: wp.ref[Solver],
    ) -> wp.spatial_vector:
        """Velocity of the body of this rank, which moves, from its increment itself.

        Where islands have been given their momentum back, joints go along.
        """
        body = body_at(rank, s.worlds)
        step = scale.step
        if wp.static(effects.needles):
            # what sweeps have not finished is spin about the axis, where nothing pushes at last
            if is_needle(body, wp.inf, s) and not is_touched_by(body, s):
                s.work.increment[body] = s.work.target[body]
        increment = s.work.increment[body]
        coasting = coasting_increment(s.work, body_qd, body, step)
        free = wp.spatial_top(s.work.target[body] - coasting)
        got = wp.spatial_top(increment - coasting)
        if wp.static(effects.joints):
            s.history.acceleration[body] = (increment - coasting) / (step * step)
        s.history.gained[body] = got / (step * step)
        if wp.static(effects.pairs):
            if wp.dot(got, free) < HELD * wp.dot(free, free) and has_no_joints(rank, s):
                if pushes_others(body, s):
                    # of a pile that is what sweeps had not finished, and would go on next time
                    s.history.gained[body] = wp.vec3(0.0)
        velocity = increment / step
        if wp.static(effects.second_order):
            velocity = (increment - s.work.lead[body]) / step
        if wp.static(effects.carried_rounding):
            if is_short(scale.h):
                rounded = wp.spatial_vector()
                if wp.static(effects.joints):
                    rounded = s.work.rounded[body]
                velocity = carry_velocity(body, velocity, rounded, scale, body_qd, s)
        if wp.static(effects.gyroscopic):
            turn = wp.spatial_bottom(increment)
            spin = wp.spatial_bottom(velocity)
            if has_no_joints(rank, s):
                if is_touched_by(body, s):
                    spin += carried_roll(turn, s.work.inv_inertia[body]) / step
                elif not flies(body, scale.h, s.history):
                    end = turned(s.work.pose[body], increment)
                    spin = turned_inertia(end, s.model.inv_inertia[body], s.work.momentum[body])
            if wp.static(effects.tilting):
                if wp.length_sq(s.work.spin_momentum[body]) > 0.0:
                    free = wp.spatial_bottom(s.work.target[body])
                    spin += (wp.quat_rotate(exp_quat(turn - free), free) - free) / step
            velocity = wp.spatial_vector(wp.spatial_top(velocity), spin)
        if wp.static(effects.joints and effects.pairs and not effects.ramp):
            if has_islands and is_moved_island(s.islands, body, -1):
                if not has_no_joints(rank, s):
                    turn_with_island(body, s)
        return velocity

    @wp.func
    def end_armature(
        joint: int,
        first: int,
        coordinate: wp.array[wp.float64],
        start_coordinate: wp.array[wp.float64],
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """How fast the coordinates of a joint have changed, the ``first`` and those after it."""
        k = int(first)
        for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
            s.history.axis_velocity[dof] = UNKNOWN
            if s.joints.enabled[joint]:
                rate = wp.float32(coordinate[k] - start_coordinate[k]) / scale.step
                s.history.axis_velocity[dof] = rate
                if wp.static(effects.second_order):
                    led = wp.float64(s.tree.start_velocity[dof])
                    end_axis(dof, led, wp.float64(rate), scale, s.history.rate)
            k += 1
        for end in range(2):
            body = wp.where(end == 0, s.joints.child[joint], s.joints.parent[joint])
            if body >= 0:
                velocity = body_qd[body]
                if s.work.inv_mass[body] > 0.0:
                    velocity = step.body_qd_out[body]
                s.history.joined_qd[joint, end] = velocity

    @wp.func
    def end_pose(rank: int, h: float, s: wp.ref[Solver]) -> wp.transform:
        """Pose of the body of this rank, which moves; where it was if that is not finite."""
        body = body_at(rank, s.worlds)
        pose = s.work.pose[body]
        increment = s.work.increment[body]
        rotation = wp.quat_identity()
        is_turned = bool(False)
        if wp.static(effects.joints):
            is_turned = is_in_tree(rank, s)
            if wp.static(effects.loops):
                is_turned = is_turned or has_loops(s.loops, body)
            rotation = renormalised(s.tree.rotation[body])
            if wp.static(effects.carried_rounding):
                if is_turned and is_short(h):
                    began = wp.transform_get_rotation(pose)
                    rotation = carry_turn(body, began, rotation, s)
            if wp.static(effects.kinds.angles):
                if is_linked(body, s):
                    count_turns(body, s)
            if wp.static(effects.dahl):
                joint = s.tree.joint[body]
                if joint >= 0:
                    if s.joints.type[joint] == ROD:
                        first = s.tree.axis_start[body] + 3
                        keep_dahl(
                            joint,
                            first,
                            s.tree.coordinate,
                            s.tree.start_coordinate,
                            s.joints,
                            s.history,
                        )
        if not is_turned:
            rotation = turned(pose, increment)
            if wp.static(effects.gyroscopic):
                if is_touched_by(body, s):
                    rotation = rolled(pose, increment, s.work.inv_inertia[body])
        shift = origin_shift(pose, s.model.com[body], increment, rotation)
        is_flown = flies(body, h, s.history)
        if wp.static(effects.joints):
            if not is_flown:
                shift += s.history.lost[body]
        before = wp.transform_get_translation(pose)
        after = before + shift
        moved = wp.transform(after, rotation)
        if wp.static(effects.carried_rounding):
            if is_flown:
                swing = exp_quat(wp.spatial_bottom(increment))
                further = less_one(swing) * wp.transform_get_rotation(pose)
                moved = carry_flight(body, pose, moved, shift, further, s.history.flights)
        if wp.isfinite(pose_sum(moved)):
            pose = moved
            if wp.static(effects.joints):
                s.history.left_q[body] = moved
                s.history.lost[body] = shift - (after - before)
                if is_flown:
                    s.history.lost[body] = wp.vec3(0.0)
        else:
            report_held(s.worlds, s.worlds.of_body[body])
        return pose

    return together(end_velocity, end_armature, end_pose)
