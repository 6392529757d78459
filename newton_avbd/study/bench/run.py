# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd bench``: SolverAVBD beside Newton's solvers and MuJoCo, time and quality.

Everything runs on one core of the CPU in one process, the solvers taking turns, each from the
state in which its own run ended. Two times are reported, both without collision detection:
*eager*, plain ``step`` calls, most of which is the cost of launches from Python; and *replayed*,
steps captured in a graph, or for MuJoCo a bare ``mj_step``, which tells solvers apart.
"""

import argparse
import math
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from statistics import median

import numpy as np

from newton_avbd.io.errors import unknown
from newton_avbd.io.options import check_writable
from newton_avbd.io.output import tables_beside, write_json
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.scenes.named import SCENES
from newton_avbd.scenes.robots import SINGLE_ROBOTS
from newton_avbd.study.bench import report
from newton_avbd.study.bench.coldstart import cold_start
from newton_avbd.study.bench.targets import COLD_START, Result
from newton_avbd.study.contestants import Contestant, NewtonContestant
from newton_avbd.study.mujoco.native import MujocoContestant, silence
from newton_avbd.study.peers import MJ_STEP, PEERS

COLD_START_SCENE = "stack"
COLD_START_SOLVERS = ("avbd", "vbd", "xpbd")


@dataclass(frozen=True)
class Benchmark:
    """A scene to measure on.

    Attributes:
        scene: Name of the scene.
        seconds: Time to simulate for quality [s].
        solvers: Solvers to measure.
        dt: Solver step where it is not the scene's own [s].
        alone: Scene of a single world of this one, where worlds are to be compared with it.
    """

    scene: str
    seconds: float
    solvers: tuple[str, ...]
    dt: float | None = None
    alone: str | None = None

    @property
    def name(self) -> str:
        """What results call it: the scene, and the steps a second where they are not its own."""
        return self.scene if self.dt is None else f"{self.scene}_{1.0 / self.dt:.0f}hz"

    def contestant(self, solver: str, *, alone: bool = False) -> Contestant:
        """Set ``solver`` up on the scene, or on a single world of it."""
        scene = SCENES[self.alone if alone and self.alone else self.scene]
        scene = scene if self.dt is None else replace(scene, dt=self.dt)
        if solver == MJ_STEP:
            return MujocoContestant(scene)
        return NewtonContestant(scene, PEERS[solver])


_RIGID = ("avbd", "vbd", "xpbd", "mujoco", MJ_STEP, "mujoco_warp", "steel", "kamino")
_PENALTY = ("semi_implicit", "featherstone")
# Worth watching at a large step.
_COARSE = ("avbd", "vbd", "xpbd", "mujoco")
_BATCH = ("avbd", "xpbd", MJ_STEP, "mujoco_warp")
_CHAINS = ("chain", "chain_100", "chain_10000")
_ROPES = ("rope", "rope_100000")

BENCHMARKS: dict[str, Benchmark] = {
    benchmark.name: benchmark
    for benchmark in (
        # The explicit penalty solvers cannot hold piles of boxes up at these time steps.
        Benchmark("pyramid", 2.0, _RIGID),
        Benchmark("stack", 10.0, _RIGID),
        # SolverMuJoCo's C backend has no worlds; Kamino takes seconds a step.
        Benchmark("pyramid_worlds", 2.0, ("avbd", "vbd", "xpbd", MJ_STEP, "mujoco_warp", "steel")),
        Benchmark("free_bodies", 2.0, (*_RIGID, *_PENALTY)),
        *(Benchmark(scene, 10.0, _RIGID) for scene in _CHAINS),
        *(Benchmark(scene, 5.0, _RIGID) for scene in _ROPES),
        *(Benchmark(scene, 5.0, _RIGID) for scene in SINGLE_ROBOTS),
        *(Benchmark(scene, 5.0, _COARSE, dt=1.0 / 60.0) for scene in SINGLE_ROBOTS),
        Benchmark(
            "ant_worlds", 1.0, ("avbd", "vbd", "xpbd", MJ_STEP, "mujoco_warp", "steel"), alone="ant"
        ),
        # The time in which they fall and land is short, and timing goes on in it.
        *(Benchmark(scene, 0.4, _BATCH) for scene in ("humanoid_worlds", "quadruped_worlds")),
    )
}
"""What is measured, by name."""


@dataclass(frozen=True)
class Effort:
    """How much time to spend.

    Attributes:
        repeats: Turns of each solver.
        turn: CPU time of a turn, for each of the three ways of timing [s].
        budget: Wall-clock time after which a run for quality stops early [s].
        cold_starts: Cold starts of each solver.
        left_out: Solvers that take too long.
    """

    repeats: int
    turn: float
    budget: float
    cold_starts: int
    left_out: tuple[str, ...] = ()


FULL = Effort(repeats=7, turn=0.1, budget=30.0, cold_starts=3)
QUICK = Effort(repeats=3, turn=0.02, budget=1.0, cold_starts=0, left_out=("kamino",))


def catalog() -> dict[str, dict[str, str]]:
    """The scenes that are measured, and what they are."""
    return {
        "scenes": {
            name: SCENES[found.scene].summary
            + ("" if found.dt is None else f", {1.0 / found.dt:.0f} steps a second")
            for name, found in BENCHMARKS.items()
        }
    }


def main(args: argparse.Namespace) -> int:
    """Run the benchmark.

    Returns:
        Exit status: 0, whether targets are met or not; 130 after Ctrl-C.

    Raises:
        UserError: A scene or solver does not exist.
    """
    effort = QUICK if args.quick else FULL
    scenes = chosen("benchmark scene", args.scenes, tuple(BENCHMARKS))
    solvers = chosen("solver", args.solvers or [], (*PEERS, MJ_STEP))
    check_writable(args.json)
    silence()
    with tables_beside(args.json), pinned() as core:
        machine = describe_machine(core)
        print("\n".join(f"{name}: {value}" for name, value in machine.items()), end="\n\n")
        results = []
        with interruptible() as interruption:
            for scene in progress(scenes, len(scenes), "scenes", str):
                benchmark = BENCHMARKS[scene]
                found = compete(benchmark, [s for s in benchmark.solvers if s in solvers], effort)
                say(f"{report.scene_table(scene, found)}\n")
                results += found
            if effort.cold_starts:
                cold = [solver for solver in COLD_START_SOLVERS if solver in solvers]
                found = start_cold(cold, effort.cold_starts)
                print(report.cold_start_table(found), end="\n\n")
                results += found
        print(report.target_table(results))
    if args.json is not None:
        write_json(args.json, report.as_json(machine, results))
    return interruption.status(0)


def compete(benchmark: Benchmark, solvers: list[str], effort: Effort) -> list[Result]:
    """Let solvers run on one scene, then time them in turns.

    Args:
        benchmark: The scene and how long to simulate it.
        solvers: Names of the solvers.
        effort: How much time to spend.

    Returns:
        A result for each solver, in their order; one that cannot run says why in its note.
    """
    results: dict[str, Result] = {}
    contestants: dict[str, Contestant] = {}
    for solver in solvers:
        result = Result(benchmark.name, solver)
        if solver in effort.left_out:
            results[solver] = replace(result, note="left out to save time")
            continue
        try:
            contestant = benchmark.contestant(solver)
            quality = contestant.run(benchmark.seconds, effort.budget)
            if benchmark.alone:
                alone = benchmark.contestant(solver, alone=True)
                alone.run(quality.seconds, math.inf)
                quality = replace(quality, apart=_apart(contestant, alone))
        except Exception as error:
            # Whatever keeps one solver from running must not keep the others from it.
            results[solver] = replace(result, note=f"{type(error).__name__}: {error}")
            continue
        contestants[solver] = contestant
        stopped = quality.seconds < 0.999 * benchmark.seconds
        note = f"stopped after {quality.seconds:.2f} s of simulated time" if stopped else ""
        results[solver] = replace(result, quality=quality, note=note)
    eager: dict[str, list[float]] = {solver: [] for solver in contestants}
    replayed: dict[str, list[float]] = {solver: [] for solver in contestants}
    collided: dict[str, list[float]] = {solver: [] for solver in contestants}
    for _ in range(effort.repeats):
        for solver, contestant in contestants.items():
            eager[solver].append(contestant.eager(effort.turn))
            replayed[solver].append(contestant.replayed(effort.turn))
            collided[solver].append(contestant.collided(effort.turn))
    for solver in contestants:
        results[solver] = replace(
            results[solver],
            # A bare mj_step is no call of Newton's: it stands beside the replayed steps only.
            eager=math.nan if solver == MJ_STEP else median(eager[solver]),
            replayed=median(replayed[solver]),
            collided=median(collided[solver]),
        )
    return [results[solver] for solver in solvers]


def start_cold(solvers: list[str], repeats: int) -> list[Result]:
    """Measure the first step with an empty kernel cache, as medians of ``repeats``."""
    times = cold_start(solvers, COLD_START_SCENE, repeats)
    return [Result(COLD_START, solver, eager=median(times[solver])) for solver in solvers]


def describe_machine(core: int | None) -> dict[str, str]:
    """What the numbers were measured on and with, by name."""
    versions = {}
    for package in ("newton-avbd", "newton", "warp-lang", "mujoco", "mujoco-warp", "numpy"):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "processor": f"{_processor()}, {os.cpu_count()} cores",
        "pinned": "no" if core is None else f"to core {core}",
        "system": platform.platform(),
        "python": platform.python_version(),
        **versions,
    }


def _apart(worlds: Contestant, alone: Contestant) -> float:
    """Largest distance of a body in any of the worlds from where it is alone [m]."""
    centers = alone.centers()
    offset = worlds.centers().reshape(-1, *centers.shape) - centers
    return float(np.max(np.linalg.norm(offset, axis=2)))


def chosen(kind: str, names: list[str], known: tuple[str, ...]) -> tuple[str, ...]:
    """The names asked for, in the order of ``known``; all of them when none was.

    Raises:
        UserError: One of them is not known.
    """
    for name in names:
        if name not in known:
            raise unknown(kind, name, known)
    return tuple(name for name in known if name in names or not names)


@contextmanager
def pinned() -> Iterator[int | None]:
    """Pin this process to a core; yield which, or None where the system has no such call."""
    if not hasattr(os, "sched_setaffinity"):
        yield None
        return
    cores = os.sched_getaffinity(0)
    # Not the first core, on which systems tend to do their own work.
    core = max(cores)
    os.sched_setaffinity(0, {core})
    try:
        yield core
    finally:
        os.sched_setaffinity(0, cores)


def _processor() -> str:
    """Name of the processor."""
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
