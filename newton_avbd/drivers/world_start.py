# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A world before its sweeps: contacts, then joints, then the blocks of both."""

import warp as wp

from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..step.anchors import is_linked
from ..step.bodies import body_at
from ..step.cables import begin_cluster
from ..step.contacts import make_rows
from ..step.distances import reach_farther
from ..step.islands import HELD, join_islands
from ..step.kernels import absent
from ..step.scale import LONGER, MUCH_LONGER, make_measure_world, sweeps_at_age
from ..step.sides import make_written_side
from ..step.weights import make_weigh
from .stages import Stages


def make_world_start(effects: Effects, stages: Stages) -> Functions:
    """Device functions of a world's step up to its first sweep."""
    measure_world = make_measure_world(effects)
    rows = make_rows(effects)
    find_rows, penalise_rows = rows.find_rows, rows.penalise_rows
    weigh_blocks = make_weigh(effects) if effects.light_links else absent
    written_side = make_written_side(effects)
    find_impacts = stages.impacts.find_impacts
    link_piles, factor_piles = stages.piles.link_piles, stages.piles.factor_piles
    block_start = stages.block_start
    measure_blocks, measure_loop = block_start.measure_blocks, block_start.measure_loop
    place_blocks, begin_body = block_start.place_blocks, stages.begin_body

    @wp.func
    def begin_world(world: int, h: float, tolerance: float, s: wp.ref[Solver]) -> WorldScale:
        """How far things may go in the step; takes a much longer step than the last as a start."""
        scale = measure_world(world, h, tolerance, s)
        # forces that stopped something within a short step would push too long in a longer one
        if h > wp.static(MUCH_LONGER if effects.adaptive else LONGER) * s.history.step[world]:
            s.history.age[world] = 0
        if wp.static(effects.second_order):
            if s.worlds.step[world] < s.history.step[world]:
                scale.lag = 0.0
        if wp.static(effects.fourth_order):
            if s.tree.runge_kutta.is_known[world] != 0:
                scale.lag = 0.0
        s.history.step[world] = h
        return scale

    @wp.func
    def build_rows(
        world: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Rows of the contacts: linearised at state_in, warm-started from the last step, penalised.

        Returns the deepest penetration [m], and whether impacts bounce.
        """
        body_start = s.worlds.body_start[world]
        body_end = s.worlds.body_start[world + 1]
        deepest = float(0.0)
        has_impacts = bool(False)
        contact_count = int(0)
        for i in range(body_start, body_end):
            body = body_at(i, s.worlds)
            contact_count += s.rows.owned_end[body] - s.rows.owned_start[body]
        if contact_count > 0:
            for i in range(body_start, body_end):
                find_rows(world, body_at(i, s.worlds), scale, step, s)
        if wp.static(effects.piles):
            link_piles(world, scale.slop, s)
        if contact_count > 0:
            if wp.static(effects.light_links):
                weigh_blocks(body_start, body_end, s)
            for i in range(body_start, body_end):
                body = body_at(i, s.worlds)
                depth = penalise_rows(world, body, scale, step, s)
                deepest = wp.max(deepest, depth)
            if wp.static(effects.restitution):
                has_impacts = find_impacts(world, written_side(world, s.history), scale, body_qd, s)
        s.history.filling[world, 0] = 0
        if wp.static(effects.matching):
            s.history.filling[world, 0] = step.contacts.buffer
            s.history.filling[world, 1] = step.contacts.generation[0]
        return deepest, has_impacts

    @wp.func
    def begin_joints(
        world: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> bool:
        """Misfit and coordinates of joints, where bodies start; whether a joint is open."""
        body_start = s.worlds.body_start[world]
        body_end = s.worlds.body_start[world + 1]
        is_open = measure_blocks(body_start, body_end, scale, body_qd, step, s)
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                if measure_loop(i, scale, body_qd, step, s):
                    is_open = True
        if place_blocks(body_start, body_end, scale, s):
            is_open = True
        if wp.static(effects.loops and effects.kinds.distances):
            first = s.loops.world_start[world]
            end = s.loops.world_start[world + 1]
            closing = float(0.0)
            for i in range(first, end):
                closing = wp.max(closing, s.loops.closing[i])
            for i in range(first, end):
                reach_farther(i, closing, s)
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                if begin_cluster(i, s):
                    is_open = True
        return is_open

    @wp.func
    def begin_sweeps(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]) -> int:
        """Sums and factors the blocks; returns how many sweeps the world takes at most.

        A body that nothing touches is at its target at once.
        """
        sweeps = int(0)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                if begin_body(i, scale.step, step, s):
                    sweeps = step.iterations
                if wp.static(effects.joints and effects.islands):
                    if is_linked(body, s):
                        join_islands(body, s.tree.parent[body], HELD, s)
        if wp.static(effects.piles):
            factor_piles(world, s)
        if wp.static(not effects.ramp):
            sweeps = sweeps_at_age(s.history.age[world], sweeps, scale)
        return sweeps

    return together(begin_world, build_rows, begin_joints, begin_sweeps)
