# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How blocks stand at the start of a step: their joints, and the guess of their increments.

Joints outside of the trees are measured once the blocks are. What a single joint of a tree is
measured by is in :mod:`.step.joint_start`.
"""

import math

import warp as wp

from ..algebra.so3 import exp_quat
from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from .anchors import ROUNDING, is_linked, parent_slot
from .beginning import is_tree, make_coasting, make_is_reached
from .bodies import body_at
from .loops import other_end
from .rotations import begin_turn
from .slopes import begin_axis, make_inputs

UNKNOWN = wp.constant(math.inf)
"""Velocity of a joint's coordinate that no step has followed: disabled, or without armature."""


def make_begin_armature(effects: Effects, measure_velocity: wp.Function) -> wp.Function:
    """Device function: how fast the coordinates of a joint change at the start of the step.

    ``measure_velocity`` reads that off the velocities of its bodies.
    """

    @wp.func
    def begin_armature(
        joint: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ):
        """Velocities of a joint's coordinates at the start of the step.

        Where the last step left the bodies they are those of that step, and what has been done to
        the bodies' velocities since: the axes have turned in the step, and along them as they stand
        now its momenta are others.
        """
        first = s.joints.dof_start[joint]
        end = s.joints.dof_start[joint + 1]
        if first == end:
            return
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, scale.static_slot)
        velocity = body_qd[child]
        velocity_p = wp.spatial_vector()
        if parent != scale.static_slot:
            velocity_p = body_qd[parent]
        is_known = not wp.isinf(s.history.axis_velocity[first])
        is_known = is_known and (s.tree.is_left[child] or s.work.inv_mass[child] == 0.0)
        is_known = is_known and (s.tree.is_left[parent] or s.work.inv_mass[parent] == 0.0)
        if is_known:
            velocity -= s.history.joined_qd[joint, 0]
            velocity_p -= s.history.joined_qd[joint, 1]
        is_new = wp.length_sq(velocity) + wp.length_sq(velocity_p) > 0.0
        if is_new:
            measure_velocity(joint, scale.static_slot, velocity, velocity_p, s)
        for dof in range(first, end):
            rate = float(0.0)
            if is_new:
                rate = s.tree.start_velocity[dof]
            if is_known:
                rate += s.history.axis_velocity[dof]
            s.tree.start_velocity[dof] = rate
            if wp.static(effects.second_order):
                led = begin_axis(dof, wp.float64(rate), scale, s.history.rate)
                s.tree.start_velocity[dof] = wp.float32(led)

    return begin_armature


def make_parabola_of_tree(effects: Effects) -> wp.Function:
    """Device function: how much less far than by backward Euler a tree in flight falls."""

    @wp.func
    def is_tied(body: int, s: wp.ref[Solver]) -> bool:
        """Whether a joint ties the body to what no force moves."""
        if is_linked(body, s):
            if s.work.inv_mass[s.tree.parent[body]] == 0.0:
                return True
        if wp.static(effects.loops):
            for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                other = other_end(s.loops.items[k], s)
                if other < 0:
                    return True
                if s.work.inv_mass[other] == 0.0:
                    return True
        return False

    @wp.func
    def parabola_of_tree(first: int, end: int, s: wp.ref[Solver]) -> wp.vec3:
        """How much less far a tree falls that nothing touches [m]; none where it does not fly.

        Its COM goes along a parabola, as a body does that flies alone: by half of what forces add
        to the way that it would coast.
        """
        mass = float(0.0)
        pushed = wp.vec3(0.0)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] == 0.0 or is_tied(body, s):
                return wp.vec3(0.0)
            added = wp.spatial_top(s.work.target[body] - s.work.coasting[body])
            pushed += s.model.mass[body] * added
            mass += s.model.mass[body]
        return -(0.5 / mass) * pushed

    return parabola_of_tree


def make_block_start(
    effects: Effects,
    trees: Functions,
    begin_loop: wp.Function,
    begin_closures: wp.Function,
    begin_tendons: wp.Function,
) -> Functions:
    """Device functions that measure joints at the start of a step, and guess where it ends.

    Args:
        effects: What the kernel is compiled with.
        trees: Those of joints in trees.
        begin_loop: Device function that measures a joint outside of trees.
        begin_closures: Device function that measures the mimics of a block.
        begin_tendons: Device function that measures its tendons.
    """
    coasting_increment, is_reached = make_coasting(effects), make_is_reached(effects)
    measure_start, measure_guess = trees.measure_start, trees.measure_guess
    begin_armature = make_begin_armature(effects, trees.measure_velocity)
    inputs = make_inputs(effects)
    begin_inputs, resists_everywhere = inputs.begin_inputs, inputs.resists_everywhere
    may_be_exact = effects.second_order and (effects.drives or effects.pushed_axes)
    may_be_exact = may_be_exact and not effects.cables and not effects.tendons
    parabola_of_tree = make_parabola_of_tree(effects)
    may_fly = effects.second_order and not effects.pulled

    @wp.func(inline=effects.inline)
    def measure_blocks(
        first: int,
        end: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> bool:
        """Measures the joints of the trees of blocks at the start of the step.

        The blocks are those of the bodies from ``first`` to ``end``, whose increments are put aside
        until :func:`place_blocks`. Returns whether a joint is open.
        """
        h = scale.step
        is_open = bool(False)
        block_end = int(-1)
        is_free = bool(False)
        is_closed = bool(False)
        is_fast = bool(False)
        fall = wp.vec3(0.0)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            s.tree.rotation[body] = wp.transform_get_rotation(s.work.pose[body])
            # a pose that the user has changed has lost nothing
            s.tree.is_left[body] = s.work.pose[body] == s.history.left_q[body]
            if not s.tree.is_left[body]:
                s.history.lost[body] = wp.vec3(0.0)
            # the guess is put aside: joints are measured at the start first
            s.tree.update[body] = s.work.increment[body]
            s.work.increment[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            s.tree.turn[body] = wp.vec3(0.0)
            s.tree.swing[body] = wp.quat_identity()
            if block_end != s.worlds.block_end[i]:
                block_end = s.worlds.block_end[i]
                is_free = is_tree(i, block_end, body, s.tree)
                if wp.static(effects.closures):
                    is_closed = s.tree.closures.block_of[i] >= 0
                is_fast = bool(False)
                for k in range(i, block_end):
                    if wp.static(effects.tilting):
                        spin = s.work.spin_momentum[body_at(k, s.worlds)]
                        is_fast = is_fast or wp.length_sq(spin) > 0.0
                    is_free = is_free and not is_reached(body_at(k, s.worlds), s)
                if wp.static(may_fly):
                    fall = wp.vec3(0.0)
                    if is_free and scale.step == scale.h:
                        fall = parabola_of_tree(i, block_end, s)
            if wp.static(may_fly):
                if wp.length_sq(fall) > 0.0:
                    less = wp.spatial_vector(fall, wp.vec3(0.0))
                    s.work.lead[body] = s.work.lead[body] + less
                    s.work.coasting[body] = s.work.coasting[body] + less
                    s.work.target[body] = s.work.target[body] + less
            if wp.static(effects.second_order):
                # a taut rope, which nothing drives, is no such tree: see below
                is_exact = is_free and not is_closed
                if wp.static(not may_be_exact):
                    is_exact = False
                s.work.input_energy[body] = wp.where(is_exact, wp.inf, 0.0)
            if s.work.inv_mass[body] > 0.0:
                coasting = coasting_increment(s.work, body_qd, body, h)
                if is_free:
                    # keeps joints closed to the third order of h
                    s.tree.update[body] = coasting + (h * h) * s.history.acceleration[body]
                elif is_closed:
                    # Keeps a mechanism in its plane, where some of its rows say nothing. By the
                    # velocity alone: of second order ``coasting`` has half of what pushed the body
                    # in the last step and nothing of its weight, and would lift it off the ground.
                    s.tree.update[body] = scale.h * body_qd[body]
                if wp.static(effects.tilting):
                    s.tree.is_fast[body] = is_fast
                if wp.static(effects.spinning):
                    if wp.length_sq(s.work.spin_momentum[body]) > 0.0:
                        shift = wp.spatial_top(s.tree.update[body])
                        turn = wp.spatial_bottom(s.work.target[body])
                        s.tree.update[body] = wp.spatial_vector(shift, turn)
        given = float(0.0)
        is_driven = bool(True)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            radius = wp.sqrt(wp.trace(s.work.inertia[body]) * s.work.inv_mass[body])
            s.tree.rounding[body] = ROUNDING * radius
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                joint = s.tree.joint[body]
                given += begin_inputs(joint, scale, step, s)
                if wp.static(may_be_exact):
                    is_driven = is_driven and resists_everywhere(joint, s)
                if measure_start(body, scale, s):
                    is_open = True
                if wp.static(effects.axis_rates):
                    begin_armature(joint, scale, body_qd, s)
            if wp.static(effects.second_order):
                if i + 1 == s.worlds.block_end[i]:
                    k = int(i)
                    while k >= first and s.worlds.block_end[k] == i + 1:
                        other = body_at(k, s.worlds)
                        if not is_driven:
                            s.work.input_energy[other] = 0.0
                        s.work.input_energy[other] = s.work.input_energy[other] + given
                        k -= 1
                    given = 0.0
                    is_driven = True
        return is_open

    @wp.func
    def measure_loop(
        i: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> bool:
        """Measures a joint outside of the trees, once the blocks are; whether it is open."""
        joint = s.loops.joints[i]
        begin_inputs(joint, scale, step, s)
        if wp.static(effects.axis_rates):
            begin_armature(joint, scale, body_qd, s)
        return begin_loop(i, scale, s)

    @wp.func(inline=effects.inline)
    def place_blocks(first: int, end: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Puts blocks to the guess of their increments.

        Returns whether a mimic joint is open, or a tendon beyond its limits.
        """
        is_open = bool(False)
        if wp.static(effects.tendons):
            for i in range(first, end):
                if begin_tendons(i, scale, s):
                    is_open = True
        if wp.static(effects.mimics):
            for i in range(first, end):
                if begin_closures(i, s):
                    is_open = True
        for i in range(first, end):
            body = body_at(i, s.worlds)
            s.work.increment[body] = s.tree.update[body]
            if s.work.inv_mass[body] > 0.0:
                turn = wp.vec3(0.0)
                if wp.static(effects.spinning):
                    if wp.length_sq(s.work.spin_momentum[body]) > 0.0:
                        turn = wp.spatial_bottom(s.work.increment[body])
                begin_turn(body, turn, s)
            else:
                s.tree.swing[body] = exp_quat(wp.spatial_bottom(s.work.increment[body]))
                s.tree.update[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        if wp.static(effects.coordinates):
            for i in range(first, end):
                body = body_at(i, s.worlds)
                if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                    measure_guess(body, scale.static_slot, s)
        return is_open

    return together(measure_blocks, measure_loop, place_blocks)
