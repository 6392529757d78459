# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Environments of gymnasium over a batch of worlds."""

import re
import runpy
import sys
from pathlib import Path
from typing import Any

import newton
import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")
mujoco = pytest.importorskip("mujoco")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402
from gymnasium.wrappers.vector import RecordEpisodeStatistics  # noqa: E402

from newton_avbd.environments import TASKS, RobotVectorEnv  # noqa: E402

WORLDS = 3


@pytest.fixture(scope="module", params=TASKS)
def envs(request: pytest.FixtureRequest) -> RobotVectorEnv:
    """Three worlds of each robot; tests reset them."""
    return RobotVectorEnv(request.param, WORLDS, max_episode_steps=12)


class FirstWorld(gymnasium.Env):
    """World 0 of a batch as an environment by itself, for gymnasium's check of such."""

    def __init__(self, envs: RobotVectorEnv) -> None:
        self._envs = envs
        self.observation_space = envs.single_observation_space
        self.action_space = envs.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        observations, _ = self._envs.reset(seed=seed)
        self._np_random, self._np_random_seed = self._envs._np_random, self._envs._np_random_seed
        return observations[0], {}

    def step(self, action: Any) -> Any:
        result = self._envs.step(np.tile(action, (WORLDS, 1)))
        observations, rewards, terminations, truncations, _ = result
        first = observations[0], float(rewards[0])
        return *first, bool(terminations[0]), bool(truncations[0]), {}


@pytest.mark.filterwarnings("ignore:.*(Box observation space|render|spec).*")
def test_a_world_passes_gymnasium_s_check(envs: RobotVectorEnv) -> None:
    """Spaces, types, that seeds determine starts and steps, and that arrays are not used again."""
    check_env(FirstWorld(envs), skip_render_check=True)


def test_a_batch_is_as_its_spaces_say(envs: RobotVectorEnv) -> None:
    statistics = RecordEpisodeStatistics(envs)
    observations, _ = statistics.reset(seed=1)
    assert observations in envs.observation_space
    for _ in range(3):
        actions = np.zeros(envs.action_space.shape, np.float32)
        observations, rewards, terminations, truncations, _ = statistics.step(actions)
        assert observations in envs.observation_space
        assert rewards.shape == terminations.shape == truncations.shape == (WORLDS,)
        assert terminations.dtype == truncations.dtype == np.bool_


def test_worlds_that_end_are_put_back_and_no_others(envs: RobotVectorEnv) -> None:
    """World 1 starts five controls later: the others end by their length in the step before."""
    zero = np.zeros(envs.action_space.shape, np.float32)
    envs.reset(seed=2)
    for _ in range(5):
        last = envs.step(zero)[0]
    observations, _ = envs.reset(options={"reset_mask": np.array([False, True, False])})
    np.testing.assert_array_equal(observations[[0, 2]], last[[0, 2]])
    assert np.abs(observations[1] - last[1]).max() > 0.0
    for _ in range(6):
        observations, _, terminations, truncations, infos = envs.step(zero)
        assert not truncations.any() and not terminations.any() and not infos
    observations, _, terminations, truncations, infos = envs.step(zero)
    assert truncations.tolist() == [True, False, True]
    assert infos["_final_obs"].tolist() == truncations.tolist()
    # World 1 goes on from its last observation, the others from a start of their own.
    np.testing.assert_array_equal(infos["final_obs"][1], observations[1])
    assert np.abs(infos["final_obs"][0] - observations[0]).max() > 1.0e-3
    assert np.abs(observations[0] - observations[2]).max() > 1.0e-4


def test_without_autoreset_a_fallen_hopper_stays_fallen() -> None:
    envs = RobotVectorEnv("hopper", WORLDS, autoreset_mode=AutoresetMode.DISABLED)
    envs.reset(seed=3)
    backwards = np.ones(envs.action_space.shape, np.float32)
    for _ in range(60):
        terminations = envs.step(backwards)[2]
    assert terminations.all()
    envs.reset(options={"reset_mask": np.ones(WORLDS, bool)})
    assert not envs.step(0.0 * backwards)[2].any()


def test_a_hopper_moves_as_in_mujoco() -> None:
    """Ten controls of 8 ms in the air, from the same pose.

    Backward Euler at 4 ms is off by half of the acceleration times the step times the time, 80 ms:
    by 1.6 mm where 10 m/s^2 act. The motors' 40 and 80 N m turn the legs, whose armature is 1 kg
    m^2, by up to 80 rad/s^2: 0.013 rad. Velocities are off by what half a step adds, and were
    within 0.3 %. MuJoCo's RK4 at 2 ms counts as exact.
    """
    envs = RobotVectorEnv("hopper", WORLDS)
    envs.reset(seed=0)
    q = np.tile(envs._rest, (WORLDS, 1))
    q[:, 1] += 0.2
    envs.state.joint_q.assign(q.ravel())
    envs.state.joint_qd.zero_()
    newton.eval_fk(envs.model, envs.state.joint_q, envs.state.joint_qd, envs.state)
    envs.solver.reset(envs.state, flags=0)
    folder = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
    model = mujoco.MjModel.from_xml_path(str(folder / "hopper.xml"))
    data = mujoco.MjData(model)
    data.qpos[1] += 0.2
    control = np.array([-0.2, -0.2, 0.4], np.float32)
    for _ in range(10):
        observations = envs.step(np.tile(control, (WORLDS, 1)))[0]
        data.ctrl[:] = control
        mujoco.mj_step(model, data, nstep=4)
    torso = data.body("torso").xpos
    np.testing.assert_allclose(envs._torso()[:, [0, 2]], [torso[[0, 2]]] * WORLDS, atol=2.5e-3)
    # as Hopper-v5 observes them
    np.testing.assert_allclose(observations[:, :5], [data.qpos[1:]] * WORLDS, atol=0.013)
    np.testing.assert_allclose(observations[:, 5:], [data.qvel] * WORLDS, rtol=0.03, atol=0.05)


@pytest.mark.long
def test_a_policy_learns_to_stay_up() -> None:
    """Cross-entropy search over linear policies: 15 generations of 32 hoppers, 1.6 s each at most.

    Without controls a hopper falls after 160 controls. Of six seeds the worst policy that was found
    had 1.3 times that return, the median 1.6 times; here the least of 32 episodes counts.
    """
    count = 32
    envs = RobotVectorEnv("hopper", count, autoreset_mode=AutoresetMode.DISABLED)
    everyone = {"reset_mask": np.ones(count, bool)}

    def returns(policies: np.ndarray, seed: int) -> np.ndarray:
        """Of an episode of each world, at most 200 controls; policies are (count, 3, 11)."""
        observations, _ = envs.reset(seed=seed, options=everyone)
        total, up = np.zeros(count), np.ones(count, bool)
        for _ in range(200):
            actions = np.tanh(np.einsum("wij,wj->wi", policies, observations))
            observations, rewards, terminations, _, _ = envs.step(actions.astype(np.float32))
            total += up * rewards
            up &= ~terminations
        return total

    rng = np.random.default_rng(2)
    mean, spread = np.zeros((3, 11)), np.full((3, 11), 0.5)
    untrained = returns(np.tile(mean, (count, 1, 1)), seed=1)
    for generation in range(15):
        policies = mean + spread * rng.standard_normal((count, 3, 11))
        best = policies[np.argsort(returns(policies, seed=100 + generation))[-8:]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.1
    trained = returns(np.tile(mean, (count, 1, 1)), seed=1)
    assert np.isfinite(trained).all()
    assert trained.min() > 1.2 * untrained.mean()


def test_the_script_trains_and_tries_a_policy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Two updates of PPO, which teach nothing yet."""
    pytest.importorskip("stable_baselines3")
    script = Path(__file__).parent.parent / "examples" / "learning" / "train.py"
    output = tmp_path / "policy.zip"
    arguments = ["--controls", "4096", "--output", str(output)]
    monkeypatch.setattr(sys, "argv", [str(script), *arguments])
    runpy.run_path(str(script), run_name="__main__")
    printed = capsys.readouterr().out
    tried = re.findall(r"^return in (\w+) +(-?\d+) ±", printed, re.MULTILINE)
    assert [engine for engine, _ in tried] == ["avbd", "mujoco"]
    assert all(0.0 < float(value) < 4000.0 for _, value in tried)
    assert output.exists()
