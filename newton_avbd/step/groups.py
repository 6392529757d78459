# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Groups: bodies that contacts tie to each other move at once by the motion that they share.

A forest links each body of a pile to one other. The rest of its rows both bodies see as if the
other stood still. So where a row of boxes is pushed, or a wall stands on a cart, each body is held
back by the next, and a sweep moves all of them by a part only of what is asked for. Hence a sweep
first moves the bodies of a group, which such rows tie that pushed in the last step, together: to
the minimum of the quadratic model over a rigid motion delta about the COM of its first body,

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
"""It has rows that push and are no links."""
SUMMED = wp.constant(2)
"""Likewise, and its block has been summed."""
LITTLE = wp.constant(0.1)
"""Share of what a sweep moves, squared, below which a world's groups move no more in the step.
With a tenth of it sweeps of a heap take a fifth longer, and nothing that is pushed gets closer."""


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
def end_groups(world: int, s: wp.ref[Solver]):
    """Moves the groups of a world no more in this step."""
    for i in range(s.worlds.body_start[world], s.rows.piles.end[world]):
        s.rows.piles.tied[s.rows.piles.order[i]] = ALONE


def make_move_groups(outer_block: wp.Function) -> wp.Function:
    """Device function that moves the bodies of each group together.

    ``outer_block`` sums a body's inertia and all that leads out of its group.
    """

    @wp.func
    def move_groups(world: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]) -> float:
        """Takes what that changes off the push on each body; returns the square of how far one of
        them has moved [m^2]."""
        piles = s.rows.piles
        begin = s.worlds.body_start[world]
        end = piles.end[world]
        are_tied = bool(False)
        for i in range(begin, end):
            body = piles.order[i]
            if piles.group[body] == body and piles.tied[body] != ALONE:
                are_tied = True
                piles.update[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
                if piles.tied[body] == TIED:
                    piles.link_ll[body] = wp.mat33(0.0)
                    piles.link_al[body] = wp.mat33(0.0)
                    piles.link_aa[body] = wp.mat33(0.0)
        if not are_tied:
            return 0.0
        for i in range(begin, end):
            body = piles.order[i]
            first = piles.group[body]
            if piles.tied[first] != ALONE:
                span = s.work.com[body] - s.work.com[first]
                piles.update[first] = piles.update[first] + handed_down(span, piles.push[body])
                if piles.tied[first] == TIED:
                    ll, al, aa = outer_block(body, h, step, s)
                    ll, al, aa = span_block(span, ll, al, aa)
                    piles.link_ll[first] = piles.link_ll[first] + ll
                    piles.link_al[first] = piles.link_al[first] + al
                    piles.link_aa[first] = piles.link_aa[first] + aa
        for i in range(begin, end):
            body = piles.order[i]
            if piles.group[body] == body and piles.tied[body] != ALONE:
                piles.tied[body] = SUMMED
                factor = factor_block(piles.link_ll[body], piles.link_al[body], piles.link_aa[body])
                push = piles.update[body]
                piles.update[body] = solve_block(
                    factor, wp.spatial_top(push), wp.spatial_bottom(push)
                )
        farthest = float(0.0)
        for i in range(begin, end):
            body = piles.order[i]
            first = piles.group[body]
            if piles.tied[first] != ALONE:
                motion = carried(s.work.com[body] - s.work.com[first], piles.update[first])
                s.work.increment[body] = s.work.increment[body] + motion
                ll, al, aa = outer_block(body, h, step, s)
                piles.push[body] = piles.push[body] - times_block(ll, al, aa, motion)
                farthest = wp.max(farthest, moved_by(body, motion, s.work))
        return farthest

    return move_groups
