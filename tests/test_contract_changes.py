# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""``notify_model_changed``: what a user may change in a model while a solver runs on it."""

import newton
import numpy as np
import pytest
import warp as wp
from contract import pile, record, snapshot, worlds
from helpers import NO_GRAVITY, G, Simulation, add_box, add_ground, add_mass
from newton import ModelFlags

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0
EVERY_FLAG = [flag for flag in ModelFlags if flag != ModelFlags.ALL]


def sliding_box(mu: float) -> Simulation:
    """A cube that slides at 1 m/s over ground of its own friction."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=mu)
    add_box(builder, (0.0, 0.0, 0.25), mu=mu)
    simulation = Simulation(builder)
    simulation.set_velocity(0, (1.0, 0.0, 0.0))
    return simulation


def test_friction_can_be_switched_on_in_a_scene_without() -> None:
    """First nothing brakes (to rounding); after the change, Coulomb's mu g, within 2 %."""
    simulation = sliding_box(mu=0.0)
    simulation.step(24)
    assert simulation.velocity[0, 0] == pytest.approx(1.0, abs=1e-5)
    simulation.model.shape_material_mu.fill_(0.4)
    simulation.solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
    simulation.step(24)
    assert 1.0 - simulation.velocity[0, 0] == pytest.approx(0.4 * G * 0.1, rel=0.02)


def test_friction_can_change_without_a_notification_where_there_was_some() -> None:
    """Materials are read live; Coulomb's mu g before and after, within 2 %."""
    simulation = sliding_box(mu=0.1)
    for mu in (0.1, 0.4):
        simulation.model.shape_material_mu.fill_(mu)
        before = simulation.velocity[0, 0]
        simulation.step(24)
        assert before - simulation.velocity[0, 0] == pytest.approx(mu * G * 0.1, rel=0.02)


def test_unequal_moments_of_inertia_can_come_at_run_time() -> None:
    """After the change the body tumbles as one that was made so, bit for bit."""
    unequal = np.diag([0.3, 0.2, 0.1]).astype(np.float32)

    def spinning(inertia: np.ndarray) -> Simulation:
        builder = newton.ModelBuilder(gravity=NO_GRAVITY)
        add_mass(builder, inertia=inertia)
        simulation = Simulation(builder, collide=False)
        simulation.set_velocity(0, angular=(0.1, 8.0, 0.1))
        return simulation

    expected = spinning(unequal)
    changed = spinning(0.1 * np.eye(3))
    changed.model.body_inertia.assign(unequal[None])
    changed.model.body_inv_inertia.assign(expected.model.body_inv_inertia)
    changed.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
    frames = record(changed, 120)
    np.testing.assert_array_equal(frames, record(expected, 120))
    # about the middle axis a wobble grows by exp(4.6 t), which equal moments would not let it
    assert np.ptp(frames[:, 0, 10]) > 0.3


def test_a_mass_can_change_under_a_stack() -> None:
    """Ten times the weight on top is carried within a few steps: no sinking.

    Bound: a hundredth of the free fall in the 30 steps.
    """
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.25))
    add_box(builder, (0.0, 0.0, 0.75))
    simulation = Simulation(builder)
    simulation.step(20)
    model = simulation.model
    for name, factor in (
        ("body_mass", 10.0),
        ("body_inertia", 10.0),
        ("body_inv_mass", 0.1),
        ("body_inv_inertia", 0.1),
    ):
        values = getattr(model, name).numpy()
        values[1] *= factor
        getattr(model, name).assign(values)
    simulation.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
    simulation.step(30)
    np.testing.assert_allclose(simulation.pose[:, 2], [0.25, 0.75], atol=0.01 * 0.5 * G * 0.125**2)


def test_arrays_of_the_model_can_be_replaced() -> None:
    """New arrays in the place of old ones are used from the notification on."""
    builder = newton.ModelBuilder()
    add_mass(builder, mass=2.0)
    model = builder.finalize(device="cpu")
    solver, state = SolverAVBD(model), model.state()
    state.body_f.assign([[6.0, 0, 0, 0, 0, 0]])
    model.gravity = wp.array([(0.0, 1.0, 0.0)], dtype=wp.vec3, device="cpu")
    model.body_mass = wp.array([3.0], dtype=float, device="cpu")
    model.body_inv_mass = wp.array([1.0 / 3.0], dtype=float, device="cpu")
    solver.notify_model_changed(ModelFlags.MODEL_PROPERTIES | ModelFlags.BODY_INERTIAL_PROPERTIES)
    solver.step(state, state, None, None, 0.1)
    np.testing.assert_allclose(state.body_qd.numpy()[0, :3], [0.2, 0.1, 0.0], rtol=1e-6)


def test_a_notification_without_a_change_changes_nothing() -> None:
    """Multipliers stay: the run goes on as it would have, bit for bit, whatever the flag.

    Users notify in every episode or frame, often without knowing that nothing was changed. The
    pile rests, slides and is hit in these 56 steps, and odd and even steps are notified.
    """
    notified, plain = Simulation(pile()), Simulation(pile())
    for flag in (*EVERY_FLAG, ModelFlags.ALL, 1 << 24, 0):
        for _ in range(3):
            np.testing.assert_array_equal(record(notified, 1), record(plain, 1), str(flag))
        notified.solver.notify_model_changed(flag)
    np.testing.assert_array_equal(record(notified, 8), record(plain, 8))


def test_a_notification_keeps_the_status() -> None:
    """What happened since the last reset is still known after a notification."""
    simulation = Simulation(worlds(pile(), 2))
    simulation.set_velocity(0, (np.nan, 0.0, 0.0))
    simulation.step(2)
    simulation.solver.notify_model_changed(ModelFlags.MODEL_PROPERTIES)
    assert simulation.solver.status.held_steps.tolist() == [2, 0]


def test_a_graph_stays_valid_through_a_notification() -> None:
    """A graph that was captured before a change of gravity replays with the new one, bit for bit.

    Domain randomisation does this: capture once, then change the model between replays.
    """
    eager, replayed = Simulation(pile()), Simulation(pile())
    with wp.ScopedCapture(device="cpu") as capture:
        replayed.step(2)
    for gravity in ((0.0, 0.0, -9.81), (0.5, 0.0, -5.0)):
        for simulation in (eager, replayed):
            simulation.model.set_gravity(gravity)
            simulation.solver.notify_model_changed(ModelFlags.MODEL_PROPERTIES)
        # whatever frees memory may now hand it out again
        clutter = [wp.full(8, 7, dtype=wp.int32, device="cpu") for _ in range(64)]
        for _ in range(10):
            eager.step(2)
            wp.capture_launch(capture.graph)
        del clutter
        np.testing.assert_array_equal(snapshot(replayed.state), snapshot(eager.state))


def test_a_change_can_be_notified_inside_a_graph() -> None:
    """Friction from within a graph: the notification reads nothing back and is replayed.

    Each replay sets the friction and takes 24 steps: Coulomb's mu g, within 2 %.
    """
    simulation = sliding_box(mu=0.0)
    friction = wp.full(2, 0.4, dtype=float, device="cpu")
    with wp.ScopedCapture(device="cpu") as capture:
        wp.copy(simulation.model.shape_material_mu, friction)
        simulation.solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
        simulation.step(24)
    for speed in (1.0 - 0.4 * G * 0.1, 1.0 - 0.4 * G * 0.2):
        wp.capture_launch(capture.graph)
        assert simulation.velocity[0, 0] == pytest.approx(speed, abs=0.02 * 0.4 * G * 0.1)


def test_a_forbidden_change_is_refused_by_name() -> None:
    """The checks of the constructor hold for changes as well."""
    builder = newton.ModelBuilder()
    add_mass(builder)
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model)
    model.body_mass.assign([-1.0])
    with pytest.raises(ValueError, match=r"body_mass\[0\].*is negative"):
        solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
