# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joint coordinates that a user writes without the poses of bodies, with ``update_joint_state``.

As programs for ``SolverMuJoCo`` and ``SolverFeatherstone`` do, whose states are joint coordinates.
"""

from typing import Any

import newton
import numpy as np
import pytest
import warp as wp
from helpers import NO_GRAVITY, Simulation, add_mass
from joint_scenes import WORLD, add_contact, add_hinge_chain, add_link, set_coordinates

from newton_avbd import SolverAVBD

DT = 1.0 / 240.0
LINKS = 3


def chain() -> newton.ModelBuilder:
    """Three hinged rods, and a free body beside them."""
    builder = newton.ModelBuilder()
    add_hinge_chain(builder, LINKS, length=0.5, base=(0.0, 0.0, 3.0))
    add_mass(builder, position=(2.0, 0.0, 5.0))
    return builder


def simulate(builder: newton.ModelBuilder, **settings: Any) -> Simulation:
    """A simulation whose bodies start where the builder has them, whatever its joints say."""
    return Simulation(
        builder, collide=False, make_solver=SolverAVBD, update_joint_state=True, **settings
    )


def write(state: newton.State, q: Any = (), qd: Any = ()) -> None:
    """Writes the first joint coordinates of a state, as a program does."""
    for array, values in ((state.joint_q, q), (state.joint_qd, qd)):
        new = array.numpy()
        new[: len(values)] = values
        array.assign(new)


def arrays(sim: Simulation) -> dict[str, np.ndarray]:
    names = ("body_q", "body_qd", "joint_q", "joint_qd")
    return {name: getattr(sim.state, name).numpy() for name in names}


def assert_same(a: Simulation, b: Simulation) -> None:
    for name, found in arrays(a).items():
        np.testing.assert_array_equal(found, arrays(b)[name])


@pytest.mark.parametrize(
    "settings", [{}, {"blocks": "body"}, {"parallel": "bodies"}, {"scheme": "generalized_alpha"}]
)
def test_written_coordinates_move_the_bodies(settings: dict[str, Any]) -> None:
    """To the same bits as if the program had called ``newton.eval_fk``, which it may do, too."""
    builders = chain(), chain()
    if "parallel" in settings:
        for builder in builders:
            add_contact(builder, LINKS)
    alone, posed = (simulate(builder, **settings) for builder in builders)
    for sim in (alone, posed):
        sim.step(10)
        write(sim.state, (0.4, -0.3, 0.2), (1.0, 0.0, -2.0))
    newton.eval_fk(posed.model, posed.state.joint_q, posed.state.joint_qd, posed.state)
    for sim in (alone, posed):
        sim.step(10)
    assert_same(alone, posed)
    # 10 steps at the 5 m/s^2 or so of a falling rod and 1 rad/s: not far from what was written
    assert alone.state.joint_q.numpy()[:3] == pytest.approx([0.4, -0.3, 0.2], abs=0.15)


def test_written_poses_count_where_both_were_written() -> None:
    """The coordinates that were written beside them are overwritten by those of the poses."""
    sim = simulate(chain())
    sim.step(10)
    q = wp.array([0.1, 0.2, 0.3, *sim.state.joint_q.numpy()[3:]], dtype=float)
    newton.eval_fk(sim.model, q, sim.model.joint_qd, sim.state)
    write(sim.state, (1.0, 1.0, 1.0))
    sim.step()
    assert sim.state.joint_q.numpy()[:3] == pytest.approx([0.1, 0.2, 0.3], abs=1.0e-2)


def test_a_first_step_starts_at_the_coordinates_of_the_model() -> None:
    """Importers pose bodies before a program edits ``builder.joint_q``, as in ``add_urdf``."""
    edited, posed = chain(), chain()
    for builder in (edited, posed):
        set_coordinates(builder, 0, (0.7,), (0.5,))
    a, b = simulate(edited), simulate(posed)
    newton.eval_fk(b.model, b.model.joint_q, b.model.joint_qd, b.state)
    for sim in (a, b):
        sim.step(5)
    assert_same(a, b)
    assert a.state.joint_q.numpy()[0] > 0.7


def test_velocities_alone_may_be_written() -> None:
    """Without gravity a wheel turns on at the speed that was written, from where it is."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    joint = builder.add_joint_revolute(WORLD, add_link(builder), axis=(0.0, 0.0, 1.0))
    builder.add_articulation([joint])
    sim = simulate(builder)
    write(sim.state, qd=(2.0,))
    sim.step(24)
    assert sim.state.joint_q.numpy()[0] == pytest.approx(24 * sim.dt * 2.0, rel=1.0e-5)
    write(sim.state, qd=(-2.0,))
    sim.step(24)
    assert sim.state.joint_q.numpy()[0] == pytest.approx(0.0, abs=1.0e-6)


def test_written_angles_keep_their_turns() -> None:
    """Sent from 0 to 7 rad with a drive to 7 rad there is nothing to do; poses say 0.717 rad."""
    builder = newton.ModelBuilder(gravity=NO_GRAVITY)
    joint = builder.add_joint_revolute(
        WORLD, add_link(builder), axis=(0.0, 0.0, 1.0), target_q=7.0, target_ke=60.0, target_kd=8.0
    )
    builder.add_articulation([joint])
    sim = simulate(builder)
    sim.step()
    write(sim.state, (7.0,), (0.0,))
    sim.step(24)
    assert sim.state.joint_q.numpy()[0] == pytest.approx(7.0, abs=1.0e-5)


def worlds() -> newton.ModelBuilder:
    builder = newton.ModelBuilder()
    builder.replicate(chain(), 3)
    return builder


def test_other_articulations_stay_as_they_are() -> None:
    """The worlds beside, and the free body of the same world, go on to the same bits."""
    written, left = simulate(worlds()), simulate(worlds())
    for sim in (written, left):
        sim.step(10)
    write(written.state, (0.4, -0.3, 0.2))
    for sim in (written, left):
        sim.step(10)
    a, b = (sim.state.body_q.numpy() for sim in (written, left))
    np.testing.assert_array_equal(a[LINKS:], b[LINKS:])
    assert np.abs(a[:LINKS] - b[:LINKS]).max() > 0.1


def test_a_reset_puts_coordinates_back_with_the_bodies() -> None:
    """Of the masked worlds; the run after it is the first one again, to the same bits."""
    sim = simulate(worlds())
    sim.step(20)
    first = arrays(sim)
    sim.solver.reset(sim.state, wp.array([False, True, False, False], dtype=wp.bool))
    size = sim.model.joint_coord_count // 3
    rest, found = sim.model.joint_q.numpy(), sim.state.joint_q.numpy()
    np.testing.assert_array_equal(found[size : 2 * size], rest[size : 2 * size])
    np.testing.assert_array_equal(found[:size], first["joint_q"][:size])
    sim.solver.reset(sim.state)
    sim.step(20)
    for name, values in arrays(sim).items():
        np.testing.assert_array_equal(values, first[name])


def test_a_reset_of_joints_alone_moves_the_bodies_in_the_next_step() -> None:
    """As SolverMuJoCo's reset, which leaves bodies to forward kinematics."""
    sim, other = simulate(chain()), simulate(chain())
    sim.step(50)
    flags = newton.StateFlags.JOINT_Q | newton.StateFlags.JOINT_QD
    sim.solver.reset(sim.state, flags=flags)
    sim.step()
    other.step()
    assert_same(sim, other)


def test_a_captured_step_sees_what_was_written() -> None:
    eager, replayed = simulate(chain()), simulate(chain())
    for sim in (eager, replayed):
        sim.step(2)
    with wp.ScopedCapture(device="cpu") as capture:
        replayed.step(2)
    for q in (0.5, -0.5):
        for sim in (eager, replayed):
            write(sim.state, (q, 0.0, 0.0), (0.0, 0.0, 0.0))
        eager.step(2)
        wp.capture_launch(capture.graph)
        assert_same(eager, replayed)
        assert eager.state.joint_q.numpy()[0] == pytest.approx(q, abs=0.01)


def test_a_restored_solver_knows_what_was_left() -> None:
    a, b = simulate(chain()), simulate(chain())
    a.step(10)
    b.solver.restore(a.solver.checkpoint())
    b.state.assign(a.state)
    for sim in (a, b):
        write(sim.state, (0.4,))
        sim.step(3)
    assert_same(a, b)


def test_without_the_setting_coordinates_are_not_read() -> None:
    """As by SolverVBD and SolverXPBD."""
    builders = chain(), chain()
    a, b = (Simulation(builder, collide=False, make_solver=SolverAVBD) for builder in builders)
    write(a.state, (0.4, 0.3, 0.2))
    for sim in (a, b):
        sim.step()
    np.testing.assert_array_equal(a.pose, b.pose)
