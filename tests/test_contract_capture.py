# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Graphs that are captured before anything ran replay as eager stepping does, and worlds agree."""

import newton
import numpy as np
import pytest
import warp as wp
from contract import add_pile, pile, record, snapshot, worlds
from helpers import IDENTITY, Simulation

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0
STEPS = 60

VARIANTS = {
    "one world": (1, {}, {}),
    "many worlds": (3, {}, {}),
    "contact matching": (1, {}, {"contact_matching": "latest"}),
    "compliant contacts": (1, {"compliant_contacts": True}, {}),
    "ramp": (1, {"formulation": "ramp"}, {}),
}
"""Number of worlds, settings of the solver, settings of the pipeline."""


def simulation_of(variant: str) -> Simulation:
    """The pile in one of the ways that a step can be compiled."""
    world_count, solver, pipeline = VARIANTS[variant]
    simulation = Simulation(worlds(pile(), world_count), **solver)
    simulation.pipeline = newton.CollisionPipeline(simulation.model, **pipeline)
    simulation.contacts = simulation.pipeline.contacts()
    return simulation


def replay(simulation: Simulation, in_graph: int, state: newton.State) -> np.ndarray:
    """Captures ``in_graph`` steps before any ran, replays them up to STEPS; final snapshot."""
    with wp.ScopedCapture(device="cpu") as capture:
        simulation.step(in_graph)
    for _ in range(STEPS // in_graph):
        wp.capture_launch(capture.graph)
    return snapshot(state)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_replayed_graph_is_the_eager_run(variant: str) -> None:
    """Captured before any eager step, two steps a graph, bit for bit after 60 steps."""
    eager, replayed = simulation_of(variant), simulation_of(variant)
    got = replay(replayed, 2, replayed.state)
    np.testing.assert_array_equal(got, record(eager, STEPS)[-1])


@pytest.mark.parametrize("in_graph", [1, 3, 4])
def test_a_graph_may_hold_any_number_of_steps_in_place(in_graph: int) -> None:
    """Odd numbers too: which of its two buffers the solver reads is kept on the device."""
    eager, replayed = Simulation(pile()), Simulation(pile())
    replayed._next = replayed.state
    got = replay(replayed, in_graph, replayed.state)
    np.testing.assert_array_equal(got, record(eager, STEPS)[-1])


def test_an_odd_graph_over_two_states_follows_its_buffers() -> None:
    """Three steps from A over B to B, then A taken from B by hand: as three eager steps a time."""
    eager, replayed = Simulation(pile()), Simulation(pile())
    first, last = replayed.state, replayed._next
    with wp.ScopedCapture(device="cpu") as capture:
        replayed.step(3)
        wp.copy(first.body_q, last.body_q)
        wp.copy(first.body_qd, last.body_qd)
    expected = record(eager, 30)
    for i in range(10):
        wp.capture_launch(capture.graph)
        np.testing.assert_array_equal(snapshot(first), expected[3 * i + 2])


def test_graphs_and_eager_steps_can_be_mixed() -> None:
    """Replays go on from where eager steps ended and the other way round."""
    mixed = Simulation(pile())
    expected = record(Simulation(pile()), 20)
    with wp.ScopedCapture(device="cpu") as capture:
        mixed.step(2)
    for i in range(5):
        wp.capture_launch(capture.graph)
        np.testing.assert_array_equal(snapshot(mixed.state), expected[4 * i + 1])
        mixed.step(2)
        np.testing.assert_array_equal(snapshot(mixed.state), expected[4 * i + 3])


def test_an_owned_pipeline_can_be_captured() -> None:
    """Detection inside the step is part of the graph."""
    expected = record(Simulation(pile()), 40)[-1]
    model = pile().finalize(device="cpu")
    solver = SolverAVBD(model, collision_pipeline=newton.CollisionPipeline(model))
    state = model.state()
    with wp.ScopedCapture(device="cpu") as capture:
        solver.step(state, state, None, None, DT)
    for _ in range(40):
        wp.capture_launch(capture.graph)
    np.testing.assert_array_equal(snapshot(state), expected)


def test_observables_are_filled_in_replays() -> None:
    """Forces and accelerations of the last step, bit for bit those of the eager run."""
    eager, replayed = Simulation(pile()), Simulation(pile())
    got, expected = (s.observe("contact_f", "body_qdd") for s in (replayed, eager))
    replay(replayed, 2, replayed.state)
    eager.step(STEPS)
    np.testing.assert_array_equal(got.contact_f.numpy(), expected.contact_f.numpy())
    np.testing.assert_array_equal(got.body_qdd.numpy(), expected.body_qdd.numpy())


def test_a_contact_buffer_unknown_at_construction_can_be_captured_on_a_cpu() -> None:
    """The buffers are then made during the capture and live on; the replays are the eager run."""
    expected = record(Simulation(pile()), 20)[-1]
    model = pile().finalize(device="cpu")
    solver, state = SolverAVBD(model), model.state()
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    with wp.ScopedCapture(device="cpu") as capture:
        pipeline.collide(state, contacts)
        solver.step(state, state, None, contacts, DT)
    for _ in range(20):
        wp.capture_launch(capture.graph)
    np.testing.assert_array_equal(snapshot(state), expected)


def test_a_run_without_contacts_can_be_captured() -> None:
    """Free motion takes another kernel; replays are the eager run."""
    eager, replayed = (Simulation(pile(), collide=False) for _ in range(2))
    got = replay(replayed, 2, replayed.state)
    np.testing.assert_array_equal(got, record(eager, STEPS)[-1])


# Worlds do not feel each other.


def test_each_of_64_worlds_is_the_world_alone() -> None:
    """The same poses in all worlds: bit for bit the run of a single world, in every world.

    No bound on a world's step, no order of contacts or bodies depends on the others.
    """
    alone = record(Simulation(worlds(pile(), 1)), STEPS)[-1]
    together = record(Simulation(worlds(pile(), 64)), STEPS)[-1]
    np.testing.assert_array_equal(together.reshape(64, *alone.shape), np.tile(alone, (64, 1, 1)))


def test_an_implicit_world_is_like_an_explicit_one() -> None:
    """A scene that never called ``begin_world`` runs like the same scene in a world, to the bit."""
    np.testing.assert_array_equal(
        record(Simulation(pile()), STEPS), record(Simulation(worlds(pile(), 1)), STEPS)
    )


def test_worlds_that_stand_apart_agree_to_rounding() -> None:
    """With spacing the poses differ, so their rounding does: half an ulp of 14 m is 5e-7 m.

    Before the impact (35 steps) nothing amplifies it: poses agree to 60 such roundings.
    """
    many = newton.ModelBuilder()
    spread = [wp.transform(wp.vec3(2.0 * i, 0.0, 0.0), IDENTITY) for i in range(8)]
    many.replicate(pile(), 8, xforms=spread)
    frames = record(Simulation(many), 35)[-1].reshape(8, -1, 13)
    shift = np.zeros((8, 1, 7), dtype=np.float32)
    shift[:, 0, 0] = 2.0 * np.arange(8)
    poses = frames[:, :, :7] - shift
    np.testing.assert_allclose(poses, np.tile(poses[:1], (8, 1, 1)), atol=60 * 5e-7)


def test_different_worlds_do_not_change_each_other() -> None:
    """World 0 is a pile, world 1 is empty or a fast ball at the same place: world 0 does not care.

    The scale of a step (gravity, speeds) is each world's own: bit for bit.
    """
    frames = []
    for other in ("nothing", "ball"):
        builder = newton.ModelBuilder()
        builder.begin_world()
        add_pile(builder)
        builder.end_world()
        builder.begin_world(gravity=(0.0, 0.0, -300.0))
        if other == "ball":
            ball = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, 0.5), IDENTITY))
            builder.add_shape_sphere(ball, radius=0.4)
            builder.body_qd[ball] = wp.spatial_vector(50.0, 0.0, -30.0, 3.0, 2.0, 1.0)
        builder.end_world()
        frames.append(record(Simulation(builder), 40)[:, :4])
    np.testing.assert_array_equal(frames[0], frames[1])


def test_a_world_that_is_not_finite_leaves_the_others_alone() -> None:
    """NaN in one world: it is held and reported, the other runs on bit for bit."""
    expected = record(Simulation(worlds(pile(), 2)), 30)
    simulation = Simulation(worlds(pile(), 2))
    simulation.step(10)
    simulation.push(0, (np.inf, 0.0, 0.0))
    got = record(simulation, 20)
    np.testing.assert_array_equal(got[:, 4:], expected[10:, 4:])
    assert simulation.solver.status.held_steps.tolist() == [20, 0]
