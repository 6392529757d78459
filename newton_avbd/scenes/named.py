# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Named scenes of free rigid bodies, most of them in contact, and the table of all scenes.

Each ``add_*`` function puts bodies into a :class:`newton.ModelBuilder`, Z up, SI units, and
takes its surface material (``ke``, ``kd``, ...) from ``builder.default_shape_cfg``; friction and
density are set here. Bodies that rest on each other are placed exactly touching. ``SCENES`` names
complete scenes, ready to build.
"""

import math
from collections.abc import Iterable
from functools import partial

import newton
import numpy as np
import warp as wp

from newton_avbd.scenes.chains import CHAINS
from newton_avbd.scenes.robots import ROBOTS
from newton_avbd.scenes.scene import FRAMES_PER_SECOND, Scene

__all__ = ["FRAMES_PER_SECOND", "SCENES", "Scene"]


def _shape(
    builder: newton.ModelBuilder, *, density: float, mu: float, gap: float | None = None
) -> newton.ModelBuilder.ShapeConfig:
    """Surface and mass of a shape: density [kg/m^3], friction, contact detection gap [m]."""
    cfg = builder.default_shape_cfg.copy()
    cfg.density, cfg.mu, cfg.gap = density, mu, gap
    return cfg


def _add_box(
    builder: newton.ModelBuilder,
    position: Iterable[float],
    size: tuple[float, float, float],
    cfg: newton.ModelBuilder.ShapeConfig,
    rotation: wp.quat | None = None,
) -> int:
    """Add a free box with full edge lengths ``size`` [m], centred at ``position`` [m]."""
    rotation = wp.quat_identity() if rotation is None else rotation
    body = builder.add_body(xform=wp.transform(wp.vec3(*position), rotation))
    builder.add_shape_box(body, hx=0.5 * size[0], hy=0.5 * size[1], hz=0.5 * size[2], cfg=cfg)
    return body


def set_velocity(
    builder: newton.ModelBuilder,
    body: int,
    linear: tuple[float, float, float] = (0.0, 0.0, 0.0),
    angular: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """Set the start velocity of a free body in both of Newton's descriptions of it.

    Args:
        builder: Builder that holds the body.
        body: Index of a body added with ``builder.add_body``.
        linear: Velocity of the center of mass, world frame [m/s].
        angular: Angular velocity, world frame [rad/s].
    """
    builder.body_qd[body] = wp.spatial_vector(*linear, *angular)
    start = builder.joint_qd_start[builder.joint_child.index(body)]
    builder.joint_qd[start : start + 6] = [*linear, *angular]


def add_ground(builder: newton.ModelBuilder, *, mu: float = 0.5, gap: float | None = None) -> None:
    """Add the plane z = 0 with friction coefficient ``mu`` and detection gap [m]."""
    builder.add_ground_plane(cfg=_shape(builder, density=0.0, mu=mu, gap=gap))


def add_pyramid(
    builder: newton.ModelBuilder,
    rows: int = 10,
    edge: float = 0.8,
    density: float = 1000.0,
    mu: float = 0.5,
) -> None:
    """Add an upright pyramid of cubes and the ground under it.

    Neighbors in a row are edge/20 apart: near enough to be reported as contacts, four each, that
    carry nothing. A pyramid of n rows so has 4 n + 6 n (n - 1) contacts, 580 for ten rows.

    Args:
        builder: Builder to add to.
        rows: Boxes in the bottom row.
        edge: Edge of a box [m]; also scales the contact detection gap, 0.1 m at 0.8 m.
        density: Mass density [kg/m^3].
        mu: Coefficient of friction.
    """
    cfg = _shape(builder, density=density, mu=mu, gap=edge / 8.0)
    add_ground(builder, mu=mu, gap=edge / 8.0)
    pitch = 1.05 * edge
    for row in range(rows):
        count = rows - row
        for i in range(count):
            position = ((i - 0.5 * (count - 1)) * pitch, 0.0, (row + 0.5) * edge)
            _add_box(builder, position, (edge, edge, edge), cfg)


def add_stack(
    builder: newton.ModelBuilder,
    count: int = 20,
    edge: float = 0.5,
    densities: tuple[float, ...] = (1000.0,),
    mu: float = 0.5,
) -> None:
    """Add a column of cubes and the ground under it, four contacts a cube.

    Args:
        builder: Builder to add to.
        count: Number of cubes.
        edge: Edge of a cube [m]; also scales the contact detection gap.
        densities: Mass densities [kg/m^3] from the bottom up, repeated as often as needed.
        mu: Coefficient of friction.
    """
    add_ground(builder, mu=mu, gap=edge / 8.0)
    for i in range(count):
        cfg = _shape(builder, density=densities[i % len(densities)], mu=mu, gap=edge / 8.0)
        _add_box(builder, (0.0, 0.0, (i + 0.5) * edge), (edge, edge, edge), cfg)


def add_wall(
    builder: newton.ModelBuilder, rows: int = 6, columns: int = 6, density: float = 1000.0
) -> None:
    """Add a brick wall in running bond on the ground, bricks 0.4 x 0.2 x 0.2 m, 5 mm joints."""
    cfg = _shape(builder, density=density, mu=0.6, gap=0.02)
    add_ground(builder, mu=0.6, gap=0.02)
    length, height = 0.4, 0.2
    pitch = length + 0.005
    for row in range(rows):
        z = (row + 0.5) * height
        odd = row % 2
        for i in range(columns - odd):
            x = (i - 0.5 * (columns - 1 - odd)) * pitch
            _add_box(builder, (x, 0.0, z), (length, 0.2, height), cfg)
        if odd:
            # half bricks close the row: a whole one would stand on the edge below it
            x = 0.5 * (columns * pitch - 0.005 - 0.5 * length)
            for end in (-x, x):
                _add_box(builder, (end, 0.0, z), (0.5 * length, 0.2, height), cfg)


def add_brick_ring(builder: newton.ModelBuilder, bricks: int = 1000) -> None:
    """Add a round wall in running bond on the ground, of about so many bricks, ten times as many in
    a course as there are courses; bricks 0.4 x 0.2 x 0.2 m, 5 mm apart where they are nearest.

    The scene of "Augmented Vertex Block Descent" (Giles, Diaz, Yuksel, 2025) has 110,000.
    """
    cfg = _shape(builder, density=1000.0, mu=0.6, gap=0.01)
    add_ground(builder, mu=0.6, gap=0.01)
    length, width, height = 0.4, 0.2, 0.2
    courses = max(1, round(math.sqrt(bricks / 10.0)))
    count = max(8, round(bricks / courses))
    radius = 0.5 * (length + 0.005) / math.tan(math.pi / count) + 0.5 * width
    # a course is built once: Newton takes 1.4 ms to add a brick
    one = newton.ModelBuilder()
    up = wp.vec3(0.0, 0.0, 1.0)
    for i in range(count):
        angle = 2.0 * math.pi * i / count
        position = (radius * math.cos(angle), radius * math.sin(angle), 0.5 * height)
        _add_box(one, position, (width, length, height), cfg, wp.quat_from_axis_angle(up, angle))
    for course in range(courses):
        turn = wp.quat_from_axis_angle(up, math.pi * (course % 2) / count)
        builder.add_builder(one, wp.transform(wp.vec3(0.0, 0.0, course * height), turn))


def add_sphere_heap(builder: newton.ModelBuilder, spheres: int = 1000, seed: int = 7) -> None:
    """Add spheres of 8 to 12 cm in a loose cube of layers that falls into a heap."""
    cfg = _shape(builder, density=1000.0, mu=0.5, gap=0.01)
    add_ground(builder, mu=0.5, gap=0.01)
    rng = np.random.default_rng(seed)
    side = max(1, round(spheres ** (1.0 / 3.0)))
    pitch = 0.25
    for i in range(spheres):
        cell = np.array([i % side, i // side % side, i // side**2 + 0.5])
        place = pitch * cell + rng.uniform(-0.02, 0.02, 3)
        body = builder.add_body(xform=wp.transform(wp.vec3(*place), wp.quat_identity()))
        builder.add_shape_sphere(body, radius=rng.uniform(0.08, 0.12), cfg=cfg)


def add_ragdoll(
    builder: newton.ModelBuilder,
    place: Iterable[float],
    rotation: wp.quat | None = None,
    stiffness: float = 20.0,
) -> list[int]:
    """Add a torso with two arms and two legs on hinges that drives hold straight.

    Args:
        builder: Builder to add to.
        place: Center of the torso [m].
        rotation: Orientation of the torso.
        stiffness: Of the drives [N m/rad].

    Returns:
        The torso and its four limbs.
    """
    cfg = _shape(builder, density=1000.0, mu=0.5, gap=0.01)
    rotation = wp.quat_identity() if rotation is None else rotation
    root = wp.transform(wp.vec3(*place), rotation)
    torso = builder.add_link(xform=root)
    builder.add_shape_box(torso, hx=0.1, hy=0.15, hz=0.25, cfg=cfg)
    bodies, joints = [torso], [builder.add_joint_free(torso)]
    first = builder.joint_q_start[joints[0]]
    builder.joint_q[first : first + 7] = list(root)
    for y, z in ((0.23, 0.22), (-0.23, 0.22), (0.09, -0.28), (-0.09, -0.28)):
        at = wp.transform(wp.vec3(0.0, y, z), wp.quat_identity())
        top = wp.transform(wp.vec3(0.0, 0.0, 0.2), wp.quat_identity())
        limb = builder.add_link(xform=root * at * wp.transform_inverse(top))
        builder.add_shape_capsule(limb, radius=0.06, half_height=0.14, cfg=cfg)
        joints.append(
            builder.add_joint_revolute(
                torso,
                limb,
                parent_xform=at,
                child_xform=top,
                axis=(0.0, 1.0, 0.0),
                target_ke=stiffness,
                target_kd=0.1 * stiffness,
                limit_lower=-1.5,
                limit_upper=1.5,
            )
        )
        bodies.append(limb)
    builder.add_articulation(joints)
    return bodies


def add_ragdoll_heap(builder: newton.ModelBuilder, ragdolls: int = 200, seed: int = 11) -> None:
    """Add ragdolls of five bodies in a loose cube of layers that falls into a heap."""
    add_ground(builder, mu=0.5, gap=0.01)
    rng = np.random.default_rng(seed)
    side = max(1, round(ragdolls ** (1.0 / 3.0)))
    for i in range(ragdolls):
        cell = np.array([i % side, i // side % side, i // side**2 + 0.6])
        turn = rng.normal(size=4)
        rotation = wp.quat(*(turn / np.linalg.norm(turn)).tolist())
        add_ragdoll(builder, 1.2 * cell + rng.uniform(-0.05, 0.05, 3), rotation)


def add_net(builder: newton.ModelBuilder, bodies: int = 1000) -> None:
    """Add a net of small spheres on strings, held at its rim, and spheres that fall into it."""
    cfg = _shape(builder, density=1000.0, mu=0.5, gap=0.01)
    side = max(3, round(math.sqrt(0.9 * bodies)))
    pitch, radius = 0.12, 0.03
    knots = {}
    for i in range(side):
        for j in range(side):
            place = wp.transform(wp.vec3(pitch * i, pitch * j, 1.0), wp.quat_identity())
            is_rim = i in (0, side - 1) or j in (0, side - 1)
            knots[i, j] = knot = builder.add_body(xform=place, is_kinematic=is_rim)
            builder.add_shape_sphere(knot, radius=radius, cfg=cfg)
            for before in (knots.get((i - 1, j)), knots.get((i, j - 1))):
                if before is not None:
                    builder.add_joint_distance(before, knot, max_distance=pitch)
    across = max(1, round(math.sqrt(0.1 * bodies)))
    for i in range(across):
        for j in range(across):
            place = (0.5 * pitch * (side - 1)) + 0.3 * np.array([i, j]) - 0.15 * (across - 1)
            body = builder.add_body(xform=wp.transform(wp.vec3(*place, 1.3), wp.quat_identity()))
            builder.add_shape_sphere(body, radius=0.1, cfg=cfg)


def add_card_house(
    builder: newton.ModelBuilder, levels: int = 3, lean: float = math.radians(20.0)
) -> None:
    """Add a house of thick cards, leaning pairs with flat cards between the levels.

    Args:
        builder: Builder to add to.
        levels: Levels of leaning pairs; the bottom one has as many pairs.
        lean: Angle of the leaning cards to the vertical [rad].
    """
    cfg = _shape(builder, density=500.0, mu=0.8, gap=0.02)
    add_ground(builder, mu=0.8, gap=0.02)
    length, width, thick = 1.0, 0.6, 0.05
    run, rise = length * math.sin(lean), length * math.cos(lean)
    side, lift = thick * math.cos(lean), thick * math.sin(lean)
    # Feet of neighboring pairs keep a thickness apart; flat cards end a thickness short.
    pitch = 2.0 * (run + side) + thick
    height = rise + lift
    for level in range(levels):
        pairs = levels - level
        base = level * (height + thick)
        for i in range(pairs):
            apex = (i - 0.5 * (pairs - 1)) * pitch
            for sign in (-1.0, 1.0):
                x = apex + sign * 0.5 * (run + side)
                turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), -sign * lean)
                _add_box(builder, (x, 0.0, base + 0.5 * height), (thick, width, length), cfg, turn)
        for i in range(pairs - 1):
            position = ((i - 0.5 * (pairs - 2)) * pitch, 0.0, base + height + 0.5 * thick)
            _add_box(builder, position, (pitch - 0.5 * thick, width, thick), cfg)


def add_dominoes(builder: newton.ModelBuilder, count: int = 20, push: float = 3.0) -> None:
    """Add a row of dominoes on the ground, the first one tipping at ``push`` [rad/s]."""
    cfg = _shape(builder, density=800.0, mu=0.4, gap=0.02)
    add_ground(builder, mu=0.4, gap=0.02)
    height = 0.5
    for i in range(count):
        body = _add_box(builder, (0.25 * i, 0.0, 0.5 * height), (0.08, 0.25, height), cfg)
        if i == 0:
            # Turning about its front bottom edge: v = omega x r of the center about that edge.
            linear = (push * 0.5 * height, 0.0, push * 0.04)
            set_velocity(builder, body, linear, (0.0, push, 0.0))


def add_spheres(
    builder: newton.ModelBuilder, count: int = 64, radius: float = 0.15, seed: int = 7
) -> None:
    """Add spheres in loose layers above the floor of a bin with four fixed walls.

    Args:
        builder: Builder to add to.
        count: Number of spheres, in layers of 4 x 4.
        radius: Radius of a sphere [m].
        seed: Seed of the horizontal scatter.
    """
    cfg = _shape(builder, density=1000.0, mu=0.4, gap=0.02)
    add_ground(builder, mu=0.4, gap=0.02)
    half, height, thick = 4.5 * radius, 12.0 * radius, radius
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        builder.add_shape_box(
            -1,
            xform=wp.transform(
                wp.vec3(x * (half + thick), y * (half + thick), height), wp.quat_identity()
            ),
            hx=thick if x else half,
            hy=thick if y else half,
            hz=height,
            cfg=cfg,
        )
    scatter = np.random.default_rng(seed).uniform(-0.05, 0.05, size=(count, 2)) * radius
    for i in range(count):
        layer, row, column = i // 16, i // 4 % 4, i % 4
        x = (column - 1.5) * 2.15 * radius + scatter[i, 0]
        y = (row - 1.5) * 2.15 * radius + scatter[i, 1]
        z = radius + layer * 2.2 * radius
        body = builder.add_body(xform=wp.transform(wp.vec3(x, y, z), wp.quat_identity()))
        builder.add_shape_sphere(body, radius=radius, cfg=cfg)


def add_falling(builder: newton.ModelBuilder, height: float = 1.0) -> None:
    """Add a box, a sphere, a capsule and a cylinder, tilted, ``height`` [m] above the ground."""
    cfg = _shape(builder, density=1000.0, mu=0.5)
    add_ground(builder, mu=0.5)
    tilt = wp.quat_from_axis_angle(wp.normalize(wp.vec3(1.0, 2.0, 0.5)), 0.6)
    bodies = [
        builder.add_body(xform=wp.transform(wp.vec3(1.2 * (i - 1.5), 0.0, height), tilt))
        for i in range(4)
    ]
    builder.add_shape_box(bodies[0], hx=0.3, hy=0.2, hz=0.15, cfg=cfg)
    builder.add_shape_sphere(bodies[1], radius=0.25, cfg=cfg)
    builder.add_shape_capsule(bodies[2], radius=0.15, half_height=0.25, cfg=cfg)
    builder.add_shape_cylinder(bodies[3], radius=0.2, half_height=0.25, cfg=cfg)


def add_incline(
    builder: newton.ModelBuilder,
    angle: float = math.radians(20.0),
    mu: float = 0.3,
    edge: float = 0.5,
) -> None:
    """Add a plane through the origin that falls towards +x, and a cube resting on it.

    Args:
        builder: Builder to add to.
        angle: Slope [rad]; the cube sticks below ``atan(mu)``.
        mu: Coefficient of friction of both.
        edge: Edge of the cube [m].
    """
    slope = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), angle)
    cfg = _shape(builder, density=1000.0, mu=mu)
    builder.add_shape_plane(
        xform=wp.transform(wp.vec3(), slope),
        width=0.0,
        length=0.0,
        cfg=_shape(builder, density=0.0, mu=mu),
    )
    position = (0.5 * edge * math.sin(angle), 0.0, 0.5 * edge * math.cos(angle))
    _add_box(builder, position, (edge, edge, edge), cfg, slope)


def add_free_bodies(builder: newton.ModelBuilder, count: int = 64, seed: int = 11) -> None:
    """Add boxes of mixed mass and inertia, moving and turning, that never collide.

    Gravity is off, so nothing acts on them.

    Args:
        builder: Builder to add to.
        count: Number of bodies.
        seed: Seed of sizes [0.1 to 0.6 m], densities [10 to 10,000 kg/m^3] and velocities.
    """
    builder.gravity = (0.0, 0.0, 0.0)
    rng = np.random.default_rng(seed)
    for i in range(count):
        cfg = _shape(builder, density=float(10.0 ** rng.uniform(1.0, 4.0)), mu=0.5)
        cfg.has_shape_collision = False
        cfg.has_particle_collision = False
        size = rng.uniform(0.1, 0.6, size=3)
        position = (i % 8, i // 8 % 8, i // 64 + 1)
        body = _add_box(builder, position, (size[0], size[1], size[2]), cfg)
        linear, angular = rng.uniform(-1.0, 1.0, size=(2, 3)) * [[0.3], [5.0]]
        set_velocity(builder, body, tuple(linear), tuple(angular))


def add_top(builder: newton.ModelBuilder, spin: float = 10.0) -> None:
    """Add a body with three different principal moments, spinning about the middle one.

    The spin about the middle axis is unstable: the body flips over again and again
    (Dzhanibekov effect). Gravity is off.

    Args:
        builder: Builder to add to.
        spin: Angular speed [rad/s]; a hundredth of it about another axis starts the flips.
    """
    builder.gravity = (0.0, 0.0, 0.0)
    cfg = _shape(builder, density=1000.0, mu=0.5)
    body = _add_box(builder, (0.0, 0.0, 1.0), (0.6, 0.3, 0.1), cfg)
    set_velocity(builder, body, angular=(0.01 * spin, spin, 0.0))


def add_pyramid_worlds(builder: newton.ModelBuilder, worlds: int = 64) -> None:
    """Add worlds with a pyramid of 10 boxes in each."""
    world = newton.ModelBuilder()
    world.default_shape_cfg = builder.default_shape_cfg
    add_pyramid(world, rows=4)
    builder.replicate(world, worlds)


SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        Scene("pyramid", "55 boxes in a pyramid of 10 rows", add_pyramid, vbd_ke=4e6),
        Scene("stack", "a column of 20 boxes", add_stack, frames=600, vbd_ke=1e8),
        Scene(
            "pyramid_worlds",
            "64 worlds, a pyramid of 10 boxes in each",
            add_pyramid_worlds,
            vbd_ke=4e6,
        ),
        Scene("free_bodies", "64 free bodies on which nothing acts", add_free_bodies),
        Scene("fall", "four tilted shapes fall to the ground", add_falling, vbd_ke=1e8),
        Scene(
            "incline", "a box slides down a slope above its friction angle", add_incline, vbd_ke=1e8
        ),
        Scene("spheres", "64 spheres fall into a bin", add_spheres, vbd_ke=1e6),
        Scene("domino", "a row of 20 dominoes topples", add_dominoes, vbd_ke=1e6),
        Scene("wall", "a brick wall stands", add_wall, vbd_ke=1e5),
        Scene("card_house", "a house of cards on three levels stands", add_card_house, vbd_ke=1e5),
        Scene(
            "heavy_on_light",
            "a box carries one of 1,000 times its mass",
            partial(add_stack, count=2, densities=(10.0, 10000.0)),
            vbd_ke=1e6,
        ),
        Scene("top", "a body spins about its middle axis and flips", add_top),
        *CHAINS,
        *ROBOTS,
    )
}
"""The scenes by name."""
