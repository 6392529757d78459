# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Every kernel compiles for CUDA, on machines without a GPU too: Warp's compiler needs none."""

import dataclasses
import importlib
import pkgutil
import typing
from collections.abc import Callable
from pathlib import Path

import pytest
import warp as wp

import newton_avbd.execute
from newton_avbd import Effects
from newton_avbd.rows.joint import JointKinds

HOPPER = 90
"""Compute capability that is compiled for: sm_90, a current data-center GPU."""

CALLED_FOR = ("contact", "friction", "gyroscopic", "joint_force")
"""Effects that scenes call for; the others are chosen, and compiled one at a time here."""

EVERYTHING = Effects(**dict.fromkeys(CALLED_FOR, True))

ALL_KINDS = JointKinds(linear=(0, 1, 2, 3), angular=(0, 1, 2, 3), euler=True, balls=True, rods=True)

JOINTED = dataclasses.replace(EVERYTHING, kinds=ALL_KINDS)

VARIANTS = {
    "everything": EVERYTHING,
    "bare contact": Effects(contact=True, friction=False, gyroscopic=False, joint_force=False),
    "hinges": Effects(
        contact=False,
        friction=False,
        gyroscopic=False,
        joint_force=False,
        kinds=JointKinds(linear=(0,), angular=(1,)),
    ),
    "joints": JOINTED,
    "articulations": dataclasses.replace(JOINTED, drives=True, limits=True, loops=True),
    "compliant articulations": dataclasses.replace(
        JOINTED, drives=True, limits=True, loops=True, compliance=True
    ),
} | {
    name: dataclasses.replace(EVERYTHING, **{name: True})
    for name in (
        "compliance",
        "ramp",
        "restitution",
        "angular_friction",
        "matching",
        "moving_surfaces",
        "contact_materials",
    )
}

MODULES = [
    importlib.import_module(f"newton_avbd.execute.{module.name}")
    for module in pkgutil.iter_modules(newton_avbd.execute.__path__)
]

KERNELS = {
    name: value
    for module in MODULES
    for name, value in vars(module).items()
    if isinstance(value, wp.Kernel)
}

MAKERS = {
    name: value
    for module in MODULES
    for name, value in vars(module).items()
    if name.startswith("make_") and typing.get_type_hints(value).get("return") is wp.Kernel
}

pytestmark = pytest.mark.cuda_compile


def compiles(kernel: wp.Kernel, folder: Path) -> None:
    """Compiles the module of a kernel to a binary for a GPU that need not be there."""
    if wp.get_cuda_toolkit_version() is None:
        pytest.skip("this build of Warp has no CUDA compiler")
    (binary,) = wp.compile_aot_module(kernel.module, arch=HOPPER, module_dir=folder)
    assert Path(binary).stat().st_size > 0


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_a_kernel_with_chosen_effects_compiles_for_a_gpu(
    make: Callable[[Effects], wp.Kernel], variant: str, tmp_path: Path
) -> None:
    """Prediction, free motion and the solve, in each way that effects can be compiled in."""
    compiles(make(VARIANTS[variant]), tmp_path)


@pytest.mark.parametrize("kernel", KERNELS.values(), ids=KERNELS)
def test_a_kernel_without_choices_compiles_for_a_gpu(kernel: wp.Kernel, tmp_path: Path) -> None:
    """Sorting, observables and reset."""
    compiles(kernel, tmp_path)


def test_the_search_for_kernels_finds_them() -> None:
    """The lists above are made by looking; they must not be empty, and hold the solve."""
    assert "make_solve" in MAKERS
    assert len(MAKERS) >= 3 and len(KERNELS) >= 3
