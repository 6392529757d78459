# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints that break under what they carry; from the next step on they are as if disabled."""

import warp as wp

from ..blocks.tree import handed_down
from ..data import Solver, Step
from ..effects import Effects
from ..functions import Functions, together
from ..rows.lock import make_locks
from .anchors import anchor_arm, anchor_rotation, is_linked
from .eliminate import held_by_loops
from .kernels import KERNEL
from .tendons import load_tendons


@wp.kernel(**KERNEL)
def enable_joints(
    # Model:
    enabled: wp.array[wp.bool],
    # In:
    broken: wp.array[wp.bool],
    # Out:
    is_whole: wp.array[wp.bool],
):
    """Which joints hold in the step: enabled and not broken; one thread a joint."""
    joint = wp.tid()
    is_whole[joint] = enabled[joint] and not broken[joint]


@wp.func
def break_joint(joint: int, force: wp.vec3, torque: wp.vec3, s: wp.ref[Solver]):
    """Breaks a joint that carries more than it may."""
    most_force = s.joints.break_force[joint]
    most_torque = s.joints.break_torque[joint]
    if wp.length(force) > most_force or wp.length(torque) > most_torque:
        s.history.broken[joint] = True


def make_break_joints(effects: Effects, gather: wp.Function) -> Functions:
    """Device functions for the joints of trees, and for one outside of them.

    Args:
        effects: What the kernel is compiled with.
        gather: Device function that sums what pulls a body beside its joints and tendons.
    """
    locks = make_locks(effects.kinds)
    linear_misfit, angular_lock = locks.linear_misfit, locks.angular_lock

    @wp.func
    def carried_load(body: int, load: wp.spatial_vector, static_slot: int, s: wp.ref[Solver]):
        """Force and torque at its anchor with which a joint holds a load, along what it locks."""
        joint = s.tree.joint[body]
        child = s.joints.child[joint]
        frame = s.joints.child_frame[joint]
        parent = s.tree.parent[body]
        if child != body:
            frame = s.joints.parent_frame[joint]
            parent = body
        arm = anchor_arm(body, frame, static_slot, s)
        q_p = anchor_rotation(s.tree, parent, s.joints.parent_frame[joint])
        q_c = anchor_rotation(s.tree, child, s.joints.child_frame[joint])
        force = wp.spatial_top(load)
        torque = wp.spatial_bottom(load) - wp.cross(arm, force)
        return (
            linear_misfit(s.joints, joint, q_p, force),
            angular_lock(s.joints, joint, q_p, q_c) * torque,
        )

    @wp.func(inline=effects.inline)
    def break_blocks(first: int, end: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """Breaks joints of the trees of the bodies from ``first`` to ``end``.

        What a joint of a tree holds is what all bodies above it lack: momentum that no other force
        gave.
        """
        static_slot = s.work.inv_mass.shape[0] - 1
        if wp.static(effects.spatial_tendons):
            for i in range(first, end):
                load_tendons(i, 1.0, s)
        for i in range(end - first):
            body = s.worlds.bodies[end - 1 - i]
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                load = s.tree.load[body] + gather(body, False, 0.0, 0.0, h, step, s)
                if wp.static(effects.closures and effects.loops):
                    held, _ = held_by_loops(body, s)
                    load += held
                parent = s.tree.parent[body]
                if s.work.inv_mass[parent] > 0.0:
                    handed = handed_down(s.tree.span[body], load)
                    s.tree.load[parent] = s.tree.load[parent] + handed
                force, torque = carried_load(body, load, static_slot, s)
                break_joint(s.tree.joint[body], force, torque, s)
            # the sweeps start from zero
            s.tree.load[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))

    @wp.func
    def break_loop(i: int, s: wp.ref[Solver]):
        """Breaks a joint outside of trees, which holds its multiplier."""
        joint = s.loops.joints[i]
        if s.loops.k_l[i] > 0.0:
            break_joint(joint, s.history.loop_force[i], s.history.loop_torque[i], s)

    return together(break_blocks, break_loop)
