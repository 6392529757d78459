# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Rows of a joint that closes a loop of a tree: the directions that it locks, and its misfit."""

import warp as wp

from ..blocks.closure import SELF_STRESS
from ..data import Closure, Solver
from ..effects import Effects
from ..rows.contact import PENALTY
from ..rows.joint import is_point, make_counts
from ..rows.lock import make_locks
from .anchors import anchor_shift, is_put, loop_geometry, parent_slot
from .rotations import relative_turn

ALL_ROWS = wp.constant(6)
"""Rows of a joint that locks all directions, or that has rows for stops of those it leaves free."""


@wp.func
def axis_of_projection(lock: wp.mat33, count: int) -> wp.vec3:
    """The one direction that a projection to ``count`` keeps, or the one that it does not."""
    kept = lock
    if count != 1:
        kept = wp.identity(n=3, dtype=float) - lock
    longest = int(0)
    for k in range(1, 3):
        if kept[k, k] > kept[longest, longest]:
            longest = k
    return wp.normalize(wp.vec3(kept[0, longest], kept[1, longest], kept[2, longest]))


@wp.func
def direction_about(axis: wp.vec3, i: int) -> wp.vec3:
    """Direction 0, 1 or 2 of a frame whose last direction is ``axis``."""
    if i == 2:
        return axis
    least = int(0)
    for k in range(1, 3):
        if wp.abs(axis[k]) < wp.abs(axis[least]):
            least = k
    direction = wp.vec3(0.0)
    direction[least] = 1.0
    direction = wp.normalize(wp.cross(axis, direction))
    if i == 1:
        direction = wp.cross(axis, direction)
    return direction


@wp.struct
class Ends:
    """The two bodies that a joint holds together."""

    moves_c: float
    """1 if the child moves, 0 if not."""
    moves_p: float
    """The same of the parent."""
    arm_c: wp.vec3
    """From the COM of the child to its anchor [m]."""
    arm_p: wp.vec3
    """From the COM of the parent to where that anchor belongs [m]."""


@wp.func
def ends_of(joint: int, arm_c: wp.vec3, arm_p: wp.vec3, s: wp.ref[Solver]) -> Ends:
    """The ends of a joint, by their arms."""
    parent = parent_slot(s.joints, joint, s.work.inv_mass.shape[0] - 1)
    ends = Ends()
    ends.moves_c = wp.where(s.work.inv_mass[s.joints.child[joint]] > 0.0, 1.0, 0.0)
    ends.moves_p = wp.where(s.work.inv_mass[parent] > 0.0, 1.0, 0.0)
    ends.arm_c = arm_c
    ends.arm_p = arm_p
    return ends


@wp.func
def row_along(row: int, n: wp.vec3, ends: Ends, s: wp.ref[Solver]):
    """Makes a row one of the distance of the ends along a direction."""
    way = s.tree.closures.way
    way[2 * row] = ends.moves_c * wp.spatial_vector(n, wp.cross(ends.arm_c, n))
    way[2 * row + 1] = -ends.moves_p * wp.spatial_vector(n, wp.cross(ends.arm_p, n))


@wp.func
def row_about(row: int, n: wp.vec3, ends: Ends, s: wp.ref[Solver]):
    """Makes a row one of the turn of the ends against each other about a direction."""
    way = s.tree.closures.way
    way[2 * row] = ends.moves_c * wp.spatial_vector(wp.vec3(0.0), n)
    way[2 * row + 1] = -ends.moves_p * wp.spatial_vector(wp.vec3(0.0), n)


@wp.func
def ends_move(closure: Closure, static_slot: int, s: wp.ref[Solver]) -> wp.vec3:
    """How far the sweep has moved the child's anchor of a joint against the parent's [m]."""
    i = closure.loop
    joint = s.loops.joints[i]
    c = s.tree.update[s.joints.child[joint]]
    p = s.tree.update[parent_slot(s.joints, joint, static_slot)]
    moved = wp.spatial_top(c) + wp.cross(wp.spatial_bottom(c), s.loops.arms[2 * i])
    return moved - wp.spatial_top(p) - wp.cross(wp.spatial_bottom(p), s.loops.arms[2 * i + 1])


def make_loop_rows(effects: Effects) -> wp.Function:
    """Device function: the rows of a joint that closes a loop."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    locks = make_locks(effects.kinds)
    linear_misfit, angular_misfit = locks.linear_misfit, locks.angular_misfit
    locked_shift, locked_turn = locks.locked_shift, locks.locked_turn
    linear_lock, angular_lock = locks.linear_lock, locks.angular_lock

    @wp.func(inline=effects.inline)
    def loop_rows(closure: Closure, recovery: float, s: wp.ref[Solver]):
        """The rows of a joint that closes a loop: what it locks, linear rows first."""
        closures = s.tree.closures
        i = closure.loop
        if s.loops.k_l[i] == 0.0:
            return
        gives = wp.vec2(0.0)
        if wp.static(effects.yielding):
            gives = s.loops.gives[i]
            if gives[0] + gives[1] > 0.0 and recovery > 0.0:
                return
        joint = s.loops.joints[i]
        static_slot = s.work.inv_mass.shape[0] - 1
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, static_slot)
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        shift = linear_misfit(s.joints, joint, q_p, offset)
        turn = angular_misfit(s.joints, joint, q_p, q_c)
        linear = 3 - linear_count(s.joints, joint)
        if wp.static(effects.kinds.distances):
            if is_point(s.joints, joint):
                linear = int(3)
        kept = wp.where(recovery > 0.0, 0.0, 1.0) * s.loops.misfit[i]
        left = shift - wp.spatial_top(kept)
        turn -= wp.spatial_bottom(kept)
        if not is_put(child, s.work) and not is_put(parent, s.work):
            moved = anchor_shift(child, parent, arm_c, arm_p, s)
            if linear == 3:
                left = moved + wp.spatial_top(s.loops.misfit[i] - kept)
            elif recovery == 0.0:
                left = locked_shift(s.joints, joint, q_p, s.tree.swing[parent], moved, offset)
            if recovery == 0.0:
                turned = relative_turn(child, parent, s.tree)
                turn = locked_turn(s.joints, joint, q_p, q_c, turned)
        if wp.static(effects.yielding):
            if gives[0] + gives[1] > 0.0:
                left -= wp.spatial_top(s.loops.wanted[i])
                turn -= wp.spatial_bottom(s.loops.wanted[i])
        arm_p += offset - shift
        s.loops.arms[2 * i] = arm_c
        s.loops.arms[2 * i + 1] = arm_p
        ends = ends_of(joint, arm_c, arm_p, s)
        angular = wp.where(linear < closure.rows, 3 - angular_count(s.joints, joint), 0)
        lock_l = linear_lock(s.joints, joint, q_p)
        lock_a = angular_lock(s.joints, joint, q_p, q_c)
        # along the axis of a hinge, too: in a planar mechanism the others imply just that row
        axis_a = wp.quat_rotate(q_p, wp.vec3(0.0, 0.0, 1.0))
        if angular == 1 or angular == 2:
            axis_a = axis_of_projection(lock_a, angular)
        axis_l = axis_a
        if linear == 1 or linear == 2:
            axis_l = axis_of_projection(lock_l, linear)
        reach = wp.max(ends.moves_c * wp.length(arm_c), ends.moves_p * wp.length(arm_p))
        for k in range(linear + angular):
            row = closure.row + k
            if k < linear:
                n = direction_about(axis_l, wp.where(linear == 1, 2, k))
                closures.direction[row] = n
                row_along(row, n, ends, s)
                closures.held[row] = wp.dot(n, s.loops.kept_force[i])
                closures.multiplier[row] = wp.float64(wp.dot(n, left))
                closures.least[row] = PENALTY / s.loops.k_l[i]
                closures.most[row] = SELF_STRESS * reach / closures.least[row]
                closures.gives[row] = gives[0]
            else:
                n = direction_about(axis_a, wp.where(angular == 1, 2, k - linear))
                closures.direction[row] = n
                row_about(row, n, ends, s)
                closures.held[row] = wp.dot(n, s.loops.kept_torque[i])
                closures.multiplier[row] = wp.float64(wp.dot(n, turn))
                closures.least[row] = PENALTY / s.loops.k_a[i]
                closures.most[row] = SELF_STRESS / closures.least[row]
                closures.gives[row] = gives[1]

    return loop_rows
