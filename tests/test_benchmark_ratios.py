# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The check of ratios tells a regression from noise."""

import importlib
import json
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture
def check(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """The module, with a baseline of its own."""
    monkeypatch.syspath_prepend(ROOT)
    module = importlib.import_module("benchmarks.check")
    monkeypatch.setattr(module, "BASELINE", tmp_path / "baseline.json")
    module.BASELINE.write_text(json.dumps({"ratios": {"pyramid": 0.2, "stack": 0.5}}))
    return module


def measure(monkeypatch: pytest.MonkeyPatch, check: ModuleType, ratios: Iterator[float]) -> None:
    """Let measurements give these ratios, one after the other."""
    monkeypatch.setattr(check, "ratio", lambda scene: next(ratios))


def test_what_is_slower_each_time_fails(
    check: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # By 25, 20 and 15 %, and then the next scene by 9 %.
    measure(monkeypatch, check, iter([0.25, 0.24, 0.23, 0.545]))
    assert check.main(["pyramid", "stack"]) == 1
    assert "slower by more than 10% than the baseline: pyramid\n" in capsys.readouterr().out


def test_a_baseline_of_another_processor_is_called_one(
    check: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = {"machine": {"processor": "Z80"}, "ratios": {"pyramid": 0.2}}
    check.BASELINE.write_text(json.dumps(machine))
    measure(monkeypatch, check, iter([0.2]))
    assert check.main(["pyramid"]) == 0
    assert "of another processor (Z80; here " in capsys.readouterr().out


def test_noise_passes(check: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    measure(monkeypatch, check, iter([0.25, 0.21]))
    assert check.main(["pyramid"]) == 0


def test_the_baseline_is_what_was_measured(
    check: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure(monkeypatch, check, iter([0.9, 0.3, 0.4]))  # the median
    assert check.main(["--write", "stack"]) == 0
    assert json.loads(check.BASELINE.read_text())["ratios"] == {"pyramid": 0.2, "stack": 0.4}


def test_the_stored_baseline_is_of_the_scenes(check: ModuleType) -> None:
    stored = json.loads((ROOT / "benchmarks" / "baseline.json").read_text())
    assert list(stored["ratios"]) == check.SCENES


def test_ctrl_c_leaves_the_scenes_that_were_measured(
    check: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The baseline gets the first scene, and keeps what it had of the one that was cut short."""
    ratios = iter([0.3, 0.3, 0.3])

    def ratio(scene: str) -> float:
        if scene == "stack":
            raise KeyboardInterrupt
        return next(ratios)

    monkeypatch.setattr(check, "ratio", ratio)
    assert check.main(["pyramid", "stack", "--write"]) == 130
    assert json.loads(check.BASELINE.read_text())["ratios"] == {"pyramid": 0.3, "stack": 0.5}
    assert "stopped by Ctrl-C" in capsys.readouterr().err
