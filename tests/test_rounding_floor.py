# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Single precision does not make results worse as steps get shorter: rounding is carried on."""

import math
from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, Array, G, Simulation, add_ground
from joint_scenes import WORLD, set_coordinates, simulate
from newton import TendonGuide as Guide
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD

LEFT_OUT = {"carried_rounding": False}
SECONDS = 3.0
FLOOR = 2.0e-5  # [m]
BODIES = {"rod": (0.5, (0.0835, 0.0835, 4.0e-4)), "ball": (1.0, (4.0e-3, 4.0e-3, 4.0e-3))}
"""From the hinge to the COM of 1 kg [m], and principal moments [kg m^2]: a rod of 1 m that hangs at
its end, with a gyroscopic torque, and a ball at 1 m without."""


def diagonal(moments: tuple[float, float, float]) -> wp.mat33:
    """An inertia tensor."""
    return wp.mat33(*np.diag(moments).ravel().tolist())


def add_pendulum(builder: newton.ModelBuilder, kind: str, start: float, *, welded: bool) -> None:
    """A body on a hinge about y at the origin; if ``welded`` half of it is another link."""
    arm, moments = BODIES[kind]
    child_xform = wp.transform(wp.vec3(0.0, 0.0, arm), wp.quat_identity())
    share = 0.5 if welded else 1.0
    inertia = diagonal(tuple(share * moment for moment in moments))
    body = builder.add_link(mass=share, inertia=inertia)
    joints = [builder.add_joint_revolute(WORLD, body, child_xform=child_xform, axis=(0, 1, 0))]
    if welded:
        joints.append(builder.add_joint_fixed(body, builder.add_link(mass=share, inertia=inertia)))
    builder.add_articulation(joints)
    set_coordinates(builder, joints[0], [start])


def pendulum(
    kind: str, start: float, rate: float, *, welded: bool = False, **how: Any
) -> Simulation:
    """A pendulum let go at an angle [rad], stepped so often a second."""
    builder = newton.ModelBuilder()
    add_pendulum(builder, kind, start, welded=welded)
    return simulate(builder, dt=1.0 / rate, collide=False, **how)


def replay(sim: Simulation, steps: int) -> None:
    """An even number of steps, the first of them eager and the others from a graph."""
    state, other = sim.state, sim.model.state()

    def twice() -> None:
        sim.solver.step(state, other, sim.control, sim.contacts, sim.dt)
        sim.solver.step(other, state, sim.control, sim.contacts, sim.dt)

    if sim.pipeline:
        sim.pipeline.collide(state, sim.contacts)
    twice()
    with wp.ScopedCapture(device="cpu") as capture:
        twice()
    for _ in range(steps // 2 - 1):
        wp.capture_launch(capture.graph)


def hinge_angle(sim: Simulation) -> float:
    """How far a pendulum has turned about y [rad], -pi to pi."""
    return 2.0 * math.atan2(sim.pose[0, 4], sim.pose[0, 6])


def swing(kind: str, start: float, seconds: float) -> Array:
    """Angle [rad] and rate [rad/s] of a pendulum, to eleven digits."""
    arm, moments = BODIES[kind]
    pull = G * arm / (float(np.float32(moments[1])) + arm * arm)
    found = solve_ivp(
        lambda _, y: [y[1], -pull * math.sin(y[0])],
        (0.0, seconds),
        [start, 0.0],
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
    )
    return found.y[:, -1]


def swing_error(sim: Simulation, kind: str, seconds: float = SECONDS) -> float:
    """How far the COM is from where it belongs after a time [m]; steps are as float32 has them."""
    arm = BODIES[kind][0]
    start = hinge_angle(sim)
    steps = round(seconds / sim.dt)
    replay(sim, steps)
    angle = swing(kind, start, steps * float(np.float32(sim.dt)))[0]
    belongs = -arm * np.array([math.sin(angle), 0.0, math.cos(angle)])
    return float(np.linalg.norm(sim.pose[0, :3] - belongs))


@pytest.mark.parametrize("kind", BODIES)
@pytest.mark.parametrize("start", [1.0, 2.8])
def test_a_pendulum_of_18000_steps_is_where_it_belongs(kind: str, start: float) -> None:
    """Bound 2e-5 m. The errors are 1e-7 to 1.1e-6 m, what the scheme leaves; without the effect
    6e-5 to 6e-4."""
    assert swing_error(pendulum(kind, start, 6000.0), kind) < 0.1 * FLOOR
    if kind == "rod":
        assert swing_error(pendulum(kind, start, 6000.0, effects=LEFT_OUT), kind) > FLOOR


def test_ten_times_as_many_steps_are_not_worse() -> None:
    assert swing_error(pendulum("rod", 2.8, 60000.0), "rod") < 0.1 * FLOOR


def test_welded_links_have_the_same_floor() -> None:
    """Another way through a step. (The links are halves that lie in each other.)"""
    assert swing_error(pendulum("rod", 1.0, 6000.0, welded=True), "rod") < FLOOR


@pytest.mark.parametrize("scene", ["contact", "cables", "accuracy"])
def test_where_rounding_is_not_carried(scene: str) -> None:
    """Contacts are off by more; cables, drag and inner steps have states of their own."""
    builder = newton.ModelBuilder()
    add_pendulum(builder, "rod", 1.0, welded=False)
    settings = {"accuracy": 1e-2} if scene == "accuracy" else {}
    if scene == "contact":
        add_ground(builder)
        builder.add_shape_sphere(0, radius=0.1)
    elif scene == "cables":
        builder.add_tendon([Guide(body=-1), Guide(body=0)])
    model = builder.finalize(device="cpu")
    assert not SolverAVBD(model, **settings).effects["carried_rounding"].on


def test_energy_does_not_drift() -> None:
    """60,000 steps from almost upright: within 1e-6 of the energy between there and the bottom."""
    sim = pendulum("rod", 2.8, 6000.0)
    arm, moments = BODIES["rod"]

    def energy() -> float:
        rate = sim.velocity[0, 4]
        return 0.5 * (moments[1] + arm**2) * rate**2 - G * arm * math.cos(hinge_angle(sim))

    before = energy()
    replay(sim, 60_000)
    assert energy() == pytest.approx(before, abs=1.0e-6 * 2.0 * G * arm)


def test_steps_of_a_millisecond_carry_nothing() -> None:
    """They are off by more than rounding, and pay nothing."""
    sims = [pendulum("rod", 1.0, 1000.0, effects=effects) for effects in ({}, LEFT_OUT)]
    for sim in sims:
        replay(sim, 500)
    kept = sims[0].solver.checkpoint()
    assert not np.any(kept["history.last"]["lost"])
    assert not np.any(kept["history.lost_turn"])
    assert np.allclose(sims[0].pose, sims[1].pose, atol=1.0e-5)


# Flight.


def flight(moments: tuple[float, float, float], rate: float, **how: Any) -> Simulation:
    """A body that is thrown up at 20 m/s, 100 m from the origin, and spins."""
    builder = newton.ModelBuilder()
    builder.add_body(
        mass=1.0,
        inertia=diagonal(moments),
        xform=wp.transform(wp.vec3(100.0, 0.0, 50.0), wp.quat_identity()),
    )
    sim = Simulation(builder, dt=1.0 / rate, collide=False, **how)
    sim.set_velocity(0, (1.5, 0.5, 20.0), (0.25, 3.0, 1.0))
    return sim


def flight_errors(sim: Simulation, moments: tuple[float, float, float]) -> tuple[float, float]:
    """How far a symmetric top is off after three seconds [m], and how far turned [rad].

    It turns about its axis as that goes round the angular momentum.
    """
    steps = round(SECONDS / sim.dt)
    spin = sim.velocity[0, 3:]
    replay(sim, steps)
    seconds = steps * float(np.float32(sim.dt))
    start, velocity = np.array([100.0, 0.0, 50.0]), np.array([1.5, 0.5, 20.0])
    fall = np.array([0.0, 0.0, 0.5 * G * seconds**2])
    across, along = (float(np.float32(moment)) for moment in moments[1:])
    momentum = np.array([across, across, along]) * spin
    turned = Rotation.from_rotvec(momentum / across * seconds)
    turned *= Rotation.from_rotvec([0.0, 0.0, (1.0 - along / across) * spin[2] * seconds])
    off = Rotation.from_quat(sim.pose[0, 3:]) * turned.inv()
    moved = sim.pose[0, :3] - (start + seconds * velocity - fall)
    return float(np.linalg.norm(moved)), float(off.magnitude())


@pytest.mark.parametrize("moments", [(0.1, 0.1, 0.1), (0.1, 0.1, 0.04)])
def test_a_thrown_body_keeps_to_its_parabola_and_its_spin(
    moments: tuple[float, float, float],
) -> None:
    """A position of 100 m rounds by 4e-6; the turn is off by what the scheme leaves, 2.5e-7.

    Without the effect it is 55 mm, and a top 15 mrad.
    """
    moved, turned = flight_errors(flight(moments, 6000.0), moments)
    assert moved < 1.0e-5
    assert turned < 2.0e-6
    worse = flight_errors(flight(moments, 6000.0, effects=LEFT_OUT), moments)
    assert worse[0] > 100.0 * moved
    assert worse[1] > 10.0 * turned


def test_what_a_user_writes_has_lost_nothing() -> None:
    """A body in flight goes on from a written state as that of a new solver does, to the bit."""
    moments = (0.1, 0.1, 0.04)
    sim, other = (flight(moments, 6000.0) for _ in range(2))
    replay(sim, 100)
    kept = sim.solver.checkpoint()["history.flights"]
    assert np.any(kept["lost"][0])
    assert np.any(kept["lost_shift"][0])
    sim.set_velocity(0, (1.0, 2.0, 3.0), (1.0, 0.0, 2.0))
    other.state.assign(sim.state)
    for each in (sim, other):
        each.step()
    assert np.array_equal(sim.pose, other.pose)
    assert np.array_equal(sim.velocity, other.velocity)


def test_a_pendulum_whose_state_is_written_has_lost_nothing() -> None:
    sim = pendulum("rod", 1.0, 6000.0)
    replay(sim, 100)
    assert np.any(sim.solver.checkpoint()["history.last"]["lost"][0])
    velocity = sim.state.body_qd.numpy()
    velocity[0, 4] += 1.0e-3
    sim.state.body_qd.assign(velocity)
    sim.step()
    assert not np.any(sim.solver.checkpoint()["history.last"]["lost"][0])


def test_a_reset_forgets_what_was_lost() -> None:
    """A body at rest that nothing pulls has moved by nothing: its state has the same bits."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    builder.add_body(mass=1.0, inertia=diagonal((0.1, 0.1, 0.1)))
    sim = Simulation(builder, dt=1.0 / 6000.0, collide=False)
    sim.step()
    sim.solver.reset(sim.state)
    kept = sim.solver.checkpoint()["history.flights"]
    assert not np.any(kept["pose"][0])


# What a step leaves to the next one.


@pytest.mark.parametrize("make", [pendulum, flight])
def test_a_checkpoint_goes_on_to_the_bit(make: Any) -> None:
    what = ("rod", 1.0) if make is pendulum else ((0.1, 0.1, 0.04),)
    sim = make(*what, 6000.0)
    replay(sim, 200)
    kept, pose, velocity = sim.solver.checkpoint(), sim.pose, sim.velocity
    found = []
    for _ in range(2):
        sim.state.body_q.assign(pose)
        sim.state.body_qd.assign(velocity)
        sim.solver.restore(kept)
        replay(sim, 200)
        found.append((sim.pose, sim.velocity))
    assert np.array_equal(found[0][0], found[1][0])
    assert np.array_equal(found[0][1], found[1][1])


@pytest.mark.parametrize("make", [pendulum, flight])
def test_a_graph_replays_the_same_bits(make: Any) -> None:
    what = ("rod", 1.0) if make is pendulum else ((0.1, 0.1, 0.04),)
    eager, replayed = (make(*what, 6000.0) for _ in range(2))
    for _ in range(300):
        eager.step()
    replay(replayed, 300)
    assert np.array_equal(eager.pose, replayed.pose)
    assert np.array_equal(eager.velocity, replayed.velocity)
