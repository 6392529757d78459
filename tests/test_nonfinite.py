# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A world whose input is not finite is held and counted; the others never notice."""

import newton
import numpy as np
import pytest
from helpers import Simulation, add_box, add_ground, add_mass

WORLDS = 4
SICK = 2


def piles(**settings: bool) -> Simulation:
    """The same pile of three boxes in each of four worlds."""
    world = newton.ModelBuilder()
    add_ground(world)
    for i in range(3):
        add_box(world, (0.02 * i, 0.0, 0.3 + 0.52 * i))
    builder = newton.ModelBuilder()
    builder.replicate(world, WORLDS)
    return Simulation(builder, **settings)


def bodies_of(world: int) -> slice:
    return slice(3 * world, 3 * world + 3)


def spoil(sim: Simulation, what: str, value: float) -> None:
    """Writes ``value`` into one number of one body of the sick world."""
    array = getattr(sim.state, what)
    values = array.numpy()
    values[3 * SICK + 1, 2] = value
    array.assign(values)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("what", ["body_q", "body_qd", "body_f"])
def test_a_sick_world_leaves_the_others_bit_identical(what: str, value: float) -> None:
    """NaN or infinity in one world, in the middle of a run: the others go on, bit for bit."""
    healthy, sick = piles(), piles()
    for sim in (healthy, sick):
        sim.step(30)
    spoil(sick, what, value)
    for sim in (healthy, sick):
        sim.step(30)
    for world in range(WORLDS):
        same = np.array_equal(
            healthy.pose[bodies_of(world)], sick.pose[bodies_of(world)]
        ) and np.array_equal(healthy.velocity[bodies_of(world)], sick.velocity[bodies_of(world)])
        assert same == (world != SICK)
    assert healthy.solver.status.held_steps.tolist() == [0] * WORLDS
    expected = [0] * WORLDS
    expected[SICK] = 30
    assert sick.solver.status.held_steps.tolist() == expected


def test_a_sick_world_stands_still_until_it_is_reset() -> None:
    """Its healthy bodies keep their poses; after a reset it goes the way that it went at first."""
    sim = piles()
    sim.step(10)
    first = sim.pose[bodies_of(SICK)]
    sim.solver.reset(sim.state)
    sim.step(5)
    spoil(sim, "body_qd", np.nan)
    held = sim.pose[bodies_of(SICK)]
    sim.step(20)
    assert np.array_equal(sim.pose[bodies_of(SICK)], held)
    sim.solver.reset(sim.state)
    assert sim.solver.status.held_steps[SICK] == 0
    sim.step(10)
    assert np.array_equal(sim.pose[bodies_of(SICK)], first)
    assert sim.solver.status.held_steps[SICK] == 0


@pytest.mark.parametrize("settings", [{"compliant_contacts": True}, {"formulation": "ramp"}])
def test_every_formulation_contains_a_sick_world(settings: dict) -> None:
    """The same with compliant contacts and with the ramp."""
    healthy, sick = piles(**settings), piles(**settings)
    spoil(sick, "body_q", np.nan)
    for sim in (healthy, sick):
        sim.step(20)
    others = [world for world in range(WORLDS) if world != SICK]
    for world in others:
        assert np.array_equal(healthy.pose[bodies_of(world)], sick.pose[bodies_of(world)])
    assert sick.solver.status.held_steps[SICK] == 20


def test_without_contacts_only_the_sick_body_is_held() -> None:
    """Where bodies cannot touch, each stands for itself: the next one falls on."""
    builder = newton.ModelBuilder()
    add_mass(builder)
    add_mass(builder)
    sim = Simulation(builder, collide=False)
    velocity = sim.state.body_qd.numpy()
    velocity[0, 0] = np.nan
    sim.state.body_qd.assign(velocity)
    sim.step(10)
    assert sim.pose[0, 2] == 0.0
    assert sim.pose[1, 2] < 0.0
    assert sim.solver.status.held_steps.sum() == 10


def test_a_finite_but_absurd_velocity_ends_in_no_nan() -> None:
    """1e30 m/s is finite, its energy is not: whatever the step makes of it, no NaN comes out."""
    healthy, sick = piles(), piles()
    spoil(sick, "body_qd", -1.0e30)
    for sim in (healthy, sick):
        sim.step(10)
    assert np.all(np.isfinite(sick.pose)) and np.all(np.isfinite(sick.velocity))
    for world in (w for w in range(WORLDS) if w != SICK):
        assert np.array_equal(healthy.pose[bodies_of(world)], sick.pose[bodies_of(world)])
