# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a step of second order leaves to the next one: rates and slopes, and what pushed."""

import warp as wp

from ..algebra.so3 import exp_quat, turned_by, turned_inertia
from ..data import History, Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows.contact import is_pushing
from ..rows.joint import make_counts
from .anchors import is_linked
from .bodies import body_at, spin_momentum
from .carrying import is_carried
from .flight import is_flying
from .slopes import (
    JUMPED,
    QUIET_WORLD,
    UNRESOLVED,
    end_axis,
    follows_second_order,
    is_going_on,
    lead,
    next_slope,
)
from .smoothness import external_wrench, inertia_of, is_quiet, is_resolved

HELD_BY_STOP = wp.constant(4)
"""What a stop that holds adds to how friction of an axis pushes: 1 to 3."""


@wp.func
def is_remembered(world: int, scale: WorldScale, history: wp.ref[History]) -> bool:
    """Whether the motion of a step is one to go on from, or was one that went on."""
    return is_going_on(history.smooth[world]) or scale.step < scale.h


@wp.func
def remember_led(
    body: int, velocity: wp.spatial_vector, scale: WorldScale, history: wp.ref[History]
):
    """What :func:`is_led_on` compares with."""
    began = history.last[body].velocity
    history.last[body].acceleration = (velocity - began) / scale.h
    history.last[body].velocity = velocity


@wp.func
def remember_loop(i: int, scale: WorldScale, s: wp.ref[Solver]):
    """Likewise the coordinates of a joint outside of the trees."""
    joint = s.loops.joints[i]
    for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
        end_axis(
            dof, s.loops.start_coordinate[dof], s.loops.coordinate[dof], scale, s.history.coordinate
        )


def make_motion_history(effects: Effects) -> Functions:
    """Device functions that remember bodies, and worlds of one thread."""
    may_be_taut = effects.loops or effects.closures or effects.cables or effects.tendons
    linear_count = make_counts(effects.kinds).linear_count

    @wp.func
    def slips_otherwise(body: int, s: wp.ref[Solver]) -> bool:
        """Whether friction of a body's joint pushes otherwise than in the last step, or holds, or a
        stop of it holds or lets go."""
        result = bool(False)
        if wp.static(effects.joints and (effects.joint_friction or effects.hard_limits)):
            if is_linked(body, s):
                joint = s.tree.joint[body]
                for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                    slip = s.history.piece[dof][2] + 2
                    if wp.abs(s.history.piece[dof][0]) == 1:
                        slip += HELD_BY_STOP
                    last = s.history.coordinate[dof].slip
                    if slip != last:
                        s.history.coordinate[dof].slip = slip
                        # in the first step friction or a stop may have stopped what moved
                        has_stopped = slip > HELD_BY_STOP
                        if wp.static(effects.joint_friction):
                            has_stopped = has_stopped or (
                                slip == 2 and s.joints.friction[dof] > 0.0
                            )
                        if last == 0 and has_stopped:
                            began = s.history.last[body].velocity
                            began -= s.history.last[s.tree.parent[body]].velocity
                            linear = linear_count(s.joints, joint)
                            if wp.length_sq(wp.spatial_bottom(began)) > 0.0 or linear > 0:
                                result = True
                        result = result or last != 0
        return result

    @wp.func
    def remember_motion(body: int, scale: WorldScale, s: wp.ref[Solver]):
        """How a body has moved in the step, before anything old is recovered, and what pushes."""
        if wp.static(effects.contact):
            pushing = int(0)
            for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
                pushing += int(is_pushing(s.rows.rows[i]))
            s.history.pushing[body] = pushing
        if is_flying(body, s.history):
            return
        if wp.static(effects.joints and effects.coordinates):
            if is_linked(body, s):
                joint = s.tree.joint[body]
                k = s.tree.axis_start[body]
                for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                    end_axis(
                        dof,
                        s.tree.start_coordinate[k],
                        s.tree.coordinate[k],
                        scale,
                        s.history.coordinate,
                    )
                    k += 1
        slope = s.history.last[body].slope
        s.history.last[body].slope = next_slope(scale, s.work.increment[body], slope)

    @wp.func
    def remember_motions(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]):
        """How the bodies of a world have moved, if that is of use to the next step."""
        quiet = bool(True)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if slips_otherwise(body, s):
                s.history.smooth[world] = JUMPED
            velocity = step.body_qd_out[body]
            may_stand = wp.static(effects.contact)
            if quiet and not is_quiet(body, velocity, may_stand, scale, s):
                quiet = False
        if quiet:
            s.history.smooth[world] = QUIET_WORLD
        if is_remembered(world, scale, s.history):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                body = body_at(i, s.worlds)
                if s.work.inv_mass[body] > 0.0:
                    remember_motion(body, scale, s)

    @wp.func
    def remember_state(
        world: int,
        body: int,
        pose: wp.transform,
        velocity: wp.spatial_vector,
        scale: WorldScale,
        s: wp.ref[Solver],
    ):
        """Where a step has left a body, how fast, and what its constraints did to that."""
        before = wp.transform_get_rotation(s.work.pose[body])
        last = s.history.last[body]
        began = last.velocity
        wrench = external_wrench(body, s)
        given = wp.spatial_vector(s.model.inv_mass[body] * wp.spatial_top(wrench), wp.vec3(0.0))
        if wp.static(effects.gyroscopic):
            after = wp.transform_get_rotation(pose)
            is_new = bool(True)
            change = -spin_momentum(s.model, body, before, began)
            if wp.static(effects.carried_rounding):
                if is_carried(scale):
                    # of momenta, which are large, the difference would round
                    is_new = False
                    swing = exp_quat(wp.spatial_bottom(s.work.increment[body]))
                    gained = wp.spatial_bottom((velocity - began) + s.work.gained[body])
                    gained -= turned_by(swing, wp.spatial_bottom(began))
                    change = turned_inertia(after, s.model.inertia[body], gained) - turned_by(
                        swing, change
                    )
            if is_new:
                change += spin_momentum(s.model, body, after, velocity)
            change -= scale.h * wp.spatial_bottom(wrench)
            last.torque = (change - lead(scale, last.torque, last.spun)) / scale.step
            last.spun = next_slope(scale, change, last.spun)
        else:
            spin = turned_inertia(before, s.model.inv_inertia[body], wp.spatial_bottom(wrench))
            given = wp.spatial_vector(wp.spatial_top(given), spin)
        change_v = velocity - began
        if wp.static(effects.carried_rounding):
            if is_carried(scale):
                change_v += s.work.gained[body]
        change_v -= scale.h * given
        pushed = (change_v - lead(scale, last.acceleration, last.gain)) / scale.step
        # a step after one of second order may be as little resolved as that one
        if scale.step < scale.h or follows_second_order(scale):
            if not is_resolved(body, velocity, pushed - last.acceleration, scale, s):
                s.history.smooth[world] = wp.static(UNRESOLVED if may_be_taut else JUMPED)
        last.acceleration = pushed
        last.gain = next_slope(scale, change_v, last.gain)
        if wp.static(not effects.cables):
            # a chord would carry on, half as much again, what backward Euler misses of a fall;
            # tensions of cables swing less after it
            if scale.step == scale.h:
                last.slope = 0.5 * (began + velocity)
        last.velocity = velocity
        last.wrench = wrench
        last.inertia = inertia_of(body, s.model)
        last.pose = pose
        s.history.last[body] = last

    @wp.func
    def remember_states(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]):
        """Likewise where the step has left them."""
        if is_remembered(world, scale, s.history):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                body = body_at(i, s.worlds)
                if s.work.inv_mass[body] == 0.0:
                    remember_led(body, step.body_qd_out[body], scale, s.history)
                elif not is_flying(body, s.history):
                    remember_state(
                        world, body, step.body_q_out[body], step.body_qd_out[body], scale, s
                    )

    return together(
        slips_otherwise, remember_motion, remember_motions, remember_state, remember_states
    )
