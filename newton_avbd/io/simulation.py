# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""A scene with a solver in it, ready to be advanced frame by frame."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import newton

from newton_avbd.flags import heed_flags
from newton_avbd.scenes.finalize import finalized

from . import solvers
from .controls import Controls
from .timing import StepTimer


class Simulation(Protocol):
    """What the commands need of anything that can be simulated.

    Attributes:
        name: The scene's name, as the user gave it.
        model: The model.
        solver: The solver that steps it.
        timer: Times of the solver and of collision detection.
        dt: Solver step [s].
        frame_dt: Time from one frame to the next, one or more solver steps [s].
        frames: Number of frames worth watching.
        notes: What the user should know of the scene, a sentence each.
    """

    name: str
    notes: tuple[str, ...]
    model: newton.Model
    solver: newton.solvers.SolverBase
    timer: StepTimer
    dt: float
    frame_dt: float
    frames: int

    @property
    def state(self) -> newton.State:
        """State at the end of the last frame."""

    def advance(self) -> None:
        """Simulate one frame."""

    def render(self) -> None:
        """Show the state in the viewer that the scene was opened with."""

    def verdict(self) -> str | None:
        """The scene's own test of where it ended: ``"passed"``, the failure, or None for none."""


@dataclass(frozen=True)
class Request:
    """How a scene is to be opened.

    Attributes:
        solver: One of :data:`newton_avbd.io.names.SOLVERS`.
        iterations: Iterations a step; None for the scene's or the solver's own.
        dt: Solver step [s]; None for the scene's own.
        viewer: Makes the viewer; None for one that shows nothing.
        arguments: Command-line arguments for a Newton example.
        ctrl: What drives the actuators of an MJCF file, one of
            :data:`newton_avbd.io.names.CONTROLS`; None for nothing.
        accuracy: Error a second that SolverAVBD is to keep to [m/s], which then steps a frame at a
            time where ``dt`` is None; None for steps as they are. Other solvers have no such thing.
        light_links: Whether joints of MJCF files may get links of their own, of next to no mass,
            for solvers that take such.
    """

    solver: str = "avbd"
    iterations: int | None = None
    dt: float | None = None
    viewer: Callable[[], Any] | None = None
    arguments: tuple[str, ...] = ()
    ctrl: str | None = None
    accuracy: float | None = None
    light_links: bool = True

    @property
    def options(self) -> dict[str, Any]:
        """Further arguments of the solver."""
        is_asked = self.accuracy is not None and self.solver == "avbd"
        return {"accuracy": self.accuracy} if is_asked else {}


class ModelSimulation:
    """A simulation of a filled builder, with Newton's collision detection before each step."""

    def __init__(
        self,
        name: str,
        builder: newton.ModelBuilder,
        request: Request,
        *,
        dt: float,
        frame_dt: float,
        frames: int,
        notes: tuple[str, ...] = (),
    ):
        """Finalize ``builder`` and put the solver of ``request`` into the model.

        Args:
            name: The scene's name.
            builder: Filled, not finalized.
            request: Solver and settings.
            dt: Solver step where the request sets none [s].
            frame_dt: Time between frames [s], made a whole number of steps.
            frames: Number of frames worth watching.
            notes: What the user should know of the scene, a sentence each.
        """
        self.name, self.frames, self.notes = name, frames, notes
        self.dt = request.dt or (frame_dt if request.options else dt)
        self._substeps = max(1, round(frame_dt / self.dt))
        self.frame_dt = self._substeps * self.dt
        solvers.complete(request.solver, builder)
        self.model = finalized(builder)
        options, without = request.options, heed_flags(self.model)
        if request.solver == "avbd" and without:
            options["effects"] = without
        self.solver = solvers.construct(request.solver, self.model, request.iterations, **options)
        self.timer = StepTimer()
        self._pipeline = newton.CollisionPipeline(self.model)
        self._contacts = self._pipeline.contacts()
        self._collide = "contact" not in without
        self._collide &= not solvers.detects_collisions(self.solver)
        self.timer.watch_solver(self.solver)
        self.timer.watch_pipeline(self._pipeline)
        self._state, self._next = self.model.state(), self.model.state()
        self._control = self.model.control()
        self._viewer = None if request.viewer is None else request.viewer()
        if self._viewer is not None:
            self._viewer.set_model(self.model)
        self._time = 0.0
        self.controls: Controls | None = None
        """What drives the actuators; None for nothing."""

    @property
    def state(self) -> newton.State:
        return self._state

    def advance(self) -> None:
        for substep in range(self._substeps):
            self._state.clear_forces()
            if self.controls is not None:
                ctrl = self.controls.at(self._time + substep * self.dt)
                self._control.mujoco.ctrl.assign(ctrl)
            if self._viewer is not None:
                self._viewer.apply_forces(self._state)
            if self._collide:
                self._pipeline.collide(self._state, self._contacts)
            self.solver.step(self._state, self._next, self._control, self._contacts, self.dt)
            self._state, self._next = self._next, self._state
        self._time += self.frame_dt

    def render(self) -> None:
        if self._viewer is not None:
            self._viewer.begin_frame(self._time)
            self._viewer.log_state(self._state)
            self._viewer.log_contacts(self._contacts, self._state)
            self._viewer.end_frame()

    def verdict(self) -> str | None:
        return None
