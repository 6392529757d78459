# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels with one thread a body: prediction, and the whole step of bodies that touch nothing."""

import functools

import warp as wp

from ..algebra.so3 import world_inertia
from ..blocks.body import free_rotation, is_mobile, moved_pose, target_translation
from ..data import BodyModel, BodyWork, History, WorldWork
from ..effects import Effects


def make_target(effects: Effects) -> wp.Function:
    """Device function of a body's inertial target: gyroscopic only where a scene needs it."""

    @wp.func
    def inertial_target(
        model: BodyModel,
        body: int,
        pose: wp.transform,
        velocity: wp.spatial_vector,
        wrench: wp.spatial_vector,
        h: float,
    ):
        rotation = wp.transform_get_rotation(pose)
        omega = wp.spatial_bottom(velocity)
        torque = wp.spatial_bottom(wrench)
        push = model.inv_mass[body] * wp.spatial_top(wrench)
        acceleration = model.gravity[model.world[body]] + push
        dx = target_translation(wp.spatial_top(velocity), acceleration, h)
        if wp.static(effects.gyroscopic):
            dtheta, remainder = free_rotation(
                model.inertia[body], model.inv_inertia[body], rotation, omega, torque, h
            )
            return wp.spatial_vector(dx, dtheta), remainder
        else:
            spun = model.inv_inertia[body] * wp.quat_rotate_inv(rotation, torque)
            dtheta = h * omega + (h * h) * wp.quat_rotate(rotation, spun)
            return wp.spatial_vector(dx, dtheta), wp.vec3(0.0)

    return inertial_target


@wp.func
def is_pose_finite(pose: wp.transform) -> bool:
    """Whether a pose holds no NaN and no infinity."""
    r = wp.transform_get_rotation(pose)
    return wp.isfinite(wp.transform_get_translation(pose)) and wp.isfinite(
        wp.vec4(r[0], r[1], r[2], r[3])
    )


@wp.func
def is_finite(pose: wp.transform, velocity: wp.spatial_vector, wrench: wp.spatial_vector) -> bool:
    """Whether a body's input holds no NaN and no infinity."""
    return is_pose_finite(pose) and wp.isfinite(velocity) and wp.isfinite(wrench)


def make_wrench(effects: Effects) -> wp.Function:
    """The function that sums a body's external forces: body_f and what drives its FREE joint."""

    @wp.func
    def external_wrench(
        model: BodyModel,
        body: int,
        body_f: wp.array[wp.spatial_vector],
        joint_f: wp.array[float],
    ) -> wp.spatial_vector:
        wrench = body_f[body]
        if wp.static(effects.joint_force):
            dof = model.free_dof[body]
            if dof >= 0:
                wrench += wp.spatial_vector(
                    wp.vec3(joint_f[dof], joint_f[dof + 1], joint_f[dof + 2]),
                    wp.vec3(joint_f[dof + 3], joint_f[dof + 4], joint_f[dof + 5]),
                )
        return wrench

    return external_wrench


@wp.func
def report_held(worlds: WorldWork, world: int):
    """Counts a step in which a world (or a body in it) was held still, and says so once."""
    if wp.atomic_add(worlds.held, world, 1) == 0:
        wp.printf("SolverAVBD: world %d is not finite and is held still until it is reset\n", world)


@functools.cache
def make_predict(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a body: everything about a body that the sweeps need, once a step."""
    inertial_target = make_target(effects)
    external_wrench = make_wrench(effects)

    @wp.kernel(enable_backward=False, module="unique")
    def predict(
        # Model:
        model: BodyModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        joint_f: wp.array[float],
        h: float,
        history: History,
        # Work out:
        work: BodyWork,
    ):
        body = wp.tid()
        pose = body_q[body]
        velocity = body_qd[body]
        wrench = external_wrench(model, body, body_f, joint_f)
        work.finite[body] = int(is_finite(pose, velocity, wrench))
        work.com[body] = wp.transform_point(pose, model.com[body])

        if not is_mobile(model, body):
            # moves as prescribed: contacts feel its velocity, nothing moves it
            work.inv_mass[body] = 0.0
            work.inv_inertia[body] = wp.mat33(0.0)
            work.target[body] = h * velocity
            work.increment[body] = h * velocity
            return

        rotation = wp.transform_get_rotation(pose)
        target, remainder = inertial_target(model, body, pose, velocity, wrench, h)
        work.inv_mass[body] = model.inv_mass[body]
        work.target[body] = target
        if wp.static(effects.gyroscopic):
            work.inertia[body] = world_inertia(rotation, model.inertia[body])
            work.inv_inertia[body] = world_inertia(rotation, model.inv_inertia[body])
            work.spin_gain[body] = remainder
        else:
            # equal principal moments look the same from all sides
            work.inertia[body] = model.inertia[body]
            work.inv_inertia[body] = model.inv_inertia[body]
        if wp.static(effects.ramp):
            work.increment[body] = target
            return
        # Start from the share of its free acceleration that the body had in the last step (VBD,
        # section 3.7): a resting body starts at rest, a falling one at its target.
        coasting = h * velocity
        work.increment[body] = coasting + history.falling[body] * (target - coasting)

    return predict


@functools.cache
def make_integrate(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a body: the whole step where nothing touches, which is exact."""
    inertial_target = make_target(effects)
    external_wrench = make_wrench(effects)

    @wp.kernel(enable_backward=False, module="unique")
    def integrate(
        # Model:
        model: BodyModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        joint_f: wp.array[float],
        h: float,
        # Work:
        worlds: WorldWork,
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        body = wp.tid()
        pose = body_q[body]
        velocity = body_qd[body]
        wrench = external_wrench(model, body, body_f, joint_f)
        finite = is_finite(pose, velocity, wrench)
        if not finite:
            report_held(worlds, worlds.of_body[body])
        if not finite or not is_mobile(model, body):
            body_q_out[body] = pose
            body_qd_out[body] = velocity
            return
        target, remainder = inertial_target(model, body, pose, velocity, wrench, h)
        body_q_out[body] = moved_pose(pose, model.com[body], target)
        body_qd_out[body] = target / h + wp.spatial_vector(wp.vec3(0.0), remainder)

    return integrate


@wp.kernel(enable_backward=False, module="unique")
def export_acceleration(
    # State out:
    body_qd_out: wp.array[wp.spatial_vector],
    h: float,
    # Out:
    body_qdd: wp.array[wp.spatial_vector],
):
    """Turns the velocities at the start of the step, left in ``body_qdd``, into accelerations."""
    body = wp.tid()
    body_qdd[body] = (body_qd_out[body] - body_qdd[body]) / h
