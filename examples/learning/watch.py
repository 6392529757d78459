# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Draw a hopper that follows a policy of ``train.py --output POLICY``, as an animated WebP file.

    pip install 'newton-avbd[learning,view]' stable-baselines3
    python examples/learning/watch.py POLICY hopper.webp

It moves in SolverAVBD. No window is opened; a machine without a display needs EGL or
``xvfb-run -a``.
"""

import argparse
import pickle
from pathlib import Path

import numpy as np
import warp as wp
from PIL import Image
from stable_baselines3 import PPO

from newton_avbd.commands.view import make_viewer
from newton_avbd.environments import RobotVectorEnv
from newton_avbd.io.terminal import start_warp

SIZE = (480, 270)
EVERY = 5
"""Controls for each picture: 40 ms."""

CAMERA = np.array([0.45, -3.2, -0.25])
"""Where the camera is from the torso [m]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("policy", type=Path)
    parser.add_argument("file", type=Path)
    parser.add_argument("--controls", type=int, default=500)
    args = parser.parse_args()
    start_warp()
    policy = PPO.load(args.policy, device="cpu")
    with args.policy.with_suffix(".normalizer").open("rb") as file:
        normalizer = pickle.load(file)
    envs = RobotVectorEnv("hopper", 1)
    observations, _ = envs.reset(seed=0)
    viewer = make_viewer("gl", "hopper", headless=True)
    viewer.set_model(envs.model)
    pictures, total = [], 0.0
    for control in range(args.controls):
        if control % EVERY == 0:
            torso = envs.state.body_q.numpy()[0, :3]
            viewer.set_camera(wp.vec3(*(torso + CAMERA)), pitch=-3.0, yaw=98.0)
            viewer.begin_frame(control * envs.task.duration)
            viewer.log_state(envs.state)
            viewer.end_frame()
            picture = Image.fromarray(viewer.get_frame().numpy())
            pictures.append(picture.resize(SIZE, Image.Resampling.LANCZOS))
        actions, _ = policy.predict(normalizer.normalize_obs(observations), deterministic=True)
        observations, rewards, *_ = envs.step(actions)
        total += rewards[0]
    duration = round(1000 * EVERY * envs.task.duration)
    pictures[0].save(
        args.file, save_all=True, append_images=pictures[1:], duration=duration, loop=0, quality=60
    )
    print(f"{args.file}: {len(pictures)} pictures, return {total:.0f}, {torso[0]:.1f} m")


if __name__ == "__main__":
    main()
