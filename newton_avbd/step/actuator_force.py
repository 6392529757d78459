# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The observable ``qfrc_actuator``: what drives and MuJoCo's actuators push joints with.

A force is its law at the end of the step, which is what a step of backward Euler pushed with.
"""

import warp as wp

from ..data import AxisPush, BodyActuation, ControlInput, JointModel, TendonModel
from ..rows.axis import away_from, drive, most_effort, pushed, pushed_within, ranged
from ..rows.joint import BALL, ball_away, has_axes
from ..rows.path import JOINT
from .actuation import axis_of, base_rotation
from .body_actuators import pushed_by
from .kernels import KERNEL


@wp.kernel(**KERNEL)
def export_axis_force(
    # Model:
    joints: JointModel,
    has_drives: bool,
    has_limits: bool,
    # In:
    control: ControlInput,
    beside: wp.array[wp.vec2],
    # State out:
    body_q: wp.array[wp.transform],
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
    # Out:
    force: wp.array[float],
):
    """What drives and actuators push each axis with; one thread a joint of the user's model.

    ``beside`` is what :func:`.actuation.push_axis` puts there.
    """
    joint = wp.tid()
    first = joints.dof_start[joint]
    for dof in range(first, joints.dof_start[joint + 1]):
        force[dof] = 0.0
    is_ball = joints.type[joint] == BALL
    if not joints.enabled[joint] or (not has_axes(joints, joint) and not is_ball):
        return
    turn = wp.vec3(0.0)
    if is_ball and has_drives:
        start = base_rotation(joint, joints.parent, joints.parent_frame, body_q)
        end = base_rotation(joint, joints.child, joints.child_frame, body_q)
        turn = ball_away(control.target_q, joints, joint, start, end)
    for axis in range(joints.dof_start[joint + 1] - first):
        dof = first + axis
        rate = joint_qd[dof]
        q = wp.float64(0.0)
        if not is_ball:
            q = wp.float64(joint_q[joints.coord_start[joint] + axis])
        bound = float(0.0)
        free = float(0.0)
        most = float(wp.inf)
        if has_limits:
            most = most_effort(joints, dof)
        least = -most
        # a rate is how far an axis moves in a second
        if has_drives:
            away = away_from(control.target_q, joints, joint, axis, q, turn)
            push, _slope = drive(joints, control, dof, away, rate, 1.0)
            bound += push
        if control.pushes.shape[0] > 0:
            push, _slope = pushed(control, dof, q, rate, 1.0)
            free += push - beside[dof][0] + beside[dof][1] * rate
            push, _slope = pushed_within(control, dof, q, rate, 1.0)
            bound += push
            if control.ranged.shape[0] > 0:
                push, _slope = ranged(control, dof, q, rate, 1.0)
                bound += push
            least = wp.max(least, control.pushes[dof].least)
            most = wp.min(most, control.pushes[dof].most)
        total = free + wp.clamp(bound, least, most)
        # of controls that are not finite, with which the world is frozen, nothing acts
        force[dof] = wp.where(wp.isfinite(total), total, 0.0)


@wp.kernel(**KERNEL)
def add_compensation(
    # In:
    dofs: wp.array[wp.int32],
    compensation: wp.array[float],
    # Out:
    force: wp.array[float],
):
    """Adds the compensation of gravity by actuators without a limit; one thread an axis."""
    i = wp.tid()
    force[dofs[i]] = force[dofs[i]] + compensation[i]


@wp.kernel(**KERNEL)
def clear_force(force: wp.array[float]):
    """Sets forces to zero; one thread a degree of freedom."""
    force[wp.tid()] = 0.0


@wp.func
def pull_of(push: AxisPush, beside: wp.vec2, length: float, velocity: float) -> float:
    """What actuators pull a tendon with, along its length [N or N m]."""
    free = push.force - beside[0] - push.stiffness * length
    free -= (push.damping - beside[1]) * velocity
    bound = push.drive - push.drive_stiffness * length - push.drive_damping * velocity
    return free + wp.clamp(bound, push.least, push.most)


@wp.kernel(**KERNEL)
def export_transmitted_force(
    # Model:
    joints: JointModel,
    com: wp.array[wp.vec3],
    tendons: TendonModel,
    tendon_start: wp.array[wp.int32],
    tendon_items: wp.array[wp.int32],
    link_start: wp.array[wp.int32],
    links: wp.array[wp.int32],
    joint_start: wp.array[wp.int32],
    joint_items: wp.array[wp.int32],
    # In:
    work: BodyActuation,
    item_start: wp.array[wp.int32],
    items: wp.array[wp.int32],
    beside: wp.array[wp.vec2],
    # State out:
    body_q: wp.array[wp.transform],
    joint_q: wp.array[float],
    # Out:
    load: wp.array[wp.spatial_vector],
    force: wp.array[float],
):
    """Adds what actuators push joints with by tendons and on links; one thread a world.

    Wrenches on links go down their tree, from the leaves: parents stand before children.
    """
    world = wp.tid()
    for k in range(link_start[world], link_start[world + 1]):
        link = links[k]
        load[link] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        if item_start.shape[0] > 0:
            center = wp.transform_point(body_q[link], com[link])
            load[link] = pushed_by(link, center, work, item_start, items)
    for k in range(tendon_start[world], tendon_start[world + 1]):
        i = tendon_items[k]
        if tendons.row_start[i] == tendons.row_start[i + 1]:
            continue
        length = wp.float32(tendons.length[i])
        pull = pull_of(tendons.push[i], beside[i], length, tendons.velocity[i])
        first = tendons.start[i]
        if not wp.isfinite(pull):
            continue
        if tendons.kind[first] == JOINT:
            for e in range(first, tendons.start[i + 1]):
                force[tendons.dof[e]] = force[tendons.dof[e]] + tendons.value[e] * pull
            continue
        for s in range(first, tendons.span_end[i]):
            span = tendons.spans[s]
            for side in range(2):
                link = tendons.link[wp.where(side == 0, span.a, span.b)]
                if link >= 0:
                    point = wp.where(side == 0, span.start, span.end)
                    along = wp.where(side == 0, -span.share, span.share) * pull * span.along
                    arm = point - wp.transform_point(body_q[link], com[link])
                    load[link] = load[link] + wp.spatial_vector(along, wp.cross(arm, along))
    last = joint_start[world + 1] - 1
    for k in range(last - joint_start[world] + 1):
        joint = joint_items[last - k]
        child = joints.child[joint]
        parent = joints.parent[joint]
        push = wp.spatial_top(load[child])
        moment = wp.spatial_bottom(load[child])
        center = wp.transform_point(body_q[child], com[child])
        first = joints.dof_start[joint]
        if not has_axes(joints, joint) and joints.type[joint] != BALL:
            # the wrench at the COM of the child
            for dof in range(6):
                if wp.isfinite(load[child][dof]):
                    force[first + dof] = force[first + dof] + load[child][dof]
        else:
            end = wp.transform_multiply(body_q[child], joints.child_frame[joint])
            about = moment + wp.cross(center - wp.transform_get_translation(end), push)
            base = base_rotation(joint, joints.parent, joints.parent_frame, body_q)
            coordinate = joints.coord_start[joint]
            turning = first + joints.dof_dim[joint, 0]
            for dof in range(first, joints.dof_start[joint + 1]):
                share = float(0.0)
                if joints.type[joint] == BALL:
                    share = wp.quat_rotate_inv(base, about)[dof - first]
                else:
                    at = coordinate + dof - first
                    axis = axis_of(dof, wp.min(turning, dof), base, joints.axis, joint_q, at)
                    share = wp.dot(axis, wp.where(dof < turning, push, about))
                if wp.isfinite(share):
                    force[dof] = force[dof] + share
        if parent >= 0:
            arm = center - wp.transform_point(body_q[parent], com[parent])
            load[parent] = load[parent] + wp.spatial_vector(push, moment + wp.cross(arm, push))
