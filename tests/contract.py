# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What the contract tests share: a scene with everything in it, and ways to look at it exactly."""

from collections.abc import Sequence

import newton
import numpy as np
import warp as wp
from helpers import Simulation, add_box, add_ground, add_sphere
from numpy.typing import NDArray

ROWS = (
    "rigid_contact_shape0",
    "rigid_contact_shape1",
    "rigid_contact_point0",
    "rigid_contact_point1",
    "rigid_contact_offset0",
    "rigid_contact_offset1",
    "rigid_contact_normal",
    "rigid_contact_margin0",
    "rigid_contact_margin1",
)
"""Arrays of a contact buffer that hold one entry a contact."""

TILT = wp.quat_from_axis_angle(wp.normalize(wp.vec3(1.0, 2.0, 0.5)), 0.3)


def add_pile(builder: newton.ModelBuilder) -> None:
    """Ground, two stacked cubes, a tilted cube that falls on them, and a sphere beside that rolls.

    It takes off: resting contacts, an impact, sliding and rolling within 60 steps of 1/240 s.
    """
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.25))
    add_box(builder, (0.02, 0.0, 0.75))
    add_box(builder, (0.3, 0.1, 1.45), rotation=TILT)
    ball = add_sphere(builder, (0.62, 0.0, 0.25))
    builder.body_qd[ball] = wp.spatial_vector(-0.5, 0.2, 0.0, 0.0, 0.0, 0.0)


def pile() -> newton.ModelBuilder:
    """A builder with :func:`add_pile` in it."""
    builder = newton.ModelBuilder()
    add_pile(builder)
    return builder


def resting_box() -> newton.ModelBuilder:
    """A cube of 125 kg that rests on the ground on four contacts."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.25))
    return builder


def worlds(builder: newton.ModelBuilder, count: int) -> newton.ModelBuilder:
    """``count`` worlds with the same content at the same place."""
    many = newton.ModelBuilder()
    many.replicate(builder, count)
    return many


def snapshot(state: newton.State) -> NDArray[np.float32]:
    """Poses and velocities, as stored, shape (body_count, 13)."""
    return np.hstack([state.body_q.numpy(), state.body_qd.numpy()])


def record(simulation: Simulation, steps: int) -> NDArray[np.float32]:
    """Poses and velocities after each of ``steps`` steps, shape (steps, body_count, 13)."""
    frames = []
    for _ in range(steps):
        simulation.step()
        frames.append(snapshot(simulation.state))
    return np.stack(frames)


def reorder(contacts: newton.Contacts, order: Sequence[int]) -> None:
    """Puts the live contacts into another order: new row i is old row order[i]."""
    for name in ROWS:
        array = getattr(contacts, name)
        rows = array.numpy()
        rows[: len(order)] = rows[list(order)]
        array.assign(rows)


def contact_count(contacts: newton.Contacts) -> int:
    """Number of contacts that the last detection found."""
    return int(contacts.rigid_contact_count.numpy()[0])
