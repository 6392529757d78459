# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Mimic joints: a follower's coordinate is tied to its leader's, both ways."""

import newton
import numpy as np
import pytest
from helpers import Array, G, Simulation
from joint_scenes import (
    WORLD,
    add_hinge_chain,
    add_link,
    coordinates,
    set_control,
    set_coordinates,
    simulate,
    transform,
)
from scipy.integrate import solve_ivp

from newton_avbd import SolverAVBD

pytestmark = pytest.mark.usefixtures("shared_kernels")

HINGE = (0.0, 1.0, 0.0)


def misfit(sim: Simulation, leader: int, follower: int, offset: float, factor: float) -> float:
    """Largest deviation of two joints from q = offset + factor q_leader."""
    q = coordinates(sim)[0]
    start = sim.model.joint_q_start.numpy()
    of_leader = q[start[leader] : start[leader + 1]]
    of_follower = q[start[follower] : start[follower + 1]]
    return float(np.abs(of_follower - offset - factor * of_leader).max())


def axes(kind: str) -> dict[str, list[newton.ModelBuilder.JointDofConfig]]:
    """Axes of a D6 joint."""
    axis = newton.ModelBuilder.JointDofConfig
    return {
        "slide": {"linear_axes": [axis(axis=newton.Axis.X)]},
        "plane": {"linear_axes": [axis(axis=newton.Axis.X), axis(axis=newton.Axis.Y)]},
        "hinge": {"angular_axes": [axis(axis=newton.Axis.Y)]},
    }[kind]


def two_sliders(kind: str, masses: tuple[float, float], offset: float, factor: float) -> Simulation:
    """Two bodies on slides from the world; the second mimics the first."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    joints = []
    for i, mass in enumerate(masses):
        link = add_link(builder, mass=mass)
        at = transform((0.0, 0.0, float(i)))
        if kind == "prismatic":
            joint = builder.add_joint_prismatic(WORLD, link, parent_xform=at, axis=(1, 0, 0))
        else:
            joint = builder.add_joint_d6(WORLD, link, parent_xform=at, **axes(kind))
        joints.append(joint)
    builder.add_articulation(joints)
    dofs = builder.joint_qd_start[1] - builder.joint_qd_start[0]
    set_coordinates(builder, 1, q=[offset] * dofs)
    builder.set_joint_mimic(1, 0, coeffs=(offset, factor))
    return simulate(builder)


@pytest.mark.parametrize("kind", ["prismatic", "slide", "plane"])
@pytest.mark.parametrize("pushed", [0, 1])
def test_masses_on_slides_move_as_one_coordinate(kind: str, pushed: int) -> None:
    """(m1 + factor^2 m2) a = f1 + factor f2: a force on either moves both."""
    factor, offset, force = -2.0, 0.3, 5.0
    sim = two_sliders(kind, (1.0, 0.5), offset, factor)
    dofs = sim.model.joint_dof_count // 2
    push = np.zeros((2, dofs))
    push[pushed] = force
    set_control(sim, joint_f=push.ravel())
    sim.step(100)
    expected = force * (factor if pushed else 1.0) / (1.0 + factor**2 * 0.5) * 100 * sim.dt
    qd = coordinates(sim)[1].reshape(2, dofs)
    np.testing.assert_allclose(qd[0], expected, rtol=1e-5)
    np.testing.assert_allclose(qd[1], factor * expected, rtol=1e-5)
    assert misfit(sim, 0, 1, offset, factor) < 1e-6


@pytest.mark.parametrize("factor", [1.0, -3.0, 0.5])
@pytest.mark.parametrize("kind", ["revolute", "hinge"])
def test_geared_hinges_feel_the_reflected_inertia(factor: float, kind: str) -> None:
    """(I1 + factor^2 I2) alpha = tau1 + factor tau2."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    inertia = (0.02, 0.005)
    joints = []
    for i in range(2):
        link = add_link(builder, inertia=np.full(3, inertia[i]))
        at = transform((0.0, 0.0, float(i)))
        if kind == "revolute":
            joint = builder.add_joint_revolute(WORLD, link, parent_xform=at, axis=HINGE)
        else:
            joint = builder.add_joint_d6(WORLD, link, parent_xform=at, **axes(kind))
        joints.append(joint)
    builder.add_articulation(joints)
    builder.set_joint_mimic(1, 0, coeffs=(0.0, factor))
    sim = simulate(builder, scheme="euler")
    torque = np.array([0.03, 0.01])
    set_control(sim, joint_f=torque)
    sim.step(120)
    alpha = (torque[0] + factor * torque[1]) / (inertia[0] + factor**2 * inertia[1])
    turned = 0.5 * alpha * sim.dt**2 * 120 * 121
    qd = coordinates(sim)[1]
    # with a factor of -3 the torques cancel: what is left is rounding
    expected = alpha * 120 * sim.dt * np.array([1.0, factor])
    np.testing.assert_allclose(qd, expected, rtol=1e-4, atol=1e-8)
    turn = 2.0 * np.arctan2(sim.pose[:, 4], sim.pose[:, 6])
    wrapped = np.angle(np.exp(1j * (turn - turned * np.array([1.0, factor]))))
    np.testing.assert_allclose(wrapped, 0.0, atol=1e-4)


def falling_arm(length: float, mass: float, factor: float, start: float, dt: float) -> Array:
    """Angle of the shoulder [rad] every 1 ms for 0.4 s; the elbow turns by factor times that."""
    builder = newton.ModelBuilder()
    joints = add_hinge_chain(builder, 2, length=length, masses=[mass, mass])
    set_coordinates(builder, joints[0], q=[start])
    set_coordinates(builder, joints[1], q=[factor * start])
    builder.set_joint_mimic(joints[1], joints[0], coeffs=(0.0, factor))
    sim = simulate(builder, dt=dt, scheme="euler")
    seen: list[float] = []
    for _ in range(400):
        sim.run(1e-3)
        seen.append(coordinates(sim)[0][0])
        assert misfit(sim, joints[0], joints[1], 0.0, factor) < 1e-5
    return np.array(seen)


def test_an_arm_whose_elbow_follows_its_shoulder_is_a_pendulum_of_one_coordinate() -> None:
    """Against Lagrange's equation of that mechanism; the error falls in proportion to dt."""
    length, mass, factor, start = 0.2, 1.0, -2.0, 0.4
    inertia = mass / 12 * ((length / 4) ** 2 + length**2)

    def jacobian(q: float) -> Array:
        """Velocities of the two COM by a unit of qd; the links stand at q and (1 + factor) q."""
        first = np.array([-np.sin(q), -np.cos(q)])
        angle = (1.0 + factor) * q
        second = (1.0 + factor) * np.array([-np.sin(angle), -np.cos(angle)])
        return 0.5 * length * np.array([*first, *(2.0 * first + second)])

    def acceleration(q: float, qd: float) -> float:
        j = jacobian(q)
        rate = (jacobian(q + 1e-6) - jacobian(q - 1e-6)) / 2e-6
        whole = mass * j @ j + inertia * (1.0 + (1.0 + factor) ** 2)
        return float((-mass * G * (j[1] + j[3]) - mass * (j @ rate) * qd * qd) / whole)

    exact = solve_ivp(
        lambda _, y: [y[1], acceleration(*y)],
        (0.0, 0.4),
        [start, 0.0],
        t_eval=1e-3 * np.arange(1, 401),
        rtol=1e-10,
        atol=1e-12,
    ).y[0]
    error, finer = (
        np.abs(falling_arm(length, mass, factor, start, dt) - exact).max() for dt in (1e-3, 5e-4)
    )
    assert error < 1.5e-2
    assert finer == pytest.approx(0.5 * error, rel=0.05)


def test_a_limit_of_the_follower_stops_the_leader() -> None:
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    joints = []
    for i in range(2):
        link = add_link(builder)
        limits = {"limit_lower": -0.1, "limit_upper": 0.1} if i else {}
        joint = builder.add_joint_prismatic(
            WORLD, link, parent_xform=transform((0, 0, i)), axis=(1, 0, 0), **limits
        )
        joints.append(joint)
    builder.add_articulation(joints)
    builder.set_joint_mimic(1, 0, coeffs=(0.0, 0.5))
    sim = simulate(builder)
    set_control(sim, joint_f=[3.0, 0.0])
    sim.step(300)
    q, qd = coordinates(sim)
    np.testing.assert_allclose(q, [0.2, 0.1], atol=1e-5)
    np.testing.assert_allclose(qd, 0.0, atol=1e-4)


@pytest.mark.parametrize("factors", [(1.0, 1.6), (1.0, 1.6, 2.4), (1.0, 2.4, 1.6)])
def test_of_two_stops_that_one_sweep_reaches_the_mimic_leaves_the_nearer_one(
    factors: tuple[float, ...],
) -> None:
    """Geared wheels, each with a velocity limit of 0.5 rad/s, as the thumbs of Unitree's H1.

    A torque that alone would turn them by 4 rad/s in a step takes all to their limits at once. The
    fastest wheel is the only one that may be there; the others turn by their factors of it.
    """
    limit, torque = 0.5, 20.0
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    joints = []
    for i in range(len(factors)):
        link = add_link(builder, inertia=np.full(3, 0.02))
        at = transform((0.0, 0.0, float(i)))
        joints.append(
            builder.add_joint_revolute(
                WORLD, link, parent_xform=at, axis=HINGE, velocity_limit=limit
            )
        )
    builder.add_articulation(joints)
    for i, factor in enumerate(factors[1:], 1):
        builder.set_joint_mimic(joints[i], joints[0], coeffs=(0.0, factor))
    sim = simulate(builder)
    for way in (1.0, -1.0):
        set_control(sim, joint_f=[way * torque] * len(factors))
        for _ in range(30):
            sim.step()
            for i, factor in enumerate(factors[1:], 1):
                assert misfit(sim, joints[0], joints[i], 0.0, factor) < 1e-6
        qd = coordinates(sim)[1]
        expected = way * limit / max(factors) * np.array(factors)
        np.testing.assert_allclose(qd, expected, rtol=1e-4)


def test_a_gripper_in_the_middle_of_a_moving_tree_stays_symmetric() -> None:
    """Fingers on a falling, spinning palm; one is pushed by its joint force."""
    builder = newton.ModelBuilder()
    palm = add_link(builder, mass=2.0)
    joints = [builder.add_joint_free(palm)]
    for side in (1.0, -1.0):
        finger = add_link(builder, mass=0.2)
        joints.append(
            builder.add_joint_prismatic(
                palm, finger, parent_xform=transform((0.1 * side, 0, 0.2)), axis=(side, 0, 0)
            )
        )
    builder.add_articulation(joints)
    set_coordinates(builder, joints[0], qd=[0, 0, 0, 3.0, -1.0, 2.0])
    builder.set_joint_mimic(joints[2], joints[1], coeffs=(0.01, 1.0))
    set_coordinates(builder, joints[2], q=[0.01])
    sim = simulate(builder)
    force = np.zeros(sim.model.joint_dof_count)
    force[6] = -0.5
    set_control(sim, joint_f=force)
    before = sim.mass @ sim.velocity[:, :3]
    sim.step(120)
    assert misfit(sim, joints[1], joints[2], 0.01, 1.0) < 1e-5
    change = sim.mass @ sim.velocity[:, :3] - before
    fallen = -G * 2.4 * 120 * sim.dt
    np.testing.assert_allclose(change, [0.0, 0.0, fallen], atol=2e-4)


def test_a_mimic_that_starts_off_closes_without_gaining_speed() -> None:
    sim = two_sliders("prismatic", (1.0, 1.0), 0.0, 1.0)
    pose = sim.state.body_q.numpy()
    pose[1, 0] += 0.02
    sim.state.body_q.assign(pose)
    sim.step(2)
    assert misfit(sim, 0, 1, 0.0, 1.0) < 1e-5
    np.testing.assert_allclose(sim.velocity, 0.0, atol=1e-5)


def test_fingers_that_lie_at_their_stops_settle() -> None:
    """What holds a closed gripper is up to rounding: its stops, or the mimics between them.

    Where the stops let go and hold again, sweep by sweep, a step takes all ten. One step at rest
    takes one, and one more where a stop lets go.
    """
    builder = newton.ModelBuilder()
    hand = add_link(builder, mass=5.0, com=(0.1, 0.0, 0.0))
    drive = {"target_ke": 1000.0, "target_kd": 100.0}
    joints = [builder.add_joint_revolute(WORLD, hand, axis=HINGE, **drive)]
    limits = {"limit_lower": 0.0, "limit_upper": 0.5}
    fingers = []
    for i, way in enumerate((1.0, -1.0)):
        finger = add_link(builder, mass=0.1, inertia=(1e-4, 1e-4, 1e-4), com=(0.05, 0.0, 0.0))
        at = transform((0.1, 0.02 * i, 0.0))
        axis = (0.0, way, 0.0)
        joints.append(
            builder.add_joint_revolute(hand, finger, parent_xform=at, axis=axis, **limits, **drive)
        )
        fingers.append(finger)
    for finger, way in zip(fingers, (-1.0, 1.0), strict=True):
        tip = add_link(builder, mass=0.05, inertia=(1e-5, 1e-5, 1e-5), com=(0.02, 0.0, 0.0))
        at = transform((0.1, 0.0, 0.0))
        axis = (0.0, way, 0.0)
        joints.append(
            builder.add_joint_revolute(finger, tip, parent_xform=at, axis=axis, **limits, **drive)
        )
    builder.add_articulation(joints)
    for joint in joints[2:]:
        builder.set_joint_mimic(joint, joints[1])
    sim = simulate(builder)
    sim.step(60)
    sweeps = []
    for _ in range(60):
        sim.step()
        sweeps.append(int(sim.solver.report().sweeps[0]))
    assert max(sweeps) <= 2


def test_blocks_of_one_body_refuse_mimics() -> None:
    builder = newton.ModelBuilder()
    joints = add_hinge_chain(builder, 2)
    builder.set_joint_mimic(joints[1], joints[0])
    with pytest.raises(NotImplementedError, match="mimics joint 0"):
        simulate(builder, blocks="body")


CHAIN = ((1, 0, (0.125, -2.0)), (2, 1, (-0.25, 0.5)), (3, 2, (0.5, 3.0)))
"""Followers, leaders, and coefficients of four gears in a row."""
DIRECT = ((1, 0, (0.125, -2.0)), (2, 0, (-0.1875, -1.0)), (3, 0, (-0.0625, -3.0)))
"""The same with the first one for leader: q2 = -0.25 + 0.5 (0.125 - 2 q0), and so on; exact."""


def gears(links: tuple, is_sparse: bool, **settings: object) -> Simulation:
    """Four geared hinges without gravity, each with a torque of its own."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    joints = []
    for i in range(4):
        link = add_link(builder, inertia=np.full(3, 0.02 * (i + 1)))
        at = transform((0.0, 0.0, float(i)))
        joint = builder.add_joint_revolute(
            WORLD, link, parent_xform=at, axis=HINGE, label=f"gear{i}"
        )
        set_coordinates(builder, joint, q=[(0.25, -0.375, -0.4375, -0.8125)[i]])
        joints.append(joint)
    builder.add_articulation(joints)
    if is_sparse:
        with pytest.warns(DeprecationWarning):
            for follower, leader, (offset, factor) in links:
                builder.add_constraint_mimic(follower, leader, offset, factor)

    def make_solver(model: newton.Model, **settings: object) -> SolverAVBD:
        newton.eval_fk(model, model.joint_q, model.joint_qd, model)
        if not is_sparse:
            # a builder refuses chains; a model holds what is written to it
            leaders, coefficients = (
                model.joint_mimic_joint.numpy(),
                model.joint_mimic_coeffs.numpy(),
            )
            for follower, leader, coeffs in links:
                leaders[follower], coefficients[follower] = leader, coeffs
            model.joint_mimic_joint.assign(leaders)
            model.joint_mimic_coeffs.assign(coefficients)
        return SolverAVBD(model, **settings)

    sim = Simulation(builder, collide=False, make_solver=make_solver, **settings)
    set_control(sim, joint_f=[0.03, 0.01, -0.02, 0.05])
    return sim


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
def test_gears_that_others_turn_against_their_torque_turn_along(parallel: str) -> None:
    """Hinges to the world, from rest: w = sum(tau) t / sum(I), for each. What one gains is what
    the others are given: nothing else but the mimics ties them."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    joints = [
        builder.add_joint_revolute(WORLD, add_link(builder, inertia=np.full(3, 0.012)), axis=HINGE)
        for _ in range(4)
    ]
    builder.add_articulation(joints)
    for joint in joints[1:]:
        builder.joint_mimic_joint[joint] = joints[0]
        builder.joint_mimic_coeffs[joint] = (0.0, 1.0)
    sim = Simulation(builder, collide=False, parallel=parallel)
    set_control(sim, joint_f=[0.1, 0.2, -0.1, 0.3])
    sim.step(2)
    np.testing.assert_allclose(sim.velocity[:, 4], 0.5 * 2 * sim.dt / 0.048, rtol=1e-5)
    assert sim.solver.status.bounded_steps.sum() == 0


@pytest.mark.parametrize("is_sparse", [False, True])
def test_a_mimic_of_a_mimic_follows_the_first_leader(is_sparse: bool) -> None:
    """A chain moves as the same joints that follow its root: the same bits."""
    chain, direct = gears(CHAIN, is_sparse), gears(DIRECT, is_sparse)
    for sim in (chain, direct):
        sim.step(120)
    assert misfit(chain, 0, 3, -0.0625, -3.0) < 1.0e-6
    assert abs(coordinates(chain)[0][0] - 0.25) > 0.01  # it did turn
    np.testing.assert_array_equal(chain.pose, direct.pose)
    np.testing.assert_array_equal(chain.velocity, direct.velocity)


def test_a_chain_of_mimics_is_composed_anew_after_a_change() -> None:
    """Another multiplier in the middle reaches the last joint with notify_model_changed."""
    sim = gears(CHAIN, False)
    coefficients = sim.model.joint_mimic_coeffs.numpy()
    coefficients[2] = (-0.125, 1.0)  # q3 = 0.5 + 3 (-0.125 + 0.125 - 2 q0)
    sim.model.joint_mimic_coeffs.assign(coefficients)
    sim.solver.notify_model_changed(newton.ModelFlags.JOINT_PROPERTIES)
    sim.step(10)
    assert misfit(sim, 0, 3, 0.5, -6.0) < 1.0e-6


@pytest.mark.parametrize("is_sparse", [False, True])
@pytest.mark.parametrize("last", [0, 2])
def test_mimics_in_a_cycle_are_an_error_that_names_them(is_sparse: bool, last: int) -> None:
    """None of them leads. ``last`` is where the cycle closes."""
    links = ((3, 2, (0.0, 1.0)), (2, 1, (0.0, 1.0)), (1, 0, (0.0, 1.0)), (0, last, (0.0, 1.0)))
    with pytest.raises(ValueError, match=r"'gear0' -> .*'gear0'"):
        gears(links, is_sparse)
