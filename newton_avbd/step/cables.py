# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Newton's tendons in a step: their tensions are solved for between the sweeps over the bodies.

A sweep moves each block to the minimum of its quadratic model under the tensions T that there are.
After it the cables of a cluster are beyond their targets by C(x), and the blocks answer a change of
the tensions by -W^T dT, where W dT is the wrench on their bodies:

    C(x) - A dT = S T + (what they may keep),   A = W^T H^-1 W,

with the blocks H as they have been factored, articulations as a whole, and the softness S of
compliant segments. It is the dual update of the augmented Lagrangian, with the exact inverse of
what couples the rows in the place of a penalty: neither the number of segments nor the ratio of
masses slows it. The next sweep moves the bodies. A pull turns with its segment; the block holds the
curvature of that (geometric stiffness, T/L square to the segment), so that it stays stable.

Which segments are slack and at which guides the cable slips is found by trying: the equations are
solved as if it were known, and what contradicts the answer is changed (policy iteration).
"""

from typing import Any, NamedTuple

import warp as wp

from ..algebra.block import half_solve, other_half
from ..blocks.tree import carried, geometric_stiffness, handed_down
from ..data import BodyWork, CableGuide, CableWork, Solver, WorldScale
from ..effects import Effects
from ..rows import cable as law
from ..rows.cable import ANCHOR, FREELY, NO_RATIO, ROLLER, STICKS, TO_LEFT, TO_RIGHT, GuidePose
from ..rows.joint import make_counts
from .anchors import is_linked

LEAST_LENGTH = wp.constant(1.0e-6)
"""Length of a segment below which its geometric stiffness does not grow any more [m]."""
ROUNDING = wp.constant(wp.float64(1.0e-7))
"""Change of a segment that counts as none, of how far its ends move in the step."""
HIDDEN = wp.constant(wp.float64(1.0e-9))
"""What the equations are off by, of its length, that counts as none."""
OPEN = wp.constant(wp.float64(1.0e-6))
"""Stretch of an inextensible segment that is left alone, of its length."""
TRIALS = wp.constant(8)
"""Most trials of what is slack and what slips, beyond two for each segment."""
LITTLE = wp.constant(wp.float64(1.0e-7))
"""Tension that counts as none, of the largest of a cluster."""
KEPT = wp.constant(wp.float64(3.0e-6))
"""Softness by which a segment keeps to its tension from sweep to sweep, of its mobility. It decides
how cables share a load where nothing else does. Rounding is 1e-7 of a mobility."""
JOLT = wp.constant(0.25)
"""Change of a tension in a step that is a jump, as a share of itself and, by what it moves, of
g h^2."""
ROUNDED = wp.constant(wp.float64(1.0e-6))
"""Share of its material by which the rounding of poses may change the length of a taut segment."""
NONE = wp.constant(wp.float64(0.0))


@wp.func
def first_segment(cable: int, cables: wp.ref[CableWork]) -> int:
    """First of the segments of a cable."""
    return cables.guide_start[cable] - cable


@wp.func
def end_segment(cable: int, cables: wp.ref[CableWork]) -> int:
    """End of them."""
    return cables.guide_start[cable + 1] - cable - 1


@wp.func
def beyond_rest(seg: int, span: law.Span, pose_l: GuidePose, pose_r: GuidePose, cables: CableWork):
    """Length of a segment beyond its material where nothing slips [m]."""
    guide_l = cables.guides[cables.left[seg]]
    guide_r = cables.guides[cables.right[seg]]
    wound = law.unwound(guide_r, pose_r, cables.base_right[seg], span.right)
    wound -= law.unwound(guide_l, pose_l, cables.base_left[seg], span.left)
    rest = wp.float64(cables.rest[seg]) + wp.float64(cables.lost[seg])
    return span.length - rest + wound


@wp.func
def is_inextensible(cable: int, cables: wp.ref[CableWork]) -> bool:
    """Whether no segment of a cable gives way."""
    for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
        if cables.active[seg] == 1 and cables.compliance[seg] > 0.0:
            return False
    return True


@wp.func
def slot_at(seg: int, side: int, cables: wp.ref[CableWork]) -> int:
    """Slot of the body at the left end of a segment, side 0, or at its right one."""
    return cables.guides[wp.where(side == 0, cables.left[seg], cables.right[seg])].slot


@wp.func
def is_joined(guide: int, cables: wp.ref[CableWork]) -> bool:
    """Whether the cable slips at a guide, which ties the tensions on both sides."""
    return not (cables.slip[guide] == STICKS)


class CableFunctions(NamedTuple):
    """Device functions in the order of the step, compiled for the joints of a scene."""

    begin_cluster: wp.Function
    solve_cluster: wp.Function
    has_jerked: wp.Function
    give_back: wp.Function


@wp.func
def guide_pose(guide: CableGuide, s: wp.ref[Solver]) -> GuidePose:
    """Where a guide is after the increments; on a kinematic body where that is put."""
    slot = guide.slot
    pose = GuidePose()
    pose.center = law.as_double(s.work.com[slot])
    pose.rotation = wp.quatd(NONE, NONE, NONE, wp.float64(1.0))
    if s.work.inv_mass[slot] > 0.0:
        pose.center += law.as_double(wp.spatial_top(s.work.increment[slot]))
        pose.rotation = law.unit_quat(s.tree.rotation[slot])
    elif slot < s.work.inv_mass.shape[0] - 1:
        pose.rotation = law.unit_quat(wp.transform_get_rotation(s.work.pose[slot]))
    pose.center += wp.quat_rotate(pose.rotation, law.as_double(guide.arm))
    pose.rotation = pose.rotation * law.unit_quat(guide.turn)
    return pose


@wp.func
def set_way(
    place: int,
    slot: int,
    point: wp.vec3d,
    direction: wp.vec3,
    work: wp.ref[BodyWork],
    cables: wp.ref[CableWork],
):
    """Wrench of a unit force at a point, on a body after its increment."""
    way = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
    if work.inv_mass[slot] > 0.0:
        center = law.as_double(work.com[slot])
        center += law.as_double(wp.spatial_top(work.increment[slot]))
        arm = law.as_single(point - center)
        cables.arm[place] = arm
        way = wp.spatial_vector(direction, wp.cross(arm, direction))
    cables.way[place] = way


@wp.func
def measure_cable(cable: int, cables: wp.ref[CableWork], s: wp.ref[Solver]):
    """Stretch and directions of the segments of a cable after the increments; ratios at guides."""
    last = int(-1)
    for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
        if cables.active[seg] == 0:
            continue
        guide_l = cables.guides[cables.left[seg]]
        guide_r = cables.guides[cables.right[seg]]
        pose_l = guide_pose(guide_l, s)
        pose_r = guide_pose(guide_r, s)
        span = law.span_between(guide_l, guide_r, pose_l, pose_r, cables.base_left[seg])
        cables.stretch[seg] = beyond_rest(seg, span, pose_l, pose_r, cables)
        direction = law.as_single(span.direction)
        cables.length[seg] = wp.float32(span.length)
        cables.direction[seg] = direction
        cables.spoke_left[seg] = law.as_single(span.left)
        cables.spoke_right[seg] = law.as_single(span.right)
        point_l = pose_l.center + span.left
        point_r = pose_r.center + span.right
        set_way(2 * seg, guide_l.slot, point_l, direction, s.work, cables)
        set_way(2 * seg + 1, guide_r.slot, point_r, -direction, s.work, cables)
        guide = cables.left[seg]
        if last >= 0:
            angle = wp.float64(0.0)
            if guide_l.kind == ROLLER:
                spoke_in = law.as_double(cables.spoke_right[last])
                angle = law.wrapped_angle(guide_l, pose_l, spoke_in, span.left)
            else:
                angle = law.bend_angle(law.as_double(cables.direction[last]), span.direction)
            cables.ratio[guide] = law.log_ratio(cables.mu[guide], angle)
            if guide_l.kind == ANCHOR:
                cables.slip[guide] = STICKS
            elif cables.ratio[guide] < NO_RATIO:
                cables.slip[guide] = FREELY
            elif cables.slip[guide] == FREELY:
                cables.slip[guide] = STICKS
        last = seg


@wp.func
def stiffen(
    seg: int,
    side: int,
    pull: float,
    share: float,
    work: wp.ref[BodyWork],
    cables: wp.ref[CableWork],
):
    """Adds the geometric stiffness of a segment to the body at one of its ends."""
    n = cables.direction[seg]
    guide = cables.left[seg]
    spoke = cables.spoke_left[seg]
    force = pull * n
    if side == 1:
        guide = cables.right[seg]
        spoke = cables.spoke_right[seg]
        force = -force
    slot = cables.guides[guide].slot
    if work.inv_mass[slot] == 0.0:
        return
    arm = cables.arm[2 * seg + side]
    across = wp.identity(n=3, dtype=float) - wp.outer(n, n)
    across = (share * pull / wp.max(cables.length[seg], LEAST_LENGTH)) * across
    cross = wp.skew(arm)
    cables.ll[slot] = cables.ll[slot] + across
    cables.al[slot] = cables.al[slot] + cross * across
    if cables.guides[guide].kind == ROLLER:
        # the contact point does not turn with the roller
        arm -= spoke
    aa = geometric_stiffness(force, arm) - cross * across * cross
    cables.aa[slot] = cables.aa[slot] + aa
    cables.pulled[slot] = True


@wp.func
def pull_cluster(cluster: int, work: wp.ref[BodyWork], cables: wp.ref[CableWork]):
    """Wrenches on the bodies of a cluster, and their geometric stiffness, by the tensions."""
    for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
        cable = cables.cables[i]
        for guide in range(cables.guide_start[cable], cables.guide_start[cable + 1]):
            slot = cables.guides[guide].slot
            cables.wrench[slot] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            cables.pulled[slot] = False
            cables.ll[slot] = wp.mat33(0.0)
            cables.al[slot] = wp.mat33(0.0)
            cables.aa[slot] = wp.mat33(0.0)
    for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
        cable = cables.cables[i]
        for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
            pull = cables.tension[seg]
            if cables.active[seg] == 0 or pull == 0.0:
                continue
            a = slot_at(seg, 0, cables)
            b = slot_at(seg, 1, cables)
            # both move at once: (u_b - u_a)^2 <= 2 u_a^2 + 2 u_b^2
            both = work.inv_mass[a] > 0.0 and work.inv_mass[b] > 0.0
            share = wp.where(both, 2.0, 1.0)
            for side in range(2):
                slot = wp.where(side == 0, a, b)
                if work.inv_mass[slot] > 0.0:
                    cables.wrench[slot] = cables.wrench[slot] + pull * cables.way[2 * seg + side]
                    if a != b:
                        stiffen(seg, side, pull, share, work, cables)


@wp.func
def reach_of(move: wp.spatial_vector, arm: wp.vec3) -> float:
    """How far a point of a body goes at most, by how the body moves [m]."""
    return wp.length(wp.spatial_top(move)) + wp.length(wp.spatial_bottom(move)) * wp.length(arm)


@wp.func
def may_jerk(cluster: int, s: wp.ref[Solver]) -> bool:
    """Whether a cable of a cluster that did not pull in the last step may do so in this one."""
    for i in range(s.tree.cables.cluster_start[cluster], s.tree.cables.cluster_start[cluster + 1]):
        cable = s.tree.cables.cables[i]
        reach = float(0.0)
        for guide in range(s.tree.cables.guide_start[cable], s.tree.cables.guide_start[cable + 1]):
            reach += reach_of(
                s.work.target[s.tree.cables.guides[guide].slot], s.tree.cables.guides[guide].arm
            )
        sum = wp.float64(0.0)
        pull = float(0.0)
        for seg in range(first_segment(cable, s.tree.cables), end_segment(cable, s.tree.cables)):
            if s.tree.cables.active[seg] == 1:
                sum += s.tree.cables.start[seg]
                pull = wp.max(pull, s.tree.cables.tension[seg])
                if not is_joined(s.tree.cables.right[seg], s.tree.cables) or seg + 1 == end_segment(
                    cable, s.tree.cables
                ):
                    if pull == 0.0 and sum > -wp.float64(2.0 * reach):
                        return True
                    sum = wp.float64(0.0)
                    pull = float(0.0)
    return False


def make_cables(effects: Effects) -> CableFunctions:
    """Device functions: cables at the start of the sweeps, and their tensions after each."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count

    @wp.func
    def begin_cluster(cluster: int, s: wp.ref[Solver]) -> bool:
        """Pulls with the tensions of the last step, where the bodies are guessed to be.

        Returns whether an inextensible cable is too long at the start of the step, which the sweeps
        leave to the recovery. Of what a kinematic body stretches, they leave nothing.
        """
        cables = s.tree.cables
        is_open = bool(False)
        for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
            cable = cables.cables[i]
            is_rigid = is_inextensible(cable, cables)
            measure_cable(cable, cables, s)
            for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
                cables.before[seg] = cables.tension[seg]
                cables.misfit[seg] = NONE
                if is_rigid and cables.active[seg] == 1:
                    misfit = wp.max(cables.start[seg], NONE)
                    is_left = bool(True)
                    for side in range(2):
                        slot = slot_at(seg, side, cables)
                        if s.work.inv_mass[slot] > 0.0:
                            is_left = is_left and s.tree.is_left[slot]
                    if is_left:
                        misfit = wp.min(misfit, wp.float64(wp.max(cables.left_over[seg], 0.0)))
                        rounded = ROUNDED * wp.float64(cables.rest[seg])
                        if cables.tension[seg] > 0.0 and wp.abs(cables.start[seg]) < rounded:
                            # it is taut: a slack of 1e-7 m would be a jolt of its tension
                            misfit = cables.start[seg]
                    cables.misfit[seg] = misfit
                    if misfit > OPEN * wp.float64(cables.rest[seg]):
                        is_open = True
        pull_cluster(cluster, s.work, cables)
        return is_open

    @wp.func
    def answer(first: int, end: int, s: wp.ref[Solver]):
        """How a block moves under the wrenches in ``push``, by its last elimination."""
        cables = s.tree.cables
        for k in range(end - first):
            body = s.worlds.bodies[end - 1 - k]
            push = cables.push[body]
            if s.work.inv_mass[body] == 0.0:
                continue
            if is_linked(body, s):
                joint = s.tree.joint[body]
                for dof in range(linear_count(s.joints, joint) + angular_count(s.joints, joint)):
                    axis = s.tree.axes[s.tree.axis_start[body] + dof]
                    if axis.pivot == 0.0:
                        along = wp.dot(axis.linear, wp.spatial_top(push))
                        along += wp.dot(axis.angular, wp.spatial_bottom(push))
                        cables.axis_push[s.tree.axis_start[body] + dof] = along
                        taken = axis.inv_pivot * along
                        push -= taken * wp.spatial_vector(axis.force, axis.torque)
                parent = s.tree.parent[body]
                if s.work.inv_mass[parent] > 0.0:
                    handed = handed_down(s.tree.span[body], push)
                    cables.push[parent] = cables.push[parent] + handed
            else:
                cables.update[body] = half_solve(
                    s.work.factor[body], wp.spatial_top(push), wp.spatial_bottom(push)
                )
        for i in range(first, end):
            body = s.worlds.bodies[i]
            if s.work.inv_mass[body] == 0.0:
                continue
            if is_linked(body, s):
                parent = s.tree.parent[body]
                joint = s.tree.joint[body]
                update = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
                if s.work.inv_mass[parent] > 0.0:
                    update = carried(s.tree.span[body], cables.update[parent])
                dofs = linear_count(s.joints, joint) + angular_count(s.joints, joint)
                for k in range(dofs):
                    place = s.tree.axis_start[body] + dofs - 1 - k
                    axis = s.tree.axes[place]
                    if axis.pivot == 0.0:
                        met = wp.dot(axis.force, wp.spatial_top(update))
                        met += wp.dot(axis.torque, wp.spatial_bottom(update))
                        q = axis.inv_pivot * (cables.axis_push[place] - met)
                        update += q * wp.spatial_vector(axis.linear, axis.angular)
                cables.update[body] = update
            else:
                cables.update[body] = other_half(s.work.factor[body], cables.update[body])

    @wp.func
    def measure_row(cluster: int, seg: int, s: wp.ref[Solver]):
        """How far a unit of tension of a segment shortens those of its cluster."""
        cables = s.tree.cables
        size = cables.size[cluster]
        place = cables.matrix_start[cluster] + cables.row[seg] * size
        for k in range(size):
            cables.mobility[place + k] = NONE
        done = int(-1)
        for side in range(2):
            body = slot_at(seg, side, cables)
            if s.work.inv_mass[body] == 0.0:
                continue
            end = s.worlds.block_end[s.worlds.rank[body]]
            if end == done:
                continue
            done = end
            first = int(s.worlds.rank[body])
            while first > 0 and s.worlds.block_end[wp.max(first - 1, 0)] == end:
                first -= 1
            for i in range(first, end):
                cables.push[s.worlds.bodies[i]] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            for at in range(2):
                slot = slot_at(seg, at, cables)
                if s.work.inv_mass[slot] > 0.0 and s.worlds.block_end[s.worlds.rank[slot]] == end:
                    cables.push[slot] = cables.push[slot] + cables.way[2 * seg + at]
            answer(first, end, s)
            for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
                cable = cables.cables[i]
                for other in range(first_segment(cable, cables), end_segment(cable, cables)):
                    if cables.active[other] == 0:
                        continue
                    moved = float(0.0)
                    for at in range(2):
                        slot = slot_at(other, at, cables)
                        if (
                            s.work.inv_mass[slot] > 0.0
                            and s.worlds.block_end[s.worlds.rank[slot]] == end
                        ):
                            moved += wp.dot(cables.way[2 * other + at], cables.update[slot])
                    k = place + cables.row[other]
                    cables.mobility[k] = cables.mobility[k] + wp.float64(moved)

    @wp.func
    def list_rows(cluster: int, recovery: float, cables: wp.ref[CableWork]) -> int:
        """Lists the segments of a cluster whose tensions are solved for; returns how many.

        In the recovery those of cables that give way pull as they do.
        """
        count = int(0)
        for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
            cable = cables.cables[i]
            if recovery > 0.0 and not is_inextensible(cable, cables):
                continue
            for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
                if cables.active[seg] == 1:
                    cables.chain[cables.first_row[cluster] + count] = seg
                    count += 1
        return count

    @wp.func
    def mobility_of(cluster: int, row: int, column: int, cables: wp.ref[CableWork]) -> wp.float64:
        """How far a unit of tension of one segment shortens another one [m/N]."""
        place = cables.matrix_start[cluster] + cables.row[row] * cables.size[cluster]
        return cables.mobility[place + cables.row[column]]

    @wp.func
    def softness_of(cluster: int, seg: int, h: float, cables: wp.ref[CableWork]) -> wp.float64:
        """Softness of a segment, and of what keeps it to its tension so far [m/N]."""
        soft = law.softness(cables.compliance[seg], cables.damping[seg], h)
        return soft + KEPT * mobility_of(cluster, seg, seg, cables)

    @wp.func
    def excess(
        cluster: int, seg: int, count: int, h: float, cables: wp.ref[CableWork]
    ) -> wp.float64:
        """What the tensions that are tried leave of a segment beyond its target [m]."""
        left = cables.load[seg] - softness_of(cluster, seg, h, cables) * cables.pull[seg]
        first = cables.first_row[cluster]
        for k in range(count):
            other = cables.chain[first + k]
            left -= mobility_of(cluster, seg, other, cables) * cables.pull[other]
        return left

    @wp.func
    def form_groups(cluster: int, count: int, cables: wp.ref[CableWork]) -> int:
        """Groups of segments between which cables slip, and their shares of the largest tension.

        Returns how many groups there are. One is slack as a whole or not at all.
        """
        first = cables.first_row[cluster]
        groups = int(0)
        start = int(0)
        while start < count:
            stop = int(start)
            weight = wp.float64(0.0)
            most = wp.float64(0.0)
            is_slack = bool(True)
            is_going_on = bool(True)
            while is_going_on:
                seg = cables.chain[first + stop]
                cables.group[seg] = groups
                cables.weight[seg] = weight
                most = wp.max(most, weight)
                is_slack = is_slack and cables.slack[seg]
                stop += 1
                is_going_on = False
                if stop < count:
                    guide = cables.right[seg]
                    same = cables.left[cables.chain[first + stop]] == guide
                    if same and is_joined(guide, cables):
                        is_going_on = True
                        if cables.slip[guide] == TO_LEFT:
                            weight -= cables.ratio[guide]
                        elif cables.slip[guide] == TO_RIGHT:
                            weight += cables.ratio[guide]
            for k in range(start, stop):
                seg = cables.chain[first + k]
                cables.weight[seg] = wp.exp(cables.weight[seg] - most)
                cables.slack[seg] = is_slack
            groups += 1
            start = stop
        return groups

    @wp.func
    def solve_groups(
        cluster: int, count: int, groups: int, h: float, cables: wp.ref[CableWork]
    ) -> wp.float64:
        """Tensions of the groups that are taut; returns the largest.

        By elimination with pivots. A group that nothing moves and that does not give way has none.
        """
        first = cables.first_row[cluster]
        base = cables.matrix_start[cluster]
        for k in range(groups * groups):
            cables.matrix[base + k] = NONE
        for g in range(groups):
            cables.answer[first + g] = NONE
        for k in range(count):
            seg = cables.chain[first + k]
            g = cables.group[seg]
            place = base + g * groups + g
            if cables.slack[seg]:
                cables.matrix[place] = wp.float64(1.0)
                continue
            cables.answer[first + g] = cables.answer[first + g] + cables.load[seg]
            soft = softness_of(cluster, seg, h, cables)
            cables.matrix[place] = cables.matrix[place] + soft * cables.weight[seg]
            for j in range(count):
                other = cables.chain[first + j]
                if not cables.slack[other]:
                    place = base + g * groups + cables.group[other]
                    moved = mobility_of(cluster, seg, other, cables) * cables.weight[other]
                    cables.matrix[place] = cables.matrix[place] + moved
        for k in range(groups):
            best = int(k)
            for i in range(k + 1, groups):
                if wp.abs(cables.matrix[base + i * groups + k]) > wp.abs(
                    cables.matrix[base + best * groups + k]
                ):
                    best = i
            if best != k:
                for j in range(groups):
                    kept = cables.matrix[base + k * groups + j]
                    cables.matrix[base + k * groups + j] = cables.matrix[base + best * groups + j]
                    cables.matrix[base + best * groups + j] = kept
                kept = cables.answer[first + k]
                cables.answer[first + k] = cables.answer[first + best]
                cables.answer[first + best] = kept
            pivot = cables.matrix[base + k * groups + k]
            if pivot == NONE:
                continue
            for i in range(k + 1, groups):
                factor = cables.matrix[base + i * groups + k] / pivot
                if factor != NONE:
                    for j in range(k, groups):
                        left = cables.matrix[base + i * groups + j]
                        left -= factor * cables.matrix[base + k * groups + j]
                        cables.matrix[base + i * groups + j] = left
                    lower = cables.answer[first + i] - factor * cables.answer[first + k]
                    cables.answer[first + i] = lower
        for i in range(groups):
            k = groups - 1 - i
            value = cables.answer[first + k]
            for j in range(k + 1, groups):
                value -= cables.matrix[base + k * groups + j] * cables.answer[first + j]
            pivot = cables.matrix[base + k * groups + k]
            cables.answer[first + k] = wp.where(pivot == NONE, NONE, value / pivot)
        most = wp.float64(0.0)
        for k in range(count):
            seg = cables.chain[first + k]
            pull = cables.answer[first + cables.group[seg]] * cables.weight[seg]
            cables.pull[seg] = wp.where(cables.slack[seg], NONE, pull)
            most = wp.max(most, pull)
        return most

    @wp.func
    def tauten(cluster: int, count: int, h: float, cables: wp.ref[CableWork]) -> bool:
        """Makes groups slack that would push, and slack ones taut that are too long.

        Returns whether there was one.
        """
        first = cables.first_row[cluster]
        is_changed = bool(False)
        start = int(0)
        while start < count:
            group = cables.group[cables.chain[first + start]]
            stop = int(start)
            sum = wp.float64(0.0)
            hidden = wp.float64(0.0)
            while (
                stop < count
                and cables.group[cables.chain[first + wp.min(stop, count - 1)]] == group
            ):
                seg = cables.chain[first + stop]
                hidden += HIDDEN * wp.float64(cables.rest[seg])
                if cables.slack[seg]:
                    sum += excess(cluster, seg, count, h, cables)
                stop += 1
            seg = cables.chain[first + start]
            pushes = cables.pull[seg] < NONE
            if pushes or (cables.slack[seg] and sum > hidden):
                is_changed = True
                for k in range(start, stop):
                    seg = cables.chain[first + k]
                    cables.slack[seg] = pushes
                    cables.pull[seg] = wp.max(cables.pull[seg], NONE)
            start = stop
        return is_changed

    @wp.func
    def let_slip(
        cluster: int, count: int, most: wp.float64, h: float, cables: wp.ref[CableWork]
    ) -> bool:
        """Lets cables slip where friction would hold too much, and holds them where it would push.

        Returns whether there was such a guide.
        """
        first = cables.first_row[cluster]
        is_changed = bool(False)
        slipped = wp.float64(0.0)
        for k in range(1, count):
            last = cables.chain[first + k - 1]
            seg = cables.chain[first + k]
            guide = cables.left[seg]
            slipped += excess(cluster, last, count, h, cables)
            if cables.right[last] != guide:
                slipped = NONE
                continue
            slip = cables.slip[guide]
            if slip == STICKS:
                slipped = NONE
                if not (cables.guides[guide].kind == ANCHOR):
                    ratio = wp.exp(cables.ratio[guide])
                    little = LITTLE * most
                    if cables.pull[last] > ratio * cables.pull[seg] + little:
                        cables.slip[guide] = TO_LEFT
                        is_changed = True
                    elif cables.pull[seg] > ratio * cables.pull[last] + little:
                        cables.slip[guide] = TO_RIGHT
                        is_changed = True
            elif not (slip == FREELY) and not cables.slack[seg]:
                against = wp.where(slip == TO_LEFT, -slipped, slipped)
                if against > HIDDEN * wp.float64(cables.rest[seg]):
                    cables.slip[guide] = STICKS
                    is_changed = True
        return is_changed

    @wp.func
    def solve_cluster(cluster: int, recovery: float, s: wp.ref[Solver]) -> float:
        """After a sweep: the tensions with which the next one closes what it has left.

        With a ``recovery`` above zero cables that were too long at the start of the step shorten,
        too. Returns the square of the largest change of a segment to come [m^2]; zero where
        rounding hides it.
        """
        cables = s.tree.cables
        h = s.history.step[cables.world[cluster]]
        first = cables.first_row[cluster]
        for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
            measure_cable(cables.cables[i], cables, s)
        count = list_rows(cluster, recovery, cables)
        for k in range(count):
            measure_row(cluster, cables.chain[first + k], s)
        for k in range(count):
            seg = cables.chain[first + k]
            # how far it would be beyond its target if none of them pulled
            load = cables.stretch[seg]
            load -= law.relaxed(cables.compliance[seg], cables.damping[seg], h, cables.start[seg])
            if recovery == 0.0:
                load -= cables.misfit[seg]
            own = KEPT * mobility_of(cluster, seg, seg, cables)
            load += own * wp.float64(cables.tension[seg])
            for j in range(count):
                other = cables.chain[first + j]
                pull = wp.float64(cables.tension[other])
                load += mobility_of(cluster, seg, other, cables) * pull
            cables.load[seg] = load
        for _trial in range(2 * count + TRIALS):
            groups = form_groups(cluster, count, cables)
            most = solve_groups(cluster, count, groups, h, cables)
            if not tauten(cluster, count, h, cables):
                if not let_slip(cluster, count, most, h, cables):
                    break
        largest = wp.float64(0.0)
        is_new = bool(False)
        for k in range(count):
            seg = cables.chain[first + k]
            moved = wp.float64(0.0)
            for j in range(count):
                other = cables.chain[first + j]
                change = cables.pull[other] - wp.float64(cables.tension[other])
                moved += mobility_of(cluster, seg, other, cables) * change
            moved = wp.abs(moved)
            largest = wp.max(largest, moved)
            reach = float(0.0)
            for side in range(2):
                slot = slot_at(seg, side, cables)
                if s.work.inv_mass[slot] > 0.0:
                    reach += reach_of(s.work.increment[slot], cables.arm[2 * seg + side])
            if moved > ROUNDING * wp.float64(reach):
                is_new = True
        for k in range(count):
            seg = cables.chain[first + k]
            cables.tension[seg] = wp.float32(cables.pull[seg])
            if recovery == 0.0:
                cables.kept[seg] = cables.tension[seg]
        pull_cluster(cluster, s.work, cables)
        if is_new:
            return wp.float32(largest * largest)
        return 0.0

    @wp.func
    def has_jerked(cluster: int, scale: WorldScale, cables: wp.ref[CableWork]) -> bool:
        """Whether a tension has changed by more than smooth forces do within a step."""
        change = wp.float64(JOLT * scale.gravity * scale.h * scale.h)
        for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
            cable = cables.cables[i]
            for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
                if cables.active[seg] == 1:
                    before = cables.before[seg]
                    after = cables.tension[seg]
                    little = wp.float64(JOLT * wp.max(before, after))
                    own = mobility_of(cluster, seg, seg, cables)
                    if own * (wp.float64(wp.abs(after - before)) - little) > change:
                        return True
        return False

    @wp.func
    def give_back(cluster: int, s: wp.ref[Solver]):
        """After the recovery: the tensions of the motion."""
        cables = s.tree.cables
        for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
            cable = cables.cables[i]
            for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
                cables.tension[seg] = cables.kept[seg]
        pull_cluster(cluster, s.work, cables)

    return CableFunctions(begin_cluster, solve_cluster, has_jerked, give_back)


def make_join(join: Any) -> wp.Function:
    """Device function: makes one island of bodies that the cables of a cluster pull."""

    @wp.func
    def join_cluster(cluster: int, s: wp.ref[Solver]):
        cables = s.tree.cables
        for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
            cable = cables.cables[i]
            for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
                if cables.active[seg] == 1 and cables.tension[seg] > 0.0:
                    a = slot_at(seg, 0, cables)
                    b = slot_at(seg, 1, cables)
                    if s.work.inv_mass[a] > 0.0:
                        join(a, b, s)
                    elif s.work.inv_mass[b] > 0.0:
                        join(b, a, s)

    return join_cluster
