# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Train a hopper with PPO of stable-baselines3, in SolverAVBD or in MuJoCo, and try it in both.

    pip install 'newton-avbd[learning]' stable-baselines3 'gymnasium[mujoco]' 'mujoco~=3.17.0'
    python examples/learning/train.py --engine avbd
    python examples/learning/train.py --engine mujoco

Prints controls a second and the return while it learns, and at the end the mean return of the
policy over ten episodes in each engine. Ctrl-C ends the training, and the policy is tried as it is.
``transfer.py`` tries policies in variants of both engines.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from newton_avbd.environments import RobotVectorEnv
from newton_avbd.io.terminal import start_warp

ENGINES = ("avbd", "mujoco")
CONTROLS = 2048
"""Controls of all environments between two updates of the policy, PPO's default for one."""

DISCOUNT = 0.995
"""Of rewards, by control: it looks 1.6 s ahead. With PPO's default of 0.99, which looks 0.8 s
ahead, two of six hoppers learned to stand or to leap once."""

EPISODES = 10
"""In which a policy is tried at the end."""

SLOWEST = 0.05
"""The learning rate falls in proportion to the controls that are left, down to this share."""


class BatchOfWorlds(VecEnv):
    """Environments of this package as stable-baselines3 calls them."""

    def __init__(self, envs: RobotVectorEnv) -> None:
        self._envs = envs
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, int)

    def reset(self) -> Any:
        seed = next((seed for seed in self._seeds if seed is not None), None)
        self._reset_seeds()
        self._returns[:], self._lengths[:] = 0.0, 0
        return self._envs.reset(seed=seed)[0]

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> Any:
        observations, rewards, terminations, truncations, last = self._envs.step(self._actions)
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for world in np.flatnonzero(terminations | truncations):
            infos[world] = {
                "terminal_observation": last["final_obs"][world],
                "TimeLimit.truncated": bool(truncations[world]),
                "episode": {"r": self._returns[world], "l": self._lengths[world], "t": 0.0},
            }
            self._returns[world], self._lengths[world] = 0.0, 0
        return observations, rewards, terminations | truncations, infos

    def close(self) -> None:
        self._envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self._envs, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError("all environments are worlds of one batch, and alike")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        raise NotImplementedError("all environments are worlds of one batch, and alike")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


class Log(BaseCallback):
    """Says how the training goes."""

    def _on_training_start(self) -> None:
        self._start, self._said = time.perf_counter(), 0.0

    def _on_step(self) -> bool:
        elapsed = time.perf_counter() - self._start
        if elapsed > self._said + 10.0 and self.model.ep_info_buffer:
            self._said = elapsed
            mean = np.mean([episode["r"] for episode in self.model.ep_info_buffer])
            rate = self.num_timesteps / elapsed
            print(f"{elapsed:4.0f} s  {rate:7,.0f} controls/s  return {mean:6.0f}", flush=True)
        return True


def make(engine: str, count: int, seed: int) -> VecEnv:
    """Hoppers moved by an engine."""
    if engine == "mujoco":
        return make_vec_env("Hopper-v5", n_envs=count, seed=seed)
    envs = BatchOfWorlds(RobotVectorEnv("hopper", count))
    envs.seed(seed)
    return envs


def returns(policy: PPO, normalizer: VecNormalize, envs: VecEnv) -> np.ndarray:
    """Returns of a policy without noise, of an episode of each environment, shape (num_envs,)."""
    observations, total = envs.reset(), np.zeros(envs.num_envs)
    running = np.ones(envs.num_envs, bool)
    while running.any():
        known = normalizer.normalize_obs(observations)
        observations, rewards, ended, _ = envs.step(policy.predict(known, deterministic=True)[0])
        total += running * rewards
        running &= ~ended
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--engine", choices=ENGINES, default="avbd")
    parser.add_argument("--controls", type=int, default=1_000_000)
    parser.add_argument("--worlds", type=int, default=16, help="environments (default: 16)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, help="file for the policy")
    args = parser.parse_args()
    start_warp()
    torch.set_num_threads(1)  # networks this small gain nothing from more
    envs = VecNormalize(make(args.engine, args.worlds, args.seed))
    policy = PPO(
        "MlpPolicy",
        envs,
        n_steps=CONTROLS // args.worlds,
        learning_rate=lambda left: 3.0e-4 * max(left, SLOWEST),
        gamma=DISCOUNT,
        seed=args.seed,
        device="cpu",
    )
    begin, used = time.perf_counter(), time.process_time()
    try:
        policy.learn(total_timesteps=args.controls, callback=Log())
    except KeyboardInterrupt:
        print("stopped; this is the policy until then")
    if args.output:
        policy.save(args.output)
        envs.save(str(args.output.with_suffix(".normalizer")))
    envs.training = False
    minutes = (time.perf_counter() - begin) / 60.0
    used = (time.process_time() - used) / 60.0
    print(
        f"trained in {args.engine} for {policy.num_timesteps:,} controls, {minutes:.1f} min "
        f"({used:.1f} of processor time), seed {args.seed}, gymnasium {gymnasium.__version__}"
    )
    for engine in ENGINES:
        found = returns(policy, envs, make(engine, EPISODES, seed=1000))
        print(f"return in {engine:<7} {found.mean():6.0f} ± {found.std():.0f}", flush=True)


if __name__ == "__main__":
    main()
