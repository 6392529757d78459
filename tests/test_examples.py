# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The example scripts run as their docstrings say and meet their own criteria.

Newton's, too, with its solver swapped: with ``NEWTON_EXAMPLES=all``, for they take half an hour.
"""

import ast
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import newton
import newton.utils
import pytest

from newton_avbd.io.examples import FRAMES, ExampleSimulation
from newton_avbd.io.simulation import Request

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
NEWTON_EXAMPLES = re.findall(
    r"^\| `(\w+)` \| \w+ \| passes \|", (ROOT / "docs" / "examples.md").read_text(), re.MULTILINE
)
"""Those of the table in the documents."""
OPTIONS = {
    "pyramid": ["--", "--num-pyramids", "3", "--pyramid-size", "5"],
    "robot_omniwheel": ["--iterations", "60"],
    "kamino_earworm_flowers": ["--", "--world-count", "2"],
}
"""What some are called with, as the table says; the last to save time."""


def asset_folder(name: str) -> Path:
    """The folder that has an asset of Newton's: ``NEWTON_ASSETS``, or Newton's own cache.

    Nothing is downloaded: tests run without a network.
    """
    given = os.environ.get("NEWTON_ASSETS")
    cache = newton.config.cache_dir_assets
    found = (
        [Path(given)] if given else [path.parent for path in Path(cache or "-").glob(f"*/{name}")]
    )
    if not any((folder / name).is_dir() for folder in found):
        pytest.skip(f"{name} is not in Newton's cache: set NEWTON_ASSETS to a folder that has it")
    return found[0]


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: script.stem)
def test_an_example_meets_its_own_criteria(script: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """60 frames without a window, judged by the example's test_post_step and test_final.

    In this process: it shares the kernels of other tests.
    """
    arguments = ["--viewer", "null", "--num-frames", "60", "--test", "--device", "cpu"]
    if script.stem == "stack_cubes":
        arguments += ["--assets", str(asset_folder("franka_emika_panda"))]
    monkeypatch.setattr(sys, "argv", [str(script), *arguments])
    runpy.run_path(str(script), run_name="__main__")


@pytest.mark.skipif(os.environ.get("NEWTON_EXAMPLES") != "all", reason="NEWTON_EXAMPLES=all")
@pytest.mark.parametrize("worlds", [1, 16])
@pytest.mark.parametrize("dt", [None, 1.0 / 300.0], ids=["own_step", "twice_the_step"])
def test_cubes_are_stacked(worlds: int, dt: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's ``ik_cube_stacking``, swapped with defaults, at half of its substeps, too."""
    folder = asset_folder("franka_emika_panda")
    monkeypatch.setattr(newton.utils, "download_asset", lambda name: folder / name)
    request = Request(dt=dt, arguments=("--world-count", str(worlds)))
    simulation = ExampleSimulation("ik_cube_stacking", request)
    for _ in range(simulation.frames):
        simulation.advance()
    assert simulation.verdict() == "passed"


def test_there_are_examples() -> None:
    """Otherwise the test above tests nothing."""
    assert len(EXAMPLES) >= 2


@pytest.mark.skipif(os.environ.get("NEWTON_EXAMPLES") != "all", reason="NEWTON_EXAMPLES=all")
@pytest.mark.parametrize("name", NEWTON_EXAMPLES)
def test_an_example_of_newton_passes_its_own_tests(name: str) -> None:
    command = [sys.executable, "-m", "newton_avbd", "run", f"newton:{name}", *OPTIONS.get(name, [])]
    # as users compile it: Newton's kernels for distance fields need adjoint functions
    places = os.environ["PYTHONPATH"].split(os.pathsep)
    kept = os.pathsep.join(place for place in places if Path(place).name != "processes")
    environment = os.environ | {"PYTHONPATH": kept}
    ran = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_a_cable_of_newton_s_swings_a_weight() -> None:
    """The shortest of its examples of tendons, with what that reads off the solver."""
    simulation = ExampleSimulation("tendon_pulley", Request())
    for _ in range(simulation.frames):
        simulation.advance()
    assert simulation.verdict() == "passed"


def test_the_documents_list_newton_s_examples() -> None:
    """All but one, which fails."""
    assert len(NEWTON_EXAMPLES) == 46


def test_examples_are_judged_no_sooner_than_by_newton() -> None:
    """Before that what they ask for need not hold, even with their native solver.

    Newton tests some in several variants: its shortest test counts.
    """
    own = Path(newton.__file__).parent / "tests" / "test_examples.py"
    tested: dict[str, list[int]] = {}
    for call in ast.walk(ast.parse(own.read_text(encoding="utf-8"))):
        if isinstance(call, ast.Call):
            title = next((ast.unparse(k.value) for k in call.keywords if k.arg == "name"), "")
            frames = re.findall(r"'num-frames': (\d+)", ast.unparse(call))
            name = title.strip("'").partition("example_")[2]
            tested.setdefault(name, []).extend(map(int, frames))
    judged = {name: min(tested[name]) for name in NEWTON_EXAMPLES if tested.get(name)}
    assert len(judged) >= 30
    sooner = {name for name, frames in judged.items() if FRAMES.get(name, 100) < frames}
    assert not sooner
