# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's equality constraints of joints: polynomials, axes of one joint, joints that are held."""

import math
import warnings
from typing import Any

import mujoco
import newton
import numpy as np
import pytest
from helpers import Array, Simulation, add_box, add_ground
from joint_scenes import coordinates
from newton.solvers import SolverMuJoCo
from numpy.polynomial import Polynomial
from scipy.integrate import solve_ivp

from newton_avbd import SolverAVBD

pytestmark = pytest.mark.usefixtures("shared_kernels")

G = 9.81
CURVE = (0.1, 0.5, 0.8, -0.6, 0.7)
"""The height of the first slider, by where the second one is."""
MASSES = (2.0, 1.0)
DT = 1.0 / 1000.0
SCHEME = "generalized_alpha"


def slider(name: str, axis: str, at: float, mass: float, more: str = "") -> str:
    return f"""<body name="{name}" pos="0 {at} 0"><joint name="{name}" type="slide" axis="{axis}"/>
      {more}<geom size=".1" mass="{mass}" contype="0" conaffinity="0"/></body>"""


def scene(bodies: str, equality: str) -> str:
    return f"""<mujoco><option gravity="0 0 -{G}" timestep="0.0005" integrator="RK4"/>
      <compiler autolimits="true"/><worldbody>{bodies}</worldbody>
      <equality>{equality}</equality></mujoco>"""


def two_sliders(equality: str | None = None) -> str:
    if equality is None:
        coefficients = " ".join(map(str, CURVE))
        equality = f'<joint joint1="up" joint2="along" polycoef="{coefficients}"/>'
    up = slider("up", "0 0 1", 0.0, MASSES[0])
    return scene(up + slider("along", "1 0 0", 1.0, MASSES[1]), equality)


def build(text: str, **options: Any) -> newton.ModelBuilder:
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    with warnings.catch_warnings():
        # Newton's, of what its mimics lack
        warnings.simplefilter("ignore")
        builder.add_mjcf(text, **options)
    return builder


def closed_path(x0: float, times: Array) -> Array:
    """Where the second slider is: (m2 + m1 p'^2) x'' = -m1 p' (g + p'' x'^2)."""
    curve = Polynomial(CURVE)
    first, second = curve.deriv(), curve.deriv(2)
    m1, m2 = MASSES

    def rate(_t: float, y: Array) -> list[float]:
        x, v = y
        push = -m1 * first(x) * (G + second(x) * v * v)
        return [v, push / (m2 + m1 * first(x) ** 2)]

    return solve_ivp(rate, (0.0, times[-1]), [x0, 0.0], t_eval=times, rtol=1e-10).y[0]


def started(text: str, q: list[float], **settings: Any) -> Simulation:
    options = {"convert_mjc_equality_constraints": settings.pop("converted", True)}
    builder = build(text, **options)
    builder.joint_q[:] = q
    sim = Simulation(builder, collide=False, **settings)
    newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
    return sim


@pytest.mark.parametrize("converted", [True, False])
def test_a_polynomial_leads_a_joint(converted: bool) -> None:
    """Two masses on slides swing as the one coordinate that they are: within 0.05 mm in a second,
    as a scheme of second order allows, and on the curve to 2e-6 m all the time."""
    x0 = 0.4
    curve = Polynomial(CURVE)
    sim = started(two_sliders(), [curve(x0), x0], converted=converted, dt=DT, scheme=SCHEME)
    assert sim.solver.effects.flags.equalities
    path = []
    for _ in range(40):
        sim.step(25)
        q = coordinates(sim)[0]
        assert abs(q[0] - curve(q[1])) < 2.0e-6
        path.append(q[1])
    times = 0.025 * np.arange(1, 41)
    np.testing.assert_allclose(path, closed_path(x0, times), atol=5.0e-5)


def test_what_pulls_the_first_joint_moves_the_second_by_the_slope() -> None:
    """m2 a2 = -p' f at the start: the force acts through the slope of the curve, 0.5 at 0."""
    sim = started(two_sliders(), [CURVE[0], 0.0])
    sim.step()
    slope = CURVE[1]
    expected = -MASSES[0] * slope * G / (MASSES[1] + MASSES[0] * slope**2)
    _, qd = coordinates(sim)
    # of the step's own length: the curve bends by p''/2 x of it
    assert qd[1] / sim.dt == pytest.approx(expected, rel=2.0e-3)
    assert qd[0] / qd[1] == pytest.approx(slope, rel=2.0e-3)


def in_mujoco(text: str, q: list[float], seconds: float) -> Array:
    """Coordinates in MuJoCo C after a time, with constraints as stiff as its step lets them be."""
    model = mujoco.MjModel.from_xml_string(text)
    model.eq_solref[:] = (0.002, 1.0)
    model.eq_solimp[:] = (0.9999, 0.9999, 0.001, 0.5, 2.0)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + q
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return data.qpos - model.qpos0


def three_joints(equality: str) -> str:
    """A slider, an arm whose reference is not zero, and a body on two slides at once."""
    arm = """<body name="b" pos="0 1 0">
      <joint name="arm" type="hinge" axis="0 1 0" ref="30"/>
      <geom size=".1" pos=".3 0 0" mass="1" contype="0" conaffinity="0"/></body>"""
    second = '<joint name="second" type="slide" axis="0 0 1"/>'
    bodies = slider("up", "0 0 1", 0.0, 1.0) + arm + slider("first", "1 0 0", 2.0, 0.5, second)
    return scene(bodies, equality)


TIES = {
    "of an arm, counted from its reference": (
        '<joint joint1="up" joint2="arm" polycoef="0 -0.3 0.2 0 0"/>'
        '<joint joint1="second" joint2="up" polycoef="0 1 0 0 0"/>',
        [0.0, 0.0, 0.0, 0.0],
    ),
    "of two axes of one joint": (
        '<joint joint1="second" joint2="first" polycoef="0 0.5 1 0 0"/>'
        '<joint joint1="up" polycoef="0 1 0 0 0"/>',
        [0.0, 0.0, 0.0, 0.0],
    ),
    "of a joint that is held": (
        '<joint joint1="arm" polycoef="0.2 1 0 0 0"/><joint joint1="second" polycoef="0 1 0 0 0"/>',
        [0.0, 0.2, 0.0, 0.0],
    ),
    "of a joint that follows another by a polynomial": (
        '<joint joint1="second" joint2="up" polycoef="0 0.5 0.2 0 0"/>'
        '<joint joint1="up" joint2="arm" polycoef="0 -0.3 0.2 0 0"/>',
        [0.0, 0.0, 0.0, 0.0],
    ),
}


@pytest.mark.parametrize("case", TIES)
def test_ties_of_all_kinds_move_as_in_mujoco(case: str) -> None:
    """Within 0.5 mm or 0.5 mrad after 0.3 s, of motion of tenths: MuJoCo's own constraints give way
    by 0.3."""
    equality, q = TIES[case]
    text = three_joints(equality)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        sim = started(text, q, dt=DT, scheme=SCHEME)
    sim.run(0.3)
    expected = in_mujoco(text, q, 0.3)
    assert np.abs(expected - q).max() > 0.1
    np.testing.assert_allclose(coordinates(sim)[0], expected, atol=5.0e-4)


def test_an_equality_that_starts_off_closes_without_gaining_speed() -> None:
    """The start is corrected in positions, as that of a mimic."""
    sim = started(two_sliders(), [CURVE[0] + 0.01, 0.0])
    sim.model.set_gravity((0.0, 0.0, 0.0))
    sim.run(0.25)
    q, qd = coordinates(sim)
    assert abs(q[0] - Polynomial(CURVE)(q[1])) < 1.0e-4
    assert np.abs(qd).max() < 1.0e-3


def test_a_polynomial_that_changes_is_followed_at_once() -> None:
    """Coefficients are read in each step."""
    sim = started(two_sliders('<joint joint1="along" polycoef="0"/>'), [0.0, 0.0])
    sim.model.set_gravity((0.0, 0.0, 0.0))
    polynomial = sim.model.mujoco.equality_constraint_polycoef.numpy()
    polynomial[0, 0] = 0.05
    sim.model.mujoco.equality_constraint_polycoef.assign(polynomial)
    sim.run(0.25)
    assert coordinates(sim)[0][1] == pytest.approx(0.05, abs=1.0e-4)
    polynomial[0, 0] = np.nan
    sim.model.mujoco.equality_constraint_polycoef.assign(polynomial)
    with pytest.raises(ValueError, match="polycoef"):
        sim.solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)


def test_a_polynomial_that_is_switched_off_leaves_no_mimic_behind() -> None:
    """The importer makes a linear mimic of it, too: both joints are free, before and at run time.

    The weight falls by g t^2/2 and the other slide stays where it is, within 2e-5.
    """
    sim = started(two_sliders(), [CURVE[0], 0.0], dt=DT, scheme=SCHEME)
    sim.model.mujoco.equality_constraint_enabled.fill_(False)
    assert not SolverAVBD(sim.model).effects.flags.mimics
    sim.solver.notify_model_changed(newton.ModelFlags.CONSTRAINT_PROPERTIES)
    sim.run(0.1)
    fall = 0.5 * G * 0.1**2
    np.testing.assert_allclose(coordinates(sim)[0], [CURVE[0] - fall, 0.0], atol=2.0e-5)


def test_a_disabled_equality_holds_nothing_and_others_are_named() -> None:
    """Of rows that tie a body to itself, or the world, the solver says that it leaves them out."""
    text = two_sliders('<joint joint1="along" polycoef="0" active="false"/>')
    sim = started(text, [0.0, 0.0])
    assert not sim.solver.effects.flags.equalities
    rows = '<connect name="rope" body1="up" body2="up" anchor="0 0 0"/><weld body1="lost"/>'
    builder = build(two_sliders(rows), convert_mjc_equality_constraints=False)
    found = r"2 MuJoCo equality constraints \('.*rope', 'row 1'\).*two bodies"
    with pytest.warns(UserWarning, match=found):
        SolverAVBD(builder.finalize(device="cpu"))


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_the_error_is_of_the_order_of_the_scheme(scheme: str) -> None:
    """Half the step halves the error of backward Euler, and quarters that of BDF2."""
    x0 = 0.4
    expected = closed_path(x0, np.array([0.5]))[0]
    errors = []
    for dt in (4.0e-3, 2.0e-3):
        sim = started(two_sliders(), [Polynomial(CURVE)(x0), x0], dt=dt, scheme=scheme)
        sim.run(0.5)
        errors.append(abs(coordinates(sim)[0][1] - expected))
    assert errors[0] / errors[1] == pytest.approx(
        {"euler": 2.0, "generalized_alpha": 4.0}[scheme], rel=0.2
    )


def test_equalities_beside_welds() -> None:
    """Joints are numbered otherwise where FIXED ones make bodies one."""
    tip = '<body pos="0.2 0 0"><geom size=".05" mass="0.5" contype="0" conaffinity="0"/></body>'
    up = slider("up", "0 0 1", 0.0, 1.5).replace("</body>", tip + "</body>")
    curve = " ".join(map(str, CURVE))
    equality = f'<joint joint1="up" joint2="along" polycoef="{curve}"/>'
    text = scene(up + slider("along", "1 0 0", 1.0, MASSES[1]), equality)
    x0 = 0.4
    sim = started(text, [Polynomial(CURVE)(x0), x0], dt=DT, scheme=SCHEME)
    assert sim.solver.effects.flags.welds
    sim.run(0.25)
    assert coordinates(sim)[0][1] == pytest.approx(closed_path(x0, np.array([0.25]))[0], abs=5e-5)


@pytest.mark.parametrize("parallel", ["worlds", "bodies"])
def test_equalities_of_each_world_and_of_bodies_solved_by_color(parallel: str) -> None:
    """Beside a box on the ground, in two worlds: as one world alone."""
    curve = Polynomial(CURVE)
    single = build(two_sliders())
    single.joint_q[:] = [curve(0.4), 0.4]
    add_ground(single)
    add_box(single, (5.0, 0.0, 0.25))
    builder = newton.ModelBuilder()
    builder.replicate(single, 2)
    sim = Simulation(builder, parallel=parallel)
    newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
    alone = started(two_sliders(), [curve(0.4), 0.4])
    for simulation in (sim, alone):
        simulation.run(0.25)
    q = coordinates(sim)[0].reshape(2, -1)[:, :2]
    np.testing.assert_allclose(q, np.tile(coordinates(alone)[0], (2, 1)), atol=2.0e-6)


def test_a_weld_takes_a_free_body_to_where_it_holds_it() -> None:
    """0.2 m and 0.3 rad away from where it starts, against its weight; at rest in the end."""
    half = math.sin(0.15), math.cos(0.15)
    text = f"""<mujoco><worldbody><body name="box" pos="0 0 1"><freejoint/>
      <geom type="box" size=".1 .2 .3" mass="2" contype="0" conaffinity="0"/></body></worldbody>
      <equality><weld body1="box" solref=".004 1" relpose="-0.2 0 -1 {half[1]} {-half[0]} 0 0"/>
      </equality></mujoco>"""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text)
    sim = Simulation(builder, collide=False)
    sim.run(1.0)
    reference = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(reference)
    for _ in range(2000):
        mujoco.mj_step(reference, data)
    # MuJoCo's soft weld sags by some tenths of a millimeter
    np.testing.assert_allclose(sim.pose[0, :3], data.xpos[1], atol=1.0e-3)
    angle = 2.0 * np.arccos(abs(sim.pose[0, 3:] @ data.xquat[1][[1, 2, 3, 0]]))
    assert angle < 1.0e-3
    assert np.abs(sim.velocity).max() < 1.0e-4
