# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The scenes are what they say: they build, bodies touch without overlap, contacts are counted."""

import math

import newton
import numpy as np
import pytest

from newton_avbd.measure.state import Probe
from newton_avbd.scenes import named as scenes

OVERLAP = 1e-6
"""Positions up to 8 m away are rounded to float32, twice for a pair: 2 x 2.4e-7 m."""


def _gaps(model: newton.Model) -> np.ndarray:
    return Probe(model).separations(model.state())


def _model(add, **options) -> newton.Model:
    builder = newton.ModelBuilder()
    add(builder, **options)
    return builder.finalize(device="cpu")


@pytest.mark.parametrize("name", scenes.SCENES)
def test_scene_starts_without_overlap(name: str) -> None:
    scene = scenes.SCENES[name]
    model = scene.model(device="cpu")
    assert model.body_count > 0
    assert scene.name == name
    assert np.all(_gaps(model) >= -OVERLAP)


@pytest.mark.parametrize("name", scenes.SCENES)
def test_frame_is_a_whole_number_of_steps(name: str) -> None:
    scene = scenes.SCENES[name]
    frame = scene.substeps * scene.dt
    assert math.isclose(frame * scenes.FRAMES_PER_SECOND, 1.0, rel_tol=1e-12)


@pytest.mark.parametrize(
    ("name", "bodies", "contacts", "touching"),
    [
        # Rows of a pyramid: 4 contacts under each box of the bottom row, 8 under each other one,
        # 4 more, that do not touch, between neighbors.
        ("pyramid", 55, 580, 400),
        ("stack", 20, 80, 80),
        ("pyramid_worlds", 640, 64 * 88, 64 * 64),
        ("heavy_on_light", 2, 8, 8),
        ("incline", 1, 4, 4),
        ("free_bodies", 64, 0, 0),
    ],
)
def test_contacts_are_those_of_the_layout(
    name: str, bodies: int, contacts: int, touching: int
) -> None:
    model = scenes.SCENES[name].model(device="cpu")
    gaps = _gaps(model)
    assert model.body_count == bodies
    assert len(gaps) == contacts
    assert np.count_nonzero(np.abs(gaps) <= OVERLAP) == touching


@pytest.mark.parametrize("edge", [0.008, 0.8, 80.0])
def test_pyramid_scales_with_its_edge(edge: float) -> None:
    gaps = _gaps(_model(scenes.add_pyramid, rows=3, edge=edge))
    assert len(gaps) == 4 * 3 + 6 * 3 * 2
    assert np.all(gaps >= -OVERLAP * edge)


def test_card_house_stands_on_the_ground_and_on_itself() -> None:
    model = _model(scenes.add_card_house, levels=2)
    gaps = _gaps(model)
    # Three leaning pairs and a flat card. Each pair: an edge of two points under either card and
    # one where they lean on each other; each pair below carries an end of the flat card. Contacts
    # of tilted boxes come out of an iteration that stops within some micrometers.
    assert model.body_count == 7
    assert np.all(gaps >= -OVERLAP)
    assert np.count_nonzero(gaps <= 1e-5) >= 3 * 3 * 2 + 2 * 2


def test_worlds_are_replicas() -> None:
    model = scenes.SCENES["pyramid_worlds"].model(device="cpu")
    body_q = model.body_q.numpy().reshape(64, 10, 7)
    assert model.world_count == 64
    assert np.array_equal(body_q, np.broadcast_to(body_q[0], body_q.shape))


def test_velocity_is_the_same_in_bodies_and_joints() -> None:
    model = scenes.SCENES["free_bodies"].model(device="cpu")
    assert np.array_equal(model.body_qd.numpy().ravel(), model.joint_qd.numpy())
    assert np.all(np.linalg.norm(model.body_qd.numpy()[:, 3:], axis=1) > 0.0)


def test_nothing_acts_on_free_bodies() -> None:
    model = scenes.SCENES["free_bodies"].model(device="cpu")
    assert not model.gravity.numpy().any()
    assert model.shape_contact_pair_count == 0


def test_stiffness_reaches_every_shape() -> None:
    for name in ("pyramid", "pyramid_worlds", "free_bodies"):
        model = scenes.SCENES[name].model(ke=1.0e5, device="cpu")
        assert np.all(model.shape_material_ke.numpy() == 1.0e5)
