# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Launches that remember their arguments: packing them costs more than a small scene's step."""

import warp as wp

from .workers import Workers


class Launcher:
    """Launches kernels on one device, packing again only the arguments that changed."""

    def __init__(self, device: wp.Device) -> None:
        self._device = device
        self._recorded: dict[wp.Kernel, tuple[int, wp.Launch, list]] = {}

    def __call__(
        self, kernel: wp.Kernel, dim: int, arguments: list, workers: Workers | None = None
    ) -> None:
        """Launches ``kernel`` with ``dim`` threads; arguments are compared by identity.

        With ``workers`` they share them.
        """
        known = self._recorded.get(kernel)
        if known is None or known[0] != dim:
            command = wp.launch(
                kernel, dim=dim, inputs=arguments, device=self._device, record_cmd=True
            )
            self._recorded[kernel] = (dim, command, list(arguments))
        else:
            _, command, packed = known
            for i, argument in enumerate(arguments):
                if argument is not packed[i]:
                    command.set_param_at_index(i, argument)
                    packed[i] = argument
        command = self._recorded[kernel][1]
        if workers is None:
            command.launch()
        else:
            workers.launch(command, dim)

    def forget(self) -> None:
        """Drops what was packed, after a struct among the arguments changed its arrays."""
        self._recorded.clear()


class Compiler(Launcher):
    """Compiles and loads the kernels that it is to launch, and launches none."""

    def __call__(
        self, kernel: wp.Kernel, dim: int, arguments: list, workers: Workers | None = None
    ) -> None:
        """Makes ``kernel`` ready for ``dim`` threads."""
        wp.launch(kernel, dim=dim, inputs=arguments, device=self._device, record_cmd=True)
