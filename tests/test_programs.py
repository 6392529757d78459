# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What programs for SolverMuJoCo use of Newton beside the solver: docs/from_mujoco.md."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY
from joint_scenes import WORLD, add_link
from newton.actuators import DrivePD, JointSpaceResponse
from newton.controllers import ControllerJointImpedance
from newton.selection import ArticulationView

from newton_avbd import SolverAVBD

INERTIA, DT = 0.3, 1.0 / 240.0
KP, KD, TARGET = 40.0, 3.0, 0.8


def wheel() -> newton.ModelBuilder:
    """A wheel without gravity, of 0.3 kg m^2 about its axis."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    joint = builder.add_joint_revolute(
        WORLD, add_link(builder, inertia=(0.2, 0.25, INERTIA)), axis=(0.0, 0.0, 1.0), label="wheel"
    )
    builder.add_articulation([joint], label="robot")
    return builder


@pytest.mark.parametrize("mode", ["explicit", "implicit"])
def test_actuators_of_newton_drive_a_joint(mode: str) -> None:
    """``newton.actuators`` read the joint state and write ``control.joint_f``; backward Euler.

    Explicit: I (v' - v) = h (kp (t - q) - kd v).
    Implicit: (I + h kd + h^2 kp) v' = I v + h kp (t - q).
    """
    builder = wheel()
    builder.add_actuator(DrivePD, index=0, kp=KP, kd=KD)
    model = builder.finalize(device="cpu")
    (actuator,) = model.actuators
    response = JointSpaceResponse(model)
    if mode == "implicit":
        actuator.set_effort_mode_implicit(response)
    solver = SolverAVBD(model, update_joint_state=True, scheme="euler")
    state, after, control = model.state(), model.state(), model.control()
    control.joint_target_q.fill_(TARGET)
    q = v = 0.0
    for _ in range(120):
        control.joint_f.zero_()
        if mode == "implicit":
            response.refresh(state)
            v = (INERTIA * v + DT * KP * (TARGET - q)) / (INERTIA + DT * KD + DT * DT * KP)
        else:
            v += DT / INERTIA * (KP * (TARGET - q) - KD * v)
        q += DT * v
        actuator.step(state, control, dt=DT)
        solver.step(state, after, control, None, DT)
        state, after = after, state
        # float32 over 120 steps
        assert state.joint_q.numpy()[0] == pytest.approx(q, abs=2.0e-5)
        assert state.joint_qd.numpy()[0] == pytest.approx(v, abs=2.0e-4)
    assert q > 0.5


def test_a_view_writes_joint_coordinates_of_chosen_worlds() -> None:
    """``newton.selection.ArticulationView``, masked, without ``eval_fk``: bodies follow."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    builder.replicate(wheel(), 3)
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, update_joint_state=True)
    state = model.state()
    view = ArticulationView(model, "robot")
    solver.step(state, state, None, None, DT)
    positions = np.full(view.get_dof_positions(state).shape, 0.6, dtype=np.float32)
    mask = wp.array([False, True, False], dtype=wp.bool)
    view.set_dof_positions(state, wp.array(positions), mask=mask)
    solver.step(state, state, None, None, DT)
    assert state.joint_q.numpy() == pytest.approx([0.0, 0.6, 0.0], abs=1.0e-6)
    turned = 2.0 * np.arctan2(state.body_q.numpy()[:, 5], state.body_q.numpy()[:, 6])
    assert turned == pytest.approx([0.0, 0.6, 0.0], abs=1.0e-6)


def test_the_torque_of_a_drive_is_its_law_at_the_end_of_the_step() -> None:
    """What ``qfrc_actuator`` has: I dv/dt = ke (target - q') - kd v'."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    joint = builder.add_joint_revolute(
        WORLD,
        add_link(builder, inertia=(0.2, 0.25, INERTIA)),
        axis=(0.0, 0.0, 1.0),
        target_q=TARGET,
        target_ke=KP,
        target_kd=KD,
    )
    builder.add_articulation([joint])
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, update_joint_state=True, scheme="euler")
    kinds = solver.ObservableKind
    observables = solver.observables({kinds.BODY_QDD, kinds.QFRC_ACTUATOR})
    state = model.state()
    for _ in range(20):
        solver.step(state, state, None, None, DT, observables=observables)
        q, v = state.joint_q.numpy()[0], state.joint_qd.numpy()[0]
        torque = INERTIA * observables.body_qdd.numpy()[0, 5]
        # at most 32 N m, of rounded velocities over the time step: 1e-7 / DT * INERTIA
        assert torque == pytest.approx(KP * (TARGET - q) - KD * v, abs=1.0e-3)
        assert torque == pytest.approx(observables.qfrc_actuator.numpy()[0], abs=1.0e-3)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_controller_of_newton_decouples_an_arm(scheme: str) -> None:
    """``newton.controllers`` compensates gravity, Coriolis forces and inertia: its law is left.

    q'' = kp (t - q) - kd v, constant in a step, which backward Euler ends with its whole velocity
    and second order with the mean one. The controller sees the start of the step: at 2 rad/s it is
    1 mrad off.
    """
    builder = newton.ModelBuilder()
    joints, parent = [], WORLD
    for k in range(2):
        link = add_link(builder, inertia=(0.02, 0.02, 0.02))
        below = wp.transform(wp.vec3(0.0, 0.0, -0.3 * k), wp.quat_identity())
        above = wp.transform(wp.vec3(0.0, 0.0, 0.15), wp.quat_identity())
        frames = {"parent_xform": below, "child_xform": above}
        joints.append(builder.add_joint_revolute(parent, link, axis=(0.0, 1.0, 0.0), **frames))
        parent = link
    builder.add_articulation(joints)
    builder.joint_target_mode[:] = [int(newton.JointTargetMode.EFFORT)] * 2
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, update_joint_state=True, scheme=scheme)
    state, control = model.state(), model.control()
    controller = ControllerJointImpedance(
        model,
        stiffness=wp.array([KP, KP], dtype=float),
        damping=wp.array([KD, KD], dtype=float),
        use_gravity_compensation=True,
        use_coriolis_compensation=True,
        use_inertia_decoupling=True,
    )
    given, found = controller.input(), controller.output()
    given.joint_q, given.joint_qd = state.joint_q, state.joint_qd
    targets = np.array([TARGET, -TARGET])
    given.joint_q_des.assign(targets.astype(np.float32))
    found.joint_f = control.joint_f[controller.qd_start]
    q, v = np.zeros(2), np.zeros(2)
    h = 5.0e-4
    for _ in range(400):
        controller.step(inputs=given, outputs=found, dt=h)
        solver.step(state, state, control, None, h)
        gain = h * (KP * (targets - q) - KD * v)
        v += gain
        q += h * (v if scheme == "euler" else v - 0.5 * gain)
        np.testing.assert_allclose(state.joint_q.numpy(), q, atol=2.0e-3)
    assert np.all(np.abs(q) > 0.3)
