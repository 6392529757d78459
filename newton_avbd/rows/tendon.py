# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What acts along a tendon of MuJoCo's, by its length L.

It is what acts along a joint axis (:mod:`.rows.axis`), at the end of the step:

    actuators  force - stiffness L - damping dL/h, or in parts within a force range
    spring     -stiffness (L - band), where L is beyond the band of the spring's lengths
    damping    -damping dL/h
    armature   -armature (dL/h - v)/h, with v at the start of the step
    friction   +-frictionloss against dL, anything between where dL = 0
    stops      anything that holds L within its range; with compliance by MuJoCo's impedance
"""

import warp as wp

from ..data import AxisLaw, TendonModel
from .axis import LEAN, LEAN_RATE, LEANING, left_beyond, within_limits


@wp.func
def stretch_of(i: int, length: float, tendons: wp.ref[TendonModel]) -> float:
    """How far a tendon is beyond the band in which its spring is slack [m or rad].

    As in MuJoCo -1 stands for the length at which the springs of joints are at rest, and as in
    SolverMuJoCo a second length below the first for that.
    """
    band = tendons.springlength[tendons.row[i]]
    if band[0] == -1.0:
        band = wp.vec2(tendons.spring_rest[i], tendons.spring_rest[i])
    elif band[1] < band[0]:
        band = wp.vec2(band[0], band[0])
    return wp.min(length - band[0], 0.0) + wp.max(length - band[1], 0.0)


@wp.func
def range_of(i: int, tendons: wp.ref[TendonModel]) -> wp.vec2:
    """Range of a tendon's length less its margin [m or rad], infinite where it has none."""
    if not tendons.is_limited[i]:
        return wp.vec2(-wp.inf, wp.inf)
    row = tendons.row[i]
    ends = tendons.range[row]
    return wp.vec2(ends[0] + tendons.margin[row], ends[1] - tendons.margin[row])


@wp.func
def linear_pull(
    i: int, length: float, moved: float, compliance: bool, h: float, tendons: wp.ref[TendonModel]
):
    """Force along a tendon of what is linear in pieces without a limit, and its curvature.

    Args:
        i: The tendon.
        length: Its length [m or rad].
        moved: By how much that has changed in the step.
        compliance: Whether its limits give way.
        h: Time step [s].
        tendons: The tendons.
    """
    row = tendons.row[i]
    push = tendons.push[i]
    stiffness = push.stiffness
    damping = push.damping + tendons.damping[row]
    force = push.force - push.stiffness * length
    beyond = stretch_of(i, length, tendons)
    if beyond != 0.0:
        force -= tendons.stiffness[row] * beyond
        stiffness += tendons.stiffness[row]
    inertia = tendons.armature[row] / (h * h)
    force -= damping * moved / h + inertia * (moved - h * tendons.start_velocity[i])
    stiffness += damping / h + inertia
    if compliance and tendons.is_limited[i]:
        pull, k = within_limits(
            length - moved,
            range_of(i, tendons),
            moved,
            tendons.limit_velocity[i],
            tendons.limit_impedance[row],
            tendons.limit_rates[i],
            tendons.limit_mobility[i],
            h,
        )
        force += pull
        stiffness += k
    return force, stiffness


@wp.func
def tendon_law(
    i: int,
    at: wp.float64,
    moved: float,
    compliance: bool,
    recovery: float,
    h: float,
    tendons: wp.ref[TendonModel],
) -> AxisLaw:
    """What is not linear along a tendon, about its length, and the piece that it is taken to be on;
    see :func:`.step.axes.make_axis`."""
    row = tendons.row[i]
    push = tendons.push[i]
    known = tendons.piece[i]
    length = wp.float32(at)
    side = int(known[0])
    limit = int(0)
    slip = int(1)
    law = AxisLaw()
    law.lower = -wp.inf
    law.upper = wp.inf
    if not compliance and tendons.is_limited[i]:
        ends = range_of(i, tendons)
        below = wp.float32(wp.float64(ends[0]) - at)
        above = wp.float32(wp.float64(ends[1]) - at)
        law.lower = below - left_beyond(below + moved, recovery)
        law.upper = above + left_beyond(-above - moved, recovery)
        law.slack = wp.min(LEAN * wp.max(1.0, wp.abs(length)), LEAN_RATE * h * h)
        if wp.abs(side) == LEANING:
            if wp.abs(wp.where(side < 0, law.lower, law.upper)) > law.slack:
                side = 0
        if side == 0:
            side = wp.where(law.lower > 0.0, -1, wp.where(law.upper < 0.0, 1, 0))
    else:
        side = 0
    law.friction = tendons.friction[row]
    law.hold = wp.float32(tendons.held_at[i] - at)
    if law.friction > 0.0:
        slip = known[2]
    law.drive = push.drive - push.drive_stiffness * length - push.drive_damping * moved / h
    law.drive_stiffness = push.drive_stiffness + push.drive_damping / h
    law.least = push.least
    law.most = push.most
    if wp.isfinite(push.least) or wp.isfinite(push.most):
        limit = known[1]
    law.piece = wp.vec3i(side, limit, slip)
    return law
