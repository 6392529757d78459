# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Worlds whose numbers are not finite: told from the others, and held still."""

import warp as wp

from ..data import ControlInput, JointModel, Solver, Step, TreeWork
from ..effects import Effects
from .bodies import body_at, report_held, vector_sum
from .resetting import forget_joints
from .slopes import JUMPED


def make_is_world_finite(effects: Effects) -> wp.Function:
    """Device function: whether all bodies and joints of the world came with finite input."""

    @wp.func
    def joint_sum(joint: int, joints: wp.ref[JointModel], control: wp.ref[ControlInput]) -> wp.vec3:
        """Sums of the numbers that make a joint and drive it: finite when they are."""
        parent = joints.parent_frame[joint]
        child = joints.child_frame[joint]
        turn = wp.transform_get_rotation(parent) + wp.transform_get_rotation(child)
        frames = wp.transform_get_translation(parent) + wp.transform_get_translation(child)
        frames += wp.vec3(turn[0] + turn[3], turn[1], turn[2])
        total = float(0.0)
        for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
            frames += joints.axis[dof]
            total += control.joint_f[dof]
            if wp.static(effects.drives):
                total += joints.target_ke[dof] + joints.target_kd[dof] + control.target_qd[dof]
            if wp.static(effects.pushed_axes):
                total += control.pushes[dof].force + control.pushes[dof].drive
            if wp.static(effects.springs):
                total += joints.stiffness[dof] + joints.damping[dof]
            if wp.static(effects.armature):
                total += joints.armature[dof]
            if wp.static(effects.joint_friction):
                total += joints.friction[dof]
        if wp.static(effects.drives):
            for i in range(joints.coord_start[joint], joints.coord_start[joint + 1]):
                total += control.target_q[i]
        if wp.static(effects.mimics):
            total += joints.mimic_coefficients[joint][0] + joints.mimic_coefficients[joint][1]
        return frames + wp.vec3(total, 0.0, 0.0)

    @wp.func
    def pull_sum(first: int, tree: wp.ref[TreeWork]) -> float:
        """Sum of what pulls the tendons of the block that starts at a place in visiting order."""
        total = float(0.0)
        number = tree.closures.block_of[first]
        if number >= 0:
            block = tree.closures.blocks[number]
            for c in range(block.first, block.end):
                i = tree.closures.closures[c].tendon
                if i >= 0:
                    row = tree.tendons.row[i]
                    push = tree.tendons.push[i]
                    total += push.force + push.stiffness + push.damping + push.drive
                    total += tree.tendons.stiffness[row] + tree.tendons.damping[row]
                    total += tree.tendons.velocity[i]
        return total

    @wp.func
    def is_world_finite(world: int, step: wp.ref[Step], s: wp.ref[Solver]) -> bool:
        total = wp.vec3(0.0)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.finite[body] == 0:
                return False
            if wp.static(effects.joints):
                if s.tree.joint[body] >= 0:
                    total += joint_sum(s.tree.joint[body], s.joints, step.control)
            if wp.static(effects.tendons):
                total += wp.vec3(pull_sum(i, s.tree), 0.0, 0.0)
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                total += joint_sum(s.loops.joints[i], s.joints, step.control)
        return wp.isfinite(total)

    return is_world_finite


@wp.func
def is_solution_finite(world: int, s: wp.ref[Solver]) -> bool:
    """Whether the sweeps ended in finite increments."""
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        if not wp.isfinite(vector_sum(s.work.increment[body_at(i, s.worlds)])):
            return False
    return True


@wp.func
def hold_world(
    world: int, body_qd: wp.array[wp.spatial_vector], step: wp.ref[Step], s: wp.ref[Solver]
):
    """Passes a world through unchanged, counts it, and forgets its contacts and what its joints
    pushed with: that may not be finite, either."""
    report_held(s.worlds, s.worlds.of_body[body_at(s.worlds.body_start[world], s.worlds)])
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = body_at(i, s.worlds)
        step.body_q_out[body] = s.work.pose[body]
        step.body_qd_out[body] = body_qd[body]
        s.rows.owned_end[body] = s.rows.owned_start[body]
        s.history.gained[body] = wp.vec3(0.0)
        for side in range(s.history.start.shape[0]):
            s.history.start[side, body] = 0
            s.history.end[side, body] = 0
        if s.tree.joint.shape[0] > 0:
            forget_joints(body, s)
    if s.history.smooth.shape[0] > 0:
        s.history.smooth[world] = JUMPED
    s.history.age[world] = 0
    s.history.filling[world, 0] = 0
    # all worlds stay on the same side: their records lie in one array
    if s.history.next_side.shape[0] > 0:
        s.history.parity[world] = s.history.next_side[world]
    else:
        s.history.parity[world] = 1 - s.history.parity[world]
