# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Measuring many settings, and keeping what was measured so that a run can go on where it ended."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path as File
from typing import Any

from newton_avbd.io.errors import UserError
from newton_avbd.study.accuracy.front import OURS
from newton_avbd.study.accuracy.run import OUT_OF_TIME, Point, Runner, measure, runner
from newton_avbd.study.accuracy.scene import AccuracyScene
from newton_avbd.study.accuracy.solvers import MEASURED, PRESETS, Setting, is_coarse


@dataclass(frozen=True)
class Effort:
    """How much time to spend.

    Attributes:
        name: What a file of results calls it.
        repeats: Runs of each setting, whose median cost counts.
        budget: Time for a solver on a scene, in which settings are tried from cheap to dear [s].
        quick: Whether only some settings are tried.
        left_out: Solvers that take too long.
    """

    name: str
    repeats: int
    budget: float
    quick: bool = False
    left_out: tuple[str, ...] = ()


FULL = Effort("full", repeats=3, budget=25.0)
QUICK = Effort("quick", repeats=1, budget=2.0, quick=True, left_out=("kamino", "mujoco_warp"))
ASK = Effort("ask", repeats=1, budget=12.0)

COARSE_SHARE = 0.7
"""Share of the budget that the coarse grid of settings may take."""

QUICK_SCENES = ("projectile", "pendulum_2", "sliding", "tipping", "stack", "rolling_y")
"""Scenes of a quick run where none is named."""


class Results:
    """Points by what was measured, one file a scene, written after each point.

    Attributes:
        machine: Description of the machine, by name.
        effort: The effort.
    """

    def __init__(self, machine: dict[str, str], effort: Effort, folder: File | None):
        """Keep results in a folder, or nowhere.

        Args:
            machine: Description of the machine; the processor must be that of what is there.
            effort: The effort, which likewise must be the same.
            folder: The folder; read scene by scene.
        """
        self.machine = machine
        self.effort = effort
        self._folder = folder
        self._points: dict[str, dict[tuple[str, str, Setting], Point]] = {}

    def of(self, scene: str) -> list[Point]:
        """Points of a scene, also those of earlier runs.

        Raises:
            UserError: They were measured on another machine or with another effort.
        """
        if scene not in self._points:
            self._points[scene] = {point.key: point for point in self._read(scene)}
        return list(self._points[scene].values())

    def get(self, key: tuple[str, str, Setting]) -> Point | None:
        """A point, if it was measured."""
        self.of(key[0])
        return self._points[key[0]].get(key)

    def add(self, point: Point) -> None:
        """Keep a point."""
        self.of(point.scene)
        self._points[point.scene][point.key] = point
        if self._folder is None:
            return
        points = ",\n".join(json.dumps(asdict(known)) for known in self.of(point.scene))
        text = (
            f'{{\n"machine": {json.dumps(self.machine)},\n"effort": "{self.effort.name}",\n'
            f'"points": [\n{points}\n]\n}}\n'
        )
        file = self._file(point.scene)
        # Written aside first: an interrupted run leaves a whole file behind.
        aside = file.with_suffix(".part")
        aside.write_text(text)
        aside.replace(file)

    def _file(self, scene: str) -> File:
        assert self._folder is not None
        return self._folder / f"{scene}.json"

    def _read(self, scene: str) -> list[Point]:
        if self._folder is None or not self._file(scene).exists():
            return []
        data = json.loads(self._file(scene).read_text())
        here = (self.machine["processor"], self.effort.name)
        there = (data["machine"]["processor"], data["effort"])
        if here != there:
            raise UserError(
                f"{self._file(scene)} holds results of {' with effort '.join(there)}, not of "
                f"{' with effort '.join(here)}; give another --output, or remove it"
            )
        return [_point(entry) for entry in data["points"]]


def _point(entry: dict[str, Any]) -> Point:
    """A point from what JSON holds of it."""
    return Point(**{**entry, "setting": Setting(**entry["setting"])})


def run(
    scenes: Iterable[AccuracyScene], solvers: tuple[str, ...], results: Results
) -> Iterator[Point]:
    """Measure what has not been measured yet.

    Args:
        scenes: Scenes.
        solvers: Names of solvers; those to which a scene means nothing are left out of it.
        results: What is known, to which points are added.

    Yields:
        The points, known ones too.
    """
    effort = results.effort
    for scene in scenes:
        for solver in solvers:
            if solver in scene.solvers and solver not in effort.left_out:
                yield from _try_settings(scene, solver, results)


def _try_settings(scene: AccuracyScene, solver: str, results: Results) -> Iterator[Point]:
    """Try the settings of a solver on a scene, until there is no time left; presets in any case."""
    effort, spent = results.effort, 0.0
    whole = scene.patience * effort.budget
    over = {True: False, False: False}
    worker: Runner | None = None
    settings = MEASURED[solver].settings(
        touching=scene.touching, sweeps=scene.sweeps, quick=effort.quick
    )
    share = 1.0 if all(map(is_coarse, settings)) else COARSE_SHARE
    for setting in settings:
        is_preset = solver == OURS and setting in PRESETS.values()
        is_first = is_coarse(setting)
        if over[is_first] and not is_preset:
            continue
        budget = whole * (share if is_first else 1.0)
        point = results.get((scene.name, solver, setting))
        if point is None:
            try:
                worker = worker or runner(scene, solver)
            except Exception as error:
                # what one solver cannot read the others may
                yield Point(scene.name, solver, setting, note=f"{type(error).__name__}: {error}")
                return
            left = whole if is_preset else budget - spent
            point = measure(worker, solver, setting, repeats=effort.repeats, budget=left)
            results.add(point)
        yield point
        spent += point.spent
        # A setting that fails for another reason than time says nothing of the next one.
        over[is_first] = over[is_first] or spent >= budget or point.note == OUT_OF_TIME
