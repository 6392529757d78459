# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Known answers are right, points are compared as said, and a run goes on where it ended."""

import json
import math
from collections.abc import Callable
from pathlib import Path as File

import numpy as np
import pytest

from newton_avbd.__main__ import main
from newton_avbd.io.errors import UserError
from newton_avbd.measure.state import Array
from newton_avbd.study.accuracy import page as accuracy_page
from newton_avbd.study.accuracy import results as accuracy
from newton_avbd.study.accuracy.front import OURS, cheapest, front, shares, split, verdicts
from newton_avbd.study.accuracy.run import OUT_OF_TIME, Point, measure, runner
from newton_avbd.study.accuracy.scene import FRAME, AccuracyScene, G, OffPath, Path, rebounds
from newton_avbd.study.accuracy.scenes import (
    ACCURACY_SCENES,
    EDGE,
    LANDING_HEIGHT,
    LANDING_TILT,
    tipped,
)
from newton_avbd.study.accuracy.simbench import (
    STANDING,
    energy_error,
    momentum_error,
    penetration_error,
    rolling_accelerations,
)
from newton_avbd.study.accuracy.solvers import MEASURED, PRESETS, STIFF, Setting, is_coarse
from newton_avbd.study.properties.body import MOMENTS, free_top

pytest.importorskip("scipy")

# The references


def _integrate(rate: Callable[[Array], Array], start: Array, seconds: float, steps: int) -> Array:
    """The end of the classical Runge-Kutta method."""
    y, h = np.array(start, dtype=float), seconds / steps
    for _ in range(steps):
        a = rate(y)
        b = rate(y + 0.5 * h * a)
        c = rate(y + 0.5 * h * b)
        y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(y + h * c))
    return y


def _resting(name: str) -> Path:
    """A path of a scene in which nothing moves."""
    scene = ACCURACY_SCENES[name]
    model = scene.scene(1).model(device="cpu")
    count = scene.frames + 1
    return Path(
        model,
        np.repeat(model.body_q.numpy()[None].astype(float), count, axis=0),
        np.repeat(model.body_qd.numpy()[None].astype(float), count, axis=0),
    )


def _belongs(name: str) -> Array:
    """Where the only body of a scene belongs."""
    error = ACCURACY_SCENES[name].error
    assert isinstance(error, OffPath)
    return error.belongs(_resting(name))[:, 0]


def _slides(mu: float, slope: float = 0.0) -> Callable[[Array], Array]:
    """Motion of a box on a slope, [way, speed]; friction fades below 0.1 mm/s."""

    def rate(y: Array) -> Array:
        friction = mu * G * math.cos(slope) * math.tanh(y[1] / 1e-4)
        return np.array([y[1], G * math.sin(slope) - friction])

    return rate


def test_sliding_box_stops_where_friction_stops_it() -> None:
    way = _integrate(_slides(0.4), [0.0, 2.0], 1.0, 20000)[0]
    belongs = _belongs("sliding")
    assert np.linalg.norm(belongs[-1] - belongs[0]) == pytest.approx(way, rel=1e-3)


def test_box_slides_down_the_incline_as_the_forces_say() -> None:
    way = _integrate(_slides(0.3, math.radians(20.0)), [0.0, 0.0], 1.0, 20000)[0]
    belongs = _belongs("incline")
    assert np.linalg.norm(belongs[-1] - belongs[0]) == pytest.approx(way, rel=1e-3)


def test_sphere_skids_until_it_rolls() -> None:
    def rate(y: Array) -> Array:
        # Way, speed, speed of the rim: friction acts until the lowest point stands still.
        friction = 0.3 * G * math.tanh((y[1] - y[2]) / 1e-3)
        return np.array([y[1], -friction, 2.5 * friction])

    way = _integrate(rate, [0.0, 2.0, 0.0], 1.0, 20000)[0]
    assert _belongs("skidding")[-1, 0] == pytest.approx(way, rel=1e-4)


def test_spring_swings_as_integrated() -> None:
    end = _integrate(
        lambda y: np.array([y[1], -((2.0 * math.pi) ** 2) * y[0]]), [0.5, 0.0], 0.4, 400
    )
    assert _belongs("oscillator")[24, 0] == pytest.approx(end[0], abs=1e-8)


def test_ball_bounces_as_stepped() -> None:
    height, speed, bounces, h = 0.5, 0.0, 0, 1e-5
    for _ in range(100_000):
        speed -= G * h
        height += speed * h
        if height < 0.0 and speed < 0.0:
            speed, bounces = -0.7 * speed, bounces + 1
    (found,), (count,) = rebounds(np.array([1.0]), 0.7, 0.5)
    assert found == pytest.approx(height, abs=2e-4) and count == bounces == 2
    assert _belongs("bounce")[-1, 2] == pytest.approx(0.1 + height, abs=2e-4)


def test_ball_comes_to_rest_after_all_its_bounces() -> None:
    fall = math.sqrt(2.0 * 0.5 / G)
    # The bounces of a geometric series of times end at fall (1 + e) / (1 - e).
    end = fall * (1.0 + 0.7) / (1.0 - 0.7)
    before, after = rebounds(np.array([end - 1e-2, end + 1e-4]), 0.7, 0.5)[0]
    assert before > 0.0 and after == 0.0


def test_tipping_cube_keeps_its_energy() -> None:
    times = np.array([0.0, 0.2, 0.2001, 0.3])
    center = tipped(times, 0.1, 0.5)[:, 0]
    reach = math.sqrt(0.5) * EDGE
    assert np.allclose(np.linalg.norm(center, axis=1), reach)
    speed = np.linalg.norm(center[2] - center[1]) / 1e-4
    # m v^2 / 2 and the cube's own turning add up to 2/3 m v^2.
    before = 2.0 / 3.0 * (0.5 * reach) ** 2 + G * reach * math.cos(0.1)
    assert 2.0 / 3.0 * speed**2 + G * center[1:3, 2].mean() == pytest.approx(before, rel=1e-5)


def test_cube_lands_with_its_angular_momentum() -> None:
    speed = math.sqrt(2.0 * G * LANDING_HEIGHT)
    path, reach = _belongs("landing"), math.sqrt(0.5) * EDGE
    # Before the blow m v times its arm, after it a moment of inertia of 4/3 m r^2.
    rate = speed * reach * math.sin(LANDING_TILT) / (4.0 / 3.0 * reach**2)
    after = (len(path) - 1) * FRAME - speed / G
    angle, _ = _integrate(
        lambda y: np.array([y[1], 0.75 * G / reach * math.sin(y[0])]),
        [LANDING_TILT, rate],
        after,
        100,
    )
    assert np.allclose(path[-1], [reach * math.sin(angle), 0.0, reach * math.cos(angle)])
    # It sticks: the blow is within the cone, and its other face has not come down yet.
    along, up = rate * reach * math.cos(LANDING_TILT), rate * reach * math.sin(LANDING_TILT)
    assert along < speed - up and angle < 0.25 * math.pi


def test_free_top_keeps_energy_and_angular_momentum() -> None:
    def spin(t: float) -> tuple[Array, Array]:
        h = 1e-4
        (a, b), q = (free_top(t - h), free_top(t + h)), free_top(t)
        rate = (b - a) / (2.0 * h)
        # Twice the vector part of conjugate(q) rate, along the body's axes.
        return q, 2.0 * (q[3] * rate[:3] - rate[3] * q[:3] - np.cross(q[:3], rate[:3]))

    found = []
    for t in (0.01, 0.25, 0.5):
        q, w = spin(t)
        momentum = MOMENTS * w
        turned = momentum + 2.0 * np.cross(q[:3], np.cross(q[:3], momentum) + q[3] * momentum)
        found.append([0.5 * w @ momentum, *turned])
    assert np.allclose(found, found[0], rtol=1e-6, atol=1e-6)


def test_balls_roll_on_the_box_as_newton_and_euler_say() -> None:
    box, ball = rolling_accelerations()
    friction = ball * 1.0
    # The rim under a ball of radius r turns with f r / (2/5 m r^2) against its way.
    assert box == pytest.approx(ball + friction / 0.4)
    assert 10.0 * box == pytest.approx(150.0 - 0.4 * 35.0 * 9.81 - 25.0 * friction)
    # It rolls: far less than what friction of 0.4 (their smallest mix) could hold.
    assert friction < 0.4 * 9.81


# Measures


def test_path_where_it_belongs_has_no_error() -> None:
    for name in ("projectile", "sliding", "tipping", "landing"):
        path = _resting(name)
        com = path.bodies.com
        path.body_q[:, 0, :3] = _belongs(name)
        assert not com.any()
        assert ACCURACY_SCENES[name].error(path) < 1e-12


def test_top_that_is_off_by_an_angle_has_that_error() -> None:
    path = _resting("top")
    x, y, z, w = free_top(0.5)
    s, c = math.sin(0.005), math.cos(0.005)
    path.body_q[-1, 0, 3:] = [c * x + s * w, c * y - s * z, c * z + s * y, c * w - s * x]
    turned = math.sqrt(18.0) * 0.5
    assert ACCURACY_SCENES["top"].error(path) == pytest.approx(0.01 / turned, rel=1e-6)


def test_simbench_measures_are_relative() -> None:
    path = _resting("666")
    # At the start nothing touches: balls are 1 cm apart, up to 1 mm out of place.
    assert penetration_error(path) == 0.0
    path.body_q[:, :, 2] -= 0.011
    lowest = path.centers[0, :, 2] < 0.1
    depth = 0.1 - path.centers[0, lowest, 2]
    expected = math.sqrt(float(np.sum(depth**2)) / 216.0) / 0.1
    assert penetration_error(path) == pytest.approx(expected)
    path = _resting("elastic_666")
    path.body_q[1:, :, 2] += 0.01 * path.centers[0, :, 2].mean()
    assert energy_error(path) == pytest.approx(0.01, rel=0.01)
    path = _resting("momentum")
    path.body_qd[1:, -1, 1] *= 0.99
    assert momentum_error(path) == pytest.approx(0.01, rel=0.01)


def test_standing_robot_is_where_mujoco_has_it() -> None:
    scene = ACCURACY_SCENES["standing"]
    path, _ = runner(scene, "mj_step").run(Setting(64, scheme=STIFF))
    assert path.centers[-1, 0, 2] == pytest.approx(STANDING, rel=scene.resolution)
    assert scene.error(path) < scene.resolution


# Points


def _point(solver: str, cost: float | None, error: float | None, **setting: int) -> Point:
    return Point("scene", solver, Setting(**({"substeps": 1} | setting)), error, cost)


def test_front_has_what_nothing_beats() -> None:
    points = [_point(OURS, *at) for at in ((1, 0.1), (2, 0.2), (3, 0.01), (3, 0.02), (9, 0.01))]
    assert [(point.cost, point.error) for point in front(points)] == [(1, 0.1), (3, 0.01)]
    assert front([_point(OURS, 1.0, None), _point(OURS, None, None)]) == []


def test_cheapest_reaches_the_error() -> None:
    points = [_point(OURS, 1.0, 0.1), _point(OURS, 3.0, 0.01), _point(OURS, 5.0, 0.001)]
    found = cheapest(points, 0.01)
    assert found is not None and found.cost == 3.0
    assert cheapest(points, 1e-4) is None


def test_verdicts_count_what_is_reached() -> None:
    points = [
        *(_point(OURS, cost, error) for cost, error in ((1.0, 1e-2), (9.0, 1e-3))),
        *(_point("xpbd", cost, error) for cost, error in ((2.0, 1e-2), (3.0, 1e-3), (4.0, 1e-4))),
    ]
    found = verdicts(points)
    assert [verdict.level for verdict in found] == [1e-2, 1e-3, 1e-4]
    assert [verdict.ratio for verdict in found] == [0.5, 3.0, math.inf]
    assert shares(found) == (pytest.approx(1 / 3), pytest.approx(1 / 3))
    # Without a rival we are the cheapest; a level finer than the reference is nobody's.
    (alone,) = verdicts(points[:1])
    assert alone.ratio == 0.0 and shares([alone]) == (1.0, 1.0)
    assert len(verdicts(points, {"scene": 5e-4})) == 2


def test_equal_cost_is_split_both_ways() -> None:
    points = [
        _point(OURS, 10.0, 0.03, substeps=16, iterations=10),
        _point(OURS, 10.5, 0.02, substeps=64, iterations=2),
        _point(OURS, 9.0, 0.04, substeps=1, iterations=40),
        _point(OURS, 9.0, 0.05, substeps=4, iterations=20),
        _point(OURS, 20.0, 0.001, substeps=1, iterations=80),
    ]
    found = split(points, Setting(16, 10))
    assert found is not None
    assert (found.iterations.error, found.substeps.error) == (0.04, 0.02)
    assert split(points, Setting(2, 10)) is None


def test_settings_go_from_cheap_to_dear_on_a_coarse_grid_first() -> None:
    for solver in MEASURED.values():
        for touching in (False, True):
            every = solver.settings(touching=touching, sweeps=True, quick=False)
            some = solver.settings(touching=touching, sweeps=True, quick=True) if every else []
            assert set(some) <= set(every)
            assert len(set(every)) == len(every)
            coarse = [is_coarse(setting) for setting in every]
            assert coarse == sorted(coarse, reverse=True)
            for kind in (True, False):
                part = [setting for setting in every if is_coarse(setting) is kind]
                efforts = [setting.substeps * (setting.iterations or 1) for setting in part]
                assert efforts == sorted(efforts)


def test_every_scene_is_for_solvers_that_are_measured() -> None:
    for scene in ACCURACY_SCENES.values():
        assert scene.frames * FRAME == pytest.approx(scene.seconds)
        assert OURS in scene.solvers and set(scene.solvers) <= set(MEASURED)
        for solver in scene.solvers:
            assert MEASURED[solver].settings(
                touching=scene.touching, sweeps=scene.sweeps, quick=False
            )


# Runs


def test_replayed_run_is_the_eager_one() -> None:
    scene = ACCURACY_SCENES["sliding"]
    worker = runner(scene, "avbd")
    path, cost = worker.run(Setting(1, 10))
    again, _ = worker.run(Setting(1, 10))
    assert cost > 0.0 and np.array_equal(path.body_q, again.body_q)
    worker.restart(Setting(1, 10))
    assert worker.eager() > 0.0  # type: ignore[operator]
    # It has made fourteen plain steps.
    assert np.array_equal(worker.observe().body_q.numpy(), path.body_q[14].astype(np.float32))


def test_smaller_steps_are_more_accurate() -> None:
    """By schemes of order one: of order two a parabola is exact at any step."""
    for solver, scheme in (("avbd", "euler"), ("mj_step", None)):
        worker = runner(ACCURACY_SCENES["projectile"], solver)
        coarse, fine = (
            measure(worker, solver, Setting(substeps, scheme=scheme), repeats=1, budget=60.0)
            for substeps in (1, 4)
        )
        assert coarse.error == pytest.approx(4.0 * fine.error, rel=0.05)  # type: ignore[operator]


def test_run_without_time_says_so() -> None:
    worker = runner(ACCURACY_SCENES["projectile"], "avbd")
    point = measure(worker, "avbd", Setting(4), repeats=1, budget=0.0)
    assert point.note == OUT_OF_TIME and point.error is None


def test_solver_that_fails_is_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    worker = runner(ACCURACY_SCENES["projectile"], "avbd")

    def fail(setting: Setting) -> None:
        raise RuntimeError("no such luck")

    monkeypatch.setattr(worker, "restart", fail)
    point = measure(worker, "avbd", Setting(4), repeats=1, budget=1.0)
    assert point.note == "RuntimeError: no such luck" and point.cost is None


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two settings of each solver, the second within a hundredth."""
    monkeypatch.setattr(
        type(MEASURED["avbd"]), "settings", lambda self, **_: [Setting(1), Setting(8)]
    )


def test_command_measures_and_goes_on_where_it_ended(
    tiny: None, tmp_path: File, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    command = ["accuracy", "projectile", "--quick", "--output", str(tmp_path)]
    assert main([*command, "--solvers", "avbd"]) == 0
    assert "SolverAVBD is the cheapest on" in capsys.readouterr().out
    data = json.loads((tmp_path / "projectile.json").read_text())
    assert [point["setting"]["substeps"] for point in data["points"]] == [1, 8]
    assert data["effort"] == "quick" and data["machine"]["processor"]
    assert "<svg" in (tmp_path / "projectile.svg").read_text()
    measured: list[str] = []

    def watched(worker: object, solver: str, *rest: object, **more: object) -> Point:
        measured.append(solver)
        return measure(worker, solver, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(accuracy, "measure", watched)
    assert main([*command, "--solvers", "avbd", "mj_step"]) == 0
    assert measured == ["mj_step", "mj_step"]
    page = (tmp_path / "results.md").read_text()
    assert "mj_step" in page and "![projectile](projectile.svg)" in page


def test_results_of_another_machine_are_not_mixed_in(tmp_path: File) -> None:
    here = accuracy.Results({"processor": "this one"}, accuracy.QUICK, tmp_path)
    here.add(_point(OURS, 1.0, 0.1))
    again = accuracy.Results({"processor": "this one"}, accuracy.QUICK, tmp_path)
    assert again.of("scene") == here.of("scene")
    for machine, effort in (("another", accuracy.QUICK), ("this one", accuracy.FULL)):
        other = accuracy.Results({"processor": machine}, effort, tmp_path)
        with pytest.raises(UserError, match="give another --output"):
            other.of("scene")


def test_time_spent_before_counts(tmp_path: File, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two settings take all of it; presets are measured in any case."""

    def costly(worker: object, solver: str, setting: Setting, **_: object) -> Point:
        return Point("projectile", solver, setting, 0.1, 1.0, spent=0.6 * accuracy.QUICK.budget)

    monkeypatch.setattr(accuracy, "measure", costly)
    scenes: list[AccuracyScene] = [ACCURACY_SCENES["projectile"]]
    for _ in range(2):
        results = accuracy.Results({"processor": "x"}, accuracy.QUICK, tmp_path)
        points = list(accuracy.run(scenes, ("avbd",), results))
        presets = [PRESETS["euler"], PRESETS["default"]]
        assert [point.setting for point in points[2:]] == presets


def test_command_knows_its_scenes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["accuracy", "projectiles"]) == 2
    assert "there is no accuracy scene 'projectiles'" in capsys.readouterr().err


def test_page_names_presets_and_losses() -> None:
    points = [
        Point("projectile", OURS, Setting(4, 2, scheme="euler"), 5e-3, 2.0),
        Point("projectile", "xpbd", Setting(4, 2), 5e-3, 1.0),
    ]
    page = accuracy_page.page({}, "quick", [ACCURACY_SCENES["projectile"]], points)
    assert "| `projectile` | 1e-02 | 2 | SolverXPBD | 4x 2 it |" in page
    assert "5.0e-03 at 2 ms" in page
