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

from newton_avbd.commands import COMMANDS, arguments, examples, listing, overview
from newton_avbd.commands.completion import Words, script
from newton_avbd.io.errors import UserError, missing_of
from newton_avbd.io.terminal import gathered_warnings, showing, start_warp


def dispatch(argv: Sequence[str] | None) -> int:
    """Run a command; see :func:`newton_avbd.__main__.main`."""
    typed = list(sys.argv[1:] if argv is None else argv)
    try:
        name = _command(typed[: 2 if typed[:1] == ["--completion"] else 1])
        if name is None:
            return 0
        args = parse(name, typed[1:])
        module = _load(COMMANDS[name].module)
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
        print(script({known: _words(known) for known in COMMANDS}))
    elif name is None:
        parser.print_help()
    elif name not in COMMANDS:
        close = difflib.get_close_matches(name, COMMANDS)
        hint = f"did you mean {' or '.join(close)}?" if close else f"try: {', '.join(COMMANDS)}"
        parser.error(f"there is no command {name!r}; {hint}")
    return name


def _load(module: str) -> Any:
    """A module that needs Newton, whose import takes seconds."""
    with showing("loading Newton"):
        return importlib.import_module(module)


def _catalog(name: str) -> dict[str, dict[str, str]]:
    """What a command can be given by name, under headings."""
    command = COMMANDS[name]
    found: dict[str, dict[str, str]] = _load(command.catalog or command.module).catalog()
    return found


def _words(name: str) -> Words:
    """What the Tab key completes after a command."""
    names = [known for entries in _catalog(name).values() for known in entries]
    return Words(_parser(name), names, COMMANDS[name].or_files)


class _List(argparse.Action):
    """Prints the names that a command takes, and ends."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        print(listing(_catalog(self.dest)))
        parser.exit()


def _parser(name: str) -> argparse.ArgumentParser:
    """The parser of a command's arguments."""
    command = COMMANDS[name]
    parser = argparse.ArgumentParser(
        prog=f"newton-avbd {name}",
        description=command.summary,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    getattr(arguments, name)(parser)
    parser.add_argument(
        "--list",
        action=_List,
        nargs=0,
        dest=name,
        default=argparse.SUPPRESS,
        help=f"name all {command.names}, and end",
    )
    parser.epilog = "\n\n".join(filter(None, (examples(name), parser.epilog)))
    return parser


def parse(name: str, typed: list[str]) -> argparse.Namespace:
    """Arguments of a command, with what follows ``--`` in ``arguments``."""
    parser = _parser(name)
    split = typed.index("--") if "--" in typed else len(typed)
    args, unknown = parser.parse_known_args(typed[:split])
    if unknown:
        _reject(parser, unknown[0])
    args.arguments = tuple(typed[split + 1 :])
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
