# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Anderson mixing: where links push what moves, sweeps go on from more than the last one.

A robot and the box in its gripper are solved in turns, each as if the other stood still, and so are
two links of a robot that press on each other. What both share, such as the lift of the box, then
needs the more sweeps the stiffer contacts are. But a sweep is a
map z -> F(z) of the increments of all bodies and of the multipliers of all contacts, and one that
converges slowly does so along few directions, which its last updates d = F(z) - z tell. So the next
sweep starts from

    F_k - t_1 (F_k - F_k-1) - t_2 (F_k-1 - F_k-2)

with those t for which the same mixture of updates, d_k - t_1 (d_k - d_k-1) - t_2 (d_k-1 - d_k-2),
is least. Updates count by their energy: m |dx|^2 / h^2, and |df|^2 / k of multipliers. See Anderson
(1965), Walker and Ni (2011), and Zhang, Peng, Ouyang and Deng (2019) for methods of multipliers. A
step ends with a sweep, so that what mixing cannot know, closed joints and cones of friction, holds.
"""

import warp as wp

from ..data import Solver
from ..effects import Effects
from .beginning import is_in_tree
from .bodies import body_at
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
    """Notes from where the next sweep starts, if a link may push what moves; returns whether."""
    is_mixed = bool(False)
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = body_at(i, s.worlds)
        for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            b = s.rows.rows[k].b
            if s.work.inv_mass[b] > 0.0:
                if is_in_tree(i, s) or is_in_tree(s.worlds.rank[b], s):
                    is_mixed = True
    if not is_mixed:
        return False
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = body_at(i, s.worlds)
        s.work.mixed[body].start = s.work.increment[body]
        for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            s.rows.mixed[k].start = s.rows.rows[k].force
    return True


@wp.func
def along(
    body: int, a: wp.spatial_vector, b: wp.spatial_vector, inv_h2: float, s: wp.ref[Solver]
) -> float:
    """Product of two updates of a body [J]."""
    shifts = s.model.mass[body] * wp.dot(wp.spatial_top(a), wp.spatial_top(b))
    turns = wp.dot(wp.spatial_bottom(a), s.work.inertia[body] * wp.spatial_bottom(b))
    return inv_h2 * (shifts + turns)


@wp.func
def least_mixture(world: int, sweep: int, h: float, s: wp.ref[Solver]) -> wp.vec2:
    """The t_1 and t_2 for which the mixture of the last updates is least."""
    inv_h2 = 1.0 / (h * h)
    a_11, a_12, a_22 = float(0.0), float(0.0), float(0.0)
    b_1, b_2 = float(0.0), float(0.0)
    turned = float(0.0)
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = body_at(i, s.worlds)
        if s.work.inv_mass[body] == 0.0:
            continue
        last = s.work.mixed[body]
        update = s.work.increment[body] - last.start
        change = update - last.update
        a_11 += along(body, change, change, inv_h2, s)
        a_12 += along(body, change, last.change, inv_h2, s)
        a_22 += along(body, last.change, last.change, inv_h2, s)
        b_1 += along(body, update, change, inv_h2, s)
        b_2 += along(body, update, last.change, inv_h2, s)
        turn = wp.spatial_bottom(s.work.increment[body] - last.end)
        turned = wp.max(turned, wp.length_sq(turn))
        for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            held = s.rows.mixed[k]
            row = s.rows.rows[k]
            force = row.force - held.start
            other = force - held.update
            a_11 += wp.dot(other, other) / row.k_n
            a_12 += wp.dot(other, held.change) / row.k_n
            a_22 += wp.dot(held.change, held.change) / row.k_n
            b_1 += wp.dot(force, other) / row.k_n
            b_2 += wp.dot(force, held.change) / row.k_n
    if sweep < 3 or a_11 == 0.0 or turned > MOST_TURN * MOST_TURN:
        return wp.vec2(0.0)
    a_11 *= 1.0 + UNCERTAIN
    a_22 *= 1.0 + UNCERTAIN
    t_1 = b_1 / a_11
    t_2 = float(0.0)
    determinant = a_11 * a_22 - a_12 * a_12
    if sweep > 3 and determinant > 0.0:
        t_1 = (b_1 * a_22 - b_2 * a_12) / determinant
        t_2 = (b_2 * a_11 - b_1 * a_12) / determinant
    return wp.vec2(wp.clamp(t_1, -MOST_MIXED, 0.0), wp.clamp(t_2, -MOST_MIXED, MOST_MIXED))


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
    def mix(world: int, sweep: int, h: float, s: wp.ref[Solver]):
        """Takes how many sweeps there have been: the first has other multipliers, the second starts
        what is remembered."""
        t = least_mixture(world, sweep, h, s)
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

    return mix
