# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies in contact that are pushed: all speed up as force and mass have it."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, Simulation, add_box, add_ground


def add_row(builder: newton.ModelBuilder, count: int, mu: float) -> None:
    """Cubes of 125 kg and half a meter along x that touch, on the ground."""
    add_ground(builder, mu=mu)
    for i in range(count):
        add_box(builder, (0.5 * i, 0.0, 0.25), mu=mu)


def pushed(builder: newton.ModelBuilder, body: int, wrench: list[float]) -> Simulation:
    """Half a second of a constant force [N] and torque [N m] on a body, at 60 Hz, by default."""
    sim = Simulation(builder, dt=1.0 / 60.0)
    wrenches = np.zeros((sim.model.body_count, 6), dtype=np.float32)
    wrenches[body] = wrench
    sim.state.body_f.assign(wrenches)
    sim.run(0.5)
    return sim


@pytest.mark.parametrize("mu", [0.0, 0.4])
@pytest.mark.parametrize("count", [2, 5])
def test_boxes_in_a_row_speed_up_as_one(count: int, mu: float) -> None:
    """Two lost a third of the push, five half of it, where each held back the next."""
    builder = newton.ModelBuilder()
    add_row(builder, count, mu)
    force = count * 125.0 * (2.0 + mu * G)
    sim = pushed(builder, 0, [force, 0.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(sim.velocity[:, 0], 1.0, rtol=0.01)


def test_a_group_is_held_by_what_does_not_belong_to_it() -> None:
    """Friction that can hold a row of boxes does, and the last one pushes nobody."""
    builder = newton.ModelBuilder()
    add_row(builder, 3, mu=0.4)
    start = Simulation(builder).pose[:, :3]
    force = 0.9 * 3.0 * 125.0 * 0.4 * G
    sim = pushed(builder, 0, [force, 0.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(sim.pose[:, :3], start, atol=1e-4)
    assert np.abs(sim.velocity).max() < 1e-3


def test_a_group_turns_as_one() -> None:
    """Bricks on a cart that a torque turns on ice: all of it is in their angular momentum."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.0)
    add_box(builder, (0.0, 0.0, 0.1), (2.0, 2.0, 0.2), mu=0.8)
    for x in (-0.5, 0.0, 0.5):
        add_box(builder, (x, 0.0, 0.45), mu=0.8)
    for x in (-0.25, 0.25):
        add_box(builder, (x, 0.0, 0.95), mu=0.8)
    sim = pushed(builder, 0, [0.0, 0.0, 0.0, 0.0, 0.0, 1000.0])
    mass, center, velocity = sim.mass, sim.center, sim.velocity
    inertia = sim.model.body_inertia.numpy()[:, 2, 2]
    moved = np.cross(center, velocity[:, :3])[:, 2]
    np.testing.assert_allclose((mass * moved + inertia * velocity[:, 5]).sum(), 500.0, rtol=0.01)
    np.testing.assert_allclose(velocity[:, 5], velocity[0, 5], rtol=0.02)


@pytest.mark.parametrize(
    "options", [{}, {"parallel": "bodies"}, {"blocks": "body"}], ids=["worlds", "bodies", "body"]
)
@pytest.mark.parametrize("rate", [60, 240])
def test_what_hits_a_pile_leaves_it_its_momentum(rate: int, options: dict) -> None:
    """What the sweeps cut off took up to a fifth of it, or gave half as much again."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.0)
    for layer, count in enumerate((3, 2, 1)):
        for i in range(count):
            add_box(builder, (0.25 * layer + 0.5 * i + 0.5, 0.0, 0.5 * layer + 0.25), mu=0.4)
    hits = add_box(builder, (-0.3, 0.0, 0.25), mu=0.0)
    builder.body_qd[hits] = (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    sim = Simulation(builder, dt=1.0 / rate, **options)
    sim.run(0.4)
    momentum = (sim.mass * sim.velocity[:, 0]).sum()
    assert momentum == pytest.approx(2.0 * sim.mass[hits], rel=1e-3)
    np.testing.assert_allclose((sim.mass * sim.velocity[:, 1]).sum(), 0.0, atol=0.1)


@pytest.mark.parametrize("options", [{}, {"parallel": "bodies"}], ids=["worlds", "bodies"])
def test_articulations_on_the_ground_keep_their_momentum(options: dict) -> None:
    """Three trains of two hinged cubes in a row, which another hits; joints stay closed."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.0)
    shape = newton.ModelBuilder.ShapeConfig(density=1000.0, mu=0.0)
    for i in range(3):
        cars = []
        for x in (1.05 * i + 0.5, 1.05 * i + 1.05):
            cars.append(builder.add_link(xform=wp.transform((x, 0.0, 0.25))))
            builder.add_shape_box(cars[-1], hx=0.25, hy=0.25, hz=0.25, cfg=shape)
        base = builder.add_joint_free(child=cars[0])
        hinge = builder.add_joint_revolute(
            *cars,
            axis=(0.0, 0.0, 1.0),
            parent_xform=wp.transform((0.275, 0.0, 0.0)),
            child_xform=wp.transform((-0.275, 0.0, 0.0)),
        )
        builder.add_articulation([base, hinge])
    hits = add_box(builder, (-0.3, 0.0, 0.25), mu=0.0)
    builder.body_qd[hits] = (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    sim = Simulation(builder, dt=1.0 / 60.0, **options)
    sim.run(0.4)
    momentum = (sim.mass * sim.velocity[:, 0]).sum()
    assert momentum == pytest.approx(2.0 * sim.mass[hits], rel=1e-3)
    apart = sim.pose[1:6:2, 0] - sim.pose[0:6:2, 0]
    np.testing.assert_allclose(apart, 0.55, atol=1e-5)


@pytest.mark.parametrize("mu", [0.3, 0.5, 0.8])
def test_friction_drags_a_box_along(mu: float) -> None:
    """On a plank that is drawn from under it at twice what friction could; to 0.03 % in 0.2 s.

    Friction above g/2 was taken for an impact, which ends with its step.
    """
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.0)
    plank = newton.ModelBuilder.ShapeConfig(density=1000.0, mu=mu)
    body = builder.add_body(xform=wp.transform((0.0, 0.0, 0.1)))
    builder.add_shape_box(body, hx=2.0, hy=0.5, hz=0.1, cfg=plank)
    add_box(builder, (0.0, 0.0, 0.45), mu=mu)
    sim = Simulation(builder)
    force = 2.0 * mu * G * sim.mass.sum()
    wrenches = np.zeros((2, 6), dtype=np.float32)
    wrenches[0, 0] = force
    sim.state.body_f.assign(wrenches)
    sim.run(0.2)
    accelerations = [(force - mu * G * sim.mass[1]) / sim.mass[0], mu * G]
    np.testing.assert_allclose(sim.velocity[:, 0], 0.2 * np.array(accelerations), rtol=3e-4)


def add_gripper(builder: newton.ModelBuilder, apart: float, mu: float) -> int:
    """A carriage of 2 kg on a vertical slider, and two fingers of 0.2 kg on horizontal ones."""
    carriage = builder.add_link(mass=2.0, inertia=wp.mat33(0.02 * np.eye(3)))
    joints = [builder.add_joint_prismatic(-1, carriage, axis=(0.0, 0.0, 1.0))]
    for side in (-1.0, 1.0):
        finger = builder.add_link(
            xform=wp.transform((side * apart, 0.0, -0.2)),
            mass=0.2,
            inertia=wp.mat33(1e-4 * np.eye(3)),
        )
        cfg = newton.ModelBuilder.ShapeConfig(density=0.0, mu=mu)
        builder.add_shape_box(finger, hx=0.02, hy=0.03, hz=0.05, cfg=cfg)
        frame = wp.transform((side * apart, 0.0, -0.2))
        joints.append(
            builder.add_joint_prismatic(carriage, finger, axis=(1.0, 0.0, 0.0), parent_xform=frame)
        )
    builder.add_articulation(joints)
    return carriage


def driven(builder: newton.ModelBuilder, rate: int, forces: list[float]) -> Simulation:
    """Half a second of constant forces on the first joints [N]."""
    sim = Simulation(builder, dt=1.0 / rate)
    pushes = np.zeros(sim.model.joint_dof_count, dtype=np.float32)
    pushes[: len(forces)] = forces
    sim.control.joint_f.assign(pushes)
    sim.run(0.5)
    return sim


@pytest.mark.parametrize("rate", [60, 240])
@pytest.mark.parametrize("mass", [0.1, 1.0, 5.0])
def test_a_gripper_lifts_what_it_holds(mass: float, rate: int) -> None:
    """By 2 m/s^2; the cube stays where it is between the fingers.

    Robot and cube are moved in turns: cut off, the lift was of first order in time, 11 mm off.
    """
    builder = newton.ModelBuilder()
    add_gripper(builder, 0.07, mu=0.6)
    cube = add_box(builder, (0.0, 0.0, -0.2), 0.1, mu=0.6, density=mass / 0.001)
    whole = 2.4 + mass
    grip = 24.0 * mass + 10.0
    sim = driven(builder, rate, [whole * (G + 2.0), grip, -grip])
    np.testing.assert_allclose(sim.velocity[:, 2], 1.0, atol=1e-3)
    assert sim.pose[cube, 2] == pytest.approx(-0.2 + 0.25, abs=1e-3)
    np.testing.assert_allclose(sim.pose[1:, 2] - sim.pose[0, 2], -0.2, atol=1e-4)


@pytest.mark.parametrize("rate", [60, 240])
def test_links_that_press_on_each_other_move_as_one(rate: int) -> None:
    """Two fingers of 0.2 kg, pushed by 40 N and 30 N against each other: 25 m/s^2, and the lift.

    Each saw the other as standing still, and so both stood.
    """
    builder = newton.ModelBuilder()
    add_gripper(builder, 0.02, mu=0.5)
    sim = driven(builder, rate, [2.4 * (G + 2.0), 40.0, -30.0])
    np.testing.assert_allclose(sim.velocity[:, 2], 1.0, atol=1e-3)
    np.testing.assert_allclose(sim.velocity[1:, 0], 12.5, rtol=2e-3)
    assert sim.pose[2, 0] - sim.pose[1, 0] == pytest.approx(0.04, abs=1e-4)


def test_what_sweeps_left_of_a_step_is_nothing_to_the_next_one() -> None:
    """To the bit: a slot may be that of a world that failed, whose NaN went from world to world."""
    builder = newton.ModelBuilder()
    add_gripper(builder, 0.07, mu=0.6)
    add_box(builder, (0.0, 0.0, -0.2), 0.1, mu=0.6)
    clean, spoilt = (driven(builder, 240, [3.4 * (G + 2.0), 34.0, -34.0]) for _ in range(2))
    for array in (spoilt.solver._rows.mixed, spoilt.solver._work.mixed):
        left = array.numpy()
        for name in left.dtype.names:
            left[name] = np.nan
        array.assign(left)
    for sim in (clean, spoilt):
        sim.control.joint_f.assign(np.array([20.0, 34.0, -20.0, *[0.0] * 6], dtype=np.float32))
        sim.step()
    assert spoilt.solver.status.sweeps.max() > 2
    np.testing.assert_array_equal(spoilt.pose, clean.pose)


@pytest.mark.parametrize("mu", [0.0, 0.2])
@pytest.mark.parametrize("rate", [60, 240])
def test_a_robot_speeds_up_with_what_it_pushes(rate: int, mu: float) -> None:
    """A block of 2 kg on a slider, and three cubes as heavy: 2 m/s^2, less friction."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=mu)
    cfg = newton.ModelBuilder.ShapeConfig(density=0.0, mu=mu)
    block = builder.add_link(
        xform=wp.transform((0.0, 0.0, 0.25)), mass=2.0, inertia=wp.mat33(0.02 * np.eye(3))
    )
    builder.add_shape_box(block, hx=0.25, hy=0.2, hz=0.2, cfg=cfg)
    at = wp.transform((0.0, 0.0, 0.25))
    slider = builder.add_joint_prismatic(-1, block, axis=(1.0, 0.0, 0.0), parent_xform=at)
    builder.add_articulation([slider])
    for i in range(3):
        add_box(builder, (0.5 + 0.5 * i, 0.0, 0.25), mu=mu, density=16.0)
    sim = driven(builder, rate, [16.0 + mu * 6.0 * G])
    np.testing.assert_allclose(sim.velocity[:, 0], 1.0, rtol=2e-3)


@pytest.mark.parametrize("sleeping", [False, True])
def test_groups_of_other_worlds_do_not_matter(sleeping: bool) -> None:
    """A row that is pushed moves to the bit as beside a world at rest and one that falls."""
    row = newton.ModelBuilder()
    add_row(row, 4, mu=0.0)
    other = newton.ModelBuilder()
    add_ground(other, mu=0.0)
    for i in range(4):
        add_box(other, (0.3 * i, 0.1 * i, 0.3 + 0.6 * i), mu=0.0)
    many = newton.ModelBuilder()
    for world in (other, row, row):
        many.add_world(world)
    alone = newton.ModelBuilder()
    alone.add_world(row)
    poses = []
    for builder, first in ((alone, 0), (many, 4)):
        sim = Simulation(builder, dt=1.0 / 60.0, sleeping=sleeping)
        wrenches = np.zeros((sim.model.body_count, 6), dtype=np.float32)
        wrenches[first, 0] = 1000.0
        sim.state.body_f.assign(wrenches)
        sim.run(0.4)
        poses.append(sim.pose[first : first + 4])
        np.testing.assert_allclose(sim.velocity[first : first + 4, 0], 0.8, rtol=0.01)
    np.testing.assert_array_equal(*poses)
