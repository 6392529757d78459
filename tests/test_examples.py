# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The example scripts run as their docstrings say and meet their own criteria."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: script.stem)
def test_an_example_meets_its_own_criteria(script: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """60 frames without a window, judged by the example's test_post_step and test_final.

    In this process: it shares the kernels of other tests.
    """
    arguments = ["--viewer", "null", "--num-frames", "60", "--test", "--device", "cpu"]
    monkeypatch.setattr(sys, "argv", [str(script), *arguments])
    runpy.run_path(str(script), run_name="__main__")


def test_there_are_examples() -> None:
    """Otherwise the test above tests nothing."""
    assert len(EXAMPLES) >= 2
