# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Hard cases that must stand: tall, leaning on each other, or heavy on light.

All rest from the start, their blocks exactly touching. Rigid blocks of decimeters may sink
:data:`SUNK` into each other and no more; then no block moves by more than what lies under it sinks,
and what is lifted out again gains no more energy than that.
"""

import math
from functools import partial

import newton
import numpy as np
import warp as wp

from newton_avbd.scenes.named import add_card_house, add_ground, add_pyramid, add_stack, add_wall
from newton_avbd.study.stability.case import Bounds, Catalog

SUNK = 1e-4
"""Penetration of resting blocks [m]."""

PILES = Catalog()
"""Piles by name."""


def standing(layers: int, sunk: float = SUNK) -> Bounds:
    """Bounds of a pile at rest with this many layers on each other."""
    return Bounds(penetration=sunk, gain=sunk, drift=max(1e-3, layers * sunk))


def block(builder: newton.ModelBuilder, **material: float) -> newton.ModelBuilder.ShapeConfig:
    """Surface and density of a shape: friction 0.6, 1000 kg/m^3, detection gap 2 cm."""
    cfg = builder.default_shape_cfg.copy()
    for name, value in ({"mu": 0.6, "density": 1000.0, "gap": 0.02} | material).items():
        setattr(cfg, name, value)
    return cfg


def add_box(
    builder: newton.ModelBuilder,
    position: tuple[float, float, float],
    size: tuple[float, float, float],
    rotation: wp.quat | None = None,
    **material: float,
) -> int:
    """Add a free box with full edges ``size`` [m] of material :func:`block`."""
    turn = wp.quat_identity() if rotation is None else rotation
    body = builder.add_body(xform=wp.transform(wp.vec3(*position), turn))
    hx, hy, hz = (0.5 * edge for edge in size)
    builder.add_shape_box(body, hx=hx, hy=hy, hz=hz, cfg=block(builder, **material))
    return body


for count in (10, 20, 30, 40, 50):
    PILES.add(
        f"stack_{count}",
        f"a column of {count} boxes",
        partial(add_stack, count=count),
        standing(count),
        vbd_ke=1e8,
        is_quick=count <= 20,
    )

for rows in (10, 20, 30, 40):
    PILES.add(
        f"pyramid_{rows}",
        f"a pyramid of {rows} rows, {rows * (rows + 1) // 2} boxes",
        partial(add_pyramid, rows=rows),
        standing(rows),
        seconds=10.0,
        vbd_ke=4e6,
        is_quick=rows <= 10,
    )

PILES.add(
    "card_house",
    "a house of cards on five levels",
    partial(add_card_house, levels=5),
    standing(10),
    vbd_ke=1e5,
)


@PILES.declare(
    "thin_cards",
    "leaning cards of 2 mm x 40 cm under flat ones, on three levels, mu 0.7",
    # A tenth of a card's thickness
    Bounds(penetration=2e-4, gain=2e-4, drift=5e-3),
    is_quick=False,
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.7, gap=1e-3)
    thick, length, lean = 0.002, 0.4, math.radians(25.0)
    run, rise = length * math.sin(lean), length * math.cos(lean)
    side, lift = thick * math.cos(lean), thick * math.sin(lean)
    pitch, height = 2.0 * (run + side) + thick, rise + lift
    card = {"mu": 0.7, "density": 800.0, "gap": 1e-3}
    for level in range(3):
        base, pairs = level * (height + thick), 3 - level
        for i in range(pairs):
            apex = (i - 0.5 * (pairs - 1)) * pitch
            for sign in (-1.0, 1.0):
                turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), -sign * lean)
                at = (apex + sign * 0.5 * (run + side), 0.0, base + 0.5 * height)
                add_box(builder, at, (thick, 0.3, length), turn, **card)
        for i in range(pairs - 1):
            at = ((i - 0.5 * (pairs - 2)) * pitch, 0.0, base + height + 0.5 * thick)
            add_box(builder, at, (pitch - 0.5 * thick, 0.3, thick), **card)


@PILES.declare(
    "arch",
    "a dry-stone arch, 21 voussoirs on a half circle, a quarter as thick as its radius",
    # Heyman: a half circle stands from 0.11 of its radius on
    standing(21),
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.7)
    radius, thick, depth, count = 2.0, 0.5, 0.5, 21
    half = 0.5 * math.pi / count
    inner, outer = radius - 0.5 * thick, radius + 0.5 * thick
    corners = [
        (r * math.sin(a), y, r * math.cos(a) - radius)
        for y in (-0.5 * depth, 0.5 * depth)
        for r in (inner, outer)
        for a in (-half, half)
    ]
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = [(q[0], q[1 + i], q[2 + i]) for q in quads for i in range(2)]
    stone = newton.Mesh(np.array(corners), np.array(triangles).ravel())
    for i in range(count):
        turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), (2 * i + 1) * half - 0.5 * math.pi)
        at = wp.quat_rotate(turn, wp.vec3(0.0, 0.0, radius))
        body = builder.add_body(xform=wp.transform(at, turn))
        builder.add_shape_convex_hull(body, mesh=stone, cfg=block(builder, mu=0.7, density=2000.0))


PILES.add(
    "wall",
    "a brick wall of 12 courses in running bond",
    partial(add_wall, rows=12, columns=8),
    standing(12),
    vbd_ke=1e5,
)


@PILES.declare("ring", "a round tower of 10 courses with 16 bricks each", standing(10))
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.6)
    for course in range(10):
        for i in range(16):
            angle = 2.0 * math.pi * (i + 0.5 * (course % 2)) / 16
            at = (1.1 * math.cos(angle), 1.1 * math.sin(angle), 0.2 * course + 0.1)
            turn = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), angle)
            add_box(builder, at, (0.2, 0.38, 0.2), turn)


def _stands(ratio: int, layers: int) -> Bounds:
    """As any pile up to 1:1,000; above that it must stand, sunk by a twentieth of an edge."""
    return standing(layers) if ratio <= 1000 else standing(layers, sunk=0.025)


for power in range(1, 6):
    ratio = 10**power
    PILES.add(
        f"heavy_on_light_{ratio}",
        f"a box carries one of {ratio:,} times its mass",
        partial(add_stack, count=2, densities=(10.0, 10.0 * ratio)),
        _stands(ratio, 2),
        vbd_ke=1e6,
    )
for power in (3, 5):
    ratio = 10**power
    PILES.add(
        f"heavy_on_ten_{ratio}",
        f"ten boxes carry one of {ratio:,} times their mass",
        partial(add_stack, count=11, densities=(10.0,) * 10 + (10.0 * ratio,)),
        _stands(ratio, 11),
        vbd_ke=1e6,
    )
    PILES.add(
        f"light_between_heavy_{ratio}",
        f"three boxes and, between them, two of a {ratio:,}th of their mass",
        partial(add_stack, count=5, densities=(10.0 * ratio, 10.0)),
        _stands(ratio, 5),
        vbd_ke=1e6,
    )


def _drop_heavy(builder: newton.ModelBuilder, ratio: int) -> None:
    add_stack(builder, count=10, densities=(10.0,))
    add_box(builder, (0.0, 0.0, 5.55), (0.5, 0.5, 0.5), mu=0.5, density=10.0 * ratio)


for power in (3, 6):
    ratio = 10**power
    PILES.add(
        f"heavy_dropped_{ratio}",
        f"a box of {ratio:,} times their mass falls 30 cm onto ten boxes",
        partial(_drop_heavy, ratio=ratio),
        Bounds(penetration=SUNK, gain=SUNK, drift=0.301),
        vbd_ke=1e6,
    )
