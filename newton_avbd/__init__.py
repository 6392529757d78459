# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""newton-avbd: a rigid-body solver for Newton by Augmented Vertex Block Descent."""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .effects import Effect, Effects, SceneEffects
    from .report import Report, Status
    from .solver import SolverAVBD

__all__ = ["Effect", "Effects", "Report", "SceneEffects", "SolverAVBD", "Status"]

_HOMES = {
    "Effect": "effects",
    "Effects": "effects",
    "Report": "report",
    "SceneEffects": "effects",
    "SolverAVBD": "solver",
    "Status": "report",
}
"""Modules of the public names. They need Newton, which the command line imports only to work."""

_MODULES = ("coupling", "effects", "report", "settings", "solver")
"""Modules that hold more that is public, as attributes of the package."""

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Import a public name when it is first asked for."""
        if name in _MODULES:
            return importlib.import_module(f"{__name__}.{name}")
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    """All names, imported or not."""
    return sorted({*globals(), *__all__, *_MODULES})
