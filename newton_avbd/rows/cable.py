# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Newton's tendons: geometry and law of massless cables that go through guides.

A cable is a chain of straight *segments* between guides. A segment of length L has material of the
length R, and pulls its ends together with a tension T >= 0,

    T = max((L - R)/c + d (L - R)', 0),   or, with a compliance c = 0,   L <= R,  T (L - R) = 0.

A roller of radius r winds and unwinds material as its contact point moves on it (Mueller et al.,
"Cable Joints", SCA 2018): without slip a segment has R = R_0 + r (phi_0 - phi) for each of its two
rollers, with the angle phi of the contact point *in the roller's frame*. So the rate of L - R is
the relative velocity of the two material points along the segment, and each tension acts on the
body at that point, with the whole of its moment. At an internal guide material s may slip from the
segment on the right to that on the left: R_l += s, R_r -= s. Friction opposes that (Euler,
Eytelwein):

    T_l = T_r e^(mu phi) where s > 0,   T_r = T_l e^(mu phi) where s < 0,   in between s = 0,

with the angle phi by which the cable turns at the guide. Through an anchor nothing slips.

Lengths are of float64: a cable of one meter that stretches by nanometers carries something.
"""

import newton
import warp as wp

from ..data import CableGuide

ROLLER = wp.constant(int(newton.TendonGuideType.ROLLER))
ANCHOR = wp.constant(int(newton.TendonGuideType.ANCHOR))

STICKS = wp.constant(0)
"""How a cable passes a guide: without slip,"""
TO_LEFT = wp.constant(1)
"""slipping to the segment on the left, whose tension is the larger one,"""
TO_RIGHT = wp.constant(-1)
"""slipping to that on the right,"""
FREELY = wp.constant(2)
"""or without friction either way."""

MOST_RATIO = wp.constant(wp.float64(20.0))
"""Most of mu phi: a ratio of tensions of 5e8 lets nothing slip."""
NO_RATIO = wp.constant(wp.float64(1.0e-9))
"""mu phi below which there is no friction."""
SAME_TANGENT = wp.constant(wp.float64(1.0e-13))
"""Move of a contact point, of the radius, that ends the search for a tangent to two rollers."""
TANGENTS = wp.constant(40)
"""Most rounds of that search. Each leaves about the square of the radii by the distance."""
POINT = wp.constant(wp.float64(1.0e-9))
"""Length of a segment that has no direction [m]."""


@wp.struct
class GuidePose:
    """Where a guide is."""

    center: wp.vec3d
    """Place of the guide, or center of the roller [m]."""
    rotation: wp.quatd
    """Rotation of its link."""


@wp.struct
class Span:
    """A straight segment, from contact point to contact point."""

    left: wp.vec3d
    """From the centers of its guides to where it touches them [m], world frame."""
    right: wp.vec3d
    direction: wp.vec3d
    """From left to right; zero for a segment without length."""
    length: wp.float64
    """[m]"""


@wp.func
def as_double(v: wp.vec3) -> wp.vec3d:
    return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))


@wp.func
def as_single(v: wp.vec3d) -> wp.vec3:
    return wp.vec3(wp.float32(v[0]), wp.float32(v[1]), wp.float32(v[2]))


@wp.func
def unit_quat(q: wp.quat) -> wp.quatd:
    """A rotation in float64, of unit length there."""
    double = wp.quatd(wp.float64(q[0]), wp.float64(q[1]), wp.float64(q[2]), wp.float64(q[3]))
    return wp.normalize(double)


@wp.func
def link_pose(guide: CableGuide, link: wp.transform) -> GuidePose:
    """Where a guide is on a link in this pose."""
    pose = GuidePose()
    pose.rotation = unit_quat(wp.transform_get_rotation(link))
    pose.center = as_double(wp.transform_get_translation(link))
    pose.center += wp.quat_rotate(pose.rotation, as_double(guide.offset))
    return pose


@wp.func
def tangent_spoke(
    point: wp.vec3d, center: wp.vec3d, radius: wp.float64, normal: wp.vec3d, side: wp.float64
) -> wp.vec3d:
    """From the center of a circle to where the tangent from a point touches it [m].

    Args:
        point: The point; only its projection to the plane of the circle counts. From within the
            circle there is no tangent: the nearest point of the circle takes its place.
        center: Center of the circle.
        radius: Its radius [m].
        normal: Normal of its plane.
        side: 1 or -1, which of the two tangents.
    """
    way = center - point
    way -= wp.dot(way, normal) * normal
    distance = wp.length(way)
    if distance < POINT:
        return radius * wp.normalize(wp.cross(normal, wp.vec3d(normal[1], normal[2], normal[0])))
    along = way / distance
    if distance <= radius:
        return -radius * along
    sine = radius / distance
    cosine = wp.sqrt((wp.float64(1.0) - sine) * (wp.float64(1.0) + sine))
    return -radius * (sine * along + side * cosine * wp.cross(normal, along))


@wp.func
def axis_of(guide: CableGuide, pose: GuidePose) -> wp.vec3d:
    """Axis of a roller, world frame."""
    return wp.quat_rotate(pose.rotation, as_double(guide.axis))


@wp.func
def span_between(
    guide_l: CableGuide, guide_r: CableGuide, pose_l: GuidePose, pose_r: GuidePose, base_l: wp.vec3
) -> Span:
    """The segment between two guides; ``base_l`` is where it touched the left one, on its link."""
    span = Span()
    rolls_l = guide_l.kind == ROLLER
    rolls_r = guide_r.kind == ROLLER
    normal_l = axis_of(guide_l, pose_l)
    normal_r = axis_of(guide_r, pose_r)
    radius_l = wp.float64(guide_l.radius)
    radius_r = wp.float64(guide_r.radius)
    side_l = -wp.float64(guide_l.side)
    side_r = wp.float64(guide_r.side)
    if rolls_l and rolls_r:
        spoke = as_double(base_l - guide_l.offset)
        span.left = wp.quat_rotate(pose_l.rotation, spoke)
        moved = radius_l
        for _round in range(TANGENTS):
            if moved > SAME_TANGENT * radius_l:
                point = pose_l.center + span.left
                span.right = tangent_spoke(point, pose_r.center, radius_r, normal_r, side_r)
                point = pose_r.center + span.right
                spoke = tangent_spoke(point, pose_l.center, radius_l, normal_l, side_l)
                moved = wp.length(spoke - span.left)
                span.left = spoke
    elif rolls_l:
        span.left = tangent_spoke(pose_r.center, pose_l.center, radius_l, normal_l, side_l)
    elif rolls_r:
        span.right = tangent_spoke(pose_l.center, pose_r.center, radius_r, normal_r, side_r)
    way = (pose_r.center - pose_l.center) + (span.right - span.left)
    span.length = wp.length(way)
    if span.length > POINT:
        span.direction = way / span.length
    return span


@wp.func
def local_point(guide: CableGuide, pose: GuidePose, spoke: wp.vec3d) -> wp.vec3:
    """A contact point in the frame of the guide's link [m]."""
    return guide.offset + as_single(wp.quat_rotate_inv(pose.rotation, spoke))


@wp.func
def angle_about(normal: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> wp.float64:
    """Angle from one spoke to another one about an axis that is square to both [rad]."""
    return wp.atan2(wp.dot(wp.cross(a, b), normal), wp.dot(a, b))


@wp.func
def unwound(guide: CableGuide, pose: GuidePose, base: wp.vec3, spoke: wp.vec3d) -> wp.float64:
    """Material that has come off a roller on its right since the segment touched ``base`` [m].

    What comes off on its left is the opposite.
    """
    if not (guide.kind == ROLLER):
        return wp.float64(0.0)
    axis = as_double(guide.axis)
    start = as_double(base - guide.offset)
    end = wp.quat_rotate_inv(pose.rotation, spoke)
    return wp.float64(guide.side * guide.radius) * angle_about(axis, end, start)


@wp.func
def wrapped_angle(
    guide: CableGuide, pose: GuidePose, spoke_in: wp.vec3d, spoke_out: wp.vec3d
) -> wp.float64:
    """Angle by which a cable winds around a roller [rad], up to pi."""
    return wp.abs(angle_about(axis_of(guide, pose), spoke_in, spoke_out))


@wp.func
def bend_angle(before: wp.vec3d, after: wp.vec3d) -> wp.float64:
    """Angle by which a cable turns in a point [rad]."""
    return wp.atan2(wp.length(wp.cross(before, after)), wp.dot(before, after))


@wp.func
def log_ratio(mu: float, angle: wp.float64) -> wp.float64:
    """mu phi: logarithm of the largest ratio of the tensions at a guide."""
    return wp.min(wp.float64(mu) * angle, MOST_RATIO)


@wp.func
def softness(compliance: float, damping: float, h: float) -> wp.float64:
    """How far a unit of tension stretches a segment within a step [m/N]: 1/(1/c + d/h)."""
    c = wp.float64(compliance)
    return c / (wp.float64(1.0) + c * wp.float64(damping) / wp.float64(h))


@wp.func
def relaxed(compliance: float, damping: float, h: float, start: wp.float64) -> wp.float64:
    """Stretch at which a segment that started with the stretch ``start`` pulls with nothing [m]."""
    return softness(compliance, damping, h) * wp.float64(damping) / wp.float64(h) * start
