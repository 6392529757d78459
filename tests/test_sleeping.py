# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Islands at rest sleep until something disturbs them; none notices whether another one does."""

from collections.abc import Callable

import newton
import numpy as np
import pytest
import warp as wp
from helpers import IDENTITY, G, Simulation, add_box, add_ground, add_sphere, surface
from joint_scenes import add_hinge_chain, set_control, simulate
from newton import ModelFlags

from newton_avbd import SolverAVBD
from newton_avbd.step.sleeping import REST_TIME

DT = 1.0 / 60.0
MU = 0.5
EDGE = 0.5

BITS = np.testing.assert_array_equal


def add_tower(builder: newton.ModelBuilder, x: float, count: int) -> None:
    """Adds cubes on each other, on the ground at ``x`` [m]."""
    for i in range(count):
        add_box(builder, (x, 0.0, (i + 0.5) * EDGE), EDGE, mu=MU)


def towers(*counts: int, sleeping: bool = True, **settings: object) -> Simulation:
    """Towers of cubes on the ground, 3 m apart: each an island."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=MU)
    for i, count in enumerate(counts):
        add_tower(builder, 3.0 * i, count)
    return Simulation(builder, dt=DT, sleeping=sleeping, **settings)


def asleep(*counts: int, **settings: object) -> Simulation:
    """The same, asleep."""
    sim = towers(*counts, **settings)
    sim.run(REST_TIME + 0.5)
    assert sim.solver.status.sleeping_bodies == sum(counts)
    return sim


def kinematic_box(builder: newton.ModelBuilder, position: object, size: float = EDGE) -> int:
    """Adds a box that the user moves."""
    body = builder.add_body(xform=wp.transform(wp.vec3(*position), IDENTITY), is_kinematic=True)
    builder.add_shape_box(body, hx=size / 2, hy=size / 2, hz=size / 2, cfg=surface(mu=MU))
    return body


def test_what_is_at_rest_for_half_a_second_sleeps_and_stays_where_it_is() -> None:
    """Bit for bit, without velocity and without a sweep; contacts go on carrying the weight."""
    sim = towers(3)
    observed = sim.observe("contact_f", "body_qdd")
    sim.run(REST_TIME - 2 * DT)
    assert sim.solver.status.sleeping_bodies == 0
    sim.run(0.5)
    assert sim.solver.status.sleeping_bodies == 3
    pose = sim.pose
    sim.run(0.5)
    BITS(sim.pose, pose)
    BITS(sim.velocity, 0.0)
    BITS(observed.body_qdd.numpy(), 0.0)
    assert sim.solver.status.sweeps[0] == 0
    # by pairs, contacts of the ground and of each body on the next: what is above weighs on them
    force = np.abs(observed.contact_f.numpy()[:12, 2].astype(np.float64))
    shapes = sim.contacts.rigid_contact_shape1.numpy()[:12]
    shapes = np.maximum(shapes, sim.contacts.rigid_contact_shape0.numpy()[:12])
    held = [force[shapes == shape].sum() for shape in sorted(set(shapes))]
    weight = sim.mass[0] * G
    assert held == pytest.approx([3 * weight, 2 * weight, weight], rel=1.0e-4)


def push(sim: Simulation) -> None:
    sim.state.body_f.assign([[2.0 * MU * sim.mass[0] * G, 0, 0, 0, 0, 0]])


def set_velocity(sim: Simulation) -> None:
    sim.state.body_qd.assign([[2.0, 0, 0, 0, 0, 0]])


def lift(sim: Simulation) -> None:
    sim.state.body_q.assign([[0, 0, 2, 0, 0, 0, 1]])


def turn_gravity(sim: Simulation) -> None:
    sim.model.gravity.assign(np.tile([0.0, 0.0, 2.0 * G], (sim.model.gravity.shape[0], 1)))


def set_joint_force(sim: Simulation) -> None:
    sim.control.joint_f.assign([0, 0, 2.0 * sim.mass[0] * G, 0, 0, 0])


DISTURBANCES: dict[Callable[[Simulation], None], tuple[int, float]] = {
    # Coulomb friction takes mu g of 2 mu g, or of the speed
    push: (0, MU * G * DT),
    set_velocity: (0, 2.0 - MU * G * DT),
    lift: (2, -G * DT),
    turn_gravity: (2, 2.0 * G * DT),
    set_joint_force: (2, G * DT),
}
"""What wakes a box, and the component of its velocity one step later [m/s]."""


@pytest.mark.parametrize("disturb", DISTURBANCES)
def test_a_disturbance_wakes_in_its_own_step(disturb: Callable[[Simulation], None]) -> None:
    axis, speed = DISTURBANCES[disturb]
    sim = asleep(1)
    disturb(sim)
    sim.step()
    assert sim.solver.status.sleeping_bodies == 0
    # the forces of the rest let go within a few percent
    assert sim.velocity[0, axis] == pytest.approx(speed, rel=5.0e-2)


def test_a_constant_force_that_friction_holds_lets_it_sleep() -> None:
    sim = asleep(1, 1)
    sim.state.body_f.assign([[0.5 * MU * sim.mass[0] * G, 0, 0, 0, 0, 0], np.zeros(6)])
    sim.step()
    assert sim.solver.status.sleeping_bodies == 1
    sim.run(REST_TIME + 0.5)
    assert sim.solver.status.sleeping_bodies == 2


def test_the_model_and_a_reset_wake_all_and_waking_is_warm() -> None:
    """A tower of ten goes on in one sweep as if it had not slept, without a wave."""
    sim = asleep(10)
    pose = sim.pose
    sim.solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
    observed = sim.observe("contact_f")
    sim.step()
    status = sim.solver.status
    assert (status.sleeping_bodies, status.sweeps[0]) == (0, 1)
    assert np.abs(sim.velocity).max() < 1.0e-6
    assert sim.pose == pytest.approx(pose, abs=1.0e-7)
    ground = np.abs(observed.contact_f.numpy()[:, 2]).max()
    assert ground == pytest.approx(10 * sim.mass[0] * G / 4, rel=1.0e-3)
    sim.run(REST_TIME + 0.5)
    assert sim.solver.status.sleeping_bodies == 10
    sim.solver.reset(sim.state)
    sim.step()
    assert sim.solver.status.sleeping_bodies == 0


def test_what_touches_wakes_and_no_one_else_notices() -> None:
    """A box slides into a sleeping tower: only that wakes, when their contacts say so."""
    sim = asleep(2, 3, 1)
    others = sim.pose[2:5]
    slide = sim.state.body_qd.numpy()
    slide[5, 0] = -3.0
    sim.state.body_qd.assign(slide)
    pose = sim.state.body_q.numpy()
    pose[5, 0] = 1.3
    sim.state.body_q.assign(pose)
    awake = []
    for _ in range(40):
        sim.step()
        awake.append(6 - sim.solver.status.sleeping_bodies)
        BITS(sim.pose[2:5], others)
    # mu g slows it over the 0.76 m to where contacts are detected: 0.36 s
    assert awake[:20] == [1] * 20
    assert awake[23] == 3
    # that of 200 iterations
    assert sim.pose[0, 0] == pytest.approx(-0.0071, rel=0.1)


def test_what_the_user_moves_wakes_what_it_touches() -> None:
    """A kinematic wall at rest lets the box beside it sleep, and takes it along when it moves; one
    that is gone from under a box lets it fall."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=MU)
    add_box(builder, (0.0, 0.0, EDGE / 2), EDGE, mu=MU)
    wall = kinematic_box(builder, (-EDGE, 0.0, EDGE / 2))
    shelf = kinematic_box(builder, (4.0, 0.0, 2.0))
    add_box(builder, (4.0, 0.0, 2.0 + EDGE), EDGE, mu=MU)
    sim = Simulation(builder, dt=DT, sleeping=True)
    sim.run(REST_TIME + 0.5)
    assert sim.solver.status.sleeping_bodies == 2
    velocity = np.zeros((4, 6))
    velocity[wall, 0] = 1.0
    sim.state.body_qd.assign(velocity)
    sim.step()
    assert sim.solver.status.sleeping_bodies == 1
    assert sim.velocity[0, 0] == pytest.approx(1.0, rel=1.0e-2)
    pose = sim.state.body_q.numpy()
    pose[shelf, 1] = 3.0
    sim.state.body_q.assign(pose)
    sim.step()
    assert sim.solver.status.sleeping_bodies == 0
    assert sim.velocity[3, 2] == pytest.approx(-G * DT, rel=1.0e-3)


def throw(sim: Simulation, steps: int) -> np.ndarray:
    """Poses of a tower of three whose first cube gets a blow, step by step."""
    velocity = sim.state.body_qd.numpy()
    velocity[0, 0] = 4.0
    sim.state.body_qd.assign(velocity)
    poses = []
    for _ in range(steps):
        sim.step()
        poses.append(sim.pose[:3])
    return np.array(poses)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_an_island_moves_the_same_bit_for_bit_whatever_others_do(scheme: str) -> None:
    """Alone, beside one that sleeps, and beside one that is awake and falls over.

    The last by backward Euler: of second order, islands share what kind of step the last one was.
    """
    sim = asleep(3, scheme=scheme)
    alone = throw(sim, 60)
    again = sim.solver.status.sleeping_bodies
    assert again < 3
    beside = asleep(3, 5, scheme=scheme)
    BITS(throw(beside, 60), alone)
    assert beside.solver.status.sleeping_bodies == 5 + again
    if scheme != "euler":
        return
    restless = asleep(3, 5, scheme=scheme)
    velocity = restless.state.body_qd.numpy()
    velocity[5, 0] = 3.0
    restless.state.body_qd.assign(velocity)
    BITS(throw(restless, 60), alone)
    assert restless.solver.status.sleeping_bodies == again


def test_worlds_sleep_apart_and_graphs_wake_them() -> None:
    """One of three equal worlds gets a push by a replayed graph that was captured asleep."""
    tower = newton.ModelBuilder()
    add_ground(tower, mu=MU)
    add_tower(tower, 0.0, 2)
    builder = newton.ModelBuilder()
    builder.replicate(tower, 3)
    sim = Simulation(builder, dt=DT, sleeping=True)
    sim.run(REST_TIME + 0.5)
    assert sim.solver.status.sleeping_bodies == 6
    pose, one = sim.pose, asleep(2)
    with wp.ScopedCapture(device="cpu") as capture:
        sim.step(2)
    wp.capture_launch(capture.graph)
    BITS(sim.pose, pose)
    velocity = np.zeros((6, 6), dtype=np.float32)
    velocity[2, 0] = 3.0
    sim.state.body_qd.assign(velocity)
    one.state.body_qd.assign(velocity[2:4])
    for _ in range(10):
        wp.capture_launch(capture.graph)
        one.step(2)
        assert sim.solver.status.sleeping_bodies == 4
        BITS(sim.pose[2:4], one.pose)
    BITS(sim.pose[[0, 1, 4, 5]], pose[[0, 1, 4, 5]])
    assert sim.pose[2, 0] > 0.1


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_target_wakes_an_arm_that_moves_as_if_it_had_not_slept(scheme: str) -> None:
    """Beside another arm that sleeps on; one that is woken all the time gives the same motion."""
    builder = newton.ModelBuilder()
    for y in (0.0, 5.0):
        add_hinge_chain(builder, 3, base=(0.0, y, 0.0), target_ke=50.0, target_kd=10.0)
    settings = {"dt": DT, "sleeping": True, "scheme": scheme}
    sleeper, restless = (simulate(builder, **settings) for _ in range(2))
    for _ in range(10):
        sleeper.run(0.4)
        restless.run(0.4)
        restless.solver.notify_model_changed(ModelFlags.JOINT_PROPERTIES)
    assert sleeper.solver.status.sleeping_bodies == 6
    assert restless.solver.status.sleeping_bodies == 0
    rest = sleeper.pose
    for sim in (sleeper, restless):
        set_control(sim, joint_target_q=[0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
        sim.run(0.2)
    assert sleeper.solver.status.sleeping_bodies == 3
    assert np.abs(sleeper.pose[2, :3] - rest[2, :3]).max() > 0.05
    assert sleeper.pose == pytest.approx(restless.pose, abs=1.0e-4)
    BITS(sleeper.pose[3:], rest[3:])


def test_a_body_that_is_slow_for_a_moment_does_not_sleep() -> None:
    """At the top of its way a ball stands still, and slowly rolling is not at rest either."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=MU)
    ball = add_sphere(builder, (0.0, 0.0, 3.0))
    roller = add_sphere(builder, (3.0, 0.0, 0.25))
    sim = Simulation(builder, dt=DT, sleeping=True)
    velocity = np.zeros((2, 6))
    velocity[ball, 2] = 0.5 * G
    velocity[roller] = [0.002, 0.0, 0.0, 0.0, 0.002 / 0.25, 0.0]
    sim.state.body_qd.assign(velocity)
    for _ in range(60):
        sim.step()
        assert sim.solver.status.sleeping_bodies == 0
    assert sim.center[roller, 0] - 3.0 == pytest.approx(0.002, rel=1.0e-2)


def test_without_asking_nothing_sleeps_and_nothing_is_kept() -> None:
    sim = towers(1, sleeping=False)
    sim.run(REST_TIME + 0.5)
    assert sim.solver.status.sleeping_bodies == 0
    effect = sim.solver.effects["sleeping"]
    assert not effect.on
    assert effect.bytes == 0
    assert effect.why == "without sleeping=True"
    assert asleep(1).solver.effects["sleeping"].on


ARM = """
<body pos="{0} 0 0">
  <joint name="{1}" axis="0 1 0"/>
  <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.3"/>
  <body pos="0.3 0 0">
    <joint name="{2}" axis="0 1 0"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.3" mass="0.2"/>
    <body name="{3}" pos="0 0 0.3">
      <joint axis="0 1 0"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.1"/>
    </body>
  </body>
</body>
"""
"""Three links on hinges."""


@pytest.mark.parametrize(
    ("effect", "tie"),
    [
        (
            "tendons",
            """<tendon><fixed name="t" stiffness="2" springlength="0" damping="0.05">
        <joint joint="a" coef="1"/><joint joint="b" coef="-0.5"/></fixed></tendon>
        <actuator><motor tendon="t" gear="3"/></actuator>""",
        ),
        (
            "mimics",
            """<equality><joint joint1="b" joint2="a" polycoef="0 -0.5 0 0 0"/></equality>
        <actuator><motor joint="a" gear="0.3"/></actuator>""",
        ),
        (
            "loops",
            """<equality><connect body1="hand" body2="world" anchor="0.3 0 0"/></equality>
        <actuator><motor joint="a" gear="0.3"/></actuator>""",
        ),
    ],
)
def test_what_ties_an_arm_beside_another_one_acts_as_without_sleeping(
    effect: str, tie: str
) -> None:
    """A pulled tendon, a coupling of hinges, a hand that is pinned to the world."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    alone = '<default><geom contype="0" conaffinity="0"/></default>'
    arms = ARM.format(0, "a", "b", "hand") + ARM.format(2, "c", "d", "other")
    text = f"<mujoco>{alone}<worldbody>{arms}</worldbody>{tie}</mujoco>"
    builder.add_mjcf(text, ctrl_direct=True)
    model = builder.finalize(device="cpu")
    ends = []
    for sleeping in (False, True):
        solver = SolverAVBD(model, sleeping=sleeping)
        assert solver.effects[effect].on
        state, after, control = model.state(), model.state(), model.control()
        for step in range(200):
            control.mujoco.ctrl.assign([0.5 * np.sin(0.01 * step)])
            solver.step(state, after, control, None, 1.0 / 1000.0)
            state, after = after, state
        ends.append((state.body_q.numpy(), state.body_qd.numpy()))
    moved = np.linalg.norm((ends[0][0] - model.body_q.numpy())[:, :3], axis=1)
    assert moved.max() > 0.01
    np.testing.assert_allclose(ends[1][0], ends[0][0], atol=1.0e-5)
    np.testing.assert_allclose(ends[1][1], ends[0][1], atol=1.0e-4)
