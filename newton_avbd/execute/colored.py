# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The step of large worlds of free bodies: the kernels that :class:`.large.LargeWorlds` launches.

What ``world.solve`` does in one thread, one kernel does here for one stage and all bodies: the
mathematics is the same functions. A sweep takes a launch for each color, and as bodies of a color
share no contact, that is what a sweep of one thread in the order of the colors computes. Where
nothing moves any more, the launches that are left return at once.
"""

import functools
import hashlib
from typing import NamedTuple

import warp as wp

from ..algebra.block import factor_block
from ..blocks.body import carried_roll, origin_shift, rolled, spin_of, turned
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
from .bodies import has_rows, pose_sum, report_held, vector_sum
from .coloring import is_owner, sort_part
from .contacts import body_slot, find_row, make_linearise_rows, make_rows, owner_of
from .islands import begin_island, is_alone
from .joining import join_at_once
from .launch import KERNEL
from .loops import make_loops
from .world import (
    COLD_STEPS,
    LONGER,
    SETTLED,
    make_assemble,
    make_gather,
    make_is_world_finite,
    make_measure_world,
    make_remember,
    make_sweep,
)


class Colored(NamedTuple):
    """Kernels in the order of the step."""

    measure_lanes: wp.Kernel
    begin_step: wp.Kernel
    build_rows: wp.Kernel
    recall_rows: wp.Kernel
    penalise: wp.Kernel
    assemble: wp.Kernel
    sweep_color: wp.Kernel
    remember: wp.Kernel
    end_velocities: wp.Kernel
    recover_color: wp.Kernel
    end_poses: wp.Kernel


@wp.func
def is_settled(moved: float, tolerance: float, scale: WorldScale) -> bool:
    """Whether a sweep that moved a body by no more than the root of ``moved`` [m^2] is the last."""
    enough = wp.max(tolerance, SETTLED * scale.gravity * scale.h * scale.h)
    return moved <= enough * enough


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
def make_colored(effects: Effects) -> Colored:
    """The kernels of a large world, in one module."""
    module = wp.get_module(f"{__name__}_{hashlib.sha256(repr(effects).encode()).hexdigest()[:8]}")
    module.options |= KERNEL["module_options"]
    measure_world = make_measure_world(effects)
    is_world_finite = make_is_world_finite(effects)
    linearise_rows = make_linearise_rows(effects)
    penalise_rows = make_rows(effects)[1]
    loop_functions = make_loops(effects)
    contact_force = contact_rows.force if effects.friction else contact_rows.normal_force
    sweep_gap = contact_rows.whole_gap if effects.compliance else contact_rows.rigid_gap
    gather = make_gather(effects, contact_force, sweep_gap, loop_functions.loop_wrench)
    sweep_body = make_sweep(effects, gather)
    assemble_body = make_assemble(effects, loop_functions.loop_curvature)
    remember_rows = make_remember(effects, contact_force, sweep_gap, join_at_once)

    @wp.kernel(enable_backward=False, module=module)
    def measure_lanes(
        # Model:
        model: BodyModel,
        joints: JointModel,
        control: ControlInput,
        h: float,
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
        colors.lane_scale[lane] = measure_world(lane, h, model, worlds, work)
        is_finite = is_world_finite(lane, joints, control, worlds, work, tree, loops)
        colors.lane_finite[lane] = int(is_finite)
        if lane == 0:
            colors.is_cold[0] = 0

    @wp.kernel(enable_backward=False, module=module)
    def begin_step(
        # In:
        h: float,
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
        for i in range(colors.moved.shape[0]):
            colors.moved[i, world] = wp.where(i == 0, wp.inf, -1.0)
        if h > LONGER * history.step[world]:
            history.age[world] = 0
        history.step[world] = h
        if history.age[world] < COLD_STEPS:
            colors.is_cold[0] = 1

    @wp.kernel(enable_backward=False, module=module)
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

    @wp.kernel(enable_backward=False, module=module)
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

    @wp.kernel(enable_backward=False, module=module)
    def penalise(
        # Model:
        shapes: ShapeModel,
        # Contacts in:
        contacts: ContactInput,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        history: History,
        # Work out:
        colors: ColorWork,
    ):
        """Penalties of the rows that a body owns; one thread a body."""
        body = wp.tid()
        world = worlds.of_body[body]
        scale = colors.scale[world]
        depth = penalise_rows(world, body, scale, shapes, contacts, work, rows, history)
        if depth > colors.deepest[world]:
            wp.atomic_max(colors.deepest, world, depth)

    @wp.kernel(enable_backward=False, module=module)
    def assemble(
        # Model:
        model: BodyModel,
        joints: JointModel,
        control: ControlInput,
        h: float,
        # Work:
        worlds: WorldWork,
        rows: RowWork,
        tree: TreeWork,
        loops: LoopWork,
        history: History,
        # Work out:
        work: BodyWork,
        islands: IslandWork,
    ):
        """Factors the block of a body, or puts it to its target; one thread a body."""
        body = wp.tid()
        if work.inv_mass[body] > 0.0:
            begin_island(islands, body)
            if has_rows(rows, body):
                h_ll, h_al, h_aa = assemble_body(
                    body, h, model, joints, control, worlds, work, rows, tree, loops, history
                )
                work.factor[body] = factor_block(h_ll, h_al, h_aa)
            else:
                work.increment[body] = work.target[body]

    @wp.kernel(enable_backward=False, module=module)
    def sweep_color(
        # Model:
        model: BodyModel,
        joints: JointModel,
        control: ControlInput,
        # In:
        sweep: int,
        color: int,
        threads: int,
        iterations: int,
        tolerance: float,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        tree: TreeWork,
        loops: LoopWork,
        colors: ColorWork,
        history: History,
    ):
        """Moves all bodies of a color once; the last color is for one thread alone."""
        lanes = colors.lane_start.shape[0] - 1
        first = colors.start[color * lanes] + wp.tid()
        for i in range(first, colors.start[(color + 1) * lanes], threads):
            body = colors.order[i]
            world = worlds.of_body[body]
            scale = colors.scale[world]
            goes_on = not is_settled(colors.moved[sweep, world], tolerance, scale)
            goes_on = goes_on and (sweep < iterations or history.age[world] < COLD_STEPS)
            if goes_on and has_rows(rows, body):
                moved = sweep_body(
                    body,
                    sweep > 0,
                    0.0,
                    scale.slop,
                    scale.h,
                    model,
                    joints,
                    control,
                    work,
                    rows,
                    tree,
                    loops,
                    history,
                )
                # looks first, since few of many threads have to
                if moved > colors.moved[sweep + 1, world]:
                    wp.atomic_max(colors.moved, sweep + 1, world, moved)

    @wp.kernel(enable_backward=False, module=module)
    def remember(
        # State in:
        body_qd: wp.array[wp.spatial_vector],
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
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
        if not wp.isfinite(vector_sum(work.increment[body])):
            colors.is_finite[world] = 0

    @wp.kernel(enable_backward=False, module=module)
    def end_velocities(
        # Model:
        model: BodyModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        h: float,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        islands: IslandWork,
        colors: ColorWork,
        # Work out:
        history: History,
        # State out:
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Velocities, from the increments themselves; one thread a body."""
        body = wp.tid()
        velocity = body_qd[body]
        if colors.is_finite[worlds.of_body[body]] == 0:
            history.falling[body] = 0.0
        elif work.inv_mass[body] > 0.0:
            increment = work.increment[body]
            coasting = h * velocity
            free = wp.spatial_top(work.target[body] - coasting)
            got = wp.spatial_top(increment - coasting)
            history.falling[body] = wp.clamp(
                wp.dot(got, free) / wp.max(wp.dot(free, free), 1.0e-30), 0.0, 1.0
            )
            velocity = increment / h
            if wp.static(effects.gyroscopic):
                spin = wp.spatial_bottom(velocity)
                if has_rows(rows, body) and not is_alone(islands, body):
                    spin += carried_roll(h * spin, work.inv_inertia[body]) / h
                else:
                    end = turned(body_q[body], increment)
                    spin = spin_of(model.inv_inertia[body], end, work.momentum[body])
                velocity = wp.spatial_vector(wp.spatial_top(velocity), spin)
        body_qd_out[body] = velocity

    @wp.kernel(enable_backward=False, module=module)
    def recover_color(
        # Model:
        model: BodyModel,
        joints: JointModel,
        control: ControlInput,
        # In:
        color: int,
        threads: int,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        tree: TreeWork,
        loops: LoopWork,
        colors: ColorWork,
        history: History,
    ):
        """As ``sweep_color``, takes out old penetration without entering the velocity."""
        lanes = colors.lane_start.shape[0] - 1
        first = colors.start[color * lanes] + wp.tid()
        for i in range(first, colors.start[(color + 1) * lanes], threads):
            body = colors.order[i]
            world = worlds.of_body[body]
            scale = colors.scale[world]
            if colors.deepest[world] > scale.slop and has_rows(rows, body):
                sweep_body(
                    body,
                    False,
                    contact_rows.RECOVERY,
                    scale.slop,
                    scale.h,
                    model,
                    joints,
                    control,
                    work,
                    rows,
                    tree,
                    loops,
                    history,
                )

    @wp.kernel(enable_backward=False, module=module)
    def end_poses(
        # Model:
        model: BodyModel,
        # State in:
        body_q: wp.array[wp.transform],
        # Work:
        work: BodyWork,
        rows: RowWork,
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
        elif work.inv_mass[body] > 0.0:
            increment = work.increment[body]
            rotation = turned(pose, increment)
            if wp.static(effects.gyroscopic):
                if has_rows(rows, body) and not is_alone(islands, body):
                    rotation = rolled(pose, increment, work.inv_inertia[body])
            shift = origin_shift(pose, model.com[body], increment, rotation)
            moved = wp.transform(wp.transform_get_translation(pose) + shift, rotation)
            if wp.isfinite(pose_sum(moved)):
                pose = moved
            else:
                report_held(worlds, world)
        body_q_out[body] = pose
        if body == worlds.bodies[colors.lane_start[colors.world_lane[world]]]:
            history.age[world] = wp.min(history.age[world] + 1, COLD_STEPS)
            if is_held:
                report_held(worlds, world)
                history.age[world] = 0
            history.parity[world] = 1 - history.parity[world]
            sweeps = int(0)
            last = colors.moved.shape[0] - 1
            while sweeps < last and colors.moved[sweeps + 1, world] >= 0.0:
                sweeps += 1
            worlds.sweeps[world] = sweeps
            worlds.update[world] = 0.0
            if sweeps > 0:
                worlds.update[world] = wp.sqrt(colors.moved[sweeps, world])

    return Colored(
        measure_lanes,
        begin_step,
        build_rows,
        recall_rows,
        penalise,
        assemble,
        sweep_color,
        remember,
        end_velocities,
        recover_color,
        end_poses,
    )
