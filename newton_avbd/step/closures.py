# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Equations between the bodies of a tree, solved with it: joints that close loops, mimics, tendons.

What they are is here, how they are eliminated in :mod:`.blocks.closure`.
"""

from dataclasses import dataclass

import warp as wp

from ..data import BodyWork, Closure, JointModel, Solver, TreeWork, WorldScale
from ..effects import Effects
from ..rows.contact import PENALTY
from ..rows.joint import is_point, is_string, make_counts
from ..rows.lock import make_locks
from .anchors import ROUNDING, anchor_shift, is_linked, is_put, parent_slot
from .kernels import ABSENT
from .loops import bound_of, distance_force, loop_geometry, string_direction
from .rotations import relative_turn
from .tendons import make_tendons


@wp.func
def mimic_misfit(
    closure: Closure, dof: int, coordinate: wp.array[wp.float64], s: wp.ref[Solver]
) -> float:
    """q - (offset + multiplier q_leader) of a mimic joint [m or rad]."""
    coefficients = s.joints.mimic_coefficients[closure.joint]
    leader = coordinate[s.tree.axis_start[closure.leader_body] + dof]
    follower = coordinate[s.tree.axis_start[closure.body] + dof]
    lead = wp.float64(coefficients[1]) * leader
    return wp.float32(follower - wp.float64(coefficients[0]) - lead)


LEAST_MISSED = wp.constant(1.0e-9)
"""What a polynomial may be off by in a sweep [m or rad]. Coordinates of a step count in float64
from where it starts; what misses the velocity in each step adds up."""


@wp.func
def led_to(closure: Closure, leader: wp.float64, joints: wp.ref[JointModel]) -> wp.vec2d:
    """Where an equality constraint leads its joint, and by how much more for more of the leader."""
    value = wp.float64(0.0)
    slope = wp.float64(0.0)
    if closure.leader_dof >= 0:
        for i in range(4):
            slope = value + slope * leader
            value = wp.float64(joints.polynomials[closure.equality, 4 - i]) + value * leader
        slope = value + slope * leader
        value = value * leader
    return wp.vec2d(value + wp.float64(joints.polynomials[closure.equality, 0]), slope)


@wp.func
def equality_misfit(
    closure: Closure, coordinate: wp.array[wp.float64], s: wp.ref[Solver]
) -> wp.vec2:
    """How far a joint is from where its equality constraint leads it [m or rad], and the slope."""
    leader = wp.float64(0.0)
    if closure.leader_dof >= 0:
        leader = coordinate[s.tree.axis_start[closure.leader_body] + closure.leader_dof]
    led = led_to(closure, leader, s.joints)
    left = coordinate[s.tree.axis_start[closure.body] + closure.dof] - led[0]
    return wp.vec2(wp.float32(left), wp.float32(led[1]))


@wp.func
def equality_start(closure: Closure, s: wp.ref[Solver]) -> float:
    """How far it was from there at the start of a step of second order [m or rad].

    The coordinates of such a step start ahead of that, where a curve leads elsewhere.
    """
    leader = wp.float64(0.0)
    if closure.leader_dof >= 0:
        first = s.joints.dof_start[s.tree.joint[closure.leader_body]]
        leader = s.history.coordinate[first + closure.leader_dof].start
    follower = s.history.coordinate[s.joints.dof_start[closure.joint] + closure.dof].start
    return wp.float32(follower - led_to(closure, leader, s.joints)[0])


@wp.func
def is_mimic(closure: Closure) -> bool:
    """Whether a closure ties coordinates of joints."""
    return closure.loop < 0 and closure.tendon < 0


@wp.func
def is_mimicking(closure: Closure, s: wp.ref[Solver]) -> bool:
    """Whether a mimic joint and its leader are enabled."""
    return is_linked(closure.body, s) and is_linked(closure.leader_body, s)


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


@wp.func
def stiffness_off(
    body: int, reach: float, change: float, force: float, h: float, work: wp.ref[BodyWork]
) -> float:
    """How far a force [N] was off in the geometric stiffness of a body, as a share of the block.

    Args:
        body: The body.
        reach: Distance of its COM from where the force acts [m].
        change: By how much the force has changed in the sweep.
        force: What it is now.
        h: Time step [s].
        work: The bodies.
    """
    if work.inv_mass[body] == 0.0:
        return 0.0
    return reach * change / (wp.trace(work.inertia[body]) / (h * h) + reach * force)


@dataclass(frozen=True)
class ClosureFunctions:
    """Device functions of closures, compiled for the joints of a scene."""

    begin_closures: wp.Function
    begin_rows: wp.Function
    keep_forces: wp.Function
    missed_by_lines: wp.Function
    begin_tendons: wp.Function
    settle_tendons: wp.Function
    load_tendons: wp.Function
    end_tendons: wp.Function


def make_closures(effects: Effects) -> ClosureFunctions:
    """Device functions: how mimics stand at the start of the step, and the solve of all rows."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    locks = make_locks(effects.kinds)
    linear_misfit, linear_lock = locks.linear_misfit, locks.linear_lock
    angular_misfit, locked_shift = locks.angular_misfit, locks.locked_shift
    locked_turn, angular_lock = locks.locked_turn, locks.angular_lock
    tendons = make_tendons(effects) if effects.tendons else ABSENT
    begin_tendon, tendon_row = tendons.begin_tendon, tendons.tendon_row
    settle_tendon, tendon_wrench = tendons.settle_tendon, tendons.tendon_wrench
    end_tendon = tendons.end_tendon

    @wp.func
    def begin_closures(first: int, s: wp.ref[Solver]) -> bool:
        """Misfit of the mimics of a block, which starts at ``first``, at the start of the step.

        Returns whether one is beyond rounding.
        """
        closures = s.tree.closures
        number = closures.block_of[first]
        if number < 0:
            return False
        is_open = bool(False)
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            if is_mimic(closure) and is_mimicking(closure, s):
                for dof in range(closure.rows):
                    axis = int(dof)
                    misfit = mimic_misfit(closure, dof, s.tree.start_coordinate, s)
                    if wp.static(effects.equalities):
                        if closure.equality >= 0:
                            axis = closure.dof
                            if wp.static(effects.second_order):
                                misfit = equality_start(closure, s)
                            else:
                                misfit = equality_misfit(closure, s.tree.start_coordinate, s)[0]
                    closures.misfit[closure.row + dof] = misfit
                    reach = wp.float32(
                        s.tree.start_coordinate[s.tree.axis_start[closure.body] + axis]
                    )
                    rounding = s.tree.rounding[closure.body] + 2.0 * ROUNDING * (
                        2.0 + wp.abs(reach)
                    )
                    if wp.abs(misfit) > rounding:
                        is_open = True
        return is_open

    @wp.func(inline=effects.inline)
    def loop_rows(closure: Closure, recovery: float, s: wp.ref[Solver]):
        """The rows of a joint that closes a loop: what it locks, linear rows first."""
        closures = s.tree.closures
        i = closure.loop
        if s.loops.k_l[i] == 0.0:
            return
        joint = s.loops.joints[i]
        static_slot = s.work.inv_mass.shape[0] - 1
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, static_slot)
        moves_c = wp.where(s.work.inv_mass[child] > 0.0, 1.0, 0.0)
        moves_p = wp.where(s.work.inv_mass[parent] > 0.0, 1.0, 0.0)
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
        arm_p += offset - shift
        s.loops.arms[2 * i] = arm_c
        s.loops.arms[2 * i + 1] = arm_p
        angular = closure.rows - linear
        lock_l = linear_lock(s.joints, joint, q_p)
        lock_a = angular_lock(s.joints, joint, q_p, q_c)
        # along the axis of a hinge, too: in a planar mechanism the others imply just that row
        axis_a = wp.quat_rotate(q_p, wp.vec3(0.0, 0.0, 1.0))
        if angular == 1 or angular == 2:
            axis_a = axis_of_projection(lock_a, angular)
        axis_l = axis_a
        if linear == 1 or linear == 2:
            axis_l = axis_of_projection(lock_l, linear)
        for k in range(closure.rows):
            row = closure.row + k
            if k < linear:
                n = direction_about(axis_l, wp.where(linear == 1, 2, k))
                closures.direction[row] = n
                closures.way[2 * row] = moves_c * wp.spatial_vector(n, wp.cross(arm_c, n))
                closures.way[2 * row + 1] = -moves_p * wp.spatial_vector(n, wp.cross(arm_p, n))
                closures.held[row] = wp.dot(n, s.loops.kept_force[i])
                closures.multiplier[row] = wp.float64(wp.dot(n, left))
                closures.least[row] = PENALTY / s.loops.k_l[i]
            else:
                n = direction_about(axis_a, wp.where(angular == 1, 2, k - linear))
                closures.direction[row] = n
                closures.way[2 * row] = moves_c * wp.spatial_vector(wp.vec3(0.0), n)
                closures.way[2 * row + 1] = -moves_p * wp.spatial_vector(wp.vec3(0.0), n)
                closures.held[row] = wp.dot(n, s.loops.kept_torque[i])
                closures.multiplier[row] = wp.float64(wp.dot(n, turn))
                closures.least[row] = PENALTY / s.loops.k_a[i]

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
        static_slot = s.work.inv_mass.shape[0] - 1
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, static_slot)
        moves_c = wp.where(s.work.inv_mass[child] > 0.0, 1.0, 0.0)
        moves_p = wp.where(s.work.inv_mass[parent] > 0.0, 1.0, 0.0)
        q_p, _q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        s.loops.arms[2 * i] = arm_c
        s.loops.arms[2 * i + 1] = arm_p
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
            closures.way[2 * row] = moves_c * wp.spatial_vector(n, wp.cross(arm_c, n))
            closures.way[2 * row + 1] = -moves_p * wp.spatial_vector(n, wp.cross(arm_p, n))
            closures.least[row] = PENALTY / s.loops.k_l[i]

    @wp.func
    def equality_row(closure: Closure, recovery: float, s: wp.ref[Solver]):
        """The row of an equality constraint, linear in the leader about where that is now."""
        closures = s.tree.closures
        misfit = equality_misfit(closure, s.tree.coordinate, s)
        if closure.leader_dof >= 0:
            met = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            met[closure.leader_dof] = -misfit[1]
            closures.met[closure.leader_place] = met
        # the other one may be an axis of the same joint
        met = closures.met[closure.place]
        met[closure.dof] = met[closure.dof] + 1.0
        closures.met[closure.place] = met
        left = misfit[0]
        if recovery == 0.0:
            left -= closures.misfit[closure.row]
        closures.multiplier[closure.row] = wp.float64(left)

    @wp.func
    def mimic_rows(closure: Closure, recovery: float, s: wp.ref[Solver]):
        """The rows of a mimic joint, one for each of its coordinates."""
        closures = s.tree.closures
        if not is_mimicking(closure, s):
            return
        if wp.static(effects.equalities):
            if closure.equality >= 0:
                equality_row(closure, recovery, s)
                return
        for dof in range(closure.rows):
            met = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            met[dof] = 1.0
            closures.met[closure.place + dof] = met
            met[dof] = -s.joints.mimic_coefficients[closure.joint][1]
            closures.met[closure.leader_place + dof] = met
            left = mimic_misfit(closure, dof, s.tree.coordinate, s)
            if recovery == 0.0:
                left -= closures.misfit[closure.row + dof]
            closures.multiplier[closure.row + dof] = wp.float64(left)

    @wp.func(inline=effects.inline)
    def begin_rows(first: int, end: int, recovery: float, h: float, s: wp.ref[Solver]):
        """Before elimination: the rows of a block where they start their ways."""
        closures = s.tree.closures
        number = closures.block_of[first]
        if number < 0:
            return
        block = closures.blocks[number]
        none = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        for k in range(block.gram, block.gram_end):
            closures.gram[k] = wp.float64(0.0)
        for i in range(first, end):
            body = s.worlds.bodies[i]
            node = closures.nodes[body]
            for p in range(node.start, node.stop):
                closures.met[p] = none
            if wp.static(effects.spatial_tendons):
                s.tree.tendons.root_curvature[body] = none
                if s.tree.joint[body] >= 0:
                    joint = s.tree.joint[body]
                    for dof in range(
                        linear_count(s.joints, joint) + angular_count(s.joints, joint)
                    ):
                        s.tree.tendons.curvature[s.tree.axis_start[body] + dof] = 0.0
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            for row in range(closure.row, closure.row + closure.rows):
                closures.way[2 * row] = none
                closures.way[2 * row + 1] = none
                closures.whole[row] = 0.0
                closures.least[row] = 0.0
                closures.held[row] = 0.0
                closures.multiplier[row] = wp.float64(0.0)
            if closure.loop >= 0:
                is_bound = bool(False)
                if wp.static(effects.kinds.distances):
                    is_bound = is_string(s.joints, s.loops.joints[closure.loop])
                    if is_bound:
                        string_rows(closure, recovery, s)
                if wp.static(effects.loops):
                    if not is_bound:
                        loop_rows(closure, recovery, s)
            else:
                is_cord = bool(False)
                if wp.static(effects.tendons):
                    is_cord = closure.tendon >= 0
                    if is_cord:
                        rank = s.worlds.rank
                        tendon_row(closure, recovery, h, rank, s)
                if wp.static(effects.mimics):
                    if not is_cord:
                        mimic_rows(closure, recovery, s)

    @wp.func
    def string_move(closure: Closure, static_slot: int, s: wp.ref[Solver]) -> wp.vec3:
        """How far the sweep has moved the ends of a DISTANCE joint against each other [m]."""
        i = closure.loop
        joint = s.loops.joints[i]
        c = s.tree.update[s.joints.child[joint]]
        p = s.tree.update[parent_slot(s.joints, joint, static_slot)]
        moved = wp.spatial_top(c) + wp.cross(wp.spatial_bottom(c), s.loops.arms[2 * i])
        return moved - wp.spatial_top(p) - wp.cross(wp.spatial_bottom(p), s.loops.arms[2 * i + 1])

    @wp.func
    def string_misses(closure: Closure, static_slot: int, s: wp.ref[Solver]) -> float:
        """What a sweep leaves of a DISTANCE joint to the next one, as a share of what it moved.

        Infinity where a bound pushes or pulls the wrong way, or none holds what has gone beyond it.
        """
        i = closure.loop
        row = closure.row
        joint = s.loops.joints[i]
        side = s.loops.side[i]
        moved = string_move(closure, static_slot, s)
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

    @wp.func
    def keep_forces(first: int, is_kept: bool, h: float, s: wp.ref[Solver]) -> float:
        """After substitution: what the joints of a block that close loops push with.

        Returns how far off their geometric stiffness was, as a share of the block.
        """
        closures = s.tree.closures
        mismatch = float(0.0)
        number = closures.block_of[first]
        if number < 0:
            return mismatch
        block = closures.blocks[number]
        static_slot = s.work.inv_mass.shape[0] - 1
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            i = closure.loop
            if i >= 0:
                linear = 3 - linear_count(s.joints, s.loops.joints[i])
                if wp.static(effects.kinds.distances):
                    if is_string(s.joints, s.loops.joints[i]):
                        linear = 3
                        off = string_misses(closure, static_slot, s)
                        mismatch = wp.max(mismatch, off)
                        if s.loops.side[i] == 0 or off == wp.inf:
                            s.history.loop_force[i] = wp.vec3(0.0)
                            continue
                force = wp.vec3(0.0)
                torque = wp.vec3(0.0)
                for k in range(closure.rows):
                    row = closure.row + k
                    along = wp.float32(closures.multiplier[row]) * closures.direction[row]
                    if k < linear:
                        force += along
                    else:
                        torque += along
                change = wp.length(force + s.history.loop_force[i])
                s.history.loop_force[i] = -force
                s.history.loop_torque[i] = -torque
                if is_kept:
                    s.loops.kept_force[i] = -force
                    s.loops.kept_torque[i] = -torque
                joint = s.loops.joints[i]
                held = wp.length(force)
                for end in range(2):
                    body = parent_slot(s.joints, joint, static_slot)
                    if end == 0:
                        body = s.joints.child[joint]
                    reach = wp.length(s.loops.arms[2 * i + end])
                    off = stiffness_off(body, reach, change, held, h, s.work)
                    mismatch = wp.max(mismatch, off)
        return mismatch

    @wp.func
    def missed_by_lines(first: int, recovery: float, s: wp.ref[Solver]) -> float:
        """After a sweep: what the equality constraints of a block are off by since they bend.

        Returns the largest square of it [m^2], of a hinge times the radius of gyration of its body;
        zero where rounding hides it.
        """
        closures = s.tree.closures
        largest = float(0.0)
        number = closures.block_of[first]
        if number < 0:
            return largest
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            is_own = closure.equality >= 0 and is_mimic(closure)
            if is_own and is_mimicking(closure, s):
                missed = equality_misfit(closure, s.tree.coordinate, s)[0]
                if recovery == 0.0:
                    missed -= closures.misfit[closure.row]
                axis = s.tree.axis_start[closure.body] + closure.dof
                moved = wp.float32(s.tree.coordinate[axis] - s.tree.start_coordinate[axis])
                if wp.abs(missed) > 2.0 * ROUNDING * wp.abs(moved) + LEAST_MISSED:
                    size = float(1.0)
                    if closure.dof >= s.joints.dof_dim[closure.joint, 0]:
                        body = closure.body
                        size = wp.trace(s.work.inertia[body]) * s.work.inv_mass[body]
                    largest = wp.max(largest, size * missed * missed)
        return largest

    @wp.func
    def begin_tendons(first: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Lengths of the tendons of a block at the start of the step, where bodies are there.

        Returns whether one is beyond its limits, or off what an equality constraint says.
        """
        closures = s.tree.closures
        number = closures.block_of[first]
        is_open = bool(False)
        if number < 0:
            return is_open
        block = closures.blocks[number]
        for turn in range(2):
            for c in range(block.first, block.end):
                closure = closures.closures[c]
                if closure.tendon >= 0 and (closure.other >= 0) == (turn == 1):
                    if begin_tendon(closure, scale, s):
                        is_open = True
        return is_open

    @wp.func
    def settle_tendons(first: int, recovery: float, h: float, s: wp.ref[Solver]) -> float:
        """After a sweep: what the tendons of a block are off by, the largest square of it [m^2]."""
        closures = s.tree.closures
        largest = float(0.0)
        number = closures.block_of[first]
        if number < 0:
            return largest
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            if closure.tendon >= 0:
                off = settle_tendon(closure, recovery, h, s)
                largest = wp.max(largest, off)
        return largest

    @wp.func
    def load_tendons(first: int, sign: float, s: wp.ref[Solver]):
        """Adds what spatial tendons of a block pull its bodies with to their loads."""
        closures = s.tree.closures
        number = closures.block_of[first]
        if number >= 0:
            block = closures.blocks[number]
            for c in range(block.first, block.end):
                if closures.closures[c].tendon >= 0:
                    tendon_wrench(closures.closures[c], sign, s)

    @wp.func
    def end_tendons(first: int, scale: WorldScale, tree: wp.ref[TreeWork]):
        """Second order: how the tendons of a block have moved."""
        closures = tree.closures
        number = closures.block_of[first]
        if number >= 0:
            block = closures.blocks[number]
            for c in range(block.first, block.end):
                if closures.closures[c].tendon >= 0:
                    end_tendon(closures.closures[c], scale, tree)

    return ClosureFunctions(
        begin_closures,
        begin_rows,
        keep_forces,
        missed_by_lines,
        begin_tendons,
        settle_tendons,
        load_tendons,
        end_tendons,
    )
