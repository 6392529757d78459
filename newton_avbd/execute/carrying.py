# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What rounding takes from poses and velocities goes on to the next step (compensated sums).

A step of 1/6000 s adds some 1e-3 m/s to velocities of meters a second, which round by 1e-7 of
themselves, each step anew. So the velocity is not read off the increment, but is that of the start
and what it gains:

    v' = v + (lost + d + (dx - dx*)/H),    lost' = what rounding takes from that sum,

with d what it gains up to the target dx*, and H the step that inertia sees. The gain is small, and
so is its rounding. Likewise poses.

What was lost goes on where the next step is given the bits that the last one wrote. (W. Kahan,
"Further remarks on reducing truncation errors", 1965; E. Hairer, C. Lubich, G. Wanner, "Geometric
Numerical Integration", section VIII.5.)
"""

import warp as wp

from ..algebra.so3 import exp_quat, turned_by, turned_inertia
from ..data import BodyWork, History, TreeWork, WorldScale

SHORT = wp.constant(1.0e-3)
"""Steps below which rounding is carried [s]: longer ones are off by more than it adds up to."""
ROUNDED_TURN = wp.constant(1.0e-6)
"""Most that rounding takes from a quaternion in a step."""


@wp.func
def is_short(h: float) -> bool:
    """Whether a step is so short that rounding is carried."""
    return h < SHORT


@wp.func
def is_carried(scale: WorldScale) -> bool:
    """Whether velocities of a step's held bodies are carried: of second order, and short."""
    return scale.step < scale.h and is_short(scale.h)


@wp.func
def gained_spin(
    before: wp.quat,
    after: wp.quat,
    spin: wp.vec3,
    kick: wp.vec3,
    turn: wp.vec3,
    inertia: wp.mat33,
    inv_inertia: wp.mat33,
) -> wp.vec3:
    """What a kick adds to the spin of a body that turns [rad/s], world axes.

    With L = I w, the momentum of the start, w' = I'^-1 (L + kick) is

        w' - w = (E w - w) + I'^-1 (kick - (E L - L)),

    as what turns along with the body keeps its momentum. Nothing large cancels in that.

    Args:
        before: Orientation at the start.
        after: At the end.
        spin: w, at the start [rad/s].
        kick: What is added to the momentum [N m s].
        turn: Rotation vector of E, from the start to the end [rad].
        inertia: In body axes [kg m^2].
        inv_inertia: Its inverse.
    """
    swing = exp_quat(turn)
    change = kick - turned_by(swing, turned_inertia(before, inertia, spin))
    return turned_inertia(after, inv_inertia, change) + turned_by(swing, spin)


@wp.func
def gained_momentum(
    before: wp.quat,
    after: wp.quat,
    spin: wp.vec3,
    gained: wp.vec3,
    turn: wp.vec3,
    inertia: wp.mat33,
) -> wp.vec3:
    """By how much the angular momentum of a body has changed [N m s], world axes.

    The other way round: I' (w' - w - (E w - w)) + (E L - L).

    Args:
        before: Orientation at the start.
        after: At the end.
        spin: w, at the start [rad/s].
        gained: w' - w [rad/s].
        turn: Rotation vector of E, from the start to the end [rad].
        inertia: In body axes [kg m^2].
    """
    swing = exp_quat(turn)
    change = turned_inertia(after, inertia, gained - turned_by(swing, spin))
    return change + turned_by(swing, turned_inertia(before, inertia, spin))


@wp.func
def carry_velocity(
    body: int,
    velocity: wp.spatial_vector,
    scale: WorldScale,
    body_qd: wp.array[wp.spatial_vector],
    work: wp.ref[BodyWork],
    history: wp.ref[History],
) -> wp.spatial_vector:
    """Velocity of a held body by what it has gained; others and other steps begin anew.

    ``work.gained`` becomes by how much more it has gained than velocities tell.
    """
    if not is_short(scale.h):
        return velocity
    lost = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    more = lost
    if scale.step < scale.h and history.flying[body] == 0:
        before = body_qd[body]
        pulled = (work.increment[body] - work.target[body]) + work.rounded[body]
        gained = work.gained[body] + pulled / scale.step
        velocity = before + gained
        lost = gained - (velocity - before)
        more = lost - history.last[body].lost
    history.last[body].lost = lost
    work.gained[body] = more
    return velocity


@wp.func
def sum_turn(before: wp.quat, swing: wp.quat, after: wp.quat, lost: wp.quat):
    """Orientation after a swing with what has been lost before, and what is lost of that.

    ``after`` is the rounded one; it stays as it is where the body has been turned otherwise, too.
    """
    axis = wp.vec3(swing[0], swing[1], swing[2])
    # w - 1, which rounds where the turn is small
    less = -wp.length_sq(axis) / (1.0 + swing[3])
    beyond = (before - after) + wp.quat(axis[0], axis[1], axis[2], less) * before + lost
    beyond -= wp.dot(beyond, after) * after
    none = wp.quat(0.0, 0.0, 0.0, 0.0)
    if not wp.dot(beyond, beyond) < ROUNDED_TURN * ROUNDED_TURN:
        return after, none
    carried = after + beyond
    return carried, beyond - (carried - after)


@wp.func
def carry_turn(
    body: int,
    before: wp.quat,
    after: wp.quat,
    tree: wp.ref[TreeWork],
    history: wp.ref[History],
) -> wp.quat:
    """Orientation of a body of a tree, from ``after``, which is rounded."""
    lost = wp.quat(0.0, 0.0, 0.0, 0.0)
    if tree.is_left[body]:
        lost = history.lost_turn[body]
    after, lost = sum_turn(before, tree.swing[body], after, lost)
    history.lost_turn[body] = lost
    return after
