# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Measures of joints agree with what can be worked out by hand."""

import math

import newton
import numpy as np
import pytest
import warp as wp

from newton_avbd.measure.joints import JointProbe, Joints

X, Y, Z = np.eye(3)

# Frames are kept in float32, near 1.
ROUNDING = 3.0e-7


def turn(axis: np.ndarray, angle: float) -> wp.quat:
    return wp.quat_from_axis_angle(wp.vec3(*axis), angle)


def dof(axis: np.ndarray, lower: float = -1e10, upper: float = 1e10):
    return newton.ModelBuilder.JointDofConfig(
        axis=wp.vec3(*axis), limit_lower=lower, limit_upper=upper
    )


def joint(kind: str, **options) -> Joints:
    """A joint between the world, at (0, 0, 1) turned a quarter about z, and a body at (1, 0, 0).

    The joint's x axis so is the world's y, and its y axis the world's -x.
    """
    builder = newton.ModelBuilder()
    body = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)))
    index = getattr(builder, f"add_joint_{kind}")(
        parent=-1,
        child=body,
        parent_xform=wp.transform(wp.vec3(0.0, 0.0, 1.0), turn(Z, 0.5 * math.pi)),
        child_xform=wp.transform(wp.vec3(1.0, 0.0, 0.0), wp.quat_identity()),
        **options,
    )
    builder.add_articulation([index])
    return Joints.of(builder.finalize(device="cpu"))


def pose(offset: np.ndarray, *turns: wp.quat) -> np.ndarray:
    """Pose of the body with its anchor ``offset``, in the joint's frame, away from the world's.

    ``turns`` are those of the joint, intrinsic: each about an axis that those before carry along.
    """
    rotation = turn(Z, 0.5 * math.pi)
    anchor = np.array([0.0, 0.0, 1.0]) + wp.quat_rotate(rotation, wp.vec3(*offset))
    for step in turns:
        rotation = wp.mul(rotation, step)
    origin = anchor - wp.quat_rotate(rotation, wp.vec3(1.0, 0.0, 0.0))
    return np.array([[*origin, *rotation]])


@pytest.mark.parametrize(
    ("kind", "options", "locked"),
    [
        ("fixed", {}, 0.13),
        ("ball", {}, 0.13),
        ("revolute", {"axis": X}, 0.13),
        # 0.12 of the offset (0.03, 0.04, 0.12) lies along the axis, the rest across it.
        ("prismatic", {"axis": Z}, 0.05),
        ("d6", {"linear_axes": [dof(X), dof(Z)]}, 0.04),
        ("d6", {"angular_axes": [dof(Y)]}, 0.13),
    ],
)
def test_separation_is_the_offset_across_what_slides(kind, options, locked) -> None:
    joints = joint(kind, **options)
    assert joints.separation(pose(np.zeros(3))) == pytest.approx([0.0], abs=ROUNDING)
    apart = pose(np.array([0.03, 0.04, 0.12]), turn(Y, 0.7))
    assert joints.separation(apart) == pytest.approx([locked], abs=ROUNDING)


@pytest.mark.parametrize(
    ("kind", "options", "turns", "off"),
    [
        ("fixed", {}, (turn(X, 3.0),), 3.0),
        ("fixed", {}, (turn(X, 4.0),), 2.0 * math.pi - 4.0),
        ("prismatic", {"axis": X}, (turn(Y, -0.2),), 0.2),
        ("ball", {}, (turn(X, 1.0), turn(Y, 1.0)), 0.0),
        ("revolute", {"axis": Y}, (turn(Y, 2.5),), 0.0),
        # Tilted by 0.1 whatever it has turned about its axis before or after.
        ("revolute", {"axis": Y}, (turn(Y, 2.5), turn(X, 0.1), turn(Y, 1.0)), 0.1),
        ("d6", {"angular_axes": [dof(X), dof(Y)]}, (turn(X, 0.8), turn(Y, -1.2)), 0.0),
        # Between the two comes the locked axis, x cross y.
        ("d6", {"angular_axes": [dof(X), dof(Y)]}, (turn(X, 0.8), turn(Z, 0.3), turn(Y, 2.0)), 0.3),
        ("d6", {"angular_axes": [dof(X), dof(Z), dof(Y)]}, (turn(X, 1.0), turn(Y, 0.4)), 0.0),
    ],
)
def test_misalignment_is_the_turn_about_what_is_locked(kind, options, turns, off) -> None:
    found = joint(kind, **options).misalignment(pose(np.zeros(3), *turns))
    assert found == pytest.approx([off], abs=2.0 * ROUNDING)


@pytest.mark.parametrize(
    ("kind", "options", "offset", "turns", "past"),
    [
        ("prismatic", {"axis": Z, "limit_lower": -0.1, "limit_upper": 0.2}, 0.25 * Z, (), 0.05),
        ("prismatic", {"axis": Z, "limit_lower": -0.1, "limit_upper": 0.2}, -0.4 * Z, (), 0.3),
        ("prismatic", {"axis": Z, "limit_lower": -0.1, "limit_upper": 0.2}, 0.1 * Z, (), 0.0),
        ("revolute", {"axis": X, "limit_lower": -1.0, "limit_upper": 2.0}, 0 * X, (3.0,), 1.0),
        ("revolute", {"axis": X, "limit_lower": -1.0, "limit_upper": 2.0}, 0 * X, (-1.5,), 0.5),
        # Half a turn and more is a turn the other way.
        ("revolute", {"axis": X, "limit_lower": -1.0, "limit_upper": 2.0}, 0 * X, (5.0,), 0.2832),
        # Beyond a limit near half a turn the angle of the pose has the other sign.
        ("revolute", {"axis": X, "limit_lower": -3.14, "limit_upper": 1.0}, 0 * X, (3.12,), 0.0232),
        # Limits of more than a turn cannot be judged by a pose.
        ("revolute", {"axis": X, "limit_lower": -9.0, "limit_upper": -8.0}, 0 * X, (1.0,), 0.0),
    ],
)
def test_limit_violation_is_the_way_past_it(kind, options, offset, turns, past) -> None:
    joints = joint(kind, **options)
    found = joints.limit_violation(pose(offset, *(turn(X, angle) for angle in turns)))
    assert found == pytest.approx([past], abs=2.0e-5)


@pytest.mark.parametrize(
    "axes",
    [
        (X, Y),
        (X, Z),
        (X, 0.6 * X - 0.8 * Z),
        (X, Y, Z),
        (X, Z, Y),
        (Z, X, Y),
        (X, 0.6 * X + 0.8 * Y, 0.8 * Z - 0.6 * Y),
    ],
    ids=lambda axes: str(len(axes)),
)
def test_limits_hold_for_each_of_several_angles(axes) -> None:
    """Angles 0.3, -0.5, 0.7, of which the last is 0.1 past its limit, then the first 0.05."""
    angles = (0.3, -0.5, 0.7)[: len(axes)]
    body_q = pose(np.zeros(3), *(turn(a, q) for a, q in zip(axes, angles, strict=True)))
    free = [dof(a, -1.0, 1.0) for a in axes]
    assert joint("d6", angular_axes=free).limit_violation(body_q) == pytest.approx([0.0])
    off = joint("d6", angular_axes=free).misalignment(body_q)
    assert off == pytest.approx([0.0], abs=ROUNDING)
    last = [*free[:-1], dof(axes[-1], angles[-1] + 0.1, 1.0)]
    assert joint("d6", angular_axes=last).limit_violation(body_q) == pytest.approx([0.1], abs=1e-6)
    first = [dof(axes[0], -1.0, 0.25), *free[1:]]
    assert joint("d6", angular_axes=first).limit_violation(body_q) == pytest.approx(
        [0.05], abs=1e-6
    )


@pytest.mark.parametrize("last", [Z, -Z, 0.8 * Z - 0.6 * Y], ids=["right", "left", "skew"])
def test_rates_are_those_that_newton_makes_the_velocity_of(last) -> None:
    builder = newton.ModelBuilder()
    body = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)))
    axes = [dof(a) for a in (X, Y, last)]
    builder.add_articulation([builder.add_joint_d6(-1, body, angular_axes=axes)])
    model = builder.finalize(device="cpu")
    model.joint_q.assign([0.3, -0.5, 0.7])
    model.joint_qd.assign([1.0, 2.0, 3.0])
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    q, qd = state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
    found = Joints.of(model).rates(q, qd, np.zeros((1, 3)))
    assert found[0, 3:] == pytest.approx([1.0, 2.0, 3.0], abs=1.0e-5)


def test_joints_that_hold_nothing_are_left_out() -> None:
    builder = newton.ModelBuilder()
    free = builder.add_body(mass=1.0, inertia=wp.mat33(np.eye(3)))
    for enabled in (True, False):
        link = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)))
        hinge = builder.add_joint_revolute(-1, link, axis=X, enabled=enabled)
        builder.add_articulation([hinge])
    joints = Joints.of(builder.finalize(device="cpu"))
    assert free == 0 and joints.child.tolist() == [1]


def test_probe_keeps_the_worst_and_the_last_energy() -> None:
    builder = newton.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)))
    builder.add_articulation([builder.add_joint_ball(-1, link)])
    probe = JointProbe(builder.finalize(device="cpu"))
    assert probe.watching
    for height, energy in ((0.0, 4.0), (0.2, 5.0), (0.1, 3.0)):
        probe.watch(np.array([[0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0]]), energy)
    assert probe.worst.separation == pytest.approx(0.2)
    assert probe.worst.gain == pytest.approx(0.25)
    assert probe.worst.energy == 3.0


def test_a_run_that_failed_once_does_not_look_good_again() -> None:
    builder = newton.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)))
    builder.add_articulation([builder.add_joint_revolute(-1, link, axis=X)])
    probe = JointProbe(builder.finalize(device="cpu"))
    whole = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    for body_q, energy in ((whole, 1.0), (whole * np.nan, math.nan), (whole, 1.0)):
        probe.watch(body_q, energy)
    worst = probe.worst
    assert np.isnan([worst.separation, worst.misalignment, worst.gain]).all()


@pytest.mark.parametrize("last", [Z, -Z], ids=["right-handed", "left-handed"])
@pytest.mark.parametrize("pole", [0.5 * math.pi, -0.5 * math.pi])
def test_limits_at_the_pole_of_three_axes_are_those_of_the_sum(pole: float, last) -> None:
    """Outer angles of 0.4 and 0.3: what they come to together counts, whichever has turned."""
    up = math.copysign(1.0, pole) * last[2]
    body_q = pose(np.zeros(3), turn(X, 0.4), turn(Y, pole), turn(last, 0.3))
    body_q = body_q.astype(np.float32).astype(float)
    for passed in (0.0, 0.1):
        total = 0.4 + up * 0.3 - passed
        free = [dof(X, -1.0, total - 0.3), dof(Y, -2.0, 2.0), dof(last, -0.3, 0.3)]
        found = joint("d6", angular_axes=free).limit_violation(body_q)
        assert found == pytest.approx([passed], abs=1e-4)
