# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Where shapes touch while they turn.

Contacts are often found once for several steps. A corner that touches turns with its body, but the
point where something round touches does not: a wheel whose contacts turned back under it would
drive itself.

Within a step, too, the lever of a contact's force changes. By its mean the force does no work on
what does not slip, so that what rolls and tumbles gains no energy; steps of second order in time
take the force, and so its lever, of the end of the step.
"""

import functools

import newton
import warp as wp

from ..data import ContactRecord, ContactRow, ShapeModel, Solver
from ..effects import Effects

FLAT = wp.constant(0.1)
"""Sine of the angle between normal and axis below which a cylinder stands on its end."""
ROLLED = wp.constant(0.8)
"""Cosine of how far a cylinder rolls at most before its contacts are found again."""
SAME = wp.constant(5.0e-5)
"""Roll that rounding may stand for [rad]; less than :data:`LEAST_TURN`, so that what rolls in steps
in which levers move is not taken for a corner, which would drive it on."""

LEAST_TURN = wp.constant(1.0e-4)
"""Turn of a step [rad] below which the levers of its contacts are those of the start: of what rests
they would change by what rounding leaves of its spin, and ask for further sweeps."""
MOST_TURN = wp.constant(0.2)
"""Turn of a step beyond which they are, too: a needle that rolls by a radian has them anywhere."""


@wp.func
def moves_levers(turn: wp.vec3) -> bool:
    """Whether the levers of a body's contacts are those of later in the step."""
    angle_sq = wp.length_sq(turn)
    return angle_sq > LEAST_TURN * LEAST_TURN and angle_sq < MOST_TURN * MOST_TURN


@wp.func
def is_round(shape: int, shapes: wp.ref[ShapeModel]) -> bool:
    """Whether a shape rolls."""
    kind = shapes.type[shape]
    is_smooth = kind >= wp.static(int(newton.GeoType.SPHERE))
    is_smooth = is_smooth and kind <= wp.static(int(newton.GeoType.CYLINDER))
    return is_smooth or kind == wp.static(int(newton.GeoType.CONE))


@wp.func
def pose_in_body(shape: int, shapes: wp.ref[ShapeModel]) -> wp.transform:
    """Pose of a shape in the frame of the body that its link is part of."""
    pose = shapes.pose[shape]
    if shapes.frame.shape[0] > 0:
        pose = shapes.frame[shape] * pose
    return pose


@wp.func
def share_of_point(record: ContactRecord, slot0: int, slot1: int, s: wp.ref[Solver]) -> float:
    """Which body a contact that was found some steps ago went with: 0 or 1, or both by halves.

    What is round takes it along, as the other one is flat there; or else what moves.
    """
    round0 = is_round(record.shape0, s.shapes)
    round1 = is_round(record.shape1, s.shapes)
    if round0 == round1:
        round0 = s.work.inv_mass[slot1] == 0.0
        round1 = s.work.inv_mass[slot0] == 0.0
    return wp.where(round0 == round1, 0.5, wp.where(round1, 1.0, 0.0))


@wp.func
def rolled_point(
    shape: int, rotation: wp.quat, point: wp.vec3, outward: wp.vec3, shapes: wp.ref[ShapeModel]
) -> wp.vec3:
    """Where a shape touches now, of the point where it did; in the frame of its body.

    Spheres and capsules touch off a point of their axis, which stays where it is. A cylinder that
    has rolled touches at the place of its rim that now lies farthest along ``outward``.
    """
    if shapes.type[shape] != wp.static(int(newton.GeoType.CYLINDER)):
        return point
    frame = pose_in_body(shape, shapes)
    along = wp.quat_rotate_inv(rotation * wp.transform_get_rotation(frame), outward)
    along = wp.vec3(along[0], along[1], 0.0)
    if wp.length_sq(along) < FLAT * FLAT:
        return point
    local = wp.transform_point(wp.transform_inverse(frame), point)
    rim = wp.vec3(local[0], local[1], 0.0)
    along = shapes.scale[shape][0] * wp.normalize(along)
    least = wp.length_sq(along)
    turned = wp.dot(rim, along)
    if turned < ROLLED * least or wp.length_sq(rim - along) < SAME * SAME * least:
        return point
    return wp.transform_point(frame, along + wp.vec3(0.0, 0.0, local[2]))


@functools.cache
def make_point_moves(effects: Effects) -> wp.Function:
    """Device function: how a contact's lever on the body that owns it changes in a step."""

    @wp.func
    def point_moves(
        row: ContactRow, record: ContactRecord, swing: wp.quat, s: wp.ref[Solver]
    ) -> wp.vec3:
        """By how much the arm of a row changes as its body turns by ``swing`` [m].

        Zero beside what moves, or is round, too, where nobody knows which point comes next, and for
        a corner that lands, which may end the turn. (A rim that rolls lands all the time.)
        """
        shape = record.shape0
        other = record.shape1
        point = record.point0
        if row.contact < 0:
            shape = record.shape1
            other = record.shape0
            point = record.point1
        kind = s.shapes.type[shape]
        is_known = kind == wp.static(int(newton.GeoType.CYLINDER))
        if wp.length_sq(row.force) > 0.0:
            is_known = kind != wp.static(int(newton.GeoType.ELLIPSOID))
            is_known = is_known and kind != wp.static(int(newton.GeoType.CONE))
        if s.work.inv_mass[row.b] > 0.0 or is_round(other, s.shapes) or not is_known:
            return wp.vec3(0.0)
        before = wp.transform_get_rotation(s.work.pose[row.a])
        after = swing * before
        point0 = point
        point1 = point
        if wp.static(effects.cylinders):
            point0 = rolled_point(shape, before, point, row.normal, s.shapes)
            point1 = rolled_point(shape, after, point, row.normal, s.shapes)
        com = s.model.com[row.a]
        return wp.quat_rotate(after, point1 - com) - wp.quat_rotate(before, point0 - com)

    return point_moves
