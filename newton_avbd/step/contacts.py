# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""From Newton's contact buffer to the rows of a world: sorted by owner, found again, linearised."""

import functools

import warp as wp

from ..algebra.so3 import exp_quat
from ..data import (
    BodyWork,
    ContactInput,
    ContactRecord,
    ContactRow,
    History,
    RowWork,
    ShapeModel,
    Solver,
    SpinRow,
    Step,
    WorldScale,
    WorldWork,
)
from ..effects import Effects
from ..functions import Functions, together
from ..rows import condim as condim_rows
from ..rows import contact as contact_rows
from ..rows import ramp as ramp_rows
from ..rows import spin as spin_rows
from .bodies import body_at
from .crossing import SLICK, as_balls, has_long_lever
from .ellipsoids import farthest_point, touching_normal
from .gathering import is_followed, is_same_block, is_visited_first
from .kernels import KERNEL, uncollected
from .needles import is_needle, off_axes
from .piles import mass_to_hold
from .rolling import make_point_moves, moves_levers, rolled_point, share_of_point
from .sides import make_written_side
from .weights import mass_to_stop

NOT_UNIT = wp.constant(0.1)
"""Squared length of a normal, less 1, that no detection means."""
FAR = wp.constant(0.2)
"""An anchor that moved more than this share of its lever arm is another contact's."""
TURNING = wp.constant(1.0e-3)
"""Turn of a link in a step from which what two links of its tree push each other with is not as in
the last step [rad]."""
BRACING = wp.constant(0.2)
"""Share of it from which such contacts start. Joints and friction brace links against each other by
any force that the last impact left, and what rounds their turn lets that force do work."""


def make_surface_shift(effects: Effects) -> wp.Function:
    """Device function: how far the surface at a contact moves."""

    @wp.func
    def surface_shift(
        row: ContactRow,
        arm: wp.vec3,
        h: float,
        share: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> wp.vec3:
        """How far a surface moves along a contact in a step, beside its body [m].

        Args:
            row: The contact.
            arm: From the COM of b to it [m].
            h: Time step [s].
            share: Of how far a body has been put that ``work.put`` stands for.
            step: What the step was given.
            s: The solver.
        """
        shift = wp.vec3(0.0)
        if wp.static(effects.moving_surfaces):
            contact = wp.where(row.contact >= 0, row.contact, ~row.contact)
            moved = h * step.contacts.surface_velocity[contact]
            shift = wp.where(row.contact >= 0, moved, -moved)
        if wp.static(effects.put_bodies):
            shift += contact_rows.carried_along(s.work.put[row.b], arm) / share
        return shift - row.normal * wp.dot(row.normal, shift)

    return surface_shift


@wp.func
def body_slot(shapes: wp.ref[ShapeModel], shape: int, static_slot: int) -> int:
    """Slot of the body that carries a shape; the static world for a shape without a body."""
    body = shapes.body[shape]
    return wp.where(body < 0, static_slot, body)


@wp.func
def point_on(shapes: wp.ref[ShapeModel], shape: int, point: wp.vec3) -> wp.vec3:
    """A point in the frame of a shape's link, in the frame of the body that the link is part of."""
    return wp.transform_point(shapes.frame[shape], point)


@wp.func
def owner_of(slot0: int, slot1: int, s: wp.ref[Solver]) -> int:
    """Slot of the body of a contact that is visited first; -1 when the solver moves neither.

    It does the dual update, so the other one has to feel the force after that.
    """
    moves0 = s.work.inv_mass[slot0] > 0.0
    moves1 = s.work.inv_mass[slot1] > 0.0
    if slot0 == slot1:
        return -1
    if moves0 and moves1:
        return wp.where(is_visited_first(s.worlds, slot0, slot1), slot0, slot1)
    if moves0:
        return slot0
    return wp.where(moves1, slot1, -1)


@wp.func
def is_across(slot0: int, slot1: int, s: wp.ref[Solver]) -> bool:
    """Whether a contact is between bodies of two worlds, which cannot meet."""
    both_move = s.work.inv_mass[slot0] > 0.0 and s.work.inv_mass[slot1] > 0.0
    return both_move and s.worlds.of_body[slot0] != s.worlds.of_body[slot1]


@wp.func
def report_dropped(worlds: wp.ref[WorldWork], contact: int):
    """Counts a contact that makes no sense, and says so once."""
    if wp.atomic_add(worlds.dropped, 0, 1) == 0:
        wp.printf(
            "SolverAVBD: contact %d is left out: its shapes are not those of a pair in a world of "
            "the model, its numbers are not finite, or it has no normal\n",
            contact,
        )


CLOSED = wp.constant(2.5e-7)
"""Gap that rounding may have opened, as a share of the size of the numbers that it is found from:
about four units in the last place of one of them."""


@wp.func
def is_sound(row: ContactRow) -> bool:
    """Whether a row is at a finite place and its normal of unit length."""
    return wp.isfinite(row.gap) and wp.abs(wp.dot(row.normal, row.normal) - 1.0) < NOT_UNIT


@wp.func(inline=True)  # a call would copy all that it takes, for each contact
def find_owner(contact: int, step: wp.ref[Step], s: wp.ref[Solver]):
    """Slot of the body that owns a contact, -1 without, and of the other one."""
    static_slot = s.work.inv_mass.shape[0] - 1
    shape0 = step.contacts.shape0[contact]
    shape1 = step.contacts.shape1[contact]
    if wp.min(shape0, shape1) < 0 or wp.max(shape0, shape1) >= s.shapes.body.shape[0]:
        report_dropped(s.worlds, contact)
        return -1, static_slot
    slot0 = body_slot(s.shapes, shape0, static_slot)
    slot1 = body_slot(s.shapes, shape1, static_slot)
    if is_across(slot0, slot1, s):
        report_dropped(s.worlds, contact)
        return -1, static_slot
    a = owner_of(slot0, slot1, s)
    return a, slot0 + slot1 - a


@functools.cache
def make_sort_by_owner(sleeping: bool = False) -> wp.Function:
    """Device function: makes room for the rows of each body."""

    @wp.func
    def sort_by_owner(step: wp.ref[Step], s: wp.ref[Solver]):
        """Counting sort of the contacts by owner, in the order of the buffer.

        Makes room for the rows: afterwards ``owned_start`` and ``owned_end`` enclose a
        body's contacts in ``rows.contacts``, and ``other_start`` = ``other_end`` is where the rows
        that others own will be listed.
        """
        static_slot = s.work.inv_mass.shape[0] - 1
        count = wp.min(step.contacts.count[0], step.contacts.capacity)
        s.worlds.overflow[0] = wp.max(
            s.worlds.overflow[0], step.contacts.count[0] - step.contacts.capacity
        )
        listed = static_slot
        if wp.static(sleeping):
            count = s.rows.awake_count[0]
            listed = s.worlds.body_start[s.worlds.island_start[s.worlds.island_start.shape[0] - 1]]
        for i in range(listed):
            body = body_at(i, s.worlds)
            s.rows.owned_end[body] = 0
            s.rows.other_end[body] = 0
        for k in range(count):
            contact = int(k)
            if wp.static(sleeping):
                contact = s.rows.awake[k]
            a, b = find_owner(contact, step, s)
            if wp.static(sleeping):
                # they may have fallen asleep just now
                if a >= 0 and wp.max(s.worlds.island[a], s.worlds.island[b]) >= 0:
                    a = int(-1)
            s.rows.owner[contact] = a
            if a >= 0:
                s.rows.owned_end[a] = s.rows.owned_end[a] + 1
                if s.work.inv_mass[b] > 0.0:
                    s.rows.other_end[b] = s.rows.other_end[b] + 1
        owned = int(0)
        other = int(0)
        for i in range(listed):
            body = body_at(i, s.worlds)
            owned_count = s.rows.owned_end[body]
            other_count = s.rows.other_end[body]
            s.rows.owned_start[body] = owned
            s.rows.owned_end[body] = owned
            s.rows.other_start[body] = other
            s.rows.other_end[body] = other
            owned += owned_count
            other += other_count
        for k in range(count):
            contact = int(k)
            if wp.static(sleeping):
                contact = s.rows.awake[k]
            a = s.rows.owner[contact]
            if a >= 0:
                s.rows.contacts[s.rows.owned_end[a]] = contact
                s.rows.owned_end[a] = s.rows.owned_end[a] + 1

    return sort_by_owner


@functools.cache
@uncollected()
def make_sort_contacts(sleeping: bool = False) -> wp.Kernel:
    """Kernel, one thread: what :func:`make_sort_by_owner` does."""
    sort_by_owner = make_sort_by_owner(sleeping)

    @wp.kernel(**KERNEL)
    def sort_contacts(step: Step, s: wp.array[Solver]):
        sort_by_owner(step, s[0])

    return sort_contacts


@wp.func
def body_arm(slot: int, static_slot: int, point: wp.vec3, s: wp.ref[Solver]) -> wp.vec3:
    """From the COM of a body to a point given in its frame, in world axes [m]."""
    if slot == static_slot:
        return point
    return wp.quat_rotate(wp.transform_get_rotation(s.work.pose[slot]), point - s.model.com[slot])


@wp.func
def anchor_distance(a: ContactRecord, b: ContactRecord) -> float:
    """Squared distance of two contacts of the same shapes [m^2].

    A contact that slides stays put on one of its two shapes: that one counts. The other decides
    between contacts that share a point, such as the centre of a sphere in a groove.
    """
    on0 = wp.length_sq(a.point0 - b.point0)
    on1 = wp.length_sq(a.point1 - b.point1)
    return wp.min(on0, on1) + 1.0e-3 * wp.max(on0, on1)


@wp.func
def find_row(record: ContactRecord, start: int, end: int, side: int, s: wp.ref[Solver]) -> int:
    """Row of a remembered contact, -1 when there is none.

    That is the nearest anchor of the same two shapes, if it is near for the row's lever arm.
    """
    found = int(-1)
    best = float(wp.inf)
    for i in range(start, end):
        if (
            s.history.records[side, i].shape0 == record.shape0
            and s.history.records[side, i].shape1 == record.shape1
        ):
            distance = anchor_distance(s.history.records[side, i], record)
            if distance < best:
                if distance < FAR * FAR * wp.length_sq(s.rows.rows[i].arm):
                    found = i
                    best = distance
    return found


@wp.func
def is_matched(history: wp.ref[History], world: int, contacts: wp.ref[ContactInput]) -> bool:
    """Whether the pipeline's contact matching speaks of the contacts that are remembered."""
    filling = history.filling[world, 1]
    return history.filling[world, 0] == contacts.buffer and (
        filling == contacts.generation[0] or filling == contacts.match_generation[0]
    )


@wp.func
def matched_record(
    history: wp.ref[History],
    side: int,
    world: int,
    body: int,
    contacts: wp.ref[ContactInput],
    contact: int,
) -> int:
    """Record that the pipeline's contact matching names, -1 for a new contact."""
    known = int(contact)
    if history.filling[world, 1] != contacts.generation[0]:
        known = contacts.match_index[contact]
    if known < 0 or known >= history.row_of_contact.shape[1]:
        return -1
    record = history.row_of_contact[side, known]
    # the owner may have changed since, when bodies start or stop to move
    if record < history.start[side, body] or record >= history.end[side, body]:
        return -1
    return record


@wp.func
def override(value: float, default: float) -> float:
    """A contact's own material value, or the default where it has none (zero)."""
    return wp.where(value > 0.0, value, default)


@wp.func
def size_of(work: wp.ref[BodyWork], slot: int, arm: wp.vec3) -> float:
    """How large a body is about a point on its surface [m]: its lever arm and radius of gyration.

    What the solver does not move has no size that matters.
    """
    if work.inv_mass[slot] == 0.0:
        return wp.inf
    return wp.length(arm) + wp.sqrt(wp.trace(work.inertia[slot]) * work.inv_mass[slot])


@functools.cache
def make_linearise_rows(effects: Effects) -> wp.Function:
    """Device function that turns the contacts of a body into rows."""
    written_side = make_written_side(effects)

    @wp.func
    def linearise(
        body: int,
        contact: int,
        record: ContactRecord,
        static_slot: int,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> ContactRow:
        """The row of a contact that ``body`` owns, at the poses in state_in."""
        slot0 = body_slot(s.shapes, record.shape0, static_slot)
        slot1 = body_slot(s.shapes, record.shape1, static_slot)
        normal = step.contacts.normal[contact]
        margin0 = step.contacts.margin0[contact]
        margin1 = step.contacts.margin1[contact]
        # Round shapes: the point is their centre, the radius is in the margin. Taking the surface
        # along the normal, not along the turned offset, lets a sphere roll.
        point0 = record.point0
        point1 = record.point1
        if wp.static(effects.ellipsoids):
            if wp.length_sq(normal) == 0.0:
                normal = touching_normal(record, slot0, slot1, static_slot, s)
                point0 = farthest_point(record.shape0, slot0, static_slot, point0, normal, s)
                point1 = farthest_point(record.shape1, slot1, static_slot, point1, -normal, s)
        if wp.static(effects.cylinders):
            if s.work.inv_mass[slot0] > 0.0:
                rotation0 = wp.transform_get_rotation(s.work.pose[slot0])
                point0 = rolled_point(record.shape0, rotation0, point0, normal, s.shapes)
            if s.work.inv_mass[slot1] > 0.0:
                rotation1 = wp.transform_get_rotation(s.work.pose[slot1])
                point1 = rolled_point(record.shape1, rotation1, point1, -normal, s.shapes)
        arm0 = body_arm(slot0, static_slot, point0, s)
        arm1 = body_arm(slot1, static_slot, point1, s)
        apart = (s.work.com[slot1] - s.work.com[slot0]) + (arm1 - arm0)
        # both bodies feel the force at one point, half way between the two surfaces
        half = 0.5 * (apart + (margin0 - margin1) * normal)
        # but where they have moved on since they were found: there one took it along
        aside = apart - wp.dot(apart, normal) * normal
        half += (share_of_point(record, slot0, slot1, s) - 0.5) * aside
        row = ContactRow()
        row.gap = wp.dot(normal, apart) - (margin0 + margin1)
        if wp.static(effects.contact_pairs):
            row.gap -= condim_rows.margin_beyond(s.shapes, record.shape0, record.shape1)
        if wp.static(not effects.compliance and not effects.ramp):
            # closing what rounding has opened would be felt as a velocity
            size = wp.length(s.work.com[slot0]) + wp.length(s.work.com[slot1])
            size += wp.length(arm0) + wp.length(arm1)
            if row.gap > 0.0 and row.gap < CLOSED * size:
                row.gap = 0.0
        if row.gap < 0.0:
            size0 = size_of(s.work, slot0, arm0 + margin0 * normal)
            size1 = size_of(s.work, slot1, arm1 - margin1 * normal)
            # Of a body that lies deeper than it is large nobody knows how it got there. Half way up
            # friction would have a lever of the depth, and recovery would turn what it lifts.
            beyond = -row.gap - wp.min(size0, size1)
            if beyond > 0.0:
                half += (wp.where(size0 < size1, 0.5, -0.5) * beyond) * normal
                if wp.static(not effects.compliance and not effects.ramp):
                    row.gap += beyond
        row.a = body
        if body == slot0:
            row.b = slot1
            row.contact = contact
            row.normal = normal
            row.arm = arm0 + half
        else:
            row.b = slot0
            row.contact = ~contact
            row.normal = -normal
            row.arm = arm1 - (apart - half)
        return row

    @wp.func
    def linearise_rows(
        world: int, body: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]
    ):
        """Turns the contacts that a body owns into rows, without those that cannot close."""
        side = s.history.parity[world]
        written = written_side(world, s.history)
        index = int(s.rows.owned_start[body])
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            contact = s.rows.contacts[i]
            record = ContactRecord()
            record.shape0 = step.contacts.shape0[contact]
            record.shape1 = step.contacts.shape1[contact]
            record.point0 = step.contacts.point0[contact]
            record.point1 = step.contacts.point1[contact]
            if wp.static(effects.welds):
                record.point0 = point_on(s.shapes, record.shape0, record.point0)
                record.point1 = point_on(s.shapes, record.shape1, record.point1)
            row = linearise(body, contact, record, scale.static_slot, step, s)
            if wp.static(effects.matching):
                s.history.row_of_contact[written, contact] = -1
            if not is_sound(row):
                report_dropped(s.worlds, contact)
                continue
            # Out of reach of what the two bodies and all others do in this step?
            gap = row.gap
            if gap > scale.reach:
                span = s.work.com[body] - s.work.com[row.b]
                u = contact_rows.slip(row, s.work.target[body], s.work.target[row.b], span)
                gap += wp.min(wp.dot(row.normal, u), 0.0)
            if gap <= scale.reach:
                if wp.dot(row.normal, row.arm) - 0.5 * row.gap < scale.reach:
                    row = as_balls(row, record, step, s)
                    if has_long_lever(row, s):
                        row.mu = SLICK
                if wp.static(effects.angular_friction):
                    spin = SpinRow()
                if wp.static(effects.matching):
                    if is_matched(s.history, world, step.contacts):
                        known = matched_record(s.history, side, world, body, step.contacts, contact)
                        if known >= 0:
                            row.force = s.history.records[side, known].force
                            record.penalty = s.history.records[side, known].penalty
                            if wp.static(effects.angular_friction):
                                spin.torque = s.history.torque[side, known]
                if wp.static(effects.angular_friction):
                    s.rows.spin[index] = spin
                s.rows.rows[index] = row
                s.history.records[written, index] = record
                if wp.static(effects.pairs):
                    if s.work.inv_mass[row.b] > 0.0:
                        other = wp.atomic_add(s.rows.other_end, row.b, 1)
                        s.rows.other_rows[other] = index
                index += 1
        s.rows.owned_end[body] = index

    return linearise_rows


@wp.func
def braces_tree(row: ContactRow, s: wp.ref[Solver]) -> bool:
    """Whether a row is between two links of one tree, and one of them turns."""
    if not is_same_block(s.worlds, row.a, row.b):
        return False
    turn_a = wp.length_sq(wp.spatial_bottom(s.work.target[row.a]))
    turn_b = wp.length_sq(wp.spatial_bottom(s.work.target[row.b]))
    return wp.max(turn_a, turn_b) > TURNING * TURNING


@functools.cache
def make_rows(effects: Effects) -> Functions:
    """Device functions that build the rows of a body, and give them their penalties."""
    mixed_friction = contact_rows.FRICTION_MIXES[effects.friction_mix]
    mixed_by_condim = condim_rows.make_mixed_friction(effects.friction_mix, effects.contact_pairs)
    linearise_rows = make_linearise_rows(effects)
    surface_shift = make_surface_shift(effects)
    point_moves = make_point_moves(effects)
    written_side = make_written_side(effects)

    @wp.func
    def recall_multipliers(world: int, body: int, s: wp.ref[Solver]):
        """Hands what is remembered of the last step to the rows of the same contacts.

        Each record serves once and looks for its row, not the other way round: so no load is used
        twice, contacts that merge add up, and the order of the contacts does not matter.
        """
        side = s.history.parity[world]
        written = written_side(world, s.history)
        start = s.rows.owned_start[body]
        for i in range(s.history.start[side, body], s.history.end[side, body]):
            record = s.history.records[side, i]
            row = int(-1)
            if wp.static(effects.ramp) or wp.length_sq(record.force) > 0.0:
                row = find_row(record, start, s.rows.owned_end[body], written, s)
            if row >= 0:
                if wp.static(effects.ramp):
                    s.history.records[written, row].penalty = wp.max(
                        s.history.records[written, row].penalty, record.penalty
                    )
                else:
                    s.rows.rows[row].force = s.rows.rows[row].force + record.force
                    if wp.static(effects.angular_friction):
                        torque = s.rows.spin[row].torque + s.history.torque[side, i]
                        s.rows.spin[row].torque = torque

    @wp.func
    def drift_along(
        row: ContactRow, arm: wp.vec3, h: float, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> wp.vec3:
        """How far what counts as no slip moves along a contact in a step [m]; ``arm`` on b."""
        bent = 0.5 * contact_rows.bent_way(s.work.target[row.a], s.work.target[row.b])
        bent -= row.normal * wp.dot(row.normal, bent)
        return surface_shift(row, arm, h, 1.0, step, s) + bent

    @wp.func
    def penalise_rows(
        world: int, body: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> float:
        """Gives a body's own rows their penalties; returns their deepest penetration [m]."""
        side = written_side(world, s.history)
        deepest = float(0.0)
        turn = wp.spatial_bottom(s.work.increment[body])
        has_turned = moves_levers(turn)
        if wp.static(effects.needles):
            has_turned = has_turned and not is_needle(body, wp.inf, s)
        half = exp_quat(0.5 * turn)
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            row = s.rows.rows[i]
            record = s.history.records[side, i]
            contact = wp.where(row.contact >= 0, row.contact, ~row.contact)
            if wp.dot(row.normal, row.force) <= 0.0:
                row.force = wp.vec3(0.0)
            if wp.static(effects.bracing):
                if braces_tree(row, s):
                    row.force = BRACING * row.force
            if wp.static(effects.needles):
                row.arm = row.arm - off_axes(row, s)
            if wp.static(not effects.ramp):
                if has_turned:
                    # a force does no work on a point that stays, by its lever of half the step
                    row.arm = row.arm + point_moves(row, record, half, s)
            is_slick = row.mu < 0.0
            row.mu = 0.0
            if wp.static(effects.condim):
                friction = mixed_by_condim(s.shapes, record.shape0, record.shape1)
            if wp.static(effects.friction):
                if wp.static(effects.condim):
                    row.mu = friction[0]
                else:
                    row.mu = mixed_friction(s.shapes.mu[record.shape0], s.shapes.mu[record.shape1])
                if wp.static(effects.contact_materials):
                    row.mu *= override(step.contacts.friction[contact], 1.0)
                row.mu = wp.where(is_slick, 0.0, row.mu)
            span = s.work.com[body] - s.work.com[row.b]
            u = contact_rows.slip(row, s.work.target[body], s.work.target[row.b], span)
            if wp.static(effects.drift):
                drift = drift_along(row, row.arm + span, scale.h, step, s)
                s.rows.drift[i] = drift
                u += drift
            stiffness = float(0.0)
            damping = float(0.0)
            if wp.static(effects.ramp or effects.compliance):
                stiffness = 0.5 * (s.shapes.ke[record.shape0] + s.shapes.ke[record.shape1])
                damping = 0.5 * (s.shapes.kd[record.shape0] + s.shapes.kd[record.shape1])
                if wp.static(effects.contact_materials):
                    stiffness = override(step.contacts.stiffness[contact], stiffness)
                    damping = override(step.contacts.damping[contact], damping)
            if wp.static(effects.ramp):
                row.k_n = ramp_rows.warm_penalty(record.penalty, stiffness)
                s.rows.stiffness[i] = stiffness
                s.rows.damping[i] = damping
            else:
                inv_mass = s.work.inv_mass[body] + s.work.inv_mass[row.b]
                inv_a, inv_b = s.work.inv_inertia[body], s.work.inv_inertia[row.b]
                mass = contact_rows.effective_mass(
                    row.normal, row.arm, row.arm + span, inv_mass, inv_a, inv_b
                )
                load = contact_rows.carried_mass(row, scale)
                sliding = float(0.0)
                if wp.static(effects.friction):
                    sliding = contact_rows.sliding_mass(row, span, inv_mass, inv_a, inv_b)
                held = float(0.0)
                if wp.static(effects.piles):
                    held = mass_to_hold(row, s)
                if wp.static(effects.light_links):
                    # A contact that stays open between links that move at once holds nothing.
                    if contact_rows.may_push(row, u) or not is_same_block(s.worlds, body, row.b):
                        held = wp.max(held, mass_to_stop(row, span, s))
                if wp.static(effects.joints):
                    # a tree takes what it carries into account itself: no sweep tells of that
                    if s.work.inv_mass[row.b] == 0.0 and s.tree.joint[body] >= 0:
                        held = wp.max(held, load)
                if wp.static(effects.compliance):
                    row, share = contact_rows.comply(
                        row, wp.max(mass, held), load, sliding, u, stiffness, damping, scale
                    )
                    s.rows.share[i] = share
                else:
                    follows = bool(False)
                    if wp.static(effects.joints):
                        follows = is_followed(row, s)
                    row = contact_rows.penalise(row, mass, load, held, sliding, u, scale, follows)
                if wp.static(effects.angular_friction):
                    spin = s.rows.spin[i]
                    if wp.static(effects.condim):
                        spin.mu_twist = friction[1]
                        spin.mu_roll = friction[2]
                    else:
                        spin.mu_twist = mixed_friction(
                            s.shapes.mu_torsional[record.shape0],
                            s.shapes.mu_torsional[record.shape1],
                        )
                        spin.mu_roll = mixed_friction(
                            s.shapes.mu_rolling[record.shape0], s.shapes.mu_rolling[record.shape1]
                        )
                    turn = wp.spatial_bottom(s.work.target[row.b] - s.work.target[body])
                    if wp.static(effects.put_bodies):
                        turn += wp.spatial_bottom(s.work.put[row.b])
                    s.rows.spin[i] = spin_rows.penalise(
                        spin,
                        row.normal,
                        s.work.inv_inertia[body] + s.work.inv_inertia[row.b],
                        turn,
                        contact_rows.expected_force(row, mass, u, scale.h),
                        scale.h,
                    )
            s.rows.rows[i] = row
            if wp.static(effects.matching):
                s.history.row_of_contact[side, contact] = i
            deepest = wp.max(deepest, -row.gap)
        return deepest

    @wp.func
    def find_rows(world: int, body: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]):
        """Builds the rows that a body owns, with what is remembered of their forces."""
        linearise_rows(world, body, scale, step, s)
        if wp.static(effects.matching):
            if not is_matched(s.history, world, step.contacts):
                recall_multipliers(world, body, s)
        else:
            recall_multipliers(world, body, s)

    return together(find_rows, penalise_rows)


MOST_STIFFENED = wp.constant(1.0e3)
"""How many times stiffer a round makes a contact at most: forces that ask for more have diverged,
and stiffer contacts would have them diverge faster."""


@wp.func
def stiffen_rows(body: int, scale: WorldScale, rows: wp.ref[RowWork]):
    """Makes the rows that a body owns as stiff as an impact needs them.

    A force f that stops a speed v within the step says that a mass f h/v is behind the row: what
    joints, and contacts that hold a body which others pull apart, make it stop. Nothing tells that
    before the sweeps. v is the fastest of the world.
    """
    unit = contact_rows.PENALTY / wp.max(0.5 * scale.reach, 1.0e-30)
    for i in range(rows.owned_start[body], rows.owned_end[body]):
        row = rows.rows[i]
        k_n = wp.min(unit * wp.dot(row.normal, row.force), MOST_STIFFENED * row.k_n)
        if k_n > row.k_n and row.k_n > 0.0:
            rows.rows[i].k_t = row.k_t * (k_n / row.k_n)
            rows.rows[i].k_n = k_n
