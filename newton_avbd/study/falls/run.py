# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Letting robots fall with one solver, and how well energy, joints and limits are kept."""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import newton
import numpy as np
from numpy.typing import NDArray

from newton_avbd.io import solvers
from newton_avbd.measure import state as measure
from newton_avbd.measure.joints import Joints
from newton_avbd.measure.state import Array, Bodies
from newton_avbd.study.falls.scene import Start, make_model

GAIN = 0.01
"""Most energy that a fall may gain, as a share of what was there at the start."""

FAST = 3.0
"""How many times faster than that a center of mass may get: where one end of a rod stops, the other
goes at up to twice its speed, and a second link adds to it."""

SLOW = 1.0e-3
"""Speed of what should not move at all that is no fault [m/s]."""

CLOSED = 1.0e-4
"""Largest distance of the anchors of a joint [m]."""

PASSED = 1.0e-3
"""Largest violation of a limit [rad, or m]."""

LEAST = 1.0e-9
"""Energy that stands for none where it is divided by [J]."""

EVERY = 4
"""Steps between two states in which joints are looked at; energy is measured in each."""


@dataclass(frozen=True)
class Setup:
    """What solves a fall, and how.

    Attributes:
        solver: One of :data:`newton_avbd.io.names.SOLVERS`.
        dt: Time step [s].
        seconds: Time to simulate [s].
        iterations: Iterations a step; None for the solver's own.
        scheme: Of SolverAVBD; None for its own.
        parallel: Likewise.
    """

    solver: str = "avbd"
    dt: float = 1.0 / 240.0
    seconds: float = 3.0
    iterations: int | None = None
    scheme: str | None = None
    parallel: str | None = None

    @property
    def steps(self) -> int:
        """Steps of a run."""
        return max(1, round(self.seconds / self.dt))

    def make_solver(self, model: newton.Model) -> newton.solvers.SolverBase:
        """The solver."""
        options: dict[str, Any] = {"scheme": self.scheme, "parallel": self.parallel}
        options = {name: value for name, value in options.items() if value is not None}
        own = options if self.solver == "avbd" else {}
        return solvers.construct(self.solver, model, self.iterations, **own)


@dataclass
class Fall:
    """How a fall went.

    Attributes:
        robot: Name of the robot, or path of its file.
        start: Where it started.
        finite: Whether every state was finite, and the solver never had to freeze the world.
        gain: Most energy above the lowest so far, as a share of that at the start. Potential energy
            counts from the ground; rotors count.
        above: Most energy above that at the start, as a share of it.
        jump: Most energy gained in a single step, likewise.
        step: Number of that step.
        speed: Speed of the fastest center of mass [m/s].
        free: That of a free fall to the ground, from the speed and the height of the start, and,
            where joints spin, what all of them give together by their lever arms [m/s].
        separation: Largest distance of the anchors of a joint [m].
        limit: Largest violation of a limit [rad or m].
        bounded: Steps in which SolverAVBD had to bound the energy.
    """

    robot: str
    start: Start
    finite: bool = True
    gain: float = 0.0
    above: float = 0.0
    jump: float = 0.0
    step: int = 0
    speed: float = 0.0
    free: float = 0.0
    separation: float = 0.0
    limit: float = 0.0
    bounded: int = 0

    def failures(self) -> list[str]:
        """What is not as it must be, a word each; empty for a pass."""
        if not self.finite:
            return ["not finite"]
        found = {
            "gain": self.gain <= GAIN,
            "speed": self.speed <= max(FAST * self.free, SLOW),
            "joint": self.separation <= CLOSED,
            "limit": self.limit <= PASSED,
        }
        return [name for name, holds in found.items() if not holds]


def run_falls(
    robot: str,
    builder: newton.ModelBuilder,
    chosen: list[Start],
    setup: Setup,
    shown: Callable[[int, int], None],
) -> list[Fall]:
    """Let a robot fall from each start.

    SolverAVBD and others take all starts as worlds of one model; MuJoCo in C takes one by one.

    Args:
        robot: Its name.
        builder: The robot, see :func:`newton_avbd.study.falls.scene.bare`.
        chosen: The starts.
        setup: The solver.
        shown: Called with the steps made and all steps.

    Returns:
        How each went.
    """
    batches = [[start] for start in chosen] if setup.solver == "mujoco" else [chosen]
    total = len(batches) * setup.steps
    found: list[Fall] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for batch in batches:
            done = len(found) * setup.steps
            model = make_model(builder, batch)
            found += _run(robot, model, batch, setup, partial(_show, shown, done, total))
    return found


def _show(shown: Callable[[int, int], None], done: int, total: int, step: int) -> None:
    shown(done + step, total)


def _run(
    robot: str, model: newton.Model, batch: list[Start], setup: Setup, shown: Callable[[int], None]
) -> list[Fall]:
    solver = setup.make_solver(model)
    state, following, control = model.state(), model.state(), model.control()
    pipeline = contacts = None
    if model.shape_contact_pair_count and not solvers.detects_collisions(solver):
        pipeline = newton.CollisionPipeline(model, broad_phase="explicit")
        contacts = pipeline.contacts()
    probe = _Probe(model, batch)
    falls = [Fall(robot, start) for start in batch]
    start = lowest = before = probe.energy(state)
    scale = np.maximum(start, LEAST)
    speed = probe.speed(state)
    heights = probe.heights(state)
    free = np.sqrt(speed**2 + 2.0 * probe.weight * heights)
    free = np.maximum(free, np.array([start.spin for start in batch]) * probe.lever(state))
    gain, jump, above = (np.zeros(len(batch)) for _ in range(3))
    when = np.zeros(len(batch), int)
    apart, passed = np.zeros(len(batch)), np.zeros(len(batch))
    finite = np.ones(len(batch), bool)
    for step in range(setup.steps):
        if pipeline is not None:
            pipeline.collide(state, contacts)
        solver.step(state, following, control, contacts, setup.dt)
        state, following = following, state
        energy = probe.energy(state)
        finite &= np.isfinite(energy)
        change = np.where(finite, energy - before, 0.0)
        when = np.where(change > jump, step, when)
        jump = np.maximum(jump, change)
        gain = np.where(finite, np.maximum(gain, energy - lowest), gain)
        above = np.where(finite, np.maximum(above, energy - start), above)
        lowest, before = np.fmin(lowest, energy), energy
        speed = np.fmax(speed, probe.speed(state))
        if (step + 1) % EVERY == 0 or step + 1 == setup.steps:
            apart = np.fmax(apart, probe.separation(state))
            passed = np.fmax(passed, probe.limit(state))
            shown(step + 1)
        if not finite.any():
            break
    status = getattr(solver, "status", None)
    held = np.zeros(len(batch)) if status is None else np.resize(status.held_steps, len(batch))
    bounded = np.resize(getattr(status, "bounded_steps", np.zeros(1)), len(batch))
    for i, fall in enumerate(falls):
        fall.finite = bool(finite[i] and not held[i])
        fall.gain = float(gain[i] / scale[i]) if fall.finite else math.inf
        fall.above = float(above[i] / scale[i])
        fall.jump, fall.step = float(jump[i] / scale[i]), int(when[i])
        fall.speed, fall.free = float(speed[i]), float(free[i])
        fall.separation, fall.limit = float(apart[i]), float(passed[i])
        fall.bounded = int(bounded[i])
    return falls


class _Probe:
    """Measures the states of a model by world; all arrays have shape [worlds]."""

    def __init__(self, model: newton.Model, batch: list[Start]):
        self._count = len(batch)
        self._bodies, self._joints = Bodies.of(model), Joints.of(model)
        self._world = model.body_world.numpy()
        self._of_joint = self._world[self._joints.child]
        self._has_rotors = bool(self._joints.armature.any())
        self._rotors = np.zeros(len(self._joints.child))
        self.weight = np.array([-start.gravity[2] for start in batch])
        mass = np.bincount(self._world, self._bodies.mass, self._count)
        self._offset = mass * self.weight * np.array([start.ground for start in batch])

    def energy(self, state: newton.State) -> Array:
        """Kinetic energy of bodies and rotors, and potential energy above the ground [J]."""
        q, qd = _read(state)
        energy = measure.kinetic_energy(self._bodies, q, qd)
        energy += measure.potential_energy(self._bodies, q)
        total = np.bincount(self._world, energy, self._count) - self._offset
        if self._has_rotors:
            rates = self._joints.rates(q, qd, self._bodies.com)
            rotors = 0.5 * np.sum(self._joints.armature * rates**2, axis=1)
            # of rotors whose rates the bodies do not tell, the last that they told
            self._rotors = np.where(np.isfinite(rotors), rotors, self._rotors)
            total += np.bincount(self._of_joint, self._rotors, self._count)
        return np.asarray(total)

    def speed(self, state: newton.State) -> Array:
        """Speed of the fastest center of mass [m/s]."""
        return self._largest(self._world, np.linalg.norm(_read(state)[1][:, :3], axis=1))

    def heights(self, state: newton.State) -> Array:
        """Height of the highest center of mass above the ground [m]."""
        centers = measure.transform(_read(state)[0], self._bodies.com)
        ground = np.divide(
            self._offset,
            self.weight * np.bincount(self._world, self._bodies.mass, self._count),
            out=np.zeros(self._count),
            where=self.weight > 0.0,
        )
        return self._largest(self._world, centers[:, 2] - ground[self._world])

    def lever(self, state: newton.State) -> Array:
        """Sum of the lengths from joint to joint on the longest way through a tree [m]."""
        q = _read(state)[0]
        joints = self._joints
        anchor = measure.transform(q[joints.child], joints.child_frame[:, :3])
        way = np.zeros(len(q))
        at: dict[int, Array] = {}
        centers = measure.transform(q, self._bodies.com)
        for joint, (parent, child) in enumerate(zip(joints.parent, joints.child, strict=True)):
            # parents come before children; a root that floats swings on its joint, too
            known = 0.0
            if parent in at:
                known = way[parent] + float(np.linalg.norm(anchor[joint] - at[parent]))
            elif parent >= 0:
                known = float(np.linalg.norm(anchor[joint] - centers[parent]))
            way[child], at[child] = known, anchor[joint]
        for body, point in at.items():
            way[body] += float(np.linalg.norm(centers[body] - point))
        return 2.0 * self._largest(self._world, way)

    def separation(self, state: newton.State) -> Array:
        """Largest distance of the anchors of a joint [m]."""
        return self._largest(self._of_joint, self._joints.separation(_read(state)[0]))

    def limit(self, state: newton.State) -> Array:
        """Largest violation of a limit [rad or m]."""
        return self._largest(self._of_joint, self._joints.limit_violation(_read(state)[0]))

    def _largest(self, world: NDArray[np.int64], values: Array) -> Array:
        found = np.zeros(self._count)
        np.fmax.at(found, world, values)
        return found


def _read(state: newton.State) -> tuple[Array, Array]:
    return state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
