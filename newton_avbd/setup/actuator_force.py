# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What actuators push joints with, ``qfrc_actuator``, for those who ask for it."""

from typing import Any

import newton
import numpy as np
import warp as wp

from .. import data
from ..drivers.launch import Launcher
from ..effects import Effects
from ..model.actuators import compensating_axes
from ..step import actuation as kernels
from ..step import actuator_force as exports
from ..step.body_actuators import end_servos
from ..step.observables import count_turns
from . import views
from .actuation import Actuation, compensate_axes
from .transmission import Transmission


class ActuatorForce:
    """The generalized forces of drives and MuJoCo's actuators at the end of a step.

    Args:
        model: The user's model.
        actuation: What MuJoCo's actuators act by; None without any.
        effects: The scene's effects.
        target_mode: Modes of the drives that are no actuators.
        turns: Angles with their turns, as :attr:`.data.History.joint_angle`; None without angles.
    """

    def __init__(
        self,
        model: newton.Model,
        actuation: Actuation | None,
        effects: Effects,
        target_mode: wp.array,
        turns: wp.array | None,
    ) -> None:
        self._model, self._actuation = model, actuation
        self._joints = views.joint_model(model)
        self._joints.target_mode = target_mode
        self._has_drives, self._has_limits = effects.drives, effects.effort_limits
        self._all_joints = views.AllJoints(model)
        with wp.ScopedDevice(model.device):
            self._joint_q = wp.zeros(model.joint_coord_count, dtype=float)
            self._joint_qd = wp.zeros(model.joint_dof_count, dtype=float)
            self._turns = data.History()
            self._counts = turns is not None
            if turns is not None:
                self._turns.joint_angle = wp.clone(turns)
            self._no_beside = wp.empty(0, dtype=wp.vec2)
            self._make_compensation(effects)
            pulls = actuation is not None and bool(actuation.tendons.rows)
            pushes = actuation is not None and actuation.bodies.row is not None
            self._pulls = pulls
            self._transmission = Transmission(model, actuation) if pulls or pushes else None

    def _make_compensation(self, effects: Effects) -> None:
        """Axes that compensate gravity, and have no limit by which the step knows them."""
        carried: dict[int, list[int]] = {}
        if effects.gravity_compensation:
            known = () if self._actuation is None else self._actuation.compensates
            found = compensating_axes(self._model, limited_only=False)
            carried = {dof: links for dof, links in found.items() if dof not in known}
        self._dofs = None
        if carried:
            dofs = np.array(sorted(carried))
            joint = np.searchsorted(self._model.joint_qd_start.numpy(), dofs, side="right") - 1
            self._dofs = views.indices(dofs)
            coordinate = views.indices(views.coordinates_of(self._model, dofs))
            links = views.lists([carried[dof] for dof in dofs.tolist()])
            self._carried = (views.indices(joint), coordinate, *links)
            self._compensation = wp.zeros(dofs.size, dtype=float)

    def export(
        self,
        launch: Launcher,
        state: newton.State,
        coordinates: tuple[wp.array, wp.array] | None,
        control: data.ControlInput,
        joints: Any,
        joint_count: int,
        history: data.History,
        force: wp.array,
    ) -> None:
        """Writes the forces of the step that led to a state.

        Args:
            launch: Launches kernels.
            state: State after the step.
            coordinates: Its joint coordinates and velocities; None where they are to be found.
            control: What drove the joints.
            joints: The joints that the solver knows.
            joint_count: Their number.
            history: Has the turns of their angles.
            force: Where to, shape (joint_dof_count,) [N or N m].
        """
        model, actuation = self._model, self._actuation
        if coordinates is None:
            coordinates = (self._joint_q, self._joint_qd)
            self._all_joints.measure(launch, state, *coordinates)
            if self._counts:
                wp.copy(self._turns.joint_angle, history.joint_angle)
                launch(count_turns, joint_count, [joints, self._turns, *coordinates])
        beside = self._no_beside if actuation is None else actuation.beside
        switches = [self._has_drives, self._has_limits]
        motion = [state.body_q, *coordinates]
        launch(
            exports.export_axis_force,
            model.joint_count,
            [self._joints, *switches, control, beside, *motion, force],
        )
        if self._dofs is not None:
            found = [self._dofs, *self._carried, self._compensation]
            compensate_axes(launch, model, state, coordinates[0], found)
            launch(
                exports.add_compensation, self._dofs.size, [self._dofs, self._compensation, force]
            )
        if self._transmission is not None:
            assert actuation is not None
            if self._pulls:
                moved = [model.body_com, state.body_q, state.body_qd, *coordinates]
                count = actuation.tendons.row.size
                launch(kernels.measure_tendons, count, [*moved, actuation.tendons])
            if actuation.servos.start is not None:
                ended = [model.body_com, state.body_q, state.body_qd, actuation.bodies]
                launch(end_servos, actuation.bodies.row.size, ended)
            self._transmission.add(launch, state.body_q, coordinates[0], force)
