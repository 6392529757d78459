# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd falls``: drop, spin and throw robots, and say whether energy appears."""

import argparse
import json
import sys
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import newton

from newton_avbd.io.assets import read_asset
from newton_avbd.io.errors import UserError
from newton_avbd.io.names import SUFFIXES
from newton_avbd.io.robots import find_robot, not_installed, read_robot
from newton_avbd.study.falls.kinds import KINDS
from newton_avbd.study.falls.run import Fall, Setup, run_falls
from newton_avbd.study.falls.scene import bare, starts

from ..io.options import make_folder
from ..io.output import length, table, writing
from ..io.terminal import interruptible, show, showing
from .robots import chosen_robots, show_trial, silence

HEAD = (
    "",
    "kind",
    "solver",
    "falls",
    "fail",
    "gain",
    "above",
    "speed",
    "joint",
    "limit",
    "bounded",
)


def main(args: argparse.Namespace) -> int:
    """Run the falls, print a table; 1 where a fall with SolverAVBD fails, 130 after Ctrl-C."""
    setups = [
        Setup(solver, args.dt, args.seconds, args.iterations, args.scheme, args.parallel)
        for solver in args.solvers
    ]
    if args.replay:
        return _replay(args.replay)
    make_folder(args.output)
    for sentence in not_installed():
        print(f"newton-avbd: {sentence}", file=sys.stderr)
    rows: list[tuple[str, ...]] = [HEAD]
    failed = False
    names = _names(args.names)
    with interruptible() as interruption:
        for number, name in enumerate(names, 1):
            label = f"{name} ({number} of {len(names)})"
            try:
                builder = load(name)
                with silence():
                    chosen = starts(builder, tuple(args.kinds), args.seeds)
            except UserError as error:
                print(f"newton-avbd: {name} is left out: {error}", file=sys.stderr)
                continue
            for setup in setups:
                try:
                    with silence():
                        shown = partial(show_trial, label, setup.solver)
                        falls = run_falls(name, builder, chosen, setup, shown)
                except Exception as error:  # solvers refuse in as many ways as there are solvers
                    show("")
                    print(
                        f"newton-avbd: {name} is left out: {setup.solver}: {error}", file=sys.stderr
                    )
                    continue
                show("")
                new = _rows(name, setup.solver, falls)
                print(table([HEAD, *new] if len(rows) == 1 else new), flush=True)
                rows += new
                for fall in falls:
                    if fall.failures() and setup.solver == "avbd":
                        failed = True
                        _save(args.output, fall, setup, args)
    if len(rows) > 1:
        print(f"\n{table(rows)}")
    return interruption.status(int(failed))


def load(name: str) -> newton.ModelBuilder:
    """A robot by its name, or of a file, without what does work.

    Raises:
        UserError: There is no such robot or file, or it cannot be read.
    """
    with silence(), showing(f"reading {name}"):
        if _is_file(name):
            builder, _ = read_asset(Path(name), "avbd", floating=True, light_links=False)
        else:
            builder, _ = read_robot(replace(find_robot(name), bolted=False), light_links=False)
        if builder.body_count == 0:
            raise UserError(f"{name} holds no rigid bodies")
        return bare(builder)


def _names(wanted: list[str]) -> list[str]:
    files = [name for name in wanted if _is_file(name)]
    others = [name for name in wanted if not _is_file(name)]
    return files + [robot.name for robot in (chosen_robots(others) if others or not files else [])]


def _is_file(name: str) -> bool:
    return name.endswith(SUFFIXES) and Path(name).is_file()


def _rows(name: str, solver: str, falls: list[Fall]) -> list[tuple[str, ...]]:
    """A row for each kind: the worst of its falls."""
    rows: list[tuple[str, ...]] = []
    for kind in KINDS:
        same = [fall for fall in falls if fall.start.kind == kind]
        if same:
            fast = max(same, key=lambda fall: fall.speed / max(fall.free, 1e-9))
            rows.append(
                (
                    name,
                    kind,
                    solver,
                    f"{len(same)}",
                    f"{sum(bool(fall.failures()) for fall in same)}",
                    f"{max(fall.gain for fall in same):.2g}",
                    f"{max(fall.above for fall in same):.2g}",
                    f"{fast.speed:.3g} m/s {fast.speed / max(fast.free, 1e-9):.2f}",
                    length(max(fall.separation for fall in same)),
                    f"{max(fall.limit for fall in same):.2g}",
                    f"{sum(fall.bounded for fall in same)}",
                )
            )
    return rows


def _save(folder: Path | None, fall: Fall, setup: Setup, args: argparse.Namespace) -> None:
    """Say which fall fails, and write what reproduces it.

    Contacts come in another order in other batches, so that the batch is part of it.
    """
    batch = {"kinds": args.kinds, "seeds": [args.seeds.start, args.seeds.stop]}
    entry = {"setup": asdict(setup), "batch": batch, **asdict(fall)}
    what = f"{fall.robot}, {fall.start.kind}, seed {fall.start.seed}: {', '.join(fall.failures())}"
    what += f" (gain {fall.gain:.2g}, {fall.jump:.2g} in step {fall.step})"
    if folder is None:
        print(f"  {what}", flush=True)
        return
    name = Path(fall.robot).stem if _is_file(fall.robot) else fall.robot.replace("/", "_")
    path = folder / f"{name}-{fall.start.kind}-{fall.start.seed}.json"
    with writing(folder):
        path.write_text(json.dumps(entry, indent=1) + "\n")
    print(f"  {what}; newton-avbd falls --replay {path}", flush=True)


def _replay(path: Path) -> int:
    """Repeat a fall that was saved, and print it; 1 where it fails."""
    try:
        entry = json.loads(path.read_text())
        setup, name = Setup(**entry["setup"]), entry["robot"]
        kinds, seeds = tuple(entry["batch"]["kinds"]), range(*entry["batch"]["seeds"])
        which = entry["start"]["kind"], entry["start"]["seed"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"cannot read a fall from {path}: {error}") from error
    with silence():
        builder = load(name)
        chosen = starts(builder, kinds, seeds)
        falls = run_falls(name, builder, chosen, setup, partial(show_trial, name, setup.solver))
    show("")
    fall = next(fall for fall in falls if (fall.start.kind, fall.start.seed) == which)
    print(table([HEAD, *_rows(name, setup.solver, [fall])]))
    if fall.failures():
        print(
            f"  {', '.join(fall.failures())}: most energy, {fall.jump:.2g} of that at the start, "
            f"comes in step {fall.step}"
        )
    return int(bool(fall.failures()))
