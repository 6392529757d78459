# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Spins of fast long bodies, less what their joints lock."""

import warp as wp

from ..algebra.so3 import world_inertia
from ..data import BodyWork, Solver, Step
from ..effects import Effects
from ..rows.lock import make_locks
from .anchors import anchor_rotation, is_linked, parent_slot
from .bodies import body_at
from .rotations import COUNTED

WIDE = wp.constant(0.8)
"""Moment across an axis, of that about it, up to which a spin keeps to the axis at any speed."""


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
def turning_mobility(body: int, s: wp.ref[Solver]) -> wp.mat33:
    """What a torque does to the spin of a body after the increments [1/(kg m^2)], world axes."""
    if s.work.inv_mass[body] == 0.0:
        return wp.mat33(0.0)
    return world_inertia(s.tree.rotation[body], s.model.inv_inertia[body])


def make_align_spins(effects: Effects) -> wp.Function:
    """Device function: takes what joints lock from the spins of a range of bodies."""
    angular_lock = make_locks(effects.kinds).angular_lock

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

    return align_spins
