# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Error control: a call is divided into the fewest inner steps that keep a world's error small.

One thread does this for its world: it estimates the local error of a step that it has taken
(:mod:`.local_error`), and goes on or takes it back and tries a shorter one (:mod:`.step_length`).
Nothing comes to the host. Errors per unit of time are to stay below the accuracy [m/s]; steps that
are not of second order may spend what smooth ones have left over.
"""

import functools

import warp as wp

from ..data import Solver, Step, WorldWork
from ..effects import Effects
from .bodies import body_at, make_predict_body, moved_by, push_by_joint
from .kernels import KERNEL
from .local_error import SAVED, Misstep, make_judge
from .observables import contact_wrench
from .saving import save_world
from .scale import ROUNDED
from .step_length import AIM, SPENT, Call, account, choose_next, choose_step, is_good, try_shorter

CONVERGED = wp.constant(0.05)
"""Update of the sweeps that is small enough, by accuracy and h^2 [1/s]: what it leaves of forces
adds up from step to step."""
THIRD = wp.constant(3)
"""Sides of what is kept of contacts: the last call's, and two that inner steps take by turns."""


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
        call.window = -dt
        call.worst = -1
        if s.history.age[world] == 0:
            s.history.wanted[world] = dt
            s.history.ratio[world] = 1.0
            s.history.saved[world] = SAVED * s.worlds.inner.accuracy
            if wp.static(effects.fourth_order):
                s.tree.runge_kutta.is_known[world] = 0
                s.tree.runge_kutta.waits[world] = 0
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
    def solve_step(
        world: int, call: Call, dt: float, tolerance: float, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> Misstep:
        """Solves an inner step; what is known of it at once."""
        made = Misstep()
        h = call.h
        if wp.static(effects.fourth_order):
            # as long as steps of second order may be as long as the call they cost less
            if s.history.wanted[world] >= dt and s.tree.runge_kutta.is_known[world] == 0:
                s.tree.runge_kutta.waits[world] = -1
        is_predicted = call.tries == 0 and h == dt
        move = predict_world(world, is_predicted, h, h / dt, step, s)
        enough = wp.max(CONVERGED * s.worlds.inner.accuracy * h * h, ROUNDED * move)
        enough = wp.max(tolerance, enough)
        solve_world(world, s.worlds.inner.velocity, h, enough, step, s)
        made.order = wp.where(s.worlds.step[world] < h, 2, 1)
        if wp.static(effects.fourth_order):
            if s.tree.runge_kutta.is_known[world] != 0:
                made.order = 4
        made.residual = s.worlds.update[world]
        made.is_settled = made.residual <= wp.max(enough, s.worlds.settled[world])
        return made

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
            if made.order == 1:
                allowed += SPENT * s.history.saved[world]
            ratio = made.error / allowed
            if not is_good(call, made, ratio, s):
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
