# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""URDF files that other programs read are read likewise, and mistakes in them are named."""

import math
from pathlib import Path

import newton
import numpy as np
import pytest

from newton_avbd.__main__ import main
from newton_avbd.io.assets import open_asset, read_asset
from newton_avbd.io.errors import UserError
from newton_avbd.io.simulation import ModelSimulation, Request

INERTIAL = """<inertial><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""
SPHERE = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
LIMIT = '<limit lower="-3" upper="3" effort="10" velocity="100"/>'


def link(name: str, content: str = INERTIAL + SPHERE) -> str:
    return f'<link name="{name}">{content}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", content: str = LIMIT) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="0 1 0"/>{content}</joint>'
    )


def write(folder: Path, content: str) -> Path:
    path = folder / "bot.urdf"
    path.write_text(f'<robot name="bot">{content}</robot>')
    return path


def run(path: Path, frames: int) -> ModelSimulation:
    simulation = open_asset(path, Request(solver="avbd"))
    for _ in range(frames):
        simulation.advance()
    return simulation


@pytest.mark.parametrize("content", ["", '<inertial><mass value="0"/></inertial>'])
def test_a_root_without_mass_is_fixed_and_bears_a_pendulum(tmp_path, content):
    bob = link("bob", INERTIAL.replace("<inertial>", '<inertial><origin xyz="0.5 0 0"/>'))
    path = write(tmp_path, link("world", content) + bob + joint("hinge", "world", "bob"))
    _, notes = read_asset(path, "avbd", floating=True)
    assert "has no mass, so it is fixed to the world" in notes[0]
    simulation = open_asset(path, Request(solver="avbd"))
    angles = []
    for _ in range(60):
        simulation.advance()
        q = simulation.state.body_q.numpy()
        assert np.abs(q[:, :3]).max() < 1e-6
        angles.append(2.0 * math.atan2(q[1, 4], q[1, 6]))
    # A pendulum that is let go at the level of its hinge reaches the bottom after a quarter of
    # its period, 1.8541 sqrt(I/(m g r)), with I = 0.26 kg m^2.
    quarter = 1.8541 * math.sqrt(0.26 / (9.81 * 0.5))
    bottom = np.interp(math.pi / 2.0, angles, np.arange(1, 61) / 60.0)
    assert bottom == pytest.approx(quarter, rel=2e-3)


def test_a_table_of_welded_links_without_mass_is_fixed(tmp_path):
    top = SPHERE + '<inertial><mass value="0"/></inertial>'
    weld = joint("weld", "world", "top", "fixed", '<origin xyz="0 0 0.6"/>')
    path = write(tmp_path, link("world", "") + link("top", top) + weld)
    _, notes = read_asset(path, "avbd", floating=True)
    assert "its root 'world' has no mass, so it is fixed to the world" in notes[0]
    assert run(path, 2).state.body_q.numpy()[1, 2] == pytest.approx(0.6, abs=1e-6)


def test_a_robot_starts_put_together_above_its_ground(tmp_path):
    """Links one above the other, 0.4 m apart: the lower one rests, the upper one on it.

    Newton's importer leaves both at the origin; then the first step closed the joint by 0.4 m.
    """
    weld = joint("weld", "a", "b", "fixed", '<origin xyz="0 0 0.4"/>')
    path = write(tmp_path, link("a") + link("b") + weld)
    simulation = run(path, 0)
    before = simulation.state.body_q.numpy()[:, 2]
    assert before == pytest.approx([0.0, 0.4], abs=1e-6)
    simulation.advance()
    # A clearance of 10 mm, of which a frame of free fall takes 1.4 mm.
    assert simulation.state.body_q.numpy()[:, 2] == pytest.approx(before, abs=2e-3)


def test_a_root_whose_welded_link_has_mass_floats(tmp_path):
    body = link("base_footprint", "") + link("body") + link("leg")
    weld = joint("weld", "base_footprint", "body", "fixed", "")
    path = write(tmp_path, body + weld + joint("hip", "body", "leg"))
    builder, notes = read_asset(path, "avbd", floating=True)
    assert notes == ()
    # A hinge between links of which nothing holds the first: seven and one coordinates.
    assert builder.joint_coord_count == 8


def test_a_link_that_floats_on_an_empty_root_is_the_root(tmp_path):
    """A joint of type ``floating`` on ``world``, as in files for MuJoCo; it says where it starts.

    MuJoCo refuses a free joint below a link.
    """
    free = joint("free", "world", "body", "floating", '<origin xyz="1 2 3" rpy="0 0 0.5"/>')
    path = write(tmp_path, '<link name="world"/>' + link("body") + free)
    builder, notes = read_asset(path, "avbd", floating=True)
    assert notes == ()
    assert builder.joint_type == [newton.JointType.FREE]
    assert builder.joint_parent == [-1]
    turned = [0.0, 0.0, math.sin(0.25), math.cos(0.25)]
    assert list(builder.body_q[0]) == pytest.approx([1.0, 2.0, 3.0, *turned], abs=1e-6)


@pytest.mark.parametrize("point", ['<sphere radius="0.0"/>', '<box size="0 0 0"/>'])
def test_a_body_stands_on_shapes_of_size_zero_with_any_solver(tmp_path, point):
    """Soles of humanoids are such points; SolverMuJoCo refuses a shape of size zero."""
    shape = f"<collision>{{}}<geometry>{point}</geometry></collision>"
    sole = "".join(
        shape.format(f'<origin xyz="{x} {y} -0.2"/>') for x in (-0.1, 0.1) for y in (-0.1, 0.1)
    )
    mark = joint("weld", "body", "mark", "fixed", '<origin xyz="0 0 0.5"/>')
    body = link("body", INERTIAL + sole) + link("mark", shape.format(""))
    builder, notes = read_asset(write(tmp_path, body + mark), "mujoco", floating=True)
    assert notes == ()
    assert builder.body_mass == [1.0, 0.0]
    assert len(builder.shape_type) == 5
    for solver in ("avbd", "mujoco"):
        simulation = open_asset(tmp_path / "bot.urdf", Request(solver=solver))
        for _ in range(30):
            simulation.advance()
        # A ground was put 10 mm under the points; MuJoCo's contacts give by less than 1 mm.
        height = simulation.state.body_q.numpy()[0, 2]
        assert height == pytest.approx(-0.01, abs=2e-5 if solver == "avbd" else 1e-3)


def test_a_capsule_is_as_long_as_the_file_says(tmp_path):
    capsule = '<collision><geometry><capsule radius="0.1" length="0.4"/></geometry></collision>'
    path = write(tmp_path, link("post", INERTIAL + capsule))
    path.write_text(path.read_text().replace("<collision>", '<collision><origin xyz="0 0 0.3"/>'))
    # Upright, it stands on its lower end, which is 0.2 + 0.1 m below its center.
    simulation = run(path, 10)
    assert simulation.state.body_q.numpy()[0, 2] == pytest.approx(0.0, abs=1e-4)


def test_crossed_limits_are_none(tmp_path):
    """PyBullet's files write so; the slide falls from its limits of 1 and -1 m as if free."""
    slide = joint("slide", "world", "a", "prismatic", '<limit lower="1" upper="-1"/>')
    path = write(tmp_path, '<link name="world"/>' + link("a") + slide.replace("0 1 0", "0 0 1"))
    path.write_text(path.read_text().replace("<axis", '<origin xyz="0 0 9"/><axis'))
    _, notes = read_asset(path, "avbd", floating=True)
    assert "joint 'slide' has its lower limit above its upper one" in notes[0]
    # Half a second of free fall.
    fallen = 0.5 * 9.81 * 0.5**2
    assert run(path, 30).state.body_q.numpy()[1, 2] == pytest.approx(9.0 - fallen, rel=1e-3)


def test_a_link_whose_moments_of_inertia_are_negative_is_named(tmp_path):
    wrong = INERTIAL.replace('iyy="0.01"', 'iyy="-0.01"')
    path = write(tmp_path, link("a") + link("b", wrong) + joint("j", "a", "b"))
    _, notes = read_asset(path, "avbd", floating=True)
    assert len(notes) == 1
    assert "link 'b' has a negative moment of inertia, -0.01 kg m^2" in notes[0]


def test_blank_lines_before_the_declaration_and_zeros_after_the_end_are_read_over(tmp_path):
    path = write(tmp_path, link("a"))
    path.write_text(f'\n\n<?xml version="1.0"?>\n{path.read_text()}\r\n\0')
    builder, _ = read_asset(path, "avbd", floating=True)
    assert builder.body_mass == [1.0]


@pytest.mark.parametrize(
    ("attribute", "element"),
    [
        ('xmlns="http://drake.mit.edu"', ""),  # files of Drake declare a default namespace
        ("", '<sensor:camera name="eye"><link name="c"/></sensor:camera>'),
        ('xmlns:sensor="http://gazebosim.org"', '<sensor:camera sensor:rate="9"/>'),
    ],
)
def test_namespaces_are_read_over(tmp_path, attribute, element):
    path = write(tmp_path, link("a") + element + link("b") + joint("j", "a", "b"))
    path.write_text(path.read_text().replace("<robot", f"<robot {attribute}"))
    builder, _ = read_asset(path, "avbd", floating=True)
    assert builder.body_mass == [1.0, 1.0]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (link("a") + link("b") + joint("j", "a", "c"), "joint 'j' names a child link 'c'"),
        (link("a") + '<joint name="j" type="fixed"/>', "joint 'j' has no <parent link=...>"),
        (link("a") + link("b") + joint("j", "a", "b", "spherical"), "of type 'spherical'"),
        (link("a") + link("b") + link("c") + joint("j", "a", "b"), "2 links hang on nothing"),
        (
            link("a") + link("b") + link("c") + "".join(joint(p, p, "c") for p in "ab"),
            "link 'c' hangs on 'a' and on 'b'",
        ),
        (link("a") + link("b") + joint("j", "a", "b") + joint("k", "b", "a"), "go round"),
        (link("a") + link("a"), "link 'a' is there 2 times"),
        (
            link("a") + link("b") + joint("j", "a", "b", content='<origin xyz="0.07, 0 0"/>'),
            "<origin xyz='0.07, 0 0'> of joint 'j' has '0.07,', which is no number",
        ),
        (
            link("a") + link("b") + joint("j", "a", "b", content='<origin rpy="0 1 0 0"/>'),
            "has 4 numbers: write 3",
        ),
        (link("a", INERTIAL.replace('value="1"', 'value="-1"')), "of link 'a' is negative"),
        (link("a", INERTIAL.replace('ixx="0.01"', 'ixx="nan"')), "of link 'a' is not finite"),
    ],
)
def test_a_mistake_is_named_with_its_place(tmp_path, capsys, content, message):
    path = write(tmp_path, content)
    with pytest.raises(UserError) as error:
        read_asset(path, "avbd", floating=True)
    assert message in str(error.value)
    assert main(["run", str(path), "--frames", "1"]) == 2
    assert message in capsys.readouterr().err
