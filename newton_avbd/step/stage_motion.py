# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies of trees by the coordinates of their joints, in a stage of a Runge-Kutta step.

A joint carries the pose of its parent to its child by its coordinates q, the velocity by their
rates q', and the acceleration by q'' and by what turns of its axes and arms add to that: with arms
r_p and r_c from the COMs to the anchor, axes s_d and spins w,

    v_c = T v_p + sum_d s_d q'_d,    a_c = T a_p + sum_d s_d q''_d + b,
    b = w_p x (w_p x r_p) - w_c x (w_c x r_c) + 2 w_p x (sum_d s_d q'_d) + ...

(Featherstone, "Rigid Body Dynamics Algorithms", chapters 4 and 5.)
"""

import functools

import warp as wp

from ..algebra.so3 import exp_quat
from ..data import Solver
from ..effects import Effects
from ..rows.angle import reduced
from ..rows.joint import linear_axis, make_counts
from .anchors import anchor_arm, make_frames_of
from .bodies import nonnegative
from .stage_axes import ball_rotation, make_stage_axes


@functools.cache
def make_place_linked(effects: Effects) -> wp.Function:
    """Device function: places a body by its joint."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_ball = make_stage_axes(effects).is_ball
    frames_of = make_frames_of(effects.flipped)

    @wp.func
    def turn_of_joint(body: int, joint: int, first: int, dofs: int, s: wp.ref[Solver]) -> wp.quat:
        """Rotation of the anchor on the joint's child against that on its parent.

        The entries of the angular axes are those from ``first`` on.
        """
        if is_ball(joint, s):
            return ball_rotation(body, first, s)
        turn = wp.quat_identity()
        index = s.joints.dof_start[joint] + linear_count(s.joints, joint)
        for dof in range(dofs):
            angle = reduced(s.tree.coordinate[first + dof])
            turn = turn * exp_quat(angle * s.joints.axis[index + dof])
        return turn

    @wp.func
    def shift_of_joint(
        joint: int, first: int, sign: float, q_p: wp.quat, s: wp.ref[Solver]
    ) -> wp.vec3:
        """From the anchor on the joint's parent to that on its child [m]; keeps the linear axes."""
        shift = wp.vec3(0.0)
        for dof in range(linear_count(s.joints, joint)):
            axis = linear_axis(s.joints, joint, dof, q_p)
            shift += wp.float32(s.tree.coordinate[first + dof]) * axis
            s.tree.axes[first + dof].linear = sign * axis
            s.tree.axes[first + dof].angular = wp.vec3(0.0)
        return shift

    @wp.func
    def turn_axes(
        joint: int,
        first: int,
        dofs: int,
        sign: float,
        q_p: wp.quat,
        arm_c: wp.vec3,
        s: wp.ref[Solver],
    ) -> wp.vec3:
        """Keeps the angular axes, each turned by those before it.

        Returns how fast the body turns against its parent [rad/s].
        """
        turned = wp.quat(q_p)
        index = s.joints.dof_start[joint] + linear_count(s.joints, joint)
        spin = wp.vec3(0.0)
        fixed = is_ball(joint, s)
        for dof in range(dofs):
            unit = s.joints.axis[index + dof]
            if fixed:
                unit = wp.vec3(0.0)
                unit[dof] = 1.0
            axis = sign * wp.quat_rotate(turned, unit)
            s.tree.axes[first + dof].angular = axis
            s.tree.axes[first + dof].linear = wp.cross(arm_c, axis)
            spin += wp.float32(s.tree.runge_kutta.rate[first + dof]) * axis
            if dof + 1 < dofs and not fixed:
                angle = reduced(s.tree.coordinate[first + dof])
                turned = turned * exp_quat(angle * unit)
        return spin

    @wp.func
    def turning_of_axes(
        joint: int, first: int, dofs: int, sign: float, holder: wp.vec3, s: wp.ref[Solver]
    ) -> wp.vec3:
        """Angular acceleration by turns of the angular axes: sum of w_d x s_d q'_d [rad/s^2].

        The first axis turns with the joint's parent, at the spin of the ``holder`` [rad/s].
        """
        if dofs == 0:
            return wp.vec3(0.0)
        spin = wp.vec3(holder)
        added = wp.vec3(0.0)
        fixed = is_ball(joint, s)
        for dof in range(dofs):
            rate = wp.float32(s.tree.runge_kutta.rate[first + dof])
            turning = rate * s.tree.axes[first + dof].angular
            added += wp.cross(spin, turning)
            if not fixed:
                spin += sign * turning
        return added

    @wp.func(inline=effects.inline)
    def place_linked(body: int, static_slot: int, s: wp.ref[Solver]):
        """Orientation, velocity and axes of a body by its joint's coordinates and rates.

        Parents go first. What turns add to its acceleration is kept as ``tree.closing``.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        first = s.tree.axis_start[body]
        linear = linear_count(s.joints, joint)
        angular = angular_count(s.joints, joint)
        turn = turn_of_joint(body, joint, first + linear, angular, s)
        sign, frame_p, frame_c = frames_of(body, joint, s.joints)
        if wp.static(effects.flipped):
            if sign < 0.0:
                turn = wp.quat_inverse(turn)
        anchor_p = s.tree.rotation[parent] * wp.transform_get_rotation(frame_p)
        anchor_c = anchor_p * turn
        rotation = anchor_c * wp.quat_inverse(wp.transform_get_rotation(frame_c))
        s.tree.rotation[body] = wp.normalize(rotation)
        q_p = wp.where(sign < 0.0, anchor_c, anchor_p)
        arm_p = anchor_arm(parent, frame_p, static_slot, s)
        arm_c = anchor_arm(body, frame_c, static_slot, s)
        shift = shift_of_joint(joint, first, sign, q_p, s)
        if sign < 0.0:
            arm_c += shift
        else:
            arm_p += shift
        s.tree.span[body] = arm_p - arm_c

        velocity_p = s.tree.runge_kutta.velocity[parent]
        spin_p = wp.spatial_bottom(velocity_p)
        spin_c = spin_p + turn_axes(joint, first + linear, angular, sign, q_p, arm_c, s)
        sliding = wp.vec3(0.0)
        for dof in range(linear):
            rate = wp.float32(s.tree.runge_kutta.rate[first + dof])
            sliding += rate * s.tree.axes[first + dof].linear
        arm_p_turns = wp.cross(spin_p, arm_p)
        arm_c_turns = wp.cross(spin_c, arm_c)
        v = wp.spatial_top(velocity_p) + arm_p_turns - arm_c_turns + sliding
        s.tree.runge_kutta.velocity[body] = wp.spatial_vector(v, spin_c)

        holder = wp.where(sign < 0.0, spin_c, spin_p)
        turning = turning_of_axes(joint, first + linear, angular, sign, holder, s)
        pulled = wp.cross(spin_p, arm_p_turns) - wp.cross(spin_c, arm_c_turns)
        pulled += 2.0 * wp.cross(holder, sliding) + wp.cross(arm_c, turning)
        s.tree.closing[body] = wp.spatial_vector(pulled, turning)

    return place_linked
