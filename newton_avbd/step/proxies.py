# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Proxies of bodies that another solver moves: what pushed them in a step."""

import warp as wp

from ..algebra.so3 import world_inertia
from .kernels import KERNEL


@wp.kernel(**KERNEL)
def harvest_momentum(
    # Model:
    body_mass: wp.array[float],
    body_inertia: wp.array[wp.mat33],
    # In:
    proxy: wp.array[wp.int32],
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    body_q_out: wp.array[wp.transform],
    body_qd_out: wp.array[wp.spatial_vector],
    h: float,
    # Out:
    proxy_f: wp.array[wp.spatial_vector],
):
    """Adds the change of momentum of each proxy over the step, by h; one thread a body."""
    body = wp.tid()
    if proxy[body] < 0:
        return
    start, end = body_qd[body], body_qd_out[body]
    before = world_inertia(wp.transform_get_rotation(body_q[body]), body_inertia[body])
    after = world_inertia(wp.transform_get_rotation(body_q_out[body]), body_inertia[body])
    push = (body_mass[body] / h) * (wp.spatial_top(end) - wp.spatial_top(start))
    turn = (after * wp.spatial_bottom(end) - before * wp.spatial_bottom(start)) / h
    wp.atomic_add(proxy_f, proxy[body], wp.spatial_vector(push, turn))
