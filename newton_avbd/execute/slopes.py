# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How a step of second order continues a motion: by rates, and by slopes that lag behind them.

The generalized alpha method of K. Jansen, C. Whiting, G. Hulbert (2000) for y' = f keeps beside the
rate f_n, which holds at the end of a step, a slope s_n, which holds a time a_n before it. From

    y_n+1 = y_n + A s_n + B f_n + C f_n+1,    y_n+1 = y_n + h ((1 - g) s_n + g s_n+1)

and B = b h, a_n+1 = a h by two constants, the other weights follow: both sums are of second order,
whatever the steps before, with A + B + C = h, C h - A a_n = h^2/2 and
g = (h/2 + a_n)/(h - a h + a_n). A step of backward Euler leaves a slope of age h/2.
"""

from typing import Any

import warp as wp

from ..data import AxisMotion, ControlInput, History, WorldScale
from ..effects import Effects

UNRESOLVED = wp.constant(-8)
"""Of a world: a body swings faster than steps can follow; one more for each step since. If the next
step but one were of second order again, a taut bridge would gain 1.2e-3 of its energy by turns."""
JUMPED = wp.constant(0)
"""Of a world: a velocity has jumped in the last step, or may have."""
SMOOTH = wp.constant(1)
"""Of a world: no velocity has jumped, and the step is remembered; one more for each step since."""
LASTING = wp.constant(4)
"""Of a world: as many steps have been smooth. Until then steps take rho = 0: what backward Euler
left, velocities along chords and not along what constraints allow, is gone at once."""
QUIET_WORLD = wp.constant(9)
"""Of a world: no velocity of what is held has changed."""

RHO = 0.5
"""Share that a step leaves of what is infinitely fast; none of the tensions of cables, which would
swing from step to step."""


def constants(rho: float) -> tuple[float, float]:
    """a and b above (Jansen, Whiting, Hulbert, equations 20, 23, 24).

    Args:
        rho: Share that a step leaves of what is infinitely fast: 0 makes BDF2 of the method, 1 the
            trapezoidal rule.
    """
    alpha_m, alpha_f = 0.5 * (3.0 - rho) / (1.0 + rho), 1.0 / (1.0 + rho)
    gamma = 0.5 + alpha_m - alpha_f
    return gamma - 0.5, gamma * (1.0 - alpha_f) / alpha_m


@wp.func
def is_going_on(smooth: int) -> bool:
    """Whether a step of a world was smooth, and is remembered."""
    return smooth >= SMOOTH and smooth <= LASTING


@wp.func
def follows_second_order(scale: WorldScale) -> bool:
    """Whether the last step was of second order: velocities then do not lag behind positions."""
    return scale.lag == 0.0


@wp.func
def second_order(scale: WorldScale, a: float, b: float) -> WorldScale:
    """Weights of a step after one whose slopes are older than its end by ``scale.age`` [s]."""
    out = scale
    h = scale.h
    out.by_rate = b * h
    out.by_slope = (0.5 - b) * h * h / (h + scale.age)
    out.step = h - out.by_rate - out.by_slope
    out.blend = (0.5 * h + scale.age) / ((1.0 - a) * h + scale.age)
    return out


@wp.func
def lead(scale: WorldScale, rate: Any, slope: Any):
    """By how much a step starts ahead."""
    return scale.by_rate * rate + scale.by_slope * slope


@wp.func
def next_slope(scale: WorldScale, change: Any, slope: Any):
    """The slope after a step, by the change in it."""
    return (change / scale.h - (1.0 - scale.blend) * slope) / scale.blend


@wp.func
def begin_axis(
    dof: int, start: wp.float64, scale: WorldScale, motions: wp.array[AxisMotion]
) -> wp.float64:
    """Where a step starts a degree of freedom, ahead of the value that it has."""
    motion = motions[dof]
    motions[dof].start = start
    return start + wp.float64(lead(scale, motion.rate, motion.slope))


@wp.func
def end_axis(
    dof: int,
    lead_start: wp.float64,
    end: wp.float64,
    scale: WorldScale,
    motions: wp.array[AxisMotion],
):
    """How a degree of freedom moved from where :func:`begin_axis` started it."""
    motion = motions[dof]
    motion.rate = wp.float32(end - lead_start) / scale.step
    motion.slope = next_slope(scale, wp.float32(end - motion.start), motion.slope)
    motions[dof] = motion


@wp.func
def step_push(force: float, last: wp.vec2, scale: WorldScale) -> wp.vec2:
    """Rate and slope by which a force that is constant over the step gives all of its impulse.

    With the force as the rate a step would take part of its impulse from the forces of the last
    steps: those of a controller that writes one force a step would act half a step late.
    """
    if scale.step == scale.h:
        return wp.vec2(force, force)
    impulse = scale.h * force
    rate = (impulse - lead(scale, last[0], last[1])) / scale.step
    return wp.vec2(rate, next_slope(scale, impulse, last[1]))


def make_push(effects: Effects) -> tuple[wp.Function, wp.Function]:
    """Device functions: forces along a joint's axes that are constant over the step.

    They are ``joint_f`` and what actuators push with whatever the motion is.
    """

    @wp.func
    def constant_push(dof: int, control: wp.ref[ControlInput]) -> float:
        force = control.joint_f[dof]
        if wp.static(effects.pushed_axes):
            force += control.pushes[dof].force
        return force

    @wp.func
    def begin_push(
        first: int,
        end: int,
        scale: WorldScale,
        control: wp.ref[ControlInput],
        history: wp.ref[History],
    ):
        """At the start of a step, of the degrees of freedom of a joint."""
        if wp.static(effects.second_order):
            for dof in range(first, end):
                force = constant_push(dof, control)
                history.joint_push[dof] = step_push(force, history.joint_push[dof], scale)

    @wp.func
    def ahead_push(dof: int, control: wp.ref[ControlInput], history: wp.ref[History]) -> float:
        """How much more than these a step of second order counts [N or N m]."""
        if wp.static(effects.second_order):
            return history.joint_push[dof][0] - constant_push(dof, control)
        return 0.0

    return begin_push, ahead_push
