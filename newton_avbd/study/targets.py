# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What the benchmark finds, and the targets that it is held against."""

import math
from dataclasses import dataclass

from newton_avbd.study.contestants import Quality

COLD_START = "cold_start"
"""Stands for a scene where the first step with an empty kernel cache is meant."""

EVERY_PEER = "every peer"
"""Stands for a solver where the fastest of all others is meant that hold contacts rigid; the
explicit penalty solvers (``UNHELD``) are shown beside them."""

UNHELD = frozenset({"semi_implicit", "featherstone"})


@dataclass(frozen=True)
class Result:
    """What one solver did on one scene.

    Attributes:
        scene: Name of the scene.
        solver: Name of the solver.
        eager: CPU time of a plain step [s]; NaN where there is none.
        replayed: CPU time of a step replayed from a graph [s]; NaN where there is none.
        quality: How well it did; None where it did not run, or only time was measured.
        note: What a reader must know, or nothing.
    """

    scene: str
    solver: str
    eager: float = math.nan
    replayed: float = math.nan
    quality: Quality | None = None
    note: str = ""


@dataclass(frozen=True)
class Target:
    """An upper bound that SolverAVBD has to keep.

    Attributes:
        scene: Name of the scene.
        quantity: ``eager`` or ``replayed``, or an attribute of :class:`Quality`.
        bound: Largest value; of the time of ``against`` where that is given, else in SI units.
        against: Solver to compare with.
    """

    scene: str
    quantity: str
    bound: float
    against: str | None = None

    def reached(self, results: list[Result]) -> float | None:
        """What SolverAVBD reached, in the units of ``bound``; None where it was not measured."""
        ours = self._value(results, "avbd")
        if self.against is None or ours is None:
            return ours
        solvers = {self.against}
        if self.against == EVERY_PEER:
            solvers = {result.solver for result in results} - {"avbd"} - UNHELD
        values = [self._value(results, solver) for solver in sorted(solvers)]
        theirs = [value for value in values if value is not None]
        return ours / min(theirs) if theirs else None

    def _value(self, results: list[Result], solver: str) -> float | None:
        for result in results:
            if (result.scene, result.solver) == (self.scene, solver):
                source = result if hasattr(result, self.quantity) else result.quality
                value = getattr(source, self.quantity, None)
                # A time that does not exist is NaN; a quality that is NaN is a failure.
                missing = source is result and value is not None and math.isnan(value)
                return None if missing else value
        return None


REST = 1e-3
"""Speed below which a pile is at rest [m/s]."""

TARGETS: tuple[Target, ...] = (
    Target("pyramid", "eager", 1 / 10, "vbd"),
    Target("pyramid", "eager", 1 / 4, "mujoco"),
    Target("pyramid", "replayed", 1 / 2, "vbd"),
    Target("pyramid", "replayed", 1 / 2.5, "mj_step"),
    Target("pyramid", "penetration", 0.05e-3),
    Target("pyramid", "drift", 1e-3),
    Target("pyramid", "speed", REST),
    Target("stack", "eager", 1 / 20, "vbd"),
    Target("stack", "replayed", 1 / 3, "vbd"),
    Target("stack", "replayed", 1 / 2, "xpbd"),
    Target("stack", "penetration", 0.1e-3),
    # It stands while no box has moved by more than its penetrations, 20 of 0.1 mm, explain.
    Target("stack", "drift", 2e-3),
    Target("pyramid_worlds", "eager", 1 / 12, "vbd"),
    Target("pyramid_worlds", "replayed", 1 / 5, "vbd"),
    Target("pyramid_worlds", "penetration", 0.05e-3),
    Target("pyramid_worlds", "drift", 1e-3),
    Target("pyramid_worlds", "speed", REST),
    Target("free_bodies", "replayed", 1 / 5, EVERY_PEER),
    # Poses rounded to float32 up to 8 m from the origin: half a unit in the last place, each of
    # 480 steps, on each axis.
    Target("free_bodies", "drift", 480 * 2.4e-7 * math.sqrt(3.0)),
    Target("free_bodies", "momentum", 1e-3),
    Target(COLD_START, "eager", 1 / 5, "vbd"),
)
"""What the solver must reach."""
