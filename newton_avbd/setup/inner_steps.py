# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Error control on the host: its arrays, what a repeated step puts back, what cannot be asked."""

import math
from collections.abc import Iterable
from typing import Any

import newton
import numpy as np
import warp as wp

from .. import data
from ..effects import Effects
from ..model.topology import Topology, joint_of_dof
from .tendons import KEPT as KEPT_OF_TENDONS

SIDES = 3
"""Of what is kept of contacts: the last call's, and two that inner steps take by turns."""

_BY: dict[str, str] = {
    **dict.fromkeys(
        (
            *("history.joint_force", "history.left_q", "history.lost", "history.acceleration"),
            *("history.gained", "history.last", "history.pushing", "history.flying"),
            *("tree.runge_kutta.left_q", "tree.runge_kutta.left_qd"),
            "tree.runge_kutta.ball_start",
        ),
        "slot",
    ),
    **dict.fromkeys(
        (
            *("history.joint_angle", "history.piece", "history.axis_velocity", "history.held_at"),
            *("history.limit_force", "history.friction_force", "history.coordinate"),
            *("history.input", "history.rate", "loops.coordinate"),
        ),
        "dof",
    ),
    **dict.fromkeys(
        ("history.joined_qd", "history.broken", "history.dahl_sigma", "history.dahl_kappa"), "joint"
    ),
    **dict.fromkeys(("history.loop_force", "history.loop_torque", "history.loop_rate"), "loop"),
    **dict.fromkeys(
        (
            *("history.step", "history.age", "history.smooth", "history.slope_age"),
            *("history.parity", "history.filling", "worlds.step"),
            *("tree.runge_kutta.is_known", "tree.runge_kutta.waits"),
        ),
        "world",
    ),
    **dict.fromkeys(("tree.coordinate", "tree.runge_kutta.rate"), "axis"),
    **dict.fromkeys((f"tendons.{name}" for name in KEPT_OF_TENDONS), "tendon"),
}
"""What is by body slot, degree of freedom, ... of all that a step leaves to the next one."""

_KEPT = frozenset(
    (
        # of two or three sides, of which a step overwrites one that nothing reads
        *("history.start", "history.end", "history.records", "history.torque"),
        "history.row_of_contact",
        # written once a call, or by the controller itself
        *("work.put_from", "links.body_q_out", "links.body_qd_out", "links.left_qd"),
        *("history.change", "history.wanted", "history.ratio", "history.saved"),
        "history.next_side",
    )
)
"""What a repeated step does not have to put back."""

_BY_CALL = ("actuators.", "joint_state.")
"""How names begin of what only the start and the end of a call write."""

_ROUNDED = 7.0e-6
"""Smallest accuracy, as a share of sqrt(g L): steps in which rounding costs as much as what the
scheme leaves out have (eps/C)^(1/3) sqrt(L/g), and each rounds a length L by eps/2."""

_REFUSED = {
    "sleeping": ("sleeping=True", "Leave sleeping out."),
    "ramp": ("formulation='ramp'", "Leave formulation out."),
    "cables": ("Newton's tendons", "Leave accuracy out, or effects={'cables': False}."),
    "servos": (
        "MuJoCo's actuators that push bodies by how these move",
        "Leave accuracy out, or effects={'body_actuators': False}.",
    ),
    "adhesion": ("adhesion", "Leave accuracy out, or effects={'adhesion': False}."),
}
"""What error control does not do: its name, and the remedy."""


def check_effects(effects: Effects) -> None:
    """Check that a scene can be simulated in inner steps.

    Raises:
        NotImplementedError: If it cannot.
    """
    found = [_REFUSED[name] for name in _REFUSED if getattr(effects, name)]
    if found:
        what = " and ".join(name for name, _ in found)
        remedies = " ".join(dict.fromkeys(remedy for _, remedy in found))
        raise NotImplementedError(
            f"SolverAVBD(accuracy=...) does not simulate {what} in steps that it chooses itself. "
            f"{remedies}"
        )


def smallest_accuracy(model: newton.Model) -> float:
    """Smallest accuracy that single precision leaves room for [m/s]; see :data:`_ROUNDED`.

    Args:
        model: The model. Its size is how far a body is from the world's origin, or 0.1 m.
    """
    far = np.abs(model.body_q.numpy()[:, :3]).max(initial=0.1)
    gravity = float(np.linalg.norm(model.gravity.numpy(), axis=-1).max(initial=0.0))
    speed = float(np.abs(model.body_qd.numpy()[:, :3]).max(initial=0.0))
    return _ROUNDED * max(math.sqrt(max(gravity, 0.1) * far), speed)


def inner_work(
    accuracy: float, budget: int, model: newton.Model, groups: np.ndarray, pushing: np.ndarray
) -> data.InnerWork:
    """Arrays by body and by world.

    Args:
        accuracy: What is asked for [m/s].
        budget: Most inner steps of a call.
        model: The model as the solver solves it.
        groups: World of each body.
        pushing: Joints that push more than the child that is predicted with them.
    """
    slots, worlds = model.body_count + 1, int(groups.max(initial=0)) + 1
    inner = data.InnerWork()
    inner.accuracy, inner.budget = accuracy, budget
    data.allocate(inner, slots, "pose", "start", "velocity", "wrench", "put", "owned_end")
    data.allocate(inner, worlds, "steps", "rejected", "missed", "cause", "estimate", "spent")
    if pushing.size:
        of_joint = groups[model.joint_child.numpy()[pushing]]
        order = np.argsort(of_joint, kind="stable")
        start = np.searchsorted(of_joint[order], np.arange(worlds + 1))
        data.fill(inner, pushing=pushing[order], pushing_start=start)
    inner.worst = wp.full(worlds, value=-1, dtype=wp.int32)
    return inner


def add_history(history: data.History, slots: int, worlds: int) -> None:
    """What error control keeps from step to step."""
    data.allocate(history, slots, "change")
    data.allocate(history, worlds, "wanted", "ratio", "saved", "next_side")


def overwritten(remembered: Iterable[tuple[str, wp.array]]) -> list[tuple[str, wp.array]]:
    """What a step overwrites of the arrays that it leaves to the next one, by name."""
    return [
        (name, array)
        for name, array in remembered
        if name not in _KEPT and not name.startswith(_BY_CALL) and array.size
    ]


def add_memory(
    inner: data.InnerWork,
    memory: Iterable[tuple[str, wp.array]],
    model: newton.Model,
    topology: Topology,
    groups: np.ndarray,
    loops: np.ndarray,
    tendons: data.TendonModel,
    worlds: int,
) -> None:
    """Lists the memory of each world that a step overwrites.

    Args:
        inner: Where to.
        memory: What a step overwrites, by name.
        model: The model as the solver solves it.
        topology: How joints link its bodies.
        groups: World of each body.
        loops: Joints outside of trees, in the order of their arrays.
        tendons: MuJoCo's tendons, if there are any.
        worlds: Number of worlds.
    """
    of_joint = np.zeros(model.joint_count, dtype=int)
    of_dof = np.zeros(model.joint_dof_count, dtype=int)
    if model.joint_count:
        child, parent = model.joint_child.numpy(), model.joint_parent.numpy()
        # a joint outside of trees goes with a body that moves
        moves = model.body_inv_mass.numpy() > 0.0
        held = np.where(moves[child] | (parent < 0), child, parent)
        of_joint = groups[held]
        of_dof = of_joint[joint_of_dof(model)]
    of_tendon = np.zeros(0, dtype=int)
    if tendons.row is not None:
        start, body = tendons.start.numpy()[:-1], tendons.body.numpy()
        # a tendon goes with any body that it moves
        acts = np.append(model.body_inv_mass.numpy() > 0.0, False)[body]
        of_tendon = groups[np.maximum.reduceat(np.where(acts, body, -1), start)]
    axis_start = topology.axis_start
    axes = np.diff(axis_start[np.append(topology.order, groups.size)])
    world_of = {
        "slot": np.append(groups, -1),
        "dof": of_dof,
        "joint": of_joint,
        "loop": of_joint[loops],
        "world": np.arange(worlds),
        "axis": np.repeat(groups[topology.order], axes),
        "tendon": of_tendon,
    }
    segments: list[tuple[int, int, int]] = []
    for name, array in memory:
        owners = world_of[_BY[name]][: array.shape[0]]
        # of neighbors in one world a single segment
        starts = np.flatnonzero(np.diff(owners, prepend=-2))
        for start, end in zip(starts, np.append(starts[1:], owners.size), strict=True):
            if owners[start] >= 0:
                address = array.ptr + int(start) * array.strides[0]
                segments.append((int(owners[start]), address, int(end - start) * array.strides[0]))
    segments.sort(key=lambda segment: segment[0])
    segment_type: Any = data.Segment
    table: Any = np.zeros(len(segments), dtype=segment_type.numpy_dtype())
    owner, table["address"], table["size"] = np.array(segments, dtype=np.int64).reshape(-1, 3).T
    # each copy begins where words of eight bytes do
    room = (table["size"] + 7) // 8 * 8
    inner.store = wp.empty(int(room.sum()), dtype=wp.uint8)
    table["copy"] = inner.store.ptr + np.cumsum(room) - room
    data.fill(inner, first=np.searchsorted(owner, np.arange(worlds + 1)), segments=table)
