# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Which piece of its law each axis of a tree is on, from sweep to sweep.

Elimination assumes a piece of each law (:mod:`.rows.axis`), and substitution finds which it should
have been.
"""

import warp as wp

from ..data import Solver
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows.joint import make_counts
from .anchors import is_linked
from .bodies import body_at, nonnegative

PATIENCE = wp.constant(3)
"""Sweeps that may fail to leave fewer axes on wrong pieces before one axis at a time moves on.
After the first of them the updates of the step are searched along where something on the axes has
a bound."""


def make_take_pieces(effects: Effects) -> wp.Function:
    """Device function: the next pieces after an update."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count

    @wp.func
    def take_pieces(first: int, end: int, wrong: int, has_dual: bool, s: wp.ref[Solver]) -> bool:
        """Puts the ``wrong`` axes of a tree on their next pieces: all of them, unless that has
        not led to fewer for a while. Then only one does so, and the others take the limit that
        their drive is at.

        Returns whether a stop is to hold that did not, or to let go.
        """
        is_stopping = bool(False)
        root = body_at(first, s.worlds)
        patience = s.tree.patience[root]
        if not has_dual or wrong < s.tree.fewest[root]:
            s.tree.fewest[root] = wrong
            # where updates are searched, those of the step go on to be
            is_searched = has_dual and patience < PATIENCE
            patience = wp.where(is_searched, PATIENCE - 1, PATIENCE)
        else:
            patience -= 1
        s.tree.patience[root] = patience
        left = int(wrong)
        if patience < 0:
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

    return take_pieces
