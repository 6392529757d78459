# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the solver: an explicit argument, otherwise what the scene says, otherwise a default.

A scene says it on the PhysicsScene prim of a USD stage, or in a builder's custom attributes; both
end up in ``model.avbd``.
"""

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import newton
import numpy as np
import warp as wp

from .rows.contact import FRICTION_MIXES


@dataclass(frozen=True)
class SceneSetting:
    """How a scene authors a setting."""

    dtype: type
    """Type of the value, a scalar of Warp's or str."""
    usd_name: str
    """Name of the attribute on the PhysicsScene prim."""
    default: Any
    """Value of a scene that does not say."""
    name: str
    """Name in ``model.avbd``."""
    unsaid: bool = False
    """Whether the default is as if the scene said nothing, which then is None."""


SCENE_SETTINGS: dict[str, SceneSetting] = {
    "iterations": SceneSetting(
        wp.int32, "newton:maxSolverIterations", -1, name="max_solver_iterations"
    ),
    "tolerance": SceneSetting(wp.float32, "newton:avbd:tolerance", 0.0, name="tolerance"),
    "compliant_contacts": SceneSetting(
        wp.bool, "newton:avbd:compliantContacts", False, name="compliant_contacts"
    ),
    "friction_mix_mode": SceneSetting(
        str,
        "newton:avbd:frictionMixMode",
        "geometric_average",
        name="friction_mix_mode",
        unsaid=True,
    ),
    "angular_friction": SceneSetting(
        wp.bool, "newton:avbd:angularFriction", False, name="angular_friction", unsaid=True
    ),
    "formulation": SceneSetting(str, "newton:avbd:formulation", "augmented", name="formulation"),
    "scheme": SceneSetting(
        str, "newton:avbd:scheme", "generalized_alpha", name="scheme", unsaid=True
    ),
    "blocks": SceneSetting(str, "newton:avbd:blocks", "articulation", name="blocks"),
    "sleeping": SceneSetting(wp.bool, "newton:avbd:sleeping", False, name="sleeping"),
    "accuracy": SceneSetting(wp.float32, "newton:avbd:accuracy", 0.0, name="accuracy", unsaid=True),
    "inner_steps": SceneSetting(wp.int32, "newton:avbd:innerSteps", 100, name="inner_steps"),
}
"""What a scene may author, by argument of the solver's constructor.

Newton's own ``newton:maxSolverIterations`` of -1 leaves the number to the solver.
"""

ITERATIONS = 10
"""Sweeps where neither the user nor the scene asks for a number."""
MOST_ITERATIONS = 40
"""The same where an accuracy is asked for, which ends them earlier."""

_CHOICES = {
    "friction_mix_mode": tuple(FRICTION_MIXES),
    "formulation": ("augmented", "ramp"),
    "scheme": ("euler", "generalized_alpha", "runge_kutta"),
    "blocks": ("articulation", "body"),
}


def register_scene_settings(builder: newton.ModelBuilder) -> None:
    """Declares the settings that a scene may author, in the namespace ``avbd``."""
    for setting in SCENE_SETTINGS.values():
        builder.add_custom_attribute(
            newton.ModelBuilder.CustomAttribute(
                name=setting.name,
                namespace="avbd",
                dtype=setting.dtype,
                default=setting.default,
                frequency=newton.Model.AttributeFrequency.ONCE,
                assignment=newton.Model.AttributeAssignment.MODEL,
                usd_attribute_name=setting.usd_name,
                usd_value_transformer=_as_string if setting.dtype is str else None,
            )
        )


def _as_string(value: Any, context: dict[str, Any]) -> str:
    """A token of a stage; Newton's own conversion knows numbers only."""
    del context
    return str(value)


@dataclass(frozen=True)
class Settings:
    """Settings that make sense, of :class:`newton_avbd.SolverAVBD`.

    Its constructor explains the arguments of these names.
    """

    iterations: int
    """Most sweeps of a step, at least 1."""
    tolerance: float
    """Update at which a world's sweeps end [m], at least 0."""
    compliant_contacts: bool
    """Whether contacts and limits give way by the model's stiffness and damping."""
    friction_mix_mode: str | None
    """None for the geometric average, and MuJoCo's rule where a shape is MuJoCo's."""
    angular_friction: bool | None
    """None where MuJoCo's condim says."""
    formulation: str
    """``"augmented"`` or ``"ramp"``."""
    scheme: str
    """``"euler"``, ``"generalized_alpha"`` or ``"runge_kutta"``."""
    blocks: str
    """``"articulation"`` or ``"body"``."""
    sleeping: bool
    """Whether islands at rest are left out."""
    accuracy: float | None
    """Error that a second may add [m/s]; None for steps as long as ``dt``."""
    inner_steps: int
    """Most inner steps of a call with ``accuracy``, at least 1."""

    @property
    def ramp(self) -> bool:
        """Whether penalties grow, as in the seed document."""
        return self.formulation == "ramp"

    @property
    def second_order(self) -> bool:
        """Whether the scheme is of second order in time."""
        return self.scheme != "euler"

    @property
    def fourth_order(self) -> bool:
        """Whether it is of fourth order where nothing but joints holds bodies."""
        return self.scheme == "runge_kutta"

    @classmethod
    def resolve(cls, model: newton.Model, **arguments: Any) -> "Settings":
        """Settings from explicit arguments, None where not given, and the scene.

        Args:
            model: The model; ``model.avbd`` is what the scene says, where it says anything.
            **arguments: A value or None for each name of :data:`SCENE_SETTINGS`.

        Returns:
            The settings, each of them explicit.

        Raises:
            ValueError: If a setting makes no sense; names the argument, or the scene's attribute.
        """
        values = {
            name: _scene_value(model, name) if argument is None else argument
            for name, argument in arguments.items()
        }
        if arguments["iterations"] is None and values["iterations"] == -1:
            values["iterations"] = ITERATIONS if values["accuracy"] is None else MOST_ITERATIONS

        def check(name: str, makes_sense: bool, wanted: str) -> None:
            if makes_sense:
                return
            setting = SCENE_SETTINGS[name]
            source, remedy = name, ""
            if arguments[name] is None:
                source = f"the scene's {setting.usd_name} (model.avbd.{setting.name})"
                remedy = f" Change the scene, or pass {name}= to SolverAVBD."
            raise ValueError(f"{source} must be {wanted}, got {values[name]!r}.{remedy}")

        for name in ("iterations", "inner_steps"):
            check(name, isinstance(values[name], Integral), "a whole number")
            check(name, values[name] >= 1, "at least 1")
        for name in ("tolerance", "accuracy"):
            is_number = values[name] is None or isinstance(values[name], Real)
            check(name, is_number, "a number")
        tolerance = values["tolerance"]
        makes_sense = bool(tolerance >= 0.0 and np.isfinite(tolerance))
        check("tolerance", makes_sense, "a length of at least 0 m")
        accuracy = values["accuracy"]
        makes_sense = accuracy is None or bool(accuracy > 0.0 and np.isfinite(accuracy))
        check("accuracy", makes_sense, "an error a second above 0 m/s")
        for name, choices in _CHOICES.items():
            is_known = values[name] is None or values[name] in choices
            check(name, is_known, " or ".join(map(repr, choices)))
        if values["formulation"] == "ramp" and values["compliant_contacts"]:
            raise ValueError(
                "formulation='ramp' is limited by the shapes' stiffness already; leave "
                "compliant_contacts out."
            )
        if values["formulation"] == "ramp" and values["angular_friction"]:
            raise ValueError("formulation='ramp' has no angular_friction; leave it out.")
        if values["formulation"] == "ramp" and values["scheme"] not in (None, "euler"):
            raise ValueError(
                f"formulation='ramp' is backward Euler; leave scheme={values['scheme']!r} out."
            )
        if accuracy is not None and values["scheme"] == "euler":
            raise ValueError("accuracy is for schemes of higher order; leave scheme='euler' out.")
        if values["scheme"] is None:
            values["scheme"] = "generalized_alpha" if accuracy is None else "runge_kutta"
            if values["formulation"] == "ramp":
                values["scheme"] = "euler"
        return cls(**values)


def _scene_value(model: newton.Model, name: str) -> Any:
    """What the scene says, or the default."""
    setting = SCENE_SETTINGS[name]
    authored = getattr(getattr(model, "avbd", None), setting.name, None)
    value = setting.default
    if authored is not None:
        value = authored.numpy()[0].item() if isinstance(authored, wp.array) else authored[0]
    return None if setting.unsaid and value == setting.default else value
