# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Needles that tumble gain no energy, and those that lie roll as solid cylinders do."""

from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import Array, Simulation, add_ground, surface
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD
from newton_avbd.measure import state as measure

LENGTH = 1.0


def add_needle(
    builder: newton.ModelBuilder,
    position: Any,
    rotation: Rotation,
    aspect: float,
    velocity: Any,
    spin: Any,
) -> int:
    """A capsule of steel, ``aspect`` times as long as thick, along the z axis of ``rotation``."""
    xform = wp.transform(tuple(map(float, position)), wp.quat(*rotation.as_quat()))
    body = builder.add_body(xform=xform)
    radius = 0.5 * LENGTH / aspect
    half = 0.5 * LENGTH - radius
    # the end of one comes down by 20 cm a step at 60 Hz
    cfg = surface(mu=0.5, density=7800.0, gap=0.2)
    builder.add_shape_capsule(body, radius=radius, half_height=half, cfg=cfg)
    builder.body_qd[body] = (*map(float, velocity), *map(float, spin))
    return body


def tumbling(aspect: float, count: int, **settings: object) -> Simulation:
    """As many worlds, each with a needle that has any rotation and spin a meter up."""
    rng = np.random.default_rng(int(aspect))
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.5)
    for k in range(count):
        builder.begin_world()
        fast = (8.0, 25.0, 60.0)[k % 3]
        turn = Rotation.random(random_state=rng.integers(2**31))
        spin = rng.uniform(-fast, fast, 3)
        add_needle(builder, (0, 0, rng.uniform(0.6, 1.5)), turn, aspect, rng.normal(size=3), spin)
        builder.end_world()
    return Simulation(builder, keep_inertia=True, **settings)


@pytest.mark.long
@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
@pytest.mark.parametrize("aspect", [1000.0, 100.0])
@pytest.mark.parametrize("scheme", ["generalized_alpha", "euler"])
def test_a_needle_that_tumbles_gains_no_energy(scheme: str, aspect: float, dt: float) -> None:
    """Not more than at the start; what has lost most of that may get some of it back.

    At 1:1,000 rounding of the axis of one that turns at 60 rad/s is 1 % of its energy, and one that
    lies and rolls by more than a radian a step may turn that into another spin.
    """
    sim = tumbling(aspect, 24, scheme=scheme, dt=dt)
    bodies = measure.Bodies.of(sim.model)

    def energy() -> Array:
        potential = measure.potential_energy(bodies, sim.pose)
        return measure.kinetic_energy(bodies, sim.pose, sim.velocity) + potential

    start = lowest = energy()
    for _ in range(round(2.5 / dt)):
        sim.step()
        now = energy()
        assert np.all(now - start < 2.0e-3 * start)
        assert np.all(now - lowest < 0.2 * start)
        lowest = np.minimum(lowest, now)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
def test_needles_that_fall_on_each_other_come_to_rest(parallel: str) -> None:
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.5)
    rng = np.random.default_rng(7)
    for k in range(12):
        place = (rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), 0.6 + 0.15 * k)
        turn = Rotation.random(random_state=rng.integers(2**31))
        add_needle(builder, place, turn, 1000.0, rng.normal(size=3), rng.uniform(-10, 10, 3))
    sim = Simulation(builder, keep_inertia=True, dt=1.0 / 60.0, parallel=parallel)
    for _ in range(300):
        sim.step()
        # 4 m of fall, and lever arms of half a meter
        assert np.abs(sim.velocity[:, :3]).max() < 15.0
    assert np.abs(sim.velocity[:, :3]).max() < 0.3


@pytest.mark.parametrize("aspect", [1000.0, 50.0])
@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_a_needle_that_slides_ends_up_rolling(aspect: float, angle: float) -> None:
    """Pushed across its axis it slides, and then rolls at 2/3 of its speed: a solid cylinder does.

    The ends are half balls, which add a share of the order of its thickness.
    """
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.5)
    turn = Rotation.from_euler("ZY", [angle, 0.5 * np.pi])
    axis, across = turn.apply([0.0, 0.0, 1.0]), turn.apply([0.0, 1.0, 0.0])
    radius = 0.5 * LENGTH / aspect
    speed = 0.3 * np.sqrt(50.0 / aspect)
    add_needle(builder, (0, 0, radius), turn, aspect, speed * across, (0, 0, 0))
    sim = Simulation(builder, keep_inertia=True, dt=1.0 / 60.0)
    sim.run(0.5)
    ends_at = sim.velocity[0, :3] @ across
    np.testing.assert_allclose(ends_at, 2.0 / 3.0 * speed, rtol=1.0e-2)
    np.testing.assert_allclose(sim.velocity[0, 3:] @ axis * radius, -ends_at, rtol=1.0e-3)


def test_only_scenes_with_needles_look_after_them() -> None:
    for aspect, is_needle in ((22.0, True), (17.0, False)):
        builder = newton.ModelBuilder()
        add_ground(builder)
        add_needle(builder, (0, 0, 1), Rotation.identity(), aspect, (0, 0, 0), (0, 0, 0))
        effects = SolverAVBD(builder.finalize(device="cpu")).effects
        assert effects["needles"].on == is_needle
