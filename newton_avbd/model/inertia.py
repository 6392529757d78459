# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Inertia along joint axes in the reference pose, by which MuJoCo scales what is soft."""

from collections.abc import Callable, Iterator

import newton
import numpy as np
import warp as wp

from ..rows.joint import KINDS
from .actuators import Actuators
from .lone_joints import LoneJoints


def reference_state(model: newton.Model) -> newton.State:
    """A state in the reference pose: coordinates along axes are zero, balls are not turned."""
    kinds = [kind for kind, known in KINDS.items() if known.has_axes]
    coordinates = np.zeros(model.joint_coord_count)
    is_ball = model.joint_type.numpy() == int(newton.JointType.BALL)
    coordinates[model.joint_q_start.numpy()[:-1][is_ball] + 3] = 1.0
    return _posed_state(model, [*kinds, int(newton.JointType.BALL)], coordinates)


def spring_state(model: newton.Model) -> newton.State:
    """A state in which the springs of all joints are at rest, MuJoCo's ``qpos_spring``."""
    kinds = [kind for kind, known in KINDS.items() if known.in_tree]
    return _posed_state(model, kinds, model.joint_rest_q.numpy())


def _posed_state(model: newton.Model, kinds: list[int], coordinates: np.ndarray) -> newton.State:
    """A state in which joints of some kinds have given coordinates, and others the model's."""
    state = model.state()
    if model.joint_count == 0:
        return state
    joint_q = model.joint_q.numpy().copy()  # on a CPU it is the array itself
    starts = model.joint_q_start.numpy()
    for joint in np.flatnonzero(np.isin(model.joint_type.numpy(), kinds)).tolist():
        at = slice(starts[joint], starts[joint + 1])
        joint_q[at] = coordinates[at]
    state.joint_q.assign(joint_q)
    newton.eval_fk(model, state.joint_q, model.joint_qd, state)
    LoneJoints(model).place(state)
    return state


def reference_matrices(
    model: newton.Model, beside: np.ndarray | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Degrees of freedom of each articulation and its mass matrix at q = 0, armature included.

    A joint of no articulation that holds a lone body to the world counts as one.

    Args:
        model: The model.
        beside: What the armature of tendons adds, shape (joint_dof_count, joint_dof_count).
    """
    added = np.diag(Actuators.of_model(model).armature(model).astype(float))
    if beside is not None:
        added += beside
    state, starts = reference_state(model), model.joint_qd_start.numpy()
    poses, lone = state.body_q.numpy(), LoneJoints(model)
    for joint in lone.joints:
        dofs = lone.dofs(joint)
        yield dofs, lone.matrix(joint, poses) + added[np.ix_(dofs, dofs)]
    if not model.articulation_count:
        return
    matrices = newton.eval_mass_matrix(model, state).numpy().astype(float)
    ends = (model.articulation_start, model.articulation_end)
    first, last = (starts[end.numpy()] for end in ends)
    for k in range(model.articulation_count):
        # joints that close loops stand between articulations
        dofs = np.arange(first[k], last[k])
        yield dofs, matrices[k, : dofs.size, : dofs.size] + added[np.ix_(dofs, dofs)]


def reference_mobility(
    model: newton.Model, beside: np.ndarray | None = None
) -> dict[int, tuple[float, float]]:
    """How a unit force accelerates degrees of freedom at q = 0.

    Args:
        model: The model.
        beside: See :func:`reference_matrices`.

    Returns:
        Diagonal entry of the mass matrix's inverse, armature included, and the norm of its column,
        which is how the force accelerates all; by degree of freedom. Those of joints that close
        loops are not among them.
    """
    found: dict[int, tuple[float, float]] = {}
    for dofs, matrix in reference_matrices(model, beside):
        inverse = np.linalg.pinv(matrix)
        for i, dof in enumerate(dofs.tolist()):
            norm = float(np.linalg.norm(inverse[:, i]))
            found[dof] = (float(inverse[i, i]), norm)
    return found


def reference_moments(
    model: newton.Model, rates_of: Callable[[newton.State], np.ndarray]
) -> np.ndarray:
    """How lengths change with each degree of freedom in the reference pose.

    Args:
        model: The model.
        rates_of: Finds the rates of the lengths in a state, shape (lengths,).

    Returns:
        Derivatives, shape (lengths, joint_dof_count) [m/m, m/rad, ...].
    """
    state, found = reference_state(model), []
    poses, lone = state.body_q.numpy(), LoneJoints(model)
    motion_of: dict[int, tuple[int, np.ndarray]] = {}
    for joint in lone.joints:
        for dof, moved in zip(lone.dofs(joint), lone.rates(joint, poses), strict=True):
            motion_of[int(dof)] = (lone.child[joint], moved)
    for dof in range(model.joint_dof_count):
        motion = np.zeros((model.body_count, 6), dtype=np.float32)
        if dof in motion_of:
            body, moved = motion_of[dof]
            motion[body] = moved
        state.body_qd.assign(motion)
        rates = np.zeros(model.joint_dof_count, dtype=np.float32)
        rates[dof] = 1.0
        newton.eval_fk(
            model, state.joint_q, wp.array(rates, dtype=float, device=model.device), state
        )
        found.append(rates_of(state).astype(float))
    return np.array(found).T


def mobility_along(
    model: newton.Model, moments: np.ndarray, beside: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How a unit of force along a length moves it in the reference pose, and all coordinates.

    Args:
        model: The model.
        moments: How the lengths change with each degree of freedom.
        beside: See :func:`reference_matrices`.

    Returns:
        J M^-1 J^T and the norm of M^-1 J^T of each of some lengths, and whether it moves degrees
        of freedom that :func:`reference_matrices` says nothing of.
    """
    along, norms = np.zeros(len(moments)), np.zeros(len(moments))
    is_unknown = np.ones(model.joint_dof_count, dtype=bool)
    for dofs, matrix in reference_matrices(model, beside):
        is_unknown[dofs] = False
        moved = np.linalg.pinv(matrix) @ moments[:, dofs].T
        along += np.einsum("ij,ji->i", moments[:, dofs], moved)
        norms += np.sum(moved**2, axis=0)
    return along, np.sqrt(norms), np.any(moments[:, is_unknown] != 0.0, axis=1)


def inertia_root(inertia: np.ndarray) -> np.ndarray:
    """A with A A^T = inertia."""
    moments, axes = np.linalg.eigh(inertia)
    return axes * np.sqrt(np.maximum(moments, 0.0))
