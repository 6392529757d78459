# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The free axes of a joint, taken out of the block of its child one by one."""

import warp as wp

from ..blocks import tree as algebra
from ..blocks.closure import meet_axes
from ..blocks.tree import Block
from ..data import Solver, Step, TreeAxis
from ..effects import Effects
from ..rows.euler import NEAR_POLE
from ..rows.free_axes import across_first, make_free_axes
from ..rows.joint import BALL, ROD, linear_axis
from .axis_forces import FreeAxis, make_add_forces, make_ball_and_rod
from .bodies import nonnegative
from .free_ball import free_ball
from .joint_frame import JointFrame
from .slopes import make_inputs
from .tilting import eliminate_tilting

POLE_DRAG = 1.0e-3
"""Inertia that resists how the outer axes of a gimbal turn against each other at its pole, of the
body's own. It only brakes, as if they were always at rest at the start of a step."""


def make_measure_axis(effects: Effects) -> wp.Function:
    """Device function: an axis of a joint in the block of its child."""
    ahead_along = make_inputs(effects).ahead_along
    angular_axis = make_free_axes(effects.kinds).angular_axis

    @wp.func
    def axis_in_block(
        dof: int, frame: wp.ref[JointFrame], block: wp.ref[Block], s: wp.ref[Solver]
    ) -> TreeAxis:
        """An axis of the joint: how it moves the body, what that meets, and what pushes it."""
        axis = TreeAxis()
        if dof < frame.linear:
            axis.linear = frame.sign * linear_axis(s.joints, frame.joint, dof, frame.q_p)
        else:
            axis.angular = frame.sign * angular_axis(
                s.joints, frame.joint, dof - frame.linear, frame.q_p, frame.q_c, frame.known
            )
            axis.linear = wp.cross(frame.arm_c, axis.angular)
        axis.force = block.ll * axis.linear + wp.transpose(block.al) * axis.angular
        axis.torque = block.al * axis.linear + block.aa * axis.angular
        axis.push = wp.dot(axis.linear, wp.spatial_top(block.push)) + wp.dot(
            axis.angular, wp.spatial_bottom(block.push)
        )
        return axis

    @wp.func
    def own_inertia(
        body: int, dof: int, angular: wp.vec3, frame: wp.ref[JointFrame], s: wp.ref[Solver]
    ) -> float:
        """Least that an axis moves of the body itself [kg or kg m^2].

        In exact arithmetic no coordinate meets less; what heavy children add and take away again
        rounds.
        """
        own = float(s.model.mass[body])
        if dof >= frame.linear:
            across = float(1.0)
            if dof > frame.linear:
                across = across_first(angular, frame.first_axis)
            own = across / wp.trace(s.model.inv_inertia[body])
        return own

    @wp.func
    def brake_at_pole(
        body: int,
        inv_h2: float,
        free: wp.ref[FreeAxis],
        axis: wp.ref[TreeAxis],
        frame: wp.ref[JointFrame],
        s: wp.ref[Solver],
    ):
        """Brakes the last axis of a gimbal near its pole, where nothing else but armature resists
        how the outer axes turn against each other."""
        along = wp.dot(axis.angular, frame.first_axis)
        lean = wp.max(1.0 - (1.0 - along * along) / NEAR_POLE, 0.0)
        drag = wp.static(POLE_DRAG) * lean * inv_h2 / wp.trace(s.model.inv_inertia[body])
        if wp.static(effects.armature):
            drag = wp.max(drag - inv_h2 * s.joints.armature[free.index], 0.0)
        axis.push -= drag * free.moved
        free.pivot += drag

    @wp.func
    def weigh_axis(
        body: int,
        dof: int,
        inv_h2: float,
        axis: wp.ref[TreeAxis],
        frame: wp.ref[JointFrame],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> FreeAxis:
        """The stiffness of an axis by what it moves, and what is put on it."""
        free = FreeAxis()
        free.dof = dof
        free.entry = nonnegative(s.tree.axis_start[body] + dof)
        free.index = nonnegative(s.joints.dof_start[frame.joint] + dof)
        if wp.static(effects.coordinates):
            free.q = s.tree.coordinate[free.entry]
            free.moved = wp.float32(free.q - s.tree.start_coordinate[free.entry])
        pivot = wp.dot(axis.linear, axis.force) + wp.dot(axis.angular, axis.torque)
        if dof == frame.linear:
            frame.first_axis = axis.angular
        own = own_inertia(body, dof, axis.angular, frame, s)
        free.inert = wp.max(pivot, inv_h2 * own)
        free.pivot = free.inert
        if wp.static(effects.kinds.gimbals):
            if dof == frame.linear + 2:
                brake_at_pole(body, inv_h2, free, axis, frame, s)
        free.pushed = ahead_along(free.index, s.history)
        if s.joints.type[frame.joint] != ROD:
            free.pushed += step.control.joint_f[free.index]
        axis.push += free.pushed
        return free

    @wp.func
    def measure_axis(
        body: int,
        dof: int,
        inv_h2: float,
        frame: wp.ref[JointFrame],
        block: wp.ref[Block],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """An axis of the joint in the block: its motion and push, and the stiffness it meets."""
        axis = axis_in_block(dof, frame, block, s)
        free = weigh_axis(body, dof, inv_h2, axis, frame, step, s)
        return axis, free

    return measure_axis


def make_eliminate_axes(effects: Effects) -> wp.Function:
    """Device function: takes the free axes of a body's joint out of its block."""
    inputs = make_inputs(effects)
    ahead_along, keep_input = inputs.ahead_along, inputs.keep_input
    measure_axis = make_measure_axis(effects)
    add_forces = make_add_forces(effects)
    measure_ball_and_rod = make_ball_and_rod(effects)

    @wp.func
    def keep_slope(
        inv_h2: float, free: wp.ref[FreeAxis], axis: wp.ref[TreeAxis], s: wp.ref[Solver]
    ):
        """Keeps how an axis follows what drives it, for steps of second order."""
        if wp.static(effects.second_order):
            inertia = free.inert
            if wp.static(effects.armature):
                inertia += inv_h2 * s.joints.armature[free.index]
            bound_force = float(0.0)
            if wp.static(effects.effort_limits):
                bound_force = s.tree.laws[free.entry].drive
            follows = wp.where(axis.pivot > 0.0, 0.0, inertia / free.pivot)
            keep_input(free.index, inertia, follows, bound_force, inv_h2, s.history)

    @wp.func
    def release_axis(
        free: wp.ref[FreeAxis], axis: wp.ref[TreeAxis], pull: float, frame: wp.ref[JointFrame]
    ):
        """Takes an axis that nothing stiffens out of the directions along which the joint holds.

        Only roots that are light need this; see :attr:`.joint_frame.JointFrame.carried`.
        """
        if wp.static(effects.light_roots):
            if free.pivot == free.inert and axis.pivot == 0.0:
                carried = frame.carried
                pushed = float(free.pushed)
                if wp.static(effects.laws):
                    pushed += pull  # of friction that slips, or a drive at its limit
                if free.dof < frame.linear:
                    shifting, thrust = algebra.freed(
                        carried.shifting, carried.thrust, axis.linear, pushed
                    )
                    carried.shifting = shifting
                    carried.thrust = thrust
                else:
                    turning, torque = algebra.freed(
                        carried.turning, carried.torque, axis.angular, pushed
                    )
                    carried.turning = turning
                    carried.torque = torque
                frame.carried = carried

    @wp.func
    def bend_tendons(free: wp.ref[FreeAxis], frame: wp.ref[JointFrame], s: wp.ref[Solver]):
        """Adds the curvature of the paths of tendons, of which it is an upper bound."""
        if wp.static(effects.spatial_tendons):
            bent = float(s.tree.tendons.curvature[free.entry])
            free.pivot += bent
            frame.mismatch = wp.max(frame.mismatch, bent / free.pivot)

    @wp.func
    def remove_axis(
        body: int,
        pivot: float,
        axis: wp.ref[TreeAxis],
        is_fast: bool,
        block: wp.ref[Block],
        s: wp.ref[Solver],
    ):
        """Takes an axis out of the block: minimised over, or moved by the step that holds it."""
        if axis.pivot > 0.0:
            block.push -= axis.step * wp.spatial_vector(axis.force, axis.torque)
        else:
            axis.inv_pivot = 1.0 / pivot
            block = algebra.eliminated(axis, block)
        if wp.static(effects.tilting):
            if is_fast:
                block, tilting = eliminate_tilting(body, axis, block, s.tree)
                axis_step = wp.where(axis.pivot > 0.0, axis.step, axis.inv_pivot * axis.push)
                block.push -= axis_step * tilting
                axis.force -= wp.spatial_top(tilting)
                axis.torque -= wp.spatial_bottom(tilting)

    @wp.func
    def eliminate_axis(
        body: int,
        dof: int,
        recovery: float,
        h: float,
        frame: wp.ref[JointFrame],
        block: wp.ref[Block],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Takes one axis out of the block, with all that acts along it."""
        inv_h2 = 1.0 / (h * h)
        axis, free = measure_axis(body, dof, inv_h2, frame, block, step, s)
        pull = add_forces(free, axis, recovery, h, frame, step, s)
        keep_slope(inv_h2, free, axis, s)
        release_axis(free, axis, pull, frame)
        bend_tendons(free, frame, s)
        remove_axis(body, free.pivot, axis, frame.is_fast, block, s)
        s.tree.axes[free.entry] = axis

    @wp.func
    def eliminate_free_ball(
        body: int,
        h: float,
        frame: wp.ref[JointFrame],
        block: wp.ref[Block],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Takes the turns of a free ball joint out of the block, which is left about the anchor."""
        if wp.static(effects.free_balls):
            is_free = s.joints.type[frame.joint] == BALL
            if wp.static(effects.tilting):
                is_free = is_free and not frame.is_fast
            if is_free:
                first = s.joints.dof_start[frame.joint]
                reaction = wp.vec3(
                    step.control.joint_f[first] + ahead_along(first, s.history),
                    step.control.joint_f[first + 1] + ahead_along(first + 1, s.history),
                    step.control.joint_f[first + 2] + ahead_along(first + 2, s.history),
                )
                reaction = frame.sign * wp.quat_rotate(frame.q_p, reaction)
                inv_h2 = 1.0 / (h * h)
                own = inv_h2 / wp.trace(s.model.inv_inertia[body])
                first_axis = s.tree.axis_start[body]
                block = free_ball(first_axis, frame.arm_c, reaction, own, block, s.tree)
                frame.is_free = True
                frame.dofs = 0

    @wp.func
    def eliminate_axes(
        body: int,
        recovery: float,
        h: float,
        frame: wp.ref[JointFrame],
        block: wp.ref[Block],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Takes the free axes of the body's joint out of its block.

        Stores them for the substitution, and in ``frame`` what the joint carries along them.
        """
        measure_ball_and_rod(body, h, frame, step, s)
        eliminate_free_ball(body, h, frame, block, step, s)
        for dof in range(frame.dofs):
            eliminate_axis(body, dof, recovery, h, frame, block, step, s)
        if wp.static(effects.closures):
            meet_axes(body, frame.dofs, s.work, s.tree)

    return eliminate_axes
