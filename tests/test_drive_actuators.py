# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joint drives that an importer makes of position and velocity actuators act as those do."""

import mujoco
import newton
import numpy as np
import pytest
from newton.solvers import SolverMuJoCo
from numpy.typing import NDArray

from newton_avbd import SolverAVBD

DT = 0.0005
STEPS = 400
TARGET, SPEED = 0.7, 0.4
BODY = """<body name="{0}" pos="{1} 0 0"><joint name="{0}" axis="0 1 0" {2}/>
  <inertial pos=".3 0 0" mass="1" diaginertia=".02 .03 .04"/></body>"""
POSITION = '<position joint="{{0}}" kp="20" kv="2" {}/>'.format
AUTHORED = {
    "forcerange": ("", POSITION('forcerange="-.5 1"'), POSITION("")),
    "dampratio": ("", '<position joint="{0}" kp="20" dampratio="1"/>', POSITION("")),
    "armature": ("", POSITION('armature=".3"'), POSITION("")),
    "damping": ("", POSITION('damping="3"'), POSITION("")),
    "dampingpoly": ("", POSITION('damping="0 1 2"'), POSITION("")),
    "ctrlrange": ("", POSITION('ctrlrange="-.2 .3"'), POSITION("")),
    "reference": ('ref="-10"', POSITION('ctrlrange="-.2 .3"'), POSITION("")),
    "velocity": (
        "",
        '<velocity joint="{0}" kv="5" forcerange="-.2 .2" ctrlrange="-.3 .3" armature=".1"/>',
        '<velocity joint="{0}" kv="5"/>',
    ),
    "both": (
        "",
        '<position joint="{0}" kp="20" forcerange="-1 1"/>'
        '<velocity joint="{0}" kv="9" forcerange="-.4 .4" damping=".3"/>',
        '<position joint="{0}" kp="20"/><velocity joint="{0}" kv="9"/>',
    ),
    "one of both": (
        'actuatorfrcrange="-5 5"',
        '<position joint="{0}" kp="20" ctrlrange="-.2 .3"/><velocity joint="{0}" kv="2"/>',
        '<position joint="{0}" kp="20"/><velocity joint="{0}" kv="2"/>',
    ),
    "motor": (
        "",
        POSITION('forcerange="-.5 1"') + '<motor joint="{0}" gear="-2"/>',
        POSITION("") + '<motor joint="{0}" gear="-2"/>',
    ),
}
"""By name: a joint and what drives it, and the same without what it authors beyond gains."""


def text_of(authored: bool) -> str:
    """A hinge for each of them, side by side."""
    bodies, actuators = "", ""
    for i, (name, (joint, *drives)) in enumerate(AUTHORED.items()):
        bodies += BODY.format(name, i, joint)
        actuators += drives[not authored].format(name)
    return f"""<mujoco><option timestep="{DT}"><flag gravity="disable"/></option>
      <worldbody>{bodies}</worldbody><actuator>{actuators}</actuator></mujoco>"""


def turned_in_mujoco(authored: bool) -> NDArray[np.float64]:
    """Angles after 0.2 s in MuJoCo C, from the reference."""
    model = mujoco.MjModel.from_xml_string(text_of(authored))
    data = mujoco.MjData(model)
    is_velocity = (model.actuator_biasprm[:, 1] == 0.0) & (model.actuator_biasprm[:, 2] < 0.0)
    data.ctrl[:] = np.where(is_velocity, SPEED, TARGET)
    for i in range(model.nu):
        if is_velocity[i] or model.actuator_biasprm[i, 1] == 0.0:
            continue
        data.ctrl[i] += model.qpos0[model.actuator_trnid[i, 0]]
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
    return data.qpos - model.qpos0


def imported(text: str, worlds: int = 1) -> newton.Model:
    """As Newton's importer makes it by default, with actuators as joint drives."""
    one = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(one)
    one.add_mjcf(text)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    builder.replicate(one, worlds)
    return builder.finalize(device="cpu")


def test_drives_act_as_the_actuators_that_they_are() -> None:
    """What each authors makes 20 times as much of a difference as SolverAVBD is off."""
    model = imported(text_of(authored=True), worlds=2)
    gains = model.joint_target_kd.numpy().copy()
    solver = SolverAVBD(model, update_joint_state=True)
    state, control = model.state(), model.control()
    control.joint_target_q.fill_(TARGET)
    control.joint_target_qd.fill_(SPEED)
    control.mujoco.ctrl.fill_(TARGET)
    for _ in range(STEPS):
        solver.step(state, state, control, None, DT)
    q = state.joint_q.numpy().astype(float).reshape(2, -1)
    np.testing.assert_array_equal(q[0], q[1])
    np.testing.assert_array_equal(model.joint_target_kd.numpy(), gains)
    expected, plain = turned_in_mujoco(True), turned_in_mujoco(False)
    for i, name in enumerate(AUTHORED):
        off, difference = abs(q[0, i] - expected[i]), abs(expected[i] - plain[i])
        assert off < 0.05 * difference, f"{name}: {off} of {difference}"


def test_a_range_that_is_new_holds_once_the_solver_is_told() -> None:
    """Before, the scene does without actuators. The push is reported as what it is, once."""
    body = BODY.format("a", 0, "")
    model = imported(f"""<mujoco><worldbody>{body}</worldbody>
      <actuator>{POSITION("").format("a")}</actuator></mujoco>""")
    solver = SolverAVBD(model, update_joint_state=True)
    assert not solver.effects["actuators"].on
    model.mujoco.actuator_forcelimited.fill_(1)
    model.mujoco.actuator_forcerange.fill_((-0.5, 1.0))
    solver.notify_model_changed(int(newton.ModelFlags.ACTUATOR_PROPERTIES))
    assert not solver.effects["drives"].on
    state, control = model.state(), model.control()
    control.joint_target_q.fill_(TARGET)
    observables = solver.observables({solver.ObservableKind.QFRC_ACTUATOR})
    for most in (1.0, 0.25):
        model.mujoco.actuator_forcerange.fill_((-0.5, most))
        solver.step(state, state, control, None, DT, observables=observables)
        assert observables.qfrc_actuator.numpy()[0] == pytest.approx(most)
    places = len(solver._launch._places)
    for _ in range(4):
        solver.step(state, state, model.control(), None, DT)
    # nothing of a control of its own in each step is kept
    assert len(solver._launch._places) == places
    control.joint_target_q.fill_(np.nan)
    solver.step(state, state, control, None, DT)
    assert solver.status.held_steps.max() == 1


def test_modes_and_armature_beside_a_drive_that_is_an_actuator_are_live() -> None:
    """An ordinary drive, one with a force range and armature, and a mode that needs a call."""
    text = BODY.format("a", 0, "") + BODY.format("b", 1, "")
    drives = POSITION("").format("a") + POSITION('forcerange="-.5 1" armature=".1"').format("b")
    model = imported(f"""<mujoco><option><flag gravity="disable"/></option>
      <worldbody>{text}</worldbody>
      <actuator>{drives}</actuator></mujoco>""")
    solver = SolverAVBD(model, scheme="euler")
    state, control = model.state(), model.control()
    control.joint_target_q.fill_(TARGET)

    def gained() -> NDArray[np.float64]:
        before = state.body_qd.numpy()[:, 4].astype(float)
        solver.step(state, state, control, None, DT)
        return state.body_qd.numpy()[:, 4] - before

    inertia = 0.03 + 0.3**2
    pushed = np.array([20.0 * TARGET / inertia, 1.0 / (inertia + 0.1)]) * DT
    np.testing.assert_allclose(gained(), pushed, rtol=0.05)
    modes = model.joint_target_mode.numpy().copy()
    model.joint_target_mode.assign([int(newton.JointTargetMode.NONE), modes[1]])
    model.joint_armature.fill_(0.2)
    assert solver.unnoticed_changes() == []
    np.testing.assert_allclose(gained(), [0.0, DT / (inertia + 0.3)], rtol=0.05, atol=1e-6)
    model.joint_target_mode.fill_(int(newton.JointTargetMode.NONE))
    assert solver.unnoticed_changes() == ["actuators"]
    solver.notify_model_changed(int(newton.ModelFlags.JOINT_DOF_PROPERTIES))
    np.testing.assert_allclose(gained(), 0.0, atol=1e-6)
    # without actuators the drives are drives
    model.joint_target_mode.assign(modes)
    model.joint_armature.zero_()
    solver = SolverAVBD(model, scheme="euler", effects={"actuators": False})
    assert solver.effects["drives"].on
    state = model.state()
    np.testing.assert_allclose(gained(), 20.0 * TARGET / inertia * DT, rtol=0.05)


def test_what_the_drive_of_a_ball_joint_leaves_out_is_named() -> None:
    ball = BODY.format("a", 0, 'type="ball"')
    model = imported(f"""<mujoco><worldbody>{ball}</worldbody><actuator>
      <position name="hold" joint="a" kp="20" forcerange="-1 1"/></actuator></mujoco>""")
    with pytest.warns(UserWarning, match="'hold'.*BALL.*ctrl_direct=True"):
        SolverAVBD(model)
