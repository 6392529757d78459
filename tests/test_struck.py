# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A robot that hits the ground very fast, or lies very deep in it, stays in one piece."""

import newton
import numpy as np
import pytest
from helpers import EPS, Simulation
from joint_scenes import anchor_gaps
from scipy.spatial.transform import Rotation

from newton_avbd.scenes.robots import add_humanoid, add_quadruped_worlds

TILTS = Rotation.random(8, random_state=11)
"""How the robot comes down."""


def humanoid(tilt: Rotation, height: float, speed: float) -> Simulation:
    """The humanoid, turned about its torso, that at a height [m] above the ground, at a speed down
    [m/s]."""
    builder = newton.ModelBuilder()
    add_humanoid(builder)
    sim = Simulation(builder)
    pose, velocity = sim.pose, sim.velocity
    pose[:, :3] = tilt.apply(pose[:, :3] - pose[0, :3])
    pose[:, 2] += height
    pose[:, 3:] = (tilt * Rotation.from_quat(pose[:, 3:])).as_quat()
    velocity[:] = [0.0, 0.0, -speed, 0.0, 0.0, 0.0]
    sim.state.body_q.assign(pose.astype(np.float32))
    sim.state.body_qd.assign(velocity.astype(np.float32))
    return sim


def opening(sim: Simulation) -> float:
    """Largest distance between the anchors of a joint [m]; the first, FREE, has none."""
    return float(anchor_gaps(sim)[1:].max())


@pytest.mark.long
@pytest.mark.parametrize("speed", [50.0, 100.0])
def test_a_robot_that_hits_the_ground_stays_in_one_piece(speed: float) -> None:
    """From 1.3 m and eight tilts, half a second: it never has more energy than it came with.

    Of that the impact leaves less than a tenth. Joints stay within 5e-4 m: recovery leaves the
    square of what it turns.
    """
    for tilt in TILTS:
        sim = humanoid(tilt, 1.3, speed)
        before, widest = sim.energy, 0.0
        for _ in range(120):
            sim.step()
            assert sim.energy < (1.0 + 1.0e-5) * before
            widest = max(widest, opening(sim))
        assert sim.solver.status.held_steps.max() == 0
        assert sim.kinetic_energy < 0.1 * before
        assert widest < 5.0e-4


def test_a_robot_that_hits_the_ground_at_200_m_s_stays_finite() -> None:
    """Iterations that turn links by many radians once ended in what is not finite."""
    for tilt in TILTS:
        sim = humanoid(tilt, 1.3, 200.0)
        sim.step(24)
        assert sim.solver.status.held_steps.max() == 0
        assert opening(sim) < 5.0e-4


GAINED = [(1, 35), (2, 0), (2, 13), (2, 20), (2, 24), (4, 13), (4, 27), (6, 75)]
"""Seeds and numbers of throws that once gained energy at 200 m/s."""
PUSHED_OFF = (4, 13)
"""The one throw of 600 whose legs push it off the ground again, at 88 m/s."""


@pytest.mark.parametrize(("seed", "throw"), GAINED)
def test_a_robot_that_hits_the_ground_at_200_m_s_gains_no_energy(seed: int, throw: int) -> None:
    """Throws of hundreds that gained some: up to a half in the step of the impact, or, by links
    that turned by a revolution a step past their limits, 1e8 times in the hundred steps after it.

    Half a second later less than a tenth of it is left, unless legs push the robot off again.
    """
    tilt = Rotation.random(100, random_state=seed)[throw]
    sim = humanoid(tilt, 1.3, 200.0)
    before = sim.energy
    for _ in range(120):
        sim.step()
        assert sim.energy < (1.0 + 1.0e-5) * before
    assert sim.solver.status.held_steps.max() == 0
    assert sim.kinetic_energy < (0.2 if (seed, throw) == PUSHED_OFF else 0.1) * before


@pytest.mark.long
@pytest.mark.parametrize("speed", [0.0, 100.0])
@pytest.mark.parametrize("depth", [10.0, 1000.0])
def test_a_robot_far_below_the_ground_is_not_thrown(depth: float, speed: float) -> None:
    """Its links touch the ground where they are, not half way up, and come out by their own size.

    Nothing is faster than 5 m/s after any step, a fall from 1.3 m; joints stay within 1e-4 m, to
    the rounding of poses.
    """
    for tilt in TILTS:
        sim = humanoid(tilt, -depth, speed)
        for _ in range(60):
            sim.step()
            assert np.abs(sim.velocity[:, :3]).max() < 5.0
            assert opening(sim) < 1.0e-4 + 4.0 * EPS * depth
        assert sim.solver.status.held_steps.max() == 0
        assert sim.pose[:, 2].min() > -depth


def test_robots_that_land_on_stiff_legs_settle() -> None:
    """A foot has the penalty of its own mass, and drives put the whole quadruped behind it.

    Each sweep left 0.96 of what the force lacked, and one step in eight did not settle.
    """
    worlds, steps = 16, 60
    builder = newton.ModelBuilder()
    add_quadruped_worlds(builder, worlds)
    sim = Simulation(builder)
    sim.step(50)
    unsettled = 0
    for _ in range(steps):
        sim.step()
        unsettled += int(np.sum(~sim.solver.report().settled))
    assert unsettled <= 0.03 * worlds * steps
