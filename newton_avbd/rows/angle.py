# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Angles of joints: less whole turns, with as many as they have made, and about an axis."""

import math

import warp as wp

from ..algebra.so3 import angle_of


@wp.func
def wrapped(angle: float) -> float:
    """The angle less whole turns, in [-pi, pi] [rad]."""
    return angle - wp.static(2.0 * math.pi) * wp.round(angle * wp.static(0.5 / math.pi))


@wp.func
def reduced(angle: wp.float64) -> float:
    """The angle less whole revolutions, in [-pi, pi] [rad]: of many, float32 tells too little."""
    turns = wp.round(angle * wp.static(wp.float64(0.5 / math.pi)))
    return wp.float32(angle - wp.static(wp.float64(2.0 * math.pi)) * turns)


@wp.func
def counted(angle: float, known: wp.float64) -> wp.float64:
    """The angle with as many whole turns as brings it nearest to the ``known`` one [rad].

    In float64: after hours of turns float32 would not tell how far a wheel turns in a step.
    """
    found = wp.float64(angle)
    turns = wp.round((known - found) * wp.static(wp.float64(0.5 / math.pi)))
    return found + wp.static(wp.float64(2.0 * math.pi)) * turns


@wp.func
def turn_about(axis: wp.vec3, start: wp.vec3, end: wp.vec3) -> float:
    """Angle about a unit axis [rad] that turns one vector square to it into another."""
    return angle_of(wp.dot(axis, wp.cross(start, end)), wp.dot(start, end))
