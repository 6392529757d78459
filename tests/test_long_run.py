# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Nothing creeps, heats up or piles up in 20,000 steps; docs/stability.md has the million."""

import dataclasses
import math
from collections.abc import Iterator

import pytest

from newton_avbd.__main__ import main
from newton_avbd.commands import stability
from newton_avbd.study.stability.long_run import IN_GRAPH, LONG_RUNS, LongRun, run_long

pytestmark = pytest.mark.long


def test_a_resting_pile_rests() -> None:
    """To the rounding of its poses, of at most 1 m; with the same contacts all the time."""
    run = run_long("resting_pile", 20_000)
    assert run.failures() == []
    assert run.drift < 2.0**-23
    assert run.energy < 2.0**-23
    assert run.speed < 1e-8
    assert run.contacts[0] == run.contacts[1] > 40


def test_a_driven_four_bar_goes_the_same_way_in_every_period() -> None:
    """To what its joints may be open: 1e-5 m, a hundredth of what counts as open."""
    run = run_long("driven_four_bar", 20_000)
    assert run.failures() == []
    assert run.drift < 1e-5
    assert run.separation < 1e-5
    assert run.speed > 0.5  # it moves


def test_what_creeps_or_grows_fails() -> None:
    good = LongRun(
        steps=120,
        drift=0.0,
        final_drift=0.0,
        speed=0.0,
        energy=0.0,
        separation=0.0,
        penetration=0.0,
        contacts=(4, 4),
        memory=0,
        held=0,
        microseconds=1.0,
    )
    assert good.failures() == []
    for name, bad in (
        ("drift", 1e-3),
        ("drift", math.nan),
        ("energy", 1e-3),
        ("memory", 2**24),
        ("held", 1),
        ("contacts", (4, 5)),
    ):
        assert dataclasses.replace(good, **{name: bad}).failures() == [name]


def test_the_command_prints_a_line_a_scene(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["stability", "--long", "240", "--device", "cpu"]
    assert main(command) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines] == [[name, "ok"] for name in LONG_RUNS]
    assert main([*command, "stack"]) == 2
    assert "no case 'stack'; there are: resting_pile" in capsys.readouterr().err


def test_ctrl_c_leaves_the_steps_until_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(items: range, *about: object) -> Iterator[int]:
        yield from items[:2]
        raise KeyboardInterrupt

    monkeypatch.setattr(stability, "progress", interrupted)
    assert main(["stability", "resting_pile", "--long", "1000000", "--device", "cpu"]) == 130
    printed = capsys.readouterr()
    assert printed.out.split()[:4] == ["resting_pile", "ok", str(2 * IN_GRAPH), "steps"]
    assert "stopped by Ctrl-C" in printed.err
