# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Armature: inertia reflected to a joint's coordinate, and to nothing else."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import Array
from joint_scenes import WORLD, add_hinge_chain, add_link, set_coordinates, transform
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD

pytestmark = pytest.mark.usefixtures("shared_kernels")

Axis = newton.ModelBuilder.JointDofConfig
DT = 1.0 / 2000.0


def chain(armature: float) -> newton.ModelBuilder:
    """Three rods that hang and swing, with armatures that rival their inertia."""
    builder = newton.ModelBuilder()
    add_hinge_chain(builder, 3, length=0.4, masses=[1.0, 0.5, 0.2], damping=0.02)
    builder.joint_armature[:] = [0.2 * armature, 0.5 * armature, armature]
    builder.joint_q[:] = [0.3, -0.4, 0.5]
    return builder


def gimbal(armature: float) -> newton.ModelBuilder:
    """A body on three Euler axes, with a slider before them, that moves from the start on."""
    builder = newton.ModelBuilder()
    body = add_link(builder, mass=1.0)
    joint = builder.add_joint_d6(
        WORLD,
        body,
        linear_axes=[Axis(axis=(1.0, 0.0, 0.0), armature=5.0 * armature)],
        angular_axes=[
            Axis(axis=axis, armature=most * armature)
            for axis, most in zip(np.eye(3), (0.5, 1.0, 0.7), strict=True)
        ],
        child_xform=transform((0.1, 0.05, 0.2)),
    )
    builder.add_articulation([joint])
    set_coordinates(builder, joint, (0.0, 0.3, 0.4, -0.2), (0.2, 0.5, -0.8, 1.1))
    return builder


def path(builder: newton.ModelBuilder, solver: type, **settings: object) -> Array:
    """Joint coordinates over 0.25 s."""
    model = builder.finalize(device="cpu")
    newton.eval_fk(model, model.joint_q, model.joint_qd, model)
    state, following = model.state(), model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    stepper = solver(model, **settings)
    q, qd = wp.zeros_like(model.joint_q), wp.zeros_like(model.joint_qd)
    control = model.control()
    frames = []
    for _ in range(500):
        stepper.step(state, following, control, None, DT)
        state, following = following, state
        newton.eval_ik(model, state, q, qd)
        frames.append(q.numpy().astype(float))
    return np.array(frames)


@pytest.mark.parametrize("scene", [chain, gimbal])
def test_a_swing_with_armature_is_mujocos(scene: object) -> None:
    """Within 0.2 % of how far it swings; both are of first order in dt. Armature matters: 5 %."""
    ours = path(scene(0.1), SolverAVBD)
    theirs = path(scene(0.1), SolverMuJoCo, use_mujoco_cpu=True)
    swing = np.ptp(theirs, axis=0).max()
    assert np.abs(ours - theirs).max() < 2.0e-3 * swing
    assert np.abs(path(scene(0.0), SolverAVBD) - theirs).max() > 5.0e-2 * swing
