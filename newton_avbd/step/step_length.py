# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Error control: how long the inner steps of a call are, by the errors of those before.

The controller is that of K. Gustafsson (1991): proportional and integral, in logarithms of errors.
"""

import warp as wp

from ..data import Solver
from .local_error import BY_JUMP, SAVED, UNSETTLED, Misstep
from .saving import restore_world

SPENT = wp.constant(0.5)
"""Share of the saved error that one step may spend, so that the next one has something left."""
AIM = wp.constant(0.8)
"""Share of the allowed error that a step aims at."""
INTEGRAL = wp.constant(0.7)
"""Exponents of the controller, by that of the step in errors a second: h^2, or h^4 of a step of
fourth order."""
PROPORTIONAL = wp.constant(0.4)
GROWTH = wp.constant(2.0)
"""How many times longer a step may be than the last one: second order needs the last one."""
MOST = wp.constant(8.0)
"""How many times longer steps are wanted at most than the last one, or than a call."""
SHRINKING = wp.constant(0.1)
"""How many times shorter, at least, a repeated one."""
BY_ROUNDING = wp.constant(1.0e-4)
"""Share of a step by which dividing what is left of a call may be off."""


FINEST = wp.constant(1.0 / 32.0)
"""Shortest step that finds a jump, as a share of those in which all that are left would be equal:
in still shorter ones what float32 rounds of a move counts as a velocity."""


@wp.struct
class Call:
    """A call of a world: how far it is, and the inner step that it is at."""

    left: float
    """What is left of it [s]."""
    h: float
    """Length of the inner step [s]."""
    parts: float
    """How many of these what is left takes."""
    share: float
    """What is left of it by the number of inner steps that are left [s]."""
    least: float
    """Length below which a step is not repeated [s]."""
    window: float
    """Time in which a jump is known to be [s]; 0 after a step in which one was, negative where none
    is known."""
    finest: float
    """Length of the step that finds it [s]."""
    tries: int
    steps: int
    spent: float
    """Error so far [m]."""
    worst: int
    """Body with the largest share of what was allowed, this share, and why."""
    worst_ratio: float
    why: int
    is_missed: bool


@wp.func
def choose_step(world: int, given: Call, s: wp.ref[Solver]) -> Call:
    """The next inner step: what is left of the call in equal parts."""
    call = given
    last_h = s.history.step[world]
    # what is left has to be done by the steps that are left
    room = wp.max(s.worlds.inner.budget - call.tries, 1)
    call.share = call.left / float(room)
    call.least = call.share
    if 2 * room > s.worlds.inner.budget:
        # half of them may find jumps, which may go on in the next one, and grow again from there
        if call.window >= 0.0:
            call.least = FINEST * call.share
        elif s.history.age[world] > 0:
            call.least = wp.min(call.least, last_h)
    h = wp.min(s.history.wanted[world], call.left)
    if s.history.age[world] > 0:
        h = wp.min(h, GROWTH * last_h)
    if call.window > 0.0:
        h = wp.min(h, wp.max(0.5 * call.window, call.finest))
    h = wp.max(h, call.least)
    call.parts = wp.ceil((1.0 - BY_ROUNDING) * call.left / h)
    if call.parts < 2.0:
        h = call.left
    elif call.window <= 0.0:
        h = call.left / call.parts
    call.h = h
    return call


@wp.func
def is_good(call: Call, made: Misstep, ratio: float, s: wp.ref[Solver]) -> bool:
    """Whether a step may stay: it is as accurate as it has to be, or is not to be shorter.

    A jump that would be within what may be saved is found; where that is spent already, shorter
    steps would not make up for it.
    """
    if ratio <= 1.0 or call.h <= 1.001 * call.least:
        return True
    is_found = made.is_jump and made.error <= SPENT * SAVED * s.worlds.inner.accuracy
    return is_found and call.h <= 1.001 * call.share


@wp.func
def try_shorter(world: int, given: Call, made: Misstep, ratio: float, s: wp.ref[Solver]) -> Call:
    """Once more, shorter; a step is at most what is left, so that there is an end."""
    call = given
    factor = AIM / ratio
    if made.order == 4:
        factor = wp.pow(factor, 0.25)
    elif not made.is_jump:
        factor = wp.sqrt(factor)
    elif s.history.age[world] > 1:
        call.window = call.h
        call.finest = factor * call.h
        factor = 0.5
    restore_world(world, s.worlds)
    s.history.wanted[world] = call.h * wp.clamp(factor, SHRINKING, 0.9)
    s.history.ratio[world] = 1.0
    return call


@wp.func
def choose_next(world: int, call: Call, made: Misstep, dt: float, aimed: float, s: wp.ref[Solver]):
    """What the next step is to be, by the error of this one as a share of what it aimed at."""
    now = wp.max(aimed, 1.0e-6)
    factor = wp.pow(now, -0.5)
    if made.order > 1:
        power = wp.where(made.order == 4, 0.25, 0.5)
        factor = wp.pow(now, -power * INTEGRAL)
        factor *= wp.pow(s.history.ratio[world] / now, power * PROPORTIONAL)
    wanted = call.h * wp.clamp(factor, SHRINKING, MOST)
    s.history.wanted[world] = wp.min(wanted, MOST * dt)
    s.history.ratio[world] = now


@wp.func
def account(world: int, given: Call, made: Misstep, ratio: float, s: wp.ref[Solver]) -> Call:
    """What a step that is accepted takes of the call, and of the errors that are allowed."""
    call = given
    accuracy = s.worlds.inner.accuracy
    call.steps += 1
    call.left -= call.h
    if call.parts < 2.0:
        call.left = 0.0
    call.spent += made.error
    saved = s.history.saved[world] + accuracy * call.h - made.error
    s.history.saved[world] = wp.clamp(saved, 0.0, SAVED * accuracy)
    if ratio > call.worst_ratio:
        call.worst_ratio = ratio
        call.worst = made.body
        call.why = wp.where(made.is_jump and made.cause != UNSETTLED, BY_JUMP, made.cause)
    if ratio > 1.0:
        call.is_missed = True
    call.window = wp.where(made.is_jump, 0.0, call.window - call.h)
    return call
