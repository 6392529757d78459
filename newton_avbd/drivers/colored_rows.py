# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Large worlds: the scale of the step, and the rows of contacts."""

import warp as wp

from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..step.contacts import body_slot, find_row, make_linearise_rows, make_rows, owner_of
from ..step.finite import make_is_world_finite
from ..step.kernels import KernelDecorator, absent
from ..step.scale import LONGER, STRUCK_FACTOR, make_measure_world, sweeps_at_age
from ..step.weights import make_weigh
from .coloring import is_owner, sort_part


@wp.func
def recall(body: int, side: int, static_slot: int, s: wp.ref[Solver]):
    """Hands what is remembered of the contacts that a body owned to their rows of this step.

    As :func:`.step.contacts.make_rows` has it, but the rows may be the other body's by now. All
    records of two shapes are one body's: no other thread writes to these rows.
    """
    for i in range(s.history.start[side, body], s.history.end[side, body]):
        record = s.history.records[side, i]
        if wp.length_sq(record.force) > 0.0:
            slot0 = body_slot(s.shapes, record.shape0, static_slot)
            slot1 = body_slot(s.shapes, record.shape1, static_slot)
            owner = owner_of(slot0, slot1, s)
            if owner >= 0:
                start = s.rows.owned_start[owner]
                row = find_row(record, start, s.rows.owned_end[owner], 1 - side, s)
                if row >= 0:
                    sign = wp.where(owner == body, 1.0, -1.0)
                    s.rows.rows[row].force = s.rows.rows[row].force + sign * record.force
                    if s.rows.spin.shape[0] > 0:
                        torque = s.rows.spin[row].torque + sign * s.history.torque[side, i]
                        s.rows.spin[row].torque = torque


def make_colored_rows(effects: Effects, kernel: KernelDecorator) -> None:
    """The kernels, made by the decorator ``kernel``."""
    measure_world = make_measure_world(effects)
    is_world_finite = make_is_world_finite(effects)
    linearise_rows = make_linearise_rows(effects)
    penalise_rows = make_rows(effects).penalise_rows
    weigh_blocks = make_weigh(effects) if effects.light_links else absent

    @kernel()
    def measure_lanes(step: Step, s: wp.array[Solver]):
        """How far the bodies of a lane may go, and whether they are finite; one thread a lane."""
        lane = wp.tid()
        s[0].colors.lane_scale[lane] = measure_world(lane, step.h, step.tolerance, s[0])
        is_finite = is_world_finite(lane, step, s[0])
        s[0].colors.lane_finite[lane] = int(is_finite)
        if lane == 0:
            s[0].colors.has_more[0] = 0
            s[0].colors.is_cold[0] = 0
            s[0].colors.is_apart[0] = 0
            s[0].colors.is_excessive[0] = 0

    @kernel()
    def begin_step(step: Step, s: wp.array[Solver]):
        """The scale of a world from that of its lanes; one thread a world."""
        world = wp.tid()
        scale = WorldScale()
        is_finite = int(1)
        for lane in range(s[0].colors.world_lane[world], s[0].colors.world_lane[world + 1]):
            part = s[0].colors.lane_scale[lane]
            part.mass += scale.mass
            part.gravity = wp.max(scale.gravity, part.gravity)
            part.reach = wp.max(scale.reach, part.reach)
            part.slop = wp.max(scale.slop, part.slop)
            scale = part
            is_finite = wp.min(is_finite, s[0].colors.lane_finite[lane])
        s[0].colors.scale[world] = scale
        s[0].colors.is_finite[world] = is_finite
        s[0].colors.deepest[world] = 0.0
        s[0].colors.closing[world] = 0.0
        s[0].colors.is_open[world] = 0
        s[0].colors.has_impacts[world] = 0
        s[0].colors.begin[world] = 0
        for i in range(s[0].colors.moved.shape[0]):
            s[0].colors.moved[i, world] = wp.where(i == 0, wp.inf, -1.0)
        for i in range(s[0].colors.recovered.shape[0]):
            s[0].colors.recovered[i, world] = wp.where(i == 0, wp.inf, -1.0)
        if step.h > LONGER * s[0].history.step[world]:
            s[0].history.age[world] = 0
        if wp.static(effects.second_order):
            if s[0].worlds.step[world] < s[0].history.step[world]:
                s[0].colors.scale[world].lag = 0.0
            s[0].colors.is_held[world] = 0
            s[0].colors.jumps[world] = 0
            s[0].colors.breaks[world] = 0
            s[0].colors.is_moving[world] = 0
        s[0].history.step[world] = step.h
        most = sweeps_at_age(s[0].history.age[world], step.iterations, scale)
        s[0].colors.most[world] = is_finite * most
        if most > step.iterations:
            s[0].colors.has_more[0] = 1
        if most > STRUCK_FACTOR * step.iterations:
            s[0].colors.is_cold[0] = 1

    @kernel()
    def build_rows(step: Step, s: wp.array[Solver]):
        """Rows of the contacts that a body owns; one thread a body."""
        body = wp.tid()
        place = int(s[0].rows.owned_start[body])
        for i in range(s[0].colors.incident_start[body], s[0].colors.incident_start[body + 1]):
            if is_owner(body, s[0].colors.partner[i], s[0].worlds):
                s[0].rows.contacts[place] = s[0].colors.incident[i]
                place += 1
        s[0].rows.owned_end[body] = place
        world = s[0].worlds.of_body[body]
        linearise_rows(world, body, s[0].colors.scale[world], step, s[0])

    @kernel()
    def recall_rows(s: wp.array[Solver]):
        """What the rows of the last step pushed with goes to those of this one; a thread a body."""
        body = wp.tid()
        sort_part(s[0].rows.other_rows, s[0].rows.other_start[body], s[0].rows.other_end[body])
        static_slot = s[0].work.inv_mass.shape[0] - 1
        side = s[0].history.parity[s[0].worlds.of_body[body]]
        recall(body, side, static_slot, s[0])

    @kernel(effects.light_links)
    def weigh(s: wp.array[Solver]):
        """Weighs the tree of a block; one thread a body, for a first one."""
        block = wp.tid()
        if (
            s[0].colors.block[block] == block
            and s[0].colors.is_finite[s[0].worlds.of_body[block]] == 1
        ):
            first = s[0].worlds.rank[block]
            end = s[0].worlds.block_end[first]
            weigh_blocks(first, end, s[0])

    @kernel()
    def penalise(step: Step, s: wp.array[Solver]):
        """Penalties of the rows that a body owns; one thread a body."""
        body = wp.tid()
        world = s[0].worlds.of_body[body]
        scale = s[0].colors.scale[world]
        depth = penalise_rows(world, body, scale, step, s[0])
        if depth > s[0].colors.deepest[world]:
            wp.atomic_max(s[0].colors.deepest, world, depth)
