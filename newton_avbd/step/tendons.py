# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's tendons in the sweeps: a row each of the equations that are solved with a tree.

With its length L, the force F along it and the slope K = -dF/dL of what acts along it, a tendon is

    J delta - (mu + F)/K = 0

of the update delta of a sweep and the tension mu, where J is how L changes with the bodies: exact
for what is linear along it, however stiff. What holds L, a stop or friction, is J delta = step.
Rows are made anew in each sweep where L then is, and settle as Newton's method does.

Where it runs is in :mod:`.step.tendon_length`, what turns as bodies move in
:mod:`.step.tendon_curvature`.
"""

import warp as wp

from ..data import Closure, Solver, TendonModel, TreeWork, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows import axis as axis_rows
from ..rows.path import JOINT, meets_kink
from ..rows.tendon import linear_pull, range_of, tendon_law
from .anchors import ROUNDING
from .bodies import body_at
from .islands import HELD
from .slopes import begin_axis, change_within, end_axis, follows_second_order, step_ahead
from .tendon_coasting import coasting_rates
from .tendon_curvature import make_bend
from .tendon_length import begin_points, center_of, make_length

FREE = wp.constant(1.0e6)
"""How much softer a row without a slope is than the bodies that it pulls are mobile: it then pushes
with F but for a millionth, which the next sweep finds."""
LIMIT_JOLT = wp.constant(1.0e-5)
"""How far beyond its range the length of a tendon that goes on is about to be [m or rad]."""
LEAST_MISSED = wp.constant(1.0e-9)
"""Length that a row may be off by in a sweep at least [m or rad]."""


@wp.func
def rounding_of(length: wp.float64) -> float:
    """What rounding explains of a length [m or rad]."""
    return LEAST_MISSED + ROUNDING * wp.abs(wp.float32(length))


@wp.func
def led_by(closure: Closure, length: wp.float64, other: wp.float64, s: wp.ref[Solver]) -> wp.vec2:
    """How far a tendon is from where its equality constraint leads it [m or rad], and by how
    much more for more of the other one. Both count from their lengths in the reference pose."""
    lead = wp.float64(0.0)
    if closure.other != closure.tendon:
        lead = other - wp.float64(s.tree.tendons.rest[closure.other])
    value = wp.float64(0.0)
    slope = wp.float64(0.0)
    for k in range(5):
        slope = value + slope * lead
        value = wp.float64(s.joints.polynomials[closure.equality, 4 - k]) + value * lead
    left = length - wp.float64(s.tree.tendons.rest[closure.tendon]) - value
    return wp.vec2(wp.float32(left), wp.float32(slope))


@wp.func
def begin_input(i: int, scale: WorldScale, tendons: wp.ref[TendonModel]) -> float:
    """Second order: how much more than what actuators pull a tendon with the step counts, as along
    axes (:func:`.slopes.step_ahead`). Returns twice the energy that a change gives in one [J]."""
    push = tendons.push[i]
    last = tendons.input[i]
    jump = push.force - last.push - push.turned[0]
    change = push.drive - last.bound_push - push.turned[1]
    resists = scale.h * (scale.h * push.drive_stiffness + push.drive_damping)
    bound = change_within(last, change, push.least, push.most, resists)
    jump += bound[0]
    ahead = step_ahead(jump, last.ahead, bound[1], scale)
    change = jump + ahead[0] - last.ahead[0]
    last.push = push.force
    last.bound_push = push.drive
    last.share = bound[1]
    last.ahead = ahead
    tendons.input[i] = last
    return scale.h * scale.h * last.mobility * change * change


@wp.func
def end_input(i: int, moved: float, whole: float, h: float, tendons: wp.ref[TendonModel]):
    """For the next step: what has resisted a tendon's actuators, and what they would have pulled
    with, had they no limit."""
    push = tendons.push[i]
    length = wp.float32(tendons.length[i])
    pulled = push.drive - push.drive_stiffness * length - push.drive_damping * moved / h
    tendons.input[i].bound_force = pulled
    tendons.input[i].mobility = whole / (h * h)
    share = float(0.0)
    if not axis_rows.is_held(tendons.law[i]):
        share = 1.0 / (1.0 + wp.max(tendons.pull[i][1], 0.0) * whole)
    tendons.input[i].share = share


def make_tendons(effects: Effects) -> Functions:
    """Device functions: how tendons stand, the row of one, and what the rows have found."""
    lengths = make_length(effects)
    find_length, pull_along = lengths.find_length, lengths.pull_along
    bend = make_bend(effects)
    next_piece = axis_rows.make_next_piece(friction=True, stops=True, limits=True)
    compliance = effects.compliance

    @wp.func
    def begin_tendon(closure: Closure, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Length of a tendon at the start of the step, or what its equality constraint misses then.

        Expects increments of zero, and the tendons of a constraint to have begun. Returns whether
        it is beyond its limits, or misses anything, by more than rounding.
        """
        tendons = s.tree.tendons
        i = closure.tendon
        length = tendons.length[i]
        rounding = rounding_of(length)
        if closure.other >= 0:
            misfit = led_by(closure, length, tendons.length[closure.other], s)[0]
            s.tree.closures.misfit[closure.row] = misfit
            return wp.abs(misfit) > rounding
        is_fixed = tendons.kind[tendons.start[i]] == JOINT
        if not is_fixed:
            begin_points(i, s)
        ahead = float(0.0)
        if wp.static(effects.second_order):
            # limits and armature take the rate for that on the side on which it was measured
            knows_rate = tendons.is_limited[i] or tendons.armature[tendons.row[i]] > 0.0
            if follows_second_order(scale) and not knows_rate:
                ahead = 0.5
        length = find_length(i, True, ahead, s)
        tendons.length[i] = length
        started = length
        rate = tendons.velocity[i]
        if wp.static(effects.second_order):
            started = begin_axis(i, length, scale, tendons.motion)
            rate = wp.float32(begin_axis(i, wp.float64(rate), scale, tendons.rate))
        tendons.start_length[i] = started
        rates = coasting_rates(i, rate, scale, tendons)
        tendons.start_velocity[i] = rates[0]
        tendons.limit_velocity[i] = rates[1]
        if wp.float32(wp.abs(length - tendons.held_at[i])) > rounding or tendons.piece[i][2] != 0:
            # what rounding moves, friction brings back
            tendons.held_at[i] = started
        ends = range_of(i, tendons)
        at = wp.float32(length)
        is_beyond = at < ends[0] - rounding or at > ends[1] + rounding
        return wp.static(not compliance) and is_beyond

    @wp.func
    def begin_tendons(first: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Lengths of the tendons of a block at the start of the step, where bodies are there.

        Returns whether one is beyond its limits, or off what an equality constraint says.
        """
        closures = s.tree.closures
        number = closures.block_of[first]
        is_open = bool(False)
        if number < 0:
            return is_open
        block = closures.blocks[number]
        given = float(0.0)
        for turn in range(2):
            for c in range(block.first, block.end):
                closure = closures.closures[c]
                if closure.tendon >= 0 and (closure.other >= 0) == (turn == 1):
                    if begin_tendon(closure, scale, s):
                        is_open = True
                    if wp.static(effects.second_order):
                        if turn == 0:
                            given += begin_input(closure.tendon, scale, s.tree.tendons)
        if wp.static(effects.second_order):
            if given > 0.0:
                for k in range(first, s.worlds.block_end[first]):
                    body = body_at(k, s.worlds)
                    s.work.input_energy[body] = s.work.input_energy[body] + given
        return is_open

    @wp.func
    def tendon_row(
        closure: Closure, recovery: float, h: float, rank: wp.array[wp.int32], s: wp.ref[Solver]
    ):
        """The row of a tendon where its bodies are now."""
        tendons = s.tree.tendons
        closures = s.tree.closures
        row = closure.row
        i = closure.tendon
        for slot in range(closure.slot, closure.slot_end):
            closures.way[slot] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        length = find_length(i, False, 0.0, s)
        if closure.other >= 0:
            other = find_length(closure.other, False, 0.0, s)
            led = led_by(closure, length, other, s)
            pull_along(i, closure.ends, 1.0, h, s)
            if closure.other != i:
                ends = closure.ends + tendons.start[i + 1] - tendons.start[i]
                pull_along(closure.other, ends, -led[1], h, s)
            left = led[0]
            if recovery == 0.0:
                left -= closures.misfit[row]
            closures.multiplier[row] = wp.float64(left)
            return
        tendons.length[i] = length
        moved = wp.float32(length - tendons.start_length[i])
        law = tendon_law(i, length, moved, wp.static(compliance), recovery, h, tendons)
        force, stiffness = linear_pull(
            i, wp.float32(length), moved, wp.static(compliance), h, tendons
        )
        tendons.law[i] = law
        more, slope = axis_rows.law_force(law)
        force += more
        if wp.static(effects.second_order):
            force += tendons.input[i].ahead[0]
        stiffness += slope
        tendons.pull[i] = wp.vec2(force, stiffness)
        is_held = axis_rows.is_held(law)
        if force == 0.0 and stiffness == 0.0 and not is_held:
            return
        mobility = pull_along(i, closure.ends, 1.0, h, s)
        tension = -force
        if is_held:
            tension = -tendons.force[i]
            closures.multiplier[row] = -wp.float64(axis_rows.held_step(law))
        else:
            soft = wp.float64(FREE * mobility)
            if wp.float64(stiffness) * soft > wp.float64(1.0):
                soft = wp.float64(1.0) / wp.float64(stiffness)
            closures.gram[closures.gram_row[row] + row] = soft
            closures.multiplier[row] = -wp.float64(force) * soft
        if wp.static(effects.spatial_tendons):
            if tendons.kind[tendons.start[i]] != JOINT:
                bend(i, tension, h, rank, s)

    @wp.func
    def settle_tendon(closure: Closure, recovery: float, h: float, s: wp.ref[Solver]) -> float:
        """After the bodies have moved: what the row has found of its tendon.

        Returns the square of how far its length is off what the row takes it for, as far as that
        moves bodies [m^2], zero where rounding hides it, and infinity on a wrong piece of its law.
        """
        tendons = s.tree.tendons
        closures = s.tree.closures
        row = closure.row
        i = closure.tendon
        length = find_length(i, False, 0.0, s)
        missed = float(0.0)
        is_wrong = bool(False)
        if closure.other >= 0:
            other = find_length(closure.other, False, 0.0, s)
            missed = led_by(closure, length, other, s)[0]
            if recovery == 0.0:
                missed -= closures.misfit[row]
        else:
            law = tendons.law[i]
            force = tendons.pull[i][0]
            stiffness = tendons.pull[i][1]
            pulled = -wp.float32(closures.multiplier[row])
            step = wp.float32(length - tendons.length[i])
            held = float(0.0)
            moved = wp.float32(length - tendons.start_length[i])
            if axis_rows.is_held(law):
                held_step = axis_rows.held_step(law)
                missed = step - held_step
                held = pulled - (force - stiffness * held_step)
                step = held_step
            else:
                now, _k = linear_pull(
                    i, wp.float32(length), moved, wp.static(compliance), h, tendons
                )
                more, slope = axis_rows.law_force(law)
                if wp.static(effects.second_order):
                    more += tendons.input[i].ahead[0]
                whole = closures.whole[row]
                now += more - slope * step
                left = now - pulled
                # what was slack had no row
                is_wrong = force == 0.0 and stiffness == 0.0 and now != 0.0
                tendons.pull[i] = wp.vec2(now, stiffness)
                missed = left * whole / (1.0 + stiffness * whole)
            if recovery == 0.0:
                # what was wrong before goes by no force
                tendons.force[i] = pulled
            tendons.length[i] = length
            found = next_piece(law, step, held)
            is_wrong = is_wrong or not (found == law.piece)
            tendons.piece[i] = found
        if is_wrong:
            return wp.inf
        return wp.where(wp.abs(missed) > rounding_of(length), missed * missed, 0.0)

    @wp.func
    def settle_tendons(first: int, recovery: float, h: float, s: wp.ref[Solver]) -> float:
        """After a sweep: what the tendons of a block are off by, the largest square of it [m^2]."""
        closures = s.tree.closures
        largest = float(0.0)
        number = closures.block_of[first]
        if number < 0:
            return largest
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            if closure.tendon >= 0:
                off = settle_tendon(closure, recovery, h, s)
                largest = wp.max(largest, off)
        return largest

    return together(begin_tendons, tendon_row, settle_tendons)


@wp.func
def tendon_wrench(closure: Closure, sign: float, s: wp.ref[Solver]):
    """Adds what a spatial tendon pulls its bodies with to their loads, times a sign."""
    tendons = s.tree.tendons
    i = closure.tendon
    if closure.other >= 0 or tendons.kind[tendons.start[i]] == JOINT:
        return
    for place in range(tendons.start[i], tendons.span_end[i]):
        span = tendons.spans[place]
        for end in range(2):
            k = wp.where(end == 0, span.a, span.b)
            body = tendons.body[k]
            if s.work.inv_mass[body] > 0.0:
                point = wp.where(end == 0, span.start, span.end)
                along = wp.where(end == 0, -sign, sign) * span.share * tendons.force[i]
                force = along * span.along
                torque = wp.cross(point - center_of(k, s), force)
                s.tree.load[body] = s.tree.load[body] + wp.spatial_vector(force, torque)


@wp.func
def load_tendons(first: int, sign: float, s: wp.ref[Solver]):
    """Adds what spatial tendons of a block pull its bodies with to their loads."""
    closures = s.tree.closures
    number = closures.block_of[first]
    if number >= 0:
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            if closures.closures[c].tendon >= 0:
                tendon_wrench(closures.closures[c], sign, s)


@wp.func
def tendon_work(i: int, tree: wp.ref[TreeWork]) -> float:
    """Work of what acts along a tendon in the step [J]: the mean force over the way."""
    tendons = tree.tendons
    moved = wp.float32(tendons.length[i] - tendons.start_length[i])
    if axis_rows.is_held(tendons.law[i]):
        return 0.0
    return (tendons.pull[i][0] + 0.5 * tendons.pull[i][1] * moved) * moved


def make_join_tendons(join: wp.Function) -> wp.Function:
    """Device function that makes one island of what tendons of a block tie, by ``join``."""

    @wp.func
    def join_tendons(first: int, s: wp.ref[Solver]):
        closures = s.tree.closures
        tendons = s.tree.tendons
        number = closures.block_of[first]
        if number < 0:
            return
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            i = closures.closures[c].tendon
            if i < 0:
                continue
            one = int(-1)
            for k in range(tendons.start[i], tendons.start[i + 1]):
                body = tendons.body[k]
                if one < 0 and body >= 0:
                    if s.work.inv_mass[body] > 0.0:
                        one = body
            for k in range(tendons.start[i], tendons.start[i + 1]):
                body = tendons.body[k]
                if one >= 0 and body >= 0 and body != one:
                    join(one, body, HELD, s)

    return join_tendons


@wp.func
def meets_range(first: int, h: float, tree: wp.ref[TreeWork]) -> bool:
    """Second order: whether the length of a tendon of a block is about to meet its range."""
    closures = tree.closures
    number = closures.block_of[first]
    if number < 0:
        return False
    block = closures.blocks[number]
    for c in range(block.first, block.end):
        i = closures.closures[c].tendon
        if i >= 0 and closures.closures[c].other < 0:
            goes_to = wp.float32(tree.tendons.length[i]) + h * tree.tendons.motion[i].rate
            ends = range_of(i, tree.tendons)
            if goes_to < ends[0] - LIMIT_JOLT or goes_to > ends[1] + LIMIT_JOLT:
                return True
    return False


@wp.func
def turns_back(first: int, tree: wp.ref[TreeWork]) -> bool:
    """Second order: whether the rate of the length of a tendon of a block jumps, as the path has
    come to a kink of it or is about to."""
    closures = tree.closures
    number = closures.block_of[first]
    if number < 0:
        return False
    block = closures.blocks[number]
    for c in range(block.first, block.end):
        i = closures.closures[c].tendon
        if i >= 0 and closures.closures[c].other < 0:
            for k in range(tree.tendons.start[i], tree.tendons.start[i + 1]):
                if meets_kink(k, tree.tendons):
                    return True
    return False


@wp.func
def end_tendon(closure: Closure, scale: WorldScale, tree: wp.ref[TreeWork]):
    """Second order: how a tendon has moved in the step, before anything old is recovered."""
    tendons = tree.tendons
    i = closure.tendon
    if closure.other < 0:
        length = tendons.length[i]
        moved = wp.float32(length - tendons.start_length[i])
        rate = tendons.start_velocity[i]
        end_axis(i, tendons.start_length[i], length, scale, tendons.motion)
        end_axis(i, wp.float64(rate), wp.float64(moved / scale.step), scale, tendons.rate)
        end_input(i, moved, tree.closures.whole[closure.row], scale.step, tendons)
        # for the inner steps of a call, which measures them at its start
        tendons.velocity[i] = moved / scale.step
        tendons.coasting[i] = wp.vec2(tendons.coasting[i][0], tendons.coasting[i][0])


@wp.func
def end_tendons(first: int, scale: WorldScale, tree: wp.ref[TreeWork]):
    """Second order: how the tendons of a block have moved."""
    closures = tree.closures
    number = closures.block_of[first]
    if number >= 0:
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            if closures.closures[c].tendon >= 0:
                end_tendon(closures.closures[c], scale, tree)
