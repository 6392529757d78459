# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Nothing creeps, heats up or piles up in 20,000 steps; docs/stability.md has the million."""

import argparse
import dataclasses
import math

import pytest

from newton_avbd.commands import stability
from newton_avbd.io import UserError
from newton_avbd.study.long_run import LONG_RUNS, LongRun, run_long


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


def command(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    stability.add_arguments(parser)
    return stability.main(parser.parse_args(arguments))


def test_the_command_prints_a_line_a_scene(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("--long", "240", "--device", "cpu") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines] == [[name, "ok"] for name in LONG_RUNS]
    with pytest.raises(UserError, match="no case 'stack'; there are: resting_pile"):
        command("stack", "--long", "240")
