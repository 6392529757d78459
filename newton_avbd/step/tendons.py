# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's tendons in the sweeps: a row each of the equations that are solved with a tree.

With its length L, the force F along it and the slope K = -dF/dL of what acts along it, a tendon is

    J delta - (mu + F)/K = 0

of the update delta of a sweep and the tension mu, where J is how L changes with the bodies: exact
for what is linear along it, however stiff. What holds L, a stop or friction, is J delta = step.
Rows are made anew in each sweep where L then is, and settle as Newton's method does.

As bodies move the path turns, which is a curvature of mu L beside that of J. It is kept along
the axes of the joints that a span passes, by the sum of its absolute values for each axis, which is
no less than it is (Gershgorin): a light body on a taut tendon is stable, and settles more slowly.
"""

from dataclasses import dataclass

import warp as wp

from ..algebra.so3 import turned_from
from ..data import BodyModel, BodyWork, Closure, Solver, TendonSpan, TreeWork, WorldScale
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows.euler import make_euler
from ..rows.free_axes import make_free_axes
from ..rows.joint import linear_axis, make_counts
from ..rows.path import CYLINDER, JOINT, PULLEY, SPHERE, double, find_path
from ..rows.tendon import linear_pull, range_of, tendon_law
from .anchors import (
    ROUNDING,
    anchor_arm,
    anchor_rotation,
    is_linked,
    is_put,
    joint_shift,
    parent_slot,
)
from .slopes import begin_axis, end_axis

FREE = wp.constant(1.0e6)
"""How much softer a row without a slope is than the bodies that it pulls are mobile: it then pushes
with F but for a millionth, which the next sweep finds."""
LIMIT_JOLT = wp.constant(1.0e-5)
"""How far beyond its range the length of a tendon that goes on is about to be [m or rad]."""
WILD = wp.constant(0.25)
"""Turn of a body in a sweep from which the curvature of a path counts with the most that it has at
any turn [rad], where it is more than the body's inertia. Always, it would slow all light bodies."""
LEAST_MISSED = wp.constant(1.0e-9)
"""Length that a row may be off by in a sweep at least [m or rad]."""


@wp.func
def rounding_of(length: wp.float64) -> float:
    """What rounding explains of a length [m or rad]."""
    return LEAST_MISSED + ROUNDING * wp.abs(wp.float32(length))


@wp.func
def mobility_of(body: int, way: wp.spatial_vector, h: float, model: wp.ref[BodyModel]) -> float:
    """How far a wrench moves its own row at most by a body that nothing else holds [m/N]."""
    turned = wp.trace(model.inv_inertia[body]) * wp.length_sq(wp.spatial_bottom(way))
    return h * h * (model.inv_mass[body] * wp.length_sq(wp.spatial_top(way)) + turned)


def make_join_tendons(join: wp.Function) -> wp.Function:
    """Device function that makes one island of what tendons of a block tie, by ``join``."""

    @wp.func
    def join_tendons(first: int, s: wp.ref[Solver]):
        closures = s.tree.closures
        tendons = s.tree.tendons
        number = closures.block_of[first]
        if number < 0:
            return
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            i = closures.closures[c].tendon
            if i < 0:
                continue
            one = int(-1)
            for k in range(tendons.start[i], tendons.start[i + 1]):
                body = tendons.body[k]
                if one < 0 and body >= 0:
                    if s.work.inv_mass[body] > 0.0:
                        one = body
            for k in range(tendons.start[i], tendons.start[i + 1]):
                body = tendons.body[k]
                if one >= 0 and body >= 0 and body != one:
                    join(one, body, s)

    return join_tendons


@wp.func
def tendon_work(i: int, tree: wp.ref[TreeWork]) -> float:
    """Work of what acts along a tendon in the step [J]: the mean force over the way."""
    tendons = tree.tendons
    moved = wp.float32(tendons.length[i] - tendons.start_length[i])
    if axis_rows.is_held(tendons.law[i]):
        return 0.0
    return (tendons.pull[i][0] + 0.5 * tendons.pull[i][1] * moved) * moved


@dataclass(frozen=True)
class TendonFunctions:
    """Device functions of tendons, compiled for the effects of a scene."""

    begin_tendon: wp.Function
    tendon_row: wp.Function
    settle_tendon: wp.Function
    tendon_wrench: wp.Function
    end_tendon: wp.Function


@wp.func
def meets_range(first: int, h: float, tree: wp.ref[TreeWork]) -> bool:
    """Second order: whether the length of a tendon of a block is about to meet its range."""
    closures = tree.closures
    number = closures.block_of[first]
    if number < 0:
        return False
    block = closures.blocks[number]
    for c in range(block.first, block.end):
        i = closures.closures[c].tendon
        if i >= 0 and closures.closures[c].other < 0:
            goes_to = wp.float32(tree.tendons.length[i]) + h * tree.tendons.motion[i].rate
            ends = range_of(i, tree.tendons)
            if goes_to < ends[0] - LIMIT_JOLT or goes_to > ends[1] + LIMIT_JOLT:
                return True
    return False


def make_tendons(effects: Effects) -> TendonFunctions:
    """Device functions: how a tendon stands, its row, and what the row has found."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    known_angles = make_euler(effects.kinds).known_angles
    angular_axis = make_free_axes(effects.kinds).angular_axis
    next_piece = axis_rows.make_next_piece(friction=True, stops=True, limits=True)
    compliance = effects.compliance

    @wp.func
    def center_of(k: int, s: wp.ref[Solver]) -> wp.vec3:
        """COM of the body of an element, from the origin of its tendon [m]."""
        return s.tree.tendons.apart[k] + joint_shift(s.work, s.tree.tendons.body[k])

    @wp.func
    def span_of(body: int, s: wp.ref[Solver]) -> wp.vec3:
        """From the COM of the parent in the tree to that of a body [m]."""
        return (
            s.tree.apart[body]
            + joint_shift(s.work, body)
            - joint_shift(s.work, s.tree.parent[body])
        )

    @wp.func
    def begin_points(i: int, s: wp.ref[Solver]):
        """Where a tendon starts, from the first of its bodies: far from the origin of the world
        positions are coarse, and their differences exact. A kinematic body counts as not yet moved.
        """
        tendons = s.tree.tendons
        static_slot = s.work.inv_mass.shape[0] - 1
        first = int(-1)
        for k in range(tendons.start[i], tendons.start[i + 1]):
            if first < 0 and tendons.body[k] != static_slot and tendons.body[k] >= 0:
                first = tendons.body[k]
        origin = wp.transform_get_translation(s.work.pose[first])
        shift = wp.quat_rotate(wp.transform_get_rotation(s.work.pose[first]), s.model.com[first])
        shift += s.history.lost[first]
        for k in range(tendons.start[i], tendons.start[i + 1]):
            body = tendons.body[k]
            if body == static_slot:
                place = wp.transform_get_translation(tendons.frame[k])
                tendons.apart[k] = (place - origin) - shift
                tendons.begun[k] = tendons.apart[k]
            elif body >= 0:
                pose = s.work.pose[body]
                away = wp.transform_get_translation(pose) - origin
                center = wp.quat_rotate(wp.transform_get_rotation(pose), s.model.com[body])
                tendons.apart[k] = away + (center + s.history.lost[body] - shift)
                arm = anchor_arm(body, tendons.frame[k], static_slot, s)
                tendons.begun[k] = tendons.apart[k] + arm
                if is_put(body, s.work):
                    ahead = s.tree.update[body]
                    turned = wp.cross(wp.spatial_bottom(ahead), arm)
                    tendons.begun[k] = tendons.begun[k] - wp.spatial_top(ahead) - turned

    @wp.func
    def find_length(i: int, is_start: bool, s: wp.ref[Solver]) -> wp.float64:
        """Length of a tendon [m or rad], and its path where it is spatial."""
        tendons = s.tree.tendons
        first = tendons.start[i]
        static_slot = s.work.inv_mass.shape[0] - 1
        total = wp.float64(0.0)
        if tendons.kind[first] == JOINT:
            for k in range(first, tendons.start[i + 1]):
                q = s.tree.coordinate[tendons.axis[k]]
                if is_start:
                    q = s.tree.start_coordinate[tendons.axis[k]]
                    if wp.static(effects.second_order):
                        q = s.history.coordinate[tendons.dof[k]].start
                q += wp.float64(tendons.ref[tendons.dof[k]])
                total += wp.float64(tendons.value[k]) * q
            return total
        if wp.static(effects.spatial_tendons):
            for k in range(first, tendons.start[i + 1]):
                body = tendons.body[k]
                if tendons.kind[k] != PULLEY:
                    point = double(tendons.begun[k])
                    frame = tendons.frame[k]
                    if body != static_slot and not is_start:
                        # read off the increments, so that it rounds as they do
                        arm = anchor_arm(body, frame, static_slot, s)
                        if is_put(body, s.work):
                            point = double(tendons.apart[k] + arm)
                        else:
                            turned = turned_from(s.tree.swing[body], arm)
                            point += double(joint_shift(s.work, body) + turned)
                    tendons.point[k] = point
                    if tendons.kind[k] == SPHERE or tendons.kind[k] == CYLINDER:
                        tendons.rotation[k] = wp.transform_get_rotation(frame)
                        if body != static_slot:
                            tendons.rotation[k] = anchor_rotation(s.tree, body, frame)
            total = find_path(i, tendons)
        return total

    @wp.func
    def led_by(
        closure: Closure, length: wp.float64, other: wp.float64, s: wp.ref[Solver]
    ) -> wp.vec2:
        """How far a tendon is from where its equality constraint leads it [m or rad], and by how
        much more for more of the other one. Both count from their lengths in the reference pose."""
        lead = wp.float64(0.0)
        if closure.other != closure.tendon:
            lead = other - wp.float64(s.tree.tendons.rest[closure.other])
        value = wp.float64(0.0)
        slope = wp.float64(0.0)
        for k in range(5):
            slope = value + slope * lead
            value = wp.float64(s.joints.polynomials[closure.equality, 4 - k]) + value * lead
        left = length - wp.float64(s.tree.tendons.rest[closure.tendon]) - value
        return wp.vec2(wp.float32(left), wp.float32(slope))

    @wp.func
    def begin_tendon(closure: Closure, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Length of a tendon at the start of the step, or what its equality constraint misses then.

        Expects increments of zero, and the tendons of a constraint to have begun. Returns whether
        it is beyond its limits, or misses anything, by more than rounding.
        """
        tendons = s.tree.tendons
        i = closure.tendon
        length = tendons.length[i]
        rounding = rounding_of(length)
        if closure.other >= 0:
            misfit = led_by(closure, length, tendons.length[closure.other], s)[0]
            s.tree.closures.misfit[closure.row] = misfit
            return wp.abs(misfit) > rounding
        is_fixed = tendons.kind[tendons.start[i]] == JOINT
        if not is_fixed:
            begin_points(i, s)
        length = find_length(i, True, s)
        tendons.length[i] = length
        started = length
        rate = tendons.velocity[i]
        if wp.static(effects.second_order):
            started = begin_axis(i, length, scale, tendons.motion)
            rate = wp.float32(begin_axis(i, wp.float64(rate), scale, tendons.rate))
        tendons.start_length[i] = started
        tendons.start_velocity[i] = rate
        if wp.float32(wp.abs(length - tendons.held_at[i])) > rounding or tendons.piece[i][2] != 0:
            # what rounding moves, friction brings back
            tendons.held_at[i] = started
        ends = range_of(i, tendons)
        at = wp.float32(length)
        is_beyond = at < ends[0] - rounding or at > ends[1] + rounding
        return wp.static(not compliance) and is_beyond

    @wp.func
    def pull_along(i: int, ends: int, share: float, h: float, s: wp.ref[Solver]) -> float:
        """Adds a share of how the length of a tendon changes with the bodies to a row.

        ``ends`` says where the row keeps what its elements pull. Returns about how far a unit of
        tension moves bodies that nothing else holds along it [m/N].
        """
        tendons = s.tree.tendons
        closures = s.tree.closures
        first = tendons.start[i]
        mobility = float(0.0)
        if tendons.kind[first] == JOINT:
            for k in range(first, tendons.start[i + 1]):
                body = tendons.body[k]
                joint = s.tree.joint[body]
                coefficient = share * tendons.value[k]
                place = closures.ends[ends + k - first]
                if place >= 0 and is_linked(body, s):
                    met = closures.met[place]
                    met[0] = met[0] + coefficient
                    closures.met[place] = met
                    free = s.model.inv_mass[body]
                    if linear_count(s.joints, joint) == 0:
                        free = wp.trace(s.model.inv_inertia[body])
                    mobility += coefficient * coefficient * h * h * free
            return mobility
        if wp.static(effects.spatial_tendons):
            for along in range(first, tendons.span_end[i]):
                span = tendons.spans[along]
                for end in range(2):
                    k = wp.where(end == 0, span.a, span.b)
                    slot = closures.ends[ends + k - first]
                    if slot >= 0:
                        point = wp.where(end == 0, span.start, span.end)
                        sign = wp.where(end == 0, -share, share)
                        force = sign * span.share * span.along
                        torque = wp.cross(point - center_of(k, s), force)
                        way = wp.spatial_vector(force, torque)
                        closures.way[slot] = closures.way[slot] + way
                        mobility += mobility_of(tendons.body[k], way, h, s.model)
        return mobility

    @wp.func
    def axis_motion(body: int, dof: int, s: wp.ref[Solver]) -> wp.spatial_vector:
        """Motion of a body's COM, and its turn, by a unit of an axis of its joint; of a root that
        floats by a shift or a turn along an axis of the world."""
        motion = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        if not is_linked(body, s):
            motion[dof] = 1.0
            return motion
        joint = s.tree.joint[body]
        static_slot = s.work.inv_mass.shape[0] - 1
        child = s.joints.child[joint]
        frame = s.joints.child_frame[joint]
        sign = float(1.0)
        if child != body:
            sign = -1.0
            frame = s.joints.parent_frame[joint]
        q_p = anchor_rotation(
            s.tree, parent_slot(s.joints, joint, static_slot), s.joints.parent_frame[joint]
        )
        linear = linear_count(s.joints, joint)
        if dof < linear:
            return wp.spatial_vector(sign * linear_axis(s.joints, joint, dof, q_p), wp.vec3(0.0))
        q_c = anchor_rotation(s.tree, child, s.joints.child_frame[joint])
        known = wp.vec3(0.0)
        if wp.static(effects.kinds.gimbals):
            known = known_angles(s.joints, joint, s.tree.coordinate, s.tree.axis_start[body])
        axis = sign * angular_axis(s.joints, joint, dof - linear, q_p, q_c, known)
        arm = anchor_arm(body, frame, static_slot, s)
        return wp.spatial_vector(wp.cross(arm, axis), axis)

    @wp.func
    def axis_count(body: int, s: wp.ref[Solver]) -> int:
        """How many axes the joint of a body has, six of a root that floats."""
        if not is_linked(body, s):
            return 6
        return linear_count(s.joints, s.tree.joint[body]) + angular_count(
            s.joints, s.tree.joint[body]
        )

    @wp.func
    def takes_start(a: int, b: int, rank: wp.array[wp.int32], work: wp.ref[BodyWork]) -> bool:
        """Whether the way between two bodies of a tree goes up from the first one next."""
        if work.inv_mass[b] == 0.0:
            return True
        return work.inv_mass[a] > 0.0 and rank[a] > rank[b]

    @wp.func
    def end_motion(
        motion: wp.spatial_vector,
        at_start: bool,
        center: wp.vec3,
        span: TendonSpan,
    ) -> wp.vec3:
        """How an axis moves the end of a span against its start, by the motion of the COM of its
        body, which is at ``center``."""
        point = wp.where(at_start, span.start, span.end)
        moved = wp.spatial_top(motion) + wp.cross(wp.spatial_bottom(motion), point - center)
        return wp.where(at_start, -moved, moved)

    @wp.func
    def bend_sum(
        span: TendonSpan,
        tension: float,
        own: int,
        own_dof: int,
        motion: wp.spatial_vector,
        moved: wp.vec3,
        at_start: bool,
        rank: wp.array[wp.int32],
        s: wp.ref[Solver],
    ) -> float:
        """Sum of the second derivatives of a span's length by one axis and each that it passes,
        times its tension; what is negative of the axis' own does not count.

        Of axes i above j they are P u_i . P u_j / l + n . (a_i x u_j), with the motions u of the
        end against the start, the turn a, and P square to the span.
        """
        n = span.along
        length = wp.max(span.length, 1.0e-6)
        across = moved - wp.dot(n, moved) * n
        turn = wp.spatial_bottom(motion)
        total = float(0.0)
        a = s.tree.tendons.body[span.a]
        b = s.tree.tendons.body[span.b]
        center_a = center_of(span.a, s)
        center_b = center_of(span.b, s)
        while a != b and s.work.inv_mass[a] + s.work.inv_mass[b] > 0.0:
            is_start = takes_start(a, b, rank, s.work)
            body = wp.where(is_start, a, b)
            center = wp.where(is_start, center_a, center_b)
            for dof in range(axis_count(body, s)):
                other = axis_motion(body, dof, s)
                u = end_motion(other, is_start, center, span)
                second = wp.dot(across, u - wp.dot(n, u) * n) / length
                if is_start == at_start:
                    is_above = rank[own] < rank[body] or (own == body and own_dof <= dof)
                    if is_above:
                        second += wp.dot(n, wp.cross(turn, u))
                    else:
                        second += wp.dot(n, wp.cross(wp.spatial_bottom(other), moved))
                second *= tension
                if body == own and dof == own_dof:
                    total += wp.max(second, 0.0)
                else:
                    # an angle and a shift compare by the way that the angle moves
                    scale = float(1.0)
                    if wp.length_sq(turn) > 0.0 and wp.length_sq(wp.spatial_bottom(other)) == 0.0:
                        scale = wp.length(moved)
                    elif wp.length_sq(turn) == 0.0:
                        if wp.length_sq(wp.spatial_bottom(other)) > 0.0:
                            scale = 1.0 / wp.max(wp.length(u), 1.0e-6)
                    total += scale * wp.abs(second)
            if is_start:
                center_a -= span_of(body, s)
                a = s.tree.parent[body]
            else:
                center_b -= span_of(body, s)
                b = s.tree.parent[body]
        return total

    @wp.func
    def bend(i: int, tension: float, h: float, rank: wp.array[wp.int32], s: wp.ref[Solver]):
        """Adds what bounds the curvature of a tendon's path to the axes that it passes."""
        tendons = s.tree.tendons
        for along in range(tendons.start[i], tendons.span_end[i]):
            span = tendons.spans[along]
            a = tendons.body[span.a]
            b = tendons.body[span.b]
            center_a = center_of(span.a, s)
            center_b = center_of(span.b, s)
            while a != b and s.work.inv_mass[a] + s.work.inv_mass[b] > 0.0:
                is_start = takes_start(a, b, rank, s.work)
                body = wp.where(is_start, a, b)
                center = wp.where(is_start, center_a, center_b)
                for dof in range(axis_count(body, s)):
                    motion = axis_motion(body, dof, s)
                    moved = end_motion(motion, is_start, center, span)
                    bound = bend_sum(
                        span, span.share * tension, body, dof, motion, moved, is_start, rank, s
                    )
                    turned = wp.spatial_bottom(s.tree.update[body])
                    is_wild = wp.length_sq(turned) > WILD * WILD
                    if is_wild and wp.length_sq(wp.spatial_bottom(motion)) > 0.0:
                        # what turns a light body over within the step has more on its way
                        lever = wp.length(moved)
                        most = lever + lever * lever / wp.max(span.length, 1.0e-6)
                        inert = wp.static(1 / 3) * wp.trace(s.work.inertia[body])
                        inert += s.model.mass[body] * wp.length_sq(wp.spatial_top(motion))
                        most *= wp.abs(span.share * tension)
                        bound = wp.max(bound, most - inert / (h * h))
                    if is_linked(body, s):
                        at = s.tree.axis_start[body] + dof
                        tendons.curvature[at] = tendons.curvature[at] + bound
                    else:
                        curved = tendons.root_curvature[body]
                        curved[dof] = curved[dof] + bound
                        tendons.root_curvature[body] = curved
                if is_start:
                    center_a -= span_of(body, s)
                    a = s.tree.parent[body]
                else:
                    center_b -= span_of(body, s)
                    b = s.tree.parent[body]

    @wp.func
    def tendon_row(
        closure: Closure, recovery: float, h: float, rank: wp.array[wp.int32], s: wp.ref[Solver]
    ):
        """The row of a tendon where its bodies are now."""
        tendons = s.tree.tendons
        closures = s.tree.closures
        row = closure.row
        i = closure.tendon
        for slot in range(closure.slot, closure.slot_end):
            closures.way[slot] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        length = find_length(i, False, s)
        if closure.other >= 0:
            other = find_length(closure.other, False, s)
            led = led_by(closure, length, other, s)
            pull_along(i, closure.ends, 1.0, h, s)
            if closure.other != i:
                ends = closure.ends + tendons.start[i + 1] - tendons.start[i]
                pull_along(closure.other, ends, -led[1], h, s)
            left = led[0]
            if recovery == 0.0:
                left -= closures.misfit[row]
            closures.multiplier[row] = wp.float64(left)
            return
        tendons.length[i] = length
        moved = wp.float32(length - tendons.start_length[i])
        law = tendon_law(i, length, moved, wp.static(compliance), recovery, h, tendons)
        force, stiffness = linear_pull(
            i, wp.float32(length), moved, wp.static(compliance), h, tendons
        )
        tendons.law[i] = law
        more, slope = axis_rows.law_force(law)
        force += more
        stiffness += slope
        tendons.pull[i] = wp.vec2(force, stiffness)
        is_held = axis_rows.is_held(law)
        if force == 0.0 and stiffness == 0.0 and not is_held:
            return
        mobility = pull_along(i, closure.ends, 1.0, h, s)
        tension = -force
        if is_held:
            tension = -tendons.force[i]
            closures.multiplier[row] = -wp.float64(axis_rows.held_step(law))
        else:
            soft = wp.float64(FREE * mobility)
            if wp.float64(stiffness) * soft > wp.float64(1.0):
                soft = wp.float64(1.0) / wp.float64(stiffness)
            closures.gram[closures.gram_row[row] + row] = soft
            closures.multiplier[row] = -wp.float64(force) * soft
        if wp.static(effects.spatial_tendons):
            if tendons.kind[tendons.start[i]] != JOINT:
                bend(i, tension, h, rank, s)

    @wp.func
    def settle_tendon(closure: Closure, recovery: float, h: float, s: wp.ref[Solver]) -> float:
        """After the bodies have moved: what the row has found of its tendon.

        Returns the square of how far its length is off what the row takes it for, as far as that
        moves bodies [m^2], zero where rounding hides it, and infinity on a wrong piece of its law.
        """
        tendons = s.tree.tendons
        closures = s.tree.closures
        row = closure.row
        i = closure.tendon
        length = find_length(i, False, s)
        missed = float(0.0)
        is_wrong = bool(False)
        if closure.other >= 0:
            other = find_length(closure.other, False, s)
            missed = led_by(closure, length, other, s)[0]
            if recovery == 0.0:
                missed -= closures.misfit[row]
        else:
            law = tendons.law[i]
            force = tendons.pull[i][0]
            stiffness = tendons.pull[i][1]
            pulled = -wp.float32(closures.multiplier[row])
            step = wp.float32(length - tendons.length[i])
            held = float(0.0)
            moved = wp.float32(length - tendons.start_length[i])
            if axis_rows.is_held(law):
                held_step = axis_rows.held_step(law)
                missed = step - held_step
                held = pulled - (force - stiffness * held_step)
                step = held_step
            else:
                now, _k = linear_pull(
                    i, wp.float32(length), moved, wp.static(compliance), h, tendons
                )
                more, slope = axis_rows.law_force(law)
                whole = closures.whole[row]
                now += more - slope * step
                left = now - pulled
                # what was slack had no row
                is_wrong = force == 0.0 and stiffness == 0.0 and now != 0.0
                tendons.pull[i] = wp.vec2(now, stiffness)
                missed = left * whole / (1.0 + stiffness * whole)
            if recovery == 0.0:
                # what was wrong before goes by no force
                tendons.force[i] = pulled
            tendons.length[i] = length
            found = next_piece(law, step, held)
            is_wrong = is_wrong or not (found == law.piece)
            tendons.piece[i] = found
        if is_wrong:
            return wp.inf
        return wp.where(wp.abs(missed) > rounding_of(length), missed * missed, 0.0)

    @wp.func
    def tendon_wrench(closure: Closure, sign: float, s: wp.ref[Solver]):
        """Adds what a spatial tendon pulls its bodies with to their loads, times a sign."""
        tendons = s.tree.tendons
        i = closure.tendon
        if closure.other >= 0 or tendons.kind[tendons.start[i]] == JOINT:
            return
        for place in range(tendons.start[i], tendons.span_end[i]):
            span = tendons.spans[place]
            for end in range(2):
                k = wp.where(end == 0, span.a, span.b)
                body = tendons.body[k]
                if s.work.inv_mass[body] > 0.0:
                    point = wp.where(end == 0, span.start, span.end)
                    along = wp.where(end == 0, -sign, sign) * span.share * tendons.force[i]
                    force = along * span.along
                    torque = wp.cross(point - center_of(k, s), force)
                    s.tree.load[body] = s.tree.load[body] + wp.spatial_vector(force, torque)

    @wp.func
    def end_tendon(closure: Closure, scale: WorldScale, tree: wp.ref[TreeWork]):
        """Second order: how a tendon has moved in the step, before anything old is recovered."""
        tendons = tree.tendons
        i = closure.tendon
        if closure.other < 0:
            length = tendons.length[i]
            moved = wp.float32(length - tendons.start_length[i])
            rate = tendons.start_velocity[i]
            end_axis(i, tendons.start_length[i], length, scale, tendons.motion)
            end_axis(i, wp.float64(rate), wp.float64(moved / scale.step), scale, tendons.rate)

    return TendonFunctions(begin_tendon, tendon_row, settle_tendon, tendon_wrench, end_tendon)
