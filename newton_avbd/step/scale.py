# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How far things may go in a step, what counts as rest, and how many sweeps a step may take."""

import warp as wp

from ..data import Solver, WorldScale
from ..effects import Effects
from .bodies import body_at

SLOP_SHARE = wp.constant(0.05)
"""Penetration that is left alone, as a share of g h^2: touching contacts go on touching."""
MOST_SLOP = wp.constant(5.0e-5)
"""The same at most [m], with steps of any length."""
TOLERATED = wp.constant(0.1)
"""Penetration that is left alone for the time being, as a share of the tolerance."""
SETTLED = wp.constant(5.0e-6)
"""Update from which nothing moves any more, as a share of g h^2: a world at rest sweeps once."""
ROUNDED = wp.constant(1.0e-7)
"""Likewise without gravity, as a share of the farthest move: what float32 rounds of it."""
GOING_ON = wp.constant(0.01)
"""Update of a last sweep from which impacts go on, as a share of g h^2: with five times as much
dominoes that fall are off by 0.8 mm/s in a step instead of 0.3, and a pile whose gravity is
switched gains 1.6 mm of height instead of 0.15."""
STIFFENING = wp.constant(25.0)
"""Update from which contacts are made stiffer, too, in units of that: with less, boxes fly off
under a press that leaves them no room."""
WEIGHTLESS = wp.constant(1.0e-2)
"""What stands for g h^2 there without gravity, as a share of the reach: at 5 m/s and 60 Hz about as
much."""
OPEN = wp.constant(1.0e-5)
"""Update [m] of the last sweep of a step that may leave joints open by several times as much."""
JOINT_PASSES = wp.constant(8)
"""Most sweeps that close open joints: in a tree one leaves the square of how far they were open.
As many recover penetration in scenes with joints, where a contact may have to move a hundred times
the mass that its penalty is for: one sweep took 4 % of the depth of a foot in another leg."""
DEEP = wp.constant(2.0)
"""Penetration from which they do, in units of what is left alone: what slides is always a little
deeper than that, and one sweep is enough for it."""
LOOP_PASSES = wp.constant(24)
"""Likewise where joints close loops: a four-bar that lands is not closed by fewer."""
COLD_STEPS = wp.constant(3)
"""Steps after a reset that sweep more, because the multipliers start from nothing."""
STRUCK_FACTOR = wp.constant(8)
"""How many times more those steps sweep: a stack of 20 boxes then starts without a wave. So do
those in which impacts do not settle: with 4 a pyramid that is hit at 60 Hz is 0.15 mm deep instead
of 0.07, with 12 spheres in a bin take twice as many sweeps."""
RESTLESS_FACTOR = wp.constant(12)
"""How many times more a world sweeps that should come to rest and does not. A pyramid of 40 rows at
60 Hz, cut off, sags by 8 mm in 10 s; with 4 by 2.5 mm, with 12 by 1.4 mm, in the same time: once at
rest it takes one sweep a step."""
RESTLESS = wp.constant(0.01)
"""Share of a world's move from which the last update makes it restless. In pyramids that are cut
off it is 0.02 to 0.05, in what falls over, rolls or walks below 0.004."""
UNREST = wp.constant(1.0e-4)
"""Share of g h^2 that such an update is at least: below it a pyramid never ends."""
COLD_FACTOR = wp.constant(12)
"""Likewise the first of them, of a world that starts from rest. What it leaves takes long to go:
with 4, a house of cards at 60 Hz is 0.38 mm deep after it, with 8 0.09 mm, with 12 0.03 mm."""
AT_REST = wp.constant(4.0)
"""Reach of a world that starts from rest at most, beside g h^2; that of a free fall is twice it."""
LONGER = wp.constant(1.5)
"""A step this many times as long as the last one is as the first after a reset."""

MUCH_LONGER = wp.constant(2.1)
"""Likewise where an estimate of its error decides whether a step is repeated."""

STOPPING = wp.constant(1.0e30)
"""Update, squared, of a sweep after which a stop is to hold that did not, or to let go: an impact
goes on, whatever that sweep has moved."""


def make_measure_world(effects: Effects) -> wp.Function:
    """Device function: how far things may go in this step, and how much could rest on a contact."""

    @wp.func
    def measure_world(world: int, h: float, tolerance: float, s: wp.ref[Solver]) -> WorldScale:
        scale = WorldScale()
        scale.h = h
        scale.step = h
        scale.tolerance = tolerance
        scale.blend = 1.0
        scale.lag = 0.5
        scale.static_slot = s.work.inv_mass.shape[0] - 1
        farthest = float(0.0)
        if wp.static(effects.sleeping):
            farthest = s.worlds.pace[world]
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            gravity = float(0.0)
            if s.work.inv_mass[body] > 0.0:
                gravity = wp.length_sq(s.model.gravity[s.model.world[body]])
                scale.gravity = wp.max(scale.gravity, gravity)
            if wp.static(effects.contact or effects.cables) or gravity == 0.0:
                target = s.work.target[body]
                move = wp.length(wp.spatial_top(target))
                if s.work.inv_mass[body] > 0.0:
                    mass = s.model.mass[body]
                    scale.mass += mass
                    # radius of a solid body from its gyration, generously
                    radius = 2.0 * wp.sqrt(wp.trace(s.work.inertia[body]) / mass)
                    move += radius * wp.length(wp.spatial_bottom(target))
                farthest = wp.max(farthest, move)
        scale.gravity = wp.sqrt(scale.gravity)
        # an impact can at most double the speed of the faster body
        scale.reach = 2.0 * farthest
        scale.slop = wp.min(SLOP_SHARE * scale.gravity * h * h, MOST_SLOP)
        return scale

    return measure_world


@wp.func
def sweeps_at_age(age: int, iterations: int, scale: WorldScale) -> int:
    """Most sweeps of a step, by the steps since the world's multipliers were reset."""
    if age == 0 and scale.reach <= AT_REST * scale.gravity * scale.h * scale.h:
        return COLD_FACTOR * iterations
    return wp.where(age < COLD_STEPS, STRUCK_FACTOR, 1) * iterations


@wp.func
def settled_update(scale: WorldScale) -> float:
    """Update [m] from which nothing moves any more."""
    if scale.gravity == 0.0:
        return 0.5 * ROUNDED * scale.reach
    return SETTLED * scale.gravity * scale.h * scale.h


@wp.func
def last_update(scale: WorldScale) -> float:
    """Update [m] from which a sweep is the last one."""
    return wp.max(scale.tolerance, settled_update(scale))


@wp.func
def unsettled_update(scale: WorldScale) -> float:
    """Update [m] of a last sweep beyond which joints are closed again."""
    return wp.max(scale.slop, settled_update(scale))


@wp.func
def open_update(scale: WorldScale) -> float:
    """Update [m] of the last sweep of a step beyond which the joints of trees are put together."""
    return wp.max(wp.min(scale.slop, OPEN), settled_update(scale))


@wp.func
def impact_of(scale: WorldScale) -> float:
    """Update of a last sweep from which impacts go on [m]."""
    if scale.gravity == 0.0:
        return GOING_ON * WEIGHTLESS * scale.reach
    return GOING_ON * scale.gravity * scale.h * scale.h


@wp.func
def is_unsettled(update: float, scale: WorldScale) -> bool:
    """Whether the last sweep's update, squared [m^2], is more than joints allow."""
    unsettled = wp.max(scale.tolerance, unsettled_update(scale))
    return update > unsettled * unsettled


@wp.func
def length_of(update: float) -> float:
    """How far a sweep moved something [m], from an update as sweeps have it; infinite for one that
    was not the last in any case."""
    return wp.where(update < STOPPING, wp.sqrt(update), wp.inf)


def most_rounds(effects: Effects) -> int:
    """Most rounds of sweeps of a step: the motion, more where impacts go on, and the recovery."""
    if effects.ramp:
        return 1
    rounds = 1 + int(STRUCK_FACTOR) if effects.switching else 2
    return rounds + int(RESTLESS_FACTOR) - 1 if effects.piles else rounds


@wp.func
def is_struck(sweeps: int, update: float, scale: WorldScale) -> bool:
    """Whether the last sweep's update, squared [m^2], says that impacts go on in a world.

    A first sweep moves whatever is to move, and says nothing about that. After one in which forces
    met their bounds, whose update is infinite, a drive may still push by more than its limit.
    """
    struck = wp.max(impact_of(scale), settled_update(scale))
    return sweeps > 1 and update > struck * struck


@wp.func
def stiffens(update: float, scale: WorldScale) -> bool:
    """Whether impacts that go on meet stiffer contacts, by the last update, squared [m^2]."""
    much = STIFFENING * impact_of(scale)
    return update > much * much and wp.isfinite(update)


@wp.func
def is_restless(update: float, move: float, scale: WorldScale) -> bool:
    """Whether a world is all but at rest, and the last sweep still moves it.

    Takes that sweep's update and the farthest move of a body in the step, both squared [m^2].
    """
    fall = scale.gravity * scale.h * scale.h
    least = wp.max(UNREST * fall, scale.tolerance)
    is_much = update > wp.max(RESTLESS * RESTLESS * move, least * least)
    return is_much and move < fall * fall and update < STOPPING


@wp.func
def farthest_move(world: int, s: wp.ref[Solver]) -> float:
    """Farthest move of the COM of a body of a world in the step, squared [m^2]."""
    most = float(0.0)
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = body_at(i, s.worlds)
        if s.work.inv_mass[body] > 0.0:
            most = wp.max(most, wp.length_sq(wp.spatial_top(s.work.increment[body])))
    return most


def make_count_passes(effects: Effects) -> wp.Function:
    """Device function: how many sweeps the recovery of a world takes at most."""

    @wp.func
    def count_passes(
        sweeps: int, update: float, deepest: float, is_open: bool, scale: WorldScale
    ) -> int:
        """Takes the sweeps of the motion, the square of their last update [m^2], the deepest
        penetration [m], and whether joints were open at the start of the step.

        Up to a tolerance nothing is recovered, penetration up to a share of it."""
        passes = int(0)
        if wp.static(not effects.compliance):
            left_alone = wp.max(scale.slop, TOLERATED * scale.tolerance)
            if sweeps > 0 and deepest > left_alone:
                passes = 1
                if wp.static(effects.joints) and deepest > DEEP * left_alone:
                    passes = int(JOINT_PASSES)
        if wp.static(effects.joints):
            # joints close even where impacts keep the sweeps from settling
            is_apart = is_unsettled(update, scale)
            if is_apart:
                # what that leaves open in trees is put together after it
                passes = wp.max(passes, 1)
            if is_open or (is_apart and wp.static(effects.loops)):
                passes = wp.static(LOOP_PASSES if effects.closures else JOINT_PASSES)
        return passes

    return count_passes
