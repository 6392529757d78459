# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The recovery of a world, in which old errors go without entering velocities, and its poses."""

import warp as wp

from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..step.anchors import is_linked
from ..step.bodies import body_at
from ..step.cables import give_back
from ..step.islands import center_islands, keep_spin
from ..step.scale import make_count_passes, open_update
from ..step.second_order import lead_spin
from ..step.trapezoid import goes_too_far
from .stages import Stages


def make_world_recovery(effects: Effects, stages: Stages) -> Functions:
    """Device functions before and after the sweeps of the recovery."""
    count_passes = make_count_passes(effects)
    put_together = stages.trees.put_together
    stop_coordinates = stages.trees.stop_coordinates
    move_by_trapezoid = stages.trees.move_by_trapezoid
    keep_loop, give_back_forces = stages.loops.keep_motion, stages.loops.give_back_forces
    restore_impacts, end_pose = stages.impacts.restore_impacts, stages.end.end_pose
    bound_world = stages.energy.bound_world
    remember_states = stages.second_order.remember_states

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
                keep_loop(i, s)
        return count_passes(sweeps, update, deepest, is_open, scale)

    @wp.func
    def end_recovery(
        world: int,
        update: float,
        has_impacts: bool,
        has_islands: bool,
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
        if wp.static(effects.centered):
            if has_islands and s.worlds.sweeps[world] >= step.iterations:
                center_islands(world, s)
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                give_back_forces(i, s)
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                give_back(i, s)
        if wp.static(effects.restitution):
            if has_impacts:
                for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                    restore_impacts(body_at(i, s.worlds), scale.h, s)
        if wp.static(effects.trapezoidal):
            if goes_too_far(world, scale, s):
                first = s.worlds.body_start[world]
                while first < s.worlds.body_start[world + 1]:
                    end = s.worlds.block_end[first]
                    move_by_trapezoid(first, end, scale, step, s)
                    first = end

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
        group = s.worlds.of_body[body_at(body_start, s.worlds)]
        held = s.worlds.held[group]
        for i in range(body_start, body_end):
            body = body_at(i, s.worlds)
            pose = s.work.pose[body]
            if s.work.inv_mass[body] > 0.0:
                pose = end_pose(i, scale.h, s)
            step.body_q_out[body] = pose
        # one step, however many of its bodies
        s.worlds.held[group] = wp.min(s.worlds.held[group], held + 1)
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

    return together(begin_recovery, end_recovery, end_poses)
