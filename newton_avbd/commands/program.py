# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Which command is asked for, with which arguments, and how it ends."""

import argparse
import difflib
import importlib
import importlib.metadata
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from newton_avbd.commands import COMMANDS, examples, overview
from newton_avbd.commands.completion import script
from newton_avbd.io.errors import UserError, missing_of
from newton_avbd.io.terminal import gathered_warnings, showing, start_warp


def dispatch(argv: Sequence[str] | None) -> int:
    """Run a command; see :func:`newton_avbd.__main__.main`."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        name = _command(arguments[: 2 if arguments[:1] == ["--completion"] else 1])
        if name is None:
            return 0
        module = _module(name)
        args = parse(name, arguments[1:])
        start_warp()
        with gathered_warnings():
            return module.main(args)
    except (UserError, ImportError) as error:
        told = missing_of(error) if isinstance(error, ImportError) else error
        print(f"newton-avbd: {told}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        # Whoever read standard output has ended, as `head` does; nothing may be flushed to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _command(first: list[str]) -> str | None:
    """Name of the command that the first arguments ask for; None where the list is printed."""
    parser = argparse.ArgumentParser(
        prog="newton-avbd",
        usage="newton-avbd COMMAND ...",
        description="Simulate rigid bodies in Newton by Augmented Vertex Block Descent.",
        epilog=overview(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=_versions())
    parser.add_argument("command", nargs="?", help=argparse.SUPPRESS)
    parser.add_argument(
        "--completion",
        nargs="?",
        const="bash",
        choices=("bash", "zsh"),
        help="print a script for the Tab key, the same for bash and zsh",
    )
    parsed = parser.parse_args(first)
    name: str | None = parsed.command
    if parsed.completion:
        print(script({known: _parser(known) for known in COMMANDS}))
    elif name is None:
        parser.print_help()
    elif name not in COMMANDS:
        close = difflib.get_close_matches(name, COMMANDS)
        hint = f"did you mean {' or '.join(close)}?" if close else f"try: {', '.join(COMMANDS)}"
        parser.error(f"there is no command {name!r}; {hint}")
    return name


def _module(name: str) -> Any:
    """The module of a command; most need Newton, whose import takes seconds."""
    with showing("loading Newton"):
        return importlib.import_module(COMMANDS[name].module)


def _parser(name: str) -> argparse.ArgumentParser:
    """The parser of a command's arguments."""
    parser = argparse.ArgumentParser(
        prog=f"newton-avbd {name}",
        description=COMMANDS[name].summary,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _module(name).add_arguments(parser)
    parser.epilog = "\n\n".join(filter(None, (examples(name), parser.epilog)))
    return parser


def parse(name: str, arguments: list[str]) -> argparse.Namespace:
    """Arguments of a command, with what follows ``--`` in ``arguments``."""
    parser = _parser(name)
    split = arguments.index("--") if "--" in arguments else len(arguments)
    args, unknown = parser.parse_known_args(arguments[:split])
    if unknown:
        _reject(parser, unknown[0])
    args.arguments = tuple(arguments[split + 1 :])
    return args


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
