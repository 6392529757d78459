# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What a scene with a known answer is, and how far a simulated path is from it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import newton
import numpy as np

from newton_avbd.measure.state import Array, Bodies, kinetic_energy, potential_energy, transform
from newton_avbd.scenes.scene import FRAMES_PER_SECOND, Scene

G = 9.81
"""Gravity of the scenes [m/s^2], along -z."""

FRAME = 1.0 / FRAMES_PER_SECOND
"""Time between two samples of a path, the largest step [s]."""


@dataclass(frozen=True)
class Path:
    """States that a solver went through, one a frame, the start first.

    Attributes:
        model: The model.
        body_q: Poses of its n bodies in k states, shape [k, n, 7].
        body_qd: Velocities of their centers of mass [m/s] and angular velocities [rad/s], shape
            [k, n, 6].
    """

    model: newton.Model
    body_q: Array
    body_qd: Array

    @cached_property
    def bodies(self) -> Bodies:
        """Mass properties."""
        return Bodies.of(self.model)

    @cached_property
    def times(self) -> Array:
        """Times of the states [s], shape [k]."""
        return np.arange(len(self.body_q), dtype=float) * FRAME

    @cached_property
    def centers(self) -> Array:
        """Centers of mass [m], shape [k, n, 3]."""
        return transform(self.body_q, self.bodies.com)

    @cached_property
    def energy(self) -> Array:
        """Kinetic and potential energy of all bodies [J], shape [k]."""
        pairs = zip(self.body_q, self.body_qd, strict=True)
        return np.array(
            [
                np.sum(kinetic_energy(self.bodies, q, qd) + potential_energy(self.bodies, q))
                for q, qd in pairs
            ]
        )

    @cached_property
    def momentum(self) -> Array:
        """Momentum of all bodies [kg m/s], shape [k, 3]."""
        return np.einsum("n,kni->ki", self.bodies.mass, self.body_qd[..., :3])


@dataclass(frozen=True)
class AccuracyScene:
    """A scene with an answer that is known without the solvers that are measured.

    Attributes:
        name: What tables and the command line call it.
        summary: What happens.
        reference: Where the answer comes from.
        measure: What the error is.
        build: Puts the scene into an empty builder.
        seconds: Time to simulate [s], a whole number of frames.
        error: Relative error of a path.
        solvers: Solvers to which the scene means something.
        touching: Whether bodies touch.
        sweeps: Whether iterations make a difference: not to bodies alone.
        wrench: Force [N] and torque [N m] on body 0, of the time at which a frame begins [s] and
            the bodies; constant in each frame.
        vbd_ke: Contact stiffness for SolverVBD [N/m], see :class:`Scene`.
        resolution: Relative error of the reference itself; smaller ones mean nothing.
        patience: How many times the time of other scenes each solver has.
        axis: What plots call the error.
    """

    name: str
    summary: str
    reference: str
    measure: str
    build: Callable[[newton.ModelBuilder], None]
    seconds: float
    error: Callable[[Path], float]
    solvers: tuple[str, ...]
    touching: bool = True
    sweeps: bool = True
    wrench: Callable[[float, Bodies], Array] | None = None
    vbd_ke: float | None = None
    resolution: float = 0.0
    patience: float = 1.0
    axis: str = "relative error"

    @property
    def frames(self) -> int:
        """Frames to simulate."""
        return round(self.seconds / FRAME)

    @property
    def interrupted(self) -> bool:
        """Whether there is something to do between frames: to detect contacts or set a force."""
        return self.touching or self.wrench is not None

    def scene(self, substeps: int) -> Scene:
        """The scene in steps of a frame's ``substeps``-th part."""
        return Scene(self.name, self.summary, self.build, FRAME / substeps, vbd_ke=self.vbd_ke)


@dataclass(frozen=True)
class OffPath:
    """Error of centers of mass: the largest distance from where they belong, at any time.

    It is relative to how far the fastest body belongs from its start.

    Attributes:
        belongs: Centers at the times of a path [m], shape [k, n, 3].
    """

    belongs: Callable[[Path], Array]

    def __call__(self, path: Path) -> float:
        """The error of a path."""
        right = self.belongs(path)
        return farthest(path.centers - right) / farthest(right - right[0])


def farthest(offsets: Array) -> float:
    """Length of the longest vector, shape [..., 3]."""
    return float(np.max(np.linalg.norm(offsets, axis=-1)))


def rms(values: Array) -> float:
    """Root of the mean square over time of values or vectors, shape [k] or [k, ...]."""
    squares = np.square(values).reshape(len(values), -1).sum(axis=1)
    return float(np.sqrt(np.mean(squares)))


def rebounds(times: Array, e: float, height: float) -> tuple[Array, Array]:
    """Height above the ground [m] and bounces so far of a ball let go from a height.

    Args:
        times: Times since then [s].
        e: Restitution, less than 1 or 1.
        height: Where it starts [m].
    """
    speed = math.sqrt(2.0 * G * height)
    # Counted as if it had been thrown up from the ground.
    start, count = -speed / G, 0
    heights, counts = np.zeros(len(times)), np.zeros(len(times), dtype=int)
    for index, t in enumerate(times):
        while t >= start + 2.0 * speed / G and speed > 1e-6:
            start, speed, count = start + 2.0 * speed / G, e * speed, count + 1
        since = t - start
        heights[index] = max(0.0, speed * since - 0.5 * G * since**2)
        counts[index] = count
    return heights, counts
