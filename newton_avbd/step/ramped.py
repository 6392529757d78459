# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The seed document's sweep, ``formulation="ramp"``: penalties that grow, and no multipliers."""

import warp as wp

from ..algebra.block import factor_block, solve_block
from ..data import Solver
from ..effects import Effects
from ..functions import Functions, together
from ..rows import contact as contact_rows
from ..rows import ramp as ramp_rows
from .drag import resistance


def make_ramped(effects: Effects) -> Functions:
    """Device functions that sweep as the seed document does."""

    @wp.func
    def sweep_body_ramped(body: int, h: float, s: wp.ref[Solver]):
        """The seed document's body update: assemble at the current pose, factor, solve."""
        increment = s.work.increment[body]
        away = s.work.target[body] - increment
        inv_h2 = 1.0 / (h * h)
        f = (s.model.mass[body] * inv_h2) * wp.spatial_top(away)
        tau = inv_h2 * (s.work.inertia[body] * wp.spatial_bottom(away))
        h_ll = wp.diag(wp.vec3(s.model.mass[body] * inv_h2))
        h_al = wp.mat33(0.0)
        h_aa = s.work.inertia[body] * inv_h2
        if wp.static(effects.drag):
            slowed = resistance(s.work.drag[body], away / h)
            f += wp.spatial_top(slowed)
            tau += wp.spatial_bottom(slowed)
            h_ll += s.work.drag[body].ll / h
            h_al += s.work.drag[body].al / h
            h_aa += s.work.drag[body].aa / h
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            row = s.rows.rows[i]
            span = s.work.com[body] - s.work.com[row.b]
            u = contact_rows.slip(row, increment, s.work.increment[row.b], span)
            if wp.static(effects.drift):
                u += s.rows.drift[i]
            push, k = ramp_rows.force_and_stiffness(row, u, s.rows.damping[i], h)
            f -= push
            tau -= wp.cross(row.arm, push)
            h_ll, h_al, h_aa = ramp_rows.add_stiffness(k, row.arm, h_ll, h_al, h_aa)
        if wp.static(effects.pairs):
            for j in range(s.rows.other_start[body], s.rows.other_end[body]):
                i = s.rows.other_rows[j]
                row = s.rows.rows[i]
                span = s.work.com[row.a] - s.work.com[body]
                u = contact_rows.slip(row, s.work.increment[row.a], increment, span)
                if wp.static(effects.drift):
                    u += s.rows.drift[i]
                push, k = ramp_rows.force_and_stiffness(row, u, s.rows.damping[i], h)
                f += push
                tau += wp.cross(row.arm + span, push)
                h_ll, h_al, h_aa = ramp_rows.add_stiffness(k, row.arm + span, h_ll, h_al, h_aa)
        s.work.increment[body] = increment + solve_block(factor_block(h_ll, h_al, h_aa), f, tau)

    @wp.func
    def sweep_duals_ramped(body: int, s: wp.ref[Solver]):
        """The seed document's dual update: the penalties of the rows that a body owns grow."""
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            row = s.rows.rows[i]
            span = s.work.com[body] - s.work.com[row.b]
            u = contact_rows.slip(row, s.work.increment[body], s.work.increment[row.b], span)
            s.rows.rows[i].k_n = ramp_rows.grown_penalty(
                row.k_n, ramp_rows.penetration(row, u), s.rows.stiffness[i]
            )

    return together(sweep_body_ramped, sweep_duals_ramped)
