# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""One degree of freedom with everything that may act along it, and its backward Euler solution."""

from dataclasses import dataclass, replace
from typing import Any

import newton
import numpy as np
from helpers import NO_GRAVITY, Simulation
from joint_scenes import WORLD, add_link, set_control, set_coordinates, simulate, transform
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

TURNED = Rotation.from_euler("xyz", [0.5, -0.8, 1.9])
MASS = 2.0
MOMENT = 0.3

Mode = newton.JointTargetMode
Axis = newton.ModelBuilder.JointDofConfig

KINDS = ("slider", "hinge", "d6")
"""A PRISMATIC, a REVOLUTE, and a D6 joint with one linear and one angular axis, the linear one."""


@dataclass(frozen=True)
class Law:
    """What acts along the axis, named as in ``ModelBuilder.JointDofConfig``, and its targets."""

    target_ke: float = 0.0
    target_kd: float = 0.0
    actuator_mode: Mode = Mode.POSITION_VELOCITY
    effort_limit: float = 1.0e6
    stiffness: float = 0.0
    rest_q: float = 0.0
    damping: float = 0.0
    armature: float = 0.0
    friction: float = 0.0
    velocity_limit: float = 1.0e6
    limit_lower: float = -newton.MAXVAL
    limit_upper: float = newton.MAXVAL
    target_q: float = 0.0
    target_qd: float = 0.0
    force: float = 0.0
    """``joint_f``."""

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments of the builder."""
        return {k: v for k, v in vars(self).items() if k not in ("force", "target_q", "target_qd")}

    def without_drive(self) -> "Law":
        return replace(self, target_ke=0.0, target_kd=0.0)

    def advanced(self, inertia: float, q: float, v: float, h: float) -> tuple[float, float]:
        """One step of backward Euler: the root of M (v' - v)/h = F(v'), which grows with v'."""
        ke = 0.0 if self.actuator_mode == Mode.VELOCITY else self.target_ke
        target_qd = 0.0 if self.actuator_mode == Mode.POSITION else self.target_qd

        def excess(w: float) -> float:
            x = q + h * w
            drive = ke * (self.target_q - x) + self.target_kd * (target_qd - w)
            drive = np.clip(drive, -self.effort_limit, self.effort_limit)
            force = drive + self.force - self.stiffness * (x - self.rest_q) - self.damping * w
            return (inertia + self.armature) * (w - v) / h - force

        def solve(push: float) -> float:
            return brentq(lambda w: excess(w) - push, -1.0e3, 1.0e3, xtol=1.0e-13)

        held = excess(0.0)
        w = 0.0 if abs(held) <= self.friction else solve(np.sign(held) * self.friction)
        lower = max(-self.velocity_limit, (self.limit_lower - q) / h)
        upper = min(self.velocity_limit, (self.limit_upper - q) / h)
        w = float(np.clip(w, lower, upper))
        return q + h * w, w


def axis_scene(
    kind: str, law: Law, q: float = 0.0, qd: float = 0.0, **settings: Any
) -> tuple[Simulation, float]:
    """A body on a turned joint without gravity that ``law`` acts on, and its inertia there.

    The hinge runs through the COM, about a principal axis, so that the motion is linear.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    body = add_link(builder, mass=MASS, inertia=(0.2, MOMENT, 0.4), com=(0.1, 0.2, 0.3))
    frames = {
        "parent_xform": transform((1.0, 0.5, -0.3), TURNED),
        "child_xform": transform((0.1, 0.2, 0.3)),
    }
    if kind == "d6":
        axis = Axis(axis=(0.0, 1.0, 0.0), **law.settings)
        spin = Axis(axis=(1.0, 0.0, 0.0))
        joint = builder.add_joint_d6(WORLD, body, linear_axes=[axis], angular_axes=[spin], **frames)
    else:
        add = builder.add_joint_revolute if kind == "hinge" else builder.add_joint_prismatic
        joint = add(WORLD, body, axis=(0.0, 1.0, 0.0), **frames, **law.settings)
    builder.add_articulation([joint])
    zeros = [0.0] * (kind == "d6")
    set_coordinates(builder, joint, [q, *zeros], [qd, *zeros])
    sim = simulate(builder, **settings)
    set_control(
        sim,
        joint_f=[law.force, *zeros],
        joint_target_q=[law.target_q, *zeros],
        joint_target_qd=[law.target_qd, *zeros],
    )
    return sim, MOMENT if kind == "hinge" else MASS
