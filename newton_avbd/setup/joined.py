# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The user's model with the joints that rows of MuJoCo's equality constraints lack."""

from typing import Any

import newton
import numpy as np
import warp as wp

from ..model.equalities import lonely_rows, moved_rows, places
from ..model.row_joints import RowJoints


class JoinedModel:
    """A model with one more joint for each CONNECT and WELD constraint that lacks one.

    A row lacks a joint if no importer made one of it, if that was disabled when the solver was
    made, or if the row has another anchor or relpose since. The joints stand behind the user's, and
    have no degrees of freedom. The arrays of joints are copies, made anew by :meth:`reread`; all
    else is the user's model's.
    """

    def __init__(self, model: newton.Model) -> None:
        """Finds the rows, and makes the arrays."""
        self.model = model
        self.own_rows = lonely_rows(model)
        self._places = places(model)
        self._make_arrays()

    def __getattr__(self, name: str) -> Any:
        value = getattr(self.model, name)
        return _Longer(value, self.own_rows.size) if name in ("avbd", "vbd") else value

    @property
    def whole(self) -> Any:
        """This model, or the user's where no row lacks a joint."""
        return self if self.own_rows.size else self.model

    def reread(self) -> None:
        """Reads rows and joints again, on the host."""
        self.own_rows = np.union1d(self.own_rows, moved_rows(self.model, self._places))
        self._make_arrays()

    def _make_arrays(self) -> None:
        model, count = self.model, self.own_rows.size
        if count == 0:
            return
        joints = RowJoints.of_model(model, self.own_rows)
        self.joint_count = model.joint_count + count
        self.joint_label = [*model.joint_label, *joints.label]
        for name, values in {
            "type": joints.type,
            "parent": joints.parent,
            "child": joints.child,
            "X_p": joints.parent_frame,
            "X_c": joints.child_frame,
            "enabled": np.ones(count, dtype=bool),
            "dof_dim": np.zeros((count, 2)),
            "articulation": np.full(count, -1),
            "mimic_joint": np.full(count, -1),
            "mimic_coeffs": np.zeros((count, 2)),
            "q_start": np.full(count, model.joint_coord_count),
            "qd_start": np.full(count, model.joint_dof_count),
        }.items():
            setattr(self, f"joint_{name}", _longer(getattr(model, f"joint_{name}"), values))


class _Longer:
    """Attributes of a scene, those of joints with values for further ones, which say nothing."""

    def __init__(self, authored: Any, count: int) -> None:
        self._authored, self._count = authored, count

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._authored, name)
        if not name.startswith(("joint_", "dahl_")):
            return value
        return _longer(value, np.full(self._count, np.inf if name.startswith("joint_") else 0.0))


def _longer(array: wp.array, values: np.ndarray) -> wp.array:
    """An array with some values more, on its device."""
    known = array.numpy().reshape(-1, *values.shape[1:])
    whole = np.concatenate([known, values.astype(known.dtype)])
    return wp.array(whole, dtype=array.dtype, device=array.device)
