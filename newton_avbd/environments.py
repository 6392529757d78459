# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Robots that learn to walk: environments of gymnasium over a batch of worlds.

Robots, rewards and ends of episodes are those of gymnasium's tasks with MuJoCo of the same names,
``Ant-v5`` without the cost of contact forces. A world observes its torso's height, its other
coordinates, the torso's velocity and the other joint velocities. For the hopper these are the
numbers of ``Hopper-v5``, so that a policy of one goes with the other; the ant's differ from
``Ant-v5`` in the order of the quaternion, and leave out contact forces.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import newton
import numpy as np
import warp as wp
from numpy.typing import NDArray

from .io.assets import read_driven
from .solver import SolverAVBD

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as error:
    raise ImportError(
        "newton_avbd.environments needs gymnasium: pip install 'newton-avbd[learning]'"
    ) from error

Array = NDArray[np.float32]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Task:
    """What a robot is to do: run along x without falling.

    Attributes:
        file: Of gymnasium's robots.
        duration: Time that a control lasts [s].
        steps: Solver steps in that time, an even number.
        axes: In which the torso moves; its first joint coordinates are along these.
        height: Least and largest height of the torso's center [m].
        pitch: Joint coordinate that tells how far the torso leans [rad], and the most of it; None
            for a robot that may lean.
        effort: What a control costs, times its square.
        noise: Largest random displacement of the joint coordinates at a start [m, rad].
        speed_noise: Standard deviation of the joint velocities at a start [m/s, rad/s].
    """

    file: str
    duration: float
    steps: int
    axes: tuple[int, ...]
    height: tuple[float, float]
    pitch: tuple[int, float] | None
    effort: float
    noise: float
    speed_noise: float


TASKS: Mapping[str, Task] = {
    "ant": Task("ant.xml", 0.05, 10, (0, 1, 2), (0.2, 1.0), None, 0.5, 0.1, 0.1),
    "hopper": Task("hopper.xml", 0.008, 2, (0, 2), (0.7, np.inf), (2, 0.2), 1.0e-3, 5.0e-3, 5.0e-3),
}
"""The tasks by the name of the robot."""

ALIVE = 1.0
"""Reward of a control after which the robot has not fallen."""

FASTEST = 10.0
"""Joint velocities are observed up to this [m/s, rad/s]."""


class RobotVectorEnv(VectorEnv[Array, Array, Any]):
    """A robot in each world of a batch, moved by SolverAVBD.

    A step advances all worlds by one launch of a captured graph. A masked reset on the
    device restarts worlds whose episode ends, and the others go on undisturbed.

    Example:
        With a random policy::

            envs = RobotVectorEnv("hopper", num_envs=64)
            observations, infos = envs.reset(seed=0)
            for _ in range(1000):
                actions = envs.action_space.sample()
                observations, rewards, terminations, truncations, infos = envs.step(actions)

    Attributes:
        model: The model, with a world for each environment.
        solver: Its solver.
        task: What the robot is to do.
        state: The present state of all worlds. A control changes it in place.
    """

    single_action_space: gymnasium.spaces.Box

    def __init__(
        self,
        robot: Literal["ant", "hopper"],
        num_envs: int,
        *,
        max_episode_steps: int = 1000,
        autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
        device: str | None = None,
        workers: int | None = None,
    ) -> None:
        """Make the worlds.

        Args:
            robot: One of :data:`TASKS`.
            num_envs: Number of worlds.
            max_episode_steps: Controls after which an episode is truncated.
            autoreset_mode: ``SAME_STEP`` puts a world back in the step in which its episode ends,
                with its last observation in ``infos["final_obs"]``. ``DISABLED`` leaves that to
                ``reset(options={"reset_mask": mask})``.
            device: Warp device; None for the current one.
            workers: Threads on a CPU; None for all cores.

        Raises:
            ValueError: There is no such robot, or the mode is neither of these.
        """
        if robot not in TASKS:
            raise ValueError(f"there is no robot {robot!r}; there are: {', '.join(TASKS)}")
        if autoreset_mode not in (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED):
            raise ValueError(f"autoreset_mode is {autoreset_mode}, not SAME_STEP or DISABLED")
        self.task = task = TASKS[robot]
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": autoreset_mode}
        self._autoreset = autoreset_mode == AutoresetMode.SAME_STEP
        self._most_steps = max_episode_steps
        folder = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
        single, _ = read_driven(folder / task.file, light_links=False)
        scene = newton.ModelBuilder()
        scene.replicate(single, num_envs)
        self.model = model = scene.finalize(device=device)
        self._pipeline = newton.CollisionPipeline(model)
        self._contacts = self._pipeline.contacts()
        self.solver = SolverAVBD(model, update_joint_state=True, workers=workers)
        self.state, self._next = model.state(), model.state()
        self._control = model.control()
        self._rest = self._first_pose(single)
        low, high = model.mujoco.actuator_ctrlrange.numpy().reshape(num_envs, -1, 2)[0].T
        size = 1 + single.joint_coord_count - len(task.axes) + single.joint_dof_count
        self.single_action_space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        self._graph: wp.Graph | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: Of the random starts; None goes on with the present generator.
            options: ``{"reset_mask": mask}`` starts those of a mask, shape (num_envs,), bool;
                without it all start.

        Returns:
            Observations of all worlds [m, rad, m/s, rad/s], shape (num_envs, size), float32, and no
            information.
        """
        super().reset(seed=seed)
        chosen = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, bool)))
        self._start(chosen)
        return self._observe(), {}

    def step(self, actions: Array) -> tuple[Array, NDArray[Any], Flags, Flags, dict[str, Any]]:
        """Advance all worlds by one control.

        Args:
            actions: Controls of the actuators, shape (num_envs, actuators), in the units of the
                file; beyond their ranges they are cut off.

        Returns:
            Observations, shape (num_envs, size), float32; rewards, float64; which episodes ended by
            a fall, and which by their length, both bool, shape (num_envs,); and infos. Where
            ``SAME_STEP`` put worlds back, these hold ``final_obs``, the observations of all worlds
            before that, and ``_final_obs``, which of them ended.
        """
        task = self.task
        space = self.single_action_space
        controls = np.clip(np.asarray(actions, dtype=np.float32), space.low, space.high)
        before = self._torso()[:, 0].copy()
        self._control.mujoco.ctrl.assign(controls.ravel())
        self._advance()
        self._elapsed += 1
        torso = self._torso()
        observations = self._observe()
        stands = (torso[:, 2] > task.height[0]) & (torso[:, 2] < task.height[1])
        if task.pitch is not None:
            coordinate, most = task.pitch
            stands &= np.abs(self._coordinates()[:, coordinate]) < most
        stands &= np.isfinite(observations).all(axis=1)
        speed = (torso[:, 0] - before) / task.duration
        rewards = ALIVE * stands + speed - task.effort * np.square(controls).sum(axis=1)
        terminations = ~stands
        truncations = ~terminations & (self._elapsed >= self._most_steps)
        infos: dict[str, Any] = {}
        ended = terminations | truncations
        if self._autoreset and ended.any():
            infos = {"final_obs": observations, "_final_obs": ended}
            self._start(ended)
            observations = self._observe()
        return observations, np.asarray(rewards, dtype=np.float64), terminations, truncations, infos

    def _first_pose(self, single: newton.ModelBuilder) -> Array:
        """Joint coordinates of one robot before noise: of its file, within the limits."""
        q = np.array(single.joint_q, dtype=np.float32)
        for joint, kind in enumerate(single.joint_type):
            if kind == newton.JointType.REVOLUTE:
                axis = single.joint_qd_start[joint]
                low, high = single.joint_limit_lower[axis], single.joint_limit_upper[axis]
                coordinate = single.joint_q_start[joint]
                q[coordinate] = np.clip(q[coordinate], low, high)
        return q

    def _advance(self) -> None:
        """Advance by a control, from and to the same state; from the second time by a graph."""
        if self._graph is not None:
            wp.capture_launch(self._graph)
            return
        self._steps()
        with wp.ScopedCapture(device=self.model.device) as capture:
            self._steps()
        self._graph = capture.graph

    def _steps(self) -> None:
        dt = self.task.duration / self.task.steps
        for _ in range(self.task.steps):
            self._pipeline.collide(self.state, self._contacts)
            self.solver.step(self.state, self._next, self._control, self._contacts, dt)
            self.state, self._next = self._next, self.state

    def _start(self, chosen: Flags) -> None:
        """Start new episodes of the worlds of a mask, at random near the first pose."""
        random, count = self.np_random, int(chosen.sum())
        q = np.tile(self._rest, (count, 1))
        q += random.uniform(-self.task.noise, self.task.noise, q.shape)
        if self.model.joint_type.numpy()[0] == newton.JointType.FREE:
            q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
        velocities = self.task.speed_noise * random.standard_normal((count, self._rates().shape[1]))
        for array, values in ((self.state.joint_q, q), (self.state.joint_qd, velocities)):
            everything = array.numpy().reshape(self.num_envs, -1).copy()
            everything[chosen] = values
            array.assign(everything.ravel())
        mask = wp.array(np.append(chosen, False), dtype=wp.bool, device=self.model.device)
        newton.eval_fk(
            self.model, self.state.joint_q, self.state.joint_qd, self.state, mask[: self.num_envs]
        )
        self.solver.reset(self.state, mask, flags=0)
        self._elapsed[chosen] = 0

    def _coordinates(self) -> Array:
        return self.state.joint_q.numpy().reshape(self.num_envs, -1)

    def _rates(self) -> Array:
        return self.state.joint_qd.numpy().reshape(self.num_envs, -1)

    def _torso(self) -> Array:
        """Positions of the robots' first bodies [m]."""
        return self.state.body_q.numpy().reshape(self.num_envs, -1, 7)[:, 0, :3]

    def _observe(self) -> Array:
        axes = self.task.axes
        # Not by joint coordinates: Newton counts the hopper's at a point at its foot.
        velocity = self.state.body_qd.numpy().reshape(self.num_envs, -1, 6)[:, 0, axes]
        rates = np.hstack([velocity, self._rates()[:, len(axes) :]])
        posture = self._coordinates()[:, len(axes) :]
        return np.hstack([self._torso()[:, 2:], posture, np.clip(rates, -FASTEST, FASTEST)])
