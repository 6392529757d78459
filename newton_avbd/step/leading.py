# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Where a step of second order starts: the leads, targets and first guesses of its bodies and rows.

The weights are those of :mod:`.step.slopes`.
"""

import warp as wp

from ..algebra.so3 import exp_quat, turned_by
from ..blocks.body import target_translation
from ..data import Solver, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows import contact as contact_rows
from .bodies import body_at, spin_momentum, target_turn
from .body_actuators import servo_input
from .carrying import is_short
from .drag import make_feel_drag
from .flight import is_flying, make_flight
from .needles import is_needle
from .rolling import make_point_moves, moves_levers
from .sides import make_written_side
from .slopes import follows_second_order, lead
from .smoothness import ROUNDING, external_wrench


@wp.func
def beyond_rounding(change: wp.vec3, move: wp.vec3) -> wp.vec3:
    """A change of a move, or zero where the rounding of velocities may have made it."""
    least = ROUNDING * wp.length(move)
    return wp.where(wp.length_sq(change) > least * least, change, wp.vec3(0.0))


def make_leading(effects: Effects) -> Functions:
    """Device functions in the order in which they run."""
    flight = make_flight(effects)
    will_fly, fly_body = flight.will_fly, flight.fly_body
    feel_drag = make_feel_drag(effects)
    written_side = make_written_side(effects)
    point_moves = make_point_moves(effects)

    @wp.func
    def begin_body(
        i: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ) -> bool:
        """A body by backward Euler, so that nothing is ahead; returns whether it is held."""
        body = body_at(i, s.worlds)
        s.work.lead[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        s.work.coasting[body] = s.work.increment[body]
        s.history.flying[body] = 0
        if s.work.inv_mass[body] == 0.0:
            return False
        s.work.coasting[body] = scale.h * body_qd[body]
        if will_fly(i, body, scale, body_qd, s):
            s.history.flying[body] = 1
            return False
        return True

    @wp.func
    def lead_body(
        body: int,
        scale: WorldScale,
        input: wp.spatial_vector,
        body_qd: wp.array[wp.spatial_vector],
        s: wp.ref[Solver],
    ):
        """Lead, target and first guess of a body; ``input`` is of controls that have changed."""
        step = scale.step
        velocity = body_qd[body]
        if s.work.inv_mass[body] == 0.0:
            # goes h v; as it speeds up, that is the mean of its velocity, and at the end it is felt
            # to be half a step ahead
            ahead_of_mean = 0.5 * (velocity - s.history.last[body].velocity)
            s.work.lead[body] = scale.h * velocity - step * (velocity + ahead_of_mean)
            if wp.static(effects.put_bodies):
                s.work.put[body] = (step / scale.h) * s.work.put[body]
            return
        last = s.history.last[body]
        ahead = lead(scale, velocity, last.slope)
        gained = lead(scale, last.acceleration, last.gain)
        v = velocity + gained
        # external forces are those of the whole step: all of their impulse, none of the last one's
        wrench = (scale.h / step) * external_wrench(body, s) + input
        push = s.model.inv_mass[body] * wp.spatial_top(wrench)
        dx = target_translation(wp.spatial_top(v), push, step)
        rotation = wp.transform_get_rotation(s.work.pose[body])
        turn = wp.spatial_bottom(ahead)
        dtheta = wp.vec3(0.0)
        end = rotation
        # what pushed it at the end of the last step goes on to
        pushed = last.acceleration
        if wp.static(effects.gyroscopic):
            # of the start, and all that the external torque gives
            momentum = s.work.momentum[body]
            if wp.static(effects.drag):
                momentum = spin_momentum(s.model, body, rotation, velocity)
                momentum += step * wp.spatial_bottom(wrench)
            began = momentum - step * wp.spatial_bottom(wrench)
            kick = step * wp.spatial_bottom(wrench) + lead(scale, last.torque, last.spun)
            momentum = began + kick
            # the inertia of the end of the step, where the body goes if all stays smooth
            spin = wp.spatial_bottom(velocity + scale.h * last.gain)
            swing = exp_quat(turn + step * spin)
            end = swing * rotation
            axes = wp.quat_to_matrix(end)
            back = wp.transpose(axes)
            s.work.inertia[body] = axes * s.model.inertia[body] * back
            spun = axes * (s.model.inv_inertia[body] * (back * last.torque))
            whole = momentum
            if wp.static(effects.carried_rounding):
                if is_short(scale.h):
                    # what turns along with the body keeps its momentum: nothing large cancels
                    whole = kick - turned_by(swing, began)
            w = axes * (s.model.inv_inertia[body] * (back * whole))
            if wp.static(effects.carried_rounding):
                if is_short(scale.h):
                    start = wp.spatial_bottom(velocity)
                    w += turned_by(swing, start)
                    gained = wp.spatial_vector(wp.spatial_top(gained), w)
                    w += start
            dtheta = step * w
            pushed = wp.spatial_vector(wp.spatial_top(pushed), spun)
            s.work.momentum[body] = momentum
        else:
            dtheta = target_turn(s.model, body, rotation, v, wrench, step)
            if wp.static(effects.carried_rounding):
                if is_short(scale.h):
                    none = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
                    spun = target_turn(s.model, body, rotation, none, wrench, step)
                    gained += wp.spatial_vector(wp.vec3(0.0), spun / step)
        s.work.target[body] = ahead + wp.spatial_vector(dx, dtheta)
        if wp.static(effects.drag):
            feel_drag(body, end, velocity, ahead, step, s)
        if wp.static(effects.carried_rounding):
            if is_short(scale.h):
                gained += last.lost + wp.spatial_vector(step * push, wp.vec3(0.0))
                s.work.gained[body] = gained
        target = s.work.target[body]
        coasting = ahead + step * v
        s.work.lead[body] = ahead
        s.work.coasting[body] = coasting
        if wp.static(effects.joints):
            # as the last steps have it, acceleration goes on to change
            change = (scale.h / scale.age) * (last.acceleration - last.gain)
            s.history.acceleration[body] = s.history.acceleration[body] + change
        pushed_shift = beyond_rounding((step * step) * wp.spatial_top(pushed), dx)
        pushed_turn = beyond_rounding((step * step) * wp.spatial_bottom(pushed), dtheta)
        s.work.increment[body] = target + wp.spatial_vector(pushed_shift, pushed_turn)

    @wp.func
    def start_body(
        body: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ):
        """Lead, target and first guess of a body, by the order of its world's step."""
        input = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        if wp.static(effects.servos):
            if s.work.inv_mass[body] > 0.0:
                rotation = wp.transform_get_rotation(s.work.pose[body])
                input = servo_input(body, rotation, scale, s.model)
        if is_flying(body, s.history):
            fly_body(body, scale, body_qd, s)
        elif scale.step < scale.h:
            lead_body(body, scale, input, body_qd, s)
        elif follows_second_order(scale):
            if wp.static(effects.joints):
                # that of the end of a step of second order says too little of the next
                s.history.acceleration[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))

    @wp.func
    def lead_rows(world: int, body: int, scale: WorldScale, s: wp.ref[Solver]):
        """Penalties of the rows that a body owns, by the step; friction sees velocities; forces are
        those of the end of the step, and so are their levers."""
        stiffer = (scale.h * scale.h) / (scale.step * scale.step)
        turn = wp.spatial_bottom(s.work.coasting[body])
        has_turned = moves_levers(turn)
        if wp.static(effects.needles):
            has_turned = has_turned and not is_needle(body, wp.inf, s)
        half = exp_quat(0.5 * turn)
        whole = half * half
        side = written_side(world, s.history)
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            row = s.rows.rows[i]
            s.rows.rows[i].k_n = stiffer * row.k_n
            s.rows.rows[i].k_t = stiffer * row.k_t
            if has_turned:
                record = s.history.records[side, i]
                s.rows.rows[i].arm += point_moves(row, record, whole, s)
                s.rows.rows[i].arm -= point_moves(row, record, half, s)
            if wp.static(effects.angular_friction):
                s.rows.spin[i].k_twist = stiffer * s.rows.spin[i].k_twist
                s.rows.spin[i].k_roll = stiffer * s.rows.spin[i].k_roll
            if wp.static(effects.put_bodies):
                # where a body is put only its move is known: what lies on it goes with that
                if wp.length_sq(s.work.put[row.b]) > 0.0:
                    continue
            if wp.static(effects.drift):
                span = s.work.com[row.a] - s.work.com[row.b]
                slid = contact_rows.slip(row, s.work.lead[row.a], s.work.lead[row.b], span)
                bent = contact_rows.bent_way(s.work.target[row.a], s.work.target[row.b])
                slid -= (0.5 * scale.step / scale.h) * bent
                slid -= wp.dot(row.normal, slid) * row.normal
                s.rows.drift[i] = (scale.step / scale.h) * s.rows.drift[i] - slid

    return together(begin_body, start_body, lead_rows)
