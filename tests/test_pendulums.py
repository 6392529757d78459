# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The pendulum reference is right, and solvers are compared with it at the same time."""

import math

import newton
import numpy as np
import pytest
import warp as wp
from helpers import SWING_SECONDS, pendulum_errors

from newton_avbd import SolverAVBD
from newton_avbd.scenes.chains import add_chain
from newton_avbd.study.accuracy import pendulums

pytest.importorskip("scipy", reason="needs scipy: pip install newton-avbd[study]")


def _model(links: int, slope: float) -> newton.Model:
    builder = newton.ModelBuilder()
    add_chain(builder, links, length=1.0, slope=slope)
    return builder.finalize(device="cpu")


def test_reference_starts_where_the_links_are() -> None:
    model = _model(3, pendulums.SLOPE)
    found = pendulums.reference(model, 0.0)
    assert np.allclose(found, model.body_q.numpy()[:, :3], atol=1e-6)


def test_small_swing_has_the_period_of_a_compound_pendulum() -> None:
    """A box a from end to end and b thick: T = 2 pi sqrt((a^2/3 + b^2/12) / (g a/2)).

    The swing of 0.01 rad lengthens it by 6e-6, its center moves 0.005 m.
    """
    model = _model(1, 0.5 * math.pi - 0.01)
    period = 2.0 * math.pi * math.sqrt((1.0 / 3.0 + 0.25**2 / 12.0) / (9.81 * 0.5))
    start = pendulums.reference(model, 0.0)
    half = pendulums.reference(model, 0.5 * period)
    # After half a period it is at the other side, at rest: a late arrival hardly shows, and a
    # quarter earlier it passes the lowest point at full speed, where it does.
    assert half[0, 0] == pytest.approx(-start[0, 0], rel=1e-6)
    quarter = pendulums.reference(model, 0.25 * period)
    assert quarter[0, 0] == pytest.approx(0.0, abs=1e-5 * start[0, 0])


def test_reference_of_a_double_pendulum_agrees_with_runge_kutta() -> None:
    """MuJoCo's method of order 4 at 1/480 s; Newton's float32 between steps leaves 1e-6 m."""
    pytest.importorskip("mujoco")

    def make(model: newton.Model) -> newton.solvers.SolverBase:
        return newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True, integrator="rk4")

    assert pendulum_errors(make, 2, [1.0 / 480.0])[1.0 / 480.0] < 5e-6


@pytest.mark.parametrize("links", [2, 3])
def test_error_of_mujoco_falls_in_proportion_to_the_step(links: int) -> None:
    pytest.importorskip("mujoco")

    def make(model: newton.Model) -> newton.solvers.SolverBase:
        return newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True)

    coarse, fine = pendulum_errors(make, links, [1.0 / 120.0, 1.0 / 240.0]).values()
    assert 1e-4 < fine < 0.02
    assert coarse / fine == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("links", [2, 3])
def test_error_of_avbd_falls_in_proportion_to_the_step(links: int) -> None:
    """By backward Euler, ends after 2 s: halved within 10 %, for what is left goes by h^2."""
    errors = pendulum_errors(
        lambda m: SolverAVBD(m, scheme="euler"), links, [1.0 / 240.0, 1.0 / 480.0]
    )
    coarse, fine = errors.values()
    assert 1e-3 < fine < 0.02
    assert coarse / fine == pytest.approx(2.0, rel=0.1)


def test_standing_still_is_an_error_of_where_it_should_be() -> None:
    class Still(newton.solvers.SolverBase):
        def step(self, state_in, state_out, control, contacts, dt, **options) -> None:
            wp.copy(state_out.body_q, state_in.body_q)
            wp.copy(state_out.body_qd, state_in.body_qd)

    model = _model(2, pendulums.SLOPE)
    moved = pendulums.reference(model, SWING_SECONDS) - pendulums.reference(model, 0.0)
    errors = pendulum_errors(Still, 2, [0.5])
    assert errors[0.5] == pytest.approx(np.linalg.norm(moved, axis=1).max(), abs=1e-5)
