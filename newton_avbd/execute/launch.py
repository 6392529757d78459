# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Launches that remember their arguments: packing them costs more than a small scene's step."""

import warp as wp


class Launcher:
    """Launches kernels on one device, packing again only the arguments that changed."""

    def __init__(self, device: wp.Device) -> None:
        self._device = device
        self._recorded: dict[wp.Kernel, dict[int, tuple[wp.Launch, list]]] = {}

    def __call__(self, kernel: wp.Kernel, dim: int, arguments: list) -> None:
        """Launches ``kernel`` with ``dim`` threads; arguments are compared by identity."""
        recorded = self._recorded.setdefault(kernel, {})
        known = recorded.get(dim)
        if known is None:
            command = wp.launch(
                kernel, dim=dim, inputs=arguments, device=self._device, record_cmd=True
            )
            recorded[dim] = (command, list(arguments))
        else:
            command, packed = known
            for i, argument in enumerate(arguments):
                if argument is not packed[i]:
                    command.set_param_at_index(i, argument)
                    packed[i] = argument
        command.launch()

    def forget(self) -> None:
        """Drops what was packed, after a struct among the arguments changed its arrays."""
        self._recorded.clear()


class Compiler(Launcher):
    """Compiles and loads the kernels that it is to launch, and launches none."""

    def __call__(self, kernel: wp.Kernel, dim: int, arguments: list) -> None:
        """Makes ``kernel`` ready for ``dim`` threads."""
        wp.launch(kernel, dim=dim, inputs=arguments, device=self._device, record_cmd=True)
