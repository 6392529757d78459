# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds after the sweeps of the motion: the forces that they keep, and velocities."""

import warp as wp

from ..data import Solver, Step
from ..effects import Effects
from ..step.anchors import is_linked
from ..step.bodies import vector_sum
from ..step.islands import HELD
from ..step.kernels import KernelDecorator
from ..step.loops import other_end, ties
from ..step.smoothness import is_quiet
from .colored_joints import loop_world
from .joining import join_at_once
from .stages import Stages


def make_colored_motion(effects: Effects, stages: Stages, kernel: KernelDecorator) -> None:
    """The kernels, made by the decorator ``kernel``."""
    remember_rows = stages.remember_rows
    join_cluster, join_closures = stages.join_cluster, stages.join_closures
    break_blocks, break_loop = stages.breaking.break_blocks, stages.breaking.break_loop
    end_velocity, end_armature = stages.end.end_velocity, stages.end.end_armature
    slips_otherwise = stages.second_order.slips_otherwise
    may_body_gain = stages.energy.may_body_gain
    release_impacts, align_block = stages.impacts.release_impacts, stages.trees.align_spins

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
                    join_at_once(body, s[0].tree.parent[body], HELD, s[0])
                if wp.static(effects.loops):
                    for k in range(s[0].loops.body_start[body], s[0].loops.body_start[body + 1]):
                        if ties(s[0].loops.items[k] / 2, s[0]):
                            other = other_end(s[0].loops.items[k], s[0])
                            slot = wp.where(other < 0, scale.static_slot, other)
                            join_at_once(body, slot, HELD, s[0])
                if wp.static(effects.tendons or effects.mimics):
                    if s[0].colors.block[body] == body:
                        join_closures(s[0].worlds.rank[body], s[0])
        if not wp.isfinite(vector_sum(s[0].work.increment[body])):
            s[0].colors.is_finite[world] = 0

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
            s[0].history.gained[body] = wp.vec3(0.0)
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
            if wp.static(effects.balanced and effects.gaining):
                if may_body_gain(body, s[0]):
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
