# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Piles: free bodies that contacts link are one block.

Body by body a load goes one contact further in each sweep and halves on the way: ten light boxes
under a heavy one do not feel it for dozens of sweeps. So all bodies of a pile move at once. Its
contacts make a graph; breadth first from what the ground carries, each body is linked to the one it
was reached from. The rows of a link act on the motion of the body against its parent's,

    d = delta - T delta_p,    Q = sum of k J^T J of the link's rows,

and elimination from the outermost bodies inwards solves the forest of links in time proportional to
its size. With H the block of a body and of what is linked behind it, less the link itself, what its
parent feels of both is

    Q - Q (H + Q)^-1 Q = H (H + Q)^-1 Q,

the two in series. Rows that are no link are seen by both bodies as if the other stood still, with
twice their curvature, which is an upper bound: (u_b - u_a)^2 <= 2 u_a^2 + 2 u_b^2.

Since nothing has to travel, the penalty of a link can be as large as the mass behind it asks for.
That of the rows which are no link would hold bodies back, so theirs is smaller. But what falls on a
body that hangs on four others has to be held by all of them: each body hands its mass, and what
rests on it, down to all bodies of lower levels that it touches, in equal shares.
"""

from dataclasses import dataclass

import warp as wp

from ..algebra.block import factor_block, solve_block
from ..blocks.tree import carried, handed_down, span_block, times_block
from ..data import NO_JOINT, ContactRow, PileWork, RowWork, Solver, Step, WorldScale
from ..effects import Effects
from ..rows import contact as contact_rows
from ..rows import spin as spin_rows
from .bodies import body_at, moved_by
from .crossing import SLICK, is_long
from .groups import ALONE, SUMMED, begin_groups, first_of, leave_group, make_move_groups, tie
from .needles import is_needle
from .rotations import place_body
from .scale import settled_update

ROOT = wp.constant(-1)
"""Parent of a body from which its pile was reached."""
OUTSIDE = wp.constant(-2)
"""Parent of a body that belongs to no pile."""
_UNSEEN = wp.constant(-3)

LINK_WEIGHT = wp.constant(0.3)
"""Weight of the mass behind a link against the effective mass of the link's rows."""
SHARE_WEIGHT = wp.constant(0.01)
"""Likewise, of its share, where a body rests on others than the one that it is linked to."""
ALONG = wp.constant(0.5)
"""Share of what holds a body that goes along the change of its momentum, squared, from which it has
stopped the body: what drags it by friction goes on."""


@wp.func
def in_pile(rows: wp.ref[RowWork], slot: int) -> bool:
    """Whether a body moves with a pile."""
    return rows.piles.parent[slot] >= ROOT


@wp.func
def is_link(row: ContactRow, rows: wp.ref[RowWork]) -> bool:
    """Whether the row belongs to the link of one of its bodies to the other."""
    return rows.piles.parent[row.b] == row.a or rows.piles.parent[row.a] == row.b


@wp.func
def is_in_group(row: ContactRow, rows: wp.ref[RowWork]) -> bool:
    """Whether both bodies of a row belong to the same group."""
    if not in_pile(rows, row.a) or not in_pile(rows, row.b):
        return False
    return rows.piles.group[row.a] == rows.piles.group[row.b]


@wp.func
def mass_to_hold(row: ContactRow, s: wp.ref[Solver]) -> float:
    """Mass by which a row is to be as stiff as its pile needs it [kg]."""
    piles = s.rows.piles
    if piles.parent[row.b] == row.a:
        return LINK_WEIGHT * piles.held[row.b]
    parent = piles.parent[row.a]
    if parent == row.b or (parent == ROOT and s.work.inv_mass[row.b] == 0.0):
        return LINK_WEIGHT * piles.held[row.a]
    if in_pile(s.rows, row.a) and in_pile(s.rows, row.b):
        if piles.level[row.a] != piles.level[row.b]:
            upper = wp.where(piles.level[row.a] > piles.level[row.b], row.a, row.b)
            return SHARE_WEIGHT * piles.held[upper] / float(piles.supports[upper])
    return 0.0


@wp.func
def lasting_share(row: ContactRow, s: wp.ref[Solver]) -> float:
    """Share of the force of a row that holds a pile which the next step can expect again."""
    if not in_pile(s.rows, row.a):
        return 1.0
    if s.work.inv_mass[row.b] == 0.0:
        # of a body that carries nothing its rows tell
        return wp.where(s.rows.piles.held[row.a] > 0.0, s.rows.piles.lasting[row.a], 1.0)
    if not in_pile(s.rows, row.b) or s.rows.piles.level[row.a] == s.rows.piles.level[row.b]:
        return 1.0
    is_upper = s.rows.piles.level[row.a] > s.rows.piles.level[row.b]
    return s.rows.piles.lasting[wp.where(is_upper, row.a, row.b)]


@wp.func
def supports(other: int, body: int, rows: wp.ref[RowWork]) -> bool:
    """Whether a body of the same pile lies on a lower level than another that touches it."""
    return in_pile(rows, other) and rows.piles.level[other] < rows.piles.level[body]


@wp.func
def has_joints(i: int, s: wp.ref[Solver]) -> bool:
    """Whether the i-th body moves with others that joints link to it."""
    if s.tree.joint[body_at(i, s.worlds)] != NO_JOINT or s.worlds.block_end[i] > i + 1:
        return True
    return i > 0 and s.worlds.block_end[i - 1] == i + 1


@wp.func
def row_count(body: int, rows: wp.ref[RowWork]) -> int:
    """Number of rows of a body."""
    owned = rows.owned_end[body] - rows.owned_start[body]
    return owned + rows.other_end[body] - rows.other_start[body]


@wp.func
def row_of(body: int, i: int, rows: wp.ref[RowWork]) -> int:
    """The i-th row of a body: first those it owns, then the others."""
    owned = rows.owned_end[body] - rows.owned_start[body]
    if i < owned:
        return rows.owned_start[body] + i
    return rows.other_rows[rows.other_start[body] + i - owned]


@wp.func
def is_grounded(body: int, gap: float, s: wp.ref[Solver]) -> bool:
    """Whether a body is at most ``gap`` [m] from something that the solver does not move."""
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        if s.work.inv_mass[s.rows.rows[i].b] == 0.0 and s.rows.rows[i].gap <= gap:
            return True
    return False


@wp.func
def reach(slot: int, parent: int, at: int, rows: wp.ref[RowWork]) -> int:
    """Links a body to its parent, and takes it into the group of that, if it has not been reached
    before; returns where to list more."""
    if rows.piles.parent[slot] != _UNSEEN:
        return at
    rows.piles.parent[slot] = parent
    rows.piles.level[slot] = 0
    rows.piles.group[slot] = slot
    rows.piles.tied[slot] = ALONE
    if parent >= 0:
        rows.piles.group[slot] = first_of(parent, rows.piles)
        rows.piles.level[slot] = rows.piles.level[parent] + 1
    rows.piles.order[at] = slot
    return at + 1


@wp.func
def meets(row: ContactRow, slop: float, s: wp.ref[Solver]) -> bool:
    """Whether two bodies touch, or would by the end of the step if nothing held them."""
    if row.gap <= slop or contact_rows.is_pushing(row):
        return True
    span = s.work.com[row.a] - s.work.com[row.b]
    u = contact_rows.slip(row, s.work.target[row.a], s.work.target[row.b], span)
    return row.gap + wp.dot(row.normal, u) <= slop


@wp.func
def are_one(a: int, b: int, piles: wp.ref[PileWork]) -> bool:
    """Whether two bodies belong to one group that has been tied."""
    first = first_of(a, piles)
    return piles.tied[first] != ALONE and first == first_of(b, piles)


@wp.func
def spread(at: int, end: int, slop: float, s: wp.ref[Solver]) -> int:
    """Links, breadth first, what the bodies listed from ``at`` to ``end`` touch, and counts what
    supports each; the new end."""
    rows = s.rows
    while at < end:
        body = rows.piles.order[at]
        count = int(0)
        before = int(-1)
        is_one = bool(False)
        for k in range(row_count(body, rows)):
            row = rows.rows[row_of(body, k, rows)]
            other = row.a + row.b - body
            if other != before:
                before = other
                span = s.work.com[other] - s.work.com[body]
                if row.mu != SLICK or not is_long(body, span, s):
                    # else rounding, by the span, would hide the parent's moment of inertia
                    end = reach(other, body, end, rows)
                if supports(other, body, rows):
                    count += 1
                is_one = not in_pile(rows, other) or is_link(row, rows)
                is_one = is_one or are_one(body, other, rows.piles)
            if not is_one:
                if meets(row, slop, s):
                    tie(body, other, rows.piles)
                    is_one = True
        rows.piles.supports[body] = count
        at += 1
    return end


@dataclass(frozen=True)
class PileFunctions:
    """Device functions for the piles of a world, which ``order`` lists from its first place on."""

    link_piles: wp.Function
    """Finds the piles of a world and the mass behind each link."""
    factor_piles: wp.Function
    """Eliminates the bodies of all piles, whose own blocks have been assembled."""
    sweep_piles: wp.Function
    """Moves all piles to the minimum of their quadratic model.

    Returns the square of how far that moved a body [m^2], a turn by its radius of gyration.
    """
    spend_impacts: wp.Function
    """Finds which share of what holds each body has stopped something and ends with the step."""


def make_piles(
    effects: Effects, gather: wp.Function, outer_block: wp.Function, coasting_increment: wp.Function
) -> PileFunctions:
    """Device functions that solve piles.

    ``gather`` sums what pulls a body, ``outer_block`` its inertia and what leads out of its group;
    ``coasting_increment`` says where it goes if nothing pulls it.
    """
    move_groups = make_move_groups(outer_block)

    @wp.func(inline=effects.inline)
    def link_piles(world: int, slop: float, s: wp.ref[Solver]):
        first = s.worlds.body_start[world]
        last = s.worlds.body_start[world + 1]
        for i in range(first, last):
            body = body_at(i, s.worlds)
            s.rows.piles.mass[body] = s.model.mass[body]
            is_free = s.work.inv_mass[body] > 0.0 and row_count(body, s.rows) > 0
            if wp.static(effects.joints):
                is_free = is_free and not has_joints(i, s)
            if wp.static(effects.needles):
                # what a link adds to the block hides the moment about the long axis
                is_free = is_free and not is_needle(body, wp.inf, s)
            s.rows.piles.parent[body] = wp.where(is_free, _UNSEEN, OUTSIDE)
        end = int(first)
        near = float(slop)
        for _ in range(2):
            # what the ground carries comes first: another body may be in the way of what falls
            at = int(end)
            for i in range(first, last):
                if is_grounded(body_at(i, s.worlds), near, s):
                    end = reach(body_at(i, s.worlds), ROOT, end, s.rows)
            end = spread(at, end, slop, s)
            near = wp.inf
        for i in range(first, last):
            # what the ground does not carry starts from its first body
            end = spread(end, reach(body_at(i, s.worlds), ROOT, end, s.rows), slop, s)
        at = int(end)
        while at > first:
            at -= 1
            body = s.rows.piles.order[at]
            if s.rows.piles.parent[body] >= 0:
                share = s.rows.piles.mass[body] / float(s.rows.piles.supports[body])
                before = int(-1)
                for k in range(row_count(body, s.rows)):
                    row = s.rows.rows[row_of(body, k, s.rows)]
                    other = row.a + row.b - body
                    if other != before and supports(other, body, s.rows):
                        s.rows.piles.mass[other] = s.rows.piles.mass[other] + share
                    before = other
        s.rows.piles.end[world] = end
        while at < end:
            body = s.rows.piles.order[at]
            parent = s.rows.piles.parent[body]
            mass = s.rows.piles.mass[body]
            if parent >= 0:
                whole = s.rows.piles.whole[parent]
                s.rows.piles.whole[body] = whole
                # of a pile that floats, the reduced mass of the two sides
                s.rows.piles.held[body] = wp.where(whole > 0.0, mass * (whole - mass) / whole, mass)
            else:
                on_ground = is_grounded(body, wp.inf, s)
                s.rows.piles.whole[body] = wp.where(on_ground, 0.0, mass)
                # a body that carries nothing is in the effective mass of its rows
                carries = on_ground and mass > s.model.mass[body]
                s.rows.piles.held[body] = wp.where(carries, mass, 0.0)
            at += 1

    @wp.func
    def link_block(body: int, s: wp.ref[Solver]):
        """Curvature of the rows that link a body to its parent, about its COM."""
        ll = wp.mat33(0.0)
        al = wp.mat33(0.0)
        aa = wp.mat33(0.0)
        parent = s.rows.piles.parent[body]
        for i in range(row_count(body, s.rows)):
            k = row_of(body, i, s.rows)
            row = s.rows.rows[k]
            if row.a + row.b - body == parent:
                arm = row.arm + (s.work.com[row.a] - s.work.com[body])
                ll, al, aa = contact_rows.curvature(row, arm, ll, al, aa)
                if wp.static(effects.angular_friction):
                    aa += spin_rows.curvature(s.rows.spin[k], row.normal)
        return ll, al, aa

    @wp.func(inline=effects.inline)
    def factor_piles(world: int, s: wp.ref[Solver]):
        piles = s.rows.piles
        begin_groups(world, s)
        at = int(piles.end[world])
        while at > s.worlds.body_start[world]:
            at -= 1
            body = piles.order[at]
            parent = piles.parent[body]
            h_ll = piles.ll[body]
            h_al = piles.al[body]
            h_aa = piles.aa[body]
            if parent < 0:
                s.work.factor[body] = factor_block(h_ll, h_al, h_aa)
            else:
                q_ll, q_al, q_aa = link_block(body, s)
                piles.link_ll[body] = q_ll
                piles.link_al[body] = q_al
                piles.link_aa[body] = q_aa
                factor = factor_block(h_ll + q_ll, h_al + q_al, h_aa + q_aa)
                s.work.factor[body] = factor
                ll = wp.mat33(0.0)
                al = wp.mat33(0.0)
                aa = wp.mat33(0.0)
                for axis in range(3):
                    unit = wp.vec3(0.0)
                    unit[axis] = 1.0
                    along = solve_block(factor, q_ll * unit, q_al * unit)
                    around = solve_block(factor, wp.transpose(q_al) * unit, q_aa * unit)
                    along = times_block(h_ll, h_al, h_aa, along)
                    around = times_block(h_ll, h_al, h_aa, around)
                    ll += wp.outer(wp.spatial_top(along), unit)
                    al += wp.outer(wp.spatial_bottom(along), unit)
                    aa += wp.outer(wp.spatial_bottom(around), unit)
                # symmetric but for rounding
                ll = 0.5 * (ll + wp.transpose(ll))
                aa = 0.5 * (aa + wp.transpose(aa))
                ll, al, aa = span_block(s.work.com[body] - s.work.com[parent], ll, al, aa)
                piles.ll[parent] = piles.ll[parent] + ll
                piles.al[parent] = piles.al[parent] + al
                piles.aa[parent] = piles.aa[parent] + aa

    @wp.func
    def link_wrench(
        body: int, motion: wp.spatial_vector, rows: wp.ref[RowWork]
    ) -> wp.spatial_vector:
        """Wrench that a motion in its link makes at the COM of a body."""
        piles = rows.piles
        return times_block(piles.link_ll[body], piles.link_al[body], piles.link_aa[body], motion)

    @wp.func(inline=effects.inline)
    def sweep_piles(
        world: int,
        has_dual: bool,
        recovery: float,
        scale: WorldScale,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        first = s.worlds.body_start[world]
        end = s.rows.piles.end[world]
        if end == first:
            return 0.0
        # in the order of visits, which says who owns a row and updates it
        for i in range(first, s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if in_pile(s.rows, body):
                s.rows.piles.push[body] = gather(
                    body, has_dual, recovery, scale.slop, scale.step, step, s
                )
        farthest = float(0.0)
        if recovery == 0.0:
            farthest = move_groups(world, settled_update(scale), scale.step, step, s)
        at = int(end)
        while at > first:
            at -= 1
            body = s.rows.piles.order[at]
            parent = s.rows.piles.parent[body]
            push = s.rows.piles.push[body]
            alone = solve_block(s.work.factor[body], wp.spatial_top(push), wp.spatial_bottom(push))
            s.rows.piles.update[body] = alone
            if parent >= 0:
                span = s.work.com[body] - s.work.com[parent]
                load = handed_down(span, link_wrench(body, alone, s.rows))
                s.rows.piles.push[parent] = s.rows.piles.push[parent] + load
        while at < end:
            body = s.rows.piles.order[at]
            parent = s.rows.piles.parent[body]
            update = s.rows.piles.update[body]
            if parent >= 0:
                span = s.work.com[body] - s.work.com[parent]
                pull = link_wrench(body, carried(span, s.rows.piles.update[parent]), s.rows)
                update += solve_block(
                    s.work.factor[body], wp.spatial_top(pull), wp.spatial_bottom(pull)
                )
                s.rows.piles.update[body] = update
            s.work.increment[body] = s.work.increment[body] + update
            if wp.static(effects.loops):
                place_body(body, s)
            moved = moved_by(body, update, s.work)
            if s.rows.piles.tied[s.rows.piles.group[body]] == SUMMED:
                leave_group(body, moved, s.rows.piles)
            farthest = wp.max(farthest, moved)
            at += 1
        return farthest

    @wp.func
    def spend_impacts(
        world: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ):
        """What holds a body and what rests on it, f, makes the change c of their momentum, less
        what pulls them. The part |c|^2 / (f.c) of f ends with the step; where f goes across c for
        the most part, f.c / |f|^2."""
        piles = s.rows.piles
        first = s.worlds.body_start[world]
        at = int(piles.end[world])
        least = contact_rows.STRUCK * scale.gravity * scale.step * scale.step
        for i in range(first, at):
            body = piles.order[i]
            mass = s.model.mass[body]
            coasting = coasting_increment(s.work, body_qd, body, scale.step)
            change = mass * wp.spatial_top(s.work.increment[body] - coasting)
            pull = mass * wp.spatial_top(s.work.target[body] - coasting)
            s.rows.piles.update[body] = wp.spatial_vector(change, pull)
        while at > first:
            at -= 1
            body = piles.order[at]
            handed = piles.update[body]
            change = wp.spatial_top(handed)
            along = wp.dot(change, change - wp.spatial_bottom(handed))
            spent = float(0.0)
            if along > 0.0 and wp.length(change) > least * piles.mass[body]:
                force = change - wp.spatial_bottom(handed)
                spent = along / wp.length_sq(force)
                if along * along > ALONG * wp.length_sq(change) * wp.length_sq(force):
                    spent = wp.length_sq(change) / along
            s.rows.piles.lasting[body] = wp.max(1.0 - spent, 0.0)
            if piles.supports[body] > 0:
                share = handed / float(piles.supports[body])
                before = int(-1)
                for k in range(row_count(body, s.rows)):
                    row = s.rows.rows[row_of(body, k, s.rows)]
                    other = row.a + row.b - body
                    if other != before and supports(other, body, s.rows):
                        s.rows.piles.update[other] = s.rows.piles.update[other] + share
                    before = other

    return PileFunctions(link_piles, factor_piles, sweep_piles, spend_impacts)
