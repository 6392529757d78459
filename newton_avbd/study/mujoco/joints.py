# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Scenes with joints in MuJoCo's own terms, as Newton's SolverMuJoCo translates them."""

from typing import Any

import newton
import numpy as np

from newton_avbd.measure.state import Array


class Articulated:
    """A Newton world as an ``mjModel``: joints, drives, limits and contacts."""

    def __init__(self, model: newton.Model):
        """Translate the first world of ``model``; its other worlds are taken to be like it."""
        import mujoco

        self._mujoco = mujoco
        worlds = max(1, model.world_count)
        solver = newton.solvers.SolverMuJoCo(
            model,
            use_mujoco_cpu=True,
            separate_worlds=worlds > 1,
            # Constraints that Newton keeps ready for a change at run time, which is not to come.
            kinematic_switchable_roots=False,
        )
        self.mj_model = solver.mj_model
        # A step of next to no time writes the start state and the targets of the drives down.
        solver.step(model.state(), model.state(), model.control(), None, 1e-12)
        self._qpos, self._qvel = solver.mj_data.qpos.copy(), solver.mj_data.qvel.copy()
        self._ctrl = solver.mj_data.ctrl.copy()
        bodies = solver.mjc_body_to_newton.numpy()[0]
        self._mj_bodies = np.flatnonzero(bodies >= 0)
        self._rows = bodies[self._mj_bodies]
        self._body_count = model.body_count // worlds

    def start(self, data: Any, world: int) -> None:
        """Put ``data`` into the start state, the same in every ``world``."""
        del world
        data.qpos[:], data.qvel[:], data.ctrl[:] = self._qpos, self._qvel, self._ctrl

    def read(self, data: Any) -> tuple[Array, Array]:
        """Body poses and velocities in Newton's terms, shapes [bodies, 7] and [bodies, 6]."""
        mujoco = self._mujoco
        mujoco.mj_fwdPosition(self.mj_model, data)
        mujoco.mj_fwdVelocity(self.mj_model, data)
        body_q, body_qd = np.zeros((self._body_count, 7)), np.zeros((self._body_count, 6))
        twist = np.zeros(6)
        for mj_body, row in zip(self._mj_bodies, self._rows, strict=True):
            body_q[row, :3] = data.xpos[mj_body]
            body_q[row, 3:] = data.xquat[mj_body][[1, 2, 3, 0]]
            # At the center of mass, along the axes of the world; MuJoCo puts rotation first.
            kind = mujoco.mjtObj.mjOBJ_BODY
            mujoco.mj_objectVelocity(self.mj_model, data, kind, mj_body, twist, 0)
            body_qd[row] = twist[[3, 4, 5, 0, 1, 2]]
        return body_q, body_qd
