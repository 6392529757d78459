# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Try policies of ``train.py --output POLICY`` in variants of both engines: what do they depend on?

    pip install 'newton-avbd[learning]' stable-baselines3 'gymnasium[mujoco]' 'mujoco~=3.17.0'
    python examples/learning/transfer.py POLICY ...

Prints the mean return over three episodes without noise, a row a variant and a column a policy.
"""

import argparse
import dataclasses
import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv
from train import BatchOfWorlds, returns

from newton_avbd import SolverAVBD
from newton_avbd.environments import RobotVectorEnv
from newton_avbd.io.terminal import start_warp

EPISODES = 3
FINER = 4
"""A fine time step goes so many times into the usual one."""

HARD = 'solref="0.004 1" solimp="0.99 0.999 0.0001"'
"""Contacts as hard as the fine step of 0.5 ms allows."""


def mujoco(changes: dict[str, str] | None = None, finer: int = 1) -> VecEnv:
    """``Hopper-v5`` with replaced texts of its file, and a finer time step."""
    file = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / "hopper.xml"
    text = file.read_text()
    changes = {'timestep="0.002"': f'timestep="{0.002 / finer}"'} | (changes or {})
    for old, new in changes.items():
        if old not in text:
            raise ValueError(f"{file} has no {old}")
        text = text.replace(old, new)
    with tempfile.NamedTemporaryFile("w", suffix=".xml") as changed:
        changed.write(text)
        changed.flush()
        options = {"xml_file": changed.name, "frame_skip": 4 * finer}
        return make_vec_env("Hopper-v5", n_envs=EPISODES, seed=1000, env_kwargs=options)


def avbd(finer: int = 1, stiffness: float | None = None, damping: float = 0.0) -> VecEnv:
    """The hopper in SolverAVBD, with a finer time step and compliant contacts [N/m, N s/m]."""
    envs = RobotVectorEnv("hopper", EPISODES)
    envs.task = dataclasses.replace(envs.task, steps=envs.task.steps * finer)
    if stiffness is not None:
        envs.model.shape_material_ke.fill_(stiffness)
        envs.model.shape_material_kd.fill_(damping)
        envs.solver = SolverAVBD(envs.model, update_joint_state=True, compliant_contacts=True)
    batch = BatchOfWorlds(envs)
    batch.seed(1000)
    return batch


SOFT = 'solimp=".8 .8 .01" solref=".02 1"'
LIMITED = 'damping="1" limited="true"'
HARD_LIMITS = 'solreflimit="0.004 1" solimplimit="0.99 0.999 0.0001"'
VARIANTS: dict[str, Callable[[], VecEnv]] = {
    "MuJoCo": mujoco,
    "MuJoCo, a quarter of the time step": lambda: mujoco(finer=FINER),
    "MuJoCo, hard contacts": lambda: mujoco({SOFT: HARD}, FINER),
    "MuJoCo, hard joint limits": lambda: mujoco({LIMITED: f"{LIMITED} {HARD_LIMITS}"}, FINER),
    "MuJoCo, friction 1.5 (the foot's is 2)": lambda: mujoco({'friction="2.0"': 'friction="1.5"'}),
    "MuJoCo, elliptic friction cone, impratio 10": lambda: mujoco(
        {'integrator="RK4"': 'integrator="RK4" cone="elliptic" impratio="10"'}
    ),
    "SolverAVBD": avbd,
    "SolverAVBD, a quarter of the time step": lambda: avbd(FINER),
    "SolverAVBD, compliant contacts of 3e4 N/m, 1e3 N s/m": lambda: avbd(1, 3.0e4, 1.0e3),
    "SolverAVBD, compliant contacts of 3e5 N/m, 1e4 N s/m": lambda: avbd(1, 3.0e5, 1.0e4),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("policies", nargs="+", type=Path, metavar="POLICY")
    args = parser.parse_args()
    start_warp()
    tried = []
    for path in args.policies:
        with path.with_suffix(".normalizer").open("rb") as file:
            tried.append((PPO.load(path, device="cpu"), pickle.load(file)))
    print("| simulated in |", " | ".join(path.name for path in args.policies), "|")
    print("| --- |" + " --- |" * len(tried))
    for name, make in VARIANTS.items():
        means = [returns(policy, normalizer, make()).mean() for policy, normalizer in tried]
        print(f"| {name} | " + " | ".join(f"{mean:,.0f}" for mean in means) + " |", flush=True)


if __name__ == "__main__":
    main()
