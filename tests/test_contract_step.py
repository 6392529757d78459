# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What ``step`` takes and leaves alone, as every Newton solver must."""

import newton
import numpy as np
import pytest
import warp as wp
from contract import pile, record, resting_box, snapshot
from helpers import IDENTITY, G, Simulation, add_box, add_ground, add_mass

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0


def test_a_step_in_place_is_the_same_step() -> None:
    """``state_in is state_out`` gives what two states give, bit for bit: contacts and free."""
    apart, in_place = Simulation(pile()), Simulation(pile())
    for collides in (True, False):
        for _ in range(40):
            apart.step()
            if collides:
                in_place.pipeline.collide(in_place.state, in_place.contacts)
            state = in_place.state
            in_place.solver.step(state, state, in_place.control, in_place.contacts, DT)
            np.testing.assert_array_equal(snapshot(state), snapshot(apart.state))
        apart.pipeline, apart.contacts, in_place.contacts = None, None, None


def test_a_step_without_contacts_falls_through_the_ground() -> None:
    """``contacts=None`` means none: after n steps of backward Euler, z = z0 - g h^2 n (n + 1)/2.

    20 roundings of z (each 3e-8 m) stay far below the bound; the fall is 36 mm.
    """
    simulation = Simulation(resting_box(), collide=False, scheme="euler")
    simulation.step(20)
    assert simulation.pose[0, 2] == pytest.approx(0.25 - G * DT**2 * 210, abs=1e-6)


def test_no_control_is_the_models_own() -> None:
    """``control=None`` takes ``model.joint_f``, which here holds a body against gravity."""
    builder = newton.ModelBuilder()
    add_mass(builder, mass=2.0)
    model = builder.finalize(device="cpu")
    model.joint_f.assign([0.0, 0.0, 2.0 * G, 0.0, 0.0, 0.5])
    solver, state, out = SolverAVBD(model), model.state(), model.state()
    solver.step(state, out, None, None, DT)
    # what is left of m g - m g is a rounding of g h; alpha = torque / I = 0.5 / 0.1
    expected = [0.0, 0.0, 0.0, 0.0, 0.0, 5.0 * DT]
    np.testing.assert_allclose(out.body_qd.numpy()[0], expected, atol=1e-7)


def test_a_control_that_is_given_goes_before_the_models() -> None:
    """The FREE joint of a given control pushes its body by f h / m."""
    builder = newton.ModelBuilder()
    add_mass(builder, mass=2.0)
    model = builder.finalize(device="cpu")
    model.set_gravity((0.0, 0.0, 0.0))
    control = model.control()
    control.joint_f.assign([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    state = model.state()
    SolverAVBD(model).step(state, state, control, None, 0.1)
    np.testing.assert_allclose(state.body_qd.numpy()[0, :3], [0.15, 0.0, 0.0], rtol=1e-6)


def test_external_forces_are_read_and_not_cleared() -> None:
    """``body_f`` belongs to the user: after the step it still holds what was put in."""
    simulation = Simulation(resting_box())
    simulation.push(0, (10.0, 0.0, 5.0), (0.0, 1.0, 0.0))
    before = simulation.state.body_f.numpy()
    state_in = simulation.state
    simulation.step()
    np.testing.assert_array_equal(state_in.body_f.numpy(), before)
    np.testing.assert_array_equal(simulation.state.body_f.numpy(), before)


def test_a_scene_without_shapes_runs_with_its_empty_contact_buffer() -> None:
    """A buffer in which nothing can ever be does not disturb free fall (v = -g h)."""
    builder = newton.ModelBuilder()
    add_mass(builder)
    simulation = Simulation(builder)
    simulation.step()
    assert simulation.velocity[0, 2] == pytest.approx(-G * DT, rel=1e-6)


def test_a_scene_without_joints_runs() -> None:
    """Bodies of ``add_link`` have no FREE joint; they rest on the ground all the same.

    Rest: the cube moves by less than a thousandth of the distance that it would fall in 60 steps.
    """
    builder = newton.ModelBuilder()
    add_ground(builder)
    body = builder.add_link(xform=wp.transform(wp.vec3(0.0, 0.0, 0.25), IDENTITY))
    builder.add_shape_box(body, hx=0.25, hy=0.25, hz=0.25)
    simulation = Simulation(builder)
    assert simulation.model.joint_count == 0
    simulation.step(60)
    assert abs(simulation.pose[0, 2] - 0.25) < 1e-3 * 0.5 * G * 0.25**2


def test_a_scene_without_bodies_steps_and_resets() -> None:
    """A ground alone is a scene; nothing is to be done, and nothing fails."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    model = builder.finalize(device="cpu")
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    solver, state = SolverAVBD(model), model.state()
    pipeline.collide(state, contacts)
    solver.step(state, model.state(), None, contacts, DT)
    solver.reset(state)
    solver.notify_model_changed(newton.ModelFlags.ALL)
    assert solver.status.contact_overflow == 0


def test_joint_coordinates_are_left_to_the_user() -> None:
    """A maximal solver writes bodies only: ``eval_ik`` is the caller's (as for XPBD and VBD)."""
    simulation = Simulation(pile())
    for state in (simulation.state, simulation._next):
        state.joint_q.fill_(7.0)
        state.joint_qd.fill_(8.0)
    simulation.step(2)
    assert np.all(simulation.state.joint_q.numpy() == 7.0)
    assert np.all(simulation.state.joint_qd.numpy() == 8.0)


def test_a_teleported_body_has_no_velocity_from_it() -> None:
    """The velocity comes from ``state_in.body_qd``, never from poses of an earlier step.

    A cube at rest is put 3 m higher; its first step there is free fall, v = -g h.
    """
    simulation = Simulation(resting_box())
    simulation.step(30)
    pose = simulation.state.body_q.numpy()
    pose[0, 2] += 3.0
    simulation.state.body_q.assign(pose)
    simulation.state.body_qd.zero_()
    simulation.step()
    np.testing.assert_allclose(simulation.velocity[0], [0, 0, -G * DT, 0, 0, 0], atol=1e-6)


def test_changing_the_time_step_between_steps_keeps_a_stack_at_rest() -> None:
    """Multipliers are forces [N], so they hold at any step: no kick when dt goes up or down.

    Bound: a tenth of the speed g h that the shorter step would take to forget a multiplier.
    """
    builder = resting_box()
    add_box(builder, (0.0, 0.0, 0.75))
    simulation = Simulation(builder)
    simulation.step(30)
    for dt in (1.0 / 60.0, 1.0 / 960.0, 1.0 / 240.0):
        simulation.dt = dt
        speed = np.abs(record(simulation, 5)[:, :, 7:]).max()
        assert speed < 0.1 * G / 960.0, f"dt {dt}: {speed}"


def count_allocations(monkeypatch: pytest.MonkeyPatch, device: wp.Device) -> list[int]:
    """A list that grows by the size of each allocation [bytes] from now on."""
    sizes: list[int] = []
    allocator = type(device.get_allocator())
    original = allocator.allocate

    def allocate(self: object, size: int) -> int:
        sizes.append(size)
        return original(self, size)

    monkeypatch.setattr(allocator, "allocate", allocate)
    return sizes


def test_a_step_neither_allocates_nor_reads_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first step no buffer is made and no number comes to the host: it can be captured.

    The same goes for a reset and for observables that were allocated before.
    """
    simulation = Simulation(pile())
    simulation.observe("contact_f", "body_qdd")
    mask = wp.array([True, False], dtype=wp.bool, device="cpu")
    simulation.step(2)
    simulation.solver.reset(simulation.state, mask)

    sizes = count_allocations(monkeypatch, simulation.solver.device)

    def numpy(self: wp.array) -> None:
        raise AssertionError("a step read a device array on the host")

    monkeypatch.setattr(wp.array, "numpy", numpy)
    state, out = simulation.state, simulation._next
    for contacts in (simulation.contacts, None):
        observables = simulation.observables if contacts else None
        for control in (simulation.control, None):
            simulation.solver.step(state, out, control, contacts, DT, observables=observables)
            simulation.solver.step(out, state, control, contacts, DT, observables=observables)
    simulation.solver.reset(state, mask)
    monkeypatch.undo()
    assert sizes == []
