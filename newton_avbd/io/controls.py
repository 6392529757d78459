# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Controls of MuJoCo's actuators over time, the same for every solver."""

from pathlib import Path

import newton
import numpy as np
from numpy.typing import NDArray

from .errors import UserError
from .mjcf import read_mjcf

HOLD = 0.05
"""How long a random control lasts [s]."""


class Controls:
    """Controls within half of each actuator's range, or half of -1 to 1 where it has none."""

    def __init__(self, kind: str, model: newton.Model, path: Path) -> None:
        """Make them.

        Args:
            kind: One of :data:`~newton_avbd.io.names.CONTROLS`.
            model: The model.
            path: The MJCF file that it was read from, for ``"keyframe"``.

        Raises:
            UserError: The model has no actuators, or the file no keyframe that controls them.
        """
        count = model.custom_frequency_counts.get("mujoco:actuator", 0)
        if not count:
            raise UserError(f"--ctrl: {path} has no actuators that control.mujoco.ctrl controls")
        self._kind, self._index = kind, np.arange(count)
        ranges = model.mujoco.actuator_ctrlrange.numpy()
        has_range = model.mujoco.actuator_has_ctrlrange.numpy()[:, None] > 0
        low, high = np.where(has_range, ranges, (-1.0, 1.0)).T
        self._middle, self._size = 0.5 * (low + high), 0.25 * (high - low)
        self._keyframe = _keyframe(path, count) if kind == "keyframe" else None

    def at(self, time: float) -> NDArray[np.float32]:
        """Controls at a time [s], shape (actuators,)."""
        if self._keyframe is not None:
            return self._keyframe
        if self._kind == "sine":
            rate = 1.0 + 0.3 * self._index % 2.0
            share = np.sin(2.0 * np.pi * rate * time + self._index)
        else:
            # a generator of its own for each interval: the same at any time step
            generator = np.random.default_rng(int(time / HOLD + 1.0e-9))
            share = generator.uniform(-1.0, 1.0, self._index.size)
        return (self._middle + self._size * share).astype(np.float32)


def _keyframe(path: Path, count: int) -> NDArray[np.float32]:
    """Controls of the first keyframe of a file, or of one that it includes, that has some.

    Raises:
        UserError: There is none.
    """
    for key in read_mjcf(path)[0].iter("key"):
        values = np.array(key.get("ctrl", "").split(), dtype=np.float32)
        if values.size == count:
            return values
    raise UserError(f"--ctrl keyframe: {path} has no keyframe with {count} controls")
