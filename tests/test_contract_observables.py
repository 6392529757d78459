# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Observables ``contact_f`` and ``body_qdd``: signs, frames, rows, and the deprecated ways."""

import newton
import numpy as np
import pytest
import warp as wp
from contract import contact_count, pile, resting_box, worlds
from helpers import IDENTITY, NO_GRAVITY, G, Simulation, add_box, add_ground, add_mass, add_sphere
from newton.solvers import SolverBase
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0
CONTACT_F = SolverBase.ObservableKind.CONTACT_F
BODY_QDD = SolverBase.ObservableKind.BODY_QDD


def contact_bodies(simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Bodies of shape 0 and shape 1 of each live contact, -1 for static shapes."""
    count = contact_count(simulation.contacts)
    owner = simulation.model.shape_body.numpy()
    return tuple(
        owner[getattr(simulation.contacts, f"rigid_contact_shape{side}").numpy()[:count]]
        for side in "01"
    )


def contact_points(simulation: Simulation, pose: np.ndarray) -> np.ndarray:
    """Midpoints between the two surfaces of each live contact [m], world frame, at ``pose``."""
    count = contact_count(simulation.contacts)
    pose = np.vstack([pose, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    ends = []
    for side, body in zip("01", contact_bodies(simulation), strict=True):
        local = getattr(simulation.contacts, f"rigid_contact_point{side}").numpy()[:count]
        offset = getattr(simulation.contacts, f"rigid_contact_offset{side}").numpy()[:count]
        turn = Rotation.from_quat(pose[body, 3:])
        ends.append(pose[body, :3] + turn.apply(local + offset))
    return 0.5 * (ends[0] + ends[1])


@pytest.mark.parametrize("world_count", [1, 3])
def test_contact_forces_are_those_that_move_the_bodies(world_count: int) -> None:
    """Row by row: forces on body 0 (minus that on body 1), torques about the COM of body 0.

    For each body, the sum over its rows must be its momentum's change beyond gravity, linear and
    angular (cubes and balls: no gyroscopic part). The scene has all kinds of pairs, static and
    mobile, in either order, and an impact. Forces move bodies exactly only when the sweeps have
    converged, hence up to 1,000 of them (an impact takes 400). Bound: 0.1 % of the largest load,
    m g of the three cubes.
    """
    simulation = Simulation(worlds(pile(), world_count), iterations=1000)
    observables = simulation.observe(CONTACT_F)
    simulation.step(50)
    for _ in range(5):
        pose, before, com = simulation.pose, simulation.velocity, simulation.center
        inertia = simulation.world_inertia
        simulation.step()
        rows = observables.contact_f.numpy().astype(float)
        count = contact_count(simulation.contacts)
        assert not np.any(rows[count:]), "unused rows are zero"
        body0, body1 = contact_bodies(simulation)
        point = contact_points(simulation, pose)
        total = np.zeros((simulation.model.body_count, 6))
        for row, a, b, x in zip(rows, body0, body1, point, strict=False):
            origin = com[a] if a >= 0 else np.zeros(3)
            force, torque = row[:3], row[3:]
            # one force acts at one point: its torque is that of the force at the contact, where
            # that is in the step
            moved = DT * max(
                np.linalg.norm(before[c, 3:]) * np.linalg.norm(x - com[c]) for c in (a, b) if c >= 0
            )
            np.testing.assert_allclose(
                torque,
                np.cross(x - origin, force),
                atol=1e-4 + (1e-4 + 0.5 * moved) * np.linalg.norm(force),
            )
            if a >= 0:
                total[a] += row
            if b >= 0:
                total[b] -= np.concatenate([force, torque + np.cross(origin - com[b], force)])
        change = (simulation.velocity - before) / DT
        linear = simulation.mass[:, None] * (change[:, :3] + [0.0, 0.0, G])
        angular = np.einsum("nij,nj->ni", inertia, change[:, 3:])
        scale = 3 * 125.0 * G
        np.testing.assert_allclose(total[:, :3], linear, atol=1e-3 * scale)
        np.testing.assert_allclose(total[:, 3:], angular, atol=1e-3 * scale * 0.25)


def test_a_static_shape_feels_the_weight_about_the_world_origin() -> None:
    """The ground is shape 0: a box at x = 2 m pushes it down, with torque (0, 2 m m g, 0).

    Newton's convention for static shapes. Bound: 1e-3 of the weight for a resting body.
    """
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (2.0, 0.0, 0.25))
    simulation = Simulation(builder)
    observables = simulation.observe(CONTACT_F)
    simulation.step(60)
    body0, _body1 = contact_bodies(simulation)
    rows = observables.contact_f.numpy()[: len(body0)]
    sign = np.where(body0 < 0, 1.0, -1.0)[:, None]
    total = (sign * rows).sum(axis=0)
    weight = simulation.mass[0] * G
    assert np.all(body0 < 0), "the pipeline puts the ground first; the test relies on it"
    np.testing.assert_allclose(total, [0, 0, -weight, 0, 2.0 * weight, 0], atol=1e-3 * 2.0 * weight)


def test_forces_on_a_kinematic_body_are_reported() -> None:
    """What a prescribed body carries is in the rows though nothing moves it."""
    builder = newton.ModelBuilder()
    plate = builder.add_body(
        xform=wp.transform(wp.vec3(0.0, 0.0, 1.0), IDENTITY),
        mass=1.0,
        inertia=wp.mat33(np.eye(3)),
        is_kinematic=True,
    )
    builder.add_shape_box(plate, hx=1.0, hy=1.0, hz=0.1)
    box = add_box(builder, (0.3, 0.0, 1.35))
    simulation = Simulation(builder)
    observables = simulation.observe(CONTACT_F)
    simulation.step(60)
    body0, _ = contact_bodies(simulation)
    sign = np.where(body0 == plate, 1.0, -1.0)
    on_plate = sign @ observables.contact_f.numpy()[: len(body0), 2]
    assert on_plate == pytest.approx(-simulation.mass[box] * G, rel=1e-3)


def test_the_acceleration_is_g_in_free_fall_and_zero_at_rest() -> None:
    """Coordinate acceleration, gravity included; of the COM, and angular, in world axes.

    A velocity that is rounded at 7 m/s (5e-7) and divided by h gives 1e-4 m/s^2.
    """
    builder = resting_box()
    add_mass(builder, com=(0.3, 0.0, 0.0), position=(5.0, 0.0, 100.0))
    simulation = Simulation(builder)
    simulation.set_velocity(1, angular=(0.0, 0.0, 2.0))
    observables = simulation.observe(BODY_QDD)
    simulation.step(60)
    acceleration = observables.body_qdd.numpy()
    np.testing.assert_allclose(acceleration[0], 0.0, atol=1e-3)
    np.testing.assert_allclose(acceleration[1], [0, 0, -G, 0, 0, 0], atol=1e-3)


def test_the_acceleration_of_a_step_in_place_is_the_same() -> None:
    """The velocity at the start is kept aside though the step overwrites it."""
    model = resting_box().finalize(device="cpu")
    solver, state = SolverAVBD(model), model.state()
    observables = solver.observables({BODY_QDD})
    solver.step(state, state, None, None, DT, observables=observables)
    np.testing.assert_allclose(observables.body_qdd.numpy()[0, 2], -G, rtol=1e-6)


def test_a_prescribed_body_has_no_acceleration() -> None:
    """Its velocity passes through, so the difference over the step is zero."""
    builder = newton.ModelBuilder()
    builder.add_body(mass=1.0, inertia=wp.mat33(np.eye(3)), is_kinematic=True)
    simulation = Simulation(builder, collide=False)
    simulation.set_velocity(0, (1.0, 2.0, 3.0))
    observables = simulation.observe(BODY_QDD)
    simulation.step()
    assert not np.any(observables.body_qdd.numpy())


def test_observables_can_be_selected_and_asked_for_together() -> None:
    """``select`` shares arrays; what is not selected is None and left alone in a step."""
    simulation = Simulation(resting_box())
    both = simulation.observe(CONTACT_F, BODY_QDD)
    one = both.select({BODY_QDD})
    assert one.body_qdd is both.body_qdd and one.contact_f is None
    simulation.step(30)
    kept = both.contact_f.numpy()
    assert np.any(kept)
    simulation.observables = one
    simulation.step()
    np.testing.assert_array_equal(both.contact_f.numpy(), kept)


def test_forces_fit_a_buffer_that_is_larger_than_the_steps() -> None:
    """Observables for the largest of several buffers serve the smaller ones; rows stay aligned."""
    simulation = Simulation(resting_box())
    large = newton.CollisionPipeline(
        simulation.model, rigid_contact_max=4096, publish_capacity=False
    ).contacts()
    observables = simulation.solver.observables({CONTACT_F}, contacts=large)
    simulation.observables = observables
    simulation.step(40)
    rows = observables.contact_f.numpy()
    assert rows.shape[0] >= 4096
    assert abs(rows[:4, 2].sum()) == pytest.approx(simulation.mass[0] * G, rel=1e-3)
    assert not np.any(rows[4:])


def test_observables_that_are_not_supported_or_not_sized_are_errors() -> None:
    """Newton's messages: the kind by name, the missing contacts, the buffer that is too small."""
    simulation = Simulation(resting_box())
    solver, state = simulation.solver, simulation.state
    with pytest.raises(ValueError, match="'soil_moisture'"):
        solver.observables({"soil_moisture"}, contacts=simulation.contacts)
    with pytest.raises(ValueError, match="Pass Contacts"):
        solver.observables({CONTACT_F})
    small = newton.CollisionPipeline(
        simulation.model, rigid_contact_max=2, publish_capacity=False
    ).contacts()
    observables = solver.observables({CONTACT_F}, contacts=small)
    with pytest.raises(ValueError, match="allocate observables"):
        solver.step(state, state, None, simulation.contacts, DT, observables=observables)


def test_no_forces_are_left_from_an_earlier_step() -> None:
    """A body that left the ground pushes nothing: rows of a step are all of that step."""
    simulation = Simulation(resting_box())
    observables = simulation.observe(CONTACT_F)
    simulation.step(30)
    assert np.any(observables.contact_f.numpy())
    pose = simulation.state.body_q.numpy()
    pose[0, 2] = 5.0
    simulation.state.body_q.assign(pose)
    simulation.step()
    assert not np.any(observables.contact_f.numpy())


def test_a_held_world_reports_no_forces() -> None:
    """A world that came with NaN is not simulated: its rows are zero, not those of before."""
    simulation = Simulation(worlds(resting_box(), 2))
    observables = simulation.observe(CONTACT_F)
    simulation.step(30)
    simulation.set_velocity(1, (np.nan, 0.0, 0.0))
    simulation.step()
    body0, body1 = contact_bodies(simulation)
    rows = observables.contact_f.numpy()[: len(body0)]
    of_held = np.maximum(body0, body1) == 1
    assert np.any(of_held) and not np.any(rows[of_held])
    assert np.abs(rows[~of_held, 2].sum()) == pytest.approx(simulation.mass[0] * G, rel=1e-3)


@pytest.mark.filterwarnings("ignore:.*request_contact_attributes.*")
def test_update_contacts_writes_the_forces_of_the_last_step() -> None:
    """Newton's deprecated way gives what the observable gives, bit for bit."""
    model = resting_box().finalize(device="cpu")
    model.request_contact_attributes("force")
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    solver, state = SolverAVBD(model), model.state()
    observables = solver.observables({CONTACT_F}, contacts=contacts)
    for _ in range(10):
        pipeline.collide(state, contacts)
        solver.step(state, state, None, contacts, DT, observables=observables)
    solver.update_contacts(contacts, state)
    assert np.any(contacts.force.numpy())
    np.testing.assert_array_equal(contacts.force.numpy(), observables.contact_f.numpy())


def test_update_contacts_without_room_says_what_to_request() -> None:
    """The array is only there when it was asked for; the message names both ways."""
    simulation = Simulation(resting_box())
    simulation.step()
    with pytest.raises(ValueError, match=r"request_contact_attributes\('force'\).*contact_f"):
        simulation.solver.update_contacts(simulation.contacts, simulation.state)


@pytest.mark.filterwarnings("ignore:.*request_state_attributes.*")
def test_accelerations_requested_on_the_state_are_filled() -> None:
    """Newton's deprecated way: ``request_state_attributes``, with or without the observable."""
    builder = newton.ModelBuilder()
    add_mass(builder)
    model = builder.finalize(device="cpu")
    model.request_state_attributes("body_qdd")
    solver, state, out = SolverAVBD(model), model.state(), model.state()
    for observables in (None, solver.observables({BODY_QDD})):
        out.body_qdd.zero_()
        solver.step(state, out, None, None, DT, observables=observables)
        np.testing.assert_allclose(out.body_qdd.numpy()[0, 2], -G, rtol=1e-6)


def test_a_contact_sensor_reads_the_forces() -> None:
    """``SensorContact`` gives a ball's weight, within 1e-3, as the force of the ground on it."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    ball = add_sphere(builder, (0.0, 0.0, 0.25))
    builder.shape_label[builder.body_shapes[ball][0]] = "ball"
    simulation = Simulation(builder)
    sensor = newton.sensors.SensorContact(
        simulation.model, sensing_shapes="ball", request_contact_attributes=False
    )
    observables = simulation.observe(*sensor.solver_observable_kinds)
    simulation.step(60)
    sensor.update(simulation.state, simulation.contacts, observables=observables)
    force = sensor.total_force.numpy().reshape(-1, 3)[0]
    weight = simulation.mass[0] * G
    np.testing.assert_allclose(force, [0, 0, weight], atol=1e-3 * weight)


def test_an_inertial_sensor_reads_gravity_at_rest_and_nothing_in_free_fall() -> None:
    """``SensorIMU`` measures specific force: +g upwards on the ground, 0 while falling."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    for height in (0.25, 50.0):
        body = add_box(builder, (height, 0.0, height))
        builder.add_site(body, label=f"imu{height}")
    simulation = Simulation(builder)
    sensor = newton.sensors.SensorIMU(
        simulation.model, sites="imu*", request_state_attributes=False
    )
    observables = simulation.observe(*sensor.solver_observable_kinds)
    simulation.step(60)
    sensor.update(simulation.state, observables=observables)
    np.testing.assert_allclose(sensor.accelerometer.numpy(), [[0, 0, G], [0, 0, 0]], atol=1e-3)


def test_gravity_free_scenes_report_zero_forces() -> None:
    """Touching bodies that nothing presses together push with nothing."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.25))
    simulation = Simulation(builder)
    observables = simulation.observe(CONTACT_F)
    simulation.step(5)
    assert contact_count(simulation.contacts) == 4
    assert not np.any(observables.contact_f.numpy())
