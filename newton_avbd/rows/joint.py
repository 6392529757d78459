# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What each type of joint locks and leaves free.

A joint compares two anchor frames, one on its parent and one on its child. It locks directions,
in which the frames must not part (the misfit), and leaves axes free, each a degree of freedom.
Newton's types differ only in how many linear and angular axes they leave free:

    angular axes free    locked                     axes, in world frame
    0 (weld)             all of the rotation        none
    1 (hinge)            what tilts the axis        the axis, of the parent
    2 (universal)        the middle Euler angle     first of the parent, second of the child
    3 (gimbal)           nothing                    three Euler axes, each carried by those before
    3 (ball)             nothing                    axes of the parent frame
    3 (rod)              nothing                    axes of the parent frame

A ROD leaves all six free and springs them; a DISTANCE joint leaves them free and bounds the
distance of the anchors, or, where that is to be 0, locks what a ball locks. A CONNECT, which is no
type of Newton's, locks what a ball locks, too, and has no coordinates. A new type is a line in
``KINDS`` and a case in the functions of joints: how many axes it leaves free is here, what it locks
in :mod:`.rows.lock`, where its axes point in :mod:`.rows.free_axes` and what its coordinates are in
:mod:`.rows.coordinate`. Three types are told from the others elsewhere, too: where coordinates act,
since a BALL has none but a turn (``rows.axis``, ``step.coordinates``, ``step.free_ball``,
``step.loop_axes``) and those of a ROD are springs (``rows.rod``, ``step.axis_forces``,
``step.loop_axes``), and where loops are held, as a DISTANCE (``step.distances``, ``step.strings``).
"""

import functools
from dataclasses import dataclass

import newton
import numpy as np
import warp as wp

from ..algebra.so3 import rotation_vector
from ..data import JointModel
from ..functions import Functions, together

JointType = newton.JointType


@dataclass(frozen=True)
class Kind:
    """How the solver treats a type of joint."""

    in_tree: bool
    """Whether it can link a body to its parent in the tree of an articulation."""
    has_axes: bool
    """Whether the model lists an axis for each degree of freedom."""


CONNECT = wp.constant(-1)
"""Type of a ball without degrees of freedom, for an equality constraint of MuJoCo's."""

KINDS: dict[int, Kind] = {
    JointType.PRISMATIC: Kind(in_tree=True, has_axes=True),
    JointType.REVOLUTE: Kind(in_tree=True, has_axes=True),
    JointType.D6: Kind(in_tree=True, has_axes=True),
    JointType.FIXED: Kind(in_tree=True, has_axes=True),
    JointType.BALL: Kind(in_tree=True, has_axes=False),
    JointType.ROD: Kind(in_tree=True, has_axes=False),
    JointType.DISTANCE: Kind(in_tree=False, has_axes=False),
    JointType.FREE: Kind(in_tree=False, has_axes=False),
    CONNECT: Kind(in_tree=False, has_axes=True),
}
"""All types of joints that the solver supports."""

PUSHED_AT_COM = (JointType.FREE, JointType.DISTANCE, JointType.ROD)
"""Types whose generalized force is a world wrench at the COM of the child."""

NO_LIMIT = wp.constant(1.0e6)
"""Newton's default for limits of effort and velocity: from here on there is none."""

BALL = wp.constant(int(JointType.BALL))
FREE = wp.constant(int(JointType.FREE))
ROD = wp.constant(int(JointType.ROD))
DISTANCE = wp.constant(int(JointType.DISTANCE))


@wp.func
def has_axes(joints: wp.ref[JointModel], joint: int) -> bool:
    """Whether the coordinates of a joint are those of its axes."""
    kind = joints.type[joint]
    return kind != BALL and kind != FREE and kind != ROD and kind != DISTANCE


@wp.func
def is_point(joints: wp.ref[JointModel], joint: int) -> bool:
    """Whether a joint is a distance of 0, which has no direction: a ball holds the same."""
    return joints.type[joint] == DISTANCE and joints.limit_upper[joints.dof_start[joint]] == 0.0


@wp.func
def is_string(joints: wp.ref[JointModel], joint: int) -> bool:
    """Whether a joint bounds the distance of its anchors."""
    return joints.type[joint] == DISTANCE and joints.limit_upper[joints.dof_start[joint]] != 0.0


SKEW = wp.constant(1.0e-4)
"""Cosine between two axes of a gimbal from which on they count as not square to each other."""


@wp.func
def is_skew(joints: wp.ref[JointModel], first: int) -> bool:
    """Whether the axes of a gimbal, whose degrees of freedom start at ``first``, are not square."""
    a0 = joints.axis[first]
    a1 = joints.axis[first + 1]
    a2 = joints.axis[first + 2]
    cosine = wp.max(wp.abs(wp.dot(a0, a1)), wp.abs(wp.dot(a1, a2)))
    return wp.max(cosine, wp.abs(wp.dot(a2, a0))) > SKEW


@wp.func
def linear_axis(joints: wp.ref[JointModel], joint: int, dof: int, q_p: wp.quat) -> wp.vec3:
    """Free linear axis, world frame; ``q_p`` is the rotation of the parent anchor."""
    return wp.quat_rotate(q_p, joints.axis[joints.dof_start[joint] + dof])


@wp.func
def ball_away(
    q: wp.array[float], joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat
) -> wp.vec3:
    """Turn that leads a ball joint to joint coordinates ``q`` [rad], parent anchor frame."""
    start = joints.coord_start[joint]
    target = wp.quat(q[start], q[start + 1], q[start + 2], q[start + 3])
    return rotation_vector(target * wp.quat_inverse(wp.quat_inverse(q_p) * q_c))


def oblique_joints(model: newton.Model) -> np.ndarray:
    """Joints of two angular axes that are not square to each other, by :data:`SKEW`."""
    dims = model.joint_dof_dim.numpy()
    found = np.flatnonzero(dims[:, 1] == 2)
    first = model.joint_qd_start.numpy()[found] + dims[found, 0]
    axes = model.joint_axis.numpy()
    cosine = np.einsum("ni,ni->n", axes[first], axes[first + 1])
    return found[np.abs(cosine) > SKEW]


def gimbal_joints(model: newton.Model) -> np.ndarray:
    """Joints of three angular axes."""
    is_d6 = model.joint_type.numpy() == int(newton.JointType.D6)
    return np.flatnonzero(is_d6 & (model.joint_dof_dim.numpy()[:, 1] == 3))


@dataclass(frozen=True)
class JointKinds:
    """Which kinds of joints a scene has, FREE joints aside."""

    linear: tuple[int, ...] = ()
    """Numbers of free linear axes that occur."""
    angular: tuple[int, ...] = ()
    """Numbers of free angular axes that occur."""
    euler: bool = False
    """Joints with two or three angular axes that are Euler axes."""
    gimbals: bool = False
    """Joints with three of them."""
    skew: bool = False
    """Gimbals whose axes are not square to each other."""
    oblique: bool = False
    """Joints with two angular axes that are not square to each other."""
    balls: bool = False
    """Joints whose angular axes are those of the parent frame: BALL and ROD."""
    rods: bool = False
    distances: bool = False
    connects: bool = False
    """Balls without degrees of freedom."""

    @property
    def angles(self) -> bool:
        """Joints with angles, whose turns are counted."""
        return self.euler or 1 in self.angular

    @classmethod
    def of_model(cls, model: newton.Model) -> "JointKinds":
        """Reads the kinds of joints from a model; copies model arrays to the host."""
        if model.joint_count == 0:
            return cls()
        types, dims = model.joint_type.numpy(), model.joint_dof_dim.numpy()
        held = types != int(JointType.FREE)
        types, dims = types[held], dims[held]
        is_ball = np.isin(types, (int(JointType.BALL), int(JointType.ROD)))
        authored = ~is_ball & (types != int(JointType.DISTANCE))
        found = gimbal_joints(model)
        first = model.joint_qd_start.numpy()[found] + model.joint_dof_dim.numpy()[found, 0]
        axes = model.joint_axis.numpy()[first[:, None] + np.arange(3)]
        cosines = np.einsum("nik,njk->nij", axes, axes)[:, (0, 1, 2), (1, 2, 0)]
        return cls(
            linear=tuple(int(n) for n in np.unique(dims[:, 0])),
            angular=tuple(int(n) for n in np.unique(dims[:, 1])),
            euler=bool(np.any(authored & (dims[:, 1] > 1))),
            gimbals=found.size > 0,
            skew=bool(np.any(np.abs(cosines) > SKEW)),
            oblique=oblique_joints(model).size > 0,
            balls=bool(np.any(is_ball)),
            rods=bool(np.any(types == int(JointType.ROD))),
            distances=bool(np.any(types == int(JointType.DISTANCE))),
            connects=bool(np.any(types == CONNECT)),
        )


@functools.cache
def make_counts(kinds: JointKinds) -> Functions:
    """Device functions: how many axes a joint leaves free, a number where all have as many."""
    linear, angular = kinds.linear, kinds.angular

    @wp.func
    def linear_count(joints: wp.ref[JointModel], joint: int) -> int:
        """Free linear axes of a joint."""
        count = int(wp.static(linear[0] if linear else 0))
        if wp.static(len(linear) > 1):
            count = joints.dof_dim[joint, 0]
        return count

    @wp.func
    def angular_count(joints: wp.ref[JointModel], joint: int) -> int:
        """Free angular axes of a joint."""
        count = int(wp.static(angular[0] if angular else 0))
        if wp.static(len(angular) > 1):
            count = joints.dof_dim[joint, 1]
        return count

    @wp.func
    def is_gimbal(joints: wp.ref[JointModel], joint: int) -> bool:
        """Whether a joint has three Euler axes."""
        return angular_count(joints, joint) == 3 and has_axes(joints, joint)

    return together(linear_count, angular_count, is_gimbal)
