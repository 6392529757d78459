# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Pairs of shapes of one articulation that its joints can never part.

Newton lets two links that a joint connects pass through each other, but not a link and what is
welded to its neighbor, nor two links further apart whose shapes the file draws too large. Contacts
push such a pair apart for good and cannot win: no solver can close what the file leaves open.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import newton
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Detect = Callable[[newton.State], tuple[NDArray[np.int64], Array]]
"""Finds the contacts of a state: their shapes, shape [k, 2], and gaps [m], shape [k]."""

LIGHT = 1.0e-9
"""Largest mass of a link without shapes that is a part of joints [kg]."""
DEPTH = 1.0e-4
"""Overlap that counts [m]: what touches is left alone."""

SAMPLES = 24
"""Poses of the joints in which a pair must overlap. A pair that the joints part in one pose out of
ten is taken for one that they never part with a probability of 0.9^24, less than one in twelve."""

SHOWN = 4
"""Pairs that a note names."""

_LOOSE = (newton.JointType.FREE, newton.JointType.DISTANCE)
_FAR = 10.0
"""How far a free joint between two links carries them apart [m]."""


@dataclass(frozen=True)
class Overlap:
    """Two shapes that overlap for good.

    Attributes:
        shapes: Indices of the shapes, the lower first.
        bodies: Names of their bodies.
        depth: Depth of the overlap in the first pose [m].
        reason: Why the joints do not part them.
    """

    shapes: tuple[int, int]
    bodies: tuple[str, str]
    depth: float
    reason: str


def find_overlaps(model: newton.Model, detect: Detect) -> tuple[Overlap, ...]:
    """Find the pairs of shapes of ``model`` that its joints cannot part.

    They overlap in the model's first pose by more than :data:`DEPTH`, belong to one articulation,
    and are welded together, or are neighbors through welds, or overlap in each of :data:`SAMPLES`
    random poses of the joints within their limits.

    Args:
        model: The model.
        detect: Finds contacts of a state.

    Returns:
        The pairs, the deepest first.
    """
    articulation = _articulations(model)
    body = model.shape_body.numpy()
    first = {
        pair: depth
        for pair, depth in _depths(*detect(model.state())).items()
        if min(body[list(pair)]) >= 0
        and articulation[body[pair[0]]] == articulation[body[pair[1]]] >= 0
    }
    if not first:
        return ()
    group, neighbors = _groups(model), _neighbors(model)
    reasons: dict[tuple[int, int], str] = {}
    for pair in first:
        a, b = (group[body[shape]] for shape in pair)
        if a == b:
            reasons[pair] = "they are welded together"
        elif frozenset((a, b)) in neighbors:
            reasons[pair] = "they are neighbors through welds"
    together = set(first) - set(reasons)
    for state in _random_poses(model) if together else ():
        together &= set(_depths(*detect(state)))
        if not together:
            break
    reasons |= dict.fromkeys(together, "no pose of their joints parts them")
    names = model.body_label
    return tuple(
        Overlap(pair, (names[body[pair[0]]], names[body[pair[1]]]), first[pair], reasons[pair])
        for pair in sorted(reasons, key=lambda pair: -first[pair])
    )


def filter_neighbors(builder: newton.ModelBuilder) -> None:
    """Let links that are welded together, or are neighbors through welds, pass each other.

    Newton's importers filter the two links of each joint; links that are merged with
    ``collapse_fixed_joints`` and MuJoCo's bodies without joints are filtered as the link is that
    they are part of. Without it a link's hull jams between two of the next one.
    """
    group, neighbors = _groups(builder), _neighbors(builder)
    shapes: dict[int, list[int]] = {}
    for shape, body in enumerate(builder.shape_body):
        if body >= 0 and builder.shape_flags[shape] & newton.ShapeFlags.COLLIDE_SHAPES:
            shapes.setdefault(int(group[body]), []).append(shape)
    apart = {frozenset((own,)) for own in shapes} | neighbors
    for pair in apart & {frozenset((a, b)) for a in shapes for b in shapes}:
        a, b = min(pair), max(pair)
        for first, second in product(shapes[a], shapes[b]):
            if a != b or first < second:
                builder.add_shape_collision_filter_pair(first, second)


def describe_overlaps(overlaps: tuple[Overlap, ...]) -> list[str]:
    """Say which links overlap for good and what to do, one sentence each; nothing for none."""
    # Worlds that are alike overlap alike.
    pairs: dict[tuple[str, str], list[Overlap]] = {}
    for overlap in overlaps:
        pairs.setdefault(overlap.bodies, []).append(overlap)
    notes = [
        f"{a} and {b} overlap by {1e3 * found[0].depth:.3g} mm for good, as {found[0].reason}: "
        f"filter the pair with builder.add_shape_collision_filter_pair{found[0].shapes}"
        + (f", and {len(found) - 1} more of these two" if len(found) > 1 else "")
        for (a, b), found in list(pairs.items())[:SHOWN]
    ]
    if len(pairs) > SHOWN:
        notes.append(f"{len(pairs) - SHOWN} more pairs of links overlap for good")
    return notes


def _depths(shapes: NDArray[np.int64], gaps: Array) -> dict[tuple[int, int], float]:
    """Deepest overlap of each pair of shapes that overlaps by more than :data:`DEPTH` [m]."""
    depths: dict[tuple[int, int], float] = {}
    deep = gaps < -DEPTH
    for pair, gap in zip(np.sort(shapes[deep], axis=1), gaps[deep], strict=True):
        key = (int(pair[0]), int(pair[1]))
        depths[key] = max(depths.get(key, 0.0), -float(gap))
    return depths


def _articulations(model: newton.Model) -> NDArray[np.int64]:
    """Articulation of each body, -1 for none, shape [bodies]."""
    owner = np.full(model.body_count, -1, np.int64)
    if model.joint_count:
        tree = model.joint_articulation.numpy() >= 0
        owner[model.joint_child.numpy()[tree]] = model.joint_articulation.numpy()[tree]
    return owner


def _groups(robot: newton.Model | newton.ModelBuilder) -> NDArray[np.int64]:
    """Number of the rigid group of each body: what joints without a free axis weld together."""
    group = np.arange(robot.body_count)
    kind, parents, children = map(_of, (robot.joint_type, robot.joint_parent, robot.joint_child))
    start, dims = _of(robot.joint_qd_start), _of(robot.joint_dof_dim)
    lower, upper = _of(robot.joint_limit_lower), _of(robot.joint_limit_upper)
    for joint, (parent, child) in enumerate(zip(parents, children, strict=True)):
        axes = slice(start[joint], start[joint] + sum(dims[joint]))
        locked = kind[joint] == newton.JointType.D6 and np.all(lower[axes] == upper[axes])
        if parent >= 0 and (locked or kind[joint] == newton.JointType.FIXED):
            group[group == group[child]] = group[parent]
    return group


def _neighbors(robot: newton.Model | newton.ModelBuilder) -> set[frozenset[int]]:
    """Rigid groups that a joint connects, or several joints with light groups between them."""
    group = _groups(robot)
    is_solid = _of(robot.body_mass) > LIGHT
    is_solid[[body for body in _of(robot.shape_body) if body >= 0]] = True
    solid = set(group[is_solid].tolist())
    joints = [
        (int(group[parent]), int(group[child]))
        for parent, child in zip(_of(robot.joint_parent), _of(robot.joint_child), strict=True)
        if parent >= 0
    ]
    above = {child: parent for parent, child in reversed(joints) if parent != child}
    found = set()
    for parent, child in joints:
        seen = {child}
        while parent not in solid and parent in above and parent not in seen:
            seen.add(parent)
            parent = above[parent]
        found.add(frozenset((parent, child)))
    return found


def _of(values: Any) -> NDArray[Any]:
    """An array of a model, or a list of a builder, in NumPy."""
    return values.numpy() if hasattr(values, "numpy") else np.asarray(values)


def _random_poses(model: newton.Model) -> Iterator[newton.State]:
    """States in which every joint is somewhere within its limits."""
    rng = np.random.default_rng(0)
    state = model.state()
    q_start, qd_start = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
    kind, parent = model.joint_type.numpy(), model.joint_parent.numpy()
    linear = model.joint_dof_dim.numpy()[:, 0]
    lower, upper = (
        limit.numpy().astype(float) for limit in (model.joint_limit_lower, model.joint_limit_upper)
    )
    leader, coefficients = model.joint_mimic_joint.numpy(), model.joint_mimic_coeffs.numpy()
    for _ in range(SAMPLES):
        q = model.joint_q.numpy().astype(float)
        for joint in range(model.joint_count):
            at, axes = q_start[joint], range(qd_start[joint], qd_start[joint + 1])
            if kind[joint] == newton.JointType.BALL:
                turn = rng.normal(size=4)
                q[at : at + 4] = turn / np.linalg.norm(turn)
            elif kind[joint] in _LOOSE:
                if parent[joint] >= 0:
                    q[at : at + 3] += rng.uniform(-_FAR, _FAR, 3)
            elif kind[joint] != newton.JointType.ROD:
                for i, dof in enumerate(axes):
                    widest = 1.0 if i < linear[joint] else np.pi
                    low, high = max(lower[dof], -widest), min(upper[dof], widest)
                    q[at + i] = rng.uniform(low, high) if low < high else lower[dof]
        for follower in np.flatnonzero(leader >= 0):
            offset, factor = coefficients[follower]
            length = q_start[follower + 1] - q_start[follower]
            at, followed = q_start[follower], q_start[leader[follower]]
            q[at : at + length] = offset + factor * q[followed : followed + length]
        state.joint_q.assign(q.astype(np.float32))
        newton.eval_fk(model, state.joint_q, state.joint_qd, state)
        yield state
