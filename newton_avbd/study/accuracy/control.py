# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Error asked for against error achieved, of ``SolverAVBD(model, accuracy=...)``.

On scenes whose motion is known, with one call of ``step`` and one collision detection in a frame of
1/60 s. What was asked for is what the accuracy means: so much a second, and a quarter of a second's
worth for steps that are not of second order. Beside it is the cheapest fixed step that is as right.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from statistics import median

import newton
import numpy as np

from newton_avbd import SolverAVBD
from newton_avbd.scenes import robots
from newton_avbd.scenes.scene import Scene
from newton_avbd.study.accuracy import pendulums
from newton_avbd.study.accuracy.ask import ask
from newton_avbd.study.accuracy.run import Runner, runner
from newton_avbd.study.accuracy.scene import FRAME, AccuracyScene, OffPath, Path, farthest
from newton_avbd.study.accuracy.scenes import ACCURACY_SCENES
from newton_avbd.study.accuracy.simbench import add_quadruped, rolling_accelerations
from newton_avbd.study.accuracy.solvers import Setting
from newton_avbd.study.properties.body import SPIN

LEVELS = (1e-1, 1e-2, 1e-3, 1e-4)
"""Accuracies that are asked for [m/s]."""

FIXED = (1, 2, 4, 8, 16, 32)
"""Fixed steps a frame beside them."""

SAVED = 0.25
"""Time that the accuracy counts for at once [s]; see :mod:`newton_avbd.step.local_error`."""

REPEATS = 5
"""Runs whose median cost counts."""

REFERENCE_BUDGET = 20.0
"""Processor time to find out how a scene without a closed form moves [s]."""


@dataclass(frozen=True)
class Outcome:
    """What an accuracy led to on a scene.

    Attributes:
        scene: Name of the scene.
        accuracy: What was asked for [m/s].
        allowed: The error that this allows in the time of the scene [m].
        error: The error achieved [m].
        estimated: The solver's own estimate of it [m].
        resolution: What the reference itself may be off [m].
        cost: Processor time of a simulated second [ms], replayed.
        fixed: The same of the cheapest fixed step that achieves what is allowed; None for none.
        rate: Steps a second of that [Hz].
        steps: Inner steps of the whole run.
        repeated: Inner steps that were repeated.
        missed: Calls for which the budget of inner steps did not do.
    """

    scene: str
    accuracy: float
    allowed: float
    error: float
    estimated: float
    resolution: float
    cost: float
    fixed: float | None
    rate: int | None
    steps: int
    repeated: int
    missed: int

    @property
    def share(self) -> float:
        """The error achieved as a share of what was allowed, the reference's own off."""
        return max(self.error - self.resolution, 0.0) / self.allowed


def _in_metres(name: str, scale: float = 1.0) -> AccuracyScene:
    """A scene of the accuracy study with its error as a length.

    Args:
        name: Its name there.
        scale: What its error is relative to [m], where it is not how far a body goes.
    """
    scene = ACCURACY_SCENES[name]
    off = scene.error

    def error(path: Path) -> float:
        if isinstance(off, OffPath):
            return farthest(path.centers - off.belongs(path))
        return scale * off(path)

    return replace(scene, error=error, resolution=0.0)


def _rolling() -> AccuracyScene:
    """Balls on a box that is drawn away; how far the box and a ball are from where they belong."""
    scene = ACCURACY_SCENES["rolling_y"]

    def error(path: Path) -> float:
        half = 0.5 * path.times[:, None] ** 2 * np.array(rolling_accelerations())[None]
        moved = path.centers[:, :2] - path.centers[0, :2]
        return float(np.max(np.abs(moved[..., 1] - half)))

    return replace(scene, error=error, seconds=1.0)


def _asked(
    name: str, build: Callable[[newton.ModelBuilder], None], seconds: float
) -> AccuracyScene:
    """A scene whose motion refinement finds."""
    frames = round(seconds / FRAME)
    return ask(Scene(name, name, build, frames=frames), budget=REFERENCE_BUDGET).scene


def add_swinging_quadruped(builder: newton.ModelBuilder) -> None:
    """Add Newton's quadruped in the air, its trunk fixed, its legs loose; nothing collides."""
    add_quadruped(builder, floating=False)
    for shape in range(builder.shape_count):
        builder.shape_flags[shape] &= ~newton.ShapeFlags.COLLIDE_SHAPES


def _turn() -> float:
    """How far the ends of the radius of gyration of the asymmetric top go [m]."""
    builder = newton.ModelBuilder()
    ACCURACY_SCENES["top"].build(builder)
    inertia = np.trace(np.array(builder.body_inertia[0]).reshape(3, 3))
    radius = math.sqrt(0.5 * inertia / builder.body_mass[0])
    return radius * float(np.linalg.norm(SPIN)) * ACCURACY_SCENES["top"].seconds


CONTROL_SCENES: dict[str, Callable[[], AccuracyScene]] = {
    "projectile": partial(_in_metres, "projectile"),
    "oscillator": partial(_in_metres, "oscillator"),
    "top": lambda: _in_metres("top", _turn()),
    "pendulum_2": partial(_in_metres, "pendulum_2", 2.0 * pendulums.LENGTH),
    "pendulum_3": partial(_in_metres, "pendulum_3", 3.0 * pendulums.LENGTH),
    "pendulum_8": partial(_in_metres, "pendulum_8", 8.0 * pendulums.LENGTH),
    "cartpole": partial(_asked, "cartpole", robots.add_cartpole, 1.0),
    "legs": partial(_asked, "legs", add_swinging_quadruped, 0.5),
    "incline": partial(_in_metres, "incline"),
    "sliding": partial(_in_metres, "sliding"),
    "skidding": partial(_in_metres, "skidding"),
    "tipping": partial(_in_metres, "tipping"),
    "landing": partial(_in_metres, "landing"),
    "bounce": partial(_in_metres, "bounce"),
    "rolling": _rolling,
    "stack": partial(_in_metres, "stack", 0.5),
    "ant": partial(_asked, "ant", robots.add_ant, 1.0),
    "quadruped": partial(_asked, "quadruped", robots.add_quadruped, 1.0),
}
"""What finds the scenes, whose errors are lengths [m], by the names that the table has."""


def outcomes(names: Iterable[str], *, repeats: int = REPEATS) -> Iterator[Outcome]:
    """Simulate scenes with accuracies and with fixed steps, one after the other.

    Args:
        names: Of :data:`CONTROL_SCENES`.
        repeats: Runs whose median cost counts.

    Yields:
        An outcome for each scene and accuracy that single precision can tell.
    """
    for name in names:
        scene = CONTROL_SCENES[name]()
        if scene.frames < 2:
            continue
        worker = runner(scene, "avbd")
        fixed = [(n, *_measure(worker, Setting(n), 1)) for n in FIXED]
        for accuracy in LEVELS:
            try:
                SolverAVBD(worker.model, accuracy=accuracy)
            except ValueError:
                # too small for single precision
                continue
            yield _outcome(name, worker, accuracy, fixed, repeats)


def _outcome(
    name: str, worker: Runner, accuracy: float, fixed: list[tuple[int, float, float]], repeats: int
) -> Outcome:
    scene = worker.scene
    allowed = accuracy * (scene.seconds + SAVED)
    right = [(ms, n) for n, off, ms in fixed if off <= allowed]
    rate = min(right)[1] if right else None
    asked = Setting(1, accuracy=accuracy)
    error, _ = _measure(worker, asked, 1)
    settings = [asked] if rate is None else [asked, Setting(rate)]
    costs: list[list[float]] = [[] for _ in settings]
    for _ in range(repeats):
        # in turns: what else the machine does hits both
        for setting, times in zip(settings, costs, strict=True):
            _, elapsed = worker.run(setting, is_watched=False)
            times.append(1e3 * elapsed / scene.frames / FRAME)
    steps = repeated = 0
    worker.restart(asked)
    solver = worker.solver
    for frame in range(scene.frames):
        worker.frame(scene.wrench and scene.wrench(frame * FRAME, worker.bodies))
        report = solver.report().inner
        steps += int(report.steps.sum())
        repeated += int(report.rejected.sum())
    return Outcome(
        scene=name,
        accuracy=accuracy,
        allowed=allowed,
        error=error,
        estimated=float(report.total.max()),
        resolution=scene.resolution,
        cost=median(costs[0]),
        fixed=None if rate is None else median(costs[1]),
        rate=None if rate is None else round(rate / FRAME),
        steps=steps,
        repeated=repeated,
        missed=int(report.missed.sum()),
    )


def _measure(worker: Runner, setting: Setting, repeats: int) -> tuple[float, float]:
    """Error [m] and cost [ms] of a simulated second."""
    worker.restart(setting)
    # loads kernels
    worker.eager()
    path, _ = worker.run(setting)
    costs = []
    for _ in range(repeats):
        # what a step costs depends on where in the motion it is
        _, cost = worker.run(setting, is_watched=False)
        costs.append(cost / worker.scene.frames)
    with np.errstate(all="ignore"):
        return worker.scene.error(path), 1e3 * median(costs) / FRAME


def table(found: Iterable[Outcome]) -> str:
    """A table of outcomes in Markdown."""
    lines = [
        "| scene | asked [m/s] | allowed [m] | achieved [m] | share | estimated [m] | inner steps "
        "(repeated) | cost [ms/s] | best fixed [ms/s] | ratio | missed |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for one in found:
        fixed, ratio = "none", "-"
        if one.fixed is not None:
            fixed = f"{one.fixed:.2f} ({one.rate} Hz)"
            ratio = f"{one.cost / one.fixed:.2f}"
        lines.append(
            f"| {one.scene} | {one.accuracy:.0e} | {one.allowed:.1e} | {one.error:.1e} | "
            f"{one.share:.2f} | {one.estimated:.1e} | {one.steps} ({one.repeated}) | "
            f"{one.cost:.2f} | {fixed} | {ratio} | {one.missed} |"
        )
    return "\n".join(lines)


def verdict(found: list[Outcome]) -> str:
    """How many outcomes keep to what was asked for, and what they cost, in words."""
    kept = [one for one in found if one.share <= 1.0]
    worst = max(found, key=lambda one: one.share)
    compared = [one for one in found if one.fixed is not None]
    ratios = sorted(one.cost / one.fixed for one in compared if one.fixed)
    alone = len(found) - len(compared)
    return (
        f"{len(kept)} of {len(found)} outcomes keep to what was asked; the largest share of what "
        f"is allowed is {worst.share:.2f}, of {worst.scene} at {worst.accuracy:.0e} m/s. Cost "
        f"beside the best fixed step: median {median(ratios):.2f}, from {ratios[0]:.2f} to "
        f"{ratios[-1]:.2f}; in {alone} outcomes no fixed step of up to "
        f"{round(FIXED[-1] / FRAME)} Hz is enough."
    )
