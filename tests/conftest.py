# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What all tests have in common: they make Newton's collision kernels once.

Newton makes them anew for each pipeline, which takes four times as long as the rest of a small
simulation, and longer the more there are.
"""

import functools

from newton._src.geometry import narrow_phase

for _make in ("create_narrow_phase_kernel_gjk_mpr", "create_narrow_phase_primitive_kernel"):
    setattr(narrow_phase, _make, functools.cache(getattr(narrow_phase, _make)))
