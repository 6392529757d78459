# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Equations between coordinates of joints: mimic joints, and equality constraints of MuJoCo's."""

import warp as wp

from ..data import Closure, JointModel, Solver
from ..effects import Effects
from ..functions import Functions, together
from .anchors import ROUNDING, is_linked
from .islands import HELD

LEAST_MISSED = wp.constant(1.0e-9)
"""What a polynomial may be off by in a sweep [m or rad]. Coordinates of a step count in float64
from where it starts; what misses the velocity in each step adds up."""


@wp.func
def is_mimic(closure: Closure) -> bool:
    """Whether a closure ties coordinates of joints."""
    return closure.loop < 0 and closure.tendon < 0


@wp.func
def is_mimicking(closure: Closure, s: wp.ref[Solver]) -> bool:
    """Whether a mimic joint and its leader are enabled."""
    return is_linked(closure.body, s) and is_linked(closure.leader_body, s)


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


def make_join_mimics(join: wp.Function) -> wp.Function:
    """Device function that makes one island of what mimics of a block tie, by ``join``."""

    @wp.func
    def join_mimics(first: int, s: wp.ref[Solver]):
        closures = s.tree.closures
        number = closures.block_of[first]
        if number < 0:
            return
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            if is_mimic(closure) and is_mimicking(closure, s):
                leader = closure.leader_body
                if s.work.inv_mass[closure.body] > 0.0:
                    join(closure.body, leader, HELD, s)
                elif s.work.inv_mass[leader] > 0.0:
                    join(leader, closure.body, HELD, s)

    return join_mimics


def make_mimics(effects: Effects) -> Functions:
    """Device functions: how mimics stand at the start of the step, and their rows."""

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

    return together(begin_closures, mimic_rows)
