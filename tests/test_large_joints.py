# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints in one large world, block by block and color by color, beside the kernel of a world."""

import newton
import numpy as np
import pytest
import warp as wp
from helpers import Simulation, add_box, add_ground, add_mass
from joint_scenes import WORLD, add_link, anchor_gaps, transform

from newton_avbd.__main__ import main
from newton_avbd.scenes.named import add_ragdoll, add_ragdoll_heap


def ragdolls(count: int = 5) -> newton.ModelBuilder:
    """Ragdolls that lie across each other, just apart."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    for i in range(count):
        turn = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), 0.5 * i)
        flat = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), 0.5 * np.pi)
        add_ragdoll(builder, (0.02 * i, 0.0, 0.1 + 0.201 * i), turn * flat)
    return builder


def joint_gap(simulation: Simulation) -> float:
    """Largest distance of the anchors of a hinge [m]."""
    is_hinge = simulation.model.joint_type.numpy() == int(newton.JointType.REVOLUTE)
    return anchor_gaps(simulation)[is_hinge].max()


def in_order_of_colors(colored: Simulation, serial: Simulation) -> None:
    """Has the kernel of a world visit blocks in the order of the colors."""
    large, solver = colored.solver._large, serial.solver
    block, count = large.colors.block.numpy(), serial.model.body_count
    order = large._worlds.bodies.numpy()
    first = large.colors.order.numpy()[: np.unique(block[:count]).size]
    by_block = [order[block[order] == body] for body in first]
    ends = np.cumsum([len(bodies) for bodies in by_block])
    order = np.concatenate(by_block)
    solver._worlds.bodies.assign(order)
    solver._worlds.rank.assign(np.append(np.argsort(order), order.size))
    sizes = [len(bodies) for bodies in by_block]
    solver._worlds.block_end.assign(np.append(np.repeat(ends, sizes), -1))


def test_a_sweep_of_trees_is_that_of_one_thread_in_the_order_of_the_colors() -> None:
    """To rounding: blocks of a color cannot tell which of them was first."""
    colored = Simulation(ragdolls(), parallel="bodies", iterations=3)
    serial = Simulation(ragdolls(), iterations=3, effects={"mixing": False})
    colored.step()
    assert colored.solver.status.colors >= 2
    order = colored.solver._large.colors.order.numpy()[:5].copy()
    in_order_of_colors(colored, serial)
    serial.step()
    for _ in range(4):
        np.testing.assert_allclose(colored.pose, serial.pose, atol=2e-7)
        np.testing.assert_allclose(colored.velocity, serial.velocity, atol=5e-5)
        assert colored.solver.status.sweeps == serial.solver.status.sweeps
        colored.step()
        serial.step()
    np.testing.assert_array_equal(colored.solver._large.colors.order.numpy()[:5], order)


@pytest.mark.long
def test_a_heap_of_ragdolls_comes_to_rest() -> None:
    """Twelve fall on each other; joints are closed all the way.

    When the last limb stops swinging is a matter of rounding: after 5 s.
    """
    builder = newton.ModelBuilder()
    add_ragdoll_heap(builder, ragdolls=12)
    simulation = Simulation(builder, parallel="bodies")
    open_by = 0.0
    for _ in range(100):
        simulation.step(12)
        open_by = max(open_by, joint_gap(simulation))
    status = simulation.solver.status
    assert open_by < 1e-5
    assert simulation.penetration < 5e-4
    assert np.linalg.norm(simulation.velocity[:, :3], axis=1).max() < 0.1
    assert status.clashes == 0 and status.colors >= 3
    assert not status.held_steps.any() and not status.dropped_contacts


def robots_and_boxes() -> newton.ModelBuilder:
    """A pyramid of boxes, and two ragdolls with stiff drives, one on it and one beside it."""
    builder = newton.ModelBuilder()
    add_ground(builder)
    for row in range(5):
        for i in range(5 - row):
            add_box(builder, (0.55 * (i - 0.5 * (4 - row)), 0.0, 0.5 * (row + 0.5)))
    for x, z in ((0.0, 2.98), (2.5, 0.48)):
        add_ragdoll(builder, (x, 0.0, z + 0.2), stiffness=2e4)
    return builder


def test_what_rests_rests_in_the_same_place() -> None:
    """Ragdolls that stand on stiff legs, of which one on top of boxes, after half a second."""
    colored = Simulation(robots_and_boxes(), parallel="bodies", iterations=60)
    serial = Simulation(robots_and_boxes(), iterations=60)
    for simulation in (colored, serial):
        simulation.run(0.5)
        assert joint_gap(simulation) < 2e-6
    np.testing.assert_allclose(colored.pose, serial.pose, atol=2e-3)
    assert abs(colored.penetration - serial.penetration) < 1e-5


def mechanisms() -> newton.ModelBuilder:
    """Mechanisms apart from each other: every order of the blocks gives the same.

    A four-bar that a joint closes, a gripper of which one finger mimics the other, with armature
    and friction, two bodies on strings, a body on a hinge that is disabled, and one that hangs on
    a kinematic crank, beside a box on the ground.
    """
    builder = newton.ModelBuilder()
    add_ground(builder)
    add_box(builder, (-3.0, 0.0, 0.3))
    hinge = {"axis": (0.0, 1.0, 0.0)}

    rods, joints, parent, before = [], [], WORLD, transform((0.0, 0.0, 3.0))
    for turn in (0.3, 0.9):
        rods.append(add_link(builder))
        frame = {"parent_xform": before, "child_xform": transform((-0.25, 0.0, 0.0))}
        joints.append(builder.add_joint_revolute(parent, rods[-1], **frame, **hinge))
        builder.joint_q[-1] = turn
        parent, before = rods[-1], transform((0.25, 0.0, 0.0))
    builder.add_articulation(joints)
    at = 0.5 * np.array([np.cos(0.3) + np.cos(1.2), 0.0, -np.sin(0.3) - np.sin(1.2)]) + [0, 0, 3.0]
    closing = add_link(builder)
    ends = {"parent_xform": transform(at), "child_xform": transform((-0.25, 0.0, 0.0))}
    closed = builder.add_joint_revolute(WORLD, closing, **ends, **hinge)
    builder.add_articulation([closed])
    ends = {"parent_xform": before, "child_xform": transform((-0.25, 0.0, 0.0))}
    builder.add_joint_ball(rods[1], closing, **ends)

    base = add_link(builder)
    fingers = [builder.add_joint_fixed(WORLD, base, parent_xform=transform((2.0, 0.0, 2.0)))]
    for side in (1.0, -1.0):
        fingers.append(
            builder.add_joint_prismatic(
                base,
                add_link(builder),
                parent_xform=transform((0.0, 0.2 * side, 0.0)),
                axis=(0.0, 0.0, 1.0),
                armature=0.5,
                friction=1.0,
                target_ke=50.0,
                target_kd=5.0,
                limit_lower=-0.05,
                limit_upper=0.05,
            )
        )
    builder.add_articulation(fingers)
    builder.set_joint_mimic(fingers[2], fingers[1], coeffs=(0.0, 0.5))

    ball, other = (add_mass(builder, position=(4.0 + d, 0.0, 3.0)) for d in (0.0, 0.5))
    nail = transform((4.0, 0.2, 3.2))
    builder.add_joint_distance(WORLD, ball, parent_xform=nail, max_distance=0.5)
    builder.add_joint_distance(ball, other, max_distance=0.6)

    nail = transform((6.0, 0.0, 5.0))
    loose = builder.add_joint_revolute(WORLD, add_link(builder), parent_xform=nail)
    builder.add_articulation([loose])
    builder.joint_enabled[loose] = False

    crank = add_link(builder, xform=transform((8.0, 0.0, 3.0)), is_kinematic=True)
    builder.body_qd[crank] = wp.spatial_vector(0.0, 0.3, 0.0, 0.0, 2.0, 0.0)
    free = builder.add_joint_free(crank)
    builder.joint_q[-7:-4] = [8.0, 0.0, 3.0]
    hung = add_link(builder)
    ends = {"parent_xform": transform((0.3, 0.0, 0.0)), "child_xform": transform((0.0, 0.0, 0.3))}
    builder.add_articulation([free, builder.add_joint_revolute(crank, hung, **ends, **hinge)])
    return builder


@pytest.mark.filterwarnings("ignore:.*another joint already connects.*")
def test_mechanisms_move_as_one_thread_moves_them() -> None:
    """Loops, mimics, strings, armature, friction, drives, limits, disabled and kinematic ends."""

    def simulation(parallel: str) -> Simulation:
        return Simulation(mechanisms(), parallel=parallel)

    colored, serial = simulation("bodies"), simulation("worlds")
    for effect in ("loops", "closures", "mimics", "armature", "joint_friction", "limits"):
        assert getattr(colored.solver._flags, effect)
    for _ in range(6):
        colored.step(10)
        serial.step(10)
        np.testing.assert_allclose(colored.pose, serial.pose, atol=2e-5)
        np.testing.assert_allclose(colored.velocity, serial.velocity, atol=2e-3)
    assert not colored.solver.status.held_steps.any()


def test_the_command_measures_joints(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["large", "ragdolls", "--bodies", "15", "--steps", "4", "--device", "cpu"]) == 0
    line = capsys.readouterr().out.splitlines()[-1].split()
    assert line[:2] == ["ragdolls", "15"]
    assert int(line[3]) > 0
