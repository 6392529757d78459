# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The command line reports what happened, and says in a sentence what it cannot do."""

import html
import importlib.metadata
import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import newton
import newton.viewer
import numpy as np
import pytest

import newton_avbd
from newton_avbd.__main__ import main
from newton_avbd.commands import COMMANDS, view
from newton_avbd.commands.compare import Comparison, Course
from newton_avbd.commands.program import parse
from newton_avbd.io import names
from newton_avbd.io.errors import UserError
from newton_avbd.io.opening import open_scene, read_scene
from newton_avbd.io.simulation import ModelSimulation, Request
from newton_avbd.io.terminal import gathered_prints, gathered_warnings, progress
from newton_avbd.study.accuracy.solvers import MEASURED
from newton_avbd.study.peers import MJ_STEP, PEERS
from newton_avbd.study.stability.long_run import LONG_RUNS

PNG = b"\x89PNG"


def rows(text: str) -> dict[str, str]:
    """Rows of a printed table, label to the rest of the line."""
    return dict(line.split("  ", 1) for line in text.splitlines() if "  " in line)


@pytest.mark.parametrize("solver", ["avbd", "vbd", "xpbd", "mujoco"])
def test_run_reports_bodies_speed_and_cost(capsys, solver):
    if solver == "mujoco":
        pytest.importorskip("mujoco")
    assert main(["run", "fall", "--solver", solver, "--frames", "6"]) == 0
    table = rows(capsys.readouterr().out)
    assert table["bodies"].split() == ["4"]
    # Free fall for 6/60 s, from rest; four digits are printed.
    speed = float(table["largest speed at the end"].split()[0])
    assert speed == pytest.approx(0.981, abs=1.0e-3)
    assert float(table["solver a step, median"].split()[0]) > 0.0


def test_run_reports_contacts_and_penetration_of_a_pile(capsys):
    assert main(["run", "pyramid", "--frames", "30"]) == 0
    table = rows(capsys.readouterr().out)
    # 10 rows: four contacts a box with what is under it, 40 + 8 * 45, and with its neighbors.
    reported, touching = table["contacts, touching"].split()
    assert (reported, touching) == ("580,", "400")
    value, unit = table["deepest penetration at the end"].split()
    assert unit == "mm"
    assert float(value) < 0.05  # what the pyramid is to keep, see the benchmark


def test_version_names_what_a_report_of_a_fault_needs(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    printed = capsys.readouterr().out
    for name in ("newton-avbd", "newton", "warp-lang"):
        assert f"{name} {importlib.metadata.version(name)}" in printed


def test_help_and_mistakes_do_not_wait_for_newton():
    """Of all commands, in one process; the import of Newton takes seconds."""
    typed = [[], ["--help"], ["--version"], ["rnu"]]
    for name in COMMANDS:
        typed += [[name, "--help"], [name, "fall", "--no-such-argument"]]
    typed += [["run"], ["run", "fall", "--solver", "none"], ["falls", "--seeds", "0"]]
    program = (
        "import sys; from newton_avbd.__main__ import main\n"
        f"for arguments in {typed}:\n"
        "    try: main(arguments)\n"
        "    except SystemExit: pass\n"
        "    heavy = {'newton', 'warp', 'numpy', 'mujoco'} & sys.modules.keys()\n"
        "    if heavy: sys.exit(f'{arguments} imports {heavy}')"
    )
    # without what the tests set up in every process, which imports Warp
    environment = {**os.environ, "PYTHONPATH": str(Path(newton_avbd.__file__).parent.parent)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("examples:") == len(COMMANDS)
    assert done.stderr.count("there is no argument --no-such-argument") == len(COMMANDS)


def test_help_names_the_solvers_and_scenes_that_a_command_checks_later(capsys):
    """The module of arguments cannot import them."""
    for command, known in (
        ("bench", [*PEERS, MJ_STEP]),
        ("accuracy", MEASURED),
        ("stability", LONG_RUNS),
    ):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        words = set(re.findall(r"\w+", capsys.readouterr().out))
        assert words >= set(known), command


@pytest.mark.parametrize("command", COMMANDS)
def test_list_names_what_a_command_takes(command, capsys):
    with pytest.raises(SystemExit) as end:
        main([command, "--list"])
    assert end.value.code == 0
    assert len(capsys.readouterr().out.splitlines()) > 3


def test_ctrl_c_ends_the_import_of_newton_without_a_traceback():
    program = (
        "import signal, sys; from newton_avbd.__main__ import main\n"
        # what starts in the background ignores it
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name == 'newton': signal.raise_signal(signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "sys.exit(main(['run', 'fall']))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "\nnewton-avbd: stopped by Ctrl-C\n")


def test_run_fails_where_the_scene_fails_its_own_test(capsys):
    assert main(["run", "basic_dzhanibekov", "--frames", "1"]) == 1
    verdict = rows(capsys.readouterr().out)["the example's own test"]
    assert verdict.split(maxsplit=1)[0] == "failed:"


def test_run_draws_a_picture_without_a_window(tmp_path, capsys):
    pytest.importorskip("pyglet")
    image = pytest.importorskip("PIL.Image")
    path = tmp_path / "fall.png"
    status = main(["run", "fall", "--solver", "xpbd", "--frames", "1", "--png", str(path)])
    if status == 2 and "OpenGL" in capsys.readouterr().err:
        pytest.skip("no OpenGL on this machine")
    pixels = np.asarray(image.open(path))
    assert pixels.shape == (720, 1280, 3)
    assert pixels.std() > 1.0  # something is there


def test_run_says_what_to_install_where_there_is_no_opengl(monkeypatch, capsys, tmp_path):
    pytest.importorskip("pyglet")

    def fail(**options):
        raise RuntimeError("no driver")

    monkeypatch.setattr(newton.viewer, "ViewerGL", fail)
    assert main(["run", "fall", "--png", str(tmp_path / "fall.png")]) == 2
    message = capsys.readouterr().err
    assert "no driver" in message
    assert "libegl1" in message
    assert "xvfb-run" in message


def test_run_writes_usd(monkeypatch, tmp_path):
    usd = pytest.importorskip("pxr.Usd")
    monkeypatch.chdir(tmp_path)
    totals = []

    def count(items, total, label):
        totals.append(total)
        return items

    monkeypatch.setattr("newton_avbd.commands.run.progress", count)
    assert main(["run", "fall", "--solver", "xpbd", "--frames", "3", "--viewer", "usd"]) == 0
    assert totals == [3]  # nobody sees a file grow
    stage = usd.Stage.Open(str(tmp_path / "fall.usd"))
    assert stage.GetEndTimeCode() - stage.GetStartTimeCode() >= 2


def test_compare_of_a_solver_with_itself_finds_no_difference(capsys):
    arguments = ["compare", "fall", "--solver", "xpbd", "--against", "xpbd", "--frames", "3"]
    assert main([*arguments, "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["distance_max"] == [0.0] * 4
    assert result["time"] == pytest.approx([0.0, 1 / 60, 2 / 60, 3 / 60])
    one, other = result["courses"]
    assert one["energy"] == other["energy"]
    assert one["penetration"] == [0.0] * 4


def test_json_goes_to_a_file_or_to_standard_output(tmp_path, capsys):
    """All numbers are the same, and the table moves to standard error for ``-`` and no file."""
    path = tmp_path / "fall.json"
    arguments = ["compare", "fall", "--against", "xpbd", "--frames", "1", "--json"]
    assert main([*arguments, str(path)]) == 0
    assert rows(capsys.readouterr().out)["step"].split() == ["4.167", "ms", "4.167", "ms"]
    assert main([*arguments, "-"]) == 0
    assert json.loads(capsys.readouterr().out)["distance_max"]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert "4.167 ms" in printed.err
    found, written = json.loads(printed.out), json.loads(path.read_text())
    assert found["distance_max"] == written["distance_max"]
    assert len(written["time"]) == 2


def test_solvers_that_can_be_named_are_those_that_are_measured():
    """The command line knows the names before Newton is imported."""
    assert names.TIMED == (*PEERS, MJ_STEP)
    assert names.REFINED == tuple(MEASURED)


def test_compare_drives_a_file_by_the_same_controls(tmp_path, capsys):
    """A hinge without contacts, by a motor: backward Euler is within 2 % of MuJoCo at 1 kHz."""
    path = tmp_path / "arm.xml"
    path.write_text(
        """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
        <inertial pos="0.2 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody>
        <actuator><motor joint="hinge" gear="5"/></actuator></mujoco>"""
    )
    arguments = ["--solver", "mujoco", "--frames", "10", "--dt", "0.001"]
    for kind in ("sine", "random"):
        assert main(["compare", str(path), "--ctrl", kind, *arguments, "--json", "-"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert 0.0 < found["distance_max"][-1] < 0.02 * 0.2
        assert [course["solver"] for course in found["courses"]] == ["mujoco", "avbd"]
        assert all(course["speed"][-1] > 0.0 for course in found["courses"])
        # controls that a step holds are late by half of it, by 0.5 ms at 1 kHz, of 167 ms
        assert all(0.0 < course["step_error"] < 0.02 * 0.2 for course in found["courses"])
    assert main(["compare", str(path), "--ctrl", "sine", *arguments]) == 0
    assert "Farthest apart in the end is body" in capsys.readouterr().out
    assert main(["compare", str(path), "--ctrl", "sine", "--against", "vbd"]) == 2
    assert "compare these two" in capsys.readouterr().err
    assert main(["compare", str(path), "--ctrl", "keyframe", *arguments]) == 2
    assert "no keyframe with 1 controls" in capsys.readouterr().err
    assert main(["compare", "fall", "--ctrl", "sine"]) == 2
    keys = '<mujoco><keyframe><key qpos="0"/><key ctrl="0.5"/></keyframe></mujoco>'
    (tmp_path / "keys.xml").write_text(keys)
    whole = path.read_text().replace("<mujoco>", '<mujoco><include file="keys.xml"/>')
    path.write_text(whole)
    assert main(["compare", str(path), "--ctrl", "keyframe", *arguments, "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["moved"][1] > 0.01


@pytest.mark.parametrize("flag", ["contact", "constraint"])
def test_compare_leaves_out_contacts_that_a_file_turns_off(flag, tmp_path, capsys):
    """A pendulum within the ground, of 0.2 m, swings in both solvers alike: 2 % of that.

    Past its limit, too, where constraints are off. Of what is heeded nothing is said.
    """
    path = tmp_path / "arm.xml"
    limit = 'limited="true" range="0 1"' if flag == "constraint" else ""
    path.write_text(
        f"""<mujoco><option><flag {flag}="disable"/></option><worldbody>
        <geom type="plane" size="1 1 1"/><body><joint name="hinge" axis="0 -1 0" {limit}/>
        <geom type="sphere" size="0.05" pos="0.2 0 0" mass="1"/></body></worldbody>
        <actuator><motor joint="hinge"/></actuator></mujoco>"""
    )
    arguments = ["--against", "mujoco", "--ctrl", "sine", "--frames", "10", "--dt", "0.001"]
    assert main(["compare", str(path), *arguments, "--json", "-"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found["moved"][0] > 0.1
    assert found["distance_max"][-1] < 0.02 * 0.2
    assert "flag" not in err
    # a study's model has nothing that could collide
    assert read_scene(str(path))[0].model(device="cpu").shape_contact_pair_count == 0


def test_actuators_that_no_importer_reads_are_named(tmp_path, capsys):
    path = tmp_path / "arm.xml"
    path.write_text(
        """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
        <inertial pos="0.2 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody><actuator>
        <motor joint="hinge"/><pid name="servo" joint="hinge"/></actuator></mujoco>"""
    )
    for driven in ([], ["--ctrl", "sine"]):
        arguments = ["compare", str(path), "--against", "mujoco", "--frames", "1", *driven]
        assert main(arguments) == 0
        assert "without 1 actuator ('servo' (<pid>))" in capsys.readouterr().err


def test_compare_prints_a_table_and_plots(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    path, page = tmp_path / "fall.png", tmp_path / "fall.html"
    files = ["--png", str(path), "--html", str(page)]
    assert main(["compare", "fall", "--against", "xpbd", "--frames", "2", *files]) == 0
    text = capsys.readouterr().out
    assert rows(text)["step"].split() == ["4.167", "ms", "4.167", "ms"]
    # SolverXPBD falls g h t/2 farther than along the parabola, which SolverAVBD keeps to.
    ahead = 1.0e3 * 0.5 * 9.81 / 240.0 / 30.0
    assert float(rows(text)["0.0333 s"].split()[0]) == pytest.approx(ahead, rel=1.0e-3)
    assert path.read_bytes().startswith(PNG)
    # The page needs no other file, and says the same.
    written = page.read_text()
    assert html.escape(text.strip()) in written
    assert written.count("<svg") == written.count("</svg>") == 1
    assert "processor: " in written


@pytest.mark.parametrize(("name", "start"), [("a.svg", b"<?xml"), ("a.PDF", b"%PDF"), ("a", PNG)])
def test_the_ending_says_which_kind_of_plot(name, start, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    course = Course("avbd", *([0.0, 0.0] for _ in range(3)))
    comparison = Comparison(
        "fall", 1, (0.1, 0.1), [0.0, 0.1], (course, course), [0.0] * 2, [0.0] * 2
    )
    done = (comparison, SimpleNamespace(happened=False, status=int))
    monkeypatch.setattr("newton_avbd.commands.compare._compare", lambda *_: done)
    assert main(["compare", "fall", "--png", str(tmp_path / name)]) == 0
    assert (tmp_path / name).read_bytes().startswith(start)


def test_a_kind_of_plot_that_there_is_not_is_told_before_the_work(capsys):
    pytest.importorskip("matplotlib")
    assert main(["compare", "fall", "--png", "a.docx"]) == 2
    assert "cannot draw a.docx: its ending is none of" in capsys.readouterr().err


def test_compare_opens_an_example_with_both_solvers(capsys):
    pyramid = ["--", "--num-pyramids", "1", "--pyramid-size", "2"]
    arguments = ["compare", "newton:pyramid", "--against", "xpbd", "--frames", "2", *pyramid]
    assert main(arguments) == 0
    table = rows(capsys.readouterr().out)
    assert table["the example's own test"].split() == ["passed", "passed"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "pyramide"], "Did you mean pyramid"),
        (["run", "fall", "--device", "cuda:99"], "there are: cpu"),
        (["run", "fall", "--solver", "kamino", "--iterations", "3"], "no iterations"),
        (["run", "fall", "--viewer", "usd", "--png", "a.png"], "--png goes with"),
        (["run", "fall", "--png", "a.txt"], "such as .png"),
        (["run", "missing.urdf"], "missing.urdf: no such file"),
        (["compare", "fall", "--frames", "1", "--png", "/no/folder/a.png"], "mkdir -p /no/folder"),
        (["bench", "stack", "--json", "/no/folder/a.json"], "mkdir -p /no/folder"),
        (["learning", "hopper"], "Did you mean"),
        (["falls", "missing.urdf"], "no robot or file"),
        (["run", "chain", "--accuracy", "1e-9"], "the smallest is"),
        (["compare", "chain", "--accuracy", "1e-9"], "the smallest is"),
    ],
)
def test_what_cannot_be_done_is_told_in_a_sentence(arguments, message, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "fall", "--framess", "3"], "did you mean --frames?"),
        (["run", "fall", "--solver", "avdb"], "'avbd', 'vbd'"),
        (["run", "fall", "--frames", "0"], "'0' is not a whole number above zero"),
        (["run", "fall", "--dt", "inf"], "'inf' is not a number above zero"),
        (["jump"], "run"),
        (["rnu"], "did you mean run?"),
        (["bench", "stack", "--solvers", "avbd", "bullet"], "'avbd', 'vbd'"),
        (["accuracy", "--ask", "stack", "--solvers", "nobody"], "'avbd', 'vbd'"),
    ],
)
def test_unknown_arguments_show_the_known_ones(arguments, message, capsys):
    with pytest.raises(SystemExit) as exit:
        main(arguments)
    assert exit.value.code == 2
    assert message in capsys.readouterr().err


def test_every_command_lists_examples_that_its_parser_takes():
    for name, command in COMMANDS.items():
        assert command.examples
        for typed, _ in command.examples:
            if typed != "--list":  # which ends
                parse(name, shlex.split(typed))


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on this machine")
@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("ru", "run"),
        ("run --pn", "--png"),
        ("falls --scheme gen", "generalized_alpha"),
        ("run domino_s", "domino_spiral"),
        ("compare newton:py", "pyramid"),  # readline keeps what stands before a colon
        ("effects robot:nv_a", "nv_ant"),
        ("falls --scheme=gen", "generalized_alpha"),
        ("run pyramid.", ""),  # the shell completes files where nothing else fits
        ("run heavy", "heavy_on_light heavy.xml"),
        ("run --png heavy", ""),
        ("accuracy heavy", "heavy_on_light"),
        ("properties fri", "friction"),
        ("falls nv_a", "nv_ant"),
        ("bench stack --solvers avbd mj", "mj_step"),
        ("learning gymnasium/Ant", "gymnasium/Ant-v5"),
        ("x y", ""),
    ],
)
def test_the_tab_key_completes(typed, completed, tmp_path, capfd):
    (tmp_path / "heavy.xml").touch()
    assert main(["--completion"]) == 0
    line = f"newton-avbd {typed}"
    words = f"COMP_WORDS=({line}) COMP_CWORD={len(typed.split())} COMP_LINE={line!r}"
    shell = f"""breaks=$COMP_WORDBREAKS
{capfd.readouterr().out}
{words} COMP_POINT={len(line)}; _newton_avbd; echo "${{COMPREPLY[*]}}"
[ "$breaks" = "$COMP_WORDBREAKS" ] || echo "other word breaks" """
    arguments = {"capture_output": True, "text": True, "check": True, "cwd": tmp_path}
    run = subprocess.run(["bash", "-c", shell], **arguments)
    assert (" ".join(run.stdout.split()), run.stderr) == (completed, "")


def test_without_a_command_they_are_listed(capsys):
    assert main([]) == 0
    printed = capsys.readouterr().out
    assert all(f"  {name} " in printed for name in COMMANDS)


@pytest.mark.parametrize("frames", [0, 2])
def test_ctrl_c_leaves_what_is_done(frames, monkeypatch, capsys):
    advance = ModelSimulation.advance
    calls = iter(range(100))

    def advance_until(simulation):
        if next(calls) == calls_until:
            raise KeyboardInterrupt
        advance(simulation)

    monkeypatch.setattr(ModelSimulation, "advance", advance_until)
    calls_until = frames
    assert main(["run", "fall"]) == 130
    table = rows(capsys.readouterr().out)
    # Free fall from rest for so many frames.
    speed = float(table["largest speed at the end"].split()[0])
    assert speed == pytest.approx(9.81 * frames / 60, abs=1.0e-3)
    # In the second of two simulations: the frame that it cuts short is left out.
    calls, calls_until = iter(range(100)), 2 * frames + 1
    assert main(["compare", "fall", "--against", "xpbd", "--json", "-"]) == 130
    result = json.loads(capsys.readouterr().out)
    assert len(result["time"]) == len(result["distance_max"]) == frames + 1
    assert len(result["courses"][1]["speed"]) == frames + 1


def test_ctrl_c_leaves_the_table_of_effects(monkeypatch, capsys):
    calls = iter(range(100))

    def advance(simulation):
        if next(calls) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(ModelSimulation, "advance", advance)
    assert main(["effects", "fall", "--measure"]) == 130
    printed = capsys.readouterr()
    assert printed.out.splitlines()[0].split() == ["effect", "bytes", "why"]
    assert "this is what was done" in printed.err


@pytest.mark.parametrize("command", ["run", "compare", "effects"])
def test_a_command_opens_its_scene_as_asked(command, monkeypatch):
    requests = []

    def open_scene(name, request):
        requests.append(request)
        raise UserError("that is all")

    monkeypatch.setattr(f"newton_avbd.commands.{command}.open_scene", open_scene)
    settings = ["--accuracy", "1e-3", "--dt", "0.01", "--iterations", "7"]
    assert main([command, "fall", *settings]) == 2
    (request,) = requests
    assert (request.accuracy, request.dt, request.iterations) == (1e-3, 0.01, 7)


def test_ctrl_c_ends_a_study_with_its_summary(monkeypatch, capfd):
    def interrupt(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("newton_avbd.commands.robots.try_robot", interrupt)
    assert main(["robots", "nv_ant"]) == 130
    printed = capfd.readouterr()
    assert "0 of 0 robots pass" in printed.out
    assert "stopped by Ctrl-C" in printed.err


def test_warnings_of_one_kind_take_one_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "warnoptions", [])
    with gathered_warnings():
        for number in range(5):
            warnings.warn(f"mesh 'part{number}.obj' has {number} triangles", stacklevel=1)
        warnings.warn("another", stacklevel=1)
    first, second = capsys.readouterr().err.splitlines()
    assert "part0.obj" in first and "4 more of this kind" in first
    assert second == "newton-avbd: warning: another"


def test_what_kernels_print_leaves_standard_output_to_the_answer(capfd):
    with gathered_prints():
        for count in (66, 65, 66):
            os.write(1, f"contact buffer overflowed {count} > 64\n".encode())
    print("{}")
    printed = capfd.readouterr()
    assert printed.out == "{}\n"
    note = "newton-avbd: contact buffer overflowed 66 > 64 (and 2 more of this kind)"
    assert printed.err.splitlines() == [note]


def test_progress_is_shown_on_a_terminal_only(capsys):
    assert list(progress(range(3), 3, "frames")) == [0, 1, 2]
    assert capsys.readouterr().err == ""


def test_what_takes_seconds_is_shown_on_a_terminal_only(monkeypatch, capsys):
    for is_terminal, shown in ((False, ""), (True, "\r\033[Kreading fall ...\r\033[K")):
        monkeypatch.setattr(sys.stderr, "isatty", lambda is_terminal=is_terminal: is_terminal)
        open_scene("fall", Request())
        assert capsys.readouterr().err == shown


def test_viewer_auto_takes_what_is_there(monkeypatch, capsys):
    installed = {"pyglet", "imgui_bundle", "viser"}
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name in installed or None)
    monkeypatch.setattr(view, "_has_display", lambda: True)
    assert view.choose_viewer() == "gl"
    monkeypatch.setattr(view, "_has_display", lambda: False)
    assert view.choose_viewer() == "viser"
    installed.clear()
    assert main(["run", "fall", "--viewer", "auto"]) == 2
    assert "pip install 'newton-avbd[view]'" in capsys.readouterr().err


def test_missing_extra_names_the_command_that_installs_it(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["run", "fall", "--png", str(tmp_path / "a.png")]) == 2
    assert "pip install 'newton-avbd[view]'" in capsys.readouterr().err
    assert main(["compare", "fall", "--png", str(tmp_path / "a.png")]) == 2
    assert "pip install 'newton-avbd[study]'" in capsys.readouterr().err


def test_a_scene_that_needs_an_extra_names_it(monkeypatch, capsys):
    """Newton's importers name no module in their error, but in its cause."""

    def fail(builder, *args, **options):
        raise ImportError("install USD") from ModuleNotFoundError("no pxr", name="pxr")

    monkeypatch.setattr(newton.ModelBuilder, "add_usd", fail)
    for command in (["run", "cartpole"], ["effects", "cartpole"]):
        assert main(command) == 2
        assert "pip install 'newton-avbd[scenes]'" in capsys.readouterr().err


def test_module_runs_as_a_program():
    command = [sys.executable, "-m", "newton_avbd", "run", "--list"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "\n  card_house        a house of cards" in done.stdout
    assert "\n  basic_shapes\n" in done.stdout
    assert "\n  newton:pyramid\n" in done.stdout
    assert "\n  robot:nv_ant" in done.stdout
