# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The observable ``qfrc_actuator``: what drives and MuJoCo's actuators push joints with."""

from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD

SHORT = 1.0e-5
"""In such a step [s] nothing moves: forces at its end are those at its start."""

MJCF = """<mujoco><worldbody>
  <site name="wall" pos="0.3 0 1.5"/>
  <body pos="0 0 1" gravcomp="1">
    <joint name="shoulder" axis="0 1 0" damping="0.1"/>
    <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="1"/>
    <body pos=".4 0 0" gravcomp="0.5">
      <joint name="yaw" axis="0 0 1" actuatorgravcomp="true"/>
      <joint name="pitch" axis="0 1 0" actuatorgravcomp="true" {limit}/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="0.7"/>
      <site name="arm" pos=".1 .05 .02" euler="20 30 10"/>
      <body pos=".3 0 0"><joint name="ball" type="ball" pos="0 0 0.02"/>
        <geom type="box" size=".1 .04 .03" pos=".1 0 0" mass="0.5"/></body>
      <body pos=".15 0 .1"><joint name="slide" type="slide" axis="1 0 1"/>
        <geom type="sphere" size=".05" mass=".3"/><site name="slider"/></body>
    </body>
  </body>
  <body pos="0 1 1" euler="30 0 50"><freejoint name="free"/>
    <geom type="box" size=".1 .2 .3" pos=".05 .02 0" mass="2"/>
    <site name="box" pos=".1 .1 .1" euler="10 40 50"/></body>
</worldbody>
<tendon>
  <spatial name="rope"><site site="wall"/><site site="arm"/><site site="slider"/></spatial>
  <fixed name="sum"><joint joint="shoulder" coef="0.5"/><joint joint="slide" coef="-2"/></fixed>
</tendon>
<actuator>
  <motor joint="shoulder" gear="3"/><position joint="shoulder" kp="20" kv="1"/>
  <general joint="pitch" gainprm="5" biastype="affine" biasprm="0 -5 -.1" damping="0.3"
    forcerange="-1 1"/>
  <motor joint="ball" gear="1 2 3"/><position joint="ball" gear="0 1 0" kp="3"/>
  {site}
  <motor joint="free" gear="1 2 3 .1 .2 .3"/><motor site="box" gear="1 0 0 0 .3 0"/>
  {rope}
  <motor tendon="sum" gear="1.5"/>
</actuator></mujoco>"""
SITE = '<motor site="arm" gear="1 2 3 .1 .2 .3"/>'
ROPE = '<motor tendon="rope" gear="2"/><position tendon="rope" kp="30"/>'
WHOLE = MJCF.format(limit="", site=SITE, rope=ROPE)
"""Every transmission."""
LIMITED = MJCF.format(limit='actuatorfrcrange="-1.5 1.5"', site="", rope="")
"""The compensation counts towards a limit."""
BOUNDED = MJCF.format(limit='actuatorfrcrange="-2 2"', site=SITE, rope=ROPE)
"""And what sites and tendons bring to the axis."""


def model_of(text: str, worlds: int = 1) -> newton.Model:
    robot = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(robot)
    robot.add_mjcf(text, ctrl_direct=True)
    robot.joint_qd[:] = np.linspace(-0.5, 0.7, robot.joint_dof_count).tolist()
    builder = newton.ModelBuilder()
    builder.replicate(robot, worlds)
    return builder.finalize(device="cpu")


def forces(model: newton.Model, solver: Any, steps: int = 1, dt: float = SHORT) -> np.ndarray:
    """``qfrc_actuator`` after some steps in which every actuator has its own control."""
    state, control = model.state(), model.control()
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    count = control.mujoco.ctrl.size // model.world_count
    ctrl = np.tile(np.linspace(0.5, 1.5, count), model.world_count)
    control.mujoco.ctrl.assign(ctrl.astype(np.float32))
    observables = solver.observables({solver.ObservableKind.QFRC_ACTUATOR})
    for _ in range(steps):
        solver.step(state, state, control, None, dt, observables=observables)
    return observables.qfrc_actuator.numpy()


@pytest.mark.parametrize("text", [WHOLE, LIMITED, BOUNDED], ids=["whole", "limited", "bounded"])
@pytest.mark.parametrize("settings", [{}, {"update_joint_state": True}])
@pytest.mark.filterwarnings("ignore:SolverAVBD steps without contacts")
def test_forces_of_actuators_are_those_of_mujoco(text: str, settings: dict[str, Any]) -> None:
    """Joints of all types, sites, tendons, force ranges, compensation by actuators, in MuJoCo C.

    The ropes shorten at 10 m/s^2: their drive of 25 N falls by 1.2e-4 in the step.
    """
    model = model_of(text)
    expected = forces(model, SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True))
    model = model_of(text)
    found = forces(model, SolverAVBD(model, **settings))
    np.testing.assert_allclose(found, expected, rtol=2.0e-4, atol=2.0e-5)


@pytest.mark.filterwarnings("ignore:SolverAVBD steps without contacts")
def test_forces_of_worlds_are_those_of_one_and_change_no_motion() -> None:
    """In motion: to the bit, but for how the step of one world and that of many round."""
    alone, three = model_of(WHOLE), model_of(WHOLE, 3)
    one = forces(alone, SolverAVBD(alone), 20, 1.0e-3)
    found = forces(three, SolverAVBD(three), 20, 1.0e-3)
    found = found.reshape(3, -1)
    np.testing.assert_array_equal(found, [found[0]] * 3)
    np.testing.assert_allclose(found[0], one, rtol=1e-6, atol=1e-6)
    ends = []
    for is_asked in (False, True):
        solver = SolverAVBD(alone, update_joint_state=False)
        kinds = {solver.ObservableKind.QFRC_ACTUATOR} if is_asked else set()
        observables = solver.observables(kinds)
        state = alone.state()
        for _ in range(20):
            solver.step(state, state, None, None, 1.0e-3, observables=observables)
        ends.append(state.body_q.numpy())
    np.testing.assert_array_equal(*ends)


def hinge(**drive: Any) -> newton.Model:
    """A wheel of 0.1 kg m^2 at 1 rad, with a drive."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverMuJoCo.register_custom_attributes(builder)
    link = builder.add_link(mass=1.0, inertia=wp.mat33(0.1 * np.eye(3)))
    joint = builder.add_joint_revolute(-1, link, axis=(0.0, 0.0, 1.0), **drive)
    builder.add_articulation([joint])
    builder.joint_q[:] = [1.0]
    return builder.finalize(device="cpu")


@pytest.mark.filterwarnings("ignore::newton.NewtonDeprecationWarning")
def test_a_state_that_has_the_force_gets_it_and_limits_count() -> None:
    """``state.mujoco.qfrc_actuator``: of 100 N m 5 are left."""
    model = hinge(target_ke=100.0, target_kd=10.0, effort_limit=5.0)
    model.request_state_attributes("mujoco:qfrc_actuator")
    state, after = model.state(), model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    solver = SolverAVBD(model)
    solver.step(state, after, None, None, 0.01)
    assert after.mujoco.qfrc_actuator.numpy() == pytest.approx([-5.0])


def test_forces_in_a_captured_graph_follow_the_targets() -> None:
    """A drive of 2 N m/rad at 1 rad, whose target moves to 3 rad after the capture."""
    model = hinge(target_ke=2.0)
    state, after, control = model.state(), model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    solver = SolverAVBD(model)
    observables = solver.observables({solver.ObservableKind.QFRC_ACTUATOR})
    solver.step(state, after, control, None, SHORT, observables=observables)
    with wp.ScopedCapture(device="cpu") as capture:
        solver.step(state, after, control, None, SHORT, observables=observables)
    control.joint_target_q.fill_(3.0)
    wp.capture_launch(capture.graph)
    assert observables.qfrc_actuator.numpy() == pytest.approx([4.0], abs=1.0e-5)


@pytest.mark.filterwarnings("ignore:SolverAVBD steps without contacts")
def test_a_frozen_world_reports_no_force() -> None:
    """Of controls that are not finite nothing acts."""
    model = model_of(LIMITED)
    solver = SolverAVBD(model)
    state, control = model.state(), model.control()
    control.mujoco.ctrl.fill_(float("nan"))
    observables = solver.observables({solver.ObservableKind.QFRC_ACTUATOR})
    solver.step(state, state, control, None, SHORT, observables=observables)
    assert np.isfinite(observables.qfrc_actuator.numpy()).all()


def test_thrust_on_a_free_body_is_reported_in_the_world() -> None:
    """10 N along z of the world, 10 N m about z of the body, which is -y of the world."""
    model = model_of("""<mujoco><worldbody><body quat="1 1 0 0"><freejoint name="free"/>
      <inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body></worldbody>
      <actuator><motor joint="free" gear="0 0 10 0 0 0"/><motor joint="free" gear="0 0 0 0 0 20"/>
      </actuator></mujoco>""")
    solver = SolverAVBD(model)
    state, control = model.state(), model.control()
    control.mujoco.ctrl.assign([1.0, 0.5])
    observables = solver.observables({solver.ObservableKind.QFRC_ACTUATOR})
    solver.step(state, state, control, None, SHORT, observables=observables)
    expected = [0.0, 0.0, 10.0, 0.0, -10.0, 0.0]
    assert observables.qfrc_actuator.numpy() == pytest.approx(expected, abs=1.0e-5)
