# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Second order in time where the motion is smooth, on poses and velocities: see ``slopes.py``.

A step is backward Euler with a step H < h, which starts ahead by s and with the velocity v_n + ...:

    x_n+1 = x_n + s + H v_n+1,    v_n+1 = v_n + (b h a_n + A g_n) + H a_n+1

So the increment from x_n is still the unknown and is where constraints hold; the inertia is m/H^2,
the inertial target s + H (v_n + ...) + H^2 a, and the velocity (dx - s)/H, which dampers and
friction see. Rotations go by the rotation vectors of the steps, which commute to the third order of
h; momenta add up in world axes.

What extrapolates is wrong where the velocity jumps: a body that lands would bounce. A world takes
backward Euler in the step of an impact and in the one after it, where a contact lets go or an
external force jumps, after sweeps that did not settle, in its first step, and where its state is
not the one that the last step left. Forces that external wrenches exert count with all of their
impulse in the step that they are given for.
"""

from dataclasses import dataclass

import warp as wp

from ..algebra.so3 import exp_quat, rotation_vector, world_inertia
from ..blocks.body import target_spin, target_translation
from ..data import (
    BodyModel,
    BodyWork,
    ContactRow,
    History,
    IslandWork,
    JointModel,
    LoopWork,
    RowWork,
    TreeWork,
    WorldScale,
    WorldWork,
)
from ..effects import Effects
from ..rows import contact as contact_rows
from ..rows.joint import BALL, DISTANCE
from .bodies import body_at, has_rows, target_turn
from .cables import may_jerk
from .fluid import feel_fluid
from .islands import is_free_island
from .loops import has_loops
from .slopes import constants, end_axis, lead, next_slope, second_order
from .trees import is_linked

JOLT = wp.constant(0.5)
"""Closing of a contact by the velocity of the start of a step that is an impact, as a share of
g h^2: what a smooth force changes in a step is about that. Likewise the share of itself or of the
weight by which an external force jumps."""
LIMIT_JOLT = wp.constant(1.0e-5)
"""How far beyond a limit a coordinate that goes on is about to meet it [m or rad]."""
ROUNDING = wp.constant(1.0e-6)
"""Share of a move that the rounding of float32 velocities may make up."""
MOST_TURN = wp.constant(1.0)
"""Turn of a body in a step [rad] beyond which extrapolation says nothing."""


@wp.func
def spin_momentum(
    model: wp.ref[BodyModel], body: int, rotation: wp.quat, velocity: wp.spatial_vector
) -> wp.vec3:
    """Angular momentum of a body about its COM [N m s], world axes."""
    return world_inertia(rotation, model.inertia[body]) * wp.spatial_bottom(velocity)


@wp.func
def begin_bodies(
    world: int,
    h: float,
    body_qd: wp.array[wp.spatial_vector],
    worlds: wp.ref[WorldWork],
    work: wp.ref[BodyWork],
):
    """Backward Euler: nothing is ahead, and bodies coast by h v."""
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = body_at(i, worlds)
        work.lead[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        work.coasting[body] = work.increment[body]
        if work.inv_mass[body] > 0.0:
            work.coasting[body] = h * body_qd[body]


@wp.func
def beyond_rounding(change: wp.vec3, move: wp.vec3) -> wp.vec3:
    """A change of a move, or zero where the rounding of velocities may have made it."""
    least = ROUNDING * wp.length(move)
    return wp.where(wp.length_sq(change) > least * least, change, wp.vec3(0.0))


@wp.func
def external_wrench(
    model: wp.ref[BodyModel], body: int, work: wp.ref[BodyWork]
) -> wp.spatial_vector:
    """External force [N], weight included, and torque [N m] on a body."""
    weight = model.mass[body] * model.gravity[model.world[body]]
    return work.wrench[body] + wp.spatial_vector(weight, wp.vec3(0.0))


@wp.func
def jumps(now: wp.vec3, last: wp.vec3, least: float) -> bool:
    """Whether what pushes a body has changed by half of it, or half of ``least``."""
    most = wp.max(wp.max(wp.length_sq(now), wp.length_sq(last)), least * least)
    return wp.length_sq(now - last) > JOLT * JOLT * most


@wp.func
def is_continued(
    world: int,
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    scale: WorldScale,
    model: wp.ref[BodyModel],
    worlds: wp.ref[WorldWork],
    work: wp.ref[BodyWork],
    history: wp.ref[History],
) -> bool:
    """Whether all bodies of a world are as the last step left them, turned little in it, and are
    pushed as they were."""
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = body_at(i, worlds)
        if work.inv_mass[body] > 0.0:
            last = history.last[body]
            is_left = body_q[body] == last.pose and body_qd[body] == last.velocity
            turn = scale.h * wp.length(wp.spatial_bottom(last.slope))
            if not is_left or turn > MOST_TURN:
                return False
            wrench = external_wrench(model, body, work)
            force, torque = wp.spatial_top(wrench), wp.spatial_bottom(wrench)
            weight = scale.gravity * model.mass[body]
            if jumps(force, wp.spatial_top(last.wrench), weight):
                return False
            if jumps(torque, wp.spatial_bottom(last.wrench), 0.0):
                return False
    return True


@wp.func
def has_impact(body: int, jolt: float, work: wp.ref[BodyWork], rows: wp.ref[RowWork]) -> bool:
    """Whether a contact that a body owns closes by more than ``jolt`` [m] while bodies coast."""
    for i in range(rows.owned_start[body], rows.owned_end[body]):
        row = rows.rows[i]
        span = work.com[row.a] - work.com[row.b]
        u = contact_rows.slip(row, work.coasting[row.a], work.coasting[row.b], span)
        if wp.dot(row.normal, u) + wp.max(row.gap, 0.0) < -jolt:
            return True
    return False


@wp.func
def is_pushing(row: ContactRow) -> bool:
    """Whether the multiplier of a row pushes."""
    return wp.dot(row.normal, row.force) > 0.0


@wp.func
def lets_go(
    world: int, worlds: wp.ref[WorldWork], rows: wp.ref[RowWork], history: wp.ref[History]
) -> bool:
    """Whether a contact that pushed in the last step is gone or about to open."""
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = body_at(i, worlds)
        left = int(history.pushing[body])
        for k in range(rows.owned_start[body], rows.owned_end[body]):
            left -= int(is_pushing(rows.rows[k]))
        if left > 0:
            return True
    return False


@wp.func
def is_beyond(
    joints: wp.ref[JointModel], dof: int, at: wp.float64, history: wp.ref[History]
) -> bool:
    """Whether a coordinate that goes on as in the last step would be beyond a limit."""
    goes_to = wp.float32(at + (at - history.coordinate[dof].start))
    lower = joints.limit_lower[dof] - LIMIT_JOLT
    return goes_to < lower or goes_to > joints.limit_upper[dof] + LIMIT_JOLT


@wp.func
def lead_spin(
    world: int,
    scale: WorldScale,
    body_q: wp.array[wp.transform],
    model: wp.ref[BodyModel],
    worlds: wp.ref[WorldWork],
    work: wp.ref[BodyWork],
    islands: wp.ref[IslandWork],
    history: wp.ref[History],
):
    """Has :func:`.islands.keep_spin` restore the angular momentum of a step of second order.

    A free island lacks sum r x m v + I w at the start, and what wrenches add, less that at the end,
    each with its own poses. By the arms of the start alone what holds bodies together would not
    cancel: constraints act where bodies end, and these have not moved along their velocities. How
    far the island's COM has moved [m] goes to its ``momentum``.
    """
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = worlds.bodies[i]
        if work.inv_mass[body] > 0.0 and is_free_island(islands, body, -1):
            root = islands.parent[body]
            total = islands.sum[root]
            if body == root:
                total.momentum = wp.vec3(0.0)
            share = model.mass[body] / total.mass
            total.momentum += share * wp.spatial_top(work.increment[body])
            islands.sum[root] = total
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = worlds.bodies[i]
        if work.inv_mass[body] > 0.0 and is_free_island(islands, body, -1):
            velocity = history.last[body].velocity
            push = scale.h * work.wrench[body]
            v = wp.spatial_top(velocity) + model.inv_mass[body] * wp.spatial_top(push)
            free = work.lead[body] + wp.spatial_vector(scale.step * v, wp.vec3(0.0))
            work.target[body] = free
            moved = wp.spatial_top(work.increment[body])
            moved -= islands.sum[islands.parent[body]].momentum
            momentum = spin_momentum(model, body, wp.transform_get_rotation(body_q[body]), velocity)
            momentum += wp.spatial_bottom(push)
            # keep_spin has the arms of the end
            momentum -= model.mass[body] * wp.cross(moved, v)
            work.momentum[body] = momentum


@dataclass(frozen=True)
class Bdf2Functions:
    """Device functions of the second-order scheme, compiled for a scene's effects."""

    begin_step: wp.Function
    remember_motion: wp.Function
    remember_loops: wp.Function
    remember_state: wp.Function


def make_bdf2(effects: Effects) -> Bdf2Functions:
    """Generates the functions for a scene's effects."""
    a, b = constants(effects.rho)

    @wp.func
    def meets_limit(
        world: int,
        joints: wp.ref[JointModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> bool:
        """Whether a joint of a world is about to meet a limit."""
        for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
            body = body_at(i, worlds)
            if work.inv_mass[body] > 0.0 and is_linked(joints, tree, body):
                joint = tree.joint[body]
                k = tree.axis_start[body]
                for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
                    if joints.type[joint] != BALL:
                        if is_beyond(joints, dof, tree.coordinate[k], history):
                            return True
                    k += 1
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                joint = loops.joints[i]
                for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
                    if joints.type[joint] != BALL:
                        if is_beyond(joints, dof, loops.coordinate[dof], history):
                            return True
        return False

    @wp.func
    def is_smooth(
        world: int,
        scale: WorldScale,
        joints: wp.ref[JointModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> bool:
        """Whether no velocity of a world is about to jump, and no linked body turns fast."""
        if wp.static(effects.spinning):
            for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
                if wp.length_sq(work.spin_momentum[body_at(i, worlds)]) > 0.0:
                    return False
        if wp.static(effects.contact):
            jolt = JOLT * scale.gravity * scale.h * scale.h
            for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
                body = body_at(i, worlds)
                if has_impact(body, jolt, work, rows):
                    return False
                if wp.static(effects.compliance):
                    # a compliant row's gap holds its damping by backward Euler
                    if rows.owned_start[body] < rows.owned_end[body]:
                        return False
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                if joints.type[loops.joints[i]] == DISTANCE:
                    return False
        if wp.static(effects.cables):
            for i in range(tree.cables.world_start[world], tree.cables.world_start[world + 1]):
                if may_jerk(i, work, tree.cables):
                    return False
        if wp.static(effects.hard_limits):
            return not meets_limit(world, joints, worlds, work, tree, loops, history)
        return True

    @wp.func
    def lead_body(
        body: int,
        is_free: bool,
        scale: WorldScale,
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        model: wp.ref[BodyModel],
        work: wp.ref[BodyWork],
        history: wp.ref[History],
    ):
        """Lead, target and first guess of a body."""
        step = scale.step
        velocity = body_qd[body]
        if work.inv_mass[body] == 0.0:
            # goes h v, and is felt to move at v
            work.lead[body] = (scale.h - step) * velocity
            if wp.static(effects.put_bodies):
                work.put[body] = (step / scale.h) * work.put[body]
            return
        last = history.last[body]
        ahead = lead(scale, velocity, last.slope)
        v = velocity + lead(scale, last.acceleration, last.gain)
        # external forces are those of the whole step: all of their impulse, none of the last one's
        wrench = (scale.h / step) * external_wrench(model, body, work)
        push = model.inv_mass[body] * wp.spatial_top(wrench)
        dx = target_translation(wp.spatial_top(v), push, step)
        rotation = wp.transform_get_rotation(body_q[body])
        turn = wp.spatial_bottom(ahead)
        dtheta = wp.vec3(0.0)
        end = rotation
        if wp.static(effects.gyroscopic):
            momentum = spin_momentum(model, body, rotation, velocity)
            momentum += step * wp.spatial_bottom(wrench)
            if is_free:
                start = exp_quat(turn) * rotation
                kept = wp.quat_rotate_inv(start, momentum)
                w = target_spin(model.inertia[body], model.inv_inertia[body], kept, step)
                end = start * exp_quat(step * w)
                dtheta = rotation_vector(end * wp.quat_inverse(rotation)) - turn
            else:
                momentum += lead(scale, last.torque, last.spun)
                # the inertia of the end of the step, where the body goes if all stays smooth
                spin = wp.spatial_bottom(velocity + scale.h * last.gain)
                end = exp_quat(turn + step * spin) * rotation
                work.inertia[body] = world_inertia(end, model.inertia[body])
                dtheta = step * (world_inertia(end, model.inv_inertia[body]) * momentum)
            work.momentum[body] = momentum
        else:
            dtheta = target_turn(model, body, rotation, v, wrench, step)
        work.target[body] = ahead + wp.spatial_vector(dx, dtheta)
        if wp.static(effects.fluid):
            feel_fluid(body, end, velocity, ahead, step, model, work)
        target = work.target[body]
        coasting = ahead + step * v
        work.lead[body] = ahead
        work.coasting[body] = coasting
        # what pushed it at the end of the last step goes on to
        pushed = last.acceleration
        if wp.static(effects.gyroscopic):
            spun = world_inertia(rotation, model.inv_inertia[body]) * last.torque
            pushed = wp.spatial_vector(wp.spatial_top(pushed), spun)
        pushed_shift = beyond_rounding((step * step) * wp.spatial_top(pushed), dx)
        pushed_turn = beyond_rounding((step * step) * wp.spatial_bottom(pushed), dtheta)
        work.increment[body] = target + wp.spatial_vector(pushed_shift, pushed_turn)

    @wp.func
    def lead_rows(body: int, scale: WorldScale, work: wp.ref[BodyWork], rows: wp.ref[RowWork]):
        """Penalties of the rows that a body owns, by the step; friction sees velocities."""
        stiffer = (scale.h * scale.h) / (scale.step * scale.step)
        for i in range(rows.owned_start[body], rows.owned_end[body]):
            row = rows.rows[i]
            rows.rows[i].k_n = stiffer * row.k_n
            rows.rows[i].k_t = stiffer * row.k_t
            if wp.static(effects.angular_friction):
                rows.spin[i].k_twist = stiffer * rows.spin[i].k_twist
                rows.spin[i].k_roll = stiffer * rows.spin[i].k_roll
            if wp.static(effects.drift):
                span = work.com[row.a] - work.com[row.b]
                slid = contact_rows.slip(row, work.lead[row.a], work.lead[row.b], span)
                slid -= wp.dot(row.normal, slid) * row.normal
                rows.drift[i] = (scale.step / scale.h) * rows.drift[i] - slid

    @wp.func
    def begin_step(
        world: int,
        has_bounce: bool,
        scale: WorldScale,
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> WorldScale:
        """Decides on the order of a world's step, and makes targets and rows those of BDF2."""
        out = scale
        begin_bodies(world, scale.h, body_qd, worlds, work)
        smooth = not has_bounce and is_smooth(
            world, scale, joints, worlds, work, rows, tree, loops, history
        )
        was_smooth = history.smooth[world] != 0 and history.age[world] > 0
        history.smooth[world] = int(smooth)
        if (
            smooth
            and was_smooth
            and not lets_go(world, worlds, rows, history)
            and is_continued(world, body_q, body_qd, scale, model, worlds, work, history)
        ):
            age = history.slope_age[world]
            out = second_order(scale, age, wp.static(a), wp.static(b))
            for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
                body = body_at(i, worlds)
                # the drag of a fluid is a force of the end of the step, as a constraint's is
                is_free = bool(wp.static(not effects.fluid))
                if wp.static(effects.contact):
                    is_free = is_free and not has_rows(rows, body)
                if wp.static(effects.joints):
                    is_free = is_free and worlds.block_end[i] == i + 1 and tree.joint[body] < 0
                if wp.static(effects.loops):
                    is_free = is_free and not has_loops(loops, body)
                lead_body(body, is_free, out, body_q, body_qd, model, work, history)
            if wp.static(effects.contact):
                for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
                    lead_rows(body_at(i, worlds), out, work, rows)
        worlds.step[world] = out.step
        history.slope_age[world] = wp.where(out.step < out.h, wp.static(a), 0.5) * out.h
        return out

    @wp.func
    def remember_motion(
        body: int,
        start_velocity: wp.spatial_vector,
        scale: WorldScale,
        joints: wp.ref[JointModel],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        history: wp.ref[History],
    ):
        """How a body has moved in the step, before anything old is recovered, and what pushes."""
        if wp.static(effects.contact):
            pushing = int(0)
            for i in range(rows.owned_start[body], rows.owned_end[body]):
                pushing += int(is_pushing(rows.rows[i]))
            history.pushing[body] = pushing
        if wp.static(effects.joints and effects.coordinates):
            if is_linked(joints, tree, body):
                joint = tree.joint[body]
                k = tree.axis_start[body]
                for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
                    end_axis(
                        dof,
                        tree.start_coordinate[k],
                        tree.coordinate[k],
                        scale,
                        history.coordinate,
                    )
                    k += 1
        last = history.last[body]
        # until the step is done, that of its start
        last.velocity = start_velocity
        last.slope = next_slope(scale, work.increment[body], last.slope)
        history.last[body] = last

    @wp.func
    def remember_loops(
        world: int,
        scale: WorldScale,
        joints: wp.ref[JointModel],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ):
        """Likewise the coordinates of a world's loop joints."""
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                joint = loops.joints[i]
                for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
                    end_axis(
                        dof,
                        loops.start_coordinate[dof],
                        loops.coordinate[dof],
                        scale,
                        history.coordinate,
                    )

    @wp.func
    def remember_state(
        body: int,
        pose: wp.transform,
        velocity: wp.spatial_vector,
        scale: WorldScale,
        body_q: wp.array[wp.transform],
        model: wp.ref[BodyModel],
        work: wp.ref[BodyWork],
        history: wp.ref[History],
    ):
        """Where a step has left a body, how fast, and what its constraints did to that."""
        last = history.last[body]
        before = wp.transform_get_rotation(body_q[body])
        wrench = external_wrench(model, body, work)
        given = wp.spatial_vector(model.inv_mass[body] * wp.spatial_top(wrench), wp.vec3(0.0))
        if wp.static(effects.gyroscopic):
            after = wp.transform_get_rotation(pose)
            change = spin_momentum(model, body, after, velocity)
            change -= spin_momentum(model, body, before, last.velocity)
            change -= scale.h * wp.spatial_bottom(wrench)
            last.torque = (change - lead(scale, last.torque, last.spun)) / scale.step
            last.spun = next_slope(scale, change, last.spun)
        else:
            spin = world_inertia(before, model.inv_inertia[body]) * wp.spatial_bottom(wrench)
            given = wp.spatial_vector(wp.spatial_top(given), spin)
        gain = velocity - last.velocity - scale.h * given
        last.acceleration = (gain - lead(scale, last.acceleration, last.gain)) / scale.step
        last.gain = next_slope(scale, gain, last.gain)
        last.velocity = velocity
        last.wrench = wrench
        last.pose = pose
        history.last[body] = last

    return Bdf2Functions(begin_step, remember_motion, remember_loops, remember_state)
