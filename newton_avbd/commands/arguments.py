# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The arguments of each command, in a function of its name.

They are read before Newton is imported, which takes seconds: this module needs neither Newton nor
Warp. Arguments that name a scene, a case or a robot are not checked here, but by the command.
"""

import argparse
import contextlib
import math
from pathlib import Path

from newton_avbd.io.names import AUTO, CONTROLS, REFINED, SOLVERS, SUFFIXES, TIMED, VIEWERS
from newton_avbd.io.options import add_device, add_json, add_scene_arguments, add_solvers, positive
from newton_avbd.study.falls.kinds import KINDS
from newton_avbd.study.properties.solvers import SOLVERS as TRIED


def run(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd run``."""
    add_scene_arguments(parser)
    parser.add_argument(
        "--viewer",
        choices=(AUTO, *VIEWERS),
        default="null",
        help="viewer (default: %(default)s); auto: a window, or a browser where there is none",
    )
    parser.add_argument(
        "--png", type=Path, metavar="FILE", help="picture of the last frame; needs no window"
    )


def compare(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd compare``."""
    add_scene_arguments(parser)
    parser.add_argument(
        "--against",
        choices=SOLVERS,
        help="solver to compare with (default: vbd; avbd where --solver is another one)",
    )
    parser.add_argument(
        "--ctrl",
        choices=CONTROLS,
        help="drive the actuators of an MJCF file, with the same controls for both",
    )
    parser.add_argument(
        "--png",
        type=Path,
        metavar="FILE",
        help="plot over time; the file's ending says of which kind: .png, .svg, .pdf, ...",
    )
    parser.add_argument(
        "--html", type=Path, metavar="FILE", help="page for a browser: table, plots over time"
    )
    add_json(parser)


def effects(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd effects``."""
    add_scene_arguments(parser, solvers=("avbd",))
    parser.add_argument(
        "--measure",
        action="store_true",
        help="also leave out each effect in turn and time a step without it, after --frames",
    )


def robots(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd robots``."""
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="robots, or packages of them; --list names them (default: all)",
    )
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="write robots.md there, with a picture of each robot and one of some; what is there "
        "of others stays",
    )
    parser.add_argument(
        "--untimed",
        action="store_true",
        help="check and draw only, time nothing; the page keeps the times of an earlier run",
    )
    parser.add_argument(
        "--usd",
        action="store_true",
        help="turn URDF and MJCF files into USD files first, and try these; the page is "
        "robots_usd.md, without pictures",
    )


def falls(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd falls``."""
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="robots or packages of them, which --list names, or files "
        f"({', '.join(SUFFIXES)}); default: all robots",
    )
    parser.add_argument(
        "--kinds", nargs="+", choices=KINDS, default=list(KINDS), help="what happens (default: all)"
    )
    parser.add_argument(
        "--seeds",
        type=_seeds,
        default=range(8),
        metavar="N",
        help="so many starts of each kind, or FIRST:END (default: 8)",
    )
    add_solvers(parser, SOLVERS, ("avbd",))
    _add_iterations(parser)
    parser.add_argument(
        "--dt", type=positive(float), default=1 / 240, help="time step in seconds (default: 1/240)"
    )
    parser.add_argument(
        "--seconds", type=positive(float), default=3.0, help="of each fall (default: 3)"
    )
    parser.add_argument(
        "--scheme", choices=("euler", "generalized_alpha", "runge_kutta"), help="of SolverAVBD"
    )
    parser.add_argument("--parallel", choices=("worlds", "bodies"), help="of SolverAVBD")
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="write a file for each fall that fails there"
    )
    parser.add_argument(
        "--replay", type=Path, metavar="FILE", help="repeat the fall of such a file instead"
    )
    parser.epilog = """\
kinds:
  fallen   random joint angles and orientation, dropped on the ground
  spin5    weightless, joints turn at up to 5 rad/s against their limits
  spin12   at up to 12 rad/s
  spin30   at up to 30 rad/s
  thrown   random joint angles and orientation, at 10 m/s against a wall
Robots float. Drives, passive springs and dampers are off. Columns: the most energy gained since its
lowest value, and above that at the start, as shares of that; the fastest center of mass, and the
same as a multiple of a free fall's speed; the widest open joint; the furthest that a limit was
passed; the steps in which SolverAVBD had to bound the energy."""


def learning(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd learning``."""
    parser.add_argument(
        "tasks", nargs="*", metavar="TASK", help="tasks; --list names them (default: all)"
    )
    parser.add_argument(
        "--episodes", type=positive(int), default=5, help="of each task (default: %(default)s)"
    )
    parser.add_argument(
        "--controls",
        type=positive(int),
        default=250,
        help="most controls of an episode (default: %(default)s)",
    )
    parser.epilog = """\
A fixed random policy. Steps a second of the engine alone, with its collision detection, on one
core. Returns are means over the episodes with their standard deviation."""


def bench(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd bench``."""
    _add_scenes(parser)
    add_solvers(parser, TIMED)
    parser.add_argument("--quick", action="store_true", help="some minutes, rough; no cold start")
    add_json(parser)


def accuracy(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd accuracy``."""
    _add_scenes(parser)
    add_solvers(parser, REFINED)
    parser.add_argument(
        "--quick", action="store_true", help="some scenes and settings in two minutes"
    )
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="folder for plots, tables and numbers; what is there is not measured again",
    )
    parser.add_argument(
        "--ask",
        metavar="SCENE",
        help="what each accuracy costs on a scene of your own: a file, robot:NAME, or what "
        "newton-avbd run takes; two minutes",
    )
    parser.add_argument(
        "--control",
        action="store_true",
        help="error asked for against error achieved, of SolverAVBD(model, accuracy=...); half an "
        "hour for all scenes",
    )
    add_json(parser, "; with --ask")


def growth(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd growth``."""
    _add_scenes(parser)
    parser.add_argument(
        "--most",
        type=positive(int),
        default=10**5,
        metavar="BODIES",
        help="bodies of the largest scenes (default: %(default)s)",
    )
    add_device(parser)
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="folder for plots (SVG) and numbers (JSON)"
    )


def large(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd large``."""
    _add_scenes(parser)
    parser.add_argument(
        "--bodies",
        type=positive(int),
        nargs="+",
        default=[1_000, 10_000, 110_000],
        metavar="COUNT",
        help="sizes (default: 1000 10000 110000)",
    )
    parser.add_argument(
        "--iterations", type=positive(int), default=4, help="sweeps a step (default: %(default)s)"
    )
    parser.add_argument(
        "--steps",
        type=positive(int),
        default=60,
        help="steps before the time is taken (default: %(default)s)",
    )
    parser.add_argument(
        "--parallel",
        choices=("bodies", "worlds"),
        default="bodies",
        help="what threads share (default: %(default)s); worlds: one thread does it all",
    )
    add_device(parser)
    add_json(parser)


def stability(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd stability``."""
    parser.add_argument(
        "cases",
        nargs="*",
        metavar="CASE",
        help="cases, by the start of their names; --list names them (default: all)",
    )
    add_solvers(parser, SOLVERS, ("avbd",))
    _add_iterations(parser)
    parser.add_argument(
        "--rate",
        type=positive(float),
        metavar="HZ",
        help="steps a second of all cases, collisions detected once a step (default: each its own)",
    )
    parser.add_argument("--quick", action="store_true", help="leave out cases that take minutes")
    parser.add_argument(
        "--budget",
        type=positive(float),
        default=math.inf,
        metavar="SECONDS",
        help="stop a run after this time (default: never)",
    )
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="folder for a page with pictures"
    )
    parser.add_argument(
        "--long",
        type=positive(int),
        metavar="STEPS",
        help="take so many steps of SolverAVBD on resting_pile and driven_four_bar instead",
    )
    add_device(parser)


def properties(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``newton-avbd properties``."""
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="properties, by the start of their names; --list names them (default: all)",
    )
    add_solvers(parser, tuple(TRIED))
    parser.add_argument("--output", type=Path, metavar="FILE", help="page to write, Markdown")
    add_json(parser, "; outcomes that a file already has are kept, unless they are tried anew")


def _add_scenes(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help="scenes; --list names them (default: all)"
    )


def _add_iterations(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--iterations", type=positive(int), help="iterations a step (default: the solver's own)"
    )


def _seeds(text: str) -> range:
    """Reader of a number of seeds, or of the first and the end."""
    first, colon, end = text.partition(":")
    with contextlib.suppress(ValueError):
        seeds = range(int(first), int(end)) if colon else range(int(first))
        if seeds:
            return seeds
    raise argparse.ArgumentTypeError(f"{text!r} names no seeds: 3 is 0 to 2, 5:8 is 5 to 7")
