# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Colors of the blocks of large worlds: those that contacts or joints link differ in color.

A block is a free body, or a tree of joints; it goes by its first body. Each step starts from the
last one's colors. In a pass, a block takes the lowest color that none of its neighbors has, if one
of higher priority has the same (speculative coloring: Gebremedhin, Manne,
2000; priorities are random and fixed, as in Jones, Plassmann, 1993). Neighbors that change at once
may meet again, and try again; one that has no clash left never changes, since all others avoid its
color. Who clashes after the last pass goes to a last group, whose blocks move one
after the other. So no two blocks in contact ever move at once, and the colors follow from the
contacts, the joints and the colors before alone.
"""

import warp as wp

from ..data import ColorWork, Solver, Step, WorldWork
from ..step.contacts import body_slot, is_across, report_dropped
from ..step.gathering import is_visited_first
from ..step.loops import other_end
from ..step.resetting import is_selected

COLORS = 12
"""Colors. Walls and piles take six or seven; a block whose neighbors have them all goes to the last
group."""
PASSES = 8
"""Passes of coloring in a step; even, so that colors end on the side on which they began."""


@wp.kernel(enable_backward=False)
def clear_counts(
    # Out:
    colors: ColorWork,
):
    """Nothing is counted yet; one thread a body."""
    colors.count[wp.tid()] = 0


@wp.kernel(enable_backward=False)
def count_contacts(step: Step, s: wp.array[Solver]):
    """How many contacts each body has; one thread a place in the contact buffer."""
    contact = wp.tid()
    static_slot = s[0].work.inv_mass.shape[0] - 1
    count = step.contacts.count[0]
    if contact == 0:
        s[0].worlds.overflow[0] = wp.max(s[0].worlds.overflow[0], count - step.contacts.capacity)
    s[0].rows.owner[contact] = -1
    if contact >= count:
        return
    shape0 = step.contacts.shape0[contact]
    shape1 = step.contacts.shape1[contact]
    if wp.min(shape0, shape1) < 0 or wp.max(shape0, shape1) >= s[0].shapes.body.shape[0]:
        report_dropped(s[0].worlds, contact)
        return
    slot0 = body_slot(s[0].shapes, shape0, static_slot)
    slot1 = body_slot(s[0].shapes, shape1, static_slot)
    if is_across(slot0, slot1, s[0]):
        report_dropped(s[0].worlds, contact)
        return
    if slot0 == slot1:
        return
    for side in range(2):
        slot = wp.where(side == 0, slot0, slot1)
        if s[0].work.inv_mass[slot] > 0.0:
            s[0].rows.owner[contact] = slot
            wp.atomic_add(s[0].colors.count, slot, 1)


@wp.kernel(enable_backward=False)
def list_contacts(step: Step, s: wp.array[Solver]):
    """Lists the contacts of each body, in no order; one thread a place in the contact buffer."""
    contact = wp.tid()
    if s[0].rows.owner[contact] < 0:
        return
    static_slot = s[0].work.inv_mass.shape[0] - 1
    slot0 = body_slot(s[0].shapes, step.contacts.shape0[contact], static_slot)
    slot1 = body_slot(s[0].shapes, step.contacts.shape1[contact], static_slot)
    for side in range(2):
        slot = wp.where(side == 0, slot0, slot1)
        if s[0].work.inv_mass[slot] > 0.0:
            left = wp.atomic_add(s[0].colors.count, slot, -1)
            s[0].colors.incident[s[0].colors.incident_start[slot + 1] - left] = contact


@wp.kernel(enable_backward=False)
def forget_colors(
    # Model:
    body_world: wp.array[wp.int32],
    # In:
    mask: wp.array[wp.bool],
    # Out:
    colors: ColorWork,
):
    """Starts the bodies of the masked worlds from no colors; one thread a body."""
    body = wp.tid()
    if mask.shape[0] == 0 or is_selected(body_world[body], mask):
        colors.color[0, body] = 0


@wp.func
def sort_part(values: wp.array[wp.int32], start: int, end: int):
    """Sorts a part of a list by insertion: atomics leave it nearly sorted."""
    for i in range(start + 1, end):
        value = values[i]
        k = int(i)
        while k > start and values[wp.max(k - 1, 0)] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value


@wp.kernel(enable_backward=False)
def sort_lists(step: Step, s: wp.array[Solver]):
    """Puts each body's contacts in order and names the other body of each; one thread a body."""
    body = wp.tid()
    static_slot = s[0].work.inv_mass.shape[0] - 1
    sort_part(
        s[0].colors.incident, s[0].colors.incident_start[body], s[0].colors.incident_start[body + 1]
    )
    for i in range(s[0].colors.incident_start[body], s[0].colors.incident_start[body + 1]):
        contact = s[0].colors.incident[i]
        slot0 = body_slot(s[0].shapes, step.contacts.shape0[contact], static_slot)
        slot1 = body_slot(s[0].shapes, step.contacts.shape1[contact], static_slot)
        partner = slot0 + slot1 - body
        s[0].colors.partner[i] = wp.where(s[0].work.inv_mass[partner] > 0.0, partner, -1)


@wp.func
def look_at(
    block: int,
    partner: int,
    side: int,
    used: wp.uint32,
    is_clashing: bool,
    colors: wp.ref[ColorWork],
):
    """Colors that neighbors use, and whether one comes before the block, with one more seen."""
    neighbor = colors.block[partner]
    theirs = colors.color[side, neighbor]
    if neighbor == block or theirs == COLORS:
        return used, is_clashing
    is_before = colors.priority[neighbor] > colors.priority[block]
    is_same = theirs == colors.color[side, block]
    return used | (wp.uint32(1) << wp.uint32(theirs)), is_clashing or (is_same and is_before)


@wp.kernel(enable_backward=False)
def color_blocks(side: int, is_last: int, s: wp.array[Solver]):
    """A pass of coloring, from ``side`` to the other one; one thread a body, for a first one."""
    block = wp.tid()
    if s[0].colors.block[block] != block:
        return
    mine = s[0].colors.color[side, block]
    used = wp.uint32(0)
    is_clashing = bool(mine == COLORS)
    first = s[0].worlds.rank[block]
    for rank in range(first, s[0].worlds.block_end[first]):
        body = s[0].worlds.bodies[rank]
        partner = int(-1)
        for i in range(s[0].colors.incident_start[body], s[0].colors.incident_start[body + 1]):
            if s[0].colors.partner[i] != partner:
                partner = s[0].colors.partner[i]
                if partner >= 0:
                    used, is_clashing = look_at(
                        block, partner, side, used, is_clashing, s[0].colors
                    )
        if s[0].loops.joints.shape[0] > 0:
            for i in range(s[0].loops.body_start[body], s[0].loops.body_start[body + 1]):
                partner = other_end(s[0].loops.items[i], s[0])
                if partner >= 0 and s[0].work.inv_mass[wp.max(partner, 0)] > 0.0:
                    used, is_clashing = look_at(
                        block, partner, side, used, is_clashing, s[0].colors
                    )
    if is_clashing:
        mine = COLORS
        if is_last == 0:
            mine = int(0)
            while mine < COLORS and (used & (wp.uint32(1) << wp.uint32(mine))) != wp.uint32(0):
                mine += 1
    s[0].colors.color[1 - side, block] = mine


@wp.func
def is_listed(body: int, colors: wp.ref[ColorWork]) -> bool:
    """Whether a body is the first of a block that something touches or holds."""
    if colors.block[body] != body:
        return False
    is_touched = colors.incident_start[body] < colors.incident_start[body + 1]
    return is_touched or colors.is_jointed[body] == 1


@wp.kernel(enable_backward=False)
def count_colors(s: wp.array[Solver]):
    """How many blocks of each color begin in a lane; one thread a lane."""
    lane = wp.tid()
    lanes = s[0].colors.lane_start.shape[0] - 1
    for color in range(COLORS + 1):
        s[0].colors.table[color * lanes + lane] = 0
    for i in range(s[0].colors.lane_start[lane], s[0].colors.lane_start[lane + 1]):
        body = s[0].worlds.bodies[i]
        if is_listed(body, s[0].colors):
            place = s[0].colors.color[0, body] * lanes + lane
            s[0].colors.table[place] = s[0].colors.table[place] + 1


@wp.kernel(enable_backward=False)
def list_colors(turns: wp.array[wp.int32], s: wp.array[Solver]):
    """Lists blocks color by color, and says in which order bodies take turns; a thread a lane."""
    lane = wp.tid()
    lanes = s[0].colors.lane_start.shape[0] - 1
    for color in range(COLORS + 1):
        s[0].colors.table[color * lanes + lane] = 0
    for i in range(s[0].colors.lane_start[lane], s[0].colors.lane_start[lane + 1]):
        body = s[0].worlds.bodies[i]
        if is_listed(body, s[0].colors):
            color = s[0].colors.color[0, body]
            place = color * lanes + lane
            s[0].colors.order[s[0].colors.start[place] + s[0].colors.table[place]] = body
            s[0].colors.table[place] = s[0].colors.table[place] + 1
            # a tree is eliminated from its last body to its first
            end = s[0].worlds.block_end[i]
            for k in range(i, end):
                turns[s[0].worlds.bodies[k]] = color * s[0].worlds.bodies.shape[0] + i + end - 1 - k


@wp.kernel(enable_backward=False)
def count_owned(s: wp.array[Solver]):
    """How many contacts each body owns: those in which it moves first; one thread a body."""
    body = wp.tid()
    count = int(0)
    for i in range(s[0].colors.incident_start[body], s[0].colors.incident_start[body + 1]):
        if is_owner(body, s[0].colors.partner[i], s[0].worlds):
            count += 1
    s[0].colors.count[body] = count
    # rows that others own: never more than the body has contacts
    s[0].rows.other_start[body] = s[0].colors.incident_start[body]
    s[0].rows.other_end[body] = s[0].colors.incident_start[body]


@wp.func
def is_owner(body: int, partner: int, worlds: wp.ref[WorldWork]) -> bool:
    """Whether a body moves before the other one of its contact."""
    return partner < 0 or is_visited_first(worlds, body, partner)
