# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Anchor frames of joints in the step: where they are, and what a joint is open by."""

import functools

import warp as wp

from ..algebra.so3 import turned_from
from ..blocks import tree as algebra
from ..data import BodyWork, JointModel, LoopWork, Solver, TreeWork
from .bodies import nonnegative

ROUNDING = wp.constant(5.0e-7)
"""Misfit of a joint that the poses' own rounding explains, as a share of the lengths involved."""


@wp.struct
class Anchors:
    """The anchor frames of the joint that links a body to its parent in the tree."""

    sign: float
    """1; -1 where the tree goes from the joint's child to its parent: the joint then moves the body
    by the opposite of its coordinates."""
    frame_p: wp.transform
    """Anchor frame on the body's parent in the tree."""
    frame_c: wp.transform
    """Anchor frame on the body."""
    q_p: wp.quat
    """Rotation of the anchor on the joint's parent after the increments."""
    q_c: wp.quat
    """Rotation of the anchor on the joint's child."""


@wp.func
def is_linked(body: int, s: wp.ref[Solver]) -> bool:
    """Whether the tree's joint of the body exists and is enabled."""
    joint = s.tree.joint[body]
    if joint < 0:
        return False
    return s.joints.enabled[joint]


@wp.func
def parent_slot(joints: wp.ref[JointModel], joint: int, static_slot: int) -> int:
    """Slot of the joint's parent."""
    parent = joints.parent[joint]
    return wp.where(parent < 0, static_slot, parent)


@wp.func
def is_put(slot: int, work: wp.ref[BodyWork]) -> bool:
    """Whether a body is kinematic: where it is put, which may be ahead of where it was."""
    return work.inv_mass[slot] == 0.0 and slot != work.inv_mass.shape[0] - 1


@wp.func
def joint_shift(work: wp.ref[BodyWork], slot: int) -> wp.vec3:
    """Shift of a body in the step as its joints see it [m]: a kinematic one is where it is put."""
    if work.inv_mass[slot] == 0.0:
        return wp.vec3(0.0)
    return wp.spatial_top(work.increment[slot])


@wp.func
def anchor_arm(slot: int, frame: wp.transform, static_slot: int, s: wp.ref[Solver]) -> wp.vec3:
    """From the COM of a body, moved by its increment, to an anchor on it [m], world axes.

    The static world is taken to lie at its anchor.
    """
    point = wp.transform_get_translation(frame)
    if slot == static_slot:
        return wp.vec3(0.0)
    return wp.quat_rotate(s.tree.rotation[slot], point - s.model.com[slot])


@wp.func
def anchor_rotation(tree: wp.ref[TreeWork], slot: int, frame: wp.transform) -> wp.quat:
    """Rotation of an anchor frame after the increment."""
    return tree.rotation[slot] * wp.transform_get_rotation(frame)


@wp.func
def start_span(
    body: int, parent: int, frame_p: wp.transform, static_slot: int, s: wp.ref[Solver]
) -> wp.vec3:
    """From the COM of the parent to that of the body at the start of the step [m].

    Far from the origin positions of bodies are coarse, and their difference is exact: so it is
    taken first, with what the poses' rounding has lost.
    """
    pose = s.work.pose[body]
    x = wp.transform_get_translation(pose)
    arm = wp.quat_rotate(wp.transform_get_rotation(pose), s.model.com[body])
    if parent == static_slot:
        return (x - wp.transform_get_translation(frame_p)) + (arm + s.history.lost[body])
    pose_p = s.work.pose[parent]
    arm -= wp.quat_rotate(wp.transform_get_rotation(pose_p), s.model.com[parent])
    lost = s.history.lost[body] - s.history.lost[parent]
    return (x - wp.transform_get_translation(pose_p)) + (arm + lost)


@wp.func
def anchor_offset(
    apart: wp.vec3, work: wp.ref[BodyWork], body: int, parent: int, arm_c: wp.vec3, arm_p: wp.vec3
) -> wp.vec3:
    """From the parent anchor to the child anchor after the increments [m].

    ``apart`` is what :func:`start_span` found.
    """
    moved = joint_shift(work, body) - joint_shift(work, parent)
    return (apart + (arm_c - arm_p)) + moved


@wp.func
def anchor_shift(
    child: int, parent: int, arm_c: wp.vec3, arm_p: wp.vec3, s: wp.ref[Solver]
) -> wp.vec3:
    """How far the child anchor has moved in the step against the parent's [m].

    It is read off the increments, so that it rounds as they do. What :func:`anchor_offset` gives
    rounds as the arms do, 1e-8 m of decimeters, and rows that imply each other but for the slope of
    a taut net make a hundred times as much of it.
    """
    moved = joint_shift(s.work, child) - joint_shift(s.work, parent)
    moved += turned_from(s.tree.swing[child], arm_c)
    return moved - turned_from(s.tree.swing[parent], arm_p)


@wp.func
def carried_misfit(
    parent: int, arm_p: wp.vec3, shift: wp.vec3, turn: wp.vec3, s: wp.ref[Solver]
) -> wp.spatial_vector:
    """Misfit of a joint that is not new in this step.

    A kinematic parent has been put ahead of its child by what it moves in a step; that is new.
    """
    if s.work.inv_mass[parent] == 0.0:
        ahead = algebra.carried(arm_p, s.tree.update[parent])
        return wp.spatial_vector(shift, turn) + ahead
    return wp.spatial_vector(shift, turn)


@wp.func
def loop_geometry(i: int, s: wp.ref[Solver]):
    """Rotations of a joint's anchors after the increments, arms, and child anchor from parent's."""
    static_slot = s.work.inv_mass.shape[0] - 1
    joint = s.loops.joints[i]
    child = s.joints.child[joint]
    parent = parent_slot(s.joints, joint, static_slot)
    frame_p = s.joints.parent_frame[joint]
    frame_c = s.joints.child_frame[joint]
    arm_p = anchor_arm(parent, frame_p, static_slot, s)
    arm_c = anchor_arm(child, frame_c, static_slot, s)
    offset = anchor_offset(s.loops.apart[i], s.work, child, parent, arm_c, arm_p)
    q_p = anchor_rotation(s.tree, parent, frame_p)
    q_c = anchor_rotation(s.tree, child, frame_c)
    return q_p, q_c, arm_p, arm_c, offset


@wp.func
def left_open(i: int, recovery: float, loops: wp.ref[LoopWork]) -> float:
    """Share of how far a joint was open at the start of the step that a sweep leaves.

    The motion leaves all of it, so that it does not enter the velocity; the recovery takes it out.
    """
    return wp.where(recovery > 0.0, 1.0 - loops.recovered[i], 1.0)


@functools.cache
def make_frames_of(flipped: bool) -> wp.Function:
    """Device function: the anchor frames of a joint that the tree may go through backwards."""

    @wp.func
    def frames_of(body: int, joint: int, joints: wp.ref[JointModel]):
        """Sign and frames of :class:`Anchors`, of the joint of a body."""
        sign = float(1.0)
        frame_p = joints.parent_frame[joint]
        frame_c = joints.child_frame[joint]
        if wp.static(flipped):
            if joints.child[joint] != body:
                sign = -1.0
                frame_p = joints.child_frame[joint]
                frame_c = joints.parent_frame[joint]
        return sign, frame_p, frame_c

    return frames_of


@functools.cache
def make_anchors_of(flipped: bool) -> wp.Function:
    """Device function: the anchors of a body's joint, which the tree may go through backwards."""
    frames_of = make_frames_of(flipped)

    @wp.func
    def anchors_of(body: int, s: wp.ref[Solver]) -> Anchors:
        """The anchors of the body's joint, rotated as ``tree`` has them."""
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        anchors = Anchors()
        sign, frame_p, frame_c = frames_of(body, joint, s.joints)
        anchors.sign = sign
        anchors.frame_p = frame_p
        anchors.frame_c = frame_c
        anchors.q_p = anchor_rotation(s.tree, parent, anchors.frame_p)
        anchors.q_c = anchor_rotation(s.tree, body, anchors.frame_c)
        if wp.static(flipped):
            if anchors.sign < 0.0:
                q_p = anchors.q_p
                anchors.q_p = anchors.q_c
                anchors.q_c = q_p
        return anchors

    return anchors_of
