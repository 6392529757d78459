# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Blocks of threads, and where those of one wait for each other. On a CPU a block is one thread."""

import warp as wp

BLOCK = 256
"""Threads of a block on a GPU; Warp's default."""
WARP = 32
"""The fewest that waste none. Blocks of so many spread threads with much to do, such as those of a
world, over all multiprocessors: 4,096 worlds are 16 blocks of 256 but 128 of 32, on 132 of them."""


def block_size(device: wp.Device, block: int = BLOCK) -> int:
    """Threads of a block."""
    return 1 if device.is_cpu else block


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __syncthreads_or(value);
#else
    return value;
#endif
""")
def any_thread(value: int) -> int:
    """Whether ``value`` is other than zero in any thread of the block, once all have come here.

    All of them have to; what any wrote before is seen by each after.
    """
    ...
