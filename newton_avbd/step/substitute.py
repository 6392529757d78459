# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""One body of an articulation, substituted: its update by that of its parent."""

import warp as wp

from ..algebra.block import other_half
from ..blocks import tree as algebra
from ..blocks.closure import find_multipliers, rows_push
from ..data import AxisLaw, Solver, TreeAxis
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows.joint import make_counts
from .anchors import is_linked
from .axes import make_axis
from .bodies import nonnegative


@wp.struct
class Misplaced:
    """How an update fits the pieces of laws that elimination assumed."""

    wrong: int
    """Axes that are off their pieces."""
    curvature: float
    """Share of the curvature d^T H d [J] along the update d of the tree."""
    held_work: float
    """Work of what holds axes [J]."""


def make_step_of_axis(effects: Effects) -> wp.Function:
    """Device function: how far an axis moves, as its law has it."""
    axes = make_axis(effects)
    next_piece, compliant_limit = axes.next_piece, axes.compliant_limit

    @wp.func
    def goes_on(law: AxisLaw, step: float, inv_pivot: float) -> bool:
        """Whether a drive takes an axis on beyond the point where friction reverses, against it.

        Takes the step on the assumed piece [m or rad], and the inverse of its pivot.
        """
        slip = float(law.piece[2])
        step = axis_rows.free_step(law, step - 2.0 * slip * law.friction * inv_pivot, inv_pivot)
        return slip * (step - law.hold) > 0.0

    @wp.func
    def step_within_law(
        k: int,
        q: float,
        met: float,
        is_searched: bool,
        axis: wp.ref[TreeAxis],
        found: wp.ref[Misplaced],
        s: wp.ref[Solver],
    ) -> float:
        """The step of an axis on the piece that was assumed; notes which it should be on.

        Args:
            k: Entry of the axis in ``tree.axes``.
            q: The step where nothing holds the axis [m or rad].
            met: What the motion of the parent meets along it [N or N m].
            is_searched: Whether the tree is searched along its update, which is then that of the
                assumed pieces.
            axis: The axis.
            found: What the body has of misplaced axes.
            s: The solver.
        """
        law = s.tree.laws[k]
        if axis.pivot > 0.0:
            q = axis.step
        held = axis.pivot * q + met - axis.push
        if wp.static(effects.bounded_axes or effects.contact):
            if axis.pivot > 0.0:
                found.curvature += q * (axis.pivot * q + 2.0 * met)
                found.held_work += held * q
            else:
                found.curvature += axis.inv_pivot * axis.push * axis.push
        assumed = float(q)
        if wp.static(effects.bounded_axes):
            if axis.pivot <= 0.0 and not is_searched:
                q = axis_rows.free_step(law, assumed, axis.inv_pivot)
        law.next = next_piece(law, q, held)
        if wp.static(effects.joint_friction and effects.effort_limits):
            if law.next[2] != law.piece[2] and axis.pivot <= 0.0 and not is_searched:
                if law.drive_stiffness > 0.0 and goes_on(law, assumed, axis.inv_pivot):
                    law.next[2] = -law.piece[2]
        s.tree.laws[k].next = law.next
        if wp.static(effects.joint_friction):
            if law.piece[2] == 0 and not axis_rows.is_stopped(law):
                s.tree.laws[k].held = wp.clamp(held, -law.friction, law.friction)
        if not (law.next == law.piece):
            found.wrong += 1
        if wp.static(effects.stops):
            if not axis_rows.is_stopped(law):
                # not beyond a stop, which holds it from the next sweep on
                q = wp.clamp(q, law.lower, law.upper)
        return q

    @wp.func
    def crosses_limit(
        index: int, at: float, moved: float, q: float, h: float, s: wp.ref[Solver]
    ) -> bool:
        """Whether a step takes a degree of freedom beyond a compliant limit, or back."""
        if wp.static(effects.limit_impedance):
            rate = s.tree.start_velocity[index]
            _f, k_then = compliant_limit(s.joints, index, at, moved, rate, h)
            _f, k_now = compliant_limit(s.joints, index, at + q, moved + q, rate, h)
            return (k_then > 0.0) != (k_now > 0.0)
        else:
            side = axis_rows.limit_side(s.joints, index, at)
            return side != axis_rows.limit_side(s.joints, index, at + q)

    @wp.func
    def move_coordinate(
        k: int, index: int, q: float, h: float, found: wp.ref[Misplaced], s: wp.ref[Solver]
    ):
        """Moves the coordinate of an entry of ``tree.axes`` by a step."""
        at = s.tree.coordinate[k]
        s.tree.coordinate[k] = at + wp.float64(q)
        if wp.static(effects.kinds.gimbals or effects.bounded_axes):
            s.tree.axes[k].step = q
        if wp.static(effects.limits and effects.compliance):
            moved = wp.float32(at - s.tree.start_coordinate[k])
            if crosses_limit(index, wp.float32(at), moved, q, h, s):
                found.wrong += 1

    @wp.func
    def step_of_axis(
        k: int,
        index: int,
        update: wp.spatial_vector,
        is_searched: bool,
        h: float,
        axis: wp.ref[TreeAxis],
        found: wp.ref[Misplaced],
        s: wp.ref[Solver],
    ) -> float:
        """Step of an axis [m or rad], as the body moves with its parent and the axes before it.

        Moves its coordinate along.
        """
        met = wp.dot(axis.force, wp.spatial_top(update)) + wp.dot(
            axis.torque, wp.spatial_bottom(update)
        )
        q = axis.inv_pivot * (axis.push - met)
        if wp.static(effects.contact and not effects.laws):
            found.curvature += axis.inv_pivot * axis.push * axis.push
        if wp.static(effects.laws):
            q = step_within_law(k, q, met, is_searched, axis, found, s)
        if wp.static(effects.coordinates):
            move_coordinate(k, index, q, h, found, s)
        return q

    return step_of_axis


def make_substitute(effects: Effects) -> wp.Function:
    """Device function: finds the update of one body of a tree."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    step_of_axis = make_step_of_axis(effects)

    @wp.func(inline=effects.inline)
    def substitute(body: int, is_searched: bool, h: float, s: wp.ref[Solver]) -> Misplaced:
        """Finds the update of the body by that of its parent.

        If the tree is then searched along its update (``is_searched``), the update is that of the
        assumed pieces. Returns how it fits them.
        """
        found = Misplaced()
        pushed = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        if wp.static(effects.closures):
            pushed = rows_push(body, s.tree.closures)
        if is_linked(body, s):
            joint = s.tree.joint[body]
            parent = nonnegative(s.tree.parent[body])
            update = algebra.carried(s.tree.span[body], s.tree.update[parent])
            dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
            for i in range(dofs):
                dof = dofs - 1 - i
                k = nonnegative(s.tree.axis_start[body] + dof)
                axis = s.tree.axes[k]
                if wp.static(effects.closures):
                    axis.push -= pushed[dof]
                index = s.joints.dof_start[joint] + dof
                q = step_of_axis(k, index, update, is_searched, h, axis, found, s)
                update += q * wp.spatial_vector(axis.linear, axis.angular)
            s.tree.update[body] = update + s.tree.closing[body]
        else:
            half = s.tree.update[body] - pushed
            if wp.static(effects.bounded_axes or effects.contact):
                found.curvature = wp.dot(half, half)
            s.tree.update[body] = other_half(s.work.factor[body], half)
        if wp.static(effects.closures):
            find_multipliers(body, s.tree.update[body], s.tree.closures)
        return found

    return substitute
