# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Compliant limits: the spring and damper that the model authors, with and without contacts."""

import newton
import numpy as np
import pytest
from helpers import G, Simulation
from joint_scenes import WORLD, add_link, anchor_gaps, coordinates, simulate, transform

from newton_avbd import SolverAVBD


def slider(ke: float, kd: float) -> newton.ModelBuilder:
    """1 kg on a vertical slide whose lower limit is at 0."""
    builder = newton.ModelBuilder()
    link = add_link(builder)
    joint = builder.add_joint_prismatic(
        WORLD, link, axis=(0, 0, 1), limit_lower=0.0, limit_upper=1.0, limit_ke=ke, limit_kd=kd
    )
    builder.add_articulation([joint])
    return builder


@pytest.mark.parametrize("kd", [1.0, 60.0])
def test_a_weight_settles_on_a_limit_as_on_a_spring_and_damper(kd: float) -> None:
    """v' = (v - h (g + ke q)) / (1 + h kd + h^2 ke) while it is beyond, m = 1 kg."""
    ke = 500.0
    sim = simulate(slider(ke, kd), compliant_contacts=True, scheme="euler")
    h, q, v = sim.dt, 0.0, 0.0
    for _ in range(480):
        sim.step()
        free = v - h * G
        v = free if q + h * free > 0.0 else (v - h * (G + ke * q)) / (1.0 + h * kd + h * h * ke)
        q += h * v
        assert coordinates(sim)[0][0] == pytest.approx(q, abs=2e-5)
    if kd > 10.0:
        assert q == pytest.approx(-G / ke, rel=1e-3)


@pytest.mark.parametrize("kind", ["revolute", "d6", "universal"])
def test_an_arm_settles_on_its_limit_as_on_a_spring(kind: str) -> None:
    """ke q = m g a cos(q), with the COM of 1 kg 0.3 m beside the hinge; within 0.1 %."""
    limit = {"limit_lower": 0.0, "limit_upper": 2.0, "limit_ke": 20.0, "limit_kd": 3.0}
    axis = newton.ModelBuilder.JointDofConfig(axis=(0, -1, 0), **limit)
    other = newton.ModelBuilder.JointDofConfig(axis=(0, 0, 1))
    builder = newton.ModelBuilder()
    link = add_link(builder, com=(0.3, 0.0, 0.0))
    if kind == "revolute":
        joint = builder.add_joint_revolute(WORLD, link, axis=(0, -1, 0), **limit)
    else:
        axes = [axis] if kind == "d6" else [axis, other]
        joint = builder.add_joint_d6(WORLD, link, angular_axes=axes)
    builder.add_articulation([joint])
    sim = simulate(builder, compliant_contacts=True)
    sim.run(3.0)
    q = coordinates(sim)[0][0]
    assert 20.0 * q == pytest.approx(-G * 0.3 * np.cos(q), rel=1e-3)


def test_the_same_limit_is_hard_otherwise() -> None:
    sim = simulate(slider(500.0, 1.0))
    sim.step(240)
    assert abs(coordinates(sim)[0][0]) < 1e-6


def test_a_step_without_contacts_does_not_harden_limits() -> None:
    """A model with shapes that can touch, stepped without contacts."""
    builder = slider(500.0, 60.0)
    builder.add_shape_box(0, hx=0.1, hy=0.1, hz=0.1, cfg=builder.ShapeConfig(density=0.0))
    builder.add_ground_plane()
    model = builder.finalize()
    solver = SolverAVBD(model, compliant_contacts=True)
    states = [model.state(), model.state()]
    for _ in range(480):
        solver.step(*states, None, None, 1 / 240)
        states.reverse()
    assert states[0].body_q.numpy()[0, 2] == pytest.approx(-G / 500.0, rel=1e-3)


def test_an_open_joint_closes_also_where_contacts_are_compliant() -> None:
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    link = add_link(builder)
    joint = builder.add_joint_ball(WORLD, link, child_xform=transform((0.0, 0.0, 0.1)))
    builder.add_articulation([joint])
    sim: Simulation = simulate(builder, compliant_contacts=True)
    pose = sim.state.body_q.numpy()
    pose[0, 0] += 0.01
    sim.state.body_q.assign(pose)
    sim.step(2)
    assert anchor_gaps(sim).max() < 1e-6
    np.testing.assert_allclose(sim.velocity, 0.0, atol=1e-5)
