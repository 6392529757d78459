# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How far a unit of tension of one segment shortens each of its cluster: A = W^T H^-1 W.

The blocks H are as they have been factored, articulations as a whole: each segment takes a pass
through its trees.
"""

import warp as wp

from ..algebra.block import half_solve, other_half
from ..blocks.tree import carried, handed_down
from ..data import CableWork, Solver
from ..effects import Effects
from ..rows import cable as law
from ..rows.joint import make_counts
from .anchors import is_linked
from .cable_segments import NONE, end_segment, first_segment, slot_at

KEPT = wp.constant(wp.float64(3.0e-6))
"""Softness by which a segment keeps to its tension from sweep to sweep, of its mobility. It decides
how cables share a load where nothing else does. Rounding is 1e-7 of a mobility."""


@wp.func
def mobility_between(cluster: int, row: int, column: int, cables: wp.ref[CableWork]) -> wp.float64:
    """How far a unit of tension of one segment shortens another one [m/N]."""
    place = cables.matrix_start[cluster] + cables.row[row] * cables.size[cluster]
    return cables.mobility[place + cables.row[column]]


@wp.func
def whole_softness(cluster: int, seg: int, h: float, cables: wp.ref[CableWork]) -> wp.float64:
    """Softness of a segment, and of what keeps it to its tension so far [m/N]."""
    soft = law.softness(cables.compliance[seg], cables.damping[seg], h)
    return soft + KEPT * mobility_between(cluster, seg, seg, cables)


def make_measure_row(effects: Effects) -> wp.Function:
    """Device function: measures what a tension moves, by the last elimination of the blocks."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count

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

    return measure_row
