# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Sphinx directive ``study-plot``: an interactive plot of what a study's JSON files hold.

The site serves plotly's script itself, so that plots work without a network.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from docutils import nodes
from plotly.offline import get_plotlyjs
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from newton_avbd.study.accuracy.front import front, usable
from newton_avbd.study.accuracy.page import COLORS
from newton_avbd.study.accuracy.run import Point
from newton_avbd.study.accuracy.scenes import ACCURACY_SCENES
from newton_avbd.study.accuracy.solvers import MEASURED, Setting
from newton_avbd.study.bench.growth import QUANTITIES
from newton_avbd.study.bench.targets import COLD_START
from newton_avbd.study.peers import PEERS
from newton_avbd.study.properties.run import GROUPS
from newton_avbd.study.robots.trial import ALIGNED, CLOSED, MOVING, WEIGHT, WRONG
from newton_avbd.study.stability.page import QUANTITIES as BOUNDED

DOCS = Path(__file__).parent
SCRIPT = "plotly.min.js"
FIT = """
new ResizeObserver(() => Plotly.Plots.resize("{plot_id}"))
    .observe(document.getElementById("{plot_id}"));
"""
"""The page gets its columns after the plot is drawn, and then the plot is too wide."""


def accuracy() -> go.Figure:
    """Error against cost: a scene at a time, all settings as points, the best of them as a line."""
    files = [DOCS / "accuracy" / f"{scene}.json" for scene in ACCURACY_SCENES]
    scenes = [file.stem for file in files if file.exists()]
    figure, owners = go.Figure(), []
    for scene in scenes:
        stored = json.loads((DOCS / "accuracy" / f"{scene}.json").read_text())["points"]
        points = [Point(**point | {"setting": Setting(**point["setting"])}) for point in stored]
        for solver, measured in MEASURED.items():
            group = [p for p in usable(points) if p.solver == solver and p.error and p.cost]
            best = front(group)
            style = {"color": COLORS[solver]}
            for chosen, mode in ((group, "markers"), (best, "lines")):
                figure.add_scatter(
                    x=[point.cost for point in chosen],
                    y=[point.error for point in chosen],
                    mode=mode,
                    marker=style | {"size": 5},
                    line=style | {"shape": "hv"},
                    text=[str(point.setting) for point in chosen],
                    hovertemplate="%{text}<br>%{x:.3g} ms, error %{y:.2g}",
                    name=measured.title,
                    legendgroup=solver,
                    showlegend=mode == "lines" and bool(chosen),
                    visible=scene == scenes[0],
                )
                owners.append(scene)
    _choose(figure, owners, {scene: ACCURACY_SCENES[scene].summary for scene in scenes})
    figure.update_xaxes(type="log", title="computing for a simulated second [ms]")
    figure.update_yaxes(type="log", title="relative error", exponentformat="power")
    return figure


def growth() -> go.Figure:
    """Time and memory against the size of a scene, a quantity at a time."""
    points = json.loads((DOCS / "growth" / "growth.json").read_text())["points"]
    figure, owners = go.Figure(), []
    for quantity in QUANTITIES:
        for family in dict.fromkeys(point["family"] for point in points):
            chosen = [point for point in points if point["family"] == family]
            text = [f"{point['contacts']:,} contacts, {point['sweeps']} sweeps" for point in chosen]
            figure.add_scatter(
                x=[point["bodies"] for point in chosen],
                y=[point[quantity] for point in chosen],
                mode="lines+markers",
                text=text,
                hovertemplate="%{x:,} bodies, %{text}<br>%{y:.3g}",
                name=family,
                visible=quantity == next(iter(QUANTITIES)),
            )
            owners.append(quantity)
    _choose(figure, owners, QUANTITIES)
    figure.update_xaxes(type="log", title="bodies", exponentformat="power")
    figure.update_yaxes(type="log", exponentformat="power")
    return figure


def benchmarks() -> go.Figure:
    """Time and quality of solvers, a quantity at a time, over scenes."""
    quantities = {
        "replayed": ("time of a step, replayed from a graph [us]", 1e6),
        "eager": ("time of a plain step [us]", 1e6),
        "collided": ("time of a replayed step with its collision detection [us]", 1e6),
        "penetration": ("deepest penetration at the end [mm]", 1e3),
        "separation": ("largest distance of anchors that a joint holds together [mm]", 1e3),
    }
    results = json.loads((DOCS / "benchmarks.json").read_text())["results"]
    solvers = list(dict.fromkeys(result["solver"] for result in results))
    figure, owners = go.Figure(), []
    for quantity, (_, scale) in quantities.items():
        for solver in solvers:
            found = {}
            for result in results:
                quality = result["quality"] or {}
                value = (result | quality | (quality.get("joints") or {})).get(quantity)
                if result["solver"] == solver and value and result["scene"] != COLD_START:
                    found[result["scene"]] = scale * value
            _add_marks(figure, found, _title(solver), quantity == "replayed")
            owners.append(quantity)
    _choose(figure, owners, {name: title for name, (title, _) in quantities.items()})
    return _over_names(figure)


def stability() -> go.Figure:
    """Shares of the bounds that solvers reach in hard cases, a quantity and a rate at a time."""
    runs = {"": "own.json", ", 60 Hz": "60_hz.json"}
    figure, owners, titles = go.Figure(), [], {}
    for suffix, file in runs.items():
        outcomes = json.loads((DOCS / "stability" / file).read_text())
        solvers = list(dict.fromkeys(outcome["solver"] for outcome in outcomes))
        for quantity in BOUNDED:
            for solver in solvers:
                found, text = {}, {}
                for outcome in outcomes:
                    number = outcome.get(quantity)
                    if outcome["solver"] == solver and number and number["bound"]:
                        value = number["value"]
                        share = math.inf if value is None else value / number["bound"]
                        found[outcome["case"]] = min(max(share, 1e-4), 1e4)
                        text[outcome["case"]] = f"{value} of {number['bound']}"
                _add_marks(figure, found, _title(solver), not titles, text)
                owners.append(quantity + suffix)
            titles[quantity + suffix] = f"{quantity}{suffix}, as a share of its bound"
    _choose(figure, owners, titles)
    figure.add_hline(y=1.0, line={"color": "#888", "width": 1})
    return _over_names(figure)


def properties() -> go.Figure:
    """Who honours what: a group of properties at a time."""
    outcomes = json.loads((DOCS / "properties.json").read_text())
    verdicts = {(entry["property"], entry["solver"]): entry["verdict"] for entry in outcomes}
    solvers = list(dict.fromkeys(entry["solver"] for entry in outcomes))
    words = ("error", "ignored", "off", "yes")
    figure, owners = go.Figure(), []
    for group, catalog in GROUPS.items():
        names = [name for name in catalog if (name, solvers[0]) in verdicts]
        rows = [[verdicts.get((name, solver), "") for solver in solvers] for name in names]
        figure.add_heatmap(
            x=[_title(solver) for solver in solvers],
            y=names,
            z=[[_rank(verdict) for verdict in row] for row in rows],
            text=rows,
            hovertemplate="%{y}<br>%{x}: %{text}<extra></extra>",
            zmin=-0.5,
            zmax=3.5,
            colorscale=_steps(("#999999", "#e8e8e8", "#e69f00", "#0072b2")),
            colorbar={"tickvals": [0, 1, 2, 3], "ticktext": words, "thickness": 12},
            xgap=1,
            ygap=1,
            visible=not owners,
        )
        owners.append(group)
    _choose(figure, owners, {group: f"properties: {group}" for group in GROUPS})
    figure.update_yaxes(autorange="reversed", automargin=True, tickfont={"size": 10})
    return figure.update_layout(height=900)


def robots() -> go.Figure:
    """What the trial of each robot measured, a quantity at a time."""
    quantities = {
        "separation": (f"anchors of a joint apart [m], bound {CLOSED:g}", CLOSED),
        "misalignment": (f"a joint turned about what it locks [rad], bound {ALIGNED:g}", ALIGNED),
        "limit": (f"a limit passed [rad or m], bound {ALIGNED:g}", ALIGNED),
        "weight": (f"contact forces off the weight, as a share, bound {WEIGHT:g}", WEIGHT),
        "wrong": (f"share of a drive's force that is not its law's, bound {WRONG:g}", WRONG),
        "speed": (f"speed after the hold [m/s], bound {MOVING:g}", MOVING),
    }
    reports = json.loads((DOCS / "robots.json").read_text())
    packages = list(dict.fromkeys(report["package"] for report in reports))
    figure, owners = go.Figure(), []
    for quantity, (_, bound) in quantities.items():
        for package in packages:
            found, text = {}, {}
            for report in reports:
                value = report["numbers"].get(quantity)
                if report["package"] == package and value is not None:
                    found[report["name"]] = max(value, 1e-6 * bound)
                    text[report["name"]] = "; ".join(report["failures"]) or "passes"
            _add_marks(figure, found, package, quantity == "separation", text)
            owners.append(quantity)
    _choose(figure, owners, {name: title for name, (title, _) in quantities.items()})
    return _over_names(figure)


def _title(solver: str) -> str:
    return PEERS[solver].title if solver in PEERS else solver


def _rank(verdict: str) -> float | None:
    """Where the color of a verdict of ``newton-avbd properties`` is; None where it has none."""
    if not verdict:
        return None
    if verdict.startswith(("error", "not finite")):
        return 0.0
    return {"ignored": 1.0, "yes": 3.0}.get(verdict, 2.0)


def _steps(colors: tuple[str, ...]) -> list[tuple[float, str]]:
    """A color scale of equal steps."""
    n = len(colors)
    return [(at / n, color) for i, color in enumerate(colors) for at in (i, i + 1)]


def _add_marks(
    figure: go.Figure,
    values: dict[str, float],
    name: str,
    visible: bool,
    text: dict[str, str] | None = None,
) -> None:
    """Add a trace of values by name."""
    figure.add_scatter(
        x=list(values),
        y=list(values.values()),
        mode="markers",
        text=None if text is None else [text[key] for key in values],
        hovertemplate="%{x}<br>%{y:.3g}" + ("" if text is None else "<br>%{text}"),
        name=name,
        visible=visible,
    )


def _over_names(figure: go.Figure) -> go.Figure:
    """Give a figure a logarithmic axis over names."""
    figure.update_xaxes(tickangle=-60, tickfont={"size": 9}, automargin=True)
    figure.update_yaxes(type="log", exponentformat="power")
    return figure.update_layout(height=640)


def _choose(figure: go.Figure, owners: list[str], titles: Any) -> None:
    """Give the figure a menu that shows the traces of one owner at a time."""
    buttons = [
        {
            "label": owner,
            "method": "update",
            "args": [
                {"visible": [other == owner for other in owners]},
                {"title.text": titles[owner]},
            ],
        }
        for owner in dict.fromkeys(owners)
    ]
    figure.update_layout(
        updatemenus=[{"buttons": buttons, "x": 0, "xanchor": "left", "y": 1.16, "yanchor": "top"}],
        title={"text": titles[owners[0]], "x": 1, "xanchor": "right", "font": {"size": 13}},
        legend={"orientation": "h", "yref": "container", "y": 0, "yanchor": "bottom"},
        template="plotly_white",
        height=560,
        margin={"l": 60, "r": 20, "t": 90, "b": 110},
    )


PLOTS: dict[str, Callable[[], go.Figure]] = {
    plot.__name__: plot for plot in (accuracy, benchmarks, growth, stability, properties, robots)
}


class StudyPlot(SphinxDirective):
    """``study-plot`` with the name of one of :data:`PLOTS`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        if name not in PLOTS:
            raise self.error(f"there is no plot {name!r}; there are: {', '.join(PLOTS)}")
        self.env.note_dependency(str(DOCS / "plots.py"))
        up = "../" * self.env.docname.count("/")
        html = PLOTS[name]().to_html(
            full_html=False,
            include_plotlyjs=False,
            div_id=f"plot-{name}",
            config={"responsive": True},
            post_script=FIT,
        )
        script = f'<script src="{up}_static/{SCRIPT}"></script>'
        return [nodes.raw("", script + html, format="html")]


def _write_script(app: Sphinx, error: Exception | None) -> None:
    """Put plotly's script beside the site's own."""
    if error is None and app.builder.format == "html":
        folder = Path(app.outdir) / "_static"
        folder.mkdir(exist_ok=True)
        (folder / SCRIPT).write_text(get_plotlyjs())


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("study-plot", StudyPlot)
    app.connect("build-finished", _write_script)
    return {"parallel_read_safe": True}
