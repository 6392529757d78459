# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What measured points say: fronts, the cheapest setting for an accuracy, and who is cheapest."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from newton_avbd.study.accuracy.run import Point
from newton_avbd.study.accuracy.solvers import Setting

OURS = "avbd"

LEVELS = (1e-2, 1e-3, 1e-4)
"""Relative errors that somebody may want to reach."""

WITHIN = 2.0
"""Cost relative to the cheapest solver's that is still as good."""


def usable(points: Iterable[Point]) -> list[Point]:
    """Points with an error and a cost."""
    return [point for point in points if point.error is not None and point.cost is not None]


def front(points: Iterable[Point]) -> list[Point]:
    """Pareto front: points than which none is both cheaper and more accurate, cheapest first."""
    best: list[Point] = []
    for point in sorted(usable(points), key=lambda point: (point.cost, point.error)):
        if not best or point.error < best[-1].error:  # type: ignore[operator]
            best.append(point)
    return best


def cheapest(points: Iterable[Point], error: float) -> Point | None:
    """The cheapest point that reaches an error; None where none does."""
    reached = [point for point in front(points) if point.error <= error]  # type: ignore[operator]
    return reached[0] if reached else None


@dataclass(frozen=True)
class Verdict:
    """Who reaches an accuracy on a scene at which cost.

    Attributes:
        scene: Name of the scene.
        level: Relative error to reach.
        best: Cheapest point that reaches it, by solver; solvers that do not are left out.
    """

    scene: str
    level: float
    best: dict[str, Point]

    @property
    def rival(self) -> Point | None:
        """The cheapest point of another solver."""
        others = [point for solver, point in self.best.items() if solver != OURS]
        return min(others, key=_cost, default=None)

    @property
    def ratio(self) -> float:
        """Our cost relative to the cheapest rival's: 0 where no rival, infinite where not we
        reach the level."""
        ours, rival = self.best.get(OURS), self.rival
        if ours is None:
            return math.inf
        return 0.0 if rival is None else _cost(ours) / _cost(rival)


def verdicts(
    points: Iterable[Point], resolutions: Mapping[str, float] | None = None
) -> list[Verdict]:
    """A verdict for each scene and level that any solver reaches.

    Args:
        points: Points of any scenes and solvers.
        resolutions: Relative errors of the scenes' references, by scene; smaller levels are not
            judged.
    """
    scenes: dict[str, dict[str, list[Point]]] = {}
    for point in points:
        scenes.setdefault(point.scene, {}).setdefault(point.solver, []).append(point)
    found = []
    for scene, solvers in scenes.items():
        for level in LEVELS:
            if level < (resolutions or {}).get(scene, 0.0):
                continue
            best = {solver: cheapest(group, level) for solver, group in solvers.items()}
            reached = {solver: point for solver, point in best.items() if point is not None}
            if reached:
                found.append(Verdict(scene, level, reached))
    return found


def shares(found: Iterable[Verdict]) -> tuple[float, float]:
    """Shares of verdicts in which we are the cheapest, and within :data:`WITHIN` of it."""
    ratios = [verdict.ratio for verdict in found]

    def share(bound: float) -> float:
        return sum(ratio <= bound for ratio in ratios) / max(1, len(ratios))

    return share(1.0), share(WITHIN)


@dataclass(frozen=True)
class Split:
    """Two ways to spend the cost of a setting.

    Attributes:
        iterations: The most accurate point with fewer steps and more iterations.
        substeps: The most accurate one with as many steps or more, and no more iterations.
    """

    iterations: Point
    substeps: Point


def split(points: Iterable[Point], base: Setting, slack: float = 1.1) -> Split | None:
    """Compare iterations and substeps at equal cost on one scene with one solver and scheme.

    Args:
        points: Its points.
        base: The setting whose cost may be spent.
        slack: What counts as equal cost.

    Returns:
        The comparison; None where there are no points for it.
    """
    points = [
        point
        for point in usable(points)
        if point.setting.tolerance is None and point.setting.scheme == base.scheme
    ]
    costs = [_cost(point) for point in points if point.setting == base]
    most = base.iterations
    if not costs or most is None:
        return None
    fewer: list[Point] = []
    more: list[Point] = []
    for point in points:
        substeps, iterations = point.setting.substeps, point.setting.iterations
        if iterations is None or _cost(point) > slack * costs[0]:
            continue
        if substeps < base.substeps and iterations > most:
            fewer.append(point)
        if substeps >= base.substeps and iterations <= most:
            more.append(point)
    if not fewer:
        return None
    return Split(min(fewer, key=_error), min(more, key=_error))


def _error(point: Point) -> float:
    return math.inf if point.error is None else point.error


def _cost(point: Point) -> float:
    return math.inf if point.cost is None else point.cost
