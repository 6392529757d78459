# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Rotations on the host."""

import numpy as np
import warp as wp


def rotation_matrix(rotation: np.ndarray) -> np.ndarray:
    """Matrix of a quaternion (xyzw)."""
    return np.array(wp.quat_to_matrix(wp.quat(*rotation))).reshape(3, 3)
