# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""One body of an articulation, eliminated: its block goes to its parent, by way of their joint.

``eliminate`` at the end says in which order. What a joint is open by is in
:mod:`.step.joint_frame`, its axes are in :mod:`.step.eliminate_axes`.
"""

import warp as wp

from ..algebra.block import factor_block, half_solve
from ..blocks import tree as algebra
from ..blocks.closure import end_rows, ends_rows, meet_root, softness_of
from ..blocks.tree import Block, seen_from, stiffened
from ..data import Solver, Step
from ..effects import Effects
from .anchors import is_linked
from .eliminate_axes import make_eliminate_axes
from .joint_frame import JointFrame, make_joint_frame
from .needles import stiffened_axis
from .tilting import (
    add_spin,
    forget_tilting,
    hand_down_tilting,
    project_tilting,
    push_tilting_root,
    times_tilting,
)


@wp.func
def held_by_loops(body: int, s: wp.ref[Solver]):
    """Wrench on a body of joints that close loops of its block, and its geometric stiffness [N m].

    They are what the sweep before has found: what carries a taut net grows many times over within a
    step.
    """
    stiffness = wp.mat33(0.0)
    wrench = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
        item = s.loops.items[k]
        i = item / 2
        if s.loops.is_exact[i]:
            sign = wp.where(item % 2 == 0, 1.0, -1.0)
            force = sign * s.history.loop_force[i]
            torque = sign * s.history.loop_torque[i] + wp.cross(s.loops.arms[item], force)
            stiffness += algebra.geometric_stiffness(force, s.loops.arms[item])
            wrench += wp.spatial_vector(force, torque)
    return wrench, stiffness


@wp.func
def clear_children(body: int, s: wp.ref[Solver]):
    """Clears what children have handed to a body, for the next sweep."""
    s.tree.h_ll[body] = wp.mat33(0.0)
    s.tree.h_al[body] = wp.mat33(0.0)
    s.tree.h_aa[body] = wp.mat33(0.0)
    s.tree.push[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    s.tree.load[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))


@wp.func
def add_to_parent(parent: int, block: Block, s: wp.ref[Solver]):
    """Adds a block to what a body has been handed."""
    s.tree.h_ll[parent] = s.tree.h_ll[parent] + block.ll
    s.tree.h_al[parent] = s.tree.h_al[parent] + block.al
    s.tree.h_aa[parent] = s.tree.h_aa[parent] + block.aa
    s.tree.push[parent] = s.tree.push[parent] + block.push


@wp.func
def find_joint_force(
    body: int,
    has_dual: bool,
    load: wp.spatial_vector,
    h: float,
    frame: wp.ref[JointFrame],
    s: wp.ref[Solver],
) -> wp.vec3:
    """Force of the body's joint on it [N]: what holds all that the body carries.

    In the first iteration (not ``has_dual``) it is that of the last step, since the guess tells it
    less well; ``frame.mismatch`` then says how far the two are apart.
    """
    force = -wp.spatial_top(load)
    if not has_dual:
        reach = wp.length(frame.arm_c)
        change = reach * wp.length(force - s.history.joint_force[body])
        force = s.history.joint_force[body]
        inv_h2 = 1.0 / (h * h)
        resistance = inv_h2 * wp.trace(s.work.inertia[body]) + reach * wp.length(force)
        frame.mismatch = change / resistance
    s.history.joint_force[body] = -wp.spatial_top(load)
    return force


@wp.func
def held_about_anchor(block: Block, frame: wp.ref[JointFrame]) -> Block:
    """The block about the joint's anchor, without what rounding has left along its free axes."""
    shifting = frame.carried.shifting
    turning = frame.carried.turning
    block = seen_from(-frame.arm_c, block)
    ll, al, aa = algebra.projected(shifting, turning, block.ll, block.al, block.aa)
    block.ll = algebra.not_less_than_rounding(shifting, ll)
    block.al = al
    block.aa = algebra.not_less_than_rounding(turning, aa)
    block.push = wp.spatial_vector(
        shifting * wp.spatial_top(block.push) + frame.carried.thrust,
        turning * wp.spatial_bottom(block.push) + frame.carried.torque,
    )
    return block


def make_eliminate(effects: Effects, gather: wp.Function) -> wp.Function:
    """Device function: eliminates one body of a tree.

    Args:
        effects: What the kernel is compiled with.
        gather: Device function that sums the inertial and contact wrench of a body, and what its
            contacts add to its block.
    """
    joint_frame = make_joint_frame(effects)
    eliminate_axes = make_eliminate_axes(effects)

    @wp.func
    def assemble(body: int, block: wp.ref[Block], h: float, s: wp.ref[Solver]) -> wp.spatial_vector:
        """Adds the body's own block, and what its children have handed to it, to its contacts'.

        Returns the wrench that the body's joint has to hold, with its children [N, N m].
        """
        inv_h2 = 1.0 / (h * h)
        own_ll = wp.diag(wp.vec3(s.model.mass[body] * inv_h2))
        own_al = wp.mat33(0.0)
        own_aa = s.work.inertia[body] * inv_h2
        if wp.static(effects.drag):
            own_ll += s.work.drag[body].ll / h
            own_al += s.work.drag[body].al / h
            own_aa += s.work.drag[body].aa / h
        if wp.static(effects.loops):
            if s.tree.is_touched[body]:
                own_ll = s.tree.own_ll[body]
                own_al = s.tree.own_al[body]
                own_aa = s.tree.own_aa[body]
        block.ll += own_ll + s.tree.h_ll[body]
        block.al += own_al + s.tree.h_al[body]
        block.aa += own_aa
        if wp.static(effects.needles):
            if s.tree.is_touched[body]:
                block.aa = stiffened_axis(body, block.aa, s)
        block.aa += s.tree.h_aa[body]
        if wp.static(effects.cables):
            block.ll += s.tree.cables.ll[body]
            block.al += s.tree.cables.al[body]
            block.aa += s.tree.cables.aa[body]
        load = block.push + s.tree.load[body]
        block.push += s.tree.push[body]
        if wp.static(effects.closures and effects.loops):
            held, held_aa = held_by_loops(body, s)
            block.aa += held_aa
            load += held
        if wp.static(effects.tilting):
            if s.tree.is_fast[body]:
                add_spin(body, s.work.spin_momentum[body], h, s.tree)
        clear_children(body, s)
        return load

    @wp.func
    def close_rows(
        body: int, has_dual: bool, recovery: float, block: wp.ref[Block], s: wp.ref[Solver]
    ):
        """Eliminates the rows that close loops and end at the body."""
        if wp.static(effects.closures):
            if ends_rows(body, s.tree.closures):
                softness = softness_of(has_dual, recovery)
                block = end_rows(body, block, softness, s.tree.closures)

    @wp.func
    def factor_root(body: int, block: Block, s: wp.ref[Solver]) -> float:
        """Factors the block of a body that no joint holds; substitution starts from it.

        Returns how far off the curvature of tendons may be, as a share of the block.
        """
        if wp.static(effects.tilting):
            if s.tree.is_fast[body]:
                block.push = push_tilting_root(body, block, s.tree)
        curved = float(0.0)
        if wp.static(effects.spatial_tendons):
            bound = s.tree.tendons.root_curvature[body]
            for k in range(3):
                curved = wp.max(curved, bound[k] / (block.ll[k, k] + bound[k]))
                curved = wp.max(curved, bound[3 + k] / (block.aa[k, k] + bound[3 + k]))
            block.ll += wp.diag(wp.spatial_top(bound))
            block.aa += wp.diag(wp.spatial_bottom(bound))
        factor = factor_block(block.ll, block.al, block.aa)
        s.work.factor[body] = factor
        s.tree.update[body] = half_solve(
            factor, wp.spatial_top(block.push), wp.spatial_bottom(block.push)
        )
        if wp.static(effects.closures):
            meet_root(body, s.work, s.tree)
        if wp.static(effects.tilting):
            if s.tree.is_fast[body]:
                forget_tilting(body, s.tree)
        return curved

    @wp.func
    def close_joint(body: int, frame: wp.ref[JointFrame], block: wp.ref[Block], s: wp.ref[Solver]):
        """Moves the body to where its joint closes: what that meets goes to the push."""
        block.push -= algebra.times_block(block.ll, block.al, block.aa, frame.closing)
        if wp.static(effects.tilting):
            if frame.is_fast:
                block.push -= times_tilting(body, frame.closing, s.tree)

    @wp.func
    def hand_to_parent(
        body: int,
        force: wp.vec3,
        load: wp.spatial_vector,
        h: float,
        frame: wp.ref[JointFrame],
        block: Block,
        s: wp.ref[Solver],
    ):
        """Adds to the parent what is left of the body's block, which its joint holds.

        ``force`` is that of the joint on the body [N], ``load`` the wrench that the joint has to
        hold [N, N m].
        """
        parent = frame.parent
        if s.work.inv_mass[parent] > 0.0:
            span = s.tree.span[body]
            arm = span
            if frame.is_free:
                arm = frame.arm_p
            elif wp.static(effects.light_roots):
                block = held_about_anchor(block, frame)
                if wp.static(effects.tilting):
                    if frame.is_fast:
                        project_tilting(
                            body, frame.carried.shifting, frame.carried.turning, frame.arm_c, s.tree
                        )
                arm = frame.arm_p
            block = seen_from(arm, block)
            mass = s.model.mass[parent]
            inertia = s.work.inertia[parent]
            add_to_parent(parent, stiffened(block, -force, frame.arm_p, mass, inertia, h), s)
            s.tree.load[parent] = s.tree.load[parent] + algebra.handed_down(span, load)
            if wp.static(effects.tilting):
                if frame.is_fast:
                    hand_down_tilting(body, parent, arm, s.tree)
        if wp.static(effects.tilting):
            if frame.is_fast:
                forget_tilting(body, s.tree)

    @wp.func(inline=effects.inline)
    def eliminate(
        body: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Reduces the body's block and wrench by its joint's axes and hands them to the parent.

        Returns how far off the geometric stiffness and the curvature of tendons may be, as a share
        of the block.
        """
        updates_duals = has_dual
        if wp.static(effects.contact):
            # multipliers are those of forces at a minimum; the recovery has none
            updates_duals = has_dual and (recovery > 0.0 or s.tree.is_minimal[body])
        block = gather(body, updates_duals, recovery, slop, h, step, s)
        load = assemble(body, block, h, s)
        close_rows(body, has_dual, recovery, block, s)
        if not is_linked(body, s):
            return factor_root(body, block, s)
        frame = joint_frame(body, recovery, s)
        force = find_joint_force(body, has_dual, load, h, frame, s)
        mass = s.model.mass[body]
        block = stiffened(block, force, frame.arm_c, mass, s.work.inertia[body], h)
        close_joint(body, frame, block, s)
        eliminate_axes(body, recovery, h, frame, block, step, s)
        hand_to_parent(body, force, load, h, frame, block, s)
        return frame.mismatch

    return eliminate
