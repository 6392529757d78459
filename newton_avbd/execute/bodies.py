# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels with one thread a body: prediction, and the whole step of bodies that touch nothing."""

import functools

import warp as wp

from ..algebra.so3 import world_inertia
from ..blocks.body import free_rotation, is_mobile, moved_pose, target_translation
from ..data import BodyModel, BodyWork, History
from ..effects import Effects


def make_target(effects: Effects):
    """The function that gives a body's inertial target: gyroscopic only where the scene needs it."""

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
        acceleration = model.gravity[model.world[body]] + model.inv_mass[body] * wp.spatial_top(
            wrench
        )
        dx = target_translation(wp.spatial_top(velocity), acceleration, h)
        if wp.static(effects.gyroscopic):
            dtheta, remainder = free_rotation(
                model.inertia[body], model.inv_inertia[body], rotation, omega, torque, h
            )
            return wp.spatial_vector(dx, dtheta), remainder, acceleration
        else:
            spun = model.inv_inertia[body] * wp.quat_rotate_inv(rotation, torque)
            dtheta = h * omega + (h * h) * wp.quat_rotate(rotation, spun)
            return wp.spatial_vector(dx, dtheta), wp.vec3(0.0), acceleration

    return inertial_target


@wp.func
def is_finite(pose: wp.transform, velocity: wp.spatial_vector, wrench: wp.spatial_vector) -> bool:
    """Whether a body's input holds no NaN and no infinity."""
    r = wp.transform_get_rotation(pose)
    return (
        wp.isfinite(wp.transform_get_translation(pose))
        and wp.isfinite(wp.vec4(r[0], r[1], r[2], r[3]))
        and wp.isfinite(velocity)
        and wp.isfinite(wrench)
    )


@functools.cache
def make_predict(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a body: everything about a body that the sweeps need, once a step."""
    inertial_target = make_target(effects)

    @wp.kernel(enable_backward=False, module="unique")
    def predict(
        # Model:
        model: BodyModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        h: float,
        history: History,
        # Work out:
        work: BodyWork,
    ):
        body = wp.tid()
        pose = body_q[body]
        velocity = body_qd[body]
        wrench = body_f[body]
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
        target, remainder, acceleration = inertial_target(
            model, body, pose, velocity, wrench, h
        )
        work.inv_mass[body] = model.inv_mass[body]
        work.inertia[body] = world_inertia(rotation, model.inertia[body])
        work.inv_inertia[body] = world_inertia(rotation, model.inv_inertia[body])
        work.target[body] = target
        if wp.static(effects.gyroscopic):
            work.spin_gain[body] = remainder
        # Start from the share of its free acceleration that the body had in the last step (VBD,
        # section 3.7): a resting body starts at rest, a falling one at its target.
        held = (1.0 - history.falling[body]) * (h * h) * acceleration
        work.increment[body] = target - wp.spatial_vector(held, wp.vec3(0.0))

    return predict


@functools.cache
def make_integrate(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a body: the whole step where nothing touches, which is exact."""
    inertial_target = make_target(effects)

    @wp.kernel(enable_backward=False, module="unique")
    def integrate(
        # Model:
        model: BodyModel,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        h: float,
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        body = wp.tid()
        pose = body_q[body]
        velocity = body_qd[body]
        if not is_mobile(model, body):
            body_q_out[body] = pose
            body_qd_out[body] = velocity
            return
        target, remainder, _acceleration = inertial_target(
            model, body, pose, velocity, body_f[body], h
        )
        body_q_out[body] = moved_pose(pose, model.com[body], target)
        body_qd_out[body] = target / h + wp.spatial_vector(wp.vec3(0.0), remainder)

    return integrate
