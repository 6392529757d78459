# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Settings of SolverAVBD as Isaac Lab's tasks configure solvers."""

from typing import Literal

from isaaclab.utils.configclass import configclass
from isaaclab_newton.physics import NewtonSolverCfg


@configclass
class AVBDSolverCfg(NewtonSolverCfg):
    """Configuration of :class:`newton_avbd.SolverAVBD`, for ``NewtonCfg(solver_cfg=...)``.

    The settings are the solver's arguments; None is its own default.
    """

    class_type: type | str = "newton_avbd.isaaclab:NewtonAVBDManager"
    """What Isaac Lab makes the solver with."""

    solver_type: str = "avbd"
    """Name in logs."""

    iterations: int | None = None
    """Most sweeps over the bodies in each step."""

    tolerance: float | None = None
    """Sweeps end when they move no body by more than this [m]."""

    compliant_contacts: bool | None = None
    """Whether contacts give way by the shapes' stiffness and damping."""

    friction_mix_mode: Literal["geometric_average", "average", "multiply", "min", "max"] | None = (
        None
    )
    """How the friction of two shapes becomes that of their contact."""

    angular_friction: bool | None = None
    """Whether contacts resist twisting and rolling."""

    scheme: Literal["euler", "generalized_alpha", "runge_kutta"] | None = None
    """Time integration."""

    parallel: Literal["worlds", "bodies"] | None = None
    """What the threads of a device share."""

    update_joint_state: bool = True
    """Whether steps write joint coordinates: Isaac Lab reads its observations from them."""
