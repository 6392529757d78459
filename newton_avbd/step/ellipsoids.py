# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Ellipsoids that just touch, where detection finds a point and no normal.

Newton's detection gives normals of zero, and a gap of zero, where an ellipsoid and what it meets
overlap by less than 0.1 mm, which is how bodies rest. The point that it gives lies in both. So the
normal is that of the ellipsoid there, and the surface is where the ellipsoid reaches farthest along
that.
"""

import newton
import warp as wp

from ..data import ContactRecord, ShapeModel, Solver
from .rolling import pose_in_body


@wp.func
def is_ellipsoid(shape: int, shapes: wp.ref[ShapeModel]) -> bool:
    """Whether a shape is an ellipsoid."""
    return shapes.type[shape] == wp.static(int(newton.GeoType.ELLIPSOID))


@wp.func
def frame_now(shape: int, slot: int, static_slot: int, s: wp.ref[Solver]) -> wp.quat:
    """Rotation of a shape's frame, in world axes."""
    rotation = wp.transform_get_rotation(pose_in_body(shape, s.shapes))
    if slot == static_slot:
        return rotation
    return wp.transform_get_rotation(s.work.pose[slot]) * rotation


@wp.func
def outward_of(
    shape: int, slot: int, static_slot: int, point: wp.vec3, s: wp.ref[Solver]
) -> wp.vec3:
    """Outward normal of an ellipsoid at a point on it, in world axes; zero of another shape.

    The gradient of x^2/a^2 + y^2/b^2 + z^2/c^2. The point is in the frame of the body.
    """
    if not is_ellipsoid(shape, s.shapes):
        return wp.vec3(0.0)
    radii = s.shapes.scale[shape]
    local = wp.transform_point(wp.transform_inverse(pose_in_body(shape, s.shapes)), point)
    gradient = wp.cw_div(local, wp.cw_mul(radii, radii))
    return wp.quat_rotate(frame_now(shape, slot, static_slot, s), wp.normalize(gradient))


@wp.func
def touching_normal(
    record: ContactRecord, slot0: int, slot1: int, static_slot: int, s: wp.ref[Solver]
) -> wp.vec3:
    """Normal of a contact from its first shape to the second; zero where none is an ellipsoid."""
    outward = outward_of(record.shape0, slot0, static_slot, record.point0, s)
    inward = outward_of(record.shape1, slot1, static_slot, record.point1, s)
    return wp.normalize(outward - inward)


@wp.func
def farthest_point(
    shape: int, slot: int, static_slot: int, point: wp.vec3, outward: wp.vec3, s: wp.ref[Solver]
) -> wp.vec3:
    """Where an ellipsoid reaches farthest along a direction; ``point`` of another shape.

    Both are in the frame of the body. With the radii a: a^2 n / |a n|, by components.
    """
    if not is_ellipsoid(shape, s.shapes):
        return point
    radii = s.shapes.scale[shape]
    along = wp.quat_rotate_inv(frame_now(shape, slot, static_slot, s), outward)
    scaled = wp.normalize(wp.cw_mul(radii, along))
    return wp.transform_point(pose_in_body(shape, s.shapes), wp.cw_mul(radii, scaled))
