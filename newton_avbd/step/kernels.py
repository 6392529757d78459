# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How all kernels are made, and what stands for functions of an absent effect."""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import warp as wp

FUSED = "-ffp-contract=fast"
"""CPU compiler flag: fuses multiply and add also across inlined functions, 12 % faster sweeps.

Which it fuses depends on the kernel around them. What is added to ``wp.config.cpu_compiler_flags``
before the import comes after it: with ``" -ffp-contract=on"`` one world and many go to the same
bits."""
INLINING = "-mllvm=-inline-threshold=1000 -mllvm=-inline-cold-callsite-threshold=225"
"""CPU compiler flags in place of Warp's thresholds, with which a robot's kernel takes 1.2 times as
long to compile, and steps no faster."""
WARP_INLINING = "-mllvm=-inline-threshold=9000 -mllvm=-inline-cold-callsite-threshold=3000"
"""Stands in ``wp.config.cpu_compiler_flags`` by default."""
NO_BFLOAT16 = "-DWP_NO_BFLOAT16="
"""Leaves out of the headers that Warp compiles first what it leaves out of such kernels anyway."""


def compiler_flags(asked: str | None) -> str:
    """Flags of all kernels, then those that a user asks for: the last of a kind counts."""
    return " ".join((FUSED, NO_BFLOAT16, INLINING, (asked or "").replace(WARP_INLINING, "")))


KERNEL: dict[str, Any] = {
    "enable_backward": False,
    "module": "unique",
    "module_options": {
        "block_dim": 1,
        "cpu_compiler_flags": compiler_flags(wp.config.cpu_compiler_flags),
    },
}
"""How all kernels are made: Warp compiles its headers once for each set of flags (1 s), and finds
out what a kernel is made of once for each block size, that of a CPU being 1."""


KernelDecorator = Callable[..., Callable[[Callable], None]]
"""Makes a kernel of a function, or None where it is called with False: the scene does without."""


def in_module(name: str) -> tuple[KernelDecorator, SimpleNamespace]:
    """Decorator of kernels that are all in the module of this name, and what it makes, by name."""
    module = wp.get_module(name)
    module.options |= KERNEL["module_options"]
    made = SimpleNamespace()

    def kernel(is_called_for: bool = True) -> Callable[[Callable], None]:
        def make(function: Callable) -> None:
            found = None
            if is_called_for:
                found = wp.kernel(enable_backward=False, module=module)(function)
            setattr(made, function.__name__, found)

        return make

    return kernel, made


@contextmanager
def uncollected() -> Iterator[None]:
    """Pauses Python's garbage collector while kernels are made.

    All that is made stays. To look through it again and again took half of the time in Python.
    """
    is_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if is_on:
            gc.enable()


@wp.func
def absent():
    """In the place of functions of an effect that a scene does without: nothing calls them."""


class _Absent:
    """Functions of an absent effect, which take time to make also where nothing calls them."""

    def __getattr__(self, name: str) -> wp.Function:
        return absent


ABSENT: Any = _Absent()
