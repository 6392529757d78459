# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A step of fourth order of a world, where nothing but joints holds its bodies."""

import warp as wp

from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..step.anchors import is_linked
from ..step.bodies import body_at, vector_sum
from ..step.finite import is_solution_finite
from ..step.islands import begin_island
from ..step.runge_kutta import WAITING, make_runge_kutta
from ..step.scale import COLD_STEPS
from ..step.sides import make_written_side
from ..step.slopes import JUMPED
from ..step.stage_end import make_stage_end
from ..step.stage_forces import make_stage_forces
from .world_stages import make_world_stages

_UNSUPPORTED: dict[str, str] = {
    "loops": "joints outside of trees",
    "closures": "joints that close loops, or mimics",
    "tendons": "tendons of MuJoCo's",
    "cables": "cables",
    "rods": "ROD joints",
    "distances": "DISTANCE joints",
    "drag": "a fluid, or servos against the world",
    "adhesion": "adhesion",
    "breaking": "joints that may break",
    "reaction": "joint_f of FREE joints that reacts on a parent",
    "light_roots": "bodies that are light beside what their joints carry",
    "sleeping": "sleeping=True",
}
"""Effects without which steps of fourth order do, and what to call them."""


def obstacles(effects: Effects) -> list[str]:
    """What of a scene has all of its steps of second order; empty where nothing has."""
    return effects.among(_UNSUPPORTED)


def make_world_smooth(effects: Effects, end_poses: wp.Function) -> wp.Function:
    """Device function: the step of a world by a Runge-Kutta method, where that can be.

    Args:
        effects: What the kernel is compiled with.
        end_poses: Device function that leaves the poses of a world by its increments.
    """
    rk = make_runge_kutta(effects)
    begin_body, measure_body = rk.begin_body, rk.measure_body
    start_from, begin_axes, give_up = rk.start_from, rk.begin_axes, rk.give_up
    ending = make_stage_end(effects)
    allows_axes, allows_rows, end_body = ending.allows_axes, ending.allows_rows, ending.end_body
    leave_body, leave_joint = ending.leave_body, ending.leave_joint
    forces = make_stage_forces(effects)
    eliminate_stage = forces.eliminate_stage
    stages = make_world_stages(effects, rk, forces, ending)
    place_world, substitute_world = stages.place_world, stages.substitute_world
    take_stages = stages.take_stages
    written_side = make_written_side(effects)

    @wp.func
    def is_led(world: int, body_qd: wp.array[wp.spatial_vector], s: wp.ref[Solver]) -> bool:
        """Whether the user moves a body of a world, by its velocity or by its pose."""
        led = bool(False)
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] == 0.0:
                is_left = s.work.pose[body] == s.tree.runge_kutta.left_q[body]
                if not is_left or wp.length_sq(body_qd[body]) > 0.0:
                    led = True
                s.tree.runge_kutta.left_q[body] = s.work.pose[body]
        return led

    @wp.func
    def is_touched(world: int, s: wp.ref[Solver]) -> bool:
        """Whether a contact of a world is closed at the start."""
        if wp.static(effects.contact):
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                body = body_at(i, s.worlds)
                for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
                    if s.rows.rows[k].gap <= 0.0:
                        return True
        return False

    @wp.func
    def measure_world(
        world: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> bool:
        """Coordinates and rates by poses and velocities.

        Velocities that joints do not allow, as steps of lower order leave them, give way. Returns
        whether joints are closed, and within their limits.
        """
        first = s.worlds.body_start[world]
        end = s.worlds.body_start[world + 1]
        for i in range(first, end):
            body = body_at(i, s.worlds)
            s.tree.rotation[body] = wp.transform_get_rotation(s.work.pose[body])
            s.tree.swing[body] = wp.quat_identity()
            s.tree.turn[body] = wp.vec3(0.0)
            s.tree.runge_kutta.velocity[body] = wp.spatial_vector()
        is_open = bool(False)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                if measure_body(body, scale, body_qd, s):
                    is_open = True
        if is_open:
            return False
        place_world(world, scale.static_slot, s)
        if not eliminate_stage(world, True, scale.static_slot, scale.h, step, s):
            return False
        substitute_world(world, s)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                start_from(body, s)
        return True

    @wp.func
    def begin_smooth(
        world: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> bool:
        """Where coordinates and rates are: as the last step left them, or measured.

        Returns whether joints are closed, and nothing holds their axes, nor would if they went on.
        """
        first = s.worlds.body_start[world]
        end = s.worlds.body_start[world + 1]
        is_known = s.tree.runge_kutta.is_known[world] != 0 and s.history.age[world] > 0
        for i in range(first, end):
            if not begin_body(body_at(i, s.worlds), body_qd, s):
                is_known = False
        if not is_known:
            if not measure_world(world, scale, body_qd, step, s):
                return False
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                begin_axes(body, s)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                if not allows_axes(body, 0.0, s) or not allows_axes(body, scale.h, s):
                    return False
        return True

    @wp.func
    def is_allowed(world: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Increments of the bodies; returns whether the step has met nothing that holds them."""
        first = s.worlds.body_start[world]
        end = s.worlds.body_start[world + 1]
        for i in range(first, end):
            body = body_at(i, s.worlds)
            end_body(body, scale.static_slot, s)
            if not wp.isfinite(vector_sum(s.tree.runge_kutta.velocity[body])):
                return False
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                if not allows_axes(body, 0.0, s):
                    return False
        if wp.static(effects.contact):
            for i in range(first, end):
                if not allows_rows(body_at(i, s.worlds), s):
                    return False
        return is_solution_finite(world, s)

    @wp.func(inline=effects.inline)
    def leave_world(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]):
        """Velocities and poses, and what the next step is to know."""
        first = s.worlds.body_start[world]
        end = s.worlds.body_start[world + 1]
        for i in range(first, end):
            body = body_at(i, s.worlds)
            step.body_qd_out[body] = s.tree.runge_kutta.velocity[body]
            leave_body(body, scale.h, s)
        s.worlds.sweeps[world] = 4
        s.worlds.update[world] = 0.0
        s.worlds.settled[world] = 0.0
        s.worlds.step[world] = scale.h
        s.history.slope_age[world] = 0.5 * scale.h
        # whatever ends the smooth motion jumps
        s.history.smooth[world] = JUMPED
        side = written_side(world, s.history)
        if wp.static(effects.contact):
            for i in range(first, end):
                body = body_at(i, s.worlds)
                s.history.start[side, body] = s.rows.owned_start[body]
                s.history.end[side, body] = s.rows.owned_start[body]
                for k in range(s.rows.owned_start[body], s.rows.owned_end[body]):
                    s.rows.rows[k].force = wp.vec3(0.0)
                    if wp.static(effects.angular_friction):
                        s.rows.spin[k].torque = wp.vec3(0.0)
                if wp.static(effects.pairs):
                    begin_island(s.islands, body)
                    s.islands.sum[body].bodies = 1
        s.history.parity[world] = side
        s.history.age[world] = wp.min(s.history.age[world] + 1, COLD_STEPS)
        end_poses(world, False, False, scale, step, s)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            s.tree.runge_kutta.left_q[body] = step.body_q_out[body]
            s.tree.runge_kutta.left_qd[body] = step.body_qd_out[body]
            if s.work.inv_mass[body] > 0.0 and s.tree.joint[body] >= 0:
                leave_joint(body, step.body_qd_out, s)

    @wp.func
    def step_smoothly(
        world: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> bool:
        """Makes the step of a world; returns false, and leaves it to others, where it cannot."""
        waits = s.tree.runge_kutta.waits[world]
        if waits > 0 and s.history.age[world] == 0:
            waits = 0
        s.tree.runge_kutta.waits[world] = wp.max(waits - 1, 0)
        has_led = is_led(world, body_qd, s)
        if waits != 0 or has_led or is_touched(world, s):
            s.tree.runge_kutta.is_known[world] = 0
            return False
        is_taken = begin_smooth(world, scale, body_qd, step, s)
        if is_taken:
            is_taken = take_stages(world, scale, step, s)
            if is_taken:
                is_taken = is_allowed(world, scale, s)
            else:
                s.tree.runge_kutta.waits[world] = WAITING
        s.tree.runge_kutta.is_known[world] = int(is_taken)
        if is_taken:
            leave_world(world, scale, step, s)
        else:
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                give_up(body_at(i, s.worlds), s)
        return is_taken

    return step_smoothly
