# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MJCF files whose meshes are not all there are read without them, and say so."""

from pathlib import Path

import newton
import numpy as np
import pytest

from newton_avbd.io.assets import read_asset
from newton_avbd.io.mjcf import read_mjcf

TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
ROBOT = """<mujoco><compiler meshdir="assets"/>
<asset><mesh file="there.obj"/><mesh name="gone" file="lost.stl"/></asset>
<worldbody><body name="a"><freejoint/><inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/>
<geom type="mesh" mesh="there"/><geom type="mesh" mesh="gone"/></body>
<body name="b"><freejoint/><geom size="0.1" mass="2"/><geom type="mesh" mesh="gone"/></body>
</worldbody></mujoco>"""
SCENE = """<mujoco><include file="robot.xml"/><worldbody>
<geom type="plane" size="1 1 1"/><geom type="mesh" mesh="there"/></worldbody></mujoco>"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A file that includes a robot with two meshes, one of which is there."""
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "there.obj").write_text(TETRAHEDRON)
    (tmp_path / "robot.xml").write_text(ROBOT)
    (tmp_path / "scene.xml").write_text(SCENE)
    return tmp_path / "scene.xml"


def test_a_missing_mesh_is_named_and_the_rest_is_read(scene: Path) -> None:
    """With what is weighed without it: of two bodies one has its mass from the file."""
    builder, notes = read_asset(scene, "avbd", floating=True)
    assert notes == (
        "scene.xml goes on without the geoms of meshes that are not there: lost.stl",
        "scene.xml: bodies of these geoms have no <inertial>, and weigh what the others of their "
        "geoms do: 'b' 2 kg",
    )
    kinds = newton.GeoType
    shapes = zip(builder.shape_body, builder.shape_type, strict=True)
    assert sorted(shapes) == sorted(
        # that of the world collides as its hull, too, as in MuJoCo
        [(0, kinds.CONVEX_MESH), (-1, kinds.CONVEX_MESH), (1, kinds.SPHERE), (-1, kinds.PLANE)]
    )
    np.testing.assert_allclose(builder.body_mass, (3.0, 2.0), rtol=1.0e-6)


def test_a_body_of_missing_meshes_alone_is_said_to_weigh_nothing(tmp_path: Path) -> None:
    path = tmp_path / "bot.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody><body name="b">'
        '<freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    builder, notes = read_asset(path, "avbd", floating=True)
    assert notes[0].endswith("gone.stl")
    assert notes[1].endswith("'b' 0 kg")
    assert builder.body_mass == [0.0]


def test_a_file_names_its_meshes_by_where_they_are(scene: Path) -> None:
    (scene.parent / "assets" / "lost.stl").write_text("solid")
    root, absent = read_mjcf(scene)
    assert not absent
    files = [mesh.get("file") for mesh in root.iter("mesh")]
    assert files == [str(scene.parent / "assets" / name) for name in ("there.obj", "lost.stl")]


def test_assets_may_be_included_within_asset(scene: Path) -> None:
    """And comments may have "--" inside, as for MuJoCo."""
    assets = '<mujoco><mesh file="there.obj"/></mujoco>'
    (scene.parent / "assets.xml").write_text(assets)
    whole = ROBOT.replace('<mesh file="there.obj"/>', '<include file="assets.xml"/><!-- a -- b -->')
    (scene.parent / "robot.xml").write_text(whole)
    root, absent = read_mjcf(scene)
    assert list(absent) == ["gone"]
    files = [mesh.get("file") for mesh in root.iter("mesh")]
    assert files == [str(scene.parent / "assets" / "there.obj")]
