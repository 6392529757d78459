# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The solvers that the command line offers, by name, and what each asks of a model."""

from functools import cache
from typing import Any

import newton
import warp as wp

from .errors import require

XPBD_SWEEPS = 10
"""Iterations of SolverXPBD where nothing else is said: as many as SolverAVBD and SolverVBD take."""

DEFORMABLE = ("vbd", "xpbd")
"""Solvers of cloth, soft bodies and grains, too; from the others such a scene keeps its own."""

_CLASSES = {
    "vbd": "SolverVBD",
    "xpbd": "SolverXPBD",
    "mujoco": "SolverMuJoCo",
    "kamino": "SolverKamino",
}
"""Names of Newton's classes. Their modules take seconds to import: only those used are."""


def solver_class(name: str) -> type[newton.solvers.SolverBase]:
    """Class of the solver ``name``, one of :data:`~newton_avbd.io.names.SOLVERS`."""
    if name == "avbd":
        from newton_avbd import SolverAVBD

        return SolverAVBD
    if name == "mujoco":
        require("mujoco", "mujoco_warp")
    return _of_newton(name)


@cache
def _of_newton(name: str) -> type[newton.solvers.SolverBase]:
    """Class of one of Newton's solvers: after the first call the same, also where a swap has
    patched ``newton.solvers``."""
    solver: type[newton.solvers.SolverBase] = getattr(newton.solvers, _CLASSES[name])
    return solver


def prepare(name: str, builder: newton.ModelBuilder) -> None:
    """Do what a solver needs to have been done to a builder before it is filled."""
    solver_class(name).register_custom_attributes(builder)


def complete(name: str, builder: newton.ModelBuilder) -> None:
    """Do what a solver needs to have been done to a builder before it is finalized."""
    if name == "vbd" and builder.body_count and not builder.body_color_groups:
        builder.color()


def construct(
    name: str, model: newton.Model, iterations: int | None = None, **options: Any
) -> newton.solvers.SolverBase:
    """Make the solver ``name`` for ``model``.

    All use Newton's contacts, but for MuJoCo on CPU: there it is MuJoCo proper, in C, which only
    knows its own.

    Args:
        name: One of :data:`~newton_avbd.io.names.SOLVERS`.
        model: The model.
        iterations: Iterations a step; None for the scene's or the solver's own default, and for
            :data:`XPBD_SWEEPS` with SolverXPBD, so that solvers that sweep compare.
        options: Further keyword arguments of the solver's class.

    Returns:
        The solver.

    Raises:
        NotImplementedError: The model holds what the solver cannot do.
    """
    if iterations is None and name == "xpbd":
        iterations = XPBD_SWEEPS
    if iterations is not None:
        options["iterations"] = iterations
    if name == "mujoco":
        on_cpu = not wp.get_device(model.device).is_cuda
        options.update(use_mujoco_cpu=on_cpu, use_mujoco_contacts=on_cpu)
    return solver_class(name)(model, **options)


def detects_collisions(solver: newton.solvers.SolverBase) -> bool:
    """Whether a solver that :func:`construct` made detects collisions itself."""
    return bool(getattr(solver, "use_mujoco_cpu", False))
