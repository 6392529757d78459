# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The benchmark's results as tables and as JSON."""

import math
from dataclasses import asdict
from typing import Any

from newton_avbd.io.output import table
from newton_avbd.study.bench.targets import TARGETS, Result, Target
from newton_avbd.study.peers import PEERS

NOTHING = "-"
"""Stands in a table for what does not exist or was not measured."""

_FREE = ("penetration", "drift", "speed", "momentum")
_JOINTED = (
    *("separation", "misalignment", "limit", "energy", "gain"),
    *("penetration", "speed", "apart"),
)
_LENGTHS = frozenset({"penetration", "drift", "separation", "apart"})


def scene_table(scene: str, results: list[Result]) -> str:
    """Time and quality of every solver on one scene; times also as multiples of SolverAVBD's."""
    shown = [result.quality for result in results if result.quality is not None]
    known = _JOINTED if any(quality.joints for quality in shown) else _FREE
    # What nobody has is not asked for here.
    columns = [name for name in known if any(q.value(name) is not None for q in shown)]
    head = ["solver", "contacts", "eager", "/ avbd", "replayed", "/ avbd", "collided", "/ avbd"]
    head += columns
    ours = next((result for result in results if result.solver == "avbd"), None)
    rows, notes = [], []
    for result in results:
        row = [_title(result.solver), NOTHING]
        for name in ("eager", "replayed", "collided"):
            time = getattr(result, name)
            row += [_time(time), _ratio(time, getattr(ours, name, math.nan))]
        quality = result.quality
        if quality is None:
            row += [NOTHING] * (len(head) - len(row))
        else:
            row[1] = str(quality.contacts)
            row += [_quantity(name, quality.value(name)) for name in columns]
        rows.append(row)
        if result.note:
            notes.append(f"{_title(result.solver)}: {result.note}")
    return "\n".join([scene, table([head, *rows]), *notes])


def cold_start_table(results: list[Result]) -> str:
    """Cold starts of solvers."""
    ours = next((result.eager for result in results if result.solver == "avbd"), math.nan)
    rows = [
        [_title(result.solver), f"{result.eager:.2f} s", _ratio(result.eager, ours)]
        for result in results
    ]
    return "\n".join(["cold start", table([["solver", "first step", "/ avbd"], *rows])])


def target_table(results: list[Result]) -> str:
    """What SolverAVBD must reach on these scenes, what it reached, and whether that is enough."""
    rows = [["target", "must reach", "reached", ""]]
    scenes = {result.scene for result in results}
    for target in TARGETS:
        if target.scene not in scenes:
            continue
        reached = target.reached(results)
        verdict = "not measured"
        if reached is not None:
            verdict = "met" if reached <= target.bound else "missed"
        against = f", of {_title(target.against)}" if target.against else ""
        rows.append(
            [
                f"{target.scene}: {target.quantity}{against}",
                f"<= {_bound(target, target.bound)}",
                NOTHING if reached is None else _bound(target, reached),
                verdict,
            ]
        )
    return table(rows)


def as_json(machine: dict[str, str], results: list[Result]) -> dict[str, Any]:
    """Everything that was measured, times in seconds, lengths in meters."""
    targets = []
    for target in TARGETS:
        reached = target.reached(results)
        met = None if reached is None else reached <= target.bound
        targets.append({**asdict(target), "reached": reached, "met": met})
    return _finite(
        {"machine": machine, "results": [asdict(result) for result in results], "targets": targets}
    )


def _finite(value: Any) -> Any:
    """Replace numbers that JSON does not have by None."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _title(solver: str) -> str:
    return PEERS[solver].title if solver in PEERS else solver


def _time(seconds: float) -> str:
    return NOTHING if math.isnan(seconds) else f"{_plain(1e6 * seconds)} us"


def _ratio(time: float, ours: float) -> str:
    return NOTHING if math.isnan(time) or math.isnan(ours) else _plain(time / ours)


def _plain(value: float) -> str:
    """Write a positive number with three digits or more, without an exponent."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def _length(meters: float) -> str:
    return f"{1e3 * meters:.3g} mm"


def _quantity(name: str, value: float | None) -> str:
    """Write an attribute of a quality: a length, a speed, an energy or a small number."""
    if value is None:
        return NOTHING
    if not math.isfinite(value):
        return "exploded"
    if name in _LENGTHS:
        return _length(value)
    if name == "speed":
        return f"{_length(value)}/s"
    return f"{value:.4g} J" if name == "energy" else f"{value:.1e}"


def _bound(target: Target, value: float) -> str:
    """Write a value of a target: a fraction of a time, or as its quantity is written."""
    if target.against is not None:
        return f"1/{1.0 / value:.3g}" if value <= 1.0 else f"{value:.3g}"
    return _quantity(target.quantity, value)
