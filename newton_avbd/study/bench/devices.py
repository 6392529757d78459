# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The same scenes on a CPU and on a GPU: how far apart they end.

Run as ``python -m newton_avbd.study.bench.devices [CASE ...]`` where there is a GPU. Each case runs
in a process of its own, since most of the time is the compilers'. On the GPU the steps are replayed
from a graph, so that the time of a step is the GPU's.
"""

import argparse
import multiprocessing
import signal
import sys
import time
import traceback
from dataclasses import dataclass
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.io.output import table
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.scenes.named import SCENES
from newton_avbd.study.bench.large import LARGE_SCENES
from newton_avbd.study.bench.run import chosen

STEPS = 60
"""Steps of each case; even, since a graph has two."""


@dataclass(frozen=True)
class Case:
    """A scene with settings of the solver."""

    scene: str
    """Name in ``SCENES``, or in ``LARGE_SCENES`` with a number of bodies."""
    settings: dict[str, Any]
    bodies: int | None = None

    def build(self, builder: newton.ModelBuilder) -> None:
        """Puts the scene into an empty builder."""
        if self.bodies is None:
            SCENES[self.scene].build(builder)
        else:
            LARGE_SCENES[self.scene][1](builder, self.bodies)


def _cases() -> dict[str, Case]:
    alone = (
        "fall",
        "stack",
        "pyramid",
        "incline",
        "domino",
        "card_house",
        "top",
        "free_bodies",
        "chain",
        "chain_100",
        "rope",
        "cartpole",
        "ant",
        "humanoid",
        "quadruped",
        "ant_usd",
        "humanoid_usd",
        "fourbar",
        "pyramid_worlds",
    )
    cases = {name: Case(name, {"parallel": "worlds"}) for name in alone}
    by_color = ("stack", "pyramid", "chain", "quadruped", "ant", "fourbar", "rope")
    cases |= {f"{name}/bodies": Case(name, {"parallel": "bodies"}) for name in by_color}
    cases |= {
        f"{name}/bodies": Case(name, {"parallel": "bodies"}, bodies=300)
        for name in ("ring", "ragdolls", "net")
    }
    cases["pyramid/sleeping"] = Case("pyramid", {"parallel": "worlds", "sleeping": True})
    for name in ("quadruped", "pyramid"):
        cases[f"{name}/euler"] = Case(name, {"parallel": "worlds", "scheme": "euler"})
    cases["stack/ramp"] = Case("stack", {"formulation": "ramp"})
    return cases


CASES = _cases()


@dataclass(frozen=True)
class Run:
    """What a device made of a case.

    Attributes:
        body_q: Poses at the end, shape [bodies, 7].
        body_qd: Velocities at the end, shape [bodies, 6].
        first: Time of the first step, compilation included [s].
        step: Mean time of a step with its collision detection [ms].
        sweeps: Most sweeps of a world in the last step.
    """

    body_q: np.ndarray
    body_qd: np.ndarray
    first: float
    step: float
    sweeps: int


def run(case: Case, device: str) -> Run:
    """Simulate a case on a device."""
    with wp.ScopedDevice(device):
        builder = newton.ModelBuilder()
        case.build(builder)
        model = builder.finalize()
        pipeline = newton.CollisionPipeline(model, broad_phase="sap", deterministic=True)
        contacts = pipeline.contacts() if model.shape_contact_pair_count else None
        solver = SolverAVBD(model, iterations=10, **case.settings)
        states = [model.state(), model.state()]

        def two_steps() -> None:
            for _ in range(2):
                if contacts is not None:
                    pipeline.collide(states[0], contacts)
                solver.step(states[0], states[1], None, contacts, 1.0 / 240.0)
                states.reverse()

        begin = time.perf_counter()
        two_steps()
        wp.synchronize()
        first = time.perf_counter() - begin
        with wp.ScopedCapture() as capture:
            two_steps()
        wp.synchronize()
        begin = time.perf_counter()
        for _ in range(STEPS // 2 - 1):
            wp.capture_launch(capture.graph)
        wp.synchronize()
        step = 1e3 * (time.perf_counter() - begin) / (STEPS - 2)
        sweeps = solver.report().sweeps
        body_q, body_qd = states[0].body_q.numpy(), states[0].body_qd.numpy()
        return Run(body_q, body_qd, first, step, int(np.max(sweeps)))


def _row(name: str) -> list[str]:
    """Runs a case on both devices; a row of the table."""
    try:
        on_cpu, on_gpu = run(CASES[name], "cpu"), run(CASES[name], "cuda:0")
    except Exception as error:  # what keeps one case must not keep the others
        traceback.print_exc()
        return [name, f"{type(error).__name__}: {error}"[:150], *[""] * 6]
    apart = np.linalg.norm(on_cpu.body_q[:, :3] - on_gpu.body_q[:, :3], axis=1).max()
    faster = np.abs(on_cpu.body_qd - on_gpu.body_qd).max()
    return [
        name,
        f"{1e3 * apart:.2g}",
        f"{faster:.2g}",
        f"{on_cpu.sweeps}, {on_gpu.sweeps}",
        f"{on_cpu.first:.1f}",
        f"{on_gpu.first:.1f}",
        f"{on_cpu.step:.3f}",
        f"{on_gpu.step:.3f}",
    ]


def main() -> int:
    """Compare devices and print a table; 0, or 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.prog = "python -m newton_avbd.study.bench.devices"
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}")
    parser.add_argument("--processes", type=int, default=1, help="cases at once (default: 1)")
    args = parser.parse_args()
    rows = [["case", "apart mm", "velocities m/s", "sweeps", "first CPU s", "first GPU s"]]
    rows[0] += ["step CPU ms", "step GPU ms"]
    names = chosen("case", args.cases, tuple(CASES))
    pool = multiprocessing.get_context("spawn").Pool(
        args.processes, signal.signal, (signal.SIGINT, signal.SIG_IGN), maxtasksperchild=1
    )
    with interruptible() as interruption, pool:
        found = pool.imap_unordered(_row, names, chunksize=1)
        for row in progress(found, len(names), "cases"):
            rows.append(row)
            say("  ".join(row))
    print(table(rows))
    return interruption.status(0)


if __name__ == "__main__":
    sys.exit(main())
