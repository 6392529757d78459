# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How an island is slowed down to the motion that its energy balance leaves it."""

import warp as wp

from ..algebra.so3 import exp_quat
from ..blocks.body import origin_shift, renormalised
from ..data import BodyModel, Solver, Step
from ..effects import Effects
from ..functions import Functions, together
from .anchors import is_linked
from .balance import counts_here, place_from, settle
from .cable_segments import end_segment, first_segment, slot_at
from .islands import island_of
from .slopes import JUMPED


@wp.func
def moved_pose(
    body: int, pose: wp.transform, shift: wp.vec3, turn: wp.quat, model: wp.ref[BodyModel]
) -> wp.transform:
    """Pose of a body whose COM has gone by ``shift`` [m], and which has turned."""
    rotation = renormalised(turn * wp.transform_get_rotation(pose))
    move = wp.spatial_vector(shift, wp.vec3(0.0))
    place = wp.transform_get_translation(pose)
    return wp.transform(place + origin_shift(pose, model.com[body], move, rotation), rotation)


@wp.func
def scale_rotors(joint: int, share: float, step: wp.ref[Step], s: wp.ref[Solver]):
    """Scales the rates of a joint's coordinates, which armature goes on with."""
    for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
        s.history.axis_velocity[dof] = share * s.history.axis_velocity[dof]
    for end in range(2):
        body = wp.where(end == 0, s.joints.child[joint], s.joints.parent[joint])
        if body >= 0:
            if s.work.inv_mass[body] > 0.0:
                s.history.joined_qd[joint, end] = step.body_qd_out[body]


@wp.func
def drop_tensions(cluster: int, s: wp.ref[Solver]):
    """Forgets what pulls an island whose step was taken back: that is no start of the next one,
    nor does material slip by it."""
    cables = s.tree.cables
    for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
        cable = cables.cables[i]
        for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
            if cables.active[seg] == 1:
                for side in range(2):
                    slot = slot_at(seg, side, cables)
                    if s.work.inv_mass[slot] > 0.0:
                        if s.islands.balance[island_of(s.islands, slot)].is_rigid:
                            cables.tension[seg] = 0.0


def make_slowing(effects: Effects) -> Functions:
    """Device functions that decide how an island moves on, and let its bodies do so."""

    @wp.func
    def settle_island(root: int, h: float, s: wp.ref[Solver]):
        """Decides which motion is left of an island, and counts what is bounded."""
        sum = settle(s.islands.balance[root], h)
        s.islands.balance[root] = sum
        world = s.worlds.of_body[root]
        if sum.is_bounded:
            wp.atomic_add(s.worlds.bounded, world, 1)
            wp.atomic_add(s.worlds.excess, world, sum.after - wp.max(sum.before, 0.0))
            if wp.static(effects.second_order):
                s.history.smooth[world] = JUMPED
        if sum.is_pushed and sum.after > sum.before:
            wp.atomic_add(s.worlds.unbounded, world, 1)

    @wp.func
    def take_back(
        joint: int, first: int, start_coordinate: wp.array[wp.float64], s: wp.ref[Solver]
    ):
        """Puts the coordinates of a joint back to where they were before the step."""
        if wp.static(effects.coordinates):
            for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                at = first + dof - s.joints.dof_start[joint]
                s.history.joint_angle[dof] = start_coordinate[at]
                if wp.static(effects.second_order):
                    s.history.joint_angle[dof] = s.history.coordinate[dof].start

    @wp.func
    def slow_body(body: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """Gives a body the motion that is left of its island."""
        root = s.islands.parent[body]
        sum = s.islands.balance[root]
        if sum.is_rigid:
            turn = exp_quat(h * sum.angular)
            r = s.work.com[body] - s.work.com[root] - sum.start_com / sum.mass
            shift = wp.quat_rotate(turn, r) - r + h * sum.free_momentum
            pose = moved_pose(body, s.islands.start_q[body], shift, turn, s.model)
            step.body_q_out[body] = pose
            v = sum.free_momentum + wp.cross(sum.free_angular, wp.quat_rotate(turn, r))
            step.body_qd_out[body] = wp.spatial_vector(v, sum.free_angular)
            if wp.static(effects.joints):
                s.history.left_q[body] = pose
                s.history.lost[body] = wp.vec3(0.0)
                if is_linked(body, s):
                    joint = s.tree.joint[body]
                    first = s.tree.axis_start[body]
                    take_back(joint, first, s.tree.start_coordinate, s)
                if wp.static(effects.loops):
                    for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                        item = s.loops.items[k]
                        joint = s.loops.joints[item / 2]
                        if counts_here(item, joint, s):
                            first = s.joints.dof_start[joint]
                            take_back(joint, first, s.loops.start_coordinate, s)
        elif sum.is_bounded:
            r = place_from(root, body, s.work) - sum.com / sum.mass
            v = sum.free_momentum + wp.cross(sum.free_angular, r)
            velocity = wp.spatial_vector(v, sum.free_angular)
            if sum.share > 0.0:
                v = sum.momentum + wp.cross(sum.angular, r)
                inner = step.body_qd_out[body] - wp.spatial_vector(v, sum.angular)
                velocity += sum.share * inner
            step.body_qd_out[body] = velocity

    @wp.func
    def slow_rotors(body: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """After :func:`slow_body` of all bodies: scales the rotors of a body's joints."""
        sum = s.islands.balance[s.islands.parent[body]]
        share = sum.share
        if sum.is_bounded:
            if is_linked(body, s):
                scale_rotors(s.tree.joint[body], share, step, s)
            if wp.static(effects.loops):
                for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                    item = s.loops.items[k]
                    joint = s.loops.joints[item / 2]
                    if counts_here(item, joint, s):
                        scale_rotors(joint, share, step, s)

    return together(settle_island, slow_body, slow_rotors)
