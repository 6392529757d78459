# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds, all blocks of a color at once: their buffers, and their launches in order."""

import functools
import math
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
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
from .colored import make_colored
from .coloring import COLORS, PASSES
from .launch import Launcher

LARGE = 64
"""Bodies from which a world on a GPU is solved color by color: on an H200 a thread takes 0.12 ms a
body of a pyramid, and colors 1.5 ms for up to 300 bodies."""
FEW = 100
"""Most worlds that are solved so: worlds by threads take the same time for up to 1,056 of them, but
colors 0.4 ms for each 1,000 bodies."""

_UNSUPPORTED: dict[str, str] = {"ramp": "formulation='ramp'", "sleeping": "sleeping=True"}
"""Effects that worlds solved color by color do without, and what to call them."""

_SHORTEST = 64
"""Fewest bodies of a lane, where a world has as many."""
_SHARE = 4
"""Bodies of a world by threads of a launch: few colors have more; those take a loop."""


def obstacles(effects: Effects) -> list[str]:
    """What of a scene cannot be solved color by color; empty where all can."""
    return effects.among(_UNSUPPORTED)


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
            data.fill(colors, lane_start=lane_start, world_lane=world_lane, block=block)
            data.fill(colors, is_jointed=is_jointed, priority=priority)
            data.allocate(colors, slots, "count", "incident_start", "order")
            data.allocate(colors, (2, slots), "color")
            data.allocate(colors, table, "table")
            data.allocate(colors, table + 1, "start")
            data.allocate(colors, scan.scratch_size(max(table, slots)), "sums")
            data.allocate(colors, lanes, "lane_scale", "lane_finite", "lane_move")
            data.allocate(colors, self._world_count, "scale", "is_finite", "closing", "deepest")
            names = ("most", "passes", "is_open", "has_impacts", "begin", "is_held", "jumps")
            data.allocate(colors, self._world_count, *names)
            data.allocate(colors, self._world_count, "breaks", "is_moving", "is_unbalanced")
            passes = 1 + max(int(JOINT_PASSES), int(LOOP_PASSES))
            data.allocate(colors, (passes, self._world_count), "recovered")
            data.allocate(colors, 1, "has_more", "is_cold", "is_apart", "is_excessive")
            self._worlds.body_start = colors.lane_start
            data.allocate(self._turns, slots, "rank")
            data.allocate(self._turns, 0, "block_end")
            if self._loop_count:
                starts = _share(loops.world_start.numpy(), world_lane)
                data.fill(self._loops_by_lane, world_start=starts)
            data.allocate(self._islands, slots, "body_start", "bodies")
            self._islands.of_body = worlds.of_body
        self._views: _Views | None = None
        self._allocate_sweeps(iterations)

    def _views_of(self, whole: data.Context) -> _Views:
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
        lanes, colors = views.lanes, self.colors
        if h > float(LONGER) * self._h:
            self.may_be_cold = True
        self._h = h
        if colors.moved.shape[0] <= int(COLD_FACTOR) * iterations:
            launch.forget()
            self._allocate_sweeps(iterations)
        kernels = make_colored(effects)

        self._color_blocks(launch, step, lanes, places)
        self._build_rows(launch, kernels, step, views)
        # without a contact buffer nothing bounces
        has_impacts = effects.restitution and places > 0
        if has_impacts:
            self._strike(launch, kernels, step, views)
        if effects.second_order:
            self._order_step(launch, kernels, step, lanes)
        self._begin_joints(launch, kernels, step, lanes)
        sweep = functools.partial(self._sweep, launch, kernels, step, lanes)
        self._move(launch, kernels, sweep, iterations, step, lanes)
        self._keep_forces(launch, kernels, effects, step, views)
        self._end_velocities(launch, kernels, has_impacts, step, lanes)
        self._recover(launch, kernels, sweep, effects, step, views)
        if effects.balanced:
            bound = functools.partial(self._bound_energy, launch, kernels, step, lanes)
            self._launch_if(colors.is_excessive, bound)
        if effects.second_order:
            launch(kernels.remember_states, self._body_count, [step, lanes])

    def _color_blocks(self, launch: Launcher, step: Any, lanes: data.Context, places: int) -> None:
        """Which blocks touch, and in what order they move."""
        bodies, lane_count, colors = self._body_count, self._lanes, self.colors
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

    def _build_rows(
        self, launch: Launcher, kernels: SimpleNamespace, step: Any, views: _Views
    ) -> None:
        """Rows: linearised at state_in, warm-started from the last step."""
        bodies, lanes, by_rank = self._body_count, views.lanes, views.by_rank
        launch(kernels.measure_lanes, self._lanes, [step, views.measured])
        launch(kernels.begin_step, self._world_count, [step, lanes])
        launch(coloring.count_owned, bodies, [by_rank])
        self._scan(launch, self.colors.count, bodies, views.whole.rows.owned_start)
        launch(kernels.build_rows, bodies, [step, by_rank])
        launch(kernels.recall_rows, bodies, [by_rank])
        launch(kernels.weigh, bodies, [lanes])
        launch(kernels.penalise, bodies, [step, lanes])

    def _strike(self, launch: Launcher, kernels: SimpleNamespace, step: Any, views: _Views) -> None:
        """What bounces: the speed after each impact."""
        bodies, block = self._body_count, block_size(self._device)
        wave = self._islands.bodies  # of no use before the sweeps have ended
        launch(kernels.begin_all_rounds, bodies, [step.body_qd, views.whole.rows])
        launch(kernels.find_impacts, bodies, [views.lanes])
        launch(kernels.strike_worlds, self._world_count * block, [block, wave, views.by_rank])
        launch(kernels.end_rounds, bodies, [views.lanes])

    def _order_step(
        self, launch: Launcher, kernels: SimpleNamespace, step: Any, lanes: data.Context
    ) -> None:
        """Second order: which worlds go on as they went, and where their bodies start."""
        bodies = self._body_count
        launch(kernels.find_flying, bodies, [step, lanes])
        launch(kernels.find_jumps, bodies, [step, lanes])
        launch(kernels.find_loop_jumps, self._loop_count, [lanes])
        launch(kernels.find_jerks, self._cluster_count, [lanes])
        launch(kernels.order_worlds, self._world_count, [lanes])
        launch(kernels.start_bodies, bodies, [step, lanes])
        launch(kernels.lead_all_rows, bodies, [lanes])

    def _begin_joints(
        self, launch: Launcher, kernels: SimpleNamespace, step: Any, lanes: data.Context
    ) -> None:
        """How joints stand, the guess of increments, and tensions of cables."""
        launch(kernels.measure_joints, self._body_count, [step, lanes])
        launch(kernels.measure_loops, self._loop_count, [step, lanes])
        launch(kernels.widen_loops, self._loop_count, [lanes])
        launch(kernels.place_joints, self._body_count, [lanes])
        launch(kernels.begin_clusters, self._cluster_count, [lanes])

    def _sweep(
        self,
        launch: Launcher,
        kernels: SimpleNamespace,
        step: Any,
        lanes: data.Context,
        first: int,
        end: int,
        recovery: float,
        most: wp.array,
        moved: wp.array,
    ) -> None:
        """The sweeps from ``first`` to ``end``, of which each world takes ``most`` at most.

        The squares of the updates go to ``moved``, (sweep + 1, world) [m^2].
        """
        threads = -(-self._body_count // _SHARE)
        for sweep in range(first, end):
            for color in range(COLORS + 1):
                count = threads if color < COLORS else 1
                given = [sweep, color, count, recovery, most, moved, step, lanes]
                launch(kernels.sweep_color, count, given)
            given = [sweep, recovery, moved, most, step, lanes]
            launch(kernels.sweep_loops, self._loop_count, given)
            given = [sweep, recovery, most, moved, lanes]
            launch(kernels.solve_clusters, self._cluster_count, given)

    def _move(
        self,
        launch: Launcher,
        kernels: SimpleNamespace,
        sweep: Callable[..., None],
        iterations: int,
        step: Any,
        lanes: data.Context,
    ) -> None:
        """The motion: rounds of sweeps, and blocks of bodies before each."""
        bodies, colors = self._body_count, self.colors

        def sweep_on(begin: int, end: int) -> None:
            sweep(begin, end, 0.0, colors.most, colors.moved)

        def sweep_again(begin: int) -> None:
            launch(kernels.stiffen, bodies, [begin, lanes])
            launch(kernels.assemble, bodies, [begin, step, lanes])
            sweep_on(begin, begin + iterations)

        def sweep_cold() -> None:
            sweep_on(int(STRUCK_FACTOR) * iterations, int(COLD_FACTOR) * iterations)

        launch(kernels.assemble, bodies, [0, step, lanes])
        sweep_on(0, iterations)
        for turn in range(1, int(STRUCK_FACTOR)):
            launch(kernels.begin_round, self._world_count, [iterations, turn * iterations, colors])
            self._launch_if(colors.has_more, functools.partial(sweep_again, turn * iterations))
        self._launch_if(colors.is_cold, sweep_cold, is_due=self.may_be_cold)
        self.may_be_cold = False

    def _keep_forces(
        self, launch: Launcher, kernels: SimpleNamespace, effects: Effects, step: Any, views: _Views
    ) -> None:
        """What rows and loops push with, for the next step; islands keep their momentum."""
        bodies, lanes = self._body_count, views.lanes
        launch(kernels.remember, bodies, [step, lanes])
        if effects.second_order:
            launch(kernels.remember_loops, self._loop_count, [lanes])
            launch(kernels.find_jerked, self._cluster_count, [lanes])
        launch(kernels.join_clusters, self._cluster_count, [lanes])
        if effects.islands:
            launch(joining.find_roots, bodies, [lanes])
            launch(joining.count_members, bodies, [lanes])
            self._scan(launch, self.colors.count, bodies, self._islands.body_start)
            launch(joining.list_members, bodies, [views.islands])
            launch(joining.keep_island, bodies, [effects.pairs, views.islands])
        launch(kernels.break_trees, bodies, [step, lanes])
        launch(kernels.break_loops, self._loop_count, [lanes])

    def _end_velocities(
        self,
        launch: Launcher,
        kernels: SimpleNamespace,
        has_impacts: bool,
        step: Any,
        lanes: data.Context,
    ) -> None:
        """Velocities; bodies that bounce leave their impacts."""
        bodies = self._body_count
        launch(kernels.end_velocities, bodies, [step, lanes])
        launch(kernels.align_spins, bodies, [step, lanes])
        if has_impacts:
            launch(kernels.leave_all_impacts, bodies, [lanes])
        launch(kernels.end_armatures, bodies, [step, lanes])
        launch(kernels.end_loop_armatures, self._loop_count, [step, lanes])

    def _recover(
        self,
        launch: Launcher,
        kernels: SimpleNamespace,
        sweep: Callable[..., None],
        effects: Effects,
        step: Any,
        views: _Views,
    ) -> None:
        """Recovery: old errors go, without entering the velocity; then poses."""
        bodies, lanes, colors = self._body_count, views.lanes, self.colors

        def recover(first: int, end: int) -> None:
            sweep(first, end, float(RECOVERY), colors.passes, colors.recovered)

        launch(kernels.end_sweeps, self._world_count, [lanes])
        if effects.second_order:
            launch(kernels.remember_motions, bodies, [lanes])
        launch(kernels.keep_loops, self._loop_count, [lanes])
        if effects.joints or not effects.compliance:
            recover(0, 1)
        if effects.joints:
            passes = int(LOOP_PASSES if effects.closures else JOINT_PASSES)
            self._launch_if(colors.is_apart, lambda: recover(1, passes))
        launch(kernels.close_joints, bodies, [step, lanes])
        if effects.centered:
            launch(joining.center_island, bodies, [step.iterations, views.islands])
        launch(kernels.give_loops_back, self._loop_count, [lanes])
        launch(kernels.give_cables_back, self._cluster_count, [lanes])
        launch(kernels.end_poses, bodies, [step, lanes])
        if effects.turning_islands:
            launch(joining.keep_island_spin, bodies, [step, views.islands])

    def _bound_energy(
        self, launch: Launcher, kernels: SimpleNamespace, step: Any, lanes: data.Context
    ) -> None:
        """Slows islands that did not settle down to the energy that they may have."""
        bodies, lane_count, count = self._body_count, self._lanes, self._world_count
        launch(kernels.measure_moves, lane_count, [lanes])
        launch(kernels.find_unbalanced, count, [lanes])
        launch(kernels.begin_balances, bodies, [lanes])
        launch(kernels.join_bodies, bodies, [bodies, lanes])
        launch(kernels.join_cabled, self._cluster_count, [lanes])
        launch(kernels.add_all_cables, count, [lanes])
        launch(kernels.add_bodies, bodies, [step, lanes])
        launch(kernels.add_runs, lane_count, [lanes])
        launch(kernels.add_lanes, count, [lanes])
        launch(kernels.add_momenta, lane_count, [step, lanes])
        launch(kernels.settle_islands, count, [lanes])
        launch(kernels.slow_bodies, bodies, [step, lanes])
        launch(kernels.slow_all_rotors, bodies, [step, lanes])
        launch(kernels.drop_all_tensions, count, [lanes])

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
