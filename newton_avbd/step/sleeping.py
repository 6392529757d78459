# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Sleeping: islands at rest are not solved until something disturbs them.

An island is what contacts of the buffer and joints link of bodies that move, whether the contacts
push or not: its bodies cannot act on others within the step. Each island is solved for itself, with
sweeps of its own, so that none notices whether another one sleeps. What sleeps costs a look at
its state, at its forces and at its contacts.

What disturbs is found in :mod:`.step.watching` and :mod:`.step.sleeping_contacts`, what falls
asleep or wakes is in :mod:`.step.sleepers`. Here islands are formed.
"""

import functools

import warp as wp

from ..data import History, Solver, Step, WorldWork
from ..effects import Effects
from .contacts import body_slot
from .islands import begin_island, disturb, island_of, unite
from .kernels import KERNEL, uncollected
from .sleepers import AWAKE, make_sleepers, mover_of
from .sleeping_contacts import find_changed_contacts, is_asleep, make_list_contacts, mark_of
from .slopes import QUIET_WORLD
from .watching import watch_gravity

REST_TIME = wp.constant(0.5)
"""An island sleeps once its bodies have been at rest for so long [s], as in Box2D."""


@wp.func
def measure_islands(world: int, s: wp.ref[Solver]):
    """How many bodies the islands of a world have, and for how long they have been at rest."""
    for block in range(s.sleep.block_start[world], s.sleep.block_start[world + 1]):
        i = s.sleep.blocks[block]
        end = s.worlds.block_end[i]
        mover = mover_of(i, end, s.worlds)
        root = island_of(s.sleep.islands, mover)
        if mover == root:
            s.sleep.quiet[root] = wp.inf
            s.sleep.size[root] = 0
        s.sleep.size[root] = s.sleep.size[root] + end - i
        for k in range(i, end):
            body = s.worlds.bodies[k]
            if s.worlds.island[body] == AWAKE:
                still = s.sleep.still[body]
                # what rested on something that is gone is about to fall
                if s.sleep.met[body] != s.sleep.contacts[body]:
                    still = wp.min(still, 0.0)
                s.sleep.contacts[body] = s.sleep.met[body]
                s.sleep.met[body] = 0
                s.sleep.quiet[root] = wp.min(s.sleep.quiet[root], still)


@functools.cache
@uncollected()
def make_form_islands(effects: Effects) -> wp.Kernel:
    """Kernel, one thread: wakes and puts to sleep, and lists what is awake island by island."""
    list_contacts = make_list_contacts(effects)
    sleepers = make_sleepers(effects)
    close_gaps, wake_islands = sleepers.close_gaps, sleepers.wake_islands
    put_to_sleep = sleepers.put_to_sleep

    @wp.func
    def begin_seen_island(
        world: int,
        island: int,
        root: int,
        seen: wp.ref[WorldWork],
        seen_history: wp.ref[History],
        s: wp.ref[Solver],
    ):
        """What holds for a world holds for its islands."""
        seen.pace[island] = s.worlds.pace[world]
        seen_history.parity[island] = s.history.parity[world]
        seen_history.step[island] = s.history.step[world]
        seen_history.age[island] = s.history.age[world]
        for i in range(2):
            seen_history.filling[island, i] = s.history.filling[world, i]
        if wp.static(effects.second_order):
            seen.step[island] = s.worlds.step[world]
            seen_history.slope_age[island] = s.history.slope_age[world]
            # what slept was at rest
            seen_history.smooth[island] = wp.where(
                s.sleep.quiet[root] < 0.0, QUIET_WORLD, s.history.smooth[world]
            )
        if wp.static(effects.loops):
            holder = s.sleep.loop_body[world]
            is_ahead = bool(True)
            if holder >= 0:
                if s.worlds.island[holder] == AWAKE:
                    holder_root = island_of(s.sleep.islands, holder)
                    is_ahead = s.worlds.rank[root] > s.worlds.rank[holder_root]
            s.sleep.seen_loop_start[island] = s.sleep.loop_start[world + int(is_ahead)]

    @wp.func
    def form(
        seen: wp.ref[WorldWork],
        seen_history: wp.ref[History],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Wakes what is disturbed, finds the islands of what is awake, and puts to sleep."""
        static_slot = s.sleep.tied.shape[0] - 1
        if s.sleep.filled[2] != 0:
            close_gaps(s)
        watch_gravity(s)
        sleeping = int(0)
        if wp.static(effects.contact):
            sleeping = list_contacts(step, s)
        if sleeping != s.sleep.marks[0]:
            if wp.static(effects.contact):
                find_changed_contacts(step, s)
            else:
                for k in range(s.sleep.filled[0]):
                    if s.sleep.contacts[s.sleep.order[k]] != 0:
                        disturb(s.sleep.order[k], s.worlds, s.sleep)
        if s.sleep.stirred[0] != 0:
            s.sleep.stirred[0] = 0
            wake_islands(s)
            if wp.static(effects.contact):
                sleeping = list_contacts(step, s)

        # What is linked.
        world_count = s.worlds.body_start.shape[0] - 1
        for block in range(s.sleep.block_start[world_count]):
            i = s.sleep.blocks[block]
            for k in range(i, s.worlds.block_end[i]):
                body = s.worlds.bodies[k]
                begin_island(s.sleep.islands, body)
                tied = s.sleep.tied[body]
                if s.worlds.island[tied] == AWAKE:
                    s.sleep.islands.parent[body] = tied
        if wp.static(effects.contact):
            for k in range(s.rows.awake_count[0]):
                shape0 = step.contacts.shape0[s.rows.awake[k]]
                shape1 = step.contacts.shape1[s.rows.awake[k]]
                if wp.min(shape0, shape1) < 0 or wp.max(shape0, shape1) >= s.shapes.body.shape[0]:
                    continue
                a = body_slot(s.shapes, shape0, static_slot)
                b = body_slot(s.shapes, shape1, static_slot)
                if s.worlds.island[a] == AWAKE and s.worlds.island[b] == AWAKE:
                    if s.worlds.of_body[a] == s.worlds.of_body[b]:
                        unite(s.sleep.islands, s.worlds, a, b)

        # Who sleeps now, and who is where in the list of the others.
        island = int(0)
        at = int(0)
        kept = int(0)
        before = s.sleep.filled[0]
        for world in range(world_count):
            measure_islands(world, s)
            seen.island_start[world] = island
            first_block = s.sleep.block_start[world]
            s.sleep.block_start[world] = kept
            for block in range(first_block, s.sleep.block_start[world + 1]):
                i = s.sleep.blocks[block]
                end = s.worlds.block_end[i]
                mover = mover_of(i, end, s.worlds)
                root = island_of(s.sleep.islands, mover)
                if s.sleep.quiet[root] >= REST_TIME:
                    for k in range(i, end):
                        body = s.worlds.bodies[k]
                        if s.worlds.island[body] == AWAKE:
                            put_to_sleep(body, root, step, s)
                    continue
                s.sleep.blocks[kept] = i
                kept += 1
                if mover == root:
                    begin_seen_island(world, island, root, seen, seen_history, s)
                    seen.body_start[island] = at
                    s.sleep.place[root] = at
                    at += s.sleep.size[root]
                    island += 1
                place = s.sleep.place[root]
                s.sleep.place[root] = place + end - i
                for k in range(i, end):
                    body = s.worlds.bodies[k]
                    if wp.static(effects.closures):
                        # only the first place of a block has its closures
                        s.sleep.seen_block_of[place + k - i] = s.sleep.block_of[k]
                    seen.bodies[place + k - i] = body
                    seen.rank[body] = place + k - i
                    seen.block_end[place + k - i] = place + end - i
            if wp.static(effects.loops):
                s.sleep.seen_loop_start[island] = s.sleep.loop_start[world + 1]
        s.sleep.block_start[world_count] = kept
        seen.island_start[world_count] = island
        seen.body_start[island] = at
        if wp.static(effects.contact):
            if s.sleep.filled[0] > before:
                for k in range(s.rows.awake_count[0]):
                    contact = s.rows.awake[k]
                    if is_asleep(contact, step, s):
                        sleeping += mark_of(
                            step.contacts.shape0[contact], step.contacts.shape1[contact]
                        )
        s.sleep.marks[0] = sleeping

    @wp.kernel(**KERNEL)
    def form_islands(
        seen: wp.array[WorldWork], seen_history: wp.array[History], step: Step, s: wp.array[Solver]
    ):
        form(seen[0], seen_history[0], step, s[0])

    return form_islands


@functools.cache
@uncollected()
def make_end_islands(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a world: what became of its islands is what became of the world."""

    @wp.kernel(**KERNEL)
    def end_islands(
        # Work:
        worlds: WorldWork,
        seen: WorldWork,
        # Work out:
        history: History,
        seen_history: History,
    ):
        world = wp.tid()
        first = seen.island_start[world]
        end = seen.island_start[world + 1]
        history.parity[world] = 1 - history.parity[world]
        worlds.pace[world] = 0.0
        worlds.sweeps[world] = 0
        worlds.update[world] = 0.0
        worlds.settled[world] = 0.0
        for island in range(first, end):
            worlds.sweeps[world] = wp.max(worlds.sweeps[world], seen.sweeps[island])
            worlds.update[world] = wp.max(worlds.update[world], seen.update[island])
            worlds.settled[world] = wp.max(worlds.settled[world], seen.settled[island])
            history.step[world] = seen_history.step[island]
            history.age[world] = wp.min(
                wp.where(island == first, seen_history.age[first], history.age[world]),
                seen_history.age[island],
            )
            for i in range(2):
                history.filling[world, i] = seen_history.filling[island, i]
            if wp.static(effects.second_order):
                # what kind of step the last one was, of the island that goes on least
                if island == first or seen_history.smooth[island] < history.smooth[world]:
                    worlds.step[world] = seen.step[island]
                    history.slope_age[world] = seen_history.slope_age[island]
                history.smooth[world] = wp.where(
                    island == first,
                    seen_history.smooth[first],
                    wp.min(history.smooth[world], seen_history.smooth[island]),
                )

    return end_islands
