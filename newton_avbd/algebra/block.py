# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The 6x6 block of one body, solved by a Schur complement of two packed 3x3 Cholesky factors.

    [ H_ll  H_al^T ] [ dx     ]   [ f   ]
    [ H_al  H_aa   ] [ dtheta ] = [ tau ]

A packed symmetric 3x3 matrix, or its Cholesky factor, is a ``vec6`` (xx, yx, yy, zx, zy, zz). A
factor keeps the *inverses* of its diagonal, so that solving divides nothing.
"""

import warp as wp

vec6 = wp.types.vector(length=6, dtype=wp.float32)

PIVOT_FLOOR = wp.constant(4.0e-7)
"""Least pivot of a Cholesky factor, as a share of the diagonal it came from."""


@wp.struct
class BlockFactor:
    """Factored block: ``ll`` = chol(H_ll), ``coupling`` = H_ll^-1 H_al^T, ``schur`` = chol(S)."""

    ll: vec6
    schur: vec6
    coupling: wp.mat33


@wp.func
def pivot_inverse(pivot: float, diagonal: float) -> float:
    """1/sqrt(pivot); a pivot that rounding has eaten is replaced, an empty row solves to zero."""
    if diagonal <= 0.0:
        return 0.0
    return 1.0 / wp.sqrt(wp.max(pivot, PIVOT_FLOOR * diagonal))


@wp.func
def cholesky(a: wp.mat33, diagonal: wp.vec3) -> vec6:
    """Packed Cholesky factor of the symmetric matrix ``a``.

    ``diagonal`` is the size that each pivot had before cancellation; a zero locks that row.
    """
    i0 = pivot_inverse(a[0, 0], diagonal[0])
    l10 = a[1, 0] * i0
    l20 = a[2, 0] * i0
    i1 = pivot_inverse(a[1, 1] - l10 * l10, diagonal[1])
    l21 = (a[2, 1] - l20 * l10) * i1
    i2 = pivot_inverse(a[2, 2] - l20 * l20 - l21 * l21, diagonal[2])
    return vec6(i0, l10, i1, l20, l21, i2)


@wp.func
def solve_lower(factor: vec6, b: wp.vec3) -> wp.vec3:
    """Solves L y = b."""
    y0 = b[0] * factor[0]
    y1 = (b[1] - factor[1] * y0) * factor[2]
    y2 = (b[2] - factor[3] * y0 - factor[4] * y1) * factor[5]
    return wp.vec3(y0, y1, y2)


@wp.func
def solve_upper(factor: vec6, y: wp.vec3) -> wp.vec3:
    """Solves L^T x = y."""
    x2 = y[2] * factor[5]
    x1 = (y[1] - factor[4] * x2) * factor[2]
    x0 = (y[0] - factor[1] * x1 - factor[3] * x2) * factor[0]
    return wp.vec3(x0, x1, x2)


@wp.func
def cholesky_solve(factor: vec6, b: wp.vec3) -> wp.vec3:
    """Solves L L^T x = b."""
    return solve_upper(factor, solve_lower(factor, b))


@wp.func
def factor_block(h_ll: wp.mat33, h_al: wp.mat33, h_aa: wp.mat33) -> BlockFactor:
    """Factors the block: L L^T = H_ll and S = H_aa - H_al H_ll^-1 H_al^T (seed document, Schur)."""
    out = BlockFactor()
    out.ll = cholesky(h_ll, wp.get_diag(h_ll))
    x0 = cholesky_solve(out.ll, h_al[0])
    x1 = cholesky_solve(out.ll, h_al[1])
    x2 = cholesky_solve(out.ll, h_al[2])
    out.coupling = wp.matrix_from_cols(x0, x1, x2)
    out.schur = cholesky(h_aa - h_al * out.coupling, wp.get_diag(h_aa))
    return out


@wp.func
def half_solve(factor: BlockFactor, force: wp.vec3, torque: wp.vec3) -> wp.spatial_vector:
    """y of M y = (f, tau), with the block H = M M^T; its dot products are those by H^-1."""
    reduced = torque - wp.transpose(factor.coupling) * force
    return wp.spatial_vector(solve_lower(factor.ll, force), solve_lower(factor.schur, reduced))


@wp.func
def other_half(factor: BlockFactor, half: wp.spatial_vector) -> wp.spatial_vector:
    """Pose increment (dx [m], dtheta [rad]) from what :func:`half_solve` gave: M^T x = y."""
    dtheta = solve_upper(factor.schur, wp.spatial_bottom(half))
    dx = solve_upper(factor.ll, wp.spatial_top(half)) - factor.coupling * dtheta
    return wp.spatial_vector(dx, dtheta)


@wp.func
def solve_block(factor: BlockFactor, force: wp.vec3, torque: wp.vec3) -> wp.spatial_vector:
    """Pose increment (dx [m], dtheta [rad]) that the factored block gives to a force and torque."""
    return other_half(factor, half_solve(factor, force, torque))
