# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How the joint of a body stands as an iteration eliminates it: arms, axes, and what closes it."""

import functools

import warp as wp

from ..data import Solver
from ..effects import Effects
from ..rows.euler import make_euler
from ..rows.joint import make_counts
from ..rows.lock import make_locks
from .anchors import anchor_arm, anchor_offset, anchor_shift, is_put, make_anchors_of
from .bodies import nonnegative
from .rotations import relative_turn


@wp.struct
class Carried:
    """What a joint hands on to its parent: projections, and loads along what it leaves free."""

    shifting: wp.mat33
    """Projects on the directions along which the joint holds shifts."""
    turning: wp.mat33
    """The same of turns."""
    thrust: wp.vec3
    """What the joint carries along the other directions [N]."""
    torque: wp.vec3
    """Likewise of torques [N m]."""


@wp.struct
class JointFrame:
    """The joint of a body in an elimination."""

    joint: int
    parent: int
    """Slot of the body's parent in the tree."""
    linear: int
    """Linear axes of the joint."""
    dofs: int
    """All of its axes."""
    is_fast: bool
    """Whether a body of the tree turns fast, so that spins resist being tilted."""
    is_free: bool
    """Whether a ball joint was eliminated at once, see :mod:`.step.free_ball`."""
    sign: float
    q_p: wp.quat
    q_c: wp.quat
    """As in :class:`.anchors.Anchors`."""
    arm_p: wp.vec3
    """From the COM of the parent to the anchor, joint closed [m]."""
    arm_c: wp.vec3
    """From the COM of the body to its anchor [m]."""
    known: wp.vec3
    """Angles of a gimbal [rad]."""
    closing: wp.spatial_vector
    """Motion of the body that closes the joint, about its COM [m, rad]."""
    mismatch: float
    """How far off the geometric stiffness and the curvature of tendons may be, as a share of the
    block."""
    first_axis: wp.vec3
    """First of the angular axes."""
    drive_away: wp.vec3
    """Turn of a ball joint away from where its drive leads it [rad]."""
    spring_away: wp.vec3
    """The same of its spring."""
    rod_torque: wp.vec3
    """What the bend and twist of a rod push with [N m]."""
    rod_stiffness: wp.vec3
    """How much more by a turn about each of its angular axes [N m/rad]."""
    carried: Carried
    """What it hands on; only light roots need that."""


@functools.cache
def make_joint_frame(effects: Effects) -> wp.Function:
    """Device function: the joint of a body as it stands in an iteration."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_gimbal = counts.is_gimbal
    euler = make_euler(effects.kinds)
    gimbal_tilt, is_led = euler.gimbal_tilt, euler.is_led
    known_angles = euler.known_angles
    locks = make_locks(effects.kinds)
    linear_misfit, angular_misfit = locks.linear_misfit, locks.angular_misfit
    locked_shift, locked_turn = locks.locked_shift, locks.locked_turn
    anchors_of = make_anchors_of(effects.flipped)

    @wp.func
    def opened_by(
        body: int,
        kept: wp.spatial_vector,
        is_new: bool,
        frame: wp.ref[JointFrame],
        s: wp.ref[Solver],
    ) -> wp.vec3:
        """How far the anchors are to go together [m], world axes.

        What the joint opens in the step is read off the increments, which round less than arms and
        axes do. Moves the anchor on the parent along the free axes to that on the child.
        """
        parent = frame.parent
        left = wp.vec3(0.0)
        if frame.linear == 0 and not is_put(parent, s.work):
            left = anchor_shift(body, parent, frame.arm_c, frame.arm_p, s)
            left += wp.spatial_top(s.tree.misfit[body] - kept)
        else:
            offset = anchor_offset(
                s.tree.apart[body], s.work, body, parent, frame.arm_c, frame.arm_p
            )
            misfit = linear_misfit(s.joints, frame.joint, frame.q_p, offset)
            left = misfit - wp.spatial_top(kept)
            if is_new:
                shift = anchor_shift(body, parent, frame.arm_c, frame.arm_p, s)
                holder = wp.where(frame.sign < 0.0, body, parent)
                swing = s.tree.swing[holder]
                left = locked_shift(s.joints, frame.joint, frame.q_p, swing, shift, offset)
            frame.arm_p += offset - misfit
        return left

    @wp.func
    def tilted_by(
        body: int,
        kept: wp.spatial_vector,
        is_new: bool,
        frame: wp.ref[JointFrame],
        s: wp.ref[Solver],
    ) -> wp.vec3:
        """How far the body is to turn back against its parent [rad], world axes."""
        joint = frame.joint
        tilt = wp.vec3(0.0)
        if is_new:
            turn = relative_turn(body, frame.parent, s.tree)
            if wp.static(effects.flipped):
                if frame.sign < 0.0:
                    turn = wp.quat_inverse(turn)
            tilt = frame.sign * locked_turn(s.joints, joint, frame.q_p, frame.q_c, turn)
        else:
            tilt = frame.sign * angular_misfit(s.joints, joint, frame.q_p, frame.q_c)
            tilt -= wp.spatial_bottom(kept)
        if wp.static(effects.kinds.gimbals):
            if is_gimbal(s.joints, joint):
                tilt = wp.vec3(0.0)
                if is_led(s.joints, joint, frame.known):
                    tilt = frame.sign * gimbal_tilt(
                        s.joints, joint, frame.q_p, frame.q_c, frame.known
                    )
                    tilt -= wp.spatial_bottom(kept)
        return tilt

    @wp.func
    def joint_frame(body: int, recovery: float, s: wp.ref[Solver]) -> JointFrame:
        """The body's joint; stores what substitution needs of it.

        Sweeps leave the misfit of the start of the step alone, and the recovery closes it.
        """
        static_slot = s.work.inv_mass.shape[0] - 1
        anchors = anchors_of(body, s)
        frame = JointFrame()
        frame.joint = nonnegative(s.tree.joint[body])
        frame.parent = nonnegative(s.tree.parent[body])
        frame.linear = linear_count(s.joints, frame.joint)
        frame.dofs = frame.linear + angular_count(s.joints, frame.joint)
        if wp.static(effects.tilting):
            frame.is_fast = s.tree.is_fast[body]
        frame.sign = anchors.sign
        frame.q_p = anchors.q_p
        frame.q_c = anchors.q_c
        frame.arm_p = anchor_arm(frame.parent, anchors.frame_p, static_slot, s)
        frame.arm_c = anchor_arm(body, anchors.frame_c, static_slot, s)
        if wp.static(effects.kinds.gimbals):
            start = s.tree.axis_start[body]
            frame.known = known_angles(s.joints, frame.joint, s.tree.coordinate, start)
        kept = wp.where(recovery > 0.0, 0.0, 1.0) * s.tree.misfit[body]
        is_new = recovery == 0.0 and not is_put(frame.parent, s.work)
        left = opened_by(body, kept, is_new, frame, s)
        tilt = tilted_by(body, kept, is_new, frame, s)
        frame.closing = wp.spatial_vector(wp.cross(tilt, frame.arm_c) - left, -tilt)
        if wp.static(effects.light_roots):
            frame.carried.shifting = wp.identity(n=3, dtype=float)
            frame.carried.turning = wp.identity(n=3, dtype=float)
        s.tree.closing[body] = frame.closing
        s.tree.span[body] = frame.arm_p - frame.arm_c
        return frame

    return joint_frame
