# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Threads that share the worlds of a step; that they change no bit: ``test_determinism.py``."""

import numpy as np
import pytest
import warp as wp

from newton_avbd.drivers import workers
from newton_avbd.drivers.workers import Workers, is_reentrant


@pytest.fixture
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads pay for any work."""
    monkeypatch.setattr(workers, "HANDOVER", 1.0e-12)
    monkeypatch.setattr(workers, "LEAST", 1.0e-12)
    monkeypatch.setattr(workers, "REST", 0)


@wp.kernel(enable_backward=False)
def count_visits(first: int, visits: wp.array[int]):
    """Adds one to the entry of each world."""
    world = first + wp.tid()
    visits[world] = visits[world] + 1


def recorded(visits: wp.array) -> wp.Launch:
    count = visits.shape[0]
    return wp.launch(count_visits, dim=count, inputs=[0, visits], device="cpu", record_cmd=True)


def none() -> None:
    """In the place of the pool of threads."""
    raise AssertionError("a thread was asked for")


@pytest.mark.parametrize("worlds", [1, 2, 7, 1000])
@pytest.mark.parametrize("count", [1, 2, 3, 16])
def test_every_world_is_visited_once(eager: None, worlds: int, count: int) -> None:
    """Also where there are more threads than worlds, or slices of a single world."""
    threads = Workers(count)
    for _ in range(3):
        visits = wp.zeros(worlds, dtype=wp.int32, device="cpu")
        whole = recorded(visits)
        for turn in range(1, 4):
            threads.launch(whole, worlds)
            np.testing.assert_array_equal(visits.numpy(), turn)


def test_other_arguments_reach_every_thread(eager: None) -> None:
    """A step swaps its states, so that arguments of a recorded launch change."""
    old, new = (wp.zeros(64, dtype=wp.int32, device="cpu") for _ in range(2))
    threads, whole = Workers(4), recorded(old)
    for _ in range(2):
        threads.launch(whole, 64)
    whole.set_param_at_index(1, new)
    threads.launch(whole, 64)
    np.testing.assert_array_equal(old.numpy(), 2)
    np.testing.assert_array_equal(new.numpy(), 1)


def test_an_error_in_any_thread_surfaces(eager: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """And the next launch is whole again."""
    visits = wp.zeros(64, dtype=wp.int32, device="cpu")
    threads, whole = Workers(3), recorded(visits)
    threads.launch(whole, 64)
    run = workers._run

    def fail_beside(part: wp.Launch, slices: object) -> float:
        if part is not threads._parts[0]:
            raise RuntimeError("no such luck")
        return run(part, slices)

    # nobody is cancelled: the thread that steps waits for the others to fail
    monkeypatch.setattr(workers.Future, "cancel", lambda self: False)
    monkeypatch.setattr(workers, "_run", fail_beside)
    with pytest.raises(RuntimeError, match="no such luck"):
        threads.launch(whole, 64)
    monkeypatch.setattr(workers, "_run", run)
    visits.zero_()
    threads.launch(whole, 64)
    np.testing.assert_array_equal(visits.numpy(), 1)


def test_a_small_batch_starts_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Below the work that pays; nor does a graph while it is captured."""
    monkeypatch.setattr(workers, "_pool", none)
    visits = wp.zeros(64, dtype=wp.int32, device="cpu")
    whole = recorded(visits)
    threads = Workers(4)
    for _ in range(3):
        threads.launch(whole, 64)
    threads._work = 1.0
    with wp.ScopedCapture(device="cpu") as capture:
        threads.launch(whole, 64)
    wp.capture_launch(capture.graph)
    np.testing.assert_array_equal(visits.numpy(), 4)


@pytest.mark.parametrize(
    ("option", "value"), [("mode", "debug"), ("optimization_level", 0), ("optimization_level", 1)]
)
def test_code_that_follows_a_static_pointer_stays_in_one_thread(
    option: str, value: str | int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of Warp on x86, where it was not optimised and tiles lie on the stack; not on ARM."""
    monkeypatch.setattr(wp.config, "enable_tiles_in_stack_memory", True)
    monkeypatch.setattr(workers.platform, "machine", lambda: "x86_64")
    assert is_reentrant(count_visits)
    monkeypatch.setitem(count_visits.module.options, option, value)
    assert is_reentrant(count_visits) == (value == 1)
    monkeypatch.setattr(workers, "_pool", none)
    visits = wp.zeros(64, dtype=wp.int32, device="cpu")
    threads, whole = Workers(4), recorded(visits)
    threads._work = 1.0
    if value != 1:
        threads.launch(whole, 64)
        np.testing.assert_array_equal(visits.numpy(), 1)
    monkeypatch.setattr(workers.platform, "machine", lambda: "aarch64")
    assert is_reentrant(count_visits)
    monkeypatch.setattr(workers.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(wp.config, "enable_tiles_in_stack_memory", None)
    assert is_reentrant(count_visits)


def test_threads_grow_with_the_root_of_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """n threads take T / n + n c, least at n = sqrt(T / c); no more than there are cores.

    None beside it for a while after other processes had the cores.
    """
    monkeypatch.setattr(workers, "cores", lambda: 8)
    threads = Workers(None)
    for work, count in ((0.0, 1), (3.9, 1), (4.1, 2), (9.1, 3), (1.0e4, 8)):
        threads._work = work * workers.HANDOVER
        assert threads._count() == count
    threads._rest = 2
    assert [threads._count() for _ in range(3)] == [1, 1, 8]


def test_no_workers_is_an_error() -> None:
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        Workers(0)
