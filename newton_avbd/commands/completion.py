# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Completion of commands, arguments, their choices and names by the Tab key, for bash and zsh."""

import argparse
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

_FUNCTION = r"""  COMPREPLY=()
  local line="${COMP_LINE:0:COMP_POINT}"
  local typed="${line##*[[:space:]]}"
  local before="${line%"$typed"}"
  before="${before%"${before##*[![:space:]]}"}"
  local previous="${before##*[[:space:]]}"
  case "$typed" in
    --*=*) previous="${typed%%=*}" typed="${typed#*=}" ;;
  esac
  case " $paths " in
    *" $previous "*) return ;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$typed"))
  if [ -n "$files" ] && [ "${#COMPREPLY[@]}" -gt 0 ]; then
    local IFS=$'\n'
    local -a found
    found=($(compgen -f -- "$typed"))
    if [ "${#found[@]}" -gt 0 ]; then
      COMPREPLY+=("${found[@]}")
      compopt -o filenames 2>/dev/null
    fi
  fi
  case "$COMP_WORDBREAKS" in
    *:*) COMPREPLY=("${COMPREPLY[@]#"${typed%"${typed##*:}"}"}") ;;
  esac
}
complete -o default -F _newton_avbd newton-avbd"""
"""What a press of the Tab key does with what a command may be given.

The shell completes names of files where ``COMPREPLY`` stays empty. In bash a word begins after a
colon, and what stands before that is not replaced."""


@dataclass(frozen=True)
class Words:
    """What may follow a command.

    Attributes:
        parser: The parser of its arguments.
        names: What it takes by name. A name ends at its first space, as a word does.
        or_files: Whether files may stand for names.
    """

    parser: argparse.ArgumentParser
    names: list[str]
    or_files: bool


def script(commands: Mapping[str, Words]) -> str:
    """What a shell sources; where nothing fits, it completes names of files.

    The script holds all words, so that a press of the Tab key does not start Python.

    Args:
        commands: What may follow each command.
    """
    return "\n".join(
        [
            '[ -n "$ZSH_VERSION" ] && autoload -U compinit bashcompinit && compinit',
            '[ -n "$ZSH_VERSION" ] && bashcompinit',
            "_newton_avbd() {",
            f"  local words={shlex.quote(' '.join(commands))} paths= files=",
            '  [ "$COMP_CWORD" -gt 1 ] && case "${COMP_WORDS[1]}" in',
            *(f"    {name}) {_known(words)} ;;" for name, words in commands.items()),
            '    *) words="" ;;',
            "  esac",
            _FUNCTION,
        ]
    )


def _known(command: Words) -> str:
    """Sets what a command may be given: words, options before a path, whether files as well."""
    words: list[str] = []
    paths: list[str] = []
    for action in command.parser._actions:
        options = [option for option in action.option_strings if option.startswith("--")]
        words += options
        words += map(str, action.choices or ())
        if action.type is Path:
            paths += options
    words += (name.split()[0].rstrip(",:") for name in command.names)
    said = shlex.quote(" ".join(dict.fromkeys(words)))
    return f"words={said} paths={shlex.quote(' '.join(paths))} files={'yes' * command.or_files}"
