# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a step does with bodies and joints before its sweeps, block by block."""

import math
from typing import NamedTuple

import warp as wp

from ..algebra.block import factor_block
from ..algebra.so3 import exp_quat
from ..data import (
    NO_JOINT,
    BodyModel,
    BodyWork,
    ContactRow,
    ControlInput,
    History,
    IslandWork,
    JointModel,
    LoopWork,
    RowWork,
    TreeWork,
    WorldScale,
    WorldWork,
)
from ..effects import Effects
from ..rows import contact as contact_rows
from .bodies import body_at, has_rows
from .islands import begin_island
from .loops import LoopFunctions, has_loops, has_outer_loops
from .piles import in_pile
from .slopes import begin_axis, make_inputs
from .trees import ROUNDING, TreeFunctions, begin_turn, is_linked, parent_slot

UNKNOWN = wp.constant(math.inf)
"""Velocity of a joint's coordinate that no step has followed: disabled, or without armature."""


@wp.func
def is_tree(first: int, end: int, body: int, tree: wp.ref[TreeWork]) -> bool:
    """Whether a body belongs to a block with joints, which holds it from ``first`` to ``end``."""
    return end > first + 1 or tree.joint[body] != NO_JOINT


@wp.func
def is_in_tree(rank: int, worlds: wp.ref[WorldWork], tree: wp.ref[TreeWork]) -> bool:
    """As :func:`is_tree`, for any place in visiting order."""
    first = int(rank)
    if rank > 0:
        first = wp.where(worlds.block_end[rank - 1] == worlds.block_end[rank], rank - 1, rank)
    return is_tree(first, worlds.block_end[rank], body_at(rank, worlds), tree)


def make_coasting(effects: Effects) -> wp.Function:
    """Device function: where a body goes that nothing accelerates."""

    @wp.func
    def coasting_increment(
        work: wp.ref[BodyWork], body_qd: wp.array[wp.spatial_vector], slot: int, h: float
    ) -> wp.spatial_vector:
        """Pose increment of a body that keeps its velocity."""
        if wp.static(effects.second_order):
            return work.coasting[slot]
        if work.inv_mass[slot] == 0.0:
            return work.increment[slot]
        return h * body_qd[slot]

    return coasting_increment


class BeginFunctions(NamedTuple):
    """Device functions in the order of the step, compiled for the effects of a scene."""

    measure_blocks: wp.Function
    measure_loop: wp.Function
    place_blocks: wp.Function
    begin_body: wp.Function


@wp.func
def pushes_on(
    row: ContactRow, increment_a: wp.spatial_vector, increment_b: wp.spatial_vector, span: wp.vec3
) -> bool:
    """Whether a row pushes by these moves about as in the last step: with half of that or more, and
    with no more than twice what friction can where that held."""
    n = row.normal
    f_n = wp.dot(n, row.force)
    if f_n <= 0.0:
        return True
    u = contact_rows.slip(row, increment_a, increment_b, span)
    u_n = wp.dot(n, u)
    if row.k_n * (u_n + wp.max(row.gap, 0.0)) > 0.5 * f_n:
        return False
    if contact_rows.slid(row):
        return True
    held = row.force - f_n * n - row.k_t * (u - u_n * n)
    return wp.length(held) <= 2.0 * row.mu * f_n


@wp.func
def rest_on_fixed(
    body: int,
    step: float,
    has_pairs: bool,
    work: wp.ref[BodyWork],
    rows: wp.ref[RowWork],
):
    """Guesses that what fixed bodies push a body with stays as it was, where no others touch it.

    Without friction a guess slides, and friction that is at its cone there says little of how far
    to go back. Nor does a contact that a guess has opened, or has made slide: where it would, there
    is no such guess.
    """
    if has_pairs and rows.other_start[body] < rows.other_end[body]:
        return  # bodies that move own these rows
    force = wp.vec3(0.0)
    torque = wp.vec3(0.0)
    for i in range(rows.owned_start[body], rows.owned_end[body]):
        row = rows.rows[i]
        if work.inv_mass[row.b] > 0.0:
            return
        force -= row.force
        torque -= wp.cross(row.arm, row.force)
    if wp.length_sq(force) == 0.0:
        return
    moved = wp.spatial_vector(work.inv_mass[body] * force, work.inv_inertia[body] * torque)
    guess = work.target[body] + (step * step) * moved
    for i in range(rows.owned_start[body], rows.owned_end[body]):
        row = rows.rows[i]
        if not pushes_on(row, guess, work.increment[row.b], work.com[body] - work.com[row.b]):
            return
    work.increment[body] = guess


def make_begin(
    effects: Effects,
    trees: TreeFunctions,
    loop_functions: LoopFunctions,
    begin_closures: wp.Function,
    begin_tendons: wp.Function,
    assemble_body: wp.Function,
) -> BeginFunctions:
    """Device functions that measure joints at the start of a step and start its bodies.

    Args:
        effects: What the kernel is compiled with.
        trees: Those of joints in trees.
        loop_functions: Those of joints outside of trees.
        begin_closures: Device function that measures the mimics of a block.
        begin_tendons: Device function that measures its tendons.
        assemble_body: Device function that sums the block of a body.
    """
    coasting_increment = make_coasting(effects)
    measure_start, measure_guess = trees.measure_start, trees.measure_guess
    measure_velocity = trees.measure_velocity
    begin_loop = loop_functions.begin_loop
    begin_inputs, resists_everywhere = make_inputs(effects)[:2]
    may_be_exact = effects.second_order and (effects.drives or effects.pushed_axes)
    may_be_exact = may_be_exact and not effects.cables and not effects.tendons
    # the force of a contact that gives way, or has bounced, is not that of the next step
    may_rest = effects.contact and not (effects.compliance or effects.restitution)
    may_rest = may_rest and not effects.cables and not effects.angular_friction

    @wp.func
    def begin_armature(
        joint: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        work: wp.ref[BodyWork],
        tree: wp.ref[TreeWork],
        history: wp.ref[History],
    ):
        """Velocities of a joint's coordinates at the start of the step.

        Where the last step left the bodies they are those of that step, and what has been done to
        the bodies' velocities since: the axes have turned in the step, and along them as they stand
        now its momenta are others.
        """
        first = joints.dof_start[joint]
        end = joints.dof_start[joint + 1]
        if first == end:
            return
        child = joints.child[joint]
        parent = parent_slot(joints, joint, scale.static_slot)
        velocity = body_qd[child]
        velocity_p = wp.spatial_vector()
        if parent != scale.static_slot:
            velocity_p = body_qd[parent]
        is_known = not wp.isinf(history.axis_velocity[first])
        is_known = is_known and (tree.is_left[child] or work.inv_mass[child] == 0.0)
        is_known = is_known and (tree.is_left[parent] or work.inv_mass[parent] == 0.0)
        if is_known:
            velocity -= history.joined_qd[joint, 0]
            velocity_p -= history.joined_qd[joint, 1]
        is_new = wp.length_sq(velocity) + wp.length_sq(velocity_p) > 0.0
        if is_new:
            measure_velocity(
                joint,
                scale.static_slot,
                velocity,
                velocity_p,
                model,
                joints,
                work,
                tree,
                history,
                tree.start_velocity,
            )
        for dof in range(first, end):
            rate = float(0.0)
            if is_new:
                rate = tree.start_velocity[dof]
            if is_known:
                rate += history.axis_velocity[dof]
            tree.start_velocity[dof] = rate
            if wp.static(effects.second_order):
                led = begin_axis(dof, wp.float64(rate), scale, history.rate)
                tree.start_velocity[dof] = wp.float32(led)

    @wp.func(inline=effects.inline)
    def measure_blocks(
        first: int,
        end: int,
        scale: WorldScale,
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> bool:
        """Measures the joints of the trees of blocks at the start of the step.

        The blocks are those of the bodies from ``first`` to ``end``, whose increments are put aside
        until :func:`place_blocks`. Returns whether a joint is open.
        """
        h = scale.step
        is_open = bool(False)
        block_end = int(-1)
        is_free = bool(False)
        is_closed = bool(False)
        is_fast = bool(False)
        for i in range(first, end):
            body = body_at(i, worlds)
            tree.rotation[body] = wp.transform_get_rotation(body_q[body])
            # a pose that the user has changed has lost nothing
            tree.is_left[body] = body_q[body] == history.left_q[body]
            if not tree.is_left[body]:
                history.lost[body] = wp.vec3(0.0)
            # the guess is put aside: joints are measured at the start first
            tree.update[body] = work.increment[body]
            work.increment[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            tree.turn[body] = wp.vec3(0.0)
            tree.swing[body] = wp.quat_identity()
            if block_end != worlds.block_end[i]:
                block_end = worlds.block_end[i]
                is_free = is_tree(i, block_end, body, tree)
                if wp.static(effects.closures):
                    is_closed = tree.closures.block_of[i] >= 0
                is_fast = bool(False)
                for k in range(i, block_end):
                    if wp.static(effects.tilting):
                        spin = work.spin_momentum[body_at(k, worlds)]
                        is_fast = is_fast or wp.length_sq(spin) > 0.0
                    if wp.static(effects.contact):
                        is_free = is_free and not has_rows(rows, body_at(k, worlds))
                    if wp.static(effects.loops):
                        is_free = is_free and not has_outer_loops(body_at(k, worlds), loops)
            if wp.static(effects.second_order):
                # a taut rope, which nothing drives, is no such tree: see below
                is_exact = is_free and not is_closed
                if wp.static(not may_be_exact):
                    is_exact = False
                work.input_energy[body] = wp.where(is_exact, wp.inf, 0.0)
            if work.inv_mass[body] > 0.0:
                coasting = coasting_increment(work, body_qd, body, h)
                if is_free:
                    # keeps joints closed to the third order of h
                    tree.update[body] = coasting + (h * h) * history.acceleration[body]
                elif is_closed:
                    # keeps a mechanism in its plane, where some of its rows say nothing
                    tree.update[body] = coasting
                if wp.static(effects.tilting):
                    tree.is_fast[body] = is_fast
                if wp.static(effects.spinning):
                    if wp.length_sq(work.spin_momentum[body]) > 0.0:
                        shift = wp.spatial_top(tree.update[body])
                        turn = wp.spatial_bottom(work.target[body])
                        tree.update[body] = wp.spatial_vector(shift, turn)
        given = float(0.0)
        is_driven = bool(True)
        for i in range(first, end):
            body = body_at(i, worlds)
            radius = wp.sqrt(wp.trace(work.inertia[body]) * work.inv_mass[body])
            tree.rounding[body] = ROUNDING * radius
            if work.inv_mass[body] > 0.0 and is_linked(joints, tree, body):
                joint = tree.joint[body]
                given += begin_inputs(joint, scale, joints, control, history)
                if wp.static(may_be_exact):
                    is_driven = is_driven and resists_everywhere(joint, joints, history)
                if measure_start(body, scale, body_q, model, joints, work, tree, history):
                    is_open = True
                if wp.static(effects.axis_rates):
                    begin_armature(
                        joint,
                        scale,
                        body_qd,
                        model,
                        joints,
                        work,
                        tree,
                        history,
                    )
            if wp.static(effects.second_order):
                if i + 1 == worlds.block_end[i]:
                    k = int(i)
                    while k >= first and worlds.block_end[k] == i + 1:
                        other = body_at(k, worlds)
                        if not is_driven:
                            work.input_energy[other] = 0.0
                        work.input_energy[other] = work.input_energy[other] + given
                        k -= 1
                    given = 0.0
                    is_driven = True
        return is_open

    @wp.func
    def measure_loop(
        i: int,
        scale: WorldScale,
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        work: wp.ref[BodyWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> bool:
        """Measures a joint outside of the trees, once the blocks are; whether it is open."""
        joint = loops.joints[i]
        begin_inputs(joint, scale, joints, control, history)
        if wp.static(effects.axis_rates):
            begin_armature(
                joint,
                scale,
                body_qd,
                model,
                joints,
                work,
                tree,
                history,
            )
        return begin_loop(i, scale, body_q, model, joints, work, tree, loops, history)

    @wp.func(inline=effects.inline)
    def place_blocks(
        first: int,
        end: int,
        scale: WorldScale,
        body_q: wp.array[wp.transform],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        tree: wp.ref[TreeWork],
        history: wp.ref[History],
    ) -> bool:
        """Puts blocks to the guess of their increments.

        Returns whether a mimic joint is open, or a tendon beyond its limits.
        """
        is_open = bool(False)
        if wp.static(effects.tendons):
            for i in range(first, end):
                if begin_tendons(i, scale, body_q, model, joints, work, tree, history):
                    is_open = True
        if wp.static(effects.mimics):
            for i in range(first, end):
                if begin_closures(i, joints, tree, history):
                    is_open = True
        for i in range(first, end):
            body = body_at(i, worlds)
            work.increment[body] = tree.update[body]
            if work.inv_mass[body] > 0.0:
                turn = wp.vec3(0.0)
                if wp.static(effects.spinning):
                    if wp.length_sq(work.spin_momentum[body]) > 0.0:
                        turn = wp.spatial_bottom(work.increment[body])
                begin_turn(body, turn, body_q, work, tree)
            else:
                tree.swing[body] = exp_quat(wp.spatial_bottom(work.increment[body]))
                tree.update[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        if wp.static(effects.coordinates):
            for i in range(first, end):
                body = body_at(i, worlds)
                if work.inv_mass[body] > 0.0 and is_linked(joints, tree, body):
                    measure_guess(body, scale.static_slot, model, joints, work, tree, history)
        return is_open

    @wp.func
    def begin_body(
        rank: int,
        step: float,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        islands: wp.ref[IslandWork],
        history: wp.ref[History],
    ) -> bool:
        """Sums the block of the body of this rank, or puts the body to its target.

        Returns whether sweeps are to move it.
        """
        body = body_at(rank, worlds)
        is_touched = bool(False)
        is_jointed = bool(False)
        if wp.static(effects.pairs):
            begin_island(islands, body)
        if wp.static(effects.contact):
            is_touched = has_rows(rows, body)
        if wp.static(effects.loops):
            is_touched = is_touched or has_loops(loops, body)
        if wp.static(effects.joints):
            tree.is_touched[body] = is_touched
            is_jointed = is_in_tree(rank, worlds, tree)
        if is_touched and wp.static(not effects.ramp):
            h_ll, h_al, h_aa = assemble_body(
                body,
                step,
                model,
                joints,
                control,
                worlds,
                work,
                rows,
                tree,
                loops,
                history,
            )
            if is_jointed:
                if wp.static(effects.joints):
                    tree.own_ll[body] = h_ll
                    tree.own_al[body] = h_al
                    tree.own_aa[body] = h_aa
            else:
                is_alone = bool(True)
                if wp.static(effects.piles):
                    if in_pile(rows, body):
                        is_alone = False
                        rows.piles.ll[body] = h_ll
                        rows.piles.al[body] = h_al
                        rows.piles.aa[body] = h_aa
                if is_alone:
                    work.factor[body] = factor_block(h_ll, h_al, h_aa)
                if wp.static(may_rest):
                    if wp.static(not effects.loops) or not has_loops(loops, body):
                        rest_on_fixed(body, step, wp.static(effects.pairs), work, rows)
        if not is_touched and not is_jointed:
            work.increment[body] = work.target[body]
            return False
        return True

    return BeginFunctions(measure_blocks, measure_loop, place_blocks, begin_body)
