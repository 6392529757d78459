# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Coulomb friction: sticks inside the cone, slides on it, and lets round bodies roll."""

import math

import newton
import numpy as np
import pytest
import warp as wp
from helpers import IDENTITY, G, Simulation, add_box, add_ground, add_sphere, surface

from newton_avbd.study.accuracy.simbench import FORCE, add_rolling, rolling_accelerations


def box_on_slope(angle: float, mu: float) -> tuple[Simulation, np.ndarray]:
    """A cube resting on a slope that falls towards +x, and the direction downhill."""
    slope = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), angle)
    builder = newton.ModelBuilder()
    builder.add_shape_plane(
        xform=wp.transform(wp.vec3(), slope), width=0.0, length=0.0, cfg=surface(mu, density=0.0)
    )
    position = (0.25 * math.sin(angle), 0.0, 0.25 * math.cos(angle))
    add_box(builder, position, rotation=slope, mu=mu)
    return Simulation(builder), np.array([math.cos(angle), 0.0, -math.sin(angle)])


@pytest.mark.parametrize("mu", [0.2, 0.5, 1.0])
def test_a_box_sticks_just_below_the_friction_angle(mu: float) -> None:
    """At 98 % of tan(angle) = mu it creeps less than 1e-6 m/s.

    The multipliers hold it, so only rounding could move it: half a unit of its position
    (3e-8 m) a second would still be below that bound, a unit each step would not.
    """
    sim, downhill = box_on_slope(math.atan(0.98 * mu), mu)
    sim.run(0.5)
    start = sim.pose[0, :3]
    sim.run(2.0)
    assert abs((sim.pose[0, :3] - start) @ downhill) / 2.0 < 1.0e-6
    assert np.abs(sim.velocity).max() < 1.0e-4


@pytest.mark.parametrize("excess", [1.02, 1.5])
def test_a_box_slides_just_above_the_friction_angle(excess: float) -> None:
    """It accelerates with g (sin a - mu cos a): within 1 %, and 2e-3 of what friction takes.

    At 2 % above the angle the two terms nearly cancel, so that the error of each one counts.
    """
    mu = 0.5
    angle = math.atan(excess * mu)
    sim, downhill = box_on_slope(angle, mu)
    sim.run(0.25)
    start = sim.velocity[0, :3] @ downhill
    sim.run(1.0)
    got = sim.velocity[0, :3] @ downhill - start
    expected = G * (math.sin(angle) - mu * math.cos(angle))
    assert got == pytest.approx(expected, rel=0.01, abs=2.0e-3 * G * mu * math.cos(angle))


@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0, 1.0 / 1000.0])
@pytest.mark.parametrize("mu", [0.1, 0.5])
def test_a_sliding_box_stops_after_v_squared_over_two_mu_g(mu: float, dt: float) -> None:
    """Slide distance within 1 % of v^2/(2 mu g), beyond what backward Euler takes: v dt/2."""
    v = 3.0
    builder = newton.ModelBuilder()
    add_ground(builder, mu)
    add_box(builder, (0.0, 0.0, 0.05), (0.5, 0.5, 0.1), mu=mu)
    sim = Simulation(builder, dt=dt, scheme="euler")
    sim.set_velocity(0, (v, 0.0, 0.0))
    sim.run(1.2 * v / (mu * G))
    expected = v * v / (2.0 * mu * G)
    assert sim.pose[0, 0] == pytest.approx(expected - 0.5 * v * dt, rel=0.01)
    assert np.abs(sim.velocity).max() < 1.0e-4


def test_friction_is_the_same_in_every_direction() -> None:
    """The cone is round: equal slide distances along x, y and between, to 0.1 %.

    A pyramid of two axes would stop the diagonal slide after 1/sqrt(2) of the way.
    """
    builder = newton.ModelBuilder()
    add_ground(builder, 0.5)
    angles = np.radians([0.0, 30.0, 45.0, 90.0, 200.0])
    for i in range(len(angles)):
        body = builder.add_body(xform=wp.transform(wp.vec3(0.0, 5.0 * i, 0.05), IDENTITY))
        builder.add_shape_cylinder(body, radius=0.3, half_height=0.05, cfg=surface(0.5))
    sim = Simulation(builder)
    start = sim.pose[:, :2]
    for i, angle in enumerate(angles):
        sim.set_velocity(i, (2.0 * math.cos(angle), 2.0 * math.sin(angle), 0.0))
    sim.run(0.6)
    moved = sim.pose[:, :2] - start
    distance = np.linalg.norm(moved, axis=1)
    assert distance == pytest.approx(distance[0], rel=1.0e-3)
    direction = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    assert np.sum(moved * direction, axis=1) == pytest.approx(distance, rel=1.0e-3)


@pytest.mark.parametrize(("shape", "share"), [("sphere", 5.0 / 7.0), ("cylinder", 2.0 / 3.0)])
def test_a_sliding_round_body_ends_up_rolling(shape: str, share: float) -> None:
    """Friction turns v into rolling at v/(1 + I/(m r^2)): 5/7 v or 2/3 v, within 1 %.

    Then it rolls on: no slip, and no loss of speed in a second (rolling friction is not modelled).
    """
    v, radius, mu = 2.0, 0.25, 0.4
    builder = newton.ModelBuilder()
    add_ground(builder, mu)
    if shape == "sphere":
        add_sphere(builder, (0.0, 0.0, radius), radius, mu=mu)
    else:
        on_side = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), 0.5 * math.pi)
        body = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, radius), on_side))
        builder.add_shape_cylinder(body, radius=radius, half_height=0.2, cfg=surface(mu))
    sim = Simulation(builder)
    sim.set_velocity(0, (v, 0.0, 0.0))
    sim.run(0.5)  # slipping ends after v (1 - share) / (mu g) = 0.17 s at the latest
    assert sim.velocity[0, 0] == pytest.approx(share * v, rel=0.01)
    assert sim.velocity[0, 4] * radius == pytest.approx(sim.velocity[0, 0], rel=1.0e-3)
    rolling = sim.velocity[0, 0]
    sim.run(1.0)
    assert sim.velocity[0, 0] == pytest.approx(rolling, rel=1.0e-3)


def test_without_friction_nothing_slows_a_slide() -> None:
    """mu = 0 on both: the speed along the ground stays as it is, to rounding."""
    builder = newton.ModelBuilder()
    add_ground(builder, 0.0)
    add_box(builder, (0.0, 0.0, 0.25), mu=0.0)
    sim = Simulation(builder)
    sim.set_velocity(0, (3.0, 1.0, 0.0))
    sim.run(1.0)
    assert sim.velocity[0, :3] == pytest.approx([3.0, 1.0, 0.0], abs=1.0e-5)


def test_friction_of_two_shapes_is_their_geometric_mean() -> None:
    """As SolverVBD mixes it: mu = sqrt(0.2 * 0.8) = 0.4; slide distance within 1 %."""
    builder = newton.ModelBuilder()
    add_ground(builder, 0.2)
    add_box(builder, (0.0, 0.0, 0.05), (0.5, 0.5, 0.1), mu=0.8)
    sim = Simulation(builder)
    sim.set_velocity(0, (2.0, 0.0, 0.0))
    sim.run(1.0)
    expected = 2.0**2 / (2.0 * 0.4 * G) - 0.5 * 2.0 * sim.dt
    assert sim.pose[0, 0] == pytest.approx(expected, rel=0.01)


def test_hinged_boxes_slide_at_any_time_step() -> None:
    """Two boxes on a hinge at 3,840 Hz: a step's moves are below the rounding of poses."""
    builder = newton.ModelBuilder()
    links = []
    for i in range(2):
        links.append(builder.add_link())
        builder.add_shape_box(links[i], hx=0.2, hy=0.2, hz=0.05, cfg=surface(mu=0.5))
    builder.add_articulation(
        [
            builder.add_joint_free(links[0]),
            builder.add_joint_revolute(
                *links,
                parent_xform=wp.transform((0.25, 0.0, 0.0)),
                child_xform=wp.transform((-0.25, 0.0, 0.0)),
                axis=(0.0, 1.0, 0.0),
            ),
        ]
    )
    add_ground(builder, mu=0.5)
    sim = Simulation(builder, dt=1 / 3840)
    pose = sim.state.body_q.numpy()
    pose[:, :3] = [[0.0, 0.0, 0.05], [0.5, 0.0, 0.05]]
    sim.state.body_q.assign(pose)
    for link in links:
        sim.set_velocity(link, (2.0, 0.0, 0.0))
    sim.run(0.1)
    np.testing.assert_allclose(sim.velocity[:, 0], 2.0 - 0.5 * G * 0.1, rtol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
@pytest.mark.parametrize("shape", ["box", "sphere"])
def test_what_slides_or_rolls_evenly_takes_few_sweeps(shape: str, dt: float) -> None:
    """It starts where the friction of the last step leaves it: two sweeps a step for a box that a
    platform shakes, and drags along by friction, and five for a ball that rolls on it."""
    builder = newton.ModelBuilder()
    platform = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, -0.1), IDENTITY), mass=1.0)
    builder.body_flags[platform] = int(newton.BodyFlags.KINEMATIC)
    builder.add_shape_box(platform, hx=4.0, hy=2.0, hz=0.1, cfg=surface(density=0.0))
    (add_box if shape == "box" else add_sphere)(builder, (0.0, 0.0, 0.25))
    sim, sweeps = Simulation(builder, dt=dt), []
    for step in range(round(1.0 / dt)):
        sim.set_velocity(0, (math.cos(4.0 * math.pi * step * dt), 0.0, 0.0))
        sim.step()
        sweeps.append(sim.solver.status.sweeps.max())
    assert np.median(sweeps) <= (2 if shape == "box" else 6)


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_box_slides_on_from_rest_under_what_rolls_on_it(scheme: str) -> None:
    """Friction of the ground never stops it, since it is drawn. 25 balls press on its corners,
    where its mass against a blow from below is a seventh of its mass."""
    builder = newton.ModelBuilder()
    add_rolling(builder)
    sim = Simulation(builder, dt=1.0 / 60.0, scheme=scheme)
    force = np.zeros((sim.model.body_count, 6), dtype=np.float32)
    force[0, 1] = FORCE
    sim.state.body_f.assign(force)
    sim.run(1.0)
    np.testing.assert_allclose(sim.velocity[:2, 1], rolling_accelerations(), rtol=1e-3)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("is_kinematic", [False, True])
def test_a_box_on_a_turntable_goes_round_with_it(is_kinematic: bool, parallel: str) -> None:
    """At 1.5 rad/s, a meter off its axis, in the place that it has on the table, for a second.

    Friction holds it there, since w^2 r is below mu g. By the tangents of the steps it would move
    out by w^2 r h t: 37 mm at 60 Hz, 9 mm at 240 Hz. What is left falls with the square of h.
    """
    for rate, most in ((60, 3.0e-4), (240, 3.0e-5)):
        builder = newton.ModelBuilder()
        table = builder.add_link()
        builder.add_shape_cylinder(table, radius=1.5, half_height=0.1, cfg=surface(1.0, gap=0.01))
        hinge = builder.add_joint_revolute(-1, table, axis=(0.0, 0.0, 1.0))
        builder.add_articulation([hinge])
        if is_kinematic:
            builder.body_flags[table] = int(newton.BodyFlags.KINEMATIC)
        box = add_box(builder, (1.0, 0.0, 0.15), (0.1, 0.1, 0.1), mu=1.0)
        sim = Simulation(builder, dt=1.0 / rate, parallel=parallel)
        sim.set_velocity(table, angular=(0.0, 0.0, 1.5))
        sim.set_velocity(box, (0.0, 1.5, 0.0), (0.0, 0.0, 1.5))
        for k in range(rate):
            if is_kinematic:
                angle = 0.5 * 1.5 * k / rate
                pose = sim.state.body_q.numpy()
                pose[table] = [0.0, 0.0, 0.0, 0.0, 0.0, math.sin(angle), math.cos(angle)]
                sim.state.body_q.assign(pose)
                sim.set_velocity(table, angular=(0.0, 0.0, 1.5))
            sim.step()
        x, y = sim.pose[box, :2]
        assert math.hypot(x, y) == pytest.approx(1.0, abs=most)
        # of a kinematic one the pose is that which was written last
        turned = 2.0 * math.atan2(sim.pose[table, 5], sim.pose[table, 6])
        turned += 1.5 / rate if is_kinematic else 0.0
        assert math.atan2(y, x) == pytest.approx(turned, abs=2.0 * most)
