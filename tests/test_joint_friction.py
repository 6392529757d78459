# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Coulomb friction in joints: holds below its force, slides against it above."""

from typing import Any

import newton
import numpy as np
import pytest
from axis_law import KINDS, Law, axis_scene
from helpers import G, Simulation, in_float32
from joint_scenes import (
    WORLD,
    add_hinge_chain,
    add_link,
    anchor_gaps,
    coordinates,
    set_coordinates,
    simulate,
    transform,
)

pytestmark = pytest.mark.usefixtures("shared_kernels")

FRICTION = 3.0


@pytest.mark.parametrize("kind", KINDS)
def test_friction_holds_without_creep(kind: str) -> None:
    """4 s under 98 % of it: within 1e-6 of where it was, which is what float32 poses can say."""
    sim, _ = axis_scene(kind, Law(friction=FRICTION, force=0.98 * FRICTION), 0.1)
    start = coordinates(sim)[0][0]
    for _ in range(4):
        sim.run(1.0)
        assert coordinates(sim)[0][0] == pytest.approx(start, abs=1.0e-6)
        assert np.abs(sim.velocity).max() < 2.0e-4


@pytest.mark.parametrize("kind", KINDS)
def test_friction_slows_by_a_constant_and_ends_at_rest(kind: str) -> None:
    """v - n h friction/M, each step within 1e-4 of the speed; then rest, without going back."""
    v = 0.9
    sim, inertia = axis_scene(kind, Law(friction=FRICTION), 0.0, v, scheme="euler")
    h = in_float32(sim.dt)
    path, way = [], 0.0
    for step in range(1, 241):
        sim.step()
        q, qd = (x[0] for x in coordinates(sim))
        path.append(q)
        expected = max(v - step * h * FRICTION / inertia, 0.0)
        way += h * expected
        assert qd == pytest.approx(expected, abs=1.0e-4 * v)
    assert np.diff(path).min() > -1.0e-6
    assert path[-1] == pytest.approx(way, rel=1.0e-4)


def test_a_held_arm_does_not_sag_and_a_heavier_one_does() -> None:
    """Gravity's torque against the hinge, 2 % to either side, 4 s."""
    for share, moves in ((0.98, False), (1.02, True)):
        builder = newton.ModelBuilder()
        body = add_link(builder)
        joint = builder.add_joint_revolute(
            WORLD,
            body,
            child_xform=transform((-0.4, 0.0, 0.0)),
            axis=(0.0, 1.0, 0.0),
            friction=0.4 * G / share,
        )
        builder.add_articulation([joint])
        sim = simulate(builder)
        sim.run(4.0)
        q = coordinates(sim)[0][0]
        assert (q > 0.1) if moves else (abs(q) < 1.0e-6)


def chain(friction: list[float], **settings: Any) -> Simulation:
    """Four hinged rods of 0.1 kg and 0.1 m, released bent and level."""
    builder = newton.ModelBuilder()
    joints = add_hinge_chain(builder, len(friction), masses=[0.1] * len(friction))
    for joint, most in enumerate(friction):
        builder.joint_friction[joint] = most
    for joint, q in zip(joints, (0.2, -0.5, 0.4, 0.3), strict=False):
        set_coordinates(builder, joint, [q])
    return simulate(builder, **settings)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_stuck_hinge_within_a_chain_is_a_weld(scheme: str) -> None:
    """A chain whose middle hinges hold swings as a chain of one hinge less: 1e-4 rad over 1 s."""
    sim = chain([0.0, 50.0, 50.0, 0.0], scheme=scheme)
    held = coordinates(sim)[0][1:3]
    builder = newton.ModelBuilder()
    add_hinge_chain(builder, 4, masses=[0.1] * 4)
    for joint, q in enumerate((0.2, -0.5, 0.4, 0.3)):
        set_coordinates(builder, joint, [q])
    for joint in (1, 2):
        builder.joint_limit_lower[joint] = builder.joint_limit_upper[joint] = held[joint - 1]
    welded = simulate(builder, scheme=scheme)
    for _ in range(240):
        sim.step()
        welded.step()
        q = coordinates(sim)[0]
        assert q[1:3] == pytest.approx(held, abs=2.0e-6)
        assert q == pytest.approx(coordinates(welded)[0], abs=1.0e-4)


@pytest.mark.parametrize("count", [4, 20])
@pytest.mark.parametrize("most", [0.1, 0.5])
@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_chain_with_friction_in_all_hinges_settles(scheme: str, count: int, most: float) -> None:
    """Hinges that stick and slip by turns lose energy only, in a few sweeps, and come to rest.

    With 0.5 N m the outer hinges never move, with 0.1 N m most do at first. By backward Euler
    energy falls from step to step, of second order it is never above the first.
    """
    sim = chain([most] * count, scheme=scheme)
    energy, sweeps, fastest = sim.energy, [], 0.0
    for step in range(1200):
        sim.step()
        assert sim.energy < energy + 1.0e-5
        if scheme == "euler":
            energy = sim.energy
        fastest = max(fastest, np.abs(coordinates(sim)[1]).max())
        if step > 3:
            sweeps.append(sim.solver.status.sweeps[0])
    assert fastest > 1.0
    assert np.mean(sweeps) < 4.0
    assert anchor_gaps(sim).max() < 1.0e-5
    if count == 4:
        assert np.abs(coordinates(sim)[1]).max() < 1.0e-4


@pytest.mark.parametrize("kind", ["slider", "hinge"])
def test_friction_outside_of_trees(kind: str) -> None:
    """Held by a multiplier: holds 98 % with 1e-5/s of creep, and stops within 2 % of the way."""
    law = Law(friction=FRICTION, force=0.98 * FRICTION)
    sim, _ = axis_scene(kind, law, 0.1, blocks="body")
    sim.run(0.5)
    q = coordinates(sim)[0][0]
    sim.run(1.0)
    assert coordinates(sim)[0][0] == pytest.approx(q, abs=1.0e-5)
    v = 0.9
    sim, inertia = axis_scene(kind, Law(friction=FRICTION), 0.0, v, blocks="body")
    sim.run(1.5)
    way = v * v * inertia / (2 * FRICTION)
    assert coordinates(sim)[0][0] == pytest.approx(way, abs=0.02 * way + 0.5 * v * sim.dt)
    assert np.abs(sim.velocity).max() < 1.0e-3


def test_friction_of_a_joint_that_closes_a_loop() -> None:
    """A plank on two hinges: the friction of the second, no part of the tree, holds it level."""
    for share, moves in ((0.9, False), (1.1, True)):
        builder = newton.ModelBuilder()
        plank = add_link(builder)
        hinge = {"child_xform": transform((-0.4, 0.0, 0.0)), "axis": (0.0, 1.0, 0.0)}
        first = builder.add_joint_revolute(WORLD, plank, **hinge)
        builder.add_articulation([first])
        with pytest.warns(match="another joint already connects"):
            builder.add_joint_revolute(WORLD, plank, friction=0.4 * G / share, **hinge)
        sim = simulate(builder)
        sim.run(1.0)
        q = coordinates(sim)[0][0]
        assert (q > 0.1) if moves else (abs(q) < 1.0e-3)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_friction_of_a_ball_acts_about_each_axis(scheme: str) -> None:
    """A spinning ball is slowed by friction/I about each axis of its parent frame that turns."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    body = add_link(builder, inertia=(0.1, 0.1, 0.1))
    joint = builder.add_joint_ball(WORLD, body, friction=0.2)
    builder.add_articulation([joint])
    set_coordinates(builder, joint, (0.0, 0.0, 0.0, 1.0), (0.3, -0.8, 0.0))
    sim = simulate(builder, scheme=scheme)
    sim.run(0.1)
    expected = [0.3 - 0.2, -0.8 + 0.2, 0.0]
    assert sim.velocity[0, 3:] == pytest.approx(expected, abs=5.0e-3)
    sim.run(1.0)
    assert np.abs(sim.velocity).max() < 1.0e-5
