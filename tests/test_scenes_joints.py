# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Scenes with joints start closed, inside their limits, and weigh what they say."""

import newton
import numpy as np
import pytest

from newton_avbd.measure.joints import Joints
from newton_avbd.scenes import chains, robots
from newton_avbd.scenes.chains import add_chain
from newton_avbd.scenes.scene import Scene

CLOSED = 5e-6
"""Positions up to 20 m away are rounded to float32: 1e-6 m, twice for a joint, on three axes."""

NAMES = {scene.name: scene for scene in (*chains.CHAINS, *robots.ROBOTS)}


def _model(scene: Scene) -> newton.Model:
    if scene.name in ("cartpole", "humanoid_usd", "ant_usd", "fourbar"):
        pytest.importorskip("pxr", reason="needs usd-core: pip install newton-avbd[scenes]")
    return scene.model(device="cpu")


@pytest.mark.parametrize("name", NAMES)
def test_joints_start_closed_and_inside_their_limits(name: str) -> None:
    model = _model(NAMES[name])
    joints, body_q = Joints.of(model), model.body_q.numpy().astype(float)
    assert len(joints.child) >= 3
    assert np.max(joints.separation(body_q)) < CLOSED
    assert np.max(joints.misalignment(body_q)) < 1e-6
    assert np.max(joints.limit_violation(body_q)) < 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_bodies_start_where_the_joint_coordinates_put_them(name: str) -> None:
    model = _model(NAMES[name])
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    assert np.allclose(state.body_q.numpy(), model.body_q.numpy(), atol=CLOSED)


@pytest.mark.parametrize(
    ("name", "links", "end"),
    [
        ("chain", 20, 1.0),
        ("chain_100", 20, 1e2),
        ("chain_10000", 20, 1e4),
        ("rope", 100, 1.0),
        ("rope_100000", 100, 1e5),
    ],
)
def test_links_are_boxes_of_a_kilogram_and_one_at_the_end(
    name: str, links: int, end: float
) -> None:
    model = chains.CHAINS[[scene.name for scene in chains.CHAINS].index(name)].model(device="cpu")
    mass, inertia = model.body_mass.numpy(), model.body_inertia.numpy()
    assert np.allclose(mass, [1.0] * (links - 1) + [end])
    # A box of 0.2 x 0.1 x 0.05 m.
    sides = np.array([0.1**2 + 0.05**2, 0.2**2 + 0.05**2, 0.2**2 + 0.1**2]) / 12.0
    assert np.allclose(inertia, mass[:, None, None] * np.diag(sides), rtol=1e-5, atol=1e-9 * end)
    assert model.shape_contact_pair_count == 0


def test_chain_hangs_level_as_high_as_it_is_long() -> None:
    model = chains.CHAINS[0].model(device="cpu")
    center = model.body_q.numpy()[:, :3]
    assert np.allclose(center, [[0.2 * (i + 0.5), 0.0, 4.0] for i in range(20)], atol=1e-6)


def test_rope_leaves_every_plane_through_its_end() -> None:
    """Three directions of links are independent of each other and of gravity."""
    model = next(s for s in chains.CHAINS if s.name == "rope").model(device="cpu")
    center = model.body_q.numpy()[:, :3].astype(float) - [0.0, 0.0, 20.0]
    horizontal = np.linalg.svd(center[:, :2])[1]
    assert horizontal[1] > 1.0


def test_slope_points_links_below_the_horizontal() -> None:
    builder = newton.ModelBuilder()
    add_chain(builder, 2, length=1.0, slope=0.5)
    center = np.array([list(pose)[:3] for pose in builder.body_q])
    down = np.array([np.cos(0.5), 0.0, -np.sin(0.5)])
    assert np.allclose(center, [[0.0, 0.0, 2.0] + 0.5 * down, [0.0, 0.0, 2.0] + 1.5 * down])


def test_fourbar_is_a_tree_and_a_joint_that_closes_it() -> None:
    model = _model(NAMES["fourbar"])
    assert np.count_nonzero(model.joint_articulation.numpy() == -1) == 1
    assert len(Joints.of(model).child) == 4
    # The free root comes first; the drives are on two of the bars' hinges.
    assert np.count_nonzero(model.joint_target_ke.numpy()) == 2


def test_ants_are_alike_and_in_worlds_of_their_own() -> None:
    model = NAMES["ant_worlds"].model(device="cpu")
    ant = NAMES["ant"].model(device="cpu")
    assert model.world_count == robots.WORLDS
    body_q = model.body_q.numpy().reshape(robots.WORLDS, -1, 7)
    assert np.array_equal(body_q, np.broadcast_to(ant.body_q.numpy(), body_q.shape))


@pytest.mark.parametrize("name", ["ant", "humanoid", "quadruped", "humanoid_usd", "ant_usd"])
def test_robot_starts_above_a_floor(name: str) -> None:
    model = _model(NAMES[name])
    planes = model.shape_type.numpy() == int(newton.GeoType.PLANE)
    assert planes.sum() == 1
    assert model.shape_body.numpy()[planes] == [-1]
    assert np.min(model.body_q.numpy()[:, 2]) > 0.2
