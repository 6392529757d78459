# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a body adds to the energy balance of its island, its contacts and joints included."""

import warp as wp

from ..algebra.so3 import world_inertia
from ..data import Balance, BodyModel, Solver, Step
from ..effects import Effects
from ..rows import contact as contact_rows
from .anchors import is_linked
from .balance import counts_here, place_from, squared_overlap, touch_surface, with_work
from .contacts import make_surface_shift
from .drag import resistance
from .impacts import lag_of_impact
from .joint_energy import make_add_joint
from .rotations import MOST_TURN


@wp.func
def kinetic_energy(
    body: int, pose: wp.transform, velocity: wp.spatial_vector, model: wp.ref[BodyModel]
) -> float:
    """(m v^2 + w I w)/2 of a body [J]."""
    v = wp.spatial_top(velocity)
    w = wp.spatial_bottom(velocity)
    inertia = world_inertia(wp.transform_get_rotation(pose), model.inertia[body])
    return 0.5 * (model.mass[body] * wp.dot(v, v) + wp.dot(w, inertia * w))


def make_add_body(effects: Effects) -> wp.Function:
    """Device function: adds a body to the balance of its island."""
    add_joint = make_add_joint(effects)
    surface_shift = make_surface_shift(effects)

    @wp.func
    def add_row(
        i: int, body: int, h: float, sum: Balance, step: wp.ref[Step], s: wp.ref[Solver]
    ) -> Balance:
        """Adds what a contact that a body owns has stored, and the work that its surface does."""
        out = sum
        row = s.rows.rows[i]
        span = s.work.com[body] - s.work.com[row.b]
        moved = s.work.increment[row.b]
        if wp.length_sq(row.force) > 0.0:
            shift = wp.vec3(0.0)
            if wp.static(effects.moving_surfaces or effects.put_bodies):
                share = float(1.0)
                if wp.static(effects.second_order):
                    share = s.worlds.step[s.model.world[body]] / h
                shift = surface_shift(row, row.arm + span, h, share, step, s)
            if s.work.inv_mass[row.b] == 0.0:
                way = contact_rows.slip(row, wp.spatial_vector(), moved, span) + shift
                out = touch_surface(-row.force, way, out)
                if wp.static(effects.angular_friction):
                    out.pushed -= wp.dot(s.rows.spin[i].torque, wp.spatial_bottom(moved))
            elif wp.static(effects.moving_surfaces):
                if wp.length_sq(shift) > 0.0:
                    out.is_pushed = True
        if wp.static(effects.compliance):
            u = contact_rows.slip(row, s.work.increment[body], moved, span)
            stiffness = row.k_n / wp.max(1.0 - s.rows.share[i], 1.0e-6)
            less = squared_overlap(row.gap)
            less -= squared_overlap(row.gap + wp.dot(row.normal, u))
            out = with_work(out, 0.5 * stiffness * less)
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
        turned = wp.length_sq(wp.spatial_bottom(increment))
        out.is_turned = out.is_turned or turned > MOST_TURN * MOST_TURN
        out.before += wp.dot(force, wp.spatial_top(increment))
        out.before += wp.dot(torque, wp.spatial_bottom(increment))
        if wp.static(effects.restitution):
            # velocities of backward Euler are behind those of the fall that an impact ends
            late = h * lag_of_impact(body, s.rows)
            ends = velocity
            if wp.static(not effects.second_order):
                ends -= step.body_qd_out[body]
            out.before += wp.max(late * wp.dot(force, wp.spatial_top(ends)), 0.0)
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
                out = add_row(i, body, h, out, step, s)
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
                if counts_here(s.loops.items[k], joint, s):
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

    return add_body
