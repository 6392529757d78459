# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies that nothing touches follow the backward Euler solution of Newton's equations."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import EPS, NO_GRAVITY, Simulation, add_ground, add_mass, add_sphere, in_float32
from scipy.spatial.transform import Rotation

VELOCITY = np.array([3.0, -2.0, 7.0])
GRAVITY = np.array([0.0, 0.0, in_float32(-9.81)])


def backward_euler(x: np.ndarray, v: np.ndarray, a: np.ndarray, h: float, steps: int):
    """Position and velocity after ``steps`` steps of v += h a, x += h v, in double precision."""
    v_end = v + steps * h * a
    return x + steps * h * v + 0.5 * steps * (steps + 1) * h * h * a, v_end


def rounding(steps: int, *sizes: float) -> float:
    """Worst case of ``steps`` float32 roundings, each half a unit of the largest value."""
    return 0.5 * EPS * steps * max(sizes)


@pytest.mark.parametrize("with_shapes", [False, True])
def test_a_projectile_is_the_backward_euler_solution(with_shapes: bool) -> None:
    """The step is linear here, so only rounding is left.

    Per step the position takes one rounding (of x) and the velocity about four (of v, h v, h^2 g
    and the quotient by h); an error of the velocity acts on the position for the rest of the
    flight.
    """
    builder = newton.ModelBuilder()
    position = np.array([0.5, -0.25, 100.0])
    if with_shapes:
        add_ground(builder)
        add_sphere(builder, position)
    else:
        add_mass(builder, position=position)
    sim = Simulation(builder, collide=with_shapes, scheme="euler")
    sim.set_velocity(0, VELOCITY)
    steps = 480
    sim.step(steps)
    h = in_float32(sim.dt)
    x, v = backward_euler(position, VELOCITY, GRAVITY, h, steps)
    v_bound = 4.0 * rounding(steps, 20.0)
    assert np.abs(sim.velocity[0, :3] - v).max() < v_bound
    assert np.abs(sim.pose[0, :3] - x).max() < rounding(steps, 110.0) + v_bound * steps * h


def test_free_fall_converges_with_order_one() -> None:
    """Backward Euler is off by g t h / 2 against g t^2 / 2: half the step, half the error."""
    errors = []
    for dt in (1.0 / 60.0, 1.0 / 120.0):
        builder = newton.ModelBuilder()
        add_mass(builder)
        sim = Simulation(builder, dt=dt, collide=False, scheme="euler")
        sim.run(1.0)
        errors.append(sim.pose[0, 2] - 0.5 * GRAVITY[2])
    assert errors[0] == pytest.approx(0.5 * GRAVITY[2] / 60.0, rel=1.0e-3)
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=1.0e-3)


def test_a_body_turns_about_its_center_of_mass() -> None:
    """With the COM beside the origin of the body, the COM flies straight; the origin circles it.

    Bounds: as for the projectile, with one more rounding of the position for each turn of the
    COM offset; the angle sums float32 increments.
    """
    com = np.array([0.3, -0.2, 0.1])
    builder = newton.ModelBuilder()
    add_mass(builder, com=com)
    sim = Simulation(builder, collide=False, scheme="euler")
    sim.set_velocity(0, VELOCITY, (0.0, 0.0, 2.0))
    steps = 240
    sim.step(steps)
    h = in_float32(sim.dt)
    x, v = backward_euler(com, VELOCITY, GRAVITY, h, steps)
    v_bound = 4.0 * rounding(steps, 10.0)
    assert np.abs(sim.velocity[0, :3] - v).max() < v_bound
    assert np.abs(sim.center[0] - x).max() < 3.0 * rounding(steps, 4.0) + v_bound * steps * h
    turned = Rotation.from_quat(sim.pose[0, 3:]) * Rotation.from_rotvec([0, 0, -2.0 * steps * h])
    assert turned.magnitude() < 4.0 * rounding(steps, 1.0)
    assert sim.velocity[0, 3:] == pytest.approx([0.0, 0.0, 2.0], abs=4.0 * rounding(steps, 2.0))


@pytest.mark.parametrize("through", ["body_f", "joint_f"])
def test_force_and_torque_accelerate_by_mass_and_inertia(through: str) -> None:
    """A force gives f/m, a torque about a principal axis tau/I, whichever array they come in."""
    force, torque = np.array([4.0, -6.0, 8.0]), np.array([0.0, 0.05, 0.0])
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_mass(builder, mass=2.0, inertia=(0.2, 0.3, 0.4), com=(0.1, 0.2, 0.3))
    sim = Simulation(builder, collide=False, scheme="euler")
    if through == "body_f":
        sim.push(0, force, torque)
    else:
        sim.control.joint_f.assign([*force, *torque])
    start = sim.center[0]
    steps = 120
    sim.step(steps)
    h = in_float32(sim.dt)
    x, v = backward_euler(start, np.zeros(3), force / 2.0, h, steps)
    angle, spin = backward_euler(np.zeros(3), np.zeros(3), torque / 0.3, h, steps)
    v_bound = 4.0 * rounding(steps, 2.0)
    assert np.abs(sim.velocity[0, :3] - v).max() < v_bound
    assert np.abs(sim.center[0] - x).max() < 3.0 * rounding(steps, 1.0) + v_bound * steps * h
    assert np.abs(sim.velocity[0, 3:] - spin).max() < v_bound
    turned = Rotation.from_quat(sim.pose[0, 3:]) * Rotation.from_rotvec(-angle)
    assert turned.magnitude() < 4.0 * rounding(steps, 1.0) + v_bound * steps * h


def test_a_torque_acts_through_the_full_inertia_tensor() -> None:
    """From rest, the first step gives w = h I^-1 tau (rotated to the body's axes and back)."""
    tilt = Rotation.from_euler("xyz", [0.4, -0.9, 1.7])
    inertia = tilt.as_matrix() @ np.diag([0.1, 0.25, 0.3]) @ tilt.as_matrix().T
    turn = Rotation.from_euler("xyz", [-1.1, 0.3, 0.8])
    torque = np.array([0.2, -0.1, 0.3])
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_mass(builder, inertia=inertia, rotation=wp.quat(*turn.as_quat()))
    sim = Simulation(builder, collide=False)
    sim.push(0, torque=torque)
    sim.step()
    expected = in_float32(sim.dt) * turn.apply(np.linalg.solve(inertia, turn.inv().apply(torque)))
    # |w| h is 1e-4: what the gyroscopic torque adds in this step is smaller than rounding
    assert sim.velocity[0, 3:] == pytest.approx(expected, rel=2.0e-5)


def test_each_world_falls_in_its_own_gravity() -> None:
    """One step from rest gives v = h g, with each world's own g, set at any time."""
    builder = newton.ModelBuilder()
    pulls = [(0.0, 0.0, -9.81), (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)]
    for pull in pulls:
        builder.begin_world(gravity=pull)
        add_mass(builder)
        builder.end_world()
    sim = Simulation(builder, dt=0.01, collide=False)
    sim.step()
    assert sim.velocity[:, :3] == pytest.approx(0.01 * np.array(pulls), rel=1.0e-6)
    sim.model.set_gravity((0.0, 5.0, 0.0), world=2)
    sim.step()
    assert sim.velocity[2, :3] == pytest.approx([0.0, 0.05, 0.0], rel=1.0e-6)
    assert sim.velocity[1, :3] == pytest.approx(0.02 * np.array(pulls[1]), rel=1.0e-6)
