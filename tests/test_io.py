# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes, Newton's examples and files open with the solver that was asked for, or say why not."""

import importlib.util
from pathlib import Path

import mujoco
import newton
import newton.examples
import numpy as np
import pytest
import warp as wp
from newton.solvers import SolverMuJoCo, SolverVBD, SolverXPBD

from newton_avbd import SolverAVBD
from newton_avbd.io.assets import read_asset, read_driven
from newton_avbd.io.errors import UserError, require
from newton_avbd.io.opening import open_scene
from newton_avbd.io.simulation import Request
from newton_avbd.io.swap import swapped
from newton_avbd.io.timing import StepTimer
from newton_avbd.measure.state import Probe, deepest_penetration

EXAMPLE_ASSETS = Path(newton.examples.get_asset_directory())
TEST_ASSETS = Path(newton.__file__).parent / "tests" / "assets"

URDF = """<robot name="cube"><link name="cube">
<inertial><mass value="8"/>
<inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>
</link></robot>"""

MJCF = """<mujoco><worldbody><body pos="0 0 {height}"><freejoint/>
<geom type="box" size="0.1 0.1 0.1" density="1000"/></body></worldbody></mujoco>"""

USD = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
)
def Cube "cube" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])
{
    double size = 0.2
    double3 xformOp:translate = (0, 0, 0.15)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


@pytest.fixture
def model() -> newton.Model:
    builder = newton.ModelBuilder()
    builder.add_shape_sphere(builder.add_body())
    builder.color()
    return builder.finalize()


def made_by_swap(solver: str, iterations: int | None = None):
    """Patches Newton as for an example; for use in a ``with``."""
    return swapped(Request(solver, iterations), StepTimer())


def test_swap_makes_the_solver_asked_for_and_is_undone(model):
    with made_by_swap("avbd") as made:
        solver = newton.solvers.SolverXPBD(model)
    assert isinstance(solver, SolverAVBD)
    assert made == [solver]
    assert newton.solvers.SolverXPBD is SolverXPBD


def test_swap_leaves_soft_bodies_to_their_solver():
    builder = newton.ModelBuilder()
    builder.add_particle(pos=(0.0, 0.0, 1.0), vel=(0.0, 0.0, 0.0), mass=1.0)
    builder.color()
    soft = builder.finalize()
    for solver, stays in (("avbd", SolverVBD), ("mujoco", SolverVBD), ("xpbd", SolverXPBD)):
        with made_by_swap(solver):
            assert type(newton.solvers.SolverVBD(soft)) is stays


def test_swap_is_undone_when_a_script_fails():
    finalize = newton.ModelBuilder.finalize
    with pytest.raises(ZeroDivisionError), made_by_swap("avbd"):
        _ = 1 / 0
    assert newton.solvers.SolverXPBD is SolverXPBD
    assert newton.ModelBuilder.finalize is finalize


def test_swap_keeps_what_else_a_solver_class_offers(model):
    with made_by_swap("avbd"):
        stand_in = newton.solvers.SolverMuJoCo
        solver = stand_in(model)
        builder = newton.ModelBuilder()
        stand_in.register_custom_attributes(builder)
        assert any(key.startswith("mujoco:") for key in builder.custom_attributes)
        assert stand_in.ObservableKind is SolverMuJoCo.ObservableKind
        assert not isinstance(solver, stand_in)
        assert isinstance(object.__new__(SolverMuJoCo), stand_in)
        assert solver.get_max_contact_count() is None


def test_swap_keeps_sweeps_and_drops_settings_that_the_solver_lacks(model):
    with made_by_swap("vbd"):
        assert newton.solvers.SolverXPBD(model, iterations=3, angular_damping=0.1).iterations == 3
        # MuJoCo's iterations are Newton steps of the whole system, not sweeps.
        assert newton.solvers.SolverMuJoCo(model, iterations=77, njmax=5).iterations == 10
    with made_by_swap("vbd", iterations=4):
        assert newton.solvers.SolverXPBD(model, iterations=3).iterations == 4
        assert newton.solvers.SolverVBD(model, iterations=3).iterations == 4


def test_swap_leaves_out_what_vbd_does_not_simulate():
    """A joint with friction, written for a solver that has none; another solver's keeps it."""
    builder = newton.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)))
    builder.add_articulation([builder.add_joint_revolute(-1, link, friction=1.0)])
    jointed = builder.finalize(device="cpu")
    with made_by_swap("avbd"):
        assert not newton.solvers.SolverVBD(jointed).effects["joint_friction"].on
        assert newton.solvers.SolverXPBD(jointed).effects["joint_friction"].on


def test_swap_colors_bodies_for_vbd():
    builder = newton.ModelBuilder()
    builder.add_shape_sphere(builder.add_body())
    with made_by_swap("vbd"):
        solver = newton.solvers.SolverXPBD(builder.finalize())
    assert isinstance(solver, SolverVBD)


def test_own_scene_opens_with_its_step_or_the_one_asked_for():
    simulation = open_scene("fall", Request("xpbd"))
    assert isinstance(simulation.solver, SolverXPBD)
    assert (simulation.dt, simulation.frame_dt) == pytest.approx((1 / 240, 1 / 60))
    simulation = open_scene("fall", Request("xpbd", dt=0.004))
    # Four steps of 4 ms come nearest to a sixtieth of a second.
    assert (simulation.dt, simulation.frame_dt) == pytest.approx((0.004, 0.016))


def test_example_runs_with_our_solver_and_passes_its_own_test():
    simulation = open_scene("balance_bird", Request("avbd"))
    assert isinstance(simulation.solver, SolverAVBD)
    for _ in range(5):
        simulation.advance()
    assert len(simulation.timer.solver) == len(simulation.timer.collision) == 50
    assert simulation.verdict() == "passed"


def test_example_that_knows_the_solver_is_set_up_its_way():
    simulation = open_scene("domino_spiral", Request("vbd"))
    # What the example gives its shapes for SolverVBD; it has 1e4 N/m for the others.
    assert simulation.model.shape_material_ke.numpy() == pytest.approx(1.0e5)


def test_example_that_leaves_collisions_to_its_solver_gets_them_detected():
    pytest.importorskip("pxr")
    simulation = open_scene("sensor_imu", Request("avbd"))
    for _ in range(simulation.frames):
        simulation.advance()
    assert simulation.verdict() == "passed"
    # Cubes with edges of 0.4 m, on the ground to within a hundredth of a millimeter.
    assert simulation.state.body_q.numpy()[:, 2] == pytest.approx(0.2, abs=1.0e-5)


def test_example_takes_arguments_and_step():
    request = Request("xpbd", dt=0.002, arguments=("--num-pyramids", "1", "--pyramid-size", "2"))
    simulation = open_scene("newton:pyramid", request)
    assert simulation.model.body_count == 3
    assert (simulation.dt, simulation.frame_dt) == pytest.approx((0.002, 0.01))


def test_example_that_needs_several_steps_to_be_judged_says_so():
    simulation = open_scene("basic_dzhanibekov", Request("avbd"))
    simulation.advance()
    assert simulation.verdict() == "failed: Dzhanibekov flip did not occur"


@pytest.mark.filterwarnings("ignore:SolverAVBD moves rigid bodies only")
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("basic_viewer", "no rigid-body solver"),
        ("cloth_bending", "no rigid bodies"),
    ],
)
def test_example_that_cannot_take_our_solver_says_why(name, reason):
    pytest.importorskip("pxr")
    with pytest.raises(UserError, match=reason):
        open_scene(name, Request("avbd"))


@pytest.mark.parametrize(
    ("file", "text"), [("cube.urdf", URDF), ("cube.xml", MJCF.format(height=0.15))]
)
@pytest.mark.parametrize("solver", ["avbd", "vbd"])
def test_asset_without_ground_comes_to_rest_on_one(tmp_path, file, text, solver):
    _check_rest(tmp_path / file, text, solver)


def test_usd_asset_without_ground_comes_to_rest_on_one(tmp_path):
    pytest.importorskip("pxr")
    _check_rest(tmp_path / "cube.usda", USD, "avbd")


@pytest.mark.parametrize(
    ("attribute", "message"),
    [
        ('mass="-2"', "<geom mass='-2'> of body 'cube' is negative"),
        ('density="nan"', "<geom density='nan'> of body 'cube' is not finite"),
    ],
)
def test_a_mass_of_an_mjcf_file_that_makes_no_sense_is_named(tmp_path, attribute, message):
    """Newton's importer makes zero of it, and the body would stay in mid-air."""
    path = tmp_path / "cube.xml"
    text = MJCF.format(height=0.15).replace('density="1000"', attribute)
    path.write_text(text.replace("<body", '<body name="cube"'))
    with pytest.raises(UserError, match=message):
        open_scene(str(path), Request("avbd"))


INERTIAL = '<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>'


@pytest.mark.parametrize(
    ("before", "body"),
    [
        ("", INERTIAL + '<geom size="0.1" density="-1"/>'),
        ("", INERTIAL + '<geom size="0.1" mass="-1"/>'),
        ('<worldbody><geom size="0.1" density="-1"/></worldbody>', INERTIAL),
        ('<default><default class="a"><geom density="-1"/></default></default>', INERTIAL),
        (
            '<compiler inertiafromgeom="true"/>',
            INERTIAL.replace('"2"', '"-2"') + '<geom size="0.1" mass="2"/>',
        ),
        ('<compiler boundmass="2"/>', INERTIAL.replace('"2"', '"-2"')),
        ('<compiler boundinertia="1"/>', INERTIAL.replace('"1 ', '"-1 ')),
        (
            '<compiler inertiagrouprange="0 2"/>',
            '<geom size="0.1" mass="-1" group="3"/><geom size="0.1" mass="2"/>',
        ),
        ("", '<geom size="0.1" density="-1" mass="2"/>'),
    ],
)
def test_what_weighs_no_body_may_be_negative(tmp_path, before, body):
    """As in MuJoCo, which finds the same mass."""
    path = tmp_path / "scene.xml"
    text = f"{before}<worldbody><body><freejoint/>{body}</body></worldbody>"
    path.write_text(f"<mujoco>{text}</mujoco>")
    assert read_asset(path, "avbd", floating=True)[0].body_mass == pytest.approx([2.0])
    assert mujoco.MjModel.from_xml_path(str(path)).body_mass[1] == pytest.approx(2.0)


def test_the_inertial_of_a_body_that_is_fixed_may_be_negative(tmp_path):
    path = tmp_path / "scene.xml"
    inertial = INERTIAL.replace('"2"', '"-2"')
    path.write_text(f"<mujoco><worldbody><body>{inertial}</body></worldbody></mujoco>")
    assert read_asset(path, "avbd", floating=True)[0].body_count == 1


def test_a_mass_of_a_usd_file_that_makes_no_sense_is_named(tmp_path):
    pytest.importorskip("pxr")
    path = tmp_path / "cube.usda"
    text = USD.replace('["PhysicsRigidBodyAPI"', '["PhysicsMassAPI", "PhysicsRigidBodyAPI"')
    path.write_text(text.replace("{\n", "{\n    float physics:mass = -3\n", 1))
    with pytest.raises(UserError, match=r"physics:mass = -3.0 of prim /cube is negative"):
        open_scene(str(path), Request("avbd"))


@pytest.mark.parametrize(
    ("api", "values", "mass"),
    [
        ('"PhysicsMassAPI", ', "float physics:mass = 2\n    float physics:density = -1\n", 2.0),
        ("", "float physics:mass = -3\n", 8.0),
    ],
)
def test_what_weighs_no_prim_may_be_negative(tmp_path, api, values, mass):
    """A density beside a mass, a mass without the schema, a material that nothing has."""
    pytest.importorskip("pxr")
    path = tmp_path / "cube.usda"
    text = USD.replace('["PhysicsRigidBodyAPI"', f'[{api}"PhysicsRigidBodyAPI"')
    material = 'def Material "m" (prepend apiSchemas = ["PhysicsMaterialAPI"])\n'
    text = text.replace("{\n", "{\n    " + values, 1)
    path.write_text(f"{text}{material}{{\n    float physics:density = -1\n}}\n")
    assert read_asset(path, "avbd", floating=True)[0].body_mass == pytest.approx([mass])


def _check_rest(path: Path, text: str, solver: str) -> None:
    path.write_text(text)
    simulation = open_scene(str(path), Request(solver))
    assert simulation.name == path.name
    for _ in range(60):
        simulation.advance()
    ground = simulation.model.shape_transform.numpy()[-1, 2]
    # A cube with edges of 0.2 m; SolverVBD's contacts of 2.5e3 N/m let one of 8 kg sink 8 mm.
    tolerance = 1.0e-5 if solver == "avbd" else 0.02
    assert simulation.state.body_q.numpy()[0, 2] - ground == pytest.approx(0.1, abs=tolerance)


def test_asset_below_zero_gets_a_ground_under_it_and_stays_where_it_was_put(tmp_path):
    path = tmp_path / "cube.xml"
    path.write_text(MJCF.format(height=-3.0))
    simulation = open_scene(str(path), Request("avbd"))
    assert simulation.state.body_q.numpy()[0, 2] == pytest.approx(-3.0)
    assert simulation.model.shape_transform.numpy()[-1, 2] == pytest.approx(-3.11)


# Penetration after 4 s, of ellipsoids that rock on each other after 8: at rest, the 0.01 mm that
# the solver leaves, and as much for the next step's fall.
@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "bodies", "penetration"),
    [
        (EXAMPLE_ASSETS / "palletizer_scene.usda", 7, 2.0e-5),
        (EXAMPLE_ASSETS / "axis_cube.usda", 1, 2.0e-5),
        (TEST_ASSETS / "cube_cylinder.usda", 1, 2.0e-5),
        (TEST_ASSETS / "kamino" / "basics" / "box_on_plane.usda", 1, 2.0e-5),
        (EXAMPLE_ASSETS / "tabletop.xml", 18, 2.0e-5),
    ],
    ids=lambda value: value.name if isinstance(value, Path) else None,
)
def test_assets_that_newton_bundles_come_to_rest(path, bodies, penetration):
    pytest.importorskip("pxr")
    simulation = open_scene(str(path), Request("avbd"))
    assert simulation.model.body_count == bodies
    for _ in range(960 if path.name == "tabletop.xml" else 240):
        simulation.advance()
    probe = Probe(simulation.model)
    assert deepest_penetration(probe.separations(simulation.state)) < penetration
    # A step's fall from rest is 0.04 m/s: slower than that, something holds every body.
    assert probe.speed(simulation.state) < 9.81 * simulation.dt


@pytest.mark.parametrize("file", ["bad.urdf", "bad.xml", "bad.usda"])
def test_unreadable_asset_is_named_with_the_reason(tmp_path, file):
    if file.endswith("usda"):
        pytest.importorskip("pxr")
    path = tmp_path / file
    path.write_text("<unfinished")
    with pytest.raises(UserError, match=rf"cannot read .*{file}: .+") as caught:
        open_scene(str(path), Request("xpbd"))
    assert "\n" not in str(caught.value)


def test_asset_without_bodies_or_file_or_format_is_refused(tmp_path):
    empty = tmp_path / "empty.xml"
    empty.write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(UserError, match=r"empty\.xml: it holds no rigid bodies"):
        open_scene(str(empty), Request("xpbd"))
    empty.write_text("<sdf/>")
    with pytest.raises(UserError, match=r"its root element is <sdf>, not <mujoco>"):
        open_scene(str(empty), Request("xpbd"))
    with pytest.raises(UserError, match=r"is a folder; name a file in it"):
        open_scene(str(tmp_path), Request("avbd"))
    with pytest.raises(UserError, match=r"none\.usd: no such file"):
        open_scene("none.usd", Request("xpbd"))
    (tmp_path / "mesh.obj").touch()
    with pytest.raises(UserError, match=r"mesh\.obj: not one of \.usd"):
        open_scene(str(tmp_path / "mesh.obj"), Request("xpbd"))


def test_muscles_get_the_length_ranges_that_mujoco_finds(tmp_path):
    """A file without them is read with them, and the solver's own remedy finds the same."""
    path = tmp_path / "muscle.xml"
    path.write_text(
        """<mujoco><worldbody><site name="end"/><body pos="0.5 0 0">
        <joint name="slide" type="slide" axis="1 0 0" limited="true" range="-0.2 0.3"/>
        <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/><site name="tip"/></body>
        </worldbody><tendon><spatial name="cord"><site site="end"/><site site="tip"/></spatial>
        </tendon><actuator><motor joint="slide"/><muscle name="biceps" tendon="cord"/></actuator>
        </mujoco>"""
    )
    for builder, notes in (read_asset(path, "avbd", floating=True), read_driven(path)):
        assert notes == (
            "muscle.xml goes on with the length ranges that MuJoCo's compiler finds for 1 muscle: "
            "the file says none.",
        )
        found = builder.finalize()
        assert SolverAVBD(found).effects["tendons"].on
    ranges = found.mujoco.actuator_lengthrange.numpy()[1]
    # soft limits of a joint give way a little
    np.testing.assert_allclose(ranges, (0.3, 0.8), atol=0.01)
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(str(path), ctrl_direct=True)
    model = builder.finalize()
    with pytest.raises(ValueError, match="biceps") as error:
        SolverAVBD(model)
    remedy = str(error.value).rpartition("solver is made: ")[2]
    exec(remedy, {"model": model, "mujoco": mujoco, "FILE": str(path)})
    np.testing.assert_allclose(model.mujoco.actuator_lengthrange.numpy()[1], ranges)


def test_unknown_scene_names_close_matches_and_what_lists_all():
    with pytest.raises(UserError) as caught:
        open_scene("pyramide", Request("xpbd"))
    assert str(caught.value) == (
        "there is no scene 'pyramide', and no such file. Did you mean pyramid or pyramid_worlds? "
        "`newton-avbd run --list` names all."
    )
    with pytest.raises(UserError) as caught:
        open_scene("qqq", Request("xpbd"))
    assert str(caught.value) == (
        "there is no scene 'qqq', and no such file. `newton-avbd run --list` names all."
    )


def test_arguments_without_an_example_are_refused():
    with pytest.raises(UserError, match="no Newton example: --num-pyramids"):
        open_scene("fall", Request("xpbd", arguments=("--num-pyramids",)))


def test_missing_package_names_the_extra_that_brings_it(monkeypatch, tmp_path):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"pyglet: pip install 'newton-avbd\[view\]'"):
        require("pyglet")

    def fail(*args, **options):
        raise ModuleNotFoundError("No module named 'pxr'", name="pxr")

    monkeypatch.setattr(newton.ModelBuilder, "add_usd", fail)
    (tmp_path / "cube.usda").write_text("#usda 1.0\n")
    with pytest.raises(UserError, match=r"pxr: pip install 'newton-avbd\[scenes\]'"):
        open_scene(str(tmp_path / "cube.usda"), Request("xpbd"))
