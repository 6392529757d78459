# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""One large world, color by color, beside the kernel that solves a world in one thread."""

from collections.abc import Callable

import newton
import numpy as np
import pytest
import warp as wp
from contract import pile, record, snapshot, worlds
from helpers import NO_GRAVITY, Simulation, add_box, add_ground, add_sphere
from test_large_joints import in_order_of_colors, ragdolls

from newton_avbd import SolverAVBD
from newton_avbd.__main__ import main
from newton_avbd.drivers.coloring import COLORS, PASSES
from newton_avbd.scenes.chains import add_chain
from newton_avbd.scenes.named import add_brick_ring
from newton_avbd.step.scale import COLD_STEPS, STRUCK_FACTOR

PYRAMID = [
    (0.55 * (i - 0.5 * (5 - row)), 0.5 * (row + 0.5)) for row in range(5) for i in range(5 - row)
]
"""Where the boxes of a pyramid are, (x, z) [m]."""


def pyramid(speed: float) -> newton.ModelBuilder:
    """Boxes of 0.5 m, some of them with a speed [m/s] to the side."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    for i, (x, z) in enumerate(PYRAMID):
        body = add_box(builder, (x, 0.0, z))
        shove = speed * (i % 3 - 1)
        builder.body_qd[body] = wp.spatial_vector(0.0, shove, 0.0, shove, 0.0, shove)
    return builder


def test_a_sweep_is_that_of_one_thread_in_the_order_of_the_colors() -> None:
    """To rounding: bodies of a color cannot tell which of them was first."""
    colored = Simulation(pyramid(speed=0.1), parallel="bodies", iterations=3)
    colored.step()
    order = colored.solver._large.colors.order.numpy()[: len(PYRAMID)].copy()
    assert not np.array_equal(order, np.sort(order))
    serial = Simulation(pyramid(speed=0.1), blocks="body", iterations=3)
    serial.solver._worlds.bodies.assign(order)
    serial.solver._worlds.rank.assign(np.append(np.argsort(order), order.size))
    serial.step()
    for _ in range(4):
        np.testing.assert_allclose(colored.pose, serial.pose, atol=1e-9)
        np.testing.assert_allclose(colored.velocity, serial.velocity, atol=1e-7)
        assert colored.solver.status.sweeps == serial.solver.status.sweeps
        colored.step()
        serial.step()
    np.testing.assert_array_equal(colored.solver._large.colors.order.numpy()[: order.size], order)


def test_a_large_world_is_of_second_order_as_one_thread_is() -> None:
    """A chain that swings, a box that slides to rest and one that falls: to what an order of the
    bodies leaves, which the chain lets grow."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    sliding = add_box(builder, (0.0, 0.0, 0.25))
    builder.body_qd[sliding] = wp.spatial_vector(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    add_box(builder, (3.0, 0.0, 2.25))
    add_chain(builder, 4)
    settings = {"dt": 1.0 / 120.0, "scheme": "generalized_alpha"}
    colored = Simulation(builder, parallel="bodies", **settings)
    serial = Simulation(builder, parallel="worlds", **settings)
    orders = []
    for _ in range(60):
        colored.step()
        serial.step()
        orders.append(int(colored.solver.report().order[0]))
        assert orders[-1] == serial.solver.report().order[0]
    assert orders.count(2) > 30
    np.testing.assert_allclose(colored.pose, serial.pose, atol=1e-5)
    np.testing.assert_allclose(colored.velocity, serial.velocity, atol=1e-4)


def test_what_rests_rests_in_the_same_place() -> None:
    """Of a pyramid that is shoved, after half a second: what an order of the bodies leaves."""
    colored = Simulation(pyramid(speed=0.02), parallel="bodies", iterations=40)
    serial = Simulation(pyramid(speed=0.02), blocks="body", iterations=40)
    for simulation in (colored, serial):
        simulation.run(0.5)
        assert np.abs(simulation.velocity).max() < 1e-4
        assert simulation.penetration < 2e-5
    np.testing.assert_allclose(colored.pose, serial.pose, atol=1e-6)


@pytest.mark.long
def test_impacts_that_go_on_take_another_round_of_sweeps() -> None:
    """Of a pyramid that falls at 0.95 m/s, as one thread sweeps it; another world takes none.

    To rounding, 1e-8 m/s in the first 15 steps. At other speeds impacts make more of that, up to
    1e-2 m/s; here not.
    """
    iterations = 4
    builder = pyramid(speed=0.1)
    for i in range(len(PYRAMID)):
        builder.body_q[i] = wp.transform_multiply(
            wp.transform((0.0, 0.0, 0.1), wp.quat_identity()), builder.body_q[i]
        )
        builder.body_qd[i] += wp.spatial_vector(0.0, 0.0, -0.95, 0.0, 0.0, 0.0)
    colored = Simulation(builder, parallel="bodies", iterations=iterations)
    serial = Simulation(builder, blocks="body", iterations=iterations)
    many = newton.ModelBuilder()
    many.add_world(builder)
    many.add_world(pyramid(speed=0.0))
    both = Simulation(many, parallel="bodies", iterations=iterations)
    sweeps = []
    for _ in range(19):
        colored.step()
        in_order_of_colors(colored, serial)
        serial.step()
        both.step()
        np.testing.assert_allclose(colored.pose, serial.pose, atol=1e-6)
        assert colored.solver.status.bounded_steps[0] == serial.solver.status.bounded_steps[0]
        np.testing.assert_allclose(colored.velocity, serial.velocity, atol=1e-4)
        np.testing.assert_array_equal(both.pose[: len(PYRAMID)], colored.pose)
        sweeps.append([*colored.solver.status.sweeps, *both.solver.status.sweeps])
        assert sweeps[-1][0] == serial.solver.status.sweeps[0] == sweeps[-1][1]
    warm = np.array(sweeps[COLD_STEPS:])
    assert warm[:, 0].max() == STRUCK_FACTOR * iterations
    assert warm[:, 2].max() <= iterations


def test_a_pile_comes_to_rest() -> None:
    """Of boxes and spheres that fall on each other; no row is lost when its owner changes."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    rng = np.random.default_rng(5)
    for i in range(30):
        place = (*rng.uniform(-0.5, 0.5, 2), 0.3 + 0.35 * i)
        (add_box if i % 3 else add_sphere)(builder, place, rng.uniform(0.2, 0.3))
    simulation = Simulation(builder, parallel="bodies")
    seen = set()
    for _ in range(60):
        simulation.step(8)
        seen.add(tuple(simulation.solver._large.colors.color.numpy()[0]))
    status = simulation.solver.status
    assert len(seen) > 10  # colors did change
    assert 3 <= status.colors <= COLORS and status.clashes == 0
    assert simulation.penetration < 5e-4
    assert not status.held_steps.any() and not status.dropped_contacts


def test_islands_keep_their_momentum() -> None:
    """Of spheres that meet in free space: after 4 sweeps not by convergence."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    rng = np.random.default_rng(3)
    for i in range(24):
        place = np.array([i % 4, i // 4 % 3, i // 12]) - 1.0
        body = add_sphere(builder, 0.6 * place, density=float(rng.uniform(200.0, 2000.0)))
        builder.body_qd[body] = wp.spatial_vector(
            *(-place + 0.3 * rng.normal(size=3)), 0.0, 0.0, 0.0
        )
    simulation = Simulation(builder, parallel="bodies", iterations=4)

    def momentum() -> np.ndarray:
        return simulation.mass @ simulation.velocity[:, :3]

    before, energy = momentum(), simulation.kinetic_energy
    simulation.run(0.5)
    assert simulation.kinetic_energy < 0.8 * energy  # they did meet
    scale = float(simulation.mass @ np.linalg.norm(simulation.velocity[:, :3], axis=1))
    np.testing.assert_allclose(momentum(), before, atol=1e-5 * scale)


def test_bodies_without_a_color_move_one_after_the_other() -> None:
    """Of balls that all touch each other one takes its color in each pass; and none flies off."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    count = COLORS + 3
    for i in range(count):
        angle = 2.0 * np.pi * i / count
        add_sphere(builder, (0.1 * np.cos(angle), 0.1 * np.sin(angle), 0.01 * i))
    simulation = Simulation(builder, parallel="bodies")
    simulation.step()
    assert simulation.solver.status.clashes == count - PASSES
    simulation.step()
    assert 0 < simulation.solver.status.clashes < count - PASSES  # goes on where it ended
    assert simulation.solver.status.colors == COLORS
    assert np.abs(simulation.velocity).max() < 1e-3  # old overlap is none of the motion


heaps = pytest.mark.parametrize("heap", [pile, ragdolls])


@heaps
def test_runs_resets_and_graphs_give_the_same_bits(heap: Callable[[], newton.ModelBuilder]) -> None:
    """Steps of which the first are cold; captured before any ran."""
    eager = Simulation(heap(), parallel="bodies")
    expected = record(eager, 16)
    eager.solver.reset(eager.state)
    np.testing.assert_array_equal(record(eager, 16), expected)
    replayed = Simulation(heap(), parallel="bodies")
    state = replayed.state
    with wp.ScopedCapture(device="cpu") as capture:
        replayed.step(2)
    for _ in range(8):
        wp.capture_launch(capture.graph)
    np.testing.assert_array_equal(snapshot(state), expected[-1])


def test_another_solver_goes_on_from_a_checkpoint() -> None:
    """To the bits of the run that was left: colors depend on those of the step before."""
    simulation, other = (Simulation(pile(), parallel="bodies") for _ in range(2))
    simulation.step(60)
    checkpoint = simulation.solver.checkpoint()
    for name in ("body_q", "body_qd"):
        getattr(other.state, name).assign(getattr(simulation.state, name))
    other.solver.restore(checkpoint)
    for sim in (simulation, other):
        sim.step(20)
    np.testing.assert_array_equal(other.pose, simulation.pose)
    np.testing.assert_array_equal(other.velocity, simulation.velocity)


@heaps
def test_worlds_do_not_see_each_other(heap: Callable[[], newton.ModelBuilder]) -> None:
    """Three of the same heap give the bits of one; one that is not finite is held, or put back."""
    expected = record(Simulation(heap(), parallel="bodies"), 16)
    simulation = Simulation(worlds(heap(), 3), parallel="bodies")
    count = expected.shape[1]
    first, second, third = (slice(i * count, (i + 1) * count) for i in range(3))
    simulation.step(4)
    for world in (first, second, third):
        np.testing.assert_array_equal(snapshot(simulation.state)[world], expected[3])
    simulation.push(count + 1, force=(np.nan, 0.0, 0.0))
    simulation.step(2)
    np.testing.assert_array_equal(snapshot(simulation.state)[second], expected[3])
    np.testing.assert_array_equal(simulation.solver.status.held_steps, [0, 2, 0])
    simulation.push(count + 1)
    mask = wp.array([False, True, False, False], dtype=wp.bool, device="cpu")
    simulation.solver.reset(simulation.state, mask)
    simulation.step(10)
    np.testing.assert_array_equal(snapshot(simulation.state)[second], expected[9])
    for world in (first, third):
        np.testing.assert_array_equal(snapshot(simulation.state)[world], expected[15])


def test_a_cpu_takes_worlds() -> None:
    model = pile().finalize(device="cpu")
    assert SolverAVBD(model).parallel == "worlds"
    assert SolverAVBD(model, parallel="bodies").parallel == "bodies"


@pytest.mark.parametrize(
    ("builder", "settings", "message"),
    [
        (pile, {"formulation": "ramp"}, "formulation='ramp'"),
    ],
)
def test_what_a_large_world_does_without_is_an_error(builder, settings, message) -> None:
    with pytest.raises(NotImplementedError, match=message):
        SolverAVBD(builder().finalize(device="cpu"), parallel="bodies", **settings)


def test_another_word_is_an_error() -> None:
    with pytest.raises(ValueError, match="'worlds', 'bodies' or None, got 'threads'"):
        SolverAVBD(pile().finalize(device="cpu"), parallel="threads")


def test_bricks_of_a_ring_are_closest_inside() -> None:
    """Neighbors in a course by 5 mm, at the corners of their inner faces."""
    builder = newton.ModelBuilder()
    add_brick_ring(builder, 360)
    place = np.array(builder.body_q)[:60, :2]  # the first of six courses
    out = place / np.linalg.norm(place, axis=1)[:, None]
    along = np.stack([-out[:, 1], out[:, 0]], axis=1)
    left, right = (place - 0.1 * out + side * 0.2 * along for side in (1.0, -1.0))
    np.testing.assert_allclose(np.linalg.norm(left[:-1] - right[1:], axis=1), 0.005, atol=1e-4)
    assert len(builder.body_q) == 360


def test_the_command_measures_a_world(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["large", "pyramid", "--bodies", "10", "--steps", "4", "--device", "cpu"]) == 0
    line = capsys.readouterr().out.splitlines()[-1].split()
    assert line[:2] == ["pyramid", "10"]
    assert 0 < int(line[3]) <= COLORS


def test_energy_is_bounded_alike_where_an_island_spans_lanes(monkeypatch) -> None:
    """Two swarms that collapse, their bodies numbered in turns, so that islands lie in all lanes.

    A sweep does not settle them. Velocities are scaled by a root of quotients of sums over up to
    100 bodies, which one lane and several sum to 1e-6: of 4 m/s.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    rng = np.random.default_rng(5)
    for i in range(200):
        place = rng.uniform(-0.8, 0.8, 3)
        body = add_sphere(builder, place + np.array([5.0 * (i % 2), 0.0, 0.0]), 0.12)
        builder.body_qd[body] = (*(-4.0 * place), 0.0, 0.0, 0.0)
    several = Simulation(builder, parallel="bodies", iterations=1)
    monkeypatch.setattr("newton_avbd.drivers.large._SHORTEST", 200)
    one = Simulation(builder, parallel="bodies", iterations=1)
    assert (several.solver._large._lanes, one.solver._large._lanes) == (4, 1)
    for _ in range(10):
        one.state.assign(several.state)
        several.step()
        one.step()
        np.testing.assert_allclose(several.velocity, one.velocity, atol=1e-4)
    status = [sim.solver.status for sim in (several, one)]
    assert status[0].bounded_steps[0] == status[1].bounded_steps[0] > 4
    assert status[0].bounded_energy[0] == pytest.approx(status[1].bounded_energy[0], rel=1e-3)
