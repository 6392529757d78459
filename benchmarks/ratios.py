# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Benchmarks for asv: a step of SolverAVBD beside bare ``mj_step``.

A time depends on the machine and on what else runs on it. The ratio of two that are measured in
turns depends on neither, so far.
"""

from newton_avbd.io.terminal import start_warp
from newton_avbd.study.bench.run import BENCHMARKS, Effort, compete, pinned
from newton_avbd.study.mujoco.native import silence
from newton_avbd.study.peers import MJ_STEP

SCENES = [
    name
    for name, benchmark in BENCHMARKS.items()
    if MJ_STEP in benchmark.solvers and not name.endswith("_worlds")
]
"""Scenes of one world that the peer runs, too. Batches take minutes each."""

EFFORT = Effort(repeats=7, turn=0.02, budget=2.0, cold_starts=0)


def ratio(scene: str) -> float:
    """Time of a step of SolverAVBD, replayed from a graph, in steps of ``mj_step``.

    Args:
        scene: One of :data:`SCENES`.

    Raises:
        RuntimeError: One of the two cannot run the scene.
    """
    start_warp()
    silence()
    with pinned():
        ours, peer = compete(BENCHMARKS[scene], ["avbd", MJ_STEP], EFFORT)
    for result in (ours, peer):
        if result.quality is None:
            raise RuntimeError(f"{result.solver} on {scene}: {result.note}")
    return ours.replayed / peer.replayed


class Replayed:
    """A step, replayed."""

    params = SCENES
    param_names = ("scene",)
    timeout = 300.0
    unit = "mj_steps"

    def track_replayed(self, scene: str) -> float:
        return ratio(scene)
