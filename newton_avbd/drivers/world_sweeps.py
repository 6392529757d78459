# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The sweeps of a world, in its motion and in its recovery."""

import warp as wp

from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..step.bodies import body_at
from ..step.contacts import stiffen_rows
from ..step.kernels import absent
from ..step.mixing import MIXED_FACTOR, begin_mixing, make_mix
from ..step.scale import last_update
from ..step.sweeps import make_sweep_world
from .stages import Stages


@wp.func
def stiffen_impacts(world: int, scale: WorldScale, s: wp.ref[Solver]):
    """Makes contacts as stiff as the forces that sweeps have found ask for."""
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        stiffen_rows(body_at(i, s.worlds), scale, s.rows)


def make_sweep_to_rest(effects: Effects, stages: Stages) -> wp.Function:
    """Device function: sweeps over a world until it is at rest."""
    sweep_world = make_sweep_world(
        effects,
        stages.sweep_block,
        stages.piles.sweep_piles,
        stages.loops.loop_wrench,
        stages.solve_cluster,
    )

    mix = make_mix(effects) if effects.mixing else absent

    @wp.func
    def sweep_to_rest(
        world: int,
        sweeps: int,
        recovery: float,
        scale: WorldScale,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """At most so many sweeps, fewer where one moves nothing by more than is asked for.

        With a ``recovery`` above zero what was wrong at the start of the step goes, too, and
        multipliers stay. Returns how many it took, and the square of the last update [m^2].
        """
        enough = last_update(scale)
        most = int(sweeps)
        update = float(0.0)
        sweep = int(0)
        is_mixed = bool(False)
        mixture = wp.vec2(0.0)
        while sweep < most:
            update = sweep_world(world, sweep > 0, recovery, scale, step, s)
            sweep += 1
            if wp.static(not effects.ramp):
                if update <= enough * enough:
                    most = sweep
            if wp.static(effects.mixing):
                if recovery == 0.0 and sweep < most:
                    if is_mixed:
                        mixture = mix(world, sweep, mixture, scale.step, s)
                    elif sweep == 1:
                        is_mixed = begin_mixing(world, s)
                        if is_mixed:
                            most = MIXED_FACTOR * most
        return most, update

    return sweep_to_rest
