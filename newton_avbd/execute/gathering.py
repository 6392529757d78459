# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""All that acts on a body, summed: its wrench in each sweep, and its block once a step."""

import warp as wp

from ..data import (
    BodyModel,
    BodyWork,
    ContactRow,
    ControlInput,
    History,
    JointModel,
    LoopWork,
    RowWork,
    TreeWork,
    WorldWork,
)
from ..effects import Effects
from ..rows import contact as contact_rows
from ..rows import spin as spin_rows
from .drag import resistance
from .piles import in_pile, is_link
from .trees import parent_slot


@wp.func
def is_same_block(worlds: wp.ref[WorldWork], a: int, b: int) -> bool:
    """Whether two bodies move at once."""
    return worlds.block_end[worlds.rank[a]] == worlds.block_end[worlds.rank[b]]


def make_gather(
    effects: Effects,
    contact_force: wp.Function,
    gap_of: wp.Function,
    loop_wrench: wp.Function,
) -> wp.Function:
    """Device function that sums what pulls a body: to its inertial target, and at its contacts.

    With ``has_dual`` the rows that the body owns start with the dual update lambda <- F that ends
    the sweep before: nothing has moved at them since. ``recovery`` is the share of the penetration
    beyond ``slop`` that is to go.
    """

    @wp.func(inline=effects.inline)
    def gather(
        body: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> wp.spatial_vector:
        increment = work.increment[body]
        away = work.target[body] - increment
        inv_h2 = 1.0 / (h * h)
        f = (model.mass[body] * inv_h2) * wp.spatial_top(away)
        tau = inv_h2 * (work.inertia[body] * wp.spatial_bottom(away))
        if wp.static(effects.drag):
            slowed = resistance(work.drag[body], away / h)
            f += wp.spatial_top(slowed)
            tau += wp.spatial_bottom(slowed)
        if wp.static(effects.tilting):
            # what tilts a spin has to turn its momentum
            tau += wp.cross(wp.spatial_bottom(away), work.spin_momentum[body]) / h
        if wp.static(effects.contact):
            # rows of the same two bodies follow each other and share their relative motion
            partner = int(-1)
            span = wp.vec3(0.0)
            shift = wp.vec3(0.0)
            turn = wp.vec3(0.0)
            for i in range(rows.owned_start[body], rows.owned_end[body]):
                row = rows.rows[i]
                if row.b != partner:
                    partner = row.b
                    span = work.com[body] - work.com[partner]
                    shift, turn = contact_rows.relative_motion(
                        increment, work.increment[partner], span
                    )
                u = shift + wp.cross(turn, row.arm)
                if wp.static(effects.drift):
                    u += rows.drift[i]
                gap = gap_of(row.gap, recovery, slop)
                push = contact_force(row, u, gap)
                if has_dual:
                    if wp.static(effects.compliance):
                        push = contact_rows.keep_share(row, push, rows.share[i])
                    row.force = push
                    rows.rows[i].force = push
                    push = contact_force(row, u, gap)
                f -= push
                tau -= wp.cross(row.arm, push)
                if wp.static(effects.angular_friction):
                    spin = rows.spin[i]
                    rolled = turn
                    if wp.static(effects.second_order):
                        rolled -= wp.spatial_bottom(work.lead[partner] - work.lead[body])
                    if wp.static(effects.put_bodies):
                        rolled += wp.spatial_bottom(work.put[partner])
                    if has_dual:
                        held = wp.dot(row.normal, row.force)
                        spin.torque = spin_rows.torque(spin, row.normal, rolled, held)
                        rows.spin[i].torque = spin.torque
                    f_n = wp.dot(row.normal, push)
                    tau -= spin_rows.torque(spin, row.normal, rolled, f_n)
        if wp.static(effects.pairs):
            partner = int(-1)
            for i in range(rows.other_start[body], rows.other_end[body]):
                other = rows.other_rows[i]
                row = rows.rows[other]
                if row.a != partner:
                    partner = row.a
                    span = work.com[partner] - work.com[body]
                    shift, turn = contact_rows.relative_motion(
                        work.increment[partner], increment, span
                    )
                u = shift + wp.cross(turn, row.arm)
                if wp.static(effects.drift):
                    u += rows.drift[other]
                push = contact_force(row, u, gap_of(row.gap, recovery, slop))
                f += push
                tau += wp.cross(row.arm + span, push)
                if wp.static(effects.angular_friction):
                    f_n = wp.dot(row.normal, push)
                    rolled = turn
                    if wp.static(effects.second_order):
                        rolled -= wp.spatial_bottom(work.lead[body] - work.lead[partner])
                    tau += spin_rows.torque(rows.spin[other], row.normal, rolled, f_n)
        if wp.static(effects.loops):
            for k in range(loops.body_start[body], loops.body_start[body + 1]):
                item = loops.items[k]
                force, torque, arm_c, arm_p = loop_wrench(
                    item / 2,
                    recovery,
                    h,
                    model,
                    joints,
                    control,
                    work,
                    tree,
                    loops,
                    history,
                    False,
                    False,
                )
                if item % 2 == 0:
                    f += force
                    tau += torque + wp.cross(arm_c, force)
                else:
                    f -= force
                    tau -= torque + wp.cross(arm_p, force)
        wrench = wp.spatial_vector(f, tau)
        if wp.static(effects.cables):
            wrench += tree.cables.wrench[body]
        return wrench

    return gather


def make_assemble(effects: Effects, loop_curvature: wp.Function) -> wp.Function:
    """Device function: the block of a body, by its inertia and the curvature of its rows."""

    @wp.func
    def share_of(row: ContactRow, worlds: wp.ref[WorldWork], rows: wp.ref[RowWork]) -> float:
        """What the block of one of its bodies sees of a row's curvature.

        The link of a pile is solved for itself. Where both bodies move at once all the same, twice
        the curvature on each is an upper bound of what couples them: (u_b - u_a)^2 <= 2 u_a^2 +
        2 u_b^2.
        """
        if wp.static(effects.piles):
            if is_link(row, rows):
                return 0.0
            if in_pile(rows, row.a) and in_pile(rows, row.b):
                return 2.0
        if wp.static(effects.joints):
            if is_same_block(worlds, row.a, row.b):
                return 2.0
        return 1.0

    @wp.func(inline=effects.inline)
    def assemble_body(
        body: int,
        h: float,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ):
        """A body's block: its inertia and the curvature of its rows, the same all step long."""
        inv_h2 = 1.0 / (h * h)
        h_ll = wp.diag(wp.vec3(model.mass[body] * inv_h2))
        h_al = wp.mat33(0.0)
        h_aa = work.inertia[body] * inv_h2
        if wp.static(effects.drag):
            h_ll += work.drag[body].ll / h
            h_al += work.drag[body].al / h
            h_aa += work.drag[body].aa / h
        if wp.static(effects.contact):
            for i in range(rows.owned_start[body], rows.owned_end[body]):
                row = rows.rows[i]
                share = share_of(row, worlds, rows)
                if share == 0.0:
                    continue
                row.k_n *= share
                row.k_t *= share
                h_ll, h_al, h_aa = contact_rows.curvature(row, row.arm, h_ll, h_al, h_aa)
                if wp.static(effects.angular_friction):
                    h_aa += share * spin_rows.curvature(rows.spin[i], row.normal)
        if wp.static(effects.pairs):
            for i in range(rows.other_start[body], rows.other_end[body]):
                row = rows.rows[rows.other_rows[i]]
                share = share_of(row, worlds, rows)
                if share == 0.0:
                    continue
                arm = row.arm + (work.com[row.a] - work.com[body])
                row.k_n *= share
                row.k_t *= share
                h_ll, h_al, h_aa = contact_rows.curvature(row, arm, h_ll, h_al, h_aa)
                if wp.static(effects.angular_friction):
                    spin = rows.spin[rows.other_rows[i]]
                    h_aa += share * spin_rows.curvature(spin, row.normal)
        if wp.static(effects.loops):
            for k in range(loops.body_start[body], loops.body_start[body + 1]):
                item = loops.items[k]
                joint = loops.joints[item / 2]
                parent = parent_slot(joints, joint, work.inv_mass.shape[0] - 1)
                ll, al, aa = loop_curvature(
                    item,
                    is_same_block(worlds, joints.child[joint], parent),
                    h,
                    model,
                    joints,
                    control,
                    work,
                    tree,
                    loops,
                    history,
                )
                h_ll += ll
                h_al += al
                h_aa += aa
        return h_ll, h_al, h_aa

    return assemble_body
