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
    BodyModel,
    ContactInput,
    ControlInput,
    History,
    JointModel,
    RowWork,
    ShapeModel,
    SleepWork,
    WorldWork,
)
from ..effects import Effects
from .bodies import make_wrench, unit_pose
from .contacts import ASLEEP, body_slot
from .islands import begin_island, disturb, island_of, unite

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


@functools.cache
def make_watch_bodies(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a body: passes on what sleeps or is not moved, and sees what disturbs."""
    external_wrench = make_wrench(effects)

    @wp.kernel(enable_backward=False, module="unique")
    def watch_bodies(
        # Model:
        model: BodyModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        control: ControlInput,
        h: float,
        # Work:
        worlds: WorldWork,
        sleep: SleepWork,
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        body = wp.tid()
        pose = body_q[body]
        velocity = body_qd[body]
        wrench = external_wrench(model, body, body_f, control)
        before = sleep.pose[body]
        shift = wp.transform_get_translation(pose) - wp.transform_get_translation(before)
        turn = wp.transform_get_rotation(pose) - wp.transform_get_rotation(before)
        pushed = wrench - sleep.wrench[body]
        change = wp.dot(shift, shift) + wp.dot(turn, turn) + wp.dot(velocity, velocity)
        push_change = wp.dot(pushed, pushed)
        island = worlds.island[body]
        sleep.met[body] = 0
        # comparisons that numbers which are not finite fail
        if island >= 0 and change == 0.0 and push_change == 0.0:
            body_q_out[body] = pose
            body_qd_out[body] = velocity
            return
        sleep.pose[body] = pose
        sleep.wrench[body] = wrench
        if island >= 0:
            disturb(body, worlds, sleep)
        if not is_mobile(model, body):
            worlds.island[body] = wp.where(change == 0.0, STILL, MOVING)
            move = h * wp.length(wp.spatial_top(velocity))
            wp.atomic_max(worlds.pace, worlds.of_body[body], move)
            body_q_out[body] = unit_pose(pose, body, worlds)
            body_qd_out[body] = velocity
            return
        size_sq = wp.trace(model.inertia[body]) * model.inv_mass[body]
        v = wp.spatial_top(velocity)
        w = wp.spatial_bottom(velocity)
        rest = REST * h * wp.length(model.gravity[model.world[body]])
        is_at_rest = (
            island == AWAKE
            and push_change == 0.0
            and wp.dot(v, v) + size_sq * wp.dot(w, w) <= rest * rest
            and wp.dot(shift, shift) <= JUMP * JUMP * size_sq
            and wp.dot(turn, turn) <= JUMP * JUMP
        )
        sleep.still[body] = wp.where(is_at_rest, wp.max(sleep.still[body], 0.0) + h, 0.0)
        if island < AWAKE:
            worlds.island[body] = AWAKE

    return watch_bodies


@wp.kernel(enable_backward=False, module="unique")
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
        if control.joint_f[dof] != sleep.joint_f[dof]:
            sleep.joint_f[dof] = control.joint_f[dof]
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


@functools.cache
def make_form_islands(effects: Effects) -> wp.Kernel:
    """Kernel, one thread: wakes and puts to sleep, and lists what is awake island by island."""

    @wp.func
    def watch_gravity(model: BodyModel, worlds: WorldWork, sleep: SleepWork):
        """Disturbs the bodies whose gravity has changed."""
        is_changed = bool(False)
        for i in range(sleep.gravity.shape[0]):
            change = model.gravity[i] - sleep.gravity[i]
            is_changed = is_changed or not wp.dot(change, change) == 0.0
        if is_changed:
            for body in range(sleep.order.shape[0]):
                change = model.gravity[model.world[body]] - sleep.gravity[model.world[body]]
                if not wp.dot(change, change) == 0.0:
                    disturb(body, worlds, sleep)
            for i in range(sleep.gravity.shape[0]):
                sleep.gravity[i] = model.gravity[i]

    @wp.func
    def watch_contacts(
        count: int,
        shapes: ShapeModel,
        contacts: ContactInput,
        worlds: WorldWork,
        sleep: SleepWork,
        rows: RowWork,
    ):
        """Counts the contacts of each body; disturbs those that touch what moves or is awake."""
        static_slot = sleep.tied.shape[0] - 1
        for contact in range(count):
            shape0 = contacts.shape0[contact]
            shape1 = contacts.shape1[contact]
            rows.owner[contact] = -1
            if wp.min(shape0, shape1) < 0 or wp.max(shape0, shape1) >= shapes.body.shape[0]:
                continue
            a = body_slot(shapes, shape0, static_slot)
            b = body_slot(shapes, shape1, static_slot)
            island_a = worlds.island[a]
            island_b = worlds.island[b]
            if island_a >= AWAKE:
                sleep.met[a] = sleep.met[a] + 1
            if island_b >= AWAKE:
                sleep.met[b] = sleep.met[b] + 1
            if wp.max(island_a, island_b) >= 0:
                rows.owner[contact] = ASLEEP
            if island_a == MOVING or (island_a == AWAKE and island_b >= 0):
                disturb(b, worlds, sleep)
            if island_b == MOVING or (island_b == AWAKE and island_a >= 0):
                disturb(a, worlds, sleep)
            if wp.static(effects.moving_surfaces):
                if wp.length_sq(contacts.surface_velocity[contact]) > 0.0:
                    disturb(a, worlds, sleep)
                    disturb(b, worlds, sleep)

    @wp.func
    def move_records(start: int, end: int, side: int, to: int, to_side: int, history: History):
        """Copies records of contacts to a place before or far behind them."""
        for i in range(start, end):
            history.records[to_side, to + i - start] = history.records[side, i]
            if wp.static(effects.angular_friction):
                history.torque[to_side, to + i - start] = history.torque[side, i]

    @wp.func
    def close_gaps(sleep: SleepWork, history: History):
        """Takes those that have woken from the list of sleepers, and their records with them."""
        count = int(0)
        at = history.records.shape[1] / 2
        for k in range(sleep.filled[0]):
            body = sleep.order[k]
            if sleep.start[body] >= 0:
                move_records(sleep.start[body], sleep.end[body], 0, at, 0, history)
                sleep.end[body] += at - sleep.start[body]
                sleep.start[body] = at
                at = sleep.end[body]
                sleep.order[count] = body
                count += 1
        sleep.filled[0] = count
        sleep.filled[1] = at
        sleep.filled[2] = 0

    @wp.func
    def wake_islands(worlds: WorldWork, sleep: SleepWork, history: History):
        """Wakes the bodies of islands that are disturbed, with the loads that they slept with."""
        for k in range(sleep.filled[0]):
            body = sleep.order[k]
            island = worlds.island[body]
            if island >= 0 and sleep.woken[island] != 0:
                worlds.island[body] = AWAKE
                sleep.still[body] = -1.0
            if worlds.island[body] < 0:
                side = history.parity[worlds.of_body[body]]
                if wp.static(effects.contact):
                    if side > 0:
                        start = sleep.start[body]
                        move_records(start, sleep.end[body], 0, start, side, history)
                    history.start[side, body] = sleep.start[body]
                    history.end[side, body] = sleep.end[body]
                sleep.start[body] = -1
                sleep.filled[2] = 1
        for body in range(sleep.order.shape[0]):
            sleep.woken[body] = 0

    @wp.func
    def put_to_sleep(
        body: int,
        island: int,
        body_q: wp.array[wp.transform],
        worlds: WorldWork,
        sleep: SleepWork,
        history: History,
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Stops a body where it is, and keeps what is remembered of its contacts."""
        worlds.island[body] = island
        body_q_out[body] = body_q[body]
        body_qd_out[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        at = sleep.filled[1]
        end = int(at)
        if wp.static(effects.contact):
            side = history.parity[worlds.of_body[body]]
            start = history.start[side, body]
            count = history.end[side, body] - start
            if at + count <= history.records.shape[1]:
                move_records(start, start + count, side, at, 0, history)
                end = at + count
        sleep.start[body] = at
        sleep.end[body] = end
        sleep.order[sleep.filled[0]] = body
        sleep.filled[0] = sleep.filled[0] + 1
        sleep.filled[1] = end

    @wp.func
    def mover_of(first: int, end: int, worlds: WorldWork) -> int:
        """The first body of a block that the solver moves, -1 without."""
        for i in range(first, end):
            if worlds.island[worlds.bodies[i]] >= AWAKE:
                return worlds.bodies[i]
        return -1

    @wp.func
    def measure_islands(first: int, last: int, worlds: WorldWork, sleep: SleepWork):
        """How many bodies the islands of a world have, and for how long they have been at rest."""
        i = int(first)
        while i < last:
            end = worlds.block_end[i]
            mover = mover_of(i, end, worlds)
            if mover >= 0 and worlds.island[mover] == AWAKE:
                root = island_of(sleep.islands, mover)
                if mover == root:
                    sleep.quiet[root] = wp.inf
                    sleep.size[root] = 0
                sleep.size[root] = sleep.size[root] + end - i
                for k in range(i, end):
                    body = worlds.bodies[k]
                    if worlds.island[body] == AWAKE:
                        still = sleep.still[body]
                        # what rested on something that is gone is about to fall
                        if sleep.met[body] != sleep.contacts[body]:
                            still = wp.min(still, 0.0)
                        sleep.contacts[body] = sleep.met[body]
                        sleep.quiet[root] = wp.min(sleep.quiet[root], still)
            i = end

    @wp.func
    def begin_seen_island(
        world: int,
        island: int,
        root: int,
        worlds: WorldWork,
        seen: WorldWork,
        sleep: SleepWork,
        history: History,
        seen_history: History,
    ):
        """What holds for a world holds for its islands."""
        seen.pace[island] = worlds.pace[world]
        seen_history.parity[island] = history.parity[world]
        seen_history.step[island] = history.step[world]
        seen_history.age[island] = history.age[world]
        for i in range(2):
            seen_history.filling[island, i] = history.filling[world, i]
        if wp.static(effects.bdf2):
            seen.step[island] = worlds.step[world]
            # what slept has no last step to go on from
            seen_history.smooth[island] = wp.where(
                sleep.quiet[root] < 0.0, 0, history.smooth[world]
            )
        if wp.static(effects.loops):
            holder = sleep.loop_body[world]
            is_ahead = bool(True)
            if holder >= 0:
                if worlds.island[holder] == AWAKE:
                    holder_root = island_of(sleep.islands, holder)
                    is_ahead = worlds.rank[root] > worlds.rank[holder_root]
            sleep.seen_loop_start[island] = sleep.loop_start[world + int(is_ahead)]

    @wp.kernel(enable_backward=False, module="unique")
    def form_islands(
        # Model:
        model: BodyModel,
        shapes: ShapeModel,
        # State in:
        body_q: wp.array[wp.transform],
        contacts: ContactInput,
        # Work:
        worlds: WorldWork,
        seen: WorldWork,
        rows: RowWork,
        sleep: SleepWork,
        history: History,
        seen_history: History,
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        static_slot = sleep.tied.shape[0] - 1
        if sleep.filled[2] != 0:
            close_gaps(sleep, history)
        watch_gravity(model, worlds, sleep)
        count = int(0)
        if wp.static(effects.contact):
            count = wp.min(contacts.count[0], contacts.capacity)
            watch_contacts(count, shapes, contacts, worlds, sleep, rows)
        for k in range(sleep.filled[0]):
            body = sleep.order[k]
            if sleep.met[body] != sleep.contacts[body]:
                disturb(body, worlds, sleep)
        is_stirred = sleep.stirred[0] != 0
        if is_stirred:
            sleep.stirred[0] = 0
            wake_islands(worlds, sleep, history)

        # What is linked.
        for body in range(static_slot):
            if worlds.island[body] == AWAKE:
                begin_island(sleep.islands, body)
                sleep.islands.parent[body] = sleep.tied[body]
        for contact in range(count):
            if is_stirred or rows.owner[contact] != ASLEEP:
                shape0 = contacts.shape0[contact]
                shape1 = contacts.shape1[contact]
                if wp.min(shape0, shape1) < 0 or wp.max(shape0, shape1) >= shapes.body.shape[0]:
                    continue
                a = body_slot(shapes, shape0, static_slot)
                b = body_slot(shapes, shape1, static_slot)
                rows.owner[contact] = -1
                if wp.max(worlds.island[a], worlds.island[b]) >= 0:
                    rows.owner[contact] = ASLEEP
                elif worlds.island[a] == AWAKE and worlds.island[b] == AWAKE:
                    if worlds.of_body[a] == worlds.of_body[b]:
                        unite(sleep.islands, worlds, a, b)

        # Who sleeps now, and who is where in the list of the others.
        island = int(0)
        at = int(0)
        for world in range(worlds.body_start.shape[0] - 1):
            first = worlds.body_start[world]
            last = worlds.body_start[world + 1]
            measure_islands(first, last, worlds, sleep)
            seen.island_start[world] = island
            i = int(first)
            while i < last:
                end = worlds.block_end[i]
                mover = mover_of(i, end, worlds)
                if mover >= 0 and worlds.island[mover] == AWAKE:
                    root = island_of(sleep.islands, mover)
                    if sleep.quiet[root] >= REST_TIME:
                        for k in range(i, end):
                            body = worlds.bodies[k]
                            if worlds.island[body] == AWAKE:
                                put_to_sleep(
                                    body,
                                    root,
                                    body_q,
                                    worlds,
                                    sleep,
                                    history,
                                    body_q_out,
                                    body_qd_out,
                                )
                    else:
                        if mover == root:
                            begin_seen_island(
                                world, island, root, worlds, seen, sleep, history, seen_history
                            )
                            seen.body_start[island] = at
                            sleep.place[root] = at
                            at += sleep.size[root]
                            island += 1
                        place = sleep.place[root]
                        sleep.place[root] = place + end - i
                        if wp.static(effects.closures):
                            sleep.seen_block_of[place] = sleep.block_of[i]
                        for k in range(i, end):
                            body = worlds.bodies[k]
                            seen.bodies[place + k - i] = body
                            seen.rank[body] = place + k - i
                            seen.block_end[place + k - i] = place + end - i
                i = end
            if wp.static(effects.loops):
                sleep.seen_loop_start[island] = sleep.loop_start[world + 1]
        seen.island_start[worlds.body_start.shape[0] - 1] = island
        seen.body_start[island] = at

    return form_islands


@functools.cache
def make_end_islands(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a world: what became of its islands is what became of the world."""

    @wp.kernel(enable_backward=False, module="unique")
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
        for island in range(first, end):
            worlds.sweeps[world] = wp.max(worlds.sweeps[world], seen.sweeps[island])
            worlds.update[world] = wp.max(worlds.update[world], seen.update[island])
            history.step[world] = seen_history.step[island]
            history.age[world] = wp.min(
                wp.where(island == first, seen_history.age[first], history.age[world]),
                seen_history.age[island],
            )
            for i in range(2):
                history.filling[world, i] = seen_history.filling[island, i]
            if wp.static(effects.bdf2):
                worlds.step[world] = seen.step[island]
                history.smooth[world] = wp.where(
                    island == first,
                    seen_history.smooth[first],
                    wp.min(history.smooth[world], seen_history.smooth[island]),
                )

    return end_islands
