# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""All that acts on a body, summed: its wrench in each sweep, and its block once a step."""

from dataclasses import dataclass

import warp as wp

from ..blocks.tree import Block
from ..data import ContactRow, Solver, Step, WorldWork
from ..effects import Effects
from ..rows import contact as contact_rows
from ..rows import spin as spin_rows
from .anchors import parent_slot
from .beginning import is_in_tree
from .drag import resistance
from .piles import in_pile, is_in_group, is_link


@wp.func
def is_same_block(worlds: wp.ref[WorldWork], a: int, b: int) -> bool:
    """Whether two bodies move at once."""
    return worlds.block_end[worlds.rank[a]] == worlds.block_end[worlds.rank[b]]


@wp.func
def is_visited_first(worlds: wp.ref[WorldWork], a: int, b: int) -> bool:
    """Whether a sweep sums what pulls body ``a`` before it does so for ``b``.

    A tree is eliminated from its last body to its first. Without blocks ranks are those of visits.
    """
    is_before = worlds.rank[a] < worlds.rank[b]
    if worlds.block_end.shape[0] > 0:
        return is_before != is_same_block(worlds, a, b)
    return is_before


@wp.func
def is_followed(row: ContactRow, s: wp.ref[Solver]) -> bool:
    """Whether the blocks of trees follow a row as it opens and slides.

    Not where a free body has the whole curvature, or where both bodies move at once.
    """
    if is_same_block(s.worlds, row.a, row.b):
        return False
    if s.work.inv_mass[row.b] > 0.0 and not is_in_tree(s.worlds.rank[row.b], s):
        return False
    return is_in_tree(s.worlds.rank[row.a], s)


@dataclass(frozen=True)
class ContactLaw:
    """Device functions of what contacts of a scene push with, by their slip and gap."""

    force: wp.Function
    stiffness: wp.Function
    """How the force falls as the slip grows."""
    gap: wp.Function
    """Gap that a sweep closes."""


def make_contact_law(effects: Effects) -> ContactLaw:
    """The law of the contacts of a scene."""
    gap = contact_rows.whole_gap if effects.compliance else contact_rows.rigid_gap
    if effects.friction:
        return ContactLaw(contact_rows.force, contact_rows.stiffness, gap)
    return ContactLaw(contact_rows.normal_force, contact_rows.normal_stiffness, gap)


def make_block_stiffness(law: ContactLaw) -> wp.Function:
    """Device function: what a row adds to the block of a body of a tree, at its arm."""
    contact_stiffness = law.stiffness

    @wp.func
    def block_stiffness(row: ContactRow, u: wp.vec3, gap: float, s: wp.ref[Solver]) -> wp.mat33:
        """How the force on the body falls as the slip u [m] grows [N/m].

        Where both bodies move at once, twice the most on each is an upper bound of what couples
        them: (u_b - u_a)^2 <= 2 u_a^2 + 2 u_b^2.
        """
        if is_same_block(s.worlds, row.a, row.b):
            return 2.0 * contact_rows.whole_stiffness(row)
        return contact_stiffness(row, u, gap)

    return block_stiffness


def make_gather(
    effects: Effects, law: ContactLaw, loop_wrench: wp.Function, *, follows: bool = False
) -> wp.Function:
    """Device function that sums what pulls a body: to its inertial target, and at its contacts.

    With ``has_dual`` the rows that the body owns start with the dual update lambda <- F that ends
    the sweep before: nothing has moved at them since. ``recovery`` is the share of the penetration
    beyond ``slop`` that is to go.

    Where a block ``follows`` its rows it returns what they add to it, as they push there, with the
    wrench as its push.
    """
    contact_force, gap_of = law.force, law.gap
    block_stiffness = make_block_stiffness(law)

    @wp.func
    def still_to_close(
        i: int, row: ContactRow, u: wp.vec3, gap: float, has_dual: bool, s: wp.ref[Solver]
    ) -> float:
        """Gap that a sweep of the recovery closes at a row [m], with what those before have left.

        That is their dual update, as a shift of the gap: the multiplier stays that of the motion.
        """
        left = float(0.0)
        if has_dual and row.k_n > 0.0:
            push = contact_force(row, u, gap + s.rows.left[i])
            left = wp.dot(row.normal, row.force - push) / row.k_n
        s.rows.left[i] = left
        return gap + left

    @wp.func
    def follow(
        i: int,
        row: ContactRow,
        u: wp.vec3,
        gap: float,
        arm: wp.vec3,
        block: wp.ref[Block],
        s: wp.ref[Solver],
    ):
        """Adds to a body's block what a row at an arm of it does, as it pushes."""
        ll, al, aa = contact_rows.stiffened(
            block_stiffness(row, u, gap, s), arm, block.ll, block.al, block.aa
        )
        block.ll = ll
        block.al = al
        block.aa = aa
        if wp.static(effects.angular_friction):
            share = wp.where(is_same_block(s.worlds, row.a, row.b), 2.0, 1.0)
            block.aa += share * spin_rows.curvature(s.rows.spin[i], row.normal)

    @wp.func(inline=effects.inline)
    def gather(
        body: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        block = Block()
        increment = s.work.increment[body]
        away = s.work.target[body] - increment
        inv_h2 = 1.0 / (h * h)
        f = (s.model.mass[body] * inv_h2) * wp.spatial_top(away)
        tau = inv_h2 * (s.work.inertia[body] * wp.spatial_bottom(away))
        if wp.static(effects.drag):
            slowed = resistance(s.work.drag[body], away / h)
            f += wp.spatial_top(slowed)
            tau += wp.spatial_bottom(slowed)
        if wp.static(effects.tilting):
            # what tilts a spin has to turn its momentum
            tau += wp.cross(wp.spatial_bottom(away), s.work.spin_momentum[body]) / h
        if wp.static(effects.contact):
            # rows of the same two bodies follow each other and share their relative motion
            partner = int(-1)
            span = wp.vec3(0.0)
            shift = wp.vec3(0.0)
            turn = wp.vec3(0.0)
            for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
                row = s.rows.rows[i]
                if row.b != partner:
                    partner = row.b
                    span = s.work.com[body] - s.work.com[partner]
                    shift, turn = contact_rows.relative_motion(
                        increment, s.work.increment[partner], span
                    )
                u = shift + wp.cross(turn, row.arm)
                if wp.static(effects.drift):
                    u += s.rows.drift[i]
                gap = gap_of(row.gap, recovery, slop)
                if wp.static(effects.recovers_by_duals):
                    if recovery > 0.0:
                        gap = still_to_close(i, row, u, gap, has_dual, s)
                push = contact_force(row, u, gap)
                if has_dual and recovery == 0.0:
                    if wp.static(effects.compliance):
                        push = contact_rows.keep_share(row, push, s.rows.share[i])
                    row.force = push
                    s.rows.rows[i].force = push
                    push = contact_force(row, u, gap)
                f -= push
                tau -= wp.cross(row.arm, push)
                if wp.static(follows):
                    follow(i, row, u, gap, row.arm, block, s)
                if wp.static(effects.angular_friction):
                    spin = s.rows.spin[i]
                    rolled = turn
                    if wp.static(effects.second_order):
                        rolled -= wp.spatial_bottom(s.work.lead[partner] - s.work.lead[body])
                    if wp.static(effects.put_bodies):
                        rolled += wp.spatial_bottom(s.work.put[partner])
                    if has_dual and recovery == 0.0:
                        held = wp.dot(row.normal, row.force)
                        spin.torque = spin_rows.torque(spin, row.normal, rolled, held)
                        s.rows.spin[i].torque = spin.torque
                    f_n = wp.dot(row.normal, push)
                    tau -= spin_rows.torque(spin, row.normal, rolled, f_n)
        if wp.static(effects.pairs):
            partner = int(-1)
            for i in range(s.rows.other_start[body], s.rows.other_end[body]):
                other = s.rows.other_rows[i]
                row = s.rows.rows[other]
                if row.a != partner:
                    partner = row.a
                    span = s.work.com[partner] - s.work.com[body]
                    shift, turn = contact_rows.relative_motion(
                        s.work.increment[partner], increment, span
                    )
                u = shift + wp.cross(turn, row.arm)
                if wp.static(effects.drift):
                    u += s.rows.drift[other]
                gap = gap_of(row.gap, recovery, slop)
                if wp.static(effects.recovers_by_duals):
                    if recovery > 0.0:
                        gap += s.rows.left[other]
                push = contact_force(row, u, gap)
                f += push
                tau += wp.cross(row.arm + span, push)
                if wp.static(follows):
                    follow(other, row, u, gap, row.arm + span, block, s)
                if wp.static(effects.angular_friction):
                    f_n = wp.dot(row.normal, push)
                    rolled = turn
                    if wp.static(effects.second_order):
                        rolled -= wp.spatial_bottom(s.work.lead[body] - s.work.lead[partner])
                    tau += spin_rows.torque(s.rows.spin[other], row.normal, rolled, f_n)
        if wp.static(effects.loops):
            for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                item = s.loops.items[k]
                force, torque, arm_c, arm_p = loop_wrench(
                    item / 2, recovery, h, False, False, step, s
                )
                if item % 2 == 0:
                    f += force
                    tau += torque + wp.cross(arm_c, force)
                else:
                    f -= force
                    tau -= torque + wp.cross(arm_p, force)
        wrench = wp.spatial_vector(f, tau)
        if wp.static(effects.cables):
            wrench += s.tree.cables.wrench[body]
        if wp.static(follows):
            block.push = wrench
            return block
        else:
            return wrench

    return gather


def make_assemble(
    effects: Effects, loop_curvature: wp.Function, *, outer: bool = False
) -> wp.Function:
    """Device function: the block of a body, by its inertia and the curvature of its rows.

    In a tree without that of contacts, which :func:`make_gather` sums in each sweep. If ``outer``,
    without that of the rows that lead to another body of its group (:mod:`.step.groups`).
    """

    @wp.func
    def share_of(row: ContactRow, s: wp.ref[Solver]) -> float:
        """What the block of one of its bodies sees of a row's curvature.

        The link of a pile is solved for itself. Where both bodies move at once all the same, it is
        doubled as in :func:`make_block_stiffness`.
        """
        if wp.static(outer):
            return wp.where(is_in_group(row, s.rows), 0.0, 1.0)
        if wp.static(effects.piles):
            if is_link(row, s.rows):
                return 0.0
            if in_pile(s.rows, row.a) and in_pile(s.rows, row.b):
                return 2.0
        return 1.0

    @wp.func(inline=effects.inline)
    def assemble_body(body: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """A body's block: its inertia and the curvature of its rows, the same all step long."""
        is_jointed = bool(False)
        if wp.static(effects.joints and effects.loops):
            is_jointed = is_in_tree(s.worlds.rank[body], s)
        inv_h2 = 1.0 / (h * h)
        h_ll = wp.diag(wp.vec3(s.model.mass[body] * inv_h2))
        h_al = wp.mat33(0.0)
        h_aa = s.work.inertia[body] * inv_h2
        if wp.static(effects.drag):
            h_ll += s.work.drag[body].ll / h
            h_al += s.work.drag[body].al / h
            h_aa += s.work.drag[body].aa / h
        if wp.static(effects.contact):
            owned_end = wp.where(is_jointed, 0, s.rows.owned_end[body])
            for i in range(s.rows.owned_start[body], owned_end):
                row = s.rows.rows[i]
                share = share_of(row, s)
                if share == 0.0:
                    continue
                row.k_n *= share
                row.k_t *= share
                h_ll, h_al, h_aa = contact_rows.curvature(row, row.arm, h_ll, h_al, h_aa)
                if wp.static(effects.angular_friction):
                    h_aa += share * spin_rows.curvature(s.rows.spin[i], row.normal)
        if wp.static(effects.pairs):
            other_end = wp.where(is_jointed, 0, s.rows.other_end[body])
            for i in range(s.rows.other_start[body], other_end):
                row = s.rows.rows[s.rows.other_rows[i]]
                share = share_of(row, s)
                if share == 0.0:
                    continue
                arm = row.arm + (s.work.com[row.a] - s.work.com[body])
                row.k_n *= share
                row.k_t *= share
                h_ll, h_al, h_aa = contact_rows.curvature(row, arm, h_ll, h_al, h_aa)
                if wp.static(effects.angular_friction):
                    spin = s.rows.spin[s.rows.other_rows[i]]
                    h_aa += share * spin_rows.curvature(spin, row.normal)
        if wp.static(effects.loops):
            for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                item = s.loops.items[k]
                joint = s.loops.joints[item / 2]
                parent = parent_slot(s.joints, joint, s.work.inv_mass.shape[0] - 1)
                ll, al, aa = loop_curvature(
                    item, is_same_block(s.worlds, s.joints.child[joint], parent), h, step, s
                )
                h_ll += ll
                h_al += al
                h_aa += aa
        return h_ll, h_al, h_aa

    return assemble_body
