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
equation left (:func:`free_step`). If a sweep does not lower the number of axes that are off, those
after it go along their update only as far as the energy falls (``least_energy`` in
:mod:`.step.line_search`). If the number does not fall for longer, one stop or friction at a time
takes its next piece (block principal pivoting, which always ends: Portugal, Judice, Vicente, Math.
Comput. 63, 1994). With compliance a limit is a spring and damper instead, or where an MJCF file
authors it one with MuJoCo's impedance.
"""

import newton
import warp as wp

from ..data import AxisLaw, ControlInput, JointModel, vec5
from .joint import BALL, NO_LIMIT, ROD

NO_DRIVE = wp.constant(int(newton.JointTargetMode.NONE))
VELOCITY_MODE = wp.constant(int(newton.JointTargetMode.VELOCITY))
POSITION_MODE = wp.constant(int(newton.JointTargetMode.POSITION))
POSITION_VELOCITY_MODE = wp.constant(int(newton.JointTargetMode.POSITION_VELOCITY))

MOST_RECOVERED = wp.constant(2.0e-2)
"""Most that the recovery moves a coordinate in a step [m or rad]."""
LEAST_IMPEDANCE = wp.constant(1.0e-4)
"""MuJoCo's ``mjMINIMP``, and as far from 1 is its ``mjMAXIMP``."""
LEANING = wp.constant(2)
"""Side of a stop that has let go of a coordinate, which has not moved away from it since."""
YIELDING = wp.constant(2)
"""Piece of friction that holds, in the recovery: it goes on pushing with what it held with, and
lets the coordinate move. As a holding force it would take all of a recovery that asks for less."""
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
def within_limits(
    start: float,
    ends: wp.vec2,
    moved: float,
    start_velocity: float,
    prm: vec5,
    rates: wp.vec2,
    mobility: float,
    h: float,
):
    """Force of a lower and an upper limit as :func:`returning_force` has them, and its curvature.

    Where their margins overlap both push.
    """
    force = float(0.0)
    stiffness = float(0.0)
    for end in range(2):
        side = wp.where(end == 0, 1.0, -1.0)
        inside = side * (start - ends[end])
        v = side * start_velocity
        push, k = returning_force(inside, side * moved, v, prm, rates, mobility, h)
        force += side * push
        stiffness += k
    return force, stiffness


@wp.func
def yielding_limit(
    joints: wp.ref[JointModel], dof: int, q: float, moved: float, start_velocity: float, h: float
):
    """Generalized force of both limits with MuJoCo's impedance [N or N m] and its curvature."""
    margin = joints.limit_margin[dof]
    return within_limits(
        q - moved,
        wp.vec2(joints.limit_lower[dof] + margin, joints.limit_upper[dof] - margin),
        moved,
        start_velocity,
        joints.limit_impedance[dof],
        joints.limit_rates[dof],
        joints.limit_mobility[dof],
        h,
    )


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
    force = law.held
    if law.piece[2] != YIELDING:
        force = float(law.piece[2]) * law.friction
    force += drive_force(law, law.piece[1], 0.0)
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
            if slip == YIELDING:
                slip = int(YIELDING)  # until the next step
            elif not is_stopped(law) and slip == 0:
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
