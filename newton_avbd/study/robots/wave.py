# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The motion that the drives of a robot are to follow."""

import newton
import numpy as np

from newton_avbd.measure.state import Array
from newton_avbd.scenes.pose import dofs_of


def wave(
    builder: newton.ModelBuilder, driven: list[int], seconds: Array, frequency: float, reach: float
) -> Array:
    """Targets that wave about the first pose within the limits, shape [times, coordinates].

    Args:
        builder: The robot.
        driven: Degrees of freedom to move.
        seconds: Times since the start of the motion [s], at which it is in the first pose.
        frequency: Frequency [Hz].
        reach: Largest displacement from the first pose [rad]; a third of it in meters.
    """
    targets = np.tile(np.array(builder.joint_q, float), (len(seconds), 1))
    for joint, kind in enumerate(builder.joint_type):
        if kind == newton.JointType.BALL:
            continue
        for i, dof in enumerate(dofs_of(builder, joint)):
            if dof not in driven:
                continue
            at = builder.joint_q_start[joint] + i
            q = builder.joint_q[at]
            far = reach / 3.0 if i < builder.joint_dof_dim[joint][0] else reach
            # What is near a limit moves away from it only.
            low = max(builder.joint_limit_lower[dof], q - far)
            high = min(builder.joint_limit_upper[dof], q + far)
            if low >= high:
                continue
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            phase = np.arcsin(np.clip((q - middle) / half, -1.0, 1.0))
            ramp = np.minimum(seconds * frequency, 1.0)
            goal = middle + half * np.sin(2.0 * np.pi * frequency * seconds + phase)
            targets[:, at] = q + ramp * (goal - q)
    return targets
