# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Massless links between joints: which there are, and the token masses that stand for nothing.

The elimination of an articulation never needs the inertia of a link itself, only that what hangs
on it resists the free axes of its joint. A token mass of a millionth of what hangs on the link is
nothing beside that, and keeps every formula of a body that moves.
"""

import warnings
from typing import Any

import newton
import numpy as np

from ..rows.joint import KINDS
from .inertia import inertia_root, rotation_matrix

SHARE = 1.0e-6
"""Token mass of a massless link, of the mass that hangs on it: float32 tells 6e-8."""
_FLAT = 1.0e-5
"""Joint speeds that move masses by less than this share of what each joint alone does with its
speed are without resistance; the Jacobian rounds to 1e-7."""
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
        ValueError: If an articulation has no mass at all, or a massless root floats and nothing
            that hangs on it resists its motion.
    """
    count = mass.size
    token_mass, token_moment = np.zeros(count), np.zeros(count)
    is_kinematic = solved.body_flags.numpy() & int(newton.BodyFlags.KINEMATIC) != 0
    massless = (mass == 0.0) & ~is_kinematic & ~solved.welds.is_static[solved.body_leader]
    if not np.any(massless) or solved.joint_count == 0:
        return token_mass, token_moment, mass > 0.0
    is_free = solved.joint_type.numpy() == int(newton.JointType.FREE)
    child, parent = solved.joint_child.numpy(), solved.joint_parent.numpy()
    held, linked = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    # a rod leaves all axes free: what it ends at without mass is where the user holds it
    is_rigid = ~is_free & (solved.joint_type.numpy() != int(newton.JointType.ROD))
    held[child[is_rigid]] = True
    linked[parent[(parent >= 0) & (is_free | is_rigid)]] = True
    floats = np.zeros(count, dtype=bool)
    floats[child[is_free]] = True
    # a lone body, and a mount that no joint holds, are where the user puts them
    moved = massless & (held | (floats & linked))
    if not np.any(moved):
        return token_mass, token_moment, mass > 0.0

    up = np.full(count, -1)
    joint = np.full(count, -1)
    for index in np.flatnonzero(~is_free)[::-1].tolist():
        up[child[index]], joint[child[index]] = parent[index], index
    above = _ancestors(up)
    place = model.body_q.numpy()[solved.body_leader].astype(np.float64)[:, :3]
    inertia = model.body_inertia.numpy()[solved.body_leader].astype(np.float64)
    spread = np.trace(inertia, axis1=1, axis2=2) / 3.0
    hung, moment = mass.copy(), np.zeros(count)
    for level in above:
        below = np.flatnonzero(level >= 0)
        top = level[below]
        np.add.at(hung, top, mass[below])
        apart = np.sum((place[below] - place[top]) ** 2, axis=1)
        np.add.at(moment, top, spread[below] + mass[below] * apart)
    root = np.arange(count)
    for level in above:
        root = np.where(level >= 0, level, root)
    whole = np.bincount(root, mass, count)[root]
    _refuse_empty(solved, moved, whole, root)

    token_mass[moved] = SHARE * np.where(hung > 0.0, hung, whole)[moved]
    # a leaf has nothing to compare with but its own armature, or the rest of the tree
    size = np.bincount(root, spread + mass * np.sum((place - place[root]) ** 2, axis=1), count)
    armature = _armature(model, solved, joint)
    leaf = np.where(armature > 0.0, armature, SHARE * size[root])
    token_moment[moved] = SHARE * np.where(moment > 0.0, moment, leaf)[moved]
    token_moment[moved] = np.maximum(token_moment[moved], 1.0e-4 * token_mass[moved])
    _report_unresisted(model, solved, np.flatnonzero(moved), floats & ~held)
    return token_mass, token_moment, (mass > 0.0) | moved


def _ancestors(up: np.ndarray) -> list[np.ndarray]:
    """Parents of all bodies, then their parents, until all are at a root; -1 where none is."""
    levels: list[np.ndarray] = []
    level = up
    while np.any(level >= 0) and len(levels) < up.size:
        levels.append(level)
        level = np.where(level >= 0, up[level], -1)
    return levels


def _armature(model: newton.Model, solved: Any, joint: np.ndarray) -> np.ndarray:
    """Most armature of the axes of a body's joint [kg or kg m^2], zero without."""
    most = np.zeros(joint.size)
    start, armature = solved.joint_qd_start.numpy(), model.joint_armature.numpy()
    for body in np.flatnonzero(joint >= 0):
        axes = armature[start[joint[body]] : start[joint[body] + 1]]
        most[body] = axes.max(initial=0.0)
    return most


def _refuse_empty(solved: Any, moved: np.ndarray, whole: np.ndarray, root: np.ndarray) -> None:
    """Raises a ValueError where the tree of a massless link has no mass at all."""
    empty = np.flatnonzero(moved & (whole == 0.0))
    if empty.size:
        names = _names(solved.body_label, np.flatnonzero(root == root[empty[0]]))
        raise ValueError(
            f"The articulation of body {empty[0]} '{solved.body_label[empty[0]]}' has no mass at "
            f"all ({names}), so that nothing says how it moves. Give its links mass (a shape with "
            "density, or <inertial>), or make it kinematic (BodyFlags.KINEMATIC)."
        )


def _report_unresisted(
    model: newton.Model, solved: Any, moved: np.ndarray, floats: np.ndarray
) -> None:
    """Looks for joint speeds that no mass resists, where massless links move.

    Raises:
        ValueError: If a massless root that floats has such a speed.
    """
    links = solved.body_leader[moved]
    flat = _flat_dofs(model, links)
    if not flat:
        return
    owner = np.repeat(np.arange(model.joint_count), np.diff(model.joint_qd_start.numpy()))
    joints = np.unique(owner[flat])
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


def _flat_dofs(model: newton.Model, links: np.ndarray) -> list[int]:
    """Degrees of freedom of speeds that no mass resists, at two poses, where links are massless."""
    first, second = model.state(), model.state()
    q = model.joint_q.numpy().copy()
    random, starts = np.random.default_rng(0), model.joint_q_start.numpy()
    kinds = model.joint_type.numpy().tolist()
    for joint in np.flatnonzero([KINDS[kind].has_axes for kind in kinds]):
        axes = slice(starts[joint], starts[joint + 1])
        q[axes] += random.uniform(0.1, 0.5, q[axes].size)
    second.joint_q.assign(q)
    newton.eval_fk(model, second.joint_q, second.joint_qd, second)
    # at the model's pose axes can be parallel that are not elsewhere
    found = [_flat_at(model, state, links) for state in (first, second)]
    return sorted(set(found[0]) & set(found[1]))


def _flat_at(model: newton.Model, state: newton.State, links: np.ndarray) -> list[int]:
    jacobians = newton.eval_jacobian(model, state)
    if jacobians is None:
        return []
    child, dofs = model.joint_child.numpy(), model.joint_qd_start.numpy()
    mass, inertia = model.body_mass.numpy(), model.body_inertia.numpy()
    armature, pose = model.joint_armature.numpy(), state.body_q.numpy()
    gathered = jacobians.numpy()
    found, known = [], set()
    for articulation, (start, end) in enumerate(
        zip(model.articulation_start.numpy(), model.articulation_end.numpy(), strict=False)
    ):
        members = child[start:end]
        if not np.isin(links, members).any():
            continue
        count = dofs[end] - dofs[start]
        motion = gathered[articulation, : 6 * members.size, :count].astype(np.float64)
        own = armature[dofs[start] : dofs[end]]
        content = (gathered[articulation], mass[members], inertia[members], own)
        key = tuple(array.tobytes() for array in content)
        if key in known:
            continue  # another copy of the same robot
        known.add(key)
        rows = [np.diag(np.sqrt(own.astype(np.float64)))]
        for i, link in enumerate(members):
            if mass[link] > 0.0:
                root = rotation_matrix(pose[link, 3:]) @ inertia_root(inertia[link].astype(float))
                rows += [np.sqrt(float(mass[link])) * motion[6 * i : 6 * i + 3]]
                rows += [root.T @ motion[6 * i + 3 : 6 * i + 6]]
        weighted = np.vstack(rows)
        scale = np.linalg.norm(weighted, axis=0)
        alone = np.flatnonzero(scale <= 0.0)
        weighted = weighted / np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.svd(weighted, full_matrices=False)[1:]
        flat = np.abs(vectors[values < _FLAT]).max(axis=0, initial=0.0) > 0.1
        found += [int(dofs[start] + dof) for dof in np.union1d(np.flatnonzero(flat), alone)]
    return found


def _names(labels: list[str], bodies: np.ndarray) -> str:
    names = ", ".join(repr(labels[body]) for body in bodies[:_MOST_NAMES])
    return names + (", ..." if bodies.size > _MOST_NAMES else "")
