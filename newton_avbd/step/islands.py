# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Momentum of islands: bodies that may push each other, or are tied.

Forces within an island cannot change its momentum. Sweeps that stop early do: two bodies that meet
are held together by the penalty, and their common motion converges slowly. So do turns, in which
the block of a body keeps the inertia that it had at the start of the step, and recovery, which
turns a body and leaves its spin. The rigid motion of the island that brings back its momentum is
known in closed form and leaves all slips within it as they are. Where contacts with something fixed
hold the island, too, it is the minimum of the quadratic model over such motions.
"""

import warp as wp

from ..algebra.block import factor_block, solve_block
from ..algebra.so3 import exp_quat, rotation_between, turned_from, world_inertia
from ..blocks.tree import combined_with
from ..data import BodyWork, IslandSum, IslandWork, SleepWork, Solver, Step, WorldWork
from ..rows import contact as contact_rows
from ..rows import spin as spin_rows
from .bodies import body_at
from .drag import resistance
from .rotations import turn_by

FREE = wp.constant(0)
"""Of an island: nothing fixed acts on it."""
TOUCHING = wp.constant(1)
"""Contacts with something fixed do."""
HELD = wp.constant(2)
"""Joints, cables or tendons to something fixed do."""


@wp.func
def begin_island(islands: wp.ref[IslandWork], body: int):
    """Puts a body into an island of its own."""
    islands.parent[body] = body
    islands.fixed[body] = FREE


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
def join_islands(a: int, b: int, how: int, s: wp.ref[Solver]):
    """Makes one island of two bodies that push each other; b may be one that does not move, which
    acts on a as ``how`` says: TOUCHING or HELD."""
    if s.work.inv_mass[b] > 0.0:
        unite(s.islands, s.worlds, a, b)
    else:
        root = island_of(s.islands, a)
        s.islands.fixed[root] = wp.max(s.islands.fixed[root], how)


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
    return root == free or (islands.fixed[root] == FREE and islands.sum[root].bodies > 1)


@wp.func
def is_moved_island(islands: wp.ref[IslandWork], body: int, moved: int) -> bool:
    """Whether the body's island has other bodies and is given its momentum, as ``moved`` is."""
    root = island_of(islands, body)
    return root == moved or islands.sum[root].bodies > 1


@wp.func
def store_sum(islands: wp.ref[IslandWork], root: int, total: IslandSum):
    """Stores the sum of the island of a root, if that is one."""
    if root >= 0:
        islands.sum[root] = total


@wp.func
def is_alone(islands: wp.ref[IslandWork], body: int) -> bool:
    """Whether nothing pushes the body."""
    root = island_of(islands, body)
    return islands.fixed[root] == FREE and islands.sum[root].bodies == 1


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
def with_fixed(body: int, r: wp.vec3, h: float, total: IslandSum, s: wp.ref[Solver]) -> IslandSum:
    """The sum of an island with what pushes a body of it, at r from its COM, off fixed things.

    A contact that slides gives way along its friction, whatever penalty it has.
    """
    root = s.islands.parent[body]
    ll = s.islands.hold_ll[root]
    al = s.islands.hold_al[root]
    aa = total.inertia
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        row = s.rows.rows[i]
        if s.work.inv_mass[row.b] > 0.0:
            continue
        arm = r + row.arm
        push = (h * h) * row.force
        total.momentum -= push
        total.angular -= wp.cross(arm, push)
        row.k_n *= h * h
        row.k_t *= wp.where(contact_rows.slid(row), 0.0, h * h)
        ll, al, aa = contact_rows.curvature(row, arm, ll, al, aa)
        if s.rows.spin.shape[0] > 0:
            spin = s.rows.spin[i]
            total.angular -= (h * h) * spin.torque
            aa += (h * h) * spin_rows.curvature(spin, row.normal)
    s.islands.hold_ll[root] = ll
    s.islands.hold_al[root] = al
    total.inertia = aa
    return total


@wp.func
def shared_motion(root: int, total: IslandSum, islands: wp.ref[IslandWork]) -> wp.spatial_vector:
    """Rigid motion that gives an island what momentum it lacks [m, rad]."""
    if islands.fixed[root] == FREE:
        return wp.spatial_vector(
            total.momentum / total.mass, rigid_spin(total.inertia, total.angular)
        )
    ll = islands.hold_ll[root] + wp.diag(wp.vec3(total.mass))
    aa = 0.5 * (total.inertia + wp.transpose(total.inertia))
    return solve_block(factor_block(ll, islands.hold_al[root], aa), total.momentum, total.angular)


@wp.func
def keep_momentum(world: int, h: float, most_fixed: int, moves: bool, s: wp.ref[Solver]) -> bool:
    """Moves islands rigidly so that they have the momentum that what acts on them gives.

    With r from the island's COM, a free island lacks the momentum sum m (dx* - dx) and the angular
    momentum sum r x m (dx* - dx) + I (dtheta* - dtheta), both times h; one that contacts hold,
    what these push it with besides.

    Args:
        world: The world.
        h: Time step [s].
        most_fixed: Which islands: FREE, or TOUCHING, in a world that has not settled, for those,
            too, that contacts with fixed things hold.
        moves: Whether to move them. What joints alone hold together need not turn, and lacks
            momentum only where it has not settled: else its sums are all that :func:`keep_spin`
            asks for.
        s: The solver.

    Returns:
        Whether there is one.
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
            if s.islands.fixed[root] <= most_fixed:
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
        if s.work.inv_mass[body] > 0.0 and is_moved_island(s.islands, body, island):
            root = s.islands.parent[body]
            if root != island:
                store_sum(s.islands, island, total)
                total = s.islands.sum[root]
                if body == root:
                    total.com = total.com / total.mass
                    total.moved = total.moved / total.mass
                    if s.islands.fixed[root] == TOUCHING:
                        s.islands.hold_ll[root] = wp.mat33(0.0)
                        s.islands.hold_al[root] = wp.mat33(0.0)
                island = root
            missing = s.work.target[body] - s.work.increment[body]
            if not moves:
                share = s.model.mass[body] / total.mass
                total.momentum += share * wp.spatial_top(missing)
                continue
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
            if s.islands.fixed[root] == TOUCHING:
                total = with_fixed(body, r, h, total, s)
    store_sum(s.islands, island, total)
    if not moves and (most_fixed == FREE or s.work.drag.shape[0] > 0):
        return True
    island = int(-1)
    for i in range(first, last):
        body = body_at(i, s.worlds)
        if s.work.inv_mass[body] > 0.0 and is_moved_island(s.islands, body, island):
            root = s.islands.parent[body]
            if root != island:
                total = s.islands.sum[root]
                if not moves and s.islands.fixed[root] != FREE:
                    total.momentum = wp.vec3(0.0)
                elif moves and body == root:
                    motion = shared_motion(root, total, s.islands)
                    total.momentum = wp.spatial_top(motion)
                    total.angular = wp.spatial_bottom(motion)
                    s.islands.sum[root] = total
                island = root
            shift = total.momentum + wp.cross(total.angular, s.work.com[body] - total.com)
            s.work.increment[body] = s.work.increment[body] + wp.spatial_vector(
                shift, total.angular
            )
    return True


@wp.func
def turn_with_island(body: int, s: wp.ref[Solver]):
    """Turns a body that joints hold as :func:`keep_momentum` has turned its island.

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
    rotation = exp_quat(turn) * exp_quat(rest)
    rest += combined_with(rest, turn)
    # that is of first order in the turn, which is large where sweeps are cut off
    rest += combined_with(rest, rotation_between(exp_quat(rest), rotation))
    s.work.increment[body] = wp.spatial_vector(moved + shift, s.tree.turn[body] + rest)
    turn_by(body, rest, s.tree)


@wp.func
def sum_moves(world: int, s: wp.ref[Solver]):
    """How far the COM of each free island has moved [m], which goes to its ``momentum``."""
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = s.worlds.bodies[i]
        if s.work.inv_mass[body] > 0.0 and is_free_island(s.islands, body, -1):
            root = s.islands.parent[body]
            moved = wp.vec3(0.0)
            if body != root:
                moved = s.islands.sum[root].momentum
            share = s.model.mass[body] / s.islands.sum[root].mass
            moved += share * wp.spatial_top(s.work.increment[body])
            s.islands.sum[root].momentum = moved


@wp.func
def center_islands(world: int, s: wp.ref[Solver]):
    """Puts the COM of each free island to where its momentum takes it.

    Joints that are closed from the root on, and coordinates that are put back to their limits, move
    the rest of a tree and not its root.
    """
    sum_moves(world, s)
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = s.worlds.bodies[i]
        if s.work.inv_mass[body] > 0.0 and is_free_island(s.islands, body, -1):
            total = s.islands.sum[s.islands.parent[body]]
            back = wp.spatial_vector(total.moved - total.momentum, wp.vec3(0.0))
            s.work.increment[body] = s.work.increment[body] + back


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
