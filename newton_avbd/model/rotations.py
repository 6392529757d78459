# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Rotations and poses on the host."""

import numpy as np
import warp as wp


def rotation_matrix(rotation: np.ndarray) -> np.ndarray:
    """Matrix of a quaternion (xyzw)."""
    return np.array(wp.quat_to_matrix(wp.quat(*rotation))).reshape(3, 3)


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rotate vectors ``v``, shape [..., 3], by unit quaternions ``q`` (x, y, z, w), [..., 4]."""
    t = 2.0 * np.cross(q[..., :3], v)
    return v + q[..., 3:] * t + np.cross(q[..., :3], t)


def conjugate(q: np.ndarray) -> np.ndarray:
    """Conjugates of quaternions, which turn the other way, shape [..., 4]."""
    return q * [-1.0, -1.0, -1.0, 1.0]


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of quaternions, shape [..., 4]."""
    va, vb, wa, wb = a[..., :3], b[..., :3], a[..., 3:], b[..., 3:]
    vector = wa * vb + wb * va + np.cross(va, vb)
    scalar = wa * wb - np.sum(va * vb, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def transform(pose: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Apply poses [m, quaternion], shape [..., 7], to points [m], shape [..., 3]."""
    return pose[..., :3] + rotate(pose[..., 3:], point)
