# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Before a step: what MuJoCo's actuators push axes and bodies with, and gravity compensation."""

import warp as wp

from ..data import (
    ActuatorLaw,
    ActuatorModel,
    AxisActuation,
    AxisInput,
    AxisPush,
    BodyActuation,
    ControlInput,
    JointModel,
    MotorState,
    Servos,
    TendonModel,
)
from ..rows.actuator import (
    BY_CONTROL,
    LIMITS_FORCE,
    VELOCITY_TARGET,
    at_limit,
    drive_law,
    law_in_step,
    own_damping,
)
from ..rows.axis import NO_DRIVE, POSITION_MODE, POSITION_VELOCITY_MODE, VELOCITY_MODE, ranged
from ..rows.joint import NO_LIMIT
from ..rows.path import JOINT, PULLEY, ZERO, double, find_path
from .body_actuators import pushed_by, velocity_at
from .kernels import KERNEL
from .resetting import is_selected


@wp.func
def is_driven(work: wp.ref[AxisActuation], joints: wp.ref[JointModel], dof: int) -> bool:
    """Whether a degree of freedom has a drive of Newton's own."""
    if work.is_drive.shape[0] > 0:
        if work.is_drive[dof]:
            return False
    mode = work.mode_in[dof]
    has_mode = mode == POSITION_MODE or mode == VELOCITY_MODE or mode == POSITION_VELOCITY_MODE
    return has_mode and (joints.target_ke[dof] != 0.0 or joints.target_kd[dof] != 0.0)


@wp.func
def frame_of_point(
    k: int, body_q: wp.array[wp.transform], tendons: wp.ref[TendonModel]
) -> wp.transform:
    """Frame of a point of a tendon in the world."""
    link = tendons.link[k]
    if link < 0:
        return tendons.link_frame[k]
    return wp.transform_multiply(body_q[link], tendons.link_frame[k])


@wp.func
def along_path(
    i: int,
    motion: wp.array[wp.spatial_vector],
    com: wp.array[wp.vec3],
    body_q: wp.array[wp.transform],
    tendons: wp.ref[TendonModel],
) -> float:
    """What a motion of links, velocities or accelerations, makes of a tendon's length as its path
    was last found."""
    total = float(0.0)
    for s in range(tendons.start[i], tendons.span_end[i]):
        span = tendons.spans[s]
        for side in range(2):
            link = tendons.link[wp.where(side == 0, span.a, span.b)]
            if link >= 0:
                point = wp.where(side == 0, span.start, span.end)
                arm = point - wp.transform_point(body_q[link], com[link])
                along = wp.dot(span.along, velocity_at(motion[link], arm))
                total += wp.where(side == 0, -span.share, span.share) * along
    return total


@wp.kernel(**KERNEL)
def measure_tendons(
    # Model:
    com: wp.array[wp.vec3],
    # State in:
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
    # Out:
    tendons: TendonModel,
):
    """Length and velocity of each tendon; one thread a tendon."""
    i = wp.tid()
    first = tendons.start[i]
    end = tendons.start[i + 1]
    if tendons.kind[first] == JOINT:
        length = wp.float64(0.0)
        velocity = float(0.0)
        for k in range(first, end):
            if joint_q.shape[0] > 0:
                at = joint_q[tendons.coordinate[k]] + tendons.ref[tendons.dof[k]]
                length += wp.float64(tendons.value[k] * at)
                velocity += tendons.value[k] * joint_qd[tendons.dof[k]]
        tendons.length[i] = length
        tendons.velocity[i] = velocity
        return
    for k in range(first, end):
        if tendons.kind[k] != PULLEY:
            frame = frame_of_point(k, body_q, tendons)
            tendons.point[k] = double(wp.transform_get_translation(frame))
            tendons.rotation[k] = wp.transform_get_rotation(frame)
    tendons.length[i] = find_path(i, False, ZERO, tendons)
    tendons.velocity[i] = along_path(i, body_qd, com, body_q, tendons)


@wp.kernel(**KERNEL)
def pull_tendons(
    # Model:
    actuators: wp.array[ActuatorModel],
    # In:
    ctrl: wp.array[float],
    h: float,
    # Out:
    tendons: TendonModel,
    beside: wp.array[wp.vec2],
):
    """Sums what actuators push along each tendon, as :func:`push_axes` does; one thread a tendon.

    As in MuJoCo the force range of a tendon bounds the sum of its actuators' forces before their
    gears. Where they have one gear it shares the mechanism of an axis' drive, as the force range of
    an actuator that is alone does. Others count as reached or not at the start of the step.
    """
    i = wp.tid()
    length = wp.float32(tendons.length[i])
    velocity = tendons.velocity[i]
    most = tendons.force_range[i]
    is_bound = wp.isfinite(most[0]) or wp.isfinite(most[1])
    first = tendons.row_start[i]
    end = tendons.row_start[i + 1]
    push = AxisPush()
    push.least = -wp.inf
    push.most = wp.inf
    apart = wp.vec2(0.0)
    is_even = bool(True)
    for k in range(first + 1, end):
        is_even = (
            is_even
            and actuators[0].gear[tendons.rows[k]][0] == (actuators[0].gear[tendons.rows[first]][0])
        )
    if is_bound and is_even and first < end:
        gear = actuators[0].gear[tendons.rows[first]][0]
        push.least = wp.min(gear * most[0], gear * most[1])
        push.most = wp.max(gear * most[0], gear * most[1])
    is_alone = end == first + 1
    total = float(0.0)
    own = wp.vec2(0.0)
    for k in range(first, end):
        row = tendons.rows[k]
        gear = actuators[0].gear[row][0]
        law = law_in_step(actuators[0], row, ctrl, gear * length, gear * velocity, h)
        is_limited = (actuators[0].limits[row] & LIMITS_FORCE) != 0
        if is_limited and is_alone:
            push.least = wp.max(push.least, wp.min(gear * law.least, gear * law.most))
            push.most = wp.min(push.most, wp.max(gear * law.least, gear * law.most))
        elif is_limited:
            law = at_limit(law, gear * length, gear * velocity)
        if (is_bound and is_even) or (is_limited and is_alone):
            push.drive += gear * law.force
            push.drive_stiffness += gear * gear * law.stiffness
            push.drive_damping += gear * gear * law.damping
        else:
            push.force += gear * law.force
            push.stiffness += gear * gear * law.stiffness
            push.damping += gear * gear * law.damping
            total += law.force - gear * (law.stiffness * length + law.damping * velocity)
        damping = gear * gear * own_damping(actuators[0], row, velocity)
        own += wp.vec2(gear * law.own_force, damping + gear * gear * law.own_damping)
        apart += wp.vec2(0.0, damping)
    if is_bound and total != 0.0 and (total < most[0] or total > most[1]):
        share = wp.clamp(total, most[0], most[1]) / total
        push.force *= share
        push.stiffness *= share
        push.damping *= share
    push.force += own[0]
    push.damping += own[1]
    push.turned = turned_by(push, tendons.push[i], length, velocity)
    tendons.push[i] = push
    beside[i] = apart


@wp.kernel(**KERNEL)
def forget_tendons(
    # In:
    mask: wp.array[wp.bool],
    # Out:
    tendons: TendonModel,
):
    """Lets go what holds the tendons of selected worlds; one thread a tendon."""
    i = wp.tid()
    if mask.shape[0] == 0 or is_selected(tendons.world[i], mask):
        tendons.piece[i] = wp.vec3i(0, 0, 0)
        tendons.force[i] = 0.0
        if tendons.input.shape[0] > 0:
            tendons.input[i] = AxisInput()


@wp.kernel(**KERNEL)
def forget_servos(
    # In:
    mask: wp.array[wp.bool],
    world: wp.array[wp.int32],
    # Out:
    servos: Servos,
):
    """Lets go what servos of selected worlds pushed with last; one thread a servo."""
    k = wp.tid()
    if mask.shape[0] == 0 or is_selected(world[servos.items[k]], mask):
        servos.input[k] = AxisInput()
        servos.slopes[k] = wp.vec2(0.0)


@wp.func
def base_rotation(
    joint: int,
    # Model:
    parent: wp.array[wp.int32],
    parent_frame: wp.array[wp.transform],
    # In:
    body_q: wp.array[wp.transform],
) -> wp.quat:
    """Orientation of a joint's anchor on its parent."""
    base = parent_frame[joint]
    if parent[joint] >= 0:
        base = wp.transform_multiply(body_q[parent[joint]], base)
    return wp.transform_get_rotation(base)


@wp.func
def axis_of(
    dof: int,
    first: int,
    turned: wp.quat,
    # Model:
    axes: wp.array[wp.vec3],
    # In:
    joint_q: wp.array[float],
    coordinate: int,
) -> wp.vec3:
    """Axis of a degree of freedom in the world.

    Args:
        dof: The degree of freedom, whose coordinate is number ``coordinate``.
        first: First of the axes of the joint that turn it; its own index where none does.
        turned: Orientation of the anchor on the parent.
    """
    for k in range(first, dof):
        turned = turned * wp.quat_from_axis_angle(axes[k], joint_q[coordinate + k - dof])
    return wp.quat_rotate(turned, axes[dof])


@wp.kernel(**KERNEL)
def compensate_axes(
    # Model:
    parent: wp.array[wp.int32],
    child: wp.array[wp.int32],
    parent_frame: wp.array[wp.transform],
    child_frame: wp.array[wp.transform],
    dof_start: wp.array[wp.int32],
    dof_dim: wp.array2d[wp.int32],
    axes: wp.array[wp.vec3],
    com: wp.array[wp.vec3],
    mass: wp.array[float],
    world: wp.array[wp.int32],
    gravity: wp.array[wp.vec3],
    share: wp.array[float],
    # In:
    body_q: wp.array[wp.transform],
    joint_q: wp.array[float],
    dofs: wp.array[wp.int32],
    joint_of: wp.array[wp.int32],
    coordinate: wp.array[wp.int32],
    start: wp.array[wp.int32],
    links: wp.array[wp.int32],
    # Out:
    compensation: wp.array[float],
):
    """Generalized force of the compensation of the links that an axis carries; one thread an axis.

    Those whose actuators do not compensate have no links. Joints and links are those of the user's
    model, where welded links are bodies of their own.
    """
    i = wp.tid()
    total = float(0.0)
    joint = joint_of[i]
    first = dof_start[joint]
    linear = dof_dim[joint, 0]
    turned = base_rotation(joint, parent, parent_frame, body_q)
    axis = axis_of(dofs[i], first + linear, turned, axes, joint_q, coordinate[i])
    end = wp.transform_multiply(body_q[child[joint]], child_frame[joint])
    anchor = wp.transform_get_translation(end)
    for k in range(start[i], start[i + 1]):
        link = links[k]
        lift = -share[link] * mass[link] * gravity[world[link]]
        if dofs[i] < first + linear:
            total += wp.dot(axis, lift)
        else:
            arm = wp.transform_point(body_q[link], com[link]) - anchor
            total += wp.dot(axis, wp.cross(arm, lift))
    compensation[i] = total


@wp.func
def has_force_range(actuators: wp.ref[ActuatorModel], row: int) -> bool:
    """Whether the force of an actuator has a range; without a row it has none."""
    if row < 0:
        return False
    return (actuators.limits[row] & LIMITS_FORCE) != 0


@wp.func
def drive_in_step(
    item: int,
    dof: int,
    coordinate: int,
    # Model:
    actuators: wp.ref[ActuatorModel],
    joints: wp.ref[JointModel],
    ref: float,
    # In:
    work: wp.ref[AxisActuation],
    control: wp.ref[ControlInput],
) -> ActuatorLaw:
    """What an actuator that is a drive pushes its axis with in the step."""
    kind = work.kind[item]
    target = ref
    if kind == VELOCITY_TARGET:
        target = control.target_qd[dof]
    else:
        target += control.target_q[coordinate]
    return drive_law(actuators, joints, work.rows[item], dof, kind, target)


@wp.func
def turned_by(push: AxisPush, before: AxisPush, q: float, v: float) -> wp.vec2:
    """See :attr:`.data.AxisPush.turned`; ``before`` is that of the last step."""
    force = (push.stiffness - before.stiffness) * q + (push.damping - before.damping) * v
    stiffness = push.drive_stiffness - before.drive_stiffness
    damping = push.drive_damping - before.drive_damping
    return wp.vec2(force, stiffness * q + damping * v)


@wp.func
def push_axis(
    i: int,
    # Model:
    actuators: wp.ref[ActuatorModel],
    joints: wp.ref[JointModel],
    ref: wp.array[float],
    # In:
    work: wp.ref[AxisActuation],
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
    ctrl: wp.array[float],
    has_limits: bool,
    h: float,
    compensation: wp.array[float],
    # Out:
    control: wp.ref[ControlInput],
    beside: wp.array[wp.vec2],
):
    """Sums what actuators push a degree of freedom with.

    Length and velocity of a transmission are gear (q + ref) and gear v. A force range shares the
    mechanism of the drive's effort limit where one actuator has one and nothing else drives the
    axis; others keep to theirs in ``ranged``, where kernels are compiled for that, and else count
    as having reached them or not at the start of the step.

    Compensation of gravity by actuators moves from the links to what the limit of the axis bounds,
    and so does what actuators of tendons and bodies bring to the axis.

    ``beside`` gets what no actuator's force is of the part that nothing limits: the damping of
    actuators, and what is taken from the links.
    """
    dof = work.dof[i]
    first = work.start[i]
    end = work.start[i + 1]
    q = 0.0
    qd = 0.0
    if joint_q.shape[0] > 0:
        q = joint_q[work.coordinate[i]]
        qd = joint_qd[dof]
    before = control.pushes[dof]
    last, stiffness_last = ranged(control, dof, wp.float64(q), h * qd, h)
    at = ref[dof]
    has_effort = has_limits and joints.effort_limit[dof] < NO_LIMIT
    limited = int(0)
    for k in range(first, end):
        if has_limits and has_force_range(actuators, work.rows[k]):
            limited += 1
    shares = limited == 1 and end == first + 1
    shares = (shares or (limited == 1 and not has_effort)) and not is_driven(work, joints, dof)
    if compensation.shape[0] > 0 and has_effort:
        # the range of an actuator does not bound the compensation
        shares = shares and compensation[i] == 0.0
    transmitted = 0.0
    if work.transmitted.shape[0] > 0 and has_effort:
        transmitted = work.transmitted[dof]
        shares = shares and transmitted == 0.0
    push = AxisPush()
    push.least = -wp.inf
    push.most = wp.inf
    apart = wp.vec2(0.0)
    for k in range(first, end):
        row = work.rows[k]
        law = ActuatorLaw()
        gear = 1.0
        if work.kind[k] == BY_CONTROL:
            gear = actuators.gear[row][0]
        length = gear * (q + at)
        velocity = gear * qd
        if work.kind[k] == BY_CONTROL:
            law = law_in_step(actuators, row, ctrl, length, velocity, h)
        else:
            law = drive_in_step(k, dof, work.coordinate[i], actuators, joints, at, work, control)
        is_limited = has_limits and has_force_range(actuators, row)
        if is_limited and not shares and control.ranged.shape[0] == 0:
            law = at_limit(law, length, velocity)
        stiffness = gear * gear * law.stiffness
        damping = gear * gear * law.damping
        force = gear * law.force - stiffness * at
        if control.ranged.shape[0] > 0:
            control.ranged[k] = ActuatorLaw()
        if is_limited and not shares and control.ranged.shape[0] > 0:
            one = ActuatorLaw()
            one.force = force
            one.stiffness = stiffness
            one.damping = damping
            one.least = wp.min(gear * law.least, gear * law.most)
            one.most = wp.max(gear * law.least, gear * law.most)
            control.ranged[k] = one
            push.first = first
            push.count = end - first
        elif has_effort or (is_limited and shares):
            push.drive += force
            push.drive_stiffness += stiffness
            push.drive_damping += damping
            if is_limited and shares:
                push.least = wp.min(gear * law.least, gear * law.most)
                push.most = wp.max(gear * law.least, gear * law.most)
        else:
            push.force += force
            push.stiffness += stiffness
            push.damping += damping
        own = 0.0
        if row >= 0:
            own = gear * gear * own_damping(actuators, row, qd)
        push.force += gear * law.own_force
        push.damping += own + gear * gear * law.own_damping
        apart += wp.vec2(0.0, own)
    if compensation.shape[0] > 0 and has_effort:
        push.force -= compensation[i]
        push.drive += compensation[i]
        apart -= wp.vec2(compensation[i], 0.0)
    # it pushes the links, past the limit, which bounds the sum
    push.force -= transmitted
    push.drive += transmitted
    push.level = before.level
    push.turned = turned_by(push, before, q, qd)
    control.pushes[dof] = push
    if push.count > 0 and before.count > 0:
        now, stiffness_now = ranged(control, dof, wp.float64(q), h * qd, h)
        if wp.isfinite(now - last):  # as where no control was, and a range has one end only
            control.pushes[dof].level = before.level + (now - last)
        control.pushes[dof].resisted = h * h * stiffness_last
        control.pushes[dof].resists = h * h * stiffness_now
    beside[dof] = apart


@wp.func
def read_axis(dof: int, work: wp.ref[AxisActuation]):
    """Mode of a drive, none where it is an actuator, and armature with what actuators add."""
    if dof < work.mode.shape[0]:
        work.mode[dof] = wp.where(work.is_drive[dof], NO_DRIVE, work.mode_in[dof])
    if dof < work.armature.shape[0]:
        work.armature[dof] = work.armature_in[dof] + work.added[dof]


@wp.kernel(**KERNEL)
def push_axes(
    # Model:
    actuators: wp.array[ActuatorModel],
    joints: wp.array[JointModel],
    ref: wp.array[float],
    # In:
    work: wp.array[AxisActuation],
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
    ctrl: wp.array[float],
    has_limits: bool,
    h: float,
    compensation: wp.array[float],
    # Out:
    control: ControlInput,
    beside: wp.array[wp.vec2],
):
    """Pushes the degrees of freedom that actuators act on; one thread for each of them.

    Where drives are actuators, or actuators have armature, one for each degree of freedom.

    Structs that stay the same are resident: a replayed graph would look up each of their pointers.
    The control does not, since the user may give another one each step.
    """
    i = wp.tid()
    read_axis(i, work[0])
    if i >= work[0].dof.shape[0]:
        return
    push_axis(
        i,
        actuators[0],
        joints[0],
        ref,
        work[0],
        joint_q,
        joint_qd,
        ctrl,
        has_limits,
        h,
        compensation,
        control,
        beside,
    )


@wp.kernel(**KERNEL)
def push_links(
    # Model:
    com: wp.array[wp.vec3],
    mass: wp.array[float],
    world: wp.array[wp.int32],
    gravity: wp.array[wp.vec3],
    compensation: wp.array[float],
    # State in:
    body_q: wp.array[wp.transform],
    body_f: wp.array[wp.spatial_vector],
    # In:
    work: BodyActuation,
    start: wp.array[wp.int32],
    items: wp.array[wp.int32],
    # Out:
    pushed: wp.array[wp.spatial_vector],
):
    """External wrench on each link with what compensates its weight and actuators push it with; one
    thread a link."""
    link = wp.tid()
    wrench = body_f[link]
    if compensation.shape[0] > 0:
        lift = -compensation[link] * mass[link] * gravity[world[link]]
        wrench += wp.spatial_vector(lift, wp.vec3(0.0))
    if start.shape[0] > 0:
        center = wp.transform_point(body_q[link], com[link])
        wrench += pushed_by(link, center, work, start, items)
    pushed[link] = wrench


@wp.kernel(**KERNEL)
def reset_activations(
    # Model:
    world: wp.array[wp.int32],
    # In:
    mask: wp.array[wp.bool],
    # Out:
    activation: wp.array[float],
):
    """Sets the activations of the selected worlds to zero; one thread an actuator."""
    i = wp.tid()
    if mask.shape[0] == 0 or is_selected(world[i], mask):
        activation[i] = 0.0


@wp.kernel(**KERNEL)
def reset_motors(
    # Model:
    world: wp.array[wp.int32],
    # In:
    mask: wp.array[wp.bool],
    # Out:
    motor: wp.array[MotorState],
):
    """Sets the states of DC motors of the selected worlds to zero; one thread an actuator."""
    i = wp.tid()
    if mask.shape[0] == 0 or is_selected(world[i], mask):
        motor[i] = MotorState()
