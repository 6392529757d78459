# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies at rest on each other: they stay, and their contact forces carry their weight."""

from collections.abc import Callable

import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, Simulation, add_box, add_ground, add_sphere

from newton_avbd.scenes.named import add_brick_ring, add_pyramid, add_stack
from newton_avbd.study.stability.piles import add_box as add_solid

pytestmark = pytest.mark.long


def contact_wrenches(sim: Simulation, forces: np.ndarray) -> np.ndarray:
    """Sum of the contact forces on each body [N] and of their torques about its COM [N m].

    The observable gives the force on body 0 and its torque about that body's COM (about the
    origin for the static world); body 1 feels the opposite force at the same point.
    """
    total = np.zeros((sim.model.body_count + 1, 6))
    center = np.vstack([sim.center, np.zeros(3)])
    count = int(sim.contacts.rigid_contact_count.numpy()[0])
    shape_body = sim.model.shape_body.numpy()
    for i in range(count):
        body0 = shape_body[sim.contacts.rigid_contact_shape0.numpy()[i]]
        body1 = shape_body[sim.contacts.rigid_contact_shape1.numpy()[i]]
        force, torque = forces[i, :3], forces[i, 3:]
        total[body0] += forces[i]
        about1 = torque + np.cross(center[body0] - center[body1], force)
        total[body1] -= [*force, *about1]
    return total[:-1]


def test_contact_forces_of_a_pile_carry_its_weight() -> None:
    """At rest, forces and torques on every body balance its weight, within 1e-3 of it.

    Boxes of different sizes stacked off their centres, so that no contact carries the same as
    its neighbour; a sphere in a corner of two boxes pushes sideways.
    """
    builder = newton.ModelBuilder()
    add_ground(builder, 0.8)
    add_box(builder, (0.0, 0.0, 0.25), (1.0, 1.0, 0.5), mu=0.8)
    add_box(builder, (0.15, 0.1, 0.65), (0.6, 0.6, 0.3), mu=0.8, density=3000.0)
    add_box(builder, (0.05, -0.05, 0.9), (0.4, 0.5, 0.2), mu=0.8)
    add_box(builder, (1.05, 0.1, 0.2), (0.4, 0.4, 0.4), mu=0.8, density=500.0)
    add_sphere(builder, (0.62, 0.1, 0.72), 0.2, mu=0.8)
    sim = Simulation(builder)
    observed = sim.observe("contact_f")
    sim.run(3.0)
    assert np.abs(sim.velocity[:4]).max() < 1.0e-4  # the sphere may roll along its corner
    wrench = contact_wrenches(sim, observed.contact_f.numpy().astype(np.float64))
    weight = sim.mass * G
    assert np.sum(observed.contact_f.numpy(), axis=0)[2] != 0.0
    assert np.abs(wrench[:, :2]).max(axis=1) == pytest.approx(0.0, abs=1.0e-3 * weight.sum())
    assert np.all(np.abs(wrench[:, 2] - weight) < 1.0e-3 * weight.sum())
    assert np.all(np.abs(wrench[:, 3:]).max(axis=1) < 1.0e-3 * weight.sum() * 0.5)


def test_contact_forces_on_the_ground_sum_to_the_weight_of_a_pyramid() -> None:
    """What 10 boxes weigh together arrives at the ground, within 1e-3."""
    builder = newton.ModelBuilder()
    add_pyramid(builder, rows=4)
    sim = Simulation(builder)
    observed = sim.observe("contact_f")
    sim.run(1.0)
    wrench = contact_wrenches(sim, observed.contact_f.numpy().astype(np.float64))
    assert wrench[:, 2].sum() == pytest.approx(sim.mass.sum() * G, rel=1.0e-3)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize(("scene", "size"), [(add_pyramid, 10), (add_brick_ring, 1000)])
def test_four_sweeps_bring_a_pile_to_rest(
    scene: Callable[[newton.ModelBuilder, int], None], size: int, parallel: str
) -> None:
    """It does not go up and down on what sweeps leave unfinished (by 0.04 m/s, without an end)."""
    builder = newton.ModelBuilder()
    scene(builder, size)
    sim = Simulation(builder, parallel=parallel, iterations=4)
    start = sim.pose[:, :3]
    sim.run(1.0)
    assert np.abs(sim.velocity[:, :3]).max() < 1.0e-3
    assert np.abs(sim.pose[:, :3] - start).max() < 2.0e-4


def test_a_stack_of_twenty_boxes_stands() -> None:
    """10 s: never more than 0.1 mm deep, nothing moved by 1 mm, no energy gained.

    The energy may rise by what recovering 0.1 mm of penetration lifts the stack.
    """
    builder = newton.ModelBuilder()
    add_stack(builder, count=20)
    sim = Simulation(builder)
    start, energy = sim.pose[:, :3], sim.energy
    weight = sim.mass.sum() * G
    deepest, highest = 0.0, energy
    for step in range(2400):
        sim.step()
        if step < 240 or step % 10 == 0:
            deepest = max(deepest, sim.penetration)
            highest = max(highest, sim.energy)
    assert deepest <= 1.0e-4
    assert np.abs(sim.pose[:, :3] - start).max() <= 1.0e-3
    assert highest - energy < 1.0e-4 * weight
    assert np.abs(sim.velocity).max() < 1.0e-3


def test_a_pyramid_of_ten_rows_stands() -> None:
    """2 s: never more than 0.05 mm deep, drift at most 1 mm, at rest to 1 mm/s at the end."""
    builder = newton.ModelBuilder()
    add_pyramid(builder, rows=10)
    sim = Simulation(builder)
    start = sim.pose[:, :3]
    deepest = 0.0
    for _ in range(480):
        sim.step()
        deepest = max(deepest, sim.penetration)
    assert deepest <= 5.0e-5
    assert np.abs(sim.pose[:, :3] - start).max() <= 1.0e-3
    assert np.abs(sim.velocity).max() < 1.0e-3


def test_a_light_box_carries_one_of_a_thousand_times_its_mass() -> None:
    """1:1000 holds: after 4 s it stands, no deeper than a hundredth of an edge (5 mm).

    Sweeps pass the load on slowly there; more of them hold it closer.
    """
    builder = newton.ModelBuilder()
    add_stack(builder, count=2, densities=(10.0, 10000.0))
    sim = Simulation(builder)
    deepest = 0.0
    for _ in range(960):
        sim.step()
        deepest = max(deepest, sim.penetration)
    assert deepest < 5.0e-3
    assert np.abs(sim.velocity).max() < 1.0e-2
    assert sim.pose[:, 2] == pytest.approx([0.25, 0.75], abs=5.0e-3)


def test_more_sweeps_carry_a_thousand_times_the_mass_to_a_tenth_of_a_millimetre() -> None:
    """The same with 40 sweeps: 0.1 mm."""
    builder = newton.ModelBuilder()
    add_stack(builder, count=2, densities=(10.0, 10000.0))
    sim = Simulation(builder, iterations=40)
    sim.run(2.0)
    assert sim.penetration < 1.0e-4
    assert np.abs(sim.velocity).max() < 1.0e-3


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_a_tumbling_pile_gains_no_energy(seed: int) -> None:
    """Boxes and spheres fall in a heap: the energy never rises by more than recovery lifts.

    Recovering penetration raises bodies without entering their velocity: at most the deepest
    penetration times the weight. That is below 1 % of the energy of the fall.
    """
    rng = np.random.default_rng(seed)
    builder = newton.ModelBuilder()
    add_ground(builder, gap=0.05)
    for i in range(20):
        position = (*rng.uniform(-0.4, 0.4, 2), 0.4 + 0.35 * i)
        if i % 3 == 0:
            add_sphere(builder, position, rng.uniform(0.1, 0.2), gap=0.05)
        else:
            turn = wp.normalize(wp.quat(*rng.normal(size=4)))
            add_box(builder, position, rng.uniform(0.2, 0.4, 3), turn, gap=0.05)
    sim = Simulation(builder)
    energy = lowest = sim.energy
    gained = 0.0
    for _ in range(720):
        sim.step()
        now = sim.energy
        gained = max(gained, now - lowest)
        lowest = min(lowest, now)
    assert gained < 0.01 * (energy - lowest)
    assert sim.penetration < 5.0e-3


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
@pytest.mark.parametrize("height", [0.38, 0.4, 0.45, 0.5])
def test_a_table_on_four_feet_takes_a_heavy_impact_with_all_of_them(
    height: float, scheme: str
) -> None:
    """8.1 t, from ``height`` [m] between centers, fall on a table top of 10 kg, off its center, on
    four feet of 8 kg.

    Where one foot has to take what the others do not know of, they go 1.3 mm into each other.
    """
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.5, gap=0.02)
    for x in (-0.4, 0.4):
        for y in (-0.4, 0.4):
            add_solid(builder, (x, y, 0.1), (0.2, 0.2, 0.2))
    add_solid(builder, (0.0, 0.0, 0.25), (1.0, 1.0, 0.1), density=100.0)
    add_solid(builder, (0.1, 0.1, 0.25 + height), (0.3, 0.3, 0.3), density=3.0e5)
    sim = Simulation(builder, scheme=scheme)
    deepest = 0.0
    for _ in range(120):
        sim.step()
        deepest = max(deepest, sim.penetration)
    assert deepest < 3.0e-4
    assert np.abs(sim.velocity).max() < 1.0e-3


def test_a_stack_stands_a_kilometre_from_the_origin() -> None:
    """At 1 km a position in float32 is only known to 0.06 mm, and so is each gap.

    The stack still stands: no deeper than two of those units, no drift beyond a few of them in a
    second, at rest to what a unit of position a step would be.
    """
    unit = 2.0**-14  # distance between float32 numbers near 1000
    builder = newton.ModelBuilder()
    add_ground(builder, gap=0.06)
    for i in range(5):
        add_box(builder, (1000.0, -1000.0, 0.25 + 0.5 * i), gap=0.06)
    sim = Simulation(builder)
    start = sim.pose[:, :3]
    sim.run(2.0)
    assert sim.penetration < 2.0 * unit
    assert np.abs(sim.pose[:, :3] - start).max() < 10.0 * unit
    assert np.abs(sim.velocity).max() < unit / sim.dt
