# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The command line, ``newton-avbd`` or ``python -m newton_avbd``."""

import argparse
import difflib
import importlib.metadata
import sys
from collections.abc import Sequence
from typing import NoReturn

import warp as wp

from newton_avbd.commands import (
    accuracy,
    compare,
    effects,
    falls,
    growth,
    large,
    learning,
    robots,
    run,
    stability,
)
from newton_avbd.io import UserError
from newton_avbd.study import bench, properties


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: Arguments without the program's name; None for those of the process. What follows
            ``--`` goes to a Newton example.

    Returns:
        Exit status: 0, 1 where a scene fails its own test, 2 where the command cannot be done.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    split = arguments.index("--") if "--" in arguments else len(arguments)
    args, unknown = _parser().parse_known_args(arguments[:split])
    if unknown:
        _reject(args.parser, unknown[0])
    args.arguments = tuple(arguments[split + 1 :])
    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    try:
        return args.main(args)
    except UserError as error:
        print(f"newton-avbd: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="newton-avbd",
        description="Simulate rigid bodies in Newton by Augmented Vertex Block Descent.",
    )
    parser.add_argument("--version", action="version", version=_versions())
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, module, summary in (
        ("run", run, "simulate a scene"),
        ("compare", compare, "simulate a scene with two solvers and compare them"),
        ("robots", robots, "try the robots of installed packages, and say which move right"),
        ("effects", effects, "say which effects a scene calls for, why, and what they cost"),
        ("bench", bench, "measure time and quality on a set of scenes"),
        ("accuracy", accuracy, "measure what accuracy costs in time"),
        ("growth", growth, "measure how time and memory grow with a scene"),
        ("learning", learning, "step tasks of dm_control and gymnasium, with MuJoCo beside"),
        ("large", large, "measure one large world, of any size"),
        ("stability", stability, "run cases that are hard to keep stable"),
        ("falls", falls, "drop, spin and throw robots, and measure energy that appears"),
        ("properties", properties, "try solvers on what a scene can author"),
    ):
        command = commands.add_parser(
            name,
            help=summary,
            description=summary,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(command)
        command.set_defaults(main=module.main, parser=command)
    return parser


def _versions() -> str:
    """Versions of this package and of what it stands on, which a report of a fault needs."""
    names = ("newton-avbd", "newton", "warp-lang")
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names)


def _reject(parser: argparse.ArgumentParser, unknown: str) -> NoReturn:
    """Exit for an argument that ``parser`` does not know; its usage lists those it does."""
    known = list(parser._option_string_actions)
    close = difflib.get_close_matches(unknown.partition("=")[0], known)
    hint = f"; did you mean {' or '.join(close)}?" if close else ""
    parser.error(f"there is no argument {unknown}{hint}")


if __name__ == "__main__":
    sys.exit(main())
