# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How joints link the bodies of a model: which make trees, and in which order to visit bodies."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import NamedTuple

import newton
import numpy as np

from ..rows.joint import CONNECT, KINDS, NO_LIMIT
from ..rows.path import PULLEY
from .equalities import Equality, equalities, may_hold, mimic_laws
from .tendons import Tendon, TendonEquality, pulled, tendon_equalities, tendon_name, tendons
from .welds import is_kinematic
from .yielding import Yielding, yielding_joints

_DISTANCE = int(newton.JointType.DISTANCE)
_ROD = int(newton.JointType.ROD)

CLOSURE_ROWS = 4096
"""Most equations that are solved with a tree, at most 64 MiB; beyond, its loops are closed sweep by
sweep, which does not converge."""
STRING_ROWS = 150
"""Most equations of bodies that DISTANCE joints tie, three for each. Such bodies have no tree to
eliminate them along: n equations cost n^3."""
STRING_SOFTNESS = 1.0e-3
"""Softness of their rows, of those of other joints, which imply each other more often. It is a
share of how mobile a row is, and so would stretch what ties light bodies and carries much."""


def moving(model: newton.Model) -> np.ndarray:
    """Whether the solver moves each body, shape (body_count,): it has mass and is not kinematic."""
    return (model.body_inv_mass.numpy() > 0.0) & ~is_kinematic(model)


def joint_of_dof(model: newton.Model) -> np.ndarray:
    """Joint of each degree of freedom, shape (joint_dof_count,)."""
    return np.repeat(np.arange(model.joint_count), np.diff(model.joint_qd_start.numpy()))


def stopped_joints(model: newton.Model) -> set[int]:
    """Joints that have an axis with a limit of its position or its velocity."""
    lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
    rate = model.joint_velocity_limit.numpy()
    has_limit = (lower > -newton.MAXVAL) | (upper < newton.MAXVAL)
    has_limit |= (rate > 0.0) & (rate < NO_LIMIT)
    return set(joint_of_dof(model)[has_limit].tolist())


@dataclass(frozen=True)
class ClosureOf:
    """A joint or tendon whose rows are solved with the tree that they are within."""

    joint: int
    """The joint that closes a loop, or that mimics; -1 for a tendon."""
    leader: int
    """The joint that it mimics, -1 for one that closes a loop."""
    rows: int
    """Directions that it locks, with those that it leaves free if it has stops there; coordinates
    that it ties; 1 for a tendon."""
    body: int
    """A body of the block."""
    top: int
    """The nearest body that carries all that the rows act on, -1 without: what they say does not
    depend on how it moves."""
    ways: tuple[tuple[int, ...], tuple[int, ...]]
    """Bodies on the two ways up the tree that lead there, without it. Those of a tendon, which may
    have more, are all in the first, each before its parent."""
    softness: float
    """How soft its rows are, of what those are that may imply each other."""
    equality: Equality | None = None
    """The polynomial by which it mimics, where that is MuJoCo's."""
    tendon: Tendon | TendonEquality | None = None
    """The tendon, or what ties it to another one."""
    yielding: Yielding | None = None
    """How it gives way; None for what is rigid."""
    ends: tuple[int, ...] = ()
    """The body that each element of its path pulls, then those of the other one, -1 where none."""


class _Link(NamedTuple):
    """A joint or tendon that ties bodies beyond their tree."""

    joint: int
    leader: int
    """The joint that it mimics, -1 for one that closes a loop."""
    bodies: list[int]
    """Those that are tied, two by a joint."""
    rows: int
    equality: Equality | None = None
    tendon: Tendon | TendonEquality | None = None


def mimics(model: newton.Model) -> tuple[np.ndarray, np.ndarray]:
    """Leader of each joint, -1 without one, and the offset and multiplier by which it follows.

    Those of joints and the deprecated sparse ones, which importers still make of MuJoCo's JOINT
    equality constraints, by whose rows they follow. A leader follows no other joint: a joint that
    mimics a mimic joint follows the first leader of that chain, by the composed offset and
    multiplier. A disabled joint within a chain does not interrupt it.

    Raises:
        ValueError: If a sparse one ties a joint that follows already, or joints of different kinds,
            or if joints mimic each other in a cycle.
    """
    leaders, coefficients = model.joint_mimic_joint.numpy(), model.joint_mimic_coeffs.numpy()
    if model.constraint_mimic_count:
        leaders, coefficients = leaders.copy(), coefficients.copy()
        laws = mimic_laws(model)
        is_enabled = model.constraint_mimic_enabled.numpy().copy()
        for index, law in laws.items():
            is_enabled[index] = law is not None
        for index in np.flatnonzero(is_enabled).tolist():
            law = laws.get(index)
            joint = model.constraint_mimic_joint0.numpy()[index]
            leader = model.constraint_mimic_joint1.numpy()[index]
            dims = model.joint_dof_dim.numpy()
            if leaders[joint] >= 0 or np.any(dims[joint] != dims[leader]):
                labels = model.joint_label
                raise ValueError(
                    f"Mimic constraint {index} ('{model.constraint_mimic_label[index]}') ties "
                    f"joint '{labels[joint]}', which follows another joint already or has other "
                    f"axes than '{labels[leader]}'. Use set_joint_mimic()."
                )
            leaders[joint] = leader
            coefficients[joint] = law or (
                model.constraint_mimic_coef0.numpy()[index],
                model.constraint_mimic_coef1.numpy()[index],
            )
    followers = np.flatnonzero(leaders >= 0)
    if not np.any(leaders[leaders[followers]] >= 0):
        return leaders, coefficients
    roots, composed = leaders.copy(), coefficients.copy()
    for joint in followers:
        chain = [int(joint)]
        while (leader := int(leaders[chain[-1]])) >= 0:
            if leader in chain:
                names = " -> ".join(f"'{model.joint_label[i]}'" for i in [*chain, leader])
                raise ValueError(
                    f"Joints mimic each other in a cycle: {names}. Let one of them lead: set its "
                    "joint_mimic_joint to -1, or disable its mimic constraint."
                )
            chain.append(leader)
        offset, multiplier = 0.0, 1.0
        for link in chain[:-1]:
            offset += multiplier * float(coefficients[link, 0])
            multiplier *= float(coefficients[link, 1])
        roots[joint], composed[joint] = chain[-1], (offset, multiplier)
    return roots, composed


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
    """First axis of each body's joint, counted in visiting order; shape (bodies + 1,), with the
    number of axes at the end."""
    loops: np.ndarray
    """Joints that constrain and are not part of a tree."""
    closures: list[ClosureOf]
    """What is solved with the trees beside their joints: block by block, and in the order in which
    elimination gets to their tops; at last those without."""
    parent: np.ndarray
    """Parent of each body in its tree, -1 for a root."""
    idle: np.ndarray
    """Whether a body that does not move has a joint that holds nothing because of that."""
    flipped: np.ndarray
    """Joints whose child carries their parent in a tree."""
    worlds: np.ndarray
    """World, as the solver sees it, of each body."""
    cabled: np.ndarray
    """Whether a cable touches each body, which is then solved as a tree, alone or not."""
    tendons: list[Tendon]
    """MuJoCo's tendons that act."""

    def __eq__(self, other: object) -> bool:
        """Whether everything is equal."""
        return isinstance(other, Topology) and all(
            np.array_equal(getattr(self, field.name), getattr(other, field.name))
            for field in fields(self)
        )

    def tied(self, model: newton.Model) -> np.ndarray:
        """First in visiting order of the bodies that joints or blocks tie to each body.

        What joints outside of trees tie to others counts as one in each world.
        """
        moves = moving(model)
        # in terms of ranks: the least one of a component is its first body
        rank, tied = self.rank, np.arange(len(self.order))
        starts = np.unique(self.block_end, return_index=True)[1]
        block = np.repeat(starts, np.diff(np.append(starts, len(self.order))))
        groups = [self.order[block == start] for start in np.unique(block[block != tied])]
        if model.joint_count:
            joints = np.stack([model.joint_child.numpy(), model.joint_parent.numpy()], axis=1)
            groups += list(joints[joints[:, 1] >= 0])
            loops = joints[self.loops]
            groups += [loops[self.worlds[loops[:, 0]] == w].ravel() for w in set(self.worlds)]
        for group in groups:
            members = [rank[body] for body in group if body >= 0 and moves[body]]
            for member in members[1:]:
                both = tied[[member, members[0]]]
                tied[tied == both.max()] = both.min()
        return self.order[tied][rank]

    @property
    def rank(self) -> np.ndarray:
        """Position of each body in ``order``."""
        rank = np.empty_like(self.order)
        rank[self.order] = np.arange(len(self.order))
        return rank

    @property
    def is_alone(self) -> np.ndarray:
        """Whether each body is a block of its own and hangs on no joint that is solved with it."""
        is_alone = (np.bincount(self.block_end)[self.block_end] == 1)[self.rank] & (self.joint < 0)
        is_alone[[closure.body for closure in self.closures]] = False
        return is_alone & ~self.cabled

    def in_company(self, chosen: np.ndarray) -> np.ndarray:
        """Those of the chosen bodies whose world has another one of them."""
        bodies = np.flatnonzero(chosen)
        return bodies[np.bincount(self.worlds[bodies])[self.worlds[bodies]] > 1]

    @classmethod
    def of_model(
        cls,
        model: newton.Model,
        worlds: np.ndarray,
        *,
        trees: bool,
        cabled: np.ndarray,
        has_tendons: bool,
    ) -> "Topology":
        """Reads the joints of a model; copies model arrays to the host.

        Args:
            model: The model.
            worlds: World, as the solver sees it, of each body.
            trees: Whether joints make blocks; otherwise each body is a block of its own.
            cabled: Whether a cable touches each body.
            has_tendons: Whether MuJoCo's tendons act.

        Raises:
            NotImplementedError: If tendons act, and joints make no blocks.
        """
        count = model.body_count
        joint = np.full(count, -1)
        loops = []
        root = list(range(count))
        parent_of = np.full(count, -1)
        moves = moving(model)
        # lists: an element of a NumPy array costs ten times as much
        kinds = model.joint_type.numpy().tolist() if model.joint_count else []
        parents = model.joint_parent.numpy().tolist() if model.joint_count else []
        children = model.joint_child.numpy().tolist() if model.joint_count else []

        def can_hang(body: int, other: int) -> bool:
            """Whether a joint to ``other`` can link a body to its parent in a tree."""
            is_new = other < 0 or find_root(root, body) != find_root(root, other)
            return joint[body] < 0 and is_new and bool(moves[body])

        idle = np.zeros(count, dtype=bool)
        flipped = []
        free = int(newton.JointType.FREE)
        numbers = solved_joints(model)
        off = {numbers[index] for index in np.flatnonzero(~may_hold(model)).tolist()}
        for index, kind in enumerate(kinds):
            parent, child = parents[index], children[index]
            if kind == free or index in off:
                continue
            if not moves[child] and (parent < 0 or not moves[parent]):
                idle[[child] if parent < 0 else [child, parent]] = True
                continue
            below, above = child, parent
            is_flipped = parent >= 0 and not can_hang(child, parent)
            if is_flipped:
                below, above = parent, child
            if not trees or not KINDS[kind].in_tree or not can_hang(below, above):
                loops.append(index)
                continue
            if is_flipped:
                flipped.append(index)
            joint[below] = index
            parent_of[below] = above
            if above >= 0:
                root[find_root(root, below)] = find_root(root, above)

        outer = loops if trees else []
        cords = tendons(model) if has_tendons else []
        if cords and not trees:
            raise NotImplementedError(
                f"blocks='body' solves each body by itself, and {tendon_name(model, cords[0].row)} "
                "ties bodies. Use blocks='articulation', or leave tendons out with "
                "effects={'tendons': False}."
            )
        closures, block_root = _closures(model, outer, cords, joint, parent_of, root, moves)

        order: list[int] = []
        ends: list[int] = []
        by_parent: list[list[int]] = [[] for _ in range(count)]
        starts: dict[int, list[int]] = {}
        for body, above in enumerate(parent_of.tolist()):
            if above >= 0:
                by_parent[above].append(body)
            else:
                starts.setdefault(find_root(block_root, body), []).append(body)
        for block in sorted(starts.values(), key=lambda roots: (worlds[roots[0]], roots[0])):
            begin = len(order)
            order.extend(block)
            position = begin
            while position < len(order):
                order.extend(by_parent[order[position]])
                position += 1
            ends.extend([len(order)] * (len(order) - begin))

        dofs = np.zeros(count, dtype=int)
        if np.any(joint >= 0):
            dims = model.joint_dof_dim.numpy().sum(axis=1)
            dofs[joint >= 0] = dims[joint[joint >= 0]]
        axis_start = np.zeros(count + 1, dtype=np.int32)
        axis_start[order] = np.cumsum(dofs[order]) - dofs[order]
        axis_start[-1] = dofs.sum()
        rank = np.argsort(order) if order else np.zeros(0, dtype=int)
        block_end = np.array(ends, dtype=np.int32)

        def turn(closure: ClosureOf) -> tuple[int, int, int]:
            """When the rows of a closure are eliminated: with the body that carries them."""
            above = -1 if closure.top < 0 else rank[closure.top]
            return block_end[rank[closure.body]], -above, rank[closure.body]

        closures.sort(key=turn)
        return cls(
            order=np.array(order, dtype=np.int32),
            block_end=block_end,
            joint=joint.astype(np.int32),
            parent=parent_of.astype(np.int32),
            idle=idle,
            flipped=np.array(flipped, dtype=np.int32),
            worlds=worlds,
            axis_start=axis_start,
            loops=np.array(loops, dtype=np.int32),
            closures=closures,
            cabled=cabled,
            tendons=cords,
        )


def find_root(root: list[int], body: int) -> int:
    """Root of a set of bodies; shortens the way for the next call."""
    while root[body] != body:
        root[body] = body = root[root[body]]
    return body


def _ways(
    ends: tuple[int, int], parent: np.ndarray, moves: np.ndarray, above: bool = False
) -> tuple[int, tuple[tuple[int, ...], tuple[int, ...]]]:
    """The nearest common ancestor of two bodies, -1 without, and the bodies on the ways there.

    Args:
        ends: The bodies, -1 for the world.
        parent: Parent of each body in its tree, -1 for a root.
        moves: Whether a body moves; one that does not ends a way.
        above: Whether none of the two may be the ancestor itself.
    """
    lines: list[list[int]] = []
    for end in ends:
        body, line = int(end), []
        while body >= 0 and moves[body]:
            line.append(body)
            body = int(parent[body])
        lines.append(line)
    if above:
        # one end may be an ancestor of the other: the longer way takes what both share
        lines.sort(key=len, reverse=True)
    first, second = lines
    shared = set(second[above:])
    top = next((body for body in first[above:] if body in shared), -1)
    if top >= 0:
        first, second = first[: first.index(top)], second[: second.index(top)]
    taken = set(first)
    return top, (tuple(first), tuple(body for body in second if body not in taken))


def _branches(
    ends: list[tuple[int, bool]], parent: np.ndarray, moves: np.ndarray
) -> tuple[int, tuple[int, ...]]:
    """As :func:`_ways` of any number of bodies: the top, and the bodies below it, children first.

    Args:
        ends: The bodies, -1 for the world, and whether each may not be the top itself.
        parent: Parent of each body in its tree, -1 for a root.
        moves: Whether a body moves.
    """
    lines: list[list[int]] = []
    above: list[set[int]] = []
    for end, is_below in ends:
        body, line = int(end), []
        while body >= 0 and moves[body]:
            line.append(body)
            body = int(parent[body])
        lines.append(line)
        above.append(set(line[is_below:]))
    shared = set.intersection(*above)
    top = next((body for body in lines[0] if body in shared), -1)
    height = {body: len(line) - i for line in lines for i, body in enumerate(line)}
    below = [body for body in height if body not in shared]
    return top, tuple(sorted(below, key=lambda body: (-height[body], body)))


def _held(
    tendon: Tendon, model: newton.Model, body_of: dict[int, int]
) -> list[tuple[int, bool] | None]:
    """What each element of a tendon's path pulls, None where nothing.

    A site or geom pulls the body that holds it, -1 for the world; a joint of a fixed tendon the
    body that it links to its parent, and so never with that as a whole.

    Raises:
        NotImplementedError: If a joint is not part of a tree.
    """
    if not tendon.is_fixed:
        owner = model.shape_body.numpy()
        return [(int(owner[e.index]), False) if e.is_held else None for e in tendon.path]
    number = solved_joints(model)
    found: list[tuple[int, bool] | None] = []
    for element in tendon.path:
        if number[element.index] not in body_of:
            label = getattr(model, "user_model", model).joint_label[element.index]
            raise NotImplementedError(
                f"{tendon_name(model, tendon.row)} combines joint {element.index} ('{label}'), "
                "which is not part of a tree: let another joint close the loop."
            )
        found.append((body_of[number[element.index]], True))
    return found


def _keeps_length(tendon: Tendon, held: list[tuple[int, bool] | None]) -> bool:
    """Whether a tendon runs within one body between its pulleys, and so moves nothing.

    Args:
        tendon: The tendon.
        held: See :func:`_held`.
    """
    if tendon.is_fixed:
        return False
    branches = np.cumsum([element.kind == int(PULLEY) for element in tendon.path]).tolist()
    ends = {(branch, end[0]) for branch, end in zip(branches, held, strict=True) if end}
    return len(ends) == len({branch for branch, _ in ends})


def solved_joints(model: newton.Model) -> list[int]:
    """By joint of the user's model: its index in what the solver makes of it, -1 for a weld."""
    welds = getattr(model, "welds", None)
    if welds is None or not welds.any:
        return list(range(model.joint_count))
    number = np.full(model.user_model.joint_count, -1)
    number[welds.joint] = np.arange(welds.joint.size)
    return number.tolist()


def _closures(
    model: newton.Model,
    loops: list[int],
    cords: list[Tendon],
    tree_joint: np.ndarray,
    tree_parent: np.ndarray,
    tree_root: list[int],
    moves: np.ndarray,
) -> tuple[list[ClosureOf], list[int]]:
    """What can be solved with the trees, and the blocks that trees make where it ties them.

    Returns:
        The closures, and the sets of bodies that are a block, as :func:`_find` reads them.

    Raises:
        NotImplementedError: If a mimic joint or its leader is not part of a tree.
    """
    if model.joint_count == 0:
        return [], tree_root
    ends = np.column_stack((model.joint_child.numpy(), model.joint_parent.numpy())).tolist()
    kinds = model.joint_type.numpy().tolist()
    dims = model.joint_dof_dim.numpy().sum(axis=1).tolist()
    body_of = dict(zip(tree_joint.tolist(), range(len(tree_joint)), strict=True))
    leaders, _ = mimics(model)
    stopped = stopped_joints(model) if loops else set()
    links: list[_Link] = []
    strings: list[_Link] = []
    for index in loops:
        if kinds[index] == _DISTANCE:
            strings.append(_Link(index, -1, ends[index], 3))
        elif kinds[index] == CONNECT:
            links.append(_Link(index, -1, ends[index], 3))
        elif kinds[index] == _ROD:
            links.append(_Link(index, -1, ends[index], 6))
        elif KINDS[kinds[index]].in_tree and dims[index] < 6:
            rows = 6 if index in stopped else 6 - dims[index]
            links.append(_Link(index, -1, ends[index], rows))
    ties: list[tuple[int, int, int, Equality | None]] = [
        (index, int(leaders[index]), dims[index], None)
        for index in map(int, np.flatnonzero(leaders >= 0))
    ]
    ties += [(equality.joint, equality.leader, 1, equality) for equality in equalities(model)]
    for index, leader, rows, equality in ties:
        if index not in body_of or leader not in body_of:
            raise NotImplementedError(
                f"Joint {index} ({model.joint_label[index]}) mimics joint {leader} "
                f"({model.joint_label[leader]}), and one of them is not part of a tree: "
                "let another joint close the loop, and use blocks='articulation'."
            )
        links.append(_Link(index, leader, [body_of[index], body_of[leader]], rows, equality))
    number = dict(enumerate(solved_joints(model)))
    yieldings = {number.get(joint, -1): each for joint, each in yielding_joints(model).items()}
    ends_of = {cord.row: _held(cord, model, body_of) for cord in cords}
    rows_of: list[Tendon | TendonEquality] = [*cords, *tendon_equalities(model, cords)]
    for one in rows_of:
        held = [end for each in pulled(one) for end in ends_of[each.row]]
        if all(_keeps_length(cord, ends_of[cord.row]) for cord in pulled(one)):
            continue
        links.append(_Link(-1, -1, [end[0] for end in held if end], 1, None, one))

    def tied(bodies: list[int]) -> list[int]:
        """The bodies that move; one at least."""
        return [body for body in bodies if body >= 0 and moves[body]]

    def merged(links: list[_Link]) -> list[int]:
        root = list(tree_root)
        for link in links:
            first, *others = tied(link.bodies)
            for body in others:
                root[find_root(root, body)] = find_root(root, first)
        return root

    def rows_by_block(links: list[_Link]) -> Callable[[list[int]], int]:
        """How many rows the block of some bodies has."""
        root = merged(links)
        rows_of: Counter[int] = Counter()
        for link in links:
            rows_of[find_root(root, tied(link.bodies)[0])] += link.rows
        return lambda bodies: rows_of[find_root(root, tied(bodies)[0])]

    links = [link for link in links if tied(link.bodies)]
    rows_with = rows_by_block(links + strings)
    strings = [link for link in strings if rows_with(link.bodies) <= STRING_ROWS]
    rows_with = rows_by_block(links + strings)
    kept = [
        link
        for link in links + strings
        if link.leader >= 0 or link.tendon or rows_with(link.bodies) <= CLOSURE_ROWS
    ]
    closures = []
    for joint, leader, bodies, rows, equality, cord in kept:
        first, softness = tied(bodies)[0], 1.0
        yielding = yieldings.get(joint) if leader < 0 else None
        tied_to: tuple[int, ...] = ()
        if cord is None:
            top, ways = _ways((bodies[0], bodies[1]), tree_parent, moves, above=leader >= 0)
            softness = STRING_SOFTNESS if kinds[joint] == _DISTANCE else 1.0
        else:
            held = [end for one in pulled(cord) for end in ends_of[one.row]]
            top, below = _branches([end for end in held if end], tree_parent, moves)
            ways = (below, ())
            tied_to = tuple(end[0] if end and tied([end[0]]) else -1 for end in held)
        closures.append(
            ClosureOf(
                joint, leader, rows, first, top, ways, softness, equality, cord, yielding, tied_to
            )
        )
    return closures, merged(kept)
