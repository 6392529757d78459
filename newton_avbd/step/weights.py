# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How much mass joints put behind the contacts of light links.

What a link stops at a contact is not its own mass but all that its joints make it stop: a foot of
16 g that carries 800 kg has to be held as those 800 kg are. By its own mass its contacts are so
soft that no number of sweeps finds their forces, and what is wedged between the ground and a heavy
body turns over. So the mass of a link along a direction is that of its articulated block where it
moves that way and does not turn. Two passes find it for all bodies of a tree (Featherstone, "Rigid
Body Dynamics Algorithms", chapter 7): outwards the blocks of subtrees are handed to parents, and
inwards those of all the rest to children.
"""

import warp as wp

from ..blocks import tree as algebra
from ..data import ContactRow, Solver, TreeAxis
from ..effects import Effects
from ..model.callers import LIGHT_LINK
from ..rows.free_axes import make_free_axes
from ..rows.joint import linear_axis, make_counts
from .anchors import anchor_arm, anchor_rotation, is_linked, make_frames_of
from .beginning import is_tree
from .bodies import body_at, has_rows
from .piles import LINK_WEIGHT

PIVOT_FLOOR = wp.constant(1.0e-6)
"""Least inertia along a free axis, as a share of the block: what rounding leaves counts as that."""


@wp.func
def mass_along(slot: int, normal: wp.vec3, s: wp.ref[Solver]) -> float:
    """Mass [kg] that moves with a body along a direction; without joints its own."""
    own = 1.0 / s.work.inv_mass[slot]
    return wp.max(own, wp.dot(normal, s.tree.own_ll[slot] * normal))


@wp.func
def mass_to_stop(row: ContactRow, span: wp.vec3, s: wp.ref[Solver]) -> float:
    """Mass by which a row is to be as stiff as what light links carry needs it [kg].

    Zero where neither of its bodies is a light link along its normal, by its mass or where the
    contact would turn it. The span leads from the COM of b to that of a [m].
    """
    inverse = float(0.0)
    is_light = bool(False)
    for side in range(2):
        slot = wp.where(side == 0, row.a, row.b)
        if s.work.inv_mass[slot] > 0.0:
            mass = mass_along(slot, row.normal, s)
            inverse += 1.0 / mass
            lever = wp.cross(wp.where(side == 0, row.arm, row.arm + span), row.normal)
            inv_own = s.work.inv_mass[slot] + wp.dot(lever, s.work.inv_inertia[slot] * lever)
            is_light = is_light or wp.static(LIGHT_LINK) * mass * inv_own > 1.0
    if is_light:
        return LINK_WEIGHT / inverse
    return 0.0


PARALLEL = wp.constant(1.0e-4)
"""Square of the sine between two axes of a joint below which they count as one."""


def make_weigh(effects: Effects) -> wp.Function:
    """Device function that weighs the trees of blocks that something touches."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    angular_axis = make_free_axes(effects.kinds).angular_axis
    frames_of = make_frames_of(effects.flipped)

    @wp.func(inline=effects.inline)
    def beyond_joint(
        body: int,
        is_inward: bool,
        mass: float,
        static_slot: int,
        h_ll: wp.mat33,
        h_al: wp.mat33,
        h_aa: wp.mat33,
        s: wp.ref[Solver],
    ):
        """Block of what is on one side of a body's joint, as the body on the other side feels it.

        Args:
            body: The body whose joint it is.
            is_inward: Whether the block is its parent's side; otherwise its own.
            mass: That of the tree [kg], of which the world is taken to have as much.
            static_slot: Slot of the static world.
            h_ll, h_al, h_aa: The block about the COM on that side [kg, kg m, kg m^2].
            s: The solver, with the tree at the start of the step.
        """
        joint = s.tree.joint[body]
        parent = s.tree.parent[body]
        above = wp.where(s.joints.parent[joint] < 0, static_slot, s.joints.parent[joint])
        q_p = anchor_rotation(s.tree, above, s.joints.parent_frame[joint])
        q_c = anchor_rotation(s.tree, s.joints.child[joint], s.joints.child_frame[joint])
        _sign, _frame_p, frame_c = frames_of(body, joint, s.joints)
        arm = anchor_arm(body, frame_c, static_slot, s)
        span = (s.work.com[body] - s.work.com[parent]) * wp.where(is_inward, -1.0, 1.0)
        if is_inward:
            if s.work.inv_mass[parent] > 0.0:
                arm -= span
            else:
                # nothing moves it: it lies at the anchor, and weighs as much as the tree
                gyration = wp.dot(arm, arm) + wp.trace(s.work.inertia[body]) * s.work.inv_mass[body]
                h_ll = wp.diag(wp.vec3(mass))
                h_al = wp.mat33(0.0)
                h_aa = wp.diag(wp.vec3(mass * gyration))
                span = arm
                arm = wp.vec3(0.0)
        linear = linear_count(s.joints, joint)
        first_axis = wp.vec3(0.0)
        for dof in range(linear + angular_count(s.joints, joint)):
            axis = TreeAxis()
            if dof < linear:
                axis.linear = linear_axis(s.joints, joint, dof, q_p)
            else:
                axis.angular = angular_axis(s.joints, joint, dof - linear, q_p, q_c, wp.vec3(0.0))
                axis.linear = wp.cross(arm, axis.angular)
                if dof == linear:
                    first_axis = axis.angular
                elif wp.length_sq(wp.cross(axis.angular, first_axis)) < PARALLEL:
                    continue  # the last axis of a gimbal at its pole: the first has freed it
            axis.force = h_ll * axis.linear + wp.transpose(h_al) * axis.angular
            axis.torque = h_al * axis.linear + h_aa * axis.angular
            pivot = wp.dot(axis.linear, axis.force) + wp.dot(axis.angular, axis.torque)
            size = wp.trace(h_ll) * wp.length_sq(axis.linear)
            size += wp.trace(h_aa) * wp.length_sq(axis.angular)
            axis.inv_pivot = 1.0 / wp.max(pivot, PIVOT_FLOOR * size)
            left = algebra.eliminated(axis, algebra.Block(h_ll, h_al, h_aa, wp.spatial_vector()))
            h_ll = left.ll
            h_al = left.al
            h_aa = left.aa
        return algebra.span_block(span, h_ll, h_al, h_aa)

    @wp.func(inline=effects.inline)
    def weigh_tree(first: int, end: int, s: wp.ref[Solver]):
        """Leaves the mass of each body of a tree, along all directions, in ``tree.own_ll``."""
        static_slot = s.work.inv_mass.shape[0] - 1
        count = end - first
        mass = float(0.0)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            parent = s.tree.parent[body]
            s.tree.rotation[body] = wp.transform_get_rotation(s.work.pose[body])
            if s.work.inv_mass[parent] == 0.0 and parent != static_slot:
                s.tree.rotation[parent] = wp.transform_get_rotation(s.work.pose[parent])
            if s.work.inv_mass[body] > 0.0:
                mass += s.model.mass[body]
            s.tree.own_ll[body] = wp.mat33(0.0)
            s.tree.own_al[body] = wp.mat33(0.0)
            s.tree.own_aa[body] = wp.mat33(0.0)
        # Two passes by one call. Outwards own_* is what a parent feels of the body, and h_* the sum
        # of that; inwards own_* becomes what the body feels of all that is not behind it.
        for k in range(2 * count):
            is_inward = k >= count
            body = body_at(wp.where(is_inward, first + k - count, end - 1 - k), s.worlds)
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                parent = s.tree.parent[body]
                side = wp.where(is_inward, parent, body)
                h_ll = s.tree.h_ll[side]
                h_al = s.tree.h_al[side]
                h_aa = s.tree.h_aa[side]
                if s.work.inv_mass[side] > 0.0:
                    h_ll += wp.diag(wp.vec3(s.model.mass[side]))
                    h_aa += s.work.inertia[side]
                if is_inward:
                    h_ll += s.tree.own_ll[side] - s.tree.own_ll[body]
                    h_al += s.tree.own_al[side] - s.tree.own_al[body]
                    h_aa += s.tree.own_aa[side] - s.tree.own_aa[body]
                h_ll, h_al, h_aa = beyond_joint(
                    body, is_inward, mass, static_slot, h_ll, h_al, h_aa, s
                )
                s.tree.own_ll[body] = h_ll
                s.tree.own_al[body] = h_al
                s.tree.own_aa[body] = h_aa
                if not is_inward and s.work.inv_mass[parent] > 0.0:
                    s.tree.h_ll[parent] = s.tree.h_ll[parent] + h_ll
                    s.tree.h_al[parent] = s.tree.h_al[parent] + h_al
                    s.tree.h_aa[parent] = s.tree.h_aa[parent] + h_aa
        for i in range(first, end):
            body = body_at(i, s.worlds)
            own = wp.diag(wp.vec3(s.model.mass[body]))
            s.tree.own_ll[body] = s.tree.own_ll[body] + s.tree.h_ll[body] + own
            s.tree.h_ll[body] = wp.mat33(0.0)
            s.tree.h_al[body] = wp.mat33(0.0)
            s.tree.h_aa[body] = wp.mat33(0.0)

    @wp.func(inline=effects.inline)
    def weigh_blocks(first: int, last: int, s: wp.ref[Solver]):
        """Weighs the trees that are touched of the bodies from ``first`` to ``last``."""
        start = int(first)
        while start < last:
            end = s.worlds.block_end[start]
            is_touched = bool(False)
            for i in range(start, end):
                is_touched = is_touched or has_rows(s.rows, body_at(i, s.worlds))
            if is_touched and is_tree(start, end, body_at(start, s.worlds), s.tree):
                weigh_tree(start, end, s)
            start = end

    return weigh_blocks
