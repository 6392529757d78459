# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Actuators that hold bodies: stable however stiff, and as strong as authored."""

import mujoco
import newton
import numpy as np
import pytest
from helpers import G
from newton.solvers import SolverMuJoCo
from numpy.typing import NDArray
from scipy.linalg import expm

from newton_avbd import SolverAVBD

MASS = 2.0
SERVO = '<position site="s" refsite="w" gear="{}" {}/>'.format
UP = "0 0 1 0 0 0"
ALL = [" ".join("1" if k == axis else "0" for k in range(6)) for axis in range(6)]
"""The six gears of a servo in all directions."""
SCENE = """<mujoco><compiler angle="radian"/><option timestep="0.0001"/>
  <worldbody>
    <site name="w" pos="0.2 0.1 1.3"/>
    <body name="b" pos="0 0 1"><freejoint/>
      <geom type="box" size=".1 .2 .05" mass="2" contype="0" conaffinity="0"/>
      <site name="s" pos="{at}"/>{tail}
    </body>
  </worldbody>
  <actuator>{actuators}</actuator></mujoco>""".format
OFF_CENTER = "0.05 0.1 0.02"


def built(text: str, gravity: float = G) -> newton.Model:
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -gravity))
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text, ctrl_direct=True)
    return builder.finalize(device="cpu")


def run(
    model: newton.Model, solver: SolverAVBD, steps: int, dt: float, ctrl: float = 0.0
) -> newton.State:
    state, control = model.state(), model.control()
    control.mujoco.ctrl.fill_(ctrl)
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    for _ in range(steps):
        solver.step(state, state, control, None, dt)
    return state


def in_mujoco(text: str, seconds: float) -> NDArray[np.float64]:
    """Where the body is, by small steps."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return data.xpos[1]


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
@pytest.mark.parametrize("stiffness", [1.0e4, 1.0e8])
@pytest.mark.parametrize("gears", [[UP] * 3, ALL], ids=["three alike", "six axes"])
def test_several_stiff_servos_never_add_energy(
    scheme: str, stiffness: float, gears: list[str]
) -> None:
    """Springs of some stretch: no speed beyond what their energy at the start gives."""
    servos = "".join(SERVO(gear, f'kp="{stiffness}"') for gear in gears)
    model = built(SCENE(at=OFF_CENTER, tail="", actuators=servos), gravity=0.0)
    solver = SolverAVBD(model, scheme=scheme)
    away = np.array([0.15, 0.0, 0.28, 0.0, 0.0, 0.0])
    stretches = [away @ np.array(gear.split(), dtype=float) for gear in gears]
    stored = 0.5 * stiffness * sum(stretch**2 for stretch in stretches)
    state, control = model.state(), model.control()
    for _ in range(240):
        solver.step(state, state, control, None, 1.0 / 240.0)
        v = state.body_qd.numpy()[0].astype(float)
        inertia = model.body_inertia.numpy()[0].astype(float).diagonal()
        assert 0.5 * MASS * v[:3] @ v[:3] + 0.5 * inertia.min() * v[3:] @ v[3:] < 1.01 * stored


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
@pytest.mark.parametrize("blocks", ["articulation", "body"])
@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
def test_a_servo_gives_way_by_the_weight_over_its_stiffness(
    scheme: str, blocks: str, dt: float
) -> None:
    """However stiff in the step: k h^2/m is 28 at 1/60 s."""
    stiffness = 2.0e5
    model = built(SCENE(at="0 0 0", tail="", actuators=SERVO(UP, f'kp="{stiffness}" kv="2e3"')))
    state = run(model, SolverAVBD(model, scheme=scheme, blocks=blocks), round(2.0 / dt), dt)
    assert 1.3 - state.body_q.numpy()[0, 2] == pytest.approx(MASS * G / stiffness, rel=0.02)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
def test_a_heavy_link_hangs_on_the_servo_of_a_light_one(parallel: str) -> None:
    """The servo's own link weighs a hundredth of what it carries."""
    tail = """<body pos="0 0 -0.3"><joint type="ball"/>
      <geom type="sphere" size=".1" mass="200" contype="0" conaffinity="0"/></body>"""
    stiffness = 2.0e5
    servos = "".join(SERVO(gear, f'kp="{stiffness}" kv="2e4"') for gear in ALL)
    text = SCENE(at="0 0 0", tail=tail, actuators=servos)
    model = built(text)
    state = run(model, SolverAVBD(model, parallel=parallel), 960, 1.0 / 240.0)
    sunk = 1.3 - state.body_q.numpy()[0, 2]
    assert sunk == pytest.approx((MASS + 200.0) * G / stiffness, rel=0.02)


def test_what_is_stuck_is_pushed_with_no_more_than_the_force_range() -> None:
    """It pulls against the stop of a slide, which bears what is left of the weight."""
    text = SCENE(at="0 0 0", tail="", actuators=SERVO(UP, 'kp="1e6" forcerange="-30 12"'))
    model = built(text.replace("<freejoint/>", '<joint type="slide" axis="0 0 1" range="0 1e-6"/>'))
    model.request_state_attributes("body_parent_f")
    state = run(model, SolverAVBD(model), 20, 1.0 / 240.0)
    assert state.body_parent_f.numpy()[0, 2] == pytest.approx(MASS * G - 12.0, rel=1.0e-3)


def test_a_limited_servo_takes_a_free_body_there_as_in_mujoco() -> None:
    text = SCENE(at="0 0 0", tail="", actuators=SERVO(UP, 'kp="1e4" kv="30" forcerange="-40 40"'))
    model = built(text)
    for dt, bound in ((1.0 / 240.0, 2.0e-3), (1.0 / 1000.0, 5.0e-4)):
        state = run(model, SolverAVBD(model), round(0.25 / dt), dt)
        assert state.body_q.numpy()[0, 2] == pytest.approx(in_mujoco(text, 0.25)[2], abs=bound)


@pytest.mark.parametrize("at", ["0 0 0", OFF_CENTER])
@pytest.mark.parametrize("gear", [UP, "1 0 0.5 0 0 0"])
def test_a_damping_ratio_is_of_the_mass_that_the_servo_moves(at: str, gear: str) -> None:
    """MuJoCo's mass is 1/(J M^-1 J^T)."""
    text = SCENE(at=at, tail="", actuators=SERVO(gear, 'kp="50" dampratio="0.7"'))
    model = built(text)
    state = run(model, SolverAVBD(model), 400, 1.0 / 1000.0)
    np.testing.assert_allclose(state.body_q.numpy()[0, :3], in_mujoco(text, 0.4), atol=1.0e-3)


HINGES = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1" contype="0" conaffinity="0"/>
  <body pos=".3 0 0"><joint name="b" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1" contype="0" conaffinity="0"/>
  </body></body></worldbody>
  <tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="2"/></fixed></tendon>
  <actuator><position {} kp="5" dampratio="0.5"/></actuator></mujoco>""".format


@pytest.mark.parametrize("target", ['joint="a" gear="2"', 'joint="b"', 'tendon="t" gear="3"'])
def test_the_same_along_joints_and_tendons(target: str) -> None:
    text = HINGES(target)
    model = built(text)
    solver = SolverAVBD(model)
    expected = mujoco.MjModel.from_xml_string(text).actuator_biasprm[0, 2]
    assert solver._actuation.law.velocity_bias.numpy()[0] == pytest.approx(expected, rel=1.0e-3)


def test_a_held_body_sleeps_and_wakes_with_its_control() -> None:
    model = built(SCENE(at="0 0 0", tail="", actuators=SERVO(UP, 'kp="1e3" kv="200"')))
    solver = SolverAVBD(model, sleeping=True)
    state, control = model.state(), model.control()
    for _ in range(960):
        solver.step(state, state, control, None, 1.0 / 240.0)
    assert solver.status.sleeping_bodies == 1
    control.mujoco.ctrl.fill_(0.1)
    before = state.body_q.numpy()[0, 2]
    for _ in range(480):
        solver.step(state, state, control, None, 1.0 / 240.0)
    assert state.body_q.numpy()[0, 2] - before == pytest.approx(0.1, rel=0.02)


def test_the_force_of_a_servo_is_told() -> None:
    """At rest it carries the weight."""
    model = built(SCENE(at="0 0 0", tail="", actuators=SERVO(UP, 'kp="1e4" kv="1e3"')))
    model.request_state_attributes("mujoco:qfrc_actuator")
    state = run(model, SolverAVBD(model), 480, 1.0 / 240.0)
    np.testing.assert_allclose(
        state.mujoco.qfrc_actuator.numpy(), [0.0, 0.0, MASS * G, 0.0, 0.0, 0.0], atol=1.0e-2
    )


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_servos_of_welded_links_hold_their_body(scheme: str) -> None:
    """Each pushes at its own link; together they keep the body level."""
    sides = "".join(
        f"""<body pos="{x} 0 0"><geom type="box" size=".05 .05 .05" mass="1" contype="0"
        conaffinity="0"/><site name="s{i}"/></body>"""
        for i, x in enumerate((-0.3, 0.5))
    )
    stiffness = 1.0e4
    servos = "".join(
        f'<position site="s{i}" refsite="w" gear="0 0 1 0 0 0" kp="{stiffness}" kv="500"/>'
        for i in range(2)
    )
    model = built(SCENE(at="0 0 0", tail=sides, actuators=servos))
    state = run(model, SolverAVBD(model, scheme=scheme), 960, 1.0 / 240.0)
    # forces by the lever rule about the COM, 0.05 m from the middle of the base
    weight, com = (MASS + 2.0) * G, (-0.3 + 0.5) / 4.0
    sunk = [weight * (0.5 - com) / 0.8 / stiffness, weight * (com + 0.3) / 0.8 / stiffness]
    np.testing.assert_allclose(1.3 - state.body_q.numpy()[1:, 2], sunk, rtol=0.02)


def test_servos_of_a_ball_joint_between_bodies_stay_stable() -> None:
    """Three stiff ones between two bodies: forces of the step, never more than all together."""
    tail = """<body pos="0 0 -0.2"><joint name="ball" type="ball"/>
      <geom type="box" size=".1 .05 .02" mass="1" contype="0" conaffinity="0"/></body>"""
    servos = "".join(
        f'<position joint="ball" gear="{gear}" kp="1e6" kv="1e2"/>'
        for gear in ("1 0 0", "0 1 0", "0 0 1", "1 1 0")
    )
    model = built(SCENE(at="0 0 0", tail=tail, actuators=servos), gravity=0.0)
    state = model.state()
    solver, control = SolverAVBD(model), model.control()
    start = np.zeros((2, 6), dtype=np.float32)
    start[0, 3:], start[1, 3:] = (1.0, 2.0, 0.0), (-1.0, 0.0, 3.0)
    state.body_qd.assign(start)
    most = 0.0
    for _ in range(480):
        solver.step(state, state, control, None, 1.0 / 240.0)
        most = max(most, float(np.abs(state.body_qd.numpy()).max()))
    assert most < 6.0


@pytest.mark.parametrize(
    ("servo", "gains", "most"),
    [
        ('<position site="s" refsite="w" gear="{}" kp="40" kv="2"/>', (40.0, 40.0, 2.0), 1e-4),
        ('<velocity site="s" refsite="w" gear="{}" kv="6"/>', (6.0, 0.0, 6.0), 2e-5),
    ],
)
def test_a_servo_acts_as_its_control_changes(
    servo: str, gains: tuple[float, float, float], most: float
) -> None:
    """Of second order, though the control jumps: against the exact motion of a linear system.

    By backward Euler it is off by some millimeters.
    """
    text = SCENE(at="0 0 0", tail="", actuators=servo.format(UP))
    model = built(text, gravity=0.0)
    dt, steps = 1.0 / 240.0, 120
    solver = SolverAVBD(model)
    state, control = model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    push, stiffness, damping = (gain / MASS for gain in gains)
    system = np.array([[0.0, 1.0, 0.0], [-stiffness, -damping, push], [0.0, 0.0, 0.0]])
    exact = expm(dt * system)
    x = np.array([1.0 - 1.3, 0.0, 0.0])  # from the site of reference
    for k in range(steps):
        x[2] = 0.2 * np.sin(0.1 * (k // 4))
        control.mujoco.ctrl.fill_(x[2])
        solver.step(state, state, control, None, dt)
        x = exact @ x
    assert state.body_q.numpy()[0, 2] == pytest.approx(1.3 + x[0], abs=most)
    # a notice of changes makes nothing of it
    for _ in range(6):
        states = [model.state() for _ in range(2)]
        checkpoint = solver.checkpoint()
        for given in states:
            solver.restore(checkpoint)
            if given is states[0]:
                solver.notify_model_changed(newton.ModelFlags.ALL)
            solver.step(state, given, control, None, dt)
        np.testing.assert_array_equal(*(given.body_q.numpy() for given in states))
        state.assign(states[0])
    # a reset forgets what it pushed with
    again = []
    for _ in range(2):
        solver.reset(state)
        newton.eval_fk(model, model.joint_q, model.joint_qd, state)
        for k in range(5):
            control.mujoco.ctrl.fill_(float(k))
            solver.step(state, state, control, None, dt)
        again.append(state.body_q.numpy())
    np.testing.assert_array_equal(*again)


MUSCLE = 'gaintype="muscle" biastype="muscle" gainprm="{0}" biasprm="{0}" lengthrange="-0.6 0.3"'
AFFINE = 'gaintype="affine" gainprm="40 8 -3" biastype="affine" biasprm="0 -30 -2"'


@pytest.mark.parametrize(
    "law", [MUSCLE.format("0.75 1.05 60 200 0.5 1.6 6 1.3 1.2"), AFFINE], ids=["muscle", "affine"]
)
def test_a_servo_whose_slopes_change_acts_by_its_law(law: str) -> None:
    """A muscle by where it is, an affine gain by its control: beside MuJoCo with short steps.

    Bound: twice what steps of second order leave. With intercepts of the law in the place of its
    force it was 0.12 mm, and of first order.
    """
    servo = f'<general site="s" refsite="w" gear="{UP}" {law}/>'
    text = SCENE(at="0 0 0", tail="", actuators=servo)
    native = mujoco.MjModel.from_xml_string(text)
    native.opt.integrator, native.opt.gravity[2] = int(mujoco.mjtIntegrator.mjINT_RK4), 0.0
    now = mujoco.MjData(native)
    now.qvel[2] = 1.0
    model = built(text, gravity=0.0)
    solver, control, state = SolverAVBD(model), model.control(), model.state()
    state.body_qd.assign([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    for k in range(200):
        now.ctrl[:] = 0.3 if law != AFFINE else 0.3 + 0.3 * np.sin(0.036 * (k // 2))
        control.mujoco.ctrl.assign(now.ctrl.astype(np.float32))
        solver.step(state, state, control, None, 2.0e-3)
        mujoco.mj_step(native, now, 20)
        assert state.body_q.numpy()[0, 2] == pytest.approx(now.qpos[2], abs=4.0e-5)
    assert abs(now.qpos[2] - 1.4) > 0.5


def test_a_moving_reference_site_gets_the_reaction() -> None:
    """Two bodies that nothing else holds, from rest: what a motor between their sites does to them
    in one step, by the moment arms of MuJoCo (which keep momentum but no angular momentum)."""
    text = """<mujoco><worldbody>
      <body name="a" pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .05" mass="1"
        contype="0" conaffinity="0"/><site name="s" pos=".1 0 0"/></body>
      <body name="b" pos="1 0 1"><freejoint/><geom type="box" size=".1 .2 .05" mass="2"
        contype="0" conaffinity="0"/><site name="r" pos="0 .1 .05" euler="0 30 0"/></body>
      </worldbody>
      <actuator><motor site="s" refsite="r" gear="0 1 2 0.1 0 0"/></actuator></mujoco>"""
    reference = mujoco.MjModel.from_xml_string(text)
    reference.opt.gravity[:] = 0.0
    data = mujoco.MjData(reference)
    data.ctrl[:] = 3.0
    mujoco.mj_forward(reference, data)
    model = built(text, gravity=0.0)
    dt = 1.0e-4
    state = run(model, SolverAVBD(model), 1, dt, ctrl=3.0)
    # nothing has turned yet: axes of the bodies are those of the world
    np.testing.assert_allclose(state.body_qd.numpy().ravel() / dt, data.qacc, atol=1.0e-3)
