# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Sleeping: islands at rest are not solved until something disturbs them.

An island is what contacts of the buffer and joints link of bodies that move, whether the contacts
push or not: its bodies cannot act on others within the step. Each island is solved for itself, with
sweeps of its own, so that none notices whether another one sleeps. What sleeps costs a look at
its state, at its forces and at its contacts.
"""

import functools

import warp as wp

from ..blocks.body import is_mobile
from ..data import (
    ContactInput,
    ContactRecord,
    ControlInput,
    History,
    JointModel,
    RowWork,
    SleepWork,
    Solver,
    Step,
    TendonModel,
    WorldWork,
)
from ..effects import Effects
from .bodies import make_wrench, unit_pose
from .body_actuators import asked_of
from .contacts import FAR, anchor_distance, body_arm, body_slot, point_on
from .islands import begin_island, disturb, island_of, unite
from .kernels import KERNEL, uncollected
from .slopes import QUIET_WORLD

REST = wp.constant(1.0e-3)
"""Speed up to which a body is at rest, as a share of what gravity gives it in a step: of
accelerations a thousandth of gravity shows, and in free space only what stands still is at rest."""
REST_TIME = wp.constant(0.5)
"""An island sleeps once its bodies have been at rest for so long [s], as in Box2D."""
JUMP = wp.constant(1.0e-3)
"""A pose that changed by more than this, as a share of the radius of gyration or as an angle [rad],
was changed by the user."""

AWAKE = wp.constant(-1)
"""Island of a body that is awake."""
STILL = wp.constant(-2)
"""That of one which the solver does not move, nor does the user."""
MOVING = wp.constant(-3)
"""That of one which the user moves."""
STANDSTILL = wp.constant(wp.spatial_vector(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


@functools.cache
@uncollected()
def make_watch_bodies(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a body: passes on what sleeps or is not moved, and sees what disturbs."""
    external_wrench = make_wrench(effects)

    @wp.func
    def watch_body(body: int, wrench: wp.spatial_vector, step: wp.ref[Step], s: wp.ref[Solver]):
        """Sees how a body moves that does not go on sleeping."""
        pose = step.body_q[body]
        velocity = step.body_qd[body]
        before = s.sleep.pose[body]
        island = s.worlds.island[body]
        is_pushed = not wrench == s.sleep.wrench[body]
        s.sleep.pose[body] = pose
        s.sleep.wrench[body] = wrench
        if island >= 0:
            disturb(body, s.worlds, s.sleep)
        if not is_mobile(s.model, body):
            if island >= AWAKE:
                s.sleep.stirred[0] = 1
            is_fixed = pose == before and velocity == STANDSTILL
            s.worlds.island[body] = wp.where(is_fixed, STILL, MOVING)
            move = step.h * wp.length(wp.spatial_top(velocity))
            wp.atomic_max(s.worlds.pace, s.worlds.of_body[body], move)
            step.body_q_out[body] = unit_pose(pose, body, s.worlds)
            step.body_qd_out[body] = velocity
            return
        if island < AWAKE:
            s.worlds.island[body] = AWAKE
            s.sleep.stirred[0] = 1
        size_sq = wp.trace(s.model.inertia[body]) * s.model.inv_mass[body]
        shift = wp.transform_get_translation(pose) - wp.transform_get_translation(before)
        turn = wp.transform_get_rotation(pose) - wp.transform_get_rotation(before)
        v = wp.spatial_top(velocity)
        w = wp.spatial_bottom(velocity)
        rest = REST * step.h * wp.length(s.model.gravity[s.model.world[body]])
        # comparisons that numbers which are not finite fail
        is_slow = wp.dot(v, v) + size_sq * wp.dot(w, w) <= rest * rest
        is_here = (
            wp.dot(shift, shift) <= JUMP * JUMP * size_sq and wp.dot(turn, turn) <= JUMP * JUMP
        )
        is_at_rest = is_slow and is_here and not is_pushed and island == AWAKE
        s.sleep.still[body] = wp.where(is_at_rest, wp.max(s.sleep.still[body], 0.0) + step.h, 0.0)

    @wp.func(inline=True)  # a call would copy all that it takes, for each body that sleeps
    def watch(body: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """Passes on a body that goes on sleeping, and looks at any other."""
        wrench = external_wrench(s.model, body, step.body_f, step.control)
        if wp.static(effects.servos):
            wrench[0] += asked_of(body, s.model)
        if s.worlds.island[body] >= 0:
            pose = step.body_q[body]
            velocity = step.body_qd[body]
            if pose == s.sleep.pose[body] and velocity == STANDSTILL:
                if wrench == s.sleep.wrench[body]:
                    step.body_q_out[body] = pose
                    step.body_qd_out[body] = velocity
                    return
        watch_body(body, wrench, step, s)

    @wp.kernel(**KERNEL)
    def watch_bodies(step: Step, s: wp.array[Solver]):
        watch(wp.tid(), step, s[0])

    return watch_bodies


@wp.kernel(**KERNEL)
def watch_joints(
    # Model:
    joints: JointModel,
    control: ControlInput,
    # Work:
    worlds: WorldWork,
    sleep: SleepWork,
):
    """Sees what is driven otherwise than in the last step, or by the user; one thread a joint."""
    joint = wp.tid()
    is_changed = bool(False)
    for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
        push = control.joint_f[dof]
        if control.pushes.shape[0] > 0:
            push += control.pushes[dof].force + control.pushes[dof].drive
        if push != sleep.joint_f[dof]:
            sleep.joint_f[dof] = push
            is_changed = True
        if control.target_qd[dof] != sleep.target_qd[dof]:
            sleep.target_qd[dof] = control.target_qd[dof]
            is_changed = True
    for i in range(joints.coord_start[joint], joints.coord_start[joint + 1]):
        if control.target_q[i] != sleep.target_q[i]:
            sleep.target_q[i] = control.target_q[i]
            is_changed = True
    static_slot = sleep.tied.shape[0] - 1
    child = joints.child[joint]
    parent = joints.parent[joint]
    parent = wp.where(parent < 0, static_slot, parent)
    if worlds.island[child] == MOVING or worlds.island[parent] == MOVING:
        is_changed = True
    if is_changed:
        disturb(child, worlds, sleep)
        disturb(parent, worlds, sleep)


@wp.kernel(**KERNEL)
def watch_tendons(
    # Model:
    tendons: TendonModel,
    # Work:
    worlds: WorldWork,
    sleep: SleepWork,
):
    """Sees what is pulled otherwise than in the last step, or by the user; one thread a tendon."""
    i = wp.tid()
    push = tendons.push[i].force + tendons.push[i].drive
    is_changed = push != sleep.pull[i]
    sleep.pull[i] = push
    for k in range(tendons.start[i], tendons.start[i + 1]):
        body = tendons.body[k]
        if body >= 0:
            is_changed = is_changed or worlds.island[body] == MOVING
    if is_changed:
        for k in range(tendons.start[i], tendons.start[i + 1]):
            if tendons.body[k] >= 0:
                disturb(tendons.body[k], worlds, sleep)


@wp.func
def mover_of(first: int, end: int, worlds: wp.ref[WorldWork]) -> int:
    """The first body of a block that the solver moves, -1 without."""
    for i in range(first, end):
        if worlds.island[worlds.bodies[i]] >= AWAKE:
            return worlds.bodies[i]
    return -1


@wp.func
def mark_of(shape0: int, shape1: int) -> int:
    """A number by which to tell contacts of two shapes from those of others."""
    mixed = (shape0 + 1) * 73856093 ^ (shape1 + 1) * 19349663
    return mixed * mixed


@wp.func
def end_of_run(contact: int, count: int, contacts: wp.ref[ContactInput]) -> int:
    """End of the contacts of the same two shapes that follow each other."""
    shape0 = contacts.shape0[contact]
    shape1 = contacts.shape1[contact]
    end = int(contact) + 1
    while end < count and contacts.shape0[end] == shape0 and contacts.shape1[end] == shape1:
        end += 1
    return end


@wp.func
def forget_rows(body: int, rows: wp.ref[RowWork]):
    """Leaves a body that is not solved without rows."""
    rows.owned_end[body] = rows.owned_start[body]
    rows.other_end[body] = rows.other_start[body]


@functools.cache
@uncollected()
def make_form_islands(effects: Effects) -> wp.Kernel:
    """Kernel, one thread: wakes and puts to sleep, and lists what is awake island by island."""

    @wp.func
    def watch_gravity(s: wp.ref[Solver]):
        """Disturbs the bodies whose gravity has changed."""
        is_changed = bool(False)
        for i in range(s.sleep.gravity.shape[0]):
            change = s.model.gravity[i] - s.sleep.gravity[i]
            is_changed = is_changed or not wp.dot(change, change) == 0.0
        if is_changed:
            for body in range(s.sleep.order.shape[0]):
                change = s.model.gravity[s.model.world[body]] - s.sleep.gravity[s.model.world[body]]
                if not wp.dot(change, change) == 0.0:
                    disturb(body, s.worlds, s.sleep)
            for i in range(s.sleep.gravity.shape[0]):
                s.sleep.gravity[i] = s.model.gravity[i]

    @wp.func
    def is_asleep(contact: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """Whether a contact is one of a body that sleeps."""
        static_slot = s.worlds.rank.shape[0] - 1
        a = body_slot(s.shapes, step.contacts.shape0[contact], static_slot)
        b = body_slot(s.shapes, step.contacts.shape1[contact], static_slot)
        return s.worlds.island[a] >= 0 or s.worlds.island[b] >= 0

    @wp.func
    def list_contacts(step: wp.ref[Step], s: wp.ref[Solver]) -> int:
        """Lists the contacts of bodies that are awake, disturbs what touches those or what moves;
        returns the sum of the marks of the other contacts."""
        static_slot = s.sleep.tied.shape[0] - 1
        count = wp.min(step.contacts.count[0], step.contacts.capacity)
        sleeping = int(0)
        listed = int(0)
        contact = int(0)
        while contact < count:
            end = end_of_run(contact, count, step.contacts)
            shape0 = step.contacts.shape0[contact]
            shape1 = step.contacts.shape1[contact]
            is_sleeping = bool(False)
            if wp.min(shape0, shape1) >= 0 and wp.max(shape0, shape1) < s.shapes.body.shape[0]:
                a = body_slot(s.shapes, shape0, static_slot)
                b = body_slot(s.shapes, shape1, static_slot)
                island_a = s.worlds.island[a]
                island_b = s.worlds.island[b]
                is_sleeping = wp.max(island_a, island_b) >= 0
                marks = mark_of(shape0, shape1) * (end - contact)
                if is_sleeping:
                    sleeping += marks
                if island_a == AWAKE:
                    s.sleep.met[a] = s.sleep.met[a] + marks
                if island_b == AWAKE:
                    s.sleep.met[b] = s.sleep.met[b] + marks
                if island_a == MOVING or (island_a == AWAKE and island_b >= 0):
                    disturb(b, s.worlds, s.sleep)
                if island_b == MOVING or (island_b == AWAKE and island_a >= 0):
                    disturb(a, s.worlds, s.sleep)
                if wp.static(effects.moving_surfaces):
                    for k in range(contact, end):
                        if wp.length_sq(step.contacts.surface_velocity[k]) > 0.0:
                            disturb(a, s.worlds, s.sleep)
                            disturb(b, s.worlds, s.sleep)
            if not is_sleeping:
                for k in range(contact, end):
                    s.rows.awake[listed] = k
                    listed += 1
            contact = end
        s.rows.awake_count[0] = listed
        return sleeping

    @wp.func
    def find_changed_contacts(step: wp.ref[Step], s: wp.ref[Solver]):
        """Disturbs what sleeps and has other contacts than before."""
        static_slot = s.sleep.tied.shape[0] - 1
        for contact in range(wp.min(step.contacts.count[0], step.contacts.capacity)):
            shape0 = step.contacts.shape0[contact]
            shape1 = step.contacts.shape1[contact]
            if wp.min(shape0, shape1) < 0 or wp.max(shape0, shape1) >= s.shapes.body.shape[0]:
                continue
            for side in range(2):
                shape = wp.where(side == 0, shape0, shape1)
                body = body_slot(s.shapes, shape, static_slot)
                if s.worlds.island[body] >= 0:
                    s.sleep.met[body] = s.sleep.met[body] + mark_of(shape0, shape1)
        for k in range(s.sleep.filled[0]):
            body = s.sleep.order[k]
            if s.sleep.met[body] != s.sleep.contacts[body]:
                disturb(body, s.worlds, s.sleep)

    @wp.func
    def move_records(
        start: int, end: int, side: int, to: int, to_side: int, history: wp.ref[History]
    ):
        """Copies records of contacts to a place before or far behind them."""
        for i in range(start, end):
            history.records[to_side, to + i - start] = history.records[side, i]
            if wp.static(effects.angular_friction):
                history.torque[to_side, to + i - start] = history.torque[side, i]

    @wp.func
    def close_gaps(s: wp.ref[Solver]):
        """Takes those that have woken from the list of sleepers, and their records with them."""
        count = int(0)
        at = s.history.records.shape[1] / 2
        for k in range(s.sleep.filled[0]):
            body = s.sleep.order[k]
            if s.sleep.start[body] >= 0:
                move_records(s.sleep.start[body], s.sleep.end[body], 0, at, 0, s.history)
                s.sleep.end[body] += at - s.sleep.start[body]
                s.sleep.start[body] = at
                at = s.sleep.end[body]
                s.sleep.order[count] = body
                count += 1
        s.sleep.filled[0] = count
        s.sleep.filled[1] = at
        s.sleep.filled[2] = 0

    @wp.func
    def wake_islands(s: wp.ref[Solver]):
        """Wakes the bodies of islands that are disturbed, with the loads that they slept with, and
        lists the blocks that are awake."""
        for k in range(s.sleep.filled[0]):
            body = s.sleep.order[k]
            island = s.worlds.island[body]
            if island >= 0 and s.sleep.woken[island] != 0:
                s.worlds.island[body] = AWAKE
                s.sleep.still[body] = -1.0
            if s.worlds.island[body] < 0:
                side = s.history.parity[s.worlds.of_body[body]]
                if wp.static(effects.contact):
                    if side > 0:
                        start = s.sleep.start[body]
                        move_records(start, s.sleep.end[body], 0, start, side, s.history)
                    s.history.start[side, body] = s.sleep.start[body]
                    s.history.end[side, body] = s.sleep.end[body]
                s.sleep.start[body] = -1
                s.sleep.filled[2] = 1
        at = int(0)
        for world in range(s.worlds.body_start.shape[0] - 1):
            s.sleep.block_start[world] = at
            i = int(s.worlds.body_start[world])
            while i < s.worlds.body_start[world + 1]:
                mover = mover_of(i, s.worlds.block_end[i], s.worlds)
                if mover >= 0 and s.worlds.island[mover] == AWAKE:
                    s.sleep.blocks[at] = i
                    at += 1
                else:
                    for k in range(i, s.worlds.block_end[i]):
                        forget_rows(s.worlds.bodies[k], s.rows)
                i = s.worlds.block_end[i]
            s.sleep.block_start[world + 1] = at
        for body in range(s.sleep.order.shape[0]):
            s.sleep.woken[body] = 0
            s.sleep.met[body] = 0

    @wp.func
    def put_to_sleep(body: int, island: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """Stops a body where it is, and keeps what is remembered of its contacts."""
        s.worlds.island[body] = island
        forget_rows(body, s.rows)
        step.body_q_out[body] = step.body_q[body]
        step.body_qd_out[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        at = s.sleep.filled[1]
        end = int(at)
        if wp.static(effects.contact):
            side = s.history.parity[s.worlds.of_body[body]]
            start = s.history.start[side, body]
            count = s.history.end[side, body] - start
            if at + count <= s.history.records.shape[1]:
                move_records(start, start + count, side, at, 0, s.history)
                end = at + count
        s.sleep.start[body] = at
        s.sleep.end[body] = end
        s.sleep.order[s.sleep.filled[0]] = body
        s.sleep.filled[0] = s.sleep.filled[0] + 1
        s.sleep.filled[1] = end

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
                if wp.static(effects.closures):
                    s.sleep.seen_block_of[place] = s.sleep.block_of[i]
                for k in range(i, end):
                    body = s.worlds.bodies[k]
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


@wp.kernel(**KERNEL)
def export_sleeping_force(
    contacts: ContactInput, contact_f: wp.array[wp.spatial_vector], s: wp.array[Solver]
):
    """As :func:`.observables.export_contact_force`, of what sleeps: the load that it slept with.

    One thread a contact, which takes the load of the record that is nearest.
    """
    contact = wp.tid()
    shape0 = contacts.shape0[contact]
    shape1 = contacts.shape1[contact]
    is_real = contact < contacts.count[0] and contact < contact_f.shape[0]
    if not is_real or wp.min(shape0, shape1) < 0:
        return
    static_slot = s[0].sleep.tied.shape[0] - 1
    a = body_slot(s[0].shapes, shape0, static_slot)
    b = body_slot(s[0].shapes, shape1, static_slot)
    point0 = contacts.point0[contact]
    point1 = contacts.point1[contact]
    if s[0].shapes.frame.shape[0] > 0:
        point0 = point_on(s[0].shapes, shape0, point0)
        point1 = point_on(s[0].shapes, shape1, point1)
    arm0 = body_arm(a, static_slot, point0, s[0])
    arm1 = body_arm(b, static_slot, point1, s[0])
    apart = (s[0].work.com[b] - s[0].work.com[a]) + (arm1 - arm0)
    margins = contacts.margin0[contact] - contacts.margin1[contact]
    arm = arm0 + 0.5 * (apart + margins * contacts.normal[contact])
    best = FAR * FAR * wp.min(wp.length_sq(arm0), wp.length_sq(arm1))
    if b == static_slot:
        best = FAR * FAR * wp.length_sq(arm0)
    if a == static_slot:
        best = FAR * FAR * wp.length_sq(arm1)
    this = ContactRecord()
    this.point0 = point0
    this.point1 = point1
    for side in range(2):
        body = wp.where(side == 0, a, b)
        if s[0].worlds.island[body] >= 0:
            for i in range(s[0].sleep.start[body], s[0].sleep.end[body]):
                record = s[0].history.records[0, i]
                distance = anchor_distance(record, this)
                if record.shape0 == shape0 and record.shape1 == shape1 and distance < best:
                    best = distance
                    # the record has the force on the body that does not own it
                    sign = wp.where(side == 0, -1.0, 1.0)
                    torque = wp.cross(arm, record.force)
                    if s[0].history.torque.shape[1] > 0:
                        torque += s[0].history.torque[0, i]
                    contact_f[contact] = sign * wp.spatial_vector(record.force, torque)
