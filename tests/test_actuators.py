# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's actuators, gravity compensation and fixed tendons push as their formulas say."""

import warnings
from pathlib import Path

import mujoco
import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, G
from newton.solvers import SolverMuJoCo
from numpy.typing import NDArray

from newton_avbd import SolverAVBD
from newton_avbd.model.inertia import reference_mobility

DT = 1.0 / 1000.0
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="arm" {body}>
      <joint name="hinge" type="hinge" axis="0 1 0" {joint}/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.3 0.5 0.4"/>
    </body>
    <body name="other">
      <joint name="slide" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.3 0.5 0.4"/>
    </body>
  </worldbody>
  {tendon}
  <actuator>{actuator}</actuator>
</mujoco>
"""
INERTIA = 0.5
"""Of the arm about its hinge [kg m^2]."""


def scene(
    actuator: str = "", *, worlds: int = 1, gravity: float = 0.0, **parts: str
) -> newton.Model:
    """An arm on a hinge through its COM, and a slider beside it."""
    one = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(one)
    slots = {"body": "", "joint": "", "tendon": "", "actuator": actuator} | parts
    one.add_mjcf(ARM.format(**slots), ctrl_direct=True)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -gravity))
    builder.replicate(one, worlds)
    return builder.finalize(device="cpu")


def advance(
    model: newton.Model,
    solver: SolverAVBD,
    ctrl: list[float],
    steps: int,
    state: newton.State | None = None,
) -> tuple[NDArray[np.float64], newton.State]:
    """Coordinates after each step, shape (steps, coordinates), and the last state."""
    control = model.control()
    if ctrl:
        control.mujoco.ctrl.assign(np.array(ctrl, dtype=np.float32))
    if state is None:
        state = model.state()
        newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    path = []
    for _ in range(steps):
        state.clear_forces()
        solver.step(state, state, control, None, DT)
        path.append(state.joint_q.numpy().astype(float))
    return np.array(path), state


def coordinates(model: newton.Model, ctrl: list[float], steps: int, **settings: object):
    """As :func:`advance`, with a solver of its own."""
    return advance(model, SolverAVBD(model, update_joint_state=True, **settings), ctrl, steps)[0]


def test_a_motor_with_gear_accelerates_its_hinge() -> None:
    """q = g u t^2/(2 I); backward Euler adds g u t dt/(2 I). Bound: rounding of 400 steps."""
    q = coordinates(scene('<motor joint="hinge" gear="3"/>'), [0.1], 400, scheme="euler")[-1, 0]
    assert q == pytest.approx(3.0 * 0.1 / (2.0 * INERTIA) * 0.4 * (0.4 + DT), rel=1.0e-4)


def test_a_damper_on_hinges_at_the_pole_stays_finite() -> None:
    """Where the outer two of three hinges are parallel, poses tell no rates of them."""
    hinges = "".join(
        f'<joint name="{name}" type="hinge" axis="{axis}"/>'
        for name, axis in (("first", "0 0 -1"), ("middle", "-1 0 0"), ("last", "0 1 0"))
    )
    dampers = "".join(f'<damper joint="{name}" kv="1"/>' for name in ("first", "middle", "last"))
    one = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(one)
    inertial = '<inertial pos="0 0 0" mass="2" diaginertia="0.3 0.5 0.4"/>'
    one.add_mjcf(
        f"<mujoco><worldbody><body>{hinges}{inertial}</body></worldbody>"
        f"<actuator>{dampers}</actuator></mujoco>",
        ctrl_direct=True,
    )
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    builder.replicate(one, 64)
    model = builder.finalize(device="cpu")
    angles = np.random.default_rng(1).uniform(-1.5, 1.5, (64, 3))
    angles[:, 1] = 0.5 * np.pi
    model.joint_q.assign(angles.ravel().astype(np.float32))
    solver = SolverAVBD(model, update_joint_state=True)
    advance(model, solver, [1.0] * (3 * 64), 20)
    assert not np.any(solver.status.held_steps)


def test_several_actuators_of_an_axis_add() -> None:
    actuators = '<motor joint="hinge" gear="3"/><motor joint="hinge" gear="-1"/>'
    two = coordinates(scene(actuators), [0.1, 0.2], 50)
    one = coordinates(scene('<motor joint="hinge"/>'), [0.1], 50)
    np.testing.assert_allclose(two, one, atol=1.0e-6)


def test_control_is_clamped_to_its_range() -> None:
    limited = coordinates(scene('<motor joint="hinge" ctrlrange="-1 0.2"/>'), [5.0], 20)
    np.testing.assert_array_equal(limited, coordinates(scene('<motor joint="hinge"/>'), [0.2], 20))


@pytest.mark.parametrize("kp", [50.0, 1.0e7])
def test_a_position_actuator_pushes_within_its_force_range(kp: float) -> None:
    """On the way to its target it accelerates by the limit, however stiff; backward Euler."""
    actuator = f'<position joint="hinge" kp="{kp}" kv="{kp / 100.0}" forcerange="-0.2 0.5"/>'
    q = coordinates(scene(actuator), [1.0], 400, scheme="euler")[-1, 0]
    assert q == pytest.approx(0.5 / (2.0 * INERTIA) * 0.4 * (0.4 + DT), rel=1.0e-3)


@pytest.mark.parametrize(("load", "gives"), [(0.3, 0.0), (0.7, 0.2)])
def test_a_stiff_servo_holds_what_its_force_range_allows(load: float, gives: float) -> None:
    """Beyond it gives way to the rest of the load. Bound: load / kp, and rounding."""
    servo = '<position joint="hinge" kp="1e6" forcerange="-0.5 0.5"/>'
    q = coordinates(scene(f'{servo}<motor joint="hinge"/>'), [0.0, load], 400, scheme="euler")[
        -1, 0
    ]
    expected = gives / (2.0 * INERTIA) * 0.4 * (0.4 + DT)
    assert q == pytest.approx(expected, rel=1.0e-3, abs=1.0e-6)


def test_a_force_range_need_not_be_symmetric() -> None:
    """Of a range from 0.1 up the actuator pushes with 0.1 at least."""
    actuator = '<position joint="hinge" kp="50" forcerange="0.1 0.5"/>'
    q = coordinates(scene(actuator), [-1.0], 400, scheme="euler")[-1, 0]
    assert q == pytest.approx(0.1 / (2.0 * INERTIA) * 0.4 * (0.4 + DT), rel=1.0e-4)


def test_a_force_range_leaves_the_drives_of_other_axes() -> None:
    """A critically damped drive of 20 rad/s is at its target after 1 s, but for 20 e^-20."""
    model = scene('<position joint="hinge" kp="50" forcerange="-0.2 0.5"/>')
    for name, value in (("mode", 1), ("ke", 800.0), ("kd", 80.0)):
        array = getattr(model, f"joint_target_{name}")
        array.assign(np.array([0, value], dtype=array.numpy().dtype))
    model.joint_target_q.assign(np.array([0.0, 0.3], dtype=np.float32))
    q = coordinates(model, [0.0], 1000)[-1, 1]
    assert q == pytest.approx(0.3, abs=1.0e-5)


TWO_RANGES = (
    '<position joint="hinge" kp="20" forcerange="-9 9"/>'
    '<velocity joint="hinge" kv="2" forcerange="-1 1"/>'
)


def test_actuators_with_ranges_of_their_own_act_in_full_in_their_step() -> None:
    """A position and a velocity actuator of a hinge, whose targets jump in each step.

    Against I q'' = clip(kp (u - q)) + clip(kv (u - q')), integrated in 200 parts of a step; both
    are at the ends of their ranges for a part of the time.
    """
    h, targets = 1.0 / 240.0, np.random.default_rng(0).uniform(-1.0, 1.0, 240)
    model = scene(TWO_RANGES)
    q, v, path = 0.0, 0.0, []
    for u in targets:
        for _ in range(200):  # the midpoint rule
            part = h / 200.0
            middle = q + 0.5 * part * v, v + 0.5 * part * two_forces(u, q, v) / INERTIA
            q += part * middle[1]
            v += part * two_forces(u, *middle) / INERTIA
        path.append(q)
    off = {}
    for scheme in ("generalized_alpha", "euler"):
        solver = SolverAVBD(model, update_joint_state=True, scheme=scheme)
        state, control, places = model.state(), model.control(), []
        newton.eval_fk(model, model.joint_q, model.joint_qd, state)
        for u in targets:
            control.mujoco.ctrl.fill_(u)
            solver.step(state, state, control, None, h)
            places.append(state.joint_q.numpy()[0])
        off[scheme] = np.abs(np.array(places) - path).max()
    assert off["generalized_alpha"] < 0.05 * off["euler"]


def two_forces(u: float, q: float, v: float) -> float:
    """Of both actuators [N m]."""
    return np.clip(20.0 * (u - q), -9.0, 9.0) + np.clip(2.0 * (u - v), -1.0, 1.0)


def test_a_checkpoint_and_a_changed_model_keep_what_ranged_actuators_pushed_with() -> None:
    """Where targets have jumped, the next steps are the same bits, with another solver or not."""
    model = scene(TWO_RANGES)

    def go_on(solver: SolverAVBD, state: newton.State, targets: list[float]) -> NDArray[np.float32]:
        for target in targets:
            advance(model, solver, [target, target], 1, state)
        return state.joint_q.numpy()

    solver = SolverAVBD(model, update_joint_state=True)
    state, copy = model.state(), model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    go_on(solver, state, [0.3, -0.8, 0.1, 0.9])
    copy.assign(state)
    other = SolverAVBD(model, update_joint_state=True)
    other.restore(solver.checkpoint())
    other.notify_model_changed(newton.ModelFlags.ALL)
    last = [-0.7, 0.2, 0.6]
    np.testing.assert_array_equal(go_on(other, copy, last), go_on(solver, state, last))


def test_ranged_actuators_go_on_after_a_control_that_is_not_finite() -> None:
    """It holds its world for that step. Five seconds later all is where it would be, also where a
    range has one end only."""
    model, ends = scene(TWO_RANGES), []
    model.mujoco.actuator_forcerange.assign(np.array([[-np.inf, 9.0], [-1.0, 1.0]], np.float32))
    for bad in (0.5, np.nan):
        solver = SolverAVBD(model, update_joint_state=True)
        _, state = advance(model, solver, [0.5, 0.5], 1)
        advance(model, solver, [bad, bad], 1, state)
        path, _ = advance(model, solver, [0.5, 0.5], 5000, state)
        ends.append(path[-1, 0])
    assert ends[1] == pytest.approx(ends[0], abs=1.0e-3)


@pytest.mark.parametrize(("load", "gives"), [(0.6, 0.0), (0.9, 0.2)])
def test_two_stiff_servos_hold_what_both_force_ranges_allow(load: float, gives: float) -> None:
    """Ranges of 0.5 and 0.2 N m share an axis; beyond both it gives way to the rest."""
    servo = '<position joint="hinge" kp="1e6" forcerange="-{0} {0}"/>'
    actuators = servo.format(0.5) + servo.format(0.2) + '<motor joint="hinge"/>'
    model = scene(actuators)
    assert SolverAVBD(model).effects["force_ranges"].on
    q = coordinates(model, [0.0, 0.0, load], 400, scheme="euler")[-1, 0]
    expected = gives / (2.0 * INERTIA) * 0.4 * (0.4 + DT)
    assert q == pytest.approx(expected, rel=1.0e-3, abs=1.0e-6)


def test_the_axis_limits_the_sum_of_its_actuators() -> None:
    """``actuatorfrcrange`` bounds what a servo and a motor push with together."""
    model = scene(
        '<position joint="hinge" kp="50"/><motor joint="hinge"/>',
        joint='actuatorfrcrange="-0.3 0.3"',
    )
    q = coordinates(model, [1.0, 0.5], 400, scheme="euler")[-1, 0]
    assert q == pytest.approx(0.3 / (2.0 * INERTIA) * 0.4 * (0.4 + DT), rel=1.0e-4)


def test_a_servo_with_gear_follows_the_implicit_law() -> None:
    """(I/h^2 + g^2 (kp + kd/h)) dq = g (kp u - kp g q) + I v/h, in each step."""
    kp, kv, gear, u = 200.0, 5.0, 2.0, 0.7
    q = coordinates(
        scene(f'<position joint="hinge" kp="{kp}" kv="{kv}" gear="{gear}"/>'),
        [u],
        200,
        scheme="euler",
    )[:, 0]
    at, v = 0.0, 0.0
    for found in q:
        push = gear * (kp * u - kp * gear * at) + INERTIA * v / DT
        moved = push / (INERTIA / DT**2 + gear**2 * (kp + kv / DT))
        at, v = at + moved, moved / DT
        assert found == pytest.approx(at, abs=2.0e-6)


SPEED_LAWS = {
    # I w' = kv (u - w)
    '<velocity joint="hinge" kv="1"/>': ([2.0], 1.0, 2.0),
    # and 3 c w less of a damper
    '<velocity joint="hinge" kv="1"/><damper joint="hinge" kv="3" ctrlrange="0 1"/>': (
        [2.0, 0.5],
        2.5,
        2.0 / 2.5,
    ),
}
"""Controls, damping [N m s/rad] and final speed [rad/s] of a hinge, by actuators."""


@pytest.mark.parametrize("actuators", SPEED_LAWS)
def test_actuators_that_hold_a_speed_reach_it_by_an_exponential(actuators: str) -> None:
    """q' = w + (v - w) exp(-t/T) with T = I/k, from a first step of backward Euler on, which ends
    at v = w h/(T + h) and goes by the mean of its velocities."""
    ctrl, damping, speed = SPEED_LAWS[actuators]
    q = coordinates(scene(actuators), ctrl, 400)[:, 0]
    t, scale = DT * np.arange(400), INERTIA / damping
    first = speed * DT / (scale + DT)
    exact = 0.5 * DT * first + speed * t
    exact += (first - speed) * scale * (1.0 - np.exp(-t / scale))
    np.testing.assert_allclose(q, exact, atol=1.0e-3 * DT)


def test_an_integrated_velocity_is_the_target_of_a_spring() -> None:
    """I q'' = kp (u t - q): q = u (t - sin(w t)/w) with w^2 = kp/I, half a step late: the
    activation of the start of a step holds in it, as in MuJoCo."""
    actuator = '<intvelocity joint="hinge" kp="50" actrange="-10 10"/>'
    q = coordinates(scene(actuator), [3.0], 400)[:, 0]
    t, w = DT * (np.arange(400) + 0.5), np.sqrt(50.0 / INERTIA)
    np.testing.assert_allclose(q, 3.0 * (t - np.sin(w * t) / w), atol=0.05 * DT)


def activation(kind: str, steps: int, u: float) -> NDArray[np.float64]:
    """Activations at the start of each step, as MuJoCo integrates them."""
    a, found = 0.0, []
    for _ in range(steps):
        found.append(a)
        a = {
            "integrator": a + DT * u,
            "filter": a + DT * (u - a) / 0.1,
            "filterexact": u + (a - u) * np.exp(-DT / 0.1),
        }[kind]
    return np.array(found)


@pytest.mark.parametrize("kind", ["integrator", "filter", "filterexact"])
@pytest.mark.parametrize("early", [False, True])
def test_activation_drives_the_force(kind: str, early: bool) -> None:
    """The force is gain times activation at the start of the step, or at its end."""
    dynprm = "" if kind == "integrator" else 'dynprm="0.1"'
    actuator = (
        f'<general joint="hinge" dyntype="{kind}" {dynprm} gainprm="3" '
        f'actearly="{str(early).lower()}"/>'
    )
    q = coordinates(scene(actuator), [0.5], 300, scheme="euler")[-1, 0]
    force = 3.0 * activation(kind, 301, 0.5)[int(early) :][:300]
    expected = DT * DT / INERTIA * np.sum(np.cumsum(force))
    assert q == pytest.approx(expected, rel=2.0e-4)


def test_activation_stays_in_its_range_and_is_reset_and_restored() -> None:
    actuator = (
        '<general joint="hinge" dyntype="integrator" gainprm="1" actlimited="true" '
        'actrange="-1 0.01"/>'
    )
    model = scene(actuator, worlds=2)
    solver = SolverAVBD(model, update_joint_state=True)
    _, state = advance(model, solver, [1.0, 2.0], 100)
    found = solver.checkpoint()
    np.testing.assert_allclose(found["actuators.activation"], 0.01, rtol=1.0e-6)
    other = SolverAVBD(model, update_joint_state=True)
    other.restore(found)
    again = model.state()
    again.assign(state)
    one, _ = advance(model, solver, [1.0, 2.0], 5, state)
    two, _ = advance(model, other, [1.0, 2.0], 5, again)
    np.testing.assert_array_equal(one, two)
    solver.notify_model_changed(newton.ModelFlags.ALL)
    kept = solver.checkpoint()["actuators.activation"]
    np.testing.assert_array_equal(kept, found["actuators.activation"])
    mask = wp.array([True, False, False], dtype=wp.bool, device="cpu")
    solver.reset(state, mask)
    left = solver.checkpoint()["actuators.activation"]
    np.testing.assert_allclose(left, [0.0, 0.01], rtol=1.0e-6)


def test_activations_are_read_and_written() -> None:
    """In the order of controls; a graph starts from what is written, and filters it by (1 - h/T).

    The arm moves by gain times activation, h^2 u/I in the first step.
    """
    actuators = (
        '<motor joint="slide"/>'
        '<general joint="hinge" dyntype="filter" dynprm="0.1" gainprm="3" actlimited="true"'
        ' actrange="-1 1"/>'
    )
    model = scene(actuators)
    solver = SolverAVBD(model, scheme="euler")
    np.testing.assert_array_equal(solver.activations.numpy(), [0.0, 0.0])
    state, control = model.state(), model.control()
    solver.step(state, state, control, None, DT)
    with wp.ScopedCapture(device="cpu") as capture:
        solver.step(state, state, control, None, DT)
    solver.activations.assign([0.0, 0.5])
    wp.capture_launch(capture.graph)
    assert state.body_qd.numpy()[0, 4] == pytest.approx(3.0 * 0.5 / INERTIA * DT, rel=1.0e-4)
    left = [0.0, 0.5 * (1.0 - DT / 0.1)]
    np.testing.assert_allclose(solver.activations.numpy(), left, rtol=1.0e-6)
    solver.notify_model_changed(newton.ModelFlags.ALL)
    np.testing.assert_allclose(solver.activations.numpy(), left, rtol=1.0e-6)
    solver.reset(state)
    np.testing.assert_array_equal(solver.activations.numpy(), [0.0, 0.0])


def test_activations_of_a_scene_without_any_are_zeros() -> None:
    assert SolverAVBD(scene()).activations.shape == (0,)
    off = {"actuators": False}
    solver = SolverAVBD(scene('<motor joint="hinge"/>'), effects=off)
    np.testing.assert_array_equal(solver.activations.numpy(), [0.0])


def test_what_is_written_to_activations_stays_where_no_actuator_acts() -> None:
    """Until a reset; a checkpoint has it."""
    model = scene('<motor joint="hinge"/>', worlds=2)
    solver, other = (SolverAVBD(model, effects={"actuators": False}) for _ in range(2))
    state = model.state()
    solver.activations.assign([0.5, 0.25])
    solver.step(state, state, None, None, DT)
    np.testing.assert_array_equal(solver.activations.numpy(), [0.5, 0.25])
    other.restore(solver.checkpoint())
    np.testing.assert_array_equal(other.activations.numpy(), [0.5, 0.25])
    solver.reset(state, wp.array([True, False, False], dtype=wp.bool, device="cpu"))
    np.testing.assert_array_equal(solver.activations.numpy(), [0.0, 0.25])


def test_activations_go_on_where_links_come_apart() -> None:
    """The solver makes its arrays anew for another grouping of links, but for these."""
    pair = (
        '<worldbody><body><joint/><geom size="0.1"/><body name="tip"><geom size="0.1"/></body>'
        "</body></worldbody>"
    )
    model = scene('<general joint="hinge" dyntype="integrator"/>', tendon=pair)
    solver, state = SolverAVBD(model), model.state()
    activations = solver.activations
    activations.assign([0.5])
    solver.step(state, state, None, None, DT)
    is_fixed = model.joint_type.numpy() == int(newton.JointType.FIXED)
    assert is_fixed.sum() == 1 and solver.effects.flags.welds
    model.joint_enabled.assign(~is_fixed)
    solver.notify_model_changed(newton.ModelFlags.ALL)
    assert solver.activations is activations
    solver.step(state, state, None, None, DT)
    np.testing.assert_array_equal(activations.numpy(), [0.5])


def muscle_force(length: float) -> float:
    """Active force [N] of a muscle of 2 N at rest; [-1, 1] is its range [0.75, 1.05]."""
    unit = 2.0 / 0.3
    x = 0.75 + (length + 1.0) / unit
    a, b = 0.75, 1.3
    if x <= a:
        return 2.0 * 0.5 * ((x - 0.5) / 0.25) ** 2
    if x <= 1.0:
        return 2.0 * (1.0 - 0.5 * ((1.0 - x) / (1.0 - a)) ** 2)
    return 2.0 * (1.0 - 0.5 * ((x - 1.0) / (b - 1.0)) ** 2)


@pytest.mark.parametrize("at", [-0.8, 0.0, 0.6])
def test_a_muscle_pulls_by_its_force_length_curve(at: float) -> None:
    """First step from rest at full activation: -F_L(length). Bound: rounding of one step."""
    model = scene('<muscle joint="hinge" lengthrange="-1 1" force="2"/>')
    solver = SolverAVBD(model)
    solver.activations.fill_(1.0)
    state, control = model.state(), model.control()
    q = model.joint_q.numpy()
    q[0] = at
    newton.eval_fk(model, wp.array(q, device="cpu"), model.joint_qd, state)
    control.mujoco.ctrl.fill_(1.0)
    solver.step(state, state, control, None, DT)
    bias = 0.0 if at < 1.0 / 0.3 * 0.5 else np.nan
    acceleration = state.body_qd.numpy()[0, 4] / DT
    assert INERTIA * acceleration + bias == pytest.approx(-muscle_force(at), rel=2.0e-3)


def test_a_muscle_without_a_length_range_is_an_error_that_names_it() -> None:
    model = scene('<muscle name="biceps" joint="hinge"/>')
    with pytest.raises(ValueError, match=r"biceps.*lengthrange"):
        SolverAVBD(model)


def test_armature_of_an_actuator_is_inertia_by_gear_squared() -> None:
    q = coordinates(
        scene('<motor joint="hinge" gear="2" armature="0.1"/>'), [0.1], 400, scheme="euler"
    )[-1, 0]
    assert q == pytest.approx(0.2 / (2.0 * (INERTIA + 0.4)) * 0.4 * (0.4 + DT), rel=1.0e-4)


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_a_compensated_arm_weighs_less(share: float) -> None:
    """An arm off its hinge stays where it is put; in part compensated it falls by the rest."""
    model = scene(body=f'gravcomp="{share}"', gravity=G)
    com = model.body_com.numpy()
    com[0] = (0.2, 0.0, 0.0)
    model.body_com.assign(com)
    solver = SolverAVBD(model, update_joint_state=True, scheme="euler")
    assert solver.effects["gravity_compensation"].on
    q, _ = advance(model, solver, [], 50)
    whole = INERTIA + 2.0 * 0.2**2
    expected = (1.0 - share) * 2.0 * G * 0.2 / (2.0 * whole) * 0.05 * (0.05 + DT)
    assert abs(q[-1, 0]) == pytest.approx(expected, rel=2.0e-3, abs=1.0e-7)


def test_welded_links_are_compensated_each_at_its_own_com() -> None:
    """Of two welded links the heavy far one floats: the hinge feels the near one only."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -G))
    SolverMuJoCo.register_custom_attributes(builder)
    inertia = wp.mat33(np.diag((0.1, 0.1, 0.1)))
    near = builder.add_link(mass=1.0, inertia=inertia, com=wp.vec3(0.1, 0.0, 0.0))
    far = builder.add_link(mass=5.0, inertia=inertia, custom_attributes={"mujoco:gravcomp": 1.0})
    hinge = builder.add_joint_revolute(-1, near, axis=newton.Axis.Y)
    at = wp.transform(wp.vec3(0.6, 0.0, 0.0), wp.quat_identity())
    weld = builder.add_joint_fixed(near, far, parent_xform=at)
    builder.add_articulation([hinge, weld])
    model = builder.finalize(device="cpu")
    q = coordinates(model, [], 20, scheme="euler")
    whole = 0.2 + 0.01 + 5.0 * 0.36
    assert q[-1, 0] == pytest.approx(G * 0.1 / (2.0 * whole) * 0.02 * (0.02 + DT), rel=1.0e-3)


TENDON = """<tendon><fixed name="cord" {has}>
<joint joint="hinge" coef="2"/><joint joint="slide" coef="-1"/></fixed></tendon>"""


def test_a_motor_pulls_a_fixed_tendon_by_its_coefficients() -> None:
    model = scene('<motor tendon="cord" gear="3"/>', tendon=TENDON.format(has=""))
    q = coordinates(model, [0.1], 400, scheme="euler")[-1]
    reach = 0.4 * (0.4 + DT) / 2.0
    assert q[0] == pytest.approx(2.0 * 0.3 / INERTIA * reach, rel=1.0e-4)
    assert q[1] == pytest.approx(-0.3 / 2.0 * reach, rel=1.0e-4)


@pytest.mark.parametrize("stiffness", [20.0, 1.0e6])
def test_a_tendon_s_spring_ties_coordinates(stiffness: float) -> None:
    """The mode of the spring swings with sqrt(k (4/I + 1/m)); what is stiff stays finite.

    Bound: a tenth of the amplitude after half a second, by the damping of backward Euler.
    """
    model = scene(tendon=TENDON.format(has=f'stiffness="{stiffness}"'))
    rates = model.joint_qd.numpy()
    rates[0] = 1.0
    model.joint_qd.assign(rates)
    q = coordinates(model, [], 500)
    assert np.all(np.abs(q) < 0.6)
    if stiffness < 1.0e3:
        w = np.sqrt(stiffness * (4.0 / INERTIA + 1.0 / 2.0))
        stretch = 2.0 * q[:, 0] - q[:, 1]
        t = DT * np.arange(1, 501)
        np.testing.assert_allclose(stretch, 2.0 / w * np.sin(w * t), atol=0.1 * 2.0 / w)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_actuators_act_in_every_driver_and_scheme(parallel: str, scheme: str) -> None:
    """With a box on the ground beside the arm, so that there is something to color."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -G))
    SolverMuJoCo.register_custom_attributes(builder)
    parts = {"body": 'gravcomp="1"', "joint": "", "tendon": TENDON.format(has="")}
    actuators = '<motor joint="hinge" gear="3" forcerange="-1 0.1"/><motor tendon="cord"/>'
    builder.add_mjcf(ARM.format(actuator=actuators, **parts), ctrl_direct=True)
    builder.add_ground_plane()
    box = builder.add_body(xform=wp.transform(wp.vec3(5.0, 0.0, 0.1), wp.quat_identity()))
    builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1)
    model = builder.finalize(device="cpu")
    pipeline = newton.CollisionPipeline(model)
    solver = SolverAVBD(
        model,
        parallel=parallel,
        scheme=scheme,
        collision_pipeline=pipeline,
        update_joint_state=True,
    )
    assert solver.parallel == parallel
    q, _ = advance(model, solver, [1.0, 0.1], 400)
    assert q[-1, 0] == pytest.approx((0.3 + 2.0 * 0.1) / (2.0 * INERTIA) * 0.4**2, rel=5.0e-3)
    assert q[-1, 1] == pytest.approx(-0.1 / (2.0 * 2.0) * 0.4**2, rel=5.0e-3)


def test_a_captured_graph_sees_what_is_written_to_ctrl() -> None:
    model = scene('<motor joint="hinge"/>')
    solver = SolverAVBD(model)
    state, control = model.state(), model.control()
    solver.step(state, state, control, None, DT)
    with wp.ScopedCapture(device="cpu") as capture:
        solver.step(state, state, control, None, DT)
    control.mujoco.ctrl.fill_(0.5)
    wp.capture_launch(capture.graph)
    assert state.body_qd.numpy()[0, 4] == pytest.approx(0.5 / INERTIA * DT, rel=1.0e-4)


def test_a_sleeping_arm_wakes_when_its_control_changes() -> None:
    model = scene('<motor joint="hinge"/>', body='gravcomp="1"', gravity=G)
    solver = SolverAVBD(model, sleeping=True, update_joint_state=True)
    _, state = advance(model, solver, [0.0], 700)
    assert solver.status.sleeping_bodies > 0
    q, _ = advance(model, solver, [0.5], 50, state)
    assert q[-1, 0] > 1.0e-3


def test_a_site_pushes_where_it_is() -> None:
    """A thruster off the COM of a free body: F/m of its COM, and the torque of its arm."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(
        """<mujoco><worldbody><body><freejoint/>
        <inertial pos="0.1 0 0" mass="2" diaginertia="0.3 0.5 0.4"/>
        <site name="jet" pos="0.1 0.2 0" euler="90 0 0"/></body></worldbody>
        <actuator><motor site="jet" gear="0 0 1 0 0 0"/></actuator></mujoco>""",
        ctrl_direct=True,
    )
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model)
    assert solver.effects["body_actuators"].on
    state, control = model.state(), model.control()
    control.mujoco.ctrl.fill_(3.0)
    solver.step(state, state, control, None, DT)
    velocity = state.body_qd.numpy()[0] / DT
    # the site's z is the body's -y
    np.testing.assert_allclose(velocity[:3], [0.0, -1.5, 0.0], atol=1.0e-4)
    np.testing.assert_allclose(velocity[3:], 0.0, atol=1.0e-4)


@pytest.mark.parametrize("effort", [0.3, 5.0])
@pytest.mark.parametrize(
    "actuator",
    [
        '<motor site="tip" gear="0 0 -2 0 0 0"/>',
        '<motor site="tip" refsite="base" gear="0 0 -2 0 0 0"/>',
        '<position site="tip" refsite="base" gear="0 0 -1 0 0 0" kp="2" kv="1e-3"/>',
        '<motor tendon="cord" gear="1"/>',
        '<motor tendon="cord" gear="1" forcerange="-0.4 9"/><motor joint="hinge" gear="0.2"/>'
        '<motor site="tip" gear="0 0 -1.8 0 0 0"/>',
    ],
    ids=["site", "refsite", "servo", "tendon", "all"],
)
def test_the_limit_of_a_joint_bounds_what_sites_and_tendons_bring_to_it(
    actuator: str, effort: float
) -> None:
    """2 N m, of which ``actuatorfrcrange`` lets 0.3 through: all of it in any number of parts."""
    site = '<site name="tip" pos="1 0 0"/>'
    text = ARM.format(
        body="",
        joint=f'actuatorfrcrange="{-effort} {effort}"',
        tendon='<tendon><fixed name="cord"><joint joint="hinge" coef="2"/></fixed></tendon>',
        actuator=actuator,
    ).replace("<inertial", site + "<inertial", 1)
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(
        text.replace("<worldbody>", '<worldbody><site name="base"/>'), ctrl_direct=True
    )
    model = builder.finalize(device="cpu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solver = SolverAVBD(model)
    state, control = model.state(), model.control()
    asked = [-0.2, 1.0, 1.0] if "forcerange" in actuator else [1.0]
    control.mujoco.ctrl.assign(asked)
    for _ in range(20):
        solver.step(state, state, control, None, DT)
    whole = 2.0 * -0.2 + 0.2 + 1.8 if len(asked) > 1 else 2.0
    expected = min(whole, effort) / INERTIA * 20 * DT
    assert state.body_qd.numpy()[0, 4] == pytest.approx(expected, rel=3.0e-3)


CRANK = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0"/>
  <worldbody>
    {fixed}
    <body name="wheel">
      <joint name="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.3 0.5 0.4"/>
      {site}
    </body>
  </worldbody>
  <actuator><general cranksite="pin" slidersite="guide" cranklength="0.5" gear="2" gainprm="3"
    biastype="affine" biasprm="0 -4 0"/></actuator>
</mujoco>
"""
SITES = '<site name="guide" pos="1 0 0"/>', '<site name="pin"/>'
"""A slider on the world and a pin on the wheel."""
PIN, GUIDE = (0.2, 0.0, 0.1), (0.6, 0.0, 0.05)
"""Of the crank's pin and the slider's place [m]; the slider goes along x."""


def wheel(fixed: str, site: str, actuator: str = "") -> newton.Model:
    """A wheel that a crank turns, or another actuator."""
    text = CRANK.format(fixed=fixed, site=site)
    if actuator:
        text = f"{text[: text.index('<general')]}{actuator}</actuator></mujoco>"
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text, ctrl_direct=True)
    return builder.finalize(device="cpu")


def crank_length(angle: float, on_wheel: str) -> float:
    """Length of a slider-crank whose wheel has turned about y, MuJoCo's a v - sqrt(...)."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    pin, guide, axis = np.array(PIN), np.array(GUIDE), np.array([1.0, 0.0, 0.0])
    if on_wheel == "crank":
        pin = turn @ pin
    else:
        guide, axis = turn @ guide, turn @ axis
    away = pin - guide
    reach = axis @ away
    return float(reach - np.sqrt(reach**2 + 0.5**2 - away @ away))


@pytest.mark.parametrize("on_wheel", ["crank", "slider"])
def test_a_slider_crank_turns_its_wheel(on_wheel: str) -> None:
    """First step: torque (3 u - 4 g l) g dl/dq on the wheel, with g = 2. Bound: float32."""
    crank = f'<site name="pin" pos="{PIN[0]} {PIN[1]} {PIN[2]}"/>'
    slider = f'<site name="guide" pos="{GUIDE[0]} {GUIDE[1]} {GUIDE[2]}" zaxis="1 0 0"/>'
    fixed, site = (slider, crank) if on_wheel == "crank" else (crank, slider)
    model = wheel(fixed, site)
    state, control = model.state(), model.control()
    control.mujoco.ctrl.fill_(0.8)
    SolverAVBD(model).step(state, state, control, None, 1.0e-4)
    slope = (crank_length(1.0e-5, on_wheel) - crank_length(-1.0e-5, on_wheel)) / 2.0e-5
    torque = (3.0 * 0.8 - 4.0 * 2.0 * crank_length(0.0, on_wheel)) * 2.0 * slope
    assert INERTIA * state.body_qd.numpy()[0, 4] / 1.0e-4 == pytest.approx(torque, rel=1.0e-3)


def test_a_dc_motor_runs_up_to_its_no_load_speed() -> None:
    """v <- (v + h K V/(R I))/(1 + h K^2/(R I)): K/R (V - K v), with its own back-EMF implicit."""
    model = scene('<dcmotor joint="hinge" motorconst="0.6" resistance="0.2"/>')
    q = coordinates(model, [3.0], 500, scheme="euler")[:, 0]
    v, at = 0.0, []
    for _ in range(500):
        v = (v + DT * 0.6 * 3.0 / (0.2 * INERTIA)) / (1.0 + DT * 0.36 / (0.2 * INERTIA))
        at.append(DT * v)
    assert v > 0.8 * 5.0
    np.testing.assert_allclose(q, np.cumsum(at), rtol=2.0e-4, atol=1.0e-6)


def test_a_dc_motor_with_every_state_goes_with_mujoco() -> None:
    """Inductance, heat, cogging, LuGre friction, slew rate and integral, 0.4 s at 1/10,000 s.

    Bound: 2e-3 of the way, some first-order error of both.
    """
    model = scene(
        '<dcmotor joint="hinge" motorconst="0.6" resistance="0.2" inductance="0.004" '
        'thermal="2 5 0 0.004 25 25" cogging="0.05 6 0.3" lugre="50 0.5 0.1 0.15 0.1" '
        'controller="4 2 0.3 8 1 6" input="pos"/>'
    )
    h, steps = 1.0e-4, 4000
    solver = SolverAVBD(model, update_joint_state=True)
    native = SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True)
    paths = []
    for one in (solver, native):
        state, control = model.state(), model.control()
        newton.eval_fk(model, model.joint_q, model.joint_qd, state)
        control.mujoco.ctrl.fill_(1.0)
        path = []
        for _ in range(steps):
            one.step(state, state, control, None, h)
            path.append(float(state.joint_q.numpy()[0]))
        paths.append(np.array(path))
    way = np.abs(paths[1]).max()
    assert way > 0.2
    np.testing.assert_allclose(paths[0], paths[1], atol=2.0e-3 * way)
    found = solver.checkpoint()["actuators.motor"][0]
    np.testing.assert_allclose(found.tolist(), native.mj_data.act, rtol=2.0e-2, atol=1.0e-4)
    solver.reset(model.state())
    assert not any(solver.checkpoint()["actuators.motor"][0].tolist())


@pytest.mark.parametrize("through", [False, True])
def test_compensation_by_actuators_counts_towards_their_limit(through: bool) -> None:
    """Weight 2 G at 0.2 m, of which the limit of 1 N m lets the actuators carry that much."""
    flag = 'actuatorgravcomp="true"' if through else ""
    model = scene(body='gravcomp="1"', joint=f'actuatorfrcrange="-1 1" {flag}', gravity=G)
    com = model.body_com.numpy()
    com[0] = (0.2, 0.0, 0.0)
    model.body_com.assign(com)
    q = coordinates(model, [], 20, scheme="euler")[-1, 0]
    rest = 2.0 * G * 0.2 - 1.0 if through else 0.0
    expected = rest / (2.0 * (INERTIA + 2.0 * 0.2**2)) * 0.02 * (0.02 + DT)
    assert q == pytest.approx(expected, rel=2.0e-3, abs=1.0e-7)


@pytest.mark.parametrize("effort", [1.0, 100.0])
def test_compensation_by_actuators_sees_the_axes_of_an_arm_on_a_welded_base(effort: float) -> None:
    """The base is welded to the world and turned, and a load welded to the arm.

    Welded links are one body of the solver, which numbers bodies and joints by itself.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -G))
    SolverMuJoCo.register_custom_attributes(builder)
    inertia = wp.mat33(*np.diag([0.3, INERTIA, 0.4]).ravel())
    lifted = {"mujoco:gravcomp": 1.0}
    base, stand = builder.add_link(mass=1.0, inertia=inertia), builder.add_link()
    arm = builder.add_link(mass=2.0, inertia=inertia, com=(0.2, 0.0, 0.0), custom_attributes=lifted)
    load = builder.add_link(mass=1.0, inertia=inertia, custom_attributes=lifted)
    ahead = wp.transform((0.3, 0.0, 0.0), wp.quat_identity())
    turned = wp.transform(
        (0.0, 0.0, 1.0), wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), wp.pi / 2)
    )
    joints = [
        builder.add_joint_fixed(-1, base, parent_xform=turned),
        builder.add_joint_fixed(base, stand),
        builder.add_joint_revolute(
            stand,
            arm,
            axis=(0.0, 1.0, 0.0),
            effort_limit=effort,
            custom_attributes={"mujoco:jnt_actgravcomp": True},
        ),
        builder.add_joint_fixed(arm, load, parent_xform=ahead),
    ]
    builder.add_articulation(joints)
    q = coordinates(builder.finalize(device="cpu"), [], 20, scheme="euler")[-1, 0]
    inertia_there = 2.0 * INERTIA + 2.0 * 0.2**2 + 0.3**2
    rest = max(0.0, G * (2.0 * 0.2 + 0.3) - effort)
    expected = rest / (2.0 * inertia_there) * 0.02 * (0.02 + DT)
    assert q == pytest.approx(expected, rel=2.0e-3, abs=1.0e-7)


def test_bad_control_is_named(capfd: pytest.CaptureFixture[str]) -> None:
    model = scene('<motor joint="hinge"/>')
    solver = SolverAVBD(model)
    state, control = model.state(), model.control()
    for wrong in (wp.zeros(3, dtype=float, device="cpu"), np.zeros(1), None):
        control.mujoco.ctrl = wrong
        with pytest.raises(ValueError, match=r"control.*mujoco\.ctrl.*model\.control\(\)"):
            solver.step(state, state, control, None, DT)
    control = model.control()
    control.mujoco.ctrl.fill_(np.nan)
    before = state.body_q.numpy().copy()
    solver.step(state, state, control, None, DT)
    solver.step(state, state, control, None, DT)
    assert capfd.readouterr().out.count("control.mujoco.ctrl[0] is not finite") == 1
    np.testing.assert_array_equal(state.body_q.numpy(), before)
    assert solver.status.held_steps.sum() == 2
    control.mujoco.ctrl.fill_(1.0)
    solver.step(state, state, control, None, DT)
    assert not np.array_equal(state.body_q.numpy(), before)
    model.mujoco.actuator_gear.assign(np.full((1, 6), np.inf, dtype=np.float32))
    with pytest.raises(ValueError, match=r"mujoco\.actuator_gear\[0\].*is not finite"):
        SolverAVBD(model)


@pytest.mark.parametrize("ends", [(np.nan, 1.0), (1.0, -1.0)])
def test_a_range_that_makes_no_sense_is_named(ends: tuple[float, float]) -> None:
    model = scene('<motor joint="hinge" name="elbow" forcerange="-1 1" forcelimited="true"/>')
    model.mujoco.actuator_forcerange.assign(np.array([ends], dtype=np.float32))
    with pytest.raises(ValueError, match=r"actuator_forcerange\[0\] .*elbow.*smaller one first"):
        SolverAVBD(model)


def test_an_unknown_transmission_is_named() -> None:
    model = scene('<motor joint="hinge" name="elbow"/>')
    model.mujoco.actuator_trntype.fill_(9)
    with pytest.raises(ValueError, match=r"trntype\[0\] .*elbow.* 9.*0 \(JOINT\)"):
        SolverAVBD(model)


@pytest.mark.parametrize(
    ("dynamics", "time", "says"),
    [
        ("filter", 0.0, "above zero"),
        ("filter", -0.1, "above zero"),
        ("filterexact", -0.1, "no less than zero.*dyntype='none'"),
        ("muscle", -0.1, "no less than zero"),
    ],
)
def test_time_constants_that_make_no_sense_are_named(dynamics: str, time: float, says: str) -> None:
    actuator = f'<general joint="hinge" name="elbow" dyntype="{dynamics}" dynprm="{time} 0.04"/>'
    model = scene(actuator)
    with pytest.raises(ValueError, match=rf"actuator_dynprm\[0\] .*elbow.*{says}"):
        SolverAVBD(model)


def test_an_exact_filter_without_time_follows_its_control_as_in_mujoco() -> None:
    ends = [
        coordinates(scene(f'<general joint="hinge" {dynamics}/>'), [0.5], 100)[-1]
        for dynamics in ("", 'dyntype="filterexact" dynprm="0"')
    ]
    # a filter takes on its control at the end of a step, as MuJoCo's does
    assert ends[1] == pytest.approx(ends[0], rel=0.03)
    assert np.abs(ends[0]).max() > 0.0


@pytest.mark.parametrize(
    ("actuator", "what"),
    [
        ('<motor joint="hinge" name="elbow"/>', "degrees of freedom"),
        ('<motor jointinparent="hinge" name="elbow"/>', "degrees of freedom"),
        ('<motor tendon="cord" name="elbow"/>', "tendons"),
        ('<motor site="pin" refsite="guide" name="elbow"/>', "shapes"),
        ('<motor cranksite="pin" slidersite="guide" cranklength="1" name="elbow"/>', "shapes"),
        ('<general body="wheel" name="elbow"/>', "bodies"),
    ],
)
def test_a_target_that_does_not_exist_is_named(actuator: str, what: str) -> None:
    """Without any (-1) an actuator is left out, with a warning."""
    by_wheel = "site" in actuator or "body" in actuator
    tendon = TENDON.format(has="") if "tendon" in actuator else ""
    model = wheel(*SITES, actuator) if by_wheel else scene(actuator, tendon=tendon)
    ends = model.mujoco.actuator_trnid.numpy()
    for target, found in (
        (99, pytest.raises(ValueError, match=rf"\[0\] .*elbow.* 99.*{what}")),
        (-1, pytest.warns(UserWarning, match="elbow.*does not exist")),
    ):
        ends[0] = (target, -1)
        model.mujoco.actuator_trnid.assign(ends)
        with found:
            SolverAVBD(model)


USD = """#usda 1.0
(
    upAxis = "Z"
    metersPerUnit = 1
)
def Xform "base" (
    prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI", "PhysicsArticulationRootAPI"]
)
{
    float physics:mass = 1
    float3 physics:diagonalInertia = (1, 1, 1)
}
def Xform "arm" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
{
    float physics:mass = 2
    float3 physics:diagonalInertia = (0.3, 0.5, 0.4)
}
def PhysicsFixedJoint "fixed"
{
    rel physics:body1 = </base>
}
def PhysicsRevoluteJoint "hinge"
{
    rel physics:body0 = </base>
    rel physics:body1 = </arm>
    uniform token physics:axis = "Y"
}
def MjcActuator "motor"
{
    rel mjc:target = </hinge>
    uniform double[] mjc:gear = [3, 0, 0, 0, 0, 0]
    uniform double[] mjc:gainPrm = [2, 0, 0, 0, 0, 0, 0, 0, 0, 0]
    uniform double mjc:forceRange:min = -1
    uniform double mjc:forceRange:max = 1
    uniform token mjc:forceLimited = "true"
}
"""
"""A motor of gain 2 and gear 3, which gives 1 N m before the gear at most."""


@pytest.mark.parametrize(("ctrl", "torque"), [(0.1, 0.6), (0.8, 3.0)])
def test_an_actuator_of_a_usd_file_pushes_its_hinge(
    tmp_path: Path, ctrl: float, torque: float
) -> None:
    """By its target's path alone, as SolverMuJoCo takes it. Bound: rounding of 200 steps."""
    pytest.importorskip("pxr.Usd", reason="needs usd-core: pip install newton-avbd[scenes]")
    path = tmp_path / "arm.usda"
    path.write_text(USD)
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_usd(str(path))
    q = coordinates(builder.finalize(device="cpu"), [ctrl], 200)[-1]
    assert q == pytest.approx([torque / INERTIA * 0.2**2 / 2.0], rel=1.0e-4)


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("actuator_armature", -1.0, r"\[0\] \('elbow'\) is negative"),
        ("actuator_damping", np.nan, r"\[0\] \('elbow'\) is not finite"),
        ("actuator_dampingpoly", np.nan, r"\[0\] \('elbow'\) is not finite"),
        ("actuator_lengthrange", np.nan, r"\[0\] \('elbow'\) is not finite"),
        ("dof_ref", np.nan, r"\[0\] \('worldbody/arm/hinge'\) is not finite"),
        ("limit_margin", np.nan, r"\[0\] \('worldbody/arm/hinge'\) is not finite"),
        ("tendon_coef", np.nan, r"\[0\] .*is not finite"),
    ],
)
def test_a_number_that_makes_no_sense_is_named(name: str, value: float, says: str) -> None:
    model = scene('<motor joint="hinge" name="elbow"/>', tendon=TENDON.format(has=""))
    getattr(model.mujoco, name).fill_(value)
    with pytest.raises(ValueError, match=rf"model\.mujoco\.{name}{says}"):
        SolverAVBD(model)


@pytest.mark.parametrize(
    ("transmission", "second"),
    [
        ('site="pin" refsite="guide"', 99),
        ('cranksite="pin" slidersite="guide" cranklength="1"', 99),
        ('cranksite="pin" slidersite="guide" cranklength="1"', -1),
    ],
)
def test_a_second_site_that_does_not_exist_is_named(transmission: str, second: int) -> None:
    model = wheel(*SITES, f'<motor name="pull" {transmission}/>')
    ends = model.mujoco.actuator_trnid.numpy()
    ends[0, 1] = second
    model.mujoco.actuator_trnid.assign(ends)
    with (
        pytest.warns(UserWarning, match="'pull'.*slider does not exist")
        if second < 0
        else pytest.raises(ValueError, match=r"trnid\[0\] .*pull.* 99")
    ):
        SolverAVBD(model)


def test_a_crank_without_length_is_named() -> None:
    model = wheel(*SITES)
    model.mujoco.actuator_cranklength.zero_()
    with pytest.raises(ValueError, match=r"actuator_cranklength\[0\] .*above zero"):
        SolverAVBD(model)


def test_what_is_left_out_does_not_push() -> None:
    model = scene('<motor joint="hinge"/>', body='gravcomp="1"', gravity=0.0)
    left = {"actuators": False, "gravity_compensation": False}
    q = coordinates(model, [1.0], 5, effects=left)
    np.testing.assert_array_equal(q, 0.0)


def test_actuators_that_act_are_nothing_to_warn_of() -> None:
    model = scene('<motor joint="hinge"/><position joint="slide" kp="3"/>')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SolverAVBD(model, strict=True)


def test_a_damping_ratio_counts_the_inertia_beside_joints_that_close_loops() -> None:
    """Newton's importer puts the joint of a <connect> between two articulations."""
    hinges = "".join(
        f"""<body name="{name}" pos="{at} 0 0"><joint name="{name}" axis="0 1 0" armature="0.1"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="{mass}"/></body>"""
        for name, at, mass in (("one", 0.0, 1.0), ("other", 1.0, 2.0))
    )
    text = f"""<mujoco><worldbody>{hinges}</worldbody>
      <equality><connect body1="one" body2="other" anchor=".3 0 0"/></equality></mujoco>"""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text)
    found = reference_mobility(builder.finalize(device="cpu"))
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    matrix = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, matrix)
    expected = np.diag(np.linalg.inv(matrix))
    assert [found[dof][0] for dof in sorted(found)[-2:]] == pytest.approx(expected)


BODY = """<body name="{0}" pos="{1} 0 0" euler="10 20 30"><joint name="{0}" axis="0 0 1" {2}/>
  <geom type="capsule" fromto="0 0 0 .4 .1 0" size=".04" mass="1" contype="0" conaffinity="0"/>
  <site name="{0}" pos=".3 0 .1" euler="30 20 10"/>{3}</body>"""
BALL = """<body name="end" pos=".4 0 0" euler="0 40 0"><joint name="ball" type="ball"/>
  <geom type="box" size=".1 .05 .03" mass=".5" contype="0" conaffinity="0"/></body>"""
MOTOR = '<motor joint="{{0}}" gear="2" {}/>'.format
AUTHORED = {
    "dampingpoly": ("", MOTOR('damping=".3 2 1"'), "", MOTOR("")),
    "ctrllimited": ("", MOTOR('ctrlrange="-.2 .3" ctrllimited="false"'), "", ""),
    "forcelimited": ("", MOTOR('forcerange="-.2 .3"'), "", MOTOR("")),
    "springref": ('stiffness="5" springref="40"', "", 'stiffness="5"', ""),
    "ref": ('ref="30"', '<position joint="{0}" kp="5"/>', "", '<position joint="{0}" kp="5"/>'),
    "refsite": ("", '<position site="{0}" refsite="wall" kp="20" gear="1 0 0 0 0 .2"/>', "", ""),
    "parent": ("", '<motor jointinparent="ball" gear=".1 .2 .3"/>', "", ""),
    "margin": ("", MOTOR(""), "", MOTOR("")),
}
"""By name: a joint and an actuator that author something, and the same without."""
LIMITED = {
    "joint": ('actuatorfrcrange="-.5 .5"', '<position joint="joint" kp="3" kv=".1"/>'),
    "actuator": ("", '<position joint="actuator" gear="-2" kp="30" kv=".5" forcerange="-.3 .9"/>'),
    **{name: ("", "") for name in ("third", "fourth", "fifth", "sixth")},
}
"""Servos that a limit holds back, by whose limit it is, and bodies without any beside."""
CORD = """<tendon><fixed name="cord" range="-1 .1" margin="{}" solreflimit=".002 1"><joint
  joint="margin" coef="1"/></fixed></tendon>"""


def everything(authored: bool) -> str:
    """A body for each attribute, side by side."""
    bodies, actuators = "", ""
    for i, (name, words) in enumerate(AUTHORED.items()):
        joint, actuator = words[:2] if authored else words[2:]
        bodies += BODY.format(name, i, joint, BALL * (name == "parent"))
        actuators += actuator.format(name)
    return f"""<mujoco><option timestep="0.0005"><flag gravity="disable"/></option><worldbody>
      <site name="wall" pos="0 0 1" euler="20 40 10"/>{bodies}</worldbody>
      {CORD.format(0.04 * authored)}<actuator>{actuators}</actuator></mujoco>"""


def moved_in_mujoco(text: str) -> NDArray[np.float64]:
    """Where bodies are after 0.2 s in MuJoCo C, as position and the columns of their axes.

    By RK4 at a tenth of the step: in Euler's steps the servo alone is 0.012 off.
    """
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 5.0e-5
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.7
    for _ in range(4000):
        mujoco.mj_step(model, data)
    return np.hstack([data.xpos, data.xmat])[1:]


def test_what_files_author_acts_as_in_mujoco() -> None:
    """Each attribute makes 100 times as much of a difference as SolverAVBD is off.

    The steps stay of second order after a joint has come to rest on its tendon's limit: with those
    of backward Euler the servo of a site is off by 19 %.
    """
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(everything(authored=True), ctrl_direct=True)
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, update_joint_state=True, scheme="generalized_alpha")
    state, control = model.state(), model.control()
    control.mujoco.ctrl.fill_(0.7)
    for _ in range(400):
        solver.step(state, state, control, None, 0.0005)
    pose = state.body_q.numpy().astype(float)
    axes = [np.array(wp.quat_to_matrix(wp.quat(*q))).reshape(9) for q in pose[:, 3:]]
    expected, plain = (moved_in_mujoco(everything(is_on)) for is_on in (True, False))
    off = np.abs(np.hstack([pose[:, :3], axes]) - expected).max(axis=1)
    difference = np.abs(expected - plain).max(axis=1)
    names = [*[*AUTHORED][:7], "end", "margin"]
    for i, name in enumerate(names):
        assert off[i] < 0.01 * difference[i], f"{name}: {off[i]} of {difference[i]}"


def test_a_load_moves_what_a_limited_servo_holds_body_by_body() -> None:
    """Steps that do not settle lose no more energy than servos take at their limits.

    They lost so much that the bodies fell by a fiftieth of the way.
    """
    bodies = "".join(
        BODY.format(name, i, said[0], "") for i, (name, said) in enumerate(LIMITED.items())
    )
    servos = "".join(servo for _, servo in LIMITED.values())
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -G))
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(
        f"<mujoco><worldbody>{bodies}</worldbody><actuator>{servos}</actuator></mujoco>",
        ctrl_direct=True,
    )
    model = builder.finalize(device="cpu")
    one, other = (
        coordinates(model, [0.7, -0.6], 150, **settings)[-1, :2]
        for settings in ({}, {"blocks": "body", "iterations": 1})
    )
    assert np.all(np.abs(one) > 0.005)
    np.testing.assert_allclose(other, one, rtol=0.03)
