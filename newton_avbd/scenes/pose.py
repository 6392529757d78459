# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Standing an imported robot up: its first pose, the ground, and drives that hold the pose."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import newton
import numpy as np

from newton_avbd.measure.overlaps import DEPTH
from newton_avbd.measure.state import Array, Probe
from newton_avbd.model.rotations import rotate, transform
from newton_avbd.scenes.finalize import finalized
from newton_avbd.scenes.robots import place

FREQUENCY = 4.0
"""Natural frequency of a drive that the file gives no gains [Hz]: a link of 1 m sags 24 mrad."""

SOLE = 0.01
"""Height above its lowest point within which a robot is taken to stand on something [m]."""

UPRIGHT = 0.9
"""Least upward part of the normal of a plane that counts as a ground."""

_UP = np.array([0.0, 0.0, 1.0])
_NO_DRIVE = (newton.JointType.FREE, newton.JointType.DISTANCE, newton.JointType.FIXED)
_GROUNDS = (newton.GeoType.PLANE, newton.GeoType.HFIELD)


@dataclass
class Pose:
    """A robot set up in a builder.

    Attributes:
        builder: The robot, its ground and its drives.
        floating: Whether the robot can fall: whether a base joint lets it move upwards.
        driven: Degrees of freedom that are driven.
        filtered: Pairs of shapes that overlap in the first pose and are filtered.
    """

    builder: newton.ModelBuilder
    floating: bool
    driven: list[int] = field(default_factory=list)
    filtered: int = 0


def stand(builder: newton.ModelBuilder) -> Pose:
    """Set a robot up that an importer put into ``builder``.

    The joints go to the coordinate of the file, or to the nearest within their limits. A robot that
    floats is lowered until it touches the ground, which is added where the file has none. One that
    is bolted down does not collide with a ground that is added. Position
    drives hold the first pose with the file's gains, or, where it has none, with those of a mass on
    a critically damped spring of :data:`FREQUENCY`: ke = I w^2 and kd = 2 I w, where I is the
    inertia that the drive moves, see :func:`_inertias`. A limit of effort or velocity of zero,
    which many files write where they know none, is taken for no limit.
    """
    for dof in range(builder.joint_dof_count):
        for limit in (builder.joint_effort_limit, builder.joint_velocity_limit):
            if limit[dof] <= 0.0:
                limit[dof] = newton.MAXVAL
    _enter_limits(builder)
    place(builder)
    pose = Pose(builder, floating=any(can_fall(builder, j) for j in range(builder.joint_count)))
    _meet_ground(builder, pose.floating)
    model = finalized(builder, device="cpu")
    inertias = _inertias(model, pose.floating)
    _add_followers(builder, inertias)
    for joint in range(builder.joint_count):
        if builder.joint_mimic_joint[joint] >= 0 or _is_base(builder, joint):
            continue
        if builder.joint_type[joint] in (*_NO_DRIVE, newton.JointType.ROD):
            continue
        if builder.joint_articulation[joint] < 0:
            continue
        for dof in dofs_of(builder, joint):
            if builder.joint_target_ke[dof] <= 0.0 and inertias[dof] <= 0.0:
                continue  # it moves nothing: no drive is right for it
            pose.driven.append(dof)
            builder.joint_target_mode[dof] = int(newton.JointTargetMode.POSITION)
            if builder.joint_target_ke[dof] <= 0.0:
                speed = 2.0 * np.pi * FREQUENCY
                builder.joint_target_ke[dof] = float(inertias[dof] * speed**2)
                builder.joint_target_kd[dof] = float(2.0 * inertias[dof] * speed)
    for i, value in enumerate(builder.joint_q):
        builder.joint_target_q[i] = value
    pose.filtered = _filter_overlaps(builder, model)
    return pose


def dofs_of(builder: newton.ModelBuilder, joint: int) -> range:
    """Degrees of freedom of a joint."""
    count = sum(builder.joint_dof_dim[joint])
    return range(builder.joint_qd_start[joint], builder.joint_qd_start[joint] + count)


def _is_base(builder: newton.ModelBuilder, joint: int) -> bool:
    """Whether a joint only says that a robot can move freely in space, or in a plane."""
    if builder.joint_parent[joint] >= 0:
        return False
    linear, angular = builder.joint_dof_dim[joint]
    kind = builder.joint_type[joint]
    return kind == newton.JointType.FREE or (
        kind == newton.JointType.D6 and linear >= 2 and angular >= 1
    )


def can_fall(builder: newton.ModelBuilder, joint: int) -> bool:
    """Whether a joint lets a robot move freely in space, or in an upright plane."""
    if not _is_base(builder, joint) or builder.joint_type[joint] == newton.JointType.FREE:
        return _is_base(builder, joint)
    start, linear = builder.joint_qd_start[joint], builder.joint_dof_dim[joint][0]
    frame = np.array(builder.joint_X_p[joint])[3:]
    axes = [np.array(builder.joint_axis[dof]) for dof in range(start, start + linear)]
    return any(abs(rotate(frame, axis)[2]) > 0.5 for axis in axes)


def _enter_limits(builder: newton.ModelBuilder) -> None:
    """Move joint coordinates to within their limits, followers after their leaders."""
    for joint, kind in enumerate(builder.joint_type):
        if kind in (*_NO_DRIVE, newton.JointType.BALL, newton.JointType.ROD):
            continue
        for i, dof in enumerate(dofs_of(builder, joint)):
            at = builder.joint_q_start[joint] + i
            lower, upper = builder.joint_limit_lower[dof], builder.joint_limit_upper[dof]
            if lower <= upper:
                builder.joint_q[at] = float(np.clip(builder.joint_q[at], lower, upper))
    follow_leaders(builder, builder.joint_q, builder.joint_q_start, offset=True)


def follow_leaders(
    builder: newton.ModelBuilder, values: list[float] | Array, at: list[int], *, offset: bool
) -> None:
    """Set coordinates or velocities of mimic joints, which start ``at``, by those of their leaders.

    Coordinates with the constant ``offset``, velocities without it.
    """
    for joint, leader in enumerate(builder.joint_mimic_joint):
        if leader >= 0:
            constant, factor = builder.joint_mimic_coeffs[joint]
            for i in range(len(dofs_of(builder, joint))):
                values[at[joint] + i] = offset * constant + factor * values[at[leader] + i]


def _meet_ground(builder: newton.ModelBuilder, floating: bool) -> None:
    """Lower what floats to the ground; put a ground under what has none.

    What is bolted down keeps clear of a ground that is not its file's: that is there to be seen.
    """
    own = grounds(builder)
    lowest = lowest_points(finalized(builder, device="cpu"))[:-1]
    bottom = float(np.min(lowest, initial=np.inf))
    free = [
        joint
        for joint, kind in enumerate(builder.joint_type)
        if kind == newton.JointType.FREE and builder.joint_parent[joint] < 0
    ]
    level = float(builder.shape_transform[own[0]][2]) if own else 0.0
    if floating and len(free) == 1 and np.isfinite(bottom):
        builder.joint_q[builder.joint_q_start[free[0]] + 2] += level - bottom
        place(builder)
        bottom = level
    if not own:
        under = bottom if floating or bottom < 0.0 else 0.0
        look = builder.default_shape_cfg.copy()
        look.has_shape_collision = look.has_particle_collision = floating
        builder.add_ground_plane(height=under if np.isfinite(under) else 0.0, cfg=look)


def grounds(builder: newton.ModelBuilder) -> list[int]:
    """Colliding planes and terrains of the world that face upwards; some files hold walls only."""
    return [
        shape
        for shape, (body, kind, flags) in enumerate(
            zip(builder.shape_body, builder.shape_type, builder.shape_flags, strict=True)
        )
        if body < 0
        and kind in _GROUNDS
        and flags & newton.ShapeFlags.COLLIDE_SHAPES
        and rotate(np.array(builder.shape_transform[shape])[3:], _UP)[2] > UPRIGHT
    ]


def lowest_points(model: newton.Model) -> Array:
    """Height of the lowest point of each body's colliding shapes [m], infinite without any.

    The last is that of the world's shapes, its planes left out; shape [bodies + 1].
    """
    lowest = np.full(model.body_count + 1, np.inf)
    colliding = (model.shape_flags.numpy() & int(newton.ShapeFlags.COLLIDE_SHAPES)) != 0
    body = model.shape_body.numpy()
    scale, kind = model.shape_scale.numpy().astype(float), model.shape_type.numpy()
    # Row -1 is the world.
    poses = np.vstack([model.body_q.numpy(), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]).astype(float)
    for shape in np.flatnonzero(colliding & (kind != int(newton.GeoType.PLANE))):
        points, radius = _points(model, int(shape), int(kind[shape]), scale[shape])
        local = transform(model.shape_transform.numpy()[shape].astype(float), points)
        height = transform(poses[body[shape]], local)[:, 2].min() - radius
        lowest[body[shape]] = min(lowest[body[shape]], height)
    return lowest


def _points(model: newton.Model, shape: int, kind: int, scale: Array) -> tuple[Array, float]:
    """Points whose hull, grown by a radius [m], is the shape; a ring for round ones."""
    around = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    ring = np.stack([np.cos(around), np.sin(around), np.zeros_like(around)], axis=1)
    ends = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    if kind == newton.GeoType.SPHERE:
        return np.zeros((1, 3)), float(scale[0])
    if kind == newton.GeoType.CAPSULE:
        return ends * scale[1], float(scale[0])
    if kind == newton.GeoType.CYLINDER:
        return np.concatenate([scale[0] * ring + end * scale[1] for end in ends]), 0.0
    if kind == newton.GeoType.BOX:
        corners = np.array(list(np.ndindex(2, 2, 2)), float) * 2.0 - 1.0
        return corners * scale, 0.0
    source = model.shape_source[shape]
    if source is not None and hasattr(source, "vertices"):
        return np.asarray(source.vertices, float) * scale, 0.0
    lower = model.shape_collision_aabb_lower.numpy()[shape].astype(float)
    upper = model.shape_collision_aabb_upper.numpy()[shape].astype(float)
    return np.array([np.where(c, upper, lower) for c in np.ndindex(2, 2, 2)]), 0.0


def _inertias(model: newton.Model, floating: bool) -> Array:
    """Inertia that the drive of each degree of freedom moves [kg m^2 or kg], shape [dofs].

    That of all links beyond the joint about its axis, with the armature. If a floating robot stands
    on one of these, the joint carries the rest of the robot: the larger of the two inertias counts.
    """
    poses = model.body_q.numpy().astype(float)
    mass = model.body_mass.numpy().astype(float)
    center = transform(poses, model.body_com.numpy().astype(float))
    turn = np.stack(
        [transform(np.hstack([np.zeros((len(poses), 3)), poses[:, 3:]]), e) for e in np.eye(3)],
        axis=2,
    )
    inertia = turn @ model.body_inertia.numpy().astype(float) @ np.swapaxes(turn, 1, 2)
    lowest = lowest_points(model)[:-1]
    stands = lowest < np.min(lowest, initial=np.inf) + SOLE
    found = model.joint_armature.numpy().astype(float)
    parents, children = model.joint_parent.numpy(), model.joint_child.numpy()
    tree = model.joint_articulation.numpy() >= 0
    axes = model.joint_axis.numpy().astype(float)
    start, linear = model.joint_qd_start.numpy(), model.joint_dof_dim.numpy()[:, 0]
    frames = model.joint_X_p.numpy().astype(float)
    for joint in np.flatnonzero(tree):
        beyond = np.zeros(len(poses), bool)
        beyond[list(_subtree(int(children[joint]), parents[tree], children[tree]))] = True
        parent = poses[parents[joint]] if parents[joint] >= 0 else np.array([0.0] * 6 + [1.0])
        anchor = transform(parent, frames[joint, :3])
        for i, dof in enumerate(range(start[joint], start[joint + 1])):
            along = transform(parent, transform(frames[joint], axes[dof])) - anchor
            arms = np.cross(along, center - anchor)
            about = (
                mass
                if i < linear[joint]
                else (
                    np.einsum("i,nij,j->n", along, inertia, along) + mass * np.sum(arms**2, axis=1)
                )
            )
            moved = about[beyond].sum()
            if floating and np.any(stands & beyond):
                moved = max(moved, about[~beyond].sum())
            found[dof] += moved
    return found


def _add_followers(builder: newton.ModelBuilder, inertias: Array) -> None:
    """Add to what a leader's drive moves what moves with it in the joints that mimic it."""
    leaders = builder.joint_mimic_joint
    for joint, leader in enumerate(leaders):
        factor, at = 1.0, joint
        while leader >= 0:
            factor, at = factor * builder.joint_mimic_coeffs[at][1], leader
            leader = leaders[at]
        if at != joint:
            for own, led in zip(dofs_of(builder, joint), dofs_of(builder, at), strict=True):
                inertias[led] += factor**2 * inertias[own]


def _subtree(root: int, parents: Array, children: Array) -> Iterator[int]:
    """Bodies of the tree that hang on ``root``, itself included."""
    yield root
    for child in children[parents == root]:
        yield from _subtree(int(child), parents, children)


def _filter_overlaps(builder: newton.ModelBuilder, model: newton.Model) -> int:
    """Filter pairs that overlap in the first pose, but for the ground; returns how many there are.

    The other one may be a shape of the world: some files keep markers there.
    """
    shapes, gaps = Probe(model).contacts(model.state())
    ground = set(grounds(builder))
    pairs = {
        (min(int(a), int(b)), max(int(a), int(b)))
        for (a, b), gap in zip(shapes, gaps, strict=True)
        if gap < -DEPTH and not ground & {int(a), int(b)}
    }
    for pair in sorted(pairs):
        builder.add_shape_collision_filter_pair(*pair)
    return len(pairs)
