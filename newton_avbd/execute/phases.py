# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The phases of a world's step, in the order in which ``world.solve_world`` runs them."""

from typing import NamedTuple

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
    WorldScale,
    WorldWork,
)
from ..effects import Effects
from ..rows import contact as contact_rows
from .beginning import make_begin, make_coasting
from .bodies import body_at
from .breaking import make_break_joints
from .cables import make_cables, make_join
from .closures import make_closures
from .contacts import make_rows, stiffen_rows
from .ending import make_end, make_remember
from .energy import make_energy
from .gathering import make_assemble, make_gather
from .impacts import leave_impacts, make_impacts
from .islands import join_islands, keep_momentum, keep_spin
from .launch import ABSENT, absent
from .loops import make_loops, reach_farther
from .piles import make_piles
from .scale import (
    LONGER,
    MUCH_LONGER,
    last_update,
    length_of,
    make_count_passes,
    make_measure_world,
    open_update,
    settled_update,
    sweeps_at_age,
)
from .second_order import lead_spin, make_second_order
from .sides import make_written_side
from .sweeps import make_sweep, make_sweep_block, make_sweep_world
from .tendons import make_join_tendons
from .trees import is_linked, make_trees, parent_slot
from .weights import make_weigh


class Phases(NamedTuple):
    """Device functions in the order of the step, compiled for the effects of a scene."""

    begin_world: wp.Function
    build_rows: wp.Function
    begin_second_order: wp.Function
    begin_joints: wp.Function
    begin_sweeps: wp.Function
    stiffen_impacts: wp.Function
    sweep_to_rest: wp.Function
    keep_forces: wp.Function
    break_joints: wp.Function
    end_velocities: wp.Function
    begin_recovery: wp.Function
    end_recovery: wp.Function
    end_poses: wp.Function
    gains_settled: wp.Function


def make_phases(effects: Effects) -> Phases:
    """Makes the device functions of the phases, and all that they call."""
    measure_world = make_measure_world(effects)
    find_rows, penalise_rows = make_rows(effects)
    weigh_blocks = make_weigh(effects) if effects.light_links else absent
    second_order = make_second_order(effects) if effects.second_order else ABSENT
    remember_motions, remember_loop = second_order.remember_motions, second_order.remember_loop
    remember_states = second_order.remember_states
    impacts = make_impacts(effects) if effects.restitution else ABSENT
    find_impacts = impacts.find_impacts
    release_impacts, restore_impacts = impacts.release_impacts, impacts.restore_impacts
    loop_functions = make_loops(effects) if effects.loops else ABSENT
    loop_wrench, count_loop_turns = loop_functions.loop_wrench, loop_functions.count_turns
    contact_force = contact_rows.force if effects.friction else contact_rows.normal_force
    sweep_gap = contact_rows.whole_gap if effects.compliance else contact_rows.rigid_gap
    gather = make_gather(effects, contact_force, sweep_gap, loop_wrench)
    assemble_body = make_assemble(effects, loop_functions.loop_curvature)
    piles = make_piles(effects, gather, make_coasting(effects)) if effects.piles else ABSENT
    link_piles, factor_piles = piles.link_piles, piles.factor_piles
    spend_impacts = piles.spend_impacts
    closures = make_closures(effects) if effects.closures else ABSENT
    trees = ABSENT
    if effects.joints:
        trees = make_trees(
            effects,
            gather,
            closures.begin_rows,
            closures.keep_forces,
            closures.missed_by_lines,
            closures.settle_tendons,
        )
    align_spins, put_together = trees.align_spins, trees.put_together
    stop_coordinates = trees.stop_coordinates
    measure_blocks, measure_loop, place_blocks, begin_body = make_begin(
        effects,
        trees,
        loop_functions,
        closures.begin_closures,
        closures.begin_tendons,
        assemble_body,
    )
    sweep_block = make_sweep_block(effects, make_sweep(effects, gather), trees.sweep_tree)
    cables = make_cables(effects) if effects.cables else ABSENT
    begin_cluster, give_back = cables.begin_cluster, cables.give_back
    has_jerked = cables.has_jerked
    join_cluster = make_join(join_islands) if effects.cables else absent
    sweep_world = make_sweep_world(
        effects, sweep_block, piles.sweep_piles, loop_wrench, cables.solve_cluster
    )
    remember_rows = make_remember(effects, contact_force, sweep_gap, join_islands)
    breaking = ABSENT
    if effects.breaking:
        breaking = make_break_joints(effects, gather, closures.load_tendons)
    end_tendons = closures.end_tendons
    join_tendons = make_join_tendons(join_islands) if effects.tendons else absent
    break_blocks, break_loop = breaking.break_blocks, breaking.break_loop
    end_velocity, end_armature, end_pose = make_end(effects, trees.count_turns)
    count_passes = make_count_passes(effects)
    energy = make_energy(effects) if effects.balanced else ABSENT
    bound_world, gains_settled = energy.bound_world, energy.gains_settled

    written_side = make_written_side(effects)

    @wp.func
    def begin_world(
        world: int,
        h: float,
        tolerance: float,
        model: wp.ref[BodyModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        history: wp.ref[History],
    ) -> WorldScale:
        """How far things may go in the step; takes a much longer step than the last as a start."""
        scale = measure_world(world, h, tolerance, model, worlds, work)
        # forces that stopped something within a short step would push too long in a longer one
        if h > wp.static(MUCH_LONGER if effects.adaptive else LONGER) * history.step[world]:
            history.age[world] = 0
        if wp.static(effects.second_order):
            if worlds.step[world] < history.step[world]:
                scale.lag = 0.0
        history.step[world] = h
        return scale

    @wp.func
    def build_rows(
        world: int,
        scale: WorldScale,
        model: wp.ref[BodyModel],
        shapes: wp.ref[ShapeModel],
        joints: wp.ref[JointModel],
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        contacts: wp.ref[ContactInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ):
        """Rows of the contacts: linearised at state_in, warm-started from the last step, penalised.

        Returns the deepest penetration [m], and whether impacts bounce.
        """
        body_start = worlds.body_start[world]
        body_end = worlds.body_start[world + 1]
        deepest = float(0.0)
        has_impacts = bool(False)
        contact_count = int(0)
        for i in range(body_start, body_end):
            body = body_at(i, worlds)
            contact_count += rows.owned_end[body] - rows.owned_start[body]
        if contact_count > 0:
            for i in range(body_start, body_end):
                find_rows(
                    world,
                    body_at(i, worlds),
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
                weigh_blocks(body_start, body_end, body_q, model, joints, worlds, work, rows, tree)
            for i in range(body_start, body_end):
                body = body_at(i, worlds)
                depth = penalise_rows(
                    world, body, scale, shapes, contacts, worlds, work, rows, tree, history
                )
                deepest = wp.max(deepest, depth)
            if wp.static(effects.restitution):
                has_impacts = find_impacts(
                    world,
                    written_side(world, history),
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
        return deepest, has_impacts

    @wp.func
    def begin_joints(
        world: int,
        scale: WorldScale,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> bool:
        """Misfit and coordinates of joints, where bodies start; whether a joint is open."""
        body_start = worlds.body_start[world]
        body_end = worlds.body_start[world + 1]
        is_open = measure_blocks(
            body_start,
            body_end,
            scale,
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
        )
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                if measure_loop(
                    i, scale, body_q, body_qd, model, joints, control, work, tree, loops, history
                ):
                    is_open = True
        if place_blocks(
            body_start,
            body_end,
            scale,
            body_q,
            model,
            joints,
            worlds,
            work,
            tree,
            history,
        ):
            is_open = True
        if wp.static(effects.loops and effects.kinds.distances):
            first = loops.world_start[world]
            end = loops.world_start[world + 1]
            closing = float(0.0)
            for i in range(first, end):
                closing = wp.max(closing, loops.closing[i])
            for i in range(first, end):
                reach_farther(i, closing, joints, loops)
        if wp.static(effects.cables):
            for i in range(tree.cables.world_start[world], tree.cables.world_start[world + 1]):
                if begin_cluster(i, work, tree):
                    is_open = True
        return is_open

    @wp.func
    def begin_sweeps(
        world: int,
        iterations: int,
        scale: WorldScale,
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
    ) -> int:
        """Sums and factors the blocks; returns how many sweeps the world takes at most.

        A body that nothing touches is at its target at once.
        """
        sweeps = int(0)
        for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
            body = body_at(i, worlds)
            if work.inv_mass[body] > 0.0:
                if begin_body(
                    i,
                    scale.step,
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
            sweeps = sweeps_at_age(history.age[world], sweeps, scale)
        return sweeps

    @wp.func
    def stiffen_impacts(
        world: int, scale: WorldScale, worlds: wp.ref[WorldWork], rows: wp.ref[RowWork]
    ):
        """Makes contacts as stiff as the forces that sweeps have found ask for."""
        for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
            stiffen_rows(body_at(i, worlds), scale, rows)

    @wp.func
    def sweep_to_rest(
        world: int,
        sweeps: int,
        recovery: float,
        scale: WorldScale,
        body_q: wp.array[wp.transform],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ):
        """At most so many sweeps, fewer where one moves nothing by more than is asked for.

        With a ``recovery`` above zero what was wrong at the start of the step goes, too, and
        multipliers stay. Returns how many it took, and the square of the last update [m^2].
        """
        enough = last_update(scale)
        most = int(sweeps)
        update = float(0.0)
        sweep = int(0)
        while sweep < most:
            update = sweep_world(
                world,
                sweep > 0 and recovery == 0.0,
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
            sweep += 1
            if wp.static(not effects.ramp):
                if update <= enough * enough:
                    most = sweep
        return most, update

    @wp.func
    def keep_forces(
        world: int,
        sweeps: int,
        update: float,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        islands: wp.ref[IslandWork],
        history: wp.ref[History],
    ) -> bool:
        """What rows and loops push with is kept for the next step; islands keep their momentum.

        Takes the sweeps of the motion and the square of their last update [m^2]. Returns whether
        there are islands that push nothing fixed.
        """
        if wp.static(effects.second_order):
            enough = last_update(scale)
            if update > enough * enough:
                # what does not settle tells nothing of the next step
                history.smooth[world] = 0
            if wp.static(effects.cables):
                for i in range(tree.cables.world_start[world], tree.cables.world_start[world + 1]):
                    # tensions of steps of different order do not compare
                    if scale.step == scale.h and has_jerked(i, scale, tree.cables):
                        history.smooth[world] = 0
            if wp.static(effects.loops):
                for i in range(loops.world_start[world], loops.world_start[world + 1]):
                    remember_loop(i, scale, joints, loops, history)
        worlds.sweeps[world] = sweeps
        worlds.update[world] = length_of(update)
        worlds.settled[world] = settled_update(scale)
        has_islands = bool(False)
        if wp.static(effects.contact):
            side = written_side(world, history)
            if wp.static(effects.piles):
                spend_impacts(world, scale, body_qd, model, worlds, work, rows)
            for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
                remember_rows(
                    body_at(i, worlds), side, scale, body_qd, worlds, work, rows, islands, history
                )
            if wp.static(effects.loops and effects.pairs):
                for i in range(loops.world_start[world], loops.world_start[world + 1]):
                    joint = loops.joints[i]
                    child = joints.child[joint]
                    parent = parent_slot(joints, joint, scale.static_slot)
                    if work.inv_mass[child] > 0.0:
                        join_islands(islands, worlds, work, child, parent)
                    elif work.inv_mass[parent] > 0.0:
                        join_islands(islands, worlds, work, parent, child)
            if wp.static(effects.cables and effects.pairs):
                for i in range(tree.cables.world_start[world], tree.cables.world_start[world + 1]):
                    join_cluster(i, worlds, work, tree, islands)
            if wp.static(effects.tendons and effects.pairs):
                for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
                    join_tendons(i, islands, worlds, work, tree)
            if wp.static(effects.pairs and not effects.ramp):
                if sweeps > 0:
                    has_islands = keep_momentum(world, scale.step, model, worlds, work, islands)
        return has_islands

    @wp.func(inline=effects.inline)
    def break_joints(
        world: int,
        h: float,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ):
        """Breaks joints that carry more than they may."""
        break_blocks(
            worlds.body_start[world],
            worlds.body_start[world + 1],
            h,
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
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                break_loop(i, joints, loops, history)

    @wp.func
    def end_armatures(
        world: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        joints: wp.ref[JointModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """How fast the coordinates of joints have changed, which armature goes on with."""
        for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
            body = body_at(i, worlds)
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

    @wp.func
    def end_velocities(
        world: int,
        has_impacts: bool,
        has_islands: bool,
        scale: WorldScale,
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        islands: wp.ref[IslandWork],
        history: wp.ref[History],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Velocities, from the increments themselves; bodies that bounce leave their impacts."""
        body_start = worlds.body_start[world]
        body_end = worlds.body_start[world + 1]
        for i in range(body_start, body_end):
            body = body_at(i, worlds)
            velocity = body_qd[body]
            if work.inv_mass[body] > 0.0:
                velocity = end_velocity(
                    i,
                    scale,
                    body_q,
                    body_qd,
                    model,
                    worlds,
                    work,
                    rows,
                    tree,
                    loops,
                    islands,
                    has_islands,
                    history,
                )
                if wp.static(effects.second_order):
                    # until the step is done, that of its start
                    history.last[body].velocity = body_qd[body]
            body_qd_out[body] = velocity
        if wp.static(effects.second_order):
            remember_motions(
                world,
                scale,
                model,
                joints,
                worlds,
                work,
                rows,
                tree,
                history,
                body_qd_out,
            )
        if wp.static(effects.second_order and effects.tendons):
            for i in range(body_start, body_end):
                end_tendons(i, scale, tree)
        if wp.static(effects.spinning):
            align_spins(body_start, body_end, model, joints, worlds, work, tree, loops, body_qd_out)
        if wp.static(effects.restitution):
            if has_impacts:
                for i in range(body_start, body_end):
                    release_impacts(body_at(i, worlds), worlds, rows, tree, loops)
                for i in range(body_start, body_end):
                    leave_impacts(body_at(i, worlds), scale, work, rows, history)
        if wp.static(effects.axis_rates):
            end_armatures(
                world, scale, body_qd, joints, worlds, work, tree, loops, history, body_qd_out
            )

    @wp.func
    def begin_recovery(
        world: int,
        sweeps: int,
        update: float,
        deepest: float,
        is_open: bool,
        scale: WorldScale,
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> int:
        """How many sweeps take out what was wrong before; what closes loops in them is no force."""
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                loops.kept_force[i] = history.loop_force[i]
                loops.kept_torque[i] = history.loop_torque[i]
        return count_passes(sweeps, update, deepest, is_open, scale)

    @wp.func
    def end_recovery(
        world: int,
        iterations: int,
        update: float,
        has_impacts: bool,
        scale: WorldScale,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ):
        """Closes the joints of a world that did not settle, and goes back to the impacts.

        Takes the square of the last update of all sweeps [m^2].
        """
        if wp.static(effects.joints):
            allowed = open_update(scale)
            if update > allowed * allowed:
                # after impacts that no iteration settles joints are closed all the same
                for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
                    body = body_at(i, worlds)
                    if work.inv_mass[body] > 0.0 and is_linked(joints, tree, body):
                        put_together(body, scale.static_slot, model, joints, work, tree)
        if wp.static(effects.hard_limits):
            if worlds.sweeps[world] >= iterations:
                stop_coordinates(
                    worlds.body_start[world],
                    worlds.body_start[world + 1],
                    scale.static_slot,
                    model,
                    joints,
                    worlds,
                    work,
                    tree,
                )
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                history.loop_force[i] = loops.kept_force[i]
                history.loop_torque[i] = loops.kept_torque[i]
                count_loop_turns(i, joints, work, loops, history)
        if wp.static(effects.cables):
            for i in range(tree.cables.world_start[world], tree.cables.world_start[world + 1]):
                give_back(i, work, tree)
        if wp.static(effects.restitution):
            if has_impacts:
                for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
                    restore_impacts(body_at(i, worlds), scale.h, work, rows)

    @wp.func
    def end_poses(
        world: int,
        has_islands: bool,
        has_not_settled: bool,
        scale: WorldScale,
        body_q: wp.array[wp.transform],
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
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Poses by the increments; islands get back the momentum that turns and recovery took.

        What did not settle has no more energy than it may have.
        """
        body_start = worlds.body_start[world]
        body_end = worlds.body_start[world + 1]
        for i in range(body_start, body_end):
            body = body_at(i, worlds)
            pose = body_q[body]
            if work.inv_mass[body] > 0.0:
                pose = end_pose(
                    i,
                    scale.h,
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
        if wp.static(effects.gyroscopic and effects.pairs and not effects.drag):
            if has_islands:
                is_led = bool(False)
                if wp.static(effects.second_order):
                    if scale.step < scale.h:
                        is_led = True
                        lead_spin(world, scale, body_q, model, worlds, work, islands, history)
                keep_spin(
                    world,
                    scale.step,
                    is_led,
                    body_q_out,
                    model,
                    worlds,
                    work,
                    islands,
                    body_qd_out,
                )
        if wp.static(effects.balanced):
            if has_not_settled:
                bound_world(
                    world,
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
                    body_q_out,
                    body_qd_out,
                )
        if wp.static(effects.second_order):
            remember_states(
                world, scale, body_q, model, worlds, work, history, body_q_out, body_qd_out
            )

    return Phases(
        begin_world,
        build_rows,
        second_order.begin_step,
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
    )
