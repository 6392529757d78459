# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Swinging bodies keep the period and the amplitude that backward Euler gives them."""

import newton
import numpy as np
import pytest
from helpers import G, Simulation
from joint_scenes import (
    TENSOR,
    WORLD,
    add_link,
    anchor_gaps,
    coordinates,
    euler_period,
    set_coordinates,
    simulate,
    swing_period,
    transform,
)
from scipy.spatial.transform import Rotation

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "oblique": (1, 2, 0.8)}
FRAMES = {
    "aligned": (Rotation.identity(), Rotation.identity()),
    "parent turned": (Rotation.from_euler("xyz", [0.5, -0.8, 1.9]), Rotation.identity()),
    "both turned": (
        Rotation.from_euler("xyz", [0.5, -0.8, 1.9]),
        Rotation.from_euler("xyz", [-2.0, 0.4, 0.9]),
    ),
}
START = 0.05  # [rad]; lengthens a period by START^2 / 16, 1.6e-4 of it


def record_swing(sim: Simulation, steps: int, coordinate: int = 0) -> np.ndarray:
    """A joint coordinate over time."""
    angles = []
    for _ in range(steps):
        sim.step()
        angles.append(coordinates(sim)[0][coordinate])
    return np.array(angles)


@pytest.mark.parametrize("frames", FRAMES)
@pytest.mark.parametrize("direction", AXES)
def test_a_compound_pendulum_keeps_its_period_and_amplitude(direction: str, frames: str) -> None:
    """A body on a hinge, its COM beside both its origin and the hinge, anchor frames turned.

    The period is 2 pi sqrt(I / (m g l)) with the part of g across the axis, as backward Euler
    turns it (longer by (w dt)^2 / 3, 1e-4 of it). Bound 3e-4: the finite amplitude and the
    interpolation of crossings. Each step shrinks the amplitude by sqrt(1 + (w dt)^2), to 0.85 of
    it over these three swings; 1 % of that is what the nonlinear terms may take.
    """
    axis = np.array(AXES[direction]) / np.linalg.norm(AXES[direction])
    turn_p, turn_c = FRAMES[frames]
    mass, arm = 2.0, 0.4
    down = np.array([0.0, 0.0, -G]) + G * axis[2] * axis
    pull = np.linalg.norm(down)
    turn = turn_p * turn_c.inv()  # of the body where the coordinate is 0
    anchor_c = np.array([0.1, -0.3, 0.2])
    builder = newton.ModelBuilder()
    body = add_link(builder, mass=mass, com=anchor_c + turn.inv().apply(arm * down / pull))
    joint = builder.add_joint_revolute(
        WORLD,
        body,
        parent_xform=transform((0.3, -0.2, 0.5), turn_p),
        child_xform=transform(anchor_c, turn_c),
        axis=tuple(turn_p.inv().apply(axis)),
    )
    builder.add_articulation([joint])
    set_coordinates(builder, joint, [START])
    sim = simulate(builder, scheme="euler")
    body_axis = turn.inv().apply(axis)
    inertia = body_axis @ TENSOR @ body_axis + mass * arm**2
    omega = np.sqrt(mass * pull * arm / inertia)
    angle = record_swing(sim, round(3.3 * 2 * np.pi / omega / sim.dt))
    assert swing_period(angle, sim.dt) == pytest.approx(euler_period(omega, sim.dt), rel=3.0e-4)
    three = round(3 * euler_period(omega, sim.dt) / sim.dt)
    decay = (1.0 + (omega * sim.dt) ** 2) ** (-0.5 * three)
    assert np.abs(angle[three - 20 : three + 20]).max() == pytest.approx(START * decay, rel=1.0e-2)
    assert anchor_gaps(sim).max() < 1.0e-6


def test_a_body_on_a_ball_joint_swings_in_each_plane_with_that_planes_period() -> None:
    """About x and about y the moments of inertia differ, so the two small swings get out of step.

    Bound 1e-3: the finite amplitude, and what the two swings of it disturb each other, which both
    go by its square; at the start of 0.02 rad it is 3e-4.
    """
    mass, arm, inertia = 2.0, 0.4, np.array([0.4, 0.05, 0.4])
    start = 0.02
    builder = newton.ModelBuilder()
    body = add_link(builder, mass=mass, inertia=inertia)
    turned = Rotation.from_euler("xyz", [0.5, -0.8, 1.9])
    joint = builder.add_joint_ball(
        WORLD,
        body,
        parent_xform=transform((0.0, 0.0, 1.0), turned),
        child_xform=transform((0.0, 0.0, arm), turned),
    )
    builder.add_articulation([joint])
    # the same turn seen from the anchor frame: that of the world is (START, START, 0)
    tilted = Rotation.from_rotvec(turned.inv().apply([start, start, 0.0]))
    set_coordinates(builder, joint, tilted.as_quat())
    sim = simulate(builder)
    tilt = []
    for _ in range(1200):
        sim.step()
        tilt.append(Rotation.from_quat(sim.pose[0, 3:]).as_rotvec())
    tilt = np.array(tilt)
    for k in (0, 1):
        omega = np.sqrt(mass * G * arm / (inertia[k] + mass * arm**2))
        expected = euler_period(omega, sim.dt)
        assert swing_period(tilt[:, k], sim.dt) == pytest.approx(expected, rel=1.0e-3)
    assert anchor_gaps(sim).max() < 1.0e-6


def test_a_slider_on_a_slope_falls_by_the_slope() -> None:
    """Along its axis a body gets g sin(slope), exactly as backward Euler sums it up; no rotation.

    The hinge frames are turned and the COM is beside the axis, which makes no difference.
    """
    turn_p, turn_c = FRAMES["both turned"]
    axis = np.array([0.6, 0.3, -0.7]) / np.linalg.norm([0.6, 0.3, -0.7])
    builder = newton.ModelBuilder()
    body = add_link(builder, com=(0.1, 0.2, -0.1))
    joint = builder.add_joint_prismatic(
        WORLD,
        body,
        parent_xform=transform((0.3, -0.2, 0.5), turn_p),
        child_xform=transform((0.1, -0.3, 0.2), turn_c),
        axis=tuple(turn_p.inv().apply(axis)),
    )
    builder.add_articulation([joint])
    sim = simulate(builder, scheme="euler")
    start = sim.pose[0]
    steps = 120
    sim.step(steps)
    fallen = 0.5 * steps * (steps + 1) * sim.dt**2 * -G * axis[2]
    assert sim.pose[0, :3] - start[:3] == pytest.approx(fallen * axis, abs=1.0e-5)
    turned = Rotation.from_quat(sim.pose[0, 3:]) * Rotation.from_quat(start[3:]).inv()
    assert turned.magnitude() < 1.0e-6


@pytest.mark.parametrize("kind", [None, "fixed", "prismatic", "universal", "planar"])
def test_a_pendulum_stays_in_its_plane_whatever_its_pose_rounds_to(kind: str | None) -> None:
    """Two rods of 2 m, 5 m up, and what hangs on them, at 1000 steps a second: none pushed aside.

    A pose in float32 rounds by 1e-7 m, and a solver that closes joints by what it reads off poses
    moves bodies by as much in a step: 1e-4 m/s. Bound 3e-5 m/s: by increments it is 1.8e-5.
    """
    builder = newton.ModelBuilder()
    across = Rotation.from_euler("z", -90, degrees=True)
    at, parent, joints = transform((0.0, 0.0, 5.0), across), WORLD, []
    for _ in range(2):
        link = add_link(builder, com=(1.0, 0.0, 0.0))
        joints.append(builder.add_joint_revolute(parent, link, parent_xform=at, axis=(0, 1, 0)))
        at, parent = transform((2.0, 0.0, 0.0)), link
    axes = {name: newton.ModelBuilder.JointDofConfig(axis=name) for name in "XYZ"}
    ends = {"parent": parent, "child": add_link(builder), "parent_xform": at} if kind else {}
    if kind == "fixed":
        joints.append(builder.add_joint_fixed(**ends))
    elif kind == "prismatic":
        joints.append(builder.add_joint_prismatic(axis=(1, 0, 0), **ends))
    elif kind == "universal":
        joints.append(builder.add_joint_d6(angular_axes=[axes["Y"], axes["X"]], **ends))
    elif kind == "planar":
        plane = [axes["X"], axes["Z"]]
        joints.append(builder.add_joint_d6(linear_axes=plane, angular_axes=[axes["Y"]], **ends))
    builder.add_articulation(joints)
    sim = simulate(builder, dt=1.0e-3)
    fastest = 0.0
    for _ in range(1000):
        sim.step()
        fastest = max(fastest, np.abs(sim.velocity[:, 0]).max())
    assert fastest < 3.0e-5
    assert np.abs(sim.velocity[:, 1:3]).max() > 1.0
