# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What the last step cost each world, and how far it got."""

from dataclasses import dataclass

import numpy as np

_SHOWN = 20
"""Worlds that the table lists."""


@dataclass(frozen=True)
class Report:
    """Sweeps and residual of each world in the last step; printed, a table.

    All arrays have shape (world_count,): Newton's worlds where they are solved apart, otherwise one
    for all bodies. ``SolverAVBD.status`` has the same sweeps and updates.
    """

    sweeps: np.ndarray
    """Sweeps that the world took; 0 where nothing touched and no joint held."""
    update: np.ndarray
    """Residual: how far the last sweep still moved a body [m], a turn by its radius of gyration."""
    allowed: np.ndarray
    """Update at which the world's sweeps end [m]: ``tolerance``, or where nothing moves any
    more."""
    order: np.ndarray
    """Order of the step in time: 2 where a scheme of second order could be kept, otherwise 1."""

    @property
    def settled(self) -> np.ndarray:
        """Whether each world's sweeps ended because no body moved any more than allowed."""
        return self.update <= self.allowed

    def __str__(self) -> str:
        count = self.sweeps.size
        # the worlds that cost or lack most come first
        listed = np.lexsort((np.arange(count), -self.update, -self.sweeps))[:_SHOWN]
        lines = [
            f"{count} worlds, {int(np.sum(self.settled))} settled, "
            f"{int(np.sum(self.sweeps))} sweeps",
            f"{'world':>6} {'sweeps':>6} {'update [m]':>10} {'allowed [m]':>11} {'order':>5}",
        ]
        for world in listed:
            mark = "" if self.settled[world] else "  not settled"
            lines.append(
                f"{world:6d} {self.sweeps[world]:6d} {self.update[world]:10.1e} "
                f"{self.allowed[world]:11.1e} {self.order[world]:5d}{mark}"
            )
        if count > _SHOWN:
            rest = np.setdiff1d(np.arange(count), listed)
            lines.append(f"{rest.size} more, at most {int(self.sweeps[rest].max())} sweeps each")
        return "\n".join(lines)
