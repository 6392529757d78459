# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Tasks of gymnasium and dm_control, moved by SolverAVBD: their coordinates, controls, rewards."""

import mujoco
import newton
import numpy as np
import pytest

from newton_avbd.commands import COMMANDS
from newton_avbd.study.bench import learning

pytest.importorskip("gymnasium")
pytest.importorskip("dm_control")


@pytest.mark.parametrize(
    ("name", "scheme", "integrator", "controls", "apart"),
    [
        # no contacts, no gravity, hinges of an arm: 32 controls, of which the hand moves by 1 rad
        ("gymnasium/Pusher-v5", "euler", "EULER", 32, 0.03),
        # swings up to 2.2 rad: of first order in the step of 20 ms
        ("dm_control/pendulum-swingup", "euler", "EULER", 32, 0.03),
        # of second order: as the exact motion, from which first order is 0.08 rad away
        ("dm_control/pendulum-swingup", "generalized_alpha", "RK4", 32, 0.03),
    ],
)
def test_a_task_moves_as_with_mujoco(
    name: str, scheme: str, integrator: str, controls: int, apart: float
) -> None:
    """The same controls from the same start: coordinates in rad and m, rewards.

    MuJoCo's own step is of first order, as backward Euler is.
    """
    task = learning.Task(name)
    runs = []
    for engine in (learning.Engine(task, scheme=scheme), learning.Clock(task)):
        task.reset(0, engine)
        task.model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
        random = np.random.default_rng(1)
        acted = [task.step(0.3 * random.uniform(-1.0, 1.0, task.actions)) for _ in range(controls)]
        runs.append((task.data.qpos.copy(), np.array([reward for _, reward, _ in acted])))
    (ours, our_rewards), (theirs, rewards) = runs
    assert ours == pytest.approx(theirs, abs=apart)
    assert our_rewards == pytest.approx(rewards, abs=0.01)
    assert np.abs(theirs).max() > 0.5


def test_bodies_of_a_file_without_contacts_pass_through_each_other() -> None:
    """A cart within its rails, which rub it where contacts count."""
    task = learning.Task("dm_control/cartpole-swingup")
    paths = []
    for engine in (learning.Engine(task), learning.Clock(task)):
        task.reset(0, engine)
        path = []
        for control in range(32):
            task.step(np.array([np.sin(0.3 * control)]))
            path.append(task.data.qpos[0])
        paths.append(np.array(path))
    assert np.ptp(paths[1]) > 0.1
    assert paths[0] == pytest.approx(paths[1], abs=2.0e-3)


@pytest.mark.parametrize("name", ["finger-spin", "fish-swim"])
def test_gravity_that_a_file_disables_pulls_nothing(name: str) -> None:
    """The fish, whose file disables constraints, too, floats where it was."""
    task = learning.Task(f"dm_control/{name}")
    ends = []
    for engine in (learning.Engine(task), learning.Clock(task)):
        task.reset(0, engine)
        task.data.qvel[:] = 0.0
        engine.start(task.data)
        for _ in range(20):
            task.step(np.zeros(task.actions))
        ends.append(task.data.qpos[:3].copy())
    assert ends[0] == pytest.approx(ends[1], abs=5.0e-3)


def test_a_floating_root_is_put_and_taken_without_loss() -> None:
    """Its quaternion, its spin, its velocity at the origin of a body whose COM is elsewhere."""
    task = learning.Task("gymnasium/Ant-v5")
    engine = learning.Engine(task)
    task.reset(3, engine)
    task.model.body_ipos[1] = (0.1, -0.2, 0.05)
    engine._match(task)
    random = np.random.default_rng(0)
    task.data.qpos[3:7] /= np.linalg.norm(task.data.qpos[3:7])
    task.data.qvel[:] = random.normal(size=task.data.qvel.size)
    q, v = task.data.qpos.copy(), task.data.qvel.copy()
    engine._put(task.data)
    state = engine._state
    newton.eval_fk(engine.model, state.joint_q, state.joint_qd, state)
    newton.eval_ik(engine.model, state, state.joint_q, state.joint_qd)
    engine._take(task.data)
    assert task.data.qpos == pytest.approx(q, abs=1.0e-5)
    assert task.data.qvel == pytest.approx(v, abs=1.0e-4)


def test_the_policy_and_the_starts_are_fixed() -> None:
    """Two runs of MuJoCo are the same, and episodes differ."""
    task = learning.Task("gymnasium/InvertedPendulum-v5")
    runs = [learning.run(task, learning.Clock(task), 3, 50) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].returns, runs[1].returns)
    assert runs[0].lost == 0 and runs[0].rate > 0.0
    assert np.ptp(runs[0].lengths) > 0


def test_the_tasks_of_the_help_s_examples_exist() -> None:
    named = [typed for typed, _ in COMMANDS["learning"].examples if not typed.startswith("-")]
    assert named and set(named) <= set(learning.TASKS)
