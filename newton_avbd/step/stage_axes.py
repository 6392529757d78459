# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Entries of joints in ``tree.axes``, as steps of fourth order count them."""

import functools

import warp as wp

from ..algebra.so3 import exp_quat
from ..data import Solver
from ..effects import Effects
from ..functions import Functions, together
from ..rows.joint import BALL, make_counts
from .bodies import nonnegative


@wp.func
def ball_turn(first: int, s: wp.ref[Solver]) -> wp.vec3:
    """Turn of a ball joint in the step [rad], parent anchor frame: entries from ``first`` on."""
    turn = wp.vec3()
    for dof in range(3):
        turn[dof] = wp.float32(s.tree.coordinate[first + dof])
    return turn


@wp.func
def ball_rotation(body: int, first: int, s: wp.ref[Solver]) -> wp.quat:
    """Rotation of the anchor on a ball joint's child against that on its parent."""
    return exp_quat(ball_turn(first, s)) * s.tree.runge_kutta.ball_start[body]


@functools.cache
def make_stage_axes(effects: Effects) -> Functions:
    """Device functions: whether a joint is a ball, and how many axes a body's joint has."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count

    @wp.func
    def is_ball(joint: int, s: wp.ref[Solver]) -> bool:
        """Whether a joint is a ball, whose axes are fixed in the parent."""
        if wp.static(effects.kinds.balls):
            return s.joints.type[joint] == BALL
        return False

    @wp.func
    def axis_count(body: int, s: wp.ref[Solver]) -> int:
        """Entries of the body in ``tree.axes``."""
        joint = nonnegative(s.tree.joint[body])
        return linear_count(s.joints, joint) + angular_count(s.joints, joint)

    return together(is_ball, axis_count)
