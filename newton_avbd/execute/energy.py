# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Energy of impacts that do not settle: they leave trees no more than there was.

Where an impact turns a link by more than a radian beyond where it was going, iterations need not
settle, and what they leave may be faster than what came. Trees that touch something are slowed down
then to the energy that what touches had, and what gravity added. What drives do in such a step is
not told from that.
"""

import warp as wp

from ..algebra.so3 import world_inertia
from ..data import BodyModel, BodyWork, RowWork, TreeWork, WorldScale, WorldWork
from ..rows import contact as contact_rows
from .beginning import is_in_tree
from .scale import impact_of

THROWN = wp.constant(1.0)
"""Turn beyond its target from which a link is said to be thrown about [rad]."""


@wp.func
def is_thrown(
    world: int, worlds: wp.ref[WorldWork], work: wp.ref[BodyWork], tree: wp.ref[TreeWork]
) -> bool:
    """Whether a step throws a link of a world about, and no kinematic body may have done so."""
    farthest = float(0.0)
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = worlds.bodies[i]
        increment = work.increment[body]
        if work.inv_mass[body] == 0.0:
            if wp.dot(increment, increment) > 0.0:
                return False
        elif is_in_tree(i, worlds, tree):
            beyond = wp.spatial_bottom(increment - work.target[body])
            farthest = wp.max(farthest, wp.length_sq(beyond))
    return farthest > THROWN * THROWN


@wp.func
def is_tree_hit(
    world: int,
    scale: WorldScale,
    body_qd: wp.array[wp.spatial_vector],
    worlds: wp.ref[WorldWork],
    work: wp.ref[BodyWork],
    rows: wp.ref[RowWork],
    tree: wp.ref[TreeWork],
) -> bool:
    """Whether a contact of a tree closes as in an impact: what motors throw about is none."""
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = worlds.bodies[i]
        for k in range(rows.owned_start[body], rows.owned_end[body]):
            row = rows.rows[k]
            other = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            is_of_tree = is_in_tree(i, worlds, tree)
            if work.inv_mass[row.b] > 0.0:
                other = scale.step * body_qd[row.b]
                is_of_tree = is_of_tree or is_in_tree(worlds.rank[row.b], worlds, tree)
            if is_of_tree:
                span = work.com[body] - work.com[row.b]
                u = contact_rows.slip(row, scale.step * body_qd[body], other, span)
                if wp.dot(row.normal, u) + wp.max(row.gap, 0.0) < -impact_of(scale):
                    return True
    return False


@wp.func
def touches(i: int, worlds: wp.ref[WorldWork], tree: wp.ref[TreeWork]) -> bool:
    """Whether something touches the block of the i-th body."""
    first = int(i)
    end = worlds.block_end[i]
    while first > 0 and worlds.block_end[first - 1] == end:
        first -= 1
    for k in range(first, end):
        if tree.is_touched[worlds.bodies[k]]:
            return True
    return False


@wp.func
def kinetic_energy(
    body: int,
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    model: wp.ref[BodyModel],
) -> float:
    """(m v^2 + w I w)/2 of a body [J]."""
    v = wp.spatial_top(body_qd[body])
    w = wp.spatial_bottom(body_qd[body])
    inertia = world_inertia(wp.transform_get_rotation(body_q[body]), model.inertia[body])
    return 0.5 * (model.mass[body] * wp.dot(v, v) + wp.dot(w, inertia * w))


@wp.func
def energy_of(
    world: int,
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    model: wp.ref[BodyModel],
    worlds: wp.ref[WorldWork],
    work: wp.ref[BodyWork],
    tree: wp.ref[TreeWork],
) -> float:
    """Kinetic energy of what moves in a world and touches something [J]."""
    energy = float(0.0)
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = worlds.bodies[i]
        if work.inv_mass[body] > 0.0 and touches(i, worlds, tree):
            energy += kinetic_energy(body, body_q, body_qd, model)
    return energy


@wp.func
def slow_down(
    world: int,
    before: float,
    body_q: wp.array[wp.transform],
    model: wp.ref[BodyModel],
    worlds: wp.ref[WorldWork],
    work: wp.ref[BodyWork],
    tree: wp.ref[TreeWork],
    body_qd: wp.array[wp.spatial_vector],
):
    """Slows the trees of a world that touch something down to the energy ``before`` [J] of what
    does, and what gravity added.

    Takes poses and velocities after the step.
    """
    excess = energy_of(world, body_q, body_qd, model, worlds, work, tree) - before
    in_trees = float(0.0)
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = worlds.bodies[i]
        if work.inv_mass[body] > 0.0 and touches(i, worlds, tree):
            fall = wp.dot(model.gravity[model.world[body]], wp.spatial_top(work.increment[body]))
            excess -= model.mass[body] * fall
            if is_in_tree(i, worlds, tree):
                in_trees += kinetic_energy(body, body_q, body_qd, model)
    if excess > 0.0:
        share = wp.sqrt(wp.max(1.0 - excess / in_trees, 0.0))
        for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
            body = worlds.bodies[i]
            is_moving = work.inv_mass[body] > 0.0 and is_in_tree(i, worlds, tree)
            if is_moving and touches(i, worlds, tree):
                body_qd[body] = share * body_qd[body]
