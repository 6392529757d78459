# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Which motions are smooth, so that a step of second order may go on from them.

Before a step: whether a velocity is about to jump, and whether the state and what pushes are those
that the last step left. After it: whether it changed nothing, or was too long for the motion.
"""

import warp as wp

from ..data import BodyModel, History, Solver, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..rows import contact as contact_rows
from ..rows.contact import is_pushing
from ..rows.euler import make_euler
from ..rows.joint import BALL, DISTANCE, make_counts
from .anchors import is_linked
from .bodies import body_at, moved_by
from .cables import may_jerk
from .flight import is_flying
from .islands import rigid_spin
from .needles import tilts_too_far
from .slopes import JUMPED, is_going_on
from .tendons import meets_range, turns_back

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
"""What positions far from the origin, which are rounded by a tenth of it, add to that. By the same
share of the position, and by as many radians, a pose may be off that says nothing of how fast what
holds the body changes."""
FARTHEST = wp.constant(10.0)
"""Distance [m] from which the latter grows no more: at 10 km it would be as fast as things move."""
RESOLVED = wp.constant(0.3)
"""Share of its velocity, or of that of a free fall, that a body may gain in a step by how much its
acceleration has changed since the last one: w^2 h^2 of an oscillation. With 0.5 taut grids stay
quiet, too; without it they gain energy without end."""
INPUTS = wp.constant(4.0)
"""How much more than what the forces of a controller change by the acceleration may: twice."""
MOST_TURN = wp.constant(0.2)
"""Turn of a body in a step [rad] beyond which extrapolation says nothing: with 0.25 a top gains
energy, with 1 a light body on a stiff two-way tendon spins up without end."""


@wp.func
def last_of(world: int, history: wp.ref[History]) -> int:
    """How the last step of a world was; the first one follows a jump."""
    return wp.where(history.age[world] > 0, history.smooth[world], JUMPED)


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
        if moved_by(body, s.work.increment[body], s.work) <= stir * stir:
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
    beyond what changes of a controller's forces give, and beyond what the rounding of its pose
    gives. For a tree with drives along all axes that nothing else holds steps are always short
    enough: what changes fast there are the drives.
    """
    mass, inertia = s.model.mass[body], s.work.inertia[body]
    fall = RESOLVED * scale.gravity * scale.h
    allowed = RESOLVED * RESOLVED * energy_of(mass, inertia, velocity) + mass * fall * fall
    rounded = FAR_STIR / scale.h
    far = mass * wp.min(wp.length_sq(s.work.com[body]), FARTHEST * FARTHEST) + wp.trace(inertia)
    allowed += rounded * rounded * far
    return (
        energy_of(mass, inertia, scale.h * change) <= allowed + INPUTS * s.work.input_energy[body]
    )


@wp.func
def inertia_of(body: int, model: wp.ref[BodyModel]) -> wp.vec2:
    """Mass of a body [kg], and a sum of its moments [kg m^2] that changes as any of these does."""
    inertia = model.inertia[body]
    return wp.vec2(model.mass[body], inertia[0, 0] + 2.0 * inertia[1, 1] + 3.0 * inertia[2, 2])


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
    if not (inertia_of(body, s.model) == s.history.last[body].inertia):
        return False
    spin = wp.spatial_bottom(s.history.last[body].slope)
    if scale.h * scale.h * wp.length_sq(spin) > MOST_TURN * MOST_TURN:
        return False
    wrench = external_wrench(body, s)
    torque = wp.spatial_bottom(wrench)
    if wp.length_sq(torque) > 0.0:
        # against a torque that a massless link alone would give way to, joints push as much
        turn = (scale.h * scale.h) * rigid_spin(s.work.inertia[body], torque)
        if wp.length_sq(turn) > MOST_TURN * MOST_TURN:
            return False
    if not (wrench == s.history.last[body].wrench):
        return not jumps(body, wrench, body_qd[body], scale, s)
    return True


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


def make_smoothness(effects: Effects) -> Functions:
    """Device functions that look at bodies, at joints, and at a world before its step."""
    is_gimbal = make_counts(effects.kinds).is_gimbal
    euler = make_euler(effects.kinds)
    is_led, known_angles = euler.is_led, euler.known_angles

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
        if wp.static(effects.spatial_tendons):
            if turns_back(i, s.tree):
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
        if wp.static(effects.needles):
            turn = scale.h * wp.spatial_bottom(s.history.last[body].slope)
            if tilts_too_far(body, turn, s):
                return False
        return is_continued(body, body_qd, scale, s)

    return together(body_jumps, loop_jumps, is_smooth, goes_on)
