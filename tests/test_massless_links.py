# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Massless links between joints move with what hangs on them; where nothing does, that is said."""

import warnings

import newton
import numpy as np
import pytest
import warp as wp
from helpers import IDENTITY, Simulation

DT = 1.0 / 240.0


def transform(position=(0.0, 0.0, 0.0), rotation=IDENTITY) -> wp.transform:
    return wp.transform(wp.vec3(*position), rotation)


def add_bob(builder: newton.ModelBuilder) -> int:
    """A body whose moments of inertia differ, half a meter below its joint."""
    inertia = wp.mat33(0.05, 0.0, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 0.02)
    return builder.add_link(mass=2.0, inertia=inertia, com=wp.vec3(0.0, 0.0, -0.5))


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
    joints = [builder.add_joint_revolute(-1, links[0], axis=y)]
    joints.append(builder.add_joint_revolute(links[0], links[1], axis=y))
    builder.add_articulation(joints)
    with pytest.raises(ValueError, match=r"'upper' has no mass at all \('upper', 'lower'\)"):
        Simulation(builder, collide=False)


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
