# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Second order in time where the motion is smooth, on poses and velocities: see ``slopes.py``.

A step is backward Euler with a step H < h, which starts ahead by s and with the velocity v_n + ...:

    x_n+1 = x_n + s + H v_n+1,    v_n+1 = v_n + (b h a_n + A g_n) + H a_n+1

So the increment from x_n is still the unknown and is where constraints hold; the inertia is m/H^2,
the inertial target s + H (v_n + ...) + H^2 a, and the velocity (dx - s)/H, which dampers and
friction see. Rotations go by the rotation vectors of the steps, which commute to the third order of
h; momenta add up in world axes.

A body that flies, held by nothing, takes the trapezoidal rule instead, and the implicit midpoint
rule for its spin where that is slow. Where no velocity of what is held changes, the next step is
backward Euler.

What extrapolates is wrong where the velocity jumps: a body that lands would bounce. A world takes
backward Euler in the step of an impact and in the one after it, where a contact lets go or an
external force jumps, after sweeps that did not settle, in its first step, and where its state is
not the one that the last step left. Forces that external wrenches exert count with all of their
impulse in the step that they are given for.
"""

from dataclasses import dataclass

import warp as wp

from ..algebra.so3 import exp_quat, turned_by, turned_inertia
from ..blocks.body import target_translation
from ..data import BodyModel, BodyWork, ContactRow, History, Solver, Step, WorldScale
from ..effects import Effects
from ..rows import contact as contact_rows
from ..rows.euler import make_euler
from ..rows.joint import BALL, DISTANCE, make_counts
from .anchors import is_linked
from .beginning import is_in_tree
from .bodies import body_at, mean_spin, takes_midpoint, target_turn
from .cables import may_jerk
from .carrying import flight_from, gained_in_flight, is_carried, is_short
from .drag import make_feel_drag
from .energy import rigid_spin, squared_move
from .islands import is_free_island
from .loops import has_loops
from .piles import row_count, row_of
from .rolling import make_point_moves, moves_levers
from .sides import make_written_side
from .slopes import (
    JUMPED,
    LASTING,
    QUIET_WORLD,
    RHO,
    SMOOTH,
    UNRESOLVED,
    constants,
    end_axis,
    follows_second_order,
    is_going_on,
    lead,
    next_slope,
    second_order,
)
from .tendons import meets_range

JOLT = wp.constant(0.5)
"""Closing of a contact by the velocity of the start of a step that is an impact, as a share of
g h^2: what a smooth force changes in a step is about that. Likewise the share of itself or of the
weight by which an external force jumps."""
TOUCH = wp.constant(0.02)
"""Share of that which is an impact of a contact that did not push in the last step: a box that lost
99 % of its weight and comes back slowly would bounce otherwise."""
LIMIT_JOLT = wp.constant(1.0e-5)
"""How far beyond a limit a coordinate that goes on is about to meet it [m or rad]."""
ROUNDING = wp.constant(1.0e-6)
"""Share of a move that the rounding of float32 velocities may make up."""
QUIET = wp.constant(2.0e-3)
"""Change of a velocity in a step, as a share of that of a free fall, below which a body goes on as
it goes: the error of backward Euler is half a step times it."""
STIR = wp.constant(5.0e-6)
"""Move of a step, as a share of how far a body is from the origin, or of a meter, that says nothing
of the next one: rotations are rounded by a percent of it, and what stands would go on so."""
FAR_STIR = wp.constant(5.0e-7)
"""What positions far from the origin, which are rounded by a tenth of it, add to that."""
SLOW = wp.constant(1.0e-2)
"""Turn of a step [rad] up to which the mean of the spins at its ends keeps the energy of what
flies: it gains 5e-8 of it a step at 0.05 rad, and some 5e-12 here."""
RESOLVED = wp.constant(0.3)
"""Share of its velocity, or of that of a free fall, that a body may gain in a step by how much its
acceleration has changed since the last one: w^2 h^2 of an oscillation. With 0.5 taut grids stay
quiet, too; without it they gain energy without end."""
HELD_BY_STOP = wp.constant(4)
"""What a stop that holds adds to how friction of an axis pushes: 1 to 3."""
INPUTS = wp.constant(4.0)
"""How much more than what the forces of a controller change by the acceleration may: twice."""
MOST_TURN = wp.constant(0.2)
"""Turn of a body in a step [rad] beyond which extrapolation says nothing: with 0.25 a top gains
energy, with 1 a light body on a stiff two-way tendon spins up without end."""


@wp.func
def spin_momentum(
    model: wp.ref[BodyModel], body: int, rotation: wp.quat, velocity: wp.spatial_vector
) -> wp.vec3:
    """Angular momentum of a body about its COM [N m s], world axes."""
    return turned_inertia(rotation, model.inertia[body], wp.spatial_bottom(velocity))


@wp.func
def beyond_rounding(change: wp.vec3, move: wp.vec3) -> wp.vec3:
    """A change of a move, or zero where the rounding of velocities may have made it."""
    least = ROUNDING * wp.length(move)
    return wp.where(wp.length_sq(change) > least * least, change, wp.vec3(0.0))


@wp.func
def energy_of(mass: float, inertia: wp.mat33, velocity: wp.spatial_vector) -> float:
    """Twice a kinetic energy [J], with the inertia in world axes."""
    spin = wp.spatial_bottom(velocity)
    return mass * wp.length_sq(wp.spatial_top(velocity)) + wp.dot(spin, inertia * spin)


@wp.func
def external_wrench(body: int, s: wp.ref[Solver]) -> wp.spatial_vector:
    """External force [N], weight included, and torque [N m] on a body."""
    weight = s.model.mass[body] * s.model.gravity[s.model.world[body]]
    return s.work.wrench[body] + wp.spatial_vector(weight, wp.vec3(0.0))


@wp.func
def given_energy(
    mass: float, inertia: wp.mat33, wrench: wp.spatial_vector, scale: WorldScale
) -> float:
    """Twice the kinetic energy that a wrench gives a body at rest in a step [J]."""
    force, torque = wp.spatial_top(wrench), wp.spatial_bottom(wrench)
    push = wp.length_sq(force) / mass + wp.dot(torque, rigid_spin(inertia, torque))
    return scale.h * scale.h * push


@wp.func
def jumps(
    body: int,
    now: wp.spatial_vector,
    velocity: wp.spatial_vector,
    scale: WorldScale,
    s: wp.ref[Solver],
) -> bool:
    """Whether what pushes a body has changed by half of it, or half of the weight.

    Wrenches count by the energy that they give in a step. What gives next to nothing beside that of
    the body is no jump.
    """
    mass, inertia = s.model.mass[body], s.work.inertia[body]
    last = s.history.last[body].wrench
    most = wp.max(given_energy(mass, inertia, now, scale), given_energy(mass, inertia, last, scale))
    weight = scale.gravity * scale.h
    most = wp.max(most, mass * weight * weight)
    small = QUIET * QUIET * energy_of(mass, inertia, velocity)
    return given_energy(mass, inertia, now - last, scale) > JOLT * JOLT * most + small


@wp.func
def is_led_on(
    body: int, velocity: wp.spatial_vector, scale: WorldScale, history: wp.ref[History]
) -> bool:
    """Whether a body that the solver does not move gains as much velocity as in the last step.

    By the measure of :func:`is_resolved`, of moves and, a meter away, of turns.
    """
    last = history.last[body]
    change = velocity - last.velocity - scale.h * last.acceleration
    fall = RESOLVED * scale.gravity * scale.h
    v, w = wp.spatial_top(velocity), wp.spatial_bottom(velocity)
    moved, turned = wp.spatial_top(change), wp.spatial_bottom(change)
    share = RESOLVED * RESOLVED
    moves_on = wp.length_sq(moved) <= share * wp.length_sq(v) + fall * fall
    return moves_on and wp.length_sq(turned) <= share * wp.length_sq(w) + fall * fall


@wp.func
def remember_led(
    body: int, velocity: wp.spatial_vector, scale: WorldScale, history: wp.ref[History]
):
    """What :func:`is_led_on` compares with."""
    began = history.last[body].velocity
    history.last[body].acceleration = (velocity - began) / scale.h
    history.last[body].velocity = velocity


@wp.func
def is_remembered(world: int, scale: WorldScale, history: wp.ref[History]) -> bool:
    """Whether the motion of a step is one to go on from, or was one that went on."""
    return is_going_on(history.smooth[world]) or scale.step < scale.h


@wp.func
def last_of(world: int, history: wp.ref[History]) -> int:
    """How the last step of a world was; the first one follows a jump."""
    return wp.where(history.age[world] > 0, history.smooth[world], JUMPED)


@wp.func
def parabola(
    slot: int, h: float, body_qd: wp.array[wp.spatial_vector], work: wp.ref[BodyWork]
) -> wp.spatial_vector:
    """Where a body goes that flies, from its target by backward Euler."""
    if work.inv_mass[slot] == 0.0:
        return work.target[slot]
    return 0.5 * (work.target[slot] + h * body_qd[slot])


@wp.func
def is_flying(body: int, history: wp.ref[History]) -> bool:
    """Whether nothing holds a body in this step, as :func:`begin_step` has found."""
    return history.flying[body] != 0


@wp.func
def is_quiet(
    body: int, velocity: wp.spatial_vector, may_stand: bool, scale: WorldScale, s: wp.ref[Solver]
) -> bool:
    """Whether the velocity of a body has not changed in a step: all schemes agree there.

    What flies does not count, nor, in scenes with contacts, what moves by little more than
    rounding. A change counts by its kinetic energy, beside that of a share of a free fall's.
    """
    if s.work.inv_mass[body] == 0.0 or is_flying(body, s.history):
        return True
    if may_stand:
        far = wp.length(s.work.com[body])
        stir = STIR * wp.min(far, 1.0) + FAR_STIR * far
        if squared_move(body, s.work) <= stir * stir:
            return True
    fall = QUIET * scale.gravity * scale.h
    change = velocity - s.history.last[body].velocity
    mass, inertia = s.model.mass[body], s.work.inertia[body]
    allowed = ROUNDING * ROUNDING * energy_of(mass, inertia, velocity) + mass * fall * fall
    return energy_of(mass, inertia, change) <= allowed


@wp.func
def is_resolved(
    body: int,
    velocity: wp.spatial_vector,
    change: wp.spatial_vector,
    scale: WorldScale,
    s: wp.ref[Solver],
) -> bool:
    """Whether steps are short beside the time in which what holds a body changes.

    What its acceleration changes in a step counts by the kinetic energy that it gives in one,
    beyond what changes of a controller's forces give. For a tree with drives along all axes that
    nothing else holds steps are always short enough: what changes fast there are the drives.
    """
    mass, inertia = s.model.mass[body], s.work.inertia[body]
    fall = RESOLVED * scale.gravity * scale.h
    allowed = RESOLVED * RESOLVED * energy_of(mass, inertia, velocity) + mass * fall * fall
    return (
        energy_of(mass, inertia, scale.h * change) <= allowed + INPUTS * s.work.input_energy[body]
    )


@wp.func
def is_continued(
    body: int, body_qd: wp.array[wp.spatial_vector], scale: WorldScale, s: wp.ref[Solver]
) -> bool:
    """Whether a body is as the last step left it, turned little in it, and is pushed as it was."""
    if is_flying(body, s.history):
        return True
    if s.work.inv_mass[body] == 0.0:
        return is_led_on(body, body_qd[body], scale, s.history)
    if not (s.work.pose[body] == s.history.last[body].pose):
        return False
    if not (body_qd[body] == s.history.last[body].velocity):
        return False
    spin = wp.spatial_bottom(s.history.last[body].slope)
    if scale.h * scale.h * wp.length_sq(spin) > MOST_TURN * MOST_TURN:
        return False
    wrench = external_wrench(body, s)
    if not (wrench == s.history.last[body].wrench):
        return not jumps(body, wrench, body_qd[body], scale, s)
    return True


@wp.func
def is_pushing(row: ContactRow) -> bool:
    """Whether the multiplier of a row pushes."""
    return wp.dot(row.normal, row.force) > 0.0


@wp.func
def has_impact(body: int, jolt: float, s: wp.ref[Solver]) -> bool:
    """Whether a contact that a body owns closes by more than ``jolt`` [m] while bodies coast, or by
    a share of it where it did not push."""
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        row = s.rows.rows[i]
        span = s.work.com[row.a] - s.work.com[row.b]
        u = contact_rows.slip(row, s.work.coasting[row.a], s.work.coasting[row.b], span)
        least = wp.where(is_pushing(row), jolt, TOUCH * jolt)
        if wp.dot(row.normal, u) + wp.max(row.gap, 0.0) < -least:
            return True
    return False


@wp.func
def stops_sliding(body: int, has_drift: bool, s: wp.ref[Solver]) -> bool:
    """Whether friction of a contact that a body owns, and that slid, turns round or holds."""
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        row = s.rows.rows[i]
        span = s.work.com[row.a] - s.work.com[row.b]
        u = contact_rows.slip(row, s.work.coasting[row.a], s.work.coasting[row.b], span)
        if has_drift:
            u += s.rows.drift[i]
        if contact_rows.ends_sliding(row, u):
            return True
    return False


@wp.func
def lets_go(body: int, s: wp.ref[Solver]) -> bool:
    """Whether a contact of a body that pushed in the last step is gone or about to open."""
    left = int(s.history.pushing[body])
    for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
        left -= int(is_pushing(s.rows.rows[i]))
    return left > 0


@wp.func
def is_beyond(world: int, dof: int, at: wp.float64, s: wp.ref[Solver]) -> bool:
    """Whether a coordinate that goes on as in the last step would be beyond a limit.

    Before the first step of a world nobody knows.
    """
    if s.history.age[world] == 0:
        return False
    goes_to = wp.float32(at + (at - s.history.coordinate[dof].start))
    lower = s.joints.limit_lower[dof] - LIMIT_JOLT
    return goes_to < lower or goes_to > s.joints.limit_upper[dof] + LIMIT_JOLT


@wp.func
def lead_spin(world: int, scale: WorldScale, s: wp.ref[Solver]):
    """Has :func:`.islands.keep_spin` restore the angular momentum of a step of second order.

    A free island lacks sum r x m v + I w at the start, and what wrenches add, less that at the end,
    each with its own poses. By the arms of the start alone what holds bodies together would not
    cancel: constraints act where bodies end, and these have not moved along their velocities. How
    far the island's COM has moved [m] goes to its ``momentum``.
    """
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = s.worlds.bodies[i]
        if s.work.inv_mass[body] > 0.0 and is_free_island(s.islands, body, -1):
            root = s.islands.parent[body]
            moved = wp.vec3(0.0)
            if body != root:
                moved = s.islands.sum[root].momentum
            share = s.model.mass[body] / s.islands.sum[root].mass
            moved += share * wp.spatial_top(s.work.increment[body])
            s.islands.sum[root].momentum = moved
    for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
        body = s.worlds.bodies[i]
        if s.work.inv_mass[body] > 0.0 and is_free_island(s.islands, body, -1):
            velocity = s.history.last[body].velocity
            push = scale.h * s.work.wrench[body]
            v = wp.spatial_top(velocity) + s.model.inv_mass[body] * wp.spatial_top(push)
            s.work.coasting[body] = wp.spatial_vector(scale.step * v, wp.vec3(0.0))
            moved = wp.spatial_top(s.work.increment[body])
            moved -= s.islands.sum[s.islands.parent[body]].momentum
            momentum = spin_momentum(
                s.model, body, wp.transform_get_rotation(s.work.pose[body]), velocity
            )
            momentum += wp.spatial_bottom(push)
            # keep_spin has the arms of the end
            momentum -= s.model.mass[body] * wp.cross(moved, v)
            s.work.momentum[body] = momentum


@dataclass(frozen=True)
class SecondOrderFunctions:
    """Device functions of the second-order scheme, compiled for a scene's effects."""

    begin_step: wp.Function
    begin_body: wp.Function
    body_jumps: wp.Function
    loop_jumps: wp.Function
    goes_on: wp.Function
    order_world: wp.Function
    start_body: wp.Function
    lead_rows: wp.Function
    slips_otherwise: wp.Function
    remember_motion: wp.Function
    remember_motions: wp.Function
    remember_loop: wp.Function
    remember_state: wp.Function
    remember_states: wp.Function


def make_second_order(effects: Effects) -> SecondOrderFunctions:
    """Generates the functions for a scene's effects."""
    a, b = constants(0.0 if effects.cables else RHO)
    a_0, b_0 = constants(0.0)
    may_be_taut = effects.loops or effects.closures or effects.cables or effects.tendons
    counts = make_counts(effects.kinds)
    is_gimbal, linear_count = counts.is_gimbal, counts.linear_count
    euler = make_euler(effects.kinds)
    is_led, known_angles = euler.is_led, euler.known_angles
    feel_drag = make_feel_drag(effects)
    written_side = make_written_side(effects)
    point_moves = make_point_moves(effects)

    @wp.func
    def body_jumps(world: int, i: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Whether the velocity of a body is about to jump, or a linked body turns fast."""
        body = body_at(i, s.worlds)
        if wp.static(effects.spinning):
            if wp.length_sq(s.work.spin_momentum[body]) > 0.0:
                return True
        if wp.static(effects.contact):
            if has_impact(body, JOLT * scale.gravity * scale.h * scale.h, s):
                return True
            if wp.static(effects.friction):
                if stops_sliding(body, wp.static(effects.drift), s):
                    return True
            if wp.static(effects.compliance):
                # a compliant row's gap holds its damping by backward Euler
                if s.rows.owned_start[body] < s.rows.owned_end[body]:
                    return True
        if wp.static(effects.tendons and not effects.compliance):
            if meets_range(i, scale.h, s.tree):
                return True
        if wp.static(effects.kinds.gimbals and effects.axis_rates):
            # the rates of rotors change fast where angles lead the pose
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                joint = s.tree.joint[body]
                if is_gimbal(s.joints, joint):
                    angles = known_angles(
                        s.joints, joint, s.tree.coordinate, s.tree.axis_start[body]
                    )
                    if is_led(s.joints, joint, angles):
                        return True
        if wp.static(effects.joints and effects.joint_friction):
            # rates are known of steps that were smooth
            is_known = is_going_on(last_of(world, s.history))
            if is_known and s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                joint = s.tree.joint[body]
                for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                    stopped = s.joints.friction[dof] * s.history.input[dof].mobility * scale.h
                    if s.history.piece[dof][2] != 0:
                        # friction stops in this step what slips
                        if wp.abs(s.history.coordinate[dof].rate) < stopped:
                            return True
        if wp.static(effects.joints and effects.hard_limits):
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                joint = s.tree.joint[body]
                k = s.tree.axis_start[body]
                for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                    if s.joints.type[joint] != BALL:
                        if is_beyond(world, dof, s.tree.coordinate[k], s):
                            return True
                    k += 1
        return False

    @wp.func
    def loop_jumps(world: int, i: int, s: wp.ref[Solver]) -> bool:
        """Whether a joint outside of the trees is about to meet a limit, or may pull at once."""
        joint = s.loops.joints[i]
        if s.joints.type[joint] == DISTANCE:
            return True
        if wp.static(effects.hard_limits):
            for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                if s.joints.type[joint] != BALL:
                    if is_beyond(world, dof, s.loops.coordinate[dof], s):
                        return True
        return False

    @wp.func
    def is_smooth(world: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Whether no velocity of a world is about to jump."""
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            if body_jumps(world, i, scale, s):
                return False
        if wp.static(effects.loops):
            for i in range(s.loops.world_start[world], s.loops.world_start[world + 1]):
                if loop_jumps(world, i, s):
                    return False
        if wp.static(effects.cables):
            for i in range(s.tree.cables.world_start[world], s.tree.cables.world_start[world + 1]):
                if may_jerk(i, s):
                    return False
        return True

    @wp.func
    def goes_on(
        body: int, body_qd: wp.array[wp.spatial_vector], scale: WorldScale, s: wp.ref[Solver]
    ) -> bool:
        """Whether a body moves on as in the last step."""
        if wp.static(effects.contact):
            if lets_go(body, s):
                return False
        return is_continued(body, body_qd, scale, s)

    @wp.func
    def will_fly(
        i: int,
        body: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        s: wp.ref[Solver],
    ) -> bool:
        """Whether nothing holds a body in a step, not even a contact that its parabola nears."""
        if wp.static(effects.drag or effects.cables or effects.tendons):
            return False
        if wp.static(effects.joints):
            if is_in_tree(i, s):
                return False
        if wp.static(effects.loops):
            if has_loops(s.loops, body):
                return False
        if wp.static(effects.contact):
            for k in range(row_count(body, s.rows)):
                row = s.rows.rows[row_of(body, k, s.rows)]
                span = s.work.com[row.a] - s.work.com[row.b]
                target_a = parabola(row.a, scale.h, body_qd, s.work)
                target_b = parabola(row.b, scale.h, body_qd, s.work)
                u = contact_rows.slip(row, target_a, target_b, span)
                is_near = wp.dot(row.normal, u) + row.gap <= scale.slop
                if is_near or wp.length_sq(row.force) > 0.0:
                    return False
        return True

    @wp.func
    def begin_body(
        i: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ) -> bool:
        """A body by backward Euler, so that nothing is ahead; returns whether it is held."""
        body = body_at(i, s.worlds)
        s.work.lead[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        s.work.coasting[body] = s.work.increment[body]
        s.history.flying[body] = 0
        if s.work.inv_mass[body] == 0.0:
            return False
        s.work.coasting[body] = scale.h * body_qd[body]
        if will_fly(i, body, scale, body_qd, s):
            s.history.flying[body] = 1
            return False
        return True

    @wp.func
    def order_world(
        world: int,
        last: int,
        is_smooth: bool,
        is_continued: bool,
        scale: WorldScale,
        s: wp.ref[Solver],
    ) -> WorldScale:
        """The scale of a world's step, of second order where it continues a smooth motion."""
        out = scale
        out.age = s.history.slope_age[world]
        age = float(0.5)
        if is_smooth and is_continued:
            s.history.smooth[world] = wp.min(last + 1, LASTING)
            age = wp.where(last == LASTING, wp.static(a), wp.static(a_0))
            b_now = wp.where(last == LASTING, wp.static(b), wp.static(b_0))
            out = second_order(out, age, b_now)
        else:
            s.history.smooth[world] = wp.where(is_smooth, SMOOTH, JUMPED)
            if last < JUMPED:
                s.history.smooth[world] = last + 1
        s.worlds.step[world] = out.step
        s.history.slope_age[world] = age * out.h
        return out

    @wp.func
    def fly_body(
        body: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ):
        """Lead and target of a body that flies: the trapezoidal rule, which makes a parabola.

        Its velocity is that of backward Euler; its angular momentum is kept by the end.
        """
        turn = 0.5 * wp.spatial_bottom(s.work.target[body] + s.work.coasting[body])
        if wp.static(effects.gyroscopic):
            if not takes_midpoint(turn):
                turn = wp.spatial_bottom(s.work.target[body])
            elif wp.length_sq(turn) > SLOW * SLOW:
                half = 0.5 * scale.h
                rotation = wp.transform_get_rotation(s.work.pose[body])
                w, _momentum = mean_spin(
                    s.model, body, rotation, body_qd[body], s.work.wrench[body], half
                )
                turn = scale.h * w
        shift = 0.5 * wp.spatial_top(s.work.target[body] + s.work.coasting[body])
        target = wp.spatial_vector(shift, turn)
        if wp.static(effects.carried_rounding):
            if is_short(scale.h):
                pose, velocity = s.work.pose[body], body_qd[body]
                flight = flight_from(body, pose, velocity, s.history.flights)
                start = wp.transform_get_rotation(pose)
                s.work.gained[body] = flight.lost + gained_in_flight(
                    s.model,
                    body,
                    start,
                    velocity,
                    s.work.wrench[body],
                    exp_quat(wp.quat_rotate_inv(start, turn)),
                    scale.h,
                )
                s.history.flights[body] = flight
        s.work.lead[body] = target - (scale.step / scale.h) * s.work.target[body]
        s.work.target[body] = target
        s.work.increment[body] = target

    @wp.func
    def lead_body(
        body: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ):
        """Lead, target and first guess of a body."""
        step = scale.step
        velocity = body_qd[body]
        if s.work.inv_mass[body] == 0.0:
            # goes h v, and is felt to move at v
            s.work.lead[body] = (scale.h - step) * velocity
            if wp.static(effects.put_bodies):
                s.work.put[body] = (step / scale.h) * s.work.put[body]
            return
        last = s.history.last[body]
        ahead = lead(scale, velocity, last.slope)
        gained = lead(scale, last.acceleration, last.gain)
        v = velocity + gained
        # external forces are those of the whole step: all of their impulse, none of the last one's
        wrench = (scale.h / step) * external_wrench(body, s)
        push = s.model.inv_mass[body] * wp.spatial_top(wrench)
        dx = target_translation(wp.spatial_top(v), push, step)
        rotation = wp.transform_get_rotation(s.work.pose[body])
        turn = wp.spatial_bottom(ahead)
        dtheta = wp.vec3(0.0)
        end = rotation
        # what pushed it at the end of the last step goes on to
        pushed = last.acceleration
        if wp.static(effects.gyroscopic):
            # of the start, and all that the external torque gives
            momentum = s.work.momentum[body]
            if wp.static(effects.drag):
                momentum = spin_momentum(s.model, body, rotation, velocity)
                momentum += step * wp.spatial_bottom(wrench)
            began = momentum - step * wp.spatial_bottom(wrench)
            kick = step * wp.spatial_bottom(wrench) + lead(scale, last.torque, last.spun)
            momentum = began + kick
            # the inertia of the end of the step, where the body goes if all stays smooth
            spin = wp.spatial_bottom(velocity + scale.h * last.gain)
            swing = exp_quat(turn + step * spin)
            end = swing * rotation
            axes = wp.quat_to_matrix(end)
            back = wp.transpose(axes)
            s.work.inertia[body] = axes * s.model.inertia[body] * back
            spun = axes * (s.model.inv_inertia[body] * (back * last.torque))
            whole = momentum
            if wp.static(effects.carried_rounding):
                if is_short(scale.h):
                    # what turns along with the body keeps its momentum: nothing large cancels
                    whole = kick - turned_by(swing, began)
            w = axes * (s.model.inv_inertia[body] * (back * whole))
            if wp.static(effects.carried_rounding):
                if is_short(scale.h):
                    start = wp.spatial_bottom(velocity)
                    w += turned_by(swing, start)
                    gained = wp.spatial_vector(wp.spatial_top(gained), w)
                    w += start
            dtheta = step * w
            pushed = wp.spatial_vector(wp.spatial_top(pushed), spun)
            s.work.momentum[body] = momentum
        else:
            dtheta = target_turn(s.model, body, rotation, v, wrench, step)
            if wp.static(effects.carried_rounding):
                if is_short(scale.h):
                    none = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
                    spun = target_turn(s.model, body, rotation, none, wrench, step)
                    gained += wp.spatial_vector(wp.vec3(0.0), spun / step)
        s.work.target[body] = ahead + wp.spatial_vector(dx, dtheta)
        if wp.static(effects.drag):
            feel_drag(body, end, velocity, ahead, step, s)
        if wp.static(effects.carried_rounding):
            if is_short(scale.h):
                gained += last.lost + wp.spatial_vector(step * push, wp.vec3(0.0))
                s.work.gained[body] = gained
        target = s.work.target[body]
        coasting = ahead + step * v
        s.work.lead[body] = ahead
        s.work.coasting[body] = coasting
        if wp.static(effects.joints):
            # as the last steps have it, acceleration goes on to change
            change = (scale.h / scale.age) * (last.acceleration - last.gain)
            s.history.acceleration[body] = s.history.acceleration[body] + change
        pushed_shift = beyond_rounding((step * step) * wp.spatial_top(pushed), dx)
        pushed_turn = beyond_rounding((step * step) * wp.spatial_bottom(pushed), dtheta)
        s.work.increment[body] = target + wp.spatial_vector(pushed_shift, pushed_turn)

    @wp.func
    def start_body(
        body: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ):
        """Lead, target and first guess of a body, by the order of its world's step."""
        if is_flying(body, s.history):
            fly_body(body, scale, body_qd, s)
        elif scale.step < scale.h:
            lead_body(body, scale, body_qd, s)
        elif follows_second_order(scale):
            if wp.static(effects.joints):
                # that of the end of a step of second order says too little of the next
                s.history.acceleration[body] = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))

    @wp.func
    def lead_rows(world: int, body: int, scale: WorldScale, s: wp.ref[Solver]):
        """Penalties of the rows that a body owns, by the step; friction sees velocities; forces are
        those of the end of the step, and so are their levers."""
        stiffer = (scale.h * scale.h) / (scale.step * scale.step)
        turn = wp.spatial_bottom(s.work.coasting[body])
        has_turned = moves_levers(turn)
        half = exp_quat(0.5 * turn)
        whole = half * half
        side = written_side(world, s.history)
        for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
            row = s.rows.rows[i]
            s.rows.rows[i].k_n = stiffer * row.k_n
            s.rows.rows[i].k_t = stiffer * row.k_t
            if has_turned:
                record = s.history.records[side, i]
                s.rows.rows[i].arm += point_moves(row, record, whole, s)
                s.rows.rows[i].arm -= point_moves(row, record, half, s)
            if wp.static(effects.angular_friction):
                s.rows.spin[i].k_twist = stiffer * s.rows.spin[i].k_twist
                s.rows.spin[i].k_roll = stiffer * s.rows.spin[i].k_roll
            if wp.static(effects.put_bodies):
                # where a body is put only its move is known: what lies on it goes with that
                if wp.length_sq(s.work.put[row.b]) > 0.0:
                    continue
            if wp.static(effects.drift):
                span = s.work.com[row.a] - s.work.com[row.b]
                slid = contact_rows.slip(row, s.work.lead[row.a], s.work.lead[row.b], span)
                slid -= wp.dot(row.normal, slid) * row.normal
                s.rows.drift[i] = (scale.step / scale.h) * s.rows.drift[i] - slid

    @wp.func
    def begin_step(
        world: int,
        has_bounce: bool,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        s: wp.ref[Solver],
    ) -> WorldScale:
        """Decides on the order of a world's step, and makes targets and rows those of it."""
        is_held = bool(False)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            if begin_body(i, scale, body_qd, s):
                is_held = True
        last = last_of(world, s.history)
        may_last = is_held and last != QUIET_WORLD and not has_bounce
        may_last = may_last and is_smooth(world, scale, s)
        lasts = may_last and is_going_on(last)
        if lasts:
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                body = body_at(i, s.worlds)
                if lasts and not goes_on(body, body_qd, scale, s):
                    lasts = False
        out = order_world(world, last, may_last, lasts, scale, s)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            start_body(body_at(i, s.worlds), out, body_qd, s)
        if wp.static(effects.contact):
            if out.step < out.h:
                for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                    lead_rows(world, body_at(i, s.worlds), out, s)
        return out

    @wp.func
    def slips_otherwise(body: int, s: wp.ref[Solver]) -> bool:
        """Whether friction of a body's joint pushes otherwise than in the last step, or holds, or a
        stop of it holds or lets go."""
        result = bool(False)
        if wp.static(effects.joints and (effects.joint_friction or effects.hard_limits)):
            if is_linked(body, s):
                joint = s.tree.joint[body]
                for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                    slip = s.history.piece[dof][2] + 2
                    if wp.abs(s.history.piece[dof][0]) == 1:
                        slip += HELD_BY_STOP
                    last = s.history.coordinate[dof].slip
                    if slip != last:
                        s.history.coordinate[dof].slip = slip
                        # in the first step friction or a stop may have stopped what moved
                        has_stopped = slip > HELD_BY_STOP
                        if wp.static(effects.joint_friction):
                            has_stopped = has_stopped or (
                                slip == 2 and s.joints.friction[dof] > 0.0
                            )
                        if last == 0 and has_stopped:
                            began = s.history.last[body].velocity
                            began -= s.history.last[s.tree.parent[body]].velocity
                            linear = linear_count(s.joints, joint)
                            if wp.length_sq(wp.spatial_bottom(began)) > 0.0 or linear > 0:
                                result = True
                        result = result or last != 0
        return result

    @wp.func
    def remember_motion(body: int, scale: WorldScale, s: wp.ref[Solver]):
        """How a body has moved in the step, before anything old is recovered, and what pushes."""
        if wp.static(effects.contact):
            pushing = int(0)
            for i in range(s.rows.owned_start[body], s.rows.owned_end[body]):
                pushing += int(is_pushing(s.rows.rows[i]))
            s.history.pushing[body] = pushing
        if is_flying(body, s.history):
            return
        if wp.static(effects.joints and effects.coordinates):
            if is_linked(body, s):
                joint = s.tree.joint[body]
                k = s.tree.axis_start[body]
                for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
                    end_axis(
                        dof,
                        s.tree.start_coordinate[k],
                        s.tree.coordinate[k],
                        scale,
                        s.history.coordinate,
                    )
                    k += 1
        slope = s.history.last[body].slope
        s.history.last[body].slope = next_slope(scale, s.work.increment[body], slope)

    @wp.func
    def remember_loop(i: int, scale: WorldScale, s: wp.ref[Solver]):
        """Likewise the coordinates of a joint outside of the trees."""
        joint = s.loops.joints[i]
        for dof in range(s.joints.dof_start[joint], s.joints.dof_start[joint + 1]):
            end_axis(
                dof,
                s.loops.start_coordinate[dof],
                s.loops.coordinate[dof],
                scale,
                s.history.coordinate,
            )

    @wp.func
    def remember_state(
        world: int,
        body: int,
        pose: wp.transform,
        velocity: wp.spatial_vector,
        scale: WorldScale,
        s: wp.ref[Solver],
    ):
        """Where a step has left a body, how fast, and what its constraints did to that."""
        before = wp.transform_get_rotation(s.work.pose[body])
        last = s.history.last[body]
        began = last.velocity
        wrench = external_wrench(body, s)
        given = wp.spatial_vector(s.model.inv_mass[body] * wp.spatial_top(wrench), wp.vec3(0.0))
        if wp.static(effects.gyroscopic):
            after = wp.transform_get_rotation(pose)
            is_new = bool(True)
            change = -spin_momentum(s.model, body, before, began)
            if wp.static(effects.carried_rounding):
                if is_carried(scale):
                    # of momenta, which are large, the difference would round
                    is_new = False
                    swing = exp_quat(wp.spatial_bottom(s.work.increment[body]))
                    gained = wp.spatial_bottom((velocity - began) + s.work.gained[body])
                    gained -= turned_by(swing, wp.spatial_bottom(began))
                    change = turned_inertia(after, s.model.inertia[body], gained) - turned_by(
                        swing, change
                    )
            if is_new:
                change += spin_momentum(s.model, body, after, velocity)
            change -= scale.h * wp.spatial_bottom(wrench)
            last.torque = (change - lead(scale, last.torque, last.spun)) / scale.step
            last.spun = next_slope(scale, change, last.spun)
        else:
            spin = turned_inertia(before, s.model.inv_inertia[body], wp.spatial_bottom(wrench))
            given = wp.spatial_vector(wp.spatial_top(given), spin)
        change_v = velocity - began
        if wp.static(effects.carried_rounding):
            if is_carried(scale):
                change_v += s.work.gained[body]
        change_v -= scale.h * given
        pushed = (change_v - lead(scale, last.acceleration, last.gain)) / scale.step
        # a step after one of second order may be as little resolved as that one
        if scale.step < scale.h or follows_second_order(scale):
            if not is_resolved(body, velocity, pushed - last.acceleration, scale, s):
                s.history.smooth[world] = wp.static(UNRESOLVED if may_be_taut else JUMPED)
        last.acceleration = pushed
        last.gain = next_slope(scale, change_v, last.gain)
        if wp.static(not effects.cables):
            # a chord would carry on, half as much again, what backward Euler misses of a fall;
            # tensions of cables swing less after it
            if scale.step == scale.h:
                last.slope = 0.5 * (began + velocity)
        last.velocity = velocity
        last.wrench = wrench
        last.pose = pose
        s.history.last[body] = last

    @wp.func
    def remember_motions(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]):
        """How the bodies of a world have moved, if that is of use to the next step."""
        quiet = bool(True)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if slips_otherwise(body, s):
                s.history.smooth[world] = JUMPED
            velocity = step.body_qd_out[body]
            may_stand = wp.static(effects.contact)
            if quiet and not is_quiet(body, velocity, may_stand, scale, s):
                quiet = False
        if quiet:
            s.history.smooth[world] = QUIET_WORLD
        if is_remembered(world, scale, s.history):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                body = body_at(i, s.worlds)
                if s.work.inv_mass[body] > 0.0:
                    remember_motion(body, scale, s)

    @wp.func
    def remember_states(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]):
        """Likewise where the step has left them."""
        if is_remembered(world, scale, s.history):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                body = body_at(i, s.worlds)
                if s.work.inv_mass[body] == 0.0:
                    remember_led(body, step.body_qd_out[body], scale, s.history)
                elif not is_flying(body, s.history):
                    remember_state(
                        world, body, step.body_q_out[body], step.body_qd_out[body], scale, s
                    )

    return SecondOrderFunctions(
        begin_step,
        begin_body,
        body_jumps,
        loop_jumps,
        goes_on,
        order_world,
        start_body,
        lead_rows,
        slips_otherwise,
        remember_motion,
        remember_motions,
        remember_loop,
        remember_state,
        remember_states,
    )
