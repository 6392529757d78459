# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A jelly falls on the tray of a robot: the arm by SolverAVBD, the jelly by SolverVBD.

Newton's proxy coupler shows the links of the robot to SolverVBD and takes the forces on them back.
The arm gives way, swings and carries the jelly; at rest the drive of its shoulder must hold the
weight of all that it carries, to 2 %.

    python examples/soft_on_robot.py [--viewer gl] [--num-frames 240]
"""

import newton
import newton.examples
import numpy as np
import warp as wp
from newton.solvers import SolverVBD
from newton.solvers.experimental.coupled import SolverCoupled, SolverCoupledProxy

from newton_avbd import SolverAVBD

ARM = 0.5
THICK = 0.04
TRAY, TRAY_TOP = 0.2, 0.01
REACH = TRAY + THICK
SHOULDER = 0.7
RADIUS = 0.01
STIFFNESS, DAMPING = 800.0, 120.0
SUBSTEPS = 4


class Example:
    """What :func:`newton.examples.run` runs."""

    def __init__(self, viewer, args=None):
        self.viewer = viewer
        self.frame_dt = 1.0 / 60.0
        self.sim_time = 0.0
        builder = newton.ModelBuilder()
        builder.add_ground_plane()
        builder.add_shape_cylinder(
            -1, xform=wp.transform((0.0, 0.0, SHOULDER / 2 - THICK)), radius=0.08, half_height=0.33
        )
        self.add_robot(builder)
        self.add_jelly(builder, wp.vec3(2 * ARM * np.cos(0.6) + REACH, 0.0, SHOULDER + 0.2))
        builder.color()
        self.model = builder.finalize()
        self.model.soft_contact_ke = 1.0e4
        self.model.soft_contact_mu = 1.0
        newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, self.model)
        self.solver = self.couple()
        self.pipeline = newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()
        self.control = self.model.control()
        self.state_0, self.state_1 = self.model.state(), self.model.state()
        self.graph = None
        self.viewer.set_model(self.model)

    def add_robot(self, builder):
        """Shoulder, elbow and wrist, each with a drive that holds its angle."""
        joints = []
        parent, anchor = -1, wp.transform((0.0, 0.0, SHOULDER))
        for angle in (-0.6, 1.2):
            link = builder.add_link()
            builder.add_shape_capsule(
                link,
                xform=wp.transform((0.0, 0.0, 0.0), wp.quat_rpy(0.0, np.pi / 2, 0.0)),
                radius=THICK,
                half_height=ARM / 2,
            )
            joints.append(self.add_joint(builder, parent, link, anchor, ARM / 2, angle))
            parent, anchor = link, wp.transform((ARM / 2, 0.0, 0.0))
        tray = builder.add_link()
        builder.add_shape_box(tray, hx=TRAY, hy=TRAY, hz=TRAY_TOP)
        joints.append(self.add_joint(builder, parent, tray, anchor, REACH, -0.6))
        builder.add_articulation(joints)

    def add_joint(self, builder, parent, child, anchor, reach, angle):
        """A hinge about y, at a point of the parent and ``reach`` before the child's middle."""
        joint = builder.add_joint_revolute(
            parent,
            child,
            axis=(0.0, 1.0, 0.0),
            parent_xform=anchor,
            child_xform=wp.transform((-reach, 0.0, 0.0)),
            target_ke=STIFFNESS,
            target_kd=DAMPING,
        )
        builder.joint_q[-1] = builder.joint_target_q[-1] = angle
        return joint

    def add_jelly(self, builder, center):
        """A block of 0.2 m by 0.2 m by 0.15 m."""
        builder.add_soft_grid(
            pos=center - wp.vec3(0.1, 0.1, 0.0),
            rot=wp.quat_identity(),
            vel=wp.vec3(0.0, 0.0, 0.0),
            dim_x=4,
            dim_y=4,
            dim_z=3,
            cell_x=0.05,
            cell_y=0.05,
            cell_z=0.05,
            density=150.0,
            k_mu=4.0e3,
            k_lambda=4.0e3,
            k_damp=10.0,
            particle_radius=RADIUS,
        )

    def couple(self):
        """SolverAVBD moves the bodies, SolverVBD the particles; it sees the links as proxies."""
        bodies = range(self.model.body_count)
        return SolverCoupledProxy(
            self.model,
            entries=[
                SolverCoupled.Entry(
                    "robot",
                    lambda view: SolverAVBD(view, update_joint_state=True),
                    bodies=bodies,
                    joints=range(self.model.joint_count),
                ),
                SolverCoupled.Entry(
                    "jelly",
                    lambda view: SolverVBD(view, particle_enable_self_contact=False),
                    particles=range(self.model.particle_count),
                ),
            ],
            coupling=SolverCoupledProxy.Config(
                [SolverCoupledProxy.Proxy("robot", "jelly", bodies)],
            ),
        )

    def simulate(self):
        """One frame; an even number of steps ends in the state that it began with."""
        dt = self.frame_dt / SUBSTEPS
        for _ in range(SUBSTEPS):
            self.pipeline.collide(self.state_0, self.contacts)
            self.solver.step(self.state_0, self.state_1, self.control, self.contacts, dt)
            self.state_0, self.state_1 = self.state_1, self.state_0

    def step(self):
        if self.graph is None:
            # the first steps make room for contacts
            self.simulate()
            with wp.ScopedCapture() as capture:
                self.simulate()
            self.graph = capture.graph
        else:
            wp.capture_launch(self.graph)
        self.sim_time += self.frame_dt

    def render(self):
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state_0)
        self.viewer.end_frame()

    def drive_torque(self):
        """Torque of the shoulder's drive [N m]."""
        target = float(self.model.joint_target_q.numpy()[0])
        q, qd = float(self.state_0.joint_q.numpy()[0]), float(self.state_0.joint_qd.numpy()[0])
        return STIFFNESS * (target - q) - DAMPING * qd

    def carried_torque(self):
        """Moment of all weights about the shoulder [N m]."""
        bodies = self.model.body_mass.numpy() @ self.state_0.body_q.numpy()[:, 0]
        jelly = self.model.particle_mass.numpy() @ self.state_0.particle_q.numpy()[:, 0]
        return -9.81 * float(bodies + jelly)

    def test_final(self):
        """The jelly lies on the tray, and the shoulder carries it."""
        from_tray = wp.transform_inverse(wp.transform(*self.state_0.body_q.numpy()[-1]))
        jelly = self.state_0.particle_q.numpy()
        jelly = np.array([wp.transform_point(from_tray, wp.vec3(*point)) for point in jelly])
        drive, carried = self.drive_torque(), self.carried_torque()
        print(f"shoulder: drive {drive:.2f} N m, weights {carried:.2f} N m")
        print(f"jelly: {1e3 * (RADIUS + TRAY_TOP - jelly[:, 2].min()):.2f} mm deep in the tray")
        assert np.abs(jelly[:, :2]).max() < TRAY and jelly[:, 2].min() > 0.0, "the jelly fell off"
        assert abs(drive / carried - 1.0) < 0.02, "the drive does not hold the weight"


if __name__ == "__main__":
    viewer, args = newton.examples.init()
    newton.examples.run(Example(viewer, args), args)
