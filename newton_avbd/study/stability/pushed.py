# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Hard cases of piles that are pushed, all bodies of which speed up as one, or that something hits.

What is lost of the push, or of momentum, shows in nothing but their speed: contacts stay closed,
and no energy is gained.
"""

from collections.abc import Callable
from functools import partial

import newton
import numpy as np

from newton_avbd.scenes.named import add_ground, set_velocity
from newton_avbd.study.stability.case import Bounds, Catalog, G, Trial
from newton_avbd.study.stability.joints import OPEN, at
from newton_avbd.study.stability.piles import SUNK, add_box, block

PUSHED = Catalog()
"""Cases of pushed piles by name."""

MU = 0.4
"""Friction of all that slides on the ground."""

ACCELERATION = 2.0
"""Acceleration that the push gives beyond the friction of the ground [m/s^2]."""

SECONDS = 2.0

SPEED = 2.0
"""Of what hits a pile [m/s]."""

LOST = 0.01 * ACCELERATION * SECONDS
"""How far the mean speed may be off [m/s]: a hundredth of what it gets to."""


class _Push:
    """A constant force along x on one body, as large as all are to speed up by."""

    def __init__(self, body: int, mu: float = MU) -> None:
        self._body = body
        self._mu = mu

    def act(self, trial: Trial, step: int) -> bool:
        """Push in the next step."""
        del step  # it is constant
        force = (ACCELERATION + self._mu * G) * float(np.sum(trial.bodies.mass))
        trial.push(self._body, (force, 0.0, 0.0, 0.0, 0.0, 0.0))
        return False


def _mean_speed(trial: Trial) -> float:
    """Of all mass, along x [m/s]."""
    return float(np.average(trial.velocities()[:, 0], weights=trial.bodies.mass))


def _off(trial: Trial) -> float:
    """By how much the mean speed of all mass is off what the push gives [m/s]."""
    return abs(_mean_speed(trial) - ACCELERATION * trial.time)


def _off_momentum(trial: Trial) -> float:
    """By what share of it the momentum along x is off that of what hits the pile, the last body."""
    mass = trial.bodies.mass
    return abs(_mean_speed(trial) * float(np.sum(mass)) / (SPEED * float(mass[-1])) - 1.0)


def _declare(
    name: str, summary: str, build: Callable[[newton.ModelBuilder], None], push: _Push
) -> None:
    PUSHED.add(
        name,
        summary,
        build,
        Bounds(penetration=SUNK, joint=OPEN, drift=LOST),
        seconds=SECONDS,
        drift=_off,
        drift_unit="m/s",
        act=push.act,
        vbd_ke=1e7,
    )


def _declare_struck(name: str, summary: str, build: Callable[[newton.ModelBuilder], None]) -> None:
    PUSHED.add(
        name,
        summary,
        build,
        Bounds(penetration=SUNK, joint=OPEN, drift=0.01),
        seconds=0.5,
        drift=_off_momentum,
        drift_unit="",
        vbd_ke=1e7,
    )


def _add_cubes(builder: newton.ModelBuilder, layers: tuple[int, ...]) -> None:
    """Add layers of cubes of half a meter that touch, each on the middle of the one below."""
    add_ground(builder, mu=MU)
    for layer, count in enumerate(layers):
        for i in range(count):
            position = (0.5 * (0.5 * (count - 1) - i), 0.0, 0.5 * layer + 0.25)
            add_box(builder, position, (0.5, 0.5, 0.5), mu=MU)


def _add_loaded_cart(builder: newton.ModelBuilder) -> None:
    """Add a flat cart without friction under it, and a wall of four courses on it."""
    add_ground(builder, mu=0.0)
    add_box(builder, (0.0, 0.0, 0.1), (3.0, 1.0, 0.2), mu=0.8)
    for course in range(4):
        for i in range(4):
            x = 0.5 * i - 0.875 + 0.25 * (course % 2)
            add_box(builder, (x, 0.0, 0.45 + 0.5 * course), (0.5, 0.5, 0.5), mu=0.8)


def _add_pusher(builder: newton.ModelBuilder) -> None:
    """Add a block on a slider, without friction, and three cubes in front of it."""
    pusher = builder.add_link(xform=at(-1.0, 0.0, 0.3))
    builder.add_shape_box(pusher, hx=0.25, hy=0.25, hz=0.25, cfg=block(builder, mu=0.0))
    joint = builder.add_joint_prismatic(
        -1, pusher, axis=(1.0, 0.0, 0.0), parent_xform=at(-1.0, 0.0, 0.3)
    )
    builder.add_articulation([joint])
    _add_cubes(builder, (3,))


def _add_striker(builder: newton.ModelBuilder) -> None:
    """Add a cube of half a meter that slides to the origin along x, with no friction."""
    body = add_box(builder, (-0.55, 0.0, 0.25), (0.5, 0.5, 0.5), mu=0.0)
    set_velocity(builder, body, (SPEED, 0.0, 0.0))


def _add_struck_cubes(builder: newton.ModelBuilder, layers: tuple[int, ...]) -> None:
    """Add layers of cubes on ice, and one that hits them; layers stick to each other."""
    add_ground(builder, mu=0.0)
    mu = 0.0 if len(layers) == 1 else MU
    for layer, count in enumerate(layers):
        for i in range(count):
            position = (0.25 * layer + 0.5 * i + 0.25, 0.0, 0.5 * layer + 0.25)
            add_box(builder, position, (0.5, 0.5, 0.5), mu=mu)
    _add_striker(builder)


def _add_struck_trains(builder: newton.ModelBuilder) -> None:
    """Add three trains of two hinged cubes in a row on ice, and a cube that hits them."""
    add_ground(builder, mu=0.0)
    for i in range(3):
        x = 1.05 * i + 0.25
        cars = []
        for place in (x, x + 0.55):
            cars.append(builder.add_link(xform=at(place, 0.0, 0.25)))
            builder.add_shape_box(cars[-1], hx=0.25, hy=0.25, hz=0.25, cfg=block(builder, mu=0.0))
        joints = [builder.add_joint_free(child=cars[0])]
        joints.append(
            builder.add_joint_revolute(
                *cars, axis=(0.0, 0.0, 1.0), parent_xform=at(0.275), child_xform=at(-0.275)
            )
        )
        builder.add_articulation(joints)
    _add_striker(builder)


_declare(
    "pushed_row",
    "ten cubes in a row, pushed over the ground from behind",
    partial(_add_cubes, layers=(10,)),
    _Push(9),
)
_declare(
    "pushed_pyramid",
    "a pyramid of ten cubes, pushed over the ground at its lowest row",
    partial(_add_cubes, layers=(4, 3, 2, 1)),
    _Push(3),
)
_declare(
    "loaded_cart", "a wall of 16 bricks on a cart that is drawn", _add_loaded_cart, _Push(0, mu=0.0)
)
_declare(
    "pusher",
    "a block on a slider pushes three cubes over the ground",
    _add_pusher,
    _Push(0, mu=MU * 3.0 / 4.0),
)
_declare_struck(
    "struck_row", "a cube hits a row of ten on ice", partial(_add_struck_cubes, layers=(10,))
)
_declare_struck(
    "struck_pyramid",
    "a cube hits a pyramid of ten on ice",
    partial(_add_struck_cubes, layers=(4, 3, 2, 1)),
)
_declare_struck(
    "struck_trains", "a cube hits three trains of two cubes each on ice", _add_struck_trains
)
