# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What acts along a joint's free axes: drives, springs, armature, friction, limits.

All of it is a generalized force F(q) of the coordinate at the end of the step, implicit, so that no
coefficient is too stiff:

    drive      ke (target_q - q) + kd (target_qd - dq/h), as the axis' mode says, within +-effort
    actuators  force - stiffness q - damping dq/h, in parts within +-effort or their force ranges
    passive    -stiffness (q - rest_q) - damping dq/h
    armature   -armature (dq/h - qd)/h, with qd at the start of the step
    friction   +-friction against dq, anything between where dq = 0
    stops      anything that holds q between its limits, and dq/h within the velocity limit

F never grows with q and is linear in pieces. In a tree the piece of each axis is taken to be known
and stands in the matrix; an axis that then turns out to be off its piece takes the next one in the
next sweep (a primal-dual active set: Hintermueller, Ito, Kunisch, SIAM J. Optim. 13, 2002). A drive
takes or leaves its effort limit within the sweep: given the motion of the parent its axis has one
equation left (:func:`free_step`). If a sweep does not lower the number of axes that are off, the
next one goes along its update only as far as the energy falls (``least_energy`` in
:mod:`..execute.trees`). If the number does not fall for longer, one stop or friction at a time
takes its next piece (block principal pivoting, which always ends: Portugal, Judice, Vicente, Math.
Comput. 63, 1994). With compliance a limit is a spring and damper instead, or where an MJCF file
authors it one with MuJoCo's impedance.
"""

from dataclasses import dataclass

import newton
import warp as wp

from ..data import AxisLaw, ControlInput, History, JointModel, vec5
from ..effects import Effects
from .joint import BALL, NO_LIMIT, ROD

VELOCITY_MODE = wp.constant(int(newton.JointTargetMode.VELOCITY))
POSITION_MODE = wp.constant(int(newton.JointTargetMode.POSITION))
POSITION_VELOCITY_MODE = wp.constant(int(newton.JointTargetMode.POSITION_VELOCITY))

MOST_RECOVERED = wp.constant(2.0e-2)
"""Most that the recovery moves a coordinate in a step [m or rad]."""
LEAST_IMPEDANCE = wp.constant(1.0e-4)
"""MuJoCo's ``mjMINIMP``, and as far from 1 is its ``mjMAXIMP``."""
LEANING = wp.constant(2)
"""Side of a stop that has let go of a coordinate, which has not moved away from it since."""
LEAN = wp.constant(3.0e-7)
"""How far beyond a stop that has let go a coordinate may step before the stop holds it again, as
rounding of orientations has it step [rad, or m of a meter]. Mimic joints at their stops hold each
other, and which stops have something to hold is up to rounding. So it is with friction in loops:
what one joint holds steps that far along its own friction."""
LEAN_RATE = wp.constant(1.0e-2)
"""Acceleration [rad/s^2 or m/s^2] that such a step may stand for at most: 1e-3 of the earth's
gravity on an arm of a meter."""
PASSED = wp.constant(1.0e-5)
"""How far a coordinate is beyond a limit when a step ends that it is put back [rad or m]."""


@wp.func
def drive_change(joints: wp.ref[JointModel], dof: int, target: float, speed: float) -> float:
    """Force that changes of the target [m or rad] and its velocity add to a drive [N or N m]."""
    mode = joints.target_mode[dof]
    force = 0.0
    if mode == POSITION_MODE or mode == POSITION_VELOCITY_MODE:
        force += joints.target_ke[dof] * target
    if mode == VELOCITY_MODE or mode == POSITION_VELOCITY_MODE:
        force += joints.target_kd[dof] * speed
    return force


@wp.func
def drive(
    joints: wp.ref[JointModel],
    control: wp.ref[ControlInput],
    dof: int,
    away: float,
    moved: float,
    h: float,
):
    """Generalized force of a drive [N or N m] and its curvature.

    As in SolverMuJoCo and SolverKamino, a POSITION drive damps towards rest whatever the target
    velocity, and a VELOCITY drive has no stiffness; NONE and EFFORT drive nothing.

    Args:
        joints: The joints.
        control: The targets.
        dof: Degree of freedom.
        away: How far the target is from the coordinate [m or rad].
        moved: How far the coordinate has moved in the step [m or rad].
        h: Time step [s].
    """
    mode = joints.target_mode[dof]
    ke = 0.0
    kd = 0.0
    speed = 0.0
    if mode == POSITION_MODE or mode == POSITION_VELOCITY_MODE:
        ke = joints.target_ke[dof]
        kd = joints.target_kd[dof]
    if mode == VELOCITY_MODE or mode == POSITION_VELOCITY_MODE:
        kd = joints.target_kd[dof]
        speed = control.target_qd[dof]
    return ke * away + kd * (speed - moved / h), ke + kd / h


@wp.func
def pushed(control: wp.ref[ControlInput], dof: int, q: wp.float64, moved: float, h: float):
    """Generalized force of actuators that nothing limits [N or N m] and its curvature."""
    push = control.pushes[dof]
    force = push.force - push.stiffness * wp.float32(q) - push.damping * moved / h
    return force, push.stiffness + push.damping / h


@wp.func
def pushed_within(control: wp.ref[ControlInput], dof: int, q: wp.float64, moved: float, h: float):
    """As :func:`pushed`, of those that share the limit of the drive."""
    push = control.pushes[dof]
    force = push.drive - push.drive_stiffness * wp.float32(q) - push.drive_damping * moved / h
    return force, push.drive_stiffness + push.drive_damping / h


@wp.func
def ranged(control: wp.ref[ControlInput], dof: int, q: wp.float64, moved: float, h: float):
    """As :func:`pushed_within`, of those that keep to force ranges of their own."""
    push = control.pushes[dof]
    total = float(0.0)
    stiffness = float(0.0)
    for k in range(push.first, push.first + push.count):
        law = control.ranged[k]
        force = law.force - law.stiffness * wp.float32(q) - law.damping * moved / h
        total += wp.clamp(force, law.least, law.most)
        if force > law.least and force < law.most:
            stiffness += law.stiffness + law.damping / h
    return total, stiffness


@wp.func
def passive(joints: wp.ref[JointModel], dof: int, away: float, moved: float, h: float):
    """Generalized force of the passive spring and damper [N or N m] and its curvature."""
    ke = joints.stiffness[dof]
    kd = joints.damping[dof]
    return ke * away - kd * moved / h, ke + kd / h


@wp.func
def reflected(joints: wp.ref[JointModel], dof: int, start_velocity: float, moved: float, h: float):
    """Generalized force of the armature's inertia [N or N m] and its curvature."""
    inertia = joints.armature[dof] / (h * h)
    return inertia * (h * start_velocity - moved), inertia


@wp.func
def away_from(
    target: wp.array[float],
    joints: wp.ref[JointModel],
    joint: int,
    dof: int,
    q: wp.float64,
    turn: wp.vec3,
) -> float:
    """How far a coordinate is from one in the layout of the joint coordinates [m or rad].

    ``turn`` leads a ball joint there.
    """
    if joints.type[joint] == BALL:
        return turn[dof]
    return wp.float32(wp.float64(target[joints.coord_start[joint] + dof]) - q)


@wp.func
def most_effort(joints: wp.ref[JointModel], dof: int) -> float:
    """Most that the drive pushes with [N or N m]."""
    limit = joints.effort_limit[dof]
    return wp.where(limit < NO_LIMIT, limit, wp.inf)


@wp.func
def most_friction(joints: wp.ref[JointModel], joint: int, dof: int) -> float:
    """Most that friction pushes with [N or N m]; a rod has none."""
    return wp.where(joints.type[joint] == ROD, 0.0, joints.friction[dof])


@wp.func
def rod_response(joints: wp.ref[JointModel], dof: int, q: float, moved: float, h: float):
    """Generalized force of a rod's stretch, shear, bend or twist [N or N m] and its curvature.

    Coefficients are the drive's ``target_ke`` and ``target_kd``, as in SolverVBD.
    """
    ke = joints.target_ke[dof]
    kd = joints.target_kd[dof]
    return -ke * q - kd * moved / h, ke + kd / h


@wp.func
def soft_limit(joints: wp.ref[JointModel], dof: int, q: float, moved: float, h: float):
    """Generalized force of a compliant limit [N or N m] and its curvature."""
    beyond = wp.min(q - joints.limit_lower[dof], 0.0) + wp.max(q - joints.limit_upper[dof], 0.0)
    if beyond == 0.0:
        return 0.0, 0.0
    ke = joints.limit_ke[dof]
    kd = joints.limit_kd[dof]
    return -ke * beyond - kd * moved / h, ke + kd / h


@wp.func
def impedance_at(prm: vec5, beyond: float) -> float:
    """MuJoCo's d(r), the share of what returns to a limit that the limit makes up for.

    Args:
        prm: ``solimp``: the shares at the limit and from a width on, the width, and midpoint and
            power of the way between.
        beyond: How far beyond the limit the coordinate is [m or rad].
    """
    least = wp.clamp(prm[0], LEAST_IMPEDANCE, 1.0 - LEAST_IMPEDANCE)
    most = wp.clamp(prm[1], LEAST_IMPEDANCE, 1.0 - LEAST_IMPEDANCE)
    middle = wp.clamp(prm[3], LEAST_IMPEDANCE, 1.0 - LEAST_IMPEDANCE)
    power = wp.max(prm[4], 1.0)
    if prm[2] <= 0.0:
        return 0.5 * (least + most)
    x = wp.min(beyond / prm[2], 1.0)
    share = 1.0 - wp.pow(1.0 - x, power) / wp.pow(1.0 - middle, power - 1.0)
    if x <= middle:
        share = wp.pow(x, power) / wp.pow(middle, power - 1.0)
    return least + share * (most - least)


@wp.func
def returning_force(
    inside: float,
    moved: float,
    start_velocity: float,
    prm: vec5,
    rates: wp.vec2,
    mobility: float,
    h: float,
):
    """Force of a limit with MuJoCo's impedance away from it [N or N m], and its curvature.

    A limit that the coordinate has passed at the start of the step pushes back with

        F = max(0, -d/((1 - d) A) (a + b v + k r)),  k = d K

    of acceleration a and velocity v away from it, at the end of the step, and of how far inside of
    it, r, the coordinate is then; with the inverse inertia A of the axis in the reference pose.
    MuJoCo minimises the same ("Constraint model"; f = -(a1 - aref)/R).

    Args:
        inside: How far inside the coordinate starts [m or rad].
        moved: How far it has moved away in the step [m or rad].
        start_velocity: Velocity away at the start of the step [m/s or rad/s].
        prm: ``solimp``.
        rates: K and b.
        mobility: A.
        h: Time step [s].
    """
    if inside >= 0.0:
        return 0.0, 0.0
    share = impedance_at(prm, -inside)
    inertia = share / ((1.0 - share) * mobility)
    ke = share * rates[0]
    force = start_velocity / h - moved / (h * h) - rates[1] * moved / h - ke * moved
    force = inertia * (force - ke * inside)
    if force <= 0.0:
        return 0.0, 0.0
    return force, inertia * (1.0 / (h * h) + rates[1] / h + ke)


@wp.func
def yielding_limit(
    joints: wp.ref[JointModel], dof: int, q: float, moved: float, start_velocity: float, h: float
):
    """Generalized force of a limit with MuJoCo's impedance [N or N m] and its curvature."""
    start = q - moved
    margin = joints.limit_margin[dof]
    inside = start - joints.limit_lower[dof] - margin
    side = 1.0
    if inside >= 0.0:
        inside = joints.limit_upper[dof] - margin - start
        side = -1.0
    force, stiffness = returning_force(
        inside,
        side * moved,
        side * start_velocity,
        joints.limit_impedance[dof],
        joints.limit_rates[dof],
        joints.limit_mobility[dof],
        h,
    )
    return side * force, stiffness


@wp.func
def limit_side(joints: wp.ref[JointModel], dof: int, q: float) -> int:
    """-1 below the lower limit, 1 above the upper, 0 between."""
    if q < joints.limit_lower[dof]:
        return -1
    return wp.where(q > joints.limit_upper[dof], 1, 0)


@wp.func
def left_beyond(beyond: float, recovery: float) -> float:
    """How far beyond a limit a sweep leaves what is beyond it at the start of the step [m or rad].

    The motion leaves all of it, so that it does not enter the velocity; the recovery takes out a
    share.
    """
    beyond = wp.max(beyond, 0.0)
    return wp.max((1.0 - recovery) * beyond, beyond - MOST_RECOVERED)


@wp.func
def passed_limit(joints: wp.ref[JointModel], dof: int, q: wp.float64, start: wp.float64) -> float:
    """How far the coordinate is beyond a limit, and beyond where it started [m or rad]."""
    lower = wp.min(wp.float64(joints.limit_lower[dof]), start)
    upper = wp.max(wp.float64(joints.limit_upper[dof]), start)
    excess = wp.float32(q - wp.clamp(q, lower, upper))
    return wp.where(wp.abs(excess) > PASSED, excess, 0.0)


@wp.func
def is_stopped(law: AxisLaw) -> bool:
    """Whether a stop holds the coordinate."""
    return wp.abs(law.piece[0]) == 1


@wp.func
def is_held(law: AxisLaw) -> bool:
    """Whether a stop or friction holds the coordinate."""
    return is_stopped(law) or law.piece[2] == 0


@wp.func
def held_step(law: AxisLaw) -> float:
    """Step to where the coordinate is held [m or rad]."""
    if law.piece[0] == -1:
        return law.lower
    if law.piece[0] == 1:
        return law.upper
    return law.hold


@wp.func
def law_force(law: AxisLaw):
    """Generalized force of drive and friction on their pieces, and its curvature."""
    force = float(law.piece[2]) * law.friction + drive_force(law, law.piece[1], 0.0)
    return force, wp.where(law.piece[1] == 0, law.drive_stiffness, 0.0)


@wp.func
def drive_force(law: AxisLaw, limit: int, step: float) -> float:
    """Generalized force of the drive after a step, where it is at a limit or at none."""
    if limit != 0:
        return wp.where(limit < 0, law.least, law.most)
    return law.drive - law.drive_stiffness * step


@wp.func
def limit_at(law: AxisLaw, step: float) -> int:
    """Limit that the drive is at after a step: 1 the upper, -1 the lower, 0 none."""
    force = law.drive - law.drive_stiffness * step
    if force >= law.most:
        return 1
    return wp.where(force <= law.least, -1, 0)


@wp.func
def step_of_drive(law: AxisLaw, rest: float, pivot: float) -> float:
    """Root q of pivot q = rest + F(q) [m or rad], with F the force of the drive within limits."""
    step = (rest + law.drive) / (pivot + law.drive_stiffness)
    limit = limit_at(law, step)
    if limit != 0:
        step = (rest + drive_force(law, limit, step)) / pivot
    return step


@wp.func
def free_step(law: AxisLaw, step: float, inv_pivot: float) -> float:
    """Step of a coordinate that nothing holds, with its drive within limits [m or rad].

    Takes the step on the piece that elimination assumed, and the inverse of its pivot. The other
    axes keep to their pieces: what is left is one equation, piecewise linear and monotone.
    """
    if limit_at(law, step) == law.piece[1]:
        return step
    pivot = 1.0 / inv_pivot - wp.where(law.piece[1] == 0, law.drive_stiffness, 0.0)
    return step_of_drive(law, step / inv_pivot - drive_force(law, law.piece[1], 0.0), pivot)


@wp.func
def piece_before(law: AxisLaw, step: float, share: float) -> wp.vec3i:
    """The next piece where only a share of the step is made: limits and stops are those there."""
    side = law.next[0]
    if share < 1.0 and not is_stopped(law) and step > law.lower and step < law.upper:
        side = law.piece[0]
    return wp.vec3i(side, limit_at(law, step), law.next[2])


@wp.func
def excess_force(law: AxisLaw, step: float, share: float) -> float:
    """What drive and friction push with on their assumed pieces after a share of a step, beyond
    what they push with there."""
    q = share * step
    excess = drive_force(law, law.piece[1], q) - drive_force(law, limit_at(law, q), q)
    if law.friction > 0.0 and (share < 1.0 or law.piece[2] != 0):
        excess += law.friction * (float(law.piece[2]) + wp.sign(q - law.hold))
    return excess


@dataclass(frozen=True)
class AxisFunctions:
    """Device functions of what acts along axes, compiled for what a scene has."""

    linear_force: wp.Function
    limited_drive: wp.Function
    compliant_limit: wp.Function
    stops: wp.Function
    law_of: wp.Function
    next_piece: wp.Function


def make_next_piece(
    *, friction: bool, stops: bool, limits: bool, closures: bool = False
) -> wp.Function:
    """Device function that finds the piece of its law that an axis is on.

    Args:
        friction: Whether laws have friction.
        stops: Whether they have stops.
        limits: Whether drives have limits.
        closures: Whether loops and mimics tie axes to each other.
    """

    @wp.func
    def next_piece(law: AxisLaw, step: float, held: float) -> wp.vec3i:
        """The piece that an axis should be on, where another than ``law.piece``, the next to it.

        Args:
            law: The law.
            step: Step of the coordinate [m or rad].
            held: What holds it there [N or N m], where something does.
        """
        side = law.piece[0]
        limit = law.piece[1]
        slip = law.piece[2]
        if wp.static(friction):
            moved = step - law.hold
            lean = wp.static(0.0)
            if wp.static(closures):
                # one axis holds all that it is tied to: those move by rounding, either way
                lean = law.slack
            if not is_stopped(law) and slip == 0:
                if wp.abs(held) >= law.friction:
                    slip = wp.where(held < 0.0, -1, 1)
            elif law.friction > 0.0 and float(slip) * moved > lean:
                # friction that would push along: it holds, or at a stop is the other one
                slip = wp.where(is_stopped(law), -slip, 0)
        if wp.static(stops):
            if not is_stopped(law):
                if step < law.lower - wp.where(side == -LEANING, law.slack, 0.0):
                    side = -1
                elif step > law.upper + wp.where(side == LEANING, law.slack, 0.0):
                    side = 1
            elif float(side) * held >= 0.0:
                # a stop pushes back; one that would have to pull lets go
                side = LEANING * side
        if wp.static(limits):
            limit = limit_at(law, step)
        return wp.vec3i(side, limit, slip)

    return next_piece


def make_axis(effects: Effects) -> AxisFunctions:
    """Device functions: the law F(q) of an axis, and its solution."""
    next_piece = make_next_piece(
        friction=effects.joint_friction,
        stops=effects.stops,
        limits=effects.effort_limits,
        closures=effects.closures,
    )

    @wp.func
    def compliant_limit(
        joints: wp.ref[JointModel],
        dof: int,
        q: float,
        moved: float,
        start_velocity: float,
        h: float,
    ):
        """Generalized force of a compliant limit [N or N m] and its curvature."""
        if wp.static(effects.limit_impedance):
            if joints.limit_mobility[dof] > 0.0:
                return yielding_limit(joints, dof, q, moved, start_velocity, h)
        return soft_limit(joints, dof, q, moved, h)

    @wp.func
    def linear_force(
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        joint: int,
        dof: int,
        q: wp.float64,
        moved: float,
        start_velocity: float,
        turn_away: wp.vec3,
        rest_away: wp.vec3,
        h: float,
    ):
        """What is linear in the coordinate, ``joint_f`` aside, and its curvature."""
        index = joints.dof_start[joint] + dof
        force = 0.0
        stiffness = 0.0
        if wp.static(effects.drives and not effects.effort_limits):
            away = away_from(control.target_q, joints, joint, dof, q, turn_away)
            pull, k = drive(joints, control, index, away, moved, h)
            force += pull
            stiffness += k
        if wp.static(effects.pushed_axes):
            pull, k = pushed(control, index, q, moved, h)
            force += pull
            stiffness += k
        if wp.static(effects.springs):
            rest = away_from(joints.rest_q, joints, joint, dof, q, rest_away)
            pull, k = passive(joints, index, rest, moved, h)
            force += pull
            stiffness += k
        if wp.static(effects.armature):
            pull, k = reflected(joints, index, start_velocity, moved, h)
            force += pull
            stiffness += k
        if wp.static(effects.limits and effects.compliance):
            pull, k = compliant_limit(joints, index, wp.float32(q), moved, start_velocity, h)
            force += pull
            stiffness += k
        return force, stiffness

    @wp.func
    def limited_drive(
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        joint: int,
        dof: int,
        q: wp.float64,
        moved: float,
        turn_away: wp.vec3,
        h: float,
    ):
        """Generalized force of what has a limit [N or N m], its curvature, and the limit's ends."""
        index = joints.dof_start[joint] + dof
        pull = 0.0
        stiffness = 0.0
        if wp.static(effects.drives):
            away = away_from(control.target_q, joints, joint, dof, q, turn_away)
            pull, stiffness = drive(joints, control, index, away, moved, h)
        most = most_effort(joints, index)
        least = -most
        if wp.static(effects.pushed_axes):
            more, k = pushed_within(control, index, q, moved, h)
            pull += more
            stiffness += k
            if wp.static(effects.force_ranges):
                more, k = ranged(control, index, q, moved, h)
                pull += more
                stiffness += k
            least = wp.max(least, control.pushes[index].least)
            most = wp.min(most, control.pushes[index].most)
        return pull, stiffness, least, most

    @wp.func
    def stops(
        joints: wp.ref[JointModel], dof: int, q: wp.float64, moved: float, recovery: float, h: float
    ):
        """Steps from the coordinate to the ends of the interval that it is held in [m or rad].

        Limits beat velocity limits.
        """
        lower = float(-wp.inf)
        upper = float(wp.inf)
        if wp.static(effects.velocity_limits):
            limit = joints.velocity_limit[dof]
            if limit > 0.0 and limit < NO_LIMIT:
                lower = -h * limit - moved
                upper = h * limit - moved
        if wp.static(effects.hard_limits):
            at = wp.float32(q)
            lower_limit = joints.limit_lower[dof]
            upper_limit = joints.limit_upper[dof]
            start = at - moved
            least = lower_limit - left_beyond(lower_limit - start, recovery) - at
            most = upper_limit + left_beyond(start - upper_limit, recovery) - at
            lower = wp.clamp(lower, least, most)
            upper = wp.clamp(upper, least, most)
        return lower, upper

    @wp.func
    def law_of(
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        history: wp.ref[History],
        joint: int,
        dof: int,
        q: wp.float64,
        moved: float,
        turn_away: wp.vec3,
        recovery: float,
        h: float,
    ) -> AxisLaw:
        """The law of an axis about its coordinate, and the piece that it is taken to be on.

        A piece says which stop holds (-1 the lower, 1 the upper; times :data:`LEANING` one that has
        let go), which limit the drive is at and which way friction pushes; 0 where none does, for
        friction where it holds.
        """
        index = joints.dof_start[joint] + dof
        known = history.piece[index]
        side = 0
        limit = 0
        slip = 1
        law = AxisLaw()
        law.least = -wp.inf
        law.most = wp.inf
        if wp.static(effects.stops or (effects.joint_friction and effects.closures)):
            law.slack = wp.min(LEAN * wp.max(1.0, wp.abs(wp.float32(q))), LEAN_RATE * h * h)
        if wp.static(effects.stops):
            lower, upper = stops(joints, index, q, moved, recovery, h)
            law.lower = lower
            law.upper = upper
            side = known[0]
            if wp.abs(side) == LEANING:
                away = wp.where(side < 0, law.lower, law.upper)
                if wp.abs(away) > law.slack:
                    side = 0
                    history.piece[index] = wp.vec3i(0, known[1], known[2])
            if side == 0 and law.lower > 0.0:
                side = -1
            if side == 0 and law.upper < 0.0:
                side = 1
        if wp.static(effects.joint_friction):
            law.hold = wp.float32(history.held_at[index] - q)
            law.friction = most_friction(joints, joint, index)
            if law.friction > 0.0:
                slip = known[2]
        if wp.static(effects.effort_limits):
            pull, stiffness, least, most = limited_drive(
                joints, control, joint, dof, q, moved, turn_away, h
            )
            law.drive = pull
            law.drive_stiffness = stiffness
            law.least = least
            law.most = most
            if wp.isfinite(least) or wp.isfinite(most):
                limit = known[1]
        law.piece = wp.vec3i(side, limit, slip)
        if wp.static(effects.effort_limits):
            if is_held(law):
                # where it is held the force of the drive is known
                law.piece = wp.vec3i(side, limit_at(law, held_step(law)), slip)
        return law

    return AxisFunctions(linear_force, limited_drive, compliant_limit, stops, law_of, next_piece)
