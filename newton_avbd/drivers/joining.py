# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Islands of one large world: joined by many threads at once, then each one's momentum by one.

An island here is a world of its own to :mod:`.step.islands`: a list of bodies, under the index of
its root. Roots are hooked to roots of lower index (Jaiganesh, Burtscher, 2018), so that the root of
an island is its first body in whatever order the threads come.
"""

import warp as wp

from ..data import IslandSum, IslandWork, Solver, Step
from ..step.islands import (
    FREE,
    HELD,
    TOUCHING,
    center_islands,
    keep_momentum,
    keep_spin,
)
from ..step.second_order import lead_spin
from .colored_sweeps import count_sweeps, is_settled, last_moved
from .coloring import sort_part


@wp.func
def root_of(islands: wp.ref[IslandWork], body: int) -> int:
    """First body of the island as far as it is joined; halves the way for the next call."""
    root = int(body)
    while islands.parent[root] != root:
        above = islands.parent[islands.parent[root]]
        islands.parent[root] = above
        root = above
    return root


@wp.func
def join_at_once(a: int, b: int, how: int, s: wp.ref[Solver]):
    """As :func:`.step.islands.join_islands`, while other threads join others."""
    if s.work.inv_mass[b] == 0.0:
        wp.atomic_max(s.islands.fixed, a, how)
        return
    one = root_of(s.islands, a)
    other = root_of(s.islands, b)
    while one != other:
        low = wp.min(one, other)
        high = wp.max(one, other)
        # a root that has been hooked meanwhile says where to
        found = wp.atomic_cas(s.islands.parent, high, high, low)
        one = low
        other = wp.where(found == high, low, found)


@wp.kernel(enable_backward=False)
def find_roots(s: wp.array[Solver]):
    """Names the root of each body's island, and marks it with what fixed things act on its bodies;
    one thread a body.

    A world that is held has no island that is to move, one that has settled none that touches fixed
    things.
    """
    body = wp.tid()
    s[0].colors.count[body] = 0
    if s[0].work.inv_mass[body] > 0.0:
        root = root_of(s[0].islands, body)
        s[0].islands.parent[body] = root
        world = s[0].worlds.of_body[body]
        how = s[0].islands.fixed[body]
        if s[0].colors.is_finite[world] == 0:
            how = HELD
        elif how == TOUCHING:
            if is_settled(last_moved(world, s[0].colors.moved), s[0].colors.scale[world]):
                how = HELD
        wp.atomic_max(s[0].islands.fixed, root, how)


@wp.kernel(enable_backward=False)
def count_members(s: wp.array[Solver]):
    """How many bodies each island has that may move; one thread a body."""
    body = wp.tid()
    if s[0].work.inv_mass[body] > 0.0:
        root = s[0].islands.parent[body]
        if s[0].islands.fixed[root] != HELD:
            wp.atomic_add(s[0].colors.count, root, 1)


@wp.kernel(enable_backward=False)
def list_members(s: wp.array[Solver]):
    """Lists the bodies of these islands, in no order; one thread a body."""
    body = wp.tid()
    if s[0].work.inv_mass[body] > 0.0:
        root = s[0].islands.parent[body]
        if s[0].islands.fixed[root] != HELD:
            left = wp.atomic_add(s[0].colors.count, root, -1)
            s[0].worlds.bodies[s[0].worlds.body_start[root + 1] - left] = body


@wp.kernel(enable_backward=False)
def keep_island(moves: bool, s: wp.array[Solver]):
    """Gives an island its momentum back; one thread a body, which does it for a root."""
    root = wp.tid()
    total = IslandSum()
    total.bodies = s[0].worlds.body_start[root + 1] - s[0].worlds.body_start[root]
    s[0].islands.sum[root] = total
    if total.bodies > 1:
        sort_part(
            s[0].worlds.bodies, s[0].worlds.body_start[root], s[0].worlds.body_start[root + 1]
        )
        world = s[0].worlds.of_body[root]
        scale = s[0].colors.scale[world]
        has_settled = is_settled(last_moved(world, s[0].colors.moved), scale)
        most_fixed = wp.where(has_settled, FREE, TOUCHING)
        keep_momentum(root, scale.step, most_fixed, moves, s[0])


@wp.kernel(enable_backward=False)
def center_island(iterations: int, s: wp.array[Solver]):
    """Puts the COM of an island back where sweeps were cut off; one thread a body, for a root."""
    root = wp.tid()
    if s[0].worlds.body_start[root + 1] - s[0].worlds.body_start[root] > 1:
        if count_sweeps(s[0].worlds.of_body[root], s[0].colors.moved) >= iterations:
            center_islands(root, s[0])


@wp.kernel(enable_backward=False)
def keep_island_spin(step: Step, s: wp.array[Solver]):
    """Gives an island its angular momentum back; one thread a body, which does it for a root."""
    root = wp.tid()
    if s[0].worlds.body_start[root + 1] - s[0].worlds.body_start[root] > 1:
        scale = s[0].colors.scale[s[0].worlds.of_body[root]]
        is_led = scale.step < scale.h
        if is_led:
            lead_spin(root, scale, s[0])
        keep_spin(root, scale.step, is_led, step, s[0])
