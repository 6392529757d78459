# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a scene may author about its joints beside Newton's own properties, in ``model.avbd``."""

from typing import Any

import newton
import numpy as np
import warp as wp

BREAK_LIMITS = {
    "joint_break_force": "physics:breakForce",
    "joint_break_torque": "physics:breakTorque",
}
"""Force [N] and torque [N m] at which a joint breaks, and their names in UsdPhysics."""


def register_joint_attributes(builder: newton.ModelBuilder) -> None:
    """Declares at what a joint breaks; infinite, never, where a scene does not say."""
    for name, usd_name in BREAK_LIMITS.items():
        builder.add_custom_attribute(
            newton.ModelBuilder.CustomAttribute(
                name=name,
                namespace="avbd",
                dtype=wp.float32,
                frequency=newton.Model.AttributeFrequency.JOINT,
                default=float("inf"),
                usd_attribute_name=usd_name,
            )
        )


def break_limits(model: newton.Model) -> dict[str, wp.array]:
    """Arrays of the limits at which joints break, empty where none does.

    A graph may change them where one joint could break before; not make joints breakable.
    """
    authored = getattr(model, "avbd", None)
    limits = {name: getattr(authored, name, None) for name in BREAK_LIMITS}
    found = {name: limit for name, limit in limits.items() if limit is not None}
    if not any(np.any(~np.isposinf(limit.numpy())) for limit in found.values()):
        return {}
    return found


def authored_fluid(model: newton.Model) -> Any | None:
    """Arrays ``density``, ``viscosity`` and ``wind`` of the worlds' fluid, in ``model.mujoco``.

    None where the scene has not been declared to have them.
    """
    authored = getattr(model, "mujoco", None)
    return authored if getattr(authored, "density", None) is not None else None


def dahl_friction(model: newton.Model) -> dict[str, wp.array]:
    """Arrays of the Dahl friction of rods, in ``model.vbd``; empty where a scene has none."""
    authored = getattr(model, "vbd", None)
    found = {name: getattr(authored, name, None) for name in ("dahl_eps_max", "dahl_tau")}
    return {} if any(values is None for values in found.values()) else found
