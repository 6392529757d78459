# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""DISTANCE joints between bodies: chains, webs, what they tie together in free space."""

import unittest
import warnings

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, G, Simulation, add_box
from joint_scenes import WORLD, add_contact, add_link, anchor_gaps, transform

from newton_avbd import SolverAVBD
from newton_avbd.model import topology

LENGTH = 0.1


def add_bead(builder: newton.ModelBuilder, position: tuple, mass: float) -> int:
    """Add a ball of 2 cm to hang on strings."""
    moment = 0.4 * mass * 0.02**2
    body = add_link(builder, mass=mass, inertia=(moment,) * 3)
    builder.body_q[body] = transform(position)
    return body


def tie(builder: newton.ModelBuilder, pairs: list[tuple[int, int]], **bounds: float) -> None:
    """Strings between bodies, or from the origin: first those that make a tree of them all."""
    held, tree, others = {WORLD}, [], list(pairs)
    while found := [pair for pair in others if pair[0] in held and pair[1] not in held]:
        held.add(found[0][1])
        tree.append(found[0])
        others.remove(found[0])
    bounds.setdefault("max_distance", LENGTH)
    joints = [builder.add_joint_distance(*pair, **bounds) for pair in tree]
    builder.add_articulation(joints)
    for pair in others:
        builder.add_joint_distance(*pair, **bounds)


def lengths(sim: Simulation) -> np.ndarray:
    """Distances of the bodies that strings tie, or from the origin [m]."""
    centers = np.vstack([sim.center, np.zeros(3)])
    child, parent = sim.model.joint_child.numpy(), sim.model.joint_parent.numpy()
    return np.linalg.norm(centers[child] - centers[parent], axis=1)


@pytest.mark.parametrize("parallel", [None, "bodies"])
@pytest.mark.parametrize("end", [1.0, 1e2, 1e4])
@pytest.mark.parametrize("count", [2, 10])
def test_a_chain_of_strings_holds_whatever_hangs_on_it(
    count: int, end: float, parallel: str | None
) -> None:
    """Let go sideways: no string is longer by 1e-4 m; energy is only lost."""
    builder = newton.ModelBuilder()
    for i in range(count):
        add_bead(builder, (LENGTH * (i + 1), 0.0, 0.0), end if i == count - 1 else 1.0)
    tie(builder, [(i - 1 if i else WORLD, i) for i in range(count)])
    sim = Simulation(builder, collide=False, parallel=parallel)
    energy, lowest = sim.energy, 0.0
    for _ in range(240):
        sim.step()
        assert lengths(sim).max() < LENGTH + 1.0e-4
        assert sim.energy < energy + 1.0e-6 * abs(energy) + 1.0e-6 * end
        energy, lowest = min(energy, sim.energy), min(lowest, sim.center[-1, 2])
    assert lowest < -0.9 * count * LENGTH  # it did swing down


def test_a_heavy_end_swings_as_on_one_string() -> None:
    """Taut beads of a ten-thousandth of its weight carry it along a circle."""
    tilt = np.array([np.sin(1.0), 0.0, -np.cos(1.0)])
    swings = []
    for count in (1, 5):
        builder = newton.ModelBuilder()
        for i in range(count):
            mass = 100.0 if i == count - 1 else 1.0e-2
            add_bead(builder, tuple(5 * LENGTH / count * (i + 1) * tilt), mass)
        pairs = [(i - 1 if i else WORLD, i) for i in range(count)]
        tie(builder, pairs, max_distance=5 * LENGTH / count)
        sim = Simulation(builder, collide=False)
        swings.append([])
        for _ in range(240):
            sim.step()
            swings[-1].append(sim.center[-1])
    np.testing.assert_allclose(swings[1], swings[0], atol=2.0e-4)


@pytest.mark.parametrize("middle", [1.0, 1e3])
def test_a_web_holds(middle: float) -> None:
    """16 beads and 25 strings, let go level; one bead may weigh more."""
    sim = web(4, middle)
    for _ in range(240):
        sim.step()
        assert lengths(sim).max() < LENGTH + 1.0e-4


def test_a_web_too_large_to_be_solved_at_once_stays_finite(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its strings are held sweep by sweep, and stretch: by an eighth here."""
    monkeypatch.setattr(topology, "STRING_ROWS", 10)
    sim = web(4, 1e3)
    for _ in range(240):
        sim.step()
        assert lengths(sim).max() < 1.5 * LENGTH


def web(side: int, middle: float) -> Simulation:
    """A square of beads, each tied to its neighbors, that hangs by a corner."""
    builder = newton.ModelBuilder()
    beads = np.arange(side * side).reshape(side, side)
    for i, j in np.ndindex(side, side):
        mass = middle if i == j == side // 2 else 1.0
        add_bead(builder, (LENGTH * i, LENGTH * j, -LENGTH), mass)
    pairs = [(WORLD, 0), *zip(beads[:-1].ravel().tolist(), beads[1:].ravel().tolist(), strict=True)]
    pairs += zip(beads[:, :-1].ravel().tolist(), beads[:, 1:].ravel().tolist(), strict=True)
    tie(builder, pairs)
    return Simulation(builder, collide=False)


@pytest.mark.parametrize("least, most", [(-1.0, 0.3), (0.3, 0.3), (0.2, 0.35)])
def test_a_string_in_free_space_keeps_the_momentum(least: float, most: float) -> None:
    """Two bodies of 1:100, tied off their centers, spin about each other."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    first, second = (add_link(builder, mass=m, inertia=(0.004 * m,) * 3) for m in (1.0, 100.0))
    builder.body_q[second] = transform((0.3, 0.0, 0.0))
    free = builder.add_joint_free(first)
    string = builder.add_joint_distance(
        first,
        second,
        parent_xform=transform((0.05, 0.02, 0.0)),
        child_xform=transform((-0.04, 0.0, 0.03)),
        min_distance=least,
        max_distance=most,
    )
    builder.add_articulation([free, string])
    sim = Simulation(builder, collide=False)
    sim.set_velocity(first, (0.0, 3.0, 0.0), (0.0, 2.0, 5.0))
    sim.set_velocity(second, (0.5, 0.0, 0.2), (1.0, 0.0, 0.0))
    momentum, energy = sim.mass @ sim.velocity[:, :3], sim.kinetic_energy
    for _ in range(480):
        sim.step()
        np.testing.assert_allclose(sim.mass @ sim.velocity[:, :3], momentum, atol=5.0e-4)
        assert sim.kinetic_energy < energy * (1.0 + 1.0e-5)
        energy = sim.kinetic_energy


def leash(is_child: bool, **settings: bool) -> Simulation:
    """A box on a string below a kinematic body, which is the child or the parent of the joint.

    The box stands on another one, and both float.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    post = builder.add_body(
        xform=transform((0.0, 0.0, 1.0)), mass=1.0, inertia=wp.mat33(np.eye(3)), is_kinematic=True
    )
    upper, lower = (add_box(builder, (0.0, 0.0, z), (0.5, 0.5, 0.5)) for z in (0.0, -0.5))
    pair = (upper, post) if is_child else (post, upper)
    builder.add_joint_distance(*pair, max_distance=1.2)
    sim = Simulation(builder, **settings)
    for box in (upper, lower):
        sim.set_velocity(box, (0.0, 0.1, -1.0))
    return sim


def test_it_is_all_one_which_end_of_a_string_is_put() -> None:
    """The box that it stops is stopped, the other one goes on."""
    first, second = leash(True), leash(False)
    for sim in (first, second):
        sim.step(120)
    np.testing.assert_allclose(first.pose, second.pose, atol=1.0e-5)
    np.testing.assert_allclose(first.velocity, second.velocity, atol=1.0e-5)
    assert first.velocity[2, 2] == pytest.approx(-1.0, abs=1.0e-2)  # friction
    assert first.pose[1, 2] > -0.21


@pytest.mark.parametrize("is_child", [True, False])
def test_what_hangs_on_a_body_that_is_put_hangs_while_others_sleep(is_child: bool) -> None:
    """Islands know which joints hold them, whichever end is the child."""
    builder = newton.ModelBuilder()
    mass = {"mass": 1.0, "inertia": wp.mat33(np.eye(3))}
    post = builder.add_body(is_kinematic=True, **mass)
    box = builder.add_body(xform=transform((0.0, 0.0, -1.0)), **mass)
    pair = (box, post) if is_child else (post, box)
    builder.add_joint_distance(*pair, max_distance=1.0)
    sim = Simulation(builder, collide=False, sleeping=True)
    sim.step(60)
    assert np.linalg.norm(sim.center[box]) == pytest.approx(1.0, abs=1.0e-4)


SETTINGS = [
    {},
    {"scheme": "generalized_alpha"},
    {"parallel": "bodies"},
    {"blocks": "body"},
    {"blocks": "body", "scheme": "generalized_alpha"},
    {"blocks": "body", "parallel": "bodies"},
]


def tether(
    start: tuple, bounds: tuple, arm: float = 0.0, gravity: bool = False, **settings: str
) -> Simulation:
    """A body at rest on a DISTANCE joint to the origin; its anchor starts at ``start``."""
    builder = newton.ModelBuilder() if gravity else newton.ModelBuilder(gravity=NO_GRAVITY)
    body = add_link(builder)
    builder.body_q[body] = transform(np.array(start) - (0.0, arm, 0.0))
    least, most = bounds
    joint = builder.add_joint_distance(
        WORLD,
        body,
        child_xform=transform((0.0, arm, 0.0)),
        min_distance=least,
        max_distance=most,
    )
    builder.add_articulation([joint])
    add_contact(builder, body)  # color by color only what could collide is solved
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="SolverAVBD steps without contacts")
        sim = Simulation(builder, collide=False, **settings)
        sim.step()
    return sim


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
@pytest.mark.parametrize(
    "start, bounds, length",
    [
        ((0.9, 0.0, -1.2), (-1.0, 1.0), 1.0),
        ((0.12, 0.16, 0.0), (0.5, -1.0), 0.5),
        ((0.0, 0.0, 0.0), (0.5, 0.5), 0.5),
        ((0.0, 5.0, 0.0), (0.2, 0.3), 0.3),
    ],
)
def test_a_string_far_beyond_a_bound_is_back_within_two_steps(
    start: tuple, bounds: tuple, length: float, settings: dict
) -> None:
    """Straight, to 1e-5 m, without a velocity, and stays there for a second to the bit or so."""
    sim = tether(start, bounds, **settings)
    sim.step()
    way = np.array(start if any(start) else (1.0, 0.0, 0.0))  # coincident: X of the parent's frame
    np.testing.assert_allclose(sim.center[0], length / np.linalg.norm(way) * way, atol=1.0e-5)
    np.testing.assert_allclose(sim.velocity, 0.0, atol=1.0e-6)
    before = sim.pose
    sim.step(240)
    np.testing.assert_allclose(sim.pose, before, atol=1.0e-6)
    np.testing.assert_allclose(sim.velocity, 0.0, atol=1.0e-6)


@pytest.mark.parametrize(
    "settings, steps",
    [
        ({}, 3),
        ({"scheme": "generalized_alpha"}, 3),
        ({"parallel": "bodies"}, 3),
        ({"blocks": "body"}, 20),
    ],
    ids=str,
)
@pytest.mark.parametrize("start, bounds", [((1.5, 0, 0), (-1.0, 1.0)), ((0.2, 0, 0), (0.5, 0.5))])
def test_so_is_one_that_turns_its_body(
    start: tuple, bounds: tuple, settings: dict, steps: int
) -> None:
    """Tied 0.2 m beside its COM. Body by body a step turns it by 0.2 rad at most."""
    sim = tether(start, bounds, arm=0.2, **settings)
    sim.step(steps - 1)
    assert anchor_gaps(sim)[0] == pytest.approx(abs(bounds[1]), abs=1.0e-5)
    assert sim.kinetic_energy < 1.0e-10
    sim.step(120)
    assert anchor_gaps(sim)[0] == pytest.approx(abs(bounds[1]), abs=1.0e-5)
    assert sim.kinetic_energy < 1.0e-10


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_what_is_pulled_back_hangs_still(settings: dict) -> None:
    """From 0.5 m too low: at its length, no faster than rounding, and without a drift for 2 s."""
    sim = tether((0.0, 0.0, -1.5), (-1.0, 1.0), gravity=True, **settings)
    sim.step(9)
    np.testing.assert_allclose(sim.center[0], (0.0, 0.0, -1.0), atol=1.0e-5)
    for _ in range(4):
        sim.step(120)
        np.testing.assert_allclose(sim.center[0], (0.0, 0.0, -1.0), atol=1.0e-5)
        assert np.abs(sim.velocity).max() < 1.0e-4


def test_pulling_back_neither_drives_nor_holds() -> None:
    """A body that starts too near falls freely from where it has been put: v = g t to 1e-5."""
    sim = tether((0.0, 0.0, -0.2), (0.5, -1.0), gravity=True)
    sim.step(59)
    assert sim.velocity[0, 2] == pytest.approx(-60 * sim.dt * G, rel=1.0e-5)
    fallen = (0.5 * 60 * 61 - 1) * sim.dt**2 * G  # all but the first step, which ends at the bound
    assert sim.center[0, 2] == pytest.approx(-0.5 - fallen, abs=1.0e-5)


@pytest.mark.parametrize(
    "settings, steps",
    [*((setting, 4) for setting in SETTINGS[:4]), *((setting, 40) for setting in SETTINGS[4:])],
    ids=str,
)
@pytest.mark.parametrize("share, bounds", [(1.5, (-1.0, LENGTH)), (0.4, (LENGTH, -1.0))])
def test_a_chain_far_beyond_its_bounds_is_pulled_together(
    share: float, bounds: tuple, settings: dict, steps: int
) -> None:
    """Five beads in a row, strings half as long again or too short: 1e-4 m, and at rest.

    Body by body they go up to 2 % beyond that bound, where nothing holds them.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    for i in range(5):
        add_bead(builder, (share * LENGTH * (i + 1), 0.0, 0.0), 1.0)
    least, most = bounds
    pairs = [(i - 1 if i else WORLD, i) for i in range(5)]
    tie(builder, pairs, min_distance=least, max_distance=most)
    add_contact(builder, 0)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="SolverAVBD steps without contacts")
        sim = Simulation(builder, collide=False, **settings)
        for _ in range(steps):
            sim.step()
            assert sim.kinetic_energy < 1.0e-8
    sim.step(60)
    assert np.all(lengths(sim) > least - 1.0e-4)
    assert most < 0.0 or np.all(lengths(sim) < most + 1.0e-4)
    np.testing.assert_allclose(lengths(sim), LENGTH, rtol=2.0e-2 if "blocks" in settings else 1e-3)
    assert sim.kinetic_energy < 1.0e-8


def test_newtons_own_test_of_its_bounds_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    """As it stands, with this solver in the place of SolverXPBD: one step of a sixtieth."""
    tests = pytest.importorskip("newton.tests.test_solver_xpbd")
    monkeypatch.setattr(newton.solvers, "SolverXPBD", SolverAVBD)
    with pytest.warns(UserWarning, match="without contacts"):
        tests.test_distance_joint_limits(unittest.TestCase(), "cpu")


def test_a_chain_of_distances_of_zero_holds_at_its_points() -> None:
    """Three bodies hung from each other by DISTANCE joints of length 0, solved at once, swing."""
    builder = newton.ModelBuilder()
    joints, above = [], WORLD
    for i in range(3):
        link = add_link(builder, xform=transform((0.5 + i, 0.0, 0.0)))
        start = transform((0.5 if i else 0.0, 0.0, 0.0))
        joint = builder.add_joint_distance(
            above,
            link,
            parent_xform=start,
            child_xform=transform((-0.5, 0.0, 0.0)),
            min_distance=0.0,
            max_distance=0.0,
        )
        joints.append(joint)
        above = link
    builder.add_articulation(joints)
    sim = Simulation(builder, collide=False)
    for _ in range(60):
        sim.step()
        np.testing.assert_allclose(anchor_gaps(sim), 0.0, atol=1e-5)
    assert sim.center[2, 2] < -0.2
