# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Compliant contacts give way as a spring and damper of the authored stiffness and damping."""

import math

import newton
import numpy as np
import pytest
from helpers import G, Simulation, add_box, add_ground, add_sphere

RADIUS = 0.25


def sphere_above(height: float, ke: float, kd: float, dt: float, **settings: bool) -> Simulation:
    """A sphere of density 1000 at a height over the floor, both of one material."""
    builder = newton.ModelBuilder()
    add_ground(builder, ke=ke, kd=kd, gap=0.05)
    add_sphere(builder, (0.0, 0.0, RADIUS + height), RADIUS, ke=ke, kd=kd, gap=0.05)
    return Simulation(builder, dt=dt, **settings)


def heights(sim: Simulation, steps: int) -> np.ndarray:
    """Height of the sphere over the floor after each step [m]; negative is penetration."""
    result = []
    for _ in range(steps):
        sim.step()
        result.append(sim.pose[0, 2] - RADIUS)
    return np.array(result)


def backward_euler(height: float, m: float, ke: float, kd: float, h: float, steps: int):
    """The same in double precision: F = -ke C - kd dC/h while it overlaps, and never pulls."""
    result, c, v = [], height, 0.0
    for _ in range(steps):
        free = v - G * h
        stiffness = ke + kd / h
        # a step that starts apart is damped along the part of it that overlaps
        push = -ke * c if c < 0.0 else -stiffness * c
        # m (v' - free)/h = push - stiffness h v'
        v = max(free, (m * free + h * push) / (m + h * h * stiffness))
        c += h * v
        result.append(c)
    return np.array(result)


@pytest.mark.parametrize("ke", [1.0e4, 1.0e5, 1.0e7])
@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
def test_a_box_sags_by_its_weight_over_the_stiffness(ke: float, dt: float) -> None:
    """m g / (4 ke) for a box on four contacts, within 2 %; the softest takes longest to settle."""
    builder = newton.ModelBuilder()
    # critical damping of the box on its four springs
    mass = 1000.0 * 0.5**3
    kd = 2.0 * math.sqrt(ke * mass / 4.0)
    add_ground(builder, ke=ke, kd=kd)
    add_box(builder, (0.0, 0.0, 0.25), ke=ke, kd=kd)
    sim = Simulation(builder, dt=dt, compliant_contacts=True)
    sim.run(4.0)
    assert 0.25 - sim.pose[0, 2] == pytest.approx(mass * G / (4.0 * ke), rel=0.02)
    assert np.abs(sim.velocity).max() < 1.0e-3


def test_stiffness_of_two_shapes_is_their_mean() -> None:
    """As SolverVBD mixes it: 1e4 and 3e4 N/m make 2e4."""
    builder = newton.ModelBuilder()
    add_ground(builder, ke=1.0e4, kd=2.0e3)
    add_sphere(builder, (0.0, 0.0, RADIUS), RADIUS, ke=3.0e4, kd=2.0e3)
    sim = Simulation(builder, compliant_contacts=True)
    sim.run(4.0)
    assert RADIUS - sim.pose[0, 2] == pytest.approx(sim.mass[0] * G / 2.0e4, rel=0.02)


@pytest.mark.parametrize("ratio", [0.1, 2.0])
@pytest.mark.parametrize("height", [0.0, 0.2])
def test_a_drop_on_a_compliant_floor_is_the_backward_euler_solution(
    height: float, ratio: float
) -> None:
    """Under- and overdamped, from touch and from a fall: within 1e-3 of the deepest penetration.

    The sweeps have to find F = -K C - kd dC/h for any penalty; float32 leaves 1e-6 m.
    """
    dt, omega = 1.0 / 240.0, 2.0 * math.pi * 3.0
    mass = 1000.0 * 4.0 / 3.0 * math.pi * RADIUS**3
    ke, kd = mass * omega**2, 2.0 * ratio * mass * omega
    got = heights(sphere_above(height, ke, kd, dt, compliant_contacts=True, scheme="euler"), 240)
    expected = backward_euler(height, mass, ke, kd, dt, 240)
    assert np.abs(got - expected).max() < 1.0e-3 * -expected.min() + 2.0e-6


@pytest.mark.parametrize("ratio", [0.1, 2.0])
def test_a_suddenly_loaded_spring_follows_the_damped_oscillator(ratio: float) -> None:
    """Laid on the floor, a sphere sinks by m g/K (1 - e^(-d t) ...): the closed form.

    Backward Euler at w h = 0.013 adds damping of w h/2 = 0.6 % of critical: 4 % of the sag.
    """
    dt, omega = 1.0e-3, 2.0 * math.pi * 2.0
    mass = 1000.0 * 4.0 / 3.0 * math.pi * RADIUS**3
    got = heights(
        sphere_above(0.0, mass * omega**2, 2.0 * ratio * mass * omega, dt, compliant_contacts=True),
        1000,
    )
    t = dt * np.arange(1, 1001)
    root = omega * np.sqrt(complex(ratio**2 - 1.0))
    decay = np.exp(-ratio * omega * t) * (
        np.cosh(root * t) + ratio * omega / root * np.sinh(root * t)
    )
    sag = G / omega**2
    assert np.abs(got + sag * (1.0 - decay.real)).max() < 0.04 * sag


@pytest.mark.parametrize("shape", ["sphere", "box"])
@pytest.mark.parametrize("ratio", [0.1, 0.5, 2.0])
def test_a_damped_contact_rebounds_as_its_closed_form_says(ratio: float, shape: str) -> None:
    """Without gravity, from the first touch to the last: depth and speed, to 1 % of the impact's.

    x = v/w_d e^(-d t) sin w_d t; the contact lets go where its force, and with it x'', is zero.
    Each of a box's four contacts is a quarter of it.
    """
    dt, omega, v = 2.0e-4, 2.0 * math.pi * 4.0, 1.0
    count, mass = (1, 1000.0 * 4.0 / 3.0 * math.pi * RADIUS**3) if shape == "sphere" else (4, 125.0)
    material = {"ke": mass * omega**2 / count, "kd": 2.0 * ratio * mass * omega / count}
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    add_ground(builder, gap=0.05, **material)
    add = add_sphere if shape == "sphere" else add_box
    add(builder, (0.0, 0.0, 0.25), gap=0.05, **material)
    sim = Simulation(builder, dt=dt, compliant_contacts=True)
    sim.set_velocity(0, (0.0, 0.0, -v))
    deepest = 0.0
    for _ in range(round(0.5 / dt)):
        sim.step()
        deepest = max(deepest, 0.25 - sim.pose[0, 2])

    decay, root = ratio * omega, np.sqrt(complex(ratio**2 - 1.0)) * omega
    t = np.arange(0.0, 0.5, 1.0e-5)
    x = v * np.exp(-decay * t) * (np.sinh(root * t) / root).real
    speed = v * np.exp(-decay * t) * (np.cosh(root * t) - decay / root * np.sinh(root * t)).real
    leaves = int(np.argmax(2.0 * decay * speed + omega**2 * x < 0.0))
    expected = -speed[leaves] if leaves else 0.0
    assert deepest == pytest.approx(x.max(), rel=0.01)
    if leaves:
        assert sim.velocity[0, 2] == pytest.approx(expected, abs=0.01 * v)


def test_stiff_contacts_tend_to_rigid_ones() -> None:
    """At ke = 1e10 N/m a box that slides and comes to rest does as on rigid contacts.

    Within 0.1 mm: the sag is 3e-8 m, and what is left is when each contact takes hold. Both by
    backward Euler, which compliant contacts keep to.
    """
    ends = []
    for compliant in (False, True):
        builder = newton.ModelBuilder()
        add_ground(builder, ke=1.0e10, kd=0.0)
        add_box(builder, (0.0, 0.0, 0.1), (0.5, 0.5, 0.2), ke=1.0e10, kd=0.0)
        sim = Simulation(builder, compliant_contacts=compliant, scheme="euler")
        sim.set_velocity(0, (2.0, 1.0, 0.0))
        sim.run(1.0)
        ends.append(sim.pose[0])
    assert np.abs(ends[1] - ends[0]).max() < 1.0e-4


@pytest.mark.parametrize("ke", [1.0e3, 1.0e5])
def test_an_elastic_floor_gives_back_no_more_than_it_took(ke: float) -> None:
    """Without damping a ball rebounds, but never higher than it fell from."""
    sim = sphere_above(0.5, ke, 0.0, 1.0 / 240.0, compliant_contacts=True)
    path = heights(sim, 720)
    assert path.max() < 0.5
    landed = int(np.argmin(path))
    assert path[landed:].max() > 0.05  # it does rebound


def test_compliant_friction_still_holds_and_slides() -> None:
    """Slide distance v^2/(2 mu g) on a compliant floor, within 2 %."""
    v, mu = 2.0, 0.4
    builder = newton.ModelBuilder()
    add_ground(builder, mu, ke=1.0e6, kd=1.0e4)
    add_box(builder, (0.0, 0.0, 0.05), (0.5, 0.5, 0.1), mu=mu, ke=1.0e6, kd=1.0e4)
    sim = Simulation(builder, compliant_contacts=True)
    sim.set_velocity(0, (v, 0.0, 0.0))
    sim.run(1.0)
    assert sim.pose[0, 0] == pytest.approx(v * v / (2.0 * mu * G) - 0.5 * v * sim.dt, rel=0.02)
    assert np.abs(sim.velocity).max() < 1.0e-4
