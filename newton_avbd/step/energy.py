# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Energy of steps that do not settle: an island ends with no more than it had and was given.

The kinetic energy of an island after a step, rotors included, is at most that before it and the
work of gravity, external forces, ``joint_f``, drives, springs and compliant contacts over the way
that the step has moved its bodies. What dissipates is not counted. Where sweeps that have not
settled leave more, velocities are scaled towards the rigid motion of the island, which has its
linear and angular momentum and the least energy for them. Where that is still too much, and
contacts with something fixed take up momentum, the rigid motion is scaled, too. A joint to
something fixed allows no rigid motion: velocities of such an island are scaled towards rest.

What a kinematic body or a moving surface does is not known. Islands that one pushes are left alone.
"""

from typing import NamedTuple

import warp as wp

from ..algebra.so3 import exp_quat, world_inertia
from ..blocks.body import origin_shift, renormalised, target_spin
from ..data import Balance, BodyModel, BodyWork, IslandWork, Solver, Step, WorldScale, WorldWork
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows import contact as contact_rows
from ..rows.coordinate import make_joint_coordinates
from ..rows.euler import make_euler
from ..rows.free_axes import make_free_axes
from ..rows.joint import BALL, ROD, ball_away, linear_axis, make_counts
from .anchors import anchor_arm, anchor_rotation, is_linked, parent_slot
from .cable_segments import end_segment, first_segment, slot_at
from .cables import make_join
from .drag import resistance
from .islands import begin_island, island_of, join_islands, point_inertia
from .kernels import absent
from .slopes import JUMPED
from .tendons import make_join_tendons, tendon_work

NEARLY = wp.constant(1.0e-5)
"""Last update of a world, as a share of the farthest move in the step, up to which it has settled
as far as energy is concerned: it is off by about twice the share."""
EXCESS = wp.constant(1.0e-6)
"""Energy beyond what may be, as a share of it, that float32 explains."""
FLAT = wp.constant(6)
"""Sweeps from which on a closed tree that nothing touches counts as flat: away from there it takes
one to four. It may fold either way, and settles at more energy: a parallelogram 3 % in a step.
Contacts take as many; with them the sweeps must have been cut off besides."""


@wp.func
def kinetic_energy(
    body: int, pose: wp.transform, velocity: wp.spatial_vector, model: wp.ref[BodyModel]
) -> float:
    """(m v^2 + w I w)/2 of a body [J]."""
    v = wp.spatial_top(velocity)
    w = wp.spatial_bottom(velocity)
    inertia = world_inertia(wp.transform_get_rotation(pose), model.inertia[body])
    return 0.5 * (model.mass[body] * wp.dot(v, v) + wp.dot(w, inertia * w))


@wp.func
def squared_overlap(gap: float) -> float:
    """Square of a penetration [m^2], zero where there is none."""
    depth = wp.min(gap, 0.0)
    return depth * depth


@wp.func
def keep_start(world: int, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]):
    """Keeps poses and velocities at the start of a step that may write to the same arrays."""
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = s.worlds.bodies[i]
        s.islands.start_q[body] = s.work.pose[body]
        s.islands.start_qd[body] = body_qd[body]


@wp.func
def squared_move(body: int, work: wp.ref[BodyWork]) -> float:
    """Square of how far a body has gone in the step, a rotation by its radius of gyration [m^2]."""
    shift = wp.spatial_top(work.increment[body])
    turn = wp.spatial_bottom(work.increment[body])
    return wp.length_sq(shift) + wp.dot(turn, work.inertia[body] * turn) * work.inv_mass[body]


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
def rigid_spin(inertia: wp.mat33, angular: wp.vec3) -> wp.vec3:
    """Angular velocity of what has this inertia and this angular momentum [rad/s]."""
    # scaled: the determinant of a small inertia would underflow
    size = wp.trace(inertia)
    return wp.inverse(inertia / size) * (angular / size)


@wp.func
def settle(sum: Balance, h: float) -> Balance:
    """Decides which motion is left of an island, once all is summed.

    What fixed things do to its momentum is taken from the velocities, unless the step has come to
    nothing: a body is faster than anything could be, energies are not finite, or the rigid
    motion alone has too much, because the inertia of where bodies are is not the one that they had.
    Then the island moves as a rigid body from where it was.
    """
    out = sum
    out.share = 1.0
    is_finite = wp.isfinite(sum.after) and wp.isfinite(sum.before) and not sum.is_wild
    most = sum.start
    if is_finite:
        most = sum.before
    if sum.is_pushed or (is_finite and sum.after - most <= EXCESS * sum.after):
        return out
    if sum.is_wild and wp.isfinite(sum.after) and sum.after <= most:
        return out
    out.is_bounded = True
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
    if not is_finite or (rigid > most and not sum.is_touched):
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
    return out


@wp.func
def moved_pose(
    body: int, pose: wp.transform, shift: wp.vec3, turn: wp.quat, model: wp.ref[BodyModel]
) -> wp.transform:
    """Pose of a body whose COM has gone by ``shift`` [m], and which has turned."""
    rotation = renormalised(turn * wp.transform_get_rotation(pose))
    move = wp.spatial_vector(shift, wp.vec3(0.0))
    place = wp.transform_get_translation(pose)
    return wp.transform(place + origin_shift(pose, model.com[body], move, rotation), rotation)


@wp.func
def counts_here(body: int, item: int, joint: int, s: wp.ref[Solver]) -> bool:
    """Whether a joint outside of trees counts with this body: with its child, if that moves."""
    is_child = item % 2 == 0
    return s.joints.enabled[joint] and (is_child or s.work.inv_mass[s.joints.child[joint]] == 0.0)


@wp.func
def place_from(root: int, body: int, work: wp.ref[BodyWork]) -> wp.vec3:
    """COM of a body after the step, from where that of the root was before it [m]."""
    return work.com[body] - work.com[root] + wp.spatial_top(work.increment[body])


@wp.func
def combined(one: Balance, other: Balance) -> Balance:
    """What is summed over the bodies of both."""
    out = one
    out.before += other.before
    out.after += other.after
    out.start += other.start
    out.mass += other.mass
    out.com += other.com
    out.start_com += other.start_com
    out.free_momentum += other.free_momentum
    out.free_angular += other.free_angular
    out.is_anchored = out.is_anchored or other.is_anchored
    out.is_touched = out.is_touched or other.is_touched
    out.is_pushed = out.is_pushed or other.is_pushed
    out.is_wild = out.is_wild or other.is_wild
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


class EnergyFunctions(NamedTuple):
    """Device functions, compiled for the effects of a scene."""

    bound_world: wp.Function
    is_body_led: wp.Function
    is_flat: wp.Function
    gains_settled: wp.Function
    begin_balance: wp.Function
    join_joints: wp.Function
    join_tendons: wp.Function
    join_cluster: wp.Function
    add_cables: wp.Function
    add_body: wp.Function
    add_tendons: wp.Function
    settle_island: wp.Function
    slow_body: wp.Function
    slow_rotors: wp.Function
    drop_tensions: wp.Function


def make_energy(effects: Effects, join: wp.Function = join_islands) -> EnergyFunctions:
    """Device functions that bound the energy of islands.

    Args:
        effects: Effects of the scene.
        join: Makes one island of two bodies.
    """
    counts = make_counts(effects.kinds)
    linear_count, angular_count = counts.linear_count, counts.angular_count
    is_gimbal = counts.is_gimbal
    euler = make_euler(effects.kinds)
    is_led, known_angles = euler.is_led, euler.known_angles
    angular_axis = make_free_axes(effects.kinds).angular_axis
    angles = make_joint_coordinates(effects.kinds).angles
    join_cluster = make_join(join)
    join_tendons = make_join_tendons(join) if effects.tendons else absent

    @wp.func
    def add_tendons(first: int, root: int, s: wp.ref[Solver]):
        """Adds the work of the tendons of the block that starts at a place in visiting order."""
        closures = s.tree.closures
        number = closures.block_of[first]
        if number >= 0:
            sum = s.islands.balance[root]
            block = closures.blocks[number]
            for c in range(block.first, block.end):
                closure = closures.closures[c]
                if closure.tendon >= 0 and closure.other < 0:
                    sum.before += tendon_work(closure.tendon, s.tree)
            s.islands.balance[root] = sum

    @wp.func
    def begin_balance(body: int, islands: wp.ref[IslandWork]):
        """Nothing is summed for a body yet; nor does anything push it where that is not known."""
        islands.balance[body] = Balance()
        if wp.static(not effects.islands):
            begin_island(islands, body)

    @wp.func
    def axis_work(
        joint: int,
        dof: int,
        q: wp.float64,
        moved: float,
        start_velocity: float,
        turn_away: wp.vec3,
        rest_away: wp.vec3,
        h: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Work of what acts along an axis that has moved to q, ``joint_f`` aside [J]."""
        index = s.joints.dof_start[joint] + dof
        total = float(0.0)
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                total -= s.joints.target_ke[index] * moved * (wp.float32(q) - 0.5 * moved)
                if wp.static(effects.dahl):
                    if dof >= 3:
                        # what friction has stored is at most what it pushed with before
                        total += wp.max(-s.history.dahl_sigma[joint][dof - 3] * moved, 0.0)
                return total
        if wp.static(effects.drives):
            # the mean force of the spring over the way, and of a damper what a motor gives
            away = axis_rows.away_from(step.control.target_q, s.joints, joint, dof, q, turn_away)
            away += 0.5 * moved
            damping, _k = axis_rows.drive(s.joints, step.control, index, 0.0, moved, h)
            whole, _k = axis_rows.drive(s.joints, step.control, index, away, moved, h)
            given = (whole - damping) * moved + wp.max(damping * moved, 0.0)
            most = axis_rows.most_effort(s.joints, index)
            if wp.isfinite(most):
                given = wp.clamp(given, -most * wp.abs(moved), most * wp.abs(moved))
            total += given
        if wp.static(effects.pushed_axes):
            push = step.control.pushes[index]
            middle = wp.float32(q) - 0.5 * moved
            total += (push.force - push.stiffness * middle) * moved
            given = (push.drive - push.drive_stiffness * middle) * moved
            if wp.static(effects.force_ranges):
                pull, _k = axis_rows.ranged(step.control, index, wp.float64(middle), 0.0, h)
                given += pull * moved
            most = wp.max(wp.abs(push.least), wp.abs(push.most))
            if wp.isfinite(most):
                given = wp.clamp(given, -most * wp.abs(moved), most * wp.abs(moved))
            total += given
        if wp.static(effects.springs):
            away = axis_rows.away_from(s.joints.rest_q, s.joints, joint, dof, q, rest_away)
            total += s.joints.stiffness[index] * moved * (away + 0.5 * moved)
        if wp.static(effects.limit_impedance):
            if s.joints.limit_mobility[index] > 0.0:
                # what returns to it beyond the inertia is given by the limit
                pull, _k = axis_rows.yielding_limit(
                    s.joints, index, wp.float32(q), moved, start_velocity, h
                )
                return total + wp.max(pull * moved, 0.0)
        if wp.static(effects.limits and effects.compliance):
            at = wp.float32(q)
            lower = at - s.joints.limit_lower[index]
            upper = s.joints.limit_upper[index] - at
            less = squared_overlap(lower - moved) - squared_overlap(lower)
            less += squared_overlap(upper + moved) - squared_overlap(upper)
            total += 0.5 * s.joints.limit_ke[index] * less
        return total

    @wp.func
    def add_joint(
        joint: int,
        first: int,
        coordinate: wp.array[wp.float64],
        start_coordinate: wp.array[wp.float64],
        h: float,
        static_slot: int,
        sum: Balance,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> Balance:
        """Adds a joint: its rotors, and the work of what acts along its axes."""
        child = s.joints.child[joint]
        parent = parent_slot(s.joints, joint, static_slot)
        out = touch_fixed(child, True, s.work, touch_fixed(parent, True, s.work, sum))
        for side in range(2):
            slot = wp.where(side == 0, child, parent)
            if s.work.inv_mass[slot] == 0.0 and slot != static_slot and not s.tree.is_left[slot]:
                out.is_pushed = True  # its pose has been written since the last step
        q_p = anchor_rotation(s.tree, parent, s.joints.parent_frame[joint])
        q_c = anchor_rotation(s.tree, child, s.joints.child_frame[joint])
        arm = anchor_arm(child, s.joints.child_frame[joint], static_slot, s)
        moved_c = s.work.increment[child]
        moved_p = s.work.increment[parent]
        turn = wp.spatial_bottom(moved_c - moved_p)
        shift = wp.spatial_top(moved_c - moved_p) + wp.cross(turn, arm)
        shift += wp.cross(wp.spatial_bottom(moved_p), s.work.com[parent] - s.work.com[child])
        turn_away = wp.vec3(0.0)
        rest_away = wp.vec3(0.0)
        if wp.static(effects.kinds.balls and effects.drives):
            if s.joints.type[joint] == BALL:
                turn_away = ball_away(step.control.target_q, s.joints, joint, q_p, q_c)
        if wp.static(effects.kinds.balls and effects.springs):
            if s.joints.type[joint] == BALL:
                rest_away = ball_away(s.joints.rest_q, s.joints, joint, q_p, q_c)
        linear = linear_count(s.joints, joint)
        bent = wp.vec3(0.0)
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                # how far sweeps have bent it counts along the axes of the start
                bent = angles(s.joints, joint, q_p, q_c, wp.vec3(0.0), False)
        for dof in range(linear + angular_count(s.joints, joint)):
            index = s.joints.dof_start[joint] + dof
            moved = float(0.0)
            q = wp.float64(0.0)
            if wp.static(effects.coordinates):
                q = coordinate[first + dof]
                if wp.static(effects.rods):
                    if s.joints.type[joint] == ROD and dof >= linear:
                        q = wp.float64(bent[dof - linear])
                begun = start_coordinate[first + dof]
                if wp.static(effects.second_order):
                    # steps of second order start ahead
                    begun = s.history.coordinate[index].start
                moved = wp.float32(q - begun)
            if s.joints.type[joint] != ROD and step.control.joint_f[index] != 0.0:
                along = float(moved)
                if dof < linear:
                    along = wp.dot(linear_axis(s.joints, joint, dof, q_p), shift)
                elif not is_gimbal(s.joints, joint):
                    axis = angular_axis(s.joints, joint, dof - linear, q_p, q_c, wp.vec3(0.0))
                    along = wp.dot(axis, turn)
                out.before += step.control.joint_f[index] * along
            if wp.static(effects.coordinates):
                out.before += axis_work(
                    joint,
                    dof,
                    q,
                    moved,
                    s.tree.start_velocity[index],
                    turn_away,
                    rest_away,
                    h,
                    step,
                    s,
                )
            if wp.static(effects.armature):
                inertia = s.joints.armature[index]
                start = s.tree.start_velocity[index]
                end = s.history.axis_velocity[index]
                if inertia > 0.0:
                    out.before += 0.5 * inertia * start * start
                    out.after += 0.5 * inertia * end * end
        return out

    @wp.func
    def add_body(
        root: int,
        body: int,
        h: float,
        reach: float,
        static_slot: int,
        sum: Balance,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> Balance:
        """Adds a body: its energy, and the work of what acts on it."""
        out = sum
        increment = s.work.increment[body]
        velocity = s.islands.start_qd[body]
        mass = s.model.mass[body]
        inertia = world_inertia(
            wp.transform_get_rotation(s.islands.start_q[body]), s.model.inertia[body]
        )
        w = wp.spatial_bottom(velocity)
        out.before += kinetic_energy(body, s.islands.start_q[body], velocity, s.model)
        out.after += kinetic_energy(body, step.body_q_out[body], step.body_qd_out[body], s.model)
        # what acts on the body from outside, by where it would go and how fast it would turn
        force = wp.vec3(0.0)
        torque = wp.vec3(0.0)
        if wp.static(effects.second_order):
            wrench = s.work.wrench[body]
            if wp.static(effects.servos):
                drag = s.work.drag[body]
                wrench += drag.push - resistance(drag, step.body_qd_out[body])
            force = wp.spatial_top(wrench) + mass * s.model.gravity[s.model.world[body]]
            torque = wp.spatial_bottom(wrench)
        else:
            free = s.work.target[body] - h * velocity
            force = (mass / (h * h)) * wp.spatial_top(free)
            if wp.static(effects.gyroscopic):
                torque = (s.work.momentum[body] - inertia * w) / h
            else:
                torque = inertia * wp.spatial_bottom(free) / (h * h)
        out.start += kinetic_energy(body, s.islands.start_q[body], velocity, s.model)
        out.start += h * (wp.dot(force, wp.spatial_top(velocity)) + wp.dot(torque, w))
        if wp.static(not effects.drives and not effects.pushed_axes):
            # drives may make a body faster than anything was; without contacts the reach of a world
            # with weight is not measured
            if reach > 0.0 and h * wp.length(wp.spatial_top(step.body_qd_out[body])) > reach:
                out.is_wild = True
        out.before += wp.dot(force, wp.spatial_top(increment))
        out.before += wp.dot(torque, wp.spatial_bottom(increment))
        out.mass += mass
        place = s.work.com[body] - s.work.com[root]
        momentum = mass * wp.spatial_top(velocity) + h * force
        out.start_com += mass * place
        out.free_momentum += momentum
        out.free_angular += wp.cross(place, momentum) + inertia * w + h * torque
        # places count from the root, which keeps their digits
        out.com += mass * place_from(root, body, s.work)
        if wp.static(effects.contact):
            for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
                row = s.rows.rows[i]
                if wp.length_sq(row.force) > 0.0:
                    out = touch_fixed(row.b, False, s.work, out)
                    if wp.static(effects.moving_surfaces):
                        carried = s.rows.drift[i]
                        if wp.static(effects.restitution):
                            if s.rows.impacts[i].total > 0.0:
                                carried = s.rows.impacts[i].drift
                        if wp.length_sq(carried) > 0.0:
                            out.is_pushed = True
                if wp.static(effects.compliance):
                    span = s.work.com[body] - s.work.com[row.b]
                    u = contact_rows.slip(row, increment, s.work.increment[row.b], span)
                    stiffness = row.k_n / wp.max(1.0 - s.rows.share[i], 1.0e-6)
                    less = squared_overlap(row.gap)
                    less -= squared_overlap(row.gap + wp.dot(row.normal, u))
                    out.before += 0.5 * stiffness * less
        if wp.static(effects.joints):
            if is_linked(body, s):
                out = add_joint(
                    s.tree.joint[body],
                    s.tree.axis_start[body],
                    s.tree.coordinate,
                    s.tree.start_coordinate,
                    h,
                    static_slot,
                    out,
                    step,
                    s,
                )
        if wp.static(effects.loops):
            for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                joint = s.loops.joints[s.loops.items[k] / 2]
                if counts_here(body, s.loops.items[k], joint, s):
                    out = add_joint(
                        joint,
                        s.joints.dof_start[joint],
                        s.loops.coordinate,
                        s.loops.start_coordinate,
                        h,
                        static_slot,
                        out,
                        step,
                        s,
                    )
        return out

    @wp.func
    def take_back(
        joint: int, first: int, start_coordinate: wp.array[wp.float64], s: wp.ref[Solver]
    ):
        """Puts the coordinates of a joint back to where they were before the step."""
        if wp.static(effects.coordinates):
            for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                at = first + dof - s.joints.dof_start[joint]
                s.history.joint_angle[dof] = start_coordinate[at]
                if wp.static(effects.second_order):
                    s.history.joint_angle[dof] = s.history.coordinate[dof].start

    @wp.func
    def scale_rotors(joint: int, share: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """Scales the rates of a joint's coordinates, which armature goes on with."""
        for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
            s.history.axis_velocity[dof] = share * s.history.axis_velocity[dof]
        for end in range(2):
            body = wp.where(end == 0, s.joints.child[joint], s.joints.parent[joint])
            if body >= 0:
                if s.work.inv_mass[body] > 0.0:
                    s.history.joined_qd[joint, end] = step.body_qd_out[body]

    @wp.func
    def settle_island(root: int, h: float, s: wp.ref[Solver]):
        """Decides which motion is left of an island, and counts what is bounded."""
        sum = settle(s.islands.balance[root], h)
        s.islands.balance[root] = sum
        world = s.worlds.of_body[root]
        if sum.is_bounded:
            wp.atomic_add(s.worlds.bounded, world, 1)
            wp.atomic_add(s.worlds.excess, world, sum.after - wp.max(sum.before, 0.0))
            if wp.static(effects.second_order):
                s.history.smooth[world] = JUMPED
        if sum.is_pushed and sum.after > sum.before:
            wp.atomic_add(s.worlds.unbounded, world, 1)

    @wp.func
    def slow_body(body: int, h: float, step: wp.ref[Step], s: wp.ref[Solver]):
        """Gives a body the motion that is left of its island."""
        root = s.islands.parent[body]
        sum = s.islands.balance[root]
        if sum.is_rigid:
            turn = exp_quat(h * sum.angular)
            r = s.work.com[body] - s.work.com[root] - sum.start_com / sum.mass
            shift = wp.quat_rotate(turn, r) - r + h * sum.free_momentum
            pose = moved_pose(body, s.islands.start_q[body], shift, turn, s.model)
            step.body_q_out[body] = pose
            v = sum.free_momentum + wp.cross(sum.free_angular, wp.quat_rotate(turn, r))
            step.body_qd_out[body] = wp.spatial_vector(v, sum.free_angular)
            if wp.static(effects.joints):
                s.history.left_q[body] = pose
                s.history.lost[body] = wp.vec3(0.0)
                if is_linked(body, s):
                    joint = s.tree.joint[body]
                    first = s.tree.axis_start[body]
                    take_back(joint, first, s.tree.start_coordinate, s)
                if wp.static(effects.loops):
                    for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                        item = s.loops.items[k]
                        joint = s.loops.joints[item / 2]
                        if counts_here(body, item, joint, s):
                            first = s.joints.dof_start[joint]
                            take_back(joint, first, s.loops.start_coordinate, s)
        elif sum.is_bounded:
            r = place_from(root, body, s.work) - sum.com / sum.mass
            v = sum.free_momentum + wp.cross(sum.free_angular, r)
            velocity = wp.spatial_vector(v, sum.free_angular)
            if sum.share > 0.0:
                v = sum.momentum + wp.cross(sum.angular, r)
                inner = step.body_qd_out[body] - wp.spatial_vector(v, sum.angular)
                velocity += sum.share * inner
            step.body_qd_out[body] = velocity

    @wp.func
    def slow_rotors(body: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """After :func:`slow_body` of all bodies: scales the rotors of a body's joints."""
        sum = s.islands.balance[s.islands.parent[body]]
        share = sum.share
        if sum.is_bounded:
            if is_linked(body, s):
                scale_rotors(s.tree.joint[body], share, step, s)
            if wp.static(effects.loops):
                for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                    item = s.loops.items[k]
                    joint = s.loops.joints[item / 2]
                    if counts_here(body, item, joint, s):
                        scale_rotors(joint, share, step, s)

    @wp.func
    def bound_energy(
        first: int, end: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]
    ):
        """Slows the islands of a list of bodies down to the energy that they may have.

        Takes poses and velocities after the step. All bodies of an island are in the list, its
        root first.
        """
        for i in range(first, end):
            body = s.worlds.bodies[i]
            if s.work.inv_mass[body] > 0.0:
                root = island_of(s.islands, body)
                sum = add_body(
                    root,
                    body,
                    scale.h,
                    scale.reach,
                    scale.static_slot,
                    s.islands.balance[root],
                    step,
                    s,
                )
                s.islands.balance[root] = sum
                if wp.static(effects.tendons):
                    add_tendons(s.worlds.rank[body], root, s)
        for i in range(first, end):
            body = s.worlds.bodies[i]
            if s.work.inv_mass[body] > 0.0:
                root = s.islands.parent[body]
                sum = s.islands.balance[root]
                s.islands.balance[root] = add_momentum(body, root, sum, sum, step, s)
        for i in range(first, end):
            body = s.worlds.bodies[i]
            if s.work.inv_mass[body] > 0.0 and s.islands.parent[body] == body:
                settle_island(body, scale.h, s)
        for i in range(first, end):
            body = s.worlds.bodies[i]
            if s.work.inv_mass[body] > 0.0:
                slow_body(body, scale.h, step, s)
        if wp.static(effects.axis_rates):
            for i in range(first, end):
                body = s.worlds.bodies[i]
                if s.work.inv_mass[body] > 0.0:
                    slow_rotors(body, step, s)

    @wp.func
    def join_joints(body: int, static_slot: int, s: wp.ref[Solver]):
        """Makes one island of bodies that joints link, where contacts have not called for it."""
        if wp.static(effects.joints):
            if is_linked(body, s):
                join(body, s.tree.parent[body], s)
        if wp.static(effects.loops):
            for k in range(s.loops.body_start[body], s.loops.body_start[body + 1]):
                joint = s.loops.joints[s.loops.items[k] / 2]
                if s.loops.items[k] % 2 == 0 and s.joints.enabled[joint]:
                    parent = parent_slot(s.joints, joint, static_slot)
                    join(body, parent, s)

    @wp.func
    def is_body_led(body: int, s: wp.ref[Solver]) -> bool:
        """Whether the angles of the body's gimbal lead its pose where the step starts or ends.

        What acts on the angles then has long levers, whose changes within the step put energy in
        also where the sweeps have settled.
        """
        if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
            joint = s.tree.joint[body]
            first = s.tree.axis_start[body]
            if is_gimbal(s.joints, joint):
                start = known_angles(s.joints, joint, s.tree.start_coordinate, first)
                end = known_angles(s.joints, joint, s.tree.coordinate, first)
                return is_led(s.joints, joint, start) or is_led(s.joints, joint, end)
        return False

    @wp.func
    def is_flat(world: int, worlds: wp.ref[WorldWork]) -> bool:
        """Whether closed trees may have folded to where they have more energy."""
        if worlds.sweeps[world] < FLAT:
            return False
        return wp.static(not effects.contact) or worlds.update[world] > worlds.settled[world]

    @wp.func
    def gains_settled(world: int, s: wp.ref[Solver]) -> bool:
        """Whether a world may gain energy in a step that has settled: where a gimbal's angles lead,
        or closed trees are flat."""
        if wp.static(effects.folding):
            if is_flat(world, s.worlds):
                return True
        if wp.static(effects.kinds.gimbals):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                if is_body_led(s.worlds.bodies[i], s):
                    return True
        return False

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
                                sum.before += 0.5 * cables.compliance[seg] * pull * pull
                            if s.work.inv_mass[other] == 0.0 and cables.tension[seg] > 0.0:
                                sum = touch_fixed(other, True, s.work, sum)
                                is_static = other == s.work.inv_mass.shape[0] - 1
                                if not is_static and not s.tree.is_left[other]:
                                    sum.is_pushed = True  # the user has moved it
                            s.islands.balance[root] = sum

    @wp.func
    def drop_tensions(cluster: int, s: wp.ref[Solver]):
        """Forgets what pulls an island whose step was taken back: that is no start of the next one,
        nor does material slip by it."""
        cables = s.tree.cables
        for i in range(cables.cluster_start[cluster], cables.cluster_start[cluster + 1]):
            cable = cables.cables[i]
            for seg in range(first_segment(cable, cables), end_segment(cable, cables)):
                if cables.active[seg] == 1:
                    for side in range(2):
                        slot = slot_at(seg, side, cables)
                        if s.work.inv_mass[slot] > 0.0:
                            if s.islands.balance[island_of(s.islands, slot)].is_rigid:
                                cables.tension[seg] = 0.0

    @wp.func
    def bound_world(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]):
        """As :func:`bound_energy`, of all islands of a world."""
        first = s.worlds.body_start[world]
        end = s.worlds.body_start[world + 1]
        farthest = float(0.0)
        for i in range(first, end):
            farthest = wp.max(farthest, squared_move(s.worlds.bodies[i], s.work))
        if s.worlds.update[world] <= NEARLY * wp.sqrt(farthest):
            if not gains_settled(world, s):
                return
        for i in range(first, end):
            if s.work.inv_mass[s.worlds.bodies[i]] > 0.0:
                begin_balance(s.worlds.bodies[i], s.islands)
        if wp.static(not effects.islands):
            for i in range(first, end):
                body = s.worlds.bodies[i]
                if s.work.inv_mass[body] > 0.0:
                    join_joints(body, scale.static_slot, s)
            if wp.static(effects.tendons):
                for i in range(first, end):
                    join_tendons(i, s)
            if wp.static(effects.cables):
                for i in range(
                    s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]
                ):
                    join_cluster(i, s)
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                add_cables(i, s)
        bound_energy(first, end, scale, step, s)
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                drop_tensions(i, s)

    return EnergyFunctions(
        bound_world,
        is_body_led,
        is_flat,
        gains_settled,
        begin_balance,
        join_joints,
        join_tendons,
        join_cluster,
        add_cables,
        add_body,
        add_tendons,
        settle_island,
        slow_body,
        slow_rotors,
        drop_tensions,
    )
