# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A chain of 20 hinges swings with an end 10,000 times as heavy as a link.

An articulation is one block of the solver: its joints stay closed whatever hangs on it. The anchors
of the chain must not part by more than 10 um.

    python examples/heavy_chain.py [--viewer gl] [--num-frames 600]
"""

import newton
import newton.examples
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD

LINKS = 20
LENGTH = 0.2
HEAVIER = 1.0e4
SUBSTEPS = 4


class Example:
    """What :func:`newton.examples.run` runs."""

    def __init__(self, viewer, args=None):
        self.viewer = viewer
        self.frame_dt = 1.0 / 60.0
        self.sim_time = 0.0
        builder = newton.ModelBuilder()
        parent, joints = -1, []
        for i in range(LINKS):
            shape = newton.ModelBuilder.ShapeConfig(has_shape_collision=False)
            shape.density *= HEAVIER if i == LINKS - 1 else 1.0
            link = builder.add_link(xform=wp.transform(((i + 0.5) * LENGTH, 0.0, LINKS * LENGTH)))
            builder.add_shape_box(link, hx=LENGTH / 2, hy=0.05, hz=0.025, cfg=shape)
            anchor = (0.0, 0.0, LINKS * LENGTH) if parent < 0 else (LENGTH / 2, 0.0, 0.0)
            joints.append(
                builder.add_joint_revolute(
                    parent,
                    link,
                    axis=(0.0, 1.0, 0.0),
                    parent_xform=wp.transform(anchor),
                    child_xform=wp.transform((-LENGTH / 2, 0.0, 0.0)),
                )
            )
            parent = link
        builder.add_articulation(joints)
        self.model = builder.finalize()
        self.solver = SolverAVBD(self.model)
        self.state_0, self.state_1 = self.model.state(), self.model.state()
        self.viewer.set_model(self.model)

    def step(self):
        for _ in range(SUBSTEPS):
            dt = self.frame_dt / SUBSTEPS
            self.solver.step(self.state_0, self.state_1, None, None, dt)
            self.state_0, self.state_1 = self.state_1, self.state_0
        self.sim_time += self.frame_dt

    def render(self):
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state_0)
        self.viewer.end_frame()

    def test_post_step(self):
        """The chain is whole."""
        poses = [wp.transform(*pose) for pose in self.state_0.body_q.numpy()]
        ends = [wp.transform_point(pose, wp.vec3(LENGTH / 2, 0.0, 0.0)) for pose in poses[:-1]]
        starts = [wp.transform_point(pose, wp.vec3(-LENGTH / 2, 0.0, 0.0)) for pose in poses[1:]]
        apart = np.linalg.norm(np.array(ends) - np.array(starts), axis=1).max()
        assert apart < 1.0e-5, f"anchors part by {apart * 1e6:.1f} um"

    def test_final(self):
        """It swings and is whole."""
        self.test_post_step()
        assert np.isfinite(self.state_0.body_qd.numpy()).all()


if __name__ == "__main__":
    viewer, args = newton.examples.init()
    newton.examples.run(Example(viewer, args), args)
