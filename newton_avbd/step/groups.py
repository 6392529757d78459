# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Groups: bodies that contacts tie to each other move at once by the motion that they share.

A forest links each body of a pile to one other. The rest of its rows both bodies see as if the
other stood still. So where a row of boxes is pushed, or a wall stands on a cart, each body is held
back by the next, and a sweep moves all of them by a part only of what is asked for. Hence a sweep
first moves the bodies of a group, which such rows tie where they touch, or would by the end of the
step, together: to the minimum of the quadratic model over a rigid motion delta about the COM of its
first body,

    (sum of T^T (M/h^2 + K) T) delta = sum of T^T w.

There w is what pulls a body, M its inertia, T delta its motion, and K the curvature of those of its
rows that lead out of the group: the others do not see that motion. In multigrid methods this is the
correction on the coarse grid.
"""

import warp as wp

from ..algebra.block import factor_block, solve_block
from ..blocks.tree import carried, handed_down, span_block, times_block
from ..data import PileWork, Solver, Step
from .bodies import moved_by

ALONE = wp.constant(0)
"""Of a group: the forest solves it exactly, or what its bodies share is settled in this step."""
TIED = wp.constant(1)
"""It has rows that touch and are no links."""
PUSHED = wp.constant(2)
"""Likewise, and enough pulls it that its block has to be summed."""
SUMMED = wp.constant(3)
"""Likewise, and that has been done."""
LITTLE = wp.constant(0.1)
"""Share of what a sweep moves one of its bodies, squared, below which a group moves no more in the
step. With a tenth of it sweeps of a heap take a fifth longer, and nothing that is pushed gets
closer."""


@wp.func
def first_of(slot: int, piles: wp.ref[PileWork]) -> int:
    """First body of the group that a body of a pile belongs to."""
    first = int(slot)
    while piles.group[first] != first:
        first = piles.group[first]
    return first


@wp.func
def tie(a: int, b: int, piles: wp.ref[PileWork]):
    """Makes one group of those of two bodies, which a row ties that is no link."""
    first = first_of(a, piles)
    other = first_of(b, piles)
    if other < first:
        first, other = other, first
    piles.group[other] = first
    piles.tied[first] = TIED


@wp.func
def begin_groups(world: int, s: wp.ref[Solver]):
    """Lists each body with the first of its group; blocks are to be summed."""
    piles = s.rows.piles
    for i in range(s.worlds.body_start[world], piles.end[world]):
        body = piles.order[i]
        first = first_of(body, piles)
        if piles.tied[first] != ALONE:
            piles.tied[first] = TIED
        piles.group[body] = first


@wp.func
def leave_group(body: int, moved: float, piles: wp.ref[PileWork]):
    """Moves a group no more in this step where a sweep has moved one of its bodies, by so much
    squared [m^2], that much farther than what all share."""
    first = piles.group[body]
    if piles.shared[first] < LITTLE * moved:
        piles.tied[first] = ALONE


@wp.func
def clear_block(first: int, piles: wp.ref[PileWork]):
    """Begins the sum of a group's block."""
    piles.link_ll[first] = wp.mat33(0.0)
    piles.link_al[first] = wp.mat33(0.0)
    piles.link_aa[first] = wp.mat33(0.0)


@wp.func
def add_to_block(
    first: int, span: wp.vec3, ll: wp.mat33, al: wp.mat33, aa: wp.mat33, piles: wp.ref[PileWork]
):
    """Adds the block of one of its bodies, which ``span`` leads to, to that of a group."""
    ll, al, aa = span_block(span, ll, al, aa)
    piles.link_ll[first] = piles.link_ll[first] + ll
    piles.link_al[first] = piles.link_al[first] + al
    piles.link_aa[first] = piles.link_aa[first] + aa


@wp.func
def group_motion(first: int, piles: wp.ref[PileWork]) -> wp.spatial_vector:
    """Motion at which the block of a group holds what pulls it."""
    factor = factor_block(piles.link_ll[first], piles.link_al[first], piles.link_aa[first])
    push = piles.update[first]
    return solve_block(factor, wp.spatial_top(push), wp.spatial_bottom(push))


def make_move_groups(outer_block: wp.Function) -> wp.Function:
    """Device function that moves the bodies of each group together.

    ``outer_block`` sums a body's inertia and all that leads out of its group.
    """

    @wp.func
    def sum_pushes(world: int, h: float, s: wp.ref[Solver]) -> bool:
        """Sums what pulls each group, and its inertia; returns whether there is one."""
        piles = s.rows.piles
        begin = s.worlds.body_start[world]
        end = piles.end[world]
        are_tied = bool(False)
        for i in range(begin, end):
            body = piles.order[i]
            if piles.group[body] == body and piles.tied[body] != ALONE:
                are_tied = True
                piles.shared[body] = 0.0
                piles.update[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
                if piles.tied[body] == TIED:
                    clear_block(body, piles)
        if not are_tied:
            return False
        inv_h2 = 1.0 / (h * h)
        for i in range(begin, end):
            body = piles.order[i]
            first = piles.group[body]
            if piles.tied[first] != ALONE:
                span = s.work.com[body] - s.work.com[first]
                piles.update[first] = piles.update[first] + handed_down(span, piles.push[body])
                if piles.tied[first] == TIED:
                    mass = wp.diag(wp.vec3(inv_h2 * s.model.mass[body]))
                    inertia = inv_h2 * s.work.inertia[body]
                    add_to_block(first, span, mass, wp.mat33(0.0), inertia, piles)
        return True

    @wp.func
    def sum_blocks(world: int, enough: float, h: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """Sums the blocks of groups that could move farther than ``enough`` [m]."""
        piles = s.rows.piles
        begin = s.worlds.body_start[world]
        end = piles.end[world]
        are_pushed = bool(False)
        for i in range(begin, end):
            body = piles.order[i]
            if piles.group[body] == body and piles.tied[body] == TIED:
                # held by nothing it would move so far, on the average of its mass
                farthest = wp.dot(piles.update[body], group_motion(body, piles))
                if farthest > enough * enough * piles.link_ll[body][0, 0]:
                    are_pushed = True
                    piles.tied[body] = PUSHED
                    clear_block(body, piles)
        if not are_pushed:
            return
        for i in range(begin, end):
            body = piles.order[i]
            first = piles.group[body]
            if piles.tied[first] == PUSHED:
                ll, al, aa = outer_block(body, h, step, s)
                piles.ll[body] = ll
                piles.al[body] = al
                piles.aa[body] = aa
                add_to_block(first, s.work.com[body] - s.work.com[first], ll, al, aa, piles)

    @wp.func
    def move_groups(
        world: int, enough: float, h: float, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> float:
        """Takes what that changes off the push on each body; returns the square of how far one of
        them has moved [m^2]. A group stays that nothing could move farther than ``enough`` [m]."""
        if not sum_pushes(world, h, s):
            return 0.0
        sum_blocks(world, enough, h, step, s)
        piles = s.rows.piles
        begin = s.worlds.body_start[world]
        end = piles.end[world]
        for i in range(begin, end):
            body = piles.order[i]
            if piles.group[body] == body and piles.tied[body] >= PUSHED:
                piles.tied[body] = SUMMED
                piles.update[body] = group_motion(body, piles)
        farthest = float(0.0)
        for i in range(begin, end):
            body = piles.order[i]
            first = piles.group[body]
            if piles.tied[first] == SUMMED:
                motion = carried(s.work.com[body] - s.work.com[first], piles.update[first])
                s.work.increment[body] = s.work.increment[body] + motion
                change = times_block(piles.ll[body], piles.al[body], piles.aa[body], motion)
                piles.push[body] = piles.push[body] - change
                moved = moved_by(body, motion, s.work)
                piles.shared[first] = wp.max(piles.shared[first], moved)
                farthest = wp.max(farthest, moved)
        return farthest

    return move_groups
