# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What actuators bring to joints through tendons and through the bodies that they push."""

from typing import Any

import newton
import numpy as np
import warp as wp

from ..drivers.launch import Launcher
from ..step import actuator_force as exports
from . import views


class Transmission:
    """Generalized forces of the actuators that pull tendons and push bodies.

    Args:
        model: The user's model.
        actuation: What the actuators act by, an :class:`.actuation.Actuation`.
    """

    def __init__(self, model: newton.Model, actuation: Any) -> None:
        self._model, self._actuation = model, actuation
        self._joints = views.joint_model(model)
        self._world_count = count = model.world_count + 1

        def by_world(worlds: Any, items: Any = None) -> tuple[wp.array, wp.array]:
            """Items by world, those of no world last."""
            of: list[list[int]] = [[] for _ in range(count)]
            for item, world in enumerate(worlds.numpy().tolist()):
                if items is None or item in items:
                    of[world if world >= 0 else count - 1].append(item)
            return views.lists(of)

        with wp.ScopedDevice(model.device):
            self._links = by_world(model.body_world)
            # of several joints of a link the first is that of its tree
            _, trees = np.unique(model.joint_child.numpy(), return_index=True)
            self._tree = by_world(model.joint_world, set(trees.tolist()))
            no_worlds = wp.empty(0, dtype=wp.int32)
            pulls = bool(actuation.tendons.rows)
            self._tendons = by_world(actuation.tendons.world if pulls else no_worlds)
            self._load = wp.zeros(model.body_count, dtype=wp.spatial_vector)

    def add(self, launch: Launcher, body_q: wp.array, joint_q: wp.array, force: wp.array) -> None:
        """Adds them to ``force``, shape (joint_dof_count,) [N or N m].

        Args:
            launch: Launches kernels.
            body_q: Poses of the links.
            joint_q: Joint coordinates there.
            force: Where to.
        """
        actuation = self._actuation
        launch(
            exports.export_transmitted_force,
            self._world_count,
            [
                *(self._joints, self._model.body_com, actuation.tendons),
                *(*self._tendons, *self._links, *self._tree),
                *(actuation.bodies, actuation.link_start, actuation.items),
                *(actuation.beside_tendons, body_q, joint_q, self._load, force),
            ],
        )
