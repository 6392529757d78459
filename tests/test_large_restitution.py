# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Restitution in one large world, beside the kernel that solves a world in one thread."""

import math

import newton
import numpy as np
import pytest
import warp as wp
from contract import record, snapshot, worlds
from helpers import NO_GRAVITY, G, Simulation, add_box, add_ground, add_sphere
from joint_scenes import WORLD, add_link, transform
from test_large_joints import in_order_of_colors
from test_restitution import ADD, gas


def energy(simulation: Simulation) -> float:
    """Kinetic and potential energy of bodies that do not turn [J]."""
    height, speed = simulation.pose[:, 2], simulation.velocity[:, :3]
    return float(simulation.mass @ (G * height + 0.5 * (speed**2).sum(axis=1)))


@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_drops_rebound_to_e_squared_of_their_height(shape: str) -> None:
    """With e from 0 to 1 within 0.3 %, and to the bits of the kernel of a world: they are apart."""
    shares = np.linspace(0.0, 1.0, 6)
    simulations = []
    for parallel in ("bodies", "worlds"):
        builder = newton.ModelBuilder()
        for i, e in enumerate(shares):
            # of their own world, so that no order of the bodies tells one kernel from the other
            builder.begin_world()
            add_ground(builder, gap=0.05, restitution=e)
            ADD[shape](builder, (float(i), 0.0, 1.25), gap=0.05, restitution=e)
            builder.end_world()
        simulations.append(Simulation(builder, parallel=parallel))
    top = np.zeros(shares.size)
    colored, serial = simulations
    for _ in range(220):
        colored.step()
        serial.step()
        np.testing.assert_array_equal(colored.pose, serial.pose)
        top = np.maximum(top, np.where(colored.velocity[:, 2] > 0.0, colored.pose[:, 2] - 0.25, 0))
    dt = colored.dt
    np.testing.assert_allclose(top, shares**2, rtol=3e-3, atol=0.25 * G * dt**2)


@pytest.mark.parametrize("moving", [1, 2, 3])
@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_newtons_cradle_passes_as_many_bodies_as_came(shape: str, moving: int) -> None:
    """Of seven equal bodies in a row, the last leave with the speed of the first."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    for i in range(7):
        x = 0.5 * i - (0.3 if i < moving else 0.0)
        ADD[shape](builder, (x, 0.0, 0.0), 0.5 if shape == "box" else 0.25, restitution=1.0)
    simulation = Simulation(builder, parallel="bodies")
    for i in range(moving):
        simulation.set_velocity(i, (2.0, 0.0, 0.0))
    simulation.run(0.5)
    expected = np.where(np.arange(7) >= 7 - moving, 2.0, 0.0)
    np.testing.assert_allclose(simulation.velocity[:, 0], expected, atol=2e-4)
    assert np.abs(simulation.velocity[:, 1:]).max() < 2e-4


def heap(e: float = 0.5) -> newton.ModelBuilder:
    """Boxes and spheres that fall on each other, some of them by way of others."""
    builder = newton.ModelBuilder()
    add_ground(builder, restitution=e)
    rng = np.random.default_rng(2)
    for i in range(24):
        place = (*rng.uniform(-0.4, 0.4, 2), 0.4 + 0.3 * i)
        (add_box if i % 3 else add_sphere)(builder, place, rng.uniform(0.2, 0.3), restitution=e)
    return builder


@pytest.mark.parametrize(("every", "steps", "impacts"), [(4, 13, 2), (1, 24, 6)])
def test_impacts_are_those_of_one_thread_in_the_order_of_the_colors(
    every: int, steps: int, impacts: int
) -> None:
    """Of a pyramid that falls and bounces, to rounding, as long as that has not grown.

    Every fourth body is a sphere, or all are. From the 14th step on a change of places by 1e-7 m
    moves boxes by 1e-4 m, whichever way they are solved; spheres it does not.
    """
    builder = newton.ModelBuilder()
    add_ground(builder, gap=0.1, restitution=0.5)
    places = [(i - 0.5 * (5 - row), row + 0.5) for row in range(5) for i in range(5 - row)]
    for i, (x, z) in enumerate(places):
        shape, size = (add_box, 0.5) if i % every else (add_sphere, 0.25)
        place = (0.55 * x, 0.0, 0.1 + 0.52 * z)
        body = shape(builder, place, size, gap=0.1, restitution=0.5)
        shove = 0.1 * (i % 3 - 1)
        builder.body_qd[body] = wp.spatial_vector(shove, 0.05 * (i % 2), -2.0, shove, 0.0, 0.1)
    colored = Simulation(builder, parallel="bodies")
    serial = Simulation(builder, blocks="body")
    struck = 0
    for _ in range(steps):
        colored.step()
        in_order_of_colors(colored, serial)
        serial.step()
        struck += int(colored.solver._large.colors.has_impacts.numpy()[0])
        np.testing.assert_allclose(colored.pose, serial.pose, atol=1e-6)
        np.testing.assert_allclose(colored.velocity, serial.velocity, atol=1e-5)
    assert struck >= impacts
    assert colored.velocity[:, 2].max() > 1.0  # they bounced


def test_a_heap_that_bounces_comes_to_rest() -> None:
    """After 6 s, but for spheres that roll on."""
    simulation = Simulation(heap(), parallel="bodies")
    simulation.run(6.0)
    assert simulation.penetration < 5e-4
    assert np.abs(simulation.velocity[:, 2]).max() < 1e-3
    assert not simulation.solver.status.held_steps.any()


def test_elastic_spheres_without_friction_keep_energy_and_momentum() -> None:
    """After collisions in all directions, within 1e-5 and 1e-6 of what they started with."""
    simulation = gas("sphere", 0.0, 1.0, side=4, parallel="bodies")
    mass, before, speed = simulation.mass[:, None], simulation.kinetic_energy, simulation.velocity
    simulation.run(1.0)
    assert np.abs(simulation.velocity[:, :3] - speed[:, :3]).max() > 1.0  # they did collide
    assert simulation.kinetic_energy == pytest.approx(before, rel=1e-5)
    momentum = (mass * (simulation.velocity - speed)[:, :3]).sum(axis=0)
    assert np.abs(momentum).max() < 1e-6 * math.sqrt(2.0 * before * mass.sum())


@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_friction_and_loss_only_take_energy(shape: str) -> None:
    """With mu = 0.5 and e = 0.5 no step adds more than 1e-5 of it."""
    simulation = gas(shape, 0.5, 0.5, side=4, parallel="bodies")
    energies = [simulation.kinetic_energy]
    for _ in range(120):
        simulation.step()
        energies.append(simulation.kinetic_energy)
    assert np.diff(energies).max() < 1e-5 * energies[0]
    assert energies[-1] < 0.5 * energies[0]


@pytest.mark.parametrize("rate", [480, 960])
def test_a_falling_column_of_elastic_spheres_keeps_its_energy(rate: int) -> None:
    """Impacts that follow each other within a step."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.0, restitution=1.0)
    for i in range(6):
        add_sphere(builder, (0.0, 0.0, 1.25 + 0.51 * i), mu=0.0, restitution=1.0)
    simulation = Simulation(builder, dt=1.0 / rate, parallel="bodies")
    start = energy(simulation)
    simulation.run(1.0)
    assert energy(simulation) == pytest.approx(start, rel=1.5e-2)


def test_many_strike_one_body_in_turn() -> None:
    """A light plate under twelve balls: by momentum and energy, as one ball of their mass would.

    Balls all strike the plate and so are of a wave each. With e = 1 the plate leaves at twice the
    speed of the center of mass less its own, 2 v m / (m + M).
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_box(builder, (0.0, 0.0, 0.0), (2.0, 1.5, 0.1), mu=0.0, restitution=1.0)
    for i in range(12):
        place = (0.5 * (i % 4 - 1.5), 0.5 * (i // 4 - 1), 0.06 + 0.1)
        ball = add_sphere(builder, place, 0.1, mu=0.0, density=3000.0, restitution=1.0)
        builder.body_qd[ball] = wp.spatial_vector(0.0, 0.0, -3.0, 0.0, 0.0, 0.0)
    simulation = Simulation(builder, parallel="bodies")
    plate, balls = simulation.mass[0], simulation.mass[1:].sum()
    simulation.run(0.1)
    expected = -2.0 * 3.0 * balls / (balls + plate)
    assert simulation.velocity[0, 2] == pytest.approx(expected, rel=1e-4)
    np.testing.assert_allclose(simulation.velocity[1:, 2], expected + 3.0, atol=1e-3)
    assert np.abs(simulation.velocity[0, 3:]).max() < 1e-3


@pytest.mark.parametrize("restitution", [0.5, 1.0])
def test_a_hinged_bar_gives_back_what_its_inertia_about_the_hinge_says(restitution: float) -> None:
    """A ball hits it r = 0.3 m below the hinge: J = (1 + e) v/(1/m + r^2/I), within 0.2 %."""
    arm, v = 0.3, 3.0
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    bar = add_link(builder, xform=transform((0.0, 0.0, -0.5)))
    material = builder.ShapeConfig(mu=0.0, density=1000.0, gap=0.02, restitution=restitution)
    builder.add_shape_box(bar, hx=0.05, hy=0.05, hz=0.5, cfg=material)
    anchor = transform((0.0, 0.0, 0.5))
    hinge = builder.add_joint_revolute(WORLD, bar, child_xform=anchor, axis=(0.0, 1.0, 0.0))
    builder.add_articulation([hinge])
    add_sphere(builder, (-0.5, 0.0, -arm), 0.1, mu=0.0, restitution=restitution)
    simulation = Simulation(builder, parallel="bodies")
    simulation.set_velocity(1, (v, 0.0, 0.0))
    simulation.run(0.25)
    inertia = simulation.world_inertia[0, 1, 1] + simulation.mass[0] * 0.5**2
    impulse = (1.0 + restitution) * v / (1.0 / simulation.mass[1] + arm**2 / inertia)
    ball = v - impulse / simulation.mass[1]
    assert simulation.velocity[1, 0] == pytest.approx(ball, abs=2e-3 * v)
    assert simulation.velocity[0, 4] == pytest.approx(-impulse * arm / inertia, rel=2e-3)


def test_runs_worlds_and_graphs_give_the_same_bits() -> None:
    """Of a heap that bounces: again, as one of three worlds, and replayed."""
    eager = Simulation(heap(), parallel="bodies")
    expected = record(eager, 80)
    eager.solver.reset(eager.state)
    np.testing.assert_array_equal(record(eager, 80), expected)
    three = Simulation(worlds(heap(), 3), parallel="bodies")
    three.step(80)
    count = expected.shape[1]
    for i in range(3):
        world = slice(i * count, (i + 1) * count)
        np.testing.assert_array_equal(snapshot(three.state)[world], expected[-1])
    replayed = Simulation(heap(), parallel="bodies")
    state = replayed.state
    with wp.ScopedCapture(device="cpu") as capture:
        replayed.step(2)
    for _ in range(40):
        wp.capture_launch(capture.graph)
    np.testing.assert_array_equal(snapshot(state), expected[-1])


def test_restitution_can_come_at_run_time() -> None:
    """A notification is enough, and the world stays one that is solved color by color."""
    builder = newton.ModelBuilder()
    add_ground(builder, gap=0.1)
    add_sphere(builder, (0.0, 0.0, 1.25), gap=0.1)
    simulation = Simulation(builder, parallel="bodies")
    simulation.step()
    simulation.model.shape_material_restitution.fill_(0.5)
    simulation.solver.notify_model_changed(newton.ModelFlags.SHAPE_PROPERTIES)
    assert simulation.solver.parallel == "bodies"
    top = 0.0
    for _ in range(200):
        simulation.step()
        if simulation.velocity[0, 2] > 0.0:
            top = max(top, simulation.pose[0, 2] - 0.25)
    assert top == pytest.approx(0.25, rel=5e-3)
