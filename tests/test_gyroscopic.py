# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A body that turns freely keeps its angular momentum and follows Euler's equations."""

from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import EPS, NO_GRAVITY, Simulation, add_mass
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

MOMENTS = np.array([0.15, 0.25, 0.35])
AXES = Rotation.from_euler("xyz", [0.7, -0.4, 1.1])
"""Principal axes of the body whose inertia tensor is not diagonal."""


def spinning(omega: np.ndarray, dt: float, axes: Rotation = AXES, **settings: str) -> Simulation:
    """A body with principal moments MOMENTS along ``axes``, turning at ``omega`` [rad/s]."""
    r = axes.as_matrix()
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_mass(builder, inertia=r @ np.diag(MOMENTS) @ r.T)
    sim = Simulation(builder, dt=dt, collide=False, **settings)
    sim.set_velocity(0, angular=omega)
    return sim


def reference(omega: np.ndarray, seconds: float, axes: Rotation = AXES):
    """Orientation and angular velocity by an 8th order method, relative error 1e-12."""
    r = axes.as_matrix()
    inertia = r @ np.diag(MOMENTS) @ r.T
    inverse = np.linalg.inv(inertia)

    def rate(_t: float, y: np.ndarray) -> np.ndarray:
        q, w = y[:4], y[4:]
        dq = 0.5 * np.append(q[3] * w + np.cross(q[:3], w), -q[:3] @ w)
        return np.append(dq, inverse @ np.cross(inertia @ w, w))

    start = np.array([0.0, 0.0, 0.0, 1.0, *omega])  # w in body axes, which start as the world's
    y = solve_ivp(rate, (0.0, seconds), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    rotation = Rotation.from_quat(y[:4])
    return rotation, rotation.apply(y[4:])


def test_an_asymmetric_top_converges_to_the_exact_motion_with_order_one() -> None:
    """Half the step, half the error, within a tenth: h |w| is 0.04, and so is the next order.

    Backward Euler takes w at the end of the step where the motion has its mean: off by h/2 dw in
    the angle, and the momentum seen from the body by as much again. With |dw/dt| up to 3 rad/s^2
    that is at most 3 h in one second.
    """
    omega = np.array([1.0, 2.0, -1.5])
    rotation, w = reference(omega, 1.0)
    steps = (1.0 / 60.0, 1.0 / 120.0, 1.0 / 240.0)
    angle_errors, spin_errors = [], []
    for dt in steps:
        sim = spinning(omega, dt, scheme="euler")
        sim.run(1.0)
        angle_errors.append((Rotation.from_quat(sim.pose[0, 3:]) * rotation.inv()).magnitude())
        spin_errors.append(np.linalg.norm(sim.velocity[0, 3:] - w))
    for errors in (angle_errors, spin_errors):
        assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)
        assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.2)
        assert errors[0] < 3.0 * steps[0]


@pytest.mark.parametrize(
    ("omega", "seconds"),
    [
        ([1.0, 2.0, -1.5], 8.0),
        ([30.0, -20.0, 25.0], 8.0),
        ([600.0, -500.0, 620.0], 4.0),  # 1,000 rad/s: more than half a turn a step
    ],
)
def test_a_free_top_keeps_its_momentum_and_gains_no_energy(
    omega: list[float], seconds: float
) -> None:
    """Momentum and energy after every step, at any spin, for a full inertia tensor.

    Float32 rounds some twenty times a step, but to either side: half a unit a step is what the
    rounded inertia and its inverse may add up to. More would be a bias, a source of energy in
    every scene. The direction of the momentum turns with the rounding of the orientation.
    Backward Euler only takes energy away; the rounding of the momentum counts twice in it.
    """
    sim = spinning(np.array(omega), 1.0 / 240.0)
    start, energy = sim.spin_momentum[0], sim.kinetic_energy
    size = np.linalg.norm(start)
    steps = round(seconds * 240.0)
    highest = energy
    for _ in range(steps):
        sim.step()
        highest = max(highest, sim.kinetic_energy)
    drift = 0.5 * EPS * steps
    assert np.linalg.norm(sim.spin_momentum[0]) == pytest.approx(size, rel=drift)
    assert np.linalg.norm(sim.spin_momentum[0] - start) < 4.0 * drift * size
    assert highest < (1.0 + 2.0 * drift) * energy


def test_a_spin_about_the_middle_axis_flips_and_keeps_its_momentum() -> None:
    """Dzhanibekov: the middle axis is unstable, so the body turns over; the momentum does not.

    The exact motion is upside down from 3 s to 7 s; with 1 % of the energy lost the body turns
    back sooner. Momentum: half a unit a step, as above.
    """
    sim = spinning(np.array([0.05, 5.0, 0.0]), 1.0 / 1000.0, Rotation.identity(), scheme="euler")
    start = sim.spin_momentum[0]
    side = []
    for _ in range(160):
        sim.step(50)
        side.append(Rotation.from_quat(sim.pose[0, 3:]).as_matrix()[1, 1])
    down = int(np.argmin(side))
    assert side[down] < -0.95
    assert max(side[down:]) > 0.95
    steps = 160 * 50
    size = np.linalg.norm(start)
    assert np.linalg.norm(sim.spin_momentum[0]) == pytest.approx(size, rel=0.5 * EPS * steps)
    assert np.linalg.norm(sim.spin_momentum[0] - start) < 2.0 * EPS * steps * size


@pytest.mark.parametrize("axis", [0, 2])
def test_a_spin_about_the_smallest_or_largest_axis_stays_there(axis: int) -> None:
    """Both axes are stable: what is off the axis at the start, 1 % each way, stays that small.

    The conserved momentum and energy let it trade between the other two axes, by less than a
    factor of three for these moments. Backward Euler drains energy and so leaves the smallest
    axis in the end: not within 4 s at this step.
    """
    omega = np.full(3, 0.05)
    omega[axis] = 5.0
    sim = spinning(omega, 1.0 / 1000.0, Rotation.identity())
    sim.run(4.0)
    w_body = Rotation.from_quat(sim.pose[0, 3:]).inv().apply(sim.velocity[0, 3:])
    assert np.linalg.norm(np.delete(w_body, axis)) < 0.03 * 5.0
    assert w_body[axis] == pytest.approx(5.0, rel=1.0e-3)


@pytest.mark.parametrize("has_ground", [False, True])
@pytest.mark.parametrize("spin", [12.0, 30.0, 200.0, 1000.0])
def test_what_is_long_and_spins_about_its_length_does_not_tumble(
    spin: float, has_ground: bool
) -> None:
    """The angle between the axis of symmetry and the momentum stays (Euler); at 60 Hz."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    if has_ground:
        builder.add_ground_plane()
    position = wp.transform((0.0, 0.0, 20.0), wp.quat_identity())
    inertia = wp.mat33(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.2)
    body = builder.add_body(xform=position, mass=1.0, inertia=inertia)
    if has_ground:
        cfg = newton.ModelBuilder.ShapeConfig(density=0.0)
        builder.add_shape_capsule(body, radius=0.1, half_height=0.3, cfg=cfg)
    sim = Simulation(builder, dt=1.0 / 60.0, collide=has_ground)
    sim.set_velocity(0, angular=(0.02 * spin, 0.0, spin))
    momentum = np.array([0.02, 0.0, 0.2])
    for _ in range(10):
        sim.run(0.5)
        axis = Rotation.from_quat(sim.pose[0, 3:]).apply([0.0, 0.0, 1.0])
        off = np.arccos(axis @ momentum / np.linalg.norm(momentum))
        assert off == pytest.approx(np.arctan(0.1), rel=0.02)


def test_a_body_that_flips_keeps_its_energy() -> None:
    """It swings by a thousandth and does not drift, at 0.13 and 0.5 rad a step of 60 Hz."""
    for speed in (8.0, 30.0):
        sim = spinning(AXES.apply([0.01, speed, 0.01]), 1.0 / 60.0)
        start = sim.kinetic_energy
        energies = []
        for _ in range(240):
            sim.step(10)
            energies.append(sim.kinetic_energy / start)
        assert max(np.abs(np.array(energies) - 1.0)) < 2.0e-3
        assert np.mean(energies[-60:]) == pytest.approx(np.mean(energies[:60]), abs=5.0e-4)


def test_a_round_body_keeps_its_spin() -> None:
    """With equal moments nothing turns the axis: w stays, up to the rounding of w h / h."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_mass(builder, rotation=wp.quat(*AXES.as_quat()))
    sim = Simulation(builder, collide=False)
    omega = np.array([3.0, -200.0, 40.0])
    sim.set_velocity(0, angular=omega)
    sim.step(1000)
    assert sim.velocity[0, 3:] == pytest.approx(omega, rel=2.0 * EPS)


def _link(builder: newton.ModelBuilder, mass: float, moments: Any, height: float = 0.0) -> int:
    """A body of these principal moments [kg m^2], for an articulation."""
    return builder.add_link(
        mass=mass,
        inertia=wp.mat33(*np.diag(moments).ravel()),
        xform=wp.transform(wp.vec3(0.0, 0.0, height), wp.quat_identity()),
        lock_inertia=True,
    )


@pytest.mark.parametrize("spin", [300.0, 1000.0, 5000.0])
def test_a_top_precesses_as_fast_as_its_weight_turns_its_momentum(spin: float) -> None:
    """A disc of 5 g m^2 spins on a ball joint at the end of a level axle of 0.1 m.

    Its weight turns the momentum I w about the vertical at m g l/(I w). Level, that is exact for
    the steady precession (Goldstein, "Classical Mechanics", section 5.7). It starts without, and
    goes below its level by 2 m g l A/(I w)^2 at most, for A = 12.5 g m^2 about the joint.
    """
    builder = newton.ModelBuilder()
    disc = _link(builder, 1.0, (0.005, 0.0025, 0.0025), 1.0)
    joint = builder.add_joint_ball(
        -1,
        disc,
        parent_xform=wp.transform(wp.vec3(-0.1, 0.0, 1.0), wp.quat_identity()),
        child_xform=wp.transform(wp.vec3(-0.1, 0.0, 0.0), wp.quat_identity()),
    )
    builder.add_articulation([joint])
    sim = Simulation(builder, collide=False)
    sim.set_velocity(0, angular=(spin, 0.0, 0.0))
    sim.run(1.0)
    axle = Rotation.from_quat(sim.pose[0, 3:]).apply([1.0, 0.0, 0.0])
    rate = 9.81 * 0.1 / (0.005 * spin)
    # float32 rounds the turn of the axle by some EPS a step
    assert np.arctan2(axle[1], axle[0]) == pytest.approx(rate, rel=0.01, abs=240 * EPS)
    assert abs(axle[2]) < 2.0 * 9.81 * 0.1 * 0.0125 / (0.005 * spin) ** 2 + 240 * EPS


@pytest.mark.parametrize("has_shapes", [False, True])
@pytest.mark.parametrize("spin", [300.0, 1000.0, 5000.0])
def test_a_flywheel_in_a_free_body_keeps_the_momentum_of_both(
    spin: float, has_shapes: bool
) -> None:
    """A kick across the spin turns their momentum by what it brings, and no energy comes of it.

    With shapes they are an island, which had 5 % too much momentum after a second, and half of the
    energy.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    hull, wheel = _link(builder, 5.0, (0.3, 0.3, 0.3)), _link(builder, 1.0, (0.05, 0.05, 0.1), 0.3)
    joints = [
        builder.add_joint_free(hull),
        builder.add_joint_revolute(
            hull,
            wheel,
            axis=(0.0, 0.0, 1.0),
            parent_xform=wp.transform(wp.vec3(0.0, 0.0, 0.3), wp.quat_identity()),
        ),
    ]
    builder.add_articulation(joints)
    for body in (hull, wheel) if has_shapes else ():
        builder.add_shape_sphere(body, radius=0.01, cfg=builder.ShapeConfig(density=0.0))
    sim = Simulation(builder, collide=has_shapes)
    sim.set_velocity(wheel, angular=(0.0, 0.0, spin))
    sim.push(hull, torque=(1.0 / sim.dt, 0.0, 0.0))
    sim.step()
    sim.push(hull)
    energy = sim.kinetic_energy
    sim.run(1.0)
    away = sim.center - sim.mass @ sim.center / np.sum(sim.mass)
    orbit = np.cross(away, sim.mass[:, None] * sim.velocity[:, :3])
    momentum = np.sum(sim.spin_momentum + orbit, axis=0)
    assert momentum == pytest.approx([1.0, 0.0, 0.1 * spin], abs=0.02)
    # backward Euler takes the nutation; the share of rounding is that of the spin
    assert 0.998 * energy < sim.kinetic_energy < energy * (1.0 + 240 * EPS)
