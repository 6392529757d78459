# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Properties of contacts, each on a scene of one to three bodies on a plane."""

import math
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd.study.properties.property import Catalog, Measure, Trial, after

G = 9.81
"""Gravity [m/s^2], along -z."""

RADIUS = 0.1
"""Radius of spheres, discs and wheels [m]."""

CONTACTS = Catalog()
"""Properties of contacts by name."""

# Only its Warp backend takes Newton's contacts, and what they carry.
_NEWTON_CONTACTS = {"use_mujoco_cpu": False, "use_mujoco_contacts": False}

_RESTITUTION = {"xpbd": {"enable_restitution": True}}
_TORSION: dict[str, dict[str, Any]] = {
    "avbd": {"angular_friction": True},
    "mujoco": {"attributes": {"condim": 4}},
}
_ROLLING = _TORSION | {"mujoco": {"attributes": {"condim": 6}}}
_BELT = {"mujoco": _NEWTON_CONTACTS}
_COMPLIANT: dict[str, dict[str, Any]] = {
    "avbd": {"compliant_contacts": True},
    # force-space: ke and kd are what the shapes say
    "mujoco": {**_NEWTON_CONTACTS, "attributes": {"solref_mode": 0}},
}
_MATERIALS: dict[str, dict[str, Any]] = {
    **_COMPLIANT,
    "steel": {"contact_compliance": True, "friction_anchor_beta": 0.0},
}
_FRICTION = {"mujoco": _NEWTON_CONTACTS, "steel": _MATERIALS["steel"]}


def material(**settings: float) -> newton.ModelBuilder.ShapeConfig:
    """A surface that nothing but sliding friction acts on, unless ``settings`` say so."""
    plain = {"mu": 0.5, "mu_torsional": 0.0, "mu_rolling": 0.0, "restitution": 0.0}
    return newton.ModelBuilder.ShapeConfig(**(plain | settings))


def add_body(
    builder: newton.ModelBuilder,
    position: tuple[float, float, float],
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rotation: wp.quat | None = None,
    **settings: Any,
) -> int:
    """Add a free body at a position [m], with a velocity [m/s] and a spin [rad/s]."""
    turn = wp.quat_identity() if rotation is None else rotation
    body = builder.add_body(xform=wp.transform(wp.vec3(*position), turn), **settings)
    builder.joint_qd[-6:] = [*velocity, *spin]
    return body


def add_sphere(
    builder: newton.ModelBuilder, height: float, *, x: float = 0.0, **settings: Any
) -> newton.ModelBuilder.ShapeConfig:
    """Add a sphere at a height above the plane z = 0 [m]; ``settings`` are of its surface."""
    motion = {key: settings.pop(key) for key in ("velocity", "spin") if key in settings}
    surface = material(**settings)
    body = add_body(builder, (x, 0.0, RADIUS + height), **motion)
    builder.add_shape_sphere(body, radius=RADIUS, cfg=surface)
    return surface


def bouncing(e: float, height: float) -> Any:
    """Builder of a ball that falls on a plane of its material from a height [m]."""

    def build(builder: newton.ModelBuilder, authored: bool) -> None:
        surface = add_sphere(builder, height, restitution=e if authored else 0.0)
        builder.add_ground_plane(cfg=surface)

    return build


@CONTACTS.declare(
    "restitution: rebound",
    "A ball with e = 0.5 falls 1 m: it rises to e^2 h.",
    expected=0.25,
    bound=0.005,
    unit="m",
    settings=_RESTITUTION,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    bouncing(0.5, 1.0)(builder, authored)
    return after(
        math.sqrt(2.0 / G) + 0.03,
        lambda trial: max(trial.center()[2] - RADIUS for _ in trial.steps(0.4)),
    )


def _settling() -> float:
    """Time until a ball with e = 0.5 from 0.1 m never rises above 2 mm any more [s].

    Its second rebound, to e^4 h = 6 mm, is the last that does.
    """
    fall = math.sqrt(2.0 * 0.1 / G)
    return fall * (1.0 + 2.0 * 0.5 + 2.0 * 0.5**2) - math.sqrt(2.0 * 0.002 / G)


@CONTACTS.declare(
    "restitution: comes to rest",
    "A ball with e = 0.5 falls 0.1 m: after two rebounds it stays below 2 mm.",
    expected=_settling(),
    bound=0.05 * _settling(),
    unit="s",
    settings=_RESTITUTION,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    bouncing(0.5, 0.1)(builder, authored)

    def measure(trial: Trial) -> float:
        heights = [(time, trial.center()[2] - RADIUS) for time in trial.steps(1.0)]
        return max((time for time, height in heights if height > 0.002), default=0.0)

    return measure


@CONTACTS.declare(
    "restitution: cradle",
    "A ball hits two that touch, e = 1, no gravity: the last one leaves with all of the speed.",
    expected=1.0,
    bound=0.02,
    unit="m/s",
    settings=_RESTITUTION,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    builder.gravity = (0.0, 0.0, 0.0)
    e = 1.0 if authored else 0.0
    for x, speed in ((0.0, 1.0), (2.5 * RADIUS, 0.0), (4.5 * RADIUS, 0.0)):
        add_sphere(builder, 0.0, x=x, velocity=(speed, 0.0, 0.0), restitution=e, mu=0.0)
    return after(0.3, lambda trial: trial.velocity(2)[0])


def stops(trial: Trial, component: int, start: float, seconds: float = 0.8) -> float:
    """Time until a component of a velocity is down to 5 % of its start [s]; infinite if never."""
    return trial.moment(lambda: trial.velocity()[component] - 0.05 * start, seconds)


def turned(axis: tuple[float, float, float]) -> wp.quat:
    """A quarter of a turn about an axis."""
    return wp.quat_from_axis_angle(wp.vec3(*axis), 0.5 * math.pi)


@CONTACTS.declare(
    "mu_torsional: sphere",
    "A sphere of radius r = 0.1 m spins at 10 rad/s about the vertical, mu_torsional 0.01 m: "
    "it slows down at mu_t g / (2/5 r^2).",
    expected=9.5 / (0.01 * G / (0.4 * RADIUS**2)),
    bound=0.05 * 9.5 / (0.01 * G / (0.4 * RADIUS**2)),
    unit="s",
    settings=_TORSION,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    torsion = 0.01 if authored else 0.0
    surface = add_sphere(builder, 0.0, spin=(0.0, 0.0, 10.0), mu_torsional=torsion)
    builder.add_ground_plane(cfg=surface)
    return lambda trial: stops(trial, 5, 10.0)


@CONTACTS.declare(
    "mu_torsional: disc",
    "A flat disc of radius r = 0.1 m spins at 10 rad/s, mu 0, mu_torsional 0.01 m: "
    "it slows down at mu_t g / (r^2 / 2).",
    expected=9.5 / (0.01 * G / (0.5 * RADIUS**2)),
    bound=0.05 * 9.5 / (0.01 * G / (0.5 * RADIUS**2)),
    unit="s",
    settings=_TORSION,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    surface = material(mu=0.0, mu_torsional=0.01 if authored else 0.0)
    body = add_body(builder, (0.0, 0.0, 0.02), spin=(0.0, 0.0, 10.0))
    builder.add_shape_cylinder(body, radius=RADIUS, half_height=0.02, cfg=surface)
    builder.add_ground_plane(cfg=surface)
    return lambda trial: stops(trial, 5, 10.0)


@CONTACTS.declare(
    "mu_rolling: sphere",
    "A sphere of radius r = 0.1 m rolls at 0.2 m/s, mu_rolling 0.005 m: "
    "it slows down at mu_r g / (r (1 + 2/5)).",
    expected=0.19 / (0.005 * G / (1.4 * RADIUS)),
    bound=0.05 * 0.19 / (0.005 * G / (1.4 * RADIUS)),
    unit="s",
    settings=_ROLLING,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    rolling = 0.005 if authored else 0.0
    velocity, spin = (0.2, 0.0, 0.0), (0.0, 0.2 / RADIUS, 0.0)
    surface = add_sphere(builder, 0.0, velocity=velocity, spin=spin, mu_rolling=rolling)
    builder.add_ground_plane(cfg=surface)
    return lambda trial: stops(trial, 0, 0.2)


@CONTACTS.declare(
    "mu_rolling: disc",
    "A disc of radius r = 0.1 m rolls on its rim at 0.2 m/s, mu_rolling 0.005 m: "
    "it slows down at mu_r g / (r (1 + 1/2)).",
    expected=0.19 / (0.005 * G / (1.5 * RADIUS)),
    bound=0.05 * 0.19 / (0.005 * G / (1.5 * RADIUS)),
    unit="s",
    settings=_ROLLING,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    surface = material(mu_rolling=0.005 if authored else 0.0)
    velocity, spin = (0.2, 0.0, 0.0), (0.0, 0.2 / RADIUS, 0.0)
    body = add_body(builder, (0.0, 0.0, RADIUS), velocity, spin, turned((1.0, 0.0, 0.0)))
    builder.add_shape_cylinder(body, radius=RADIUS, half_height=0.02, cfg=surface)
    builder.add_ground_plane(cfg=surface)
    return lambda trial: stops(trial, 0, 0.2)


def add_belt(builder: newton.ModelBuilder) -> newton.Mesh:
    """Add a box on a belt, the top of a fixed mesh whose surface can move; both have mu 0.5."""
    corners = [(x, y, z) for x in (-2.0, 2.0) for y in (-1.0, 1.0) for z in (-0.1, 0.0)]
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = [i for a, b, c, d in quads for i in (a, b, c, a, c, d)]
    belt = newton.Mesh(
        np.array(corners, dtype=np.float32), np.array(triangles), enable_surface_velocity=True
    )
    builder.add_shape_mesh(-1, mesh=belt, cfg=material())
    body = add_body(builder, (0.0, 0.0, 0.05))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.05, cfg=material())
    return belt


def belt_speed(builder: newton.ModelBuilder, authored: bool, seconds: float) -> Measure:
    """A box on a belt that runs at 1 m/s; measures its speed after a time."""
    belt = add_belt(builder)

    def measure(trial: Trial) -> float:
        velocities = belt.mesh.velocities
        velocities.assign(np.tile([1.0 if authored else 0.0, 0.0, 0.0], (len(velocities), 1)))
        trial.run(seconds)
        return trial.velocity()[0]

    return measure


@CONTACTS.declare(
    "surface velocity: takes along",
    "A box at rest on a belt of 1 m/s, mu 0.5: after 0.1 s it has the speed mu g t.",
    expected=0.5 * G * 0.1,
    bound=0.02 * 0.5 * G * 0.1,
    unit="m/s",
    settings=_BELT,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    return belt_speed(builder, authored, 0.1)


@CONTACTS.declare(
    "surface velocity: carries",
    "The same box after 0.5 s has the belt's speed.",
    expected=1.0,
    bound=0.01,
    unit="m/s",
    settings=_BELT,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    return belt_speed(builder, authored, 0.5)


def add_sliding_box(builder: newton.ModelBuilder, mu: float, mu_ground: float) -> None:
    """Add a flat box that slides over the plane z = 0 at 3 m/s."""
    body = add_body(builder, (0.0, 0.0, 0.02), (3.0, 0.0, 0.0))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.02, cfg=material(mu=mu))
    builder.add_ground_plane(cfg=material(mu=mu_ground))


def friction_coefficient(trial: Trial) -> float:
    """Coefficient of friction that brings a box to rest in the time that it takes.

    Also where the box hops: the mean of its load is its weight.
    """
    return 0.95 * 3.0 / (G * stops(trial, 0, 3.0, 1.5))


@CONTACTS.declare(
    "friction: slides",
    "A box slides at 3 m/s, mu 0.5: the mu by which v / (mu g) is the time in which it stops.",
    expected=0.5,
    bound=0.01,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    mu = 0.5 if authored else 0.0
    add_sliding_box(builder, mu, mu)
    return friction_coefficient


@CONTACTS.declare(
    "friction: mixing rule",
    "A box with mu 1 slides over ground with mu 0.25: which mean the time shows in which it stops.",
    expected=math.nan,
    bound=0.04,
    rules={"minimum": 0.25, "geometric mean": 0.5, "arithmetic mean": 0.625, "maximum": 1.0},
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    add_sliding_box(builder, 1.0, 0.25)
    return friction_coefficient


def add_heavy_point(builder: newton.ModelBuilder, **settings: float) -> None:
    """Add a sphere of 1 kg and 1 m across that touches the ground, whose contact gives way."""
    body = add_body(builder, (0.0, 0.0, 0.5), mass=1.0, inertia=wp.mat33(0.1 * np.eye(3)))
    surface = material(density=0.0, **settings)
    builder.add_shape_sphere(body, radius=0.5, cfg=surface)
    builder.add_ground_plane(cfg=surface)


def sag(trial: Trial) -> float:
    """How deep the sphere has sunk in [m]."""
    return 0.5 - trial.center()[2]


def deepest(trial: Trial) -> float:
    """How deep the sphere sinks in before it comes back [m]."""
    return max(sag(trial) for _ in trial.steps(0.5))


def _peak(ke: float, kd: float) -> float:
    """Deepest sag of 1 kg that is let go on an underdamped spring [m]."""
    zeta = 0.5 * kd / math.sqrt(ke)
    return G / ke * (1.0 + math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)))


def _creep(ke: float, kd: float, time: float) -> float:
    """Sag of 1 kg that is let go on an overdamped spring [m]."""
    omega, zeta = math.sqrt(ke), 0.5 * kd / math.sqrt(ke)
    root = math.sqrt(zeta**2 - 1.0)
    slow, fast = omega * (-zeta + root), omega * (-zeta - root)
    part = (fast * math.exp(slow * time) - slow * math.exp(fast * time)) / (fast - slow)
    return G / ke * (1.0 - part)


@CONTACTS.declare(
    "shape ke: static sag",
    "1 kg rests on a contact with ke 500 N/m and kd 50 N s/m: it sinks in by m g / ke.",
    expected=G / 500.0,
    bound=0.02 * G / 500.0,
    unit="m",
    settings=_COMPLIANT,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    add_heavy_point(builder, **({"ke": 500.0, "kd": 50.0} if authored else {}))
    return after(1.5, sag)


@CONTACTS.declare(
    "shape kd: underdamped",
    "1 kg is let go on a contact with ke 100 N/m, kd 5 N s/m: "
    "it sinks in by m g / ke (1 + exp(-pi zeta / sqrt(1 - zeta^2))).",
    expected=_peak(100.0, 5.0),
    bound=0.05 * _peak(100.0, 5.0),
    unit="m",
    settings=_COMPLIANT,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    add_heavy_point(builder, ke=100.0, kd=5.0 if authored else 0.0)
    return deepest


@CONTACTS.declare(
    "shape kd: overdamped",
    "1 kg is let go on a contact with ke 100 N/m, kd 40 N s/m: the sum of two exponentials.",
    expected=_creep(100.0, 40.0, 0.2),
    bound=0.05 * _creep(100.0, 40.0, 0.2),
    unit="m",
    settings=_COMPLIANT,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    add_heavy_point(builder, ke=100.0, kd=40.0 if authored else 0.0)
    return after(0.2, sag)


@CONTACTS.declare(
    "per-contact stiffness",
    "1 kg rests on a contact that carries 500 N/m and 50 N s/m, shapes with ke 5000: m g / k.",
    expected=G / 500.0,
    bound=0.02 * G / 500.0,
    unit="m",
    settings=_MATERIALS,
    materials=True,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    add_heavy_point(builder, ke=5000.0, kd=50.0)

    def measure(trial: Trial) -> float:
        trial.materials = {"stiffness": 500.0, "damping": 50.0} if authored else {}
        trial.run(1.5)
        return sag(trial)

    return measure


@CONTACTS.declare(
    "per-contact damping",
    "1 kg is let go on a contact that carries 100 N/m and 40 N s/m, shapes with kd 0: "
    "the sum of two exponentials.",
    expected=_creep(100.0, 40.0, 0.2),
    bound=0.05 * _creep(100.0, 40.0, 0.2),
    unit="m",
    settings=_MATERIALS,
    materials=True,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    add_heavy_point(builder, ke=100.0, kd=0.0)

    def measure(trial: Trial) -> float:
        trial.materials = {"stiffness": 100.0} | ({"damping": 40.0} if authored else {})
        trial.run(0.2)
        return sag(trial)

    return measure


@CONTACTS.declare(
    "per-contact friction",
    "A box slides, mu 0.5, on contacts that scale friction by 0.5: the mu by which it stops.",
    expected=0.25,
    bound=0.005,
    settings=_FRICTION,
    materials=True,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    add_sliding_box(builder, 0.5, 0.5)

    def measure(trial: Trial) -> float:
        trial.materials = {"friction": 0.5} if authored else {}
        return friction_coefficient(trial)

    return measure
