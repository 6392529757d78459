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

How C(x) is measured is in :mod:`.step.cable_segments`, A in :mod:`.step.cable_mobility`, which
segments are slack and where cables slip in :mod:`.step.tensions`, what cables pull bodies with in
:mod:`.step.cable_pull`.
"""

from typing import Any

import warp as wp

from ..data import CableWork, Solver, WorldScale
from ..effects import Effects
from ..rows import cable as law
from .cable_mobility import KEPT, make_measure_row, mobility_between
from .cable_pull import pull_cluster
from .cable_segments import (
    NONE,
    end_segment,
    first_segment,
    is_inextensible,
    is_joined,
    measure_cable,
    slot_at,
)
from .islands import HELD
from .tensions import form_groups, let_slip, list_rows, solve_groups, tauten

ROUNDING = wp.constant(wp.float64(1.0e-7))
"""Change of a segment that counts as none, of how far its ends move in the step."""
OPEN = wp.constant(wp.float64(1.0e-6))
"""Stretch of an inextensible segment that is left alone, of its length."""
TRIALS = wp.constant(8)
"""Most trials of what is slack and what slips, beyond two for each segment."""
JOLT = wp.constant(0.25)
"""Change of a tension in a step that is a jump, as a share of itself and, by what it moves, of
g h^2."""
ROUNDED = wp.constant(wp.float64(1.0e-6))
"""Share of its material by which the rounding of poses may change the length of a taut segment."""


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
                own = mobility_between(cluster, seg, seg, cables)
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


def make_solve_cluster(effects: Effects) -> wp.Function:
    """Device function: the tensions of cables after a sweep."""
    measure_row = make_measure_row(effects)

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
            own = KEPT * mobility_between(cluster, seg, seg, cables)
            load += own * wp.float64(cables.tension[seg])
            for j in range(count):
                other = cables.chain[first + j]
                pull = wp.float64(cables.tension[other])
                load += mobility_between(cluster, seg, other, cables) * pull
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
                moved += mobility_between(cluster, seg, other, cables) * change
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

    return solve_cluster


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
                        join(a, b, HELD, s)
                    elif s.work.inv_mass[b] > 0.0:
                        join(b, a, HELD, s)

    return join_cluster
