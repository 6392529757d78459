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
distance of the anchors, or, where that is to be 0, locks what a ball locks. A new type is a line in
``KINDS`` and a case in these functions. Three types are told from the others elsewhere, too: where
coordinates act, since a BALL has none but a turn (``rows.axis``, ``step.coordinates``,
``step.free_ball``, ``step.loop_axes``) and those of a ROD are springs (``step.axis_forces``,
``step.loop_axes``), and where loops are held, as a DISTANCE (``step.distances``,
``step.closures``).
"""

import functools
import math
from dataclasses import dataclass

import newton
import numpy as np
import warp as wp

from ..algebra.so3 import angle_of, rotation_vector, turned_from
from ..data import JointModel

JointType = newton.JointType


@dataclass(frozen=True)
class Kind:
    """How the solver treats a type of joint."""

    in_tree: bool
    """Whether it can link a body to its parent in the tree of an articulation."""
    has_axes: bool
    """Whether the model lists an axis for each degree of freedom."""


KINDS: dict[JointType, Kind] = {
    JointType.PRISMATIC: Kind(in_tree=True, has_axes=True),
    JointType.REVOLUTE: Kind(in_tree=True, has_axes=True),
    JointType.D6: Kind(in_tree=True, has_axes=True),
    JointType.FIXED: Kind(in_tree=True, has_axes=True),
    JointType.BALL: Kind(in_tree=True, has_axes=False),
    JointType.ROD: Kind(in_tree=True, has_axes=False),
    JointType.DISTANCE: Kind(in_tree=False, has_axes=False),
    JointType.FREE: Kind(in_tree=False, has_axes=False),
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


@wp.func
def wrapped(angle: float) -> float:
    """The angle less whole turns, in [-pi, pi] [rad]."""
    return angle - wp.static(2.0 * math.pi) * wp.round(angle * wp.static(0.5 / math.pi))


NEAR_POLE = wp.constant(4.0e-2)
"""Square of the cosine of the middle angle below which a gimbal is near its pole, where its first
and last axis are nearly parallel: within 0.2 rad of a right angle."""
POLE = wp.constant(4.0e-4)
"""Square of the cosine below which the pose of a gimbal that is not solved with a tree is not asked
how the two turn against each other: 0.02 rad."""
SKEW = wp.constant(1.0e-4)
"""Cosine between two axes of a gimbal from which on they count as not square to each other."""
LEAST_SPREAD = wp.constant(1.0e-6)
"""Share by which rates of the outer axes of a gimbal count as error beside the spin that they miss:
rounding of the axes makes none of more than 350 times the spin."""

LOOP_SPREAD = wp.constant(1.0e-3)
"""Likewise for torques of joints outside of trees: they grow to 16 times what turns the axis."""


@wp.func
def is_skew(joints: wp.ref[JointModel], first: int) -> bool:
    """Whether the axes of a gimbal, whose degrees of freedom start at ``first``, are not square."""
    a0 = joints.axis[first]
    a1 = joints.axis[first + 1]
    a2 = joints.axis[first + 2]
    cosine = wp.max(wp.abs(wp.dot(a0, a1)), wp.abs(wp.dot(a1, a2)))
    return wp.max(cosine, wp.abs(wp.dot(a2, a0))) > SKEW


@wp.func
def is_near_pole(middle: float) -> bool:
    """Whether a gimbal of this middle angle [rad] is near its pole."""
    cosine = wp.cos(middle)
    return cosine * cosine < NEAR_POLE


@wp.func
def nearest_angles(found: wp.vec3, known: wp.vec3, parallel: float, is_carried: bool) -> wp.vec3:
    """Angles of a gimbal that the pose allows, those nearest to the known ones [rad].

    A pose has two solutions: (a, b, c) and (a + pi, pi - b, c + pi). At the pole, where the middle
    angle is a right one, it tells the sum of the outer angles (their difference where the axes are
    opposite) and nothing else. What they turn against each other is then that of the known angles,
    and blends into that of the pose on the way out, so that no angle ever jumps.

    Args:
        found: A solution, with the middle angle within a right one.
        known: Angles to be near to.
        parallel: Above zero where the first and the last axis point alike, below where opposite.
        is_carried: Whether the known angles already have what the axes turned. Then the pose is
            asked from far enough from the pole on only, for that is what it follows.
    """
    other = other_solution(found)
    a = found - known
    b = other - known
    for i in range(3):
        a[i] = wrapped(a[i])
        b[i] = wrapped(b[i])
    cosine = wp.cos(found[1])
    beside = cosine * cosine
    if beside < NEAR_POLE:
        side = wp.where(parallel < 0.0, -1.0, 1.0)
        pole = wp.where(found[1] < 0.0, wp.static(-0.5 * math.pi), wp.static(0.5 * math.pi))
        ahead = found[1] - pole
        both = wrapped(a[0] + side * a[2])
        against = wrapped(a[0] - side * a[2])
        if wp.length_sq(b) < wp.length_sq(a):
            ahead = -ahead
            both = wrapped(b[0] + side * b[2])
            against = wrapped(b[0] - side * b[2])
        share = beside / (beside + POLE * (1.0 - beside / NEAR_POLE))
        if is_carried:
            share = wp.max(2.0 * beside / NEAR_POLE - 1.0, 0.0)
        left = (1.0 - share) * against
        against -= left
        # the azimuth about the pole is off by half of what is left
        middle = pole + ahead * wp.cos(0.5 * left)
        return known + wp.vec3(
            0.5 * (both + against), wrapped(middle - known[1]), 0.5 * side * (both - against)
        )
    if wp.length_sq(b) < wp.length_sq(a):
        return known + b
    return known + a


@wp.func
def other_solution(angles: wp.vec3) -> wp.vec3:
    """The other angles of a gimbal that have its child in the same pose, in [-pi, pi] [rad]."""
    half = wp.static(math.pi)
    return wp.vec3(wrapped(angles[0] + half), wrapped(half - angles[1]), wrapped(angles[2] + half))


@wp.func
def beyond_limits(joints: wp.ref[JointModel], first: int, angles: wp.vec3) -> float:
    """How far angles are beyond the limits of the degrees of freedom from ``first`` on [rad]."""
    lower = wp.vec3(
        joints.limit_lower[first], joints.limit_lower[first + 1], joints.limit_lower[first + 2]
    )
    upper = wp.vec3(
        joints.limit_upper[first], joints.limit_upper[first + 1], joints.limit_upper[first + 2]
    )
    return wp.max(wp.max(wp.max(lower - angles), wp.max(angles - upper)), 0.0)


@wp.func
def reduced(angle: wp.float64) -> float:
    """The angle less whole revolutions, in [-pi, pi] [rad]: of many, float32 tells too little."""
    turns = wp.round(angle * wp.static(wp.float64(0.5 / math.pi)))
    return wp.float32(angle - wp.static(wp.float64(2.0 * math.pi)) * turns)


@wp.func
def counted(angle: float, known: wp.float64) -> wp.float64:
    """The angle with as many whole turns as brings it nearest to the ``known`` one [rad].

    In float64: after hours of turns float32 would not tell how far a wheel turns in a step.
    """
    found = wp.float64(angle)
    turns = wp.round((known - found) * wp.static(wp.float64(0.5 / math.pi)))
    return found + wp.static(wp.float64(2.0 * math.pi)) * turns


@wp.func
def rod_stiffness(q_p: wp.quat, q_c: wp.quat, stiffness: wp.vec3) -> wp.vec3:
    """Bound of J^T K J about each axis of the parent frame [N m/rad], J as in :func:`rod_torque`.

    The twist of a bent rod couples the axes: each gets the sum of its row (Gershgorin).
    """
    start = tangent(q_p)
    end = tangent(q_c)
    along = wp.max(1.0 + wp.dot(start, end), 1.0e-3)
    growth = 1.0 + wp.length_sq(wp.cross(start, end)) / (along * along)
    mean = wp.quat_rotate_inv(q_p, start + end) / along
    row = wp.vec3(wp.abs(mean[0]), wp.abs(mean[1]), wp.abs(mean[2]))
    bend = growth * growth * wp.vec3(stiffness[0], stiffness[1], 0.0)
    return bend + (stiffness[2] * (row[0] + row[1] + row[2])) * row


@wp.func
def turn_about(axis: wp.vec3, start: wp.vec3, end: wp.vec3) -> float:
    """Angle about a unit axis [rad] that turns one vector square to it into another."""
    return angle_of(wp.dot(axis, wp.cross(start, end)), wp.dot(start, end))


@wp.func
def tangent(q: wp.quat) -> wp.vec3:
    """Direction of a rod at an anchor: its local Z."""
    return wp.quat_rotate(q, wp.vec3(0.0, 0.0, 1.0))


@wp.func
def bend_and_twist(q: wp.quat) -> wp.vec3:
    """Bends about X and Y and twist about Z [rad] of a rod whose end is turned by q to its start.

    The bend is the curvature binormal 2 tan(theta/2) of the angle theta between the two tangents
    (Bergou et al., "Discrete Elastic Rods", 2008), the twist what turns the child about its tangent
    after the start has been carried along without twisting.
    """
    end = tangent(q)
    along = wp.max(1.0 + end[2], 1.0e-3)
    # z x t = (-t_y, t_x, 0)
    return wp.vec3(-2.0 * end[1] / along, 2.0 * end[0] / along, 2.0 * angle_of(q[2], q[3]))


@wp.func
def rod_torque(q_p: wp.quat, q_c: wp.quat, response: wp.vec3) -> wp.vec3:
    """Torque on the child [N m], world frame, of what answers the bends and the twist [N m].

    That is J^T response: a bend changes by 1 + kb^2/4 times the turn, the twist by the turn about
    the mean tangent.
    """
    start = tangent(q_p)
    end = tangent(q_c)
    along = wp.max(1.0 + wp.dot(start, end), 1.0e-3)
    bend = wp.cross(start, end)
    growth = 1.0 + wp.length_sq(bend) / (along * along)
    across = wp.quat_rotate(q_p, wp.vec3(response[0], response[1], 0.0))
    return growth * across + (response[2] / along) * (start + end)


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
        )


@dataclass(frozen=True)
class JointFunctions:
    """Device functions of joints, compiled for the kinds of joints that a scene has."""

    linear_count: wp.Function
    angular_count: wp.Function
    linear_axis: wp.Function
    linear_misfit: wp.Function
    linear_lock: wp.Function
    angular_misfit: wp.Function
    locked_shift: wp.Function
    locked_turn: wp.Function
    angular_lock: wp.Function
    angular_axis: wp.Function
    torque_axis: wp.Function
    axis_of: wp.Function
    angles: wp.Function
    is_gimbal: wp.Function
    is_led: wp.Function
    known_angles: wp.Function
    gimbal_tilt: wp.Function
    coordinate: wp.Function
    velocity: wp.Function
    advance: wp.Function


@functools.cache
def make_joint(kinds: JointKinds) -> JointFunctions:
    """Device functions for the kinds of joints that a scene has, and for no others."""
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

    @wp.func
    def is_led(joints: wp.ref[JointModel], joint: int, known: wp.vec3) -> bool:
        """Whether the angles of a gimbal lead its pose: near the pole, or with skew axes."""
        if wp.static(kinds.skew):
            if is_skew(joints, joints.dof_start[joint] + linear_count(joints, joint)):
                return True
        return is_near_pole(known[1])

    @wp.func
    def known_angles(
        joints: wp.ref[JointModel], joint: int, values: wp.array[wp.float64], first: int
    ) -> wp.vec3:
        """Angles of a gimbal less whole revolutions [rad], by coordinates of its joint.

        They stand from ``first`` on.
        """
        if wp.static(kinds.gimbals):
            if is_gimbal(joints, joint):
                k = first + linear_count(joints, joint)
                return wp.vec3(reduced(values[k]), reduced(values[k + 1]), reduced(values[k + 2]))
        return wp.vec3(0.0)

    @wp.func
    def linear_axis(joints: wp.ref[JointModel], joint: int, dof: int, q_p: wp.quat) -> wp.vec3:
        """Free linear axis, world frame; ``q_p`` is the rotation of the parent anchor."""
        return wp.quat_rotate(q_p, joints.axis[joints.dof_start[joint] + dof])

    @wp.func
    def linear_misfit(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, offset: wp.vec3
    ) -> wp.vec3:
        """Part [m] of the offset between the anchors that the joint locks."""
        free = linear_count(joints, joint)
        if wp.static(0 in linear):
            if free == 0:
                return offset
        if wp.static(kinds.distances):
            if is_point(joints, joint):
                return offset
        if wp.static(1 in linear):
            if free == 1:
                axis = linear_axis(joints, joint, 0, q_p)
                return offset - wp.dot(axis, offset) * axis
        if wp.static(2 in linear):
            if free == 2:
                normal = wp.normalize(
                    wp.cross(linear_axis(joints, joint, 0, q_p), linear_axis(joints, joint, 1, q_p))
                )
                return wp.dot(normal, offset) * normal
        return wp.vec3(0.0)

    @wp.func
    def linear_lock(joints: wp.ref[JointModel], joint: int, q_p: wp.quat) -> wp.mat33:
        """Projection of a shift to what the joint locks."""
        return wp.matrix_from_cols(
            linear_misfit(joints, joint, q_p, wp.vec3(1.0, 0.0, 0.0)),
            linear_misfit(joints, joint, q_p, wp.vec3(0.0, 1.0, 0.0)),
            linear_misfit(joints, joint, q_p, wp.vec3(0.0, 0.0, 1.0)),
        )

    @wp.func
    def euler_axes(joints: wp.ref[JointModel], joint: int):
        """The three axes of a joint with two or three angular axes, in the parent anchor frame.

        With two, the locked rotation is the middle one, as in Newton.
        """
        first = joints.dof_start[joint] + linear_count(joints, joint)
        a0 = joints.axis[first]
        a1 = joints.axis[first + 1]
        if angular_count(joints, joint) == 2:
            return a0, wp.cross(a0, a1), a1
        return a0, a1, joints.axis[first + 2]

    @wp.func(inline=False)
    def euler_middle(joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat):
        """Sine of the middle Euler angle of a joint with two or three axes, and its axis."""
        a0, a1, a2 = euler_axes(joints, joint)
        first = wp.quat_rotate(q_p, a0)
        last = wp.quat_rotate(q_c, a2)
        # The middle axis is square to both; the angle is how far the last leaves the plane
        # across the first.
        middle = wp.cross(last, first)
        if wp.dot(wp.cross(a2, a0), a1) < 0.0:
            middle = -middle
        if wp.length_sq(middle) < 1.0e-8:
            middle = wp.quat_rotate(q_p, a1)
        middle = wp.normalize(middle)
        sine = wp.dot(first, last)
        if wp.dot(wp.cross(a0, a1), a2) < 0.0:
            sine = -sine
        return wp.clamp(sine, -1.0, 1.0), middle

    @wp.func(inline=False)
    def middle_axis(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """Middle Euler axis; of a gimbal as its ``known`` angles have it [rad], since the pose has
        two solutions, and at the pole more."""
        if wp.static(kinds.gimbals):
            if angular_count(joints, joint) == 3:
                if is_led(joints, joint, known):
                    a0, a1, _last = euler_axes(joints, joint)
                    return wp.quat_rotate(q_p * wp.quat_from_axis_angle(a0, known[0]), a1)
        _sine, middle = euler_middle(joints, joint, q_p, q_c)
        if wp.static(kinds.gimbals):
            if angular_count(joints, joint) == 3 and wp.cos(known[1]) < 0.0:
                middle = -middle
        return middle

    @wp.func(inline=False)
    def gimbal_tilt(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """Turn of the child [rad], world frame, beyond where the angles of a gimbal have it.

        Near its pole a gimbal locks the turn square to its axes as a hinge does. Elsewhere the
        angles follow the pose (but for skew axes).
        """
        if not is_led(joints, joint, known):
            return wp.vec3(0.0)
        a0, a1, a2 = euler_axes(joints, joint)
        turn = wp.quat_from_axis_angle(a0, known[0]) * wp.quat_from_axis_angle(a1, known[1])
        turn = q_p * turn * wp.quat_from_axis_angle(a2, known[2])
        return rotation_vector(q_c * wp.quat_inverse(turn))

    @wp.func
    def angular_misfit(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat
    ) -> wp.vec3:
        """Turn [rad] of the child against the parent that the joint locks, world frame."""
        free = angular_count(joints, joint)
        if wp.static(0 in angular):
            if free == 0:
                return rotation_vector(q_c * wp.quat_inverse(q_p))
        if wp.static(1 in angular):
            if free == 1:
                axis = joints.axis[joints.dof_start[joint] + linear_count(joints, joint)]
                return wp.cross(wp.quat_rotate(q_p, axis), wp.quat_rotate(q_c, axis))
        if wp.static(2 in angular):
            if free == 2:
                sine, middle = euler_middle(joints, joint, q_p, q_c)
                tilt = wp.asin(sine)
                if wp.static(kinds.oblique):
                    first = joints.dof_start[joint] + linear_count(joints, joint)
                    cosine = wp.dot(joints.axis[first], joints.axis[first + 1])
                    tilt += wp.asin(wp.clamp(cosine, -1.0, 1.0))
                return tilt * middle
        return wp.vec3(0.0)

    @wp.func
    def locked_shift(
        joints: wp.ref[JointModel],
        joint: int,
        q_p: wp.quat,
        turn_p: wp.quat,
        shift: wp.vec3,
        offset: wp.vec3,
    ) -> wp.vec3:
        """Of a shift [m] of the child anchor against the parent's what the joint locks.

        With the turn of the parent meanwhile, and what lies between the anchors after it: seen from
        the parent the child was at ``turn_p (offset - shift)``. Of a small shift nothing is lost,
        as it is where two misfits are subtracted.
        """
        turned = turned_from(wp.quat_inverse(turn_p), offset - shift)
        return linear_misfit(joints, joint, q_p, shift + turned)

    @wp.func
    def locked_turn(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat, turn: wp.quat
    ) -> wp.vec3:
        """Likewise, of a turn of the child against the parent that led to these rotations [rad]."""
        free = angular_count(joints, joint)
        if wp.static(0 in angular):
            if free == 0:
                return rotation_vector(turn)
        if wp.static(1 in angular):
            if free == 1:
                first = joints.dof_start[joint] + linear_count(joints, joint)
                axis = wp.quat_rotate(q_p, joints.axis[first])
                return wp.cross(turned_from(wp.quat_inverse(turn), axis), axis)
        if wp.static(2 in angular):
            if free == 2:
                # of the middle angle, whose sine is that of the two axes
                i = joints.dof_start[joint] + linear_count(joints, joint)
                axis_p = wp.quat_rotate(q_p, joints.axis[i])
                axis_c = wp.quat_rotate(q_c, joints.axis[i + 1])
                whole, middle = euler_middle(joints, joint, q_p, q_c)
                sine = -wp.dot(axis_p, turned_from(turn, axis_c))
                cosine = wp.sqrt((1.0 - whole) * (1.0 + whole))
                return (sine / wp.max(cosine, 1.0e-4)) * middle
        return wp.vec3(0.0)

    @wp.func
    def angular_lock(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat
    ) -> wp.mat33:
        """Projection of a turn to what the joint locks."""
        free = angular_count(joints, joint)
        if wp.static(0 in angular):
            if free == 0:
                return wp.identity(n=3, dtype=float)
        if wp.static(1 in angular):
            if free == 1:
                axis = wp.quat_rotate(
                    q_p, joints.axis[joints.dof_start[joint] + linear_count(joints, joint)]
                )
                return wp.identity(n=3, dtype=float) - wp.outer(axis, axis)
        if wp.static(2 in angular):
            if free == 2:
                _, middle = euler_middle(joints, joint, q_p, q_c)
                return wp.outer(middle, middle)
        return wp.mat33(0.0)

    @wp.func
    def angular_axis(
        joints: wp.ref[JointModel], joint: int, dof: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """World frame's axis of angular coordinate ``dof``, counted from the first angular one.

        ``known`` are the :func:`known_angles`.
        """
        if wp.static(kinds.balls):
            kind = joints.type[joint]
            if kind == BALL or kind == ROD:
                unit = wp.vec3(0.0)
                unit[dof] = 1.0
                return wp.quat_rotate(q_p, unit)
        axis = joints.axis[joints.dof_start[joint] + linear_count(joints, joint) + dof]
        if wp.static(kinds.euler):
            if dof > 0:
                if dof == angular_count(joints, joint) - 1:
                    return wp.quat_rotate(q_c, axis)
                return middle_axis(joints, joint, q_p, q_c, known)
        return wp.quat_rotate(q_p, axis)

    @wp.func
    def rod_turn(joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat) -> wp.vec3:
        """Bends and twist of a rod beyond those at rest [rad]."""
        start = joints.coord_start[joint] + 3
        rest = wp.quat(
            joints.rest_q[start],
            joints.rest_q[start + 1],
            joints.rest_q[start + 2],
            joints.rest_q[start + 3],
        )
        out = bend_and_twist(wp.quat_inverse(q_p) * q_c) - bend_and_twist(rest)
        out[2] = wrapped(out[2])
        return out

    @wp.func(inline=False)
    def chain_angles(
        joints: wp.ref[JointModel], joint: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """Angles of a chain of three hinges whose axes are not square to each other [rad].

        By Newton's method from the known ones, damped where the axes lie in a plane.
        """
        a0, a1, a2 = euler_axes(joints, joint)
        pose = wp.quat_inverse(q_p) * q_c
        out = wp.vec3(known)
        for _i in range(4):
            first = wp.quat_from_axis_angle(a0, out[0])
            second = first * wp.quat_from_axis_angle(a1, out[1])
            turn = second * wp.quat_from_axis_angle(a2, out[2])
            left = rotation_vector(pose * wp.quat_inverse(turn))
            axes = wp.matrix_from_cols(a0, wp.quat_rotate(first, a1), wp.quat_rotate(second, a2))
            square = axes * wp.transpose(axes) + wp.diag(wp.vec3(SKEW))
            out += wp.transpose(axes) * (wp.inverse(square) * left)
        return out

    @wp.func
    def angles(
        joints: wp.ref[JointModel],
        joint: int,
        q_p: wp.quat,
        q_c: wp.quat,
        known: wp.vec3,
        is_carried: bool,
    ) -> wp.vec3:
        """Coordinates of the angular axes of a joint, less whole turns [rad]; zero of a ball.

        Those of a gimbal are the :func:`nearest_angles` to the ``known`` ones.
        """
        free = angular_count(joints, joint)
        if free == 0:
            return wp.vec3(0.0)
        if wp.static(kinds.balls):
            if joints.type[joint] == BALL:
                return wp.vec3(0.0)
        if wp.static(kinds.rods):
            if joints.type[joint] == ROD:
                return rod_turn(joints, joint, q_p, q_c)
        if wp.static(kinds.skew):
            if free == 3:
                if is_skew(joints, joints.dof_start[joint] + linear_count(joints, joint)):
                    return chain_angles(joints, joint, q_p, q_c, known)
        if wp.static(kinds.euler):
            if free > 1:
                sine, middle = euler_middle(joints, joint, q_p, q_c)
                a0, a1, a2 = euler_axes(joints, joint)
                first = turn_about(wp.quat_rotate(q_p, a0), wp.quat_rotate(q_p, a1), middle)
                last = turn_about(wp.quat_rotate(q_c, a2), middle, wp.quat_rotate(q_c, a1))
                if free == 2:
                    return wp.vec3(first, last, 0.0)
                if wp.static(kinds.gimbals):
                    parallel = wp.dot(wp.quat_rotate(q_p, a0), wp.quat_rotate(q_c, a2))
                    across = wp.cross(wp.quat_rotate(q_p, a0), wp.quat_rotate(q_c, a2))
                    found = wp.vec3(first, angle_of(sine, wp.length(across)), last)
                    return nearest_angles(found, known, parallel, is_carried)
        axis = joints.axis[joints.dof_start[joint] + linear_count(joints, joint)]
        q = wp.quat_inverse(q_p) * q_c
        half = angle_of(wp.dot(wp.vec3(q[0], q[1], q[2]), axis), q[3])
        return wp.vec3(wrapped(2.0 * half), 0.0, 0.0)

    @wp.func
    def torque_axis(
        joints: wp.ref[JointModel],
        joint: int,
        dof: int,
        q_p: wp.quat,
        q_c: wp.quat,
        known: wp.vec3,
        least: float,
    ) -> wp.vec3:
        """World frame's torque of a unit generalized force along angular coordinate ``dof``.

        By it a spin has the rate of the coordinate. The first and the last Euler axis are not
        square to each other, and at the pole both rates are undetermined: least squares leave the
        two the least rates, where a rate counts ``least`` beside the spin that it misses.
        """
        axis = angular_axis(joints, joint, dof, q_p, q_c, known)
        if wp.static(kinds.skew):
            if is_gimbal(joints, joint):
                if is_skew(joints, joints.dof_start[joint] + linear_count(joints, joint)):
                    second = angular_axis(joints, joint, (dof + 1) % 3, q_p, q_c, known)
                    third = angular_axis(joints, joint, (dof + 2) % 3, q_p, q_c, known)
                    across = wp.cross(second, third)
                    volume = wp.dot(axis, across)
                    return (volume / (volume * volume + least)) * across
        if wp.static(kinds.oblique):
            if angular_count(joints, joint) == 2:
                other = angular_axis(joints, joint, 1 - dof, q_p, q_c, known)
                along = wp.dot(axis, other)
                return (axis - along * other) / wp.length_sq(wp.cross(axis, other))
        if wp.static(kinds.gimbals):
            if dof != 1 and is_gimbal(joints, joint):
                other = angular_axis(joints, joint, 2 - dof, q_p, q_c, known)
                along = wp.dot(axis, other)
                spread = wp.length_sq(wp.cross(axis, other)) + least * (2.0 + least)
                return ((1.0 + least) * axis - along * other) / spread
        return axis

    @wp.func
    def axis_of(
        joints: wp.ref[JointModel], joint: int, dof: int, q_p: wp.quat, q_c: wp.quat, known: wp.vec3
    ) -> wp.vec3:
        """World axis along which a generalized force of a degree of freedom pushes or turns."""
        linear = linear_count(joints, joint)
        if dof < linear:
            return linear_axis(joints, joint, dof, q_p)
        return torque_axis(joints, joint, dof - linear, q_p, q_c, known, LOOP_SPREAD)

    @wp.func
    def coordinate(
        joints: wp.ref[JointModel],
        joint: int,
        dof: int,
        q_p: wp.quat,
        turns: wp.vec3,
        offset: wp.vec3,
        known: wp.float64,
    ) -> wp.float64:
        """Coordinate of a degree of freedom [m or rad]; zero for a ball.

        ``turns`` are the joint's :func:`angles`; ``offset`` leads from the parent anchor to the
        child anchor. An angle is the one nearest to the ``known`` one, so that turns are counted.
        """
        linear = linear_count(joints, joint)
        if dof < linear:
            return wp.float64(wp.dot(linear_axis(joints, joint, dof, q_p), offset))
        if joints.type[joint] == BALL:
            return wp.float64(0.0)
        return counted(turns[dof - linear], known)

    @wp.func
    def velocity(
        joints: wp.ref[JointModel],
        joint: int,
        dof: int,
        q_p: wp.quat,
        q_c: wp.quat,
        known: wp.vec3,
        relative: wp.spatial_vector,
    ) -> float:
        """Velocity of a degree of freedom [m/s or rad/s].

        ``relative`` is the velocity of the child anchor against the parent, world frame; ``known``
        are the :func:`known_angles`.
        """
        linear = linear_count(joints, joint)
        if dof < linear:
            return wp.dot(linear_axis(joints, joint, dof, q_p), wp.spatial_top(relative))
        spin = wp.spatial_bottom(relative)
        axis = torque_axis(joints, joint, dof - linear, q_p, q_c, known, LEAST_SPREAD)
        return wp.dot(axis, spin)

    @wp.func
    def advance(
        joints: wp.ref[JointModel],
        joint: int,
        dof: int,
        q_p: wp.quat,
        q_c: wp.quat,
        known: wp.vec3,
        turn: wp.vec3,
    ) -> wp.float64:
        """About how far a turn of the child against the parent [rad] takes an angle of a joint that
        is no ball, where that may go round: the bends of a rod do not."""
        if wp.static(kinds.rods):
            if joints.type[joint] == ROD and dof != linear_count(joints, joint) + 2:
                return wp.float64(0.0)
        relative = wp.spatial_vector(wp.vec3(0.0), turn)
        return wp.float64(velocity(joints, joint, dof, q_p, q_c, known, relative))

    return JointFunctions(
        linear_count,
        angular_count,
        linear_axis,
        linear_misfit,
        linear_lock,
        angular_misfit,
        locked_shift,
        locked_turn,
        angular_lock,
        angular_axis,
        torque_axis,
        axis_of,
        angles,
        is_gimbal,
        is_led,
        known_angles,
        gimbal_tilt,
        coordinate,
        velocity,
        advance,
    )
