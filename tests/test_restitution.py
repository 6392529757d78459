# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Restitution: what an impact gives back, what a row of bodies passes on, what stays at rest."""

import math

import newton
import numpy as np
import pytest
import warp as wp
from helpers import IDENTITY, NO_GRAVITY, G, Simulation, add_box, add_ground, add_sphere, surface
from joint_scenes import anchor_gaps
from numpy.typing import NDArray

from newton_avbd.scenes.named import add_dominoes

pytestmark = pytest.mark.usefixtures("shared_kernels")

ADD = {"sphere": add_sphere, "box": add_box}


def dropped(
    shape: str,
    restitution: float,
    height: float,
    dt: float,
    floor: float | None = None,
    scheme: str = "euler",
) -> Simulation:
    """A body above the ground, both of one restitution, detected a step ahead of the impact."""
    speed = math.sqrt(2.0 * G * height)
    gap = 1.5 * (speed + G * dt) * dt
    builder = newton.ModelBuilder()
    add_ground(builder, gap=gap, restitution=restitution if floor is None else floor)
    ADD[shape](builder, (0.0, 0.0, 0.25 + height), gap=gap, restitution=restitution)
    return Simulation(builder, dt=dt, scheme=scheme)


def rebound(sim: Simulation, height: float) -> float:
    """Height of the top of the first rebound [m]."""
    tops = [0.0]
    for _ in range(round(3.0 * math.sqrt(2.0 * height / G) / sim.dt) + 4):
        sim.step()
        if sim.velocity[0, 2] > 0.0:
            tops.append(sim.pose[0, 2] - 0.25)
        elif len(tops) > 1:
            tops.append(sim.pose[0, 2] - 0.25)  # the top lies between the last two
            break
    return max(tops)


@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
@pytest.mark.parametrize("height", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("restitution", [0.25, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_a_drop_rebounds_to_e_squared_of_its_height(
    shape: str, restitution: float, height: float, dt: float
) -> None:
    """Within 0.3 %, and what lies between two steps at the top: g dt^2/8, twice."""
    sim = dropped(shape, restitution, height, dt)
    expected = restitution**2 * height
    assert rebound(sim, height) == pytest.approx(expected, rel=3.0e-3, abs=0.25 * G * dt**2)
    assert np.abs(sim.velocity[0, 3:]).max() < 1.0e-3  # and a box lands flat


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
def test_an_elastic_ball_bounces_for_ever(dt: float, scheme: str) -> None:
    """With e = 1 the top of the last bounce of 20 s is that of the first, within 0.1 %."""
    sim = dropped("sphere", 1.0, 1.0, dt, scheme=scheme)
    path = []
    for _ in range(round(20.0 / dt)):
        sim.step()
        path.append(sim.pose[0, 2] - 0.25)
    path = np.array(path)
    tops = path[1:-1][(path[1:-1] >= path[:-2]) & (path[1:-1] > path[2:])]
    assert tops.size >= 20
    assert tops == pytest.approx(1.0, rel=1.0e-3)


@pytest.mark.parametrize("restitution", [0.5, 1.0])
def test_a_bounce_of_second_order_keeps_its_parabola(restitution: float) -> None:
    """Between bounces g z + v^2/2 is e^2 times what it was, to rounding, and never more."""
    sim = dropped("sphere", restitution, 1.0, 1.0 / 60.0, scheme="generalized_alpha")
    seen = []
    for _ in range(70):
        sim.step()
        height, speed = sim.pose[0, 2] - 0.25, sim.velocity[0, 2]
        seen.append(float(height + 0.5 * speed**2 / G))
    bounces = np.log(seen) / (2.0 * np.log(restitution)) if restitution < 1.0 else np.log(seen)
    np.testing.assert_allclose(bounces, np.round(bounces), atol=1.0e-4)
    assert np.diff(seen).max() < 1.0e-6


def test_restitution_of_two_shapes_is_their_mean_within_0_and_1() -> None:
    """0.2 and 0.6 make 0.4; 2 counts as 1."""
    sim = dropped("sphere", 0.2, 1.0, 1.0 / 240.0, floor=0.6)
    assert rebound(sim, 1.0) == pytest.approx(0.4**2, rel=5.0e-3)
    sim = dropped("sphere", 0.4, 1.0, 1.0 / 240.0, floor=2.0)
    assert rebound(sim, 1.0) == pytest.approx(0.7**2, rel=5.0e-3)


@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
@pytest.mark.parametrize("restitution", [0.5, 1.0])
@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_what_rests_stays_at_rest(shape: str, restitution: float, dt: float) -> None:
    """No jitter: for a second nothing moves faster than 1e-6 m/s."""
    builder = newton.ModelBuilder()
    add_ground(builder, restitution=restitution)
    ADD[shape](builder, (0.0, 0.0, 0.25), restitution=restitution)
    sim = Simulation(builder, dt=dt)
    for _ in range(round(1.0 / dt)):
        sim.step()
        assert np.abs(sim.velocity).max() < 1.0e-6


def test_a_falling_stack_comes_to_rest() -> None:
    """Five boxes that fall apart from each other with e = 0.6 stand on each other in the end."""
    builder = newton.ModelBuilder()
    add_ground(builder, restitution=0.6)
    for i in range(5):
        add_box(builder, (0.0, 0.0, 0.25 + 0.5 * i + 0.1 * (i + 1)), restitution=0.6)
    sim = Simulation(builder)
    sim.run(4.0)
    assert np.abs(sim.velocity).max() < 1.0e-5
    assert sim.pose[:, 2] == pytest.approx(0.25 + 0.5 * np.arange(5), abs=1.0e-4)


@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
@pytest.mark.parametrize("moving", [1, 2, 3])
@pytest.mark.parametrize("gap", [0.0, 1.0e-3])
@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_newtons_cradle_passes_as_many_bodies_as_came(
    shape: str, gap: float, moving: int, dt: float
) -> None:
    """Of five equal bodies in a row, the last leave with the speed of the first, within 1e-4."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    for i in range(5):
        x = i * (0.5 + gap) - (0.3 if i < moving else 0.0)
        ADD[shape](builder, (x, 0.0, 0.0), 2 * 0.25 if shape == "box" else 0.25, restitution=1.0)
    sim = Simulation(builder, dt=dt)
    for i in range(moving):
        sim.set_velocity(i, (2.0, 0.0, 0.0))
    sim.run(0.5)
    expected = np.where(np.arange(5) >= 5 - moving, 2.0, 0.0)
    assert sim.velocity[:, 0] == pytest.approx(expected, abs=2.0e-4)
    assert np.abs(sim.velocity[:, 1:]).max() < 2.0e-4


def test_dominoes_that_bounce_off_each_other_stay_out_of_each_other() -> None:
    """A domino that the ground and its neighbors hold is not put back to where it was struck.

    As if free, it went 2 to 9 mm into its neighbor, depending on rounding. The last ones turn with
    10 rad/s: at 240 steps a second rows miss 0.4 mm of that, the second order, for each.
    """
    builder = newton.ModelBuilder()
    add_dominoes(builder, count=10)
    builder.shape_material_restitution = [0.5] * builder.shape_count
    sim = Simulation(builder, dt=1.0 / 480.0)
    deepest = 0.0
    for _ in range(960):
        sim.step()
        deepest = max(deepest, sim.penetration)
    assert sim.pose[-1, 2] < 0.1  # the last one has toppled
    assert deepest < 5.0e-4


def test_a_hanging_cradle_passes_the_swing_on() -> None:
    """Five pendulums on hinges: the last swings out, the others stay within 0.5 degrees.

    It reaches 28 of 30 degrees; backward Euler takes 2 % of a free pendulum's swing, too.
    """
    length, radius, count = 1.0, 0.1, 5
    builder = newton.ModelBuilder()
    for i in range(count):
        angle = math.radians(30.0) if i == 0 else 0.0
        turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), angle)
        top = wp.vec3(2.0 * radius * i, 0.0, 0.0)
        ball = builder.add_link(
            xform=wp.transform(top + wp.quat_rotate(turn, wp.vec3(0.0, 0.0, -length)), turn)
        )
        builder.add_shape_sphere(ball, radius=radius, cfg=surface(0.0, restitution=1.0))
        joint = builder.add_joint_revolute(
            -1,
            ball,
            parent_xform=wp.transform(top, IDENTITY),
            child_xform=wp.transform(wp.vec3(0.0, 0.0, length), IDENTITY),
            axis=(0.0, 1.0, 0.0),
        )
        builder.add_articulation([joint])
        builder.joint_q[-1] = angle
    sim = Simulation(builder)
    sim.run(0.6)  # a quarter of the period is 0.51 s
    swing = np.zeros(count)
    for _ in range(round(0.5 / sim.dt)):
        sim.step()
        x = sim.pose[:, 0] - 2.0 * radius * np.arange(count)
        swing = np.maximum(swing, np.degrees(np.abs(np.arctan2(x, -sim.pose[:, 2]))))
    assert swing[-1] > 28.0
    assert swing[:-1].max() < 0.5


@pytest.mark.parametrize("restitution", [0.5, 1.0])
def test_a_hinged_bar_gives_back_what_its_inertia_about_the_hinge_says(restitution: float) -> None:
    """A ball hits it r = 0.3 m below the hinge: J = (1 + e) v/(1/m + r^2/I), within 0.2 %."""
    arm, v = 0.3, 3.0
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    bar = builder.add_link(xform=wp.transform(wp.vec3(0.0, 0.0, -0.5), IDENTITY))
    material = surface(0.0, restitution=restitution)
    builder.add_shape_box(bar, hx=0.05, hy=0.05, hz=0.5, cfg=material)
    anchor = wp.transform(wp.vec3(0.0, 0.0, 0.5), IDENTITY)
    joint = builder.add_joint_revolute(-1, bar, child_xform=anchor, axis=(0.0, 1.0, 0.0))
    builder.add_articulation([joint])
    add_sphere(builder, (-0.5, 0.0, -arm), 0.1, mu=0.0, restitution=restitution)
    sim = Simulation(builder)
    sim.set_velocity(1, (v, 0.0, 0.0))
    sim.run(0.25)
    inertia = sim.mass[0] * ((0.1**2 + 1.0**2) / 12.0 + 0.5**2)
    impulse = (1.0 + restitution) * v / (1.0 / sim.mass[1] + arm**2 / inertia)
    assert sim.velocity[1, 0] == pytest.approx(v - impulse / sim.mass[1], abs=2.0e-3 * v)
    assert sim.velocity[0, 4] == pytest.approx(-impulse * arm / inertia, rel=2.0e-3)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_joint_is_closed_in_the_step_in_which_a_ball_bounces_off_its_link(
    scheme: str, parallel: str
) -> None:
    """A ball falls onto a bar on a hinge at 60 Hz: closed within 1e-5 m.

    At second order a step with a rebound left the joint open by g h^2/2, which is 1.4 mm.
    """
    builder = newton.ModelBuilder()
    bar = builder.add_link(xform=wp.transform(wp.vec3(0.5, 0.0, 0.0), IDENTITY))
    material = surface(0.0, restitution=0.8)
    builder.add_shape_box(bar, hx=0.5, hy=0.05, hz=0.05, cfg=material)
    anchor = wp.transform(wp.vec3(-0.5, 0.0, 0.0), IDENTITY)
    joint = builder.add_joint_revolute(-1, bar, child_xform=anchor, axis=(0.0, 1.0, 0.0))
    builder.add_articulation([joint])
    add_sphere(builder, (0.6, 0.0, 0.3), 0.1, gap=0.1, restitution=0.8)
    sim = Simulation(builder, dt=1.0 / 60.0, scheme=scheme, parallel=parallel)
    sim.set_velocity(1, (0.0, 0.0, -3.0))
    bounced = False
    for _ in range(30):
        closing = sim.velocity[1, 2] - sim.velocity[0, 2]
        sim.step()
        bounced |= closing < 0.0 < sim.velocity[1, 2] - sim.velocity[0, 2]
        assert anchor_gaps(sim)[0] < 1.0e-5
    assert bounced


def gas(shape: str, mu: float, restitution: float, side: int = 3, **settings: str) -> Simulation:
    """``side``^3 bodies in empty space that fly at each other, turning."""
    generator = np.random.default_rng(0)
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    for i in range(side**3):
        cell = np.array([i % side, i // side % side, i // side**2]) - 0.5 * (side - 1)
        position = 0.8 * cell + generator.uniform(-0.05, 0.05, 3)
        ADD[shape](builder, position, 0.2, gap=0.05, mu=mu, restitution=restitution)
    sim = Simulation(builder, **settings)
    for i in range(side**3):
        velocity = -3.0 * sim.pose[i, :3] + generator.uniform(-1.0, 1.0, 3)
        sim.set_velocity(i, velocity, generator.uniform(-2.0, 2.0, 3))
    return sim


def test_elastic_spheres_without_friction_keep_energy_and_momentum() -> None:
    """After two seconds of collisions, within 1e-5 and 1e-6 of what they started with."""
    sim = gas("sphere", 0.0, 1.0)
    mass, energy, speed = sim.mass[:, None], sim.kinetic_energy, sim.velocity
    sim.run(2.0)
    assert np.abs(sim.velocity[:, :3] - speed[:, :3]).max() > 1.0  # they did collide
    assert sim.kinetic_energy == pytest.approx(energy, rel=1.0e-5)
    momentum = (mass * (sim.velocity - speed)[:, :3]).sum(axis=0)
    assert np.abs(momentum).max() < 1.0e-6 * math.sqrt(2.0 * energy * sim.mass.sum())


@pytest.mark.parametrize("rate", [480, 960, 1920])
@pytest.mark.parametrize("count", [3, 6])
def test_a_falling_column_of_elastic_spheres_keeps_its_energy(count: int, rate: int) -> None:
    """Impacts that follow each other within a step, the last of which leave some closing slowly."""
    builder = newton.ModelBuilder()
    add_ground(builder, mu=0.0, restitution=1.0)
    for i in range(count):
        add_sphere(builder, (0.0, 0.0, 1.25 + 0.51 * i), mu=0.0, restitution=1.0)
    sim = Simulation(builder, dt=1.0 / rate)
    mass = sim.model.body_mass.numpy()

    def energy() -> float:
        return float(mass @ (G * sim.pose[:, 2] + 0.5 * sim.velocity[:, 2] ** 2))

    start = energy()
    for _ in range(rate):
        sim.step()
    assert energy() == pytest.approx(start, rel=1.5e-2)


@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_friction_and_loss_only_take_energy(shape: str) -> None:
    """With mu = 0.5 and e = 0.5 no step adds more than 1e-5 of it."""
    sim = gas(shape, 0.5, 0.5)
    energy = [sim.kinetic_energy]
    for _ in range(240):
        sim.step()
        energy.append(sim.kinetic_energy)
    assert np.diff(energy).max() < 1.0e-5 * energy[0]
    assert energy[-1] < 0.5 * energy[0]


def test_what_a_moving_wall_throws_back_gains_no_energy() -> None:
    """Seen from the wall, rough boxes that spin fly off with no more than they came with.

    Before the work of the wall counted, single boxes had up to a quarter more.
    """
    rng = np.random.default_rng(3)
    speed, dt = 5.0, 1.0 / 60.0
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    wall = builder.add_body(xform=wp.transform((0.0, 0.0, 0.0), IDENTITY), is_kinematic=True)
    builder.add_shape_box(wall, hx=0.5, hy=40.0, hz=5.0, cfg=surface(restitution=1.0))
    for i in range(24):
        turn = rng.normal(size=4)
        turn = wp.quat(*(turn / np.linalg.norm(turn)).tolist())
        box = add_box(builder, (1.5, 2.0 * i - 24, 0.0), (0.6, 0.4, 0.2), turn, restitution=1.0)
        builder.body_qd[box] = [0.0, 0.0, 0.0, *(6.0 * rng.normal(size=3))]
    sim = Simulation(builder, dt=dt)
    sim.set_velocity(wall, linear=(speed, 0.0, 0.0))

    def energy() -> NDArray[np.float64]:
        v = sim.velocity - np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0])
        spin = np.sum(v[:, 3:] * sim.spin_momentum, axis=1)
        return 0.5 * (sim.mass * np.sum(v[:, :3] ** 2, axis=1) + spin)[1:]

    came = energy()
    for step in range(30):
        pose = sim.state.body_q.numpy()
        pose[wall, 0] = speed * dt * step
        sim.state.body_q.assign(pose)
        sim.step()
        assert np.all(energy() < (1.0 + 1.0e-3) * came)
    assert np.all(sim.velocity[1:, 0] > speed)


@pytest.mark.parametrize("mu", [0.1, 0.3, 1.0])
def test_a_spinning_ball_is_turned_as_coulomb_says(mu: float) -> None:
    """It slips through the impact, mu (1 + e) v along the ground, or ends up rolling: to 1 %.

    At 1 kHz: contacts act half way across the gap that a step closes, here up to 2 mm.
    """
    radius, e, v, spin = 0.25, 0.8, 4.0, 30.0
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_ground(builder, mu, gap=0.1, restitution=e)
    add_sphere(builder, (0.0, 0.0, radius + 0.1), radius, mu=mu, gap=0.1, restitution=e)
    sim = Simulation(builder, dt=1.0e-3)
    sim.set_velocity(0, (0.0, 0.0, -v), (0.0, spin, 0.0))
    sim.run(0.2)
    along = min(mu * (1.0 + e) * v, spin * radius * 2.0 / 7.0)
    assert sim.velocity[0, [0, 2]] == pytest.approx([along, e * v], rel=0.01)
    assert sim.velocity[0, 4] == pytest.approx(spin - along / (0.4 * radius), abs=0.01 * spin)


def test_contact_forces_hold_the_impulse_of_the_impact() -> None:
    """Over the drop and the rebound the ground's force adds up to m (1 + e) v, within 1 %."""
    sim = dropped("sphere", 0.6, 1.0, 1.0 / 240.0)
    observed = sim.observe("contact_f")
    impulse = 0.0
    for _ in range(150):
        sim.step()
        impulse += abs(observed.contact_f.numpy()[:, 2].sum()) * sim.dt
    assert impulse == pytest.approx(sim.mass[0] * 1.6 * math.sqrt(2.0 * G), rel=0.01)


def test_restitution_can_come_at_run_time() -> None:
    """A notification is enough; the ball bounces from then on."""
    sim = dropped("sphere", 0.0, 1.0, 1.0 / 240.0)
    assert not sim.solver.effects.flags.restitution
    sim.step()
    sim.model.shape_material_restitution.fill_(0.5)
    sim.solver.notify_model_changed(newton.ModelFlags.SHAPE_PROPERTIES)
    assert rebound(sim, 1.0) == pytest.approx(0.25, rel=5.0e-3)


def test_compliant_contacts_say_that_they_have_no_restitution() -> None:
    builder = newton.ModelBuilder()
    add_sphere(builder, (0.0, 0.0, 1.0), restitution=0.5)
    with pytest.warns(UserWarning, match="leaves out the restitution of 1 shape"):
        sim = Simulation(builder, compliant_contacts=True)
    assert not sim.solver.effects.flags.restitution
