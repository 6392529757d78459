# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd robots``: let the robots of installed packages hold and move, and judge them."""

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import newton

from newton_avbd.io.converted import as_usd, can_convert, require_converters
from newton_avbd.io.errors import require
from newton_avbd.io.robots import (
    SOURCES,
    Robot,
    describe_filtered,
    find_robot,
    not_installed,
    read_robot,
    robots,
)
from newton_avbd.study.bench.run import describe_machine
from newton_avbd.study.robots.page import (
    line,
    picture,
    read_reports,
    summary,
    write_montage,
    write_page,
)
from newton_avbd.study.robots.run import Record
from newton_avbd.study.robots.trial import Report, try_robot

from ..io.options import make_folder
from ..io.output import writing
from ..io.terminal import gathered_warnings, interruptible, say_notes, show, showing
from . import view

PICTURE_SIZE = (192, 108)
"""Width and height of a robot's picture [px]."""


def main(args: argparse.Namespace) -> int:
    """Try the robots, print a line for each, write the page; 1 where one fails.

    Raises:
        UserError: There is no such robot, or the folder cannot be written.
    """
    for sentence in not_installed():
        print(f"newton-avbd: {sentence}", file=sys.stderr)
    chosen = chosen_robots(args.names)
    stem = "robots"
    if args.usd:
        require_converters()
        chosen = [robot for robot in chosen if can_convert(robot)]
        stem = "robots_usd"
    if args.output:
        require("pyglet", "PIL")
        make_folder((args.output / picture("")).parent)
    known = read_reports(args.output, stem) if args.output else {}
    reports: list[Report] = []
    with interruptible() as interruption, TemporaryDirectory() as folder:
        for number, robot in enumerate(chosen, 1):
            report = Report(robot.name, robot.package)
            shown = partial(show_trial, f"{robot.name} ({number} of {len(chosen)})")
            notes: list[str] = []
            source = partial(as_usd, robot, Path(folder)) if args.usd else lambda robot=robot: robot
            with unprinted(), gathered_warnings(), showing(f"trying {robot.name}"):
                load = partial(_load, source, notes)
                record = try_robot(report, load, shown, timed=not args.untimed)
            notes = [*dict.fromkeys(notes), *describe_filtered(robot.name, report.filtered)]
            say_notes(notes)
            if report.failures:
                report.failures += _losses(notes, robot.path.name)
            if args.output and record is not None and not args.usd:
                with silence():
                    _draw(robot, record, args.output / picture(robot.name))
            if args.untimed and robot.name in known:
                report.times = known[robot.name].times
                report.notes = known[robot.name].notes | report.notes
            print(line(report), flush=True)
            reports.append(report)
            known[robot.name] = report
            if args.output:
                # After each robot, so that a run that is interrupted loses none.
                order = [known[other.name] for other in robots() if other.name in known]
                _write(args.output, order, stem)
    if args.output and not args.usd:
        write_montage(args.output)
    print(f"\n{summary(reports)}")
    return interruption.status(int(any(report.failures for report in reports)))


def chosen_robots(names: list[str]) -> list[Robot]:
    """Robots that are called so, or are of the packages called so; all where none is named."""
    if not names:
        return list(robots())
    packages = {source.package for source in SOURCES}
    chosen: dict[str, Robot] = {}
    for name in names:
        found = [robot for robot in robots() if robot.package == name]
        for robot in found if name in packages else [find_robot(name)]:
            chosen[robot.name] = robot
    return list(chosen.values())


def _load(source: Callable[[], Robot], notes: list[str]) -> newton.ModelBuilder:
    """Import a robot; ``notes`` gets what the user should know of it."""
    robot = source()
    with showing(f"reading {robot.name}"):
        builder, found = read_robot(robot)
    notes += found
    return builder


def _losses(notes: list[str], file: str) -> list[str]:
    """Those of the notes that say what a robot goes on without, which the page has beside it; of
    several with the same remedy the first."""
    kinds: dict[str, list[str]] = {}
    for note in notes:
        if note.startswith((f"{file}:", f"{file} goes on without")):
            kinds.setdefault(note.rpartition(": ")[2], []).append(note)
    return [
        kind[0] + (f" (and {len(kind) - 1} more)" if len(kind) > 1 else "")
        for kind in kinds.values()
    ]


def _write(output: Path, reports: list[Report], stem: str) -> None:
    from newton_avbd.study.bench.run import pinned

    with pinned() as core:
        machine = describe_machine(core)
    with writing(output):
        write_page(output, reports, machine, stem)


def _draw(robot: Robot, record: Record, path: Path) -> None:
    """Draw how a robot ended, if that can be drawn."""
    if record.model is None or not record.finite:
        return
    viewer = view.make_viewer("gl", robot.name, headless=True)
    viewer.set_model(record.model)
    view.look_at(viewer, record.model, record.state)
    viewer.begin_frame(0.0)
    viewer.log_state(record.state)
    viewer.end_frame()
    view.save_picture(viewer, path, PICTURE_SIZE)
    viewer.close()


def show_trial(label: str, what: str, done: int, total: int) -> None:
    """Show on standard error how far a robot is, if that is a terminal."""
    show(f"{label}: {what} {done}/{total}")


@contextmanager
def silence() -> Iterator[None]:
    """Keep solvers' warnings off the terminal."""
    with unprinted(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def unprinted() -> Iterator[None]:
    """Keep what kernels print past Python off the terminal."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
