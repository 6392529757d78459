# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers below 1e-38 count as zero on the CPU: motions that decay forever are slow otherwise.

An ant at rest took three times as long as one that moves. Other devices and processors keep their
mode; a GPU is not slower for such numbers.
"""

import warp as wp


@wp.func_native("""
#if defined(__x86_64__) && !defined(__CUDA_ARCH__)
    unsigned int mode = __builtin_ia32_stmxcsr();
    // bit 15 flushes results to zero, bit 6 takes inputs as zero
    __builtin_ia32_ldmxcsr(mode | 0x8040u);
    return (int)mode;
#else
    return 0;
#endif
""")
def flush_denormals() -> int:
    """Counts numbers below 1e-38 as zero from here on; returns the mode before."""
    ...


@wp.func_native("""
#if defined(__x86_64__) && !defined(__CUDA_ARCH__)
    __builtin_ia32_ldmxcsr((unsigned int)mode);
#endif
""")
def restore_denormals(mode: int):
    """Puts the mode back that :func:`flush_denormals` returned."""
    ...
