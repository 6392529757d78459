# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Hard cases of thin and fast bodies, at 60 steps a second with collisions detected once a step.

What moves by many times its size in a step is met only by a detection that looks ahead as far; all
of these cases say how far (:attr:`~.case.Case.speculative`).
"""

import math
from functools import partial
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd.scenes.named import add_ground, set_velocity
from newton_avbd.study.stability.bodies import beyond
from newton_avbd.study.stability.case import Bounds, Catalog, Trial
from newton_avbd.study.stability.joints import at
from newton_avbd.study.stability.piles import SUNK, add_box, block

FAST = Catalog()
"""Cases of thin and fast bodies by name."""

RATE: dict[str, Any] = {"dt": 1.0 / 60.0}

THICK = 1e-3
"""Thickness of the plates and the needles [m]."""


def _add_plate(builder: newton.ModelBuilder, lean: float) -> None:
    """A steel plate of half a meter, its lowest edge 20 cm above the ground.

    A plane meets the four lowest corners of a box, those of one edge until the plate lies flatter
    than its thickness; so it has a ball in each corner, which reports itself.
    """
    add_ground(builder, mu=0.5, gap=0.01)
    turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), lean)
    height = 0.2 + 0.25 * math.sin(lean)
    plate = add_box(builder, (0.0, 0.0, height), (0.5, 0.5, THICK), turn, density=7800.0, gap=0.01)
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        corner = at(0.2495 * x, 0.2495 * y, 0.0)
        cfg = block(builder, density=0.0, gap=0.01)
        builder.add_shape_sphere(plate, xform=corner, radius=0.5 * THICK, cfg=cfg)


for name, lean in (("flat", 0.0), ("edge", math.radians(85.0))):
    FAST.add(
        f"plate_{name}",
        f"a plate 500 times as wide as thick, 1 mm, falls by 20 cm {name}",
        partial(_add_plate, lean=lean),
        # a quarter of its thickness
        Bounds(penetration=0.25 * THICK, gain=1e-3, rest=SUNK),
        # the edge that falls over comes down at 5 m/s, 9 cm a step
        speculative=0.2,
        seconds=3.0,
        **RATE,
    )


def _needle(builder: newton.ModelBuilder, pose: wp.transform) -> int:
    """A needle of steel, 1,000 times as long as thick."""
    body = builder.add_body(xform=pose)
    cfg = block(builder, density=7800.0, gap=0.005)
    builder.add_shape_capsule(body, radius=0.5 * THICK, half_height=499.5 * THICK, cfg=cfg)
    return body


def _add_needle(builder: newton.ModelBuilder, angular: tuple[float, float, float]) -> None:
    """A needle a meter above the ground."""
    add_ground(builder, mu=0.5, gap=0.005)
    tilt = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), 0.5 * math.pi)
    set_velocity(builder, _needle(builder, at(0.0, 0.0, 1.0, tilt)), angular=angular)


def _add_needles(builder: newton.ModelBuilder) -> None:
    """Twenty needles above each other, which are thrown, and turn, anyhow."""
    add_ground(builder, mu=0.5, gap=0.005)
    rng = np.random.default_rng(1000)
    for k in range(20):
        turn = rng.normal(size=4)
        x, y = rng.uniform(-0.3, 0.3, 2)
        pose = at(x, y, 1.6 + 0.15 * k, wp.quat(*(turn / np.linalg.norm(turn))))
        body = _needle(builder, pose)
        linear, angular = rng.uniform(-3.0, 3.0, 3), rng.uniform(-10.0, 10.0, 3)
        set_velocity(builder, body, tuple(linear), tuple(angular))


for name, angular in (
    ("rolls", (1000.0, 0.0, 0.0)),
    ("twirls", (0.0, 0.0, 100.0)),
    ("tumbles", (5.0, 20.0, 0.0)),
):
    FAST.add(
        f"needle_{name}",
        f"a needle 1,000 times as long as thick {name} at "
        f"{max(map(abs, angular)):,.0f} rad/s and falls",
        partial(_add_needle, angular=angular),
        # a quarter of its thickness; of one that tumbles the end comes down by 17 cm a step
        Bounds(penetration=0.5 * THICK if name == "tumbles" else 0.25 * THICK, gain=1e-3),
        # its end comes down at 10 m/s
        speculative=0.5,
        seconds=2.0,
        **RATE,
    )


FAST.add(
    "needles_land",
    "20 needles 1,000 times as long as thick tumble on each other",
    _add_needles,
    # how deep cannot be said: they cross each other between two detections
    Bounds(gain=1e-3),
    speculative=1.0,
    seconds=4.0,
    **RATE,
)


def _crossed(trial: Trial) -> float:
    """How far two bodies that fly at each other along x have got through each other [m]."""
    return max(0.0, float(trial.centers()[0, 0] - trial.centers()[1, 0]))


def _add_bullet(
    builder: newton.ModelBuilder,
    x: float,
    speed: float,
    angular: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """A slug of 1 cm x 1 cm x 2 cm that flies along x."""
    body = add_box(builder, (x, 0.003, 0.002), (0.02, 0.01, 0.01), density=7800.0, gap=0.01)
    set_velocity(builder, body, (speed, 0.0, 0.0), angular)


def _add_shot(
    builder: newton.ModelBuilder,
    speed: float,
    is_free: bool,
    angular: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    builder.gravity = (0.0, 0.0, 0.0)
    _add_bullet(builder, 0.0, speed, angular)
    wall = (0.01, 1.0, 1.0)
    if is_free:
        add_box(builder, (5.005, 0.0, 0.0), wall, density=7800.0, gap=0.01)
    else:
        half = dict(zip(("hx", "hy", "hz"), (0.5 * edge for edge in wall), strict=True))
        builder.add_shape_box(-1, xform=at(5.005), cfg=block(builder, gap=0.01), **half)


def _add_pair(builder: newton.ModelBuilder, speed: float) -> None:
    builder.gravity = (0.0, 0.0, 0.0)
    _add_bullet(builder, -5.0, speed)
    _add_bullet(builder, 5.3, -speed)


for speed in (100.0, 1000.0):
    for label, is_free in (("wall", False), ("slab", True)):
        against = "a free slab" if is_free else "a wall"
        FAST.add(
            f"bullet_{speed:.0f}_{label}",
            f"a slug of 2 cm at {speed:,.0f} m/s against {against} of 1 cm",
            partial(_add_shot, speed=speed, is_free=is_free),
            # it does not get through the wall, and nothing comes from nowhere
            Bounds(
                penetration=SUNK, gain=1e-3 * 0.5 * speed**2 / 9.81, drift=None if is_free else 0.0
            ),
            drift=beyond(5.0),
            speculative=speed / 60.0 * 1.1,
            seconds=0.5,
            **RATE,
        )
    FAST.add(
        f"bullet_{speed:.0f}_turns",
        f"a slug of 2 cm at {speed:,.0f} m/s that turns by 2 rad a step against a wall of 1 cm",
        partial(_add_shot, speed=speed, is_free=False, angular=(60.0, 30.0, 90.0)),
        # how deep cannot be said: detection does not see how it turns
        Bounds(gain=1e-3 * 0.5 * speed**2 / 9.81, drift=0.0),
        drift=beyond(5.0),
        speculative=speed / 60.0 * 1.1 + 0.1,
        seconds=0.5,
        **RATE,
    )
    FAST.add(
        f"bullets_{speed:.0f}",
        f"two slugs of 2 cm at {speed:,.0f} m/s fly at each other",
        partial(_add_pair, speed=speed),
        Bounds(penetration=SUNK, gain=1e-3 * 0.5 * speed**2 / 9.81, drift=0.0),
        drift=_crossed,
        speculative=speed / 60.0 * 1.1,
        seconds=0.5,
        **RATE,
    )
