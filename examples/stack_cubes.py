# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A Franka robot stacks three cubes: Newton's ``ik_cube_stacking``, its solver swapped.

Newton's example builds the scene, plans with ``newton.ik`` and judges where the cubes end: each
within 20 mm of its place, 10 mm of its height and 5 degrees. Grasps, lifts and stacks need friction
that holds, a mimic finger, effort limits and MuJoCo's gravity compensation.

    pip install 'newton-avbd[scenes,view]' GitPython
    python examples/stack_cubes.py --viewer gl

The robot's description is downloaded from github.com/newton-physics/newton-assets at the first run,
and kept. Without a network, put the folder ``franka_emika_panda`` into a folder of your
own and name that: ``--assets FOLDER``. ``--solver mujoco`` runs the example as it is.
"""

from pathlib import Path
from unittest import mock

import newton
import newton.examples
import newton.utils
from newton.examples.ik.example_ik_cube_stacking import Example as CubeStacking
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD


class Swapped(SolverAVBD):
    """What a program that names SolverMuJoCo gets instead; the options are MuJoCo's own."""

    register_custom_attributes = SolverMuJoCo.register_custom_attributes

    def __init__(self, model, **options):
        super().__init__(model, update_joint_state=True)


class Example(CubeStacking):
    """What :func:`newton.examples.run` runs."""

    def __init__(self, viewer, args):
        solver = Swapped if args.solver == "avbd" else SolverMuJoCo
        assets = args.assets and (lambda name: Path(args.assets) / name)
        with (
            mock.patch.object(newton.solvers, "SolverMuJoCo", solver),
            mock.patch.object(
                newton.utils, "download_asset", assets or newton.utils.download_asset
            ),
        ):
            super().__init__(viewer, args)
        if hasattr(self.viewer, "set_camera"):
            self.viewer.set_camera(pos=(0.95, -1.15, 0.75), pitch=-25.0, yaw=140.0)

    def test_final(self):
        """Newton's own test at the end; before it, each cube is on the table or in the hand.

        The arm follows its targets.
        """
        joints, targets = (
            values.numpy().reshape(self.world_count, -1)[:, :7]
            for values in (self.state_0.joint_q, self.control.joint_target_q)
        )
        # kd/ke is 0.1 s: drives lag so far behind targets that move at 3 rad/s
        lag = abs(joints - targets).max()
        assert lag < 0.3, f"the arm does not follow: {lag:.3f} rad"
        if (self.task_idx.numpy() == self.task_counter - 1).all():
            super().test_final()
        bodies = self.state_0.body_q.numpy().reshape(self.world_count, -1, 7)
        heights = bodies[:, self.robot_body_count :, 2]
        resting = self.table_height + 0.5 * self.cube_size
        assert (heights > resting - 1.0e-3).all(), f"cubes sink: {heights.min():.4f} m"


if __name__ == "__main__":
    parser = CubeStacking.create_parser()
    parser.set_defaults(world_count=1, num_frames=2000)
    parser.add_argument("--solver", choices=("avbd", "mujoco"), default="avbd")
    parser.add_argument("--assets", metavar="FOLDER", help="has franka_emika_panda")
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
