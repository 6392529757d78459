# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How far a tree goes along its update: to where the energy along it is least.

Newton's method with a search for where the slope along the update vanishes, as in MuJoCo's solver.
"""

import warp as wp

from ..data import Solver
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows import contact as contact_rows
from ..rows.joint import make_counts
from .anchors import is_linked
from .bodies import body_at
from .gathering import ContactLaw, is_same_block, make_block_stiffness
from .substitute import Misplaced

SEARCHES = wp.constant(20)
"""Most guesses of the share of an update at which the energy along it is least."""
LEVEL = wp.constant(0.1)
"""Slope there that counts as none, as a share of that at the start."""
AXES_LEVEL = wp.constant(1.0e-2)
"""Likewise where axes are searched: a stiff drive goes from limit to limit within a milliradian, of
an update of a radian."""


def make_contact_excess(effects: Effects, law: ContactLaw) -> wp.Function:
    """Device function: what contacts of a body push with along an update, beyond its model."""
    contact_force, gap_of = law.force, law.gap
    block_stiffness = make_block_stiffness(law)

    @wp.func
    def moved_point(body: int, arm: wp.vec3, s: wp.ref[Solver]) -> wp.vec3:
        """How far the update of a body moves a point of it [m]."""
        update = s.tree.update[body]
        return wp.spatial_top(update) + wp.cross(wp.spatial_bottom(update), arm)

    @wp.func
    def excess_of_row(
        i: int, share: float, recovery: float, slop: float, is_other: bool, s: wp.ref[Solver]
    ) -> float:
        """That of a row [J], after a share of the update of its owner's tree, or the other's."""
        row = s.rows.rows[i]
        span = s.work.com[row.a] - s.work.com[row.b]
        u = contact_rows.slip(row, s.work.increment[row.a], s.work.increment[row.b], span)
        if wp.static(effects.drift):
            u += s.rows.drift[i]
        gap = gap_of(row.gap, recovery, slop)
        if wp.static(effects.recovers_by_duals):
            if recovery > 0.0:
                gap += s.rows.left[i]
        k = block_stiffness(row, u, gap, s)
        moved = wp.vec3(0.0)
        of_model = float(0.0)
        if is_other:
            moved = moved_point(row.b, row.arm + span, s)
            of_model = wp.dot(moved, k * moved)
        else:
            back = moved_point(row.a, row.arm, s)
            moved = -back
            of_model = wp.dot(back, k * back)
            if is_same_block(s.worlds, row.a, row.b):
                ahead = moved_point(row.b, row.arm + span, s)
                moved += ahead
                of_model += wp.dot(ahead, k * ahead)
        more = contact_force(row, u + share * moved, gap) - contact_force(row, u, gap)
        return share * of_model + wp.dot(more, moved)

    @wp.func
    def contact_excess(
        body: int, share: float, recovery: float, slop: float, s: wp.ref[Solver]
    ) -> float:
        """Work along the update of the body's tree [J], of all rows at a share of it."""
        excess = float(0.0)
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            excess += excess_of_row(i, share, recovery, slop, False, s)
        if wp.static(effects.pairs):
            for i in range(s.rows.other_start[body], s.rows.other_end[body]):
                other = s.rows.other_rows[i]
                if not is_same_block(s.worlds, s.rows.rows[other].a, body):
                    excess += excess_of_row(other, share, recovery, slop, True, s)
        return excess

    return contact_excess


def make_least_energy(effects: Effects, law: ContactLaw) -> wp.Function:
    """Device function: a search along the update of a tree."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    contact_excess = make_contact_excess(effects, law)

    @wp.func
    def axis_excess(body: int, share: float, s: wp.ref[Solver]) -> float:
        """What axes of a body push with along its update, beyond their assumed pieces [J]."""
        excess = float(0.0)
        if is_linked(body, s):
            joint = s.tree.joint[body]
            start = s.tree.axis_start[body]
            dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
            for k in range(start, start + dofs):
                step = s.tree.axes[k].step
                excess += step * axis_rows.excess_force(s.tree.laws[k], step, share)
        return excess

    @wp.func
    def note_pieces(first: int, end: int, share: float, s: wp.ref[Solver]):
        """Makes the next pieces of axes those that they are on after a share of an update."""
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if is_linked(body, s):
                joint = s.tree.joint[body]
                start = s.tree.axis_start[body]
                dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
                for k in range(start, start + dofs):
                    step = share * s.tree.axes[k].step
                    s.tree.laws[k].next = axis_rows.piece_before(s.tree.laws[k], step, share)

    @wp.func
    def least_energy(
        first: int,
        end: int,
        found: wp.ref[Misplaced],
        are_axes_searched: bool,
        recovery: float,
        slop: float,
        s: wp.ref[Solver],
    ) -> float:
        """Share of a tree's update at which the energy along it is least.

        The energy is convex where only drives, their limits, friction and contacts are not
        quadratic: its slope is that of the model, (s - 1) d^T H d, but for those that are not on
        their assumed pieces.
        """
        share = float(1.0)
        low, high = float(0.0), float(1.0)
        slope_low, slope_high = float(-found.curvature), float(0.0)
        level = wp.where(are_axes_searched, AXES_LEVEL, LEVEL) * found.curvature
        for search in range(SEARCHES):
            slope = (share - 1.0) * found.curvature
            if are_axes_searched:
                slope += found.held_work
            for i in range(first, end):
                body = body_at(i, s.worlds)
                if wp.static(effects.bounded_axes):
                    if are_axes_searched:
                        slope += axis_excess(body, share, s)
                if wp.static(effects.contact):
                    if s.tree.is_touched[body] and s.work.inv_mass[body] > 0.0:
                        slope -= contact_excess(body, share, recovery, slop, s)
            if (search == 0 and slope <= 0.0) or wp.abs(slope) < level:
                break
            # the slope jumps where axes have friction: halves; else false position, and what stays
            # twice counts half (Illinois)
            if slope <= 0.0:
                low = share
                slope_low = slope
                slope_high *= 0.5
            else:
                high = share
                slope_high = slope
                if search > 0:
                    slope_low *= 0.5
            share = 0.5 * (low + high)
            if not are_axes_searched:
                share = low + (high - low) * slope_low / (slope_low - slope_high)
        if wp.static(effects.bounded_axes):
            if are_axes_searched:
                note_pieces(first, end, share, s)
        return share

    return least_energy
