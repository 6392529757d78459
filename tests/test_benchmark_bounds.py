# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What the benchmark asks of the motion of its scenes holds: a benchmark is only run by people."""

import math
import subprocess
import sys

import pytest
from helpers import marked_long

from newton_avbd.study.bench import run as bench
from newton_avbd.study.bench.targets import TARGETS

USD = ("cartpole", "humanoid_usd", "ant_usd", "fourbar")
QUALITY = [
    target for target in TARGETS if target.against is None and not target.scene.endswith("worlds")
]
"""Bounds that are no times, of scenes of one world."""

LONG = ("chain", "rope", "stack", "pyramid", "free")
"""How names of scenes begin that take longer than to optimise their kernels."""


@pytest.mark.parametrize("name", marked_long(sorted({target.scene for target in QUALITY}), LONG))
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


ALONE = """
import dataclasses
import warp as wp

usual = wp.config.cpu_compiler_flags
wp.config.cpu_compiler_flags += " -ffp-contract=on"
import newton_avbd  # whose kernels take the flags of now

wp.config.cpu_compiler_flags = usual
from newton_avbd.scenes import robots
from newton_avbd.study.bench import run as bench

robots.WORLDS = 4
settings = dataclasses.replace(bench.QUICK, repeats=1, budget=60.0)
(result,) = bench.compete(bench.BENCHMARKS["ant_worlds"], ["avbd"], settings)
print(result.quality.seconds, result.quality.apart)
"""


def test_worlds_move_as_one_alone() -> None:
    """Four ants for 1 s, each as one by itself: the same bits.

    The step of one world and that of many are two kernels. Which products and sums the compiler
    fuses depends on the kernel by default; here it is told to fuse within expressions only.
    """
    done = subprocess.run([sys.executable, "-c", ALONE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    seconds, apart = map(float, done.stdout.splitlines()[-1].split())
    assert seconds == 1.0
    assert apart == 0.0
