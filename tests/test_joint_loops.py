# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints that close a loop, and bodies that several joints hold."""

from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, Simulation
from joint_scenes import (
    WORLD,
    add_link,
    anchor_gaps,
    coordinates,
    euler_period,
    set_coordinates,
    simulate,
    swing_period,
    transform,
)
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD
from newton_avbd.io.opening import open_scene
from newton_avbd.io.simulation import Request
from newton_avbd.measure.joints import Joints

pytestmark = pytest.mark.usefixtures("shared_kernels")

HINGE = (0.0, 1.0, 0.0)
AT_END = pytest.mark.filterwarnings("ignore:.*another joint already connects.*")


def four_bar(
    crank: float,
    coupler: float,
    rocker: float,
    ground: float,
    angle: float,
    *,
    stops: tuple[float, float] = (-newton.MAXVAL, newton.MAXVAL),
    **settings: Any,
) -> Simulation:
    """A planar four-bar in the xz plane that hangs from (0, 0, 0) and (ground, 0, 0).

    Links are rods along their own x, at ``angle`` [rad] below +x for the crank; the joint from
    the rocker to the world closes the loop and belongs to no articulation. Its limits
    are ``stops`` [rad].
    """
    # angles below +x, all about +y
    b = crank * np.array([np.cos(angle), -np.sin(angle)])
    d = np.array([ground, 0.0])
    reach = np.linalg.norm(d - b)
    along = (reach**2 + coupler**2 - rocker**2) / (2.0 * reach)
    across = np.sqrt(coupler**2 - along**2)
    u = (d - b) / reach
    c = b + along * u + across * np.array([u[1], -u[0]])  # the lower of the two assemblies
    coupler_angle = np.arctan2(-(c - b)[1], (c - b)[0])
    rocker_angle = np.arctan2(-(d - c)[1], (d - c)[0])
    builder = newton.ModelBuilder()
    lengths = (crank, coupler, rocker)
    links = [
        add_link(builder, mass=m, inertia=np.array([0.001, m / 12 * a**2, m / 12 * a**2]))
        for m, a in zip(2.0 * np.array(lengths), lengths, strict=True)
    ]
    parent, joints = WORLD, []
    for link, length, before in zip(links, lengths, (0.0, crank, coupler), strict=True):
        joints.append(
            builder.add_joint_revolute(
                parent,
                link,
                parent_xform=transform((0.5 * before, 0.0, 0.0)),
                child_xform=transform((-0.5 * length, 0.0, 0.0)),
                axis=HINGE,
            )
        )
        parent = link
    builder.add_articulation(joints)
    builder.add_joint_revolute(
        WORLD,
        links[2],
        parent_xform=transform((ground, 0.0, 0.0)),
        child_xform=transform((0.5 * rocker, 0.0, 0.0)),
        axis=HINGE,
        limit_lower=stops[0],
        limit_upper=stops[1],
    )
    turns = (angle, coupler_angle - angle, rocker_angle - coupler_angle)
    for joint, turn in zip(joints, turns, strict=True):
        set_coordinates(builder, joint, [turn])
    return simulate(builder, **settings)


def test_a_four_bar_keeps_its_anchors_together() -> None:
    """3 s of swinging in gravity: all four anchors within 1e-4 m, all links in their plane.

    It swings for a while (the lowest energy is not the start's), and gains no energy.
    """
    sim = four_bar(0.4, 0.9, 0.7, 1.0, 0.3)
    assert anchor_gaps(sim).max() < 1.0e-6
    energy = sim.energy
    fastest = 0.0
    for _ in range(720):
        sim.step()
        assert anchor_gaps(sim).max() < 1.0e-4
        assert np.abs(sim.pose[:, 1]).max() < 1.0e-4
        assert sim.energy < energy + 1.0e-4 * sim.mass.sum() * G
        fastest = max(fastest, np.abs(sim.velocity[0, 4]))
    assert fastest > 1.0


BAR = {"crank": 0.4, "coupler": 0.9, "rocker": 0.7, "ground": 1.0, "angle": 0.3}
BAR_STARTS = -1.67382  # coordinate of the joint that closes it, by the law of cosines [rad]


def stopped_bar(lower: float, upper: float, **settings: Any) -> Simulation:
    """A four-bar whose closing joint has limits so far from where it starts [rad]."""
    stops = (BAR_STARTS + lower, BAR_STARTS + upper)
    return four_bar(**BAR, stops=stops, update_joint_state=True, **settings)


def closing_angle(sim: Simulation) -> tuple[float, float]:
    """How far that joint has turned [rad], and at what rate [rad/s]."""
    q, qd = sim.state.joint_q.numpy()[3], sim.state.joint_qd.numpy()[3]
    return float(q) - BAR_STARTS, float(qd)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("rate", [60.0, 240.0])
def test_a_four_bar_stops_where_the_joint_that_closes_it_is_stopped(
    parallel: str, rate: float
) -> None:
    """It falls onto its limit and rests there. Sweep by sweep it passed it by 3 to 10 mrad."""
    sim = stopped_bar(-1.0, 0.1, dt=1.0 / rate, parallel=parallel)
    at = []
    for _ in range(int(2.0 * rate)):
        sim.step()
        at.append(closing_angle(sim))
    at = np.array(at)
    assert at[:, 0].max() < 0.1 + 1.0e-5
    assert at[-1] == pytest.approx([0.1, 0.0], abs=1.0e-3)
    assert anchor_gaps(sim).max() < 1.0e-5


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
def test_the_joint_that_closes_a_loop_comes_back_within_its_limit(parallel: str) -> None:
    """It starts 0.05 rad beyond; the weight of the links presses it against its limit.

    Outside of trees, what was beyond a limit was held there for good.
    """
    sim = stopped_bar(0.05, 1.0, parallel=parallel)
    at = 0.0
    for _ in range(60):
        before = at
        sim.step()
        at, rate = closing_angle(sim)
        assert at > before - 1.0e-5
        assert abs(rate) < 1.0e-3
        assert anchor_gaps(sim).max() < 1.0e-4
    assert at == pytest.approx(0.05, abs=1.0e-5)


def test_a_loop_rests_where_it_comes_closest_to_a_limit_that_it_cannot_reach() -> None:
    """Its dead center is 40 mrad from where it starts, its limit 100.

    Without a softness in the recovery the stop threw the links to and fro, by up to 60 mrad a step.
    """
    sim = stopped_bar(-1.0, -0.1)
    for step in range(240):
        sim.step()
        at, rate = closing_angle(sim)
        assert anchor_gaps(sim).max() < 1.0e-4
        assert -0.0405 < at
        if step > 60:
            assert at < -0.04
            assert abs(rate) < 0.01


def test_the_joint_that_closes_a_loop_has_coordinates() -> None:
    """It turns the rocker against the world, as all other joints do together."""
    sim = four_bar(0.4, 0.9, 0.7, 1.0, 0.3, update_joint_state=True)
    sim.run(0.3)
    q, qd = sim.state.joint_q.numpy(), sim.state.joint_qd.numpy()
    assert np.abs(qd[3]) > 0.5
    assert qd[3] == pytest.approx(qd[:3].sum(), abs=1.0e-4)
    assert np.sin(q[3] - q[:3].sum()) == pytest.approx(0.0, abs=1.0e-5)
    assert np.cos(q[3] - q[:3].sum()) == pytest.approx(1.0, abs=1.0e-5)


def test_a_parallelogram_swings_with_its_own_period() -> None:
    """Equal cranks carry the coupler without turning it: one dof, T in closed form.

    I = 2 m_c l^2 / 3 + m_k l^2 and the weight m_k l + 2 m_c l / 2 about hanging straight down.
    The loop has a redundant row out of the plane, three in fact, which must not hold it back.
    Bound 1e-3: the amplitude of 0.05 rad adds 1.6e-4.
    """
    crank, coupler = 0.5, 0.8
    sim = four_bar(crank, coupler, crank, coupler, np.pi / 2 + 0.05)
    light, heavy = 2.0 * crank, 2.0 * coupler
    inertia = 2.0 * light * crank**2 / 3.0 + heavy * crank**2
    omega = np.sqrt(G * (heavy * crank + light * crank) / inertia)
    angle = []
    for _ in range(round(3.3 * 2 * np.pi / omega / sim.dt)):
        sim.step()
        angle.append(coordinates(sim)[0][0] - np.pi / 2)
    assert swing_period(np.array(angle), sim.dt) == pytest.approx(
        euler_period(omega, sim.dt), rel=1.0e-3
    )
    turned = Rotation.from_quat(sim.pose[1, 3:]).magnitude()
    assert turned < 1.0e-4  # the coupler stays level


def test_friction_of_all_hinges_of_a_loop_holds_and_lets_go() -> None:
    """A motor turns a parallelogram to and fro: at the ends it stands until 3 N m push it back.

    Each of three hinges has friction of 1 N m and turns as the crank does. One of them holds the
    others, which step by rounding then, and sweeps settle: before, rounding had them take turns,
    and ten sweeps did not end it in four of 480 steps. Bound: 0.16 N m is what a step adds.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    links = [add_link(builder, mass=0.1, inertia=(1e-4, 1e-4, 1e-4)) for _ in range(3)]
    arm, end = (0.0, 0.1, 0.0), (0.1, 0.0, 0.0)
    joints = [
        builder.add_joint_revolute(
            parent,
            link,
            parent_xform=transform(at),
            child_xform=transform((0.0, 0.0, 0.0)),
            axis=(0.0, 0.0, 1.0),
            friction=1.0,
            armature=0.1,
        )
        for parent, link, at in (
            (WORLD, links[0], (0.0, 0.0, 0.0)),
            (links[0], links[1], arm),
            (WORLD, links[2], end),
        )
    ]
    builder.joint_target_ke[0], builder.joint_target_kd[0] = 20.0, 1.0
    builder.joint_target_mode[0] = int(newton.JointTargetMode.POSITION)
    builder.add_articulation(joints)
    builder.add_joint_ball(
        links[2], links[1], parent_xform=transform(arm), child_xform=transform(end)
    )
    sim = simulate(builder)
    angles, torques = [], []
    for i in range(480):
        target = 0.4 * np.sin(2.0 * np.pi * 0.75 * (i + 1) * sim.dt)
        sim.control.joint_target_q.assign(np.full(len(sim.control.joint_target_q), target))
        sim.step()
        assert np.isfinite(sim.solver.status.update[0])
        angles.append(coordinates(sim)[0][:3])
        torques.append(20.0 * (angles[-1][0] - target))
    q = np.array(angles)
    assert np.abs(q - q[:, :1] * [1.0, -1.0, 1.0]).max() < 1.0e-6
    stands = np.abs(np.diff(q[:, 0])) < 1.0e-6
    ends = np.flatnonzero(stands[30:-1] & ~stands[31:]) + 31
    assert len(ends) == 3
    assert np.abs(torques)[ends] == pytest.approx(3.0, abs=0.16)


def test_a_row_of_parallelograms_swings_as_one() -> None:
    """21 rods, joined by 20 couplers that close 20 loops: 100 rows, of which 60 say nothing new.

    One dof, T in closed form, within 1e-3; all anchors within 1e-5 m throughout.
    """
    length, spacing, count, mass = 0.5, 0.2, 20, 1.0
    angle = 0.05
    builder = newton.ModelBuilder()
    rods = [add_link(builder, mass=mass, inertia=np.full(3, 0.02)) for _ in range(count + 1)]
    couplers = [add_link(builder, mass=mass) for _ in range(count)]
    ends = [transform((side * 0.5 * spacing, 0.0, 0.0)) for side in (-1.0, 1.0)]
    top, bottom = transform((0.0, 0.0, 0.5 * length)), transform((0.0, 0.0, -0.5 * length))

    def hinge(parent: int, child: int, at_parent: wp.transform, at_child: wp.transform) -> int:
        return builder.add_joint_revolute(
            parent, child, parent_xform=at_parent, child_xform=at_child, axis=HINGE
        )

    for i, rod in enumerate(rods):
        joints = [hinge(WORLD, rod, transform((i * spacing, 0.0, 0.0)), top)]
        set_coordinates(builder, joints[0], [angle])
        if i < count:
            joints.append(hinge(rod, couplers[i], bottom, ends[0]))
            set_coordinates(builder, joints[1], [-angle])
        builder.add_articulation(joints)
    for rod, coupler in zip(rods[1:], couplers, strict=True):
        hinge(rod, coupler, bottom, ends[1])
    sim = simulate(builder)
    inertia = (count + 1) * (0.02 + 0.25 * mass * length**2) + count * mass * length**2
    weight = G * mass * (0.5 * length * (count + 1) + length * count)
    omega = np.sqrt(weight / inertia)
    swing = []
    for _ in range(round(3.3 * 2 * np.pi / omega / sim.dt)):
        sim.step()
        assert anchor_gaps(sim).max() < 1.0e-5
        swing.append(coordinates(sim)[0][0])
    assert swing_period(np.array(swing), sim.dt) == pytest.approx(
        euler_period(omega, sim.dt), rel=1.0e-3
    )


def door(hinges: int) -> Simulation:
    """A plate that swings about the x axis on hinges at x = -0.4 and 0.4, released level."""
    builder = newton.ModelBuilder()
    plate = add_link(builder, mass=2.0, inertia=(0.2, 0.3, 0.4))
    joints = [
        builder.add_joint_revolute(
            WORLD,
            plate,
            parent_xform=transform((x, 0.0, 1.0)),
            child_xform=transform((x, -0.3, 0.0)),
            axis=(1.0, 0.0, 0.0),
        )
        for x in np.linspace(-0.4, 0.4, hinges)
    ]
    builder.add_articulation(joints[:1])
    return simulate(builder)


@AT_END
def test_a_second_hinge_on_the_same_axis_changes_nothing() -> None:
    """A door on two hinges swings like a door on one, within 1e-4 over 1 s: five redundant rows."""
    one, two = door(1), door(2)
    lowest = 1.0
    for _ in range(240):
        one.step()
        two.step()
        assert two.pose == pytest.approx(one.pose, abs=1.0e-4)
        assert anchor_gaps(two).max() < 1.0e-5
        lowest = min(lowest, two.pose[0, 2])
    assert lowest < 0.75  # it swung through


@AT_END
@AT_END
def test_a_joint_that_lets_go_under_load_leaves_no_force_behind() -> None:
    """A heavy plate on two ball joints loses one of them: it swings as if it never had it."""

    def hung(joints: int) -> Simulation:
        builder = newton.ModelBuilder()
        plate = add_link(builder, mass=50.0, inertia=(0.02, 0.3, 0.3))
        found = [
            builder.add_joint_ball(
                WORLD,
                plate,
                parent_xform=transform((x, 0.0, 1.0)),
                child_xform=transform((x, 0.0, 0.3)),
            )
            for x in (-0.4, 0.4)[:joints]
        ]
        builder.add_articulation(found[:1])
        set_coordinates(builder, found[0], (0.0, 0.0, 0.0, 1.0))
        return simulate(builder)

    free, held = hung(1), hung(2)
    held.step(60)
    held.model.joint_enabled.assign([True, False])
    free.state.body_q.assign(held.state.body_q)
    free.state.body_qd.assign(held.state.body_qd)
    for _ in range(120):
        free.step()
        held.step()
    assert held.pose == pytest.approx(free.pose, abs=1.0e-3)


def test_a_body_on_two_ball_joints_is_a_door() -> None:
    """Two inbound joints on one body: it turns about the line through both, as on a hinge."""
    hinged = door(1)
    builder = newton.ModelBuilder()
    plate = add_link(builder, mass=2.0, inertia=(0.2, 0.3, 0.4))
    joints = [
        builder.add_joint_ball(
            WORLD,
            plate,
            parent_xform=transform((x, 0.0, 1.0)),
            child_xform=transform((x, -0.3, 0.0)),
        )
        for x in (-0.4, 0.4)
    ]
    builder.add_articulation(joints[:1])
    set_coordinates(builder, joints[0], (0.0, 0.0, 0.0, 1.0))
    sim = simulate(builder)
    for _ in range(240):
        hinged.step()
        sim.step()
        assert sim.pose == pytest.approx(hinged.pose, abs=1.0e-4)
    assert anchor_gaps(sim).max() < 1.0e-5


def test_a_plate_hung_from_four_links_carries_itself() -> None:
    """Four equal links with ball joints at both ends, four inbound joints on the plate, at rest.

    Nothing moves: the links hang straight and share the load in whatever way. 1 mm/s, 1e-4 m.
    """
    builder = newton.ModelBuilder()
    plate = add_link(builder, mass=5.0, inertia=(0.5, 0.5, 0.9))
    loops = []
    for x, y in ((-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5)):
        link = add_link(builder, mass=0.2, inertia=(0.005, 0.005, 0.001))
        tree = [
            builder.add_joint_ball(
                WORLD,
                link,
                parent_xform=transform((x, y, 1.0)),
                child_xform=transform((0.0, 0.0, 0.25)),
            )
        ]
        hung = {
            "parent_xform": transform((0.0, 0.0, -0.25)),
            "child_xform": transform((x, y, 0.0)),
        }
        if not loops:
            tree.append(builder.add_joint_ball(link, plate, **hung))
        loops.append((link, hung))
        builder.add_articulation(tree)
    for link, hung in loops[1:]:
        builder.add_joint_ball(link, plate, **hung)
    sim = simulate(builder)
    assert anchor_gaps(sim).max() < 1.0e-6
    start = sim.pose
    for _ in range(240):
        sim.step()
        assert anchor_gaps(sim).max() < 1.0e-4
    assert sim.pose == pytest.approx(start, abs=1.0e-4)
    assert np.abs(sim.velocity).max() < 1.0e-3


@AT_END
def test_a_loop_that_floats_keeps_its_momentum_and_goes_on_turning() -> None:
    """Four rods in a rhombus, spun out of their plane: momentum keeps to 3e-5.

    Rows that a planar mechanism implies must not push: they would at any of its poses.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    side, angle = 0.2, 0.6
    corners = side * np.array(
        [
            [0.0, 0.0],
            [np.cos(angle), np.sin(angle)],
            [2.0 * np.cos(angle), 0.0],
            [np.cos(angle), -np.sin(angle)],
        ]
    )
    links, joints = [], []
    turns = [Rotation.from_euler("y", -a) for a in (angle, -angle, angle - np.pi, np.pi - angle)]
    for i in range(4):
        links.append(add_link(builder, inertia=np.array([1e-4, 4e-3, 4e-3])))
        middle = 0.5 * (corners[i] + corners[(i + 1) % 4])
        at = transform((middle[0], 0.0, middle[1]), turns[i])
        builder.body_q[links[i]] = at
        if i == 0:
            joints.append(builder.add_joint_free(links[0]))
            builder.joint_q[:7] = [*at]
            continue
        joints.append(
            builder.add_joint_revolute(
                links[i - 1],
                links[i],
                parent_xform=transform((0.5 * side, 0.0, 0.0)),
                child_xform=transform((-0.5 * side, 0.0, 0.0)),
                axis=HINGE,
            )
        )
        turn = (turns[i - 1].inv() * turns[i]).as_euler("yxz")[0]
        set_coordinates(builder, joints[i], q=[turn])
    builder.add_articulation(joints)
    builder.add_joint_revolute(
        links[3],
        links[0],
        parent_xform=transform((0.5 * side, 0.0, 0.0)),
        child_xform=transform((-0.5 * side, 0.0, 0.0)),
        axis=HINGE,
    )
    sim = simulate(builder, scheme="euler")
    assert anchor_gaps(sim)[1:].max() < 1e-6
    spin = np.array([0.5, 1.0, 2.0])
    middle = sim.center.mean(axis=0)
    for body in links:
        sim.set_velocity(body, np.cross(spin, sim.center[body] - middle), spin)
    start = moments(sim)
    for _ in range(480):
        sim.step()
        assert anchor_gaps(sim)[1:].max() < 2e-6
    np.testing.assert_allclose(sim.mass @ sim.velocity[:, :3], 0.0, atol=1e-5)
    assert moments(sim) == pytest.approx(start, abs=3e-5 * np.linalg.norm(start))


def moments(sim: Simulation) -> np.ndarray:
    """Angular momentum about the common COM [N m s]."""
    away = sim.center - sim.center.mean(axis=0)
    orbit = sim.mass[:, None] * np.cross(away, sim.velocity[:, :3])
    return (orbit + sim.spin_momentum).sum(axis=0)


def test_a_net_that_floats_keeps_its_momentum() -> None:
    """4 x 4 plates on 24 ball joints, 9 of which close loops, each plate with its own velocity.

    Only internal forces act: linear momentum stays within 1e-5 of what the bodies carry, all
    anchors within 1e-5 m, and backward Euler gains no energy.
    """
    edge, count = 0.2, 4
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    body = [
        [add_link(builder, inertia=np.full(3, 2e-3)) for _ in range(count)] for _ in range(count)
    ]
    half = 0.5 * edge
    joints, ties = [builder.add_joint_free(body[0][0])], []
    for i in range(count):
        for j in range(count):
            builder.body_q[body[i][j]] = transform((i * edge, j * edge, 0.0))
            if i > 0:
                ties.append((False, body[i - 1][j], body[i][j], np.array([half, 0.0, 0.0])))
            if j > 0:
                ties.append((i > 0, body[i][j - 1], body[i][j], np.array([0.0, half, 0.0])))
    for is_loop, parent, child, arm in sorted(ties, key=lambda tie: tie[0]):
        frames = {"parent_xform": transform(arm), "child_xform": transform(-arm)}
        joint = builder.add_joint_ball(parent, child, **frames)
        if not is_loop:
            joints.append(joint)
    builder.add_articulation(joints)
    sim = simulate(builder)
    rng = np.random.default_rng(3)
    for links in body:
        for link in links:
            sim.set_velocity(link, rng.normal(size=3) * 0.2, np.zeros(3))
    start = sim.mass @ sim.velocity[:, :3]
    carried = np.abs(sim.mass[:, None] * sim.velocity[:, :3]).sum()
    energy = sim.energy
    for _ in range(240):
        sim.step()
        assert anchor_gaps(sim)[1:].max() < 1e-5
    np.testing.assert_allclose(sim.mass @ sim.velocity[:, :3], start, atol=1e-5 * carried)
    assert sim.energy < energy


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:SolverAVBD steps without contacts")
def test_a_sphere_of_scissors_does_not_push_itself_apart() -> None:
    """A Hoberman sphere that opens: most of what its loops lock they imply of each other.

    What rows that imply each other push each other with does nothing, and so nothing bounds it but
    that it is forgotten; it once grew by a tenth a step, until the sphere burst after 110. Here the
    scissors push each other with what a motor of 300 N m a radian makes of 180 g, at 60 steps a
    second.
    """
    arguments = ("--world-count", "1", "--stage-count", "1")
    simulation = open_scene("kamino_earworm_flowers", Request("avbd", arguments=arguments))
    for _ in range(simulation.frames):
        simulation.advance()
    assert simulation.verdict() == "passed"
    assert isinstance(simulation.solver, SolverAVBD)
    push = simulation.solver.checkpoint()["history.loop_force"]
    assert np.linalg.norm(push, axis=1).max() < 10.0


LEG = """<mujoco><compiler autolimits="true"/><worldbody>
 <body pos="0 0 1" euler="0 0 -45"><joint name="knee"/>
  <inertial pos=".02 .03 0" mass=".76" diaginertia="1e-3 1e-3 2e-3"/>
  <body pos=".06 .047 0"><joint name="shin"/>
   <inertial pos=".18 0 0" mass=".58" diaginertia="4e-4 .015 .015"/>
   <body pos=".43 .02 0" euler="0 0 58"><joint name="tarsus"/>
    <inertial pos=".11 -.03 0" mass=".78" diaginertia="4e-4 .014 .014"/>
    <body pos=".058 -.034 .01"><joint name="crank" range="-140 -30"/>
     <inertial pos=".005 0 0" mass=".13" diaginertia="3e-5 5e-5 6e-5"/>
     <body name="rod" pos=".055 0 -.01"><joint name="rod"/>
      <inertial pos=".18 0 0" mass=".12" diaginertia="3e-6 2e-3 2e-3"/></body></body>
    <body name="foot" pos=".408 -.04 0"><joint name="foot" range="-140 -30"/>
     <inertial pos=".005 .027 0" mass=".15" diaginertia="2e-4 2e-4 3e-4"/></body>
   </body></body></body></worldbody>
 <equality><connect body1="rod" body2="foot" anchor=".3501 0 0"/></equality></mujoco>"""
"""The lower leg of a bird-like robot: the crank turns the foot by a rod. Both are 30 degrees beyond
their stops, and the loop is no parallelogram by a few tenths of a millimeter."""


def locked_hinge(seed: int, kind: str, spin: float) -> Simulation:
    """A floating base with two links; a ball joint or hinge between these locks the second's hinge.

    The base hangs on a light root by a ball joint; all turn as one at ``spin`` [rad/s].
    """
    rng = np.random.default_rng(seed)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    root = add_link(builder, mass=0.1, inertia=(0.001, 0.001, 0.001))
    base = add_link(builder, inertia=(0.02, 0.03, 0.04))
    fixed, hinged = (add_link(builder, inertia=(0.002, 0.01, 0.01)) for _ in range(2))
    hung, held = transform((0.1, 0.05, 0.0)), transform((-0.2, 0.0, 0.0))
    joints = [builder.add_joint_free(root)]
    joints.append(builder.add_joint_ball(root, base, parent_xform=hung, child_xform=held))
    places = [(rng.uniform(-0.2, 0.2, 3), Rotation.random(random_state=rng)) for _ in range(2)]
    first, second = (transform(*place) for place in places)
    joints.append(builder.add_joint_fixed(base, fixed, parent_xform=first))
    joints.append(
        builder.add_joint_revolute(
            base, hinged, parent_xform=second, child_xform=transform((-0.15, 0.0, 0.0))
        )
    )
    builder.add_articulation(joints)
    (at_a, turn_a), (at_b, turn_b) = places
    at_b = at_b + turn_b.apply([0.15, 0.0, 0.0])
    anchor = at_a + turn_a.apply([0.1, 0.0, 0.0])
    add = builder.add_joint_ball if kind == "ball" else builder.add_joint_revolute
    add(
        fixed,
        hinged,
        parent_xform=transform((0.1, 0.0, 0.0)),
        child_xform=transform(turn_b.inv().apply(anchor - at_b), turn_b.inv() * turn_a),
    )
    axis = rng.normal(size=3)
    builder.joint_qd[3:6] = (spin / np.linalg.norm(axis) * axis).tolist()
    return simulate(builder)


@pytest.mark.parametrize("kind", ["ball", "revolute"])
@pytest.mark.parametrize("seed", range(3))
def test_what_a_loop_locks_turns_as_one_body(kind: str, seed: int) -> None:
    """Nothing acts on it, so that it keeps its energy, and its joints, and the bound never acts.

    Of the rows of the loop all but one are implied by it, and ask for what does not go together as
    bodies turn by 0.08 rad a step. They pushed each other with 10 to 100 MN, and were cut off.
    """
    sim = locked_hinge(seed, kind, spin=20.0)
    start = sim.kinetic_energy
    sim.run(0.5)
    assert sim.kinetic_energy == pytest.approx(start, rel=1e-3)
    assert anchor_gaps(sim)[1:].max() < 2e-6
    assert not sim.solver.status.held_steps.any()
    assert not sim.solver.status.bounded_steps.any()


def test_two_stops_of_a_loop_that_do_not_go_together_let_it_close() -> None:
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(LEG, parse_visuals=False)
    sim = Simulation(builder, collide=False)
    measured = Joints.of(sim.model)
    for _ in range(60):
        sim.step()
        assert measured.separation(sim.pose).max() < 1.0e-3
        assert np.abs(sim.velocity).max() < 10.0
    assert measured.separation(sim.pose).max() < 1.0e-6
    assert measured.limit_violation(sim.pose).max() < 1.0e-5


def test_of_stops_that_one_sweep_reaches_a_loop_leaves_the_nearest() -> None:
    """A parallelogram whose hinges have velocity limits of 0.3, 0.4 and 0.5 rad/s.

    All turn alike, so it turns by 0.3 rad/s. Torques that alone would turn it by 10 rad/s in a step
    take all to their limits at once.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    crank, coupler, rocker = (add_link(builder) for _ in range(3))
    low, high = transform((0.0, 0.0, -0.1)), transform((0.0, 0.0, 0.1))
    left, right = transform((-0.2, 0.0, 0.0)), transform((0.2, 0.0, 0.0))
    far = transform((0.4, 0.0, 0.0))
    joints = [
        builder.add_joint_revolute(
            parent, child, parent_xform=at, child_xform=own, axis=HINGE, velocity_limit=limit
        )
        for parent, child, at, own, limit in (
            (WORLD, crank, transform(), low, 0.3),
            (crank, coupler, high, left, 0.4),
            (WORLD, rocker, far, low, 0.5),
        )
    ]
    builder.add_joint_revolute(rocker, coupler, parent_xform=high, child_xform=right, axis=HINGE)
    builder.add_articulation(joints)
    sim = simulate(builder, scheme="euler")
    sim.control.joint_f.assign(np.array([50.0, 50.0, 50.0, 0.0], dtype=np.float32))
    for _ in range(10):
        sim.step()
        assert anchor_gaps(sim).max() < 1.0e-6
        # in a step links of 0.2 m may stay apart by 1e-6 m
        np.testing.assert_allclose(sim.velocity[:, 4], [0.3, 0.0, 0.3], atol=1.2e-3)


def held_cable(middle: int, **stiffness: float) -> Simulation:
    """A cable along x, weightless, of ``2 middle + 1`` segments of 0.1 m, whose ends stay."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    rod = newton.Rod.create_straight(
        start=wp.vec3(0.0),
        direction=wp.vec3(1.0, 0.0, 0.0),
        length=0.1 * (2 * middle + 1),
        segment_count=2 * middle + 1,
        radius=0.01,
    )
    bodies, _ = builder.add_rod(rod=rod, bend_damping=2.0, **stiffness)
    for body in (bodies[0], bodies[-1]):
        builder.body_mass[body] = builder.body_inv_mass[body] = 0.0
        builder.body_inertia[body] = builder.body_inv_inertia[body] = wp.mat33(0.0)
    return Simulation(builder, collide=False)


def test_a_cable_held_at_both_ends_is_springs_in_series() -> None:
    """Pulled along it by F and twisted by T, its middle gives way by (n/2)/k of F and T for n rods
    on each side. Its last rod, which closes a loop, is solved with the others: in one or two
    sweeps a step, not in all of eighty."""
    middle, force, torque = 8, 50.0, 0.2
    sim = held_cable(
        middle,
        stretch_stiffness=1.0e5,
        stretch_damping=50.0,
        bend_stiffness=20.0,
        twist_stiffness=20.0,
        twist_damping=0.2,
    )
    start = sim.pose[middle]
    sim.state.body_f.assign(
        np.array([[force, 0, 0, torque, 0, 0] if i == middle else [0] * 6 for i in range(17)])
    )
    sweeps = 0
    for _ in range(240):
        sim.step()
        sweeps = max(sweeps, int(sim.solver.report().sweeps.max()))
    end = sim.pose[middle]
    assert end[0] - start[0] == pytest.approx(0.5 * middle * force / 1.0e5, rel=1.0e-3)
    turn = Rotation.from_quat(end[3:]) * Rotation.from_quat(start[3:]).inv()
    assert turn.as_rotvec() == pytest.approx([0.5 * middle * torque / 20.0, 0, 0], abs=4.0e-5)
    assert sweeps <= 2


def test_a_ring_of_rods_moves_the_same_wherever_the_tree_ends() -> None:
    """Which rod closes the loop follows from their order: a ring that hangs and sways."""
    ends = []
    for first in range(0, 6, 2):
        builder = newton.ModelBuilder()
        links = []
        for i in range(6):
            turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), np.pi * i / 3.0)
            away = wp.quat_rotate(turn, wp.vec3(0.3, 0.0, 0.0))
            link = builder.add_link(xform=wp.transform(away, turn), is_kinematic=i == 0)
            builder.add_shape_box(link, hx=0.02, hy=0.03, hz=0.1)
            links.append(link)
        for k in range(6):
            i = (first + k) % 6
            builder.add_joint_rod(
                links[i],
                links[(i + 1) % 6],
                parent_xform=wp.transform((0.0, 0.0, -0.15)),
                child_xform=wp.transform((0.0, 0.0, 0.15)),
                stretch_stiffness=2.0e4,
                bend_stiffness=30.0,
                twist_stiffness=10.0,
                bend_damping=0.3,
            )
        sim = Simulation(builder, collide=False, is_checked=False)
        sim.step(120)
        ends.append(sim.pose)
    assert np.abs(ends[0][:, :3] - sim.model.body_q.numpy()[:, :3]).max() > 0.02
    for other in ends[1:]:
        assert other[:, :3] == pytest.approx(ends[0][:, :3], abs=2.0e-5)
