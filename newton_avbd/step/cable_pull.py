# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What cables pull their bodies with, by their tensions, and the curvature of that."""

import warp as wp

from ..blocks.tree import geometric_stiffness
from ..data import BodyWork, CableWork
from ..rows.cable import ROLLER
from .cable_segments import end_segment, first_segment, slot_at

LEAST_LENGTH = wp.constant(1.0e-6)
"""Length of a segment below which its geometric stiffness does not grow any more [m]."""


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
