# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Equations between the bodies of a tree, solved with it: joints that close loops, mimics, tendons.

What they are is in :mod:`.step.loop_rows`, :mod:`.step.strings`, :mod:`.step.mimics` and
:mod:`.step.tendons`, how they are eliminated in :mod:`.blocks.closure`.
"""

import warp as wp

from ..data import BodyWork, Solver
from ..effects import Effects
from ..functions import Functions, together
from ..rows.joint import ROD, is_string, make_counts
from .anchors import parent_slot
from .kernels import ABSENT, absent
from .loop_rows import ALL_ROWS, make_loop_rows
from .mimics import make_join_mimics, make_mimics
from .rod_rows import make_rod_rows
from .stop_rows import make_stop_rows
from .strings import make_string_rows, string_misses
from .tendons import make_join_tendons, make_tendons


@wp.func
def stiffness_off(
    body: int, reach: float, change: float, force: float, h: float, work: wp.ref[BodyWork]
) -> float:
    """How far a force [N] was off in the geometric stiffness of a body, as a share of the block.

    Args:
        body: The body.
        reach: Distance of its COM from where the force acts [m].
        change: By how much the force has changed in the sweep.
        force: What it is now.
        h: Time step [s].
        work: The bodies.
    """
    if work.inv_mass[body] == 0.0:
        return 0.0
    return reach * change / (wp.trace(work.inertia[body]) / (h * h) + reach * force)


def make_join_closures(effects: Effects, join: wp.Function) -> wp.Function:
    """Device function that makes one island of what tendons and mimics of a block tie."""
    join_tendons = make_join_tendons(join) if effects.tendons else absent
    join_mimics = make_join_mimics(join) if effects.mimics else absent

    @wp.func
    def join_closures(first: int, s: wp.ref[Solver]):
        if wp.static(effects.tendons):
            join_tendons(first, s)
        if wp.static(effects.mimics):
            join_mimics(first, s)

    return join_closures


def make_closures(effects: Effects) -> Functions:
    """Device functions of what ties the bodies of a block, beside the joints of its tree."""
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    loop_rows = make_loop_rows(effects) if effects.loops else absent
    string_rows = make_string_rows(effects) if effects.kinds.distances else absent
    rod_rows = make_rod_rows(effects) if effects.rods else absent
    has_stops = effects.loops and effects.stops
    stops = make_stop_rows(effects) if has_stops else ABSENT
    stop_rows, keep_stops = stops.stop_rows, stops.keep_stops
    mimics = make_mimics(effects) if effects.mimics else ABSENT
    mimic_rows = mimics.mimic_rows
    tendons = make_tendons(effects) if effects.tendons else ABSENT
    tendon_row = tendons.tendon_row

    @wp.func(inline=effects.inline)
    def begin_rows(first: int, end: int, recovery: float, h: float, s: wp.ref[Solver]):
        """Before elimination: the rows of a block where they start their ways."""
        closures = s.tree.closures
        number = closures.block_of[first]
        if number < 0:
            return
        block = closures.blocks[number]
        none = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        turned = float(0.0)
        if wp.static(effects.loops):
            for i in range(first, end):
                update = s.tree.update[s.worlds.bodies[i]]
                turned = wp.max(turned, wp.length_sq(wp.spatial_bottom(update)))
        for k in range(block.gram, block.gram_end):
            closures.gram[k] = wp.float64(0.0)
        for i in range(first, end):
            body = s.worlds.bodies[i]
            node = closures.nodes[body]
            for p in range(node.start, node.stop):
                closures.met[p] = none
            if wp.static(effects.spatial_tendons):
                s.tree.tendons.root_curvature[body] = none
                if s.tree.joint[body] >= 0:
                    joint = s.tree.joint[body]
                    for dof in range(
                        linear_count(s.joints, joint) + angular_count(s.joints, joint)
                    ):
                        s.tree.tendons.curvature[s.tree.axis_start[body] + dof] = 0.0
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            for row in range(closure.row, closure.row + closure.rows):
                closures.way[2 * row] = none
                closures.way[2 * row + 1] = none
                closures.whole[row] = 0.0
                closures.stopped[row] = 0.0
                closures.least[row] = 0.0
                closures.gives[row] = 0.0
                closures.held[row] = 0.0
                closures.most[row] = 0.0
                closures.loosened[row] = 0.0
                closures.multiplier[row] = wp.float64(0.0)
            if closure.loop >= 0:
                is_bound = bool(False)
                if wp.static(effects.kinds.distances):
                    is_bound = is_string(s.joints, s.loops.joints[closure.loop])
                    if is_bound:
                        string_rows(closure, recovery, s)
                if wp.static(effects.rods):
                    if s.joints.type[s.loops.joints[closure.loop]] == ROD:
                        is_bound = True
                        rod_rows(closure, h, s)
                if wp.static(effects.loops):
                    if not is_bound:
                        loop_rows(closure, recovery, s)
                        if wp.static(has_stops):
                            if closure.rows == ALL_ROWS:
                                stop_rows(closure, recovery, h, s)
                        for row in range(closure.row, closure.row + closure.rows):
                            closures.loosened[row] = turned * closures.least[row]
            else:
                is_cord = bool(False)
                if wp.static(effects.tendons):
                    is_cord = closure.tendon >= 0
                    if is_cord:
                        rank = s.worlds.rank
                        tendon_row(closure, recovery, h, rank, s)
                if wp.static(effects.mimics):
                    if not is_cord:
                        mimic_rows(closure, recovery, s)

    @wp.func
    def keep_forces(
        first: int, is_first: bool, recovery: float, h: float, s: wp.ref[Solver]
    ) -> float:
        """After substitution: what the joints of a block that close loops push with.

        Not in the recovery, but for strings. What moves joints back is no force, and has no
        geometric stiffness: two stops that ask a loop for what does not go together would push each
        other harder from sweep to sweep, as bodies yield the less the harder they are pushed.

        Returns how far off their geometric stiffness was, as a share of the block.
        """
        closures = s.tree.closures
        mismatch = float(0.0)
        number = closures.block_of[first]
        if number < 0:
            return mismatch
        block = closures.blocks[number]
        static_slot = s.work.inv_mass.shape[0] - 1
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            i = closure.loop
            if wp.static(effects.rods):
                if i >= 0:
                    if s.joints.type[s.loops.joints[i]] == ROD:
                        # what it pushes with is told by where its ends are
                        if wp.static(effects.dahl):
                            mismatch = 1.0  # by the steepest slope there is, not by Newton's method
                        continue
            if i >= 0:
                linear = 3 - linear_count(s.joints, s.loops.joints[i])
                is_force = bool(recovery == 0.0)
                if wp.static(effects.kinds.distances):
                    if is_string(s.joints, s.loops.joints[i]):
                        linear = 3
                        is_force = bool(True)
                        off = string_misses(closure, static_slot, s)
                        mismatch = wp.max(mismatch, off)
                        if s.loops.side[i] == 0 or off == wp.inf:
                            s.history.loop_force[i] = wp.vec3(0.0)
                            continue
                force = wp.vec3(0.0)
                torque = wp.vec3(0.0)
                rows = closure.rows
                if wp.static(has_stops):
                    if rows == ALL_ROWS:
                        rows -= linear_count(s.joints, s.loops.joints[i])
                        rows -= angular_count(s.joints, s.loops.joints[i])
                        mismatch = wp.max(mismatch, keep_stops(closure, static_slot, s))
                for k in range(rows):
                    row = closure.row + k
                    along = wp.float32(closures.multiplier[row]) * closures.direction[row]
                    if k < linear:
                        force += along
                    else:
                        torque += along
                change = float(0.0)
                if is_force:
                    change = wp.length(force + s.history.loop_force[i])
                    s.history.loop_force[i] = -force
                    s.history.loop_torque[i] = -torque
                if is_first and recovery == 0.0:
                    s.loops.kept_force[i] = -force
                    s.loops.kept_torque[i] = -torque
                joint = s.loops.joints[i]
                held = wp.length(force)
                for end in range(2):
                    body = parent_slot(s.joints, joint, static_slot)
                    if end == 0:
                        body = s.joints.child[joint]
                    reach = wp.length(s.loops.arms[2 * i + end])
                    off = stiffness_off(body, reach, change, held, h, s.work)
                    mismatch = wp.max(mismatch, off)
        return mismatch

    return together(
        begin_rows,
        keep_forces,
        begin_closures=mimics.begin_closures,
        begin_tendons=tendons.begin_tendons,
        settle_tendons=tendons.settle_tendons,
    )
