# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What an effect costs in time: replayed steps of one state, with and without it."""

import dataclasses
import time
from collections.abc import Mapping
from statistics import median

import newton
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.effects import CAUSES
from newton_avbd.io.simulation import Simulation

STEPS = 8
"""Steps in a captured graph."""

ROUNDS = 40
"""Replays of each of two solvers, in turn, so that both see the same neighbors on the machine."""


class Stepper:
    """A solver without some effects that steps from a simulation's state again and again."""

    def __init__(self, simulation: Simulation, effects: Mapping[str, bool]) -> None:
        """Capture steps of a new solver with the settings of the simulation's.

        Args:
            simulation: A simulation by :class:`SolverAVBD`.
            effects: What to leave out, see there.
        """
        model, solver = simulation.model, simulation.solver
        assert isinstance(solver, SolverAVBD)
        self.solver = SolverAVBD(model, **dataclasses.asdict(solver.settings), effects=effects)
        self._device = model.device
        state, after = model.state(), model.state()
        state.assign(simulation.state)
        pipeline = newton.CollisionPipeline(model)
        contacts = pipeline.contacts()
        pipeline.collide(state, contacts)

        def step() -> None:
            self.solver.step(state, after, None, contacts, simulation.dt)

        for _ in range(STEPS):  # the first after a reset sweep more
            step()
        with wp.ScopedCapture(self._device) as capture:
            for _ in range(STEPS):
                step()
        self._graph = capture.graph
        self.seconds()

    @property
    def removable(self) -> list[str]:
        """Effects that are on and can be left out."""
        return [name for name, e in self.solver.effects.items() if e.on and not CAUSES[name].remedy]

    @property
    def sweeps(self) -> float:
        """Sweeps of the last step, mean over worlds."""
        return float(self.solver.status.sweeps.mean())

    def seconds(self) -> float:
        """Time of a step, a mean over one replay [s]."""
        wp.synchronize_device(self._device)
        begin = time.perf_counter()
        wp.capture_launch(self._graph)
        wp.synchronize_device(self._device)
        return (time.perf_counter() - begin) / STEPS


def difference(whole: Stepper, stripped: Stepper) -> tuple[float, float]:
    """By how much the second is faster: time of a step [s], and share of the first's; medians."""
    times = [(whole.seconds(), stripped.seconds()) for _ in range(ROUNDS)]
    first, second = (median(column) for column in zip(*times, strict=True))
    return first - second, 1.0 - second / first
