# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MJCF files with what Newton's importer does not read are read as MuJoCo's compiler has them."""

import re
from pathlib import Path

import mujoco
import newton
import numpy as np
import pytest
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.io.assets import read_driven
from newton_avbd.io.errors import UserError
from newton_avbd.io.mjcf import add_mjcf
from newton_avbd.io.opening import open_scene, read_scene
from newton_avbd.io.simulation import Request
from newton_avbd.scenes.finalize import finalized

TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
BODY = '<body name="{}"><joint name="{}" {}/><geom size="0.1"/></body>'


def written(folder: Path, text: str, name: str = "scene.xml") -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return path


def named(labels: list[str]) -> list[str]:
    """The last parts of labels."""
    return [label.rpartition("/")[2] for label in labels]


def compare(path: Path, builder: newton.ModelBuilder) -> mujoco.MjModel:
    """Masses, places and damping, beside those of MuJoCo's compiler."""
    native = mujoco.MjModel.from_xml_path(str(path))
    now = mujoco.MjData(native)
    mujoco.mj_kinematics(native, now)
    bodies = named(builder.body_label)
    assert sorted(bodies) == sorted(native.body(i).name for i in range(1, native.nbody))
    state = builder.finalize().state()
    for body, (name, mass) in enumerate(zip(bodies, builder.body_mass, strict=True)):
        np.testing.assert_allclose(mass, native.body(name).mass[0], rtol=1.0e-5)
        pose = state.body_q.numpy()[body]
        np.testing.assert_allclose(pose[:3], now.body(name).xpos, atol=1.0e-5)
    return native


def test_what_is_replicated_and_composed_is_there(tmp_path: Path) -> None:
    """A ring of pendulums, and a cable, whose elasticity is named as it is lost."""
    path = written(
        tmp_path,
        f"""<mujoco><extension><plugin plugin="mujoco.elasticity.cable"/></extension>
        <default class="main"><joint damping="3"/></default><worldbody>
        <replicate count="3" euler="0 0 90" sep="_"><frame pos="1 0 0">{BODY.format("p", "j", "")}
        </frame></replicate>
        <composite type="cable" curve="s" count="4 1 1" size="1" offset="0 0 2" initial="none">
        <geom type="capsule" size=".01" rgba=".8 .2 .1 1"/><joint kind="main" damping=".01"/>
        <plugin plugin="mujoco.elasticity.cable"><config key="bend" value="4e6"/></plugin>
        </composite></worldbody></mujoco>""",
    )
    builder, notes = read_driven(path)
    compare(path, builder)
    assert builder.body_count == 6
    assert builder.joint_damping.count(3.0) == 3
    assert notes[0].startswith(
        "scene.xml is read as MuJoCo's compiler writes it: it has <replicate>, <composite>, which"
    )
    assert "without 3 plugins" in notes[1]
    assert len(notes) == 2


def test_a_file_that_is_attached_has_its_own_folder_and_classes(tmp_path: Path) -> None:
    """Also one that an attached one attaches, with a mesh of the same name elsewhere."""
    text = """<mujoco model="{0}"><compiler meshdir="meshes"/>
    <default class="main"><joint damping="{1}"/></default>
    <asset><mesh name="m" file="m.obj"/>{2}</asset>
    <worldbody><body name="arm"><joint name="j"/><geom type="mesh" mesh="m"/>{3}</body></worldbody>
    <actuator><motor name="act" joint="j"/></actuator></mujoco>"""
    attach = '<attach model="{}" body="arm" prefix="{}_"/>'
    model = '<model name="{0}" file="{1}.xml"/>'
    one = (model.format("one", "one/one"), attach.format("one", "l") + attach.format("one", "r"))
    two = (model.format("two", "../two/two"), attach.format("two", "in"))
    path = written(tmp_path, text.format("main", 1, *one))
    written(tmp_path / "one", text.format("one", 2, *two), "one.xml")
    written(tmp_path / "two", text.format("two", 3, "", ""), "two.xml")
    for scale, folder in enumerate((tmp_path, tmp_path / "one", tmp_path / "two"), 1):
        tetrahedron = TETRAHEDRON.replace(".1", f".{scale}")
        written(folder / "meshes", tetrahedron, "m.obj")
    builder, notes = read_driven(path)
    assert len(notes) == 1
    assert builder.joint_damping == [1.0, 2.0, 3.0, 2.0, 3.0]
    sizes = [0.1**3, 0.2**3, 0.3**3, 0.2**3, 0.3**3]
    np.testing.assert_allclose(builder.body_mass, 1000.0 / 6.0 * np.array(sizes), rtol=1.0e-4)
    labels = named(builder.custom_attributes["mujoco:actuator_label"].values)
    assert labels == ["act", "l_act", "l_in_act", "r_act", "r_in_act"]


def test_joints_in_frames_turn_as_the_frames_do(tmp_path: Path) -> None:
    """With places and axes of their default class, in frames in frames, in their order."""
    path = written(
        tmp_path,
        """<mujoco><compiler eulerseq="zyx"/><default><joint axis="0 1 0"/>
        <default class="in"><joint pos="0.1 0.2 0" damping="3"/></default></default><worldbody>
        <body name="a" pos="0 0 1"><frame pos="1 0 0" euler="20 30 40" childclass="in">
        <joint name="one"/><body name="b"><frame euler="10 0 0"><frame pos="0 2 0"
        axisangle="1 2 3 50"><joint name="two" class="main" type="slide"/></frame></frame>
        <geom size="0.1"/></body></frame><geom size="0.2"/></body></worldbody></mujoco>""",
    )
    builder, notes = read_driven(path)
    assert len(notes) == 1
    assert "joints in a <frame>" in notes[0]
    native = compare(path, builder)
    np.testing.assert_allclose(builder.joint_axis, native.jnt_axis, atol=1.0e-5)
    np.testing.assert_allclose(builder.joint_damping, [3.0, 0.0])
    np.testing.assert_allclose(builder.joint_X_c[0][:3], native.joint("one").pos, atol=1.0e-5)


def test_boxes_and_ellipsoids_span_from_one_point_to_another(tmp_path: Path) -> None:
    """Newton's importer makes cubes and balls of them, elsewhere."""
    geom = '<geom type="{}" size="0.1" fromto="0 0 0 1 0.5 0.2"/>'
    bodies = "".join(
        f'<body name="{kind}"><joint name="{kind}"/>{geom.format(kind)}</body>'
        for kind in ("box", "ellipsoid")
    )
    path = written(tmp_path, f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    builder, _ = read_driven(path)
    native = compare(path, builder)
    np.testing.assert_allclose(builder.body_com, native.body_ipos[1:], atol=1.0e-5)
    moments = [
        np.linalg.eigvalsh(np.array(matrix).reshape(3, 3)) for matrix in builder.body_inertia
    ]
    np.testing.assert_allclose(moments, np.sort(native.body_inertia[1:]), rtol=1.0e-4)


def test_boxes_of_the_world_span_too_where_a_class_or_a_frame_says_so(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        f"""<mujoco><default><default class="beam"><geom type="box" size=".1"/></default></default>
        <worldbody>{BODY.format("a", "a", "")}<frame childclass="beam">
        <geom fromto="0 0 1 2 0 1"/></frame></worldbody></mujoco>""",
    )
    builder, _ = read_driven(path)
    scale = next(builder.shape_scale[i] for i in range(2) if builder.shape_body[i] < 0)
    np.testing.assert_allclose(sorted(scale), [0.1, 0.1, 1.0], atol=1.0e-5)


def test_actuators_that_mujoco_writes_otherwise_are_the_same(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        f"""<mujoco><worldbody>{BODY.format("a", "a", "")}</worldbody><actuator>
        <cylinder name="c" joint="a" timeconst=".1" area="2" bias="1 2 3"/>
        <position name="p" joint="a" kp="3" kv=".5" timeconst=".2"/>
        <adhesion name="g" body="a" gain="5" ctrlrange="0 1"/></actuator></mujoco>""",
    )
    model = read_driven(path)[0].finalize()
    native = mujoco.MjModel.from_xml_path(str(path))
    assert named(model.mujoco.actuator_label) == ["c", "p", "g"]
    for name in ("dyntype", "dynprm", "gaintype", "gainprm", "biastype", "biasprm"):
        expected = getattr(native, f"actuator_{name}")
        given = getattr(model.mujoco, f"actuator_{name}").numpy()
        np.testing.assert_allclose(given, expected, rtol=1.0e-6, err_msg=name)


def test_actuators_inherit_the_range_of_what_they_push(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        f"""<mujoco><default><position inheritrange=".5"/></default><worldbody>
        {BODY.format("a", "a", 'range="-40 60"')}</worldbody><actuator>
        <position name="p" joint="a" kp="3"/>
        <intvelocity name="i" joint="a" kp="3" inheritrange="1"/></actuator></mujoco>""",
    )
    builder, notes = read_driven(path)
    assert "inheritrange of actuators" in notes[0]
    model = builder.finalize()
    native = mujoco.MjModel.from_xml_path(str(path))
    for name, row in (("ctrlrange", 0), ("actrange", 1)):
        given = getattr(model.mujoco, f"actuator_{name}").numpy()[row]
        expected = getattr(native, f"actuator_{name}")[row]
        assert expected[0] < expected[1]
        np.testing.assert_allclose(given, expected, rtol=1.0e-5)


def test_bodies_weigh_together_what_the_compiler_says(tmp_path: Path) -> None:
    """As the half cheetahs of gymnasium and dm_control, which are 1.5 times too heavy otherwise."""
    path = written(
        tmp_path,
        f"""<mujoco><compiler settotalmass="14"/><worldbody>
        {BODY.format("a", "a", "")}{BODY.format("b", "b", "")}</worldbody></mujoco>""",
    )
    builder, notes = read_driven(path)
    assert "settotalmass of <compiler>" in notes[0]
    native = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(builder.body_mass, native.body_mass[1:], rtol=1.0e-5)
    given = [np.diag(np.array(matrix).reshape(3, 3)) for matrix in builder.body_inertia]
    expected = native.body_inertia[1:]
    np.testing.assert_allclose(given, expected, rtol=1.0e-5)


def test_actuators_of_all_kinds_share_their_defaults(tmp_path: Path) -> None:
    """As in MuJoCo: a gear of ``<general>`` is that of motors, too."""
    path = written(
        tmp_path,
        f"""<mujoco><default><general gear="5" ctrlrange="-2 2" forcerange="-9 9"/>
        <default class="in"><position kp="7" gear="4"/></default></default>
        <worldbody>{BODY.format("a", "a", "")}</worldbody><actuator>
        <motor name="m" joint="a"/><position name="p" joint="a" kp="3" kv="2"/>
        <general name="g" joint="a" class="in"/></actuator></mujoco>""",
    )
    builder, notes = read_driven(path)
    assert "a <default> of actuators of another kind" in notes[0]
    model = builder.finalize()
    native = mujoco.MjModel.from_xml_path(str(path))
    assert named(model.mujoco.actuator_label) == ["m", "p", "g"]
    kinds = ("gear", "ctrlrange", "forcerange", "gaintype", "gainprm", "biastype", "biasprm")
    for name in kinds:
        expected = getattr(native, f"actuator_{name}")
        given = getattr(model.mujoco, f"actuator_{name}").numpy()
        np.testing.assert_allclose(given, expected, rtol=1.0e-6, err_msg=name)


def after(path: Path, controls: list[float], dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates after 0.3 s in SolverAVBD and in MuJoCo."""
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    add_mjcf(builder, path, ctrl_direct=True)
    model = builder.finalize()
    solver, state, control = SolverAVBD(model), model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    control.mujoco.ctrl.assign(controls)
    native = mujoco.MjModel.from_xml_path(str(path))
    native.opt.timestep = dt
    now = mujoco.MjData(native)
    now.ctrl[:] = controls
    for _ in range(round(0.3 / dt)):
        solver.step(state, state, control, None, dt)
        mujoco.mj_step(native, now)
    newton.eval_ik(model, state, state.joint_q, state.joint_qd)
    return state.joint_q.numpy(), now.qpos


GROUPS = f"""<mujoco><option actuatorgroupdisable="0 2"><flag gravity="disable"/></option>
<default><default class="off"><position group="2" kp="40" ctrlrange="-1 1"/>
</default></default><worldbody>{BODY.format("a", "a", "")}
{BODY.format("b", "b", "").replace("<body", '<body pos="1 0 0"')}</worldbody><actuator>
<position name="p" class="off" joint="a" armature="0.02" damping="0.03"/>
<motor name="m" joint="a" group="1" gear="2"/><motor name="n" joint="b"/>
<general name="g" joint="b" group="3" dyntype="filter" dynprm="0.1" gainprm="3"/></actuator>
</mujoco>"""
"""Two joints with an actuator each of a disabled group, one by its class and one by default."""


def test_actuators_of_disabled_groups_exert_no_force(tmp_path: Path) -> None:
    """They keep their controls, and what they add to the armature and the damping of a joint."""
    path = written(tmp_path, GROUPS)
    builder, notes = read_driven(path)
    assert notes == (
        "scene.xml disables the groups of 2 actuators ('p', 'n'), which exert no force",
    )
    assert named(builder.custom_attributes["mujoco:actuator_label"].values) == ["p", "m", "n", "g"]
    has, wants = after(path, [1.0, 0.5, 0.7, 0.9], 1.0e-3)
    np.testing.assert_allclose(has, wants, rtol=0.01)
    assert np.all(wants > 0.1)


def test_a_disabled_position_actuator_is_no_drive_either(tmp_path: Path) -> None:
    """Newton's importer makes drives of joints of such actuators, where it may."""
    for groups, gains in (("1", [40.0, 0.0]), ("2", [0.0, 0.0])):
        path = written(tmp_path, GROUPS.replace("0 2", groups))
        model = open_scene(str(path), Request()).model
        np.testing.assert_array_equal(model.joint_target_ke.numpy(), gains)


@pytest.mark.parametrize("groups", ["31", "-1", "1 two"])
def test_groups_that_there_are_not_are_named(tmp_path: Path, groups: str) -> None:
    path = written(tmp_path, GROUPS.replace("0 2", groups))
    with pytest.raises(UserError, match=r"disables group .* of actuators\. Write groups from 0 to"):
        open_scene(str(path), Request())


def test_springs_by_time_constant_are_those_that_mujoco_finds(tmp_path: Path) -> None:
    """Also of a default class, and of joints in the tree of others."""
    path = written(
        tmp_path,
        f"""<mujoco><default><default class="s"><joint springdamper="0.1 0.7"/></default></default>
        <worldbody>{BODY.format("a", "a", 'class="s"')}
        <body name="b"><joint name="b" stiffness="2" damping="1"/><geom size="0.1"/>
        <body name="c" pos="1 0 0"><joint name="c" springdamper="0.2 1" stiffness="9"/>
        <geom size="0.2"/></body></body></worldbody></mujoco>""",
    )
    builder, notes = read_driven(path)
    assert [re.sub(".*springdamper", "", note) for note in notes] == [": 'a', 'c'"]
    native = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(builder.joint_damping, native.dof_damping, rtol=1.0e-6)
    np.testing.assert_allclose(builder.joint_stiffness, native.jnt_stiffness, rtol=1.0e-6)


SEVERAL = """<mujoco><worldbody><body name="base"><geom name="base" size="0.3"/><joint name="turn"/>
  <body name="arm" pos="0.5 0 0" euler="0 0 30" gravcomp="0.5" childclass="soft">
    <joint name="lift" axis="0 1 0" pos="0 0 0.1"/>{}
    <geom name="arm" type="capsule" fromto="0 0 0 0.4 0 0.1" size="0.05" mass="2"/>
    <body name="hand" pos="0.4 0 0.1"><joint name="grip" axis="1 1 0"/>
    <geom name="hand" type="box" size="0.1 0.05 0.02"/></body></body></body></worldbody>
  <default><default class="soft"><joint damping="0.3"/></default></default>
  <tendon><fixed name="t"><joint joint="swing" coef="1"/><joint joint="grip" coef="-0.7"/></fixed>
  </tendon><actuator><motor name="m" tendon="t"/><position name="p" joint="lift" kp="9" kv="1"/>
  </actuator></mujoco>"""
"""An arm whose body has several joints, of which a tendon combines one."""
JOINTS = {
    "a tendon": '<joint name="swing" axis="0 0 1" pos="0 0 0.1"/>',
    "two places": '<joint name="swing" axis="1 0 0" pos="0 0.2 0"/>',
    "a slide after a hinge": '<joint name="swing" type="slide" axis="0 0 1" pos="0 0 0.1"/>',
}


@pytest.mark.parametrize("swing", JOINTS.values(), ids=JOINTS)
def test_several_joints_of_a_body_move_it_as_in_mujoco(tmp_path: Path, swing: str) -> None:
    """Driven for 0.4 s. Bound: 1 % of how far bodies move; MuJoCo's own error is 0.3 %.

    Newton's importer has the tendon without the joint, or takes the joint for another one, which
    moves the hand elsewhere by a tenth of its way or more.
    """
    path = written(tmp_path, SEVERAL.format(swing))
    builder, notes = read_driven(path)
    assert notes[0].startswith("scene.xml gets bodies of 1e-09 kg for joints of 'arm': Newton's")
    assert len(notes) == 1
    model = builder.finalize()
    solver, state, control = SolverAVBD(model), model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    native = mujoco.MjModel.from_xml_path(str(path))
    native.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    dt = native.opt.timestep = 1.0 / 1000.0
    now = mujoco.MjData(native)
    mujoco.mj_kinematics(native, now)
    places = [named(builder.body_label).index(native.body(i).name) for i in range(1, native.nbody)]
    start = now.xpos[1:].copy()
    np.testing.assert_allclose(state.body_q.numpy()[places, :3], start, atol=1.0e-6)
    now.ctrl[:] = 3.0, 0.5
    control.mujoco.ctrl.assign([3.0, 0.5])
    for _ in range(400):
        solver.step(state, state, control, None, dt)
        mujoco.mj_step(native, now)
    mujoco.mj_kinematics(native, now)
    moved = np.linalg.norm(now.xpos[1:] - start, axis=1)
    off = np.linalg.norm(state.body_q.numpy()[places, :3] - now.xpos[1:], axis=1)
    assert moved[2] > 0.1
    assert np.all(off <= 0.01 * np.maximum(moved, 0.01))


def test_bodies_with_light_ones_between_pass_each_other(tmp_path: Path) -> None:
    """As a body and the one that it is in; not those that are farther apart."""
    builder, _ = read_driven(written(tmp_path, SEVERAL.format(JOINTS["two places"])))
    shapes = named(builder.shape_label)
    pairs = {frozenset((shapes[a], shapes[b])) for a, b in builder.shape_collision_filter_pairs}
    assert pairs == {frozenset(("base", "arm")), frozenset(("arm", "hand"))}


def test_solvers_that_take_no_light_bodies_get_none(tmp_path: Path) -> None:
    """A comparison with such a solver has the same bodies in both."""
    path = written(tmp_path, SEVERAL.format(JOINTS["two places"]))
    counts = [
        open_scene(str(path), Request(solver, light_links=light)).model.body_count
        for solver, light in (("avbd", True), ("xpbd", True), ("avbd", False))
    ]
    assert counts == [4, 3, 3]


def test_slides_are_where_the_hinges_of_their_body_are(tmp_path: Path) -> None:
    """Their place says nothing: a planar root needs no body more."""
    joints = (
        '<joint name="x" type="slide" axis="1 0 0" pos="0 0 -1"/><joint name="z" type="slide" '
        'pos="0 0 -1"/><joint name="y" axis="0 1 0" pos="0 0 0.2"/>'
    )
    body = f'<body name="b">{joints}<geom size="0.1"/></body>'
    path = written(tmp_path, f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    builder, notes = read_driven(path)
    assert (builder.body_count, notes) == (1, ())
    np.testing.assert_allclose(builder.joint_X_c[0][:3], [0.0, 0.0, 0.2], atol=1.0e-6)


def test_small_moments_of_inertia_are_as_the_file_has_them(tmp_path: Path) -> None:
    """To less than 1e-10 kg m^2 Newton adds 1e-6 kg m^2."""
    inertial = '<inertial pos="0 0 0" mass="1e-5" diaginertia="2e-10 2e-10 3e-11"/>'
    body = f'<body name="claw"><joint/>{inertial}</body>'
    path = written(tmp_path, f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    models = (
        open_scene(str(path), Request()).model,
        read_scene(str(path))[0].model(device="cpu"),
    )
    for model in models:
        inertia = model.body_inertia.numpy()[0]
        np.testing.assert_allclose(inertia, np.diag([2.0e-10, 2.0e-10, 3.0e-11]), rtol=1.0e-5)


def test_moments_of_inertia_that_no_body_has_are_corrected_as_before() -> None:
    builder = newton.ModelBuilder()
    builder.add_body(mass=1.0, inertia=wp.mat33(2.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.5))
    with pytest.warns(UserWarning, match="Inertia"):
        moments = finalized(builder).body_inertia.numpy()[0].diagonal()
    assert moments[0] <= moments[1] + moments[2] + 1.0e-5


@pytest.mark.parametrize("name", ["", ' class="main"'])
@pytest.mark.parametrize("is_late", [False, True])
def test_default_classes_add_up(tmp_path: Path, name: str, is_late: bool) -> None:
    """The outermost one acts on all, by whichever name, and is that of what names it.

    A class has what was said before it was made, as in MuJoCo.
    """
    joint = BODY.format("{0}", "{0}", "{1}")
    made = '<default class="in"><joint damping="5"/></default>'
    path = written(
        tmp_path,
        f"""<mujoco><default{name}><joint damping="3"/>{made * is_late}</default>
        <default{name}><joint armature="2"/>{made * (not is_late)}</default>
        <worldbody>{joint.format("a", "")}
        <body name="c" childclass="in"><joint name="c"/><geom size="0.1"/>
        {joint.format("d", 'class="main"')}</body></worldbody></mujoco>""",
    )
    builder, notes = read_driven(path)
    assert len(notes) == is_late
    if is_late:
        late = "<joint armature=\"2\"/> in a <default> below the one that has class 'in'"
        assert late in notes[0] and "move it above the class" in notes[0]
    native = mujoco.MjModel.from_xml_path(str(path))
    assert named(builder.joint_label) == [native.joint(i).name for i in range(3)]
    np.testing.assert_allclose(builder.joint_damping, native.dof_damping, rtol=1.0e-6)
    np.testing.assert_allclose(builder.joint_armature, native.dof_armature, rtol=1.0e-6)


def test_a_file_that_uses_all_of_it_moves_as_in_mujoco(tmp_path: Path) -> None:
    """Motors on pendulums of a replicate, whose joints are in frames, with defaults called main.

    The bound is 1 % of how far they move: MuJoCo's own step, of first order, is off by 0.2 %.
    """
    path = written(
        tmp_path,
        """<mujoco><default class="main"><joint damping="0.2" armature="0.05"/></default>
        <worldbody><replicate count="2" euler="0 0 70" sep="_"><body name="p" pos="1 0 0">
        <frame pos="0 0.1 0.3" euler="30 0 0"><joint name="j"/></frame>
        <geom type="capsule" fromto="0 0 0 0.3 0 -0.2" size="0.05" mass="2"/></body></replicate>
        </worldbody></mujoco>""",
    )
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    add_mjcf(builder, path, ctrl_direct=True)
    model = builder.finalize()
    model.joint_qd.assign([3.0, -2.0])
    solver, state, dt = SolverAVBD(model), model.state(), 1.0 / 1000.0
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    native = mujoco.MjModel.from_xml_path(str(path))
    native.opt.timestep = dt
    now = mujoco.MjData(native)
    now.qvel[:] = 3.0, -2.0
    for _ in range(400):
        solver.step(state, state, None, None, dt)
        mujoco.mj_step(native, now)
    mujoco.mj_kinematics(native, now)
    places = np.array([now.body(name).xpos for name in named(model.body_label)])
    start = mujoco.MjData(native)
    mujoco.mj_kinematics(native, start)
    moved = np.linalg.norm(places - start.xpos[1:], axis=1)
    off = np.linalg.norm(state.body_q.numpy()[:, :3] - places, axis=1)
    assert np.all(moved > 0.05)
    assert np.all(off < 0.01 * moved)
