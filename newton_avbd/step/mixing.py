# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Anderson mixing: where links touch something, sweeps go on from more than the last one.

A robot and the box in its gripper are solved in turns, each as if the other stood still, and so are
two links of a robot that press on each other. What both share, such as the lift of the box, then
needs the more sweeps the stiffer contacts are. And a foot that lands has a penalty for its own
mass, where stiff drives put all of the robot behind it: each sweep leaves 0.96 of what its force
lacks. But a sweep is a map z -> F(z) of the increments of all bodies and of the multipliers of all
contacts, and one that converges slowly does so along few directions, which its last updates
d = F(z) - z tell. So the next sweep starts from

    F_k - t_1 (F_k - F_k-1) - t_2 (F_k-1 - F_k-2)

with those t for which the same mixture of updates, d_k - t_1 (d_k - d_k-1) - t_2 (d_k-1 - d_k-2),
is least. Updates count by their energy: m |dx|^2 / h^2, and |df|^2 / k of multipliers. After one
that is larger than the last one, nothing is mixed. See Anderson (1965), Walker and Ni (2011), and
Zhang, Peng, Ouyang and Deng (2019) for methods of multipliers. A step ends with a sweep, so that
what mixing cannot know, closed joints and cones of friction, holds.
"""

import warp as wp

from ..data import MixedBody, MixedRow, Solver
from ..effects import Effects
from .beginning import is_in_tree
from .bodies import body_at, has_rows
from .rotations import place_body
from .sweep_tree import make_move

MOST_MIXED = wp.constant(4.0)
"""Most that a difference of sweeps counts. The last one counts by zero at least: sweeps that
overshoot are not shortened."""
MOST_TURN = wp.constant(0.1)
"""Turn of a body from sweep to sweep [rad] beyond which the last ones tell nothing of the next."""
UNCERTAIN = wp.constant(1.0e-2)
"""Share of itself that is added to the square of each difference, since they are alike."""
MIXED_FACTOR = wp.constant(2)
"""How many times more a world sweeps then: with 10 sweeps an arm that pushes a box is off by 39 mm
after a second at 60 Hz, with 20 by 6 mm; without mixing 10 sweeps leave 136 mm."""


@wp.func
def begin_mixing(world: int, s: wp.ref[Solver]) -> bool:
    """Notes from where the next sweep starts, if a link touches something; returns whether."""
    is_mixed = bool(False)
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = body_at(i, s.worlds)
        if has_rows(s.rows, body) and is_in_tree(i, s):
            is_mixed = True
    if not is_mixed:
        return False
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = body_at(i, s.worlds)
        # nothing of the last step, not even times zero: a slot may be that of a world that failed
        last = MixedBody()
        last.start = s.work.increment[body]
        s.work.mixed[body] = last
        for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            held = MixedRow()
            held.start = s.rows.rows[k].force
            s.rows.mixed[k] = held
    return True


@wp.func
def inertial(
    body: int, update: wp.spatial_vector, inv_h2: float, s: wp.ref[Solver]
) -> wp.spatial_vector:
    """Of which an update's product with another one is an energy [J]."""
    return inv_h2 * wp.spatial_vector(
        s.model.mass[body] * wp.spatial_top(update),
        s.work.inertia[body] * wp.spatial_bottom(update),
    )


@wp.func
def least_mixture(
    world: int, sweep: int, before: wp.vec2, h: float, s: wp.ref[Solver]
) -> tuple[wp.vec2, wp.vec2]:
    """The t_1 and t_2 for which the mixture of the last updates is least.

    Takes what the sweep before left: the squares of its update and of how that had changed.
    Returns those of this sweep, too.
    """
    inv_h2 = 1.0 / (h * h)
    size = float(0.0)
    a_11, a_12 = float(0.0), float(0.0)
    b_1, b_2 = float(0.0), float(0.0)
    turned = float(0.0)
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = body_at(i, s.worlds)
        if s.work.inv_mass[body] == 0.0:
            continue
        last = s.work.mixed[body]
        end = s.work.increment[body]
        update = end - last.start
        change = update - last.update
        by_update = inertial(body, update, inv_h2, s)
        by_change = inertial(body, change, inv_h2, s)
        size += wp.dot(update, by_update)
        a_11 += wp.dot(change, by_change)
        a_12 += wp.dot(last.change, by_change)
        b_1 += wp.dot(update, by_change)
        b_2 += wp.dot(last.change, by_update)
        turned = wp.max(turned, wp.length_sq(wp.spatial_bottom(end - last.end)))
        for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            held = s.rows.mixed[k]
            softness = 1.0 / s.rows.rows[k].k_n
            step = s.rows.rows[k].force - held.start
            other = step - held.update
            size += softness * wp.dot(step, step)
            a_11 += softness * wp.dot(other, other)
            a_12 += softness * wp.dot(held.change, other)
            b_1 += softness * wp.dot(step, other)
            b_2 += softness * wp.dot(step, held.change)
    after = wp.vec2(size, a_11)
    is_worse = size > before[0]
    if sweep < 3 or a_11 == 0.0 or is_worse or turned > MOST_TURN * MOST_TURN:
        return wp.vec2(0.0), after
    a_11 *= 1.0 + UNCERTAIN
    a_22 = (1.0 + UNCERTAIN) * before[1]
    t_1 = b_1 / a_11
    t_2 = float(0.0)
    determinant = a_11 * a_22 - a_12 * a_12
    if sweep > 3 and determinant > 0.0:
        t_1 = (b_1 * a_22 - b_2 * a_12) / determinant
        t_2 = (b_2 * a_11 - b_1 * a_12) / determinant
    if not wp.isfinite(t_1 + t_2):
        return wp.vec2(0.0), after
    t_1 = wp.clamp(t_1, -MOST_MIXED, 0.0)
    return wp.vec2(t_1, wp.clamp(t_2, -MOST_MIXED, MOST_MIXED)), after


def make_mix(effects: Effects) -> wp.Function:
    """Device function: moves a world on from its last sweeps."""
    shift_link = make_move(effects).shift

    @wp.func
    def shift(i: int, update: wp.spatial_vector, h: float, s: wp.ref[Solver]):
        """Moves the i-th body."""
        body = body_at(i, s.worlds)
        if is_in_tree(i, s):
            shift_link(body, update, h, s)
        else:
            s.work.increment[body] = s.work.increment[body] + update
            if wp.static(effects.loops):
                place_body(body, s)

    @wp.func
    def mix(world: int, sweep: int, before: wp.vec2, h: float, s: wp.ref[Solver]) -> wp.vec2:
        """Takes how many sweeps there have been: the first has other multipliers, the second starts
        what is remembered. Takes and returns what :func:`least_mixture` does of sweeps."""
        t, after = least_mixture(world, sweep, before, h, s)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] == 0.0:
                continue
            last = s.work.mixed[body]
            end = s.work.increment[body]
            shifted = -t[0] * (end - last.end) - t[1] * last.shift
            last.shift = end - last.end
            last.end = end
            last.change = (end - last.start) - last.update
            last.update = end - last.start
            if wp.length_sq(t) > 0.0:
                shift(i, shifted, h, s)
            last.start = s.work.increment[body]
            s.work.mixed[body] = last
            for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
                held = s.rows.mixed[k]
                force = s.rows.rows[k].force
                mixed = force - t[0] * (force - held.end) - t[1] * held.shift
                held.shift = force - held.end
                held.end = force
                held.change = (force - held.start) - held.update
                held.update = force - held.start
                held.start = mixed
                s.rows.mixed[k] = held
                s.rows.rows[k].force = mixed
        return after

    return mix
