# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""DISTANCE joints: what keeps two anchors within their bounds of each other."""

import warp as wp

from ..data import LoopWork, Solver
from ..rows.joint import DISTANCE
from .anchors import left_open

ASIDE = wp.constant(1.0e3)
"""Length of a DISTANCE joint, as a multiple of what the recovery closes elsewhere, from which its
curvature is along itself only. Others are pulled aside: with 30 chains of five diverge."""
COINCIDENT = wp.constant(1.0e-9)
"""Anchors of a DISTANCE joint that are closer have no direction [m]."""


@wp.func
def reach_farther(i: int, closing: float, s: wp.ref[Solver]):
    """Expects that the recovery pulls at a DISTANCE joint where joints of its world close [m]."""
    if s.joints.type[s.loops.joints[i]] == DISTANCE:
        s.loops.reach[i] += ASIDE * closing


@wp.func
def bound_of(i: int, limit: float, start: float, recovery: float, loops: wp.ref[LoopWork]) -> float:
    """Where a bound of a DISTANCE joint holds it that started at or beyond it [m]."""
    return limit + left_open(i, recovery, loops) * (start - limit)


@wp.func
def beyond_bounds(i: int, s: wp.ref[Solver]) -> float:
    """How much longer than its upper bound a DISTANCE joint starts [m]; negative where shorter than
    its lower one."""
    index = s.joints.dof_start[s.loops.joints[i]]
    start = wp.float32(s.loops.start_coordinate[index])
    if start < s.joints.limit_lower[index]:
        return start - s.joints.limit_lower[index]
    # an upper bound of 0 is no direction to pull in, but locked
    if s.joints.limit_upper[index] > 0.0 and start > s.joints.limit_upper[index]:
        return start - s.joints.limit_upper[index]
    return 0.0


@wp.func
def distance_force(i: int, length: float, held: float, recovery: float, s: wp.ref[Solver]) -> float:
    """Force of a DISTANCE joint that pushes its anchors apart [N], negative where it pulls.

    ``held`` is its multiplier.
    """
    index = s.joints.dof_start[s.loops.joints[i]]
    start = wp.float32(s.loops.start_coordinate[index])
    force = float(0.0)
    lower = s.joints.limit_lower[index]
    if lower >= 0.0:
        bound = bound_of(i, lower, wp.min(start, lower), recovery, s.loops)
        force = wp.max(held + s.loops.k_l[i] * (bound - length), 0.0)
    upper = s.joints.limit_upper[index]
    if force == 0.0 and upper > 0.0:
        bound = bound_of(i, upper, wp.max(start, upper), recovery, s.loops)
        force = wp.min(held + s.loops.k_l[i] * (bound - length), 0.0)
    return force


@wp.func
def string_direction(q_p: wp.quat, arm_c: wp.vec3, offset: wp.vec3) -> wp.vec3:
    """From the parent's anchor of a DISTANCE joint to the child's.

    Where they coincide: from there to the COM of the child, and where that is there, too, the X
    axis of the parent's anchor, as in SolverXPBD.
    """
    if wp.length_sq(offset) > COINCIDENT * COINCIDENT:
        return wp.normalize(offset)
    if wp.length_sq(arm_c) > COINCIDENT * COINCIDENT:
        return -wp.normalize(arm_c)
    return wp.quat_rotate(q_p, wp.vec3(1.0, 0.0, 0.0))
