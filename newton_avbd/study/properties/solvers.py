# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The solvers that properties are tried with."""

from typing import Any

SOLVERS: dict[str, tuple[str, dict[str, Any]]] = {
    "avbd": ("SolverAVBD", {}),
    "vbd": ("SolverVBD", {}),
    "xpbd": ("SolverXPBD", {"iterations": 10}),
    "mujoco": ("SolverMuJoCo", {"use_mujoco_cpu": True, "cone": "elliptic", "impratio": 10.0}),
    "kamino": ("SolverKamino", {}),
    "steel": ("SolverSteel", {"enable_joint_limits": True, "joint_limit_activation_gap": 0.1}),
}
"""Class and settings of each solver, ours first. Iterations are the solvers' own defaults, 10
sweeps of SolverAVBD and SolverVBD; SolverXPBD, whose default is 2, takes as many. MuJoCo has the
friction cone that is round and hard."""
