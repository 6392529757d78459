# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Inertia along joint axes in the reference pose, by which MuJoCo scales what is soft."""

from collections.abc import Iterator

import newton
import numpy as np

from .actuators import Actuators, reflected_armature
from .rows.joint import KINDS


def reference_state(model: newton.Model) -> newton.State:
    """A state in the reference pose: all coordinates along axes are zero."""
    state = model.state()
    joint_q = model.joint_q.numpy().copy()  # on a CPU it is the array itself
    starts, kinds = model.joint_q_start.numpy(), model.joint_type.numpy().tolist()
    for joint, kind in enumerate(kinds):
        if KINDS[newton.JointType(kind)].has_axes:
            joint_q[starts[joint] : starts[joint + 1]] = 0.0
    state.joint_q.assign(joint_q)
    newton.eval_fk(model, state.joint_q, model.joint_qd, state)
    return state


def reference_matrices(model: newton.Model) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Degrees of freedom of each articulation and its mass matrix at q = 0, armature included."""
    if not model.articulation_count:
        return
    axes = Actuators.of_model(model).axes
    armature = reflected_armature(model, axes, model.joint_dof_count)
    matrices = newton.eval_mass_matrix(model, reference_state(model)).numpy().astype(float)
    ends = (model.articulation_start, model.articulation_end)
    first, last = (model.joint_qd_start.numpy()[end.numpy()] for end in ends)
    for k in range(model.articulation_count):
        # joints that close loops stand between articulations
        dofs = np.arange(first[k], last[k])
        yield dofs, matrices[k, : dofs.size, : dofs.size] + np.diag(armature[dofs])


def reference_inertia(model: newton.Model) -> dict[int, tuple[float, float, float]]:
    """Inertia of each degree of freedom of an articulation at q = 0, armature included.

    Returns:
        Diagonal entry of the mass matrix, that of its inverse, and the norm of the inverse's
        column, which is how a unit force accelerates all; by degree of freedom.
    """
    found: dict[int, tuple[float, float, float]] = {}
    for dofs, matrix in reference_matrices(model):
        inverse = np.linalg.pinv(matrix)
        for i, dof in enumerate(dofs.tolist()):
            norm = float(np.linalg.norm(inverse[:, i]))
            found[dof] = (float(matrix[i, i]), float(inverse[i, i]), norm)
    return found
