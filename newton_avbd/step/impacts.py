# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Restitution: what a step's impacts leave of the bodies' velocities.

Impacts go through the world in rounds. In each round all contacts that close faster than the
threshold part with e times that speed, at once: a box that lands flat does not turn. Bodies struck
so may close other contacts, which part in the next round: Newton's cradle. The rounds see free
bodies and no friction; what they decide is the speed at which the bodies of each row are to part.
The sweeps then find forces that make it so, through joints and with friction.

An impact happens within the step, not at its end. Positions of backward Euler lie on a parabola
whose velocity at the start of the step is v + a h/2. So the time and the speed of the impact are
known, and where the rebound's parabola ends: ``release_impacts`` puts the bodies there.
"""

import warp as wp

from ..data import BodyWork, ContactRow, Impact, RowWork, ShapeModel, Solver, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows import contact as contact_rows
from .bodies import body_at
from .loops import has_loops
from .piles import row_count, row_of

THRESHOLD = wp.constant(2.0)
"""Closing speed from which a contact bounces, as a multiple of g h: a body at rest stays so."""
NOISE = wp.constant(1.0e-5)
"""Closing speed that is none, as a share of the world's fastest."""
ROUNDS = wp.constant(32)
"""Most contacts in a row that an impact goes through within a step."""
SETTLE = wp.constant(50)
"""Most Gauss-Seidel sweeps of a round."""


@wp.func
def mixed_restitution(shapes: wp.ref[ShapeModel], shape0: int, shape1: int) -> float:
    """Mean of two shapes' restitution, each within 0 and 1, as in SolverSteel."""
    e0 = wp.clamp(shapes.restitution[shape0], 0.0, 1.0)
    return 0.5 * (e0 + wp.clamp(shapes.restitution[shape1], 0.0, 1.0))


@wp.func
def noise_of(scale: WorldScale) -> float:
    """Closing speed that is none [m/s]."""
    return NOISE * scale.reach / scale.h


@wp.func
def threshold_of(scale: WorldScale) -> float:
    """Closing speed from which a contact bounces [m/s]."""
    return wp.max(THRESHOLD * scale.gravity * scale.h, noise_of(scale))


@wp.func
def current_qd(slot: int, h: float, s: wp.ref[Solver]) -> wp.spatial_vector:
    """Velocity of a body after the rounds so far."""
    if s.work.inv_mass[slot] == 0.0:
        return s.work.target[slot] / h
    return s.rows.struck_qd[slot]


@wp.func
def parting_speed(row: ContactRow, h: float, s: wp.ref[Solver]) -> float:
    """Speed at which the bodies part after the rounds so far [m/s]; negative where they close."""
    span = s.work.com[row.a] - s.work.com[row.b]
    qd_a = current_qd(row.a, h, s)
    qd_b = current_qd(row.b, h, s)
    return wp.dot(row.normal, contact_rows.slip(row, qd_a, qd_b, span))


@wp.func
def response(
    work: wp.ref[BodyWork], slot: int, arm: wp.vec3, force: wp.vec3, torque: wp.vec3
) -> wp.spatial_vector:
    """M^-1 times a force at an arm and a torque, of a free body."""
    return wp.spatial_vector(
        work.inv_mass[slot] * force, work.inv_inertia[slot] * (wp.cross(arm, force) + torque)
    )


@wp.func
def begin_rounds(body: int, body_qd: wp.array[wp.spatial_vector], rows: wp.ref[RowWork]):
    """A body before the rounds: nothing has struck it."""
    rows.struck_qd[body] = body_qd[body]
    rows.struck_at[body] = -1.0


@wp.func
def begin_impacts(body: int, side: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
    """Rows that a body owns and that close in this step; returns if there is one.

    A gap g closes at the speed sqrt((v + a h/2)^2 - 2 a g), after 2 g over the sum of the speeds at
    its start and end; ``scale.lag`` h takes the place of h/2.
    """
    h = scale.h
    threshold = threshold_of(scale)
    found = bool(False)
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        row = s.rows.rows[i]
        record = s.history.records[side, i]
        impact = Impact()
        impact.restitution = mixed_restitution(s.shapes, record.shape0, record.shape1)
        impact.gap = row.gap
        impact.drift = s.rows.drift[i]
        impact.goal = -1.0
        span = s.work.com[row.a] - s.work.com[row.b]
        u = contact_rows.slip(row, s.work.target[row.a], s.work.target[row.b], span)
        u_n = wp.dot(row.normal, u)
        v = parting_speed(row, h, s)
        a = (u_n / h - v) / h
        lag = scale.lag
        if s.history.flying.shape[0] > 0:
            # what flies keeps to its parabola
            if s.history.flying[row.a] + s.history.flying[row.b] > 0:
                lag = 0.0
        start = v + lag * a * h
        if v < -threshold and row.gap + h * (start + 0.5 * a * h) < 0.0:
            gap = wp.max(row.gap, 0.0)
            hit = wp.sqrt(wp.max(start * start - 2.0 * a * gap, 0.0))
            impact.acceleration = a
            impact.lag = lag
            impact.wait = wp.min(2.0 * gap / (wp.abs(start) + hit), h)
            impact.goal = impact.restitution * hit
            found = True
        s.rows.impacts[i] = impact
    return found


@wp.func
def continue_impacts(body: int, threshold: float, h: float, s: wp.ref[Solver]) -> bool:
    """Rows that a body owns and that the last round makes close; returns if there is one."""
    found = bool(False)
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        row = s.rows.rows[i]
        impact = s.rows.impacts[i]
        impact.goal = -1.0
        impact.impulse = 0.0
        v = parting_speed(row, h, s)
        if v < -threshold and row.gap + h * v < 0.0:
            if impact.total == 0.0:
                struck = wp.max(s.rows.struck_at[row.a], s.rows.struck_at[row.b])
                impact.wait = wp.min(wp.max(struck, 0.0) - wp.max(row.gap, 0.0) / v, h)
            impact.goal = -impact.restitution * v
            found = True
        s.rows.impacts[i] = impact
    return found


@wp.func
def continue_world(world: int, threshold: float, h: float, s: wp.ref[Solver]) -> bool:
    """The next round; returns if there is one."""
    found = bool(False)
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        if continue_impacts(body_at(i, s.worlds), threshold, h, s):
            found = True
    return found


@wp.func
def strike(body: int, h: float, s: wp.ref[Solver]) -> float:
    """Lets the round's rows of a body part; returns the largest change [m/s]."""
    change = float(0.0)
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        impact = s.rows.impacts[i]
        if impact.goal >= 0.0:
            row = s.rows.rows[i]
            arm_b = row.arm + (s.work.com[row.a] - s.work.com[row.b])
            if impact.mass == 0.0:
                impact.mass = contact_rows.effective_mass(
                    row.normal,
                    row.arm,
                    arm_b,
                    s.work.inv_mass[row.a] + s.work.inv_mass[row.b],
                    s.work.inv_inertia[row.a],
                    s.work.inv_inertia[row.b],
                )
            missing = impact.goal - parting_speed(row, h, s)
            push = wp.max(impact.mass * missing, -impact.impulse)
            change = wp.max(change, wp.abs(push) / impact.mass)
            impact.impulse += push
            impact.total += push
            s.rows.impacts[i] = impact
            force = push * row.normal
            none = wp.vec3(0.0)
            s.rows.struck_qd[row.a] = s.rows.struck_qd[row.a] - response(
                s.work, row.a, row.arm, force, none
            )
            s.rows.struck_at[row.a] = wp.max(s.rows.struck_at[row.a], impact.wait)
            if s.work.inv_mass[row.b] > 0.0:
                s.rows.struck_qd[row.b] = s.rows.struck_qd[row.b] + response(
                    s.work, row.b, arm_b, force, none
                )
                s.rows.struck_at[row.b] = wp.max(s.rows.struck_at[row.b], impact.wait)
    return change


@wp.func
def strike_world(world: int, h: float, s: wp.ref[Solver]) -> float:
    """A Gauss-Seidel sweep over the round's rows of a world; returns the largest change [m/s]."""
    change = float(0.0)
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        change = wp.max(change, strike(body_at(i, s.worlds), h, s))
    return change


@wp.func
def aim_rows(body: int, noise: float, lag: float, h: float, s: wp.ref[Solver]):
    """Makes the rows that a body owns part as the rounds have decided.

    A bounce that gravity ends within the step is none. Bodies that later rounds made close again,
    but will not meet in this step, go on closing.
    """
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        impact = s.rows.impacts[i]
        if impact.total > 0.0:
            row = s.rows.rows[i]
            # velocities of backward Euler lag half a step behind its parabola
            part = parting_speed(row, h, s)
            is_late = part < -noise and row.gap + h * part > 0.0
            part += impact.acceleration * ((1.0 - lag) * h - impact.wait)
            if impact.restitution > 0.0 and (is_late or part >= -noise):
                if not is_late:
                    part = wp.max(part, 0.0)
                row.gap = 0.0
                row.force = (impact.total / h) * row.normal
                row.k_n = contact_rows.PENALTY * impact.mass / (h * h)
                # whether it will slide or stick is open: a penalty that finds both
                row.k_t = contact_rows.RELEASE_RATIO * contact_rows.tangent_penalty(row, row.k_n)
                s.rows.rows[i] = row
                s.rows.drift[i] = impact.drift - (h * part) * row.normal
            else:
                s.rows.impacts[i].total = 0.0


@wp.func
def owned_last(body: int, k: int, rows: wp.ref[RowWork]) -> int:
    """The k-th row of a body in the order of their owners, itself last."""
    owned = rows.owned_end[body] - rows.owned_start[body]
    return row_of(body, (k + owned) % row_count(body, rows), rows)


@wp.func
def add_target(body: int, i: int, sign: float, h: float, s: wp.ref[Solver]) -> wp.spatial_vector:
    """Adds to a body's target ``sign`` times what the impact of a row does from its time on.

    Returns by how much its force has moved the body before.
    """
    impact = s.rows.impacts[i]
    early = wp.spatial_vector()
    if impact.total > 0.0:
        row = s.rows.rows[i]
        arm = row.arm
        side = float(-1.0)
        if body != row.a:
            arm += s.work.com[row.a] - s.work.com[row.b]
            side = 1.0
        change = h * response(s.work, body, arm, side * impact.force, side * impact.torque)
        wait = s.rows.struck_at[body]
        s.work.target[body] = s.work.target[body] + (sign * (h - wait)) * change
        early = wait * change
    return early


@wp.func
def lag_of_impact(body: int, rows: wp.ref[RowWork]) -> float:
    """How far velocities that impacts of a body end are behind the start of the step, in steps."""
    lag = float(0.0)
    for k in range(row_count(body, rows)):
        impact = rows.impacts[row_of(body, k, rows)]
        if impact.total > 0.0:
            lag = wp.max(lag, impact.lag)
    return lag


@wp.func
def lead_of_rebound(body: int, h: float, s: wp.ref[Solver]) -> float:
    """Second order: how far a parabola is ahead of the step of backward Euler that sweeps take.

    As a share of what acceleration moves the body in that step: a h^2/2, less what the velocity of
    its start had lagged behind until the impact.
    """
    if s.work.coasting.shape[0] == 0:
        return 0.0
    return 0.5 - lag_of_impact(body, s.rows) * s.rows.struck_at[body] / h


@wp.func
def free_share(body: int, scale: WorldScale, work: wp.ref[BodyWork]) -> float:
    """Share of its free acceleration that impacts leave a body, 0 to 1, once they are released."""
    lacking = wp.length(wp.spatial_top(work.target[body] - work.increment[body]))
    fall = scale.gravity * scale.h * scale.h
    return 1.0 - wp.min(lacking / wp.max(fall, 1.0e-30), 1.0)


@wp.func
def leave_impacts(body: int, scale: WorldScale, s: wp.ref[Solver]):
    """Puts a body to where its rebounds are, of which its target takes what they did.

    The sweeps let the force of an impact act all step long, though it acts from its time on.
    What it has done goes to the target of the body, so that the recovery leaves it alone.
    """
    if s.work.inv_mass[body] > 0.0 and s.rows.struck_at[body] >= 0.0:
        share = lead_of_rebound(body, scale.h, s)
        if share > 0.0:
            behind = share * (s.work.target[body] - s.work.coasting[body])
            behind = wp.spatial_vector(wp.spatial_top(behind), wp.vec3(0.0))
            s.work.increment[body] = s.work.increment[body] - behind
            s.work.target[body] = s.work.target[body] - behind
        for k in range(row_count(body, s.rows)):
            early = add_target(body, owned_last(body, k, s.rows), 1.0, scale.h, s)
            s.work.increment[body] = s.work.increment[body] - early
        share = free_share(body, scale, s.work)
        s.history.gained[body] = share * s.model.gravity[s.model.world[body]]


def make_impacts(effects: Effects) -> Functions:
    """Device functions that make of a world's impacts what restitution says."""

    @wp.func
    def is_joined(slot: int, s: wp.ref[Solver]) -> bool:
        """Whether joints decide how a body answers a force."""
        result = bool(False)
        if wp.static(effects.joints):
            rank = s.worlds.rank[slot]
            result = s.worlds.block_end[rank] > rank + 1 or s.tree.joint[slot] >= 0
        if wp.static(effects.loops):
            result = result or has_loops(s.loops, slot)
        return result

    @wp.func
    def end_rounds(body: int, scale: WorldScale, s: wp.ref[Solver]):
        """A body after the rounds: where it starts from, and how its rows are to part."""
        lag = wp.static(0.0 if effects.second_order else 0.5)
        aim_rows(body, noise_of(scale), lag, scale.h, s)
        if s.rows.struck_at[body] >= 0.0:
            s.work.increment[body] = scale.h * s.rows.struck_qd[body]

    @wp.func(inline=effects.inline)
    def find_impacts(
        world: int,
        side: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        s: wp.ref[Solver],
    ) -> bool:
        """Lets the impacts go through the world, in rounds; returns whether there are any."""
        h = scale.h
        first = s.worlds.body_start[world]
        end = s.worlds.body_start[world + 1]
        noise = noise_of(scale)
        for i in range(first, end):
            begin_rounds(body_at(i, s.worlds), body_qd, s.rows)
        is_active = bool(False)
        for i in range(first, end):
            if begin_impacts(body_at(i, s.worlds), side, scale, s):
                is_active = True
        if not is_active:
            return False
        rounds = int(0)
        while is_active and rounds < ROUNDS:
            change = float(wp.inf)
            sweeps = int(0)
            while change > noise and sweeps < SETTLE:
                change = strike_world(world, h, s)
                sweeps += 1
            is_active = continue_world(world, threshold_of(scale), h, s)
            rounds += 1
        for i in range(first, end):
            end_rounds(body_at(i, s.worlds), scale, s)
        return True

    @wp.func
    def find_wait(body: int, s: wp.ref[Solver]) -> float:
        """How long the impacts of a body waited [s], the first of them; negative without any.

        A body that joints hold, or that something else pushes, is where those say that it is.
        """
        wait = float(-1.0)
        is_held = is_joined(body, s)
        for k in range(row_count(body, s.rows)):
            i = row_of(body, k, s.rows)
            impact = s.rows.impacts[i]
            if impact.total > 0.0:
                wait = wp.where(wait < 0.0, impact.wait, wp.min(wait, impact.wait))
            elif wp.length_sq(s.rows.rows[i].force) > 0.0:
                is_held = True
        return wp.where(is_held, wp.min(wait, 0.0), wait)

    @wp.func
    def release_impacts(body: int, s: wp.ref[Solver]):
        """Says for how long a body's impacts waited; rows that it owns go back to their gaps."""
        s.rows.struck_at[body] = find_wait(body, s)
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            impact = s.rows.impacts[i]
            if impact.total > 0.0:
                impact.force = s.rows.rows[i].force
                if wp.static(effects.angular_friction):
                    impact.torque = s.rows.spin[i].torque
                    s.rows.spin[i].torque = wp.vec3(0.0)
                s.rows.impacts[i] = impact
                s.rows.drift[i] = impact.drift
                s.rows.rows[i].force = wp.vec3(0.0)
                s.rows.rows[i].gap = impact.gap

    @wp.func
    def restore_impacts(body: int, h: float, s: wp.ref[Solver]):
        """Gives the rows that a body owns their forces back, and the body its target."""
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            impact = s.rows.impacts[i]
            if impact.total > 0.0:
                s.rows.rows[i].force = impact.force
                if wp.static(effects.angular_friction):
                    s.rows.spin[i].torque = impact.torque
        if s.work.inv_mass[body] > 0.0:
            for k in range(row_count(body, s.rows)):
                add_target(body, owned_last(body, k, s.rows), -1.0, h, s)
            if s.rows.struck_at[body] >= 0.0:
                share = lead_of_rebound(body, h, s)
                if share > 0.0:
                    behind = (share / (1.0 - share)) * (s.work.target[body] - s.work.coasting[body])
                    behind = wp.spatial_vector(wp.spatial_top(behind), wp.vec3(0.0))
                    s.work.target[body] = s.work.target[body] + behind

    return together(find_impacts, end_rounds, release_impacts, restore_impacts)
