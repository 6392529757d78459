# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Contact buffers as pipelines really fill them: stale rows, overflow, old contacts, any order."""

import dataclasses
from collections.abc import Callable

import newton
import numpy as np
import pytest
import warp as wp
from contract import (
    ROWS,
    add_pile,
    contact_count,
    pile,
    record,
    reorder,
    resting_box,
    snapshot,
    worlds,
)
from helpers import IDENTITY, G, Simulation, add_box, add_ground, add_sphere, surface

from newton_avbd import SolverAVBD
from newton_avbd.setup import buffers

DT = 1.0 / 240.0


def stack(count: int = 5) -> newton.ModelBuilder:
    """A column of cubes, each on four contacts."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    for i in range(count):
        add_box(builder, (0.0, 0.0, 0.25 + 0.5 * i))
    return builder


def spoil_unused_rows(contacts: newton.Contacts) -> None:
    """Fills the rows beyond the count with shapes that do not exist and numbers that are none."""
    count = contact_count(contacts)
    for name in ROWS:
        array = getattr(contacts, name)
        rows = array.numpy()
        rows[count:] = 2**30 if rows.dtype == np.int32 else np.nan
        array.assign(rows)


def edited(
    simulation: Simulation, steps: int, edit: Callable[[newton.Contacts], None]
) -> np.ndarray:
    """As ``record``, with ``edit(contacts)`` between detection and step."""
    detect = simulation.pipeline.collide

    def collide(state: newton.State, contacts: newton.Contacts) -> None:
        detect(state, contacts)
        edit(contacts)

    simulation.pipeline.collide = collide
    try:
        return record(simulation, steps)
    finally:
        simulation.pipeline.collide = detect


@pytest.mark.parametrize("world_count", [1, 3])
def test_rows_beyond_the_count_are_not_read(world_count: int) -> None:
    """Garbage behind the live contacts changes nothing, bit for bit."""
    clean = record(Simulation(worlds(pile(), world_count)), 40)
    spoilt = edited(Simulation(worlds(pile(), world_count)), 40, spoil_unused_rows)
    np.testing.assert_array_equal(spoilt, clean)


def overflowing(capacity: int) -> Simulation:
    """The stack of five cubes (20 contacts) with a pipeline that holds fewer."""
    simulation = Simulation(stack())
    simulation.pipeline = newton.CollisionPipeline(
        simulation.model, rigid_contact_max=capacity, publish_capacity=False
    )
    simulation.contacts = simulation.pipeline.contacts()
    return simulation


def test_an_overflow_is_reported_and_survived() -> None:
    """The count runs past the capacity: the rows that exist are simulated, the status says it."""
    simulation = overflowing(14)
    simulation.step(3)
    count = contact_count(simulation.contacts)
    assert count > simulation.contacts.rigid_contact_max == 14
    assert simulation.solver.status.contact_overflow == count - 14
    assert np.all(np.isfinite(simulation.velocity))
    # the bottom of the stack is still held: by 14 contacts of 20
    assert simulation.pose[0, 2] == pytest.approx(0.25, abs=0.5 * G * (3 * DT) ** 2)


def test_a_reset_clears_the_reported_overflow() -> None:
    """The status counts what happened since the last reset."""
    simulation = overflowing(14)
    simulation.step(3)
    simulation.solver.reset(simulation.state)
    assert simulation.solver.status.contact_overflow == 0


def test_a_scene_that_fits_reports_no_overflow() -> None:
    """Neither a full buffer nor an empty one is an overflow."""
    simulation = overflowing(20)
    simulation.step(3)
    assert simulation.solver.status.contact_overflow == 0


def as_on_a_gpu(simulation: Simulation) -> Simulation:
    """The same, with its contacts sorted by many threads, and its worlds by their size."""
    solver = simulation.solver
    solver._flags = dataclasses.replace(solver._flags, on_gpu=True)
    solver._allocate_contacts(simulation.contacts.rigid_contact_max)
    solver._worlds = buffers.world_work(solver._topology, solver.settings.second_order, True)
    return simulation


def heaps(capacity: int | None) -> Simulation:
    """Three unequal worlds, whose pipeline may hold fewer contacts than they have."""
    builder = newton.ModelBuilder()
    for heap in (stack(2), pile(), stack(9)):
        builder.add_world(heap)
    simulation = Simulation(builder)
    if capacity is not None:
        simulation.pipeline = newton.CollisionPipeline(
            simulation.model, rigid_contact_max=capacity, publish_capacity=False
        )
        simulation.contacts = simulation.pipeline.contacts()
    return simulation


def test_many_threads_sort_contacts_as_one_does() -> None:
    """Bit for bit, in whatever order they come."""
    one, many = heaps(None), as_on_a_gpu(heaps(None))
    assert many.solver._worlds.turn.numpy().tolist() == [2, 1, 0] + [-1] * 29
    np.testing.assert_array_equal(edited(many, 60, shuffle(3)), edited(one, 60, shuffle(3)))


@pytest.mark.parametrize(
    ("worlds", "abreast"), [(1, 1), (1056, 1), (1057, 2), (4096, 4), (33792, 32), (100000, 32)]
)
def test_worlds_spread_over_the_warps_of_a_gpu(worlds: int, abreast: int) -> None:
    """132 multiprocessors hold 1,056 warps; each world is in one of them, in order."""
    threads = buffers.spread(np.arange(worlds), 132).reshape(-1, 32)
    assert (threads >= 0).sum(axis=1).max() == abreast
    np.testing.assert_array_equal(threads[threads >= 0], np.arange(worlds))


@pytest.mark.parametrize("capacity", [1, 14])
def test_many_threads_report_what_overflows_as_one_does(capacity: int) -> None:
    """As what they leave out: a shape that does not exist."""

    def misname(contacts: newton.Contacts) -> None:
        shapes = contacts.rigid_contact_shape0.numpy()
        shapes[0] = 2**30
        contacts.rigid_contact_shape0.assign(shapes)

    one, many = heaps(capacity), as_on_a_gpu(heaps(capacity))
    np.testing.assert_array_equal(edited(many, 10, misname), edited(one, 10, misname))
    seen, told = many.solver.status, one.solver.status
    assert seen.contact_overflow == told.contact_overflow > 0
    assert seen.dropped_contacts == told.dropped_contacts == 10


def test_contacts_of_an_earlier_pose_still_hold() -> None:
    """Detection every fourth step: separations are measured at the poses of each step.

    A cube rests (to a thousandth of the free fall of 60 steps) and a ball that falls lands at
    its radius without going deeper than 0.1 mm.
    """
    builder = resting_box()
    ball = add_sphere(builder, (2.0, 0.0, 0.4), radius=0.25, gap=0.2)
    builder.shape_gap[builder.body_shapes[ball][0]] = 0.2
    simulation = Simulation(builder)
    lowest = 1.0
    for step in range(60):
        if step % 4 == 0:
            simulation.pipeline.collide(simulation.state, simulation.contacts)
        state, out = simulation.state, simulation._next
        simulation.solver.step(state, out, None, simulation.contacts, DT)
        simulation.state, simulation._next = out, state
        lowest = min(lowest, simulation.pose[ball, 2])
    assert simulation.pose[0, 2] == pytest.approx(0.25, abs=1e-3 * 0.5 * G * 0.25**2)
    assert 0.25 - 1e-4 < lowest < 0.25 + 1e-3


def test_contacts_of_an_earlier_pose_do_not_hold_back() -> None:
    """A ball that leaves the ground at 3 m/s flies freely though its contact is still listed."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_sphere(builder, (0.0, 0.0, 0.25))
    simulation = Simulation(builder)
    simulation.pipeline.collide(simulation.state, simulation.contacts)
    simulation.pipeline = None
    simulation.set_velocity(0, (0.0, 0.0, 3.0))
    simulation.step(10)
    assert simulation.velocity[0, 2] == pytest.approx(3.0 - G * 10 * DT, rel=1e-5)


def other_buffer(model: newton.Model, capacity: int) -> newton.Contacts:
    """A contact buffer of another size for the same model."""
    pipeline = newton.CollisionPipeline(model, rigid_contact_max=capacity, publish_capacity=False)
    return pipeline.contacts()


@pytest.mark.parametrize("world_count", [1, 3])
def test_a_larger_buffer_than_at_construction_works(world_count: int) -> None:
    """The solver grows once, in the middle of a run, and the stack goes on standing.

    Bound: a hundredth of what the cubes would fall in the 20 steps if nothing held them.
    """
    builder = worlds(stack(), world_count)
    model = builder.finalize(device="cpu")
    simulation = Simulation(worlds(stack(), world_count))
    del model
    simulation.step(20)
    start = simulation.pose
    simulation.pipeline = newton.CollisionPipeline(
        simulation.model,
        rigid_contact_max=4 * simulation.contacts.rigid_contact_max,
        publish_capacity=False,
    )
    simulation.contacts = simulation.pipeline.contacts()
    simulation.step(20)
    np.testing.assert_allclose(simulation.pose, start, atol=0.01 * 0.5 * G * (20 * DT) ** 2)


def test_a_buffer_that_comes_after_the_solver_works() -> None:
    """No capacity is known at construction: the first step with contacts makes the buffers."""
    model = resting_box().finalize(device="cpu")
    solver, state = SolverAVBD(model), model.state()
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    for _ in range(20):
        pipeline.collide(state, contacts)
        solver.step(state, state, None, contacts, DT)
    assert float(state.body_q.numpy()[0, 2]) == pytest.approx(0.25, abs=1e-5)


def test_growing_while_a_graph_is_captured_names_the_remedy() -> None:
    """Buffers cannot move under a graph; the message says what to do before the capture."""
    simulation = Simulation(resting_box())
    simulation.step()
    larger = other_buffer(simulation.model, 4 * simulation.contacts.rigid_contact_max)
    with pytest.raises(RuntimeError, match="take one step with these contacts first"):
        with wp.ScopedCapture(device="cpu"):
            state = simulation.state
            simulation.solver.step(state, simulation._next, None, larger, DT)
    simulation.step()  # and the solver goes on as before
    assert simulation.pose[0, 2] == pytest.approx(0.25, abs=1e-6)


def test_a_moving_surface_carries() -> None:
    """``rigid_contact_surface_velocity``: a belt's velocity, though its shape stands still.

    It is that of shape 1's surface against shape 0's; here the ground (shape 0) runs at +1 m/s.
    Coulomb: the cube gains mu g, 0.4905 m/s in 0.1 s, within 2 %, and ends at the belt's speed.
    """
    simulation = Simulation(resting_box())
    contacts = simulation.contacts
    contacts.rigid_contact_surface_velocity = wp.full(
        contacts.rigid_contact_max, wp.vec3(-1.0, 0.0, 0.0), dtype=wp.vec3, device="cpu"
    )
    simulation.run(0.1)
    assert simulation.velocity[0, 0] == pytest.approx(0.5 * G * 0.1, rel=0.02)
    simulation.run(0.4)
    np.testing.assert_allclose(simulation.velocity[0], [1.0, 0, 0, 0, 0, 0], atol=1e-3)


# Warm start: the multiplier of a contact goes on to the same contact of the next step.


def settled(builder: newton.ModelBuilder, **settings: object) -> Simulation:
    """A scene after 60 steps, from now on with a single sweep a step.

    One sweep cannot find the forces of a stack: they must be there from the step before.
    """
    matching = settings.pop("contact_matching", "disabled")
    simulation = Simulation(builder, **settings)
    simulation.pipeline = newton.CollisionPipeline(simulation.model, contact_matching=matching)
    simulation.contacts = simulation.pipeline.contacts()
    simulation.step(60)
    simulation.solver.iterations = 1
    return simulation


STILL = 1e-3 * G * DT
"""A thousandth of the speed [m/s] that a body without support gains in one step."""


def shuffle(seed: int) -> Callable[[newton.Contacts], None]:
    """An edit that puts the contacts into a random order, another one in each call."""
    generator = np.random.default_rng(seed)

    def edit(contacts: newton.Contacts) -> None:
        reorder(contacts, generator.permutation(contact_count(contacts)))

    return edit


def forget(contacts: newton.Contacts) -> None:
    """An edit that exchanges the two shapes of all contacts, so that no record fits them."""
    for name in ROWS:
        if name.endswith("0"):
            first, second = getattr(contacts, name), getattr(contacts, name[:-1] + "1")
            saved = first.numpy()
            first.assign(second)
            second.assign(saved)
    normal = contacts.rigid_contact_normal
    normal.assign(-normal.numpy())


@pytest.mark.parametrize("matching", ["disabled", "latest", "sticky"])
def test_a_stack_stands_on_its_remembered_multipliers(matching: str) -> None:
    """With one sweep a step the column of five cubes stays as still as it was."""
    simulation = settled(stack(), contact_matching=matching)
    assert np.abs(record(simulation, 30)[:, :, 7:]).max() < STILL


def test_the_order_of_contacts_does_not_matter() -> None:
    """Shuffled in every step, the solver finds each contact again by its nearest anchor.

    The bound of the unshuffled test holds; poses agree to rounding (sums in another order).
    """
    plain, shuffled = settled(stack()), settled(stack())
    expected = record(plain, 30)
    got = edited(shuffled, 30, shuffle(seed=5))
    assert np.abs(got[:, :, 7:]).max() < STILL
    np.testing.assert_allclose(got[:, :, :7], expected[:, :, :7], atol=2e-6)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_moving_scene_does_not_depend_on_the_order_of_contacts(scheme: str) -> None:
    """Impact, sliding, rolling, contacts that come and go: each step is the same when shuffled.

    Both runs start each step from the same state, of second order with what the last step left
    beside it: the slopes go with that state. Sums in another order differ by rounding of
    increments of up to 0.02 m, over h: 1e-6 m/s, ten times that after sweeps; a multiplier that
    went to another contact makes 1e-2 m/s.
    """
    plain, shuffled = (Simulation(pile(), scheme=scheme) for _ in range(2))
    edit = shuffle(seed=6)
    for step in range(66):
        wp.copy(shuffled.state.body_q, plain.state.body_q)
        wp.copy(shuffled.state.body_qd, plain.state.body_qd)
        if scheme != "euler" and step > 0:
            shuffled.solver.restore(plain.solver.checkpoint())
        plain.step()
        edited(shuffled, 1, edit)
        worst = np.abs(shuffled.velocity - plain.velocity).max()
        assert worst < 1e-5, f"step {step}: {worst} m/s"


@pytest.mark.parametrize("matching", ["disabled", "latest", "sticky"])
def test_two_alternating_buffers_are_as_good_as_one(matching: str) -> None:
    """Multipliers are found again across buffers, also when the rows of one stand the other way.

    Match indices and generations count within a buffer and say nothing about another one.
    """
    simulation = settled(stack(), contact_matching=matching)
    pipelines = [
        simulation.pipeline,
        newton.CollisionPipeline(simulation.model, contact_matching=matching),
    ]
    buffers = [simulation.contacts, pipelines[1].contacts()]
    state, solver = simulation.state, simulation.solver
    for step in range(60):
        contacts = buffers[step % 2]
        pipelines[step % 2].collide(state, contacts)
        if step % 2:
            reorder(contacts, range(contact_count(contacts))[::-1])
            # as if this buffer had been filled as often as the other one
            wp.copy(contacts.contact_generation, buffers[0].contact_generation)
        solver.step(state, state, None, contacts, DT)
        assert np.abs(state.body_qd.numpy()).max() < STILL, f"step {step}"


def test_without_remembered_multipliers_one_sweep_does_not_hold_a_stack() -> None:
    """The control of the tests above: when no contact is recognised, the stack gives way."""
    simulation = settled(stack())
    flips = iter(range(100))

    def forget_every_other(contacts: newton.Contacts) -> None:
        if next(flips) % 2:
            forget(contacts)

    assert np.abs(edited(simulation, 30, forget_every_other)[:, :, 7:]).max() > 10 * STILL


def test_contacts_that_the_pipeline_calls_new_start_without_a_multiplier() -> None:
    """With matching, its indices decide, not the anchors: -1 everywhere is a cold start."""
    simulation = settled(stack(), contact_matching="latest")

    def all_new(contacts: newton.Contacts) -> None:
        contacts.rigid_contact_match_index.fill_(-1)

    assert np.abs(edited(simulation, 1, all_new)[:, :, 7:]).max() > 10 * STILL


def test_match_indices_are_followed_when_the_rows_move() -> None:
    """Rows in another order, with the indices that say so: each finds its own multiplier."""
    simulation = settled(stack(), contact_matching="latest")
    generator = np.random.default_rng(8)
    last: list[int] = list(range(contact_count(simulation.contacts)))

    def edit(contacts: newton.Contacts) -> None:
        nonlocal last
        order = generator.permutation(contact_count(contacts))
        match = contacts.rigid_contact_match_index.numpy()
        place = np.argsort(last)  # where the last step put each row of the pipeline's order
        known = match[order]
        match[: len(order)] = np.where(known >= 0, place[np.maximum(known, 0)], known)
        contacts.rigid_contact_match_index.assign(match)
        reorder(contacts, order)
        last = list(order)

    assert np.abs(edited(simulation, 30, edit)[:, :, 7:]).max() < STILL


def off_center_box() -> newton.ModelBuilder:
    """A resting cube of 100 kg whose COM is 0.1 m off: its contacts carry 0.3 and 0.7 of it."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    body = builder.add_body(
        xform=wp.transform(wp.vec3(0.0, 0.0, 0.25), IDENTITY),
        mass=100.0,
        inertia=wp.mat33(4.0 * np.eye(3)),
        com=wp.vec3(0.1, 0.0, 0.0),
    )
    builder.add_shape_box(body, hx=0.25, hy=0.25, hz=0.25, cfg=surface(density=0.0))
    return builder


def exchange_sides(contacts: newton.Contacts) -> None:
    """An edit that swaps the rows at +x and -x, so that each row's place jumps to the other side.

    The match indices stay: they say that each row is the contact that it was.
    """
    points = contacts.rigid_contact_point0.numpy()[: contact_count(contacts)]
    mirror = [
        int(np.argmin(np.linalg.norm(points - point * [-1.0, 1.0, 1.0], axis=1)))
        for point in points
    ]
    reorder(contacts, mirror)


def test_match_indices_are_followed_when_the_anchors_jump() -> None:
    """Multipliers go with the row that the pipeline names, not with the place, if it names one.

    Exchanging places hands 0.7 of the weight to the side that carried 0.3: without the sweeps
    that correct it, the cube would turn at 0.2 m m g h / I = 0.2 rad/s, and more than a hundredth
    of it is left after one sweep. Where the pipeline names none, the places decide: no turn.
    """
    turn = {}
    for matching in ("disabled", "latest"):
        simulation = settled(off_center_box(), contact_matching=matching)
        turn[matching] = np.abs(edited(simulation, 1, exchange_sides)[:, :, 10:]).max()
    assert turn["disabled"] < 1e-4
    assert turn["latest"] > 2e-3


def test_match_indices_into_an_unseen_filling_are_not_followed() -> None:
    """Detection twice before a step: the indices name rows that the solver never read.

    It then goes by the anchors. Indices that would exchange the unequal loads show it.
    """
    simulation = settled(off_center_box(), contact_matching="latest")

    def detect_again(contacts: newton.Contacts) -> None:
        detect(simulation.state, contacts)
        count = contact_count(contacts)
        match = contacts.rigid_contact_match_index.numpy()
        match[:count] = [1, 0, 3, 2]
        contacts.rigid_contact_match_index.assign(match)

    detect = simulation.pipeline.collide
    assert np.abs(edited(simulation, 1, detect_again)[:, :, 10:]).max() < 1e-4


def test_a_contact_that_is_listed_twice_does_not_count_twice() -> None:
    """A remembered multiplier serves one contact: doubled rows do not throw a resting cube up.

    Bound: a hundredth of g h, the speed from a support of twice the weight, of which the one
    sweep would leave a twentieth.
    """
    simulation = settled(resting_box())

    def double(contacts: newton.Contacts) -> None:
        count = contact_count(contacts)
        for name in ROWS:
            array = getattr(contacts, name)
            rows = array.numpy()
            rows[count : 2 * count] = rows[:count]
            array.assign(rows)
        contacts.rigid_contact_count.fill_(2 * count)

    assert np.abs(edited(simulation, 5, double)[:, :, 7:]).max() < 0.01 * G * DT


def test_a_contact_that_comes_back_starts_fresh() -> None:
    """A cube that was lifted and put down again has no force left from before: it does not jump.

    It is put 1 mm above the ground, falls and rests; it never rises above where it was put.
    """
    simulation = Simulation(resting_box())
    simulation.step(30)
    pose = simulation.state.body_q.numpy()
    pose[0, 2] = 0.251
    simulation.state.body_q.assign(pose)
    simulation.state.body_qd.zero_()
    frames = record(simulation, 60)
    assert frames[:, 0, 2].max() <= 0.251
    assert frames[-1, 0, 2] == pytest.approx(0.25, abs=1e-5)


# Body-pair-reduced buffers, which ``supports_body_pair_reduced_contacts`` promises to consume.


def add_foot(builder: newton.ModelBuilder, height: float) -> int:
    """One body whose collision is a row of seven upright cylinders, like an exported robot foot."""
    body = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, height), IDENTITY), mass=1.0)
    for i in range(7):
        builder.add_shape_cylinder(
            body,
            xform=wp.transform(wp.vec3(0.044 * (i - 3), 0.0, 0.0), IDENTITY),
            radius=0.02,
            half_height=0.015,
        )
    return body


def foot(height: float, reduction: object) -> Simulation:
    """The foot over the ground, with a pipeline that does or does not reduce."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_foot(builder, height)
    simulation = Simulation(builder)
    simulation.pipeline = newton.CollisionPipeline(simulation.model, body_pair_reduction=reduction)
    simulation.contacts = simulation.pipeline.contacts()
    return simulation


def test_reduced_contacts_settle_a_body_as_full_ones_do() -> None:
    """The conformance that Newton asks for: contact depth in the reducer's signed separation.

    Dropped from 5 mm, the foot of seven cylinders comes to rest on half as many contacts at the
    same height and just as still. Bounds: the slop (0.05 g h^2, 9e-6 m); the speed that a step
    without support would give, a thousandth of it.
    """
    reduced = foot(0.02, newton.CollisionPipeline.BodyPairReductionConfig())
    full = foot(0.02, None)
    for simulation in (reduced, full):
        simulation.run(1.0)
        simulation.pipeline.collide(simulation.state, simulation.contacts)
        assert simulation.pose[0, 2] == pytest.approx(0.015, abs=2e-5)
        assert np.abs(simulation.velocity).max() < STILL
    assert reduced.contacts.rigid_contact_body_pair_reduced
    assert 0 < contact_count(reduced.contacts) <= contact_count(full.contacts) / 2


def test_reduced_contacts_push_a_sunken_body_out() -> None:
    """Negative separation is depth: a foot that starts 1 mm in the ground is brought to it."""
    simulation = foot(0.014, newton.CollisionPipeline.BodyPairReductionConfig())
    simulation.run(0.5)
    assert simulation.pose[0, 2] == pytest.approx(0.015, abs=2e-5)
    assert np.abs(simulation.velocity).max() < STILL


def test_an_owned_pipeline_may_reduce() -> None:
    """Newton refuses a reducing pipeline for solvers that did not declare support."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_foot(builder, 0.015)
    model = builder.finalize(device="cpu")
    pipeline = newton.CollisionPipeline(
        model, body_pair_reduction=newton.CollisionPipeline.BodyPairReductionConfig()
    )
    solver, state = SolverAVBD(model, collision_pipeline=pipeline), model.state()
    before = snapshot(state)
    for _ in range(60):
        solver.step(state, state, None, None, DT)
    assert solver.contacts.rigid_contact_body_pair_reduced
    np.testing.assert_allclose(snapshot(state), before, atol=2e-5)


def test_the_pile_uses_what_it_is_made_for() -> None:
    """The shared scene holds resting contacts and ones that come and go (else tests are blind)."""
    builder = newton.ModelBuilder()
    add_pile(builder)
    simulation = Simulation(builder)
    counts = []
    for _ in range(60):
        simulation.step()
        counts.append(contact_count(simulation.contacts))
    assert min(counts) >= 8 and len(set(counts)) > 1
