# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The same bits from the same start, in a scene with nearly every effect, however it is run.

Of piles alone: ``test_contract_capture.py``, ``test_contract_reset.py``. Another order within the
contact buffer is the same to rounding: ``test_contract_contacts.py``.
"""

from collections.abc import Sequence
from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from contract import record, snapshot
from helpers import Array, G, Simulation
from joint_scenes import WORLD, add_link, transform
from workshop import BODIES, add_workshop

from newton_avbd.drivers import workers

STEPS = 40
SPEEDS = (0.0, 0.7, -0.4)
"""What sets three worlds apart: a velocity of their upper boxes [m/s]."""


def workshops_of(worlds: Sequence[int], **settings: Any) -> Simulation:
    """Workshops with the speeds of these worlds, in this order."""
    builder = newton.ModelBuilder()
    for world in worlds:
        builder.begin_world()
        add_workshop(builder)
        builder.end_world()
        upper = builder.body_count - BODIES + 1
        builder.body_qd[upper] = wp.spatial_vector(SPEEDS[world], 0.1, 0.0, 0.0, 0.0, SPEEDS[world])
    return Simulation(builder, **settings)


def by_world(sim: Simulation) -> Array:
    return snapshot(sim.state).reshape(len(SPEEDS), BODIES, -1)


@pytest.fixture(scope="module")
def sim() -> Simulation:
    """Of worlds 0, 1, 2; each test resets it."""
    return workshops_of((0, 1, 2))


@pytest.fixture(scope="module")
def expected() -> Array:
    """Poses and velocities by world after an eager run from the start."""
    first = workshops_of((0, 1, 2))
    first.step(STEPS)
    found = by_world(first)
    assert not np.array_equal(found[0], found[1])  # the worlds differ
    return found


def test_runs_are_the_same(sim: Simulation, expected: Array) -> None:
    """Of two solvers; and of one after a reset of all, whether things have moved far or hardly."""
    for before in (0, 2, 7):
        sim.step(before)
        sim.solver.reset(sim.state)
        sim.step(STEPS)
        np.testing.assert_array_equal(by_world(sim), expected)
        sim.solver.reset(sim.state)


def test_a_reset_of_some_worlds_changes_no_other(sim: Simulation, expected: Array) -> None:
    """World 1 is put back on its way and then goes it again; the others never notice."""
    sim.solver.reset(sim.state)
    sim.step(STEPS // 2)
    mask = wp.array([False, True, False, False], dtype=wp.bool, device="cpu")
    sim.solver.reset(sim.state, mask)
    sim.step(STEPS // 2)
    np.testing.assert_array_equal(by_world(sim)[[0, 2]], expected[[0, 2]])
    sim.step(STEPS // 2)
    np.testing.assert_array_equal(by_world(sim)[1], expected[1])


def test_a_replayed_graph_is_the_eager_run(sim: Simulation, expected: Array) -> None:
    """With resets of the whole in it, and with resets of one world outside of it."""
    sim.solver.reset(sim.state)
    sim.step(2)
    with wp.ScopedCapture(device="cpu") as steps:
        sim.step(2)
    with wp.ScopedCapture(device="cpu") as reset:
        sim.solver.reset(sim.state)
    for _ in range(2):
        wp.capture_launch(reset.graph)
        for _ in range(STEPS // 2):
            wp.capture_launch(steps.graph)
        np.testing.assert_array_equal(by_world(sim), expected)


@pytest.mark.parametrize("count", [2, 3])
def test_threads_that_share_the_worlds_change_nothing(
    count: int, expected: Array, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a thread has a single world, and the bodies of one are predicted by several."""
    for name in ("HANDOVER", "LEAST", "REST"):
        monkeypatch.setattr(workers, name, 0.0 if name == "REST" else 1.0e-12)
    shared = workshops_of((0, 1, 2), workers=count)
    shared.step(STEPS)
    np.testing.assert_array_equal(by_world(shared), expected)


def test_another_solver_goes_on_from_a_checkpoint(sim: Simulation, expected: Array) -> None:
    """To the bits of the run that was left, whatever that solver did before."""
    first = workshops_of((0, 1, 2))
    first.step(STEPS // 2)
    checkpoint = first.solver.checkpoint()
    left = {name: getattr(first.state, name).numpy().copy() for name in ("body_q", "body_qd")}
    first.step(3)  # copies do not change
    sim.step(2)
    sim.solver.restore(checkpoint)
    for name, array in left.items():
        getattr(sim.state, name).assign(array)
    sim.step(STEPS - STEPS // 2)
    np.testing.assert_array_equal(by_world(sim), expected)
    checkpoint.pop("history.step")
    with pytest.raises(ValueError, match=r"does not fit this solver: history\.step\."):
        sim.solver.restore(checkpoint)


def test_a_checkpoint_knows_where_joints_to_kinematic_bodies_were() -> None:
    """A wheel whose damper feels how its base is turned on goes on to the same bits."""

    def turning() -> Simulation:
        builder = newton.ModelBuilder()
        base, wheel = add_link(builder, is_kinematic=True), add_link(builder)
        joint = builder.add_joint_revolute(base, wheel, axis=(0.0, 0.0, 1.0), damping=1.0)
        builder.add_articulation([joint])
        sim = Simulation(builder, collide=False)
        sim.set_velocity(base, angular=(0.0, 0.0, 2.0))
        return sim

    def step(sim: Simulation, turned: float) -> None:
        sim.step()
        pose = sim.pose
        pose[0, 5:] = np.sin(0.5 * turned), np.cos(0.5 * turned)
        sim.state.body_q.assign(pose.astype(np.float32))

    first, second = turning(), turning()
    for k in range(5):
        step(first, 0.1 * k)
    second.solver.restore(first.solver.checkpoint())
    for name in ("body_q", "body_qd"):
        getattr(second.state, name).assign(getattr(first.state, name))
    step(first, 0.5)
    step(second, 0.5)
    np.testing.assert_array_equal(snapshot(second.state), snapshot(first.state))


@pytest.mark.parametrize("order", [(2, 0, 1), (1, 2, 0)])
def test_the_order_of_worlds_changes_nothing(order: tuple[int, ...], expected: Array) -> None:
    """Each world moves as in its own place, bit for bit."""
    permuted = workshops_of(order)
    permuted.step(STEPS)
    np.testing.assert_array_equal(by_world(permuted), expected[list(order)])


def test_a_reset_forgets_where_friction_held() -> None:
    """A hinge that friction holds against its weight, moved by less than a rounding before."""
    builder = newton.ModelBuilder()
    arm = add_link(builder, xform=transform((0.2, 0.0, 0.0)))
    hinge = builder.add_joint_revolute(
        WORLD, arm, axis=(0, 1, 0), child_xform=transform((-0.2, 0.0, 0.0)), friction=5.0
    )
    builder.add_articulation([hinge])
    fresh, other = Simulation(builder, collide=False), Simulation(builder, collide=False)
    expected = record(fresh, 10)
    for before in (1, 2, 3):
        # beyond friction less the weight by what accelerates it by some 2e-3 rad/s^2
        other.push(arm, torque=(0.0, 5.0 - 0.2 * G + 2e-4, 0.0))
        other.step(before)
        other.push(arm)
        other.solver.reset(other.state)
        np.testing.assert_array_equal(record(other, 10), expected)
        other.solver.reset(other.state)
