# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints that turn by more than half a revolution a step, which orientations do not tell."""

from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, Simulation, in_float32
from joint_scenes import (
    add_contact,
    add_link,
    set_control,
    set_coordinates,
    simulate,
    transform,
)
from scipy.spatial.transform import Rotation

from newton_avbd.study.stability.case import Trial
from newton_avbd.study.stability.cases import CASES
from newton_avbd.study.stability.steps import CAR_DRIVE, CAR_SPEED, CAR_WHEEL

pytestmark = pytest.mark.usefixtures("shared_kernels")

WHEEL = 0.1
"""Moment of inertia of a wheel about its axis [kg m^2]."""
BASE = 2.0
"""That of a free base about any axis."""
FRAME = Rotation.from_euler("xyz", [0.5, -0.8, 1.9])
AXIS = (0.0, 1.0, 0.0)
SPEED = 2000.0
"""8.3 radians a step [rad/s]."""
KINDS = ["hinge", "d6", "ball", "flipped", "bearings", "colored"]


def motor(
    kind: str, speed: float, *, is_free: bool = False, angle: float = 0.0, **settings: Any
) -> Simulation:
    """A wheel that turns at ``speed`` [rad/s] on a held or a free base, without gravity.

    By a hinge, a D6 or a ball; the parent of its base (``flipped``); between two ``bearings``;
    solved color by color. ``settings`` are those of the axis.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    base = add_link(builder, mass=3.0, inertia=(BASE, BASE, BASE), is_kinematic=not is_free)
    # what turns about a ball goes over to its greatest moment of inertia
    across = 0.06 if kind == "ball" else 0.3
    wheel = add_link(builder, inertia=(across, WHEEL, across))
    at_base = transform(rotation=FRAME)
    turned_by = Rotation.from_rotvec(angle * np.array(AXIS))
    builder.body_q[wheel] = transform(rotation=FRAME * turned_by)
    how: dict[str, Any] = {"update_joint_state": True}
    if kind == "flipped":
        joint = builder.add_joint_revolute(wheel, base, child_xform=at_base, axis=AXIS, **settings)
    elif kind == "d6":
        axis = newton.ModelBuilder.JointDofConfig(axis=AXIS, **settings)
        joint = builder.add_joint_d6(base, wheel, angular_axes=[axis], parent_xform=at_base)
    elif kind == "ball":
        joint = builder.add_joint_ball(base, wheel, parent_xform=at_base, **settings)
    else:
        joint = builder.add_joint_revolute(base, wheel, parent_xform=at_base, axis=AXIS, **settings)
    if kind != "flipped":
        builder.add_articulation([joint])
    set_coordinates(builder, joint, [-angle if kind == "flipped" else angle])
    if kind == "bearings":
        away = transform(0.3 * FRAME.apply(AXIS), FRAME)
        along = transform(0.3 * np.array(AXIS))
        builder.add_joint_revolute(base, wheel, parent_xform=away, child_xform=along, axis=AXIS)
    if kind == "colored":
        how |= {"parallel": "bodies"}
        add_contact(builder, wheel)
    is_checked = kind != "flipped"
    sim = Simulation(builder, collide=kind == "colored", is_checked=is_checked, **how)
    assert kind != "colored" or sim.solver.parallel == "bodies"
    sim.set_velocity(wheel, angular=FRAME.apply(AXIS) * speed)
    return sim


def relative_speed(sim: Simulation) -> float:
    """How fast the wheel turns against its base, about its axis [rad/s]."""
    base, wheel = sim.velocity[:, 3:]
    return float((wheel - base) @ FRAME.apply(AXIS))


def turned(sim: Simulation, kind: str) -> float:
    """The angle of the joint, as ``joint_q`` has it [rad]."""
    angle = float(sim.state.joint_q.numpy()[-1])
    return -angle if kind == "flipped" else angle


@pytest.mark.parametrize("is_free", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_what_damps_follows_the_implicit_law(kind: str, is_free: bool) -> None:
    """w' = I w / (I + h c) of the speed w between the bodies, I = I_w I_b / (I_w + I_b).

    Twelve steps of 8.3 down to 5.1 radians each, to 2e-6 of the speed at first; the angular
    momentum stays as it is. Taken for the turn within half a revolution the speed was off by a
    tenth in a step.
    """
    sim = motor(kind, SPEED, is_free=is_free, damping=1.0)
    inertia = WHEEL * BASE / (WHEEL + BASE) if is_free else WHEEL
    before = sim.spin_momentum.sum(axis=0)
    speed, h = SPEED, in_float32(sim.dt)
    for _ in range(12):
        sim.step()
        speed *= inertia / (inertia + h * 1.0)
        assert relative_speed(sim) == pytest.approx(speed, abs=2.0e-6 * SPEED)
    if is_free:
        assert sim.spin_momentum.sum(axis=0) == pytest.approx(before, abs=1.0e-5 * 0.1 * SPEED)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "ball"])
def test_a_drive_reaches_its_speed(kind: str) -> None:
    """From rest to 2,000 rad/s: w' = (I w + h kd target) / (I + h kd), and turns are counted.

    It accelerates by 2 radians a step squared and ends at 8.3 a step; once that went to 70,000
    rad/s.
    """
    sign = -1.0 if kind == "flipped" else 1.0
    drive = newton.JointTargetMode.VELOCITY
    sim = motor(kind, 0.0, target_kd=10.0, actuator_mode=drive)
    set_control(sim, joint_target_qd=[sign * SPEED])
    speed = angle = 0.0
    h = in_float32(sim.dt)
    for _ in range(48):
        sim.step()
        speed = (WHEEL * speed + h * 10.0 * SPEED) / (WHEEL + h * 10.0)
        angle += h * speed
        assert relative_speed(sim) == pytest.approx(speed, abs=1.0e-5 * SPEED)
        assert turned(sim, kind) == pytest.approx(angle, abs=1.0e-5 * angle)
    assert angle > 300.0


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "ball"])
def test_a_drive_comes_to_a_far_angle(kind: str) -> None:
    """Sent to 40 rad by a spring, it goes by up to 3.9 radians a step, as the law has it."""
    sign = -1.0 if kind == "flipped" else 1.0
    drive = newton.JointTargetMode.POSITION
    sim = motor(kind, 0.0, target_ke=60.0, actuator_mode=drive)
    set_control(sim, joint_target_q=[sign * 40.0])
    speed = angle = 0.0
    h = in_float32(sim.dt)
    for _ in range(60):
        sim.step()
        speed = (WHEEL * speed + h * 60.0 * (40.0 - angle)) / (WHEEL + h * h * 60.0)
        angle += h * speed
        assert relative_speed(sim) == pytest.approx(speed, abs=1.0e-4 * 1000.0)
        assert turned(sim, kind) == pytest.approx(angle, abs=1.0e-4 * 40.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_flywheel_keeps_its_speed(kind: str) -> None:
    """The rotor behind a joint, its armature, turns as fast as the wheel: nothing slows it."""
    sim = motor(kind, SPEED, armature=0.1)
    sim.step(48)
    assert relative_speed(sim) == pytest.approx(SPEED, rel=1.0e-5)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "ball"])
def test_a_stop_is_not_passed_in_a_revolution(kind: str) -> None:
    """8.3 radians a step towards a stop at 2: the wheel ends there, and does not go round."""
    limits = {"limit_lower": -2.0, "limit_upper": 2.0}
    sim = motor(kind, SPEED, **limits)
    for _ in range(6):
        sim.step()
        assert abs(turned(sim, kind)) < 2.0 + 1.0e-3
    assert abs(relative_speed(sim)) < 1.0e-2 * SPEED


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "ball"])
def test_a_wheel_that_has_turned_for_hours_keeps_its_speed(kind: str) -> None:
    """After 400,000 rad, an hour at 100 rad/s, a driven wheel with a rotor jitters by 1e-4 rad/s.

    A float32 angle has a step of 0.03 rad there, 7.5 rad/s at 240 steps a second; the speed
    wandered by a twentieth.
    """
    sign = -1.0 if kind == "flipped" else 1.0
    drive = newton.JointTargetMode.VELOCITY
    settings = {"armature": 0.1, "target_kd": 1.0, "actuator_mode": drive}
    sim = motor(kind, 100.0, angle=4.0e5, **settings)
    set_control(sim, joint_target_qd=np.full(sim.model.joint_dof_count, sign * 100.0))
    for _ in range(240):
        sim.step()
        assert relative_speed(sim) == pytest.approx(100.0, abs=1.0e-3)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("speed", [200.0, 500.0, 1000.0])
def test_a_universal_joint_turns_unevenly(speed: float, parallel: str) -> None:
    """cos b <= w_2/w_1 <= 1/cos b for shafts at an angle b = 0.35 rad, on a bearing each.

    Up to 4.2 radians a step, for two seconds, to 1e-3; it takes both bounds on. The driven shaft
    has the speed that is asked for in the mean; the other one keeps its place and axis.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    bend = Rotation.from_euler("z", 0.35)
    axis = bend.apply([1.0, 0.0, 0.0])
    slim = (0.01, 0.1, 0.1)
    driven, output = add_link(builder, inertia=slim), add_link(builder, inertia=slim)
    drive = {"target_kd": 5.0, "actuator_mode": newton.JointTargetMode.VELOCITY}
    turning = newton.ModelBuilder.JointDofConfig
    joints = [
        builder.add_joint_revolute(-1, driven, axis=(1.0, 0.0, 0.0), target_qd=speed, **drive),
        builder.add_joint_d6(
            driven,
            output,
            angular_axes=[turning(axis=(0.0, 1.0, 0.0)), turning(axis=(0.0, 0.0, 1.0))],
            parent_xform=transform((0.5, 0.0, 0.0)),
            child_xform=transform((-0.5, 0.0, 0.0)),
        ),
    ]
    builder.add_articulation(joints)
    set_coordinates(builder, joints[1], [0.0, 0.35])
    place = np.array([0.5, 0.0, 0.0]) + 0.5 * axis
    builder.add_joint_revolute(-1, output, parent_xform=transform(place, bend), axis=(1, 0, 0))
    if parallel == "bodies":
        add_contact(builder, output)
    sim = simulate(builder, collide=parallel == "bodies", parallel=parallel)
    assert sim.solver.parallel == parallel
    ratios, speeds = [], []
    for _ in range(480):
        sim.step()
        speeds.append(sim.velocity[driven, 3])
        spin = sim.velocity[output, 3:]
        ratios.append(spin @ axis / speeds[-1])
        assert np.linalg.norm(spin - (spin @ axis) * axis) < 1.0e-3 * speed
    assert np.mean(speeds[240:]) == pytest.approx(speed, rel=5.0e-3)
    assert min(ratios) == pytest.approx(np.cos(0.35), abs=1.0e-3)
    assert max(ratios) == pytest.approx(1.0 / np.cos(0.35), abs=1.0e-3)
    assert sim.center[output] == pytest.approx(place, abs=1.0e-4)
    assert sim.solver.status.held_steps.max() == 0


def test_a_motor_on_what_rests_starts() -> None:
    """More radians in the first step than iterations turn a link by: no impact has to lose them.

    A spindle on a box on the ground, asked for 50 radians a step, stood still for good.
    """
    builder = newton.ModelBuilder()
    builder.add_ground_plane()
    box = builder.add_link(xform=transform((0.0, 0.0, 0.25)))
    density = newton.ModelBuilder.ShapeConfig(density=400.0)
    builder.add_shape_box(box, hx=0.5, hy=0.5, hz=0.25, cfg=density)
    spindle = add_link(builder, inertia=(0.01, 0.01, 0.015))
    builder.body_q[spindle] = transform((0.0, 0.0, 0.75))
    above = transform((0.0, 0.0, 0.5))
    drive = {"target_kd": 10.0, "actuator_mode": newton.JointTargetMode.VELOCITY}
    free = builder.add_joint_free(box)
    hinge = builder.add_joint_revolute(
        box, spindle, parent_xform=above, axis=(0.0, 0.0, 1.0), target_qd=3000.0, **drive
    )
    builder.add_articulation([free, hinge])
    sim = Simulation(builder, dt=1.0 / 60.0)
    sim.step(30)
    assert sim.velocity[spindle, 5] == pytest.approx(3000.0, rel=1.0e-4)
    assert sim.center[box] == pytest.approx([0.0, 0.0, 0.25], abs=1.0e-4)


@pytest.mark.parametrize("is_root", [False, True])
@pytest.mark.parametrize(("across", "speed"), [(0.2, 400.0), (0.2, 2000.0), (0.1, 700.0)])
def test_a_shaft_in_a_free_housing_keeps_its_spin(
    across: float, speed: float, is_root: bool
) -> None:
    """Also one that is the root of its tree: for a second, and the angular momentum with it.

    As the root it gained energy without bounds. One of equal moments kept to its axis from 1,000
    rad/s on only.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    shaft_of = {"inertia": (across, WHEEL, across)}
    housing_of = {"mass": 3.0, "inertia": (BASE, BASE, 2.1)}
    if is_root:
        shaft, housing = add_link(builder, **shaft_of), add_link(builder, **housing_of)
    else:
        housing, shaft = add_link(builder, **housing_of), add_link(builder, **shaft_of)
    place = transform(rotation=FRAME)
    builder.body_q[shaft] = place
    xform = {"child_xform" if is_root else "parent_xform": place}
    ends = (shaft, housing) if is_root else (housing, shaft)
    builder.add_articulation([builder.add_joint_revolute(*ends, axis=AXIS, **xform)])
    sim = Simulation(builder, collide=False, is_checked=False)
    sim.set_velocity(shaft, angular=FRAME.apply(AXIS) * speed)
    before = sim.spin_momentum.sum(axis=0)
    sim.step(960 if across == 0.1 else 240)
    axis = Rotation.from_quat(sim.pose[shaft, 3:]).apply(AXIS)
    assert sim.velocity[shaft, 3:] @ axis == pytest.approx(speed, rel=1.0e-4)
    lost = np.linalg.norm(sim.spin_momentum.sum(axis=0) - before)
    assert lost < 5.0e-5 * np.linalg.norm(before)


@pytest.mark.parametrize(("speed", "frame"), [(500.0, 5.0), (2000.0, 5.0)])
def test_a_flywheel_in_a_frame_that_turns_keeps_its_speed(speed: float, frame: float) -> None:
    """A second at 2 and 8 radians a step, about an axis that goes round at 0.02, to 2 %.

    To take off what is across the axis at the end of each step took 14 %.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    base = add_link(builder, mass=3.0, inertia=(BASE, BASE, BASE), is_kinematic=True)
    wheel = add_link(builder, inertia=(0.06, WHEEL, 0.06))
    builder.add_articulation([builder.add_joint_revolute(base, wheel, axis=AXIS)])
    sim = simulate(builder)
    sim.set_velocity(base, angular=(0.0, 0.0, frame))
    sim.set_velocity(wheel, angular=(0.0, speed, frame))
    for k in range(240):
        sim.step()
        pose, velocity = sim.pose, sim.velocity
        pose[base, 3:] = Rotation.from_rotvec([0.0, 0.0, frame * sim.dt * (k + 1)]).as_quat()
        velocity[base] = [0.0, 0.0, 0.0, 0.0, 0.0, frame]
        sim.state.body_q.assign(pose.astype(np.float32))
        sim.state.body_qd.assign(velocity.astype(np.float32))
    axis = Rotation.from_quat(sim.pose[wheel, 3:]).apply(AXIS)
    assert sim.velocity[wheel, 3:] @ axis == pytest.approx(speed, rel=0.02)


@pytest.mark.parametrize("speed", [800.0, 2000.0])
def test_turns_about_one_of_three_axes_are_not_counted_for_the_others(speed: float) -> None:
    """The first and the last are not square to each other, where the middle one is tilted.

    What turns about the last by up to 8.3 radians a step was counted a revolution a step about
    the first.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    base = add_link(builder, mass=3.0, inertia=(BASE, BASE, BASE), is_kinematic=True)
    wheel = add_link(builder, inertia=(0.06, 0.06, WHEEL))
    axes = [newton.ModelBuilder.JointDofConfig(axis=axis) for axis in np.eye(3)]
    joint = builder.add_joint_d6(base, wheel, angular_axes=axes)
    builder.add_articulation([joint])
    set_coordinates(builder, joint, [0.0, 0.5, 0.0], [0.0, 0.0, speed])
    sim = simulate(builder, update_joint_state=True)
    sim.step(24)
    expected = [0.0, 0.5, 24 * sim.dt * speed]
    assert sim.state.joint_q.numpy()[-3:] == pytest.approx(expected, abs=2.0e-3)


def test_the_bends_of_a_rod_do_not_go_round() -> None:
    """A shaft of 3:2 at rest in its bend, that spins by 8.3 radians a step, stays in it."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    bend = Rotation.from_euler("x", 0.5)
    shaft = add_link(builder, inertia=(0.02, 0.02, 0.03))
    builder.body_q[shaft] = transform(rotation=bend)
    stiffness = {"stretch_stiffness": 1.0e4, "shear_stiffness": 1.0e4, "bend_stiffness": 0.5}
    rest = wp.quat(*bend.as_quat())
    joint = builder.add_joint_rod(-1, shaft, twist_stiffness=0.0, rest_rotation=rest, **stiffness)
    builder.add_articulation([joint])
    sim = Simulation(builder, collide=False)
    axis = bend.apply([0.0, 0.0, 1.0])
    sim.set_velocity(shaft, angular=axis * SPEED)
    sim.step(24)
    now = Rotation.from_quat(sim.pose[shaft, 3:]).apply([0.0, 0.0, 1.0])
    assert np.linalg.norm(np.cross(now, axis)) < 2.0e-4


def test_a_car_rolls_by_its_law() -> None:
    """v' = (m v + h D W/r) / (m + h D/r^2), from 3.3 to 5.5 radians a step, without slip.

    D is the sum of the drives, W the speed asked for, m the mass of all and I/r^2 of the wheels.
    To 1e-3 of the speed at the end, and the car keeps to its line. The motors ran away, and threw
    it over.
    """
    trial = Trial(CASES["fast_car"], "avbd")
    bodies, h, r = trial.bodies, 1.0 / 60.0, CAR_WHEEL
    mass = float(bodies.mass.sum() + trial.model.body_inertia.numpy()[1:, 1, 1].sum() / r**2)
    speed = 0.5 * r * CAR_SPEED
    for _ in range(1200):
        trial.step(h)
        pull = h * 4.0 * CAR_DRIVE / r
        speed = (mass * speed + pull * CAR_SPEED) / (mass + pull / r)
        assert trial.velocities()[0, 0] == pytest.approx(speed, abs=1.0e-3 * r * CAR_SPEED)
    assert speed > 0.8 * r * CAR_SPEED
    assert abs(trial.centers()[0, 1]) < 1.0e-2
