# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""A scene that calls for everything at once, to see what all effects cost to compile and to run."""

from typing import Any

import newton
import numpy as np
import warp as wp
from newton.solvers import mujoco

from newton_avbd import SolverAVBD

SETTINGS: dict[str, Any] = {"angular_friction": True}
"""Arguments of the solver that the scene is made for."""

HINGE: dict[str, float] = {
    "target_ke": 10.0,
    "target_kd": 1.0,
    "limit_lower": -1.0,
    "limit_upper": 1.0,
    "effort_limit": 5.0,
    "velocity_limit": 10.0,
    "armature": 0.01,
    "friction": 0.1,
    "stiffness": 1.0,
    "damping": 0.1,
}
"""What a joint axis can have."""


def add_everything(builder: newton.ModelBuilder) -> None:
    """Add a ground, boxes, one of them put, and a mechanism with all types of joints and loops."""
    SolverAVBD.register_custom_attributes(builder)
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    newton.solvers.SolverVBD.register_custom_attributes(builder)
    builder.custom_attributes["mujoco:density"].values = {0: 1.2}
    cfg = newton.ModelBuilder.ShapeConfig(restitution=0.3, mu_torsional=0.01, mu_rolling=0.001)
    ground = builder.add_ground_plane(cfg=cfg)
    for x in (3.0, 3.5):
        box = builder.add_body(xform=_at(x, 0.0, 0.2))
        shape = builder.add_shape_box(
            box, hx=0.2, hy=0.1, hz=0.2, cfg=cfg, custom_attributes={"mujoco:condim": 6}
        )
    builder.add_custom_values(
        **{"mujoco:pair_geom1": ground, "mujoco:pair_geom2": shape, "mujoco:pair_condim": 3}
    )
    builder.add_shape_cylinder(box, radius=0.1, half_height=0.1, cfg=cfg)
    builder.add_shape_ellipsoid(box, rx=0.1, ry=0.1, rz=0.1, cfg=cfg)
    needle = builder.add_body(xform=_at(4.5, 0.0, 0.5))
    builder.add_shape_capsule(needle, radius=0.01, half_height=0.4, cfg=cfg)
    put = builder.add_body(xform=_at(6.0, 0.0, 0.5), is_kinematic=True)
    builder.add_shape_box(put, hx=0.2, hy=0.1, hz=0.2, cfg=cfg)
    links = [
        builder.add_link(
            xform=_at(0.5 * i, 0.0, 2.0),
            mass=1.0,
            inertia=wp.mat33(np.diag((0.02, 0.03, 0.04))),
            custom_attributes={"mujoco:gravcomp": 0.1},
        )
        for i in range(12)
    ]
    builder.add_shape_sphere(links[8], radius=0.1, cfg=cfg)

    def ends(parent: int, child: int) -> dict[str, Any]:
        first = wp.vec3(0.0, 0.0, 2.0) if parent < 0 else wp.vec3(0.5, 0.0, 0.0)
        frame = wp.transform(first, wp.quat_identity())
        return {"parent": parent, "child": child, "parent_xform": frame}

    first = builder.add_joint_revolute(
        **ends(-1, links[0]), **HINGE, custom_attributes={"avbd:joint_break_force": 1.0e4}
    )
    second = builder.add_joint_revolute(**ends(links[0], links[1]), **HINGE)
    axes = [
        newton.ModelBuilder.JointDofConfig(axis=axis) for axis in (newton.Axis.X, newton.Axis.Y)
    ]
    joints = [
        first,
        second,
        builder.add_joint_d6(**ends(links[1], links[2]), angular_axes=axes),
        builder.add_joint_ball(**ends(links[2], links[3])),
        builder.add_joint_prismatic(**ends(links[3], links[4])),
        builder.add_joint_fixed(**ends(links[4], links[5])),
        builder.add_joint_revolute(**ends(links[5], links[6])),
        builder.add_joint_distance(**ends(links[6], links[7]), min_distance=0.1, max_distance=0.8),
    ]
    builder.add_articulation(joints)
    builder.set_joint_mimic(second, first)
    mujoco.add_equality_joint(builder, joints[4], first, polycoef=(0.0, 0.0, 0.1))
    builder.add_articulation([builder.add_joint_revolute(**ends(-1, links[8]))])
    cable = {"vbd:dahl_eps_max": 0.1, "vbd:dahl_tau": 1.0}
    rod = builder.add_joint_rod(**ends(-1, links[9]), custom_attributes=cable)
    builder.add_articulation([rod])
    floats = builder.add_joint_free(links[10])
    builder.add_articulation([floats, builder.add_joint_ball(**ends(links[10], links[11]))])
    mujoco.add_equality_connect(builder, put, links[8])
    target = mujoco.ActuatorTarget
    mujoco.add_actuator_motor(builder, target.joint(first))
    for _ in range(2):
        mujoco.add_actuator_motor(builder, target.joint(first), forcerange=(-9.0, 9.0))
    mujoco.add_actuator_motor(builder, target.joint(joints[3]), gear=(1.0, 0.0, 0.0))
    mujoco.add_tendon_fixed(builder, [(first, 1.0), (second, -1.0)], stiffness=1.0)
    guide = newton.TendonGuide
    builder.add_tendon([guide(body=-1, offset=(0.0, 0.0, 3.0)), guide(body=links[0])])
    sites = [mujoco.TendonWrapSite(builder.add_site(link)) for link in (links[0], links[3])]
    mujoco.add_tendon_spatial(builder, sites, stiffness=1.0)
    held = {"biastype": "affine", "biasprm": (0.0, 0.0, -1.0)}
    mujoco.add_actuator_general(builder, target.site(sites[0].site), **held)
    mujoco.add_actuator_general(builder, target.body(links[8]))
    # these close loops: within a tree, and from a body that so hangs from its child
    builder.add_joint_ball(**ends(-1, links[6]), child_xform=_at(-3.0, 0.0, 0.0))
    builder.add_joint_revolute(**ends(links[7], links[8]))


def _at(x: float, y: float, z: float) -> wp.transform:
    return wp.transform(wp.vec3(x, y, z), wp.quat_identity())
