# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a user changes between steps, and what the solver says of the joints after one."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, G, Simulation, in_float32
from joint_scenes import (
    WORLD,
    add_hinge_chain,
    add_link,
    anchor_frames,
    anchor_gaps,
    coordinates,
    set_control,
    set_coordinates,
    simulate,
    transform,
)
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

TURN_P = Rotation.from_euler("xyz", [0.5, -0.8, 1.9])
TURN_C = Rotation.from_euler("xyz", [-2.0, 0.4, 0.9])


def test_a_joint_that_is_switched_off_lets_go() -> None:
    """The lower of two hanging links falls freely from then on, and the upper one stays.

    Free fall is exact for backward Euler: v = g t within rounding. What the joint pushed before
    must not act any more.
    """
    builder = newton.ModelBuilder()
    joints = add_hinge_chain(builder, 2, length=0.5, base=(0.0, 0.0, 3.0))
    set_coordinates(builder, joints[0], [np.pi / 2])
    sim = simulate(builder, scheme="euler")
    sim.run(0.25)
    assert np.abs(sim.velocity).max() < 1.0e-5
    hanging = sim.pose
    sim.model.joint_enabled.assign([True, False])
    sim.solver.notify_model_changed(newton.ModelFlags.JOINT_PROPERTIES)
    steps = 120
    sim.step(steps)
    h = in_float32(sim.dt)
    assert sim.velocity[1] == pytest.approx([0, 0, -steps * h * G, 0, 0, 0], abs=1.0e-4)
    fallen = 0.5 * steps * (steps + 1) * h * h * G
    assert hanging[1, 2] - sim.pose[1, 2] == pytest.approx(fallen, abs=1.0e-4)
    assert sim.pose[0] == pytest.approx(hanging[0], abs=1.0e-5)


def test_a_joint_that_is_switched_on_again_holds() -> None:
    """Off for one step and on again, a hanging link is where it was, within what it fell."""
    builder = newton.ModelBuilder()
    joints = add_hinge_chain(builder, 2, length=0.5, base=(0.0, 0.0, 3.0))
    set_coordinates(builder, joints[0], [np.pi / 2])
    sim = simulate(builder)
    sim.run(0.1)
    for enabled in (False, True):
        sim.model.joint_enabled.assign([True, enabled])
        sim.solver.notify_model_changed(newton.ModelFlags.JOINT_PROPERTIES)
        sim.step()
    sim.run(0.5)
    assert anchor_gaps(sim).max() < 1.0e-6
    assert np.abs(sim.velocity).max() < 1.0e-3


@pytest.mark.parametrize("kind", ["fixed", "hinge"])
def test_a_kinematic_root_carries_its_child(kind: str) -> None:
    """The user moves the root along a circle; the child's anchor is with it after every step.

    Welded, the child's whole pose is; on a hinge along the way up it hangs from it and its
    angle stays free. Bounds: 1 % of the 5 mm and 13 mrad that the root moves in a step.
    """
    builder = newton.ModelBuilder()
    root = add_link(builder, is_kinematic=True)
    child = add_link(builder, mass=0.5)
    base = builder.add_joint_free(root)
    frames = {
        "parent_xform": transform((0.3, 0.1, 0.0), TURN_P),
        "child_xform": transform((-0.2, 0.0, 0.1), TURN_C),
    }
    if kind == "fixed":
        joint = builder.add_joint_fixed(root, child, **frames)
    else:
        joint = builder.add_joint_revolute(root, child, axis=(0.0, 0.0, 1.0), **frames)
    builder.add_articulation([base, joint])
    set_coordinates(builder, base, (0.2, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0))
    sim = simulate(builder)
    for step in range(240):
        phase = 2.0 * np.pi * step / 240
        pose, velocity = sim.state.body_q.numpy(), sim.state.body_qd.numpy()
        pose[root, :3] = [0.2 * np.cos(phase), 0.2 * np.sin(phase), 0.5]
        pose[root, 3:] = Rotation.from_rotvec([0.0, 0.0, 0.5 * np.sin(phase)]).as_quat()
        velocity[root] = (
            2.0
            * np.pi
            * np.array(
                [-0.2 * np.sin(phase), 0.2 * np.cos(phase), 0.0, 0.0, 0.0, 0.5 * np.cos(phase)]
            )
        )
        sim.state.body_q.assign(pose)
        sim.state.body_qd.assign(velocity)
        sim.step()
        assert sim.pose[root] == pytest.approx(pose[root], abs=1.0e-7)
        assert anchor_gaps(sim)[joint] < 5.0e-5
        if kind == "fixed":
            _, turn_p, _, turn_c = anchor_frames(sim)
            assert (turn_p.inv() * turn_c).magnitude()[joint] < 1.3e-4
    assert np.linalg.norm(sim.velocity[child, :3]) > 0.5  # carried along


def test_a_pendulum_on_a_base_that_speeds_up_is_of_second_order() -> None:
    """Its base, written where it is after a step and with the mean velocity until there, swings.

    It goes x = (1 - cos 4t)/4. In the frame of the base its acceleration adds to gravity:
    I theta'' = -m g l sin theta + m l x'' cos theta, whose solution scipy has.
    """
    length, inertia = 0.3, 0.12

    def way(t: float) -> float:
        return 0.25 * (1.0 - np.cos(4.0 * t))

    def swing(t: float, y: np.ndarray) -> list[float]:
        push = 4.0 * np.cos(4.0 * t) * np.cos(y[0]) - G * np.sin(y[0])
        return [y[1], push * length / inertia]

    expected = solve_ivp(swing, (0.0, 2.0), [0.3, 0.0], rtol=1e-10, atol=1e-10).y[0, -1]

    def error(rate: int) -> float:
        builder = newton.ModelBuilder()
        root = add_link(builder, is_kinematic=True)
        own = inertia - length**2
        bob = add_link(builder, inertia=(own, own, 0.01), com=(0.0, 0.0, -length))
        base = builder.add_joint_free(root)
        hinge = builder.add_joint_revolute(root, bob, axis=(0.0, 1.0, 0.0))
        builder.add_articulation([base, hinge])
        set_coordinates(builder, hinge, [0.3])
        sim = simulate(builder, dt=1.0 / rate)
        for i in range(2 * rate):
            there, pose = way((i + 1) / rate), sim.pose
            sim.set_velocity(root, ((there - way(i / rate)) * rate, 0.0, 0.0))
            pose[root, 0] = there
            sim.state.body_q.assign(pose.astype(np.float32))
            sim.step()
        turn = Rotation.from_quat(sim.pose[bob, 3:]).as_rotvec()
        return abs(turn[1] - expected)

    coarse, fine = error(60), error(240)
    assert coarse < 0.02
    assert fine < coarse / 12.0


def wheel(ke: float, kd: float, **settings: str) -> Simulation:
    """A body on a driven hinge through its COM, no gravity, joint state written."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    body = add_link(builder, inertia=(0.2, 0.25, 0.3))
    joint = builder.add_joint_revolute(
        WORLD,
        body,
        parent_xform=transform((0.1, 0.2, 0.3), TURN_P),
        axis=(0.0, 0.0, 1.0),
        target_ke=ke,
        target_kd=kd,
    )
    builder.add_articulation([joint])
    return simulate(builder, update_joint_state=True, **settings)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_angle_of_a_hinge_keeps_counting_turns(direction: float) -> None:
    """At 8 rad/s for 3.25 s, 4 turns: ``joint_q`` follows the closed form, without a jump.

    The drive takes the wheel up to speed as v' = (I v + dt kd target) / (I + dt kd). Bound 1e-3
    of a turn; ``joint_qd`` is the speed.
    """
    sim = wheel(0.0, 5.0, scheme="euler")
    target, inertia, h = direction * 8.0, 0.3, in_float32(sim.dt)
    set_control(sim, joint_target_qd=[target])
    q = v = 0.0
    for _ in range(780):
        v = (inertia * v + h * 5.0 * target) / (inertia + h * 5.0)
        q += h * v
        sim.step()
        assert sim.state.joint_q.numpy()[0] == pytest.approx(q, abs=1.0e-3 * 2.0 * np.pi)
        assert sim.state.joint_qd.numpy()[0] == pytest.approx(v, abs=1.0e-3 * 8.0)
    assert abs(q) > 4.0 * 2.0 * np.pi


def test_a_drive_reaches_a_target_beyond_half_a_turn() -> None:
    """Sent to 10 rad, it turns one and a half times and stays there, to 1e-3 rad."""
    sim = wheel(60.0, 8.0)
    set_control(sim, joint_target_q=[10.0])
    sim.run(3.0)
    assert sim.state.joint_q.numpy()[0] == pytest.approx(10.0, abs=1.0e-3)
    assert np.abs(sim.velocity).max() < 1.0e-2


def test_turns_are_counted_without_writing_the_joint_state() -> None:
    """The drive itself needs the turns: it reaches 10 rad where no joint state is written too."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    body = add_link(builder, inertia=(0.2, 0.25, 0.3))
    joint = builder.add_joint_revolute(
        WORLD, body, axis=(0.0, 0.0, 1.0), target_q=10.0, target_ke=60.0, target_kd=8.0
    )
    builder.add_articulation([joint])
    sim = simulate(builder, scheme="euler")
    turned = 0.0
    for _ in range(720):
        sim.step()
        turned += sim.dt * sim.velocity[0, 5]
    assert turned == pytest.approx(10.0, abs=1.0e-2)


def test_a_hinge_starts_at_the_turns_of_the_model() -> None:
    """From ``model.joint_q`` = 7 rad, a drive to 7 rad has nothing to do, and to 6 turns back."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    body = add_link(builder, inertia=(0.2, 0.25, 0.3))
    joint = builder.add_joint_revolute(
        WORLD, body, axis=(0.0, 0.0, 1.0), target_q=7.0, target_ke=60.0, target_kd=8.0
    )
    builder.add_articulation([joint])
    set_coordinates(builder, joint, [7.0])
    sim = simulate(builder, update_joint_state=True)
    sim.run(0.1)
    assert sim.state.joint_q.numpy()[0] == pytest.approx(7.0, abs=1.0e-5)
    assert np.abs(sim.velocity).max() < 1.0e-3
    set_control(sim, joint_target_q=[6.0])
    sim.run(2.0)
    assert sim.state.joint_q.numpy()[0] == pytest.approx(6.0, abs=1.0e-3)


def all_types() -> newton.ModelBuilder:
    """A floating body with an arm of one joint of each type."""
    Dof = newton.ModelBuilder.JointDofConfig
    builder = newton.ModelBuilder()
    frames = {
        "parent_xform": transform((0.3, 0.1, 0.0), TURN_P),
        "child_xform": transform((-0.2, 0.0, 0.1), TURN_C),
    }
    bodies = [add_link(builder, com=(0.02, 0.03, -0.05)) for _ in range(8)]
    joints = [
        builder.add_joint_free(bodies[0]),
        builder.add_joint_revolute(bodies[0], bodies[1], axis=(0.6, 0.3, -0.7), **frames),
        builder.add_joint_prismatic(bodies[1], bodies[2], axis=(0.6, 0.3, -0.7), **frames),
        builder.add_joint_ball(bodies[2], bodies[3], **frames),
        builder.add_joint_fixed(bodies[3], bodies[4], **frames),
        builder.add_joint_d6(
            bodies[4],
            bodies[5],
            linear_axes=[Dof(axis=(0, 0, 1))],
            angular_axes=[Dof(axis=(1, 0, 0)), Dof(axis=(0, 1, 0))],
            **frames,
        ),
        builder.add_joint_rod(
            bodies[5], bodies[6], stretch_stiffness=500.0, bend_stiffness=2.0, **frames
        ),
        builder.add_joint_distance(bodies[6], bodies[7], max_distance=0.3, **frames),
    ]
    builder.add_articulation(joints)
    set_coordinates(builder, joints[0], qd=(0.5, -0.3, 0.8, 0.4, 0.5, -0.6))
    set_coordinates(builder, joints[1], (0.4,), (0.8,))
    return builder


def test_the_joint_state_is_that_of_the_bodies() -> None:
    """With every type in one tree: ``joint_q`` and ``joint_qd`` are Newton's inverse kinematics.

    Which counts no turns.
    """
    sim = simulate(all_types(), update_joint_state=True)
    assert sim.solver.writes_joint_state
    sim.run(0.5)
    q, qd = coordinates(sim)
    off = np.remainder(sim.state.joint_q.numpy() - q + np.pi, 2.0 * np.pi) - np.pi
    assert np.abs(off).max() < 1.0e-5
    assert sim.state.joint_qd.numpy() == pytest.approx(qd, abs=1.0e-4)
    assert np.abs(q - sim.model.joint_q.numpy()).max() > 0.1


def test_the_joint_state_of_a_captured_step_is_that_of_an_eager_one() -> None:
    eager, replayed = (simulate(all_types(), update_joint_state=True) for _ in range(2))
    with wp.ScopedCapture(device="cpu") as capture:
        replayed.step(2)
    for _ in range(30):
        wp.capture_launch(capture.graph)
    eager.step(60)
    for name in ("body_q", "body_qd", "joint_q", "joint_qd"):
        found, expected = (getattr(sim.state, name).numpy() for sim in (replayed, eager))
        np.testing.assert_array_equal(found, expected)


def test_the_joint_state_is_left_alone_by_default() -> None:
    """As by Newton's other solvers of this kind; ``writes_joint_state`` says which it is."""
    sim = simulate(all_types())
    assert not sim.solver.writes_joint_state
    marks = np.full(sim.model.joint_coord_count, 5.0, dtype=np.float32)
    for state in (sim.state, sim._next):
        state.joint_q.assign(marks)
    sim.step(2)
    np.testing.assert_array_equal(sim.state.joint_q.numpy(), marks)


def test_a_reset_forgets_what_joints_pushed_and_how_often_they_turned() -> None:
    """After a reset the same run comes out again, bit for bit, drives beyond half a turn too."""
    sim = wheel(60.0, 8.0)
    set_control(sim, joint_target_q=[10.0])
    runs = []
    for _ in range(2):
        sim.run(0.3)
        runs.append(np.hstack([sim.state.body_q.numpy(), sim.state.body_qd.numpy()]))
        sim.solver.reset(sim.state)
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.abs(runs[0][0, 7:]).max() > 0.1


def test_a_step_in_place_is_the_same_step() -> None:
    """``state_in is state_out`` is allowed: Newton's loop examples step so."""
    a, b = simulate(all_types()), simulate(all_types())
    a.step(60)
    for _ in range(60):
        b.solver.step(b.state, b.state, b.control, None, b.dt)
    np.testing.assert_array_equal(a.state.body_q.numpy(), b.state.body_q.numpy())
    np.testing.assert_array_equal(a.state.body_qd.numpy(), b.state.body_qd.numpy())
