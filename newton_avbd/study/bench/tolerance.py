# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What ``tolerance`` saves in a batch of easy and hard worlds: ``python -m
newton_avbd.study.bench.tolerance``.

In 32 worlds a box rests on the ground; in 32 a ball hits a pyramid of 10 boxes. A fixed number of
sweeps, which the hard worlds need for a while, all worlds pay for all the time.
"""

import argparse
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import newton
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.drivers import world
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.measure.state import Probe, deepest_penetration
from newton_avbd.scenes.named import add_pyramid, add_stack, set_velocity
from newton_avbd.step import scale

WORLDS = 32
"""Worlds of each kind."""
SECONDS = 2.0
DT = 1.0 / 240.0


@dataclass(frozen=True)
class Cost:
    """What a setting costs and how good it is."""

    milliseconds: float
    """CPU time in the solver by simulated second."""
    sweeps: float
    """Sweeps by world and step."""
    penetration: float
    """Deepest penetration in any world at any time [m]."""


def add_mixed_worlds(builder: newton.ModelBuilder) -> None:
    """Add the easy and the hard worlds."""
    easy, hard = newton.ModelBuilder(), newton.ModelBuilder()
    add_stack(easy, count=1)
    add_pyramid(hard, rows=4)
    ball = hard.add_body(xform=wp.transform(wp.vec3(-4.0, 0.0, 1.2), wp.quat_identity()))
    cfg = hard.default_shape_cfg.copy()
    cfg.density = 1000.0
    hard.add_shape_sphere(ball, radius=0.4, cfg=cfg)
    set_velocity(hard, ball, (8.0, 0.0, 1.0))
    builder.replicate(easy, WORLDS)
    builder.replicate(hard, WORLDS)


@contextmanager
def _all_sweeps() -> Iterator[None]:
    """Worlds at rest go on sweeping, too: nothing is less than what is no number."""
    settled = scale.SETTLED
    scale.SETTLED = wp.constant(math.nan)
    _forget_kernels()
    try:
        yield
    finally:
        scale.SETTLED = settled
        _forget_kernels()


def _forget_kernels() -> None:
    """Makes solvers generate the solve anew."""
    for make in (world.make_solve_worlds, world.make_solve, world.make_step):
        make.cache_clear()


def measure(iterations: int, tolerance: float | None) -> Cost:
    """Simulates the batch with a setting; a tolerance of None is a fixed number of sweeps."""
    if tolerance is None:
        with _all_sweeps():
            return _simulate(iterations, math.nan)
    return _simulate(iterations, tolerance)


def _simulate(iterations: int, tolerance: float) -> Cost:
    builder = newton.ModelBuilder()
    add_mixed_worlds(builder)
    model = builder.finalize(device="cpu")
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    solver = SolverAVBD(model, iterations=iterations)
    solver.tolerance = tolerance
    state, following, probe = model.state(), model.state(), Probe(model)
    spent, sweeps, deepest = 0.0, 0, 0.0
    steps = round(SECONDS / DT)
    for step in range(steps + 2):
        if step == 2:
            # compiled, and started
            solver.reset(state)
            spent, sweeps, deepest = 0.0, 0, 0.0
        pipeline.collide(state, contacts)
        start = time.process_time()
        solver.step(state, following, None, contacts, DT)
        spent += time.process_time() - start
        state, following = following, state
        sweeps += int(np.sum(solver.report().sweeps))
        if step % 2:
            deepest = max(deepest, deepest_penetration(probe.separations(state)))
    return Cost(1.0e3 * spent / SECONDS, sweeps / (steps * 2 * WORLDS), deepest)


def table() -> int:
    """Print a row for each setting, as Markdown; 0, or 130 after Ctrl-C."""
    settings: list[tuple[str, int, float | None]] = [
        *((f"{n} sweeps, always", n, None) for n in (5, 10, 20, 40)),
        *((f"at most {n}", n, 0.0) for n in (10, 20, 40)),
        *((f"at most 40, `tolerance={t:g}`", 40, t) for t in (1.0e-7, 1.0e-6, 1.0e-5)),
    ]
    print("| setting | ms by second | sweeps | deepest |\n| --- | --- | --- | --- |")
    with interruptible() as interruption:
        for name, iterations, tolerance in progress(settings, len(settings), "settings"):
            cost = measure(iterations, tolerance)
            say(
                f"| {name} | {cost.milliseconds:.0f} | {cost.sweeps:.1f} | "
                f"{1.0e3 * cost.penetration:.3f} mm |"
            )
    return interruption.status(0)


if __name__ == "__main__":
    argparse.ArgumentParser(prog="python -m newton_avbd.study.bench.tolerance").parse_args()
    wp.config.log_level = wp.LOG_WARNING
    sys.exit(table())
