# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies that sleep: how they are told from others, are put to sleep and wake.

They stand in a list (``SleepWork.order``), each with the records of its contacts.
"""

import warp as wp

from ..data import History, RowWork, Solver, Step, WorldWork
from ..effects import Effects
from ..functions import Functions, together

AWAKE = wp.constant(-1)
"""Island of a body that is awake."""
STILL = wp.constant(-2)
"""That of one which the solver does not move, nor does the user."""
MOVING = wp.constant(-3)
"""That of one which the user moves."""


@wp.func
def mover_of(first: int, end: int, worlds: wp.ref[WorldWork]) -> int:
    """The first body of a block that the solver moves, -1 without."""
    for i in range(first, end):
        if worlds.island[worlds.bodies[i]] >= AWAKE:
            return worlds.bodies[i]
    return -1


@wp.func
def forget_rows(body: int, rows: wp.ref[RowWork]):
    """Leaves a body that is not solved without rows."""
    rows.owned_end[body] = rows.owned_start[body]
    rows.other_end[body] = rows.other_start[body]


def make_sleepers(effects: Effects) -> Functions:
    """Device functions of bodies that sleep."""

    @wp.func
    def move_records(
        start: int, end: int, side: int, to: int, to_side: int, history: wp.ref[History]
    ):
        """Copies records of contacts to a place before or far behind them."""
        for i in range(start, end):
            history.records[to_side, to + i - start] = history.records[side, i]
            if wp.static(effects.angular_friction):
                history.torque[to_side, to + i - start] = history.torque[side, i]

    @wp.func
    def close_gaps(s: wp.ref[Solver]):
        """Takes those that have woken from the list of sleepers, and their records with them."""
        count = int(0)
        at = s.history.records.shape[1] / 2
        for k in range(s.sleep.filled[0]):
            body = s.sleep.order[k]
            if s.sleep.start[body] >= 0:
                move_records(s.sleep.start[body], s.sleep.end[body], 0, at, 0, s.history)
                s.sleep.end[body] += at - s.sleep.start[body]
                s.sleep.start[body] = at
                at = s.sleep.end[body]
                s.sleep.order[count] = body
                count += 1
        s.sleep.filled[0] = count
        s.sleep.filled[1] = at
        s.sleep.filled[2] = 0

    @wp.func
    def wake_islands(s: wp.ref[Solver]):
        """Wakes the bodies of islands that are disturbed, with the loads that they slept with, and
        lists the blocks that are awake."""
        for k in range(s.sleep.filled[0]):
            body = s.sleep.order[k]
            island = s.worlds.island[body]
            if island >= 0 and s.sleep.woken[island] != 0:
                s.worlds.island[body] = AWAKE
                s.sleep.still[body] = -1.0
            if s.worlds.island[body] < 0:
                side = s.history.parity[s.worlds.of_body[body]]
                if wp.static(effects.contact):
                    if side > 0:
                        start = s.sleep.start[body]
                        move_records(start, s.sleep.end[body], 0, start, side, s.history)
                    s.history.start[side, body] = s.sleep.start[body]
                    s.history.end[side, body] = s.sleep.end[body]
                s.sleep.start[body] = -1
                s.sleep.filled[2] = 1
        at = int(0)
        for world in range(s.worlds.body_start.shape[0] - 1):
            s.sleep.block_start[world] = at
            i = int(s.worlds.body_start[world])
            while i < s.worlds.body_start[world + 1]:
                mover = mover_of(i, s.worlds.block_end[i], s.worlds)
                if mover >= 0 and s.worlds.island[mover] == AWAKE:
                    s.sleep.blocks[at] = i
                    at += 1
                else:
                    for k in range(i, s.worlds.block_end[i]):
                        forget_rows(s.worlds.bodies[k], s.rows)
                i = s.worlds.block_end[i]
            s.sleep.block_start[world + 1] = at
        for body in range(s.sleep.order.shape[0]):
            s.sleep.woken[body] = 0
            s.sleep.met[body] = 0

    @wp.func
    def put_to_sleep(body: int, island: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """Stops a body where it is, and keeps what is remembered of its contacts."""
        s.worlds.island[body] = island
        forget_rows(body, s.rows)
        step.body_q_out[body] = step.body_q[body]
        step.body_qd_out[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        at = s.sleep.filled[1]
        end = int(at)
        if wp.static(effects.contact):
            side = s.history.parity[s.worlds.of_body[body]]
            start = s.history.start[side, body]
            count = s.history.end[side, body] - start
            if at + count <= s.history.records.shape[1]:
                move_records(start, start + count, side, at, 0, s.history)
                end = at + count
        s.sleep.start[body] = at
        s.sleep.end[body] = end
        s.sleep.order[s.sleep.filled[0]] = body
        s.sleep.filled[0] = s.sleep.filled[0] + 1
        s.sleep.filled[1] = end

    return together(close_gaps, wake_islands, put_to_sleep)
