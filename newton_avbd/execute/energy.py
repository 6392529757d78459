# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Energy of impacts that do not settle: they leave trees no more than there was.

Where an impact turns a link by more than a radian beyond where it was going, iterations need not
settle, and what they leave may be faster than what came. The bodies of trees are slowed down then
to the energy that the world had, and what gravity added.
"""

import warp as wp

from ..algebra.so3 import world_inertia
from ..data import BodyModel, BodyWork, TreeWork, WorldWork
from .beginning import is_in_tree

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
) -> float:
    """Kinetic energy of what moves in a world [J]."""
    energy = float(0.0)
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = worlds.bodies[i]
        if work.inv_mass[body] > 0.0:
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
    """Slows the trees of a world down to the energy ``before`` [J] and what gravity added.

    Takes poses and velocities after the step.
    """
    excess = energy_of(world, body_q, body_qd, model, worlds, work) - before
    in_trees = float(0.0)
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = worlds.bodies[i]
        if work.inv_mass[body] > 0.0:
            fall = wp.dot(model.gravity[model.world[body]], wp.spatial_top(work.increment[body]))
            excess -= model.mass[body] * fall
            if is_in_tree(i, worlds, tree):
                in_trees += kinetic_energy(body, body_q, body_qd, model)
    if excess > 0.0:
        share = wp.sqrt(wp.max(1.0 - excess / in_trees, 0.0))
        for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
            body = worlds.bodies[i]
            if work.inv_mass[body] > 0.0 and is_in_tree(i, worlds, tree):
                body_qd[body] = share * body_qd[body]
