# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Ropes of 100 links swing as backward Euler, solved to convergence in float64, lets them swing.

And none spins where none should."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from helpers import Array, G
from scipy.linalg import solve_banded
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD
from newton_avbd.scenes.named import SCENES
from newton_avbd.study.contestants import NewtonContestant
from newton_avbd.study.peers import Peer

EYE = np.eye(3)
FORCE, PLACE, TURN = 0, 3, 6
"""Where a link's unknowns begin: force at its upper joint, position, turn in the step."""
UNKNOWNS = 9
BAND = 15
"""How far from the diagonal two unknowns that know of each other are: a link's turn, the next's
force."""


def crossing(vectors: Array) -> Array:
    """The matrices whose product with a vector is the cross product, shape (n, 3, 3)."""
    return -np.cross(vectors[:, None, :], EYE)


@dataclass
class Rope:
    """Links on ball joints that hang from the world, in float64.

    Attributes:
        mass: Shape (n,) [kg].
        inertia: In the links' frames, shape (n, 3, 3) [kg m^2].
        arm: From a link's center to its lower joint, in its frame, shape (3,) [m].
        place: Centers, shape (n, 3) [m].
        turn: Rotations of n links.
        velocity: Shape (n, 3) [m/s].
        spin: Angular velocities in the world, shape (n, 3) [rad/s].
    """

    mass: Array
    inertia: Array
    arm: Array
    place: Array
    turn: Rotation
    velocity: Array
    spin: Array

    def __post_init__(self) -> None:
        self.top = (self.place - self.turn.apply(self.arm))[0]
        self.force = np.zeros_like(self.place)

    @property
    def energy(self) -> float:
        """Kinetic energy, and potential energy above the origin [J]."""
        moving = np.einsum("ni,nij,nj", self.spin, self._world_inertia(), self.spin)
        moving += np.sum(self.mass[:, None] * self.velocity**2)
        return float(0.5 * moving + G * self.mass @ self.place[:, 2])

    def step(self, h: float) -> None:
        """One step of backward Euler, of momentum and of angular momentum, by Newton's method."""
        place, turn = self.place, self.turn
        momentum = self.mass[:, None] * self.velocity
        spun = np.einsum("nij,nj->ni", self._world_inertia(), self.spin)
        self.place = place + h * self.velocity
        self.turn = Rotation.from_rotvec(h * self.spin) * turn
        for _ in range(30):
            self.velocity = (self.place - place) / h
            self.spin = (self.turn * turn.inv()).as_rotvec() / h
            update = self._update(momentum, spun, h)
            self.force += update[:, FORCE:PLACE]
            self.place = self.place + update[:, PLACE:TURN]
            self.turn = Rotation.from_rotvec(update[:, TURN:]) * self.turn
            if np.abs(update[:, PLACE:]).max() < 1.0e-11:
                return
        raise RuntimeError("Newton's method did not converge.")

    def _world_inertia(self) -> Array:
        frame = self.turn.as_matrix()
        return np.einsum("nij,njk,nlk->nil", frame, self.inertia, frame)

    def _update(self, momentum: Array, spun: Array, h: float) -> Array:
        """What closes all joints and balances all forces, to first order, shape (n, 9)."""
        count = len(self.mass)
        arm, inertia = self.turn.apply(self.arm), self._world_inertia()
        below = np.vstack([self.force[1:], np.zeros(3)])
        lacks = np.zeros((count, UNKNOWNS))
        lacks[:, FORCE:PLACE] = self.place - arm
        lacks[:, FORCE:PLACE] -= np.vstack([self.top, (self.place + arm)[:-1]])
        lacks[:, PLACE:TURN] = (self.mass[:, None] * self.velocity - momentum) / h
        lacks[:, PLACE:TURN] += below - self.force
        lacks[:, PLACE + 2] += G * self.mass
        lacks[:, TURN:] = (np.einsum("nij,nj->ni", inertia, self.spin) - spun) / h
        lacks[:, TURN:] += np.cross(arm, self.force + below)

        matrix = np.zeros((2 * BAND + 1, UNKNOWNS * count))
        row, column = np.mgrid[:3, :3]

        def put(blocks: Array, links: Array, what: int, others: Array, of: int) -> None:
            i = UNKNOWNS * links[:, None, None] + what + row
            j = UNKNOWNS * others[:, None, None] + of + column
            matrix[BAND + i - j, j] = blocks

        link = np.arange(count)
        first, second, lever = link[:-1], link[1:], crossing(arm)
        put(EYE, link, FORCE, link, PLACE)
        put(lever, link, FORCE, link, TURN)
        put(-EYE, second, FORCE, first, PLACE)
        put(lever[:-1], second, FORCE, first, TURN)
        put(self.mass[:, None, None] / h**2 * EYE, link, PLACE, link, PLACE)
        put(-EYE, link, PLACE, link, FORCE)
        put(EYE, first, PLACE, second, FORCE)
        put(inertia / h**2 + crossing(self.force + below) @ lever, link, TURN, link, TURN)
        put(lever, link, TURN, link, FORCE)
        put(lever[:-1], first, TURN, second, FORCE)
        return solve_banded((BAND, BAND), matrix, -lacks.ravel()).reshape(count, UNKNOWNS)


def swinging(name: str, **options: Any) -> Any:
    """A rope of the benchmark, and the solver with some settings at work on it."""
    return NewtonContestant(SCENES[name], Peer("", lambda model: SolverAVBD(model, **options)))


@pytest.mark.parametrize("name", ["rope", "rope_100000"])
def test_a_rope_swings_as_the_converged_scheme_lets_it(name: str) -> None:
    """For 5 s, ends of a link's mass and of 100,000 times as much: energy within 1e-4.

    Backward Euler itself takes 3.4 % and 2.5 % of it, and the light rope cracks its whip. Centers
    are within 2 mm of 20 m.
    """
    contestant = swinging(name, scheme="euler")
    model = contestant.model
    pose = model.body_q.numpy().astype(float)
    still = np.zeros((model.body_count, 3))
    rope = Rope(
        mass=model.body_mass.numpy().astype(float),
        inertia=model.body_inertia.numpy().astype(float),
        arm=-model.joint_X_c.numpy()[0, :3].astype(float),
        place=pose[:, :3],
        turn=Rotation.from_quat(pose[:, 3:]),
        velocity=still,
        spin=still,
    )
    for _ in range(1200):
        rope.step(1.0 / 240.0)
    quality = contestant.run(seconds=5.0, budget=np.inf)
    assert quality.joints.energy == pytest.approx(rope.energy, rel=1.0e-4)
    assert quality.joints.separation < 1.0e-4
    center = contestant.observe().body_q.numpy()[:, :3]
    assert np.linalg.norm(center - rope.place, axis=1).max() < 2.0e-3


def test_links_of_a_taut_rope_do_not_spin_about_themselves() -> None:
    """Nothing turns a link about the line of its joints while a heavy end stretches the rope.

    Where the rope is pulled straight, within 0.8 s, a step that ends before it has settled may turn
    links about that line by a radian, 240 rad/s. Steps an eighth as long have 4 rad/s after 0.9 s.
    """
    rope = swinging("rope_100000", scheme="generalized_alpha")
    rope.run(seconds=0.9, budget=np.inf)
    state = rope.observe()
    line = Rotation.from_quat(state.body_q.numpy()[:, 3:]).apply([1.0, 0.0, 0.0])
    spin = np.sum(state.body_qd.numpy()[:, 3:] * line, axis=1)
    assert np.abs(spin).max() < 10.0
