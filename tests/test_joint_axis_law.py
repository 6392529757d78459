# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Everything at once along one axis: the step is the exact solution of backward Euler."""

import newton
import numpy as np
import pytest
from axis_law import KINDS, Law, Mode, axis_scene
from helpers import in_float32
from joint_scenes import coordinates

DRIVE = Law(target_ke=400.0, target_kd=15.0, target_q=0.4, target_qd=0.2)
LAWS = {
    "drive": DRIVE,
    "effort": Law(**{**vars(DRIVE), "effort_limit": 5.0}),
    "friction": Law(friction=3.0, force=1.0),
    "friction and drive": Law(**{**vars(DRIVE), "friction": 6.0}),
    "spring": Law(stiffness=150.0, rest_q=0.3, damping=2.0),
    "armature": Law(**{**vars(DRIVE), "armature": 1.5}),
    "velocity": Law(force=20.0, velocity_limit=0.8),
    "velocity and limits": Law(force=20.0, velocity_limit=0.8, limit_lower=-0.2, limit_upper=0.2),
    "all": Law(
        **{
            **vars(DRIVE),
            "effort_limit": 30.0,
            "stiffness": 40.0,
            "rest_q": -0.5,
            "damping": 1.0,
            "armature": 0.7,
            "friction": 4.0,
            "velocity_limit": 1.2,
            "limit_lower": -0.3,
            "limit_upper": 0.35,
        }
    ),
    "stiff": Law(target_ke=1.0e6, target_kd=1.0e3, target_q=0.4, effort_limit=50.0, friction=5.0),
}


@pytest.mark.usefixtures("shared_kernels")
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("kind", KINDS)
def test_an_axis_follows_its_law(kind: str, name: str) -> None:
    """Positions and velocities of 1 s, in which pieces of the law change: 1e-3 of the largest.

    What float32 coordinates leave of a speed is 1e-7/dt = 3e-5 rad/s.
    """
    law = LAWS[name]
    q, v = 0.1, -0.9
    sim, inertia = axis_scene(kind, law, q, v, scheme="euler")
    h = in_float32(sim.dt)
    fastest = 0.5
    for _ in range(240):
        q, v = law.advanced(inertia, q, v, h)
        sim.step()
        got_q, got_v = (x[0] for x in coordinates(sim))
        fastest = max(fastest, abs(v))
        assert got_q == pytest.approx(q, abs=1.0e-3 * max(abs(q), 0.1))
        assert got_v == pytest.approx(v, abs=1.0e-3 * fastest)
        # the reference goes on from where the simulation is: what is tested is the step
        q, v = float(got_q), float(got_v)


@pytest.mark.usefixtures("shared_kernels")
@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("kind", ["slider", "hinge"])
def test_modes_say_what_a_drive_follows(kind: str, mode: Mode) -> None:
    """POSITION damps to rest, VELOCITY has no stiffness, NONE and EFFORT leave all to ``joint_f``.

    Each step is backward Euler's.

    So do SolverMuJoCo's actuators and SolverKamino's joint dynamics.
    """
    law = Law(**{**vars(DRIVE), "actuator_mode": mode, "force": 0.5})
    expected = law.without_drive() if mode in (Mode.NONE, Mode.EFFORT) else law
    sim, inertia = axis_scene(kind, law, 0.1, -0.9, scheme="euler")
    h = in_float32(sim.dt)
    q, v = 0.1, -0.9
    for _ in range(60):
        q, v = expected.advanced(inertia, q, v, h)
        sim.step()
        assert coordinates(sim)[1][0] == pytest.approx(v, abs=2.0e-3)


def test_values_are_read_live() -> None:
    """Each of them acts from the step after it was changed on, also where there was none of it."""
    sim, inertia = axis_scene("hinge", Law(target_kd=1.0), 0.1, -0.9, scheme="euler")
    law = Law(
        target_kd=1.0,
        effort_limit=0.4,
        friction=0.2,
        damping=0.3,
        stiffness=5.0,
        rest_q=0.2,
        armature=0.1,
        velocity_limit=0.8,
    )
    h = in_float32(sim.dt)
    sim.step()
    for name in ("effort_limit", "friction", "damping", "stiffness", "rest_q", "armature"):
        getattr(sim.model, f"joint_{name}").fill_(getattr(law, name))
    sim.model.joint_velocity_limit.fill_(law.velocity_limit)
    sim.solver.notify_model_changed(newton.ModelFlags.JOINT_DOF_PROPERTIES)
    for _ in range(60):
        q, v = (float(x[0]) for x in coordinates(sim))
        q, v = law.advanced(inertia, q, v, h)
        sim.step()
        assert coordinates(sim)[1][0] == pytest.approx(v, abs=1.0e-4)


@pytest.mark.usefixtures("shared_kernels")
def test_a_limit_of_newtons_default_is_none() -> None:
    """A drive of 1e8 N is not held to 1e6 because another axis has a limit, nor by infinity."""
    for none in (1.0e6, np.inf):
        law = Law(target_ke=1.0e9, target_q=0.4, effort_limit=none, velocity_limit=none)
        sim, inertia = axis_scene("slider", law)
        sim.step()
        _, v = law.advanced(inertia, 0.0, 0.0, sim.dt) if np.isinf(none) else (0, 0.4 / sim.dt)
        assert coordinates(sim)[1][0] == pytest.approx(v, rel=1.0e-3)
