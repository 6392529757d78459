# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a step overwrites of a world's memory, copied before it, and put back for another try."""

import warp as wp

from ..data import WorldWork


@wp.func_native("""
    memcpy((void*)target, (const void*)source, (size_t)size);
""")
def copy_bytes(target: wp.uint64, source: wp.uint64, size: int):
    """Copies memory: all that a body leaves to the next step, faster than array by array."""
    ...


@wp.func
def save_world(world: int, worlds: wp.ref[WorldWork]):
    """Copies what a step will overwrite of a world's memory."""
    for k in range(worlds.inner.first[world], worlds.inner.first[world + 1]):
        segment = worlds.inner.segments[k]
        copy_bytes(segment.copy, segment.address, segment.size)


@wp.func
def restore_world(world: int, worlds: wp.ref[WorldWork]):
    """Puts it back."""
    for k in range(worlds.inner.first[world], worlds.inner.first[world + 1]):
        segment = worlds.inner.segments[k]
        copy_bytes(segment.address, segment.copy, segment.size)
