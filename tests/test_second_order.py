# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Schemes of second order: errors fall with the square of the step, contacts stay as they are."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import newton
import newton.examples
import numpy as np
import pytest
import warp as wp
from contract import pile, record, snapshot
from helpers import (
    EPS,
    NO_GRAVITY,
    G,
    Simulation,
    add_box,
    add_ground,
    add_mass,
    add_sphere,
    pendulum_errors,
    surface,
)
from joint_scenes import WORLD, add_link, coordinates, set_coordinates, simulate, transform
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from test_gyroscopic import AXES, MOMENTS, reference

from newton_avbd import SolverAVBD
from newton_avbd.scenes.chains import add_chain

STEPS = (1.0 / 60.0, 1.0 / 120.0, 1.0 / 240.0)

ALPHA = "generalized_alpha"


def assert_second_order(error_of: Callable[[float], float], least: float = 3.4) -> None:
    """Half the step leaves a quarter of the error, but for the next order and for rounding."""
    errors = [error_of(dt) for dt in STEPS]
    assert errors[0] > least * errors[1]
    assert errors[1] > least * errors[2]


def sliding(shape: str, dt: float, speed: float = 3.0, **settings: Any) -> Simulation:
    """A box or a sphere that starts to slide on the ground."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    (add_box if shape == "box" else add_sphere)(builder, (0.0, 0.0, 0.25))
    sim = Simulation(builder, dt=dt, **settings)
    sim.set_velocity(0, (speed, 0.0, 0.0))
    return sim


def test_a_projectile_keeps_to_its_parabola() -> None:
    """To half a rounding of a meter a step: the trapezoidal rule is exact for a constant force."""
    for dt in STEPS:
        builder = newton.ModelBuilder()
        add_mass(builder)
        sim = Simulation(builder, dt=dt, collide=False, scheme=ALPHA)
        sim.set_velocity(0, (1.0, 0.0, 5.0))
        sim.run(1.0)
        assert sim.pose[0, 2] == pytest.approx(5.0 - 0.5 * G, abs=0.5 * EPS / dt)
        assert sim.velocity[0, 2] == pytest.approx(5.0 - G, rel=200 * EPS)


def test_a_body_that_tumbles_freely_keeps_its_energy() -> None:
    """A box of 1 : 2 : 3 turns over about its middle axis, at most 0.15 rad a step, for 20 s. The
    implicit midpoint rule lets its energy swing by 1/24 of the turn's square at most."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    inertia = wp.mat33(1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0)
    builder.add_body(mass=1.0, inertia=inertia)
    sim = Simulation(builder, dt=1.0 / 120.0, collide=False, scheme=ALPHA)
    sim.set_velocity(0, (0.0, 0.0, 0.0), (1.0, 12.0, 8.0))

    def energy() -> float:
        turn = Rotation.from_quat(sim.pose[0, 3:]).inv()
        return 0.5 * float(np.array([1.0, 2.0, 3.0]) @ turn.apply(sim.velocity[0, 3:]) ** 2)

    start, energies = energy(), []
    for _ in range(2400):
        sim.step()
        energies.append(energy())
    assert np.max(np.abs(np.array(energies) / start - 1.0)) < 0.15**2 / 24.0
    assert abs(energies[-1] / start - 1.0) < 0.15**2 / 24.0


def test_a_world_at_rest_steps_by_backward_euler() -> None:
    """All schemes agree where no velocity changes: a box that lies, after one that slides."""
    sim = sliding("box", STEPS[-1], scheme=ALPHA)
    step = sim.solver._worlds.step
    sim.run(0.1)
    assert step.numpy()[0] < 0.9 * sim.dt
    sim.run(1.0)
    assert step.numpy()[0] == pytest.approx(sim.dt)


@pytest.mark.usefixtures("shared_kernels")
@pytest.mark.parametrize("armature", [0.0, 0.5])
def test_a_damped_oscillator_converges_with_order_two(armature: float) -> None:
    """A slider on a passive spring and damper in no gravity, with its closed form after 1 s."""
    mass, stiffness, damping = 1.0, 40.0, 1.0

    def error(dt: float) -> float:
        builder = newton.ModelBuilder(gravity=NO_GRAVITY)
        joint = builder.add_joint_prismatic(
            WORLD,
            add_link(builder, mass=mass),
            axis=(1.0, 0.0, 0.0),
            stiffness=stiffness,
            damping=damping,
            armature=armature,
        )
        builder.add_articulation([joint])
        set_coordinates(builder, joint, [0.3])
        sim = simulate(builder, dt=dt, scheme=ALPHA)
        sim.run(1.0)
        total = mass + armature
        rate = -0.5 * damping / total
        omega = np.sqrt(stiffness / total - rate**2)
        belongs = 0.3 * np.exp(rate) * (np.cos(omega) - rate / omega * np.sin(omega))
        return abs(coordinates(sim)[0][0] - belongs)

    assert_second_order(error)


@pytest.mark.parametrize("links", [1, 2, 3])
def test_a_chain_of_hinges_converges_with_order_two(links: int) -> None:
    """Largest distance from Lagrange's equations after 2 s; backward Euler is off 20 times more."""
    errors = pendulum_errors(lambda m: SolverAVBD(m, scheme=ALPHA), links, STEPS)
    assert_second_order(errors.__getitem__, least=3.0)
    euler = pendulum_errors(lambda m: SolverAVBD(m, scheme="euler"), links, STEPS[-1:])
    assert euler[STEPS[-1]] > 20.0 * errors[STEPS[-1]]


def test_an_asymmetric_top_converges_with_order_two_and_keeps_its_momentum() -> None:
    """Orientation after 1 s; momentum to half a rounding a step and the noise of the increments."""
    omega = np.array([1.0, 2.0, -1.5])
    rotation, _ = reference(omega, 1.0)
    r = AXES.as_matrix()

    def error(dt: float) -> float:
        builder = newton.ModelBuilder(gravity=NO_GRAVITY)
        add_mass(builder, inertia=r @ np.diag(MOMENTS) @ r.T)
        sim = Simulation(builder, dt=dt, collide=False, scheme=ALPHA)
        sim.set_velocity(0, angular=omega)
        before = sim.spin_momentum[0]
        sim.run(1.0)
        drift = np.linalg.norm(sim.spin_momentum[0] - before) / np.linalg.norm(before)
        assert drift < EPS / dt
        return (Rotation.from_quat(sim.pose[0, 3:]) * rotation.inv()).magnitude()

    assert_second_order(error)


@pytest.mark.usefixtures("shared_kernels")
def test_an_asymmetric_body_on_a_ball_joint_converges_with_order_two() -> None:
    """It swings and spins about its pivot: Euler's equations there, with the torque of gravity."""
    mass, moments = 2.0, np.array([0.4, 0.15, 0.3])
    center = np.array([0.0, 0.1, -0.4])
    spin = np.array([1.0, -2.0, 3.0])
    pivot = np.diag(moments) + mass * (center @ center * np.eye(3) - np.outer(center, center))

    def rate(_t: float, y: np.ndarray) -> np.ndarray:
        q, w = y[:4], y[4:]
        down = Rotation.from_quat(q).inv().apply([0.0, 0.0, -mass * G])
        dq = 0.5 * np.append(q[3] * w + np.cross(q[:3], w), -q[:3] @ w)
        torque = np.cross(center, down) + np.cross(pivot @ w, w)
        return np.append(dq, np.linalg.solve(pivot, torque))

    start = np.array([0.0, 0.0, 0.0, 1.0, *spin])
    found = solve_ivp(rate, (0.0, 1.0), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    belongs = Rotation.from_quat(found[:4])

    def error(dt: float) -> float:
        builder = newton.ModelBuilder()
        body = add_link(builder, mass=mass, inertia=moments)
        joint = builder.add_joint_ball(WORLD, body, child_xform=transform(-center))
        builder.add_articulation([joint])
        set_coordinates(builder, joint, qd=spin)
        sim = simulate(builder, dt=dt, scheme=ALPHA)
        sim.run(1.0)
        return (Rotation.from_quat(sim.pose[0, 3:]) * belongs.inv()).magnitude()

    assert_second_order(error)


def test_steps_of_changing_length_keep_the_order() -> None:
    """A pendulum by steps of 0.9 and 1.1 dt in turn, against one by steps an eighth as long."""

    def angle(dt: float) -> float:
        builder = newton.ModelBuilder()
        add_chain(builder, 1, length=1.0, slope=0.5)
        sim = Simulation(builder, collide=False, scheme=ALPHA)
        for i in range(round(1.0 / dt)):
            sim.dt = dt * (0.9 if i % 2 else 1.1)
            sim.step()
        return float(Rotation.from_quat(sim.pose[0, 3:]).as_rotvec()[1])

    belongs = angle(STEPS[-1] / 8.0)
    assert_second_order(lambda dt: abs(angle(dt) - belongs))


def test_a_free_chain_keeps_its_energy_where_backward_euler_loses_it() -> None:
    """Ten links swing for 3 s at 240 Hz: below 1 % of what they can turn into motion is lost."""
    lost = {}
    for scheme in ("euler", ALPHA):
        builder = newton.ModelBuilder()
        add_chain(builder, 10, length=0.2, slope=0.5)
        sim = Simulation(builder, collide=False, scheme=scheme)
        start, weight = sim.energy, G * float(sim.mass.sum())
        sim.run(3.0)
        lost[scheme] = (start - sim.energy) / weight  # [m]
    assert abs(lost[ALPHA]) < 0.01
    assert abs(lost[ALPHA]) < 0.1 * lost["euler"]


@pytest.mark.usefixtures("shared_kernels")
@pytest.mark.parametrize("moments", [(0.1, 0.1, 0.1), (0.1, 0.2, 0.25)])
def test_a_free_chain_keeps_its_momentum(moments: tuple[float, ...]) -> None:
    """Three bodies on hinges in no gravity: linear momentum to rounding."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    bodies = [add_link(builder, inertia=moments) for _ in range(3)]
    joints = [builder.add_joint_free(bodies[0])]
    for parent, child in pairwise(bodies):
        joints.append(
            builder.add_joint_revolute(
                parent,
                child,
                parent_xform=transform((0.3, 0.0, 0.0)),
                child_xform=transform((-0.3, 0.0, 0.0)),
                axis=(0.0, 1.0, 0.0),
            )
        )
    builder.add_articulation(joints)
    set_coordinates(builder, joints[0], qd=[1.0, 0.5, 0.0, 0.3, 0.2, 0.1])
    set_coordinates(builder, joints[1], qd=[3.0])
    sim = simulate(builder, scheme=ALPHA)
    before = sim.mass @ sim.velocity[:, :3]
    sim.run(1.0)
    assert sim.mass @ sim.velocity[:, :3] == pytest.approx(before, abs=1.0e-4)


def test_a_sliding_box_converges_with_order_two_until_it_stops() -> None:
    """v t - mu g t^2 / 2 after 0.3 s, and v^2 / (2 mu g) where it stops, within 2 mu g h^2."""

    def error(dt: float) -> float:
        sim = sliding("box", dt, scheme=ALPHA)
        sim.run(0.3)
        return abs(sim.pose[0, 0] - (0.9 - 0.25 * G * 0.09))

    assert_second_order(error)
    for dt in STEPS:
        sim = sliding("box", dt, scheme=ALPHA)
        sim.run(1.0)
        assert sim.pose[0, 0] == pytest.approx(9.0 / G, abs=2.0 * G * dt**2)
        assert np.abs(sim.velocity).max() < 1.0e-4


@pytest.mark.parametrize("dt", STEPS)
def test_a_box_that_lands_stays(dt: float) -> None:
    """From 1 m at 4.4 m/s: neither does it bounce, by more than g h, nor does it sink in."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 1.25))
    sim = Simulation(builder, dt=dt, scheme=ALPHA)
    highest = 0.0
    for _ in range(round(1.0 / dt)):
        sim.step()
        highest = max(highest, sim.velocity[0, 2])
    assert highest < G * dt
    assert np.abs(sim.velocity).max() < 1.0e-3
    assert sim.pose[0, 2] == pytest.approx(0.25, abs=0.1 * G * dt**2)


@pytest.mark.usefixtures("shared_kernels")
def test_an_arm_that_falls_on_its_limit_stays() -> None:
    """At 5 rad/s: from the landing on it is within 1e-3 of the limit."""
    builder = newton.ModelBuilder()
    joint = builder.add_joint_revolute(
        WORLD,
        add_link(builder),
        child_xform=transform((-0.4, 0.0, 0.0)),
        axis=(0.0, 1.0, 0.0),
        limit_upper=0.5,
    )
    builder.add_articulation([joint])
    sim = simulate(builder, scheme=ALPHA)
    path = []
    for _ in range(240):
        sim.step()
        path.append(coordinates(sim)[0][0])
    landed = int(np.argmax(np.array(path) > 0.499))
    assert 0 < landed < 120
    assert min(path[landed:]) > 0.499
    assert max(path) < 0.5 + 1.0e-4


def test_a_force_gives_its_impulse_in_the_step_it_acts_in() -> None:
    """Pushed with 2 N for ten steps, then with none: 1 kg moves at 20 h from then on."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_mass(builder)
    sim = Simulation(builder, collide=False, scheme=ALPHA)
    sim.step(5)
    sim.push(0, (2.0, 0.0, 0.0))
    sim.step(10)
    assert sim.velocity[0, 0] == pytest.approx(20.0 * sim.dt, rel=1.0e-5)
    sim.push(0)
    sim.step(5)
    assert sim.velocity[0, 0] == pytest.approx(20.0 * sim.dt, rel=1.0e-5)


def test_a_body_that_is_put_elsewhere_starts_anew() -> None:
    """After a new velocity from outside the step is backward Euler, whatever was before."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_mass(builder)
    sim = Simulation(builder, collide=False, scheme=ALPHA)
    sim.set_velocity(0, (5.0, 0.0, 0.0))
    sim.step(4)
    sim.set_velocity(0, (0.0, 1.0, 0.0))
    x = sim.pose[0, 0]
    sim.step(3)
    assert sim.pose[0, 0] == x
    assert sim.velocity[0] == pytest.approx([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], abs=EPS)


def test_a_reset_world_repeats_itself() -> None:
    """Bit for bit the run of a new solver: nothing of the last steps is left."""
    sim = Simulation(pile(), scheme=ALPHA)
    first = record(sim, 40)
    sim.solver.reset(sim.state)
    np.testing.assert_array_equal(record(sim, 40), first)


def test_a_replayed_graph_is_the_eager_run() -> None:
    """Captured before anything ran, three steps a graph, bit for bit."""
    eager, replayed = (Simulation(pile(), scheme=ALPHA) for _ in range(2))
    replayed._next = replayed.state
    with wp.ScopedCapture(device="cpu") as capture:
        replayed.step(3)
    for _ in range(20):
        wp.capture_launch(capture.graph)
    np.testing.assert_array_equal(snapshot(replayed.state), record(eager, 60)[-1])


def test_the_ramp_is_backward_euler() -> None:
    """Its penalties know one step only."""
    builder = newton.ModelBuilder()
    add_mass(builder)
    with pytest.raises(ValueError, match="leave scheme='generalized_alpha' out"):
        SolverAVBD(builder.finalize(device="cpu"), formulation="ramp", scheme=ALPHA)


def test_gravity_that_is_switched_off_is_gone_at_once() -> None:
    """After ten steps of it a body falls at 10 g h, and goes on so."""
    builder = newton.ModelBuilder()
    add_mass(builder)
    sim = Simulation(builder, collide=False, scheme=ALPHA)
    sim.step(10)
    sim.model.set_gravity((0.0, 0.0, 0.0))
    sim.solver.notify_model_changed(newton.ModelFlags.MODEL_PROPERTIES)
    sim.step(10)
    assert sim.velocity[0, 2] == pytest.approx(-10.0 * G * sim.dt, rel=1.0e-5)


@pytest.mark.parametrize("rate", [240.0, 400.0])
def test_a_top_gains_no_energy(rate: float) -> None:
    """It spins on its tip by 0.25 and 0.15 rad a step, with 270 J, 44 J above the ground."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.3)
    tilt = Rotation.from_euler("x", 5.0, degrees=True)
    body = builder.add_body(xform=transform((0.0, 0.0, 0.3), tilt))
    tip = transform((0.0, 0.0, -0.28))
    builder.add_shape_sphere(body, xform=tip, radius=0.02, cfg=surface(mu=0.3))
    disk = surface(mu=0.3, density=2000.0)
    builder.add_shape_cylinder(body, radius=0.2, half_height=0.03, cfg=disk)
    sim = Simulation(builder, dt=1.0 / rate)
    sim.set_velocity(0, angular=tilt.apply([0.0, 0.0, 60.0]))
    start, most = sim.energy, 0.0
    for _ in range(round(3.0 * rate)):
        sim.step()
        most = max(most, sim.energy - start)
    assert most < 1.0e-4 * 270.0
    upright = Rotation.from_quat(sim.pose[0, 3:]).as_matrix()[2, 2]
    assert np.degrees(np.arccos(upright)) < 5.2


def test_a_torque_next_to_nothing_is_no_jump() -> None:
    """It goes to and fro from step to step, and gives 1e-9 of what the pendulum has."""

    def ends(torque: float) -> np.ndarray:
        builder = newton.ModelBuilder()
        add_chain(builder, 1)
        sim = simulate(builder, dt=1.0 / 240.0)
        for i in range(480):
            sim.push(0, torque=(0.0, torque * (-1) ** i, 0.0))
            sim.step()
        return sim.pose[0]

    np.testing.assert_allclose(ends(1.0e-6), ends(0.0), atol=5.0e-5)


def test_a_base_that_is_moved_by_jerks_is_followed_as_by_backward_euler() -> None:
    """Its velocity is 1 and 0 m/s by turns: how it went on says nothing of how it goes on."""

    def angles(scheme: str) -> list[float]:
        builder = newton.ModelBuilder(gravity=NO_GRAVITY)
        base = add_link(builder)
        builder.body_flags[base] = int(newton.BodyFlags.KINEMATIC)
        arm = add_link(builder, inertia=(0.01, 0.01, 0.01))
        root = builder.add_joint_free(base)
        elbow = builder.add_joint_revolute(
            base,
            arm,
            axis=(0.0, 1.0, 0.0),
            child_xform=transform((-0.2, 0.0, 0.0)),
            target_ke=200.0,
            target_kd=4.0,
        )
        builder.add_articulation([root, elbow])
        sim, found = simulate(builder, dt=1.0 / 240.0, scheme=scheme), []
        for i in range(240):
            sim.set_velocity(0, (0.0, 0.0, float(i % 2 == 0)))
            sim.step()
            found.append(float(coordinates(sim)[0][-1]))
        return found

    np.testing.assert_allclose(angles(ALPHA), angles("euler"), atol=1.0e-5)


@pytest.mark.usefixtures("shared_kernels")
@pytest.mark.parametrize("rate", [50, 60, 100, 120, 200, 240])
def test_a_quadruped_comes_to_rest_at_any_rate(rate: int) -> None:
    """Three seconds after it has been let go it is at rest, and a sweep a step is enough."""
    robot = newton.ModelBuilder()
    robot.default_joint_cfg = newton.ModelBuilder.JointDofConfig(
        target_ke=2000.0, target_kd=50.0, armature=0.01
    )
    robot.add_urdf(
        newton.examples.get_asset("quadruped.urdf"),
        xform=transform((0.0, 0.0, 0.6)),
        floating=True,
    )
    stance = [0.2, 0.4, -0.6, -0.2, -0.4, 0.6, -0.2, 0.4, -0.6, 0.2, -0.4, 0.6]
    robot.joint_q[-12:] = robot.joint_target_q[-12:] = stance
    robot.add_ground_plane()
    sim = simulate(robot, collide=True, dt=1.0 / rate)
    sim.step(3 * rate)
    at = sim.pose
    for _ in range(rate):
        sim.step()
        assert sim.solver.status.sweeps.max() == 1
    assert np.abs(sim.velocity).max() < 2.0e-5
    assert np.abs(sim.pose - at).max() < 2.0e-6
