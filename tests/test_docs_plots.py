# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The menus of the interactive plots show what they name, and all of it."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("plotly")
pytest.importorskip("sphinx")

DOCS = Path(__file__).parent.parent / "docs"
sys.path.append(str(DOCS))

import plots  # noqa: E402

from newton_avbd.study.accuracy.scenes import ACCURACY_SCENES  # noqa: E402
from newton_avbd.study.bench.growth import QUANTITIES  # noqa: E402


def menu_of(name: str) -> tuple[Any, dict[str, list[Any]], dict[str, str]]:
    """A plot; for each entry of its menu the traces that it shows, and the title."""
    figure = plots.PLOTS[name]()
    (menu,) = figure.layout.updatemenus
    shown, titles = {}, {}
    for button in menu.buttons:
        traces, layout = button.args
        assert len(traces["visible"]) == len(figure.data), button.label
        shown[button.label] = [
            trace
            for trace, visible in zip(figure.data, traces["visible"], strict=True)
            if visible is True
        ]
        titles[button.label] = layout["title.text"]
    return figure, shown, titles


@pytest.mark.parametrize("name", plots.PLOTS)
def test_a_menu_shows_each_trace_once_and_starts_with_its_first_entry(name: str) -> None:
    figure, shown, titles = menu_of(name)
    first = next(iter(shown))
    assert [trace for trace in figure.data if trace.visible is True] == shown[first]
    assert figure.layout.title.text == titles[first]
    assert sum(len(traces) for traces in shown.values()) == len(figure.data)
    assert all(any(trace.x for trace in traces) for traces in shown.values())


def test_a_scene_shows_its_measured_settings_and_no_others() -> None:
    _, shown, titles = menu_of("accuracy")
    assert list(shown) == [
        scene for scene in ACCURACY_SCENES if (DOCS / "accuracy" / f"{scene}.json").exists()
    ]
    for scene, traces in shown.items():
        stored = json.loads((DOCS / "accuracy" / f"{scene}.json").read_text())["points"]
        measured = {(point["cost"], point["error"]) for point in stored}
        marks = [trace for trace in traces if trace.mode == "markers"]
        drawn = [pair for trace in marks for pair in zip(trace.x, trace.y, strict=True)]
        assert len(drawn) > 10 and set(drawn) <= measured
        for best, every in zip((t for t in traces if t.mode == "lines"), marks, strict=True):
            assert best.name == every.name
            # the best error of a solver is on its line
            assert min(best.y, default=None) == min(every.y, default=None)
        assert titles[scene] == ACCURACY_SCENES[scene].summary


def test_a_quantity_shows_its_numbers_of_every_scene() -> None:
    _, shown, titles = menu_of("growth")
    points = json.loads((DOCS / "growth" / "growth.json").read_text())["points"]
    assert titles == QUANTITIES
    for quantity, traces in shown.items():
        assert {trace.name for trace in traces} == {point["family"] for point in points}
        for trace in traces:
            own = [point for point in points if point["family"] == trace.name]
            assert list(trace.x) == [point["bodies"] for point in own]
            assert list(trace.y) == [point[quantity] for point in own]
