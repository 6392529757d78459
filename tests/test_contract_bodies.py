# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies that are not moved, bodies whose mass is not where their origin is, and gravity."""

import newton
import numpy as np
import pytest
import warp as wp
from contract import snapshot
from helpers import IDENTITY, NO_GRAVITY, G, Simulation, add_box, add_ground, add_mass, surface
from newton import BodyFlags, ModelFlags
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0


def add_plate(
    builder: newton.ModelBuilder,
    position: tuple[float, float, float],
    *,
    half: tuple[float, float, float] = (2.0, 2.0, 0.1),
    mu: float = 0.5,
    mass: float = 5.0,
    kinematic: bool = True,
) -> int:
    """A box of given half sizes [m] that, if kinematic, moves as its velocity says."""
    body = builder.add_body(
        xform=wp.transform(wp.vec3(*position), IDENTITY),
        mass=mass,
        inertia=wp.mat33(np.eye(3)),
        is_kinematic=kinematic,
    )
    hx, hy, hz = half
    builder.add_shape_box(body, hx=hx, hy=hy, hz=hz, cfg=surface(mu=mu, density=0.0))
    return body


def drive(simulation: Simulation, body: int, velocity: tuple[float, float, float]) -> None:
    """Moves a kinematic body on by its velocity, as a user does between steps."""
    simulation.set_velocity(body, velocity)
    pose = simulation.state.body_q.numpy()
    pose[body, :3] += simulation.dt * np.asarray(velocity)
    simulation.state.body_q.assign(pose)


def set_flag(model: newton.Model, body: int, flag: BodyFlags) -> None:
    """Makes a body dynamic or kinematic."""
    flags = model.body_flags.numpy()
    flags[body] = int(flag)
    model.body_flags.assign(flags)


@pytest.mark.parametrize("collide", [False, True])
def test_a_kinematic_body_is_passed_through_and_feels_nothing(collide: bool) -> None:
    """Pose and velocity bit for bit, under gravity, body_f, joint_f, and a box on top of it."""
    builder = newton.ModelBuilder()
    plate = add_plate(builder, (0.0, 0.0, 1.0))
    add_box(builder, (0.0, 0.0, 1.35))
    simulation = Simulation(builder, collide=collide)
    simulation.set_velocity(plate, (0.3, -0.2, 0.1), (0.0, 0.0, 0.5))
    simulation.push(plate, (1e4, 0.0, 1e4), (0.0, 1e3, 0.0))
    simulation.control.joint_f.fill_(1e3)
    before = snapshot(simulation.state)[plate]
    simulation.step(3)
    np.testing.assert_array_equal(snapshot(simulation.state)[plate], before)


def shoved(mu: float) -> tuple[Simulation, int, int]:
    """A wall at 0.5 m/s that reaches a cube after 0.1 s, and shoves it for 0.9 s over a floor."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=mu)
    cube = add_box(builder, (0.0, 0.0, 0.25), mu=mu)
    wall = add_plate(builder, (-0.4, 0.0, 0.5), half=(0.1, 0.5, 0.3), mu=0.0)
    simulation = Simulation(builder)
    for _ in range(240):
        drive(simulation, wall, (0.5, 0.0, 0.0))
        simulation.step()
    return simulation, cube, wall


def test_a_kinematic_body_pushes_others() -> None:
    """A wall shoves a cube ahead of itself over a rough floor, at its own speed, touching it.

    The wall's pose is that of the start of the step, the cube's that of the end: v h further on.
    Bounds: rounding of the increments (about 1e-7 m over 1/240 s: 3e-5 m/s), and the slop that is
    left alone (0.05 g h^2, 9e-6 m).
    """
    simulation, cube, wall = shoved(mu=0.3)
    assert simulation.velocity[cube, 0] == pytest.approx(0.5, abs=1e-4)
    apart = simulation.pose[cube, 0] - simulation.pose[wall, 0]
    assert apart == pytest.approx(0.35 + 0.5 * DT, abs=2e-5)


def test_a_kinematic_body_does_not_kick_others() -> None:
    """On a smooth floor nothing holds the cube to the wall: it leaves at the wall's speed.

    No restitution is asked for, so 1 % of the impact speed is what may be left of it.
    """
    simulation, cube, _wall = shoved(mu=0.0)
    assert simulation.velocity[cube, 0] == pytest.approx(0.5, rel=0.01)


def test_a_conveyor_carries_by_friction() -> None:
    """The velocity of a kinematic body that stays where it is drags a cube along (a belt).

    Coulomb: the cube gains mu g until it moves with the belt; after 0.1 s at mu 0.5 it has
    0.4905 m/s, within one step's gain (2 %: the first steps settle the multipliers), and after
    0.5 s it has the belt's 1 m/s.
    """
    builder = newton.ModelBuilder()
    belt = add_plate(builder, (0.0, 0.0, 0.0))
    cube = add_box(builder, (-1.0, 0.0, 0.35))
    simulation = Simulation(builder)
    simulation.set_velocity(belt, (1.0, 0.0, 0.0))
    simulation.run(0.1)
    assert simulation.velocity[cube, 0] == pytest.approx(0.5 * G * 0.1, rel=0.02)
    simulation.run(0.4)
    np.testing.assert_allclose(simulation.velocity[cube], [1.0, 0, 0, 0, 0, 0], atol=1e-3)


def test_a_turntable_carries_by_friction() -> None:
    """The spin of a kinematic body drags too: a cube at its centre ends up turning with it."""
    builder = newton.ModelBuilder()
    table = add_plate(builder, (0.0, 0.0, 0.0))
    cube = add_box(builder, (0.0, 0.0, 0.35))
    simulation = Simulation(builder)
    for _ in range(240):
        simulation.set_velocity(table, angular=(0.0, 0.0, 1.0))
        simulation.step()
    np.testing.assert_allclose(simulation.velocity[cube], [0, 0, 0, 0, 0, 1.0], atol=1e-3)


@pytest.mark.parametrize("notify", [True, False])
def test_a_body_can_become_kinematic_and_dynamic_again(notify: bool) -> None:
    """Flags are read live; a box on the switched body stays, falls with it and stays again.

    Newton's own tests notify with BODY_PROPERTIES; leaving that out changes nothing here, since
    the body belongs to the same world either way.
    """
    builder = newton.ModelBuilder()
    plate = add_plate(builder, (0.0, 0.0, 5.0), half=(0.5, 0.5, 0.1))
    box = add_box(builder, (0.0, 0.0, 5.35))
    simulation = Simulation(builder)

    def switch(flag: BodyFlags) -> None:
        set_flag(simulation.model, plate, flag)
        if notify:
            simulation.solver.notify_model_changed(ModelFlags.BODY_PROPERTIES)

    simulation.step(30)
    np.testing.assert_allclose(simulation.velocity[:, 2], 0.0, atol=1e-4)
    switch(BodyFlags.DYNAMIC)
    simulation.step(24)
    # both fall freely now, together: v = g t; the box's last multiplier must not kick it
    np.testing.assert_allclose(simulation.velocity[:, 2], -G * 24 * DT, rtol=5e-3)
    simulation.set_velocity(plate)
    switch(BodyFlags.KINEMATIC)
    simulation.step(60)
    assert simulation.velocity[plate, 2] == 0.0
    assert simulation.velocity[box, 2] == pytest.approx(0.0, abs=1e-3)
    assert simulation.pose[box, 2] - simulation.pose[plate, 2] == pytest.approx(0.35, abs=1e-4)


def test_a_body_without_mass_does_not_move_and_carries() -> None:
    """Mass 0 is immovable, without gravity: pose and velocity pass through, boxes rest on it."""
    builder = newton.ModelBuilder()
    base = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, 1.0), IDENTITY), mass=0.0)
    builder.add_shape_box(base, hx=0.5, hy=0.5, hz=0.1, cfg=surface(density=0.0))
    box = add_box(builder, (0.0, 0.0, 1.35))
    simulation = Simulation(builder)
    simulation.push(base, (100.0, 0.0, 0.0))
    before = snapshot(simulation.state)[base]
    simulation.step(60)
    np.testing.assert_array_equal(snapshot(simulation.state)[base], before)
    assert simulation.pose[box, 2] == pytest.approx(1.35, abs=1e-5)


def test_an_offset_center_of_mass_falls_straight_and_spins_in_place() -> None:
    """The COM takes the parabola, and the origin turns about it by the spin w t.

    Backward Euler over n steps: z = z0 - g h^2 n (n + 1)/2. A sphere's inertia spins steadily.
    Bounds: n roundings of the pose (1e-7 m each) and of the turn.
    """
    builder = newton.ModelBuilder()
    com = (0.4, -0.3, 0.2)
    body = add_mass(builder, com=com, position=(1.0, 2.0, 50.0))
    simulation = Simulation(builder, collide=False, scheme="euler")
    simulation.set_velocity(body, angular=(0.0, 0.0, 3.0))
    start = simulation.center[0]
    simulation.step(60)
    drop = G * DT**2 * 60 * 61 / 2
    np.testing.assert_allclose(simulation.center[0], start - [0, 0, drop], atol=2e-4)
    turned = Rotation.from_rotvec([0.0, 0.0, 3.0 * 60 * DT])
    np.testing.assert_allclose(
        simulation.pose[0, :3], start - [0, 0, drop] - turned.apply(com), atol=2e-4
    )


def test_a_force_acts_at_the_center_of_mass() -> None:
    """``body_f`` is a force at the COM and a torque about it, in world axes, at any orientation."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5])
    inertia = np.array([[0.3, 0.05, -0.02], [0.05, 0.2, 0.03], [-0.02, 0.03, 0.25]])
    add_mass(
        builder, mass=2.0, inertia=inertia, com=(0.1, 0.2, -0.3), rotation=wp.quat(*turn.as_quat())
    )
    simulation = Simulation(builder, collide=False, dt=1e-3)
    force, torque = np.array([1.0, -2.0, 3.0]), np.array([0.3, 0.1, -0.2])
    simulation.push(0, force, torque)
    simulation.step()
    world = turn.as_matrix() @ inertia @ turn.as_matrix().T
    expected = np.concatenate([force / 2.0, np.linalg.solve(world, torque)]) * 1e-3
    # the spin is small enough for its gyroscopic part (w x I w, order 1e-9) to vanish
    np.testing.assert_allclose(simulation.velocity[0], expected, rtol=1e-5)


def test_an_offset_center_of_mass_topples_a_box_and_a_centered_one_stands() -> None:
    """The box of 0.5 m stands with its COM inside the base and falls over with it outside."""
    for offset, falls in ((0.2, False), (0.3, True)):
        builder = newton.ModelBuilder()
        add_ground(builder)
        body = builder.add_body(
            xform=wp.transform(wp.vec3(0.0, 0.0, 0.25), IDENTITY),
            mass=10.0,
            inertia=wp.mat33(0.4 * np.eye(3)),
            com=wp.vec3(offset, 0.0, 0.0),
        )
        builder.add_shape_box(body, hx=0.25, hy=0.25, hz=0.25, cfg=surface(density=0.0))
        simulation = Simulation(builder)
        simulation.run(0.5)
        tilt = Rotation.from_quat(simulation.pose[0, 3:]).magnitude()
        assert (tilt > 0.2) if falls else (tilt < 1e-4), f"offset {offset}: {tilt}"


def test_a_full_inertia_tensor_decides_how_a_hit_body_turns() -> None:
    """A body whose principal axes are not its own turns as R I R^T says, not as its diagonal.

    The same physical box, described in two body frames that differ by a rotation, must fall and
    bounce about the same way. Bound: rounding grows in the impacts, 1e-3 of the 0.4 m box after
    0.25 s; the diagonal alone would turn it by tenths of a radian otherwise.
    """
    turn = Rotation.from_rotvec([0.4, -0.7, 0.9])
    start = Rotation.from_rotvec([0.3, 0.2, 0.0])
    frames = []
    for frame in (Rotation.identity(), turn):
        builder = newton.ModelBuilder()
        add_ground(builder, gap=0.1)
        quaternion = wp.quat(*(start * frame).as_quat())
        size = np.array([0.4, 0.2, 0.1])
        moments = 8.0 / 12.0 * (np.sum(size**2) - size**2)
        axes = frame.inv().as_matrix()
        body = builder.add_body(
            xform=wp.transform(wp.vec3(0.0, 0.0, 0.3), quaternion),
            mass=8.0,
            inertia=wp.mat33((axes @ np.diag(moments) @ axes.T).ravel()),
        )
        local = wp.transform(wp.vec3(), wp.quat(*frame.inv().as_quat()))
        builder.add_shape_box(
            body, xform=local, hx=0.2, hy=0.1, hz=0.05, cfg=surface(density=0.0, gap=0.1)
        )
        simulation = Simulation(builder)
        simulation.run(0.25)
        attitude = Rotation.from_quat(simulation.pose[0, 3:]) * frame.inv()
        frames.append((simulation.pose[0, :3], attitude))
    (x0, r0), (x1, r1) = frames
    assert (r0 * start.inv()).magnitude() > 0.3, "the scene must make the box turn"
    np.testing.assert_allclose(x1, x0, atol=4e-4)
    assert (r0 * r1.inv()).magnitude() < 4e-3


def worlds_of_falling_bodies() -> newton.Model:
    """Two worlds of one body each, and a global body."""
    builder = newton.ModelBuilder()
    for _ in range(2):
        builder.begin_world()
        add_mass(builder)
        builder.end_world()
    add_mass(builder)
    return builder.finalize(device="cpu")


def test_gravity_is_each_worlds_own_and_can_change_at_run_time() -> None:
    """v = g h in each world, with a global body on the last entry, before and after a change."""
    model = worlds_of_falling_bodies()
    solver, state = SolverAVBD(model), model.state()
    model.set_gravity((0.0, 0.0, -1.0), world=0)
    model.set_gravity((0.0, 2.0, 0.0), world=1)
    model.set_gravity((3.0, 0.0, 0.0), world=-1)
    solver.notify_model_changed(ModelFlags.MODEL_PROPERTIES)
    solver.step(state, state, None, None, 0.1)
    np.testing.assert_allclose(
        state.body_qd.numpy()[:, :3], [[0, 0, -0.1], [0, 0.2, 0], [0.3, 0, 0]], atol=1e-7
    )
    model.set_gravity((0.0, 0.0, 0.0))
    state.body_qd.zero_()
    solver.step(state, state, None, None, 0.1)  # read live: no notification
    assert not np.any(state.body_qd.numpy())


def test_gravity_can_change_under_a_resting_box() -> None:
    """At twice the gravity the multiplier follows within a few steps and the box stays.

    Bound: a thousandth of what the extra g would let it fall in the 30 steps.
    """
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.25))
    simulation = Simulation(builder)
    simulation.step(30)
    simulation.model.set_gravity((0.0, 0.0, -2.0 * G))
    simulation.solver.notify_model_changed(ModelFlags.MODEL_PROPERTIES)
    simulation.step(30)
    assert simulation.pose[0, 2] == pytest.approx(0.25, abs=1e-3 * 0.5 * G * 0.125**2)


def global_scene(kind: str) -> tuple[Simulation, int]:
    """Two worlds with a cube each, side by side on one global plate; returns the plate's index."""
    builder = newton.ModelBuilder()
    if kind == "mobile":
        add_ground(builder)
    if kind == "static":
        builder.add_shape_box(
            -1,
            xform=wp.transform(wp.vec3(0.0, 0.0, 0.9), IDENTITY),
            hx=2.0,
            hy=2.0,
            hz=0.1,
            cfg=surface(density=0.0),
        )
        plate = -1
    else:
        height = 0.9 if kind == "kinematic" else 0.1
        plate = add_plate(builder, (0.0, 0.0, height), mass=50.0, kinematic=kind == "kinematic")
    top = 0.2 if kind == "mobile" else 1.0
    for x in (-0.5, 0.5):
        builder.begin_world()
        add_box(builder, (x, 0.0, top + 0.25))
        builder.end_world()
    return Simulation(builder), plate


@pytest.mark.parametrize("kind", ["static", "kinematic", "mobile"])
def test_a_global_body_carries_the_bodies_of_several_worlds(kind: str) -> None:
    """``body_world`` -1: static, prescribed, or moved by the solver together with all worlds.

    At rest after 60 steps, to a thousandth of the free fall in that time.
    """
    simulation, _plate = global_scene(kind)
    start = simulation.pose
    simulation.step(60)
    np.testing.assert_allclose(simulation.pose, start, atol=1e-3 * 0.5 * G * 0.25**2)


def test_a_mobile_global_body_feels_the_bodies_of_all_worlds() -> None:
    """The plate of 50 kg on ground without friction is dragged by two cubes of two worlds.

    Momentum: all three slide as one in the end, at m v / (sum of masses), within 1 %.
    """
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.0)
    plate = add_plate(builder, (0.0, 0.0, 0.1), mass=50.0, kinematic=False, mu=1.0)
    for x in (-0.5, 0.5):
        builder.begin_world()
        cube = add_box(builder, (x, 0.0, 0.45), density=200.0, mu=1.0)
        builder.body_qd[cube] = wp.spatial_vector(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        builder.end_world()
    # friction is sqrt(mu0 mu1): none against the ground, 1 between plate and cubes
    simulation = Simulation(builder)
    simulation.run(1.0)
    mass = simulation.mass
    together = (mass.sum() - mass[plate]) / mass.sum()
    np.testing.assert_allclose(simulation.velocity[:, 0], together, rtol=0.01)


def test_a_global_body_can_become_mobile_at_run_time() -> None:
    """Kinematic to dynamic, with a notification: the worlds are then solved together.

    Plate and cubes fall freely, v = g t, as one; the next switch stops the plate under them.
    """
    simulation, plate = global_scene("kinematic")
    simulation.step(10)
    set_flag(simulation.model, plate, BodyFlags.DYNAMIC)
    simulation.solver.notify_model_changed(ModelFlags.BODY_PROPERTIES)
    simulation.step(24)
    np.testing.assert_allclose(simulation.velocity[:, 2], -G * 24 * DT, rtol=5e-3)
    set_flag(simulation.model, plate, BodyFlags.KINEMATIC)
    simulation.set_velocity(plate)
    simulation.solver.notify_model_changed(ModelFlags.BODY_PROPERTIES)
    simulation.step(60)
    np.testing.assert_allclose(simulation.velocity[:, 2], 0.0, atol=1e-3)
