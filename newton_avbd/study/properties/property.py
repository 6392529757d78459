# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What a property of a scene is, and how a solver is tried on it: one number, known by hand."""

import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverBase

from newton_avbd.measure import state as measure
from newton_avbd.measure.state import Array
from newton_avbd.study.properties.solvers import SOLVERS

DT = 1.0 / 240.0
"""Time step [s]."""

IGNORED = 0.05
"""A solver ignores a property if authoring it makes less than this part of the difference that it
should make."""

ERROR_LENGTH = 120
"""Characters of an error that a table shows."""


@dataclass(frozen=True)
class Property:
    """Something that a scene can author, on the smallest scene that shows it.

    Attributes:
        name: What a table calls it.
        scene: The scene and its closed form, in a sentence.
        build: Fills a builder and returns what measures; its second argument says whether the
            property is to be authored, everything else being the same.
        expected: The closed form's value; NaN where there is no right one, but :attr:`rules`.
        bound: Largest deviation that still counts as right, in :attr:`unit`.
        unit: Unit of the value.
        settings: Solver settings that switch the property on, by solver, beside those of
            :data:`~newton_avbd.study.properties.solvers.SOLVERS`; ``attributes`` are custom
            attributes of MuJoCo's, the same for all shapes.
        materials: Whether contacts carry their own stiffness, damping and friction.
        rules: Values of the rules between which Newton's solvers choose, by name.
    """

    name: str
    scene: str
    build: Callable[[newton.ModelBuilder, bool], "Measure"]
    expected: float
    bound: float
    unit: str = ""
    settings: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    materials: bool = False
    rules: Mapping[str, float] = field(default_factory=dict)


class Catalog(dict[str, Property]):
    """Properties by name, in the order in which they are declared."""

    def declare(
        self, name: str, scene: str, expected: float, bound: float, unit: str = "", **more: Any
    ) -> Callable[[Callable[[newton.ModelBuilder, bool], "Measure"]], None]:
        """Decorator of a function that builds; arguments as in :class:`Property`."""

        def add(build: Callable[[newton.ModelBuilder, bool], "Measure"]) -> None:
            self[name] = Property(name, scene, build, expected, bound, unit, **more)

        return add


class Trial:
    """A solver at work on the scene of a property.

    Attributes:
        model: The model.
        solver: The solver.
        state: The current state.
        control: Forces and targets of the joints.
        contacts: Contacts of Newton's collision detection; None without, or where the solver
            detects them itself.
        observables: What :meth:`observe` asked for.
    """

    def __init__(self, solver: str, property_: Property, authored: bool):
        """Build the scene and set the solver up on it."""
        name, defaults = SOLVERS[solver]
        settings = defaults | property_.settings.get(solver, {})
        if name == "SolverAVBD":
            from newton_avbd import SolverAVBD

            make: type[SolverBase] = SolverAVBD
        else:
            make = getattr(newton.solvers, name)
        builder = newton.ModelBuilder()
        make.register_custom_attributes(builder)
        self.measure = property_.build(builder, authored)
        builder.color()
        self.model = builder.finalize(device="cpu")
        if self.model.joint_count:
            newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, self.model)
        for attribute, value in settings.pop("attributes", {}).items():
            getattr(self.model.mujoco, attribute).fill_(value)
        self.solver = make(self.model, **settings)
        self.control = self.model.control()
        self.state, self._next = self.model.state(), self.model.state()
        self.contacts: newton.Contacts | None = None
        self._pipeline: newton.CollisionPipeline | None = None
        own = name == "SolverMuJoCo" and settings.get("use_mujoco_contacts", True)
        if self.model.shape_contact_pair_count and not own:
            self._pipeline = newton.CollisionPipeline(self.model)
            self.contacts = self._pipeline.contacts()
            if property_.materials:
                self.contacts = newton.Contacts(
                    self._pipeline.rigid_contact_max, 0, per_contact_shape_properties=True
                )
        self.observables: SolverBase.Observables | None = None
        self.materials: dict[str, float] = {}

    def observe(self, kind: str) -> None:
        """Ask for an observable, from the next step on."""
        self.observables = self.solver.observables((kind,), contacts=self.contacts)

    def step(self) -> None:
        """Detect contacts and step; forces on bodies and joints stay as they are."""
        if self._pipeline is not None:
            self._pipeline.collide(self.state, self.contacts)
            for name, value in self.materials.items():
                getattr(self.contacts, f"rigid_contact_{name}").fill_(value)
        wp.copy(self._next.body_f, self.state.body_f)
        more = {} if self.observables is None else {"observables": self.observables}
        self.solver.step(self.state, self._next, self.control, self.contacts, DT, **more)
        self.state, self._next = self._next, self.state

    def run(self, seconds: float) -> None:
        """Step for a time [s]."""
        for _ in self.steps(seconds):
            pass

    def steps(self, seconds: float) -> Iterator[float]:
        """Step for a time [s], and yield after each step how much of it has passed."""
        for index in range(round(seconds / DT)):
            self.step()
            yield (index + 1) * DT

    def moment(self, value: Callable[[], float], seconds: float) -> float:
        """When ``value`` first changes its sign [s], interpolated; infinite if not in time."""
        before = value()
        for time in self.steps(seconds):
            now = value()
            if now * before <= 0.0:
                return time - DT * now / (now - before)
            before = now
        return math.inf

    def center(self, body: int = 0) -> Array:
        """Center of mass of a body [m]."""
        pose = self.state.body_q.numpy()[body : body + 1].astype(float)
        com = self.model.body_com.numpy()[body : body + 1].astype(float)
        return measure.transform(pose, com)[0]

    def velocity(self, body: int = 0) -> Array:
        """Velocity of a body: of its center of mass [m/s], and angular [rad/s]."""
        return self.state.body_qd.numpy()[body].astype(float)

    def rotation(self, body: int = 0) -> Array:
        """Rotation of a body, a quaternion xyzw."""
        return self.state.body_q.numpy()[body, 3:].astype(float)

    def turn(self, body: int = 0, axis: int = 1) -> float:
        """Angle of a body that turns about a coordinate axis alone [rad], within half a turn."""
        q = self.rotation(body)
        return 2.0 * math.atan2(math.copysign(1.0, q[3]) * q[axis], abs(q[3]))

    def push(self, force: Any = (0, 0, 0), torque: Any = (0, 0, 0), body: int = 0) -> None:
        """Set the force [N] and torque [N m] on a body."""
        wrench = self.state.body_f.numpy().copy()
        wrench[body] = [*force, *torque]
        self.state.body_f.assign(wrench)

    def drive(self, force: float, dof: int = 0) -> None:
        """Set the force of a joint's degree of freedom [N or N m]."""
        forces = self.control.joint_f.numpy().copy()
        forces[dof] = force
        self.control.joint_f.assign(forces)

    def finite(self) -> bool:
        """Whether the state is finite and the solver has not given up on it."""
        status = getattr(self.solver, "status", None)
        held = getattr(status, "held_steps", None)
        arrays = (self.state.body_q.numpy(), self.state.body_qd.numpy())
        return all(np.isfinite(a).all() for a in arrays) and not np.any(held)


Measure = Callable[[Trial], float]
"""Simulates, and returns the value that the closed form predicts."""


def after(
    seconds: float, value: Measure, *, drive: float = 0.0, dof: int = 0, push: Any = None
) -> Measure:
    """Measure of a value after a time.

    Args:
        seconds: The time [s].
        value: What is then read off the trial.
        drive: Force of the joints' degree of freedom ``dof`` meanwhile [N or N m].
        dof: That degree of freedom.
        push: Force on the first body meanwhile [N]; None for none.
    """

    def measure(trial: Trial) -> float:
        if drive:
            trial.drive(drive, dof)
        if push is not None:
            trial.push(force=push)
        trial.run(seconds)
        return value(trial)

    return measure


@dataclass(frozen=True)
class Outcome:
    """What a solver made of a property.

    Attributes:
        property: Name of the property.
        solver: Name of the solver, a key of :data:`~newton_avbd.study.properties.solvers.SOLVERS`.
        verdict: ``"yes"``, ``"ignored"``, ``"not finite"``, ``"error: ..."``, the deviation from
            the closed form, or the rule that the solver follows.
        value: What was measured; None where nothing was, or what was waited for never happened.
        expected: The closed form; None where the solver has a choice.
        unauthored: What was measured without the property; None where that was not asked for.
        date: Day of the measurement, YYYY-MM-DD.
        processor: Name of the processor.
    """

    property: str
    solver: str
    verdict: str
    value: float | None
    expected: float | None
    unauthored: float | None = None
    date: str = ""
    processor: str = ""


def judge(property_: Property, solver: str) -> Outcome:
    """Try a solver on a property."""
    name, expected = property_.name, property_.expected
    hoped = None if math.isnan(expected) else expected
    try:
        with _quiet():
            value = _try(property_, solver, True)
            if value is None:
                return Outcome(name, solver, "not finite", None, hoped)
            if property_.rules:
                return Outcome(name, solver, _rule(property_, value), value, None)
            if abs(value - expected) <= property_.bound:
                return Outcome(name, solver, "yes", value, expected)
            without = _try(property_, solver, False)
    except Exception as error:  # solvers refuse in as many ways as there are solvers
        return Outcome(name, solver, f"error: {_short(error)}", None, hoped)
    ignored = without is not None and _same(value, without, expected)
    verdict = "ignored" if ignored else _deviation(property_, value)
    return Outcome(name, solver, verdict, _number(value), expected, _number(without))


def _number(value: float | None) -> float | None:
    """A number that JSON can hold."""
    return None if value is None or math.isinf(value) else value


def _same(value: float, without: float, expected: float) -> bool:
    """Whether authoring the property has made next to no difference."""
    if math.isinf(value) or math.isinf(without):
        return value == without
    return abs(value - without) <= IGNORED * abs(expected - without)


def _try(property_: Property, solver: str, authored: bool) -> float | None:
    """Value that a solver reaches; None if it does not stay finite."""
    trial = Trial(solver, property_, authored)
    value = float(trial.measure(trial))
    return value if trial.finite() and not math.isnan(value) else None


def _rule(property_: Property, value: float) -> str:
    """Name of the rule that gives a value, or the value."""
    name, nearest = min(property_.rules.items(), key=lambda rule: abs(rule[1] - value))
    return name if abs(nearest - value) <= property_.bound else f"{value:.3g}"


def _deviation(property_: Property, value: float) -> str:
    """How far a value is off: relative to the closed form, or absolute where that is zero."""
    if math.isinf(value):
        return "never"
    if property_.expected == 0.0:
        return f"{value:.2g} {property_.unit}"
    percent = 100.0 * (value / property_.expected - 1.0)
    return f"{percent:+.2g} %" if abs(percent) < 1000.0 else f"{value:.2g} {property_.unit}"


def _short(error: Exception) -> str:
    """The first sentence of an error, on one line."""
    text = re.sub(r"\s+", " ", str(error)).strip() or type(error).__name__
    text = re.split(r"[.;] ", text)[0].rstrip(".")
    return text if len(text) <= ERROR_LENGTH else f"{text[: ERROR_LENGTH - 3].rstrip()}..."


@contextmanager
def _quiet() -> Iterator[None]:
    """Leave warnings of solvers away: the table says what they do."""
    level = wp.config.log_level
    wp.config.log_level = wp.LOG_ERROR
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            wp.config.log_level = level
