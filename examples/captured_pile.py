# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A whole frame in one graph: collision detection and four steps of a pyramid, replayed.

Launching a kernel from Python costs more than a small scene's step. A captured graph launches the
frame's kernels at once, on the CPU as on a GPU. The pyramid must stand: no box sinks by 0.1 mm.

    python examples/captured_pile.py [--viewer gl] [--num-frames 240]
"""

import newton
import newton.examples
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD

ROWS = 10
EDGE = 0.8
SUBSTEPS = 4


class Example:
    """What :func:`newton.examples.run` runs."""

    def __init__(self, viewer, args=None):
        self.viewer = viewer
        self.frame_dt = 1.0 / 60.0
        self.sim_time = 0.0
        builder = newton.ModelBuilder()
        builder.add_ground_plane()
        for row in range(ROWS):
            for i in range(ROWS - row):
                x = (i - 0.5 * (ROWS - row - 1)) * 1.05 * EDGE
                body = builder.add_body(xform=wp.transform((x, 0.0, (row + 0.5) * EDGE)))
                builder.add_shape_box(body, hx=EDGE / 2, hy=EDGE / 2, hz=EDGE / 2)
        self.model = builder.finalize()
        self.pipeline = newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()
        self.solver = SolverAVBD(self.model)
        self.state_0, self.state_1 = self.model.state(), self.model.state()
        self.height = self.state_0.body_q.numpy()[:, 2].copy()
        self.viewer.set_model(self.model)
        with wp.ScopedCapture() as capture:
            self.simulate()
        self.graph = capture.graph

    def simulate(self):
        """One frame; an even number of steps ends in the state that it began with."""
        self.pipeline.collide(self.state_0, self.contacts)
        for _ in range(SUBSTEPS):
            dt = self.frame_dt / SUBSTEPS
            self.solver.step(self.state_0, self.state_1, None, self.contacts, dt)
            self.state_0, self.state_1 = self.state_1, self.state_0

    def step(self):
        wp.capture_launch(self.graph)
        self.sim_time += self.frame_dt

    def render(self):
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state_0)
        self.viewer.end_frame()

    def test_final(self):
        """The pyramid stands."""
        fallen = np.abs(self.state_0.body_q.numpy()[:, 2] - self.height).max()
        assert fallen < 1.0e-4, f"a box moved by {fallen * 1e3:.3f} mm"


if __name__ == "__main__":
    viewer, args = newton.examples.init()
    newton.examples.run(Example(viewer, args), args)
