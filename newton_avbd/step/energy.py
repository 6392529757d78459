# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Energy of steps that do not settle: an island ends with no more than it had and was given.

The kinetic energy of an island after a step, rotors included, is at most that before it and the
work of gravity, external forces, ``joint_f``, drives, springs and compliant contacts over the way
that the step has moved its bodies. What dissipates is not counted. Where sweeps that have not
settled leave more, velocities are scaled towards the rigid motion of the island, which has its
linear and angular momentum and the least energy for them. Where that is still too much, and
contacts with something fixed take up momentum, the rigid motion is scaled, too. A joint to
something fixed allows no rigid motion: velocities of such an island are scaled towards rest.

Contacts with kinematic bodies and moving surfaces do work that counts. What joints and tendons to
kinematic bodies do is not known: islands that have such are left alone.

What a body adds to the sums is in :mod:`.step.body_energy`, what becomes of its velocity in
:mod:`.step.slowing`.
"""

import warp as wp

from ..data import Balance, IslandWork, Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows.contact import is_pushing
from ..rows.euler import make_euler
from ..rows.joint import make_counts
from .anchors import is_linked, parent_slot
from .balance import add_cables, add_momentum, add_tendons
from .bodies import has_rows, moved_by
from .body_energy import make_add_body
from .cables import make_join
from .closures import make_join_closures
from .contacts import braces_tree
from .islands import HELD, begin_island, island_of, join_islands
from .rotations import MOST_TURN
from .slowing import drop_tensions, make_slowing

NEARLY = wp.constant(1.0e-5)
"""Last update of a world, as a share of the farthest move in the step, up to which it has settled
as far as energy is concerned: it is off by about twice the share."""
FLAT = wp.constant(6)
"""Sweeps from which on a closed tree that nothing touches counts as flat: away from there it takes
one to four. It may fold either way, and settles at more energy: a parallelogram 3 % in a step.
Contacts take as many; with them the sweeps must have been cut off besides."""
ASTRAY = wp.constant(10)
"""Sweeps from which on what joints link, and nothing touches, counts as having gone astray: far
turns against limits may settle at more energy. A humanoid at 30 rad/s and 60 Hz gained a tenth in a
step. Contacts take as many, and what rolls on another body would be bounded for nothing; unless
they throw a link about, as ground that the humanoid hit at 200 m/s: it gained 1.5 %."""


@wp.func
def keep_start(world: int, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]):
    """Keeps poses and velocities at the start of a step that may write to the same arrays."""
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = s.worlds.bodies[i]
        s.islands.start_q[body] = s.work.pose[body]
        s.islands.start_qd[body] = body_qd[body]


def make_gains(effects: Effects) -> Functions:
    """Device functions: which worlds may gain energy in a step that has settled."""
    is_gimbal = make_counts(effects.kinds).is_gimbal
    euler = make_euler(effects.kinds)
    is_led, known_angles = euler.is_led, euler.known_angles

    @wp.func
    def is_body_led(body: int, s: wp.ref[Solver]) -> bool:
        """Whether the angles of the body's gimbal lead its pose where the step starts or ends.

        What acts on the angles then has long levers, whose changes within the step put energy in
        also where the sweeps have settled.
        """
        if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
            joint = s.tree.joint[body]
            first = s.tree.axis_start[body]
            if is_gimbal(s.joints, joint):
                start = known_angles(s.joints, joint, s.tree.start_coordinate, first)
                end = known_angles(s.joints, joint, s.tree.coordinate, first)
                return is_led(s.joints, joint, start) or is_led(s.joints, joint, end)
        return False

    @wp.func
    def is_braced(body: int, s: wp.ref[Solver]) -> bool:
        """Whether a contact of the body pushes another link of its tree, and one of them turns.

        Where joints all but forbid the two to part, any force is as good as any other, and what is
        linear in the turn lets a large one do work.
        """
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            row = s.rows.rows[i]
            if is_pushing(row) and braces_tree(row, s):
                return True
        return False

    @wp.func
    def bounces(body: int, s: wp.ref[Solver]) -> bool:
        """Whether a body bounces off another one: how fast they separate is then given, whatever
        friction and joints make of what it takes to get there."""
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            if s.rows.impacts[i].total > 0.0:
                return True
        return False

    @wp.func
    def may_body_gain(body: int, s: wp.ref[Solver]) -> bool:
        """Whether a body may gain energy in a step that has settled."""
        if wp.static(effects.restitution):
            if bounces(body, s):
                return True
        if wp.static(effects.bracing):
            if is_braced(body, s):
                return True
        if wp.static(effects.kinds.gimbals):
            return is_body_led(body, s)
        else:
            return False

    @wp.func
    def is_touched(world: int, s: wp.ref[Solver]) -> bool:
        """Whether anything touches a body of a world."""
        if wp.static(effects.contact):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                if has_rows(s.rows, s.worlds.bodies[i]):
                    return True
        return False

    @wp.func
    def is_thrown(world: int, s: wp.ref[Solver]) -> bool:
        """Whether a body that a joint holds has turned so far that what is linear in its turn says
        nothing."""
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = s.worlds.bodies[i]
            turn = wp.spatial_bottom(s.work.increment[body])
            if is_linked(body, s) and wp.length_sq(turn) > MOST_TURN * MOST_TURN:
                return True
        return False

    @wp.func
    def is_astray(world: int, s: wp.ref[Solver]) -> bool:
        """Whether sweeps may have led to where there is more energy: many of them, or those of
        closed trees, which may fold either way."""
        sweeps = s.worlds.sweeps[world]
        if sweeps >= ASTRAY:
            if not is_touched(world, s) or is_thrown(world, s):
                return True
        if wp.static(not effects.folding) or sweeps < FLAT:
            return False
        return wp.static(not effects.contact) or s.worlds.update[world] > s.worlds.settled[world]

    @wp.func
    def gains_settled(world: int, s: wp.ref[Solver]) -> bool:
        """Whether a world may gain energy in a step that has settled: where a gimbal's angles lead,
        links of a tree push each other as they turn, or sweeps went astray."""
        if wp.static(effects.joints):
            if is_astray(world, s):
                return True
        if wp.static(effects.gaining):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                if may_body_gain(s.worlds.bodies[i], s):
                    return True
        return False

    return together(may_body_gain, is_astray, gains_settled)


def make_join_bodies(effects: Effects, join: wp.Function) -> Functions:
    """Device functions that make islands, where contacts have not called for them.

    Args:
        effects: Effects of the scene.
        join: Makes one island of two bodies.
    """

    @wp.func
    def begin_balance(body: int, islands: wp.ref[IslandWork]):
        """Nothing is summed for a body yet; nor does anything push it where that is not known."""
        islands.balance[body] = Balance()
        if wp.static(not effects.islands):
            begin_island(islands, body)

    @wp.func
    def join_joints(body: int, static_slot: int, s: wp.ref[Solver]):
        """Makes one island of bodies that joints link, where contacts have not called for it."""
        if wp.static(effects.joints):
            if is_linked(body, s):
                join(body, s.tree.parent[body], HELD, s)
        if wp.static(effects.loops):
            for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                joint = s.loops.joints[s.loops.items[k] / 2]
                if s.loops.items[k] % 2 == 0 and s.joints.enabled[joint]:
                    parent = parent_slot(s.joints, joint, static_slot)
                    join(body, parent, HELD, s)

    join_closures = make_join_closures(effects, join)
    return together(
        begin_balance, join_joints, join_closures=join_closures, join_cluster=make_join(join)
    )


def make_energy(effects: Effects, join: wp.Function = join_islands) -> Functions:
    """Device functions that bound the energy of islands.

    Args:
        effects: Effects of the scene.
        join: Makes one island of two bodies.
    """
    gains = make_gains(effects)
    gains_settled = gains.gains_settled
    islands = make_join_bodies(effects, join)
    begin_balance, join_joints = islands.begin_balance, islands.join_joints
    join_closures, join_cluster = islands.join_closures, islands.join_cluster
    add_body = make_add_body(effects)
    slowing = make_slowing(effects)
    settle_island, slow_body = slowing.settle_island, slowing.slow_body
    slow_rotors = slowing.slow_rotors

    @wp.func
    def bound_energy(
        first: int, end: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]
    ):
        """Slows the islands of a list of bodies down to the energy that they may have.

        Takes poses and velocities after the step. All bodies of an island are in the list, its
        root first.
        """
        for i in range(first, end):
            body = s.worlds.bodies[i]
            if s.work.inv_mass[body] > 0.0:
                root = island_of(s.islands, body)
                sum = add_body(
                    root,
                    body,
                    scale.h,
                    scale.reach,
                    scale.static_slot,
                    s.islands.balance[root],
                    step,
                    s,
                )
                s.islands.balance[root] = sum
                if wp.static(effects.tendons):
                    add_tendons(s.worlds.rank[body], root, s)
        for i in range(first, end):
            body = s.worlds.bodies[i]
            if s.work.inv_mass[body] > 0.0:
                root = s.islands.parent[body]
                sum = s.islands.balance[root]
                s.islands.balance[root] = add_momentum(body, root, sum, sum, step, s)
        for i in range(first, end):
            body = s.worlds.bodies[i]
            if s.work.inv_mass[body] > 0.0 and s.islands.parent[body] == body:
                settle_island(body, scale.h, s)
        for i in range(first, end):
            body = s.worlds.bodies[i]
            if s.work.inv_mass[body] > 0.0:
                slow_body(body, scale.h, step, s)
        if wp.static(effects.axis_rates):
            for i in range(first, end):
                body = s.worlds.bodies[i]
                if s.work.inv_mass[body] > 0.0:
                    slow_rotors(body, step, s)

    @wp.func
    def bound_world(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]):
        """As :func:`bound_energy`, of all islands of a world."""
        first = s.worlds.body_start[world]
        end = s.worlds.body_start[world + 1]
        farthest = float(0.0)
        for i in range(first, end):
            body = s.worlds.bodies[i]
            farthest = wp.max(farthest, moved_by(body, s.work.increment[body], s.work))
        if s.worlds.update[world] <= NEARLY * wp.sqrt(farthest):
            if not gains_settled(world, s):
                return
        for i in range(first, end):
            if s.work.inv_mass[s.worlds.bodies[i]] > 0.0:
                begin_balance(s.worlds.bodies[i], s.islands)
        if wp.static(not effects.islands):
            for i in range(first, end):
                body = s.worlds.bodies[i]
                if s.work.inv_mass[body] > 0.0:
                    join_joints(body, scale.static_slot, s)
            if wp.static(effects.tendons or effects.mimics):
                for i in range(first, end):
                    join_closures(i, s)
            if wp.static(effects.cables):
                for i in range(
                    s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]
                ):
                    join_cluster(i, s)
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                add_cables(i, s)
        bound_energy(first, end, scale, step, s)
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                drop_tensions(i, s)

    return together(bound_world, gains, islands, slowing, add_body=add_body)
