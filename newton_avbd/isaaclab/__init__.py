# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""SolverAVBD in Isaac Lab 3.0, selected by a task's configuration.

The module can be imported without Isaac Lab; what it offers cannot be used then. The configuration
is a module of its own, as in Isaac Lab, where configurations are loaded before the simulation.
"""

import importlib
from typing import Any

__all__ = ["AVBDSolverCfg", "NewtonAVBDManager"]

_MODULES = {"AVBDSolverCfg": "config", "NewtonAVBDManager": "manager"}


def __getattr__(name: str) -> Any:
    """Import what Isaac Lab is needed for.

    Raises:
        ImportError: Isaac Lab is not installed, or has no Newton backend.
    """
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        module = importlib.import_module(f"{__name__}.{_MODULES[name]}")
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("isaaclab"):
            raise
        raise ImportError(
            f"newton_avbd.isaaclab.{name} needs Isaac Lab 3.0 with its Newton backend, and the "
            f"package {error.name} is not installed: see "
            "https://isaac-sim.github.io/IsaacLab/release/3.0.0/source/isaaclab/quickstart.html"
        ) from error
    return getattr(module, name)
