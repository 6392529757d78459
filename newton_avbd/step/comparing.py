# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Whether arrays hold the same numbers: whole arrays at once, many numbers an instruction."""

from typing import Any

import warp as wp

_COMPARE = """
    const int size = (int)sizeof(*one.data);
    if (one.strides[0] != size || other.strides[0] != size || one.shape[0] != other.shape[0])
        return false;
    const float* a = (const float*)one.data;
    const float* b = (const float*)other.data;
    const int count = one.shape[0] * size / (int)sizeof(float);
    int unequal = 0;
    for (int i = 0; i < count; ++i)
        unequal |= !(a[i] == b[i]);
    return unequal == 0;
"""


def _make_are_equal(dtype: Any) -> wp.Function:
    """Device function for arrays of items of ``dtype``, which is made of single precision."""

    @wp.func_native(_COMPARE)
    def are_equal(one: wp.array[dtype], other: wp.array[dtype]) -> bool:
        """Whether two arrays hold the same numbers; numbers that are none equal nothing.

        False also where the items of an array do not follow each other.
        """
        ...

    return are_equal


are_equal_numbers = _make_are_equal(float)
are_equal_vectors = _make_are_equal(wp.vec3)
are_equal_matrices = _make_are_equal(wp.mat33)
are_equal_velocities = _make_are_equal(wp.spatial_vector)


@wp.func_native("""
    const int size = (int)sizeof(*wrenches.data);
    if (wrenches.strides[0] != size)
        return false;
    const float* f = (const float*)wrenches.data;
    const int count = wrenches.shape[0] * size / (int)sizeof(float);
    int other = 0;
    for (int i = 0; i < count; ++i)
        other |= !(f[i] == 0.0f);
    return other == 0;
""")
def are_zero(wrenches: wp.array[wp.spatial_vector]) -> bool:
    """Whether all numbers of an array are zero; False also where items do not follow each other."""
    ...
