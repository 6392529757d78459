# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The step of one world in one kernel, one thread a world: read ``solve_world`` top to bottom."""

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
    LinkModel,
    LoopWork,
    RowWork,
    ShapeModel,
    TreeWork,
    WorldWork,
)
from ..effects import Effects
from ..rows.contact import RECOVERY
from .adapting import make_adapt_world
from .bodies import make_predict_body
from .contacts import make_sort_by_owner
from .denormals import flush_denormals, restore_denormals
from .energy import keep_start
from .finite import hold_world, is_solution_finite, make_is_world_finite
from .launch import KERNEL, uncollected
from .links import gather_body, gather_joint, place_fixed_links, scatter_body
from .phases import make_phases
from .scale import (
    COLD_STEPS,
    STRUCK_FACTOR,
    is_struck,
    is_unsettled,
    most_rounds,
)
from .sides import make_written_side


@functools.cache
def make_solve_worlds(effects: Effects) -> wp.Function:
    """Device function: the whole step of the world of a thread, after prediction."""
    is_world_finite = make_is_world_finite(effects)
    written_side = make_written_side(effects)
    (
        begin_world,
        build_rows,
        begin_second_order,
        begin_joints,
        begin_sweeps,
        stiffen_impacts,
        sweep_to_rest,
        keep_forces,
        break_joints,
        end_velocities,
        begin_recovery,
        end_recovery,
        end_poses,
        gains_settled,
    ) = make_phases(effects)

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
        """The step of one world, phase by phase; what is not finite is held still."""
        if not is_world_finite(world, joints, control, worlds, work, tree, loops):
            hold_world(
                world,
                body_q,
                body_qd,
                joints,
                worlds,
                rows,
                tree,
                loops,
                history,
                body_q_out,
                body_qd_out,
            )
            return

        # Before the sweeps: contacts, then joints, then the blocks of both.
        scale = begin_world(world, h, tolerance, model, worlds, work, history)
        deepest = float(0.0)
        has_impacts = bool(False)
        if wp.static(effects.contact):
            deepest, has_impacts = build_rows(
                world,
                scale,
                model,
                shapes,
                joints,
                body_q,
                body_qd,
                contacts,
                worlds,
                work,
                rows,
                tree,
                loops,
                history,
            )
        if wp.static(effects.second_order):
            scale = begin_second_order(
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
        is_open = bool(False)
        if wp.static(effects.joints):
            is_open = begin_joints(
                world,
                scale,
                model,
                joints,
                control,
                body_q,
                body_qd,
                worlds,
                work,
                rows,
                tree,
                loops,
                history,
            )

        # Rounds of sweeps by one call, which is most of the code: the motion, again and with
        # stiffer contacts where impacts go on, and the recovery.
        most = int(0)
        sweeps = int(0)
        update = float(0.0)
        recovery = float(0.0)
        has_islands = bool(False)
        has_not_settled = bool(False)
        rounds = int(wp.static(most_rounds(effects)))
        for _round in range(rounds):
            if recovery == 0.0:
                most = begin_sweeps(
                    world,
                    iterations,
                    scale,
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
                if sweeps > 0:
                    most = iterations
            taken, update = sweep_to_rest(
                world,
                most,
                recovery,
                scale,
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
            if recovery > 0.0:
                break
            sweeps += taken
            if wp.static(effects.switching and not effects.ramp):
                is_cut_off = taken == iterations and sweeps < STRUCK_FACTOR * iterations
                if is_cut_off and is_struck(sweeps, update, scale):
                    if wp.static(effects.contact and not effects.compliance):
                        stiffen_impacts(world, scale, worlds, rows)
                    continue

            # After the motion: forces and velocities.
            has_islands = keep_forces(
                world,
                sweeps,
                update,
                scale,
                body_qd,
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
            if not is_solution_finite(world, worlds, work):
                hold_world(
                    world,
                    body_q,
                    body_qd,
                    joints,
                    worlds,
                    rows,
                    tree,
                    loops,
                    history,
                    body_q_out,
                    body_qd_out,
                )
                return
            if wp.static(effects.breaking):
                break_joints(
                    world,
                    scale.step,
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
            history.parity[world] = written_side(world, history)
            history.age[world] = wp.min(history.age[world] + 1, COLD_STEPS)
            if wp.static(effects.balanced):
                has_not_settled = is_unsettled(update, scale)
                if wp.static(effects.folding or effects.kinds.gimbals):
                    if gains_settled(world, joints, worlds, work, tree):
                        has_not_settled = True
                if has_not_settled:
                    keep_start(world, body_q, body_qd, worlds, islands)
            end_velocities(
                world,
                has_impacts,
                has_islands,
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
                islands,
                history,
                body_qd_out,
            )

            # Recovery: old errors go, without entering the velocity.
            if wp.static(not effects.ramp):
                most = begin_recovery(
                    world, sweeps, update, deepest, is_open, scale, loops, history
                )
                recovery = RECOVERY
                if most == 0:
                    break

        # After the recovery: poses.
        end_recovery(
            world,
            iterations,
            update,
            has_impacts,
            scale,
            model,
            joints,
            worlds,
            work,
            rows,
            tree,
            loops,
            history,
        )
        end_poses(
            world,
            has_islands,
            has_not_settled,
            scale,
            body_q,
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
            body_q_out,
            body_qd_out,
        )

    # the same arguments, so that either can stand for the step
    step_once = solve_world
    if effects.adaptive:
        step_once = make_adapt_world(effects, solve_world)

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
        for turn in range(thread, end, stride):
            world = int(turn)
            if wp.static(effects.on_gpu and not effects.sleeping):
                world = worlds.turn[turn]
                if world < 0:
                    return
            step_once(
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
def make_step_world(effects: Effects) -> wp.Function:
    """Device function: the whole step of a single world, by one thread."""
    predict_body = make_predict_body(effects)
    sort_by_owner = make_sort_by_owner()
    solve_worlds = make_solve_worlds(effects)

    @wp.func
    def step_world(
        model: wp.ref[BodyModel],
        shapes: wp.ref[ShapeModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
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
        for body in range(body_q.shape[0]):
            predict_body(
                body,
                model,
                body_q,
                body_qd,
                body_f,
                control,
                h,
                worlds,
                history.falling,
                tree.joint,
                work,
            )
            if wp.static(effects.adaptive):
                worlds.inner.wrench[body] = body_f[body]
        if wp.static(effects.contact):
            sort_by_owner(shapes, contacts, worlds, work, rows)
        solve_worlds(
            0,
            model,
            shapes,
            joints,
            control,
            work.pose,
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

    return step_world


@functools.cache
@uncollected()
def make_step(effects: Effects) -> wp.Kernel:
    """Kernel, one thread: the whole step of a single world on a CPU, where launches cost most."""
    step_world = make_step_world(effects)

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
        step_world(
            model[0],
            shapes[0],
            joints[0],
            control,
            body_q,
            body_qd,
            body_f,
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


@functools.cache
@uncollected()
def make_step_links(effects: Effects) -> wp.Kernel:
    """Kernel, one thread: as :func:`make_step`, of links that welds make bodies of."""
    step_world = make_step_world(effects)

    @wp.kernel(**KERNEL)
    def step_links(
        # Model:
        links: wp.array[LinkModel],
        model: wp.array[BodyModel],
        shapes: wp.array[ShapeModel],
        joints: wp.array[JointModel],
        control: ControlInput,
        # State in:
        link_q: wp.array[wp.transform],
        link_qd: wp.array[wp.spatial_vector],
        link_f: wp.array[wp.spatial_vector],
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
        link_q_out: wp.array[wp.transform],
        link_qd_out: wp.array[wp.spatial_vector],
    ):
        mode = flush_denormals()
        for joint in range(links[0].joint.shape[0]):
            gather_joint(joint, links[0])
        for body in range(links[0].leader.shape[0]):
            gather_body(body, model[0], links[0], control, link_q, link_qd, link_f)
        step_world(
            model[0],
            shapes[0],
            joints[0],
            control,
            links[0].body_q,
            links[0].body_qd,
            links[0].body_f,
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
            links[0].body_q_out,
            links[0].body_qd_out,
        )
        for body in range(links[0].leader.shape[0]):
            scatter_body(body, links[0], link_q, link_qd, link_q_out, link_qd_out)
        place_fixed_links(links[0], link_q_out, link_qd_out)
        restore_denormals(mode)

    return step_links
