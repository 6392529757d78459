# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A reset: bodies go back to where the model has them, and all that is remembered is forgotten."""

import newton
import warp as wp

from ..data import (
    AxisMotion,
    BodyWork,
    Flight,
    History,
    JointModel,
    LoopWork,
    SleepWork,
    TreeWork,
    WorldWork,
)
from ..rows.dahl import forget_dahl
from ..rows.joint import ROD
from .bodies import forget_pose
from .islands import disturb
from .launch import KERNEL
from .slopes import JUMPED


@wp.func
def is_selected(world: int, mask: wp.array[wp.bool]) -> bool:
    """Whether a reset mask, whose last entry stands for global bodies, selects a Newton world."""
    return mask[wp.where(world < 0, mask.shape[0] - 1, world)]


@wp.func
def let_go(joint: int, joints: wp.ref[JointModel], history: wp.ref[History]):
    """Lets go what limits and friction of a joint hold."""
    if joint >= 0:
        for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
            history.piece[dof] = wp.vec3i(0, 0, 0)
            history.limit_force[dof] = 0.0
            history.friction_force[dof] = 0.0


@wp.func
def forget_joints(
    body: int,
    joints: wp.ref[JointModel],
    tree: wp.ref[TreeWork],
    loops: wp.ref[LoopWork],
    history: wp.ref[History],
):
    """Forgets what the joints of a body have pushed with."""
    history.joint_force[body] = wp.vec3(0.0)
    history.acceleration[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    let_go(tree.joint[body], joints, history)
    if loops.joints.shape[0] > 0:
        for i in range(loops.body_start[body], loops.body_start[body + 1]):
            loop = loops.items[i] / 2
            history.loop_force[loop] = wp.vec3(0.0)
            history.loop_torque[loop] = wp.vec3(0.0)
            let_go(loops.joints[loop], joints, history)


@wp.func
def forget_axes(
    joint: int,
    joints: wp.ref[JointModel],
    rest_angle: wp.array[wp.float64],
    history: wp.ref[History],
):
    """Mends a joint, and puts the turns of its angles back."""
    if joint >= 0:
        if history.broken.shape[0] > 0:
            history.broken[joint] = False
        if history.dahl_sigma.shape[0] > 0:
            if joints.type[joint] == ROD:
                forget_dahl(joint, history)
        for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
            history.held_at[dof] = wp.float64(0.0)
            if history.coordinate.shape[0] > 0:
                history.coordinate[dof] = AxisMotion()
            history.joint_angle[dof] = rest_angle[dof]


@wp.kernel(**KERNEL)
def reset_bodies(
    # Model:
    body_world: wp.array[wp.int32],
    rest_q: wp.array[wp.transform],
    rest_qd: wp.array[wp.spatial_vector],
    # In:
    mask: wp.array[wp.bool],
    flags: int,
    worlds: WorldWork,
    joints: JointModel,
    tree: TreeWork,
    loops: LoopWork,
    rest_angle: wp.array[wp.float64],
    sleep: SleepWork,
    # Work out:
    work: BodyWork,
    # Out:
    history: History,
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
):
    """Puts the bodies of the masked worlds back and forgets what held them; one thread a body."""
    body = wp.tid()
    world = body_world[body]
    if mask.shape[0] == 0:
        worlds.overflow[0] = 0
        worlds.dropped[0] = 0
    else:
        if not is_selected(world, mask):
            return
    if (flags & wp.static(int(newton.StateFlags.BODY_Q))) != 0:
        body_q[body] = rest_q[body]
    if (flags & wp.static(int(newton.StateFlags.BODY_QD))) != 0:
        body_qd[body] = rest_qd[body]
    for side in range(history.start.shape[0]):
        history.start[side, body] = 0
        history.end[side, body] = 0
    history.falling[body] = 0.0
    if work.put.shape[0] > 0:
        forget_pose(body, work)
    if sleep.still.shape[0] > 0:
        disturb(body, worlds, sleep)
        sleep.end[body] = sleep.start[body]
    if tree.joint.shape[0] > 0:
        forget_joints(body, joints, tree, loops, history)
        history.left_q[body] = wp.transform()
        history.lost[body] = wp.vec3(0.0)
        forget_axes(tree.joint[body], joints, rest_angle, history)
    if loops.joints.shape[0] > 0:
        for i in range(loops.body_start[body], loops.body_start[body + 1]):
            forget_axes(loops.joints[loops.items[i] / 2], joints, rest_angle, history)
    if history.flights.shape[0] > 0:
        history.flights[body] = Flight()
    if history.flying.shape[0] > 0:
        history.flying[body] = 0
        history.smooth[worlds.of_body[body]] = JUMPED
        # velocities that are given are not those of a step of second order
        worlds.step[worlds.of_body[body]] = history.step[worlds.of_body[body]]
    history.age[worlds.of_body[body]] = 0
    history.filling[worlds.of_body[body], 0] = 0
    worlds.held[worlds.of_body[body]] = 0
    worlds.repaired[worlds.of_body[body]] = 0
    worlds.bounded[worlds.of_body[body]] = 0
    worlds.excess[worlds.of_body[body]] = 0.0
    worlds.unbounded[worlds.of_body[body]] = 0
    if history.change.shape[0] > 0:
        history.change[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        worlds.inner.spent[worlds.of_body[body]] = 0.0
        worlds.inner.missed[worlds.of_body[body]] = 0
