# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Prefix sums by kernels alone, which any graph can capture: three launches, always the same sum.

A thread takes a run of about sqrt(n) of n counts, so that no thread goes through more than sqrt(n)
of anything.
"""

import math

import warp as wp

from .launch import Launcher


@wp.func
def run_end(run: int, length: int, count: int) -> int:
    """End of a run of ``length`` counts of ``count``."""
    return wp.min((run + 1) * length, count)


@wp.kernel(enable_backward=False)
def sum_runs(
    # In:
    counts: wp.array[wp.int32],
    count: int,
    length: int,
    # Out:
    sums: wp.array[wp.int32],
):
    """Sum of each run; one thread a run."""
    run = wp.tid()
    total = int(0)
    for i in range(run * length, run_end(run, length, count)):
        total += counts[i]
    sums[run] = total


@wp.kernel(enable_backward=False)
def sum_before_runs(
    # In:
    runs: int,
    # In and out:
    sums: wp.array[wp.int32],
):
    """Sum of all runs before each, in the place of its own; one thread."""
    total = int(0)
    for run in range(runs):
        own = sums[run]
        sums[run] = total
        total += own


@wp.kernel(enable_backward=False)
def sum_before(
    # In:
    counts: wp.array[wp.int32],
    count: int,
    length: int,
    sums: wp.array[wp.int32],
    # Out:
    starts: wp.array[wp.int32],
):
    """Sum of all counts before each, and after the last that of all; one thread a run."""
    run = wp.tid()
    total = int(sums[run])
    end = run_end(run, length, count)
    for i in range(run * length, end):
        starts[i] = total
        total += counts[i]
    if end == count:
        starts[count] = total


def _runs(count: int) -> tuple[int, int]:
    """Into how many runs of which length prefix sums divide counts."""
    length = max(1, math.isqrt(count))
    return -(-count // length), length


def scratch_size(count: int) -> int:
    """Length of the scratch that :func:`scan` needs for so many counts."""
    return _runs(count)[0] + 1


def scan(launch: Launcher, counts: wp.array, count: int, sums: wp.array, starts: wp.array) -> None:
    """Sums the first ``count`` counts before each, and all of them, into ``starts``.

    Args:
        launch: What launches kernels.
        counts: Shape (count or more,).
        count: How many there are.
        sums: Scratch, shape (:func:`scratch_size`,).
        starts: Out, shape (count + 1 or more,).
    """
    runs, length = _runs(count)
    launch(sum_runs, runs, [counts, count, length, sums])
    launch(sum_before_runs, 1, [runs, sums])
    launch(sum_before, runs, [counts, count, length, sums, starts])
