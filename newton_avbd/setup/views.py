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


def body_model(model: newton.Model, free_joint: wp.array, free_dof: wp.array) -> Any:
    """Bodies, and each one's first joint that pushes it, with its degree of freedom, or -1."""
    bodies = data.BodyModel()
    bodies.mass = model.body_mass
    bodies.inertia = model.body_inertia
    bodies.inv_mass = model.body_inv_mass
    bodies.inv_inertia = model.body_inv_inertia
    bodies.com = model.body_com
    bodies.flags = model.body_flags
    bodies.world = model.body_world
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
        joints.type = model.joint_type
        joints.parent = model.joint_parent
        joints.child = model.joint_child
        joints.parent_frame = model.joint_X_p
        joints.child_frame = model.joint_X_c
        joints.enabled = model.joint_enabled
        joints.axis = model.joint_axis
        joints.dof_start = model.joint_qd_start
        joints.dof_dim = model.joint_dof_dim
        joints.coord_start = model.joint_q_start
        joints.target_mode = model.joint_target_mode
        joints.target_ke = model.joint_target_ke
        joints.target_kd = model.joint_target_kd
        joints.limit_lower = model.joint_limit_lower
        joints.limit_upper = model.joint_limit_upper
        joints.limit_ke = model.joint_limit_ke
        joints.limit_kd = model.joint_limit_kd
        joints.rest_q = model.joint_rest_q
        joints.mimic_coefficients = model.joint_mimic_coeffs
        if model.custom_frequency_counts.get("mujoco:equality_constraint", 0):
            joints.polynomials = model.mujoco.equality_constraint_polycoef
        joints.damping = model.joint_damping
        joints.stiffness = model.joint_stiffness
        joints.armature = model.joint_armature
        joints.friction = model.joint_friction
        joints.effort_limit = model.joint_effort_limit
        joints.velocity_limit = model.joint_velocity_limit
        for name, values in dahl_friction(model).items():
            setattr(joints, name, values)
    return joints


def shape_model(model: newton.Model) -> Any:
    """Shapes and their materials."""
    shapes = data.ShapeModel()
    shapes.body = model.shape_body
    if hasattr(model, "shape_frame"):
        shapes.frame = model.shape_frame
    shapes.type = model.shape_type
    shapes.pose = model.shape_transform
    shapes.scale = model.shape_scale
    shapes.mu = model.shape_material_mu
    shapes.mu_torsional = model.shape_material_mu_torsional
    shapes.mu_rolling = model.shape_material_mu_rolling
    shapes.restitution = model.shape_material_restitution
    shapes.ke = model.shape_material_ke
    shapes.kd = model.shape_material_kd
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
    source.count = contacts.rigid_contact_count
    source.shape0 = contacts.rigid_contact_shape0
    source.shape1 = contacts.rigid_contact_shape1
    source.point0 = contacts.rigid_contact_point0
    source.point1 = contacts.rigid_contact_point1
    source.normal = contacts.rigid_contact_normal
    source.margin0 = contacts.rigid_contact_margin0
    source.margin1 = contacts.rigid_contact_margin1
    source.generation = contacts.contact_generation
    if surfaces is not None:
        source.surface_velocity = surfaces
    if contacts.rigid_contact_friction is not None:
        source.stiffness = contacts.rigid_contact_stiffness
        source.damping = contacts.rigid_contact_damping
        source.friction = contacts.rigid_contact_friction
    if contacts.rigid_contact_match_index is not None:
        source.match_index = contacts.rigid_contact_match_index
        source.match_generation = contacts.rigid_contact_match_generation
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
