# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""An articulation as one block: Newton's method on all bodies that a tree of joints links.

Bodies keep their six unknowns each. A joint ties the update of a body to that of its parent,

    delta_c = T delta_p + sum_d s_d q_d + g,

where T carries the parent's motion to the child, s_d are the axes that the joint leaves free and g
closes its misfit. Elimination from the leaves to the root and substitution back solves

    sum_c delta_c . (H_c delta_c / 2 - b_c)  ->  min

in time proportional to the number of bodies, whatever their masses: it is the articulated-body
recursion (Featherstone, "Rigid Body Dynamics Algorithms", chapter 7) of the step's equations.
H_c holds the inertia, the curvature of the body's contacts, and the geometric stiffness of its
joints: how the torque of a joint's force changes as its arm turns. Without that, a taut chain of
light links is unstable.
"""

import warp as wp

from ..data import TreeAxis

ROUNDED = wp.constant(3.0e-8)
"""What rounding may take from a sum of blocks, as a share of the larger. (4e-7 slows what has 6e-8
of what it carries: after ten sweeps it has slid 17 % too far; without, 6e-9 was not finite.)"""


@wp.struct
class Block:
    """What the motion delta of a body meets, H delta - push, once all that it carries has moved.

    H = [ ll  al^T ]
        [ al  aa   ]
    """

    ll: wp.mat33
    """[N/m]"""
    al: wp.mat33
    """[N]"""
    aa: wp.mat33
    """[N m]"""
    push: wp.spatial_vector
    """Wrench [N, N m]."""


@wp.func
def geometric_stiffness(force: wp.vec3, arm: wp.vec3) -> wp.mat33:
    """Angular curvature [N m] of a force [N] that acts on a body at an arm [m] turning with it.

    -d(r x f)/dtheta = (f.r) I - r f^T, made symmetric and shifted to be positive semidefinite.
    """
    product = wp.outer(arm, force)
    along = wp.dot(force, arm)
    shifted = 0.5 * (wp.length(force) * wp.length(arm) + along)
    return wp.diag(wp.vec3(shifted)) - 0.5 * (product + wp.transpose(product))


@wp.func
def buckling(force: wp.vec3, arm: wp.vec3, mass: float, inertia: wp.mat33, h: float) -> wp.mat33:
    """Angular curvature [N m] that keeps a body from overturning under a force [N] at an arm [m].

    A force that pushes along its arm has a curvature down to -(|f| |r| - f.r) / 2, for which
    :func:`geometric_stiffness` has none. Where that is more than the inertia of the body about the
    end of the arm, over h^2, the body turns over within the step, and each iteration would send it
    many turns around. With as much of the opposite sign the force has no more energy at any turn
    than the model says (majorisation), so that iterations lead down.
    """
    push = 0.5 * (wp.length(force) * wp.length(arm) - wp.dot(force, arm))
    inert = (wp.trace(inertia) / 3.0 + mass * wp.length_sq(arm)) / (h * h)
    return wp.diag(wp.vec3(wp.max(push - inert, 0.0)))


@wp.func
def combined_with(theta: wp.vec3, delta: wp.vec3) -> wp.vec3:
    """What exp(delta) adds to the rotation vector theta [rad], to second order in theta.

    That of exp(delta) exp(theta) is the sum. Of a theta of many radians the second order would take
    more of delta than there is.
    """
    across = wp.cross(theta, delta)
    second = 1.0 / wp.max(wp.dot(theta, theta), 12.0)
    return delta - 0.5 * across + second * wp.cross(theta, across)


@wp.func
def carried(span: wp.vec3, motion: wp.spatial_vector) -> wp.spatial_vector:
    """T delta: motion of a point at ``span`` from the COM of a body, with the body."""
    turn = wp.spatial_bottom(motion)
    return wp.spatial_vector(wp.spatial_top(motion) + wp.cross(turn, span), turn)


@wp.func
def handed_down(span: wp.vec3, wrench: wp.spatial_vector) -> wp.spatial_vector:
    """T^T w: wrench about the COM of the parent of one about the child's."""
    force = wp.spatial_top(wrench)
    return wp.spatial_vector(force, wp.spatial_bottom(wrench) + wp.cross(span, force))


@wp.func
def times_block(
    h_ll: wp.mat33, h_al: wp.mat33, h_aa: wp.mat33, motion: wp.spatial_vector
) -> wp.spatial_vector:
    """H delta of a block."""
    linear = wp.spatial_top(motion)
    angular = wp.spatial_bottom(motion)
    return wp.spatial_vector(
        h_ll * linear + wp.transpose(h_al) * angular, h_al * linear + h_aa * angular
    )


@wp.func
def span_block(span: wp.vec3, h_ll: wp.mat33, h_al: wp.mat33, h_aa: wp.mat33):
    """T^T H T: the child's block about the COM of the parent."""
    d = wp.skew(span)
    al = h_al + d * h_ll
    return h_ll, al, h_aa - h_al * d + d * wp.transpose(al)


@wp.func
def times_skew(
    n_ll: wp.mat33, n_al: wp.mat33, n_aa: wp.mat33, motion: wp.spatial_vector
) -> wp.spatial_vector:
    """N delta of the antisymmetric part of a block."""
    linear = wp.spatial_top(motion)
    angular = wp.spatial_bottom(motion)
    return wp.spatial_vector(
        n_ll * linear - wp.transpose(n_al) * angular, n_al * linear + n_aa * angular
    )


@wp.func
def span_skew(span: wp.vec3, n_ll: wp.mat33, n_al: wp.mat33, n_aa: wp.mat33):
    """T^T N T: as :func:`span_block` for the antisymmetric part."""
    d = wp.skew(span)
    al = n_al + d * n_ll
    return n_ll, al, n_aa - n_al * d - d * wp.transpose(al)


@wp.func
def seen_from(span: wp.vec3, block: Block) -> Block:
    """The block about a point that ``span`` leads from to where it was."""
    ll, al, aa = span_block(span, block.ll, block.al, block.aa)
    return Block(ll, al, aa, handed_down(span, block.push))


@wp.func
def stiffened(
    block: Block, force: wp.vec3, arm: wp.vec3, mass: float, inertia: wp.mat33, h: float
) -> Block:
    """The block of a body, of which a joint pushes an arm [m] with a force [N]."""
    block.aa += geometric_stiffness(force, arm)
    block.aa += buckling(force, arm, mass, inertia, h)
    return block


@wp.func
def eliminated(axis: TreeAxis, block: Block) -> Block:
    """The block that is left once a coordinate has been minimised over."""
    scaled_force = axis.inv_pivot * axis.force
    scaled_torque = axis.inv_pivot * axis.torque
    left = Block()
    left.ll = block.ll - wp.outer(scaled_force, axis.force)
    left.al = block.al - wp.outer(scaled_torque, axis.force)
    left.aa = block.aa - wp.outer(scaled_torque, axis.torque)
    left.push = block.push - axis.push * wp.spatial_vector(scaled_force, scaled_torque)
    return left


@wp.func
def eliminated_skew(
    axis: TreeAxis,
    tilting: wp.spatial_vector,
    block: Block,
    n_ll: wp.mat33,
    n_al: wp.mat33,
    n_aa: wp.mat33,
):
    """What :func:`eliminated` leaves out where the block has an antisymmetric part N.

    With a = H s and b = N s the block loses (a + b)(a - b)^T / pivot.

    Args:
        axis: The coordinate, with a as its force and torque.
        tilting: b.
        block: The symmetric part, less a a^T / pivot.
        n_ll, n_al, n_aa: The antisymmetric part.
    """
    force = wp.spatial_top(tilting)
    torque = wp.spatial_bottom(tilting)
    scaled_force = axis.inv_pivot * force
    scaled_torque = axis.inv_pivot * torque
    block.ll += wp.outer(scaled_force, force)
    block.al += wp.outer(scaled_torque, force)
    block.aa += wp.outer(scaled_torque, torque)
    # b a^T - a b^T
    skew_ll = n_ll - wp.outer(scaled_force, axis.force) + wp.outer(axis.force, scaled_force)
    skew_al = n_al - wp.outer(scaled_torque, axis.force) + wp.outer(axis.torque, scaled_force)
    skew_aa = n_aa - wp.outer(scaled_torque, axis.torque) + wp.outer(axis.torque, scaled_torque)
    return block, skew_ll, skew_al, skew_aa


@wp.func
def symmetric_push(
    block: Block, n_ll: wp.mat33, n_al: wp.mat33, n_aa: wp.mat33
) -> wp.spatial_vector:
    """Wrench that moves the block H as its push moves H + N."""
    ll = wp.inverse(block.ll + n_ll)
    al = block.al + n_al
    la = wp.transpose(block.al - n_al)
    f = wp.spatial_top(block.push)
    torque = wp.spatial_bottom(block.push) - al * (ll * f)
    turn = wp.inverse(block.aa + n_aa - al * ll * la) * torque
    motion = wp.spatial_vector(ll * (f - la * turn), turn)
    return times_block(block.ll, block.al, block.aa, motion)


@wp.func
def freed(held: wp.mat33, load: wp.vec3, axis: wp.vec3, push: float):
    """Takes a free axis out of the directions along which a joint holds.

    Args:
        held: Projects on the directions that are left.
        load: What the joint carries along those that were taken [N or N m].
        axis: The axis, of length 1.
        push: What is put on the axis, which reacts on the parent [N or N m].

    Returns:
        ``held`` and ``load`` after that, unchanged where others have taken the axis already.
    """
    across = held * axis
    size = wp.dot(across, across)
    if size < 1.0e-6:
        return held, load
    share = (push + wp.dot(axis, load)) / size
    return held - wp.outer(across / size, across), load - share * across


@wp.func
def projected(
    shifting: wp.mat33, turning: wp.mat33, h_ll: wp.mat33, h_al: wp.mat33, h_aa: wp.mat33
):
    """The block without what rounding has left in it along directions in which nothing holds."""
    return shifting * h_ll * shifting, turning * h_al * shifting, turning * h_aa * turning


@wp.func
def not_less_than_rounding(held: wp.mat33, block: wp.mat33) -> wp.mat33:
    """A projected block with the rounding of its largest along the directions that it leaves free.

    What a light parent has of its own along these is lost in the sum, and a sum that rounding makes
    negative throws it away. So it gives way more slowly, sweep by sweep.
    """
    return block + (ROUNDED * wp.trace(block)) * (wp.identity(n=3, dtype=float) - held)
