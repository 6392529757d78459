# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Buffers of a solver, struct by struct, on Warp's current device."""

from typing import Any

import newton
import numpy as np
import warp as wp

from .. import data
from ..algebra.block import BlockFactor
from ..drivers.barrier import WARP
from ..effects import Effects
from ..model.tendons import TendonEquality, pulled
from ..model.topology import Topology, moving
from ..rows.path import JOINT
from ..step.piles import OUTSIDE

SIDES = 2
"""What is remembered of contacts lies on two sides, read and written in turn."""


def body_work(slots: int, second_order: bool) -> Any:
    """What a step works out of bodies, by body slot."""
    work = data.BodyWork()
    work.com = wp.zeros(slots, dtype=wp.vec3)
    work.inv_mass = wp.zeros(slots, dtype=float)
    work.inertia = wp.zeros(slots, dtype=wp.mat33)
    work.inv_inertia = wp.zeros(slots, dtype=wp.mat33)
    work.target = wp.zeros(slots, dtype=wp.spatial_vector)
    work.increment = wp.zeros(slots, dtype=wp.spatial_vector)
    work.momentum = wp.zeros(slots, dtype=wp.vec3)
    work.spin_momentum = wp.zeros(slots, dtype=wp.vec3)
    work.finite = wp.zeros(slots, dtype=wp.int32)
    work.pose = wp.zeros(slots, dtype=wp.transform)
    work.factor = wp.zeros(slots, dtype=BlockFactor)
    if second_order:
        work.wrench = wp.zeros(slots, dtype=wp.spatial_vector)
        work.lead = wp.zeros(slots, dtype=wp.spatial_vector)
        work.coasting = wp.zeros(slots, dtype=wp.spatial_vector)
        work.input_energy = wp.zeros(slots, dtype=float)
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
    worlds.body_start = wp.array(starts, dtype=wp.int32)
    worlds.bodies = wp.array(topology.order, dtype=wp.int32)
    worlds.block_end = wp.array(np.append(topology.block_end, -1), dtype=wp.int32)
    worlds.rank = wp.array(np.append(topology.rank, topology.rank.size), dtype=wp.int32)
    worlds.of_body = wp.array(np.append(groups, -1), dtype=wp.int32)
    if on_gpu:
        by_size = np.argsort(-np.diff(starts), kind="stable")
        worlds.turn = wp.array(spread(by_size, wp.get_device().sm_count), dtype=wp.int32)
    worlds.held = wp.zeros(count, dtype=wp.int32)
    worlds.sweeps = wp.zeros(count, dtype=wp.int32)
    worlds.update = wp.zeros(count, dtype=float)
    worlds.settled = wp.zeros(count, dtype=float)
    worlds.overflow = wp.zeros(1, dtype=wp.int32)
    worlds.dropped = wp.zeros(1, dtype=wp.int32)
    worlds.repaired = wp.zeros(count, dtype=wp.int32)
    worlds.bounded = wp.zeros(count, dtype=wp.int32)
    worlds.excess = wp.zeros(count, dtype=float)
    worlds.unbounded = wp.zeros(count, dtype=wp.int32)
    if second_order:
        worlds.step = wp.zeros(count, dtype=float)
    return worlds


def add_world_history(history: Any, count: int, second_order: bool) -> None:
    """What is remembered of worlds."""
    history.parity = wp.zeros(count, dtype=wp.int32)
    history.filling = wp.zeros((count, 2), dtype=wp.int32)
    history.step = wp.zeros(count, dtype=float)
    history.age = wp.zeros(count, dtype=wp.int32)
    if second_order:
        history.smooth = wp.zeros(count, dtype=wp.int32)
        history.slope_age = wp.zeros(count, dtype=float)


def add_put_work(work: Any) -> None:
    """What a step works out of bodies that are put, by body slot."""
    slots = work.com.shape[0]
    work.put = wp.zeros(slots, dtype=wp.spatial_vector)
    work.put_from = wp.zeros(slots, dtype=wp.transform)


def add_drag_work(work: Any) -> None:
    """What slows bodies down in a step, by body slot."""
    work.drag = wp.zeros(work.com.shape[0], dtype=data.Drag)


def island_work(slots: int) -> Any:
    """Islands, by body slot."""
    islands = data.IslandWork()
    islands.parent = wp.zeros(slots, dtype=wp.int32)
    islands.fixed = wp.zeros(slots, dtype=wp.int32)
    islands.sum = wp.zeros(slots, dtype=data.IslandSum)
    return islands


def add_hold(islands: Any) -> None:
    """What holds islands that touch fixed things, by body slot."""
    slots = islands.parent.shape[0]
    islands.hold_ll = wp.zeros(slots, dtype=wp.mat33)
    islands.hold_al = wp.zeros(slots, dtype=wp.mat33)


def add_balance(islands: Any) -> None:
    """What bounds the energy of a step that does not settle, by body slot."""
    slots = islands.parent.shape[0]
    islands.balance = wp.zeros(slots, dtype=data.Balance)
    islands.start_q = wp.zeros(slots, dtype=wp.transform)
    islands.start_qd = wp.zeros(slots, dtype=wp.spatial_vector)


def row_work(slots: int) -> Any:
    """Which rows are those of a body, by body slot."""
    rows = data.RowWork()
    rows.owned_start = wp.zeros(slots, dtype=wp.int32)
    rows.owned_end = wp.zeros(slots, dtype=wp.int32)
    rows.other_start = wp.zeros(slots, dtype=wp.int32)
    rows.other_end = wp.zeros(slots, dtype=wp.int32)
    return rows


def history(model: newton.Model, second_order: bool, is_linked: bool, sides: int = SIDES) -> Any:
    """What is remembered of the last step, by body slot, and of joints with ``second_order``.

    Of what drives axes only where joints link bodies.
    """
    slots = model.body_count + 1
    history = data.History()
    history.start = wp.zeros((sides, slots), dtype=wp.int32)
    history.end = wp.zeros((sides, slots), dtype=wp.int32)
    history.gained = wp.zeros(slots, dtype=wp.vec3)
    if second_order:
        history.last = wp.zeros(slots, dtype=data.LastStep)
        history.pushing = wp.zeros(slots, dtype=wp.int32)
        history.flying = wp.zeros(slots, dtype=wp.int32)
        history.coordinate = wp.zeros(model.joint_dof_count, dtype=data.AxisMotion)
        history.rate = wp.zeros(model.joint_dof_count, dtype=data.AxisMotion)
        driven = model.joint_dof_count if is_linked else 0
        history.input = wp.zeros(driven, dtype=data.AxisInput)
    return history


def pile_work(slots: int, count: int) -> Any:
    """Piles of free bodies, by body slot, of at most ``count`` worlds or islands."""
    piles = data.PileWork()
    # the static world, in the last slot, is in no pile
    piles.parent = wp.full(slots, value=OUTSIDE, dtype=wp.int32)
    piles.order = wp.zeros(slots, dtype=wp.int32)
    piles.end = wp.zeros(count, dtype=wp.int32)
    piles.level = wp.zeros(slots, dtype=wp.int32)
    piles.supports = wp.zeros(slots, dtype=wp.int32)
    piles.mass = wp.zeros(slots, dtype=float)
    piles.whole = wp.zeros(slots, dtype=float)
    piles.held = wp.zeros(slots, dtype=float)
    piles.lasting = wp.zeros(slots, dtype=float)
    piles.shared = wp.zeros(slots, dtype=float)
    for block in ("ll", "al", "aa", "link_ll", "link_al", "link_aa"):
        setattr(piles, block, wp.zeros(slots, dtype=wp.mat33))
    piles.push = wp.zeros(slots, dtype=wp.spatial_vector)
    piles.group = wp.zeros(slots, dtype=wp.int32)
    piles.tied = wp.zeros(slots, dtype=wp.int32)
    piles.update = wp.zeros(slots, dtype=wp.spatial_vector)
    return piles


def tree_work(model: newton.Model, topology: Topology) -> Any:
    """Trees of joints, by body slot."""
    tree = data.TreeWork()
    count = model.body_count
    slots = count + 1
    parent = np.full(slots, count)
    parent[:-1] = np.where(topology.parent < 0, count, topology.parent)
    rotation = np.zeros((slots, 4), dtype=np.float32)
    rotation[:, 3] = 1.0
    joint = np.append(topology.joint, int(data.NO_JOINT))
    joint[:-1][~topology.is_alone & (topology.joint < 0)] = int(data.LONE)
    tree.joint = wp.array(joint, dtype=wp.int32)
    tree.parent = wp.array(parent, dtype=wp.int32)
    tree.axis_start = wp.array(topology.axis_start, dtype=wp.int32)
    tree.axes = wp.zeros(int(topology.axis_start[-1]), dtype=data.TreeAxis)
    tree.coordinate = wp.zeros(int(topology.axis_start[-1]), dtype=wp.float64)
    tree.start_coordinate = wp.zeros(int(topology.axis_start[-1]), dtype=wp.float64)
    tree.laws = wp.zeros(int(topology.axis_start[-1]), dtype=data.AxisLaw)
    tree.fewest = wp.zeros(slots, dtype=wp.int32)
    tree.patience = wp.zeros(slots, dtype=wp.int32)
    tree.is_minimal = wp.zeros(slots, dtype=wp.bool)
    tree.start_velocity = wp.zeros(model.joint_dof_count, dtype=float)
    tree.rotation = wp.array(rotation, dtype=wp.quat)
    tree.turn = wp.zeros(slots, dtype=wp.vec3)
    tree.turned = wp.array(rotation, dtype=wp.quat)
    tree.swing = wp.array(rotation, dtype=wp.quat)
    tree.apart = wp.zeros(slots, dtype=wp.vec3)
    tree.misfit = wp.zeros(slots, dtype=wp.spatial_vector)
    tree.is_left = wp.zeros(slots, dtype=wp.bool)
    tree.rounding = wp.zeros(slots, dtype=float)
    tree.span = wp.zeros(slots, dtype=wp.vec3)
    tree.closing = wp.zeros(slots, dtype=wp.spatial_vector)
    tree.update = wp.zeros(slots, dtype=wp.spatial_vector)
    tree.is_touched = wp.zeros(slots, dtype=wp.bool)
    tree.own_ll = wp.zeros(slots, dtype=wp.mat33)
    tree.own_al = wp.zeros(slots, dtype=wp.mat33)
    tree.own_aa = wp.zeros(slots, dtype=wp.mat33)
    tree.h_ll = wp.zeros(slots, dtype=wp.mat33)
    tree.h_al = wp.zeros(slots, dtype=wp.mat33)
    tree.h_aa = wp.zeros(slots, dtype=wp.mat33)
    tree.is_fast = wp.zeros(slots, dtype=wp.bool)
    tree.n_ll = wp.zeros(slots, dtype=wp.mat33)
    tree.n_al = wp.zeros(slots, dtype=wp.mat33)
    tree.n_aa = wp.zeros(slots, dtype=wp.mat33)
    tree.push = wp.zeros(slots, dtype=wp.spatial_vector)
    tree.load = wp.zeros(slots, dtype=wp.spatial_vector)
    return tree


def runge_kutta_work(slots: int, axes: int, worlds: int) -> Any:
    """Stages of steps of fourth order, by body slot, entry of the tree's axes and world."""
    work = data.RungeKuttaWork()
    of_bodies = ("guess", "left_qd", "start_velocity", "velocity", "before", "moved", "gain")
    for name in of_bodies:
        setattr(work, name, wp.zeros(slots, dtype=wp.spatial_vector))
    work.left_q = wp.zeros(slots, dtype=wp.transform)
    work.place = wp.zeros(slots, dtype=wp.vec3)
    work.ball_start = wp.zeros(slots, dtype=wp.quat)
    for name in ("rate", "start_rate", "axis_moved", "axis_gain"):
        setattr(work, name, wp.zeros(axes, dtype=wp.float64))
    work.gained = wp.zeros(axes, dtype=float)
    work.is_known = wp.zeros(worlds, dtype=wp.int32)
    work.waits = wp.zeros(worlds, dtype=wp.int32)
    work.turns = wp.zeros(worlds, dtype=float)
    return work


def add_joint_history(history: Any, model: newton.Model, rest_angle: wp.array) -> None:
    """What is remembered of joints, by body slot and by degree of freedom."""
    slots, dofs = model.body_count + 1, model.joint_dof_count
    history.joint_force = wp.zeros(slots, dtype=wp.vec3)
    history.left_q = wp.zeros(slots, dtype=wp.transform)
    history.lost = wp.zeros(slots, dtype=wp.vec3)
    history.acceleration = wp.zeros(slots, dtype=wp.spatial_vector)
    history.joint_angle = wp.clone(rest_angle)
    history.piece = wp.zeros(dofs, dtype=wp.vec3i)
    history.joined_qd = wp.zeros((model.joint_count, 2), dtype=wp.spatial_vector)
    history.axis_velocity = wp.zeros(dofs, dtype=float)
    history.held_at = wp.zeros(dofs, dtype=wp.float64)
    history.limit_force = wp.zeros(dofs, dtype=float)
    history.friction_force = wp.zeros(dofs, dtype=float)


def add_carrying(work: Any, history: Any, *, has_joints: bool, has_free: bool) -> bool:
    """What rounding takes from poses and velocities, by body slot, where it is not there yet.

    Args:
        work: The work of bodies.
        history: What is remembered of the last step.
        has_joints: Whether joints hold bodies.
        has_free: Whether there are bodies that none holds.

    Returns:
        Whether something has been added.
    """
    slots = work.com.size
    wanted: list[tuple[Any, str, Any]] = [(work, "gained", wp.spatial_vector)]
    if has_joints:
        wanted += [(work, "rounded", wp.spatial_vector), (history, "lost_turn", wp.quat)]
    if has_free:
        wanted.append((history, "flights", data.Flight))
    missing = [item for item in wanted if getattr(item[0], item[1]) is None]
    for struct, name, dtype in missing:
        setattr(struct, name, wp.zeros(slots, dtype=dtype))
    return bool(missing)


def add_dahl_history(history: Any, model: newton.Model) -> None:
    """What is remembered of Dahl friction, by joint."""
    is_rod = model.joint_type.numpy() == int(newton.JointType.ROD)
    unknown = np.where(is_rod[:, None], np.inf, np.zeros(3))
    history.dahl_sigma = wp.zeros(model.joint_count, dtype=wp.vec3)
    history.dahl_kappa = wp.array(unknown, dtype=wp.vec3)


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
    loops.world_start = wp.array(world_start, dtype=wp.int32)
    loops.joints = wp.array(joints, dtype=wp.int32)
    exact = np.isin(joints, [closure.joint for closure in topology.closures])
    loops.is_exact = wp.array(exact, dtype=wp.bool)
    loops.is_soft = wp.zeros(joints.size, dtype=wp.bool)
    loops.body_start = wp.array(np.cumsum([0, *map(len, sides)]), dtype=wp.int32)
    loops.items = wp.array(
        np.concatenate([np.array(side, dtype=int) for side in sides]), dtype=wp.int32
    )
    loops.apart = wp.zeros(joints.size, dtype=wp.vec3)
    loops.arms = wp.zeros(2 * joints.size, dtype=wp.vec3)
    loops.misfit = wp.zeros(joints.size, dtype=wp.spatial_vector)
    loops.recovered = wp.zeros(joints.size, dtype=float)
    loops.closing = wp.zeros(joints.size, dtype=float)
    loops.kept_force = wp.zeros(joints.size, dtype=wp.vec3)
    loops.kept_torque = wp.zeros(joints.size, dtype=wp.vec3)
    loops.reach = wp.zeros(joints.size, dtype=float)
    loops.turn_reach = wp.zeros(joints.size, dtype=float)
    loops.side = wp.zeros(joints.size, dtype=wp.int32)
    loops.k_l = wp.zeros(joints.size, dtype=float)
    loops.k_a = wp.zeros(joints.size, dtype=float)
    loops.stop_side = wp.zeros(model.joint_dof_count, dtype=wp.int32)
    loops.stop_steps = wp.zeros(model.joint_dof_count, dtype=wp.vec2)
    loops.kept_stop = wp.zeros(model.joint_dof_count, dtype=float)
    loops.coordinate = wp.zeros(model.joint_dof_count, dtype=wp.float64)
    loops.start_coordinate = wp.zeros(model.joint_dof_count, dtype=wp.float64)
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
    loops.yielding = wp.array(rates, dtype=data.vec5)
    loops.impedance = wp.array(impedance, dtype=data.vec5)
    loops.gives = wp.zeros(count, dtype=wp.vec2)
    loops.wanted = wp.zeros(count, dtype=wp.spatial_vector)
    loops.span = wp.zeros(count, dtype=float)


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
    work.block_of = wp.array(block_of, dtype=wp.int32)
    work.blocks = wp.array(blocks, dtype=data.ClosureBlock)
    work.closures = wp.array(closures, dtype=data.Closure)
    work.nodes = wp.array(nodes, dtype=data.ClosureNode)
    places = np.array([place for body in passing for place in body], dtype=np.int32).reshape(-1, 3)
    for name, values in zip(("items", "slots", "next"), places.T, strict=True):
        setattr(work, name, wp.array(values, dtype=wp.int32))
    work.ends = wp.array(ends, dtype=wp.int32)
    work.met = wp.zeros(int(starts[-1]), dtype=wp.spatial_vector)
    work.way = wp.zeros(way_count, dtype=wp.spatial_vector)
    work.misfit = wp.zeros(len(top), dtype=float)
    work.direction = wp.zeros(len(top), dtype=wp.vec3)
    work.whole = wp.zeros(len(top), dtype=float)
    work.stopped = wp.zeros(len(top), dtype=float)
    work.least = wp.zeros(len(top), dtype=float)
    work.gives = wp.zeros(len(top), dtype=float)
    work.held = wp.zeros(len(top), dtype=float)
    work.most = wp.zeros(len(top), dtype=float)
    work.loosened = wp.zeros(len(top), dtype=float)
    work.multiplier = wp.zeros(len(top), dtype=wp.float64)
    work.gram_row = wp.array(gram[:-1] - np.arange(len(top)), dtype=wp.int32)
    work.gram = wp.zeros(int(gram[-1]), dtype=wp.float64)


def sleep_work(
    model: newton.Model,
    topology: Topology,
    effects: Effects,
    capacity: int,
    loops: Any,
    tree: Any,
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
    sleep.tied = wp.array(np.append(tied, slots - 1), dtype=wp.int32)
    for name in ("still", "quiet"):
        setattr(sleep, name, wp.zeros(slots, dtype=float))
    for name in ("woken", "met", "contacts", "end", "size", "place"):
        setattr(sleep, name, wp.zeros(slots, dtype=wp.int32))
    # the first step lists what is awake
    sleep.stirred = wp.ones(1, dtype=wp.int32)
    sleep.marks = wp.zeros(1, dtype=wp.int32)
    sleep.blocks = wp.zeros(slots, dtype=wp.int32)
    sleep.block_start = wp.zeros(worlds + 1, dtype=wp.int32)
    sleep.start = wp.full(slots, value=-1, dtype=wp.int32)
    sleep.order = wp.zeros(slots - 1, dtype=wp.int32)
    sleep.filled = wp.array([0, capacity, 0], dtype=wp.int32)
    sleep.pose = wp.zeros(slots, dtype=wp.transform)
    sleep.wrench = wp.zeros(slots, dtype=wp.spatial_vector)
    sleep.islands.parent = wp.zeros(slots, dtype=wp.int32)
    sleep.islands.fixed = wp.zeros(slots, dtype=wp.int32)
    sleep.gravity = wp.clone(model.gravity)
    sleep.pull = wp.zeros(len(topology.tendons), dtype=float)
    if effects.joints:
        sleep.joint_f = wp.zeros(model.joint_dof_count, dtype=float)
        sleep.target_qd = wp.zeros(model.joint_dof_count, dtype=float)
        sleep.target_q = wp.zeros(model.joint_coord_count, dtype=float)
    if effects.loops:
        holders = np.full(worlds, -1)
        held = _held(model, topology.loops)
        holders[topology.worlds[held]] = held
        sleep.loop_body = wp.array(holders, dtype=wp.int32)
        sleep.loop_start = loops.world_start
        sleep.seen_loop_start = wp.zeros(slots, dtype=wp.int32)
    if effects.closures:
        sleep.block_of = tree.closures.block_of
        sleep.seen_block_of = wp.zeros(slots, dtype=wp.int32)
    return sleep


def seen_work(slots: int, world_count: int, second_order: bool) -> tuple[Any, Any]:
    """What the solve sees in the place of what is by world: worlds and history, of islands."""
    worlds, history = data.WorldWork(), data.History()
    for name in ("body_start", "bodies", "sweeps"):
        setattr(worlds, name, wp.zeros(slots, dtype=wp.int32))
    # a body that is not listed makes no block
    worlds.block_end = wp.full(slots, value=-1, dtype=wp.int32)
    worlds.rank = wp.full(slots, value=slots - 1, dtype=wp.int32)
    worlds.island_start = wp.zeros(world_count + 1, dtype=wp.int32)
    # a thread of the CPU that finds nothing to do costs more than a body that sleeps
    worlds.threads = slots - 1 if wp.get_device().is_cuda else 1
    for name in ("update", "settled", "pace", "step"):
        setattr(worlds, name, wp.zeros(slots, dtype=float))
    if second_order:
        history.slope_age = wp.zeros(slots, dtype=float)
    for name in ("parity", "age", "smooth"):
        setattr(history, name, wp.zeros(slots, dtype=wp.int32))
    history.filling = wp.zeros((slots, 2), dtype=wp.int32)
    history.step = wp.zeros(slots, dtype=float)
    return worlds, history
