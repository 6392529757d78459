# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Quantities by which a simulated state is judged: penetration, energy, speed, distance.

Plain NumPy in double precision, on copies of device data; not for use inside a step.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import newton
import numpy as np
from numpy.typing import NDArray

from newton_avbd.measure.overlaps import Overlap, find_overlaps
from newton_avbd.model.rotations import conjugate, rotate, transform

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bodies:
    """Mass properties of a model's bodies, n of them, read once.

    Attributes:
        mass: Mass [kg], shape [n].
        inertia: Inertia about the center of mass, body axes [kg m^2], shape [n, 3, 3].
        com: Center of mass in the body frame [m], shape [n, 3].
        gravity: Gravity that acts on the body [m/s^2], shape [n, 3].
        moving: Whether forces move the body: neither kinematic nor of mass 0, shape [n].
    """

    mass: Array
    inertia: Array
    com: Array
    gravity: Array
    moving: NDArray[np.bool_]

    @classmethod
    def of(cls, model: newton.Model) -> "Bodies":
        """Read the bodies of ``model``."""
        n = model.body_count
        kinematic = (model.body_flags.numpy() & int(newton.BodyFlags.KINEMATIC)) != 0
        mass = model.body_mass.numpy().astype(float)
        gravity = model.gravity.numpy().astype(float).reshape(-1, 3)
        return cls(
            mass=mass,
            inertia=model.body_inertia.numpy().astype(float).reshape(n, 3, 3),
            com=model.body_com.numpy().astype(float).reshape(n, 3),
            # World -1 is the last entry, which is how Newton's own kernels index it.
            gravity=gravity[model.body_world.numpy()],
            moving=(mass > 0.0) & ~kinematic,
        )


def kinetic_energy(bodies: Bodies, body_q: Array, body_qd: Array) -> Array:
    """Kinetic energy of each moving body, 1/2 m v.v + 1/2 w.(R I R^T w).

    Args:
        bodies: Mass properties.
        body_q: Body poses, shape [n, 7].
        body_qd: Velocity of the center of mass [m/s] and angular velocity [rad/s], both in the
            world frame, shape [n, 6].

    Returns:
        Energy [J], shape [n]; 0 for bodies that forces do not move.
    """
    v, w = body_qd[:, :3], body_qd[:, 3:]
    w_body = rotate(conjugate(body_q[:, 3:]), w)
    turning = np.einsum("ni,nij,nj->n", w_body, bodies.inertia, w_body)
    energy = 0.5 * (bodies.mass * np.einsum("ni,ni->n", v, v) + turning)
    return np.where(bodies.moving, energy, 0.0)


def spin_momenta(bodies: Bodies, body_q: Array, body_qd: Array) -> Array:
    """Angular momentum of each body about its center of mass, R I R^T w [kg m^2/s], shape [n, 3].

    World frame; arguments as of :func:`kinetic_energy`.
    """
    w_body = rotate(conjugate(body_q[:, 3:]), body_qd[:, 3:])
    return rotate(body_q[:, 3:], np.einsum("nij,nj->ni", bodies.inertia, w_body))


def potential_energy(bodies: Bodies, body_q: Array) -> Array:
    """Potential energy of each moving body, -m g.c, zero at the world's origin.

    Args:
        bodies: Mass properties.
        body_q: Body poses, shape [n, 7].

    Returns:
        Energy [J], shape [n].
    """
    com = transform(body_q, bodies.com)
    energy = -bodies.mass * np.einsum("ni,ni->n", bodies.gravity, com)
    return np.where(bodies.moving, energy, 0.0)


def total_energy(bodies: Bodies, state: newton.State) -> float:
    """Kinetic and potential energy of all moving bodies in ``state`` [J]."""
    body_q, body_qd = _poses(state.body_q), _twists(state.body_qd)
    return float(np.sum(kinetic_energy(bodies, body_q, body_qd) + potential_energy(bodies, body_q)))


def largest_speed(bodies: Bodies, state: newton.State) -> float:
    """Speed of the fastest moving body's center of mass in ``state`` [m/s]."""
    speed = np.linalg.norm(_twists(state.body_qd)[:, :3], axis=1)
    return _largest(speed[bodies.moving])


def shapes_and_gaps(
    model: newton.Model, bodies: Bodies, state: newton.State, contacts: newton.Contacts
) -> tuple[NDArray[np.int64], Array]:
    """Shapes and gap of each contact that a moving body takes part in, at the poses of ``state``.

    The gap is n.(X1 p1 - X0 p0) - margin0 - margin1 with the contact's normal n and points p as
    Newton's collision pipeline reported them.

    Args:
        model: The model.
        bodies: Its mass properties.
        state: Poses to measure at; may be later than the detection.
        contacts: Detected contacts.

    Returns:
        Indices of the two shapes, shape [k, 2], and gaps [m], shape [k]; negative where shapes
        penetrate.
    """
    count = min(int(contacts.rigid_contact_count.numpy()[0]), contacts.rigid_contact_max)
    if count == 0:
        return np.empty((0, 2), np.int64), np.empty(0)
    shape_body = np.append(model.shape_body.numpy(), -1)
    # Row -1 is the world: the identity pose, and nothing that moves.
    poses = np.vstack([_poses(state.body_q), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    moving = np.append(bodies.moving, False)

    def rows(array: Any) -> NDArray[Any]:
        return array.numpy()[:count]

    shapes = np.stack(
        [rows(contacts.rigid_contact_shape0), rows(contacts.rigid_contact_shape1)], axis=1
    ).astype(np.int64)
    body0, body1 = shape_body[shapes[:, 0]], shape_body[shapes[:, 1]]
    point0 = transform(poses[body0], rows(contacts.rigid_contact_point0).astype(float))
    point1 = transform(poses[body1], rows(contacts.rigid_contact_point1).astype(float))
    margin = rows(contacts.rigid_contact_margin0) + rows(contacts.rigid_contact_margin1)
    normal = rows(contacts.rigid_contact_normal).astype(float)
    gap = np.einsum("ni,ni->n", normal, point1 - point0) - margin
    kept = moving[body0] | moving[body1]
    return shapes[kept], gap[kept]


def deepest_penetration(gaps: Array) -> float:
    """Largest overlap among ``gaps`` as :func:`shapes_and_gaps` returns them [m], at least 0."""
    return _largest(-gaps)


def distances(bodies: Bodies, body_q_a: Array, body_q_b: Array) -> Array:
    """Distance between where two runs have each moving body's center of mass.

    Args:
        bodies: Mass properties.
        body_q_a: Body poses of one run, shape [n, 7].
        body_q_b: Body poses of the other, shape [n, 7].

    Returns:
        Distances [m], shape [moving bodies].
    """
    offset = transform(body_q_a, bodies.com) - transform(body_q_b, bodies.com)
    return np.linalg.norm(offset, axis=1)[bodies.moving]


class Probe:
    """Measures states of one model with a collision pipeline of its own.

    Detection anew on the poses that are measured, by the same pipeline whatever the solver, keeps
    the numbers of two solvers comparable. What overlaps for good (:mod:`overlaps`) is told apart
    from penetration.
    """

    def __init__(self, model: newton.Model):
        self.model = model
        self.bodies = Bodies.of(model)

    @cached_property
    def _detection(self) -> tuple[newton.CollisionPipeline, newton.Contacts]:
        # Sweep and prune: the default tests all pairs, which many bodies make slow.
        pipeline = newton.CollisionPipeline(self.model, broad_phase="sap", publish_capacity=False)
        return pipeline, pipeline.contacts()

    @cached_property
    def overlaps(self) -> tuple[Overlap, ...]:
        """Pairs of shapes that the model's joints cannot part, the deepest first."""
        return find_overlaps(self.model, self.contacts)

    def separations(self, state: newton.State) -> Array:
        """Gaps [m] between shapes in ``state``, without those of :attr:`overlaps`."""
        shapes, gaps = self.contacts(state)
        return gaps[~self._overlapping(shapes)]

    def overlap(self, state: newton.State) -> float:
        """Deepest overlap [m] in ``state`` of the pairs in :attr:`overlaps`."""
        shapes, gaps = self.contacts(state)
        return deepest_penetration(gaps[self._overlapping(shapes)])

    def energy(self, state: newton.State) -> float:
        """Energy [J] of ``state``, see :func:`total_energy`."""
        return total_energy(self.bodies, state)

    def speed(self, state: newton.State) -> float:
        """Largest speed [m/s] in ``state``, see :func:`largest_speed`."""
        return largest_speed(self.bodies, state)

    def contacts(self, state: newton.State) -> tuple[NDArray[np.int64], Array]:
        """Shapes and gaps of the contacts in ``state``, see :func:`shapes_and_gaps`."""
        pipeline, contacts = self._detection
        pipeline.collide(state, contacts)
        return shapes_and_gaps(self.model, self.bodies, state, contacts)

    def _overlapping(self, shapes: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which rows of ``shapes``, shape [k, 2], are pairs of :attr:`overlaps`, shape [k]."""
        count = max(1, self.model.shape_count)
        known = [a * count + b for a, b in (overlap.shapes for overlap in self.overlaps)]
        return np.isin(shapes.min(axis=1) * count + shapes.max(axis=1), known)


def _poses(array: Any) -> Array:
    return array.numpy().astype(float).reshape(-1, 7)


def _twists(array: Any) -> Array:
    return array.numpy().astype(float).reshape(-1, 6)


def _largest(values: Array) -> float:
    """Largest value, at least 0; NaN where one is NaN, so that a failed run cannot look good."""
    return float(np.max(values, initial=0.0))
