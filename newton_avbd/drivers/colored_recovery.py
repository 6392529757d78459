# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The recovery of large worlds, in which old errors go without entering velocities, and poses."""

import warp as wp

from ..data import Solver, Step
from ..effects import Effects
from ..step.anchors import is_linked
from ..step.bodies import report_held
from ..step.cables import give_back
from ..step.kernels import KernelDecorator
from ..step.resetting import forget_joints
from ..step.scale import (
    COLD_STEPS,
    is_unsettled,
    length_of,
    make_count_passes,
    open_update,
    settled_update,
)
from ..step.slopes import JUMPED, QUIET_WORLD
from ..step.trapezoid import goes_too_far
from .colored_joints import loop_world
from .colored_sweeps import count_sweeps, is_settled, last_moved
from .stages import Stages


def make_colored_recovery(effects: Effects, stages: Stages, kernel: KernelDecorator) -> None:
    """The kernels, made by the decorator ``kernel``."""
    count_passes, is_astray = make_count_passes(effects), stages.energy.is_astray
    put_together = stages.trees.put_together
    stop_coordinates = stages.trees.stop_coordinates
    move_by_trapezoid = stages.trees.move_by_trapezoid
    keep_loop, give_back_forces = stages.loops.keep_motion, stages.loops.give_back_forces
    restore_impacts, end_pose = stages.impacts.restore_impacts, stages.end.end_pose

    @kernel()
    def end_sweeps(s: wp.array[Solver]):
        """What sweeps left, and how many the recovery takes; one thread a world."""
        world = wp.tid()
        scale = s[0].colors.scale[world]
        sweeps = count_sweeps(world, s[0].colors.moved)
        update = last_moved(world, s[0].colors.moved)
        s[0].worlds.sweeps[world] = sweeps
        s[0].worlds.update[world] = length_of(update)
        s[0].worlds.settled[world] = settled_update(scale)
        # rebounds have moved what joints hold
        is_open = s[0].colors.is_open[world] == 1 or s[0].colors.has_impacts[world] == 1
        passes = count_passes(sweeps, update, s[0].colors.deepest[world], is_open, scale)
        if s[0].colors.is_finite[world] == 0:
            passes = 0
        elif is_unsettled(update, scale):
            s[0].colors.is_excessive[0] = 1
        elif wp.static(effects.joints):
            if is_astray(world, s[0]):
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

    @kernel(effects.loops)
    def keep_loops(s: wp.array[Solver]):
        """What closes loops in the recovery is no force of the motion; one thread a joint."""
        keep_loop(wp.tid(), s[0])

    @kernel(effects.joints)
    def close_joints(step: Step, s: wp.array[Solver]):
        """Closes joints that are still open, and puts coordinates back to limits that they passed;
        one thread a body, for the first of a block."""
        block = wp.tid()
        world = s[0].worlds.of_body[block]
        if s[0].colors.block[block] == block and s[0].colors.is_finite[world] == 1:
            scale = s[0].colors.scale[world]
            first = s[0].worlds.rank[block]
            end = s[0].worlds.block_end[first]
            last = s[0].worlds.update[world] * s[0].worlds.update[world]
            if s[0].colors.passes[world] > 0:
                last = s[0].colors.recovered[count_sweeps(world, s[0].colors.recovered), world]
            allowed = open_update(scale)
            if last > allowed * allowed:
                for i in range(first, end):
                    body = s[0].worlds.bodies[i]
                    if s[0].work.inv_mass[body] > 0.0 and is_linked(body, s[0]):
                        put_together(body, scale.static_slot, s[0])
            if wp.static(effects.hard_limits):
                if s[0].worlds.sweeps[world] >= step.iterations:
                    stop_coordinates(first, end, scale.static_slot, s[0])
            if wp.static(effects.trapezoidal):
                if goes_too_far(world, scale, s[0]):
                    move_by_trapezoid(first, end, scale, step, s[0])

    @kernel(effects.loops)
    def give_loops_back(s: wp.array[Solver]):
        """Ends what :func:`keep_loops` began; one thread a joint."""
        i = wp.tid()
        if s[0].colors.is_finite[loop_world(i, s[0])] == 1:
            give_back_forces(i, s[0])

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
