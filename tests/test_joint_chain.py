# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Chains of hinges: closed whatever hangs at their end, and wherever they are."""

import itertools

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, G, Simulation
from joint_scenes import (
    TENSOR,
    add_hinge_chain,
    add_link,
    anchor_gaps,
    coordinates,
    set_coordinates,
    simulate,
    transform,
)
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD

LENGTH = 0.1


def chain(count: int, end_mass: float = 1.0, base: tuple = (0, 0, 0), **settings) -> Simulation:
    """A horizontal chain of links of 1 kg and 0.1 m with another mass at its end, about to fall."""
    builder = newton.ModelBuilder()
    masses = [1.0] * (count - 1) + [end_mass]
    add_hinge_chain(builder, count, length=LENGTH, masses=masses, base=base)
    return simulate(builder, **settings)


def tips(sim: Simulation) -> np.ndarray:
    """Ends of the links relative to the base [m], in the plane of the chain, from its angles.

    Angles come from rotations alone, which are as exact at 10 km as near the origin.
    """
    angle = np.cumsum(coordinates(sim)[0])
    return LENGTH * np.cumsum(np.stack([np.cos(angle), -np.sin(angle)], axis=1), axis=0)


@pytest.mark.parametrize("end_mass", [1.0, 1.0e2, 1.0e4])
def test_a_chain_stays_closed_whatever_its_end_weighs(end_mass: float) -> None:
    """20 links swing for 3 s with 1, 100 and 10,000 times a link's mass at the end.

    Anchors stay within 1e-5 m, links in their plane, energy does not grow, and the end comes
    down as it should: through the lowest point, 2 m below.
    """
    sim = chain(20, end_mass)
    energy, scale = sim.energy, sim.mass.sum() * G * 20 * LENGTH
    widest, lowest, highest = 0.0, 0.0, energy
    for _ in range(720):
        sim.step()
        widest = max(widest, anchor_gaps(sim).max())
        lowest = min(lowest, sim.pose[-1, 2])
        highest = max(highest, sim.energy)
    assert widest < 1.0e-5
    assert highest - energy < 1.0e-4 * scale
    assert -20 * LENGTH < lowest < -0.95 * 20 * LENGTH
    assert np.abs(sim.pose[:, 1]).max() < 1.0e-5


def test_a_heavy_end_falls_as_on_a_massless_string() -> None:
    """A chain with 10,000 times the mass at its end is a point on a string of 1.95 m.

    From horizontal, the energy at the bottom is m g times the drop: v^2 = 2 g drop. Backward Euler
    loses (w dt)^2 a step, about 1 %; hidden dissipation of an unsolved chain would show at once.
    """
    sim = chain(20, 1.0e4)
    fastest = 0.0
    for _ in range(360):
        sim.step()
        fastest = max(fastest, np.linalg.norm(sim.velocity[-1, :3]))
    assert fastest == pytest.approx(np.sqrt(2.0 * G * 1.95), rel=2.0e-2)


def test_a_chain_moves_alike_ten_kilometres_away() -> None:
    """10 links for 1 s at x = 0 and at x = 10 km: the same shape, read off orientations.

    There float32 holds positions to a unit of 1 mm. The solver takes differences of positions
    first and remembers what rounding took from each, so that shapes differ by 1e-3 m at most
    (1e-6 here); a state of such numbers alone makes a falling chain stray by 7.5 mm.
    """
    near, far = chain(10), chain(10, base=(1.0e4, 0.0, 0.0))
    lowest = 0.0
    for _ in range(240):
        near.step()
        far.step()
        assert np.abs(tips(far) - tips(near)).max() < 1.0e-3
        lowest = min(lowest, tips(far)[-1, 1])
    assert lowest < -0.5 * 10 * LENGTH  # it fell


def test_a_chain_at_rest_hangs_still() -> None:
    """Hung straight, 20 links with 100 times the mass at the end do not move: 1e-5 m.

    Speed below 5e-4 m/s: closing what float32 rounds off positions of 2 m is 3e-5 m/s a joint.
    """
    builder = newton.ModelBuilder()
    joints = add_hinge_chain(builder, 20, length=LENGTH, masses=[1.0] * 19 + [100.0])
    set_coordinates(builder, joints[0], [np.pi / 2])
    sim = simulate(builder)
    start = sim.pose
    for _ in range(240):
        sim.step()
        assert np.abs(sim.velocity[:, :3]).max() < 5.0e-4
    assert sim.pose == pytest.approx(start, abs=1.0e-5)


def test_a_chain_in_many_worlds_is_the_same_chain() -> None:
    """Each of 3 worlds gives what one alone gives, bit for bit."""
    one, many = newton.ModelBuilder(), newton.ModelBuilder()
    add_hinge_chain(one, 5, length=LENGTH)
    many.replicate(one, 3)
    alone, together = simulate(one), simulate(many)
    alone.step(120)
    together.step(120)
    pose = together.state.body_q.numpy().reshape(3, 5, 7)
    for world in range(3):
        np.testing.assert_array_equal(pose[world], alone.state.body_q.numpy())


@pytest.mark.parametrize("scheme", ["euler", "generalized_alpha"])
def test_a_spinning_chain_without_gravity_does_not_speed_up(scheme: str) -> None:
    """Thrown around its base at 5 rad/s for 2 s: no energy is gained, and anchors hold to 1e-5 m.

    By backward Euler it falls from step to step, of second order it is never above the first.
    """
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    joints = add_hinge_chain(builder, 5, length=LENGTH)
    set_coordinates(builder, joints[0], qd=[5.0])
    sim = simulate(builder, scheme=scheme)
    energy = sim.energy
    for _ in range(480):
        sim.step()
        assert sim.energy < energy * (1.0 + 1.0e-5)
        if scheme == "euler":
            energy = sim.energy
        assert anchor_gaps(sim).max() < 1.0e-5


@pytest.mark.parametrize("end", [1.0, 1.0e4])
def test_ball_joints_turn_alike_beside_a_drive(end: float) -> None:
    """Free ball joints are eliminated at once, beside a drive anywhere axis by axis: the same.

    Five links of uneven inertia that a moving root carries, one joint the other way around, with
    torques on all; equal links or 10,000 times as much at the end, for 1 s.
    """
    paths = []
    for has_drive in (False, True):
        builder = newton.ModelBuilder()
        links = [add_link(builder) for _ in range(4)]
        links.append(add_link(builder, mass=end, inertia=end * TENSOR))
        for i, (parent, child) in enumerate(itertools.pairwise(links)):
            ends = [(parent, (0.2, 0.05, 0.0)), (child, (-0.2, 0.0, 0.1))]
            if i == 2:
                ends.reverse()
            (first, at_first), (second, at_second) = ends
            builder.add_joint_ball(
                first,
                second,
                parent_xform=transform(at_first, Rotation.from_rotvec([0.3, 0.1, 0.2])),
                child_xform=transform(at_second),
            )
            offset = np.array([0.4, 0.05, -0.1]) * (i + 1)
            builder.body_q[child] = transform(offset)
        if has_drive:
            arm = add_link(builder)
            builder.add_joint_revolute(-1, arm, axis=(0, 1, 0), target_ke=1.0)
        # a joint the other way around belongs to no articulation
        model = builder.finalize(device="cpu", skip_all_validations=True)
        solver, state, out = SolverAVBD(model), model.state(), model.state()
        assert solver.effects.flags.free_balls != has_drive
        control = model.control()
        torque = np.zeros(model.joint_dof_count, dtype=np.float32)
        torque[:12] = np.linspace(-0.3, 0.4, 12)
        control.joint_f.assign(torque)
        for _ in range(240):
            solver.step(state, out, control, None, 1.0 / 240.0)
            state, out = out, state
        paths.append(state.body_q.numpy()[:5])
    assert np.abs(paths[0] - paths[1]).max() < 1.0e-4
    assert np.abs(paths[0][:, :3]).max() > 0.5


@pytest.mark.long
@pytest.mark.parametrize("end", [1.0, 100.0])
def test_chains_that_collapse_on_themselves_stay_closed(end: float) -> None:
    """20 balls on ball joints, upright on the first one, fall and pile up from 16 tilts.

    The end weighs as the others or 100 times as much. Joints stay within 1e-5 m throughout, and
    nothing is faster than 20 m/s, of which a fall from top to bottom gives 9.
    """
    builder = newton.ModelBuilder()
    for tilt in np.radians(np.linspace(0.1, 3.1, 16)):
        builder.add_world(ball_chain(20, end, tilt))
    sim = Simulation(builder)
    widest, fastest, deepest = 0.0, 0.0, 0.0
    for _ in range(480):
        sim.step()
        widest = max(widest, anchor_gaps(sim).max())
        fastest = max(fastest, np.linalg.norm(sim.velocity[:, :3], axis=1).max())
        deepest = max(deepest, sim.penetration)
    assert widest < 1.0e-5
    assert fastest < 20.0
    assert 0.0 < deepest < 0.1 * LENGTH  # they do touch


def ball_chain(count: int, end: float, tilt: float) -> newton.ModelBuilder:
    """A chain of balls with a density at the end that is ``end`` times that of the others."""
    builder = newton.ModelBuilder()
    turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), float(tilt))
    up, half = wp.quat_rotate(turn, wp.vec3(0.0, 0.0, LENGTH)), wp.vec3(0.0, 0.0, 0.5 * LENGTH)
    joints: list[int] = []
    for i in range(count):
        ball = builder.add_link(xform=wp.transform((i + 0.5) * up, turn))
        density = 1000.0 * (end if i == count - 1 else 1.0)
        cfg = newton.ModelBuilder.ShapeConfig(density=density)
        builder.add_shape_sphere(ball, radius=0.45 * LENGTH, cfg=cfg)
        frame = wp.transform(half, wp.quat_identity()) if i else wp.transform(wp.vec3(), turn)
        joints.append(
            builder.add_joint_ball(
                parent=ball - 1,
                child=ball,
                parent_xform=frame,
                child_xform=wp.transform(-half, wp.quat_identity()),
            )
        )
    builder.add_articulation(joints)
    return builder


def test_body_by_body_descent_closes_a_short_chain() -> None:
    """``blocks="body"`` solves body by body: with 50 sweeps 3 links stay within 1 mm for 2 s."""
    sim = chain(3, blocks="body", iterations=50)
    widest = lowest = 0.0
    for _ in range(480):
        sim.step()
        widest = max(widest, anchor_gaps(sim).max())
        lowest = min(lowest, sim.pose[-1, 2])
    assert widest < 1.0e-3
    assert lowest < -0.9 * 3 * LENGTH + 0.5 * LENGTH


def test_an_unknown_kind_of_block_is_an_error() -> None:
    """The message names what there is."""
    with pytest.raises(ValueError, match="body"):
        chain(1, blocks="nobody")
