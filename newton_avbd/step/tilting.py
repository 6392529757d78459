# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The antisymmetric part of blocks: how fast spins resist being tilted.

It stays in memory, out of the way of all that is not fast.
"""

import warp as wp

from ..blocks import tree as algebra
from ..blocks.tree import Block
from ..data import TreeAxis, TreeWork


@wp.func
def add_spin(body: int, momentum: wp.vec3, h: float, tree: wp.ref[TreeWork]):
    """Adds a body's own spin to its antisymmetric part."""
    tree.n_aa[body] = tree.n_aa[body] - wp.skew(momentum) / h


@wp.func(inline=False)
def push_tilting_root(body: int, block: Block, tree: wp.ref[TreeWork]) -> wp.spatial_vector:
    """As :func:`.blocks.tree.symmetric_push` [N, N m], of a body that no joint holds."""
    return algebra.symmetric_push(block, tree.n_ll[body], tree.n_al[body], tree.n_aa[body])


@wp.func
def times_tilting(
    body: int, motion: wp.spatial_vector, tree: wp.ref[TreeWork]
) -> wp.spatial_vector:
    """N delta of a body's antisymmetric part."""
    return algebra.times_skew(tree.n_ll[body], tree.n_al[body], tree.n_aa[body], motion)


@wp.func(inline=False)
def eliminate_tilting(body: int, axis: TreeAxis, block: Block, tree: wp.ref[TreeWork]):
    """Takes an axis out of a body's antisymmetric part N, and what that adds to the block.

    Returns the block and N s of the axis.
    """
    n_ll = tree.n_ll[body]
    n_al = tree.n_al[body]
    n_aa = tree.n_aa[body]
    direction = wp.spatial_vector(axis.linear, axis.angular)
    tilting = algebra.times_skew(n_ll, n_al, n_aa, direction)
    if not axis.pivot > 0.0:
        block, n_ll, n_al, n_aa = algebra.eliminated_skew(axis, tilting, block, n_ll, n_al, n_aa)
        tree.n_ll[body] = n_ll
        tree.n_al[body] = n_al
        tree.n_aa[body] = n_aa
    return block, tilting


@wp.func(inline=False)
def project_tilting(
    body: int, shifting: wp.mat33, turning: wp.mat33, arm: wp.vec3, tree: wp.ref[TreeWork]
):
    """Moves a body's antisymmetric part to an anchor, and keeps of it what the joint holds."""
    n_ll, n_al, n_aa = algebra.span_skew(-arm, tree.n_ll[body], tree.n_al[body], tree.n_aa[body])
    n_ll, n_al, n_aa = algebra.projected(shifting, turning, n_ll, n_al, n_aa)
    tree.n_ll[body] = n_ll
    tree.n_al[body] = n_al
    tree.n_aa[body] = n_aa


@wp.func(inline=False)
def hand_down_tilting(body: int, parent: int, span: wp.vec3, tree: wp.ref[TreeWork]):
    """Adds a body's antisymmetric part to that of its parent."""
    n_ll, n_al, n_aa = algebra.span_skew(span, tree.n_ll[body], tree.n_al[body], tree.n_aa[body])
    tree.n_ll[parent] = tree.n_ll[parent] + n_ll
    tree.n_al[parent] = tree.n_al[parent] + n_al
    tree.n_aa[parent] = tree.n_aa[parent] + n_aa


@wp.func
def forget_tilting(body: int, tree: wp.ref[TreeWork]):
    """Clears a body's antisymmetric part for the next sweep."""
    tree.n_ll[body] = wp.mat33(0.0)
    tree.n_al[body] = wp.mat33(0.0)
    tree.n_aa[body] = wp.mat33(0.0)
