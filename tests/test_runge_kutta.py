# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""scheme="runge_kutta": of fourth order where nothing but joints holds bodies."""

import warnings
from typing import Any

import newton
import newton.examples
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, Simulation, add_box, add_ground, add_sphere
from joint_scenes import WORLD, add_link, coordinates, set_coordinates, simulate, transform
from newton.solvers import SolverMuJoCo
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD

RK4 = "runge_kutta"
INERTIA = (0.02, 0.03, 0.045)
"""Of the links here [kg m^2]; they weigh 1 kg."""
KINDS = ("revolute", "prismatic", "ball", "universal", "mixed", "gimbal")
Axis = newton.ModelBuilder.JointDofConfig


def order(sim: Simulation, world: int = 0) -> int:
    """Order of the last step of a world."""
    return int(sim.solver.report().order[world])


def momentum(sim: Simulation) -> np.ndarray:
    """Momentum [N s] and angular momentum about the origin [N m s] of all bodies."""
    linear = sim.mass[:, None] * sim.velocity[:, :3]
    angular = sim.spin_momentum + np.cross(sim.center, linear)
    return np.concatenate([linear.sum(axis=0), angular.sum(axis=0)])


def placed(rng: np.random.Generator) -> wp.transform:
    """An anchor somewhere on a link."""
    rotation = Rotation.from_euler("xyz", rng.uniform(-1.0, 1.0, 3))
    return transform(rng.uniform(-0.3, 0.3, 3), rotation)


def add_joint(
    builder: newton.ModelBuilder, kind: str, parent: int, child: int, rng: np.random.Generator
) -> int:
    """A joint of a kind, with anchors and axes somewhere."""
    ends: dict[str, Any] = {"parent_xform": placed(rng), "child_xform": placed(rng)}
    axis = rng.normal(size=3)
    if kind == "revolute":
        return builder.add_joint_revolute(parent, child, axis=axis, **ends)
    if kind == "prismatic":
        return builder.add_joint_prismatic(parent, child, axis=axis, **ends)
    if kind == "ball":
        return builder.add_joint_ball(parent, child, **ends)
    linear = ["X", "Y"] if kind == "mixed" else []
    angular = {"universal": "XY", "gimbal": "ZYX", "mixed": "XZ"}[kind]
    return builder.add_joint_d6(
        parent,
        child,
        linear_axes=[Axis(axis=newton.Axis[name]) for name in linear],
        angular_axes=[Axis(axis=newton.Axis[name]) for name in angular],
        **ends,
    )


def tree(seed: int, floats: bool, gravity: Any = None) -> newton.ModelBuilder:
    """Links in motion, each on an earlier one, by a joint of each kind; the first may float."""
    rng = np.random.default_rng(seed)
    builder = newton.ModelBuilder() if gravity is None else newton.ModelBuilder(gravity=gravity)
    links = [add_link(builder, inertia=INERTIA) for _ in range(1 + len(KINDS))]
    anchor = transform((0.0, 0.0, 0.3), Rotation.from_euler("xyz", (0.1, 0.2, 0.3)))
    if floats:
        joints = [builder.add_joint_free(links[0])]
    else:
        joints = [builder.add_joint_revolute(WORLD, links[0], axis=(0, 1, 0), child_xform=anchor)]
    for i, kind in enumerate(KINDS, 1):
        joints.append(add_joint(builder, kind, links[rng.integers(i)], links[i], rng))
    builder.add_articulation(joints)
    for joint, kind in zip(joints[1:], KINDS, strict=True):
        count = sum(builder.joint_dof_dim[joint])
        q = rng.uniform(-0.6, 0.6, count)
        if kind == "ball":
            q = Rotation.from_rotvec(q).as_quat()
        set_coordinates(builder, joint, list(q), list(rng.uniform(-2.0, 2.0, count)))
    return builder


def end(builder: newton.ModelBuilder, hz: float, seconds: float = 0.5, **settings: Any) -> Any:
    """Positions of bodies after a while [m], and the orders of the steps."""
    sim = simulate(builder, dt=1.0 / hz, **{"scheme": RK4, **settings})
    orders = []
    for _ in range(round(seconds * hz)):
        sim.run(1.0 / hz)
        orders.append(order(sim))
    return sim.center, set(orders)


@pytest.mark.parametrize("floats", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_trees_of_all_kinds_of_joints_go_where_small_steps_take_them(
    seed: int, floats: bool
) -> None:
    """Beside 1,920 steps a second of second order, which are 1e-5 m off: 120 of fourth order."""
    builder = tree(seed, floats)
    exact = end(builder, 1920.0, scheme="generalized_alpha")[0]
    coarse, fine = end(builder, 60.0), end(builder, 120.0)
    off = [np.abs(position - exact).max() for position in (coarse[0], fine[0])]
    assert coarse[1] == fine[1] == {4}
    assert off[1] < 5.0e-5
    assert off[0] < 16.0 * 1.5 * max(off[1], 2.0e-5)


@pytest.mark.parametrize("law", ["free", "driven"])
def test_a_pendulum_with_forces_along_its_hinge_is_of_fourth_order(law: str) -> None:
    """(I + m l^2 + a) q'' = m g l cos q + ke (target - q) - kd q' - k (q - rest) - c q', 1 s."""
    arm, q, qd = 0.4, 0.3, 1.0
    axis: dict[str, Any] = {}
    if law == "driven":
        axis = {"target_ke": 30.0, "target_kd": 0.04, "target_q": 0.2, "effort_limit": 100.0}
        axis |= {"stiffness": 20.0, "damping": 0.03, "armature": 0.3}
    builder = newton.ModelBuilder()
    link = add_link(builder, inertia=INERTIA)
    frame = transform((-arm, 0.0, 0.0))
    joint = builder.add_joint_revolute(WORLD, link, child_xform=frame, axis=(0, 1, 0), **axis)
    builder.add_articulation([joint])
    set_coordinates(builder, joint, [q], [qd])
    get = axis.get
    inertia = INERTIA[1] + arm**2 + get("armature", 0.0)

    def rate(_: float, y: np.ndarray) -> list[float]:
        force = 9.81 * arm * np.cos(y[0]) + get("target_ke", 0.0) * (get("target_q", 0.0) - y[0])
        force -= (get("target_kd", 0.0) + get("damping", 0.0)) * y[1] + get("stiffness", 0.0) * y[0]
        return [y[1], force / inertia]

    found = solve_ivp(rate, (0.0, 1.0), [q, qd], method="DOP853", rtol=1e-11, atol=1e-12)
    errors = []
    for hz in (30.0, 60.0):
        sim = simulate(builder, dt=1.0 / hz, scheme=RK4)
        sim.run(1.0)
        assert order(sim) == 4
        errors.append(abs(float(coordinates(sim)[0][0]) - found.y[0, -1]))
    assert errors[1] < 1.0e-5
    assert errors[0] / errors[1] > 10.0


def test_what_floats_keeps_energy_and_momentum() -> None:
    """60 steps of 1/60 s, joints at up to 2 rad/s, without gravity."""
    builder = tree(0, True, NO_GRAVITY)
    sim = simulate(builder, dt=1.0 / 60.0, scheme=RK4)
    energy, start = sim.kinetic_energy, momentum(sim)
    sim.run(1.0)
    assert order(sim) == 4
    assert sim.kinetic_energy == pytest.approx(energy, rel=2.0e-5)
    assert np.abs(momentum(sim) - start).max() < 1.0e-5 * np.abs(start).max()


@pytest.mark.parametrize(
    ("name", "hz", "bound"), [("nv_ant", 60.0, 1e-5), ("nv_humanoid", 240.0, 2e-5)]
)
def test_robots_swing_as_mujoco_has_them_with_its_own_rk4(
    name: str, hz: float, bound: float
) -> None:
    """0.4 s without contacts and limits, beside MuJoCo's Runge-Kutta steps, four times as many."""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(newton.examples.get_asset(f"{name}.xml"))
    dofs = len(builder.joint_qd)
    builder.joint_limit_lower[:] = [-1.0e10] * dofs
    builder.joint_limit_upper[:] = [1.0e10] * dofs
    builder.joint_qd[6:] = np.random.default_rng(3).uniform(-1.0, 1.0, dofs - 6).tolist()
    ours = Simulation(builder, dt=1.0 / hz, collide=False, scheme=RK4)
    peer = Simulation(
        builder,
        dt=0.25 / hz,
        collide=False,
        make_solver=SolverMuJoCo,
        use_mujoco_cpu=True,
        integrator="rk4",
        disable_contacts=True,
    )
    for sim in (ours, peer):
        newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
        sim.run(0.4)
    assert order(ours) == 4
    assert np.abs(ours.center - peer.center).max() < bound


def armed_box(height: float) -> newton.ModelBuilder:
    """A box with an arm on a limited hinge, in the air."""
    builder = newton.ModelBuilder()
    box = builder.add_link(xform=transform((0.0, 0.0, height)))
    builder.add_shape_box(box, hx=0.2, hy=0.2, hz=0.1)
    arm = builder.add_link()
    builder.add_shape_box(arm, hx=0.02, hy=0.02, hz=0.15)
    frame = transform((0.0, 0.0, -0.2))
    joints = [
        builder.add_joint_free(box),
        builder.add_joint_revolute(
            box,
            arm,
            parent_xform=transform((0.0, 0.0, 0.15)),
            child_xform=frame,
            axis=(0, 1, 0),
            limit_lower=-0.5,
            limit_upper=0.5,
        ),
    ]
    builder.add_articulation(joints)
    set_coordinates(builder, joints[1], [0.3], [1.0])
    return builder


def test_a_world_falls_in_fourth_order_meets_a_stop_and_lands_like_the_default() -> None:
    builder = armed_box(0.5)
    add_ground(builder)
    sims = [simulate(builder, collide=True, scheme=name) for name in (RK4, "generalized_alpha")]
    orders = []
    for _ in range(240):
        for sim in sims:
            sim.run(1.0 / 240.0)
        orders.append(order(sims[0]))
        angle = float(coordinates(sims[0])[0][-1])
        assert abs(angle) < 0.5 + 1.0e-4
    assert orders[0] == 4
    assert orders.count(4) > 20
    assert orders[-1] < 4
    ours, default = (sim.center for sim in sims)
    assert np.abs(ours - default).max() < 2.0e-3
    assert np.linalg.norm(sims[0].velocity, axis=1).max() < 1.0e-3


def test_what_is_too_stiff_is_damped_in_other_steps() -> None:
    """A damper of 300 N m s/rad on 0.19 kg m^2: h d / I = 26 at 60 Hz. The default's result."""
    ends = []
    for scheme in (RK4, "generalized_alpha"):
        builder = newton.ModelBuilder()
        link = add_link(builder, inertia=INERTIA)
        frame = transform((-0.4, 0.0, 0.0))
        joint = builder.add_joint_revolute(
            WORLD, link, child_xform=frame, axis=(0, 1, 0), damping=300.0
        )
        builder.add_articulation([joint])
        sim = simulate(builder, dt=1.0 / 60.0, scheme=scheme)
        sim.run(1.0)
        assert order(sim) < 4
        ends.append(float(coordinates(sim)[0][0]))
    assert ends[0] == ends[1]


def test_velocities_that_joints_do_not_allow_keep_their_momentum() -> None:
    """A kick on one link: the joints share it, which takes energy and gives none."""
    sim = simulate(tree(0, True, NO_GRAVITY), dt=1.0 / 60.0, scheme=RK4)
    velocity = sim.state.body_qd.numpy()
    velocity[3, :3] += (1.0, -2.0, 0.5)
    sim.state.body_qd.assign(velocity)
    energy, start = sim.kinetic_energy, momentum(sim)
    sim.run(1.0 / 60.0)
    assert order(sim) == 4
    assert sim.kinetic_energy < energy
    assert np.abs(momentum(sim) - start).max() < 2.0e-5


def test_worlds_take_steps_of_their_own_order_alone_and_replayed() -> None:
    """Of three worlds one stands on the ground; a checkpoint goes on to the same bits."""
    one, scene = armed_box(1.0), newton.ModelBuilder()
    low = armed_box(0.09)
    for builder in (one, low, one):
        scene.add_world(builder)
    add_ground(scene)
    sim = simulate(scene, collide=True, scheme=RK4)
    sim.run(10.0 / 240.0)
    assert sim.solver.report().order.tolist()[0::2] == [4, 4]
    assert sim.solver.report().order[1] < 4
    assert (sim.center[0] - sim.center[4] == 0.0).all()
    state, left = sim.model.state(), sim.solver.checkpoint()
    state.assign(sim.state)
    sim.run(10.0 / 240.0)
    wanted = sim.state.body_q.numpy()
    sim.solver.restore(left)
    sim.state.assign(state)
    sim.run(10.0 / 240.0)
    assert (sim.state.body_q.numpy() == wanted).all()
    sim.solver.reset(sim.state, wp.array([True, False, False, False], dtype=wp.bool))
    sim.run(10.0 / 240.0)
    assert np.isfinite(sim.center).all()


def test_what_it_does_not_do_is_named() -> None:
    builder = tree(0, True)
    builder.set_joint_mimic(2, 1, coeffs=(0.0, 1.0))
    with pytest.warns(UserWarning, match=r"of second order, .* loops, or mimics"):
        solver = SolverAVBD(builder.finalize(device="cpu"), scheme=RK4)
    assert not solver.effects["fourth_order"].on
    model = armed_box(0.5).finalize(device="cpu")
    with pytest.raises(ValueError, match="leave scheme='runge_kutta' out"):
        SolverAVBD(model, scheme=RK4, formulation="ramp")
    scene = armed_box(0.5)
    add_ground(scene)
    add_box(scene, (2.0, 0.0, 0.5), 0.5)
    with pytest.warns(UserWarning, match="with parallel='bodies'"):
        SolverAVBD(scene.finalize(device="cpu"), scheme=RK4, parallel="bodies")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert SolverAVBD(model, scheme=RK4).effects["fourth_order"].on


# What others may do to a world.


def test_a_base_that_is_turned_by_its_pose_drags_its_wheel_as_by_default() -> None:
    """A damper feels the turn, which is no step of fourth order."""
    ends = []
    for scheme in (RK4, "generalized_alpha"):
        builder = newton.ModelBuilder()
        base, wheel = add_link(builder, is_kinematic=True), add_link(builder)
        joint = builder.add_joint_revolute(base, wheel, axis=(0.0, 0.0, 1.0), damping=1.0)
        builder.add_articulation([joint])
        sim = simulate(builder, scheme=scheme)
        for k in range(1, 60):
            sim.step()
            pose = sim.pose
            pose[0, 5:] = np.sin(0.01 * k), np.cos(0.01 * k)
            sim.state.body_q.assign(pose.astype(np.float32))
        ends.append(sim.velocity[1, 5])
    assert ends[0] > 1.0
    assert ends[0] == pytest.approx(ends[1], rel=1.0e-5)


def test_a_ball_that_bounces_beside_a_pendulum_gains_nothing() -> None:
    """Restitution 1: as high as by default, bounce by bounce."""
    peaks = []
    for scheme in (RK4, "generalized_alpha"):
        builder = newton.ModelBuilder()
        bob = builder.add_link(mass=1.0, inertia=wp.mat33(0.01 * np.eye(3)))
        frame = transform((0.0, 0.0, 0.5))
        joint = builder.add_joint_revolute(
            WORLD,
            bob,
            axis=(0, 1, 0),
            parent_xform=transform((3.0, 0.0, 2.0)),
            child_xform=frame,
        )
        builder.add_articulation([joint])
        set_coordinates(builder, joint, [0.5])
        add_ground(builder, restitution=1.0)
        ball = add_sphere(builder, (0.0, 0.0, 0.6), restitution=1.0)
        sim = simulate(builder, collide=True, dt=1.0 / 60.0, scheme=scheme)
        heights = []
        for _ in range(180):
            sim.step()
            heights.append(sim.center[ball, 2])
        peaks.append(max(heights[120:]))
    assert peaks[0] < 0.6 + 1.0e-3
    assert peaks[0] > peaks[1] - 5.0e-3


def test_friction_of_a_ball_joint_holds() -> None:
    """A light arm on a ball joint with friction stays while another arm swings."""
    builder = newton.ModelBuilder()
    arms = [add_link(builder, inertia=INERTIA) for _ in range(2)]
    frame = transform((-0.1, 0.0, 0.0))
    ball = builder.add_joint_ball(WORLD, arms[0], child_xform=frame, friction=2.0)
    hinge = builder.add_joint_revolute(arms[0], arms[1], child_xform=frame, axis=(0, 0, 1))
    builder.add_articulation([ball, hinge])
    set_coordinates(builder, hinge, [0.0], [3.0])
    sims = [simulate(builder, scheme=scheme) for scheme in (RK4, "generalized_alpha")]
    for sim in sims:
        sim.run(0.5)
    assert order(sims[0]) < 4
    assert np.abs(sims[0].pose[0] - sims[1].pose[0]).max() < 1.0e-5


@pytest.mark.parametrize("speed", [3.0, 2.98, 2.96])
def test_friction_stops_a_slide_once(speed: float) -> None:
    """v = v0 - a t, and 0 from then on. With the last stage beyond the stop, where friction would
    push the other way, a third of a step's change was left: 0.022 m/s."""
    rate = 4.0
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    link = builder.add_link(mass=1.0, inertia=wp.mat33(0.1 * np.eye(3)))
    joint = builder.add_joint_prismatic(-1, link, axis=(1.0, 0.0, 0.0), friction=rate)
    builder.add_articulation([joint])
    builder.body_qd[link] = wp.spatial_vector(speed, 0.0, 0.0, 0.0, 0.0, 0.0)
    sim = Simulation(builder, dt=1.0 / 60.0, collide=False, scheme="runge_kutta")
    for step in range(1, 61):
        sim.step()
        belongs = max(speed - rate * step * sim.dt, 0.0)
        assert sim.velocity[link, 0] == pytest.approx(belongs, abs=1e-4)


def test_a_model_that_loses_its_fluid_goes_on_in_fourth_order() -> None:
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.custom_attributes["mujoco:density"].values = {0: 1.2}
    link = add_link(builder, inertia=INERTIA)
    joint = builder.add_joint_revolute(
        WORLD, link, child_xform=transform((-0.4, 0.0, 0.0)), axis=(0, 1, 0)
    )
    builder.add_articulation([joint])
    with pytest.warns(UserWarning, match="with a fluid"):
        sim = simulate(builder, scheme=RK4)
    sim.step(2)
    assert order(sim) < 4
    sim.model.mujoco.density.zero_()
    sim.solver.notify_model_changed(newton.ModelFlags.ALL)
    sim.step(2)
    assert order(sim) == 4


def test_a_joint_that_was_off_does_not_jump_back() -> None:
    """Switched off and on again without a word: the child closes its joint as in other steps."""
    sim = simulate(tree(0, False), scheme=RK4)
    sim.run(0.1)
    sim.model.joint_enabled.assign([True, False, *[True] * (len(KINDS) - 1)])
    sim.run(0.1)
    sim.model.joint_enabled.fill_(True)
    before = sim.center
    sim.step()
    assert order(sim) < 4
    assert np.abs(sim.center - before).max() < 0.1
