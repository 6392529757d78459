# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The model as the solver solves it: welded links are one body, massless links have a token mass.

A *link* is a body of the user's model. A *body* of the solver is what moves as one: a link, or the
links that welds (joints that leave nothing free: FIXED, or a D6 without axes) make rigid with each
other. Links that welds tie to the world are no body at all, but part of the static world.
"""

from dataclasses import dataclass

import newton
import numpy as np

from ..attributes import break_limits
from .equalities import may_hold
from .rotations import conjugate, product

STATIC = -1
"""Body of a link that is part of the static world."""
OPEN = 1.0e-4
"""From which anchor separation [m], and half of the angle [rad], on a weld is not where its links
are: files round to a few digits."""


IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""Pose of a frame in itself."""


@dataclass(frozen=True, eq=False)
class Welds:
    """Which links are one body, and which joints make them so."""

    body: np.ndarray
    """Body of each link, ``STATIC`` for one that is welded to the world, shape (links,)."""
    leader: np.ndarray
    """The link whose frame is that of each body, shape (bodies,)."""
    frame: np.ndarray
    """Pose of each link in the frame of its body, or of the world, shape (links, 7)."""
    is_static: np.ndarray
    """Whether welds tie each link to the world. What another joint has as its child is a body all
    the same, one that does not move."""
    joint: np.ndarray
    """Index in the model of each joint that the solver knows, shape (joints,)."""
    welded: np.ndarray
    """Indices of the joints that make links one body."""
    weld: np.ndarray
    """The weld that ties each link to the next one towards the root of its body, -1 at the root."""
    towards: np.ndarray
    """That link; -1 at a root, and for the world."""
    depth: np.ndarray
    """How many welds lie between each link and the root of its body."""

    def __eq__(self, other: object) -> bool:
        """Whether the same links are one body, in the same places."""
        return isinstance(other, Welds) and all(
            np.array_equal(getattr(self, name), getattr(other, name))
            for name in ("body", "leader", "frame", "joint", "weld", "towards")
        )

    @property
    def any(self) -> bool:
        """Whether a joint is a weld."""
        return self.welded.size > 0

    @classmethod
    def of_model(
        cls, model: newton.Model, *, wanted: bool, breakable: bool, before: "Welds | None" = None
    ) -> "Welds":
        """Finds the welds of a model; copies model arrays to the host.

        Args:
            model: The model.
            wanted: Whether welds are to make links one body; otherwise each link is a body.
            breakable: Whether joints break at the loads that the model authors. A joint that can
                break is no weld.
            before: What there was so far. Its leaders go on to lead, whatever masses are now.
        """
        count = model.body_count
        welds = _find_welds(model, breakable) if wanted else np.zeros(0, dtype=int)
        if welds.size == 0:
            links = np.arange(count)
            frame = np.tile(IDENTITY, (count, 1))
            none = np.full(count, -1)
            joints = np.arange(model.joint_count)
            still = np.zeros(count, dtype=bool)
            depth = np.zeros(count, dtype=int)
            return cls(links, links, frame, still, joints, welds, none, none, depth)

        child = model.joint_child.numpy()
        used, root = _spanning_forest(model, welds)
        is_static = root[:count] == root[count]
        kept = np.setdiff1d(np.arange(model.joint_count), welds)
        # what another joint has as its child has to be a body, also where it cannot move
        held = np.intersect1d(np.flatnonzero(is_static), child[kept])
        entry = np.full(count + 1, -1)
        linking = kept[model.joint_type.numpy()[kept] != int(newton.JointType.FREE)]
        entry[root[child[linking][::-1]]] = child[linking][::-1]
        led = np.flatnonzero(is_kinematic(model))
        entry[root[led]] = led
        frame, weld, towards, depth = _walk(model, used, root, entry, is_static)

        led_before = np.zeros(count, dtype=bool)
        if before is not None:
            led_before[before.leader] = True
        leader = _leaders(model, root[:count], led_before)
        is_leader = (leader == np.arange(count)) & ~is_static
        is_leader[held] = True
        bodies = np.flatnonzero(is_leader)
        number = np.full(count, STATIC)
        number[bodies] = np.arange(bodies.size)
        body = np.where(is_static, number, number[leader])
        # of a body that moves poses count from its leader, in the static world from the world
        in_body = multiply(inverse(frame[leader]), frame)
        frame = np.where(is_static[:, None], frame, in_body)
        frame[bodies] = IDENTITY
        return cls(body, bodies, frame, is_static, kept, welds, weld, towards, depth)


def is_kinematic(model: newton.Model) -> np.ndarray:
    """Which links the user moves."""
    return model.body_flags.numpy() & int(newton.BodyFlags.KINEMATIC) != 0


def _find_welds(model: newton.Model, breakable: bool) -> np.ndarray:
    """Joints that leave nothing free, are enabled, and cannot break.

    Those of MuJoCo's equality constraints are enabled where their rows are, too.
    """
    if model.joint_count == 0:
        return np.zeros(0, dtype=int)
    kinds, dims = model.joint_type.numpy(), model.joint_dof_dim.numpy().sum(axis=1)
    types = (int(newton.JointType.FIXED), int(newton.JointType.D6))
    is_weld = np.isin(kinds, types) & (dims == 0) & model.joint_enabled.numpy()
    is_weld &= may_hold(model)
    if breakable:
        for limit in break_limits(model).values():
            is_weld &= np.isposinf(limit.numpy())
    # what another solver moves stays a body of its own
    is_proxy = np.append(model.body_flags.numpy() & int(newton.BodyFlags.PROXY) != 0, False)
    is_weld &= ~is_proxy[model.joint_child.numpy()] & ~is_proxy[model.joint_parent.numpy()]
    return np.flatnonzero(is_weld & ~_leads_a_tree(model, is_weld))


def _leads_a_tree(model: newton.Model, is_weld: np.ndarray) -> np.ndarray:
    """Which joints outside of trees tie what a tree moves to what stands still or is led.

    So MuJoCo's welds to the world and to mocap bodies come out. They pull the tree as far as its
    other joints let them; welded to the mocap body, a link would leave those behind, and welded to
    the world it would stay where the state puts it. So would a free body that starts elsewhere than
    where the weld is to hold it.
    """
    child, parent = model.joint_child.numpy(), model.joint_parent.numpy()
    is_outside = model.joint_articulation.numpy() < 0
    candidates = is_weld & is_outside
    if not np.any(candidates):
        return candidates
    root = _spanning_forest(model, np.flatnonzero(is_weld & ~is_outside))[1]
    is_led, is_held = np.zeros((2, root.size), dtype=bool)
    is_led[root[np.append(np.flatnonzero(is_kinematic(model)), root.size - 1)]] = True
    moving = ~is_weld & ~is_outside & (model.joint_type.numpy() != int(newton.JointType.FREE))
    is_held[root[child[moving]]] = True
    ends = root[child], root[parent]
    is_open = _is_open(model)
    leads = [
        is_led[one] & (is_held[other] | (is_open & ~is_led[other]))
        for one, other in (ends, ends[::-1])
    ]
    return candidates & (leads[0] | leads[1])


def _is_open(model: newton.Model) -> np.ndarray:
    """Which joints hold their links elsewhere than where the model puts them, by :data:`OPEN`."""
    poses = np.vstack([model.body_q.numpy().astype(np.float64), IDENTITY])
    start, end = (
        multiply(poses[getattr(model, f"joint_{end}").numpy()], frames.numpy().astype(np.float64))
        for end, frames in (("parent", model.joint_X_p), ("child", model.joint_X_c))
    )
    apart = multiply(inverse(start), end)
    return (np.abs(apart[:, :6]) > OPEN).any(axis=1)


def _spanning_forest(model: newton.Model, welds: np.ndarray) -> tuple[list[int], np.ndarray]:
    """The welds that tie links which no others tie, and the root of each link's set.

    The world is the last of the links. What the user moves (a kinematic body) stays apart from
    the world and from other such bodies.
    """
    count = model.body_count
    root = list(range(count + 1))
    led = [*is_kinematic(model).tolist(), True]

    def find(link: int) -> int:
        while root[link] != link:
            root[link] = link = root[root[link]]
        return link

    used = []
    child, parent = model.joint_child.numpy().tolist(), model.joint_parent.numpy().tolist()
    for joint in welds.tolist():
        a, b = find(child[joint]), find(parent[joint] if parent[joint] >= 0 else count)
        if a != b and not (led[a] and led[b]):
            root[a], led[b] = b, led[a] or led[b]
            used.append(joint)
    return used, np.array([find(link) for link in range(count + 1)])


def _walk(
    model: newton.Model, used: list[int], root: np.ndarray, entry: np.ndarray, is_static: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Walks each set of welded links from its root: poses in the root's frame, and ways to it.

    The root of a set is the world, its kinematic link, the link that another joint holds, or any.
    """
    count = model.body_count
    child, parent = model.joint_child.numpy(), model.joint_parent.numpy()
    frame_p = model.joint_X_p.numpy().astype(np.float64)
    frame_c = model.joint_X_c.numpy().astype(np.float64)
    frame = np.tile(IDENTITY, (count + 1, 1))
    weld, towards, depth = np.full(count, -1), np.full(count, -1), np.zeros(count, dtype=int)
    sets = np.unique(root[:count][~is_static])
    first = np.where(entry[sets] >= 0, entry[sets], sets)
    known = np.zeros(count + 1, dtype=bool)
    known[first], known[count] = True, True
    joints = np.array(used, dtype=int)
    ends = np.stack([child[joints], np.where(parent[joints] < 0, count, parent[joints])])
    level = 0
    while joints.size:
        level += 1
        down = known[ends[1]] & ~known[ends[0]]
        up = known[ends[0]] & ~known[ends[1]]
        for reached, near, far, a, b in (
            (down, 1, 0, frame_p, frame_c),
            (up, 0, 1, frame_c, frame_p),
        ):
            at = joints[reached]
            start, link = ends[near][reached], ends[far][reached]
            frame[link] = multiply(multiply(frame[start], a[at]), inverse(b[at]))
            weld[link], depth[link] = at, level
            towards[link] = np.where(start == count, -1, start)
        left = ~(down | up)
        known[ends[0][down]] = True
        known[ends[1][up]] = True
        joints, ends = joints[left], ends[:, left]
    return frame[:count], weld, towards, depth


def _leaders(model: newton.Model, root: np.ndarray, led_before: np.ndarray) -> np.ndarray:
    """The leader of each link's set: the kinematic body, otherwise one that led before, otherwise
    the heaviest link."""
    is_led = is_kinematic(model)
    mass = model.body_mass.numpy()
    order = np.lexsort((np.arange(root.size), -mass, ~led_before, ~is_led, root))
    sets, first = np.unique(root[order], return_index=True)
    return order[first][np.searchsorted(sets, root)]


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of poses (position, quaternion xyzw), shape (n, 7)."""
    p, q = a[:, :3], a[:, 3:]
    vector, scalar = q[:, :3], q[:, 3:]
    turned = np.cross(vector, b[:, :3]) + scalar * b[:, :3]
    position = p + b[:, :3] + 2.0 * np.cross(vector, turned)
    return np.hstack([position, product(q, b[:, 3:])])


def inverse(a: np.ndarray) -> np.ndarray:
    """Inverses of poses, shape (n, 7)."""
    turn = conjugate(a[:, 3:])
    zero = np.hstack([np.zeros((len(a), 3)), turn])
    back = multiply(zero, np.hstack([-a[:, :3], np.tile(IDENTITY[3:], (len(a), 1))]))
    return np.hstack([back[:, :3], turn])
