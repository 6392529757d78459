# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""``SolverAVBD(model, accuracy=...)``: what is asked for is achieved, in any driver alike."""

import math
from collections.abc import Sequence
from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import (
    IDENTITY,
    NO_GRAVITY,
    Array,
    G,
    Simulation,
    add_box,
    add_ground,
    add_mass,
    add_sphere,
)
from newton.solvers import SolverMuJoCo
from scipy.integrate import solve_ivp
from scipy.special import ellipk
from workshop import BODIES, add_workshop

from newton_avbd import SolverAVBD
from newton_avbd.__main__ import main
from newton_avbd.drivers import workers
from newton_avbd.setup.inner_steps import smallest_accuracy

FRAME = 1.0 / 60.0
"""Time of a call [s]."""
SAVED = 0.25
"""Time that the accuracy counts for at once [s]."""
LEVELS = (1e-1, 1e-2, 1e-3, 1e-4)
"""Accuracies that are asked for [m/s]."""


def pendulum(builder: newton.ModelBuilder, angle: float = 1.0, **laws: Any) -> None:
    """A point-like mass on a massless meter, let go at an angle to the vertical [rad]."""
    bob = builder.add_link(mass=1.0, inertia=wp.mat33(1e-3 * np.eye(3)))
    joint = builder.add_joint_revolute(
        -1,
        bob,
        axis=(0.0, 1.0, 0.0),
        child_xform=wp.transform(wp.vec3(0.0, 0.0, 1.0), IDENTITY),
        **laws,
    )
    builder.add_articulation([joint])
    builder.joint_q[-1] = angle
    turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), angle)
    builder.body_q[-1] = wp.transform(wp.quat_rotate(turn, wp.vec3(0.0, 0.0, -1.0)), turn)


def swung(seconds: float, angle: float = 1.0) -> Array:
    """Where that mass is then [m]."""
    stiffness = G / (1.0 + 1e-3)
    found = solve_ivp(
        lambda t, y: [y[1], -stiffness * math.sin(y[0])],
        (0.0, seconds),
        [angle, 0.0],
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    )
    phi = found.y[0, -1]
    return np.array([-math.sin(phi), 0.0, -math.cos(phi)])


def oscillator(builder: newton.ModelBuilder) -> None:
    """1 kg on a slider with a spring, half a meter off, 1 Hz, without gravity."""
    builder.gravity = NO_GRAVITY
    link = builder.add_link(
        xform=wp.transform(wp.vec3(0.5, 0.0, 0.0), wp.quat_identity()),
        mass=1.0,
        inertia=wp.mat33(0.1 * np.eye(3)),
    )
    joint = builder.add_joint_prismatic(
        -1, link, axis=(1.0, 0.0, 0.0), target_ke=4.0 * math.pi**2, target_kd=0.0
    )
    builder.add_articulation([joint])
    builder.joint_q[-1] = 0.5


TENDON = """
<mujoco>
  <worldbody>
    <body>
      <joint name="x" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <tendon><fixed stiffness="{stiffness}"><joint joint="x" coef="1"/></fixed></tendon>
</mujoco>
"""


def spring_of_a_tendon(builder: newton.ModelBuilder, at: float = 0.5) -> None:
    """The same by a tendon of MuJoCo's."""
    SolverMuJoCo.register_custom_attributes(builder)
    builder.gravity = NO_GRAVITY
    builder.add_mjcf(TENDON.format(stiffness=4.0 * math.pi**2))
    builder.joint_q[-1] = at
    builder.body_q[-1] = wp.transform(wp.vec3(at, 0.0, 0.0), IDENTITY)


def simulation(add: Any, **settings: Any) -> Simulation:
    """A scene in calls of a sixtieth of a second."""
    builder = newton.ModelBuilder()
    add(builder)
    collide = builder.shape_count > 0
    return Simulation(builder, dt=FRAME, collide=collide, **settings)


def steps_of(sim: Simulation) -> int:
    """Inner steps of the last call, of all worlds."""
    return int(sim.solver.report().inner.steps.sum())


# Asked for and achieved.


@pytest.mark.parametrize("accuracy", LEVELS)
def test_a_pendulum_is_as_accurate_as_asked(accuracy: float) -> None:
    """Against the elliptic integral: after a period it is back where it started.

    In a second, with what may be spent at once, 1.25 s times the accuracy; the estimate is right
    within a factor of three where it decides about the steps, but for the first one. Of that nobody
    knows more than what backward Euler would miss.
    """
    period = 4.0 * ellipk(math.sin(0.5) ** 2) * math.sqrt((1.0 + 1e-3) / G)
    assert np.allclose(swung(period), swung(0.0), atol=1e-8)
    sim = simulation(pendulum, accuracy=accuracy)
    sim.run(2.0)
    off = float(np.linalg.norm(sim.pose[0, :3] - swung(2.0)))
    report = sim.solver.report().inner
    assert off <= accuracy * (2.0 + SAVED)
    assert not report.missed.any()
    assert report.total[0] <= accuracy * (2.0 + SAVED)
    first = 0.5 * FRAME**2 * G * math.sin(1.0)
    assert off / 3.0 <= report.total[0] <= 3.0 * off + min(first, accuracy * SAVED)


@pytest.mark.parametrize("accuracy", LEVELS)
@pytest.mark.parametrize("add", [oscillator, spring_of_a_tendon])
def test_an_oscillator_is_as_accurate_as_asked(add: Any, accuracy: float) -> None:
    sim = simulation(add, accuracy=accuracy)
    off = 0.0
    for frame in range(60):
        sim.step()
        belongs = 0.5 * math.cos(2.0 * math.pi * (frame + 1) * FRAME)
        off = max(off, abs(sim.pose[0, 0] - belongs))
    assert off <= accuracy * (1.0 + SAVED)
    report = sim.solver.report().inner
    assert off / 3.0 <= report.total[0] <= 3.0 * off


@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 240.0])
@pytest.mark.parametrize(("add", "least"), [(oscillator, 0.8), (pendulum, 0.85)])
def test_the_estimate_is_that_of_the_local_error(add: Any, least: float, dt: float) -> None:
    """Against the exact motion from the state at the start of each step, in position and velocity.

    Within a factor of three on most steps: where the jerk goes through zero the estimate does, too,
    and the error of the velocity is left. Errors of less than a few units of float32 at 1 rad are
    not counted: the state that they are measured by is rounded by as much.
    """
    sim = simulation(add, accuracy=100.0, scheme="generalized_alpha")
    sim.dt = dt
    is_linear = add is oscillator
    rate = 2.0 * math.pi if is_linear else math.sqrt(G / (1.0 + 1e-3))
    ratios = []
    for count in range(round(2.0 / dt)):
        begin = coordinate_of(sim, is_linear)
        sim.step()
        end = coordinate_of(sim, is_linear)
        found = solve_ivp(
            lambda t, y: [y[1], -(rate**2) * (y[0] if is_linear else math.sin(y[0]))],
            (0.0, dt),
            begin,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
        )
        off = end - found.y[:, -1]
        error = math.hypot(off[0], off[1] / rate)
        if count >= 5 and error > 2.0e-7:
            ratios.append(sim.solver.report().inner.estimated[0] * dt / error)
    assert 0.5 < np.median(ratios) < 2.0
    assert np.mean((np.array(ratios) > 1.0 / 3.0) & (np.array(ratios) < 3.0)) >= least


def coordinate_of(sim: Simulation, is_linear: bool) -> Array:
    """Coordinate of the only joint and its rate."""
    if is_linear:
        return np.array([sim.pose[0, 0], sim.velocity[0, 0]])
    return np.array([math.atan2(-sim.pose[0, 0], -sim.pose[0, 2]), sim.velocity[0, 4]])


def test_inner_steps_go_by_the_root_of_the_accuracy() -> None:
    """Second order: a hundredth of the error takes ten times as many steps."""
    counts = []
    for accuracy in (1e-2, 1e-4):
        sim = simulation(oscillator, accuracy=accuracy, scheme="generalized_alpha")
        count = 0
        for _ in range(60):
            sim.step()
            count += steps_of(sim)
        counts.append(count)
    assert 5.0 <= counts[1] / counts[0] <= 12.0


@pytest.mark.parametrize("accuracy", LEVELS[1:])
def test_long_calls_of_smooth_motion_take_a_few_steps_of_fourth_order(accuracy: float) -> None:
    """12 calls of 1/6 s, in at most 45 steps; of second order they are 71, 187 and 548.

    The estimate is within a factor of three of what is achieved.
    """
    sim = simulation(pendulum, accuracy=accuracy)
    sim.dt = 1.0 / 6.0
    count = 0
    for _ in range(12):
        sim.step()
        count += steps_of(sim)
    assert sim.solver.report().order[0] == 4
    off = float(np.linalg.norm(sim.pose[0, :3] - swung(2.0)))
    total = sim.solver.report().inner.total[0]
    assert off <= accuracy * (2.0 + SAVED)
    assert off / 3.0 <= total <= 3.0 * off
    assert count <= 45


def test_a_fall_takes_one_step_a_call() -> None:
    """A parabola is exact, whatever the accuracy."""
    sim = simulation(add_mass, accuracy=1e-3)
    for _ in range(60):
        sim.step()
        assert steps_of(sim) == 1
    assert sim.pose[0, 2] == pytest.approx(-0.5 * G, abs=1e-4)


def test_an_impact_shrinks_the_step_and_it_grows_at_once() -> None:
    """A sphere that falls 1 m stays where it lands: one call takes many steps, others one."""

    def add(builder: newton.ModelBuilder) -> None:
        add_ground(builder)
        add_sphere(builder, (0.0, 0.0, 1.25))

    sim = simulation(add, accuracy=1e-2)
    counts = []
    for _ in range(60):
        sim.step()
        counts.append(steps_of(sim))
    assert max(counts) > 3
    assert sum(count > 1 for count in counts) <= 4
    assert counts[-1] == 1
    assert sim.pose[0, 2] == pytest.approx(0.25, abs=1e-4)
    assert sim.penetration < 1e-4


@pytest.mark.parametrize(("calls", "budget"), [(10, 100), (60, 100), (60, 1000)])
def test_a_stop_takes_the_whole_velocity_at_its_time(calls: int, budget: int) -> None:
    """A pendulum that meets a stop at 2.5 rad/s and swings back from there, 1e-4 m/s, 1 s.

    Before, 8.8e-4 m off: steps were no shorter than a hundredth of a call, though few were taken.
    And 5.6e-4 m with a thousand: what float32 rounds of the angle at the stop was a velocity.
    """
    accuracy, stop = 1e-4, -0.5
    builder = newton.ModelBuilder()
    pendulum(builder, limit_lower=stop, limit_upper=2.0)
    sim = Simulation(builder, dt=1.0 / calls, accuracy=accuracy, inner_steps=budget, collide=False)
    sim.run(1.0)

    def swing(seconds: float, angle: float) -> Any:
        def meets_stop(_t: float, y: Array) -> float:
            return y[0] - stop

        meets_stop.terminal = True
        meets_stop.direction = -1
        return solve_ivp(
            lambda _t, y: [y[1], -G / (1.0 + 1e-3) * math.sin(y[0])],
            (0.0, seconds),
            [angle, 0.0],
            method="DOP853",
            rtol=1e-12,
            atol=1e-12,
            events=meets_stop,
        )

    first = swing(1.0, 1.0)
    assert first.t[-1] < 1.0
    phi = swing(1.0 - first.t[-1], stop + 1e-12).y[0, -1]
    belongs = np.array([-math.sin(phi), 0.0, -math.cos(phi)])
    assert np.linalg.norm(sim.pose[0, :3] - belongs) < accuracy * (1.0 + SAVED)


def test_levers_of_contacts_are_those_of_the_end() -> None:
    """A cube that tips over an edge goes by the angle that it has at the end of a step.

    With levers of the start its error at 60 calls a second is 5.8 mm, and it halves with the step.
    """
    from newton_avbd.study.accuracy.scenes import TILT, add_cube_on_edge, tipped

    sim = simulation(lambda builder: add_cube_on_edge(builder, TILT), accuracy=1e-2)
    sim.run(0.35)
    belongs = tipped(np.array([0.0, 0.35]), TILT, 0.0)[-1, 0]
    assert np.linalg.norm(sim.pose[0, :3] - belongs) < 1.5e-3


def test_a_sphere_rolls_on_within_a_call() -> None:
    """Contacts that were found at the start of a call move along with it, and it does not sink."""
    from newton_avbd.study.accuracy.scenes import add_skidding_sphere

    sim = simulation(add_skidding_sphere, accuracy=1e-3)
    sim.run(1.0)
    assert sim.velocity[0, 0] == pytest.approx(5.0 / 7.0 * 2.0, rel=1e-3)
    assert sim.pose[0, 2] == pytest.approx(0.1, abs=1e-5)


# What is kept.


def test_a_large_accuracy_is_the_plain_step() -> None:
    """Where no call is divided nothing changes but rounding."""
    plain, asked = simulation(pendulum), simulation(pendulum, accuracy=100.0, tolerance=0.0)
    for _ in range(30):
        plain.step()
        asked.step()
        assert steps_of(asked) == 1
        # only the sweeps of a tree that is solved exactly could end earlier
        np.testing.assert_allclose(asked.pose, plain.pose, atol=2e-6)


def test_the_state_that_was_given_stays() -> None:
    sim = simulation(pendulum, accuracy=1e-4)
    before = sim.state.body_q.numpy().copy(), sim.state.body_qd.numpy().copy()
    given = sim.state
    sim.step()
    assert steps_of(sim) > 1
    np.testing.assert_array_equal(given.body_q.numpy(), before[0])
    np.testing.assert_array_equal(given.body_qd.numpy(), before[1])


def test_steps_may_be_in_place() -> None:
    apart, same = simulation(pendulum, accuracy=1e-4), simulation(pendulum, accuracy=1e-4)
    same._next = same.state
    apart.step(20)
    same.step(20)
    np.testing.assert_array_equal(same.pose, apart.pose)
    np.testing.assert_array_equal(same.velocity, apart.velocity)


def test_what_the_user_moves_goes_on_within_a_call() -> None:
    """A box lies on a plate that moves at 1 m/s; the user's pose of the plate stays."""
    builder = newton.ModelBuilder()
    plate = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, -0.05), wp.quat_identity()))
    builder.add_shape_box(
        plate, hx=5.0, hy=5.0, hz=0.05, cfg=newton.ModelBuilder.ShapeConfig(mu=1.0, gap=0.02)
    )
    builder.body_flags[plate] = int(newton.BodyFlags.KINEMATIC)
    box = add_box(builder, (0.0, 0.0, 0.25), 0.5, mu=1.0)
    sim = Simulation(builder, dt=FRAME, accuracy=1e-4)
    sim.set_velocity(plate, (1.0, 0.0, 0.0))
    sim.set_velocity(box, (1.0, 0.0, 0.0))
    for frame in range(30):
        poses = sim.state.body_q.numpy()
        poses[plate, 0] = frame * FRAME
        sim.state.body_q.assign(poses)
        given = sim.state.body_q.numpy()[plate].copy()
        sim.step()
        np.testing.assert_array_equal(sim.state.body_q.numpy()[plate], given)
    assert sim.velocity[box, 0] == pytest.approx(1.0, abs=1e-4)
    assert sim.pose[box, 0] == pytest.approx(30 * FRAME, abs=1e-3)


def test_worlds_share_what_the_user_moves() -> None:
    """Boxes at rest on a belt of 1 m/s that no world owns: dragged along by friction of 1.

    They slide until v = mu g t, and lag by v^2 / (2 mu g).
    """
    builder = newton.ModelBuilder()
    belt = builder.add_body(xform=wp.transform(wp.vec3(0.0, 0.0, -0.05), wp.quat_identity()))
    builder.add_shape_box(
        belt, hx=5.0, hy=5.0, hz=0.05, cfg=newton.ModelBuilder.ShapeConfig(mu=1.0, gap=0.02)
    )
    builder.body_flags[belt] = int(newton.BodyFlags.KINEMATIC)
    for _ in range(2):
        builder.begin_world()
        add_box(builder, (0.0, 0.0, 0.25), 0.5, mu=1.0)
        builder.end_world()
    sim = Simulation(builder, dt=FRAME, accuracy=1e-3)
    sim.set_velocity(belt, (1.0, 0.0, 0.0))
    for frame in range(30):
        poses = sim.state.body_q.numpy()
        poses[belt, 0] = frame * FRAME
        sim.state.body_q.assign(poses)
        sim.step()
    np.testing.assert_allclose(sim.velocity[1:, 0], 1.0, atol=1e-4)
    np.testing.assert_allclose(sim.pose[1:, 0], 0.5 - 0.5 / G, atol=1e-3 * (0.5 + SAVED))


def test_observables_are_those_of_the_call() -> None:
    """The mean of the contact force stops the box; body_qdd is its change of velocity by dt."""

    def add(builder: newton.ModelBuilder) -> None:
        add_ground(builder)
        add_box(builder, (0.0, 0.0, 0.255), 0.5)

    sim = simulation(add, accuracy=1e-3)
    kinds = SolverAVBD.ObservableKind
    seen = sim.observe(kinds.BODY_QDD, kinds.CONTACT_F)
    weight = float(sim.mass[0]) * G
    divided = False
    for _ in range(10):
        before = sim.velocity[0].copy()
        sim.step()
        divided = divided or steps_of(sim) > 1
        change = (sim.velocity[0, 2] - before[2]) / FRAME
        assert seen.body_qdd.numpy()[0, 2] == pytest.approx(change, rel=1e-4, abs=1e-4)
        total = np.abs(seen.contact_f.numpy()[:, 2].sum())
        assert total == pytest.approx(weight + float(sim.mass[0]) * change, rel=2e-3, abs=1e-2)
    assert divided


# The same bits.


def workshops(worlds: Sequence[int], **settings: Any) -> Simulation:
    """Workshops, with nearly every effect, that differ in the speed of a box."""
    builder = newton.ModelBuilder()
    for world in worlds:
        builder.begin_world()
        add_workshop(builder)
        builder.end_world()
        upper = builder.body_count - BODIES + 1
        builder.body_qd[upper] = wp.spatial_vector(0.7 * world, 0.1, 0.0, 0.0, 0.0, 0.4 * world)
    return Simulation(builder, dt=FRAME, accuracy=1e-2, inner_steps=30, **settings)


def by_world(sim: Simulation, count: int) -> Array:
    return np.concatenate([sim.pose, sim.velocity], axis=1).reshape(count, BODIES, -1)


CALLS = 20


@pytest.fixture(scope="module")
def expected() -> Array:
    """Three worlds after some calls from the start; they take different numbers of steps."""
    sim = workshops((0, 1, 2))
    apart = False
    for _ in range(CALLS):
        sim.step()
        steps = sim.solver.report().inner.steps
        apart = apart or len(set(steps.tolist())) > 1
    assert apart
    assert sim.solver.status.held_steps.sum() == 0
    return by_world(sim, 3)


def test_the_bits_are_the_same_again_and_after_a_reset(expected: Array) -> None:
    sim = workshops((0, 1, 2))
    sim.step(7)
    sim.solver.reset(sim.state)
    sim.step(CALLS)
    np.testing.assert_array_equal(by_world(sim, 3), expected)


def test_a_pendulum_takes_the_same_steps_after_a_reset() -> None:
    """Of fourth order, in long calls."""
    ends = []
    builder = newton.ModelBuilder()
    pendulum(builder)
    sim = Simulation(builder, dt=0.1, accuracy=1e-4, collide=False)
    for _ in range(2):
        sim.step(5)
        assert sim.solver.report().order[0] == 4
        ends.append(np.hstack([sim.pose, sim.velocity]))
        sim.solver.reset(sim.state)
    np.testing.assert_array_equal(ends[1], ends[0])


def test_the_bits_are_those_of_other_company(expected: Array) -> None:
    """Which worlds are beside one, and in which order, changes nothing."""
    sim = workshops((2, 0, 1))
    sim.step(CALLS)
    np.testing.assert_array_equal(by_world(sim, 3), expected[[2, 0, 1]])


def test_threads_change_no_bit(expected: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "HANDOVER", 1e-9)
    sim = workshops((0, 1, 2), workers=3)
    sim.step(CALLS)
    np.testing.assert_array_equal(by_world(sim, 3), expected)


def test_a_replayed_graph_is_the_eager_run(expected: Array) -> None:
    """Captured before any call, two calls a graph: how often a world steps is decided in it."""
    sim = workshops((0, 1, 2))
    with wp.ScopedCapture(device="cpu") as capture:
        sim.step(2)
    for _ in range(CALLS // 2):
        wp.capture_launch(capture.graph)
    np.testing.assert_array_equal(by_world(sim, 3), expected)


def test_a_restored_run_goes_on_to_the_same_bits(expected: Array) -> None:
    first, second = workshops((0, 1, 2)), workshops((0, 1, 2))
    first.step(CALLS // 2)
    second.step(3)
    second.solver.restore(first.solver.checkpoint())
    second.state.assign(first.state)
    second.step(CALLS - CALLS // 2)
    np.testing.assert_array_equal(by_world(second, 3), expected)


def test_tendons_of_worlds_go_their_own_ways() -> None:
    """Each to the bits that it has alone."""

    def add(*starts: float) -> Simulation:
        builder = newton.ModelBuilder(gravity=NO_GRAVITY)
        for at in starts:
            builder.begin_world()
            spring_of_a_tendon(builder, at)
            builder.end_world()
        sim = Simulation(builder, dt=FRAME, collide=False, accuracy=1e-4)
        sim.step(CALLS)
        return sim

    both = add(0.5, 0.05)
    assert len(set(both.solver.report().inner.steps.tolist())) == 2
    np.testing.assert_array_equal(both.pose, [add(0.5).pose[0], add(0.05).pose[0]])


@pytest.mark.parametrize(
    ("add", "scheme", "dt"),
    [
        (pendulum, "generalized_alpha", FRAME),
        (pendulum, "runge_kutta", 10.0 * FRAME),
        (spring_of_a_tendon, "generalized_alpha", FRAME),
    ],
)
def test_a_repeated_step_leaves_no_trace(add: Any, scheme: str, dt: float) -> None:
    """A solver that tried a long step first ends where one does that knew the short one."""
    sims = [simulation(add, accuracy=1e-4, scheme=scheme) for _ in range(2)]
    for sim in sims:
        sim.dt = dt
        sim.step(10)
    knows, tries = sims
    tries.solver._history.wanted.fill_(2.0 * dt)
    knows.step()
    tries.step()
    assert tries.solver.report().inner.rejected[0] > 0
    assert knows.solver.report().inner.rejected[0] == 0
    np.testing.assert_allclose(tries.pose, knows.pose, atol=5e-6)


# Budget and report.


def test_the_budget_bounds_a_call_and_the_report_says_what_was_missed(
    capfd: pytest.CaptureFixture[str],
) -> None:
    settings = {"scheme": "generalized_alpha", "inner_steps": 3}
    sim = simulation(lambda builder: pendulum(builder, 2.5), accuracy=1e-4, **settings)
    for _ in range(30):
        sim.step()
        inner = sim.solver.report().inner
        assert inner.steps[0] + inner.rejected[0] <= 3
    assert inner.missed[0] > 5
    assert inner.worst == [sim.model.body_label[0]]
    assert inner.why == ["smooth motion"]
    assert inner.estimated[0] > inner.asked == pytest.approx(1e-4)
    np.testing.assert_array_equal(sim.solver.status.missed_accuracy, inner.missed)
    text = str(sim.solver.report())
    assert "asked: 1.0e-04 m/s; 1 of 1 worlds missed" in text
    wp.synchronize()
    assert capfd.readouterr().out.count("less accurate than it was asked to be") == 1
    sim.solver.reset(sim.state)
    assert not sim.solver.status.missed_accuracy.any()


def test_worlds_decide_on_their_own() -> None:
    """One at rest takes one step while another one swings."""
    builder = newton.ModelBuilder()
    for angle in (0.0, 2.0):
        builder.begin_world()
        pendulum(builder, angle)
        builder.end_world()
    scheme = "generalized_alpha"
    sim = Simulation(builder, dt=FRAME, collide=False, accuracy=1e-3, scheme=scheme)
    sim.step(30)
    quiet, busy = sim.solver.report().inner.steps
    assert quiet == 1
    assert busy > 2


def test_without_an_accuracy_there_is_nothing() -> None:
    plain, asked = simulation(pendulum), simulation(pendulum, accuracy=1e-3)
    assert plain.solver.report().inner is None
    assert plain.solver.effects["adaptive"].bytes == 0
    assert not plain.solver.effects["adaptive"].on
    assert asked.solver.effects["adaptive"].on
    assert asked.solver.effects["adaptive"].bytes > 0
    assert "history.wanted" not in plain.solver.checkpoint()


# What makes no sense, and what cannot be.


@pytest.mark.parametrize("accuracy", [0.0, -1e-3, math.nan, math.inf])
def test_an_accuracy_that_makes_no_sense_is_an_error(accuracy: float) -> None:
    with pytest.raises(ValueError, match="accuracy must be an error a second above 0 m/s"):
        simulation(pendulum, accuracy=accuracy)


def test_an_accuracy_below_rounding_is_an_error_that_names_the_smallest() -> None:
    builder = newton.ModelBuilder()
    pendulum(builder)
    smallest = smallest_accuracy(builder.finalize(device="cpu"))
    assert 1e-6 < smallest < 1e-4
    with pytest.raises(ValueError, match=f"the smallest is {smallest:.1e} m/s"):
        simulation(pendulum, accuracy=0.5 * smallest)
    simulation(pendulum, accuracy=1.01 * smallest)


def test_a_budget_that_makes_no_sense_is_an_error() -> None:
    with pytest.raises(ValueError, match="inner_steps must be at least 1"):
        simulation(pendulum, accuracy=1e-3, inner_steps=0)


@pytest.mark.parametrize(
    ("settings", "remedy"),
    [({"sleeping": True}, "Leave sleeping out"), ({"parallel": "bodies"}, "Leave parallel")],
)
def test_what_cannot_be_together_is_an_error(settings: dict, remedy: str) -> None:
    def add(builder: newton.ModelBuilder) -> None:
        add_ground(builder)
        add_box(builder, (0.0, 0.0, 0.25), 0.5)

    with pytest.raises(NotImplementedError, match=remedy):
        simulation(add, accuracy=1e-3, **settings)
    with pytest.raises(ValueError, match="scheme"):
        simulation(add, accuracy=1e-3, scheme="euler")


AT_A_SITE = """
<mujoco>
  <worldbody>
    <site name="wall"/>
    <body>
      <freejoint/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <site name="nose"/>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""


def at_a_site(actuator: str) -> Any:
    def add(builder: newton.ModelBuilder) -> None:
        SolverMuJoCo.register_custom_attributes(builder)
        builder.gravity = NO_GRAVITY
        builder.add_mjcf(AT_A_SITE.format(actuator=actuator), ctrl_direct=True)

    return add


def test_a_thruster_pushes_within_inner_steps() -> None:
    sim = simulation(at_a_site('<motor site="nose" gear="2 0 0 0 0 0"/>'), accuracy=1e-3)
    sim.control.mujoco.ctrl.fill_(1.0)
    sim.step(60)
    assert sim.pose[0, 0] == pytest.approx(0.5 * 2.0, abs=1e-3 * (1.0 + SAVED))


def test_a_servo_at_a_site_is_not_for_inner_steps() -> None:
    servo = '<position site="nose" refsite="wall" kp="2" gear="1 0 0 0 0 0"/>'
    with pytest.raises(NotImplementedError, match=r"by how these move.*'body_actuators': False"):
        simulation(at_a_site(servo), accuracy=1e-3)


def test_the_study_says_what_was_achieved(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["accuracy", "oscillator", "--control"]) == 0
    out = capsys.readouterr().out
    assert "| oscillator | 1e-03 |" in out
    assert "4 of 4 outcomes keep to what was asked" in out
