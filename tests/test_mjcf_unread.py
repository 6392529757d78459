# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What goes unread of MJCF files is named, with a remedy.

Solvers that take light links have joints of their own for some of it (``test_mjcf_rewriting.py``);
SolverXPBD does not.
"""

import re
from pathlib import Path

import mujoco
import newton
import numpy as np
import pytest

from newton_avbd.io.assets import read_asset
from newton_avbd.io.errors import UserError
from newton_avbd.io.opening import open_scene
from newton_avbd.io.simulation import Request

SCENE = """<mujoco><option gravity="0 0 -1.6" density="1000"/>
<default><joint damping="2"/>
<default class="arm"><joint actuatorfrcrange="-1 5"/></default></default>
<worldbody><site name="hook" pos="0 0 1"/>
<body name="ball"><joint name="swivel" type="ball" range="0 20"/><joint name="lost" type="slide"/>
<geom name="egg" size="0.1" fluidshape="ellipsoid"/></body>
<body name="free"><joint type="free"/><geom size="0.1"/></body>
<body name="plain" pos="1 0 0"><freejoint/><geom size="0.1"/></body>
<body name="arm" pos="2 0 0" childclass="arm"><joint name="first" axis="0 1 0"/>
<joint name="second" axis="1 0 0" pos="0 0.1 0"/><joint name="rail" type="slide"/>
<geom size="0.1"/><site name="tip"/></body>
<body name="hand" mocap="true"><geom size="0.1"/></body></worldbody>
<equality><connect name="rope" site1="hook" site2="tip"/></equality>
<actuator><position class="arm" joint="first"/><orientation name="turn" joint="swivel" kp="1"/>
</actuator></mujoco>"""
"""A file that has all of it; some by default classes."""

FOUND = (
    r"1 actuator \('turn' \(<orientation>\)\)",
    r"the range of 1 ball joint \('swivel'\)",
    r"the damping of 1 free joint \(that of body 'free'\)",
    r"the pos of 1 joint \('second'\)",
    r"the order of the joints of 1 body \('arm'\)",
    r"the joints after the ball joint of 1 body \('ball'\)",
    r"the smaller end of the actuatorfrcrange of 3 joints \('first', 'second', 'rail'\)",
    r"the fluidshape of 1 geom \('egg'\)",
    r"the mocap of 1 body \('hand'\)",
    r"the frame of site2 of 1 equality constraint \('rope'\)",
    r"its gravity \(0, 0, -1\.6\).*\(0, 0, -9\.81\)",
)
LOST = """<mujoco><compiler settotalmass="3"/><default><joint damping="3"/></default>
<asset><model name="other" file="other.xml"/></asset><worldbody>
<body name="a"><frame><joint name="framed"/></frame><geom size="0.1"/></body>
<body name="b"><joint name="kept"/><geom size="0.1"/>
<attach model="other" body="c" prefix="p"/></body>
<replicate count="2"><body><joint/><geom size="0.1"/></body></replicate>
<frame><flexcomp name="cloth"/><composite prefix="rope"/></frame></worldbody>
<actuator><position name="eager" joint="kept" inheritrange="1"/></actuator></mujoco>"""
"""A file of which the most is lost, since MuJoCo's compiler refuses it, too."""
LOST_FOUND = (
    r"has <replicate>, <attach>, <composite>, inheritrange of actuators, settotalmass of "
    r"<compiler>, joints in a <frame>, which Newton's importer does not read, and MuJoCo's "
    r"compiler refuses it: ",
    r"1 <replicate> element \(that of the world\).* mujoco.mj_saveLastXML",
    r"1 <attach> element \('other'\)",
    r"1 <composite> element \('rope'\)",
    r"1 <flexcomp> element \('cloth'\)",
    r"1 joint \('framed' \(in a <frame>\)\).*: a body without another joint is fixed",
    r"the inheritrange of 1 actuator \('eager'\)",
    r"the settotalmass of 1 <compiler> \(3 kg\)",
)
PLAIN = """<mujoco><option gravity="0 0 -9.81"/>
<default><default class="off"><equality active="false"/></default></default>
<worldbody><site name="hook"/>
<body name="ball"><joint type="ball" limited="false" range="0 20"/><geom size="0.1"/></body>
<body name="arm"><joint name="rail" type="slide" pos="0.1 0 0" actuatorfrcrange="-5 5"/>
<joint name="first" axis="0 1 0" pos="0.1000000001 0.3 0" damping="1"/>
<geom size="0.1" fluidshape="ellipsoid"/>
<site name="tip"/><site name="turned" euler="90 0 0"/><site name="far" pos="1 0 0"/></body>
</worldbody>
<equality><connect site1="hook" site2="tip"/><connect site1="hook" site2="far" active="false"/>
<connect class="off" site1="hook" site2="far"/>
<weld site1="hook" site2="turned" torquescale="0"/></equality>
<actuator><position joint="first" kp="3"/></actuator></mujoco>"""
"""The same elements, of which nothing is lost."""


def write(folder: Path, text: str) -> Path:
    path = folder / "scene.xml"
    path.write_text(text)
    return path


@pytest.mark.filterwarnings("ignore:.*Parallel joints")
def test_each_kind_is_named_once(tmp_path: Path) -> None:
    """In one sentence with names, also where a default class or an included file says it."""
    write(tmp_path, SCENE).rename(tmp_path / "inner.xml")
    path = write(tmp_path, '<mujoco><include file="inner.xml"/></mujoco>')
    notes = read_asset(path, "xpbd", floating=True)[1]
    assert len(notes) == len(FOUND)
    for note, pattern in zip(notes, FOUND, strict=True):
        assert note.startswith("scene.xml goes on without ")
        assert re.search(pattern, note), note


def test_what_is_lost_with_all_that_is_in_it_is_named(tmp_path: Path) -> None:
    """Newton's importer says nothing, and makes two bodies."""
    builder, notes = read_asset(write(tmp_path, LOST), "xpbd", floating=True)
    assert len(notes) == len(LOST_FOUND)
    for note, pattern in zip(notes, LOST_FOUND, strict=True):
        assert re.search(pattern, note), note
    assert builder.body_count == 2
    assert builder.joint_type[0] == newton.JointType.FIXED


def test_a_file_that_is_empty_without_it_says_so(tmp_path: Path) -> None:
    """With what it has, and why that is not there."""
    body = '<replicate count="2"><body><geom/></body></replicate>'
    path = write(tmp_path, f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    why = r"no rigid bodies\n.* has <replicate>.* MuJoCo's compiler refuses it: .*size"
    with pytest.raises(UserError, match=why):
        open_scene(str(path), Request())


def test_a_second_default_adds_to_the_first(tmp_path: Path) -> None:
    """As in MuJoCo, also where the class is called by its name."""
    joint = '<joint class="main" actuatorfrcrange="-1 5"/><joint name="s" pos="0.1 0 0"/>'
    text = (
        '<default><joint actuatorfrclimited="false"/></default><default><joint pos="0.1 0 0"/>'
        f'</default><worldbody><body>{joint}<geom size="0.1"/></body></worldbody>'
    )
    assert read_asset(write(tmp_path, f"<mujoco>{text}</mujoco>"), "xpbd", floating=True)[1] == ()


def test_what_is_read_is_not_named(tmp_path: Path) -> None:
    assert read_asset(write(tmp_path, PLAIN), "xpbd", floating=True)[1] == ()


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ('name="o" damping=".1 .3"', r"joint 'o' has damping=\"\.1 \.3\", a polynomial"),
        ('stiffness="1 5"', "a joint of body 'b' has stiffness"),
        ('name="s" type="slide"/><joint name="b" type="ball"', "joint 'b' is a ball after another"),
    ],
)
def test_a_joint_that_the_importer_fails_at_is_named(
    tmp_path: Path, joint: str, message: str
) -> None:
    path = write(
        tmp_path,
        f'<mujoco><worldbody><body name="b"><joint {joint}/><geom size="0.1"/></body></worldbody>'
        "</mujoco>",
    )
    with pytest.raises(UserError, match=message):
        read_asset(path, "xpbd", floating=True)


@pytest.mark.parametrize("kind", ["spatial", "fixed"])
def test_a_tendon_that_the_importer_fails_at_is_named(tmp_path: Path, kind: str) -> None:
    path = {
        "spatial": '<site site="a"/><site site="c"/>',
        "fixed": '<joint joint="j" coef="1"/>',
    }[kind]
    text = f"""<mujoco><default><tendon stiffness="0 200"/></default><worldbody><site name="a"/>
    <body pos="1 0 0"><joint name="j"/><geom size="0.1"/><site name="c"/></body></worldbody>
    <tendon><{kind} name="soft">{path}</{kind}></tendon></mujoco>"""
    with pytest.raises(UserError, match=r"tendon 'soft' has stiffness=\"0 200\", a polynomial"):
        read_asset(write(tmp_path, text), "avbd", floating=True)


def test_a_body_without_a_name_is_called_so(tmp_path: Path) -> None:
    text = '<mujoco><worldbody><body mocap="true"><joint {}/><geom size="0.1"/></body></worldbody>'
    path = write(tmp_path, text.format('stiffness="1 5"') + "</mujoco>")
    with pytest.raises(UserError, match="a joint of a body without a name has stiffness"):
        read_asset(path, "xpbd", floating=True)
    path = write(tmp_path, text.format('type="ball" range="0 20"') + "</mujoco>")
    ball, mocap = read_asset(path, "xpbd", floating=True)[1]
    assert "(that of a body without a name)" in ball
    assert "(one without a name)" in mocap


@pytest.mark.parametrize(
    "joint",
    ['type="free" damping="0 1"', 'type="ball"/><joint type="slide" damping="0 1"'],
)
def test_a_polynomial_that_the_importer_does_not_read_is_not_refused(
    tmp_path: Path, joint: str
) -> None:
    """It stops at the first free or ball joint of a body."""
    body = f'<body><joint {joint}/><geom size="0.1"/></body>'
    path = write(tmp_path, f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    mujoco.MjModel.from_xml_path(str(path))
    assert read_asset(path, "xpbd", floating=True)[0].body_count == 1


def test_the_remedy_for_a_time_constant_is_the_same_actuator() -> None:
    """As MuJoCo compiles both."""
    text = """<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
    <actuator><position joint="j" kp="3" kv="0.5" timeconst="0.1"/>
    <general joint="j" dyntype="filterexact" dynprm="0.1" gainprm="3" biastype="affine"
     biasprm="0 -3 -0.5"/></actuator></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    for name in ("dyntype", "dynprm", "gaintype", "gainprm", "biastype", "biasprm"):
        values = getattr(model, f"actuator_{name}")
        np.testing.assert_array_equal(values[0], values[1])
