# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A foot of 10 g stops what it carries: its contacts are as stiff as that asks for."""

import newton
import numpy as np
import pytest
from helpers import Array, Simulation, add_ground, surface
from joint_scenes import add_link, transform

from newton_avbd.rows.contact import PENALTY
from newton_avbd.step.piles import LINK_WEIGHT

RADIUS = 0.05
FOOT = 1.0e-2
AXIS = (0.6, 0.0, 0.8)


def standing(
    *kinds: str, load: float, foot: int = 0, speed: float = 0.0
) -> tuple[Simulation, Array]:
    """A tree that falls [m/s], of bodies aslant on each other that are joined as said.

    The ball of the one called ``foot`` touches the ground; the load [kg] is at the other end.
    Returns also the ways from each body to the next [m].
    """
    builder = newton.ModelBuilder()
    add_ground(builder)
    steps = np.array([[0.2, 0.1, 0.3], [-0.1, 0.3, 0.4], [0.3, -0.2, 0.5]])[: len(kinds)]
    places = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    places[:, 2] += RADIUS - places[foot, 2]
    masses = [FOOT] * len(places)
    masses[0 if foot else -1] = load
    joints = []
    for i, (place, mass) in enumerate(zip(places, masses, strict=True)):
        inertia = mass * np.diag([0.01, 0.02, 0.025])
        body = add_link(builder, mass=mass, inertia=inertia, xform=transform(place))
        builder.body_qd[body] = (0.0, 0.0, -speed, 0.0, 0.0, 0.0)
        if i == 0:
            joints.append(builder.add_joint_free(body))
            continue
        ends = {
            "parent_xform": transform(0.5 * steps[i - 1]),
            "child_xform": transform(-0.5 * steps[i - 1]),
        }
        if kinds[i - 1] in ("revolute", "prismatic"):
            ends["axis"] = AXIS
        add = getattr(builder, f"add_joint_{kinds[i - 1]}")
        joints.append(add(body - 1, body, **ends))
    builder.add_articulation(joints)
    builder.add_shape_sphere(foot, radius=RADIUS, cfg=surface(density=0.0))
    # a foot that is welded to its load is one body with it, and no light link
    return Simulation(builder, effects={"welds": False}), steps


def mass_without_turning(sim: Simulation, foot: int, kinds: tuple[str, ...], steps: Array) -> float:
    """Mass [kg] of the tree as its foot moves upwards by 1 and does not turn, by a dense solve.

    The motion of least energy among those that the joints allow.
    """
    count = len(kinds) + 1
    metric = np.zeros((6 * count, 6 * count))
    for i in range(count):
        metric[6 * i : 6 * i + 3, 6 * i : 6 * i + 3] = sim.mass[i] * np.eye(3)
        metric[6 * i + 3 : 6 * i + 6, 6 * i + 3 : 6 * i + 6] = sim.world_inertia[i]
    across = np.linalg.svd(np.array([AXIS]))[2][1:]
    locked = []
    for i, kind in enumerate(kinds):
        # velocity of the anchor and spin of the child against the parent
        relative = np.zeros((6, 6 * count))
        for body, sign, arm in ((i, -1.0, 0.5 * steps[i]), (i + 1, 1.0, -0.5 * steps[i])):
            relative[:3, 6 * body : 6 * body + 3] = sign * np.eye(3)
            relative[:3, 6 * body + 3 : 6 * body + 6] = -sign * np.cross(np.eye(3), arm)
            relative[3:, 6 * body + 3 : 6 * body + 6] = sign * np.eye(3)
        shift, turn = relative[:3], relative[3:]
        locked.append(across @ shift if kind == "prismatic" else shift)
        if kind != "ball":
            locked.append(across @ turn if kind == "revolute" else turn)
    moves = np.zeros((6, 6 * count))
    moves[:, 6 * foot : 6 * foot + 6] = np.eye(6)
    rows = np.vstack([*locked, moves])
    goal = np.zeros(len(rows))
    goal[-4] = 1.0
    saddle = np.block([[metric, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    motion = np.linalg.lstsq(saddle, np.append(np.zeros(6 * count), goal), rcond=None)[0]
    motion = motion[: 6 * count]
    assert np.abs(rows @ motion - goal).max() < 1.0e-9
    return float(motion @ metric @ motion)


@pytest.mark.usefixtures("shared_kernels")
@pytest.mark.parametrize("foot", [0, -1])
@pytest.mark.parametrize(
    "kinds",
    [("ball",), ("revolute",), ("prismatic",), ("fixed",), ("revolute", "ball", "prismatic")],
)
def test_the_penalty_is_that_of_what_moves_with_the_foot(kinds: tuple[str, ...], foot: int) -> None:
    """Within 1e-3: blocks of float32, and a load of 10^5 times the foot."""
    at = foot % (len(kinds) + 1)
    sim, steps = standing(*kinds, load=1000.0, foot=at, speed=1.0)
    expected = LINK_WEIGHT * mass_without_turning(sim, at, kinds, steps)
    sim.step()
    rows = sim.solver._rows
    row = rows.rows.numpy()[rows.owned_start.numpy()[at]]
    assert row["k_n"] * sim.dt**2 / PENALTY == pytest.approx(expected, rel=1.0e-3)


@pytest.mark.parametrize("kind", ["fixed", "revolute"])
def test_a_foot_stops_a_load_of_a_hundred_thousand_times_its_mass(kind: str) -> None:
    """Straight above it, at 3 m/s, within a step.

    By the penalty of the foot alone the load goes on at 3 m/s, 13 mm into the ground.
    """
    builder = newton.ModelBuilder()
    add_ground(builder)
    inertia = np.diag([0.01, 0.01, 0.01])
    foot = add_link(builder, mass=FOOT, inertia=FOOT * inertia, xform=transform((0, 0, 0.1)))
    load = add_link(builder, mass=1000.0, inertia=1000.0 * inertia, xform=transform((0, 0, 0.6)))
    for body in (foot, load):
        builder.body_qd[body] = (0.0, 0.0, -3.0, 0.0, 0.0, 0.0)
    add = getattr(builder, f"add_joint_{kind}")
    ends = {"parent_xform": transform((0, 0, 0.25)), "child_xform": transform((0, 0, -0.25))}
    builder.add_articulation([builder.add_joint_free(foot), add(foot, load, **ends)])
    builder.add_shape_box(foot, hx=0.2, hy=0.2, hz=0.1, cfg=surface(density=0.0))
    sim = Simulation(builder)
    sim.step()
    assert np.abs(sim.velocity[load]).max() < 1.0e-4
    assert sim.penetration < 1.0e-6


@pytest.mark.parametrize("moment", [1.0e-6, 1.0e-5, 0.1])
def test_what_joints_carry_lands_on_a_link_without_a_moment_of_inertia(moment: float) -> None:
    """10 kg with the moment that files have for a placeholder, under a mast of 5 kg, at 1 m/s.

    A ball beside its center of mass touches the ground first. The hinge between the two is upright,
    so they turn as one, by the impulse v/(1/M + d^2/I), and the ball stops within the step.
    """
    beside, up, radius, speed = 0.2, 0.4, 0.05, 1.0
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    add_ground(builder)
    base = add_link(builder, mass=10.0, inertia=moment * np.eye(3), xform=transform((0, 0, radius)))
    own = np.diag([0.03, 0.05, 0.04])  # nothing turns the base about the hinge
    mast = add_link(builder, mass=5.0, inertia=own, xform=transform((0, 0, radius + up)))
    for body in (base, mast):
        builder.body_qd[body] = (0.0, 0.0, -speed, 0.0, 0.0, 0.0)
    ends = {"child_xform": transform((0, 0, -up)), "axis": (0.0, 0.0, 1.0)}
    joints = [builder.add_joint_free(base), builder.add_joint_revolute(base, mast, **ends)]
    builder.add_articulation(joints)
    surfaces = surface(density=0.0, mu=0.0)
    builder.add_shape_sphere(base, xform=transform((beside, 0, 0)), radius=radius, cfg=surfaces)
    sim = Simulation(builder)
    assert sim.solver.effects.flags.light_links == (moment < 0.01)
    sim.step()
    above = 5.0 * up / 15.0
    about = 0.05 + moment + 10.0 * above**2 + 5.0 * (up - above) ** 2
    impulse = speed / (1.0 / 15.0 + beside**2 / about)
    spin = -beside * impulse / about
    np.testing.assert_allclose(sim.velocity[:2, 3:], [[0, spin, 0]] * 2, atol=1.0e-2)
    assert sim.velocity[base, 2] == pytest.approx(beside * spin, abs=1.0e-3)


def test_only_light_links_are_looked_after() -> None:
    """A foot of a hundredth of the load is none: its contacts are as they are without a load."""
    assert standing("ball", load=1000.0)[0].solver.effects.flags.light_links
    assert not standing("ball", load=100.0 * FOOT)[0].solver.effects.flags.light_links


def test_fingers_that_do_not_touch_leave_their_arm_free():
    # Two fingers of 1 g side by side, 0.02 mm apart, at the end of an arm that a torque turns:
    # their contact stays open, and the rate is T t / I of all three. As stiff as an arm to stop,
    # it took half of that.
    torque, seconds, end = 0.5, 0.1, 0.55
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    arm = add_link(builder, mass=2.0, inertia=np.diag([1.0e-3, 0.03, 0.03]), com=(0.25, 0.0, 0.0))
    joints = [builder.add_joint_revolute(-1, arm, axis=(0.0, 0.0, 1.0))]
    about = 0.03 + 2.0 * 0.25**2
    for side in (-0.01001, 0.01001):
        place = transform((end, side, 0.0))
        finger = add_link(builder, mass=1.0e-3, inertia=1.0e-7 * np.eye(3), xform=place)
        builder.add_shape_box(finger, hx=0.04, hy=0.01, hz=0.01, cfg=surface(density=0.0))
        hold = {"parent_xform": place, "axis": (1.0, 0.0, 0.0), "target_ke": 10.0}
        joints.append(builder.add_joint_revolute(arm, finger, **hold, target_kd=0.01))
        about += 1.0e-7 + 1.0e-3 * (end**2 + side**2)
    builder.add_articulation(joints)
    sim = Simulation(builder)
    sim.control.joint_f.assign(np.array([torque, 0.0, 0.0], np.float32))
    sim.run(seconds)
    assert sim.velocity[arm, 5] == pytest.approx(torque * seconds / about, rel=1.0e-4)
