# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""MuJoCo's flags, by which a file turns physics off, and what turns off the same here."""

from typing import Any

import newton
import numpy as np
import warp as wp

from .effects import CAUSES

FLAGS = {
    "actuation": ("actuators", "body_actuators"),
    "clampctrl": ("mujoco.actuator_ctrllimited",),
    "constraint": (
        *("contact", "limits", "joint_friction", "mujoco.tendon_limited"),
        *("mujoco.tendon_frictionloss", "mujoco.equality_constraint_enabled"),
    ),
    "contact": ("contact",),
    "damper": ("joint_damping", "mujoco.tendon_damping"),
    "equality": ("mujoco.equality_constraint_enabled",),
    "frictionloss": ("joint_friction", "mujoco.tendon_frictionloss"),
    "limit": ("limits", "mujoco.tendon_limited"),
    "spring": ("joint_stiffness", "mujoco.tendon_stiffness"),
}
"""Effects that are left out, and arrays of the model that are set to zero, by flag."""


def flags_off(model: newton.Model) -> list[str]:
    """Flags that the model's file turns off."""
    mujoco: Any = getattr(model, "mujoco", None)
    flags = {name: getattr(mujoco, f"flag_{name}", None) for name in FLAGS}
    return [name for name, flag in flags.items() if flag is not None and not flag.numpy()[0]]


def still_on(model: newton.Model, flag: str, without: frozenset[str]) -> list[str]:
    """What a flag would turn off and the model still has: effects and arrays, by name.

    Args:
        model: The model.
        flag: Key in :data:`FLAGS`.
        without: Effects that are left out.
    """
    return [
        name
        for name in FLAGS[flag]
        if (name not in without if name in CAUSES else _is_set(model, name))
        and (name != "contact" or model.shape_contact_pair_count)
    ]


def heed_flags(model: newton.Model) -> dict[str, bool]:
    """Turn off what the flags of the model's file do: its arrays are changed.

    Returns:
        The effects to make SolverAVBD with, none of them on.
    """
    names = dict.fromkeys(name for flag in flags_off(model) for name in FLAGS[flag])
    for name in names:
        if name not in CAUSES and _is_set(model, name):
            _array(model, name).zero_()
    if "contact" in names:
        model.shape_contact_pairs = wp.empty(0, dtype=wp.vec2i, device=model.device)
    return {name: False for name in names if name in CAUSES}


def _array(model: newton.Model, name: str) -> Any:
    space, _, inner = name.rpartition(".")
    return getattr(getattr(model, space, None) if space else model, inner, None)


def _is_set(model: newton.Model, name: str) -> bool:
    """Whether an array of the model holds anything but zeros."""
    array = _array(model, name)
    return array is not None and bool(np.any(array.numpy()))
