# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Contact rows of the seed document: a penalty that grows with the violation, no multiplier.

Source: "Rigid Body Dynamics with VBD, Section I: Free Bodies", the document that this package
implements. It is here for comparison; :mod:`.contact` is what a scene should use. Damping is in
N s/m, as Newton 1.8 authors it (the document's damping coefficient kd * ke).
"""

import warp as wp

from ..data import ContactRow

GROWTH = wp.constant(1.0e5)
"""beta: growth of the penalty by violation, sweep by sweep [N/m^2]."""
RETENTION = wp.constant(0.99)
"""gamma: what a step keeps of the last step's penalty."""
START = wp.constant(1.0e2)
"""k_min: least penalty [N/m]."""
SLIP_SPEED = wp.constant(1.0e-2)
"""Speed below which friction is regularised [m/s], as in SolverVBD."""


@wp.func
def warm_penalty(penalty: float, stiffness: float) -> float:
    """k <- clamp(gamma k, k_min, k_max): the penalty that a step starts from [N/m]."""
    return wp.clamp(RETENTION * penalty, wp.min(START, stiffness), stiffness)


@wp.func
def grown_penalty(penalty: float, penetration: float, stiffness: float) -> float:
    """k <- min(k + beta |C|, k_max): the dual update of the ramp [N/m]."""
    return wp.min(penalty + GROWTH * penetration, stiffness)


@wp.func
def penetration(row: ContactRow, u: wp.vec3) -> float:
    """Penetration depth [m] at the slip u [m], zero when apart."""
    return wp.max(0.0, -(row.gap + wp.dot(row.normal, u)))


@wp.func
def force_and_stiffness(row: ContactRow, u: wp.vec3, damping: float, h: float):
    """Force on body b [N] and K = -dF/du [N/m] at the slip u [m]."""
    depth = penetration(row, u)
    if depth <= 0.0:
        return wp.vec3(0.0), wp.mat33(0.0)
    n = row.normal
    f_n = row.k_n * depth
    u_n = wp.dot(n, u)
    f = f_n * n
    k = row.k_n * wp.outer(n, n)
    if damping > 0.0 and u_n < 0.0:
        f -= (damping * u_n / h) * n
        k += (damping / h) * wp.outer(n, n)
    # Coulomb friction, smooth below SLIP_SPEED (Li et al., "Incremental Potential Contact", 2020)
    u_t = u - u_n * n
    length = wp.length(u_t)
    least = SLIP_SPEED * h
    secant = row.mu * f_n / wp.max(length, 1.0e-30)
    if length < least:
        secant = row.mu * f_n * (2.0 - length / least) / least
    f -= secant * u_t
    k += secant * (wp.identity(n=3, dtype=float) - wp.outer(n, n))
    return f, k


@wp.func
def add_stiffness(k: wp.mat33, arm: wp.vec3, h_ll: wp.mat33, h_al: wp.mat33, h_aa: wp.mat33):
    """Adds H_ll = K, H_al = -[r]^T K, H_aa = [r]^T K [r] to a body's block."""
    r = wp.skew(arm)
    rt_k = wp.transpose(r) * k
    return h_ll + k, h_al - rt_k, h_aa + rt_k * r
