# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A kinematic body moves at ``body_qd``; where that is zero, friction sees its written poses."""

import itertools

import newton
import numpy as np
import pytest
import warp as wp
from helpers import IDENTITY, NO_GRAVITY, G, Simulation, add_box, add_ground, add_sphere, surface
from newton import BodyFlags, ModelFlags
from scipy.spatial.transform import Rotation

DT = 1.0 / 240.0
EDGE = 0.2


def add_plate(
    builder: newton.ModelBuilder, mu: float = 0.5, half: float = 2.0, **more: float
) -> int:
    """A kinematic plate whose upper side is z = 0."""
    body = builder.add_body(
        xform=wp.transform(wp.vec3(0.0, 0.0, -0.1), IDENTITY),
        mass=1.0,
        inertia=wp.mat33(np.eye(3)),
        is_kinematic=True,
    )
    cfg = surface(mu=mu, density=0.0, **more)
    builder.add_shape_box(body, hx=half, hy=half, hz=0.1, cfg=cfg)
    return body


def put(sim: Simulation, body: int, position: object, turn: object = (0.0, 0.0, 0.0)) -> None:
    """Writes the pose of a body: position [m] and rotation vector [rad]."""
    pose = sim.state.body_q.numpy()
    pose[body] = [*position, *Rotation.from_rotvec(turn).as_quat()]
    sim.state.body_q.assign(pose)


def carried(at: object = (0.0, 0.0), mu: float = 0.5, **settings: object) -> tuple[Simulation, int]:
    """A cube at rest on a plate; both are known to be there."""
    builder = newton.ModelBuilder()
    plate = add_plate(builder, mu, ke=1.0e5, kd=1.0e3)
    add_box(builder, (*at, EDGE / 2), EDGE, mu=mu, ke=1.0e5, kd=1.0e3)
    sim = Simulation(builder, **settings)
    sim.step(10)
    return sim, plate


def drag(sim: Simulation, plate: int, seconds: float, speed: float = 1.0) -> None:
    """Writes the pose of a plate that moves along x [m/s]."""
    start = sim.pose[plate, 0]
    for i in range(round(seconds / DT)):
        put(sim, plate, (start + speed * (i + 1) * DT, 0.0, -0.1))
        sim.step()


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"parallel": "bodies"},
        {"scheme": "generalized_alpha"},
        {"compliant_contacts": True},
        {"sleeping": True},
        {"blocks": "body"},
    ],
    ids=str,
)
def test_a_plate_that_is_put_along_drags_what_lies_on_it(settings: dict) -> None:
    """Coulomb: the cube gains mu g until it moves along, as if the plate had its velocity.

    After 0.1 s at mu 0.5 0.4905 m/s, within a step's gain; after 0.5 s the plate's 1 m/s.
    """
    sim, plate = carried((-1.0, 0.0), **settings)
    drag(sim, plate, 0.1)
    assert sim.velocity[1, 0] == pytest.approx(0.5 * G * 0.1, abs=0.5 * G * DT)
    drag(sim, plate, 0.4)
    np.testing.assert_allclose(sim.velocity[1], [1.0, 0, 0, 0, 0, 0], atol=1.0e-3)
    # sliding it has lost v^2/(2 mu g) on the plate, and a step's motion to the first write
    lag = (sim.pose[plate, 0] - sim.pose[1, 0]) - 1.0
    assert lag == pytest.approx(1.0 / (2.0 * 0.5 * G), rel=0.03)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_turntable_that_is_put_turns_what_lies_on_it(scheme: str) -> None:
    """1 rad/s, 0.5 m off its axis, below mu g: the cube keeps its place on the table.

    It goes round by the table's angle and keeps its distance, as the chords of the steps do (their
    tangents would take it out by 1.4 mm): within what the friction that holds it creeps.
    """
    sim, plate = carried((0.5, 0.0), scheme=scheme)
    for i in range(480):
        t = (i + 1) * DT
        put(sim, plate, (0.0, 0.0, -0.1), (0.0, 0.0, 0.5 * t * t if t < 1.0 else t - 0.5))
        sim.step()
    x, y, _ = sim.pose[1, :3]
    assert np.hypot(x, y) == pytest.approx(0.5, abs=1.0e-4)
    assert np.arctan2(y, x) == pytest.approx(1.5, abs=5.0e-4)
    np.testing.assert_allclose(sim.velocity[1, 3:], [0.0, 0.0, 1.0], atol=2.0e-3)


def test_a_wheel_that_is_put_turns_a_ball_on_it_by_twist() -> None:
    """Torsional friction sees the turn, too: a ball on the axis of a plate gains mu_twist N/I.

    mu_twist 0.02 m: 5/2 0.02 g/r^2 = 49 rad/s^2 at r = 0.1 m, so 1 rad/s after 0.02 s.
    """
    builder = newton.ModelBuilder()
    plate = add_plate(builder, mu_torsional=0.02)
    add_sphere(builder, (0.0, 0.0, 0.1), 0.1, mu_torsional=0.02)
    sim = Simulation(builder, angular_friction=True)
    sim.step(10)
    for i in range(60):
        put(sim, plate, (0.0, 0.0, -0.1), (0.0, 0.0, (i + 1) * DT))
        sim.step()
        if i == 2:
            assert sim.velocity[1, 5] == pytest.approx(2.5 * 0.02 * G / 0.01 * 3 * DT, rel=0.05)
    assert sim.velocity[1, 5] == pytest.approx(1.0, abs=2.0e-3)


def test_a_velocity_is_not_counted_twice() -> None:
    """With its velocity the written pose changes nothing: as a belt that stays, bit for bit."""

    def velocities(moves: bool) -> np.ndarray:
        sim, plate = carried((-1.0, 0.0))
        found = []
        for i in range(60):
            sim.set_velocity(plate, (1.0 if i < 50 else 0.0, 0.0, 0.0))
            if moves:
                put(sim, plate, (min(i, 50) * DT, 0.0, -0.1))
            sim.step()
            found.append(sim.velocity[1, 0])
        return np.array(found)

    driven, belt = velocities(True), velocities(False)
    # contacts lie elsewhere on a plate that moves, which changes their rounding
    np.testing.assert_allclose(driven, belt, atol=1.0e-5)
    # the step in which it stops brakes already
    assert driven[50] < driven[49]


def test_a_plate_that_stops_brakes() -> None:
    """The cube moves along; the plate is not put elsewhere any more: it loses mu g."""
    sim, plate = carried((-1.0, 0.0))
    drag(sim, plate, 0.4)
    sim.step(24)
    assert sim.velocity[1, 0] == pytest.approx(1.0 - 0.5 * G * 0.1, abs=0.03)
    sim.run(0.3)
    assert abs(sim.velocity[1, 0]) < 1.0e-3


@pytest.mark.parametrize("forget", ["reset", "kinematic", "no contacts"])
def test_a_pose_after_a_gap_is_no_motion(forget: str) -> None:
    """After a reset, a time as a dynamic body, or steps without contacts nobody knows it moved."""
    sim, plate = carried()
    solver, contacts = sim.solver, sim.contacts
    start = sim.state.body_q.numpy()
    if forget == "reset":
        solver.reset(sim.state, flags=0)
    elif forget == "kinematic":
        flags = sim.model.body_flags
        for flag in (BodyFlags.DYNAMIC, BodyFlags.KINEMATIC):
            flags.assign([int(flag), int(BodyFlags.DYNAMIC)])
            solver.notify_model_changed(ModelFlags.BODY_PROPERTIES)
            if flag == BodyFlags.DYNAMIC:
                sim.step()
    else:
        solver.step(sim.state, sim._next, sim.control, None, DT)
    sim.contacts = contacts
    sim.state.body_q.assign(start)
    sim.state.body_qd.zero_()
    put(sim, plate, (0.01, 0.0, -0.1))
    sim.step()
    assert abs(sim.velocity[1, 0]) < 1.0e-5


def test_a_body_that_is_let_go_is_no_conveyor() -> None:
    """A gripper puts a cube on another one, 1 cm in the last step, and lets it go: both stay."""
    builder = newton.ModelBuilder()
    below = add_box(builder, (0.0, 0.0, EDGE / 2), EDGE)
    add_plate(builder)
    above = add_box(builder, (0.0, 0.0, 1.5 * EDGE), EDGE)
    builder.body_flags[above] = int(BodyFlags.KINEMATIC)
    sim = Simulation(builder)
    for x in (-0.02, -0.01, 0.0):
        put(sim, above, (x, 0.0, 1.5 * EDGE))
        sim.step()
    sim.state.body_qd.zero_()
    flags = sim.model.body_flags.numpy()
    flags[above] = int(BodyFlags.DYNAMIC)
    sim.model.body_flags.assign(flags)
    sim.solver.notify_model_changed(ModelFlags.BODY_PROPERTIES)
    start = sim.pose[[below, above], 0]
    sim.run(0.25)
    np.testing.assert_allclose(sim.pose[[below, above], 0], start, atol=1.0e-4)


def test_a_teleport_drags_for_one_step_at_most_at_the_cone() -> None:
    """Friction of one step is all that a jump of half a meter gives: mu g h, and takes back."""
    sim, plate = carried()
    put(sim, plate, (0.5, 0.0, -0.1))
    sim.step()
    assert 0.0 < sim.velocity[1, 0] <= 0.5 * G * DT * 1.01
    sim.step(10)
    assert abs(sim.velocity[1, 0]) < 1.0e-4


def test_normals_do_not_see_written_poses() -> None:
    """A plate that is put 1 mm up does not throw the cube: overlap goes without a velocity."""
    sim, plate = carried()
    put(sim, plate, (0.0, 0.0, -0.099))
    for _ in range(20):
        sim.step()
        assert abs(sim.velocity[1, 2]) < 1.0e-3
    assert sim.pose[1, 2] == pytest.approx(EDGE / 2 + 0.001, abs=2.0e-5)


def test_it_costs_nothing_where_no_body_is_put() -> None:
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.5))
    sim = Simulation(builder)
    assert not sim.solver.effects["put_bodies"].on
    assert sim.solver.effects["put_bodies"].bytes == 0
    smooth, _ = carried(mu=0.0)
    assert not smooth.solver.effects["put_bodies"].on
    rough, _ = carried()
    assert rough.solver.effects["put_bodies"].on
    left, _ = carried(effects={"put_bodies": False})
    assert not left.solver.effects["put_bodies"].on


def test_replayed_steps_see_it_as_eager_ones() -> None:
    """Poses that a graph writes, two steps a graph: the same to the bit."""

    @wp.kernel(enable_backward=False)
    def shift(body: int, dx: float, body_q: wp.array[wp.transform]):
        pose = body_q[body]
        to = wp.transform_get_translation(pose) + wp.vec3(dx, 0.0, 0.0)
        body_q[body] = wp.transform(to, wp.transform_get_rotation(pose))

    def moved(replay: bool) -> np.ndarray:
        sim, plate = carried((-1.0, 0.0))

        def two_steps() -> None:
            for _ in range(2):
                wp.launch(shift, 1, [plate, DT, sim.state.body_q], device="cpu")
                sim.step()

        if not replay:
            for _ in range(20):
                two_steps()
            return sim.velocity
        with wp.ScopedCapture(device="cpu") as capture:
            two_steps()
        for _ in range(20):
            wp.capture_launch(capture.graph)
        return sim.velocity

    np.testing.assert_array_equal(moved(True), moved(False))


def test_a_rope_is_drawn_over_a_wheel_by_the_capstan_formula() -> None:
    """A wheel that is put round under half a turn of rope, held at one end, pulled at the other.

    Each of n + 1 nodes carries mu of its load: the tension grows by
    ((1 + mu tan a)/(1 - mu tan a))^n, a = pi/2n, 2.582 at mu 0.3 and n = 12 (e^(mu pi) = 2.566).
    Nodes are balls of 2 mm at the ends of links of 131 mm, whose torque is worth 1.5 % of mu.
    """
    count, radius, ball, leg, mu, pull = 12, 0.5, 0.002, 0.13, 0.3, 10.0
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    wheel = builder.add_body(mass=1.0, inertia=wp.mat33(np.eye(3)), is_kinematic=True)
    cfg = surface(mu=mu, density=0.0)
    builder.add_shape_cylinder(wheel, radius=radius, half_height=0.2, cfg=cfg)
    angle = np.pi * np.arange(count + 1) / count
    nodes = (radius + ball) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    nodes = np.vstack([nodes[0] - [0.0, leg], nodes, nodes[-1] - [0.0, leg]])
    joints, parent, reach, links = [], -1, 0.0, []
    for start, end in itertools.pairwise(nodes):
        way = end - start
        rotation = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), float(np.arctan2(*way[::-1])))
        link = builder.add_link(
            xform=wp.transform(wp.vec3(*start, 0.0), rotation),
            com=wp.vec3(0.5 * float(np.linalg.norm(way)), 0.0, 0.0),
            mass=0.01,
            inertia=wp.mat33(1.0e-5 * np.eye(3)),
        )
        at = wp.vec3(*start, 0.0) if parent < 0 else wp.vec3(reach, 0.0, 0.0)
        joints.append(
            builder.add_joint_revolute(
                parent, link, axis=(0.0, 0.0, 1.0), parent_xform=wp.transform(at, IDENTITY)
            )
        )
        if parent >= 0:
            builder.add_shape_sphere(link, radius=ball, cfg=cfg)
        parent, reach = link, float(np.linalg.norm(way))
        links.append(link)
    builder.add_articulation(joints)
    sim = Simulation(builder, iterations=40)
    force = sim.observe("body_parent_f")
    sim.push(links[-1], (0.0, -pull, 0.0))
    tension = []
    for i in range(240):
        put(sim, wheel, (0.0, 0.0, 0.0), (0.0, 0.0, (i + 1) * DT))
        sim.push(links[-1], (0.0, -pull, 0.0))
        sim.step()
        tension.append(np.linalg.norm(force.body_parent_f.numpy()[links[0], :3]))
    expected = ((1.0 + mu * np.tan(np.pi / 24)) / (1.0 - mu * np.tan(np.pi / 24))) ** count
    assert np.mean(tension[120:]) / pull == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("rate", [60, 240])
def test_a_box_stays_where_it_stands_on_what_speeds_up(rate: int, turns: bool) -> None:
    """By 2 m/s^2 up to 1 m/s, less than mu g; about z by 2 rad/s^2, where the box is 0.5 m off it.

    A friction that saw v instead of the velocity of the end of the step would lose v h/2.
    """
    builder = newton.ModelBuilder()
    cfg = newton.ModelBuilder.ShapeConfig(mu=0.8)
    place = wp.transform((0.0, 0.0, -0.1), wp.quat_identity())
    platform = builder.add_body(xform=place, is_kinematic=True)
    builder.add_shape_box(platform, hx=2.0, hy=2.0, hz=0.1, cfg=cfg)
    box = builder.add_body(xform=wp.transform((0.5, 0.0, 0.1), wp.quat_identity()))
    builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1, cfg=cfg)
    sim = Simulation(builder, dt=1.0 / rate)
    way = 0.0
    for i in range(rate):
        speed = 2.0 * min((i + 1) / rate, 0.5)
        twist = (0.0, 0.0, 0.0, 0.0, 0.0, speed) if turns else (speed, 0.0, 0.0, 0.0, 0.0, 0.0)
        sim.set_velocity(platform, linear=twist[:3], angular=twist[3:])
        sim.step()
        way += speed / rate
        pose = sim.pose
        turn = (0.0, 0.0, np.sin(0.5 * way), np.cos(0.5 * way))
        pose[platform] = (0.0, 0.0, -0.1, *turn) if turns else (way, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0)
        sim.state.body_q.assign(pose.astype(np.float32))
        x, y, _ = sim.pose[box, :3]
        if turns:
            x, y = np.cos(way) * x + np.sin(way) * y, np.cos(way) * y - np.sin(way) * x
        else:
            x -= way
        assert np.hypot(x - 0.5, y) < 1.0 / rate**2
