# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Contacts in MuJoCo's terms: condim, priority, the larger coefficient, explicit pairs.

Each is a body that slides, spins or rolls on a plane for a quarter of a second, and slows down at a
constant rate that says which coefficient acted.
"""

import math
import warnings
from typing import Any

import mujoco
import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, Simulation, add_box, add_ground
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD
from newton_avbd.flags import FLAGS, heed_flags

R = 0.1
SECONDS = 0.25
SPEED = 2.0
"""Of what slides or rolls [m/s]."""
SPIN = 30.0
"""About the normal [rad/s]."""
FLOOR = "0.3 0.01 0.002"
BODY = "0.7 0.02 0.004"
PAIR = '<pair geom1="floor" geom2="geom" friction="0.5 0.5 0.015 0.003 0.003" {}/>'


def mjcf(geom: str = "", floor: str = "", kind: str = "box", contact: str = "") -> str:
    """A body on a plane, with attributes of both geoms."""
    return f"""<mujoco><option cone="elliptic" timestep="0.001"/><worldbody>
      <geom name="floor" type="plane" size="5 5 .1" friction="{FLOOR}" {floor}/>
      <body pos="0 0 {R}"><freejoint/>
        <geom name="geom" type="{kind}" size="{R} {R} {R}" friction="{BODY}" {geom}/>
      </body></worldbody><contact>{contact}</contact></mujoco>"""


def build(text: str, **options: Any) -> newton.ModelBuilder:
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(text, **options)
    return builder


def velocity_of(motion: str) -> list[float]:
    """Velocity at the start of a body that slides, spins or rolls."""
    return {
        "slide": [SPEED, 0.0, 0.0, 0.0, 0.0, 0.0],
        "spin": [0.0, 0.0, 0.0, 0.0, 0.0, SPIN],
        "roll": [SPEED, 0.0, 0.0, 0.0, SPEED / R, 0.0],
    }[motion]


def coefficient(motion: str, v: np.ndarray) -> float:
    """Which friction takes a body to the velocity v after :data:`SECONDS`."""
    lost = SPEED - v[0]
    if motion == "slide":
        return lost / (SECONDS * G)
    if motion == "spin":  # mu m g = 2/5 m r^2 a
        return (SPIN - v[5]) / (SECONDS * G) * 0.4 * R * R
    return lost / (SECONDS * G) * 1.4 * R  # mu m g = (2/5 + 1) m r^2 a/r


def measure(sim: Simulation, motion: str) -> float:
    sim.state.body_qd.assign(np.array([velocity_of(motion)] * sim.model.body_count, np.float32))
    sim.run(SECONDS)
    return coefficient(motion, sim.velocity[-1])


def in_mujoco(text: str, motion: str) -> float:
    """The coefficient that acts in MuJoCo C."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    # as deep as it rests
    for _ in range(1000):
        mujoco.mj_step(model, data)
    data.qvel[:] = velocity_of(motion)
    for _ in range(round(SECONDS / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return coefficient(motion, data.qvel)


CASES = {
    "the larger one of equal priority": ("slide", "", "", 0.7),
    "that of the higher priority": ("slide", "", 'priority="1"', 0.3),
    "that of the body, of the higher priority": ("slide", 'priority="2"', 'priority="1"', 0.7),
    "none where both have condim 1": ("slide", 'condim="1"', 'condim="1"', 0.0),
    "the larger condim": ("slide", 'condim="1"', "", 0.7),
    "condim 1 of the higher priority": ("slide", "", 'condim="1" priority="1"', 0.0),
    "no twisting by default": ("spin", "", "", 0.0),
    "twisting by condim 4": ("spin", 'condim="4"', "", 0.02),
    "twisting by condim 4 of the floor": ("spin", "", 'condim="4" priority="1"', 0.01),
    "no rolling by condim 4": ("roll", 'condim="4"', "", 0.0),
    "rolling by condim 6": ("roll", 'condim="6"', "", 0.004),
    "rolling by condim 6 of the floor": ("roll", "", 'condim="6" priority="1"', 0.002),
}


@pytest.mark.parametrize("case", CASES)
def test_friction_follows_condim_and_priority(case: str) -> None:
    """Within 1e-3 of the coefficient: the rate is constant, so that the time step does not matter.
    MuJoCo's contacts are soft and creep: its rolling is off by 1.1e-4 m, 6 % of the smallest
    coefficient here, the others by less than 3 %."""
    motion, geom, floor, expected = CASES[case]
    text = mjcf(geom, floor, "box" if motion == "slide" else "sphere")
    found = measure(Simulation(build(text)), motion)
    scale = max(expected, {"slide": 0.3, "spin": 0.01, "roll": 0.002}[motion])
    assert found == pytest.approx(expected, abs=1.0e-3 * scale)
    assert in_mujoco(text, motion) == pytest.approx(expected, abs=0.08 * scale)


@pytest.mark.parametrize(
    ("motion", "condim", "expected"),
    [
        ("slide", 3, 0.5),
        ("slide", 1, 0.0),
        ("spin", 4, 0.015),
        ("roll", 4, 0.0),
        ("roll", 6, 0.003),
    ],
)
def test_an_explicit_pair_has_its_own_friction(motion: str, condim: int, expected: float) -> None:
    """Whatever its shapes say."""
    contact = PAIR.format(f'condim="{condim}"')
    text = mjcf('condim="3"', 'priority="1"', "box" if motion == "slide" else "sphere", contact)
    found = measure(Simulation(build(text)), motion)
    assert found == pytest.approx(expected, abs=1.0e-3 * max(expected, 0.003))


def test_an_explicit_pair_has_its_own_margin() -> None:
    """A box whose pair has a margin of 5 mm rests that much above the plane."""
    text = mjcf("", "", "box", PAIR.format('margin="0.005"'))
    sim = Simulation(build(text))
    sim.run(0.5)
    assert sim.pose[0, 2] == pytest.approx(R + 0.005, abs=2.0e-5)
    assert np.abs(sim.velocity).max() < 1.0e-4


SECOND = '<body name="top" pos="0 0 0.31"><freejoint/><geom type="box" size=".1 .1 .1" {}/></body>'
MEETINGS = {
    "margins add up": mjcf('margin="0.004"', 'margin="0.002"'),
    "a gap does not lift": mjcf('margin="0.004" gap="0.003"'),
    "a pair has its own margin": mjcf("", 'margin="0.002"', contact=PAIR.format('margin="0.003"')),
    "masks that do not meet": mjcf('contype="2" conaffinity="2"'),
    "a mask that meets one way": mjcf('contype="2" conaffinity="1"'),
    "bodies whose masks meet": (mjcf(), SECOND.format('contype="2" conaffinity="1"')),
    "bodies whose masks do not": (mjcf(), SECOND.format('contype="4" conaffinity="8"')),
    "bodies that are excluded": (
        mjcf(contact='<exclude body1="box" body2="top"/>'),
        SECOND.format(""),
    ),
}


@pytest.mark.parametrize("case", MEETINGS)
def test_what_meets_is_what_meets_in_mujoco(case: str) -> None:
    """Bodies end as high as in MuJoCo C, or fall through what they do not meet: its soft contacts
    give way by 1e-4 m each, and where they fall the steps' errors are 0.5 g t h, 10 and 2.5 mm."""
    text, *more = (MEETINGS[case],) if isinstance(MEETINGS[case], str) else MEETINGS[case]
    text = text.replace("<body pos", '<body name="box" pos').replace(
        "</worldbody>", "".join(more) + "</worldbody>"
    )
    sim = Simulation(build(text))
    sim.run(0.5)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for _ in range(round(0.5 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(sim.pose[:, 2], data.xpos[1:, 2], atol=2.0e-2)
    rests = data.xpos[1:, 2] > 0.0
    np.testing.assert_allclose(sim.pose[rests, 2], data.xpos[1:, 2][rests], atol=5.0e-4)


def test_a_pair_that_newton_does_not_deliver_is_said_and_can_be_added() -> None:
    """Shapes of contype and conaffinity 0 meet nothing but what their pairs name."""
    contact = PAIR.format("")
    text = mjcf('contype="0" conaffinity="0"', "", "box", contact)
    with pytest.warns(UserWarning, match="makes no contacts for 1 explicit pair .*floor"):
        SolverAVBD(build(text).finalize(device="cpu"))
    model = build(text).finalize(device="cpu")
    ends = [model.mujoco.pair_geom1.numpy(), model.mujoco.pair_geom2.numpy()]
    pairs = np.vstack((model.shape_contact_pairs.numpy(), np.sort(np.column_stack(ends))))
    model.shape_contact_pairs = wp.array(pairs, dtype=wp.vec2i)
    pipeline = newton.CollisionPipeline(model, broad_phase="explicit")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solver = SolverAVBD(model, collision_pipeline=pipeline)
    state, after = model.state(), model.state()
    state.body_qd.assign(np.array([velocity_of("slide")], np.float32))
    for _ in range(60):
        solver.step(state, after, None, None, SECONDS / 60.0)
        state, after = after, state
    found = coefficient("slide", state.body_qd.numpy()[0])
    assert found == pytest.approx(0.5, abs=5.0e-4)


def test_pairs_of_each_world_and_bodies_solved_by_color() -> None:
    """The same pair in three worlds, and in one large world."""
    text = mjcf("", "", "box", PAIR.format(""))
    builder = newton.ModelBuilder()
    builder.replicate(build(text), 3)
    sim = Simulation(builder)
    assert measure(sim, "slide") == pytest.approx(0.5, abs=5.0e-4)
    assert np.ptp(sim.velocity[:, 0]) < 1.0e-6
    large = Simulation(build(text), parallel="bodies")
    assert measure(large, "slide") == pytest.approx(0.5, abs=5.0e-4)


def test_pairs_with_two_frictions_take_the_mean_and_say_so() -> None:
    """Of 0.5 and 0.3, 0.4."""
    contact = PAIR.replace("0.5 0.5", "0.5 0.3").format("")
    with pytest.warns(UserWarning, match=r"same friction in all directions; of 1 explicit pair"):
        sim = Simulation(build(mjcf("", "", "box", contact)))
    assert measure(sim, "slide") == pytest.approx(0.4, abs=4.0e-4)


def test_what_the_user_asks_for_wins() -> None:
    """A rule of mixing, and twisting and rolling everywhere or nowhere."""
    text = mjcf("", "", "box")
    mixed = measure(Simulation(build(text), friction_mix_mode="geometric_average"), "slide")
    assert mixed == pytest.approx(math.sqrt(0.21), rel=1.0e-3)
    rolls = measure(Simulation(build(mjcf("", "", "sphere")), angular_friction=True), "roll")
    assert rolls == pytest.approx(0.004, rel=1.0e-3)
    text = mjcf('condim="6"', "", "sphere")
    never = Simulation(build(text), angular_friction=False)
    assert not never.solver.effects.flags.angular_friction
    assert measure(never, "roll") == pytest.approx(0.0, abs=1.0e-6)
    without = Simulation(build(mjcf("", "", "box")), effects={"condim": False})
    assert measure(without, "slide") == pytest.approx(math.sqrt(0.21), rel=1.0e-3)


def test_attributes_that_are_registered_and_left_alone_change_nothing() -> None:
    """Newton's own shapes keep Newton's rule, to the bit, also beside a robot of an MJCF file."""
    velocities = []
    for registered in (False, True):
        builder = newton.ModelBuilder()
        if registered:
            SolverMuJoCo.register_custom_attributes(builder)
        add_ground(builder, mu=0.3)
        add_box(builder, (0.0, 0.0, 0.25), mu=0.7)
        sim = Simulation(builder)
        assert not sim.solver.effects.flags.condim
        sim.state.body_qd.assign(np.array([velocity_of("slide")], np.float32))
        sim.run(SECONDS)
        velocities.append(sim.velocity)
    np.testing.assert_array_equal(*velocities)
    builder = build(mjcf("", "", "box"))
    add_box(builder, (0.0, 3.0, 0.25), mu=0.7)
    add_box(builder, (0.0, 3.0, 0.75), mu=0.1)
    sim = Simulation(builder)
    sim.set_velocity(2, linear=(0.5, 0.0, 0.0))
    sim.run(0.1)
    lost = (0.5 - sim.velocity[2, 0]) / (0.1 * G)
    assert lost == pytest.approx(math.sqrt(0.07), rel=2.0e-2)


def test_changes_of_condim_are_seen_after_a_notice() -> None:
    """Priority, condim and effects: a floor that turns frictionless."""
    sim = Simulation(build(mjcf("", "", "box")))
    assert measure(sim, "slide") == pytest.approx(0.7, rel=1.0e-3)
    floor = sim.model.shape_label.index("worldbody/floor")
    for name, value in (("condim", 1), ("geom_priority", 1)):
        values = getattr(sim.model.mujoco, name).numpy()
        values[floor] = value
        getattr(sim.model.mujoco, name).assign(values)
    sim.solver.notify_model_changed(newton.ModelFlags.SHAPE_PROPERTIES)
    assert measure(sim, "slide") == pytest.approx(0.0, abs=1.0e-6)


def test_a_condim_that_does_not_exist_is_an_error_that_names_it() -> None:
    model = build(mjcf("", "", "box")).finalize(device="cpu")
    model.mujoco.condim.fill_(5)
    with pytest.raises(ValueError, match=r"mujoco\.condim\[0\] .* must be 1 or 3 or 4 or 6: 5"):
        SolverAVBD(model)


def flagged(flag: str) -> str:
    """A ball on two hinges, which holds most of what flags turn off, and its file turns off one."""
    return f"""<mujoco><option><flag {flag}="disable"/></option><worldbody>
    <geom type="plane" size="1 1 1" pos="0 0 -2"/><body>
    <joint name="a" axis="0 1 0" stiffness="1" damping="1" limited="true" range="-9 9"/>
    <joint name="b" axis="1 0 0"/><geom size="0.1"/></body></worldbody>
    <equality><joint joint1="a" joint2="b"/></equality></mujoco>"""


@pytest.mark.parametrize(
    ("flag", "remedy"),
    [
        ("contact", r"pass effects=\{'contact': False\}\.$"),
        ("spring", r"call model\.joint_stiffness\.zero_\(\) before"),
        (
            "constraint",
            r"pass effects=\{'contact': False, 'limits': False, 'joint_friction': False\} and call "
            r"model\.mujoco\.equality_constraint_enabled\.zero_\(\) before",
        ),
        ("damper", r"call model\.joint_damping\.zero_\(\) before"),
    ],
)
def test_flags_that_turn_physics_off_are_said(flag: str, remedy: str) -> None:
    """They are MuJoCo's. The remedy is that of the flag, and of what the model holds."""
    found = f"MuJoCo's flags, of which {flag} .*{remedy}"
    with pytest.warns(UserWarning, match=found):
        SolverAVBD(build(flagged(flag)).finalize(device="cpu"))


@pytest.mark.parametrize("flag", FLAGS)
def test_of_flags_that_are_heeded_nothing_is_said(flag: str) -> None:
    """What would be off is: by an effect that is left out, an array of zeros, or no pairs."""
    model = build(flagged(flag)).finalize(device="cpu")
    without = heed_flags(model)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SolverAVBD(model, effects=without)
    assert bool(model.shape_contact_pair_count) == (flag not in ("contact", "constraint"))
