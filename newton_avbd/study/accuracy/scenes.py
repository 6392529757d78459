# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Scenes whose motion is known: in closed form, from high-precision integration, or as rest."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd.measure.state import Array
from newton_avbd.model.rotations import conjugate
from newton_avbd.scenes.chains import add_chain
from newton_avbd.scenes.named import SCENES, set_velocity
from newton_avbd.study.accuracy import pendulums
from newton_avbd.study.accuracy.scene import (
    FRAME,
    AccuracyScene,
    G,
    OffPath,
    Path,
    farthest,
    rebounds,
)
from newton_avbd.study.accuracy.simbench import SIMBENCH
from newton_avbd.study.accuracy.solvers import CONTACT, RESTITUTION, SMOOTH
from newton_avbd.study.properties.body import MOMENTS, SPIN, add_mass, free_top
from newton_avbd.study.properties.contact import add_body, bouncing, material

CLOSED = "closed form"
INTEGRATED = "DOP853, tolerance 1e-11"
REST = "rest"

PATH = "largest distance of a center of mass from where it belongs, relative to the way it goes"

THROW = (3.0, 0.0, 4.0)
"""Start velocity of the projectile [m/s]."""


def add_projectile(builder: newton.ModelBuilder) -> None:
    """Add a body that is thrown up and turns, an ball in its moments of inertia."""
    body = add_mass(builder, 0.1, 0.1, 0.1)
    set_velocity(builder, body, THROW, (0.0, 2.0, 0.0))


def projectile(path: Path) -> Array:
    """Centers of mass of the projectile [m]."""
    t = path.times[:, None]
    return (np.array(THROW) * t - 0.5 * np.array([0.0, 0.0, G]) * t**2)[:, None]


AMPLITUDE = 0.5
"""Deflection from which the oscillator is let go [m]."""

FREQUENCY = 2.0 * math.pi
"""Its angular frequency [rad/s]."""


def add_oscillator(builder: newton.ModelBuilder) -> None:
    """Add 1 kg on a slider along x, with a spring to the origin."""
    builder.gravity = (0.0, 0.0, 0.0)
    where = wp.transform(wp.vec3(AMPLITUDE, 0.0, 0.0), wp.quat_identity())
    link = builder.add_link(xform=where, mass=1.0, inertia=wp.mat33(0.1 * np.eye(3)))
    joint = builder.add_joint_prismatic(
        -1, link, axis=(1.0, 0.0, 0.0), target_ke=FREQUENCY**2, target_kd=0.0
    )
    builder.add_articulation([joint])
    builder.joint_q[-1] = AMPLITUDE


def oscillator(path: Path) -> Array:
    """Centers of mass of the oscillator [m]."""
    x = AMPLITUDE * np.cos(FREQUENCY * path.times)
    return np.stack([x, 0.0 * x, 0.0 * x], axis=1)[:, None]


def add_top(builder: newton.ModelBuilder) -> None:
    """Add a body with three different moments of inertia that spins about the middle axis."""
    builder.gravity = (0.0, 0.0, 0.0)
    set_velocity(builder, add_mass(builder, *MOMENTS), angular=(SPIN[0], SPIN[1], SPIN[2]))


def top_error(path: Path) -> float:
    """Angle of the top to where it belongs at the end, relative to how far it has turned."""
    seconds = path.times[-1]
    x, y, z, w = conjugate(path.body_q[-1, 0, 3:])
    a, b, c, d = free_top(seconds)
    # The vector part of their difference is exact for the smallest of angles.
    apart = [w * a + d * x + y * c - z * b, w * b + d * y + z * a - x * c]
    apart += [w * c + d * z + x * b - y * a]
    angle = 2.0 * math.asin(min(1.0, float(np.linalg.norm(apart))))
    return angle / (float(np.linalg.norm(SPIN)) * seconds)


def _pendulum(links: int, seconds: float) -> AccuracyScene:
    def error(path: Path) -> float:
        belongs = pendulums.reference(path.model, float(path.times[-1]))
        return farthest(path.centers[-1] - belongs) / (links * pendulums.LENGTH)

    return AccuracyScene(
        f"pendulum_{links}",
        f"{links} hinged links of {pendulums.LENGTH:g} m swing, let go at 45 degrees",
        INTEGRATED,
        "largest distance of a link from where it belongs at the end, relative to the length",
        partial(add_chain, links=links, length=pendulums.LENGTH, slope=pendulums.SLOPE),
        seconds,
        error,
        SMOOTH,
        touching=False,
    )


SLOPE, MU = math.radians(20.0), 0.3
"""Angle [rad] and friction of the scene ``incline``."""


def incline(path: Path) -> Array:
    """Center of a box that slides down from rest [m]."""
    way = 0.5 * G * (math.sin(SLOPE) - MU * math.cos(SLOPE)) * path.times**2
    along = np.array([math.cos(SLOPE), 0.0, -math.sin(SLOPE)])
    return (path.centers[0, 0] + way[:, None] * along)[:, None]


EDGE = 0.2
"""Edge of single boxes [m]."""


def add_slider(builder: newton.ModelBuilder) -> None:
    """Add a flat box that slides at 2 m/s, and a plane."""
    surface = material(mu=0.4, density=1000.0)
    box = add_body(builder, (0.0, 0.0, 0.25 * EDGE))
    builder.add_shape_box(box, hx=0.5 * EDGE, hy=0.5 * EDGE, hz=0.25 * EDGE, cfg=surface)
    set_velocity(builder, box, (2.0, 0.0, 0.0))
    builder.add_ground_plane(cfg=surface)


def slider(path: Path) -> Array:
    """Center of the box that slides to a stop [m]."""
    brake = 0.4 * G
    t = np.minimum(path.times, 2.0 / brake)
    return _along_x(path, 2.0 * t - 0.5 * brake * t**2)


def add_skidding_sphere(builder: newton.ModelBuilder) -> None:
    """Add a sphere of 0.1 m that starts at 2 m/s without a spin, and a plane."""
    surface = material(mu=0.3, density=1000.0)
    sphere = add_body(builder, (0.0, 0.0, 0.1))
    builder.add_shape_sphere(sphere, radius=0.1, cfg=surface)
    set_velocity(builder, sphere, (2.0, 0.0, 0.0))
    builder.add_ground_plane(cfg=surface)


def skidding_sphere(path: Path) -> Array:
    """Center of the sphere, which slides until it rolls at 5/7 of its speed [m]."""
    brake = 0.3 * G
    until = 2.0 / 7.0 * 2.0 / brake
    t = np.minimum(path.times, until)
    return _along_x(path, 2.0 * t - 0.5 * brake * t**2 + 5.0 / 7.0 * 2.0 * (path.times - t))


RESTITUTION_OF_BALL, DROP = 0.7, 0.5
"""Restitution of the ball that bounces, and the height from which it falls [m]."""


def bounce(path: Path) -> Array:
    """Center of the bouncing ball [m]."""
    height, _ = rebounds(path.times, RESTITUTION_OF_BALL, DROP)
    return path.centers[0] - np.array([0.0, 0.0, DROP]) + _up(height)


TILT = 0.1
"""Angle by which the tipping box stands past its balance on an edge [rad]."""

_REACH = math.sqrt(0.5) * EDGE
"""Distance of its center from the edge [m]."""


def add_cube_on_edge(builder: newton.ModelBuilder, tilt: float, height: float = 0.0) -> None:
    """Add a cube above rough ground, an edge along y lowest.

    Args:
        builder: Builder to add to.
        tilt: Angle of the center past its balance above that edge [rad].
        height: Height of the edge [m].
    """
    surface = material(mu=1.0, density=1000.0)
    turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), 0.25 * math.pi + tilt)
    center = (_REACH * math.sin(tilt), 0.0, _REACH * math.cos(tilt) + height)
    box = add_body(builder, center, rotation=turn)
    builder.add_shape_box(box, hx=0.5 * EDGE, hy=0.5 * EDGE, hz=0.5 * EDGE, cfg=surface)
    builder.add_ground_plane(cfg=surface)


def tipped(times: Array, angle: float, rate: float) -> Array:
    """Center of a cube that turns about an edge at the origin: 4/3 m r^2 a = m g r sin(angle).

    Args:
        times: Times [s], from 0, shape [k].
        angle: Angle of the center to the vertical above the edge [rad], at the start.
        rate: Its rate [rad/s].

    Returns:
        Centers [m], shape [k, 1, 3].
    """
    from scipy.integrate import solve_ivp

    def slope(_: float, y: Array) -> list[float]:
        return [y[1], 0.75 * G / _REACH * math.sin(y[0])]

    found = solve_ivp(
        slope,
        (0.0, times[-1]),
        [angle, rate],
        t_eval=times,
        method="DOP853",
        rtol=1e-11,
        atol=1e-12,
    )
    angles = found.y[0]
    return _REACH * np.stack([np.sin(angles), 0.0 * angles, np.cos(angles)], axis=1)[:, None]


LANDING_TILT, LANDING_HEIGHT = 0.5, 0.2
"""Tilt [rad] of the cube that lands on its edge, and the height of the edge [m]."""


def landing(path: Path) -> Array:
    """Center of a cube that falls on an edge, which sticks, and goes on about it [m].

    The blow leaves the angular momentum about the edge: 4/3 m r^2 w = m v r sin(tilt).
    """
    speed = math.sqrt(2.0 * G * LANDING_HEIGHT)
    lands = speed / G
    rate = 0.75 * speed * math.sin(LANDING_TILT) / _REACH
    falls = path.times < lands
    way = _up(-0.5 * G * path.times[falls] ** 2)
    after = tipped(np.append(0.0, path.times[~falls] - lands), LANDING_TILT, rate)
    return np.concatenate([path.centers[0] + way, after[1:]])


def _along_x(path: Path, way: Array) -> Array:
    """Center of the only body, moved along x."""
    return path.centers[0] + way[:, None, None] * np.array([1.0, 0.0, 0.0])


def _up(height: Array) -> Array:
    """Offsets of one body along z."""
    return height[:, None, None] * np.array([0.0, 0.0, 1.0])


def _rest(name: str, edge: float) -> AccuracyScene:
    scene = SCENES[name]

    def error(path: Path) -> float:
        return farthest(path.centers - path.centers[0]) / edge

    return AccuracyScene(
        name,
        scene.summary,
        REST,
        "largest distance of a body from its start, relative to the edge of a box",
        scene.build,
        2.0,
        error,
        CONTACT,
        vbd_ke=scene.vbd_ke,
    )


def _known(
    name: str,
    summary: str,
    reference: str,
    build: Callable[[newton.ModelBuilder], None],
    seconds: float,
    belongs: Callable[[Path], Array],
    solvers: tuple[str, ...],
    **more: Any,
) -> AccuracyScene:
    error = OffPath(belongs)
    return AccuracyScene(name, summary, reference, PATH, build, seconds, error, solvers, **more)


ACCURACY_SCENES: dict[str, AccuracyScene] = {
    scene.name: scene
    for scene in (
        _known(
            "projectile",
            "a body thrown at 5 m/s",
            CLOSED,
            add_projectile,
            0.8,
            projectile,
            SMOOTH,
            touching=False,
            sweeps=False,
        ),
        _known(
            "oscillator",
            "1 kg on a slider with a spring, one period of 1 s",
            CLOSED,
            add_oscillator,
            1.0,
            oscillator,
            SMOOTH,
            touching=False,
        ),
        AccuracyScene(
            "top",
            "a body with moments 0.1, 0.2, 0.25 kg m^2 spins freely with 1, 4, 1 rad/s",
            INTEGRATED,
            "angle to where it belongs at the end, relative to how far it has turned",
            add_top,
            0.5,
            top_error,
            SMOOTH,
            touching=False,
            sweeps=False,
        ),
        _pendulum(2, 2.0),
        _pendulum(3, 2.0),
        _pendulum(8, 1.0),
        _known(
            "incline",
            "a box slides down a slope of 20 degrees, mu 0.3",
            CLOSED,
            SCENES["incline"].build,
            1.0,
            incline,
            CONTACT,
            vbd_ke=SCENES["incline"].vbd_ke,
        ),
        _known(
            "sliding",
            "a box slides to a stop from 2 m/s, mu 0.4",
            CLOSED,
            add_slider,
            1.0,
            slider,
            CONTACT,
            vbd_ke=1e6,
        ),
        _known(
            "skidding",
            "a sphere at 2 m/s slides until it rolls, mu 0.3",
            CLOSED,
            add_skidding_sphere,
            1.0,
            skidding_sphere,
            CONTACT,
            vbd_ke=1e6,
        ),
        _known(
            "tipping",
            "a cube tips over an edge, mu 1",
            INTEGRATED,
            partial(add_cube_on_edge, tilt=TILT),
            0.35,
            lambda path: tipped(path.times, TILT, 0.0),
            CONTACT,
            vbd_ke=1e6,
        ),
        _known(
            "landing",
            f"a cube falls {LANDING_HEIGHT} m on an edge and goes on about it, mu 1",
            INTEGRATED,
            partial(add_cube_on_edge, tilt=LANDING_TILT, height=LANDING_HEIGHT),
            14.0 * FRAME,
            landing,
            CONTACT,
            vbd_ke=1e6,
        ),
        _known(
            "bounce",
            f"a ball with e = {RESTITUTION_OF_BALL} falls {DROP} m and bounces for 1 s",
            CLOSED,
            lambda builder: bouncing(RESTITUTION_OF_BALL, DROP)(builder, True),
            1.0,
            bounce,
            RESTITUTION,
        ),
        _rest("stack", 0.5),
        _rest("pyramid", 0.8),
        _rest("heavy_on_light", 0.5),
        *SIMBENCH,
    )
}
"""Scenes with a known answer by name."""
