# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Tensions of a cluster of cables, and which segments are slack and where the cables slip.

That is found by trying: the equations are solved as if it were known, and what contradicts the
answer is changed (policy iteration).
"""

import warp as wp

from ..data import CableWork
from ..rows.cable import ANCHOR, FREELY, STICKS, TO_LEFT, TO_RIGHT
from .cable_mobility import mobility_between, whole_softness
from .cable_segments import NONE, end_segment, first_segment, is_inextensible, is_joined

HIDDEN = wp.constant(wp.float64(1.0e-9))
"""What the equations are off by, of its length, that counts as none."""
LITTLE = wp.constant(wp.float64(1.0e-7))
"""Tension that counts as none, of the largest of a cluster."""


@wp.func
def list_rows(cluster: int, recovery: float, cables: wp.ref[CableWork]) -> int:
    """Lists the segments of a cluster whose tensions are solved for; returns how many.

    In the recovery those of cables that give way pull as they do.
    """
    count = int(0)
    for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
        cable = cables.cables[i]
        if recovery > 0.0 and not is_inextensible(cable, cables):
            continue
        for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
            if cables.active[seg] == 1:
                cables.chain[cables.first_row[cluster] + count] = seg
                count += 1
    return count


@wp.func
def excess(cluster: int, seg: int, count: int, h: float, cables: wp.ref[CableWork]) -> wp.float64:
    """What the tensions that are tried leave of a segment beyond its target [m]."""
    left = cables.load[seg] - whole_softness(cluster, seg, h, cables) * cables.pull[seg]
    first = cables.first_row[cluster]
    for k in range(count):
        other = cables.chain[first + k]
        left -= mobility_between(cluster, seg, other, cables) * cables.pull[other]
    return left


@wp.func
def form_groups(cluster: int, count: int, cables: wp.ref[CableWork]) -> int:
    """Groups of segments between which cables slip, and their shares of the largest tension.

    Returns how many groups there are. One is slack as a whole or not at all.
    """
    first = cables.first_row[cluster]
    groups = int(0)
    start = int(0)
    while start < count:
        stop = int(start)
        weight = wp.float64(0.0)
        most = wp.float64(0.0)
        is_slack = bool(True)
        is_going_on = bool(True)
        while is_going_on:
            seg = cables.chain[first + stop]
            cables.group[seg] = groups
            cables.weight[seg] = weight
            most = wp.max(most, weight)
            is_slack = is_slack and cables.slack[seg]
            stop += 1
            is_going_on = False
            if stop < count:
                guide = cables.right[seg]
                same = cables.left[cables.chain[first + stop]] == guide
                if same and is_joined(guide, cables):
                    is_going_on = True
                    if cables.slip[guide] == TO_LEFT:
                        weight -= cables.ratio[guide]
                    elif cables.slip[guide] == TO_RIGHT:
                        weight += cables.ratio[guide]
        for k in range(start, stop):
            seg = cables.chain[first + k]
            cables.weight[seg] = wp.exp(cables.weight[seg] - most)
            cables.slack[seg] = is_slack
        groups += 1
        start = stop
    return groups


@wp.func
def solve_groups(
    cluster: int, count: int, groups: int, h: float, cables: wp.ref[CableWork]
) -> wp.float64:
    """Tensions of the groups that are taut; returns the largest.

    By elimination with pivots. A group that nothing moves and that does not give way has none.
    """
    first = cables.first_row[cluster]
    base = cables.matrix_start[cluster]
    for k in range(groups * groups):
        cables.matrix[base + k] = NONE
    for g in range(groups):
        cables.answer[first + g] = NONE
    for k in range(count):
        seg = cables.chain[first + k]
        g = cables.group[seg]
        place = base + g * groups + g
        if cables.slack[seg]:
            cables.matrix[place] = wp.float64(1.0)
            continue
        cables.answer[first + g] = cables.answer[first + g] + cables.load[seg]
        soft = whole_softness(cluster, seg, h, cables)
        cables.matrix[place] = cables.matrix[place] + soft * cables.weight[seg]
        for j in range(count):
            other = cables.chain[first + j]
            if not cables.slack[other]:
                place = base + g * groups + cables.group[other]
                moved = mobility_between(cluster, seg, other, cables) * cables.weight[other]
                cables.matrix[place] = cables.matrix[place] + moved
    for k in range(groups):
        best = int(k)
        for i in range(k + 1, groups):
            if wp.abs(cables.matrix[base + i * groups + k]) > wp.abs(
                cables.matrix[base + best * groups + k]
            ):
                best = i
        if best != k:
            for j in range(groups):
                kept = cables.matrix[base + k * groups + j]
                cables.matrix[base + k * groups + j] = cables.matrix[base + best * groups + j]
                cables.matrix[base + best * groups + j] = kept
            kept = cables.answer[first + k]
            cables.answer[first + k] = cables.answer[first + best]
            cables.answer[first + best] = kept
        pivot = cables.matrix[base + k * groups + k]
        if pivot == NONE:
            continue
        for i in range(k + 1, groups):
            factor = cables.matrix[base + i * groups + k] / pivot
            if factor != NONE:
                for j in range(k, groups):
                    left = cables.matrix[base + i * groups + j]
                    left -= factor * cables.matrix[base + k * groups + j]
                    cables.matrix[base + i * groups + j] = left
                lower = cables.answer[first + i] - factor * cables.answer[first + k]
                cables.answer[first + i] = lower
    for i in range(groups):
        k = groups - 1 - i
        value = cables.answer[first + k]
        for j in range(k + 1, groups):
            value -= cables.matrix[base + k * groups + j] * cables.answer[first + j]
        pivot = cables.matrix[base + k * groups + k]
        cables.answer[first + k] = wp.where(pivot == NONE, NONE, value / pivot)
    most = wp.float64(0.0)
    for k in range(count):
        seg = cables.chain[first + k]
        pull = cables.answer[first + cables.group[seg]] * cables.weight[seg]
        cables.pull[seg] = wp.where(cables.slack[seg], NONE, pull)
        most = wp.max(most, pull)
    return most


@wp.func
def tauten(cluster: int, count: int, h: float, cables: wp.ref[CableWork]) -> bool:
    """Makes groups slack that would push, and slack ones taut that are too long.

    Returns whether there was one.
    """
    first = cables.first_row[cluster]
    is_changed = bool(False)
    start = int(0)
    while start < count:
        group = cables.group[cables.chain[first + start]]
        stop = int(start)
        sum = wp.float64(0.0)
        hidden = wp.float64(0.0)
        while stop < count and cables.group[cables.chain[first + wp.min(stop, count - 1)]] == group:
            seg = cables.chain[first + stop]
            hidden += HIDDEN * wp.float64(cables.rest[seg])
            if cables.slack[seg]:
                sum += excess(cluster, seg, count, h, cables)
            stop += 1
        seg = cables.chain[first + start]
        pushes = cables.pull[seg] < NONE
        if pushes or (cables.slack[seg] and sum > hidden):
            is_changed = True
            for k in range(start, stop):
                seg = cables.chain[first + k]
                cables.slack[seg] = pushes
                cables.pull[seg] = wp.max(cables.pull[seg], NONE)
        start = stop
    return is_changed


@wp.func
def let_slip(
    cluster: int, count: int, most: wp.float64, h: float, cables: wp.ref[CableWork]
) -> bool:
    """Lets cables slip where friction would hold too much, and holds them where it would push.

    Returns whether there was such a guide.
    """
    first = cables.first_row[cluster]
    is_changed = bool(False)
    slipped = wp.float64(0.0)
    for k in range(1, count):
        last = cables.chain[first + k - 1]
        seg = cables.chain[first + k]
        guide = cables.left[seg]
        slipped += excess(cluster, last, count, h, cables)
        if cables.right[last] != guide:
            slipped = NONE
            continue
        slip = cables.slip[guide]
        if slip == STICKS:
            slipped = NONE
            if not (cables.guides[guide].kind == ANCHOR):
                ratio = wp.exp(cables.ratio[guide])
                little = LITTLE * most
                if cables.pull[last] > ratio * cables.pull[seg] + little:
                    cables.slip[guide] = TO_LEFT
                    is_changed = True
                elif cables.pull[seg] > ratio * cables.pull[last] + little:
                    cables.slip[guide] = TO_RIGHT
                    is_changed = True
        elif not (slip == FREELY) and not cables.slack[seg]:
            against = wp.where(slip == TO_LEFT, -slipped, slipped)
            if against > HIDDEN * wp.float64(cables.rest[seg]):
                cables.slip[guide] = STICKS
                is_changed = True
    return is_changed
