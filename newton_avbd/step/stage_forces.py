# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Accelerations of bodies and joint coordinates in a stage of a Runge-Kutta step.

The same elimination from the leaves to the roots as in a sweep (:mod:`.blocks.tree`), of inertias
and of the forces of the stage as it stands: nothing is implicit. Of momenta instead of forces it
finds the velocities that joints allow and that are nearest to those of the bodies, by their kinetic
energy: the momentum stays, and the energy does not grow.
"""

import functools

import warp as wp

from ..algebra.block import factor_block, solve_block
from ..algebra.so3 import world_inertia
from ..blocks import tree as algebra
from ..blocks.tree import Block, seen_from
from ..data import Solver, Step
from ..effects import Effects
from ..functions import Functions, together
from ..rows import axis as axis_rows
from ..rows.euler import NEAR_POLE
from ..rows.free_axes import across_first
from ..rows.joint import BALL, ball_away, make_counts
from .anchors import anchor_rotation, is_linked, parent_slot
from .axes import make_axis
from .bodies import body_at, nonnegative
from .eliminate import add_to_parent, clear_children
from .smoothness import external_wrench

STIFF = wp.constant(2.0)
"""Most that springs and dampers of an axis, h^2 k + h d, may be of the inertia that it moves: from
2.8 on a Runge-Kutta step of fourth order is unstable. Axes together, and those on a light parent,
are stiffer than one whose parent is fixed; what then grows is noticed by how far stages differ."""


def make_push_along(effects: Effects) -> wp.Function:
    """Device function: what acts along an axis of a joint."""
    axes = make_axis(effects)
    linear_force, limited_drive = axes.linear_force, axes.limited_drive

    @wp.func
    def push_along(
        joint: int,
        dof: int,
        k: int,
        drive_away: wp.vec3,
        spring_away: wp.vec3,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Generalized force on the axis of entry ``k`` [N or N m], and what resists by h^2 [kg].

        That is its armature, and what springs and dampers add in a step.
        """
        index = nonnegative(s.joints.dof_start[joint] + dof)
        force = float(step.control.joint_f[index])
        resists = float(0.0)
        if wp.static(effects.coordinates):
            q = s.tree.coordinate[k]
            rate = wp.float32(s.tree.runge_kutta.rate[k])
            moved = rate * h
            pull, stiffness = linear_force(
                s.joints, step.control, joint, dof, q, moved, rate, drive_away, spring_away, h
            )
            force += pull
            resists += h * h * stiffness
            if wp.static(effects.effort_limits):
                drive, stiffness, least, most = limited_drive(
                    s.joints, step.control, joint, dof, q, moved, drive_away, h
                )
                force += wp.clamp(drive, least, most)
                if drive > least and drive < most:
                    resists += h * h * stiffness
            if wp.static(effects.joint_friction):
                # slips on as it began: where it turns round the step is given up
                began = wp.float32(s.tree.runge_kutta.start_rate[k])
                friction = axis_rows.most_friction(s.joints, joint, index)
                force -= wp.sign(began) * friction
        return force, resists

    return push_along


@functools.cache
def make_stage_forces(effects: Effects) -> Functions:
    """Device functions: the accelerations of the bodies of trees."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_gimbal = counts.is_gimbal
    push_along = make_push_along(effects)

    @wp.func
    def assemble_stage(body: int, of_momenta: bool, s: wp.ref[Solver]) -> Block:
        """Inertia of the body, what its children have handed to it, and what pushes them."""
        inertia = s.model.inertia[body]
        if wp.static(effects.gyroscopic):
            inertia = world_inertia(s.tree.rotation[body], inertia)
        wrench = wp.spatial_vector()
        if of_momenta:
            velocity = s.tree.runge_kutta.start_velocity[body]
            momentum = s.model.mass[body] * wp.spatial_top(velocity)
            wrench = wp.spatial_vector(momentum, inertia * wp.spatial_bottom(velocity))
        else:
            wrench = external_wrench(body, s)
            if wp.static(effects.gyroscopic):
                spin = wp.spatial_bottom(s.tree.runge_kutta.velocity[body])
                wrench -= wp.spatial_vector(wp.vec3(0.0), wp.cross(spin, inertia * spin))
        block = Block()
        block.ll = wp.diag(wp.vec3(s.model.mass[body])) + s.tree.h_ll[body]
        block.al = s.tree.h_al[body]
        block.aa = inertia + s.tree.h_aa[body]
        block.push = wrench + s.tree.push[body]
        clear_children(body, s)
        return block

    @wp.func
    def ball_turns(joint: int, static_slot: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """How far a ball joint is from where its drive and its spring lead it [rad]."""
        drive_away = wp.vec3(0.0)
        spring_away = wp.vec3(0.0)
        if wp.static(effects.kinds.balls and (effects.drives or effects.springs)):
            if s.joints.type[joint] == BALL:
                parent = parent_slot(s.joints, joint, static_slot)
                child = s.joints.child[joint]
                q_p = anchor_rotation(s.tree, parent, s.joints.parent_frame[joint])
                q_c = anchor_rotation(s.tree, child, s.joints.child_frame[joint])
                if wp.static(effects.drives):
                    drive_away = ball_away(step.control.target_q, s.joints, joint, q_p, q_c)
                if wp.static(effects.springs):
                    spring_away = ball_away(s.joints.rest_q, s.joints, joint, q_p, q_c)
        return drive_away, spring_away

    @wp.func
    def eliminate_linked(
        body: int,
        of_momenta: bool,
        static_slot: int,
        h: float,
        block: wp.ref[Block],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> bool:
        """Takes the axes of the body's joint out of its block, and hands that to its parent.

        Returns whether the step is short beside what springs and dampers do, and the joint is not
        near a pole.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        is_short = bool(True)
        block.push -= algebra.times_block(block.ll, block.al, block.aa, s.tree.closing[body])
        drive_away, spring_away = ball_turns(joint, static_slot, step, s)
        linear = linear_count(s.joints, joint)
        for dof in range(linear + angular_count(s.joints, joint)):
            k = nonnegative(s.tree.axis_start[body] + dof)
            axis = s.tree.axes[k]
            axis.force = block.ll * axis.linear + wp.transpose(block.al) * axis.angular
            axis.torque = block.al * axis.linear + block.aa * axis.angular
            index = s.joints.dof_start[joint] + dof
            pushed = float(0.0)
            resists = float(0.0)
            if of_momenta:
                if wp.static(effects.armature):
                    pushed = s.joints.armature[index] * s.tree.start_velocity[index]
            else:
                pushed, resists = push_along(joint, dof, k, drive_away, spring_away, h, step, s)
            axis.push = pushed + wp.dot(axis.linear, wp.spatial_top(block.push))
            axis.push += wp.dot(axis.angular, wp.spatial_bottom(block.push))
            inert = wp.dot(axis.linear, axis.force) + wp.dot(axis.angular, axis.torque)
            own = float(s.model.mass[body])
            if dof >= linear:
                own = 1.0 / wp.trace(s.model.inv_inertia[body])
            if dof > linear:
                own *= across_first(
                    axis.angular, s.tree.axes[nonnegative(k - dof + linear)].angular
                )
            # in exact arithmetic no coordinate meets less
            inert = wp.max(inert, own)
            if wp.static(effects.kinds.gimbals):
                if dof == linear + 2 and is_gimbal(s.joints, joint):
                    first = s.tree.axes[k - 2].angular
                    if wp.length_sq(wp.cross(first, axis.angular)) < NEAR_POLE:
                        is_short = False
                        inert = own
            if wp.static(effects.armature):
                rotor = s.joints.armature[index]
                inert += rotor
                resists -= rotor
            if resists > STIFF * inert:
                is_short = False
            axis.inv_pivot = 1.0 / inert
            block = algebra.eliminated(axis, block)
            s.tree.axes[k] = axis
        if s.work.inv_mass[parent] > 0.0:
            add_to_parent(parent, seen_from(s.tree.span[body], block), s)
        return is_short

    @wp.func(inline=effects.inline)
    def eliminate_stage(
        world: int,
        of_momenta: bool,
        static_slot: int,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> bool:
        """Eliminates the bodies of a world, children first; roots have their accelerations then.

        With ``of_momenta`` they are velocities, of bodies that are placed as if nothing moved.
        Returns whether the step is short beside what springs and dampers do, and no joint is near a
        pole.
        """
        is_short = bool(True)
        first = s.worlds.body_start[world]
        end = s.worlds.body_start[world + 1]
        for i in range(end - first):
            body = body_at(end - 1 - i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                block = assemble_stage(body, of_momenta, s)
                if is_linked(body, s):
                    if not eliminate_linked(body, of_momenta, static_slot, h, block, step, s):
                        is_short = False
                else:
                    factor = factor_block(block.ll, block.al, block.aa)
                    s.tree.update[body] = solve_block(
                        factor, wp.spatial_top(block.push), wp.spatial_bottom(block.push)
                    )
        return is_short

    @wp.func
    def substitute_stage(body: int, s: wp.ref[Solver]):
        """Acceleration of a body by that of its parent, and of its joint's coordinates."""
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        motion = algebra.carried(s.tree.span[body], s.tree.update[parent])
        dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
        for i in range(dofs):
            k = nonnegative(s.tree.axis_start[body] + dofs - 1 - i)
            axis = s.tree.axes[k]
            met = wp.dot(axis.force, wp.spatial_top(motion))
            met += wp.dot(axis.torque, wp.spatial_bottom(motion))
            gained = axis.inv_pivot * (axis.push - met)
            s.tree.runge_kutta.gained[k] = gained
            motion += gained * wp.spatial_vector(axis.linear, axis.angular)
        s.tree.update[body] = motion + s.tree.closing[body]

    return together(eliminate_stage, substitute_stage)
