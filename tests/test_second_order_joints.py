# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Schemes of second order with what acts along joints: drives, springs, friction, limits."""

import dataclasses
from collections.abc import Callable
from typing import Any

import newton
import numpy as np
import pytest
from helpers import NO_GRAVITY, G
from joint_scenes import (
    WORLD,
    add_contact,
    add_link,
    coordinates,
    set_control,
    set_coordinates,
    simulate,
    transform,
)
from newton.solvers import SolverBase
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from test_second_order import ALPHA, STEPS, assert_second_order

from newton_avbd.study.stability.case import Trial
from newton_avbd.study.stability.cases import CASES

pytestmark = pytest.mark.usefixtures("shared_kernels")

HINGE = (0.0, 1.0, 0.0)
INERTIA = (0.2, 0.3, 0.4)
"""Of the links here [kg m^2]; they weigh 1 kg."""
ARM = 0.4
"""From a hinge to the center of mass of a link that hangs from it [m]."""


def hinged(arm: float = ARM, q: float = 0.0, qd: float = 0.0, **axis: Any) -> newton.ModelBuilder:
    """A link on a hinge along y, at ``arm`` [m] along +x where the angle is zero."""
    builder = newton.ModelBuilder()
    link = add_link(builder, inertia=INERTIA)
    joint = builder.add_joint_revolute(
        WORLD, link, child_xform=transform((-arm, 0.0, 0.0)), axis=HINGE, **axis
    )
    builder.add_articulation([joint])
    set_coordinates(builder, joint, [q], [qd])
    return builder


def angle(builder: newton.ModelBuilder, seconds: float, dt: float) -> float:
    """First joint coordinate after a while [rad]."""
    sim = simulate(builder, dt=dt, scheme=ALPHA)
    sim.run(seconds)
    return float(coordinates(sim)[0][0])


def integrated(
    acceleration: Callable[[float, float], float], q: float, qd: float, seconds: float
) -> float:
    """Coordinate after a while by DOP853, from its acceleration by coordinate and velocity."""

    def rate(_: float, y: np.ndarray) -> list[float]:
        return [y[1], acceleration(y[0], y[1])]

    found = solve_ivp(rate, (0.0, seconds), [q, qd], method="DOP853", rtol=1e-11, atol=1e-12)
    return float(found.y[0, -1])


@pytest.mark.parametrize("law", ["drive", "spring", "armature", "all"])
def test_a_pendulum_with_forces_along_its_hinge(law: str) -> None:
    """(I + m l^2 + armature) q'' = m g l cos q + ke (target - q) - kd qd - k q - c qd, 1 s."""
    ke, kd = (30.0, 0.4) if law in ("drive", "all") else (0.0, 0.0)
    k, c = (20.0, 0.3) if law in ("spring", "all") else (0.0, 0.0)
    armature = 0.3 if law in ("armature", "all") else 0.0
    target = 0.2
    inertia = INERTIA[1] + ARM**2 + armature

    def acceleration(q: float, qd: float) -> float:
        torque = G * ARM * np.cos(q) + ke * (target - q) - (kd + c) * qd - k * q
        return torque / inertia

    belongs = integrated(acceleration, -0.3, 0.5, 1.0)

    def error(dt: float) -> float:
        builder = hinged(
            q=-0.3,
            qd=0.5,
            target_ke=ke,
            target_kd=kd,
            target_pos=target,
            stiffness=k,
            damping=c,
            armature=armature,
            actuator_mode=newton.JointTargetMode.POSITION,
        )
        return abs(angle(builder, 1.0, dt) - belongs)

    assert_second_order(error, least=3.0)


def test_a_stiff_drive_holds_and_does_not_ring() -> None:
    """Ten times as stiff as a step of 1/60 s resolves: from 0.5 rad it comes to its target."""
    ke = 100.0 * INERTIA[1] * 60.0**2
    builder = hinged(arm=0.0, q=0.5, target_ke=ke, target_kd=0.0)
    builder.gravity = NO_GRAVITY
    sim = simulate(builder, dt=1.0 / 60.0, scheme=ALPHA)
    start = sim.energy + 0.5 * ke * 0.5**2
    for _ in range(120):
        sim.step()
        q = float(coordinates(sim)[0][0])
        assert sim.energy + 0.5 * ke * q**2 < 1.01 * start
    assert abs(q) < 1.0e-3


def test_friction_stops_a_hinge_where_it_belongs() -> None:
    """v t - a t^2 / 2 to rounding, v^2 / (2 a) where it stops, and there it stays."""
    speed, friction = 3.0, 0.6
    brake = friction / INERTIA[1]
    stop = speed**2 / (2.0 * brake)

    def scene() -> newton.ModelBuilder:
        builder = hinged(arm=0.0, qd=speed, friction=friction)
        builder.gravity = NO_GRAVITY
        return builder

    belongs = speed - 0.5 * brake
    # the trapezoidal rule is exact for a constant brake, and the next steps are not quite
    for dt in STEPS:
        assert angle(scene(), 1.0, dt) == pytest.approx(belongs, abs=0.1 * brake * dt**2 + 6.0e-5)
        sim = simulate(scene(), dt=dt, scheme=ALPHA)
        sim.run(2.0)
        q = coordinates(sim)[0][0]
        assert q == pytest.approx(stop, abs=brake * dt**2 + 1.0e-4)
        sim.run(1.0)
        assert coordinates(sim)[0][0] == pytest.approx(q, abs=1.0e-6)
        assert np.abs(sim.velocity).max() < 1.0e-3


@pytest.mark.parametrize("settings", [{}, {"parallel": "bodies", "collide": True}], ids=str)
def test_a_hinge_that_friction_stops_does_not_ring(settings: dict[str, Any]) -> None:
    """Once it stands the braking is over: extrapolated, it swung on at 1.4e-3 rad/s."""
    builder = hinged(arm=0.0, qd=1.0, friction=10.0 * INERTIA[1])
    builder.gravity = NO_GRAVITY
    add_contact(builder, 0)
    sim = simulate(builder, dt=1.0 / 240.0, scheme=ALPHA, **settings)
    speeds = []
    for _ in range(60):
        sim.step()
        speeds.append(np.abs(sim.velocity[0]).max())
    assert speeds[0] > 0.9
    assert max(speeds[-30:]) < 1.0e-5


@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
def test_a_turning_arm_is_pulled_evenly_after_its_start(dt: float) -> None:
    """By m w^2 r: what the first step leaves, along a chord, took 16 steps to die out."""
    builder = hinged(qd=3.0)
    builder.gravity = NO_GRAVITY
    sim = simulate(builder, dt=dt, scheme=ALPHA)
    observables = sim.observe(SolverBase.ObservableKind.BODY_PARENT_F)
    pulls = []
    for _ in range(24):
        sim.step()
        spin = np.linalg.norm(sim.velocity[0, 3:])
        force = np.linalg.norm(observables.body_parent_f.numpy()[0, :3])
        pulls.append(float(force) / (spin**2 * ARM))
    assert max(pulls[:4]) < 2.3
    assert pulls[4:] == pytest.approx([1.0] * 20, abs=0.05)


@pytest.mark.long
@pytest.mark.parametrize("rate", [240.0, 480.0])
def test_a_taut_grid_gains_no_energy_however_many_sweeps(rate: float) -> None:
    """Its joints open by micrometers, so what swings is faster than any step. Extrapolated, and
    converged, boxes of it went at 17 rad/s; in 1 s it gained 12 and 68 mm of height."""
    case = CASES["joint_grid_8"].at_rate(rate)
    trial = Trial(dataclasses.replace(case, settings={"scheme": ALPHA}), "avbd", 100)
    weight = G * float(np.sum(trial.bodies.mass[trial.bodies.moving]))
    start, highest = trial.energy(), -np.inf
    for step in range(int(rate)):
        trial.step(case.step_size(step))
        highest = max(highest, trial.energy())
    assert highest - start < 1.0e-5 * weight


def test_a_limit_gives_no_energy_back() -> None:
    """In no gravity at 3 rad/s: after a limit it stands there; until then it keeps its speed."""
    for dt in STEPS:
        builder = hinged(arm=0.0, qd=3.0, limit_lower=-1.0, limit_upper=0.7)
        builder.gravity = NO_GRAVITY
        sim = simulate(builder, dt=dt, scheme=ALPHA)
        energies = []
        for _ in range(round(0.5 / dt)):
            sim.step()
            energies.append(sim.energy)
        assert np.diff(energies).max() < 1.0e-5 * energies[0]
        assert coordinates(sim)[0][0] == pytest.approx(0.7, abs=5.0e-4)
        assert np.abs(sim.velocity).max() < 1.0e-3


def test_a_pendulum_between_limits_only_loses_energy() -> None:
    """It falls from one limit to the other and leans there; a swing gains at most 1e-3 of it."""
    for dt in STEPS:
        builder = hinged(q=-0.5, qd=-2.0, limit_lower=-0.8, limit_upper=0.9)
        sim = simulate(builder, dt=dt, scheme=ALPHA)
        start = highest = sim.energy
        lowest = highest
        for _ in range(round(2.0 / dt)):
            sim.step()
            highest = max(highest, sim.energy)
            lowest = min(lowest, sim.energy)
        assert highest - start < 1.0e-3 * (start - lowest)
        assert coordinates(sim)[0][0] == pytest.approx(0.9, abs=1.0e-4)
        assert np.abs(sim.velocity).max() < 1.0e-3


@pytest.mark.parametrize("settings", [{}, {"blocks": "body"}, {"parallel": "bodies"}])
def test_forces_that_change_each_step_act_in_full_in_their_step(settings: dict[str, str]) -> None:
    """A slider under random forces, each for a step: v = sum of h f/m to rounding.

    In a tree its places are twenty times closer to the exact ones, pieces of parabolas, than by
    backward Euler, on the average of eight paths.
    """
    h, mass = 1.0 / 240.0, 2.0
    shares = []
    for seed in range(8):
        forces = np.random.default_rng(seed).uniform(-10.0, 10.0, 240)
        v = np.cumsum(h * forces / mass)
        x = np.cumsum(h * np.append(0.0, v[:-1]) + 0.5 * h * h * forces / mass)
        off = {}
        for scheme in (ALPHA, "euler"):
            builder = newton.ModelBuilder(gravity=NO_GRAVITY)
            joint = builder.add_joint_prismatic(WORLD, add_link(builder, mass=mass), axis=(1, 0, 0))
            builder.add_articulation([joint])
            sim, places = simulate(builder, dt=h, scheme=scheme, **settings), []
            for force, speed in zip(forces, v, strict=True):
                set_control(sim, joint_f=[force])
                sim.step()
                places.append(sim.pose[0, 0])
                assert sim.velocity[0, 0] == pytest.approx(speed, abs=2.0e-6)
            off[scheme] = np.abs(np.array(places) - x).max()
        shares.append(off[ALPHA] / off["euler"])
    if "blocks" not in settings:
        assert np.mean(shares) < 0.055


@pytest.mark.parametrize("limit", [None, 1.0e4])
@pytest.mark.parametrize(("ke", "kd", "share"), [(10.0, 1.0, 0.06), (1.0e3, 40.0, 0.11)])
def test_targets_that_jump_act_in_full_in_their_step(
    limit: float | None, ke: float, kd: float, share: float
) -> None:
    """A slider whose drive gets a random target each step, against the matrix exponential.

    Drives are 18 and 10 times closer than by backward Euler, soft ones and those of an eighth of a
    step's inertia, on the average of eight paths.
    """
    h, mass = 1.0 / 240.0, 2.0
    turn = expm(h * np.array([[0.0, 1.0], [-ke / mass, -kd / mass]]))
    law = {"target_ke": ke, "target_kd": kd, "effort_limit": limit}
    shares = []
    for seed in range(8):
        targets = np.random.default_rng(seed).uniform(-1.0, 1.0, 240)
        path, state = [], np.zeros(2)
        for target in targets:
            rest = np.array([target, 0.0])
            state = rest + turn @ (state - rest)
            path.append(state[0])
        off = {}
        for scheme in (ALPHA, "euler"):
            builder = newton.ModelBuilder(gravity=NO_GRAVITY)
            joint = builder.add_joint_prismatic(
                WORLD,
                add_link(builder, mass=mass),
                axis=(1, 0, 0),
                actuator_mode=newton.JointTargetMode.POSITION,
                **{name: value for name, value in law.items() if value is not None},
            )
            builder.add_articulation([joint])
            sim, places = simulate(builder, dt=h, scheme=scheme), []
            for target in targets:
                set_control(sim, joint_target_q=[target])
                sim.step()
                places.append(sim.pose[0, 0])
            off[scheme] = np.abs(np.array(places) - path).max()
        shares.append(off[ALPHA] / off["euler"])
    assert np.mean(shares) < share


@pytest.mark.parametrize("effort", [1.0, 4.0])
def test_targets_that_jump_act_in_full_within_an_effort_limit(effort: float) -> None:
    """A drive that is at its limit most of the time, against steps of a 32nd."""
    targets = np.random.default_rng(0).uniform(-1.0, 1.0, 100)

    def path(scheme: str, parts: int) -> np.ndarray:
        builder = hinged(arm=0.0, target_ke=20.0, target_kd=1.0, effort_limit=effort)
        builder.gravity = NO_GRAVITY
        sim, angles = simulate(builder, dt=1.0 / 240.0 / parts, scheme=scheme), []
        for target in targets:
            set_control(sim, joint_target_q=[target])
            sim.step(parts)
            angles.append(coordinates(sim)[0][0])
        return np.array(angles)

    exact = path("euler", 32)
    off = {scheme: np.abs(path(scheme, 1) - exact).max() for scheme in (ALPHA, "euler")}
    assert off[ALPHA] < off["euler"]


def test_a_drive_in_another_world_gives_a_taut_chain_no_energy() -> None:
    """300 kg at the end of links of 10 g: what swings faster than steps is stepped by backward
    Euler, whatever else there is."""
    chain, driven = newton.ModelBuilder(), newton.ModelBuilder()
    for builder, masses, ke in ((chain, [0.01] * 11 + [300.0], 0.0), (driven, [1.0], 1.0e-3)):
        joints, parent = [], WORLD
        for mass in masses:
            link = add_link(builder, mass=mass, inertia=mass * np.array([1e-4, 8e-4, 8e-4]))
            joint = builder.add_joint_revolute(
                parent,
                link,
                parent_xform=transform((0.0 if parent == WORLD else 0.05, 0.0, 0.0)),
                child_xform=transform((-0.05, 0.0, 0.0)),
                axis=HINGE,
                target_ke=ke,
            )
            joints.append(joint)
            parent = link
        builder.add_articulation(joints)
        set_coordinates(builder, joints[0], [0.3])
    both = newton.ModelBuilder()
    both.add_world(chain)
    both.add_world(driven)
    sim = simulate(both, dt=1.0 / 240.0, scheme=ALPHA)
    start = sim.energy
    for _ in range(960):
        sim.step()
        assert sim.energy - start < 1.0e-3 * 300.0 * G


def test_friction_that_stops_a_hinge_at_once_stops_it_for_good() -> None:
    """The first step takes all of its rate; the second one does not give any of it back."""
    builder = hinged(arm=0.0, qd=5.0, friction=1.0e3)
    builder.gravity = NO_GRAVITY
    sim = simulate(builder, dt=1.0 / 240.0, scheme=ALPHA)
    for _ in range(5):
        sim.step()
        assert np.abs(sim.velocity).max() < 1.0e-4


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("stiffness", [0.0, 2000.0])
def test_a_robot_in_the_air_falls_as_a_ball_does(stiffness: float, parallel: str) -> None:
    """The COM of an articulation goes along a parabola from the first step on at 60 Hz.

    That is so in steps of first order, too, which a stiff spring makes of all. With a constant
    force F on a link the COM has the acceleration g + F/M.
    """
    builder = newton.ModelBuilder()
    builder.default_shape_cfg.collision_group = 0
    root = add_link(builder, mass=2.0)
    joints = [builder.add_joint_free(root)]
    for side in (1.0, -1.0):
        link = add_link(builder, mass=0.5, inertia=(0.01, 0.02, 0.02))
        joints.append(
            builder.add_joint_revolute(
                root,
                link,
                parent_xform=transform((0.2 * side, 0.0, 0.0)),
                child_xform=transform((-0.3 * side, 0.0, 0.0)),
                axis=HINGE,
                stiffness=stiffness,
            )
        )
    builder.add_articulation(joints)
    set_coordinates(builder, joints[0], [0, 0, 3, 0, 0, 0, 1], [1.0, 0.0, 2.0, 0.3, 0.0, 0.0])
    set_coordinates(builder, joints[1], [0.1], [1.0])
    add_contact(builder, root)
    sim = simulate(builder, dt=1.0 / 60.0, scheme=ALPHA, parallel=parallel)
    share = sim.mass / sim.mass.sum()
    force = np.array([0.0, 1.5, 3.0])
    sim.push(root, force)
    start, v = share @ sim.center, share @ sim.velocity[:, :3]
    a = force / sim.mass.sum() - [0.0, 0.0, G]
    orders = set()
    for k in range(1, 31):
        sim.step()
        orders.add(int(sim.solver.report().order[0]))
        t = k / 60.0
        np.testing.assert_allclose(share @ sim.center, start + t * v + 0.5 * t**2 * a, atol=1e-5)
        np.testing.assert_allclose(share @ sim.velocity[:, :3], v + t * a, atol=1e-4)
    assert 1 in orders
    if stiffness == 0.0:
        assert 2 in orders


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_the_first_step_does_not_go_too_far(speed: float, parallel: str) -> None:
    """A pendulum on a slider after one step of 1/60 s, against Lagrange's equations in float64.

    Backward Euler is off by h^2 a/2, 1.4 mm on the slider. Its chord remains: the trapezoidal rule
    is off by terms of h^3. A step in place is the same step.
    """
    h, mass, arm, inertia, angle_0 = 1.0 / 60.0, 1.0, 0.4, 0.01, 0.7
    builder = newton.ModelBuilder()
    rail, bob = add_link(builder, mass=mass), add_link(builder, mass=mass, inertia=[inertia] * 3)
    slider = builder.add_joint_prismatic(WORLD, rail, axis=(0, 0, 1))
    hinge = builder.add_joint_revolute(
        rail, bob, child_xform=transform((-arm, 0.0, 0.0)), axis=(0, 1, 0)
    )
    builder.add_articulation([slider, hinge])
    set_coordinates(builder, slider, [0.0], [-speed])
    set_coordinates(builder, hinge, [angle_0], [speed])
    add_contact(builder, rail)

    def rates(_: float, y: np.ndarray) -> list[float]:
        # the bob is at x = arm cos a, z = s - arm sin a
        _, a, v, w = y
        m = [[2.0 * mass, -mass * arm * np.cos(a)], [-mass * arm * np.cos(a), 0.0]]
        m[1][1] = mass * arm**2 + inertia
        push = [-2.0 * mass * G - mass * arm * np.sin(a) * w**2, mass * G * arm * np.cos(a)]
        return [v, w, *np.linalg.solve(m, push)]

    exact = solve_ivp(rates, (0.0, h), [0.0, angle_0, -speed, speed], rtol=1e-10, atol=1e-12).y
    off = {}
    for scheme in ("euler", ALPHA):
        sim = simulate(builder, dt=h, scheme=scheme, parallel=parallel)
        sim.step()
        off[scheme] = np.abs(coordinates(sim)[0] - exact[:2, -1]).max()
    assert off["euler"] > 1.0e-3
    assert off[ALPHA] < 0.1 * off["euler"]
    in_place = simulate(builder, dt=h, scheme=ALPHA, parallel=parallel)
    in_place.solver.step(in_place.state, in_place.state, None, in_place.contacts, h)
    np.testing.assert_array_equal(in_place.pose, sim.pose)


def test_velocities_that_joints_stop_at_once_count_as_a_jump() -> None:
    """One of two bodies on a slider of its own is kicked, though a joint holds them together.

    Both go on at half of the speed from the start of the step, and not by a quarter of it more.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    links = [add_link(builder, mass=1.0) for _ in range(2)]
    joints = [builder.add_joint_prismatic(WORLD, links[0], axis=(1, 0, 0))]
    joints.append(builder.add_joint_revolute(links[0], links[1], axis=HINGE))
    builder.add_articulation(joints)
    sim = simulate(builder, dt=1.0 / 60.0, scheme=ALPHA)
    sim.set_velocity(0, (1.0, 0.0, 0.0))
    sim.step()
    np.testing.assert_allclose(sim.pose[:, 0], 0.5 / 60.0, atol=1e-6)
    np.testing.assert_allclose(sim.velocity[:, 0], 0.5, atol=1e-5)
