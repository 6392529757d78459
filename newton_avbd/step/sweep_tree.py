# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""One iteration of Newton's method on the tree of an articulation: eliminate, substitute, move."""

from dataclasses import dataclass

import warp as wp

from ..blocks import tree as algebra
from ..blocks.closure import MISSED, softness_of, solve_ground
from ..data import LoopWork, Solver, Step
from ..effects import Effects
from ..rows.joint import make_counts
from .active_set import PATIENCE, make_take_pieces
from .anchors import is_linked
from .bodies import body_at, has_rows, nonnegative
from .carrying import is_short
from .coordinates import make_coordinates
from .eliminate import make_eliminate
from .gathering import ContactLaw
from .line_search import make_least_energy
from .mimics import missed_by_lines
from .rotations import MOST_TURN, turn_by
from .scale import STOPPING
from .substitute import Misplaced, make_substitute

HIDDEN = wp.constant(2.0e-2)
"""Move of a body with contacts that counts as none, as a share of the penetration that is left
alone: 1e-3 g h^2."""
FAR = wp.constant(3.0e-2)
"""Turn by an update from which joint coordinates are measured again [rad]."""
EULER_FAR = wp.constant(3.0e-3)
"""Likewise in scenes with joints of two or three angular axes, which turn each other."""
ALL = wp.constant(0.9)
"""Share of an update that takes a tree to where multipliers of its contacts may follow their
forces: before, these are those of no state that the tree will be in."""


@wp.func
def has_soft_loops(body: int, loops: wp.ref[LoopWork]) -> bool:
    """Whether a joint acts on the body whose rows converge by a factor, sweep by sweep."""
    for k in range(loops.body_start[body], loops.body_start[body + 1]):
        if loops.is_soft[loops.items[k] / 2]:
            return True
    return False


@dataclass(frozen=True)
class MoveFunctions:
    """Device functions that move bodies by their updates."""

    gimbal_step: wp.Function
    shift: wp.Function
    """Moves a body by any update, and measures its coordinates anew."""
    move: wp.Function


def make_move(effects: Effects) -> MoveFunctions:
    """Device functions: how far an update turns the joint of a body, and its motion by it."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_gimbal = counts.is_gimbal
    coordinates = make_coordinates(effects)
    measure_coordinates = coordinates.measure_coordinates
    measure_moved = coordinates.measure_moved

    @wp.func
    def gimbal_step(body: int, s: wp.ref[Solver]) -> float:
        """Square of the largest step of the angles of the body's joint [rad^2], if a gimbal."""
        largest = float(0.0)
        if is_linked(body, s):
            joint = s.tree.joint[body]
            if is_gimbal(s.joints, joint):
                first = s.tree.axis_start[body] + linear_count(s.joints, joint)
                for k in range(first, first + 3):
                    largest = wp.max(largest, s.tree.axes[k].step * s.tree.axes[k].step)
        return largest

    @wp.func(inline=effects.inline)
    def move_pose(body: int, update: wp.spatial_vector, h: float, s: wp.ref[Solver]):
        """Moves the body by an update."""
        increment = s.work.increment[body]
        turn = s.tree.turn[body]
        before = wp.spatial_bottom(increment) - turn
        further = algebra.combined_with(before, wp.spatial_bottom(update))
        rest = before + further
        moved = wp.spatial_vector(wp.spatial_top(increment) + wp.spatial_top(update), turn + rest)
        s.work.increment[body] = moved
        if wp.static(effects.carried_rounding):
            if is_short(h):
                update = wp.spatial_vector(wp.spatial_top(update), further)
                s.work.rounded[body] = update - (moved - increment)
        turn_by(body, rest, s.tree)

    @wp.func
    def measure(body: int, share: float, s: wp.ref[Solver]):
        """Measures the coordinates of a joint after a share of the steps of its axes."""
        static_slot = s.work.inv_mass.shape[0] - 1
        if wp.static(effects.kinds.gimbals):
            joint = s.tree.joint[body]
            if is_gimbal(s.joints, joint):
                # its pose does not tell all of its coordinates: what its axes turned does
                first = s.tree.axis_start[body]
                dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
                for k in range(first, first + dofs):
                    back = (1.0 - share) * s.tree.axes[k].step
                    s.tree.coordinate[k] = s.tree.coordinate[k] - wp.float64(back)
                measure_coordinates(body, first, wp.vec3(0.0), s.tree.coordinate, static_slot, s)
                return
        measure_moved(body, static_slot, s)

    @wp.func
    def turned(body: int, s: wp.ref[Solver]) -> float:
        """Square of the largest turn by which an update moves a joint's coordinates [rad^2].

        That of the body or its parent, which may be the light one, or, of a gimbal, of an axis:
        the outer ones may turn against each other.
        """
        turn = wp.spatial_bottom(s.tree.update[body])
        turn_p = wp.spatial_bottom(s.tree.update[nonnegative(s.tree.parent[body])])
        largest = wp.max(wp.length_sq(turn), wp.length_sq(turn_p))
        if wp.static(effects.kinds.gimbals):
            largest = wp.max(largest, gimbal_step(body, s))
        return largest

    @wp.func(inline=effects.inline)
    def move(body: int, share: float, h: float, s: wp.ref[Solver]):
        """Moves the body by a share of its update."""
        update = share * s.tree.update[body]
        move_pose(body, update, h, s)
        if wp.static(effects.coordinates):
            # summing steps misses the square of the turn
            far = wp.static(EULER_FAR if effects.kinds.euler else FAR)
            if is_linked(body, s) and (share < 1.0 or turned(body, s) > far * far):
                measure(body, share, s)

    @wp.func
    def shift(body: int, update: wp.spatial_vector, h: float, s: wp.ref[Solver]):
        move_pose(body, update, h, s)
        if wp.static(effects.coordinates):
            if is_linked(body, s):
                measure(body, 1.0, s)

    return MoveFunctions(gimbal_step, shift, move)


def make_sweep_tree(
    effects: Effects,
    law: ContactLaw,
    gather: wp.Function,
    begin_rows: wp.Function,
    keep_forces: wp.Function,
    settle_tendons: wp.Function,
) -> wp.Function:
    """Device function: one Newton iteration on a tree.

    Args:
        effects: What the kernel is compiled with.
        law: What contacts push with.
        gather: Device function that sums the inertial and contact wrench of a body.
        begin_rows: Device function that starts the closures of a block.
        keep_forces: Device function that keeps what they push with.
        settle_tendons: Device function that measures what tendons are off by.
    """
    eliminate = make_eliminate(effects, gather)
    substitute = make_substitute(effects)
    move_functions = make_move(effects)
    gimbal_step, move = move_functions.gimbal_step, move_functions.move
    least_energy = make_least_energy(effects, law)
    take_pieces = make_take_pieces(effects)
    has_curvature = effects.bounded_axes or effects.contact

    @wp.func
    def eliminate_tree(
        first: int,
        end: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Eliminates the bodies of a tree, children first, and the rows that close it.

        Returns how far off the geometric stiffness and the curvature of tendons may be, as a share
        of the blocks.
        """
        if wp.static(effects.closures):
            begin_rows(first, end, recovery, h, s)
        mismatch = float(0.0)
        for i in range(end - first):
            body = body_at(end - 1 - i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                off = eliminate(body, has_dual, recovery, slop, h, step, s)
                mismatch = wp.max(mismatch, off)
        if wp.static(effects.closures):
            solve_ground(first, softness_of(has_dual, recovery), s.tree.closures)
        return mismatch

    @wp.func
    def substitute_tree(
        first: int,
        end: int,
        is_searched: bool,
        h: float,
        found: wp.ref[Misplaced],
        s: wp.ref[Solver],
    ) -> float:
        """Finds the updates of the bodies of a tree, parents first, and how they fit the laws.

        Returns the square of the largest turn of a body, or step of a gimbal's angle [rad^2].
        """
        turned_most = float(0.0)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                of_body = substitute(body, is_searched, h, s)
                found.wrong += of_body.wrong
                if wp.static(has_curvature):
                    found.curvature += of_body.curvature
                    found.held_work += of_body.held_work
                turned_most = wp.max(
                    turned_most, wp.length_sq(wp.spatial_bottom(s.tree.update[body]))
                )
                if wp.static(effects.kinds.gimbals):
                    turned_most = wp.max(turned_most, gimbal_step(body, s))
        return turned_most

    @wp.func
    def note_minimum(first: int, end: int, is_minimal: bool, s: wp.ref[Solver]):
        """Notes whether the bodies of a tree go to the minimum of its model."""
        for i in range(first, end):
            s.tree.is_minimal[body_at(i, s.worlds)] = is_minimal

    @wp.func
    def is_newtons(body: int, s: wp.ref[Solver]) -> bool:
        """Whether Newton's method converges at the body. Contacts converge by a factor."""
        if wp.static(effects.contact):
            if has_rows(s.rows, body):
                return False
        if wp.static(effects.loops):
            if has_soft_loops(body, s.loops):
                return False
        if wp.static(effects.cables):
            if s.tree.cables.pulled[body]:
                return False
        return True

    @wp.func
    def move_tree(first: int, end: int, share: float, h: float, largest: float, s: wp.ref[Solver]):
        """Moves the bodies of a tree by a share of their updates.

        Returns the square of the largest turn in the step [rad^2], or ``largest`` if that is more,
        and whether all that is left is what Newton's method leaves.
        """
        is_newton = bool(True)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                move(body, share, h, s)
                turn = wp.spatial_bottom(s.work.increment[body])
                largest = wp.max(largest, wp.length_sq(turn))
                if wp.static(effects.kinds.gimbals):
                    largest = wp.max(largest, gimbal_step(body, s))
                if not is_newtons(body, s):
                    is_newton = False
        return largest, is_newton

    @wp.func
    def off_by(
        first: int,
        end: int,
        wrong: int,
        largest: float,
        has_dual: bool,
        recovery: float,
        h: float,
        s: wp.ref[Solver],
    ) -> float:
        """What axes on wrong pieces, equality constraints and tendons leave to the next iteration.

        A square [m^2], as :func:`sweep_tree` returns it; infinite where it is to run in any case.
        """
        farthest = float(0.0)
        if largest == wp.inf:
            farthest = wp.inf
        if wrong > 0:
            farthest = wp.inf
            if wp.static(effects.laws):
                if take_pieces(first, end, wrong, has_dual, s):
                    farthest = STOPPING
        if wp.static(effects.equalities):
            # what a line misses of a curve, and the next iteration finds
            farthest = wp.max(farthest, missed_by_lines(first, recovery, s))
        if wp.static(effects.tendons):
            farthest = wp.max(farthest, settle_tendons(first, recovery, h, s))
        return farthest

    @wp.func
    def farthest_next(
        first: int, end: int, left: float, is_newton: bool, slop: float, s: wp.ref[Solver]
    ) -> float:
        """Square of how far the next iteration moves a body [m^2], which has ``left`` of this."""
        farthest = float(0.0)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                shift = wp.spatial_top(s.tree.update[body])
                turn = wp.spatial_bottom(s.tree.update[body])
                turned = wp.dot(turn, s.work.inertia[body] * turn) * s.work.inv_mass[body]
                moved = left * (wp.dot(shift, shift) + turned)
                hidden = s.tree.rounding[body]
                if not is_newton and slop > 0.0:
                    # multipliers of contacts build up by moves that small
                    hidden = wp.min(hidden, HIDDEN * slop)
                if moved > hidden * hidden:
                    farthest = wp.max(farthest, moved)
        return farthest

    @wp.func
    def sweep_tree(
        first: int,
        end: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Moves the bodies of a tree to the minimum of their quadratic model.

        Returns the square of how far the next iteration would move one of them [m^2]: zero where
        the rounding of the poses hides it.
        """
        mismatch = eliminate_tree(first, end, has_dual, recovery, slop, h, step, s)
        is_searched = bool(False)
        if wp.static(effects.bounded_axes):
            is_searched = has_dual and recovery == 0.0
            is_searched = is_searched and s.tree.patience[body_at(first, s.worlds)] < PATIENCE
        found = Misplaced()
        turned_most = substitute_tree(first, end, is_searched, h, found, s)
        share = float(1.0)
        if turned_most > MOST_TURN * MOST_TURN:
            share = MOST_TURN / wp.sqrt(turned_most)
        if wp.static(has_curvature):
            is_searched = is_searched and found.wrong > 0
            is_seen = bool(False)
            if wp.static(effects.contact):
                is_seen = farthest_next(first, end, 1.0, False, slop, s) > 0.0
            if is_searched or is_seen:
                least = least_energy(first, end, found, is_searched, recovery, slop, s)
                share = wp.min(share, least)
            if wp.static(effects.contact):
                note_minimum(first, end, found.wrong == 0 and share >= ALL, s)
        # Newton's method leaves half of the angle times the update, the angle of the step or, where
        # a stop takes it back, of the update; or what the joint forces of the last step are off by
        # in the first iteration.
        largest = wp.max(4.0 * mismatch * mismatch, turned_most)
        largest, is_newton = move_tree(first, end, share, h, largest, s)
        if wp.static(effects.closures and effects.loops):
            off = keep_forces(first, not has_dual, recovery, h, s)
            largest = wp.max(largest, 4.0 * off * off)
        farthest = off_by(first, end, found.wrong, largest, has_dual, recovery, h, s)
        if wp.static(effects.closures):
            if s.tree.closures.block_of[first] >= 0:
                largest = wp.max(largest, wp.static(4.0 * MISSED * MISSED))
        left = wp.where(is_newton, wp.min(0.25 * largest, 1.0), 1.0)
        return wp.max(farthest, farthest_next(first, end, left, is_newton, slop, s))

    return sweep_tree
