# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Isaac Lab's task Isaac-Cartpole-Direct with SolverAVBD, as Newton-AVBD-Cartpole-Direct."""

import gymnasium
from isaaclab.utils.configclass import configclass
from isaaclab_newton.physics import NewtonCfg
from isaaclab_tasks.core.cartpole.cartpole_direct_env_cfg import CartpoleEnvCfg

from newton_avbd.isaaclab import AVBDSolverCfg


@configclass
class AVBDCartpoleEnvCfg(CartpoleEnvCfg):
    """The task as it is, but for the solver."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.sim.physics = NewtonCfg(solver_cfg=AVBDSolverCfg())


gymnasium.register(
    id="Newton-AVBD-Cartpole-Direct",
    entry_point="isaaclab_tasks.core.cartpole.cartpole_direct_env:CartpoleEnv",
    disable_env_checker=True,
    kwargs={
        "env_cfg_entry_point": f"{__name__}:AVBDCartpoleEnvCfg",
        "rsl_rl_cfg_entry_point": "isaaclab_tasks.core.cartpole.agents.rsl_rl_ppo_cfg:"
        "CartpoleDirectPPORunnerCfg",
        "default_agent": "rsl_rl",
    },
)
