# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Threads that share the worlds of a step on the CPU, where Warp runs a launch on one.

A launch frees Python's global lock, so that threads of this process run at once. Worlds, and bodies
before they meet, are independent: which thread takes one changes no bit of the result.
"""

import functools
import math
import os
import platform
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor

import warp as wp

HANDOVER = 150.0e-6
"""Time that one more thread costs a launch [s]: two pay from four times this work on."""
LEAST = 100.0e-6
"""Work of the smallest slice [s]; taking one costs 10 us."""
REST = 20
"""Launches in one thread after one in several took longer: other processes have the cores."""


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def _pool() -> ThreadPoolExecutor:
    """Threads of all solvers of the process, beside those that call ``step``."""
    return ThreadPoolExecutor(max(cores(), 2), thread_name_prefix="avbd")


if hasattr(os, "register_at_fork"):
    # threads do not survive it
    os.register_at_fork(after_in_child=_pool.cache_clear)


def is_reentrant(kernel: wp.Kernel) -> bool:
    """Whether several threads may run a kernel at once.

    Warp notes in a static variable where on the stack of a launch tiles would lie. Code that is not
    optimised looks there though it has none, and crashes where another thread has just ended. On
    ARM the note is in a register (``warp/native/tile.h``).
    """
    options = kernel.module.resolve_options(wp.config)
    is_noted = options["enable_tiles_in_stack_memory"] and platform.machine() == "x86_64"
    return not is_noted or (options["mode"] != "debug" and options["optimization_level"] != 0)


class Workers:
    """Launches one kernel, whose first argument is the world or body of its first thread."""

    def __init__(self, most: int | None) -> None:
        """Starts no thread: the first launch that pays for one does.

        Args:
            most: Threads for a launch; None for one a core.

        Raises:
            ValueError: If there would be no thread.
        """
        if most is not None and most < 1:
            raise ValueError(f"workers must be at least 1, got {most}.")
        self._most = cores() if most is None else most
        self._work = 0.0
        self._rest = 0
        self._whole: wp.Launch | None = None
        self._is_shared = False
        self._parts: list[wp.Launch] = []

    def launch(self, whole: wp.Launch, items: int) -> None:
        """Runs a launch in slices; in one thread where a graph is captured, or threads may not.

        Args:
            whole: The launch, recorded from 0 on.
            items: Worlds or bodies that it has.
        """
        if min(items, self._most) == 1 or not whole.device.is_cpu or whole.device.is_capturing:
            whole.launch()
            return
        if whole is not self._whole:
            self._whole, self._parts = whole, []
            self._is_shared = is_reentrant(whole.kernel)
        count = min(self._count(), items) if self._is_shared else 1
        if count == 1:
            begin = time.thread_time()
            whole.launch()
            self._work = time.thread_time() - begin
            return
        begin = time.perf_counter()
        slices = _slices(items, count, self._work)
        own, *parts = self._parts_of(whole, count)
        others: list[Future[float]] = [_pool().submit(_run, part, slices) for part in parts]
        times = []
        try:
            times.append(_run(own, slices))
        finally:
            slices.clear()
            # one that has not begun by now would find nothing left
            times.extend(other.result() for other in others if not other.cancel())
        self._work = sum(times)
        if time.perf_counter() - begin > self._work:
            self._rest = REST

    def _count(self) -> int:
        """Threads with which the work T of the last launch takes least: T / n + n HANDOVER."""
        if self._rest:
            self._rest -= 1
            return 1
        return max(1, min(int(math.sqrt(self._work / HANDOVER)), self._most))

    def _parts_of(self, whole: wp.Launch, count: int) -> list[wp.Launch]:
        """A launch for each thread, with the arguments of the whole."""
        while len(self._parts) < count:
            part = wp.Launch(whole.kernel, whole.device, whole.hooks, [*whole.params])
            self._parts.append(part)
        for part in self._parts[:count]:
            part.params[2:] = whole.params[2:]
        return self._parts[:count]


def _slices(items: int, count: int, work: float) -> deque[tuple[int, int]]:
    """Where each slice begins and its size: large ones first, then small ones to end even."""
    least = max(1, math.ceil(items * LEAST / max(work, LEAST)))
    slices: deque[tuple[int, int]] = deque()
    first = 0
    while first < items:
        size = min(max((items - first) // (2 * count), least), items - first)
        slices.append((first, size))
        first += size
    return slices


def _run(part: wp.Launch, slices: deque[tuple[int, int]]) -> float:
    """Launches slices until none is left; returns the processor time that it took [s]."""
    begin = time.thread_time()
    while True:
        try:
            first, size = slices.popleft()
        except IndexError:
            return time.thread_time() - begin
        part.set_dim(size)
        part.set_param_at_index(0, first)
        part.launch()
