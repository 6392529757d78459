# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""MuJoCo's own ``mj_step`` on a scene, without Newton around it."""

import time
from typing import Any

import newton
import numpy as np

from newton_avbd.measure.state import Array
from newton_avbd.model.rotations import conjugate, rotate
from newton_avbd.scenes.named import Scene
from newton_avbd.study.contestants import FRAMES_IN_ONE_GO, GRAPH_STEPS, Contestant
from newton_avbd.study.mujoco.joints import Articulated


def silence() -> None:
    """Keep MuJoCo from writing its warnings into a file in the current folder.

    What it warns of are runs that blow up, which the quality shows.
    """
    try:
        import mujoco
    except ImportError:
        return
    mujoco.set_mju_user_warning(lambda message: None)


class MujocoContestant(Contestant):
    """``mj_step`` on a scene.

    Each Newton world is an ``mjData`` of the same ``mjModel``, stepped one after the other. Free
    bodies go with MuJoCo's default options, joints with what ``SolverMuJoCo`` makes of them.

    Attributes:
        mj_model: The ``mjModel``, whose options may be changed before :meth:`restart`.
    """

    def __init__(self, scene: Scene):
        """Write ``scene`` down for MuJoCo.

        Raises:
            ImportError: MuJoCo is not installed.
        """
        import mujoco

        super().__init__(scene, scene.model(device="cpu"))
        self._mujoco = mujoco
        free = np.all(self.model.joint_type.numpy() == newton.JointType.FREE)
        self._translation = (_FreeBodies if free else Articulated)(self.model)
        self.mj_model = self._translation.mj_model
        self.mj_model.opt.timestep = scene.dt
        self.restart()

    def restart(self) -> None:
        """Go back to the start."""
        worlds = max(1, self.model.world_count)
        self._data = [self._mujoco.MjData(self.mj_model) for _ in range(worlds)]
        for world, data in enumerate(self._data):
            self._translation.start(data, world)

    def push(self, wrench: Array) -> None:
        """Set the force [N] and torque [N m] on the first body of each world."""
        for data in self._data:
            data.xfrc_applied[1] = wrench

    def advance(self, steps: int = 1) -> float:
        """Make steps, more than one at once only where nothing can collide; see the base class."""
        begin = time.process_time()
        for data in self._data:
            self._mujoco.mj_step(self.mj_model, data, steps)
        elapsed = time.process_time() - begin
        begin = time.process_time()
        for data in self._data:
            self._mujoco.mj_collision(self.mj_model, data)
        return elapsed - (time.process_time() - begin)

    def replay(self, *, collide: bool = False) -> float:
        # There is nothing around mj_step to take away, nor collisions to find where there are none.
        steps = FRAMES_IN_ONE_GO * GRAPH_STEPS if self.is_uninterrupted or collide else 1
        if not collide:
            return self.advance(steps) / steps
        begin = time.process_time()
        for data in self._data:
            self._mujoco.mj_step(self.mj_model, data, steps)
        return (time.process_time() - begin) / steps

    def observe(self) -> newton.State:
        found = [self._translation.read(data) for data in self._data]
        body_q, body_qd = (np.vstack(part) for part in zip(*found, strict=True))
        self.state.body_q.assign(body_q.astype(np.float32))
        self.state.body_qd.assign(body_qd.astype(np.float32))
        return self.state


class _FreeBodies:
    """A Newton world of free bodies as an ``mjModel``."""

    def __init__(self, model: newton.Model):
        """Translate the first world of ``model``."""
        self._count = model.body_count // max(1, model.world_count)
        self.mj_model = _translate(model, self._count).compile()
        self._body_q = model.body_q.numpy().astype(float)
        self._body_qd = model.body_qd.numpy().astype(float)

    def start(self, data: Any, world: int) -> None:
        """Put ``data`` into the start state of ``world``."""
        bodies = slice(world * self._count, (world + 1) * self._count)
        _set_state(data, self._body_q[bodies], self._body_qd[bodies])

    def read(self, data: Any) -> tuple[Array, Array]:
        """Body poses and velocities in Newton's terms, shapes [bodies, 7] and [bodies, 6]."""
        qpos, qvel = data.qpos.reshape(-1, 7), data.qvel.reshape(-1, 6)
        body_q = qpos[:, [0, 1, 2, 4, 5, 6, 3]]
        return body_q, np.hstack([qvel[:, :3], rotate(body_q[:, 3:], qvel[:, 3:])])


def _set_state(data: Any, body_q: Array, body_qd: Array) -> None:
    """Write body states, shapes [n, 7] and [n, 6], into ``mjData`` of n free joints.

    MuJoCo puts the real part of a quaternion first and turns in the frame of the body.
    """
    spin = rotate(conjugate(body_q[:, 3:]), body_qd[:, 3:])
    data.qpos[:] = body_q[:, [0, 1, 2, 6, 3, 4, 5]].ravel()
    data.qvel[:] = np.hstack([body_qd[:, :3], spin]).ravel()


def _translate(model: newton.Model, bodies: int) -> Any:
    """Describe the first ``bodies`` bodies of ``model`` and its fixed shapes as an ``MjSpec``."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.gravity = model.gravity.numpy().reshape(-1, 3)[0]
    mass, com = model.body_mass.numpy(), model.body_com.numpy()
    inertia = model.body_inertia.numpy()
    made = {}
    for i in range(bodies):
        body = spec.worldbody.add_body()
        body.add_freejoint()
        body.explicitinertial = True
        body.mass, body.ipos = mass[i], com[i]
        body.fullinertia = inertia[i][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        made[i] = body
    made[-1] = spec.worldbody
    shape_body, shape_world = model.shape_body.numpy(), model.shape_world.numpy()
    for shape in range(model.shape_count):
        if shape_world[shape] <= 0 and shape_body[shape] in made:
            _add_geom(made[shape_body[shape]], model, shape)
    return spec


def _add_geom(body: Any, model: newton.Model, shape: int) -> None:
    """Add a shape of ``model`` to a body of an ``MjSpec``."""
    import mujoco

    kinds = {
        newton.GeoType.PLANE: mujoco.mjtGeom.mjGEOM_PLANE,
        newton.GeoType.SPHERE: mujoco.mjtGeom.mjGEOM_SPHERE,
        newton.GeoType.CAPSULE: mujoco.mjtGeom.mjGEOM_CAPSULE,
        newton.GeoType.CYLINDER: mujoco.mjtGeom.mjGEOM_CYLINDER,
        newton.GeoType.BOX: mujoco.mjtGeom.mjGEOM_BOX,
    }
    kind = newton.GeoType(int(model.shape_type.numpy()[shape]))
    pose = model.shape_transform.numpy()[shape]
    collides = model.shape_flags.numpy()[shape] & int(newton.ShapeFlags.COLLIDE_SHAPES)
    geom = body.add_geom()
    geom.type = kinds[kind]
    # Planes: an infinite one, with a spacing of the grid lines, which only a viewer uses.
    plane = kind == newton.GeoType.PLANE
    geom.size = [0.0, 0.0, 1.0] if plane else model.shape_scale.numpy()[shape]
    geom.pos, geom.quat = pose[:3], pose[[6, 3, 4, 5]]
    geom.friction[0] = model.shape_material_mu.numpy()[shape]
    if not collides:
        geom.contype = geom.conaffinity = 0
