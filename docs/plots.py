# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Sphinx directive ``study-plot``: an interactive plot of what a study's JSON files hold.

The site serves plotly's script itself, so that plots work without a network.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from docutils import nodes
from plotly.offline import get_plotlyjs
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from newton_avbd.study.accuracy_front import front, usable
from newton_avbd.study.accuracy_page import COLORS
from newton_avbd.study.accuracy_run import Point
from newton_avbd.study.accuracy_scenes import ACCURACY_SCENES
from newton_avbd.study.accuracy_solvers import MEASURED, Setting
from newton_avbd.study.growth import QUANTITIES

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


PLOTS: dict[str, Callable[[], go.Figure]] = {"accuracy": accuracy, "growth": growth}


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
