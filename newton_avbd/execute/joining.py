# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Islands of one large world: joined by many threads at once, then each one's momentum by one.

An island here is a world of its own to :mod:`.islands`: a list of bodies, under the index of its
root. Roots are hooked to roots of lower index (Jaiganesh, Burtscher, 2018), so that the root of an
island is its first body in whatever order the threads come.
"""

import warp as wp

from ..data import BodyModel, BodyWork, ColorWork, History, IslandSum, IslandWork, WorldWork
from .coloring import sort_part
from .islands import keep_momentum, keep_spin
from .second_order import lead_spin


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
def join_at_once(
    islands: wp.ref[IslandWork], worlds: wp.ref[WorldWork], work: wp.ref[BodyWork], a: int, b: int
):
    """As :func:`.islands.join_islands`, while other threads join others."""
    if work.inv_mass[b] == 0.0:
        islands.fixed[a] = 1
        return
    one = root_of(islands, a)
    other = root_of(islands, b)
    while one != other:
        low = wp.min(one, other)
        high = wp.max(one, other)
        # a root that has been hooked meanwhile says where to
        found = wp.atomic_cas(islands.parent, high, high, low)
        one = low
        other = wp.where(found == high, low, found)


@wp.kernel(enable_backward=False)
def find_roots(
    # Work:
    worlds: WorldWork,
    work: BodyWork,
    # Work out:
    islands: IslandWork,
    colors: ColorWork,
):
    """Names the root of each body's island, marks it where one is fixed; one thread a body.

    A world that is held has no island that is to move.
    """
    body = wp.tid()
    colors.count[body] = 0
    if work.inv_mass[body] > 0.0:
        root = root_of(islands, body)
        islands.parent[body] = root
        if islands.fixed[body] == 1 or colors.is_finite[worlds.of_body[body]] == 0:
            islands.fixed[root] = 1


@wp.kernel(enable_backward=False)
def count_members(
    # Work:
    work: BodyWork,
    islands: IslandWork,
    # Work out:
    colors: ColorWork,
):
    """How many bodies each island has that pushes nothing fixed; one thread a body."""
    body = wp.tid()
    if work.inv_mass[body] > 0.0:
        root = islands.parent[body]
        if islands.fixed[root] == 0:
            wp.atomic_add(colors.count, root, 1)


@wp.kernel(enable_backward=False)
def list_members(
    # Work:
    work: BodyWork,
    islands: IslandWork,
    # Work out:
    worlds: WorldWork,
    colors: ColorWork,
):
    """Lists the bodies of these islands, in no order; one thread a body."""
    body = wp.tid()
    if work.inv_mass[body] > 0.0:
        root = islands.parent[body]
        if islands.fixed[root] == 0:
            left = wp.atomic_add(colors.count, root, -1)
            worlds.bodies[worlds.body_start[root + 1] - left] = body


@wp.kernel(enable_backward=False)
def keep_island(
    # Model:
    model: BodyModel,
    # Work:
    worlds: WorldWork,
    islands: IslandWork,
    colors: ColorWork,
    # Work out:
    work: BodyWork,
):
    """Gives an island its momentum back; one thread a body, which does it for a root."""
    root = wp.tid()
    total = IslandSum()
    total.bodies = worlds.body_start[root + 1] - worlds.body_start[root]
    islands.sum[root] = total
    if total.bodies > 1:
        sort_part(worlds.bodies, worlds.body_start[root], worlds.body_start[root + 1])
        step = colors.scale[worlds.of_body[root]].step
        keep_momentum(root, step, model, worlds, work, islands)


@wp.kernel(enable_backward=False)
def keep_island_spin(
    # Model:
    model: BodyModel,
    # State in:
    body_q: wp.array[wp.transform],
    # Work:
    worlds: WorldWork,
    work: BodyWork,
    colors: ColorWork,
    history: History,
    # Work out:
    islands: IslandWork,
    # State out:
    body_q_out: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
):
    """Gives an island its angular momentum back; one thread a body, which does it for a root."""
    root = wp.tid()
    if worlds.body_start[root + 1] - worlds.body_start[root] > 1:
        scale = colors.scale[worlds.of_body[root]]
        is_led = scale.step < scale.h
        if is_led:
            lead_spin(root, scale, body_q, model, worlds, work, islands, history)
        keep_spin(root, scale.step, is_led, body_q_out, model, worlds, work, islands, body_qd)
