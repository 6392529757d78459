# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What a hard case is, how a solver is tried on it, and what is held against it."""

import dataclasses
import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd.io import solvers
from newton_avbd.measure import state as measure
from newton_avbd.measure.joints import Joints
from newton_avbd.measure.state import Array

DT = 1.0 / 240.0
"""Time step where a case sets none [s]."""

G = 9.81
"""Gravity where a case sets none, along -z, and what energies are divided by [m/s^2]."""

SAMPLES = 240
"""States of a run in which penetrations are detected and joints looked at, evenly spread, beside
those after each of the first :data:`FIRST` steps, in which a pile finds its forces."""

FIRST = 20


@dataclass(frozen=True)
class Bounds:
    """What may be the largest, chosen from physics before anything was measured; None for all.

    Attributes:
        penetration: Deepest penetration in any sample [m].
        joint: Largest distance between the anchors of a joint along what it locks [m].
        gain: Energy gained, as the height to which it would lift all bodies [m].
        share: The same as a share of the energy that was there; see :attr:`Outcome.share`.
        drift: Largest value of :attr:`Case.drift`.
        rest: Deepest penetration at the end, where bodies have come to rest [m].
    """

    penetration: float | None = None
    joint: float | None = None
    gain: float | None = None
    share: float | None = 1.0e-3
    drift: float | None = None
    rest: float | None = None


@dataclass(frozen=True)
class Case:
    """A scene that is known to be hard for solvers.

    Attributes:
        name: What the command line calls it.
        summary: One line that says what is hard.
        build: Puts the scene into an empty builder.
        bounds: What passes.
        seconds: Time to simulate [s].
        dt: Time step [s], or the time step of each step by its number.
        drift: What else must stay small, at the end of each step; by default the largest distance
            of a moving body's center of mass from its start [m].
        drift_unit: Unit of that.
        act: Called before each step with its number; returns whether it has put energy in.
        stores: Whether springs hold energy that is not measured: what is gained then counts from
            the start of the run instead of the lowest energy so far.
        speculative: How far the collision detection looks ahead of moving bodies [m].
        farther: How many times the gap that it sets its shapes lets the detection look.
        is_quick: Whether it takes seconds and not minutes.
        vbd_ke: Contact stiffness [N/m] with which ``SolverVBD`` does best; None for Newton's.
        settings: Further settings of SolverAVBD.
        own_rate: Why it has no meaning with other time steps than its own; empty where it has.
    """

    name: str
    summary: str
    build: Callable[[newton.ModelBuilder], None]
    bounds: Bounds
    seconds: float = 5.0
    dt: float | Callable[[int], float] = DT
    drift: "Callable[[Trial], float] | None" = None
    drift_unit: str = "m"
    act: "Callable[[Trial, int], bool] | None" = None
    stores: bool = False
    speculative: float | None = None
    farther: float = 1.0
    is_quick: bool = True
    vbd_ke: float | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    own_rate: str = ""

    def step_size(self, step: int) -> float:
        """Time step of the step with this number [s]."""
        return self.dt(step) if callable(self.dt) else self.dt

    def at_rate(self, rate: float) -> "Case":
        """The case at a number of steps a second, for which collision detection looks as far ahead.

        Raises:
            ValueError: It has no meaning there; :attr:`own_rate` says why.
        """
        if self.own_rate:
            raise ValueError(self.own_rate)
        farther = max(1.0, 1.0 / (rate * self.step_size(0)))
        ahead = self.speculative and farther * self.speculative
        return dataclasses.replace(self, dt=1.0 / rate, speculative=ahead, farther=farther)


class Catalog(dict[str, Case]):
    """Hard cases by name, in the order in which they are declared."""

    def add(
        self,
        name: str,
        summary: str,
        build: Callable[[newton.ModelBuilder], None],
        bounds: Bounds,
        **more: Any,
    ) -> None:
        """Declare a case; arguments as in :class:`Case`."""
        self[name] = Case(name, summary, build, bounds, **more)

    def declare(
        self, name: str, summary: str, bounds: Bounds, **more: Any
    ) -> Callable[[Callable[[newton.ModelBuilder], None]], None]:
        """Decorator of a function that builds a case; arguments as in :class:`Case`."""

        def add(build: Callable[[newton.ModelBuilder], None]) -> None:
            self.add(name, summary, build, bounds, **more)

        return add


class Trial:
    """A solver at work on a hard case.

    Attributes:
        case: The case.
        model: Its model.
        solver: The solver.
        control: Forces and targets of the joints.
        state: The current state.
        time: Simulated so far [s].
        bodies: Mass properties.
        start: Centers of mass at the start [m], shape [bodies, 3].
    """

    def __init__(self, case: Case, solver: str, iterations: int | None = None):
        """Build the case and set ``solver``, of :data:`newton_avbd.io.names.SOLVERS`, up."""
        self.case = case
        builder = newton.ModelBuilder()
        solvers.prepare(solver, builder)
        if solver == "vbd" and case.vbd_ke is not None:
            builder.default_shape_cfg.ke = case.vbd_ke
        case.build(builder)
        builder.color()
        # Newton would mend needles and thin plates.
        self.model = builder.finalize(skip_validation_inertia=True)
        self.model.shape_gap.assign(case.farther * self.model.shape_gap.numpy())
        settings = case.settings if solver == "avbd" else {}
        self.solver = solvers.construct(solver, self.model, iterations, **settings)
        self.control = self.model.control()
        self.state, self._next = self.model.state(), self.model.state()
        self.bodies = measure.Bodies.of(self.model)
        self.start = self.centers()
        self.time = 0.0
        self._pipeline: newton.CollisionPipeline | None = None
        self._contacts: newton.Contacts | None = None
        own = solvers.detects_collisions(self.solver)
        if self.model.shape_contact_pair_count and not own:
            # on a GPU contacts come in any order, unless they are sorted
            self._pipeline = newton.CollisionPipeline(
                self.model,
                speculative_contact_gap_max=case.speculative,
                deterministic=self.model.device.is_cuda,
            )
            self._contacts = self._pipeline.contacts()

    def step(self, dt: float) -> None:
        """Detect contacts and step."""
        if self._pipeline is not None:
            # a little further than a step, in which gravity speeds bodies up
            self._pipeline.collide(self.state, self._contacts, dt=1.1 * dt)
        self.solver.step(self.state, self._next, self.control, self._contacts, dt)
        self.state, self._next = self._next, self.state
        self.time += dt

    def poses(self) -> Array:
        """Poses of the bodies, shape [bodies, 7]."""
        return self.state.body_q.numpy().astype(float)

    def velocities(self) -> Array:
        """Velocities of the centers of mass [m/s] and angular [rad/s], shape [bodies, 6]."""
        return self.state.body_qd.numpy().astype(float)

    def centers(self) -> Array:
        """Centers of mass [m], shape [bodies, 3]."""
        return measure.transform(self.poses(), self.bodies.com)

    def place(self, body: int, pose: Any, velocity: Any = (0.0,) * 6) -> None:
        """Put a free body to a pose with a velocity, in all terms in which a solver may read it."""
        joint = int(np.flatnonzero(self.model.joint_child.numpy() == body)[0])
        at = int(self.model.joint_q_start.numpy()[joint])
        moving = int(self.model.joint_qd_start.numpy()[joint])
        for array, where in ((self.state.body_q, 7 * body), (self.state.joint_q, at)):
            _assign(array, where, pose)
        for array, where in ((self.state.body_qd, 6 * body), (self.state.joint_qd, moving)):
            _assign(array, where, velocity)

    def push(self, body: int, wrench: tuple[float, ...]) -> None:
        """Push a body in the next step: force [N] and torque [N m] at its center of mass."""
        _assign(self.state.body_f, 6 * body, wrench)

    def set_gravity(self, gravity: tuple[float, float, float]) -> None:
        """Change gravity [m/s^2] while the simulation runs."""
        self.model.set_gravity(gravity)
        self.solver.notify_model_changed(newton.ModelFlags.MODEL_PROPERTIES)
        self.bodies = measure.Bodies.of(self.model)

    def reset(self) -> None:
        """Put everything back to the start."""
        self.solver.reset(self.state)

    def energy(self) -> float:
        """Kinetic and potential energy of the moving bodies [J]."""
        return measure.total_energy(self.bodies, self.state)

    def moved(self) -> float:
        """Largest distance of a moving body's center of mass from its start [m]."""
        moved = np.linalg.norm(self.centers() - self.start, axis=1)[self.bodies.moving]
        return float(np.max(moved, initial=0.0))

    def is_finite(self) -> bool:
        """Whether the state is finite and the solver has not given up on it."""
        held = getattr(getattr(self.solver, "status", None), "held_steps", None)
        return bool(
            np.isfinite(self.poses()).all()
            and np.isfinite(self.velocities()).all()
            and not np.any(held)
        )


@dataclass(frozen=True)
class Outcome:
    """What a solver made of a case.

    Attributes:
        case: Name of the case.
        solver: Name of the solver.
        finite: Whether every state was finite.
        penetration: See :class:`Bounds`, as the next three.
        joint: None without joints.
        gain: None where the case bounds none: something then does work.
        share: The gain as a share of what was there: kinetic energy where the gain counts from, by
            how much the potential energy falls from there, and what lifts each body by its radius
            of gyration. None where the gain is.
        drift: None where the case bounds none.
        milliseconds: Median time of a step, collision detection included [ms].
        seconds: Simulated time [s].
        rest: See :class:`Bounds`.
        note: Why it did not run, or not to its end.
        times: Of the samples [s].
        energies: In the samples, as heights [m].
        penetrations: In the samples [m].
        separations: Of joints, in the samples [m].
    """

    case: str
    solver: str
    finite: bool = False
    penetration: float = math.nan
    joint: float | None = None
    gain: float | None = None
    share: float | None = None
    drift: float | None = None
    rest: float = math.nan
    milliseconds: float = math.nan
    seconds: float = 0.0
    note: str = ""
    times: list[float] = field(default_factory=list)
    energies: list[float] = field(default_factory=list)
    penetrations: list[float] = field(default_factory=list)
    separations: list[float] = field(default_factory=list)

    def failures(self, bounds: Bounds) -> list[str]:
        """What is not as it must be; empty for a pass."""
        if not self.finite:
            return [self.note or "not finite"]
        failures = [self.note] if self.note else []
        for name in ("penetration", "joint", "gain", "share", "drift", "rest"):
            bound, value = getattr(bounds, name), getattr(self, name)
            if bound is not None and value is not None and not value <= bound:
                failures.append(name)
        return failures


def try_case(
    case: Case, solver: str, *, iterations: int | None = None, budget: float = math.inf
) -> Outcome:
    """Let a solver run a case.

    Args:
        case: The case.
        solver: One of :data:`newton_avbd.io.names.SOLVERS`.
        iterations: Iterations a step; None for the solver's own.
        budget: Wall-clock time after which to stop early [s].

    Returns:
        The outcome; a solver that refuses says why in its note.
    """
    level, wp.config.log_level = wp.config.log_level, wp.LOG_ERROR
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _run(Trial(case, solver, iterations), solver, budget)
    except Exception as error:  # solvers refuse in as many ways as there are solvers
        first = str(error).strip().splitlines()[:1]
        return Outcome(case.name, solver, note=f"{type(error).__name__}: {''.join(first)}")
    finally:
        wp.config.log_level = level


def _run(trial: Trial, solver: str, budget: float) -> Outcome:
    case, probe, joints = trial.case, measure.Probe(trial.model), Joints.of(trial.model)
    sizes = _step_sizes(case)
    sampled = {round(len(sizes) * (i + 1) / SAMPLES) for i in range(SAMPLES)}
    sampled |= set(range(1, FIRST + 1))
    weight = G * float(np.sum(trial.bodies.mass[trial.bodies.moving]))
    origin = lowest = trial.energy()
    overlaps = trial.model.shape_contact_pair_count > 0
    times: list[float] = []
    energies: list[float] = []
    penetrations: list[float] = []
    separations: list[float] = []
    gain = drift = 0.0
    supply = _Supply(trial)
    durations, begin, note, finite = [], time.monotonic(), "", True
    for step, dt in enumerate(sizes):
        if case.act is not None and case.act(trial, step):
            lowest = trial.energy()
            supply.put_in(trial)
        start = time.perf_counter()
        trial.step(dt)
        durations.append(time.perf_counter() - start)
        energy = trial.energy()
        if not math.isfinite(energy) or not trial.is_finite():
            finite, note = False, f"not finite after {trial.time:.3g} s"
            break
        gain = max(gain, (energy - lowest) / weight)
        supply.watch(trial)
        lowest = lowest if case.stores else min(lowest, energy)
        drift = max(drift, trial.moved() if case.drift is None else case.drift(trial))
        if step == 0:
            # it has loaded kernels, which does not count
            begin = time.monotonic()
        late = time.monotonic() - begin > budget
        if step + 1 in sampled or late:
            times.append(trial.time)
            energies.append((energy - origin) / weight)
            gaps = probe.separations(trial.state) if overlaps else np.empty(0)
            penetrations.append(measure.deepest_penetration(gaps))
            separations.append(float(np.max(joints.separation(trial.poses()), initial=0.0)))
        if late and step + 1 < len(sizes):
            note = f"stopped after {trial.time:.3g} s"
            break
    return Outcome(
        case.name,
        solver,
        finite=finite,
        penetration=max(penetrations, default=0.0),
        joint=max(separations, default=0.0) if len(joints.child) else None,
        gain=None if case.bounds.gain is None else gain,
        share=None if case.bounds.gain is None else gain * weight / supply.energy,
        drift=None if case.bounds.drift is None else drift,
        rest=penetrations[-1] if penetrations else 0.0,
        milliseconds=1e3 * float(np.median(durations[1:] or durations)),
        seconds=trial.time,
        note=note,
        times=times,
        energies=energies,
        penetrations=penetrations,
        separations=separations if len(joints.child) else [],
    )


class _Supply:
    """The energy that a run can spend, see :attr:`Outcome.share`."""

    def __init__(self, trial: Trial):
        moving, bodies = trial.bodies.moving, trial.bodies
        size = np.trace(bodies.inertia, axis1=1, axis2=2)[moving] * bodies.mass[moving]
        self._lift = G * float(np.sum(np.sqrt(0.5 * size)))
        self._kinetic = self._fall = 0.0
        self.put_in(trial)

    def put_in(self, trial: Trial) -> None:
        """Counts from the present state on."""
        self._start = self._potential(trial)
        self._kinetic = max(self._kinetic, trial.energy() - self._start)

    def watch(self, trial: Trial) -> None:
        """Takes a state in."""
        self._fall = max(self._fall, self._start - self._potential(trial))

    @property
    def energy(self) -> float:
        """What was there [J]."""
        return self._kinetic + self._fall + self._lift

    @staticmethod
    def _potential(trial: Trial) -> float:
        return float(np.sum(measure.potential_energy(trial.bodies, trial.poses())))


def _step_sizes(case: Case) -> list[float]:
    """Time steps of a run [s]."""
    sizes: list[float] = []
    passed = 0.0
    while passed < case.seconds * (1.0 - 1e-9):
        sizes.append(case.step_size(len(sizes)))
        passed += sizes[-1]
    return sizes


def _assign(array: wp.array | None, where: int, values: Any) -> None:
    """Write into an array, counted in single numbers."""
    if array is None:
        return
    numbers = array.numpy().copy()
    numbers.reshape(-1)[where : where + len(values)] = values
    array.assign(numbers)
