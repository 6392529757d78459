# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Which material a contact has: how two shapes mix, what the contact itself says, and belts."""

import math

import newton
import numpy as np
import pytest
import warp as wp
from helpers import IDENTITY, G, Simulation, add_box, add_ground, add_sphere, surface


def sliding_box(mu_floor: float, mu_box: float, **settings: object) -> Simulation:
    """A flat box that slides along x at 2 m/s."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu_floor)
    add_box(builder, (0.0, 0.0, 0.05), (0.5, 0.5, 0.1), mu=mu_box)
    sim = Simulation(builder, **settings)
    sim.set_velocity(0, (2.0, 0.0, 0.0))
    return sim


@pytest.mark.parametrize(
    ("mode", "mu"),
    [
        ("geometric_average", 0.4),
        ("average", 0.5),
        ("multiply", 0.16),
        ("min", 0.2),
        ("max", 0.8),
    ],
)
def test_friction_mixes_as_asked(mode: str, mu: float) -> None:
    """0.2 against 0.8: a sliding box loses mu g, within 1 %."""
    sim = sliding_box(0.2, 0.8, friction_mix_mode=mode)
    sim.run(0.2)
    assert 2.0 - sim.velocity[0, 0] == pytest.approx(0.2 * mu * G, rel=0.01)


def test_friction_mixes_geometrically_by_default() -> None:
    assert sliding_box(0.2, 0.8).solver.effects.flags.friction_mix == "geometric_average"


def test_another_mix_is_an_error() -> None:
    with pytest.raises(ValueError, match="friction_mix_mode must be 'geometric_average'"):
        sliding_box(0.2, 0.8, friction_mix_mode="median")


class Giving:
    """A pipeline that gives its contacts materials of their own, as hydroelastic ones do."""

    def __init__(self, sim: Simulation, **values: float) -> None:
        self._collide = sim.pipeline.collide
        self._values = {"stiffness": 0.0, "damping": 0.0, "friction": 0.0} | values
        for name in self._values:
            array = wp.zeros(sim.contacts.rigid_contact_max, dtype=float, device="cpu")
            setattr(sim.contacts, f"rigid_contact_{name}", array)
        sim.pipeline = self

    def collide(self, state: newton.State, contacts: newton.Contacts) -> None:
        self._collide(state, contacts)
        for name, value in self._values.items():
            getattr(contacts, f"rigid_contact_{name}").fill_(value)


@pytest.mark.parametrize(("friction", "mu"), [(0.0, 0.4), (0.5, 0.2), (2.0, 0.8)])
def test_the_friction_of_a_contact_scales_the_materials(friction: float, mu: float) -> None:
    """sqrt(0.2 * 0.8) = 0.4 times it; 0 leaves the materials as they are."""
    sim = sliding_box(0.2, 0.8)
    Giving(sim, friction=friction)
    sim.run(0.2)
    assert 2.0 - sim.velocity[0, 0] == pytest.approx(0.2 * mu * G, rel=0.01)


@pytest.mark.parametrize(("stiffness", "expected"), [(0.0, 2.0e4), (5.0e4, 5.0e4)])
def test_the_stiffness_of_a_contact_replaces_the_materials(
    stiffness: float, expected: float
) -> None:
    """Of a compliant contact; 0 leaves the mean of the materials, 1e4 and 3e4 N/m. Sag m g/K."""
    builder = newton.ModelBuilder()
    add_ground(builder, ke=1.0e4, kd=2.0e3)
    add_sphere(builder, (0.0, 0.0, 0.25), ke=3.0e4, kd=2.0e3)
    sim = Simulation(builder, compliant_contacts=True)
    Giving(sim, stiffness=stiffness)
    sim.run(4.0)
    assert 0.25 - sim.pose[0, 2] == pytest.approx(sim.mass[0] * G / expected, rel=0.02)


@pytest.mark.parametrize(("damping", "expected"), [(0.0, 100.0), (400.0, 400.0)])
def test_the_damping_of_a_contact_replaces_the_materials(damping: float, expected: float) -> None:
    """Pressed into a soft floor, a sphere swings as m x'' + kd x' + ke x = 0 says, to 1 %.

    The decay over one period of exp(-kd t/(2 m)), with backward Euler's own, exp(-w^2 h t/2).
    """
    ke, dt = 1.0e4, 1.0e-3
    builder = newton.ModelBuilder()
    add_ground(builder, ke=ke, kd=100.0, gap=0.2)
    add_sphere(builder, (0.0, 0.0, 0.25), ke=ke, kd=100.0, gap=0.2)
    sim = Simulation(builder, dt=dt, compliant_contacts=True)
    Giving(sim, damping=damping)
    mass = sim.mass[0]
    sag = mass * G / ke
    depths = []
    rate, omega2 = expected / (2.0 * mass), ke / mass
    period = 2.0 * math.pi / math.sqrt(omega2 - rate**2)
    for _ in range(round(period / dt)):
        sim.step()
        depths.append(0.25 - sim.pose[0, 2])
    left = math.exp(-(rate + 0.5 * omega2 * dt) * 0.5 * period)
    assert max(depths) == pytest.approx(sag * (1.0 + left), rel=0.01)


# Belts: surfaces that move while their shapes stand still.


def box_on_belt(speed: float, mu: float, *, turned: bool = False) -> Simulation:
    """A flat box on a mesh whose surface runs along x, as Newton authors conveyors."""
    corners = np.array([[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0]], dtype=np.float32)
    belt = newton.Mesh(
        corners,
        np.array([0, 1, 2, 0, 2, 3], dtype=np.int32),
        compute_inertia=False,
        enable_surface_velocity=True,
    )
    turn = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), 0.5 * math.pi if turned else 0.0)
    builder = newton.ModelBuilder()
    builder.add_shape_mesh(-1, xform=wp.transform(wp.vec3(), turn), mesh=belt, cfg=surface(mu))
    add_box(builder, (0.0, 0.0, 0.05), (0.4, 0.4, 0.1), mu=mu)
    sim = Simulation(builder)
    belt.mesh.velocities.fill_(wp.vec3(speed, 0.0, 0.0))
    return sim


@pytest.mark.parametrize("mu", [0.2, 0.5])
@pytest.mark.parametrize("speed", [1.0, -0.5])
def test_a_belt_accelerates_a_box_by_mu_g_to_its_speed(speed: float, mu: float) -> None:
    """Within 2 %, then it stays at that speed within 1e-4 m/s; the way up is v^2/(2 mu g)."""
    sim = box_on_belt(speed, mu)
    time = abs(speed) / (mu * G)
    sim.run(0.5 * time)
    elapsed = round(0.5 * time / sim.dt) * sim.dt
    assert sim.velocity[0, 0] == pytest.approx(math.copysign(mu * G * elapsed, speed), rel=0.02)
    sim.run(0.5 * time + 0.1)
    assert sim.velocity[0] == pytest.approx([speed, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1.0e-4)
    start = sim.pose[0, 0]
    sim.run(0.5)
    ran = round(0.5 / sim.dt) * sim.dt
    assert sim.pose[0, 0] - start == pytest.approx(speed * ran, rel=1.0e-4)


def test_a_turned_belt_carries_along_its_own_axis() -> None:
    sim = box_on_belt(1.0, 0.5, turned=True)
    sim.run(0.5)
    assert sim.velocity[0, :3] == pytest.approx([0.0, 1.0, 0.0], abs=1.0e-4)


def test_the_force_of_a_belt_opposes_the_slip_and_then_vanishes() -> None:
    """mu m g on the box along the belt while it slips, within 1 %; nothing at belt speed."""
    mu, speed = 0.5, 1.0
    sim = box_on_belt(speed, mu)
    observed = sim.observe("contact_f")
    shape0 = sim.contacts.rigid_contact_shape0

    def force_on_box() -> np.ndarray:
        count = int(sim.contacts.rigid_contact_count.numpy()[0])
        sign = np.where(sim.model.shape_body.numpy()[shape0.numpy()[:count]] == 0, 1.0, -1.0)
        return (sign[:, None] * observed.contact_f.numpy()[:count, :3]).sum(axis=0)

    weight = sim.mass[0] * G
    sim.run(0.1)
    assert force_on_box() == pytest.approx([mu * weight, 0.0, weight], rel=0.01, abs=0.01 * weight)
    sim.run(0.5)
    assert force_on_box() == pytest.approx([0.0, 0.0, weight], rel=0.01, abs=1.0e-3 * weight)


def test_a_load_is_held_on_a_belt_by_a_stop() -> None:
    """A box held back against the belt by mu m g/2 stays with it; by 2 mu m g it slips back."""
    for share, carried in ((0.5, True), (2.0, False)):
        sim = box_on_belt(1.0, 0.5)
        sim.run(0.5)
        sim.push(0, (-share * 0.5 * sim.mass[0] * G, 0.0, 0.0))
        sim.run(0.2)
        expected = 1.0 if carried else 1.0 - 0.5 * G * 0.2
        assert sim.velocity[0, 0] == pytest.approx(expected, abs=0.01)


def test_a_sphere_rolls_backwards_on_a_belt() -> None:
    """It reaches 2/7 of the belt's speed and spins so that its foot moves with the belt."""
    builder = newton.ModelBuilder()
    add_ground(builder, 0.5)
    body = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, 0.25), IDENTITY))
    builder.add_shape_sphere(body, radius=0.25, cfg=surface(0.5))
    sim = Simulation(builder)
    # velocity of surface 1 against surface 0, the ground
    sim.contacts.rigid_contact_surface_velocity = wp.full(
        sim.contacts.rigid_contact_max, wp.vec3(-1.0, 0.0, 0.0), dtype=wp.vec3, device="cpu"
    )
    sim.run(0.5)
    assert sim.velocity[0, 0] == pytest.approx(2.0 / 7.0, rel=0.01)
    assert sim.velocity[0, 0] - 0.25 * sim.velocity[0, 4] == pytest.approx(1.0, rel=1.0e-3)
