# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Time spent in a solver and in collision detection, told apart."""

import time
from statistics import median
from typing import Any

import warp as wp


class StepTimer:
    """Times every solver step and every collision detection of a run.

    Calls that a graph capture records are not timed: they do not run. On CUDA a timed call waits
    for the device at its end.

    Attributes:
        solver: Seconds of each solver step, collision detection inside it taken out.
        collision: Seconds of each collision detection.
    """

    def __init__(self) -> None:
        self.solver: list[float] = []
        self.collision: list[float] = []

    def watch_solver(self, solver: Any) -> None:
        """Time ``solver.step`` from now on."""
        self._watch(solver, "step", self.solver)

    def watch_pipeline(self, pipeline: Any) -> None:
        """Time ``pipeline.collide`` from now on."""
        self._watch(pipeline, "collide", self.collision)

    def milliseconds_per_step(self) -> tuple[float, float]:
        """Time of a step in the solver and in collision detection [ms].

        The solver's is the median. Collision detection may run less often than the solver steps:
        its median is scaled by how often it ran. The first call of each, which loads kernels,
        does not count.
        """
        solver, collision = self.solver[1:] or self.solver, self.collision[1:] or self.collision
        if not solver:
            return 0.0, 0.0
        share = len(collision) / len(solver)
        return 1e3 * median(solver), 1e3 * share * median(collision) if collision else 0.0

    def _watch(self, target: Any, method: str, seconds: list[float]) -> None:
        call = getattr(target, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            device = wp.get_device()
            if device.is_capturing:
                return call(*args, **kwargs)
            inner = len(self.collision)
            start = time.perf_counter()
            result = call(*args, **kwargs)
            wp.synchronize_device(device)
            elapsed = time.perf_counter() - start
            if seconds is self.solver:
                elapsed -= sum(self.collision[inner:])
            seconds.append(elapsed)
            return result

        setattr(target, method, timed)
