# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Properties of bodies and worlds, and what solvers report of them."""

import math
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd.study.properties.property import DT, Catalog, Measure, Trial, after

G = 9.81
"""Gravity where nothing else is said [m/s^2], along -z."""

BODIES = Catalog()
"""Properties of bodies and worlds by name."""

_WORLDS = {"mujoco": {"use_mujoco_cpu": False}}
_CONTACT_FORCE = {"mujoco": {"use_mujoco_cpu": False, "use_mujoco_contacts": False}}


def add_mass(builder: newton.ModelBuilder, *inertia: float) -> int:
    """Add a free body of 1 kg with principal moments of inertia [kg m^2]."""
    return builder.add_body(mass=1.0, inertia=wp.mat33(np.diag(inertia)))


@BODIES.declare(
    "kinematic body: carries",
    "A box on a kinematic plate that moves at 0.5 m/s, mu 1: after 0.5 s it moves along.",
    expected=0.5,
    bound=0.005,
    unit="m/s",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    speed = 0.5
    plate = builder.add_body(is_kinematic=True)
    builder.add_shape_box(plate, hx=1.0, hy=1.0, hz=0.05)
    box = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, 0.15), wp.quat_identity()))
    builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1)

    def move(trial: Trial, time: float) -> None:
        """Prescribe the plate, in all the terms in which a solver may read it."""
        for poses in (trial.state.body_q, trial.state.joint_q):
            where = poses.numpy().copy()
            where.reshape(-1, 7)[plate, 0] = speed * time
            poses.assign(where)
        for velocities in (trial.state.body_qd, trial.state.joint_qd):
            motion = velocities.numpy().copy()
            motion.reshape(-1, 6)[plate, 0] = speed
            velocities.assign(motion)

    def measure(trial: Trial) -> float:
        for index in range(120):
            if authored:
                move(trial, index * DT)
            trial.step()
        return trial.velocity(box)[0]

    return measure


@BODIES.declare(
    "body_f",
    "A body of 1 kg, pushed by 2 N for 0.5 s without gravity: F t^2 / 2m.",
    expected=0.25,
    bound=0.02 * 0.25,
    unit="m",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    builder.gravity = (0.0, 0.0, 0.0)
    add_mass(builder, 1.0, 1.0, 1.0)
    return after(0.5, lambda trial: trial.center()[0], push=(2.0 if authored else 0.0, 0.0, 0.0))


@BODIES.declare(
    "gravity of each world",
    "A body falls for 0.5 s in the second of two worlds, which has 1.62 m/s^2: -g t^2 / 2.",
    expected=-0.2025,
    bound=0.02 * 0.2025,
    unit="m",
    settings=_WORLDS,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    for gravity in (G, 1.62 if authored else G):
        builder.begin_world(gravity=(0.0, 0.0, -gravity))
        add_mass(builder, 1.0, 1.0, 1.0)
        builder.end_world()
    return after(0.5, lambda trial: trial.center(1)[2])


MOMENTS = np.array([0.1, 0.2, 0.25])
"""Moments of inertia of the top [kg m^2]."""

SPIN = np.array([1.0, 4.0, 1.0])
"""Its first spin [rad/s], mostly about the middle axis, along its axes and the world's."""


def free_top(seconds: float) -> np.ndarray:
    """Rotation of the top after a time [s], by Euler's equations, a quaternion xyzw."""
    from scipy.integrate import solve_ivp

    def slope(_: float, y: Any) -> Any:
        q, spin = y[:4], y[4:]
        rate = 0.5 * np.array([*(q[3] * spin + np.cross(q[:3], spin)), -q[:3] @ spin])
        return np.concatenate([rate, np.cross(MOMENTS * spin, spin) / MOMENTS])

    start = np.concatenate([[0.0, 0.0, 0.0, 1.0], SPIN])
    end = solve_ivp(slope, (0.0, seconds), start, method="DOP853", rtol=1e-10, atol=1e-12)
    return end.y[:4, -1]


@BODIES.declare(
    "gyroscopic torque",
    "A top with 0.1, 0.2, 0.25 kg m^2 spins freely with 1, 4, 1 rad/s: after 0.5 s, its angle to "
    "the solution of Euler's equations (a ball instead of the top, without the torque).",
    expected=0.0,
    bound=0.02,
    unit="rad",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    builder.gravity = (0.0, 0.0, 0.0)
    add_mass(builder, *(MOMENTS if authored else np.full(3, 0.2)))
    builder.joint_qd[-3:] = list(map(float, SPIN))
    return after(
        0.5, lambda trial: 2.0 * math.acos(min(1.0, abs(float(free_top(0.5) @ trial.rotation()))))
    )


def add_fluid(builder: newton.ModelBuilder, density: float, viscosity: float) -> None:
    """Fill the world with a fluid [kg/m^3, Pa s] that blows at 1 m/s along x."""
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    values = {"density": density, "viscosity": viscosity, "wind": wp.vec3(1.0, 0.0, 0.0)}
    for name, value in values.items():
        builder.custom_attributes[f"mujoco:{name}"].values = {0: value}


SQUARE = 1.0 / 6.0
"""Moment of inertia of a cube of 1 kg with edges of 1 m [kg m^2]."""


@BODIES.declare(
    "mujoco:density, wind",
    "A box of 1 kg and 1, 0.8, 0.6 m falls flat in a fluid of 10 kg/m^3 that blows aside at 1 m/s: "
    "it ends at the root of 2 m g / (density A).",
    expected=math.sqrt(0.25 * G),
    bound=0.001,
    unit="m/s",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    add_fluid(builder, 10.0 if authored else 0.0, 0.0)
    add_mass(builder, 1.0 / 12.0, 1.36 / 12.0, 1.64 / 12.0)
    return after(4.0, lambda trial: -trial.velocity()[2])


@BODIES.declare(
    "mujoco:viscosity",
    "A cube of 1 kg and 1 m spins at 1 rad/s in a fluid of 0.1 Pa s: exp(-pi viscosity t / I) of "
    "it is left after 0.5 s.",
    expected=math.exp(-0.05 * math.pi / SQUARE),
    bound=0.005,
    unit="rad/s",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    builder.gravity = (0.0, 0.0, 0.0)
    add_fluid(builder, 0.0, 0.1 if authored else 0.0)
    add_mass(builder, SQUARE, SQUARE, SQUARE)
    builder.joint_qd[-3:] = [0.0, 0.0, 1.0]
    return after(0.5, lambda trial: trial.velocity()[5])


def observed(trial: Trial, kind: str, seconds: float) -> np.ndarray:
    """An observable after a time, shape [rows, 6]."""
    trial.observe(kind)
    trial.run(seconds)
    return getattr(trial.observables, kind).numpy().astype(float)


@BODIES.declare(
    "observable: body_qdd",
    "A body slides down a slider at 30 degrees: the size of its acceleration, g sin a.",
    expected=0.5 * G,
    bound=0.005 * 0.5 * G,
    unit="m/s^2",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    link = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)))
    slope = (0.5 * math.sqrt(3.0), 0.0, -0.5 if authored else 0.0)
    builder.add_articulation([builder.add_joint_prismatic(-1, link, axis=slope)])

    def measure(trial: Trial) -> float:
        return float(np.linalg.norm(observed(trial, "body_qdd", 0.2)[0, :3]))

    return measure


@BODIES.declare(
    "observable: body_parent_f",
    "Two bodies of 1 kg hang on hinges, one from the other: the upper joint carries 2 m g.",
    expected=2.0 * G,
    bound=0.001 * 2.0 * G,
    unit="N",
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    builder.gravity = (0.0, 0.0, -G if authored else 0.0)
    joints, parent = [], -1
    for _ in range(2):
        link = builder.add_link(mass=1.0, inertia=wp.mat33(0.01 * np.eye(3)))
        top = wp.transform(wp.vec3(0.0, 0.0, 0.2), wp.quat_identity())
        joints.append(builder.add_joint_revolute(parent, link, child_xform=top, axis=(0, 1, 0)))
        parent = link
    builder.add_articulation(joints)
    return lambda trial: observed(trial, "body_parent_f", 0.5)[0, 2]


@BODIES.declare(
    "observable: contact_f",
    "A box of 8 kg rests on the ground: its contacts add up to m g.",
    expected=8.0 * G,
    bound=0.005 * 8.0 * G,
    unit="N",
    settings=_CONTACT_FORCE,
)
def _(builder: newton.ModelBuilder, authored: bool) -> Measure:
    builder.gravity = (0.0, 0.0, -G if authored else 0.0)
    body = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, 0.1), wp.quat_identity()))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    builder.add_ground_plane()
    return lambda trial: abs(observed(trial, "contact_f", 1.0)[:, 2].sum())
