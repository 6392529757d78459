# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How a joint outside of trees stands at the start of a step, and how stiff it is held."""

import warp as wp

from ..data import JointModel, Solver, WorldScale
from ..effects import Effects
from ..rows.axis import impedance_at
from ..rows.contact import PENALTY
from ..rows.coordinate import make_joint_coordinates
from ..rows.euler import make_euler
from ..rows.joint import BALL, DISTANCE, make_counts
from ..rows.lock import make_locks
from .anchors import ROUNDING, carried_misfit, loop_geometry, parent_slot, start_span
from .distances import beyond_bounds
from .slopes import begin_axis

FADING = wp.constant(0.1)
"""Turn in a step from which rows that are solved with a tree are not pulled towards what they last
pushed with [rad], and in proportion before: that would turn against others. Besides, rounding adds
about a tenth a step to what rows push each other with that imply each other: where bodies turn, a
step takes sweeps that are that stiff.
"""
MOST_TURNED = wp.constant(0.2)
"""By how much closing an open joint may turn its bodies, or a string, in a step [rad], unless it is
solved with a tree: blocks stay those of the start of the step, and what turns further diverges."""


@wp.func
def mean_inverse(inv_inertia: wp.mat33) -> float:
    """What a torque does to the spin, in the mean over all directions [1/(kg m^2)]."""
    return wp.static(1 / 3) * wp.trace(inv_inertia)


@wp.func
def share_recovered(
    shift: float,
    turn: float,
    length: float,
    arm_c: wp.vec3,
    arm_p: wp.vec3,
    child: int,
    parent: int,
    s: wp.ref[Solver],
) -> float:
    """Share of an open joint that a step closes: what turns nothing by :data:`MOST_TURNED`.

    Args:
        shift: How far the joint is open [m].
        turn: By what angle [rad].
        length: What a DISTANCE joint is to have then [m]; infinite for others.
        arm_c: From the COM of the child to its anchor [m].
        arm_p: Likewise of the parent.
        child: Slot of the child.
        parent: Slot of the parent.
        s: The solver.
    """
    turns_c = mean_inverse(s.work.inv_inertia[child])
    turns_p = mean_inverse(s.work.inv_inertia[parent])
    yields = s.work.inv_mass[child] + turns_c * wp.length_sq(arm_c)
    yields += s.work.inv_mass[parent] + turns_p * wp.length_sq(arm_p)
    rate = wp.max(turns_c * wp.length(arm_c), turns_p * wp.length(arm_p)) / yields
    joints_c = s.loops.body_start[child + 1] - s.loops.body_start[child]
    joints = wp.max(joints_c, s.loops.body_start[parent + 1] - s.loops.body_start[parent])
    if joints > 1:
        # others pull the string aside
        rate = float(joints) * wp.max(rate, 1.0 / wp.max(length, 1.0e-12))
    return wp.min(1.0, MOST_TURNED / wp.max(rate * shift + turn, 1.0e-30))


@wp.func
def beyond_limit(joints: wp.ref[JointModel], dof: int, at: float, rounding: float) -> float:
    """How far a coordinate is beyond its limits, by more than rounding [m or rad]."""
    beyond = wp.max(joints.limit_lower[dof] - at, at - joints.limit_upper[dof])
    return wp.where(beyond > rounding, beyond, 0.0)


@wp.func
def begin_yielding(i: int, h: float, s: wp.ref[Solver]):
    """How far a joint that gives way moves in the step without a push, and by how much a push does.

    MuJoCo's law ("Constraint model"), with all of it at the end of the step: of the misfit e

        F = -d/((1 - d) A) (a + b v + k e),  v = moved/h,  a = (v - v_0)/h,  e = e_0 + moved,

    and k = d K. So moved + (1 - d) A h^2/(d (1 + h b + h^2 k)) F = (h v_0 - h^2 k e_0)/(1 + ...).
    """
    law = s.loops.yielding[i]
    opened = s.loops.misfit[i]
    turned = wp.spatial_bottom(opened) / law[2]
    far = wp.length_sq(wp.spatial_top(opened)) + wp.length_sq(turned)
    share = impedance_at(s.loops.impedance[i], wp.sqrt(far))
    pull = h * h * share * law[0]
    held = 1.0 + h * law[1] + pull
    slack = (1.0 - share) * h * h / (share * held)
    s.loops.span[i] = h
    s.loops.gives[i] = slack * wp.vec2(law[3], law[2] * law[2] * law[4])
    s.loops.wanted[i] = (h * s.history.loop_rate[i] - pull * opened) / held


def make_begin_loop(effects: Effects) -> wp.Function:
    """Device function: measures a joint, and chooses its penalties for the step."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    known_angles = make_euler(effects.kinds).known_angles
    locks = make_locks(effects.kinds)
    linear_misfit, angular_misfit = locks.linear_misfit, locks.angular_misfit
    angular_lock = locks.angular_lock
    coordinates = make_joint_coordinates(effects.kinds)
    angles, coordinate = coordinates.angles, coordinates.coordinate

    @wp.func(inline=effects.inline)
    def begin_loop(i: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Misfit, coordinates and penalties of a joint at the start of the step.

        Expects increments of zero and rotations at the start of the step. Returns whether the joint
        is open by more than rounding.
        """
        h = scale.step
        joint = s.loops.joints[i]
        static_slot = scale.static_slot
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, static_slot)
        s.loops.apart[i] = start_span(child, parent, s.joints.parent_frame[joint], static_slot, s)
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        shift = linear_misfit(s.joints, joint, q_p, offset)
        turn = angular_misfit(s.joints, joint, q_p, q_c)
        if s.work.inv_mass[parent] == 0.0:
            misfit = carried_misfit(parent, arm_p, shift, turn, s)
            shift = linear_misfit(s.joints, joint, q_p, wp.spatial_top(misfit))
            turn = angular_lock(s.joints, joint, q_p, q_c) * wp.spatial_bottom(misfit)
        s.loops.misfit[i] = wp.spatial_vector(shift, turn)
        s.loops.closing[i] = 0.0
        open_by = wp.length(shift)
        turn_by = wp.length(turn)
        span = float(wp.inf)
        turning = wp.length(wp.spatial_bottom(s.work.target[child]))
        turning += wp.length(wp.spatial_bottom(s.work.target[parent]))
        moving = wp.length(wp.spatial_top(s.work.target[child]))
        moving += wp.length(wp.spatial_top(s.work.target[parent]))
        s.loops.turn_reach[i] = 2.0 * turning
        s.loops.reach[i] = 2.0 * (moving + turning * (wp.length(arm_c) + wp.length(arm_p)))
        inv_mass = s.work.inv_mass[child] + s.work.inv_mass[parent]
        inv_inertia = mean_inverse(s.work.inv_inertia[child] + s.work.inv_inertia[parent])
        s.loops.k_l[i] = 0.0
        s.loops.k_a[i] = 0.0
        if wp.static(effects.yielding):
            s.loops.gives[i] = wp.vec2(0.0)
        if not s.joints.enabled[joint] or inv_mass == 0.0:
            s.history.loop_force[i] = wp.vec3(0.0)
            s.history.loop_torque[i] = wp.vec3(0.0)
            if wp.static(effects.yielding):
                s.history.loop_rate[i] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            return False
        turn_c = wp.length_sq(wp.spatial_bottom(s.work.target[child]))
        turn_p = wp.length_sq(wp.spatial_bottom(s.work.target[parent]))
        kept = float(1.0)
        if s.loops.is_exact[i]:
            kept = wp.max(1.0 - wp.sqrt(wp.max(turn_c, turn_p)) / FADING, 0.0)
        s.loops.kept_force[i] = kept * s.history.loop_force[i]
        s.loops.kept_torque[i] = kept * s.history.loop_torque[i]
        s.loops.k_l[i] = PENALTY / (inv_mass * h * h)
        s.loops.k_a[i] = PENALTY / (inv_inertia * h * h)
        # one end kinematic, the other where the last step left it
        is_carried = parent != static_slot
        if s.work.inv_mass[parent] == 0.0:
            is_carried = is_carried and s.tree.is_left[child]
        elif s.work.inv_mass[child] == 0.0:
            is_carried = is_carried and s.tree.is_left[parent]
        else:
            is_carried = False
        is_open = bool(False)
        linear = linear_count(s.joints, joint)
        if s.joints.type[joint] == DISTANCE:
            index = s.joints.dof_start[joint]
            length = wp.length(offset)
            s.loops.start_coordinate[index] = wp.float64(length)
            rounding = ROUNDING * (wp.length(s.work.com[child]) + length)
            lower = s.joints.limit_lower[index]
            upper = s.joints.limit_upper[index]
            is_open = length < lower - rounding or (upper >= 0.0 and length > upper + rounding)
            beyond = beyond_bounds(i, s)
            open_by = wp.max(open_by, wp.abs(beyond))
            span = length - beyond
        else:
            known = known_angles(s.joints, joint, s.history.joint_angle, s.joints.dof_start[joint])
            turns = angles(s.joints, joint, q_p, q_c, known, False)
            for dof in range(linear + angular_count(s.joints, joint)):
                index = s.joints.dof_start[joint] + dof
                q = coordinate(
                    s.joints, joint, dof, q_p, turns, offset, s.history.joint_angle[index]
                )
                s.history.joint_angle[index] = q
                if wp.static(effects.hard_limits):
                    size = 4.0 + 2.0 * wp.abs(wp.float32(q))
                    if dof < linear:
                        size = wp.length(s.work.com[child]) + 2.0 * wp.length(offset)
                    beyond = beyond_limit(s.joints, index, wp.float32(q), ROUNDING * size)
                    is_open = is_open or beyond > 0.0
                    if dof < linear:
                        open_by = wp.max(open_by, beyond)
                    else:
                        turn_by = wp.max(turn_by, beyond)
                if is_carried and s.joints.type[joint] != BALL:
                    # a kinematic body has been put elsewhere since: what damps feels its motion
                    q = s.loops.coordinate[index]
                if wp.static(effects.second_order):
                    q = begin_axis(index, q, scale, s.history.coordinate)
                s.loops.start_coordinate[index] = q
        if wp.static(effects.yielding):
            if s.loops.yielding[i][2] > 0.0 and s.loops.is_exact[i]:
                begin_yielding(i, scale.h, s)
                return False
        s.loops.recovered[i] = 1.0
        if not s.loops.is_exact[i]:
            s.loops.recovered[i] = share_recovered(
                open_by, turn_by, span, arm_c, arm_p, child, parent, s
            )
        reach = wp.length(arm_c) + wp.length(arm_p)
        s.loops.closing[i] = s.loops.recovered[i] * (open_by + reach * turn_by)
        allowed = ROUNDING * (wp.length(s.work.com[child]) + reach)
        error = wp.length_sq(shift) + reach * reach * wp.length_sq(turn)
        return is_open or error > allowed * allowed

    return begin_loop
