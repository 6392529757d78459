# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Drag of a fluid on bodies (:mod:`.step.drag`): the sum over their links.

Each link of a welded body has its own box, at its own place.
"""

import warp as wp

from ..algebra.so3 import world_inertia
from ..data import BodyModel, Drag, FluidBox, LinkModel
from ..rows import fluid as law
from .kernels import KERNEL

MOST_TURNS = wp.constant(50)
"""Most rotations of Jacobi's method; a tensor takes some five."""
DIAGONAL = wp.constant(wp.float64(1.0e-12))
"""Moment off the diagonal [kg m^2], and what the cosine of a turn lacks of 1, that count as none.
MuJoCo's numbers: of equal moments, they decide which axes a box has."""
LEAST_MASS = wp.constant(1.0e-15)
"""Mass of a link below which it feels nothing [kg], as in MuJoCo."""


@wp.func
def jacobi_turn(tensor: wp.mat33d, a: int, b: int) -> wp.mat33d:
    """Turn in the plane of two axes that makes their product of inertia vanish."""
    one = wp.float64(1.0)
    turn = wp.identity(n=3, dtype=wp.float64)
    if wp.abs(tensor[a, b]) < DIAGONAL:
        return turn
    tau = (tensor[b, b] - tensor[a, a]) / (wp.float64(2.0) * tensor[a, b])
    size = one / (wp.abs(tau) + wp.sqrt(one + tau * tau))
    t = wp.where(tau >= wp.float64(0.0), size, -size)
    c = one / wp.sqrt(one + t * t)
    if c > one - DIAGONAL:
        return turn
    turn[a, a] = c
    turn[b, b] = c
    turn[a, b] = t * c
    turn[b, a] = -t * c
    return turn


@wp.func
def principal_axes(inertia: wp.mat33) -> wp.mat33:
    """Principal axes of an inertia tensor as the columns of a rotation, by Jacobi's method."""
    start = wp.mat33d(inertia)
    axes = wp.identity(n=3, dtype=wp.float64)
    for _ in range(MOST_TURNS):
        tensor = wp.transpose(axes) * start * axes
        xy = wp.abs(tensor[0, 1])
        xz = wp.abs(tensor[0, 2])
        yz = wp.abs(tensor[1, 2])
        a = int(1)
        b = int(2)
        if xy > xz and xy > yz:
            a = 0
            b = 1
        elif xz > yz:
            a = 0
        turn = jacobi_turn(tensor, a, b)
        axes = axes * turn
        if turn[a, b] == wp.float64(0.0):
            break
    return wp.mat33(axes)


@wp.kernel(**KERNEL)
def find_boxes(
    # Model:
    links: LinkModel,
    mass: wp.array[float],
    inertia: wp.array[wp.mat33],
    # In:
    link_of: wp.array[wp.int32],
    # Model out:
    boxes: wp.array[FluidBox],
):
    """Boxes of equal inertia, in the frames of the solver's bodies; one thread a box."""
    i = wp.tid()
    link = link_of[i]
    box = FluidBox()
    if mass[link] >= LEAST_MASS:
        axes = principal_axes(inertia[link])
        moments = wp.get_diag(wp.transpose(axes) * inertia[link] * axes)
        box.edges = law.box_edges(mass[link], moments)
        box.axes = axes
        if links.frame.shape[0] > 0:
            turn = wp.quat_to_matrix(wp.transform_get_rotation(links.frame[link]))
            box.axes = turn * axes
            box.arm = links.arm[link]
            body = links.body[link]
            if body >= 0:
                if links.leader[body] == link:
                    box.axes = axes
    boxes[i] = box


@wp.func
def add_axis(
    drag: Drag,
    coefficients: wp.vec2,
    along: wp.vec3,
    about: wp.vec3,
    start: wp.spatial_vector,
    free: wp.spatial_vector,
    mobility: wp.vec2,
    inv_inertia: wp.mat33,
    wind: float,
) -> Drag:
    """Adds the drag against one speed, along.v + about.w - wind, all in body axes.

    ``start`` and ``free`` are velocities of the COM [m/s, rad/s], at the start of the step and at
    its end without drag; ``mobility`` is step/mass [s/kg] and step [s].
    """
    u = wp.dot(along, wp.spatial_top(start)) + wp.dot(about, wp.spatial_bottom(start)) - wind
    goal = wp.dot(along, wp.spatial_top(free)) + wp.dot(about, wp.spatial_bottom(free)) - wind
    moved = mobility[0] * wp.dot(along, along) + mobility[1] * wp.dot(about, inv_inertia * about)
    slope = law.chord_slope(coefficients, u, law.slowed(coefficients, goal, moved))
    push = slope * (u + wind) - law.drag_of(coefficients, u)
    drag.ll += slope * wp.outer(along, along)
    drag.al += slope * wp.outer(about, along)
    drag.aa += slope * wp.outer(about, about)
    drag.push += push * wp.spatial_vector(along, about)
    return drag


@wp.func
def body_axes(rotation: wp.quat, velocity: wp.spatial_vector) -> wp.spatial_vector:
    """A velocity in the axes of the body."""
    return wp.spatial_vector(
        wp.quat_rotate_inv(rotation, wp.spatial_top(velocity)),
        wp.quat_rotate_inv(rotation, wp.spatial_bottom(velocity)),
    )


@wp.func
def fluid_drag(
    body: int,
    rotation: wp.quat,
    velocity: wp.spatial_vector,
    free_velocity: wp.spatial_vector,
    step: float,
    model: wp.ref[BodyModel],
) -> Drag:
    """Drag on a body [N, N m] about its COM, world axes: the sum over its links.

    Args:
        body: The body.
        rotation: Its orientation, at which the drag is taken.
        velocity: Velocity at the start of the step [m/s, rad/s].
        free_velocity: Velocity at its end without the drag.
        step: The step that inertia sees [s].
        model: The bodies and the fluid.
    """
    drag = Drag()
    world = wp.max(model.world[body], 0)
    density = model.fluid.density[world]
    viscosity = model.fluid.viscosity[world]
    wind = wp.quat_rotate_inv(rotation, model.fluid.wind[world])
    start = body_axes(rotation, velocity)
    free = body_axes(rotation, free_velocity)
    inv_inertia = model.inv_inertia[body]
    mobility = wp.vec2(step * model.inv_mass[body], step)
    for k in range(model.fluid.box_start[body], model.fluid.box_start[body + 1]):
        box = model.fluid.boxes[k]
        for axis in range(3):
            along = wp.vec3(box.axes[0, axis], box.axes[1, axis], box.axes[2, axis])
            drag = add_axis(
                drag,
                law.force_coefficients(box.edges, axis, density, viscosity),
                along,
                wp.cross(box.arm, along),
                start,
                free,
                mobility,
                inv_inertia,
                wp.dot(along, wind),
            )
            drag = add_axis(
                drag,
                law.torque_coefficients(box.edges, axis, density, viscosity),
                wp.vec3(0.0),
                along,
                start,
                free,
                mobility,
                inv_inertia,
                0.0,
            )
    drag.ll = world_inertia(rotation, drag.ll)
    drag.al = world_inertia(rotation, drag.al)
    drag.aa = world_inertia(rotation, drag.aa)
    drag.push = wp.spatial_vector(
        wp.quat_rotate(rotation, wp.spatial_top(drag.push)),
        wp.quat_rotate(rotation, wp.spatial_bottom(drag.push)),
    )
    return drag
