# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How the rate of a spatial tendon's length changes while the joints keep their rates.

With the coordinates q of joints, v = q', and J = dL/dq, the length L of a tendon has

    L'' = J v' + J' v.

What is measured here is J' v. MuJoCo's soft limits go by J v' alone ("Computation: Constraint
model": of its constraints only CONNECT and WELD have J' v). A step of backward Euler moves a length
by its mean rate, which is half of J' v h behind that at the end. Coordinates are MuJoCo's: those of
a free body are the place of its origin and its turn.
"""

import warp as wp

from ..algebra.so3 import exp_quat
from ..data import JointModel, TendonModel, WorldScale
from ..rows.joint import BALL, has_axes
from ..rows.path import JOINT, PULLEY, ZERO, double, find_path
from .actuation import along_path, axis_of, base_rotation, frame_of_point
from .body_actuators import velocity_at
from .kernels import KERNEL

AHEAD = wp.constant(1.0e-3)
"""How far bodies coast to both sides to see how their tendons bend [s]. A body at 30 rad/s turns by
0.03 rad, which is off by 1e-4; rounding of its orientation makes 0.02 m/s^2 by a path of 0.3 m."""


@wp.func
def swung(qd: wp.spatial_vector, acceleration: wp.spatial_vector, arm: wp.vec3) -> wp.vec3:
    """Acceleration of a point of a body, ``arm`` from its COM."""
    spin = wp.spatial_bottom(qd)
    return velocity_at(acceleration, arm) + wp.cross(spin, wp.cross(spin, arm))


@wp.func
def axes_turned(
    joint: int,
    joints: wp.ref[JointModel],
    body_q: wp.array[wp.transform],
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
) -> wp.vec3:
    """How the spin of a joint changes as its axes turn each other [rad/s^2]."""
    first = joints.dof_start[joint] + joints.dof_dim[joint, 0]
    coordinate = joints.coord_start[joint] + joints.dof_dim[joint, 0]
    base = base_rotation(joint, joints.parent, joints.parent_frame, body_q)
    spin = wp.vec3(0.0)
    change = wp.vec3(0.0)
    for k in range(joints.dof_dim[joint, 1]):
        rate = joint_qd[first + k]
        more = rate * axis_of(first + k, first, base, joints.axis, joint_q, coordinate + k)
        change += wp.cross(spin, more)
        spin += more
    return change


@wp.kernel(**KERNEL)
def coast_links(
    # Model:
    joints: JointModel,
    com: wp.array[wp.vec3],
    joint_start: wp.array[wp.int32],
    joint_items: wp.array[wp.int32],
    # State in:
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
    # Out:
    coasting: wp.array[wp.spatial_vector],
):
    """Accelerations of links, of their COM, while their joints keep their rates; one thread a
    world. Parents stand before children."""
    world = wp.tid()
    for k in range(joint_start[world], joint_start[world + 1]):
        joint = joint_items[k]
        child = joints.child[joint]
        parent = joints.parent[joint]
        pose = body_q[child]
        center = wp.transform_point(pose, com[child])
        anchor = wp.transform_point(pose, wp.transform_get_translation(joints.child_frame[joint]))
        qd = body_qd[child]
        spin = wp.spatial_bottom(qd)
        place = wp.vec3(0.0)
        turn = wp.vec3(0.0)
        is_held = has_axes(joints, joint) or joints.type[joint] == BALL
        if is_held and parent >= 0:
            arm = anchor - wp.transform_point(body_q[parent], com[parent])
            base_qd = body_qd[parent]
            base_spin = wp.spatial_bottom(base_qd)
            slid = velocity_at(qd, anchor - center) - velocity_at(base_qd, arm)
            place = swung(base_qd, coasting[parent], arm) + 2.0 * wp.cross(base_spin, slid)
            turn = wp.spatial_bottom(coasting[parent]) + wp.cross(base_spin, spin)
        if joints.dof_dim[joint, 1] > 1 and has_axes(joints, joint):
            turn += axes_turned(joint, joints, body_q, joint_q, joint_qd)
        at_anchor = wp.spatial_vector(place, turn)
        coasting[child] = wp.spatial_vector(swung(qd, at_anchor, center - anchor), turn)


@wp.func
def coasted_length(
    i: int,
    time: float,
    com: wp.array[wp.vec3],
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    coasting: wp.array[wp.spatial_vector],
    tendons: wp.ref[TendonModel],
) -> wp.float64:
    """Length of a tendon after its links have coasted for a time, which is below 0 for before."""
    for k in range(tendons.start[i], tendons.start[i + 1]):
        link = tendons.link[k]
        if tendons.kind[k] != PULLEY:
            frame = frame_of_point(k, body_q, tendons)
            place = wp.transform_get_translation(frame)
            axes = wp.transform_get_rotation(frame)
            point = double(place)
            if link >= 0:
                arm = place - wp.transform_point(body_q[link], com[link])
                moved = time * velocity_at(body_qd[link], arm)
                moved += 0.5 * time * time * swung(body_qd[link], coasting[link], arm)
                point += double(moved)
                turned = time * wp.spatial_bottom(body_qd[link])
                turned += 0.5 * time * time * wp.spatial_bottom(coasting[link])
                axes = wp.normalize(exp_quat(turned) * axes)
            tendons.point[k] = point
            tendons.rotation[k] = axes
    return find_path(i, False, ZERO, tendons)


@wp.kernel(**KERNEL)
def measure_coasting(
    # Model:
    com: wp.array[wp.vec3],
    # State in:
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    coasting: wp.array[wp.spatial_vector],
    # Out:
    tendons: TendonModel,
):
    """How the rate of each tendon's length changes while joints keep theirs, and what of that the
    COM and the spin of bodies make; one thread a tendon.

    Where the first differs between the two sides of the start, the path has a kink or jumps on one
    of them, and the other one counts.
    """
    i = wp.tid()
    if tendons.kind[tendons.start[i]] == JOINT:
        return
    now = tendons.length[i]
    rate = tendons.velocity[i]
    carried = along_path(i, coasting, com, body_q, tendons)
    after = coasted_length(i, AHEAD, com, body_q, body_qd, coasting, tendons) - now
    before = now - coasted_length(i, -AHEAD, com, body_q, body_qd, coasting, tendons)
    ahead = 2.0 / AHEAD * (wp.float32(after) / AHEAD - rate)
    behind = 2.0 / AHEAD * (rate - wp.float32(before) / AHEAD)
    change = 0.5 * (ahead + behind)
    if wp.abs(ahead - behind) > 0.25 * wp.abs(ahead + behind):
        change = wp.where(wp.abs(ahead) < wp.abs(behind), ahead, behind)
    tendons.coasting[i] = wp.vec2(change, carried)


@wp.func
def coasting_rates(i: int, rate: float, scale: WorldScale, tendons: wp.ref[TendonModel]) -> wp.vec2:
    """Rates of a length, ``rate`` at the start of the step, from which the step is to change it: by
    all of L'', and by J v' alone.

    What a step of backward Euler has left are the mean velocities of bodies in it.
    """
    coasting = tendons.coasting[i]
    begun = rate + scale.lag * scale.h * coasting[1]
    mean = wp.where(scale.step == scale.h, 0.5 * scale.h * coasting[0], 0.0)
    return wp.vec2(begun - mean, begun - mean + scale.step * coasting[0])
