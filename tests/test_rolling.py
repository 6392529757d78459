# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What rolls and tumbles, on contacts found once a step or once for several."""

import math

import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, Simulation, add_ground, surface

from newton_avbd.study.accuracy.scenes import TILT, add_cube_on_edge, tipped

RADIUS, HALF = 0.1, 0.08
"""Radius of what rolls and half of its length, along y [m]."""


class OnceForSeveral(Simulation):
    """Finds contacts once for ``every`` steps."""

    every = 1

    def step(self, count: int = 1) -> None:
        pipeline = self.pipeline
        for k in range(count):
            self.pipeline = pipeline if k % self.every == 0 else None
            super().step()
        self.pipeline = pipeline


def add_shape(builder: newton.ModelBuilder, link: int, shape: str, mu: float) -> None:
    """A round shape about the link's z axis."""
    cfg = surface(mu)
    if shape == "sphere":
        builder.add_shape_sphere(link, radius=RADIUS, cfg=cfg)
    elif shape == "capsule":
        builder.add_shape_capsule(link, radius=RADIUS, half_height=HALF, cfg=cfg)
    else:
        builder.add_shape_cylinder(link, radius=RADIUS, half_height=HALF, cfg=cfg)


def wheel(shape: str, tilt: float = 0.0, every: int = 1, dt: float = 1.0 / 240.0) -> OnceForSeveral:
    """A round body on the ground, its axis along y, under gravity tilted towards x."""
    gravity = (G * math.sin(tilt), 0.0, -G * math.cos(tilt))
    builder = newton.ModelBuilder(gravity=gravity)
    add_ground(builder, 1.0)
    on_side = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), 0.5 * math.pi)
    pose = wp.transform(wp.vec3(0.0, 0.0, RADIUS), on_side)
    if shape == "welded cylinder":
        hub, tyre = builder.add_link(xform=pose, mass=1.0), builder.add_link(xform=pose)
        builder.body_inertia[hub] = wp.mat33(np.diag([0.01, 0.01, 0.01]))
        add_shape(builder, tyre, "cylinder", 1.0)
        joints = [builder.add_joint_free(hub), builder.add_joint_fixed(hub, tyre)]
        builder.joint_q[:7] = [*pose]
        builder.add_articulation(joints)
    else:
        add_shape(builder, builder.add_body(xform=pose), shape, 1.0)
    sim = OnceForSeveral(builder, dt=dt)
    sim.every = every
    return sim


@pytest.mark.parametrize("every", [1, 4, 10])
@pytest.mark.parametrize("shape", ["sphere", "capsule", "cylinder", "welded cylinder"])
def test_what_rolls_keeps_its_speed(shape: str, every: int) -> None:
    """At 3 rad/s for two seconds, within 1e-4 of it. (Contacts that turned back with the body, or
    stayed behind it, made it 4.3 and 5.3 rad/s where they were found every fourth step.)"""
    sim = wheel(shape, every=every)
    for body in range(sim.model.body_count):
        sim.set_velocity(body, (3.0 * RADIUS, 0.0, 0.0), (0.0, 3.0, 0.0))
    sim.run(2.0)
    assert sim.velocity[0, 4] == pytest.approx(3.0, rel=1.0e-4)
    assert sim.velocity[0, 0] == pytest.approx(3.0 * RADIUS, rel=1.0e-4)
    assert abs(sim.pose[0, 2] - RADIUS) < 1.0e-4


def test_a_cylinder_that_rolls_slowly_keeps_its_speed() -> None:
    """By 0.8 mrad a step, which is no rounding: as a corner its contact would add 31 % in 2 s."""
    sim = wheel("cylinder")
    sim.set_velocity(0, (0.2 * RADIUS, 0.0, 0.0), (0.0, 0.2, 0.0))
    sim.run(2.0)
    assert sim.velocity[0, 4] == pytest.approx(0.2, rel=1e-3)


@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.parametrize(("shape", "share"), [("sphere", 5.0 / 7.0), ("cylinder", 2.0 / 3.0)])
def test_what_rolls_down_a_slope_speeds_up_by_its_inertia(
    shape: str, share: float, every: int
) -> None:
    """g sin(tilt) / (1 + I/(m r^2)) for a second, within 1e-3."""
    sim = wheel(shape, tilt=0.2, every=every)
    sim.run(1.0)
    assert sim.velocity[0, 0] == pytest.approx(share * G * math.sin(0.2), rel=1.0e-3)


@pytest.mark.parametrize(("rate", "share"), [(60, 0.02), (240, 0.003), (960, 0.0006)])
def test_a_cube_tips_over_an_edge_as_its_equation_has_it(rate: int, share: float) -> None:
    """Error after 0.35 s, as a share of the way. (By the levers of the start of the step it was
    0.08, 0.024 and 0.005.)"""
    builder = newton.ModelBuilder()
    add_cube_on_edge(builder, TILT)
    sim = Simulation(builder, dt=1.0 / rate)
    start = sim.center[0]
    steps = round(0.35 * rate)
    sim.step(steps)
    path = tipped(np.array([0.0, steps / rate]), TILT, 0.0)[:, 0]
    error = np.linalg.norm(sim.center[0] - start - (path[1] - path[0]))
    assert error < share * np.linalg.norm(path[1] - path[0])


@pytest.mark.parametrize(("dt", "every"), [(1.0 / 240.0, 1), (1.0 / 480.0, 8)])
@pytest.mark.parametrize("shape", ["capsule", "cylinder"])
def test_what_is_thrown_and_whirls_gains_little_energy(shape: str, dt: float, every: int) -> None:
    """At most 1.5 % of the energy at the start of each of thirty, in a second. (It was up to 2.4 %
    where contacts were found at each step, and 20 % where every eighth.)"""
    rng = np.random.default_rng(7)
    builder = newton.ModelBuilder()
    velocities = []
    for _ in range(30):
        world = newton.ModelBuilder()
        add_ground(world, 0.6)
        q = rng.normal(size=4)
        pose = wp.transform(wp.vec3(0.0, 0.0, 0.3), wp.quat(*(q / np.linalg.norm(q))))
        add_shape(world, world.add_body(xform=pose), shape, 0.6)
        builder.add_world(world)
        velocities.append((0.3 * rng.normal(size=3), 8.0 * rng.normal(size=3)))
    sim = OnceForSeveral(builder, dt=dt)
    sim.every = every
    for body, (linear, angular) in enumerate(velocities):
        sim.set_velocity(body, tuple(linear), tuple(angular))

    def energies() -> np.ndarray:
        v, spin = sim.velocity, np.sum(sim.velocity[:, 3:] * sim.spin_momentum, axis=1)
        kinetic = 0.5 * (sim.mass * np.sum(v[:, :3] ** 2, axis=1) + spin)
        return kinetic + sim.mass * G * sim.center[:, 2]

    first = last = energies()
    gained = np.zeros(30)
    for _ in range(round(1.0 / (dt * every))):
        sim.step(every)
        now = energies()
        gained += np.maximum(now - last, 0.0)
        last = now
    assert np.max(gained / first) < 0.015
