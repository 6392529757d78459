# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Where a tendon runs, how long it is, and how its length changes with the bodies."""

import warp as wp

from ..algebra.so3 import turned_from
from ..data import BodyModel, Solver
from ..effects import Effects
from ..functions import Functions, together
from ..rows.joint import make_counts
from ..rows.path import CYLINDER, JOINT, PULLEY, SPHERE, double, find_path
from .anchors import anchor_arm, anchor_rotation, is_linked, is_put, joint_shift


@wp.func
def mobility_of(body: int, way: wp.spatial_vector, h: float, model: wp.ref[BodyModel]) -> float:
    """How far a wrench moves its own row at most by a body that nothing else holds [m/N]."""
    turned = wp.trace(model.inv_inertia[body]) * wp.length_sq(wp.spatial_bottom(way))
    return h * h * (model.inv_mass[body] * wp.length_sq(wp.spatial_top(way)) + turned)


@wp.func
def center_of(k: int, s: wp.ref[Solver]) -> wp.vec3:
    """COM of the body of an element, from the origin of its tendon [m]."""
    return s.tree.tendons.apart[k] + joint_shift(s.work, s.tree.tendons.body[k])


@wp.func
def begin_points(i: int, s: wp.ref[Solver]):
    """Where a tendon starts, from the first of its bodies: far from the origin of the world
    positions are coarse, and their differences exact. A kinematic body counts as not yet moved.
    """
    tendons = s.tree.tendons
    static_slot = s.work.inv_mass.shape[0] - 1
    first = int(-1)
    for k in range(tendons.start[i], tendons.start[i + 1]):
        if first < 0 and tendons.body[k] != static_slot and tendons.body[k] >= 0:
            first = tendons.body[k]
    origin = wp.transform_get_translation(s.work.pose[first])
    shift = wp.quat_rotate(wp.transform_get_rotation(s.work.pose[first]), s.model.com[first])
    shift += s.history.lost[first]
    for k in range(tendons.start[i], tendons.start[i + 1]):
        body = tendons.body[k]
        if body == static_slot:
            place = wp.transform_get_translation(tendons.frame[k])
            tendons.apart[k] = (place - origin) - shift
            tendons.begun[k] = tendons.apart[k]
        elif body >= 0:
            pose = s.work.pose[body]
            away = wp.transform_get_translation(pose) - origin
            center = wp.quat_rotate(wp.transform_get_rotation(pose), s.model.com[body])
            tendons.apart[k] = away + (center + s.history.lost[body] - shift)
            arm = anchor_arm(body, tendons.frame[k], static_slot, s)
            tendons.begun[k] = tendons.apart[k] + arm
            if is_put(body, s.work):
                ahead = s.tree.update[body]
                turned = wp.cross(wp.spatial_bottom(ahead), arm)
                tendons.begun[k] = tendons.begun[k] - wp.spatial_top(ahead) - turned


def make_length(effects: Effects) -> Functions:
    """Device functions: the length of a tendon where its bodies are, and its slope."""
    linear_count = make_counts(effects.kinds).linear_count

    @wp.func
    def find_length(i: int, is_start: bool, ahead: float, s: wp.ref[Solver]) -> wp.float64:
        """Length of a tendon [m or rad], and its path where it is spatial.

        At the start of a step ``ahead`` is as :func:`.rows.path.side_taken` has it.
        """
        tendons = s.tree.tendons
        first = tendons.start[i]
        static_slot = s.work.inv_mass.shape[0] - 1
        total = wp.float64(0.0)
        if tendons.kind[first] == JOINT:
            for k in range(first, tendons.start[i + 1]):
                q = s.tree.coordinate[tendons.axis[k]]
                if is_start:
                    q = s.tree.start_coordinate[tendons.axis[k]]
                    if wp.static(effects.second_order):
                        q = s.history.coordinate[tendons.dof[k]].start
                q += wp.float64(tendons.ref[tendons.dof[k]])
                total += wp.float64(tendons.value[k]) * q
            return total
        if wp.static(effects.spatial_tendons):
            for k in range(first, tendons.start[i + 1]):
                body = tendons.body[k]
                if tendons.kind[k] != PULLEY:
                    point = double(tendons.begun[k])
                    frame = tendons.frame[k]
                    if body != static_slot and not is_start:
                        # read off the increments, so that it rounds as they do
                        arm = anchor_arm(body, frame, static_slot, s)
                        if is_put(body, s.work):
                            point = double(tendons.apart[k] + arm)
                        else:
                            turned = turned_from(s.tree.swing[body], arm)
                            point += double(joint_shift(s.work, body) + turned)
                    tendons.point[k] = point
                    if tendons.kind[k] == SPHERE or tendons.kind[k] == CYLINDER:
                        tendons.rotation[k] = wp.transform_get_rotation(frame)
                        if body != static_slot:
                            tendons.rotation[k] = anchor_rotation(s.tree, body, frame)
            total = find_path(i, True, wp.float64(wp.where(is_start, ahead, -1.0)), tendons)
        return total

    @wp.func
    def pull_along(i: int, ends: int, share: float, h: float, s: wp.ref[Solver]) -> float:
        """Adds a share of how the length of a tendon changes with the bodies to a row.

        ``ends`` says where the row keeps what its elements pull. Returns about how far a unit of
        tension moves bodies that nothing else holds along it [m/N].
        """
        tendons = s.tree.tendons
        closures = s.tree.closures
        first = tendons.start[i]
        mobility = float(0.0)
        if tendons.kind[first] == JOINT:
            for k in range(first, tendons.start[i + 1]):
                body = tendons.body[k]
                joint = s.tree.joint[body]
                coefficient = share * tendons.value[k]
                place = closures.ends[ends + k - first]
                if place >= 0 and is_linked(body, s):
                    met = closures.met[place]
                    met[0] = met[0] + coefficient
                    closures.met[place] = met
                    free = s.model.inv_mass[body]
                    if linear_count(s.joints, joint) == 0:
                        free = wp.trace(s.model.inv_inertia[body])
                    mobility += coefficient * coefficient * h * h * free
            return mobility
        if wp.static(effects.spatial_tendons):
            for along in range(first, tendons.span_end[i]):
                span = tendons.spans[along]
                for end in range(2):
                    k = wp.where(end == 0, span.a, span.b)
                    slot = closures.ends[ends + k - first]
                    if slot >= 0:
                        point = wp.where(end == 0, span.start, span.end)
                        sign = wp.where(end == 0, -share, share)
                        force = sign * span.share * span.along
                        torque = wp.cross(point - center_of(k, s), force)
                        way = wp.spatial_vector(force, torque)
                        closures.way[slot] = closures.way[slot] + way
                        mobility += mobility_of(tendons.body[k], way, h, s.model)
        return mobility

    return together(find_length, pull_along)
