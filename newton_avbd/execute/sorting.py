# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Contacts by owner as :func:`.contacts.make_sort_by_owner` sorts them, by many threads: for GPUs.

The lists are the same, each in the order of the contact buffer; where they begin follows the order
of the bodies in the model.
"""

import warp as wp

from ..data import BodyWork, ContactInput, RowWork, ShapeModel, WorldWork
from .coloring import sort_part
from .contacts import find_owner
from .launch import KERNEL, Launcher
from .scan import scan


@wp.kernel(**KERNEL)
def clear_counts(
    # Work out:
    rows: RowWork,
):
    """Nothing is counted yet; one thread a body."""
    body = wp.tid()
    rows.owned_end[body] = 0
    rows.other_end[body] = 0


@wp.kernel(**KERNEL)
def count_by_owner(
    # Model:
    shapes: ShapeModel,
    # Contacts in:
    contacts: ContactInput,
    # Work:
    worlds: WorldWork,
    work: BodyWork,
    # Work out:
    rows: RowWork,
):
    """How many contacts each body owns, and how many others own; one thread a place in the buffer.

    ``owned_end`` and ``other_end`` hold the counts.
    """
    contact = wp.tid()
    count = contacts.count[0]
    if contact == 0:
        worlds.overflow[0] = wp.max(worlds.overflow[0], count - contacts.capacity)
    a = int(-1)
    b = int(-1)
    if contact < count:
        a, b = find_owner(contact, shapes, contacts, worlds, work)
    rows.owner[contact] = a
    if a >= 0:
        wp.atomic_add(rows.owned_end, a, 1)
        if work.inv_mass[b] > 0.0:
            wp.atomic_add(rows.other_end, b, 1)


@wp.kernel(**KERNEL)
def list_by_owner(
    # Work out:
    rows: RowWork,
):
    """Lists the contacts of each owner, in no order; one thread a place in the buffer."""
    contact = wp.tid()
    owner = rows.owner[contact]
    if owner >= 0:
        left = wp.atomic_add(rows.owned_end, owner, -1)
        rows.contacts[rows.owned_start[owner + 1] - left] = contact


@wp.kernel(**KERNEL)
def order_lists(
    # Work out:
    rows: RowWork,
):
    """Puts the contacts of each owner in order; one thread a body."""
    body = wp.tid()
    start = rows.owned_start[body]
    end = rows.owned_start[body + 1]
    sort_part(rows.contacts, start, end)
    rows.owned_end[body] = end
    rows.other_end[body] = rows.other_start[body]


def sort_at_once(
    launch: Launcher,
    shapes: ShapeModel,
    contacts: ContactInput,
    worlds: WorldWork,
    work: BodyWork,
    rows: RowWork,
) -> None:
    """Sorts all contacts by owner, in ten launches."""
    bodies = worlds.bodies.shape[0]
    launch(clear_counts, bodies, [rows])
    if contacts.capacity:
        launch(count_by_owner, contacts.capacity, [shapes, contacts, worlds, work, rows])
    scan(launch, rows.owned_end, bodies, rows.sums, rows.owned_start)
    scan(launch, rows.other_end, bodies, rows.sums, rows.other_start)
    if contacts.capacity:
        launch(list_by_owner, contacts.capacity, [rows])
    launch(order_lists, bodies, [rows])
