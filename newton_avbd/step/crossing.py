# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies that fly farther in a step than they, and what they meet, are large.

A blow of a corner would turn such a body by many radians within the step. A row is linear in the
turn: it would hold the corner where it is, while the center goes on through a wall. So where a body
may get past what it meets it is taken for a ball about its center, as large as its corner is far:
it stops where no turn of it can touch, and goes on to turn as it does.
"""

import newton
import warp as wp

from ..data import BodyWork, ContactRecord, ContactRow, Solver, Step
from .bodies import is_loose
from .rolling import pose_in_body

COMPACT = wp.constant(0.5)
"""Depth of a body behind a contact, as a share of its radius of gyration, from which a ball can
stand for it: for a brick of 2:1:1 from any side, not for a plate from a side, nor for a needle."""
FLAT = wp.constant(0.05)
"""Share of the size by which bodies may get deeper as they turn, up to which three points or more
hold them flat."""
SLICK = wp.constant(-1.0)
"""Friction of a row that is to have none in the step, whatever its shapes have."""
LONG = wp.constant(30.0)
"""Lever of a contact, in radii of gyration, from which its friction is left to the next step."""
OPEN = wp.constant(0.5)
"""Gap, as a share of the lever, from which the lever is that long since the contact is open."""


@wp.func
def depth_of_shape(normal: wp.vec3, point: wp.vec3, b: int, shape: int, s: wp.ref[Solver]) -> float:
    """How deep behind a point of its surface the center of a shape is that the solver does not
    move [m]; zero for a mesh, whose origin says nothing of that, and is as if it were thin."""
    kind = s.shapes.type[shape]
    has_center = kind >= wp.static(int(newton.GeoType.SPHERE))
    if not (has_center and kind <= wp.static(int(newton.GeoType.BOX))):
        return 0.0
    center = wp.transform_get_translation(pose_in_body(shape, s.shapes))
    if s.shapes.body[shape] >= 0:
        center = wp.transform_point(s.work.pose[b], center)
    return wp.max(wp.dot(normal, center - point), 0.0)


@wp.func
def gyration_sq(body: int, work: wp.ref[BodyWork]) -> float:
    """Square of the radius of gyration of a body, of all directions [m^2]."""
    return 0.5 * wp.trace(work.inertia[body]) * work.inv_mass[body]


@wp.func
def is_long(body: int, lever: wp.vec3, s: wp.ref[Solver]) -> bool:
    """Whether a lever is so long for a body that friction by it is nothing but rounding."""
    is_far = wp.length_sq(lever) > LONG * LONG * gyration_sq(body, s.work)
    return s.work.inv_mass[body] > 0.0 and is_far


@wp.func
def has_long_lever(row: ContactRow, s: wp.ref[Solver]) -> bool:
    """Whether a contact is so far open that its friction has no lever yet, on either body."""
    if row.gap < OPEN * wp.length(row.arm):
        return False
    span = s.work.com[row.a] - s.work.com[row.b]
    return is_long(row.a, row.arm, s) or is_long(row.b, row.arm + span, s)


@wp.func
def is_compact(body: int, depth: float, s: wp.ref[Solver]) -> bool:
    """Whether the solver moves a body, no joint holds it, and a ball can stand for it."""
    if s.work.inv_mass[body] == 0.0:
        return False
    if not is_loose(body, s):
        return False
    return depth > 0.0 and depth * depth > COMPACT * COMPACT * gyration_sq(body, s.work)


@wp.func
def swept(body: int, depth: float, radius: float, s: wp.ref[Solver]) -> float:
    """By how much a body gets deeper behind a contact as it turns in a step, at most [m]."""
    return wp.min(radius - depth, radius * wp.length(wp.spatial_bottom(s.work.target[body])))


@wp.func
def point_count(record: ContactRecord, owner: int, step: wp.ref[Step], s: wp.ref[Solver]) -> int:
    """Number of points at which two shapes touch."""
    count = int(0)
    for i in range(s.rows.owned_start[owner], s.rows.owned_end[owner]):
        contact = s.rows.contacts[i]
        if step.contacts.shape0[contact] == record.shape0:
            count += int(step.contacts.shape1[contact] == record.shape1)
    return count


@wp.func
def as_balls(
    row: ContactRow, record: ContactRecord, step: wp.ref[Step], s: wp.ref[Solver]
) -> ContactRow:
    """A row; where bodies may get past each other in this step, that of balls."""
    moved = wp.spatial_top(s.work.target[row.b]) - wp.spatial_top(s.work.target[row.a])
    closing = -wp.dot(row.normal, moved)
    apart = s.work.com[row.b] - s.work.com[row.a]
    # the point of a row is half way between the surfaces
    arm_a = row.arm - (0.5 * row.gap) * row.normal
    arm_b = row.arm + (0.5 * row.gap) * row.normal - apart
    depth_a = wp.dot(row.normal, arm_a)
    depth_b = -wp.dot(row.normal, arm_b)
    if closing < depth_a:
        return row
    is_ball_a = is_compact(row.a, depth_a, s)
    is_ball_b = is_compact(row.b, depth_b, s)
    radius_a = wp.length(arm_a)
    radius_b = wp.length(arm_b)
    deeper = float(0.0)
    size = float(0.0)
    if is_ball_a:
        deeper += swept(row.a, depth_a, radius_a, s)
        size += radius_a
    if is_ball_b:
        deeper += swept(row.b, depth_b, radius_b, s)
        size += radius_b
    gap = row.gap - deeper
    behind = float(depth_b)
    if s.work.inv_mass[row.b] == 0.0:
        shape = wp.where(row.contact < 0, record.shape0, record.shape1)
        if s.shapes.type[shape] == wp.static(int(newton.GeoType.PLANE)):
            return row
        point = s.work.com[row.b] + arm_b
        behind = depth_of_shape(row.normal, point, row.b, shape, s)
    if not is_ball_b:
        size = wp.max(size, behind)
    if not is_ball_a:
        size = wp.max(size, depth_a)
    if closing < wp.max(size, gap):
        return row
    aside = apart - (wp.dot(apart, moved) / wp.length_sq(moved)) * moved
    if is_ball_a and is_ball_b:
        # a blow that misses their centers turns them, so that these go on by this share of the way
        turning = gyration_sq(row.a, s.work) + gyration_sq(row.b, s.work)
        deeper += closing * wp.min(wp.length_sq(aside) / turning, 1.0)
    if deeper < FLAT * size and point_count(record, row.a, step, s) >= 3:
        return row
    deepest = wp.min(row.gap, 0.0)
    if is_ball_a and is_ball_b:
        is_ahead = wp.dot(apart, row.normal) > 0.0
        if is_ahead and wp.length_sq(aside) < size * size:
            row.normal = wp.normalize(apart)
            row.gap = wp.max(wp.length(apart) - size, deepest)
            row.arm = radius_a * row.normal
            row.mu = SLICK
    elif is_ball_a or is_ball_b:
        # in line with the center of the ball
        row.arm = wp.where(is_ball_a, radius_a * row.normal, apart - radius_b * row.normal)
        row.gap = wp.max(gap, deepest)
        row.mu = SLICK
    return row
