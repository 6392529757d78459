# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a solver says about a model that it cannot simulate, before it simulates anything."""

import warnings

import newton
import numpy as np

from .rows.joint import KINDS


def check_model(model: newton.Model, *, ramp: bool = False) -> None:
    """Refuses a model that holds what the solver does not support or cannot make sense of.

    Args:
        model: The model, on any device; its arrays are copied to the host.
        ramp: Whether it is to be solved by the ramped formulation.

    Raises:
        NotImplementedError: If a joint is of a type that the solver does not know.
        ValueError: If a mass, inertia, center of mass, joint frame, axis, limit, gain, friction
            coefficient or gravity is not finite, or a mass, gain or coefficient is negative.
    """
    _check_joints(model, ramp)
    _check_bodies(model)
    if model.shape_count:
        for name in ("shape_material_mu", "shape_material_ke", "shape_material_kd"):
            _check_numbers(model, name, model.shape_label, minimum=0.0)
    if not np.all(np.isfinite(model.gravity.numpy())):
        raise ValueError("model.gravity is not finite; set it with model.set_gravity().")
    if model.particle_count:
        warnings.warn(
            f"SolverAVBD moves rigid bodies only: the model's {model.particle_count} particles "
            "stay where they are. Use SolverVBD or SolverXPBD for them.",
            stacklevel=3,
        )


def _check_joints(model: newton.Model, ramp: bool) -> None:
    if model.joint_count == 0:
        return
    for joint, kind in enumerate(model.joint_type.numpy()):
        if kind not in KINDS or (ramp and kind != newton.JointType.FREE):
            where = " with formulation='ramp'" if ramp else ""
            raise NotImplementedError(
                f"SolverAVBD does not support joint {joint} '{_label(model.joint_label, joint)}' "
                f"of type {newton.JointType(int(kind)).name}{where}."
            )
    for name in ("joint_X_p", "joint_X_c"):
        _check_numbers(model, name, model.joint_label)
    owner = np.repeat(np.arange(model.joint_count), model.joint_dof_dim.numpy().sum(axis=1))
    labels = [_label(model.joint_label, joint) for joint in owner]
    for name in ("joint_axis", "joint_limit_lower", "joint_limit_upper"):
        _check_numbers(model, name, labels)
    if labels:
        lengths = np.linalg.norm(model.joint_axis.numpy(), axis=1)
        wrong = np.flatnonzero(np.abs(lengths - 1.0) > 1.0e-3)
        if wrong.size:
            raise ValueError(
                f"model.joint_axis[{wrong[0]}] ('{labels[wrong[0]]}') is not a unit vector: "
                f"{model.joint_axis.numpy()[wrong[0]]}."
            )
    for name in ("joint_target_ke", "joint_target_kd", "joint_limit_ke", "joint_limit_kd"):
        _check_numbers(model, name, labels, minimum=0.0)


def _check_bodies(model: newton.Model) -> None:
    if model.body_count == 0:
        return
    _check_numbers(model, "body_mass", model.body_label, minimum=0.0)
    for name in ("body_inertia", "body_inv_mass", "body_inv_inertia", "body_com"):
        _check_numbers(model, name, model.body_label)
    mass = model.body_mass.numpy()
    moments = np.diagonal(model.body_inertia.numpy(), axis1=1, axis2=2)
    locked = np.flatnonzero((mass > 0.0) & np.all(moments <= 0.0, axis=1))
    if locked.size:
        raise ValueError(
            f"body {locked[0]} '{_label(model.body_label, locked[0])}' has a mass but no inertia; "
            "give it a shape with density, or set body_inertia and body_inv_inertia."
        )


def _check_numbers(
    model: newton.Model, name: str, labels: list[str], minimum: float = -np.inf
) -> None:
    """Raises a ValueError that names the first entry of a model array that makes no sense."""
    values = getattr(model, name).numpy()
    if values.size == 0:
        return
    per_item = values.reshape(len(values), -1)
    wrong = np.flatnonzero(~np.all(np.isfinite(per_item) & (per_item >= minimum), axis=1))
    if wrong.size:
        item = int(wrong[0])
        problem = "is not finite"
        if np.all(np.isfinite(per_item[item])):
            problem = "is negative"
        raise ValueError(
            f"model.{name}[{item}] ('{_label(labels, item)}') {problem}: {values[item]}."
        )


def _label(labels: list[str], index: int) -> str:
    return labels[index] if index < len(labels) else ""
