# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joint speeds that no mass, no armature and no constraint resists, where links are massless."""

from collections.abc import Iterator
from dataclasses import dataclass

import newton
import numpy as np

from ..rows.joint import CONNECT, KINDS
from .actuators import Actuators
from .equalities import equalities, may_hold
from .inertia import inertia_root
from .rotations import rotation_matrix
from .topology import joint_of_dof, mimics
from .welds import is_kinematic

_FLAT = 1.0e-5
"""Joint speeds that move masses by less than this share of what each joint alone does with its
speed are without resistance; the Jacobian rounds to 1e-7."""


def armature_of(model: newton.Model) -> np.ndarray:
    """Armature of each degree of freedom, that of actuators included [kg or kg m^2]."""
    return model.joint_armature.numpy() + Actuators.of_model(model).armature(model)


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
    inner, owned = (parent >= 0) & may_hold(model), articulation >= 0
    dofs = np.array([tie[:2] for tie in tied_dofs(model) if tie[1] >= 0], dtype=int).reshape(-1, 2)
    ties = child[joint_of_dof(model)[dofs]]
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


def unresisted_dofs(model: newton.Model, links: np.ndarray) -> list[int]:
    """Degrees of freedom of speeds that nothing resists, at two poses.

    Loops, mimic joints, axes with equal limits and kinematic links allow no speed against them.

    Args:
        model: The model.
        links: Massless links; only articulations with some, and what is tied to these, count.
    """
    first, second = model.state(), model.state()
    starts, owner = model.joint_q_start.numpy(), model.joint_articulation.numpy()
    count = np.diff(starts)
    has_axes = np.repeat([KINDS[kind].has_axes for kind in model.joint_type.numpy()], count)
    # the same in copies of an articulation
    root = np.append(model.articulation_start.numpy(), 0)[owner]
    place = np.arange(has_axes.size) - np.repeat(np.where(owner < 0, 0, starts[root]), count)
    shift = np.random.default_rng(0).uniform(0.1, 0.5, has_axes.size)
    second.joint_q.assign(model.joint_q.numpy() + np.where(has_axes, shift[place], 0.0))
    newton.eval_fk(model, second.joint_q, second.joint_qd, second)
    # at the model's pose axes can be parallel that are not elsewhere
    search = _Search(model, links)
    return sorted(search.found_at(first) & search.found_at(second))


@dataclass(frozen=True)
class _Group:
    """What is looked at together; columns are its degrees of freedom, then six of a loose link."""

    articulations: np.ndarray
    dofs: np.ndarray
    """Degrees of freedom of these."""
    links: np.ndarray
    loose: dict[int, int]
    """First column of each link of no articulation that moves: as if no joint held it."""
    loops: np.ndarray
    """Joints of no articulation, which hold it, or close loops."""
    ties: list[tuple[int, int, float]]

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.dofs.size + 6 * len(self.loose)


class _Search:
    """The model on the host, and the groups that are looked at."""

    def __init__(self, model: newton.Model, links: np.ndarray) -> None:
        self.model = model
        self.child, self.parent = model.joint_child.numpy(), model.joint_parent.numpy()
        self.frames = model.joint_X_p.numpy(), model.joint_X_c.numpy()
        self.kinds = model.joint_type.numpy()
        self.com, self.axis = model.body_com.numpy(), model.joint_axis.numpy()
        self.dims, self.dofs = model.joint_dof_dim.numpy(), model.joint_qd_start.numpy()
        self.mass, self.inertia = model.body_mass.numpy(), model.body_inertia.numpy()
        self.armature = armature_of(model)
        self.is_led = is_kinematic(model)
        owner, start = model.joint_articulation.numpy(), model.articulation_start.numpy()
        self.articulation = np.full(model.body_count, -1)
        self.row = np.full(model.body_count, -1)
        inner = np.flatnonzero(owner >= 0)
        self.articulation[self.child[inner]] = owner[inner]
        self.row[self.child[inner]] = inner - start[owner[inner]]
        joint = joint_of_dof(model)
        self.articulation_of_dof = owner[joint]
        has_axes = np.array([KINDS[kind].has_axes for kind in model.joint_type.numpy().tolist()])
        self.locked = has_axes[joint]
        self.locked &= model.joint_limit_lower.numpy() == model.joint_limit_upper.numpy()
        self.groups = list(self._groups(links))

    def _groups(self, links: np.ndarray) -> Iterator[_Group]:
        """The sets of some links, those without a degree of freedom of an articulation left out."""
        model = self.model
        start, end = model.articulation_start.numpy(), model.articulation_end.numpy()
        is_loop = (model.joint_articulation.numpy() < 0) & (self.dims.sum(axis=1) < 6)
        loops = np.flatnonzero(is_loop & may_hold(model) & model.joint_enabled.numpy())
        is_loose = (self.articulation < 0) & (self.mass > 0.0)
        # what no joint holds has no mass to move by: it is where the user puts it
        is_loose[self.child[loops][self.articulation[self.child[loops]] < 0]] = True
        loose, ties = np.flatnonzero(is_loose & ~self.is_led), tied_dofs(model)
        sets, joint = tied_links(model), joint_of_dof(model)
        wanted = np.unique(sets[links])
        first = self.child[joint[np.array([tie[0] for tie in ties], dtype=int)]]
        members = (self.child[start[: model.articulation_count]], loose, self.child[loops], first)
        for trees, free, closing, tied in zip(
            *(_members(sets[of], wanted) for of in members), strict=True
        ):
            dofs = [np.arange(self.dofs[start[i]], self.dofs[end[i]]) for i in trees]
            count, free = sum(map(len, dofs)), loose[free]
            if count == 0:
                continue
            yield _Group(
                articulations=trees,
                dofs=np.concatenate(dofs),
                links=np.concatenate([*(self.child[start[i] : end[i]] for i in trees), free]),
                loose={link: count + 6 * i for i, link in enumerate(free.tolist())},
                loops=loops[closing],
                ties=[ties[i] for i in tied],
            )

    def found_at(self, state: newton.State) -> set[int]:
        """Degrees of freedom of speeds that nothing resists in a state."""
        jacobians = newton.eval_jacobian(self.model, state)
        if jacobians is None:
            return set()
        self.pose, self.jacobians = state.body_q.numpy().astype(np.float64), jacobians.numpy()
        found: set[int] = set()
        known = set()
        for group in self.groups:
            dofs, links = group.dofs, group.links
            known_dofs, rates, locked = self._rates(group)
            held = np.vstack([*locked, *self._held(group, known_dofs, rates)])
            armature = self.armature[known_dofs]
            masses = self.mass[links], self.inertia[links], armature
            content = held, rates, self.jacobians[group.articulations], *masses
            key = tuple(array.tobytes() for array in content)
            if key in known:
                continue  # another copy of the same robot
            known.add(key)
            resisted = np.sqrt(armature.astype(np.float64))[:, None] * rates
            weighted = np.vstack([resisted, *self._weighted(group)])
            columns = _flat(weighted, held)
            found |= set(dofs[columns[columns < dofs.size]].tolist())
        return found

    def _motion(self, link: int, group: _Group) -> np.ndarray:
        """Velocity of a link, of its COM first, by the speeds of a group, shape (6, width)."""
        motion = np.zeros((6, group.width))
        if link in group.loose:
            motion[:, group.loose[link] :][:, :6] = np.eye(6)
        elif link >= 0 and self.articulation[link] >= 0:
            articulation = self.articulation[link]
            own = np.flatnonzero(self.articulation_of_dof[group.dofs] == articulation)
            motion[:, own] = self.jacobians[articulation, 6 * self.row[link] :][:6, : own.size]
        return motion

    def _weighted(self, group: _Group) -> Iterator[np.ndarray]:
        """Speeds of a group to speeds by the roots of the masses that they move; matrices."""
        for link in group.links[self.mass[group.links] > 0.0].tolist():
            motion = self._motion(link, group)
            root = inertia_root(self.inertia[link].astype(float))
            root = rotation_matrix(self.pose[link, 3:]) @ root
            yield np.sqrt(float(self.mass[link])) * motion[:3]
            yield root.T @ motion[3:]

    def _rates(self, group: _Group) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """How coordinates move with the speeds of a group.

        Returns:
            Degrees of freedom, those of loops behind those of trees, and the rates of each, a row
            each; and how the ends of the loops part along what these lock, matrices.
        """
        dofs, rates, locked = [group.dofs], [np.eye(group.dofs.size, group.width)], []
        for joint in group.loops.tolist():
            dofs.append(np.arange(self.dofs[joint], self.dofs[joint + 1]))
            for axes, apart in self._across(joint, group):
                rates.append(np.linalg.pinv(axes.T) @ apart)
                locked.append(np.linalg.svd(axes)[2][len(axes) :] @ apart)
        return np.concatenate(dofs), np.vstack(rates), locked

    def _held(self, group: _Group, dofs: np.ndarray, rates: np.ndarray) -> Iterator[np.ndarray]:
        """What limits, mimics and kinematic links allow no speed of; matrices.

        Args:
            group: What is looked at.
            dofs: Degrees of freedom.
            rates: Their rates, by the speeds of the group.
        """
        yield rates[self.locked[dofs]]
        rate = dict(zip(dofs.tolist(), rates, strict=True))
        rate[-1] = np.zeros(group.width)
        for dof, leader, slope in group.ties:
            if dof in rate and leader in rate:
                yield rate[dof] - slope * rate[leader]
        for link in group.links[self.is_led[group.links]].tolist():
            yield self._motion(link, group)

    def _across(self, joint: int, group: _Group) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Linear and angular axes of a joint, and how its ends part by the speeds of a group.

        Both in the world frame, shapes (axes, 3) and (3, width).
        """
        turn, apart = np.eye(3), np.zeros((6, group.width))
        for link, frame, sign in (
            (self.parent[joint], self.frames[0][joint], -1.0),
            (self.child[joint], self.frames[1][joint], 1.0),
        ):
            if link < 0:
                turn = rotation_matrix(frame[3:])
                continue
            motion, own = self._motion(link, group), rotation_matrix(self.pose[link, 3:])
            arm = own @ (frame[:3] - self.com[link])
            apart[:3] += sign * (motion[:3] + np.cross(motion[3:], arm, axis=0))
            apart[3:] += sign * motion[3:]
            # a state of random coordinates leaves a loose link where it is
            if sign < 0.0 or self.parent[joint] in group.loose:
                turn = own @ rotation_matrix(frame[3:])
        linear, angular = self.dims[joint]
        axes = self.axis[self.dofs[joint] :][: linear + angular] @ turn.T
        yield axes[:linear], apart[:3]
        if self.kinds[joint] != CONNECT:
            yield axes[linear:], apart[3:]


def _members(sets: np.ndarray, wanted: np.ndarray) -> list[np.ndarray]:
    """Indices of the things of each of some sets, where each thing is in one."""
    order = np.argsort(sets, kind="stable")
    ends = (np.searchsorted(sets[order], wanted, side) for side in ("left", "right"))
    return [order[first:last] for first, last in zip(*ends, strict=True)]


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
