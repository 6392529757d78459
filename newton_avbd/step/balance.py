# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What an island had, was given and has of energy and momentum in a step, summed over its bodies.

What a body adds is in :mod:`.step.body_energy`, and what its joints add in
:mod:`.step.joint_energy`. :func:`settle` decides which motion the sums leave an island.
"""

import warp as wp

from ..algebra.so3 import exp_quat, world_inertia
from ..blocks.body import target_spin
from ..data import Balance, BodyWork, Solver, Step
from .cable_segments import end_segment, first_segment, slot_at
from .islands import island_of, point_inertia, rigid_spin
from .tendons import tendon_work

EXCESS = wp.constant(1.0e-6)
"""Energy beyond what may be, as a share of it, that float32 explains."""
FAR_OFF = wp.constant(100.0)
"""Energy after a step as a multiple of what may be from which on not only velocities, but poses,
too, have come to nothing: bodies have gone ten times as far as they can have."""


@wp.func
def squared_overlap(gap: float) -> float:
    """Square of a penetration [m^2], zero where there is none."""
    depth = wp.min(gap, 0.0)
    return depth * depth


@wp.func
def place_from(root: int, body: int, work: wp.ref[BodyWork]) -> wp.vec3:
    """COM of a body after the step, from where that of the root was before it [m]."""
    return work.com[body] - work.com[root] + wp.spatial_top(work.increment[body])


@wp.func
def touch_fixed(slot: int, is_joint: bool, work: wp.ref[BodyWork], sum: Balance) -> Balance:
    """Notes a joint or a contact with a body that the solver does not move."""
    out = sum
    if work.inv_mass[slot] == 0.0:
        if is_joint:
            out.is_anchored = True
        out.is_touched = True
        moved = wp.length_sq(work.increment[slot])
        if work.put.shape[0] > 0:
            moved += wp.length_sq(work.put[slot])
        if moved > 0.0:
            out.is_pushed = True
    return out


@wp.func
def touch_surface(force: wp.vec3, way: wp.vec3, sum: Balance) -> Balance:
    """Notes a contact with a body that the solver does not move.

    Args:
        force: What it pushes with [N].
        way: How far its surface goes in the step [m].
        sum: Of the island.
    """
    out = sum
    load = wp.length(force)
    out.is_touched = True
    out.pushed += wp.dot(force, way)
    out.push += force
    out.load += load
    out.way += load * way
    return out


@wp.func
def with_work(sum: Balance, work: float) -> Balance:
    """Adds the work of what stores energy [J], which may make a body faster than all was before."""
    out = sum
    out.before += work
    if work > 0.0 and wp.isfinite(work):
        out.given += work
    return out


@wp.func
def counts_here(item: int, joint: int, s: wp.ref[Solver]) -> bool:
    """Whether a joint outside of trees counts with a body of which ``item`` says which end it is:
    with its child, if that moves."""
    is_child = item % 2 == 0
    return s.joints.enabled[joint] and (is_child or s.work.inv_mass[s.joints.child[joint]] == 0.0)


@wp.func
def add_tendons(first: int, root: int, s: wp.ref[Solver]):
    """Adds the work of the tendons of the block that starts at a place in visiting order, and to
    what fixed bodies they tie it."""
    closures = s.tree.closures
    number = closures.block_of[first]
    if number >= 0:
        sum = s.islands.balance[root]
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            if closure.tendon >= 0 and closure.other < 0:
                i = closure.tendon
                sum = with_work(sum, tendon_work(i, s.tree))
                if s.tree.tendons.force[i] != 0.0:
                    for k in range(s.tree.tendons.start[i], s.tree.tendons.start[i + 1]):
                        body = s.tree.tendons.body[k]
                        if body >= 0:
                            sum = touch_fixed(body, False, s.work, sum)
        s.islands.balance[root] = sum


@wp.func
def add_cables(cluster: int, s: wp.ref[Solver]):
    """Adds what the cables of a cluster had stored at the start of the step, and to what they
    tie its island."""
    cables = s.tree.cables
    for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
        cable = cables.cables[i]
        for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
            if cables.active[seg] == 1:
                for side in range(2):
                    slot = slot_at(seg, side, cables)
                    other = slot_at(seg, 1 - side, cables)
                    if s.work.inv_mass[slot] > 0.0:
                        root = island_of(s.islands, slot)
                        sum = s.islands.balance[root]
                        if side == 0 or s.work.inv_mass[other] == 0.0:
                            pull = cables.before[seg]
                            sum = with_work(sum, 0.5 * cables.compliance[seg] * pull * pull)
                        if s.work.inv_mass[other] == 0.0 and cables.tension[seg] > 0.0:
                            sum = touch_fixed(other, True, s.work, sum)
                            is_static = other == s.work.inv_mass.shape[0] - 1
                            if not is_static and not s.tree.is_left[other]:
                                sum.is_pushed = True  # the user has moved it
                        s.islands.balance[root] = sum


@wp.func
def combined(one: Balance, other: Balance) -> Balance:
    """What is summed over the bodies of both."""
    out = one
    out.before += other.before
    out.after += other.after
    out.start += other.start
    out.given += other.given
    out.pushed += other.pushed
    out.push += other.push
    out.load += other.load
    out.way += other.way
    out.mass += other.mass
    out.com += other.com
    out.start_com += other.start_com
    out.free_momentum += other.free_momentum
    out.free_angular += other.free_angular
    out.is_anchored = out.is_anchored or other.is_anchored
    out.is_touched = out.is_touched or other.is_touched
    out.is_pushed = out.is_pushed or other.is_pushed
    out.is_wild = out.is_wild or other.is_wild
    out.is_turned = out.is_turned or other.is_turned
    return out


@wp.func
def add_momentum(
    body: int, root: int, island: Balance, sum: Balance, step: wp.ref[Step], s: wp.ref[Solver]
) -> Balance:
    """Adds a body's momentum and inertia about the COM of its island."""
    out = sum
    mass = s.model.mass[body]
    r = place_from(root, body, s.work) - island.com / island.mass
    inertia = world_inertia(wp.transform_get_rotation(step.body_q_out[body]), s.model.inertia[body])
    momentum = mass * wp.spatial_top(step.body_qd_out[body])
    out.momentum += momentum
    out.angular += wp.cross(r, momentum)
    out.angular += inertia * wp.spatial_bottom(step.body_qd_out[body])
    out.inertia += inertia + point_inertia(mass, r)
    r = s.work.com[body] - s.work.com[root] - island.start_com / island.mass
    inertia = world_inertia(
        wp.transform_get_rotation(s.islands.start_q[body]), s.model.inertia[body]
    )
    out.start_inertia += inertia + point_inertia(mass, r)
    return out


@wp.func
def combined_momentum(one: Balance, other: Balance) -> Balance:
    """Momenta and inertias of both, which are summed once the COM of the island is known."""
    out = one
    out.momentum += other.momentum
    out.angular += other.angular
    out.inertia += other.inertia
    out.start_inertia += other.start_inertia
    return out


@wp.func
def seen_from(frame: wp.vec3, h: float, sum: Balance) -> Balance:
    """The sums as they are for what moves at a velocity [m/s], with the work of what it touches."""
    out = sum
    own = 0.5 * sum.mass * wp.length_sq(frame)
    out.before += own - wp.dot(frame, sum.free_momentum)
    out.before += sum.pushed - h * wp.dot(frame, sum.push)
    out.after += own - wp.dot(frame, sum.momentum)
    out.start += own - wp.dot(frame, sum.free_momentum)
    out.momentum -= sum.mass * frame
    out.free_momentum -= sum.mass * frame
    out.free_angular -= wp.cross(sum.start_com, frame)
    return out


@wp.func
def settle(island: Balance, h: float) -> Balance:
    """Decides which motion is left of an island, once all is summed.

    What fixed things do to its momentum is taken from the velocities, unless the step has come to
    nothing: a body is faster than anything could be, energies are not finite or far too high, the
    island is where springs and drives have stored more than all motion can have put in, or the
    rigid motion alone has too much, because the inertia of where bodies are is not the one that
    they had. Then the island moves as a rigid body from where it was.

    All velocities count from that of the surfaces that it touches, their mean by what they push
    with: what has too much of them ends up at rest on a surface, wherever that goes.
    """
    frame = wp.vec3(0.0)
    if island.load > 0.0 and wp.isfinite(wp.length_sq(island.way)) and not island.is_anchored:
        frame = island.way / (h * island.load)
    speed_sq = wp.length_sq(frame)
    sum = seen_from(frame, h, island)
    out = sum
    out.share = 1.0
    # how far anything goes is not known of what is carried along
    is_wild = sum.is_wild and speed_sq == 0.0
    is_finite = wp.isfinite(sum.after) and wp.isfinite(sum.before) and not is_wild
    most = sum.start
    if is_finite:
        most = sum.before
    rounding = EXCESS * (island.after + 0.5 * sum.mass * speed_sq)
    if sum.is_pushed or (is_finite and sum.after - most <= rounding):
        return out
    if is_wild and wp.isfinite(sum.after) and sum.after <= most + sum.given:
        return out
    out.is_bounded = True
    is_far_off = sum.before < -sum.start or sum.after > FAR_OFF * wp.max(most, sum.start)
    is_uphill = is_finite and sum.is_turned and is_far_off and speed_sq == 0.0
    if is_uphill:
        most = sum.start
    most = wp.max(most, 0.0)
    rigid = float(0.0)
    old = float(0.0)
    if sum.is_anchored:
        out.momentum = wp.vec3(0.0)
        out.angular = wp.vec3(0.0)
    else:
        out.momentum = sum.momentum / sum.mass
        out.angular = rigid_spin(sum.inertia, sum.angular)
        old = 0.5 * wp.dot(sum.momentum, out.momentum) + 0.5 * wp.dot(sum.angular, out.angular)
        rigid = old
        momentum = sum.free_momentum
        if sum.is_touched:
            out.free_momentum = out.momentum
            out.free_angular = out.angular
        else:
            out.free_momentum = momentum / sum.mass
            out.free_angular = rigid_spin(
                sum.inertia, sum.free_angular - wp.cross(sum.start_com / sum.mass, momentum)
            )
            rigid = 0.5 * wp.dot(momentum, out.free_momentum)
            rigid += 0.5 * wp.dot(out.free_angular, sum.inertia * out.free_angular)
    if not is_finite or is_uphill or (rigid > most and not sum.is_touched):
        out.is_rigid = True
        out.share = 0.0
        momentum = sum.free_momentum
        angular = sum.free_angular - wp.cross(sum.start_com / sum.mass, momentum)
        size = wp.trace(sum.start_inertia)
        out.free_momentum = momentum / sum.mass
        inverse = wp.inverse(sum.start_inertia / size) / size
        # the solve for what turns it is cut off, and as a velocity would gain energy by half the
        # square of its change; the spin that belongs to the momentum after the turn does not
        out.angular = target_spin(sum.start_inertia, inverse, angular, h)
        turn = exp_quat(h * out.angular)
        spin = inverse * wp.quat_rotate_inv(turn, angular)
        out.free_angular = wp.quat_rotate(turn, spin)
        rigid = 0.5 * wp.dot(momentum, out.free_momentum)
        rigid += 0.5 * wp.dot(spin, sum.start_inertia * spin)
    else:
        inner = wp.max(sum.after - old, 1.0e-30)
        out.share = wp.min(wp.sqrt(wp.max(most - rigid, 0.0) / inner), 1.0)
    if sum.is_anchored:
        out.free_momentum = wp.vec3(0.0)
        out.free_angular = wp.vec3(0.0)
        if out.is_rigid:
            out.angular = wp.vec3(0.0)
    elif sum.is_touched and rigid > most:
        kept = wp.sqrt(most / rigid)
        out.free_momentum *= kept
        out.free_angular *= kept
        if out.is_rigid:
            out.angular *= kept
    if not sum.is_anchored:
        out.momentum += frame
        out.free_momentum += frame
    return out
