# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels with one thread a body: prediction, and the whole step of bodies that touch nothing."""

import functools

import warp as wp

from ..algebra.so3 import exp_quat, rotation_between, turned_inertia, world_inertia
from ..blocks.body import (
    free_turn,
    is_mobile,
    origin_shift,
    renormalised,
    start_momentum,
    target_spin,
    target_translation,
)
from ..data import NO_JOINT, BodyModel, BodyWork, ControlInput, RowWork, Solver, Step, WorldWork
from ..effects import Effects
from .carrying import carry_flight, flight_from, gained_in_flight, is_short, less_one
from .denormals import flush_denormals, restore_denormals
from .drag import make_feel_drag, resistance, response
from .kernels import KERNEL, uncollected

BODIES_PER_THREAD = 64
"""Of those that a thread predicts on a CPU; a thread of a GPU predicts one."""
FAST = wp.constant(0.25)
"""Turn of a step [rad] from which the spin of a linked body resists tilting within the step."""
NOT_UNIT = wp.constant(1.0e-4)
"""Squared length of a quaternion, less 1, that rounding does not explain."""
HOLDING = wp.constant(1.001)
"""How far beyond Gauss's principle an acceleration may be and still be one that contacts allow."""
MIDPOINT = wp.constant(0.1)
"""Turn [rad] up to which a free body takes the implicit midpoint rule in one part: its energy
swings to and fro by up to turn^2/12 of it, 0.8e-3 here. Backward Euler would take energy away,
until what is long and spins about its length tumbles."""
MOST_PARTS = wp.constant(256)
"""Most parts of a step: a part takes 70 ns."""


@wp.func
def target_shift(
    model: wp.ref[BodyModel],
    body: int,
    velocity: wp.spatial_vector,
    wrench: wp.spatial_vector,
    h: float,
) -> wp.vec3:
    """dx* [m]: where the COM of a body goes without constraints."""
    push = model.inv_mass[body] * wp.spatial_top(wrench)
    acceleration = model.gravity[model.world[body]] + push
    return target_translation(wp.spatial_top(velocity), acceleration, h)


@wp.func
def target_turn(
    model: wp.ref[BodyModel],
    body: int,
    rotation: wp.quat,
    velocity: wp.spatial_vector,
    wrench: wp.spatial_vector,
    h: float,
) -> wp.vec3:
    """dtheta* [rad] of a body whose principal moments are equal."""
    torque = wp.quat_rotate_inv(rotation, wp.spatial_bottom(wrench))
    spun = wp.quat_rotate(rotation, model.inv_inertia[body] * torque)
    return h * wp.spatial_bottom(velocity) + (h * h) * spun


@wp.func(inline=True)  # a call would copy all that it takes, for each body
def free_turn_of(
    model: wp.ref[BodyModel],
    body: int,
    rotation: wp.quat,
    velocity: wp.spatial_vector,
    wrench: wp.spatial_vector,
    h: float,
    parts: int,
):
    """As :func:`.blocks.body.free_turn`, for a body of the model."""
    return free_turn(
        model.inertia[body],
        model.inv_inertia[body],
        rotation,
        wp.spatial_bottom(velocity),
        wp.spatial_bottom(wrench),
        h,
        parts,
    )


@wp.func(inline=True)
def mean_spin(
    model: wp.ref[BodyModel],
    body: int,
    rotation: wp.quat,
    velocity: wp.spatial_vector,
    wrench: wp.spatial_vector,
    h: float,
):
    """Angular velocity over the step [rad/s] and momentum [N m s] after it, world frame."""
    momentum = start_momentum(
        model.inertia[body], rotation, wp.spatial_bottom(velocity), wp.spatial_bottom(wrench), h
    )
    w = target_spin(model.inertia[body], model.inv_inertia[body], momentum, h)
    return wp.quat_rotate(rotation, w), wp.quat_rotate(rotation, momentum)


@wp.func
def spin_momentum(
    model: wp.ref[BodyModel], body: int, rotation: wp.quat, velocity: wp.spatial_vector
) -> wp.vec3:
    """Angular momentum of a body about its COM [N m s], world axes."""
    return turned_inertia(rotation, model.inertia[body], wp.spatial_bottom(velocity))


@wp.func
def midpoint_parts(
    model: wp.ref[BodyModel], body: int, rotation: wp.quat, velocity: wp.spatial_vector, h: float
) -> int:
    """In how many parts a free body takes the midpoint rule; 0 where it turns too far for that.

    By its mean turn about the momentum, 2 E h/|L|, which stays as it is: energy drifts where the
    parts change with the velocity of a body that flips.
    """
    spin = wp.quat_rotate_inv(rotation, wp.spatial_bottom(velocity))
    momentum = model.inertia[body] * spin
    turn = h * wp.dot(spin, momentum)
    most = MIDPOINT * wp.length(momentum)
    if turn <= most:
        return 1
    parts = wp.min(wp.ceil(turn / most), 2.0 * float(MOST_PARTS))
    return wp.where(parts > float(MOST_PARTS), 0, int(parts))


@wp.func
def pose_sum(pose: wp.transform) -> float:
    """Sum of all numbers of a pose: finite when they are."""
    x = wp.transform_get_translation(pose)
    r = wp.transform_get_rotation(pose)
    return x[0] + x[1] + x[2] + r[0] + r[1] + r[2] + r[3]


@wp.func
def vector_sum(v: wp.spatial_vector) -> float:
    """Sum of all numbers of a spatial vector: finite when they are."""
    return v[0] + v[1] + v[2] + v[3] + v[4] + v[5]


@wp.func
def unit_pose(pose: wp.transform, body: int, worlds: wp.ref[WorldWork]) -> wp.transform:
    """The pose with a quaternion of unit length; counts one that was not, and says so once."""
    rotation = wp.transform_get_rotation(pose)
    length_sq = wp.dot(rotation, rotation)
    if wp.abs(length_sq - 1.0) > NOT_UNIT and length_sq > 0.0:
        if wp.atomic_add(worlds.repaired, worlds.of_body[body], 1) == 0:
            wp.printf("SolverAVBD: the quaternion of body %d is not of unit length\n", body)
        return wp.transform(wp.transform_get_translation(pose), renormalised(rotation))
    return pose


@wp.func
def is_finite(
    model: wp.ref[BodyModel],
    body: int,
    pose: wp.transform,
    velocity: wp.spatial_vector,
    wrench: wp.spatial_vector,
) -> bool:
    """Whether what is given of a body holds no NaN, no infinity and no quaternion of zeros."""
    rotation = wp.transform_get_rotation(pose)
    total = pose_sum(pose) + vector_sum(velocity) + vector_sum(wrench)
    # products: an infinite one times a zero one is not a number
    total += model.mass[body] * model.inv_mass[body]
    total += wp.ddot(model.inertia[body], model.inv_inertia[body])
    total += wp.dot(model.com[body], model.gravity[model.world[body]])
    # of numbers that are not finite the difference is none; wp.isfinite is a call on a CPU
    return total - total == 0.0 and wp.dot(rotation, rotation) > 0.0


@wp.func
def forget_pose(body: int, work: wp.ref[BodyWork]):
    """Takes a body to be where it was put without having moved there."""
    work.put_from[body] = wp.transform(wp.vec3(0.0), wp.quat(0.0, 0.0, 0.0, 0.0))
    work.put[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))


@wp.func
def watch_pose(body: int, pose: wp.transform, velocity: wp.spatial_vector, s: wp.ref[Solver]):
    """How far a body that the solver does not move was put since the last step.

    It moves at its velocity. Where that was zero then and is zero now, its pose says how it moves.
    """
    before = s.work.put_from[body]
    rotation = wp.transform_get_rotation(before)
    forget_pose(body, s.work)
    if s.work.finite[body] == 0 or wp.length_sq(velocity) > 0.0:
        return
    s.work.put_from[body] = pose
    if wp.dot(rotation, rotation) > 0.0:
        end = wp.transform_get_rotation(pose)
        arm = wp.quat_rotate(end, s.model.com[body]) - wp.quat_rotate(rotation, s.model.com[body])
        moved = wp.transform_get_translation(pose) - wp.transform_get_translation(before)
        s.work.put[body] = wp.spatial_vector(moved + arm, rotation_between(rotation, end))


@wp.func(inline=True)
def joint_wrench(dof: int, control: wp.ref[ControlInput]) -> wp.spatial_vector:
    """What a joint from this degree of freedom on pushes its child with, at the COM."""
    f = control.joint_f
    return wp.spatial_vector(
        wp.vec3(f[dof], f[dof + 1], f[dof + 2]), wp.vec3(f[dof + 3], f[dof + 4], f[dof + 5])
    )


def make_wrench(effects: Effects) -> wp.Function:
    """The function that sums a body's external forces: body_f, and joint_f that pushes it."""

    @wp.func
    def external_wrench(
        model: wp.ref[BodyModel],
        body: int,
        body_f: wp.array[wp.spatial_vector],
        control: wp.ref[ControlInput],
    ) -> wp.spatial_vector:
        wrench = body_f[body]
        if wp.static(effects.joint_force):
            dof = model.free_dof[body]
            if wp.static(effects.joints):  # a world of FREE joints has none to switch
                joint = model.free_joint[body]
                if joint >= 0 and not model.joint_enabled[joint]:
                    dof = -1
            if dof >= 0:
                wrench += joint_wrench(dof, control)
        return wrench

    return external_wrench


@wp.func
def moved_by(body: int, update: wp.spatial_vector, work: wp.ref[BodyWork]) -> float:
    """Square of how far an update moves a body [m^2], a turn by its radius of gyration."""
    shift = wp.spatial_top(update)
    turn = wp.spatial_bottom(update)
    return wp.dot(shift, shift) + wp.dot(turn, work.inertia[body] * turn) * work.inv_mass[body]


@wp.func
def nonnegative(index: int) -> int:
    """The index, of which the compiler then knows that it is not negative.

    An array takes a negative index from its end: each access costs three instructions less.
    """
    return index & 0x7FFFFFFF


@wp.func
def body_at(rank: int, worlds: wp.ref[WorldWork]) -> int:
    """The body of a place in visiting order."""
    return nonnegative(worlds.bodies[rank])


@wp.func
def is_loose(body: int, s: wp.ref[Solver]) -> bool:
    """Whether no joint that is solved with its bodies holds a body."""
    if s.tree.joint.shape[0] == 0:
        return True
    return s.tree.joint[body] == NO_JOINT


@wp.func
def has_rows(rows: wp.ref[RowWork], body: int) -> bool:
    """Whether anything touches the body."""
    return (
        rows.owned_start[body] < rows.owned_end[body]
        or rows.other_start[body] < rows.other_end[body]
    )


@wp.func
def report_held(worlds: wp.ref[WorldWork], world: int):
    """Counts a step in which a world (or a body in it) was held still, and says so once."""
    if wp.atomic_add(worlds.held, world, 1) == 0:
        wp.printf(
            "SolverAVBD: world %d is not finite and is held still while that lasts; reset it\n",
            world,
        )


@wp.kernel(**KERNEL)
def report_freed(
    # Model:
    model: BodyModel,
    # In:
    taken_as_fixed: wp.array[wp.bool],
):
    """Says which bodies move that the solver has grouped as fixed ones; one thread a body."""
    body = wp.tid()
    if taken_as_fixed[body] and is_mobile(model, body):
        wp.printf(
            "SolverAVBD: body %d moves since a graph changed it; call notify_model_changed outside "
            "of graphs and capture again\n",
            body,
        )


@wp.func
def expected(free: wp.spatial_vector, last: wp.vec3) -> wp.spatial_vector:
    """What a step is likely to add to the coasting of a body, by what the last one added [m].

    Contacts that only hold leave of the free acceleration f what is nearest to it, a with
    a.a = a.f (Gauss's principle): then the acceleration of the last step goes on. Where a.a is
    more, something pushes, as in an impact, and the body has the same share of its free
    acceleration again (VBD, section 3.7).
    """
    shift = wp.spatial_top(free)
    along = wp.dot(last, shift)
    share = wp.clamp(along / wp.max(wp.dot(shift, shift), 1.0e-30), 0.0, 1.0)
    guess = share * free
    if along > 0.0 and wp.dot(last, last) <= HOLDING * along:
        return wp.spatial_vector(last, wp.spatial_bottom(guess))
    return guess


@functools.cache
def make_predict_body(effects: Effects) -> wp.Function:
    """Device function: all that the sweeps need of a body, once a step.

    Two arrays are passed without the structs that they lie in: Warp compiles code for each struct.
    """
    external_wrench = make_wrench(effects)
    feel_drag = make_feel_drag(effects)

    @wp.func
    def predict_body(
        body: int,
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        pose = unit_pose(body_q[body], body, s.worlds)
        velocity = body_qd[body]
        wrench = external_wrench(s.model, body, body_f, step.control)
        s.work.pose[body] = pose
        s.work.finite[body] = int(is_finite(s.model, body, pose, velocity, wrench))
        s.work.com[body] = wp.transform_point(pose, s.model.com[body])

        if not is_mobile(s.model, body):
            # moves as prescribed: contacts feel its velocity, nothing moves it
            s.work.inv_mass[body] = 0.0
            s.work.inv_inertia[body] = wp.mat33(0.0)
            s.work.target[body] = h * velocity
            s.work.increment[body] = h * velocity
            if wp.static(effects.put_bodies):
                watch_pose(body, pose, velocity, s)
            return
        if wp.static(effects.put_bodies):
            forget_pose(body, s.work)

        rotation = wp.transform_get_rotation(pose)
        dx = target_shift(s.model, body, velocity, wrench, h)
        dtheta = wp.vec3(0.0)
        s.work.inv_mass[body] = s.model.inv_mass[body]
        if wp.static(effects.second_order):
            s.work.wrench[body] = wrench
        if wp.static(effects.gyroscopic):
            w, momentum = mean_spin(s.model, body, rotation, velocity, wrench, h)
            dtheta = h * w
            s.work.momentum[body] = momentum
            if wp.static(effects.spinning):
                rank = s.worlds.rank[body]
                is_linked = s.tree.joint[body] != NO_JOINT or s.worlds.block_end[rank] > rank + 1
                # a torque alone would turn a massless link far, which its joints do not let it
                spin = wp.spatial_bottom(velocity)
                turn_sq = wp.min(wp.length_sq(dtheta), h * h * wp.length_sq(spin))
                is_fast = is_linked and turn_sq > FAST * FAST
                s.work.spin_momentum[body] = wp.where(is_fast, momentum, wp.vec3(0.0))
            s.work.inertia[body] = world_inertia(rotation, s.model.inertia[body])
            if wp.static(effects.contact or effects.loops or effects.reaction):
                s.work.inv_inertia[body] = world_inertia(rotation, s.model.inv_inertia[body])
        else:
            dtheta = target_turn(s.model, body, rotation, velocity, wrench, h)
            if wp.static(effects.turning_islands):
                s.work.momentum[body] = s.model.inertia[body] * (dtheta / h)
            # equal principal moments look the same from all sides
            s.work.inertia[body] = s.model.inertia[body]
            s.work.inv_inertia[body] = s.model.inv_inertia[body]
        s.work.target[body] = wp.spatial_vector(dx, dtheta)
        if wp.static(effects.drag):
            feel_drag(body, rotation, velocity, wp.spatial_vector(), h, s)
        target = s.work.target[body]
        if wp.static(effects.ramp):
            s.work.increment[body] = target
            return
        # of a body that others hold the last acceleration counts as none (:mod:`.ending`)
        coasting = h * velocity
        last = (h * h) * s.history.gained[body]
        s.work.increment[body] = coasting + expected(target - coasting, last)

    return predict_body


@functools.cache
@uncollected()
def make_predict(effects: Effects, bodies_per_thread: int = 1) -> wp.Kernel:
    """Kernel, a thread for a body or some: what :func:`make_predict_body` does for each."""
    predict_body = make_predict_body(effects)

    @wp.func
    def predict_bodies(thread: int, step: wp.ref[Step], s: wp.ref[Solver]):
        each = wp.static(bodies_per_thread)
        for body in range(thread * each, wp.min((thread + 1) * each, step.body_q.shape[0])):
            if wp.static(effects.sleeping):
                if s.worlds.island[body] >= 0:
                    continue
            predict_body(body, step.body_q, step.body_qd, step.body_f, step.h, step, s)
            if wp.static(effects.adaptive):
                s.worlds.inner.wrench[body] = step.body_f[body]

    @wp.kernel(**KERNEL)
    def predict(first: int, step: Step, s: wp.array[Solver]):
        mode = flush_denormals()
        predict_bodies(first + wp.tid(), step, s[0])
        restore_denormals(mode)

    return predict


@functools.cache
@uncollected()
def make_integrate(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a body: the whole step where nothing touches, which is exact."""
    external_wrench = make_wrench(effects)

    @wp.func(inline=True)  # a call would copy all that it takes, for each body
    def integrate_body(body: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """The step of a body."""
        pose = unit_pose(step.body_q[body], body, s.worlds)
        velocity = step.body_qd[body]
        wrench = external_wrench(s.model, body, step.body_f, step.control)
        finite = is_finite(s.model, body, pose, velocity, wrench)
        if not finite:
            report_held(s.worlds, s.worlds.of_body[body])
        if not finite or not is_mobile(s.model, body):
            step.body_q_out[body] = pose
            step.body_qd_out[body] = velocity
            return
        dx = target_shift(s.model, body, velocity, wrench, step.h)
        end_velocity = dx / step.h
        rotation = wp.transform_get_rotation(pose)
        spin = wp.vec3(0.0)
        further = wp.quat(0.0, 0.0, 0.0, 0.0)
        gained = wp.spatial_vector()
        if wp.static(effects.second_order):
            # the trapezoidal rule, which makes a parabola
            dx = 0.5 * (dx + step.h * wp.spatial_top(velocity))
        if wp.static(effects.gyroscopic):
            parts = int(0)
            if wp.static(effects.second_order):
                parts = midpoint_parts(s.model, body, rotation, velocity, step.h)
            turn, own_spin = free_turn_of(s.model, body, rotation, velocity, wrench, step.h, parts)
            if wp.static(effects.carried_rounding):
                if is_short(step.h):
                    further = rotation * less_one(turn)
                    gained = gained_in_flight(
                        s.model, body, rotation, velocity, wrench, turn, step.h
                    )
            rotation = rotation * turn
            spin = wp.quat_rotate(rotation, own_spin)
        else:
            dtheta = target_turn(s.model, body, rotation, velocity, wrench, step.h)
            spin = dtheta / step.h
            if wp.static(effects.second_order):
                dtheta = 0.5 * (dtheta + step.h * wp.spatial_bottom(velocity))
            if wp.static(effects.carried_rounding):
                if is_short(step.h):
                    own = exp_quat(wp.quat_rotate_inv(rotation, dtheta))
                    further = rotation * less_one(own)
                    gained = gained_in_flight(
                        s.model, body, rotation, velocity, wrench, own, step.h
                    )
            rotation = exp_quat(dtheta) * rotation
        rotation = renormalised(rotation)
        increment = wp.spatial_vector(dx, wp.vec3(0.0))
        shift = origin_shift(pose, s.model.com[body], increment, rotation)
        after = wp.transform(wp.transform_get_translation(pose) + shift, rotation)
        left = wp.spatial_vector(end_velocity, spin)
        if wp.static(effects.carried_rounding):
            if is_short(step.h):
                flight = flight_from(body, pose, velocity, s.history.flights)
                gained += flight.lost
                left = velocity + gained
                flight.lost = gained - (left - velocity)
                flight.velocity = left
                s.history.flights[body] = flight
                after = carry_flight(body, pose, after, shift, further, s.history.flights)
        step.body_q_out[body] = after
        step.body_qd_out[body] = left

    @wp.kernel(**KERNEL)
    def integrate(step: Step, s: wp.array[Solver]):
        integrate_body(wp.tid(), step, s[0])

    return integrate


@wp.func
def push(body: int, force: wp.vec3, torque: wp.vec3, h: float, s: wp.ref[Solver]):
    """Adds a wrench at the body's COM to those that it has been predicted with."""
    if s.work.inv_mass[body] == 0.0:
        return
    wrench = wp.spatial_vector(force, torque)
    kick = torque
    if s.work.drag.shape[0] > 0:
        drag = s.work.drag[body]
        moved = response(body, wrench, h, drag, s)
        s.work.target[body] = s.work.target[body] + moved
        kick -= wp.spatial_bottom(resistance(drag, moved / h))
    else:
        shift = s.model.inv_mass[body] * force
        spin = s.work.inv_inertia[body] * torque
        s.work.target[body] = s.work.target[body] + (h * h) * wp.spatial_vector(shift, spin)
    s.work.momentum[body] = s.work.momentum[body] + h * kick
    if s.work.wrench.shape[0] > 0:
        s.work.wrench[body] = s.work.wrench[body] + wrench


@wp.func
def push_by_joint(joint: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]):
    """What a joint pushes beyond the child that has been predicted with it."""
    if s.joints.enabled[joint]:
        child = s.joints.child[joint]
        parent = s.joints.parent[joint]
        wrench = joint_wrench(s.joints.dof_start[joint], step.control)
        force = wp.spatial_top(wrench)
        torque = wp.spatial_bottom(wrench)
        if s.model.free_joint[child] != joint:
            push(child, force, torque, h, s)
        if parent >= 0:
            arm = s.work.com[child] - s.work.com[parent]
            push(parent, -force, -torque - wp.cross(arm, force), h, s)


@wp.kernel(**KERNEL)
def push_more(pushing: wp.array[wp.int32], step: Step, s: wp.array[Solver]):
    """Wrenches of joints beyond those that bodies have been predicted with.

    These are reactions on parents, and what further joints of a body push it with. ``pushing``
    lists the joints; one thread, so that the order of sums is always the same.
    """
    for i in range(pushing.shape[0]):
        push_by_joint(pushing[i], step.h, step, s[0])
