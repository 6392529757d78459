# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A sweep: each block of a world in turn goes to the minimum of its quadratic model."""

import warp as wp

from ..algebra.block import solve_block
from ..data import Solver, Step, WorldScale
from ..effects import Effects
from .beginning import is_tree
from .bodies import body_at, has_rows, moved_by
from .loops import has_loops
from .piles import in_pile
from .ramped import make_ramped
from .rotations import place_body


def make_sweep(effects: Effects, gather: wp.Function) -> wp.Function:
    """Device function that moves one body to the minimum of its quadratic model (block descent)."""

    @wp.func
    def sweep(
        body: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Returns the square of how far that moved it [m^2], a turn by its radius of gyration."""
        wrench = gather(body, has_dual, recovery, slop, h, step, s)
        update = solve_block(s.work.factor[body], wp.spatial_top(wrench), wp.spatial_bottom(wrench))
        s.work.increment[body] = s.work.increment[body] + update
        if wp.static(effects.loops):
            place_body(body, s)
        return moved_by(body, update, s.work)

    return sweep


def make_sweep_block(
    effects: Effects, sweep_body: wp.Function, sweep_tree: wp.Function
) -> wp.Function:
    """Device function that moves one block: a tree, or a body that something holds."""

    @wp.func
    def sweep_block(
        first: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Returns the square of how far one of its bodies moved [m^2]."""
        body = body_at(first, s.worlds)
        if wp.static(effects.joints):
            end = s.worlds.block_end[first]
            if is_tree(first, end, body, s.tree):
                return sweep_tree(first, end, has_dual, recovery, slop, h, step, s)
        is_held = bool(False)
        if wp.static(effects.contact):
            is_held = has_rows(s.rows, body)
        if wp.static(effects.loops):
            is_held = is_held or has_loops(s.loops, body)
        if wp.static(effects.piles):
            is_held = is_held and not in_pile(s.rows, body)
        if s.work.inv_mass[body] > 0.0 and is_held:
            return sweep_body(body, has_dual, recovery, slop, h, step, s)
        return 0.0

    return sweep_block


def make_sweep_world(
    effects: Effects,
    sweep_block: wp.Function,
    sweep_piles: wp.Function,
    loop_wrench: wp.Function,
    solve_cluster: wp.Function,
) -> wp.Function:
    """Device function: one sweep over a world."""
    ramped = make_ramped(effects)
    sweep_body_ramped, sweep_duals_ramped = ramped.sweep_body_ramped, ramped.sweep_duals_ramped

    @wp.func(inline=effects.inline)
    def sweep_world(
        world: int,
        has_dual: bool,
        recovery: float,
        scale: WorldScale,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Visits all blocks; returns the square of how far one of their bodies moved [m^2].

        With a ``recovery`` above zero what was wrong at the start of the step goes, too: that share
        of the penetration beyond the slop, and all misfit of joints.
        """
        farthest = float(0.0)
        first = int(s.worlds.body_start[world])
        while first < s.worlds.body_start[world + 1]:
            if wp.static(effects.ramp):
                body = body_at(first, s.worlds)
                if s.work.inv_mass[body] > 0.0 and has_rows(s.rows, body):
                    sweep_body_ramped(body, scale.step, s)
            else:
                farthest = wp.max(
                    farthest,
                    sweep_block(first, has_dual, recovery, scale.slop, scale.step, step, s),
                )
            first = s.worlds.block_end[first]
        if wp.static(effects.piles):
            farthest = wp.max(farthest, sweep_piles(world, has_dual, recovery, scale, step, s))
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                loop_wrench(i, recovery, scale.step, True, True, step, s)
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                changed = solve_cluster(i, recovery, s)
                farthest = wp.max(farthest, changed)
        if wp.static(effects.ramp):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                sweep_duals_ramped(body_at(i, s.worlds), s)
        return farthest

    return sweep_world
