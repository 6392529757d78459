# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How much memory a solver takes, and for which effect."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import warp as wp

from .. import data

_OWNERS: dict[str, str] = {
    "tree": "joints",
    "tree.closures": "closures",
    "tree.cables": "cables",
    "tree.tendons": "tendons",
    "tree.runge_kutta": "fourth_order",
    "loops": "loops",
    "work.put": "put_bodies",
    "work.put_from": "put_bodies",
    "work.drag": "fluid",
    "work.wrench": "second_order",
    "work.lead": "second_order",
    "work.coasting": "second_order",
    "work.gained": "carried_rounding",
    "work.rounded": "carried_rounding",
    "work.input_energy": "second_order",
    "worlds.step": "second_order",
    "history.last": "second_order",
    "history.pushing": "second_order",
    "history.flying": "second_order",
    "history.coordinate": "second_order",
    "history.rate": "second_order",
    "history.input": "second_order",
    "history.smooth": "second_order",
    "history.slope_age": "second_order",
    "worlds.inner": "adaptive",
    "history.change": "adaptive",
    "history.wanted": "adaptive",
    "history.ratio": "adaptive",
    "history.saved": "adaptive",
    "history.next_side": "adaptive",
    "sleep": "sleeping",
    "seen_worlds": "sleeping",
    "seen_history": "sleeping",
    "sleep.islands": "sleeping",
    "worlds.island": "sleeping",
    "worlds.pace": "sleeping",
    "rows.awake": "sleeping",
    "rows.awake_count": "sleeping",
    "rows.piles": "piles",
    "rows.mixed": "mixing",
    "work.mixed": "mixing",
    "islands.hold_ll": "pairs",
    "islands.hold_al": "pairs",
    "rows.owner": "contact",
    "rows.contacts": "contact",
    "rows.rows": "contact",
    "rows.other_rows": "contact",
    "rows.sums": "contact",
    "rows.drift": "moving_surfaces",
    "rows.left": "contact",
    "rows.impacts": "restitution",
    "rows.struck_qd": "restitution",
    "rows.struck_at": "restitution",
    "rows.spin": "angular_friction",
    "rows.share": "compliance",
    "rows.stiffness": "ramp",
    "rows.damping": "ramp",
    "colors": "contact",
    "history.records": "contact",
    "history.row_of_contact": "contact",
    "history.torque": "angular_friction",
    "history.joint_force": "joints",
    "history.left_q": "joints",
    "history.lost": "joints",
    "history.lost_turn": "carried_rounding",
    "history.flights": "carried_rounding",
    "history.joint_angle": "joints",
    "history.piece": "joints",
    "history.axis_velocity": "joints",
    "history.joined_qd": "joints",
    "history.held_at": "joints",
    "history.limit_force": "joints",
    "history.acceleration": "joints",
    "history.friction_force": "joints",
    "history.loop_force": "loops",
    "history.loop_torque": "loops",
    "history.loop_rate": "yielding",
    "loops.yielding": "yielding",
    "loops.impedance": "yielding",
    "loops.gives": "yielding",
    "loops.wanted": "yielding",
    "loops.span": "yielding",
    "history.dahl_sigma": "dahl",
    "history.dahl_kappa": "dahl",
    "history.broken": "breaking",
    "is_whole": "breaking",
    "unbreakable": "breaking",
    "pushing": "reaction",
    "free_joint": "joints",
}
"""Effect that a struct or one of its arrays is for; what is not here every scene has."""
_AUTHORED = frozenset(
    (
        *("ref", "stiffness", "damping", "springlength", "friction", "armature", "range"),
        *("margin", "limit_impedance"),
    )
)
"""Arrays of tendons that are the model's."""

_OWNED: tuple[Any, ...] = (
    data.BodyWork,
    data.IslandWork,
    data.RowWork,
    data.History,
    data.TreeWork,
    data.LoopWork,
    data.WorldWork,
    data.ColorWork,
    data.SleepWork,
)
"""Structs whose arrays are the solver's own, not the model's, a control's or a contact buffer's."""


def bytes_by_effect(solver: object) -> Counter[str]:
    """Memory of a solver's arrays [bytes], by the effect that they are for.

    What every scene has is under ``""``. Not counted is what graphs still hold that were captured
    before buffers grew.
    """
    sizes: Counter[str] = Counter()
    for name, array in _arrays(solver):
        group, _, own = name.rpartition(".")
        if group == "tree.tendons" and own in _AUTHORED:
            continue
        sizes[_OWNERS.get(name, _OWNERS.get(group, ""))] += array.capacity
    if not solver._flags.fluid:  # type: ignore[attr-defined]
        sizes["servos"] += sizes.pop("fluid", 0)
    for name in ("restitution", "put_bodies", "second_order"):  # moving surfaces share their drift
        if sizes[name]:
            sizes[name] += sizes.pop("moving_surfaces", 0)
    return sizes


def _arrays(solver: object) -> Iterator[tuple[str, wp.array]]:
    """Arrays of the solver and of its structs, with their names without underscores."""
    owned = {struct.key for struct in _OWNED}
    for name, value in vars(solver).items():
        if isinstance(value, wp.array):
            yield name.strip("_"), value
        elif _struct_name(value) in owned:
            yield from members(name.strip("_"), value)


def members(name: str, struct: Any) -> Iterator[tuple[str, wp.array]]:
    """Arrays in a struct, and in the structs that it holds."""
    for key in struct._cls.vars:
        value = getattr(struct, key)
        if isinstance(value, wp.array):
            yield f"{name}.{key}", value
        elif _struct_name(value):
            yield from members(f"{name}.{key}", value)


def _struct_name(value: object) -> str:
    """Name of the type of a Warp struct; empty for anything else."""
    return getattr(getattr(value, "_cls", None), "key", "")
