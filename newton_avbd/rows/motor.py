# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's DC motor: voltage, winding, temperature, cogging and LuGre friction.

Formulas, order of parameters and states are those of MuJoCo's ``mj_fwdActuation``. With R
the resistance and K the torque constant the winding without inductance pushes with K/R (V - K v),
which the step takes implicitly in v; one with a current as its state pushes with K i. The friction
of the bristle and its return count with the velocity at the end of the step.
"""

import warp as wp

from ..data import ActuatorLaw, ActuatorModel

MOTOR = wp.constant(3)
"""MuJoCo's ``mjGAIN_DCMOTOR`` and ``mjBIAS_DCMOTOR``, as Newton numbers them."""
POSITION_INPUT = wp.constant(1)
VELOCITY_INPUT = wp.constant(2)
"""What the control of a motor with a controller is, of ``ctrlspec``."""
_LEAST = wp.constant(1.0e-15)


@wp.func
def motor_law(
    actuators: wp.ref[ActuatorModel],
    row: int,
    control: float,
    length: float,
    velocity: float,
    h: float,
) -> ActuatorLaw:
    """What a DC motor pushes its transmission with; its states go on by a step.

    Args:
        actuators: The actuators.
        row: The motor.
        control: Its control: voltage [V], or the position or velocity of its transmission.
        length: Length of the transmission at the start of the step [m or rad].
        velocity: Its velocity [m/s or rad/s].
        h: Time step [s].
    """
    dyn = actuators.dynprm[row]
    gain = actuators.gainprm[row]
    bias = actuators.biasprm[row]
    spec = actuators.inputs[row]
    now = actuators.motor[row]
    after = actuators.motor[row]
    law = ActuatorLaw()
    law.least = -wp.inf
    law.most = wp.inf
    u = control
    if dyn[7] > 0.0:
        u = wp.clamp(u, now.control - dyn[7] * h, now.control + dyn[7] * h)
        after.control = u
    if gain[5] > 0.0:
        after.integral = now.integral + h * (u - length)
        if dyn[8] > 0.0:
            after.integral = wp.clamp(after.integral, -dyn[8], dyn[8])
    constant = gain[1]
    cold = wp.max(gain[0], _LEAST)
    resistance = cold
    if dyn[2] > 0.0:
        resistance = wp.max(cold * (1.0 + gain[2] * (now.warmth + dyn[4] - gain[3])), _LEAST)
    voltage = u
    is_linear = False
    if spec == POSITION_INPUT or spec == VELOCITY_INPUT:
        wanted = gain[5] * now.integral
        wanted += wp.where(spec == POSITION_INPUT, gain[4], gain[6]) * u
        torque = wanted - gain[4] * length - gain[6] * velocity
        voltage = cold / constant * torque + constant * velocity
        is_linear = True
        if gain[7] > 0.0:
            is_linear = wp.abs(voltage) < gain[7]
            voltage = wp.clamp(voltage, -gain[7], gain[7])
        law.force = cold / resistance * wanted
        law.stiffness = cold / resistance * gain[4]
        law.damping = cold / resistance * gain[6]
    if not is_linear:
        law.force = constant / resistance * voltage
        law.stiffness = 0.0
        law.damping = constant * constant / resistance
    current = (voltage - constant * velocity) / resistance
    if dyn[0] > 0.0:
        rate = (current - now.current) / dyn[0]
        if dyn[1] > 0.0:
            rate = wp.clamp(rate, -dyn[1], dyn[1])
        current = now.current
        after.current = current + rate * dyn[0] * (1.0 - wp.exp(-h / dyn[0]))
        law.force = constant * wp.where(actuators.actearly[row], after.current, current)
        law.stiffness = 0.0
        law.damping = 0.0
    if dyn[2] > 0.0:
        heating = resistance * current * current - now.warmth / dyn[2]
        after.warmth = now.warmth + h * heating / wp.max(dyn[3], _LEAST)
    if bias[0] != 0.0:
        law.own_force = bias[0] * wp.sin(bias[1] * length + bias[2])
    if dyn[5] > 0.0:
        ratio = velocity / wp.max(bias[5], _LEAST)
        most = bias[3] + (bias[4] - bias[3]) * wp.exp(-ratio * ratio)
        fading = -dyn[5] * wp.abs(velocity) / wp.max(most, _LEAST)
        left = wp.exp(fading * h)
        span = h
        if fading * h < -1.0e-3:
            span = (left - 1.0) / fading
        after.bristle = left * now.bristle + span * velocity
        law.own_force -= (dyn[5] * left + dyn[6] * fading) * now.bristle
        law.own_damping = dyn[5] * span + dyn[6]
    total = after.control + after.integral + after.warmth + after.bristle + after.current
    if wp.isfinite(total):
        actuators.motor[row] = after
    return law
