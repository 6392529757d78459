# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What acts along a free axis of a joint as it is eliminated: its push, and the stiffness it meets.

What acts is in :mod:`.rows.axis`, put together for a scene in :mod:`.step.axes`.
"""

import warp as wp

from ..data import Solver, Step, TreeAxis
from ..effects import Effects
from ..rows import axis as axis_rows
from ..rows.dahl import dahl_response
from ..rows.joint import BALL, ROD, ball_away
from ..rows.rod import rod_stiffness, rod_torque
from .axes import make_axis
from .joint_frame import JointFrame


@wp.struct
class FreeAxis:
    """A free axis as it is eliminated: which it is, and the stiffness that its coordinate meets."""

    dof: int
    """Which of the joint's axes it is."""
    entry: int
    """Its place in ``tree.axes``."""
    index: int
    """The degree of freedom of the model."""
    q: wp.float64
    """Coordinate [m or rad]."""
    moved: float
    """What the step has added to it."""
    inert: float
    """Stiffness by the inertia that the axis moves, over h^2 [N/m or N m]."""
    pivot: float
    """The whole stiffness."""
    pushed: float
    """Generalized force that is put on the axis [N or N m]."""


def make_add_forces(effects: Effects) -> wp.Function:
    """Device function: all that acts along an axis, at its linearisation."""
    axes = make_axis(effects)
    linear_force, law_of = axes.linear_force, axes.law_of

    @wp.func
    def add_linear(
        free: wp.ref[FreeAxis],
        axis: wp.ref[TreeAxis],
        h: float,
        frame: wp.ref[JointFrame],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """Adds what is linear in the coordinate: drives, springs, armature, compliant limits."""
        joint = frame.joint
        start_velocity = float(0.0)
        if wp.static(effects.axis_rates):
            start_velocity = s.tree.start_velocity[free.index]
        if s.joints.type[joint] != ROD:
            pull, stiffness = linear_force(
                s.joints,
                step.control,
                joint,
                free.dof,
                free.q,
                free.moved,
                start_velocity,
                frame.drive_away,
                frame.spring_away,
                h,
            )
            axis.push += pull
            free.pivot += stiffness
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                pull, stiffness = axis_rows.rod_response(
                    s.joints, free.index, wp.float32(free.q), free.moved, h
                )
                if free.dof < frame.linear:
                    axis.push += pull
                    free.pivot += stiffness
                else:
                    axis.push += wp.dot(axis.angular, frame.rod_torque)
                    free.pivot += frame.rod_stiffness[free.dof - frame.linear]

    @wp.func
    def add_law(
        free: wp.ref[FreeAxis],
        axis: wp.ref[TreeAxis],
        recovery: float,
        h: float,
        frame: wp.ref[JointFrame],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Adds the piece of what is not linear: stops, friction, drives with a limit of effort.

        Returns its generalized force [N or N m].
        """
        law = law_of(
            s.joints,
            step.control,
            s.history,
            frame.joint,
            free.dof,
            free.q,
            free.moved,
            frame.drive_away,
            recovery,
            h,
        )
        if wp.static(effects.joint_friction):
            law.held = s.tree.laws[free.entry].held
        pull, stiffness = axis_rows.law_force(law)
        axis.push += pull
        free.pivot += stiffness
        if axis_rows.is_held(law):
            axis.pivot = free.pivot
            axis.step = axis_rows.held_step(law)
        s.tree.laws[free.entry] = law
        return pull

    @wp.func
    def add_forces(
        free: wp.ref[FreeAxis],
        axis: wp.ref[TreeAxis],
        recovery: float,
        h: float,
        frame: wp.ref[JointFrame],
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ) -> float:
        """Adds what acts along an axis to its push and its pivot.

        Returns the force of a law that does not grow with the coordinate, such as friction that
        slips [N or N m].
        """
        pull = float(0.0)
        if wp.static(effects.coordinates):
            add_linear(free, axis, h, frame, step, s)
            if wp.static(effects.laws):
                pull = add_law(free, axis, recovery, h, frame, step, s)
        return pull

    return add_forces


def make_ball_and_rod(effects: Effects) -> wp.Function:
    """Device function: what the three turns of a ball or a rod push with together."""

    @wp.func
    def rod_responses(body: int, joint: int, h: float, s: wp.ref[Solver]):
        """Torque along the bends and the twist of a rod [N m], and how it grows [N m/rad]."""
        response = wp.vec3(0.0)
        stiff = wp.vec3(0.0)
        for dof in range(3):
            k = s.tree.axis_start[body] + 3 + dof
            index = s.joints.dof_start[joint] + 3 + dof
            q = s.tree.coordinate[k]
            moved = wp.float32(q - s.tree.start_coordinate[k])
            pull, stiffness = axis_rows.rod_response(s.joints, index, wp.float32(q), moved, h)
            if wp.static(effects.dahl):
                resisting, slope, _most = dahl_response(
                    joint, dof, wp.float32(q), moved, s.joints, s.history
                )
                pull += resisting
                stiffness += slope
            response[dof] = pull
            stiff[dof] = stiffness
        return response, stiff

    @wp.func
    def measure_ball_and_rod(
        body: int, h: float, frame: wp.ref[JointFrame], step: wp.ref[Step], s: wp.ref[Solver]
    ):
        """Measures how a ball or a rod has turned away from where its drive and springs lead."""
        joint = frame.joint
        if wp.static(effects.kinds.balls and effects.drives):
            if s.joints.type[joint] == BALL:
                frame.drive_away = ball_away(
                    step.control.target_q, s.joints, joint, frame.q_p, frame.q_c
                )
        if wp.static(effects.kinds.balls and effects.springs):
            if s.joints.type[joint] == BALL:
                frame.spring_away = ball_away(
                    s.joints.rest_q, s.joints, joint, frame.q_p, frame.q_c
                )
        if wp.static(effects.rods):
            if s.joints.type[joint] == ROD:
                response, stiff = rod_responses(body, joint, h, s)
                frame.rod_torque = frame.sign * rod_torque(frame.q_p, frame.q_c, response)
                frame.rod_stiffness = rod_stiffness(frame.q_p, frame.q_c, stiff)

    return measure_ball_and_rod
