# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What flies by many times its size a step does not get through thin walls, however it turns."""

from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import Array, Simulation, surface
from scipy.spatial.transform import Rotation

DT = 1.0 / 60.0
COUNT = 24
SHAPES = ("box", "capsule", "cylinder")


def add_slug(builder: newton.ModelBuilder, kind: str, x: float, speed: float, rng: Any) -> int:
    """A slug of steel, 2 cm x 1 cm, in any rotation, that flies along x and turns at any rate."""
    turn = Rotation.random(random_state=rng.integers(2**31)).as_quat()
    body = builder.add_body(xform=wp.transform((x, 0.003, 0.002), wp.quat(*map(float, turn))))
    cfg = surface(density=7800.0, gap=0.01)
    if kind == "box":
        builder.add_shape_box(body, hx=0.01, hy=0.005, hz=0.005, cfg=cfg)
    elif kind == "capsule":
        builder.add_shape_capsule(body, radius=0.005, half_height=0.005, cfg=cfg)
    else:
        builder.add_shape_cylinder(body, radius=0.005, half_height=0.01, cfg=cfg)
    spin = rng.uniform(-1.0, 1.0, 3) * rng.choice([0.0, 30.0, 120.0, 300.0])
    builder.body_qd[body] = (speed, 0.0, 0.0, *map(float, spin))
    return body


def simulate(builder: newton.ModelBuilder, ahead: float, **settings: Any) -> Simulation:
    """A simulation whose detection looks so far ahead [m]."""
    sim = Simulation(builder, dt=DT, **settings)
    sim.pipeline = newton.CollisionPipeline(sim.model, speculative_contact_gap_max=ahead)
    sim.contacts = sim.pipeline.contacts()
    return sim


def step(sim: Simulation) -> None:
    """A step, of which detection knows how long it is."""
    sim.pipeline.collide(sim.state, sim.contacts, dt=DT)
    sim.solver.step(sim.state, sim._next, None, sim.contacts, DT)
    sim.state, sim._next = sim._next, sim.state


def run(builder: newton.ModelBuilder, speed: float, **settings: Any) -> tuple[Simulation, Array]:
    """Half a second; also the largest x of each body."""
    sim = simulate(builder, 1.2 * 2.0 * speed * DT, **settings)
    farthest = sim.center[:, 0]
    for _ in range(30):
        step(sim)
        farthest = np.maximum(farthest, sim.center[:, 0])
    return sim, farthest


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("speed", [100.0, 1000.0])
def test_no_slug_gets_through_a_wall_of_a_centimeter(speed: float, parallel: str) -> None:
    """The center of none gets past the middle of the wall, and none leaves faster than it came."""
    rng = np.random.default_rng(int(speed))
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    for k in range(COUNT):
        builder.begin_world()
        add_slug(builder, SHAPES[k % 3], -rng.uniform(0.1, 1.0) * speed * DT, speed, rng)
        wall = wp.transform((0.005, 0.0, 0.0), wp.quat_identity())
        builder.add_shape_box(-1, xform=wall, hx=0.005, hy=0.5, hz=0.5, cfg=surface(gap=0.01))
        builder.end_world()
    sim, farthest = run(builder, speed, parallel=parallel)
    assert np.all(farthest < 0.005)
    assert np.all(np.linalg.norm(sim.velocity[:, :3], axis=1) < 0.2 * speed)


def test_no_die_falls_through_a_shelf_of_a_centimeter() -> None:
    """Dice of 2 cm come down by 5 to 8 cm a step; the center of none gets to its middle."""
    rng = np.random.default_rng(3)
    builder = newton.ModelBuilder()
    shelf = wp.transform((0.0, 0.0, -0.005), wp.quat_identity())
    for _ in range(32):
        builder.begin_world()
        turn = Rotation.random(random_state=rng.integers(2**31)).as_quat()
        place = wp.transform((0.0, 0.0, rng.uniform(0.2, 0.8)), wp.quat(*map(float, turn)))
        die = builder.add_body(xform=place)
        builder.add_shape_box(die, hx=0.01, hy=0.01, hz=0.01, cfg=surface(gap=0.01))
        velocity = np.append(rng.normal(size=2) * 0.5, 0.0)
        builder.body_qd[die] = (*map(float, velocity), *map(float, 10.0 * rng.normal(size=3)))
        builder.add_shape_box(-1, xform=shelf, hx=3.0, hy=3.0, hz=0.005, cfg=surface(gap=0.01))
        builder.end_world()
    sim = simulate(builder, 0.2)
    for _ in range(120):
        step(sim)
        assert sim.center[:, 2].min() > -0.005


@pytest.mark.parametrize("speed", [100.0, 1000.0])
def test_slugs_that_meet_stop_each_other_and_keep_their_momentum(speed: float) -> None:
    rng = np.random.default_rng(int(speed) + 1)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    for k in range(COUNT):
        builder.begin_world()
        kind, apart = SHAPES[k % 3], rng.uniform(0.2, 1.9) * speed * DT
        add_slug(builder, kind, -0.5 * apart, speed, rng)
        add_slug(builder, kind, 0.5 * apart, -speed, rng)
        builder.end_world()
    sim, _ = run(builder, speed)
    # equal masses from both sides
    momentum = sim.velocity[::2, :3] + sim.velocity[1::2, :3]
    assert np.abs(momentum).max() < 1.0e-5 * speed
    # what is left of the speed is that of bodies that glance off
    assert np.abs(sim.velocity[:, 0]).max() < 0.2 * speed
    assert sim.kinetic_energy < 0.05 * COUNT * sim.mass[0] * speed**2


def angular_momentum(sim: Simulation) -> Array:
    """That of each pair of slugs about the origin [N m s], shape (pairs, 3)."""
    spin = np.einsum("nij,nj->ni", sim.world_inertia, sim.velocity[:, 3:])
    orbit = np.cross(sim.center, sim.mass[:, None] * sim.velocity[:, :3])
    return (spin + orbit).reshape(-1, 2, 3).sum(axis=1)


@pytest.mark.parametrize("speed", [100.0, 1000.0])
def test_slugs_that_meet_off_center_face_to_face_do_not_pass_each_other(speed: float) -> None:
    """Four points touch, but the blow misses the centers of mass, and would turn the slugs."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    aside = 0.001 * np.array([(0.1, 0.0), (0.5, 0.5), (3.0, 2.0), (4.0, 4.0)])
    for y, z in aside:
        builder.begin_world()
        for x, sign in ((-0.3, 1.0), (0.3, -1.0)):
            place = wp.transform(
                (x * speed * DT, 0.5 * sign * y, 0.5 * sign * z), wp.quat_identity()
            )
            body = builder.add_body(xform=place)
            cfg = surface(density=7800.0, gap=0.01)
            builder.add_shape_box(body, hx=0.01, hy=0.005, hz=0.005, cfg=cfg)
            builder.body_qd[body] = (sign * speed, 0.0, 0.0, 0.0, 0.0, 0.0)
        builder.end_world()
    sim = simulate(builder, 2.4 * speed * DT)
    before = angular_momentum(sim)
    step(sim)
    assert np.all(sim.center[::2, 0] < sim.center[1::2, 0])
    after = angular_momentum(sim)
    np.testing.assert_allclose(after, before, atol=2.0e-4 * sim.mass[0] * speed * 0.01)
    step(sim)
    # what is left of the speed is that of bodies that glance off
    assert np.abs(sim.velocity[:, :3]).max() < 0.2 * speed


def test_slugs_that_meet_the_corner_of_a_free_wall_far_away_settle() -> None:
    """Seen from a slug, the lever of the wall is 14 m long, and its own inertia nothing."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    cfg = surface(density=7800.0, gap=0.1)
    lying = wp.transform(
        (0.0, 0.0, 0.0), wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), np.pi / 2)
    )
    angles = np.linspace(0.45, 0.8, 64)
    ways = np.stack([np.cos(angles), np.sin(angles), np.zeros(64)], axis=1)
    for way in ways:
        builder.begin_world()
        x, y, z = map(float, -7.2 * way)
        slug = builder.add_body(xform=wp.transform((x, y + 0.003, z + 0.002), wp.quat_identity()))
        builder.add_shape_cylinder(slug, xform=lying, radius=0.004, half_height=0.01, cfg=cfg)
        builder.body_qd[slug] = (*map(float, 1000.0 * way), 0.0, 0.0, 0.0)
        wall = builder.add_body(xform=wp.transform((0.005, 0.0, 0.0), wp.quat_identity()))
        builder.add_shape_box(wall, hx=0.005, hy=0.5, hz=0.5, cfg=cfg)
        builder.end_world()
    sim = simulate(builder, 20.0)
    step(sim)
    assert sim.solver.status.held_steps.sum() == 0
    assert np.all(sim.solver.report().settled)
    momentum = (sim.mass[:, None] * sim.velocity[:, :3]).reshape(-1, 2, 3).sum(axis=1)
    np.testing.assert_allclose(momentum, 1000.0 * sim.mass[0] * ways, atol=1.0 * sim.mass[0])


def test_a_lever_that_is_long_for_a_tiny_inertia_keeps_its_friction() -> None:
    """A box of 2 m/s, whose file says next to no inertia: mu g slows it, in steps of 3 cm."""
    builder = newton.ModelBuilder()
    builder.add_ground_plane(cfg=surface(mu=0.5))
    inertia = wp.mat33(*(1.0e-7 * np.eye(3)).ravel())
    body = builder.add_body(
        xform=wp.transform((0.0, 0.0, 0.01), wp.quat_identity()), mass=1.0, inertia=inertia
    )
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.01, cfg=surface(mu=0.5, density=0.0))
    builder.body_qd[body] = (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    sim = Simulation(builder, dt=DT)
    sim.step(6)
    np.testing.assert_allclose(sim.velocity[0, 0], 2.0 - 0.5 * 9.81 * 0.1, rtol=0.02)
