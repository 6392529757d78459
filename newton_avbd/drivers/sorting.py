# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Contacts sorted by owner with many threads, for GPUs.

The lists are those of :func:`.step.contacts.make_sort_by_owner`, each in the order of the contact
buffer; where they begin follows the order of the bodies in the model.
"""

from typing import Any

import warp as wp

from ..data import Context, RowWork, Solver, Step
from ..step.contacts import find_owner
from ..step.kernels import KERNEL
from .coloring import sort_part
from .launch import Launcher
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
def count_by_owner(step: Step, s: wp.array[Solver]):
    """How many contacts each body owns, and how many others own; one thread a place in the buffer.

    ``owned_end`` and ``other_end`` hold the counts.
    """
    contact = wp.tid()
    count = step.contacts.count[0]
    if contact == 0:
        s[0].worlds.overflow[0] = wp.max(s[0].worlds.overflow[0], count - step.contacts.capacity)
    a = int(-1)
    b = int(-1)
    if contact < count:
        a, b = find_owner(contact, step, s[0])
    s[0].rows.owner[contact] = a
    if a >= 0:
        wp.atomic_add(s[0].rows.owned_end, a, 1)
        if s[0].work.inv_mass[b] > 0.0:
            wp.atomic_add(s[0].rows.other_end, b, 1)


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


def sort_at_once(launch: Launcher, step: Any, context: Context, capacity: int) -> None:
    """Sorts all contacts by owner, in ten launches."""
    bodies, rows = context.worlds.bodies.shape[0], context.rows
    launch(clear_counts, bodies, [rows])
    if capacity:
        launch(count_by_owner, capacity, [step, context])
    scan(launch, rows.owned_end, bodies, rows.sums, rows.owned_start)
    scan(launch, rows.other_end, bodies, rows.sums, rows.other_start)
    if capacity:
        launch(list_by_owner, capacity, [rows])
    launch(order_lists, bodies, [rows])
