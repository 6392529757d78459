# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds: the energy of islands that did not settle, summed by many threads.

What one body adds (:mod:`.step.body_energy`) is found by a thread a body. A *run* is a sequence of
bodies of one lane that belong to one island; a thread a lane sums over its runs, and a thread a
world over the runs of all lanes, in their order. So sums do not depend on the order of the threads,
and an island of n bodies, which mostly follow each other, takes about the root of n additions one
after the other.
"""

import warp as wp

from ..data import Balance, Solver, Step
from ..effects import Effects
from ..functions import Functions
from ..step.balance import add_cables, add_momentum, add_tendons, combined, combined_momentum
from ..step.bodies import moved_by
from ..step.energy import NEARLY
from ..step.kernels import KernelDecorator
from ..step.scale import is_unsettled
from ..step.slowing import drop_tensions
from .joining import root_of


@wp.func
def is_unbalanced(body: int, s: wp.ref[Solver]) -> bool:
    """Whether the energy of a body's world has to be looked at."""
    return s.colors.is_unbalanced[s.worlds.of_body[body]] == 1


@wp.func
def end_of_run(first: int, end: int, root: int, s: wp.ref[Solver]) -> int:
    """Place after the run that begins at a place; bodies that do not move belong to any."""
    place = int(first)
    while place < end:
        body = s.worlds.bodies[place]
        if s.work.inv_mass[body] > 0.0 and s.islands.parent[body] != root:
            return place
        place += 1
    return place


@wp.func
def next_moving(first: int, end: int, s: wp.ref[Solver]) -> int:
    """First place from this one on whose body moves."""
    place = int(first)
    while place < end and s.work.inv_mass[s.worlds.bodies[place]] == 0.0:
        place += 1
    return place


def make_colored_energy(effects: Effects, energy: Functions, kernel: KernelDecorator) -> None:
    """Kernels that bound the energy of islands, made by a decorator.

    Args:
        effects: Effects of the scene.
        energy: What they call; islands are joined by many threads at once.
        kernel: The decorator.
    """
    may_body_gain, is_astray = energy.may_body_gain, energy.is_astray
    begin_balance = energy.begin_balance
    join_joints, join_closures = energy.join_joints, energy.join_closures
    join_cluster = energy.join_cluster
    add_body, settle_island = energy.add_body, energy.settle_island
    slow_body, slow_rotors = energy.slow_body, energy.slow_rotors

    @kernel()
    def measure_moves(s: wp.array[Solver]):
        """The farthest move of a lane, negative where a body may gain energy; one thread a lane."""
        lane = wp.tid()
        farthest = float(0.0)
        gains = bool(False)
        for i in range(s[0].colors.lane_start[lane], s[0].colors.lane_start[lane + 1]):
            body = s[0].worlds.bodies[i]
            farthest = wp.max(farthest, moved_by(body, s[0].work.increment[body], s[0].work))
            if wp.static(effects.gaining):
                if may_body_gain(body, s[0]):
                    gains = True
        s[0].colors.lane_move[lane] = wp.where(gains, -1.0, farthest)

    @kernel()
    def find_unbalanced(s: wp.array[Solver]):
        """Whether the energy of a world has to be looked at; one thread a world."""
        world = wp.tid()
        farthest = float(0.0)
        gains = bool(False)
        if wp.static(effects.joints):
            gains = is_astray(world, s[0])
        for lane in range(s[0].colors.world_lane[world], s[0].colors.world_lane[world + 1]):
            farthest = wp.max(farthest, s[0].colors.lane_move[lane])
            if s[0].colors.lane_move[lane] < 0.0:
                gains = True
        update = s[0].worlds.update[world]
        has_not_settled = is_unsettled(update * update, s[0].colors.scale[world])
        has_not_settled = has_not_settled and update > NEARLY * wp.sqrt(farthest)
        is_due = s[0].colors.is_finite[world] == 1 and (has_not_settled or gains)
        s[0].colors.is_unbalanced[world] = int(is_due)

    @kernel()
    def begin_balances(s: wp.array[Solver]):
        """Nothing is summed yet; one thread a body."""
        body = wp.tid()
        if s[0].work.inv_mass[body] > 0.0 and is_unbalanced(body, s[0]):
            begin_balance(body, s[0].islands)

    @kernel(not effects.islands and (effects.joints or effects.tendons))
    def join_bodies(static_slot: int, s: wp.array[Solver]):
        """Makes one island of what joints, tendons and mimics link; one thread a body."""
        body = wp.tid()
        if is_unbalanced(body, s[0]):
            if s[0].work.inv_mass[body] > 0.0:
                join_joints(body, static_slot, s[0])
            if wp.static(effects.tendons or effects.mimics):
                join_closures(s[0].worlds.rank[body], s[0])

    @kernel(not effects.islands and effects.cables)
    def join_cabled(s: wp.array[Solver]):
        """Makes one island of bodies that cables pull; one thread a cluster of cables."""
        join_cluster(wp.tid(), s[0])

    @kernel(effects.cables)
    def add_all_cables(s: wp.array[Solver]):
        """Adds what cables had stored; one thread a world."""
        world = wp.tid()
        if s[0].colors.is_unbalanced[world] == 1:
            cables = s[0].tree.cables
            for i in range(cables.world_start[world], cables.world_start[world + 1]):
                add_cables(i, s[0])

    @kernel()
    def add_bodies(step: Step, s: wp.array[Solver]):
        """Energy of a body, and the work of what acts on it; one thread a body."""
        body = wp.tid()
        if s[0].work.inv_mass[body] > 0.0 and is_unbalanced(body, s[0]):
            root = root_of(s[0].islands, body)
            s[0].islands.parent[body] = root
            scale = s[0].colors.scale[s[0].worlds.of_body[body]]
            s[0].islands.balance[body] = add_body(
                root,
                body,
                scale.h,
                scale.reach,
                scale.static_slot,
                s[0].islands.balance[body],
                step,
                s[0],
            )
            if wp.static(effects.tendons):
                add_tendons(s[0].worlds.rank[body], body, s[0])

    @kernel()
    def add_runs(s: wp.array[Solver]):
        """Sums over each run of a lane, for its first body; one thread a lane.

        Where the root of an island comes later in a run, nothing is left there: the world's thread
        adds the run to it.
        """
        lane = wp.tid()
        end = s[0].colors.lane_start[lane + 1]
        place = next_moving(s[0].colors.lane_start[lane], end, s[0])
        if place == end or not is_unbalanced(s[0].worlds.bodies[place], s[0]):
            return
        while place < end:
            head = s[0].worlds.bodies[place]
            root = s[0].islands.parent[head]
            last = end_of_run(place, end, root, s[0])
            sum = s[0].islands.balance[head]
            for i in range(place + 1, last):
                body = s[0].worlds.bodies[i]
                if s[0].work.inv_mass[body] > 0.0:
                    sum = combined(sum, s[0].islands.balance[body])
                    s[0].islands.balance[body] = Balance()
            s[0].islands.balance[head] = sum
            s[0].colors.count[head] = last
            place = next_moving(last, end, s[0])

    @kernel()
    def add_lanes(s: wp.array[Solver]):
        """Sums over the runs of each island, for its root; one thread a world."""
        world = wp.tid()
        if s[0].colors.is_unbalanced[world] == 0:
            return
        for lane in range(s[0].colors.world_lane[world], s[0].colors.world_lane[world + 1]):
            end = s[0].colors.lane_start[lane + 1]
            place = next_moving(s[0].colors.lane_start[lane], end, s[0])
            while place < end:
                head = s[0].worlds.bodies[place]
                root = s[0].islands.parent[head]
                if head != root:
                    s[0].islands.balance[root] = combined(
                        s[0].islands.balance[root], s[0].islands.balance[head]
                    )
                place = next_moving(s[0].colors.count[head], end, s[0])

    @kernel()
    def add_momenta(step: Step, s: wp.array[Solver]):
        """Momentum of each run about the COM of its island, for its first body; a thread a lane."""
        lane = wp.tid()
        end = s[0].colors.lane_start[lane + 1]
        place = next_moving(s[0].colors.lane_start[lane], end, s[0])
        if place == end or not is_unbalanced(s[0].worlds.bodies[place], s[0]):
            return
        while place < end:
            head = s[0].worlds.bodies[place]
            root = s[0].islands.parent[head]
            island = s[0].islands.balance[root]
            sum = Balance()
            for i in range(place, s[0].colors.count[head]):
                body = s[0].worlds.bodies[i]
                if s[0].work.inv_mass[body] > 0.0:
                    sum = add_momentum(body, root, island, sum, step, s[0])
            # no more than this: others read the COM of the island meanwhile
            s[0].islands.balance[head].momentum = sum.momentum
            s[0].islands.balance[head].angular = sum.angular
            s[0].islands.balance[head].inertia = sum.inertia
            s[0].islands.balance[head].start_inertia = sum.start_inertia
            place = next_moving(s[0].colors.count[head], end, s[0])

    @kernel()
    def settle_islands(s: wp.array[Solver]):
        """What is left of the motion of each island of a world; one thread a world."""
        world = wp.tid()
        if s[0].colors.is_unbalanced[world] == 0:
            return
        h = s[0].colors.scale[world].h
        for lane in range(s[0].colors.world_lane[world], s[0].colors.world_lane[world + 1]):
            end = s[0].colors.lane_start[lane + 1]
            place = next_moving(s[0].colors.lane_start[lane], end, s[0])
            while place < end:
                head = s[0].worlds.bodies[place]
                root = s[0].islands.parent[head]
                if head != root:
                    sum = combined_momentum(s[0].islands.balance[root], s[0].islands.balance[head])
                    s[0].islands.balance[root] = sum
                place = next_moving(s[0].colors.count[head], end, s[0])
        for lane in range(s[0].colors.world_lane[world], s[0].colors.world_lane[world + 1]):
            end = s[0].colors.lane_start[lane + 1]
            place = next_moving(s[0].colors.lane_start[lane], end, s[0])
            while place < end:
                head = s[0].worlds.bodies[place]
                root = s[0].islands.parent[head]
                last = s[0].colors.count[head]
                if place <= s[0].worlds.rank[root] and s[0].worlds.rank[root] < last:
                    settle_island(root, h, s[0])
                place = next_moving(last, end, s[0])

    @kernel()
    def slow_bodies(step: Step, s: wp.array[Solver]):
        """Gives a body what is left of the motion of its island; one thread a body."""
        body = wp.tid()
        if s[0].work.inv_mass[body] > 0.0 and is_unbalanced(body, s[0]):
            slow_body(body, s[0].colors.scale[s[0].worlds.of_body[body]].h, step, s[0])

    @kernel(effects.axis_rates)
    def slow_all_rotors(step: Step, s: wp.array[Solver]):
        """Scales the rotors of a body's joints; one thread a body."""
        body = wp.tid()
        if s[0].work.inv_mass[body] > 0.0 and is_unbalanced(body, s[0]):
            slow_rotors(body, step, s[0])

    @kernel(effects.cables)
    def drop_all_tensions(s: wp.array[Solver]):
        """Forgets what pulls islands whose step was taken back; one thread a world."""
        world = wp.tid()
        if s[0].colors.is_unbalanced[world] == 1:
            cables = s[0].tree.cables
            for i in range(cables.world_start[world], cables.world_start[world + 1]):
                drop_tensions(i, s[0])
