# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Ball joints that nothing drives, brakes or stops: all three turns are eliminated at once."""

import warp as wp

from ..algebra.block import PIVOT_FLOOR, cholesky, cholesky_solve
from ..blocks.tree import Block, seen_from
from ..data import TreeAxis, TreeWork


@wp.func
def free_ball(
    first_axis: int,
    arm_c: wp.vec3,
    torque: wp.vec3,
    own: float,
    block: Block,
    tree: wp.ref[TreeWork],
) -> Block:
    """Eliminates all three turns at once of a ball joint that nothing drives, brakes or stops.

    About its anchor such a joint hands down a force only. Its axes are those of the world; what
    each meets does not depend on the others, so that substitution may take them in any order.

    Args:
        first_axis: First of the joint's axes in ``tree.axes``.
        arm_c: From the COM of the body to the anchor [m].
        torque: What is put on the joint, which reacts on the parent [N m].
        own: Least moment of inertia of the body over h^2 [N m]; no turn meets less.
        block: That of the body about its COM.
        tree: The trees' work.

    Returns:
        The block that is left about the anchor, of which only the linear part is not zero.
    """
    block = seen_from(-arm_c, block)
    h_al = block.al
    least = wp.vec3(own / PIVOT_FLOOR)
    factor = cholesky(block.aa, wp.max(wp.get_diag(block.aa), least))
    turns = wp.matrix_from_cols(
        cholesky_solve(factor, wp.vec3(h_al[0, 0], h_al[1, 0], h_al[2, 0])),
        cholesky_solve(factor, wp.vec3(h_al[0, 1], h_al[1, 1], h_al[2, 1])),
        cholesky_solve(factor, wp.vec3(h_al[0, 2], h_al[1, 2], h_al[2, 2])),
    )
    turned = cholesky_solve(factor, wp.spatial_bottom(block.push) + torque)
    for i in range(3):
        axis = TreeAxis()
        axis.angular[i] = 1.0
        axis.linear = wp.cross(arm_c, axis.angular)
        axis.force = turns[i]
        axis.torque = axis.angular + wp.cross(arm_c, turns[i])
        axis.inv_pivot = 1.0
        axis.push = turned[i]
        tree.axes[first_axis + i] = axis
    h_la = wp.transpose(h_al)
    left = Block()
    left.ll = block.ll - h_la * turns
    left.push = wp.spatial_vector(wp.spatial_top(block.push) - h_la * turned, -torque)
    return left
