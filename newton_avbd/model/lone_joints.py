# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints of no articulation that hold a lone body to the world, as Newton allows.

Newton's ``eval_fk`` and ``eval_mass_matrix`` leave them out.
"""

import newton
import numpy as np
import warp as wp

from ..rows.joint import KINDS
from .rotations import rotation_matrix

_BALL, _FREE = int(newton.JointType.BALL), int(newton.JointType.FREE)
_KNOWN = (*(int(kind) for kind, known in KINDS.items() if known.has_axes), _BALL, _FREE)


def _lone_joints(model: newton.Model) -> list[int]:
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


class LoneJoints:
    """Such joints of a model, whose arrays are read once."""

    def __init__(self, model: newton.Model) -> None:
        """Copies model arrays to the host, if there is such a joint."""
        self.joints = _lone_joints(model)
        if not self.joints:
            return
        self.child = model.joint_child.numpy()
        self._kind, self._linear = model.joint_type.numpy(), model.joint_dof_dim.numpy()[:, 0]
        self._frames = model.joint_X_p.numpy(), model.joint_X_c.numpy()
        self._axis, self._armature = model.joint_axis.numpy(), model.joint_armature.numpy()
        self._starts = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
        self._mass, self._com = model.body_mass.numpy(), model.body_com.numpy()
        self._inertia = model.body_inertia.numpy().astype(float)

    def place(self, state: newton.State) -> None:
        """Puts their bodies where the joint coordinates of a state say."""
        if not self.joints:
            return
        poses, coordinates = state.body_q.numpy().copy(), state.joint_q.numpy()
        for joint in self.joints:
            poses[self.child[joint]] = self._pose(joint, coordinates)
        state.body_q.assign(poses)

    def _pose(self, joint: int, coordinates: np.ndarray) -> wp.transform:
        """Where the coordinates of all joints put the body of a joint."""
        q = coordinates[self._starts[0][joint] : self._starts[0][joint + 1]].tolist()
        kind, moved = self._kind[joint], wp.transform_identity()
        if kind == _FREE:
            moved = wp.transform(*q)
        elif kind == _BALL:
            moved = wp.transform(wp.vec3(), wp.quat(*q))
        else:
            for i, (axis, at) in enumerate(zip(self._axis[self.dofs(joint)], q, strict=True)):
                direction = wp.vec3(*axis)
                if i < self._linear[joint]:
                    moved = moved * wp.transform(at * direction, wp.quat_identity())
                else:
                    moved = moved * wp.transform(wp.vec3(), wp.quat_from_axis_angle(direction, at))
        ends = [wp.transform(*frame[joint]) for frame in self._frames]
        return ends[0] * moved * wp.transform_inverse(ends[1])

    def dofs(self, joint: int) -> np.ndarray:
        """Degrees of freedom of a joint."""
        return np.arange(self._starts[1][joint], self._starts[1][joint + 1])

    def rates(self, joint: int, body_q: np.ndarray) -> np.ndarray:
        """Velocities of the body of such a joint by unit rates of its coordinates.

        Args:
            joint: The joint.
            body_q: Poses of bodies in which the axes of the joint are at zero.

        Returns:
            Of the COM, and angular, world frame, shape (degrees of freedom, 6).
        """
        kind, body = self._kind[joint], self.child[joint]
        base = rotation_matrix(self._frames[0][joint, 3:])
        if kind == _FREE:
            # of the COM itself
            return np.kron(np.eye(2), base.T)
        arm = rotation_matrix(body_q[body, 3:]) @ (self._com[body] - self._frames[1][joint, :3])
        linear = 0 if kind == _BALL else self._linear[joint]
        axes = (np.eye(3) if kind == _BALL else self._axis[self.dofs(joint)]) @ base.T
        turned = axes * (np.arange(len(axes)) >= linear)[:, None]
        return np.hstack([axes - turned + np.cross(turned, arm), turned])

    def matrix(self, joint: int, body_q: np.ndarray) -> np.ndarray:
        """Mass matrix of the degrees of freedom of such a joint, armature of joints included.

        Args:
            joint: The joint.
            body_q: Poses of bodies in which the axes of the joint are at zero.
        """
        body, rates = self.child[joint], self.rates(joint, body_q)
        rotation = rotation_matrix(body_q[body, 3:])
        inertia = rotation @ self._inertia[body] @ rotation.T
        moved, turned = rates[:, :3], rates[:, 3:]
        matrix = float(self._mass[body]) * moved @ moved.T + turned @ inertia @ turned.T
        return matrix + np.diag(self._armature[self.dofs(joint)])
