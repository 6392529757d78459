# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How the tests, and the processes that they start, compile kernels: fast, for few steps of each.

Without derivatives, which no test takes; and optimised less, so that clang takes two thirds of its
time, and steps up to twice as long.
"""

import warp as wp

wp.config.enable_backward = False
wp.config.cpu_compiler_flags = " ".join(
    [
        "-march=native",
        "-fno-vectorize",
        "-fno-slp-vectorize",
        "-disable-lifetime-markers",
        "-mllvm=-inline-threshold=25",
        "-mllvm=-inline-cold-callsite-threshold=5",
        "-mllvm=-enable-gvn-memdep=0",
        "-mllvm=-regalloc=basic",
    ]
)
