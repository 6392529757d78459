# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints outside of trees, held by multipliers and a penalty, as contacts are.

Those are the joints that close loops, DISTANCE joints, and with ``blocks="body"`` all joints. What
is solved with a tree (``is_exact``, see :mod:`.step.closures`) has no penalty. Of the others, with
the misfit e = (e_l, e_a) beyond that of the start of the step, a joint pushes its child with

    F = P_l lambda_l - k_l e_l at the anchor,   tau = P_a lambda_a - k_a e_a,

where P projects to what the joint locks, and its parent with the opposite. The dual update is
lambda <- F, tau, after each sweep. What acts along its free axes, drives and limits, is
rows of one dimension: friction and stops have multipliers, too.

How a joint stands at the start of a step is in :mod:`.step.loop_start`, what acts along its free
axes in :mod:`.step.loop_axes`, the law of a DISTANCE joint in :mod:`.step.distances`.
"""

import warp as wp

from ..blocks.tree import geometric_stiffness
from ..data import LoopWork, Solver, Step
from ..effects import Effects
from ..functions import Functions, together
from ..rows.contact import PENALTY
from ..rows.coordinate import make_joint_coordinates
from ..rows.euler import make_euler
from ..rows.free_axes import make_free_axes
from ..rows.joint import DISTANCE, ROD, is_string, make_counts
from ..rows.lock import make_locks
from ..rows.rod import rod_stiffness, rod_torque
from .anchors import left_open, loop_geometry
from .distances import beyond_bounds, distance_force, string_direction
from .loop_axes import BallAway, make_loop_axes
from .loop_start import make_begin_loop


@wp.func
def has_loops(loops: wp.ref[LoopWork], body: int) -> bool:
    """Whether a joint outside of the trees acts on the body."""
    return loops.body_start[body] < loops.body_start[body + 1]


@wp.func
def other_end(item: int, s: wp.ref[Solver]) -> int:
    """The other body of a joint outside of trees, -1 for the world; ``item`` says which joint."""
    joint = s.loops.joints[item / 2]
    return wp.where(item % 2 == 0, s.joints.parent[joint], s.joints.child[joint])


@wp.func
def has_outer_loops(body: int, loops: wp.ref[LoopWork]) -> bool:
    """Whether a joint acts on the body that is not solved with its tree."""
    for k in range(loops.body_start[body], loops.body_start[body + 1]):
        if not loops.is_exact[loops.items[k] / 2]:
            return True
    return False


@wp.func
def ties(i: int, s: wp.ref[Solver]) -> bool:
    """Whether a joint outside of the trees makes one island of its bodies: no slack string does."""
    joint = s.loops.joints[i]
    if is_string(s.joints, joint):
        return wp.length_sq(s.history.loop_force[i]) > 0.0
    return s.joints.enabled[joint]


def make_loops(effects: Effects) -> Functions:
    """Device functions: how a joint stands, its wrench on its child, its share of a block."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    known_angles = make_euler(effects.kinds).known_angles
    locks = make_locks(effects.kinds)
    linear_misfit, linear_lock = locks.linear_misfit, locks.linear_lock
    angular_misfit, angular_lock = locks.angular_misfit, locks.angular_lock
    axis_of = make_free_axes(effects.kinds).axis_of
    angles = make_joint_coordinates(effects.kinds).angles
    loop_axes = make_loop_axes(effects)
    coordinate_of, axis_force = loop_axes.coordinate_of, loop_axes.axis_force
    away_of, count_turns = loop_axes.away_of, loop_axes.count_turns
    begin_loop = make_begin_loop(effects)

    @wp.func(inline=effects.inline)
    def loop_wrench(
        i: int,
        recovery: float,
        h: float,
        has_dual: bool,
        is_whole: bool,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Force [N] at the anchor and torque [N m] of a joint on its child, and the two arms [m].

        With ``has_dual`` they become the joint's multipliers. What a joint locks whose rows are
        solved with the tree counts only if ``is_whole``: otherwise its rows are to find it.
        """
        joint = s.loops.joints[i]
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        if s.loops.k_l[i] == 0.0:
            return wp.vec3(0.0), wp.vec3(0.0), arm_c, arm_p
        if wp.static(effects.kinds.distances):
            if is_string(s.joints, joint):
                along = string_direction(q_p, arm_c, offset)
                pull = wp.dot(s.history.loop_force[i], along)
                if s.loops.is_exact[i]:
                    pull = wp.where(is_whole, pull, 0.0)
                elif has_dual or not is_whole:
                    pull = distance_force(i, wp.length(offset), pull, recovery, s)
                if has_dual:
                    s.history.loop_force[i] = pull * along
                return pull * along, wp.vec3(0.0), arm_c, arm_p
        shift = linear_misfit(s.joints, joint, q_p, offset)
        arm_p += offset - shift
        turn = angular_misfit(s.joints, joint, q_p, q_c)
        kept = left_open(i, recovery, s.loops) * s.loops.misfit[i]
        force = linear_misfit(s.joints, joint, q_p, s.history.loop_force[i])
        torque = angular_lock(s.joints, joint, q_p, q_c) * s.history.loop_torque[i]
        if not s.loops.is_exact[i]:
            force -= s.loops.k_l[i] * (shift - wp.spatial_top(kept))
            torque -= s.loops.k_a[i] * (turn - wp.spatial_bottom(kept))
        if has_dual:
            s.history.loop_force[i] = force
            s.history.loop_torque[i] = torque
        if s.loops.is_exact[i] and not is_whole:
            force = wp.vec3(0.0)
            torque = wp.vec3(0.0)
        if s.joints.type[joint] == DISTANCE:
            return force, torque, arm_c, arm_p
        linear = linear_count(s.joints, joint)
        started = known_angles(s.joints, joint, s.loops.start_coordinate, s.joints.dof_start[joint])
        turned = angles(s.joints, joint, q_p, q_c, started, False)
        response = wp.vec3(0.0)
        away = away_of(joint, q_p, q_c, step, s)
        share = recovery * s.loops.recovered[i]
        for dof in range(linear + angular_count(s.joints, joint)):
            index = s.joints.dof_start[joint] + dof
            known = s.loops.start_coordinate[index]
            q = coordinate_of(i, dof, q_p, q_c, offset, known, s)
            push, _, friction, stop = axis_force(i, dof, q, away, share, h, step, s)
            if is_whole or not s.loops.is_exact[i]:
                push += stop
            if has_dual:
                s.history.limit_force[index] = stop
                if recovery == 0.0:
                    if wp.static(effects.joint_friction):
                        s.history.friction_force[index] = friction
                    s.loops.coordinate[index] = q
            axis = axis_of(s.joints, joint, dof, q_p, q_c, turned)
            if s.joints.type[joint] == ROD and s.loops.is_exact[i] and not is_whole:
                continue
            if dof < linear:
                force += push * axis
            elif s.joints.type[joint] == ROD:
                response[dof - linear] = push
            else:
                torque += push * axis
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                torque += rod_torque(q_p, q_c, response)
        return force, torque, arm_c, arm_p

    @wp.func(inline=effects.inline)
    def loop_curvature(item: int, doubled: bool, h: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """What a joint adds to the block of one of its bodies: H_ll, H_al and H_aa."""
        i = item / 2
        joint = s.loops.joints[i]
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        shift = linear_misfit(s.joints, joint, q_p, offset)
        arm = arm_c
        sign = float(1.0)
        if item % 2 == 1:
            arm = arm_p + (offset - shift)
            sign = -1.0
        linear_k = wp.mat33(0.0)
        angular_k = wp.mat33(0.0)
        is_soft = not s.loops.is_exact[i]
        if is_soft:
            linear_k = s.loops.k_l[i] * linear_lock(s.joints, joint, q_p)
            angular_k = s.loops.k_a[i] * angular_lock(s.joints, joint, q_p, q_c)
        pulled = wp.mat33(0.0)
        if s.joints.type[joint] == DISTANCE:
            length = wp.length(offset)
            reach = s.loops.reach[i]
            along = string_direction(q_p, arm_c, offset)
            held = wp.dot(s.history.loop_force[i], along)
            beyond = beyond_bounds(i, s)
            if is_soft and (
                distance_force(i, length + reach, held, 0.0, s) != 0.0
                or distance_force(i, length - reach, held, 0.0, s) != 0.0
            ):
                # what takes out of the length what is beyond its bounds
                beyond *= s.loops.recovered[i]
                held -= (s.loops.k_l[i] / PENALTY) * beyond
                shortest = wp.min(length, length - beyond)
                curvature = wp.outer(along, along)
                if shortest < reach:
                    # within the step it may come to point anywhere
                    curvature = wp.identity(n=3, dtype=float)
                linear_k += s.loops.k_l[i] * curvature
                # what pulls turns with the string
                square = wp.identity(n=3, dtype=float) - wp.outer(along, along)
                linear_k += (wp.max(-held, 0.0) / wp.max(shortest, reach)) * square
                pulled = geometric_stiffness((sign * held) * along, arm)
        elif s.loops.k_l[i] > 0.0:
            linear = linear_count(s.joints, joint)
            started = known_angles(
                s.joints, joint, s.loops.start_coordinate, s.joints.dof_start[joint]
            )
            turned = angles(s.joints, joint, q_p, q_c, started, False)
            stiff = wp.vec3(0.0)
            for dof in range(linear + angular_count(s.joints, joint)):
                index = s.joints.dof_start[joint] + dof
                known = s.loops.start_coordinate[index]
                q = coordinate_of(i, dof, q_p, q_c, offset, known, s)
                share = s.loops.recovered[i]
                _, stiffness, _, _ = axis_force(i, dof, q, BallAway(), share, h, step, s)
                if s.joints.type[joint] == ROD and s.loops.is_exact[i]:
                    continue
                is_soft = is_soft or stiffness > 0.0
                axis = axis_of(s.joints, joint, dof, q_p, q_c, turned)
                if dof < linear:
                    linear_k += stiffness * wp.outer(axis, axis)
                elif s.joints.type[joint] == ROD:
                    stiff[dof - linear] = stiffness
                else:
                    angular_k += stiffness * wp.outer(axis, axis)
            if wp.static(effects.rods):
                if s.joints.type[joint] == ROD:
                    bound = rod_stiffness(q_p, q_c, stiff)
                    for dof in range(3):
                        axis = axis_of(s.joints, joint, linear + dof, q_p, q_c, turned)
                        angular_k += bound[dof] * wp.outer(axis, axis)
        s.loops.is_soft[i] = is_soft
        if doubled:
            linear_k *= 2.0
            angular_k *= 2.0
        r = wp.skew(arm)
        al = r * linear_k
        aa = al * wp.transpose(r) + angular_k
        if not s.loops.is_exact[i]:
            aa += geometric_stiffness(sign * s.history.loop_force[i], arm) + pulled
        return linear_k, al, aa

    @wp.func
    def keep_motion(i: int, s: wp.ref[Solver]):
        """Before the recovery: what joints have pushed with, and how those that give way moved."""
        s.loops.kept_force[i] = s.history.loop_force[i]
        s.loops.kept_torque[i] = s.history.loop_torque[i]
        if wp.static(effects.hard_limits):
            joint = s.loops.joints[i]
            for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                s.loops.kept_stop[dof] = s.history.limit_force[dof]
        if wp.static(effects.yielding):
            if s.loops.gives[i][0] + s.loops.gives[i][1] > 0.0:
                joint = s.loops.joints[i]
                q_p, q_c, _arm_p, _arm_c, offset = loop_geometry(i, s)
                shift = linear_misfit(s.joints, joint, q_p, offset)
                turn = angular_misfit(s.joints, joint, q_p, q_c)
                moved = wp.spatial_vector(shift, turn) - s.loops.misfit[i]
                s.history.loop_rate[i] = moved / s.loops.span[i]

    @wp.func
    def give_back_forces(i: int, s: wp.ref[Solver]):
        """After the recovery: joints push with what they had before it."""
        s.history.loop_force[i] = s.loops.kept_force[i]
        s.history.loop_torque[i] = s.loops.kept_torque[i]
        if wp.static(effects.hard_limits):
            joint = s.loops.joints[i]
            for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                s.history.limit_force[dof] = s.loops.kept_stop[dof]
        count_turns(i, s)

    return together(
        loop_wrench, loop_curvature, keep_motion, give_back_forces, begin_loop=begin_loop
    )
