# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd accuracy``: what accuracy costs in time, for SolverAVBD and its peers."""

import argparse
import contextlib
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

from newton_avbd.io.errors import UserError, require
from newton_avbd.io.opening import read_scene
from newton_avbd.study.accuracy import ask as accuracy_ask
from newton_avbd.study.accuracy import control as accuracy_control
from newton_avbd.study.accuracy import page as accuracy_page
from newton_avbd.study.accuracy.front import OURS
from newton_avbd.study.accuracy.results import ASK, FULL, QUICK, QUICK_SCENES, Results, run
from newton_avbd.study.accuracy.run import Point
from newton_avbd.study.accuracy.scenes import ACCURACY_SCENES
from newton_avbd.study.accuracy.solvers import MEASURED
from newton_avbd.study.bench.run import chosen, describe_machine, pinned
from newton_avbd.study.mujoco.native import silence

from ..io.options import check_writable, make_folder
from ..io.output import length, table, tables_beside, write_json, writing
from ..io.terminal import (
    gathered_prints,
    gathered_warnings,
    interruptible,
    progress,
    say,
    say_notes,
)

REFERENCE_BUDGET = 25.0
"""Processor time in which the motion of a scene of the user's is found out [s]."""


def catalog() -> dict[str, dict[str, str]]:
    """The scenes that are measured, and what they are."""
    return {"scenes": {name: scene.summary for name, scene in ACCURACY_SCENES.items()}}


def main(args: argparse.Namespace) -> int:
    """Measure, print a line for each setting and tables at the end, write the page.

    Returns:
        Exit status: 0, or 130 after Ctrl-C.

    Raises:
        UserError: A scene or a solver does not exist, the folder cannot be written, or it holds
            results of another machine.
    """
    if args.output:
        require("matplotlib")
    if args.ask is not None:
        return _ask(args)
    if args.control:
        return _control(args)
    if args.json:
        raise UserError("--json goes with --ask; without it --output writes all numbers")
    require("scipy")
    default = list(QUICK_SCENES) if args.quick else []
    names = chosen("accuracy scene", args.scenes or default, tuple(ACCURACY_SCENES))
    solvers = chosen("solver", args.solvers or [], tuple(MEASURED))
    scenes = [ACCURACY_SCENES[name] for name in names]
    silence()
    make_folder(args.output)
    with writing(args.output) if args.output else contextlib.nullcontext():
        with pinned() as core:
            machine = describe_machine(core)
            results = Results(machine, QUICK if args.quick else FULL, args.output)
            points = []
            with interruptible() as interruption:
                for point in progress(run(scenes, solvers, results), None, "settings"):
                    say(accuracy_page.line(point))
                    points.append(point)
        print(f"\n{accuracy_page.summary(scenes, points)}")
        if args.output:
            for scene in scenes:
                file = args.output / f"{scene.name}.svg"
                accuracy_page.write_plot(scene, results.of(scene.name), file)
            text = accuracy_page.page(machine, results.effort.name, scenes, points)
            (args.output / "results.md").write_text(text)
            print(f"wrote {args.output / 'results.md'}", file=sys.stderr)
    return interruption.status(0)


def _control(args: argparse.Namespace) -> int:
    """Error asked for against error achieved; returns the exit status."""
    require("scipy")
    names = chosen("scene", args.scenes, tuple(accuracy_control.CONTROL_SCENES))
    silence()
    make_folder(args.output)
    found: list[accuracy_control.Outcome] = []
    with gathered_prints(), gathered_warnings(), pinned():
        with interruptible() as interruption:
            for outcome in progress(accuracy_control.outcomes(names), None, "accuracies"):
                found.append(outcome)
    if found:
        text = f"{accuracy_control.table(found)}\n\n{accuracy_control.verdict(found)}\n"
        print(text)
        if args.output:
            file = args.output / "control.json"
            with writing(args.output):
                file.write_text(json.dumps([dataclasses.asdict(one) for one in found], indent=1))
            print(f"wrote {file}", file=sys.stderr)
    return interruption.status(0)


def _ask(args: argparse.Namespace) -> int:
    """Answer for a scene of the user's; returns the exit status."""
    if args.scenes:
        raise UserError(
            f"--ask takes one scene, and {', '.join(args.scenes)} besides: leave it out"
        )
    check_writable(args.json)
    solvers = chosen("solver", args.solvers or list(accuracy_ask.SOLVERS), tuple(MEASURED))
    silence()
    make_folder(args.output)
    with gathered_prints(), gathered_warnings(), pinned() as core:
        scene, notes = read_scene(args.ask)
        say_notes(notes)
        points: list[Point] = []
        question = None
        with interruptible() as interruption:
            for _ in progress([scene.name], 1, "how it moves"):
                question = accuracy_ask.ask(scene, budget=REFERENCE_BUDGET)
            if question is not None and question.is_determined:
                results = Results(describe_machine(core), ASK, None)
                for point in progress(run([question.scene], solvers, results), None, "settings"):
                    points.append(point)
    if question is None:
        return interruption.status(0)
    prices = accuracy_ask.prices(question, points)
    with tables_beside(args.json):
        print(_answer(question, prices, points))
    if args.json:
        write_json(args.json, _as_json(question, prices, points))
    if args.output and points:
        file = args.output / f"{Path(scene.name).stem}.svg"
        with writing(args.output):
            accuracy_page.write_plot(question.scene, points, file)
        print(f"wrote {file}", file=sys.stderr)
    return interruption.status(0)


def _answer(
    question: accuracy_ask.Question, prices: list[accuracy_ask.Price], points: list[Point]
) -> str:
    """What each accuracy costs, as text."""
    scene, reference = question.scene, question.reference
    if not question.is_determined:
        return (
            f"{scene.name}: its motion is not determined. Runs with {reference.substeps // 2} and "
            f"{reference.substeps} steps a frame part by more than "
            f"{length(accuracy_ask.CERTAIN)} within {accuracy_ask.FEWEST} frames, so nobody can "
            "say how far off a solver is. Compare energy and momentum: newton-avbd compare "
            f"{scene.name}"
        )
    parts = [_reference(question)]
    solvers = [name for name in MEASURED if any(p.solver == name and p.cost for p in points)]
    rows = [["off by at most", *(MEASURED[name].title for name in solvers)]]
    for price in prices:
        cells = [price.cheapest.get(name) for name in solvers]
        rows.append([length(price.accuracy), *(_price(point) for point in cells)])
    parts.append(
        "ms of computing for a simulated second (steps a second, iterations, scheme), replayed:\n"
        + table(rows)
    )
    lines = {price.line: price.accuracy for price in prices if price.line}
    if lines:
        pasted = [[length(accuracy), line] for line, accuracy in lines.items()]
        parts.append("to paste:\n" + "\n".join(f"{a.rjust(8)}  {line}" for a, line in pasted))
    failed = {p.solver: p.note for p in points if p.error is None and p.note}
    for name, note in failed.items():
        if not any(p.solver == name and p.error is not None for p in points):
            parts.append(f"{MEASURED[name].title} is left out: {note}")
    return "\n\n".join(parts)


def _reference(question: accuracy_ask.Question) -> str:
    """What is asked about, and how its motion is known."""
    scene, reference = question.scene, question.reference
    way = length(reference.way[scene.frames])
    text = (
        f"{scene.name}: {question.bodies} bodies in their first {scene.seconds:.3g} s, in which a "
        f"point goes {way}. Reference: {MEASURED[reference.solver].title} refined to "
        f"{reference.substeps} steps a frame, known to {length(question.bar)}."
    )
    if scene.frames < question.frames:
        text += (
            f" What comes later is not determined: after {question.frames / 60:.3g} s two fine "
            f"runs are {length(reference.bar[question.frames])} apart."
        )
    if question.apart is not None and reference.solver == OURS:
        text += (
            f" mj_step converges to another motion, {length(question.apart)} away: its limits and "
            "its friction in joints are soft."
        )
    elif question.apart is not None:
        text += f" SolverAVBD refined ends {length(question.apart)} from it."
    elif scene.touching:
        text += " Solvers whose contacts or joint limits are soft converge to another motion."
    return text


def _price(point: Point | None) -> str:
    """Cost and setting of a point; nothing where there is none."""
    if point is None:
        return "-"
    setting = point.setting
    given = [f"{round(60 * setting.substeps)} Hz"]
    given += [] if setting.iterations is None else [f"{setting.iterations} it"]
    given += [] if setting.scheme is None else [setting.scheme]
    return f"{point.cost:.3g} ({', '.join(given)})"


def _as_json(
    question: accuracy_ask.Question, prices: list[accuracy_ask.Price], points: list[Point]
) -> dict[str, Any]:
    """All numbers: lengths [m], costs [ms] of a simulated second."""
    reference = question.reference
    return {
        "scene": question.scene.name,
        "bodies": question.bodies,
        "seconds": question.scene.seconds,
        "is_determined": question.is_determined,
        "way": float(reference.way[question.scene.frames]),
        "reference": {
            "solver": reference.solver,
            "substeps": reference.substeps,
            "bar": reference.bar.tolist(),
            "apart": question.apart,
        },
        "prices": [{**dataclasses.asdict(price), "line": price.line} for price in prices],
        "points": [dataclasses.asdict(point) for point in points],
    }
