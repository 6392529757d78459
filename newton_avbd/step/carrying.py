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

from ..algebra.so3 import turned_by, turned_from
from ..data import BodyModel, Flight, Solver, WorldScale

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
def flight_from(
    body: int, pose: wp.transform, velocity: wp.spatial_vector, flights: wp.array[Flight]
) -> Flight:
    """What is known of how a body flew, if it is given what its last flight left."""
    flight = flights[body]
    if flight.pose == pose and flight.velocity == velocity:
        return flight
    return Flight()


@wp.func
def gained_in_flight(
    model: wp.ref[BodyModel],
    body: int,
    rotation: wp.quat,
    velocity: wp.spatial_vector,
    wrench: wp.spatial_vector,
    turn: wp.quat,
    h: float,
) -> wp.spatial_vector:
    """What the velocity of a body gains that nothing holds [m/s, rad/s], world axes.

    Its spin keeps the momentum, L' = L + h torque, and turns with the body:

        w' - w = (E w - w) + I'^-1 (L' - E L).

    Nothing large cancels in that.

    Args:
        model: The model.
        body: The body.
        rotation: Orientation at the start.
        velocity: At the start [m/s, rad/s].
        wrench: External force [N] and torque [N m], without the weight.
        turn: E, how the body turns, in its own axes.
        h: Time step [s].
    """
    push = model.inv_mass[body] * wp.spatial_top(wrench)
    shot = h * (model.gravity[model.world[body]] + push)
    spin = wp.quat_rotate_inv(rotation, wp.spatial_bottom(velocity))
    kick = h * wp.quat_rotate_inv(turn, wp.quat_rotate_inv(rotation, wp.spatial_bottom(wrench)))
    kick -= turned_from(turn, model.inertia[body] * spin)
    spun = turned_by(turn, spin) + wp.quat_rotate(turn, model.inv_inertia[body] * kick)
    return wp.spatial_vector(shot, wp.quat_rotate(rotation, spun))


@wp.func
def carry_velocity(
    body: int,
    velocity: wp.spatial_vector,
    rounded: wp.spatial_vector,
    scale: WorldScale,
    body_qd: wp.array[wp.spatial_vector],
    s: wp.ref[Solver],
) -> wp.spatial_vector:
    """Velocity of a body by what it has gained; other steps than those of second order begin anew.

    ``rounded`` is what rounding took from the increment. ``work.gained`` becomes by how much more
    the velocity has gained than the states tell.
    """
    lost = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    more = lost
    is_flying = s.history.flying[body] != 0
    if is_flying or scale.step < scale.h:
        before = body_qd[body]
        pulled = (s.work.increment[body] - s.work.target[body]) + rounded
        gained = s.work.gained[body] + (1.0 / scale.step) * pulled
        velocity = before + gained
        lost = gained - (velocity - before)
        if is_flying:
            s.history.flights[body].velocity = velocity
            s.history.flights[body].lost = lost
            return velocity
        more = lost - s.history.last[body].lost
    s.history.last[body].lost = lost
    s.work.gained[body] = more
    return velocity


@wp.func
def less_one(turn: wp.quat) -> wp.quat:
    """A turn less the unit quaternion; of a small one w - 1 would round."""
    axis = wp.vec3(turn[0], turn[1], turn[2])
    return wp.quat(axis[0], axis[1], axis[2], -wp.length_sq(axis) / (1.0 + turn[3]))


@wp.func
def sum_turn(before: wp.quat, further: wp.quat, after: wp.quat, lost: wp.quat):
    """The quaternion ``before + further + lost``, and what rounding takes from that.

    ``after`` is the rounded one of unit length; it stays as it is where the body has been turned
    otherwise, too, or far.
    """
    beyond = (before - after) + further + lost
    beyond -= wp.dot(beyond, after) * after
    none = wp.quat(0.0, 0.0, 0.0, 0.0)
    if not wp.dot(beyond, beyond) < ROUNDED_TURN * ROUNDED_TURN:
        return after, none
    carried = after + beyond
    return carried, beyond - (carried - after)


@wp.func
def carry_turn(body: int, before: wp.quat, after: wp.quat, s: wp.ref[Solver]) -> wp.quat:
    """Orientation of a body of a tree, from ``after``, which is rounded."""
    lost = wp.quat(0.0, 0.0, 0.0, 0.0)
    if s.tree.is_left[body]:
        lost = s.history.lost_turn[body]
    after, lost = sum_turn(before, less_one(s.tree.swing[body]) * before, after, lost)
    s.history.lost_turn[body] = lost
    return after


@wp.func
def carry_flight(
    body: int,
    pose: wp.transform,
    after: wp.transform,
    shift: wp.vec3,
    further: wp.quat,
    flights: wp.array[Flight],
) -> wp.transform:
    """Pose of a body that flew, from ``after``, which is rounded; kept for the next step.

    Args:
        body: The body.
        pose: At the start.
        after: At the end.
        shift: From that to this [m].
        further: By how much its quaternion has changed.
        flights: That of this step, with what earlier ones have lost.
    """
    before = wp.transform_get_rotation(pose)
    rotation = wp.transform_get_rotation(after)
    rotation, lost_turn = sum_turn(before, further, rotation, flights[body].lost_turn)
    start = wp.transform_get_translation(pose)
    moved = shift + flights[body].lost_shift
    end = start + moved
    flights[body].lost_shift = moved - (end - start)
    flights[body].lost_turn = lost_turn
    flights[body].pose = wp.transform(end, rotation)
    return wp.transform(end, rotation)
