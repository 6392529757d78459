# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Segments of cables in a step: between which guides, where they are, how far beyond their rest."""

import warp as wp

from ..data import BodyWork, CableGuide, CableWork, Solver
from ..rows import cable as law
from ..rows.cable import ANCHOR, FREELY, NO_RATIO, ROLLER, STICKS, GuidePose

NONE = wp.constant(wp.float64(0.0))


@wp.func
def first_segment(cable: int, cables: wp.ref[CableWork]) -> int:
    """First of the segments of a cable."""
    return cables.guide_start[cable] - cable


@wp.func
def end_segment(cable: int, cables: wp.ref[CableWork]) -> int:
    """End of them."""
    return cables.guide_start[cable + 1] - cable - 1


@wp.func
def slot_at(seg: int, side: int, cables: wp.ref[CableWork]) -> int:
    """Slot of the body at the left end of a segment, side 0, or at its right one."""
    return cables.guides[wp.where(side == 0, cables.left[seg], cables.right[seg])].slot


@wp.func
def is_joined(guide: int, cables: wp.ref[CableWork]) -> bool:
    """Whether the cable slips at a guide, which ties the tensions on both sides."""
    return not (cables.slip[guide] == STICKS)


@wp.func
def is_inextensible(cable: int, cables: wp.ref[CableWork]) -> bool:
    """Whether no segment of a cable gives way."""
    for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
        if cables.active[seg] == 1 and cables.compliance[seg] > 0.0:
            return False
    return True


@wp.func
def beyond_rest(seg: int, span: law.Span, pose_l: GuidePose, pose_r: GuidePose, cables: CableWork):
    """Length of a segment beyond its material where nothing slips [m]."""
    guide_l = cables.guides[cables.left[seg]]
    guide_r = cables.guides[cables.right[seg]]
    wound = law.unwound(guide_r, pose_r, cables.base_right[seg], span.right)
    wound -= law.unwound(guide_l, pose_l, cables.base_left[seg], span.left)
    rest = wp.float64(cables.rest[seg]) + wp.float64(cables.lost[seg])
    return span.length - rest + wound


@wp.func
def guide_pose(guide: CableGuide, s: wp.ref[Solver]) -> GuidePose:
    """Where a guide is after the increments; on a kinematic body where that is put."""
    slot = guide.slot
    pose = GuidePose()
    pose.center = law.as_double(s.work.com[slot])
    pose.rotation = wp.quatd(NONE, NONE, NONE, wp.float64(1.0))
    if s.work.inv_mass[slot] > 0.0:
        pose.center += law.as_double(wp.spatial_top(s.work.increment[slot]))
        pose.rotation = law.unit_quat(s.tree.rotation[slot])
    elif slot < s.work.inv_mass.shape[0] - 1:
        pose.rotation = law.unit_quat(wp.transform_get_rotation(s.work.pose[slot]))
    pose.center += wp.quat_rotate(pose.rotation, law.as_double(guide.arm))
    pose.rotation = pose.rotation * law.unit_quat(guide.turn)
    return pose


@wp.func
def set_way(
    place: int,
    slot: int,
    point: wp.vec3d,
    direction: wp.vec3,
    work: wp.ref[BodyWork],
    cables: wp.ref[CableWork],
):
    """Wrench of a unit force at a point, on a body after its increment."""
    way = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    if work.inv_mass[slot] > 0.0:
        center = law.as_double(work.com[slot])
        center += law.as_double(wp.spatial_top(work.increment[slot]))
        arm = law.as_single(point - center)
        cables.arm[place] = arm
        way = wp.spatial_vector(direction, wp.cross(arm, direction))
    cables.way[place] = way


@wp.func
def measure_cable(cable: int, cables: wp.ref[CableWork], s: wp.ref[Solver]):
    """Stretch and directions of the segments of a cable after the increments; ratios at guides."""
    last = int(-1)
    for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
        if cables.active[seg] == 0:
            continue
        guide_l = cables.guides[cables.left[seg]]
        guide_r = cables.guides[cables.right[seg]]
        pose_l = guide_pose(guide_l, s)
        pose_r = guide_pose(guide_r, s)
        span = law.span_between(guide_l, guide_r, pose_l, pose_r, cables.base_left[seg])
        cables.stretch[seg] = beyond_rest(seg, span, pose_l, pose_r, cables)
        direction = law.as_single(span.direction)
        cables.length[seg] = wp.float32(span.length)
        cables.direction[seg] = direction
        cables.spoke_left[seg] = law.as_single(span.left)
        cables.spoke_right[seg] = law.as_single(span.right)
        point_l = pose_l.center + span.left
        point_r = pose_r.center + span.right
        set_way(2 * seg, guide_l.slot, point_l, direction, s.work, cables)
        set_way(2 * seg + 1, guide_r.slot, point_r, -direction, s.work, cables)
        guide = cables.left[seg]
        if last >= 0:
            angle = wp.float64(0.0)
            if guide_l.kind == ROLLER:
                spoke_in = law.as_double(cables.spoke_right[last])
                angle = law.wrapped_angle(guide_l, pose_l, spoke_in, span.left)
            else:
                angle = law.bend_angle(law.as_double(cables.direction[last]), span.direction)
            cables.ratio[guide] = law.log_ratio(cables.mu[guide], angle)
            if guide_l.kind == ANCHOR:
                cables.slip[guide] = STICKS
            elif cables.ratio[guide] < NO_RATIO:
                cables.slip[guide] = FREELY
            elif cables.slip[guide] == FREELY:
                cables.slip[guide] = STICKS
        last = seg
