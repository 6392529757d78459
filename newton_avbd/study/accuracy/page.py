# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Plots of error against cost, and the tables that follow from them."""

import math
from dataclasses import replace
from pathlib import Path as File

import numpy as np

from newton_avbd.measure.state import Array
from newton_avbd.study.accuracy.front import (
    LEVELS,
    OURS,
    WITHIN,
    Verdict,
    front,
    shares,
    split,
    usable,
    verdicts,
)
from newton_avbd.study.accuracy.run import Point
from newton_avbd.study.accuracy.scene import AccuracyScene
from newton_avbd.study.accuracy.solvers import AVBD_SCHEMES, MEASURED, PRESETS, Setting

EQUAL_COST = (16, 8, 4)
"""Steps a frame, with ten iterations, at whose cost iterations and substeps are compared: the first
that a scene leaves time for."""

COLORS = {
    "avbd": "#d62728",
    "vbd": "#ff9896",
    "xpbd": "#2ca02c",
    "mj_step": "#1f77b4",
    "mujoco_warp": "#9ecae1",
    "kamino": "#8c564b",
    "featherstone": "#7f7f7f",
}
"""Colors of solvers in plots."""


def write_plot(scene: AccuracyScene, points: list[Point], file: File) -> None:
    """Draw error against cost, both logarithmic, with the Pareto front of each solver.

    Args:
        scene: The scene.
        points: What was measured on it.
        file: An SVG file to write.
    """
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": scene.name, "svg.fonttype": "none"}):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.0, 4.0), layout="constrained")
        axes = figure.subplots()
        for solver, measured in MEASURED.items():
            group = [p for p in usable(points) if p.solver == solver and p.error]
            if not group:
                continue
            color = COLORS[solver]
            axes.scatter(*_coordinates(group), s=5, color=color)
            axes.step(
                *_coordinates(front(group)),
                where="post",
                color=color,
                linewidth=2.0 if solver == OURS else 1.2,
                label=measured.title,
            )
            if solver == OURS:
                for name, preset in PRESETS.items():
                    point = _at(group, preset)
                    if point is not None:
                        axes.annotate(
                            name,
                            (point.cost, point.error),
                            xytext=(3.0, 3.0),
                            textcoords="offset points",
                            fontsize=8,
                        )
        axes.set(xscale="log", yscale="log")
        axes.set_xlabel("computing for a simulated second [ms]")
        axes.set_ylabel(scene.axis)
        axes.set_title(": ".join(filter(None, (scene.name, scene.summary))), fontsize=9)
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=8)
        figure.savefig(file, format="svg", metadata={"Date": None})


def level_table(every: list[Verdict], level: float) -> str:
    """Cost of the cheapest setting that reaches a level, by scene and solver, in Markdown."""
    found = [verdict for verdict in every if verdict.level == level]
    solvers = [name for name in MEASURED if any(name in verdict.best for verdict in found)]
    rows = [["scene", *(MEASURED[name].title for name in solvers), "ours / cheapest other"]]
    for verdict in found:
        cells = [_cell(verdict, name) for name in solvers]
        rows.append([f"`{verdict.scene}`", *cells, _ratio(verdict)])
    return _markdown(rows)


def split_table(points: list[Point]) -> str:
    """What SolverAVBD makes of equal cost: more iterations or more substeps, in Markdown."""
    rows = [["scene", "cost of", "fewer steps, more iterations", "more steps", "better"]]
    told = []
    for scheme in AVBD_SCHEMES:
        wins = {"iterations": 0, "substeps": 0}
        for scene in _scenes(points):
            ours = [p for p in points if (p.scene, p.solver) == (scene, OURS)]
            for substeps in EQUAL_COST:
                base = Setting(substeps, 10, scheme=scheme)
                found = split(ours, base)
                if found is not None:
                    break
            else:
                continue
            better = min(wins, key=lambda way: getattr(found, way).error)
            wins[better] += 1
            ways = (found.iterations, found.substeps)
            cells = [f"{p.error:.1e} ({p.setting}, {_number(p.cost)} ms)" for p in ways]
            rows.append([f"`{scene}`", str(base), *cells, better])
        told.append(
            f"With `{scheme}` substeps are better on {wins['substeps']} scenes, iterations on "
            f"{wins['iterations']}."
        )
    return f"{_markdown(rows)}\n\n{' '.join(told)}"


def preset_table(points: list[Point]) -> str:
    """Error and cost of the presets on each scene, in Markdown."""
    rows = [["scene", *(f"{name} ({preset})" for name, preset in PRESETS.items())]]
    for scene in _scenes(points):
        ours = [p for p in usable(points) if p.scene == scene and p.solver == OURS]
        found = [_at(ours, preset) for preset in PRESETS.values()]
        cells = ["-" if p is None else f"{p.error:.1e} at {_number(p.cost)} ms" for p in found]
        rows.append([f"`{scene}`", *cells])
    return _markdown(rows)


def page(
    machine: dict[str, str], effort: str, scenes: list[AccuracyScene], points: list[Point]
) -> str:
    """All results in Markdown, to stand beside the plots."""
    found = verdicts(points, {scene.name: scene.resolution for scene in scenes})
    lost = [verdict for verdict in found if verdict.ratio > 1.0]
    parts = [
        "# Accuracy and cost: results",
        "Written by `newton-avbd accuracy --output`. [What accuracy costs](../accuracy.md) says "
        f"what is measured, and how. Effort: {effort}.",
        "```\n" + "\n".join(f"{name}: {value}" for name, value in machine.items()) + "\n```",
        "## Who is cheapest",
        f"{_standing(found)} It is not the cheapest on these:",
        _markdown(
            [
                ["scene", "error", "ours / cheapest", "cheapest", "with"],
                *(
                    [
                        f"`{verdict.scene}`",
                        f"{verdict.level:.0e}",
                        _ratio(verdict),
                        MEASURED[verdict.rival.solver].title,
                        str(verdict.rival.setting),
                    ]
                    for verdict in lost
                    if verdict.rival is not None
                ),
            ]
        ),
        "## The cheapest setting for an accuracy",
        "Milliseconds of computing for a simulated second and, in brackets, the setting: steps in "
        "a frame of 1/60 s (`3x`), iterations (`10 it`), tolerance [m] (`tol`), scheme; for "
        "MuJoCo its contacts (`soft`, `stiff`) or its integrator. Empty: no setting reached the "
        "error in the time given, or the solver does not simulate what the scene is about.",
        *(f"Relative error {level:.0e}:\n\n{level_table(found, level)}" for level in LEVELS),
        "## Iterations against substeps",
        "The most accurate settings of SolverAVBD that cost at most a tenth more than the one "
        "named: with fewer steps and more iterations, and with more steps.",
        split_table(points),
        "## Presets",
        "Relative error and cost of [recommended settings]"
        "(../accuracy.md#which-settings-for-my-scene) on each scene.",
        preset_table(points),
        "## Scenes",
        *(
            f"### {scene.name}\n\n{scene.summary[0].upper()}{scene.summary[1:]}. Reference: "
            f"{scene.reference}. Error: {scene.measure}. [Numbers]({scene.name}.json).\n\n"
            f"![{scene.name}]({scene.name}.svg)"
            for scene in scenes
        ),
    ]
    return "\n\n".join(parts) + "\n"


def line(point: Point) -> str:
    """A point, for the terminal."""
    name = f"{point.scene:<14} {MEASURED[point.solver].title:<18} {point.setting!s:<22}"
    if point.error is None:
        return f"{name} {point.note}"
    eager = "" if point.eager is None else f", {_number(point.eager)} ms eager"
    return f"{name} error {point.error:.1e} at {_number(point.cost)} ms/s{eager}"


def summary(scenes: list[AccuracyScene], points: list[Point]) -> str:
    """What a terminal shows at the end."""
    found = verdicts(points, {scene.name: scene.resolution for scene in scenes})
    tables = [f"relative error {level:.0e}\n{level_table(found, level)}" for level in LEVELS]
    return "\n\n".join([*tables, _standing(found)])


def _standing(found: list[Verdict]) -> str:
    """How often we are the cheapest, in a sentence."""
    cheapest, close = shares(found)
    return (
        f"Of {len(found)} pairs of a scene and a relative error ({_levels()}) that any solver "
        f"reaches, SolverAVBD is the cheapest on {cheapest:.0%} and within {WITHIN:g}x of the "
        f"cheapest on {close:.0%}."
    )


def _coordinates(points: list[Point]) -> tuple[Array, Array]:
    """Costs and errors."""
    costs, errors = np.array([(point.cost, point.error) for point in points], dtype=float).T
    return costs, errors


def _at(points: list[Point], setting: Setting) -> Point | None:
    """The point of a setting; with the only number of iterations, where only one was tried."""
    iterations = {point.setting.iterations for point in points}
    if len(iterations) == 1:
        setting = replace(setting, iterations=iterations.pop())
    return next((point for point in points if point.setting == setting), None)


def _scenes(points: list[Point]) -> list[str]:
    """Names of the scenes of points."""
    return list(dict.fromkeys(point.scene for point in points))


def _cell(verdict: Verdict, solver: str) -> str:
    point = verdict.best.get(solver)
    if point is None:
        return ""
    text = f"{_number(point.cost)} ({point.setting})"
    return f"**{text}**" if point == min(verdict.best.values(), key=lambda p: p.cost or 0) else text


def _ratio(verdict: Verdict) -> str:
    if verdict.ratio == 0.0:
        return "no other"
    return "not reached" if math.isinf(verdict.ratio) else f"{verdict.ratio:.2g}"


def _levels() -> str:
    return ", ".join(f"{level:.0e}" for level in LEVELS)


def _number(value: float | None) -> str:
    """Three digits, or all before the point."""
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def _markdown(rows: list[list[str]]) -> str:
    """A table whose first row is its head."""
    head, *body = rows
    lines = [head, ["---"] * len(head), *body]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
