# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The seed document's formulation, penalties that grow, in whole scenes."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, add_box, add_ground
from newton.solvers import SolverBase, SolverVBD

from newton_avbd import SolverAVBD

pytestmark = pytest.mark.long

DT = 1.0 / 240.0


def box_on_floor(ke: float, kd: float) -> newton.Model:
    builder = newton.ModelBuilder()
    add_ground(builder, ke=ke, kd=kd)
    add_box(builder, (0.0, 0.0, 0.25), ke=ke, kd=kd)
    builder.color()
    return builder.finalize(device="cpu")


def heights(solver: SolverBase, model: newton.Model, steps: int, matching: str) -> np.ndarray:
    """Height of the box over the floor after each step [m]; negative is penetration."""
    pipeline = newton.CollisionPipeline(model, contact_matching=matching)
    contacts = pipeline.contacts()
    states = model.state(), model.state()
    result = []
    for _ in range(steps):
        pipeline.collide(states[0], contacts)
        solver.step(states[0], states[1], None, contacts, DT)
        states = states[::-1]
        result.append(float(states[0].body_q.numpy()[0, 2]) - 0.25)
    return np.array(result)


@pytest.mark.parametrize("ke", [3.0e3, 1.0e4])
def test_a_box_comes_to_rest_at_the_sag_of_the_full_penalty(ke: float) -> None:
    """On a floor so soft that the penalty ends at the material's: m g/(4 ke), within 2 %."""
    model = box_on_floor(ke, 1.0e3)
    z = heights(SolverAVBD(model, formulation="ramp"), model, 960, "disabled")
    sag = float(model.body_mass.numpy()[0]) * G / (4.0 * ke)
    assert -z[-1] == pytest.approx(sag, rel=0.02)
    assert np.ptp(z[-10:]) < 1.0e-3 * sag


@pytest.mark.parametrize("ke", [1.0e5, 1.0e6])
def test_a_damped_box_comes_to_rest_on_a_stiff_floor(ke: float) -> None:
    """With damping near critical it stands still after 8 s and never jumps up.

    It needs that damping: a penalty that grows while it is compressed gives back more energy than
    it took, which is the rule's own. Backward Euler alone does not take as much away.
    """
    kd = 4.0e3
    model = box_on_floor(ke, kd)
    z = heights(SolverAVBD(model, formulation="ramp"), model, 1920, "disabled")
    assert z.max() < 1.0e-3
    assert np.ptp(z[-10:]) < 1.0e-5


@pytest.mark.parametrize("ke", [1.0e5, 1.0e6])
def test_a_box_sinks_as_with_solver_vbd(ke: float) -> None:
    """The same ramp as SolverVBD's: same path for 2 s, within 20 um of up to 8.5 mm.

    Both see the same contact matching. SolverVBD takes velocities from positions in float32, so
    that each step's differs by 3e-8 m / dt = 7e-6 m/s; over the second that the box takes to
    settle, that is 1e-5 m.
    """
    paths = []
    for make in (
        lambda model: SolverAVBD(model, formulation="ramp"),
        lambda model: SolverVBD(
            model,
            iterations=10,
            rigid_compliant_alm=False,
            rigid_contact_hard=False,
            rigid_contact_history=True,
            rigid_avbd_beta=1.0e5,
            rigid_avbd_gamma=0.99,
            rigid_contact_k_start=1.0e2,
        ),
    ):
        model = box_on_floor(ke, 1.0e3)
        paths.append(heights(make(model), model, 480, "latest"))
    assert paths[1].min() < -8.0e-3
    assert np.abs(paths[0] - paths[1]).max() < 2.0e-5


def test_the_ramp_holds_a_box_on_a_slope() -> None:
    """Well below the friction angle it creeps, as its friction is regularised, but slower than
    the speed up to which that is: 1 cm/s."""
    slope = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), 0.2)
    builder = newton.ModelBuilder()
    cfg = newton.ModelBuilder.ShapeConfig(mu=0.5, ke=1.0e4, kd=1.0e3)
    builder.add_shape_plane(xform=wp.transform(wp.vec3(), slope), width=0.0, length=0.0, cfg=cfg)
    position = (0.25 * np.sin(0.2), 0.0, 0.25 * np.cos(0.2))
    add_box(builder, position, rotation=slope, ke=1.0e4, kd=1.0e3)
    model = builder.finalize(device="cpu")
    solver = SolverAVBD(model, formulation="ramp")
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, other = model.state(), model.state()
    for _ in range(480):
        pipeline.collide(state, contacts)
        solver.step(state, other, None, contacts, DT)
        state, other = other, state
    speed = np.linalg.norm(state.body_qd.numpy()[0, :3])
    assert 0.0 < speed < 1.0e-2
