# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A world after the sweeps of its motion: the forces that it keeps, and velocities."""

import warp as wp

from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..step.anchors import parent_slot
from ..step.bodies import body_at
from ..step.cables import has_jerked
from ..step.impacts import leave_impacts
from ..step.islands import FREE, HELD, TOUCHING, join_islands, keep_momentum
from ..step.loops import ties
from ..step.motion_history import remember_loop
from ..step.scale import last_update, length_of, settled_update
from ..step.sides import make_written_side
from ..step.tendons import end_tendons
from .stages import Stages


def make_world_motion(effects: Effects, stages: Stages) -> Functions:
    """Device functions that read forces and velocities off what the sweeps have found."""
    written_side = make_written_side(effects)
    remember_motions = stages.second_order.remember_motions
    spend_impacts = stages.piles.spend_impacts
    remember_rows = stages.remember_rows
    join_cluster, join_closures = stages.join_cluster, stages.join_closures
    break_blocks, break_loop = stages.breaking.break_blocks, stages.breaking.break_loop
    end_velocity, end_armature = stages.end.end_velocity, stages.end.end_armature
    align_spins = stages.trees.align_spins
    release_impacts = stages.impacts.release_impacts

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
        islands have been given their momentum.
        """
        enough = last_update(scale)
        if wp.static(effects.second_order):
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
                    join_islands(child, parent, HELD, s)
                elif s.work.inv_mass[parent] > 0.0:
                    join_islands(parent, child, HELD, s)
        if wp.static(effects.cables and effects.islands):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                join_cluster(i, s)
        if wp.static((effects.tendons or effects.mimics) and effects.islands):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                join_closures(i, s)
        if wp.static(effects.islands and not effects.ramp):
            if sweeps > 0:
                most_fixed = wp.where(update > enough * enough, TOUCHING, FREE)
                has_islands = keep_momentum(
                    world, scale.step, most_fixed, wp.static(effects.pairs), s
                )
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

    return together(keep_forces, break_joints, end_velocities)
