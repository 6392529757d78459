# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Equations between the bodies of a tree, eliminated with it from the leaves to the root.

Rows J delta = -r with multipliers mu make the tree's quadratic model a saddle,

    sum_c delta_c . (H_c delta_c / 2 - b_c) + mu . (J delta + r)  ->  min over delta, max over mu.

A row starts as a wrench w on each of the bodies that it names and goes up the tree with the
elimination. Of an axis that is eliminated, with the pivot D, the force f that it meets in the block
and its push p, the row meets y = w . s, and leaves

    w - f y / D,    (J delta + r) + y p / D,    G + y y^T / D,

where G says how far the multipliers move the rows. Where both ways of a row join, at the nearest
body that carries all it acts on, the row has met all that it ever will of G, since a motion of that
body with all that it carries changes nothing about it. There the row is eliminated as the axes are,
with the pivot G_rr: it stiffens the body's block by w w^T / G_rr, and takes its share out of the
rows that go on. What rows meet of each other stays as local as the loops are: neighbours in a chain
of loops cost no more than a chain, and an n x n grid what a band of n costs (Featherstone, "Rigid
Body Dynamics Algorithms", chapter 8, closes all loops at the root; Brandl, Johanni, Otter 1986
close them on the way). Substitution goes back: multipliers of the rows that end at a body follow
its update, and push the axes of the bodies that they came by.

A row that the others imply already, as most are in a planar mechanism, or that nothing can move,
has no pivot and is left out. Where that is so only since stops or friction hold axes on its way,
and they hold them where the row cannot be closed, it is soft instead (:data:`CONTRADICTED`).

G and what is done with it is float64. As a sum of squares of what rows meet it is positive
semidefinite to 1e-16 then, and pivots may be as small as :data:`SOFTNESS` has them.
"""

import warp as wp

from ..algebra.block import half_solve
from ..data import BodyWork, ClosureNode, ClosureWork, TreeWork
from .tree import Block, handed_down

IMPLIED = wp.constant(1.0e-4)
"""Pivot from which a mimic says nothing new, as a share of what it had before elimination."""
CONTRADICTED = wp.constant(1.0e-6)
"""How far a row that stops leave nothing to say may be from closed [m or rad]: more than rounding
of limits makes it. Beyond that the stops do not go together: a sweep has reached two of which the
row lets its axes reach one. With a softness of :data:`IMPLIED` it then pushes so hard that the
other would have to pull, and lets go. Left out, it would stay open, at a minimum of all but itself.
"""
SOFTNESS = wp.constant(1.0e-7)
"""By how much more a multiplier moves its row, as a share of what the most mobile row of its joint
does: more than rounding leaves of a pivot after hundreds of others. A row along a taut chain has a
pivot of the square of its slope; what the softness misses of it the next step finds."""
FIRST_SOFTNESS = wp.constant(1.0e-5)
"""The same in the first sweep of a step, and in all sweeps of the recovery. The first sweep is off
by the square of what bodies turn by: rows that imply each other ask for what does not go together
then, and would push each other with it. So they do in the recovery, against contacts between them.
"""
MISSED = wp.constant(1.0e-4)
"""Share of its move that a sweep leaves to the next one at least, where rows are soft."""
FORGOTTEN = wp.constant(5.0e-2)
"""Share of what a row has pushed with that is taken back where nothing needs it: of what rows that
imply each other push each other with."""
SELF_STRESS = wp.constant(0.1)
"""Most that a row may push with if others imply it, as a share of what moves its bodies, were they
free, by their lever arms, or by a radian: beyond that its force says how they turn. A sweep asks
such rows for what does not go together, by the square of what bodies turn by, and their softness
lets them push a thousand times as hard. A row is softened for it by no more than the square of what
the guess, or the last sweep, has turned a body by, so that taut nets stay as stiff."""
HARDLY_MOVED = wp.constant(1.0e-9)
"""A row says nothing that moves less than this share of what the joint's others do, each taken
against how it would move were its bodies free."""
IMMOVABLE = wp.constant(1.0e-10)
"""Nor one that moves less than this share of how it would move were its bodies free."""


@wp.func
def meet_rows(node: ClosureNode, inverse: wp.spatial_vector, closures: wp.ref[ClosureWork]):
    """Adds what rows that go on have met at a body to their matrix; ``inverse`` of its pivots."""
    for p in range(node.start, node.stop):
        met = closures.met[p]
        at = closures.gram_row[closures.items[p] / 2]
        for q in range(p, node.stop):
            to = at + closures.items[q] / 2
            other = closures.met[q]
            total = wp.float64(0.0)
            for k in range(6):
                total += wp.float64(inverse[k]) * wp.float64(met[k]) * wp.float64(other[k])
            closures.gram[to] += total


@wp.func
def meet_root(body: int, work: wp.ref[BodyWork], tree: wp.ref[TreeWork]):
    """Takes rows through a body that no joint holds, the last one on their way."""
    closures = tree.closures
    node = closures.nodes[body]
    for p in range(node.start, node.stop):
        row = closures.items[p] / 2
        at = closures.slots[p]
        w = closures.way[at]
        half = half_solve(work.factor[body], wp.spatial_top(w), wp.spatial_bottom(w))
        closures.met[p] = half
        closures.multiplier[row] += wp.float64(wp.dot(half, tree.update[body]))
        closures.whole[row] += wp.dot(half, half)
        closures.way[at] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    meet_rows(node, wp.spatial_vector(wp.vec3(1.0), wp.vec3(1.0)), closures)


@wp.func
def meet_axes(body: int, axes: int, work: wp.ref[BodyWork], tree: wp.ref[TreeWork]):
    """Takes rows through the joint of a body, whose axes are eliminated, to its parent."""
    closures = tree.closures
    node = closures.nodes[body]
    if node.start == node.stop:
        return
    first = tree.axis_start[body]
    inverse = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    for k in range(axes):
        inverse[k] = tree.axes[first + k].inv_pivot
    is_carried = work.inv_mass[tree.parent[body]] > 0.0
    for p in range(node.start, node.stop):
        row = closures.items[p] / 2
        at = closures.slots[p]
        to = closures.next[p]
        w = closures.way[at]
        met = closures.met[p]
        whole = closures.whole[row]
        stopped = closures.stopped[row]
        moved = closures.multiplier[row] + wp.float64(wp.dot(w, tree.closing[body]))
        for k in range(axes):
            axis = tree.axes[first + k]
            force = met[k] + wp.dot(axis.linear, wp.spatial_top(w))
            force += wp.dot(axis.angular, wp.spatial_bottom(w))
            share = axis.inv_pivot * force
            w -= share * wp.spatial_vector(axis.force, axis.torque)
            moved += wp.float64(force * (axis.inv_pivot * axis.push + axis.step))
            whole += share * force
            if axis.pivot > 0.0:
                stopped += force * force / axis.pivot
            met[k] = force
        closures.met[p] = met
        closures.whole[row] = whole
        closures.stopped[row] = stopped
        closures.multiplier[row] = moved
        closures.way[at] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        handed = wp.where(is_carried, 1.0, 0.0) * handed_down(tree.span[body], w)
        closures.way[to] = closures.way[to] + handed
    meet_rows(node, inverse, closures)


@wp.func
def rows_push(body: int, closures: wp.ref[ClosureWork]) -> wp.spatial_vector:
    """What the multipliers of the rows that go on take from the push of each axis of a body."""
    node = closures.nodes[body]
    push = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    for p in range(node.start, node.stop):
        push += wp.float32(closures.multiplier[closures.items[p] / 2]) * closures.met[p]
    return push


@wp.func
def softness_of(has_dual: bool, recovery: float) -> float:
    """By how much more a multiplier moves its row: in the first sweep of a step, in others, and in
    the recovery, where rows that do not go together are to yield."""
    return wp.where(has_dual and recovery == 0.0, SOFTNESS, FIRST_SOFTNESS)


@wp.func
def ends_rows(top: int, closures: wp.ref[ClosureWork]) -> bool:
    """Whether a row ends at a node. At most nodes none does, and the block stays where it is."""
    node = closures.nodes[top]
    return node.first < node.end or node.row < node.row_end


@wp.func
def end_rows(top: int, block: Block, softness: float, closures: wp.ref[ClosureWork]) -> Block:
    """Eliminates the multipliers of the rows that end at a node; returns its block.

    A row that the ones before it imply gets a multiplier of zero.
    """
    node = closures.nodes[top]
    for c in range(node.first, node.end):
        closure = closures.closures[c]
        mobility = float(0.0)
        for row in range(closure.row, closure.row + closure.rows):
            if closures.least[row] > 0.0:
                mobility = wp.max(mobility, closures.whole[row] / closures.least[row])
        for row in range(closure.row, closure.row + closure.rows):
            least = IMPLIED * closures.whole[row]
            if closure.tendon >= 0:
                closures.stopped[row] = 0.0
            if closure.loop >= 0:
                free = closures.least[row]
                says = closures.whole[row] > wp.max(HARDLY_MOVED * mobility, IMMOVABLE) * free
                least = wp.where(says, 0.0, wp.inf)
                if closures.stopped[row] <= IMPLIED * free:
                    closures.stopped[row] = 0.0  # it is not the stops
                slack = closure.softness * softness * mobility * free
                kept = (1.0 - FORGOTTEN) * slack * closures.held[row]
                slack += closures.gives[row]
                closures.gram[closures.gram_row[row] + row] += wp.float64(slack)
                closures.multiplier[row] -= wp.float64(kept)
            closures.least[row] = least
            closures.way[2 * row] += closures.way[2 * row + 1]
    for row in range(node.row, node.row_end):
        g_row = closures.gram_row[row]
        pivot = closures.gram[g_row + row]
        w = closures.way[2 * row]
        if pivot <= wp.float64(closures.least[row]):
            is_soft = closures.stopped[row] > 0.0
            if not is_soft or wp.abs(closures.multiplier[row]) <= wp.float64(CONTRADICTED):
                closures.gram[g_row + row] = wp.float64(0.0)
                continue
            pivot = wp.float64(IMPLIED * (closures.whole[row] + closures.stopped[row]))
        moved = closures.multiplier[row]
        most = wp.float64(closures.most[row])
        if most > wp.float64(0.0) and wp.abs(moved) > most * pivot:
            if pivot <= wp.float64(IMPLIED * closures.whole[row]):
                extra = wp.min(wp.abs(moved) / most - pivot, wp.float64(closures.loosened[row]))
                moved -= extra * wp.float64((1.0 - FORGOTTEN) * closures.held[row])
                closures.multiplier[row] = moved
                pivot += extra
        inverse = wp.float64(1.0) / pivot
        closures.gram[g_row + row] = inverse
        w_l = wp.spatial_top(w)
        w_a = wp.spatial_bottom(w)
        stiffness = wp.float32(inverse)
        block.ll += stiffness * wp.outer(w_l, w_l)
        block.al += stiffness * wp.outer(w_a, w_l)
        block.aa += stiffness * wp.outer(w_a, w_a)
        block.push -= wp.float32(inverse * moved) * w
        for other in range(row + 1, node.row_end):
            share = inverse * closures.gram[g_row + other]
            if share != wp.float64(0.0):
                closures.way[2 * other] -= wp.float32(share) * w
                closures.multiplier[other] -= share * moved
                g_other = closures.gram_row[other]
                for to in range(other, node.row_end):
                    closures.gram[g_other + to] -= share * closures.gram[g_row + to]
                for q in range(node.start, node.stop):
                    to = closures.items[q] / 2
                    closures.gram[g_other + to] -= share * closures.gram[g_row + to]
        for p in range(node.start, node.stop):
            item = closures.items[p]
            share = inverse * closures.gram[g_row + item / 2]
            if share != wp.float64(0.0):
                at = closures.slots[p]
                closures.way[at] = closures.way[at] - wp.float32(share) * w
                closures.multiplier[item / 2] -= share * moved
                g_other = closures.gram_row[item / 2]
                for q in range(p, node.stop):
                    to = closures.items[q] / 2
                    closures.gram[g_other + to] -= share * closures.gram[g_row + to]
    return block


@wp.func
def find_multipliers(at: int, update: wp.spatial_vector, closures: wp.ref[ClosureWork]):
    """Multipliers of the rows that end at a node, whose body has moved by its update."""
    node = closures.nodes[at]
    for i in range(node.row_end - node.row):
        row = node.row_end - 1 - i
        g_row = closures.gram_row[row]
        inverse = closures.gram[g_row + row]
        if inverse == wp.float64(0.0):
            closures.multiplier[row] = wp.float64(0.0)
            continue
        left = closures.multiplier[row] + wp.float64(wp.dot(closures.way[2 * row], update))
        for other in range(row + 1, node.row_end):
            left -= closures.gram[g_row + other] * closures.multiplier[other]
        for p in range(node.start, node.stop):
            other = closures.items[p] / 2
            left -= closures.gram[g_row + other] * closures.multiplier[other]
        closures.multiplier[row] = inverse * left


@wp.func
def solve_ground(first: int, softness: float, closures: wp.ref[ClosureWork]):
    """Multipliers of the rows of a block that end at no body, after elimination."""
    number = closures.block_of[first]
    if number >= 0:
        ground = closures.blocks[number].ground
        end_rows(ground, Block(), softness, closures)
        find_multipliers(ground, wp.spatial_vector(), closures)
