# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What acts along a joint's free axes: drives, limits and generalized forces.

A drive pulls a coordinate q with ke (target_q - q) + kd (target_qd - dq/h), implicitly: its
curvature ke + kd/h stands beside the inertia that the coordinate meets, so no gain is too stiff.

A limit is hard: it holds the coordinate where it stops, and lets go as soon as it would have to
pull (a primal-dual active set: Hintermueller, Ito, Kunisch, SIAM J. Optim. 13, 2002). With
compliance it is a spring and damper instead, beyond the limit.
"""

import newton
import warp as wp

from ..data import ControlInput, JointModel

POSITION_MODE = wp.constant(int(newton.JointTargetMode.POSITION))
VELOCITY_MODE = wp.constant(int(newton.JointTargetMode.VELOCITY))
POSITION_VELOCITY_MODE = wp.constant(int(newton.JointTargetMode.POSITION_VELOCITY))

MOST_RECOVERED = wp.constant(2.0e-2)
"""Most that the recovery moves a coordinate in a step [m or rad]."""


@wp.func
def drive(
    joints: JointModel,
    control: ControlInput,
    dof: int,
    away: float,
    moved: float,
    h: float,
):
    """Generalized force of a drive [N or N m] and its curvature.

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
    if mode == POSITION_MODE or mode == POSITION_VELOCITY_MODE:
        ke = joints.target_ke[dof]
        kd = joints.target_kd[dof]
    if mode == VELOCITY_MODE:
        kd = joints.target_kd[dof]
    return ke * away + kd * (control.target_qd[dof] - moved / h), ke + kd / h


@wp.func
def rod_response(joints: JointModel, dof: int, q: float, moved: float, h: float):
    """Generalized force of a rod's stretch, shear, bend or twist [N or N m] and its curvature.

    Coefficients are the drive's ``target_ke`` and ``target_kd``, as in SolverVBD.
    """
    ke = joints.target_ke[dof]
    kd = joints.target_kd[dof]
    return -ke * q - kd * moved / h, ke + kd / h


@wp.func
def soft_limit(joints: JointModel, dof: int, q: float, moved: float, h: float):
    """Generalized force of a compliant limit [N or N m] and its curvature."""
    beyond = wp.min(q - joints.limit_lower[dof], 0.0) + wp.max(q - joints.limit_upper[dof], 0.0)
    if beyond == 0.0:
        return 0.0, 0.0
    ke = joints.limit_ke[dof]
    kd = joints.limit_kd[dof]
    return -ke * beyond - kd * moved / h, ke + kd / h


@wp.func
def lower_stop(joints: JointModel, dof: int, start: float, recovery: float) -> float:
    """Where the lower limit stops the coordinate [m or rad].

    What was beyond at the start of the step stays, so that it does not enter the velocity; the
    recovery takes out a share of it.
    """
    limit = joints.limit_lower[dof]
    beyond = wp.max(limit - start, 0.0)
    return limit - wp.max((1.0 - recovery) * beyond, beyond - MOST_RECOVERED)


@wp.func
def upper_stop(joints: JointModel, dof: int, start: float, recovery: float) -> float:
    """As :func:`lower_stop` for the upper limit."""
    limit = joints.limit_upper[dof]
    beyond = wp.max(start - limit, 0.0)
    return limit + wp.max((1.0 - recovery) * beyond, beyond - MOST_RECOVERED)


@wp.func
def held_side(lower: float, upper: float, q: float, limit_force: float) -> int:
    """Which stop holds the coordinate: -1 the lower, 1 the upper, 0 none."""
    if limit_force > 0.0 or (limit_force == 0.0 and q < lower):
        return -1
    if limit_force < 0.0 or q > upper:
        return 1
    return 0
