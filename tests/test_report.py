# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""``solver.report()``: what a step cost each world, and what a tolerance saves there."""

import re

import newton
import numpy as np
import pytest
from contract import pile, worlds
from helpers import G, Simulation, add_box, add_ground

from newton_avbd.report import missed
from newton_avbd.scenes.named import add_dominoes


def easy_and_hard(**settings: object) -> Simulation:
    """A box at rest in the first world, a row of dominoes that topples in the second."""
    builder, easy, hard = (newton.ModelBuilder() for _ in range(3))
    add_ground(easy)
    add_box(easy, (0.0, 0.0, 0.25))
    add_dominoes(hard)
    builder.add_world(easy)
    builder.add_world(hard)
    return Simulation(builder, **settings)


def test_worlds_that_are_done_sweep_no_more() -> None:
    """A box at rest ends after one sweep, dominoes take all; the table says so."""
    sim = easy_and_hard()
    sim.step(40)
    report = sim.solver.report()
    assert report.sweeps.tolist() == [1, 10]
    assert report.settled.tolist() == [True, False]
    assert list(report.order) == [1, 1]
    lines = str(report).splitlines()
    assert lines[0] == "2 worlds, 1 settled, 11 sweeps"
    assert lines[2].split()[:2] == ["1", "10"]
    assert re.search(r"not settled: '\w+' on 'shape_\d+' misses by \S+ m$", lines[2])
    assert report.worst.keys() == {1}
    assert lines[3].split()[:2] == ["0", "1"]


def test_how_far_contacts_miss() -> None:
    """Body 1 falls by 3 mm on body 0 and turns by 0.01 rad: at an arm of 0.1 m that is 1 mm more.

    From a gap of 1 mm it overlaps by 3 mm. Where it was in the ground already that is all new;
    where it is lifted out of it nothing is missed. One that pushes across a gap misses that.
    """
    kinds = [("normal", float, 3), ("arm", float, 3), ("force", float, 3), ("gap", float)]
    rows = np.zeros(4, dtype=[("a", int), ("b", int), *kinds])
    rows["b"], rows["normal"] = 1, (0.0, 0.0, 1.0)
    rows["arm"] = (0.1, 0.0, 0.0)
    rows["gap"] = [1.0e-3, -5.0e-3, -5.0e-3, 6.0e-3]
    rows["force"][2:, 2] = 1.0
    increment = np.array([[0.0] * 6, [0.0, 0.0, -3.0e-3, 0.0, 0.01, 0.0]])
    assert missed(rows, increment, np.zeros((2, 3))) == pytest.approx([3e-3, 4e-3, 4e-3, 2e-3])
    assert missed(rows, -increment, np.zeros((2, 3))) == pytest.approx([0.0, 0.0, 0.0, 1e-2])


def test_the_report_is_that_of_the_status() -> None:
    """The same sweeps and updates, as copies that later steps leave alone."""
    sim = easy_and_hard()
    sim.step(5)
    report, status = sim.solver.report(), sim.solver.status
    np.testing.assert_array_equal(report.sweeps, status.sweeps)
    np.testing.assert_array_equal(report.update, status.update)
    kept = report.update.copy()
    sim.step(5)
    np.testing.assert_array_equal(report.update, kept)


@pytest.mark.parametrize("tolerance", [0.0, 1.0e-6, 1.0e-4])
def test_a_world_ends_where_it_is_allowed_to(tolerance: float) -> None:
    """At the tolerance, or 5e-6 g h^2 without one; fewer than 40 sweeps are for settled worlds."""
    sim = easy_and_hard(tolerance=tolerance, iterations=40)
    for _ in range(30):
        sim.step()
        report = sim.solver.report()
        assert report.allowed == pytest.approx(max(tolerance, 5.0e-6 * G * sim.dt**2))
        assert np.all(report.settled[report.sweeps < 40])


def test_a_tolerance_saves_sweeps() -> None:
    """The looser it is, the fewer sweeps dominoes take until they lie."""
    total = []
    for tolerance in (0.0, 1.0e-7, 1.0e-6):
        sim = easy_and_hard(tolerance=tolerance, iterations=40)
        sweeps = 0
        for _ in range(60):
            sim.step()
            sweeps += int(sim.solver.report().sweeps.sum())
        total.append(sweeps)
    assert total[0] > 1.1 * total[1] > 1.1 * total[2]


def test_many_worlds_make_a_short_table() -> None:
    """The twenty that cost most, and how many there are besides."""
    sim = Simulation(worlds(pile(), 24))
    sim.step(2)
    lines = str(sim.solver.report()).splitlines()
    assert len(lines) == 23
    assert lines[-1].startswith("4 more")


def test_the_report_tells_the_order_of_the_step() -> None:
    """BDF2 from the second step on, where nothing jumps, until all is at rest."""
    sim = easy_and_hard(scheme="generalized_alpha")
    sim.set_velocity(0, (1.0, 0.0, 0.0))
    sim.step(1)
    assert list(sim.solver.report().order) == [1, 1]
    sim.step(9)
    assert sim.solver.report().order[0] == 2
    sim.step(120)
    assert sim.solver.report().order[0] == 1


def test_a_world_of_static_links_has_a_report() -> None:
    """A FIXED joint welds its only body to the world: nothing is left to sweep."""
    builder = newton.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=np.eye(3).tolist())
    builder.add_articulation([builder.add_joint_fixed(-1, link)])
    sim = Simulation(builder)
    sim.step()
    report = sim.solver.report()
    assert report.sweeps.tolist() == [0]
    assert report.settled.tolist() == [True]
    assert str(report).splitlines()[0] == "1 worlds, 1 settled, 0 sweeps"
