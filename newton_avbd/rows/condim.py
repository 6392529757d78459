# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Friction of the contacts of shapes that MuJoCo's rules are for.

The ``condim`` of a contact says what it resists beside penetration: 1 nothing, 3 sliding, 4 also
twisting, 6 also rolling. The shape of the higher ``priority`` decides about condim and
coefficients; of equal priority each is the larger one (MuJoCo's documentation, "Contact
parameters"). An explicit pair has its own.
"""

import functools

import warp as wp

from ..data import ShapeModel
from .contact import FRICTION_MIXES

SLIDING = wp.constant(3)
"""The condim from which a contact resists sliding."""
TWISTING = wp.constant(4)
"""Twisting."""
ROLLING = wp.constant(6)
"""Rolling."""


@wp.func
def of_condim(condim: int, friction: wp.vec3) -> wp.vec3:
    """Those of the coefficients (sliding, torsional [m], rolling [m]) that a condim lets act."""
    return wp.vec3(
        wp.where(condim >= SLIDING, friction[0], 0.0),
        wp.where(condim >= TWISTING, friction[1], 0.0),
        wp.where(condim >= ROLLING, friction[2], 0.0),
    )


@wp.func
def friction_of(shapes: wp.ref[ShapeModel], shape: int) -> wp.vec3:
    """A shape's coefficients (sliding, torsional [m], rolling [m])."""
    return wp.vec3(shapes.mu[shape], shapes.mu_torsional[shape], shapes.mu_rolling[shape])


@wp.func
def pair_of(shapes: wp.ref[ShapeModel], shape0: int, shape1: int) -> int:
    """The explicit pair of two shapes, -1 without."""
    first = wp.min(shape0, shape1)
    other = wp.max(shape0, shape1)
    for pair in range(shapes.pair_start[first], shapes.pair_start[first + 1]):
        if shapes.pair_other[pair] == other:
            return pair
    return -1


@wp.func
def margin_beyond(shapes: wp.ref[ShapeModel], shape0: int, shape1: int) -> float:
    """By how much the margin of an explicit pair exceeds those of its two shapes [m]."""
    pair = pair_of(shapes, shape0, shape1)
    if pair < 0:
        return 0.0
    return shapes.pair_margin[pair] - shapes.margin[shape0] - shapes.margin[shape1]


@functools.cache
def make_mixed_friction(mix: str, has_pairs: bool) -> wp.Function:
    """Device function that returns the coefficients of a contact.

    Args:
        mix: Rule for contacts of shapes that are not MuJoCo's, of :data:`FRICTION_MIXES`.
        has_pairs: Whether there are explicit pairs.
    """
    mixed = FRICTION_MIXES[mix]

    @wp.func
    def mixed_friction(shapes: wp.ref[ShapeModel], shape0: int, shape1: int) -> wp.vec3:
        """Coefficients (sliding, torsional [m], rolling [m]) of a contact of two shapes."""
        if wp.static(has_pairs):
            pair = pair_of(shapes, shape0, shape1)
            if pair >= 0:
                return shapes.pair_friction[pair]
        friction0 = friction_of(shapes, shape0)
        friction1 = friction_of(shapes, shape1)
        condim0 = shapes.condim[shape0]
        condim1 = shapes.condim[shape1]
        condim = wp.max(wp.abs(condim0), wp.abs(condim1))
        friction = wp.max(friction0, friction1)
        precedence = shapes.priority[shape0] - shapes.priority[shape1]
        if precedence > 0:
            condim = wp.abs(condim0)
            friction = friction0
        elif precedence < 0:
            condim = wp.abs(condim1)
            friction = friction1
        if condim0 < 0 and condim1 < 0:
            for k in range(3):
                friction[k] = mixed(friction0[k], friction1[k])
        return of_condim(condim, friction)

    return mixed_friction
