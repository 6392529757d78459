# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Where steps of backward Euler leave fixed articulations that nothing touches: trapezoidal rule.

With the velocity of its end such a step goes too far by half of what that changed: a fall from rest
by g h^2/2. Bodies go back by h (v_n+1 - v_n)/2, with their joints closed, and keep their
velocities. An axis that resists fast motion, or is stopped, keeps its coordinate instead. (How
articulations that fly fall is known before the step: see :mod:`.step.block_start`.)
"""

import warp as wp

from ..algebra.so3 import exp_quat
from ..blocks.tree import carried
from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions
from ..rows.joint import make_counts
from ..rows.lock import make_locks
from .anchors import is_linked, joint_shift, make_frames_of, start_span
from .beginning import make_is_reached
from .bodies import body_at
from .scale import last_update
from .slopes import QUIET_WORLD, make_resistance
from .smoothness import MOST_TURN, RESOLVED

AGREEING = wp.constant(0.1)
"""Share of what a step changes of the velocities at a joint by which these may disagree with it at
the start, beyond what chords do: it stops at once, and not by halves."""
FOLLOWING = wp.constant(1.0 / (1.0 + RESOLVED))
"""Share of the inertia in what resists along an axis from which on the axis is slow enough."""


@wp.func
def velocity_before(body: int, step: wp.ref[Step], s: wp.ref[Solver]) -> wp.spatial_vector:
    """Velocity of a body at the start of the step, whose end may have taken the array."""
    if s.work.inv_mass[body] > 0.0:
        return s.history.last[body].velocity
    return step.body_qd_out[body]


@wp.func
def overshoot(body: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]) -> wp.spatial_vector:
    """How much farther backward Euler has moved a body than the trapezoidal rule would."""
    return (0.5 * h) * (step.body_qd_out[body] - velocity_before(body, step, s))


@wp.func
def goes_too_far(world: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
    """Whether a world has made a step of backward Euler that settled and changed velocities."""
    if scale.step < scale.h or s.history.smooth[world] == QUIET_WORLD:
        return False
    return s.worlds.update[world] <= last_update(scale)


def make_is_untouched(effects: Effects) -> wp.Function:
    """Device function: whether nothing but the joints of a fixed tree holds it."""
    is_reached = make_is_reached(effects)

    @wp.func
    def is_untouched(first: int, end: int, s: wp.ref[Solver]) -> bool:
        """Whether a block is a tree on what no force moves, without loops, tendons and mimics, that
        no contact may reach."""
        root = body_at(first, s.worlds)
        if not is_linked(root, s):
            return False
        if s.work.inv_mass[s.tree.parent[root]] > 0.0:
            return False
        if wp.static(effects.closures):
            if s.tree.closures.block_of[first] >= 0:
                return False
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if is_reached(body, s):
                return False
            if wp.static(effects.spinning):
                if wp.length_sq(s.work.spin_momentum[body]) > 0.0:
                    return False
        return True

    return is_untouched


def make_is_smooth_joint(effects: Effects) -> wp.Function:
    """Device function: whether the velocities at a joint have changed smoothly in a step."""
    linear_misfit = make_locks(effects.kinds).linear_misfit
    frames_of = make_frames_of(effects.flipped)

    @wp.func
    def is_smooth_joint(
        body: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> bool:
        """Whether a body turns slowly, and moves against its parent at first as its joint lets it.

        What backward Euler left moves along the chord of the last step.
        """
        h = scale.h
        before, after = velocity_before(body, step, s), step.body_qd_out[body]
        w = wp.spatial_bottom(before)
        fastest = wp.max(wp.length_sq(w), wp.length_sq(wp.spatial_bottom(after)))
        if h * h * fastest > MOST_TURN * MOST_TURN:
            return False
        joint = s.tree.joint[body]
        parent = s.tree.parent[body]
        sign, frame_p, frame_c = frames_of(body, joint, s.joints)
        rotation = wp.transform_get_rotation(s.work.pose[body])
        arm = wp.transform_get_translation(frame_c) - s.model.com[body]
        arm = wp.quat_rotate(rotation, arm)
        span = start_span(body, parent, frame_p, scale.static_slot, s) + arm
        slip = wp.spatial_top(carried(arm, before))
        change = wp.spatial_top(carried(arm, after - before))
        chord = wp.length_sq(w) * wp.length(arm)
        rotation_p = wp.transform_get_rotation(frame_p)
        if parent != scale.static_slot:
            before_p = velocity_before(parent, step, s)
            w_p = wp.spatial_bottom(before_p)
            slip -= wp.spatial_top(carried(span, before_p))
            change -= wp.spatial_top(carried(span, step.body_qd_out[parent] - before_p))
            chord += wp.length_sq(w_p) * wp.length(span)
            chord += 2.0 * wp.length(w_p) * wp.length(slip)
            rotation_p = wp.transform_get_rotation(s.work.pose[parent]) * rotation_p
        if sign < 0.0:
            rotation_p = rotation * wp.transform_get_rotation(frame_c)
        misfit = linear_misfit(s.joints, joint, rotation_p, slip)
        return wp.length(misfit) <= h * chord + AGREEING * wp.length(change)

    return is_smooth_joint


def make_trapezoid(effects: Effects, forward: Functions) -> wp.Function:
    """Device function: moves a block back to where the trapezoidal rule leaves it.

    Args:
        effects: What the kernel is compiled with.
        forward: Device functions that close the joints of bodies.
    """
    is_untouched = make_is_untouched(effects)
    is_smooth_joint = make_is_smooth_joint(effects)
    put_together, stop_coordinates = forward.put_together, forward.stop_coordinates
    angular_count = make_counts(effects.kinds).angular_count
    resistance = make_resistance(effects)

    @wp.func
    def is_followed(body: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]) -> bool:
        """Whether the axes of a body's joint follow what pushes them in a step.

        Of several angles the change in a step is no sum of those about their axes.
        """
        joint = s.tree.joint[body]
        if angular_count(s.joints, joint) > 1:
            return False
        for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
            last = s.history.input[dof]
            share = last.share
            if wp.static(effects.effort_limits):
                # what is at its limit will not be there for long
                resists = resistance(dof, scale, step, s)
                share = wp.min(share, 1.0 / (1.0 + last.mobility * resists))
            if share < FOLLOWING:
                return False
        return True

    @wp.func
    def go_back(body: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]):
        """Moves a body back, after its parent, of which ``tree.update`` says how far it went."""
        back = overshoot(body, scale.h, step, s)
        if is_linked(body, s):
            parent = s.tree.parent[body]
            gone = wp.spatial_vector()
            span = s.tree.apart[body] + joint_shift(s.work, body) - joint_shift(s.work, parent)
            if s.work.inv_mass[parent] > 0.0:
                gone = s.tree.update[parent]
            if is_followed(body, scale, step, s):
                if parent != scale.static_slot:
                    gone -= overshoot(parent, scale.h, step, s)
                back += carried(span, gone)
            else:
                back = carried(span, gone)
        s.work.increment[body] = s.work.increment[body] - back
        turned = exp_quat(-wp.spatial_bottom(back))
        s.tree.rotation[body] = turned * s.tree.rotation[body]
        s.tree.update[body] = back
        if is_linked(body, s):
            put_together(body, scale.static_slot, s)

    @wp.func
    def move_by_trapezoid(
        first: int, end: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]
    ):
        """Moves the bodies of a block, of places ``first`` to ``end``, after a backward Euler step.

        ``step.body_qd_out`` has the velocities of its end already.
        """
        if not is_untouched(first, end, s):
            return
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if is_linked(body, s):
                if not is_smooth_joint(body, scale, step, s):
                    return
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                go_back(body, scale, step, s)
        if wp.static(effects.hard_limits):
            stop_coordinates(first, end, scale.static_slot, s)

    return move_by_trapezoid
