# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Newton's tendons: massless cables through guides, against their formulas."""

import math

import newton
import numpy as np
import pytest
import warp as wp
from newton import TendonGuide as Guide
from newton import TendonGuideType as Kind

from newton_avbd import SolverAVBD

G = 9.81
DTS = (1.0 / 60.0, 1.0 / 240.0)


def at(*place: float) -> wp.transform:
    return wp.transform(wp.vec3(*place), wp.quat_identity())


def weight(builder: newton.ModelBuilder, mass: float, *place: float, **more: bool) -> int:
    """A free body without a shape."""
    inertia = wp.mat33(np.eye(3) * 0.004 * mass)
    return builder.add_body(xform=at(*place), mass=mass, inertia=inertia, **more)


def built(weightless: bool = False) -> newton.ModelBuilder:
    gravity = (0.0, 0.0, 0.0 if weightless else -G)
    return newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=gravity)


class Run:
    """A solver at work, without contacts."""

    def __init__(self, builder: newton.ModelBuilder, dt: float = 1.0 / 240.0, **settings: object):
        self.model = builder.finalize(device="cpu")
        self.solver = SolverAVBD(self.model, **settings)
        self.state, self._next = self.model.state(), self.model.state()
        self.dt = dt

    def steps(self, seconds: float) -> range:
        return range(round(seconds / self.dt))

    def step(self) -> None:
        self.solver.step(self.state, self._next, None, None, self.dt)
        self.state, self._next = self._next, self.state

    def run(self, seconds: float) -> None:
        for _ in self.steps(seconds):
            self.step()

    def set_velocity(self, body: int, *twist: float) -> None:
        velocity = self.state.body_qd.numpy()
        velocity[body] = twist
        self.state.body_qd.assign(velocity)

    def velocity(self, body: int) -> np.ndarray:
        return self.state.body_qd.numpy()[body].astype(float)

    def place(self, body: int) -> np.ndarray:
        return self.state.body_q.numpy()[body, :3].astype(float)

    def tension(self) -> np.ndarray:
        solver = self.solver
        return (
            solver.tendon_segment_material_tension.numpy()
            + solver.tendon_segment_damping_tension.numpy()
        )

    def stretch(self) -> float:
        """How much longer than its material a segment is, at most [m]."""
        solver = self.solver
        longer = solver.tendon_segment_length.numpy() - solver.tendon_segment_rest_length.numpy()
        return float(longer[solver.tendon_segment_active.numpy() == 1].max())

    def energy(self) -> float:
        """Kinetic and potential energy [J], of bodies whose moments are equal."""
        mass = self.model.body_mass.numpy().astype(float)
        moment = self.model.body_inertia.numpy()[:, 0, 0].astype(float)
        q, v = self.state.body_q.numpy().astype(float), self.state.body_qd.numpy().astype(float)
        gravity = -float(self.model.gravity.numpy()[0, 2])
        kinetic = 0.5 * mass * (v[:, :3] ** 2).sum(1) + 0.5 * moment * (v[:, 3:] ** 2).sum(1)
        return float((kinetic + mass * gravity * q[:, 2]).sum())


def atwood(
    masses: tuple[float, float], kind: Kind = Kind.ROLLER, mu: float = 0.0, dt: float = DTS[1]
) -> Run:
    """Two weights on a cable over a guide that is fixed in space."""
    builder = built()
    radius = 0.2 if kind == Kind.ROLLER else 0.0
    left = weight(builder, masses[0], -radius, 0.0, -2.0)
    right = weight(builder, masses[1], radius, 0.0, -2.0)
    over = Guide(body=-1, guide_type=kind, radius=radius, mu=mu, axis=(0.0, 1.0, 0.0))
    builder.add_tendon([Guide(body=left), over, Guide(body=right)])
    return Run(builder, dt)


# Truths.


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("kind", [Kind.ROLLER, Kind.PINHOLE])
@pytest.mark.parametrize("masses", [(1.0, 2.0), (1.0, 1000.0)])
def test_atwood_s_machine(masses: tuple[float, float], kind: Kind, dt: float) -> None:
    """a = (m2 - m1)/(m1 + m2) g and T = 2 m1 m2/(m1 + m2) g, to what float32 rounds of them."""
    run = atwood(masses, kind, dt=dt)
    run.run(0.25)
    one, other = masses
    assert run.velocity(0)[2] / 0.25 == pytest.approx((other - one) / (one + other) * G, rel=1e-5)
    assert run.tension() == pytest.approx(2.0 * one * other / (one + other) * G, rel=1e-5)
    assert run.stretch() < 1e-6
    # the cable has its length, to the digits of 4 m
    assert run.solver.tendon_segment_rest_length.numpy().sum() == pytest.approx(4.0, abs=1e-6)


@pytest.mark.parametrize("mu", [0.1, 0.2, 0.3])
def test_capstan(mu: float) -> None:
    """Half a turn holds e^(mu pi): 2 of weight against 1 slip below mu = ln 2/pi = 0.22."""
    run = atwood((1.0, 2.0), mu=mu)
    run.run(0.5)
    ratio = math.exp(mu * math.pi)
    if ratio > 2.0:
        assert abs(run.velocity(0)[2]) < 1e-5
        assert run.tension() == pytest.approx([G, 2.0 * G], rel=1e-4)
    else:
        assert run.tension()[1] / run.tension()[0] == pytest.approx(ratio, rel=1e-5)
        slides = (2.0 - ratio) / (2.0 + ratio) * G
        assert run.velocity(0)[2] / 0.5 == pytest.approx(slides, rel=1e-5)


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("last", [1.0, 1000.0])
def test_an_inextensible_cable_carries_any_weight(last: float, dt: float) -> None:
    """Three weights below each other, the last one up to 1,000 times as heavy; asked: 0.1 mm."""
    builder = built()
    above = -1
    for i in range(3):
        body = weight(builder, last if i == 2 else 1.0, 0.0, 0.0, -0.5 * (i + 1))
        builder.add_tendon([Guide(body=above), Guide(body=body)])
        above = body
    run = Run(builder, dt)
    longest = 0.0
    for _ in run.steps(0.5):
        run.step()
        longest = max(longest, run.stretch())
    assert longest < 2e-6
    assert run.tension() == pytest.approx(np.array([last + 2, last + 1, last]) * G, rel=2e-4)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_compliant_cable_is_a_spring(scheme: str) -> None:
    """It hangs m g c lower, and swings with sqrt(m c); backward Euler slows that by (w h)^2/2.

    Backward Euler also damps it, so that it hangs still.
    """
    builder = built()
    body = weight(builder, 2.0, 0.0, 0.0, -1.0)
    builder.add_tendon([Guide(body=-1), Guide(body=body, compliance=5e-3, damping=0.0)])
    run = Run(builder, 1.0 / 1000.0, scheme=scheme)
    down, lows = [], []
    for i in run.steps(1.6):
        run.step()
        down.append(-1.0 - run.place(body)[2])
        if i > 1 and down[-2] > down[-1] and down[-2] >= down[-3]:
            lows.append((i - 1) * run.dt)
    assert np.diff(lows).mean() == pytest.approx(2.0 * math.pi * math.sqrt(2.0 * 5e-3), rel=2e-3)
    if scheme == "generalized_alpha":
        return
    damped = Run(builder, 1.0 / 60.0, scheme=scheme)
    damped.run(10.0)
    assert -1.0 - damped.place(body)[2] == pytest.approx(2.0 * G * 5e-3, rel=1e-3)


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("compliance", [0.0, 1e-4])
@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_cable_that_goes_taut_gains_no_energy(scheme: str, compliance: float, dt: float) -> None:
    """By backward Euler not from step to step, of second order never beyond the first."""
    builder = built()
    body = weight(builder, 1.0, 0.1, 0.0, -0.2)
    end = Guide(body=body, offset=(0.0, 0.0, 0.05), compliance=compliance, rest_length=1.0)
    builder.add_tendon([Guide(body=-1), end])
    run = Run(builder, dt, scheme=scheme)
    was_slack = was_taut = False
    before = run.energy()
    for _ in run.steps(2.0):
        run.step()
        stored = 0.5 * compliance * float(run.tension()[0]) ** 2
        now = run.energy() + stored
        assert now < before + 1e-5
        if scheme == "euler":
            before = now
        was_slack = was_slack or run.tension()[0] == 0.0
        was_taut = was_taut or run.tension()[0] > G
        if compliance == 0.0:
            assert run.stretch() < 1e-6
    assert was_slack and was_taut


@pytest.mark.parametrize("kind", [Kind.ROLLER, Kind.PINHOLE])
def test_a_moving_pulley(kind: Kind) -> None:
    """3 kg hang in the loop of a cable from whose end 1 kg does: a = g/7 down, T = 9/7 g."""
    radius = 0.1 if kind == Kind.ROLLER else 0.0
    builder = built()
    pulley = weight(builder, 3.0, 0.0, 0.0, -1.0)
    body = weight(builder, 1.0, 4.0 * radius, 0.0, -1.0)
    axis = (0.0, 1.0, 0.0)
    place = (2.5 * radius, 0.0, 0.0)
    roll = {"guide_type": kind, "axis": axis}
    builder.add_tendon(
        [
            Guide(body=-1, offset=(-radius, 0.0, 0.0)),
            Guide(body=pulley, radius=radius, orientation=-1, **roll),
            Guide(body=-1, radius=1.5 * radius, offset=place, **roll),
            Guide(body=body),
        ]
    )
    run = Run(builder)
    length = run.solver.tendon_segment_length.numpy().sum()
    run.run(0.5)
    assert run.velocity(pulley)[2] / 0.5 == pytest.approx(-G / 7.0, rel=1e-4)
    assert run.velocity(body)[2] / 0.5 == pytest.approx(2.0 * G / 7.0, rel=1e-4)
    assert run.tension() == pytest.approx(9.0 / 7.0 * G, rel=1e-4)
    assert run.solver.tendon_segment_length.numpy().sum() == pytest.approx(length, abs=2e-6)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_bodies_on_a_cable_keep_their_momentum(scheme: str) -> None:
    """Without gravity, for two seconds at 4 rad/s: angular momentum to 3e-5.

    Without islands backward Euler would lose 11 % of it, and BDF2, of second order, 0.5 %.
    """
    builder = built(weightless=True)
    one, other = weight(builder, 1.0, -0.5, 0.0, 0.0), weight(builder, 3.0, 0.5, 0.0, 0.0)
    builder.add_tendon([Guide(body=one, offset=(0.05, 0.02, 0)), Guide(body=other)])
    run = Run(builder, scheme=scheme)
    run.set_velocity(one, 0.0, 3.0, 0.0, 0.0, 0.0, 2.0)
    run.set_velocity(other, 0.2, -1.0, 0.0, 0.0, 0.0, 0.5)
    mass = np.array([1.0, 3.0])
    before, start = run.energy(), None
    for _ in run.steps(2.0):
        run.step()
        velocity = np.array([run.velocity(one), run.velocity(other)])
        place = np.array([run.place(one), run.place(other)])
        momentum = mass @ velocity[:, :3]
        spin = (mass[:, None] * np.cross(place, velocity[:, :3])).sum(0)[2]
        spin += 0.004 * (mass @ velocity[:, 5])
        start = spin if start is None else start
        assert momentum == pytest.approx([0.6, 0.0, 0.0], abs=3e-5)
        if scheme == "euler":
            assert run.energy() < before + 1e-6
        before = run.energy()
    assert run.tension()[0] > 1.0
    assert spin == pytest.approx(start, rel=3e-5)


def test_a_cable_follows_a_guide_that_the_user_moves() -> None:
    """At 1 m/s, by its poses alone."""
    builder = built()
    hook = builder.add_body(xform=at(0.0, 0.0, 0.0), is_kinematic=True)
    body = weight(builder, 1.0, 0.0, 0.0, -1.0)
    builder.add_tendon([Guide(body=hook), Guide(body=body)])
    run = Run(builder)
    run.run(0.1)
    for i in run.steps(0.5):
        pose = run.state.body_q.numpy()
        pose[hook, 2] = (i + 1) * run.dt
        run.state.body_q.assign(pose)
        run.step()
    assert run.velocity(body)[2] == pytest.approx(1.0, abs=1e-4)
    assert run.place(body)[2] == pytest.approx(-0.5, abs=1e-5)
    assert run.tension()[0] == pytest.approx(G, rel=1e-2)


def test_a_cable_that_is_too_long_at_first_shortens_without_a_throw() -> None:
    builder = built()
    body = weight(builder, 1.0, 0.0, 0.0, -1.1)
    builder.add_tendon([Guide(body=-1), Guide(body=body, rest_length=1.0)])
    run = Run(builder)
    run.run(0.1)
    assert run.place(body)[2] == pytest.approx(-1.0, abs=1e-5)
    assert np.abs(run.velocity(body)).max() < 1e-3


# Routes.


def switch() -> tuple[Run, int]:
    """A cable between two points, one of which the user moves across a roller that it may meet."""
    builder = built(weightless=True)
    hand = builder.add_body(xform=at(1.0, 0.0, 1.0), is_kinematic=True)
    y = (0.0, 1.0, 0.0)
    builder.add_tendon(
        [
            Guide(body=-1, offset=(0.0, 0.0, -1.0), axis=y),
            Guide(
                body=-1, guide_type=Kind.ROLLER, radius=0.1, orientation=-1, dynamic=True, axis=y,
                compliance=1e-3,
            ),
            Guide(body=hand, axis=y, compliance=1e-3),
        ]
    )  # fmt: skip
    return Run(builder), hand


def test_a_dynamic_guide_is_touched_where_the_way_leads_there() -> None:
    """And its material is the same before and after, to rounding."""
    run, hand = switch()
    rest = run.solver.tendon_segment_rest_length.numpy().copy()
    assert not run.solver.tendon_guide_active.numpy()[1]
    seen = set()
    for x in (*np.linspace(1.0, -1.0, 50), *np.linspace(-1.0, 1.0, 50)):
        pose = run.state.body_q.numpy()
        pose[hand, 0] = x
        run.state.body_q.assign(pose)
        run.step()
        touched = bool(run.solver.tendon_guide_active.numpy()[1])
        assert touched == bool(run.solver.tendon_segment_active.numpy()[1])
        seen.add(touched)
        ends = run.solver.tendon_segment_attachment_r.numpy()[0]
        if touched:
            assert np.linalg.norm(ends) == pytest.approx(0.1, abs=1e-6)
    assert seen == {False, True}
    assert not run.solver.tendon_guide_active.numpy()[1]
    assert run.solver.tendon_segment_rest_length.numpy()[0] == pytest.approx(rest[0], abs=2e-4)


@pytest.mark.parametrize("seed", range(12))
def test_random_cables_stay_finite_and_gain_no_energy(seed: int) -> None:
    """Bodies of 10 g to a ton, thrown, on cables through each other's guides in random order.

    What they have at most is what they started with. Many such steps do not settle in 10 sweeps.
    """
    random = np.random.default_rng(seed)
    builder = built()
    ends = [-1]
    for _ in range(random.integers(2, 6)):
        ends.append(weight(builder, 10.0 ** random.uniform(-2, 3), *random.uniform(-1.5, 1.5, 3)))
    compliance = random.choice([0.0, 0.0, 1e-6, 1e-4])
    for _ in range(random.integers(1, 4)):
        count = random.integers(2, 6)
        route: list[Guide] = []
        for k in range(count):
            others = [end for end in ends if not route or end != route[-1].body]
            body = int(random.choice(others))
            kind = Kind.ANCHOR if k in (0, count - 1) else Kind(random.choice([0, 2]))
            route.append(
                Guide(
                    body=body,
                    guide_type=kind,
                    radius=0.05 if kind == Kind.ROLLER else 0.0,
                    mu=random.choice([0.0, 0.1, 5.0]),
                    orientation=int(random.choice([-1, 1])),
                    offset=tuple(random.uniform(-0.1, 0.1, 3)),
                    axis=(0.0, 1.0, 0.0),
                    compliance=compliance if k else 0.0,
                )
            )
        builder.add_tendon(route)
    run = Run(builder, DTS[seed % 2])
    run.state.body_qd.assign(random.uniform(-3.0, 3.0, run.state.body_qd.numpy().shape))
    start = run.energy()
    mass = float(run.model.body_mass.numpy().sum())
    for _ in run.steps(1.0):
        run.step()
        assert run.energy() < start + 1e-4 * mass * G
    assert np.isfinite(run.state.body_q.numpy()).all()
    assert not run.solver.status.held_steps.any()


# What a solver promises.


def two_worlds() -> newton.ModelBuilder:
    """Each with a weight on a string, and one with two over a roller with friction."""
    world = built()
    left, right = weight(world, 1.0, -0.2, 0.0, -2.0), weight(world, 2.0, 0.2, 0.0, -2.0)
    over = Guide(body=-1, guide_type=Kind.ROLLER, radius=0.2, mu=0.1, axis=(0.0, 1.0, 0.0))
    world.add_tendon([Guide(body=left), over, Guide(body=right)])
    ball = weight(world, 1.0, 1.0, 0.0, -1.0)
    world.add_tendon([Guide(body=-1), Guide(body=ball, compliance=1e-4)])
    builder = built()
    builder.replicate(world, 2)
    return builder


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_checkpoint_goes_on_to_the_same_bits_and_a_reset_starts_one_world_again(
    scheme: str,
) -> None:
    run = Run(two_worlds(), scheme=scheme)
    run.run(0.2)
    kept = run.solver.checkpoint()
    start = run.model.state()
    start.assign(run.state)
    run.run(0.1)
    again = Run(two_worlds(), scheme=scheme)
    again.solver.restore(kept)
    again.state.assign(start)
    again.run(0.1)
    q = run.state.body_q.numpy()
    assert np.array_equal(again.state.body_q.numpy(), q)
    # both worlds are alike
    assert np.array_equal(q[:3], q[3:])
    mask = wp.array([False, True, False], dtype=wp.bool, device="cpu")
    run.solver.reset(run.state, mask)
    run.run(0.2)
    fresh = Run(two_worlds(), scheme=scheme)
    fresh.run(0.2)
    assert np.array_equal(run.state.body_q.numpy()[3:], fresh.state.body_q.numpy()[3:])
    rest = run.solver.tendon_segment_rest_length.numpy()
    assert np.array_equal(rest[3:], fresh.solver.tendon_segment_rest_length.numpy()[3:])
    assert rest[0] < rest[3]


def test_a_captured_graph_goes_to_the_same_bits() -> None:
    eager, captured = atwood((1.0, 2.0), mu=0.1), atwood((1.0, 2.0), mu=0.1)
    for _ in range(2):
        eager.step()
        captured.step()
    with wp.ScopedCapture(device="cpu") as capture:
        captured.step()
        captured.step()
    for _ in range(10):
        wp.capture_launch(capture.graph)
    for _ in range(20):
        eager.step()
    assert np.array_equal(eager.state.body_q.numpy(), captured.state.body_q.numpy())


def test_a_large_world_lifts_a_box_off_the_ground() -> None:
    """By a heavier one, over a pulley of some inertia to whose rim the cable sticks."""
    builder = built()
    inertia = wp.mat33(np.eye(3) * 0.02)
    pulley = builder.add_link(xform=at(0.0, 0.0, 3.0), mass=1.0, inertia=inertia)
    hinge = builder.add_joint_revolute(-1, pulley, axis=(0, 1, 0), parent_xform=at(0.0, 0.0, 3.0))
    builder.add_articulation([hinge])
    boxes = []
    for x, z, half in ((-0.2, 0.1, 0.1), (0.2, 1.5, 0.12)):
        boxes.append(builder.add_body(xform=at(x, 0.0, z)))
        builder.add_shape_box(boxes[-1], hx=half, hy=half, hz=half)
    over = Guide(body=pulley, guide_type=Kind.ROLLER, radius=0.2, mu=9.0, axis=(0.0, 1.0, 0.0))
    light, heavy = boxes
    builder.add_tendon([Guide(body=light), over, Guide(body=heavy)])
    builder.add_ground_plane()
    run = Run(builder, parallel="bodies")
    pipeline = newton.CollisionPipeline(run.model)
    contacts = pipeline.contacts()
    for _ in run.steps(0.5):
        pipeline.collide(run.state, contacts)
        run.solver.step(run.state, run._next, None, contacts, run.dt)
        run.state, run._next = run._next, run.state
    one, other = run.model.body_mass.numpy()[boxes]
    lift = (other - one) * G / (one + other + 0.02 / 0.2**2)
    # in its first step the ground still holds the box a little
    assert run.velocity(light)[2] / 0.5 == pytest.approx(lift, rel=2e-3)
    assert run.velocity(pulley)[4] == pytest.approx(run.velocity(light)[2] / 0.2, rel=1e-4)
    pulls = np.array([one * (G + lift), other * (G - lift)])
    assert run.tension() == pytest.approx(pulls, rel=2e-3)
    assert run.stretch() < 2e-6


def test_effects_say_that_there_are_cables() -> None:
    effects = atwood((1.0, 2.0)).solver.effects
    assert effects["cables"].on and effects["cables"].bytes > 0
    assert "1 tendon" in effects["cables"].why
    plain = built()
    weight(plain, 1.0, 0.0, 0.0, 0.0)
    without = SolverAVBD(plain.finalize(device="cpu"))
    assert not without.effects["cables"].on and without.effects["cables"].bytes == 0
    assert without.tendon_segment_rest_length is None


@pytest.mark.parametrize(
    ("array", "index", "value", "message"),
    [
        ("tendon_start", 1, 1, "tendon 0 .* has fewer than two guides"),
        ("tendon_guide_body", 2, 7, "guide 2 of tendon 0 .* is on body 7, and the model has 2"),
        ("tendon_segment_compliance", 1, -1.0, "guide 2 of tendon 0 .* is -1.0: set compliance"),
        ("tendon_segment_damping", 0, np.nan, "guide 1 of tendon 0 .* is nan: set damping"),
        ("tendon_guide_mu", 1, np.inf, "guide 1 of tendon 0 .* is inf: set mu"),
        ("tendon_segment_rest_length", 0, np.nan, "guide 1 of tendon 0 .* is not finite"),
        ("tendon_guide_radius", 1, 0.0, "guide 1 of tendon 0 .* is a roller without a radius"),
        ("tendon_guide_orientation", 1, 0, "guide 1 of tendon 0 .* winds on side 0"),
        ("tendon_guide_axis", 1, (0.0, 0.0, 2.0), "axis of guide 1 of tendon 0 .* normalize"),
    ],
)
def test_a_cable_that_makes_no_sense_is_named(
    array: str, index: int, value: object, message: str
) -> None:
    model = atwood((1.0, 2.0)).model
    values = getattr(model, array).numpy()
    values[index] = value
    getattr(model, array).assign(values)
    with pytest.raises(ValueError, match=message):
        SolverAVBD(model)


@pytest.mark.parametrize("setting", [{"sleeping": True}, {"formulation": "ramp"}])
def test_settings_that_cables_do_without_are_refused(setting: dict[str, object]) -> None:
    with pytest.raises(NotImplementedError, match="tendons"):
        SolverAVBD(atwood((1.0, 2.0)).model, **setting)


def test_a_route_stays_and_lengths_may_change() -> None:
    run = atwood((1.0, 1.0))
    run.step()
    model = run.model
    rest = model.tendon_segment_rest_length
    rest.assign(np.array([2.5, 2.0]))
    run.solver.notify_model_changed(newton.ModelFlags.TENDON_PROPERTIES)
    run.run(0.1)
    assert run.stretch() < 1e-6 and abs(run.velocity(0)[2]) < 1e-4  # it goes on as it was
    run.solver.reset(run.state)
    run.step()
    assert run.tension() == pytest.approx(0.0)  # 0.5 m longer
    model.tendon_guide_radius.fill_(0.1)
    with pytest.raises(ValueError, match="tendon_guide_radius has changed"):
        run.solver.notify_model_changed(newton.ModelFlags.TENDON_PROPERTIES)
