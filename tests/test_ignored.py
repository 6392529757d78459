# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a model holds and no rigid solver moves: named by a warning, or with ``strict`` an error."""

import warnings
from collections.abc import Callable

import newton
import pytest
import warp as wp
from contract import resting_box
from helpers import add_mass
from newton.solvers.experimental.coupled import ModelView

from newton_avbd import SolverAVBD

ORIGIN = wp.vec3(0.0, 0.0, 0.0)

CELL = {
    "pos": ORIGIN,
    "rot": wp.quat_identity(),
    "vel": ORIGIN,
    "dim_x": 1,
    "dim_y": 1,
    "cell_x": 0.1,
    "cell_y": 0.1,
}


def add_cloth(builder: newton.ModelBuilder) -> None:
    """One cell: four particles, two triangles, five edges."""
    builder.add_cloth_grid(**CELL, mass=0.1, label="flag")


def add_jelly(builder: newton.ModelBuilder) -> None:
    """One cell: eight particles, five tets."""
    builder.add_soft_grid(
        **CELL, dim_z=1, cell_z=0.1, density=100.0, k_mu=1.0, k_lambda=1.0, k_damp=0.0
    )


def add_spring(builder: newton.ModelBuilder) -> None:
    """Two particles and what ties them."""
    for height in (2.0, 3.0):
        builder.add_particle(pos=(0.0, 0.0, height), vel=(0.0, 0.0, 0.0), mass=1.0)
    builder.add_spring(0, 1, ke=1.0, kd=0.0, control=0.0)


def add_attachment(builder: newton.ModelBuilder) -> None:
    """A particle on the cube."""
    builder.add_particle(pos=(0.0, 0.0, 2.0), vel=(0.0, 0.0, 0.0), mass=1.0)
    builder.body_label[0] = "cube"
    builder.add_attachment_particle_body(0, 0)


def add_muscle(builder: newton.ModelBuilder) -> None:
    """Along a link."""
    builder.body_label[0] = "arm"
    builder.add_muscle([0, 0], [ORIGIN, wp.vec3(0.0, 0.0, 1.0)], 1.0, 1.0, 1.0, 1.0, 0.0)


def add_adhesion(builder: newton.ModelBuilder) -> None:
    """A sticky ball."""
    body = add_mass(builder)
    builder.add_shape_sphere(body, cfg=builder.ShapeConfig(ka=0.01), label="gum")


ARM = """
<mujoco>
  <worldbody>
    <body>
      <joint name="hinge" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="hinge" gear="3"/>
    <position name="servo" joint="hinge" kp="10"/>
    <general name="spring" joint="hinge" {spring}/>
  </actuator>
</mujoco>
"""


def add_actuators(builder: newton.ModelBuilder) -> None:
    """Two motors, one of which acts by the user's code only."""
    builder.add_mjcf(ARM.format(spring='dyntype="user"'), ctrl_direct=True)


TWO_HINGES = """
<mujoco>
  <worldbody>
    <body>
      <joint name="one" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body name="wrist">
        <joint name="yaw" type="hinge" axis="0 0 1"/>
        <joint name="pitch" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="cord" stiffness="3"><joint joint="one" coef="1"/><joint joint="pitch" coef="2"/>
    </fixed>
  </tendon>
</mujoco>
"""


def add_tendon(builder: newton.ModelBuilder) -> None:
    """One over a hinge and over one of two hinges of a body."""
    builder.add_mjcf(TWO_HINGES)


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (add_tendon, r"joint '.*yaw.*' of MuJoCo tendon 0 \('cord'\): .*body of its own"),
        (
            add_cloth,
            r"4 particles, 2 triangles, \d bending edges, 1 surface \('flag'\)\..*Use SolverVBD",
        ),
        (add_jelly, r"8 particles, .*5 tets, 1 volume \('volume_0'\)\. Use SolverVBD"),
        (add_spring, r"2 particles, 1 spring\. Use SolverVBD"),
        (add_attachment, r"1 particle, 1 particle attachment \('body cube'\)"),
        (add_muscle, r"1 muscle \('from body arm'\)"),
        (add_actuators, r"MuJoCo actuator 2 \('spring'\): its dynamics.*SolverMuJoCo"),
        (add_adhesion, r"adhesion \(ka\) of 1 shape \('gum'\).*SolverSemiImplicit"),
    ],
)
def test_what_is_left_out_is_named(
    add: Callable[[newton.ModelBuilder], None], message: str
) -> None:
    """How many of what, the first labels, and what to do; the same text as an error."""
    builder = resting_box()
    add(builder)
    model = builder.finalize(device="cpu")
    with pytest.warns(UserWarning, match=message) as caught:
        SolverAVBD(model)
    assert len(caught) == 1 and caught[0].filename == __file__
    with pytest.raises(NotImplementedError, match=message):
        SolverAVBD(model, strict=True)


def test_a_rigid_scene_is_nothing_to_warn_of() -> None:
    """Not even with ``strict``."""
    model = resting_box().finalize(device="cpu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SolverAVBD(model, strict=True)


def test_actuators_that_act_are_not_mentioned() -> None:
    """A position actuator is its joint's drive, a motor acts by itself."""
    builder = newton.ModelBuilder()
    builder.add_mjcf(ARM.format(spring=""))
    model = builder.finalize(device="cpu")
    assert model.joint_target_ke.numpy()[0] == 10.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SolverAVBD(model, strict=True)


def test_particles_of_another_solver_are_not_mentioned() -> None:
    """The view that a coupled solver gives its rigid side: the others' particles are not active.

    A proxy particle stands for one that another solver moves, too.
    """
    builder = resting_box()
    add_cloth(builder)
    model = builder.finalize(device="cpu")
    view = ModelView(model, "rigid")
    view.disable_particles(wp.array([0, 1, 2], dtype=int, device="cpu"))
    view.mark_proxy_particles(wp.array([3], dtype=int, device="cpu"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SolverAVBD(view, strict=True)
    with pytest.warns(UserWarning, match="4 particles"):
        SolverAVBD(model)


def test_crossed_limits_are_named_but_not_those_of_distances() -> None:
    """A joint whose lower limit is above its upper one locks; a distance of -1 is no limit."""
    builder = resting_box()
    link = builder.add_link(mass=1.0, inertia=wp.diag(wp.vec3(0.1)))
    joint = builder.add_joint_revolute(-1, link, limit_lower=1.0, limit_upper=-1.0, label="hinge")
    builder.add_articulation([joint])
    far = builder.add_link(mass=1.0, inertia=wp.diag(wp.vec3(0.1)))
    far_joint = builder.add_joint_distance(-1, far, min_distance=1.0, max_distance=-1.0)
    builder.add_articulation([far_joint])
    message = r"lower limit of 1 joint \('hinge'\) is above the upper one.*newton.MAXVAL"
    with pytest.warns(UserWarning, match=message):
        SolverAVBD(builder.finalize(device="cpu"))
