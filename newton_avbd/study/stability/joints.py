# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Hard cases of joints: heavy ends, nets of loops, stiff beside soft, degenerate anchors.

Links of decimeters may open :data:`OPEN`, a thousandth of their length, where the joints are not in
a loop that a heavy load tears at; what swings freely gains less than a thousandth of the energy of
a fall by its own length.
"""

import math
from functools import partial

import newton
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.scenes.chains import add_chain
from newton_avbd.scenes.named import add_ground
from newton_avbd.study.stability.case import Bounds, Catalog, Trial
from newton_avbd.study.stability.piles import add_box, block

OPEN = 1e-4
"""Distance between the anchors of a joint [m]."""

WORLD = -1

JOINTS = Catalog()
"""Cases of joints by name."""


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: wp.quat | None = None) -> wp.transform:
    """A frame at a point [m]."""
    return wp.transform(wp.vec3(x, y, z), wp.quat_identity() if turn is None else turn)


def add_link(
    builder: newton.ModelBuilder,
    frame: wp.transform,
    size: tuple[float, float, float],
    *,
    collides: bool = False,
    density: float = 1000.0,
) -> int:
    """Add a box with full edges ``size`` [m] that joints are to hold."""
    cfg = block(builder, density=density)
    cfg.has_shape_collision = collides
    body = builder.add_link(xform=frame)
    hx, hy, hz = (0.5 * edge for edge in size)
    builder.add_shape_box(body, hx=hx, hy=hy, hz=hz, cfg=cfg)
    return body


Tie = tuple[int, int, wp.transform, wp.transform]
"""Parent, child, anchor in the parent, anchor in the child."""


def tie(builder: newton.ModelBuilder, ties: list[Tie]) -> None:
    """Tie bodies by ball joints.

    Those that are the first to hold their child make an articulation, the others close loops.
    """
    held: set[int] = set()
    tree: list[Tie] = []
    loops: list[Tie] = []
    for entry in ties:
        (loops if entry[1] in held else tree).append(entry)
        held.add(entry[1])
    builder.add_articulation([_ball(builder, *entry) for entry in tree])
    for entry in loops:
        _ball(builder, *entry)


def _ball(
    builder: newton.ModelBuilder, parent: int, child: int, hung: wp.transform, held: wp.transform
) -> int:
    return builder.add_joint_ball(parent, child, parent_xform=hung, child_xform=held)


for links, ratio in ((50, 200), (50, 50_000)):
    JOINTS.add(
        f"pendulum_{links}_{ratio}",
        f"{links} hinged links swing from the horizontal, end mass 1:{ratio:,}",
        partial(add_chain, links=links, end_ratio=ratio),
        Bounds(joint=OPEN, gain=1e-3 * 0.2 * links),
    )


@JOINTS.declare(
    "rope_bridge",
    "40 planks, two ball joints from each to the next, and 50 boxes that fall on them",
    Bounds(penetration=5e-3, joint=1e-3, gain=1e-3),
    is_quick=False,
)
def _(builder: newton.ModelBuilder) -> None:
    size, count, width = (0.5, 2.0, 0.1), 40, 0.8
    planks = [
        add_link(builder, at((i + 0.5) * size[0], 0.0, 5.0), size, collides=True)
        for i in range(count)
    ]
    ties = []
    for i in range(count + 1):
        for y in (-width, width):
            x = 0.5 * size[0]
            before = at(x, y) if i > 0 else at(0.0, y, 5.0)
            if i < count:
                ties.append((planks[i - 1] if i else WORLD, planks[i], before, at(-x, y)))
            else:
                ties.append((WORLD, planks[-1], at(count * size[0], y, 5.0), at(x, y)))
    tie(builder, ties)
    for i in range(50):
        x, layer = 5.0 + (i % 25) * 0.4, i // 25
        add_box(builder, (x, 0.0, 5.3 + 0.5 * layer), (0.3, 0.3, 0.3), density=500.0)


@JOINTS.declare(
    "chain_mail",
    "3 x 3 rings in 12 more, the outer ones held, catch a ball of 1,000 times a ring's mass",
    # Deeper than their own radius the rings would pass through each other.
    Bounds(penetration=0.01, gain=1e-3),
    seconds=2.0,
    is_quick=False,
)
def _(builder: newton.ModelBuilder) -> None:
    ring, tube, sides, pitch = 0.1, 0.01, 8, 0.26
    upright = {
        "x": wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), 0.5 * math.pi),
        "y": wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), 0.5 * math.pi),
    }

    def add_ring(x: float, y: float, turn: wp.quat | None, is_held: bool) -> int:
        body = builder.add_body(xform=at(x, y, 1.0, turn), is_kinematic=is_held)
        length = ring * math.sin(math.pi / sides)
        for i in range(sides):
            angle = 2.0 * math.pi * i / sides
            along = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), angle)
            lay = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), 0.5 * math.pi)
            apothem = ring * math.cos(math.pi / sides)
            frame = at(
                apothem * math.cos(angle), apothem * math.sin(angle), 0.0, wp.mul(along, lay)
            )
            cfg = block(builder, mu=0.3, gap=0.005)
            builder.add_shape_capsule(body, xform=frame, radius=tube, half_height=length, cfg=cfg)
        return body

    for i in range(3):
        for j in range(3):
            flat = add_ring((i - 1) * pitch, (j - 1) * pitch, None, is_held=(i, j) != (1, 1))
            if i < 2:
                add_ring((i - 0.5) * pitch, (j - 1) * pitch, upright["x"], is_held=False)
            if j < 2:
                add_ring((i - 1) * pitch, (j - 0.5) * pitch, upright["y"], is_held=False)
    radius = 0.25
    density = 1000.0 * builder.body_mass[flat] / (4.0 / 3.0 * math.pi * radius**3)
    ball = builder.add_body(xform=at(0.0, 0.0, 1.6))
    builder.add_shape_sphere(ball, radius=radius, cfg=block(builder, mu=0.3, density=density))


def add_grid(builder: newton.ModelBuilder, count: int, edge: float, boxes: int = 0) -> None:
    """Add boxes in a horizontal grid, tied to their neighbors, the corners to the world."""
    size, places = (0.8 * edge, 0.8 * edge, 0.2 * edge), range(count)
    body = [
        [add_link(builder, at(i * edge, j * edge, 5.0), size, collides=boxes > 0) for j in places]
        for i in places
    ]
    half, last = 0.5 * edge, count - 1
    ties = [(WORLD, body[0][0], at(0.0, 0.0, 5.0), at())]
    for i in range(count):
        for j in range(count):
            if i < last:
                ties.append((body[i][j], body[i + 1][j], at(half), at(-half)))
            if j < last:
                ties.append((body[i][j], body[i][j + 1], at(0.0, half), at(0.0, -half)))
    for i, j in ((0, last), (last, 0), (last, last)):
        ties.append((WORLD, body[i][j], at(i * edge, j * edge, 5.0), at()))
    tie(builder, ties)
    for k in range(boxes):
        x, y = (1.5 + k % 5) * edge, (1.5 + k // 5 % 5) * edge
        add_box(builder, (x, y, 5.2 + 0.3 * (k // 25)), (0.2, 0.2, 0.2), density=500.0)


JOINTS.add(
    "joint_grid_8",
    "8 x 8 boxes tied by 112 ball joints, hung up by their corners",
    partial(add_grid, count=8, edge=0.25),
    Bounds(joint=1e-3, gain=1e-3),
    is_quick=False,
)
JOINTS.add(
    "joint_grid_25",
    "25 x 25 boxes tied by 1,200 ball joints, hung up by their corners",
    partial(add_grid, count=25, edge=0.25),
    # it hardly falls: micrometers by which taut joints open are much beside that, and are closed
    Bounds(joint=1e-3, gain=1e-3, share=1e-2),
    is_quick=False,
)
JOINTS.add(
    "net",
    "8 x 8 tied boxes catch 50 more",
    partial(add_grid, count=8, edge=0.3, boxes=50),
    # as of the grid
    Bounds(penetration=5e-3, joint=1e-3, gain=1e-3, share=1e-2),
    is_quick=False,
)


def _stretched(trial: Trial) -> float:
    """Largest elongation of the stiff springs [m]: of every second link."""
    height = trial.centers()[:, 2]
    length = -np.diff(np.concatenate([[0.0], height]))
    return float(np.max(np.abs(length[1::2] - 0.4)))


@JOINTS.declare(
    "spring_ratio",
    "ten blocks of 1 kg hang on springs of 100 and, in turn, 1e9 N/m: 1:10,000,000",
    # 10 kg on the stiffest stretch it by 0.1 um; what is left is rounding, 4 m from the origin
    Bounds(joint=OPEN, gain=1e-3, drift=1e-5),
    drift=_stretched,
    stores=True,
)
def _(builder: newton.ModelBuilder) -> None:
    parent, joints = WORLD, []
    for i in range(10):
        block_ = add_link(builder, at(0.0, 0.0, -0.4 * (i + 1)), (0.1, 0.1, 0.1))
        hung = at(0.0, 0.0, -0.4)
        joints.append(
            builder.add_joint_prismatic(
                parent,
                block_,
                parent_xform=hung,
                axis=(0.0, 0.0, 1.0),
                target_ke=1e9 if i % 2 else 100.0,
                target_kd=1.0,
                target_q=0.0,
                actuator_mode=newton.JointTargetMode.POSITION,
            )
        )
        parent = block_
    builder.add_articulation(joints)


@JOINTS.declare(
    "motor_against_wall",
    "a motor of 20 rad/s and 50 N m at stall turns an arm of 1 kg against a wall",
    Bounds(penetration=1e-4, joint=OPEN),
    seconds=3.0,
)
def _(builder: newton.ModelBuilder) -> None:
    arm = add_link(
        builder, at(0.25, 0.0, 1.0), (0.5, 0.05, 0.05), collides=True, density=1.0 / (0.5 * 0.05**2)
    )
    hinge = builder.add_joint_revolute(
        WORLD,
        arm,
        parent_xform=at(0.0, 0.0, 1.0),
        child_xform=at(-0.25),
        axis=(0.0, 1.0, 0.0),
        target_kd=2.5,
        target_qd=20.0,
        actuator_mode=newton.JointTargetMode.VELOCITY,
    )
    builder.add_articulation([hinge])
    builder.add_shape_box(
        WORLD, xform=at(0.4, 0.0, 0.6), hx=0.05, hy=0.2, hz=0.2, cfg=block(builder)
    )


HIT = (0.0, 0.0, 0.525)
"""Where a ball is to hit the breakable wall, and how far it flies up to there [m]."""
FLIGHT = 0.6


def _astray(trial: Trial) -> float:
    """How far from the hit a joint broke [m].

    Infinite where one broke, or a brick moved by 0.1 mm, before the ball was half way.
    """
    broken = getattr(getattr(trial.solver, "status", None), "broken_joints", ())
    bricks = trial.model.joint_child.numpy()[list(broken)]
    if np.linalg.norm(trial.centers()[-1] - trial.start[-1]) < 0.5 * FLIGHT:
        moved = np.linalg.norm(trial.centers() - trial.start, axis=1)[:-1]
        return math.inf if len(broken) or np.max(moved) > 1e-4 else 0.0
    return float(np.max(np.linalg.norm(trial.start[bricks] - HIT, axis=1), initial=0.0))


@JOINTS.declare(
    "breakable_wall",
    "6 x 5 bricks of 16 kg tied by joints that break at 4 kN, hit by a ball of 20 kg at 6 m/s",
    # the joints of the two bricks that it hits, and of those around them
    Bounds(penetration=5e-3, gain=1e-3, drift=1.0),
    drift=_astray,
    seconds=2.0,
    speculative=0.1,
)
def _(builder: newton.ModelBuilder) -> None:
    SolverAVBD.register_custom_attributes(builder)
    add_ground(builder, mu=0.6, gap=0.02)
    length, height = 0.41, 0.21
    columns, rows = 6, 5
    bricks: list[list[int]] = []
    ties: list[Tie] = []
    loops: list[Tie] = []
    for row in range(rows):
        z = (row + 0.5) * height
        xs = [(column - 0.5 * (columns - 1)) * length for column in range(columns)]
        bricks.append(
            [add_link(builder, at(x, 0.0, z), (0.4, 0.2, 0.2), collides=True) for x in xs]
        )
        for column, brick in enumerate(bricks[row]):
            under = at(0.0, 0.0, -0.5 * height)
            if row == 0:
                ties.append((WORLD, brick, at(xs[column]), under))
            else:
                ties.append((bricks[row - 1][column], brick, at(0.0, 0.0, 0.5 * height), under))
            if column > 0:
                loops.append((bricks[row][column - 1], brick, at(0.5 * length), at(-0.5 * length)))

    def weld(tie: Tie) -> int:
        parent, child, hung, held = tie
        return builder.add_joint_fixed(
            parent,
            child,
            parent_xform=hung,
            child_xform=held,
            collision_filter_parent=False,
            custom_attributes={"avbd:joint_break_force": 4e3},
        )

    builder.add_articulation([weld(tie) for tie in ties])
    for tie in loops:
        weld(tie)
    ball = builder.add_body(xform=at(HIT[0], -0.2 - FLIGHT, HIT[2]))
    radius = 0.1
    density = 20.0 / (4.0 / 3.0 * math.pi * radius**3)
    builder.add_shape_sphere(ball, radius=radius, cfg=block(builder, density=density))
    builder.body_qd[ball] = wp.spatial_vector(0.0, 6.0, 0.0, 0.0, 0.0, 0.0)


@JOINTS.declare(
    "zero_length",
    "five bodies hang at one point: every joint of theirs has its anchors in both centers",
    Bounds(joint=OPEN, gain=1e-3),
)
def _(builder: newton.ModelBuilder) -> None:
    parent = WORLD
    ties: list[Tie] = []
    for _ in range(5):
        link = add_link(builder, at(0.0, 0.0, 1.0), (0.3, 0.2, 0.1))
        ties.append((parent, link, at() if ties else at(0.0, 0.0, 1.0), at()))
        builder.body_qd[link] = wp.spatial_vector(0.0, 0.0, 0.0, 1.0, 5.0, 1.0)
        parent = link
    tie(builder, ties)


@JOINTS.declare(
    "zero_distance",
    "a box hangs by a distance joint of length 0 from its center, another by one from its corner",
    Bounds(gain=1e-3, drift=1e-3),
    drift=lambda trial: float(np.linalg.norm(trial.centers()[0] - [0.0, 0.0, 1.0])),
)
def _(builder: newton.ModelBuilder) -> None:
    for i, corner in enumerate((at(), at(0.15, 0.1, 0.05))):
        body = add_box(builder, (float(i), 0.0, 1.0), (0.3, 0.2, 0.1))
        hung = at(*(np.array([i, 0.0, 1.0]) + np.array(corner[:3])))
        builder.add_joint_distance(
            WORLD, body, parent_xform=hung, child_xform=corner, min_distance=0.0, max_distance=0.0
        )


@JOINTS.declare(
    "collinear_anchors",
    "a plank on five ball joints in one line: redundant, and free to turn about that line",
    Bounds(joint=OPEN, gain=1e-3),
)
def _(builder: newton.ModelBuilder) -> None:
    plank = add_link(builder, at(0.0, 0.25, 1.0), (2.0, 0.5, 0.05))
    tie(
        builder,
        [(WORLD, plank, at(x, 0.0, 1.0), at(x, -0.25)) for x in (-1.0, -0.5, 0.0, 0.5, 1.0)],
    )


@JOINTS.declare(
    "singular_d6",
    "a body swings on three turning axes through a pitch of 90 degrees, where two of them coincide",
    Bounds(joint=OPEN, gain=1e-3),
    stores=True,
)
def _(builder: newton.ModelBuilder) -> None:
    turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), 0.5 * math.pi)
    arm = wp.vec3(0.3, 0.1, 0.0)
    body = add_link(
        builder,
        wp.transform(wp.vec3(0.0, 0.0, 1.0) + wp.quat_rotate(turn, arm), turn),
        (0.6, 0.2, 0.1),
    )
    axis = newton.ModelBuilder.JointDofConfig
    # driven, so that the coordinates matter
    joint = builder.add_joint_d6(
        WORLD,
        body,
        angular_axes=[
            axis(axis="X"),
            # where the other two are no coordinates, a spring on them would have no energy
            axis(axis="Y", target_q=0.5 * math.pi, target_ke=5.0, target_kd=0.1),
            axis(axis="Z"),
        ],
        parent_xform=at(0.0, 0.0, 1.0),
        child_xform=wp.transform(-arm, wp.quat_identity()),
    )
    builder.joint_q[-3:] = [0.0, 0.5 * math.pi, 0.0]
    builder.add_articulation([joint])
    # of the center of mass
    spin = np.array([1.0, 0.5, 2.0])
    linear = np.cross(spin, np.array(wp.quat_rotate(turn, arm)))
    builder.body_qd[body] = wp.spatial_vector(*map(float, linear), *map(float, spin))


@JOINTS.declare(
    "ground_chain",
    "20 links with an end of 10,000 times their mass fall on the ground",
    Bounds(penetration=1e-3, joint=1e-3, gain=2e-3),
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.5, gap=0.02)
    ties, parent = [], -1
    for i in range(20):
        link = add_link(
            builder,
            at(0.2 * i, 0.0, 1.0),
            (0.16, 0.1, 0.05),
            collides=True,
            density=1e7 if i == 19 else 1000.0,
        )
        if i == 0:
            joints = [builder.add_joint_free(link)]
        else:
            ties.append(_ball(builder, parent, link, at(0.1), at(-0.1)))
        parent = link
    builder.add_articulation(joints + ties)
