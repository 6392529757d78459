# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What each joint type holds and leaves free."""

from collections.abc import Callable

import mujoco
import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, G, Simulation, surface
from joint_scenes import (
    WORLD,
    add_link,
    anchor_frames,
    anchor_gaps,
    set_coordinates,
    simulate,
    transform,
)
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD

pytestmark = pytest.mark.usefixtures("shared_kernels")

Dof = newton.ModelBuilder.JointDofConfig
TURN_P = Rotation.from_euler("xyz", [0.5, -0.8, 1.9])
TURN_C = Rotation.from_euler("xyz", [-2.0, 0.4, 0.9])
AXIS = (0.6, 0.3, -0.7)
XYZ = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]


def two_links(add: Callable[..., int], q: tuple = (), qd: tuple = ()) -> Simulation:
    """Two links in a row, both joined by ``add(builder, parent, child, **frames)``."""
    builder = newton.ModelBuilder()
    parent, joints = WORLD, []
    for at in ((0.3, -0.2, 1.0), (0.4, 0.1, 0.0)):
        body = add_link(builder, com=(0.02, 0.03, -0.05))
        frames = {
            "parent_xform": transform(at, TURN_P),
            "child_xform": transform((-0.3, 0.1, 0.05), TURN_C),
        }
        joints.append(add(builder, parent, body, **frames))
        parent = body
    builder.add_articulation(joints)
    for joint in joints:
        set_coordinates(builder, joint, q, qd)
    return simulate(builder)


SAME = {
    "fixed": (
        lambda b, p, c, **f: b.add_joint_fixed(p, c, **f),
        lambda b, p, c, **f: b.add_joint_d6(p, c, **f),
        ((), ()),
        ((), ()),
    ),
    "revolute": (
        lambda b, p, c, **f: b.add_joint_revolute(p, c, axis=AXIS, **f),
        lambda b, p, c, **f: b.add_joint_d6(p, c, angular_axes=[Dof(axis=AXIS)], **f),
        ((0.4,), (1.5,)),
        ((0.4,), (1.5,)),
    ),
    "prismatic": (
        lambda b, p, c, **f: b.add_joint_prismatic(p, c, axis=AXIS, **f),
        lambda b, p, c, **f: b.add_joint_d6(p, c, linear_axes=[Dof(axis=AXIS)], **f),
        ((0.1,), (0.5,)),
        ((0.1,), (0.5,)),
    ),
    "ball": (
        lambda b, p, c, **f: b.add_joint_ball(p, c, **f),
        lambda b, p, c, **f: b.add_joint_d6(p, c, angular_axes=[Dof(axis=a) for a in XYZ], **f),
        ((0.0, 0.0, 0.0, 1.0), (0.3, -0.2, 0.4)),
        ((0.0, 0.0, 0.0), (0.3, -0.2, 0.4)),
    ),
}


@pytest.mark.parametrize("kind", SAME)
def test_a_d6_joint_with_the_same_freedoms_moves_the_same(kind: str) -> None:
    """Two links under gravity for 1 s: poses within 1e-4 of those with the simple type.

    The constraints are the same, written differently, so only rounding and what is left after
    the iterations may differ. Something must have moved where something is free to.
    """
    simple, general, start, start_d6 = SAME[kind]
    a, b = two_links(simple, *start), two_links(general, *start_d6)
    first = a.pose
    assert b.pose == pytest.approx(first, abs=1.0e-6)
    for _ in range(240):
        a.step()
        b.step()
        sign = np.sign(np.sum(a.pose[:, 3:] * b.pose[:, 3:], axis=1))[:, None]
        assert np.abs(a.pose[:, :3] - b.pose[:, :3]).max() < 1.0e-4
        assert np.abs(a.pose[:, 3:] - sign * b.pose[:, 3:]).max() < 1.0e-4
    moved = np.abs(
        a.center - (first[:, :3] + Rotation.from_quat(first[:, 3:]).apply((0.02, 0.03, -0.05)))
    )
    assert (moved.max() > 0.05) == (kind != "fixed")


@pytest.mark.parametrize("kind", SAME)
def test_a_joint_holds_what_it_locks(kind: str) -> None:
    """After 1 s of motion under gravity, what the type locks is closed to 1e-6 m and 2e-6 rad.

    Angles are read from float32 quaternions, each known to 1e-7, of two bodies.
    """
    simple, _, start, _ = SAME[kind]
    sim = two_links(simple, *start)
    sim.run(1.0)
    parent, turn_p, child, turn_c = anchor_frames(sim)
    gap = turn_p.inv().apply(child - parent)
    turned = (turn_p.inv() * turn_c).as_rotvec()
    axis = np.array(AXIS) / np.linalg.norm(AXIS)
    if kind == "prismatic":
        gap -= np.outer(gap @ axis, axis)
    if kind == "revolute":
        turned -= np.outer(turned @ axis, axis)
    assert np.abs(gap).max() < 1.0e-6
    if kind != "ball":
        assert np.abs(turned).max() < 2.0e-6


@pytest.mark.parametrize("angular", range(4))
@pytest.mark.parametrize("linear", range(4))
def test_a_d6_joint_leaves_its_axes_free_and_no_others(linear: int, angular: int) -> None:
    """Pushed and turned anyhow, a body on 0 to 3 sliders and 0 to 3 hinges starts to move by

    S (S^T M S)^-1 S^T f: S holds the axes where the body is, 0.1 m and 0.3 rad along each; each
    turns about an axis that those before it carry. Within 0.2 %, for one step is a motion.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    body = add_link(builder, mass=2.0, com=(0.02, 0.03, -0.05))
    joint = builder.add_joint_d6(
        WORLD,
        body,
        linear_axes=[Dof(axis=axis) for axis in XYZ[:linear]],
        angular_axes=[Dof(axis=axis) for axis in XYZ[:angular]],
        parent_xform=transform((0.3, -0.2, 1.0), TURN_P),
        child_xform=transform((-0.3, 0.1, 0.05), TURN_C),
    )
    builder.add_articulation([joint])
    set_coordinates(builder, joint, [0.1] * linear + [0.3] * angular)
    sim = simulate(builder)
    arm = sim.center[0] - anchor_frames(sim)[2][0]
    axes = [(*TURN_P.apply(axis), 0.0, 0.0, 0.0) for axis in XYZ[:linear]]
    carried = TURN_P
    for axis in np.array(XYZ[:angular], dtype=float):
        about = carried.apply(axis)
        axes.append((*np.cross(about, arm), *about))
        carried = carried * Rotation.from_rotvec(0.3 * axis)
    wrench = np.array([3.0, -2.0, 5.0, 0.3, 0.2, -0.4])
    expected = np.zeros(6)
    if axes:
        free = np.array(axes).T
        mass = np.zeros((6, 6))
        mass[:3, :3], mass[3:, 3:] = 2.0 * np.eye(3), sim.world_inertia[0]
        expected = free @ np.linalg.solve(free.T @ mass @ free, free.T @ wrench)
    sim.push(0, wrench[:3], torque=wrench[3:])
    sim.step()
    assert sim.velocity[0] / sim.dt == pytest.approx(expected, abs=2.0e-3 * np.abs(wrench).max())


def test_a_d6_joint_of_two_axes_is_a_universal_joint() -> None:
    """Two angular axes: the second is carried by the first and stays square to the child's.

    With axes x and y the angles are intrinsic, so the child's y lies in the plane square to the
    parent's x: their product is 0, to rounding, while both angles move.
    """
    sim = two_links(
        lambda b, p, c, **f: b.add_joint_d6(
            p, c, angular_axes=[Dof(axis=(1, 0, 0)), Dof(axis=(0, 1, 0))], **f
        ),
        (0.2, -0.3),
        (0.5, 0.4),
    )
    seen = []
    for _ in range(240):
        sim.step()
        _, turn_p, _, turn_c = anchor_frames(sim)
        relative = (turn_p.inv() * turn_c).as_matrix()
        assert np.abs(relative[:, 0, 1]).max() < 1.0e-5
        seen.append(relative[:, :, 0])
        assert anchor_gaps(sim).max() < 1.0e-6
    assert np.ptp(np.array(seen), axis=0).max() > 0.1


def test_a_d6_joint_of_two_sliders_keeps_its_plane() -> None:
    """Two linear axes: a body falls freely in the plane of the axes, and not out of it, unturned.

    With axes that are 45 degrees steep, gravity's part in the plane is found by projection.
    """
    builder = newton.ModelBuilder()
    body = add_link(builder, com=(0.02, 0.03, -0.05))
    axes = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    joint = builder.add_joint_d6(
        WORLD,
        body,
        linear_axes=[Dof(axis=tuple(a)) for a in axes],
        parent_xform=transform((0.3, -0.2, 1.0), TURN_P),
        child_xform=transform((-0.3, 0.1, 0.05), TURN_C),
    )
    builder.add_articulation([joint])
    sim = simulate(builder, scheme="euler")
    start = sim.pose[0]
    steps = 120
    sim.step(steps)
    world = TURN_P.apply(axes)
    pull = world.T @ world @ np.array([0.0, 0.0, -G])
    fallen = 0.5 * steps * (steps + 1) * sim.dt**2 * pull
    assert sim.pose[0, :3] - start[:3] == pytest.approx(fallen, abs=1.0e-5)
    turned = Rotation.from_quat(sim.pose[0, 3:]) * Rotation.from_quat(start[3:]).inv()
    assert turned.magnitude() < 1.0e-6


def test_a_cantilever_of_welds_is_straight_and_still() -> None:
    """Ten boxes welded in a row to the world: the tip sags at most 1e-4 of the length, and rests.

    Welds are rigid, so there is nothing to swing: speed below 1e-4 m/s, from the first step on
    below what 1e-4 of sag in one step could be.
    """
    builder = newton.ModelBuilder()
    count, edge = 10, 0.2
    parent, joints = WORLD, []
    for _ in range(count):
        body = add_link(builder, mass=8.0, inertia=np.full(3, 8.0 * edge**2 / 6.0))
        at = (0.0, 0.0, 1.0) if parent == WORLD else (0.5 * edge, 0.0, 0.0)
        joints.append(
            builder.add_joint_fixed(
                parent, body, parent_xform=transform(at), child_xform=transform((-0.5 * edge, 0, 0))
            )
        )
        parent = body
    builder.add_articulation(joints)
    sim = simulate(builder)
    for _ in range(240):
        sim.step()
        assert np.abs(sim.velocity).max() < 1.0e-4 * count * edge / sim.dt
        assert abs(sim.pose[-1, 2] - 1.0) < 1.0e-4 * count * edge
    assert np.abs(sim.velocity).max() < 1.0e-4
    assert anchor_gaps(sim).max() < 1.0e-6


def string(lower: float, upper: float, start: tuple, qd: tuple = (0,) * 6) -> Simulation:
    """A body tied to the point (0, 0, 2) by a DISTANCE joint at an anchor beside its COM.

    ``start`` is where the anchor on the body starts, relative to that point.
    """
    builder = newton.ModelBuilder()
    body = add_link(builder, inertia=(0.05, 0.05, 0.05))
    joint = builder.add_joint_distance(
        WORLD,
        body,
        parent_xform=transform((0.0, 0.0, 2.0), TURN_P),
        child_xform=transform((0.0, 0.0, 0.1)),
        min_distance=lower,
        max_distance=upper,
    )
    builder.add_articulation([joint])
    # coordinates of a DISTANCE joint are the child anchor's pose in the parent anchor frame
    q = (*TURN_P.inv().apply(start), *TURN_P.inv().as_quat())
    set_coordinates(builder, joint, q, qd)
    return simulate(builder)


def test_a_string_stays_at_its_length_while_it_swings() -> None:
    """Released at 60 degrees it stays taut: the distance is the length within 1e-4 m."""
    sim = string(-1.0, 1.0, (np.sin(np.pi / 3), 0.0, -np.cos(np.pi / 3)))
    lowest = 0.0
    for _ in range(480):
        sim.step()
        assert anchor_gaps(sim)[0] == pytest.approx(1.0, abs=1.0e-4)
        lowest = min(lowest, anchor_frames(sim)[2][0, 2] - 2.0)
    assert lowest < -0.99  # it came through the lowest point


def test_a_slack_string_does_nothing_and_a_taut_one_stops_the_fall() -> None:
    """From half its length the body falls freely, to rounding; at the length it stops, for good."""
    sim = string(-1.0, 1.0, (0.0, 0.0, -0.5))
    start = sim.pose[0, 2]
    free = 60  # falls 0.31 m of the 0.5
    sim.step(free)
    fallen = 0.5 * free * (free + 1) * sim.dt**2 * G
    assert start - sim.pose[0, 2] == pytest.approx(fallen, abs=1.0e-5)
    assert sim.velocity[0, 2] == pytest.approx(-free * sim.dt * G, rel=1.0e-5)
    longest = 0.0
    for _ in range(180):
        sim.step()
        longest = max(longest, anchor_gaps(sim)[0])
    assert longest < 1.0 + 1.0e-4
    assert anchor_gaps(sim)[0] == pytest.approx(1.0, abs=1.0e-4)
    assert np.abs(sim.velocity).max() < 1.0e-4


def test_a_least_distance_keeps_bodies_apart() -> None:
    """A body that falls onto the point slides off around it, never nearer than 0.5 m less 1e-4."""
    sim = string(0.5, -1.0, (0.1, 0.0, 0.8))
    nearest, farthest = 1.0, 0.0
    for _ in range(240):
        sim.step()
        nearest = min(nearest, anchor_gaps(sim)[0])
        farthest = max(farthest, anchor_gaps(sim)[0])
    assert 0.5 - 1.0e-4 < nearest < 0.5 + 1.0e-4
    assert farthest > 1.0  # it left: no largest distance


def test_bodies_on_strings_stay_where_they_touch() -> None:
    """What pushes them apart does not let them fall."""
    builder = newton.ModelBuilder()
    for x in (-0.1, 0.1):
        ball = builder.add_link(xform=transform((x, 0.0, 0.0)))
        builder.add_shape_sphere(ball, radius=0.1, cfg=surface())
        top = transform((x, 0.0, 1.0))
        joint = builder.add_joint_distance(WORLD, ball, parent_xform=top, max_distance=1.0)
        builder.add_articulation([joint])
    sim = Simulation(builder)
    for _ in range(120):
        sim.step()
        assert np.abs(sim.pose[:, 2]).max() < 1.0e-4


def rod(gravity: bool, **stiffness: float) -> Simulation:
    """A body on a rod joint to the world, anchor at the COM, the tangent +z turned to +x."""
    builder = newton.ModelBuilder() if gravity else newton.ModelBuilder(gravity=NO_GRAVITY)
    body = add_link(builder, mass=2.0, inertia=(0.05, 0.05, 0.05))
    upright = transform((0.3, -0.2, 1.0), Rotation.identity() if gravity else TURN_P)
    builder.body_q[body] = upright
    joint = builder.add_joint_rod(WORLD, body, parent_xform=upright, **stiffness)
    builder.add_articulation([joint])
    return simulate(builder)


def test_a_rod_stretches_by_load_over_stiffness() -> None:
    """Hung along its tangent: m g / stretch stiffness, within 2 %; nothing sideways."""
    sim = rod(True, stretch_stiffness=2000.0, stretch_damping=80.0, bend_stiffness=10.0)
    start = sim.pose[0]
    sim.run(1.5)
    moved = sim.pose[0, :3] - start[:3]
    assert moved[2] == pytest.approx(-2.0 * G / 2000.0, rel=2.0e-2)
    assert np.abs(moved[:2]).max() < 1.0e-5


def test_a_rod_shears_by_load_over_its_shear_stiffness() -> None:
    """Pushed across its tangent: force / shear stiffness, within 2 %, the same for x and y."""
    sim = rod(
        False,
        stretch_stiffness=1.0e5,
        shear_stiffness=500.0,
        shear_damping=40.0,
        bend_stiffness=10.0,
    )
    start = sim.pose[0]
    sim.push(0, TURN_P.apply([3.0, -2.0, 0.0]))
    sim.run(1.5)
    moved = TURN_P.inv().apply(sim.pose[0, :3] - start[:3])
    assert moved[:2] == pytest.approx(np.array([3.0, -2.0]) / 500.0, rel=2.0e-2)
    assert abs(moved[2]) < 1.0e-5


@pytest.mark.parametrize(
    ("axis", "stiffness"), [(0, 20.0), (1, 20.0), (2, 5.0)], ids=["bend x", "bend y", "twist"]
)
def test_a_rod_bends_and_twists_by_torque_over_stiffness(axis: int, stiffness: float) -> None:
    """About x and y of the anchor frame by the bend stiffness, about z by the twist's, within 2 %.

    The angle is 0.05 rad: Newton's bend measure 2 tan(angle / 2) is 2e-4 more than the angle.
    """
    sim = rod(
        False,
        stretch_stiffness=1.0e5,
        stretch_damping=100.0,
        bend_stiffness=20.0,
        bend_damping=1.0,
        twist_stiffness=5.0,
        twist_damping=0.5,
    )
    start = Rotation.from_quat(sim.pose[0, 3:])
    torque = np.zeros(3)
    torque[axis] = 0.05 * stiffness
    sim.push(0, torque=TURN_P.apply(torque))
    sim.run(1.5)
    turned = TURN_P.inv().apply((Rotation.from_quat(sim.pose[0, 3:]) * start.inv()).as_rotvec())
    assert turned == pytest.approx(torque / stiffness, abs=1.0e-3)


def test_a_rod_resists_large_bends_by_newtons_measure() -> None:
    """SolverVBD's energy is K k^2 / 2 with k = 2 tan(angle / 2): the torque K k (1 + k^2 / 4).

    At one radian that is 1.42 of K times the angle; within 0.5 %.
    """
    sim = rod(
        False, stretch_stiffness=1.0e5, stretch_damping=100.0, bend_stiffness=20.0, bend_damping=2.0
    )
    start = Rotation.from_quat(sim.pose[0, 3:])
    bend = 2.0 * np.tan(0.5)
    sim.push(0, torque=TURN_P.apply([20.0 * bend * (1.0 + 0.25 * bend**2), 0.0, 0.0]))
    sim.run(2.0)
    turned = TURN_P.inv().apply((Rotation.from_quat(sim.pose[0, 3:]) * start.inv()).as_rotvec())
    assert turned == pytest.approx([1.0, 0.0, 0.0], abs=5.0e-3)


def test_a_rod_pushes_by_the_slope_of_its_energy() -> None:
    """K |k - k_rest|^2 / 2, by differences, where it is bent out of the plane of its rest.

    Rest is bent by 0.8 rad about y, the pose by 0.7 rad about x as well. A body of the same inertia
    about all axes starts to turn by that torque: within 0.5 %, the share of a step's own turn.
    Without what pushes about the tangent it is off by a third.
    """
    inertia, stiffness = 0.05, np.array([20.0, 20.0, 5.0])
    rest, pose = Rotation.from_rotvec([0.0, 0.8, 0.0]), Rotation.from_rotvec([0.7, 0.3, 0.2])

    def measure(turn: Rotation) -> np.ndarray:
        end = turn.apply([0.0, 0.0, 1.0])
        bend = 2.0 * np.cross([0.0, 0.0, 1.0], end) / (1.0 + end[2])
        return np.array([*bend[:2], 2.0 * np.arctan2(*turn.as_quat()[2:])])

    def energy(turn: Rotation) -> float:
        return 0.5 * float(stiffness @ (measure(turn) - measure(rest)) ** 2)

    turns = [Rotation.from_rotvec(1.0e-5 * axis) for axis in np.eye(3)]
    slope = np.array([energy(t * pose) - energy(t.inv() * pose) for t in turns]) / 2.0e-5
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    body = add_link(builder, mass=2.0, inertia=(inertia, inertia, inertia))
    joint = builder.add_joint_rod(
        WORLD, body, stretch_stiffness=1.0e5, bend_stiffness=20.0, twist_stiffness=5.0
    )
    set_coordinates(builder, joint, q=[0.0, 0.0, 0.0, *pose.as_quat()])
    builder.joint_rest_q[-4:] = rest.as_quat()
    builder.add_articulation([joint])
    sim = simulate(builder, dt=1.0e-3)
    sim.step()
    assert sim.velocity[0, 3:] == pytest.approx(-sim.dt / inertia * slope, rel=5.0e-3)


@pytest.mark.parametrize("kind", SAME)
def test_rest_frames_are_the_joints_and_not_where_bodies_were_put(kind: str) -> None:
    """A model whose ``body_q`` is anywhere else: nothing moves that starts where joints hold it."""
    simple, _, start, _ = SAME[kind]
    settled = two_links(simple, start[0])
    model = settled.model
    wp.copy(model.gravity, wp.zeros_like(model.gravity))
    placed = settled.state.body_q
    pose = placed.numpy().copy()
    pose[:, :3] += [[0.4, -0.3, 0.2], [-0.1, 0.5, 0.3]]
    pose[:, 3:] = Rotation.from_rotvec([0.5, -0.4, 0.9]).as_quat()
    model.body_q.assign(pose)
    solver = SolverAVBD(model)
    states = [model.state(), model.state()]
    states[0].body_q.assign(placed)
    for _ in range(10):
        solver.step(*states, None, None, settled.dt)
        states.reverse()
    assert states[0].body_q.numpy() == pytest.approx(placed.numpy(), abs=1.0e-6)


@pytest.mark.long
@pytest.mark.parametrize("settings", [{}, {"scheme": "euler"}, {"parallel": "bodies"}])
def test_joined_bodies_that_float_keep_their_momentum(settings: dict) -> None:
    """Two links on a hinge, thrown without gravity, for 2 s: joints push equally and oppositely.

    Linear momentum keeps to 1e-5 of itself, and angular momentum to 3e-5. (Backward Euler moves a
    body along its new velocity, which takes m v x v' dt of it a step, some per cent here; the two
    together get it back.)
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    inertia = (0.05, 0.05, 0.05)  # equal moments: the spin is the angular velocity's
    first, second = add_link(builder, mass=2.0, inertia=inertia), add_link(builder, inertia=inertia)
    base = builder.add_joint_free(first)
    hinge = builder.add_joint_revolute(
        first,
        second,
        parent_xform=transform((0.3, 0.1, 0.0), TURN_P),
        child_xform=transform((-0.2, 0.0, 0.1), TURN_C),
        axis=AXIS,
    )
    builder.add_articulation([base, hinge])
    set_coordinates(builder, base, qd=(0.5, -0.3, 0.8, 1.0, 0.5, -1.5))
    set_coordinates(builder, hinge, (0.4,), (2.0,))
    sim = simulate(builder, **settings)

    def momentum() -> tuple[np.ndarray, np.ndarray]:
        linear = sim.mass[:, None] * sim.velocity[:, :3]
        return linear, (np.cross(sim.center, linear) + sim.spin_momentum).sum(axis=0)

    linear, angular = momentum()
    start, start_angular = linear.sum(axis=0), angular
    sim.step(480)
    linear, angular = momentum()
    assert linear.sum(axis=0) == pytest.approx(start, abs=1.0e-5 * np.linalg.norm(start))
    bound = 3.0e-5 * np.linalg.norm(start_angular)
    assert angular == pytest.approx(start_angular, abs=bound)
    assert anchor_gaps(sim)[1] < 2.0e-6  # poses of 2 m, read in float32


@pytest.mark.parametrize("settings", [{}, {"blocks": "body", "iterations": 60}])
@pytest.mark.parametrize("last", ["0.3 1 0", "-0.7 0.2 0.5"])
def test_two_hinges_that_are_not_square_move_as_in_mujoco(last: str, settings: dict) -> None:
    """Axes at 73 and 142 degrees: pose, angles and rates after 0.25 s of falling.

    It starts at zero: at other angles Newton's eval_fk takes the axes for square. Errors are of
    first order in the step, as of square axes: 1e-3 rad.
    """
    text = f"""<mujoco><option timestep="0.0005" integrator="RK4"/><worldbody><body pos="0 0 1">
      <joint name="first" axis="1 0 0"/><joint name="last" axis="{last}"/>
      <geom type="box" size=".1 .05 .2" pos=".1 .1 -.1" mass="1" contype="0" conaffinity="0"/>
      </body></worldbody></mujoco>"""
    builder = newton.ModelBuilder()
    builder.add_mjcf(text)
    sim = Simulation(builder, dt=0.0005, collide=False, update_joint_state=True, **settings)
    reference = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(reference)
    for _ in range(500):
        mujoco.mj_step(reference, data)
    sim.step(500)
    np.testing.assert_allclose(sim.state.joint_q.numpy(), data.qpos, atol=3.0e-3)
    np.testing.assert_allclose(sim.state.joint_qd.numpy(), data.qvel, rtol=1.0e-2)
    angle = 2.0 * np.arccos(min(abs(sim.pose[0, 3:] @ data.xquat[1][[1, 2, 3, 0]]), 1.0))
    assert angle < 3.0e-3
