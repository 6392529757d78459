# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What a robot of the gallery must do, and what it cost."""

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from statistics import median

import newton
import numpy as np

from newton_avbd.scenes.pose import Pose, stand
from newton_avbd.scenes.scene import Scene
from newton_avbd.study.bench.run import pinned
from newton_avbd.study.contestants import Contestant, NewtonContestant
from newton_avbd.study.mujoco.native import MujocoContestant, silence
from newton_avbd.study.peers import MJ_STEP, PEERS
from newton_avbd.study.robots.run import DT, Record, run_robot

CLOSED = 1.0e-4
"""Largest distance of the anchors of a joint [m]."""

ALIGNED = 1.0e-3
"""Largest rotation of a joint about what it locks, and violation of a limit [rad, or m]."""


LAG = 0.02
"""How much further a drive may stay behind its target on average than the reference does, or,
without one, than the law of the drive says [rad or m]."""

WRONG = 0.02
"""Largest share of a drive's force that may be not its law's. A drive that stays behind further
than the reference does pushes as its law says all the same where its effort limit or a contact
stops it, and contacts differ between solvers: feet stick in one and creep in the other, what falls
over falls at another time."""

STILL = 0.25
"""The same as a fraction of the target's mean distance from the first pose: by the law a drive of
4 Hz stays behind by 0.38 of it, one that does not move by all of it."""

WEIGHT = 0.01
"""Largest error of the contact forces, as a fraction of the weight."""

MOVING = 0.1
"""Speed at the end of the hold that counts as moving on [m/s]."""

FOOTING = 0.1
"""Fraction of the weight that the ground bears at least at the end of the hold."""

SOLVERS = ("avbd", MJ_STEP, "mujoco", "xpbd", "vbd")
"""Solvers that are timed, in the order of the table."""

WARM_UP = 60
"""Steps before a step is timed."""

ROUNDS, TURN = 5, 0.02
"""Turns of each solver, and the CPU time of a turn [s]."""

BLEW_UP = "blows up"
"""Note of a solver whose state is not finite when it is timed."""

BUDGET = 240.0
"""Wall-clock time after which a run is given up [s]."""

Importer = Callable[[], newton.ModelBuilder]
"""Imports a robot."""


@dataclass
class Report:
    """What is known of a robot.

    Attributes:
        name: The robot's name.
        package: The package that it is from.
        links: Links, massless ones and driven axes.
        base: ``floating`` or ``fixed``.
        filtered: Pairs of its shapes that overlap in the first pose.
        reference: What its drives were compared with.
        failures: What it did not do, a phrase each; empty where it passes.
        numbers: Worst separation [m], misalignment [rad], limit violation [rad or m], lag beyond
            the reference [rad or m], weight error, end speed [m/s], and the largest share of a
            drive's force that is not its law's.
        times: Time of a step [s] by solver; missing where the solver does not load the robot.
        notes: Why a solver is missing, by solver.
    """

    name: str
    package: str
    links: tuple[int, int, int] = (0, 0, 0)
    base: str = ""
    filtered: int = 0
    reference: str = ""
    failures: list[str] = field(default_factory=list)
    numbers: dict[str, float] = field(default_factory=dict)
    times: dict[str, float] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)


def try_robot(
    report: Report, load: Importer, shown: Callable[[str, int, int], None], *, timed: bool = True
) -> Record | None:
    """Set a robot up, let it hold and wave, check what it did, and time it.

    Args:
        report: Receives what is found.
        load: Imports the robot.
        shown: Called with what is being done, the steps made and all steps.
        timed: Whether to time it, beside the other solvers.

    Returns:
        What SolverAVBD made of it; None where it cannot run.
    """
    silence()
    try:
        shown("import", 0, 1)
        builder = load()
        if not builder.joint_count:
            raise ValueError("it holds no joints")
        pose = stand(builder)
    except Exception as error:
        # Files can be wrong, and importers fail, in any way.
        report.failures.append(f"cannot be imported: {_summary(error)}")
        return None
    mass = np.array(builder.body_mass)
    report.links = (builder.body_count, int(np.sum(mass <= 0.0)), len(pose.driven))
    report.base = "floating" if pose.floating else "fixed"
    report.filtered = pose.filtered
    try:
        record = run_robot(pose, "avbd", BUDGET, partial(shown, "avbd"))
    except Exception as error:
        report.failures.append(f"cannot be simulated: {_summary(error)}")
        record = None
    poses = _Poses(pose, load)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of other solvers, or known by now
        reference = _reference(report, poses, shown)
        if timed:
            _time(report, poses, shown)
    if record is not None:
        report.failures += judge(report, record, reference)
    return record


class _Poses:
    """A robot as its file has it, and with its welded links made one.

    MuJoCo refuses massless links that move; made one with what they are welded to, most go.
    """

    def __init__(self, pose: Pose, load: Importer):
        self.plain, self._load = pose, load

    @cached_property
    def merged(self) -> Pose:
        builder = self._load()
        builder.collapse_fixed_joints()
        return stand(builder)


def _reference(
    report: Report, poses: _Poses, shown: Callable[[str, int, int], None]
) -> Record | None:
    """What MuJoCo makes of the robot; None where it does not load it."""
    for form, how in (("plain", "MuJoCo"), ("merged", "MuJoCo, welded links merged")):
        try:
            pose = getattr(poses, form)
            record = run_robot(pose, "mujoco", BUDGET, partial(shown, "mujoco"))
        except Exception as error:
            report.notes.setdefault("mujoco", _summary(error))
            continue
        if record.finite:
            report.reference = how
            return record
        report.notes.setdefault("mujoco", "not finite")
    report.reference = "the law of the drive"
    return None


def judge(report: Report, ours: Record, reference: Record | None) -> list[str]:
    """What a robot did not do, a phrase each."""
    failures = []
    if not ours.finite:
        return ["not finite: the solver had to freeze the world"]
    late = {name: lag - _due(name, ours, reference) for name, lag in ours.lag.items()}
    behind = max(late.values(), default=0.0)
    off = abs(ours.support - ours.demand) / ours.weight if ours.weight else 0.0
    report.numbers = {
        "separation": ours.separation,
        "misalignment": ours.misalignment,
        "limit": ours.limit,
        "behind": behind,
        "weight": off,
        "speed": ours.speed,
        "wrong": max((ours.wrong[name] for name in ours.wrong), default=0.0),
    }
    if ours.separation > CLOSED or ours.misalignment > ALIGNED:
        failures.append(
            f"{ours.joint} opens: {1e3 * ours.separation:.2g} mm, {ours.misalignment:.2g} rad"
        )
    if ours.limit > ALIGNED:
        failures.append(f"a limit is passed by {ours.limit:.2g}")
    missed = [
        name
        for name in late
        if late[name] > max(ALIGNED, min(LAG, STILL * ours.stroke[name]))
        and ours.wrong.get(name, 1.0) > WRONG
    ]
    if missed:
        worst = max(missed, key=lambda name: late[name])
        failures.append(
            f"{len(missed)} of {len(late)} drives do not follow, {worst.rpartition(':')[0]} by "
            f"{late[worst]:.2g}"
            + (f", with {100 * ours.wrong[worst]:.2g} % of its force wrong" if ours.wrong else "")
        )
    if ours.weight and ours.support < FOOTING * ours.weight:
        failures.append("hangs in mid-air" if off > WEIGHT else "falls past the ground")
    elif off > WEIGHT:
        failures.append(f"contacts bear {ours.support:.4g} N of {ours.demand:.4g} N")
    if reference is not None and ours.speed > max(MOVING, 2.0 * reference.speed):
        failures.append(
            f"moves at {ours.speed:.2g} m/s where the reference has {reference.speed:.2g}"
        )
    return failures


def _due(name: str, ours: Record, reference: Record | None) -> float:
    """How far a drive may stay behind its target by itself [rad or m]: what the reference does.

    Without a reference what the law of the drive alone gives; nothing where that is not to move.
    """
    if reference is not None and name in reference.lag:
        return reference.lag[name]
    return ours.law[name] if ours.law[name] < ours.stroke[name] else 0.0


def _time(report: Report, poses: _Poses, shown: Callable[[str, int, int], None]) -> None:
    """Time a step of each solver, in turns, while the robot holds its first pose."""
    contestants: dict[str, Contestant] = {}
    for number, solver in enumerate(SOLVERS):
        shown("time", number, len(SOLVERS))
        for form in ("plain", "merged") if solver in (MJ_STEP, "mujoco") else ("plain",):
            try:
                pose = getattr(poses, form)
                contestants[solver] = _contestant(solver, report.name, pose)
                break
            except Exception as error:
                report.notes.setdefault(solver, _summary(error))
    times: dict[str, list[float]] = {solver: [] for solver in contestants}
    with pinned():
        for _ in range(ROUNDS):
            for solver, contestant in contestants.items():
                native = solver == "mujoco"
                times[solver].append((contestant.eager if native else contestant.replayed)(TURN))
    report.times = {solver: median(taken) for solver, taken in times.items()}
    for solver, contestant in contestants.items():
        if not np.isfinite(contestant.observe().body_qd.numpy()).all():
            report.notes[solver] = BLEW_UP


def _contestant(solver: str, name: str, pose: Pose) -> Contestant:
    """Set a solver up on a robot and let it run for a moment."""
    scene = Scene(name, name, lambda builder: builder.add_builder(pose.builder), dt=DT)
    contestant: Contestant
    if solver == MJ_STEP:
        contestant = MujocoContestant(scene)
    else:
        contestant = NewtonContestant(scene, PEERS[solver])
    for _ in range(WARM_UP):
        contestant.advance()
    return contestant


def _summary(error: Exception) -> str:
    """First line of an error's message, without folders and not too long for a table."""
    lines = str(error).strip().splitlines()
    text = re.sub(r"(/\S+)+/", "", lines[0]) if lines else type(error).__name__
    return text if len(text) <= 120 else f"{text[:117]}..."
