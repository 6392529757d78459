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

import newton
import newton.solvers.experimental.coupled
import numpy as np
import pytest
import warp as wp

import newton_avbd
from newton_avbd import SolverAVBD
from newton_avbd.__main__ import main
from newton_avbd.commands import COMMANDS
from newton_avbd.commands.program import parse

DOCS = Path(__file__).parent.parent / "docs"
ALL_PAGES = [*sorted(DOCS.glob("*.md")), *sorted((DOCS / "howto").glob("*.md"))]
ALL_PAGES += [DOCS.parent / name for name in ("README.md", "CONTRIBUTING.md")]
PAGES = [DOCS / "tutorial.md", *sorted((DOCS / "howto").glob("*.md")), DOCS / "external_solver.md"]
FRAGMENTS = ("from_mujoco", "coupling", "effects", "tolerance", "faq")
"""Pages whose blocks speak of a model that the reader has."""

ROBOT = """<mujoco><option solver="PGS"/><worldbody>
<geom name="floor" type="plane" size="1 1 1" contype="0" conaffinity="0"/>
<body name="hand" mocap="true" pos="0 0 2"><geom size="0.1"/></body>
<body pos="0 0 1"><joint name="shoulder" axis="0 1 0"/><geom size="0.1" pos="0.5 0 0"/>
<body pos="1 0 0"><joint name="elbow" axis="0 1 0"/>
<geom name="fist" size="0.1" pos="0.5 0 0" contype="0" conaffinity="0"/></body></body>
</worldbody><contact><pair geom1="floor" geom2="fist"/></contact>
<actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>"""
"""Has what docs/from_mujoco.md speaks of: two motors, a pair of geoms, a mocap body."""

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
        status, errors = _run(arguments)
        if status == 2 and "OpenGL" in errors:  # all but the picture
            at = arguments.index("--png")
            status, errors = _run(arguments[:at] + arguments[at + 2 :])
        assert status == 0, f"{line}\n{errors}"


def _run(arguments: list[str]) -> tuple[int, str]:
    """The status of a command and what it prints to standard error."""
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors):
        return main(arguments), errors.getvalue()


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


@pytest.fixture(scope="module")
def beginnings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a reader of fragments has before them; compiles what other tests compile, too."""
    file = tmp_path_factory.mktemp("robot") / "robot.xml"
    file.write_text(ROBOT.replace('solver="PGS"', ""))
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(str(file))
    builder.add_soft_mesh(
        vertices=[(x, y, 3.0 + z) for x, y, z in np.vstack([np.zeros(3), np.eye(3)])],
        indices=[0, 1, 2, 3],
        pos=wp.vec3(),
        rot=wp.quat_identity(),
        scale=0.1,
        vel=wp.vec3(),
        density=100.0,
    )
    builder.color()
    model = builder.finalize()
    return {
        "file": file,
        "model": model,
        "bodies": range(model.body_count),
        "joints": range(model.joint_count),
        "particles": range(model.particle_count),
    }


@pytest.mark.parametrize("name", FRAGMENTS)
def test_fragments_run_where_a_model_is_there(
    name: str, beginnings: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its numbers are not asked for: this is about names, arguments and types."""
    monkeypatch.chdir(tmp_path)
    Path("robot.xml").write_text(beginnings["file"].read_text())
    Path("pgs.xml").write_text(ROBOT)
    namespace = vars(newton.solvers.experimental.coupled) | beginnings
    namespace |= {"newton": newton, "newton_avbd": newton_avbd, "SolverAVBD": SolverAVBD}
    namespace |= {"np": np, "wp": wp, "Path": Path, "SolverVBD": newton.solvers.SolverVBD}
    namespace |= {"FILE": "pgs.xml"}
    page = DOCS / f"{name}.md"
    for language, line, content in blocks(page):
        if language == "python":
            run_python(page, line, content, namespace)


def commands(page: Path) -> list[str]:
    """Lines of a page that a reader types, those in sentences included."""
    typed = r"^ *(newton-avbd .*)$|`(newton-avbd [^`]*)`"
    found = ["".join(pair) for pair in re.findall(typed, page.read_text(), re.MULTILINE)]
    whole = [line for line in found if not re.search(r"[\[>]|\.\.\.", line)]
    return list(dict.fromkeys(whole))


@pytest.mark.parametrize("page", ALL_PAGES, ids=lambda page: page.stem)
def test_the_arguments_of_a_page_s_commands_exist(page: Path) -> None:
    """``SCENE``, ``FILE`` and the like stand for what is not looked up here."""
    for line in commands(page):
        name, *arguments = shlex.split(line)[1:]
        if name.startswith("--") or arguments in (["--list"], ["--help"]) or name == "COMMAND":
            continue
        assert name in COMMANDS, line
        needs_scene = name in ("run", "compare", "effects") and not arguments
        parse(name, ["SCENE"] if needs_scene else arguments)


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
