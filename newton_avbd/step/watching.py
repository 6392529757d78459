# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What may disturb a body that sleeps: its state, forces on it, joints, tendons and gravity.

What touches it is looked at in :mod:`.step.sleeping_contacts`.
"""

import functools

import warp as wp

from ..blocks.body import is_mobile
from ..data import ControlInput, JointModel, SleepWork, Solver, Step, TendonModel, WorldWork
from ..effects import Effects
from .bodies import make_wrench, unit_pose
from .body_actuators import asked_of
from .islands import disturb
from .kernels import KERNEL, uncollected
from .sleepers import AWAKE, MOVING, STILL

REST = wp.constant(1.0e-3)
"""Speed up to which a body is at rest, as a share of what gravity gives it in a step: of
accelerations a thousandth of gravity shows, and in free space only what stands still is at rest."""
JUMP = wp.constant(1.0e-3)
"""A pose that changed by more than this, as a share of the radius of gyration or as an angle [rad],
was changed by the user."""
STANDSTILL = wp.constant(wp.spatial_vector(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


@functools.cache
@uncollected()
def make_watch_bodies(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a body: passes on what sleeps or is not moved, and sees what disturbs."""
    external_wrench = make_wrench(effects)

    @wp.func
    def watch_body(body: int, wrench: wp.spatial_vector, step: wp.ref[Step], s: wp.ref[Solver]):
        """Sees how a body moves that does not go on sleeping."""
        pose = step.body_q[body]
        velocity = step.body_qd[body]
        before = s.sleep.pose[body]
        island = s.worlds.island[body]
        is_pushed = not wrench == s.sleep.wrench[body]
        s.sleep.pose[body] = pose
        s.sleep.wrench[body] = wrench
        if island >= 0:
            disturb(body, s.worlds, s.sleep)
        if not is_mobile(s.model, body):
            if island >= AWAKE:
                s.sleep.stirred[0] = 1
            is_fixed = pose == before and velocity == STANDSTILL
            s.worlds.island[body] = wp.where(is_fixed, STILL, MOVING)
            move = step.h * wp.length(wp.spatial_top(velocity))
            wp.atomic_max(s.worlds.pace, s.worlds.of_body[body], move)
            step.body_q_out[body] = unit_pose(pose, body, s.worlds)
            step.body_qd_out[body] = velocity
            return
        if island < AWAKE:
            s.worlds.island[body] = AWAKE
            s.sleep.stirred[0] = 1
        size_sq = wp.trace(s.model.inertia[body]) * s.model.inv_mass[body]
        shift = wp.transform_get_translation(pose) - wp.transform_get_translation(before)
        turn = wp.transform_get_rotation(pose) - wp.transform_get_rotation(before)
        v = wp.spatial_top(velocity)
        w = wp.spatial_bottom(velocity)
        rest = REST * step.h * wp.length(s.model.gravity[s.model.world[body]])
        # comparisons that numbers which are not finite fail
        is_slow = wp.dot(v, v) + size_sq * wp.dot(w, w) <= rest * rest
        is_here = (
            wp.dot(shift, shift) <= JUMP * JUMP * size_sq and wp.dot(turn, turn) <= JUMP * JUMP
        )
        is_at_rest = is_slow and is_here and not is_pushed and island == AWAKE
        s.sleep.still[body] = wp.where(is_at_rest, wp.max(s.sleep.still[body], 0.0) + step.h, 0.0)

    @wp.func(inline=True)  # a call would copy all that it takes, for each body that sleeps
    def watch(body: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """Passes on a body that goes on sleeping, and looks at any other."""
        wrench = external_wrench(s.model, body, step.body_f, step.control)
        if wp.static(effects.servos):
            wrench[0] += asked_of(body, s.model)
        if s.worlds.island[body] >= 0:
            pose = step.body_q[body]
            velocity = step.body_qd[body]
            if pose == s.sleep.pose[body] and velocity == STANDSTILL:
                if wrench == s.sleep.wrench[body]:
                    step.body_q_out[body] = pose
                    step.body_qd_out[body] = velocity
                    return
        watch_body(body, wrench, step, s)

    @wp.kernel(**KERNEL)
    def watch_bodies(step: Step, s: wp.array[Solver]):
        watch(wp.tid(), step, s[0])

    return watch_bodies


@wp.kernel(**KERNEL)
def watch_joints(
    # Model:
    joints: JointModel,
    control: ControlInput,
    # Work:
    worlds: WorldWork,
    sleep: SleepWork,
):
    """Sees what is driven otherwise than in the last step, or by the user; one thread a joint."""
    joint = wp.tid()
    is_changed = bool(False)
    for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
        push = control.joint_f[dof]
        if control.pushes.shape[0] > 0:
            push += control.pushes[dof].force + control.pushes[dof].drive
        if push != sleep.joint_f[dof]:
            sleep.joint_f[dof] = push
            is_changed = True
        if control.target_qd[dof] != sleep.target_qd[dof]:
            sleep.target_qd[dof] = control.target_qd[dof]
            is_changed = True
    for i in range(joints.coord_start[joint], joints.coord_start[joint + 1]):
        if control.target_q[i] != sleep.target_q[i]:
            sleep.target_q[i] = control.target_q[i]
            is_changed = True
    static_slot = sleep.tied.shape[0] - 1
    child = joints.child[joint]
    parent = joints.parent[joint]
    parent = wp.where(parent < 0, static_slot, parent)
    if worlds.island[child] == MOVING or worlds.island[parent] == MOVING:
        is_changed = True
    if is_changed:
        disturb(child, worlds, sleep)
        disturb(parent, worlds, sleep)


@wp.kernel(**KERNEL)
def watch_tendons(
    # Model:
    tendons: TendonModel,
    # Work:
    worlds: WorldWork,
    sleep: SleepWork,
):
    """Sees what is pulled otherwise than in the last step, or by the user; one thread a tendon."""
    i = wp.tid()
    push = tendons.push[i].force + tendons.push[i].drive
    is_changed = push != sleep.pull[i]
    sleep.pull[i] = push
    for k in range(tendons.start[i], tendons.start[i + 1]):
        body = tendons.body[k]
        if body >= 0:
            is_changed = is_changed or worlds.island[body] == MOVING
    if is_changed:
        for k in range(tendons.start[i], tendons.start[i + 1]):
            if tendons.body[k] >= 0:
                disturb(tendons.body[k], worlds, sleep)


@wp.func
def watch_gravity(s: wp.ref[Solver]):
    """Disturbs the bodies whose gravity has changed."""
    is_changed = bool(False)
    for i in range(s.sleep.gravity.shape[0]):
        change = s.model.gravity[i] - s.sleep.gravity[i]
        is_changed = is_changed or not wp.dot(change, change) == 0.0
    if is_changed:
        for body in range(s.sleep.order.shape[0]):
            change = s.model.gravity[s.model.world[body]] - s.sleep.gravity[s.model.world[body]]
            if not wp.dot(change, change) == 0.0:
                disturb(body, s.worlds, s.sleep)
        for i in range(s.sleep.gravity.shape[0]):
            s.sleep.gravity[i] = s.model.gravity[i]
