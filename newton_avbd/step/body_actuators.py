# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's actuators that push bodies: at sites, by slider-cranks, along BALL and FREE joints.

By a unit of its force F an actuator pushes a body with a wrench J^T, which moves its transmission
by J v. What pushes against the world and depends on that motion,

    F = force - stiffness (l + J dx) - damping J v,

is a servo: linear in the velocity of the step's end, it is part of the body's drag
(:mod:`.step.drag`), stable however stiff, and holds against any load as its law says. What pushes
two bodies apart acts as a force that is constant in the step.
"""

import warp as wp

from ..algebra.so3 import rotation_vector
from ..data import (
    ActuatorLaw,
    ActuatorModel,
    BodyActuation,
    BodyModel,
    BodyPush,
    Drag,
    WorldScale,
    vec6,
)
from ..rows.actuator import (
    AGAINST_SITE,
    BALL_JOINT,
    BALL_JOINT_IN_PARENT,
    CRANK_ON_WORLD,
    FREE_JOINT,
    FREE_JOINT_IN_PARENT,
    SLIDER_CRANK,
    law_in_step,
)
from .kernels import KERNEL
from .slopes import step_ahead


@wp.func
def velocity_at(qd: wp.spatial_vector, arm: wp.vec3) -> wp.vec3:
    """Velocity of a point of a body [m/s], ``arm`` from its COM."""
    return wp.spatial_top(qd) + wp.cross(wp.spatial_bottom(qd), arm)


@wp.func
def top_of(gear: vec6) -> wp.vec3:
    return wp.vec3(gear[0], gear[1], gear[2])


@wp.func
def bottom_of(gear: vec6) -> wp.vec3:
    return wp.vec3(gear[3], gear[4], gear[5])


@wp.func
def mobility_between(
    a: wp.spatial_vector,
    b: wp.spatial_vector,
    rotation: wp.quat,
    inv_mass: float,
    inv_inertia: wp.mat33,
) -> float:
    """How fast a unit impulse of one transmission moves another one, on a body [1/kg]."""
    first = wp.quat_rotate_inv(rotation, wp.spatial_bottom(a))
    second = wp.quat_rotate_inv(rotation, wp.spatial_bottom(b))
    shift = inv_mass * wp.dot(wp.spatial_top(a), wp.spatial_top(b))
    return shift + wp.dot(first, inv_inertia * second)


@wp.func
def wrench_at(push: BodyPush, side: int, center: wp.vec3) -> wp.spatial_vector:
    """Wrench about a point by a unit of an actuator's force, on its link (side 0), or, with the
    opposite sign, on the other body (1)."""
    point = wp.where(side == 0, push.point, push.against)
    return wp.spatial_vector(push.along, push.about + wp.cross(point - center, push.along))


@wp.kernel(**KERNEL)
def find_pushes(
    # Model:
    actuators: ActuatorModel,
    com: wp.array[wp.vec3],
    # State in:
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    ctrl: wp.array[float],
    h: float,
    # Out:
    work: BodyActuation,
):
    """Transmission and law of each actuator that pushes bodies; one thread an actuator.

    Without controls only the transmission is found.
    """
    i = wp.tid()
    row = work.row[i]
    link = work.link[i]
    other = work.against[i]
    kind = work.axes[i]
    gear = actuators.gear[row]
    along = top_of(gear)
    about = bottom_of(gear)
    pose = body_q[link]
    rotation = wp.transform_get_rotation(pose)
    frame = wp.transform_multiply(pose, work.frame[i])
    point = wp.transform_get_translation(frame)
    axes = wp.transform_get_rotation(frame)
    base = work.reference[i]
    if other >= 0:
        base = wp.transform_multiply(body_q[other], base)
    base_axes = wp.transform_get_rotation(base)
    apart = wp.quat_inverse(base_axes) * axes
    force = wp.vec3(0.0)
    torque = wp.vec3(0.0)
    against = point
    length = 0.0
    period = 0.0
    has_length = bool(True)
    if kind == BALL_JOINT or kind == BALL_JOINT_IN_PARENT:
        length = wp.dot(rotation_vector(apart), along)
        period = wp.length(along)
        torque = wp.quat_rotate(wp.where(kind == BALL_JOINT, axes, base_axes), along)
    elif kind == FREE_JOINT or kind == FREE_JOINT_IN_PARENT:
        has_length = False
        force = along
        torque = about
        if kind == FREE_JOINT:
            torque = wp.quat_rotate(rotation, about)
    elif kind == AGAINST_SITE:
        # as MuJoCo has it, though only a reaction at the site would keep angular momentum
        against = wp.transform_get_translation(base)
        offset = wp.quat_rotate_inv(base_axes, point - against)
        length = wp.dot(along, offset) + wp.dot(about, rotation_vector(apart))
        if wp.length_sq(along) == 0.0:
            period = wp.length(about)
        force = wp.quat_rotate(base_axes, along)
        torque = wp.quat_rotate(base_axes, about)
    elif kind == SLIDER_CRANK or kind == CRANK_ON_WORLD:
        pin = point
        slider = base
        if kind == CRANK_ON_WORLD:
            pin = wp.transform_get_translation(base)
            slider = frame
        rod = actuators.crank[row]
        away = pin - wp.transform_get_translation(slider)
        axis = wp.quat_rotate(wp.transform_get_rotation(slider), wp.vec3(0.0, 0.0, 1.0))
        reach = wp.dot(axis, away)
        square = reach * reach + rod * rod - wp.length_sq(away)
        length = gear[0] * reach
        force = gear[0] * axis
        if square > 0.0:
            root = wp.sqrt(square)
            length = gear[0] * (reach - root)
            force = gear[0] * (axis * (1.0 - reach / root) + away / root)
        if kind == CRANK_ON_WORLD:
            # the slider gets the reaction, at the pin, which is as good as the rod's end
            force = -force
            point = pin
            against = pin
    else:
        has_length = False
        force = wp.quat_rotate(axes, along)
        torque = wp.quat_rotate(axes, about)

    push = BodyPush()
    push.along = force
    push.about = torque
    push.point = point
    push.against = against
    push.arm = point - wp.transform_point(pose, com[link])
    velocity = wp.dot(force, velocity_at(body_qd[link], push.arm))
    velocity += wp.dot(torque, wp.spatial_bottom(body_qd[link]))
    if other >= 0:
        other_arm = against - wp.transform_point(body_q[other], com[other])
        velocity -= wp.dot(force, velocity_at(body_qd[other], other_arm))
        velocity -= wp.dot(torque, wp.spatial_bottom(body_qd[other]))
    push.velocity = velocity
    if ctrl.shape[0] > 0:
        law = law_in_step(actuators, row, ctrl, length, velocity, h)
        if not has_length:
            # as MuJoCo has it, the length is zero wherever the body is
            law.stiffness = 0.0
        if period > 0.0 and law.stiffness > 0.0:
            # the nearest of the turns that are the same pose
            turn = 2.0 * wp.pi * period
            behind = law.force / law.stiffness - length
            length += turn * wp.round(behind / turn)
        push.law = law
    push.length = length
    work.pushes[i] = push


@wp.kernel(**KERNEL)
def begin_servos(work: BodyActuation):
    """Force of each servo at the start of the step; one thread an actuator that pushes bodies."""
    i = wp.tid()
    if not work.is_servo[i]:
        return
    push = work.pushes[i]
    law = push.law
    force = law.force - law.stiffness * push.length - law.damping * push.velocity
    force = wp.clamp(force, law.least, law.most)
    work.pushes[i].force = force + law.own_force - law.own_damping * push.velocity


@wp.kernel(**KERNEL)
def push_bodies(
    # Model:
    com: wp.array[wp.vec3],
    inv_mass: wp.array[float],
    inv_inertia: wp.array[wp.mat33],
    # State in:
    body_q: wp.array[wp.transform],
    # In:
    h: float,
    start: wp.array[wp.int32],
    items: wp.array[wp.int32],
    # Out:
    work: BodyActuation,
):
    """Force of the actuators that are no servos; one thread an actuator.

    What depends on length and velocity is no more than it would be at the end of a step in which
    all actuators of the bodies pushed what is free otherwise: each counts what the others do for
    itself by absolute values (Gershgorin), so that none overshoots.
    """
    i = wp.tid()
    if work.is_servo[i]:
        return
    push = work.pushes[i]
    law = push.law
    slope = law.damping + h * law.stiffness
    softer = float(1.0)
    own_softer = float(1.0)
    for side in range(2):
        link = wp.where(side == 0, work.link[i], work.against[i])
        if link >= 0:
            pose = body_q[link]
            center = wp.transform_point(pose, com[link])
            way = wrench_at(push, side, center)
            turned = wp.transform_get_rotation(pose)
            for k in range(start[link], start[link + 1]):
                beside = work.pushes[items[k] / 2]
                its_way = wrench_at(beside, items[k] % 2, center)
                moved = mobility_between(way, its_way, turned, inv_mass[link], inv_inertia[link])
                rate = beside.law.damping + h * beside.law.stiffness
                softer += h * wp.abs(moved) * wp.sqrt(slope * rate)
                own_softer += h * wp.abs(moved) * wp.sqrt(law.own_damping * beside.law.own_damping)
    force = law.force - law.stiffness * push.length - slope * push.velocity
    force = wp.clamp(force / softer, law.least, law.most)
    force += (law.own_force - law.own_damping * push.velocity) / own_softer
    work.pushes[i].force = force  # others read the rest


@wp.func
def within(
    level: float, slope: float, begun: float, free: float, mobility: float, law: ActuatorLaw
) -> wp.vec2:
    """Force ``level - slope v`` of a servo where it keeps to its range, as level and slope.

    Where it would leave its range it is the chord between the forces at the velocities ``begun``,
    which it has, and that to which it alone would take what is at ``free`` otherwise: what is stuck
    is pushed with no more than the range, and what moves does not overshoot.
    """
    least = law.least
    most = law.most
    start = level - slope * begun
    alone = (level - slope * free) / (1.0 + mobility * slope)
    first = wp.clamp(start, least, most)
    last = wp.clamp(alone, least, most)
    if first == start and last == alone:
        return wp.vec2(level, slope)
    end = free + mobility * last
    chord = 0.0
    if end != begun:
        chord = wp.clamp((first - last) / (end - begun), 0.0, slope)
    return wp.vec2(last + chord * end, chord)


@wp.func
def servo_way(k: int, rotation: wp.quat, model: wp.ref[BodyModel]) -> wp.spatial_vector:
    """Wrench on a body by a unit of the force of its servo at a place of the list."""
    push = model.servos.pushes[model.servos.items[k]]
    arm = push.arm + wp.quat_rotate(rotation, model.servos.arms[model.servos.links[k]])
    return wp.spatial_vector(push.along, push.about + wp.cross(arm, push.along))


@wp.func
def servo_input(
    body: int, rotation: wp.quat, scale: WorldScale, model: wp.ref[BodyModel]
) -> wp.spatial_vector:
    """Second order: wrench by which a step counts more than the forces of a body's servos, where
    their controls have changed (:func:`.slopes.step_ahead`).

    A force has changed by what it is now less what the law of the last step has here: the slopes of
    some laws change as they move.
    """
    out = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    h = scale.step
    for k in range(model.servos.start[body], model.servos.start[body + 1]):
        push = model.servos.pushes[model.servos.items[k]]
        law = push.law
        last = model.servos.input[k]
        way = servo_way(k, rotation, model)
        moving = law.stiffness * push.length + law.damping * push.velocity
        slopes = model.servos.slopes[k]
        moved = slopes[0] * push.length + slopes[1] * push.velocity
        before = wp.clamp(last.push - moved, law.least, law.most)
        after = wp.clamp(law.force - moving, law.least, law.most)
        resists = law.own_damping
        if after == law.force - moving:
            resists += law.damping + h * law.stiffness
        mobility = h * mobility_between(
            way, way, rotation, model.inv_mass[body], model.inv_inertia[body]
        )
        jump = after - before + law.own_force - last.bound_push
        last.push = law.force
        model.servos.slopes[k] = wp.vec2(law.stiffness, law.damping)
        last.bound_push = law.own_force
        last.ahead = step_ahead(jump, last.ahead, 1.0 / (1.0 + mobility * resists), scale)
        model.servos.input[k] = last
        out += last.ahead[0] * way
    return out


@wp.func
def servo_drag(
    drag: Drag,
    body: int,
    rotation: wp.quat,
    free: wp.spatial_vector,
    lead: wp.spatial_vector,
    step: float,
    model: wp.ref[BodyModel],
) -> Drag:
    """Adds the servos of a body to its drag.

    Args:
        drag: Drag without them.
        body: The body.
        rotation: Its orientation.
        free: Velocity at the end of the step without drag [m/s, rad/s].
        lead: Increment from which the velocity of the step counts [m, rad].
        step: The step that inertia sees [s].
        model: The bodies and their servos.
    """
    out = drag
    for k in range(model.servos.start[body], model.servos.start[body + 1]):
        i = model.servos.items[k]
        push = model.servos.pushes[i]
        way = servo_way(k, rotation, model)
        along = wp.spatial_top(way)
        about = wp.spatial_bottom(way)
        law = push.law
        slope = law.damping + step * law.stiffness
        level = law.force - law.stiffness * (push.length + wp.dot(way, lead))
        mobility = step * mobility_between(
            way, way, rotation, model.inv_mass[body], model.inv_inertia[body]
        )
        found = within(level, slope, push.velocity, wp.dot(way, free), mobility, law)
        push.force = found[0] + law.own_force
        push.slope = found[1] + law.own_damping
        model.servos.pushes[i] = push
        out.ll += push.slope * wp.outer(along, along)
        out.al += push.slope * wp.outer(about, along)
        out.aa += push.slope * wp.outer(about, about)
        out.push += push.force * way
    return out


@wp.func
def asked_of(body: int, model: wp.ref[BodyModel]) -> float:
    """What the controls of a body's servos come to: what sleeps wakes where that changes [N]."""
    asked = float(0.0)
    for k in range(model.servos.start[body], model.servos.start[body + 1]):
        asked += model.servos.pushes[model.servos.items[k]].law.force
    return asked


@wp.kernel(**KERNEL)
def end_servos(
    # Model:
    com: wp.array[wp.vec3],
    # State out:
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    # Out:
    work: BodyActuation,
):
    """Force of each servo at the end of the step; one thread an actuator that pushes bodies."""
    i = wp.tid()
    if not work.is_servo[i]:
        return
    push = work.pushes[i]
    link = work.link[i]
    velocity = wp.dot(push.along, velocity_at(body_qd[link], push.arm))
    velocity += wp.dot(push.about, wp.spatial_bottom(body_qd[link]))
    push.force -= push.slope * velocity
    push.slope = 0.0
    # it has moved on with the link
    push.point = wp.transform_point(body_q[link], com[link]) + push.arm
    work.pushes[i] = push


@wp.func
def pushed_by(
    link: int,
    center: wp.vec3,
    # In:
    work: BodyActuation,
    start: wp.array[wp.int32],
    items: wp.array[wp.int32],
) -> wp.spatial_vector:
    """Wrench of actuators on a link, whose COM is at ``center``.

    An item is twice an actuator, plus 1 for its reaction.
    """
    wrench = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    for k in range(start[link], start[link + 1]):
        push = work.pushes[items[k] / 2]
        side = items[k] % 2
        wrench += wp.where(side == 0, push.force, -push.force) * wrench_at(push, side, center)
    return wrench
