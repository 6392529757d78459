# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What bodies cost asleep and awake: ``python -m newton_avbd.study.bench.sleeping``.

Towers of five cubes with four contacts each stand on the ground, at rest all the time: awake
until half a second is over, and asleep from then on.
"""

import argparse
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import newton
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.scenes.named import add_ground

DT = 1.0 / 240.0
CUBES = 5
"""Cubes of a tower."""
SETTLING = 40
"""Steps after which towers take one sweep each."""
FALLING_ASLEEP = 160
"""Steps after which they sleep: half a second and what they settle in."""
ROUNDS = 10
"""Times that they are woken."""


class Cost(NamedTuple):
    """Processor time of a step by body [ns]: the median of all steps, and the least."""

    median: float
    least: float


def measure(towers: int, *, sleeping: bool) -> list[Cost]:
    """Simulate towers, replayed from a graph.

    Args:
        towers: Their number.
        sleeping: Whether they may sleep.

    Returns:
        The cost awake and at rest and, where they may sleep, asleep.
    """
    builder = newton.ModelBuilder()
    add_ground(builder)
    for tower in range(towers):
        for level in range(CUBES):
            body = builder.add_body(xform=wp.transform((3.0 * tower, 0.0, 0.25 + 0.5 * level)))
            builder.add_shape_box(body, hx=0.25, hy=0.25, hz=0.25)
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, sleeping=sleeping)
    state, following = model.state(), model.state()
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    solver.step(state, following, None, contacts, DT)
    with wp.ScopedCapture("cpu") as capture:
        solver.step(state, following, None, contacts, DT)
        solver.step(following, state, None, contacts, DT)

    def two_steps() -> None:
        wp.capture_launch(capture.graph)

    awake: list[float] = []
    asleep: list[float] = []
    for _ in range(ROUNDS):
        solver.reset(state)
        _time(two_steps, SETTLING)
        awake += _time(two_steps, SETTLING)
        if sleeping:
            _time(two_steps, FALLING_ASLEEP - 2 * SETTLING)
            if solver.status.sleeping_bodies != model.body_count:
                raise RuntimeError("not all cubes sleep")
            asleep += _time(two_steps, FALLING_ASLEEP)
        elif np.any(solver.report().sweeps > 1):
            raise RuntimeError("the towers do not rest")
    per_body = [np.array(times) / model.body_count for times in (awake, asleep) if times]
    return [Cost(float(np.median(times)), float(np.min(times))) for times in per_body]


def _time(two_steps: Callable[[], None], steps: int) -> list[float]:
    """Processor time of each of so many steps [ns]."""
    spent = []
    for _ in range(steps // 2):
        start = time.process_time_ns()
        two_steps()
        spent.append((time.process_time_ns() - start) / 2)
    return spent


def table() -> int:
    """Print the costs for some numbers of cubes, as Markdown; 0, or 130 after Ctrl-C."""
    print("| cubes | awake, sleeping off [ns a cube] | awake | asleep | asleep / awake |")
    print("| --- | --- | --- | --- | --- |")
    sizes = (40, 200, 1000)
    with interruptible() as interruption:
        for towers in progress(sizes, len(sizes), "scenes"):
            (off,) = measure(towers, sleeping=False)
            awake, asleep = measure(towers, sleeping=True)
            say(
                f"| {CUBES * towers} | {off.median:.0f} | {awake.median:.0f} | "
                f"{asleep.median:.1f} | {asleep.median / awake.median:.2%} "
                f"(least: {asleep.least / awake.least:.2%}) |"
            )
    return interruption.status(0)


if __name__ == "__main__":
    argparse.ArgumentParser(prog="python -m newton_avbd.study.bench.sleeping").parse_args()
    wp.config.log_level = wp.LOG_WARNING
    sys.exit(table())
