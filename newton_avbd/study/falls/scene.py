# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Robots that fall, spin or are thrown: where they start, and the worlds that they start in."""

from dataclasses import dataclass, replace

import newton
import numpy as np

from newton_avbd.measure.overlaps import DEPTH
from newton_avbd.measure.state import Array, Bodies, Probe
from newton_avbd.model.rotations import product, rotate, transform
from newton_avbd.scenes.finalize import finalized
from newton_avbd.scenes.pose import dofs_of, follow_leaders, lowest_points, stand

DROP = 0.1
"""Height of the lowest point above the ground at the start [m]."""

AHEAD = 0.2
"""Distance of the foremost point from the wall at the start [m]."""

THROW = 10.0
"""Speed of a throw [m/s]."""

ARM = 0.1
"""Speed of a sliding joint where turning ones have 1 rad/s [m/s]."""

TRIES = 8
"""Random poses that are tried; each is closer to the first pose, the last one is that."""

_LOOSE = (newton.JointType.FREE, newton.JointType.DISTANCE, newton.JointType.FIXED)


@dataclass(frozen=True)
class Start:
    """Where a robot starts.

    Attributes:
        kind: One of :data:`~newton_avbd.study.falls.kinds.KINDS`.
        seed: Number of the start.
        joint_q: Joint coordinates.
        joint_qd: Joint velocities.
        ground: Height of the ground [m].
        wall: Place of the wall, which stands across the x-axis [m].
    """

    kind: str
    seed: int
    joint_q: list[float]
    joint_qd: list[float]
    ground: float
    wall: float

    @property
    def spin(self) -> float:
        """Speed up to which joints turn [rad/s]; 0 for a robot with weight."""
        return float(self.kind.removeprefix("spin")) if self.kind.startswith("spin") else 0.0

    @property
    def gravity(self) -> tuple[float, float, float]:
        """Gravity [m/s^2]."""
        return (0.0, 0.0, 0.0 if self.spin else -9.81)


def bare(builder: newton.ModelBuilder) -> newton.ModelBuilder:
    """Take from an imported robot what does work, or hides what the solver does.

    Drives, actuators, passive springs and dampers are off; armature and friction stay. Shapes of
    the world do not collide. Pairs of shapes that overlap in the first pose are filtered.
    """
    stand(builder)
    for dof in range(builder.joint_dof_count):
        builder.joint_target_mode[dof] = int(newton.JointTargetMode.NONE)
        for values in (
            builder.joint_target_ke,
            builder.joint_target_kd,
            builder.joint_stiffness,
            builder.joint_damping,
        ):
            values[dof] = 0.0
    gear = builder.custom_attributes.get("mujoco:actuator_gear")
    if gear is not None and gear.values:
        gear.values = [type(value)(0.0) for value in gear.values]
    for shape, body in enumerate(builder.shape_body):
        if body < 0:
            builder.shape_flags[shape] &= ~int(newton.ShapeFlags.COLLIDE_SHAPES)
    return builder


def starts(builder: newton.ModelBuilder, kinds: tuple[str, ...], seeds: range) -> list[Start]:
    """Random starts of a robot without its own overlaps.

    Joints are anywhere within their limits, free roots are turned at random. Where a loop is closed
    by joints, the joints keep the first pose, and nothing spins. A robot without a root that can
    move along x is not thrown.

    Args:
        builder: What :func:`bare` has returned.
        kinds: Of :data:`~newton_avbd.study.falls.kinds.KINDS`.
        seeds: Numbers of the starts; the same number gives the same pose in all kinds.
    """
    model = finalized(builder, device="cpu")
    probe, state = Probe(model), model.state()
    is_loop = any(articulation < 0 for articulation in builder.joint_articulation)
    throw = _throw(builder)
    found = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        q = _pose(builder, probe, state, rng, 0.0 if is_loop else 1.0)
        model.body_q.assign(state.body_q)
        ground = _ground(model)
        wall = _foremost(model) + AHEAD
        rate = rng.uniform(-1.0, 1.0, builder.joint_dof_count)
        for kind in kinds:
            qd = np.zeros(builder.joint_dof_count)
            start = Start(kind, seed, q.tolist(), qd.tolist(), ground, wall)
            if (start.spin and is_loop) or (kind == "thrown" and not throw.any()):
                continue
            if start.spin:
                qd = start.spin * rate * _spins(builder)
                follow_leaders(builder, qd, builder.joint_qd_start, offset=False)
            elif kind == "thrown":
                qd = THROW * throw
            found.append(replace(start, joint_qd=qd.tolist()))
    return found


def _ground(model: newton.Model) -> float:
    """Height of a ground under all of a robot [m], also under what of it does not collide.

    Above a center of mass, a robot of which only the feet collide would have less energy than none.
    """
    lowest = float(np.min(lowest_points(model)[:-1], initial=np.inf))
    bodies = Bodies.of(model)
    centers = transform(model.body_q.numpy().astype(float), bodies.com)[bodies.mass > 0.0, 2]
    return float(np.min(centers, initial=lowest)) - DROP if np.isfinite(lowest) else -100.0


def make_model(builder: newton.ModelBuilder, chosen: list[Start]) -> newton.Model:
    """A model with a world for each start, in which the robot is at its start."""
    # MuJoCo in C has one gravity, that of the model.
    worlds = newton.ModelBuilder(gravity=chosen[0].gravity)
    for start in chosen:
        worlds.begin_world()
        builder.gravity = start.gravity  # which the world takes over
        worlds.add_builder(builder)
        if not start.spin:
            worlds.add_shape_plane((0.0, 0.0, 1.0, -start.ground), width=0.0, length=0.0)
        if start.kind == "thrown":
            worlds.add_shape_plane((-1.0, 0.0, 0.0, start.wall), width=0.0, length=0.0)
        worlds.end_world()
    worlds.color()
    model = finalized(worlds, device="cpu")
    for array, values in (
        (model.joint_q, [start.joint_q for start in chosen]),
        (model.joint_qd, [start.joint_qd for start in chosen]),
    ):
        array.assign(np.array(values, np.float32).reshape(-1))
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    model.body_q.assign(state.body_q)
    model.body_qd.assign(state.body_qd)
    return model


def _pose(
    builder: newton.ModelBuilder,
    probe: Probe,
    state: newton.State,
    rng: np.random.Generator,
    reach: float,
) -> Array:
    """Random joint coordinates in which no two shapes overlap; puts them into ``state``."""
    first = np.array(builder.joint_q)
    lower, upper = _ranges(builder)
    turn = _random_turn(rng)
    for attempt in range(TRIES):
        share = reach * (1.0 - attempt / (TRIES - 1))
        q = first.copy()
        root = None
        for joint, kind in enumerate(builder.joint_type):
            at = builder.joint_q_start[joint]
            if kind == newton.JointType.BALL:
                q[at : at + 4] = _random_turn(rng, share)
            elif kind == newton.JointType.FREE and builder.joint_parent[joint] < 0:
                root = first[at : at + 3] if root is None else root
                q[at : at + 3] = root + rotate(turn, first[at : at + 3] - root)
                q[at + 3 : at + 7] = product(turn, first[at + 3 : at + 7])
            elif kind not in (*_LOOSE, newton.JointType.ROD):
                for i, dof in enumerate(dofs_of(builder, joint)):
                    low, high = lower[dof], upper[dof]
                    if low < high:
                        q[at + i] += share * (rng.uniform(low, high) - q[at + i])
        follow_leaders(builder, q, builder.joint_q_start, offset=True)
        state.joint_q.assign(q.astype(np.float32))
        newton.eval_fk(probe.model, state.joint_q, state.joint_qd, state)
        gaps = probe.contacts(state)[1]
        if np.min(gaps, initial=0.0) > -DEPTH:
            break
    return q


def _ranges(builder: newton.ModelBuilder) -> tuple[Array, Array]:
    """Lower and upper ends of what joints are moved to, where joints that mimic them can follow."""
    lower, upper = np.array(builder.joint_limit_lower), np.array(builder.joint_limit_upper)
    for joint, (linear, _angular) in enumerate(builder.joint_dof_dim):
        for i, dof in enumerate(dofs_of(builder, joint)):
            widest = 1.0 if i < linear else np.pi
            lower[dof], upper[dof] = max(lower[dof], -widest), min(upper[dof], widest)
    for joint, leader in reversed(list(enumerate(builder.joint_mimic_joint))):
        constant, factor = builder.joint_mimic_coeffs[joint]
        if leader < 0 or factor == 0.0:
            continue
        for led, of in zip(dofs_of(builder, joint), dofs_of(builder, leader), strict=False):
            ends = sorted((end - constant) / factor for end in (lower[led], upper[led]))
            lower[of], upper[of] = max(lower[of], ends[0]), min(upper[of], ends[1])
    return lower, upper


def _spins(builder: newton.ModelBuilder) -> Array:
    """Speed of each degree of freedom in a weightless start, relative to that of hinges."""
    speeds = np.zeros(builder.joint_dof_count)
    for joint, kind in enumerate(builder.joint_type):
        if kind not in (*_LOOSE, newton.JointType.ROD):
            for i, dof in enumerate(dofs_of(builder, joint)):
                speeds[dof] = ARM if i < builder.joint_dof_dim[joint][0] else 1.0
    return speeds


def _throw(builder: newton.ModelBuilder) -> Array:
    """Velocity of each degree of freedom that moves the roots along x at 1 m/s."""
    velocity = np.zeros(builder.joint_dof_count)
    for joint, parent in enumerate(builder.joint_parent):
        if parent >= 0:
            continue
        dof = builder.joint_qd_start[joint]
        if builder.joint_type[joint] == newton.JointType.FREE:
            velocity[dof] = 1.0
            continue
        frame = np.array(builder.joint_X_p[joint])[3:]
        for i in range(builder.joint_dof_dim[joint][0]):
            along = rotate(frame, np.array(builder.joint_axis[dof + i], float))[0]
            velocity[dof + i] = along if abs(along) > 0.99 else 0.0
    return velocity


def _foremost(model: newton.Model) -> float:
    """Upper bound of the x-coordinates of the colliding shapes of bodies [m]."""
    colliding = (model.shape_flags.numpy() & int(newton.ShapeFlags.COLLIDE_SHAPES)) != 0
    chosen = colliding & (model.shape_body.numpy() >= 0)
    if not chosen.any():
        centers = transform(model.body_q.numpy().astype(float), Bodies.of(model).com)
        return float(centers[:, 0].max())
    poses = model.body_q.numpy().astype(float)[model.shape_body.numpy()[chosen]]
    centers = transform(poses, model.shape_transform.numpy()[chosen, :3].astype(float))
    radius = model.shape_collision_radius.numpy()[chosen]
    return float(np.max(centers[:, 0] + radius))


def _random_turn(rng: np.random.Generator, share: float = 1.0) -> Array:
    """A random unit quaternion, or the same rotation about the same axis by a share of it."""
    q = rng.normal(size=4)
    q /= np.linalg.norm(q)
    angle = share * np.arccos(np.clip(abs(q[3]), 0.0, 1.0))
    axis = np.sign(q[3]) * q[:3] / max(float(np.linalg.norm(q[:3])), 1e-12)
    return np.append(np.sin(angle) * axis, np.cos(angle))
