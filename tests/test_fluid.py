# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Drag of a fluid: MuJoCo's inertia-box model against its formulas, and against MuJoCo."""

import math
from pathlib import Path

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, G, Simulation, in_float32
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD

SCHEMES = ("euler", "generalized_alpha")
EDGES = np.array([0.2, 0.4, 0.6])
"""Edges of the box that falls and spins [m]."""


def add_fluid(
    builder: newton.ModelBuilder,
    density: float,
    viscosity: float = 0.0,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """Puts the world into a fluid [kg/m^3, Pa s, m/s]."""
    SolverMuJoCo.register_custom_attributes(builder)
    values = {"density": density, "viscosity": viscosity, "wind": wp.vec3(*wind)}
    for name, value in values.items():
        builder.custom_attributes[f"mujoco:{name}"].values = {0: value}


def falling_box(
    density: float,
    viscosity: float = 0.0,
    *,
    gravity: tuple[float, float, float] = (0.0, 0.0, -G),
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **settings: object,
) -> Simulation:
    """A box of 48 kg in a fluid."""
    builder = newton.ModelBuilder(gravity=gravity)
    add_fluid(builder, density, viscosity, wind)
    body = builder.add_body()
    hx, hy, hz = (0.5 * EDGES).tolist()
    builder.add_shape_box(body, hx=hx, hy=hy, hz=hz)
    return Simulation(builder, collide=False, effects={"contact": False}, **settings)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("density", [300.0, 1.0e6, 1.0e9])
def test_a_box_falls_at_its_terminal_velocity_at_any_density(scheme: str, density: float) -> None:
    """1/2 density A v^2 = m g, float32 leaves 1e-5 of it. A step is 0.01 to 20 times the time to
    reach it; backward Euler never goes beyond, second order by 2.5 % at most."""
    sim = falling_box(density, scheme=scheme)
    terminal = math.sqrt(48.0 * G / (0.5 * density * EDGES[0] * EDGES[1]))
    fastest = 0.0
    for _ in range(1200):
        sim.step()
        fastest = max(fastest, -sim.velocity[0, 2])
    assert -sim.velocity[0, 2] == pytest.approx(terminal, rel=2.0e-5)
    assert fastest <= terminal * (1.0 + (2.0e-5 if scheme == "euler" else 0.03))


def test_a_sphere_falls_at_the_terminal_velocity_of_its_box() -> None:
    """A cube of equal inertia, edge a: a^2 = 12/5 r^2."""
    builder = newton.ModelBuilder()
    add_fluid(builder, 1000.0, 5.0)
    radius = 0.1
    body = builder.add_body()
    builder.add_shape_sphere(body, radius=radius, cfg=newton.ModelBuilder.ShapeConfig(density=3e3))
    sim = Simulation(builder, collide=False, effects={"contact": False})
    sim.run(3.0)
    edge = math.sqrt(2.4) * radius
    v = -sim.velocity[0, 2]
    drag = 500.0 * edge**2 * v * v + 15.0 * math.pi * edge * v
    assert drag == pytest.approx(4000.0 * math.pi * radius**3 * G, rel=1.0e-4)


@pytest.mark.parametrize(("scheme", "bound"), [("euler", 5.0e-3), ("generalized_alpha", 2.0e-4)])
def test_a_spin_slows_down_by_the_formula(scheme: str, bound: float) -> None:
    """w0/(1 + c w0 t/I) with density, exp(-c t/I) with viscosity; the bound is the scheme's
    error at 1/240 s, which is of first and of second order."""
    moment = 48.0 / 12.0 * (EDGES[0] ** 2 + EDGES[1] ** 2)
    by_density = 1000.0 * EDGES[2] * (EDGES[0] ** 4 + EDGES[1] ** 4) / 64.0 / moment
    by_viscosity = math.pi * EDGES.mean() ** 3 * 5.0 / moment
    for fluid, expected in (
        ((1000.0, 0.0), 10.0 / (1.0 + 10.0 * by_density)),
        ((0.0, 5.0), 10.0 * math.exp(-by_viscosity)),
    ):
        sim = falling_box(*fluid, gravity=NO_GRAVITY, scheme=scheme)
        sim.state.body_qd.assign([(0.0, 0.0, 0.0, 0.0, 0.0, 10.0)])
        sim.run(1.0)
        assert sim.velocity[0, 5] == pytest.approx(expected, rel=bound)


def test_wind_takes_a_body_along() -> None:
    """Viscosity alone leaves exp(-c t/m) of the difference, backward Euler a step's part more."""
    sim = falling_box(0.0, 5.0, gravity=NO_GRAVITY, wind=(1.0, -2.0, 3.0), scheme="euler")
    sim.run(1.0)
    rate = 3.0 * math.pi * EDGES.mean() * 5.0 / 48.0
    left = (1.0 + rate * in_float32(sim.dt)) ** -240
    assert sim.velocity[0, :3] == pytest.approx((1.0 - left) * np.array([1.0, -2.0, 3.0]), rel=1e-5)


def three_links() -> newton.ModelBuilder:
    """Two plates welded askew, and one on a hinge, in a fluid that blows."""
    builder = newton.ModelBuilder()
    add_fluid(builder, 800.0, 2.0, (1.0, -2.0, 0.5))
    plates = []
    for hx, hy, hz in ((0.1, 0.2, 0.02), (0.02, 0.1, 0.2), (0.02, 0.1, 0.1)):
        plates.append(builder.add_link())
        builder.add_shape_box(plates[-1], hx=hx, hy=hy, hz=hz)
    askew = wp.transform((0.3, 0.1, 0.0), wp.quat_rpy(0.5, 0.1, 1.0))
    up = wp.transform((0.0, 0.0, 0.3), wp.quat_identity())
    aside = wp.transform((0.0, 0.1, 0.0), wp.quat_identity())
    builder.add_articulation(
        [
            builder.add_joint_free(plates[0]),
            builder.add_joint_fixed(plates[0], plates[1], parent_xform=askew, child_xform=up),
            builder.add_joint_revolute(
                plates[1], plates[2], axis=(1, 0, 0), parent_xform=up, child_xform=aside
            ),
        ]
    )
    return builder


def moved(model: newton.Model, solver: newton.solvers.SolverBase, h: float, seed: int):
    """Positions of bodies before and after 0.4 s from random velocities of joints."""
    states = [model.state(), model.state()]
    speeds = np.random.default_rng(seed).normal(size=model.joint_dof_count)
    states[0].joint_qd.assign(speeds.astype(np.float32))
    newton.eval_fk(model, states[0].joint_q, states[0].joint_qd, states[0])
    start = states[0].body_q.numpy()[:, :3].copy()
    for _ in range(round(0.4 / h)):
        solver.step(*states, None, None, h)
        states.reverse()
    return start, states[0].body_q.numpy()[:, :3]


def swimmers() -> list[str]:
    """Files of other packages in which something swims, where these are installed."""
    found = []
    for package, files in (
        ("dm_control.suite", ("fish.xml", "swimmer.xml")),
        ("gymnasium.envs.mujoco", ("assets/swimmer.xml",)),
    ):
        try:
            module = __import__(package, fromlist=["__file__"])
        except ImportError:
            continue
        found += [str(Path(module.__file__).parent / name) for name in files]
    return found


@pytest.mark.parametrize("file", ["", *swimmers()], ids=lambda file: "/".join(file.split("/")[-3:]))
def test_motion_is_that_of_mujoco(file: str) -> None:
    """0.4 s at 1/2000 s: within 0.1 % of the farthest motion; of second order, MuJoCo's own error
    shows, up to 0.2 %."""
    pytest.importorskip("mujoco")
    builder = three_links()
    if file:
        builder = newton.ModelBuilder()
        SolverMuJoCo.register_custom_attributes(builder)
        builder.add_mjcf(file)
    model = builder.finalize(device="cpu")
    h = 1.0 / 2000.0
    theirs = SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True)
    start, expected = moved(model, theirs, h, 1)
    farthest = np.linalg.norm(expected - start, axis=1).max()
    apart = {"contact": False}
    for scheme, bound in (("euler", 1.0e-3), ("generalized_alpha", 2.0e-3)):
        solver = SolverAVBD(model, scheme=scheme, effects=apart)
        _, ours = moved(model, solver, h, 1)
        assert np.linalg.norm(ours - expected, axis=1).max() < bound * farthest
    # Without the fluid it moves otherwise, whoever leaves it out.
    if not file:
        _, dry = moved(model, SolverAVBD(model, effects={**apart, "fluid": False}), h, 1)
        assert np.linalg.norm(dry - expected, axis=1).max() > 0.1 * farthest
    theirs = SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True)
    theirs.mj_model.opt.density = theirs.mj_model.opt.viscosity = 0.0
    _, dry = moved(model, theirs, h, 1)
    assert np.linalg.norm(dry - expected, axis=1).max() > 0.1 * farthest


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
def test_boxes_in_a_dense_wind_go_with_it(parallel: str) -> None:
    """A stack and a pendulum, at a density at which a step is 1e4 times too long to follow: all go
    at 0.5 m/s or are held, and nothing is faster, in a captured graph as well."""
    builder = newton.ModelBuilder()
    add_fluid(builder, 1.0e7, 0.0, (0.5, 0.0, 0.0))
    builder.add_ground_plane()
    for i in range(4):
        body = builder.add_body(
            xform=wp.transform((0.02 * i, 0, 0.1 + 0.2 * i), wp.quat_identity())
        )
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    arm = builder.add_link()
    builder.add_shape_capsule(arm, radius=0.05, half_height=0.2)
    hinge = builder.add_joint_revolute(
        -1,
        arm,
        axis=(0, 1, 0),
        parent_xform=wp.transform((2.0, 0.0, 2.0), wp.quat_identity()),
        child_xform=wp.transform((0.0, 0.0, 0.25), wp.quat_identity()),
    )
    builder.add_articulation([hinge])
    sim = Simulation(builder, parallel=parallel)
    sim.step(2)
    with wp.ScopedCapture(device="cpu") as capture:
        sim.step(2)
    for _ in range(60):
        wp.capture_launch(capture.graph)
        assert np.abs(sim.velocity[:4, :3]).max() < 0.6
    assert sim.velocity[:4, 0] == pytest.approx(0.5, abs=0.05)
    assert np.linalg.norm(sim.velocity[4]) < 1.0


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
def test_a_collision_in_thin_air_keeps_momentum(parallel: str) -> None:
    """Two spheres meet head on, 1:3. Air takes less than 1e-4 of the momentum in the time."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    add_fluid(builder, 1.2)
    for x, density in ((-0.15, 1000.0), (0.15, 3000.0)):
        body = builder.add_body(xform=wp.transform((x, 0.0, 0.0), wp.quat_identity()))
        cfg = newton.ModelBuilder.ShapeConfig(density=density)
        builder.add_shape_sphere(body, radius=0.1, cfg=cfg)
    sim = Simulation(builder, parallel=parallel)
    sim.state.body_qd.assign([(1.0, 0, 0, 0, 0, 0), (-1.0, 0, 0, 0, 0, 0)])
    sim.run(0.1)
    assert sim.velocity[:, 0] == pytest.approx(-0.5, rel=2.0e-3)


def test_links_of_a_weld_carry_what_their_joints_say() -> None:
    """A plate that hangs in a wind: its hinge carries weight and drag."""
    builder = newton.ModelBuilder()
    add_fluid(builder, 100.0, 0.0, (2.0, 0.0, 0.0))
    link = builder.add_link()
    builder.add_shape_box(link, hx=0.1, hy=0.1, hz=0.1)
    slider = builder.add_joint_prismatic(-1, link, axis=(0, 1, 0))
    builder.add_articulation([slider])
    sim = Simulation(builder, collide=False, effects={"contact": False})
    observed = sim.observe("body_parent_f")
    sim.run(0.1)
    force = observed.body_parent_f.numpy()[0, :3]
    assert force == pytest.approx([-0.5 * 100.0 * 0.04 * 4.0, 0.0, 8.0 * G], rel=1.0e-5, abs=1e-5)


def test_a_fluid_is_an_effect_that_changes_can_bring() -> None:
    sim = falling_box(0.0)
    assert not sim.solver.effects["fluid"].on
    sim.step()
    sim.model.mujoco.density.fill_(1000.0)
    sim.solver.notify_model_changed(newton.ModelFlags.ALL)
    assert "body_0" in sim.solver.effects["fluid"].why
    sim.run(2.0)
    terminal = math.sqrt(48.0 * G / (500.0 * EDGES[0] * EDGES[1]))
    assert -sim.velocity[0, 2] == pytest.approx(terminal, rel=1.0e-3)


@pytest.mark.parametrize(
    ("name", "value"), [("density", -1.0), ("viscosity", math.nan), ("wind", math.inf)]
)
def test_a_fluid_that_makes_no_sense_is_refused(name: str, value: float) -> None:
    sim = falling_box(1.0)
    getattr(sim.model.mujoco, name).fill_(value)
    with pytest.raises(ValueError, match=f"mujoco.{name} must be finite"):
        SolverAVBD(sim.model)
