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

from ..data import AxisInput, AxisMotion, History, Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows.axis import drive_change, most_effort
from ..rows.joint import BALL

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

FREE_SHARE = wp.constant(0.99)
"""Share of the inertia in what resists along an axis from which the axis counts as not driven."""

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
def caught_up(share: float, scale: WorldScale) -> float:
    """Share of the impulse of a force that has just changed which a step has to make up for.

    Against a resistance of m = d h/I the force takes an axis to (1 - exp(-m))/m of the velocity
    that it would give without. A step of second order, with 1 + m H/h in the denominator, comes to
    the same with this share; a stiff spring, with m = k H h/I, to its target.

    Args:
        share: Of the inertia in what resists along the axis, 1/(1 + m H/h).
        scale: Of the step.
    """
    part = scale.step / scale.h
    m = (1.0 / share - 1.0) / part
    reached = wp.where(m < 0.01, 1.0 - 0.5 * m, (1.0 - wp.exp(-m)) / m)
    return wp.min((reached * (1.0 + part * m) - part) / (1.0 - part), 1.0)


@wp.func
def step_ahead(change: float, ahead: wp.vec2, share: float, scale: WorldScale) -> wp.vec2:
    """How much more than a force that has just changed a step counts, and the slope of that.

    The force of a controller is constant over the step, or changes at its start, and is to give all
    of its impulse in it. With the force as the rate at the end, a step takes part of the impulse
    from the last steps, before the change: the controller would act half a step late.

    Args:
        change: By how much the force has changed since the last step [N or N m].
        ahead: What the last step counted more, and its slope.
        share: Share of the inertia in what resists along the axis. What is stiff follows at once,
            and more would be an overshoot; what is held, by a stop or friction, has no impulse of
            the last steps to make up for.
        scale: Of the step.
    """
    if scale.step == scale.h or share == 0.0:
        return wp.vec2(0.0, 0.0)
    # of what the last step counted, beyond the force as it is now
    rate = ahead[0] - change
    slope = ahead[1] - change
    led = lead(scale, rate, slope)
    now = -caught_up(share, scale) * led / scale.step
    return wp.vec2(now, next_slope(scale, led + scale.step * now, slope))


@wp.func
def change_within(last: AxisInput, change: float, least: float, most: float, resists: float):
    """By how much a force within limits changes, and the share of the inertia in what resists it.

    A force at its limit has no stiffness, and one that has left it has its own again.

    Args:
        last: Of the last step.
        change: By how much the force would change without limits [N or N m].
        least: Lower limit [N or N m].
        most: Upper one.
        resists: What its stiffness and damping resist with, by h^2 [kg or kg m^2].
    """
    before = wp.clamp(last.bound_force, least, most)
    after = wp.clamp(last.bound_force + change, least, most)
    share = last.share
    if share > 0.0:
        if after != last.bound_force + change:
            share = 1.0
        elif before != last.bound_force:
            share = wp.min(share, 1.0 / (1.0 + last.mobility * resists))
    return wp.vec2(after - before, share)


def make_resistance(effects: Effects) -> wp.Function:
    """Device function: what drives resist motion with."""

    @wp.func
    def resistance(dof: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]) -> float:
        """What the drive and limited actuators of an axis resist its motion with within their
        limits, by h^2 [kg or kg m^2]."""
        resists = float(0.0)
        if wp.static(effects.drives):
            resists = scale.h * (scale.h * s.joints.target_ke[dof] + s.joints.target_kd[dof])
        if wp.static(effects.effort_limits and effects.pushed_axes):
            push = step.control.pushes[dof]
            resists += scale.h * (scale.h * push.drive_stiffness + push.drive_damping)
        return resists

    return resistance


def make_inputs(effects: Effects) -> Functions:
    """Device functions: what a controller pushes along the axes of a joint, in second order.

    That is ``joint_f``, what actuators push with whatever the motion is, and the targets of drives,
    within their limits.
    """
    resistance = make_resistance(effects)
    acts_within = effects.drives or (effects.pushed_axes and effects.effort_limits)

    @wp.func
    def drive_jump(
        joint: int, dof: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> float:
        """By how much targets and limited actuators change a force in a step [N or N m]."""
        last = s.history.input[dof]
        change = float(0.0)
        if wp.static(effects.drives):
            target = float(0.0)
            if s.joints.type[joint] != BALL:
                first = s.joints.dof_start[joint]
                target = step.control.target_q[s.joints.coord_start[joint] + dof - first]
            speed = step.control.target_qd[dof]
            change = drive_change(s.joints, dof, target - last.target, speed - last.speed)
            s.history.input[dof].target = target
            s.history.input[dof].speed = speed
        if wp.static(effects.effort_limits):
            resists = resistance(dof, scale, step, s)
            most = most_effort(s.joints, dof)
            least = -most
            if wp.static(effects.pushed_axes):
                push = step.control.pushes[dof]
                bound_push = push.drive + push.level
                change += bound_push - last.bound_push - push.turned[1]
                s.history.input[dof].bound_push = bound_push
                least = wp.max(least, push.least)
                most = wp.min(most, push.most)
                if wp.static(effects.force_ranges):
                    resists += push.resists
                    if last.share > 0.0 and change != 0.0:
                        more = last.mobility * (push.resists - push.resisted)
                        last.share = 1.0 / wp.max(1.0 / last.share + more, 1.0)
            bound = change_within(last, change, least, most, resists)
            change = bound[0]
            s.history.input[dof].share = bound[1]
        return change

    @wp.func
    def begin_inputs(joint: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]) -> float:
        """At the start of a step; returns twice the energy that its changes give in one [J]."""
        given = float(0.0)
        if wp.static(effects.second_order):
            first = s.joints.dof_start[joint]
            for dof in range(first, s.joints.dof_start[joint + 1]):
                last = s.history.input[dof]
                push = step.control.joint_f[dof]
                turned = float(0.0)
                if wp.static(effects.pushed_axes):
                    push += step.control.pushes[dof].force
                    turned = step.control.pushes[dof].turned[0]
                jump = push - last.push - turned
                if wp.static(acts_within):
                    jump += drive_jump(joint, dof, scale, step, s)
                share = s.history.input[dof].share
                s.history.input[dof].push = push
                ahead = step_ahead(jump, last.ahead, share, scale)
                s.history.input[dof].ahead = ahead
                change = jump + ahead[0] - last.ahead[0]
                given += last.mobility * change * change
        return scale.h * scale.h * given

    @wp.func
    def resists_everywhere(joint: int, s: wp.ref[Solver]) -> bool:
        """Whether drives resist motion along all axes of a joint, beside their inertia."""
        for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
            if s.history.input[dof].share > FREE_SHARE:
                return False
        return True

    @wp.func
    def ahead_along(dof: int, history: wp.ref[History]) -> float:
        """How much more than what the controller pushes with the step counts [N or N m]."""
        if wp.static(effects.second_order):
            return history.input[dof].ahead[0]
        return 0.0

    @wp.func
    def keep_input(
        dof: int,
        inertia: float,
        share: float,
        bound_force: float,
        inv_h2: float,
        history: wp.ref[History],
    ):
        """For the next step: the inertia along the axis by h^2, its share in what resists, and what
        has a limit pushed with, if it had none."""
        if wp.static(effects.second_order):
            history.input[dof].share = wp.clamp(share, 0.0, 1.0)
            history.input[dof].mobility = inv_h2 / inertia
            history.input[dof].bound_force = bound_force

    return together(begin_inputs, resists_everywhere, ahead_along, keep_input)
