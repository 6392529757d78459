# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Structs that lie in memory: launches see what they hold, graphs what they held."""

import ctypes
import gc
import runpy

import warp as wp

from newton_avbd import data
from newton_avbd.drivers.launch import Launcher, put_members, putting
from newton_avbd.step.kernels import INLINING, compiler_flags, uncollected


@wp.struct
class Counter:
    count: wp.array[float]


@wp.kernel(enable_backward=False)
def count_up(counters: wp.array[Counter]):
    counter = counters[0]
    counter.count[0] = counter.count[0] + 1.0


def test_a_graph_goes_on_with_the_arrays_that_it_was_captured_with() -> None:
    """Their number of worlds may be another now."""
    first, second = wp.zeros(1, dtype=float, device="cpu"), wp.zeros(1, dtype=float, device="cpu")
    counter = Counter()
    counter.count = first
    launch = Launcher(wp.get_device("cpu"))
    launch(count_up, 1, [counter])
    with wp.ScopedCapture(device="cpu") as capture:
        launch(count_up, 1, [counter])
    before = float(first.numpy()[0])
    counter.count = second
    launch.forget()
    launch(count_up, 1, [counter])
    wp.capture_launch(capture.graph)
    assert first.numpy()[0] == before + 1.0
    assert second.numpy()[0] == 1.0


def test_a_kernel_puts_a_struct_where_it_lies() -> None:
    """As on a GPU; what copies it on a CPU is not seen by graphs."""
    counter = Counter()
    counter.count = wp.array([2.0], dtype=float, device="cpu")
    place = wp.empty(1, dtype=Counter, device="cpu")
    wp.launch(putting(Counter), dim=1, inputs=[counter, place], device="cpu")
    wp.launch(count_up, dim=1, inputs=[place], device="cpu")
    assert counter.count.numpy()[0] == 3.0


@wp.kernel(enable_backward=False)
def read_context(step: data.Step, s: wp.array[data.Solver], read: wp.array[float]):
    read[0] = s[0].work.inv_mass[0]
    read[1] = s[0].tree.cables.tension[0]
    read[2] = step.h


def test_structs_lie_in_one_as_a_kernel_reads_them() -> None:
    """However they are put there; a struct within one of them, too."""
    work, tree = data.BodyWork(), data.TreeWork()
    work.inv_mass = wp.array([2.0], dtype=float, device="cpu")
    tree.cables.tension = wp.array([3.0], dtype=float, device="cpu")
    context = data.Context(*[None] * 13)._replace(work=work, tree=tree)
    step, read = data.Step(), wp.zeros(3, dtype=float, device="cpu")
    step.h = 0.5
    launch = Launcher(wp.get_device("cpu"))
    launch(read_context, 1, [step, context, read])
    assert read.numpy().tolist() == [2.0, 3.0, 0.5]
    # a launch sees what a struct holds that it was given
    step.h = 0.25
    launch(read_context, 1, [step, context, read])
    assert read.numpy()[2] == 0.25
    place = wp.zeros(1, dtype=data.Solver, device="cpu")
    put_members(data.Solver, context, place)
    wp.launch(read_context, 1, [step, place, wp.zeros_like(read)], device="cpu")
    size = ctypes.sizeof(data.Solver.ctype)
    (resident,) = (known[2] for known in launch._resident.values())
    assert ctypes.string_at(place.ptr, size) == ctypes.string_at(resident.ptr, size)


def test_the_garbage_collector_pauses_and_is_left_as_it_was() -> None:
    """Also where the user has turned it off, and one pause lies within another."""
    assert gc.isenabled()
    with uncollected():
        with uncollected():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()


def test_kernels_are_inlined_as_the_package_says_or_the_user_does() -> None:
    """Warp's own thresholds, which are there by default, are not the user's."""
    default = runpy.run_path(wp.config.__file__)["cpu_compiler_flags"]
    assert "inline" in default
    flags = compiler_flags(default).split()
    assert [flag for flag in flags if "inline" in flag] == INLINING.split()
    assert "-march=native" in flags
    assert compiler_flags("-mllvm=-inline-threshold=1").endswith(" -mllvm=-inline-threshold=1")
