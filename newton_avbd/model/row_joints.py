# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints that stand for MuJoCo's CONNECT and WELD constraints, where no importer made some.

A CONNECT holds its anchor, a point of the first body, to where that is on the second body in the
reference pose. A WELD holds its anchor, a point of the second body, to the position of its relpose
in the frame of the first one, and the second body to the rotation of its relpose against the first.
A relpose whose quaternion is zero is that of the reference pose. A WELD whose torquescale is zero
leaves the rotation free, as in MuJoCo; otherwise it is rigid, whatever its torquescale.
"""

from dataclasses import dataclass
from typing import Any

import newton
import numpy as np

from ..rows.joint import CONNECT
from .equalities import WELD
from .inertia import reference_state
from .welds import IDENTITY, inverse, multiply

_FIXED = int(newton.JointType.FIXED)


@dataclass(frozen=True)
class RowJoints:
    """The joints of some rows of ``mujoco:equality_constraint``; arrays of one entry a row."""

    label: list[str]
    type: np.ndarray
    """``CONNECT`` or ``JointType.FIXED``."""
    parent: np.ndarray
    """Links, -1 for the world."""
    child: np.ndarray
    parent_frame: np.ndarray
    """Anchor frames on the links, shape (rows, 7)."""
    child_frame: np.ndarray

    @classmethod
    def of_model(cls, model: newton.Model, rows: np.ndarray) -> "RowJoints":
        """Reads rows of a model; copies its arrays to the host."""
        mujoco: Any = model.mujoco

        def column(name: str) -> np.ndarray:
            return getattr(mujoco, f"equality_constraint_{name}").numpy()[rows]

        bodies = np.stack([column("body1"), column("body2")])
        is_weld = column("type") == WELD
        poses = np.vstack([reference_state(model).body_q.numpy().astype(np.float64), IDENTITY])
        apart = multiply(inverse(poses[bodies[0]]), poses[bodies[1]])
        anchor = np.tile(IDENTITY, (rows.size, 1))
        anchor[:, :3] = column("anchor")
        relpose = column("relpose").astype(np.float64)
        length = np.linalg.norm(relpose[:, 3:], axis=1, keepdims=True)
        is_said = length[:, 0] > 0.0
        relpose[is_said, 3:] /= length[is_said]
        first = np.where(is_said[:, None], relpose, multiply(apart, anchor))
        second = multiply(inverse(apart), anchor)
        second[:, 3:] = IDENTITY[3:]
        frames = np.stack(
            [np.where(is_weld[:, None], first, anchor), np.where(is_weld[:, None], anchor, second)]
        )
        # the world is no child
        child = (bodies[1] >= 0).astype(int)
        item = np.arange(rows.size)
        return cls(
            label=[mujoco.equality_constraint_label[row] for row in rows.tolist()],
            type=np.where(is_weld & (column("torquescale") != 0.0), _FIXED, CONNECT),
            parent=bodies[1 - child, item],
            child=bodies[child, item],
            parent_frame=frames[1 - child, item],
            child_frame=frames[child, item],
        )
