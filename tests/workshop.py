# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A scene that calls for nearly every effect, for what must hold whatever a scene is made of."""

from typing import Any

import newton
import numpy as np
import warp as wp
from helpers import add_box, add_ground
from joint_scenes import WORLD, add_link, transform

HIGH = 3.0
"""Where the mechanisms hang [m]."""

LONG = 0.4
"""Distance from one joint to the next [m]."""

BODIES = 10
"""Bodies of a workshop."""

TOP, BOTTOM, LEFT, RIGHT = ((0, 0, 0.2), (0, 0, -0.2), (-0.2, 0, 0), (0.2, 0, 0))

LAWS: dict[str, Any] = {
    "target_q": 0.2,
    "target_ke": 100.0,
    "target_kd": 1.0,
    "actuator_mode": newton.JointTargetMode.POSITION_VELOCITY,
    "effort_limit": 10.0,
    "velocity_limit": 10.0,
    "armature": 0.01,
    "friction": 0.1,
    "damping": 0.1,
    "stiffness": 1.0,
    "limit_lower": -0.2,
    "limit_upper": 0.25,
}
"""Everything that may act along a joint axis."""


def add_workshop(builder: newton.ModelBuilder) -> None:
    """Boxes 0 and 1 on the ground; 2, 3, 4 a driven four-bar; 5 to 8 a chain with a joint of each
    kind; 9 follows the first of these as a mimic."""
    add_ground(builder)
    for i in range(2):
        add_box(builder, (0.02 * i, 0.0, 0.25 + 0.51 * i), size=(0.5, 0.4, 0.5))

    crank, coupler, rocker = (
        add_link(builder, xform=transform(at))
        for at in ((0, 0, HIGH - 0.2), (0.2, 0, HIGH - LONG), (LONG, 0, HIGH - 0.2))
    )
    hinges = [
        builder.add_joint_revolute(
            parent,
            child,
            axis=(0, 1, 0),
            parent_xform=transform(hung),
            child_xform=transform(held),
            **laws,
        )
        for parent, child, hung, held, laws in (
            (WORLD, crank, (0, 0, HIGH), TOP, LAWS),
            (crank, coupler, BOTTOM, LEFT, {}),
            (coupler, rocker, RIGHT, BOTTOM, {}),
        )
    ]
    builder.add_articulation(hinges)
    builder.add_joint_revolute(
        WORLD,
        rocker,
        axis=(0, 1, 0),
        parent_xform=transform((LONG, 0, HIGH)),
        child_xform=transform(TOP),
    )

    links = [add_link(builder, xform=transform((2, 0, HIGH - 0.2 - LONG * i))) for i in range(4)]
    builder.body_qd[links[3]] = wp.spatial_vector(1.5, 1.0, 0.0, 0.0, 0.0, 2.0)
    axis = newton.ModelBuilder.JointDofConfig
    frames = [
        {"parent_xform": transform(at), "child_xform": transform(TOP)}
        for at in ((2, 0, HIGH), BOTTOM, BOTTOM, BOTTOM)
    ]
    slide = builder.add_joint_prismatic(WORLD, links[0], **frames[0], **LAWS)
    ball = builder.add_joint_ball(links[0], links[1], **frames[1])
    builder.joint_target_ke[-3:], builder.joint_target_kd[-3:] = [2.0] * 3, [0.1] * 3
    d6 = builder.add_joint_d6(
        links[1],
        links[2],
        linear_axes=[axis(axis=(1, 0, 0), **LAWS)],
        angular_axes=[axis(axis=(0, 1, 0), **LAWS), axis(axis=(0, 0, 1))],
        **frames[2],
    )
    rod = builder.add_joint_rod(links[2], links[3], bend_stiffness=5.0, **frames[3])
    follower = add_link(builder, xform=transform((2, 1, HIGH - 0.2)))
    mimic = builder.add_joint_prismatic(
        WORLD, follower, parent_xform=transform((2, 1, HIGH)), child_xform=transform(TOP)
    )
    builder.add_articulation([slide, ball, d6, rod, mimic])
    builder.set_joint_mimic(mimic, slide, coeffs=(0.0, -0.5))
    builder.add_joint_distance(
        WORLD, links[3], parent_xform=frames[0]["parent_xform"], max_distance=1.5
    )


def workshops(count: int) -> newton.ModelBuilder:
    """``count`` worlds with a workshop in each."""
    world, many = newton.ModelBuilder(), newton.ModelBuilder()
    add_workshop(world)
    many.replicate(world, count)
    return many


def spoil(array: wp.array, row: int, value: float) -> None:
    """Writes ``value`` into the first number of one entry of an array."""
    values = array.numpy().copy()
    values.reshape(len(values), -1)[row, 0] = value
    array.assign(values)


def numbers(array: wp.array) -> np.ndarray:
    """A copy of what an array holds."""
    return array.numpy().copy()
