# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What saves all tests time: kernels take longer to make than most scenes to run.

Kernels are compiled as ``processes/sitecustomize.py`` says, also in the processes that tests start.
Newton's collision kernels are made once: Newton makes them anew for each pipeline, which takes four
times as long as the rest of a small simulation, and longer the more there are.
"""

import dataclasses
import functools
import gc
import importlib
import os
import pkgutil
import runpy
import sys
from pathlib import Path

import pytest
import warp as wp

_PROCESSES = Path(__file__).parent / "processes"
_COMPILER = str(_PROCESSES / "sitecustomize.py")
if getattr(sys.modules.get("sitecustomize"), "__file__", None) == _COMPILER:  # as workers have
    _LEVEL = sys.modules["sitecustomize"].LEVEL
else:
    sys.path.append(str(_PROCESSES))
    _LEVEL = runpy.run_path(_COMPILER)["LEVEL"]  # before Newton is imported, which looks once

from newton._src.geometry import narrow_phase  # noqa: E402

from newton_avbd import drivers, step  # noqa: E402
from newton_avbd.effects import Effects  # noqa: E402
from newton_avbd.rows.joint import JointKinds  # noqa: E402
from newton_avbd.step.kernels import KERNEL  # noqa: E402

for _package in (drivers, step):  # kernels of modules are optimised, whoever imports them
    for _module in pkgutil.iter_modules(_package.__path__, f"{_package.__name__}."):
        importlib.import_module(_module.name)

_get_module = wp.get_module


def _module_of_level(name: str) -> wp.Module:
    """As Warp's function, with another module for kernels of large worlds of each level."""
    is_made = name.startswith(f"{drivers.__name__}.colored_")
    return _get_module(f"{name}_{_LEVEL['optimization_level']}" if is_made else name)


wp.get_module = _module_of_level


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Kernels that a test makes are optimised only if it is long."""
    _LEVEL["optimization_level"] = 2 if item.get_closest_marker("long") else 0
    KERNEL["module_options"] |= _LEVEL


_paths = [str(_PROCESSES), os.environ.get("PYTHONPATH")]
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, _paths))

# Compiling makes many objects that stay; looking through them took a twentieth of the time.
gc.set_threshold(50_000, 20, 20)

for _make in ("create_narrow_phase_kernel_gjk_mpr", "create_narrow_phase_primitive_kernel"):
    setattr(narrow_phase, _make, functools.cache(getattr(narrow_phase, _make)))

_ALL_KINDS = JointKinds(
    (0, 1, 2, 3),
    (0, 1, 2, 3),
    euler=True,
    gimbals=True,
    skew=True,
    oblique=True,
    balls=True,
    rods=True,
    distances=True,
)


@pytest.fixture
def shared_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels hold what other values and other types of joints would call for, too.

    So scenes that differ in these share them, as if beside one that has it all. For tests of what
    the numbers are; that kernels without the others give those as well is seen in
    ``test_properties``, each effect by itself, and where this is not used.
    """
    of_model = Effects.of_model

    def widened(*args, **settings):
        effects, callers = of_model(*args, **settings)
        if effects.joints:
            effects = dataclasses.replace(effects, kinds=_ALL_KINDS, joint_force=True)
        without = settings.get("without", frozenset())
        return effects.for_any_values().leaving_out(without), callers

    monkeypatch.setattr(Effects, "of_model", widened)
