# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What one MuJoCo actuator pushes with: its activation, gain and bias, linear in the motion.

An actuator pushes its transmission with F(l, v) = gain(l, v) u + bias(l, v), where l and v are
length and velocity of the transmission and u is the control or the activation. Formulas and names
of parameters are MuJoCo's ("Computation: Actuation model"). F is handed on as

    F = force - stiffness l - damping v

which is exact for fixed and affine gains and biases. A muscle is linearised at the start of the
step. Slopes that would drive the motion further count as constant over the step, so that stiffness
and damping are never negative and the step stays stable, however large they are.
"""

import warp as wp

from ..data import ActuatorLaw, ActuatorModel, JointModel, vec10
from .motor import MOTOR, motor_law

NO_DYNAMICS = wp.constant(0)
INTEGRATOR = wp.constant(1)
FILTER = wp.constant(2)
EXACT_FILTER = wp.constant(3)
MUSCLE_DYNAMICS = wp.constant(4)
"""MuJoCo's ``mjtDyn``."""
FIXED_GAIN = wp.constant(0)
AFFINE_GAIN = wp.constant(1)
MUSCLE_GAIN = wp.constant(2)
"""MuJoCo's ``mjtGain``."""
NO_BIAS = wp.constant(0)
AFFINE_BIAS = wp.constant(1)
MUSCLE_BIAS = wp.constant(2)
"""MuJoCo's ``mjtBias``."""
LIMITS_CONTROL = wp.constant(1)
LIMITS_FORCE = wp.constant(2)
LIMITS_ACTIVATION = wp.constant(4)
"""Bits of :attr:`.ActuatorModel.limits`."""
BY_CONTROL = wp.constant(0)
"""An actuator of a control of its own."""
POSITION_TARGET = wp.constant(1)
"""One that is a POSITION drive: ke (target_q - q) - kd v."""
UNDAMPED_POSITION_TARGET = wp.constant(2)
"""The first of a POSITION_VELOCITY drive: ke (target_q - q)."""
VELOCITY_TARGET = wp.constant(3)
"""The second of it, and a VELOCITY drive: kd (target_qd - v)."""
AT_SITE = wp.constant(0)
"""Gear in the axes of a site, at the site."""
AGAINST_SITE = wp.constant(1)
"""Gear in the axes of a reference site, at the site; the force reacts on what holds that, there."""
FREE_JOINT = wp.constant(2)
"""Force in the axes of the world, at the origin of the link, and torque in those of the link."""
FREE_JOINT_IN_PARENT = wp.constant(3)
"""Force and torque in the axes of the world, at the origin of the link."""
BALL_JOINT = wp.constant(4)
"""Torque in the axes of the link."""
BALL_JOINT_IN_PARENT = wp.constant(5)
"""Torque in the axes of the parent's anchor."""
SLIDER_CRANK = wp.constant(6)
"""From the site of the crank, and the link with the slider gets the reaction."""
CRANK_ON_WORLD = wp.constant(7)
"""The same of a crank on the world: from the site of the slider."""
LEAST = wp.constant(1.0e-15)
"""MuJoCo's ``mjMINVAL``: what it divides by at least."""


@wp.func
def smooth_step(x: float) -> float:
    """Rises from 0 at 0 to 1 at 1 with two derivatives that vanish there."""
    s = wp.clamp(x, 0.0, 1.0)
    return s * s * s * (3.0 * s * (2.0 * s - 5.0) + 10.0)


@wp.func
def muscle_rate(control: float, activation: float, prm: vec10) -> float:
    """Rate of a muscle's activation [1/s] (Millard et al. 2013, as in MuJoCo)."""
    scale = 0.5 + 1.5 * wp.clamp(activation, 0.0, 1.0)
    rise = prm[0] * scale
    fall = prm[1] / scale
    excess = wp.clamp(control, 0.0, 1.0) - activation
    tau = wp.where(excess > 0.0, rise, fall)
    if prm[2] > LEAST:
        tau = fall + (rise - fall) * smooth_step(excess / prm[2] + 0.5)
    return excess / wp.max(tau, LEAST)


@wp.func
def next_activation(
    actuators: wp.ref[ActuatorModel], row: int, control: float, activation: float, h: float
) -> float:
    """Activation at the end of the step."""
    kind = actuators.dynamics[row]
    prm = actuators.dynprm[row]
    value = activation + h * control
    if kind == FILTER:
        value = activation + h * (control - activation) / wp.max(prm[0], LEAST)
    if kind == EXACT_FILTER:
        tau = wp.max(prm[0], LEAST)
        value = activation + (control - activation) * (1.0 - wp.exp(-h / tau))
    if kind == MUSCLE_DYNAMICS:
        value = activation + h * muscle_rate(control, activation, prm)
    if (actuators.limits[row] & LIMITS_ACTIVATION) != 0:
        most = actuators.actrange[row]
        value = wp.clamp(value, most[0], most[1])
    return value


@wp.func
def control_of(actuators: wp.ref[ActuatorModel], row: int, ctrl: wp.array[float]) -> float:
    """Control of an actuator within its range; says once of one that is not finite which it is."""
    control = ctrl[row]
    is_sound = wp.isfinite(control)
    if not is_sound and not actuators.is_reported[row]:
        wp.printf(
            "SolverAVBD: control.mujoco.ctrl[%d] is not finite, and its world is held still while "
            "that lasts; write a finite number\n",
            row,
        )
    if is_sound == actuators.is_reported[row]:
        actuators.is_reported[row] = not is_sound
    return within_range(actuators, row, control)


@wp.func
def within_range(actuators: wp.ref[ActuatorModel], row: int, control: float) -> float:
    """A control, or the target of a drive, within the range of its actuator."""
    if (actuators.limits[row] & LIMITS_CONTROL) != 0:
        most = actuators.ctrlrange[row]
        # of numbers that are not finite clamping would make some that are
        control = control - control + wp.clamp(control, most[0], most[1])
    return control


@wp.func
def input_of(actuators: wp.ref[ActuatorModel], row: int, ctrl: wp.array[float], h: float) -> float:
    """What drives an actuator in the step, its control or activation; the latter goes on.

    As in MuJoCo the force is that of the activation at the start of the step, or with ``actearly``
    of that at its end.
    """
    control = control_of(actuators, row, ctrl)
    if actuators.dynamics[row] == NO_DYNAMICS:
        return control
    activation = actuators.activation[row]
    after = next_activation(actuators, row, control, activation, h)
    if wp.isfinite(after):
        actuators.activation[row] = after
    return wp.where(actuators.actearly[row] or not wp.isfinite(after), after, activation)


@wp.func
def muscle_length_gain(length: float, least: float, most: float):
    """Active force of a muscle by its normalised length, and its slope."""
    if length < least or length > most:
        return 0.0, 0.0
    rise = 0.5 * (least + 1.0)
    fall = 0.5 * (1.0 + most)
    if length <= rise:
        width = wp.max(rise - least, LEAST)
        x = (length - least) / width
        return 0.5 * x * x, x / width
    if length <= 1.0:
        width = wp.max(1.0 - rise, LEAST)
        x = (1.0 - length) / width
        return 1.0 - 0.5 * x * x, x / width
    if length <= fall:
        width = wp.max(fall - 1.0, LEAST)
        x = (length - 1.0) / width
        return 1.0 - 0.5 * x * x, -x / width
    width = wp.max(most - fall, LEAST)
    x = (most - length) / width
    return 0.5 * x * x, -x / width


@wp.func
def muscle_velocity_gain(velocity: float, most: float):
    """Active force of a muscle by its normalised velocity, and its slope."""
    y = most - 1.0
    if velocity <= -1.0:
        return 0.0, 0.0
    if velocity <= 0.0:
        return (velocity + 1.0) * (velocity + 1.0), 2.0 * (velocity + 1.0)
    if velocity <= y:
        behind = y - velocity
        return most - behind * behind / wp.max(y, LEAST), 2.0 * behind / wp.max(y, LEAST)
    return most, 0.0


@wp.func
def muscle_passive_force(length: float, most_length: float, most: float):
    """Passive force of a muscle by its normalised length, and its slope."""
    b = wp.max(0.5 * (1.0 + most_length) - 1.0, LEAST)
    if length <= 1.0:
        return 0.0, 0.0
    x = (length - 1.0) / b
    if length <= 1.0 + b:
        return most * 0.5 * x * x, most * x / b
    return most * (x - 0.5), most / b


@wp.func
def muscle_scale(actuators: wp.ref[ActuatorModel], row: int, prm: vec10):
    """Peak force of a muscle [N], length of its unit [m], and its length range's start [m]."""
    force = prm[2]
    if force < 0.0:
        force = prm[3] / wp.max(actuators.acc0[row], LEAST)
    span = actuators.lengthrange[row]
    unit = (span[1] - span[0]) / wp.max(prm[1] - prm[0], LEAST)
    return force, wp.max(unit, LEAST), span[0]


@wp.func
def muscle_push(
    actuators: wp.ref[ActuatorModel], row: int, drive: float, length: float, velocity: float
):
    """Force of a muscle's gain and bias at a length and a velocity, and its slopes by both."""
    force = 0.0
    by_length = 0.0
    by_velocity = 0.0
    if actuators.gain[row] == MUSCLE_GAIN:
        prm = actuators.gainprm[row]
        peak, unit, start = muscle_scale(actuators, row, prm)
        fl, dfl = muscle_length_gain(prm[0] + (length - start) / unit, prm[4], prm[5])
        fastest = wp.max(unit * prm[6], LEAST)
        fv, dfv = muscle_velocity_gain(velocity / fastest, prm[8])
        force -= drive * peak * fl * fv
        by_length -= drive * peak * dfl * fv / unit
        by_velocity -= drive * peak * fl * dfv / fastest
    if actuators.bias[row] == MUSCLE_BIAS:
        prm = actuators.biasprm[row]
        peak, unit, start = muscle_scale(actuators, row, prm)
        fp, dfp = muscle_passive_force(prm[0] + (length - start) / unit, prm[5], prm[7])
        force -= peak * fp
        by_length -= peak * dfp / unit
    return force, by_length, by_velocity


@wp.func
def law_of(
    actuators: wp.ref[ActuatorModel], row: int, drive: float, length: float, velocity: float
) -> ActuatorLaw:
    """What an actuator pushes its transmission with.

    Args:
        actuators: The actuators.
        row: The actuator.
        drive: What :func:`input_of` says.
        length: Length of the transmission at the start of the step [m or rad].
        velocity: Its velocity [m/s or rad/s].
    """
    law = ActuatorLaw()
    law.least = -wp.inf
    law.most = wp.inf
    gain = actuators.gain[row]
    bias = actuators.bias[row]
    prm = actuators.gainprm[row]
    if gain == FIXED_GAIN or gain == AFFINE_GAIN:
        law.force = prm[0] * drive
    if gain == AFFINE_GAIN:
        law.stiffness = -prm[1] * drive
        law.damping = -prm[2] * drive
    if bias == AFFINE_BIAS:
        by = actuators.biasprm[row]
        law.force += by[0]
        law.stiffness -= by[1]
        law.damping -= wp.where(by[2] > 0.0, actuators.velocity_bias[row], by[2])
    if gain == MUSCLE_GAIN or bias == MUSCLE_BIAS:
        push, by_length, by_velocity = muscle_push(actuators, row, drive, length, velocity)
        law.force += push - by_length * length - by_velocity * velocity
        law.stiffness -= by_length
        law.damping -= by_velocity
    if law.stiffness < 0.0:
        law.force -= law.stiffness * length
        law.stiffness = 0.0
    if law.damping < 0.0:
        law.force -= law.damping * velocity
        law.damping = 0.0
    return law


@wp.func
def law_in_step(
    actuators: wp.ref[ActuatorModel],
    row: int,
    ctrl: wp.array[float],
    length: float,
    velocity: float,
    h: float,
) -> ActuatorLaw:
    """What an actuator pushes its transmission with in the step, by its length and velocity at the
    start; its activation goes on. The velocity at the end of the step counts for the law."""
    law = ActuatorLaw()
    if actuators.gain[row] == MOTOR:
        control = control_of(actuators, row, ctrl)
        law = motor_law(actuators, row, control, length, velocity, h)
    else:
        law = law_of(actuators, row, input_of(actuators, row, ctrl, h), length, velocity)
    if (actuators.limits[row] & LIMITS_FORCE) != 0:
        most = actuators.forcerange[row]
        law.least = most[0]
        law.most = most[1]
    return law


@wp.func
def drive_law(
    actuators: wp.ref[ActuatorModel],
    joints: wp.ref[JointModel],
    row: int,
    dof: int,
    kind: int,
    target: float,
) -> ActuatorLaw:
    """What an actuator that is a joint drive pushes its axis with, by the gains of the drive.

    Args:
        actuators: The actuators.
        joints: The joints.
        row: Row of what it authors, -1 for nothing.
        dof: Its degree of freedom.
        kind: What it takes from the drive.
        target: Its target [m or rad, or m/s or rad/s], counted as the control of an actuator is.
    """
    law = ActuatorLaw()
    law.least = -wp.inf
    law.most = wp.inf
    damping = joints.target_kd[dof]
    if row >= 0:
        target = within_range(actuators, row, target)
        if (actuators.limits[row] & LIMITS_FORCE) != 0:
            most = actuators.forcerange[row]
            law.least = most[0]
            law.most = most[1]
        if damping == 0.0:
            # by a damping ratio
            damping = -actuators.velocity_bias[row]
    if kind == VELOCITY_TARGET:
        law.force = damping * target
        law.damping = damping
    else:
        law.stiffness = joints.target_ke[dof]
        law.force = law.stiffness * target
        if kind == POSITION_TARGET:
            law.damping = damping
    return law


@wp.func
def at_limit(law: ActuatorLaw, length: float, velocity: float) -> ActuatorLaw:
    """A law whose limit counts as it is at the start of the step: constant where it is reached."""
    force = law.force - law.stiffness * length - law.damping * velocity
    if force <= law.least or force >= law.most:
        law.force = wp.clamp(force, law.least, law.most)
        law.stiffness = 0.0
        law.damping = 0.0
    law.least = -wp.inf
    law.most = wp.inf
    return law


@wp.func
def own_damping(actuators: wp.ref[ActuatorModel], row: int, velocity: float) -> float:
    """Damping of an actuator beside its force [N s/m or N m s/rad], at the velocity of its axis."""
    poly = actuators.dampingpoly[row]
    speed = wp.abs(velocity)
    return actuators.damping[row] + speed * (poly[0] + speed * poly[1])
