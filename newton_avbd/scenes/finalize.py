# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Models of builders, with small moments of inertia as they are."""

from typing import Any

import newton
import numpy as np

ROUNDED = 1.0e-5
"""Share by which moments of inertia may miss what a body can have."""


def finalized(builder: newton.ModelBuilder, **options: Any) -> newton.Model:
    """``builder.finalize``, which leaves small moments of inertia as they are.

    Newton takes less than 1e-10 kg m^2 for an error and adds 1e-6 kg m^2: to a thumb of 1 g, the
    tail of a rat. Where all bodies have moments of inertia that a body can have, it is not asked to
    correct them.
    """
    inertia = np.array(builder.body_inertia, dtype=float).reshape(-1, 3, 3)
    mass = np.array(builder.body_mass, dtype=float)
    return builder.finalize(skip_validation_inertia=_is_sound(mass, inertia), **options)


def _is_sound(mass: np.ndarray, inertia: np.ndarray) -> bool:
    """Whether bodies can have these masses and moments of inertia, the triangle inequality too."""
    if not (np.all(np.isfinite(mass)) and np.all(np.isfinite(inertia)) and np.all(mass >= 0.0)):
        return False
    largest = np.abs(inertia).max(axis=(1, 2))
    if np.any(np.abs(inertia - np.swapaxes(inertia, 1, 2)).max(axis=(1, 2)) > ROUNDED * largest):
        return False
    moments = np.linalg.eigvalsh(inertia)
    has_inertia = (moments[:, 0] > ROUNDED * largest) & (
        moments[:, 2] <= (1.0 + ROUNDED) * moments[:, :2].sum(axis=1)
    )
    return bool(np.all(np.where(mass > 0.0, has_inertia, largest == 0.0)))
