# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joint limits that an MJCF file authors: MuJoCo's reference and impedance, by degree of freedom.

What a limit pushes with is in :mod:`.rows.axis`.
"""

import newton
import numpy as np
import warp as wp

from .inertia import reference_mobility

_DEFAULT_REFERENCE = (0.02, 1.0)
"""MuJoCo's ``solreflimit`` where a file does not say one: time constant [s] and damping ratio."""
_RAW, _DEFAULT = 1, 2
"""Modes of ``mujoco:solreflimit_mode``: authored, and left to MuJoCo's default."""
_MOST = 0.9999
"""MuJoCo's ``mjMAXIMP``: impedance at most."""


def has_authored_limit(model: newton.Model) -> np.ndarray:
    """Degrees of freedom whose limit gives way by ``solreflimit`` and not by ``limit_ke``.

    As for SolverMuJoCo, those of an MJCF file do, until the user changes ``joint_limit_ke`` or
    ``joint_limit_kd`` of one that had no ``solreflimit``.
    """
    mujoco = getattr(model, "mujoco", None)
    mode = getattr(mujoco, "solreflimit_mode", None)
    if mode is None or model.joint_dof_count == 0:
        return np.zeros(model.joint_dof_count, dtype=bool)
    kinds = mode.numpy()
    is_default = kinds == _DEFAULT
    baseline = getattr(mujoco, "solreflimit_gain_baseline", None)
    if baseline is not None:
        gains = [getattr(model, f"joint_limit_{name}").numpy() for name in ("ke", "kd")]
        is_default &= np.all(np.stack(gains, axis=1) == baseline.numpy(), axis=1)
    return (kinds == _RAW) | is_default


def impedance_rates(reference: np.ndarray, impedance: np.ndarray) -> np.ndarray:
    """How limits return what has passed them.

    MuJoCo's formulas ("Solver parameters"): a limit that is passed by r returns by
    a = -b v - k d(r) r, with b = 2/(d_width T) and k = 1/(d_width T zeta)^2 of ``solref`` = (T,
    zeta); or ``solref`` = (-k', -b') with k = k'/d_width^2 and b = b'/d_width.

    Args:
        reference: ``solref`` of each limit, shape (limits, 2).
        impedance: ``solimp``, shape (limits, 5).

    Returns:
        k and b, shape (limits, 2).
    """
    width = np.clip(impedance[:, 1].astype(float), 1.0 - _MOST, _MOST)
    first, second = reference.T
    is_direct = (first <= 0.0) | (second <= 0.0)
    time, ratio = (np.where(is_direct, 1.0, values) for values in (first, second))
    k = np.where(is_direct, -first / width**2, 1.0 / (width * time * ratio) ** 2)
    b = np.where(is_direct, -second / width, 2.0 / (width * time))
    return np.stack((k, b), axis=1)


def limit_law(model: newton.Model, beside: np.ndarray | None = None) -> dict[str, wp.array]:
    """Arrays of :class:`.data.JointModel` for limits with an impedance, each of shape (dofs,).

    Args:
        model: The user's model.
        beside: See :func:`.inertia.reference_matrices`.
    """
    mujoco = model.mujoco
    is_authored = has_authored_limit(model)
    mobility = np.zeros(model.joint_dof_count)
    for dof, (inverse, _) in reference_mobility(model, beside).items():
        mobility[dof] = inverse
    reference = mujoco.solreflimit.numpy().astype(float)
    reference[mujoco.solreflimit_mode.numpy() != _RAW] = _DEFAULT_REFERENCE
    rates = impedance_rates(reference, mujoco.solimplimit.numpy())
    margin = getattr(mujoco, "limit_margin", None)
    if margin is None:
        margin = wp.zeros(model.joint_dof_count, dtype=float, device=model.device)
    return {
        "limit_mobility": wp.array(mobility * is_authored, dtype=float, device=model.device),
        "limit_rates": wp.array(rates, dtype=wp.vec2, device=model.device),
        "limit_impedance": mujoco.solimplimit,
        "limit_margin": margin,
    }


def limits_within_margins(model: newton.Model) -> dict[str, wp.array]:
    """Rigid limits where a file authors a margin (``mujoco:limit_margin``), else nothing.

    MuJoCo's limits push until the coordinate is a margin inside of them, so the stiffer they are
    the closer it comes to that. Margins that overlap meet in the middle of the range.

    Args:
        model: The user's model.

    Returns:
        Arrays of :class:`.data.JointModel`, each of shape (dofs,).
    """
    margin = getattr(getattr(model, "mujoco", None), "limit_margin", None)
    if margin is None or not np.any(margin.numpy() > 0.0):
        return {}
    lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
    inside = np.minimum(np.maximum(margin.numpy(), 0.0), 0.5 * np.maximum(upper - lower, 0.0))
    return {
        "limit_lower": wp.array(lower + inside, dtype=float, device=model.device),
        "limit_upper": wp.array(upper - inside, dtype=float, device=model.device),
    }
