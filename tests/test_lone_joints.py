# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A joint of no articulation that holds a lone body to the world has an inertia along its axes."""

import newton
import numpy as np
import pytest
import warp as wp
from newton.solvers import SolverMuJoCo
from newton.solvers import mujoco as of_mujoco

from newton_avbd import SolverAVBD
from newton_avbd.model.inertia import reference_matrices, reference_moments, spring_state

Axis = newton.ModelBuilder.JointDofConfig
INERTIA = wp.mat33(0.3, 0.02, 0.0, 0.02, 0.4, 0.01, 0.0, 0.01, 0.5)
ENDS = {
    "parent_xform": wp.transform((0.3, -0.2, 0.5), wp.quat_rpy(0.4, -0.7, 1.1)),
    "child_xform": wp.transform((0.1, 0.2, -0.3), wp.quat_rpy(-0.5, 0.2, 0.8)),
}


def joints_of_each_type(is_lone: bool) -> newton.Model:
    """A body to each type of joint, at coordinates and rates that are not zero."""
    builder = newton.ModelBuilder()
    for kind in ("revolute", "prismatic", "d6", "ball", "free"):
        body = builder.add_link(mass=2.0, inertia=INERTIA, com=(0.2, -0.1, 0.3))
        add = getattr(builder, f"add_joint_{kind}")
        if kind == "d6":
            linear, angular = [Axis(axis="X")], [Axis(axis="Y", armature=0.2), Axis(axis="Z")]
            joint = add(-1, body, linear_axes=linear, angular_axes=angular, **ENDS)
        elif kind == "free":
            joint = add(body, **ENDS)
        else:
            joint = add(-1, body, **ENDS)
        if not is_lone:
            builder.add_articulation([joint])
    count = builder.joint_dof_count
    builder.joint_qd[:] = np.linspace(-1.0, 1.0, count).tolist()
    builder.joint_rest_q[:5] = [0.3, -0.2, 0.4, -0.5, 0.6]
    model = builder.finalize(device="cpu")
    assert model.articulation_count == (0 if is_lone else 5)
    return model


def test_its_matrix_and_its_motion_are_those_of_an_articulation() -> None:
    """Bound: float32."""
    lone, owned = joints_of_each_type(True), joints_of_each_type(False)
    matrices = [reference_matrices(model) for model in (lone, owned)]
    for (dofs, matrix), (of_dofs, expected) in zip(*matrices, strict=True):
        np.testing.assert_array_equal(dofs, of_dofs)
        np.testing.assert_allclose(matrix, expected, rtol=1.0e-5, atol=1.0e-6)
    moments = [
        reference_moments(model, lambda state: state.body_qd.numpy().ravel())
        for model in (lone, owned)
    ]
    np.testing.assert_allclose(*moments, atol=1.0e-6)
    poses = [spring_state(model).body_q.numpy() for model in (lone, owned)]
    np.testing.assert_allclose(*poses, atol=1.0e-6)


def hinges(builder: newton.ModelBuilder, count: int) -> list[int]:
    """Arms on hinges to the world."""
    inertia = wp.mat33(0.1, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1)
    found = []
    for i in range(count):
        link = builder.add_link(mass=1.0, inertia=inertia, com=(0.3, 0.0, 0.0))
        ends = {"parent_xform": wp.transform((float(i), 0.0, 0.0), wp.quat_identity())}
        found.append(builder.add_joint_revolute(-1, link, axis=(0.0, 1.0, 0.0), **ends))
    return found


def add_servo(builder: newton.ModelBuilder, joint: int) -> None:
    """A position actuator of damping ratio 1."""
    of_mujoco.add_actuator_general(
        builder,
        target=of_mujoco.ActuatorTarget.joint(joint),
        gainprm=[20.0],
        biastype="affine",
        biasprm=[0.0, -20.0, 1.0],
        custom_attributes={"mujoco:actuator_label": "servo"},
    )


def test_its_damping_ratio_damps() -> None:
    """As on the same arm in an articulation; it went 1.4 instead of 0.57 rad."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverMuJoCo.register_custom_attributes(builder)
    joints = hinges(builder, 2)
    builder.add_articulation(joints[:1])
    for joint in joints:
        add_servo(builder, joint)
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, update_joint_state=True)
    state, control = model.state(), model.control()
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    control.mujoco.ctrl.fill_(0.7)
    for _ in range(150):
        solver.step(state, state, control, None, 0.002)
    owned, lone = state.joint_q.numpy()
    assert lone == pytest.approx(owned, abs=1.0e-3)
    assert 0.5 < owned < 0.6


def test_a_damping_ratio_without_an_inertia_is_an_error_that_names_the_actuator() -> None:
    """A joint that closes a loop has none of its own."""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    joints = hinges(builder, 2)
    for joint in joints:
        builder.add_articulation([joint])
    ends = {"parent_xform": wp.transform((1.0, 0.0, 0.0), wp.quat_identity())}
    add_servo(builder, builder.add_joint_revolute(0, 1, axis=(0.0, 1.0, 0.0), **ends))
    with pytest.raises(ValueError, match=r"'servo'.*damping ratio.*unless it closes a loop"):
        SolverAVBD(builder.finalize(device="cpu"))
