# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Each fault of ``docs/faults.md`` gets its answer, and other worlds move as if there were none.

Numbers that make no sense at construction, time steps, masks and other arguments that are refused:
``test_contract_errors.py``, ``test_contract_reset.py``. Overflow: ``test_contract_contacts.py``.
"""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import newton
import numpy as np
import pytest
import warp as wp
from contract import contact_count, resting_box, snapshot
from helpers import Array, Simulation, add_box, add_ground, add_mass
from joint_scenes import add_contact, add_hinge_chain, simulate
from newton import ModelFlags
from workshop import BODIES, add_workshop, spoil, workshops

from newton_avbd import SolverAVBD

WORLDS = 3
SICK = 1
OTHERS = (0, 2)
BEFORE, AFTER = 20, 4
"""Steps before the fault and with it."""
DT = 1.0 / 240.0


@dataclass
class Ward:
    """A workshop in each of three worlds, and where they are without a fault."""

    sim: Simulation
    healthy: Array

    def run(self, fault: Callable[[], None] = lambda: None) -> Array:
        """Poses and velocities by world after a run from the start with a fault in it."""
        self.sim.solver.reset(self.sim.state)
        self.sim.step(BEFORE)
        fault()
        self.sim.step(AFTER)
        return by_world(self.sim)

    @property
    def held(self) -> list[int]:
        return self.sim.solver.status.held_steps.tolist()


def by_world(sim: Simulation) -> Array:
    return snapshot(sim.state).reshape(WORLDS, BODIES, -1)


@pytest.fixture(scope="module")
def ward() -> Ward:
    ward = Ward(Simulation(workshops(WORLDS)), np.empty(0))
    ward.healthy = ward.run()
    return ward


@contextmanager
def kept(array: wp.array) -> Iterator[None]:
    """Puts an array back in the end."""
    values = array.numpy().copy()
    yield
    array.assign(values)


def arrays_of(ward: Ward, name: str) -> list[wp.array]:
    """An array by its path; of states, both that take turns."""
    owner, _, field = name.partition(".")
    if owner == "state":
        return [getattr(state, field) for state in (ward.sim.state, ward.sim._next)]
    return [getattr(getattr(ward.sim, owner), field)]


# Numbers that are not finite, in one world.

READ = {
    "state.body_q": (1, 4, 8),
    "state.body_qd": (1, 4, 8),
    "state.body_f": (1, 4, 8),
    "control.joint_f": (0, 12, 15, 16, 20),
    "control.joint_target_q": (14, 18, 19, 23),
    "control.joint_target_qd": (12, 16, 20),
    "model.body_mass": (0, 2, 9),
    "model.body_inv_mass": (0, 2, 9),
    "model.body_inertia": (0, 2, 9),
    "model.body_inv_inertia": (0, 2, 9),
    "model.body_com": (0, 2, 9),
    "model.joint_X_p": (2, 5, 8),
    "model.joint_X_c": (2, 5, 8),
    "model.joint_axis": (12, 16, 20),
    "model.joint_target_ke": (12, 20),
    "model.joint_target_kd": (12, 20),
    "model.joint_stiffness": (12, 20),
    "model.joint_damping": (12, 20),
    "model.joint_armature": (12, 20),
    "model.joint_friction": (12, 20),
    "model.joint_mimic_coeffs": (10,),
    "model.gravity": (0,),
}
"""Entries of the sick world that a step reads: of boxes, of the loop, of the chain."""


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", READ)
def test_a_number_that_is_not_finite_holds_its_world(ward: Ward, name: str, value: float) -> None:
    """All bodies of the world stay, the others move bit for bit as ever, and so do all after a
    reset."""
    array = arrays_of(ward, name)[0]
    first = SICK if name == "model.gravity" else SICK * (len(array) // WORLDS)
    for row in READ[name]:
        before = []

        def fault(at: int = first + row, before: list = before) -> None:
            before.append(by_world(ward.sim)[SICK])
            spoil(arrays_of(ward, name)[0], at, value)

        with kept(arrays_of(ward, name)[0]), kept(arrays_of(ward, name)[-1]):
            got = ward.run(fault)
        np.testing.assert_array_equal(got[OTHERS, :], ward.healthy[OTHERS, :])
        same = got[SICK] == before[0]
        assert np.count_nonzero(~same) <= 1  # the number itself
        assert ward.held == [0, AFTER, 0]
        np.testing.assert_array_equal(ward.run(), ward.healthy)
        assert ward.held == [0, 0, 0]


# Contacts that make no sense, in one world.


def rows_of(ward: Ward, world: int) -> list[int]:
    """Rows of the contact buffer that hold a body of a world."""
    contacts, body = ward.sim.contacts, ward.sim.model.shape_body.numpy()
    shapes = contacts.rigid_contact_shape0.numpy(), contacts.rigid_contact_shape1.numpy()
    owner = [body[s[: contact_count(contacts)]] // BODIES for s in shapes]
    return np.flatnonzero((owner[0] == world) | (owner[1] == world)).tolist()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("point0", np.nan),
        ("point1", np.inf),
        ("normal", np.nan),
        ("normal", 3.0),
        ("margin0", -np.inf),
        ("margin1", np.nan),
        ("shape0", -5),
        ("shape1", 2**30),
        ("shape1", "other world"),
    ],
)
def test_a_contact_that_makes_no_sense_is_left_out(
    ward: Ward, name: str, value: float | str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Counted, said once; the world goes on with its other contacts, the others bit for bit."""
    sim = ward.sim
    if value == "other world":
        value = int(np.flatnonzero(sim.model.shape_body.numpy() == 0)[0])
    detect = sim.pipeline.collide
    rows: list[int] = []

    def collide(state: newton.State, contacts: newton.Contacts) -> None:
        detect(state, contacts)
        array = getattr(contacts, f"rigid_contact_{name}")
        body = sim.model.shape_body.numpy()
        # between boxes, so that another box in the place of the upper one is another world's
        pair = [body[getattr(contacts, f"rigid_contact_shape{i}").numpy()] for i in (0, 1)]
        mine = [r for r in rows_of(ward, SICK) if min(pair[0][r], pair[1][r]) >= 0][:2]
        rows.extend(mine)
        for row in mine:
            spoil(array, row, value)

    def fault() -> None:
        sim.pipeline.collide = collide

    try:
        got = ward.run(fault)
    finally:
        sim.pipeline.collide = detect
    np.testing.assert_array_equal(got[OTHERS, :], ward.healthy[OTHERS, :])
    assert not np.array_equal(got[SICK], ward.healthy[SICK])
    # a box that lies on an edge of another begins to tip by 3 g/(4 a), 0.25 rad/s in these steps
    np.testing.assert_allclose(got[SICK], ward.healthy[SICK], atol=0.3)
    assert len(rows) == 2 * AFTER
    assert sim.solver.status.dropped_contacts == len(rows)
    assert capfd.readouterr().out.count("is left out: its shapes are not") == 1
    np.testing.assert_array_equal(ward.run(), ward.healthy)
    assert sim.solver.status.dropped_contacts == 0


def test_a_match_that_points_nowhere_is_a_new_contact() -> None:
    """With contact matching, into a buffer of any size; nothing is read from there."""
    sim = Simulation(resting_box())
    sim.pipeline = newton.CollisionPipeline(sim.model, contact_matching="latest")
    sim.contacts = sim.pipeline.contacts()
    sim.step(3)
    sim.pipeline.collide(sim.state, sim.contacts)
    sim.contacts.rigid_contact_match_index.fill_(2**30)
    sim.pipeline = None
    sim.step()
    assert sim.pose[0, 2] == pytest.approx(0.25, abs=1e-5)


# Quaternions.


def stretch(array: wp.array, row: int, factor: float) -> None:
    """Multiplies the quaternion of a pose."""
    poses = array.numpy().copy()
    poses[row, 3:] *= factor
    array.assign(poses)


def test_a_quaternion_is_normalised_and_counted(ward: Ward) -> None:
    """Of bodies in a tree and in a loop: they move as with the unit quaternion, to rounding."""
    bodies = [SICK * BODIES + i for i in (2, 4, 7)]

    def fault() -> None:
        for body in bodies:
            stretch(ward.sim.state.body_q, body, 1.7)

    got = ward.run(fault)
    np.testing.assert_array_equal(got[OTHERS, :], ward.healthy[OTHERS, :])
    np.testing.assert_allclose(got[SICK], ward.healthy[SICK], atol=1e-4)
    assert ward.sim.solver.status.repaired_poses.tolist() == [0, len(bodies), 0]
    ward.run()
    assert ward.sim.solver.status.repaired_poses.tolist() == [0, 0, 0]


@pytest.mark.parametrize("kinematic", [False, True])
def test_a_quaternion_is_normalised_in_free_motion(kinematic: bool) -> None:
    """Where no contact and no joint is, another kernel moves the bodies."""
    builder = newton.ModelBuilder()
    body = add_mass(builder, rotation=wp.quat_rpy(0.1, 0.2, 0.3))
    builder.body_flags[body] = int(newton.BodyFlags.KINEMATIC if kinematic else 1)
    sim = Simulation(builder, collide=False)
    turn = sim.pose[0, 3:]
    stretch(sim.state.body_q, 0, 0.5)
    sim.step(2)
    np.testing.assert_allclose(sim.pose[0, 3:], turn, atol=1e-6)
    assert sim.solver.status.repaired_poses.tolist() == [1]


def test_a_quaternion_of_zeros_holds_its_world(ward: Ward) -> None:
    """It says nothing about where the body is turned."""
    with kept(ward.sim.state.body_q), kept(ward.sim._next.body_q):
        got = ward.run(lambda: stretch(ward.sim.state.body_q, SICK * BODIES + 1, 0.0))
    np.testing.assert_array_equal(got[OTHERS, :], ward.healthy[OTHERS, :])
    assert ward.held == [0, AFTER, 0]


# What is known before anything moves.


def box_with_inertia(change: Callable[[Array], Array]) -> newton.Model:
    builder = newton.ModelBuilder()
    body = add_box(builder, (0, 0, 1))
    builder.body_label[body] = "odd"
    model = builder.finalize(device="cpu")
    inertia = change(model.body_inertia.numpy().astype(float)[0])
    model.body_inertia.assign(inertia[None])
    with np.errstate(all="ignore"):
        model.body_inv_inertia.assign(np.linalg.inv(inertia)[None])
    return model


def skewed(inertia: Array) -> Array:
    return inertia + inertia[0, 0] * np.array([[0, 0.1, 0], [0, 0, 0], [0, 0, 0]])


def indefinite(inertia: Array) -> Array:
    return inertia @ np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("change", "problem"),
    [(skewed, "is not symmetric"), (indefinite, "has a negative principal moment")],
)
def test_what_is_no_inertia_is_refused(change: Callable, problem: str) -> None:
    with pytest.raises(ValueError, match=rf"body_inertia\[0\] \('.*odd'\) {problem}"):
        SolverAVBD(box_with_inertia(change))


def test_an_inertia_against_the_triangle_inequality_is_simulated_with_a_warning() -> None:
    """The equations of motion know no such inequality: a free body turns at its rate."""
    model = box_with_inertia(lambda inertia: inertia @ np.diag([1.0, 1.0, 5.0]))
    with pytest.warns(UserWarning, match="No mass has such moments of inertia as body .*odd"):
        solver = SolverAVBD(model)
    state = model.state()
    state.body_qd.assign([[0, 0, 0, 0, 0, 2.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solver.step(state, state, None, None, DT)
    np.testing.assert_allclose(state.body_qd.numpy()[0, 3:], [0, 0, 2.0], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("body_q", np.nan, "is not finite"),
        ("body_qd", np.inf, "is not finite"),
        ("joint_q", np.nan, "is not finite"),
        ("joint_rest_q", np.inf, "is not finite"),
        ("joint_mimic_coeffs", np.nan, "is not finite"),
        ("joint_stiffness", -1.0, "is negative"),
        ("joint_damping", -1.0, "is negative"),
        ("joint_limit_ke", -1.0, "is negative"),
        ("shape_transform", np.nan, "is not finite"),
        ("shape_material_ke", -1.0, "is negative"),
    ],
)
def test_a_model_that_makes_no_sense_is_refused(name: str, value: float, problem: str) -> None:
    """At construction, and when the change is notified."""
    builder = newton.ModelBuilder()
    add_workshop(builder)
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model)
    spoil(getattr(model, name), 1, value)
    with pytest.raises(ValueError, match=rf"model\.{name}\[1\] .*{problem}"):
        SolverAVBD(model)
    with pytest.raises(ValueError, match=rf"model\.{name}\[1\] .*{problem}"):
        solver.notify_model_changed(ModelFlags.ALL)


@pytest.mark.parametrize("name", ["joint_X_p", "joint_X_c", "shape_transform"])
def test_a_frame_needs_a_unit_quaternion(name: str) -> None:
    builder = newton.ModelBuilder()
    add_workshop(builder)
    model = builder.finalize(device="cpu")
    stretch(getattr(model, name), 2, 1.01)
    with pytest.raises(ValueError, match=rf"model\.{name}\[2\] .*is not a unit quaternion"):
        SolverAVBD(model)


# Arguments of a step.


def test_missing_contacts_are_said_once() -> None:
    """Nothing touches then, which is a way to simulate; a scene without shapes says nothing."""
    sim = Simulation(resting_box())
    with pytest.warns(UserWarning, match="without contacts.*pass through each other") as caught:
        for _ in range(3):
            sim.solver.step(sim.state, sim.state, None, None, DT)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    builder = newton.ModelBuilder()
    add_mass(builder)
    apart = Simulation(builder, collide=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        apart.step()


def test_contacts_with_short_arrays_are_refused() -> None:
    """By name, before a kernel reads beyond their end."""
    sim = Simulation(resting_box())
    sim.step()
    contacts = newton.CollisionPipeline(sim.model).contacts()
    contacts.rigid_contact_normal = wp.zeros(3, dtype=wp.vec3, device="cpu")
    with pytest.raises(ValueError, match=r"contacts.rigid_contact_normal has 3 entries"):
        sim.solver.step(sim.state, sim.state, None, contacts, DT)


@pytest.mark.parametrize("name", ["joint_f", "joint_target_q", "joint_target_qd"])
def test_a_control_of_another_model_is_refused(ward: Ward, name: str) -> None:
    """Too short, or not there at all; the run goes on."""
    sim, control = ward.sim, ward.sim.model.control()
    for array, problem in ((wp.zeros(2, dtype=float, device="cpu"), "has 2 entries"), (None, "is")):
        setattr(control, name, array)
        with pytest.raises(ValueError, match=rf"control\.{name} {problem}"):
            sim.solver.step(sim.state, sim._next, control, sim.contacts, DT)
    np.testing.assert_array_equal(ward.run(), ward.healthy)


@pytest.mark.parametrize("name", ["body_qd", "body_f"])
def test_a_state_without_an_array_is_refused(name: str) -> None:
    sim = Simulation(resting_box())
    setattr(sim.state, name, None)
    with pytest.raises(ValueError, match="state_in holds no bodies or those of another model"):
        sim.solver.step(sim.state, sim._next, None, sim.contacts, DT)


def test_a_force_on_a_hinge_that_is_no_number_holds_the_world_until_it_is_one() -> None:
    """Where no joint pushes bodies at their COM, too; then it goes on as if nothing had been."""
    builder = newton.ModelBuilder()
    add_hinge_chain(builder, 2)
    sim, healthy = simulate(builder), simulate(builder)
    start = sim.pose
    sim.control.joint_f.fill_(np.nan)
    sim.step(3)
    np.testing.assert_array_equal(sim.pose, start)
    assert sim.solver.status.held_steps[0] == 3
    sim.control.joint_f.zero_()
    sim.step(10)
    healthy.step(10)
    np.testing.assert_allclose(sim.pose, healthy.pose, atol=1.0e-6)


# A model that changed and nobody said so.


def test_changes_that_a_step_does_not_see_are_named() -> None:
    """Effects that the kernels lack and arrays in the place of others; none after the call."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.0)
    add_box(builder, (0, 0, 0.25), mu=0.0)
    sim = Simulation(builder)
    assert sim.solver.unnoticed_changes() == []
    sim.model.shape_material_mu.fill_(0.5)
    sim.model.body_com = wp.clone(sim.model.body_com)
    assert sim.solver.unnoticed_changes() == ["friction", "model.body_com"]
    sim.solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
    assert sim.solver.unnoticed_changes() == []


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("name", ["joint_force", "loop_force", "loop_torque", "acceleration"])
def test_a_step_that_ends_in_what_is_not_finite_holds_for_that_step(
    name: str, parallel: str
) -> None:
    """What joints pushed with is forgotten then: it once kept the world held for good."""
    builder = newton.ModelBuilder()
    joints = add_hinge_chain(builder, 3)
    last = builder.joint_child[joints[-1]]
    builder.add_joint_ball(-1, last, child_xform=wp.transform(wp.vec3(0.05, 0.0, 0.0)))
    builder.body_q[last] = wp.transform(wp.vec3(0.25, 0.0, 0.0), wp.quat_identity())
    builder.joint_X_p[-1] = wp.transform(wp.vec3(0.3, 0.0, 0.0), wp.quat_identity())
    add_contact(builder, last)
    sim = simulate(builder, collide=True, parallel=parallel)
    assert sim.solver.parallel == parallel
    sim.step(8)
    getattr(sim.solver._history, name).fill_(np.nan)
    sim.step(8)
    assert sim.solver.status.held_steps.max() <= 1
    assert np.isfinite(snapshot(sim.state)).all()
    assert np.abs(sim.velocity).max() > 0.0
