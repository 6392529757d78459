# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints that break in one large world, beside the kernel that solves a world in one thread."""

from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, G, Simulation, add_box, add_ground, add_sphere, surface
from joint_scenes import WORLD, add_link, transform

from newton_avbd import SolverAVBD


def breakable(**settings: Any) -> newton.ModelBuilder:
    """A box on the ground, so that there are contacts, and room for joints that break."""
    builder = newton.ModelBuilder(**settings)
    SolverAVBD.register_custom_attributes(builder)
    add_ground(builder)
    add_box(builder, (-3.0, 0.0, 0.25))
    return builder


def limit(force: float) -> dict[str, Any]:
    """What a joint is to be added with to break at a force [N]."""
    return {"custom_attributes": {"avbd:joint_break_force": force}}


def add_chain(builder: newton.ModelBuilder, y: float, share: float) -> int:
    """Three links of 1 kg that hang; the first joint holds ``share`` of their weight."""
    parent, place, joints = WORLD, transform((0.0, y, 3.0)), []
    for k in range(3):
        link = add_link(builder, xform=transform((0.0, y, 2.7 - 0.6 * k)))
        ends = {"parent_xform": place, "child_xform": transform((0.0, 0.0, 0.3))}
        most = limit(share * 3.0 * G) if k == 0 else {}
        joints.append(builder.add_joint_ball(parent, link, **ends, **most))
        parent, place = link, transform((0.0, 0.0, -0.3))
    builder.add_articulation(joints)
    return joints[0]


def add_bridge(builder: newton.ModelBuilder, y: float, share: float) -> int:
    """A body of 1 kg on two hinges, of which one closes a loop and holds ``share`` of its half."""
    body = add_link(builder, xform=transform((0.0, y, 3.0)))
    joints = []
    for x in (-0.5, 0.5):
        ends = {"parent_xform": transform((x, y, 3.0)), "child_xform": transform((x, 0.0, 0.0))}
        most = limit(share * 0.5 * G) if x > 0.0 else {}
        joints.append(builder.add_joint_revolute(WORLD, body, axis=(0.0, 1.0, 0.0), **ends, **most))
    builder.add_articulation(joints[:1])
    return joints[1]


@pytest.mark.filterwarnings("ignore:.*another joint already connects.*")
def test_joints_break_at_what_they_carry_and_as_one_thread_breaks_them() -> None:
    """Of chains and bridges those that hold 0.98 of the load; then they move as there."""
    simulations = []
    for parallel in ("bodies", "worlds"):
        builder = breakable()
        weak = []
        for i, share in enumerate((0.98, 1.02)):
            joints = [add_chain(builder, 2.0 * i, share), add_bridge(builder, 2.0 * i + 1.0, share)]
            weak += joints if share < 1.0 else []
        simulations.append(Simulation(builder, parallel=parallel))
    colored, serial = simulations
    for _ in range(60):
        colored.step()
        serial.step()
        broken = colored.solver.status.broken_joints
        np.testing.assert_array_equal(broken, serial.solver.status.broken_joints)
        np.testing.assert_allclose(colored.pose, serial.pose, atol=2e-5)
    assert list(broken) == weak
    assert colored.pose[1:4, 2].max() < 2.7 - 0.3 * G * 0.25**2  # the first chain fell
    colored.solver.reset(colored.state)
    assert not colored.solver.status.broken_joints.size


@pytest.mark.parametrize(("share", "breaks"), [(0.98, True), (1.02, False)])
def test_a_weld_breaks_in_an_impact(share: float, breaks: bool) -> None:
    """A ball that stays on the box it hits; the weld drags another along: M v m/(m + 2 M)/h."""
    v, dt = 3.0, 1.0 / 240.0
    builder = breakable(gravity=NO_GRAVITY)
    boxes = []
    for i in range(2):
        boxes.append(
            add_link(builder, xform=transform((0.5 * i, 0.0, 3.0)), mass=0.0, inertia=[0] * 3)
        )
        builder.add_shape_box(boxes[-1], hx=0.25, hy=0.25, hz=0.25, cfg=surface())
    ball = add_sphere(builder, (-0.5, 0.0, 3.0), 0.25)
    builder.body_qd[ball] = wp.spatial_vector(v, 0.0, 0.0, 0.0, 0.0, 0.0)
    mass, other = builder.body_mass[ball], builder.body_mass[boxes[0]]
    most = share * other * v * mass / (mass + 2.0 * other) / dt
    free = builder.add_joint_free(boxes[0])
    weld = builder.add_joint_fixed(*boxes, parent_xform=transform((0.5, 0.0, 0.0)), **limit(most))
    builder.add_articulation([free, weld])
    simulation = Simulation(builder, parallel="bodies", dt=dt)
    simulation.step(5)
    assert list(simulation.solver.status.broken_joints) == ([weld] if breaks else [])
