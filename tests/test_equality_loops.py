# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's equality constraints: importers make joints of them, which close loops."""

import newton
import numpy as np
import pytest
from helpers import G, Simulation
from joint_scenes import anchor_gaps, euler_period, simulate, swing_period

from newton_avbd import SolverAVBD

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


@pytest.mark.parametrize("speed", [0.1, 1.0])
def test_connect_and_weld_hold_a_four_bar_and_its_payload(speed: float) -> None:
    """Period of a parallelogram: 2 pi sqrt((2 I + M L^2)/((m + M) g L)), times 1 + a^2/16.

    I = m L^2/3 about the hinge; M is coupler and payload, which do not turn; a is the amplitude.
    To backward Euler's period within 1e-3; anchors within 1e-5 m, and the payload does not turn
    by 1e-4 rad.
    """
    sim = simulate(four_bar())
    kinds = sim.model.joint_type.numpy()[-2:]
    assert kinds.tolist() == [newton.JointType.BALL, newton.JointType.FIXED]
    assert np.all(sim.model.joint_articulation.numpy()[-2:] == -1)
    swing(sim, speed)
    held = sim.model.joint_type.numpy() != newton.JointType.FREE
    angles, gap, turn = [], 0.0, 0.0
    for _ in range(1200):
        sim.step()
        angles.append(2.0 * np.arcsin(sim.pose[0, 4]))
        gap = max(gap, anchor_gaps(sim)[held].max())
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


def test_a_constraint_that_is_switched_off_lets_go() -> None:
    """By ``equality_constraint_enabled`` and a notification, as in SolverMuJoCo, whichever joint it
    is: the payload falls freely, then the wrist opens, and both close again where that is asked.
    """
    sim = simulate(four_bar(), scheme="euler")
    enabled = sim.model.mujoco.equality_constraint_enabled
    swing(sim, 1.0)

    def switch(wrist: bool, strap: bool) -> np.ndarray:
        enabled.assign([wrist, strap])
        sim.solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)
        sim.step(24)
        return anchor_gaps(sim)[-2:]

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
    assert anchor_gaps(sim)[-2:].max() < 1e-4


def test_a_constraint_that_is_half_switched_or_moved_is_named() -> None:
    """One whose row is on and whose joint is off holds nothing; frames are those of the joint."""
    model = four_bar(weld='active="false"').finalize(device="cpu")
    solver = SolverAVBD(model, strict=True)
    rows = model.mujoco
    rows.equality_constraint_enabled.fill_(True)
    with pytest.raises(NotImplementedError, match=r"\('strap'\): enabled, .*model.joint_enabled"):
        solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)
    model.joint_enabled.fill_(True)
    solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)
    anchor = rows.equality_constraint_anchor.numpy()
    anchor[0] += 0.1
    rows.equality_constraint_anchor.assign(anchor)
    with pytest.raises(NotImplementedError, match=r"anchor or relpose of .*\('wrist'\).*joint_X_p"):
        solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)


def test_constraints_that_were_not_converted_are_named() -> None:
    """With the importer's option that makes joints of them; switched-off ones do not count."""
    model = four_bar(connect='active="false"', convert=False).finalize(device="cpu")
    message = (
        r"1 MuJoCo equality constraint \('strap'\).*convert_mjc_equality_constraints=True"
        r".*set_joint_mimic"
    )
    with pytest.warns(UserWarning, match=message):
        SolverAVBD(model)
    with pytest.raises(NotImplementedError, match=message):
        SolverAVBD(model, strict=True)


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
    T/I1 then. Within 1e-5.
    """
    builder = newton.ModelBuilder()
    builder.add_mjcf(GEAR)
    sim = simulate(builder)
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
