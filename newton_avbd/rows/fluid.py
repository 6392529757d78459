# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Drag of a fluid on a link, by MuJoCo's inertia-box model.

The box is the one of equal mass and inertia, with edges a_i along the principal axes. At the
velocity u of its center against the fluid and its angular velocity w, both along these axes,

    F_i = -1/2 density a_j a_k |u_i| u_i - 3 pi d viscosity u_i
    T_i = -1/64 density a_i (a_j^4 + a_k^4) |w_i| w_i - pi d^3 viscosity w_i

with d the mean of the edges (MuJoCo, "Computation", passive forces, inertia model).

The force of a step is linear in the velocity at its end: the chord of the law from the velocity at
the start of the step to that which the drag alone would leave. A body that nothing else holds ends
where backward Euler takes it. The slope of a chord is positive, whatever the density and step, so
that the step is stable without a condition; and at rest against other forces, the law holds as it
stands.
"""

import warp as wp


@wp.func
def box_edges(mass: float, moments: wp.vec3) -> wp.vec3:
    """Edges of the box of this mass and these principal moments of inertia [m]."""
    total = moments[0] + moments[1] + moments[2]
    squares = wp.vec3(0.0)
    for i in range(3):
        squares[i] = wp.max(total - 2.0 * moments[i], 0.0) * (6.0 / mass)
    return wp.vec3(wp.sqrt(squares[0]), wp.sqrt(squares[1]), wp.sqrt(squares[2]))


@wp.func
def force_coefficients(edges: wp.vec3, axis: int, density: float, viscosity: float) -> wp.vec2:
    """Factors of |u| u [kg/m] and of u [kg/s] in the force along an axis."""
    other = edges[(axis + 1) % 3] * edges[(axis + 2) % 3]
    mean = (edges[0] + edges[1] + edges[2]) / 3.0
    return wp.vec2(0.5 * density * other, 3.0 * wp.pi * mean * viscosity)


@wp.func
def torque_coefficients(edges: wp.vec3, axis: int, density: float, viscosity: float) -> wp.vec2:
    """Factors of |w| w [kg m^2] and of w [kg m^2/s] in the torque about an axis."""
    b = edges[(axis + 1) % 3] * edges[(axis + 1) % 3]
    c = edges[(axis + 2) % 3] * edges[(axis + 2) % 3]
    mean = (edges[0] + edges[1] + edges[2]) / 3.0
    return wp.vec2(
        density * edges[axis] * (b * b + c * c) / 64.0, wp.pi * mean * mean * mean * viscosity
    )


@wp.func
def drag_of(coefficients: wp.vec2, u: float) -> float:
    """Force against the motion at the speed ``u`` [N or N m]."""
    return (coefficients[0] * wp.abs(u) + coefficients[1]) * u


@wp.func
def slowed(coefficients: wp.vec2, free: float, mobility: float) -> float:
    """Speed that the drag leaves of the one without it, by backward Euler.

    Args:
        coefficients: Of the drag.
        free: Speed at the end of the step without drag [m/s or rad/s].
        mobility: What a unit force adds to the speed in the step [s/kg or s/(kg m^2)].
    """
    b = 1.0 + mobility * coefficients[1]
    return 2.0 * free / (b + wp.sqrt(b * b + 4.0 * mobility * coefficients[0] * wp.abs(free)))


@wp.func
def chord_slope(coefficients: wp.vec2, start: float, end: float) -> float:
    """Slope of the drag between two speeds [N s/m or N m s/rad]."""
    size = wp.abs(start) + wp.abs(end)
    if start * end < 0.0:
        size = (start * start + end * end) / size
    return coefficients[0] * size + coefficients[1]
