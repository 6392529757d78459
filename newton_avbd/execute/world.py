# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The step of one world in one kernel, one thread a world: read ``solve`` top to bottom."""

import functools

import warp as wp

from ..data import (
    BodyModel,
    BodyWork,
    ContactInput,
    ControlInput,
    History,
    IslandWork,
    JointModel,
    LoopWork,
    RowWork,
    ShapeModel,
    TreeWork,
    WorldWork,
)
from ..effects import Effects
from ..rows import contact as contact_rows
from .bdf2 import make_bdf2
from .beginning import make_begin
from .bodies import make_predict_body
from .breaking import make_break_joints
from .closures import make_closures
from .contacts import make_rows, make_sort_by_owner
from .denormals import flush_denormals, restore_denormals
from .ending import make_end, make_remember
from .finite import hold_world, is_solution_finite, make_is_world_finite
from .gathering import make_assemble, make_gather
from .impacts import free_share, make_impacts
from .islands import join_islands, keep_momentum, keep_spin
from .launch import KERNEL, uncollected
from .loops import make_loops, parent_slot
from .piles import make_piles
from .scale import (
    COLD_FACTOR,
    COLD_STEPS,
    LONGER,
    make_count_passes,
    make_measure_world,
    settled_update,
    unsettled_update,
)
from .sweeps import make_sweep, make_sweep_block, make_sweep_world
from .trees import is_linked, make_trees
from .weights import make_weigh


@functools.cache
def make_solve_worlds(effects: Effects) -> wp.Function:
    """Device function: the whole step of the world of a thread, after prediction."""
    measure_world = make_measure_world(effects)
    is_world_finite = make_is_world_finite(effects)
    find_rows, penalise_rows = make_rows(effects)
    weigh_blocks = make_weigh(effects)
    impacts = make_impacts(effects)
    bdf2 = make_bdf2(effects)
    begin_bdf2, remember_motion = bdf2.begin_step, bdf2.remember_motion
    remember_loops, remember_state = bdf2.remember_loops, bdf2.remember_state
    find_impacts = impacts.find_impacts
    find_wait = impacts.find_wait
    release_impacts = impacts.release_impacts
    restore_impacts = impacts.restore_impacts
    loop_functions = make_loops(effects)
    loop_wrench = loop_functions.loop_wrench
    loop_curvature = loop_functions.loop_curvature
    contact_force = contact_rows.force if effects.friction else contact_rows.normal_force
    sweep_gap = contact_rows.whole_gap if effects.compliance else contact_rows.rigid_gap

    assemble_body = make_assemble(effects, loop_curvature)
    remember_rows = make_remember(effects, contact_force, sweep_gap, join_islands)
    gather = make_gather(effects, contact_force, sweep_gap, loop_wrench)
    sweep_body = make_sweep(effects, gather)
    piles = make_piles(effects, gather)
    link_piles = piles.link_piles
    factor_piles = piles.factor_piles
    break_joints = make_break_joints(effects, gather)
    closures = make_closures(effects)
    trees = make_trees(effects, gather, closures.begin_rows, closures.keep_forces)
    sweep_block = make_sweep_block(effects, sweep_body, trees.sweep_tree)
    sweep_world = make_sweep_world(effects, sweep_block, piles.sweep_piles, loop_wrench)
    put_together = trees.put_together
    begin = make_begin(effects, trees, loop_functions, closures.begin_closures, assemble_body)
    measure_blocks = begin.measure_blocks
    measure_loop = begin.measure_loop
    place_blocks = begin.place_blocks
    begin_body = begin.begin_body
    end_velocity, end_armature, end_pose = make_end(effects)
    count_passes = make_count_passes(effects)

    @wp.func
    def solve_world(
        world: int,
        # Model:
        model: wp.ref[BodyModel],
        shapes: wp.ref[ShapeModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        contacts: wp.ref[ContactInput],
        h: float,
        iterations: int,
        tolerance: float,
        # Work:
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        islands: wp.ref[IslandWork],
        history: wp.ref[History],
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        body_start = worlds.body_start[world]
        body_end = worlds.body_start[world + 1]
        if not is_world_finite(world, joints, control, worlds, work, tree, loops):
            hold_world(world, body_q, body_qd, worlds, rows, history, body_q_out, body_qd_out)
            return

        # Rows: linearised at state_in, warm-started from the last step.
        scale = measure_world(world, h, model, worlds, work)
        # forces that stopped something within a short step would push too long in a longer one
        if h > LONGER * history.step[world]:
            history.age[world] = 0
        if wp.static(effects.bdf2):
            if worlds.step[world] < history.step[world]:
                scale.lag = 0.0
        history.step[world] = h
        deepest = float(0.0)
        has_impacts = bool(False)
        if wp.static(effects.contact):
            contact_count = int(0)
            for i in range(body_start, body_end):
                body = worlds.bodies[i]
                contact_count += rows.owned_end[body] - rows.owned_start[body]
            if contact_count > 0:
                for i in range(body_start, body_end):
                    body = worlds.bodies[i]
                    find_rows(
                        world,
                        body,
                        scale,
                        body_q,
                        model,
                        shapes,
                        contacts,
                        worlds,
                        work,
                        rows,
                        history,
                    )
            if wp.static(effects.piles):
                link_piles(world, scale.slop, model, worlds, work, rows, tree)
            if contact_count > 0:
                if wp.static(effects.light_links):
                    weigh_blocks(
                        body_start, body_end, body_q, model, joints, worlds, work, rows, tree
                    )
                for i in range(body_start, body_end):
                    body = worlds.bodies[i]
                    depth = penalise_rows(
                        world, body, scale, shapes, contacts, work, rows, tree, history
                    )
                    deepest = wp.max(deepest, depth)
            if wp.static(effects.restitution):
                if contact_count > 0:
                    has_impacts = find_impacts(
                        world,
                        1 - history.parity[world],
                        scale,
                        body_qd,
                        shapes,
                        worlds,
                        work,
                        rows,
                        tree,
                        loops,
                        history,
                    )
            history.filling[world, 0] = 0
            if wp.static(effects.matching):
                history.filling[world, 0] = contacts.buffer
                history.filling[world, 1] = contacts.generation[0]
        if wp.static(effects.bdf2):
            scale = begin_bdf2(
                world,
                has_impacts,
                scale,
                body_q,
                body_qd,
                model,
                joints,
                worlds,
                work,
                rows,
                tree,
                loops,
                history,
            )
        step = scale.step
        is_open = bool(False)
        if wp.static(effects.joints):
            is_open = measure_blocks(
                body_start,
                body_end,
                scale,
                body_q,
                body_qd,
                model,
                joints,
                worlds,
                work,
                rows,
                tree,
                loops,
                history,
            )
            if wp.static(effects.loops):
                for i in range(loops.world_start[world], loops.world_start[world + 1]):
                    if measure_loop(
                        i, scale, body_q, body_qd, model, joints, work, tree, loops, history
                    ):
                        is_open = True
            if place_blocks(
                body_start, body_end, scale.static_slot, body_q, model, joints, worlds, work, tree
            ):
                is_open = True

        # Sweeps: a body that nothing touches is at its target at once.
        sweeps = int(0)
        for i in range(body_start, body_end):
            body = worlds.bodies[i]
            if work.inv_mass[body] > 0.0:
                if begin_body(
                    i,
                    step,
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
                ):
                    sweeps = iterations
                if wp.static(effects.joints and effects.pairs):
                    if tree.joint[body] >= 0:
                        join_islands(islands, worlds, work, body, tree.parent[body])
        if wp.static(effects.piles):
            factor_piles(world, worlds, work, rows)
        if wp.static(not effects.ramp):
            if history.age[world] < COLD_STEPS:
                sweeps = COLD_FACTOR * sweeps
        settled = settled_update(scale)
        enough = wp.max(tolerance, settled)
        update = float(0.0)
        recovery = float(0.0)
        sweep = int(0)
        has_islands = bool(False)
        rounds = int(wp.static(1 if effects.ramp else 2))
        # Two rounds of sweeps, the motion and the recovery, by one call: it is most of the code.
        for _round in range(rounds):
            while sweep < sweeps:
                update = sweep_world(
                    world,
                    sweep > 0 and recovery == 0.0,
                    recovery,
                    scale.slop,
                    step,
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
                sweep += 1
                if wp.static(not effects.ramp):
                    if update <= enough * enough:
                        sweeps = sweep
            if recovery > 0.0:
                break
            if wp.static(effects.bdf2):
                if update > enough * enough:
                    # what does not settle tells nothing of the next step
                    history.smooth[world] = 0
                remember_loops(world, scale, joints, loops, history)
            worlds.sweeps[world] = sweeps
            worlds.update[world] = wp.sqrt(update)
            worlds.settled[world] = settled
            side = 1 - history.parity[world]
            if wp.static(effects.contact):
                for i in range(body_start, body_end):
                    remember_rows(
                        worlds.bodies[i], side, scale, body_qd, worlds, work, rows, islands, history
                    )
                if wp.static(effects.loops):
                    for i in range(loops.world_start[world], loops.world_start[world + 1]):
                        joint = loops.joints[i]
                        parent = parent_slot(joints, joint, scale.static_slot)
                        join_islands(islands, worlds, work, joints.child[joint], parent)
                if wp.static(effects.pairs and not effects.ramp):
                    if sweeps > 0:
                        has_islands = keep_momentum(world, model, worlds, work, islands)
            if not is_solution_finite(world, worlds, work):
                hold_world(world, body_q, body_qd, worlds, rows, history, body_q_out, body_qd_out)
                return
            if wp.static(effects.breaking):
                break_joints(
                    world, step, model, joints, control, worlds, work, rows, tree, loops, history
                )
            history.parity[world] = side
            history.age[world] = wp.min(history.age[world] + 1, COLD_STEPS)

            # Velocity, from the increments themselves.
            for i in range(body_start, body_end):
                body = worlds.bodies[i]
                velocity = body_qd[body]
                if work.inv_mass[body] > 0.0:
                    velocity = end_velocity(
                        i,
                        step,
                        body_q,
                        body_qd,
                        model,
                        worlds,
                        work,
                        rows,
                        tree,
                        loops,
                        islands,
                        history,
                    )
                    if wp.static(effects.bdf2):
                        remember_motion(
                            body, body_qd[body], scale, joints, work, rows, tree, history
                        )
                body_qd_out[body] = velocity

            if wp.static(effects.restitution):
                if has_impacts:
                    for i in range(body_start, body_end):
                        body = worlds.bodies[i]
                        rows.struck_at[body] = find_wait(body, worlds, rows, tree, loops)
                    for i in range(body_start, body_end):
                        release_impacts(worlds.bodies[i], h, work, rows)
                    for i in range(body_start, body_end):
                        body = worlds.bodies[i]
                        if rows.struck_at[body] >= 0.0:
                            history.falling[body] = free_share(body, scale, work)
            if wp.static(effects.armature):
                for i in range(body_start, body_end):
                    body = worlds.bodies[i]
                    if work.inv_mass[body] > 0.0 and tree.joint[body] >= 0:
                        end_armature(
                            tree.joint[body],
                            tree.axis_start[body],
                            tree.coordinate,
                            tree.start_coordinate,
                            scale,
                            body_qd,
                            body_qd_out,
                            joints,
                            work,
                            tree,
                            history,
                        )
                if wp.static(effects.loops):
                    for i in range(loops.world_start[world], loops.world_start[world + 1]):
                        joint = loops.joints[i]
                        end_armature(
                            joint,
                            joints.dof_start[joint],
                            loops.coordinate,
                            loops.start_coordinate,
                            scale,
                            body_qd,
                            body_qd_out,
                            joints,
                            work,
                            tree,
                            history,
                        )

            # Recovery: old errors go, without entering the velocity.
            if wp.static(not effects.ramp):
                sweeps = count_passes(sweeps, update, deepest, is_open, scale)
                recovery = contact_rows.RECOVERY
                sweep = 0
                if wp.static(effects.loops):
                    # what closes them now is no force of the motion
                    for i in range(loops.world_start[world], loops.world_start[world + 1]):
                        loops.kept_force[i] = history.loop_force[i]
                        loops.kept_torque[i] = history.loop_torque[i]

        if wp.static(effects.joints):
            unsettled = unsettled_update(scale)
            if update > unsettled * unsettled:
                # after impacts that no iteration settles joints are closed all the same
                for i in range(body_start, body_end):
                    body = worlds.bodies[i]
                    if work.inv_mass[body] > 0.0 and is_linked(joints, tree, body):
                        put_together(body, scale.static_slot, model, joints, work, tree)
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                history.loop_force[i] = loops.kept_force[i]
                history.loop_torque[i] = loops.kept_torque[i]

        if wp.static(effects.restitution):
            if has_impacts:
                for i in range(body_start, body_end):
                    restore_impacts(worlds.bodies[i], h, work, rows)

        # Poses.
        for i in range(body_start, body_end):
            body = worlds.bodies[i]
            pose = body_q[body]
            if work.inv_mass[body] > 0.0:
                pose = end_pose(i, body_q, model, worlds, work, rows, tree, loops, islands, history)
            body_q_out[body] = pose
        if wp.static(effects.gyroscopic and effects.contact):
            if has_islands:
                keep_spin(world, step, body_q_out, model, worlds, work, islands, body_qd_out)
        if wp.static(effects.bdf2):
            for i in range(body_start, body_end):
                body = worlds.bodies[i]
                if work.inv_mass[body] > 0.0:
                    remember_state(
                        body,
                        body_q_out[body],
                        body_qd_out[body],
                        scale,
                        body_q,
                        model,
                        work,
                        history,
                    )

    @wp.func
    def solve_worlds(
        thread: int,
        model: wp.ref[BodyModel],
        shapes: wp.ref[ShapeModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        contacts: wp.ref[ContactInput],
        h: float,
        iterations: int,
        tolerance: float,
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        islands: wp.ref[IslandWork],
        history: wp.ref[History],
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """The world of a thread; what is awake is solved island by island, as worlds are."""
        end = int(thread + 1)
        stride = int(1)
        if wp.static(effects.sleeping):
            end = worlds.island_start[worlds.island_start.shape[0] - 1]
            stride = worlds.threads
        for world in range(thread, end, stride):
            solve_world(
                world,
                model,
                shapes,
                joints,
                control,
                body_q,
                body_qd,
                contacts,
                h,
                iterations,
                tolerance,
                worlds,
                work,
                rows,
                tree,
                loops,
                islands,
                history,
                body_q_out,
                body_qd_out,
            )

    return solve_worlds


@functools.cache
@uncollected()
def make_solve(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a world: what :func:`make_solve_worlds` does for each."""
    solve_worlds = make_solve_worlds(effects)

    @wp.kernel(**KERNEL)
    def solve(
        first: int,
        # Model:
        model: wp.array[BodyModel],
        shapes: wp.array[ShapeModel],
        joints: wp.array[JointModel],
        control: ControlInput,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        contacts: ContactInput,
        h: float,
        iterations: int,
        tolerance: float,
        # Work:
        worlds: wp.array[WorldWork],
        work: wp.array[BodyWork],
        rows: wp.array[RowWork],
        tree: wp.array[TreeWork],
        loops: wp.array[LoopWork],
        islands: wp.array[IslandWork],
        history: wp.array[History],
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """The worlds from ``first`` on."""
        mode = flush_denormals()
        solve_worlds(
            first + wp.tid(),
            model[0],
            shapes[0],
            joints[0],
            control,
            body_q,
            body_qd,
            contacts,
            h,
            iterations,
            tolerance,
            worlds[0],
            work[0],
            rows[0],
            tree[0],
            loops[0],
            islands[0],
            history[0],
            body_q_out,
            body_qd_out,
        )
        restore_denormals(mode)

    return solve


@functools.cache
@uncollected()
def make_step(effects: Effects) -> wp.Kernel:
    """Kernel, one thread: the whole step of a single world on a CPU, where launches cost most."""
    predict_body = make_predict_body(effects)
    sort_by_owner = make_sort_by_owner()
    solve_worlds = make_solve_worlds(effects)

    @wp.kernel(**KERNEL)
    def step(
        # Model:
        model: wp.array[BodyModel],
        shapes: wp.array[ShapeModel],
        joints: wp.array[JointModel],
        control: ControlInput,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        contacts: ContactInput,
        h: float,
        iterations: int,
        tolerance: float,
        # Work:
        worlds: wp.array[WorldWork],
        work: wp.array[BodyWork],
        rows: wp.array[RowWork],
        tree: wp.array[TreeWork],
        loops: wp.array[LoopWork],
        islands: wp.array[IslandWork],
        history: wp.array[History],
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        mode = flush_denormals()
        for body in range(body_q.shape[0]):
            predict_body(
                body,
                model[0],
                body_q,
                body_qd,
                body_f,
                control,
                h,
                worlds[0],
                history[0].falling,
                tree[0].joint,
                work[0],
            )
        if wp.static(effects.contact):
            sort_by_owner(shapes[0], contacts, worlds[0], work[0], rows[0])
        solve_worlds(
            0,
            model[0],
            shapes[0],
            joints[0],
            control,
            work[0].pose,
            body_qd,
            contacts,
            h,
            iterations,
            tolerance,
            worlds[0],
            work[0],
            rows[0],
            tree[0],
            loops[0],
            islands[0],
            history[0],
            body_q_out,
            body_qd_out,
        )
        restore_denormals(mode)

    return step
