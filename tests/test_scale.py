# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The same scene in other units moves the same way: nothing in the solver is an absolute number."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, Simulation, add_box, add_ground, add_sphere


def scene(length: float, density: float, dt: float) -> Simulation:
    """A stack, a box that lands tilted and slides, and a sphere; all lengths times ``length``."""
    material = {"mu": 0.4, "density": density, "gap": 0.05 * length}
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -G * length))
    add_ground(builder, **material)
    tilt = wp.quat_from_axis_angle(wp.normalize(wp.vec3(1.0, 2.0, 0.5)), 0.4)
    for i in range(4):
        add_box(builder, (0.0, 0.0, (0.25 + 0.5 * i) * length), 0.5 * length, **material)
    size = np.array([0.6, 0.4, 0.2]) * length
    add_box(builder, np.array([1.0, 0.0, 0.6]) * length, size, tilt, **material)
    add_sphere(builder, np.array([-1.0, 0.0, 0.3]) * length, 0.2 * length, **material)
    sim = Simulation(builder, dt=dt, keep_inertia=True)
    sim.set_velocity(4, np.array([1.0, 0.5, 0.0]) * length, (0.5, -1.0, 2.0))
    sim.set_velocity(5, np.array([-1.0, 0.5, 0.0]) * length)
    return sim


def trajectory(sim: Simulation, length: float) -> np.ndarray:
    """Poses every 20 steps for 0.5 s, lengths divided by ``length``."""
    poses = []
    for _ in range(6):
        sim.step(20)
        poses.append(sim.pose / [length, length, length, 1, 1, 1, 1])
    return np.array(poses)


DT = 1.0 / 240.0


@pytest.fixture(scope="module")
def expected() -> np.ndarray:
    return trajectory(scene(1.0, 1000.0, DT), 1.0)


@pytest.mark.parametrize("density", [1.0e-3, 1.0, 1.0e4])
def test_density_changes_nothing(density: float, expected: np.ndarray) -> None:
    """Only ratios of masses matter: from 1e-3 to 1e4 kg/m^3 the trajectory is the same.

    Rounding differs, and a rotating box that lands amplifies it: 1e-6 per step in the beginning
    grows by the impacts to 1e-4 of a metre.
    """
    got = trajectory(scene(1.0, density, DT), 1.0)
    assert np.abs(got[0] - expected[0]).max() < 1.0e-6
    assert np.abs(got - expected).max() < 1.0e-4


@pytest.mark.parametrize("power", [-20, 10])
def test_a_density_by_a_power_of_two_changes_not_even_a_bit(
    power: int, expected: np.ndarray
) -> None:
    """Masses times a power of two only shift the exponents of all forces."""
    got = trajectory(scene(1.0, 1000.0 * 2.0**power, DT), 1.0)
    assert np.array_equal(got, expected)


@pytest.mark.parametrize("length", [2.0e-3, 1.0e-2, 10.0, 100.0])
def test_length_with_gravity_changes_nothing(length: float, expected: np.ndarray) -> None:
    """Boxes of 1 mm to 50 m, with gravity in proportion, move alike."""
    got = trajectory(scene(length, 1000.0, DT), length)
    assert np.abs(got[0] - expected[0]).max() < 1.0e-5
    assert np.abs(got - expected).max() < 1.0e-3


@pytest.mark.parametrize("length", [2.0e-3, 0.1, 100.0])
def test_length_with_time_changes_nothing(length: float) -> None:
    """Under the same gravity, lengths go with the square of time: Froude's rule.

    The stack and the fall in real gravity, with dt scaled by the root of the length.
    """
    results = []
    for size in (1.0, length):
        builder = newton.ModelBuilder()
        add_ground(builder, gap=0.05 * size)
        for i in range(4):
            position = (0.0, 0.0, (0.25 + 0.6 * i) * size)
            add_box(builder, position, 0.5 * size, gap=0.05 * size)
        sim = Simulation(builder, dt=DT * np.sqrt(size), keep_inertia=True)
        sim.step(120)
        results.append(sim.pose / [size, size, size, 1, 1, 1, 1])
    assert np.abs(results[1] - results[0]).max() < 1.0e-4
