# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Massless links between joints move with what hangs on them; where nothing does, that is said."""

import warnings
from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import IDENTITY, Array, Simulation
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0


def transform(position=(0.0, 0.0, 0.0), rotation=IDENTITY) -> wp.transform:
    return wp.transform(wp.vec3(*position), rotation)


def add_bob(builder: newton.ModelBuilder) -> int:
    """A body whose moments of inertia differ, half a meter below its joint."""
    inertia = wp.mat33(0.05, 0.0, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 0.02)
    return builder.add_link(mass=2.0, inertia=inertia, com=wp.vec3(0.0, 0.0, -0.5))


def is_solved(builder: newton.ModelBuilder, **settings: Any) -> Array:
    """Which links the solver moves; a warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solver = SolverAVBD(builder.finalize(device="cpu"), **settings)
    return solver._solved.body_inv_mass.numpy() > 0.0


def universal(crossed: bool) -> Simulation:
    """A bob on a universal joint: two hinges with a massless cross between, or one D6."""
    builder = newton.ModelBuilder()
    x, y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    if crossed:
        cross = builder.add_link(label="cross")
        bob = add_bob(builder)
        joints = [
            builder.add_joint_revolute(-1, cross, axis=x),
            builder.add_joint_revolute(cross, bob, axis=y),
        ]
    else:
        bob = add_bob(builder)
        axes = [newton.ModelBuilder.JointDofConfig(axis=axis) for axis in (x, y)]
        joints = [builder.add_joint_d6(-1, bob, angular_axes=axes)]
    builder.add_articulation(joints)
    builder.joint_q[:] = [0.4, 0.7]
    builder.joint_qd[:] = [1.0, -2.0]
    sim = Simulation(builder, collide=False)
    newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
    return sim


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_two_hinges_with_a_massless_cross_are_a_universal_joint(scheme: str) -> None:
    """Within a tenth of a millimetre of half a meter after two seconds: a cross of a millionth of
    the bob's mass changes its motion by some millionths a swing."""
    crossed, whole = universal(True), universal(False)
    for sim in (crossed, whole):
        sim.solver = type(sim.solver)(sim.model, scheme=scheme)
        sim.run(2.0)
    np.testing.assert_allclose(crossed.pose[-1], whole.pose[-1], atol=1e-4)
    assert np.abs(crossed.velocity).max() > 0.5


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_torque_on_a_massless_cross_turns_what_hangs_on_it(scheme: str) -> None:
    """About the axis to the world it is tau t / I of the bob, whatever the joints carry beside it:
    on the cross alone the torque would give thousands of turns in a step."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    cross, bob = builder.add_link(label="cross"), add_bob(builder)
    builder.add_articulation(
        [
            builder.add_joint_revolute(-1, cross, axis=(1.0, 0.0, 0.0)),
            builder.add_joint_revolute(cross, bob, axis=(0.0, 1.0, 0.0)),
        ]
    )
    sim = Simulation(builder, collide=False, scheme=scheme)
    sim.push(cross, torque=(0.3, 0.2, -1.0))
    sim.step(60)
    about_joint = 0.05 + 2.0 * 0.5**2
    spin = [0.3 * 60 * DT / about_joint, 0.0, 0.0]
    np.testing.assert_allclose(sim.velocity[:, 3:], [spin, spin], atol=1e-4 * spin[0])


def test_a_massless_link_does_not_add_to_the_weight() -> None:
    """A bob below two massless links: the first joint carries the bob's weight."""
    builder = newton.ModelBuilder()
    first, second = builder.add_link(), builder.add_link()
    bob = add_bob(builder)
    y = (0.0, 1.0, 0.0)
    builder.add_articulation(
        [
            builder.add_joint_revolute(-1, first, axis=y),
            builder.add_joint_revolute(first, second, axis=(1.0, 0.0, 0.0)),
            builder.add_joint_fixed(second, bob),
        ]
    )
    sim = Simulation(builder, collide=False)
    assert sim.solver._solved.body_count == 2  # the second massless link is part of the bob
    wrench = sim.observe("body_parent_f")
    sim.step(10)
    force = wrench.body_parent_f.numpy()
    weight = 2.0 * 9.81
    np.testing.assert_allclose(force[[first, bob], 2], weight, rtol=1e-5)


def test_a_free_axis_that_nothing_resists_is_named() -> None:
    builder = newton.ModelBuilder()
    bob = add_bob(builder)
    spinner = builder.add_link(label="spinner")
    builder.add_articulation(
        [
            builder.add_joint_revolute(-1, bob, axis=(0.0, 1.0, 0.0)),
            builder.add_joint_revolute(bob, spinner, axis=(0.0, 0.0, 1.0), label="idle"),
        ]
    )
    with pytest.warns(UserWarning, match=r"Nothing resists the motion of joint 'idle'.*'spinner'"):
        sim = Simulation(builder, collide=False)
    sim.step(10)
    assert np.all(np.isfinite(sim.pose))


def test_armature_resists() -> None:
    builder = newton.ModelBuilder()
    bob = add_bob(builder)
    rotor = builder.add_link(label="rotor")
    spin = (0.0, 0.0, 1.0)
    builder.add_articulation(
        [
            builder.add_joint_revolute(-1, bob, axis=(0.0, 1.0, 0.0)),
            builder.add_joint_revolute(bob, rotor, axis=spin, armature=0.01),
        ]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim = Simulation(builder, collide=False)
    sim.control.joint_f.assign([0.0, 0.5])
    sim.step(12)
    # a shaft at rest otherwise: w = tau t / I
    assert sim.velocity[rotor, 5] == pytest.approx(0.5 * 12 * DT / 0.01, rel=1e-3)


def test_an_articulation_without_mass_is_refused() -> None:
    builder = newton.ModelBuilder()
    links = [builder.add_link(label="upper"), builder.add_link(label="lower")]
    y = (0.0, 1.0, 0.0)
    joints = [builder.add_joint_revolute(-1, links[0], axis=y, label="a")]
    joints.append(builder.add_joint_revolute(links[0], links[1], axis=y, label="b"))
    builder.add_articulation(joints)
    named = (
        r"body 0 'upper' has neither mass nor armature "
        r"\(bodies 'upper', 'lower'; joints 'a', 'b'\)"
    )
    with pytest.raises(ValueError, match=named):
        Simulation(builder, collide=False)


def test_a_floating_root_welded_to_links_without_mass_is_refused() -> None:
    """Body and joints have the model's numbers and names, also behind other bodies and welds."""
    builder = newton.ModelBuilder()
    bob = add_bob(builder)
    builder.add_articulation([builder.add_joint_free(bob)])
    base, mast = builder.add_link(label="base"), builder.add_link(label="mast")
    joints = [builder.add_joint_free(base, label="floats")]
    joints.append(builder.add_joint_fixed(base, mast, label="weld"))
    builder.add_articulation(joints)
    named = (
        r"body 1 'base' has neither mass nor armature "
        r"\(bodies 'base', 'mast'; joints 'floats', 'weld'\)"
    )
    with pytest.raises(ValueError, match=named):
        Simulation(builder, collide=False)


def bolted(armature: float) -> Simulation:
    """A base bolted to the world that carries an arm, and a laser without mass on a hinge."""
    builder = newton.ModelBuilder()
    inertia = wp.mat33(0.05, 0.0, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 0.02)
    base = builder.add_link(mass=2.0, inertia=inertia, label="base")
    arm, laser = add_bob(builder), builder.add_link(label="laser")
    builder.add_articulation(
        [
            builder.add_joint_fixed(-1, base),
            builder.add_joint_revolute(base, arm, axis=(0.0, 1.0, 0.0)),
            builder.add_joint_revolute(
                base, laser, axis=(0.0, 0.0, 1.0), armature=armature, label="spin"
            ),
        ]
    )
    return Simulation(builder, collide=False)


def test_a_massless_leaf_on_a_base_that_is_bolted_to_the_world_turns_by_its_armature() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim = bolted(0.01)
    sim.control.joint_f.assign([0.0, 0.5])
    sim.step(12)
    # w = tau t / I
    assert sim.velocity[2, 5] == pytest.approx(0.5 * 12 * DT / 0.01, rel=1e-3)
    with pytest.warns(UserWarning, match=r"Nothing resists .* 'spin' \(body 'laser'\)"):
        bolted(0.0)


def test_a_massless_cart_with_armature_moves_as_a_cart_of_that_mass() -> None:
    builder = newton.ModelBuilder()
    cart = builder.add_link()
    slide = builder.add_joint_prismatic(-1, cart, axis=(1.0, 0.0, 0.0), armature=1.5)
    builder.add_articulation([slide])
    sim = Simulation(builder, collide=False)
    sim.control.joint_f.assign([3.0])
    sim.step(24)
    assert sim.velocity[cart, 0] == pytest.approx(3.0 * 24 * DT / 1.5, rel=1e-4)


@pytest.mark.parametrize("ctrl_direct", [False, True])
def test_armature_that_an_actuator_authors_moves_a_massless_cart_and_resists_a_leaf(
    ctrl_direct: bool,
) -> None:
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(
        """
        <mujoco>
          <worldbody>
            <body><joint name="x" type="slide" axis="1 0 0"/></body>
            <body>
              <joint axis="0 1 0"/>
              <inertial pos="0 0 -0.5" mass="2" diaginertia="0.05 0.03 0.02"/>
              <body><joint name="leaf" axis="0 0 1"/></body>
            </body>
          </worldbody>
          <actuator>
            <position joint="x" kp="10" kv="1" armature="1.5"/>
            <position joint="leaf" kp="10" kv="1" armature="1.5"/>
          </actuator>
        </mujoco>
        """,
        ctrl_direct=ctrl_direct,
    )
    assert np.all(is_solved(builder))


def test_massless_links_of_sets_without_a_degree_of_freedom_are_solved() -> None:
    """A lone one on a hinge with armature beside an articulation; a mount, where welds are off."""
    builder = newton.ModelBuilder()
    builder.add_articulation([builder.add_joint_revolute(-1, add_bob(builder), axis=(0, 1, 0))])
    rotor = builder.add_link()
    builder.add_joint_revolute(-1, rotor, axis=(0.0, 1.0, 0.0), armature=0.1)
    assert is_solved(builder)[rotor]
    builder = newton.ModelBuilder()
    mount, bob = builder.add_link(), add_bob(builder)
    joints = [builder.add_joint_fixed(-1, mount), builder.add_joint_fixed(mount, bob)]
    builder.add_articulation(joints)
    assert is_solved(builder, effects={"welds": False})[mount]


def test_a_massless_follower_on_the_world_turns_with_its_leader() -> None:
    builder = newton.ModelBuilder()
    bob, dummy, y = add_bob(builder), builder.add_link(), (0.0, 1.0, 0.0)
    joints = [builder.add_joint_revolute(-1, link, axis=y) for link in (bob, dummy)]
    builder.add_articulation(joints)
    builder.set_joint_mimic(joints[1], joints[0], coeffs=(0.0, 2.0))
    builder.joint_q[:2] = [0.4, 0.8]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim = Simulation(builder, collide=False)
    newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
    energy = sim.energy
    sim.step(48)
    assert sim.velocity[bob, 4] < -0.5
    assert sim.velocity[dummy, 4] == pytest.approx(2.0 * sim.velocity[bob, 4], rel=1e-4)
    assert sim.energy == pytest.approx(energy, abs=1e-3)


@pytest.mark.parametrize("armature", [0.0, 0.1])
def test_a_leader_of_no_articulation_holds_its_massless_follower(armature: float) -> None:
    """By its mass, or where it has none, by its armature."""
    builder = newton.ModelBuilder()
    y = (0.0, 1.0, 0.0)
    lead = builder.add_link() if armature else add_bob(builder)
    leader = builder.add_joint_revolute(-1, lead, axis=y, armature=armature)
    follower = builder.add_joint_revolute(-1, builder.add_link(), axis=y)
    builder.add_articulation([follower])
    builder.set_joint_mimic(follower, leader, coeffs=(0.0, 2.0))
    assert np.all(is_solved(builder))


def test_a_leader_that_closes_a_loop_is_refused_by_name() -> None:
    builder = newton.ModelBuilder()
    y = (0.0, 1.0, 0.0)
    for _ in range(2):
        builder.add_articulation([builder.add_joint_revolute(-1, add_bob(builder), axis=y)])
    closing = builder.add_joint_revolute(0, 1, axis=y, label="closing")
    follower = builder.add_joint_revolute(-1, builder.add_link(), axis=y, label="follows")
    builder.add_articulation([follower])
    builder.set_joint_mimic(follower, closing)
    with pytest.raises(NotImplementedError, match=r"\(follows\) mimics joint 2 \(closing\)"):
        is_solved(builder)


def hanging(axis: tuple[float, float, float]) -> newton.ModelBuilder:
    """A massless link that turns about z, and a body on it by a hinge of no articulation."""
    builder = newton.ModelBuilder()
    bob, link, body = add_bob(builder), builder.add_link(), add_bob(builder)
    first = builder.add_joint_revolute(-1, bob, axis=(0.0, 1.0, 0.0))
    spin = builder.add_joint_revolute(bob, link, axis=(0.0, 0.0, 1.0), label="spin")
    builder.add_articulation([first, spin])
    builder.add_joint_revolute(body, link, axis=axis)
    return builder


def test_a_body_of_no_articulation_resists_by_its_mass() -> None:
    """It holds nothing as the world would: about its own hinge its carrier turns freely."""
    assert np.all(is_solved(hanging((1.0, 0.0, 0.0))))
    with pytest.warns(UserWarning, match="Nothing resists the motion of joint 'spin'"):
        SolverAVBD(hanging((0.0, 0.0, 1.0)).finalize(device="cpu"))


def slider_crank(mass: float) -> Simulation:
    """A crank on the world, closed by a loop to a rod that hangs on a slider."""
    builder = newton.ModelBuilder()
    y, radius, length, angle = (0.0, 1.0, 0.0), 0.2, 0.5, 0.5
    crank = builder.add_link(mass=mass, inertia=wp.mat33(*(mass * 0.01 * np.eye(3)).ravel()))
    builder.add_articulation([builder.add_joint_revolute(-1, crank, axis=y)])
    slider = builder.add_link(mass=1.0, inertia=wp.mat33(*(0.01 * np.eye(3)).ravel()))
    rod = builder.add_link(
        mass=0.2, inertia=wp.mat33(*(0.002 * np.eye(3)).ravel()), com=wp.vec3(-0.25, 0.0, 0.0)
    )
    slide = builder.add_joint_prismatic(-1, slider, axis=(1.0, 0.0, 0.0))
    builder.add_articulation([slide, builder.add_joint_revolute(slider, rod, axis=y)])
    pin = {
        "parent_xform": transform((0.0, 0.0, radius)),
        "child_xform": transform((-length, 0.0, 0.0)),
    }
    builder.add_joint_revolute(crank, rod, axis=y, **pin)
    x, z = radius * np.sin(angle), radius * np.cos(angle)
    builder.joint_q[:3] = [angle, x + np.sqrt(length**2 - z**2), np.arcsin(z / length)]
    sim = Simulation(builder, collide=False, keep_inertia=True)
    newton.eval_fk(sim.model, sim.model.joint_q, sim.model.joint_qd, sim.state)
    return sim


def test_a_massless_crank_that_a_loop_closes_moves_as_one_of_a_milligram() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        massless = slider_crank(0.0)
    light = slider_crank(1e-6)
    start = massless.pose
    for sim in (massless, light):
        sim.step(48)
    np.testing.assert_allclose(massless.pose[1:], light.pose[1:], atol=1e-5)
    assert np.abs(massless.pose - start)[1, 0] > 5e-3


@pytest.mark.parametrize("joint", ["hinge", "d6"])
def test_an_axis_between_equal_limits_needs_no_mass(joint: str) -> None:
    builder = newton.ModelBuilder()
    bob, leaf, z = add_bob(builder), builder.add_link(), (0.0, 0.0, 1.0)
    locked = {"limit_lower": 0.1, "limit_upper": 0.1}
    first = builder.add_joint_revolute(-1, bob, axis=(0.0, 1.0, 0.0))
    if joint == "hinge":
        last = builder.add_joint_revolute(bob, leaf, axis=z, **locked)
    else:
        axes = [newton.ModelBuilder.JointDofConfig(axis=axis, **locked) for axis in (z, (1, 0, 0))]
        last = builder.add_joint_d6(bob, leaf, angular_axes=axes)
    builder.add_articulation([first, last])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Simulation(builder, collide=False)


@pytest.mark.parametrize("pin", ["revolute", "ball"])
def test_a_massless_rod_of_a_four_bar_is_named_only_where_it_can_turn_about_itself(
    pin: str,
) -> None:
    builder = newton.ModelBuilder()
    y, tip = (0.0, 1.0, 0.0), {"parent_xform": transform((0.0, 0.0, -0.5))}
    first, second, rod = add_bob(builder), add_bob(builder), builder.add_link(label="rod")
    joints = [builder.add_joint_revolute(-1, first, axis=y)]
    joints.append(getattr(builder, f"add_joint_{pin}")(first, rod, label="pin", **tip))
    builder.add_articulation(joints)
    mount = transform((0.5, 0.0, 0.0))
    builder.add_articulation([builder.add_joint_revolute(-1, second, axis=y, parent_xform=mount)])
    closing = {"parent_xform": mount, "child_xform": transform((0.0, 0.0, -0.5))}
    getattr(builder, f"add_joint_{pin}")(rod, second, **closing)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Simulation(builder, collide=False)
    said = [str(item.message) for item in caught]
    assert len(said) == (pin == "ball")
    assert all("Nothing resists the motion of joint 'pin' (body 'rod')" in text for text in said)


def test_a_joint_whose_equality_row_is_disabled_holds_no_massless_link() -> None:
    """The closing pin of a four-bar: without it its rod turns freely about the other one. And the
    weld of a plate to an arm: without it the plate is where the user puts it."""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    arm = """
        <body name="%s" pos="%s">
          <joint axis="0 1 0"/>
          <inertial pos="0 0 -0.5" mass="2" diaginertia="0.05 0.03 0.02"/>
          %s
        </body>"""
    rod = '<body name="rod" pos="0 0 -0.5"><joint name="pin" axis="0 1 0"/></body>'
    builder.add_mjcf(
        f"""
        <mujoco>
          <worldbody>
            {arm % ("a", "0 0 0", rod)}
            {arm % ("b", "0.5 0 0", "")}
            <body name="plate"><freejoint/></body>
          </worldbody>
          <equality>
            <connect body1="rod" body2="b" anchor="0.5 0 0"/>
            <weld body1="a" body2="plate"/>
          </equality>
        </mujoco>
        """
    )
    assert np.all(is_solved(builder))
    model = builder.finalize(device="cpu")
    model.mujoco.equality_constraint_enabled.assign([False, False])
    with pytest.warns(UserWarning, match=r"Nothing resists the motion of joint '[^']*pin' \("):
        solver = SolverAVBD(model)
    plate = model.body_label.index("worldbody/plate")
    assert solver._solved.body_inv_mass.numpy()[solver._solved.body_of_link[plate]] == 0.0


def test_a_massless_root_that_floats_is_refused_where_nothing_resists_its_turns() -> None:
    builder = newton.ModelBuilder()
    root = builder.add_link(label="pelvis")
    bob = add_bob(builder)
    floats = builder.add_joint_free(root, label="floats")
    hinge = builder.add_joint_revolute(root, bob, axis=(0.0, 1.0, 0.0))
    builder.add_articulation([floats, hinge])
    with pytest.raises(ValueError, match=r"'pelvis' has no mass, floats on joint 0 'floats'"):
        Simulation(builder, collide=False)


def test_a_massless_root_welded_to_a_trunk_falls_with_it() -> None:
    builder = newton.ModelBuilder()
    root = builder.add_link(label="base_link")
    trunk = add_bob(builder)
    builder.add_articulation([builder.add_joint_free(root), builder.add_joint_fixed(root, trunk)])
    sim = Simulation(builder, collide=False)
    sim.step(24)
    np.testing.assert_allclose(sim.velocity[:, 2], -9.81 * 24 * DT, rtol=1e-5)


def test_a_massless_mount_without_a_joint_stays_where_it_is() -> None:
    """A body without mass that no joint holds is where the user puts it, also with a pendulum."""
    builder = newton.ModelBuilder()
    mount = builder.add_link(xform=transform((0.0, 0.0, 2.0)))
    bob = add_bob(builder)
    builder.body_q[bob] = transform((0.0, 0.0, 2.0))
    builder.add_articulation([builder.add_joint_revolute(mount, bob, axis=(0.0, 1.0, 0.0))])
    sim = Simulation(builder, collide=False, is_checked=False)
    sim.step(24)
    np.testing.assert_array_equal(sim.pose[mount], [0, 0, 2, 0, 0, 0, 1])
    assert sim.pose[bob, 2] == pytest.approx(2.0, abs=1e-5)


def test_mass_that_a_massless_link_gets_counts_and_one_that_it_loses_does_not() -> None:
    """Both by notify_model_changed: the weight on the joint above says so."""
    builder = newton.ModelBuilder()
    middle, bob, y = builder.add_link(), add_bob(builder), (0.0, 1.0, 0.0)
    upper = builder.add_joint_revolute(-1, middle, axis=y)
    builder.add_articulation([upper, builder.add_joint_revolute(middle, bob, axis=(1.0, 0.0, 0.0))])
    sim = Simulation(builder, collide=False)
    wrench = sim.observe("body_parent_f")
    model = sim.model
    for mass, expected in ((0.0, 2.0), (3.0, 5.0), (0.0, 2.0)):
        inverse = 1.0 / mass if mass else 0.0
        for name, value in (("mass", mass), ("inv_mass", inverse)):
            values = getattr(model, f"body_{name}").numpy()
            values[middle] = value
            getattr(model, f"body_{name}").assign(values)
        for name, value in (("inertia", mass), ("inv_inertia", inverse)):
            values = getattr(model, f"body_{name}").numpy()
            values[middle] = value * np.eye(3)
            getattr(model, f"body_{name}").assign(values)
        sim.solver.notify_model_changed(newton.ModelFlags.BODY_INERTIAL_PROPERTIES)
        sim.step(5)
        force = wrench.body_parent_f.numpy()[middle, 2]
        assert force == pytest.approx(expected * 9.81, rel=1e-4)
    model.body_mass.assign([0.0, 6.0])
    model.body_inv_mass.assign([0.0, 1.0 / 6.0])
    assert sim.solver.unnoticed_changes() == []
    sim.step(5)  # the mass of the bob acts without a call
    assert wrench.body_parent_f.numpy()[middle, 2] == pytest.approx(6.0 * 9.81, rel=1e-4)
    model.body_mass.assign([3.0, 6.0])
    assert sim.solver.unnoticed_changes() == ["topology"]
