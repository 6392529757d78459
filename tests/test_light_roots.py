# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A ball of half a gram, which nothing else holds, carries a box of 1.5 t by a joint."""

from typing import Any

import newton
import numpy as np
import pytest
from helpers import Simulation
from joint_scenes import add_link, set_control, simulate, transform

BALL, BOX = 0, 1
BALL_MOMENT = 5.0e-7
SPIN = np.array([6.0, -12.0, 8.0])
STEPS = 48


def carrying(
    kind: str,
    held: Any = (0.0, 0.0, 0.0),
    box_mass: float = 1500.0,
    scheme: str | None = None,
    **axis: float,
) -> Simulation:
    """The joint is in the center of the ball and at ``held`` [m] in the box; no gravity."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    ball = add_link(builder, mass=5.0e-4, inertia=[BALL_MOMENT] * 3)
    box = add_link(builder, mass=box_mass, inertia=box_mass * np.array([0.007, 0.022, 0.026]))
    free = builder.add_joint_free(ball)
    add = getattr(builder, f"add_joint_{kind}")
    builder.add_articulation([free, add(ball, box, child_xform=transform(held), **axis)])
    return simulate(builder, scheme=scheme)


def spin(sim: Simulation, held: Any = (0.0, 0.0, 0.0)) -> None:
    """Turns both about the joint."""
    sim.set_velocity(BALL, angular=SPIN)
    sim.set_velocity(BOX, np.cross(SPIN, -np.asarray(held)), SPIN)


@pytest.mark.parametrize("held", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.1)])
def test_a_ball_joint_in_its_center_does_not_turn_the_ball(held: Any) -> None:
    """It turns on as it did, while the box tumbles and keeps its momentum within 1e-5.

    What backward Euler has taken of that, 1e-3, both get back together, so that the ball turns by
    1e-4 of its spin otherwise.
    """
    sim = carrying("ball", held, scheme="euler")
    spin(sim, held)
    momentum = sim.spin_momentum[BOX]
    sim.step(STEPS)
    np.testing.assert_allclose(sim.velocity[BALL, 3:], SPIN, rtol=2.0e-4)
    lost = np.linalg.norm(sim.spin_momentum[BOX] - momentum)
    assert lost < 1.0e-5 * np.linalg.norm(momentum)


@pytest.mark.parametrize("held", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.1)])
def test_a_box_that_tumbles_on_a_light_ball_keeps_momentum_and_energy(held: Any) -> None:
    """About its intermediate axis, for 2 s: within 3e-3, of second order in a step of 0.065 rad.

    Backward Euler is off by 3e-2 of the momentum and 9e-2 of the energy.
    """
    sim = carrying("ball", held)
    spin(sim, held)
    momentum, size = sim.spin_momentum[BOX], np.linalg.norm(sim.spin_momentum[BOX])
    energy = 0.5 * sim.velocity[BOX, 3:] @ momentum
    for _ in range(480):
        sim.step()
        assert np.linalg.norm(sim.spin_momentum[BOX] - momentum) < 3.0e-3 * size
        now = 0.5 * sim.velocity[BOX, 3:] @ sim.spin_momentum[BOX]
        assert now == pytest.approx(energy, rel=3.0e-3)


def test_a_torque_of_the_joint_reacts_on_the_ball() -> None:
    """It takes the ball from rest to f t / I."""
    sim = carrying("ball")
    set_control(sim, joint_f=[0.0] * 6 + [0.0, 1.0e-5, 0.0])
    sim.step(STEPS)
    expected = -1.0e-5 * STEPS * sim.dt / BALL_MOMENT
    np.testing.assert_allclose(sim.velocity[BALL, 3:], [0.0, expected, 0.0], atol=1.0e-4)


@pytest.mark.usefixtures("shared_kernels")
@pytest.mark.parametrize(
    "axis", [{"friction": 1.0e-5}, {"target_kd": 1.0, "target_qd": 30.0, "effort_limit": 1.0e-5}]
)
def test_what_acts_along_a_hinge_reacts_on_the_ball(axis: dict[str, float]) -> None:
    """Friction that slips and a drive at its limit slow it by f t / I."""
    sim = carrying("revolute", box_mass=10.0, **axis)
    assert sim.solver.effects.flags.light_roots
    sim.set_velocity(BALL, angular=(10.0, 0.0, 0.0))
    sim.step(STEPS)
    expected = 10.0 - 1.0e-5 * STEPS * sim.dt / BALL_MOMENT
    np.testing.assert_allclose(sim.velocity[BALL, 3:], [expected, 0.0, 0.0], atol=1.0e-3)


@pytest.mark.usefixtures("shared_kernels")
@pytest.mark.parametrize(("scheme", "rounding"), [("euler", 1e-4), ("generalized_alpha", 3e-4)])
def test_about_its_axis_a_hinge_does_not_turn_the_ball(scheme: str, rounding: float) -> None:
    """The ball's rates, which steps of second order go on by, round like its velocity."""
    sim = carrying("revolute", scheme=scheme)
    sim.set_velocity(BALL, angular=(10.0, 0.0, 0.0))
    sim.step(STEPS)
    np.testing.assert_allclose(sim.velocity[:, 3:], [[10.0, 0, 0], [0, 0, 0]], atol=rounding)


@pytest.mark.usefixtures("shared_kernels")
def test_along_its_axis_a_slide_does_not_push_the_ball() -> None:
    sim = carrying("prismatic")
    sim.set_velocity(BALL, (1.0, 0.0, 0.0))
    sim.step(STEPS)
    np.testing.assert_allclose(sim.velocity[:, :3], [[1.0, 0, 0], [0, 0, 0]], atol=1.0e-5)


def test_only_light_roots_are_looked_after() -> None:
    """A ball of a thousandth of the box is none: what it carries rounds to less than it has."""
    assert carrying("ball").solver.effects.flags.light_roots
    assert not carrying("ball", box_mass=0.5).solver.effects.flags.light_roots
