# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The benchmark measures what it says, and tells when it cannot."""

import dataclasses
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from newton_avbd.commands.program import parse
from newton_avbd.io.errors import UserError
from newton_avbd.measure.joints import JointQuality
from newton_avbd.scenes.named import SCENES
from newton_avbd.study.bench import coldstart
from newton_avbd.study.bench import run as bench
from newton_avbd.study.bench.targets import EVERY_PEER, NEWTON_PEER, TARGETS, Result, Target
from newton_avbd.study.contestants import GRAPH_STEPS, NewtonContestant, Quality
from newton_avbd.study.mujoco.native import MujocoContestant
from newton_avbd.study.peers import PEERS, Peer


def _bench(*arguments: str) -> int:
    return bench.main(parse("bench", list(arguments)))


def test_quick_run_measures_every_solver_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bench.json"
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    assert (
        _bench("stack", "--quick", "--solvers", "avbd", "xpbd", "mj_step", "--json", str(out)) == 0
    )
    if cores is not None:
        assert os.sched_getaffinity(0) == cores
    printed = capsys.readouterr().out
    assert "SolverAVBD(10)" in printed and "must reach" in printed
    data = json.loads(out.read_text())
    results = {result["solver"]: result for result in data["results"]}
    assert list(results) == ["avbd", "xpbd", "mj_step"]
    assert data["machine"]["newton"] and data["machine"]["date"]
    assert len(data["targets"]) == len(TARGETS)
    for solver, result in results.items():
        assert result["replayed"] > 0.0
        # A bare mj_step has no launches from Python that could be left out.
        assert result["eager"] is None if solver == "mj_step" else result["eager"] > 0.0
        assert result["quality"]["contacts"] >= 80
        assert math.isfinite(result["quality"]["penetration"])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["pyramids"], "no benchmark scene 'pyramids'; there are: pyramid, stack"),
    ],
)
def test_unknown_name_lists_what_there_is(arguments: list[str], told: str) -> None:
    with pytest.raises(UserError, match=told):
        _bench(*arguments)


def test_solver_that_fails_is_reported_beside_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(model: object) -> None:
        raise RuntimeError("no such luck")

    monkeypatch.setitem(PEERS, "vbd", Peer("SolverVBD(10)", fail))
    results = bench.compete(bench.BENCHMARKS["free_bodies"], ["vbd", "semi_implicit"], bench.QUICK)
    assert results[0].note == "RuntimeError: no such luck"
    assert math.isnan(results[0].eager)
    assert results[1].eager > results[1].replayed > 0.0


def test_replayed_frame_is_a_frame_of_steps() -> None:
    replayed, eager = (NewtonContestant(SCENES["incline"], PEERS["xpbd"]) for _ in range(2))
    assert replayed.replay() > 0.0
    eager._collide()
    for _ in range(GRAPH_STEPS):
        eager._step()
    # The box slides, so a replay that did nothing would show.
    assert np.array_equal(replayed.observe().body_q.numpy(), eager.observe().body_q.numpy())
    assert np.all(replayed.observe().body_qd.numpy()[:, 0] > 0.0)


def test_solver_that_cannot_be_captured_has_no_replayed_time() -> None:
    contestant = NewtonContestant(SCENES["top"], PEERS["mujoco"])
    assert math.isnan(contestant.replayed(0.01))


def test_bodies_move_alike_in_mujoco_and_on_a_straight_line() -> None:
    contestant = MujocoContestant(SCENES["free_bodies"])
    model = contestant.model
    assert np.allclose(contestant.observe().body_q.numpy(), model.body_q.numpy(), atol=1e-6)
    assert np.allclose(contestant.observe().body_qd.numpy(), model.body_qd.numpy(), atol=1e-6)
    quality = contestant.run(seconds=0.1, budget=60.0)
    # MuJoCo computes in double precision; what is left is the rounding of observed poses, 8 m
    # from the origin. Explicit Euler keeps angular momentum to first order in the step.
    assert quality.drift < 1e-6
    assert quality.momentum is not None and 0.0 < quality.momentum < 0.05


def test_boxes_stand_in_mujoco() -> None:
    quality = MujocoContestant(SCENES["stack"]).run(seconds=1.0, budget=60.0)
    # MuJoCo's contacts are soft by default, of the order of half a millimeter here.
    assert 1e-5 < quality.penetration < 5e-3
    assert quality.contacts == 80


def test_first_step_is_timed_in_a_process_of_its_own() -> None:
    # With the kernel cache of this process, so that nothing is compiled.
    wp.init()
    cache = Path(wp.config.kernel_cache_dir).parent
    assert coldstart._in_new_process("xpbd", "incline", cache) > 0.0
    assert coldstart.first_step(coldstart.NO_SOLVER, "incline") < 1e-3


def test_ctrl_c_in_a_cold_start_leaves_what_was_measured(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*details: object) -> None:
        raise KeyboardInterrupt

    measured = [Result("stack", "avbd", eager=1.0e-3)]
    monkeypatch.setattr(bench, "compete", lambda *details: measured)
    monkeypatch.setattr(coldstart, "_in_new_process", interrupt)
    out = tmp_path / "bench.json"
    assert _bench("stack", "--json", str(out)) == 130
    (result,) = json.loads(out.read_text())["results"]
    assert (result["solver"], result["eager"]) == ("avbd", 1.0e-3)
    assert "must reach" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["ant", "quadruped", "rope"])
def test_joints_move_in_bare_mujoco_as_in_newton_s_solver(name: str) -> None:
    """The same library with the same model; Newton's rounds its state to float32 in between."""
    scene = SCENES[name]
    bare, wrapped = MujocoContestant(scene), NewtonContestant(scene, PEERS["mujoco"])
    start = bare.model.state()
    assert np.allclose(bare.observe().body_q.numpy(), start.body_q.numpy(), atol=5e-6)
    for contestant in (bare, wrapped):
        for _ in range(48):
            contestant.advance()
    velocity = [contestant.observe().body_qd.numpy() for contestant in (bare, wrapped)]
    assert np.abs(velocity[0]).max() > 0.1
    assert np.allclose(bare.centers(), wrapped.centers(), atol=1e-4)
    assert np.allclose(*velocity, atol=1e-2)


def test_run_of_a_chain_tells_of_its_joints() -> None:
    quality = NewtonContestant(SCENES["chain"], PEERS["mujoco"]).run(seconds=0.1, budget=60.0)
    joints = quality.joints
    assert joints is not None and quality.value("separation") == joints.separation
    # In joint coordinates nothing opens but by rounding.
    assert joints.separation < 2e-6 and joints.misalignment < 1e-6 and joints.limit == 0.0
    # Let go 4 m up, its 20 kg gain nothing and lose next to nothing in a tenth of a second.
    assert joints.energy == pytest.approx(20.0 * 9.81 * 4.0, rel=1e-2)
    assert joints.gain < 1e-2


def test_run_of_free_bodies_has_no_joints() -> None:
    quality = NewtonContestant(SCENES["top"], PEERS["mujoco"]).run(seconds=0.02, budget=60.0)
    assert quality.joints is None and quality.value("separation") is None


def test_solver_that_gave_up_has_no_quality(monkeypatch: pytest.MonkeyPatch) -> None:
    contestant = NewtonContestant(SCENES["chain"], PEERS["mujoco"])
    monkeypatch.setattr(NewtonContestant, "gave_up", lambda self: True)
    quality = contestant.run(seconds=0.02, budget=60.0)
    for quantity in ("separation", "limit", "gain", "speed", "penetration"):
        value = quality.value(quantity)
        assert value is not None and math.isnan(value)


def test_worlds_are_compared_with_one_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    benchmark = bench.BENCHMARKS["ant_worlds"]
    monkeypatch.setattr("newton_avbd.scenes.robots.WORLDS", 4)
    short = dataclasses.replace(benchmark, seconds=0.05)
    (result,) = bench.compete(short, ["mj_step"], bench.QUICK)
    assert result.quality is not None and result.quality.apart == 0.0


def test_larger_step_is_a_benchmark_of_its_own() -> None:
    benchmark = bench.BENCHMARKS["ant_60hz"]
    assert benchmark.contestant("mujoco").scene.dt == pytest.approx(1.0 / 60.0)
    assert bench.BENCHMARKS["ant"].contestant("mujoco").scene.dt == pytest.approx(1.0 / 240.0)


def test_every_target_is_on_something_that_is_measured() -> None:
    names = {*bench.BENCHMARKS, bench.COLD_START}
    quantities = {
        field.name for kind in (Result, Quality, JointQuality) for field in dataclasses.fields(kind)
    }
    for target in TARGETS:
        assert target.scene in names and target.quantity in quantities
        if target.against in (*PEERS, bench.MJ_STEP) and target.scene != bench.COLD_START:
            assert target.against in bench.BENCHMARKS[target.scene].solvers


REST = Quality(2.0, 80, 1e-5, 1e-4, 1e-6, None)
SWING = dataclasses.replace(REST, joints=JointQuality(separation=2e-5, energy=49.0))
RESULTS = [
    Result("stack", "avbd", eager=1e-4, replayed=2e-5, quality=REST),
    Result("stack", "vbd", eager=2e-3, replayed=3e-4),
    Result("stack", "xpbd", eager=1e-3, replayed=1e-4),
    Result("stack", "mj_step", replayed=5e-5),
    Result("stack", "semi_implicit", replayed=1e-6),
    Result("rope", "avbd", replayed=1e-5, quality=SWING),
    Result("rope", "vbd", replayed=1e-4),
]


@pytest.mark.parametrize(
    ("target", "reached"),
    [
        (Target("stack", "eager", 1.0, "vbd"), 1 / 20),
        # The explicit penalty solvers are no peers.
        (Target("stack", "replayed", 1.0, EVERY_PEER), 2 / 5),
        (Target("stack", "replayed", 1.0, NEWTON_PEER), 1 / 5),
        (Target("rope", "replayed", 1.0, NEWTON_PEER), 1 / 10),
        (Target("rope", "separation", 1.0), 2e-5),
        (Target("stack", "separation", 1.0), None),
        (Target("stack", "penetration", 1.0), 1e-5),
        (Target("stack", "momentum", 1.0), None),
        (Target("stack", "eager", 1.0, "mj_step"), None),
        (Target("pyramid", "eager", 1.0, "vbd"), None),
    ],
)
def test_target_compares_with_what_was_measured(target: Target, reached: float | None) -> None:
    assert target.reached(RESULTS) == (None if reached is None else pytest.approx(reached))


def test_exploded_run_meets_no_target() -> None:
    quality = Quality(2.0, 80, math.nan, math.nan, math.nan, None)
    reached = Target("stack", "drift", 1.0).reached([Result("stack", "avbd", quality=quality)])
    assert reached is not None and not reached <= 1.0
