# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Observables against each other, finite differences and statics; Newton's sensors on top."""

from typing import Any

import newton
import numpy as np
from helpers import Array, G, Simulation, add_box, add_ground, add_mass, surface
from joint_scenes import WORLD, add_link, simulate, transform
from newton.sensors import SensorContact, SensorIMU
from newton.solvers import SolverBase
from scipy.spatial.transform import Rotation

CONTACT_F = SolverBase.ObservableKind.CONTACT_F
BODY_QDD = SolverBase.ObservableKind.BODY_QDD
PARENT_F = SolverBase.ObservableKind.BODY_PARENT_F

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7])


def falling_chain() -> newton.ModelBuilder:
    """Three cubes on ball joints, the first floating, that fall flat on the ground."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    joints, parent = [], WORLD
    for i in range(3):
        link = builder.add_link(xform=transform((0.3 * i, 0.0, 0.15)))
        builder.add_shape_box(link, hx=0.1, hy=0.1, hz=0.1, cfg=surface())
        frames = {
            "parent_xform": transform((0.15, 0.0, 0.0)),
            "child_xform": transform((-0.15, 0.0, 0.0)),
        }
        joints.append(
            builder.add_joint_free(link)
            if parent == WORLD
            else builder.add_joint_ball(parent, link, **frames)
        )
        parent = link
    builder.add_articulation(joints)
    builder.joint_q[2] = 0.15
    return builder


def contact_sums(sim: Simulation, contact_f: Array) -> Array:
    """Force and torque about its COM that contacts exert on each body, shape (body_count, 6)."""
    owner = sim.model.shape_body.numpy()
    count = int(sim.contacts.rigid_contact_count.numpy()[0])
    a = owner[sim.contacts.rigid_contact_shape0.numpy()[:count]]
    assert np.all(a == -1), "the ground comes first"
    b = owner[sim.contacts.rigid_contact_shape1.numpy()[:count]]
    sums = np.zeros((sim.model.body_count, 6))
    for body, row in zip(b, contact_f[:count], strict=True):
        # static shapes have their torque about the origin of the world
        sums[body, :3] -= row[:3]
        sums[body, 3:] -= row[3:] - np.cross(sim.center[body], row[:3])
    return sums


def test_all_observables_together_are_newtons_second_law() -> None:
    """m (a - g) = force of the parent + contacts - forces on the children, through an impact.

    Three cubes on ball joints that fall, strike the ground and lie. Torques likewise, about each
    COM (cubes have no gyroscopic part). The sweeps are converged. Bound: 0.1 % of the largest load;
    for torques with a cube's half edge, and 1 % of it where arms are those of the end of the step.
    """
    sim = simulate(falling_chain(), iterations=100)
    sim.pipeline = newton.CollisionPipeline(sim.model)
    sim.contacts = sim.pipeline.contacts()
    observables = sim.observe(CONTACT_F, BODY_QDD, PARENT_F)
    mass, largest = sim.mass[:, None], 0.0
    for _ in range(60):
        inertia = sim.world_inertia
        sim.step()
        acceleration = observables.body_qdd.numpy().astype(float)
        parent_f = observables.body_parent_f.numpy().astype(float)
        sums = parent_f + contact_sums(sim, observables.contact_f.numpy().astype(float))
        for child in (1, 2):
            arm = sim.center[child] - sim.center[child - 1]
            sums[child - 1, :3] -= parent_f[child, :3]
            sums[child - 1, 3:] -= parent_f[child, 3:] + np.cross(arm, parent_f[child, :3])
        linear = mass * (acceleration[:, :3] + [0.0, 0.0, G])
        angular = np.einsum("nij,nj->ni", inertia, acceleration[:, 3:])
        load = max(np.abs(linear).max(), mass.sum() * G)
        largest = max(largest, load)
        np.testing.assert_allclose(sums[:, :3], linear, atol=1e-3 * load)
        np.testing.assert_allclose(sums[:, 3:], angular, atol=1e-2 * load * 0.1)
    assert largest > 10.0 * mass[0] * G  # there was an impact
    np.testing.assert_allclose(acceleration, 0.0, atol=0.02 * G)  # and rest


def test_the_acceleration_is_the_second_difference_of_positions() -> None:
    """(x2 - 2 x1 + x0)/h^2 of the COMs of a swinging double pendulum.

    Bound: 1e-6 m/h^2, 0.6 % of g. Rounding of positions and what the recovery closes (joints open
    by more than 5e-7 m) move bodies without entering their velocity.
    """
    builder = newton.ModelBuilder()
    links = [add_link(builder) for _ in range(2)]
    frames = {"child_xform": transform((-0.3, 0.0, 0.0)), "axis": (0.0, 1.0, 0.0)}
    joints = [
        builder.add_joint_revolute(WORLD, links[0], **frames),
        builder.add_joint_revolute(
            links[0], links[1], parent_xform=transform((0.3, 0.0, 0.0)), **frames
        ),
    ]
    builder.add_articulation(joints)
    sim = simulate(builder, scheme="euler")
    observables = sim.observe(BODY_QDD)
    centers, accelerations = [sim.center], []
    for _ in range(60):
        sim.step()
        centers.append(sim.center)
        accelerations.append(observables.body_qdd.numpy()[:, :3].astype(float))
    second = np.diff(centers, n=2, axis=0) / sim.dt**2
    assert np.abs(second).max() > G
    np.testing.assert_allclose(accelerations[1:], second, atol=1e-6 / sim.dt**2)


def imu(builder: newton.ModelBuilder, body: int, at: Any, **settings: Any) -> Simulation:
    """A simulation of one body with a tilted inertial sensor on it."""
    builder.add_site(body, xform=transform(at, TURN), label="imu")
    sim = simulate(builder, **settings)
    sim.sensor = SensorIMU(sim.model, sites="imu", request_state_attributes=False)
    sim.observe(*sim.sensor.solver_observable_kinds)
    return sim


def reading(sim: Simulation) -> tuple[Array, Array]:
    """Specific force [m/s^2] and angular velocity [rad/s] that the sensor sees, its own frame."""
    sim.sensor.update(sim.state, observables=sim.observables)
    return sim.sensor.accelerometer.numpy()[0], sim.sensor.gyroscope.numpy()[0]


def seen(sim: Simulation, vector: Any) -> Array:
    """A vector of the world as the sensor sees it."""
    return (Rotation.from_quat(sim.pose[0, 3:]) * TURN).inv().apply(vector)


def test_an_inertial_sensor_of_a_free_body_feels_the_push_and_the_turn_only() -> None:
    """F/m + alpha x r + w x (w x r), whatever gravity is: a ball that falls, is pushed and spun."""
    builder = newton.ModelBuilder()
    body = add_mass(builder, mass=2.0, inertia=(0.1, 0.1, 0.1), com=(0.0, 0.1, 0.0))
    at = np.array([0.2, 0.1, -0.1])
    sim = imu(builder, body, at)
    sim.set_velocity(body, (1.0, 2.0, 3.0), (0.0, 0.0, 6.0))
    sim.push(body, (8.0, 0.0, 4.0), (0.0, 0.5, 0.0))
    sim.step(12)
    w = sim.velocity[0, 3:]
    r = Rotation.from_quat(sim.pose[0, 3:]).apply(at - [0.0, 0.1, 0.0])
    expected = np.array([4.0, 0.0, 2.0]) + np.cross([0.0, 5.0, 0.0], r)
    expected += np.cross(w, np.cross(w, r))
    force, spin = reading(sim)
    np.testing.assert_allclose(w, [0.0, 5.0 * 12 * sim.dt, 6.0], atol=1e-4)
    np.testing.assert_allclose(force, seen(sim, expected), atol=2e-3)
    np.testing.assert_allclose(spin, seen(sim, w), atol=1e-5)


def test_an_inertial_sensor_at_a_pivot_feels_gravity_only() -> None:
    """The hinge of a pendulum stands still however it swings: g upwards, within 2 % of g.

    COM acceleration, angular acceleration and centripetal part cancel there; the last is that of
    the end of the step, w dt ahead of the mean.
    """
    builder = newton.ModelBuilder()
    body = add_link(builder, inertia=(0.05, 0.05, 0.05))
    frames = {"child_xform": transform((-0.4, 0.0, 0.0)), "axis": (0.0, 1.0, 0.0)}
    builder.add_articulation([builder.add_joint_revolute(WORLD, body, **frames)])
    sim = imu(builder, body, (-0.4, 0.0, 0.0), dt=1.0 / 960.0)
    fastest = 0.0
    for _ in range(60):
        sim.step(8)
        force, spin = reading(sim)
        np.testing.assert_allclose(force, seen(sim, [0.0, 0.0, G]), atol=0.02 * G)
        np.testing.assert_allclose(spin, seen(sim, sim.velocity[0, 3:]), atol=1e-5)
        fastest = max(fastest, np.linalg.norm(spin))
    assert fastest > 5.0


def test_an_inertial_sensor_on_a_turntable_feels_the_centripetal_pull() -> None:
    """w^2 r towards the axle, and gravity, on a wheel with a drive that keeps its speed."""
    builder = newton.ModelBuilder()
    body = add_link(builder, inertia=(0.05, 0.05, 0.05))
    mode = newton.JointTargetMode.VELOCITY
    hinge = builder.add_joint_revolute(
        WORLD, body, axis=(0.0, 0.0, 1.0), target_kd=50.0, target_qd=10.0, actuator_mode=mode
    )
    builder.add_articulation([hinge])
    sim = imu(builder, body, (0.3, 0.0, 0.0))
    sim.step(60)
    radius = Rotation.from_quat(sim.pose[0, 3:]).apply([0.3, 0.0, 0.0])
    force, spin = reading(sim)
    np.testing.assert_allclose(force, seen(sim, [0.0, 0.0, G] - 100.0 * radius), atol=1e-3 * 30.0)
    np.testing.assert_allclose(spin, seen(sim, [0.0, 0.0, 10.0]), atol=1e-3)


def test_a_contact_sensor_tells_who_pushes_and_how_much_of_it_is_friction() -> None:
    """Two cubes on each other under a slanting gravity: statics of a slope, within 0.1 %.

    The ground carries both along -g; the upper pushes the lower along g. What is across the normal
    z is friction.
    """
    gravity = G * np.array([np.sin(0.25), 0.0, -np.cos(0.25)])
    builder = newton.ModelBuilder(gravity=tuple(gravity))
    add_ground(builder)
    lower, upper = add_box(builder, (0.0, 0.0, 0.25)), add_box(builder, (0.0, 0.0, 0.75))
    sim = Simulation(builder)
    sensor = SensorContact(
        sim.model,
        sensing_bodies=[lower, upper],
        counterpart_bodies=[lower, upper],
        request_contact_attributes=False,
    )
    sim.observe(*sensor.solver_observable_kinds)
    sim.step(120)
    sensor.update(sim.state, sim.contacts, observables=sim.observables)
    weight = sim.mass[0] * gravity
    bound = 1e-3 * 2.0 * np.linalg.norm(weight)
    across = np.array([1.0, 1.0, 0.0])
    # the lower one stands on the ground (2 weights) and carries the upper one
    total = np.array([-2.0 * weight + weight, -weight])
    np.testing.assert_allclose(sensor.total_force.numpy(), total, atol=bound)
    np.testing.assert_allclose(sensor.total_force_friction.numpy(), total * across, atol=bound)
    between = {lower: weight, upper: -weight}
    for row, body in enumerate(sensor.sensing_indices):
        for column, other in enumerate(sensor.counterpart_indices[row]):
            expected = between[body] if other != body else np.zeros(3)
            actual = sensor.force_matrix.numpy()[row, column]
            np.testing.assert_allclose(actual, expected, atol=bound)
