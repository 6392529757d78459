# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds, all blocks of a color at once: their buffers, and their launches in order."""

import functools
import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from .. import data
from ..effects import Effects
from ..model.topology import Topology
from ..rows.contact import RECOVERY
from ..step.scale import COLD_FACTOR, JOINT_PASSES, LONGER, LOOP_PASSES, STRUCK_FACTOR
from . import coloring, joining, scan
from .barrier import block_size
from .colored import Colored, make_colored
from .coloring import COLORS, PASSES
from .launch import Launcher

LARGE = 64
"""Bodies from which a world on a GPU is solved color by color: on an H200 a thread takes 0.12 ms a
body of a pyramid, and colors 1.5 ms for up to 300 bodies."""
FEW = 100
"""Most worlds that are solved so: worlds by threads take the same time for up to 1,056 of them, but
colors 0.4 ms for each 1,000 bodies."""

_UNSUPPORTED: dict[str, str] = {
    "ramp": "formulation='ramp'",
    "sleeping": "sleeping=True",
}
"""Effects that worlds solved color by color do without, and what to call them."""

_SHORTEST = 64
"""Fewest bodies of a lane, where a world has as many."""
_SHARE = 4
"""Bodies of a world by threads of a launch: few colors have more; those take a loop."""


def obstacles(effects: Effects) -> list[str]:
    """What of a scene cannot be solved color by color; empty where all can."""
    found = [reason for name, reason in _UNSUPPORTED.items() if getattr(effects, name)]
    return list(dict.fromkeys(found))


class _Views(NamedTuple):
    """The solver with what kernels take for its worlds."""

    whole: data.Context
    lanes: data.Context
    measured: data.Context
    """Lanes, with the loops of each."""
    by_rank: data.Context
    """Lanes, whose bodies are in the order of the colors."""
    islands: data.Context


class LargeWorlds:
    """Buffers of large worlds, and the order of their launches.

    Args:
        worlds: The solver's :class:`.data.WorldWork`.
        loops: The solver's :class:`.data.LoopWork`.
        topology: Which bodies are a block.
        clusters: How many sets of cables are solved at once.
        iterations: Sweeps of a step.
        device: Where the bodies are.
    """

    def __init__(
        self,
        worlds: Any,
        loops: Any,
        topology: Topology,
        clusters: int,
        iterations: int,
        device: wp.Device,
    ) -> None:
        body_start, bodies = worlds.body_start.numpy(), worlds.bodies.numpy()
        self._body_count, self._world_count = bodies.size, body_start.size - 1
        self._device = device
        self.may_be_cold = True
        """Whether the next step may be the first of a world, as far as the host knows."""
        self._h = 0.0
        slots = bodies.size + 1
        lane_start, world_lane = _lanes(body_start)
        self._lanes = lanes = lane_start.size - 1
        table = (COLORS + 1) * lanes
        # what is random is the same in worlds of the same size
        priority = np.zeros(slots)
        for start, end in pairwise(body_start):
            priority[bodies[start:end]] = np.random.default_rng(0).permutation(end - start)
        ends = topology.block_end
        start = np.searchsorted(ends, ends)
        block = np.append(bodies[start][topology.rank], bodies.size)
        is_jointed = np.zeros(slots, dtype=np.int32)
        is_jointed[block[:-1][~topology.is_alone]] = 1
        self._loop_count, self._cluster_count = 0, clusters
        if loops.joints is not None:
            self._loop_count = loops.joints.shape[0]
            is_jointed[block[:-1][np.diff(loops.body_start.numpy())[:-1] > 0]] = 1
        # as worlds: lanes of bodies, the same in the order of the colors, and islands
        self._worlds, self._turns = data.merged(worlds), data.merged(worlds)
        self._islands, self._loops_by_lane = data.WorldWork(), data.merged(loops)
        self.colors = colors = data.ColorWork()
        with wp.ScopedDevice(device):
            colors.lane_start = wp.array(lane_start, dtype=wp.int32)
            colors.world_lane = wp.array(world_lane, dtype=wp.int32)
            colors.block = wp.array(block, dtype=wp.int32)
            colors.is_jointed = wp.array(is_jointed, dtype=wp.int32)
            colors.priority = wp.array(priority, dtype=wp.int32)
            colors.count = wp.zeros(slots, dtype=wp.int32)
            colors.incident_start = wp.zeros(slots, dtype=wp.int32)
            colors.color = wp.zeros((2, slots), dtype=wp.int32)
            colors.table = wp.zeros(table, dtype=wp.int32)
            colors.start = wp.zeros(table + 1, dtype=wp.int32)
            colors.order = wp.zeros(slots, dtype=wp.int32)
            colors.sums = wp.zeros(scan.scratch_size(max(table, slots)), dtype=wp.int32)
            colors.lane_scale = wp.zeros(lanes, dtype=data.WorldScale)
            colors.lane_finite = wp.zeros(lanes, dtype=wp.int32)
            colors.lane_move = wp.zeros(lanes, dtype=float)
            colors.scale = wp.zeros(self._world_count, dtype=data.WorldScale)
            colors.is_finite = wp.zeros(self._world_count, dtype=wp.int32)
            colors.closing = wp.zeros(self._world_count, dtype=float)
            colors.deepest = wp.zeros(self._world_count, dtype=float)
            names = ("most", "passes", "is_open", "has_impacts", "begin", "is_held", "jumps")
            for name in (*names, "breaks", "is_moving", "is_unbalanced"):
                setattr(colors, name, wp.zeros(self._world_count, dtype=wp.int32))
            passes = 1 + max(int(JOINT_PASSES), int(LOOP_PASSES))
            colors.recovered = wp.zeros((passes, self._world_count), dtype=float)
            colors.has_more = wp.zeros(1, dtype=wp.int32)
            colors.is_cold = wp.zeros(1, dtype=wp.int32)
            colors.is_apart = wp.zeros(1, dtype=wp.int32)
            colors.is_excessive = wp.zeros(1, dtype=wp.int32)
            self._worlds.body_start = colors.lane_start
            self._turns.rank = wp.zeros(slots, dtype=wp.int32)
            if self._loop_count:
                starts = _share(loops.world_start.numpy(), world_lane)
                self._loops_by_lane.world_start = wp.array(starts, dtype=wp.int32)
            self._islands.body_start = wp.zeros(slots, dtype=wp.int32)
            self._islands.bodies = wp.zeros(slots, dtype=wp.int32)
            self._islands.of_body = worlds.of_body
        self._views: _Views | None = None
        self._allocate_sweeps(iterations)

    def _views_of(self, whole: data.Context) -> "_Views":
        """The solver with what these kernels take for its worlds."""
        if self._views is None or self._views.whole is not whole:
            lanes = whole._replace(worlds=self._worlds)
            self._views = _Views(
                whole,
                lanes,
                lanes._replace(loops=self._loops_by_lane),
                whole._replace(worlds=self._turns),
                whole._replace(worlds=self._islands),
            )
        return self._views

    def _allocate_sweeps(self, iterations: int) -> None:
        shape = (int(COLD_FACTOR) * iterations + 1, self._world_count)
        self.colors.moved = wp.zeros(shape, dtype=float, device=self._device)

    def allocate_contacts(self, capacity: int) -> tuple[wp.array, ...]:
        """Buffers by contact; returns those that they replace, which graphs may hold."""
        old = (self.colors.incident, self.colors.partner)
        with wp.ScopedDevice(self._device):
            # a contact between two bodies that move is one of both
            self.colors.incident = wp.empty(2 * capacity, dtype=wp.int32)
            self.colors.partner = wp.empty(2 * capacity, dtype=wp.int32)
        return old

    def forget(self, launch: Launcher, body_world: wp.array, mask: wp.array) -> None:
        """Starts the masked worlds from no colors; all, with an empty mask."""
        launch(coloring.forget_colors, self._body_count, [body_world, mask, self.colors])
        self.may_be_cold = True

    def found(self) -> tuple[int, int]:
        """How many colors the last step took, and how many blocks found none."""
        sizes = np.diff(self.colors.start.numpy()[:: self._lanes])
        return int(np.count_nonzero(sizes[:COLORS])), int(sizes[COLORS])

    def _scan(self, launch: Launcher, counts: wp.array, count: int, starts: wp.array) -> None:
        """Prefix sums of the first ``count`` counts."""
        scan.scan(launch, counts, count, self.colors.sums, starts)

    def solve(
        self,
        launch: Launcher,
        effects: Effects,
        step: Any,
        whole: data.Context,
        places: int,
        h: float,
        iterations: int,
    ) -> None:
        """The step after prediction.

        Args:
            launch: Launches.
            effects: Those of the scene.
            step: The :class:`.data.Step`.
            whole: What the kernels see of the solver.
            places: Contacts that the buffer has room for.
            h: Time step [s].
            iterations: Most sweeps of a round.
        """
        views = self._views_of(whole)
        lanes, measured, by_rank = views.lanes, views.measured, views.by_rank
        islands_as_worlds, colors, rows = views.islands, self.colors, whole.rows
        if h > float(LONGER) * self._h:
            self.may_be_cold = True
        self._h = h
        most = int(COLD_FACTOR) * iterations
        if colors.moved.shape[0] <= most:
            launch.forget()
            self._allocate_sweeps(iterations)
        bodies, lane_count = self._body_count, self._lanes
        kernels = make_colored(effects)

        # Which blocks touch, and in what order they move.
        launch(coloring.clear_counts, bodies, [colors])
        launch(coloring.count_contacts, places, [step, lanes])
        self._scan(launch, colors.count, bodies, colors.incident_start)
        launch(coloring.list_contacts, places, [step, lanes])
        launch(coloring.sort_lists, bodies, [step, lanes])
        for i in range(PASSES):
            launch(coloring.color_blocks, bodies, [i % 2, int(i == PASSES - 1), lanes])
        launch(coloring.count_colors, lane_count, [lanes])
        self._scan(launch, colors.table, (COLORS + 1) * lane_count, colors.start)
        launch(coloring.list_colors, lane_count, [self._turns.rank, lanes])

        # Rows: linearised at state_in, warm-started from the last step.
        launch(kernels.measure_lanes, lane_count, [step, measured])
        launch(kernels.begin_step, self._world_count, [step, lanes])
        launch(coloring.count_owned, bodies, [by_rank])
        self._scan(launch, colors.count, bodies, rows.owned_start)
        launch(kernels.build_rows, bodies, [step, by_rank])
        launch(kernels.recall_rows, bodies, [by_rank])
        if effects.light_links:
            launch(kernels.weigh, bodies, [lanes])
        launch(kernels.penalise, bodies, [step, lanes])

        # What bounces; without a contact buffer nothing does.
        if effects.restitution and places:
            launch(kernels.begin_rounds, bodies, [step.body_qd, rows])
            launch(kernels.find_impacts, bodies, [lanes])
            block = block_size(self._device)
            wave = self._islands.bodies  # of no use before the sweeps have ended
            launch(kernels.strike_worlds, self._world_count * block, [block, wave, by_rank])
            launch(kernels.end_rounds, bodies, [lanes])

        if effects.second_order:
            self._order_step(launch, kernels, effects, step, lanes)

        # Joints, and the blocks of bodies.
        if effects.joints:
            launch(kernels.measure_joints, bodies, [step, lanes])
        if effects.loops:
            launch(kernels.measure_loops, self._loop_count, [step, lanes])
        if effects.loops and effects.kinds.distances:
            launch(kernels.widen_loops, self._loop_count, [lanes])
        if effects.joints:
            launch(kernels.place_joints, bodies, [lanes])
        if effects.cables:
            launch(kernels.begin_clusters, self._cluster_count, [lanes])

        def assemble(begin: int) -> None:
            launch(kernels.assemble, bodies, [begin, step, lanes])

        threads = -(-bodies // _SHARE)

        def sweep(first: int, end: int) -> None:
            run(first, end, 0.0, colors.most, colors.moved)

        def recover(first: int, end: int) -> None:
            run(first, end, float(RECOVERY), colors.passes, colors.recovered)

        def run(first: int, end: int, recovery: float, most: wp.array, moved: wp.array) -> None:
            for sweep in range(first, end):
                for color in range(COLORS + 1):
                    count = threads if color < COLORS else 1
                    launch(
                        kernels.sweep_color,
                        count,
                        [sweep, color, count, recovery, most, moved, step, lanes],
                    )
                if effects.loops:
                    launch(
                        kernels.sweep_loops,
                        self._loop_count,
                        [sweep, recovery, moved, most, step, lanes],
                    )
                if effects.cables:
                    launch(
                        kernels.solve_clusters,
                        self._cluster_count,
                        [sweep, recovery, most, moved, lanes],
                    )

        def sweep_on(begin: int) -> None:
            if kernels.stiffen is not None:
                launch(kernels.stiffen, bodies, [begin, lanes])
            assemble(begin)
            sweep(begin, begin + iterations)

        def sweep_cold() -> None:
            sweep(int(STRUCK_FACTOR) * iterations, most)

        assemble(0)
        sweep(0, iterations)
        for turn in range(1, int(STRUCK_FACTOR)):
            launch(kernels.begin_round, self._world_count, [iterations, turn * iterations, colors])
            self._launch_if(colors.has_more, functools.partial(sweep_on, turn * iterations))
        self._launch_if(colors.is_cold, sweep_cold, is_due=self.may_be_cold)
        self.may_be_cold = False
        launch(kernels.remember, bodies, [step, lanes])
        if effects.second_order and effects.loops:
            launch(kernels.remember_loops, self._loop_count, [lanes])
        if effects.second_order and effects.cables:
            launch(kernels.find_jerked, self._cluster_count, [lanes])
        if effects.cables and effects.islands:
            launch(kernels.join_clusters, self._cluster_count, [lanes])
        if effects.islands:
            launch(joining.find_roots, bodies, [lanes])
            launch(joining.count_members, bodies, [lanes])
            self._scan(launch, colors.count, bodies, self._islands.body_start)
            launch(joining.list_members, bodies, [islands_as_worlds])
            launch(joining.keep_island, bodies, [effects.pairs, islands_as_worlds])
        if effects.breaking:
            launch(kernels.break_trees, bodies, [step, lanes])
            if effects.loops:
                launch(kernels.break_loops, self._loop_count, [lanes])
        launch(kernels.end_velocities, bodies, [step, lanes])
        if effects.spinning:
            launch(kernels.align_spins, bodies, [step, lanes])
        if effects.restitution and places:
            launch(kernels.leave_impacts, bodies, [lanes])
        if effects.axis_rates:
            launch(kernels.end_armatures, bodies, [step, lanes])
            if effects.loops:
                launch(kernels.end_loop_armatures, self._loop_count, [step, lanes])

        # Recovery: old errors go, without entering the velocity.
        launch(kernels.end_sweeps, self._world_count, [lanes])
        if effects.second_order:
            launch(kernels.remember_motions, bodies, [lanes])
        if effects.loops:
            launch(kernels.keep_loops, self._loop_count, [lanes])
        if effects.joints or not effects.compliance:
            recover(0, 1)
        if effects.joints:
            passes = int(LOOP_PASSES if effects.closures else JOINT_PASSES)
            self._launch_if(colors.is_apart, lambda: recover(1, passes))
            launch(kernels.close_joints, bodies, [step, lanes])
        if effects.loops:
            launch(kernels.give_loops_back, self._loop_count, [lanes])
        if effects.cables:
            launch(kernels.give_cables_back, self._cluster_count, [lanes])
        launch(kernels.end_poses, bodies, [step, lanes])
        if effects.turning_islands:
            launch(joining.keep_island_spin, bodies, [step, islands_as_worlds])

        if effects.balanced:
            bound = functools.partial(self._bound_energy, launch, kernels, effects, step, lanes)
            self._launch_if(colors.is_excessive, bound)
        if effects.second_order:
            launch(kernels.remember_states, bodies, [step, lanes])

    def _order_step(
        self,
        launch: Launcher,
        kernels: Colored,
        effects: Effects,
        step: Any,
        lanes: data.Context,
    ) -> None:
        """Second order: which worlds go on as they went, and where their bodies start."""
        bodies = self._body_count
        launch(kernels.find_flying, bodies, [step, lanes])
        launch(kernels.find_jumps, bodies, [step, lanes])
        if effects.loops:
            launch(kernels.find_loop_jumps, self._loop_count, [lanes])
        if effects.cables:
            launch(kernels.find_jerks, self._cluster_count, [lanes])
        launch(kernels.order_worlds, self._world_count, [lanes])
        launch(kernels.start_bodies, bodies, [step, lanes])
        if effects.contact:
            launch(kernels.lead_all_rows, bodies, [lanes])

    def _bound_energy(
        self,
        launch: Launcher,
        kernels: Colored,
        effects: Effects,
        step: Any,
        lanes: data.Context,
    ) -> None:
        """Slows islands that did not settle down to the energy that they may have."""
        energy = kernels.energy
        bodies, lane_count, count = self._body_count, self._lanes, self._world_count
        assert energy is not None
        launch(energy.measure_moves, lane_count, [lanes])
        launch(energy.find_unbalanced, count, [lanes])
        launch(energy.begin_balances, bodies, [lanes])
        if energy.join_bodies is not None:
            launch(energy.join_bodies, bodies, [bodies, lanes])
        if energy.join_clusters is not None:
            launch(energy.join_clusters, self._cluster_count, [lanes])
        if effects.cables:
            launch(energy.add_all_cables, count, [lanes])
        launch(energy.add_bodies, bodies, [step, lanes])
        launch(energy.add_runs, lane_count, [lanes])
        launch(energy.add_lanes, count, [lanes])
        launch(energy.add_momenta, lane_count, [step, lanes])
        launch(energy.settle_islands, count, [lanes])
        launch(energy.slow_bodies, bodies, [step, lanes])
        if effects.axis_rates:
            launch(energy.slow_all_rotors, bodies, [step, lanes])
        if effects.cables:
            launch(energy.drop_all_tensions, count, [lanes])

    def _launch_if(
        self, condition: wp.array, launches: Callable[[], None], *, is_due: bool = True
    ) -> None:
        """Launches what a number on the device calls for.

        Where the host cannot leave that to the device it launches all, unless it knows that nothing
        ``is_due``: kernels that are not needed return at once.
        """
        is_graph = self._device.is_capturing and wp.is_conditional_graph_supported()
        if self._device.is_cpu or is_graph:
            wp.capture_if(condition, launches)
        elif is_due or self._device.is_capturing:
            launches()


def _share(starts: np.ndarray, world_lane: np.ndarray) -> np.ndarray:
    """Where each lane starts, where those of a world share what the world has from its start on."""
    shares = [
        start + np.arange(lanes) * (end - start) // lanes
        for (start, end), lanes in zip(pairwise(starts), np.diff(world_lane), strict=True)
        if lanes
    ]
    return np.append(np.concatenate(shares), starts[-1])


def _lanes(body_start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Divides worlds into lanes: first body of each lane, and first lane of each world.

    A lane has about the root of its world's bodies, so that neither takes long to go through; how a
    world is divided, and so what its sums round to, does not depend on the others.
    """
    starts, world_lane = [0], [0]
    for start, end in pairwise(body_start):
        length = max(_SHORTEST, math.isqrt(end - start))
        starts += [min(place, end) for place in range(start + length, end + length, length)]
        world_lane.append(len(starts) - 1)
    return np.array(starts), np.array(world_lane)
