# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The scenes of SimBenchmark, as Newton models, with its error measures.

Source: Kang and Hwangbo, "SimBenchmark", https://leggedrobotics.github.io/SimBenchmark, 2018:
masses, sizes, friction, forces and closed forms are theirs. They report means of squares in SI
units; here these are the roots of such means, relative to what is measured, so that a hundredth
means a hundredth in each scene. The robot is Newton's quadruped instead of ANYmal, and the runs
end earlier where they say so.
"""

import math
from functools import partial

import newton
import newton.examples
import numpy as np
import warp as wp

from newton_avbd.measure.state import Array, Bodies
from newton_avbd.scenes import robots
from newton_avbd.scenes.named import set_velocity
from newton_avbd.study.accuracy.scene import AccuracyScene, G, Path, rebounds, rms
from newton_avbd.study.accuracy.solvers import CONTACT, RESTITUTION, SMOOTH
from newton_avbd.study.properties.contact import add_body, material

CLOSED = "SimBenchmark's closed form"
CONSERVED = "conserved, as in SimBenchmark"


def ball_material(radius: float, mass: float, **settings: float) -> newton.ModelBuilder.ShapeConfig:
    """Surface of a ball of a radius [m], and the density that gives it a mass [kg]."""
    return material(density=mass / (4.0 / 3.0 * math.pi * radius**3), **settings)


# Rolling: a box on the ground is drawn under 25 balls that roll on it.

BALLS, BOX, FORCE = 25, 10.0, 150.0
"""Balls of 1 kg, mass of the box [kg], and the force on it [N]."""

MU_GROUND, MU_BALL = 0.4, 0.8
"""Friction of box and ground, and of the balls."""


def add_rolling(builder: newton.ModelBuilder) -> None:
    """Add a box of 20 x 20 x 1 m and 10 kg with 5 x 5 balls of 0.5 m and 1 kg on it."""
    ground = material(mu=MU_GROUND, density=BOX / 400.0)
    box = add_body(builder, (0.0, 0.0, 0.5))
    builder.add_shape_box(box, hx=10.0, hy=10.0, hz=0.5, cfg=ground)
    builder.add_ground_plane(cfg=ground)
    surface = ball_material(0.5, 1.0, mu=MU_BALL)
    for i in range(BALLS):
        ball = add_body(builder, (i // 5 * 2.0 - 4.0, i % 5 * 2.0 - 4.0, 1.5))
        builder.add_shape_sphere(ball, radius=0.5, cfg=surface)


def rolling_accelerations() -> tuple[float, float]:
    """Accelerations of the box, which slides, and of the balls, which roll [m/s^2].

    The box feels F - mu (M + 25 m) g - 25 f = M a1; a ball is moved and turned by f alone, and
    its lowest point moves with the box: a1 = 7/2 f / m.
    """
    sliding = MU_GROUND * (BOX + BALLS) * G
    friction = (FORCE - sliding) / BOX / (3.5 + BALLS / BOX)
    return (FORCE - sliding - BALLS * friction) / BOX, friction


def _rolling(name: str, direction: tuple[float, float]) -> AccuracyScene:
    along = np.array([*direction, 0.0])

    def error(path: Path) -> float:
        belongs = np.outer(rolling_accelerations(), along)[None] * path.times[:, None, None]
        return rms(path.body_qd[:, :2, :3] - belongs) / rms(belongs)

    def pull(time: float, bodies: Bodies) -> Array:
        del time, bodies
        return np.array([*(FORCE * along), 0.0, 0.0, 0.0])

    return AccuracyScene(
        name,
        f"25 balls on a box that {FORCE:.0f} N draw over the ground along "
        f"{direction[0]:.3g}, {direction[1]:.3g}",
        CLOSED,
        "velocities of the box and of one ball, root mean square over 4 s",
        add_rolling,
        4.0,
        error,
        CONTACT,
        wrench=pull,
        vbd_ke=1e5,
    )


# Bouncing: balls fall apart from each other.

HEIGHT = 5.0
"""Height of their centers above the ground [m]."""


def add_bouncing(builder: newton.ModelBuilder, e: float) -> None:
    """Add 7 x 7 balls of 0.1 m and 10 kg, 5 m above the ground, with a restitution."""
    surface = ball_material(0.1, 10.0, mu=0.0, restitution=e)
    for i in range(49):
        ball = add_body(builder, (i // 7 * 1.0, i % 7 * 1.0, HEIGHT))
        builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    builder.add_ground_plane(cfg=surface)


def _bouncing(e: float) -> AccuracyScene:
    def error(path: Path) -> float:
        _, bounces = rebounds(path.times, e, HEIGHT - 0.1)
        weight = float(np.sum(path.bodies.mass)) * G
        # What the ground keeps is what the balls would need to rise above lying on it.
        belongs = weight * (0.1 + (HEIGHT - 0.1) * e ** (2.0 * bounces))
        return rms(path.energy - belongs) / (weight * HEIGHT)

    return AccuracyScene(
        f"bouncing_{e:g}",
        f"49 balls of 10 kg with e = {e:g} fall 5 m",
        CLOSED,
        "energy, root mean square over 20 s, relative to that at the start",
        partial(add_bouncing, e=e),
        20.0,
        error,
        RESTITUTION,
    )


# 666: balls in a loose cube, without friction.


def add_666(builder: newton.ModelBuilder, height: float, e: float) -> None:
    """Add 6 x 6 x 6 balls of 0.1 m and 10 kg, 1 cm apart and up to 1 mm out of place.

    Args:
        builder: Builder to add to.
        height: Height of the lowest centers [m].
        e: Restitution.
    """
    surface = ball_material(0.1, 10.0, mu=0.0, restitution=e)
    scatter = np.random.default_rng(42).uniform(0.0, 0.001, size=(216, 3))
    for i, offset in enumerate(scatter):
        cell = np.array([i // 36, i // 6 % 6, i % 6])
        ball = add_body(builder, tuple(0.21 * cell + [0.0, 0.0, height] + offset))
        builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    builder.add_ground_plane(cfg=surface)


def penetration_error(path: Path) -> float:
    """Penetrations of balls of 0.1 m with each other and the plane z = 0.

    Returns:
        Root of the mean over time of the sum of their squares a ball, relative to the radius.
    """
    squares = []
    for centers in path.centers:
        apart = np.linalg.norm(centers[:, None] - centers[None], axis=2)
        pairs = apart[np.triu_indices(len(centers), 1)]
        depths = np.concatenate([0.2 - pairs, 0.1 - centers[:, 2]])
        squares.append(np.sum(np.square(np.maximum(depths, 0.0))) / len(centers))
    return math.sqrt(float(np.mean(squares))) / 0.1


def energy_error(path: Path) -> float:
    """Change of energy, root mean square over time, relative to that at the start."""
    return rms(path.energy - path.energy[0]) / float(path.energy[0])


# A robot in space.


def add_quadruped(builder: newton.ModelBuilder, *, floating: bool = True) -> None:
    """Add Newton's quadruped 2 m up, legs bent; its joints are free, limits as if not authored."""
    builder.default_joint_cfg.armature = 0.0
    builder.add_urdf(
        newton.examples.get_asset("quadruped.urdf"),
        xform=wp.transform(wp.vec3(0.0, 0.0, 2.0), wp.quat_identity()),
        floating=floating,
        enable_self_collisions=False,
        # The file's mass properties are placeholders; a density makes them fit the shapes.
        ignore_inertial_definitions=True,
    )
    for dof in range(builder.joint_dof_count):
        builder.joint_target_ke[dof] = builder.joint_target_kd[dof] = 0.0
        builder.joint_target_mode[dof] = int(newton.JointTargetMode.NONE)
        builder.joint_damping[dof] = builder.joint_friction[dof] = 0.0
        builder.joint_limit_lower[dof], builder.joint_limit_upper[dof] = -1e10, 1e10
        builder.joint_velocity_limit[dof] = 1e6
    builder.joint_q[-12:] = [0.03, 0.4, -0.8, -0.03, 0.4, -0.8, 0.03, -0.4, 0.8, -0.03, -0.4, 0.8]
    robots.place(builder)


def add_momentum(builder: newton.ModelBuilder) -> None:
    """Add the robot, free of gravity, and a ball of 10 kg that is 1 m off and hits it at 5 m/s."""
    builder.gravity = (0.0, 0.0, 0.0)
    add_quadruped(builder)
    ball = add_body(builder, (0.05, -1.5, 2.02))
    builder.add_shape_sphere(ball, radius=0.2, cfg=ball_material(0.2, 10.0, mu=0.5))
    set_velocity(builder, ball, (0.0, 5.0, 0.0))


def momentum_error(path: Path) -> float:
    """Change of momentum, root mean square over time, relative to that at the start."""
    return rms(path.momentum - path.momentum[0]) / float(np.linalg.norm(path.momentum[0]))


def add_energy(builder: newton.ModelBuilder) -> None:
    """Add the robot alone; nothing collides."""
    add_quadruped(builder)
    for shape in range(builder.shape_count):
        builder.shape_flags[shape] &= ~newton.ShapeFlags.COLLIDE_SHAPES


LIFT = 1.0
"""Time for which the robot is lifted before it falls [s]."""


def _energy() -> AccuracyScene:
    def error(path: Path) -> float:
        fall = path.energy[round(LIFT * 60.0) :]
        lifted = 0.5 * float(np.sum(path.bodies.mass)) * (G * LIFT) ** 2
        return rms(fall - fall[0]) / lifted

    def lift(time: float, bodies: Bodies) -> Array:
        force = 2.0 * G * float(np.sum(bodies.mass)) if time < LIFT - 1e-6 else 0.0
        return np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])

    return AccuracyScene(
        "energy",
        "a robot with loose legs, lifted by twice its weight for 1 s, falls for 2 s",
        CONSERVED,
        "energy in the fall, root mean square, relative to what lifting put into motion",
        add_energy,
        3.0,
        error,
        SMOOTH,
        touching=False,
        wrench=lift,
    )


STANDING = 0.46136
"""Height at which the robot's trunk comes to rest [m]: mj_step with stiff contacts has it at
0.46137 with 3,840 and with 7,680 steps a second, SolverXPBD(40) at 0.46134 with 3,840."""


def standing_error(path: Path) -> float:
    """Distance of the trunk's height from where it comes to rest, at the end, relative to it."""
    return abs(float(path.centers[-1, 0, 2]) / STANDING - 1.0)


def _of_many(solvers: tuple[str, ...]) -> tuple[str, ...]:
    """Less SolverKamino, whose dense matrix of the contacts of 216 balls takes more than 20 GB."""
    return tuple(solver for solver in solvers if solver != "kamino")


SIMBENCH: tuple[AccuracyScene, ...] = (
    _rolling("rolling_y", (0.0, 1.0)),
    _rolling("rolling_xy", (0.5, math.sqrt(0.75))),
    _bouncing(1.0),
    _bouncing(0.5),
    AccuracyScene(
        "666",
        "216 balls of 10 kg in a cube come down without friction",
        "rigid, as in SimBenchmark",
        "penetration of a ball, root mean square over 2 s (SimBenchmark: 10 s), relative to the "
        "radius",
        partial(add_666, height=0.101, e=0.0),
        2.0,
        penetration_error,
        _of_many(CONTACT),
        vbd_ke=1e6,
    ),
    AccuracyScene(
        "elastic_666",
        "216 elastic balls of 10 kg fall 1 m",
        CONSERVED,
        "energy, root mean square over 2 s (SimBenchmark: 10 s), relative to that at the start",
        partial(add_666, height=1.101, e=1.0),
        2.0,
        energy_error,
        _of_many(RESTITUTION),
        # a hundredth takes steps of 2 ms with several iterations, or of 1 ms
        patience=3.0,
    ),
    AccuracyScene(
        "momentum",
        "a ball of 10 kg hits a robot in space at 5 m/s",
        CONSERVED,
        "momentum, root mean square over 1 s (SimBenchmark: 10 s), relative to that at the start",
        add_momentum,
        1.0,
        momentum_error,
        CONTACT,
        vbd_ke=1e5,
    ),
    _energy(),
    AccuracyScene(
        "standing",
        "a robot with stiff drives lands and stands",
        "mj_step at 7,680 steps a second, checked by SolverXPBD at 3,840",
        "height of the trunk after 2 s, relative; the feet stick where they land, and with them "
        "the height is known to 3e-4",
        robots.add_quadruped,
        2.0,
        standing_error,
        CONTACT,
        vbd_ke=1e5,
        resolution=3e-4,
    ),
)
"""Scenes of SimBenchmark."""
