# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd accuracy --ask``: the reference is as good as it says, and so are the prices."""

import json
from pathlib import Path as File

import numpy as np
import pytest

from newton_avbd.__main__ import main
from newton_avbd.io.errors import UserError
from newton_avbd.io.opening import read_scene
from newton_avbd.scenes.scene import Scene
from newton_avbd.study.accuracy import ask as accuracy_ask
from newton_avbd.study.accuracy import pendulums
from newton_avbd.study.accuracy import results as accuracy
from newton_avbd.study.accuracy.ask import (
    Question,
    Reference,
    ask,
    marks,
    prices,
)
from newton_avbd.study.accuracy.run import Point, runner
from newton_avbd.study.accuracy.scene import FRAME
from newton_avbd.study.accuracy.scenes import ACCURACY_SCENES
from newton_avbd.study.accuracy.solvers import Setting

PENDULUM = """<mujoco><option timestep="0.01"/><worldbody><body pos="0 0 2" euler="0 60 0">
<joint name="hinge" type="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05" mass="1" contype="0" conaffinity="0"/>
</body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def question() -> Question:
    """A double pendulum of half a second."""
    chain = ACCURACY_SCENES["pendulum_2"]
    return ask(Scene("pendulum", "", chain.build, frames=30), budget=3.0)


def test_a_refined_motion_is_as_close_to_the_true_one_as_it_says(question: Question) -> None:
    worker = runner(question.scene, "avbd")
    path, _ = worker.run(Setting(1, 10))
    belongs = pendulums.reference(worker.model, 30 * FRAME)
    found = question.reference.marks[30, : len(belongs)]
    off = np.max(np.linalg.norm(found - belongs, axis=1))
    assert question.scene.frames == 30
    # the model's own numbers are of single precision
    assert off <= question.bar + 1e-6
    assert question.bar < 1e-5
    # double precision, and not the solver that is measured
    assert question.reference.solver == "mj_step"
    assert question.apart is not None and question.apart < 1e-4
    # and the first step of a plain run is told from it
    assert question.scene.error(path) > 10.0 * question.bar


def test_a_price_is_that_of_the_cheapest_setting_and_can_be_pasted(question: Question) -> None:
    def point(solver: str, setting: Setting, error: float, cost: float) -> Point:
        return Point("pendulum", solver, setting, error=error, cost=cost)

    points = [
        point("avbd", Setting(4, 10, scheme="euler"), 5e-3, 1.0),
        point("avbd", Setting(2, 10, scheme="generalized_alpha"), 5e-3, 0.5),
        point("avbd", Setting(8, 10, 1e-3, "generalized_alpha"), 5e-5, 2.0),
        point("mj_step", Setting(1, scheme="rk4"), 5e-4, 0.4),
    ]
    found = {price.accuracy: price for price in prices(question, points)}
    assert found[1e-2].cheapest == {"avbd": points[1], "mj_step": points[3]}
    line = 'solver = SolverAVBD(model, scheme="generalized_alpha", iterations=10'
    assert found[1e-2].line == f"{line})  # and dt = 1 / 120"
    assert found[1e-4].line == f"{line}, tolerance=0.001)  # and dt = 1 / 480"
    assert found[1e-5].line is None


def test_a_motion_is_known_until_fine_runs_part() -> None:
    still = np.zeros((5, 1, 3))
    known = Reference("avbd", 16, still, np.array([0.0, 1e-4, 9e-4, 2e-3, 1e-5]))
    assert known.certain == 2
    assert Reference("avbd", 16, still, np.zeros(5)).certain == 4
    # beside a way of 10 m, 2 mm are little
    far = np.linspace(0.0, 10.0, 5)[:, None, None] * np.array([1.0, 0.0, 0.0])
    assert Reference("avbd", 16, far, known.bar).certain == 4


def test_points_of_a_body_tell_a_turn_about_its_center(question: Question) -> None:
    worker = runner(question.scene, "avbd")
    path, _ = worker.run(Setting(1, 10))
    turned = path.body_q.copy()
    # by half a turn about z
    turned[..., 3:] = np.stack(
        [-turned[..., 4], turned[..., 3], turned[..., 6], -turned[..., 5]], axis=-1
    )
    other = type(path)(path.model, turned, path.body_qd)
    assert np.max(np.linalg.norm(marks(other) - marks(path), axis=2)) > 0.1


def test_a_file_is_asked_about_from_the_command_line(
    tmp_path: File, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "pendulum.xml"
    file.write_text(PENDULUM)
    monkeypatch.setattr("newton_avbd.commands.accuracy.REFERENCE_BUDGET", 2.0)
    effort = accuracy.Effort("ask", repeats=1, budget=1.0, quick=True)
    monkeypatch.setattr("newton_avbd.commands.accuracy.ASK", effort)
    ending = ["--ask", str(file), "--solvers", "avbd", "mj_step"]
    assert main(["accuracy", *ending, "--output", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "SolverAVBD" in text and "mj_step" in text and "to paste:" in text
    assert (tmp_path / "pendulum.svg").is_file()
    assert main(["accuracy", *ending, "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["is_determined"] and found["bodies"] == 1
    assert found["prices"][0]["line"].startswith("solver = SolverAVBD(model")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--ask", "no_such_scene"], "there is no scene"),
        (["--ask", "robot:nobody"], "there is no robot"),
        (["--ask", "nothing.urdf"], "no such file"),
        (["--ask", "stack", "pyramid"], "--ask takes one scene"),
        (["--json", "-"], "--json goes with --ask"),
    ],
)
def test_what_cannot_be_asked_is_named(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["accuracy", *arguments]) != 0
    assert says in capsys.readouterr().err


def test_an_example_starts_where_its_program_puts_it() -> None:
    scene, notes = read_scene("newton:basic_pendulum")
    assert any("only its model" in note for note in notes)
    poses = scene.model(device="cpu").body_q.numpy()
    # its links hang together: 2 m from center to center at most
    assert np.linalg.norm(poses[1, :3] - poses[0, :3]) < 2.0
    with pytest.raises(UserError, match="no rigid bodies"):
        read_scene("newton:cloth_hanging")


def test_what_is_asked_by_default_is_told_in_time() -> None:
    budget = len(accuracy_ask.SOLVERS) * accuracy.ASK.budget
    assert budget < 90.0
