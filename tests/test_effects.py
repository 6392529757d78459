# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A solver says which effects a scene calls for, and takes neither code nor memory for others."""

import dataclasses
import json
import re
from pathlib import Path

import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, Simulation, add_box, add_ground
from newton import ModelFlags

import newton_avbd
from newton_avbd import Effects, SolverAVBD
from newton_avbd.__main__ import main
from newton_avbd.drivers.colored import make_colored
from newton_avbd.drivers.world import make_step
from newton_avbd.effects import CAUSES
from newton_avbd.rows.joint import JointKinds
from newton_avbd.study.effects.full import SETTINGS, add_everything
from newton_avbd.study.effects.stripped import real_and_stripped, strip

DOCS = Path(__file__).parent.parent / "docs" / "effects.md"


def boxes(count: int, contacts: int = 0, **material: float) -> newton.Model:
    """Free boxes and a contact capacity."""
    builder = newton.ModelBuilder()
    for i in range(count):
        add_box(builder, (2.0 * i, 0.0, 0.5), 1.0, **material)
    model = builder.finalize(device="cpu")
    model.rigid_contact_max = contacts
    return model


def free_bodies(count: int) -> newton.Model:
    """Bodies that nothing touches."""
    builder = newton.ModelBuilder()
    for _ in range(count):
        builder.add_body(mass=1.0, inertia=wp.mat33(np.eye(3)))
    return builder.finalize(device="cpu")


def chain(count: int) -> newton.Model:
    """Links on hinges, without shapes."""
    builder = newton.ModelBuilder()
    links = [builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3))) for _ in range(count)]
    builder.add_articulation(
        [builder.add_joint_revolute(i - 1 if i else -1, link) for i, link in enumerate(links)]
    )
    return builder.finalize(device="cpu")


def memory(model: newton.Model, scheme: str = "euler", **settings: object) -> int:
    """All of a solver's arrays [bytes]."""
    effects = SolverAVBD(model, scheme=scheme, **settings).effects
    return effects.always + sum(effect.bytes for effect in effects.values())


def modules(sim: Simulation) -> set[str]:
    """Compiled modules of the kernels that the solver launched, named by a hash of their code."""
    return {kernel.module.name for kernel in sim.solver._launch._recorded}


# What it says.


def test_reasons_name_a_few_and_count_all() -> None:
    builder = newton.ModelBuilder()
    for i in range(5):
        body = builder.add_body(label=f"box_{i}")
        cfg = newton.ModelBuilder.ShapeConfig(mu=0.5, restitution=0.1 * (i == 3))
        builder.add_shape_box(body, label=f"cube_{i}", cfg=cfg)
    effects = SolverAVBD(builder.finalize(device="cpu")).effects
    assert effects["friction"].on
    assert effects["friction"].why.startswith("5 shapes")
    assert effects["friction"].why.endswith("'cube_0', 'cube_1', 'cube_2', ...")
    assert effects["restitution"].why.startswith("1 shape ")
    assert effects["restitution"].why.endswith("'cube_3'")
    assert not effects["gyroscopic"].on
    assert effects["gyroscopic"].why == "no body with unequal principal moments of inertia"


def test_effects_are_a_dict_and_a_table() -> None:
    effects = SolverAVBD(boxes(2)).effects
    values = json.loads(json.dumps(effects.as_dict()))
    assert values["contact"] == {"on": True, "why": effects["contact"].why, "bytes": 0}
    lines = str(effects).splitlines()
    assert len(lines) == len(CAUSES) + 2
    for name in CAUSES:
        assert any(line.startswith(f"{name} ") for line in lines)


def test_each_flag_has_a_cause_a_file_and_a_line_in_the_docs() -> None:
    flags = {field.name for field in dataclasses.fields(Effects)}
    flags -= {"kinds", "friction_mix", "on_gpu"}
    assert flags | {"joints"} == set(CAUSES)
    text = DOCS.read_text()
    for name, cause in CAUSES.items():
        assert (Path(newton_avbd.__file__).parent / cause.code).is_file()
        by = cause.by or "setting"
        assert f"| `{name}` | {by} {cause.having} | `{cause.code}` |" in text


def test_reasons_read_right_of_one_and_of_many() -> None:
    """ "14 shapes that collides" is what a verb or a pronoun of one thing would print."""
    for cause in CAUSES.values():
        if cause.by not in ("", "contact buffer"):
            assert not re.search(r"^that (?!joints)(is|\w+s)\b|\bits\b", cause.having), cause.having


def test_shapes_that_collide_with_nothing_call_for_no_contact() -> None:
    """Those only to look at, and sites; once one collides, and the solver is told, it does."""
    model = boxes(2, mu=0.5)
    flags = model.shape_flags.numpy().copy()
    model.shape_flags.assign(flags & ~int(newton.ShapeFlags.COLLIDE_SHAPES))
    solver = SolverAVBD(model)
    names = ("contact", "pairs", "piles", "friction")
    assert not any(solver.effects[name].on for name in names)
    model.shape_flags.assign(flags)
    assert "contact" in solver.unnoticed_changes()
    solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
    assert all(solver.effects[name].on for name in names)


def test_only_bodies_that_share_a_world_are_pairs_and_only_free_ones_piles() -> None:
    """A body alone, two in worlds of their own, a robot of two links, and that with a box."""

    def on(builder: newton.ModelBuilder) -> list[bool]:
        effects = SolverAVBD(builder.finalize(device="cpu")).effects
        return [effects[name].on for name in ("contact", "pairs", "piles")]

    box, worlds, robot = (newton.ModelBuilder() for _ in range(3))
    add_box(box, (0.0, 0.0, 0.5), 1.0)
    worlds.replicate(box, 2)
    assert on(box) == on(worlds) == [True, False, False]
    links = [robot.add_link() for _ in range(2)]
    for link in links:
        robot.add_shape_sphere(link, radius=0.1)
    robot.add_articulation(
        [
            robot.add_joint_revolute(parent, link)
            for parent, link in zip((-1, 0), links, strict=True)
        ]
    )
    assert on(robot) == [True, True, False]
    add_box(robot, (0.0, 0.0, 0.5), 1.0)
    assert on(robot) == [True, True, False]
    add_box(robot, (0.0, 0.0, 0.5), 1.0)
    assert on(robot) == [True, True, True]


def test_a_contact_buffer_calls_for_effects() -> None:
    model = boxes(2, 100)
    contacts = newton.CollisionPipeline(model, contact_matching="sticky").contacts()
    solver = SolverAVBD(model)
    assert not solver.effects["matching"].on
    assert SolverAVBD(model, effects={"matching": False}) is not None
    solver.step(model.state(), model.state(), None, contacts, 0.01)
    assert solver.effects["matching"].on


def test_the_full_scene_calls_for_everything() -> None:
    """Save what other settings and contact buffers ask for."""
    builder = newton.ModelBuilder()
    add_everything(builder)
    effects = SolverAVBD(builder.finalize(device="cpu"), **SETTINGS).effects
    off = {name for name, effect in effects.items() if not effect.on}
    assert off == {
        *("compliance", "ramp", "matching", "moving_surfaces", "contact_materials"),
        *("light_roots", "light_links", "sleeping", "adaptive", "limit_impedance"),
        *("carried_rounding", "fourth_order"),  # it has cables, and drag
    }


# Leaving out.


def slope(**settings: object) -> Simulation:
    """A box that friction of 1 would hold, under gravity that is tilted by 30 degrees."""
    tilt = np.radians(30.0)
    gravity = (G * np.sin(tilt), 0.0, -G * np.cos(tilt))
    builder = newton.ModelBuilder(gravity=gravity)
    add_ground(builder, mu=1.0)
    add_box(builder, (0.0, 0.0, 0.25), 0.5, mu=1.0)
    return Simulation(builder, **settings)


def test_what_is_left_out_does_not_act_and_is_said_so() -> None:
    """Without friction the box slides at g sin 30 from the first step."""
    sim = slope(effects={"friction": False})
    sim.run(0.5)
    assert sim.velocity[0, 0] == pytest.approx(0.25 * G, rel=1.0e-3)
    effect = sim.solver.effects["friction"]
    assert not effect.on
    assert effect.why.startswith("left out by the user; 2 shapes with friction")
    held = slope(effects={"friction": True})
    held.run(0.5)
    assert abs(held.velocity[0, 0]) < 1.0e-4


def test_what_is_left_out_stays_out_when_the_model_changes() -> None:
    sim = slope(effects={"friction": False})
    sim.model.shape_material_mu.fill_(0.7)
    sim.solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
    assert not sim.solver.effects["friction"].on
    with wp.ScopedCapture(device="cpu"):
        sim.solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
    assert not sim.solver.effects["friction"].on
    assert sim.solver.effects["gyroscopic"].why.startswith("a graph may call for it; so far no")


def test_contact_takes_friction_along() -> None:
    effects = SolverAVBD(boxes(1), effects={"contact": False}).effects
    assert not (effects["contact"].on or effects["friction"].on)
    assert effects["friction"].why.startswith("left out by the user")


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"restitution": True}, "nothing calls for it: no shape with restitution above zero"),
        ({"drives": True}, "no joint with a drive that has a gain"),
        ({"compliance": True}, "Pass compliant_contacts"),
        ({"compliance": False}, "Pass compliant_contacts"),
        ({"matching": True}, "it can only be left out"),
        ({"loops": False}, "joint_enabled"),
        ({"contact": False, "friction": True}, "another effect that is left out"),
        ({"sticktion": False}, "'sticktion'; there are only contact, pairs, floating, "),
    ],
)
def test_what_makes_no_sense_is_an_error_that_says_why(
    effects: dict[str, bool], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        SolverAVBD(boxes(1), effects=effects)


# What it compiles.


def test_solvers_with_the_same_effects_share_kernels() -> None:
    """Reasons do not matter: other shapes of other names call for the same."""
    few, many = SolverAVBD(boxes(2)).effects, SolverAVBD(boxes(3, mu=0.2)).effects
    assert few["friction"].why != many["friction"].why
    assert make_step(few.flags) is make_step(many.flags)


def test_values_compile_nothing_and_effects_only_what_holds_them() -> None:
    """Friction, masses, gravity, the step; then restitution, which only the solve knows."""
    sim = slope()
    sim.step()
    before = modules(sim)
    sim.model.shape_material_mu.fill_(0.3)
    for name, factor in (("body_mass", 2.0), ("body_inv_mass", 0.5), ("gravity", 1.5)):
        array = getattr(sim.model, name)
        array.assign(factor * array.numpy())
    sim.solver.iterations, sim.dt = 4, 0.01
    sim.solver.notify_model_changed(ModelFlags.ALL)
    sim.step()
    assert modules(sim) == before
    sim.model.shape_material_restitution.fill_(0.5)
    sim.solver.notify_model_changed(ModelFlags.SHAPE_PROPERTIES)
    sim.step()
    (new,) = modules(sim) - before
    assert "step" in new


def test_precompiling_loads_what_a_step_launches_and_moves_nothing() -> None:
    model = boxes(1, restitution=0.25, mu=0.0)
    contacts = newton.CollisionPipeline(model).contacts()
    effects = SolverAVBD.precompile(model, contacts=contacts)
    step = make_step(effects.flags).module
    assert step.execs
    solver = SolverAVBD(model)
    state_in, state_out = model.state(), model.state()
    loaded = dict(step.execs)
    solver.step(state_in, state_out, None, contacts, 0.01)
    assert step.execs == loaded
    assert any(kernel.module is step for kernel in solver._launch._recorded)
    assert np.array_equal(state_in.body_q.numpy(), model.body_q.numpy())


def test_absent_code_leaves_nothing_behind(tmp_path: Path) -> None:
    """The kernels are those of a package from which the code of absent effects was removed."""
    bare = Effects(contact=True, friction=False, gyroscopic=False, joint_force=False)
    hinged = dataclasses.replace(bare, kinds=JointKinds(linear=(0,), angular=(1,)))
    assert strip(hinged, tmp_path) > 100
    real, stripped = real_and_stripped(hinged)
    assert len(real) == 4
    assert real == stripped


# What it takes.


ALONE, DOF, PILE, CONTACT = 441, 8, 380, 180
"""Bytes that docs/effects.md states: of each body, degree of freedom, body in a scene with contacts
(beside those), and contact."""
BODY = ALONE + 260
"""Of each body in a scene with contacts or joints."""
LINK, AXIS = 684, 188
"""Of each body and each axis in a scene with joints, beside those."""
SLEEPER, SLEEPING_CONTACT = 176, 100
"""Of each body and each contact with sleeping, beside those."""
HISTORY, DOF_HISTORY, INPUT, SLEEPER_HISTORY, TOUCH = 288, 48, 36, 4, 12
"""Of each body, degree of freedom, degree of freedom beside joints that link bodies, body with
sleeping, and contact of rigid shapes that do not bounce, with the scheme of second order, beside
those."""
FLIGHT, CARRIED = 128, 64
"""Of each body that no joint holds, and of each that joints do, with the scheme of second order in
a scene without contacts, beside those."""
BY_CONTACT = {"restitution": 84, "angular_friction": 52, "compliance": 4, "ramp": 8}
"""Of each contact, where the effect is on."""


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_large_world_has_no_kernels_of_absent_effects(scheme: str) -> None:
    flags = SolverAVBD(boxes(2, contacts=8), parallel="bodies", scheme=scheme).effects.flags
    kernels = vars(make_colored(flags))
    made = {name for name, kernel in kernels.items() if kernel is not None}
    absent = {
        *(
            "weigh",
            "measure_joints",
            "measure_loops",
            "widen_loops",
            "place_joints",
            "close_joints",
        ),
        *("sweep_loops", "keep_loops", "give_loops_back", "end_armatures", "end_loop_armatures"),
        *("align_spins", "break_trees", "break_loops"),
        *("join_clusters", "begin_clusters", "solve_clusters", "give_cables_back"),
        *("join_bodies", "join_cabled", "add_all_cables", "slow_all_rotors", "drop_all_tensions"),
    }
    if scheme != "euler":
        absent |= {"find_loop_jumps", "find_jerks", "find_jerked", "remember_loops"}
    assert set(kernels) - made == absent
    assert "find_impacts" not in kernels
    assert ("order_worlds" in kernels) == (scheme != "euler")
    assert set(kernels["sweep_color"].module.kernels) == {kernels[name].key for name in made}


def test_memory_is_as_documented() -> None:
    """Whole scenes, and what each effect adds."""
    assert memory(free_bodies(200)) - memory(free_bodies(100)) == 100 * (ALONE + 6 * DOF)
    assert memory(boxes(200)) - memory(boxes(100)) == 100 * (BODY + 6 * DOF + PILE)
    assert memory(boxes(1, 300)) - memory(boxes(1, 200)) == 100 * CONTACT
    assert memory(chain(200)) - memory(chain(100)) == 100 * (BODY + DOF + LINK + AXIS)
    sleepers = [memory(boxes(n), sleeping=True) for n in (100, 200)]
    assert sleepers[1] - sleepers[0] == 100 * (BODY + 6 * DOF + PILE + SLEEPER)
    sleepers = [memory(boxes(1, n), sleeping=True) for n in (100, 200)]
    assert sleepers[1] - sleepers[0] == 100 * (CONTACT + SLEEPING_CONTACT)
    bouncing = [
        SolverAVBD(boxes(1, n, restitution=0.5), angular_friction=True).effects for n in (100, 200)
    ]
    compliant = [SolverAVBD(boxes(1, n), compliant_contacts=True).effects for n in (100, 200)]
    ramped = [SolverAVBD(boxes(1, n), formulation="ramp").effects for n in (100, 200)]
    for name, size in BY_CONTACT.items():
        few, many = {"compliance": compliant, "ramp": ramped}.get(name, bouncing)
        assert many[name].bytes - few[name].bytes == 100 * size
    text = DOCS.read_text()
    for size in (ALONE, 224, DOF, PILE, CONTACT, LINK, AXIS, SLEEPER, SLEEPING_CONTACT):
        assert f" {size} |" in text
    for size in (HISTORY, DOF_HISTORY, INPUT, SLEEPER_HISTORY, TOUCH, FLIGHT, CARRIED):
        assert f" {size} |" in text
    for size in BY_CONTACT.values():
        assert f" {size} |" in text


def test_memory_of_second_order_is_as_documented() -> None:
    """What the scheme adds to the above, of which it changes nothing."""

    def added(few: newton.Model, many: newton.Model, **settings: object) -> int:
        first, second = (
            memory(many, scheme=scheme, **settings) - memory(few, scheme=scheme, **settings)
            for scheme in ("euler", "generalized_alpha")
        )
        return second - first

    free = HISTORY + 6 * DOF_HISTORY
    assert added(free_bodies(100), free_bodies(200)) == 100 * (free + FLIGHT)
    assert added(boxes(100), boxes(200)) == 100 * free
    assert added(boxes(100), boxes(200), sleeping=True) == 100 * (free + SLEEPER_HISTORY)
    assert added(chain(100), chain(200)) == 100 * (HISTORY + CARRIED + DOF_HISTORY + INPUT)
    assert added(boxes(1, 100), boxes(1, 200)) == 100 * TOUCH
    bouncing = [boxes(1, count, restitution=0.5) for count in (100, 200)]
    assert added(*bouncing) == 0


def test_a_hundred_thousand_boxes_fit() -> None:
    """With 400,000 contacts in 400 MB: memory is linear in both, see above."""
    small = memory(boxes(1, 1), scheme="generalized_alpha")
    box = BODY + 6 * DOF + PILE + HISTORY + 6 * DOF_HISTORY
    assert small + 99_999 * box + 399_999 * (CONTACT + TOUCH) < 400.0e6


# The command.


def test_the_command_prints_the_table_and_what_effects_cost(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["effects", "fall", "--measure", "--frames", "2"]) == 0
    table, _, costs = capsys.readouterr().out.partition("\n\n")
    assert table.splitlines()[0].split() == ["effect", "bytes", "why"]
    assert {line.split()[0] for line in costs.splitlines()[2:]} <= set(CAUSES)
    assert "joint_force" in costs
