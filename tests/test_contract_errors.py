# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Messages: what a model or an argument gets wrong, by name, before anything is simulated."""

import warnings
from collections.abc import Callable

import newton
import numpy as np
import pytest
import warp as wp
from contract import pile, resting_box
from helpers import Simulation, add_mass

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0


def jointed() -> newton.ModelBuilder:
    """A body on a hinge, its joint named."""
    builder = newton.ModelBuilder()
    body = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)))
    joint = builder.add_joint_revolute(-1, body, target_ke=1.0, label="elbow")
    builder.add_articulation([joint])
    return builder


def test_the_ramp_refuses_joints_by_name_and_type() -> None:
    """The document of the ramped penalty treats free bodies."""
    model = jointed().finalize(device="cpu")
    message = r"joint 0 '.*elbow' of type REVOLUTE"
    with pytest.raises(NotImplementedError, match=message):
        SolverAVBD(model, formulation="ramp")


@pytest.mark.parametrize(
    ("array", "value", "problem"),
    [
        ("joint_X_p", np.nan, "is not finite"),
        ("joint_X_c", np.inf, "is not finite"),
        ("joint_axis", np.nan, "is not finite"),
        ("joint_limit_lower", np.nan, "is not finite"),
        ("joint_target_ke", -1.0, "is negative"),
        ("joint_target_kd", np.nan, "is not finite"),
    ],
)
def test_a_number_of_a_joint_that_makes_no_sense_is_named(
    array: str, value: float, problem: str
) -> None:
    """Which array, which joint and what is wrong with it."""
    model = jointed().finalize(device="cpu")
    spoil(array, value)(model)
    with pytest.raises(ValueError, match=rf"model.{array}\[0\] \('.*elbow'\) {problem}"):
        SolverAVBD(model)


def test_an_axis_of_no_length_is_named() -> None:
    """A hinge needs a direction."""
    model = jointed().finalize(device="cpu")
    model.joint_axis.zero_()
    with pytest.raises(ValueError, match=r"joint_axis\[0\] \('.*elbow'\) is not a unit vector"):
        SolverAVBD(model)


def test_blocks_are_one_of_two() -> None:
    """An articulation or a body."""
    with pytest.raises(ValueError, match="blocks must be 'articulation' or 'body', got 'island'"):
        SolverAVBD(jointed().finalize(device="cpu"), blocks="island")


@pytest.mark.parametrize("tolerance", [-1.0, np.nan, np.inf])
def test_a_tolerance_is_a_length(tolerance: float) -> None:
    """Not negative and finite."""
    with pytest.raises(ValueError, match="tolerance must be a length of at least 0 m"):
        SolverAVBD(jointed().finalize(device="cpu"), tolerance=tolerance)


def spoil(name: str, value: float) -> Callable[[newton.Model], None]:
    """Puts a value into the last entry of a model array."""

    def change(model: newton.Model) -> None:
        array = getattr(model, name)
        values = array.numpy()
        values.reshape(len(values), -1)[-1, 0] = value
        array.assign(values)

    return change


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("body_mass", np.nan, "is not finite"),
        ("body_mass", -1.0, "is negative"),
        ("body_inv_mass", np.inf, "is not finite"),
        ("body_inertia", np.nan, "is not finite"),
        ("body_inv_inertia", np.nan, "is not finite"),
        ("body_com", np.inf, "is not finite"),
        ("shape_material_mu", np.nan, "is not finite"),
        ("shape_material_mu", -0.5, "is negative"),
    ],
)
def test_a_number_that_makes_no_sense_is_named(name: str, value: float, problem: str) -> None:
    """The array, the index, the label, and what is wrong with the value."""
    builder = pile()
    builder.body_label[-1] = builder.shape_label[-1] = "culprit"
    model = builder.finalize(device="cpu")
    spoil(name, value)(model)
    index = len(getattr(model, name)) - 1
    with pytest.raises(ValueError, match=rf"model\.{name}\[{index}\] \('culprit'\) {problem}"):
        SolverAVBD(model)


def test_a_mass_without_inertia_is_named() -> None:
    """A body that has mass and cannot turn is a forgotten shape or inertia, not a request."""
    builder = newton.ModelBuilder()
    add_mass(builder)
    builder.body_label[0] = "ghost"
    model = builder.finalize(device="cpu")
    model.body_inertia.zero_()
    with pytest.raises(ValueError, match=r"body 0 'ghost' has a mass but no inertia.*body_inertia"):
        SolverAVBD(model)


def test_gravity_that_is_not_finite_is_an_error() -> None:
    """With the call that sets it."""
    model = resting_box().finalize(device="cpu")
    model.gravity.fill_(wp.vec3(0.0, 0.0, np.nan))
    with pytest.raises(ValueError, match=r"gravity is not finite.*set_gravity"):
        SolverAVBD(model)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"iterations": 0}, "iterations must be at least 1, got 0"),
        ({"iterations": 2.5}, "iterations must be a whole number, got 2.5"),
        ({"accuracy": "fine"}, "accuracy must be a number, got 'fine'"),
        ({"effects": ["friction"]}, "effects must be a mapping like"),
        ({"formulation": "classic"}, "must be 'augmented' or 'ramp', got 'classic'"),
        ({"formulation": "ramp", "compliant_contacts": True}, "leave compliant_contacts out"),
    ],
)
def test_a_setting_that_makes_no_sense_is_named(settings: dict, message: str) -> None:
    """What was given and what is possible."""
    with pytest.raises(ValueError, match=message):
        SolverAVBD(resting_box().finalize(device="cpu"), **settings)


@pytest.mark.parametrize("dt", [0.0, -0.01, np.nan, np.inf])
def test_a_time_step_must_be_positive(dt: float) -> None:
    """Nothing is written when it is not."""
    simulation = Simulation(resting_box())
    before = simulation.state.body_q.numpy()
    with pytest.raises(ValueError, match="dt must be a positive number of seconds"):
        simulation.solver.step(simulation.state, simulation.state, None, None, dt)
    np.testing.assert_array_equal(simulation.state.body_q.numpy(), before)


def test_a_state_of_another_model_is_an_error() -> None:
    """Which of the two, and how many bodies there should be; also a state without bodies."""
    simulation = Simulation(pile())
    own = simulation.state
    for foreign in (resting_box(), newton.ModelBuilder()):
        state = foreign.finalize(device="cpu").state()
        with pytest.raises(ValueError, match=r"state_in .*the solver's model has 4"):
            simulation.solver.step(state, own, None, None, DT)
        with pytest.raises(ValueError, match=r"state_out .*the solver's model has 4"):
            simulation.solver.step(own, state, None, None, DT)


class Elsewhere:
    """A device that is not the solver's."""

    def __str__(self) -> str:
        return "cuda:7"


def test_buffers_on_another_device_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both devices are named; the check needs no such device to be there."""
    simulation = Simulation(resting_box())
    foreign = simulation.model.state()
    monkeypatch.setattr(foreign.body_q, "device", Elsewhere())
    with pytest.raises(ValueError, match=r"state_in is on device cuda:7, the solver on cpu"):
        simulation.solver.step(foreign, simulation.state, None, None, DT)
    with pytest.raises(ValueError, match=r"state_out is on device cuda:7, the solver on cpu"):
        simulation.solver.step(simulation.state, foreign, None, None, DT)
    monkeypatch.setattr(simulation.contacts.rigid_contact_count, "device", Elsewhere())
    state = simulation.state
    with pytest.raises(ValueError, match=r"contacts are on device cuda:7, the solver on cpu"):
        simulation.solver.step(state, state, None, simulation.contacts, DT)


def test_particles_are_left_alone_with_a_warning() -> None:
    """How many, and who moves them; the bodies are simulated."""
    builder = resting_box()
    builder.add_particle(pos=(0.0, 0.0, 3.0), vel=(0.0, 0.0, 0.0), mass=1.0)
    model = builder.finalize(device="cpu")
    with pytest.warns(UserWarning, match=r"leaves out the model's 1 particle\..*SolverVBD"):
        solver = SolverAVBD(model)
    state = model.state()
    before = state.particle_q.numpy()
    solver.step(state, state, None, None, DT)
    np.testing.assert_array_equal(state.particle_q.numpy(), before)


def test_joints_that_the_first_poses_leave_open_are_named() -> None:
    """Links of which only the joints say where they are; not with poses, nor where joints count."""
    builder = newton.ModelBuilder()
    links = [builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3))) for _ in range(3)]
    frame = wp.transform((0.4, 0.0, 0.0))
    joints = [
        builder.add_joint_revolute(-1, links[0], label="shoulder"),
        builder.add_joint_revolute(links[0], links[1], parent_xform=frame, label="elbow"),
        builder.add_joint_prismatic(links[1], links[2], label="finger"),
    ]
    builder.add_articulation(joints)
    model = builder.finalize(device="cpu")
    state = model.state()
    with pytest.warns(UserWarning, match=r"1 joint \('elbow'\) open, by up to 0\.4 m") as caught:
        solver = SolverAVBD(model)
        solver.step(state, model.state(), None, None, DT)
    assert [warning.filename for warning in caught] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solver.step(state, model.state(), None, None, DT)
        SolverAVBD(model, update_joint_state=True).step(state, model.state(), None, None, DT)
        newton.eval_fk(model, state.joint_q, state.joint_qd, state)
        SolverAVBD(model).step(state, model.state(), None, None, DT)


def test_a_warning_points_to_the_users_line() -> None:
    """Not into the package: the stack level leads to the call of the constructor."""
    builder = resting_box()
    builder.add_particle(pos=(0.0, 0.0, 3.0), vel=(0.0, 0.0, 0.0), mass=1.0)
    with pytest.warns(UserWarning, match="1 particle") as caught:
        SolverAVBD(builder.finalize(device="cpu"))
    assert caught[0].filename == __file__


def test_a_world_that_is_not_finite_is_reported_once(capfd: pytest.CaptureFixture[str]) -> None:
    """One line in the terminal, by world, whatever the number of steps and bodies."""
    simulation = Simulation(pile())
    simulation.set_velocity(2, (np.nan, 0.0, 0.0))
    simulation.step(5)
    assert capfd.readouterr().out.count("world 0 is not finite and is held still") == 1
    assert simulation.solver.status.held_steps.tolist() == [5]
