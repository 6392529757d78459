# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Error control: how far a step has led a world astray.

The estimate costs no solve. With the mean acceleration A of a step, its velocity change by h, a
step of second order misses C h^2 dA, where dA is what A has changed since the last step: the rest
of Taylor's series that the scheme leaves out (Milne's device, with the last step in the place of a
second formula). A step of fourth order leaves a difference of its own: by h/6 of that between the
velocities of its last stage and of its end, the same stages make a step of third order (with the
end in the place of the last stage). That misses z^4/72 of an oscillation that the step takes z far,
and the step itself z^5/120. A step of backward Euler misses h^2 A / 2, and so does a step
in which a velocity jumps by h A, at a time in the step that it does not know.
"""

import functools

import warp as wp

from ..data import Solver, Step
from ..effects import Effects
from .bodies import MIDPOINT, body_at, moved_by

TRUNCATED = wp.constant(0.14)
"""C above. Positions miss h^3/12 of the jerk with the weights of the scheme, and velocities as much
of its rate; how far both lead a pendulum astray in a second decides here."""
SAVED = wp.constant(0.25)
"""Error that may be saved for steps that are not of second order, as a time [s] that the accuracy
counts for: an impact or a start may cost as much as a quarter of a second of smooth motion."""
JUMP = wp.constant(2.0)
"""How many times larger than the last mean acceleration one has to be to be a jump: what comes
after a jump is as smooth as what was before it, so that its time is found by halving."""
SMOOTHLY = wp.constant(0)
"""Why a body went astray most: in smooth motion, ..."""
BY_EULER = wp.constant(1)
"""... in a step of first order, as after an impact, a start or a change of order, ..."""
BY_JUMP = wp.constant(2)
"""... because its velocity jumped, ..."""
UNSETTLED = wp.constant(3)
"""... or because sweeps did not settle."""


@wp.struct
class Misstep:
    """How far a step has led a world astray."""

    error: float
    """[m]"""
    body: int
    """The body that has it; -1 where nothing moves."""
    cause: int
    is_jump: bool
    """Whether a velocity has jumped, in a step that is not of second order."""
    order: int
    """Of the step in time: 1, 2 or 4."""
    is_settled: bool
    residual: float
    """Update that sweeps were left at [m]."""


@functools.cache
def make_local_error(effects: Effects) -> wp.Function:
    """Device function: how far a step has led a body astray."""

    @wp.func
    def local_error(
        body: int,
        h: float,
        last_h: float,
        is_second_order: bool,
        change: wp.spatial_vector,
        s: wp.ref[Solver],
    ) -> float:
        """By its mean acceleration in the step [m/s^2, rad/s^2]; a turn counts by the radius of
        gyration [m]."""
        is_smooth = is_second_order
        changed = change - s.history.change[body]
        if s.history.flying[body] != 0:
            # a parabola is exact
            changed = wp.spatial_vector(wp.vec3(0.0), wp.spatial_bottom(changed))
            is_smooth = bool(True)
            if wp.static(effects.gyroscopic):
                turn = wp.spatial_bottom(s.work.increment[body])
                if wp.length_sq(turn) > MIDPOINT * MIDPOINT:
                    is_smooth = bool(False)
                    changed = change
        if is_smooth:
            # from the middle of the last step to that of this one
            apart = 2.0 * h / (h + last_h)
            return TRUNCATED * h * h * apart * wp.sqrt(moved_by(body, changed, s.work))
        return 0.5 * h * h * wp.sqrt(moved_by(body, change, s.work))

    return local_error


@functools.cache
def make_judge(effects: Effects) -> wp.Function:
    """Device function: how far a step has led a world astray."""
    local_error = make_local_error(effects)

    @wp.func
    def stage_error(
        world: int, body: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> float:
        """Error of a body in a step of fourth order [m], by its last stage."""
        if wp.static(effects.fourth_order):
            share = wp.min(wp.static(72.0 / 120.0) * s.tree.runge_kutta.turns[world], 1.0)
            apart = step.body_qd_out[body] - s.tree.runge_kutta.before[body]
            return share * (h / 6.0) * wp.sqrt(moved_by(body, apart, s.work))
        return 0.0

    @wp.func
    def judge(
        world: int, h: float, last_h: float, made: Misstep, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> Misstep:
        """By its bodies, and by what its sweeps have left."""
        out = made
        out.body = -1
        out.cause = wp.where(made.order > 1, SMOOTHLY, BY_EULER)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                change = (step.body_qd_out[body] - s.worlds.inner.velocity[body]) / h
                error = float(0.0)
                if made.order == 4:
                    error = stage_error(world, body, h, step, s)
                else:
                    error = local_error(body, h, last_h, made.order > 1, change, s)
                if error > out.error:
                    out.error = error
                    out.body = body
                    before = moved_by(body, s.history.change[body], s.work)
                    jumps = moved_by(body, change, s.work) > JUMP * JUMP * before
                    out.is_jump = jumps and made.order == 1
        if not made.is_settled and wp.isfinite(made.residual):
            # what sweeps leave of forces stays in velocities
            out.error += SAVED * made.residual / h
            out.cause = int(UNSETTLED)
        return out

    return judge
