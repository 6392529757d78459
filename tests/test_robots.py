# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The gallery: robots have names, stand, are held by drives of known gains, and are judged."""

import math
from importlib import metadata
from pathlib import Path

import newton
import numpy as np
import pytest
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.__main__ import main
from newton_avbd.io import converted, robots
from newton_avbd.io.assets import read_asset
from newton_avbd.io.errors import UserError
from newton_avbd.io.opening import open_scene
from newton_avbd.io.robots import find_robot, read_robot
from newton_avbd.io.simulation import Request
from newton_avbd.scenes.pose import FREQUENCY, lowest_points, stand
from newton_avbd.study.robots.page import read_reports, summary, write_page
from newton_avbd.study.robots.run import Record
from newton_avbd.study.robots.torque import Torques
from newton_avbd.study.robots.trial import WRONG, Report, judge, try_robot
from newton_avbd.study.robots.wave import wave

ROUNDING = 1.0e-5


def pendulum(builder: newton.ModelBuilder, **options: float) -> None:
    """A point mass of 2 kg at 0.5 m from a hinge that is fixed to the world."""
    tiny = wp.mat33(np.eye(3) * 1.0e-6)
    link = builder.add_link(mass=2.0, inertia=tiny, com=wp.vec3(0.5, 0.0, 0.0))
    axis = wp.vec3(0.0, 1.0, 0.0)
    joint = builder.add_joint_revolute(-1, link, axis=axis, label="hinge", **options)
    builder.add_articulation([joint])


def test_every_robot_has_a_name_of_its_own():
    names = [name for robot in robots.robots() for name in (robot.name, *robot.aliases)]
    assert len(names) == len(set(names))
    assert find_robot("robot:nv_ant").path.name == "nv_ant.xml"
    assert find_robot("newton/cartpole.usda").path.name == "cartpole.usda"


def test_an_unknown_robot_is_answered_with_names_and_what_to_install(monkeypatch):
    def absent(package: str) -> None:
        raise metadata.PackageNotFoundError(package)

    with pytest.raises(UserError, match="Did you mean robot:newton/cartpole"):
        find_robot("robot:cartpole.us")
    monkeypatch.setattr(metadata, "distribution", absent)
    with pytest.raises(UserError, match="pip install example-robot-data"):
        find_robot("robot:nothing_like_this")


def test_a_drive_gets_the_gains_of_the_inertia_that_it_moves():
    builder = newton.ModelBuilder()
    pendulum(builder, armature=0.1)
    pose = stand(builder)
    inertia, speed = 2.0 * 0.5**2 + 0.1, 2.0 * math.pi * FREQUENCY
    assert pose.driven == [0]
    assert builder.joint_target_ke[0] == pytest.approx(inertia * speed**2, rel=ROUNDING)
    assert builder.joint_target_kd[0] == pytest.approx(2.0 * inertia * speed, rel=ROUNDING)


def test_a_drive_of_next_to_no_inertia_gets_the_gains_of_that():
    # 1e-9 kg m^2: to that Newton adds a thousand times as much where it corrects moments of inertia
    builder = newton.ModelBuilder()
    moments = wp.mat33(np.eye(3) * 5.0e-11)
    link = builder.add_link(mass=1.0e-5, inertia=moments, com=wp.vec3(0.01, 0.0, 0.0))
    joint = builder.add_joint_revolute(-1, link, axis=wp.vec3(0.0, 1.0, 0.0))
    builder.add_articulation([joint])
    stand(builder)
    inertia, speed = 1.0e-5 * 0.01**2 + 5.0e-11, 2.0 * math.pi * FREQUENCY
    assert builder.joint_target_ke[0] == pytest.approx(inertia * speed**2, rel=ROUNDING)


def test_gains_of_the_file_are_kept():
    builder = newton.ModelBuilder()
    pendulum(builder, target_ke=7.0, target_kd=3.0)
    stand(builder)
    assert (builder.joint_target_ke[0], builder.joint_target_kd[0]) == (7.0, 3.0)


def test_the_first_pose_and_the_motion_keep_the_limits():
    builder = newton.ModelBuilder()
    pendulum(builder, limit_lower=0.3, limit_upper=0.45)
    pose = stand(builder)
    assert builder.joint_q[0] == pytest.approx(0.3)
    seconds = np.linspace(0.0, 4.0, 200)
    targets = wave(builder, pose.driven, seconds, 1.0, 0.2)[:, 0]
    assert targets[0] == pytest.approx(0.3)
    assert 0.3 - ROUNDING < targets.min() < targets.max() < 0.45 + ROUNDING
    assert targets.max() > 0.44


def test_a_floating_robot_stands_on_the_ground():
    robot = find_robot("nv_ant")
    builder, _ = read_robot(robot)
    pose = stand(builder)
    assert pose.floating
    # Its file has a wall, no floor: it gets one at the height of its lowest point.
    lowest = lowest_points(builder.finalize(device="cpu"))[:-1].min()
    ground = builder.shape_type.index(newton.GeoType.PLANE, -1)
    assert lowest == pytest.approx(float(builder.shape_transform[ground][2]), abs=ROUNDING)


def judged(**changes) -> list[str]:
    """Failures of a run that is right but for ``changes``, beside a reference that is right."""
    right = {"lag": {"hinge:0": 0.01}, "law": {"hinge:0": 0.005}, "stroke": {"hinge:0": 0.1}}
    right |= {"weight": 20.0, "support": 20.0, "demand": 20.0}
    reference = Record(lag={"hinge:0": 0.01}, speed=0.0)
    return judge(Report("r", "p"), Record(**{**right, "speed": 0.0, **changes}), reference)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"finite": False}, "not finite"),
        ({"separation": 2.0e-4, "joint": "hinge"}, "hinge opens: 0.2 mm"),
        ({"misalignment": 2.0e-3, "joint": "hinge"}, "hinge opens"),
        ({"limit": 0.01}, "a limit is passed by 0.01"),
        ({"lag": {"hinge:0": 0.1}}, "1 of 1 drives do not follow, hinge by 0.09"),
        # A joint of a small range that does not move at all.
        ({"lag": {"hinge:0": 0.02}, "stroke": {"hinge:0": 0.02}}, "1 of 1 drives do not follow"),
        ({"support": 0.0}, "hangs in mid-air"),
        ({"support": 0.0, "demand": 0.0}, "falls past the ground"),
        ({"support": 19.0}, "contacts bear 19 N of 20 N"),
        ({"speed": 1.0}, "moves at 1 m/s"),
    ],
)
def test_each_fault_is_named(changes, complaint):
    (failure,) = judged(**changes)
    assert failure.startswith(complaint)


def test_what_is_right_passes():
    assert judged() == []
    assert judged(lag={"hinge:0": 0.025}) == []


def test_a_robot_of_newton_passes():
    robot = find_robot("cartpole_single_pendulum")
    report = Report(robot.name, robot.package)
    record = try_robot(report, lambda: read_robot(robot)[0], lambda *_: None, timed=False)
    assert report.failures == []
    assert record is not None and len(record.lag) == 2
    # Newton's second law gives the force of each drive, with the rounding of float32 velocities.
    assert 0.0 < max(record.wrong.values()) < WRONG


def test_a_drive_that_lags_passes_only_if_it_pushes_as_its_law_says():
    late = {"lag": {"hinge:0": 0.1}}
    assert judged(**late, wrong={"hinge:0": 0.01}) == []
    (failure,) = judged(**late, wrong={"hinge:0": 0.3})
    assert failure.endswith("by 0.09, with 30 % of its force wrong")


def test_a_force_that_is_not_the_law_s_is_told():
    # A pendulum of 2 kg at 0.5 m along x that holds still, about y: the drive bears
    # -m g r = -9.81 N m.
    builder = newton.ModelBuilder()
    pendulum(builder, target_ke=100.0, target_kd=10.0)
    model = builder.finalize(device="cpu")
    state, contacts = model.state(), newton.Contacts(1, 0, device="cpu")
    kind = newton.solvers.SolverBase.ObservableKind.CONTACT_F
    observables = SolverAVBD(model).observables([kind], contacts=contacts)
    torques = Torques(model, 0.01)
    torques.add(torques.start(state), state, np.array([-0.0981]), contacts, observables)
    assert torques.pushed[0] == pytest.approx(9.81, rel=ROUNDING)
    assert torques.wrong[0] == pytest.approx(0.0, abs=1.0e-4)
    torques.add(torques.start(state), state, np.array([-0.1981]), contacts, observables)
    assert torques.wrong[0] == pytest.approx(10.0, rel=1.0e-4)


def test_a_contact_pushes_where_it_was_at_the_start_of_the_step():
    # The pendulum holds still. A body flies by, 10 m/s along x, and in this step pushes with 10 N
    # downwards on the pendulum's center, 0.5 m from its own: the drive bears another -5 N m.
    builder = newton.ModelBuilder()
    pendulum(builder, target_ke=100.0, target_kd=10.0)
    passing = builder.add_body(mass=1.0, inertia=wp.mat33(np.eye(3)))
    shapes = [builder.add_shape_sphere(body, radius=0.1) for body in (passing, 0)]
    model = builder.finalize(device="cpu")
    before, after, contacts = model.state(), model.state(), newton.Contacts(1, 0, device="cpu")
    for state, x in ((before, 1.0), (after, 1.1)):
        poses = state.body_q.numpy()
        poses[passing, 0] = x
        state.body_q.assign(poses)
    contacts.rigid_contact_count.assign(np.array([1], np.int32))
    contacts.rigid_contact_shape0.assign(np.array(shapes[:1], np.int32))
    contacts.rigid_contact_shape1.assign(np.array(shapes[1:], np.int32))
    kind = newton.solvers.SolverBase.ObservableKind.CONTACT_F
    observables = SolverAVBD(model).observables([kind], contacts=contacts)
    observables.contact_f.assign(np.array([[0.0, 0.0, 10.0, 0.0, 5.0, 0.0]], np.float32))
    torques = Torques(model, 0.01)
    targets = np.zeros(model.joint_coord_count)
    targets[0] = -0.1481
    torques.add(torques.start(before), after, targets, contacts, observables)
    assert torques.pushed[0] == pytest.approx(14.81, rel=ROUNDING)
    assert torques.wrong[0] == pytest.approx(0.0, abs=1.0e-4)


def test_a_brake_of_what_follows_is_its_leader_s_too():
    """A leader's drive pushes a follower that is at its velocity limit, and turns no faster."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    links = [builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3) * 0.01)) for _ in "ab"]
    axis = wp.vec3(0.0, 1.0, 0.0)
    drive = {"target_ke": 100.0, "target_kd": 1.0}
    joints = [
        builder.add_joint_revolute(-1, links[0], axis=axis, **drive),
        builder.add_joint_revolute(-1, links[1], axis=axis, velocity_limit=0.5),
    ]
    builder.add_articulation(joints)
    builder.set_joint_mimic(joints[1], joints[0], coeffs=(0.0, 2.0))
    model = builder.finalize(device="cpu")
    state, following, control = model.state(), model.state(), model.control()
    targets = np.array([1.0, 2.0])
    control.joint_target_q.assign(targets.astype(np.float32))
    contacts, solver = newton.Contacts(1, 0, device="cpu"), SolverAVBD(model)
    kind = newton.solvers.SolverBase.ObservableKind.CONTACT_F
    observables = solver.observables([kind], contacts=contacts)
    torques = Torques(model, 0.01)
    for step in range(5):
        if step == 4:
            before = torques.start(state)
        solver.step(state, following, control, contacts, 0.01, observables=observables)
        state, following = following, state
    torques.add(before, state, targets, contacts, observables)
    assert state.body_qd.numpy()[:, 4] == pytest.approx([0.25, 0.5], rel=1.0e-4)
    assert torques.wrong[0] == 0.0


def test_a_leader_s_drive_carries_what_follows_it():
    builder = newton.ModelBuilder()
    tiny = wp.mat33(np.eye(3) * 1.0e-6)
    links = [builder.add_link(mass=2.0, inertia=tiny, com=wp.vec3(0.5, 0.0, 0.0)) for _ in "ab"]
    joints = [builder.add_joint_revolute(-1, link, axis=wp.vec3(0.0, 1.0, 0.0)) for link in links]
    builder.add_articulation(joints)
    builder.set_joint_mimic(joints[1], joints[0], coeffs=(0.0, -2.0))
    pose = stand(builder)
    # Both move 2 kg at 0.5 m; the follower twice as fast, so that it counts four times.
    inertia = 5.0 * 2.0 * 0.5**2
    assert pose.driven == [0]
    ke = inertia * (2.0 * math.pi * FREQUENCY) ** 2
    assert builder.joint_target_ke[0] == pytest.approx(ke, rel=ROUNDING)


def test_fixed_joints_that_mimic_and_robots_without_a_name_are_read(tmp_path: Path):
    file = tmp_path / "robot.urdf"
    inertia = " ".join(f"i{axes}='{axes[0] == axes[1]:d}'" for axes in "xx yy zz xy xz yz".split())
    inertial = f"<inertial><mass value='1'/><inertia {inertia}/></inertial>"
    links = "".join(f"<link name='{name}'>{inertial}</link>" for name in "abc")
    axis = "<axis xyz='0 1 0'/><limit lower='-1' upper='1' effort='1' velocity='1'/>"
    file.write_text(
        f"<robot>{links}"
        f"<joint name='ab' type='revolute'><parent link='a'/><child link='b'/>{axis}</joint>"
        "<joint name='bc' type='fixed'><parent link='b'/><child link='c'/>"
        "<mimic joint='ab'/></joint></robot>"
    )
    builder, _ = read_asset(file, "avbd", floating=False)
    assert builder.joint_count == 3
    file.write_text("<robot name='r'/>")
    with pytest.raises(UserError, match="it holds no links"):
        read_asset(file, "avbd", floating=False)
    file.write_text("<robot name='r'><link name='a'/><joint name='j' type='$(arg kind)'/></robot>")
    with pytest.raises(UserError, match=r"xacro robot\.urdf > expanded\.urdf"):
        read_asset(file, "avbd", floating=False)


def test_neighbors_through_welds_pass_each_other_as_merged_ones_do(tmp_path: Path):
    """a, welded b, and c on a hinge of b: no pair collides; d, beyond c, meets a and b."""
    file = tmp_path / "robot.urdf"
    box = "<collision><geometry><box size='1 1 1'/></geometry></collision>"
    links = "".join(f"<link name='{name}'>{box}</link>" for name in "abcd")
    limit = "<axis xyz='0 1 0'/><limit lower='-1' upper='1' effort='1' velocity='1'/>"
    joints = "".join(
        f"<joint name='{a}{b}' type='{kind}'><parent link='{a}'/><child link='{b}'/>{limit}</joint>"
        for a, b, kind in (("a", "b", "fixed"), ("b", "c", "revolute"), ("c", "d", "revolute"))
    )
    file.write_text(f"<robot name='r'>{links}{joints}</robot>")
    model = read_asset(file, "avbd", floating=False)[0].finalize(device="cpu")
    body = model.shape_body.numpy()
    pairs = {tuple(sorted(body[pair].tolist())) for pair in model.shape_contact_pairs.numpy()}
    assert pairs == {(0, 3), (1, 3)}


def test_neighbors_through_a_frame_without_mass_pass_each_other(tmp_path: Path):
    """a is welded to the root, an empty frame, and b hangs on a hinge of the root."""
    file = tmp_path / "robot.urdf"
    box = "<collision><geometry><box size='1 1 1'/></geometry></collision>"
    links = f"<link name='root'/><link name='a'>{box}</link><link name='b'>{box}</link>"
    limit = "<axis xyz='0 1 0'/><limit lower='-1' upper='1' effort='1' velocity='1'/>"
    joints = "".join(
        f"<joint name='{b}' type='{kind}'><parent link='root'/><child link='{b}'/>{limit}</joint>"
        for b, kind in (("a", "fixed"), ("b", "revolute"))
    )
    file.write_text(f"<robot name='r'>{links}{joints}</robot>")
    model = read_asset(file, "avbd", floating=False)[0].finalize(device="cpu")
    assert len(model.shape_contact_pairs.numpy()) == 0


def test_a_choice_of_mujoco_s_pgs_solver_is_read_over(tmp_path: Path):
    file = tmp_path / "robot.xml"
    file.write_text(
        "<mujoco><option solver='PGS' timestep='0.004'/><worldbody><body><joint type='hinge'/>"
        "<geom size='0.1'/></body></worldbody></mujoco>"
    )
    builder, _ = read_asset(file, "avbd", floating=False)
    assert builder.body_count == 1


LOSSES = """<mujoco><worldbody>
<body><joint type="ball" range="0 20"/><geom size="0.1"/></body>
<body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1e-12"/><joint type="hinge"/></body>
<body pos="9 0 0"><joint/><joint type="slide"/><geom size="0.1"/></body>
</worldbody></mujoco>"""


def test_a_robot_that_fails_is_told_with_what_its_file_loses(tmp_path: Path, monkeypatch, capfd):
    path = tmp_path / "arm.xml"
    path.write_text(LOSSES)
    chosen = [robots.Robot("arm", "package", path, bolted=False)]
    monkeypatch.setattr("newton_avbd.commands.robots.chosen_robots", lambda names: chosen)

    def fail(report, load, *args, **options):
        load()
        report.failures.append("no")

    monkeypatch.setattr("newton_avbd.commands.robots.try_robot", fail)
    assert main(["robots"]) == 1
    assert "arm.xml goes on without the range of 1 ball joint" in capfd.readouterr().out


def test_a_robot_is_told_with_all_that_a_run_says_of_it(tmp_path: Path, monkeypatch, capfd):
    path = tmp_path / "arm.xml"
    path.write_text(LOSSES)
    robot = robots.Robot("arm", "package", path, bolted=False)
    monkeypatch.setattr("newton_avbd.commands.robots.chosen_robots", lambda names: [robot])
    monkeypatch.setattr(robots, "robots", lambda: (robot,))
    said = {}
    for command in (["robots", "--untimed"], ["run", "robot:arm", "--frames", "1"]):
        main(command)
        lines = capfd.readouterr().err.splitlines()
        about = ("arm", "warning: Inertia", "warning: SolverAVBD")
        said[command[0]] = [
            line for line in lines if line.removeprefix("newton-avbd: ").startswith(about)
        ]
    assert said["robots"] == said["run"]
    said_of = "\n".join(said["run"])
    for part in ("without the range", "gets bodies of", "warning: Inertia"):
        assert part in said_of


def test_missing_converters_are_named_with_what_installs_them(monkeypatch, capsys):
    monkeypatch.setitem(converted.CONVERTERS, ".urdf", "no_such_converter")
    assert main(["robots", "--usd"]) == 2
    assert "pip install no-such-converter mujoco-usd-converter" in capsys.readouterr().err


def test_two_builds_of_usd_that_do_not_go_together_are_named(monkeypatch, capsys):
    # With both installed the converters end with a segmentation fault.
    monkeypatch.setattr(converted, "CONVERTERS", {".urdf": "json"})
    monkeypatch.setattr(converted, "_installed", lambda: {"usd-core", "usd-exchange"})
    assert main(["robots", "--usd"]) == 2
    assert "pip uninstall usd-core" in capsys.readouterr().err


def test_a_robot_moves_as_usd_as_it_does_as_mjcf(tmp_path: Path):
    try:
        converted.require_converters()
    except UserError as error:
        pytest.skip(str(error))
    robot = find_robot("nv_ant")
    plain = read_robot(robot)[0]
    usd = read_robot(converted.as_usd(robot, tmp_path))[0]
    assert usd.body_count == plain.body_count
    # The converter writes masses as float32.
    np.testing.assert_allclose(usd.body_mass, plain.body_mass, rtol=1.0e-5)


def test_a_robot_that_cannot_be_read_stays_in_the_page_with_its_reason(tmp_path: Path):
    def broken() -> newton.ModelBuilder:
        raise ValueError("no <link> in it")

    report = Report("broken", "example-robot-data", times={})
    assert try_robot(report, broken, lambda *_: None) is None
    page = write_page(tmp_path, [report], {"date": "today"}).read_text()
    assert "| `broken` |" in page
    assert "cannot be imported: no <link> in it" in page
    assert read_reports(tmp_path) == {"broken": report}
    assert summary([report]) == "0 of 1 robots pass. Their steps were not timed."


def test_the_command_lists_robots(capsys):
    with pytest.raises(SystemExit):
        main(["robots", "--list"])
    listed = capsys.readouterr().out
    assert "  example-robot-data  pip install example-robot-data\n" in listed
    assert "  nv_humanoid\n" in listed


def test_run_takes_a_robot_by_name():
    simulation = open_scene("robot:boxes_fourbar", Request("xpbd"))
    simulation.advance()
    assert simulation.model.joint_count == 5
