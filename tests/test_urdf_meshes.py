# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The meshes of a URDF file are found where they are, and named where they are not."""

from pathlib import Path
from xml.etree import ElementTree

import newton
import pytest

from newton_avbd.__main__ import main
from newton_avbd.io.assets import read_asset
from newton_avbd.io.meshes import find_asset, read_urdf

TETRAHEDRON = """v 0 0 0
v 0.1 0 0
v 0 0.1 0
v 0 0 0.1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""

LINK = """<robot name="r"><link name="base"><inertial><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="{mesh}"/></geometry></collision>
<collision><geometry><sphere radius="0.05"/></geometry></collision></link></robot>"""


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A package ``bot`` with a robot and its mesh, five folders below the workspace."""
    package = tmp_path / "share" / "bot"
    (package / "models" / "deep" / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    (package / "meshes" / "part.obj").write_text(TETRAHEDRON)
    return tmp_path


def write(workspace: Path, mesh: str) -> Path:
    path = workspace / "share" / "bot" / "models" / "deep" / "urdf" / "bot.urdf"
    path.write_text(LINK.format(mesh=mesh))
    return path


@pytest.mark.parametrize(
    "name",
    [
        "package://bot/meshes/part.obj",
        "package:///bot/meshes/part.obj",
        "../../../meshes/part.obj",
        "meshes/part.obj",  # which PyBullet finds by its search path
    ],
)
def test_a_mesh_is_found_in_a_folder_above_the_file(workspace, name):
    found = find_asset(name, write(workspace, name))
    assert found is not None
    assert found.resolve() == workspace / "share" / "bot" / "meshes" / "part.obj"


def test_a_package_is_found_whose_folder_has_another_name(workspace):
    found = find_asset("package://bot_description/meshes/part.obj", write(workspace, ""))
    assert found == workspace / "share" / "bot" / "meshes" / "part.obj"


@pytest.mark.parametrize("entry", ["ws", "ws/bot"])
def test_a_package_is_found_in_ros_package_path(workspace, monkeypatch, tmp_path, entry):
    (tmp_path / "ws" / "bot").mkdir(parents=True)
    (tmp_path / "ws" / "bot" / "part.obj").write_text(TETRAHEDRON)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / entry}")
    found = find_asset("package://bot/part.obj", write(workspace, ""))
    assert found == tmp_path / "ws" / "bot" / "part.obj"


def test_a_robot_with_its_mesh_collides_by_the_hull_of_it(workspace):
    path = write(workspace, "package://bot/meshes/part.obj")
    builder, notes = read_asset(path, "avbd", floating=True)
    assert notes == ()
    assert builder.shape_type == [newton.GeoType.CONVEX_MESH, newton.GeoType.SPHERE]


@pytest.mark.parametrize(
    ("mesh", "remedy"),
    [
        ("package://other/part.stl", "set ROS_PACKAGE_PATH to the folder that holds the package"),
        ("file:///other/part.stl", "there is no such file"),
        ("../part.stl", "there is no such file"),
    ],
)
def test_a_missing_mesh_is_named_and_the_rest_is_read(workspace, mesh, remedy):
    path = write(workspace, mesh)
    root, absent = read_urdf(path)
    assert absent == (mesh,)
    assert "part.stl" not in ElementTree.tostring(root, encoding="unicode")
    builder, (note,) = read_asset(path, "avbd", floating=True)
    assert note == f"bot.urdf goes on without {mesh}: {remedy}"
    assert builder.shape_type == [newton.GeoType.SPHERE]


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("part.obj", "v 0 0 0\n", "it "),  # without triangles
        # no XML: its reader fails with a message that does not name the file
        ("part.dae", "<COLLADA><a></COLLADA>", "it cannot be loaded: "),
    ],
)
def test_a_mesh_that_cannot_be_read_is_named_and_the_rest_is_read(workspace, name, content, reason):
    path = write(workspace, f"package://bot/meshes/{name}")
    (workspace / "share" / "bot" / "meshes" / name).write_text(content)
    builder, (note,) = read_asset(path, "avbd", floating=True)
    assert f"{name}: {reason}" in note
    assert builder.shape_type == [newton.GeoType.SPHERE]


def test_run_says_which_mesh_is_missing(workspace, capsys):
    path = write(workspace, "package://other/part.stl")
    assert main(["run", str(path), "--solver", "xpbd", "--frames", "1"]) == 0
    assert "goes on without package://other/part.stl" in capsys.readouterr().err


def test_a_robot_without_mass_says_that_its_meshes_are_missing(workspace, capsys):
    """Links without ``<inertial>`` weigh what their shapes do."""
    path = write(workspace, "")
    shape = '<collision><geometry><mesh filename="package://x/{}.stl"/></geometry></collision>'
    links = "".join(f'<link name="{name}">{shape.format(name)}</link>' for name in "ab")
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
    path.write_text(f'<robot name="bot">{links}{joint}</robot>')
    assert main(["run", str(path)]) != 0
    said = capsys.readouterr().err
    assert "cannot run with avbd: The articulation of body" in said
    assert "has neither mass nor armature" in said
    for name in "ab":
        assert f"bot.urdf goes on without package://x/{name}.stl: set ROS_PACKAGE_PATH" in said
