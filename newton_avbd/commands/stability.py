# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd stability``: run hard cases and say which of them a solver withstands."""

import argparse
import sys
from collections.abc import Iterable, Iterator

from newton_avbd.io.errors import require, unknown
from newton_avbd.study.stability.case import Case, Outcome, try_case
from newton_avbd.study.stability.cases import CASES, GROUPS
from newton_avbd.study.stability.long_run import IN_GRAPH, LONG_RUNS, run_long
from newton_avbd.study.stability.page import line, write_page

from ..io.options import make_folder, use_device
from ..io.output import length, writing
from ..io.terminal import interruptible, progress, say


def catalog() -> dict[str, dict[str, str]]:
    """The cases of each group, and what they are."""
    return {
        title: {case.name: case.summary for case in cases.values()}
        for title, cases in GROUPS.items()
    }


def main(args: argparse.Namespace) -> int:
    """Run the cases, print a line for each, write the page; 1 where SolverAVBD misses a bound."""
    use_device(args.device)
    if args.long:
        return _run_long(args.cases, args.long, args.iterations)
    if args.output:
        require("matplotlib")
    make_folder(args.output)
    outcomes: list[Outcome] = []
    cases = _chosen(args.cases, args.quick)
    if args.rate:
        for case in cases:
            if case.own_rate:
                say(f"{case.name:24} left out: {case.own_rate}")
        cases = [case.at_rate(args.rate) for case in cases if not case.own_rate]
    pairs = [(case, solver) for case in cases for solver in args.solvers]
    with interruptible() as interruption:
        for case, solver in progress(pairs, len(pairs), "cases", lambda pair: pair[0].name):
            outcome = try_case(case, solver, iterations=args.iterations, budget=args.budget)
            say(line(case, outcome))
            outcomes.append(outcome)
    if args.output:
        with writing(args.output):
            print(f"wrote {write_page(outcomes, args.output)}", file=sys.stderr)
    ours = [outcome for outcome in outcomes if outcome.solver == "avbd"]
    failed = any(outcome.failures(CASES[outcome.case].bounds) for outcome in ours)
    return interruption.status(int(failed))


def _run_long(names: list[str], steps: int, iterations: int | None) -> int:
    """Take many steps, print a line a scene; 1 where one misses a bound, 130 after Ctrl-C."""
    _check_names(names, LONG_RUNS)
    failed = False
    chosen = [name for name in LONG_RUNS if name.startswith(tuple(names) or ("",))]
    with interruptible() as interruption:
        for name in chosen:

            def watch(replays: range, name: str = name) -> Iterator[int]:
                return progress(replays, len(replays), f"{name}, {IN_GRAPH} steps each")

            run = run_long(name, steps, iterations, watch)
            failures = run.failures()
            failed |= bool(failures)
            say(
                f"{name:<18}{' '.join(['FAIL', *failures]) if failures else 'ok'}"
                f"  {run.steps} steps"
                f"  drift {length(run.drift)}, at the end {length(run.final_drift)}"
                f"  energy {length(run.energy)}  joints {length(run.separation)}"
                f"  penetration {length(run.penetration)}"
                f"  contacts {run.contacts[0]} to {run.contacts[1]}"
                f"  memory +{run.memory // 1024} KiB  {run.microseconds:.0f} us a step"
            )
            if run.stopped:
                raise KeyboardInterrupt
    return interruption.status(int(failed))


def _check_names(names: list[str], known: Iterable[str]) -> None:
    """Raises a UserError for a name with which no known one starts."""
    for name in names:
        if not any(case.startswith(name) for case in known):
            raise unknown("case", name, known)


def _chosen(names: list[str], quick: bool) -> list[Case]:
    """Cases whose names start with one of ``names``, or all, in the order of the catalog.

    Raises:
        UserError: A name starts none.
    """
    _check_names(names, CASES)
    starts = tuple(names) or ("",)
    return [
        case
        for name, case in CASES.items()
        if name.startswith(starts) and (case.is_quick or not quick or name in names)
    ]
