# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Whole arrays are compared as their items are."""

import numpy as np
import warp as wp

from newton_avbd.step.comparing import are_equal_velocities, are_zero
from newton_avbd.step.kernels import KERNEL


@wp.kernel(**KERNEL)
def compare(
    one: wp.array[wp.spatial_vector],
    other: wp.array[wp.spatial_vector],
    found: wp.array[wp.bool],
):
    found[0] = are_equal_velocities(one, other)
    found[1] = are_zero(one)


def test_whole_arrays_are_equal_where_each_number_is():
    def compared(one: np.ndarray, other: np.ndarray, step: int = 1) -> list[bool]:
        found = wp.zeros(2, dtype=wp.bool, device="cpu")
        arrays = [wp.array(v, dtype=wp.spatial_vector, device="cpu")[::step] for v in (one, other)]
        wp.launch(compare, 1, [*arrays, found], device="cpu")
        return found.numpy().tolist()

    still = np.zeros((23, 6), dtype=np.float32)
    assert compared(still, -still) == [True, True]
    for place in ((0, 0), (11, 3), (22, 5)):
        moved = still.copy()
        moved[place] = 1.0e-30
        assert compared(moved, still) == [False, False]
        assert compared(moved, moved) == [True, False]
        moved[place] = np.nan
        assert compared(moved, moved) == [False, False]
    # no claim about items that do not follow each other
    assert compared(still, still, step=2) == [False, False]
