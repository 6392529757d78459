# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""One solver with one setting on one scene: what it costs and how far it is off.

Cost is processor time of the solver alone. Where nothing happens between steps, many are captured
in a graph and replayed. Otherwise a step is, or a frame of steps where only a force is set between
frames; contacts are detected anew between steps, untimed. The time of replaying an empty graph in
its place is taken off. MuJoCo's ``mj_step`` finds its own contacts, whose time is measured apart
and taken off, and with it that of a call from Python.
"""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd.measure.state import Array, Bodies
from newton_avbd.study.accuracy.scene import FRAME, AccuracyScene, Path
from newton_avbd.study.accuracy.solvers import (
    INTEGRATORS,
    MEASURED,
    MUJOCO_CONTACTS,
    MUJOCO_OPTIONS,
    STIFF,
    Setting,
)
from newton_avbd.study.mujoco.native import MujocoContestant
from newton_avbd.study.peers import MJ_STEP

OUT_OF_TIME = "out of time"
"""Note of a point that was not reached."""

EAGER_STEPS = 14
"""Plain steps, of which all but the first two are timed."""

STEPS_IN_ONE_GO = 64
"""Steps timed at once at least where nothing happens between them, ..."""

LEAST_TIMED = 0.02
"""... and processor time that they take, so that clocks and cold caches do not show [s]."""


@dataclass(frozen=True)
class Point:
    """What a solver did on a scene.

    Attributes:
        scene: Name of the scene.
        solver: Name of the solver.
        setting: What was asked of it.
        error: Relative error, see :class:`AccuracyScene`; None where there is none, as
            :attr:`note` says.
        cost: Median processor time for a simulated second [ms], replayed.
        eager: The same for plain steps; None for ``mj_step``, which has no others.
        note: Why there is no error, or nothing.
        spent: Processor time that it took to find this out [s].
    """

    scene: str
    solver: str
    setting: Setting
    error: float | None = None
    cost: float | None = None
    eager: float | None = None
    note: str = ""
    spent: float = 0.0

    @property
    def key(self) -> tuple[str, str, Setting]:
        """What tells points apart."""
        return self.scene, self.solver, self.setting


class OutOfTime(Exception):
    """A run takes longer than there is time for."""


class Runner(ABC):
    """A solver at work on a scene, one setting after the other.

    Attributes:
        scene: The scene.
        model: Its model.
    """

    def __init__(self, scene: AccuracyScene, model: newton.Model):
        self.scene = scene
        self.model = model
        self.bodies = Bodies.of(model)

    @property
    def solver(self) -> Any:
        """The solver at work; None where it is not one of Newton's."""
        return None

    @abstractmethod
    def restart(self, setting: Setting) -> None:
        """Go back to the start with a new solver."""

    @abstractmethod
    def frame(self, wrench: Array | None) -> float:
        """Simulate a frame under a wrench on body 0; processor time of the solver [s]."""

    @abstractmethod
    def rush(self) -> float:
        """Simulate some frames in one go; processor time of the solver for each [s]."""

    @abstractmethod
    def observe(self) -> newton.State:
        """The state reached."""

    def eager(self) -> float | None:
        """Processor time of a plain step [s]; None where there is none but the replayed one."""
        return None

    def gave_up(self) -> bool:
        """Whether the solver says that it could not go on."""
        return False

    def run(
        self, setting: Setting, deadline: float = math.inf, *, is_watched: bool = True
    ) -> tuple[Path, float]:
        """Simulate the scene.

        Args:
            setting: What to ask of the solver.
            deadline: Processor time of this process after which to stop [s].
            is_watched: Whether to keep the states; reading them leaves a solver with cold caches.

        Returns:
            The states, or none, and the processor time of the solver [s].

        Raises:
            OutOfTime: It is not done at the deadline.
        """
        self.restart(setting)
        poses, velocities, elapsed = [], [], 0.0

        def sample() -> None:
            if is_watched:
                state = self.observe()
                poses.append(state.body_q.numpy().astype(float))
                velocities.append(state.body_qd.numpy().astype(float))

        sample()
        for frame in range(self.scene.frames):
            wrench = self.scene.wrench
            elapsed += self.frame(wrench and wrench(frame * FRAME, self.bodies))
            sample()
            if time.process_time() > deadline:
                raise OutOfTime
        return Path(self.model, np.array(poses), np.array(velocities)), elapsed


class _NewtonRunner(Runner):
    """One of Newton's solvers, replayed."""

    def __init__(self, scene: AccuracyScene, solver: str):
        self._solver_name = solver
        ke = scene.vbd_ke if MEASURED[solver].stiff else None
        super().__init__(scene, scene.scene(1).model(ke=ke, device="cpu"))
        self._states = self.model.state(), self.model.state()
        self._control = self.model.control()
        self._contacts: newton.Contacts | None = None
        if self.model.shape_contact_pair_count:
            pipeline = newton.CollisionPipeline(self.model)
            self._contacts = pipeline.contacts()
            self._collide = [
                _record(partial(pipeline.collide, state, self._contacts)) for state in self._states
            ]
            self._overhead = _overhead(self._collide[0])
        else:
            self._overhead = _overhead()

    def restart(self, setting: Setting) -> None:
        self._solver = _make(self._solver_name, self.model, setting)
        self._setting = setting
        start = self.model.state()
        for state in self._states:
            for name in ("body_q", "body_qd", "body_f", "joint_q", "joint_qd"):
                array = getattr(state, name)
                if array is not None:
                    wp.copy(array, getattr(start, name))
        self._steps: dict[int, wp.Graph] = {}
        self._now = 0

    def observe(self) -> newton.State:
        return self._states[self._now]

    def frame(self, wrench: Array | None) -> float:
        if wrench is not None:
            for state in self._states:
                forces = state.body_f.numpy().copy()
                forces[0] = wrench
                state.body_f.assign(forces)
        if self._contacts is None:
            return self._replay(self._setting.substeps)
        elapsed = 0.0
        for _ in range(self._setting.substeps):
            wp.capture_launch(self._collide[self._now])
            elapsed += self._replay(1)
        return elapsed

    def rush(self) -> float:
        # an even number of frames, which end in the state in which they start
        frames = 2 * math.ceil(STEPS_IN_ONE_GO / (2 * self._setting.substeps))
        graph, calls, elapsed = _record(self._step, frames * self._setting.substeps), 0, 0.0
        begin = time.process_time()
        while elapsed < LEAST_TIMED:
            wp.capture_launch(graph)
            calls += 1
            elapsed = time.process_time() - begin
        return max(0.0, elapsed / calls - self._overhead) / frames

    def eager(self) -> float:
        times = []
        for _ in range(EAGER_STEPS):
            if self._contacts is not None:
                wp.capture_launch(self._collide[self._now])
            begin = time.process_time()
            self._step()
            times.append(time.process_time() - begin)
        # The first two load kernels.
        return median(times[2:])

    @property
    def solver(self) -> newton.solvers.SolverBase:
        """The solver at work."""
        return self._solver

    def gave_up(self) -> bool:
        status = getattr(self._solver, "status", None)
        return bool(np.any(getattr(status, "held_steps", 0)))

    def _step(self) -> None:
        now, following = self._states[self._now], self._states[1 - self._now]
        dt = FRAME / self._setting.substeps
        self._solver.step(now, following, self._control, self._contacts, dt)
        self._now = 1 - self._now

    def _replay(self, steps: int) -> float:
        """Replay a number of steps, always the same; their processor time [s]."""
        start = self._now
        if start not in self._steps:
            self._steps[start] = _record(self._step, steps)
        begin = time.process_time()
        wp.capture_launch(self._steps[start])
        elapsed = time.process_time() - begin
        self._now = (start + steps) % 2
        return max(0.0, elapsed - self._overhead)


class _MujocoRunner(Runner):
    """MuJoCo without Newton around it."""

    def __init__(self, scene: AccuracyScene):
        self._contestant = MujocoContestant(scene.scene(1))
        super().__init__(scene, self._contestant.model)

    def restart(self, setting: Setting) -> None:
        import mujoco

        self._setting = setting
        model = self._contestant.mj_model
        option = model.opt
        option.timestep = FRAME / setting.substeps
        if setting.scheme in INTEGRATORS:
            name = f"mjINT_{setting.scheme.upper()}"
            option.integrator = getattr(mujoco.mjtIntegrator, name)
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.impratio = MUJOCO_OPTIONS["impratio"]
        model.geom_solref[:], model.geom_solimp[:] = _mujoco_contacts(setting)
        self._contestant.restart()

    def observe(self) -> newton.State:
        return self._contestant.observe()

    def frame(self, wrench: Array | None) -> float:
        if wrench is not None:
            self._contestant.push(wrench)
        if self.scene.touching:
            return sum(self._contestant.advance() for _ in range(self._setting.substeps))
        return self._contestant.advance(self._setting.substeps)

    def rush(self) -> float:
        frames, elapsed = 0, 0.0
        while elapsed < LEAST_TIMED:
            elapsed += self._contestant.advance(STEPS_IN_ONE_GO * self._setting.substeps)
            frames += STEPS_IN_ONE_GO
        return elapsed / frames


def runner(scene: AccuracyScene, solver: str) -> Runner:
    """Set a solver up on a scene."""
    return _MujocoRunner(scene) if solver == MJ_STEP else _NewtonRunner(scene, solver)


def measure(worker: Runner, solver: str, setting: Setting, *, repeats: int, budget: float) -> Point:
    """Try a setting.

    Args:
        worker: The solver at work on its scene.
        solver: Its name.
        setting: What to ask of it.
        repeats: Runs whose median cost counts, after the one for the error: all alike, or where
            nothing happens between frames, one after the other.
        budget: Processor time after which to stop [s].
    """
    scene, begin = worker.scene, time.process_time()

    def found(**more: Any) -> Point:
        spent = round(time.process_time() - begin, 3)
        return Point(scene.name, solver, setting, spent=spent, **more)

    try:
        worker.restart(setting)
        eager = worker.eager()
        # Loading and compiling kernels is nobody's fault.
        begin = time.process_time()
        path, watched = worker.run(setting, begin + budget)
        costs: list[float] = []
        while len(costs) < repeats and time.process_time() - begin < 0.5 * budget:
            if scene.interrupted:
                _, cost = worker.run(setting, begin + budget, is_watched=False)
                costs.append(cost / scene.frames)
            else:
                costs.append(worker.rush())
        costs = costs or [watched / scene.frames]
    except OutOfTime:
        return found(note=OUT_OF_TIME)
    except Exception as exception:
        # Whatever keeps one solver from running must not keep the others from it.
        return found(note=f"{type(exception).__name__}: {exception}".splitlines()[0][:200])
    times = {"cost": 1e3 * median(costs) / FRAME}
    if eager is not None:
        times["eager"] = 1e3 * eager * setting.substeps / FRAME
    with np.errstate(all="ignore"):
        error = scene.error(path)
    if worker.gave_up() or not math.isfinite(error):
        return found(note="not finite", **times)
    return found(error=error, **times)


def _overhead(before: wp.Graph | None = None) -> float:
    """Processor time of replaying nothing [s], which a call from Python and the clocks take.

    What is replayed ``before``, untimed, leaves neither of them in the processor's caches.
    """
    nothing = _record(lambda: None)
    times = []
    for _ in range(300):
        if before is not None:
            wp.capture_launch(before)
        begin = time.process_time()
        wp.capture_launch(nothing)
        times.append(time.process_time() - begin)
    return median(times)


def _record(command: Callable[[], None], times: int = 1) -> wp.Graph:
    """Capture a command, some times in a row."""
    with wp.ScopedCapture(device="cpu") as capture:
        for _ in range(times):
            command()
    return capture.graph


def _make(solver: str, model: newton.Model, setting: Setting) -> newton.solvers.SolverBase:
    """A solver of Newton's with a setting; MuJoCo's contacts as the setting says."""
    make = MEASURED[solver].make
    assert make is not None
    made = make(model, setting)
    if solver == "mujoco_warp":
        solref, solimp = _mujoco_contacts(setting)
        made.mjw_model.geom_solref.fill_(wp.vec2(*solref))
        made.mjw_model.geom_solimp.fill_(made.mjw_model.geom_solimp.dtype(*solimp))
    return made


def _mujoco_contacts(setting: Setting) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """MuJoCo's ``solref`` and ``solimp`` of contacts."""
    solref, solimp = MUJOCO_CONTACTS.get(setting.scheme or STIFF, MUJOCO_CONTACTS[STIFF])
    if solref is None:
        return (0.02, 1.0), solimp
    return (solref[0] * FRAME / setting.substeps, solref[1]), solimp
