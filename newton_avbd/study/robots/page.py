# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The page of the gallery of robots, and the file of numbers behind it."""

import json
from dataclasses import asdict
from pathlib import Path
from statistics import median

import numpy as np

from newton_avbd.study.peers import MJ_STEP, PEERS
from newton_avbd.study.robots.trial import BLEW_UP, SOLVERS, Report

PICTURES = Path("images") / "robots"
"""Folder of the pictures, beside the page."""

MONTAGE = Path("images") / "robots.jpg"
"""Some of the pictures in one, beside the page."""

SHOWN = (
    ("anymal_c", "panda", "pr2", "laikago", "so101"),
    ("hyq", "tiago", "allegro_right_hand", "centauro", "b1-z1"),
    ("iris", "baxter", "nv_ant", "dm_control/dog", "ur5_robot"),
)
"""Robots of that picture, by row."""

_INTRODUCTION = """# Robots

Written by `newton-avbd robots --output docs`. Each robot is imported as its file has it: no welded
links are merged. It floats and is lowered to the ground, or it is bolted down, clear of the ground.
Meshes collide as their convex hulls. Links that are welded together, or are neighbors through
welds, do not collide, as in MuJoCo and as if they were merged. Nor do pairs of shapes that overlap
in the first pose. Position drives hold the first pose for 2 s, or up to 4 s until the robot has
come to rest. Their gains are the file's. If it has none, they are those of a critically damped
spring of 4 Hz that carries the inertia beyond the joint. Then all drives follow slow sines within
their limits for 1.5 s, at 240 steps a second.

A robot passes if all numbers stay finite; every joint, welds included, stays closed to 0.1 mm and
1 mrad; limits are kept to 1 mrad; contact forces and momentum balance the weight to 1 %; nothing
hangs in mid-air; after the hold nothing moves faster than 0.1 m/s, or than twice its speed with
SolverMuJoCo; and the drives move right. A drive moves right if it stays at most 20 mrad further
behind its target than with SolverMuJoCo, or, if MuJoCo refuses the robot, than its law predicts.
Two simulators need not make the same motion of a robot: a foot sticks in one and creeps in the
other, or the robot falls over at another time. So a drive that stays further behind moves right,
too, if the force along its axis is that of its law, to 2 %. This force follows from how fast the
links beyond the drive gain momentum, less gravity and contact forces. A difference is no error if
friction, position limits or velocity limits explain it, of the drive's joint or of joints that
mimic it. For example, the tip of a thumb mimics the thumb's joint 2.4 times as far: the tip's limit
of 0.5 rad/s lets the drive turn the joint at 0.21 rad/s. MuJoCo has no limits of velocity.
"""

_PLOT = """\
Choose what was measured.

```{study-plot} robots
```
"""
"""What the site shows as a plot with a menu."""

_TIMES = """\
Times are of one step while the robot holds its first pose, without collision detection, in
microseconds: replayed from a graph for SolverAVBD, SolverXPBD and SolverVBD, bare calls for
`mj_step`, plain calls from Python for SolverMuJoCo, on one core. MuJoCo is given the same robot;
where it refuses massless links, with welded links merged. A star marks a solver that blew up.
"""


_USD = """# Robots as USD

The robots of [robots.md](robots.md) that come as URDF or MJCF files, turned into USD by Newton's
converters, `urdf-usd-converter` and `mujoco-usd-converter`, and tried likewise.
"""


def picture(name: str) -> Path:
    """Path of a robot's picture, beside the page."""
    return PICTURES / f"{name.replace('/', '_')}.jpg"


def line(report: Report) -> str:
    """A robot in a line of a terminal."""
    times = "  ".join(
        f"{solver} {1e6 * report.times[solver]:.3g}" for solver in SOLVERS if solver in report.times
    )
    verdict = "; ".join(report.failures) if report.failures else "passes"
    return f"{report.name:<28} {verdict}  [us: {times}]"


def summary(reports: list[Report]) -> str:
    """How many robots pass, and how their times compare with those of ``mj_step``."""
    passed = sum(not report.failures for report in reports)
    text = f"{passed} of {len(reports)} robots pass."
    ratios = sorted(
        (report.times["avbd"] / report.times[MJ_STEP], report.name)
        for report in reports
        if {"avbd", MJ_STEP} <= set(report.times)
    )
    if not ratios:
        return f"{text} Their steps were not timed."
    values = [ratio for ratio, _ in ratios]
    above = [f"{name} ({ratio:.2g})" for ratio, name in reversed(ratios) if ratio > 1.0]
    text += (
        f" SolverAVBD takes {median(values):.2f} times as long as `mj_step` in the median of "
        f"{len(values)} robots, {np.exp(np.mean(np.log(values))):.2f} in the geometric mean."
    )
    return text + (f" It takes longer on {', '.join(above)}." if above else "")


def read_reports(folder: Path, stem: str = "robots") -> dict[str, Report]:
    """Reports of earlier runs in ``folder``, by name."""
    file = folder / f"{stem}.json"
    if not file.exists():
        return {}
    entries = json.loads(file.read_text())
    return {entry["name"]: Report(**{**entry, "links": tuple(entry["links"])}) for entry in entries}


def write_page(
    folder: Path, reports: list[Report], machine: dict[str, str], stem: str = "robots"
) -> Path:
    """Write the page and the numbers.

    Args:
        folder: Where to; pictures lie below it.
        reports: All robots, in the order of the page.
        machine: What the numbers were measured on and with.
        stem: Name of the page and of the file of numbers; ``robots_usd`` for robots as USD.

    Returns:
        The page.

    Raises:
        OSError: It cannot be written.
    """
    entries = [asdict(report) for report in reports]
    (folder / f"{stem}.json").write_text(json.dumps(entries, indent=1, allow_nan=True) + "\n")
    is_usd = stem != "robots"
    parts = [_USD if is_usd else "", _INTRODUCTION, f"{summary(reports)}\n"]
    if is_usd:
        parts[1] = parts[1].partition("\n")[2].replace("docs`", "docs --usd`")
    timed = [solver for solver in SOLVERS if any(solver in report.times for report in reports)]
    if timed:
        parts.insert(2, _TIMES)
    if not is_usd:
        parts.append(_PLOT)
    for package in dict.fromkeys(report.package for report in reports):
        rows = [_row(folder, report, timed) for report in reports if report.package == package]
        titles = [PEERS[solver].title if solver in PEERS else "`mj_step`" for solver in timed]
        head = ["", "robot", "links", "massless", "drives", "base", "result", *titles]
        head += ["/ `mj_step`"] if timed else []
        parts.append(f"## {package}\n\n| {' | '.join(head)} |\n|{' --- |' * len(head)}")
        parts[-1] += "".join(f"\n| {' | '.join(row)} |" for row in rows) + "\n"
    parts.append("\n".join(f"- {name}: {value}" for name, value in machine.items()) + "\n")
    page = folder / f"{stem}.md"
    page.write_text("\n".join(parts).lstrip("\n"))
    return page


def write_montage(folder: Path) -> Path | None:
    """Put the pictures of :data:`SHOWN` into one.

    Args:
        folder: That of the page; pictures lie below it.

    Returns:
        The picture; None where one of its parts has not been drawn.
    """
    from PIL import Image

    paths = [[folder / picture(name) for name in row] for row in SHOWN]
    if not all(path.exists() for row in paths for path in row):
        return None
    rows = [[Image.open(path) for path in row] for row in paths]
    width, height = rows[0][0].size
    whole = Image.new("RGB", (width * len(rows[0]), height * len(rows)))
    for i, row in enumerate(rows):
        for j, image in enumerate(row):
            whole.paste(image, (width * j, height * i))
    whole.save(folder / MONTAGE, quality=90)
    return folder / MONTAGE


def _row(folder: Path, report: Report, timed: list[str]) -> list[str]:
    """Cells of a robot, with times of the solvers that were timed on any robot of the page."""
    image = picture(report.name)
    shown = f"![{report.name}]({image.as_posix()})" if (folder / image).exists() else ""
    links, massless, drives = report.links
    verdict = "; ".join(report.failures) if report.failures else "passes"
    times = [
        f"{1e6 * report.times[solver]:.3g}" + ("*" if report.notes.get(solver) == BLEW_UP else "")
        if solver in report.times
        else "-"
        for solver in timed
    ]
    ours, theirs = (report.times.get(solver) for solver in ("avbd", MJ_STEP))
    if timed:
        times.append(f"{ours / theirs:.2f}" if ours and theirs else "-")
    numbers = [str(links), str(massless), str(drives), report.base]
    return [shown, f"`{report.name}`", *numbers, verdict.replace("|", "\\|"), *times]
