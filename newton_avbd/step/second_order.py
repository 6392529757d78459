# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Second order in time where the motion is smooth, on poses and velocities: see ``slopes.py``.

A step is backward Euler with a step H < h, which starts ahead by s and with the velocity v_n + ...:

    x_n+1 = x_n + s + H v_n+1,    v_n+1 = v_n + (b h a_n + A g_n) + H a_n+1

So the increment from x_n is still the unknown and is where constraints hold; the inertia is m/H^2,
the inertial target s + H (v_n + ...) + H^2 a, and the velocity (dx - s)/H, which dampers and
friction see. Rotations go by the rotation vectors of the steps, which commute to the third order of
h; momenta add up in world axes.

A body that flies, held by nothing, takes the trapezoidal rule instead, and the implicit midpoint
rule for its spin where that is slow. Where no velocity of what is held changes, the next step is
backward Euler.

What extrapolates is wrong where the velocity jumps: a body that lands would bounce. A world takes
backward Euler in the step of an impact and in the one after it, where a contact lets go or an
external force jumps, after sweeps that did not settle, in its first step, and where its state or
its masses are not those that the last step left. Forces that external wrenches exert count with all
of their impulse in the step that they are given for.

Each part has a file: whether a motion is smooth (:mod:`.step.smoothness`), where a step starts
(:mod:`.step.leading`, :mod:`.step.flight`), and what it leaves (:mod:`.step.motion_history`).
"""

import warp as wp

from ..data import Solver, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from .bodies import body_at, spin_momentum
from .islands import is_free_island, sum_moves
from .leading import make_leading
from .motion_history import make_motion_history
from .slopes import JUMPED, LASTING, QUIET_WORLD, RHO, SMOOTH, constants, is_going_on, second_order
from .smoothness import last_of, make_smoothness


@wp.func
def lead_spin(world: int, scale: WorldScale, s: wp.ref[Solver]):
    """Has :func:`.islands.keep_spin` restore the angular momentum of a step of second order.

    A free island lacks sum r x m v + I w at the start, and what wrenches add, less that at the end,
    each with its own poses. By the arms of the start alone what holds bodies together would not
    cancel: constraints act where bodies end, and these have not moved along their velocities. How
    far the island's COM has moved [m] goes to its ``momentum``.
    """
    sum_moves(world, s)
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = s.worlds.bodies[i]
        if s.work.inv_mass[body] > 0.0 and is_free_island(s.islands, body, -1):
            velocity = s.history.last[body].velocity
            push = scale.h * s.work.wrench[body]
            v = wp.spatial_top(velocity) + s.model.inv_mass[body] * wp.spatial_top(push)
            s.work.coasting[body] = wp.spatial_vector(scale.step * v, wp.vec3(0.0))
            moved = wp.spatial_top(s.work.increment[body])
            moved -= s.islands.sum[s.islands.parent[body]].momentum
            momentum = spin_momentum(
                s.model, body, wp.transform_get_rotation(s.work.pose[body]), velocity
            )
            momentum += wp.spatial_bottom(push)
            # keep_spin has the arms of the end
            momentum -= s.model.mass[body] * wp.cross(moved, v)
            s.work.momentum[body] = momentum


def make_order_world(effects: Effects) -> wp.Function:
    """Device function: decides on the order of a world's step."""
    a, b = constants(0.0 if effects.cables else RHO)
    a_0, b_0 = constants(0.0)

    @wp.func
    def order_world(
        world: int,
        last: int,
        is_smooth: bool,
        is_continued: bool,
        scale: WorldScale,
        s: wp.ref[Solver],
    ) -> WorldScale:
        """The scale of a world's step, of second order where it continues a smooth motion."""
        out = scale
        out.age = s.history.slope_age[world]
        age = float(0.5)
        if is_smooth and is_continued:
            s.history.smooth[world] = wp.min(last + 1, LASTING)
            age = wp.where(last == LASTING, wp.static(a), wp.static(a_0))
            b_now = wp.where(last == LASTING, wp.static(b), wp.static(b_0))
            out = second_order(out, age, b_now)
        else:
            s.history.smooth[world] = wp.where(is_smooth, SMOOTH, JUMPED)
            if last < JUMPED:
                s.history.smooth[world] = last + 1
        s.worlds.step[world] = out.step
        s.history.slope_age[world] = age * out.h
        return out

    return order_world


def make_second_order(effects: Effects) -> Functions:
    """Device functions of steps of second order."""
    smoothness = make_smoothness(effects)
    is_smooth, goes_on = smoothness.is_smooth, smoothness.goes_on
    order_world = make_order_world(effects)
    leading = make_leading(effects)
    begin_body, start_body, lead_rows = leading.begin_body, leading.start_body, leading.lead_rows
    motion_history = make_motion_history(effects)

    @wp.func
    def begin_step(
        world: int,
        has_bounce: bool,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        s: wp.ref[Solver],
    ) -> WorldScale:
        """Decides on the order of a world's step, and makes targets and rows those of it."""
        is_held = bool(False)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            if begin_body(i, scale, body_qd, s):
                is_held = True
        last = last_of(world, s.history)
        may_last = is_held and last != QUIET_WORLD and not has_bounce
        may_last = may_last and is_smooth(world, scale, s)
        lasts = may_last and is_going_on(last)
        if lasts:
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                body = body_at(i, s.worlds)
                if lasts and not goes_on(body, body_qd, scale, s):
                    lasts = False
        out = order_world(world, last, may_last, lasts, scale, s)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            start_body(body_at(i, s.worlds), out, body_qd, s)
        if wp.static(effects.contact):
            if out.step < out.h:
                for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                    lead_rows(world, body_at(i, s.worlds), out, s)
        return out

    return together(begin_step, order_world, smoothness, leading, motion_history)
