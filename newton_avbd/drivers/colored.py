# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The step of large worlds: the kernels that :class:`.large.LargeWorlds` launches.

What ``world.solve_world`` does in one thread, a kernel does here for one phase and all bodies: the
mathematics is the same functions. A tree of joints is one thread's work, as in a world. A
sweep takes a launch for each color, and as blocks of a color share no contact and no joint, that is
what a sweep of one thread in the order of the colors computes. Where nothing moves any more, the
launches that are left return at once.
"""

import functools
import hashlib
from collections.abc import Callable
from typing import NamedTuple

import warp as wp

from ..data import ColorWork, Solver, Step, WorldScale
from ..effects import Effects
from ..rows import contact as contact_rows
from ..step.anchors import is_linked
from ..step.beginning import make_begin
from ..step.bodies import report_held, vector_sum
from ..step.breaking import make_break_joints
from ..step.cables import make_cables, make_join, may_jerk
from ..step.closures import make_closures
from ..step.contacts import (
    body_slot,
    find_row,
    make_linearise_rows,
    make_rows,
    owner_of,
    stiffen_rows,
)
from ..step.distances import reach_farther
from ..step.ending import make_end, make_remember
from ..step.energy import make_energy
from ..step.finite import make_is_world_finite
from ..step.flight import is_flying
from ..step.gathering import make_assemble, make_gather
from ..step.impacts import make_impacts
from ..step.kernels import ABSENT, KERNEL, absent, uncollected
from ..step.loops import make_loops, ties
from ..step.motion_history import is_remembered, remember_led, remember_loop
from ..step.resetting import forget_joints
from ..step.scale import (
    COLD_STEPS,
    LONGER,
    STRUCK_FACTOR,
    is_struck,
    is_unsettled,
    last_update,
    length_of,
    make_count_passes,
    make_measure_world,
    open_update,
    settled_update,
    sweeps_at_age,
)
from ..step.second_order import make_second_order
from ..step.slopes import JUMPED, QUIET_WORLD, is_going_on
from ..step.smoothness import is_quiet, last_of
from ..step.sweeps import make_sweep, make_sweep_block
from ..step.tendons import make_join_tendons
from ..step.trees import make_trees
from ..step.weights import make_weigh
from .colored_energy import ColoredEnergy, make_colored_energy
from .colored_impacts import make_colored_impacts
from .coloring import is_owner, other_end, sort_part
from .joining import join_at_once


class Colored(NamedTuple):
    """Kernels in the order of the step; None for those of effects that the scene does without."""

    measure_lanes: wp.Kernel
    begin_step: wp.Kernel
    build_rows: wp.Kernel
    recall_rows: wp.Kernel
    weigh: wp.Kernel | None
    penalise: wp.Kernel
    begin_rounds: wp.Kernel | None
    find_impacts: wp.Kernel | None
    strike_worlds: wp.Kernel | None
    end_rounds: wp.Kernel | None
    find_flying: wp.Kernel | None
    find_jumps: wp.Kernel | None
    find_loop_jumps: wp.Kernel | None
    find_jerks: wp.Kernel | None
    order_worlds: wp.Kernel | None
    start_bodies: wp.Kernel | None
    lead_all_rows: wp.Kernel | None
    measure_joints: wp.Kernel | None
    measure_loops: wp.Kernel | None
    widen_loops: wp.Kernel | None
    place_joints: wp.Kernel | None
    begin_clusters: wp.Kernel | None
    assemble: wp.Kernel
    sweep_color: wp.Kernel
    sweep_loops: wp.Kernel | None
    solve_clusters: wp.Kernel | None
    begin_round: wp.Kernel
    stiffen: wp.Kernel | None
    remember: wp.Kernel
    remember_loops: wp.Kernel | None
    find_jerked: wp.Kernel | None
    join_clusters: wp.Kernel | None
    break_trees: wp.Kernel | None
    break_loops: wp.Kernel | None
    end_velocities: wp.Kernel
    align_spins: wp.Kernel | None
    leave_impacts: wp.Kernel | None
    end_armatures: wp.Kernel | None
    end_loop_armatures: wp.Kernel | None
    end_sweeps: wp.Kernel
    remember_motions: wp.Kernel | None
    keep_loops: wp.Kernel | None
    close_joints: wp.Kernel | None
    give_loops_back: wp.Kernel | None
    give_cables_back: wp.Kernel | None
    end_poses: wp.Kernel
    energy: ColoredEnergy | None
    remember_states: wp.Kernel | None


@wp.func
def is_settled(moved: float, scale: WorldScale) -> bool:
    """Whether a sweep that moved a body by no more than the root of ``moved`` [m^2] is the last."""
    enough = last_update(scale)
    return moved <= enough * enough


@wp.func
def goes_on(
    sweep: int,
    world: int,
    moved: wp.array2d[float],
    most: wp.array[wp.int32],
    colors: wp.ref[ColorWork],
) -> bool:
    """Whether a world takes this sweep."""
    if sweep >= most[world]:
        return False
    return not is_settled(moved[sweep, world], colors.scale[world])


@wp.func
def count_sweeps(world: int, moved: wp.array2d[float]) -> int:
    """How many sweeps moved something, or could have."""
    sweeps = int(0)
    last = moved.shape[0] - 1
    while sweeps < last and moved[wp.min(sweeps + 1, last), world] >= 0.0:
        sweeps += 1
    return sweeps


@wp.func
def loop_world(i: int, s: wp.ref[Solver]) -> int:
    """World of a joint outside of the trees: that of its body that moves."""
    joint = s.loops.joints[i]
    child = s.joints.child[joint]
    if s.work.inv_mass[child] > 0.0 or s.joints.parent[joint] < 0:
        return s.worlds.of_body[child]
    return s.worlds.of_body[s.joints.parent[joint]]


@wp.func
def recall(body: int, side: int, static_slot: int, s: wp.ref[Solver]):
    """Hands what is remembered of the contacts that a body owned to their rows of this step.

    As :func:`.step.contacts.make_rows` has it, but the rows may be the other body's by now. All
    records of two shapes are one body's: no other thread writes to these rows.
    """
    for i in range(s.history.start[side, body], s.history.end[side, body]):
        record = s.history.records[side, i]
        if wp.length_sq(record.force) > 0.0:
            slot0 = body_slot(s.shapes, record.shape0, static_slot)
            slot1 = body_slot(s.shapes, record.shape1, static_slot)
            owner = owner_of(slot0, slot1, s)
            if owner >= 0:
                start = s.rows.owned_start[owner]
                row = find_row(record, start, s.rows.owned_end[owner], 1 - side, s)
                if row >= 0:
                    sign = wp.where(owner == body, 1.0, -1.0)
                    s.rows.rows[row].force = s.rows.rows[row].force + sign * record.force
                    if s.rows.spin.shape[0] > 0:
                        torque = s.rows.spin[row].torque + sign * s.history.torque[side, i]
                        s.rows.spin[row].torque = torque


@functools.cache
@uncollected()
def make_colored(effects: Effects) -> Colored:
    """The kernels of a large world, in one module."""
    module = wp.get_module(f"{__name__}_{hashlib.sha256(repr(effects).encode()).hexdigest()[:8]}")
    module.options |= KERNEL["module_options"]
    measure_world = make_measure_world(effects)
    is_world_finite = make_is_world_finite(effects)
    linearise_rows = make_linearise_rows(effects)
    penalise_rows = make_rows(effects)[1]
    weigh_blocks = make_weigh(effects)
    loop_functions = make_loops(effects)
    contact_force = contact_rows.force if effects.friction else contact_rows.normal_force
    sweep_gap = contact_rows.whole_gap if effects.compliance else contact_rows.rigid_gap
    loop_wrench, count_loop_turns = loop_functions.loop_wrench, loop_functions.count_turns
    gather = make_gather(effects, contact_force, sweep_gap, loop_wrench)
    closures = make_closures(effects)
    trees = make_trees(
        effects,
        gather,
        closures.begin_rows,
        closures.keep_forces,
        closures.missed_by_lines,
        closures.settle_tendons,
    )
    align_block, put_together = trees.align_spins, trees.put_together
    stop_coordinates = trees.stop_coordinates
    sweep_block = make_sweep_block(effects, make_sweep(effects, gather), trees.sweep_tree)
    assemble_body = make_assemble(effects, loop_functions.loop_curvature)
    remember_rows = make_remember(effects, contact_force, sweep_gap, join_at_once)
    measure_blocks, measure_loop, place_blocks, begin_body = make_begin(
        effects,
        trees,
        loop_functions,
        closures.begin_closures,
        closures.begin_tendons,
        assemble_body,
    )
    end_velocity, end_armature, end_pose = make_end(effects, trees.count_turns)
    break_blocks, break_loop = make_break_joints(effects, gather, closures.load_tendons)
    impacts = make_impacts(effects)
    release_impacts, restore_impacts = impacts.release_impacts, impacts.restore_impacts
    energy = make_energy(effects, join_at_once) if effects.balanced else ABSENT
    is_body_led, is_flat = energy.is_body_led, energy.is_flat
    count_passes = make_count_passes(effects)
    cables = make_cables(effects)
    begin_cluster, solve_cluster = cables.begin_cluster, cables.solve_cluster
    give_back, has_jerked = cables.give_back, cables.has_jerked
    end_tendons = closures.end_tendons
    orders = make_second_order(effects) if effects.second_order else ABSENT
    begin_order, body_jumps, loop_jumps = orders.begin_body, orders.body_jumps, orders.loop_jumps
    goes_on_smoothly, order_world = orders.goes_on, orders.order_world
    start_body, lead_rows = orders.start_body, orders.lead_rows
    slips_otherwise = orders.slips_otherwise
    remember_motion, remember_state = orders.remember_motion, orders.remember_state
    join_cluster = make_join(join_at_once)
    join_tendons = make_join_tendons(join_at_once) if effects.tendons else absent

    def kernel(is_called_for: bool = True) -> Callable[[Callable], wp.Kernel | None]:
        """Decorator: makes a kernel of the module, or nothing where the scene does without it."""
        if not is_called_for:
            return lambda function: None
        return wp.kernel(enable_backward=False, module=module)

    @kernel()
    def measure_lanes(step: Step, s: wp.array[Solver]):
        """How far the bodies of a lane may go, and whether they are finite; one thread a lane."""
        lane = wp.tid()
        s[0].colors.lane_scale[lane] = measure_world(lane, step.h, step.tolerance, s[0])
        is_finite = is_world_finite(lane, step, s[0])
        s[0].colors.lane_finite[lane] = int(is_finite)
        if lane == 0:
            s[0].colors.has_more[0] = 0
            s[0].colors.is_cold[0] = 0
            s[0].colors.is_apart[0] = 0
            s[0].colors.is_excessive[0] = 0

    @kernel()
    def begin_step(step: Step, s: wp.array[Solver]):
        """The scale of a world from that of its lanes; one thread a world."""
        world = wp.tid()
        scale = WorldScale()
        is_finite = int(1)
        for lane in range(s[0].colors.world_lane[world], s[0].colors.world_lane[world + 1]):
            part = s[0].colors.lane_scale[lane]
            part.mass += scale.mass
            part.gravity = wp.max(scale.gravity, part.gravity)
            part.reach = wp.max(scale.reach, part.reach)
            part.slop = wp.max(scale.slop, part.slop)
            scale = part
            is_finite = wp.min(is_finite, s[0].colors.lane_finite[lane])
        s[0].colors.scale[world] = scale
        s[0].colors.is_finite[world] = is_finite
        s[0].colors.deepest[world] = 0.0
        s[0].colors.closing[world] = 0.0
        s[0].colors.is_open[world] = 0
        s[0].colors.has_impacts[world] = 0
        s[0].colors.begin[world] = 0
        for i in range(s[0].colors.moved.shape[0]):
            s[0].colors.moved[i, world] = wp.where(i == 0, wp.inf, -1.0)
        for i in range(s[0].colors.recovered.shape[0]):
            s[0].colors.recovered[i, world] = wp.where(i == 0, wp.inf, -1.0)
        if step.h > LONGER * s[0].history.step[world]:
            s[0].history.age[world] = 0
        if wp.static(effects.second_order):
            if s[0].worlds.step[world] < s[0].history.step[world]:
                s[0].colors.scale[world].lag = 0.0
            s[0].colors.is_held[world] = 0
            s[0].colors.jumps[world] = 0
            s[0].colors.breaks[world] = 0
            s[0].colors.is_moving[world] = 0
        s[0].history.step[world] = step.h
        most = sweeps_at_age(s[0].history.age[world], step.iterations, scale)
        s[0].colors.most[world] = is_finite * most
        if most > step.iterations:
            s[0].colors.has_more[0] = 1
        if most > STRUCK_FACTOR * step.iterations:
            s[0].colors.is_cold[0] = 1

    @kernel()
    def build_rows(step: Step, s: wp.array[Solver]):
        """Rows of the contacts that a body owns; one thread a body."""
        body = wp.tid()
        place = int(s[0].rows.owned_start[body])
        for i in range(s[0].colors.incident_start[body], s[0].colors.incident_start[body + 1]):
            if is_owner(body, s[0].colors.partner[i], s[0].worlds):
                s[0].rows.contacts[place] = s[0].colors.incident[i]
                place += 1
        s[0].rows.owned_end[body] = place
        world = s[0].worlds.of_body[body]
        linearise_rows(world, body, s[0].colors.scale[world], step, s[0])

    @kernel()
    def recall_rows(s: wp.array[Solver]):
        """What the rows of the last step pushed with goes to those of this one; a thread a body."""
        body = wp.tid()
        sort_part(s[0].rows.other_rows, s[0].rows.other_start[body], s[0].rows.other_end[body])
        static_slot = s[0].work.inv_mass.shape[0] - 1
        side = s[0].history.parity[s[0].worlds.of_body[body]]
        recall(body, side, static_slot, s[0])

    @kernel(effects.light_links)
    def weigh(s: wp.array[Solver]):
        """Weighs the tree of a block; one thread a body, for a first one."""
        block = wp.tid()
        if (
            s[0].colors.block[block] == block
            and s[0].colors.is_finite[s[0].worlds.of_body[block]] == 1
        ):
            first = s[0].worlds.rank[block]
            end = s[0].worlds.block_end[first]
            weigh_blocks(first, end, s[0])

    @kernel()
    def penalise(step: Step, s: wp.array[Solver]):
        """Penalties of the rows that a body owns; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        depth = penalise_rows(world, body, scale, step, s[0])
        if depth > s[0].colors.deepest[world]:
            wp.atomic_max(s[0].colors.deepest, world, depth)

    @kernel(effects.second_order)
    def find_flying(step: Step, s: wp.array[Solver]):
        """Starts all bodies by backward Euler, and finds what is held; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if begin_order(s[0].worlds.rank[body], scale, step.body_qd, s[0]):
            s[0].colors.is_held[world] = 1

    @kernel(effects.second_order)
    def find_jumps(step: Step, s: wp.array[Solver]):
        """Whether a velocity is about to jump, and whether motions go on; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if s[0].colors.is_finite[world] == 0 or s[0].colors.has_impacts[world] == 1:
            s[0].colors.jumps[world] = 1
        elif body_jumps(world, s[0].worlds.rank[body], scale, s[0]):
            s[0].colors.jumps[world] = 1
        elif not goes_on_smoothly(body, step.body_qd, scale, s[0]):
            s[0].colors.breaks[world] = 1

    @kernel(effects.second_order and effects.loops)
    def find_loop_jumps(s: wp.array[Solver]):
        """Likewise by joints outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        if loop_jumps(world, i, s[0]):
            s[0].colors.jumps[world] = 1

    @kernel(effects.second_order and effects.cables)
    def find_jerks(s: wp.array[Solver]):
        """Likewise by cables that may pull at once; one thread a cluster of cables."""
        cluster = wp.tid()
        if may_jerk(cluster, s[0]):
            s[0].colors.jumps[s[0].tree.cables.world[cluster]] = 1

    @kernel(effects.second_order)
    def order_worlds(s: wp.array[Solver]):
        """Decides on the order of a world's step; one thread a world."""
        world = wp.tid()
        last = last_of(world, s[0].history)
        is_smooth = (
            s[0].colors.is_held[world] == 1
            and last != QUIET_WORLD
            and s[0].colors.jumps[world] == 0
        )
        is_continued = is_going_on(last) and s[0].colors.breaks[world] == 0
        scale = s[0].colors.scale[world]
        s[0].colors.scale[world] = order_world(world, last, is_smooth, is_continued, scale, s[0])
        s[0].colors.jumps[world] = 0

    @kernel(effects.second_order)
    def start_bodies(step: Step, s: wp.array[Solver]):
        """Leads and targets of bodies, by that order; one thread a body."""
        body = wp.tid()
        scale = s[0].colors.scale[s[0].worlds.of_body[body]]
        start_body(body, scale, step.body_qd, s[0])

    @kernel(effects.second_order)
    def lead_all_rows(s: wp.array[Solver]):
        """Likewise the rows that a body owns; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if scale.step < scale.h:
            lead_rows(world, body, scale, s[0])

    @kernel(effects.joints)
    def measure_joints(step: Step, s: wp.array[Solver]):
        """Measures the joints of a block's tree; one thread a body, for a first one."""
        block = wp.tid()
        world = s[0].worlds.of_body[block]
        if s[0].colors.block[block] == block and s[0].colors.is_finite[world] == 1:
            first = s[0].worlds.rank[block]
            if measure_blocks(
                first,
                s[0].worlds.block_end[first],
                s[0].colors.scale[world],
                step.body_qd,
                step,
                s[0],
            ):
                s[0].colors.is_open[world] = 1

    @kernel(effects.loops)
    def measure_loops(step: Step, s: wp.array[Solver]):
        """Measures a joint outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        if s[0].colors.is_finite[world] == 1:
            scale = s[0].colors.scale[world]
            if measure_loop(i, scale, step.body_qd, step, s[0]):
                s[0].colors.is_open[world] = 1
            wp.atomic_max(s[0].colors.closing, world, s[0].loops.closing[i])

    @kernel(effects.loops and effects.kinds.distances)
    def widen_loops(s: wp.array[Solver]):
        """How far the recovery of other joints may pull a DISTANCE joint; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        reach_farther(i, s[0].colors.closing[world], s[0])

    @kernel(effects.joints)
    def place_joints(s: wp.array[Solver]):
        """Puts a block to the guess of its increments; one thread a body, for a first one."""
        block = wp.tid()
        world = s[0].worlds.of_body[block]
        if s[0].colors.block[block] == block and s[0].colors.is_finite[world] == 1:
            first = s[0].worlds.rank[block]
            if place_blocks(first, s[0].worlds.block_end[first], s[0].colors.scale[world], s[0]):
                s[0].colors.is_open[world] = 1

    @kernel(effects.cables)
    def begin_clusters(s: wp.array[Solver]):
        """Pulls with the tensions of the last step; one thread a cluster of cables."""
        cluster = wp.tid()
        world = s[0].tree.cables.world[cluster]
        if s[0].colors.is_finite[world] == 1:
            if begin_cluster(cluster, s[0]):
                s[0].colors.is_open[world] = 1

    @kernel()
    def assemble(begin: int, step: Step, s: wp.array[Solver]):
        """Sums the block of a body, or puts it to its target; one thread a body.

        Those of worlds whose round of sweeps begins with the sweep ``begin``.
        """
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        if s[0].work.inv_mass[body] > 0.0 and s[0].colors.begin[world] == begin:
            begin_body(s[0].worlds.rank[body], s[0].colors.scale[world].step, step, s[0])

    @wp.func
    def sweep_blocks(
        thread: int,
        sweep: int,
        color: int,
        threads: int,
        recovery: float,
        most: wp.array[wp.int32],
        moved: wp.array2d[float],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Moves the blocks of a color that fall to a thread."""
        lanes = s.colors.lane_start.shape[0] - 1
        first = s.colors.start[color * lanes] + thread
        for i in range(first, s.colors.start[(color + 1) * lanes], threads):
            body = s.colors.order[i]
            world = s.worlds.of_body[body]
            if goes_on(sweep, world, moved, most, s.colors):
                scale = s.colors.scale[world]
                far = sweep_block(
                    s.worlds.rank[body],
                    sweep > s.colors.begin[world] and recovery == 0.0,
                    recovery,
                    scale.slop,
                    scale.step,
                    step,
                    s,
                )
                # looks first, since few of many threads have to
                if far > moved[sweep + 1, world]:
                    wp.atomic_max(moved, sweep + 1, world, far)

    @kernel()
    def sweep_color(
        sweep: int,
        color: int,
        threads: int,
        recovery: float,
        most: wp.array[wp.int32],
        moved: wp.array2d[float],
        step: Step,
        s: wp.array[Solver],
    ):
        """Moves all blocks of a color once; the last color is for one thread alone.

        With a ``recovery`` above zero what was wrong at the start of the step goes, too.
        """
        sweep_blocks(wp.tid(), sweep, color, threads, recovery, most, moved, step, s[0])

    @kernel(effects.loops)
    def sweep_loops(
        sweep: int,
        recovery: float,
        moved: wp.array2d[float],
        most: wp.array[wp.int32],
        step: Step,
        s: wp.array[Solver],
    ):
        """The dual update of a joint outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        if goes_on(sweep, world, moved, most, s[0].colors):
            h = s[0].colors.scale[world].step
            loop_wrench(i, recovery, h, True, True, step, s[0])

    @kernel(effects.cables)
    def solve_clusters(
        sweep: int,
        recovery: float,
        most: wp.array[wp.int32],
        moved: wp.array2d[float],
        s: wp.array[Solver],
    ):
        """Tensions for the next sweep; one thread a cluster of cables."""
        cluster = wp.tid()
        world = s[0].tree.cables.world[cluster]
        if goes_on(sweep, world, moved, most, s[0].colors):
            changed = solve_cluster(cluster, recovery, s[0])
            wp.atomic_max(moved, sweep + 1, world, changed)

    @kernel()
    def begin_round(
        # In:
        iterations: int,
        begin: int,
        # Work out:
        colors: ColorWork,
    ):
        """Another round of sweeps where impacts go on after the last; one thread a world."""
        world = wp.tid()
        if colors.most[world] == begin:
            if is_struck(begin, colors.moved[begin, world], colors.scale[world]):
                colors.most[world] = begin + iterations
                colors.begin[world] = begin
                colors.has_more[0] = 1

    @kernel(effects.contact and not effects.compliance)
    def stiffen(begin: int, s: wp.array[Solver]):
        """Contacts as stiff as the forces that sweeps have found ask for; one thread a body.

        Those of worlds whose round of sweeps begins with the sweep ``begin``.
        """
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        if s[0].colors.begin[world] == begin:
            stiffen_rows(body, s[0].colors.scale[world], s[0].rows)

    @kernel()
    def remember(step: Step, s: wp.array[Solver]):
        """The last dual update, kept for the next step; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        side = 1 - s[0].history.parity[world]
        scale = s[0].colors.scale[world]
        remember_rows(body, side, scale, step.body_qd, s[0])
        if wp.static(effects.joints and effects.islands):
            if s[0].work.inv_mass[body] > 0.0:
                if is_linked(body, s[0]):
                    join_at_once(body, s[0].tree.parent[body], s[0])
                if wp.static(effects.loops):
                    for k in range(s[0].loops.body_start[body], s[0].loops.body_start[body + 1]):
                        if ties(s[0].loops.items[k] / 2, s[0]):
                            other = other_end(body, s[0].loops.items[k], s[0])
                            slot = wp.where(other < 0, scale.static_slot, other)
                            join_at_once(body, slot, s[0])
                if wp.static(effects.tendons):
                    if s[0].colors.block[body] == body:
                        join_tendons(s[0].worlds.rank[body], s[0])
        if not wp.isfinite(vector_sum(s[0].work.increment[body])):
            s[0].colors.is_finite[world] = 0

    @kernel(effects.second_order and effects.loops)
    def remember_loops(s: wp.array[Solver]):
        """How a joint outside of the trees has moved; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        if s[0].colors.is_finite[world] == 1:
            remember_loop(i, s[0].colors.scale[world], s[0])

    @kernel(effects.second_order and effects.cables)
    def find_jerked(s: wp.array[Solver]):
        """Whether a cable's tension has jumped; one thread a cluster of cables."""
        cluster = wp.tid()
        world = s[0].tree.cables.world[cluster]
        scale = s[0].colors.scale[world]
        # tensions of steps of different order do not compare
        if scale.step == scale.h and has_jerked(cluster, scale, s[0].tree.cables):
            s[0].colors.jumps[world] = 1

    @kernel(effects.cables and effects.islands)
    def join_clusters(s: wp.array[Solver]):
        """Makes one island of bodies that cables pull; one thread a cluster of cables."""
        join_cluster(wp.tid(), s[0])

    @kernel(effects.breaking)
    def break_trees(step: Step, s: wp.array[Solver]):
        """Breaks the joints of a block's tree; one thread a body, for a first one."""
        block = wp.tid()
        if (
            s[0].colors.block[block] == block
            and s[0].colors.is_finite[s[0].worlds.of_body[block]] == 1
        ):
            first = s[0].worlds.rank[block]
            break_blocks(
                first,
                s[0].worlds.block_end[first],
                s[0].colors.scale[s[0].worlds.of_body[block]].step,
                step,
                s[0],
            )

    @kernel(effects.breaking and effects.loops)
    def break_loops(s: wp.array[Solver]):
        """Breaks joints outside of the trees; one thread a joint."""
        i = wp.tid()
        if s[0].colors.is_finite[loop_world(i, s[0])] == 1:
            break_loop(i, s[0])

    @kernel()
    def end_velocities(step: Step, s: wp.array[Solver]):
        """Velocities; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        velocity = step.body_qd[body]
        if wp.static(effects.balanced):
            s[0].islands.start_q[body] = s[0].work.pose[body]
            s[0].islands.start_qd[body] = velocity
        if s[0].colors.is_finite[world] == 0:
            s[0].history.falling[body] = 0.0
        elif s[0].work.inv_mass[body] > 0.0:
            velocity = end_velocity(
                s[0].worlds.rank[body], s[0].colors.scale[world], step.body_qd, True, s[0]
            )
            if wp.static(effects.second_order):
                # until the step is done, that of its start
                s[0].history.last[body].velocity = step.body_qd[body]
                may_stand, scale = wp.static(effects.contact), s[0].colors.scale[world]
                if not is_quiet(body, velocity, may_stand, scale, s[0]):
                    s[0].colors.is_moving[world] = 1
                if slips_otherwise(body, s[0]):
                    s[0].colors.jumps[world] = 1
            if wp.static(effects.balanced and effects.kinds.gimbals):
                if is_body_led(body, s[0]):
                    s[0].colors.is_excessive[0] = 1
            if wp.static(effects.restitution):
                if s[0].colors.has_impacts[world] == 1:
                    release_impacts(body, s[0])
        step.body_qd_out[body] = velocity

    @kernel(effects.spinning)
    def align_spins(step: Step, s: wp.array[Solver]):
        """Spins as their joints leave them; one thread a body, for the first of a block."""
        block = wp.tid()
        if (
            s[0].colors.block[block] == block
            and s[0].colors.is_finite[s[0].worlds.of_body[block]] == 1
        ):
            first = s[0].worlds.rank[block]
            align_block(first, s[0].worlds.block_end[first], step, s[0])

    @kernel(effects.axis_rates)
    def end_armatures(step: Step, s: wp.array[Solver]):
        """What armature has of a tree's joint; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        if s[0].colors.is_finite[world] == 1 and s[0].work.inv_mass[body] > 0.0:
            if s[0].tree.joint[body] >= 0:
                end_armature(
                    s[0].tree.joint[body],
                    s[0].tree.axis_start[body],
                    s[0].tree.coordinate,
                    s[0].tree.start_coordinate,
                    s[0].colors.scale[world],
                    step.body_qd,
                    step,
                    s[0],
                )

    @kernel(effects.axis_rates and effects.loops)
    def end_loop_armatures(step: Step, s: wp.array[Solver]):
        """What armature has of a joint outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        if s[0].colors.is_finite[world] == 1:
            joint = s[0].loops.joints[i]
            end_armature(
                joint,
                s[0].joints.dof_start[joint],
                s[0].loops.coordinate,
                s[0].loops.start_coordinate,
                s[0].colors.scale[world],
                step.body_qd,
                step,
                s[0],
            )

    @kernel()
    def end_sweeps(s: wp.array[Solver]):
        """What sweeps left, and how many the recovery takes; one thread a world."""
        world = wp.tid()
        scale = s[0].colors.scale[world]
        sweeps = count_sweeps(world, s[0].colors.moved)
        update = float(0.0)
        if sweeps > 0:
            update = s[0].colors.moved[sweeps, world]
        s[0].worlds.sweeps[world] = sweeps
        s[0].worlds.update[world] = length_of(update)
        s[0].worlds.settled[world] = settled_update(scale)
        is_open = s[0].colors.is_open[world] == 1
        passes = count_passes(sweeps, update, s[0].colors.deepest[world], is_open, scale)
        if s[0].colors.is_finite[world] == 0:
            passes = 0
        elif is_unsettled(update, scale):
            s[0].colors.is_excessive[0] = 1
        elif wp.static(effects.folding):
            if is_flat(world, s[0].worlds):
                s[0].colors.is_excessive[0] = 1
        s[0].colors.passes[world] = passes
        if passes > 1:
            s[0].colors.is_apart[0] = 1
        if wp.static(effects.second_order):
            # what does not settle tells nothing of the next step
            if not is_settled(update, scale) or s[0].colors.jumps[world] == 1:
                s[0].history.smooth[world] = JUMPED
            if s[0].colors.is_moving[world] == 0:
                s[0].history.smooth[world] = QUIET_WORLD

    @kernel(effects.second_order)
    def remember_motions(s: wp.array[Solver]):
        """How a body has moved, before anything old is recovered; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if s[0].colors.is_finite[world] == 1:
            if s[0].work.inv_mass[body] > 0.0 and is_remembered(world, scale, s[0].history):
                remember_motion(body, scale, s[0])
            if wp.static(effects.tendons):
                end_tendons(s[0].worlds.rank[body], scale, s[0].tree)

    @kernel(effects.loops)
    def keep_loops(s: wp.array[Solver]):
        """What closes loops in the recovery is no force of the motion; one thread a joint."""
        i = wp.tid()
        s[0].loops.kept_force[i] = s[0].history.loop_force[i]
        s[0].loops.kept_torque[i] = s[0].history.loop_torque[i]

    @kernel(effects.joints)
    def close_joints(step: Step, s: wp.array[Solver]):
        """Closes joints that are still open, and puts coordinates back to limits that they passed;
        one thread a body, for the first of a block."""
        block = wp.tid()
        world = s[0].worlds.of_body[block]
        if s[0].colors.block[block] == block and s[0].colors.is_finite[world] == 1:
            scale = s[0].colors.scale[world]
            last = s[0].worlds.update[world] * s[0].worlds.update[world]
            if s[0].colors.passes[world] > 0:
                last = s[0].colors.recovered[count_sweeps(world, s[0].colors.recovered), world]
            allowed = open_update(scale)
            if last > allowed * allowed:
                first = s[0].worlds.rank[block]
                for i in range(first, s[0].worlds.block_end[first]):
                    body = s[0].worlds.bodies[i]
                    if s[0].work.inv_mass[body] > 0.0 and is_linked(body, s[0]):
                        put_together(body, scale.static_slot, s[0])
            if wp.static(effects.hard_limits):
                if s[0].worlds.sweeps[world] >= step.iterations:
                    first = s[0].worlds.rank[block]
                    end = s[0].worlds.block_end[first]
                    slot = scale.static_slot
                    stop_coordinates(first, end, slot, s[0])

    @kernel(effects.loops)
    def give_loops_back(s: wp.array[Solver]):
        """Ends what :func:`keep_loops` began; one thread a joint."""
        i = wp.tid()
        if s[0].colors.is_finite[loop_world(i, s[0])] == 1:
            s[0].history.loop_force[i] = s[0].loops.kept_force[i]
            s[0].history.loop_torque[i] = s[0].loops.kept_torque[i]
            count_loop_turns(i, s[0])

    @kernel(effects.cables)
    def give_cables_back(s: wp.array[Solver]):
        """After the recovery: the tensions of the motion; one thread a cluster of cables."""
        give_back(wp.tid(), s[0])

    @kernel()
    def end_poses(step: Step, s: wp.array[Solver]):
        """Poses, and what became of the worlds; one thread a body."""
        body = wp.tid()
        pose = s[0].work.pose[body]
        world = s[0].worlds.of_body[body]
        is_held = s[0].colors.is_finite[world] == 0
        if is_held:
            s[0].rows.owned_end[body] = s[0].rows.owned_start[body]
            for side in range(2):
                s[0].history.start[side, body] = 0
                s[0].history.end[side, body] = 0
            if s[0].tree.joint.shape[0] > 0:
                forget_joints(body, s[0])
        elif s[0].work.inv_mass[body] > 0.0:
            if wp.static(effects.restitution):
                if s[0].colors.has_impacts[world] == 1:
                    restore_impacts(body, s[0].colors.scale[world].h, s[0])
            pose = end_pose(s[0].worlds.rank[body], s[0].colors.scale[world].h, s[0])
        step.body_q_out[body] = pose
        if body == s[0].worlds.bodies[s[0].colors.lane_start[s[0].colors.world_lane[world]]]:
            s[0].history.age[world] = wp.min(s[0].history.age[world] + 1, COLD_STEPS)
            if is_held:
                report_held(s[0].worlds, world)
                s[0].history.age[world] = 0
            s[0].history.parity[world] = 1 - s[0].history.parity[world]

    @kernel(effects.second_order)
    def remember_states(step: Step, s: wp.array[Solver]):
        """Where the step has left a body, and how fast; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if s[0].colors.is_finite[world] == 1 and is_remembered(world, scale, s[0].history):
            q, qd = step.body_q_out[body], step.body_qd_out[body]
            if s[0].work.inv_mass[body] == 0.0:
                remember_led(body, qd, scale, s[0].history)
            elif not is_flying(body, s[0].history):
                remember_state(world, body, q, qd, scale, s[0])

    strikes = make_colored_impacts(effects, kernel)
    return Colored(
        measure_lanes,
        begin_step,
        build_rows,
        recall_rows,
        weigh,
        penalise,
        strikes.begin_rounds,
        strikes.find_impacts,
        strikes.strike_worlds,
        strikes.end_rounds,
        find_flying,
        find_jumps,
        find_loop_jumps,
        find_jerks,
        order_worlds,
        start_bodies,
        lead_all_rows,
        measure_joints,
        measure_loops,
        widen_loops,
        place_joints,
        begin_clusters,
        assemble,
        sweep_color,
        sweep_loops,
        solve_clusters,
        begin_round,
        stiffen,
        remember,
        remember_loops,
        find_jerked,
        join_clusters,
        break_trees,
        break_loops,
        end_velocities,
        align_spins,
        strikes.leave_impacts,
        end_armatures,
        end_loop_armatures,
        end_sweeps,
        remember_motions,
        keep_loops,
        close_joints,
        give_loops_back,
        give_cables_back,
        end_poses,
        make_colored_energy(effects, energy, kernel) if effects.balanced else None,
        remember_states,
    )
