# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Isaac Lab's Isaac-Velocity-Flat-UnitreeGo2 with SolverAVBD, as Newton-AVBD-Velocity-Flat-Go2."""

import gymnasium
from isaaclab.utils.configclass import configclass
from isaaclab_newton.physics import NewtonCfg
from isaaclab_tasks.core.velocity.config.go2.flat_env_cfg import UnitreeGo2FlatEnvCfg

from newton_avbd.isaaclab import AVBDSolverCfg


@configclass
class AVBDGo2FlatEnvCfg(UnitreeGo2FlatEnvCfg):
    """The task as it is, but for the solver."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.sim.physics = NewtonCfg(solver_cfg=AVBDSolverCfg())


gymnasium.register(
    id="Newton-AVBD-Velocity-Flat-Go2",
    entry_point="isaaclab.envs:ManagerBasedRLEnv",
    disable_env_checker=True,
    kwargs={
        "env_cfg_entry_point": f"{__name__}:AVBDGo2FlatEnvCfg",
        "rsl_rl_cfg_entry_point": "isaaclab_tasks.core.velocity.config.go2.agents.rsl_rl_ppo_cfg:"
        "UnitreeGo2FlatPPORunnerCfg",
        "default_agent": "rsl_rl",
    },
)
