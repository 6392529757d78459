# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Newton's coupled solvers with SolverAVBD for their rigid bodies, on scenes solvable by hand."""

from collections.abc import Callable, Sequence
from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, Array, G, Simulation, add_box, add_ground, add_mass, surface
from newton.solvers import SolverBase, SolverVBD
from newton.solvers.experimental.coupled import (
    CouplingInterface,
    SolverCoupled,
    SolverCoupledADMM,
    SolverCoupledProxy,
)
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from newton_avbd import SolverAVBD

PARENT_F = SolverBase.ObservableKind.BODY_PARENT_F
LENGTH = 1.0
CELL = 0.1
INERTIA = wp.mat33(0.1 * np.eye(3))
BODY = int(CouplingInterface.EndpointKind.BODY)


def couple_soft(model: newton.Model, **settings: Any) -> SolverCoupledProxy:
    """All bodies and joints by SolverAVBD, all particles by SolverVBD, which sees the bodies."""
    bodies = range(model.body_count)
    return SolverCoupledProxy(
        model,
        entries=[
            SolverCoupled.Entry("rigid", SolverAVBD, bodies, joints=range(model.joint_count)),
            SolverCoupled.Entry(
                "soft",
                lambda view: SolverVBD(view, particle_enable_self_contact=False),
                particles=range(model.particle_count),
            ),
        ],
        coupling=SolverCoupledProxy.Config([proxy("rigid", "soft", bodies, **settings)]),
    )


def couple_rigid(
    model: newton.Model, bodies: Sequence[int], *, iterations: int = 1, **settings: Any
) -> SolverCoupledProxy:
    """``bodies`` by one SolverAVBD; the others by a second one, which sees these."""
    ours, theirs = split(model, bodies)
    return SolverCoupledProxy(
        model,
        entries=[ours, theirs],
        coupling=SolverCoupledProxy.Config(
            [proxy(ours.name, theirs.name, bodies, **settings)], iterations
        ),
    )


def split(model: newton.Model, bodies: Sequence[int]) -> list[SolverCoupled.Entry]:
    """Entries of two SolverAVBD: ``bodies`` with the joints above them, and the rest.

    Joints between the two belong to neither.
    """
    child, parent = model.joint_child.numpy(), model.joint_parent.numpy()
    rest = [body for body in range(model.body_count) if body not in bodies]
    return [
        SolverCoupled.Entry(
            name,
            SolverAVBD,
            group,
            joints=[
                joint
                for joint in range(model.joint_count)
                if child[joint] in group and parent[joint] in [-1, *group]
            ],
        )
        for name, group in (("first", list(bodies)), ("second", rest))
    ]


def proxy(
    source: str, destination: str, bodies: Sequence[int], **settings: Any
) -> SolverCoupledProxy.Proxy:
    """Proxies that the destination detects contacts of in each step."""
    return SolverCoupledProxy.Proxy(
        source, destination, bodies, collision_pipeline=newton.CollisionPipeline, **settings
    )


def add_arm(builder: newton.ModelBuilder, **drive: float) -> int:
    """A horizontal plank of 20 kg, hinged to the world at its left end, 1 m above the ground."""
    link = builder.add_link(xform=wp.transform((LENGTH / 2, 0.0, 1.0)))
    builder.add_shape_box(link, hx=LENGTH / 2, hy=0.2, hz=0.05, cfg=surface(density=500.0))
    joint = builder.add_joint_revolute(
        -1,
        link,
        axis=(0.0, 1.0, 0.0),
        parent_xform=wp.transform((0.0, 0.0, 1.0)),
        child_xform=wp.transform((-LENGTH / 2, 0.0, 0.0)),
        **drive,
    )
    builder.add_articulation([joint])
    return link


def add_soft_cube(builder: newton.ModelBuilder, corner: Any, velocity: Any = (0, 0, 0)) -> None:
    """A soft cube of 0.2 m and 400 kg/m^3, by its corner with the least coordinates."""
    stiffness = 1.0e5
    builder.add_soft_grid(
        pos=wp.vec3(*corner),
        rot=wp.quat_identity(),
        vel=wp.vec3(*velocity),
        dim_x=2,
        dim_y=2,
        dim_z=2,
        cell_x=CELL,
        cell_y=CELL,
        cell_z=CELL,
        density=400.0,
        k_mu=stiffness,
        k_lambda=stiffness,
        k_damp=1.0e-3 * stiffness,
        particle_radius=0.01,
    )


def simulate_soft(builder: newton.ModelBuilder, **settings: Any) -> Simulation:
    """A coupled simulation of bodies and a soft body, at 240 Hz."""
    builder.color()
    sim = Simulation(builder, collide=False, make_solver=couple_soft, **settings)
    sim.model.soft_contact_ke = 1.0e5
    sim.model.soft_contact_kd = 10.0
    return sim


def replay(sim: Simulation, seconds: float, look: Callable[[], Any] = lambda: None) -> list[Any]:
    """Steps twice, captures two steps and replays them; what ``look`` saw after each replay."""
    sim.step(2)
    with wp.ScopedCapture(device="cpu") as capture:
        sim.step(2)
    seen = []
    for _ in range(round(0.5 * seconds / sim.dt) - 1):
        wp.capture_launch(capture.graph)
        seen.append(look())
    return seen


def soft_mass(sim: Simulation) -> float:
    """Mass of all particles [kg]."""
    return float(sim.model.particle_mass.numpy().sum())


def soft_center(sim: Simulation) -> Array:
    """Their center of mass [m]."""
    mass = sim.model.particle_mass.numpy().astype(float)
    return mass @ sim.state.particle_q.numpy().astype(float) / mass.sum()


def soft_momentum(sim: Simulation) -> Array:
    """Their momentum [N s]."""
    return sim.model.particle_mass.numpy().astype(float) @ sim.state.particle_qd.numpy()


def weigh(model: newton.Model, body: int, offset: Any = (0, 0, 0)) -> tuple[float, Array]:
    """Effective mass [kg] and inertia [kg m^2] of a point of a body, as a coupler asks for them."""
    mass, inertia = wp.zeros(1, dtype=float, device="cpu"), wp.zeros(1, wp.mat33, device="cpu")
    SolverAVBD(model).coupling_eval_effective_mass_block(
        wp.array([BODY], dtype=int, device="cpu"),
        wp.array([body], dtype=int, device="cpu"),
        wp.array([offset], dtype=wp.vec3, device="cpu"),
        mass,
        inertia,
    )
    return float(mass.numpy()[0]), inertia.numpy()[0]


def test_a_free_body_shows_its_own_mass() -> None:
    """At its COM; at an arm r across, 1/(1/m + r^2/I)."""
    builder = newton.ModelBuilder()
    add_mass(builder, mass=3.0, inertia=(0.1, 0.2, 0.25), rotation=wp.quat_rpy(0.3, 0.5, -1.0))
    model = builder.finalize(device="cpu")
    mass, inertia = weigh(model, 0)
    assert mass == pytest.approx(3.0, rel=1e-5)
    np.testing.assert_allclose(np.diag(inertia), (0.1, 0.2, 0.25), rtol=1e-5)
    mass, _ = weigh(model, 0, (0.0, 0.5, 0.0))
    assert mass == pytest.approx(1.0 / (1.0 / 3.0 + 0.25 / 0.1), rel=1e-5)


def test_a_hinged_plank_shows_the_mass_that_swings() -> None:
    """I/r^2 for a push across the arm r, I = about the hinge; at the hinge itself, its own mass."""
    builder = newton.ModelBuilder()
    add_arm(builder)
    model = builder.finalize(device="cpu")
    own = model.body_inertia.numpy()[0]
    swing = own[1, 1] + 20.0 * (LENGTH / 2) ** 2
    mass, inertia = weigh(model, 0)
    assert mass == pytest.approx(swing / (LENGTH / 2) ** 2, rel=1e-4)
    np.testing.assert_allclose(inertia, own * swing / own[1, 1], rtol=1e-4, atol=1e-6)
    assert weigh(model, 0, (LENGTH / 2, 0.0, 0.0))[0] == pytest.approx(swing, rel=1e-4)
    assert weigh(model, 0, (-LENGTH / 2, 0.0, 0.0))[0] == pytest.approx(20.0, rel=1e-4)


def test_bodies_that_do_not_move_show_their_own_mass() -> None:
    """A kinematic body, and one that a FIXED joint holds."""
    builder = newton.ModelBuilder()
    held = builder.add_link(mass=2.0, inertia=wp.mat33(np.eye(3)))
    builder.add_articulation([builder.add_joint_fixed(-1, held)])
    builder.add_body(mass=3.0, inertia=wp.mat33(np.eye(3)), is_kinematic=True)
    model = builder.finalize(device="cpu")
    for body, own in ((0, 2.0), (1, 3.0)):
        mass, inertia = weigh(model, body)
        assert mass == pytest.approx(own)
        np.testing.assert_allclose(inertia, np.eye(3))


def harvest(sim: Simulation, seconds: float) -> Array:
    """Mean force and torque on body 0, as a coupler reads them after each step, shape (6,)."""
    total = wp.zeros(1, dtype=wp.spatial_vector, device="cpu")
    steps = round(seconds / sim.dt)
    for _ in range(steps):
        before = wp.clone(sim.state.body_qd)
        sim.step()
        sim.solver.coupling_harvest_proxy_wrenches(
            wp.zeros(1, dtype=int, device="cpu"),
            total,
            body_qd_before=before,
            state=sim._next,
            state_out=sim.state,
            contacts=None,
            dt=sim.dt,
        )
    return total.numpy()[0].astype(float) / steps


def test_feedback_is_the_wrench_that_acted() -> None:
    """On a body that spins, whose angular velocity changes without a torque."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_mass(builder, mass=3.0, inertia=(0.1, 0.2, 0.25))
    sim = Simulation(builder, collide=False)
    sim.set_velocity(0, linear=(1.0, 0.0, 0.0), angular=(3.0, 4.0, -5.0))
    gyroscopic = np.cross((3.0, 4.0, -5.0), (0.1 * 3.0, 0.2 * 4.0, -0.25 * 5.0))
    assert np.linalg.norm(gyroscopic) > 1.0
    np.testing.assert_allclose(harvest(sim, 0.1), 0.0, atol=2e-4)
    sim.push(0, force=(1.0, 2.0, 3.0), torque=(0.1, -0.2, 0.3))
    np.testing.assert_allclose(harvest(sim, 0.1), (1.0, 2.0, 3.0, 0.1, -0.2, 0.3), atol=2e-4)


def test_the_support_of_a_box_carries_the_soft_body_on_it() -> None:
    """A held box: its joint carries both weights."""
    builder = newton.ModelBuilder()
    box = builder.add_link(xform=wp.transform((0.0, 0.0, 0.5)))
    builder.add_shape_box(box, hx=0.25, hy=0.25, hz=0.05, cfg=surface(density=1000.0))
    joint = builder.add_joint_fixed(-1, box, parent_xform=wp.transform((0.0, 0.0, 0.5)))
    builder.add_articulation([joint])
    add_soft_cube(builder, (-CELL, -CELL, 0.56))
    sim = simulate_soft(builder)
    seen = sim.observe(PARENT_F)
    forces = replay(sim, 1.2, lambda: seen.body_parent_f.numpy()[0, :3].astype(float))
    weight = (sim.mass[0] + soft_mass(sim)) * G
    held = np.mean(forces[-24:], axis=0)
    np.testing.assert_allclose(held, (0.0, 0.0, weight), atol=2e-3 * weight)


def test_a_soft_body_bends_a_driven_arm_by_its_weight() -> None:
    """The drive's torque is that of both weights about the hinge."""
    ke = 2000.0
    builder = newton.ModelBuilder()
    add_arm(builder, target_ke=ke, target_kd=0.2 * ke)
    add_soft_cube(builder, (0.7, -CELL, 1.06))
    sim = simulate_soft(builder)
    replay(sim, 2.0)
    angle = Rotation.from_quat(sim.pose[0, 3:]).as_rotvec()[1]
    torque = G * (sim.mass[0] * sim.center[0, 0] + soft_mass(sim) * soft_center(sim)[0])
    assert angle == pytest.approx(torque / ke, rel=2e-3)


def test_a_soft_body_hands_its_momentum_to_a_box() -> None:
    """The total stays what it was, whatever the impact does.

    At a step in which SolverVBD does that, too: at 240 Hz its particles lose 6 % more than the
    forces that it hands back, whichever solver moves the box.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_box(builder, (0.0, 0.0, 0.0), 0.3, density=400.0)
    add_soft_cube(builder, (-0.37, -CELL, -CELL), velocity=(1.0, 0.0, 0.0))
    sim = simulate_soft(builder, dt=1.0 / 960.0)
    before = soft_momentum(sim)
    replay(sim, 0.15)
    after = sim.mass[0] * sim.velocity[0, :3]
    assert after[0] > 0.5 * before[0]
    np.testing.assert_allclose(after + soft_momentum(sim), before, atol=1e-3 * before[0])


def test_cloth_rests_on_a_kinematic_body_that_goes_its_way() -> None:
    """The body follows its velocity to rounding; the cloth goes with it and is not passed."""
    builder = newton.ModelBuilder()
    table = builder.add_link(xform=wp.transform((0.0, 0.0, 0.5)), is_kinematic=True)
    builder.add_shape_box(table, hx=0.3, hy=0.3, hz=0.05, cfg=surface(mu=1.0))
    builder.add_articulation([builder.add_joint_free(table)])
    builder.add_cloth_grid(
        pos=wp.vec3(-0.2, -0.2, 0.57),
        rot=wp.quat_identity(),
        vel=wp.vec3(0.0, 0.0, 0.0),
        dim_x=8,
        dim_y=8,
        cell_x=0.05,
        cell_y=0.05,
        mass=0.01,
        particle_radius=0.01,
    )
    sim = simulate_soft(builder)
    sim.run(0.3)
    rise = np.array([0.0, 0.0, 0.2])
    sim.set_velocity(0, linear=rise)
    for _ in range(120):
        pose = sim.state.body_q.numpy()
        pose[0, :3] += rise * sim.dt
        sim.state.body_q.assign(pose)
        sim.step()
    np.testing.assert_allclose(sim.pose[0, :3], (0.0, 0.0, 0.6), atol=1e-5)
    height = sim.state.particle_q.numpy()[:, 2] - (sim.pose[0, 2] + 0.05)
    assert 0.0 < height.min() and height.max() < 0.03


@pytest.mark.parametrize("iterations", [1, 3])
def test_a_box_of_another_solver_bends_an_arm_by_its_weight(iterations: int) -> None:
    """Rigid contact with a proxy of SolverAVBD; the load weighs ten times as much as the arm."""
    ke = 2.0e4
    builder = newton.ModelBuilder()
    arm = add_arm(builder, target_ke=ke, target_kd=0.2 * ke)
    add_box(builder, (0.7, 0.0, 1.15), 0.2, density=25.0e3)
    sim = Simulation(
        builder,
        collide=False,
        make_solver=lambda model: couple_rigid(model, [arm], iterations=iterations),
        dt=1.0 / 480.0,
    )
    replay(sim, 2.5)
    angle = Rotation.from_quat(sim.pose[0, 3:]).as_rotvec()[1]
    assert angle == pytest.approx(G * (sim.mass @ sim.center[:, 0]) / ke, rel=1e-4)


def tower() -> newton.ModelBuilder:
    """A box on a box on the ground."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (0.0, 0.0, 0.25))
    add_box(builder, (0.0, 0.0, 0.76), density=2000.0)
    return builder


def test_a_captured_coupled_frame_does_what_steps_do() -> None:
    """After one step that makes room for contacts, bit for bit."""
    poses = []
    for captured in (False, True):
        sim = Simulation(tower(), make_solver=lambda model: couple_rigid(model, [0]))
        if captured:
            replay(sim, 60 * sim.dt)
        else:
            sim.step(60)
        poses.append(sim.pose)
    np.testing.assert_array_equal(*poses)


def test_a_reset_tower_stands_as_it_did() -> None:
    """Multipliers and feedback are forgotten: the second run is the first."""
    sim = Simulation(tower(), make_solver=lambda model: couple_rigid(model, [0]))
    runs = []
    for _ in range(2):
        sim.run(0.25)
        runs.append(sim.pose)
        sim.solver.reset(sim.state)
    assert runs[0][1, 2] == pytest.approx(0.75, abs=1e-4)
    np.testing.assert_array_equal(*runs)


def test_a_solver_step_may_be_repeated() -> None:
    """A coupler that iterates solves each step again: the tower does not feel it."""
    sim = Simulation(tower(), make_solver=lambda model: couple_rigid(model, [0], iterations=4))
    sim.run(0.5)
    np.testing.assert_allclose(sim.pose[:, 2], (0.25, 0.75), atol=1e-4)
    assert np.abs(sim.velocity).max() < 1e-3


def test_a_ball_joint_between_two_solvers_swings_a_pendulum() -> None:
    """By ADMM: the anchors stay together, a quarter of the period is K sqrt(I/(m g r))."""
    builder = newton.ModelBuilder()
    held = builder.add_link(xform=wp.transform((0.0, 0.0, 1.0)), mass=1.0, inertia=INERTIA)
    fixed = builder.add_joint_fixed(-1, held, parent_xform=wp.transform((0.0, 0.0, 1.0)))
    arm = (0.5, 0.0, 0.0)
    bob = builder.add_link(xform=wp.transform((0.5, 0.0, 1.0)), mass=2.0, inertia=INERTIA)
    ball = builder.add_joint_ball(held, bob, child_xform=wp.transform((-0.5, 0.0, 0.0)))
    builder.add_articulation([fixed, ball])
    sim = Simulation(
        builder,
        collide=False,
        make_solver=lambda model: SolverCoupledADMM(
            model, split(model, [held]), SolverCoupledADMM.Config(iterations=10)
        ),
        dt=1.0 / 480.0,
    )
    passes = 0.0
    while sim.center[1, 0] > 0.0:
        sim.step()
        passes += sim.dt
        anchor = sim.pose[1, :3] - Rotation.from_quat(sim.pose[1, 3:]).apply(arm)
        np.testing.assert_allclose(anchor, (0.0, 0.0, 1.0), atol=1e-5)
    quarter = ellipk(0.5) * np.sqrt((0.1 + 2.0 * 0.25) / (2.0 * G * 0.5))
    assert passes == pytest.approx(quarter, rel=1e-2)
