# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Torsional and rolling friction: torques up to mu_torsional and mu_rolling times the force."""

import math
import warnings

import newton
import numpy as np
import pytest
import warp as wp
from helpers import IDENTITY, G, Simulation, add_box, add_ground, add_sphere, surface

RADIUS = 0.25
DTS = [1.0 / 60.0, 1.0 / 240.0]


def on_plane(
    shape: str, twist: float, roll: float, *, mu: float = 0.5, angle: float = 0.0, **settings: float
) -> Simulation:
    """A sphere or a disc that rests on a plane that falls towards +x, with friction in meters."""
    material = {"mu_torsional": twist, "mu_rolling": roll}
    slope = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), angle)
    builder = newton.ModelBuilder()
    builder.add_shape_plane(
        xform=wp.transform(wp.vec3(), slope),
        width=0.0,
        length=0.0,
        cfg=surface(mu, density=0.0, **material),
    )
    height = RADIUS if shape == "sphere" else 0.05
    position = wp.quat_rotate(slope, wp.vec3(0.0, 0.0, height))
    if shape == "sphere":
        add_sphere(builder, position, RADIUS, mu=mu, **material)
    else:
        body = builder.add_body(xform=wp.transform(position, slope))
        builder.add_shape_cylinder(
            body, radius=0.3, half_height=height, cfg=surface(mu, **material)
        )
    return Simulation(builder, angular_friction=True, **settings)


def moment_about_z(sim: Simulation) -> float:
    return float(sim.world_inertia[0, 2, 2])


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("twist", [0.005, 0.05])
@pytest.mark.parametrize("shape", ["sphere", "disc"])
def test_a_spin_ends_after_its_momentum_over_the_torque(
    shape: str, twist: float, dt: float
) -> None:
    """t = I w/(mu_t m g), within 1 %; without sliding friction, which would hold a disc, too."""
    sim = on_plane(shape, twist, 0.0, mu=0.0, dt=dt)
    deceleration = twist * sim.mass[0] * G / moment_about_z(sim)
    sim.set_velocity(0, angular=(0.0, 0.0, 0.5 * deceleration))
    sim.run(0.25)
    assert sim.velocity[0, 5] == pytest.approx(0.25 * deceleration, rel=0.01)
    sim.run(0.25 + 3.0 * dt)
    assert np.abs(sim.velocity).max() < 1.0e-4 * deceleration


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("roll", [1.0e-4, 1.0e-3, 0.02])
def test_a_rolling_sphere_stops_after_its_distance(roll: float, dt: float) -> None:
    """a = mu_r g/(7/5 r): v/a and v^2/(2 a), less v dt/2 of backward Euler, within 1 %."""
    sim = on_plane("sphere", 0.0, roll, dt=dt, scheme="euler")
    deceleration = roll * G / (1.4 * RADIUS)
    speed = 0.5 * deceleration
    sim.set_velocity(0, (speed, 0.0, 0.0), (0.0, speed / RADIUS, 0.0))
    sim.run(0.25)
    assert sim.velocity[0, 0] == pytest.approx(0.5 * speed, rel=0.01)
    sim.run(0.25 + 3.0 * dt)
    expected = speed**2 / (2.0 * deceleration) - 0.5 * speed * dt
    assert sim.pose[0, 0] == pytest.approx(expected, rel=0.01)
    assert np.abs(sim.velocity).max() < 1.0e-3 * speed


@pytest.mark.parametrize("dt", DTS)
def test_a_sphere_stays_on_a_slope_that_rolling_friction_holds(dt: float) -> None:
    """At 98 % of tan(angle) = mu_r/r it does not creep; at 105 % it rolls as it should, to 1 %."""
    roll = 0.05
    sim = on_plane("sphere", 0.0, roll, mu=0.8, angle=math.atan(0.98 * roll / RADIUS), dt=dt)
    sim.run(0.5)
    start = sim.pose[0]
    sim.run(1.0)
    assert np.abs(sim.pose[0] - start).max() < 1.0e-7

    angle = math.atan(1.05 * roll / RADIUS)
    sim = on_plane("sphere", 0.0, roll, mu=0.8, angle=angle, dt=dt)
    sim.run(0.5)
    before = np.linalg.norm(sim.velocity[0, :3])
    sim.run(1.0)
    expected = G * (math.sin(angle) - roll / RADIUS * math.cos(angle)) / 1.4
    assert np.linalg.norm(sim.velocity[0, :3]) - before == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("dt", DTS)
def test_torsional_friction_holds_against_a_torque_below_its_bound(dt: float) -> None:
    """At 98 % of mu_t m g nothing turns; at 105 % the rest accelerates the spin, to 1 %."""
    twist = 0.02
    for share in (0.98, 1.05):
        sim = on_plane("sphere", twist, 0.0, dt=dt)
        most = twist * sim.mass[0] * G
        sim.push(0, torque=(0.0, 0.0, share * most))
        sim.run(0.5)
        start = sim.velocity[0, 5]
        sim.run(0.5)
        gained = 0.5 * max(share - 1.0, 0.0) * most / moment_about_z(sim)
        assert sim.velocity[0, 5] - start == pytest.approx(gained, rel=0.01, abs=1.0e-7)


@pytest.mark.parametrize(("iterations", "bound"), [(10, 0.05), (50, 1.0e-3)])
def test_a_box_twists_against_both_frictions(iterations: int, bound: float) -> None:
    """A box pushed by a torque above its bound: sliding friction and mu_t m g add up.

    The four corners slide at an arm of a/sqrt(2): mu m g a/sqrt(2) for a square of edge a. Each of
    them has a penalty for the whole body, which takes more sweeps than a sphere's one contact.
    """
    mu, twist, edge = 0.3, 0.1, 0.5
    builder = newton.ModelBuilder()
    add_ground(builder, mu, mu_torsional=twist)
    add_box(builder, (0.0, 0.0, 0.05), (edge, edge, 0.1), mu=mu, mu_torsional=twist)
    sim = Simulation(builder, angular_friction=True, iterations=iterations)
    held = sim.mass[0] * G * (mu * edge / math.sqrt(2.0) + twist)
    sim.push(0, torque=(0.0, 0.0, 1.5 * held))
    sim.run(0.1)
    start = sim.velocity[0, 5]
    sim.run(0.2)
    expected = 0.2 * 0.5 * held / moment_about_z(sim)
    assert sim.velocity[0, 5] - start == pytest.approx(expected, rel=bound)


def test_two_spinning_spheres_share_their_spin() -> None:
    """Pressed together in empty space: torsional friction keeps their angular momentum."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    for i in range(2):
        add_sphere(builder, (0.0, 0.0, 2.0 * RADIUS * i), RADIUS, mu_torsional=0.05)
    sim = Simulation(builder, angular_friction=True)
    push = sim.mass[0] * G
    sim.push(0, (0.0, 0.0, push))
    sim.push(1, (0.0, 0.0, -push))
    sim.set_velocity(1, angular=(0.0, 0.0, 4.0))
    sim.run(0.05)
    rate = 0.05 * push / (0.4 * sim.mass[0] * RADIUS**2)
    assert sim.velocity[:, 5] == pytest.approx([0.05 * rate, 4.0 - 0.05 * rate], rel=0.05)
    sim.run(0.5)
    assert sim.velocity[:, 5] == pytest.approx([2.0, 2.0], abs=1.0e-3)


def test_contact_forces_report_the_torque() -> None:
    """What holds a sphere against a torque is the contact's torque on it."""
    sim = on_plane("sphere", 0.02, 0.0)
    observed = sim.observe("contact_f")
    torque = 0.5 * 0.02 * sim.mass[0] * G
    sim.push(0, torque=(0.0, 0.0, torque))
    sim.run(0.5)
    assert abs(observed.contact_f.numpy()[0, 5]) == pytest.approx(torque, rel=1.0e-3)


def test_what_nobody_asked_for_is_left_out_and_said() -> None:
    """Newton's defaults cost nothing; values of one's own are named, unless there is an answer."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain = newton.ModelBuilder()
        add_sphere(plain, (0.0, 0.0, RADIUS))
        assert not Simulation(plain).solver.effects.flags.angular_friction
        authored = newton.ModelBuilder()
        add_sphere(authored, (0.0, 0.0, RADIUS), mu_rolling=0.02)
        assert not Simulation(
            authored, angular_friction=False
        ).solver.effects.flags.angular_friction
    with pytest.warns(UserWarning, match="torsional and rolling friction of 1 shape"):
        Simulation(authored)


def test_without_coefficients_there_is_no_effect() -> None:
    builder = newton.ModelBuilder()
    builder.add_body(xform=wp.transform(wp.vec3(), IDENTITY))
    builder.add_shape_sphere(0, radius=RADIUS, cfg=surface(mu_torsional=0.0, mu_rolling=0.0))
    assert not Simulation(builder, angular_friction=True).solver.effects.flags.angular_friction
