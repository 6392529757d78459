# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joint speeds that no mass, no armature and no constraint resists, where links are massless."""

from collections.abc import Iterator

import newton
import numpy as np

from ..rows.joint import KINDS
from .actuators import Actuators, reflected_armature
from .equalities import equalities
from .inertia import inertia_root, rotation_matrix
from .topology import mimics

_FLAT = 1.0e-5
"""Joint speeds that move masses by less than this share of what each joint alone does with its
speed are without resistance; the Jacobian rounds to 1e-7."""


def armature_of(model: newton.Model) -> np.ndarray:
    """Armature of each degree of freedom, that of actuators included [kg or kg m^2]."""
    along = Actuators.of_model(model).axes
    return model.joint_armature.numpy() + reflected_armature(model, along, model.joint_dof_count)


def tied_dofs(model: newton.Model) -> list[tuple[int, int, float]]:
    """Degrees of freedom that follow others: which, the leader's (-1 for none), and the slope.

    Any slope stands for that of MuJoCo's polynomials.
    """
    starts = model.joint_qd_start.numpy()
    leaders, coefficients = mimics(model)
    found = []
    for joint in np.flatnonzero(leaders >= 0).tolist():
        for i in range(starts[joint + 1] - starts[joint]):
            pair = int(starts[joint] + i), int(starts[leaders[joint]] + i)
            found.append((*pair, float(coefficients[joint, 1])))
    for equality in equalities(model):
        dof = int(starts[equality.joint]) + equality.dof
        leader = equality.leader_dof
        found.append((dof, int(starts[equality.leader]) + leader if leader >= 0 else -1, 1.0))
    return found


def tied_links(model: newton.Model) -> np.ndarray:
    """Number of the set of each link: what joints, articulations and mimics tie is one.

    Returns:
        The numbers, shape (body_count,).
    """
    child, parent = model.joint_child.numpy(), model.joint_parent.numpy()
    articulation = model.joint_articulation.numpy()
    count = model.body_count
    inner, owned = parent >= 0, articulation >= 0
    dofs = np.array([tie[:2] for tie in tied_dofs(model) if tie[1] >= 0], dtype=int).reshape(-1, 2)
    ties = child[_joint_of_dof(model)[dofs]]
    a = np.concatenate([child[inner], child[owned], ties[:, 0]])
    b = np.concatenate([parent[inner], count + articulation[owned], ties[:, 1]])
    return _sets(count + model.articulation_count, a, b)[:count]


def _sets(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The least member of the set of each of some things, where pairs (a, b) are in one set."""
    label = np.arange(count)
    while True:
        least = np.minimum(label[a], label[b])
        new = label.copy()
        np.minimum.at(new, a, least)
        np.minimum.at(new, b, least)
        new = new[new]
        if np.array_equal(new, label):
            return label
        label = new


def _joint_of_dof(model: newton.Model) -> np.ndarray:
    return np.repeat(np.arange(model.joint_count), np.diff(model.joint_qd_start.numpy()))


def unresisted_dofs(model: newton.Model, links: np.ndarray) -> list[int]:
    """Degrees of freedom of speeds that nothing resists, at two poses.

    Loops, mimic joints, axes with equal limits and kinematic links allow no speed against them.

    Args:
        model: The model.
        links: Massless links; only articulations with some, and what is tied to these, count.
    """
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
    search = _Search(model, links)
    return sorted(search.found_at(first) & search.found_at(second))


class _Search:
    """The model on the host, and the articulations that are looked at together."""

    def __init__(self, model: newton.Model, links: np.ndarray) -> None:
        self.model = model
        self.child, self.parent = model.joint_child.numpy(), model.joint_parent.numpy()
        self.dofs = model.joint_qd_start.numpy()
        self.mass, self.inertia = model.body_mass.numpy(), model.body_inertia.numpy()
        self.armature, self.ties = armature_of(model), tied_dofs(model)
        self.is_led = model.body_flags.numpy() & int(newton.BodyFlags.KINEMATIC) != 0
        owner, self.start = model.joint_articulation.numpy(), model.articulation_start.numpy()
        self.articulation = np.full(model.body_count, -1)
        self.row = np.full(model.body_count, -1)
        inner = np.flatnonzero(owner >= 0)
        self.articulation[self.child[inner]] = owner[inner]
        self.row[self.child[inner]] = inner - self.start[owner[inner]]
        dims = model.joint_dof_dim.numpy().sum(axis=1)
        is_loop = (owner < 0) & (dims < 6) & model.joint_enabled.numpy()
        self.loops = np.flatnonzero(is_loop)
        joint = _joint_of_dof(model)
        self.articulation_of_dof = owner[joint]
        has_axes = np.array([KINDS[kind].has_axes for kind in model.joint_type.numpy().tolist()])
        self.locked = has_axes[joint]
        self.locked &= model.joint_limit_lower.numpy() == model.joint_limit_upper.numpy()
        sets = tied_links(model)
        wanted = np.unique(sets[links])
        of_loop = sets[self.child[self.loops]]
        first = self.child[self.start[: model.articulation_count]]
        self.groups = [
            (np.flatnonzero(sets[first] == one).tolist(), self.loops[of_loop == one].tolist())
            for one in wanted
        ]

    def found_at(self, state: newton.State) -> set[int]:
        """Degrees of freedom of speeds that nothing resists in a state."""
        jacobians = newton.eval_jacobian(self.model, state)
        if jacobians is None:
            return set()
        self.pose, self.jacobians = state.body_q.numpy().astype(np.float64), jacobians.numpy()
        found: set[int] = set()
        known = set()
        for articulations, loops in self.groups:
            spans = [(self.dofs[self.start[i]], self._end(i)) for i in articulations]
            dofs = np.concatenate([np.arange(*span) for span in spans] or [np.zeros(0, dtype=int)])
            if dofs.size == 0:
                continue
            members = [self._members(i) for i in articulations]
            links = np.concatenate(members or [np.zeros(0, dtype=int)])
            held = np.array([*self._held(links, loops, dofs)]).reshape(-1, dofs.size)
            content = (held, self.jacobians[articulations], self.mass[links], self.inertia[links])
            key = tuple(array.tobytes() for array in (*content, self.armature[dofs]))
            if key in known:
                continue  # another copy of the same robot
            known.add(key)
            found |= set(dofs[_flat(self._weighted(links, dofs), held)].tolist())
        return found

    def _end(self, articulation: int) -> int:
        return int(self.dofs[self.model.articulation_end.numpy()[articulation]])

    def _members(self, articulation: int) -> np.ndarray:
        end = self.model.articulation_end.numpy()[articulation]
        return self.child[self.start[articulation] : end]

    def _motion(self, link: int, dofs: np.ndarray) -> np.ndarray:
        """Velocity of a link, of its COM first, by some joint speeds, shape (6, dofs)."""
        motion = np.zeros((6, dofs.size))
        articulation = self.articulation[link] if link >= 0 else -1
        if articulation >= 0:
            own = self.articulation_of_dof[dofs] == articulation
            rows = self.jacobians[articulation, 6 * self.row[link] :][:6, : int(own.sum())]
            motion[:, own] = rows
        return motion

    def _weighted(self, links: np.ndarray, dofs: np.ndarray) -> np.ndarray:
        """Joint speeds to speeds by the roots of the masses that they move; a matrix."""
        rows = [np.diag(np.sqrt(self.armature[dofs].astype(np.float64)))]
        for link in links[self.mass[links] > 0.0]:
            motion = self._motion(link, dofs)
            root = inertia_root(self.inertia[link].astype(float))
            root = rotation_matrix(self.pose[link, 3:]) @ root
            rows += [np.sqrt(float(self.mass[link])) * motion[:3], root.T @ motion[3:]]
        return np.vstack(rows)

    def _held(self, links: np.ndarray, loops: list[int], dofs: np.ndarray) -> Iterator[np.ndarray]:
        """What constraints allow no speed of, a row each."""
        column = {dof: i for i, dof in enumerate(dofs.tolist())}
        unit = np.eye(dofs.size)
        yield from unit[self.locked[dofs]]
        for dof, leader, slope in self.ties:
            if dof in column:
                yield unit[column[dof]] - (slope * unit[column[leader]] if leader >= 0 else 0.0)
        for link in links[self.is_led[links]]:
            yield from self._motion(link, dofs)
        for joint in loops:
            yield from self._closed(joint, dofs)

    def _closed(self, joint: int, dofs: np.ndarray) -> Iterator[np.ndarray]:
        """How the ends of a joint that closes a loop part along what it locks, a row each."""
        turn, apart = np.eye(3), np.zeros((6, dofs.size))
        com = self.model.body_com.numpy()
        for link, frame, sign in (
            (self.parent[joint], self.model.joint_X_p.numpy()[joint], -1.0),
            (self.child[joint], self.model.joint_X_c.numpy()[joint], 1.0),
        ):
            if link < 0:
                turn = rotation_matrix(frame[3:])
                continue
            motion, own = self._motion(link, dofs), rotation_matrix(self.pose[link, 3:])
            arm = own @ (frame[:3] - com[link])
            apart[:3] += sign * (motion[:3] + np.cross(motion[3:], arm, axis=0))
            apart[3:] += sign * motion[3:]
            if sign < 0.0:
                turn = own @ rotation_matrix(frame[3:])
        linear, angular = self.model.joint_dof_dim.numpy()[joint]
        start = self.dofs[joint]
        for half, first, count in ((apart[:3], 0, linear), (apart[3:], linear, angular)):
            if count < 3:
                axes = self.model.joint_axis.numpy()[start + first :][:count] @ turn.T
                yield from np.linalg.svd(axes)[2][count:] @ half if count else half


def _flat(weighted: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Columns with which the rows of two matrices have a direction in common that none resists."""
    scale = np.linalg.norm(weighted, axis=0)
    if np.any(scale > 0.0):
        scale = np.where(scale > 0.0, scale, np.median(scale[scale > 0.0]))
    else:
        scale = np.ones_like(scale)
    held = held / scale
    held = held / (np.linalg.norm(held, axis=1).max(initial=0.0) or 1.0)
    values, vectors = np.linalg.svd(np.vstack([weighted / scale, held]), full_matrices=False)[1:]
    return np.flatnonzero(np.abs(vectors[values < _FLAT]).max(axis=0, initial=0.0) > 0.1)
