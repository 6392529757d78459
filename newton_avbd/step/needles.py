# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How contacts turn needles, whose moment about their long axis is next to nothing.

Of a needle 1,000 times as long as thick it is a millionth of the other two. A torque about the axis
that should not be there, since a lever is off by more than the radius of gyration about it, would
spin the needle up without end. As a needle tilts within a step the levers of its ends change by
more than that. So contacts of a needle that tilts do not roll it.
"""

import warp as wp

from ..data import ContactRow, Solver
from ..model.callers import NEEDLE
from ..rows import contact as contact_rows
from .bodies import has_rows, is_loose

ROUNDED = wp.constant(5.0e-7)
"""What rounding may take from a block along the long axis, as a share of its angular part."""


@wp.func
def long_axis(inertia: wp.mat33) -> wp.mat33:
    """a a^T of the long axis a of a needle, from its inertia, in the axes of that.

    1 - 2 I / tr I is 1 along the axis and next to zero across it: to the eighth power it is a a^T.
    """
    share = wp.identity(3, dtype=float) - (2.0 / wp.trace(inertia)) * inertia
    share = share * share
    share = share * share
    return share * share


@wp.func
def is_needle(body: int, reach: float, s: wp.ref[Solver]) -> bool:
    """Whether a body is a needle whose radius of gyration about its axis is below ``reach`` [m]."""
    if not is_loose(body, s):
        return False
    least = 1.0 / wp.trace(s.work.inv_inertia[body])
    if least * s.work.inv_mass[body] > reach * reach:
        return False
    return least < wp.static(NEEDLE) * wp.trace(s.work.inertia[body])


@wp.func
def tilts_too_far(body: int, turn: wp.vec3, s: wp.ref[Solver]) -> bool:
    """Whether a touched body is a needle that tilts too far in a step for one of second order.

    Such a step has the inertia of its end, and here the levers of its start.
    """
    if s.work.inv_mass[body] == 0.0 or not has_rows(s.rows, body):
        return False
    inertia = s.work.inertia[body]
    half_length = wp.sqrt(1.5 * wp.trace(inertia) * s.work.inv_mass[body])
    tilt = wp.length(turn - long_axis(inertia) * turn)
    return is_needle(body, half_length * tilt, s)


@wp.func
def off_axis(body: int, arm: wp.vec3, closing: float, s: wp.ref[Solver]) -> wp.vec3:
    """What a contact's lever about the long axis of a needle is, where the needle tilts by more.

    Args:
        body: The body.
        arm: From its COM to the contact [m].
        closing: By how much the contact would close beyond its gap [m].
        s: The solver.
    """
    if s.work.inv_mass[body] == 0.0:
        return wp.vec3(0.0)
    length = wp.length(arm)
    turn = wp.spatial_bottom(s.work.target[body])
    tilt = wp.length(turn) + closing / length
    if not is_needle(body, 0.5 * length * tilt * tilt, s):
        return wp.vec3(0.0)
    axis = long_axis(s.work.inertia[body])
    tilt = wp.length(turn - axis * turn) + closing / length
    if not is_needle(body, 0.5 * length * tilt * tilt, s):
        return wp.vec3(0.0)
    return arm - axis * arm


@wp.func
def off_axes(row: ContactRow, s: wp.ref[Solver]) -> wp.vec3:
    """By how much the point of a contact is off the long axis of what does not roll by it [m].

    Nothing where two needles tilt: the point cannot be on both axes.
    """
    span = s.work.com[row.a] - s.work.com[row.b]
    u = contact_rows.slip(row, s.work.target[row.a], s.work.target[row.b], span)
    closing = wp.max(-wp.dot(row.normal, u) - wp.max(row.gap, 0.0), 0.0)
    aside_a = off_axis(row.a, row.arm, closing, s)
    aside_b = off_axis(row.b, row.arm + span, closing, s)
    if wp.length_sq(aside_a) * wp.length_sq(aside_b) > 0.0:
        return wp.vec3(0.0)
    return aside_a + aside_b


@wp.func
def stiffened_axis(body: int, angular: wp.mat33, s: wp.ref[Solver]) -> wp.mat33:
    """The angular part of a body's block, with what rounding may take from it along a needle."""
    if not is_needle(body, wp.inf, s):
        return angular
    return angular + (ROUNDED * wp.trace(angular)) * long_axis(s.work.inertia[body])
