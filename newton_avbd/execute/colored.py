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

from ..data import (
    BodyModel,
    BodyWork,
    ColorWork,
    ContactInput,
    ControlInput,
    History,
    IslandWork,
    JointModel,
    LoopWork,
    RowWork,
    ShapeModel,
    TreeWork,
    WorldScale,
    WorldWork,
)
from ..effects import Effects
from ..rows import contact as contact_rows
from .beginning import make_begin
from .bodies import report_held, vector_sum
from .breaking import make_break_joints
from .cables import make_cables, make_join, may_jerk
from .closures import make_closures
from .colored_energy import ColoredEnergy, make_colored_energy
from .colored_impacts import make_colored_impacts
from .coloring import is_owner, other_end, sort_part
from .contacts import body_slot, find_row, make_linearise_rows, make_rows, owner_of, stiffen_rows
from .ending import make_end, make_remember
from .energy import make_energy
from .finite import make_is_world_finite
from .gathering import make_assemble, make_gather
from .impacts import make_impacts
from .joining import join_at_once
from .launch import ABSENT, KERNEL, absent, uncollected
from .loops import make_loops, reach_farther
from .resetting import forget_joints
from .scale import (
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
from .second_order import (
    is_flying,
    is_quiet,
    is_remembered,
    last_of,
    make_second_order,
    remember_led,
)
from .slopes import JUMPED, QUIET_WORLD, is_going_on
from .sweeps import make_sweep, make_sweep_block
from .tendons import make_join_tendons
from .trees import is_linked, make_trees
from .weights import make_weigh


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
def loop_world(
    i: int,
    joints: wp.ref[JointModel],
    worlds: wp.ref[WorldWork],
    work: wp.ref[BodyWork],
    loops: wp.ref[LoopWork],
) -> int:
    """World of a joint outside of the trees: that of its body that moves."""
    joint = loops.joints[i]
    child = joints.child[joint]
    if work.inv_mass[child] > 0.0 or joints.parent[joint] < 0:
        return worlds.of_body[child]
    return worlds.of_body[joints.parent[joint]]


@wp.func
def recall(
    body: int,
    side: int,
    static_slot: int,
    shapes: wp.ref[ShapeModel],
    worlds: wp.ref[WorldWork],
    work: wp.ref[BodyWork],
    rows: wp.ref[RowWork],
    history: wp.ref[History],
):
    """Hands what is remembered of the contacts that a body owned to their rows of this step.

    As :func:`.contacts.make_rows` has it, but the rows may be the other body's by now. All records
    of two shapes are one body's: no other thread writes to these rows.
    """
    for i in range(history.start[side, body], history.end[side, body]):
        record = history.records[side, i]
        if wp.length_sq(record.force) > 0.0:
            slot0 = body_slot(shapes, record.shape0, static_slot)
            slot1 = body_slot(shapes, record.shape1, static_slot)
            owner = owner_of(worlds, work, slot0, slot1)
            if owner >= 0:
                start = rows.owned_start[owner]
                row = find_row(record, start, rows.owned_end[owner], 1 - side, rows, history)
                if row >= 0:
                    sign = wp.where(owner == body, 1.0, -1.0)
                    rows.rows[row].force = rows.rows[row].force + sign * record.force
                    if rows.spin.shape[0] > 0:
                        torque = rows.spin[row].torque + sign * history.torque[side, i]
                        rows.spin[row].torque = torque


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
    remember_motion, remember_loop = orders.remember_motion, orders.remember_loop
    remember_state = orders.remember_state
    join_cluster = make_join(join_at_once)
    join_tendons = make_join_tendons(join_at_once) if effects.tendons else absent

    def kernel(is_called_for: bool = True) -> Callable[[Callable], wp.Kernel | None]:
        """Decorator: makes a kernel of the module, or nothing where the scene does without it."""
        if not is_called_for:
            return lambda function: None
        return wp.kernel(enable_backward=False, module=module)

    @kernel()
    def measure_lanes(
        # Model:
        model: BodyModel,
        joints: JointModel,
        control: ControlInput,
        h: float,
        tolerance: float,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        loops: LoopWork,
        # Work out:
        colors: ColorWork,
    ):
        """How far the bodies of a lane may go, and whether they are finite; one thread a lane."""
        lane = wp.tid()
        colors.lane_scale[lane] = measure_world(lane, h, tolerance, model, worlds, work)
        is_finite = is_world_finite(lane, joints, control, worlds, work, tree, loops)
        colors.lane_finite[lane] = int(is_finite)
        if lane == 0:
            colors.has_more[0] = 0
            colors.is_cold[0] = 0
            colors.is_apart[0] = 0
            colors.is_excessive[0] = 0

    @kernel()
    def begin_step(
        # In:
        h: float,
        iterations: int,
        # Work:
        worlds: WorldWork,
        # Work out:
        colors: ColorWork,
        history: History,
    ):
        """The scale of a world from that of its lanes; one thread a world."""
        world = wp.tid()
        scale = WorldScale()
        is_finite = int(1)
        for lane in range(colors.world_lane[world], colors.world_lane[world + 1]):
            part = colors.lane_scale[lane]
            part.mass += scale.mass
            part.gravity = wp.max(scale.gravity, part.gravity)
            part.reach = wp.max(scale.reach, part.reach)
            part.slop = wp.max(scale.slop, part.slop)
            scale = part
            is_finite = wp.min(is_finite, colors.lane_finite[lane])
        colors.scale[world] = scale
        colors.is_finite[world] = is_finite
        colors.deepest[world] = 0.0
        colors.closing[world] = 0.0
        colors.is_open[world] = 0
        colors.has_impacts[world] = 0
        colors.begin[world] = 0
        for i in range(colors.moved.shape[0]):
            colors.moved[i, world] = wp.where(i == 0, wp.inf, -1.0)
        for i in range(colors.recovered.shape[0]):
            colors.recovered[i, world] = wp.where(i == 0, wp.inf, -1.0)
        if h > LONGER * history.step[world]:
            history.age[world] = 0
        if wp.static(effects.second_order):
            if worlds.step[world] < history.step[world]:
                colors.scale[world].lag = 0.0
            colors.is_held[world] = 0
            colors.jumps[world] = 0
            colors.breaks[world] = 0
            colors.is_moving[world] = 0
        history.step[world] = h
        most = sweeps_at_age(history.age[world], iterations, scale)
        colors.most[world] = is_finite * most
        if most > iterations:
            colors.has_more[0] = 1
        if most > STRUCK_FACTOR * iterations:
            colors.is_cold[0] = 1

    @kernel()
    def build_rows(
        # Model:
        model: BodyModel,
        shapes: ShapeModel,
        # State in:
        body_q: wp.array[wp.transform],
        contacts: ContactInput,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        # Work out:
        rows: RowWork,
        colors: ColorWork,
        history: History,
    ):
        """Rows of the contacts that a body owns; one thread a body."""
        body = wp.tid()
        place = int(rows.owned_start[body])
        for i in range(colors.incident_start[body], colors.incident_start[body + 1]):
            if is_owner(body, colors.partner[i], worlds):
                rows.contacts[place] = colors.incident[i]
                place += 1
        rows.owned_end[body] = place
        world = worlds.of_body[body]
        linearise_rows(
            world,
            body,
            colors.scale[world],
            body_q,
            model,
            shapes,
            contacts,
            worlds,
            work,
            rows,
            history,
        )

    @kernel()
    def recall_rows(
        # Model:
        shapes: ShapeModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        history: History,
        # Work out:
        rows: RowWork,
    ):
        """What the rows of the last step pushed with goes to those of this one; a thread a body."""
        body = wp.tid()
        sort_part(rows.other_rows, rows.other_start[body], rows.other_end[body])
        static_slot = work.inv_mass.shape[0] - 1
        side = history.parity[worlds.of_body[body]]
        recall(body, side, static_slot, shapes, worlds, work, rows, history)

    @kernel(effects.light_links)
    def weigh(
        # Model:
        model: BodyModel,
        joints: JointModel,
        # State in:
        body_q: wp.array[wp.transform],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        colors: ColorWork,
        # Work out:
        tree: TreeWork,
    ):
        """Weighs the tree of a block; one thread a body, for a first one."""
        block = wp.tid()
        if colors.block[block] == block and colors.is_finite[worlds.of_body[block]] == 1:
            first = worlds.rank[block]
            end = worlds.block_end[first]
            weigh_blocks(first, end, body_q, model, joints, worlds, work, rows, tree)

    @kernel()
    def penalise(
        # Model:
        shapes: ShapeModel,
        # Contacts in:
        contacts: ContactInput,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        tree: TreeWork,
        history: History,
        # Work out:
        colors: ColorWork,
    ):
        """Penalties of the rows that a body owns; one thread a body."""
        body = wp.tid()
        world = worlds.of_body[body]
        scale = colors.scale[world]
        depth = penalise_rows(
            world, body, scale, shapes, contacts, worlds, work, rows, tree, history
        )
        if depth > colors.deepest[world]:
            wp.atomic_max(colors.deepest, world, depth)

    @kernel(effects.second_order)
    def find_flying(
        # State in:
        body_qd: wp.array[wp.spatial_vector],
        # Work:
        worlds: WorldWork,
        rows: RowWork,
        tree: TreeWork,
        loops: LoopWork,
        # Work out:
        work: BodyWork,
        colors: ColorWork,
        history: History,
    ):
        """Starts all bodies by backward Euler, and finds what is held; one thread a body."""
        body = wp.tid()
        world = worlds.of_body[body]
        scale = colors.scale[world]
        if begin_order(worlds.rank[body], scale, body_qd, worlds, work, rows, tree, loops, history):
            colors.is_held[world] = 1

    @kernel(effects.second_order)
    def find_jumps(
        # Model:
        model: BodyModel,
        joints: JointModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        tree: TreeWork,
        history: History,
        # Work out:
        colors: ColorWork,
    ):
        """Whether a velocity is about to jump, and whether motions go on; one thread a body."""
        body = wp.tid()
        world = worlds.of_body[body]
        scale = colors.scale[world]
        if colors.is_finite[world] == 0 or colors.has_impacts[world] == 1:
            colors.jumps[world] = 1
        elif body_jumps(world, worlds.rank[body], scale, joints, worlds, work, rows, tree, history):
            colors.jumps[world] = 1
        elif not goes_on_smoothly(body, body_q, body_qd, scale, model, work, rows, history):
            colors.breaks[world] = 1

    @kernel(effects.second_order and effects.loops)
    def find_loop_jumps(
        # Model:
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        loops: LoopWork,
        history: History,
        # Work out:
        colors: ColorWork,
    ):
        """Likewise by joints outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, joints, worlds, work, loops)
        if loop_jumps(world, i, joints, loops, history):
            colors.jumps[world] = 1

    @kernel(effects.second_order and effects.cables)
    def find_jerks(
        # Work:
        work: BodyWork,
        tree: TreeWork,
        # Work out:
        colors: ColorWork,
    ):
        """Likewise by cables that may pull at once; one thread a cluster of cables."""
        cluster = wp.tid()
        if may_jerk(cluster, work, tree.cables):
            colors.jumps[tree.cables.world[cluster]] = 1

    @kernel(effects.second_order)
    def order_worlds(
        # Work out:
        worlds: WorldWork,
        colors: ColorWork,
        history: History,
    ):
        """Decides on the order of a world's step; one thread a world."""
        world = wp.tid()
        last = last_of(world, history)
        is_smooth = colors.is_held[world] == 1 and last != QUIET_WORLD and colors.jumps[world] == 0
        is_continued = is_going_on(last) and colors.breaks[world] == 0
        scale = colors.scale[world]
        colors.scale[world] = order_world(
            world, last, is_smooth, is_continued, scale, worlds, history
        )
        colors.jumps[world] = 0

    @kernel(effects.second_order)
    def start_bodies(
        # Model:
        model: BodyModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        # Work:
        worlds: WorldWork,
        colors: ColorWork,
        # Work out:
        work: BodyWork,
        history: History,
    ):
        """Leads and targets of bodies, by that order; one thread a body."""
        body = wp.tid()
        scale = colors.scale[worlds.of_body[body]]
        start_body(body, scale, body_q, body_qd, model, work, history)

    @kernel(effects.second_order)
    def lead_all_rows(
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        colors: ColorWork,
        # Work out:
        rows: RowWork,
    ):
        """Likewise the rows that a body owns; one thread a body."""
        body = wp.tid()
        scale = colors.scale[worlds.of_body[body]]
        if scale.step < scale.h:
            lead_rows(body, scale, work, rows)

    @kernel(effects.joints)
    def measure_joints(
        # Model:
        model: BodyModel,
        joints: JointModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        control: ControlInput,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        loops: LoopWork,
        # Work out:
        tree: TreeWork,
        colors: ColorWork,
        history: History,
    ):
        """Measures the joints of a block's tree; one thread a body, for a first one."""
        block = wp.tid()
        world = worlds.of_body[block]
        if colors.block[block] == block and colors.is_finite[world] == 1:
            first = worlds.rank[block]
            if measure_blocks(
                first,
                worlds.block_end[first],
                colors.scale[world],
                body_q,
                body_qd,
                model,
                joints,
                control,
                worlds,
                work,
                rows,
                tree,
                loops,
                history,
            ):
                colors.is_open[world] = 1

    @kernel(effects.loops)
    def measure_loops(
        # Model:
        model: BodyModel,
        joints: JointModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        control: ControlInput,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        # Work out:
        loops: LoopWork,
        colors: ColorWork,
        history: History,
    ):
        """Measures a joint outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, joints, worlds, work, loops)
        if colors.is_finite[world] == 1:
            scale = colors.scale[world]
            if measure_loop(
                i, scale, body_q, body_qd, model, joints, control, work, tree, loops, history
            ):
                colors.is_open[world] = 1
            wp.atomic_max(colors.closing, world, loops.closing[i])

    @kernel(effects.loops and effects.kinds.distances)
    def widen_loops(
        # Model:
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        colors: ColorWork,
        # Work out:
        loops: LoopWork,
    ):
        """How far the recovery of other joints may pull a DISTANCE joint; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, joints, worlds, work, loops)
        reach_farther(i, colors.closing[world], joints, loops)

    @kernel(effects.joints)
    def place_joints(
        # Model:
        model: BodyModel,
        joints: JointModel,
        # State in:
        body_q: wp.array[wp.transform],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        # Work out:
        tree: TreeWork,
        colors: ColorWork,
        history: History,
    ):
        """Puts a block to the guess of its increments; one thread a body, for a first one."""
        block = wp.tid()
        world = worlds.of_body[block]
        if colors.block[block] == block and colors.is_finite[world] == 1:
            first = worlds.rank[block]
            if place_blocks(
                first,
                worlds.block_end[first],
                colors.scale[world],
                body_q,
                model,
                joints,
                worlds,
                work,
                tree,
                history,
            ):
                colors.is_open[world] = 1

    @kernel(effects.cables)
    def begin_clusters(
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        # Work out:
        tree: TreeWork,
        colors: ColorWork,
    ):
        """Pulls with the tensions of the last step; one thread a cluster of cables."""
        cluster = wp.tid()
        world = tree.cables.world[cluster]
        if colors.is_finite[world] == 1:
            if begin_cluster(cluster, work, tree):
                colors.is_open[world] = 1

    @kernel()
    def assemble(
        # Model:
        model: BodyModel,
        joints: JointModel,
        control: ControlInput,
        # In:
        begin: int,
        # Work:
        worlds: WorldWork,
        rows: RowWork,
        tree: TreeWork,
        loops: LoopWork,
        colors: ColorWork,
        history: History,
        # Work out:
        work: BodyWork,
        islands: IslandWork,
    ):
        """Sums the block of a body, or puts it to its target; one thread a body.

        Those of worlds whose round of sweeps begins with the sweep ``begin``.
        """
        body = wp.tid()
        world = worlds.of_body[body]
        if work.inv_mass[body] > 0.0 and colors.begin[world] == begin:
            begin_body(
                worlds.rank[body],
                colors.scale[world].step,
                model,
                joints,
                control,
                worlds,
                work,
                rows,
                tree,
                loops,
                islands,
                history,
            )

    @wp.func
    def sweep_blocks(
        thread: int,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        body_q: wp.array[wp.transform],
        sweep: int,
        color: int,
        threads: int,
        recovery: float,
        most: wp.array[wp.int32],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        colors: wp.ref[ColorWork],
        history: wp.ref[History],
        moved: wp.array2d[float],
    ):
        """Moves the blocks of a color that fall to a thread."""
        lanes = colors.lane_start.shape[0] - 1
        first = colors.start[color * lanes] + thread
        for i in range(first, colors.start[(color + 1) * lanes], threads):
            body = colors.order[i]
            world = worlds.of_body[body]
            if goes_on(sweep, world, moved, most, colors):
                scale = colors.scale[world]
                far = sweep_block(
                    worlds.rank[body],
                    sweep > colors.begin[world] and recovery == 0.0,
                    recovery,
                    scale.slop,
                    scale.step,
                    body_q,
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
                # looks first, since few of many threads have to
                if far > moved[sweep + 1, world]:
                    wp.atomic_max(moved, sweep + 1, world, far)

    @kernel()
    def sweep_color(
        # Model:
        model: wp.array[BodyModel],
        joints: wp.array[JointModel],
        control: ControlInput,
        # State in:
        body_q: wp.array[wp.transform],
        # In:
        sweep: int,
        color: int,
        threads: int,
        recovery: float,
        most: wp.array[wp.int32],
        # Work:
        worlds: wp.array[WorldWork],
        work: wp.array[BodyWork],
        rows: wp.array[RowWork],
        tree: wp.array[TreeWork],
        loops: wp.array[LoopWork],
        colors: wp.array[ColorWork],
        history: wp.array[History],
        # Work out:
        moved: wp.array2d[float],
    ):
        """Moves all blocks of a color once; the last color is for one thread alone.

        With a ``recovery`` above zero what was wrong at the start of the step goes, too.
        """
        sweep_blocks(
            wp.tid(),
            model[0],
            joints[0],
            control,
            body_q,
            sweep,
            color,
            threads,
            recovery,
            most,
            worlds[0],
            work[0],
            rows[0],
            tree[0],
            loops[0],
            colors[0],
            history[0],
            moved,
        )

    @kernel(effects.loops)
    def sweep_loops(
        # Model:
        model: BodyModel,
        joints: JointModel,
        control: ControlInput,
        # In:
        sweep: int,
        recovery: float,
        moved: wp.array2d[float],
        most: wp.array[wp.int32],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        colors: ColorWork,
        # Work out:
        loops: LoopWork,
        history: History,
    ):
        """The dual update of a joint outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, joints, worlds, work, loops)
        if goes_on(sweep, world, moved, most, colors):
            h = colors.scale[world].step
            loop_wrench(
                i, recovery, h, model, joints, control, work, tree, loops, history, True, True
            )

    @kernel(effects.cables)
    def solve_clusters(
        # Model:
        joints: JointModel,
        # In:
        sweep: int,
        recovery: float,
        most: wp.array[wp.int32],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        colors: ColorWork,
        history: History,
        # Work out:
        tree: TreeWork,
        moved: wp.array2d[float],
    ):
        """Tensions for the next sweep; one thread a cluster of cables."""
        cluster = wp.tid()
        world = tree.cables.world[cluster]
        if goes_on(sweep, world, moved, most, colors):
            changed = solve_cluster(cluster, recovery, joints, worlds, work, tree, history)
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
    def stiffen(
        # In:
        begin: int,
        # Work:
        worlds: WorldWork,
        colors: ColorWork,
        # Work out:
        rows: RowWork,
    ):
        """Contacts as stiff as the forces that sweeps have found ask for; one thread a body.

        Those of worlds whose round of sweeps begins with the sweep ``begin``.
        """
        body = wp.tid()
        world = worlds.of_body[body]
        if colors.begin[world] == begin:
            stiffen_rows(body, colors.scale[world], rows)

    @kernel()
    def remember(
        # Model:
        joints: JointModel,
        # State in:
        body_qd: wp.array[wp.spatial_vector],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        tree: TreeWork,
        loops: LoopWork,
        islands: IslandWork,
        # Work out:
        colors: ColorWork,
        history: History,
    ):
        """The last dual update, kept for the next step; one thread a body."""
        body = wp.tid()
        world = worlds.of_body[body]
        side = 1 - history.parity[world]
        scale = colors.scale[world]
        remember_rows(body, side, scale, body_qd, worlds, work, rows, islands, history)
        if wp.static(effects.joints and effects.pairs):
            if work.inv_mass[body] > 0.0:
                if tree.joint[body] >= 0:
                    join_at_once(islands, worlds, work, body, tree.parent[body])
                if wp.static(effects.loops):
                    for k in range(loops.body_start[body], loops.body_start[body + 1]):
                        other = other_end(body, loops.items[k], joints, loops)
                        slot = wp.where(other < 0, scale.static_slot, other)
                        join_at_once(islands, worlds, work, body, slot)
                if wp.static(effects.tendons):
                    if colors.block[body] == body:
                        join_tendons(worlds.rank[body], islands, worlds, work, tree)
        if not wp.isfinite(vector_sum(work.increment[body])):
            colors.is_finite[world] = 0

    @kernel(effects.second_order and effects.loops)
    def remember_loops(
        # Model:
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        loops: LoopWork,
        colors: ColorWork,
        # Work out:
        history: History,
    ):
        """How a joint outside of the trees has moved; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, joints, worlds, work, loops)
        if colors.is_finite[world] == 1:
            remember_loop(i, colors.scale[world], joints, loops, history)

    @kernel(effects.second_order and effects.cables)
    def find_jerked(
        # Work:
        tree: TreeWork,
        # Work out:
        colors: ColorWork,
    ):
        """Whether a cable's tension has jumped; one thread a cluster of cables."""
        cluster = wp.tid()
        world = tree.cables.world[cluster]
        scale = colors.scale[world]
        # tensions of steps of different order do not compare
        if scale.step == scale.h and has_jerked(cluster, scale, tree.cables):
            colors.jumps[world] = 1

    @kernel(effects.cables and effects.pairs)
    def join_clusters(
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        # Work out:
        islands: IslandWork,
    ):
        """Makes one island of bodies that cables pull; one thread a cluster of cables."""
        join_cluster(wp.tid(), worlds, work, tree, islands)

    @kernel(effects.breaking)
    def break_trees(
        # Model:
        model: BodyModel,
        joints: JointModel,
        control: ControlInput,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        loops: LoopWork,
        colors: ColorWork,
        # Work out:
        tree: TreeWork,
        history: History,
    ):
        """Breaks the joints of a block's tree; one thread a body, for a first one."""
        block = wp.tid()
        if colors.block[block] == block and colors.is_finite[worlds.of_body[block]] == 1:
            first = worlds.rank[block]
            break_blocks(
                first,
                worlds.block_end[first],
                colors.scale[worlds.of_body[block]].step,
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

    @kernel(effects.breaking and effects.loops)
    def break_loops(
        # Model:
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        loops: LoopWork,
        colors: ColorWork,
        # Work out:
        history: History,
    ):
        """Breaks joints outside of the trees; one thread a joint."""
        i = wp.tid()
        if colors.is_finite[loop_world(i, joints, worlds, work, loops)] == 1:
            break_loop(i, joints, loops, history)

    @kernel()
    def end_velocities(
        # Model:
        model: BodyModel,
        joints: JointModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        tree: TreeWork,
        loops: LoopWork,
        islands: IslandWork,
        colors: ColorWork,
        # Work out:
        history: History,
        # State out:
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Velocities; one thread a body."""
        body = wp.tid()
        world = worlds.of_body[body]
        velocity = body_qd[body]
        if wp.static(effects.balanced):
            islands.start_q[body] = body_q[body]
            islands.start_qd[body] = velocity
        if colors.is_finite[world] == 0:
            history.falling[body] = 0.0
        elif work.inv_mass[body] > 0.0:
            velocity = end_velocity(
                worlds.rank[body],
                colors.scale[world],
                body_q,
                body_qd,
                model,
                worlds,
                work,
                rows,
                tree,
                loops,
                islands,
                True,
                history,
            )
            if wp.static(effects.second_order):
                # until the step is done, that of its start
                history.last[body].velocity = body_qd[body]
                may_stand, scale = wp.static(effects.contact), colors.scale[world]
                if not is_quiet(body, velocity, may_stand, scale, model, work, history):
                    colors.is_moving[world] = 1
                if slips_otherwise(body, joints, tree, history):
                    colors.jumps[world] = 1
            if wp.static(effects.balanced and effects.kinds.gimbals):
                if is_body_led(body, joints, work, tree):
                    colors.is_excessive[0] = 1
            if wp.static(effects.restitution):
                if colors.has_impacts[world] == 1:
                    release_impacts(body, worlds, rows, tree, loops)
        body_qd_out[body] = velocity

    @kernel(effects.spinning)
    def align_spins(
        # Model:
        model: BodyModel,
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        loops: LoopWork,
        colors: ColorWork,
        # State out:
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Spins as their joints leave them; one thread a body, for the first of a block."""
        block = wp.tid()
        if colors.block[block] == block and colors.is_finite[worlds.of_body[block]] == 1:
            first = worlds.rank[block]
            align_block(
                first,
                worlds.block_end[first],
                model,
                joints,
                worlds,
                work,
                tree,
                loops,
                body_qd_out,
            )

    @kernel(effects.axis_rates)
    def end_armatures(
        # Model:
        joints: JointModel,
        # State in and out:
        body_qd: wp.array[wp.spatial_vector],
        body_qd_out: wp.array[wp.spatial_vector],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        colors: ColorWork,
        # Work out:
        history: History,
    ):
        """What armature has of a tree's joint; one thread a body."""
        body = wp.tid()
        world = worlds.of_body[body]
        if colors.is_finite[world] == 1 and work.inv_mass[body] > 0.0:
            if tree.joint[body] >= 0:
                end_armature(
                    tree.joint[body],
                    tree.axis_start[body],
                    tree.coordinate,
                    tree.start_coordinate,
                    colors.scale[world],
                    body_qd,
                    body_qd_out,
                    joints,
                    work,
                    tree,
                    history,
                )

    @kernel(effects.axis_rates and effects.loops)
    def end_loop_armatures(
        # Model:
        joints: JointModel,
        # State in and out:
        body_qd: wp.array[wp.spatial_vector],
        body_qd_out: wp.array[wp.spatial_vector],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        loops: LoopWork,
        colors: ColorWork,
        # Work out:
        history: History,
    ):
        """What armature has of a joint outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, joints, worlds, work, loops)
        if colors.is_finite[world] == 1:
            joint = loops.joints[i]
            end_armature(
                joint,
                joints.dof_start[joint],
                loops.coordinate,
                loops.start_coordinate,
                colors.scale[world],
                body_qd,
                body_qd_out,
                joints,
                work,
                tree,
                history,
            )

    @kernel()
    def end_sweeps(
        # Work out:
        colors: ColorWork,
        worlds: WorldWork,
        history: History,
    ):
        """What sweeps left, and how many the recovery takes; one thread a world."""
        world = wp.tid()
        scale = colors.scale[world]
        sweeps = count_sweeps(world, colors.moved)
        update = float(0.0)
        if sweeps > 0:
            update = colors.moved[sweeps, world]
        worlds.sweeps[world] = sweeps
        worlds.update[world] = length_of(update)
        worlds.settled[world] = settled_update(scale)
        is_open = colors.is_open[world] == 1
        passes = count_passes(sweeps, update, colors.deepest[world], is_open, scale)
        if colors.is_finite[world] == 0:
            passes = 0
        elif is_unsettled(update, scale):
            colors.is_excessive[0] = 1
        elif wp.static(effects.folding):
            if is_flat(world, worlds):
                colors.is_excessive[0] = 1
        colors.passes[world] = passes
        if passes > 1:
            colors.is_apart[0] = 1
        if wp.static(effects.second_order):
            # what does not settle tells nothing of the next step
            if not is_settled(update, scale) or colors.jumps[world] == 1:
                history.smooth[world] = JUMPED
            if colors.is_moving[world] == 0:
                history.smooth[world] = QUIET_WORLD

    @kernel(effects.second_order)
    def remember_motions(
        # Model:
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        tree: TreeWork,
        colors: ColorWork,
        # Work out:
        history: History,
    ):
        """How a body has moved, before anything old is recovered; one thread a body."""
        body = wp.tid()
        world = worlds.of_body[body]
        scale = colors.scale[world]
        if colors.is_finite[world] == 1:
            if work.inv_mass[body] > 0.0 and is_remembered(world, scale, history):
                remember_motion(body, scale, joints, work, rows, tree, history)
            if wp.static(effects.tendons):
                end_tendons(worlds.rank[body], scale, tree)

    @kernel(effects.loops)
    def keep_loops(
        # In:
        history: History,
        # Work out:
        loops: LoopWork,
    ):
        """What closes loops in the recovery is no force of the motion; one thread a joint."""
        i = wp.tid()
        loops.kept_force[i] = history.loop_force[i]
        loops.kept_torque[i] = history.loop_torque[i]

    @kernel(effects.joints)
    def close_joints(
        iterations: int,
        # Model:
        model: BodyModel,
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        colors: ColorWork,
        # Work out:
        work: BodyWork,
        tree: TreeWork,
    ):
        """Closes joints that are still open, and puts coordinates back to limits that they passed;
        one thread a body, for the first of a block."""
        block = wp.tid()
        world = worlds.of_body[block]
        if colors.block[block] == block and colors.is_finite[world] == 1:
            scale = colors.scale[world]
            last = worlds.update[world] * worlds.update[world]
            if colors.passes[world] > 0:
                last = colors.recovered[count_sweeps(world, colors.recovered), world]
            allowed = open_update(scale)
            if last > allowed * allowed:
                first = worlds.rank[block]
                for i in range(first, worlds.block_end[first]):
                    body = worlds.bodies[i]
                    if work.inv_mass[body] > 0.0 and is_linked(joints, tree, body):
                        put_together(body, scale.static_slot, model, joints, work, tree)
            if wp.static(effects.hard_limits):
                if worlds.sweeps[world] >= iterations:
                    first = worlds.rank[block]
                    end = worlds.block_end[first]
                    slot = scale.static_slot
                    stop_coordinates(first, end, slot, model, joints, worlds, work, tree)

    @kernel(effects.loops)
    def give_loops_back(
        # Model:
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        loops: LoopWork,
        colors: ColorWork,
        # Out:
        history: History,
    ):
        """Ends what :func:`keep_loops` began; one thread a joint."""
        i = wp.tid()
        if colors.is_finite[loop_world(i, joints, worlds, work, loops)] == 1:
            history.loop_force[i] = loops.kept_force[i]
            history.loop_torque[i] = loops.kept_torque[i]
            count_loop_turns(i, joints, work, loops, history)

    @kernel(effects.cables)
    def give_cables_back(
        # Work:
        work: BodyWork,
        # Work out:
        tree: TreeWork,
    ):
        """After the recovery: the tensions of the motion; one thread a cluster of cables."""
        give_back(wp.tid(), work, tree)

    @kernel()
    def end_poses(
        # Model:
        model: BodyModel,
        joints: JointModel,
        # State in:
        body_q: wp.array[wp.transform],
        # Work:
        work: BodyWork,
        rows: RowWork,
        tree: TreeWork,
        loops: LoopWork,
        islands: IslandWork,
        colors: ColorWork,
        # Work out:
        worlds: WorldWork,
        history: History,
        # State out:
        body_q_out: wp.array[wp.transform],
    ):
        """Poses, and what became of the worlds; one thread a body."""
        body = wp.tid()
        pose = body_q[body]
        world = worlds.of_body[body]
        is_held = colors.is_finite[world] == 0
        if is_held:
            rows.owned_end[body] = rows.owned_start[body]
            for side in range(2):
                history.start[side, body] = 0
                history.end[side, body] = 0
            if tree.joint.shape[0] > 0:
                forget_joints(body, joints, tree, loops, history)
        elif work.inv_mass[body] > 0.0:
            if wp.static(effects.restitution):
                if colors.has_impacts[world] == 1:
                    restore_impacts(body, colors.scale[world].h, work, rows)
            pose = end_pose(
                worlds.rank[body],
                colors.scale[world].h,
                body_q,
                model,
                joints,
                worlds,
                work,
                rows,
                tree,
                loops,
                islands,
                history,
            )
        body_q_out[body] = pose
        if body == worlds.bodies[colors.lane_start[colors.world_lane[world]]]:
            history.age[world] = wp.min(history.age[world] + 1, COLD_STEPS)
            if is_held:
                report_held(worlds, world)
                history.age[world] = 0
            history.parity[world] = 1 - history.parity[world]

    @kernel(effects.second_order)
    def remember_states(
        # Model:
        model: BodyModel,
        # State in:
        body_q: wp.array[wp.transform],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        colors: ColorWork,
        # Work out:
        history: History,
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Where the step has left a body, and how fast; one thread a body."""
        body = wp.tid()
        world = worlds.of_body[body]
        scale = colors.scale[world]
        if colors.is_finite[world] == 1 and is_remembered(world, scale, history):
            q, qd = body_q_out[body], body_qd_out[body]
            if work.inv_mass[body] == 0.0:
                remember_led(body, qd, scale, history)
            elif not is_flying(body, history):
                remember_state(world, body, q, qd, scale, body_q, model, work, history)

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
