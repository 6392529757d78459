# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Controls a second of hoppers in SolverAVBD and of gymnasium's own in MuJoCo, in one run.

    pip install 'newton-avbd[learning]' 'gymnasium[mujoco]' 'mujoco~=3.17.0'
    python examples/learning/speed.py

A random policy; collision detection, rewards, observations and new episodes are included. The
environments take turns, and the fastest turn of each counts.
"""

import time
from collections.abc import Callable

import gymnasium

from newton_avbd.environments import RobotVectorEnv
from newton_avbd.io.terminal import start_warp

CONTROLS = 4096
"""Of all environments of a batch in a turn."""

TURNS = 15
CONTESTANTS: dict[str, tuple[int, Callable[[int], gymnasium.vector.VectorEnv]]] = {
    "SolverAVBD, 64 worlds": (64, lambda n: RobotVectorEnv("hopper", n)),
    "SolverAVBD, 1,024 worlds": (1024, lambda n: RobotVectorEnv("hopper", n)),
    "MuJoCo, 8 one after the other": (
        8,
        lambda n: gymnasium.make_vec("Hopper-v5", n, vectorization_mode="sync"),
    ),
    "MuJoCo, 8 in processes": (
        8,
        lambda n: gymnasium.make_vec("Hopper-v5", n, vectorization_mode="async"),
    ),
}


def turn(envs: gymnasium.vector.VectorEnv) -> float:
    """Time of some controls by a random policy [s]."""
    actions = [envs.action_space.sample() for _ in range(CONTROLS // envs.num_envs)]
    begin = time.perf_counter()
    for action in actions:
        envs.step(action)
    return time.perf_counter() - begin


def main() -> None:
    start_warp()
    batches = {name: make(count) for name, (count, make) in CONTESTANTS.items()}
    for envs in batches.values():
        envs.action_space.seed(0)
        envs.reset(seed=0)
        turn(envs)  # compiles kernels, and captures the graph
    least = dict.fromkeys(batches, float("inf"))
    for _ in range(TURNS):
        for name, envs in batches.items():
            least[name] = min(least[name], turn(envs))
    for name, envs in batches.items():
        print(f"{name:<30} {CONTROLS / least[name]:9,.0f} controls/s")
        envs.close()


if __name__ == "__main__":
    main()
