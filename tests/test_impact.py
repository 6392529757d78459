# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies that meet, and bodies that part: no bounce, no glue, nothing lost of the momentum."""

from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import (
    IDENTITY,
    NO_GRAVITY,
    G,
    Simulation,
    add_box,
    add_ground,
    add_sphere,
    surface,
)

pytestmark = pytest.mark.usefixtures("shared_kernels")


@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0, 1.0 / 1000.0])
@pytest.mark.parametrize("height", [0.01, 1.0, 20.0])
@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_an_impact_does_not_bounce(shape: str, height: float, dt: float) -> None:
    """Without restitution the body stays where it lands.

    It never leaves faster than a thousandth of the speed that it came with, hence rises by no
    more than the ballistic height of that (or the recovered penetration), sinks in by no more
    than a hundredth of its last step, and is at rest in a tenth of a second. Contacts are
    detected a step ahead: what a detection gap misses is not the solver's to mend.
    """
    speed = np.sqrt(2.0 * G * height)
    reach = 1.5 * (speed + G * dt) * dt
    builder = newton.ModelBuilder()
    add_ground(builder, gap=reach)
    add = add_sphere if shape == "sphere" else add_box
    add(builder, (0.0, 0.0, 0.25 + height), gap=reach)
    sim = Simulation(builder, dt=dt)
    sim.run(speed / G - 4.0 * dt)  # nearly there
    lowest, rise, fastest = np.inf, 0.0, -np.inf
    for _ in range(round(0.1 / dt) + 6):
        sim.step()
        z = sim.pose[0, 2]
        lowest = min(lowest, z)
        rise = max(rise, z - lowest)
        fastest = max(fastest, sim.velocity[0, 2])
    assert fastest < 1.0e-3 * speed + 1.0e-5
    assert lowest > 0.25 - 1.0e-5 - 0.01 * speed * dt
    assert rise < 1.0e-6 * speed**2 / (2.0 * G) + 0.25 + 1.0e-6 - lowest
    assert np.abs(sim.velocity).max() < 1.0e-3 * speed


def resting_box(**settings: Any) -> tuple[Simulation, float]:
    """A box at rest on the ground, and its weight [N]."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.25))
    sim = Simulation(builder, **settings)
    sim.run(0.5)
    assert np.abs(sim.velocity).max() < 1.0e-5
    return sim, sim.mass[0] * G


@pytest.mark.parametrize("excess", [1.2, 2.0, 10.0])
def test_a_box_lifts_off_without_delay(excess: float) -> None:
    """A force of ``excess`` times its weight gives f/m - g within 1 % from the first step on.

    Contacts that hold back a body on its way up would show here.
    """
    sim, weight = resting_box()
    sim.push(0, (0.0, 0.0, excess * weight))
    expected = (excess - 1.0) * G * sim.dt
    for step in range(1, 11):
        sim.step()
        assert sim.velocity[0, 2] == pytest.approx(step * expected, rel=0.01)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
@pytest.mark.parametrize("share", [0.5, 0.99, 1.001])
def test_a_box_that_loses_its_weight_is_not_thrown(share: float, scheme: str) -> None:
    """What is left of the multiplier that carried it may push it once, by 5 % of g dt at most.

    With less than its weight taken off it comes back, and does not bounce: it rises by less than a
    tenth of what it would fall in a step. With more, it goes on as the force says.
    """
    sim, weight = resting_box(scheme=scheme)
    start = sim.pose[0, 2]
    sim.push(0, (0.0, 0.0, share * weight))
    rise = 0.0
    for step in range(1, 21):
        sim.step()
        excess = max(share - 1.0, 0.0) * G * sim.dt
        assert sim.velocity[0, 2] < step * excess + 0.05 * G * sim.dt
        rise = max(rise, sim.pose[0, 2] - start)
    if share < 1.0:
        assert rise < 0.1 * G * sim.dt**2
        assert abs(sim.velocity[0, 2]) < 1.0e-5


@pytest.mark.parametrize("ratio", [1.0, 10.0, 1000.0])
def test_a_box_stays_when_its_load_is_lifted(ratio: float) -> None:
    """A box under ``ratio`` times its mass: the load goes, the box rises less than g dt^2."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.25), density=10.0)
    add_box(builder, (0.0, 0.0, 0.75), density=10.0 * ratio)
    sim = Simulation(builder)
    sim.run(1.0)
    start = sim.pose[0, 2]
    sim.push(1, (0.0, 0.0, 2.0 * sim.mass[1] * G))
    rise = 0.0
    for _ in range(24):
        sim.step()
        rise = max(rise, sim.pose[0, 2] - start)
    assert sim.velocity[1, 2] == pytest.approx(24 * G * sim.dt, rel=0.01)
    assert rise < G * sim.dt**2
    assert np.abs(sim.velocity[0]).max() < 1.0e-3


def test_a_pulled_sphere_leaves_without_turning() -> None:
    """A sphere lifted and pushed aside leaves the ground at once: no friction is left on it."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_sphere(builder, (0.0, 0.0, 0.25))
    sim = Simulation(builder)
    sim.run(0.25)
    weight = sim.mass[0] * G
    sim.push(0, (0.5 * weight, 0.0, 2.0 * weight))
    sim.step(10)
    assert sim.velocity[0, :3] == pytest.approx(np.array([0.5, 0.0, 1.0]) * 10 * G * sim.dt, 0.01)
    assert np.abs(sim.velocity[0, 3:]).max() < 0.01 * 0.5 * 10 * G * sim.dt / 0.25


@pytest.mark.parametrize(
    ("iterations", "linear", "angular"), [(10, 0.01, 0.012), (100, 1.0e-4, 3.0e-3)]
)
@pytest.mark.parametrize("mu", [0.0, 0.6])
def test_a_collision_keeps_linear_and_angular_momentum(
    mu: float, iterations: int, linear: float, angular: float
) -> None:
    """Two tumbling bodies with COM offsets and a mass ratio of 20 collide in empty space.

    Both feel each contact's force at one point, so that converged sweeps keep the momentum; the
    default number of them, to 1 % of what is exchanged. The angular momentum changes with the
    turn of the inertia tensors in the step of the impact, h |w| = 1 % of a third of it.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    for x, density, offset in ((0.0, 100.0, 0.3), (2.0, 2000.0, -0.4)):
        turn = wp.quat_rpy(0.3 + x, 0.5, 0.2 * x)
        body = builder.add_body(xform=wp.transform(wp.vec3(x, 0.1 * x, 0.05 * x), turn))
        # the shape's offset from the origin puts the COM there
        builder.add_shape_box(
            body,
            xform=wp.transform(wp.vec3(offset, 0.1, -0.2), IDENTITY),
            hx=0.3,
            hy=0.4,
            hz=0.5,
            cfg=surface(mu, density=density),
        )
    sim = Simulation(builder, iterations=iterations)
    sim.set_velocity(0, (3.0, 0.2, 0.0), (1.0, -2.0, 0.5))
    sim.set_velocity(1, (-1.0, 0.0, 0.1), (0.3, 0.2, -1.0))
    mass = sim.mass[:, None]
    energy = sim.kinetic_energy

    def momenta() -> tuple[np.ndarray, np.ndarray]:
        p = mass * sim.velocity[:, :3]
        return p, np.cross(sim.center, p) + sim.spin_momentum

    p0, l0 = momenta()
    sim.run(0.8)
    p1, l1 = momenta()
    exchanged = np.abs(p1 - p0).max()
    assert exchanged > 50.0  # they did collide
    assert np.abs((p1 - p0).sum(axis=0)).max() < linear * exchanged
    assert np.abs((l1 - l0).sum(axis=0)).max() < angular * np.abs(l1 - l0).max()
    assert sim.kinetic_energy < energy


@pytest.mark.parametrize(("iterations", "bound"), [(10, 0.01), (40, 1.0e-4)])
def test_equal_spheres_meeting_head_on_share_their_momentum(iterations: int, bound: float) -> None:
    """Without restitution and friction both move on with the mean velocity, for good.

    The default number of sweeps is allowed 1 % of the closing speed, 40 of them 1e-4.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_sphere(builder, (0.0, 0.0, 0.0), mu=0.0)
    add_sphere(builder, (1.0, 0.0, 0.0), mu=0.0)
    sim = Simulation(builder, iterations=iterations)
    sim.set_velocity(0, (2.0, 0.0, 0.0))
    sim.run(0.5)
    assert sim.velocity[:, 0] == pytest.approx([1.0, 1.0], abs=2.0 * bound)


def test_a_light_body_does_not_stop_a_heavy_one() -> None:
    """Momentum decides: at 1:1000 the heavy sphere keeps 1000/1001 of its speed, within 1e-4."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_sphere(builder, (0.0, 0.0, 0.0), mu=0.0, density=10000.0)
    add_sphere(builder, (1.0, 0.0, 0.0), mu=0.0, density=10.0)
    sim = Simulation(builder)
    sim.set_velocity(0, (2.0, 0.0, 0.0))
    sim.run(0.5)
    assert sim.velocity[:, 0] == pytest.approx(np.full(2, 2.0 * 1000.0 / 1001.0), abs=2.0e-4)
