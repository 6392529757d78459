# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Forces on joints (``control.joint_f``) and by joints (``body_parent_f``), in Newton's frames."""

import newton
import numpy as np
import pytest
from helpers import NO_GRAVITY, G, Simulation
from joint_scenes import (
    TENSOR,
    WORLD,
    add_link,
    anchor_frames,
    coordinates,
    set_control,
    set_coordinates,
    simulate,
    transform,
)
from newton.solvers import SolverBase
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.usefixtures("shared_kernels")

Dof = newton.ModelBuilder.JointDofConfig
PARENT_F = SolverBase.ObservableKind.BODY_PARENT_F
TURN_P = Rotation.from_euler("xyz", [0.5, -0.8, 1.9])
TURN_C = Rotation.from_euler("xyz", [-2.0, 0.4, 0.9])
AXIS = np.array([0.6, 0.3, -0.7]) / np.linalg.norm([0.6, 0.3, -0.7])
MASS = 2.0
COM = np.array([0.2, -0.1, 0.3])
ANCHOR = np.array([-0.2, 0.1, 0.05])
FRAMES = {
    "parent_xform": transform((0.3, -0.2, 1.0), TURN_P),
    "child_xform": transform(ANCHOR, TURN_C),
}
FIRST_STEP = 2.0e-3
"""Relative bound on an acceleration in one step from rest.

Turns in it are below 3e-4 rad, and closing what float32 rounds off a pose of 1 m in a step is
up to 4e-3 m/s^2, of 10 and more here.
"""


def kick(builder: newton.ModelBuilder, joint_f: np.ndarray) -> tuple[Simulation, np.ndarray]:
    """One step from rest with a joint force; the bodies' accelerations (linear, angular)."""
    sim = simulate(builder)
    set_control(sim, joint_f=joint_f)
    sim.step()
    return sim, sim.velocity / sim.dt


def about_anchor(sim: Simulation, body: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A body's inertia about its inbound anchor, world axes, and the arm from there to the COM."""
    arm = sim.center[body] - anchor_frames(sim)[2][body]
    steiner = sim.mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return sim.world_inertia[body] + steiner, arm


def body_without_gravity() -> tuple[newton.ModelBuilder, int]:
    """A builder with one body whose COM is beside its origin and its anchor."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    return builder, add_link(builder, mass=MASS, com=COM)


def test_a_force_on_a_slider_acts_along_its_axis() -> None:
    """f / m along the axis in the parent's anchor frame, at the COM as elsewhere; no rotation."""
    builder, body = body_without_gravity()
    builder.add_articulation([builder.add_joint_prismatic(WORLD, body, axis=tuple(AXIS), **FRAMES)])
    _, acceleration = kick(builder, [30.0])
    expected = TURN_P.apply(AXIS) * 30.0 / MASS
    assert acceleration[0, :3] == pytest.approx(expected, abs=FIRST_STEP * 15.0)
    assert np.abs(acceleration[0, 3:]).max() < FIRST_STEP * 15.0


def test_a_torque_on_a_hinge_acts_about_its_axis() -> None:
    """torque / I about the axis through the anchor; the COM follows on its arm."""
    builder, body = body_without_gravity()
    builder.add_articulation([builder.add_joint_revolute(WORLD, body, axis=tuple(AXIS), **FRAMES)])
    sim, acceleration = kick(builder, [5.0])
    inertia, arm = about_anchor(sim)
    axis = TURN_P.apply(AXIS)
    spin = axis * 5.0 / (axis @ inertia @ axis)
    size = np.linalg.norm(spin)
    assert acceleration[0, 3:] == pytest.approx(spin, abs=FIRST_STEP * size)
    assert acceleration[0, :3] == pytest.approx(np.cross(spin, arm), abs=FIRST_STEP * size)


def test_a_torque_on_a_ball_joint_is_one_in_the_parents_anchor_frame() -> None:
    """I^-1 of the turned torque; not of the torque as it stands, which differs by half of it."""
    builder, body = body_without_gravity()
    builder.add_articulation([builder.add_joint_ball(WORLD, body, **FRAMES)])
    torque = np.array([3.0, -2.0, 5.0])
    sim, acceleration = kick(builder, torque)
    inertia, arm = about_anchor(sim)
    spin = np.linalg.solve(inertia, TURN_P.apply(torque))
    size = np.linalg.norm(spin)
    assert acceleration[0, 3:] == pytest.approx(spin, abs=FIRST_STEP * size)
    assert acceleration[0, :3] == pytest.approx(np.cross(spin, arm), abs=FIRST_STEP * size)


@pytest.mark.parametrize("kind", ["free", "distance", "rod"])
def test_a_wrench_on_a_free_body_is_one_in_the_world_at_the_com(kind: str) -> None:
    """f / m and I^-1 torque, however the anchor frames are turned, for the three 6-dof types.

    The string is slack and the rod has no stiffness.
    """
    builder, body = body_without_gravity()
    if kind == "free":
        joint = builder.add_joint_free(body, **FRAMES)
    elif kind == "distance":
        joint = builder.add_joint_distance(WORLD, body, max_distance=5.0, **FRAMES)
    else:
        joint = builder.add_joint_rod(WORLD, body, stretch_stiffness=0.0, **FRAMES)
    builder.add_articulation([joint])
    wrench = np.array([10.0, -20.0, 30.0, 0.1, 0.2, -0.3])
    sim, acceleration = kick(builder, wrench)
    spin = np.linalg.solve(sim.world_inertia[0], wrench[3:])
    assert acceleration[0, :3] == pytest.approx(wrench[:3] / MASS, abs=FIRST_STEP * 15.0)
    assert acceleration[0, 3:] == pytest.approx(spin, abs=FIRST_STEP * np.linalg.norm(spin))


@pytest.mark.parametrize("is_enabled", [True, False])
@pytest.mark.parametrize("kind", ["free", "distance", "rod"])
def test_a_wrench_between_two_bodies_acts_on_both(kind: str, is_enabled: bool) -> None:
    """On the child at its COM, with the opposite on the parent; not where the joint is off.

    The string is slack and the rod has no stiffness, so that bodies do not feel each other else.
    """
    builder, parent = body_without_gravity()
    child = add_link(builder, mass=1.0, com=(-0.05, 0.1, 0.0), inertia=1.3 * TENSOR[::-1, ::-1])
    base = builder.add_joint_free(parent)
    settings = {"parent": parent, "child": child, "enabled": is_enabled, **FRAMES}
    if kind == "free":
        joint = builder.add_joint_free(**settings)
    elif kind == "distance":
        joint = builder.add_joint_distance(max_distance=5.0, **settings)
    else:
        joint = builder.add_joint_rod(stretch_stiffness=0.0, **settings)
    builder.add_articulation([base, joint])
    wrench = np.array([10.0, -20.0, 30.0, 0.1, 0.2, -0.3])
    sim, acceleration = kick(builder, [*np.zeros(6), *wrench])
    if not is_enabled:
        assert np.abs(acceleration).max() == 0.0
        return
    arm = sim.center[child] - sim.center[parent]
    torque = wrench[3:] + np.cross(arm, wrench[:3])
    expected = [
        [*-wrench[:3] / MASS, *np.linalg.solve(sim.world_inertia[0], -torque)],
        [*wrench[:3], *np.linalg.solve(sim.world_inertia[1], wrench[3:])],
    ]
    for found, known in zip(acceleration, np.array(expected), strict=True):
        assert found[:3] == pytest.approx(known[:3], abs=FIRST_STEP * 30.0)
        assert found[3:] == pytest.approx(known[3:], abs=FIRST_STEP * np.linalg.norm(known[3:]))


def test_all_joints_of_a_body_push_it() -> None:
    """A FREE joint and two slack strings on one body: their wrenches add up."""
    builder, body = body_without_gravity()
    free = builder.add_joint_free(body)
    builder.add_articulation([free])
    builder.add_joint_distance(WORLD, body, max_distance=5.0, **FRAMES)
    builder.add_joint_distance(WORLD, body, max_distance=6.0, **FRAMES)
    wrenches = np.array(
        [[10, -20, 30, 0.1, 0.2, -0.3], [5, 5, -7, 0.4, 0, 0.1], [-8, 2, 1, 0, 0, 0.5]]
    )
    sim, acceleration = kick(builder, wrenches.ravel())
    total = wrenches.sum(axis=0)
    spin = np.linalg.solve(sim.world_inertia[0], total[3:])
    assert acceleration[0, :3] == pytest.approx(total[:3] / MASS, abs=FIRST_STEP * 15.0)
    assert acceleration[0, 3:] == pytest.approx(spin, abs=FIRST_STEP * np.linalg.norm(spin))


def test_forces_on_the_sliders_of_a_d6_joint_act_along_their_axes() -> None:
    """Two linear axes, displaced: each force along its axis, in the parent's anchor frame."""
    builder, body = body_without_gravity()
    axes = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    joint = builder.add_joint_d6(
        WORLD, body, linear_axes=[Dof(axis=tuple(a)) for a in axes], **FRAMES
    )
    builder.add_articulation([joint])
    set_coordinates(builder, joint, (0.3, -0.2))
    _, acceleration = kick(builder, [30.0, -10.0])
    expected = TURN_P.apply(30.0 * axes[0] - 10.0 * axes[1]) / MASS
    assert acceleration[0, :3] == pytest.approx(expected, abs=FIRST_STEP * 15.0)
    assert np.abs(acceleration[0, 3:]).max() < FIRST_STEP * 15.0


def test_torques_on_a_turned_d6_joint_do_work_on_its_angles() -> None:
    """Three angles at (0.3, -0.5, 0.4): torque k does its work on angle k alone.

    The axes are carried along: x, then y turned by the first angle, then z by the first two. The
    torque in the parent's frame is that whose product with axis k is torque k.
    """
    builder, body = body_without_gravity()
    joint = builder.add_joint_d6(
        WORLD, body, angular_axes=[Dof(axis=a) for a in ((1, 0, 0), (0, 1, 0), (0, 0, 1))], **FRAMES
    )
    builder.add_articulation([joint])
    angles = np.array([0.3, -0.5, 0.4])
    set_coordinates(builder, joint, angles)
    torque = np.array([3.0, -2.0, 5.0])
    sim, acceleration = kick(builder, torque)
    one = Rotation.from_rotvec([angles[0], 0.0, 0.0])
    two = one * Rotation.from_rotvec([0.0, angles[1], 0.0])
    axes = np.array([[1.0, 0.0, 0.0], one.apply([0.0, 1.0, 0.0]), two.apply([0.0, 0.0, 1.0])])
    inertia, _ = about_anchor(sim)
    spin = np.linalg.solve(inertia, TURN_P.apply(np.linalg.solve(axes, torque)))
    assert acceleration[0, 3:] == pytest.approx(spin, abs=FIRST_STEP * np.linalg.norm(spin))


def test_a_torque_between_two_bodies_acts_on_both() -> None:
    """Two floating links on a hinge: no momentum arises, and the accelerations are those of the

    equations of motion with the hinge's five rows, solved here as a dense system.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    first = add_link(builder, mass=MASS, com=COM)
    second = add_link(builder, mass=1.0, com=(-0.05, 0.1, 0.0), inertia=1.3 * TENSOR[::-1, ::-1])
    base = builder.add_joint_free(first)
    hinge = builder.add_joint_revolute(first, second, axis=tuple(AXIS), **FRAMES)
    builder.add_articulation([base, hinge])
    set_coordinates(builder, hinge, [0.4])
    torque = 5.0
    sim, acceleration = kick(builder, [*np.zeros(6), torque])
    parent, turn_p, _, _ = anchor_frames(sim)
    axis = turn_p[hinge].apply(AXIS)
    sides = np.linalg.svd(axis[None])[2][1:]
    mass = np.zeros((12, 12))
    rows, force = np.zeros((5, 12)), np.zeros(12)
    for i, sign in ((0, -1.0), (1, 1.0)):
        k = 6 * i
        mass[k : k + 3, k : k + 3] = sim.mass[i] * np.eye(3)
        mass[k + 3 : k + 6, k + 3 : k + 6] = sim.world_inertia[i]
        x, y, z = parent[hinge] - sim.center[i]
        rows[:3, k : k + 3] = sign * np.eye(3)
        rows[:3, k + 3 : k + 6] = -sign * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        rows[3:, k + 3 : k + 6] = sign * sides
        force[k + 3 : k + 6] = sign * torque * axis
    system = np.block([[mass, rows.T], [rows, np.zeros((5, 5))]])
    expected = np.linalg.solve(system, [*force, *np.zeros(5)])[:12].reshape(2, 6)
    size = np.abs(expected).max()
    assert acceleration == pytest.approx(expected, abs=FIRST_STEP * size)
    assert np.abs(sim.mass @ acceleration[:, :3]).max() < 1.0e-5 * size


def row_of_boxes(count: int, **joint: object) -> Simulation:
    """Links of 0.5 m along +x, welded end to end and to the world."""
    builder = newton.ModelBuilder()
    parent, joints = WORLD, []
    for mass in np.linspace(1.0, 2.0, count):
        body = add_link(builder, mass=mass)
        at = (0.0, 0.0, 1.0) if parent == WORLD else (0.25, 0.0, 0.0)
        joints.append(
            builder.add_joint_fixed(
                parent,
                body,
                parent_xform=transform(at),
                child_xform=transform((-0.25, 0.0, 0.0)),
            )
        )
        parent = body
    builder.add_articulation(joints)
    return simulate(builder)


def test_a_hanging_pendulum_pulls_with_its_weight() -> None:
    """(0, 0, m g), no torque about its COM: the anchor is right above it. Within 1e-4 of m g.

    Newton's own tests use this bound; it holds in the first step and at rest.
    """
    builder = newton.ModelBuilder()
    body = add_link(builder, mass=MASS)
    joint = builder.add_joint_revolute(
        WORLD,
        body,
        parent_xform=transform((5, 3, -2)),
        child_xform=transform((0, 0, 1)),
        axis=(0, 1, 0),
    )
    builder.add_articulation([joint])
    sim = simulate(builder)
    observables = sim.observe(PARENT_F)
    for steps in (1, 60):
        sim.step(steps)
        weight = MASS * G
        expected = [0.0, 0.0, weight, 0.0, 0.0, 0.0]
        assert observables.body_parent_f.numpy()[0] == pytest.approx(expected, abs=1.0e-4 * weight)


def test_a_cantilever_carries_what_is_beyond() -> None:
    """Each weld carries the weight of its link and of all beyond, and their moment about its COM.

    At rest the wrench from the parent and the loads beyond balance. Bound 1e-4 of what the root
    carries, force and moment.
    """
    sim = row_of_boxes(3)
    observables = sim.observe(PARENT_F)
    for steps in (1, 30):
        sim.step(steps)
        wrench = observables.body_parent_f.numpy().astype(float)
        x, weight = sim.center[:, 0], sim.mass * G
        for i in range(3):
            # a weight at d along x turns about y by + weight d: the joint by the opposite
            moment = -np.sum(weight[i + 1 :] * (x[i + 1 :] - x[i]))
            expected = [0.0, 0.0, weight[i:].sum(), 0.0, moment, 0.0]
            assert wrench[i] == pytest.approx(expected, abs=1.0e-4 * weight.sum())


def test_pushes_pass_through_the_joints() -> None:
    """A sideways push and a torque on the last link arrive at the root with opposite sign.

    The push of 10 N along y at 1 m from the root's COM: torque about z too. Within 1e-4 of the
    loads (weights included).
    """
    sim = row_of_boxes(3)
    observables = sim.observe(PARENT_F)
    sim.push(2, (0.0, 10.0, 0.0), (5.0, 0.0, 0.0))
    sim.step(2)
    x, weight = sim.center[:, 0], sim.mass * G
    moment = -np.sum(weight[1:] * (x[1:] - x[0]))
    expected = [0.0, -10.0, weight.sum(), -5.0, moment, -10.0]
    assert observables.body_parent_f.numpy()[0] == pytest.approx(
        expected, abs=1.0e-4 * weight.sum()
    )


@pytest.mark.parametrize("through", ["joint_f", "drive"])
def test_the_parents_wrench_includes_what_the_joint_is_driven_with(through: str) -> None:
    """A horizontal arm held by its drive or by ``joint_f``: (0, 0, m g) and no torque at the COM.

    Without the driven part the torque would be m g l, half of the weight here. The drive needs
    a sag of m g l / ke = 1e-4 rad to hold, hence 1e-3.
    """
    arm = 0.5
    builder = newton.ModelBuilder()
    body = add_link(builder, mass=MASS)
    gains = {"target_ke": 1.0e5, "target_kd": 1.0e3} if through == "drive" else {}
    joint = builder.add_joint_revolute(
        WORLD, body, child_xform=transform((-arm, 0, 0)), axis=(0, 1, 0), **gains
    )
    builder.add_articulation([joint])
    sim = simulate(builder)
    weight = MASS * G
    if through == "joint_f":
        set_control(sim, joint_f=[-weight * arm])
    observables = sim.observe(PARENT_F)
    sim.step(240 if through == "drive" else 1)
    assert abs(coordinates(sim)[0][0]) < 2.0e-4
    assert observables.body_parent_f.numpy()[0] == pytest.approx(
        [0.0, 0.0, weight, 0.0, 0.0, 0.0], abs=1.0e-3 * weight
    )


def test_a_free_body_gets_nothing_and_a_falling_chain_carries_nothing() -> None:
    """FREE joints transmit nothing, not even ``joint_f``; bodies falling alike pull on nothing."""
    builder = newton.ModelBuilder()
    first, second = add_link(builder), add_link(builder)
    base = builder.add_joint_free(first)
    hinge = builder.add_joint_revolute(first, second, axis=(0, 1, 0), **FRAMES)
    builder.add_articulation([base, hinge])
    sim = simulate(builder)
    observables = sim.observe(PARENT_F)
    sim.step(10)
    assert np.abs(observables.body_parent_f.numpy()).max() < 1.0e-4 * G
    set_control(sim, joint_f=[0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0])
    sim.step()
    assert np.abs(observables.body_parent_f.numpy()[0]).max() < 1.0e-6


@pytest.mark.filterwarnings("ignore:.*another joint already connects.*")
def test_the_wrenches_of_several_joints_add_up() -> None:
    """A plate on two ball joints to the world: together they carry its weight, without a torque."""
    builder = newton.ModelBuilder()
    plate = add_link(builder, mass=MASS)
    joints = [
        builder.add_joint_ball(
            WORLD, plate, parent_xform=transform((x, 0, 1)), child_xform=transform((x, 0, 0.2))
        )
        for x in (-0.4, 0.6)
    ]
    builder.add_articulation(joints[:1])
    sim = simulate(builder)
    observables = sim.observe(PARENT_F)
    sim.step(60)
    weight = MASS * G
    assert observables.body_parent_f.numpy()[0] == pytest.approx(
        [0.0, 0.0, weight, 0.0, 0.0, 0.0], abs=1.0e-3 * weight
    )


def test_a_turning_arm_is_pulled_towards_its_hinge() -> None:
    """m w^2 l along the arm, and the weight. Bound 3 %: directions are those of the end of step.

    (w dt is 2 %.) In the very first step from a velocity along the tangent it is half as much.
    """
    arm, speed = 1.0, 5.0
    builder = newton.ModelBuilder()
    body = add_link(builder, mass=MASS, inertia=(0.1, 0.1, 0.1))
    joint = builder.add_joint_revolute(
        WORLD, body, child_xform=transform((-arm, 0, 0)), axis=(0, 0, 1)
    )
    builder.add_articulation([joint])
    set_coordinates(builder, joint, qd=[speed])
    sim = simulate(builder)
    observables = sim.observe(PARENT_F)
    sim.step(10)
    speed = np.linalg.norm(sim.velocity[0, :3]) / arm
    wrench = observables.body_parent_f.numpy()[0]
    pull = MASS * speed**2 * arm
    assert wrench[:2] == pytest.approx(-pull * sim.pose[0, :2] / arm, abs=3.0e-2 * pull)
    assert wrench[2] == pytest.approx(MASS * G, rel=1.0e-3)
