# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The device mathematics against the same in double precision: 6x6 blocks and rotations."""

import numpy as np
import pytest
import warp as wp
from helpers import EPS, Array
from scipy.spatial.transform import Rotation

from newton_avbd.algebra.block import factor_block, solve_block
from newton_avbd.algebra.so3 import angle_of, exp_quat, right_jacobian, world_inertia

COUNT = 2000


@wp.kernel(enable_backward=False, module="unique")
def solve_blocks(
    h_ll: wp.array[wp.mat33],
    h_al: wp.array[wp.mat33],
    h_aa: wp.array[wp.mat33],
    load: wp.array[wp.spatial_vector],
    out: wp.array[wp.spatial_vector],
):
    i = wp.tid()
    factor = factor_block(h_ll[i], h_al[i], h_aa[i])
    out[i] = solve_block(factor, wp.spatial_top(load[i]), wp.spatial_bottom(load[i]))


@wp.kernel(enable_backward=False, module="unique")
def rotate(theta: wp.array[wp.vec3], out: wp.array[wp.quat]):
    out[wp.tid()] = exp_quat(theta[wp.tid()])


@wp.kernel(enable_backward=False, module="unique")
def jacobian(theta: wp.array[wp.vec3], out: wp.array[wp.mat33]):
    out[wp.tid()] = right_jacobian(theta[wp.tid()])


@wp.kernel(enable_backward=False, module="unique")
def turn_inertia(q: wp.array[wp.quat], inertia: wp.array[wp.mat33], out: wp.array[wp.mat33]):
    out[wp.tid()] = world_inertia(q[wp.tid()], inertia[wp.tid()])


def blocks(condition: float, scale: float, seed: int = 3) -> Array:
    """Random symmetric 6x6 blocks with that condition number and largest eigenvalue."""
    rng = np.random.default_rng(seed)
    q = np.linalg.qr(rng.normal(size=(COUNT, 6, 6)))[0]
    values = scale * condition ** -rng.uniform(0.0, 1.0, size=(COUNT, 6))
    values[:, 0], values[:, 1] = scale, scale / condition
    h = np.einsum("nij,nj,nkj->nik", q, values, q)
    return h.astype(np.float32).astype(np.float64)


def solved(h: Array, load: Array) -> Array:
    """What the device makes of block h and load."""
    out = wp.zeros(len(h), dtype=wp.spatial_vector, device="cpu")

    def part(rows: slice, columns: slice) -> wp.array:
        return wp.array(h[:, rows, columns], dtype=wp.mat33, device="cpu")

    top, bottom = slice(0, 3), slice(3, 6)
    inputs = [part(top, top), part(bottom, top), part(bottom, bottom)]
    inputs += [wp.array(load, dtype=wp.spatial_vector, device="cpu"), out]
    wp.launch(solve_blocks, dim=len(h), inputs=inputs, device="cpu")
    return out.numpy().astype(np.float64)


@pytest.mark.parametrize("condition", [1.0, 1.0e2, 1.0e4])
@pytest.mark.parametrize("scale", [1.0e-12, 1.0, 1.0e12])
def test_a_block_is_solved_to_float32_rounding(condition: float, scale: float) -> None:
    """Forward error below 10 eps times the condition number, at any scale of the block.

    Cholesky is backward stable: its error is a small multiple of n eps |H|, n = 6; the Schur
    complement repeats that once for its second factor.
    """
    h = blocks(condition, scale)
    load = np.random.default_rng(4).normal(size=(COUNT, 6)).astype(np.float32).astype(np.float64)
    exact = np.linalg.solve(h, load[:, :, None])[:, :, 0]
    error = np.linalg.norm(solved(h, load) - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert error.max() < 10.0 * EPS * condition


@pytest.mark.parametrize("condition", [1.0e6, 1.0e9])
def test_a_block_beyond_float32_still_gives_a_bounded_descent_step(condition: float) -> None:
    """Where rounding has eaten a pivot, the step stays finite and goes downhill.

    That is what a descent needs; the floor under the pivots makes the block stiffer, not softer.
    """
    h = blocks(condition, 1.0)
    load = np.random.default_rng(4).normal(size=(COUNT, 6)).astype(np.float32).astype(np.float64)
    step = solved(h, load)
    assert np.all(np.isfinite(step))
    assert np.all(np.einsum("ni,ni->n", step, load) > 0.0)


def test_a_body_on_three_contacts_is_solved_in_spite_of_mass_scales() -> None:
    """Linear and angular unknowns in different units: 1 g and 1 cm to 1,000 t and 10 m.

    Inertia m/h^2 with contact rows of ten times that, as the solver assembles them. Scaled to
    its natural units each block has a condition below 1e3, so the error stays below 1e-3.
    """
    rng = np.random.default_rng(5)
    mass = 10.0 ** rng.uniform(-3.0, 6.0, COUNT)
    size = 0.1 * mass ** (1.0 / 3.0)
    h = np.zeros((COUNT, 6, 6))
    for n in range(COUNT):
        k = mass[n] * 240.0**2
        h[n] = np.diag([k] * 3 + [0.1 * k * size[n] ** 2] * 3)
        for _ in range(3):
            arm, normal = size[n] * rng.uniform(-0.5, 0.5, 3), rng.normal(size=3)
            normal /= np.linalg.norm(normal)
            row = np.append(normal, np.cross(arm, normal))
            h[n] += 10.0 * k * np.outer(row, row)
    unit = np.concatenate([np.ones((COUNT, 3)), np.repeat(size[:, None], 3, axis=1)], axis=1)
    load = rng.normal(size=(COUNT, 6)) * unit * mass[:, None]
    h, load = (x.astype(np.float32).astype(np.float64) for x in (h, load))
    exact = np.linalg.solve(h, load[:, :, None])[:, :, 0] * unit
    error = np.linalg.norm(solved(h, load) * unit - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert error.max() < 1.0e-3
    assert np.median(error) < 10.0 * EPS


def test_an_empty_block_moves_nothing() -> None:
    """A block of zeros (nothing acts, no mass) gives a step of zeros, not a division by zero."""
    assert np.all(solved(np.zeros((1, 6, 6)), np.ones((1, 6))) == 0.0)


def rotation_vectors() -> Array:
    """Rotation vectors of all sizes from 0 and 1e-20 to 30 rad, and where the series end."""
    rng = np.random.default_rng(6)
    direction = rng.normal(size=(COUNT, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    size = 10.0 ** rng.uniform(-20.0, 1.5, COUNT)
    size[: COUNT // 2] = rng.uniform(0.0, 2.0, COUNT // 2)
    size[0] = 0.0
    return (direction * size[:, None]).astype(np.float32).astype(np.float64)


def test_the_exponential_map_is_exact_to_rounding() -> None:
    """Against scipy in double precision; the half angle of 30 rad itself is rounded by 15 eps."""
    theta = rotation_vectors()
    out = wp.zeros(COUNT, dtype=wp.quat, device="cpu")
    inputs = [wp.array(theta, dtype=wp.vec3, device="cpu"), out]
    wp.launch(rotate, dim=COUNT, inputs=inputs, device="cpu")
    q = out.numpy().astype(np.float64)
    size = np.linalg.norm(theta, axis=1)
    exact = Rotation.from_rotvec(theta).as_quat()
    exact *= np.sign(np.sum(exact * q, axis=1))[:, None]  # q and -q are the same rotation
    assert np.all(np.abs(q - exact).max(axis=1) < EPS * (2.0 + 0.5 * size))
    # tiny rotations are kept, not rounded to none
    tiny = (size > 0.0) & (size < 1.0e-4)
    assert q[tiny, :3] == pytest.approx(0.5 * theta[tiny], rel=1.0e-6, abs=0.0)


@wp.kernel(enable_backward=False)
def angles(point: wp.array[wp.vec2], out: wp.array[float]):
    i = wp.tid()
    out[i] = angle_of(point[i][1], point[i][0])


def test_an_angle_is_exact_to_rounding() -> None:
    """Against NumPy in double precision: all around, on the axes, and near them."""
    around = np.linspace(-np.pi, np.pi, 4096)
    tiny = 10.0 ** np.linspace(-20.0, -1.0, 512)
    angle = np.concatenate([around, tiny, -tiny, np.pi - tiny, 0.5 * np.pi + tiny])
    point = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
    point = np.concatenate([point, np.float32([[1, 0], [0, 1], [-1, 0], [0, -1], [0, 0]])])
    out = wp.zeros(len(point), dtype=float, device="cpu")
    inputs = [wp.array(point, dtype=wp.vec2, device="cpu"), out]
    wp.launch(angles, dim=len(point), inputs=inputs, device="cpu")
    exact = np.arctan2(point[:, 1].astype(float), point[:, 0].astype(float))
    error = np.abs(out.numpy() - exact)
    # the float32 of pi is off by 0.7 eps of 1
    assert np.all(error < 2.0 * EPS * np.abs(exact) + 1.0e-30)


def test_the_right_jacobian_is_the_derivative_of_the_exponential_map() -> None:
    """Against central differences of scipy's map in double precision.

    Their own error is about 1e-9. In float32 (1 - cos a)/a^2 and (a - sin a)/a^3 lose up to four
    units of what is left, where the series hand over at 1 rad.
    """
    theta = rotation_vectors()
    theta = theta[np.linalg.norm(theta, axis=1) < 6.0]
    out = wp.zeros(len(theta), dtype=wp.mat33, device="cpu")
    inputs = [wp.array(theta, dtype=wp.vec3, device="cpu"), out]
    wp.launch(jacobian, dim=len(theta), inputs=inputs, device="cpu")
    exact = np.zeros((len(theta), 3, 3))
    step = 1.0e-6
    back = Rotation.from_rotvec(theta).inv()
    for i in range(3):
        delta = step * np.eye(3)[i]
        forward = (back * Rotation.from_rotvec(theta + delta)).as_rotvec()
        backward = (back * Rotation.from_rotvec(theta - delta)).as_rotvec()
        exact[:, :, i] = (forward - backward) / (2.0 * step)
    assert np.abs(out.numpy() - exact).max() < 10.0 * EPS + 1.0e-8


def test_inertia_is_turned_to_world_axes() -> None:
    """R I R^T for full tensors, to a few roundings."""
    rng = np.random.default_rng(7)
    r = Rotation.random(COUNT, random_state=8)
    axes = Rotation.random(COUNT, random_state=9).as_matrix()
    inertia = np.einsum("nij,nj,nkj->nik", axes, rng.uniform(1.0, 2.0, (COUNT, 3)), axes)
    out = wp.zeros(COUNT, dtype=wp.mat33, device="cpu")
    q = wp.array(r.as_quat(), dtype=wp.quat, device="cpu")
    inputs = [q, wp.array(inertia, dtype=wp.mat33, device="cpu"), out]
    wp.launch(turn_inertia, dim=COUNT, inputs=inputs, device="cpu")
    exact = r.as_matrix() @ inertia @ r.as_matrix().transpose(0, 2, 1)
    assert np.abs(out.numpy() - exact).max() < 10.0 * EPS
