# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds: the energy of islands that did not settle, summed by many threads.

What one body adds (:mod:`.energy`) is found by a thread a body. A *run* is a sequence of bodies of
one lane that belong to one island; a thread a lane sums over its runs, and a thread a world over
the runs of all lanes, in their order. So sums do not depend on the order of the threads, and an
island of n bodies, which mostly follow each other, takes about the root of n additions one after
the other.
"""

from collections.abc import Callable
from typing import NamedTuple

import warp as wp

from ..data import (
    Balance,
    BodyModel,
    BodyWork,
    ColorWork,
    ControlInput,
    History,
    IslandWork,
    JointModel,
    LoopWork,
    RowWork,
    TreeWork,
    WorldWork,
)
from ..effects import Effects
from .energy import (
    NEARLY,
    EnergyFunctions,
    add_momentum,
    combined,
    combined_momentum,
    squared_move,
)
from .joining import root_of
from .scale import is_unsettled


class ColoredEnergy(NamedTuple):
    """Kernels in the order in which they run."""

    measure_moves: wp.Kernel
    find_unbalanced: wp.Kernel
    begin_balances: wp.Kernel
    join_bodies: wp.Kernel | None
    join_clusters: wp.Kernel | None
    add_all_cables: wp.Kernel | None
    add_bodies: wp.Kernel
    add_runs: wp.Kernel
    add_lanes: wp.Kernel
    add_momenta: wp.Kernel
    settle_islands: wp.Kernel
    slow_bodies: wp.Kernel
    slow_all_rotors: wp.Kernel | None
    drop_all_tensions: wp.Kernel | None


@wp.func
def is_unbalanced(body: int, worlds: wp.ref[WorldWork], colors: wp.ref[ColorWork]) -> bool:
    """Whether the energy of a body's world has to be looked at."""
    return colors.is_unbalanced[worlds.of_body[body]] == 1


@wp.func
def end_of_run(
    first: int,
    end: int,
    root: int,
    worlds: wp.ref[WorldWork],
    work: wp.ref[BodyWork],
    islands: wp.ref[IslandWork],
) -> int:
    """Place after the run that begins at a place; bodies that do not move belong to any."""
    place = int(first)
    while place < end:
        body = worlds.bodies[place]
        if work.inv_mass[body] > 0.0 and islands.parent[body] != root:
            return place
        place += 1
    return place


@wp.func
def next_moving(first: int, end: int, worlds: wp.ref[WorldWork], work: wp.ref[BodyWork]) -> int:
    """First place from this one on whose body moves."""
    place = int(first)
    while place < end and work.inv_mass[worlds.bodies[place]] == 0.0:
        place += 1
    return place


def make_colored_energy(
    effects: Effects,
    energy: EnergyFunctions,
    kernel: Callable[..., Callable[[Callable], wp.Kernel | None]],
) -> ColoredEnergy:
    """Kernels that bound the energy of islands, made by a decorator.

    Args:
        effects: Effects of the scene.
        energy: What they call; islands are joined by many threads at once.
        kernel: The decorator.
    """
    is_body_led, is_flat = energy.is_body_led, energy.is_flat
    begin_balance = energy.begin_balance
    join_joints, join_tendons = energy.join_joints, energy.join_tendons
    join_cluster = energy.join_cluster
    add_cables, drop_tensions = energy.add_cables, energy.drop_tensions
    add_body, add_tendons = energy.add_body, energy.add_tendons
    settle_island, slow_body = energy.settle_island, energy.slow_body
    slow_rotors = energy.slow_rotors

    @kernel()
    def measure_moves(
        # Model:
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        # Work out:
        colors: ColorWork,
    ):
        """The farthest move of a lane, negative where a gimbal leads; one thread a lane."""
        lane = wp.tid()
        farthest = float(0.0)
        is_led = bool(False)
        for i in range(colors.lane_start[lane], colors.lane_start[lane + 1]):
            body = worlds.bodies[i]
            farthest = wp.max(farthest, squared_move(body, work))
            if wp.static(effects.kinds.gimbals):
                if is_body_led(body, joints, work, tree):
                    is_led = True
        colors.lane_move[lane] = wp.where(is_led, -1.0, farthest)

    @kernel()
    def find_unbalanced(
        # Work:
        worlds: WorldWork,
        # Work out:
        colors: ColorWork,
    ):
        """Whether the energy of a world has to be looked at; one thread a world."""
        world = wp.tid()
        farthest = float(0.0)
        gains = bool(False)
        if wp.static(effects.folding):
            gains = is_flat(world, worlds)
        for lane in range(colors.world_lane[world], colors.world_lane[world + 1]):
            farthest = wp.max(farthest, colors.lane_move[lane])
            if colors.lane_move[lane] < 0.0:
                gains = True
        update = worlds.update[world]
        has_not_settled = is_unsettled(update * update, colors.scale[world])
        has_not_settled = has_not_settled and update > NEARLY * wp.sqrt(farthest)
        is_due = colors.is_finite[world] == 1 and (has_not_settled or gains)
        colors.is_unbalanced[world] = int(is_due)

    @kernel()
    def begin_balances(
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        colors: ColorWork,
        # Work out:
        islands: IslandWork,
    ):
        """Nothing is summed yet; one thread a body."""
        body = wp.tid()
        if work.inv_mass[body] > 0.0 and is_unbalanced(body, worlds, colors):
            begin_balance(body, islands)

    @kernel(not effects.pairs and (effects.joints or effects.tendons))
    def join_bodies(
        static_slot: int,
        # Model:
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        loops: LoopWork,
        colors: ColorWork,
        # Work out:
        islands: IslandWork,
    ):
        """Makes one island of what joints and tendons link; one thread a body."""
        body = wp.tid()
        if is_unbalanced(body, worlds, colors):
            if work.inv_mass[body] > 0.0:
                join_joints(body, static_slot, joints, worlds, work, tree, loops, islands)
            if wp.static(effects.tendons):
                join_tendons(worlds.rank[body], islands, worlds, work, tree)

    @kernel(not effects.pairs and effects.cables)
    def join_clusters(
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        # Work out:
        islands: IslandWork,
    ):
        """Makes one island of bodies that cables pull; one thread a cluster of cables."""
        join_cluster(wp.tid(), worlds, work, tree, islands)

    @kernel(effects.cables)
    def add_all_cables(
        # Work:
        work: BodyWork,
        tree: TreeWork,
        colors: ColorWork,
        # Work out:
        islands: IslandWork,
    ):
        """Adds what cables had stored; one thread a world."""
        world = wp.tid()
        if colors.is_unbalanced[world] == 1:
            cables = tree.cables
            for i in range(cables.world_start[world], cables.world_start[world + 1]):
                add_cables(i, work, tree, islands)

    @kernel()
    def add_bodies(
        # Model:
        model: BodyModel,
        joints: JointModel,
        control: ControlInput,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        tree: TreeWork,
        loops: LoopWork,
        colors: ColorWork,
        history: History,
        # State:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
        # Work out:
        islands: IslandWork,
    ):
        """Energy of a body, and the work of what acts on it; one thread a body."""
        body = wp.tid()
        if work.inv_mass[body] > 0.0 and is_unbalanced(body, worlds, colors):
            root = root_of(islands, body)
            islands.parent[body] = root
            scale = colors.scale[worlds.of_body[body]]
            islands.balance[body] = add_body(
                root,
                body,
                scale.h,
                scale.reach,
                scale.static_slot,
                islands.start_q,
                islands.start_qd,
                model,
                joints,
                control,
                work,
                rows,
                tree,
                loops,
                history,
                body_q_out,
                body_qd_out,
                islands.balance[body],
            )
            if wp.static(effects.tendons):
                add_tendons(worlds.rank[body], body, tree, islands)

    @kernel()
    def add_runs(
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        # Work out:
        islands: IslandWork,
        colors: ColorWork,
    ):
        """Sums over each run of a lane, for its first body; one thread a lane.

        Where the root of an island comes later in a run, nothing is left there: the world's thread
        adds the run to it.
        """
        lane = wp.tid()
        end = colors.lane_start[lane + 1]
        place = next_moving(colors.lane_start[lane], end, worlds, work)
        if place == end or not is_unbalanced(worlds.bodies[place], worlds, colors):
            return
        while place < end:
            head = worlds.bodies[place]
            root = islands.parent[head]
            last = end_of_run(place, end, root, worlds, work, islands)
            sum = islands.balance[head]
            for i in range(place + 1, last):
                body = worlds.bodies[i]
                if work.inv_mass[body] > 0.0:
                    sum = combined(sum, islands.balance[body])
                    islands.balance[body] = Balance()
            islands.balance[head] = sum
            colors.count[head] = last
            place = next_moving(last, end, worlds, work)

    @kernel()
    def add_lanes(
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        colors: ColorWork,
        # Work out:
        islands: IslandWork,
    ):
        """Sums over the runs of each island, for its root; one thread a world."""
        world = wp.tid()
        if colors.is_unbalanced[world] == 0:
            return
        for lane in range(colors.world_lane[world], colors.world_lane[world + 1]):
            end = colors.lane_start[lane + 1]
            place = next_moving(colors.lane_start[lane], end, worlds, work)
            while place < end:
                head = worlds.bodies[place]
                root = islands.parent[head]
                if head != root:
                    islands.balance[root] = combined(islands.balance[root], islands.balance[head])
                place = next_moving(colors.count[head], end, worlds, work)

    @kernel()
    def add_momenta(
        # Model:
        model: BodyModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        colors: ColorWork,
        # State:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
        # Work out:
        islands: IslandWork,
    ):
        """Momentum of each run about the COM of its island, for its first body; a thread a lane."""
        lane = wp.tid()
        end = colors.lane_start[lane + 1]
        place = next_moving(colors.lane_start[lane], end, worlds, work)
        if place == end or not is_unbalanced(worlds.bodies[place], worlds, colors):
            return
        while place < end:
            head = worlds.bodies[place]
            root = islands.parent[head]
            island = islands.balance[root]
            sum = Balance()
            for i in range(place, colors.count[head]):
                body = worlds.bodies[i]
                if work.inv_mass[body] > 0.0:
                    sum = add_momentum(
                        body,
                        root,
                        island,
                        islands.start_q,
                        model,
                        work,
                        body_q_out,
                        body_qd_out,
                        sum,
                    )
            # no more than this: others read the COM of the island meanwhile
            islands.balance[head].momentum = sum.momentum
            islands.balance[head].angular = sum.angular
            islands.balance[head].inertia = sum.inertia
            islands.balance[head].start_inertia = sum.start_inertia
            place = next_moving(colors.count[head], end, worlds, work)

    @kernel()
    def settle_islands(
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        colors: ColorWork,
        # Work out:
        islands: IslandWork,
        history: History,
    ):
        """What is left of the motion of each island of a world; one thread a world."""
        world = wp.tid()
        if colors.is_unbalanced[world] == 0:
            return
        h = colors.scale[world].h
        for lane in range(colors.world_lane[world], colors.world_lane[world + 1]):
            end = colors.lane_start[lane + 1]
            place = next_moving(colors.lane_start[lane], end, worlds, work)
            while place < end:
                head = worlds.bodies[place]
                root = islands.parent[head]
                if head != root:
                    sum = combined_momentum(islands.balance[root], islands.balance[head])
                    islands.balance[root] = sum
                place = next_moving(colors.count[head], end, worlds, work)
        for lane in range(colors.world_lane[world], colors.world_lane[world + 1]):
            end = colors.lane_start[lane + 1]
            place = next_moving(colors.lane_start[lane], end, worlds, work)
            while place < end:
                head = worlds.bodies[place]
                root = islands.parent[head]
                last = colors.count[head]
                if place <= worlds.rank[root] and worlds.rank[root] < last:
                    settle_island(root, h, worlds, islands, history)
                place = next_moving(last, end, worlds, work)

    @kernel()
    def slow_bodies(
        # Model:
        model: BodyModel,
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        loops: LoopWork,
        colors: ColorWork,
        # Work out:
        islands: IslandWork,
        history: History,
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Gives a body what is left of the motion of its island; one thread a body."""
        body = wp.tid()
        if work.inv_mass[body] > 0.0 and is_unbalanced(body, worlds, colors):
            slow_body(
                body,
                colors.scale[worlds.of_body[body]].h,
                islands.start_q,
                model,
                joints,
                work,
                tree,
                loops,
                islands,
                history,
                body_q_out,
                body_qd_out,
            )

    @kernel(effects.axis_rates)
    def slow_all_rotors(
        # Model:
        joints: JointModel,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        loops: LoopWork,
        colors: ColorWork,
        islands: IslandWork,
        # State:
        body_qd_out: wp.array[wp.spatial_vector],
        # Work out:
        history: History,
    ):
        """Scales the rotors of a body's joints; one thread a body."""
        body = wp.tid()
        if work.inv_mass[body] > 0.0 and is_unbalanced(body, worlds, colors):
            slow_rotors(body, joints, work, tree, loops, islands, history, body_qd_out)

    @kernel(effects.cables)
    def drop_all_tensions(
        # Work:
        work: BodyWork,
        colors: ColorWork,
        islands: IslandWork,
        # Work out:
        tree: TreeWork,
    ):
        """Forgets what pulls islands whose step was taken back; one thread a world."""
        world = wp.tid()
        if colors.is_unbalanced[world] == 1:
            cables = tree.cables
            for i in range(cables.world_start[world], cables.world_start[world + 1]):
                drop_tensions(i, work, tree, islands)

    return ColoredEnergy(
        measure_moves,
        find_unbalanced,
        begin_balances,
        join_bodies,
        join_clusters,
        add_all_cables,
        add_bodies,
        add_runs,
        add_lanes,
        add_momenta,
        settle_islands,
        slow_bodies,
        slow_all_rotors,
        drop_all_tensions,
    )
