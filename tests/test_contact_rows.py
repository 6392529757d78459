# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The mathematics of one contact row against the same in double precision."""

import numpy as np
import pytest
import warp as wp
from helpers import EPS, Array

from newton_avbd.data import ContactRow, WorldScale
from newton_avbd.rows import contact, ramp

COUNT = 1000
BETA, GAMMA, K_MIN = 1.0e5, 0.99, 1.0e2
"""What the seed document's ramp is set to."""


@wp.func
def make_row(
    normal: wp.vec3, arms: wp.spatial_vector, force: wp.vec3, numbers: wp.vec4
) -> ContactRow:
    """A row with the arm of body a from arms (a, b), and numbers (k_n, k_t, mu, gap)."""
    row = ContactRow()
    row.normal = normal
    row.arm = wp.spatial_top(arms)
    row.force = force
    row.k_n = numbers[0]
    row.k_t = numbers[1]
    row.mu = numbers[2]
    row.gap = numbers[3]
    return row


@wp.kernel(enable_backward=False, module="unique")
def evaluate(
    normal: wp.array[wp.vec3],
    arms: wp.array[wp.spatial_vector],
    force: wp.array[wp.vec3],
    numbers: wp.array[wp.vec4],
    increment_a: wp.array[wp.spatial_vector],
    increment_b: wp.array[wp.spatial_vector],
    slip: wp.array[wp.vec3],
    push: wp.array[wp.vec3],
    normal_push: wp.array[wp.vec3],
):
    i = wp.tid()
    row = make_row(normal[i], arms[i], force[i], numbers[i])
    span = wp.spatial_bottom(arms[i]) - wp.spatial_top(arms[i])
    u = contact.slip(row, increment_a[i], increment_b[i], span)
    slip[i] = u
    push[i] = contact.force(row, u, row.gap)
    normal_push[i] = contact.normal_force(row, u, row.gap)


@wp.kernel(enable_backward=False, module="unique")
def assemble(
    normal: wp.array[wp.vec3],
    arms: wp.array[wp.spatial_vector],
    numbers: wp.array[wp.vec4],
    inv_mass: wp.array[float],
    inv_inertia_a: wp.array[wp.mat33],
    inv_inertia_b: wp.array[wp.mat33],
    ll: wp.array[wp.mat33],
    al: wp.array[wp.mat33],
    aa: wp.array[wp.mat33],
    mass: wp.array[float],
):
    i = wp.tid()
    row = make_row(normal[i], arms[i], wp.vec3(0.0), numbers[i])
    h_ll, h_al, h_aa = contact.curvature(row, row.arm, ll[i], al[i], aa[i])
    ll[i] = h_ll
    al[i] = h_al
    aa[i] = h_aa
    mass[i] = contact.effective_mass(
        row.normal,
        wp.spatial_top(arms[i]),
        wp.spatial_bottom(arms[i]),
        inv_mass[i],
        inv_inertia_a[i],
        inv_inertia_b[i],
    )


@wp.kernel(enable_backward=False, module="unique")
def evaluate_ramp(
    normal: wp.array[wp.vec3],
    arms: wp.array[wp.spatial_vector],
    numbers: wp.array[wp.vec4],
    u: wp.array[wp.vec3],
    damping: float,
    h: float,
    push: wp.array[wp.vec3],
    ll: wp.array[wp.mat33],
    al: wp.array[wp.mat33],
    aa: wp.array[wp.mat33],
):
    i = wp.tid()
    row = make_row(normal[i], arms[i], wp.vec3(0.0), numbers[i])
    f, k = ramp.force_and_stiffness(row, u[i], damping, h)
    push[i] = f
    h_ll, h_al, h_aa = ramp.add_stiffness(k, wp.spatial_bottom(arms[i]), ll[i], al[i], aa[i])
    ll[i] = h_ll
    al[i] = h_al
    aa[i] = h_aa


@wp.kernel(enable_backward=False, module="unique")
def ramp_penalty(
    penalty: wp.array[float],
    depth: wp.array[float],
    stiffness: wp.array[float],
    warm: wp.array[float],
    grown: wp.array[float],
):
    i = wp.tid()
    warm[i] = ramp.warm_penalty(penalty[i], stiffness[i])
    grown[i] = ramp.grown_penalty(penalty[i], depth[i], stiffness[i])


def launch(kernel: wp.Kernel, inputs: list, *outputs: type) -> list[Array]:
    """Runs a kernel over COUNT rows; arrays become Warp arrays, results come back in double."""
    made = [wp.zeros(COUNT, dtype=kind, device="cpu") for kind in outputs]
    wp.launch(kernel, dim=COUNT, inputs=inputs + made, device="cpu")
    return [array.numpy().astype(np.float64) for array in made]


def device(values: Array, kind: type) -> wp.array:
    return wp.array(values.astype(np.float32), dtype=kind, device="cpu")


def random_rows(seed: int):
    """Normals, arms (a, b), multipliers, and (k_n, k_t, mu, gap), exactly as float32 holds them."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(COUNT, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    arms = rng.uniform(-1.0, 1.0, (COUNT, 6))
    force = rng.normal(size=(COUNT, 3)) * 10.0
    k_n = rng.uniform(50.0, 150.0, COUNT)
    numbers = np.stack([k_n, 0.3 * k_n, rng.uniform(0.0, 1.5, COUNT), rng.normal(size=COUNT)], 1)
    numbers[:, 3] *= 0.1
    return [x.astype(np.float32).astype(np.float64) for x in (normal, arms, force, numbers)]


def dot(a: Array, b: Array) -> Array:
    return np.sum(a * b, axis=1)


def skew(r: Array) -> Array:
    """Cross product matrices [r], shape (n, 3, 3)."""
    return np.stack([np.cross(r, e) for e in np.eye(3)], axis=2)


def test_a_row_pushes_as_its_multiplier_and_penalty_say_inside_the_friction_cone() -> None:
    """F = proj(lambda - K (u + gap n)): within the circular cone, zero when it would pull.

    A few roundings of forces up to 300 N: bound 10 eps of that.
    """
    normal, arms, force, numbers = random_rows(1)
    rng = np.random.default_rng(2)
    da, db = (0.1 * rng.normal(size=(2, COUNT, 6))).astype(np.float32).astype(np.float64)
    inputs = [device(normal, wp.vec3), device(arms, wp.spatial_vector), device(force, wp.vec3)]
    inputs += [device(numbers, wp.vec4), device(da, wp.spatial_vector)]
    inputs += [device(db, wp.spatial_vector)]
    slip, push, normal_push = launch(evaluate, inputs, wp.vec3, wp.vec3, wp.vec3)

    u = db[:, :3] + np.cross(db[:, 3:], arms[:, 3:]) - da[:, :3] - np.cross(da[:, 3:], arms[:, :3])
    assert np.abs(slip - u).max() < 10.0 * EPS

    k_n, k_t, mu, gap = numbers.T
    u_n = dot(normal, u)
    f_n = np.maximum(dot(normal, force) - k_n * (u_n + gap), 0.0)
    f_t = force - dot(normal, force)[:, None] * normal
    f_t -= k_t[:, None] * (u - u_n[:, None] * normal)
    size = np.linalg.norm(f_t, axis=1)
    f_t *= np.minimum(1.0, mu * f_n / size)[:, None]
    expected = np.where((f_n > 0.0)[:, None], f_n[:, None] * normal + f_t, 0.0)
    bound = 10.0 * EPS * 300.0
    assert np.abs(push - expected).max() < bound
    assert np.abs(normal_push - f_n[:, None] * normal).max() < bound
    # both sides of every decision were there
    assert 0.1 < np.mean(f_n > 0.0) < 0.9
    assert 0.1 < np.mean(size[f_n > 0.0] > (mu * f_n)[f_n > 0.0]) < 0.9
    got_n = dot(push, normal)
    got_t = np.linalg.norm(push - got_n[:, None] * normal, axis=1)
    assert np.all(got_n >= -bound) and np.all(got_t <= mu * got_n + 2.0 * bound)


def test_curvature_is_the_jacobian_squared_and_effective_mass_its_inverse() -> None:
    """Adds J^T K J with J = [1, -[r]] and K = k_t 1 + (k_n - k_t) n n^T; 1/(J M^-1 J^T) along n.

    The masses differ by up to 1e6; all terms are positive, so that rounding stays relative.
    """
    normal, arms, _force, numbers = random_rows(3)
    rng = np.random.default_rng(4)
    inv_mass = 10.0 ** rng.uniform(-3.0, 3.0, COUNT)
    axes = np.linalg.qr(rng.normal(size=(2, COUNT, 3, 3)))[0]
    inv_inertia = np.einsum(
        "snij,snj,snkj->snik", axes, 10.0 ** rng.uniform(-3.0, 3.0, (2, COUNT, 3)), axes
    )
    start = [device(rng.normal(size=(COUNT, 3, 3)), wp.mat33) for _ in range(3)]
    before = [array.numpy().astype(np.float64) for array in start]
    inputs = [device(normal, wp.vec3), device(arms, wp.spatial_vector), device(numbers, wp.vec4)]
    inputs += [device(inv_mass, float), *(device(x, wp.mat33) for x in inv_inertia), *start]
    (mass,) = launch(assemble, inputs, float)
    added = [array.numpy() - old for array, old in zip(start, before, strict=True)]

    k_n, k_t = numbers[:, 0], numbers[:, 1]
    k = k_t[:, None, None] * np.eye(3)
    k += (k_n - k_t)[:, None, None] * normal[:, :, None] * normal[:, None, :]
    j = np.concatenate([np.tile(np.eye(3), (COUNT, 1, 1)), -skew(arms[:, :3])], axis=2)
    h = np.einsum("nij,nik,nkl->njl", j, k, j)
    for got, expected in zip(added, (h[:, :3, :3], h[:, 3:, :3], h[:, 3:, 3:]), strict=True):
        assert np.abs(got - expected).max() < 10.0 * EPS * 300.0

    row_a = np.cross(arms[:, :3], normal)
    row_b = np.cross(arms[:, 3:], normal)
    turn = np.einsum("ni,nij,nj->n", row_a, inv_inertia[0], row_a)
    turn += np.einsum("ni,nij,nj->n", row_b, inv_inertia[1], row_b)
    size = np.linalg.norm(row_a, axis=1) ** 2 * np.abs(inv_inertia[0]).max(axis=(1, 2))
    size += np.linalg.norm(row_b, axis=1) ** 2 * np.abs(inv_inertia[1]).max(axis=(1, 2))
    error = np.abs(1.0 / mass - (inv_mass + turn))
    assert np.all(error < 30.0 * EPS * (inv_mass + size))


@pytest.mark.parametrize("damping", [0.0, 5.0])
def test_a_ramped_row_has_the_force_and_blocks_of_the_seed_document(damping: float) -> None:
    """f = k d n, damped while closing; K = k n n^T + (kd/h) n n^T; and the three blocks

        H_ll = K,  H_al = -[r]^T K,  H_aa = [r]^T K [r].

    Without friction. Bound: a few roundings of k d, and of K with arms below 2 m.
    """
    normal, arms, _force, numbers = random_rows(5)
    numbers[:, 2] = 0.0
    h = 0.01
    u = 0.1 * np.random.default_rng(6).normal(size=(COUNT, 3))
    u = u.astype(np.float32).astype(np.float64)
    inputs = [device(normal, wp.vec3), device(arms, wp.spatial_vector), device(numbers, wp.vec4)]
    inputs += [device(u, wp.vec3), damping, h]
    push, ll, al, aa = launch(evaluate_ramp, inputs, wp.vec3, wp.mat33, wp.mat33, wp.mat33)

    k_n, gap = numbers[:, 0], numbers[:, 3]
    u_n = dot(normal, u)
    depth = np.maximum(0.0, -(gap + u_n))
    closing = (depth > 0.0) & (u_n < 0.0)
    f_n = k_n * depth - np.where(closing, damping * u_n / h, 0.0)
    stiffness = np.where(depth > 0.0, k_n, 0.0) + np.where(closing, damping / h, 0.0)
    k = stiffness[:, None, None] * normal[:, :, None] * normal[:, None, :]
    r = skew(arms[:, 3:])
    rt_k = r.transpose(0, 2, 1) @ k
    assert np.abs(push - f_n[:, None] * normal).max() < 20.0 * EPS * 100.0
    for got, expected in ((ll, k), (al, -rt_k), (aa, rt_k @ r)):
        assert np.abs(got - expected).max() < 10.0 * EPS * 2000.0
    assert 0.1 < np.mean(depth > 0.0) < 0.9


def test_ramped_friction_opposes_the_slip_within_the_cone() -> None:
    """|f_t| = mu f_n against the slip at speed, in proportion to it near rest, never more."""
    normal, arms, _force, numbers = random_rows(7)
    numbers[:, 3] = -0.05
    h = 0.01
    u = np.random.default_rng(8).normal(size=(COUNT, 3))
    u -= dot(u, normal)[:, None] * normal
    u *= (10.0 ** np.random.default_rng(9).uniform(-7.0, -2.0, COUNT))[:, None]
    inputs = [device(normal, wp.vec3), device(arms, wp.spatial_vector), device(numbers, wp.vec4)]
    inputs += [device(u, wp.vec3), 0.0, h]
    push = launch(evaluate_ramp, inputs, wp.vec3, wp.mat33, wp.mat33, wp.mat33)[0]
    f_n = dot(push, normal)
    f_t = push - f_n[:, None] * normal
    limit = numbers[:, 2] * f_n
    size = np.linalg.norm(f_t, axis=1)
    assert np.all(size <= limit * (1.0 + 1.0e-5) + 1.0e-5)
    fast = np.linalg.norm(u, axis=1) > 1.1e-2 * h
    assert size[fast] == pytest.approx(limit[fast], rel=1.0e-5, abs=1.0e-5)
    assert np.all(dot(f_t, u) <= 0.0)


def test_the_ramp_grows_by_violation_up_to_the_material_and_fades_between_steps() -> None:
    """k <- min(k + beta |C|, k_max) a sweep, k <- clamp(gamma k, k_min, k_max) a step."""
    rng = np.random.default_rng(10)
    stiffness = 10.0 ** rng.uniform(1.0, 6.0, COUNT)
    penalty = stiffness * rng.uniform(0.0, 1.0, COUNT)
    depth = np.where(rng.uniform(size=COUNT) < 0.3, 0.0, 10.0 ** rng.uniform(-6.0, 0.0, COUNT))
    inputs = [device(x, float) for x in (penalty, depth, stiffness)]
    warm, grown = launch(ramp_penalty, inputs, float, float)
    expected = np.clip(GAMMA * penalty, np.minimum(K_MIN, stiffness), stiffness)
    assert warm == pytest.approx(expected, rel=4.0 * EPS)
    expected = np.minimum(penalty + BETA * depth, stiffness)
    assert grown == pytest.approx(expected, rel=4.0 * EPS)


@wp.kernel(enable_backward=False, module="unique")
def keep(push: wp.array[wp.vec3], kept: wp.array[wp.vec3]):
    i = wp.tid()
    scale = WorldScale()
    scale.mass = 2.0
    scale.h = 0.01
    kept[i] = contact.kept_force(push[i], 0.1, scale)


def test_a_contact_keeps_a_force_that_a_scene_may_ask_for() -> None:
    """Up to 10,000 times what moves 2 kg by a body's size of 10 cm in 10 ms, with its direction.

    Links of a file may overlap so that no joint can part them: each sweep adds to the force.
    """
    most = 1.0e4 * 2.0 * 0.1 / 0.01**2
    pushes = np.array([[0, 0, 0], [0.3, -0.4, 0.0], [0.9 * most, 0, 0], [3e12, 0, 4e12]])
    push = wp.array(pushes, dtype=wp.vec3, device="cpu")
    kept = wp.zeros_like(push)
    wp.launch(keep, dim=4, inputs=[push], outputs=[kept], device="cpu")
    pushes[3] *= most / 5e12
    np.testing.assert_allclose(kept.numpy(), pushes, rtol=1e-6)
