# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What SolverAVBD honours of what a scene authors, on scenes of ``newton-avbd properties``."""

import dataclasses
import json
import math
from datetime import UTC, datetime, timedelta
from pathlib import Path

import newton
import pytest

from newton_avbd.__main__ import main
from newton_avbd.study.properties.mujoco import ATTRIBUTES, pattern_of, registered
from newton_avbd.study.properties.property import Measure, Property, Trial, judge
from newton_avbd.study.properties.run import PROPERTIES

CHOICES = ("friction: mixing rule",)
"""Properties for which Newton has no rule of its own."""

HONOURED = (
    "restitution: rebound",
    "restitution: comes to rest",
    "restitution: cradle",
    "mu_torsional: sphere",
    "mu_torsional: disc",
    "mu_rolling: sphere",
    "mu_rolling: disc",
    "surface velocity: takes along",
    "surface velocity: carries",
    "friction: slides",
    "shape ke: static sag",
    "shape kd: underdamped",
    "shape kd: overdamped",
    "per-contact stiffness",
    "per-contact damping",
    "per-contact friction",
    "joint_friction: holds",
    "joint_friction: moves",
    "joint_friction: slows down",
    "joint_damping",
    "joint_stiffness, joint_rest_q",
    "joint_armature",
    "joint_effort_limit",
    "joint_effort_limit: no chatter",
    "joint_velocity_limit",
    "joint_target_mode: NONE",
    "joint_target_mode: POSITION",
    "joint_target_mode: VELOCITY",
    "joint_target_mode: POSITION_VELOCITY",
    "joint_target_mode: EFFORT",
    "joint limit: stops",
    "joint limit: holds",
    "joint limit: compliant",
    "mimic: PRISMATIC",
    "mimic: REVOLUTE",
    "mimic: D6",
    "mimic: both ways",
    "loop: MuJoCo CONNECT",
    "loop: MuJoCo WELD",
    "loop: parallelogram",
    "joint breaking: force",
    "joint breaking: torque",
    "FIXED",
    "REVOLUTE",
    "PRISMATIC",
    "BALL",
    "D6: free axes",
    "D6: locked axes",
    "DISTANCE",
    "ROD",
    "vbd:dahl_eps_max, dahl_tau",
    "joint_f: slider, reaction",
    "joint_f: hinge",
    "joint_f: ball",
    "kinematic body: carries",
    "body_f",
    "gravity of each world",
    "gyroscopic torque",
    "mujoco:density, wind",
    "mujoco:viscosity",
    "observable: body_qdd",
    "observable: body_parent_f",
    "observable: contact_f",
    "tendon: Atwood",
    "tendon: capstan slips",
    "tendon: capstan holds",
    "tendon: inextensible",
    "tendon: compliance, damping",
    "tendon: moving pulley",
    "tendon: goes taut",
    "tendon: pinhole with friction",
    "mujoco:condim 1",
    "mujoco:condim 3",
    "mujoco:condim 4",
    "mujoco:condim 6",
    "mujoco:geom_priority",
    "mujoco:pair_friction",
    "mujoco:equality_constraint_polycoef",
    "mujoco:equality_constraint: held",
    "mujoco:gravcomp",
)


@pytest.mark.parametrize("name", HONOURED)
def test_solver_honours(name: str) -> None:
    """The closed form is met within the property's own bound."""
    outcome = judge(PROPERTIES[name], "avbd")
    assert outcome.verdict == "yes", outcome


def test_friction_mixes_by_the_geometric_mean() -> None:
    """As in SolverVBD; Newton's solvers disagree."""
    assert judge(PROPERTIES["friction: mixing rule"], "avbd").verdict == "geometric mean"


def test_every_property_is_tried() -> None:
    """One that is added to the catalog is to be added here."""
    assert {*HONOURED, *CHOICES} == set(PROPERTIES)


def test_every_attribute_of_mujoco_has_a_row() -> None:
    """One that a new version of Newton declares is to be added; no row is for nothing."""
    patterns = {attribute: pattern_of(attribute) for attribute in registered()}
    assert [attribute for attribute, pattern in patterns.items() if pattern is None] == []
    assert set(patterns.values()) == set(ATTRIBUTES)


def falls(builder: newton.ModelBuilder, authored: bool) -> Measure:
    """A body that falls for a tenth of a second, through 5 cm, if gravity is authored."""
    builder.gravity = (0.0, 0.0, -10.0 if authored else 0.0)
    builder.add_body(mass=1.0, inertia=[[1, 0, 0], [0, 1, 0], [0, 0, 1]])

    def measure(trial: Trial) -> float:
        trial.run(0.1)
        return trial.center()[2]

    return measure


FALL = Property("fall", "A body falls.", falls, expected=-0.05, bound=0.003, unit="m")


def still(builder: newton.ModelBuilder, _: bool) -> Measure:
    return falls(builder, False)


def refused(builder: newton.ModelBuilder, _: bool) -> Measure:
    raise ValueError("No such thing. There is another.")


def endless(builder: newton.ModelBuilder, authored: bool) -> Measure:
    falls(builder, authored)
    return lambda trial: trial.moment(lambda: -1.0, 0.05)


def blown_up(builder: newton.ModelBuilder, authored: bool) -> Measure:
    falls(builder, authored)
    return lambda _: math.nan


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({}, "yes"),
        ({"expected": -0.1}, "-50 %"),
        ({"expected": 0.0}, "-0.05 m"),
        ({"build": still}, "ignored"),
        ({"build": endless}, "ignored"),
        ({"build": refused}, "error: No such thing"),
        ({"build": blown_up}, "not finite"),
        ({"rules": {"down": -0.05, "up": 0.05}}, "down"),
        ({"rules": {"up": 0.05}}, "-0.05"),
    ],
)
def test_judgement(change: dict[str, object], verdict: str) -> None:
    """What the tables say of a number."""
    assert judge(dataclasses.replace(FALL, **change), "avbd").verdict == verdict


def test_command_writes_a_page_and_adds_to_the_numbers(tmp_path: Path, capsys) -> None:
    """A second run keeps what the first has found."""
    numbers, page = tmp_path / "properties.json", tmp_path / "properties.md"
    options = ["--solvers", "avbd", "--json", str(numbers), "--output", str(page)]
    assert main(["properties", "body_f", *options]) == 0
    assert main(["properties", "observable: body_qdd", *options]) == 0
    found = json.loads(numbers.read_text())
    assert [entry["property"] for entry in found] == ["body_f", "observable: body_qdd"]
    assert found[0]["value"] == pytest.approx(0.25, rel=0.02)
    text, today = page.read_text(), datetime.now(UTC).date()
    assert "| body_f | **yes** |" in text
    assert found[0]["date"] in (str(today), str(today - timedelta(days=1)))  # at midnight
    assert f"Measured on {found[0]['date']} on {found[0]['processor']}." in text
    assert "default scheme, `generalized_alpha`" in text
    assert "body_qdd" in capsys.readouterr().out


def test_command_names_the_properties_that_there_are(capsys) -> None:
    assert main(["properties", "colour"]) == 2
    assert "there is no property 'colour'; there are: restitution" in capsys.readouterr().err
