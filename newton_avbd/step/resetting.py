# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A reset: bodies go back to where the model has them, and all that is remembered is forgotten."""

import newton
import warp as wp

from ..data import AxisInput, AxisMotion, Flight, Solver
from ..rows.dahl import forget_dahl
from ..rows.joint import ROD
from .bodies import forget_pose
from .islands import disturb
from .kernels import KERNEL
from .slopes import JUMPED


@wp.func
def is_selected(world: int, mask: wp.array[wp.bool]) -> bool:
    """Whether a reset mask, whose last entry stands for global bodies, selects a Newton world."""
    return mask[wp.where(world < 0, mask.shape[0] - 1, world)]


@wp.func
def let_go(joint: int, s: wp.ref[Solver]):
    """Lets go what limits and friction of a joint hold, and forgets how its axes moved."""
    if joint >= 0:
        for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
            s.history.piece[dof] = wp.vec3i(0, 0, 0)
            s.history.limit_force[dof] = 0.0
            s.history.friction_force[dof] = 0.0
            if s.history.coordinate.shape[0] > 0:
                s.history.coordinate[dof] = AxisMotion()
                s.history.rate[dof] = AxisMotion()
            if s.history.input.shape[0] > 0:
                s.history.input[dof] = AxisInput()


@wp.func
def forget_joints(body: int, s: wp.ref[Solver]):
    """Forgets what the joints of a body have pushed with."""
    s.history.joint_force[body] = wp.vec3(0.0)
    s.history.acceleration[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    let_go(s.tree.joint[body], s)
    if s.loops.joints.shape[0] > 0:
        for i in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
            loop = s.loops.items[i] / 2
            s.history.loop_force[loop] = wp.vec3(0.0)
            s.history.loop_torque[loop] = wp.vec3(0.0)
            if s.history.loop_rate.shape[0] > 0:
                s.history.loop_rate[loop] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            let_go(s.loops.joints[loop], s)


@wp.func
def forget_axes(joint: int, rest_angle: wp.array[wp.float64], s: wp.ref[Solver]):
    """Mends a joint, and puts the turns of its angles back."""
    if joint >= 0:
        if s.history.broken.shape[0] > 0:
            s.history.broken[joint] = False
        if s.history.dahl_sigma.shape[0] > 0:
            if s.joints.type[joint] == ROD:
                forget_dahl(joint, s.history)
        for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
            s.history.held_at[dof] = wp.float64(0.0)
            s.history.joint_angle[dof] = rest_angle[dof]


@wp.kernel(**KERNEL)
def reset_bodies(
    rest_q: wp.array[wp.transform],
    rest_qd: wp.array[wp.spatial_vector],
    mask: wp.array[wp.bool],
    flags: int,
    rest_angle: wp.array[wp.float64],
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    s: wp.array[Solver],
):
    """Puts the bodies of the masked worlds back and forgets what held them; one thread a body."""
    body = wp.tid()
    world = s[0].model.world[body]
    if mask.shape[0] == 0:
        s[0].worlds.overflow[0] = 0
        s[0].worlds.dropped[0] = 0
    else:
        if not is_selected(world, mask):
            return
    if (flags & wp.static(int(newton.StateFlags.BODY_Q))) != 0:
        body_q[body] = rest_q[body]
    if (flags & wp.static(int(newton.StateFlags.BODY_QD))) != 0:
        body_qd[body] = rest_qd[body]
    for side in range(s[0].history.start.shape[0]):
        s[0].history.start[side, body] = 0
        s[0].history.end[side, body] = 0
    s[0].history.gained[body] = wp.vec3(0.0)
    if s[0].work.put.shape[0] > 0:
        forget_pose(body, s[0].work)
    if s[0].sleep.still.shape[0] > 0:
        disturb(body, s[0].worlds, s[0].sleep)
        s[0].sleep.end[body] = s[0].sleep.start[body]
    if s[0].tree.joint.shape[0] > 0:
        forget_joints(body, s[0])
        s[0].history.left_q[body] = wp.transform()
        s[0].history.lost[body] = wp.vec3(0.0)
        forget_axes(s[0].tree.joint[body], rest_angle, s[0])
    if s[0].loops.joints.shape[0] > 0:
        for i in range(s[0].loops.body_start[body], s[0].loops.body_start[body + 1]):
            forget_axes(s[0].loops.joints[s[0].loops.items[i] / 2], rest_angle, s[0])
    if s[0].history.flights.shape[0] > 0:
        s[0].history.flights[body] = Flight()
    if s[0].history.flying.shape[0] > 0:
        s[0].history.flying[body] = 0
        s[0].history.smooth[s[0].worlds.of_body[body]] = JUMPED
        # velocities that are given are not those of a step of second order
        s[0].worlds.step[s[0].worlds.of_body[body]] = s[0].history.step[s[0].worlds.of_body[body]]
    s[0].history.age[s[0].worlds.of_body[body]] = 0
    s[0].history.filling[s[0].worlds.of_body[body], 0] = 0
    s[0].worlds.held[s[0].worlds.of_body[body]] = 0
    s[0].worlds.repaired[s[0].worlds.of_body[body]] = 0
    s[0].worlds.bounded[s[0].worlds.of_body[body]] = 0
    s[0].worlds.excess[s[0].worlds.of_body[body]] = 0.0
    s[0].worlds.unbounded[s[0].worlds.of_body[body]] = 0
    if s[0].history.change.shape[0] > 0:
        s[0].history.change[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        s[0].worlds.inner.spent[s[0].worlds.of_body[body]] = 0.0
        s[0].worlds.inner.missed[s[0].worlds.of_body[body]] = 0
