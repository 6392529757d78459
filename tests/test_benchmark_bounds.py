# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What the benchmark asks of the motion of its scenes holds: a benchmark is only run by people."""

import dataclasses
import math

import pytest

from newton_avbd.study import bench
from newton_avbd.study.targets import TARGETS

USD = ("cartpole", "humanoid_usd", "ant_usd", "fourbar")
QUALITY = [
    target for target in TARGETS if target.against is None and not target.scene.endswith("worlds")
]
"""Bounds that are no times, of scenes of one world."""


@pytest.mark.parametrize("name", sorted({target.scene for target in QUALITY}))
def test_a_scene_of_the_benchmark_moves_as_it_asks(name: str) -> None:
    """For the time of the benchmark, 2 to 10 s: chains stay closed, robots whole, piles at rest."""
    if name.startswith(USD):
        pytest.importorskip("pxr", reason="needs usd-core: pip install newton-avbd[scenes]")
    benchmark = bench.BENCHMARKS[name]
    quality = benchmark.contestant("avbd").run(benchmark.seconds, budget=math.inf)
    for target in QUALITY:
        if target.scene == name:
            value = quality.value(target.quantity)
            assert value is not None and value <= target.bound, target


def test_worlds_move_as_one_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four ants for 1 s, each as one by itself.

    The step of one world and that of many are two kernels, for which a compiler may fuse products
    and sums differently: after 14 steps velocities that should be zero differ by 1e-23 m/s, after
    240 places by 1.2e-16 m. A float32 of a meter rounds by 6e-8.
    """
    monkeypatch.setattr("newton_avbd.study.robots.WORLDS", 4)
    (result,) = bench.compete(
        bench.BENCHMARKS["ant_worlds"], ["avbd"], dataclasses.replace(bench.QUICK, repeats=1)
    )
    assert result.quality is not None and result.quality.seconds == 1.0
    assert result.quality.apart < 1.0e-12
