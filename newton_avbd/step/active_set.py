# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Which piece of its law each axis of a tree is on, from sweep to sweep.

Elimination assumes a piece of each law (:mod:`.rows.axis`), and substitution finds which it should
have been.
"""

from dataclasses import dataclass

import warp as wp

from ..data import Solver
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows.joint import make_counts
from .anchors import is_linked
from .bodies import body_at, nonnegative

PATIENCE = wp.constant(3)
"""Sweeps that may fail to leave fewer axes on wrong pieces before one axis at a time moves on.
After the first of them updates are searched along where something on the axes has a bound."""
SEARCHES = wp.constant(8)
"""Bisections of the share of an update at which the energy along it is least."""


@dataclass(frozen=True)
class ActiveSetFunctions:
    """Device functions of the pieces that the axes of a tree are on."""

    least_energy: wp.Function
    take_pieces: wp.Function


def make_active_set(effects: Effects) -> ActiveSetFunctions:
    """Device functions: a search along an update, and the next pieces after it."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count

    @wp.func
    def least_energy(
        first: int, end: int, curvature: float, held_work: float, s: wp.ref[Solver]
    ) -> float:
        """Share of a tree's update at which the energy along it is least.

        The next pieces of the laws become those at that share.

        The energy is convex where only drives, their limits and friction are not quadratic: its
        slope is that of the model, (s - 1) d^T H d, but for those that are not on their assumed
        pieces. So the iteration goes downhill (Newton's method with an exact search, as in MuJoCo's
        solver).
        """
        share = float(1.0)
        for search in range(SEARCHES):
            slope = (share - 1.0) * curvature + held_work
            for i in range(first, end):
                body = s.worlds.bodies[i]
                if is_linked(body, s):
                    joint = s.tree.joint[body]
                    start = s.tree.axis_start[body]
                    dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
                    for k in range(start, start + dofs):
                        law = s.tree.laws[k]
                        step = s.tree.axes[k].step
                        slope += step * axis_rows.excess_force(law, step, share)
                        s.tree.laws[k].next = axis_rows.piece_before(law, share * step, share)
            if slope <= 0.0:
                if search == 0:
                    return 1.0
                share += 1.0 / float(1 << (search + 1))
            else:
                share -= 1.0 / float(1 << (search + 1))
        return share

    @wp.func
    def take_pieces(first: int, end: int, wrong: int, has_dual: bool, s: wp.ref[Solver]) -> bool:
        """Puts the ``wrong`` axes of a tree on their next pieces: all of them, unless that has
        not led to fewer for a while. Then only one does so, and the others take the limit that
        their drive is at.

        Returns whether a stop is to hold that did not, or to let go.
        """
        is_stopping = bool(False)
        root = body_at(first, s.worlds)
        if not has_dual or wrong < s.tree.fewest[root]:
            s.tree.fewest[root] = wrong
            s.tree.patience[root] = PATIENCE
        else:
            s.tree.patience[root] = s.tree.patience[root] - 1
        left = int(wrong)
        if s.tree.patience[root] < 0:
            left = 1
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if is_linked(body, s):
                joint = s.tree.joint[body]
                for dof in range(linear_count(s.joints, joint) + angular_count(s.joints, joint)):
                    index = nonnegative(s.joints.dof_start[joint] + dof)
                    law = s.tree.laws[s.tree.axis_start[body] + dof]
                    piece = law.piece
                    if law.next[0] != piece[0]:
                        is_stopping = True
                    if wp.static(effects.bounded_axes):
                        piece[1] = law.next[1]
                    if left > 0 and not (law.next == piece):
                        piece = law.next
                        left -= 1
                    if wp.static(effects.joint_friction):
                        if piece[2] == axis_rows.YIELDING:
                            piece[2] = 0
                    s.history.piece[index] = piece
        return is_stopping

    return ActiveSetFunctions(least_energy, take_pieces)
