# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Limits of a joint that closes a loop of a tree: a row along an axis while a stop holds it."""

import warp as wp

from ..blocks.closure import SELF_STRESS
from ..data import Closure, Solver
from ..effects import Effects
from ..functions import Functions, together
from ..rows.contact import PENALTY
from ..rows.coordinate import make_joint_coordinates
from ..rows.euler import make_euler
from ..rows.free_axes import make_free_axes
from ..rows.joint import make_counts
from ..rows.lock import make_locks
from .anchors import ROUNDING, loop_geometry, parent_slot
from .axes import make_axis
from .loop_axes import make_loop_axes
from .loop_rows import ends_move, ends_of, row_about, row_along

NONE = wp.constant(0)
"""Side of an axis that no stop holds; -1 and 1 are held by the lower and the upper one."""
BOTH = wp.constant(2)
"""Side of an axis whose stops leave it no room: they hold it in either direction."""


YIELDING = wp.constant(1.0e-3)
"""How far a stop gives way in the recovery, as a share of how far it would move its bodies, were
they free, to what it pushes with beyond the motion's push: a mechanism at a dead center cannot go
where the stop wants it, and would be thrown about."""


def make_stop_rows(effects: Effects) -> Functions:
    """Device functions: the rows of a joint's stops, and what they push with."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    known_angles = make_euler(effects.kinds).known_angles
    linear_misfit = make_locks(effects.kinds).linear_misfit
    axis_of = make_free_axes(effects.kinds).axis_of
    angles = make_joint_coordinates(effects.kinds).angles
    coordinate_of = make_loop_axes(effects).coordinate_of
    stops = make_axis(effects).stops

    @wp.func(inline=effects.inline)
    def stop_rows(closure: Closure, recovery: float, h: float, s: wp.ref[Solver]):
        """The rows of the stops that hold axes of a joint, after those of what it locks.

        Expects that :func:`.loop_rows.make_loop_rows` has begun those.
        """
        closures = s.tree.closures
        i = closure.loop
        if s.loops.k_l[i] == 0.0:
            return
        joint = s.loops.joints[i]
        linear = linear_count(s.joints, joint)
        count = linear + angular_count(s.joints, joint)
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        arm_p += offset - linear_misfit(s.joints, joint, q_p, offset)
        ends = ends_of(joint, arm_c, arm_p, s)
        reach = wp.max(ends.moves_c * wp.length(arm_c), ends.moves_p * wp.length(arm_p))
        start = s.joints.dof_start[joint]
        started = known_angles(s.joints, joint, s.loops.start_coordinate, start)
        turned = angles(s.joints, joint, q_p, q_c, started, False)
        for dof in range(count):
            index = start + dof
            row = closure.row + closure.rows - count + dof
            known = s.loops.start_coordinate[index]
            q = coordinate_of(i, dof, q_p, q_c, offset, known, s)
            moved = wp.float32(q - known)
            share = recovery * s.loops.recovered[i]
            lower, upper = stops(s.joints, index, q, moved, share, h)
            penalty = wp.where(dof < linear, s.loops.k_l[i], s.loops.k_a[i])
            held = s.history.limit_force[index]
            n = axis_of(s.joints, joint, dof, q_p, q_c, turned)
            side = NONE
            if held + penalty * lower > 0.0:
                side = -1
            elif held + penalty * upper < 0.0:
                side = 1
            if lower >= upper:
                side = BOTH
            s.loops.stop_side[index] = side
            s.loops.stop_steps[index] = wp.vec2(lower, upper)
            closures.direction[row] = n
            if side == NONE:
                continue
            closures.multiplier[row] = wp.float64(-wp.where(side < NONE, lower, upper))
            closures.held[row] = held
            closures.least[row] = PENALTY / penalty
            if recovery > 0.0:
                gives = YIELDING * closures.least[row]
                closures.gives[row] = gives
                closures.multiplier[row] -= wp.float64(gives * s.loops.kept_stop[index])
            closures.most[row] = SELF_STRESS / closures.least[row]
            if dof < linear:
                closures.most[row] = reach * closures.most[row]
                row_along(row, n, ends, s)
            else:
                row_about(row, n, ends, s)

    @wp.func
    def keep_stops(closure: Closure, static_slot: int, s: wp.ref[Solver]) -> float:
        """After substitution: what the stops of a joint push with.

        Returns infinity where one pulls, or none holds an axis that has gone beyond it.
        """
        i = closure.loop
        joint = s.loops.joints[i]
        linear = linear_count(s.joints, joint)
        count = linear + angular_count(s.joints, joint)
        start = s.joints.dof_start[joint]
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, static_slot)
        shift = ends_move(closure, static_slot, s)
        turn = wp.spatial_bottom(s.tree.update[child]) - wp.spatial_bottom(s.tree.update[parent])
        missed = float(0.0)
        for dof in range(count):
            index = start + dof
            row = closure.row + closure.rows - count + dof
            side = s.loops.stop_side[index]
            push = wp.float32(-s.tree.closures.multiplier[row])
            if side == NONE:
                push = 0.0
                n = s.tree.closures.direction[row]
                moved = wp.dot(n, wp.where(dof < linear, shift, turn))
                size = 2.0 * (2.0 + wp.abs(wp.float32(s.loops.start_coordinate[index])))
                if dof < linear:
                    size = wp.length(s.work.com[child]) + wp.length(s.loops.arms[2 * i])
                    size += wp.length(s.loops.arms[2 * i + 1])
                steps = s.loops.stop_steps[index]
                if wp.max(steps[0] - moved, moved - steps[1]) > ROUNDING * size:
                    missed = wp.inf
            elif side != BOTH and push * float(side) > 0.0:
                push = 0.0
                missed = wp.inf
            s.history.limit_force[index] = push
        return missed

    return together(stop_rows, keep_stops)
