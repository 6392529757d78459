# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd compare``: simulate a scene with two solvers from the same start, side by side."""

import argparse
import dataclasses
import html
import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from newton_avbd import SolverAVBD
from newton_avbd.io.errors import UserError, require
from newton_avbd.io.names import ACTUATED
from newton_avbd.io.opening import open_scene
from newton_avbd.io.simulation import Request, Simulation
from newton_avbd.measure.joints import Joints
from newton_avbd.measure.overlaps import describe_overlaps
from newton_avbd.measure.state import Probe, deepest_penetration, distances
from newton_avbd.study.bench.run import describe_machine

from ..io.options import check_writable, device_notes, use_device
from ..io.output import length, table, tables_beside, write_json, writing
from ..io.terminal import (
    Interruption,
    gathered_prints,
    gathered_warnings,
    interruptible,
    progress,
    say_notes,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = ("#0072b2", "#d55e00")
"""Colors of the two solvers in a plot, told apart by every kind of color vision."""
PASSED = 1.0e-4
"""How far a joint has to be past its limits to be named [m or rad]."""
_PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>{title}</title>
<style>
body {{ font: 15px/1.4 sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em; }}
svg {{ max-width: 100%; height: auto; }}
</style>
<h1>{title}</h1>
<pre>
{report}
</pre>
{plot}
<pre>
{machine}
</pre>
</html>
"""


@dataclass
class Course:
    """What one solver made of a scene.

    Attributes:
        solver: The solver's name.
        penetration: Deepest penetration at the end of each frame [m].
        energy: Kinetic and potential energy at the end of each frame [J].
        speed: Largest speed at the end of each frame [m/s].
        overlap: Deepest overlap of links that no joint can part, at the end of each frame [m];
            empty where there are none.
        solver_ms: Median time of a solver step [ms].
        collision_ms: Time of collision detection a step [ms]; 0 where the solver includes it.
        test: What the scene's own test says; None where it has none.
        step_error: Distance at the end between this run and one at half the step [m], of the body
            that is off most; None where no such run was made.
        estimated_error: What SolverAVBD estimates of the error that it was asked to keep to [m];
            None where it was not.
        passed: How far a joint was past its limits at the end of a frame, at most [m or rad], and
            its label; None where all were within.
        started_past: How far a joint was past its limits when the run began [m or rad].
    """

    solver: str
    penetration: list[float] = field(default_factory=list)
    energy: list[float] = field(default_factory=list)
    speed: list[float] = field(default_factory=list)
    overlap: list[float] = field(default_factory=list)
    solver_ms: float = 0.0
    collision_ms: float = 0.0
    test: str | None = None
    step_error: float | None = None
    estimated_error: float | None = None
    passed: tuple[float, str] | None = None
    started_past: float = 0.0

    def record(self, probe: Probe, simulation: Simulation, joints: Joints | None) -> None:
        """Add the simulation's present state."""
        state = simulation.state
        self.penetration.append(deepest_penetration(probe.separations(state)))
        self.energy.append(probe.energy(state))
        self.speed.append(probe.speed(state))
        if probe.overlaps:
            self.overlap.append(probe.overlap(state))
        if joints is None:
            return
        passed = joints.limit_violation(state.body_q.numpy().astype(float))
        if passed.max(initial=0.0) > max(PASSED, self.passed[0] if self.passed else 0.0):
            worst = int(np.argmax(passed))
            label = simulation.model.joint_label[joints.index[worst]]
            self.passed = (float(passed[worst]), label)
        if len(self.speed) == 1 and self.passed:
            self.started_past = self.passed[0]

    def close(self, simulation: Simulation) -> None:
        """Add what is known only at the end."""
        self.solver_ms, self.collision_ms = simulation.timer.milliseconds_per_step()
        self.test = simulation.verdict()
        solver = getattr(simulation, "solver", None)
        inner = solver.report().inner if isinstance(solver, SolverAVBD) else None
        if inner is not None:
            self.estimated_error = float(inner.total.max())


@dataclass
class Comparison:
    """Two solvers on one scene.

    Attributes:
        scene: The scene's name.
        bodies: Number of bodies.
        dt: Solver step of each solver [s].
        time: Time of each frame, the start included [s].
        courses: What each solver made of it.
        distance_max: Largest distance between the places that the two solvers give to a body's
            center of mass, in each frame [m].
        distance_median: Median of the same [m].
        body: Label of the body that the two put farthest apart at the end; None without bodies
            that move.
        moved: How far that body is from its start in each of the two [m].
    """

    scene: str
    bodies: int
    dt: tuple[float, float]
    time: list[float]
    courses: tuple[Course, Course]
    distance_max: list[float] = field(default_factory=list)
    distance_median: list[float] = field(default_factory=list)
    body: str | None = None
    moved: tuple[float, float] = (0.0, 0.0)

    def keep(self, count: int) -> None:
        """Keep ``count`` frames: Ctrl-C may have cut the record of one more short."""
        series = [self.time, self.distance_max, self.distance_median]
        for course in self.courses:
            series += [course.penetration, course.energy, course.speed, course.overlap]
        for values in series:
            del values[count:]


def main(args: argparse.Namespace) -> int:
    """Simulate with both solvers, print a table, write files; returns the exit status."""
    check_writable(args.png, args.html, args.json)
    use_device(args.device)
    if args.png or args.html:
        require("matplotlib")
    kind = _kind(args.png)
    against = args.against or _rival(args)
    names = (args.solver, against)
    if args.ctrl and not set(names) <= set(ACTUATED):
        raise UserError(
            f"--ctrl drives actuators of MuJoCo, which only {' and '.join(ACTUATED)} have; compare "
            f"these two"
        )

    def open_pair(dt: float | None) -> tuple[Simulation, ...]:
        with gathered_warnings():
            return tuple(
                open_scene(
                    args.scene,
                    Request(
                        solver,
                        args.iterations,
                        dt,
                        None,
                        args.arguments,
                        args.ctrl,
                        args.accuracy,
                        light_links=set(names) <= set(ACTUATED),
                    ),
                )
                for solver in names
            )

    if args.accuracy is not None and "avbd" not in names:
        raise UserError("--accuracy is for SolverAVBD: compare with --solver avbd")
    pair = open_pair(args.dt)
    say_notes(device_notes(args.device))
    with gathered_prints():
        comparison, interruption = _compare(pair, names, args.frames)
        if args.ctrl and not interruption.happened:
            _refine(comparison, pair, open_pair(0.5 * pair[0].dt))
    with tables_beside(args.json):
        print(_report(comparison))
    if args.json:
        write_json(args.json, dataclasses.asdict(comparison))
    if args.png:
        with writing(args.png):
            args.png.write_bytes(_picture(comparison, kind))
    if args.html:
        with writing(args.html):
            args.html.write_bytes(_page(comparison).encode())
    return interruption.status(0)


def _rival(args: argparse.Namespace) -> str:
    """The solver to compare with where the user names none."""
    if args.solver != "avbd":
        return "avbd"
    return "mujoco" if args.ctrl else "vbd"


def _compare(
    pair: tuple[Simulation, ...], names: tuple[str, str], frames: int | None
) -> tuple[Comparison, Interruption]:
    """Advance two simulations side by side and record both, until Ctrl-C."""
    one, other = pair
    if one.model.body_count != other.model.body_count or one.frame_dt != other.frame_dt:
        raise UserError(f"{one.name} is another scene for {names[1]} than for {names[0]}")
    frames = frames or one.frames
    probes = tuple(Probe(simulation.model) for simulation in pair)
    say_notes([*one.notes, *describe_overlaps(probes[0].overlaps)])
    joints = Joints.of(one.model) if one.model.joint_count else None
    courses = (Course(names[0]), Course(names[1]))
    comparison = Comparison(
        scene=one.name,
        bodies=one.model.body_count,
        dt=(one.dt, other.dt),
        time=[frame * one.frame_dt for frame in range(frames + 1)],
        courses=courses,
    )

    def record() -> None:
        for course, probe, simulation in zip(courses, probes, pair, strict=True):
            course.record(probe, simulation, joints)
        poses = [simulation.state.body_q.numpy().astype(float) for simulation in pair]
        apart = distances(probes[0].bodies, *poses)
        comparison.distance_max.append(float(np.max(apart, initial=0.0)))
        comparison.distance_median.append(float(np.median(apart)) if apart.size else 0.0)

    record()
    with interruptible() as interruption:
        for _ in progress(range(frames), frames, one.name):
            for simulation in pair:
                simulation.advance()
            record()
    comparison.keep(len(comparison.distance_median))
    for course, simulation in zip(courses, pair, strict=True):
        course.close(simulation)
    bodies = probes[0].bodies
    moving = np.flatnonzero(bodies.moving)
    if moving.size:
        start = one.model.state().body_q.numpy().astype(float)
        ends = [simulation.state.body_q.numpy().astype(float) for simulation in pair]
        worst = int(np.argmax(np.nan_to_num(distances(bodies, *ends), nan=np.inf)))
        comparison.body = one.model.body_label[moving[worst]]
        one_way, other_way = (distances(bodies, start, end)[worst] for end in ends)
        comparison.moved = (float(one_way), float(other_way))
    return comparison, interruption


def _refine(
    comparison: Comparison, pair: tuple[Simulation, ...], finer: tuple[Simulation, ...]
) -> None:
    """Repeat both runs at half the step, and say how far from them each ends."""
    frames = len(comparison.time) - 1
    with interruptible() as interruption:
        for _ in progress(range(frames), frames, f"{comparison.scene}, half the step"):
            for simulation in finer:
                simulation.advance()
    if interruption.happened:
        return
    bodies = Probe(pair[0].model).bodies
    for course, coarse, fine in zip(comparison.courses, pair, finer, strict=True):
        ends = (run.state.body_q.numpy().astype(float) for run in (coarse, fine))
        course.step_error = float(np.max(distances(bodies, *ends), initial=0.0))


def _report(comparison: Comparison) -> str:
    """The comparison as a table, and how far apart the two solvers are over time."""
    a, b = comparison.courses
    start = a.energy[0]

    def row(label: str, form: Any) -> tuple[str, str, str]:
        return label, form(a), form(b)

    rows = [
        (f"{comparison.scene}, {comparison.bodies} bodies, {comparison.time[-1]:.3g} s", "", ""),
        row("", lambda course: course.solver),
        ("step", *(f"{1e3 * dt:.4g} ms" for dt in comparison.dt)),
        row("solver a step, median", lambda c: f"{c.solver_ms:.3f} ms"),
        row(
            "collision detection a step",
            lambda c: f"{c.collision_ms:.3f} ms" if c.collision_ms else "in the solver",
        ),
        row("deepest penetration, ever", lambda c: length(max(c.penetration))),
        row("deepest penetration at the end", lambda c: length(c.penetration[-1])),
        row("largest speed at the end", lambda c: f"{c.speed[-1]:.4g} m/s"),
        row(f"energy gained, of {start:.4g} J", lambda c: f"{c.energy[-1] - start:+.4g} J"),
    ]
    if a.overlap:
        rows.append(row("overlap of links, for good", lambda c: length(c.overlap[-1])))
    if a.test is not None or b.test is not None:
        rows.append(row("the example's own test", lambda c: c.test or "none"))
    if a.step_error is not None and b.step_error is not None:
        rows.append(row("at half the step ends apart by", lambda c: length(c.step_error)))
    if a.estimated_error is not None or b.estimated_error is not None:
        rows.append(
            row(
                "error, by its own estimate",
                lambda c: "unknown" if c.estimated_error is None else length(c.estimated_error),
            )
        )
    if a.passed or b.passed:
        rows.append(
            row("past limits of joints, ever", lambda c: f"{c.passed[0] if c.passed else 0.0:.3g}")
        )
    apart = [("apart after", "most", "median")]
    last = len(comparison.time) - 1
    for frame in sorted({max(min(1, last), last * part // 4) for part in range(1, 5)}):
        apart.append(
            (
                f"{comparison.time[frame]:.3g} s",
                length(comparison.distance_max[frame]),
                length(comparison.distance_median[frame]),
            )
        )
    return "\n\n".join([table(rows), table(apart), *_reasons(comparison)])


def _reasons(comparison: Comparison) -> list[str]:
    """A sentence on where the two differ most in the end, and one for each reason that is known."""
    apart = comparison.distance_max[-1]
    if comparison.body is None:
        return []
    one, other = comparison.courses
    lines = [
        f"Farthest apart in the end is body '{comparison.body}': by {length(apart)}, after moving "
        f"by {length(comparison.moved[0])} with {one.solver} and by "
        f"{length(comparison.moved[1])} with {other.solver}."
    ]
    for course in comparison.courses:
        if course.step_error is not None and course.step_error > 0.25 * apart > 0.0:
            lines.append(
                f"The step is a reason: with half of it {course.solver} ends "
                f"{length(course.step_error)} elsewhere. Try a smaller --dt."
            )
        if course.passed is not None:
            started = course.passed[0] <= course.started_past
            lines.append(
                f"Limits are a reason: with {course.solver} joint '{course.passed[1]}' "
                f"{'started' if started else 'was'} {course.passed[0]:.3g} (m or rad) past its own."
            )
    deep = [max(course.penetration) for course in comparison.courses]
    if abs(deep[0] - deep[1]) > 0.1 * apart > 0.0:
        lines.append(
            f"Contacts are a reason: shapes were {length(deep[0])} deep with {one.solver} and "
            f"{length(deep[1])} with {other.solver}."
        )
    return ["\n".join(lines)]


def _page(comparison: Comparison) -> str:
    """The report as an HTML page: the table, plots over time, and what it ran on."""
    machine = describe_machine(None)
    picture = _picture(comparison, "svg").decode()
    solvers = " and ".join(course.solver for course in comparison.courses)
    return _PAGE.format(
        title=html.escape(f"{comparison.scene}: {solvers}"),
        report=html.escape(_report(comparison)),
        plot=picture[picture.index("<svg") :],
        machine=html.escape("\n".join(f"{name}: {value}" for name, value in machine.items())),
    )


def _kind(path: Path | None) -> str:
    """What kind of image the ending of a file's name asks for: png where it has none.

    Raises:
        UserError: Matplotlib writes no such images.
    """
    kind = path.suffix[1:].lower() if path else ""
    if not kind:
        return "png"
    from matplotlib.backend_bases import FigureCanvasBase

    known = FigureCanvasBase.get_supported_filetypes()
    if kind not in known:
        raise UserError(f"cannot draw {path}: its ending is none of {', '.join(sorted(known))}")
    return kind


def _picture(comparison: Comparison, kind: str) -> bytes:
    """Both courses over time, as an image file of a kind: png, svg, ..."""
    image = io.BytesIO()
    _draw(comparison).savefig(image, format=kind, dpi=120)
    return image.getvalue()


def _draw(comparison: Comparison) -> "Figure":
    """Draw both courses over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 6.5), layout="constrained")
    figure.suptitle(f"{comparison.scene}, {comparison.bodies} bodies")
    (apart, penetration), (energy, cost) = figure.subplots(2, 2)
    time = comparison.time
    apart.plot(time, 1e3 * np.array(comparison.distance_max), "k-", label="most")
    apart.plot(time, 1e3 * np.array(comparison.distance_median), "k:", label="median")
    apart.set_ylabel("distance between the two [mm]")
    penetration.set_ylabel("deepest penetration [mm]")
    energy.set_ylabel("energy since the start [J]")
    for course, color in zip(comparison.courses, COLORS, strict=True):
        style = {"color": color, "label": course.solver}
        penetration.plot(time, 1e3 * np.array(course.penetration), **style)
        energy.plot(time, np.array(course.energy) - course.energy[0], **style)
    for axes in (apart, penetration):
        # Solvers differ by orders of magnitude; below a micrometer it is rounding.
        axes.set_yscale("symlog", linthresh=1.0e-3)
        axes.set_ylim(bottom=0.0)
    for axes in (apart, penetration, energy):
        axes.set_xlabel("time [s]")
        axes.legend()
    labels = [course.solver for course in comparison.courses]
    solver_ms = [course.solver_ms for course in comparison.courses]
    bars = cost.barh(labels, solver_ms, color=COLORS)
    cost.bar_label(bars, fmt="%.3g", padding=3)
    cost.invert_yaxis()
    cost.margins(x=0.15)
    cost.set_xlabel("solver, median of a step [ms]")
    return figure
