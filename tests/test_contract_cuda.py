# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Every kernel compiles for CUDA, on machines without a GPU too: Warp's compiler needs none."""

import dataclasses
import importlib
import os
import pkgutil
import typing
from pathlib import Path

import pytest
import warp as wp

import newton_avbd.drivers
import newton_avbd.step
from newton_avbd import Effects
from newton_avbd.drivers.colored import make_colored
from newton_avbd.rows.joint import JointKinds

HOPPER = 90
"""Compute capability that is compiled for: sm_90, a current data-center GPU."""

ALL_KINDS = JointKinds(
    linear=(0, 1, 2, 3),
    angular=(0, 1, 2, 3),
    euler=True,
    gimbals=True,
    skew=True,
    oblique=True,
    balls=True,
    rods=True,
)

BARE = Effects(contact=True, friction=False, gyroscopic=False, joint_force=False, on_gpu=True)

BODIES = dataclasses.replace(BARE, friction=True, gyroscopic=True, joint_force=True)

HINGED = Effects(
    contact=False,
    friction=False,
    gyroscopic=False,
    joint_force=False,
    kinds=JointKinds(linear=(0,), angular=(1,)),
    on_gpu=True,
)

JOINTED = dataclasses.replace(
    BODIES,
    kinds=ALL_KINDS,
    drives=True,
    limits=True,
    loops=True,
    closures=True,
)


def with_all(effects: Effects, names: str) -> Effects:
    """The effects and those named, too."""
    return dataclasses.replace(effects, **dict.fromkeys(names.split(), True))


VARIANTS = {
    "bare contact": BARE,
    "hinges": HINGED,
    "driven hinges": with_all(
        HINGED, "drives limits armature springs second_order fourth_order carried_rounding"
    ),
    "a robot": with_all(
        dataclasses.replace(BODIES, kinds=HINGED.kinds), "drives limits armature pairs welds mixing"
    ),
    "contacts": with_all(
        BODIES,
        "pairs piles restitution angular_friction matching moving_surfaces contact_materials "
        "put_bodies condim contact_pairs cylinders ellipsoids needles",
    ),
    "an accuracy": with_all(HINGED, "adaptive second_order fourth_order drives limits"),
    "compliance": with_all(BODIES, "compliance matching contact_materials"),
    "sleeping": with_all(BARE, "sleeping"),
    "ramp": with_all(BODIES, "ramp matching contact_materials"),
    "articulations": with_all(
        JOINTED,
        "floating flipped light_roots light_links reaction mimics springs armature joint_friction "
        "effort_limits velocity_limits breaking restitution actuators tendons dahl fluid "
        "gravity_compensation body_actuators servos adhesion spatial_tendons cables equalities "
        "yielding "
        "force_ranges mixing",
    ),
    "compliant articulations": with_all(JOINTED, "compliance limit_impedance"),
}
"""Effects that go together; all of them occur."""

LARGE_VARIANTS = {
    "bodies": BODIES,
    "hinges": dataclasses.replace(HINGED, contact=True, pairs=True),
    "all contacts": with_all(
        BODIES, "compliance angular_friction moving_surfaces contact_materials put_bodies"
    ),
    "bouncing": with_all(BODIES, "pairs restitution angular_friction"),
    "articulations": with_all(
        JOINTED,
        "pairs flipped light_roots light_links reaction mimics springs armature joint_friction "
        "effort_limits velocity_limits restitution breaking actuators tendons dahl fluid "
        "spatial_tendons cables",
    ),
}
"""Effects of one large world."""

MODULES = [
    importlib.import_module(f"{package.__name__}.{module.name}")
    for package in (newton_avbd.step, newton_avbd.drivers)
    for module in pkgutil.iter_modules(package.__path__)
]

KERNELS = {
    name: value
    for module in MODULES
    for name, value in vars(module).items()
    if isinstance(value, wp.Kernel)
}

SHARED = {kernel.module: kernel for kernel in KERNELS.values()}
"""One kernel of each module: they compile together."""

MAKERS = {
    name: value
    for module in MODULES
    for name, value in vars(module).items()
    if name.startswith("make_") and typing.get_type_hints(value).get("return") is wp.Kernel
}

pytestmark = pytest.mark.cuda_compile


EVERYTHING = "COMPILE_ALL" in os.environ


def compiles(
    kernel: wp.Kernel, folder: Path, arch: int = HOPPER, to_ptx: bool = not EVERYTHING
) -> None:
    """Compiles the module of a kernel for a GPU that need not be there.

    To PTX. The assembler, which gives registers to it, takes two thirds of the time: it is asked
    for a large world, and with COMPILE_ALL=1 for all, as once a week.
    """
    if wp.get_cuda_toolkit_version() is None:
        pytest.skip("this build of Warp has no CUDA compiler")
    (binary,) = wp.compile_aot_module(kernel.module, arch=arch, module_dir=folder, use_ptx=to_ptx)
    assert Path(binary).stat().st_size > 0


LONG = pytest.mark.skipif(
    not EVERYTHING,
    reason="takes long, or differs little from others; set COMPILE_ALL=1 to compile it",
)


OF_A_CPU = ("make_step", "make_step_links")
"""What is launched on a CPU only."""

ON_REQUEST = ("bare contact", "hinges", "compliance", "sleeping", "ramp")
"""What differs little from the others."""

ARCHITECTURES = [HOPPER, *(pytest.param(arch, marks=LONG) for arch in (80, 120))]
"""Those that are compiled for where many would take too long: Ampere and Blackwell, on request."""


@pytest.mark.parametrize(
    "variant",
    [
        pytest.param(name, marks=LONG if effects.loops or name in ON_REQUEST else ())
        for name, effects in VARIANTS.items()
    ],
)
def test_the_solve_compiles_for_a_gpu(variant: str, tmp_path: Path) -> None:
    compiles(MAKERS["make_solve"](VARIANTS[variant]), tmp_path)


@pytest.mark.parametrize("variant", ["contacts", "driven hinges"])
@pytest.mark.parametrize("make", sorted({*MAKERS} - {"make_solve", *OF_A_CPU}))
def test_a_kernel_with_chosen_effects_compiles_for_a_gpu(
    make: str, variant: str, tmp_path: Path
) -> None:
    """Prediction, free motion, observables."""
    maker = MAKERS[make]
    chosen = [VARIANTS[variant]] if "effects" in typing.get_type_hints(maker) else []
    compiles(maker(*chosen), tmp_path)


def test_the_variants_hold_all_effects() -> None:
    for field in dataclasses.fields(Effects):
        if field.name != "friction_mix":
            assert any(getattr(effects, field.name) for effects in VARIANTS.values()), field.name


@pytest.mark.parametrize("arch", ARCHITECTURES)
@pytest.mark.parametrize(
    "variant",
    [
        "bouncing",
        *(pytest.param(name, marks=LONG) for name in sorted({*LARGE_VARIANTS} - {"bouncing"})),
    ],
)
def test_a_large_world_compiles_for_gpus(variant: str, arch: int, tmp_path: Path) -> None:
    kernel = make_colored(LARGE_VARIANTS[variant]).sweep_color
    compiles(kernel, tmp_path, arch, to_ptx=False)


@pytest.mark.parametrize("kernel", SHARED.values(), ids=lambda kernel: kernel.key)
def test_a_kernel_without_choices_compiles_for_a_gpu(kernel: wp.Kernel, tmp_path: Path) -> None:
    """Sorting, observables and reset."""
    compiles(kernel, tmp_path)


def test_the_search_for_kernels_finds_them() -> None:
    """The lists above are made by looking; they must not be empty, and hold the solve."""
    assert "make_solve" in MAKERS
    assert len(MAKERS) >= 3 and len(KERNELS) >= 3
