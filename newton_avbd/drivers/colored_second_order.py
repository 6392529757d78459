# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds: the order of a step, and what it keeps of motions for the next one."""

import warp as wp

from ..data import Solver, Step
from ..effects import Effects
from ..step.cables import has_jerked, may_jerk
from ..step.flight import is_flying
from ..step.kernels import KernelDecorator
from ..step.motion_history import is_remembered, remember_led, remember_loop
from ..step.slopes import QUIET_WORLD, is_going_on
from ..step.smoothness import last_of
from ..step.tendons import end_tendons
from .colored_joints import loop_world
from .stages import Stages


def make_colored_second_order(effects: Effects, stages: Stages, kernel: KernelDecorator) -> None:
    """The kernels, made by the decorator ``kernel``."""
    orders = stages.second_order
    begin_order, body_jumps, loop_jumps = orders.begin_body, orders.body_jumps, orders.loop_jumps
    goes_on_smoothly, order_world = orders.goes_on, orders.order_world
    start_body, lead_rows = orders.start_body, orders.lead_rows
    remember_motion = orders.remember_motion
    remember_state = orders.remember_state

    @kernel()
    def find_flying(step: Step, s: wp.array[Solver]):
        """Starts all bodies by backward Euler, and finds what is held; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if begin_order(s[0].worlds.rank[body], scale, step.body_qd, s[0]):
            s[0].colors.is_held[world] = 1

    @kernel()
    def find_jumps(step: Step, s: wp.array[Solver]):
        """Whether a velocity is about to jump, and whether motions go on; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if s[0].colors.is_finite[world] == 0 or s[0].colors.has_impacts[world] == 1:
            s[0].colors.jumps[world] = 1
        elif body_jumps(world, s[0].worlds.rank[body], scale, s[0]):
            s[0].colors.jumps[world] = 1
        elif not goes_on_smoothly(body, step.body_qd, scale, s[0]):
            s[0].colors.breaks[world] = 1

    @kernel(effects.loops)
    def find_loop_jumps(s: wp.array[Solver]):
        """Likewise by joints outside of the trees; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        if loop_jumps(world, i, s[0]):
            s[0].colors.jumps[world] = 1

    @kernel(effects.cables)
    def find_jerks(s: wp.array[Solver]):
        """Likewise by cables that may pull at once; one thread a cluster of cables."""
        cluster = wp.tid()
        if may_jerk(cluster, s[0]):
            s[0].colors.jumps[s[0].tree.cables.world[cluster]] = 1

    @kernel()
    def order_worlds(s: wp.array[Solver]):
        """Decides on the order of a world's step; one thread a world."""
        world = wp.tid()
        last = last_of(world, s[0].history)
        is_smooth = (
            s[0].colors.is_held[world] == 1
            and last != QUIET_WORLD
            and s[0].colors.jumps[world] == 0
        )
        is_continued = is_going_on(last) and s[0].colors.breaks[world] == 0
        scale = s[0].colors.scale[world]
        s[0].colors.scale[world] = order_world(world, last, is_smooth, is_continued, scale, s[0])
        s[0].colors.jumps[world] = 0

    @kernel()
    def start_bodies(step: Step, s: wp.array[Solver]):
        """Leads and targets of bodies, by that order; one thread a body."""
        body = wp.tid()
        scale = s[0].colors.scale[s[0].worlds.of_body[body]]
        start_body(body, scale, step.body_qd, s[0])

    @kernel(effects.contact)
    def lead_all_rows(s: wp.array[Solver]):
        """Likewise the rows that a body owns; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if scale.step < scale.h:
            lead_rows(world, body, scale, s[0])

    @kernel(effects.loops)
    def remember_loops(s: wp.array[Solver]):
        """How a joint outside of the trees has moved; one thread a joint."""
        i = wp.tid()
        world = loop_world(i, s[0])
        if s[0].colors.is_finite[world] == 1:
            remember_loop(i, s[0].colors.scale[world], s[0])

    @kernel(effects.cables)
    def find_jerked(s: wp.array[Solver]):
        """Whether a cable's tension has jumped; one thread a cluster of cables."""
        cluster = wp.tid()
        world = s[0].tree.cables.world[cluster]
        scale = s[0].colors.scale[world]
        # tensions of steps of different order do not compare
        if scale.step == scale.h and has_jerked(cluster, scale, s[0].tree.cables):
            s[0].colors.jumps[world] = 1

    @kernel()
    def remember_motions(s: wp.array[Solver]):
        """How a body has moved, before anything old is recovered; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if s[0].colors.is_finite[world] == 1:
            if s[0].work.inv_mass[body] > 0.0 and is_remembered(world, scale, s[0].history):
                remember_motion(body, scale, s[0])
            if wp.static(effects.tendons):
                end_tendons(s[0].worlds.rank[body], scale, s[0].tree)

    @kernel()
    def remember_states(step: Step, s: wp.array[Solver]):
        """Where the step has left a body, and how fast; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        if s[0].colors.is_finite[world] == 1 and is_remembered(world, scale, s[0].history):
            q, qd = step.body_q_out[body], step.body_qd_out[body]
            if s[0].work.inv_mass[body] == 0.0:
                remember_led(body, qd, scale, s[0].history)
            elif not is_flying(body, s[0].history):
                remember_state(world, body, q, qd, scale, s[0])
