# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A collision pipeline that the solver owns: when it runs, and what the caller may still pass."""

import newton
import numpy as np
import pytest
from contract import contact_count, pile, record, resting_box, snapshot
from helpers import Simulation
from newton.solvers import SolverBase

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0
RIGID = SolverBase.CollisionSlot.RIGID
Frequency = SolverBase.CollisionFrequencyType


def owning(builder: newton.ModelBuilder, **settings: object) -> SolverAVBD:
    """A solver that owns the pipeline of its model."""
    model = builder.finalize(device="cpu")
    return SolverAVBD(model, collision_pipeline=newton.CollisionPipeline(model), **settings)


def test_an_owned_pipeline_is_the_same_as_detection_before_each_step() -> None:
    """Detection on ``state_in`` at the start of a step, bit for bit, contacts and trajectory."""
    outside = Simulation(pile())
    solver = owning(pile())
    state, out = solver.model.state(), solver.model.state()
    for _ in range(40):
        outside.step()
        solver.step(state, out, None, None, DT)
        state, out = out, state
        np.testing.assert_array_equal(snapshot(state), snapshot(outside.state))
    assert contact_count(solver.contacts) == contact_count(outside.contacts) > 0


def test_contacts_besides_an_owned_pipeline_are_an_error() -> None:
    """There is one source of contacts; the message says which argument is too much."""
    solver = owning(resting_box())
    state = solver.model.state()
    with pytest.raises(ValueError, match=r"contacts.*must be None"):
        solver.step(state, state, None, solver.contacts, DT)


def test_without_detection_the_caller_fills_the_owned_buffer() -> None:
    """``NONE`` leaves ``solver.contacts`` to the caller: empty it is no contact, filled it holds.

    The cube falls through the ground for 10 steps in the one case and rests in the other.
    """
    for fills in (False, True):
        none = {RIGID: Frequency.NONE}
        solver = owning(resting_box(), collision_frequency_type=none, scheme="euler")
        state = solver.model.state()
        for _ in range(10):
            if fills:
                solver.collision_pipeline.collide(state, solver.contacts)
            solver.step(state, state, None, None, DT)
        fall = 0.25 - float(state.body_q.numpy()[0, 2])
        assert fall == pytest.approx(0.0 if fills else 9.81 * DT**2 * 55, abs=1e-6)


def test_the_schedule_can_change_between_steps() -> None:
    """Detection every second step, by switching ``NONE`` and ``PRE_INIT``, as Newton documents."""
    solver = owning(resting_box())
    state = solver.model.state()
    generations = []
    for i in range(4):
        schedule = Frequency.NONE if i % 2 else Frequency.PRE_INIT
        solver.set_collision_frequency(collision_frequency_type={RIGID: schedule})
        solver.step(state, state, None, None, DT)
        generations.append(int(solver.contacts.contact_generation.numpy()[0]))
    assert np.diff(generations).tolist() == [0, 1, 0]


@pytest.mark.parametrize("schedule", [Frequency.PRE_POST_INIT, Frequency.ITERATIONS])
def test_a_schedule_inside_the_step_is_refused_by_name(schedule: Frequency) -> None:
    """At construction and later; the old schedule then stays."""
    with pytest.raises(NotImplementedError, match=schedule.name):
        owning(resting_box(), collision_frequency_type={RIGID: schedule})
    solver = owning(resting_box())
    with pytest.raises(NotImplementedError, match=schedule.name):
        solver.set_collision_frequency(collision_frequency_type={RIGID: schedule})
    assert solver.collision_frequency_type[RIGID] == Frequency.AUTO


def test_a_schedule_without_a_pipeline_is_an_error() -> None:
    """Newton's rule: there is nothing that could detect."""
    model = resting_box().finalize(device="cpu")
    with pytest.raises(ValueError, match="requires a solver-owned pipeline"):
        SolverAVBD(model, collision_frequency_type={RIGID: Frequency.PRE_INIT})


def test_a_pipeline_of_another_model_is_an_error() -> None:
    """Newton's rule: shapes and bodies would not be the same ones."""
    pipeline = newton.CollisionPipeline(resting_box().finalize(device="cpu"))
    with pytest.raises(ValueError, match="same model"):
        SolverAVBD(resting_box().finalize(device="cpu"), collision_pipeline=pipeline)


def test_a_speculative_pipeline_gets_the_step_it_looks_ahead() -> None:
    """An owned pipeline that widens its gaps by velocity and ``dt`` catches a fast body in time.

    At 40 m/s the cube moves 0.17 m a step and the detection gap is 0.02 m. It may sink in by
    nothing but rounding of its height (the impact is one step of exact contact at the ground).
    """
    builder = newton.ModelBuilder()
    builder.rigid_gap = 0.02
    builder.add_ground_plane()
    body = builder.add_body(xform=(0.0, 0.0, 1.3, 0.0, 0.0, 0.0, 1.0))
    builder.add_shape_box(body, hx=0.25, hy=0.25, hz=0.25)
    builder.body_qd[body] = (0.0, 0.0, -40.0, 0.0, 0.0, 0.0)
    model = builder.finalize(device="cpu")
    pipeline = newton.CollisionPipeline(model, speculative_contact_gap_max=1.0)
    solver, state = SolverAVBD(model, collision_pipeline=pipeline), model.state()
    lowest = 1.0
    for _ in range(30):
        solver.step(state, state, None, None, DT)
        lowest = min(lowest, float(state.body_q.numpy()[0, 2]))
    assert lowest > 0.25 - 1e-4


def test_two_runs_are_bit_identical() -> None:
    """No step depends on memory addresses, time or leftovers of another solver."""
    np.testing.assert_array_equal(record(Simulation(pile()), 60), record(Simulation(pile()), 60))
