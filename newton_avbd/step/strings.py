# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""DISTANCE joints that are solved with a tree: a row along the string while a bound holds it."""

import warp as wp

from ..data import Closure, Solver
from ..effects import Effects
from ..rows.contact import PENALTY
from .anchors import ROUNDING, loop_geometry
from .distances import bound_of, distance_force, string_direction
from .loop_rows import direction_about, ends_move, ends_of, row_along


def make_string_rows(effects: Effects) -> wp.Function:
    """Device function: the rows of a DISTANCE joint."""

    @wp.func(inline=effects.inline)
    def string_rows(closure: Closure, recovery: float, s: wp.ref[Solver]):
        """The rows of a DISTANCE joint while a bound holds it: along the string, and square to it.

        What pulls, T, turns with the string of length L: square to it that is a spring of T/L, a
        row of the softness L/T.
        """
        closures = s.tree.closures
        i = closure.loop
        s.loops.side[i] = 0
        if s.loops.k_l[i] == 0.0:
            return
        joint = s.loops.joints[i]
        q_p, _q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        s.loops.arms[2 * i] = arm_c
        s.loops.arms[2 * i + 1] = arm_p
        ends = ends_of(joint, arm_c, arm_p, s)
        length = wp.length(offset)
        along = string_direction(q_p, arm_c, offset)
        held = wp.dot(s.history.loop_force[i], along)
        push = distance_force(i, length, held, recovery, s)
        closures.direction[closure.row] = offset
        if push == 0.0:
            return
        dof = s.joints.dof_start[joint]
        start = wp.float32(s.loops.start_coordinate[dof])
        upper = s.joints.limit_upper[dof]
        stop = bound_of(i, upper, wp.max(start, upper), recovery, s.loops)
        side = int(1)
        if push > 0.0:
            lower = s.joints.limit_lower[dof]
            stop = bound_of(i, lower, wp.min(start, lower), recovery, s.loops)
            side = -1
        if s.joints.limit_lower[dof] == s.joints.limit_upper[dof]:
            side = 2
        s.loops.side[i] = side
        for k in range(closure.rows):
            row = closure.row + k
            n = along
            if k > 0:
                if held >= 0.0:
                    continue
                n = direction_about(along, k - 1)
                softness = wp.float64(-length / held)
                closures.gram[closures.gram_row[row] + row] = softness
            else:
                closures.held[row] = wp.dot(n, s.loops.kept_force[i])
                closures.multiplier[row] = wp.float64(length - stop)
            closures.direction[row] = n
            row_along(row, n, ends, s)
            closures.least[row] = PENALTY / s.loops.k_l[i]

    return string_rows


@wp.func
def string_misses(closure: Closure, static_slot: int, s: wp.ref[Solver]) -> float:
    """What a sweep leaves of a DISTANCE joint to the next one, as a share of what it moved.

    Infinity where a bound pushes or pulls the wrong way, or none holds what has gone beyond it.
    """
    i = closure.loop
    row = closure.row
    joint = s.loops.joints[i]
    side = s.loops.side[i]
    moved = ends_move(closure, static_slot, s)
    direction = s.tree.closures.direction[row]
    if side == 0:
        length = wp.length(direction + moved)
        force = distance_force(i, length, 0.0, 0.0, s)
        rounding = ROUNDING * (wp.length(s.work.com[s.joints.child[joint]]) + length)
        return wp.where(wp.abs(force) > s.loops.k_l[i] * rounding, wp.inf, 0.0)
    pull = s.tree.closures.multiplier[row]
    if side < 2 and pull * wp.float64(side) < wp.float64(0.0):
        return wp.inf
    # as of turns of bodies: Newton's method leaves half of the angle times the update
    across = wp.length(wp.cross(direction, moved))
    length = wp.max(wp.float32(s.loops.start_coordinate[s.joints.dof_start[joint]]), across)
    return 0.5 * across / wp.max(length, 1.0e-12)
