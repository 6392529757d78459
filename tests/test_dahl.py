# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Dahl friction of rods: the loop of torque and angle against its closed form, and SolverVBD."""

import math

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, Simulation
from newton.solvers import SolverVBD

from newton_avbd import SolverAVBD
from newton_avbd.io.examples import ExampleSimulation
from newton_avbd.io.simulation import Request

pytestmark = pytest.mark.usefixtures("shared_kernels")

KE, EPS, TAU = 250.0, 0.1, 0.05
"""Stiffness of each rod [N m/rad], its most torque by that [rad], the angle over which it grows."""
SEGMENTS = 4
TURN = math.radians(12.0)
"""Twist of the whole cable, 4 degrees for each of its three joints."""


def cable(tip_is_held: bool, segments: int = SEGMENTS) -> tuple[newton.ModelBuilder, list[int]]:
    """A straight cable along x; its first segment, and its last one if so, stay where they are."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    SolverVBD.register_custom_attributes(builder)
    rod = newton.Rod.create_straight(
        start=wp.vec3(0.0),
        direction=wp.vec3(1.0, 0.0, 0.0),
        length=0.1 * segments,
        segment_count=segments,
        radius=0.01,
    )
    bodies, _ = builder.add_rod(
        rod=rod,
        stretch_stiffness=1.0e6,
        stretch_damping=0.0,
        bend_stiffness=KE,
        bend_damping=1.0,
        twist_stiffness=KE,
        twist_damping=1.0,
    )
    for body in (bodies[0], bodies[-1]) if tip_is_held else (bodies[0],):
        builder.body_mass[body] = builder.body_inv_mass[body] = 0.0
        builder.body_inertia[body] = builder.body_inv_inertia[body] = wp.mat33(0.0)
    for name, value in (("dahl_eps_max", EPS), ("dahl_tau", TAU)):
        rods = [i for i, kind in enumerate(builder.joint_type) if kind == newton.JointType.ROD]
        builder.custom_attributes[f"vbd:{name}"].values = dict.fromkeys(rods, value)
    builder.color()
    return builder, list(bodies)


def rods_of(sim: Simulation) -> np.ndarray:
    """Which joints are rods."""
    return np.flatnonzero(sim.model.joint_type.numpy() == int(newton.JointType.ROD))


def twist(sim: Simulation, tip: int, angle: float) -> None:
    """Puts the tip to an angle about the cable."""
    pose = sim.state.body_q.numpy().copy()
    rest = wp.quat(*sim.model.body_q.numpy()[tip, 3:].tolist())
    pose[tip, 3:] = list(wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), angle) * rest)
    sim.state.body_q.assign(pose)


@pytest.mark.parametrize(
    ("settings", "collide"),
    [
        ({}, False),
        ({"scheme": "generalized_alpha"}, False),
        ({"blocks": "body", "iterations": 60}, False),
        ({"parallel": "bodies"}, True),
    ],
    ids=["tree", "second order", "bodies alone", "large world"],
)
def test_torques_of_a_twisted_cable_follow_the_closed_form(
    settings: dict[str, object], collide: bool
) -> None:
    """Twice there and back: sigma = s m + (sigma - s m) exp(-|dk|/tau), with k a third of the
    turn. Within 1 % of the most; the cable's own inertia and damping lag behind by that."""
    builder, bodies = cable(tip_is_held=True)
    sim = Simulation(builder, collide=collide, **settings)
    most, kappa, sigma = KE * EPS, TURN / (SEGMENTS - 1), 0.0
    for side in (1.0, -1.0, 1.0, -1.0):
        for k in range(120):
            angle = TURN * (k + 1) / 120 if side > 0.0 else TURN * (119 - k) / 120
            twist(sim, bodies[-1], angle)
            sim.step()
        sigma = side * most + (sigma - side * most) * math.exp(-kappa / TAU)
        found = sim.solver.joint_sigma_prev.numpy()[rods_of(sim), 2]
        assert found == pytest.approx(sigma, abs=0.01 * most)
    assert "of type ROD with Dahl friction" in sim.solver.effects["dahl"].why
    sim.solver.reset(sim.state)
    assert not sim.solver.joint_sigma_prev.numpy().any()


def bent(make_solver, torques: np.ndarray, **settings: object) -> np.ndarray:
    """Bend of a cable of two segments [rad] at the end of ramps between these torques [N m]."""
    builder, bodies = cable(tip_is_held=False, segments=2)
    # a segment of 36 g would be turned over within a step by such torques
    tip = bodies[-1]
    builder.body_mass[tip], builder.body_inv_mass[tip] = 1.0, 1.0
    builder.body_inertia[tip] = wp.mat33(np.diag((0.01,) * 3))
    builder.body_inv_inertia[tip] = wp.mat33(np.diag((100.0,) * 3))
    sim = Simulation(builder, collide=False, make_solver=make_solver, **settings)
    found, before = [], 0.0
    for torque in torques:
        for share in np.linspace(0.0, 1.0, 240):
            wrench = np.zeros((len(bodies), 6), dtype=np.float32)
            wrench[tip, 4] = before + share * (torque - before)
            sim.state.body_f.assign(wrench)
            sim.step()
        before = torque
        kappa = sim.solver.joint_kappa_prev.numpy()[rods_of(sim)[0]]
        found.append(float(np.linalg.norm(kappa[:2])))
    return np.array(found)


def test_the_loop_of_a_bend_is_that_of_vbd_and_of_the_closed_form() -> None:
    """Torque up to 20 N m, back to none, up again: KE k + sigma(k) = T, found by bisection. Within
    1 % of the largest bend of both; what is left at no torque is a third of that."""
    torques = np.array([20.0, 0.0, 20.0])
    most, kappa, sigma, expected = KE * EPS, 0.0, 0.0, []
    for torque, side in zip(torques, (1.0, -1.0, 1.0), strict=True):
        ends = [kappa, kappa + side * 0.2]
        for _ in range(60):
            k = 0.5 * (ends[0] + ends[1])
            s = side * most + (sigma - side * most) * math.exp(-abs(k - kappa) / TAU)
            ends[int((KE * k + s - torque) * side > 0.0)] = k
        kappa, sigma = k, s
        expected.append(k)
    ours = bent(SolverAVBD, torques)
    assert ours == pytest.approx(expected, abs=0.01 * max(expected))
    theirs = bent(SolverVBD, torques, iterations=30)
    assert ours == pytest.approx(theirs, abs=0.02 * max(expected))


def sink_of_a_cantilever(example, is_frictional: bool) -> np.ndarray:
    """How far the tip of the example's cable sinks [m], at the end of each frame.

    Small angles: a force F at the COM of the last link asks F x of the hinge x before it, whatever
    the others do, and each hinge has a law of its own, c dkappa/dt + k kappa + sigma = F x.
    """
    stiffness, damping = example.BEND_STIFFNESS, example.BEND_DAMPING
    lever = example.SEGMENT_LENGTH * (np.arange(1, example.NUM_ELEMENTS) - 0.5)
    node = lever - 0.5 * example.SEGMENT_LENGTH
    most = stiffness * example.DAHL_EPS_MAX * is_frictional
    kappa, sigma, sink, h = np.zeros_like(lever), np.zeros_like(lever), [], example.sim_dt
    for force in example.history_force:
        for _ in range(example.sim_substeps):
            now, torque = kappa, sigma
            for _ in range(4):  # friction is some hundredth of what damping is in so short a step
                now = (force * lever - torque + damping * kappa / h) / (stiffness + damping / h)
                end = most * np.sign(now - kappa)
                torque = end + (sigma - end) * np.exp(-np.abs(now - kappa) / example.DAHL_TAU)
            kappa, sigma = now, torque
        sink.append(float(kappa @ node))
    return np.array(sink)


@pytest.mark.long
@pytest.mark.parametrize("force", [0.5, 3.65], ids=["as authored", "as far as vbd bends"])
def test_loops_of_newton_s_example_follow_closed_forms(force: float) -> None:
    """``cable_dahl_hysteresis`` swapped: all along, bends within 1 % of the largest, where small
    angles end (sin x = x to 0.4 % at 0.15), and torques of twists within 0.2 %.

    With 3.65 N the cable bends as far as it does in SolverVBD with the example's ten iterations and
    its 0.5 N, and the example's own test passes. With the authored 0.5 N it asks for a bend of
    30 mm, where the authored stiffness gives 20.
    """
    simulation = ExampleSimulation("cable_dahl_hysteresis", Request())
    example = simulation._example
    example.TIP_FORCE_MAX = force
    for _ in range(simulation.frames):
        simulation.advance()
    for name, is_frictional in (("bend_elastic", False), ("bend_dahl", True)):
        expected = sink_of_a_cantilever(example, is_frictional)
        found = np.array(example.history_bend_down[name])
        assert found == pytest.approx(expected, abs=0.01 * expected.max())
    kappa, sigma, most, torques = 0.0, 0.0, KE * EPS, []
    for angle in np.array(example.history_twist_command) / (example.NUM_ELEMENTS - 1):
        end = most * np.sign(angle - kappa)
        sigma = end + (sigma - end) * math.exp(-abs(angle - kappa) / TAU)
        kappa = angle
        torques.append(KE * kappa + sigma)
    # the example's mean counts the joint at the root, which bears nothing
    expected = np.array(torques) * (1.0 - 1.0 / example.NUM_ELEMENTS)
    found = np.array(example.history_twist_reaction["twist_dahl"])
    assert found == pytest.approx(expected, abs=0.002 * expected.max())
    verdict = simulation.verdict()
    if force > 3.0:
        assert verdict == "passed"
    else:
        assert verdict is not None and "bend elastic barely deflected" in verdict
        example._assert_subspace_containment(example.analysis_metrics())


def test_friction_that_makes_no_sense_is_refused() -> None:
    builder, _ = cable(tip_is_held=False)
    model = builder.finalize(device="cpu")
    model.vbd.dahl_tau.fill_(math.nan)
    with pytest.raises(ValueError, match=r"model.vbd.dahl_tau\[\d+\]"):
        SolverAVBD(model)


def test_a_cable_that_a_loop_closes_has_friction() -> None:
    """Its tip is tied to the world by a joint outside of its tree, and its middle is pushed aside.

    The tie stays closed to rounding, and friction ends within its bound.
    """
    builder, bodies = cable(tip_is_held=False)
    builder.add_joint_ball(
        parent=-1,
        child=bodies[-1],
        parent_xform=builder.body_q[bodies[-1]],
        child_xform=wp.transform_identity(),
    )
    sim = Simulation(builder)
    start = sim.pose[bodies[-1], :3].copy()
    for _ in range(48):
        sim.push(bodies[1], (0.0, 1500.0, 0.0))
        sim.step()
    np.testing.assert_allclose(sim.pose[bodies[-1], :3], start, atol=1e-5)
    assert sim.pose[bodies[1], 1] > 1e-3
    sigma = sim.solver.joint_sigma_prev.numpy()
    assert 0.0 < np.abs(sigma).max() <= KE * EPS * (1.0 + 1e-5)
