# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""``newton-avbd growth`` builds what it says, and reads powers off what it measured."""

import json
import math
from pathlib import Path

import newton
import pytest

from newton_avbd.__main__ import main
from newton_avbd.study.bench.growth import FAMILIES, Point, exponent, sizes


def test_powers_are_read_off_large_scenes() -> None:
    """Below a thousand bodies a fixed cost hides them."""
    points = [
        Point("boxes", n, 0, 4 * n, 1, 1, construction=1e-6 * n**1.5, step=1e-6 * n, memory=8)
        for n in (1000, 10000, 100000)
    ]
    small = Point("boxes", 10, 0, 40, 1, 1, construction=1.0, step=1.0, memory=8)
    found = [exponent([small, *points], name) for name in ("construction", "step", "memory")]
    assert found == pytest.approx([1.5, 1.0, 0.0])
    assert math.isnan(exponent([small, points[0]], "step"))


def test_scenes_are_of_about_the_size_asked_for() -> None:
    for family in FAMILIES.values():
        builder = newton.ModelBuilder()
        family.build(builder, 100)
        assert 90 <= builder.body_count <= 120
    assert list(sizes("net", 10**6)) == [10, 100, 1000, 10000]


def test_command_writes_numbers_and_plots(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "growth"
    command = ["growth", "boxes", "--most", "100", "--device", "cpu", "--output", str(out)]
    assert main(command) == 0
    assert "as a power of the bodies" in capsys.readouterr().out
    points = json.loads((out / "growth.json").read_text())["points"]
    # four corners of each box touch the ground, none another box
    assert [(p["bodies"], p["contacts"]) for p in points] == [(12, 48), (100, 400)]
    assert all(p["step"] > 0.0 and p["construction"] > 0.0 and p["memory"] > 0 for p in points)
    for name in ("step", "construction", "memory"):
        assert (out / f"{name}.svg").read_text().count("</svg>") == 1
    assert main(["growth", "pile"]) == 2
    assert "there is no scene that grows 'pile'; there are: boxes" in capsys.readouterr().err
