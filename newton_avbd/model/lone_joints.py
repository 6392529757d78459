# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints of no articulation that hold a lone body to the world, as Newton allows.

Newton's ``eval_fk`` and ``eval_mass_matrix`` leave them out.
"""

import newton
import numpy as np
import warp as wp

from ..rows.joint import KINDS

_BALL, _FREE = int(newton.JointType.BALL), int(newton.JointType.FREE)
_KNOWN = (*(int(kind) for kind, known in KINDS.items() if known.has_axes), _BALL, _FREE)


def lone_joints(model: newton.Model) -> list[int]:
    """The joints; those that close loops, or whose bodies carry others, are not among them."""
    if model.joint_count == 0:
        return []
    child, parent = model.joint_child.numpy(), model.joint_parent.numpy()
    has_owner = model.joint_articulation.numpy() >= 0
    _, first = np.unique(child, return_index=True)
    is_tree = np.zeros(model.joint_count, dtype=bool)
    is_tree[first] = True
    is_lone = is_tree & ~has_owner & (parent < 0) & np.isin(model.joint_type.numpy(), _KNOWN)
    is_lone &= ~np.isin(child, [*child[has_owner], *parent[is_tree]])
    return np.flatnonzero(is_lone).tolist()


def place_lone(model: newton.Model, state: newton.State) -> None:
    """Puts the bodies of such joints where the joint coordinates of a state say."""
    if not (joints := lone_joints(model)):
        return
    poses = state.body_q.numpy().copy()
    for joint in joints:
        poses[model.joint_child.numpy()[joint]] = _pose(model, joint, state.joint_q.numpy())
    state.body_q.assign(poses)


def _pose(model: newton.Model, joint: int, joint_q: np.ndarray) -> wp.transform:
    """Where the coordinates put the body of a joint."""
    first = model.joint_q_start.numpy()[joint]
    q = joint_q[first : model.joint_q_start.numpy()[joint + 1]].tolist()
    kind = model.joint_type.numpy()[joint]
    moved = wp.transform_identity()
    if kind == _FREE:
        moved = wp.transform(*q)
    elif kind == _BALL:
        moved = wp.transform(wp.vec3(), wp.quat(*q))
    else:
        linear = model.joint_dof_dim.numpy()[joint, 0]
        for i, (axis, at) in enumerate(zip(_axes(model, joint), q, strict=True)):
            direction = wp.vec3(*axis)
            if i < linear:
                moved = moved * wp.transform(at * direction, wp.quat_identity())
            else:
                moved = moved * wp.transform(wp.vec3(), wp.quat_from_axis_angle(direction, at))
    ends = [wp.transform(*getattr(model, f"joint_X_{end}").numpy()[joint]) for end in "pc"]
    return ends[0] * moved * wp.transform_inverse(ends[1])


def _axes(model: newton.Model, joint: int) -> np.ndarray:
    """Axes of a joint in the frame of its parent's anchor, shape (axes, 3)."""
    starts = model.joint_qd_start.numpy()
    return model.joint_axis.numpy()[starts[joint] : starts[joint + 1]]


def lone_rates(model: newton.Model, joint: int, body_q: np.ndarray) -> np.ndarray:
    """Velocities of the body of such a joint by unit rates of its coordinates.

    Args:
        model: The model.
        joint: The joint.
        body_q: Poses of bodies in which the axes of the joint are at zero.

    Returns:
        Of the COM, and angular, world frame, shape (degrees of freedom, 6).
    """
    kind, body = model.joint_type.numpy()[joint], model.joint_child.numpy()[joint]
    turn = wp.transform_get_rotation(wp.transform(*model.joint_X_p.numpy()[joint]))
    base = np.array(wp.quat_to_matrix(turn)).reshape(3, 3)
    if kind == _FREE:
        # of the COM itself
        return np.kron(np.eye(2), base.T)
    anchor = wp.vec3(*model.joint_X_c.numpy()[joint, :3])
    arm = wp.quat_rotate(
        wp.transform_get_rotation(wp.transform(*body_q[body])),
        wp.vec3(*model.body_com.numpy()[body]) - anchor,
    )
    linear = 0 if kind == _BALL else model.joint_dof_dim.numpy()[joint, 0]
    axes = (np.eye(3) if kind == _BALL else _axes(model, joint)) @ base.T
    turned = axes * (np.arange(len(axes)) >= linear)[:, None]
    return np.hstack([axes - turned + np.cross(turned, np.array(arm)), turned])


def lone_matrix(model: newton.Model, joint: int, body_q: np.ndarray) -> np.ndarray:
    """Mass matrix of the degrees of freedom of such a joint, armature of joints included.

    Args:
        model: The model.
        joint: The joint.
        body_q: Poses of bodies in which the axes of the joint are at zero.
    """
    body, starts = model.joint_child.numpy()[joint], model.joint_qd_start.numpy()
    rates = lone_rates(model, joint, body_q)
    rotation = np.array(wp.quat_to_matrix(wp.quat(*body_q[body, 3:]))).reshape(3, 3)
    inertia = rotation @ model.body_inertia.numpy()[body].astype(float) @ rotation.T
    moved, turned = rates[:, :3], rates[:, 3:]
    matrix = float(model.body_mass.numpy()[body]) * moved @ moved.T + turned @ inertia @ turned.T
    return matrix + np.diag(model.joint_armature.numpy()[starts[joint] : starts[joint + 1]])
