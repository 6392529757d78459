# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What slows a body down by how it moves itself: a fluid, and actuators that hold it.

With the drag ``push - D v``, linear in the velocity v of the step's end, the inertial target is
where inertia and drag take a body together, and the block of the body is M/h^2 + D/h: what follows
sees a body that resists more, and no new force. So it is implicit, however stiff.
"""

import functools

import warp as wp

from ..algebra.block import factor_block, solve_block
from ..data import Drag, Solver
from ..effects import Effects
from .body_actuators import servo_drag
from .fluid import fluid_drag


@wp.func
def resistance(drag: Drag, motion: wp.spatial_vector) -> wp.spatial_vector:
    """D times a motion: wrench by which the drag resists it, of a velocity [N, N m]."""
    shift = wp.spatial_top(motion)
    turn = wp.spatial_bottom(motion)
    return wp.spatial_vector(
        drag.ll * shift + wp.transpose(drag.al) * turn, drag.al * shift + drag.aa * turn
    )


@wp.func
def response(
    body: int, wrench: wp.spatial_vector, step: float, drag: Drag, s: wp.ref[Solver]
) -> wp.spatial_vector:
    """Increment that a wrench gives a body against its inertia and the drag [m, rad]."""
    inv_h2 = 1.0 / (step * step)
    factor = factor_block(
        wp.diag(wp.vec3(s.model.mass[body] * inv_h2)) + drag.ll / step,
        drag.al / step,
        s.work.inertia[body] * inv_h2 + drag.aa / step,
    )
    return solve_block(factor, wp.spatial_top(wrench), wp.spatial_bottom(wrench))


@functools.cache
def make_feel_drag(effects: Effects) -> wp.Function:
    """Device function: what drag does to the target of a body."""

    @wp.func
    def feel_drag(
        body: int,
        rotation: wp.quat,
        velocity: wp.spatial_vector,
        lead: wp.spatial_vector,
        step: float,
        s: wp.ref[Solver],
    ):
        """Moves the target of a body to where drag lets it go, and keeps the drag for its block.

        ``lead`` is the increment from which the velocity of the step counts.
        """
        free = (s.work.target[body] - lead) / step
        drag = Drag()
        if wp.static(effects.fluid):
            drag = fluid_drag(body, rotation, velocity, free, step, s.model)
        if wp.static(effects.servos):
            drag = servo_drag(drag, body, rotation, free, lead, step, s.model)
        wrench = drag.push - resistance(drag, free)
        slowed = response(body, wrench, step, drag, s)
        s.work.target[body] = s.work.target[body] + slowed
        s.work.momentum[body] = s.work.momentum[body] + step * (
            wp.spatial_bottom(wrench) - wp.spatial_bottom(resistance(drag, slowed / step))
        )
        s.work.drag[body] = drag
        size = wp.dot(slowed, slowed)
        if not (size - size == 0.0):
            s.work.finite[body] = 0

    return feel_drag
