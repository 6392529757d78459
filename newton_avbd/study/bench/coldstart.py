# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Cold start: how long a scene with contacts takes to its first step with no kernels compiled.

Every measurement is a process of its own with a kernel cache that holds only what building the
scene and detecting its collisions needs; that part is Newton's and the same for every solver.

Run as ``python -m newton_avbd.study.bench.coldstart SOLVER SCENE`` it is that process.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import newton
import warp as wp

from newton_avbd.io.terminal import progress
from newton_avbd.scenes.named import SCENES
from newton_avbd.study.peers import PEERS

NO_SOLVER = "none"
"""Given as SOLVER: build the scene and detect its collisions, no more."""


def cold_start(solvers: list[str], scene: str, repeats: int) -> dict[str, list[float]]:
    """Measure the cold start of several solvers, in turns.

    Args:
        solvers: Names in :data:`PEERS`.
        scene: Name in :data:`SCENES`.
        repeats: Measurements of each.

    Returns:
        CPU times from a model to the end of the first step [s], by solver.
    """
    times: dict[str, list[float]] = {solver: [] for solver in solvers}
    with tempfile.TemporaryDirectory() as folder:
        collision = Path(folder, "collision")
        _in_new_process(NO_SOLVER, scene, collision)
        turns = [(solver, repeat) for repeat in range(repeats) for solver in solvers]
        for solver, repeat in progress(turns, len(turns), "cold starts", lambda turn: turn[0]):
            cache = Path(folder, f"{solver}{repeat}")
            shutil.copytree(collision, cache)
            times[solver].append(_in_new_process(solver, scene, cache))
    return times


def first_step(solver: str, scene: str) -> float:
    """Construct a solver and make a first step; return the CPU time of both [s]."""
    peer = PEERS.get(solver, PEERS["xpbd"])
    model = peer.model(SCENES[scene])
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state_in, state_out, control = model.state(), model.state(), model.control()
    pipeline.collide(state_in, contacts)
    begin = time.process_time()
    if solver != NO_SOLVER:
        peer.make(model).step(state_in, state_out, control, contacts, SCENES[scene].dt)
    return time.process_time() - begin


def _in_new_process(solver: str, scene: str, cache: Path) -> float:
    """Run :func:`first_step` in a new process with the kernel cache ``cache``."""
    cache.mkdir(exist_ok=True)
    result = subprocess.run(
        [sys.executable, "-m", "newton_avbd.study.bench.coldstart", solver, scene],
        env={**os.environ, "WARP_CACHE_PATH": str(cache)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return float(json.loads(result.stdout.splitlines()[-1]))


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_WARNING
    print(json.dumps(first_step(sys.argv[1], sys.argv[2])))
