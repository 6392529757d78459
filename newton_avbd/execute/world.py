# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The step of one world in one kernel, one thread a world: read :func:`make_solve` top to bottom."""

import functools

import warp as wp

from ..algebra.block import factor_block, solve_block
from ..blocks.body import moved_pose
from ..data import (
    BodyModel,
    BodyWork,
    ContactInput,
    ContactRecord,
    ContactRow,
    History,
    RowWork,
    ShapeModel,
    WorldWork,
)
from ..effects import Effects
from ..rows import contact as contact_rows

SLOP_SHARE = wp.constant(0.05)
"""Penetration that is left alone, as a share of g h^2: it keeps touching contacts touching."""


@wp.func
def body_slot(shapes: ShapeModel, shape: int, static_slot: int) -> int:
    """Slot of the body that carries a shape; the static world for a shape without a body."""
    body = shapes.body[shape]
    if body < 0:
        return static_slot
    return body


@wp.func
def body_arm(
    body_q: wp.array[wp.transform], model: BodyModel, slot: int, static_slot: int, point: wp.vec3
) -> wp.vec3:
    """From the COM of a body to a point given in its frame, in world axes [m]."""
    if slot == static_slot:
        return point
    return wp.quat_rotate(wp.transform_get_rotation(body_q[slot]), point - model.com[slot])


@wp.func
def owner_of(work: BodyWork, slot0: int, slot1: int) -> int:
    """Which body of a contact is visited first (0 or 1); -1 when the solver moves neither."""
    moves0 = work.inv_mass[slot0] > 0.0
    moves1 = work.inv_mass[slot1] > 0.0
    if moves0 and moves1:
        return wp.where(slot0 < slot1, 0, 1)
    if moves0:
        return 0
    return wp.where(moves1, 1, -1)


@wp.func
def sort_rows(
    world: int,
    static_slot: int,
    contact_start: int,
    contact_end: int,
    contacts: ContactInput,
    shapes: ShapeModel,
    worlds: WorldWork,
    work: BodyWork,
    rows: RowWork,
):
    """Makes room for each body's rows: counting sort of the world's contacts by owner."""
    body_start = worlds.body_start[world]
    body_end = worlds.body_start[world + 1]
    for i in range(body_start, body_end):
        body = worlds.bodies[i]
        rows.owned_end[body] = 0
        rows.other_end[body] = 0
    for i in range(contact_start, contact_end):
        contact = worlds.contacts[i]
        slot0 = body_slot(shapes, contacts.shape0[contact], static_slot)
        slot1 = body_slot(shapes, contacts.shape1[contact], static_slot)
        owner = owner_of(work, slot0, slot1)
        if owner >= 0:
            a = wp.where(owner == 0, slot0, slot1)
            b = wp.where(owner == 0, slot1, slot0)
            rows.owned_end[a] = rows.owned_end[a] + 1
            if work.inv_mass[b] > 0.0:
                rows.other_end[b] = rows.other_end[b] + 1
    owned = int(contact_start)
    other = int(contact_start)
    for i in range(body_start, body_end):
        body = worlds.bodies[i]
        owned_count = rows.owned_end[body]
        other_count = rows.other_end[body]
        rows.owned_start[body] = owned
        rows.owned_end[body] = owned
        rows.other_start[body] = other
        rows.other_end[body] = other
        owned += owned_count
        other += other_count


@wp.func
def anchor_distance(record: ContactRecord, point0: wp.vec3, point1: wp.vec3) -> float:
    """Squared distance of a contact from a remembered one [m^2], on the shape where it is nearer.

    A contact that slides stays put on one of its two shapes.
    """
    return wp.min(
        wp.length_sq(record.point0 - point0), wp.length_sq(record.point1 - point1)
    )


@wp.func
def find_record(
    history: History,
    side: int,
    start: int,
    end: int,
    guess: int,
    shape0: int,
    shape1: int,
    point0: wp.vec3,
    point1: wp.vec3,
    near: float,
) -> int:
    """Record of the same contact in the last step, -1 when there is none.

    The same pair of shapes and the nearest anchor; the guess is taken at once if it is near.
    """
    if guess < end:
        record = history.records[side, guess]
        if record.shape0 == shape0 and record.shape1 == shape1:
            if anchor_distance(record, point0, point1) < near:
                return guess
    found = int(-1)
    best = float(0.0)
    for i in range(start, end):
        record = history.records[side, i]
        if record.shape0 == shape0 and record.shape1 == shape1:
            distance = anchor_distance(record, point0, point1)
            if found < 0 or distance < best:
                found = i
                best = distance
    return found


@functools.cache
def make_solve(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a world: the whole step of bodies in contact, after prediction."""
    contact_force = contact_rows.force if effects.friction else contact_rows.normal_force

    @wp.func
    def build_rows(
        world: int,
        static_slot: int,
        contact_start: int,
        contact_end: int,
        reach: float,
        gravity: float,
        world_mass: float,
        h: float,
        body_q: wp.array[wp.transform],
        model: BodyModel,
        contacts: ContactInput,
        shapes: ShapeModel,
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        history: History,
    ) -> float:
        """Linearises the world's contacts, warm-started; returns the deepest penetration [m]."""
        side = history.parity[world]
        deepest = float(0.0)
        for i in range(contact_start, contact_end):
            contact = worlds.contacts[i]
            shape0 = contacts.shape0[contact]
            shape1 = contacts.shape1[contact]
            slot0 = body_slot(shapes, shape0, static_slot)
            slot1 = body_slot(shapes, shape1, static_slot)
            owner = owner_of(work, slot0, slot1)
            if owner >= 0:
                point0 = contacts.point0[contact]
                point1 = contacts.point1[contact]
                normal = contacts.normal[contact]
                margin0 = contacts.margin0[contact]
                margin1 = contacts.margin1[contact]
                arm0 = body_arm(body_q, model, slot0, static_slot, point0)
                arm1 = body_arm(body_q, model, slot1, static_slot, point1)
                apart = (work.com[slot1] - work.com[slot0]) + (arm1 - arm0)
                gap = wp.dot(normal, apart) - (margin0 + margin1)
                # both bodies feel the force at one point, half way between the two surfaces
                arm0 = arm0 + 0.5 * (apart + (margin0 - margin1) * normal)
                arm1 = arm1 - 0.5 * (apart - (margin0 - margin1) * normal)

                row = ContactRow()
                row.gap = gap
                if owner == 0:
                    row.a = slot0
                    row.b = slot1
                    row.normal = normal
                    row.arm_a = arm0
                    row.arm_b = arm1
                else:
                    row.a = slot1
                    row.b = slot0
                    row.normal = -normal
                    row.arm_a = arm1
                    row.arm_b = arm0

                index = rows.owned_end[row.a]
                start = history.start[side, row.a]
                known = find_record(
                    history,
                    side,
                    start,
                    history.end[side, row.a],
                    start + (index - rows.owned_start[row.a]),
                    shape0,
                    shape1,
                    point0,
                    point1,
                    1.0e-4 * wp.length_sq(row.arm_a),
                )
                if known >= 0:
                    row.force = history.records[side, known].force
                    # a record serves one contact only
                    history.records[side, known].shape0 = -1
                    lambda_n = wp.dot(row.normal, row.force)
                    if lambda_n <= 0.0:
                        row.force = wp.vec3(0.0)
                    elif wp.static(effects.friction):
                        row.mu = wp.sqrt(shapes.mu[shape0] * shapes.mu[shape1])
                if wp.static(effects.friction):
                    row.mu = wp.sqrt(shapes.mu[shape0] * shapes.mu[shape1])

                mass = contact_rows.effective_mass(
                    row.normal,
                    row.arm_a,
                    row.arm_b,
                    work.inv_mass[row.a] + work.inv_mass[row.b],
                    work.inv_inertia[row.a],
                    work.inv_inertia[row.b],
                )
                load = wp.min(
                    wp.dot(row.normal, row.force) / wp.max(gravity, 1.0e-12), world_mass
                )
                u = contact_rows.slip(row, work.target[row.a], work.target[row.b])
                row = contact_rows.penalise(row, mass, load, u, reach, h)
                if row.k_n > 0.0:
                    rows.rows[index] = row
                    rows.contact[index] = wp.where(owner == 0, contact, ~contact)
                    rows.owned_end[row.a] = index + 1
                    if work.inv_mass[row.b] > 0.0:
                        other = rows.other_end[row.b]
                        rows.other_rows[other] = index
                        rows.other_end[row.b] = other + 1
                    deepest = wp.max(deepest, -gap)

                    record = ContactRecord()
                    record.shape0 = shape0
                    record.shape1 = shape1
                    record.point0 = point0
                    record.point1 = point1
                    history.records[1 - side, index] = record
        return deepest

    @wp.func
    def factor_body(body: int, h: float, model: BodyModel, work: BodyWork, rows: RowWork):
        """Assembles and factors a body's block; the penalties stay, so once a step is enough."""
        inv_h2 = 1.0 / (h * h)
        h_ll = wp.diag(wp.vec3(model.mass[body] * inv_h2))
        h_al = wp.mat33(0.0)
        h_aa = work.inertia[body] * inv_h2
        for i in range(rows.owned_start[body], rows.owned_end[body]):
            row = rows.rows[i]
            h_ll, h_al, h_aa = contact_rows.curvature(row, row.arm_a, h_ll, h_al, h_aa)
        for i in range(rows.other_start[body], rows.other_end[body]):
            row = rows.rows[rows.other_rows[i]]
            h_ll, h_al, h_aa = contact_rows.curvature(row, row.arm_b, h_ll, h_al, h_aa)
        work.factor[body] = factor_block(h_ll, h_al, h_aa)

    @wp.func
    def sweep_body(
        body: int,
        dual: bool,
        recover: bool,
        slop: float,
        h: float,
        model: BodyModel,
        work: BodyWork,
        rows: RowWork,
    ):
        """Moves one body to the minimum of its quadratic model (block descent).

        With ``dual`` the rows that the body owns first take the dual update that ends the last
        sweep: nothing has moved at them since.
        """
        increment = work.increment[body]
        away = work.target[body] - increment
        inv_h2 = 1.0 / (h * h)
        f = (model.mass[body] * inv_h2) * wp.spatial_top(away)
        tau = inv_h2 * (work.inertia[body] * wp.spatial_bottom(away))
        for i in range(rows.owned_start[body], rows.owned_end[body]):
            row = rows.rows[i]
            u = contact_rows.slip(row, increment, work.increment[row.b])
            gap = contact_rows.solve_gap(row)
            if dual:
                row.force = contact_force(row, u, gap)
                rows.rows[i].force = row.force
            if recover:
                gap = contact_rows.recovery_gap(row, slop)
            push = contact_force(row, u, gap)
            f -= push
            tau -= wp.cross(row.arm_a, push)
        for i in range(rows.other_start[body], rows.other_end[body]):
            row = rows.rows[rows.other_rows[i]]
            u = contact_rows.slip(row, work.increment[row.a], increment)
            gap = contact_rows.solve_gap(row)
            if recover:
                gap = contact_rows.recovery_gap(row, slop)
            push = contact_force(row, u, gap)
            f += push
            tau += wp.cross(row.arm_b, push)
        work.increment[body] = increment + solve_block(work.factor[body], f, tau)

    @wp.func
    def finish_rows(
        world: int, side: int, work: BodyWork, rows: RowWork, worlds: WorldWork, history: History
    ):
        """Last dual update; the multipliers are remembered for the next step."""
        for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
            body = worlds.bodies[i]
            history.start[side, body] = rows.owned_start[body]
            history.end[side, body] = rows.owned_end[body]
            for r in range(rows.owned_start[body], rows.owned_end[body]):
                row = rows.rows[r]
                u = contact_rows.slip(row, work.increment[row.a], work.increment[row.b])
                push = contact_force(row, u, contact_rows.solve_gap(row))
                rows.rows[r].force = push
                history.records[side, r].force = push

    @wp.kernel(enable_backward=False, module="unique")
    def solve(
        # Model:
        model: BodyModel,
        shapes: ShapeModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        contacts: ContactInput,
        h: float,
        iterations: int,
        # Work:
        worlds: WorldWork,
        work: BodyWork,
        rows: RowWork,
        history: History,
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        world = wp.tid()
        static_slot = work.inv_mass.shape[0] - 1
        body_start = worlds.body_start[world]
        body_end = worlds.body_start[world + 1]
        contact_start = worlds.contact_start[world]
        contact_end = worlds.contact_start[world + 1]

        # What the world as a whole says: how far things may go, what could rest on a contact.
        world_mass = float(0.0)
        gravity = float(0.0)
        fastest = float(0.0)
        for i in range(body_start, body_end):
            body = worlds.bodies[i]
            fastest = wp.max(fastest, wp.length(wp.spatial_top(work.target[body])))
            if work.inv_mass[body] > 0.0:
                world_mass += model.mass[body]
                gravity = wp.max(gravity, wp.length(model.gravity[model.world[body]]))
        reach = 2.0 * fastest

        sort_rows(
            world, static_slot, contact_start, contact_end, contacts, shapes, worlds, work, rows
        )
        deepest = build_rows(
            world,
            static_slot,
            contact_start,
            contact_end,
            reach,
            gravity,
            world_mass,
            h,
            body_q,
            model,
            contacts,
            shapes,
            worlds,
            work,
            rows,
            history,
        )
        for i in range(body_start, body_end):
            if work.inv_mass[worlds.bodies[i]] > 0.0:
                factor_body(worlds.bodies[i], h, model, work, rows)

        for sweep in range(iterations):
            for i in range(body_start, body_end):
                if work.inv_mass[worlds.bodies[i]] > 0.0:
                    sweep_body(
                        worlds.bodies[i], sweep > 0, False, 0.0, h, model, work, rows
                    )
        finish_rows(world, 1 - history.parity[world], work, rows, worlds, history)
        history.parity[world] = 1 - history.parity[world]

        for i in range(body_start, body_end):
            body = worlds.bodies[i]
            velocity = body_qd[body]
            if work.inv_mass[body] > 0.0:
                increment = work.increment[body]
                new_velocity = increment / h
                if wp.static(effects.gyroscopic):
                    new_velocity += wp.spatial_vector(wp.vec3(0.0), work.spin_gain[body])
                # how much of the free acceleration came through: the next step's first guess
                free = wp.spatial_top(work.target[body]) - h * wp.spatial_top(velocity)
                got = wp.spatial_top(increment) - h * wp.spatial_top(velocity)
                history.falling[body] = wp.clamp(
                    wp.dot(got, free) / wp.max(wp.dot(free, free), 1.0e-30), 0.0, 1.0
                )
                body_qd_out[body] = new_velocity
            else:
                body_qd_out[body] = velocity

        slop = SLOP_SHARE * gravity * h * h
        if deepest > slop:
            for i in range(body_start, body_end):
                if work.inv_mass[worlds.bodies[i]] > 0.0:
                    sweep_body(worlds.bodies[i], False, True, slop, h, model, work, rows)

        for i in range(body_start, body_end):
            body = worlds.bodies[i]
            if work.inv_mass[body] > 0.0:
                body_q_out[body] = moved_pose(body_q[body], model.com[body], work.increment[body])
            else:
                body_q_out[body] = body_q[body]

    return solve
