# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Hanging chains of rigid links: hinges or ball joints, equal links or a heavy one at the end."""

import math
from functools import partial

import newton
import warp as wp

from newton_avbd.scenes.scene import Scene

DENSITY = 1000.0
"""Density of a link [kg/m^3]."""


def add_chain(
    builder: newton.ModelBuilder,
    links: int,
    *,
    ball: bool = False,
    end_ratio: float = 1.0,
    length: float = 0.2,
    slope: float = 0.0,
    sweep: float = 0.0,
) -> None:
    """Add a chain of boxes that hangs from the world by its first link, at rest.

    Links are ``length`` x ``length`` / 2 x ``length`` / 4, 1 kg at 0.2 m, and collide with
    nothing. The chain hangs as high as it is long, so that its potential energy is positive
    wherever it swings. All joint coordinates of a hinged chain are 0 at the start.

    Args:
        builder: Builder to add to.
        links: Number of links.
        ball: Ball joints; otherwise hinges, all about the world's y axis.
        end_ratio: Mass of the last link relative to that of the others, at the same size.
        length: Length of a link and distance between its joints [m].
        slope: Angle by which the links point below the horizontal [rad].
        sweep: Angle by which the chain turns to the side from its first link to its last [rad];
            for ball joints, and what makes them move out of a plane.
    """
    down = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), slope)
    end = wp.vec3(0.0, 0.0, links * length)
    turn = sweep / max(1, links - 1)
    center = wp.vec3(0.5 * length, 0.0, 0.0)
    parent, joints = -1, []
    for i in range(links):
        rotation = wp.mul(down, wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), i * turn))
        body = builder.add_link(
            xform=wp.transform(end + wp.quat_rotate(rotation, center), rotation)
        )
        builder.add_shape_box(
            body,
            hx=0.5 * length,
            hy=0.25 * length,
            hz=0.125 * length,
            cfg=_link(builder, end_ratio if i == links - 1 else 1.0),
        )
        hung = wp.transform(end, down) if parent < 0 else wp.transform(center, wp.quat_identity())
        held = wp.transform(-center, wp.quat_identity())
        if ball:
            joints.append(builder.add_joint_ball(parent, body, parent_xform=hung, child_xform=held))
            half = 0.5 * turn if i else 0.0
            builder.joint_q[-4:] = [0.0, 0.0, math.sin(half), math.cos(half)]
        else:
            axis = wp.vec3(0.0, 1.0, 0.0)
            joints.append(
                builder.add_joint_revolute(
                    parent, body, parent_xform=hung, child_xform=held, axis=axis
                )
            )
        end = end + wp.quat_rotate(rotation, 2.0 * center)
        parent = body
    builder.add_articulation(joints)


def _link(builder: newton.ModelBuilder, ratio: float) -> newton.ModelBuilder.ShapeConfig:
    """Mass of a link, ``ratio`` times the common one, in a shape that nothing touches."""
    cfg = builder.default_shape_cfg.copy()
    cfg.density = ratio * DENSITY
    cfg.has_shape_collision = False
    cfg.has_particle_collision = False
    return cfg


def _chain(name: str, end_ratio: int) -> Scene:
    summary = f"20 hinged links swing from the horizontal, end mass 1:{end_ratio}"
    return Scene(name, summary, partial(add_chain, links=20, end_ratio=end_ratio), frames=600)


def _rope(name: str, end_ratio: int) -> Scene:
    summary = f"100 links on ball joints swing in space, end mass 1:{end_ratio}"
    build = partial(add_chain, links=100, ball=True, end_ratio=end_ratio, sweep=math.radians(30.0))
    return Scene(name, summary, build, frames=300)


CHAINS = (
    _chain("chain", 1),
    _chain("chain_100", 100),
    _chain("chain_10000", 10_000),
    _rope("rope", 1),
    _rope("rope_100000", 100_000),
)
"""Scenes of one chain each."""
