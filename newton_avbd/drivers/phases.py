# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The phases of a world's step, in the order in which ``world.solve_world`` runs them."""

from typing import NamedTuple

import warp as wp

from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..rows import contact as contact_rows
from ..step.anchors import is_linked, parent_slot
from ..step.beginning import make_begin, make_coasting
from ..step.bodies import body_at
from ..step.breaking import make_break_joints
from ..step.cables import make_cables, make_join
from ..step.closures import make_closures
from ..step.contacts import make_rows, stiffen_rows
from ..step.distances import reach_farther
from ..step.ending import make_end, make_remember
from ..step.energy import make_energy
from ..step.gathering import make_assemble, make_gather
from ..step.impacts import leave_impacts, make_impacts
from ..step.islands import join_islands, keep_momentum, keep_spin
from ..step.kernels import ABSENT, absent
from ..step.loops import make_loops, ties
from ..step.motion_history import remember_loop
from ..step.piles import make_piles
from ..step.scale import (
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
from ..step.second_order import lead_spin, make_second_order
from ..step.sides import make_written_side
from ..step.sweeps import make_sweep, make_sweep_block, make_sweep_world
from ..step.tendons import make_join_tendons
from ..step.trees import make_trees
from ..step.weights import make_weigh


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
    remember_motions = second_order.remember_motions
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
    def begin_world(world: int, h: float, tolerance: float, s: wp.ref[Solver]) -> WorldScale:
        """How far things may go in the step; takes a much longer step than the last as a start."""
        scale = measure_world(world, h, tolerance, s)
        # forces that stopped something within a short step would push too long in a longer one
        if h > wp.static(MUCH_LONGER if effects.adaptive else LONGER) * s.history.step[world]:
            s.history.age[world] = 0
        if wp.static(effects.second_order):
            if s.worlds.step[world] < s.history.step[world]:
                scale.lag = 0.0
        s.history.step[world] = h
        return scale

    @wp.func
    def build_rows(
        world: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Rows of the contacts: linearised at state_in, warm-started from the last step, penalised.

        Returns the deepest penetration [m], and whether impacts bounce.
        """
        body_start = s.worlds.body_start[world]
        body_end = s.worlds.body_start[world + 1]
        deepest = float(0.0)
        has_impacts = bool(False)
        contact_count = int(0)
        for i in range(body_start, body_end):
            body = body_at(i, s.worlds)
            contact_count += s.rows.owned_end[body] - s.rows.owned_start[body]
        if contact_count > 0:
            for i in range(body_start, body_end):
                find_rows(world, body_at(i, s.worlds), scale, step, s)
        if wp.static(effects.piles):
            link_piles(world, scale.slop, s)
        if contact_count > 0:
            if wp.static(effects.light_links):
                weigh_blocks(body_start, body_end, s)
            for i in range(body_start, body_end):
                body = body_at(i, s.worlds)
                depth = penalise_rows(world, body, scale, step, s)
                deepest = wp.max(deepest, depth)
            if wp.static(effects.restitution):
                has_impacts = find_impacts(world, written_side(world, s.history), scale, body_qd, s)
        s.history.filling[world, 0] = 0
        if wp.static(effects.matching):
            s.history.filling[world, 0] = step.contacts.buffer
            s.history.filling[world, 1] = step.contacts.generation[0]
        return deepest, has_impacts

    @wp.func
    def begin_joints(
        world: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> bool:
        """Misfit and coordinates of joints, where bodies start; whether a joint is open."""
        body_start = s.worlds.body_start[world]
        body_end = s.worlds.body_start[world + 1]
        is_open = measure_blocks(body_start, body_end, scale, body_qd, step, s)
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                if measure_loop(i, scale, body_qd, step, s):
                    is_open = True
        if place_blocks(body_start, body_end, scale, s):
            is_open = True
        if wp.static(effects.loops and effects.kinds.distances):
            first = s.loops.world_start[world]
            end = s.loops.world_start[world + 1]
            closing = float(0.0)
            for i in range(first, end):
                closing = wp.max(closing, s.loops.closing[i])
            for i in range(first, end):
                reach_farther(i, closing, s)
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                if begin_cluster(i, s):
                    is_open = True
        return is_open

    @wp.func
    def begin_sweeps(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]) -> int:
        """Sums and factors the blocks; returns how many sweeps the world takes at most.

        A body that nothing touches is at its target at once.
        """
        sweeps = int(0)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                if begin_body(i, scale.step, step, s):
                    sweeps = step.iterations
                if wp.static(effects.joints and effects.islands):
                    if is_linked(body, s):
                        join_islands(body, s.tree.parent[body], s)
        if wp.static(effects.piles):
            factor_piles(world, s)
        if wp.static(not effects.ramp):
            sweeps = sweeps_at_age(s.history.age[world], sweeps, scale)
        return sweeps

    @wp.func
    def stiffen_impacts(world: int, scale: WorldScale, s: wp.ref[Solver]):
        """Makes contacts as stiff as the forces that sweeps have found ask for."""
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            stiffen_rows(body_at(i, s.worlds), scale, s.rows)

    @wp.func
    def sweep_to_rest(
        world: int,
        sweeps: int,
        recovery: float,
        scale: WorldScale,
        step: wp.ref[Step],
        s: wp.ref[Solver],
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
                world, sweep > 0 and recovery == 0.0, recovery, scale.slop, scale.step, step, s
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
        s: wp.ref[Solver],
    ) -> bool:
        """What rows and loops push with is kept for the next step; islands keep their momentum.

        Takes the sweeps of the motion and the square of their last update [m^2]. Returns whether
        there are islands that push nothing fixed.
        """
        if wp.static(effects.second_order):
            enough = last_update(scale)
            if update > enough * enough:
                # what does not settle tells nothing of the next step
                s.history.smooth[world] = 0
            if wp.static(effects.cables):
                for i in range(
                    s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]
                ):
                    # tensions of steps of different order do not compare
                    if scale.step == scale.h and has_jerked(i, scale, s.tree.cables):
                        s.history.smooth[world] = 0
            if wp.static(effects.loops):
                for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                    remember_loop(i, scale, s)
        s.worlds.sweeps[world] = sweeps
        s.worlds.update[world] = length_of(update)
        s.worlds.settled[world] = settled_update(scale)
        has_islands = bool(False)
        if wp.static(effects.contact):
            side = written_side(world, s.history)
            if wp.static(effects.piles):
                spend_impacts(world, scale, body_qd, s)
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                remember_rows(body_at(i, s.worlds), side, scale, body_qd, s)
        if wp.static(effects.loops and effects.islands):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                if not ties(i, s):
                    continue
                joint = s.loops.joints[i]
                child = s.joints.child[joint]
                parent = parent_slot(s.joints, joint, scale.static_slot)
                if s.work.inv_mass[child] > 0.0:
                    join_islands(child, parent, s)
                elif s.work.inv_mass[parent] > 0.0:
                    join_islands(parent, child, s)
        if wp.static(effects.cables and effects.islands):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                join_cluster(i, s)
        if wp.static(effects.tendons and effects.islands):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                join_tendons(i, s)
        if wp.static(effects.islands and not effects.ramp):
            if sweeps > 0:
                has_islands = keep_momentum(world, scale.step, wp.static(effects.pairs), s)
        return has_islands

    @wp.func(inline=effects.inline)
    def break_joints(world: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """Breaks joints that carry more than they may."""
        break_blocks(s.worlds.body_start[world], s.worlds.body_start[world + 1], h, step, s)
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                break_loop(i, s)

    @wp.func
    def end_armatures(
        world: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """How fast the coordinates of joints have changed, which armature goes on with."""
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0 and s.tree.joint[body] >= 0:
                end_armature(
                    s.tree.joint[body],
                    s.tree.axis_start[body],
                    s.tree.coordinate,
                    s.tree.start_coordinate,
                    scale,
                    body_qd,
                    step,
                    s,
                )
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                joint = s.loops.joints[i]
                end_armature(
                    joint,
                    s.joints.dof_start[joint],
                    s.loops.coordinate,
                    s.loops.start_coordinate,
                    scale,
                    body_qd,
                    step,
                    s,
                )

    @wp.func
    def end_velocities(
        world: int,
        has_impacts: bool,
        has_islands: bool,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Velocities, from the increments themselves; bodies that bounce leave their impacts."""
        body_start = s.worlds.body_start[world]
        body_end = s.worlds.body_start[world + 1]
        for i in range(body_start, body_end):
            body = body_at(i, s.worlds)
            velocity = body_qd[body]
            if s.work.inv_mass[body] > 0.0:
                velocity = end_velocity(i, scale, body_qd, has_islands, s)
                if wp.static(effects.second_order):
                    # until the step is done, that of its start
                    s.history.last[body].velocity = body_qd[body]
            step.body_qd_out[body] = velocity
        if wp.static(effects.second_order):
            remember_motions(world, scale, step, s)
        if wp.static(effects.second_order and effects.tendons):
            for i in range(body_start, body_end):
                end_tendons(i, scale, s.tree)
        if wp.static(effects.spinning):
            align_spins(body_start, body_end, step, s)
        if wp.static(effects.restitution):
            if has_impacts:
                for i in range(body_start, body_end):
                    release_impacts(body_at(i, s.worlds), s)
                for i in range(body_start, body_end):
                    leave_impacts(body_at(i, s.worlds), scale, s)
        if wp.static(effects.axis_rates):
            end_armatures(world, scale, body_qd, step, s)

    @wp.func
    def begin_recovery(
        world: int,
        sweeps: int,
        update: float,
        deepest: float,
        is_open: bool,
        scale: WorldScale,
        s: wp.ref[Solver],
    ) -> int:
        """How many sweeps take out what was wrong before; what closes loops in them is no force."""
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                s.loops.kept_force[i] = s.history.loop_force[i]
                s.loops.kept_torque[i] = s.history.loop_torque[i]
        return count_passes(sweeps, update, deepest, is_open, scale)

    @wp.func
    def end_recovery(
        world: int,
        update: float,
        has_impacts: bool,
        scale: WorldScale,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Closes the joints of a world that did not settle, and goes back to the impacts.

        Takes the square of the last update of all sweeps [m^2].
        """
        if wp.static(effects.joints):
            allowed = open_update(scale)
            if update > allowed * allowed:
                # after impacts that no iteration settles joints are closed all the same
                for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                    body = body_at(i, s.worlds)
                    if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                        put_together(body, scale.static_slot, s)
        if wp.static(effects.hard_limits):
            if s.worlds.sweeps[world] >= step.iterations:
                stop_coordinates(
                    s.worlds.body_start[world], s.worlds.body_start[world + 1], scale.static_slot, s
                )
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                s.history.loop_force[i] = s.loops.kept_force[i]
                s.history.loop_torque[i] = s.loops.kept_torque[i]
                count_loop_turns(i, s)
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                give_back(i, s)
        if wp.static(effects.restitution):
            if has_impacts:
                for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                    restore_impacts(body_at(i, s.worlds), scale.h, s)

    @wp.func
    def end_poses(
        world: int,
        has_islands: bool,
        has_not_settled: bool,
        scale: WorldScale,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Poses by the increments; islands get back the momentum that turns and recovery took.

        What did not settle has no more energy than it may have.
        """
        body_start = s.worlds.body_start[world]
        body_end = s.worlds.body_start[world + 1]
        for i in range(body_start, body_end):
            body = body_at(i, s.worlds)
            pose = s.work.pose[body]
            if s.work.inv_mass[body] > 0.0:
                pose = end_pose(i, scale.h, s)
            step.body_q_out[body] = pose
        if wp.static(effects.turning_islands):
            if has_islands:
                is_led = bool(False)
                if wp.static(effects.second_order):
                    if scale.step < scale.h:
                        is_led = True
                        lead_spin(world, scale, s)
                keep_spin(world, scale.step, is_led, step, s)
        if wp.static(effects.balanced):
            if has_not_settled:
                bound_world(world, scale, step, s)
        if wp.static(effects.second_order):
            remember_states(world, scale, step, s)

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
