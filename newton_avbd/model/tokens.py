# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Massless links between joints: which there are, and the token masses that stand for nothing.

The elimination of an articulation never needs the inertia of a link itself, only that what hangs
on it resists the free axes of its joint. A token mass of a millionth of what hangs on the link is
nothing beside that, and keeps every formula of a body that moves.
"""

import warnings
from collections.abc import Sequence
from typing import Any

import newton
import numpy as np

from .equalities import may_hold
from .topology import joint_of_dof
from .unresisted import armature_of, tied_links, unresisted_dofs
from .welds import is_kinematic

SHARE = 1.0e-6
"""Token mass of a massless link, of the mass that hangs on it: float32 tells 6e-8."""
_MOST_NAMES = 3


def token_masses(
    model: newton.Model, solved: Any, mass: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Token masses and moments of massless bodies that joints move, and which bodies may move.

    A body without mass is immovable where no joint holds it as a child, or only rods do: it is
    where the user puts it. One that joints hold is a massless link, and moves with what hangs on
    it.

    Args:
        model: The user's model.
        solved: The model as the solver solves it: bodies of welded links, and their joints.
        mass: Mass of each body [kg], shape (bodies,).

    Returns:
        Mass [kg] and moment of inertia [kg m^2] of each, zero for all others, and whether each
        body may move: it has mass, or such a token; three arrays of shape (bodies,).

    Raises:
        ValueError: If an articulation has neither mass nor armature, or a massless root floats and
            nothing that hangs on it resists its motion.
    """
    count = mass.size
    token_mass, token_moment = np.zeros(count), np.zeros(count)
    massless = (mass == 0.0) & ~is_kinematic(solved) & ~solved.welds.is_static[solved.body_leader]
    if not np.any(massless) or solved.joint_count == 0:
        return token_mass, token_moment, mass > 0.0
    is_free = solved.joint_type.numpy() == int(newton.JointType.FREE)
    child, parent = solved.joint_child.numpy(), solved.joint_parent.numpy()
    held, linked = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    # a rod leaves all axes free: what it ends at without mass is where the user holds it
    is_tie = ~is_free & may_hold(model)[solved.welds.joint]
    is_rigid = is_tie & (solved.joint_type.numpy() != int(newton.JointType.ROD))
    held[child[is_rigid]] = True
    linked[parent[(parent >= 0) & (is_free | is_rigid)]] = True
    floats = np.zeros(count, dtype=bool)
    floats[child[is_free]] = True
    # a lone link, and a mount that no joint holds, are where the user puts them
    is_welded = np.bincount(solved.welds.body[solved.welds.body >= 0], minlength=count) > 1
    moved = massless & (held | (floats & (linked | is_welded)))
    if not np.any(moved):
        return token_mass, token_moment, mass > 0.0

    up = np.full(count, -1)
    joint = np.full(count, -1)
    for index in np.flatnonzero(is_tie)[::-1].tolist():
        up[child[index]], joint[child[index]] = parent[index], index
    place = model.body_q.numpy()[solved.body_leader].astype(np.float64)[:, :3]
    spread = _spread(model)[solved.body_leader]
    hung, moment = mass.copy(), np.zeros(count)
    for level in _ancestors(up):
        below = np.flatnonzero(level >= 0)
        top = level[below]
        np.add.at(hung, top, mass[below])
        apart = np.sum((place[below] - place[top]) ** 2, axis=1)
        np.add.at(moment, top, spread[below] + mass[below] * apart)

    armature, sets = armature_of(model), tied_links(model)
    whole, size, added = (of[solved.body_leader] for of in _of_sets(model, sets, armature))
    _refuse_empty(model, solved.body_leader[moved & (whole + added == 0.0)], sets)
    # a leaf has nothing to compare with but its own armature, or what it is tied to
    own = _armature(solved, joint, armature)
    amount = np.where(hung > 0.0, hung, np.where(whole > 0.0, whole, added))
    leaf = np.where(own > 0.0, own, np.where(size > 0.0, size, added))
    token_mass[moved] = SHARE * amount[moved]
    token_moment[moved] = SHARE * np.where(moment > 0.0, moment, leaf)[moved]
    token_moment[moved] = np.maximum(token_moment[moved], 1.0e-4 * token_mass[moved])
    _report_unresisted(model, solved, np.flatnonzero(moved), floats & ~held)
    return token_mass, token_moment, (mass > 0.0) | moved


def _spread(model: newton.Model) -> np.ndarray:
    """Mean principal moment of inertia of each link [kg m^2]."""
    return np.trace(model.body_inertia.numpy().astype(np.float64), axis1=1, axis2=2) / 3.0


def _of_sets(
    model: newton.Model, sets: np.ndarray, armature: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, moment about the mean place, and armature of the set of each link."""
    count = model.body_count
    place = model.body_q.numpy().astype(np.float64)[:, :3]
    mass = model.body_mass.numpy().astype(np.float64)
    whole = np.bincount(sets, mass, count)
    divisor = np.where(whole > 0.0, whole, 1.0)
    mean = np.column_stack([np.bincount(sets, mass * axis, count) / divisor for axis in place.T])
    apart = np.sum((place - mean[sets]) ** 2, axis=1)
    size = np.bincount(sets, _spread(model) + mass * apart, count)
    owner = model.joint_child.numpy()[joint_of_dof(model)]
    added = np.bincount(sets[owner], armature, count)
    return whole[sets], size[sets], added[sets]


def _ancestors(up: np.ndarray) -> list[np.ndarray]:
    """Parents of all bodies, then their parents, until all are at a root; -1 where none is."""
    levels: list[np.ndarray] = []
    level = up
    while np.any(level >= 0) and len(levels) < up.size:
        levels.append(level)
        level = np.where(level >= 0, up[level], -1)
    return levels


def _armature(solved: Any, joint: np.ndarray, armature: np.ndarray) -> np.ndarray:
    """Most armature of the axes of a body's joint [kg or kg m^2], zero without."""
    most = np.zeros(joint.size)
    start = solved.joint_qd_start.numpy()
    for body in np.flatnonzero(joint >= 0):
        axes = armature[start[joint[body]] : start[joint[body] + 1]]
        most[body] = axes.max(initial=0.0)
    return most


def _refuse_empty(model: newton.Model, empty: np.ndarray, sets: np.ndarray) -> None:
    """Raises a ValueError if there are links whose set has neither mass nor armature."""
    if empty.size:
        link = empty[0]
        of_set = sets == sets[link]
        joints = np.flatnonzero(of_set[model.joint_child.numpy()])
        raise ValueError(
            f"The articulation of body {link} '{model.body_label[link]}' has neither mass nor "
            f"armature (bodies {_names(model.body_label, np.flatnonzero(of_set))}; joints "
            f"{_names(model.joint_label, joints)}), so that nothing says how it moves. Give its "
            "links mass (a shape with density, or <inertial>) or its joints armature, or make it "
            "kinematic (BodyFlags.KINEMATIC)."
        )


def _report_unresisted(
    model: newton.Model, solved: Any, moved: np.ndarray, floats: np.ndarray
) -> None:
    """Looks for joint speeds that no mass resists, where massless links move.

    Raises:
        ValueError: If a massless root that floats has such a speed.
    """
    links = solved.body_leader[moved]
    flat = unresisted_dofs(model, links)
    if not flat:
        return
    joints = np.unique(joint_of_dof(model)[flat])
    child = model.joint_child.numpy()[joints]
    roots = [
        (joint, link)
        for joint, link in zip(joints, child, strict=True)
        if floats[solved.body_of_link[link]] and np.isin(solved.body_of_link[link], moved)
        if model.joint_type.numpy()[joint] == int(newton.JointType.FREE)
    ]
    if roots:
        joint, link = roots[0]
        raise ValueError(
            f"Body {link} '{model.body_label[link]}' has no mass, floats on joint {joint} "
            f"'{model.joint_label[joint]}', and nothing that hangs on it resists all of its "
            "motion. Give it mass (a shape with density, or <inertial>), weld it to a link that "
            "has mass, or fix it to the world."
        )
    names = [
        f"'{model.joint_label[joint]}' (body '{model.body_label[link]}')"
        for joint, link in zip(joints[:_MOST_NAMES], child, strict=False)
    ]
    more = ", ..." if joints.size > _MOST_NAMES else ""
    warnings.warn(
        f"Nothing resists the motion of joint {', '.join(names)}{more}: no mass hangs on it, or "
        "its axis is that of another joint with a massless link between. Its links get a token "
        "mass. Give the body mass, the joint armature, or make the joint FIXED.",
        stacklevel=6,
    )


def _names(labels: Sequence[str], items: np.ndarray) -> str:
    names = ", ".join(repr(labels[item]) for item in items[:_MOST_NAMES])
    return names + (", ..." if items.size > _MOST_NAMES else "")
