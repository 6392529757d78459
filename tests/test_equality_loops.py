# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's equality constraints CONNECT and WELD, with or without joints that an importer made."""

from pathlib import Path
from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, Simulation
from joint_scenes import add_link, anchor_gaps, euler_period, simulate, swing_period, transform
from newton.solvers import SolverMuJoCo, mujoco
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD
from newton_avbd.io.mjcf import add_mjcf
from newton_avbd.model.row_joints import RowJoints

pytestmark = pytest.mark.usefixtures("shared_kernels")

LENGTH, ROD, COUPLER, PAYLOAD = 0.5, 0.3, 0.8, 1.5
"""Of the four-bar: length of the two rods [m] and masses of its parts [kg]."""

FOUR_BAR = """
<mujoco>
  <compiler inertiafromgeom="false"/>
  <worldbody>
    <body name="left">
      <joint name="left" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 -0.25" mass="0.3" diaginertia="0.00625 0.00625 1e-5"/>
      <body name="coupler" pos="0 0 -0.5">
        <joint name="elbow" type="hinge" axis="0 1 0"/>
        <inertial pos="0.2 0 0" mass="0.8" diaginertia="0.01 0.01 0.01"/>
      </body>
    </body>
    <body name="right" pos="0.4 0 0">
      <joint name="right" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 -0.25" mass="0.3" diaginertia="0.00625 0.00625 1e-5"/>
    </body>
    <body name="payload" pos="0.1 0.2 -0.7">
      <freejoint/>
      <inertial pos="0 0 0" mass="1.5" diaginertia="0.01 0.02 0.03"/>
    </body>
  </worldbody>
  <equality>
    <connect name="wrist" body1="coupler" body2="right" anchor="0.4 0 0" {connect}/>
    <weld name="strap" body1="coupler" body2="payload" {weld}/>
    {more}
  </equality>
</mujoco>
"""
"""A parallelogram of two rods that hang side by side and a coupler, with a payload tied to it."""


def four_bar(
    *, connect: str = "", weld: str = "", more: str = "", convert: bool = True
) -> newton.ModelBuilder:
    """The four-bar with further attributes of its constraints, and further constraints."""
    builder = newton.ModelBuilder()
    text = FOUR_BAR.format(connect=connect, weld=weld, more=more)
    builder.add_mjcf(text, convert_mjc_equality_constraints=convert)
    return builder


def swing(sim: Simulation, speed: float) -> None:
    """Gives both rods an angular velocity [rad/s] about y; the coupler and payload translate."""
    for body in (0, 2):
        sim.set_velocity(body, (-0.5 * LENGTH * speed, 0.0, 0.0), (0.0, speed, 0.0))
    for body in (1, 3):
        sim.set_velocity(body, (-LENGTH * speed, 0.0, 0.0))


def row_gaps(sim: Simulation) -> np.ndarray:
    """How far the first two rows are from what they say [m], by their own anchors."""
    joints = RowJoints.of_model(sim.model, np.arange(2))
    ends = [
        sim.pose[link, :3] + Rotation.from_quat(sim.pose[link, 3:]).apply(frame[:, :3])
        for link, frame in (
            (joints.parent, joints.parent_frame),
            (joints.child, joints.child_frame),
        )
    ]
    return np.linalg.norm(ends[0] - ends[1], axis=1)


@pytest.mark.parametrize(("speed", "convert"), [(0.1, True), (1.0, True), (1.0, False)])
def test_connect_and_weld_hold_a_four_bar_and_its_payload(speed: float, convert: bool) -> None:
    """Period of a parallelogram: 2 pi sqrt((2 I + M L^2)/((m + M) g L)), times 1 + a^2/16.

    I = m L^2/3 about the hinge; M is coupler and payload, which do not turn; a is the amplitude.
    To backward Euler's period within 1e-3; anchors within 1e-5 m, and the payload does not turn
    by 1e-4 rad. With the joints that the importer makes of the rows, and without.
    """
    sim = simulate(four_bar(convert=convert), strict=True)
    kinds = sim.model.joint_type.numpy()[-2:]
    is_loop = sim.model.joint_articulation.numpy()[-2:] == -1
    if convert:
        assert kinds.tolist() == [newton.JointType.BALL, newton.JointType.FIXED]
        assert np.all(is_loop)
    else:
        assert not np.any(is_loop)
    swing(sim, speed)
    held = sim.model.joint_type.numpy() != newton.JointType.FREE
    angles, gap, turn = [], 0.0, 0.0
    for _ in range(1200):
        sim.step()
        angles.append(2.0 * np.arcsin(sim.pose[0, 4]))
        gap = max(gap, anchor_gaps(sim)[held].max(), row_gaps(sim).max())
        turn = max(turn, 2.0 * np.abs(sim.pose[3, 3:6]).max())
    mass = COUPLER + PAYLOAD
    inertia = 2.0 * (ROD * LENGTH**2 / 12 + ROD * (0.5 * LENGTH) ** 2) + mass * LENGTH**2
    omega = np.sqrt((ROD + mass) * G * LENGTH / inertia)
    period = euler_period(omega, sim.dt) * (1.0 + max(angles) ** 2 / 16)
    assert swing_period(np.array(angles), sim.dt) == pytest.approx(period, rel=1e-3)
    assert gap < 1e-5
    assert turn < 1e-4


def test_an_inactive_constraint_lets_go() -> None:
    """The payload whose weld is off falls freely; the rest of the loop holds."""
    sim = simulate(four_bar(weld='active="false"'), scheme="euler")
    sim.step(48)
    fall = 0.5 * G * 48 * 49 * sim.dt**2  # backward Euler
    assert sim.pose[3, 2] == pytest.approx(-0.7 - fall, rel=1e-5)
    assert anchor_gaps(sim)[-2] < 1e-5


@pytest.mark.parametrize("convert", [True, False])
def test_a_constraint_that_is_switched_off_lets_go(convert: bool) -> None:
    """By ``equality_constraint_enabled`` and a notification, as in SolverMuJoCo, whichever joint it
    is: the payload falls freely, then the wrist opens, and both close again where that is asked.
    """
    sim = simulate(four_bar(convert=convert), scheme="euler")
    enabled = sim.model.mujoco.equality_constraint_enabled
    swing(sim, 1.0)

    def switch(wrist: bool, strap: bool) -> np.ndarray:
        enabled.assign([wrist, strap])
        sim.solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)
        sim.step(24)
        return row_gaps(sim)

    height, rate = sim.pose[3, 2], sim.velocity[3, 2]
    wrist, strap = switch(wrist=True, strap=False)
    fall = 0.5 * G * 24 * 25 * sim.dt**2 - 24 * sim.dt * rate
    assert sim.pose[3, 2] == pytest.approx(height - fall, rel=1e-5)
    assert wrist < 1e-5
    assert strap > 0.01
    assert switch(wrist=False, strap=False)[0] > 0.01
    sim.run(0.2)
    switch(wrist=True, strap=True)
    sim.run(0.5)
    assert row_gaps(sim).max() < 1e-4


@pytest.mark.parametrize("convert", [True, False])
def test_a_constraint_that_is_moved_holds_elsewhere(convert: bool) -> None:
    """By ``equality_constraint_anchor`` and ``relpose`` and a notification, as in SolverMuJoCo.

    The wrist is held 0.1 m farther along the coupler, where its rods swing; the payload 0.05 m
    lower, and turned by 0.3 rad about z. Within 1e-4 m and 1e-3 rad after half a second.
    """
    sim = simulate(four_bar(convert=convert), scheme="euler")
    rows = sim.model.mujoco
    swing(sim, 1.0)
    sim.run(0.1)
    anchor, relpose = rows.equality_constraint_anchor, rows.equality_constraint_relpose
    anchor.assign(anchor.numpy() + np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    turned = transform((0.1, 0.2, -0.25), Rotation.from_rotvec((0.0, 0.0, 0.3)))
    relpose.assign([relpose.numpy()[0], turned])
    sim.solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)
    assert sim.solver.unnoticed_changes() == []
    assert row_gaps(sim)[1] > 0.04
    sim.run(0.5)
    assert row_gaps(sim).max() < 1e-4
    turn = Rotation.from_quat(sim.pose[1, 3:]).inv() * Rotation.from_quat(sim.pose[3, 3:])
    np.testing.assert_allclose(turn.as_rotvec(), (0.0, 0.0, 0.3), atol=1e-3)


def test_a_constraint_that_starts_inactive_is_switched_by_its_row_alone() -> None:
    """As in SolverMuJoCo, though the importer disables the joint that it makes of it, too.

    A joint that is disabled later lets go, and the row that is still enabled is named.
    """
    sim = simulate(four_bar(weld='active="false"'), scheme="euler", strict=True)
    rows, enabled = sim.model.mujoco, sim.model.joint_enabled.numpy().copy()
    assert enabled[-2:].tolist() == [True, False]
    rows.equality_constraint_enabled.fill_(True)
    sim.solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)
    sim.step(48)
    assert row_gaps(sim).max() < 1e-5
    enabled[-2] = False
    sim.model.joint_enabled.assign(enabled)
    with pytest.raises(NotImplementedError, match=r"\('wrist'\): enabled, .*model.joint_enabled"):
        sim.solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)


PLACED = """
<mujoco>
  <worldbody>
    <body name="a" pos="0.1 0.2 0.3" euler="20 40 60">
      <joint type="hinge"/><geom size="0.1"/>
    </body>
    <body name="b" pos="-0.3 0.4 0.5" euler="10 -50 30"><freejoint/><geom size="0.1"/></body>
  </worldbody>
  <equality>
    <connect body1="a" body2="b" anchor="0.1 0.2 0.3"/>
    <connect body1="b" anchor="0.1 -0.2 0.3"/>
    <weld body1="a" body2="b" anchor="0.1 0.2 0.3"/>
    <weld body1="a" body2="b" relpose="0.4 0.1 0.2 2 1 0.5 0" anchor="0.1 0 0.1"/>
    <weld body1="b" relpose="0.4 0.1 0.2 0.6 0 0.8 0"/>
    <weld body1="b" body2="a" torquescale="0"/>
  </equality>
</mujoco>
"""
"""Constraints of all kinds: between bodies and with the world, with and without a relpose."""


@pytest.mark.filterwarnings("ignore:.*another joint already connects")
def test_rows_say_the_same_as_the_joints_that_an_importer_makes_of_them() -> None:
    """Anchor frames within 1e-6. Where CONNECT is a BALL, frames differ by a turn."""
    models = []
    for convert in (True, False):
        builder = newton.ModelBuilder()
        builder.add_mjcf(PLACED, convert_mjc_equality_constraints=convert)
        models.append(builder.finalize(device="cpu"))
    joints = RowJoints.of_model(models[1], np.arange(6))
    kinds = models[0].joint_type.numpy()[-6:]
    is_ball = kinds == newton.JointType.BALL
    assert is_ball.tolist() == [True, True, False, False, False, True]
    np.testing.assert_array_equal(joints.type == newton.JointType.FIXED, ~is_ball)
    for name in ("parent", "child"):
        theirs = getattr(models[0], f"joint_{name}").numpy()[-6:]
        np.testing.assert_array_equal(getattr(joints, name), theirs)
    frames = [
        (joints.parent_frame, models[0].joint_X_p.numpy()[-6:]),
        (joints.child_frame, models[0].joint_X_c.numpy()[-6:]),
    ]
    turns = []
    for ours, theirs in frames:
        np.testing.assert_allclose(ours[:, :3], theirs[:, :3], atol=1e-6)
        turns.append([Rotation.from_quat(frame[~is_ball, 3:]) for frame in (ours, theirs)])
    between = [parent * child.inv() for parent, child in zip(*turns, strict=True)]
    np.testing.assert_allclose((between[0] * between[1].inv()).magnitude(), 0.0, atol=1e-6)


def pendulums(hold: str) -> newton.ModelBuilder:
    """Two pendulums of other lengths, each on a ball, held together at a point between them."""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    for x in (0.0, 0.6):
        link = add_link(builder, com=(0.05, 0.1 + x / 3.0, -0.25 - x / 6.0), mass=1.0 + x)
        builder.body_q[link] = at = transform((x, 0.0, 0.0))
        builder.add_articulation([builder.add_joint_ball(-1, link, parent_xform=at)])
    if hold == "joint":
        ends = [transform((x, 0.0, -0.5)) for x in (0.3, -0.3)]
        builder.add_joint_ball(0, 1, parent_xform=ends[0], child_xform=ends[1])
    elif hold == "row":
        mujoco.add_equality_connect(builder, 0, 1, anchor=wp.vec3(0.3, 0.0, -0.5))
    return builder


def test_a_row_that_a_program_adds_moves_as_a_ball_joint_and_in_mujoco() -> None:
    """Over 0.4 s at 1/2000 s: as a joint that closes the loop to 1e-6 m, and as MuJoCo's soft
    constraint within 2 % of how far the COM of the first pendulum moves."""
    sims = {hold: simulate(pendulums(hold), strict=True) for hold in ("joint", "row")}
    for sim in sims.values():
        sim.dt = 1.0 / 2000.0
        sim.run(0.4)
    center = sims["row"].center[0]
    motion = np.linalg.norm(center - [0.05, 0.1, -0.25])
    assert motion > 0.02
    np.testing.assert_allclose(sims["joint"].center[0], center, atol=1e-6)

    model = pendulums("row").finalize(device="cpu")
    theirs = SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True)
    state, control = model.state(), model.control()
    for _ in range(800):
        theirs.step(state, state, control, None, 1.0 / 2000.0)
    pose = state.body_q.numpy()[0]
    moved = pose[:3] + Rotation.from_quat(pose[3:]).apply((0.05, 0.1, -0.25))
    assert np.linalg.norm(moved - center) < 0.02 * motion


@pytest.mark.filterwarnings("ignore:.*stay MuJoCo equality constraints")
def test_a_constraint_that_no_joint_can_stand_for_holds_the_loop() -> None:
    """A JOINT constraint on a single joint stays MuJoCo's even with conversion, and acts.

    The four-bar hangs at an angle of 0.1 rad, although its start is off by that; the loop stays
    closed, and nothing is left out.
    """
    model = four_bar(more='<joint name="stop" joint1="left" polycoef="0.1 0 0 0 0"/>')
    sim = simulate(model, strict=True)
    sim.run(1.0)
    held = sim.model.joint_type.numpy() != newton.JointType.FREE
    assert 2.0 * np.arcsin(sim.pose[[0, 2], 4]) == pytest.approx([0.1, 0.1], abs=1e-5)
    assert anchor_gaps(sim)[held].max() < 1e-5
    assert np.abs(sim.velocity).max() < 1e-5


GEAR = """
<mujoco>
  <option gravity="0 0 0"/>
  <compiler inertiafromgeom="false"/>
  <worldbody>
    <body name="first">
      <joint name="first" type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
    </body>
    <body name="second" pos="1 0 0">
      <joint name="second" type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.2 0.2 0.2"/>
    </body>
  </worldbody>
  <equality>
    <joint name="gear" joint1="first" joint2="second" polycoef="0 -2 0 0 0"/>
  </equality>
</mujoco>
"""


def test_joint_equalities_are_gears() -> None:
    """q1 = -2 q2: a torque T on the first turns it with T/(I1 + I2/4), the second at -1/2 of it.

    Newton makes one of its deprecated mimic constraints of it, which follows by the row. Another
    ratio acts after a notification, and so does a row that is switched off: the first turns with
    T/I1 then. The row alone decides, as in SolverMuJoCo: the mimic is disabled. Within 1e-5.
    """
    builder = newton.ModelBuilder()
    builder.add_mjcf(GEAR)
    builder.constraint_mimic_enabled[0] = False
    sim = simulate(builder, strict=True)
    sim.push(0, torque=(0.0, 0.0, 0.5))
    spin = 0.0
    rows = sim.model.mujoco
    for ratio, enabled in ((-2.0, True), (4.0, True), (4.0, False)):
        rows.equality_constraint_polycoef.assign([[0.0, ratio, 0.0, 0.0, 0.0]])
        rows.equality_constraint_enabled.fill_(enabled)
        newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
        sim.solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)
        sim.step(24)
        share = 1.0 / ratio if enabled else 0.0
        spin = 0.5 / (0.1 + 0.2 * share**2) * 24 * sim.dt
        np.testing.assert_allclose(sim.velocity[:, 5], [spin, share * spin], rtol=1e-5, atol=1e-6)


@pytest.mark.filterwarnings("ignore:.*add_constraint_mimic")
def test_a_joint_that_follows_twice_is_named() -> None:
    """Sparse constraints may contradict each other; the solver takes one leader for each joint."""
    builder = newton.ModelBuilder()
    builder.add_mjcf(GEAR)
    builder.add_constraint_mimic(0, 1, label="again")
    with pytest.raises(
        ValueError, match=r"\('again'\) ties joint '.*first', which follows another"
    ):
        SolverAVBD(builder.finalize(device="cpu"))


ARM = """
<mujoco>
  <option gravity="0 0 0"/>
  <default><joint axis="0 1 0" damping="0.2"/><geom type="capsule" size="0.03"/></default>
  <worldbody>
    <body name="mark" mocap="true" pos="0.6 0 0"/>
    <body name="upper">
      <joint/><geom fromto="0 0 0 0.3 0 0.3"/>
      <body name="lower" pos="0.3 0 0.3">
        <joint/><geom fromto="0 0 0 0.3 0 -0.3"/>
        <body name="hand" pos="0.3 0 -0.3"><joint/><geom type="sphere"/></body>
      </body>
    </body>
  </worldbody>
  <equality><weld body1="{}" body2="{}"/></equality>
</mujoco>
"""
"""An arm in the x-z plane, of two links and a hand, welded to what a program moves."""
HOME, SPAN = np.array([0.6, 0.0, 0.0]), 2.0 * np.hypot(0.3, 0.3)
"""Where the hand starts, and how far it can be from the shoulder [m]."""
WEIGHT = """
<mujoco>
  <worldbody>
    <body name="mark" mocap="true"/>
    <body name="weight"><joint type="slide" axis="0 0 1"/><geom size="0.1"/></body>
  </worldbody>
  <equality><connect body1="mark" body2="weight" anchor="0 0 0" solimp="{d} {d} 0.001"/></equality>
</mujoco>
"""


def led(text: str, tmp_path: Path, **settings: Any) -> Simulation:
    """A scene of an MJCF file whose mocap bodies are kinematic."""
    path = tmp_path / "led.xml"
    path.write_text(text)
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    add_mjcf(builder, path)
    assert builder.body_flags[0] == int(newton.BodyFlags.KINEMATIC)
    return simulate(builder, **settings)


@pytest.mark.parametrize(
    ("ends", "settings"),
    [
        (("mark", "hand"), {}),
        (("mark", "hand"), {"dt": 1 / 60}),
        (("mark", "hand"), {"scheme": "euler"}),
        (("mark", "hand"), {"parallel": "bodies"}),
        (("hand", "mark"), {}),
        (("hand", "mark"), {"compliant_contacts": True}),
    ],
)
def test_a_weld_to_what_a_program_moves_goes_as_far_as_the_arm(
    tmp_path: Path, ends: tuple[str, str], settings: dict
) -> None:
    """The mark goes 1 m away, twice as far as the arm is long, waits, and comes back.

    The arm follows, ends within 1 mm of stretched towards it, and is as calm as the mark is slow: a
    rigid weld would turn links by hundreds of rad/s where the arm is straight.
    """
    sim = led(ARM.format(*ends), tmp_path, **settings)
    speed, fastest = 0.5, 0.0
    for way, seconds in ((1.0, 2.0), (0.0, 1.0), (-1.0, 2.0), (0.0, 1.0)):
        for _ in range(round(seconds / sim.dt)):
            pose, velocity = sim.pose, sim.velocity
            pose[0, 0] += way * speed * sim.dt
            velocity[0] = (way * speed, 0.0, 0.0, 0.0, 0.0, 0.0)
            sim.state.body_q.assign(pose)
            sim.state.body_qd.assign(velocity)
            sim.step()
            fastest = max(fastest, np.abs(sim.velocity[1:]).max())
            mark, hand = sim.pose[[0, -1], :3]
            if mark[0] < 0.9 * SPAN:
                assert np.linalg.norm(hand - mark) < 0.05
        if way > 0.0:
            assert mark[0] == pytest.approx(1.6, abs=1e-4)
        if way == 0.0 and mark[0] > 1.5:
            np.testing.assert_allclose(hand, (SPAN, 0.0, 0.0), atol=1e-3)
    assert fastest < 8.0
    np.testing.assert_allclose(hand, HOME, atol=1e-3)
    assert np.abs(sim.velocity).max() < 1e-2


@pytest.mark.parametrize("dt", [1 / 60, 1 / 240])
def test_a_weld_to_a_link_that_nothing_moves_pulls_an_arm_as_far_as_it_goes(dt: float) -> None:
    """Newton's importer fixes mocap bodies to the world: the arm stretches to one out of reach."""
    text = ARM.format("mark", "hand").replace("<weld", '<weld relpose="1 0 0 1 0 0 0"')
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text)
    assert builder.body_flags[0] == int(newton.BodyFlags.DYNAMIC)
    sim = simulate(builder, dt=dt)
    fastest = 0.0
    for _ in range(round(2.0 / dt)):
        sim.step()
        fastest = max(fastest, np.abs(sim.velocity[1:, :3]).max())
    # the way that is left in three time constants of the constraint
    assert fastest < 1.0 / 0.06
    np.testing.assert_allclose(sim.pose[-1, :3], (SPAN, 0.0, 0.0), atol=1e-3)
    assert np.abs(sim.velocity).max() < 1e-2


@pytest.mark.parametrize("impedance", [0.5, 0.95])
def test_what_a_program_moves_holds_as_softly_as_the_file_says(
    tmp_path: Path, impedance: float
) -> None:
    """A weight on a slide hangs from a mark by a CONNECT, which opens by (1 - d) g T^2/3.

    At rest d/((1 - d) A) k e = m g, with k = d/(d T)^2 of the time constant T and A = 1/(3 m), the
    mean over three directions, in two of which nothing moves the weight. As in MuJoCo.
    """
    sim = led(WEIGHT.format(d=impedance), tmp_path)
    sim.run(2.0)
    assert sim.pose[1, 2] == pytest.approx(-(1.0 - impedance) * G * 0.02**2 / 3.0, rel=1e-3)
    solver = SolverMuJoCo(sim.model, use_mujoco_cpu=True, disable_contacts=True)
    state = sim.model.state()
    for _ in range(480):
        solver.step(state, state, sim.control, None, sim.dt)
    assert sim.pose[1, 2] == pytest.approx(state.body_q.numpy()[1, 2], rel=1e-3)
