# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What actuators bring to joints through tendons and through the bodies that they push."""

from typing import Any

import newton
import numpy as np
import warp as wp

from ..drivers.launch import Launcher
from ..step import actuator_force as exports
from ..step import tendon_coasting as kernels
from . import views


def by_world(model: newton.Model, worlds: Any, items: Any = None) -> tuple[wp.array, wp.array]:
    """Items by the world of each, those of no world last; of some only if ``items`` says which."""
    count = model.world_count + 1
    of: list[list[int]] = [[] for _ in range(count)]
    for item, world in enumerate(worlds.numpy().tolist()):
        if items is None or item in items:
            of[world if world >= 0 else count - 1].append(item)
    return views.lists(of)


def joints_of_trees(model: newton.Model) -> tuple[wp.array, wp.array]:
    """Joints of trees by world: of several joints of a link the first one."""
    _, trees = np.unique(model.joint_child.numpy(), return_index=True)
    return by_world(model, model.joint_world, set(trees.tolist()))


class Coasting:
    """How tendons bend while joints keep their rates (:mod:`.step.tendon_coasting`).

    Args:
        model: The user's model.
        tendons: Its tendons, a :class:`.data.TendonModel`.
    """

    def __init__(self, model: newton.Model, tendons: Any) -> None:
        self._model, self._tendons = model, tendons
        self._joints = views.joint_model(model)
        self._tree = joints_of_trees(model)
        self._links = wp.zeros(model.body_count, dtype=wp.spatial_vector)

    @staticmethod
    def needs_coordinates(model: newton.Model) -> bool:
        """Whether joints have axes that turn each other."""
        is_ball = model.joint_type.numpy() == int(newton.JointType.BALL)
        is_free = model.joint_type.numpy() == int(newton.JointType.FREE)
        return bool(np.any((model.joint_dof_dim.numpy()[:, 1] > 1) & ~is_ball & ~is_free))

    def measure(self, launch: Launcher, state: Any, joint_q: wp.array, joint_qd: wp.array) -> None:
        """Measures it in a state."""
        model, motion = self._model, [state.body_q, state.body_qd]
        given = [self._joints, model.body_com, *self._tree, *motion, joint_q, joint_qd]
        launch(kernels.coast_links, model.world_count + 1, [*given, self._links])
        given = [model.body_com, *motion, self._links, self._tendons]
        launch(kernels.measure_coasting, self._tendons.row.size, given)


class Transmission:
    """Generalized forces of the actuators that pull tendons and push bodies.

    Args:
        model: The user's model.
        actuation: What the actuators act by, an :class:`.actuation.Actuation`.
    """

    def __init__(self, model: newton.Model, actuation: Any) -> None:
        self._model, self._actuation = model, actuation
        self._joints = views.joint_model(model)
        self._world_count = model.world_count + 1
        with wp.ScopedDevice(model.device):
            self._links = by_world(model, model.body_world)
            self._tree = joints_of_trees(model)
            no_worlds = wp.empty(0, dtype=wp.int32)
            pulls = bool(actuation.tendons.rows)
            self._tendons = by_world(model, actuation.tendons.world if pulls else no_worlds)
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
