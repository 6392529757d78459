# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Error control: a call is divided into the fewest inner steps that keep a world's error small.

One thread does this for its world: it estimates the local error of a step that it has taken, and
goes on or takes it back and tries a shorter one. Nothing comes to the host.

The estimate costs no solve. With the mean acceleration A of a step, its velocity change by h, a
step of second order misses C h^2 dA, where dA is what A has changed since the last step: the rest
of Taylor's series that the scheme leaves out (Milne's device, with the last step in the place of a
second formula). A step of backward Euler misses h^2 A / 2, and so does a step in which a velocity
jumps by h A, at a time in the step that it does not know. Per unit of time these are to stay below
the accuracy [m/s]; steps that are not of second order may spend what smooth ones have left over.
The controller is that of K. Gustafsson (1991): proportional and integral, in logarithms of errors.
"""

import functools

import warp as wp

from ..data import Solver, Step, WorldWork
from ..effects import Effects
from .bodies import MIDPOINT, body_at, make_predict_body, moved_by, push_by_joint
from .kernels import KERNEL
from .observables import contact_wrench
from .scale import ROUNDED

TRUNCATED = wp.constant(0.14)
"""C above. Positions miss h^3/12 of the jerk with the weights of the scheme, and velocities as much
of its rate; how far both lead a pendulum astray in a second decides here."""
SAVED = wp.constant(0.25)
"""Error that may be saved for steps that are not of second order, as a time [s] that the accuracy
counts for: an impact or a start may cost as much as a quarter of a second of smooth motion."""
SPENT = wp.constant(0.5)
"""Share of it that one of them may spend, so that there is something left for the next."""
AIM = wp.constant(0.8)
"""Share of the allowed error that a step aims at."""
INTEGRAL = wp.constant(0.35)
"""Exponents of the controller: 0.7/2 and 0.4/2 for errors a second that go by h^2."""
PROPORTIONAL = wp.constant(0.2)
CONVERGED = wp.constant(0.05)
"""Update of the sweeps that is small enough, by accuracy and h^2 [1/s]: what it leaves of forces
adds up from step to step."""
GROWTH = wp.constant(2.0)
"""How many times longer a step may be than the last one: second order needs the last one."""
MOST = wp.constant(8.0)
"""How many times longer steps are wanted at most than the last one, or than a call."""
SHRINKING = wp.constant(0.1)
"""How many times shorter, at least, a repeated one."""
JUMP = wp.constant(2.0)
"""How many times larger than the last mean acceleration one has to be to be a jump: what comes
after a jump is as smooth as what was before it, so that its time is found by halving."""
BY_ROUNDING = wp.constant(1.0e-4)
"""Share of a step by which dividing what is left of a call may be off."""
SMOOTHLY = wp.constant(0)
"""Why a body went astray most: in smooth motion, ..."""
BY_EULER = wp.constant(1)
"""... in a step of first order, as after an impact, a start or a change of order, ..."""
BY_JUMP = wp.constant(2)
"""... because its velocity jumped, ..."""
UNSETTLED = wp.constant(3)
"""... or because sweeps did not settle."""
THIRD = wp.constant(3)
"""Sides of what is kept of contacts: the last call's, and two that inner steps take by turns."""


@wp.func_native("""
    memcpy((void*)target, (const void*)source, (size_t)size);
""")
def copy_bytes(target: wp.uint64, source: wp.uint64, size: int):
    """Copies memory: all that a body leaves to the next step, faster than array by array."""
    ...


@wp.func
def save_world(world: int, worlds: wp.ref[WorldWork]):
    """Copies what a step will overwrite of a world's memory."""
    for k in range(worlds.inner.first[world], worlds.inner.first[world + 1]):
        segment = worlds.inner.segments[k]
        copy_bytes(segment.copy, segment.address, segment.size)


@wp.func
def restore_world(world: int, worlds: wp.ref[WorldWork]):
    """Puts it back."""
    for k in range(worlds.inner.first[world], worlds.inner.first[world + 1]):
        segment = worlds.inner.segments[k]
        copy_bytes(segment.address, segment.copy, segment.size)


@wp.func
def report_missed(world: int, body: int, worlds: wp.ref[WorldWork]):
    """Counts a call that is not as accurate as it was asked to be, and says so once."""
    missed = worlds.inner.missed[world]
    worlds.inner.missed[world] = missed + 1
    if missed == 0:
        wp.printf(
            "SolverAVBD: world %d is less accurate than it was asked to be, most of all its body "
            "%d: a call may take %d inner steps; see report()\n",
            world,
            body,
            worlds.inner.budget,
        )


@wp.func
def led_pose(
    pose: wp.transform, com: wp.vec3, velocity: wp.spatial_vector, h: float
) -> wp.transform:
    """Where a body goes that the solver does not move, at its velocity."""
    rotation = wp.transform_get_rotation(pose)
    turn = h * wp.spatial_bottom(velocity)
    angle = wp.length(turn)
    end = rotation
    if angle > 0.0:
        end = wp.normalize(wp.quat_from_axis_angle(turn / angle, angle) * rotation)
    place = wp.transform_point(pose, com) + h * wp.spatial_top(velocity)
    return wp.transform(place - wp.quat_rotate(end, com), end)


@functools.cache
def make_local_error(effects: Effects) -> wp.Function:
    """Device function: how far a step has led a body astray."""

    @wp.func
    def local_error(
        body: int,
        h: float,
        last_h: float,
        is_second_order: bool,
        change: wp.spatial_vector,
        s: wp.ref[Solver],
    ) -> float:
        """By its mean acceleration in the step [m/s^2, rad/s^2]; a turn counts by the radius of
        gyration [m]."""
        is_smooth = is_second_order
        changed = change - s.history.change[body]
        if s.history.flying[body] != 0:
            # a parabola is exact
            changed = wp.spatial_vector(wp.vec3(0.0), wp.spatial_bottom(changed))
            is_smooth = bool(True)
            if wp.static(effects.gyroscopic):
                turn = wp.spatial_bottom(s.work.increment[body])
                if wp.length_sq(turn) > MIDPOINT * MIDPOINT:
                    is_smooth = bool(False)
                    changed = change
        if is_smooth:
            # from the middle of the last step to that of this one
            apart = 2.0 * h / (h + last_h)
            return TRUNCATED * h * h * apart * wp.sqrt(moved_by(body, changed, s.work))
        return 0.5 * h * h * wp.sqrt(moved_by(body, change, s.work))

    return local_error


@wp.struct
class Call:
    """A call of a world: how far it is, and the inner step that it is at."""

    left: float
    """What is left of it [s]."""
    h: float
    """Length of the inner step [s]."""
    parts: float
    """How many of these what is left takes."""
    least: float
    """Length below which the inner steps that are left would not do [s]."""
    window: float
    """Time in which a jump is known to be [s]."""
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


@wp.struct
class Misstep:
    """How far a step has led a world astray."""

    error: float
    """[m]"""
    body: int
    """The body that has it; -1 where nothing moves."""
    cause: int
    is_jump: bool
    """Whether a velocity has jumped, in a step that is not of second order."""
    is_second_order: bool
    is_settled: bool
    residual: float
    """Update that sweeps were left at [m]."""


@functools.cache
def make_judge(effects: Effects) -> wp.Function:
    """Device function: how far a step has led a world astray."""
    local_error = make_local_error(effects)

    @wp.func
    def judge(
        world: int,
        h: float,
        last_h: float,
        made: Misstep,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> Misstep:
        """By its bodies, and by what its sweeps have left."""
        out = made
        out.body = -1
        out.cause = wp.where(made.is_second_order, SMOOTHLY, BY_EULER)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                change = (step.body_qd_out[body] - s.worlds.inner.velocity[body]) / h
                error = local_error(body, h, last_h, made.is_second_order, change, s)
                if error > out.error:
                    out.error = error
                    out.body = body
                    before = moved_by(body, s.history.change[body], s.work)
                    jumps = moved_by(body, change, s.work) > JUMP * JUMP * before
                    out.is_jump = jumps and not made.is_second_order
        if not made.is_settled and wp.isfinite(made.residual):
            # what sweeps leave of forces stays in velocities
            out.error += SAVED * made.residual / h
            out.cause = int(UNSETTLED)
        return out

    return judge


@functools.cache
def make_adapt_world(effects: Effects, solve_world: wp.Function) -> wp.Function:
    """Device function: a call of a world in inner steps."""
    predict_body = make_predict_body(effects)
    judge = make_judge(effects)

    @wp.func
    def begin_call(
        world: int, body_qd: wp.array[wp.spatial_vector], dt: float, s: wp.ref[Solver]
    ) -> Call:
        """State of the first inner step; the end may take the place of the start."""
        call = Call()
        call.left = dt
        call.worst = -1
        if s.history.age[world] == 0:
            s.history.wanted[world] = dt
            s.history.ratio[world] = 1.0
            s.history.saved[world] = SAVED * s.worlds.inner.accuracy
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            s.worlds.inner.pose[body] = s.work.pose[body]
            s.worlds.inner.velocity[body] = body_qd[body]
            s.worlds.inner.start[body] = s.work.pose[body]
            if wp.static(effects.put_bodies):
                s.worlds.inner.put[body] = s.work.put[body]
            if wp.static(effects.contact):
                s.worlds.inner.owned_end[body] = s.rows.owned_end[body]
                for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
                    s.worlds.inner.contact_f[s.rows.contacts[k]] = wp.spatial_vector()
        return call

    @wp.func
    def choose_step(world: int, given: Call, s: wp.ref[Solver]) -> Call:
        """The next inner step: what is left of the call in equal parts."""
        call = given
        last_h = s.history.step[world]
        # what is left has to be done by the steps that are left
        room = wp.max(s.worlds.inner.budget - call.tries, 1)
        call.least = call.left / float(room)
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
    def predict_world(
        world: int,
        is_predicted: bool,
        h: float,
        share: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Predicts the bodies of a world for an inner step, which is this share of the call.

        They are predicted already for the whole of it. Returns how far one of them moves at most
        without constraints [m].
        """
        farthest = float(0.0)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if not is_predicted:
                predict_body(
                    body,
                    s.worlds.inner.pose,
                    s.worlds.inner.velocity,
                    s.worlds.inner.wrench,
                    h,
                    step,
                    s,
                )
                if wp.static(effects.put_bodies):
                    s.work.put[body] = share * s.worlds.inner.put[body]
                if wp.static(effects.contact):
                    # rows leave out what is out of reach
                    s.rows.owned_end[body] = s.worlds.inner.owned_end[body]
                    s.rows.other_end[body] = s.rows.other_start[body]
        if wp.static(effects.reaction):
            if not is_predicted:
                for k in range(
                    s.worlds.inner.pushing_start[world], s.worlds.inner.pushing_start[world + 1]
                ):
                    push_by_joint(s.worlds.inner.pushing[k], h, step, s)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                farthest = wp.max(farthest, moved_by(body, s.work.target[body], s.work))
        return wp.sqrt(farthest)

    @wp.func
    def accept_step(world: int, h: float, share: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """The end of an inner step is the start of the next."""
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] == 0.0:
                velocity = s.worlds.inner.velocity[body]
                pose = s.worlds.inner.pose[body]
                s.worlds.inner.pose[body] = led_pose(pose, s.model.com[body], velocity, h)
                continue
            velocity = step.body_qd_out[body]
            s.history.change[body] = (velocity - s.worlds.inner.velocity[body]) / h
            s.worlds.inner.pose[body] = step.body_q_out[body]
            s.worlds.inner.velocity[body] = velocity
            if wp.static(effects.contact):
                for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
                    contact, force = contact_wrench(k, s.work, s.rows)
                    mean = s.worlds.inner.contact_f[contact] + share * force
                    s.worlds.inner.contact_f[contact] = mean

    @wp.func
    def end_call(world: int, home: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """Puts back what the user moves, and what is kept of contacts on the side of all worlds."""
        side = s.history.parity[world]
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] == 0.0:
                step.body_q_out[body] = s.worlds.inner.start[body]
            if wp.static(effects.contact):
                if side != home:
                    s.history.start[home, body] = s.history.start[side, body]
                    s.history.end[home, body] = s.history.end[side, body]
                    for k in range(s.history.start[side, body], s.history.end[side, body]):
                        s.history.records[home, k] = s.history.records[side, k]
                        if wp.static(effects.angular_friction):
                            s.history.torque[home, k] = s.history.torque[side, k]
                    if wp.static(effects.matching):
                        for k in range(s.rows.owned_start[body], s.worlds.inner.owned_end[body]):
                            contact = s.rows.contacts[k]
                            known = s.history.row_of_contact[side, contact]
                            s.history.row_of_contact[home, contact] = known
        s.history.parity[world] = home

    @wp.func
    def solve_step(
        world: int,
        call: Call,
        dt: float,
        tolerance: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> Misstep:
        """Solves an inner step; what is known of it at once."""
        made = Misstep()
        h = call.h
        is_predicted = call.tries == 0 and h == dt
        move = predict_world(world, is_predicted, h, h / dt, step, s)
        enough = wp.max(CONVERGED * s.worlds.inner.accuracy * h * h, ROUNDED * move)
        enough = wp.max(tolerance, enough)
        solve_world(world, s.worlds.inner.velocity, h, enough, step, s)
        made.is_second_order = s.worlds.step[world] < h
        made.residual = s.worlds.update[world]
        made.is_settled = made.residual <= wp.max(enough, s.worlds.settled[world])
        return made

    @wp.func
    def try_shorter(
        world: int, given: Call, made: Misstep, ratio: float, s: wp.ref[Solver]
    ) -> Call:
        """Once more, shorter; a step is at most what is left, so that there is an end."""
        call = given
        factor = AIM / ratio
        if not made.is_jump:
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
    def choose_next(
        world: int, call: Call, made: Misstep, dt: float, aimed: float, s: wp.ref[Solver]
    ):
        """What the next step is to be, by the error of this one as a share of what it aimed at."""
        now = wp.max(aimed, 1.0e-6)
        factor = wp.pow(now, -0.5)
        if made.is_second_order:
            factor = wp.pow(now, -INTEGRAL) * wp.pow(s.history.ratio[world] / now, PROPORTIONAL)
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

    @wp.func
    def adapt_world(
        world: int,
        body_qd: wp.array[wp.spatial_vector],
        dt: float,
        tolerance: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """A call of a world, in as many inner steps as its accuracy takes, or as it may take."""
        accuracy = s.worlds.inner.accuracy
        home = (s.history.parity[world] + 1) % THIRD
        held = s.worlds.held[world]
        call = begin_call(world, body_qd, dt, s)
        while call.left > 0.0:
            call = choose_step(world, call, s)
            last_h = s.history.step[world]
            last_h = wp.where(last_h == 0.0, call.h, last_h)
            save_world(world, s.worlds)
            side = s.history.parity[world]
            s.history.next_side[world] = wp.where(side == home, (home + 1) % THIRD, home)
            made = solve_step(world, call, dt, tolerance, step, s)
            call.tries += 1
            if s.worlds.held[world] != held:
                # what is not finite has no error; it was held for the whole call
                break
            made = judge(world, call.h, last_h, made, step, s)
            allowed = accuracy * call.h
            if not made.is_second_order:
                allowed += SPENT * s.history.saved[world]
            ratio = made.error / allowed
            if ratio > 1.0 and call.h > 1.001 * call.least:
                call = try_shorter(world, call, made, ratio, s)
                continue
            accept_step(world, call.h, call.h / dt, step, s)
            call = account(world, call, made, ratio, s)
            choose_next(world, call, made, dt, made.error / (AIM * allowed), s)

        end_call(world, home, step, s)
        s.worlds.inner.steps[world] = call.steps
        s.worlds.inner.rejected[world] = call.tries - call.steps
        s.worlds.inner.estimate[world] = call.spent / dt
        s.worlds.inner.spent[world] = s.worlds.inner.spent[world] + call.spent
        s.worlds.inner.worst[world] = call.worst
        s.worlds.inner.cause[world] = call.why
        if call.is_missed:
            report_missed(world, call.worst, s.worlds)

    return adapt_world


@wp.kernel(**KERNEL)
def export_mean_force(contact_f: wp.array[wp.spatial_vector], s: wp.array[Solver]):
    """Mean wrenches of contacts over a call, for the contacts that a body owns; a thread a body."""
    body = wp.tid()
    for k in range(s[0].rows.owned_start[body], s[0].worlds.inner.owned_end[body]):
        contact = s[0].rows.contacts[k]
        if contact < contact_f.shape[0]:
            contact_f[contact] = s[0].worlds.inner.contact_f[contact]
