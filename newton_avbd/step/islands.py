# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Momentum of islands: bodies that may push each other, or are tied, and push nothing fixed.

Forces within an island cannot change its momentum. Sweeps that stop early do: two bodies that meet
are held together by the penalty, and their common motion converges slowly. So do turns, in which
the block of a body keeps the inertia that it had at the start of the step, and recovery, which
turns a body and leaves its spin. The rigid motion of the island that brings back its momentum is
known in closed form and leaves all slips as they are.
"""

import warp as wp

from ..algebra.so3 import exp_quat, turned_from, world_inertia
from ..blocks.tree import combined_with
from ..data import BodyWork, IslandSum, IslandWork, SleepWork, Solver, Step, WorldWork
from .bodies import body_at
from .drag import resistance
from .rotations import turn_by


@wp.func
def begin_island(islands: wp.ref[IslandWork], body: int):
    """Puts a body into an island of its own."""
    islands.parent[body] = body
    islands.fixed[body] = 0


@wp.func
def island_of(islands: wp.ref[IslandWork], body: int) -> int:
    """First body of the island; shortens the way for the next call."""
    root = int(body)
    while islands.parent[root] != root:
        root = islands.parent[root]
    islands.parent[body] = root
    return root


@wp.func
def unite(islands: wp.ref[IslandWork], worlds: wp.ref[WorldWork], a: int, b: int):
    """Makes one island of those of two bodies."""
    root_a = island_of(islands, a)
    root_b = island_of(islands, b)
    is_a_first = worlds.rank[root_a] < worlds.rank[root_b]
    first = wp.where(is_a_first, root_a, root_b)
    islands.fixed[first] = wp.max(islands.fixed[root_a], islands.fixed[root_b])
    islands.parent[wp.where(is_a_first, root_b, root_a)] = first


@wp.func
def join_islands(a: int, b: int, s: wp.ref[Solver]):
    """Makes one island of two bodies that push each other; b may be one that does not move."""
    if s.work.inv_mass[b] > 0.0:
        unite(s.islands, s.worlds, a, b)
    else:
        s.islands.fixed[island_of(s.islands, a)] = 1


@wp.func
def disturb(slot: int, worlds: wp.ref[WorldWork], sleep: wp.ref[SleepWork]):
    """Wakes the island of a body, or keeps it awake."""
    sleep.still[slot] = 0.0
    island = worlds.island[slot]
    if island >= 0:
        sleep.woken[island] = 1
        sleep.stirred[0] = 1


@wp.func
def is_free_island(islands: wp.ref[IslandWork], body: int, free: int) -> bool:
    """Whether the body's island has other bodies and touches nothing fixed, as ``free`` does."""
    root = island_of(islands, body)
    return root == free or (islands.fixed[root] == 0 and islands.sum[root].bodies > 1)


@wp.func
def store_sum(islands: wp.ref[IslandWork], root: int, total: IslandSum):
    """Stores the sum of the island of a root, if that is one."""
    if root >= 0:
        islands.sum[root] = total


@wp.func
def is_alone(islands: wp.ref[IslandWork], body: int) -> bool:
    """Whether nothing pushes the body."""
    root = island_of(islands, body)
    return islands.fixed[root] == 0 and islands.sum[root].bodies == 1


@wp.func
def rigid_spin(inertia: wp.mat33, angular: wp.vec3) -> wp.vec3:
    """Angular velocity of what has this inertia and this angular momentum [rad/s]."""
    # scaled: the determinant of a small inertia would underflow
    size = wp.trace(inertia)
    return wp.inverse(inertia / size) * (angular / size)


@wp.func
def point_inertia(mass: float, r: wp.vec3) -> wp.mat33:
    """Inertia of a point mass at r [kg m^2]."""
    return mass * (wp.diag(wp.vec3(wp.dot(r, r))) - wp.outer(r, r))


@wp.func
def keep_momentum(world: int, h: float, moves: bool, s: wp.ref[Solver]) -> bool:
    """Moves each free island rigidly so that it has the momentum of its inertial targets.

    With r from the island's COM, the missing momentum is sum m (dx* - dx) and the missing angular
    momentum sum r x m (dx* - dx) + I (dtheta* - dtheta), both times h. Returns whether there is
    a free island. One that no contact holds need not move (not ``moves``): its sums are all that
    :func:`keep_spin` asks for.
    """
    first = s.worlds.body_start[world]
    last = s.worlds.body_start[world + 1]
    largest = int(0)
    # Bodies of an island follow each other for the most part: its sum is stored where they end.
    island = int(-1)
    total = IslandSum()
    for i in range(first, last):
        body = body_at(i, s.worlds)
        if s.work.inv_mass[body] > 0.0:
            root = island_of(s.islands, body)
            if s.islands.fixed[root] == 0:
                if root != island:
                    store_sum(s.islands, island, total)
                    # the root comes first, since it is visited first
                    total = IslandSum()
                    if body != root:
                        total = s.islands.sum[root]
                    island = root
                total.bodies += 1
                total.mass += s.model.mass[body]
                total.com += s.model.mass[body] * s.work.com[body]
                total.moved += s.model.mass[body] * wp.spatial_top(s.work.target[body])
                largest = wp.max(largest, total.bodies)
    store_sum(s.islands, island, total)
    if largest < 2:
        return False
    island = int(-1)
    for i in range(first, last):
        body = body_at(i, s.worlds)
        if s.work.inv_mass[body] > 0.0 and is_free_island(s.islands, body, island):
            root = s.islands.parent[body]
            if root != island:
                store_sum(s.islands, island, total)
                total = s.islands.sum[root]
                if body == root:
                    total.com = total.com / total.mass
                    total.moved = total.moved / total.mass
                island = root
            if not moves:
                continue
            missing = s.work.target[body] - s.work.increment[body]
            momentum = s.model.mass[body] * wp.spatial_top(missing)
            spin = s.work.inertia[body] * wp.spatial_bottom(missing)
            r = s.work.com[body] - total.com
            total.inertia += s.work.inertia[body] + point_inertia(s.model.mass[body], r)
            # what turns fast resists tilting with its momentum: by L x -dtheta
            fast = h * s.work.spin_momentum[body]
            spin += wp.cross(wp.spatial_bottom(missing), fast)
            total.inertia -= wp.skew(fast)
            if s.work.drag.shape[0] > 0:
                drag = s.work.drag[body]
                taken = h * resistance(drag, missing)
                momentum += wp.spatial_top(taken)
                spin += wp.spatial_bottom(taken)
                # bounds: the correction may lack what a dense fluid couples, and never goes beyond
                across = 4.0 * h * wp.trace(drag.ll)
                about = 2.0 * h * wp.trace(drag.aa) + across * wp.dot(r, r)
                total.mass += across
                total.inertia += wp.diag(wp.vec3(about))
            total.momentum += momentum
            total.angular += wp.cross(r, momentum)
            total.angular += spin
    store_sum(s.islands, island, total)
    if not moves:
        return True
    island = int(-1)
    for i in range(first, last):
        body = body_at(i, s.worlds)
        if s.work.inv_mass[body] > 0.0 and is_free_island(s.islands, body, island):
            root = s.islands.parent[body]
            if root != island:
                total = s.islands.sum[root]
                if body == root:
                    total.momentum = total.momentum / total.mass
                    total.angular = rigid_spin(total.inertia, total.angular)
                    s.islands.sum[root] = total
                island = root
            shift = total.momentum + wp.cross(total.angular, s.work.com[body] - total.com)
            s.work.increment[body] = s.work.increment[body] + wp.spatial_vector(
                shift, total.angular
            )
    return True


@wp.func
def turn_with_island(body: int, s: wp.ref[Solver]):
    """Turns a body that joints hold as :func:`keep_momentum` has turned its free island.

    That turn is rigid to first order, and joints would open by its product with how far the step
    has moved and turned the body. So the body goes to where a rigid turn of the island about its
    COM at the end of the step takes it. Velocities have been read off before.
    """
    total = s.islands.sum[s.islands.parent[body]]
    turn = total.angular
    r = s.work.com[body] - total.com
    moved = wp.spatial_top(s.work.increment[body])
    linear = wp.cross(turn, r)
    end = r + moved - linear - total.moved
    shift = -turned_from(exp_quat(-turn), end) - linear
    rest = wp.spatial_bottom(s.work.increment[body]) - turn - s.tree.turn[body]
    rest += combined_with(rest, turn)
    s.work.increment[body] = wp.spatial_vector(moved + shift, s.tree.turn[body] + rest)
    turn_by(body, rest, s.tree)


@wp.func
def end_arm(body: int, is_led: bool, total: IslandSum, work: wp.ref[BodyWork]) -> wp.vec3:
    """From the COM of an island to that of a body [m], at the start or at the end of the step."""
    r = work.com[body] - total.com
    if is_led:
        r += wp.spatial_top(work.increment[body]) - total.momentum
    return r


@wp.func
def keep_spin(world: int, h: float, is_led: bool, step: wp.ref[Step], s: wp.ref[Solver]):
    """Turns the velocities of each free island so that it has its angular momentum.

    Of what forces within the island leave as it is, sum r x m v + I w with r at the start and I at
    the end of the step lacks sum r x m (v* - v) + L - I w, where L is the momentum of a body that
    nothing pushes.

    Args:
        world: The world.
        h: Time step [s].
        is_led: Whether it is of second order: arms are then those of the end, see
            :func:`.second_order.lead_spin`.
        step: Its poses, and velocities that are turned.
        s: The solver, whose islands are as :func:`keep_momentum` has summed them.
    """
    first = s.worlds.body_start[world]
    last = s.worlds.body_start[world + 1]
    island = int(-1)
    total = IslandSum()
    for i in range(first, last):
        body = body_at(i, s.worlds)
        if s.work.inv_mass[body] > 0.0 and is_free_island(s.islands, body, island):
            root = s.islands.parent[body]
            if root != island:
                store_sum(s.islands, island, total)
                total = s.islands.sum[root]
                if body == root:
                    total.angular = wp.vec3(0.0)
                    total.inertia = wp.mat33(0.0)
                island = root
            free = s.work.target[body]
            if is_led:
                free = s.work.coasting[body]
            elif s.work.lead.shape[0] > 0:
                free -= s.work.lead[body]
            inertia = world_inertia(
                wp.transform_get_rotation(step.body_q_out[body]), s.model.inertia[body]
            )
            missing = wp.spatial_top(free) / h - wp.spatial_top(step.body_qd_out[body])
            r = end_arm(body, is_led, total, s.work)
            total.angular += s.model.mass[body] * wp.cross(r, missing)
            total.angular += s.work.momentum[body] - inertia * wp.spatial_bottom(
                step.body_qd_out[body]
            )
            total.inertia += inertia + point_inertia(s.model.mass[body], r)
    store_sum(s.islands, island, total)
    island = int(-1)
    for i in range(first, last):
        body = body_at(i, s.worlds)
        if s.work.inv_mass[body] > 0.0 and is_free_island(s.islands, body, island):
            root = s.islands.parent[body]
            if root != island:
                total = s.islands.sum[root]
                if body == root:
                    total.angular = rigid_spin(total.inertia, total.angular)
                    s.islands.sum[root].angular = total.angular
                island = root
            r = end_arm(body, is_led, total, s.work)
            spin = wp.spatial_vector(wp.cross(total.angular, r), total.angular)
            step.body_qd_out[body] = step.body_qd_out[body] + spin
