# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Welded links: their states make that of the body which they are, and its state makes theirs."""

import newton
import warp as wp

from ..algebra.so3 import world_inertia
from ..blocks.body import KINEMATIC
from ..data import (
    BodyModel,
    ContactInput,
    ControlInput,
    LinkLoads,
    LinkModel,
    Solver,
    Step,
    WorldWork,
)
from ..rows.joint import DISTANCE, FREE, ROD
from .bodies import joint_wrench as joint_wrench_of
from .bodies import nonnegative, pose_sum, vector_sum
from .comparing import (
    are_equal_matrices,
    are_equal_numbers,
    are_equal_vectors,
    are_equal_velocities,
    are_zero,
)
from .kernels import KERNEL
from .resetting import is_selected

APART = wp.constant(1.0e-4)
"""How far the velocity of a link may be from that of its body, as a share of the velocities that
make it: rounding is far below, what a user changes is above."""


# What the solver sees of the model: as live as the model's arrays.


@wp.func
def is_reweighed(body: int, links: wp.ref[LinkModel]) -> bool:
    """Whether a link of a body has another mass, COM or inertia than when it was weighed."""
    for k in range(links.member_start[body], links.member_start[body + 1]):
        link = nonnegative(links.members[k])
        # comparisons that numbers which are not finite fail
        if not (links.mass[link] == links.known_mass[link]):
            return True
        if not (links.com[link] == links.known_com[link]):
            return True
        if not (links.inertia[link] == links.known_inertia[link]):
            return True
    return False


@wp.func
def weigh_links(body: int, links: wp.ref[LinkModel], model: wp.ref[BodyModel]):
    """Mass, COM and inertia of a body by those of its links, and where these are in it."""
    start = nonnegative(links.member_start[body])
    end = links.member_start[body + 1]
    total = wp.float64(0.0)
    center = wp.vec3d(wp.float64(0.0))
    for k in range(start, end):
        link = nonnegative(links.members[k])
        at = wp.transform_point(links.frame[link], links.com[link])
        total += wp.float64(links.mass[link])
        center += wp.float64(links.mass[link]) * wp.vec3d(at)
        links.known_mass[link] = links.mass[link]
        links.known_com[link] = links.com[link]
        links.known_inertia[link] = links.inertia[link]
    tensor = wp.mat33d(wp.float64(0.0))
    if total == wp.float64(0.0):
        center = wp.vec3d(links.com[nonnegative(links.leader[body])])
    else:
        center = center / total
        for k in range(start, end):
            link = nonnegative(links.members[k])
            at = wp.transform_point(links.frame[link], links.com[link])
            arm = wp.vec3d(at) - center
            turned = world_inertia(
                wp.transform_get_rotation(links.frame[link]), links.inertia[link]
            )
            tensor += wp.mat33d(turned)
            spread = wp.dot(arm, arm) * wp.identity(n=3, dtype=wp.float64)
            tensor += wp.float64(links.mass[link]) * (spread - wp.outer(arm, arm))
    mass = wp.float32(total)
    com = wp.vec3(center)
    inv_mass = float(0.0)
    inv_inertia = wp.mat33(0.0)
    if mass > 0.0:
        inv_mass = 1.0 / mass
    # the determinant of a millimetre's inertia would underflow
    unit = wp.trace(tensor)
    if unit > wp.float64(0.0):
        if wp.determinant(tensor / unit) > wp.float64(1.0e-12):
            inv_inertia = wp.mat33(wp.inverse(tensor / unit) / unit)
    for k in range(start, end):
        link = nonnegative(links.members[k])
        links.arm[link] = wp.transform_point(links.frame[link], links.com[link]) - com
    model.mass[body] = mass
    model.com[body] = com
    model.inertia[body] = wp.mat33(tensor)
    model.inv_mass[body] = inv_mass
    model.inv_inertia[body] = inv_inertia


@wp.func
def forget_links(body: int, links: wp.ref[LinkModel]):
    """Lets links say how a body moves: its own velocity is that of where its COM was."""
    for k in range(links.member_start[body], links.member_start[body + 1]):
        unknown = wp.vec3(wp.NAN)
        links.left_qd[nonnegative(links.members[k])] = wp.spatial_vector(unknown, unknown)


@wp.func
def are_links_known(links: wp.ref[LinkModel]) -> bool:
    """Whether all links have the mass, COM and inertia that :func:`know_links` has seen."""
    if not are_equal_numbers(links.mass, links.known_mass):
        return False
    if not are_equal_vectors(links.com, links.known_com):
        return False
    return are_equal_matrices(links.inertia, links.known_inertia)


@wp.func
def know_links(links: wp.ref[LinkModel]):
    """Stores mass, COM and inertia of all links, after their bodies have been weighed."""
    for link in range(links.mass.shape[0]):
        links.known_mass[link] = links.mass[link]
        links.known_com[link] = links.com[link]
        links.known_inertia[link] = links.inertia[link]


@wp.func
def weigh_body(
    body: int, is_new: bool, is_known: bool, links: wp.ref[LinkModel], model: wp.ref[BodyModel]
):
    """Flags, mass, COM and inertia of a body by those of its links, where they have changed.

    A massless body between joints has a token mass. A body of one link is that link, to the bit.
    ``is_new`` says that tokens may have changed, or what may move; ``is_known`` that its links are
    known to be as they were weighed.
    """
    leader = nonnegative(links.leader[body])
    model.flags[body] = links.flags[leader]
    if links.member_start[body + 1] > links.member_start[body] + 1:
        is_other = bool(False)
        if not is_known:
            is_other = is_reweighed(body, links)
        if not (is_new or is_other):
            return
        before = model.com[body]
        weigh_links(body, links, model)
        if is_other and not (before == model.com[body]):
            forget_links(body, links)
    else:
        model.mass[body] = links.mass[leader]
        model.com[body] = links.com[leader]
        model.inertia[body] = links.inertia[leader]
        model.inv_mass[body] = links.inv_mass[leader]
        model.inv_inertia[body] = links.inv_inertia[leader]
    if links.token_mass[body] > 0.0 and model.mass[body] == 0.0:
        model.mass[body] = links.token_mass[body]
        model.inertia[body] = wp.diag(wp.vec3(links.token_moment[body]))
        model.inv_mass[body] = 1.0 / links.token_mass[body]
        model.inv_inertia[body] = wp.diag(wp.vec3(1.0 / links.token_moment[body]))
    if not links.is_free[body]:
        model.inv_mass[body] = 0.0
        model.inv_inertia[body] = wp.mat33(0.0)


@wp.kernel(**KERNEL)
def weigh_bodies(is_new: bool, links: wp.array[LinkModel], model: wp.array[BodyModel]):
    """Flags, mass, COM and inertia of each body by those of its links; one thread a body."""
    weigh_body(wp.tid(), is_new, False, links[0], model[0])


@wp.func
def gather_joint(i: int, links: wp.ref[LinkModel]):
    """Whether a joint that the solver knows is enabled, and its anchor frames on bodies."""
    joint = nonnegative(links.joint[i])
    if joint >= links.enabled_in.shape[0]:
        return  # of a row of MuJoCo's, read on the host
    links.enabled[i] = links.enabled_in[joint]
    parent = links.joint_parent[joint]
    frame = links.parent_frame_in[joint]
    if parent >= 0:
        frame = placed_on(parent, frame, links)
    links.parent_frame[i] = frame
    child = nonnegative(links.joint_child[joint])
    links.child_frame[i] = placed_on(child, links.child_frame_in[joint], links)


@wp.func
def placed_on(link: int, frame: wp.transform, links: wp.ref[LinkModel]) -> wp.transform:
    """A frame on a link, in the frame of its body."""
    body = links.body[link]
    if body >= 0:
        if links.leader[body] == link:
            return frame
    return links.frame[link] * frame


@wp.kernel(**KERNEL)
def gather_joints(links: wp.array[LinkModel]):
    """What the solver sees of the joints that it knows; one thread a joint."""
    gather_joint(wp.tid(), links[0])


# States of links and bodies.


@wp.func
def is_known(pose: wp.transform, velocity: wp.spatial_vector) -> bool:
    """Whether a state is finite."""
    total = pose_sum(pose) + vector_sum(velocity)
    return total - total == 0.0


@wp.func
def moved_at(velocity: wp.spatial_vector, arm: wp.vec3) -> wp.spatial_vector:
    """Velocity of a rigid body at a point off its COM [m/s, rad/s]."""
    w = wp.spatial_bottom(velocity)
    return wp.spatial_vector(wp.spatial_top(velocity) + wp.cross(w, arm), w)


@wp.func
def pushed_at(force: wp.vec3, torque: wp.vec3, arm: wp.vec3) -> wp.spatial_vector:
    """Wrench about the COM of a force and a torque off it [N, N m]."""
    return wp.spatial_vector(force, torque + wp.cross(arm, force))


@wp.func
def kick_of(
    link: int,
    rotation: wp.quat,
    velocity: wp.spatial_vector,
    links: wp.ref[LinkModel],
    link_qd: wp.array[wp.spatial_vector],
) -> wp.spatial_vector:
    """Momentum that a link has beside that of its body, about the COM of the body [N s, N m s].

    Zero unless the user gave the link a velocity that its welds do not allow.
    """
    arm = wp.quat_rotate(rotation, links.arm[link])
    expected = moved_at(velocity, arm)
    apart = link_qd[link] - expected
    spin = wp.spatial_bottom(velocity)
    size = wp.length_sq(velocity) + wp.length_sq(spin) * wp.length_sq(arm)
    # a comparison that numbers which are not finite fail
    if wp.length_sq(apart) <= APART * APART * size:
        return wp.spatial_vector()
    turned = rotation * wp.transform_get_rotation(links.frame[link])
    momentum = links.mass[link] * wp.spatial_top(apart)
    turning = world_inertia(turned, links.inertia[link]) * wp.spatial_bottom(apart)
    return pushed_at(momentum, turning, arm)


@wp.func
def are_links_quiet(
    links: wp.ref[LinkModel],
    link_qd: wp.array[wp.spatial_vector],
    link_f: wp.array[wp.spatial_vector],
) -> bool:
    """Whether links have the velocities that the last step gave them, and nothing pushes one."""
    if not are_zero(link_f):
        return False
    return are_equal_velocities(link_qd, links.left_qd)


@wp.func
def disturbed_state(
    body: int,
    pose: wp.transform,
    # Model:
    model: wp.ref[BodyModel],
    links: wp.ref[LinkModel],
    # State in:
    link_qd: wp.array[wp.spatial_vector],
    link_f: wp.array[wp.spatial_vector],
):
    """Velocity of a body, and the wrench on it, by those of its links.

    Where a link has another velocity than its welds allow, the momentum that it has by it is
    shared, as an impact through the welds would do.
    """
    leader = nonnegative(links.leader[body])
    rotation = wp.transform_get_rotation(pose)
    start = nonnegative(links.member_start[body])
    end = links.member_start[body + 1]
    pushed = float(0.0)
    changed = float(0.0)
    for k in range(start, end):
        link = nonnegative(links.members[k])
        change = link_qd[link] - links.left_qd[link]
        pushed += wp.dot(link_f[link], link_f[link])
        changed += wp.dot(change, change)
    is_left = changed == 0.0 and pose == links.body_q_out[body]
    # to the bit: of second order is only what goes on from where the last step left it
    velocity = links.body_qd_out[body]
    if not is_left:
        velocity = moved_at(link_qd[leader], -wp.quat_rotate(rotation, links.arm[leader]))
    wrench = wp.spatial_vector()
    kick = wp.spatial_vector()
    # comparisons that numbers which are not finite pass
    if pushed != 0.0 or not is_left:
        for k in range(start, end):
            link = nonnegative(links.members[k])
            push = link_f[link]
            arm = wp.quat_rotate(rotation, links.arm[link])
            wrench += pushed_at(wp.spatial_top(push), wp.spatial_bottom(push), arm)
            if link != leader:
                kick += kick_of(link, rotation, velocity, links, link_qd)
    if wp.length_sq(kick) != 0.0 and (model.flags[body] & KINEMATIC) == 0:
        mobility = world_inertia(rotation, model.inv_inertia[body])
        velocity += wp.spatial_vector(
            model.inv_mass[body] * wp.spatial_top(kick), mobility * wp.spatial_bottom(kick)
        )
    return velocity, wrench


@wp.func
def gather_body(
    body: int,
    # Model:
    model: wp.ref[BodyModel],
    links: wp.ref[LinkModel],
    # State in:
    control: wp.ref[ControlInput],
    link_q: wp.array[wp.transform],
    link_qd: wp.array[wp.spatial_vector],
    link_f: wp.array[wp.spatial_vector],
    is_quiet: bool,
):
    """State of a body, and the external wrench on it; its pose is that of its leader.

    ``is_quiet`` says that nothing pushes a link, and that all have the velocities of the last step.
    """
    pose = link_q[nonnegative(links.leader[body])]
    velocity = links.body_qd_out[body]
    wrench = wp.spatial_vector()
    if not is_quiet or not (pose == links.body_q_out[body]):
        velocity, wrench = disturbed_state(body, pose, model, links, link_qd, link_f)
    for k in range(links.push_start[body], links.push_start[body + 1]):
        # the force of a joint that pushes its child at its COM, which is a link's
        link = links.pushed[k]
        dof = links.push_dof[k]
        if links.enabled_in[links.joint[links.push_joint[k]]]:
            f = control.joint_f
            force = wp.vec3(f[dof], f[dof + 1], f[dof + 2])
            holder = links.leader[links.body[link]]
            turn = wp.transform_get_rotation(link_q[holder])
            couple = wp.cross(wp.quat_rotate(turn, links.arm[link]), force)
            wrench += wp.spatial_vector(wp.vec3(0.0), links.push_sign[k] * couple)
    links.body_q[body] = pose
    links.body_qd[body] = velocity
    links.body_f[body] = wrench


@wp.func
def leave_link(
    link: int,
    is_leader: bool,
    pose: wp.transform,
    turn: wp.mat33,
    velocity: wp.spatial_vector,
    # Model:
    links: wp.ref[LinkModel],
    # State in:
    link_q: wp.array[wp.transform],
    link_qd: wp.array[wp.spatial_vector],
    # State out:
    link_q_out: wp.array[wp.transform],
    link_qd_out: wp.array[wp.spatial_vector],
):
    """State of a link by pose, rotation matrix and velocity of its body.

    What is not finite stays as the user gave it.
    """
    is_finite = is_known(pose, velocity)
    moved = moved_at(velocity, turn * links.arm[link])
    links.left_qd[link] = moved
    if not is_finite:
        link_q_out[link] = link_q[link]
        link_qd_out[link] = link_qd[link]
        return
    if is_leader:
        link_q_out[link] = pose
    else:
        frame = links.frame[link]
        link_q_out[link] = wp.transform(
            wp.transform_get_translation(pose) + turn * wp.transform_get_translation(frame),
            wp.transform_get_rotation(pose) * wp.transform_get_rotation(frame),
        )
    link_qd_out[link] = moved


@wp.func
def scatter_body(
    body: int,
    # Model:
    links: wp.ref[LinkModel],
    # State in:
    link_q: wp.array[wp.transform],
    link_qd: wp.array[wp.spatial_vector],
    # State out:
    link_q_out: wp.array[wp.transform],
    link_qd_out: wp.array[wp.spatial_vector],
):
    """States of the links of a body by its own."""
    pose = links.body_q_out[body]
    velocity = links.body_qd_out[body]
    leader = nonnegative(links.leader[body])
    start = nonnegative(links.member_start[body])
    end = links.member_start[body + 1]
    turn = wp.identity(n=3, dtype=float)
    if end > start + 1:
        turn = wp.quat_to_matrix(wp.transform_get_rotation(pose))
    for k in range(start, end):
        link = nonnegative(links.members[k])
        leave_link(
            link,
            link == leader,
            pose,
            turn,
            velocity,
            links,
            link_q,
            link_qd,
            link_q_out,
            link_qd_out,
        )


@wp.func
def place_fixed_links(
    links: wp.ref[LinkModel],
    link_q_out: wp.array[wp.transform],
    link_qd_out: wp.array[wp.spatial_vector],
):
    """States of the links that are part of the static world, which stand after all members."""
    for k in range(links.member_start[links.leader.shape[0]], links.members.shape[0]):
        link = nonnegative(links.members[k])
        link_q_out[link] = links.frame[link]
        link_qd_out[link] = wp.spatial_vector()


@wp.kernel(**KERNEL)
def gather_bodies(
    # Model:
    model: wp.array[BodyModel],
    links: wp.array[LinkModel],
    # State in:
    control: ControlInput,
    link_q: wp.array[wp.transform],
    link_qd: wp.array[wp.spatial_vector],
    link_f: wp.array[wp.spatial_vector],
):
    """What the solver starts from; one thread a body, and a joint.

    All bodies have been weighed: a body may be pushed by the arm of another one's link.
    """
    i = wp.tid()
    if i < links[0].joint.shape[0]:
        gather_joint(i, links[0])
    if i < links[0].leader.shape[0]:
        gather_body(i, model[0], links[0], control, link_q, link_qd, link_f, False)


@wp.kernel(**KERNEL)
def scatter_links(
    # Model:
    links: wp.array[LinkModel],
    # State in:
    link_q: wp.array[wp.transform],
    link_qd: wp.array[wp.spatial_vector],
    # State out:
    link_q_out: wp.array[wp.transform],
    link_qd_out: wp.array[wp.spatial_vector],
):
    """What the step gives back; one thread a link."""
    link = wp.tid()
    body = links[0].body[link]
    if body < 0:
        link_q_out[link] = links[0].frame[link]
        link_qd_out[link] = wp.spatial_vector()
        return
    pose = links[0].body_q_out[body]
    leave_link(
        link,
        link == links[0].leader[body],
        pose,
        wp.quat_to_matrix(wp.transform_get_rotation(pose)),
        links[0].body_qd_out[body],
        links[0],
        link_q,
        link_qd,
        link_q_out,
        link_qd_out,
    )


@wp.kernel(**KERNEL)
def reset_links(
    # Model:
    body_world: wp.array[wp.int32],
    rest_q: wp.array[wp.transform],
    rest_qd: wp.array[wp.spatial_vector],
    # In:
    mask: wp.array[wp.bool],
    flags: int,
    # State out:
    link_q: wp.array[wp.transform],
    link_qd: wp.array[wp.spatial_vector],
):
    """Puts the links of the masked worlds back to where the model has them; one thread a link."""
    link = wp.tid()
    if mask.shape[0] > 0:
        if not is_selected(body_world[link], mask):
            return
    if (flags & wp.static(int(newton.StateFlags.BODY_Q))) != 0:
        link_q[link] = rest_q[link]
    if (flags & wp.static(int(newton.StateFlags.BODY_QD))) != 0:
        link_qd[link] = rest_qd[link]


# What the welds carry, for who asks.


@wp.kernel(**KERNEL)
def refer_contact_force(
    # Model:
    links: LinkModel,
    shape_link: wp.array[wp.int32],
    # State in:
    contacts: ContactInput,
    pose: wp.array[wp.transform],
    # Out:
    contact_f: wp.array[wp.spatial_vector],
):
    """Torques about the COM of the link of shape 0 instead of its body's; one thread a contact."""
    contact = wp.tid()
    if contact >= wp.min(contacts.count[0], contact_f.shape[0]):
        return
    shape = contacts.shape0[contact]
    if shape < 0 or shape >= shape_link.shape[0]:
        return
    link = shape_link[shape]
    if link < 0:
        return
    push = contact_f[contact]
    arm = link_arm(link, links, pose)
    contact_f[contact] = pushed_at(wp.spatial_top(push), wp.spatial_bottom(push), -arm)


@wp.func
def link_arm(link: int, links: wp.ref[LinkModel], pose: wp.array[wp.transform]) -> wp.vec3:
    """From the COM of a body to that of its link [m], world axes; from the origin in the world."""
    body = links.body[link]
    if body < 0:
        return wp.transform_point(links.frame[link], links.com[link])
    return wp.quat_rotate(wp.transform_get_rotation(pose[body]), links.arm[link])


@wp.kernel(**KERNEL)
def load_links(
    # Model:
    links: LinkModel,
    link_world: wp.array[wp.int32],
    gravity: wp.array[wp.vec3],
    # State in:
    link_f: wp.array[wp.spatial_vector],
    h: float,
    worlds: WorldWork,
    # Work out:
    loads: LinkLoads,
    # Out:
    body_parent_f: wp.array[wp.spatial_vector],
):
    """What joints and contacts have to give each link: momentum that nothing else gave [N, N m].

    One thread a link.
    """
    link = wp.tid()
    body = links.body[link]
    if is_asleep(body, worlds):
        return  # the last force stays
    body_parent_f[link] = wp.spatial_vector()
    load = wp.spatial_vector(-links.mass[link] * gravity[link_world[link]], wp.vec3(0.0))
    if body >= 0:
        before = momentum_of(link, links.body_q[body], links.body_qd[body], links)
        after = momentum_of(link, links.body_q_out[body], links.body_qd_out[body], links)
        load += (after - before) / h
    loads.link[link] = load - link_f[link]


@wp.func
def momentum_of(
    link: int, pose: wp.transform, velocity: wp.spatial_vector, links: wp.ref[LinkModel]
) -> wp.spatial_vector:
    """Momentum [N s] and angular momentum about its COM [N m s] of a link by its body's state."""
    rotation = wp.transform_get_rotation(pose)
    moved = moved_at(velocity, wp.quat_rotate(rotation, links.arm[link]))
    turned = rotation * wp.transform_get_rotation(links.frame[link])
    spun = world_inertia(turned, links.inertia[link]) * wp.spatial_bottom(moved)
    return wp.spatial_vector(links.mass[link] * wp.spatial_top(moved), spun)


@wp.kernel(**KERNEL)
def load_by_contacts(
    # Model:
    links: LinkModel,
    shape_link: wp.array[wp.int32],
    # State in:
    contacts: ContactInput,
    pose: wp.array[wp.transform],
    contact_f: wp.array[wp.spatial_vector],
    # Work out:
    loads: LinkLoads,
):
    """Takes what contacts give each link from its load; one thread a contact."""
    contact = wp.tid()
    if contact >= wp.min(contacts.count[0], contact_f.shape[0]):
        return
    push = contact_f[contact]
    if wp.length_sq(push) == 0.0:
        return
    link0 = shape_link[contacts.shape0[contact]]
    link1 = shape_link[contacts.shape1[contact]]
    force = wp.spatial_top(push)
    center0 = wp.vec3(0.0)
    if link0 >= 0:
        wp.atomic_sub(loads.link, link0, push)
        center0 = link_center(link0, links, pose)
    if link1 >= 0:
        arm = center0 - link_center(link1, links, pose)
        wp.atomic_add(loads.link, link1, pushed_at(force, wp.spatial_bottom(push), arm))


@wp.func
def link_center(link: int, links: wp.ref[LinkModel], pose: wp.array[wp.transform]) -> wp.vec3:
    """COM of a link [m]."""
    at = wp.transform_point(links.frame[link], links.com[link])
    body = links.body[link]
    if body < 0:
        return at
    return wp.transform_point(pose[body], at)


@wp.kernel(**KERNEL)
def load_by_joints(
    link_parent: wp.array[wp.int32],
    link_child: wp.array[wp.int32],
    pose: wp.array[wp.transform],
    joint_wrench: wp.array[wp.spatial_vector],
    loads: LinkLoads,
    body_parent_f: wp.array[wp.spatial_vector],
    step: Step,
    s: wp.array[Solver],
):
    """Takes what joints give each link from its load, and reports it; one thread a joint.

    ``joint_wrench`` is that on the child about the COM of its body. What FREE, DISTANCE and ROD
    joints push with by their ``joint_f`` is no such wrench, but an external one.
    """
    i = wp.tid()
    child = link_child[s[0].links.joint[i]]
    parent = link_parent[s[0].links.joint[i]]
    body = s[0].links.body[child]
    if is_asleep(body, s[0].worlds):
        return
    at = link_center(child, s[0].links, pose)
    center = wp.transform_point(pose[body], s[0].model.com[body])
    push = joint_wrench[i]
    push = pushed_at(wp.spatial_top(push), wp.spatial_bottom(push), center - at)
    wp.atomic_add(body_parent_f, child, push)
    kind = s[0].joints.type[i]
    if s[0].joints.enabled[i] and (kind == FREE or kind == DISTANCE or kind == ROD):
        push += joint_wrench_of(s[0].joints.dof_start[i], step.control)
    wp.atomic_sub(loads.link, child, push)
    if parent >= 0:
        arm = at - link_center(parent, s[0].links, pose)
        wp.atomic_add(
            loads.link, parent, pushed_at(wp.spatial_top(push), wp.spatial_bottom(push), arm)
        )


@wp.kernel(**KERNEL)
def load_welds(
    # Model:
    links: LinkModel,
    joint_child: wp.array[wp.int32],
    # State in:
    pose: wp.array[wp.transform],
    worlds: WorldWork,
    loads: LinkLoads,
    # Out:
    body_parent_f: wp.array[wp.spatial_vector],
):
    """What each weld carries is what the links behind it lack; one thread, the farthest first."""
    for k in range(loads.order.shape[0]):
        link = loads.order[k]
        if is_asleep(links.body[link], worlds):
            continue
        towards = loads.towards[link]
        load = loads.link[link]
        at = link_center(link, links, pose)
        weld = loads.weld[link]
        handed = load
        if towards >= 0:
            arm = at - link_center(towards, links, pose)
            handed = pushed_at(wp.spatial_top(load), wp.spatial_bottom(load), arm)
            loads.link[towards] = loads.link[towards] + handed
        if joint_child[weld] == link:
            body_parent_f[link] = body_parent_f[link] + load
        else:
            body_parent_f[towards] = body_parent_f[towards] - handed


@wp.func
def is_asleep(body: int, worlds: wp.ref[WorldWork]) -> bool:
    """Whether a body sleeps; those of the static world do not."""
    if body < 0 or worlds.island.shape[0] == 0:
        return False
    return worlds.island[body] >= 0
