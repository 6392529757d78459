# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The solvers that the benchmark sets side by side, each set up as its users would."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import newton
import numpy as np
from newton.solvers import SolverBase

from newton_avbd.scenes.named import Scene

ITERATIONS = 10
"""Iterations a step of the solvers that sweep over bodies or constraints."""

MJ_STEP = "mj_step"
"""Name of MuJoCo without Newton around it, which is no solver of Newton's."""

STEEL_ROWS = 2048
"""Rows that SolverSteel may use for contacts of free bodies, three a contact; its default of 512
lets the boxes of the pyramid fall through the ground."""

STEEL_ARTICULATION_ROWS = 192
"""Rows that SolverSteel may use for an articulation, against a default of 32."""


@dataclass(frozen=True)
class Peer:
    """How to set a solver up.

    Attributes:
        title: What a table calls it.
        make: Constructs it for a model.
        stiff: Whether it takes the contact stiffness :attr:`Scene.vbd_ke`; the others treat
            contacts as rigid or keep Newton's default.
        detects: Whether it detects collisions itself, in ``step``.
        captures: Whether its step can be captured in a graph on the CPU.
    """

    title: str
    make: Callable[[newton.Model], SolverBase]
    stiff: bool = False
    detects: bool = False
    captures: bool = True

    def model(self, scene: Scene) -> newton.Model:
        """Build ``scene`` on the CPU with the contact stiffness that suits this solver."""
        return scene.model(ke=scene.vbd_ke if self.stiff else None, device="cpu")


def _avbd(model: newton.Model) -> SolverBase:
    from newton_avbd import SolverAVBD

    return SolverAVBD(model, iterations=ITERATIONS)


def _mujoco_warp(model: newton.Model) -> SolverBase:
    # Told to use Newton's contacts it insists on some, also where nothing can collide.
    own_contacts = not model.shape_contact_pair_count
    return newton.solvers.SolverMuJoCo(model, use_mujoco_contacts=own_contacts)


def _steel(model: newton.Model) -> SolverBase:
    options: dict[str, Any] = {}
    if np.any(model.joint_type.numpy() != newton.JointType.FREE):
        # By default it ignores limits, and a robot that lies on the ground has more rows than fit.
        options = {
            "articulation_constraint_max": STEEL_ARTICULATION_ROWS,
            "enable_joint_limits": True,
            "joint_limit_activation_gap": 0.1,
        }
    return newton.solvers.SolverSteel(
        model, iterations=ITERATIONS, free_body_constraint_max=STEEL_ROWS, **options
    )


_vbd = partial(newton.solvers.SolverVBD, iterations=ITERATIONS)
_xpbd = partial(newton.solvers.SolverXPBD, iterations=ITERATIONS)
# The C backend cannot be given Newton's contacts: SolverMuJoCo refuses.
_mujoco = partial(newton.solvers.SolverMuJoCo, use_mujoco_cpu=True)


PEERS: dict[str, Peer] = {
    "avbd": Peer("SolverAVBD(10)", _avbd),
    "vbd": Peer("SolverVBD(10)", _vbd, stiff=True),
    "xpbd": Peer("SolverXPBD(10)", _xpbd),
    "mujoco": Peer("SolverMuJoCo C", _mujoco, detects=True, captures=False),
    "mujoco_warp": Peer("SolverMuJoCo Warp", _mujoco_warp),
    "steel": Peer("SolverSteel(10)", _steel),
    "kamino": Peer("SolverKamino", newton.solvers.SolverKamino),
    "semi_implicit": Peer("SolverSemiImplicit", newton.solvers.SolverSemiImplicit),
    "featherstone": Peer("SolverFeatherstone", newton.solvers.SolverFeatherstone),
}
"""Solvers of Newton by name, ours first, and at the end ours as it would be without haste."""
