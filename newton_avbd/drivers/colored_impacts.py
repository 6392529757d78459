# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Restitution in large worlds: the rounds of :mod:`.step.impacts`, by a block of threads a world.

How many rounds there are, and sweeps of each, turns out on the device, and most steps have none; so
one launch takes them all. In a round a body that owns rows which take part strikes those on the
other side of them. Bodies that strike at once must have none in common, which two of a color may
have; so the bodies that strike are divided anew in each round, into *waves* that are independent
sets: those come first that are of the highest priority among all that strike what they strike, then
likewise of those that are left (Jones, Plassmann, 1993). A sweep goes wave by wave: it is one
Gauss-Seidel sweep, in the order of the waves.
"""

import warp as wp

from ..data import RowWork, Solver
from ..functions import Functions
from ..step.impacts import (
    ROUNDS,
    SETTLE,
    begin_impacts,
    begin_rounds,
    continue_impacts,
    leave_impacts,
    noise_of,
    strike,
    threshold_of,
)
from ..step.kernels import KernelDecorator
from .barrier import any_thread

_STILL = wp.constant(-1)
"""Wave of a body that strikes none in the round."""
_WAITING = wp.constant(-2)
"""Wave of a body that has none yet."""


@wp.func
def claim(body: int, s: wp.ref[Solver]) -> bool:
    """Claims a body and all that it strikes in the round; returns whether there is one.

    Of several claims that of the highest priority holds.
    """
    priority = s.colors.priority[body]
    is_striking = bool(False)
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        if s.rows.impacts[i].goal >= 0.0:
            wp.atomic_max(s.colors.count, s.rows.rows[i].b, priority)
            is_striking = True
    if is_striking:
        wp.atomic_max(s.colors.count, body, priority)
    return is_striking


@wp.func
def has_claimed(body: int, s: wp.ref[Solver]) -> bool:
    """Whether all claims of a body hold. What does not move can be struck by many at once."""
    priority = s.colors.priority[body]
    result = bool(s.colors.count[body] == priority)
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        other = s.rows.rows[i].b
        if s.rows.impacts[i].goal >= 0.0 and s.work.inv_mass[other] > 0.0:
            result = result and s.colors.count[other] == priority
    return result


@wp.func
def give_up(body: int, s: wp.ref[Solver]):
    """Gives the claims of a body up that has its wave; nobody else takes them for his."""
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        if s.rows.impacts[i].goal >= 0.0:
            s.colors.count[s.rows.rows[i].b] = -1
    s.colors.count[body] = -1


@wp.func
def divide(
    thread: int, threads: int, first: int, end: int, wave: wp.array[wp.int32], s: wp.ref[Solver]
) -> int:
    """Divides the bodies of a world that strike in the round into waves; returns how many."""
    for i in range(first + thread, end, threads):
        body = s.worlds.bodies[i]
        s.colors.count[body] = -1
        wave[body] = _WAITING
    waves = int(0)
    left = any_thread(1)
    while left != 0:
        for i in range(first + thread, end, threads):
            body = s.worlds.bodies[i]
            if wave[body] == _WAITING:
                if not claim(body, s):
                    wave[body] = _STILL
        any_thread(0)
        left = int(0)
        for i in range(first + thread, end, threads):
            body = s.worlds.bodies[i]
            if wave[body] == _WAITING:
                if has_claimed(body, s):
                    wave[body] = waves
                    give_up(body, s)
                else:
                    left = int(1)
        left = any_thread(left)
        waves += 1
    return waves


def make_colored_impacts(impacts: Functions, kernel: KernelDecorator) -> None:
    """The kernels, made by the decorator ``kernel``."""
    end_body_rounds = impacts.end_rounds

    @kernel()
    def begin_all_rounds(
        # State in:
        body_qd: wp.array[wp.spatial_vector],
        # Work out:
        rows: RowWork,
    ):
        """Nothing has struck a body yet; one thread a body."""
        begin_rounds(wp.tid(), body_qd, rows)

    @kernel()
    def find_impacts(s: wp.array[Solver]):
        """Rows that a body owns and that close in this step; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        if s[0].colors.is_finite[world] == 1:
            side = 1 - s[0].history.parity[world]
            if begin_impacts(body, side, s[0].colors.scale[world], s[0]):
                s[0].colors.has_impacts[world] = 1

    @kernel()
    def strike_worlds(threads: int, wave: wp.array[wp.int32], s: wp.array[Solver]):
        """Lets the impacts go through a world, in rounds; ``threads`` a world, which is a block."""
        world = wp.tid() / threads
        thread = wp.tid() % threads
        if s[0].colors.has_impacts[world] == 1:
            scale = s[0].colors.scale[world]
            h = scale.h
            noise = noise_of(scale)
            threshold = threshold_of(scale)
            first = s[0].worlds.body_start[world]
            end = s[0].worlds.body_start[world + 1]
            is_active = int(1)
            rounds = int(0)
            while is_active != 0 and rounds < ROUNDS:
                waves = divide(thread, threads, first, end, wave, s[0])
                is_moving = int(1)
                sweeps = int(0)
                while is_moving != 0 and sweeps < SETTLE:
                    change = float(0.0)
                    for turn in range(waves):
                        for i in range(first + thread, end, threads):
                            body = s[0].worlds.bodies[i]
                            if wave[body] == turn:
                                change = wp.max(change, strike(body, h, s[0]))
                        any_thread(0)
                    is_moving = any_thread(wp.where(change > noise, 1, 0))
                    sweeps += 1
                is_active = int(0)
                for i in range(first + thread, end, threads):
                    if continue_impacts(s[0].worlds.bodies[i], threshold, h, s[0]):
                        is_active = int(1)
                is_active = any_thread(is_active)
                rounds += 1

    @kernel()
    def end_rounds(s: wp.array[Solver]):
        """Where bodies start from, and how their rows are to part; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        if s[0].colors.has_impacts[world] == 1:
            end_body_rounds(body, s[0].colors.scale[world], s[0])

    @kernel()
    def leave_all_impacts(s: wp.array[Solver]):
        """Puts bodies to where their rebounds are; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        if s[0].colors.has_impacts[world] == 1:
            leave_impacts(body, s[0].colors.scale[world], s[0])
