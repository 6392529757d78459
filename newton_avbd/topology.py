# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How joints link the bodies of a model: which make trees, and in which order to visit bodies."""

from dataclasses import dataclass, fields

import newton
import numpy as np

from .rows.joint import KINDS


@dataclass(frozen=True, eq=False)
class Topology:
    """Blocks of bodies, and the order in which they are solved."""

    order: np.ndarray
    """All bodies: worlds in turn, the bodies of a block together, parents before children."""
    block_end: np.ndarray
    """End of the block that ``order[i]`` belongs to, a position in ``order``."""
    joint: np.ndarray
    """Joint that links each body to its parent in a tree, -1 without one."""
    axis_start: np.ndarray
    """First degree of freedom of each body's joint, counted over the trees; shape (bodies + 1,)."""
    loops: np.ndarray
    """Joints that constrain and are not part of a tree."""
    parent: np.ndarray
    """Parent of each body in its tree, -1 for a root."""
    has_flips: bool
    """Whether a tree goes from the child of a joint to its parent somewhere."""
    worlds: np.ndarray
    """World, as the solver sees it, of each body."""

    def __eq__(self, other: object) -> bool:
        """Whether everything is equal."""
        return isinstance(other, Topology) and all(
            np.array_equal(getattr(self, field.name), getattr(other, field.name))
            for field in fields(self)
        )

    @property
    def rank(self) -> np.ndarray:
        """Position of each body in ``order``."""
        rank = np.empty_like(self.order)
        rank[self.order] = np.arange(len(self.order))
        return rank

    @classmethod
    def of_model(cls, model: newton.Model, worlds: np.ndarray, *, trees: bool) -> "Topology":
        """Reads the joints of a model; copies model arrays to the host.

        Args:
            model: The model.
            worlds: World, as the solver sees it, of each body.
            trees: Whether joints make blocks; otherwise each body is a block of its own.
        """
        count = model.body_count
        joint = np.full(count, -1)
        loops = []
        root = np.arange(count)

        def find(body: int) -> int:
            while root[body] != body:
                root[body] = root[root[body]]
                body = root[body]
            return body

        parent_of = np.full(count, -1)
        moves = (model.body_inv_mass.numpy() > 0.0) & (
            model.body_flags.numpy() & int(newton.BodyFlags.KINEMATIC) == 0
        )
        kinds = model.joint_type.numpy() if model.joint_count else []
        parents = model.joint_parent.numpy() if model.joint_count else []
        children = model.joint_child.numpy() if model.joint_count else []

        def can_hang(body: int, other: int) -> bool:
            """Whether a joint to ``other`` can link a body to its parent in a tree."""
            is_new = other < 0 or find(body) != find(other)
            return joint[body] < 0 and is_new and bool(moves[body])

        has_flips = False
        for index, kind in enumerate(kinds):
            parent, child = int(parents[index]), int(children[index])
            if kind == newton.JointType.FREE:
                continue
            if not moves[child] and (parent < 0 or not moves[parent]):
                continue
            below, above = child, parent
            is_flipped = parent >= 0 and not can_hang(child, parent)
            if is_flipped:
                below, above = parent, child
            if not trees or not KINDS[kind].in_tree or not can_hang(below, above):
                loops.append(index)
                continue
            has_flips |= is_flipped
            joint[below] = index
            parent_of[below] = above
            if above >= 0:
                root[find(below)] = find(above)

        order: list[int] = []
        ends: list[int] = []
        by_parent: list[list[int]] = [[] for _ in range(count)]
        for body in range(count):
            if parent_of[body] >= 0:
                by_parent[parent_of[body]].append(body)
        starts = [body for body in range(count) if parent_of[body] < 0]
        for start in sorted(starts, key=lambda body: (worlds[body], body)):
            begin = len(order)
            order.append(start)
            position = begin
            while position < len(order):
                order.extend(by_parent[order[position]])
                position += 1
            ends.extend([len(order)] * (len(order) - begin))

        dofs = np.zeros(count, dtype=int)
        if np.any(joint >= 0):
            dims = model.joint_dof_dim.numpy().sum(axis=1)
            dofs[joint >= 0] = dims[joint[joint >= 0]]
        return cls(
            order=np.array(order, dtype=np.int32),
            block_end=np.array(ends, dtype=np.int32),
            joint=joint.astype(np.int32),
            parent=parent_of.astype(np.int32),
            has_flips=has_flips,
            worlds=worlds,
            axis_start=np.concatenate([[0], np.cumsum(dofs)]).astype(np.int32),
            loops=np.array(loops, dtype=np.int32),
        )
