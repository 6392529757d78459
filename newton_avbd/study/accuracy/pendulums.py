# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Planar pendulums of rigid links, integrated to high accuracy.

The reference solves Lagrange's equations in the angles of the links to the vertical, with SciPy's
Dormand-Prince method of order 8.
"""

import math

import newton
import numpy as np

from newton_avbd.measure.state import Array, Bodies
from newton_avbd.model.rotations import transform

LENGTH = 1.0
"""Length of a link [m]."""

SLOPE = math.radians(45.0)
"""Angle below the horizontal at which the links are let go [rad]; from higher up, more than two
of them move so chaotically that the error at the end says nothing about a step."""


def reference(model: newton.Model, seconds: float) -> Array:
    """Centers of mass of a hinged chain after a time, to about nine digits [m], shape [n, 3].

    Args:
        model: A model that :func:`newton_avbd.scenes.chains.add_chain` filled with hinges.
        seconds: Time from the start, at which all links rest [s].
    """
    from scipy.integrate import solve_ivp

    bodies = Bodies.of(model)
    count = len(bodies.mass)
    body_q = model.body_q.numpy().astype(float)
    reach = model.joint_X_c.numpy().astype(float)[:, 0]
    # Centers of mass halve the links.
    to_center, length = -reach, -2.0 * reach
    hung = model.joint_X_p.numpy().astype(float)[0, :3]
    along = transform(body_q, np.array([1.0, 0.0, 0.0])) - body_q[:, :3]
    angle = np.arctan2(along[:, 0], -along[:, 2])
    # arm[i, j]: how far out link j carries the center of link i.
    arm = np.tril(np.broadcast_to(length, (count, count)), -1) + np.diag(to_center)
    gravity = -bodies.gravity[0, 2]
    coupling = np.einsum("k,ki,kj->ij", bodies.mass, arm, arm)
    spin = np.diag(bodies.inertia[:, 1, 1])
    weight = gravity * bodies.mass @ arm

    def motion(_: float, y: Array) -> Array:
        phi, rate = y[:count], y[count:]
        apart = phi[:, None] - phi[None, :]
        inertia = coupling * np.cos(apart) + spin
        force = -(coupling * np.sin(apart)) @ rate**2 - weight * np.sin(phi)
        return np.concatenate([rate, np.linalg.solve(inertia, force)])

    start = np.concatenate([angle, np.zeros(count)])
    found = solve_ivp(motion, (0.0, seconds), start, method="DOP853", rtol=1e-11, atol=1e-12)
    phi = found.y[:count, -1]
    return hung + np.stack([arm @ np.sin(phi), np.zeros(count), -arm @ np.cos(phi)], axis=1)
