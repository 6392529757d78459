# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Hard cases of single bodies and contacts: thin, fast, pressed, overlapping, redundant."""

import math
from collections.abc import Callable
from functools import partial

import newton
import numpy as np
import warp as wp

from newton_avbd.measure.state import spin_momenta
from newton_avbd.model.rotations import rotate
from newton_avbd.scenes.named import add_ground, set_velocity
from newton_avbd.study.stability.case import Bounds, Catalog, Trial
from newton_avbd.study.stability.joints import at
from newton_avbd.study.stability.piles import SUNK, add_box, block, standing

BODIES = Catalog()
"""Cases of bodies and contacts by name."""


def fastest(trial: Trial) -> float:
    """Speed of the fastest body that forces move [m/s]."""
    speed = np.linalg.norm(trial.velocities()[:, :3], axis=1)[trial.bodies.moving]
    return float(np.max(speed, initial=0.0))


PRESS = 0.2
"""Speed of the press [m/s]."""


def _press(trial: Trial, step: int) -> bool:
    """Move the last body down for a second, then up."""
    dt, way = trial.case.step_size(step), trial.time if trial.time < 1.0 else 2.0 - trial.time
    speed = -PRESS if trial.time < 1.0 else PRESS
    body = trial.model.body_count - 1
    trial.place(body, (0.0, 0.0, 2.7 - PRESS * way, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, speed, 0, 0, 0))
    return dt > 0.0


@BODIES.declare(
    "crushed_stack",
    "a press takes 10 cm more than five boxes leave it, which is impossible, and lets go",
    # Whatever gives way moves like the press, or falls
    Bounds(drift=math.sqrt(2.0 * 9.81 * 0.5)),
    drift=fastest,
    drift_unit="m/s",
    act=_press,
    seconds=3.0,
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.5)
    for i in range(5):
        add_box(builder, (0.0, 0.0, 0.5 * i + 0.25), (0.5, 0.5, 0.5))
    press = builder.add_body(xform=at(0.0, 0.0, 2.7), is_kinematic=True)
    builder.add_shape_box(press, hx=1.0, hy=1.0, hz=0.1, cfg=block(builder))


def _pump(trial: Trial, step: int) -> bool:
    """Swing the last body, a piston, by 15 cm at 2 Hz; it goes to where the next step puts it."""
    body, dt = trial.model.body_count - 1, trial.case.step_size(step)
    height, end = (0.1 + 0.15 * math.sin(4.0 * math.pi * t) for t in (trial.time, trial.time + dt))
    speed = (end - height) / dt
    trial.place(body, (0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, speed, 0, 0, 0))
    return step >= 0


@BODIES.declare(
    "piston",
    "a kinematic piston throws 27 boxes of 1 kg up in a shaft, twice a second, at 15 m/s^2",
    # A hundredth of an edge in impacts at 4 m/s
    Bounds(penetration=2e-3),
    act=_pump,
    # boxes meet the piston at 4 m/s, 2 cm a step
    speculative=0.02,
)
def _(builder: newton.ModelBuilder) -> None:
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        builder.add_shape_box(
            -1,
            xform=at(0.5 * x, 0.5 * y, 1.0),
            hx=0.1 if x else 0.6,
            hy=0.1 if y else 0.6,
            hz=2.0,
            cfg=block(builder),
        )
    for i in range(27):
        position = (0.22 * (i % 3 - 1), 0.22 * (i // 3 % 3 - 1), 0.31 + 0.2 * (i // 9))
        add_box(builder, position, (0.2, 0.2, 0.2), density=125.0)
    piston = builder.add_body(xform=at(0.0, 0.0, 0.1), is_kinematic=True)
    builder.add_shape_box(piston, hx=0.38, hy=0.38, hz=0.1, cfg=block(builder))


@BODIES.declare(
    "thin_plate",
    "a plate of 1 m x 1 m x 2 mm falls on its edge; a box falls on it",
    # A quarter of its thickness
    Bounds(penetration=5e-4, gain=1e-3),
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.5, gap=0.02)
    tilt = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), math.radians(30.0))
    plate = add_box(builder, (0.0, 0.0, 0.6), (1.0, 1.0, 0.002), tilt, density=7800.0)
    # A plane meets the four lowest corners of a box, those of one edge until the plate lies flatter
    # than its thickness: round corners report themselves.
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        corner = at(0.499 * x, 0.499 * y, 0.0)
        builder.add_shape_sphere(plate, xform=corner, radius=0.001, cfg=block(builder, density=0.0))
    add_box(builder, (0.0, 0.0, 2.0), (0.2, 0.2, 0.2))


@BODIES.declare(
    "needle",
    "a needle of 60 cm x 2 mm, principal moments 1:60,000, falls and rolls",
    Bounds(penetration=2e-4, gain=1e-3),
    # its end comes down at 5 m/s, 2 cm a step
    speculative=0.05,
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.5, gap=0.01)
    tilt = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), math.radians(60.0))
    body = builder.add_body(
        xform=at(0.0, 0.0, 0.5, tilt),
        mass=0.015,
        inertia=wp.mat33(*np.diag([4.5e-4, 4.5e-4, 7.5e-9]).ravel()),
        lock_inertia=True,
    )
    cfg = block(builder, density=0.0, gap=0.01)
    builder.add_shape_capsule(body, radius=0.001, half_height=0.3, cfg=cfg)
    set_velocity(builder, body, (0.5, 0.0, 0.0), (0.0, 1.0, 3.0))


def _lost_momentum(trial: Trial) -> float:
    """Change of the spin momentum of the first body, relative to it."""
    start = (array.numpy().astype(float) for array in (trial.model.body_q, trial.model.body_qd))
    before = spin_momenta(trial.bodies, *start)[0]
    after = spin_momenta(trial.bodies, trial.poses(), trial.velocities())[0]
    return float(np.linalg.norm(after - before) / np.linalg.norm(before))


def _add_top(builder: newton.ModelBuilder, spin: float) -> None:
    builder.gravity = (0.0, 0.0, 0.0)
    body = add_box(builder, (0.0, 0.0, 1.0), (0.6, 0.3, 0.1))
    set_velocity(builder, body, angular=(0.1 * spin, spin, 0.1 * spin))


for power in (1, 2, 3, 4):
    rate = 10.0**power
    BODIES.add(
        f"top_{10**power}",
        f"a body with three different moments spins freely at {10**power:,} rad/s",
        partial(_add_top, spin=rate),
        # a thousandth of its kinetic energy, of its momentum
        Bounds(gain=1e-3 * 0.5 * (0.6**2 + 0.1**2) / 12.0 * rate**2 / 9.81, drift=1e-3),
        drift=_lost_momentum,
        drift_unit="",
        seconds=2.0,
    )


def _tilt(trial: Trial) -> float:
    """How far the spinning axis of the top has left its angle to the vertical [rad]."""
    axis = rotate(trial.poses()[0, 3:], np.array([0.0, 0.0, 1.0]))
    return abs(math.acos(np.clip(axis[2], -1.0, 1.0)) - math.radians(20.0))


def _add_spinning_top(builder: newton.ModelBuilder, spin: float) -> None:
    tilt = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), math.radians(20.0))
    axis = np.array(wp.quat_rotate(tilt, wp.vec3(0.0, 0.0, 1.0)))
    x, y, z = map(float, 0.1 * axis + [0.0, 0.0, 1.0])
    body = builder.add_link(xform=at(x, y, z, tilt))
    cfg = block(builder)
    cfg.has_shape_collision = False
    builder.add_shape_cylinder(body, radius=0.1, half_height=0.02, cfg=cfg)
    joint = builder.add_joint_ball(-1, body, parent_xform=at(0, 0, 1), child_xform=at(0, 0, -0.1))
    builder.add_articulation([joint])
    builder.joint_q[-4:] = list(map(float, np.array(tilt)))
    builder.body_qd[body] = wp.spatial_vector(0.0, 0.0, 0.0, *(spin * axis))


for power in (3, 4):
    rate = 10.0**power
    BODIES.add(
        f"spinning_top_{10**power}",
        f"a top on its point turns at {10**power:,} rad/s, 20 degrees off the vertical",
        partial(_add_spinning_top, spin=rate),
        # it precesses; nutation is 2 m g l sin / (I w)^2 A, microradians
        Bounds(joint=1e-4, gain=1e-4 * 0.25 * 0.1**2 * rate**2 / 9.81, drift=0.01),
        drift=_tilt,
        drift_unit="rad",
        seconds=2.0,
    )


def _add_heap(builder: newton.ModelBuilder) -> None:
    builder.gravity = (0.0, 0.0, 0.0)
    for i in range(8):
        add_box(builder, (0.2 * (i & 1), 0.2 * (i >> 1 & 1), 0.2 * (i >> 2)), (0.4, 0.4, 0.4))


BODIES.add(
    "overlap_free",
    "eight boxes at rest overlap by half their edges, no gravity",
    _add_heap,
    # Nothing pushes them but the solver: they may part, not fly
    Bounds(gain=1e-6, drift=1e-2),
    drift=fastest,
    drift_unit="m/s",
    seconds=2.0,
)


@BODIES.declare(
    "ellipsoids",
    "twelve ellipsoids settle in a bin; where two just touch detection finds no normal",
    # a tenth of the shortest axis in impacts at 2 m/s, and at rest what blocks may sink
    Bounds(penetration=0.1 * 0.08, gain=1e-3, rest=SUNK),
    seconds=3.0,
    speculative=0.1,
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.5)
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        wall = {"hx": 0.1 if x else 0.4, "hy": 0.1 if y else 0.4, "hz": 0.5}
        builder.add_shape_box(-1, xform=at(0.33 * x, 0.33 * y, 0.5), cfg=block(builder), **wall)
    rng = np.random.default_rng(3)
    for i in range(12):
        yaw, tilt = map(float, rng.uniform((0.0, -0.3), (2.0 * math.pi, 0.3)))
        turn = wp.quat_from_axis_angle(wp.vec3(math.cos(yaw), math.sin(yaw), 0.0), tilt)
        body = builder.add_body(xform=at(0.11 * (-1) ** i, 0.0, 0.06 + 0.11 * (i // 2), turn))
        builder.add_shape_ellipsoid(body, rx=0.1, ry=0.08, rz=0.04, cfg=block(builder))


@BODIES.declare(
    "overlap_ground",
    "three boxes within each other and half in the ground; until those that came up topple",
    # Slower than a fall from the depth
    Bounds(drift=math.sqrt(2.0 * 9.81 * 0.25)),
    drift=fastest,
    drift_unit="m/s",
    seconds=0.4,
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.5)
    for i in range(3):
        add_box(builder, (0.02 * i, 0.0, 0.3 * i), (0.5, 0.5, 0.5))


@BODIES.declare(
    "same_place",
    "three spheres and three boxes at the very same place, no gravity",
    Bounds(gain=1e-6, drift=1e-2),
    drift=fastest,
    drift_unit="m/s",
    seconds=2.0,
)
def _(builder: newton.ModelBuilder) -> None:
    builder.gravity = (0.0, 0.0, 0.0)
    for _ in range(3):
        ball = builder.add_body(xform=at())
        builder.add_shape_sphere(ball, radius=0.25, cfg=block(builder))
        add_box(builder, (2.0, 0.0, 0.0), (0.5, 0.5, 0.5))


@BODIES.declare(
    "redundant_contacts",
    "a body of 64 boxes at the same place on another: hundreds of contacts at identical points",
    standing(2),
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder)
    for i in range(2):
        body = builder.add_body(xform=at(0.0, 0.0, 0.25 + 0.5 * i))
        for _ in range(64 if i else 1):
            builder.add_shape_box(body, hx=0.25, hy=0.25, hz=0.25, cfg=block(builder))


@BODIES.declare("bed_of_nails", "a plate on 400 spheres of its own", standing(1))
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder)
    body = builder.add_body(xform=at(0.0, 0.0, 0.05))
    builder.add_shape_box(body, hx=0.5, hy=0.5, hz=0.02, cfg=block(builder))
    for i in range(400):
        where = at((i % 20 - 9.5) * 0.05, (i // 20 - 9.5) * 0.05, -0.03)
        builder.add_shape_sphere(body, xform=where, radius=0.02, cfg=block(builder))


def _ridge() -> newton.Mesh:
    """A roof along y with its ridge at z = 0, cut into ten parts."""
    points, triangles = [], []
    for i in range(11):
        y = 0.4 * (i - 5)
        points += [(-1.0, y, -1.0), (0.0, y, 0.0), (1.0, y, -1.0)]
    for i in range(10):
        a, b = 3 * i, 3 * i + 3
        for k in range(2):
            triangles += [(a + k, b + k, b + k + 1), (a + k, b + k + 1, a + k + 1)]
    return newton.Mesh(np.array(points), np.array(triangles)[:, ::-1].ravel(), is_solid=False)


@BODIES.declare(
    "mesh_edge",
    "a ball rolls along the ridge of a mesh",
    Bounds(penetration=1e-3, gain=1e-3),
    seconds=3.0,
)
def _(builder: newton.ModelBuilder) -> None:
    builder.add_shape_mesh(-1, mesh=_ridge(), cfg=block(builder))
    ball = builder.add_body(xform=at(0.0, -1.0, 0.2))
    builder.add_shape_sphere(ball, radius=0.2, cfg=block(builder))
    set_velocity(builder, ball, (0.0, 1.0, 0.0), (-5.0, 0.0, 0.0))


def beyond(wall: float) -> Callable[[Trial], float]:
    """How far the first body has got through a wall at x = ``wall`` [m]."""
    return lambda trial: max(0.0, float(trial.centers()[0, 0]) - wall)


@BODIES.declare(
    "bullet",
    "a ball of 1 cm at 500 m/s against a fixed wall of 1 cm, with contacts that look ahead",
    # it stops at the wall: its center 5 mm before it; nothing of its energy comes back
    Bounds(penetration=SUNK, gain=1e-3 * 0.5 * 500.0**2 / 9.81, drift=0.0),
    drift=beyond(10.0),
    speculative=5.0,
    seconds=0.5,
)
def _(builder: newton.ModelBuilder) -> None:
    builder.gravity = (0.0, 0.0, 0.0)
    ball = builder.add_body(xform=at(0.0, 0.1, 0.0))
    builder.add_shape_sphere(ball, radius=0.005, cfg=block(builder, density=7800.0))
    set_velocity(builder, ball, (500.0, 0.0, 0.0))
    builder.add_shape_box(-1, xform=at(10.005), hx=0.005, hy=1.0, hz=1.0, cfg=block(builder))


@BODIES.declare(
    "bullet_box",
    "the same against a free slab of 1 cm and 78 kg: it takes the momentum, and no energy comes in",
    Bounds(penetration=1e-3, gain=1e-3),
    speculative=5.0,
    seconds=0.5,
)
def _(builder: newton.ModelBuilder) -> None:
    builder.gravity = (0.0, 0.0, 0.0)
    ball = builder.add_body(xform=at(0.0, 0.1, 0.0))
    builder.add_shape_sphere(ball, radius=0.005, cfg=block(builder, density=7800.0))
    set_velocity(builder, ball, (500.0, 0.0, 0.0))
    add_box(builder, (10.005, 0.0, 0.0), (0.01, 1.0, 1.0), density=7800.0)


@BODIES.declare(
    "sizes",
    "boxes of 100 m, 1 m, 1 cm and 1 mm on each other, and of 1 mm on the ground",
    # a tenth of the smallest edge: twelve roundings of a position 100 m up
    Bounds(penetration=1e-4, gain=1e-4, drift=1e-3),
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.5, gap=0.01)
    height = 0.0
    for edge in (100.0, 1.0, 0.01, 0.001):
        add_box(builder, (0.0, 0.0, height + 0.5 * edge), (edge,) * 3, gap=min(0.02, 0.2 * edge))
        height += edge
    add_box(builder, (100.0, 0.0, 0.0005), (0.001,) * 3, gap=2e-4)
    add_box(builder, (100.0, 0.0, 0.0015), (0.001,) * 3, gap=2e-4)
