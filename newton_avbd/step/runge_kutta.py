# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Fourth order in time where nothing but joints holds bodies, on coordinates of these.

What moves freely along the axes of its joints is an ordinary differential equation of their
coordinates q and rates r = q', and of the poses and velocities of roots that float. The classical
Runge-Kutta method takes four accelerations a step (W. Kutta, 1901; E. Hairer, S. Norsett,
G. Wanner, "Solving Ordinary Differential Equations I", section II.1):

    k_1 = f(y),  k_2 = f(y + h/2 k_1),  k_3 = f(y + h/2 k_2),  k_4 = f(y + h k_3),
    y' = y + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4).

Rotations of roots and of ball joints go by the rotation vector u of the step, u' = dexp^-1_u(w)
(H. Munthe-Kaas, 1998). A step is given up, and made as others are, where a contact, a stop or
friction that holds is met within it, or a spring, damper or drive is too stiff for it.
"""

import warp as wp

from ..algebra.so3 import exp_quat
from ..data import Solver, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from .anchors import is_linked, make_anchors_of
from .block_start import make_begin_armature
from .bodies import nonnegative
from .joint_start import make_joint_start
from .smoothness import energy_of
from .stage_axes import ball_rotation, ball_turn, make_stage_axes
from .stage_motion import make_place_linked

WAITING = wp.constant(32)
"""Steps of second order after one that was too long for one of fourth order. Each change of order
costs a step of first order."""
RESOLVED = wp.constant(0.05)
"""How much the velocities that the two stages in the middle of a step give in one may differ, as a
share of the velocity of a body: (h w)^3 / 4 of an oscillation, of which a step then turns 0.6
rad."""
SHARED = wp.constant(0.01)
"""The same as a share of the velocities of all bodies of its tree, which tell what a body that
hardly moves may do."""


@wp.func
def inverse_dexp(u: wp.vec3, spin: wp.vec3) -> wp.vec3:
    """Rate of the rotation vector u of what turns at a spin, to third order: dexp^-1_u(w)."""
    across = wp.cross(u, spin)
    return spin - 0.5 * across + wp.static(1.0 / 12.0) * wp.cross(u, across)


@wp.func
def rate_of_root(body: int, s: wp.ref[Solver]) -> wp.spatial_vector:
    """How fast a root moves: its COM, and the rotation vector of its turn in the step."""
    velocity = s.tree.runge_kutta.velocity[body]
    u = wp.spatial_bottom(s.work.increment[body])
    return wp.spatial_vector(wp.spatial_top(velocity), inverse_dexp(u, wp.spatial_bottom(velocity)))


def make_start(effects: Effects) -> Functions:
    """Device functions: where a body starts, and where another kind of step goes on from."""
    axes = make_stage_axes(effects)
    is_ball, axis_count = axes.is_ball, axes.axis_count
    anchors_of = make_anchors_of(effects.flipped)
    start = make_joint_start(effects)
    measure_misfit, read_start = start.measure_misfit, start.read_start
    begin_armature = make_begin_armature(effects, start.measure_velocity)

    @wp.func
    def begin_body(body: int, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]) -> bool:
        """Starts a body of a step; returns whether it is as the last such step left it."""
        velocity = body_qd[body]
        pose = s.work.pose[body]
        s.tree.is_left[body] = pose == s.history.left_q[body]
        if not s.tree.is_left[body]:
            s.history.lost[body] = wp.vec3(0.0)
        s.tree.runge_kutta.guess[body] = s.work.increment[body]
        s.work.increment[body] = wp.spatial_vector()
        if s.work.inv_mass[body] == 0.0:
            velocity = wp.spatial_vector()
            s.tree.update[body] = velocity
            s.tree.rotation[body] = wp.transform_get_rotation(pose)
        is_known = pose == s.tree.runge_kutta.left_q[body]
        is_known = is_known and velocity == s.tree.runge_kutta.left_qd[body]
        s.tree.runge_kutta.velocity[body] = velocity
        s.tree.runge_kutta.start_velocity[body] = velocity
        s.tree.runge_kutta.moved[body] = wp.spatial_vector()
        s.tree.runge_kutta.gain[body] = wp.spatial_vector()
        return is_known

    @wp.func
    def measure_body(
        body: int, scale: WorldScale, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]
    ) -> bool:
        """Coordinates of the body's joint by its pose, with rates of zero for now.

        Expects orientations at the start in ``tree.rotation``. Returns whether the joint is open.
        """
        joint = nonnegative(s.tree.joint[body])
        first = nonnegative(s.tree.axis_start[body])
        index = s.joints.dof_start[joint]
        anchors = anchors_of(body, s)
        is_open = measure_misfit(body, anchors, scale.static_slot, s)
        read_start(body, anchors, scale.static_slot, s)
        if wp.static(effects.axis_rates):
            begin_armature(joint, scale, body_qd, s)
        for dof in range(axis_count(body, s)):
            s.tree.coordinate[first + dof] = s.history.joint_angle[index + dof]
            s.tree.start_coordinate[first + dof] = s.history.joint_angle[index + dof]
            s.tree.runge_kutta.rate[first + dof] = wp.float64(0.0)
        if is_ball(joint, s):
            start = wp.quat_inverse(anchors.q_p) * anchors.q_c
            s.tree.runge_kutta.ball_start[body] = start
        return is_open

    @wp.func
    def start_from(body: int, s: wp.ref[Solver]):
        """Takes what :mod:`.step.stage_forces` found of momenta as the motion at the start."""
        velocity = s.tree.update[body]
        s.tree.runge_kutta.velocity[body] = velocity
        s.tree.runge_kutta.start_velocity[body] = velocity
        if is_linked(body, s):
            first = nonnegative(s.tree.axis_start[body])
            for k in range(first, first + axis_count(body, s)):
                s.tree.runge_kutta.rate[k] = wp.float64(s.tree.runge_kutta.gained[k])

    @wp.func
    def begin_axes(body: int, s: wp.ref[Solver]):
        """Starts the sums of a body's axes from where its coordinates are."""
        joint = nonnegative(s.tree.joint[body])
        first = nonnegative(s.tree.axis_start[body])
        if is_ball(joint, s):
            start = wp.normalize(ball_rotation(body, first, s))
            s.tree.runge_kutta.ball_start[body] = start
            for dof in range(3):
                s.tree.coordinate[first + dof] = wp.float64(0.0)
        for k in range(first, first + axis_count(body, s)):
            s.tree.start_coordinate[k] = s.tree.coordinate[k]
            s.tree.runge_kutta.start_rate[k] = s.tree.runge_kutta.rate[k]
            s.tree.runge_kutta.axis_moved[k] = wp.float64(0.0)
            s.tree.runge_kutta.axis_gain[k] = wp.float64(0.0)

    @wp.func
    def give_up(body: int, s: wp.ref[Solver]):
        """Leaves the body to a step of another kind."""
        s.work.increment[body] = s.tree.runge_kutta.guess[body]
        if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
            first = nonnegative(s.tree.axis_start[body])
            for k in range(first, first + axis_count(body, s)):
                s.tree.coordinate[k] = s.tree.start_coordinate[k]

    return together(begin_body, measure_body, start_from, begin_axes, give_up)


def make_runge_kutta(effects: Effects) -> Functions:
    """Device functions of a body in a step of fourth order."""
    axes = make_stage_axes(effects)
    is_ball, axis_count = axes.is_ball, axes.axis_count
    place_linked = make_place_linked(effects)

    @wp.func
    def place_body(body: int, static_slot: int, s: wp.ref[Solver]):
        """Places a body that moves by its coordinates; parents go first."""
        if is_linked(body, s):
            place_linked(body, static_slot, s)
        else:
            turn = exp_quat(wp.spatial_bottom(s.work.increment[body]))
            rotation = turn * wp.transform_get_rotation(s.work.pose[body])
            s.tree.rotation[body] = wp.normalize(rotation)

    @wp.func
    def advance_axes(body: int, weight: float, ahead: float, s: wp.ref[Solver]):
        """As :func:`advance_body`, the coordinates of the body's joint."""
        joint = nonnegative(s.tree.joint[body])
        first = nonnegative(s.tree.axis_start[body])
        turning = wp.vec3(0.0)
        has_ball = is_ball(joint, s)
        if has_ball:
            spin = wp.vec3()
            for dof in range(3):
                spin[dof] = wp.float32(s.tree.runge_kutta.rate[first + dof])
            turning = inverse_dexp(ball_turn(first, s), spin)
        for dof in range(axis_count(body, s)):
            k = first + dof
            rate = s.tree.runge_kutta.rate[k]
            if has_ball:
                rate = wp.float64(turning[dof])
            gained = wp.float64(s.tree.runge_kutta.gained[k])
            moved = s.tree.runge_kutta.axis_moved[k] + wp.float64(weight) * rate
            gain = s.tree.runge_kutta.axis_gain[k] + wp.float64(weight) * gained
            s.tree.runge_kutta.axis_moved[k] = moved
            s.tree.runge_kutta.axis_gain[k] = gain
            if ahead > 0.0:
                moved = wp.float64(ahead) * rate
                gain = wp.float64(ahead) * gained
            s.tree.coordinate[k] = s.tree.start_coordinate[k] + moved
            s.tree.runge_kutta.rate[k] = s.tree.runge_kutta.start_rate[k] + gain

    @wp.func
    def advance_body(body: int, weight: float, ahead: float, s: wp.ref[Solver]):
        """Adds the rates of a stage by their weight [s]; leads on to the next stage.

        That is ``ahead`` of the start [s]; after the last one, of 0, the end of the step.
        """
        if is_linked(body, s):
            advance_axes(body, weight, ahead, s)
            return
        rate = rate_of_root(body, s)
        gained = s.tree.update[body]
        moved = s.tree.runge_kutta.moved[body] + weight * rate
        gain = s.tree.runge_kutta.gain[body] + weight * gained
        s.tree.runge_kutta.moved[body] = moved
        s.tree.runge_kutta.gain[body] = gain
        if ahead > 0.0:
            moved = ahead * rate
            gain = ahead * gained
        s.work.increment[body] = moved
        s.tree.runge_kutta.velocity[body] = s.tree.runge_kutta.start_velocity[body] + gain

    @wp.func
    def differs_by(body: int, drift: wp.vec3, h: float, s: wp.ref[Solver]):
        """Twice the energies of how two stages at the middle of the step differ, of what the body
        gains in it, and of its motion at the start against the ``drift`` of its tree [J].

        The first two are of the velocities that accelerations give in a step.
        """
        mass = s.model.mass[body]
        inertia = s.work.inertia[body]
        gained = h * s.tree.runge_kutta.before[body]
        change = h * s.tree.update[body] - gained
        motion = s.tree.runge_kutta.start_velocity[body]
        motion -= wp.spatial_vector(drift, wp.vec3(0.0))
        moved = energy_of(mass, inertia, motion)
        return energy_of(mass, inertia, change), energy_of(mass, inertia, gained), moved

    return together(place_body, advance_body, differs_by, make_start(effects))
