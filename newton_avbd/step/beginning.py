# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How a step starts its bodies: blocks summed and factored, and where contacts let them go."""

import warp as wp

from ..algebra.block import factor_block
from ..data import NO_JOINT, BodyWork, ContactRow, Solver, Step, TreeWork
from ..effects import Effects
from ..rows import contact as contact_rows
from .bodies import body_at, has_rows
from .islands import begin_island
from .loops import has_loops, has_outer_loops
from .needles import stiffened_axis
from .piles import in_pile


@wp.func
def is_tree(first: int, end: int, body: int, tree: wp.ref[TreeWork]) -> bool:
    """Whether a body belongs to a block with joints, which holds it from ``first`` to ``end``."""
    return end > first + 1 or tree.joint[body] != NO_JOINT


@wp.func
def is_in_tree(rank: int, s: wp.ref[Solver]) -> bool:
    """As :func:`is_tree`, for any place in visiting order."""
    first = int(rank)
    if rank > 0:
        first = wp.where(s.worlds.block_end[rank - 1] == s.worlds.block_end[rank], rank - 1, rank)
    return is_tree(first, s.worlds.block_end[rank], body_at(rank, s.worlds), s.tree)


def make_is_reached(effects: Effects) -> wp.Function:
    """Device function: whether more than the joints of its tree may hold a body."""

    @wp.func
    def is_reached(body: int, s: wp.ref[Solver]) -> bool:
        """Whether a contact may reach a body, or a joint acts on it that is not solved with its
        tree."""
        result = bool(False)
        if wp.static(effects.contact):
            result = has_rows(s.rows, body)
        if wp.static(effects.loops):
            result = result or has_outer_loops(body, s.loops)
        return result

    return is_reached


def make_coasting(effects: Effects) -> wp.Function:
    """Device function: where a body goes that nothing accelerates."""

    @wp.func
    def coasting_increment(
        work: wp.ref[BodyWork], body_qd: wp.array[wp.spatial_vector], slot: int, h: float
    ) -> wp.spatial_vector:
        """Pose increment of a body that keeps its velocity."""
        if wp.static(effects.second_order):
            return work.coasting[slot]
        if work.inv_mass[slot] == 0.0:
            return work.increment[slot]
        return h * body_qd[slot]

    return coasting_increment


@wp.func
def pushes_on(
    row: ContactRow, increment_a: wp.spatial_vector, increment_b: wp.spatial_vector, span: wp.vec3
) -> bool:
    """Whether a row pushes by these moves about as in the last step: with half of that or more, and
    with no more than twice what friction can where that held."""
    n = row.normal
    f_n = wp.dot(n, row.force)
    if f_n <= 0.0:
        return True
    u = contact_rows.slip(row, increment_a, increment_b, span)
    u_n = wp.dot(n, u)
    if row.k_n * (u_n + wp.max(row.gap, 0.0)) > 0.5 * f_n:
        return False
    if contact_rows.slid(row):
        return True
    held = row.force - f_n * n - row.k_t * (u - u_n * n)
    return wp.length(held) <= 2.0 * row.mu * f_n


@wp.func
def rest_on_fixed(body: int, step: float, has_pairs: bool, s: wp.ref[Solver]):
    """Guesses that what fixed bodies push a body with stays as it was, where no others touch it.

    Without friction a guess slides, and friction that is at its cone there says little of how far
    to go back. Nor does a contact that a guess has opened, or has made slide: where it would, there
    is no such guess.
    """
    if has_pairs and s.rows.other_start[body] < s.rows.other_end[body]:
        return  # bodies that move own these rows
    force = wp.vec3(0.0)
    torque = wp.vec3(0.0)
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        row = s.rows.rows[i]
        if s.work.inv_mass[row.b] > 0.0:
            return
        force -= row.force
        torque -= wp.cross(row.arm, row.force)
    if wp.length_sq(force) == 0.0:
        return
    moved = wp.spatial_vector(s.work.inv_mass[body] * force, s.work.inv_inertia[body] * torque)
    guess = s.work.target[body] + (step * step) * moved
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        row = s.rows.rows[i]
        if not pushes_on(row, guess, s.work.increment[row.b], s.work.com[body] - s.work.com[row.b]):
            return
    s.work.increment[body] = guess


def make_begin_body(effects: Effects, assemble_body: wp.Function) -> wp.Function:
    """Device function that starts a body; ``assemble_body`` sums its block."""
    # the force of a contact that gives way, or has bounced, is not that of the next step
    may_rest = effects.contact and not (effects.compliance or effects.restitution)
    may_rest = may_rest and not effects.cables and not effects.angular_friction

    @wp.func
    def begin_body(rank: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]) -> bool:
        """Sums the block of the body of this rank, or puts the body to its target.

        Returns whether sweeps are to move it.
        """
        body = body_at(rank, s.worlds)
        is_touched = bool(False)
        is_jointed = bool(False)
        if wp.static(effects.islands):
            begin_island(s.islands, body)
            # an island that touches fixed things is summed where the step does not settle only
            s.islands.sum[body].bodies = 0
        if wp.static(effects.contact):
            is_touched = has_rows(s.rows, body)
        if wp.static(effects.loops):
            is_touched = is_touched or has_loops(s.loops, body)
        if wp.static(effects.joints):
            s.tree.is_touched[body] = is_touched
            is_jointed = is_in_tree(rank, s)
        has_block = bool(is_touched)
        if wp.static(not effects.loops):
            has_block = is_touched and not is_jointed  # trees sum their contacts in each sweep
        if has_block and wp.static(not effects.ramp):
            h_ll, h_al, h_aa = assemble_body(body, h, step, s)
            if wp.static(effects.needles):
                if not is_jointed:
                    h_aa = stiffened_axis(body, h_aa, s)
            if is_jointed:
                if wp.static(effects.joints and effects.loops):
                    s.tree.own_ll[body] = h_ll
                    s.tree.own_al[body] = h_al
                    s.tree.own_aa[body] = h_aa
            else:
                is_alone = bool(True)
                if wp.static(effects.piles):
                    if in_pile(s.rows, body):
                        is_alone = False
                        s.rows.piles.ll[body] = h_ll
                        s.rows.piles.al[body] = h_al
                        s.rows.piles.aa[body] = h_aa
                if is_alone:
                    s.work.factor[body] = factor_block(h_ll, h_al, h_aa)
                if wp.static(may_rest):
                    if wp.static(not effects.loops) or not has_loops(s.loops, body):
                        rest_on_fixed(body, h, wp.static(effects.pairs), s)
        if not is_touched and not is_jointed:
            s.work.increment[body] = s.work.target[body]
            return False
        return True

    return begin_body
