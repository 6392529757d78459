# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Contacts of bodies that sleep: which there are, whether they change, and the loads that stay.

Contacts are told by marks, numbers that add up: two sums differ if a contact has come or gone.
"""

import warp as wp

from ..data import ContactInput, ContactRecord, Solver, Step
from ..effects import Effects
from .contacts import FAR, anchor_distance, body_arm, body_slot, point_on
from .islands import disturb
from .kernels import KERNEL
from .sleepers import AWAKE, MOVING


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
def is_asleep(contact: int, step: wp.ref[Step], s: wp.ref[Solver]):
    """Whether a contact is one of a body that sleeps."""
    static_slot = s.worlds.rank.shape[0] - 1
    a = body_slot(s.shapes, step.contacts.shape0[contact], static_slot)
    b = body_slot(s.shapes, step.contacts.shape1[contact], static_slot)
    return s.worlds.island[a] >= 0 or s.worlds.island[b] >= 0


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


def make_list_contacts(effects: Effects) -> wp.Function:
    """Device function: lists the contacts of what is awake, and sees whom they disturb."""

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

    return list_contacts


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
