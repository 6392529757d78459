# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""One solver with one setting on one scene: what it costs and how far it is off.

Cost is processor time of the solver alone. Where nothing touches, a frame of steps is captured in
a graph and replayed; otherwise a step is, and between steps contacts are detected anew, untimed.
MuJoCo's ``mj_step`` finds its own contacts, whose time is measured apart and taken off.
"""

import math
import time
from dataclasses import dataclass
from statistics import median
from typing import Any, Protocol

import newton
import numpy as np
import warp as wp

from newton_avbd.study.accuracy_scene import FRAME, AccuracyScene, Path
from newton_avbd.study.accuracy_solvers import (
    INTEGRATORS,
    MEASURED,
    MUJOCO_CONTACTS,
    MUJOCO_OPTIONS,
    STIFF,
    Setting,
)
from newton_avbd.study.contestants import Contestant, NewtonContestant
from newton_avbd.study.measure import Array, Bodies
from newton_avbd.study.mujoco_native import MujocoContestant
from newton_avbd.study.peers import Peer

OUT_OF_TIME = "out of time"
"""Note of a point that was not reached."""

EAGER_STEPS = 12
"""Plain steps that are timed, after two that load kernels."""


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
        wall: Time that it took to find this out [s].
    """

    scene: str
    solver: str
    setting: Setting
    error: float | None = None
    cost: float | None = None
    eager: float | None = None
    note: str = ""
    wall: float = 0.0

    @property
    def key(self) -> tuple[str, str, Setting]:
        """What tells points apart."""
        return self.scene, self.solver, self.setting


class OutOfTime(Exception):
    """A run takes longer than there is time for."""


class _Runner(Protocol):
    """A contestant that goes frame by frame."""

    model: newton.Model

    def frame(self, wrench: Array | None) -> float:
        """Simulate a frame under a wrench on body 0; processor time of the solver [s]."""

    def observe(self) -> newton.State:
        """The state reached."""

    def gave_up(self) -> bool:
        """Whether the solver says that it could not go on."""


class _NewtonRunner(NewtonContestant):
    """One of Newton's solvers, replayed."""

    def __init__(self, scene: AccuracyScene, solver: str, setting: Setting):
        measured = MEASURED[solver]
        peer = Peer(measured.title, lambda model: _make(solver, model, setting), measured.stiff)
        super().__init__(scene.scene(setting.substeps), peer)
        self._substeps = setting.substeps
        self._graphs: dict[tuple[str, int], wp.Graph] = {}

    def frame(self, wrench: Array | None) -> float:
        if wrench is not None:
            for state in (self.state, self._next):
                forces = state.body_f.numpy().copy()
                forces[0] = wrench
                state.body_f.assign(forces)
        if self._pipeline is None:
            return self._timed(self._substeps)
        elapsed = 0.0
        for _ in range(self._substeps):
            wp.capture_launch(self._graph_of("collide", self._collide))
            elapsed += self._timed(1)
        return elapsed

    def _timed(self, steps: int) -> float:
        """Replay ``steps`` steps; their processor time [s]."""

        def record() -> None:
            for _ in range(steps):
                self._step()

        start, following = self.state, self._next
        graph = self._graph_of("step", record)
        if steps % 2:
            self.state, self._next = following, start
        else:
            self.state, self._next = start, following
        begin = time.process_time()
        wp.capture_launch(graph)
        return time.process_time() - begin

    def _graph_of(self, name: str, record: Any) -> wp.Graph:
        """Commands from the current state on, recorded once for each of the two states."""
        key = (name, id(self.state))
        if key not in self._graphs:
            with wp.ScopedCapture(device="cpu") as capture:
                record()
            self._graphs[key] = capture.graph
        return self._graphs[key]


class _MujocoRunner(MujocoContestant):
    """MuJoCo without Newton around it."""

    def __init__(self, scene: AccuracyScene, setting: Setting):
        super().__init__(scene.scene(setting.substeps))
        import mujoco

        model, option = self._mj_model, self._mj_model.opt
        if setting.scheme in INTEGRATORS:
            name = f"mjINT_{setting.scheme.upper()}"
            option.integrator = getattr(mujoco.mjtIntegrator, name)
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.impratio = MUJOCO_OPTIONS["impratio"]
        model.geom_solref[:], model.geom_solimp[:] = _mujoco_contacts(setting)
        self._substeps = setting.substeps
        self._touching = bool(self.model.shape_contact_pair_count)

    def frame(self, wrench: Array | None) -> float:
        (data,) = self._data
        if wrench is not None:
            data.xfrc_applied[1] = wrench
        if self._touching:
            return sum(self.advance() for _ in range(self._substeps))
        begin = time.process_time()
        self._mujoco.mj_step(self._mj_model, data, self._substeps)
        return time.process_time() - begin


def measure(
    scene: AccuracyScene, solver: str, setting: Setting, *, repeats: int, budget: float
) -> Point:
    """Try a setting.

    Args:
        scene: The scene.
        solver: Name of the solver.
        setting: What to ask of it.
        repeats: Runs, all alike, whose median cost counts.
        budget: Time after which to stop [s].
    """
    begin = time.monotonic()

    def found(**more: Any) -> Point:
        wall = round(time.monotonic() - begin, 3)
        return Point(scene.name, solver, setting, wall=wall, **more)

    try:
        eager = _eager(scene, solver, setting)
        # Loading and compiling kernels is nobody's fault.
        begin = time.monotonic()
        runs = []
        for _ in range(repeats):
            runner = _runner(scene, solver, setting)
            path, cost = _run(scene, runner, begin + budget)
            runs.append(cost)
            if time.monotonic() - begin > 0.5 * budget:
                break
    except OutOfTime:
        return found(note=OUT_OF_TIME)
    except Exception as exception:
        # Whatever keeps one solver from running must not keep the others from it.
        return found(note=f"{type(exception).__name__}: {exception}".splitlines()[0][:200])
    cost = 1e3 * median(runs) / scene.seconds
    with np.errstate(all="ignore"):
        error = scene.error(path)
    if runner.gave_up() or not math.isfinite(error):
        return found(cost=cost, eager=eager, note="not finite")
    return found(error=error, cost=cost, eager=eager)


def simulate(scene: AccuracyScene, solver: str, setting: Setting) -> Path:
    """States of a solver that goes through a scene."""
    return _run(scene, _runner(scene, solver, setting), math.inf)[0]


def _make(solver: str, model: newton.Model, setting: Setting) -> newton.solvers.SolverBase:
    """A solver of Newton's with a setting; MuJoCo's contacts as hard as the step allows."""
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


def _runner(scene: AccuracyScene, solver: str, setting: Setting) -> _Runner:
    if MEASURED[solver].make is None:
        return _MujocoRunner(scene, setting)
    return _NewtonRunner(scene, solver, setting)


def _run(scene: AccuracyScene, runner: _Runner, deadline: float) -> tuple[Path, float]:
    """Simulate a scene.

    Returns:
        The states and the processor time of the solver [s].

    Raises:
        OutOfTime: It is not done at the deadline.
    """
    bodies = Bodies.of(runner.model)
    poses, velocities, elapsed = [], [], 0.0

    def sample() -> None:
        state = runner.observe()
        poses.append(state.body_q.numpy().astype(float))
        velocities.append(state.body_qd.numpy().astype(float))

    sample()
    for frame in range(scene.frames):
        wrench = None if scene.wrench is None else scene.wrench(frame * FRAME, bodies)
        elapsed += runner.frame(wrench)
        sample()
        if time.monotonic() > deadline:
            raise OutOfTime
    return Path(runner.model, np.array(poses), np.array(velocities)), elapsed


def _eager(scene: AccuracyScene, solver: str, setting: Setting) -> float | None:
    """Processor time of plain steps for a simulated second [ms]; None for ``mj_step``.

    It also loads the kernels that the run after it replays.
    """
    runner = _runner(scene, solver, setting)
    if not isinstance(runner, NewtonContestant):
        return None
    assert isinstance(runner, Contestant)
    times = [runner.advance() for _ in range(EAGER_STEPS + 2)][2:]
    return 1e3 * median(times) * setting.substeps / FRAME
