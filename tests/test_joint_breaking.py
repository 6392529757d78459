# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A joint breaks at the force or torque that a scene authors, and stays broken until a reset."""

from pathlib import Path
from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import G, Simulation
from joint_scenes import WORLD, add_link, anchor_gaps, simulate, transform

from newton_avbd import SolverAVBD

MASS = 2.0
ARM = 0.5
HINGE = (0.0, 1.0, 0.0)


def breakable(**settings: Any) -> newton.ModelBuilder:
    builder = newton.ModelBuilder(**settings)
    SolverAVBD.register_custom_attributes(builder)
    return builder


def limits(force: float = np.inf, torque: float = np.inf) -> dict[str, Any]:
    """What a joint is to be added with."""
    return {
        "custom_attributes": {"avbd:joint_break_force": force, "avbd:joint_break_torque": torque}
    }


def cantilever(
    links: int = 1, blocks: str = "articulation", scheme: str | None = None, **most: float
) -> Simulation:
    """Bodies of 2 kg in a row, welded to each other and the first to a wall, which may break."""
    builder = breakable()
    parent, joints = WORLD, []
    for i in range(links):
        body = add_link(builder, mass=MASS)
        joints.append(
            builder.add_joint_fixed(
                parent,
                body,
                child_xform=transform((-ARM, 0.0, 0.0)),
                **(limits(**most) if i == 0 else {}),
            )
        )
        parent = body
    builder.add_articulation(joints)
    return simulate(builder, blocks=blocks, scheme=scheme)


def breaking_load(sim: Simulation, body: int, load: Any, step: float) -> float:
    """Load at which the first joint breaks when it grows slowly, in multiples of ``load``."""
    share = 0.0
    while sim.solver.status.broken_joints.size == 0 and share < 100.0:
        share += step
        sim.push(body, *(share * np.asarray(load, dtype=float)))
        sim.step()
    return share


@pytest.mark.parametrize("blocks", ["articulation", "body"])
def test_a_joint_breaks_at_its_force(blocks: str) -> None:
    """A weight that grows slowly: 2 % of the authored force, of which its own weight is a part."""
    sim = cantilever(blocks=blocks, force=100.0)
    pull = breaking_load(sim, 0, [(0.0, 0.0, -1.0), (0.0, 0.0, 0.0)], 0.5)
    assert pull + MASS * G == pytest.approx(100.0, rel=0.02)


@pytest.mark.parametrize("blocks", ["articulation", "body"])
def test_a_joint_breaks_at_its_torque(blocks: str) -> None:
    """A cantilever's: the weight on its arm and what twists it, added as vectors."""
    sim = cantilever(blocks=blocks, torque=20.0)
    twist = breaking_load(sim, 0, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], 0.1)
    assert np.hypot(twist, MASS * G * ARM) == pytest.approx(20.0, rel=0.02)


def test_a_joint_carries_all_that_hangs_on_it() -> None:
    """Three bodies in a row: their weight, and its torque m g (l + 2 l + 3 l), break the first."""
    torque = MASS * G * ARM * (1 + 2 + 3)
    for most, breaks in ((1.02 * torque, False), (0.98 * torque, True)):
        sim = cantilever(3, torque=most)
        sim.step(10)
        assert (sim.solver.status.broken_joints.size > 0) is breaks
    for most, breaks in ((1.02 * 3 * MASS * G, False), (0.98 * 3 * MASS * G, True)):
        sim = cantilever(3, force=most)
        sim.step(10)
        assert (sim.solver.status.broken_joints.size > 0) is breaks


def test_along_its_free_axis_a_joint_carries_nothing() -> None:
    """What a drive pushes with is not in the hinge: 10 N m of drive, 0.1 N m of strength."""
    builder = breakable(gravity=(0.0, 0.0, 0.0))
    body = add_link(builder, inertia=(0.1, 0.1, 0.1))
    joint = builder.add_joint_revolute(
        WORLD, body, axis=HINGE, target_kd=10.0, **limits(torque=0.1)
    )
    builder.add_articulation([joint])
    sim = simulate(builder)
    sim.control.joint_target_qd.fill_(1.0)
    sim.model.joint_target_mode.fill_(int(newton.JointTargetMode.VELOCITY))
    sim.step(50)
    assert sim.solver.status.broken_joints.size == 0
    sim.push(0, torque=(0.2, 0.0, 0.0))
    sim.step()
    assert list(sim.solver.status.broken_joints) == [joint]


def test_a_broken_joint_is_as_a_disabled_one() -> None:
    """Its body falls freely from the next step on; ``joint_enabled`` stays as it was."""
    sim = cantilever(scheme="euler", force=10.0)
    sim.step()
    assert list(sim.solver.status.broken_joints) == [0]
    start, v = sim.pose[0, 2], sim.velocity[0, 2]
    sim.step(60)
    fallen = sum(v - i * G * sim.dt for i in range(1, 61)) * sim.dt
    assert sim.pose[0, 2] - start == pytest.approx(fallen, rel=1.0e-3)
    assert np.abs(sim.velocity[0, 3:]).max() < 1.0e-5
    assert sim.model.joint_enabled.numpy().all()


def test_a_broken_joint_stays_broken_where_other_links_become_one_body() -> None:
    """A weld beside it is switched off and on again, each time with a call."""
    builder = breakable()
    ends = [add_link(builder, mass=MASS, inertia=(0.1, 0.1, 0.1)) for _ in range(3)]
    joints = [builder.add_joint_free(ends[0]), builder.add_joint_fixed(ends[0], ends[1])]
    builder.add_articulation(joints)
    hinge = builder.add_joint_revolute(WORLD, ends[2], axis=HINGE, **limits(force=10.0))
    builder.add_articulation([hinge])
    sim = simulate(builder)
    sim.step()
    for is_weld in (False, True):
        assert list(sim.solver.status.broken_joints) == [hinge]
        sim.model.joint_enabled.assign([True, is_weld, True])
        sim.solver.notify_model_changed(newton.ModelFlags.JOINT_PROPERTIES)
    sim.step(20)
    # the hinge held in the step in which it broke
    fallen = np.array([21, 21, 20]) * G * sim.dt
    np.testing.assert_allclose(-sim.velocity[:, 2], fallen, rtol=1e-4)


@pytest.mark.filterwarnings("ignore:.*another joint already connects.*")
def test_a_loop_joint_breaks() -> None:
    """A plank on two hinges of which one, no part of the tree, holds half of its weight."""
    most = 0.5 * MASS * G
    for share, breaks in ((1.02, False), (0.98, True)):
        builder = breakable()
        plank = add_link(builder, mass=MASS, inertia=(0.01, 0.2, 0.2))
        joints = [
            builder.add_joint_revolute(
                WORLD,
                plank,
                parent_xform=transform((x, 0.0, 0.0)),
                child_xform=transform((x, 0.0, 0.0)),
                axis=HINGE,
                **(limits(force=share * most) if x > 0.0 else {}),
            )
            for x in (-0.5, 0.5)
        ]
        builder.add_articulation(joints[:1])
        sim = simulate(builder)
        sim.step(10)
        assert list(sim.solver.status.broken_joints) == ([joints[1]] if breaks else [])
        sim.step(60)
        assert bool(anchor_gaps(sim)[1] > 0.1) is breaks


def test_a_reset_mends_the_joints_of_its_worlds() -> None:
    """And no others."""
    world = breakable()
    body = add_link(world, mass=MASS)
    world.add_articulation([world.add_joint_fixed(WORLD, body, **limits(force=10.0))])
    builder = breakable()
    builder.replicate(world, 3)
    sim = simulate(builder)
    sim.step(2)
    assert list(sim.solver.status.broken_joints) == [0, 1, 2]
    sim.solver.reset(sim.state, wp.array([False, True, False, False], dtype=wp.bool, device="cpu"))
    assert list(sim.solver.status.broken_joints) == [0, 2]


def test_limits_come_from_usd(tmp_path: Path) -> None:
    """``physics:breakForce`` and ``physics:breakTorque`` of UsdPhysics joints."""
    pxr = pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics

    assert pxr
    stage = Usd.Stage.CreateNew(str(tmp_path / "scene.usda"))
    UsdPhysics.Scene.Define(stage, "/scene")
    box = UsdGeom.Cube.Define(stage, "/box").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(box)
    UsdPhysics.CollisionAPI.Apply(box)
    joint = UsdPhysics.FixedJoint.Define(stage, "/joint")
    joint.CreateBody1Rel().SetTargets(["/box"])
    joint.CreateBreakForceAttr(30.0)
    joint.CreateBreakTorqueAttr(4.0)
    stage.Save()
    builder = breakable()
    builder.add_usd(str(tmp_path / "scene.usda"))
    model = builder.finalize(device="cpu")
    assert model.avbd.joint_break_force.numpy() == pytest.approx([30.0])
    assert model.avbd.joint_break_torque.numpy() == pytest.approx([4.0])
    assert SolverAVBD(model).effects.flags.breaking


@pytest.mark.parametrize("value", [-1.0, np.nan])
def test_a_limit_that_makes_no_sense_is_refused(value: float) -> None:
    builder = breakable()
    body = add_link(builder)
    builder.add_articulation([builder.add_joint_fixed(WORLD, body, **limits(force=value))])
    with pytest.raises(ValueError, match="joint_break_force"):
        SolverAVBD(builder.finalize(device="cpu"))
