# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a taut tendon resists as its path turns: a bound of its curvature for each axis.

As bodies move the path of a tendon turns, which is a curvature of its tension times its length,
beside that of its row (:mod:`.step.tendons`). It is kept along the axes of the joints that a span
passes, by the sum of its absolute values for each axis, which is no less than it is (Gershgorin): a
light body on a taut tendon is stable, and settles more slowly.
"""

import warp as wp

from ..data import BodyWork, Solver, TendonSpan
from ..effects import Effects
from ..rows.euler import make_euler
from ..rows.free_axes import make_free_axes
from ..rows.joint import linear_axis, make_counts
from .anchors import anchor_arm, anchor_rotation, is_linked, joint_shift, parent_slot
from .tendon_length import center_of

WILD = wp.constant(0.25)
"""Turn of a body in a sweep from which the curvature of a path counts with the most that it has at
any turn [rad], where it is more than the body's inertia. Always, it would slow all light bodies."""


@wp.func
def span_of(body: int, s: wp.ref[Solver]) -> wp.vec3:
    """From the COM of the parent in the tree to that of a body [m]."""
    return s.tree.apart[body] + joint_shift(s.work, body) - joint_shift(s.work, s.tree.parent[body])


@wp.func
def takes_start(a: int, b: int, rank: wp.array[wp.int32], work: wp.ref[BodyWork]) -> bool:
    """Whether the way between two bodies of a tree goes up from the first one next."""
    if work.inv_mass[b] == 0.0:
        return True
    return work.inv_mass[a] > 0.0 and rank[a] > rank[b]


@wp.func
def end_motion(
    motion: wp.spatial_vector, at_start: bool, center: wp.vec3, span: TendonSpan
) -> wp.vec3:
    """How an axis moves the end of a span against its start, by the motion of the COM of its
    body, which is at ``center``."""
    point = wp.where(at_start, span.start, span.end)
    moved = wp.spatial_top(motion) + wp.cross(wp.spatial_bottom(motion), point - center)
    return wp.where(at_start, -moved, moved)


def make_bend(effects: Effects) -> wp.Function:
    """Device function: adds what bounds the curvature of a tendon to the axes that it passes."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    known_angles = make_euler(effects.kinds).known_angles
    angular_axis = make_free_axes(effects.kinds).angular_axis

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

    return bend
