# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The outcomes of hard cases as lines on a terminal and as an HTML page with pictures."""

import html
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from newton_avbd.study.stability.case import Case, Outcome
from newton_avbd.study.stability.cases import CASES, GROUPS

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")
"""Colors of solvers in a plot, told apart by every kind of color vision."""

QUANTITIES = ("penetration", "rest", "joint", "gain", "share", "drift")
"""Columns that have a bound."""

_STYLE = """\
body { font: 15px/1.4 sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em; }
table { border-collapse: collapse; margin: .5em 0; }
th, td { padding: .1em .8em; text-align: right; }
th:first-child, td:first-child { text-align: left; }
th { border-bottom: 1px solid #888; }
.over { color: #b00; font-weight: bold; }
img { max-width: 100%; }
h3 { margin: 1.5em 0 .2em; }
"""

_INTRODUCTION = """\
<p>Scenes that are known to be hard, on a CPU. <em>Penetration</em> is the deepest in any sample,
<em>rest</em> that in the last one;
<em>joint</em> the largest distance between the anchors of a joint along what it locks;
<em>gain</em> the energy that came from nowhere, as the height to which it would lift all bodies;
<em>share</em> the same as a share of what was there: kinetic energy at the start, potential energy
that is spent later, and what lifts each body by its radius of gyration;
<em>drift</em> what the case says, or how far a body has moved from its start; <em>time</em> the
median of a step with its collision detection. Bounds follow from the physics of each case, not
from what a solver reaches; numbers above them are red.</p>"""


def line(case: Case, outcome: Outcome) -> str:
    """One line for a terminal."""
    failures = outcome.failures(case.bounds)
    cells = [f"{case.name:24} {outcome.solver:7}", "ok  " if not failures else "FAIL"]
    if not math.isnan(outcome.milliseconds):
        cells += [f"{name} {value(case, outcome, name):<11}" for name in QUANTITIES]
        cells.append(f"time {outcome.milliseconds:.3g} ms")
    if failures:
        cells.append(f"<- {', '.join(failures)}")
    return "  ".join(cells)


def value(case: Case, outcome: Outcome, name: str) -> str:
    """A quantity of an outcome with its unit."""
    number = getattr(outcome, name)
    if number is None:
        return "-"
    return quantity(number, _unit(case, name))


def _unit(case: Case, name: str) -> str:
    return {"drift": case.drift_unit, "share": ""}.get(name, "m")


def quantity(number: float, unit: str) -> str:
    """A number with its unit; lengths in millimeters."""
    if not math.isfinite(number):
        return "not finite"
    return f"{1e3 * number:.3g} mm" if unit == "m" else f"{number:.3g} {unit}".strip()


def write_page(outcomes: Sequence[Outcome], folder: Path) -> Path:
    """Write ``index.html``, a picture for each case and ``outcomes.json`` into a folder; return the
    page's path.

    Raises:
        OSError: A file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = [
        "<!DOCTYPE html><html lang='en'><meta charset='utf-8'><title>Hard cases</title>",
        f"<style>{_STYLE}</style><h1>Hard cases</h1>{_INTRODUCTION}",
        _summary(outcomes),
    ]
    for group, catalog in GROUPS.items():
        tried = [name for name in catalog if any(o.case == name for o in outcomes)]
        if tried:
            parts.append(f"<h2>{html.escape(group)}</h2>")
        for name in tried:
            found = [outcome for outcome in outcomes if outcome.case == name]
            draw(found, folder / f"{name}.png")
            parts.append(_section(CASES[name], found))
    page = folder / "index.html"
    page.write_text("\n".join(parts) + "</html>\n", encoding="utf-8")
    numbers = json.dumps([as_json(outcome) for outcome in outcomes], indent=1)
    (folder / "outcomes.json").write_text(numbers + "\n", encoding="utf-8")
    return page


def as_json(outcome: Outcome) -> dict[str, Any]:
    """The numbers of an outcome in SI units, each with its bound; None for what is not finite."""
    bounds = CASES[outcome.case].bounds
    numbers: dict[str, Any] = {}
    for name in QUANTITIES:
        number, bound = getattr(outcome, name), getattr(bounds, name)
        if number is not None:
            is_finite = math.isfinite(number)
            numbers[name] = {"value": float(f"{number:.3g}") if is_finite else None, "bound": bound}
    time = outcome.milliseconds
    return {
        "case": outcome.case,
        "solver": outcome.solver,
        "failures": outcome.failures(bounds),
        "milliseconds": float(f"{time:.3g}") if math.isfinite(time) else None,
        **numbers,
    }


def draw(outcomes: Sequence[Outcome], path: Path) -> None:
    """Draw penetration or joint error, and energy, over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 2.6), layout="constrained")
    error, energy = figure.subplots(1, 2)
    jointed = any(outcome.separations for outcome in outcomes)
    touching = any(any(outcome.penetrations) for outcome in outcomes)
    for i, outcome in enumerate(outcomes):
        style = {"color": COLORS[i % len(COLORS)]}
        if touching or not jointed:
            values = [1e3 * depth for depth in outcome.penetrations]
            error.plot(outcome.times, values, label=outcome.solver, **style)
        if outcome.separations:
            values = [1e3 * gap for gap in outcome.separations]
            label = f"{outcome.solver}, joints"
            error.plot(outcome.times, values, linestyle=":", label=label, **style)
        energy.plot(outcome.times, outcome.energies, label=outcome.solver, **style)
    error.set_ylabel("penetration, joints [mm]")
    # Solvers differ by orders of magnitude; below a micrometer it is rounding.
    error.set_yscale("symlog", linthresh=1e-3)
    error.set_ylim(bottom=0.0)
    energy.set_ylabel("energy / weight [m]")
    for axes in (error, energy):
        axes.set_xlabel("time [s]")
    if outcomes:
        error.legend(fontsize="small")
    figure.savefig(path, dpi=90)


def _summary(outcomes: Sequence[Outcome]) -> str:
    """How many cases each solver passes."""
    rows = []
    for solver in dict.fromkeys(outcome.solver for outcome in outcomes):
        mine = [outcome for outcome in outcomes if outcome.solver == solver]
        passed = sum(not outcome.failures(CASES[outcome.case].bounds) for outcome in mine)
        finite = sum(outcome.finite for outcome in mine)
        rows.append([solver, str(len(mine)), str(finite), str(passed)])
    return _table(["solver", "cases", "finite", "within bounds"], rows)


def _section(case: Case, outcomes: Sequence[Outcome]) -> str:
    """Table and picture of one case."""
    head = ["solver", *QUANTITIES, "time", ""]
    limits = [getattr(case.bounds, name) for name in QUANTITIES]
    units = [_unit(case, name) for name in QUANTITIES]
    bounds = ["-" if b is None else quantity(b, u) for b, u in zip(limits, units, strict=True)]
    rows = [["bound", *bounds, "", ""]]
    for outcome in outcomes:
        failures = outcome.failures(case.bounds)
        cells = [outcome.solver]
        for name in QUANTITIES:
            text = html.escape(value(case, outcome, name))
            cells.append(f"<span class='over'>{text}</span>" if name in failures else text)
        cells.append("-" if math.isnan(outcome.milliseconds) else f"{outcome.milliseconds:.3g} ms")
        cells.append(f"<span class='over'>{html.escape(outcome.note)}</span>")
        rows.append(cells)
    summary = html.escape(f"{case.summary}, {case.seconds:g} s")
    return (
        f"<h3 id='{case.name}'>{case.name}</h3>{summary}{_table(head, rows)}"
        f"<img src='{case.name}.png' alt='penetration and energy over time'>"
    )


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """An HTML table; cells are HTML."""
    lines = ["".join(f"<th>{cell}</th>" for cell in head)]
    lines += ["".join(f"<td>{cell}</td>" for cell in row) for row in rows]
    return "<table>" + "".join(f"<tr>{row}</tr>" for row in lines) + "</table>"
