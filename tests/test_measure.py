# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Measures of a state agree with what can be worked out by hand."""

import newton
import numpy as np
import pytest
import warp as wp

from newton_avbd.measure import state as measure

# The model holds float32; a few roundings lie between it and a measure.
ROUNDING = 1.0e-6


def model_with(add: str, height: float, **size: float) -> newton.Model:
    """A body of density 1000 kg/m^3 at ``height`` above the ground, turned a quarter about x."""
    builder = newton.ModelBuilder()
    builder.default_shape_cfg.density = 1000.0
    quarter = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), 0.5 * np.pi)
    body = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, height), quarter))
    getattr(builder, f"add_shape_{add}")(body, **size)
    builder.add_ground_plane()
    return builder.finalize(device="cpu")


def test_penetration_of_a_box_is_its_depth_in_the_ground():
    model = model_with("box", height=0.299, hx=0.5, hy=0.3, hz=0.1)
    gaps = measure.Probe(model).separations(model.state())
    assert measure.deepest_penetration(gaps) == pytest.approx(1.0e-3, abs=ROUNDING)


def test_penetration_of_a_sphere_counts_its_radius():
    model = model_with("sphere", height=0.248, radius=0.25)
    gaps = measure.Probe(model).separations(model.state())
    assert measure.deepest_penetration(gaps) == pytest.approx(2.0e-3, abs=ROUNDING)


def test_shapes_apart_do_not_penetrate():
    model = model_with("sphere", height=0.26, radius=0.25)
    gaps = measure.Probe(model).separations(model.state())
    assert gaps == pytest.approx([0.01], abs=ROUNDING)
    assert measure.deepest_penetration(gaps) == 0.0


def test_contacts_between_bodies_that_nothing_moves_are_left_out():
    model = model_with("sphere", height=0.2, radius=0.25)
    model.body_flags.fill_(int(newton.BodyFlags.KINEMATIC))
    assert measure.Probe(model).separations(model.state()).size == 0


def test_energy_is_that_of_fall_and_spin():
    model = model_with("box", height=2.0, hx=0.5, hy=0.3, hz=0.1)
    state = model.state()
    # About the world's y axis, the body's -z axis after the quarter turn.
    state.body_qd.assign([[3.0, 0.0, -4.0, 0.0, 2.0, 0.0]])
    mass = 1000.0 * 8.0 * 0.5 * 0.3 * 0.1
    inertia = mass / 3.0 * (0.5**2 + 0.3**2)
    expected = 0.5 * mass * 25.0 + 0.5 * inertia * 4.0 + mass * 9.81 * 2.0
    probe = measure.Probe(model)
    assert probe.energy(state) == pytest.approx(expected, rel=ROUNDING)
    assert probe.speed(state) == pytest.approx(5.0, rel=ROUNDING)


def test_distance_is_between_centers_of_mass():
    builder = newton.ModelBuilder()
    body = builder.add_body(mass=1.0, com=wp.vec3(1.0, 0.0, 0.0), inertia=wp.mat33(np.eye(3)))
    assert body == 0
    bodies = measure.Bodies.of(builder.finalize(device="cpu"))
    still = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    half_turn = np.array([[2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
    # Turned half about z at its center of mass: the origin moves, the center does not.
    assert measure.distances(bodies, still, half_turn) == pytest.approx([0.0], abs=ROUNDING)
    moved = still.copy()
    moved[0, :3] = [0.0, 3.0, 4.0]
    assert measure.distances(bodies, still, moved) == pytest.approx([5.0])


def test_a_state_that_is_not_finite_does_not_look_good():
    model = model_with("sphere", height=1.0, radius=0.25)
    state = model.state()
    state.body_qd.assign([[np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]])
    assert np.isnan(measure.Probe(model).speed(state))
