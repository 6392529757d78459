# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What each accuracy costs on a scene of the user's own, whose motion nobody knows beforehand.

The motion is found by refinement: smaller and smaller steps, and L. F. Richardson's extrapolation
from the last two (Phil. Trans. R. Soc. A 210, 1911), whose own error is that of the last run but
one. Where nothing can touch, MuJoCo's ``mj_step`` with RK4, in double precision, is refined beside
SolverAVBD, and taken where both agree: then the reference is not the solver that is measured.
"""

import json
import math
import time
from dataclasses import dataclass, replace

import numpy as np

from newton_avbd.io.errors import UserError
from newton_avbd.measure.state import Array, Bodies
from newton_avbd.model.rotations import rotate, transform
from newton_avbd.scenes.scene import Scene
from newton_avbd.study.accuracy.front import OURS, cheapest, usable
from newton_avbd.study.accuracy.run import OutOfTime, Point, Runner, runner
from newton_avbd.study.accuracy.scene import FRAME, AccuracyScene, Path, farthest
from newton_avbd.study.accuracy.solvers import MEASURED, Setting
from newton_avbd.study.peers import ITERATIONS, MJ_STEP

FRAMES = 120
"""Most frames that are asked about."""

LEVELS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
"""Accuracies [m]."""

SOLVERS = (OURS, MJ_STEP, "xpbd", "vbd")
"""Solvers that are asked where the user names none: others take minutes to compile or to run."""

CERTAIN = 1e-3
"""A reference that may be farther off [m], and by more than this share of the way that the bodies
go, says nothing: from there on the motion is not determined."""

FEWEST = 6
"""Frames that have to be certain, so that there is something to ask about."""

LEAST_GAIN = 1.5
"""How many times smaller a difference has to be at half the step for an extrapolation."""

MOST_GAIN = {OURS: 4.0, MJ_STEP: 16.0}
"""How many times smaller it gets at best, by the order of the scheme."""

FINE = {OURS: Setting(4, 100, 1e-6, "runge_kutta"), MJ_STEP: Setting(1, scheme="rk4")}
"""Where a refinement starts."""

NO_DEARER = 1.1
"""Cost relative to the cheapest setting's below which clocks do not tell them apart."""

ROUNDING = 1e-7
"""Share of a coordinate that states in single precision lose."""

SINGLE = 1e-5
"""Share of the way that the steps of a run in single precision lose in all, and as much of a
meter."""

MOST_SUBSTEPS = 1024
"""Steps a frame beyond which single precision makes it worse again."""


@dataclass(frozen=True)
class Reference:
    """A motion, as far as it is known.

    Attributes:
        solver: The solver that was refined.
        substeps: Steps a frame of its finest run.
        marks: Points of the bodies, see :func:`marks`, shape [frames + 1, points, 3].
        bar: How far they may be off until a frame [m], shape [frames + 1].
    """

    solver: str
    substeps: int
    marks: Array
    bar: Array

    @property
    def way(self) -> Array:
        """How far a point has gone from its start at most until a frame [m], [frames + 1]."""
        return _until(self.marks - self.marks[0])

    @property
    def certain(self) -> int:
        """Frames until which it is certain, see :data:`CERTAIN`."""
        bound = CERTAIN * np.maximum(1.0, self.way)
        return int(np.argmin(np.append(self.bar <= bound, False))) - 1


@dataclass(frozen=True)
class OffReference:
    """Error of a path: the largest distance of a point from where it belongs [m].

    Attributes:
        marks: Where points belong, shape [k, points, 3].
    """

    marks: Array

    def __call__(self, path: Path) -> float:
        """The error of a path of k states."""
        return farthest(marks(path) - self.marks)


@dataclass(frozen=True)
class AskedScene(AccuracyScene):
    """A user's scene.

    Attributes:
        asked: The scene.
    """

    asked: Scene | None = None

    def scene(self, substeps: int) -> Scene:
        """The scene in steps of a frame's ``substeps``-th part."""
        assert self.asked is not None
        return replace(self.asked, dt=FRAME / substeps)


@dataclass(frozen=True)
class Question:
    """A scene that can be measured, and how well its motion is known.

    Attributes:
        scene: The scene, as long as its motion is certain.
        reference: The motion.
        apart: How far the limits of SolverAVBD and of ``mj_step`` are apart [m]; None where only
            one of them was refined.
        bodies: Number of bodies.
        frames: Frames that were asked about.
    """

    scene: AskedScene
    reference: Reference
    apart: float | None
    bodies: int
    frames: int

    @property
    def is_determined(self) -> bool:
        """Whether the motion is certain for long enough to ask about it."""
        return self.scene.frames >= FEWEST

    @property
    def bar(self) -> float:
        """How far the reference may be off [m]."""
        return float(self.reference.bar[self.scene.frames])


def marks(path: Path) -> Array:
    """COM of each body that moves, and three points around it, shape [k, 4 n, 3] [m].

    They are the radius of gyration sqrt(tr I / 2 m) away along the axes of the body.
    """
    bodies = path.bodies
    moving = bodies.moving
    inertia = np.trace(bodies.inertia[moving], axis1=1, axis2=2)
    radius = np.sqrt(0.5 * inertia / bodies.mass[moving])
    poses = path.body_q[:, moving]
    center = transform(poses, bodies.com[moving])
    points = [center]
    for axis in np.eye(3):
        points.append(center + rotate(poses[..., 3:], np.outer(radius, axis)[None]))
    return np.concatenate(points, axis=1)


def ask(scene: Scene, *, budget: float) -> Question:
    """Find out how a scene moves.

    Args:
        scene: The scene.
        budget: Processor time for the references [s].

    Raises:
        UserError: Not even three coarse runs end in time.
    """
    model = scene.model(device="cpu")
    frames = min(FRAMES, scene.frames)
    asked = AskedScene(
        scene.name,
        scene.summary,
        "refinement",
        "largest distance of a point of a body from where it belongs",
        scene.build,
        frames * FRAME,
        lambda path: math.nan,
        tuple(MEASURED),
        touching=bool(model.shape_contact_pair_count),
        axis="error [m]",
        asked=scene,
    )
    ours = _refine(asked, OURS, budget)
    other = None if asked.touching else _refine(asked, MJ_STEP, 0.3 * budget)
    if ours is None:
        raise UserError(
            f"{scene.name} takes too long: three runs of {asked.seconds:.2g} s, the last with "
            f"{4 * FINE[OURS].substeps} steps a frame, do not end in {budget:.0f} s"
        )
    reference, apart = _settle(ours, other)
    certain = min(frames, reference.certain)
    known = replace(
        asked,
        seconds=certain * FRAME,
        error=OffReference(reference.marks[: certain + 1]),
        resolution=float(reference.bar[certain]),
    )
    return Question(known, reference, apart, int(np.sum(Bodies.of(model).moving)), frames)


def _settle(ours: Reference, other: Reference | None) -> tuple[Reference, float | None]:
    """The reference to take of two, and how far apart they are where both are certain."""
    if other is None or other.certain < FEWEST:
        return ours, None
    certain = min(ours.certain, other.certain)
    if certain < FEWEST:
        return other, None
    apart = _until(ours.marks - other.marks)
    # each bar is an estimate
    agree = apart <= 3.0 * (ours.bar + other.bar) + SINGLE * (1.0 + other.way)
    is_same = bool(np.all(agree[: certain + 1]))
    return (other if is_same else ours), float(apart[certain])


def _refine(scene: AskedScene, solver: str, budget: float) -> Reference | None:
    """The limit of smaller and smaller steps, while these make it better; None without any."""
    try:
        worker = runner(scene, solver)
    except Exception:
        # the other solver has to do
        if solver == OURS:
            raise
        return None
    # loading and compiling kernels is nobody's fault
    _run(worker, FINE[solver], math.inf)
    deadline = time.process_time() + budget
    best: Reference | None = None
    runs: list[Array] = []
    substeps, spent = FINE[solver].substeps, 0.0
    while substeps <= MOST_SUBSTEPS and time.process_time() + 2.2 * spent < deadline:
        begin = time.process_time()
        try:
            runs.append(_run(worker, replace(FINE[solver], substeps=substeps), deadline))
        except OutOfTime:
            break
        spent = time.process_time() - begin
        if len(runs) >= 3:
            found = _extrapolate(solver, substeps, runs[-3:], best)
            if best is not None and _merit(found) >= _merit(best):
                break
            best = found
        substeps *= 2
    return best


def _run(worker: Runner, setting: Setting, deadline: float) -> Array:
    """Points of the bodies in a run."""
    path, _ = worker.run(setting, deadline)
    with np.errstate(all="ignore"):
        return marks(path)


def _merit(reference: Reference) -> tuple[int, float]:
    """What makes a reference better where it is smaller."""
    return -reference.certain, float(reference.bar[max(0, reference.certain)])


def _extrapolate(
    solver: str, substeps: int, runs: list[Array], before: Reference | None
) -> Reference:
    """The limit of three runs, each at half the step of the last; beside that of ``before``."""
    coarse, middle, fine = runs
    with np.errstate(all="ignore"):
        first, second = _until(middle - coarse), _until(fine - middle)
        first, second = np.nan_to_num(first, nan=np.inf), np.nan_to_num(second, nan=np.inf)
        gain = np.minimum(first / np.maximum(second, ROUNDING), MOST_GAIN[solver])
    goes_on = gain >= LEAST_GAIN
    share = np.where(goes_on, 1.0 / np.maximum(gain - 1.0, LEAST_GAIN - 1.0), 0.0)
    limit = fine + share[:, None, None] * (fine - middle)
    bar = np.where(goes_on, share * second, np.maximum(first, second))
    bar = np.maximum(bar, ROUNDING * _until(fine))
    if before is not None:
        # where rounding grows as steps shrink, limits part
        bar = np.maximum(bar, np.nan_to_num(_until(limit - before.marks), nan=np.inf))
    return Reference(solver, substeps, limit, np.maximum.accumulate(bar))


def _until(offsets: Array) -> Array:
    """Length of the longest vector until each frame, of shape [k, points, 3]: [k]."""
    return np.maximum.accumulate(np.max(np.linalg.norm(offsets, axis=2), axis=1, initial=0.0))


@dataclass(frozen=True)
class Price:
    """What an accuracy costs on a scene.

    Attributes:
        accuracy: How far no point of a body is off [m].
        cheapest: The cheapest point that reaches it, by solver; those that do not are left out.
    """

    accuracy: float
    cheapest: dict[str, Point]

    @property
    def line(self) -> str | None:
        """The line of a program that buys it from SolverAVBD; None where no setting does."""
        point = self.cheapest.get(OURS)
        if point is None:
            return None
        given = {
            "scheme": point.setting.scheme,
            "iterations": point.setting.iterations,
            "tolerance": point.setting.tolerance,
        }
        options = "".join(f", {k}={json.dumps(v)}" for k, v in given.items() if v is not None)
        steps = round(point.setting.substeps / FRAME)
        return f"solver = SolverAVBD(model{options})  # and dt = 1 / {steps}"


def prices(question: Question, points: list[Point]) -> list[Price]:
    """What each of :data:`LEVELS` costs that the reference can tell."""
    found = []
    for level in LEVELS:
        if level >= 2.0 * question.bar:
            solvers = {solver: [p for p in points if p.solver == solver] for solver in MEASURED}
            best = {solver: _plainest(group, level) for solver, group in solvers.items()}
            reached = {solver: point for solver, point in best.items() if point is not None}
            found.append(Price(level, reached))
    return found


def _plainest(points: list[Point], level: float) -> Point | None:
    """The cheapest point that reaches a level, or one as good with the solver's own iterations."""
    best = cheapest(points, level)
    if best is None or best.cost is None:
        return None
    alike = [
        point
        for point in usable(points)
        if point.error <= level  # type: ignore[operator]
        and point.cost <= NO_DEARER * best.cost  # type: ignore[operator]
        and point.setting.iterations == ITERATIONS
        and point.setting.tolerance is None
    ]
    return min(alike, key=lambda point: point.cost or 0.0, default=best)
