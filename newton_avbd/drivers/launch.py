# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Launches that remember their arguments: packing them costs more than a small scene's step.

A struct of arrays is an argument of many pointers. A graph that is replayed on a CPU looks up each
of them, which took half the time of a pendulum's step. So structs that stay the same are
*resident*: they lie in an array of one, which is what kernels are given. Device functions take them
by reference (``wp.ref``): by value each call copies a thousand pointers, which a compiler for GPUs
spends most of its time on where it inlines, and which a function that is not inlined would do.
What lasts from step to step is one such struct, :class:`.data.Solver`, whose members lie side by
side; on the host they are a :class:`.data.Context`.
"""

import ctypes
import functools
from typing import Any

import warp as wp

from ..data import Context
from ..step.kernels import KERNEL, uncollected
from .barrier import BLOCK, block_size
from .workers import Workers


@functools.cache
def putting(struct: type) -> wp.Kernel:
    """Kernel, one thread: puts a struct into an array of one."""

    @wp.kernel(**KERNEL)
    def put(value: struct, place: wp.array[struct]):
        place[0] = value

    return put


class Launcher:
    """Launches kernels on one device, packing again only the arguments that changed."""

    def __init__(self, device: wp.Device) -> None:
        self._device = device
        self._recorded: dict[wp.Kernel, dict[int, tuple[wp.Launch, list]]] = {}
        self._resident: dict[int, tuple[Any, bytes, wp.array]] = {}
        self._places: list[wp.array] = []

    def __call__(
        self,
        kernel: wp.Kernel | None,
        dim: int,
        arguments: list,
        workers: Workers | None = None,
        block: int = BLOCK,
    ) -> None:
        """Launches ``kernel`` with ``dim`` threads; arguments are compared by identity.

        With ``workers`` they share them. A GPU takes ``block`` threads as a block. Without threads
        there is nothing to launch, as over the contacts of a buffer that can hold none, nor without
        a kernel, whose effect the scene does without.
        """
        if dim == 0 or kernel is None:
            return
        recorded = self._recorded.setdefault(kernel, {})
        known = recorded.get(dim)
        if known is None:
            command = self._pack(kernel, dim, arguments, block)
            recorded[dim] = (command, list(arguments))
        else:
            command, packed = known
            for i, argument in enumerate(arguments):
                if argument is not packed[i]:
                    command.set_param_at_index(i, self._passed(kernel, i, argument))
                    packed[i] = argument
        if workers is None:
            command.launch()
        else:
            workers.launch(command, dim)

    def forget(self) -> None:
        """Drops what was packed, after a struct among the arguments changed its arrays."""
        self._recorded.clear()

    def _pack(self, kernel: wp.Kernel, dim: int, arguments: list, block: int) -> wp.Launch:
        inputs = [self._passed(kernel, i, argument) for i, argument in enumerate(arguments)]
        device = self._device
        with uncollected():
            return wp.launch(
                kernel,
                dim,
                inputs,
                device=device,
                record_cmd=True,
                block_dim=block_size(device, block),
            )

    def _passed(self, kernel: wp.Kernel, i: int, argument: Any) -> Any:
        """What a kernel is given for an argument."""
        struct = getattr(kernel.adj.args[i].type, "dtype", None)
        if struct is None or argument is None or isinstance(argument, wp.array):
            return argument
        content = _content(struct, argument)
        known = self._resident.get(id(argument))
        if known is None or known[1] != content:
            place = wp.empty(1, dtype=struct, device=self._device)
            if self._device.is_cpu:
                # at once, also while a graph is captured
                ctypes.memmove(place.ptr, content, len(content))
            elif isinstance(argument, Context):
                place.zero_()
                put_members(struct, argument, place)
            else:
                wp.launch(putting(struct), dim=1, inputs=[argument, place], device=self._device)
            # graphs that were captured before go on using the old place, and the arrays named there
            self._places.append(place)
            known = argument, content, place
            self._resident[id(argument)] = known
        return known[2]


def put_members(struct: Any, context: Context, place: wp.array) -> None:
    """Puts structs to where they lie in another one, which is zero so far.

    Each by itself: together they may be more than the arguments of a kernel have room for.
    """
    for name, var in struct.vars.items():
        member = getattr(context, name)
        if member is None or not any(bytes(member.__ctype__())):
            continue
        view = wp.array(
            ptr=place.ptr + getattr(struct.ctype, name).offset,
            dtype=var.type,
            shape=(1,),
            device=place.device,
        )
        wp.launch(putting(var.type), dim=1, inputs=[member, view], device=place.device)


def _content(struct: Any, argument: Any) -> bytes:
    """Bytes of a struct."""
    if not isinstance(argument, Context):
        return bytes(argument.__ctype__())
    whole = struct.ctype()
    for name, member in zip(argument._fields, argument, strict=True):
        if member is not None:
            setattr(whole, name, member.__ctype__())
    return bytes(whole)


class Compiler(Launcher):
    """Compiles and loads the kernels that it is to launch, and launches none."""

    def __call__(
        self,
        kernel: wp.Kernel | None,
        dim: int,
        arguments: list,
        workers: Workers | None = None,
        block: int = BLOCK,
    ) -> None:
        """Makes ``kernel`` ready for ``dim`` threads."""
        if kernel is not None:
            self._pack(kernel, dim, arguments, block)
