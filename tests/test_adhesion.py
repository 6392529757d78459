# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's adhesion: a body is pulled towards what it touches, by the actuator's force in all."""

import newton
import numpy as np
import pytest
from helpers import G
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD

MASS, GAIN, MU = 2.0, 50.0, 0.5
SCENE = """<mujoco><option timestep="0.001"/><worldbody>
  <geom type="box" size="1 1 .1" pos="{ceiling}" friction=".5"/>
  <body name="b"><freejoint/><geom type="box" size=".1 .1 .1" mass="2" friction=".5"/></body>
  </worldbody>
  <actuator><general body="b" ctrlrange="0 10" gainprm="50"/></actuator></mujoco>""".format
CEILING, WALL = "0 0 0.2", "1.1 0 0"


class Stuck:
    """The box under a ceiling or beside a wall."""

    def __init__(self, ceiling: str, **settings: object) -> None:
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -G))
        SolverMuJoCo.register_custom_attributes(builder)
        builder.add_mjcf(SCENE(ceiling=ceiling), ctrl_direct=True)
        self.model = builder.finalize(device="cpu")
        self.solver = SolverAVBD(self.model, **settings)
        self.pipeline = newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()
        self.observables = self.solver.observables({"contact_f"}, contacts=self.contacts)
        self.state, self.control = self.model.state(), self.model.control()

    def step(self, ctrl: float, steps: int) -> np.ndarray:
        """Velocity of the box after some steps."""
        self.control.mujoco.ctrl.fill_(ctrl)
        for _ in range(steps):
            self.pipeline.collide(self.state, self.contacts)
            self.solver.step(
                self.state,
                self.state,
                self.control,
                self.contacts,
                0.001,
                observables=self.observables,
            )
        return self.state.body_qd.numpy()[0].astype(float)


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_box_hangs_from_the_ceiling_until_it_is_let_go(scheme: str) -> None:
    """The ceiling presses with what the force has beyond the weight."""
    scene = Stuck(CEILING, scheme=scheme)
    assert scene.solver.effects["adhesion"].on
    np.testing.assert_allclose(scene.step(0.5, 300), 0.0, atol=1.0e-4)
    count = int(scene.contacts.rigid_contact_count.numpy()[0])
    forces = scene.observables.contact_f.numpy()[:count, 2]
    assert abs(forces.sum()) == pytest.approx(0.5 * GAIN - MASS * G, rel=1.0e-3)
    assert scene.step(0.0, 100)[2] == pytest.approx(-G * 0.1, rel=1.0e-3)
    # out of touch, it pulls no more
    assert scene.step(1.0, 100)[2] == pytest.approx(-G * 0.2, rel=1.0e-3)


@pytest.mark.parametrize("ctrl", [0.7, 0.9])
def test_a_box_holds_on_a_wall_by_friction(ctrl: float) -> None:
    """mu F against m g: slides at 0.7, holds at 0.9."""
    scene = Stuck(WALL)
    excess = MU * GAIN * ctrl / MASS - G
    assert scene.step(ctrl, 200)[2] == pytest.approx(min(excess, 0.0) * 0.2, abs=2.0e-3)


def test_without_adhesion_it_falls() -> None:
    scene = Stuck(CEILING, effects={"adhesion": False})
    assert scene.step(0.5, 100)[2] == pytest.approx(-G * 0.1, rel=1.0e-3)
