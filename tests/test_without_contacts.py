# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Worlds that nothing can touch, however their work is shared and their time is stepped."""

import warnings

import newton
import numpy as np
import pytest
import warp as wp
from helpers import add_box
from joint_scenes import WORLD, add_hinge_chain, add_link, set_coordinates, transform

from newton_avbd import SolverAVBD

STEPS = 40


def cart_poles(shapes: bool) -> newton.Model:
    """Two worlds, each with a cart, a pole, a free body and one that hangs on a string.

    With ``shapes`` the free body has one that could collide if it were given contacts.
    """
    world = newton.ModelBuilder()
    cart, pole = add_link(world), add_link(world, com=(0.0, 0.0, 0.2))
    rail = world.add_joint_prismatic(WORLD, cart, axis=(1.0, 0.0, 0.0))
    hinge = world.add_joint_revolute(cart, pole, axis=(0.0, 1.0, 0.0))
    world.add_articulation([rail, hinge])
    set_coordinates(world, hinge, [0.3])
    if shapes:
        add_box(world, (2.0, 0.0, 0.0), (0.2, 0.3, 0.4))
        world.add_shape_plane(plane=(0.0, 0.0, 1.0, 5.0), width=0.0, length=0.0)
    else:
        world.add_body(mass=1.0, inertia=wp.mat33(np.diag((0.1, 0.2, 0.25))))
    ball = add_link(world)
    world.body_q[ball] = transform((1.0, 0.0, 0.0))
    world.add_articulation([world.add_joint_distance(WORLD, ball, max_distance=1.0)])
    add_hinge_chain(world, 3, base=(0.0, 3.0, 0.0))
    builder = newton.ModelBuilder()
    for _ in range(2):
        builder.add_world(world)
    model = builder.finalize(device="cpu")
    newton.eval_fk(model, model.joint_q, model.joint_qd, model)
    return model


def motion(shapes: bool, capacity: int | None, **settings: object) -> np.ndarray:
    """Poses after some steps; ``capacity`` of the contact buffer, None without one."""
    model = cart_poles(shapes)
    contacts = None
    if capacity is not None:
        contacts = newton.Contacts(capacity, 0, device=model.device)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="SolverAVBD steps without contacts")
        solver = SolverAVBD(model, **settings)
        states = model.state(), model.state()
        for _ in range(STEPS):
            solver.step(*states, None, contacts, 1.0 / 120.0)
            states = states[::-1]
    return states[0].body_q.numpy()


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
@pytest.mark.parametrize("blocks", ["articulation", "body"])
@pytest.mark.parametrize("shapes, capacity", [(False, None), (False, 0), (True, None), (True, 0)])
def test_they_move_as_one_thread_a_world_moves_them(
    shapes: bool, capacity: int | None, blocks: str, scheme: str
) -> None:
    """For all that can share the work: poses within 1e-5, a hundred roundings of a metre.

    Body by body joints close sweep by sweep, in an order of its own color by color: with 10 sweeps
    the poses differ by 2e-2, with 50 by 1e-4, with 200 by 3e-6.
    """
    settings = {"blocks": blocks, "scheme": scheme, "iterations": 200 if blocks == "body" else 10}
    expected = motion(shapes, capacity, parallel="worlds", **settings)
    assert np.abs(expected - cart_poles(shapes).body_q.numpy()).max() > 0.1  # they do move
    others = [{"parallel": None}]
    if scheme == "euler" or not shapes:  # color by color there is no scheme of second order
        others.append({"parallel": "bodies"})
    for setting in others:
        poses = motion(shapes, capacity, **settings, **setting)
        np.testing.assert_allclose(poses, expected, atol=1.0e-5)


@pytest.mark.parametrize("shapes, capacity", [(False, None), (False, 0), (True, None), (True, 0)])
def test_they_move_as_well_where_what_rests_sleeps(shapes: bool, capacity: int | None) -> None:
    """Nothing rests here; poses within 1e-5."""
    expected = motion(shapes, capacity)
    poses = motion(shapes, capacity, sleeping=True)
    np.testing.assert_allclose(poses, expected, atol=1.0e-5)
