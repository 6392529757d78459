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
    BodyWork,
    ContactInput,
    ContactRecord,
    ControlInput,
    History,
    JointModel,
    RowWork,
    ShapeModel,
    SleepWork,
    TendonModel,
    WorldWork,
)
from ..effects import Effects
from .bodies import make_wrench, unit_pose
from .body_actuators import asked_of
from .contacts import FAR, anchor_distance, body_arm, body_slot, point_on
from .islands import begin_island, disturb, island_of, unite
from .launch import KERNEL, uncollected
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
    def watch_body(
        body: int,
        wrench: wp.spatial_vector,
        model: wp.ref[BodyModel],
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        h: float,
        worlds: wp.ref[WorldWork],
        sleep: wp.ref[SleepWork],
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Sees how a body moves that does not go on sleeping."""
        pose = body_q[body]
        velocity = body_qd[body]
        before = sleep.pose[body]
        island = worlds.island[body]
        is_pushed = not wrench == sleep.wrench[body]
        sleep.pose[body] = pose
        sleep.wrench[body] = wrench
        if island >= 0:
            disturb(body, worlds, sleep)
        if not is_mobile(model, body):
            if island >= AWAKE:
                sleep.stirred[0] = 1
            is_fixed = pose == before and velocity == STANDSTILL
            worlds.island[body] = wp.where(is_fixed, STILL, MOVING)
            move = h * wp.length(wp.spatial_top(velocity))
            wp.atomic_max(worlds.pace, worlds.of_body[body], move)
            body_q_out[body] = unit_pose(pose, body, worlds)
            body_qd_out[body] = velocity
            return
        if island < AWAKE:
            worlds.island[body] = AWAKE
            sleep.stirred[0] = 1
        size_sq = wp.trace(model.inertia[body]) * model.inv_mass[body]
        shift = wp.transform_get_translation(pose) - wp.transform_get_translation(before)
        turn = wp.transform_get_rotation(pose) - wp.transform_get_rotation(before)
        v = wp.spatial_top(velocity)
        w = wp.spatial_bottom(velocity)
        rest = REST * h * wp.length(model.gravity[model.world[body]])
        # comparisons that numbers which are not finite fail
        is_slow = wp.dot(v, v) + size_sq * wp.dot(w, w) <= rest * rest
        is_here = (
            wp.dot(shift, shift) <= JUMP * JUMP * size_sq and wp.dot(turn, turn) <= JUMP * JUMP
        )
        is_at_rest = is_slow and is_here and not is_pushed and island == AWAKE
        sleep.still[body] = wp.where(is_at_rest, wp.max(sleep.still[body], 0.0) + h, 0.0)

    @wp.func(inline=True)  # a call would copy all that it takes, for each body that sleeps
    def watch(
        body: int,
        model: wp.ref[BodyModel],
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        control: wp.ref[ControlInput],
        h: float,
        worlds: wp.ref[WorldWork],
        sleep: wp.ref[SleepWork],
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Passes on a body that goes on sleeping, and looks at any other."""
        wrench = external_wrench(model, body, body_f, control)
        if wp.static(effects.servos):
            wrench[0] += asked_of(body, model)
        if worlds.island[body] >= 0:
            pose = body_q[body]
            velocity = body_qd[body]
            if pose == sleep.pose[body] and velocity == STANDSTILL:
                if wrench == sleep.wrench[body]:
                    body_q_out[body] = pose
                    body_qd_out[body] = velocity
                    return
        watch_body(body, wrench, model, body_q, body_qd, h, worlds, sleep, body_q_out, body_qd_out)

    @wp.kernel(**KERNEL)
    def watch_bodies(
        # Model:
        model: wp.array[BodyModel],
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        control: ControlInput,
        h: float,
        # Work:
        worlds: wp.array[WorldWork],
        sleep: wp.array[SleepWork],
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        watch(
            wp.tid(),
            model[0],
            body_q,
            body_qd,
            body_f,
            control,
            h,
            worlds[0],
            sleep[0],
            body_q_out,
            body_qd_out,
        )

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
    def watch_gravity(
        model: wp.ref[BodyModel], worlds: wp.ref[WorldWork], sleep: wp.ref[SleepWork]
    ):
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
    def is_asleep(
        contact: int,
        shapes: wp.ref[ShapeModel],
        contacts: wp.ref[ContactInput],
        worlds: wp.ref[WorldWork],
    ):
        """Whether a contact is one of a body that sleeps."""
        static_slot = worlds.rank.shape[0] - 1
        a = body_slot(shapes, contacts.shape0[contact], static_slot)
        b = body_slot(shapes, contacts.shape1[contact], static_slot)
        return worlds.island[a] >= 0 or worlds.island[b] >= 0

    @wp.func
    def list_contacts(
        shapes: wp.ref[ShapeModel],
        contacts: wp.ref[ContactInput],
        worlds: wp.ref[WorldWork],
        sleep: wp.ref[SleepWork],
        rows: wp.ref[RowWork],
    ) -> int:
        """Lists the contacts of bodies that are awake, disturbs what touches those or what moves;
        returns the sum of the marks of the other contacts."""
        static_slot = sleep.tied.shape[0] - 1
        count = wp.min(contacts.count[0], contacts.capacity)
        sleeping = int(0)
        listed = int(0)
        contact = int(0)
        while contact < count:
            end = end_of_run(contact, count, contacts)
            shape0 = contacts.shape0[contact]
            shape1 = contacts.shape1[contact]
            is_sleeping = bool(False)
            if wp.min(shape0, shape1) >= 0 and wp.max(shape0, shape1) < shapes.body.shape[0]:
                a = body_slot(shapes, shape0, static_slot)
                b = body_slot(shapes, shape1, static_slot)
                island_a = worlds.island[a]
                island_b = worlds.island[b]
                is_sleeping = wp.max(island_a, island_b) >= 0
                marks = mark_of(shape0, shape1) * (end - contact)
                if is_sleeping:
                    sleeping += marks
                if island_a == AWAKE:
                    sleep.met[a] = sleep.met[a] + marks
                if island_b == AWAKE:
                    sleep.met[b] = sleep.met[b] + marks
                if island_a == MOVING or (island_a == AWAKE and island_b >= 0):
                    disturb(b, worlds, sleep)
                if island_b == MOVING or (island_b == AWAKE and island_a >= 0):
                    disturb(a, worlds, sleep)
                if wp.static(effects.moving_surfaces):
                    for k in range(contact, end):
                        if wp.length_sq(contacts.surface_velocity[k]) > 0.0:
                            disturb(a, worlds, sleep)
                            disturb(b, worlds, sleep)
            if not is_sleeping:
                for k in range(contact, end):
                    rows.awake[listed] = k
                    listed += 1
            contact = end
        rows.awake_count[0] = listed
        return sleeping

    @wp.func
    def find_changed_contacts(
        shapes: wp.ref[ShapeModel],
        contacts: wp.ref[ContactInput],
        worlds: wp.ref[WorldWork],
        sleep: wp.ref[SleepWork],
    ):
        """Disturbs what sleeps and has other contacts than before."""
        static_slot = sleep.tied.shape[0] - 1
        for contact in range(wp.min(contacts.count[0], contacts.capacity)):
            shape0 = contacts.shape0[contact]
            shape1 = contacts.shape1[contact]
            if wp.min(shape0, shape1) < 0 or wp.max(shape0, shape1) >= shapes.body.shape[0]:
                continue
            for side in range(2):
                shape = wp.where(side == 0, shape0, shape1)
                body = body_slot(shapes, shape, static_slot)
                if worlds.island[body] >= 0:
                    sleep.met[body] = sleep.met[body] + mark_of(shape0, shape1)
        for k in range(sleep.filled[0]):
            body = sleep.order[k]
            if sleep.met[body] != sleep.contacts[body]:
                disturb(body, worlds, sleep)

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
    def close_gaps(sleep: wp.ref[SleepWork], history: wp.ref[History]):
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
    def wake_islands(
        worlds: wp.ref[WorldWork],
        sleep: wp.ref[SleepWork],
        rows: wp.ref[RowWork],
        history: wp.ref[History],
    ):
        """Wakes the bodies of islands that are disturbed, with the loads that they slept with, and
        lists the blocks that are awake."""
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
        at = int(0)
        for world in range(worlds.body_start.shape[0] - 1):
            sleep.block_start[world] = at
            i = int(worlds.body_start[world])
            while i < worlds.body_start[world + 1]:
                mover = mover_of(i, worlds.block_end[i], worlds)
                if mover >= 0 and worlds.island[mover] == AWAKE:
                    sleep.blocks[at] = i
                    at += 1
                else:
                    for k in range(i, worlds.block_end[i]):
                        forget_rows(worlds.bodies[k], rows)
                i = worlds.block_end[i]
            sleep.block_start[world + 1] = at
        for body in range(sleep.order.shape[0]):
            sleep.woken[body] = 0
            sleep.met[body] = 0

    @wp.func
    def put_to_sleep(
        body: int,
        island: int,
        body_q: wp.array[wp.transform],
        worlds: wp.ref[WorldWork],
        sleep: wp.ref[SleepWork],
        rows: wp.ref[RowWork],
        history: wp.ref[History],
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Stops a body where it is, and keeps what is remembered of its contacts."""
        worlds.island[body] = island
        forget_rows(body, rows)
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
    def measure_islands(world: int, worlds: wp.ref[WorldWork], sleep: wp.ref[SleepWork]):
        """How many bodies the islands of a world have, and for how long they have been at rest."""
        for block in range(sleep.block_start[world], sleep.block_start[world + 1]):
            i = sleep.blocks[block]
            end = worlds.block_end[i]
            mover = mover_of(i, end, worlds)
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
                    sleep.met[body] = 0
                    sleep.quiet[root] = wp.min(sleep.quiet[root], still)

    @wp.func
    def begin_seen_island(
        world: int,
        island: int,
        root: int,
        worlds: wp.ref[WorldWork],
        seen: wp.ref[WorldWork],
        sleep: wp.ref[SleepWork],
        history: wp.ref[History],
        seen_history: wp.ref[History],
    ):
        """What holds for a world holds for its islands."""
        seen.pace[island] = worlds.pace[world]
        seen_history.parity[island] = history.parity[world]
        seen_history.step[island] = history.step[world]
        seen_history.age[island] = history.age[world]
        for i in range(2):
            seen_history.filling[island, i] = history.filling[world, i]
        if wp.static(effects.second_order):
            seen.step[island] = worlds.step[world]
            seen_history.slope_age[island] = history.slope_age[world]
            # what slept was at rest
            seen_history.smooth[island] = wp.where(
                sleep.quiet[root] < 0.0, QUIET_WORLD, history.smooth[world]
            )
        if wp.static(effects.loops):
            holder = sleep.loop_body[world]
            is_ahead = bool(True)
            if holder >= 0:
                if worlds.island[holder] == AWAKE:
                    holder_root = island_of(sleep.islands, holder)
                    is_ahead = worlds.rank[root] > worlds.rank[holder_root]
            sleep.seen_loop_start[island] = sleep.loop_start[world + int(is_ahead)]

    @wp.func
    def form(
        model: wp.ref[BodyModel],
        shapes: wp.ref[ShapeModel],
        body_q: wp.array[wp.transform],
        contacts: wp.ref[ContactInput],
        worlds: wp.ref[WorldWork],
        seen: wp.ref[WorldWork],
        rows: wp.ref[RowWork],
        sleep: wp.ref[SleepWork],
        history: wp.ref[History],
        seen_history: wp.ref[History],
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """Wakes what is disturbed, finds the islands of what is awake, and puts to sleep."""
        static_slot = sleep.tied.shape[0] - 1
        if sleep.filled[2] != 0:
            close_gaps(sleep, history)
        watch_gravity(model, worlds, sleep)
        sleeping = int(0)
        if wp.static(effects.contact):
            sleeping = list_contacts(shapes, contacts, worlds, sleep, rows)
        if sleeping != sleep.marks[0]:
            if wp.static(effects.contact):
                find_changed_contacts(shapes, contacts, worlds, sleep)
            else:
                for k in range(sleep.filled[0]):
                    if sleep.contacts[sleep.order[k]] != 0:
                        disturb(sleep.order[k], worlds, sleep)
        if sleep.stirred[0] != 0:
            sleep.stirred[0] = 0
            wake_islands(worlds, sleep, rows, history)
            if wp.static(effects.contact):
                sleeping = list_contacts(shapes, contacts, worlds, sleep, rows)

        # What is linked.
        world_count = worlds.body_start.shape[0] - 1
        for block in range(sleep.block_start[world_count]):
            i = sleep.blocks[block]
            for k in range(i, worlds.block_end[i]):
                body = worlds.bodies[k]
                begin_island(sleep.islands, body)
                tied = sleep.tied[body]
                if worlds.island[tied] == AWAKE:
                    sleep.islands.parent[body] = tied
        if wp.static(effects.contact):
            for k in range(rows.awake_count[0]):
                shape0 = contacts.shape0[rows.awake[k]]
                shape1 = contacts.shape1[rows.awake[k]]
                if wp.min(shape0, shape1) < 0 or wp.max(shape0, shape1) >= shapes.body.shape[0]:
                    continue
                a = body_slot(shapes, shape0, static_slot)
                b = body_slot(shapes, shape1, static_slot)
                if worlds.island[a] == AWAKE and worlds.island[b] == AWAKE:
                    if worlds.of_body[a] == worlds.of_body[b]:
                        unite(sleep.islands, worlds, a, b)

        # Who sleeps now, and who is where in the list of the others.
        island = int(0)
        at = int(0)
        kept = int(0)
        before = sleep.filled[0]
        for world in range(world_count):
            measure_islands(world, worlds, sleep)
            seen.island_start[world] = island
            first_block = sleep.block_start[world]
            sleep.block_start[world] = kept
            for block in range(first_block, sleep.block_start[world + 1]):
                i = sleep.blocks[block]
                end = worlds.block_end[i]
                mover = mover_of(i, end, worlds)
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
                                rows,
                                history,
                                body_q_out,
                                body_qd_out,
                            )
                    continue
                sleep.blocks[kept] = i
                kept += 1
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
            if wp.static(effects.loops):
                sleep.seen_loop_start[island] = sleep.loop_start[world + 1]
        sleep.block_start[world_count] = kept
        seen.island_start[world_count] = island
        seen.body_start[island] = at
        if wp.static(effects.contact):
            if sleep.filled[0] > before:
                for k in range(rows.awake_count[0]):
                    contact = rows.awake[k]
                    if is_asleep(contact, shapes, contacts, worlds):
                        sleeping += mark_of(contacts.shape0[contact], contacts.shape1[contact])
        sleep.marks[0] = sleeping

    @wp.kernel(**KERNEL)
    def form_islands(
        # Model:
        model: wp.array[BodyModel],
        shapes: wp.array[ShapeModel],
        # State in:
        body_q: wp.array[wp.transform],
        contacts: ContactInput,
        # Work:
        worlds: wp.array[WorldWork],
        seen: wp.array[WorldWork],
        rows: wp.array[RowWork],
        sleep: wp.array[SleepWork],
        history: wp.array[History],
        seen_history: wp.array[History],
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        form(
            model[0],
            shapes[0],
            body_q,
            contacts,
            worlds[0],
            seen[0],
            rows[0],
            sleep[0],
            history[0],
            seen_history[0],
            body_q_out,
            body_qd_out,
        )

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
    # Model:
    model: BodyModel,
    shapes: ShapeModel,
    # Contacts in:
    contacts: ContactInput,
    # Work:
    worlds: WorldWork,
    work: BodyWork,
    sleep: SleepWork,
    history: History,
    # Out:
    contact_f: wp.array[wp.spatial_vector],
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
    static_slot = sleep.tied.shape[0] - 1
    a = body_slot(shapes, shape0, static_slot)
    b = body_slot(shapes, shape1, static_slot)
    point0 = contacts.point0[contact]
    point1 = contacts.point1[contact]
    if shapes.frame.shape[0] > 0:
        point0 = point_on(shapes, shape0, point0)
        point1 = point_on(shapes, shape1, point1)
    arm0 = body_arm(work.pose, model, a, static_slot, point0)
    arm1 = body_arm(work.pose, model, b, static_slot, point1)
    apart = (work.com[b] - work.com[a]) + (arm1 - arm0)
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
        if worlds.island[body] >= 0:
            for i in range(sleep.start[body], sleep.end[body]):
                record = history.records[0, i]
                distance = anchor_distance(record, this)
                if record.shape0 == shape0 and record.shape1 == shape1 and distance < best:
                    best = distance
                    # the record has the force on the body that does not own it
                    sign = wp.where(side == 0, -1.0, 1.0)
                    torque = wp.cross(arm, record.force)
                    if history.torque.shape[1] > 0:
                        torque += history.torque[0, i]
                    contact_f[contact] = sign * wp.spatial_vector(record.force, torque)
