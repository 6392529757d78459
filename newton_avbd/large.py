# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds, all bodies of a color at once: their buffers, and their launches in order."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from . import data
from .effects import Effects
from .execute import coloring, joining, scan
from .execute.colored import make_colored
from .execute.coloring import COLORS, PASSES
from .execute.launch import Launcher
from .execute.world import COLD_FACTOR, COLD_STEPS, LONGER

LARGE = 256
"""Bodies from which a world on a GPU is solved color by color. An estimate, not measured: the
thread that would do it alone is some 30 times as slow as a core of a CPU, which takes 0.3 ms."""

_UNSUPPORTED: dict[str, str] = {
    "joints": "joints other than FREE",
    "loops": "joints other than FREE",
    "restitution": "restitution (effects={'restitution': False} leaves it out)",
    "bdf2": "scheme='bdf2' or 'generalized_alpha'",
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


class LargeWorlds:
    """Buffers of large worlds, and the order of their launches.

    Args:
        worlds: The solver's :class:`.data.WorldWork`.
        iterations: Sweeps of a step.
        device: Where the bodies are.
    """

    def __init__(self, worlds: Any, iterations: int, device: wp.Device) -> None:
        body_start, bodies = worlds.body_start.numpy(), worlds.bodies.numpy()
        self._body_count, self._world_count = bodies.size, body_start.size - 1
        self._device = device
        self._cold = float(COLD_STEPS)
        self._last_dt = 0.0
        slots = bodies.size + 1
        lane_start, world_lane = _lanes(body_start)
        self._lanes = lanes = lane_start.size - 1
        table = (COLORS + 1) * lanes
        # what is random is the same in worlds of the same size
        priority = np.zeros(slots)
        for start, end in pairwise(body_start):
            priority[bodies[start:end]] = np.random.default_rng(0).permutation(end - start)
        # lanes of bodies, with ranks that change with the colors, and islands, as worlds
        self._worlds, self._islands = data.WorldWork(), data.WorldWork()
        for name in worlds._cls.vars:
            setattr(self._worlds, name, getattr(worlds, name))
        self.colors = colors = data.ColorWork()
        with wp.ScopedDevice(device):
            colors.lane_start = wp.array(lane_start, dtype=wp.int32)
            colors.world_lane = wp.array(world_lane, dtype=wp.int32)
            colors.priority = wp.array(priority, dtype=wp.int32)
            colors.count = wp.zeros(slots, dtype=wp.int32)
            colors.incident_start = wp.zeros(slots, dtype=wp.int32)
            colors.color = wp.zeros((2, slots), dtype=wp.int32)
            colors.table = wp.zeros(table, dtype=wp.int32)
            colors.start = wp.zeros(table + 1, dtype=wp.int32)
            colors.order = wp.zeros(slots, dtype=wp.int32)
            colors.sums = wp.zeros(_runs(max(table, slots))[0] + 1, dtype=wp.int32)
            colors.lane_scale = wp.zeros(lanes, dtype=data.WorldScale)
            colors.lane_finite = wp.zeros(lanes, dtype=wp.int32)
            colors.scale = wp.zeros(self._world_count, dtype=data.WorldScale)
            colors.is_finite = wp.zeros(self._world_count, dtype=wp.int32)
            colors.deepest = wp.zeros(self._world_count, dtype=float)
            colors.is_cold = wp.zeros(1, dtype=wp.int32)
            self._worlds.body_start = colors.lane_start
            self._worlds.rank = wp.zeros(slots, dtype=wp.int32)
            self._islands.body_start = wp.zeros(slots, dtype=wp.int32)
            self._islands.bodies = wp.zeros(slots, dtype=wp.int32)
        self._allocate_sweeps(iterations)

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
        # a replay that resets is not seen here: from then on any step may be cold
        self._cold = math.inf if self._device.is_capturing else max(self._cold, float(COLD_STEPS))
        launch(coloring.forget_colors, self._body_count, [body_world, mask, self.colors])

    def found(self) -> tuple[int, int]:
        """How many colors the last step took, and how many bodies found none."""
        sizes = np.diff(self.colors.start.numpy()[:: self._lanes])
        return int(np.count_nonzero(sizes[:COLORS])), int(sizes[COLORS])

    def _may_be_cold(self, dt: float) -> bool:
        """Whether the step may be one of the first after a reset, as far as the host can tell.

        The device knows for certain, and sweeps no more than it has to.
        """
        if dt > LONGER * self._last_dt:
            self._cold = float(COLD_STEPS)
        self._last_dt = dt
        is_cold = self._cold > 0
        self._cold = max(self._cold - 1, 0)
        return is_cold

    def _scan(self, launch: Launcher, counts: wp.array, count: int, starts: wp.array) -> None:
        """Prefix sums of the first ``count`` counts."""
        runs, length = _runs(count)
        sums = self.colors.sums
        launch(scan.sum_runs, runs, [counts, count, length, sums])
        launch(scan.sum_before_runs, 1, [runs, sums])
        launch(scan.sum_before, runs, [counts, count, length, sums, starts])

    def solve(self, launch: Launcher, effects: Effects, arguments: Sequence[Any]) -> None:
        """The step after prediction; takes the arguments of the kernel ``solve`` of a world."""
        (
            model,
            shapes,
            joints,
            control,
            body_q,
            body_qd,
            contacts,
            h,
            iterations,
            tolerance,
            _,
            work,
            rows,
            tree,
            loops,
            islands,
            history,
            body_q_out,
            body_qd_out,
        ) = arguments
        worlds, colors = self._worlds, self.colors
        most = int(COLD_FACTOR) * iterations
        if colors.moved.shape[0] <= most:
            launch.forget()
            self._allocate_sweeps(iterations)
        bodies, lanes, places = self._body_count, self._lanes, contacts.capacity
        kernels = make_colored(effects)

        # Which bodies touch, and in what order they move.
        launch(coloring.clear_counts, bodies, [colors])
        launch(coloring.count_contacts, places, [shapes, contacts, worlds, work, rows, colors])
        self._scan(launch, colors.count, bodies, colors.incident_start)
        launch(coloring.list_contacts, places, [shapes, contacts, work, rows, colors])
        launch(coloring.sort_lists, bodies, [shapes, contacts, work, colors])
        for i in range(PASSES):
            launch(coloring.color_bodies, bodies, [i % 2, int(i == PASSES - 1), colors])
        launch(coloring.count_colors, lanes, [worlds, colors])
        self._scan(launch, colors.table, (COLORS + 1) * lanes, colors.start)
        launch(coloring.list_colors, lanes, [worlds, colors])

        # Rows: linearised at state_in, warm-started from the last step.
        launch(
            kernels.measure_lanes,
            lanes,
            [model, joints, control, h, worlds, work, tree, loops, colors],
        )
        launch(kernels.begin_step, self._world_count, [h, colors, history])
        launch(coloring.count_owned, bodies, [worlds, rows, colors])
        self._scan(launch, colors.count, bodies, rows.owned_start)
        launch(
            kernels.build_rows,
            bodies,
            [model, shapes, body_q, contacts, worlds, work, rows, colors, history],
        )
        launch(kernels.recall_rows, bodies, [shapes, worlds, work, history, rows])
        launch(kernels.penalise, bodies, [shapes, contacts, worlds, work, rows, history, colors])
        launch(
            kernels.assemble,
            bodies,
            [model, joints, control, h, worlds, rows, tree, loops, history, work, islands],
        )

        threads = -(-bodies // _SHARE)
        state = [worlds, work, rows, tree, loops, colors, history]

        def sweep(first: int, end: int) -> None:
            for sweep in range(first, end):
                for color in range(COLORS + 1):
                    count = threads if color < COLORS else 1
                    numbers = [sweep, color, count, iterations, tolerance]
                    launch(kernels.sweep_color, count, [model, joints, control, *numbers, *state])

        sweep(0, iterations)
        if self._device.is_cpu or (
            self._device.is_capturing and wp.is_conditional_graph_supported()
        ):
            wp.capture_if(colors.is_cold, lambda: sweep(iterations, most))
        elif self._device.is_capturing or self._may_be_cold(h):
            sweep(iterations, most)
        launch(kernels.remember, bodies, [body_qd, worlds, work, rows, islands, colors, history])
        launch(joining.find_roots, bodies, [work, rows, islands, colors])
        launch(joining.count_members, bodies, [work, rows, islands, colors])
        self._scan(launch, colors.count, bodies, self._islands.body_start)
        launch(joining.list_members, bodies, [work, rows, islands, self._islands, colors])
        launch(joining.keep_island, bodies, [model, self._islands, islands, work])
        launch(
            kernels.end_velocities,
            bodies,
            [model, body_q, body_qd, h, worlds, work, rows, islands, colors, history, body_qd_out],
        )

        # Recovery: old errors go, without entering the velocity.
        if not effects.compliance:
            for color in range(COLORS + 1):
                count = threads if color < COLORS else 1
                launch(kernels.recover_color, count, [model, joints, control, color, count, *state])
        launch(
            kernels.end_poses,
            bodies,
            [model, body_q, work, rows, islands, colors, worlds, history, body_q_out],
        )
        if effects.gyroscopic:
            launch(
                joining.keep_island_spin,
                bodies,
                [model, h, body_q_out, self._islands, work, islands, body_qd_out],
            )


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


def _runs(count: int) -> tuple[int, int]:
    """Into how many runs of which length prefix sums divide counts."""
    length = max(1, math.isqrt(count))
    return -(-count // length), length
