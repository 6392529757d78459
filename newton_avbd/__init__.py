# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""newton-avbd: a rigid-body solver for Newton by Augmented Vertex Block Descent."""

from .effects import Effect, Effects, SceneEffects
from .report import Report, Status
from .solver import SolverAVBD

__all__ = ["Effect", "Effects", "Report", "SceneEffects", "SolverAVBD", "Status"]
