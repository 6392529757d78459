# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a reader copies from the documentation runs, and prints what the page says.

The Python and shell blocks of a page run in their order, Python in one namespace. A ``text`` block
is what the block before it prints; its numbers, which depend on the machine, are not compared.
"""

import contextlib
import doctest
import io
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import warp as wp

from newton_avbd.__main__ import main

DOCS = Path(__file__).parent.parent / "docs"
PAGES = [DOCS / "tutorial.md", *sorted((DOCS / "howto").glob("*.md")), DOCS / "external_solver.md"]
_ANY_FENCE = re.compile(r"^```(\S*)\n.*?^```$", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"^ {4,}(\S.*)$", re.MULTILINE)
_FENCE = re.compile(r"^```(python|sh|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")
_INSTALLS = ("pip ", "python3 -m venv ", "source ")


def blocks(page: Path) -> Iterator[tuple[str, int, str]]:
    """Language, line and content of the blocks of a page."""
    text = page.read_text()
    for fence in _FENCE.finditer(text):
        yield fence[1], text.count("\n", 0, fence.start()) + 1, fence[2]


def run_shell(content: str) -> None:
    """Runs the package's commands; what installs has been done, or the test would not run."""
    for line in content.splitlines():
        if line.startswith(_INSTALLS):
            continue
        command, *arguments = shlex.split(line)
        assert command == "newton-avbd", line
        errors = io.StringIO()
        with contextlib.redirect_stderr(errors):
            status = main(arguments)
        if status == 2 and "OpenGL" in errors.getvalue():
            pytest.skip("no OpenGL on this machine")
        assert status == 0, f"{line}\n{errors.getvalue()}"


def run_python(page: Path, line: int, content: str, namespace: dict[str, Any]) -> None:
    """Runs a block; a traceback names the line of the page."""
    exec(compile("\n" * line + content, str(page), "exec"), namespace)


def shape(text: str) -> str:
    """What was printed, without its numbers."""
    return _NUMBER.sub("0", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_code_of_a_page_runs_and_prints_what_it_says(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_WARNING)  # kernels that are compiled
    namespace: dict[str, Any] = {"__name__": "__main__"}
    printed = ""
    for language, line, content in blocks(page):
        if language == "text":
            flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
            fits = doctest.OutputChecker().check_output(shape(content), shape(printed), flags)
            assert fits, f"{page.name}:{line} says\n{content}\nand the block before it\n{printed}"
            continue
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            if language == "sh":
                run_shell(content)
            else:
                run_python(page, line, content, namespace)
        printed = output.getvalue()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_no_block_of_a_page_is_left_out(page: Path) -> None:
    """All run above, but for scripts that take minutes and need what no extra brings.

    Of these the file exists, and it has the options.
    """
    text = page.read_text()
    languages = {language for language in _ANY_FENCE.findall(text) if not language.startswith("{")}
    assert languages <= {"python", "sh", "text"}
    for line in _INDENTED.findall(_ANY_FENCE.sub("", text)):
        if line.startswith(_INSTALLS):
            continue
        python, script, *arguments = shlex.split(line)
        assert python == "python", line
        source = (DOCS.parent / script).read_text()
        for option in (argument for argument in arguments if argument.startswith("-")):
            assert f'"{option}"' in source, line
