# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""``reset`` puts chosen worlds back to the model's start and forgets their multipliers."""

import newton
import numpy as np
import pytest
import warp as wp
from contract import pile, record, snapshot, worlds
from helpers import IDENTITY, G, Simulation, add_box, surface
from newton import StateFlags

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0
BODIES = 4
"""Bodies of the pile, of which each world holds one."""


def mask(*selected: bool) -> wp.array:
    """A reset mask: one entry a world, and one for global bodies."""
    return wp.array(selected, dtype=wp.bool, device="cpu")


def of_world(frames: np.ndarray, world: int) -> np.ndarray:
    """What belongs to one world, along the body axis (the last but one)."""
    return frames[..., BODIES * world : BODIES * (world + 1), :]


def test_only_the_masked_worlds_are_put_back() -> None:
    """World 1 of three is at the model's poses and velocities, the others are untouched."""
    simulation = Simulation(worlds(pile(), 3))
    start = snapshot(simulation.state)
    simulation.step(30)
    before = snapshot(simulation.state)
    simulation.solver.reset(simulation.state, mask(False, True, False, False))
    after = snapshot(simulation.state)
    np.testing.assert_array_equal(of_world(after, 1), of_world(start, 1))
    for world in (0, 2):
        np.testing.assert_array_equal(of_world(after, world), of_world(before, world))


def test_a_reset_world_runs_as_in_a_fresh_solver_and_the_others_run_on() -> None:
    """Nothing is left of its contacts, and nothing is lost of theirs, bit for bit."""
    expected = record(Simulation(worlds(pile(), 3)), 60)
    simulation = Simulation(worlds(pile(), 3))
    simulation.step(30)
    simulation.solver.reset(simulation.state, mask(False, True, False, False))
    got = record(simulation, 30)
    np.testing.assert_array_equal(of_world(got, 1), of_world(expected[:30], 1))
    for world in (0, 2):
        np.testing.assert_array_equal(of_world(got, world), of_world(expected[30:], world))


@pytest.mark.parametrize("steps", [29, 30])
@pytest.mark.parametrize("matching", ["disabled", "latest"])
def test_after_a_reset_of_all_a_run_repeats_bit_for_bit(steps: int, matching: str) -> None:
    """No mask means all; with contact matching the pipeline's history is the caller's to reset.

    The bodies are thrown up first, so that they are not in the start's condition when it comes.
    """
    simulation = Simulation(pile())
    simulation.pipeline = newton.CollisionPipeline(simulation.model, contact_matching=matching)
    simulation.contacts = simulation.pipeline.contacts()
    expected = record(simulation, steps)
    for body in range(BODIES):
        simulation.set_velocity(body, (0.0, 0.0, 3.0))
    simulation.step(3)
    simulation.solver.reset(simulation.state)
    simulation.pipeline.reset_contact_matching()
    np.testing.assert_array_equal(record(simulation, steps), expected)


@pytest.mark.parametrize(
    ("flags", "poses", "velocities"),
    [
        (StateFlags.BODY_Q, True, False),
        (StateFlags.BODY_QD, False, True),
        (StateFlags.BODY_Q | StateFlags.BODY_QD, True, True),
        (StateFlags.JOINT_Q | StateFlags.PARTICLE_Q, False, False),
        (1 << 25, False, False),
        (0, False, False),
        (None, True, True),
    ],
)
def test_flags_choose_what_is_put_back(
    flags: StateFlags | int | None, poses: bool, velocities: bool
) -> None:
    """Only poses and velocities of bodies are the solver's; other and unknown bits do nothing."""
    simulation = Simulation(pile())
    start = snapshot(simulation.state)
    simulation.step(20)
    moved = snapshot(simulation.state)
    simulation.solver.reset(simulation.state, flags=flags)
    after = snapshot(simulation.state)
    np.testing.assert_array_equal(after[:, :7], (start if poses else moved)[:, :7])
    np.testing.assert_array_equal(after[:, 7:], (start if velocities else moved)[:, 7:])


def test_forces_and_joint_coordinates_are_left_to_the_caller() -> None:
    """As in SolverVBD: body_f, joint_q and joint_qd are not the solver's to reset."""
    simulation = Simulation(pile())
    simulation.state.body_f.fill_(3.0)
    simulation.state.joint_q.fill_(2.0)
    simulation.solver.reset(simulation.state)
    assert np.all(simulation.state.body_f.numpy() == 3.0)
    assert np.all(simulation.state.joint_q.numpy() == 2.0)


def test_the_last_entry_of_the_mask_selects_global_bodies() -> None:
    """A kinematic global plate is put back, the cube of the world stays, and the reverse."""
    builder = newton.ModelBuilder()
    plate = builder.add_body(
        xform=wp.transform(wp.vec3(), IDENTITY),
        mass=1.0,
        inertia=wp.mat33(np.eye(3)),
        is_kinematic=True,
    )
    builder.add_shape_box(plate, hx=1.0, hy=1.0, hz=0.1, cfg=surface(density=0.0))
    builder.begin_world()
    cube = add_box(builder, (0.0, 0.0, 2.0))
    builder.end_world()
    simulation = Simulation(builder)
    start = snapshot(simulation.state)
    for selected, kept in (((False, True), cube), ((True, False), plate)):
        poses = simulation.state.body_q.numpy()
        poses[:, 0] += 0.25
        simulation.state.body_q.assign(poses)
        before = snapshot(simulation.state)
        simulation.solver.reset(simulation.state, mask(*selected))
        after = snapshot(simulation.state)
        np.testing.assert_array_equal(after[1 - kept], start[1 - kept])
        np.testing.assert_array_equal(after[kept], before[kept])


def test_a_mask_that_does_not_fit_is_an_error() -> None:
    """Newton's rules: a Warp array of bool with one entry a world and one for globals."""
    simulation = Simulation(worlds(pile(), 2))
    reset = simulation.solver.reset
    with pytest.raises(ValueError, match=r"must equal model\.world_count"):
        reset(simulation.state, mask(True, False))
    with pytest.raises(TypeError, match="dtype bool"):
        reset(simulation.state, wp.zeros(3, dtype=wp.int32, device="cpu"))
    with pytest.raises(ValueError, match="one-dimensional"):
        reset(simulation.state, wp.zeros((3, 1), dtype=wp.bool, device="cpu"))
    with pytest.raises(TypeError, match="Warp array"):
        reset(simulation.state, np.array([True, False, False]))


def test_a_mask_that_does_not_fit_is_an_error_without_bodies_too() -> None:
    """The check does not depend on there being something to reset."""
    model = newton.ModelBuilder().finalize(device="cpu")
    with pytest.raises(ValueError, match=r"must equal model\.world_count"):
        SolverAVBD(model).reset(model.state(), mask(True, True, True))


def test_a_reset_frees_a_world_that_was_held() -> None:
    """A world that came with NaN is held; put back, it runs like a fresh one and counts anew."""
    expected = record(Simulation(worlds(pile(), 2)), 20)
    simulation = Simulation(worlds(pile(), 2))
    simulation.step(10)
    velocity = simulation.state.body_qd.numpy()
    velocity[BODIES, 0] = np.nan
    simulation.state.body_qd.assign(velocity)
    simulation.step(3)
    assert simulation.solver.status.held_steps.tolist() == [0, 3]
    simulation.solver.reset(simulation.state, mask(False, True, False))
    assert simulation.solver.status.held_steps.tolist() == [0, 0]
    np.testing.assert_array_equal(of_world(record(simulation, 20), 1), of_world(expected, 1))


def test_a_reset_inside_a_graph_follows_its_mask() -> None:
    """Captured with a step, it resets in each replay the worlds that the mask then names."""
    simulation = Simulation(worlds(pile(), 2))
    state, solver = simulation.state, simulation.solver
    start = snapshot(state)
    selected = mask(False, False, False)
    with wp.ScopedCapture(device="cpu") as capture:
        solver.reset(state, selected)
        simulation.pipeline.collide(state, simulation.contacts)
        solver.step(state, state, None, simulation.contacts, DT)
    for _ in range(20):
        wp.capture_launch(capture.graph)
    first = record(Simulation(worlds(pile(), 2)), 21)
    np.testing.assert_array_equal(snapshot(state), first[19])
    selected.assign([True, False, False])
    wp.capture_launch(capture.graph)
    after = snapshot(state)
    np.testing.assert_array_equal(of_world(after, 0), of_world(first[0], 0))
    np.testing.assert_array_equal(of_world(after, 1), of_world(first[20], 1))
    assert not np.array_equal(of_world(after, 0), of_world(start, 0))


def test_a_reset_to_the_users_own_state_forgets_the_contacts() -> None:
    """With ``flags=0`` the caller sets the state; the old support must not push it.

    A cube that rested is put 1 m up: its first step is free fall, v = -g h, to rounding.
    """
    builder = newton.ModelBuilder()
    builder.add_ground_plane()
    add_box(builder, (0.0, 0.0, 0.25))
    simulation = Simulation(builder)
    simulation.step(20)
    pose = simulation.state.body_q.numpy()
    pose[0, 2] = 1.25
    simulation.state.body_q.assign(pose)
    simulation.state.body_qd.zero_()
    simulation.solver.reset(simulation.state, flags=0)
    simulation.step()
    np.testing.assert_allclose(simulation.velocity[0], [0, 0, -G * DT, 0, 0, 0], atol=1e-6)
