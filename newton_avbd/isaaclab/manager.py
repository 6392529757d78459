# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What Isaac Lab's Newton backend makes SolverAVBD with."""

from typing import Any

import newton
from isaaclab_newton import physics

from newton_avbd import SolverAVBD

from .config import AVBDSolverCfg

_Base: Any = getattr(physics, "NewtonSolver", None) or physics.NewtonManager
"""What a solver's configuration names: a manager, and later an adapter without a state."""


class NewtonAVBDManager(_Base):
    """Makes a :class:`newton_avbd.SolverAVBD` for each simulation.

    Release 3.0.0 calls ``_build_solver``, which fills slots of NewtonManager itself. The
    development branch after it constructs ``solver_class``; its last stage has an adapter
    ``NewtonSolver`` in the place of the manager. The base class does the rest: contacts by
    Newton's pipeline, two states, ``reset(state, world_mask, flags=0)``.
    """

    # Isaac Lab 3.0.0
    _builder_attribute_solvers = (SolverAVBD,)

    # and after it
    solver_class = SolverAVBD
    builder_attribute_solvers = (SolverAVBD,)
    supports_heterogeneous_worlds = True

    @classmethod
    def _create_solver(cls, model: newton.Model, solver_cfg: AVBDSolverCfg) -> SolverAVBD:
        return SolverAVBD(model, **cls._filter_solver_kwargs(SolverAVBD, solver_cfg))

    @classmethod
    def _build_solver(cls, model: newton.Model, solver_cfg: AVBDSolverCfg) -> None:
        manager = physics.NewtonManager
        manager._solver = cls._create_solver(model, solver_cfg)
        manager._use_single_state = False
        manager._needs_collision_pipeline = True
        manager._supports_rigid_body_force_input = True
