# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joint coordinates as part of the state, as for solvers in reduced coordinates."""

from collections.abc import Iterator
from typing import Any

import newton
import warp as wp

from .. import data
from ..drivers.launch import Launcher
from ..step.joint_state import StateArrays, find_written, keep_left, reset_joints
from ..step.observables import count_turns
from . import views

_ARRAYS = ("joint_q", "joint_qd", "body_q", "body_qd")


class JointState:
    """Reads what a user wrote to the joint coordinates of a state, and writes them after a step.

    Which of the two a user wrote, joint coordinates or poses of bodies, is found out on the device
    by what the last step left: no synchronisation, two launches a step more and Newton's
    ``eval_fk``.
    """

    def __init__(self, model: newton.Model) -> None:
        """Makes the arrays; nothing is left yet, so that a first step starts at ``joint_q``."""
        self._model = model
        self._all_joints = views.AllJoints(model)
        self._left: Any = StateArrays()
        with wp.ScopedDevice(model.device):
            for name in _ARRAYS:
                setattr(self._left, name, wp.empty_like(getattr(model, name)))
            for name in ("joint_q", "joint_qd"):
                getattr(self._left, name).fill_(float("nan"))
            self._is_written = wp.zeros(model.articulation_count, dtype=wp.bool)
        self._joints = views.joint_model(model)

    def read(self, launch: Launcher, state: newton.State, history: data.History) -> None:
        """Puts the bodies of articulations of which only the joints were written where they say."""
        model = self._model
        if not model.articulation_count:
            return
        launch(
            find_written,
            model.articulation_count,
            [
                self._joints,
                model.articulation_start,
                model.articulation_end,
                model.body_q,
                model.body_qd,
                *(getattr(state, name) for name in _ARRAYS),
                self._left,
                history,
                self._is_written,
            ],
        )
        newton.eval_fk(model, state.joint_q, state.joint_qd, state, mask=self._is_written)

    def write(
        self,
        launch: Launcher,
        state: newton.State,
        joints: data.JointModel,
        count: int,
        history: data.History,
    ) -> None:
        """Writes coordinates by the poses of bodies, turns counted.

        Args:
            launch: Launches kernels.
            state: State of which to write ``joint_q`` and ``joint_qd``.
            joints: The joints that the solver knows.
            count: Their number.
            history: Has the turns of their angles.
        """
        self._all_joints.measure(launch, state, state.joint_q, state.joint_qd)
        launch(count_turns, count, [joints, history, state.joint_q, state.joint_qd])
        most = max(self._model.joint_coord_count, self._model.body_count)
        launch(keep_left, most, [*(getattr(state, name) for name in _ARRAYS), self._left])

    def reset(self, launch: Launcher, state: newton.State, mask: wp.array, flags: int) -> None:
        """Puts joint coordinates of the masked worlds back to the model's, as ``flags`` say."""
        model = self._model
        launch(
            reset_joints,
            model.joint_count,
            [
                self._joints,
                model.joint_world,
                model.joint_q,
                model.joint_qd,
                mask,
                flags,
                state.joint_q,
                state.joint_qd,
                self._left,
            ],
        )

    def remembered(self) -> Iterator[tuple[str, wp.array]]:
        """Arrays that a step leaves to the next one, by name."""
        for name in _ARRAYS:
            yield f"joint_state.{name}", getattr(self._left, name)
