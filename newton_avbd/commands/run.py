# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd run``: simulate a scene, watch it or not, and say how it went."""

import argparse
import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np

from newton_avbd.io.errors import UserError
from newton_avbd.io.names import AUTO
from newton_avbd.io.opening import open_scene
from newton_avbd.io.simulation import ModelSimulation, Request, Simulation
from newton_avbd.measure.overlaps import describe_overlaps
from newton_avbd.measure.state import Probe, deepest_penetration
from newton_avbd.report import InnerReport, Status

from ..io.options import check_writable, device_notes, use_device
from ..io.output import length, table
from ..io.terminal import gathered_warnings, interruptible, progress, say_notes
from . import view

TOUCHING = 1.0e-4
"""Gap below which a contact counts as touching [m]: what resting bodies keep of it or less."""


def main(args: argparse.Namespace) -> int:
    """Simulate, then print a table; returns the exit status."""
    check_writable(args.png)
    use_device(args.device)
    if args.viewer == AUTO:
        args.viewer = view.choose_viewer()
    viewer = _make_viewer(args)
    request = Request(
        solver=args.solver,
        iterations=args.iterations,
        dt=args.dt,
        viewer=None if viewer is None else lambda: viewer,
        arguments=args.arguments,
        accuracy=args.accuracy,
    )
    if args.accuracy is not None and args.solver != "avbd":
        raise UserError(f"--accuracy goes with --solver avbd, not with {args.solver}")
    camera = view.camera(viewer) if args.png else None
    with gathered_warnings():
        simulation = open_scene(args.scene, request)
    probe = Probe(simulation.model)
    notes = [*device_notes(args.device), *simulation.notes]
    say_notes([*notes, *describe_overlaps(probe.overlaps)])
    if args.viewer == "gl" and isinstance(simulation, ModelSimulation):
        view.look_at(viewer, simulation.model, simulation.state)
    # A window that is watched stays open until it is closed.
    endless = args.viewer in view.WINDOWS and args.frames is None
    frames = args.frames or simulation.frames
    count: Iterable[int] = itertools.count()
    if not endless:
        count = progress(range(frames), frames, simulation.name)
    with interruptible() as interruption:
        if args.viewer == "null":
            for _ in count:
                simulation.advance()
        else:
            _watch(simulation, viewer, count)
    if args.png:
        # where an example has put its camera it stays
        if args.viewer == "null" and view.camera(viewer) == camera:
            view.look_at(viewer, simulation.model, simulation.state)
        simulation.render()
        view.save_picture(viewer, args.png)
    if viewer is not None:
        viewer.close()
    # An example's test judges where it ends.
    verdict = None if interruption.happened else simulation.verdict()
    print(_report(simulation, probe, args.solver, verdict))
    return interruption.status(0 if verdict in (None, "passed") else 1)


def _make_viewer(args: argparse.Namespace) -> Any:
    """The viewer that the arguments ask for; None for none."""
    if args.png and args.viewer not in ("null", "gl"):
        raise UserError(f"--png goes with --viewer null or gl, not with {args.viewer}")
    if args.png:
        view.check_picture(args.png)
    if args.viewer == "null":
        return view.make_viewer("gl", args.scene, headless=True) if args.png else None
    return view.make_viewer(args.viewer, args.scene)


def _watch(simulation: Simulation, viewer: Any, count: Iterable[int]) -> None:
    """Simulate and show every frame until the frames are over or the window is closed."""
    for _ in count:
        if not viewer.is_running():
            return
        if viewer.should_step():
            simulation.advance()
        simulation.render()


def _accuracy(inner: InnerReport) -> list[tuple[str, str]]:
    """Rows of a table on what an accuracy led to."""
    rows = [
        ("accuracy asked for", f"{length(inner.asked)} a second"),
        ("error, by its own estimate", length(float(inner.total.max()))),
    ]
    if inner.missed.any():
        rows.append(("calls with too few inner steps", f"{int(inner.missed.sum())}"))
    return rows


def _report(simulation: Simulation, probe: Probe, solver: str, verdict: str | None) -> str:
    """Table of what was simulated, what it cost and where it ended."""
    gaps = probe.separations(simulation.state)
    solve, collide = simulation.timer.milliseconds_per_step()
    rows = [
        (f"{simulation.name}, {solver}", ""),
        ("bodies", f"{simulation.model.body_count}"),
        ("contacts, touching", f"{len(gaps)}, {int((gaps <= TOUCHING).sum())}"),
        ("step", f"{1e3 * simulation.dt:.4g} ms"),
        ("solver a step, median", f"{solve:.3f} ms"),
        ("collision detection a step", f"{collide:.3f} ms" if collide else "in the solver"),
        ("deepest penetration at the end", length(deepest_penetration(gaps))),
        ("largest speed at the end", f"{probe.speed(simulation.state):.4g} m/s"),
    ]
    if probe.overlaps:
        rows.insert(7, ("overlap of links, for good", length(probe.overlap(simulation.state))))
    status = getattr(getattr(simulation, "solver", None), "status", None)
    if isinstance(status, Status) and status.bounded_steps.any():
        lost = f"{np.sum(status.bounded_energy):.3g} J"
        rows.append(("energy bounded", f"{np.sum(status.bounded_steps)} times, {lost}"))
    if isinstance(status, Status) and simulation.solver.settings.accuracy is not None:
        rows += _accuracy(simulation.solver.report().inner)
    if isinstance(status, Status) and status.unbounded_steps.any():
        rows.append(("energy not bounded", f"{np.sum(status.unbounded_steps)} times"))
    if verdict is not None:
        rows.append(("the example's own test", verdict))
    return table(rows)
