# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds: sweeps, color by color."""

import warp as wp

from ..data import ColorWork, Solver, Step, WorldScale
from ..effects import Effects
from ..step.contacts import stiffen_rows
from ..step.kernels import KernelDecorator
from ..step.scale import is_struck, last_update, stiffens
from .colored_joints import loop_world
from .stages import Stages


@wp.func
def is_settled(moved: float, scale: WorldScale) -> bool:
    """Whether a sweep that moved a body by no more than the root of ``moved`` [m^2] is the last."""
    enough = last_update(scale)
    return moved <= enough * enough


@wp.func
def goes_on(
    sweep: int,
    world: int,
    moved: wp.array2d[float],
    most: wp.array[wp.int32],
    colors: wp.ref[ColorWork],
) -> bool:
    """Whether a world takes this sweep."""
    if sweep >= most[world]:
        return False
    return not is_settled(moved[sweep, world], colors.scale[world])


@wp.func
def count_sweeps(world: int, moved: wp.array2d[float]) -> int:
    """How many sweeps moved something, or could have."""
    sweeps = int(0)
    last = moved.shape[0] - 1
    while sweeps < last and moved[wp.min(sweeps + 1, last), world] >= 0.0:
        sweeps += 1
    return sweeps


@wp.func
def last_moved(world: int, moved: wp.array2d[float]) -> float:
    """Square of how far the last sweep of a world has moved a body [m^2]."""
    sweeps = count_sweeps(world, moved)
    return wp.where(sweeps > 0, moved[sweeps, world], 0.0)


def make_colored_sweeps(effects: Effects, stages: Stages, kernel: KernelDecorator) -> None:
    """The kernels, made by the decorator ``kernel``."""
    begin_body, sweep_block = stages.begin_body, stages.sweep_block
    loop_wrench, solve_cluster = stages.loops.loop_wrench, stages.solve_cluster

    @kernel()
    def assemble(begin: int, step: Step, s: wp.array[Solver]):
        """Sums the block of a body, or puts it to its target; one thread a body.

        Those of worlds whose round of sweeps begins with the sweep ``begin``.
        """
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        if s[0].work.inv_mass[body] > 0.0 and s[0].colors.begin[world] == begin:
            begin_body(s[0].worlds.rank[body], s[0].colors.scale[world].step, step, s[0])

    @wp.func
    def sweep_blocks(
        thread: int,
        sweep: int,
        color: int,
        threads: int,
        recovery: float,
        most: wp.array[wp.int32],
        moved: wp.array2d[float],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Moves the blocks of a color that fall to a thread."""
        lanes = s.colors.lane_start.shape[0] - 1
        first = s.colors.start[color * lanes] + thread
        for i in range(first, s.colors.start[(color + 1) * lanes], threads):
            body = s.colors.order[i]
            world = s.worlds.of_body[body]
            if goes_on(sweep, world, moved, most, s.colors):
                scale = s.colors.scale[world]
                far = sweep_block(
                    s.worlds.rank[body],
                    sweep > wp.where(recovery > 0.0, 0, s.colors.begin[world]),
                    recovery,
                    scale.slop,
                    scale.step,
                    step,
                    s,
                )
                # looks first, since few of many threads have to
                if far > moved[sweep + 1, world]:
                    wp.atomic_max(moved, sweep + 1, world, far)

    @kernel()
    def sweep_color(
        sweep: int,
        color: int,
        threads: int,
        recovery: float,
        most: wp.array[wp.int32],
        moved: wp.array2d[float],
        step: Step,
        s: wp.array[Solver],
    ):
        """Moves all blocks of a color once; the last color is for one thread alone.

        With a ``recovery`` above zero what was wrong at the start of the step goes, too.
        """
        sweep_blocks(wp.tid(), sweep, color, threads, recovery, most, moved, step, s[0])

    @kernel(effects.loops)
    def sweep_loops(
        sweep: int,
        recovery: float,
        moved: wp.array2d[float],
        most: wp.array[wp.int32],
        step: Step,
        s: wp.array[Solver],
    ):
        """The dual update of a joint outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        if goes_on(sweep, world, moved, most, s[0].colors):
            h = s[0].colors.scale[world].step
            loop_wrench(i, recovery, h, True, True, step, s[0])

    @kernel(effects.cables)
    def solve_clusters(
        sweep: int,
        recovery: float,
        most: wp.array[wp.int32],
        moved: wp.array2d[float],
        s: wp.array[Solver],
    ):
        """Tensions for the next sweep; one thread a cluster of cables."""
        cluster = wp.tid()
        world = s[0].tree.cables.world[cluster]
        if goes_on(sweep, world, moved, most, s[0].colors):
            changed = solve_cluster(cluster, recovery, s[0])
            wp.atomic_max(moved, sweep + 1, world, changed)

    @kernel()
    def begin_round(
        # In:
        iterations: int,
        begin: int,
        # Work out:
        colors: ColorWork,
    ):
        """Another round of sweeps where impacts go on after the last; one thread a world."""
        world = wp.tid()
        if colors.most[world] == begin:
            if is_struck(begin, colors.moved[begin, world], colors.scale[world]):
                colors.most[world] = begin + iterations
                colors.begin[world] = begin
                colors.has_more[0] = 1

    @kernel(effects.contact and not effects.compliance)
    def stiffen(begin: int, s: wp.array[Solver]):
        """Contacts as stiff as the forces that sweeps have found ask for; one thread a body.

        Those of worlds whose round of sweeps begins with the sweep ``begin``.
        """
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if s[0].colors.begin[world] == begin and stiffens(s[0].colors.moved[begin, world], scale):
            stiffen_rows(body, scale, s[0].rows)
