# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds: joints and cables at the start of the step."""

import warp as wp

from ..data import Solver, Step
from ..effects import Effects
from ..step.cables import begin_cluster
from ..step.distances import reach_farther
from ..step.kernels import KernelDecorator
from .stages import Stages


@wp.func
def loop_world(i: int, s: wp.ref[Solver]) -> int:
    """World of a joint outside of the trees: that of its body that moves."""
    joint = s.loops.joints[i]
    child = s.joints.child[joint]
    if s.work.inv_mass[child] > 0.0 or s.joints.parent[joint] < 0:
        return s.worlds.of_body[child]
    return s.worlds.of_body[s.joints.parent[joint]]


def make_colored_joints(effects: Effects, stages: Stages, kernel: KernelDecorator) -> None:
    """The kernels, made by the decorator ``kernel``."""
    block_start = stages.block_start
    measure_blocks, measure_loop = block_start.measure_blocks, block_start.measure_loop
    place_blocks = block_start.place_blocks

    @kernel(effects.joints)
    def measure_joints(step: Step, s: wp.array[Solver]):
        """Measures the joints of a block's tree; one thread a body, for a first one."""
        block = wp.tid()
        world = s[0].worlds.of_body[block]
        if s[0].colors.block[block] == block and s[0].colors.is_finite[world] == 1:
            first = s[0].worlds.rank[block]
            if measure_blocks(
                first,
                s[0].worlds.block_end[first],
                s[0].colors.scale[world],
                step.body_qd,
                step,
                s[0],
            ):
                s[0].colors.is_open[world] = 1

    @kernel(effects.loops)
    def measure_loops(step: Step, s: wp.array[Solver]):
        """Measures a joint outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        if s[0].colors.is_finite[world] == 1:
            scale = s[0].colors.scale[world]
            if measure_loop(i, scale, step.body_qd, step, s[0]):
                s[0].colors.is_open[world] = 1
            wp.atomic_max(s[0].colors.closing, world, s[0].loops.closing[i])

    @kernel(effects.loops and effects.kinds.distances)
    def widen_loops(s: wp.array[Solver]):
        """How far the recovery of other joints may pull a DISTANCE joint; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        reach_farther(i, s[0].colors.closing[world], s[0])

    @kernel(effects.joints)
    def place_joints(s: wp.array[Solver]):
        """Puts a block to the guess of its increments; one thread a body, for a first one."""
        block = wp.tid()
        world = s[0].worlds.of_body[block]
        if s[0].colors.block[block] == block and s[0].colors.is_finite[world] == 1:
            first = s[0].worlds.rank[block]
            if place_blocks(first, s[0].worlds.block_end[first], s[0].colors.scale[world], s[0]):
                s[0].colors.is_open[world] = 1

    @kernel(effects.cables)
    def begin_clusters(s: wp.array[Solver]):
        """Pulls with the tensions of the last step; one thread a cluster of cables."""
        cluster = wp.tid()
        world = s[0].tree.cables.world[cluster]
        if s[0].colors.is_finite[world] == 1:
            if begin_cluster(cluster, s[0]):
                s[0].colors.is_open[world] = 1
