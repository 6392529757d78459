# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Colors of the bodies of large worlds: bodies in contact with each other differ in color.

Each step starts from the last one's colors. In a pass, a body takes the lowest color that none of
its neighbors has, if one of higher priority has the same (speculative coloring: Gebremedhin, Manne,
2000; priorities are random and fixed, as in Jones, Plassmann, 1993). Neighbors that change at once
may meet again, and try again; one that has no clash left never changes, since all others avoid its
color. Who clashes after the last pass goes to a last group, whose bodies move one
after the other. So no two bodies in contact ever move at once, and the colors follow from the
contacts and the colors before alone.
"""

import warp as wp

from ..data import BodyWork, ColorWork, ContactInput, RowWork, ShapeModel, WorldWork
from .contacts import body_slot, is_across, is_selected, report_dropped

COLORS = 12
"""Colors. Walls and piles take six or seven; a body whose neighbors have them all goes to the last
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
def count_contacts(
    # Model:
    shapes: ShapeModel,
    # Contacts in:
    contacts: ContactInput,
    # Work:
    worlds: WorldWork,
    work: BodyWork,
    # Work out:
    rows: RowWork,
    colors: ColorWork,
):
    """How many contacts each body has; one thread a place in the contact buffer."""
    contact = wp.tid()
    static_slot = work.inv_mass.shape[0] - 1
    count = contacts.count[0]
    if contact == 0:
        worlds.overflow[0] = wp.max(worlds.overflow[0], count - contacts.capacity)
    rows.owner[contact] = -1
    if contact >= count:
        return
    shape0 = contacts.shape0[contact]
    shape1 = contacts.shape1[contact]
    if wp.min(shape0, shape1) < 0 or wp.max(shape0, shape1) >= shapes.body.shape[0]:
        report_dropped(worlds, contact)
        return
    slot0 = body_slot(shapes, shape0, static_slot)
    slot1 = body_slot(shapes, shape1, static_slot)
    if is_across(worlds, work, slot0, slot1):
        report_dropped(worlds, contact)
        return
    if slot0 == slot1:
        return
    for side in range(2):
        slot = wp.where(side == 0, slot0, slot1)
        if work.inv_mass[slot] > 0.0:
            rows.owner[contact] = slot
            wp.atomic_add(colors.count, slot, 1)


@wp.kernel(enable_backward=False)
def list_contacts(
    # Model:
    shapes: ShapeModel,
    # Contacts in:
    contacts: ContactInput,
    # Work:
    work: BodyWork,
    rows: RowWork,
    # Work out:
    colors: ColorWork,
):
    """Lists the contacts of each body, in no order; one thread a place in the contact buffer."""
    contact = wp.tid()
    if rows.owner[contact] < 0:
        return
    static_slot = work.inv_mass.shape[0] - 1
    slot0 = body_slot(shapes, contacts.shape0[contact], static_slot)
    slot1 = body_slot(shapes, contacts.shape1[contact], static_slot)
    for side in range(2):
        slot = wp.where(side == 0, slot0, slot1)
        if work.inv_mass[slot] > 0.0:
            left = wp.atomic_add(colors.count, slot, -1)
            colors.incident[colors.incident_start[slot + 1] - left] = contact


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
def sort_lists(
    # Model:
    shapes: ShapeModel,
    # Contacts in:
    contacts: ContactInput,
    # Work:
    work: BodyWork,
    # Work out:
    colors: ColorWork,
):
    """Puts each body's contacts in order and names the other body of each; one thread a body."""
    body = wp.tid()
    static_slot = work.inv_mass.shape[0] - 1
    sort_part(colors.incident, colors.incident_start[body], colors.incident_start[body + 1])
    for i in range(colors.incident_start[body], colors.incident_start[body + 1]):
        contact = colors.incident[i]
        slot0 = body_slot(shapes, contacts.shape0[contact], static_slot)
        slot1 = body_slot(shapes, contacts.shape1[contact], static_slot)
        partner = slot0 + slot1 - body
        colors.partner[i] = wp.where(work.inv_mass[partner] > 0.0, partner, -1)


@wp.kernel(enable_backward=False)
def color_bodies(
    # In:
    side: int,
    is_last: int,
    # Work out:
    colors: ColorWork,
):
    """A pass of coloring, from ``side`` to the other one; one thread a body."""
    body = wp.tid()
    mine = colors.color[side, body]
    used = wp.uint32(0)
    is_clashing = bool(mine == COLORS)
    partner = int(-1)
    for i in range(colors.incident_start[body], colors.incident_start[body + 1]):
        if colors.partner[i] != partner:
            partner = colors.partner[i]
            if partner >= 0:
                theirs = colors.color[side, partner]
                if theirs < COLORS:
                    used = used | (wp.uint32(1) << wp.uint32(theirs))
                    is_clashing = is_clashing or (
                        theirs == mine and colors.priority[partner] > colors.priority[body]
                    )
    if is_clashing:
        mine = COLORS
        if is_last == 0:
            mine = int(0)
            while mine < COLORS and (used & (wp.uint32(1) << wp.uint32(mine))) != wp.uint32(0):
                mine += 1
    colors.color[1 - side, body] = mine


@wp.kernel(enable_backward=False)
def count_colors(
    # Work:
    worlds: WorldWork,
    # Work out:
    colors: ColorWork,
):
    """How many bodies of each color a lane has; one thread a lane."""
    lane = wp.tid()
    lanes = colors.lane_start.shape[0] - 1
    for color in range(COLORS + 1):
        colors.table[color * lanes + lane] = 0
    for i in range(colors.lane_start[lane], colors.lane_start[lane + 1]):
        body = worlds.bodies[i]
        if colors.incident_start[body] < colors.incident_start[body + 1]:
            place = colors.color[0, body] * lanes + lane
            colors.table[place] = colors.table[place] + 1


@wp.kernel(enable_backward=False)
def list_colors(
    # Work out:
    worlds: WorldWork,
    colors: ColorWork,
):
    """Lists the bodies color by color, and ranks them in this order; one thread a lane."""
    lane = wp.tid()
    lanes = colors.lane_start.shape[0] - 1
    for color in range(COLORS + 1):
        colors.table[color * lanes + lane] = 0
    for i in range(colors.lane_start[lane], colors.lane_start[lane + 1]):
        body = worlds.bodies[i]
        if colors.incident_start[body] < colors.incident_start[body + 1]:
            place = colors.color[0, body] * lanes + lane
            position = colors.start[place] + colors.table[place]
            colors.table[place] = colors.table[place] + 1
            colors.order[position] = body
            worlds.rank[body] = position


@wp.kernel(enable_backward=False)
def count_owned(
    # Work:
    worlds: WorldWork,
    # Work out:
    rows: RowWork,
    colors: ColorWork,
):
    """How many contacts each body owns: those in which it moves first; one thread a body."""
    body = wp.tid()
    count = int(0)
    for i in range(colors.incident_start[body], colors.incident_start[body + 1]):
        if is_owner(body, colors.partner[i], worlds):
            count += 1
    colors.count[body] = count
    # rows that others own: never more than the body has contacts
    rows.other_start[body] = colors.incident_start[body]
    rows.other_end[body] = colors.incident_start[body]


@wp.func
def is_owner(body: int, partner: int, worlds: wp.ref[WorldWork]) -> bool:
    """Whether a body moves before the other one of its contact."""
    return partner < 0 or worlds.rank[body] < worlds.rank[partner]
