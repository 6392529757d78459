# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Settings that a scene authors: on a USD stage's PhysicsScene prim, or in custom attributes."""

from typing import Any

import newton
import numpy as np
import pytest
from contract import resting_box, worlds
from joint_scenes import add_hinge_chain

from newton_avbd import SolverAVBD

Usd = pytest.importorskip("pxr.Usd", reason="needs usd-core: pip install newton-avbd[scenes]")
from pxr import Sdf, UsdGeom, UsdPhysics  # noqa: E402

TYPES = {
    "newton:maxSolverIterations": Sdf.ValueTypeNames.Int,
    "newton:avbd:tolerance": Sdf.ValueTypeNames.Float,
    "newton:avbd:compliantContacts": Sdf.ValueTypeNames.Bool,
    "newton:avbd:frictionMixMode": Sdf.ValueTypeNames.Token,
    "newton:avbd:angularFriction": Sdf.ValueTypeNames.Bool,
    "newton:avbd:formulation": Sdf.ValueTypeNames.Token,
    "newton:avbd:blocks": Sdf.ValueTypeNames.Token,
}

AUTHORED = {
    "newton:maxSolverIterations": 7,
    "newton:avbd:tolerance": 1.0e-4,
    "newton:avbd:compliantContacts": True,
    "newton:avbd:frictionMixMode": "max",
    "newton:avbd:angularFriction": True,
    "newton:avbd:blocks": "body",
}


def model_of(path: Any, authored: dict[str, Any], registrations: int = 1) -> newton.Model:
    """A cube on a plane, written to a stage file with these settings, and read from it."""
    stage = Usd.Stage.CreateNew(str(path / "scene.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    scene = UsdPhysics.Scene.Define(stage, "/physicsScene").GetPrim()
    for name, value in authored.items():
        scene.CreateAttribute(name, TYPES[name]).Set(value)
    cube = UsdGeom.Cube.Define(stage, "/cube").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(cube)
    UsdPhysics.CollisionAPI.Apply(cube)
    stage.Save()
    builder = newton.ModelBuilder()
    for _ in range(registrations):
        SolverAVBD.register_custom_attributes(builder)
    builder.add_usd(str(path / "scene.usda"))
    return builder.finalize(device="cpu")


def test_a_stage_sets_the_solver(tmp_path: Any) -> None:
    """All settings, from a file that was written and read; registering twice is harmless."""
    solver = SolverAVBD(model_of(tmp_path, AUTHORED, registrations=2))
    assert solver.iterations == 7
    assert solver.tolerance == pytest.approx(1.0e-4)
    assert solver.effects.flags.compliance
    assert solver.effects.flags.friction_mix == "max"
    assert solver.effects.flags.angular_friction
    assert not solver.effects.flags.ramp


def test_the_ramp_can_be_authored(tmp_path: Any) -> None:
    """It excludes compliant contacts, and says so whoever asked for the two."""
    model = model_of(tmp_path, {"newton:avbd:formulation": "ramp"})
    assert SolverAVBD(model).effects.flags.ramp
    with pytest.raises(ValueError, match="leave compliant_contacts out"):
        SolverAVBD(model, compliant_contacts=True)


def test_an_argument_beats_the_scene(tmp_path: Any) -> None:
    """Also one that equals the solver's default."""
    model = model_of(tmp_path, AUTHORED)
    solver = SolverAVBD(model, iterations=10, tolerance=0.0, compliant_contacts=False)
    assert (solver.iterations, solver.tolerance) == (10, 0.0)
    assert not solver.effects.flags.compliance


@pytest.mark.parametrize("authored", [{}, {"newton:maxSolverIterations": -1}])
def test_a_stage_that_says_nothing_leaves_the_defaults(
    tmp_path: Any, authored: dict[str, Any]
) -> None:
    """-1 is Newton's word for it."""
    solver = SolverAVBD(model_of(tmp_path, authored))
    plain = SolverAVBD(resting_box().finalize(device="cpu"))
    assert (solver.iterations, solver.tolerance) == (plain.iterations, plain.tolerance) == (10, 0.0)
    assert not (solver.effects.flags.compliance or solver.effects.flags.ramp)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("newton:maxSolverIterations", 0, r"model.avbd.max_solver_iterations\) must be at least 1"),
        ("newton:maxSolverIterations", -2, r"must be at least 1, got -2"),
        ("newton:avbd:tolerance", -1.0, r"model.avbd.tolerance\) must be a length of at least 0 m"),
        ("newton:avbd:tolerance", np.nan, r"must be a length of at least 0 m, got nan"),
        ("newton:avbd:formulation", "classic", r"must be 'augmented' or 'ramp', got 'classic'"),
        ("newton:avbd:blocks", "island", r"must be 'articulation' or 'body', got 'island'"),
    ],
)
def test_a_value_that_makes_no_sense_is_named(
    tmp_path: Any, name: str, value: Any, message: str
) -> None:
    """The stage's attribute, what is wrong with it, and how an argument overrides it."""
    model = model_of(tmp_path, {name: value})
    with pytest.raises(ValueError, match=rf"the scene's {name} .*{message}.*pass \w+= to"):
        SolverAVBD(model)
    SolverAVBD(model, iterations=5, tolerance=0.0, formulation="augmented", blocks="body")


def test_settings_pass_through_the_builder_of_many_worlds() -> None:
    """A scene that is authored in Python and replicated; its links are blocks each."""
    builder = newton.ModelBuilder()
    SolverAVBD.register_custom_attributes(builder)
    builder.custom_attributes["avbd:max_solver_iterations"].values[0] = 3
    builder.custom_attributes["avbd:blocks"].values[0] = "body"
    add_hinge_chain(builder, 2)
    solver = SolverAVBD(worlds(builder, 2).finalize(device="cpu"))
    assert solver.iterations == 3
    assert solver.effects.flags.loops
