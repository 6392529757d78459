# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Contacts between two links of one robot, at 60 Hz, the step of most learning code."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import Simulation, surface
from joint_scenes import add_link

LENGTH, RADIUS, REACH = 0.3, 0.02, 0.5
SLOP = 5.0e-5
"""Penetration that is left alone at 60 Hz [m]."""


def two_arms(depth: float, friction: float, armature: float, rest: float) -> Simulation:
    """A base in free fall from which two arms hang, with a ball each; mirror images.

    The balls start ``depth`` [m] deep in each other, and springs lead the arms towards each other
    by ``rest`` [rad].
    """
    builder = newton.ModelBuilder()
    base = add_link(builder, mass=20.0, inertia=0.1 * np.eye(3))
    joints = [builder.add_joint_free(base)]
    for side in (-1.0, 1.0):
        arm = add_link(builder, mass=0.2, inertia=1.0e-4 * np.eye(3))
        builder.add_shape_sphere(arm, radius=RADIUS, cfg=surface(density=0.0))
        joints.append(
            builder.add_joint_revolute(
                base,
                arm,
                axis=(0.0, 1.0, 0.0),
                parent_xform=wp.transform(wp.vec3(side * (RADIUS - 0.5 * depth), 0.0, -0.1)),
                child_xform=wp.transform(wp.vec3(0.0, 0.0, LENGTH)),
                friction=friction,
                armature=armature,
                target_pos=side * rest,
                target_ke=1.0,
                actuator_mode=newton.JointTargetMode.POSITION,
            )
        )
    builder.add_articulation(joints)
    sim = Simulation(builder, dt=1.0 / 60.0)
    newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
    return sim


def depth_of(sim: Simulation) -> float:
    """How deep the balls are in each other [m]."""
    places = sim.pose[1:, :3]
    return float(2.0 * RADIUS - np.linalg.norm(places[1] - places[0]))


def test_a_robot_that_presses_its_arms_together_stays_its_mirror_image():
    """Both links feel the same force, however many sweeps it takes to find it."""
    sim = two_arms(-0.02, friction=1.0e-6, armature=1.0e-3, rest=REACH)
    for _ in range(60):
        sim.step()
        assert abs(sim.pose[1, 0] + sim.pose[2, 0]) < 1.0e-6
    assert abs(depth_of(sim)) < 2.0 * SLOP


@pytest.mark.parametrize(("friction", "armature"), [(1.0e-6, 1.0e-6), (5.0, 1.0e-6), (1.0e-6, 0.1)])
def test_half_of_the_depth_goes_in_each_step(friction: float, armature: float):
    """Whatever friction holds the joints with. What rotors put behind them takes more sweeps than
    there are to make it all of the half: a share of 0.18 in each of eight leaves a fifth of it."""
    sim = two_arms(2.0e-3, friction, armature, rest=0.0)
    depth = depth_of(sim)
    for _ in range(4):
        sim.step()
        assert depth_of(sim) - SLOP < 0.65 * (depth - SLOP)
        depth = depth_of(sim)
        # and the recovery leaves no velocity
        assert np.abs(sim.velocity[:, 3:]).max() < 1.0e-3
