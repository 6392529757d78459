# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Which side of what is kept between steps a step writes."""

import functools

import warp as wp

from ..data import History
from ..effects import Effects


@wp.func
def other_side(world: int, history: wp.ref[History]) -> int:
    """The side that the step does not read."""
    return 1 - history.parity[world]


@wp.func
def next_side(world: int, history: wp.ref[History]) -> int:
    """With error control: the side that :mod:`.adapting` has chosen."""
    return history.next_side[world]


@functools.cache
def make_written_side(effects: Effects) -> wp.Function:
    """Device function: side that a step of a world writes."""
    return next_side if effects.adaptive else other_side
