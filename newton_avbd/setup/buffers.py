# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Buffers of a solver, struct by struct, on Warp's current device."""

from typing import Any

import newton
import numpy as np
import warp as wp

from .. import data
from ..drivers.barrier import WARP
from ..effects import Effects
from ..model.tendons import TendonEquality, pulled
from ..model.topology import Topology, moving
from ..rows.path import JOINT
from ..step.piles import OUTSIDE
from .views import lists

SIDES = 2
"""What is remembered of contacts lies on two sides, read and written in turn."""


def body_work(slots: int, second_order: bool) -> Any:
    """What a step works out of bodies, by body slot."""
    work = data.BodyWork()
    data.allocate(work, slots, "com", "inv_mass", "inertia", "inv_inertia", "target", "increment")
    data.allocate(work, slots, "momentum", "spin_momentum", "finite", "pose", "factor")
    if second_order:
        data.allocate(work, slots, "wrench", "lead", "coasting", "input_energy")
    return work


WARPS = 8
"""Warps that a multiprocessor of a GPU holds, of a kernel that takes all 255 registers a thread."""


def spread(worlds: np.ndarray, multiprocessors: int) -> np.ndarray:
    """World of each thread of a GPU, or -1: as few in a warp as there are warps for.

    Threads of a warp wait for each other wherever their worlds differ: 1,024 humanoids that fall
    took 18 to 42 times as long, 32 in a warp, as one of them alone.
    """
    warps = max(1, WARPS * multiprocessors)
    abreast = min(WARP, -(-worlds.size // warps))
    groups = -(-worlds.size // abreast)
    threads = np.full((groups, WARP), -1, dtype=np.int32)
    threads[:, :abreast].flat[: worlds.size] = worlds
    return threads.ravel()


def world_work(topology: Topology, second_order: bool, on_gpu: bool) -> Any:
    """Which bodies are those of a world, and what becomes of it."""
    groups = topology.worlds
    count = int(groups.max(initial=0)) + 1
    worlds = data.WorldWork()
    starts = np.searchsorted(groups[topology.order], np.arange(count + 1))
    data.fill(worlds, body_start=starts, bodies=topology.order, of_body=np.append(groups, -1))
    data.fill(worlds, block_end=np.append(topology.block_end, -1))
    data.fill(worlds, rank=np.append(topology.rank, topology.rank.size))
    if on_gpu:
        by_size = np.argsort(-np.diff(starts), kind="stable")
        data.fill(worlds, turn=spread(by_size, wp.get_device().sm_count))
    data.allocate(worlds, count, "held", "sweeps", "update", "settled", "repaired", "bounded")
    data.allocate(worlds, count, "excess", "unbounded")
    data.allocate(worlds, 1, "overflow", "dropped")
    if second_order:
        data.allocate(worlds, count, "step")
    return worlds


def add_world_history(history: Any, count: int, second_order: bool) -> None:
    """What is remembered of worlds."""
    data.allocate(history, count, "parity", "step", "age")
    data.allocate(history, (count, 2), "filling")
    if second_order:
        data.allocate(history, count, "smooth", "slope_age")


def island_work(slots: int) -> Any:
    """Islands, by body slot."""
    islands = data.IslandWork()
    data.allocate(islands, slots, "parent", "fixed", "sum")
    return islands


def row_work(slots: int) -> Any:
    """Which rows are those of a body, by body slot."""
    rows = data.RowWork()
    data.allocate(rows, slots, "owned_start", "owned_end", "other_start", "other_end")
    return rows


def history(model: newton.Model, second_order: bool, is_linked: bool, sides: int = SIDES) -> Any:
    """What is remembered of the last step, by body slot, and of joints with ``second_order``.

    Of what drives axes only where joints link bodies.
    """
    slots = model.body_count + 1
    history = data.History()
    data.allocate(history, (sides, slots), "start", "end")
    data.allocate(history, slots, "gained")
    if second_order:
        data.allocate(history, slots, "last", "pushing", "flying")
        data.allocate(history, model.joint_dof_count, "coordinate", "rate")
        driven = model.joint_dof_count if is_linked else 0
        data.allocate(history, driven, "input")
    return history


def pile_work(slots: int, count: int) -> Any:
    """Piles of free bodies, by body slot, of at most ``count`` worlds or islands."""
    piles = data.PileWork()
    # the static world, in the last slot, is in no pile
    piles.parent = wp.full(slots, value=OUTSIDE, dtype=wp.int32)
    data.allocate(piles, slots, "order", "level", "supports", "mass", "whole", "held", "lasting")
    data.allocate(piles, slots, "shared", "ll", "al", "aa", "link_ll", "link_al", "link_aa")
    data.allocate(piles, slots, "push", "group", "tied", "update")
    data.allocate(piles, count, "end")
    return piles


def tree_work(model: newton.Model, topology: Topology) -> Any:
    """Trees of joints, by body slot."""
    tree = data.TreeWork()
    count, axes = model.body_count, int(topology.axis_start[-1])
    slots = count + 1
    parent = np.full(slots, count)
    parent[:-1] = np.where(topology.parent < 0, count, topology.parent)
    rotation = np.zeros((slots, 4), dtype=np.float32)
    rotation[:, 3] = 1.0
    joint = np.append(topology.joint, int(data.NO_JOINT))
    joint[:-1][~topology.is_alone & (topology.joint < 0)] = int(data.LONE)
    data.fill(tree, joint=joint, parent=parent, axis_start=topology.axis_start)
    data.allocate(tree, axes, "axes", "coordinate", "start_coordinate", "laws")
    data.allocate(tree, model.joint_dof_count, "start_velocity")
    data.fill(tree, rotation=rotation, turned=rotation, swing=rotation)
    data.allocate(tree, slots, "fewest", "patience", "is_minimal", "turn", "apart", "misfit")
    data.allocate(tree, slots, "is_left", "rounding", "span", "closing", "update", "is_touched")
    data.allocate(tree, slots, "own_ll", "own_al", "own_aa", "h_ll", "h_al", "h_aa")
    data.allocate(tree, slots, "is_fast", "n_ll", "n_al", "n_aa", "push", "load")
    return tree


def runge_kutta_work(slots: int, axes: int, worlds: int) -> Any:
    """Stages of steps of fourth order, by body slot, entry of the tree's axes and world."""
    work = data.RungeKuttaWork()
    data.allocate(work, slots, "guess", "left_qd", "start_velocity", "velocity", "before", "moved")
    data.allocate(work, slots, "gain", "left_q", "place", "ball_start")
    data.allocate(work, axes, "rate", "start_rate", "axis_moved", "axis_gain", "gained")
    data.allocate(work, worlds, "is_known", "waits", "turns")
    return work


def add_joint_history(history: Any, model: newton.Model, rest_angle: wp.array) -> None:
    """What is remembered of joints, by body slot and by degree of freedom."""
    slots, dofs = model.body_count + 1, model.joint_dof_count
    data.allocate(history, slots, "joint_force", "left_q", "lost", "acceleration")
    history.joint_angle = wp.clone(rest_angle)
    data.allocate(history, dofs, "piece", "axis_velocity", "held_at")
    data.allocate(history, dofs, "limit_force", "friction_force")
    data.allocate(history, (model.joint_count, 2), "joined_qd")


def add_dahl_history(history: Any, model: newton.Model) -> None:
    """What is remembered of Dahl friction, by joint."""
    is_rod = model.joint_type.numpy() == int(newton.JointType.ROD)
    unknown = np.where(is_rod[:, None], np.inf, np.zeros(3))
    data.allocate(history, model.joint_count, "dahl_sigma")
    data.fill(history, dahl_kappa=unknown)


def _held(model: newton.Model, joints: np.ndarray) -> np.ndarray:
    """The body that moves of each joint; of two the child."""
    child, parent = model.joint_child.numpy()[joints], model.joint_parent.numpy()[joints]
    return np.where(moving(model)[child] | (parent < 0), child, parent)


def loop_work(model: newton.Model, topology: Topology, groups: np.ndarray) -> Any:
    """Joints outside of trees, world by world; ``groups`` says which world a body belongs to."""
    loops = data.LoopWork()
    world_count = int(groups.max(initial=0)) + 1
    slots = model.body_count + 1
    child, parent = model.joint_child.numpy(), model.joint_parent.numpy()
    world = groups[_held(model, topology.loops)]
    order = np.argsort(world, kind="stable")
    joints = topology.loops[order]
    world_start = np.searchsorted(world[order], np.arange(world_count + 1))
    sides: list[list[int]] = [[] for _ in range(slots)]
    for i, joint in enumerate(joints):
        sides[child[joint]].append(2 * i)
        if parent[joint] >= 0:
            sides[parent[joint]].append(2 * i + 1)
    data.fill(loops, world_start=world_start, joints=joints)
    data.fill(loops, is_exact=np.isin(joints, [closure.joint for closure in topology.closures]))
    loops.body_start, loops.items = lists(sides)
    data.allocate(loops, joints.size, "is_soft", "apart", "misfit", "recovered", "closing")
    data.allocate(loops, joints.size, "kept_force", "kept_torque", "reach", "turn_reach", "side")
    data.allocate(loops, joints.size, "k_l", "k_a")
    data.allocate(loops, 2 * joints.size, "arms")
    data.allocate(loops, model.joint_dof_count, "stop_side", "stop_steps", "kept_stop")
    data.allocate(loops, model.joint_dof_count, "coordinate", "start_coordinate")
    return loops


def add_yielding(loops: Any, topology: Topology) -> None:
    """What joints that give way need beside.

    Args:
        loops: The :class:`.data.LoopWork` to fill.
        topology: How joints link the bodies.
    """
    count = topology.loops.size
    rates, impedance = np.zeros((count, 5)), np.zeros((count, 5))
    number = {joint: loop for loop, joint in enumerate(loops.joints.numpy().tolist())}
    for closure in topology.closures:
        if closure.yielding is not None:
            law = closure.yielding
            rates[number[closure.joint]] = (*law.rates, law.turn, *law.mobility)
            impedance[number[closure.joint]] = law.impedance
    data.fill(loops, yielding=rates, impedance=impedance)
    data.allocate(loops, count, "gives", "wanted", "span")


def add_closures(work: Any, topology: Topology, joints: list[int]) -> None:
    """Equations that are solved with trees, block by block.

    Args:
        work: The :class:`.data.ClosureWork` to fill.
        topology: How joints link the bodies.
        joints: Those outside of trees, in the order of :class:`.data.LoopWork`.
    """
    loop_of = {joint: loop for loop, joint in enumerate(joints)}
    body_of = {int(joint): body for body, joint in enumerate(topology.joint)}
    slots, rank = topology.order.size + 1, topology.rank
    block_of = np.full(topology.order.size, -1)
    blocks: list[data.ClosureBlock] = []
    closures: list[data.Closure] = []
    nodes = [data.ClosureNode() for _ in range(slots)]
    passing: list[list[tuple[int, int, int]]] = [[] for _ in range(slots)]
    top: list[int] = []
    ends: list[int] = []
    of_joint: list[tuple[int, int, int]] = []
    number = {cord.row: i for i, cord in enumerate(topology.tendons)}
    way_count = 2 * sum(item.rows for item in topology.closures)
    for item in topology.closures:
        first = int(np.searchsorted(topology.block_end, topology.block_end[rank[item.body]]))
        if block_of[first] < 0:
            block_of[first] = len(blocks)
            block = data.ClosureBlock()
            block.first, block.ground = len(closures), len(nodes)
            blocks.append(block)
            nodes.append(data.ClosureNode())
            passing.append([])
        closure = data.Closure()
        closure.loop = loop_of.get(item.joint, -1) if item.leader < 0 else -1
        closure.tendon = closure.other = -1
        closure.joint, closure.row, closure.rows = item.joint, len(top), item.rows
        closure.softness = item.softness
        closure.equality = -1
        if item.equality is not None:
            closure.equality = item.equality.row
            closure.dof, closure.leader_dof = item.equality.dof, item.equality.leader_dof
        if item.leader >= 0:
            closure.body, closure.leader_body = body_of[item.joint], body_of[item.leader]
        at = block.ground if item.top < 0 else item.top
        node = nodes[at]
        if node.end == 0:
            node.first, node.row = len(closures), closure.row
        closures.append(closure)
        top.extend([at] * item.rows)
        block.end = node.end = len(closures)
        node.row_end = len(top)
        if item.tendon is not None:
            cords = [number[cord.row] for cord in pulled(item.tendon)]
            closure.tendon = cords[0]
            if isinstance(item.tendon, TendonEquality):
                closure.other, closure.equality = cords[-1], item.tendon.row
            slot = {body: way_count + i for i, body in enumerate(item.ways[0])}
            closure.slot, closure.slot_end = way_count, way_count + len(slot)
            way_count = closure.slot_end
            for body in item.ways[0]:
                above = slot.get(int(topology.parent[body]), 2 * closure.row)
                passing[body].append((2 * closure.row, slot[body], above))
            slot[item.top] = 2 * closure.row
            closure.ends = len(ends)
            path = [element for cord in pulled(item.tendon) for element in cord.path]
            for body, element in zip(item.ends, path, strict=True):
                if element.kind == int(JOINT) and body >= 0:
                    of_joint.append((len(ends), body, len(passing[body]) - 1))
                ends.append(slot[body] if body >= 0 else -1)
            continue
        for side, way in enumerate(item.ways):
            for body in way:
                rows = range(2 * closure.row + side, 2 * len(top), 2)
                passing[body].extend((row, row, row) for row in rows)
    starts = np.cumsum([0, *map(len, passing)])
    for node, start, stop in zip(nodes, starts[:-1], starts[1:], strict=True):
        node.start, node.stop = start, stop
    for at, body, nth in of_joint:
        ends[at] = int(starts[body]) + nth
    for closure in closures:
        if closure.loop < 0 and closure.tendon < 0:
            place = [
                starts[body] + [item // 2 for item, *_ in passing[body]].index(closure.row)
                for body in (closure.body, closure.leader_body)
            ]
            closure.place, closure.leader_place = place
    last = [max([nodes[at].row_end - 1, *(i // 2 for i, *_ in passing[at][-1:])]) for at in top]
    gram = np.cumsum([0, *(np.array(last, dtype=int) - np.arange(len(top)) + 1)])
    for block in blocks:
        end = closures[block.end - 1]
        block.gram = gram[closures[block.first].row]
        block.gram_end = gram[end.row + end.rows]
    data.fill(work, block_of=block_of, blocks=blocks, closures=closures, nodes=nodes)
    places = np.array([place for body in passing for place in body], dtype=np.int32).reshape(-1, 3)
    data.fill(work, ends=ends, **dict(zip(("items", "slots", "next"), places.T, strict=True)))
    data.allocate(work, int(starts[-1]), "met")
    data.allocate(work, way_count, "way")
    data.allocate(work, len(top), "misfit", "direction", "whole", "stopped", "least", "gives")
    data.allocate(work, len(top), "held", "most", "loosened", "multiplier")
    data.fill(work, gram_row=gram[:-1] - np.arange(len(top)))
    data.allocate(work, int(gram[-1]), "gram")


def sleep_work(
    model: newton.Model, topology: Topology, effects: Effects, capacity: int, loops: Any, tree: Any
) -> Any:
    """What is known of the bodies that sleep, by body slot; none does.

    Args:
        model: The model.
        topology: How joints link its bodies.
        effects: What the kernels are compiled with.
        capacity: Contacts for which there is room.
        loops: The solver's :class:`.data.LoopWork`.
        tree: Its :class:`.data.TreeWork`.
    """
    slots, worlds = model.body_count + 1, int(topology.worlds.max(initial=0)) + 1
    sleep = data.SleepWork()
    tied = topology.tied(model)
    data.fill(sleep, tied=np.append(tied, slots - 1))
    data.allocate(sleep, slots, "still", "quiet", "woken", "met", "contacts", "end", "size")
    data.allocate(sleep, slots, "place", "blocks", "pose", "wrench")
    # the first step lists what is awake
    sleep.stirred = wp.ones(1, dtype=wp.int32)
    data.allocate(sleep, 1, "marks")
    data.allocate(sleep, worlds + 1, "block_start")
    sleep.start = wp.full(slots, value=-1, dtype=wp.int32)
    data.allocate(sleep, slots - 1, "order")
    data.fill(sleep, filled=[0, capacity, 0])
    data.allocate(sleep.islands, slots, "parent", "fixed")
    sleep.gravity = wp.clone(model.gravity)
    data.allocate(sleep, len(topology.tendons), "pull")
    if effects.joints:
        data.allocate(sleep, model.joint_dof_count, "joint_f", "target_qd")
        data.allocate(sleep, model.joint_coord_count, "target_q")
    if effects.loops:
        holders = np.full(worlds, -1)
        held = _held(model, topology.loops)
        holders[topology.worlds[held]] = held
        data.fill(sleep, loop_body=holders)
        sleep.loop_start = loops.world_start
        data.allocate(sleep, slots, "seen_loop_start")
    if effects.closures:
        sleep.block_of = tree.closures.block_of
        data.allocate(sleep, slots, "seen_block_of")
    return sleep


def seen_work(slots: int, world_count: int, second_order: bool) -> tuple[Any, Any]:
    """What the solve sees in the place of what is by world: worlds and history, of islands."""
    worlds, history = data.WorldWork(), data.History()
    data.allocate(worlds, slots, "body_start", "bodies", "sweeps")
    data.allocate(worlds, slots, "update", "settled", "pace", "step")
    # a body that is not listed makes no block
    worlds.block_end = wp.full(slots, value=-1, dtype=wp.int32)
    worlds.rank = wp.full(slots, value=slots - 1, dtype=wp.int32)
    data.allocate(worlds, world_count + 1, "island_start")
    # a thread of the CPU that finds nothing to do costs more than a body that sleeps
    worlds.threads = slots - 1 if wp.get_device().is_cuda else 1
    if second_order:
        data.allocate(history, slots, "slope_age")
    data.allocate(history, slots, "parity", "age", "smooth", "step")
    data.allocate(history, (slots, 2), "filling")
    return worlds, history
