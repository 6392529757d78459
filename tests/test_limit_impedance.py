# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""With compliant_contacts=True limits of MJCF files give way by solreflimit and solimplimit."""

import mujoco
import newton
import numpy as np
import pytest
from newton.solvers import SolverMuJoCo
from numpy.typing import NDArray

from newton_avbd import SolverAVBD

INERTIA = 0.5
"""Of the arm about its hinge [kg m^2]."""
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="hinge" axis="0 1 0" range="{range}" {limit}/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.3 0.5 0.4"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge"/></actuator>
</mujoco>
"""
CONSTANT = 'solreflimit="0.05 0.8" solimplimit="0.7 0.7 0.001 0.5 2"'
"""A limit whose impedance is 0.7 however far it is passed."""
D, B, K = 0.7, 2.0 / (0.7 * 0.05), 1.0 / (0.7 * 0.05 * 0.8) ** 2


def arm(limit: str = CONSTANT, ends: str = "0 2") -> newton.Model:
    """An arm on a hinge through its COM, without gravity."""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(ARM.format(range=ends, limit=limit), ctrl_direct=True)
    return builder.finalize(device="cpu")


def angles(
    model: newton.Model,
    torque: float,
    dt: float,
    steps: int,
    start: tuple[float, float] = (0.0, 0.0),
    **settings: object,
) -> NDArray[np.float64]:
    """Angle after each step."""
    given = {"compliant_contacts": True, "update_joint_state": True} | settings
    solver = SolverAVBD(model, **given)
    state, control = model.state(), model.control()
    control.mujoco.ctrl.fill_(torque)
    state.joint_q.fill_(start[0])
    state.joint_qd.fill_(start[1])
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    path = []
    for _ in range(steps):
        state.clear_forces()
        solver.step(state, state, control, None, dt)
        path.append(float(state.joint_q.numpy()[0]))
    return np.array(path)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
def test_a_limit_gives_way_to_a_load_by_its_impedance(parallel: str) -> None:
    """At rest (1 - d) tau/I = d^2 k r. Bound: rounding of the angle."""
    model = arm()
    q = angles(model, -3.0, 2.0e-3, 500, parallel=None if parallel == "worlds" else parallel)
    assert q[-1] == pytest.approx(-(1.0 - D) * 3.0 / INERTIA / (D * D * K), rel=1.0e-3)


@pytest.mark.parametrize(("scheme", "bound"), [("euler", 6.0e-5), ("generalized_alpha", 1.0e-5)])
def test_an_arm_beyond_its_limit_returns_by_the_reference(scheme: str, bound: float) -> None:
    """r'' = -d (b r' + d k r) from rest until it is back.

    Errors are 4.6e-5 and 6.5e-6; those of twice the step 9.0e-5 and 2.3e-5.
    """
    h, steps = 1.0e-3, 50
    q = angles(arm(), 0.0, h, steps, (-0.02, 0.0), scheme=scheme)
    roots = np.roots([1.0, D * B, D * D * K])
    first = np.linalg.solve(np.vander(roots, 2, increasing=True).T, [-0.02, 0.0])
    t = h * np.arange(1, steps + 1)
    exact = np.real(np.exp(np.outer(t, roots)) @ first)
    beyond = exact < 0.0
    np.testing.assert_allclose(q[beyond], exact[beyond], atol=bound)


def test_the_impedance_grows_with_how_far_the_limit_is_passed() -> None:
    """At rest the load is balanced by d(r)^2/(1 - d(r)) I k r, with MuJoCo's default curve."""
    q = angles(arm(""), -8.0, 2.0e-3, 300)[-1]
    x = min(-q / 0.001, 1.0)
    share = 2.0 * x * x if x <= 0.5 else 1.0 - 2.0 * (1.0 - x) ** 2
    d = 0.9 + share * 0.05
    k = 1.0 / (0.95 * 0.02) ** 2
    assert 0.0 < share < 1.0
    assert d * d / (1.0 - d) * INERTIA * k * -q == pytest.approx(8.0, rel=5.0e-3)


@pytest.mark.parametrize("on", ["joint", "tendon"])
def test_limits_whose_margins_overlap_both_push(on: str) -> None:
    """At rest (1 - d) tau/I = 2 d^2 k q: each pushes by how far it is passed, 0.2 rad where q is 0.

    With a range of 0.1 and a margin of 0.3 rad.
    """
    ends, has, tendon = "-0.1 0.1", f'margin="0.3" {CONSTANT}', ""
    if on == "tendon":
        tendon = f"""<tendon><fixed range="{ends}" {has}><joint joint="hinge" coef="1"/></fixed>
        </tendon>"""
        has = 'limited="false"'
    text = ARM.format(range=ends, limit=has).replace("<actuator>", f"{tendon}<actuator>")
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text, ctrl_direct=True)
    q = angles(builder.finalize(device="cpu"), 40.0, 2.0e-3, 300, (0.01, 0.0))
    assert q[-1] == pytest.approx((1.0 - D) * 40.0 / INERTIA / (2.0 * D * D * K), rel=1.0e-3)


def test_a_limit_does_not_hold_what_leaves_it() -> None:
    """A torque that pulls the arm back faster than the limit would is all that acts."""
    torque, h = 400.0, 1.0e-4
    q = angles(arm(), torque, h, 20, (-0.02, 0.0), scheme="euler")
    t = h * np.arange(1, 21)
    np.testing.assert_allclose(
        q, -0.02 + torque / (2.0 * INERTIA) * t * (t + h), atol=1.0e-6, rtol=1.0e-5
    )


def test_mujoco_agrees() -> None:
    """An arm thrown against its limit. Bound: the way of a step, by which either notices late."""
    model, h, steps = arm("", "-1 0.05"), 1.0e-4, 2000
    found = angles(model, 0.0, h, steps, (0.0, 3.0))
    native = SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True)
    state, control = model.state(), model.control()
    state.joint_qd.fill_(3.0)
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    path = []
    for _ in range(steps):
        native.step(state, state, control, None, h)
        path.append(float(native.mj_data.qpos[0]))
    assert max(path) > 0.055
    np.testing.assert_allclose(found, path, atol=3.0 * h)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_tendon_that_turns_gives_way_by_the_acceleration_of_its_joints(scheme: str) -> None:
    """A weight goes around a post, on a tendon that is beyond its range by r: v^2/R = d^2 K r.

    MuJoCo's limit leaves the acceleration v^2/R of the path itself out. With it the weight would
    stay where v^2/R = d^2 K r/(1 - d). Bound: r changes by 0.3 % as a step notices v late.
    """
    beyond = 0.02
    radius = 1.0 + beyond
    text = f"""<mujoco><option gravity="0 0 0"/><worldbody><site name="post"/>
    <body pos="{radius} 0 0"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
    <inertial pos="0 0 0" mass="2" diaginertia="0.3 0.5 0.4"/><site name="end"/></body></worldbody>
    <tendon><spatial range="0 1" {CONSTANT}><site site="post"/><site site="end"/></spatial></tendon>
    </mujoco>"""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text, ctrl_direct=True)
    model = builder.finalize(device="cpu")
    speed = D * np.sqrt(K * beyond * radius)
    solver = SolverAVBD(model, compliant_contacts=True, scheme=scheme)
    state, farthest = model.state(), []
    state.body_qd.assign([[0.0, speed, 0.0, 0.0, 0.0, 0.0]])
    for _ in range(400):
        solver.step(state, state, None, None, 5.0e-4)
        farthest.append(float(np.linalg.norm(state.body_q.numpy()[0, :2])) - 1.0)
    np.testing.assert_allclose(farthest, beyond, rtol=0.01)


MECHANISM = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0"/>
  <worldbody>
    <site name="post" pos="0.1 0.2 0.6"/>
    <body>
      <joint type="slide" axis="1 0 0" damping="0.1"/>
      <joint type="hinge" axis="0 1 0"/>
      <joint type="hinge" axis="0 0.6 0.8"/>
      <inertial pos="0.1 0.02 0" mass="1" diaginertia="0.03 0.05 0.04"/>
      <geom name="drum" type="cylinder" size="0.06 0.1" pos="0.2 0 0.05" euler="0.3 0.2 0"/>
      <body pos="0.3 0 0">
        <joint type="ball"/>
        <inertial pos="0.1 0 0.03" mass="0.5" diaginertia="0.01 0.02 0.03"/>
        <body pos="0.3 0 0">
          <joint type="hinge" axis="1 0 0"/>
          <inertial pos="0.05 0 0.03" mass="0.5" diaginertia="0.01 0.02 0.03"/>
          <site name="tip" pos="0.1 0.05 0.1"/>
        </body>
      </body>
    </body>
    <body pos="0.3 0.6 0.2">
      <freejoint/>
      <inertial pos="0.05 0 0.03" mass="0.5" diaginertia="0.01 0.02 0.03"/>
      <site name="end" pos="-0.1 0.05 0.1"/>
    </body>
  </worldbody>
  <tendon>
    <spatial range="0 0.5"><site site="post"/><geom geom="drum"/><site site="tip"/></spatial>
    <spatial range="0 0.4"><site site="end"/><site site="tip"/></spatial>
  </tendon>
</mujoco>
"""
"""Joints of all kinds, and tendons of which one runs around a drum that moves."""


def test_limits_of_tendons_on_all_kinds_of_joints_give_way_as_in_mujoco() -> None:
    """Bound: 0.3 % of how far they move. They would be up to 270 mm off with what paths add."""
    native = mujoco.MjModel.from_xml_string(MECHANISM)
    native.opt.timestep = 2.5e-5
    native.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    now = mujoco.MjData(native)
    now.qvel[:] = np.random.default_rng(1).uniform(-3.0, 3.0, native.nv)
    mujoco.mj_forward(native, now)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(MECHANISM, ctrl_direct=True)
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, compliant_contacts=True)
    state, motion = model.state(), np.zeros((model.body_count, 6))
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    for body in range(model.body_count):
        at = np.zeros(6)
        mujoco.mj_objectVelocity(native, now, int(mujoco.mjtObj.mjOBJ_BODY), body + 1, at, 0)
        motion[body] = at[[3, 4, 5, 0, 1, 2]]
    state.body_qd.assign(motion)
    begun = state.body_q.numpy()[:, :3].copy()
    for _ in range(800):
        solver.step(state, state, None, None, 5.0e-4)
    mujoco.mj_step(native, now, 16000)
    ended = state.body_q.numpy()[:, :3]
    moved = np.linalg.norm(now.xpos[1:] - begun, axis=1)
    off = np.linalg.norm(ended - now.xpos[1:], axis=1)
    assert np.all(off < 3.0e-3 * moved.max())


def test_limits_are_rigid_or_by_limit_ke_where_the_user_says_so() -> None:
    """The load of 3 N m passes a rigid limit by nothing, and one of 400 N m/rad by 3/400."""
    rigid = angles(arm(), -3.0, 2.0e-3, 100, compliant_contacts=False)
    assert abs(rigid[-1]) < 1.0e-5
    model = arm("")
    assert SolverAVBD(model, compliant_contacts=True).effects["limit_impedance"].on
    model.joint_limit_ke.fill_(400.0)
    model.joint_limit_kd.fill_(20.0)
    assert not SolverAVBD(model, compliant_contacts=True).effects["limit_impedance"].on
    assert angles(model, -3.0, 2.0e-3, 500)[-1] == pytest.approx(-3.0 / 400.0, rel=1.0e-3)


def test_the_reference_pose_leaves_the_model_s_pose_alone() -> None:
    model = arm()
    model.joint_q.fill_(0.3)
    SolverAVBD(model, compliant_contacts=True)
    np.testing.assert_array_equal(model.joint_q.numpy(), np.float32(0.3))


@pytest.mark.parametrize("settings", [{}, {"blocks": "body"}, {"parallel": "bodies"}])
def test_a_rigid_limit_holds_where_its_margin_begins(settings: dict) -> None:
    """MuJoCo pushes until the coordinate is the margin inside, so its stiff limits hold there."""
    rigid = {"compliant_contacts": False} | settings
    for ends, torque, expected in (
        ("0 2", -3.0, 0.1),
        ("0 2", 30.0, 1.9),
        ("0 0.1", 3.0, 0.05),  # margins that overlap meet
    ):
        path = angles(arm('margin="0.1"', ends), torque, 1e-2, 60, (0.05, 0.0), **rigid)
        assert path[-1] == pytest.approx(expected, abs=1e-5)


def test_a_margin_that_the_user_takes_away_is_gone_after_the_notice() -> None:
    model = arm('margin="0.1"')
    solver = SolverAVBD(model, update_joint_state=True)
    state, control = model.state(), model.control()
    control.mujoco.ctrl.fill_(-3.0)
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    for expected in (0.1, 0.0):
        for _ in range(60):
            solver.step(state, state, control, None, 1e-2)
        assert state.joint_q.numpy()[0] == pytest.approx(expected, abs=1e-5)
        model.mujoco.limit_margin.zero_()
        solver.notify_model_changed(newton.ModelFlags.JOINT_DOF_PROPERTIES)
