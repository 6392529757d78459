# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Completion of commands, arguments, their choices and names by the Tab key, for bash and zsh."""

import argparse
import shlex
from collections.abc import Mapping


def script(parsers: Mapping[str, argparse.ArgumentParser]) -> str:
    """What a shell sources; where nothing fits, it completes names of files.

    The script holds all words, so that a press of the Tab key does not start Python.

    Args:
        parsers: A parser for each command.
    """
    cases = [f"    {name}) words={shlex.quote(_words(parsers[name]))} ;;" for name in parsers]
    return "\n".join(
        [
            '[ -n "$ZSH_VERSION" ] && autoload -U compinit bashcompinit && compinit',
            '[ -n "$ZSH_VERSION" ] && bashcompinit',
            "COMP_WORDBREAKS=${COMP_WORDBREAKS//:/}",  # robot:NAME is one word
            "_newton_avbd() {",
            f"  local words={shlex.quote(' '.join(parsers))}",
            '  [ "$COMP_CWORD" -gt 1 ] && case "${COMP_WORDS[1]}" in',
            *cases,
            '    *) words="" ;;',
            "  esac",
            '  COMPREPLY=($(compgen -W "$words" -- "${COMP_WORDS[COMP_CWORD]}"))',
            "}",
            "complete -o default -F _newton_avbd newton-avbd",
        ]
    )


def _words(parser: argparse.ArgumentParser) -> str:
    """Long options of a command, and the choices and names of all its arguments."""
    words: list[str] = []
    for action in parser._actions:
        words += [option for option in action.option_strings if option.startswith("--")]
        words += map(str, action.choices or ())
        words += getattr(action, "names", tuple)()  # see io.options.offer
    return " ".join(dict.fromkeys(words))
