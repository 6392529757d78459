# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The device functions of :mod:`newton_avbd.step`, put together once for each driver."""

from dataclasses import dataclass

import warp as wp

from ..effects import Effects
from ..functions import Functions
from ..step.beginning import make_begin_body, make_coasting
from ..step.block_start import make_block_start
from ..step.breaking import make_break_joints
from ..step.cables import make_join, make_solve_cluster
from ..step.closures import make_closures, make_join_closures
from ..step.ending import make_end, make_remember
from ..step.energy import make_energy
from ..step.gathering import make_assemble, make_contact_law, make_gather
from ..step.impacts import make_impacts
from ..step.kernels import ABSENT, absent
from ..step.loops import make_loops
from ..step.piles import PileFunctions, make_piles
from ..step.second_order import make_second_order
from ..step.sweeps import make_sweep, make_sweep_block
from ..step.trees import make_trees


@dataclass(frozen=True)
class Stages:
    """Device functions of the stages of a step; absent those of effects that a scene has not."""

    second_order: Functions
    impacts: Functions
    loops: Functions
    closures: Functions
    trees: Functions
    piles: PileFunctions
    solve_cluster: wp.Function
    """Finds the tensions of a cluster of cables."""
    block_start: Functions
    begin_body: wp.Function
    """Sums the block of a body, or puts the body to its target."""
    sweep_block: wp.Function
    """Moves a block to the minimum of its quadratic model."""
    remember_rows: wp.Function
    """Keeps what the rows that a body owns push with."""
    join_cluster: wp.Function
    """Makes one island of bodies that cables pull."""
    join_closures: wp.Function
    """Makes one island of bodies that tendons pull, or mimics tie."""
    breaking: Functions
    end: Functions
    energy: Functions


def make_stages(effects: Effects, join: wp.Function) -> Stages:
    """Makes the device functions, and all that they call.

    Args:
        effects: What the kernel is compiled with.
        join: Device function that makes one island of two: ``join_islands`` where one thread has
            the world, ``join_at_once`` where many have.
    """
    law = make_contact_law(effects)
    loops = make_loops(effects) if effects.loops else ABSENT
    gather = make_gather(effects, law, loops.loop_wrench)
    closures = make_closures(effects) if effects.closures else ABSENT
    trees = ABSENT
    if effects.joints:
        trees = make_trees(
            effects,
            law,
            make_gather(effects, law, loops.loop_wrench, follows=True),
            closures.begin_rows,
            closures.keep_forces,
            closures.settle_tendons,
        )
    block_start = make_block_start(
        effects, trees, loops.begin_loop, closures.begin_closures, closures.begin_tendons
    )
    breaking = ABSENT
    if effects.breaking:
        breaking = make_break_joints(effects, gather)
    piles = ABSENT
    if effects.piles:
        outer_block = make_assemble(effects, loops.loop_curvature, outer=True)
        piles = make_piles(effects, gather, outer_block, make_coasting(effects))
    return Stages(
        second_order=make_second_order(effects) if effects.second_order else ABSENT,
        impacts=make_impacts(effects) if effects.restitution else ABSENT,
        loops=loops,
        closures=closures,
        trees=trees,
        piles=piles,
        solve_cluster=make_solve_cluster(effects) if effects.cables else absent,
        block_start=block_start,
        begin_body=make_begin_body(effects, make_assemble(effects, loops.loop_curvature)),
        sweep_block=make_sweep_block(effects, make_sweep(effects, gather), trees.sweep_tree),
        remember_rows=make_remember(effects, law.force, law.gap, join),
        join_cluster=make_join(join) if effects.cables else absent,
        join_closures=make_join_closures(effects, join),
        breaking=breaking,
        end=make_end(effects, trees.count_turns),
        energy=make_energy(effects, join) if effects.balanced else ABSENT,
    )
