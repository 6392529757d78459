# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""One iteration of Newton's method on the tree of an articulation: eliminate, substitute."""

from dataclasses import dataclass

import warp as wp

from ..algebra.block import (
    PIVOT_FLOOR,
    cholesky,
    cholesky_solve,
    factor_block,
    half_solve,
    other_half,
)
from ..algebra.so3 import exp_quat, rotation_vector, turned_from, world_inertia
from ..blocks import tree as algebra
from ..blocks.closure import (
    MISSED,
    end_rows,
    find_multipliers,
    meet_axes,
    meet_root,
    rows_push,
    softness_of,
    solve_ground,
)
from ..data import BodyWork, JointModel, LoopWork, Solver, Step, TreeAxis, TreeWork, WorldScale
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows import joint as joint_rows
from ..rows.dahl import dahl_response
from ..rows.joint import BALL, NEAR_POLE, ROD, counted, wrapped
from .axes import make_axis
from .bodies import body_at, has_rows, nonnegative
from .carrying import is_short
from .scale import STOPPING
from .slopes import begin_axis, make_inputs

ROUNDING = wp.constant(5.0e-7)
"""Misfit of a joint that the poses' own rounding explains, as a share of the lengths involved."""

PATIENCE = wp.constant(3)
"""Sweeps that may fail to leave fewer axes on wrong pieces before one axis at a time moves on.
After the first of them updates are searched along where something on the axes has a bound."""
SEARCHES = wp.constant(8)
"""Bisections of the share of an update at which the energy along it is least."""
HIDDEN = wp.constant(2.0e-2)
"""Move of a body with contacts that counts as none, as a share of the penetration that is left
alone: 1e-3 g h^2."""
FAR = wp.constant(3.0e-2)
"""Turn by an update from which joint coordinates are measured again [rad]."""
HINGE_NEAR = wp.constant(0.1)
"""Sine of half the turn of a hinge in a step up to which a series tells the turn."""
MOST_TURN = wp.constant(1.0)
"""Most that an iteration turns a body [rad]: what is linear in a turn says nothing beyond."""
POLE_DRAG = 1.0e-3
"""Inertia that resists how the outer axes of a gimbal turn against each other at its pole, of the
body's own. It only brakes, as if they were always at rest at the start of a step."""
COUNTED = wp.constant(1.0)
"""Turn of a joint in a step from which orientations may not tell it [rad]."""
WIDE = wp.constant(0.8)
"""Moment across an axis, of that about it, up to which a spin keeps to the axis at any speed."""


@wp.func
def anchor_arm(slot: int, frame: wp.transform, static_slot: int, s: wp.ref[Solver]) -> wp.vec3:
    """From the COM of a body, moved by its increment, to an anchor on it [m], world axes.

    The static world is taken to lie at its anchor.
    """
    point = wp.transform_get_translation(frame)
    if slot == static_slot:
        return wp.vec3(0.0)
    return wp.quat_rotate(s.tree.rotation[slot], point - s.model.com[slot])


@wp.func
def anchor_rotation(tree: wp.ref[TreeWork], slot: int, frame: wp.transform) -> wp.quat:
    """Rotation of an anchor frame after the increment."""
    return tree.rotation[slot] * wp.transform_get_rotation(frame)


@wp.func
def joint_shift(work: wp.ref[BodyWork], slot: int) -> wp.vec3:
    """Shift of a body in the step as its joints see it [m]: a kinematic one is where it is put."""
    if work.inv_mass[slot] == 0.0:
        return wp.vec3(0.0)
    return wp.spatial_top(work.increment[slot])


@wp.func
def start_span(
    body: int, parent: int, frame_p: wp.transform, static_slot: int, s: wp.ref[Solver]
) -> wp.vec3:
    """From the COM of the parent to that of the body at the start of the step [m].

    Far from the origin positions of bodies are coarse, and their difference is exact: so it is
    taken first, with what the poses' rounding has lost.
    """
    pose = s.work.pose[body]
    x = wp.transform_get_translation(pose)
    arm = wp.quat_rotate(wp.transform_get_rotation(pose), s.model.com[body])
    if parent == static_slot:
        return (x - wp.transform_get_translation(frame_p)) + (arm + s.history.lost[body])
    pose_p = s.work.pose[parent]
    arm -= wp.quat_rotate(wp.transform_get_rotation(pose_p), s.model.com[parent])
    lost = s.history.lost[body] - s.history.lost[parent]
    return (x - wp.transform_get_translation(pose_p)) + (arm + lost)


@wp.func
def anchor_offset(
    apart: wp.vec3, work: wp.ref[BodyWork], body: int, parent: int, arm_c: wp.vec3, arm_p: wp.vec3
) -> wp.vec3:
    """From the parent anchor to the child anchor after the increments [m].

    ``apart`` is what :func:`start_span` found.
    """
    moved = joint_shift(work, body) - joint_shift(work, parent)
    return (apart + (arm_c - arm_p)) + moved


@wp.func
def carried_misfit(
    parent: int, arm_p: wp.vec3, shift: wp.vec3, turn: wp.vec3, s: wp.ref[Solver]
) -> wp.spatial_vector:
    """Misfit of a joint that is not new in this step.

    A kinematic parent has been put ahead of its child by what it moves in a step; that is new.
    """
    if s.work.inv_mass[parent] == 0.0:
        ahead = algebra.carried(arm_p, s.tree.update[parent])
        return wp.spatial_vector(shift, turn) + ahead
    return wp.spatial_vector(shift, turn)


@wp.func
def turn_by(body: int, rest: wp.vec3, tree: wp.ref[TreeWork]):
    """Turns a body after the turn of :func:`begin_turn` [rad], world axes."""
    swing = exp_quat(rest)
    tree.rotation[body] = swing * tree.turned[body]
    turn = tree.turn[body]
    if wp.length_sq(turn) > 0.0:
        swing = swing * exp_quat(turn)
    tree.swing[body] = swing


@wp.func
def place_body(body: int, s: wp.ref[Solver]):
    """Orientation of a body after its increment, the turn of :func:`begin_turn` first.

    The rest is small, where the increment is many radians.
    """
    turn_by(body, wp.spatial_bottom(s.work.increment[body]) - s.tree.turn[body], s.tree)


@wp.func
def begin_turn(body: int, turn: wp.vec3, s: wp.ref[Solver]):
    """Orientation of a body that is to turn as said [rad], whatever the sweeps add to it."""
    rotation = wp.transform_get_rotation(s.work.pose[body])
    s.tree.turn[body] = turn
    if wp.length_sq(turn) > 0.0:
        s.tree.turned[body] = exp_quat(turn) * rotation
        place_body(body, s)
    else:
        swing = exp_quat(wp.spatial_bottom(s.work.increment[body]))
        s.tree.turned[body] = rotation
        s.tree.rotation[body] = swing * rotation
        s.tree.swing[body] = swing


@wp.func
def is_put(slot: int, work: wp.ref[BodyWork]) -> bool:
    """Whether a body is kinematic: where it is put, which may be ahead of where it was."""
    return work.inv_mass[slot] == 0.0 and slot != work.inv_mass.shape[0] - 1


@wp.func
def anchor_shift(
    child: int, parent: int, arm_c: wp.vec3, arm_p: wp.vec3, s: wp.ref[Solver]
) -> wp.vec3:
    """How far the child anchor has moved in the step against the parent's [m].

    It is read off the increments, so that it rounds as they do. What :func:`anchor_offset` gives
    rounds as the arms do, 1e-8 m of decimeters, and rows that imply each other but for the slope of
    a taut net make a hundred times as much of it.
    """
    moved = joint_shift(s.work, child) - joint_shift(s.work, parent)
    moved += turned_from(s.tree.swing[child], arm_c)
    return moved - turned_from(s.tree.swing[parent], arm_p)


@wp.func
def relative_turn(child: int, parent: int, tree: wp.ref[TreeWork]) -> wp.quat:
    """Turn of a body against its parent in the step, world axes."""
    return tree.swing[child] * wp.quat_inverse(tree.swing[parent])


@wp.func
def full_turns(child: int, parent: int, work: wp.ref[BodyWork]) -> wp.vec3:
    """About how far a body turns in the step against its parent [rad], world axes.

    Orientations do not tell turns of more than half a revolution: this does, for a motor. Zero
    where there is nothing to tell.
    """
    turn = wp.spatial_bottom(work.increment[child] - work.increment[parent])
    if wp.length_sq(turn) > COUNTED * COUNTED:
        return turn
    return wp.vec3(0.0)


@wp.func
def is_fast_shaft(body: int, work: wp.ref[BodyWork]) -> bool:
    """Whether a body turns so far in the step, about an axis along which it is so long, that its
    spin does not keep to it by itself."""
    if wp.length_sq(work.spin_momentum[body]) == 0.0:
        return False
    turn = wp.spatial_bottom(work.increment[body])
    size = wp.length_sq(turn)
    about = wp.dot(turn, work.inertia[body] * turn)
    across = 0.5 * (wp.trace(work.inertia[body]) * size - about)
    return across > WIDE * about and size * across > COUNTED * COUNTED * about


@wp.func
def ball_turn(child: int, parent: int, q_p: wp.quat, s: wp.ref[Solver]) -> wp.vec3:
    """Turn of a ball joint in the step [rad], parent anchor frame."""
    turn = rotation_vector(relative_turn(child, parent, s.tree))
    about = full_turns(child, parent, s.work)
    if wp.length_sq(about) > 0.0:
        axis = wp.normalize(turn)
        angle = wp.dot(axis, about)
        turn = (angle + wrapped(wp.dot(axis, turn) - angle)) * axis
    return wp.quat_rotate_inv(q_p, turn)


@wp.func
def is_linked(body: int, s: wp.ref[Solver]) -> bool:
    """Whether the tree's joint of the body exists and is enabled."""
    joint = s.tree.joint[body]
    if joint < 0:
        return False
    return s.joints.enabled[joint]


@wp.func
def parent_slot(joints: wp.ref[JointModel], joint: int, static_slot: int) -> int:
    """Slot of the joint's parent."""
    parent = joints.parent[joint]
    return wp.where(parent < 0, static_slot, parent)


@wp.func
def turning_mobility(body: int, s: wp.ref[Solver]) -> wp.mat33:
    """What a torque does to the spin of a body after the increments [1/(kg m^2)], world axes."""
    if s.work.inv_mass[body] == 0.0:
        return wp.mat33(0.0)
    return world_inertia(s.tree.rotation[body], s.model.inv_inertia[body])


@wp.func
def free_ball(
    first_axis: int,
    arm_c: wp.vec3,
    torque: wp.vec3,
    own: float,
    h_ll: wp.mat33,
    h_al: wp.mat33,
    h_aa: wp.mat33,
    push: wp.spatial_vector,
    tree: wp.ref[TreeWork],
):
    """Eliminates all three turns at once of a ball joint that nothing drives, brakes or stops.

    About its anchor such a joint hands down a force only. Its axes are those of the world; what
    each meets does not depend on the others, so that substitution may take them in any order.

    Args:
        first_axis: First of the joint's axes in ``tree.axes``.
        arm_c: From the COM of the body to the anchor [m].
        torque: What is put on the joint, which reacts on the parent [N m].
        own: Least moment of inertia of the body over h^2 [N m]; no turn meets less.
        h_ll, h_al, h_aa: Block of the body about its COM.
        push: Wrench on the body about its COM.
        tree: The trees' work.

    Returns:
        The block that is left about the anchor, of which only the linear part is not zero, and the
        wrench about the anchor.
    """
    h_ll, h_al, h_aa = algebra.span_block(-arm_c, h_ll, h_al, h_aa)
    push = algebra.handed_down(-arm_c, push)
    least = wp.vec3(own / PIVOT_FLOOR)
    factor = cholesky(h_aa, wp.max(wp.get_diag(h_aa), least))
    turns = wp.matrix_from_cols(
        cholesky_solve(factor, wp.vec3(h_al[0, 0], h_al[1, 0], h_al[2, 0])),
        cholesky_solve(factor, wp.vec3(h_al[0, 1], h_al[1, 1], h_al[2, 1])),
        cholesky_solve(factor, wp.vec3(h_al[0, 2], h_al[1, 2], h_al[2, 2])),
    )
    turned = cholesky_solve(factor, wp.spatial_bottom(push) + torque)
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
    force = wp.spatial_top(push) - h_la * turned
    return h_ll - h_la * turns, wp.spatial_vector(force, -torque)


@wp.func
def has_soft_loops(body: int, loops: wp.ref[LoopWork]) -> bool:
    """Whether a joint acts on the body whose rows converge by a factor, sweep by sweep."""
    for k in range(loops.body_start[body], loops.body_start[body + 1]):
        if loops.is_soft[loops.items[k] / 2]:
            return True
    return False


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


@wp.func(inline=False)
def push_tilting_root(
    body: int,
    h_ll: wp.mat33,
    h_al: wp.mat33,
    h_aa: wp.mat33,
    push: wp.spatial_vector,
    tree: wp.ref[TreeWork],
) -> wp.spatial_vector:
    """As :func:`.blocks.tree.symmetric_push`, of a body that no joint holds."""
    return algebra.symmetric_push(
        h_ll, h_al, h_aa, tree.n_ll[body], tree.n_al[body], tree.n_aa[body], push
    )


@wp.func
def times_tilting(
    body: int, motion: wp.spatial_vector, tree: wp.ref[TreeWork]
) -> wp.spatial_vector:
    """N delta of a body's antisymmetric part."""
    return algebra.times_skew(tree.n_ll[body], tree.n_al[body], tree.n_aa[body], motion)


@wp.func(inline=False)
def eliminate_tilting(
    body: int,
    axis: TreeAxis,
    h_ll: wp.mat33,
    h_al: wp.mat33,
    h_aa: wp.mat33,
    tree: wp.ref[TreeWork],
):
    """Takes an axis out of a body's antisymmetric part N, and what that adds to the block.

    Returns the block and N s of the axis.
    """
    n_ll = tree.n_ll[body]
    n_al = tree.n_al[body]
    n_aa = tree.n_aa[body]
    direction = wp.spatial_vector(axis.linear, axis.angular)
    tilting = algebra.times_skew(n_ll, n_al, n_aa, direction)
    if not axis.pivot > 0.0:
        h_ll, h_al, h_aa, n_ll, n_al, n_aa = algebra.eliminated_skew(
            axis, tilting, h_ll, h_al, h_aa, n_ll, n_al, n_aa
        )
        tree.n_ll[body] = n_ll
        tree.n_al[body] = n_al
        tree.n_aa[body] = n_aa
    return h_ll, h_al, h_aa, tilting


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


@dataclass(frozen=True)
class TreeFunctions:
    """Device functions of trees, compiled for the joints of a scene."""

    measure_start: wp.Function
    measure_velocity: wp.Function
    measure_guess: wp.Function
    count_turns: wp.Function
    align_spins: wp.Function
    sweep_tree: wp.Function
    put_together: wp.Function
    stop_coordinates: wp.Function


def make_trees(
    effects: Effects,
    gather: wp.Function,
    begin_rows: wp.Function,
    keep_forces: wp.Function,
    missed_by_lines: wp.Function,
    settle_tendons: wp.Function,
) -> TreeFunctions:
    """Device functions: how joints stand, and one Newton iteration on a tree.

    Args:
        effects: What the kernel is compiled with.
        gather: Device function that sums the inertial and contact wrench of a body.
        begin_rows: Device function that starts the closures of a block.
        keep_forces: Device function that keeps what they push with.
        missed_by_lines: Device function that measures what equality constraints are off by.
        settle_tendons: Device function that measures what tendons are off by.
    """
    ahead_along, keep_input = make_inputs(effects)[2:]
    joint_functions = joint_rows.make_joint(effects.kinds)
    linear_count = joint_functions.linear_count
    angular_count = joint_functions.angular_count
    linear_axis = joint_functions.linear_axis
    angles, known_angles = joint_functions.angles, joint_functions.known_angles
    is_gimbal, gimbal_tilt = joint_functions.is_gimbal, joint_functions.gimbal_tilt
    is_led = joint_functions.is_led
    velocity = joint_functions.velocity
    advance = joint_functions.advance
    linear_misfit = joint_functions.linear_misfit
    angular_axis = joint_functions.angular_axis
    angular_misfit = joint_functions.angular_misfit
    locked_shift, locked_turn = joint_functions.locked_shift, joint_functions.locked_turn
    angular_lock = joint_functions.angular_lock
    axes = make_axis(effects)
    linear_force, law_of, next_piece = axes.linear_force, axes.law_of, axes.next_piece
    compliant_limit = axes.compliant_limit

    @wp.func
    def frames_of(joint: int, body: int, joints: wp.ref[JointModel]):
        """1, the anchor frame on the body's parent in the tree, and that on the body.

        -1 where the tree goes from the joint's child to its parent: the joint then moves the body
        by the opposite of its coordinates.
        """
        sign = float(1.0)
        frame_p = joints.parent_frame[joint]
        frame_c = joints.child_frame[joint]
        if wp.static(effects.flipped):
            if joints.child[joint] != body:
                sign = -1.0
                frame_p = joints.child_frame[joint]
                frame_c = joints.parent_frame[joint]
        return sign, frame_p, frame_c

    @wp.func
    def in_joint_order(sign: float, q_p: wp.quat, q_c: wp.quat):
        """Rotations of the anchors of the joint's parent and child."""
        if sign < 0.0:
            return q_c, q_p
        return q_p, q_c

    @wp.func
    def anchors_of(joint: int, body: int, parent: int, s: wp.ref[Solver]):
        """What :func:`frames_of` returns, and rotations of the anchors of the joint's parent and
        child as ``tree`` has them."""
        sign, frame_p, frame_c = frames_of(joint, body, s.joints)
        q_p = anchor_rotation(s.tree, parent, frame_p)
        q_c = anchor_rotation(s.tree, body, frame_c)
        if wp.static(effects.flipped):
            q_p, q_c = in_joint_order(sign, q_p, q_c)
        return sign, frame_p, frame_c, q_p, q_c

    @wp.func
    def measure_misfit(
        body: int,
        sign: float,
        frame_p: wp.transform,
        frame_c: wp.transform,
        q_p: wp.quat,
        q_c: wp.quat,
        static_slot: int,
        s: wp.ref[Solver],
    ) -> bool:
        """Misfit of the body's joint at the start of the step, by what :func:`anchors_of` returns.

        Expects increments of zero, the guess of them in ``tree.update``, and rotations at the
        start. Returns whether the misfit is beyond rounding.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        arm_p = anchor_arm(parent, frame_p, static_slot, s)
        arm_c = anchor_arm(body, frame_c, static_slot, s)
        apart = start_span(body, parent, frame_p, static_slot, s)
        s.tree.apart[body] = apart
        linear = linear_misfit(s.joints, joint, q_p, apart + (arm_c - arm_p))
        angular = sign * angular_misfit(s.joints, joint, q_p, q_c)
        misfit = carried_misfit(parent, arm_p, linear, angular, s)
        if s.work.inv_mass[parent] == 0.0:
            # only what the joint locks
            linear = linear_misfit(s.joints, joint, q_p, wp.spatial_top(misfit))
            lock = angular_lock(s.joints, joint, q_p, q_c)
            angular = lock * wp.spatial_bottom(misfit)
        s.tree.misfit[body] = wp.spatial_vector(linear, angular)
        reach = wp.length(arm_c) + wp.length(arm_p)
        s.tree.rounding[body] = ROUNDING * reach
        allowed = ROUNDING * (wp.length(s.work.com[body]) + reach)
        return wp.length_sq(linear) + reach * reach * wp.length_sq(angular) > allowed * allowed

    @wp.func
    def put_together(body: int, static_slot: int, s: wp.ref[Solver]):
        """Moves the body to where its joint is closed, whatever that takes; parents go first."""
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        sign, frame_p, frame_c, q_p, q_c = anchors_of(joint, body, parent, s)
        tilt = sign * angular_misfit(s.joints, joint, q_p, q_c)
        s.tree.rotation[body] = exp_quat(-tilt) * s.tree.rotation[body]
        arm_p = anchor_arm(parent, frame_p, static_slot, s)
        arm_c = anchor_arm(body, frame_c, static_slot, s)
        offset = anchor_offset(s.tree.apart[body], s.work, body, parent, arm_c, arm_p)
        misfit = linear_misfit(s.joints, joint, q_p, offset)
        s.work.increment[body] = s.work.increment[body] - wp.spatial_vector(misfit, wp.vec3(0.0))

    @wp.func
    def align_ends(joint: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """Takes what a joint locks from the spins of its ends, by a torque between them."""
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, s.work.inv_mass.shape[0] - 1)
        q_p = anchor_rotation(s.tree, parent, s.joints.parent_frame[joint])
        q_c = anchor_rotation(s.tree, child, s.joints.child_frame[joint])
        lock = angular_lock(s.joints, joint, q_p, q_c)
        spin = wp.spatial_bottom(step.body_qd_out[child])
        mobility_c = turning_mobility(child, s)
        mobility_p = wp.mat33(0.0)
        if parent < step.body_qd_out.shape[0]:
            spin -= wp.spatial_bottom(step.body_qd_out[parent])
            mobility_p = turning_mobility(parent, s)
        mobility = mobility_c + mobility_p
        # what is free is left free, and the matrix has an inverse
        free = wp.identity(n=3, dtype=float) - lock
        matrix = lock * mobility * lock + wp.trace(mobility) * free
        # twice locked: what rounds the axis once would slow the spin, step by step
        torque = -(lock * (wp.inverse(matrix) * (lock * (lock * spin))))
        none = wp.vec3(0.0)
        step.body_qd_out[child] = step.body_qd_out[child] + wp.spatial_vector(
            none, mobility_c * torque
        )
        if parent < step.body_qd_out.shape[0]:
            step.body_qd_out[parent] = step.body_qd_out[parent] - wp.spatial_vector(
                none, mobility_p * torque
            )

    @wp.func
    def align_spins(first: int, end: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """Takes what joints lock from the spins of fast long bodies in blocks; parents go first.

        A spin that is off the axis by rounding turns the target off it, by more the longer the body
        is along the axis; that the joint holds the body against it carried the spin along, to twice
        as far off in each step of two radians. (Of discs and slower spins, what is off is how the
        axis turns; without it they would lose speed.)
        """
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if wp.static(effects.tilting):
                if not s.tree.is_fast[body]:
                    continue  # nothing of its block is
            is_fast = is_fast_shaft(body, s.work)
            if is_linked(body, s):
                if is_fast or is_fast_shaft(s.tree.parent[body], s.work):
                    align_ends(s.tree.joint[body], step, s)
            if is_fast:
                if wp.static(effects.closures and effects.loops):
                    for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                        loop = s.loops.items[k] / 2
                        if s.loops.is_exact[loop] and s.loops.k_l[loop] > 0.0:
                            align_ends(s.loops.joints[loop], step, s)

    @wp.func
    def tilt_beyond(body: int, first: int, s: wp.ref[Solver]) -> wp.vec3:
        """Turn of the body [rad] beyond where the coordinates of its gimbal have it, which stand
        from ``first`` on."""
        joint = s.tree.joint[body]
        sign, frame_p, frame_c = frames_of(joint, body, s.joints)
        q_p = anchor_rotation(s.tree, s.tree.parent[body], frame_p)
        q_c = anchor_rotation(s.tree, body, frame_c)
        if wp.static(effects.flipped):
            q_p, q_c = in_joint_order(sign, q_p, q_c)
        known = known_angles(s.joints, joint, s.history.joint_angle, first)
        return sign * gimbal_tilt(s.joints, joint, q_p, q_c, known)

    @wp.func(inline=effects.inline)
    def read_coordinates(
        body: int,
        sign: float,
        frame_p: wp.transform,
        frame_c: wp.transform,
        q_p: wp.quat,
        q_c: wp.quat,
        first: int,
        turn: wp.vec3,
        known: wp.array[wp.float64],
        coordinates: wp.array[wp.float64],
        static_slot: int,
        s: wp.ref[Solver],
    ):
        """As :func:`measure_coordinates`, by what :func:`anchors_of` returns."""
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        linear = linear_count(s.joints, joint)
        dofs = linear + angular_count(s.joints, joint)
        if wp.static(effects.kinds.balls):
            if s.joints.type[joint] == BALL:
                turns = sign * ball_turn(body, parent, q_p, s)
                for dof in range(dofs):
                    coordinates[first + dof] = wp.float64(turns[dof])
                return
        if linear > 0:
            arm_p = anchor_arm(parent, frame_p, static_slot, s)
            arm_c = anchor_arm(body, frame_c, static_slot, s)
            offset = sign * anchor_offset(s.tree.apart[body], s.work, body, parent, arm_c, arm_p)
            for dof in range(linear):
                q = wp.dot(linear_axis(s.joints, joint, dof, q_p), offset)
                coordinates[first + dof] = wp.float64(q)
        if dofs > linear:
            has_turned = wp.length_sq(turn) > 0.0
            started = known_angles(s.joints, joint, known, first)
            near = wp.vec3(started)
            if wp.static(effects.kinds.gimbals):
                if has_turned and is_gimbal(s.joints, joint):
                    for i in range(3):
                        ahead = advance(s.joints, joint, linear + i, q_p, q_c, started, sign * turn)
                        near[i] = started[i] + wp.float32(ahead)
            turns = angles(s.joints, joint, q_p, q_c, near, True)
            for dof in range(linear, dofs):
                about = known[first + dof]
                if has_turned:
                    about += advance(s.joints, joint, dof, q_p, q_c, started, sign * turn)
                coordinates[first + dof] = counted(turns[dof - linear], about)

    @wp.func(inline=effects.inline)
    def measure_coordinates(
        body: int,
        first: int,
        turn: wp.vec3,
        known: wp.array[wp.float64],
        static_slot: int,
        s: wp.ref[Solver],
    ):
        """Coordinates of the body's joint as ``tree`` has it; of a ball its turn in the step.

        They and the ``known`` ones stand in their arrays from ``first`` on. An angle is the one
        nearest to the known one, and what the joint's ``turn`` since then [rad, world frame] adds
        to it, so that revolutions are counted.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        sign, frame_p, frame_c, q_p, q_c = anchors_of(joint, body, parent, s)
        read_coordinates(
            body,
            sign,
            frame_p,
            frame_c,
            q_p,
            q_c,
            first,
            turn,
            known,
            s.tree.coordinate,
            static_slot,
            s,
        )

    @wp.func
    def put_back(body: int, static_slot: int, s: wp.ref[Solver]):
        """Puts the coordinates of the body's joint back to the limits that the step has passed.

        What was beyond at the start of the step may stay. The body goes along with its parent, of
        which ``tree.update`` says how it has been put back; parents go first.
        """
        back = wp.quat_identity()
        shift = wp.vec3(0.0)
        if is_linked(body, s):
            joint = s.tree.joint[body]
            parent = s.tree.parent[body]
            if s.work.inv_mass[parent] > 0.0:
                shift = wp.spatial_top(s.tree.update[parent])
                turn = wp.spatial_bottom(s.tree.update[parent])
                if wp.length_sq(turn) > 0.0:
                    back = exp_quat(turn)
                    span = s.tree.apart[body] + joint_shift(s.work, body)
                    span -= joint_shift(s.work, parent) - shift
                    shift += wp.quat_rotate(back, span) - span
                    s.tree.rotation[body] = back * s.tree.rotation[body]
            sign, frame_p, frame_c = frames_of(joint, body, s.joints)
            known = known_angles(s.joints, joint, s.tree.coordinate, s.tree.axis_start[body])
            linear = linear_count(s.joints, joint)
            dofs = linear + angular_count(s.joints, joint)
            if not joint_rows.has_axes(s.joints, joint):
                dofs = 0
            for dof in range(dofs):
                k = nonnegative(s.tree.axis_start[body] + dof)
                excess = axis_rows.passed_limit(
                    s.joints,
                    s.joints.dof_start[joint] + dof,
                    s.tree.coordinate[k],
                    s.tree.start_coordinate[k],
                )
                if excess != 0.0:
                    q_p = anchor_rotation(s.tree, parent, frame_p)
                    q_c = anchor_rotation(s.tree, body, frame_c)
                    if wp.static(effects.flipped):
                        q_p, q_c = in_joint_order(sign, q_p, q_c)
                    s.tree.coordinate[k] = s.tree.coordinate[k] - wp.float64(excess)
                    if dof < linear:
                        shift -= excess * sign * linear_axis(s.joints, joint, dof, q_p)
                    else:
                        axis = sign * angular_axis(s.joints, joint, dof - linear, q_p, q_c, known)
                        step = exp_quat(-excess * axis)
                        arm = anchor_arm(body, frame_c, static_slot, s)
                        shift += arm - wp.quat_rotate(step, arm)
                        back = step * back
                        s.tree.rotation[body] = step * s.tree.rotation[body]
        s.work.increment[body] = s.work.increment[body] + wp.spatial_vector(shift, wp.vec3(0.0))
        s.tree.update[body] = wp.spatial_vector(shift, rotation_vector(back))

    @wp.func
    def stop_coordinates(first: int, end: int, static_slot: int, s: wp.ref[Solver]):
        """Has the limits of bodies from ``first`` on hold after sweeps that were cut off.

        An axis may be on the wrong piece of its law, and coordinates that have followed many turns
        are off by their squares.
        """
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                measure_coordinates(
                    body, s.tree.axis_start[body], wp.vec3(0.0), s.tree.coordinate, static_slot, s
                )
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                put_back(body, static_slot, s)

    @wp.func
    def count_turns(body: int, s: wp.ref[Solver]):
        """Remembers what orientations do not tell: turns of the body's joint in the step, and the
        coordinates of a gimbal."""
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        if wp.static(effects.kinds.gimbals):
            if is_gimbal(s.joints, joint):
                for dof in range(s.joints.dof_start[joint + 1] - s.joints.dof_start[joint]):
                    known = s.tree.coordinate[s.tree.axis_start[body] + dof]
                    s.history.joint_angle[s.joints.dof_start[joint] + dof] = known
                return
        turn = full_turns(body, parent, s.work)
        if wp.length_sq(turn) > 0.0:
            sign, frame_p, frame_c = frames_of(joint, body, s.joints)
            q_p = anchor_rotation(s.tree, parent, frame_p)
            q_c = anchor_rotation(s.tree, body, frame_c)
            if wp.static(effects.flipped):
                q_p, q_c = in_joint_order(sign, q_p, q_c)
            linear = linear_count(s.joints, joint)
            for dof in range(linear, linear + angular_count(s.joints, joint)):
                about = advance(s.joints, joint, dof, q_p, q_c, wp.vec3(0.0), sign * turn)
                index = nonnegative(s.joints.dof_start[joint] + dof)
                s.history.joint_angle[index] = s.history.joint_angle[index] + about

    @wp.func
    def take_allowed(first: int, s: wp.ref[Solver]):
        """Of the two solutions for the angles of a gimbal whose pose was written since the last
        step, takes the one within the limits; they stand from ``first`` on."""
        if wp.static(effects.kinds.skew):
            if joint_rows.is_skew(s.joints, first):
                return
        angles = wp.vec3()
        for i in range(3):
            angles[i] = wp.float32(s.history.joint_angle[first + i])
        other = joint_rows.other_solution(angles)
        least = joint_rows.beyond_limits(s.joints, first, other)
        if least < joint_rows.beyond_limits(s.joints, first, angles):
            for i in range(3):
                s.history.joint_angle[first + i] = wp.float64(other[i])

    @wp.func(inline=effects.inline)
    def begin_coordinates(
        body: int,
        sign: float,
        frame_p: wp.transform,
        frame_c: wp.transform,
        q_p: wp.quat,
        q_c: wp.quat,
        scale: WorldScale,
        s: wp.ref[Solver],
    ) -> bool:
        """Coordinates of the body's joint at the start of the step, by its anchors.

        Returns whether one is beyond its limits by more than rounding.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        static_slot = scale.static_slot
        is_open = bool(False)
        is_carried = (
            parent != static_slot and s.work.inv_mass[parent] == 0.0 and s.tree.is_left[body]
        )
        start = s.joints.dof_start[joint]
        read_coordinates(
            body,
            sign,
            frame_p,
            frame_c,
            q_p,
            q_c,
            start,
            wp.vec3(0.0),
            s.history.joint_angle,
            s.history.joint_angle,
            static_slot,
            s,
        )
        if wp.static(effects.kinds.gimbals):
            if is_gimbal(s.joints, joint):
                if wp.static(effects.limits):
                    if not s.tree.is_left[body]:
                        take_allowed(start + linear_count(s.joints, joint), s)
                # what the pose has beyond the angles was there before
                tilt = tilt_beyond(body, start, s)
                none = wp.vec3(0.0)
                s.tree.misfit[body] = s.tree.misfit[body] + wp.spatial_vector(none, tilt)
        for dof in range(linear_count(s.joints, joint) + angular_count(s.joints, joint)):
            index = start + dof
            q = s.history.joint_angle[index]
            at = wp.float32(q)
            rounding = s.tree.rounding[body] + 2.0 * ROUNDING * wp.abs(at)
            if dof >= linear_count(s.joints, joint):
                rounding = 2.0 * ROUNDING * (2.0 + wp.abs(at))
            if wp.static(effects.hard_limits):
                lower = s.joints.limit_lower[index] - rounding
                if at < lower or at > s.joints.limit_upper[index] + rounding:
                    is_open = True
            if is_carried and s.joints.type[joint] != BALL:
                # a kinematic parent has been put elsewhere since: what damps feels its motion
                q = s.tree.coordinate[s.tree.axis_start[body] + dof]
            if wp.static(effects.second_order):
                q = begin_axis(index, q, scale, s.history.coordinate)
            if wp.static(effects.joint_friction):
                # what rounding moves, friction brings back; a ball's coordinates start anew
                drift = wp.float32(wp.abs(q - s.history.held_at[index]))
                is_off = drift > rounding + 2.0 * ROUNDING * wp.length(s.work.com[body])
                is_off = is_off or s.joints.type[joint] == BALL
                if is_off or s.history.piece[index][2] != 0:
                    s.history.held_at[index] = q
            s.tree.start_coordinate[s.tree.axis_start[body] + dof] = q
        return is_open

    @wp.func(inline=effects.inline)
    def measure_start(body: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Misfit and coordinates of the body's joint at the start of the step.

        Expects what :func:`measure_misfit` does. Returns whether the misfit, or a coordinate beyond
        its limits, is more than rounding.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        static_slot = scale.static_slot
        sign, frame_p, frame_c, q_p, q_c = anchors_of(joint, body, parent, s)
        is_open = measure_misfit(body, sign, frame_p, frame_c, q_p, q_c, static_slot, s)
        if wp.static(effects.coordinates):
            if begin_coordinates(body, sign, frame_p, frame_c, q_p, q_c, scale, s):
                is_open = True
        return is_open

    @wp.func(inline=effects.inline)
    def measure_velocity(
        joint: int,
        static_slot: int,
        velocity_c: wp.spatial_vector,
        velocity_p: wp.spatial_vector,
        s: wp.ref[Solver],
    ):
        """Velocities of a joint's coordinates by those of its child and its parent, at their
        present poses."""
        child = s.joints.child[joint]
        parent = s.joints.parent[joint]
        frame_c = s.joints.child_frame[joint]
        arm = anchor_arm(child, frame_c, static_slot, s)
        relative = algebra.carried(arm, velocity_c)
        if parent >= 0:
            # of the parent where the child's anchor is
            span = arm + (s.work.com[child] - s.work.com[parent])
            span += joint_shift(s.work, child) - joint_shift(s.work, parent)
            relative -= algebra.carried(span, velocity_p)
        slot = wp.where(parent < 0, static_slot, parent)
        q_p = anchor_rotation(s.tree, slot, s.joints.parent_frame[joint])
        q_c = anchor_rotation(s.tree, child, frame_c)
        known = known_angles(s.joints, joint, s.history.joint_angle, s.joints.dof_start[joint])
        for dof in range(linear_count(s.joints, joint) + angular_count(s.joints, joint)):
            s.tree.start_velocity[s.joints.dof_start[joint] + dof] = velocity(
                s.joints, joint, dof, q_p, q_c, known, relative
            )

    @wp.func(inline=effects.inline)
    def measure_moved(body: int, static_slot: int, s: wp.ref[Solver]):
        """Coordinates of the body's joint after the increments, by those at the start."""
        measure_coordinates(
            body,
            s.tree.axis_start[body],
            full_turns(body, s.tree.parent[body], s.work),
            s.tree.start_coordinate,
            static_slot,
            s,
        )

    @wp.func
    def follow_hinge(body: int, s: wp.ref[Solver]) -> bool:
        """Angle of the body's hinge, by that at the start and how far it has turned since.

        Returns false, and leaves the angle as it is, if the joint is no hinge or has turned far, or
        if its parent is kinematic and has been put ahead.
        """
        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        if angular_count(s.joints, joint) != 1 or linear_count(s.joints, joint) != 0:
            return False
        sign, frame_p, _frame_c = frames_of(joint, body, s.joints)
        if sign < 0.0 or is_put(parent, s.work):
            return False
        if wp.length_sq(full_turns(body, parent, s.work)) > 0.0:
            return False
        index = nonnegative(s.joints.dof_start[joint])
        axis = wp.quat_rotate(anchor_rotation(s.tree, parent, frame_p), s.joints.axis[index])
        turn = relative_turn(body, parent, s.tree)
        sine = wp.dot(axis, wp.vec3(turn[0], turn[1], turn[2]))
        x = sine * sine
        if x > HINGE_NEAR * HINGE_NEAR:
            return False
        # 2 asin(sine), by a series that is exact in float32
        series = wp.static(3 / 20) + x * (wp.static(5 / 56) + x * wp.static(35 / 576))
        angle = sine * (2.0 + x * (wp.static(1 / 3) + x * series))
        s.tree.coordinate[s.tree.axis_start[body]] = s.history.joint_angle[index] + wp.float64(
            angle
        )
        return True

    @wp.func
    def measure_guess(body: int, static_slot: int, s: wp.ref[Solver]):
        """Coordinates of the body's joint where the guess of the increments has the bodies."""
        if wp.static(1 in effects.kinds.angular):
            if follow_hinge(body, s):
                return
        measure_moved(body, static_slot, s)

    @wp.func(inline=effects.inline)
    def eliminate(
        body: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Reduces the body's block and wrench by its joint's axes and hands them to the parent.

        Returns how far off the geometric stiffness may be, as a share of the block.
        """
        static_slot = s.work.inv_mass.shape[0] - 1
        wrench = gather(body, has_dual, recovery, slop, h, step, s)
        inv_h2 = 1.0 / (h * h)
        h_ll = wp.diag(wp.vec3(s.model.mass[body] * inv_h2)) + s.tree.h_ll[body]
        h_al = s.tree.h_al[body]
        h_aa = s.work.inertia[body] * inv_h2 + s.tree.h_aa[body]
        if wp.static(effects.drag):
            h_ll += s.work.drag[body].ll / h
            h_al += s.work.drag[body].al / h
            h_aa += s.work.drag[body].aa / h
        if wp.static(effects.contact or effects.loops):
            if s.tree.is_touched[body]:
                h_ll = s.tree.own_ll[body] + s.tree.h_ll[body]
                h_al = s.tree.own_al[body] + s.tree.h_al[body]
                h_aa = s.tree.own_aa[body] + s.tree.h_aa[body]
        if wp.static(effects.cables):
            h_ll += s.tree.cables.ll[body]
            h_al += s.tree.cables.al[body]
            h_aa += s.tree.cables.aa[body]
        if wp.static(effects.closures and effects.loops):
            held, held_aa = held_by_loops(body, s)
            h_aa += held_aa
        if wp.static(effects.tilting):
            # the antisymmetric part stays in memory, out of the way of all that is not fast
            is_fast = s.tree.is_fast[body]
            if is_fast:
                s.tree.n_aa[body] = s.tree.n_aa[body] - wp.skew(s.work.spin_momentum[body]) / h
        push = wrench + s.tree.push[body]
        load = wrench + s.tree.load[body]
        if wp.static(effects.closures and effects.loops):
            load += held
        s.tree.h_ll[body] = wp.mat33(0.0)
        s.tree.h_al[body] = wp.mat33(0.0)
        s.tree.h_aa[body] = wp.mat33(0.0)
        s.tree.push[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        s.tree.load[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        if wp.static(effects.closures):
            softness = softness_of(not has_dual)
            h_ll, h_al, h_aa, push = end_rows(
                body, h_ll, h_al, h_aa, push, softness, s.tree.closures
            )
        if not is_linked(body, s):
            if wp.static(effects.tilting):
                if is_fast:
                    push = push_tilting_root(body, h_ll, h_al, h_aa, push, s.tree)
            curved = float(0.0)
            if wp.static(effects.spatial_tendons):
                bound = s.tree.tendons.root_curvature[body]
                for k in range(3):
                    curved = wp.max(curved, bound[k] / (h_ll[k, k] + bound[k]))
                    curved = wp.max(curved, bound[3 + k] / (h_aa[k, k] + bound[3 + k]))
                h_ll += wp.diag(wp.spatial_top(bound))
                h_aa += wp.diag(wp.spatial_bottom(bound))
            factor = factor_block(h_ll, h_al, h_aa)
            s.work.factor[body] = factor
            s.tree.update[body] = half_solve(factor, wp.spatial_top(push), wp.spatial_bottom(push))
            if wp.static(effects.closures):
                meet_root(body, s.work, s.tree)
            if wp.static(effects.tilting):
                if is_fast:
                    forget_tilting(body, s.tree)
            return curved

        joint = nonnegative(s.tree.joint[body])
        parent = nonnegative(s.tree.parent[body])
        sign, frame_p, frame_c, q_p, q_c = anchors_of(joint, body, parent, s)
        arm_p = anchor_arm(parent, frame_p, static_slot, s)
        arm_c = anchor_arm(body, frame_c, static_slot, s)
        # The sweeps leave the misfit alone. What the joint opens beside it is read off the
        # increments, which round less than arms and axes do.
        kept = wp.where(recovery > 0.0, 0.0, 1.0) * s.tree.misfit[body]
        is_new = recovery == 0.0 and not is_put(parent, s.work)
        left = wp.vec3(0.0)
        if linear_count(s.joints, joint) == 0 and not is_put(parent, s.work):
            left = anchor_shift(body, parent, arm_c, arm_p, s)
            left += wp.spatial_top(s.tree.misfit[body] - kept)
        else:
            offset = anchor_offset(s.tree.apart[body], s.work, body, parent, arm_c, arm_p)
            misfit = linear_misfit(s.joints, joint, q_p, offset)
            left = misfit - wp.spatial_top(kept)
            if is_new:
                shift = anchor_shift(body, parent, arm_c, arm_p, s)
                holder = wp.where(sign < 0.0, body, parent)
                left = locked_shift(s.joints, joint, q_p, s.tree.swing[holder], shift, offset)
            arm_p += offset - misfit
        tilt = wp.vec3(0.0)
        if is_new:
            turn = relative_turn(body, parent, s.tree)
            if wp.static(effects.flipped):
                if sign < 0.0:
                    turn = wp.quat_inverse(turn)
            tilt = sign * locked_turn(s.joints, joint, q_p, q_c, turn)
        else:
            tilt = sign * angular_misfit(s.joints, joint, q_p, q_c) - wp.spatial_bottom(kept)
        known = wp.vec3(0.0)
        if wp.static(effects.kinds.gimbals):
            known = known_angles(s.joints, joint, s.tree.coordinate, s.tree.axis_start[body])
            if is_gimbal(s.joints, joint):
                tilt = wp.vec3(0.0)
                if is_led(s.joints, joint, known):
                    tilt = sign * gimbal_tilt(s.joints, joint, q_p, q_c, known)
                    tilt -= wp.spatial_bottom(kept)
        closing = wp.spatial_vector(wp.cross(tilt, arm_c) - left, -tilt)
        span = arm_p - arm_c
        s.tree.closing[body] = closing
        s.tree.span[body] = span

        force = -wp.spatial_top(load)
        mismatch = float(0.0)
        if not has_dual:
            # the guess of the first iteration tells the force less well than the last step did
            reach = wp.length(arm_c)
            change = reach * wp.length(force - s.history.joint_force[body])
            force = s.history.joint_force[body]
            resistance = inv_h2 * wp.trace(s.work.inertia[body]) + reach * wp.length(force)
            mismatch = change / resistance
        s.history.joint_force[body] = -wp.spatial_top(load)
        h_aa += algebra.geometric_stiffness(force, arm_c)
        h_aa += algebra.buckling(force, arm_c, s.model.mass[body], s.work.inertia[body], h)

        push -= algebra.times_block(h_ll, h_al, h_aa, closing)
        if wp.static(effects.tilting):
            if is_fast:
                push -= times_tilting(body, closing, s.tree)
        linear = linear_count(s.joints, joint)
        dofs = linear + angular_count(s.joints, joint)
        first_axis = wp.vec3(0.0)
        turn_away = wp.vec3(0.0)
        rest_away = wp.vec3(0.0)
        if wp.static(effects.kinds.balls and effects.drives):
            if s.joints.type[joint] == BALL:
                turn_away = joint_rows.ball_away(step.control.target_q, s.joints, joint, q_p, q_c)
        if wp.static(effects.kinds.balls and effects.springs):
            if s.joints.type[joint] == BALL:
                rest_away = joint_rows.ball_away(s.joints.rest_q, s.joints, joint, q_p, q_c)
        rod_torque = wp.vec3(0.0)
        rod_stiffness = wp.vec3(0.0)
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                response = wp.vec3(0.0)
                stiff = wp.vec3(0.0)
                for dof in range(3):
                    k = s.tree.axis_start[body] + 3 + dof
                    q = s.tree.coordinate[k]
                    pull, stiffness = axis_rows.rod_response(
                        s.joints,
                        s.joints.dof_start[joint] + 3 + dof,
                        wp.float32(q),
                        wp.float32(q - s.tree.start_coordinate[k]),
                        h,
                    )
                    if wp.static(effects.dahl):
                        moved = wp.float32(q - s.tree.start_coordinate[k])
                        resisting, slope, _most = dahl_response(
                            joint, dof, wp.float32(q), moved, s.joints, s.history
                        )
                        pull += resisting
                        stiffness += slope
                    response[dof] = pull
                    stiff[dof] = stiffness
                rod_torque = sign * joint_rows.rod_torque(q_p, q_c, response)
                rod_stiffness = joint_rows.rod_stiffness(q_p, q_c, stiff)
        if wp.static(effects.light_roots):
            # the directions along which the joint holds, and what it carries along the others
            shifting = wp.identity(n=3, dtype=float)
            turning = wp.identity(n=3, dtype=float)
            thrust = wp.vec3(0.0)
            torque = wp.vec3(0.0)
        is_free = bool(False)
        if wp.static(effects.free_balls):
            is_free = s.joints.type[joint] == BALL
            if wp.static(effects.tilting):
                is_free = is_free and not is_fast
            if is_free:
                first = s.joints.dof_start[joint]
                reaction = wp.vec3(
                    step.control.joint_f[first] + ahead_along(first, s.history),
                    step.control.joint_f[first + 1] + ahead_along(first + 1, s.history),
                    step.control.joint_f[first + 2] + ahead_along(first + 2, s.history),
                )
                reaction = sign * wp.quat_rotate(q_p, reaction)
                own = inv_h2 / wp.trace(s.model.inv_inertia[body])
                h_ll, push = free_ball(
                    s.tree.axis_start[body], arm_c, reaction, own, h_ll, h_al, h_aa, push, s.tree
                )
                h_al = wp.mat33(0.0)
                h_aa = wp.mat33(0.0)
                dofs = 0
        for dof in range(dofs):
            axis = TreeAxis()
            if dof < linear:
                axis.linear = sign * linear_axis(s.joints, joint, dof, q_p)
            else:
                axis.angular = sign * angular_axis(s.joints, joint, dof - linear, q_p, q_c, known)
                axis.linear = wp.cross(arm_c, axis.angular)
            axis.force = h_ll * axis.linear + wp.transpose(h_al) * axis.angular
            axis.torque = h_al * axis.linear + h_aa * axis.angular
            pivot = wp.dot(axis.linear, axis.force) + wp.dot(axis.angular, axis.torque)
            # In exact arithmetic no coordinate meets less than the body's own inertia; what heavy
            # children add and take away again rounds. (Of an Euler axis that is nearly parallel to
            # the first only the part across it counts.)
            own = float(s.model.mass[body])
            if dof == linear:
                first_axis = axis.angular
            if dof >= linear:
                across = float(1.0)
                if dof > linear:
                    along = wp.dot(axis.angular, first_axis)
                    across = wp.max(1.0 - along * along, 0.0) + 1.0e-6
                own = across / wp.trace(s.model.inv_inertia[body])
            pivot = wp.max(pivot, inv_h2 * own)
            inert = pivot
            axis.push = wp.dot(axis.linear, wp.spatial_top(push)) + wp.dot(
                axis.angular, wp.spatial_bottom(push)
            )
            k = nonnegative(s.tree.axis_start[body] + dof)
            index = nonnegative(s.joints.dof_start[joint] + dof)
            if wp.static(effects.kinds.gimbals):
                if dof == linear + 2:
                    # At the pole of a gimbal nothing else but armature resists how the outer axes
                    # turn against each other.
                    along = wp.dot(axis.angular, first_axis)
                    lean = wp.max(1.0 - (1.0 - along * along) / NEAR_POLE, 0.0)
                    drag = (
                        wp.static(POLE_DRAG) * lean * inv_h2 / wp.trace(s.model.inv_inertia[body])
                    )
                    if wp.static(effects.armature):
                        drag = wp.max(drag - inv_h2 * s.joints.armature[index], 0.0)
                    moved = wp.float32(s.tree.coordinate[k] - s.tree.start_coordinate[k])
                    axis.push -= drag * moved
                    pivot += drag
            pushed = float(0.0)
            if s.joints.type[joint] != ROD:
                pushed = step.control.joint_f[index]
            axis.push += pushed + ahead_along(index, s.history)
            if wp.static(effects.coordinates):
                q = s.tree.coordinate[k]
                moved = wp.float32(q - s.tree.start_coordinate[k])
                start_velocity = float(0.0)
                if wp.static(effects.axis_rates):
                    start_velocity = s.tree.start_velocity[index]
                if s.joints.type[joint] != ROD:
                    pull, stiffness = linear_force(
                        s.joints,
                        step.control,
                        joint,
                        dof,
                        q,
                        moved,
                        start_velocity,
                        turn_away,
                        rest_away,
                        h,
                    )
                    axis.push += pull
                    pivot += stiffness
                if wp.static(effects.rods):
                    if s.joints.type[joint] == ROD:
                        pull, stiffness = axis_rows.rod_response(
                            s.joints, index, wp.float32(q), moved, h
                        )
                        if dof < linear:
                            axis.push += pull
                            pivot += stiffness
                        else:
                            axis.push += wp.dot(axis.angular, rod_torque)
                            pivot += rod_stiffness[dof - linear]
                if wp.static(effects.laws):
                    law = law_of(
                        s.joints,
                        step.control,
                        s.history,
                        joint,
                        dof,
                        q,
                        moved,
                        turn_away,
                        recovery,
                        h,
                    )
                    pull, stiffness = axis_rows.law_force(law)
                    axis.push += pull
                    pivot += stiffness
                    if axis_rows.is_held(law):
                        axis.pivot = pivot
                        axis.step = axis_rows.held_step(law)
                    s.tree.laws[k] = law
            if wp.static(effects.second_order):
                inertia = inert
                if wp.static(effects.armature):
                    inertia += inv_h2 * s.joints.armature[index]
                bound_force = float(0.0)
                if wp.static(effects.effort_limits):
                    bound_force = s.tree.laws[k].drive
                keep_input(
                    index,
                    inertia,
                    wp.where(axis.pivot > 0.0, 0.0, inertia / pivot),
                    bound_force,
                    inv_h2,
                    s.history,
                )
            if wp.static(effects.light_roots):
                if pivot == inert and axis.pivot == 0.0:
                    if wp.static(effects.laws):
                        pushed += pull  # of friction that slips, or a drive at its limit
                    if dof < linear:
                        shifting, thrust = algebra.freed(shifting, thrust, axis.linear, pushed)
                    else:
                        turning, torque = algebra.freed(turning, torque, axis.angular, pushed)
            if wp.static(effects.spatial_tendons):
                bent = float(s.tree.tendons.curvature[k])
                pivot += bent
                mismatch = wp.max(mismatch, bent / pivot)
            if axis.pivot > 0.0:
                push -= axis.step * wp.spatial_vector(axis.force, axis.torque)
            else:
                axis.inv_pivot = 1.0 / pivot
                h_ll, h_al, h_aa, push = algebra.eliminated(axis, h_ll, h_al, h_aa, push)
            if wp.static(effects.tilting):
                if is_fast:
                    h_ll, h_al, h_aa, tilting = eliminate_tilting(
                        body, axis, h_ll, h_al, h_aa, s.tree
                    )
                    axis_step = wp.where(axis.pivot > 0.0, axis.step, axis.inv_pivot * axis.push)
                    push -= axis_step * tilting
                    axis.force -= wp.spatial_top(tilting)
                    axis.torque -= wp.spatial_bottom(tilting)
            s.tree.axes[k] = axis

        if wp.static(effects.closures):
            meet_axes(body, dofs, s.work, s.tree)
        if s.work.inv_mass[parent] > 0.0:
            arm = span
            if is_free:
                arm = arm_p
            elif wp.static(effects.light_roots):
                h_ll, h_al, h_aa = algebra.span_block(-arm_c, h_ll, h_al, h_aa)
                h_ll, h_al, h_aa = algebra.projected(shifting, turning, h_ll, h_al, h_aa)
                h_ll = algebra.not_less_than_rounding(shifting, h_ll)
                h_aa = algebra.not_less_than_rounding(turning, h_aa)
                push = algebra.handed_down(-arm_c, push)
                push = wp.spatial_vector(
                    shifting * wp.spatial_top(push) + thrust,
                    turning * wp.spatial_bottom(push) + torque,
                )
                if wp.static(effects.tilting):
                    if is_fast:
                        project_tilting(body, shifting, turning, arm_c, s.tree)
                arm = arm_p
            h_ll, h_al, h_aa = algebra.span_block(arm, h_ll, h_al, h_aa)
            h_aa += algebra.geometric_stiffness(-force, arm_p)
            h_aa += algebra.buckling(-force, arm_p, s.model.mass[parent], s.work.inertia[parent], h)
            s.tree.h_ll[parent] = s.tree.h_ll[parent] + h_ll
            s.tree.h_al[parent] = s.tree.h_al[parent] + h_al
            s.tree.h_aa[parent] = s.tree.h_aa[parent] + h_aa
            if wp.static(effects.tilting):
                if is_fast:
                    hand_down_tilting(body, parent, arm, s.tree)
            s.tree.push[parent] = s.tree.push[parent] + algebra.handed_down(arm, push)
            s.tree.load[parent] = s.tree.load[parent] + algebra.handed_down(span, load)
        if wp.static(effects.tilting):
            if is_fast:
                forget_tilting(body, s.tree)
        return mismatch

    @wp.func(inline=effects.inline)
    def substitute(body: int, is_searched: bool, h: float, s: wp.ref[Solver]):
        """Finds the update of the body by that of its parent.

        Where the update ``is_searched`` along, it is that of the assumed pieces.

        Returns how many of its axes are off the pieces of their laws that elimination assumed, the
        body's share of the curvature d^T H d along the update d of the tree, and the work of what
        holds its axes.
        """
        wrong = int(0)
        curvature = float(0.0)
        held_work = float(0.0)
        pushed = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        if wp.static(effects.closures):
            pushed = rows_push(body, s.tree.closures)
        if is_linked(body, s):
            joint = s.tree.joint[body]
            parent = nonnegative(s.tree.parent[body])
            update = algebra.carried(s.tree.span[body], s.tree.update[parent])
            dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
            for i in range(dofs):
                k = nonnegative(s.tree.axis_start[body] + dofs - 1 - i)
                axis = s.tree.axes[k]
                if wp.static(effects.closures):
                    axis.push -= pushed[dofs - 1 - i]
                met = wp.dot(axis.force, wp.spatial_top(update)) + wp.dot(
                    axis.torque, wp.spatial_bottom(update)
                )
                q = axis.inv_pivot * (axis.push - met)
                if wp.static(effects.laws):
                    law = s.tree.laws[k]
                    if axis.pivot > 0.0:
                        q = axis.step
                    held = axis.pivot * q + met - axis.push
                    if wp.static(effects.bounded_axes):
                        if axis.pivot > 0.0:
                            curvature += q * (axis.pivot * q + 2.0 * met)
                            held_work += held * q
                        else:
                            curvature += axis.inv_pivot * axis.push * axis.push
                            if not is_searched:
                                q = axis_rows.free_step(law, q, axis.inv_pivot)
                    law.next = next_piece(law, q, held)
                    s.tree.laws[k].next = law.next
                    if not (law.next == law.piece):
                        wrong += 1
                    if wp.static(effects.stops):
                        if not axis_rows.is_stopped(law):
                            # not beyond a stop, which holds it from the next sweep on
                            q = wp.clamp(q, law.lower, law.upper)
                if wp.static(effects.coordinates):
                    at = s.tree.coordinate[k]
                    s.tree.coordinate[k] = at + wp.float64(q)
                    if wp.static(effects.kinds.gimbals or effects.bounded_axes):
                        s.tree.axes[k].step = q
                    if wp.static(effects.limits and effects.compliance):
                        index = s.joints.dof_start[joint] + dofs - 1 - i
                        if wp.static(effects.limit_impedance):
                            moved = wp.float32(at - s.tree.start_coordinate[k])
                            rate = s.tree.start_velocity[index]
                            _f, k_then = compliant_limit(
                                s.joints, index, wp.float32(at), moved, rate, h
                            )
                            _f, k_now = compliant_limit(
                                s.joints, index, wp.float32(at) + q, moved + q, rate, h
                            )
                            if (k_then > 0.0) != (k_now > 0.0):
                                wrong += 1
                        else:
                            side = axis_rows.limit_side(s.joints, index, wp.float32(at))
                            if side != axis_rows.limit_side(s.joints, index, wp.float32(at) + q):
                                wrong += 1
                update += q * wp.spatial_vector(axis.linear, axis.angular)
            s.tree.update[body] = update + s.tree.closing[body]
        else:
            half = s.tree.update[body] - pushed
            if wp.static(effects.bounded_axes):
                curvature = wp.dot(half, half)
            s.tree.update[body] = other_half(s.work.factor[body], half)
        if wp.static(effects.closures):
            find_multipliers(body, s.tree.update[body], s.tree.closures)
        return wrong, curvature, held_work

    @wp.func
    def least_energy(
        first: int, end: int, curvature: float, held_work: float, s: wp.ref[Solver]
    ) -> float:
        """Share of a tree's update at which the energy along it is least; limits are those there.

        The energy is convex where only drives, their limits and friction are not quadratic: its
        slope is that of the model, (s - 1) d^T H d, but for those that are not on their assumed
        pieces. So the iteration goes downhill (Newton's method with an exact search, as in MuJoCo's
        solver).
        """
        share = float(1.0)
        for search in range(SEARCHES):
            slope = (share - 1.0) * curvature + held_work
            for i in range(first, end):
                body = s.worlds.bodies[i]
                if is_linked(body, s):
                    joint = s.tree.joint[body]
                    start = s.tree.axis_start[body]
                    dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
                    for k in range(start, start + dofs):
                        law = s.tree.laws[k]
                        step = s.tree.axes[k].step
                        slope += step * axis_rows.excess_force(law, step, share)
                        s.tree.laws[k].next = axis_rows.piece_before(law, share * step, share)
            if slope <= 0.0:
                if search == 0:
                    return 1.0
                share += 1.0 / float(1 << (search + 1))
            else:
                share -= 1.0 / float(1 << (search + 1))
        return share

    @wp.func(inline=effects.inline)
    def move(body: int, share: float, h: float, s: wp.ref[Solver]):
        """Moves the body by a share of its update."""
        update = share * s.tree.update[body]
        increment = s.work.increment[body]
        turn = s.tree.turn[body]
        before = wp.spatial_bottom(increment) - turn
        further = algebra.combined_with(before, wp.spatial_bottom(update))
        rest = before + further
        moved = wp.spatial_vector(wp.spatial_top(increment) + wp.spatial_top(update), turn + rest)
        s.work.increment[body] = moved
        if wp.static(effects.carried_rounding):
            if is_short(h):
                update = wp.spatial_vector(wp.spatial_top(update), further)
                s.work.rounded[body] = update - (moved - increment)
        turn_by(body, rest, s.tree)
        if wp.static(effects.coordinates):
            # summing steps misses the square of the turn
            if is_linked(body, s) and (
                share < 1.0 or wp.length_sq(wp.spatial_bottom(update)) > FAR * FAR
            ):
                static_slot = s.work.inv_mass.shape[0] - 1
                if wp.static(effects.kinds.gimbals):
                    joint = s.tree.joint[body]
                    if is_gimbal(s.joints, joint):
                        # its pose does not tell all of its coordinates: what its axes turned does
                        first = s.tree.axis_start[body]
                        dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
                        for k in range(first, first + dofs):
                            back = (1.0 - share) * s.tree.axes[k].step
                            s.tree.coordinate[k] = s.tree.coordinate[k] - wp.float64(back)
                        measure_coordinates(
                            body, first, wp.vec3(0.0), s.tree.coordinate, static_slot, s
                        )
                        return
                measure_moved(body, static_slot, s)

    @wp.func
    def gimbal_step(body: int, s: wp.ref[Solver]) -> float:
        """Square of the largest step of the angles of the body's joint, if it is a gimbal."""
        largest = float(0.0)
        if is_linked(body, s):
            joint = s.tree.joint[body]
            if is_gimbal(s.joints, joint):
                first = s.tree.axis_start[body] + linear_count(s.joints, joint)
                for k in range(first, first + 3):
                    largest = wp.max(largest, s.tree.axes[k].step * s.tree.axes[k].step)
        return largest

    @wp.func
    def take_pieces(first: int, end: int, wrong: int, has_dual: bool, s: wp.ref[Solver]) -> bool:
        """Puts the ``wrong`` axes of a tree on their next pieces: all of them, unless that has
        not led to fewer for a while. Limits of drives are then searched along the update.

        Returns whether a stop is to hold that did not, or to let go.
        """
        is_stopping = bool(False)
        root = body_at(first, s.worlds)
        if not has_dual or wrong < s.tree.fewest[root]:
            s.tree.fewest[root] = wrong
            s.tree.patience[root] = PATIENCE
        else:
            s.tree.patience[root] = s.tree.patience[root] - 1
        left = int(wrong)
        if s.tree.patience[root] < 0:
            left = 1
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if is_linked(body, s):
                joint = s.tree.joint[body]
                for dof in range(linear_count(s.joints, joint) + angular_count(s.joints, joint)):
                    index = nonnegative(s.joints.dof_start[joint] + dof)
                    law = s.tree.laws[s.tree.axis_start[body] + dof]
                    piece = law.piece
                    if law.next[0] != piece[0]:
                        is_stopping = True
                    if wp.static(effects.bounded_axes):
                        piece[1] = law.next[1]
                    if left > 0 and not (law.next == piece):
                        piece = law.next
                        left -= 1
                    s.history.piece[index] = piece
        return is_stopping

    @wp.func
    def sweep_tree(
        first: int,
        end: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Moves the bodies of a tree to the minimum of their quadratic model.

        Returns the square of how far the next iteration would move one of them [m^2]: zero where
        the rounding of the poses hides it.
        """
        if wp.static(effects.closures):
            begin_rows(first, end, recovery, h, s)
        mismatch = float(0.0)
        for i in range(end - first):
            body = body_at(end - 1 - i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                off = eliminate(body, has_dual, recovery, slop, h, step, s)
                mismatch = wp.max(mismatch, off)
        if wp.static(effects.closures):
            solve_ground(first, softness_of(not has_dual), s.tree.closures)
        # Newton's method leaves half of the angle times the update, the angle of the step or, where
        # a stop takes it back, of the update; or what the joint forces of the last step are off by
        # in the first iteration. Contacts converge by a factor.
        largest = float(4.0 * mismatch * mismatch)
        is_newton = bool(True)
        is_searched = bool(False)
        if wp.static(effects.bounded_axes):
            is_searched = has_dual and s.tree.patience[body_at(first, s.worlds)] < PATIENCE
        wrong = int(0)
        curvature = float(0.0)
        held_work = float(0.0)
        turned_most = float(0.0)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                misplaced, curved, worked = substitute(body, is_searched, h, s)
                wrong += misplaced
                if wp.static(effects.bounded_axes):
                    curvature += curved
                    held_work += worked
                turned_most = wp.max(
                    turned_most, wp.length_sq(wp.spatial_bottom(s.tree.update[body]))
                )
                if wp.static(effects.kinds.gimbals):
                    turned_most = wp.max(turned_most, gimbal_step(body, s))
        largest = wp.max(largest, turned_most)
        share = float(1.0)
        if turned_most > MOST_TURN * MOST_TURN:
            share = MOST_TURN / wp.sqrt(turned_most)
        if wp.static(effects.bounded_axes):
            if is_searched and wrong > 0:
                least = least_energy(first, end, curvature, held_work, s)
                share = wp.min(share, least)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                move(body, share, h, s)
                turn = wp.spatial_bottom(s.work.increment[body])
                largest = wp.max(largest, wp.length_sq(turn))
                if wp.static(effects.kinds.gimbals):
                    largest = wp.max(largest, gimbal_step(body, s))
                if wp.static(effects.contact):
                    if has_rows(s.rows, body):
                        is_newton = False
                if wp.static(effects.loops):
                    if has_soft_loops(body, s.loops):
                        is_newton = False
                if wp.static(effects.cables):
                    if s.tree.cables.pulled[body]:
                        is_newton = False
        if wp.static(effects.closures and effects.loops):
            off = keep_forces(first, not has_dual and recovery == 0.0, h, s)
            largest = wp.max(largest, 4.0 * off * off)
        farthest = float(0.0)
        if largest == wp.inf:
            farthest = wp.inf
        if wrong > 0:
            farthest = wp.inf
            if wp.static(effects.laws):
                if take_pieces(first, end, wrong, has_dual, s):
                    farthest = STOPPING
        if wp.static(effects.equalities):
            # what a line misses of a curve, and the next iteration finds
            farthest = wp.max(farthest, missed_by_lines(first, recovery, s))
        if wp.static(effects.tendons):
            off_by = settle_tendons(first, recovery, h, s)
            farthest = wp.max(farthest, off_by)
        if wp.static(effects.closures):
            if s.tree.closures.block_of[first] >= 0:
                largest = wp.max(largest, wp.static(4.0 * MISSED * MISSED))
        left = wp.where(is_newton, wp.min(0.25 * largest, 1.0), 1.0)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                shift = wp.spatial_top(s.tree.update[body])
                turn = wp.spatial_bottom(s.tree.update[body])
                turned = wp.dot(turn, s.work.inertia[body] * turn) * s.work.inv_mass[body]
                moved = left * (wp.dot(shift, shift) + turned)
                hidden = s.tree.rounding[body]
                if not is_newton and slop > 0.0:
                    # multipliers of contacts build up by moves that small
                    hidden = wp.min(hidden, HIDDEN * slop)
                if moved > hidden * hidden:
                    farthest = wp.max(farthest, moved)
        return farthest

    return TreeFunctions(
        measure_start,
        measure_velocity,
        measure_guess,
        count_turns,
        align_spins,
        sweep_tree,
        put_together,
        stop_coordinates,
    )
