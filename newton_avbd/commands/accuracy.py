# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd accuracy``: what accuracy costs in time, for SolverAVBD and its peers."""

import argparse
import sys
from pathlib import Path

from newton_avbd.io import UserError, require
from newton_avbd.study import accuracy_page
from newton_avbd.study.accuracy import FULL, QUICK, QUICK_SCENES, Results, run
from newton_avbd.study.accuracy_scenes import ACCURACY_SCENES
from newton_avbd.study.accuracy_solvers import MEASURED
from newton_avbd.study.bench import chosen, describe_machine, pinned
from newton_avbd.study.mujoco_native import silence

from .options import make_folder
from .terminal import interruptible, progress, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments to its parser."""
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help="scenes, see below (default: all)"
    )
    parser.add_argument(
        "--solvers",
        metavar="NAMES",
        help=f"separated by commas, of {', '.join(MEASURED)} (default: all that apply)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="some scenes and settings in two minutes"
    )
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="folder for plots, tables and numbers; what is there is not measured again",
    )
    parser.epilog = "scenes:\n" + "\n".join(
        f"  {name:<16} {scene.summary}" for name, scene in ACCURACY_SCENES.items()
    )


def main(args: argparse.Namespace) -> int:
    """Measure, print a line for each setting and tables at the end, write the page.

    Returns:
        Exit status: 0, or 130 after Ctrl-C.

    Raises:
        UserError: A scene or a solver does not exist, the folder cannot be written, or it holds
            results of another machine.
    """
    require("scipy")
    if args.output:
        require("matplotlib")
    default = list(QUICK_SCENES) if args.quick else []
    names = chosen("accuracy scene", args.scenes or default, tuple(ACCURACY_SCENES))
    named = args.solvers.split(",") if args.solvers else []
    solvers = chosen("solver", named, tuple(MEASURED))
    scenes = [ACCURACY_SCENES[name] for name in names]
    silence()
    make_folder(args.output)
    try:
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
    except OSError as error:
        raise UserError(f"cannot write to {args.output}: {error}") from error
    return interruption.status(0)
