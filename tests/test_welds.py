# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Welded links are one body inside the solver, and as many as there are outside of it."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import EPS, IDENTITY, G, Simulation, add_ground, add_mass, surface
from newton import ModelFlags
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0
SIZE = (0.5, 0.3, 0.2)
"""Full edges of a box [m]."""
MASS = 1000.0 * float(np.prod(SIZE))


def transform(position=(0.0, 0.0, 0.0), rotation=IDENTITY) -> wp.transform:
    return wp.transform(wp.vec3(*position), rotation)


def add_block(builder: newton.ModelBuilder, link: int, at=(0.0, 0.0, 0.0), **settings) -> None:
    half = [0.5 * edge for edge in SIZE]
    builder.add_shape_box(link, xform=transform(at), hx=half[0], hy=half[1], hz=half[2], **settings)


def beam(welded: bool, height: float = 0.1, joint: str = "fixed") -> newton.ModelBuilder:
    """Two boxes end to end: as two links with a weld between them, or as one link."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    first = builder.add_link(xform=transform((0.0, 0.0, height)))
    add_block(builder, first, cfg=surface())
    joints = [builder.add_joint_free(first)]
    ahead = transform((SIZE[0], 0.0, 0.0))
    if welded:
        second = builder.add_link(xform=transform((SIZE[0], 0.0, height)))
        add_block(builder, second, cfg=surface())
        if joint == "fixed":
            joints.append(builder.add_joint_fixed(first, second, parent_xform=ahead))
        else:
            joints.append(builder.add_joint_d6(first, second, parent_xform=ahead))
    else:
        add_block(builder, first, (SIZE[0], 0.0, 0.0), cfg=surface())
    builder.add_articulation(joints)
    return builder


def throw(sim: Simulation) -> None:
    """The same rigid motion of the beam, whatever it is made of."""
    spin = np.array([0.5, 1.0, 1.0])
    middle = np.array([0.5 * SIZE[0], 0.0, sim.center[0, 2]])
    for body, center in enumerate(sim.center):
        sim.set_velocity(body, np.cross(spin, center - middle) + np.array([0.3, 0, 1]), spin)


@pytest.mark.parametrize("joint", ["fixed", "d6"])
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"scheme": "generalized_alpha"},
        {"sleeping": True},
        {"blocks": "body"},
        {"parallel": "bodies"},
    ],
    ids=lambda settings: "-".join(settings) or "default",
)
def test_two_welded_boxes_move_as_one_of_the_same_total(joint: str, settings: dict) -> None:
    """Poses, energy and contact forces, thrown up, tumbling and at rest.

    Bounds: the inertia of the sum rounds by some EPS; a tumble and its impacts multiply what that
    changes by some hundreds until it lies still. (With twice the spin impacts at one end after the
    other make up to 1e-3 m of it, converged or not: the two have twice as many contacts.)
    """
    two = Simulation(beam(True, 0.5, joint), **settings)
    one = Simulation(beam(False, 0.5), **settings)
    assert two.solver.effects.flags.welds and not one.solver.effects.flags.welds
    for sim in (two, one):
        throw(sim)
    forces = [sim.observe("contact_f") for sim in (two, one)]
    for seconds in (0.1, 0.2, 1.7):
        two.run(seconds)
        one.run(seconds)
        np.testing.assert_allclose(two.pose[0], one.pose[0], atol=1e-5)
        assert two.kinetic_energy == pytest.approx(one.kinetic_energy, rel=2e-3, abs=1e-4)
    if not settings.get("sleeping"):
        sums = [force.contact_f.numpy()[:, :3].sum(axis=0) for force in forces]
        np.testing.assert_allclose(sums[0], sums[1], atol=2e-4 * MASS * G)
    ahead = Rotation.from_quat(two.pose[0, 3:]).apply([SIZE[0], 0.0, 0.0])
    np.testing.assert_allclose(two.pose[1, :3], two.pose[0, :3] + ahead, atol=4 * EPS)


def test_a_weld_carries_what_a_free_body_diagram_says() -> None:
    """Two boxes welded to the world and to each other: the outer weld carries one weight and its
    moment about the box's COM, none; the inner one both weights."""
    builder = newton.ModelBuilder()
    first = builder.add_link(xform=transform((0.0, 0.0, 1.0)))
    second = builder.add_link(xform=transform((SIZE[0], 0.0, 1.0)))
    for link in (first, second):
        add_block(builder, link, cfg=surface())
    wall = builder.add_joint_fixed(-1, first, parent_xform=transform((0.0, 0.0, 1.0)))
    weld = builder.add_joint_fixed(
        first,
        second,
        parent_xform=transform((SIZE[0] / 2, 0.0, 0.0)),
        child_xform=transform((-SIZE[0] / 2, 0.0, 0.0)),
    )
    builder.add_articulation([wall, weld])
    sim = Simulation(builder, collide=False)
    assert sim.solver._solved.body_count == 0  # all of it is part of the static world
    wrench = sim.observe("body_parent_f")
    sim.push(second, (0.0, 7.0, 0.0))
    sim.step()
    load = wrench.body_parent_f.numpy()
    weight = MASS * G
    np.testing.assert_allclose(load[second], [0, -7, weight, 0, 0, 0], atol=1e-5 * weight)
    # about the COM of the first: the second hangs half a meter ahead of it
    held = [0, -7, 2 * weight, 0, -SIZE[0] * weight, -SIZE[0] * 7.0]
    np.testing.assert_allclose(load[first], held, atol=1e-5 * weight)
    assert not np.any(sim.velocity)


def test_a_weld_that_turns_carries_the_centripetal_force() -> None:
    """A beam of two boxes spins about its COM: each box pulls the other by m w^2 r."""
    sim = Simulation(beam(True, 5.0), collide=False)
    sim.model.set_gravity((0.0, 0.0, 0.0))
    wrench = sim.observe("body_parent_f")
    spin = 3.0
    for body, center in enumerate(sim.center):
        side = center[0] - 0.5 * SIZE[0]
        sim.set_velocity(body, (0.0, spin * side, 0.0), (0.0, 0.0, spin))
    sim.step(20)
    outward = Rotation.from_quat(sim.pose[0, 3:]).apply([1.0, 0.0, 0.0])
    force = wrench.body_parent_f.numpy()[1, :3]
    # within the turn of half a step
    expected = -MASS * spin**2 * 0.5 * SIZE[0] * outward
    np.testing.assert_allclose(force, expected, atol=spin * DT * np.linalg.norm(expected))
    np.testing.assert_allclose(wrench.body_parent_f.numpy()[0], 0.0, atol=0)


def test_a_pendulum_of_welded_links_and_a_massless_flange_swings_as_the_closed_form() -> None:
    """A rod of three welded links, a massless flange between hinge and rod, another at its end.

    Small swings of a physical pendulum: T = 2 pi sqrt(I / (m g d)), less than 1 % off at the
    amplitude of 0.2 rad (theta^2/16 = 0.25 %) and by backward Euler at a thousand steps a second.
    """
    builder = newton.ModelBuilder()
    length, count, amplitude = 0.3, 3, 0.2
    start = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), amplitude)
    flange = builder.add_link(label="flange")
    joints = [builder.add_joint_revolute(-1, flange, axis=(0.0, 1.0, 0.0))]
    above, below = flange, transform()
    for _ in range(count):
        rod = builder.add_link()
        builder.add_shape_box(
            rod,
            xform=transform((0.0, 0.0, -length / 2)),
            hx=0.01,
            hy=0.01,
            hz=length / 2,
            cfg=surface(),
        )
        joints.append(builder.add_joint_fixed(above, rod, parent_xform=below))
        above, below = rod, transform((0.0, 0.0, -length))
    tool = builder.add_link(label="tool0")
    joints.append(builder.add_joint_fixed(above, tool, parent_xform=below))
    builder.add_articulation(joints)
    builder.joint_q[0] = amplitude
    dt = 1.0e-3
    sim = Simulation(builder, collide=False, dt=dt)
    newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
    assert sim.solver._solved.body_count == 1
    whole, mass = count * length, 1000.0 * 0.02**2 * count * length
    inertia = mass * (whole**2 / 3.0 + (0.02**2) / 12.0)
    period = 2.0 * np.pi * np.sqrt(inertia / (mass * G * whole / 2.0))
    del start
    angles = []
    for _ in range(round(2.5 * period / dt)):
        sim.step()
        angles.append(2.0 * np.arctan2(sim.pose[flange, 4], sim.pose[flange, 6]))
    crossings = np.flatnonzero(np.diff(np.sign(angles)))
    measured = 2.0 * dt * np.mean(np.diff(crossings))
    assert measured == pytest.approx(period * (1.0 + amplitude**2 / 16.0), rel=3e-3)
    tip = Rotation.from_quat(sim.pose[flange, 3:]).apply([0.0, 0.0, -whole])
    np.testing.assert_allclose(sim.pose[tool, :3], tip, atol=2e-6)


def test_a_weld_that_is_switched_off_lets_go_once_the_solver_is_told() -> None:
    """Two boxes welded in the air fall together; then the second, pushed up, flies away."""
    sim = Simulation(beam(True, 3.0), collide=False)
    sim.step(10)
    sim.model.joint_enabled.assign([True, False])
    assert "topology" in sim.solver.unnoticed_changes()
    sim.solver.notify_model_changed(ModelFlags.JOINT_PROPERTIES)
    assert not sim.solver.effects.flags.welds
    sim.push(1, (0.0, 0.0, 3.0 * MASS * G))
    before = sim.velocity
    sim.step(10)
    gained = (sim.velocity - before)[:, 2]
    np.testing.assert_allclose(gained, [-10 * DT * G, 20 * DT * G], rtol=1e-4)
    sim.model.joint_enabled.assign([True, True])
    sim.solver.notify_model_changed(ModelFlags.JOINT_PROPERTIES)
    assert sim.solver.effects.flags.welds


def weigh_by(model: newton.Model, body: int, factor: float) -> None:
    """Makes a body so many times as heavy."""
    for name in ("mass", "inertia", "inv_mass", "inv_inertia"):
        values = getattr(model, f"body_{name}").numpy()
        values[body] *= 1.0 / factor if name.startswith("inv") else factor
        getattr(model, f"body_{name}").assign(values)


@pytest.mark.parametrize("is_told", [True, False])
def test_a_change_of_mass_reaches_the_welded_body(is_told: bool) -> None:
    """The second box made three times as heavy: a force on the first turns them as one body."""
    sim = Simulation(beam(True, 3.0), collide=False)
    model = sim.model
    weigh_by(model, 1, 3.0)
    if is_told:
        sim.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
    model.set_gravity((0.0, 0.0, 0.0))
    sim.push(0, (0.0, 0.0, 40.0))
    sim.step()
    momentum = (model.body_mass.numpy()[:, None] * sim.velocity[:, :3]).sum(axis=0)
    np.testing.assert_allclose(momentum, [0, 0, 40.0 * DT], rtol=1e-5, atol=1e-6)
    # about the common COM, 3/4 of the way to the second box
    arm = 0.75 * SIZE[0]
    reduced = 0.75 * MASS * SIZE[0] ** 2 + 4.0 * MASS * (SIZE[0] ** 2 + SIZE[2] ** 2) / 12.0
    assert sim.velocity[0, 4] == pytest.approx(arm * 40.0 * DT / reduced, rel=1e-4)


@pytest.mark.parametrize("is_told", [True, False])
def test_a_turning_beam_whose_mass_changes_goes_on_turning(is_told: bool) -> None:
    """Its COM moves by 5 cm; no link jumps by the 0.25 m/s that lie between old and new one."""
    sim = Simulation(beam(True, 3.0), collide=False)
    sim.model.set_gravity((0.0, 0.0, 0.0))
    for body, side in ((0, -0.5), (1, 0.5)):
        sim.set_velocity(body, (0.0, 5.0 * side * SIZE[0], 0.0), (0.0, 0.0, 5.0))
    sim.step(3)
    # the link whose frame is the body's stays that one, though another one is heavier now
    weigh_by(sim.model, 1, 1.5)
    assert sim.solver.unnoticed_changes() == []
    solved = sim.solver._solved
    if is_told:
        sim.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
    assert sim.solver._solved is solved
    momentum = sim.mass @ sim.velocity[:, :3]
    assert np.linalg.norm(momentum) == pytest.approx(5.0 * 0.05 * 2.5 * MASS, rel=1e-3)
    sim.step()
    np.testing.assert_allclose(sim.mass @ sim.velocity[:, :3], momentum, atol=1e-4 * MASS)
    np.testing.assert_allclose(sim.velocity[:, 5], 5.0, rtol=1e-5)


def test_masses_beside_a_weld_act_in_a_captured_graph_and_what_is_not_finite_holds() -> None:
    """A free body, and a welded one, that get ten times as heavy: v = F t / m."""
    builder = beam(True, 3.0)
    free = add_mass(builder, position=(3.0, 0.0, 0.0))
    sim = Simulation(builder, collide=False)
    sim.model.set_gravity((0.0, 0.0, 0.0))
    with wp.ScopedCapture(device="cpu") as capture:
        sim.step(2)
    for body in range(3):
        weigh_by(sim.model, body, 10.0)
    # who asks what has changed writes nothing
    solved = sim.solver._solved
    assert sim.solver.unnoticed_changes() == []
    assert solved.body_mass.numpy()[0] == pytest.approx(2.0 * MASS)
    weighed = solved.weighed()
    sim.push(0, (30.0, 0.0, 0.0))
    sim.push(free, (30.0, 0.0, 0.0))
    wp.capture_launch(capture.graph)
    for body, mass in ((0, 20.0 * MASS), (1, 20.0 * MASS), (free, 10.0)):
        assert sim.velocity[body, 0] == pytest.approx(30.0 * 2 * DT / mass, rel=1e-5)
    for name in ("mass", "com", "inertia"):
        known, found = (getattr(of, f"body_{name}").numpy() for of in (solved, weighed))
        np.testing.assert_allclose(found, known, rtol=1e-5, atol=1e-6)
    for body in (free, 1):
        before, mass = sim.velocity, sim.model.body_mass.numpy().copy()
        spoiled = mass.copy()
        spoiled[body] = np.nan
        sim.model.body_mass.assign(spoiled)
        wp.capture_launch(capture.graph)
        np.testing.assert_array_equal(sim.velocity[body], before[body])
        sim.model.body_mass.assign(mass)


def test_the_frame_of_a_joint_to_a_welded_link_can_move_without_a_call() -> None:
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    links = [builder.add_link(mass=1.0, inertia=wp.mat33(*np.eye(3).ravel())) for _ in range(2)]
    hinge = builder.add_joint_revolute(-1, links[0], axis=(0.0, 1.0, 0.0))
    builder.add_articulation([hinge, builder.add_joint_fixed(*links)])
    sim = Simulation(builder, collide=False)
    sim.model.joint_X_p.assign([transform((0.02, 0.0, 0.01)), transform()])
    sim.step(60)
    np.testing.assert_allclose(sim.pose[:, :3], [[0.02, 0.0, 0.01]] * 2, atol=1e-5)


def test_a_kick_on_one_link_moves_all_of_its_body() -> None:
    """The momentum that a user gives one link is shared, as an impact through the weld would."""
    sim = Simulation(beam(True, 3.0), collide=False)
    sim.model.set_gravity((0.0, 0.0, 0.0))
    for kicked in (0, 1):
        sim.state.body_qd.zero_()
        sim.set_velocity(kicked, (0.0, 0.0, 2.0))
        sim.step()
        momentum = MASS * sim.velocity[:, 2].sum()
        assert momentum == pytest.approx(2.0 * MASS, rel=1e-5)


def test_a_body_that_is_turned_elsewhere_keeps_the_velocity_of_its_leader() -> None:
    """Turned by hand by a right angle, at the same velocities of the links' own."""
    sim = Simulation(beam(True, 5.0), collide=False)
    sim.model.set_gravity((0.0, 0.0, 0.0))
    for body in (0, 1):
        sim.set_velocity(body, (0.0, SIZE[0] * body, 0.0), (0.0, 0.0, 1.0))
    sim.step()
    pose, velocity = sim.pose, sim.velocity
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    moved = pose.copy()
    moved[:, :3] = pose[0, :3] + turn.apply(pose[:, :3] - pose[0, :3])
    moved[:, 3:] = (turn * Rotation.from_quat(pose[:, 3:])).as_quat()
    sim.state.body_q.assign(moved.astype(np.float32))
    apart = np.cross([0.0, 0.0, 1.0], moved[1, :3] - moved[0, :3])
    sim.set_velocity(1, velocity[0, :3] + apart, (0.0, 0.0, 1.0))
    momentum = MASS * sim.velocity[:, :3].sum(axis=0)
    sim.step()
    np.testing.assert_allclose(MASS * sim.velocity[:, :3].sum(axis=0), momentum, atol=1e-3)


def test_mimic_joints_beside_welds_follow_by_their_own_coefficients() -> None:
    """A chain of mimic joints behind a weld: composed coefficients are those of their joints."""
    builder = newton.ModelBuilder()
    base, y = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3))), (0.0, 1.0, 0.0)
    joints = [builder.add_joint_fixed(-1, base)]
    links = [builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3))) for _ in range(3)]
    joints += [builder.add_joint_revolute(base, link, axis=y) for link in links]
    builder.add_articulation(joints)
    for follower, leader, factor in ((2, 1, 2.0), (3, 2, 0.5)):
        builder.joint_mimic_joint[joints[follower]] = joints[leader]
        builder.joint_mimic_coeffs[joints[follower]] = (0.0, factor)
    sim = Simulation(builder, collide=False)
    sim.control.joint_f.assign([0.3, 0.0, 0.0])
    sim.step(10)
    rates = sim.velocity[links, 4]
    np.testing.assert_allclose(rates[1:], [2.0 * rates[0], rates[0]], rtol=1e-4)
    assert rates[0] > 1e-3
    sim.model.joint_mimic_coeffs.assign(sim.model.joint_mimic_coeffs.numpy() * [1.0, 2.0])
    sim.solver.notify_model_changed(ModelFlags.JOINT_PROPERTIES)
    sim.step(10)
    # what was closed at the start of the step moves on by the new ratios
    rates = sim.velocity[links, 4]
    np.testing.assert_allclose(rates[1:], [4.0 * rates[0], 4.0 * rates[0]], rtol=1e-3)


def test_reset_puts_all_links_back_and_a_checkpoint_goes_on_to_the_same_bits() -> None:
    sim = Simulation(beam(True, 0.3))
    start = sim.pose
    sim.step(30)
    kept = sim.solver.checkpoint()
    q, qd = sim.state.body_q.numpy().copy(), sim.state.body_qd.numpy().copy()
    sim.step(30)
    end = sim.pose
    sim.solver.restore(kept)
    sim.state.body_q.assign(q)
    sim.state.body_qd.assign(qd)
    sim.step(30)
    np.testing.assert_array_equal(sim.pose, end)
    sim.solver.reset(sim.state)
    np.testing.assert_array_equal(sim.pose, start)


def test_what_is_not_finite_of_one_link_loses_nothing_of_the_others() -> None:
    sim = Simulation(beam(True, 0.3))
    sim.set_velocity(1, (np.nan, 0.0, 0.0))
    before = sim.state.body_q.numpy().copy()
    sim.step()
    np.testing.assert_array_equal(sim.state.body_q.numpy(), before)
    assert sim.solver.status.held_steps.sum() == 1
    sim.set_velocity(1)
    sim.step()
    assert np.all(np.isfinite(sim.velocity)) and sim.velocity[0, 2] < 0.0


def test_the_force_of_a_free_joint_acts_at_the_center_of_its_link() -> None:
    """joint_f on the first of two welded boxes: as body_f on it, not at the common COM."""
    pushed, forced = (
        Simulation(beam(True, 3.0), collide=False),
        Simulation(beam(True, 3.0), collide=False),
    )
    pushed.push(0, (0.0, 0.0, 300.0))
    forced.control.joint_f.assign([0.0, 0.0, 300.0, 0.0, 0.0, 0.0])
    for sim in (pushed, forced):
        sim.step(5)
    np.testing.assert_allclose(forced.velocity, pushed.velocity, rtol=1e-5, atol=1e-6)
    assert abs(pushed.velocity[0, 4]) > 0.01


def test_a_force_between_welded_bodies_acts_at_where_a_new_mass_puts_it() -> None:
    """joint_f on the child of a FREE joint, which a link of another body holds, as once told."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    links = [
        builder.add_link(
            mass=2.0 - i % 2, inertia=wp.mat33(np.eye(3)), xform=transform((float(i), 0.0, 0.0))
        )
        for i in range(4)
    ]
    joints = [builder.add_joint_free(links[0])]
    ahead = transform((1.0, 0.0, 0.0))
    joints.append(builder.add_joint_fixed(*links[:2], parent_xform=ahead))
    joints.append(builder.add_joint_free(links[2], parent=links[1]))
    joints.append(builder.add_joint_fixed(*links[2:], parent_xform=ahead))
    builder.add_articulation(joints)
    velocity = []
    for is_told in (True, False):
        sim = Simulation(builder, collide=False)
        sim.control.joint_f.assign([0.0] * 6 + [0.0, 0.0, 30.0, 0.0, 0.0, 0.0])
        weigh_by(sim.model, links[3], 1.8)
        if is_told:
            sim.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
        sim.step()
        velocity.append(sim.velocity)
    np.testing.assert_allclose(velocity[1], velocity[0], atol=1e-6)
    assert np.all(np.abs(velocity[0][:, 4]) > 1e-3)


def test_a_kinematic_link_leads_what_is_welded_to_it() -> None:
    builder = beam(True, 1.0)
    builder.body_flags[0] = int(newton.BodyFlags.KINEMATIC)
    sim = Simulation(builder, collide=False)
    sim.set_velocity(0, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    start = sim.pose
    sim.step()
    np.testing.assert_array_equal(sim.pose[0], start[0])  # the user moves it
    np.testing.assert_allclose(sim.velocity[1, :3], [0.0, SIZE[0], 0.0], atol=1e-6)


def test_links_that_are_no_body_step_in_a_captured_graph() -> None:
    eager, replayed = Simulation(beam(True, 0.3)), Simulation(beam(True, 0.3))
    with wp.ScopedCapture(device="cpu") as capture:
        replayed.step(2)
    for _ in range(20):
        eager.step(2)
        wp.capture_launch(capture.graph)
    np.testing.assert_array_equal(replayed.pose, eager.pose)


def test_worlds_of_welded_links_move_as_one_alone() -> None:
    """Three worlds, the second of which is reset: to the bits of a world that is alone."""
    alone = Simulation(beam(True, 0.3))
    world, builder = beam(True, 0.3), newton.ModelBuilder()
    builder.replicate(world, 3)
    sim = Simulation(builder)
    start = sim.pose
    for each in (alone, sim):
        each.step(20)
    poses = sim.pose.reshape(3, 2, 7)
    for pose in poses:
        np.testing.assert_allclose(pose, alone.pose, atol=1e-6)
    mask = wp.array([False, True, False, False], dtype=wp.bool)
    sim.solver.reset(sim.state, mask)
    np.testing.assert_array_equal(sim.pose[2:4], start[2:4])
    np.testing.assert_array_equal(sim.pose[[0, 1, 4, 5]], poses[[0, 2]].reshape(4, 7))


@pytest.mark.parametrize("blocks", ["articulation", "body"])
def test_a_weld_to_a_still_link_outside_of_the_tree_pulls_the_arm_there(blocks: str) -> None:
    """MuJoCo's weld to a mocap body: three hinges take the angles that put the hand there."""
    reach, angles = 0.3, np.array([0.3, 0.5, -0.4])
    headings = np.cumsum(angles)
    goal = reach * np.array([np.cos(headings).sum(), np.sin(headings).sum(), 0.0])
    turn = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), float(headings[-1]))
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    mark = builder.add_link(xform=transform(goal, turn))
    builder.add_articulation(
        [builder.add_joint_fixed(-1, mark, parent_xform=transform(goal, turn))]
    )
    joints, last = [], -1
    inertia = wp.mat33(*(0.01 * np.eye(3)).ravel())
    for i in range(3):
        link = builder.add_link(mass=1.0, inertia=inertia, com=(0.5 * reach, 0.0, 0.0))
        ahead = transform((reach if i else 0.0, 0.0, 0.0))
        joints.append(
            builder.add_joint_revolute(last, link, parent_xform=ahead, axis=(0.0, 0.0, 1.0))
        )
        last = link
    hand = builder.add_link()
    joints.append(builder.add_joint_fixed(last, hand, parent_xform=transform((reach, 0.0, 0.0))))
    builder.add_articulation(joints)
    builder.add_joint_fixed(mark, hand)
    builder.joint_q[-3:] = [0.2, 0.7, -0.6]
    model = builder.finalize(device="cpu")
    newton.eval_fk(model, model.joint_q, model.joint_qd, model)
    solver, state, after = SolverAVBD(model, blocks=blocks), model.state(), model.state()
    for _ in range(120):
        solver.step(state, after, model.control(), None, DT)
        state, after = after, state
    newton.eval_ik(model, state, state.joint_q, state.joint_qd)
    np.testing.assert_allclose(state.joint_q.numpy(), angles, atol=1e-4)
    np.testing.assert_allclose(state.body_q.numpy()[hand, :3], goal, atol=1e-5)


@pytest.mark.parametrize(
    ("gap", "settings"),
    [
        (0.2, {}),
        (0.2, {"scheme": "generalized_alpha"}),
        (0.2, {"parallel": "bodies"}),
        # body by body, a gap closes that is small beside the radius of gyration, 0.1 m
        (0.02, {"blocks": "body"}),
    ],
)
def test_a_weld_to_the_world_pulls_a_tree_there_from_where_the_state_puts_it(
    gap: float, settings: dict
) -> None:
    """Two slides let the hand go anywhere in a plane, and a weld puts it off where it starts."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    inertia = wp.mat33(*(0.01 * np.eye(3)).ravel())
    sledge, hand = (builder.add_link(mass=1.0, inertia=inertia) for _ in range(2))
    joints = [
        builder.add_joint_prismatic(-1, sledge, axis=(1.0, 0.0, 0.0)),
        builder.add_joint_prismatic(sledge, hand, axis=(0.0, 1.0, 0.0)),
    ]
    builder.add_articulation(joints)
    goal = gap * np.array([1.0, -1.5, 0.0])
    builder.add_joint_fixed(-1, hand, parent_xform=transform(goal))
    model = builder.finalize(device="cpu")
    solver, state, after = SolverAVBD(model, **settings), model.state(), model.state()
    for _ in range(120):
        solver.step(state, after, model.control(), None, DT)
        state, after = after, state
    np.testing.assert_allclose(state.body_q.numpy()[hand, :3], goal, atol=1e-5)
    np.testing.assert_allclose(state.body_q.numpy()[sledge, :3], [goal[0], 0.0, 0.0], atol=1e-5)
    # the correction of a gap is no velocity
    np.testing.assert_allclose(state.body_qd.numpy(), 0.0, atol=1e-5)
