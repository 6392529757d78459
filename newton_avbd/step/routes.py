# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Newton's tendons before and after a step: where they run, and what of them slips.

Kernels here see the links of the user's model, and the arrays in which Newton's states keep how
their cables stand.
"""

import warp as wp

from ..data import CableWork
from ..rows import cable as law
from ..rows.cable import STICKS
from .cable_segments import NONE, beyond_rest, end_segment, first_segment, is_joined
from .kernels import KERNEL
from .resetting import is_selected

LEAST_REST = wp.constant(1.0e-6)
"""Least material of a segment [m], as in SolverXPBD."""


@wp.func
def link_of(body: int, body_q: wp.array[wp.transform]) -> wp.transform:
    """Pose of a link; the world's is the identity."""
    if body < 0:
        return wp.transform_identity()
    return body_q[body]


@wp.struct
class CableModel:
    """The model's tendons, read live."""

    world: wp.array[wp.int32]
    body: wp.array[wp.int32]
    """Link of each guide."""
    mu: wp.array[float]
    compliance: wp.array[float]
    damping: wp.array[float]


@wp.struct
class CableState:
    """What a state knows of its cables; Newton's arrays."""

    is_known: wp.array[wp.bool]
    """By cable: whether a step has written it."""
    is_placed: wp.array[wp.bool]
    """By world, the global one last: whether a reset put the bodies elsewhere since."""
    rest: wp.array[float]
    left: wp.array[wp.vec3]
    right: wp.array[wp.vec3]
    touched: wp.array[wp.bool]


@wp.struct
class CableView:
    """What is shown of the cables after a step."""

    left: wp.array[wp.vec3]
    """Ends of the segments [m], world frame."""
    right: wp.array[wp.vec3]
    length: wp.array[float]
    material_tension: wp.array[float]
    damping_tension: wp.array[float]


@wp.func
def touches(
    guide: int,
    was_touched: bool,
    tolerance: float,
    model: CableModel,
    body_q: wp.array[wp.transform],
    cables: CableWork,
) -> bool:
    """Whether the way of a cable leads around a dynamic roller, as SolverXPBD decides it.

    In the plane of the roller: its center lies beside the segment that would bypass it, on the side
    to which the cable winds, or no farther than the radius on the other one. A roller that the
    cable does not touch yet has to reach in by the share ``tolerance`` of its radius.
    """
    before = cables.guides[guide - 1]
    after = cables.guides[guide + 1]
    candidate = cables.guides[guide]
    pose_l = law.link_pose(before, link_of(model.body[guide - 1], body_q))
    pose_r = law.link_pose(after, link_of(model.body[guide + 1], body_q))
    pose = law.link_pose(candidate, link_of(model.body[guide], body_q))
    span = law.span_between(before, after, pose_l, pose_r, before.offset)
    normal = law.axis_of(candidate, pose)
    start = pose_l.center + span.left
    way = span.length * span.direction
    away = pose.center - start
    way -= wp.dot(way, normal) * normal
    away -= wp.dot(away, normal) * normal
    square = wp.dot(way, way)
    if square <= wp.float64(1.0e-12):
        return False
    share = wp.dot(away, way) / square
    distance = wp.float64(candidate.side) * wp.dot(away, wp.cross(normal, way)) / wp.sqrt(square)
    reach = wp.float64(candidate.radius)
    if not was_touched:
        reach *= wp.float64(1.0) - wp.float64(tolerance)
    return share > NONE and share < wp.float64(1.0) and distance <= reach


@wp.kernel(**KERNEL)
def begin_cables(
    # Model:
    model: CableModel,
    # State in:
    body_q: wp.array[wp.transform],
    state: CableState,
    initial: CableState,
    tolerance: float,
    # Out:
    cables: CableWork,
):
    """The routes of the step, and how the cables stand at its start; one thread a cable."""
    cable = wp.tid()
    first = first_segment(cable, cables)
    end = end_segment(cable, cables)
    world = model.world[cable]
    is_known = state.is_known[cable]
    is_placed = state.is_placed[wp.where(world < 0, state.is_placed.shape[0] - 1, world)]
    for seg in range(first, end):
        guide = seg + cable
        cables.active[seg] = 1
        cables.left[seg] = guide
        cables.right[seg] = guide + 1
        cables.compliance[seg] = model.compliance[seg]
        cables.damping[seg] = model.damping[seg]
        left = cables.rest[seg]
        cables.rest[seg] = initial.rest[seg]
        cables.base_left[seg] = initial.left[seg]
        cables.base_right[seg] = initial.right[seg]
        if is_known:
            cables.rest[seg] = state.rest[seg]
            cables.base_left[seg] = state.left[seg]
            cables.base_right[seg] = state.right[seg]
        if not (cables.rest[seg] == left):
            cables.lost[seg] = 0.0
    for seg in range(first, end + 1):
        guide = seg + cable
        cables.mu[guide] = model.mu[guide]
        is_touched = bool(True)
        if cables.guides[guide].is_dynamic:
            was_touched = initial.touched[guide]
            if is_known:
                was_touched = state.touched[guide]
            is_touched = touches(guide, was_touched, tolerance, model, body_q, cables)
            before = seg - 1
            if not is_touched:
                # the segment on the left takes the place of both
                rest = cables.rest[before]
                if was_touched:
                    pose = law.link_pose(cables.guides[guide], link_of(model.body[guide], body_q))
                    offset = cables.guides[guide].offset
                    spoke_in = wp.quat_rotate(
                        pose.rotation, law.as_double(cables.base_right[before] - offset)
                    )
                    spoke_out = wp.quat_rotate(
                        pose.rotation, law.as_double(cables.base_left[seg] - offset)
                    )
                    angle = law.wrapped_angle(cables.guides[guide], pose, spoke_in, spoke_out)
                    rest += cables.rest[seg] + cables.guides[guide].radius * wp.float32(angle)
                    cables.base_right[before] = cables.base_right[seg]
                elif rest <= 0.0:
                    rest = cables.guides[guide].detour
                cables.rest[before] = wp.max(rest, LEAST_REST)
                cables.rest[seg] = LEAST_REST
                cables.active[seg] = 0
                cables.right[before] = guide + 1
                cables.compliance[before] = model.compliance[before] + model.compliance[seg]
                cables.damping[before] = model.damping[before] + model.damping[seg]
                cables.tension[seg] = 0.0
            elif not was_touched:
                # its material is shared among the two and what winds around the roller
                guide_l = cables.guides[guide - 1]
                guide_r = cables.guides[guide + 1]
                candidate = cables.guides[guide]
                pose_l = law.link_pose(guide_l, link_of(model.body[guide - 1], body_q))
                pose_r = law.link_pose(guide_r, link_of(model.body[guide + 1], body_q))
                pose = law.link_pose(candidate, link_of(model.body[guide], body_q))
                base = cables.base_left[before]
                span_l = law.span_between(guide_l, candidate, pose_l, pose, base)
                span_r = law.span_between(candidate, guide_r, pose, pose_r, candidate.offset)
                angle = law.wrapped_angle(candidate, pose, span_l.right, span_r.left)
                free = wp.float64(cables.rest[before])
                free -= wp.float64(candidate.radius) * angle
                share = span_l.length / wp.max(span_l.length + span_r.length, law.POINT)
                cables.rest[before] = wp.max(wp.float32(share * free), LEAST_REST)
                cables.rest[seg] = wp.max(wp.float32(free) - cables.rest[before], LEAST_REST)
                cables.base_right[seg] = cables.base_right[before]
                cables.base_right[before] = law.local_point(candidate, pose, span_l.right)
                cables.base_left[seg] = law.local_point(candidate, pose, span_r.left)
                cables.tension[seg] = cables.tension[before]
                cables.slip[guide] = STICKS
        cables.touched[guide] = is_touched
    for seg in range(first, end):
        cables.start[seg] = NONE
        if not wp.isfinite(cables.tension[seg]):
            cables.tension[seg] = 0.0
        if cables.active[seg] == 1:
            guide_l = cables.guides[cables.left[seg]]
            guide_r = cables.guides[cables.right[seg]]
            pose_l = law.link_pose(guide_l, link_of(model.body[cables.left[seg]], body_q))
            pose_r = law.link_pose(guide_r, link_of(model.body[cables.right[seg]], body_q))
            span = law.span_between(guide_l, guide_r, pose_l, pose_r, cables.base_left[seg])
            if is_placed:
                cables.base_left[seg] = law.local_point(guide_l, pose_l, span.left)
                cables.base_right[seg] = law.local_point(guide_r, pose_r, span.right)
            cables.start[seg] = beyond_rest(seg, span, pose_l, pose_r, cables)


@wp.func
def give_slack(first: int, end: int, cables: CableWork):
    """In a group that is slack, material slips to segments that lack some."""
    for k in range(first, end):
        seg = cables.chain[k]
        for j in range(first, end):
            other = cables.chain[j]
            lack = wp.max(cables.load[seg], NONE)
            spare = wp.max(-cables.load[other], NONE)
            moved = wp.min(lack, spare)
            cables.load[seg] = cables.load[seg] - moved
            cables.load[other] = cables.load[other] + moved


@wp.func
def keep_material(first: int, end: int, cables: CableWork):
    """In a group, a segment gives away no more material than it has: its neighbors lack the rest.

    Expects ``load``, the stretch of each [m].
    """
    least = wp.float64(LEAST_REST)
    for k in range(first, end):
        seg = cables.chain[k]
        lack = least - (cables.stretch[seg] - cables.load[seg])
        for j in range(first, end):
            other = cables.chain[j]
            spare = (cables.stretch[other] - cables.load[other]) - least
            moved = wp.min(lack, spare)
            if j != k and moved > NONE:
                cables.load[seg] = cables.load[seg] - moved
                cables.load[other] = cables.load[other] + moved
                lack -= moved


@wp.kernel(**KERNEL)
def end_cables(
    # Model:
    model: CableModel,
    # State in:
    body_q: wp.array[wp.transform],
    h: float,
    # Work:
    cables: CableWork,
    # State out:
    state: CableState,
    # Out:
    view: CableView,
):
    """Material that has slipped, and how the cables stand after the step; one thread a cable.

    In a group of segments between which the cable slips, material goes where the tensions call for
    it, and what the group is off by is shared.
    """
    cable = wp.tid()
    first = first_segment(cable, cables)
    end = end_segment(cable, cables)
    world = model.world[cable]
    state.is_placed[wp.where(world < 0, state.is_placed.shape[0] - 1, world)] = False
    state.is_known[cable] = True
    count = int(0)
    for seg in range(first, end):
        zero = wp.vec3(0.0)
        view.left[seg] = zero
        view.right[seg] = zero
        view.length[seg] = 0.0
        view.material_tension[seg] = 0.0
        view.damping_tension[seg] = 0.0
        if cables.active[seg] == 1:
            guide_l = cables.guides[cables.left[seg]]
            guide_r = cables.guides[cables.right[seg]]
            pose_l = law.link_pose(guide_l, link_of(model.body[cables.left[seg]], body_q))
            pose_r = law.link_pose(guide_r, link_of(model.body[cables.right[seg]], body_q))
            span = law.span_between(guide_l, guide_r, pose_l, pose_r, cables.base_left[seg])
            target = wp.float64(0.0)
            if cables.compliance[seg] > 0.0:
                c = cables.compliance[seg]
                d = cables.damping[seg]
                target = law.softness(c, d, h) * wp.float64(cables.tension[seg])
                target += law.relaxed(c, d, h, cables.start[seg])
            cables.load[seg] = beyond_rest(seg, span, pose_l, pose_r, cables) - target
            cables.pull[seg] = target
            cables.base_left[seg] = law.local_point(guide_l, pose_l, span.left)
            cables.base_right[seg] = law.local_point(guide_r, pose_r, span.right)
            view.left[seg] = law.as_single(pose_l.center + span.left)
            view.right[seg] = law.as_single(pose_r.center + span.right)
            view.length[seg] = wp.float32(span.length)
            cables.stretch[seg] = span.length
            cables.chain[first + count] = seg
            count += 1
    start = int(0)
    while start < count:
        stop = int(start + 1)
        seg = cables.chain[first + start]
        pull = cables.tension[seg]
        sum = cables.load[seg]
        while stop < count and is_joined(cables.right[cables.chain[first + stop - 1]], cables):
            seg = cables.chain[first + stop]
            pull = wp.max(pull, cables.tension[seg])
            sum += cables.load[seg]
            stop += 1
        if pull > 0.0:
            for k in range(start, stop):
                seg = cables.chain[first + k]
                cables.load[seg] = sum / wp.float64(stop - start) + cables.pull[seg]
            keep_material(first + start, first + stop, cables)
        else:
            for k in range(start, stop):
                seg = cables.chain[first + k]
                cables.load[seg] = cables.load[seg] + cables.pull[seg]
            give_slack(first + start, first + stop, cables)
        start = stop
    for seg in range(first, end):
        if cables.active[seg] == 1:
            stretch = cables.load[seg]
            rest = cables.stretch[seg] - stretch
            cables.rest[seg] = wp.max(wp.float32(rest), LEAST_REST)
            cables.lost[seg] = wp.float32(rest - wp.float64(cables.rest[seg]))
            cables.left_over[seg] = wp.float32(stretch)
            tension = cables.tension[seg]
            view.material_tension[seg] = tension
            if cables.compliance[seg] > 0.0:
                material = wp.max(wp.float32(stretch) / cables.compliance[seg], 0.0)
                view.material_tension[seg] = material
                view.damping_tension[seg] = tension - material
        state.rest[seg] = cables.rest[seg]
        state.left[seg] = cables.base_left[seg]
        state.right[seg] = cables.base_right[seg]
    for guide in range(cables.guide_start[cable], cables.guide_start[cable + 1]):
        state.touched[guide] = cables.touched[guide]


@wp.kernel(**KERNEL)
def reset_cables(
    # Model:
    model: CableModel,
    # In:
    mask: wp.array[wp.bool],
    initial: CableState,
    # Out:
    cables: CableWork,
    state: CableState,
):
    """Puts the material of cables of the masked worlds back; one thread a cable."""
    cable = wp.tid()
    world = model.world[cable]
    if mask.shape[0] > 0:
        if not is_selected(world, mask):
            return
    state.is_known[cable] = True
    state.is_placed[wp.where(world < 0, state.is_placed.shape[0] - 1, world)] = True
    for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
        state.rest[seg] = initial.rest[seg]
        state.left[seg] = initial.left[seg]
        state.right[seg] = initial.right[seg]
        cables.rest[seg] = initial.rest[seg]
        cables.lost[seg] = 0.0
        cables.tension[seg] = 0.0
        cables.left_over[seg] = 0.0
        cables.slack[seg] = False
    for guide in range(cables.guide_start[cable], cables.guide_start[cable + 1]):
        state.touched[guide] = initial.touched[guide]
        cables.touched[guide] = initial.touched[guide]
        cables.slip[guide] = STICKS
