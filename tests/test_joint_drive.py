# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Drives push with ke (target_q - q) + kd (target_qd - qd), taken at the end of the step."""

import newton
import numpy as np
import pytest
from helpers import NO_GRAVITY, G, Simulation, in_float32
from joint_scenes import (
    WORLD,
    add_hinge_chain,
    add_link,
    anchor_gaps,
    coordinates,
    euler_period,
    set_control,
    set_coordinates,
    simulate,
    swing_period,
    transform,
)
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.usefixtures("shared_kernels")

TURNED = Rotation.from_euler("xyz", [0.5, -0.8, 1.9])
GAINS = [(0.0, 5.0), (100.0, 0.0), (100.0, 3.0), (1.0e4, 20.0), (1.0e6, 0.0)]


def one_dof(
    kind: str, ke: float, kd: float, q: float, qd: float, **settings: str
) -> tuple[Simulation, float]:
    """A body of 2 kg on a turned slider or hinge without gravity, and what it weighs for its dof.

    The hinge runs through the COM, about a principal axis, so that the motion is linear.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    inertia = (0.2, 0.3, 0.4)
    body = add_link(builder, mass=2.0, inertia=inertia, com=(0.1, 0.2, 0.3))
    add = builder.add_joint_prismatic if kind == "slider" else builder.add_joint_revolute
    joint = add(
        WORLD,
        body,
        parent_xform=transform((1.0, 0.5, -0.3), TURNED),
        child_xform=transform((0.1, 0.2, 0.3)),
        axis=(0.0, 1.0, 0.0),
        target_ke=ke,
        target_kd=kd,
        actuator_mode=newton.JointTargetMode.POSITION_VELOCITY,
    )
    builder.add_articulation([joint])
    set_coordinates(builder, joint, [q], [qd])
    return simulate(builder, **settings), 2.0 if kind == "slider" else inertia[1]


@pytest.mark.parametrize(("ke", "kd"), GAINS)
@pytest.mark.parametrize("kind", ["slider", "hinge"])
def test_a_driven_dof_follows_the_implicit_law(kind: str, ke: float, kd: float) -> None:
    """v' = (M v + dt (ke (target - q) + kd target_v + f)) / (M + dt kd + dt^2 ke), q' = q + dt v'.

    The motion is linear, so one step solves it to rounding. Bound: 1e-4 of the largest speed in
    the first step, 1e-3 over 60 steps, for a drive that is 13 times as stiff as the step resolves
    as for one that swings.
    """
    q, v = 0.2, -0.5
    target, target_v, force = 0.35, 0.7, 1.5
    sim, inertia = one_dof(kind, ke, kd, q, v, scheme="euler")
    set_control(sim, joint_f=[force], joint_target_q=[target], joint_target_qd=[target_v])
    h = in_float32(sim.dt)
    scale = 0.0
    for step in range(60):
        pull = ke * (target - q) + kd * target_v + force
        v = (inertia * v + h * pull) / (inertia + h * kd + h * h * ke)
        q += h * v
        scale = max(scale, abs(v))
        sim.step()
        actual_q, actual_v = (x[0] for x in coordinates(sim))
        bound = 1.0e-4 if step == 0 else 1.0e-3
        assert actual_v == pytest.approx(v, abs=bound * scale)
        assert actual_q == pytest.approx(q, abs=bound * scale * max(step * h, 0.1))


@pytest.mark.parametrize("turn", [0.01, 0.19, 0.21, 0.9])
def test_a_hinge_follows_the_implicit_law_however_far_it_turns(turn: float) -> None:
    """As above, in a step of so many radians before the drive brakes it.

    Where a step starts, a series tells the angle up to 0.2 rad, and beyond that the pose does.
    Bound: 1e-5 of the speed, rounding of an angle of a radian.
    """
    ke, kd, q = 100.0, 3.0, 0.2
    h = in_float32(one_dof("hinge", ke, kd, q, 0.0)[0].dt)
    sim, inertia = one_dof("hinge", ke, kd, q, turn / h)
    set_control(sim, joint_target_q=[q], joint_target_qd=[0.0])
    sim.step()
    v = inertia * (turn / h) / (inertia + h * kd + h * h * ke)
    actual_q, actual_v = (x[0] for x in coordinates(sim))
    assert actual_v == pytest.approx(v, rel=1.0e-5)
    assert actual_q == pytest.approx(q + h * v, abs=1.0e-5 * turn + 1.0e-6)


@pytest.mark.parametrize("kind", ["slider", "hinge"])
def test_targets_are_read_live(kind: str) -> None:
    """A target that moves is followed; the drive halves its error in 14 ms, so 0.5 s is plenty."""
    sim, _ = one_dof(kind, 1.0e5, 2.0e3, 0.0, 0.0)
    for target in (0.3, -0.2):
        set_control(sim, joint_target_q=[target])
        sim.run(0.5)
        assert coordinates(sim)[0][0] == pytest.approx(target, abs=1.0e-3)


def test_gains_that_change_are_read_live() -> None:
    """``joint_target_ke`` and ``joint_target_kd`` of the model act from the next step on."""
    sim, inertia = one_dof("hinge", 50.0, 1.0, 0.2, 0.0)
    sim.model.joint_target_ke.assign([400.0])
    sim.model.joint_target_kd.assign([8.0])
    sim.solver.notify_model_changed(newton.ModelFlags.JOINT_DOF_PROPERTIES)
    sim.step()
    h = in_float32(sim.dt)
    expected = h * 400.0 * -0.2 / (inertia + h * 8.0 + h * h * 400.0)
    assert coordinates(sim)[1][0] == pytest.approx(expected, rel=1.0e-3)


def two_hinges(stiff: float, soft: float, **settings: str) -> Simulation:
    """Two links on parallel hinges with springs, each turned by 0.1 rad from its target."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    inertia = (0.02, 0.02, 0.02)
    upper, lower = (add_link(builder, inertia=inertia) for _ in range(2))
    first = builder.add_joint_revolute(
        WORLD, upper, child_xform=transform((-0.25, 0, 0)), axis=(0, 1, 0), target_ke=stiff
    )
    second = builder.add_joint_revolute(
        upper,
        lower,
        parent_xform=transform((0.25, 0, 0)),
        child_xform=transform((-0.25, 0, 0)),
        axis=(0, 1, 0),
        target_ke=soft,
    )
    builder.add_articulation([first, second])
    for joint in (first, second):
        set_coordinates(builder, joint, [0.1])
    return simulate(builder, **settings)


def test_a_stiff_drive_beside_a_soft_one_does_not_oscillate() -> None:
    """1e6 beside 1e2 N m/rad in a chain: the stiff one is home at once, the soft one swings.

    The stiff hinge then gives by what the soft spring's torque bends it, 1e-5 rad, and what its
    own start still rings: each step divides that by at least dt sqrt(ke / I), 8 and more here. The
    soft one swings as if the stiff one were a wall, period within 1 % of backward Euler's. With
    springs alone and no damping, energy never grows.
    """
    stiff, soft = 1.0e6, 1.0e2
    sim = two_hinges(stiff, soft, scheme="euler")
    inertia = 0.02 + 0.25**2
    angles, energies = [], []
    for _ in range(240):
        sim.step()
        q = coordinates(sim)[0]
        angles.append(q)
        energies.append(sim.kinetic_energy + 0.5 * (stiff * q[0] ** 2 + soft * q[1] ** 2))
    angles, energies = np.array(angles), np.array(energies)
    assert np.abs(angles[10:, 0]).max() < 1.0e-4
    assert np.all(np.diff(energies) < 1.0e-4 * energies[0])
    period = swing_period(angles[10:, 1], sim.dt)
    assert period == pytest.approx(euler_period(np.sqrt(soft / inertia), sim.dt), rel=1.0e-2)
    assert anchor_gaps(sim).max() < 1.0e-6


@pytest.mark.parametrize(("ke", "kd"), [(200.0, 20.0), (1.0e4, 150.0)])
def test_a_drive_holds_an_arm_against_gravity(ke: float, kd: float) -> None:
    """The sag of a horizontal arm balances its weight: ke sag = m g l cos(sag), within 1 %."""
    mass, arm = 1.0, 0.5
    builder = newton.ModelBuilder()
    body = add_link(builder, mass=mass)
    joint = builder.add_joint_revolute(
        WORLD,
        body,
        parent_xform=transform((0.0, 0.0, 1.0), TURNED),
        child_xform=transform((-arm, 0.0, 0.0), TURNED),
        axis=tuple(TURNED.inv().apply([0.0, 1.0, 0.0])),
        target_ke=ke,
        target_kd=kd,
    )
    builder.add_articulation([joint])
    sim = simulate(builder)
    sim.run(2.0)
    sag = coordinates(sim)[0][0]  # about +y: positive is downwards
    assert sag == pytest.approx(mass * G * arm * np.cos(sag) / ke, rel=1.0e-2)
    assert np.abs(sim.velocity).max() < 1.0e-4


def test_a_vertical_slider_sags_by_its_weight_over_the_stiffness() -> None:
    """ke sag = m g, within 1 %; gravity pulls along -q."""
    builder = newton.ModelBuilder()
    body = add_link(builder, mass=2.0)
    joint = builder.add_joint_prismatic(
        WORLD, body, axis=(0.0, 0.0, 1.0), target_q=0.3, target_ke=4000.0, target_kd=200.0
    )
    builder.add_articulation([joint])
    sim = simulate(builder)
    sim.run(2.0)
    assert coordinates(sim)[0][0] - 0.3 == pytest.approx(-2.0 * G / 4000.0, rel=1.0e-2)
    assert np.abs(sim.velocity).max() < 1.0e-4


@pytest.mark.parametrize("friction", [0.0, 1.0])
@pytest.mark.parametrize(("rate", "most", "cut_off"), [(60, 5.5, 0.1), (240, 3.0, 0.01)])
def test_drives_at_their_limits_settle(
    rate: int, most: float, cut_off: float, friction: float
) -> None:
    """Twelve motors of a body with four legs get other targets ten times a second, in two runs.

    Most are at an effort limit or a stop, and go from one to the other within a step. It settles in
    some five sweeps at 60 Hz (a hip turns by half a radian within a step, which takes Newton's
    method so many), in three at 240 Hz. Sweeps that only took the next piece of each axis went
    round without an end: with friction 99 % of the steps took more than ten sweeps at 60 Hz, 30 %
    at 240 Hz. Joints stay closed to the rounding of the poses.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    trunk = add_link(builder, mass=7.0, inertia=(0.03, 0.1, 0.11))
    joints = [builder.add_joint_free(trunk)]
    for x, y in ((0.2, 0.05), (0.2, -0.05), (-0.2, 0.05), (-0.2, -0.05)):
        parent, at = trunk, (x, y, 0.0)
        for axis, mass, limit, effort in (
            ((1.0, 0.0, 0.0), 0.7, 1.0, 24.0),
            ((0.0, 1.0, 0.0), 1.1, 1.0, 24.0),
            ((0.0, 1.0, 0.0), 0.2, 0.26, 45.0),
        ):
            link = add_link(builder, mass=mass, inertia=mass * np.array([4e-3, 4e-3, 1e-3]))
            joints.append(
                builder.add_joint_revolute(
                    parent,
                    link,
                    parent_xform=transform(at),
                    child_xform=transform((0.0, 0.0, 0.1)),
                    axis=axis,
                    target_ke=1500.0,
                    target_kd=80.0,
                    effort_limit=effort,
                    limit_lower=-limit,
                    limit_upper=limit,
                    friction=friction,
                )
            )
            parent, at = link, (0.0, 0.0, -0.1)
    builder.add_articulation(joints)
    sweeps = []
    for seed in (0, 1):
        sim = simulate(builder, dt=1.0 / rate)
        rng = np.random.default_rng(seed)
        targets = np.zeros(19)
        for step in range(4 * rate):
            if step % (rate // 10) == 0:
                targets[7:] = rng.uniform(-1.0, 1.0, 12) * np.tile([1.0, 1.0, 0.26], 4)
                set_control(sim, joint_target_q=targets)
            sim.step()
            sweeps.append(int(sim.solver.report().sweeps[0]))
            assert anchor_gaps(sim)[1:].max() < 1.0e-6
    assert np.mean(sweeps) < most
    assert np.mean(np.array(sweeps) >= 10) < cut_off


def test_a_step_does_not_end_while_drives_pass_their_limits() -> None:
    """Eight links on a wall, whose drives get targets that they cannot reach, with 3 iterations.

    A sweep finds which drives meet their effort limits where it ends. The next one takes them
    there, also after the third: the step would end with forces beyond the limits otherwise, as one
    of five did. The last of such sweeps has an infinite update in the report.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    joints, parent = [], WORLD
    for number in range(8):
        link = add_link(builder, mass=1.0)
        joints.append(
            builder.add_joint_revolute(
                parent,
                link,
                parent_xform=transform((0.0 if parent == WORLD else 0.15, 0.0, 0.0)),
                child_xform=transform((-0.15, 0.0, 0.0)),
                axis=(0.0, 1.0, 0.0),
                target_ke=3.0e3,
                target_kd=30.0,
                effort_limit=2.0 * (8 - number),
            )
        )
        parent = link
    builder.add_articulation(joints)
    sim, rng = simulate(builder, dt=1.0 / 60.0, iterations=3), np.random.default_rng(0)
    for step in range(120):
        if step % 3 == 0:
            set_control(sim, joint_target_q=rng.uniform(-1.5, 1.5, 8))
        sim.step()
        assert np.isfinite(sim.solver.report().update[0])


@pytest.mark.parametrize(("friction", "most"), [(0.0, 6.0), (0.1, 8.0)])
def test_stiff_drives_of_a_chain_settle_at_their_limits(friction: float, most: float) -> None:
    """Twelve light links, whose drives go from one limit to the other within a milliradian.

    Updates of a radian pass many such limits, and the energy is least right behind one of them.
    Where the search along an update did not get so close, and was not kept up to the end of a step,
    energy went up and down: ten sweeps cut off 48 % of the steps, with friction 92 %.
    """
    builder = newton.ModelBuilder()
    count, rate = 12, 240
    add_hinge_chain(builder, count, masses=[0.1] * count)
    for joint in range(count):
        builder.joint_friction[joint] = friction
        builder.joint_target_mode[joint] = int(newton.JointTargetMode.POSITION)
        builder.joint_target_ke[joint], builder.joint_target_kd[joint] = 1.0e3, 50.0
        builder.joint_effort_limit[joint] = 10.0
    sim, rng, sweeps, unsettled = simulate(builder, dt=1.0 / rate), np.random.default_rng(0), [], 0
    for step in range(rate):
        if step % 24 == 0:
            set_control(sim, joint_target_q=rng.uniform(-0.5, 0.5, count))
        sim.step()
        report = sim.solver.report()
        sweeps.append(int(report.sweeps[0]))
        unsettled += not np.isfinite(report.update[0])
    assert np.mean(sweeps) < most
    assert unsettled < 0.1 * rate
