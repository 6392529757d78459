# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Robots and mechanisms out of Newton's assets, set up as Newton's examples set them up.

They start inside their joint limits, above a floor, with the drives and the rotor inertia of the
asset or, where it has none, of the example. The inertia that examples add to bodies "for better
stability" is left out.
"""

import math
from collections.abc import Callable

import newton
import newton.examples
import numpy as np
import warp as wp

from newton_avbd.scenes.finalize import finalized
from newton_avbd.scenes.scene import Scene

GAP = 0.02
"""Contact detection gap of every shape [m]; Newton's default is as large as an ant's leg."""

WORLDS = 1024


def add_ant(builder: newton.ModelBuilder) -> None:
    """Add ``nv_ant.xml``, its legs in the middle of their range, no drives."""
    _add_mjcf(builder, "nv_ant.xml", height=0.0)
    _center_hinges(builder)
    _finish(builder)


def add_humanoid(builder: newton.ModelBuilder) -> None:
    """Add ``nv_humanoid.xml`` upright, held by the springs and dampers of its joints."""
    _add_mjcf(builder, "nv_humanoid.xml", height=1.5)
    _finish(builder)


def add_quadruped(builder: newton.ModelBuilder) -> None:
    """Add ``quadruped.urdf``, stiff drives that hold its start pose."""
    builder.default_shape_cfg.gap = GAP
    builder.default_joint_cfg.armature = 0.01
    builder.default_joint_cfg.target_ke = 2000.0
    builder.default_joint_cfg.target_kd = 1.0
    builder.add_urdf(
        newton.examples.get_asset("quadruped.urdf"),
        xform=wp.transform(wp.vec3(0.0, 0.0, 0.7), wp.quat_identity()),
        floating=True,
        enable_self_collisions=False,
        # The file's mass properties are placeholders; a density makes them fit the shapes.
        ignore_inertial_definitions=True,
        joint_damping_mode="drive",
    )
    pose = [0.2, 0.4, -0.6, -0.2, -0.4, 0.6, -0.2, 0.4, -0.6, 0.2, -0.4, 0.6]
    builder.joint_q[-12:] = pose
    builder.joint_target_q[-12:] = pose
    _finish(builder)


def add_cartpole(builder: newton.ModelBuilder) -> None:
    """Add ``cartpole.usda``, two poles on a cart, tipping over; nothing collides, no drives."""
    builder.default_joint_cfg.armature = 0.1
    _add_usd(builder, "cartpole.usda", height=0.0, enable_self_collisions=False)
    for shape in range(builder.shape_count):
        builder.shape_flags[shape] &= ~newton.ShapeFlags.COLLIDE_SHAPES
    builder.joint_q[-3:] = [0.0, 0.3, 0.0]
    place(builder)


def add_humanoid_usd(builder: newton.ModelBuilder) -> None:
    """Add ``humanoid.usda`` upright with the drives that the file holds."""
    _add_usd(builder, "humanoid.usda", height=1.5)
    _finish(builder)


def add_ant_usd(builder: newton.ModelBuilder) -> None:
    """Add ``ant.usda``, its legs in the middle of their range, with the file's drives."""
    _add_usd(builder, "ant.usda", height=0.0)
    _center_hinges(builder)
    _finish(builder)


def add_fourbar(builder: newton.ModelBuilder) -> None:
    """Add ``boxes_fourbar.usda``, a loop of four bars, tilted, over its own floor.

    The two hinges that the file declares driven get weak drives.
    """
    from pxr import Usd, UsdPhysics

    stage = Usd.Stage.Open(newton.examples.get_asset("boxes_fourbar.usda"))
    stage = Usd.Stage.Open(stage.Flatten())
    # The file says of no bar that it is the root; solvers in joint coordinates must know.
    root = stage.GetPrimAtPath("/boxes_fourbar/RigidBodies/body_1")
    UsdPhysics.ArticulationRootAPI.Apply(root)
    closing = UsdPhysics.Joint(stage.GetPrimAtPath("/boxes_fourbar/Joints/joint_4"))
    closing.CreateExcludeFromArticulationAttr(True)
    builder.default_shape_cfg.gap = GAP
    builder.add_usd(stage, enable_self_collisions=False)
    for joint, kind in enumerate(builder.joint_type):
        driven = builder.joint_label[joint].endswith(("joint_1", "joint_3"))
        if kind == newton.JointType.REVOLUTE and driven:
            dof = builder.joint_qd_start[joint]
            builder.joint_target_mode[dof] = int(newton.JointTargetMode.POSITION_VELOCITY)
            builder.joint_target_ke[dof] = 1.0
            builder.joint_target_kd[dof] = 0.001
    builder.joint_q[2] += 0.1
    builder.joint_q[3:7] = [0.0, math.sin(0.1), 0.0, math.cos(0.1)]
    place(builder)


def add_ant_worlds(builder: newton.ModelBuilder, worlds: int = WORLDS) -> None:
    """Add worlds with an ant in each, all alike."""
    world = newton.ModelBuilder()
    world.default_shape_cfg = builder.default_shape_cfg.copy()
    add_ant(world)
    builder.replicate(world, worlds)


def add_humanoid_worlds(builder: newton.ModelBuilder, worlds: int = WORLDS) -> None:
    """Add worlds in which a humanoid falls, from any orientation."""
    _add_falling_worlds(builder, add_humanoid, worlds, most_turn=math.pi)


def add_quadruped_worlds(builder: newton.ModelBuilder, worlds: int = WORLDS) -> None:
    """Add worlds in which a quadruped falls on its feet, its legs held by drives."""
    _add_falling_worlds(builder, add_quadruped, worlds, most_turn=0.3)


def _add_falling_worlds(
    builder: newton.ModelBuilder,
    add_robot: Callable[[newton.ModelBuilder], None],
    worlds: int,
    most_turn: float,
) -> None:
    """Add worlds with a robot in each, up to 0.5 m higher and turned by up to so much [rad]."""
    world = newton.ModelBuilder()
    world.default_shape_cfg = builder.default_shape_cfg.copy()
    add_robot(world)
    builder.replicate(world, worlds)
    random = np.random.default_rng(0)
    coordinates = len(builder.joint_q) // worlds
    for start in range(0, len(builder.joint_q), coordinates):
        axis = wp.normalize(wp.vec3(*random.normal(size=3)))
        turn = wp.quat_from_axis_angle(axis, float(random.uniform(0.0, most_turn)))
        builder.joint_q[start + 2] += float(random.uniform(0.0, 0.5))
        rotation = wp.quat(*builder.joint_q[start + 3 : start + 7])
        builder.joint_q[start + 3 : start + 7] = list(turn * rotation)
    place(builder)


def _add_mjcf(builder: newton.ModelBuilder, asset: str, height: float) -> None:
    """Add an asset without its floor, ``height`` [m] above where it was authored."""
    builder.default_shape_cfg.gap = GAP
    builder.add_mjcf(
        newton.examples.get_asset(asset),
        ignore_names=["floor", "ground"],
        xform=wp.transform(wp.vec3(0.0, 0.0, height), wp.quat_identity()),
        parse_sites=False,
    )


def _add_usd(
    builder: newton.ModelBuilder, asset: str, height: float, enable_self_collisions: bool = True
) -> None:
    """Add an asset ``height`` [m] above where it was authored."""
    builder.default_shape_cfg.gap = GAP
    builder.add_usd(
        newton.examples.get_asset(asset),
        xform=wp.transform(wp.vec3(0.0, 0.0, height), wp.quat_identity()),
        enable_self_collisions=enable_self_collisions,
        load_visual_shapes=False,
    )


def _center_hinges(builder: newton.ModelBuilder) -> None:
    """Set every hinge to the middle of its range."""
    for joint, kind in enumerate(builder.joint_type):
        if kind == newton.JointType.REVOLUTE:
            dof = builder.joint_qd_start[joint]
            middle = 0.5 * (builder.joint_limit_lower[dof] + builder.joint_limit_upper[dof])
            builder.joint_q[builder.joint_q_start[joint]] = middle


def _finish(builder: newton.ModelBuilder) -> None:
    """Place the bodies and add a floor."""
    place(builder)
    builder.add_ground_plane(cfg=builder.default_shape_cfg)


def place(builder: newton.ModelBuilder) -> None:
    """Move all bodies to where the joint coordinates put them."""
    model = finalized(builder, device="cpu")
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    for body, pose in enumerate(state.body_q.numpy()):
        builder.body_q[body] = wp.transform(*pose)


_SINGLE = (
    Scene("ant", "nv_ant.xml falls to the ground", add_ant, vbd_ke=1e4),
    Scene("humanoid", "nv_humanoid.xml falls to the ground", add_humanoid, vbd_ke=1e5),
    Scene("quadruped", "quadruped.urdf stands by its drives", add_quadruped, vbd_ke=1e5),
    Scene("cartpole", "cartpole.usda, two poles on a cart", add_cartpole),
    Scene("humanoid_usd", "humanoid.usda falls to the ground", add_humanoid_usd, vbd_ke=1e5),
    Scene("ant_usd", "ant.usda stands by its drives", add_ant_usd, vbd_ke=1e4),
    Scene("fourbar", "boxes_fourbar.usda, a loop of four bars", add_fourbar, vbd_ke=1e5),
)

ROBOTS = (
    *_SINGLE,
    Scene("ant_worlds", f"{WORLDS:,} worlds, an ant in each", add_ant_worlds, vbd_ke=1e4),
    Scene(
        "humanoid_worlds",
        f"{WORLDS:,} worlds, a humanoid falls in each",
        add_humanoid_worlds,
        vbd_ke=1e5,
    ),
    Scene(
        "quadruped_worlds",
        f"{WORLDS:,} worlds, a quadruped lands in each",
        add_quadruped_worlds,
        vbd_ke=1e5,
    ),
)
"""Scenes of one robot each, and of many worlds."""

SINGLE_ROBOTS = tuple(scene.name for scene in _SINGLE)
"""Names of the scenes of one robot."""
