# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Limits are hard: a joint stops there, does not bounce, and leaves freely."""

from typing import Any

import newton
import numpy as np
import pytest
from helpers import NO_GRAVITY, G, Simulation
from joint_scenes import (
    WORLD,
    add_link,
    anchor_gaps,
    coordinates,
    set_control,
    set_coordinates,
    simulate,
    transform,
)
from scipy.spatial.transform import Rotation

from newton_avbd.measure.joints import Joints

pytestmark = pytest.mark.usefixtures("shared_kernels")

TURNED = Rotation.from_euler("xyz", [0.5, -0.8, 1.9])
CLOSE = 1.0e-4  # [m] or [rad]: how far past its limit a joint may be found, ever


def falling(
    kind: str,
    side: str,
    stop: float | None,
    q: float = 0.0,
    *,
    gravity: tuple[float, float, float] = (0.0, 0.0, -G),
    **settings: Any,
) -> Simulation:
    """A slider that falls along, or an arm that falls from horizontal about, a turned frame.

    Towards the upper side the coordinate grows in the fall, towards the lower side it shrinks.
    ``stop`` is the limit's distance from 0.
    """
    sign = 1.0 if side == "upper" else -1.0
    axis = np.array([0.0, 0.0, -sign]) if kind == "slider" else np.array([0.0, sign, 0.0])
    limits = {} if stop is None else {f"limit_{side}": sign * stop}
    builder = newton.ModelBuilder(gravity=gravity)
    body = add_link(builder)
    add = builder.add_joint_prismatic if kind == "slider" else builder.add_joint_revolute
    joint = add(
        WORLD,
        body,
        parent_xform=transform((0.2, 0.1, 1.0), TURNED),
        child_xform=transform((-0.4, 0.0, 0.0), TURNED),
        axis=tuple(TURNED.inv().apply(axis)),
        **limits,
    )
    builder.add_articulation([joint])
    set_coordinates(builder, joint, [sign * q])
    return simulate(builder, **settings)


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("kind", ["slider", "arm"])
def test_a_falling_joint_stops_at_its_limit(kind: str, side: str) -> None:
    """It lands after 0.2 to 0.4 s, at 3 to 5 m/s or rad/s, and is at rest there from then on.

    Newton's ``limit_ke`` of 1e4 would let it 20 mm deep; limits are hard here, and inelastic.
    """
    stop = 0.5
    sim = falling(kind, side, stop)
    path = []
    for _ in range(240):
        sim.step()
        path.append(abs(coordinates(sim)[0][0]))
    path = np.array(path)
    landed = int(np.argmax(path > stop - CLOSE))
    assert 0.2 < landed * sim.dt < 0.4
    assert path.max() < stop + CLOSE
    assert path[landed:].min() > stop - CLOSE
    assert np.abs(sim.velocity).max() < 1.0e-4
    assert anchor_gaps(sim)[0] == pytest.approx(stop if kind == "slider" else 0.0, abs=CLOSE)


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("kind", ["slider", "arm"])
def test_a_limit_that_is_not_reached_changes_nothing(kind: str, side: str) -> None:
    """Up to landing the fall is that without a limit, to rounding: no braking before it."""
    free, limited = falling(kind, side, None), falling(kind, side, 0.5)
    for _ in range(50):
        free.step()
        limited.step()
        assert abs(coordinates(limited)[0][0]) < 0.5
        assert limited.velocity == pytest.approx(free.velocity, abs=1.0e-4)
        assert limited.pose == pytest.approx(free.pose, abs=1.0e-5)


def test_a_joint_is_closed_where_a_stop_takes_back_what_it_would_have_turned() -> None:
    """An arm meets its stop at 20 rad/s: the first iteration takes back a turn of 5 degrees.

    One iteration left the joint open by half the angle times the way, 1 mm, since the step as a
    whole turned next to nothing. Rounding is 1e-7.
    """
    sim = falling("arm", "upper", 0.5)
    sim.model.joint_qd.assign([20.0])
    newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
    for _ in range(12):
        sim.step()
        assert anchor_gaps(sim).max() < 1.0e-6
    assert np.abs(sim.velocity).max() < 1.0e-3


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("kind", ["slider", "arm"])
def test_outside_of_trees_a_joint_comes_back_within_its_limit(kind: str, parallel: str) -> None:
    """From 0.1 beyond it, weightless and under its weight, as fast as in an articulation.

    What a step closes is no velocity. Bound: a tenth of what the tree has closed by then.
    """
    for gravity in (NO_GRAVITY, (0.0, 0.0, -G)):
        trees, lone = (
            falling(kind, "upper", 0.5, 0.6, gravity=gravity, **settings)
            for settings in ({}, {"blocks": "body", "parallel": parallel})
        )
        for _ in range(30):
            closed = 0.6 - coordinates(trees)[0][0]
            assert abs(coordinates(lone)[0][0] - coordinates(trees)[0][0]) < 0.1 * closed + 1.0e-4
            trees.step()
            lone.step()
        assert abs(coordinates(lone)[0][0] - 0.5) < CLOSE
        assert np.abs(lone.velocity).max() < 1.0e-3


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_joint_leaves_its_limit_freely(side: str) -> None:
    """Pulled away with twice its weight, it leaves with 1 g at once: limits do not hold on.

    Bound: 1 % of the speed after 24 steps, a tenth of which is one step's worth.
    """
    sim = falling("slider", side, 0.1, q=0.1)
    sim.step(10)
    assert abs(coordinates(sim)[0][0]) == pytest.approx(0.1, abs=CLOSE)
    sim.push(0, (0.0, 0.0, 2.0 * G))
    sim.step(24)
    assert sim.velocity[0, 2] == pytest.approx(24 * sim.dt * G, rel=1.0e-2)


def test_both_limits_at_zero_lock_the_joint() -> None:
    """An arm between equal limits neither sags nor swings: 1e-4 rad."""
    builder = newton.ModelBuilder()
    body = add_link(builder)
    joint = builder.add_joint_revolute(
        WORLD,
        body,
        child_xform=transform((-0.4, 0.0, 0.0)),
        axis=(0.0, 1.0, 0.0),
        limit_lower=0.0,
        limit_upper=0.0,
    )
    builder.add_articulation([joint])
    sim = simulate(builder)
    sim.run(0.5)
    assert coordinates(sim)[0][0] == pytest.approx(0.0, abs=CLOSE)
    assert np.abs(sim.velocity).max() < 1.0e-3


def test_a_stop_that_let_go_holds_what_presses_it_again() -> None:
    """A motor lifts an arm off its stop by less than rounding, then presses it down.

    Both are parts of a robot that floats without gravity. The arm pushes the robot as the motor
    does, so that nothing turns but for what the first step gave. Were the arm only kept from
    passing its stop, the robot would take the motor's torque and turn the other way: at 0.05
    rad/s^2 on 1 kg m^2, five times what may pass for rounding, by 0.05 rad/s in the second.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    base = add_link(builder, inertia=(1.0, 1.0, 1.0))
    arm = add_link(builder, inertia=(1.0, 1.0, 1.0))
    joints = [
        builder.add_joint_free(base),
        builder.add_joint_revolute(base, arm, axis=(0, 1, 0), limit_lower=0.0, limit_upper=1.0),
    ]
    builder.add_articulation(joints)
    sim = simulate(builder)
    press = np.zeros(7)
    press[6] = -0.05
    set_control(sim, joint_f=press)
    sim.step(10)
    set_control(sim, joint_f=-1e-3 * press)
    sim.step(1)
    set_control(sim, joint_f=press)
    sim.step(240)
    assert np.abs(sim.velocity).max() < 1e-5
    assert coordinates(sim)[0][-1] > -1e-6


def test_a_stop_that_holds_in_the_first_step_is_an_impact() -> None:
    """An arm on a floating base starts at 5 rad/s, between limits that both are where it is.

    The step of second order after it went on with the deceleration: 0.8 rad/s and 3 % of the energy
    came back.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    base = add_link(builder, inertia=(1.0, 1.0, 1.0))
    arm = add_link(builder, inertia=(0.5, 0.4, 0.3))
    limits = {"limit_lower": 0.0, "limit_upper": 0.0}
    joints = [
        builder.add_joint_free(base),
        builder.add_joint_revolute(base, arm, axis=(0, 1, 0), **limits),
    ]
    builder.add_articulation(joints)
    builder.joint_qd[6] = 5.0
    sim = simulate(builder)
    newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
    for _ in range(8):
        sim.step()
        assert np.abs(sim.velocity[1, 3:] - sim.velocity[0, 3:]).max() < 1.0e-4


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_train_that_is_pulled_taut_keeps_its_momentum(scheme: str) -> None:
    """The last of 24 wagons, none of whose couplings can give way, is hit away from the others.

    All go at v/24 in that step. Couplings take the load one after the other, which takes more
    sweeps than other steps have; when they ended before, the whole momentum was gone.
    """
    count, speed = 24, 1.0
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    joints, ahead = [], WORLD
    for i in range(count):
        wagon = add_link(builder, xform=transform((float(i), 0.0, 0.0)))
        hung = transform((float(i > 0), 0.0, 0.0))
        limits = {"limit_lower": -1.0, "limit_upper": 0.0} if i > 0 else {}
        joints.append(
            builder.add_joint_prismatic(
                ahead, wagon, axis=(1.0, 0.0, 0.0), parent_xform=hung, **limits
            )
        )
        ahead = wagon
    builder.add_articulation(joints)
    sim = simulate(builder, scheme=scheme)
    sim.step(5)
    sim.set_velocity(count - 1, (speed, 0.0, 0.0))
    sim.step()
    assert sim.velocity[:, 0] == pytest.approx(speed / count, rel=1.0e-3)
    sim.step(60)
    assert sim.velocity[:, 0] == pytest.approx(speed / count, rel=1.0e-3)
    assert np.diff(sim.pose[:, 0]).max() < 1.0 + CLOSE


def test_a_stop_holds_while_other_axes_of_its_joint_turn_fast() -> None:
    """By the pose of the body, from 16 random starts.

    Axes turn each other: summed updates of coordinates let one pass its stop by three milliradians.
    """
    rng = np.random.default_rng(0)
    for _ in range(16):
        builder = newton.ModelBuilder(gravity=NO_GRAVITY)
        body = add_link(builder, com=rng.uniform(-0.2, 0.2, 3), inertia=(0.01, 0.02, 0.025))
        q = [0.1, rng.uniform(-1.2, 1.2), rng.uniform(-1.0, 1.0)]
        rate, dt = rng.uniform(-12.0, 12.0, 3), rng.choice([60.0, 120.0, 240.0])
        axes = [
            newton.ModelBuilder.JointDofConfig(axis=axis, limit_lower=-3.0, limit_upper=upper)
            for axis, upper in (((1, 0, 0), 0.1), ((0, 0, 1), 3.0), ((0, 1, 0), 3.0))
        ]
        joint = builder.add_joint_d6(WORLD, body, angular_axes=axes)
        builder.add_articulation([joint])
        set_coordinates(builder, joint, [q[0] - 0.05 * abs(rng.normal()), *q[1:]], rate)
        sim = simulate(builder, dt=1.0 / dt)
        joints = Joints.of(sim.model)
        for _ in range(120):
            sim.step()
            assert joints.limit_violation(sim.pose).max() < CLOSE


def test_a_gimbal_whose_parent_turns_is_measured_again_at_its_stop() -> None:
    """Light bodies carry heavy ones by gimbals near their poles; first axes meet stops at speed.

    A stop takes back what an axis would have turned. It is the light parent that turns back, or
    axes turn against each other, and the child hardly moves: its coordinates stayed sums of first
    order, and stops were passed by up to 0.1 mrad, in random scenes by 29.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    far = 1.0e10
    for seed in range(32):
        rng = np.random.default_rng(seed)
        root = add_link(builder, mass=0.1, inertia=(1e-3, 1e-3, 1e-3))
        link = add_link(builder, mass=1.0, inertia=(0.005, 0.03, 0.03))
        axes = [
            newton.ModelBuilder.JointDofConfig(
                axis=axis, limit_lower=-0.5 if k == 0 else -far, limit_upper=0.5 if k == 0 else far
            )
            for k, axis in enumerate(((1, 0, 0), (0, 1, 0), (0, 0, 1)))
        ]
        ends = {
            "parent_xform": transform((0.2, 0.0, 0.0)),
            "child_xform": transform((-0.25, 0.0, 0.0)),
        }
        free = builder.add_joint_free(root)
        gimbal = builder.add_joint_d6(root, link, angular_axes=axes, **ends)
        builder.add_articulation([free, gimbal])
        near_pole = [rng.uniform(0.3, 0.5), -rng.uniform(1.15, 1.3), rng.uniform(-1.0, 1.0)]
        set_coordinates(builder, gimbal, near_pole)
        rates = np.array([1.0, rng.uniform(-0.3, 0.3), rng.uniform(0.9, 1.2)])
        builder.joint_qd[-3:] = (rng.uniform(10.0, 40.0) * rates).tolist()
    sim = simulate(builder)
    joints = Joints.of(sim.model)
    for _ in range(40):
        sim.step()
        assert joints.limit_violation(sim.pose).max() < 1e-5
