# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's tendons have the length and the moments of their geometry, and pull by their laws.

All scenes have the same kinds of joints and effects, so that they share their kernels.
"""

import mujoco
import newton
import numpy as np
import pytest
from helpers import G
from newton.solvers import SolverMuJoCo
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD

DT = 1.0 / 1000.0
ARM, LEFT, RIGHT = 0, 1, 2
"""Coordinates of an arm on a hinge, and of two weights that slide up and down."""
SCENE = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom name="drum" type="cylinder" size="0.1 0.3" euler="1.5707963267948966 0 0"
          contype="0" conaffinity="0"/>
    <site name="behind" pos="-0.5 0 0"/>
    <site name="above" pos="0 0 0.3"/>
    <site name="pulley_left" pos="1 0 2"/>
    <site name="pulley_right" pos="2 0 2"/>
    <body name="arm">
      <joint name="hinge" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.3 0.5 0.4"/>
      <site name="tip" pos="0.4 0 0"/>
      <site name="elbow" pos="0.1 0.2 0.1"/>
    </body>
    <body name="left" pos="1 0 1">
      <joint name="left" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="3" diaginertia="0.3 0.5 0.4"/>
      <site name="left"/>
    </body>
    <body name="right" pos="2 0 1">
      <joint name="right" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.3 0.5 0.4"/>
      <site name="right"/>
    </body>
  </worldbody>
  <tendon>{tendon}</tendon>
  <equality>{equality}</equality>
  <actuator>{actuator}</actuator>
</mujoco>
"""
LIGHT, HEAVY, NEAR, FAR = 0.5, 5.0, 0.3, 1.2
"""Two ends of a tendon that runs through a ball: masses [kg], and places on the line that leads out
of its center [m]. The near one is on the surface of the ball."""


def through_ball(has: str) -> str:
    return f"""
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom name="ball" type="sphere" size="{NEAR}" contype="0" conaffinity="0"/>
    <site name="middle"/>
    <body name="arm" pos="0 3 0">
      <joint name="hinge" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.3 0.5 0.4"/>
    </body>
    <body pos="{NEAR} 0 0">
      <joint type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{LIGHT}" diaginertia="0.3 0.5 0.4"/>
      <site name="near"/>
    </body>
    <body pos="{FAR} 0 0">
      <joint type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{HEAVY}" diaginertia="0.3 0.5 0.4"/>
      <site name="far"/>
    </body>
  </worldbody>
  <tendon>
    <spatial {has}>
      <site site="near"/><geom geom="ball" sidesite="middle"/><site site="far"/>
    </spatial>
  </tendon>
</mujoco>
"""


OVER_DRUM = """<spatial name="cord" {has}><site site="behind"/><geom geom="drum" sidesite="above"/>
<site site="tip"/></spatial>"""
ROPE = """<spatial name="rope" {has}><site site="left"/><site site="pulley_left"/>
<site site="pulley_right"/><site site="right"/></spatial>"""
BOTH = """<fixed name="both" {has}><joint joint="left" coef="1"/>
<joint joint="right" coef="1"/></fixed>
<spatial><site site="behind"/><site site="above"/></spatial>"""


def file(tendon: str, actuator: str = "", equality: str = "") -> str:
    return SCENE.format(tendon=tendon, actuator=actuator, equality=equality)


def model_of(text: str, gravity: float = 0.0) -> newton.Model:
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -gravity))
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text, ctrl_direct=True)
    return builder.finalize(device="cpu")


def run(
    model: newton.Model,
    steps: int,
    ctrl: float | None = None,
    start: tuple[float, ...] = (0.0, 0.0, 0.0),
    rates: tuple[float, ...] = (0.0, 0.0, 0.0),
    dt: float = DT,
    **settings: object,
) -> tuple[NDArray[np.float64], SolverAVBD]:
    """Coordinates after each step, shape (steps, 3)."""
    solver = SolverAVBD(model, update_joint_state=True, **settings)
    state, control = model.state(), model.control()
    state.joint_q.assign(np.array(start, dtype=np.float32))
    state.joint_qd.assign(np.array(rates, dtype=np.float32))
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    if ctrl is not None:
        control.mujoco.ctrl.fill_(ctrl)
    path = []
    for _ in range(steps):
        state.clear_forces()
        solver.step(state, state, control, None, dt)
        path.append(state.joint_q.numpy().astype(float))
    return np.array(path), solver


def drum_length(angle: float) -> tuple[float, float]:
    """Length of the cord over the drum with the arm at an angle [rad], and its derivative.

    Two tangents and the arc between them; the arm turns the end of the cord, which its tangent
    leaves at the distance of the drum's radius from the hinge.
    """
    radius, behind, tip = 0.1, 0.5, 0.4
    spans = np.sqrt(behind**2 - radius**2) + np.sqrt(tip**2 - radius**2)
    arc = np.pi + angle - np.arccos(radius / behind) - np.arccos(radius / tip)
    return spans + radius * arc, radius


def test_a_tendon_around_a_cylinder_has_its_geodesic_and_its_radius_for_an_arm() -> None:
    """A constant pull f turns the arm by f r/I, whatever its angle while the cord is on the drum.

    Bounds: rounding of float32 lengths; backward Euler adds t dt/2, exact here.
    """
    pull, inertia, steps = 2.0, 0.5, 200
    model = model_of(file(OVER_DRUM.format(has=""), '<motor tendon="cord"/>'))
    q, solver = run(model, steps, -pull, scheme="euler")
    angle = -pull * drum_length(0.0)[1] / inertia * steps * (steps + 1) / 2 * DT**2
    assert q[-1, ARM] == pytest.approx(angle, rel=1.0e-4)
    found = solver._tree.tendons.length.numpy()[0]
    assert found == pytest.approx(drum_length(q[-1, ARM])[0], abs=1.0e-6)


@pytest.mark.parametrize("ratio", [1.0, 1.0e3])
def test_two_weights_on_a_rope_over_pulleys_accelerate_as_atwood_says(ratio: float) -> None:
    """a = (m1 - m2)/(m1 + m2) g, and the rope, a limit of a tendon, keeps its length.

    Bound of the length: rounding of 3 m in float32.
    """
    model = model_of(file(ROPE.format(has='limited="true" range="0 3"')), G)
    masses = model.body_mass.numpy()
    masses[LEFT] = ratio * 3.0
    model.body_mass.assign(masses)
    model.body_inv_mass.assign(1.0 / masses)
    q, _ = run(model, 200, scheme="euler")
    weights = (masses[LEFT] - masses[RIGHT]) / (masses[LEFT] + masses[RIGHT])
    assert q[-1, RIGHT] == pytest.approx(weights * G * 0.2 * (0.2 + DT) / 2.0, rel=1.0e-4)
    np.testing.assert_allclose(q[:, LEFT] + q[:, RIGHT], 0.0, atol=1.0e-6)


def test_a_rope_that_goes_slack_pulls_nothing_and_then_holds() -> None:
    """Thrown up, the weights fall freely until the rope is taut again; it never pushes.

    Bounds: rounding; 1e-5 m where it holds, what one step leaves open.
    """
    model = model_of(file(ROPE.format(has='limited="true" range="0 3"')), G)
    q, _ = run(model, 500, rates=(0.0, 1.0, 1.0), scheme="euler")
    t = DT * np.arange(1, 501)
    free = t - G * t * (t + DT) / 2.0
    is_slack = t < 0.2
    np.testing.assert_allclose(q[is_slack, LEFT], free[is_slack], atol=1.0e-5)
    np.testing.assert_allclose(q[is_slack, RIGHT], free[is_slack], atol=1.0e-5)
    assert np.all(q[:, LEFT] + q[:, RIGHT] > -1.0e-5)
    assert q[-1, RIGHT] > q[-1, LEFT]


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_rope_that_goes_taut_does_not_throw_the_weights_back(scheme: str) -> None:
    """Both fall by 0.1 m until the rope is taut, at 1.4 m/s; then the heavier one pulls the other.

    Bound: what one step leaves open. Extrapolated over the jolt, they bounced to half the height.
    """
    model = model_of(file(ROPE.format(has='limited="true" range="0 3"')), G)
    q, _ = run(model, 300, start=(0.0, 0.1, 0.1), dt=2.0e-3, scheme=scheme)
    slack = q[:, LEFT] + q[:, RIGHT]
    taut = int(np.argmax(slack < 1.0e-4))
    assert taut * 2.0e-3 == pytest.approx(np.sqrt(2.0 * 0.1 / G), abs=4.0e-3)
    np.testing.assert_allclose(slack[taut:], 0.0, atol=1.0e-4)


def test_a_pulley_divides_the_pull_of_what_comes_after_it() -> None:
    """Of a force on the tendon a branch of divisor 2 gets the half."""
    tendon = """<spatial name="cord"><site site="left"/><site site="pulley_left"/>
    <pulley divisor="2"/><site site="right"/><site site="pulley_right"/></spatial>"""
    q, _ = run(model_of(file(tendon, '<motor tendon="cord"/>')), 100, -3.0, scheme="euler")
    reach = 0.1 * (0.1 + DT) / 2.0
    assert q[-1, LEFT] == pytest.approx(3.0 / 3.0 * reach, rel=1.0e-4)
    assert q[-1, RIGHT] == pytest.approx(1.5 / 1.0 * reach, rel=1.0e-4)


def test_a_spring_is_slack_in_its_band_and_stable_beyond_however_stiff() -> None:
    """Within the band nothing pulls; a stiff one holds its end at m g/k beyond the band."""
    stiffness = 1.0e8
    tendon = f"""<spatial stiffness="{stiffness}" springlength="0 1.5">
    <site site="left"/><site site="pulley_left"/></spatial>"""
    model = model_of(file(tendon), G)
    q, _ = run(model, 1000, scheme="euler")
    t = DT * np.arange(1, 1001)
    free = -G * t * (t + DT) / 2.0
    np.testing.assert_allclose(q[t < 0.3, LEFT], free[t < 0.3], atol=1.0e-5)
    assert q[-1, LEFT] == pytest.approx(-0.5, abs=1.0e-5)
    assert np.all(q[:, LEFT] > -0.5 - 1.0e-4)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_light_body_on_a_stiff_spring_gains_no_energy(scheme: str) -> None:
    """100 N by a lever of 0.3 m on 4e-5 kg m^2 turn it by 13 rad in the square of a step."""
    mass, inertia, lever, stretch, stiffness, dt = 0.1, 4.0e-5, 0.3, 0.1, 1000.0, 1.0 / 240.0
    rest = np.hypot(1.0, lever) - stretch
    model = model_of(f"""<mujoco><worldbody><site name="w" pos="0 0 1"/><body><freejoint/>
    <inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
    <site name="s" pos="{lever} 0 0"/></body></worldbody>
    <tendon><spatial stiffness="{stiffness}" springlength="{rest}"><site site="w"/>
    <site site="s"/></spatial></tendon></mujoco>""")
    solver, state, after = SolverAVBD(model, scheme=scheme), model.state(), model.state()
    stored = 0.5 * stiffness * stretch**2
    for _ in range(240):
        solver.step(state, after, model.control(), None, dt)
        state, after = after, state
        pose, velocity = state.body_q.numpy()[0].astype(float), state.body_qd.numpy()[0]
        end = pose[:3] + Rotation.from_quat(pose[3:]).apply((lever, 0.0, 0.0))
        energy = 0.5 * mass * velocity[:3] @ velocity[:3]
        energy += 0.5 * inertia * velocity[3:] @ velocity[3:]
        energy += 0.5 * stiffness * (np.linalg.norm(end - (0.0, 0.0, 1.0)) - rest) ** 2
        assert energy < 1.001 * stored


CORD = """<mujoco><worldbody><site name="hook" pos="-0.5 -0.2 -2"/>
<body pos="0 0 2"><freejoint/><inertial pos="0 0 0" mass="0.4" diaginertia="0.04 0.05 0.045"/>
<site name="eye" pos="0.07 -0.07 -0.12"/></body>
<body pos="0.7 -0.4 1.4"><freejoint/>
<inertial pos="0 0 0" mass="0.2" diaginertia="0.018 0.02 0.018"/>
<site name="tip" pos="0.7 0.2 -0.3"/></body></worldbody>
<tendon><spatial stiffness="{stiffness}" springlength="0.6"><site site="hook"/><site site="eye"/>
<site site="tip"/></spatial></tendon></mujoco>"""


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
@pytest.mark.parametrize("rate", [60, 240])
@pytest.mark.parametrize("stiffness", [300.0, 3000.0])
def test_a_cord_over_a_body_that_floats_gains_no_energy(
    scheme: str, rate: int, stiffness: float
) -> None:
    """It is tied to the world, and brings the eye of a body to where it is tied: steps in which
    sweeps do not settle. Their energy was bounded as if the two bodies were alone, whose momentum
    is then kept; they ended with 570 to 5e16 times what was stored."""
    text = CORD.format(stiffness=stiffness)
    model, mujoco_model = model_of(text), mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(mujoco_model)
    solver, state, after = SolverAVBD(model, scheme=scheme), model.state(), model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)

    def energy() -> float:
        data.qpos[:] = state.body_q.numpy()[:, [0, 1, 2, 6, 3, 4, 5]].ravel()
        mujoco.mj_fwdPosition(mujoco_model, data)
        stored = 0.5 * stiffness * (data.ten_length[0] - 0.6) ** 2
        turns = data.ximat.reshape(-1, 3, 3)[1:]
        for velocity, turn, mass, inertia in zip(
            state.body_qd.numpy().astype(float),
            turns,
            mujoco_model.body_mass[1:],
            mujoco_model.body_inertia[1:],
            strict=True,
        ):
            spin = turn.T @ velocity[3:]
            stored += 0.5 * mass * velocity[:3] @ velocity[:3] + 0.5 * spin @ (inertia * spin)
        return stored

    most = 1.001 * energy()
    for _ in range(2 * rate):
        solver.step(state, after, model.control(), None, 1.0 / rate)
        state, after = after, state
        assert energy() < most


def muscle(length: float) -> float:
    """Active force of MuJoCo's muscle by its normalised length, with lmin 0.5 and lmax 1.6."""
    least, most = 0.5, 1.6
    rise, fall = 0.5 * (least + 1.0), 0.5 * (1.0 + most)
    if length <= rise:
        return 0.5 * ((length - least) / (rise - least)) ** 2
    if length <= 1.0:
        return 1.0 - 0.5 * ((1.0 - length) / (1.0 - rise)) ** 2
    if length <= fall:
        return 1.0 - 0.5 * ((length - 1.0) / (fall - 1.0)) ** 2
    return 0.5 * ((most - length) / (most - fall)) ** 2


@pytest.mark.parametrize("length", [0.7, 0.95, 1.2, 1.45])
def test_a_muscle_pulls_a_spatial_tendon_by_its_force_length_curve(length: float) -> None:
    """The weight accelerates by the curve's force. Bound: 1e-5 m that one step moves it by, and
    that by rounding."""
    tendon = '<spatial name="cord"><site site="left"/><site site="pulley_left"/></spatial>'
    peak = 30.0
    prm = f"0.5 1.5 {peak} 1 0.5 1.6 1e9 0 1.2"
    actuator = f"""<general tendon="cord" gaintype="muscle" biastype="muscle" dyntype="none"
    gainprm="{prm}" biasprm="{prm}" lengthrange="0.5 1.5"/>"""
    dt = 4.0e-3
    q, _ = run(model_of(file(tendon, actuator)), 1, 1.0, (0.0, 1.0 - length, 0.0), dt=dt)
    force = (q[0, LEFT] - np.float32(1.0 - length)) * 3.0 / dt**2
    assert force == pytest.approx(peak * muscle(length), rel=5.0e-3)


@pytest.mark.parametrize("along", ["joint", "tendon"])
def test_a_muscle_at_second_order_pushes_by_its_law_and_not_by_its_slopes(along: str) -> None:
    """Two muscles whose slopes change from step to step, beside MuJoCo with short steps.

    Only a force that changes where the muscle is counts as one that its control changes.
    """
    tendon = '<fixed name="all"><joint joint="hinge" coef="1"/></fixed>'
    of = {"joint": 'joint="hinge"', "tendon": 'tendon="all"'}[along]
    law = 'gaintype="muscle" biastype="muscle" gainprm="{0}" biasprm="{0}"'
    law = law.format("0.75 1.05 200 200 0.5 1.6 6 1.3 1.2")
    muscles = f"""<general {of} lengthrange="4.5 6" {law}/>
    <general {of} lengthrange="-6 -4.5" gear="-1" {law}/>"""
    text = file(tendon, muscles).replace('axis="0 1 0"/>', 'axis="0 1 0" ref="5"/>')
    native = mujoco.MjModel.from_xml_string(text)
    native.opt.timestep, native.opt.gravity[2] = 1.0e-4, 0.0
    now, steps, substeps = mujoco.MjData(native), 100, 20
    now.qvel[0] = 4.0
    now.ctrl[:] = 0.2
    path = []
    for _ in range(steps):
        mujoco.mj_step(native, now, substeps)
        path.append(now.qpos[0] - 5.0)
    dt = substeps * native.opt.timestep
    q, _ = run(model_of(text), steps, 0.2, rates=(4.0, 0.0, 0.0), dt=dt)
    assert np.ptp(path) > 0.1
    np.testing.assert_allclose(q[:, ARM], path, atol=2.5e-4)


@pytest.mark.parametrize("along", ["joint", "tendon"])
def test_a_servo_goes_on_after_notices_and_checkpoints(along: str) -> None:
    """What it pushed with in the last step is kept: only a change of its force counts as one."""
    tendon = '<fixed name="all"><joint joint="hinge" coef="1"/></fixed>'
    of = {"joint": 'joint="hinge"', "tendon": 'tendon="all"'}[along]
    law = 'gaintype="affine" gainprm="40 8 -3" biastype="affine" biasprm="0 -30 -2"'
    model = model_of(file(tendon, f"<general {of} {law}/>"))
    solver, control, state = SolverAVBD(model), model.control(), model.state()
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    for k in range(20):
        control.mujoco.ctrl.fill_(0.3 + 0.1 * k)
        states = [model.state() for _ in range(3)]
        checkpoint = solver.checkpoint()
        for given in states:
            solver.restore(checkpoint)
            if given is states[0]:
                solver.notify_model_changed(newton.ModelFlags.ALL)
            solver.step(state, given, control, None, DT)
        np.testing.assert_array_equal(states[0].body_q.numpy(), states[1].body_q.numpy())
        np.testing.assert_array_equal(states[2].body_q.numpy(), states[1].body_q.numpy())
        state.assign(states[1])


def test_a_limit_of_a_fixed_tendon_stops_the_sum_of_its_coordinates() -> None:
    """Both fall freely; from the limit on their sum stays, and it pulls both alike."""
    model = model_of(file(BOTH.format(has='limited="true" range="-0.5 9"')), G)
    q, _ = run(model, 600, rates=(0.0, 0.0, -0.5), scheme="euler")
    total = q[:, LEFT] + q[:, RIGHT]
    assert np.all(total > -0.5 - 1.0e-5)
    np.testing.assert_allclose(total[-100:], -0.5, atol=1.0e-5)
    # what holds both pulls them alike, so that 3 q_left - q_right keeps its acceleration, -2 g
    t = 0.6
    apart = 3.0 * q[-1, LEFT] - q[-1, RIGHT]
    assert apart == pytest.approx(0.5 * t - G * t * (t + DT), rel=1.0e-3)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_limit_pulls_on_where_a_path_through_a_geom_is_shortest(scheme: str) -> None:
    """A light end stays on the surface, and the heavy end comes in as MuJoCo's law of limits says.

    Off the surface the light end yields with its mass m, so of m and M and with b and K of
    ``solref`` the law is F = d (b v + d K r)/(1/m + 1/M), by which the heavy end is a damped
    oscillator. So far beyond its range d is 0.95. The light end passes the surface within steps,
    which is an error of first order.
    """
    share = 0.95 * LIGHT / (LIGHT + HEAVY)
    damping = 2.0 / (0.95 * 0.02)
    stiffness = 0.95 / (0.95 * 0.02) ** 2
    half = share * damping / 2.0
    rate = np.sqrt(share * stiffness - half**2)
    time, beyond = 0.1, FAR - NEAR - 0.5
    left = np.cos(rate * time) + half / rate * np.sin(rate * time)
    reached = beyond * (np.exp(-half * time) * left - 1.0)
    dt = DT / 4.0
    model = model_of(through_ball('range="0 0.5"'))
    path, solver = run(model, round(time / dt), dt=dt, scheme=scheme, compliant_contacts=True)
    assert path[-1, RIGHT] == pytest.approx(reached, rel=0.02)
    assert np.abs(path[:, LEFT]).max() < 0.01
    assert solver.status.bounded_steps[0] == 0


def test_a_tendon_beyond_its_limit_is_brought_back_where_its_path_is_shortest() -> None:
    """The heavy end has to come in by all of it, without a velocity.

    Bound: the light end moves there and back by 2 cm, what a recovery takes out of a length.
    """
    path, _ = run(model_of(through_ball('range="0 0.5"')), 400)
    assert path[-1, RIGHT] == pytest.approx(NEAR + 0.5 - FAR, abs=1.0e-4)
    assert np.abs(path[:, LEFT]).max() < 0.021


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
@pytest.mark.parametrize("up", [True, False])
def test_an_end_passes_a_place_where_its_path_jumps_as_in_mujoco(scheme: str, up: bool) -> None:
    """By a side site it goes around a ball, and straight from where its end is within the ball.

    Within a step no jump of the length counts as a motion: a damper does not stop the end there.
    """
    text = f"""
    <mujoco><compiler angle="radian"/><worldbody>
      <geom name="ball" size="0.1" contype="0" conaffinity="0"/>
      <site name="above" pos="0 0 0.5"/><site name="aside" pos="-0.3 0 0"/>
      <body pos="0.02 0 {-0.15 if up else -0.05}"><joint type="slide" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="1" diaginertia="0.3 0.5 0.4"/><site name="end"/></body>
      <body pos="0 3 0"><joint type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 0" mass="1" diaginertia="0.3 0.5 0.4"/></body>
    </worldbody><tendon><spatial stiffness="20" damping="5" springlength="0.6">
      <site site="above"/><geom geom="ball" sidesite="aside"/><site site="end"/>
    </spatial></tendon></mujoco>"""
    native = mujoco.MjModel.from_xml_string(text)
    native.opt.timestep, native.opt.gravity[2] = 1.0e-4, 0.0
    now = mujoco.MjData(native)
    mujoco.mj_forward(native, now)
    began = now.ten_length[0]
    now.qvel[0] = 1.0 if up else -1.0
    mujoco.mj_step(native, now, 1500)
    rates = (1.0 if up else -1.0, 0.0)
    q, _ = run(model_of(text), 150, start=(0.0, 0.0), rates=rates, scheme=scheme)
    assert abs(now.ten_length[0] - began) > 0.5 * abs(now.qpos[0]) + 0.02
    assert abs(now.qpos[0]) > 0.07
    assert q[-1, 0] == pytest.approx(now.qpos[0], abs=1.0e-3)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_an_end_on_a_spring_swings_through_where_its_path_is_shortest(scheme: str) -> None:
    """As in MuJoCo with steps that are a fiftieth.

    Bounds: the heavy end's way is of first order where the light one passes the surface.
    """
    time, text = 0.2, through_ball('springlength="0 0.5" stiffness="200"')
    start = (0.0, -0.1, 0.0)
    path, solver = run(model_of(text), round(time / DT), start=start, scheme=scheme)
    native = mujoco.MjModel.from_xml_string(text)
    native.opt.timestep = DT / 50.0
    native.opt.gravity = 0.0
    now = mujoco.MjData(native)
    now.qpos[:] = start
    while now.time < time - 0.5 * native.opt.timestep:
        mujoco.mj_step(native, now)
    assert path[-1, RIGHT] == pytest.approx(now.qpos[RIGHT], rel=0.01)
    assert np.ptp(path[:, LEFT]) > 0.15
    assert solver.status.bounded_steps[0] == 0


def test_friction_loss_holds_a_tendon_and_then_slips() -> None:
    """Of a pull below it nothing moves, above it what it leaves accelerates the weight."""
    tendon = """<spatial name="cord" frictionloss="2"><site site="left"/><site site="pulley_left"/>
    </spatial>"""
    model = model_of(file(tendon, '<motor tendon="cord"/>'))
    held, _ = run(model, 100, -1.9)
    np.testing.assert_allclose(held[:, LEFT], 0.0, atol=1.0e-6)
    slips, _ = run(model, 100, -5.0, scheme="euler")
    assert slips[-1, LEFT] == pytest.approx(3.0 / 3.0 * 0.1 * (0.1 + DT) / 2.0, rel=1.0e-3)


SPRUNG = (
    SCENE.replace('name="left" type="slide"', 'name="left" type="slide" springref="-0.2"')
    .replace('name="right" type="slide"', 'name="right" type="slide" ref="0.3" springref="0.1"')
    .replace('name="hinge"', 'name="hinge" springref="0.7"')
)
"""The scene with springs of joints, none of which pulls, at rest away from the reference."""


def test_a_tendon_of_no_given_length_rests_where_the_springs_of_joints_do() -> None:
    """Lengths are those that MuJoCo's compiler finds, and an equality counts from the reference.

    Bounds: float32 of a meter.
    """
    kinds = BOTH.format(has="") + OVER_DRUM.format(has="") + ROPE.format(has="")
    text = SPRUNG.format(tendon=kinds, actuator="", equality="")
    native = mujoco.MjModel.from_xml_string(text)
    cords = SolverAVBD(model_of(text))._actuation._cords
    rest = native.tendon_lengthspring[:, 0]
    np.testing.assert_allclose(cords.arrays.spring_rest.numpy(), rest, atol=1.0e-6)
    np.testing.assert_allclose(cords.arrays.rest.numpy(), native.tendon_length0, atol=1.0e-6)
    assert np.sum(np.abs(rest - native.tendon_length0) > 0.05) == 3


@pytest.mark.parametrize("kind", ["spatial", "fixed"])
def test_a_stiff_spring_of_a_tendon_brings_a_weight_to_where_its_joint_rests(kind: str) -> None:
    """A step of backward Euler leaves (1 + h^2 k/m)^-1/2 = 17 % of the swing. Bound: what sweeps
    leave of 0.2 m."""
    tendon = {
        "spatial": """<spatial stiffness="1e8"><site site="left"/><site site="pulley_left"/>
        </spatial>""",
        "fixed": """<fixed stiffness="1e8"><joint joint="left" coef="-1"/></fixed>
        <spatial><site site="behind"/><site site="above"/></spatial>""",
    }[kind]
    model = model_of(SPRUNG.format(tendon=tendon, actuator="", equality=""))
    q, _ = run(model, 50, scheme="euler")
    assert q[-1, LEFT] == pytest.approx(-0.2, abs=1.0e-5)


def test_armature_adds_to_the_inertia_along_a_tendon() -> None:
    """a = f/(m + armature), where the moment is 1."""
    tendon = """<spatial name="cord" armature="2"><site site="left"/><site site="pulley_left"/>
    </spatial>"""
    q, _ = run(model_of(file(tendon, '<motor tendon="cord"/>')), 100, -5.0, scheme="euler")
    assert q[-1, LEFT] == pytest.approx(5.0 / (3.0 + 2.0) * 0.1 * (0.1 + DT) / 2.0, rel=1.0e-3)


@pytest.mark.parametrize(
    ("dt", "settings"),
    [
        (5.0e-4, {"scheme": "euler"}),
        (5.0e-4, {"scheme": "generalized_alpha"}),
        (5.0e-3, {"accuracy": 1.0e-4}),
    ],
    ids=str,
)
def test_armature_of_a_tendon_stores_energy_as_its_path_turns(dt: float, settings: dict) -> None:
    """(I + armature (dL/dq)^2) q'^2 is constant while an arm swings by 1.4 rad.

    dL/dq goes from 0.24 to 0.02 m meanwhile. Bound: a step turns the arm by 0.0015 rad.
    """
    tendon = '<spatial armature="8"><site site="above"/><site site="tip"/></spatial>'
    model = model_of(file(tendon))
    q, _ = run(model, round(0.4 / dt), rates=(3.0, 0.0, 0.0), dt=dt, **settings)
    angle = np.array([0.0, *q[:, ARM]])

    def moment(at: float) -> float:
        to = 0.4 * np.array([np.cos(at), -np.sin(at)]) - [0.0, 0.3]
        return float(to @ (0.4 * np.array([-np.sin(at), -np.cos(at)])) / np.linalg.norm(to))

    rate = (angle[-1] - angle[-3]) / (2.0 * dt)
    inertia = [0.5 + 8.0 * moment(at) ** 2 for at in (0.0, angle[-2])]
    assert inertia[1] < 0.6 * inertia[0]
    assert inertia[1] * rate**2 == pytest.approx(inertia[0] * 3.0**2, rel=2.0e-3)


def test_armature_of_a_tendon_couples_the_articulations_that_it_spans() -> None:
    """A pull f on a rope of the moments J: a = (M + J^T armature J)^-1 J^T f.

    MuJoCo drops the terms between branches of the tree, and has 1 and 5/3 m/s^2 here.
    """
    model = model_of(file(ROPE.format(has='armature="2"'), '<motor tendon="rope"/>'))
    assert model.articulation_count == 3
    q, _ = run(model, 100, -5.0, scheme="euler")
    way = 0.1 * (0.1 + DT) / 2.0
    moments = np.array([-1.0, -1.0])
    inertia = np.diag([3.0, 1.0]) + 2.0 * np.outer(moments, moments)
    expected = np.linalg.solve(inertia, -5.0 * moments) * way
    np.testing.assert_allclose(q[-1, [LEFT, RIGHT]], expected, rtol=1.0e-3)


def test_armature_of_an_actuator_adds_to_that_of_its_tendon() -> None:
    """By the square of its gear: a = g f/(m + g^2 armature)."""
    tendon = '<spatial name="cord"><site site="left"/><site site="pulley_left"/></spatial>'
    motor = '<motor tendon="cord" gear="2" armature="0.5"/>'
    q, _ = run(model_of(file(tendon, motor)), 100, -5.0, scheme="euler")
    assert q[-1, LEFT] == pytest.approx(10.0 / (3.0 + 2.0) * 0.1 * (0.1 + DT) / 2.0, rel=1.0e-3)


def test_armature_of_a_tendon_is_part_of_the_mass_of_a_damping_ratio() -> None:
    """A position actuator of kp = k is damped critically: q = u (1 - (1 + w t) e^(-w t))."""
    tendon = '<fixed name="one" armature="5"><joint joint="left" coef="1"/></fixed>'
    servo = '<position tendon="one" kp="800" dampratio="1"/>'
    q, _ = run(model_of(file(tendon, servo)), 200, 0.1)
    turned = np.sqrt(800.0 / (3.0 + 5.0)) * DT * np.arange(1, 201)
    expected = 0.1 * (1.0 - (1.0 + turned) * np.exp(-turned))
    np.testing.assert_allclose(q[:, LEFT], expected, atol=1.0e-4)


@pytest.mark.parametrize("at", ["joint", "tendon"])
def test_soft_limits_count_the_armature_of_tendons(at: str) -> None:
    """As MuJoCo's, whose limits push by the inertia in the reference pose."""
    tendon = """<spatial name="cord" armature="5" {has}><site site="left"/>
    <site site="pulley_left"/></spatial>"""
    ends = {"joint": ("-0.1 9", ""), "tendon": ("-9 9", 'limited="true" range="0 1.1"')}[at]
    text = file(tendon.format(has=ends[1]))
    slide = '<joint name="left" type="slide"'
    text = text.replace(slide, f'{slide} limited="true" range="{ends[0]}"')
    native = mujoco.MjModel.from_xml_string(text)
    native.opt.timestep, native.opt.gravity[2] = 1.0e-4, -G
    now = mujoco.MjData(native)
    mujoco.mj_step(native, now, 5000)
    q, _ = run(model_of(text, G), 500, compliant_contacts=True)
    assert now.qpos[LEFT] < -0.1
    assert q[-1, LEFT] == pytest.approx(now.qpos[LEFT], abs=1.0e-4)


@pytest.mark.parametrize("compliant_contacts", [False, True])
def test_a_tendon_within_one_body_moves_nothing(compliant_contacts: bool) -> None:
    """However far it is beyond its limit: its length stays. The arm turns as without it."""
    tendon = """<spatial name="own" limited="true" range="0.9 1" stiffness="2e4">
    <site site="tip"/><site site="elbow"/><pulley divisor="2"/>
    <site site="left"/><site site="left"/></spatial>"""
    q, _ = run(
        model_of(file(tendon), G),
        200,
        rates=(2.0, 0.0, 0.0),
        compliant_contacts=compliant_contacts,
    )
    np.testing.assert_allclose(q[:, ARM], 2.0 * DT * np.arange(1, 201), rtol=1.0e-4)
    assert q[-1, LEFT] == pytest.approx(-0.5 * G * 0.2**2, rel=1.0e-3)


def test_an_equality_leads_a_tendon_by_a_polynomial_of_another_one() -> None:
    """The cord of the left weight is 2 d + d^2 longer where that of the right one is d longer."""
    tendon = """<spatial name="one"><site site="left"/><site site="pulley_left"/></spatial>
    <fixed name="other"><joint joint="right" coef="1"/></fixed>"""
    equality = '<tendon tendon1="one" tendon2="other" polycoef="0 2 1 0 0"/>'
    q, _ = run(model_of(file(tendon, equality=equality), G), 300)
    d = q[:, RIGHT]
    np.testing.assert_allclose(-q[:, LEFT], 2.0 * d + d**2, atol=2.0e-6)
    assert q[-1, LEFT] < -0.1


def test_a_force_range_of_a_tendon_bounds_its_actuators() -> None:
    tendon = """<spatial name="cord" actuatorfrcrange="-2 2"><site site="left"/>
    <site site="pulley_left"/></spatial>"""
    actuator = '<position tendon="cord" kp="1e6" kv="1e3"/>'
    q, _ = run(model_of(file(tendon, actuator)), 100, 0.0, scheme="euler")
    assert q[-1, LEFT] == pytest.approx(2.0 / 3.0 * 0.1 * (0.1 + DT) / 2.0, rel=1.0e-3)


@pytest.mark.parametrize(
    ("gears", "force"),
    [((3,), 3.0 * 2.0), ((-3,), -3.0 * 2.0), ((3, 3), 3.0 * 2.0), ((3, 1), (3.0 + 1.0) * 1.0)],
)
def test_a_force_range_of_a_tendon_is_before_the_gears(
    gears: tuple[int, ...], force: float
) -> None:
    """Motors of 50 N each; of two with other gears each gives its share, as in MuJoCo."""
    tendon = """<spatial name="cord" actuatorfrcrange="-2 2"><site site="left"/>
    <site site="pulley_left"/></spatial>"""
    motors = "".join(f'<motor tendon="cord" gear="{gear}"/>' for gear in gears)
    q, _ = run(model_of(file(tendon, motors)), 100, -50.0, scheme="euler")
    assert q[-1, LEFT] == pytest.approx(force / 3.0 * 0.1 * (0.1 + DT) / 2.0, rel=1.0e-3)


@pytest.mark.parametrize("settings", [{}, {"parallel": "bodies"}, {"accuracy": 1.0}])
@pytest.mark.parametrize(("most", "has"), [(9.0, ""), (0.6, 'forcerange="-0.6 0.6"')])
@pytest.mark.parametrize(
    ("cord", "sign"),
    [
        ('<fixed name="cord"><joint joint="left" coef="1"/></fixed>', 1.0),
        (
            """<spatial name="cord"><site site="left"/><site site="pulley_left"/></spatial>""",
            -1.0,
        ),
    ],
)
def test_a_motor_acts_as_its_control_changes(
    cord: str, sign: float, most: float, has: str, settings: dict
) -> None:
    """Not half a step late, also of second order, where a control jumps in each step.

    What is left is of the first steps, which follow no smooth motion.
    """
    dt = 1.0 / 60.0
    model = model_of(file(cord, f'<motor tendon="cord" {has}/>'))
    solver = SolverAVBD(model, update_joint_state=True, **settings)
    state, control = model.state(), model.control()
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    at, speed = 0.0, 0.0
    for k in range(40):
        push = np.sin(0.5 * k) + 0.3
        control.mujoco.ctrl.fill_(push)
        solver.step(state, state, control, None, dt)
        faster = sign * np.clip(push, -most, most) / 3.0 * dt
        at, speed = at + (speed + 0.5 * faster) * dt, speed + faster
    assert state.joint_q.numpy()[LEFT] == pytest.approx(at, abs=4.0e-5)
    assert abs(at) > 1.0e-2


def test_random_paths_have_the_lengths_and_moments_of_mujoco() -> None:
    """Spheres and cylinders, with side sites outside, inside and without, and pulleys.

    Bounds: float32 of some meters.
    """
    rng = np.random.default_rng(1)
    parts, paths, count = "", "", 120
    for i in range(count):
        start, end, side = (0.5 * rng.normal(size=3) for _ in range(3))
        radius, turn = rng.uniform(0.05, 0.3), rng.uniform(-3.0, 3.0, 3)
        side *= 0.2 * radius if i % 4 == 3 else 0.8
        kind, size = ("sphere", f"{radius}") if i % 2 else ("cylinder", f"{radius} 0.3")
        at = {name: " ".join(map(str, v)) for name, v in (("p", start), ("q", end), ("s", side))}
        parts += f"""<site name="p{i}" pos="{at["p"]}"/><site name="s{i}" pos="{at["s"]}"/>
        <geom name="g{i}" type="{kind}" size="{size}" euler="{" ".join(map(str, turn))}"/>
        <body pos="{at["q"]}"><freejoint/><geom type="sphere" size="0.01" mass="1"/>
        <site name="q{i}" pos="0.02 0.01 0"/></body>"""
        around = f'sidesite="s{i}"' if i % 4 >= 2 else ""
        pulley = '<pulley divisor="2"/>' if i % 5 == 0 else ""
        paths += f"""<spatial>{pulley}<site site="p{i}"/><geom geom="g{i}" {around}/>
        <site site="q{i}"/></spatial>"""
    text = f"""<mujoco><compiler angle="radian"/><worldbody>{parts}</worldbody>
    <tendon>{paths}</tendon></mujoco>"""
    native = mujoco.MjModel.from_xml_string(text)
    now = mujoco.MjData(native)
    mujoco.mj_forward(native, now)
    moments = np.zeros((count, native.nv))
    rows = (native.ten_J_rownnz, native.ten_J_rowadr, native.ten_J_colind)
    mujoco.mju_sparse2dense(moments, now.ten_J, *rows)
    cords = SolverAVBD(model_of(text))._actuation._cords
    assert np.sum(now.ten_wrapnum > 2 + 2 * (np.arange(count) % 5 == 0)) > count / 4
    np.testing.assert_allclose(cords.arrays.rest.numpy(), now.ten_length, atol=1.0e-6)
    linear = (np.arange(native.nv) % 6) < 3
    np.testing.assert_allclose(cords.moments()[:, linear], moments[:, linear], atol=2.0e-6)


def test_a_path_straight_through_the_center_of_a_ball_goes_the_way_of_mujoco() -> None:
    """All ways around are as short. Along an axis of the ball MuJoCo goes between the others."""
    parts, paths = "", ""
    for i in range(6):
        at = np.zeros(3)
        at[i // 2] = 0.5
        start, end = (" ".join(map(str, sign * at)) for sign in (1.0, -1.0))
        parts += f"""<site name="p{i}" pos="{start}"/><geom name="g{i}" size="0.1"/>
        <site name="s{i}" pos="0.1 0.2 0.3"/>
        <body pos="{end}"><freejoint/><geom size="0.01" mass="1"/><site name="q{i}"/></body>"""
        side = f'sidesite="s{i}"' if i % 2 else ""
        paths += f"""<spatial><site site="p{i}"/><geom geom="g{i}" {side}/><site site="q{i}"/>
        </spatial>"""
    text = f"<mujoco><worldbody>{parts}</worldbody><tendon>{paths}</tendon></mujoco>"
    native = mujoco.MjModel.from_xml_string(text)
    now = mujoco.MjData(native)
    mujoco.mj_forward(native, now)
    moments = np.zeros((6, native.nv))
    rows = (native.ten_J_rownnz, native.ten_J_rowadr, native.ten_J_colind)
    mujoco.mju_sparse2dense(moments, now.ten_J, *rows)
    found = SolverAVBD(model_of(text))._actuation._cords.moments()
    np.testing.assert_allclose(found, moments, atol=2.0e-6)


PATH = '<spatial name="cord" {has}><site site="left"/>{rest}<site site="right"/></spatial>'


@pytest.mark.parametrize(
    ("tendon", "actuator", "spoil", "says"),
    [
        ('<spatial name="cord"><site site="left"/></spatial>', "", None, "fewer than two sites"),
        (
            PATH.format(has="", rest='<geom geom="drum"/>'),
            "",
            ("tendon_wrap_shape", 1, 99),
            r"none of the model's .* shapes",
        ),
        (
            PATH.format(has="", rest='<geom geom="drum"/>'),
            "",
            ("tendon_wrap_type", 0, 1),
            r"fewer than two sites|from no site",
        ),
        (PATH.format(has='stiffness="1"', rest=""), "", ("tendon_stiffness", 0, np.nan), "finite"),
        (
            PATH.format(has="", rest=""),
            '<muscle tendon="cord"/>',
            None,
            r"has no length range.*MjModel",
        ),
    ],
)
def test_what_makes_no_sense_is_named(
    tendon: str, actuator: str, spoil: tuple[str, int, float] | None, says: str
) -> None:
    model = model_of(file(tendon, actuator))
    if spoil is not None:
        array = getattr(model.mujoco, spoil[0])
        values = array.numpy()
        values[spoil[1]] = spoil[2]
        array.assign(values)
    with pytest.raises(ValueError, match=says) as error:
        SolverAVBD(model)
    assert "cord" in str(error.value) or actuator


def test_bodies_one_by_one_have_no_tendons_and_say_so() -> None:
    model = model_of(file(ROPE.format(has="")))
    with pytest.raises(NotImplementedError, match=r"'rope'.*blocks='articulation'"):
        SolverAVBD(model, blocks="body")
    assert not SolverAVBD(model, blocks="body", effects={"tendons": False}).effects["tendons"].on


def test_tendons_are_an_effect_with_a_reason() -> None:
    effects = SolverAVBD(model_of(file(ROPE.format(has="")))).effects
    assert effects["spatial_tendons"].on and "'worldbody/left'" in effects["tendons"].why
    assert effects["tendons"].bytes > 0
