# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a user may ask for beside poses and velocities, written after the step."""

import functools

import warp as wp

from ..blocks.tree import handed_down
from ..data import BodyWork, History, JointModel, RowWork, Solver, Step
from ..effects import Effects
from ..rows.angle import counted, reduced
from ..rows.euler import nearest_angles
from ..rows.joint import has_axes, is_skew
from .anchors import is_linked
from .drag import resistance
from .kernels import KERNEL, uncollected
from .loops import make_loops
from .tendons import load_tendons


@wp.kernel(**KERNEL)
def export_acceleration(
    # State out:
    body_qd_out: wp.array[wp.spatial_vector],
    h: float,
    # Out:
    body_qdd: wp.array[wp.spatial_vector],
):
    """Turns the velocities at the start of the step, left in ``body_qdd``, into accelerations."""
    body = wp.tid()
    body_qdd[body] = (body_qd_out[body] - body_qdd[body]) / h


@wp.func
def row_torque(i: int, rows: wp.ref[RowWork]) -> wp.vec3:
    """Torque of a row's torsional and rolling friction on its body b [N m]."""
    if rows.spin.shape[0] == 0:
        return wp.vec3(0.0)
    return rows.spin[i].torque


@wp.func
def contact_wrench(i: int, work: wp.ref[BodyWork], rows: wp.ref[RowWork]):
    """Index of a row's contact; force [N] on its body 0 and torque [N m] about the COM of that."""
    row = rows.rows[i]
    torque = row_torque(i, rows)
    if row.contact >= 0:
        torque += wp.cross(row.arm, row.force)
        return row.contact, wp.spatial_vector(-row.force, -torque)
    arm = row.arm + (work.com[row.a] - work.com[row.b])
    torque += wp.cross(arm, row.force)
    return ~row.contact, wp.spatial_vector(row.force, torque)


@wp.kernel(**KERNEL)
def export_contact_force(
    # Work:
    work: BodyWork,
    rows: RowWork,
    # Out:
    contact_f: wp.array[wp.spatial_vector],
):
    """Force [N] on body 0 of each contact and torque [N m] about its COM; one thread a body."""
    body = wp.tid()
    for i in range(rows.owned_start[body], rows.owned_end[body]):
        contact, wrench = contact_wrench(i, work, rows)
        if contact < contact_f.shape[0]:
            contact_f[contact] = wrench


@functools.cache
@uncollected()
def make_export_parent_force(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a world: the wrench that each body gets through its inbound joints."""
    loop_wrench = make_loops(effects).loop_wrench

    @wp.kernel(**KERNEL)
    def export_parent_force(
        body_parent_f: wp.array[wp.spatial_vector], step: Step, s: wp.array[Solver]
    ):
        """What holds a subtree is what its bodies lack: momentum that no other force gave.

        Where welds make bodies of links it goes to ``body_parent_f`` by joint, not by child.
        """
        world = wp.tid()
        if wp.static(effects.sleeping):
            if world >= s[0].worlds.island_start[s[0].worlds.island_start.shape[0] - 1]:
                return
        first = s[0].worlds.body_start[world]
        end = s[0].worlds.body_start[world + 1]
        h = step.h
        if wp.static(effects.second_order):
            h = s[0].worlds.step[world]
        inv_h2 = 1.0 / (h * h)
        for i in range(first, end):
            body = s[0].worlds.bodies[i]
            if wp.static(effects.sleeping and not effects.welds):
                # of what sleeps, the last force stays
                body_parent_f[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            lacking = h * step.body_qd_out[body] - s[0].work.target[body]
            if wp.static(effects.second_order):
                lacking += s[0].work.lead[body]
            wrench = wp.spatial_vector(
                (s[0].model.mass[body] * inv_h2) * wp.spatial_top(lacking),
                inv_h2 * (s[0].work.inertia[body] * wp.spatial_bottom(lacking)),
            )
            if wp.static(effects.drag):
                wrench += resistance(s[0].work.drag[body], lacking / h)
            if wp.static(effects.cables):
                wrench -= s[0].tree.cables.wrench[body]
            if s[0].work.inv_mass[body] == 0.0:
                wrench = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            if wp.static(effects.contact):
                for k in range(s[0].rows.owned_start[body], s[0].rows.owned_end[body]):
                    row = s[0].rows.rows[k]
                    torque = wp.cross(row.arm, row.force) + row_torque(k, s[0].rows)
                    wrench += wp.spatial_vector(row.force, torque)
            if wp.static(effects.pairs):
                for k in range(s[0].rows.other_start[body], s[0].rows.other_end[body]):
                    row = s[0].rows.rows[s[0].rows.other_rows[k]]
                    arm = row.arm + (s[0].work.com[row.a] - s[0].work.com[body])
                    torque = wp.cross(arm, row.force) + row_torque(
                        s[0].rows.other_rows[k], s[0].rows
                    )
                    wrench -= wp.spatial_vector(row.force, torque)
            s[0].tree.load[body] = wrench
        if wp.static(effects.spatial_tendons):
            for i in range(first, end):
                load_tendons(i, -1.0, s[0])
        if wp.static(effects.loops):
            for i in range(s[0].loops.world_start[world], s[0].loops.world_start[world + 1]):
                joint = s[0].loops.joints[i]
                child = s[0].joints.child[joint]
                force, torque, arm_c, arm_p = loop_wrench(i, 0.0, h, False, True, step, s[0])
                push = wp.spatial_vector(force, torque + wp.cross(arm_c, force))
                s[0].tree.load[child] = s[0].tree.load[child] - push
                parent = s[0].joints.parent[joint]
                if parent >= 0:
                    pull = wp.spatial_vector(force, torque + wp.cross(arm_p, force))
                    s[0].tree.load[parent] = s[0].tree.load[parent] + pull
                at = wp.where(wp.static(effects.welds), joint, child)
                body_parent_f[at] = body_parent_f[at] + push
        for i in range(end - first):
            body = s[0].worlds.bodies[end - 1 - i]
            if s[0].work.inv_mass[body] > 0.0 and is_linked(body, s[0]):
                load = s[0].tree.load[body]
                parent = s[0].tree.parent[body]
                handed = handed_down(s[0].tree.span[body], load)
                s[0].tree.load[parent] = s[0].tree.load[parent] + handed
                child = s[0].joints.child[s[0].tree.joint[body]]
                at = wp.where(wp.static(effects.welds), s[0].tree.joint[body], child)
                if child == body:
                    body_parent_f[at] = body_parent_f[at] + load
                else:
                    body_parent_f[at] = body_parent_f[at] - handed
        # the sweeps of the next step start from zero
        for i in range(first, end):
            s[0].tree.load[s[0].worlds.bodies[i]] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))

    return export_parent_force


@wp.kernel(**KERNEL)
def count_turns(
    # Model:
    joints: JointModel,
    # Work:
    history: History,
    # State out:
    joint_q_out: wp.array[float],
    joint_qd_out: wp.array[float],
):
    """Puts the turns back into the angles that inverse kinematics wraps; one thread a joint.

    Of the two solutions that a gimbal's pose has inverse kinematics knows one. The joint is at the
    one nearest to where the step began.
    """
    joint = wp.tid()
    if not has_axes(joints, joint):
        return
    linear = joints.dof_dim[joint, 0]
    if joints.dof_dim[joint, 1] == 3:
        first = joints.dof_start[joint] + linear
        coord = joints.coord_start[joint] + linear
        found = wp.vec3()
        known = wp.vec3()
        for dof in range(3):
            found[dof] = joint_q_out[coord + dof]
            known[dof] = reduced(history.joint_angle[first + dof])
        across = wp.cross(joints.axis[first], joints.axis[first + 1])
        parallel = wp.sin(found[1]) * wp.dot(across, joints.axis[first + 2])
        angles = nearest_angles(found, known, parallel, False)
        if is_skew(joints, first):
            angles = known  # inverse kinematics takes axes for square to each other
        if wp.cos(angles[1]) < 0.0:
            joint_qd_out[first + 1] = -joint_qd_out[first + 1]
        for dof in range(3):
            joint_q_out[coord + dof] = angles[dof]
    for dof in range(linear, linear + joints.dof_dim[joint, 1]):
        index = joints.dof_start[joint] + dof
        coord = joints.coord_start[joint] + dof
        angle = counted(joint_q_out[coord], history.joint_angle[index])
        joint_q_out[coord] = wp.float32(angle)
        history.joint_angle[index] = angle
