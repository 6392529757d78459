# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd learning``: tasks of dm_control and gymnasium, moved by SolverAVBD and MuJoCo."""

import argparse
import warnings

from newton_avbd.io.errors import UserError, require
from newton_avbd.study.bench import learning
from newton_avbd.study.bench.run import chosen, describe_machine, pinned

from ..io.output import table
from ..io.terminal import interruptible, progress, say_notes
from .robots import silence

HEAD = ("", "step", "AVBD steps/s", "MuJoCo", "AVBD return", "MuJoCo", "AVBD length", "MuJoCo")


def catalog() -> dict[str, dict[str, str]]:
    """The tasks."""
    return {"tasks": dict.fromkeys(learning.TASKS, "")}


def main(args: argparse.Namespace) -> int:
    """Run the episodes and print a table.

    Returns:
        Exit status: 0, or 1 where SolverAVBD loses an episode to numbers that are not finite.

    Raises:
        UserError: There is no such task, or its package is not installed.
    """
    names = chosen("task", args.tasks, learning.TASKS)
    require("dm_control", "gymnasium", "mujoco")
    warnings.simplefilter("ignore")
    rows: list[tuple[str, ...]] = [HEAD]
    lost = 0
    with pinned() as core:
        machine = describe_machine(core)
        with interruptible() as interruption:
            for name in progress(names, len(names), "tasks", str):
                try:
                    with silence():
                        ours, theirs, dt = _run(name, args.episodes, args.controls)
                except UserError as error:
                    say_notes([f"{name} is left out: {error}"])
                    continue
                lost += ours.lost
                rows.append(_row(name, dt, ours, theirs))
    for name, value in machine.items():
        print(f"{name}: {value}")
    print(f"\n{table(rows)}")
    return interruption.status(int(lost > 0))


def _run(
    name: str, episodes: int, controls: int
) -> tuple[learning.Outcome, learning.Outcome, float]:
    """Episodes of a task with both engines, and its time step [s]."""
    task = learning.Task(name)
    engines = learning.Engine(task), learning.Clock(task)
    ours, theirs = (learning.run(task, engine, episodes, controls) for engine in engines)
    return ours, theirs, float(task.model.opt.timestep)


def _row(name: str, dt: float, ours: learning.Outcome, theirs: learning.Outcome) -> tuple[str, ...]:
    rates = [f"{outcome.rate:,.0f}" for outcome in (ours, theirs)]
    returns = [
        f"{outcome.returns.mean():.4g} ± {outcome.returns.std():.2g}" for outcome in (ours, theirs)
    ]
    lengths = [f"{outcome.lengths.mean():.0f}" for outcome in (ours, theirs)]
    note = f" ({ours.lost} lost)" if ours.lost else ""
    return (name + note, f"{1e3 * dt:g} ms", *rates, *returns, *lengths)
