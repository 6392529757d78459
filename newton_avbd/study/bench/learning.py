# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Tasks of dm_control and gymnasium with SolverAVBD in the place of MuJoCo's ``mj_step``.

The task stays what it is: it resets, observes, rewards and ends an episode by its ``mjData``. Only
what moves that data by a control is exchanged: SolverAVBD starts from the joint coordinates that
the task has written, steps with the task's time step and controls, and writes them back.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.flags import heed_flags
from newton_avbd.io.assets import read_driven
from newton_avbd.io.errors import UserError
from newton_avbd.measure.state import Array
from newton_avbd.model.rotations import conjugate, rotate

GYMNASIUM = (
    "InvertedPendulum-v5",
    "InvertedDoublePendulum-v5",
    "Reacher-v5",
    "Pusher-v5",
    "Swimmer-v5",
    "Hopper-v5",
    "Walker2d-v5",
    "HalfCheetah-v5",
    "Ant-v5",
    "Humanoid-v5",
    "HumanoidStandup-v5",
)
"""Its tasks with MuJoCo."""

DM_CONTROL = (
    "acrobot-swingup",
    "ball_in_cup-catch",
    "cartpole-balance",
    "cartpole-swingup",
    "cheetah-run",
    "finger-spin",
    "fish-swim",
    "hopper-hop",
    "humanoid-stand",
    "pendulum-swingup",
    "point_mass-easy",
    "quadruped-walk",
    "reacher-easy",
    "swimmer-swimmer6",
    "walker-walk",
)
"""Tasks of its suite, of each domain one that every policy can do something in."""

TASKS = (*(f"gymnasium/{name}" for name in GYMNASIUM), *(f"dm_control/{n}" for n in DM_CONTROL))
"""Names of the tasks."""

NEAR = 0.01
"""By how much a body may be elsewhere than in MuJoCo at random coordinates [m]: Newton's importer
gives joints of one body, as of an ankle, one anchor, which is up to 4 mm."""


@dataclass(frozen=True)
class Outcome:
    """What the episodes of a task came to with one engine.

    Attributes:
        returns: Sum of the rewards of each episode, shape (episodes,).
        lengths: Controls of each episode, shape (episodes,).
        rate: Steps of the engine a second, collision detection included.
        lost: Episodes in which a coordinate was not finite.
    """

    returns: Array
    lengths: Array
    rate: float
    lost: int


class Task:
    """A task of either package, reset and stepped alike.

    Attributes:
        name: Its name.
        model: Its ``mjModel``.
        data: Its ``mjData``.
        actions: Number of its actions.
    """

    def __init__(self, name: str) -> None:
        """Make the task ``name``, one of :data:`TASKS`.

        Raises:
            ModuleNotFoundError: Its package is not installed.
        """
        self.name = name
        package, _, self._task = name.partition("/")
        self._is_gymnasium = package == "gymnasium"
        if self._is_gymnasium:
            import gymnasium

            self._env: Any = gymnasium.make(self._task)
            inner: Any = self._env.unwrapped
            self.model, self.data = inner.model, inner.data
            space: Any = self._env.action_space
            self._low, self._high = space.low, space.high
        else:
            self._start(0)
            spec = self._env.action_spec()
            self._low, self._high = spec.minimum, spec.maximum
        self.actions = int(self._low.size)
        self._advance: Callable[[int], None] | None = None

    def _start(self, seed: int) -> None:
        """Make the task of dm_control, which draws its episodes from a seed of its own."""
        from dm_control import suite

        domain, _, task = self._task.rpartition("-")
        self._env = suite.load(domain, task, task_kwargs={"random": seed})
        physics = self._env.physics
        self.model, self.data = physics.model.ptr, physics.data.ptr

    def file(self, folder: Path) -> Path:
        """The MJCF file of the task, one that it has made written into ``folder``."""
        if self._is_gymnasium:
            return Path(self._env.unwrapped.fullpath)
        from dm_control.mujoco.wrapper import core

        self._start(0)
        path = folder / f"{self._task}.xml"
        core.save_last_parsed_model_to_xml(str(path), self._env.physics.model)
        return path

    def reset(self, seed: int, engine: "Engine | None") -> Array:
        """Start an episode; MuJoCo settles where a task asks for that. Returns its observation."""
        if self._is_gymnasium:
            inner = self._env.unwrapped
            if engine is not None:
                inner.do_simulation = partial(self._simulate, engine)
            observation = self._env.reset(seed=seed)[0]
        else:
            self._start(seed)
            observation = self._env.reset().observation
            if engine is not None:
                self._env.physics.step = partial(engine.advance, self.data)
        if engine is not None:
            engine.start(self.data)
        return _flat(observation)

    def _simulate(self, engine: "Engine", ctrl: Array, steps: int) -> None:
        self.data.ctrl[:] = ctrl
        engine.advance(self.data, steps)

    def step(self, action: Array) -> tuple[Array, float, bool]:
        """Act, from -1 to 1; returns observation, reward and whether the episode ends."""
        scaled = self._low + 0.5 * (action + 1.0) * (self._high - self._low)
        if self._is_gymnasium:
            observation, reward, ends, is_cut, _ = self._env.step(scaled.astype(np.float32))
            return _flat(observation), float(reward), bool(ends or is_cut)
        after = self._env.step(scaled)
        return _flat(after.observation), float(after.reward or 0.0), bool(after.last())


def _flat(observation: Any) -> Array:
    parts = observation.values() if hasattr(observation, "values") else [observation]
    return np.concatenate([np.ravel(part) for part in parts]).astype(float)


class Engine:
    """SolverAVBD, which moves the ``mjData`` of a task."""

    def __init__(self, task: Task, **settings: Any) -> None:
        """Read the task's file, and compile a step; ``settings`` go to the solver.

        Raises:
            UserError: The coordinates of the file are not those of the task.
        """
        import mujoco

        self._mujoco, self._task = mujoco, task
        with TemporaryDirectory() as folder:
            builder, _ = read_driven(task.file(Path(folder)), light_links=False)
        self.model = builder.finalize(device="cpu")
        is_weightless = task.model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        gravity = np.zeros(3) if is_weightless else task.model.opt.gravity
        self.model.set_gravity(tuple(map(float, gravity)))
        self._match(task)
        # bodies may pass through each other, as a cart through its rails
        without = heed_flags(self.model)
        settings["effects"] = {**without, **settings.get("effects", {})}
        self._solver = SolverAVBD(self.model, update_joint_state=True, **settings)
        self._pipeline = newton.CollisionPipeline(self.model)
        self._contacts = None if "contact" in without else self._pipeline.contacts()
        self._state, self._control = self.model.state(), self.model.control()
        self.seconds, self.steps = 0.0, 0
        self._step()
        with wp.ScopedCapture(device="cpu") as capture:
            self._step()
        self._graph = capture.graph

    def _match(self, task: Task) -> None:
        """Find out which coordinate is which: both go depth first, sliders of a body before hinges.

        Raises:
            UserError: At random coordinates bodies are elsewhere than MuJoCo has them.
        """
        mujoco, model, mj = self._mujoco, self.model, task.model
        is_free = mj.jnt_type == mujoco.mjtJoint.mjJNT_FREE
        # a body's velocity is that of its COM in Newton, and that of its origin in MuJoCo
        self._free = [
            (mj.jnt_qposadr[i], mj.jnt_dofadr[i], mj.body_ipos[mj.jnt_bodyid[i]])
            for i in np.flatnonzero(is_free)
        ]
        # where MuJoCo's coordinate of a hinge or slider is ref, Newton's is zero
        self._ref = np.zeros(mj.nq)
        axes = mj.jnt_qposadr[~is_free]
        self._ref[axes] = mj.qpos0[axes]
        alike = (
            (model.joint_coord_count, model.joint_dof_count) == (mj.nq, mj.nv)
            and model.body_count == mj.nbody - 1
            and not (mj.jnt_type == mujoco.mjtJoint.mjJNT_BALL).any()
            and model.custom_frequency_counts.get("mujoco:actuator", 0) == mj.nu
        )
        if alike:
            data, self._state = mujoco.MjData(mj), self.model.state()
            data.qpos[axes] += np.random.default_rng(0).uniform(-0.3, 0.3, axes.size)
            mujoco.mj_kinematics(mj, data)
            self._put(data)
            newton.eval_fk(model, self._state.joint_q, self._state.joint_qd, self._state)
            alike = np.abs(self._state.body_q.numpy()[:, :3] - data.xpos[1:]).max() < NEAR
        if not alike:
            raise UserError(f"{task.name}: Newton's importer has other coordinates than MuJoCo")

    def _step(self) -> None:
        state = self._state
        if self._contacts is not None:
            self._pipeline.collide(state, self._contacts)
        self._solver.step(
            state, state, self._control, self._contacts, float(self._task.model.opt.timestep)
        )

    def start(self, data: Any) -> None:
        """Forget the last episode; the next step starts from the task's coordinates."""
        self._solver.reset(self._state)
        self._put(data)

    def _put(self, data: Any) -> None:
        """Write the task's coordinates and velocities to the state, whose bodies follow."""
        q, qd = data.qpos - self._ref, data.qvel.copy()
        for at, dof, com in self._free:
            turn = data.qpos[at + 3 : at + 7][[1, 2, 3, 0]]
            turn = turn / np.linalg.norm(turn)  # gymnasium starts from four random numbers
            q[at + 3 : at + 7] = turn
            qd[dof + 3 : dof + 6] = rotate(turn, data.qvel[dof + 3 : dof + 6])
            qd[dof : dof + 3] += np.cross(qd[dof + 3 : dof + 6], rotate(turn, com))
        self._state.joint_q.assign(q.astype(np.float32))
        self._state.joint_qd.assign(qd.astype(np.float32))

    def _take(self, data: Any) -> None:
        """Write the state's coordinates, velocities and activations to the task."""
        q, qd = (
            self._state.joint_q.numpy().astype(float),
            self._state.joint_qd.numpy().astype(float),
        )
        data.qpos[:], data.qvel[:] = q + self._ref, qd
        for at, dof, com in self._free:
            turn = q[at + 3 : at + 7]
            spin = qd[dof + 3 : dof + 6]
            data.qpos[at + 3 : at + 7] = turn[[3, 0, 1, 2]]
            data.qvel[dof : dof + 3] = qd[dof : dof + 3] - np.cross(spin, rotate(turn, com))
            data.qvel[dof + 3 : dof + 6] = rotate(conjugate(turn), spin)
        has = np.flatnonzero(self._task.model.actuator_actadr >= 0)
        if has.size:
            activations = self._solver.activations.numpy()
            data.act[self._task.model.actuator_actadr[has]] = activations[has]

    def advance(self, data: Any, steps: int = 1) -> None:
        """Move the task's data on by its controls; its sensors are MuJoCo's of where that ends."""
        if data.ctrl.size:
            self._control.mujoco.ctrl.assign(data.ctrl.astype(np.float32))
        begin = time.process_time()
        for _ in range(steps):
            wp.capture_launch(self._graph)
        self.seconds += time.process_time() - begin
        self.steps += steps
        self._take(data)
        data.time += steps * self._task.model.opt.timestep
        self._mujoco.mj_forward(self._task.model, data)
        self._mujoco.mj_rnePostConstraint(self._task.model, data)


class Clock:
    """Times MuJoCo's steps, and makes them as the task does."""

    def __init__(self, task: Task) -> None:
        """Of a task, whose ``mjModel`` steps, as it has changed it for an episode."""
        import mujoco

        self._mujoco, self._task = mujoco, task
        self.seconds, self.steps = 0.0, 0

    def start(self, data: Any) -> None:
        """Nothing is kept between episodes."""

    def advance(self, data: Any, steps: int = 1) -> None:
        """Make steps."""
        begin = time.process_time()
        self._mujoco.mj_step(self._task.model, data, steps)
        self.seconds += time.process_time() - begin
        self.steps += steps
        self._mujoco.mj_forward(self._task.model, data)
        self._mujoco.mj_rnePostConstraint(self._task.model, data)


def run(task: Task, engine: Any, episodes: int, controls: int) -> Outcome:
    """Run a fixed random policy, tanh(W o) with W drawn once, for some episodes.

    Args:
        task: The task.
        engine: :class:`Engine` or :class:`Clock`.
        episodes: How many, each from a seed of its own.
        controls: Most controls of an episode.

    Returns:
        What they came to.
    """
    returns, lengths, lost = [], [], 0
    for seed in range(episodes):
        observation = task.reset(seed, engine)
        weights = np.random.default_rng(0).normal(size=(task.actions, observation.size))
        total, length = 0.0, 0
        for _ in range(controls):
            observation = np.clip(np.nan_to_num(observation), -10.0, 10.0)
            observation, reward, ends = task.step(np.tanh(0.3 * weights @ observation))
            if not np.isfinite(reward) or not np.isfinite(task.data.qpos).all():
                lost += 1
                break
            total, length = total + reward, length + 1
            if ends:
                break
        returns.append(total)
        lengths.append(length)
    rate = engine.steps / max(engine.seconds, 1.0e-9)
    return Outcome(np.array(returns), np.array(lengths), rate, lost)
