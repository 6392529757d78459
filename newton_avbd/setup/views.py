# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What the kernels see of the model and of contact buffers: their arrays, without a copy."""

from typing import Any

import newton
import numpy as np
import warp as wp

from .. import data
from ..attributes import dahl_friction
from ..drivers.launch import Launcher
from ..rows.joint import gimbal_joints, oblique_joints
from ..step.joint_state import measure_joints


def _take(struct: Any, source: Any, prefix: str, *names: str) -> None:
    """Has arrays of a struct be those of the same names behind a prefix."""
    for name in names:
        setattr(struct, name, getattr(source, f"{prefix}{name}"))


def body_model(model: newton.Model, free_joint: wp.array, free_dof: wp.array) -> Any:
    """Bodies, and each one's first joint that pushes it, with its degree of freedom, or -1."""
    bodies = data.BodyModel()
    names = ("mass", "inertia", "inv_mass", "inv_inertia", "com", "flags", "world")
    _take(bodies, model, "body_", *names)
    bodies.gravity = model.gravity
    bodies.free_joint = free_joint
    bodies.free_dof = free_dof
    if model.joint_count:
        bodies.joint_enabled = model.joint_enabled
    return bodies


def joint_model(model: newton.Model) -> Any:
    """Joints."""
    joints = data.JointModel()
    if model.joint_count:
        _take(joints, model, "joint_", "type", "parent", "child", "enabled", "axis", "dof_dim")
        _take(joints, model, "joint_", "target_mode", "target_ke", "target_kd")
        _take(joints, model, "joint_", "limit_lower", "limit_upper", "limit_ke", "limit_kd")
        _take(joints, model, "joint_", "rest_q", "damping", "stiffness", "armature", "friction")
        _take(joints, model, "joint_", "effort_limit", "velocity_limit")
        joints.parent_frame, joints.child_frame = model.joint_X_p, model.joint_X_c
        joints.dof_start, joints.coord_start = model.joint_qd_start, model.joint_q_start
        joints.mimic_coefficients = model.joint_mimic_coeffs
        if model.custom_frequency_counts.get("mujoco:equality_constraint", 0):
            joints.polynomials = model.mujoco.equality_constraint_polycoef
        for name, values in dahl_friction(model).items():
            setattr(joints, name, values)
    return joints


def shape_model(model: newton.Model) -> Any:
    """Shapes and their materials."""
    shapes = data.ShapeModel()
    _take(shapes, model, "shape_", "body", "type", "scale")
    if hasattr(model, "shape_frame"):
        shapes.frame = model.shape_frame
    shapes.pose = model.shape_transform
    material = ("mu", "mu_torsional", "mu_rolling", "restitution", "ke", "kd")
    _take(shapes, model, "shape_material_", *material)
    return shapes


def contact_input(contacts: newton.Contacts, buffer: int, surfaces: wp.array | None) -> Any:
    """A contact buffer.

    Args:
        contacts: The buffer.
        buffer: A number by which to tell it from others.
        surfaces: Velocities of the surfaces [m/s], shape (rigid_contact_max,); None for none.
    """
    source = data.ContactInput()
    source.buffer = buffer
    source.capacity = contacts.rigid_contact_max
    source.generation = contacts.contact_generation
    _take(source, contacts, "rigid_contact_", "count", "shape0", "shape1", "point0", "point1")
    _take(source, contacts, "rigid_contact_", "normal", "margin0", "margin1")
    if surfaces is not None:
        source.surface_velocity = surfaces
    if contacts.rigid_contact_friction is not None:
        _take(source, contacts, "rigid_contact_", "stiffness", "damping", "friction")
    if contacts.rigid_contact_match_index is not None:
        _take(source, contacts, "rigid_contact_", "match_index", "match_generation")
    return source


def indices(values: np.ndarray) -> wp.array:
    """An array of indices on the current device."""
    return wp.array(values.astype(np.int32), dtype=wp.int32)


def lists(items: list[list[int]]) -> tuple[wp.array, wp.array]:
    """Where each of some lists starts in one array, and that array."""
    flat = np.array([item for one in items for item in one], dtype=int)
    return indices(np.cumsum([0, *map(len, items)])), indices(flat)


def coordinates_of(model: newton.Model, dofs: np.ndarray) -> np.ndarray:
    """Joint coordinate of degrees of freedom that have an axis."""
    if dofs.size == 0:
        return dofs
    starts = model.joint_qd_start.numpy()
    joint = np.searchsorted(starts, dofs, side="right") - 1
    return dofs - starts[joint] + model.joint_q_start.numpy()[joint]


class AllJoints:
    """A model whose joints all belong to one articulation, which is what ``eval_ik`` evaluates."""

    def __init__(self, model: newton.Model) -> None:
        self._model = model
        with wp.ScopedDevice(model.device):
            self._missed = indices(np.union1d(oblique_joints(model), gimbal_joints(model)))
            self._joints = joint_model(model) if self._missed.size else None
        self.articulation_start = wp.array([0], dtype=wp.int32, device=model.device)
        self.articulation_end = wp.array([model.joint_count], dtype=wp.int32, device=model.device)
        self.articulation_count = 1
        self.max_joints_per_articulation = model.joint_count

    def __getattr__(self, name: str) -> Any:
        return getattr(self._model, name)

    def measure(
        self, launch: Launcher, state: newton.State, joint_q: wp.array, joint_qd: wp.array
    ) -> None:
        """Writes the coordinates that the bodies of a state have, and their rates."""
        newton.eval_ik(self, state, joint_q, joint_qd)
        if self._joints is not None:
            given = [self._joints, self._missed, state.body_q, state.body_qd]
            launch(measure_joints, self._missed.size, [*given, joint_q, joint_qd])
