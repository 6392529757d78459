# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Assets that Newton brings along, stripped to free bodies, fall and come to rest."""

from pathlib import Path

import newton
import numpy as np
import pytest
from helpers import G, Simulation, add_ground

Usd = pytest.importorskip("pxr.Usd", reason="needs usd-core: pip install newton-avbd[scenes]")
UsdPhysics = pytest.importorskip("pxr.UsdPhysics")

ASSETS = Path(newton.__file__).parent / "examples" / "assets"


def free_bodies(asset: str) -> newton.ModelBuilder:
    """The bodies of an asset and their colliders, without joints, side by side over a floor."""
    stage = Usd.Stage.Open(Usd.Stage.Open(str(ASSETS / asset)).Flatten())
    for prim in [prim for prim in stage.TraverseAll() if prim.IsA(UsdPhysics.Joint)]:
        prim.SetActive(False)
    builder = newton.ModelBuilder()
    builder.rigid_gap = 0.05
    builder.add_usd(stage, load_visual_shapes=False)
    for body in range(builder.body_count):
        pose = builder.body_q[body]
        builder.body_q[body] = type(pose)((2.0 * body, 0.0, 1.5), pose.q)
    return builder


@pytest.mark.parametrize(
    ("asset", "bodies"),
    [
        ("axis_cube.usda", 1),
        ("boxes_fourbar.usda", 4),
        ("ant.usda", 9),
        ("humanoid.usda", 16),
        ("cartpole.usda", 4),
    ],
)
def test_parts_of_an_asset_fall_and_come_to_rest(asset: str, bodies: int) -> None:
    """After 4 s nothing moves up or down, nothing is deeper than 0.1 mm, nothing has flown off.

    Round parts may roll on; they do it no faster than 5 % of the speed they landed with.
    """
    builder = free_bodies(asset)
    assert builder.body_count == bodies
    add_ground(builder, gap=0.05)
    sim = Simulation(builder)
    start = sim.energy
    sim.run(4.0)
    assert np.all(sim.solver.status.held_steps == 0)
    assert np.abs(sim.velocity[:, 2]).max() < 1.0e-3
    assert np.abs(sim.velocity[:, :2]).max() < 0.05 * np.sqrt(2.0 * G * 1.5)
    assert sim.penetration < 1.0e-4
    assert sim.energy < start
    assert np.all(sim.center[:, 2] > 0.0) and np.all(sim.center[:, 2] < 1.0)


def test_the_palletizer_s_load_settles_where_the_asset_puts_it() -> None:
    """Seven free boxes with their own static scene, as authored: at rest after 4 s.

    No contact is deeper than 0.1 mm.
    """
    builder = newton.ModelBuilder()
    builder.add_usd(str(ASSETS / "palletizer_scene.usda"), load_visual_shapes=False)
    add_ground(builder)
    sim = Simulation(builder)
    sim.run(4.0)
    assert sim.penetration < 1.0e-4
    assert np.abs(sim.velocity).max() < 1.0e-3
