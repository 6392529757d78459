# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints of three axes whose middle one passes a right angle, where the outer two are parallel."""

import itertools

import newton
import numpy as np
import pytest
import warp as wp

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0
ORDERS = list(itertools.permutations(range(3)))
SPEEDS = (-20.0, -2.0, 2.0, 20.0)
LIMIT = 0.5


def hinged(blocks: str):
    """Bodies on D6 joints in all orders of axes, at 80 degrees, that turn either way."""
    builder = newton.ModelBuilder()
    config = newton.ModelBuilder.JointDofConfig
    for order, _ in itertools.product(ORDERS, SPEEDS):
        builder.begin_world()
        body = builder.add_link(mass=1.0, inertia=wp.mat33(np.diag([0.1, 0.2, 0.15])))
        axes = [
            config(axis=np.eye(3)[k].tolist(), limit_lower=-bound, limit_upper=bound)
            for k, bound in zip(order, (LIMIT, 3.0, LIMIT), strict=True)
        ]
        builder.add_articulation([builder.add_joint_d6(-1, body, angular_axes=axes)])
        builder.end_world()
    model = builder.finalize(device="cpu")
    model.set_gravity((0.0, 0.0, 0.0))
    q, qd = model.joint_q.numpy().reshape(-1, 3), model.joint_qd.numpy().reshape(-1, 3)
    speed = np.tile(SPEEDS, len(ORDERS))
    q[:] = np.stack([0.1 + 0.0 * speed, np.sign(speed) * 1.4, -0.05 + 0.0 * speed], axis=1)
    qd[:] = np.stack([0.02 * speed, speed, 0.01 * speed], axis=1)
    model.joint_q.assign(q.ravel())
    model.joint_qd.assign(qd.ravel())
    solver = SolverAVBD(model, update_joint_state=True, blocks=blocks)
    return model, solver


def energies(model: newton.Model, state: newton.State) -> np.ndarray:
    """Kinetic energy of each body [J]."""
    rotation = np.array(
        [
            np.array(wp.quat_to_matrix(wp.quat(*q))).reshape(3, 3)
            for q in state.body_q.numpy()[:, 3:]
        ]
    )
    velocity = state.body_qd.numpy()
    spin = np.einsum("nji,nj->ni", rotation, velocity[:, 3:])
    inertia = model.body_inertia.numpy()
    linear = 0.5 * model.body_mass.numpy() * np.sum(velocity[:, :3] ** 2, axis=1)
    return linear + 0.5 * np.einsum("ni,nij,nj->n", spin, inertia, spin)


@pytest.mark.parametrize(("blocks", "gain"), [("articulation", 1.0e-4), ("body", 5.0e-4)])
def test_middle_axis_goes_through_a_right_angle(blocks: str, gain: float) -> None:
    """The coordinates go on, the outer ones within their limits, and no step gains energy."""
    model, solver = hinged(blocks)
    state, after = model.state(), model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    known = model.joint_q.numpy().reshape(-1, 3)
    before = start = energies(model, state)
    most = np.abs(known[:, 1])
    # a body that turns at 2 rad/s takes 0.2 s from 80 to 103 degrees
    for _ in range(72):
        solver.step(state, after, None, None, DT)
        state, after = after, state
        q = state.joint_q.numpy().reshape(-1, 3)
        # one step at 20 rad/s is 0.083; the outer two may cross their limits' range, but not jump
        assert np.abs(q - known)[:, 1].max() < 0.12
        assert np.abs(q - known).max() < 2.0 * LIMIT + 0.01
        now = energies(model, state)
        # the gyroscopic term of a step; multipliers of joints outside of trees converge by a factor
        assert np.all(now <= before + gain * start)
        assert np.abs(q[:, [0, 2]]).max() < LIMIT + 1.0e-3
        most, known, before = np.maximum(most, np.abs(q[:, 1])), q, now
    # all of them have gone beyond the right angle
    assert most.min() > 1.65


def test_a_pose_that_is_written_takes_the_angles_within_the_limits() -> None:
    """(2, 1.9, 2) and (2 - pi, pi - 1.9, 2 - pi) are one pose: the second is nearer to the model's
    own angles, which are zero, and limits allow the first only."""
    model, _ = hinged("articulation")
    q = np.tile([2.0, 1.9, 2.0], (model.joint_count, 1)).astype(np.float32)
    model.joint_q.zero_()
    model.joint_limit_lower.assign((q - np.array([0.5, 4.0, 0.5])).ravel())
    model.joint_limit_upper.assign((q + np.array([0.5, 4.0, 0.5])).ravel())
    solver = SolverAVBD(model, update_joint_state=True)
    state, after = model.state(), model.state()
    state.joint_q.assign(q.ravel())
    state.joint_qd.zero_()
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    for _ in range(3):
        solver.step(state, after, None, None, DT)
        state, after = after, state
    # at rest without gravity: it stays, to rounding of orientations divided by the cosine
    assert np.abs(state.joint_q.numpy().reshape(-1, 3) - q).max() < 1.0e-5


def swing(axes: list[tuple[float, float, float]], as_chain: bool) -> np.ndarray:
    """Poses of a body that swings for half a second from three hinges, as one joint or as three."""
    builder = newton.ModelBuilder()
    joints, parent = [], -1
    inertia = wp.mat33(np.diag([0.02, 0.03, 0.04]))
    body = builder.add_link(mass=1.0, inertia=inertia, com=wp.vec3(0.2, 0.1, -0.3))
    if as_chain:
        for axis in axes[:-1]:
            link = builder.add_link()
            joints.append(builder.add_joint_revolute(parent, link, axis=axis))
            parent = link
        joints.append(builder.add_joint_revolute(parent, body, axis=axes[-1]))
    else:
        config = [newton.ModelBuilder.JointDofConfig(axis=axis) for axis in axes]
        joints.append(builder.add_joint_d6(-1, body, angular_axes=config))
    builder.add_articulation(joints)
    model = builder.finalize(device="cpu")
    model.joint_q.assign([0.3, 1.1, -0.4])
    state, after = model.state(), model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    solver = SolverAVBD(model)
    poses = []
    for _ in range(500):
        solver.step(state, after, None, None, 1.0e-3)
        state, after = after, state
        poses.append(state.body_q.numpy()[body].copy())
    return np.array(poses)


@pytest.mark.parametrize(
    "axes", [[(0, 0, 1), (1, 0, 0), (0.3, 1, 0)], [(0, 0, 1), (1, 0, 0), (0, 1, 0)]]
)
def test_three_hinges_in_one_joint_are_a_chain_of_hinges(axes) -> None:
    """Axes that are square to each other, and the skew ones of the scapulae of dm_control's dog.

    The links between have a millionth of the mass. Quaternions, so to 1e-4 rad.
    """
    one, chain = swing(axes, as_chain=False), swing(axes, as_chain=True)
    assert np.abs(one[:, :3] - one[0, :3]).max() < 1.0e-6  # the body's origin is the anchor
    assert np.linalg.norm(one[-1, 3:] - one[0, 3:]) > 0.3  # and it swings
    assert np.abs(one - chain).max() < 5.0e-5
