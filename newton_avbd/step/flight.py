# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies that fly, held by nothing, in a scheme of second order.

They take the trapezoidal rule, and the implicit midpoint rule for their spin, in parts where that
is fast. What spins fast beside what it may touch takes backward Euler.
"""

import warp as wp

from ..algebra.so3 import exp_quat, rotation_vector
from ..data import BodyWork, History, Solver, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows import contact as contact_rows
from .beginning import is_in_tree
from .bodies import free_turn_of, has_rows, midpoint_parts
from .carrying import flight_from, gained_in_flight, is_short
from .loops import has_loops
from .piles import row_count, row_of

SLOW = wp.constant(1.0e-2)
"""Turn of a step [rad] up to which the mean of the spins at its ends keeps the energy of what
flies: it gains 5e-8 of it a step at 0.05 rad, and some 5e-12 here."""


@wp.func
def parabola(
    slot: int, h: float, body_qd: wp.array[wp.spatial_vector], work: wp.ref[BodyWork]
) -> wp.spatial_vector:
    """Where a body goes that flies, from its target by backward Euler."""
    if work.inv_mass[slot] == 0.0:
        return work.target[slot]
    return 0.5 * (work.target[slot] + h * body_qd[slot])


@wp.func
def is_flying(body: int, history: wp.ref[History]) -> bool:
    """Whether nothing holds a body in this step, as :func:`begin_step` has found."""
    return history.flying[body] != 0


def make_flight(effects: Effects) -> Functions:
    """Device functions of bodies that fly."""

    @wp.func
    def will_fly(
        i: int,
        body: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        s: wp.ref[Solver],
    ) -> bool:
        """Whether nothing holds a body in a step, not even a contact that its parabola nears."""
        if wp.static(effects.drag or effects.cables or effects.tendons):
            return False
        if wp.static(effects.joints):
            if is_in_tree(i, s):
                return False
        if wp.static(effects.loops):
            if has_loops(s.loops, body):
                return False
        if wp.static(effects.contact):
            for k in range(row_count(body, s.rows)):
                row = s.rows.rows[row_of(body, k, s.rows)]
                span = s.work.com[row.a] - s.work.com[row.b]
                target_a = parabola(row.a, scale.h, body_qd, s.work)
                target_b = parabola(row.b, scale.h, body_qd, s.work)
                u = contact_rows.slip(row, target_a, target_b, span)
                is_near = wp.dot(row.normal, u) + row.gap <= scale.slop
                if is_near or wp.length_sq(row.force) > 0.0:
                    return False
        return True

    @wp.func
    def may_touch(body: int, s: wp.ref[Solver]) -> bool:
        """Whether something is in reach of a body in the step."""
        if wp.static(effects.contact):
            return has_rows(s.rows, body)
        return False

    @wp.func
    def fly_body(
        body: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ):
        """Lead and target of a body that flies: the trapezoidal rule, which makes a parabola.

        Its velocity is that of backward Euler; its angular momentum is kept by the end.
        """
        turn = 0.5 * wp.spatial_bottom(s.work.target[body] + s.work.coasting[body])
        rotation = wp.transform_get_rotation(s.work.pose[body])
        velocity = body_qd[body]
        if wp.static(effects.gyroscopic):
            parts = midpoint_parts(s.model, body, rotation, velocity, scale.h)
            if parts == 0 or (parts > 1 and may_touch(body, s)):
                # rows are linear in the turn: one of several parts says less of where points go
                turn = wp.spatial_bottom(s.work.target[body])
            elif wp.length_sq(turn) > SLOW * SLOW:
                wrench = s.work.wrench[body]
                own, _spin = free_turn_of(s.model, body, rotation, velocity, wrench, scale.h, parts)
                turn = wp.quat_rotate(rotation, rotation_vector(own))
        shift = 0.5 * wp.spatial_top(s.work.target[body] + s.work.coasting[body])
        target = wp.spatial_vector(shift, turn)
        if wp.static(effects.carried_rounding):
            if is_short(scale.h):
                flight = flight_from(body, s.work.pose[body], velocity, s.history.flights)
                s.work.gained[body] = flight.lost + gained_in_flight(
                    s.model,
                    body,
                    rotation,
                    velocity,
                    s.work.wrench[body],
                    exp_quat(wp.quat_rotate_inv(rotation, turn)),
                    scale.h,
                )
                s.history.flights[body] = flight
        s.work.lead[body] = target - (scale.step / scale.h) * s.work.target[body]
        s.work.target[body] = target
        s.work.increment[body] = target

    return together(will_fly, fly_body)
