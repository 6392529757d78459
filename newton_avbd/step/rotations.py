# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How far bodies have turned in a step, and orientations after that."""

import warp as wp

from ..algebra.so3 import exp_quat, rotation_vector
from ..data import BodyWork, Solver, TreeWork
from ..rows.angle import wrapped

COUNTED = wp.constant(1.0)
"""Turn of a joint in a step from which orientations may not tell it [rad]."""
MOST_TURN = wp.constant(1.0)
"""Most that an iteration turns a body [rad]: what is linear in a turn says nothing beyond."""


@wp.func
def turn_by(body: int, rest: wp.vec3, tree: wp.ref[TreeWork]):
    """Orientation of a body that turns by the ``rest`` after the turn of :func:`begin_turn`.

    The rest is a rotation vector [rad], world axes.
    """
    swing = exp_quat(rest)
    tree.rotation[body] = swing * tree.turned[body]
    turn = tree.turn[body]
    if wp.length_sq(turn) > 0.0:
        swing = swing * exp_quat(turn)
    tree.swing[body] = swing


@wp.func
def place_body(body: int, s: wp.ref[Solver]):
    """Orientation of a body after its increment, the turn of :func:`begin_turn` first.

    The rest is small, where the increment is many radians.
    """
    turn_by(body, wp.spatial_bottom(s.work.increment[body]) - s.tree.turn[body], s.tree)


@wp.func
def begin_turn(body: int, turn: wp.vec3, s: wp.ref[Solver]):
    """Orientation of a body that is to turn as said [rad], whatever the sweeps add to it."""
    rotation = wp.transform_get_rotation(s.work.pose[body])
    s.tree.turn[body] = turn
    if wp.length_sq(turn) > 0.0:
        s.tree.turned[body] = exp_quat(turn) * rotation
        place_body(body, s)
    else:
        swing = exp_quat(wp.spatial_bottom(s.work.increment[body]))
        s.tree.turned[body] = rotation
        s.tree.rotation[body] = swing * rotation
        s.tree.swing[body] = swing


@wp.func
def relative_turn(child: int, parent: int, tree: wp.ref[TreeWork]) -> wp.quat:
    """Turn of a body against its parent in the step, world axes."""
    return tree.swing[child] * wp.quat_inverse(tree.swing[parent])


@wp.func
def full_turns(child: int, parent: int, work: wp.ref[BodyWork]) -> wp.vec3:
    """About how far a body turns in the step against its parent [rad], world axes.

    Orientations do not tell turns of more than half a revolution: this does, for a motor. Zero
    where there is nothing to tell.
    """
    turn = wp.spatial_bottom(work.increment[child] - work.increment[parent])
    if wp.length_sq(turn) > COUNTED * COUNTED:
        return turn
    return wp.vec3(0.0)


@wp.func
def ball_turn(child: int, parent: int, q_p: wp.quat, s: wp.ref[Solver]) -> wp.vec3:
    """Turn of a ball joint in the step [rad], parent anchor frame."""
    turn = rotation_vector(relative_turn(child, parent, s.tree))
    about = full_turns(child, parent, s.work)
    if wp.length_sq(about) > 0.0:
        axis = wp.normalize(turn)
        angle = wp.dot(axis, about)
        turn = (angle + wrapped(wp.dot(axis, turn) - angle)) * axis
    return wp.quat_rotate_inv(q_p, turn)
