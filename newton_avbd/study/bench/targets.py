# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What the benchmark finds, and the targets that it is held against."""

import math
from dataclasses import dataclass

from newton_avbd.scenes.robots import SINGLE_ROBOTS
from newton_avbd.study.contestants import Quality
from newton_avbd.study.peers import MJ_STEP

COLD_START = "cold_start"
"""Stands for a scene where the first step with an empty kernel cache is meant."""

EVERY_PEER = "every peer"
"""Stands for a solver where the fastest of all others is meant that hold contacts rigid; the
explicit penalty solvers (``UNHELD``) are shown beside them."""

NEWTON_PEER = "every peer in Newton"
"""Stands for the same without MuJoCo's bare ``mj_step``."""

UNHELD = frozenset({"semi_implicit", "featherstone"})

_NO_PEER = UNHELD | {"avbd"}


@dataclass(frozen=True)
class Result:
    """What one solver did on one scene.

    Attributes:
        scene: Name of the scene.
        solver: Name of the solver.
        eager: CPU time of a plain step [s]; NaN where there is none.
        replayed: CPU time of a step replayed from a graph [s]; NaN where there is none.
        collided: The same with collision detection in it; NaN also where nothing can collide.
        quality: How well it did; None where it did not run, or only time was measured.
        note: What a reader must know, or nothing.
    """

    scene: str
    solver: str
    eager: float = math.nan
    replayed: float = math.nan
    collided: float = math.nan
    quality: Quality | None = None
    note: str = ""


@dataclass(frozen=True)
class Target:
    """An upper bound that SolverAVBD has to keep.

    Attributes:
        scene: Name of the scene.
        quantity: A time of :class:`Result`, or an attribute of :class:`Quality` or of its joints.
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
        if self.against in (EVERY_PEER, NEWTON_PEER):
            solvers = {result.solver for result in results} - _NO_PEER
        if self.against == NEWTON_PEER:
            solvers.discard(MJ_STEP)
        values = [self._value(results, solver) for solver in sorted(solvers)]
        theirs = [value for value in values if value is not None]
        if not theirs:
            return None
        return ours / min(theirs)

    def _value(self, results: list[Result], solver: str) -> float | None:
        for result in results:
            if (result.scene, result.solver) == (self.scene, solver):
                if hasattr(result, self.quantity):
                    # A time that does not exist is NaN; a quality that is NaN is a failure.
                    time = getattr(result, self.quantity)
                    return None if math.isnan(time) else time
                return result.quality.value(self.quantity) if result.quality else None
        return None


REST = 1e-3
"""Speed below which a pile is at rest [m/s]."""

LIMIT = 1e-2
"""Violation up to which a joint limit counts as held, half a degree [rad], or 1 cm [m]."""

BLOWN_UP = 10.0
"""Speed above which a robot that fell from a meter or so has blown up [m/s]."""


def _chain(scene: str) -> tuple[Target, ...]:
    return (
        Target(scene, "eager", 1 / 40, "vbd"),
        Target(scene, "eager", 1 / 5, "mujoco"),
        Target(scene, "replayed", 1 / 6, "vbd"),
        Target(scene, "replayed", 1.0, "xpbd"),
        Target(scene, "replayed", 1.0, "steel"),
        Target(scene, "replayed", 2.0, MJ_STEP),
        Target(scene, "separation", 1e-5),
        # Nothing drives it: energy that it gains is the beginning of a blow-up.
        Target(scene, "gain", 1e-2),
    )


def _rope(scene: str) -> tuple[Target, ...]:
    return (
        Target(scene, "replayed", 1 / 8, "vbd"),
        Target(scene, "replayed", 1 / 3, "xpbd"),
        Target(scene, "separation", 1e-4),
    )


def _held(scene: str) -> tuple[Target, ...]:
    return (
        Target(scene, "speed", BLOWN_UP),
        Target(scene, "separation", 1e-4),
        Target(scene, "limit", LIMIT),
    )


def _robot(scene: str) -> tuple[Target, ...]:
    return (
        Target(scene, "eager", 1 / 40, "vbd"),
        Target(scene, "eager", 1 / 4, "mujoco"),
        Target(scene, "replayed", 1 / 3, "vbd"),
        Target(scene, "replayed", 1.0, NEWTON_PEER),
        Target(scene, "replayed", 2.0, MJ_STEP),
        *_held(scene),
        *_held(f"{scene}_60hz"),
    )


def _collided(scene: str) -> tuple[Target, ...]:
    return (Target(scene, "collided", 1 / 3, "vbd"), Target(scene, "collided", 1.0, NEWTON_PEER))


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
    *(target for scene in ("chain", "chain_100", "chain_10000") for target in _chain(scene)),
    *(target for scene in ("rope", "rope_100000") for target in _rope(scene)),
    *(target for scene in SINGLE_ROBOTS for target in _robot(scene)),
    # The cartpole meets nothing.
    *(target for scene in SINGLE_ROBOTS if scene != "cartpole" for target in _collided(scene)),
    Target("ant_worlds", "replayed", 1 / 5, "vbd"),
    Target("ant_worlds", "replayed", 1.0, "mujoco_warp"),
    Target("ant_worlds", "apart", 0.0),
    Target(COLD_START, "eager", 1 / 5, "vbd"),
)
"""What the solver must reach."""
