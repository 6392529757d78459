# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""``notify_model_changed`` flag by flag: change, notify, and the motion follows."""

import dataclasses

import newton
import numpy as np
import pytest
import warp as wp
from contract import resting_box, worlds
from helpers import NO_GRAVITY, G, Simulation, add_box, add_ground, add_sphere
from joint_scenes import (
    WORLD,
    add_hinge_chain,
    add_link,
    anchor_gaps,
    set_control,
    simulate,
    transform,
)
from newton import ModelFlags
from test_equality_loops import four_bar

from newton_avbd import Effects, SolverAVBD

DT = 1.0 / 240.0
KINEMATIC, DYNAMIC = int(newton.BodyFlags.KINEMATIC), int(newton.BodyFlags.DYNAMIC)


def slider(
    mass: float = 2.0, gravity: tuple = NO_GRAVITY, **settings: float
) -> newton.ModelBuilder:
    """A body of 2 kg that slides along z."""
    builder = newton.ModelBuilder(gravity=gravity)
    link = add_link(builder, mass=2.0)
    joint = builder.add_joint_prismatic(WORLD, link, axis=(0.0, 0.0, 1.0), **settings)
    builder.add_articulation([joint])
    return builder


def driven(mass: float, ke: float, kd: float, target: float, steps: int) -> float:
    """Where implicit steps of a driven slider get from rest at 0 [m]."""
    q = v = 0.0
    for _ in range(steps):
        v = (mass * v + DT * ke * (target - q)) / (mass + DT * kd + DT * DT * ke)
        q += DT * v
    return q


# Joints


def test_a_joints_axis_can_turn() -> None:
    """A slider along x holds its body against gravity; along z it lets it fall, v = g t."""
    sim = simulate(slider(gravity=(-G, 0.0, 0.0)))
    sim.step(10)
    np.testing.assert_allclose(sim.velocity, 0.0, atol=1e-6)
    sim.model.joint_axis.assign([(1.0, 0.0, 0.0)])
    sim.solver.notify_model_changed(ModelFlags.JOINT_PROPERTIES)
    sim.step(10)
    assert sim.velocity[0, 0] == pytest.approx(-G * 10 * DT, rel=1e-5)


@pytest.mark.parametrize("array", ["joint_X_p", "joint_X_c"])
def test_a_joints_frame_can_move(array: str) -> None:
    """A welded body goes where its anchor went, without a kick, and stays: to 1e-5 m."""
    builder = newton.ModelBuilder()
    link = add_link(builder)
    builder.add_articulation([builder.add_joint_fixed(WORLD, link)])
    sim = simulate(builder)
    sim.step(5)
    getattr(sim.model, array).assign([transform((0.02, 0.0, 0.01))])
    sim.solver.notify_model_changed(ModelFlags.JOINT_PROPERTIES)
    sim.step(60)
    sign = 1.0 if array == "joint_X_p" else -1.0
    np.testing.assert_allclose(sim.pose[0, :3], [sign * 0.02, 0.0, sign * 0.01], atol=1e-5)
    np.testing.assert_allclose(sim.velocity, 0.0, atol=1e-4)


def test_the_turns_that_a_reset_goes_back_to_can_change() -> None:
    """A hinge whose initial angle is now two turns ahead, as its target is: it stays after a reset.

    With the old turns the drive would throw it two turns forward.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_hinge_chain(builder, 1, target_ke=100.0, target_kd=1.0)
    sim = simulate(builder)
    sim.step(5)
    sim.model.joint_q.assign([4.0 * np.pi])
    set_control(sim, joint_target_q=[4.0 * np.pi])
    sim.solver.notify_model_changed(ModelFlags.JOINT_PROPERTIES)
    sim.solver.reset(sim.state)
    sim.step(10)
    np.testing.assert_allclose(sim.velocity, 0.0, atol=1e-3)


@pytest.mark.parametrize(
    "flag", [ModelFlags.JOINT_DOF_PROPERTIES, ModelFlags.JOINT_DOF_FORCE_PROPERTIES, ModelFlags.ALL]
)
@pytest.mark.parametrize("absent", ["gain", "mode"])
def test_a_drive_can_come(flag: ModelFlags, absent: str) -> None:
    """Where no joint had one, by its gains or its mode: then as the implicit spring, to 1e-5."""
    mode = newton.JointTargetMode
    builder = slider(
        target_ke=50.0 * (absent == "mode"),
        target_kd=3.0 * (absent == "mode"),
        actuator_mode=mode.NONE if absent == "mode" else mode.POSITION,
    )
    sim = simulate(builder, scheme="euler")
    set_control(sim, joint_target_q=[0.3])
    sim.step(10)
    np.testing.assert_allclose(sim.pose[0, 2], 0.0, atol=1e-7)
    sim.model.joint_target_ke.fill_(50.0)
    sim.model.joint_target_kd.fill_(3.0)
    sim.model.joint_target_mode.fill_(int(mode.POSITION))
    sim.solver.notify_model_changed(flag)
    sim.step(100)
    assert sim.pose[0, 2] == pytest.approx(driven(2.0, 50.0, 3.0, 0.3, 100), rel=1e-5)


def test_a_limit_can_come() -> None:
    """A falling slider that had none stops at it, to 1e-5 m."""
    sim = simulate(slider(gravity=(0.0, 0.0, -G)))
    sim.step(10)
    sim.model.joint_limit_lower.fill_(-0.05)
    sim.solver.notify_model_changed(ModelFlags.JOINT_DOF_FORCE_PROPERTIES)
    sim.step(60)
    assert sim.pose[0, 2] == pytest.approx(-0.05, abs=1e-5)


def test_a_rod_can_get_another_shape_at_rest() -> None:
    """A damped rod goes to the twist that it now has at rest, within 1 %."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    links = [add_link(builder, inertia=(0.01, 0.01, 0.01)) for _ in range(2)]
    weld = builder.add_joint_fixed(WORLD, links[0])
    rod = builder.add_joint_rod(
        links[0], links[1], bend_stiffness=2.0, twist_stiffness=2.0, twist_damping=0.2
    )
    builder.add_articulation([weld, rod])
    sim = simulate(builder)
    sim.step(5)
    rest = sim.model.joint_rest_q.numpy()
    rest[-4:] = [0.0, 0.0, np.sin(0.15), np.cos(0.15)]
    sim.model.joint_rest_q.assign(rest)
    sim.solver.notify_model_changed(ModelFlags.JOINT_REFERENCE_POSE_PROPERTIES)
    sim.step(480)
    twist = 2.0 * np.arcsin(sim.pose[1, 5])
    assert twist == pytest.approx(0.3, rel=0.01)


# Bodies


def test_a_kinematic_root_can_be_freed_and_its_joint_holds_it() -> None:
    """Its joint to the world did nothing; then the two links are the chain they would have been."""

    def chain(flag: int) -> newton.ModelBuilder:
        builder = newton.ModelBuilder()
        add_hinge_chain(builder, 2, length=0.3)
        builder.body_flags[0] = flag
        builder.joint_enabled[1] = flag == DYNAMIC  # the child waits
        return builder

    freed, expected = simulate(chain(KINEMATIC)), simulate(chain(DYNAMIC))
    freed.push(1, (0.0, 0.0, G))
    freed.step(5)
    np.testing.assert_allclose(freed.velocity, 0.0, atol=1e-5)
    freed.model.body_flags.fill_(DYNAMIC)
    freed.model.joint_enabled.fill_(True)
    freed.push(1)
    freed.solver.notify_model_changed(ModelFlags.BODY_PROPERTIES | ModelFlags.JOINT_PROPERTIES)
    freed.step(60)
    expected.step(60)
    assert anchor_gaps(freed).max() < 1e-5
    np.testing.assert_allclose(freed.pose, expected.pose, atol=2e-4)


def test_a_mass_can_change() -> None:
    """Six newtons on 2 kg, then on 3 kg: v = F t/m, without contacts, by joints or free."""
    sim = simulate(slider())
    sim.push(0, (0.0, 0.0, 6.0))
    sim.step(24)
    assert sim.velocity[0, 2] == pytest.approx(0.3, rel=1e-5)
    for name, factor in (("mass", 1.5), ("inertia", 1.5)):
        for array, by in ((f"body_{name}", factor), (f"body_inv_{name}", 1.0 / factor)):
            values = getattr(sim.model, array)
            values.assign(values.numpy() * by)
    sim.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
    sim.step(24)
    assert sim.velocity[0, 2] == pytest.approx(0.5, rel=1e-5)


def spinning_pair() -> newton.ModelBuilder:
    """Two rods that float and turn on their hinge."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    first, second = add_link(builder, mass=1.0), add_link(builder, mass=1.0)
    free = builder.add_joint_free(first)
    ends = {"parent_xform": transform((0.2, 0, 0)), "child_xform": transform((-0.2, 0, 0))}
    hinge = builder.add_joint_revolute(first, second, axis=(1.0, 0.0, 0.0), **ends)
    builder.add_articulation([free, hinge])
    builder.joint_qd[3:] = [0.0, 0.0, 8.0, -4.0]
    return builder


def test_masses_that_change_in_motion_give_no_energy() -> None:
    """A step that went on with the accelerations of the old ones gained 1.2 % of it.

    One after a notice of the same masses goes on, to the same bits.
    """
    sim, same = simulate(spinning_pair()), simulate(spinning_pair())
    sim.step(20)
    same.step(20)
    sim.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
    sim.step()
    same.step()
    np.testing.assert_array_equal(sim.velocity, same.velocity)
    assert sim.solver.report().order[0] == 2
    factor = np.array([5.0, 0.2])
    for name, by in (("", factor), ("inv_", 1.0 / factor)):
        for kind in ("mass", "inertia"):
            values = getattr(sim.model, f"body_{name}{kind}")
            values.assign((values.numpy().T * by).T.astype(np.float32))
    sim.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
    before = sim.kinetic_energy
    sim.step()
    assert sim.solver.report().order[0] == 1
    assert sim.kinetic_energy < (1.0 + 1.0e-4) * before
    sim.step(3)
    assert sim.solver.report().order[0] == 2


def test_a_center_of_mass_can_change() -> None:
    """A wheel on its axle rests; out of balance it starts with m g d/(I + m d^2), within 0.1 %."""
    builder = newton.ModelBuilder()
    link = add_link(builder, mass=2.0, inertia=(0.1, 0.1, 0.1))
    builder.add_articulation([builder.add_joint_revolute(WORLD, link, axis=(0.0, 1.0, 0.0))])
    sim = simulate(builder)
    sim.step(10)
    np.testing.assert_allclose(sim.velocity, 0.0, atol=1e-7)
    sim.model.body_com.assign([(0.1, 0.0, 0.0)])
    sim.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)
    sim.step(2)
    expected = 2.0 * G * 0.1 / (0.1 + 2.0 * 0.1**2)
    assert sim.velocity[0, 4] == pytest.approx(expected * 2 * DT, rel=1e-3)


@pytest.mark.parametrize("name", ["mass", "inertia"])
def test_a_mass_that_is_changed_without_its_inverse_is_refused(name: str) -> None:
    """Both are read; the message names the body and the array."""
    sim = simulate(slider())
    array = getattr(sim.model, f"body_{name}")
    array.assign(1.5 * array.numpy())
    with pytest.raises(ValueError, match=rf"body_inv_{name}\[0\].*not the inverse of body_{name}"):
        sim.solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)


# Shapes and constraints


def test_a_shape_can_move_on_its_body() -> None:
    """A cube whose collider is moved up by 5 cm sinks until that touches: to 1e-4 m."""
    sim = Simulation(resting_box())
    sim.step(10)
    poses = sim.model.shape_transform.numpy()
    poses[1, 2] = 0.05
    sim.model.shape_transform.assign(poses)
    sim.solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
    sim.step(120)
    assert sim.pose[0, 2] == pytest.approx(0.2, abs=1e-4)


def test_a_material_can_soften() -> None:
    """A compliant cube sinks by m g/(4 ke), before and after a change of ke; within 2 %."""
    builder = newton.ModelBuilder()
    soft = {"ke": 1.0e5, "kd": 4.0e3}
    add_ground(builder, **soft)
    add_box(builder, (0.0, 0.0, 0.25), **soft)
    sim = Simulation(builder, compliant_contacts=True)
    for ke in (1.0e5, 4.0e4):
        sim.model.shape_material_ke.fill_(ke)
        sim.solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
        sim.run(2.0)
        assert 0.25 - sim.pose[0, 2] == pytest.approx(sim.mass[0] * G / (4.0 * ke), rel=0.02)


def shapes_of_choice() -> newton.ModelBuilder:
    """A body above the ground that is a cube with edges of 0.5 m, or a ball with radius 0.15 m."""
    choices = [newton.ModelBuilder() for _ in range(2)]
    add_box(choices[0], (0.0, 0.0, 0.0))
    add_sphere(choices[1], (0.0, 0.0, 0.0), radius=0.15)
    builder = newton.ModelBuilder()
    add_ground(builder)
    body = builder.add_body(xform=wp.transform((0.0, 0.0, 0.25), wp.quat_identity()))
    builder.add_body_variants(body, choices)
    return builder


def test_a_shape_can_become_another() -> None:
    """Cubes rest; the one that turns into a ball falls and rests on its radius, as a ball rolls.

    With the drawn mass and inertia: under a force F at its centre a = F/(m + I/r^2).
    """
    sim = Simulation(worlds(shapes_of_choice(), 2))
    sim.step(10)
    changed = sim.model.select_body_variants(wp.array([1, 0], dtype=wp.int32, device="cpu"))
    assert changed & ModelFlags.SHAPE_TYPE_AND_SOURCE
    sim.solver.notify_model_changed(changed)
    sim.step(60)
    np.testing.assert_allclose(sim.pose[:, 2], [0.15, 0.25], atol=1e-4)
    mass = 1000.0 * 4.0 / 3.0 * np.pi * 0.15**3
    sim.push(0, (20.0, 0.0, 0.0))
    sim.step(24)
    assert sim.velocity[0, 0] == pytest.approx(20.0 / (1.4 * mass) * 24 * DT, rel=0.01)


LEFT_OUT = '<connect name="loop" body1="left" body2="left" anchor="0 0 0" active="false"/>'
"""Ties a body to itself."""


def test_a_constraint_that_is_switched_on_and_left_out_is_named() -> None:
    """MuJoCo's equality constraint of one body: a warning again, or the error again."""
    builder = four_bar(more=LEFT_OUT, convert=False)
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, strict=True)
    model.mujoco.equality_constraint_enabled.fill_(True)
    with pytest.raises(NotImplementedError, match="'loop'"):
        solver.notify_model_changed(ModelFlags.CONSTRAINT_PROPERTIES)


def test_what_is_left_out_is_named_also_where_links_become_one_body() -> None:
    """An equality that is switched on beside a weld that is switched off, by one call."""
    builder = four_bar(more=LEFT_OUT, convert=False)
    links = [builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3))) for _ in range(2)]
    free, weld = builder.add_joint_free(links[0]), builder.add_joint_fixed(*links)
    builder.add_articulation([free, weld])
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, strict=True)
    model.mujoco.equality_constraint_enabled.fill_(True)
    enabled = model.joint_enabled.numpy().copy()
    enabled[weld] = False
    model.joint_enabled.assign(enabled)
    with pytest.raises(NotImplementedError, match="'loop'"):
        solver.notify_model_changed(ModelFlags.ALL)


# Inside of graphs


@wp.kernel
def draw_values(
    draws: wp.array2d[float],
    shape_world: wp.array[wp.int32],
    mass: wp.array[float],
    inv_mass: wp.array[float],
    ke: wp.array[float],
    kd: wp.array[float],
    mu: wp.array[float],
):
    """Gives each world its mass [kg], gains of its slider and friction."""
    world = wp.tid()
    if mass.shape[0] > 0:
        mass[world] = draws[world, 0]
        inv_mass[world] = 1.0 / draws[world, 0]
    if ke.shape[0] > 0:
        ke[world] = draws[world, 1]
        kd[world] = draws[world, 2]
    for shape in range(mu.shape[0]):
        if shape_world[shape] == world:
            mu[shape] = draws[world, 3]


DRAWS = np.array([[1.0, 20.0, 1.0, 0.1], [2.0, 80.0, 0.0, 0.2], [4.0, 5.0, 8.0, 0.3]])


def randomised(sim: Simulation, draws: wp.array, steps: int, *, notify: bool) -> wp.Graph:
    """A graph that takes the draws, says so if asked to, and takes steps."""
    model = sim.model
    with wp.ScopedCapture(device="cpu") as capture:
        wp.launch(
            draw_values,
            dim=model.world_count,
            inputs=[
                draws,
                model.shape_world,
                model.body_mass,
                model.body_inv_mass,
                model.joint_target_ke,
                model.joint_target_kd,
                model.shape_material_mu,
            ],
            device="cpu",
        )
        if notify:
            sim.solver.notify_model_changed(ModelFlags.ALL)
        sim.step(steps)
    return capture.graph


@pytest.mark.parametrize("gain", [1.0, 0.0])
def test_masses_and_gains_are_drawn_by_world_in_a_graph(gain: float) -> None:
    """Each replay simulates each world with the draw of the moment: the implicit spring, to 1e-5.

    Without gains at first there is no code for drives: then the graph must notify.
    """
    sim = simulate(worlds(slider(target_ke=gain, target_kd=gain), 3), scheme="euler")
    sim.model.joint_target_mode.fill_(int(newton.JointTargetMode.POSITION))
    set_control(sim, joint_target_q=[0.3, 0.3, 0.3])
    draws = wp.array(DRAWS, dtype=float, device="cpu")
    graph = randomised(sim, draws, 60, notify=gain == 0.0)
    for values in (DRAWS, DRAWS[::-1]):
        draws.assign(values.astype(np.float32))
        sim.solver.reset(sim.state)
        wp.capture_launch(graph)
        expected = [driven(m, ke, kd, 0.3, 60) for m, ke, kd, _ in values]
        np.testing.assert_allclose(sim.pose[:, 2], expected, rtol=1e-5)


def test_targets_and_limits_are_drawn_by_world_in_a_graph() -> None:
    """Sliders that had no limit go to their world's target or stop: as the spring says, to 1e-5."""
    sim = simulate(worlds(slider(target_ke=200.0, target_kd=40.0), 3), scheme="euler")
    sim.model.joint_target_mode.fill_(int(newton.JointTargetMode.POSITION))
    targets, limits = np.array([0.3, 0.15, 0.4]), np.array([0.1, 0.2, 1.0])
    drawn = [wp.array(values, dtype=float, device="cpu") for values in (targets, limits)]
    with wp.ScopedCapture(device="cpu") as capture:
        wp.copy(sim.control.joint_target_q, drawn[0])
        wp.copy(sim.model.joint_limit_upper, drawn[1])
        sim.solver.notify_model_changed(ModelFlags.JOINT_DOF_FORCE_PROPERTIES)
        sim.step(60)
    for order in (slice(None), slice(None, None, -1)):
        for array, values in zip(drawn, (targets[order], limits[order]), strict=True):
            array.assign(values)
        sim.solver.reset(sim.state)
        wp.capture_launch(capture.graph)
        free = [driven(2.0, 200.0, 40.0, target, 60) for target in targets[order]]
        expected = np.minimum(free, limits[order])
        np.testing.assert_allclose(sim.pose[:, 2], expected, rtol=1e-5)


def test_shapes_are_drawn_by_world_in_a_graph() -> None:
    """Each replay drops each world's draw, with the contacts, mass and inertia of its shape."""
    sim = Simulation(worlds(shapes_of_choice(), 2))
    drawn = wp.zeros(2, dtype=wp.int32, device="cpu")
    sim.model.select_body_variants(drawn)
    sim.solver.reset(sim.state)
    with wp.ScopedCapture(device="cpu") as capture:
        sim.solver.notify_model_changed(sim.model.select_body_variants(drawn))
        sim.step(60)
    for draw in ([1, 0], [0, 1]):
        drawn.assign(draw)
        sim.solver.reset(sim.state)
        wp.capture_launch(capture.graph)
        np.testing.assert_allclose(sim.pose[:, 2], np.where(draw, 0.15, 0.25), atol=1e-4)


def test_friction_is_drawn_by_world_in_a_graph() -> None:
    """Cubes that slide are braked by their world's mu g in the replay that drew it, within 2 %."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.25))
    sim = Simulation(worlds(builder, 3))
    draws = wp.array(np.hstack([[[125.0]] * 3, DRAWS[:, 1:]]), dtype=float, device="cpu")
    graph = randomised(sim, draws, 24, notify=False)
    for values in (DRAWS[:, 3], DRAWS[::-1, 3]):
        drawn = draws.numpy()
        drawn[:, 3] = values
        draws.assign(drawn)
        sim.solver.reset(sim.state)
        for body in range(3):
            sim.set_velocity(body, (2.0, 0.0, 0.0))
        wp.capture_launch(graph)
        np.testing.assert_allclose(2.0 - sim.velocity[:, 0], values * G * 24 * DT, rtol=0.02)


def test_a_body_that_a_graph_frees_at_its_joint_is_reported(capfd: pytest.CaptureFixture) -> None:
    """A joint that held nothing when the solver looked: each replay says what to do about it."""
    builder = newton.ModelBuilder()
    add_hinge_chain(builder, 1)
    sim = simulate(builder)
    sim.model.body_flags.fill_(KINEMATIC)
    sim.solver.notify_model_changed(ModelFlags.BODY_PROPERTIES)
    flags = wp.full(1, KINEMATIC, dtype=wp.int32, device="cpu")
    with wp.ScopedCapture(device="cpu") as capture:
        wp.copy(sim.model.body_flags, flags)
        sim.solver.notify_model_changed(ModelFlags.BODY_PROPERTIES)
        sim.step(2)
    wp.capture_launch(capture.graph)
    assert "moves" not in capfd.readouterr().out
    flags.fill_(DYNAMIC)
    wp.capture_launch(capture.graph)
    assert "body 0 moves since a graph changed it" in capfd.readouterr().out


def test_every_effect_of_values_can_come_inside_of_a_graph() -> None:
    """Each effect either follows from what there is and from settings, or is compiled in."""
    given = {
        *(
            "contact",
            "joint_force",
            "pairs",
            "floating",
            "kinds",
            "reaction",
            "flipped",
            "loops",
            "welds",
            "actuators",
            "tendons",
            "spatial_tendons",
            "body_actuators",
            "adhesion",
            "cables",
            "condim",
            "contact_pairs",
            "carried_rounding",
            "cylinders",
            "ellipsoids",
        ),  # what there is
        *("closures", "mimics", "equalities", "yielding"),
        "breaking",  # that some joint can break is said before
        *(
            "piles",
            "mixing",
            "compliance",
            "ramp",
            "second_order",
            "fourth_order",
            "friction_mix",
            "angular_friction",
            "sleeping",
            "adaptive",
            "on_gpu",
        ),  # settings
        # need buffers: named where a graph is captured
        *("restitution", "put_bodies", "gravity_compensation", "fluid", "servos", "dahl"),
        *("force_ranges", "limit_impedance"),
        *("matching", "moving_surfaces", "contact_materials"),  # the contact buffer
    }
    least = Effects(contact=True, friction=False, gyroscopic=False, joint_force=False)
    kinds = dataclasses.replace(least.kinds, linear=(0,), angular=(1,))
    least = dataclasses.replace(least, kinds=kinds)
    most = least.for_any_values()
    for field in dataclasses.fields(Effects):
        if field.name not in given:
            assert getattr(most, field.name) is True, field.name
