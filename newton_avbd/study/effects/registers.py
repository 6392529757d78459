# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Registers, stack and spills of the kernels on a GPU, which need not be there.

Run as ``python -m newton_avbd.study.effects.registers [SCENE ...]``. Warp's compiler makes the
code, and ``ptxas`` of the CUDA toolkit (``pip install nvidia-cuda-nvcc``) says what it takes.
"""

import argparse
import dataclasses
import functools
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import newton
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.drivers.barrier import BLOCK
from newton_avbd.drivers.launch import Launcher
from newton_avbd.drivers.workers import Workers
from newton_avbd.io.output import table
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.scenes.robots import add_quadruped

from .full import SETTINGS, add_everything

HOPPER = 90
"""Compute capability of the GPU."""


@dataclass(frozen=True)
class Usage:
    """What a kernel takes on a GPU."""

    registers: int
    """Registers of a thread."""
    stack: int
    """Local memory of a thread [bytes]: arrays and structs that are no registers, and spills."""
    spilled: int
    """Stores of registers that did not suffice [bytes]."""
    seconds: float
    """CPU time to compile its module [s], which may hold others."""


def usage(kernel: wp.Kernel) -> Usage:
    """Compile a kernel for a GPU and look at what it takes."""
    said, seconds = _compiled(kernel.module)
    entries = set(re.findall(r"Compiling entry function '(\w+)'", said))
    (entry,) = (name for name in entries if name.startswith(f"{kernel.get_mangled_name()}_"))
    # of functions that are not inlined, too
    frames = re.findall(
        r"Function properties for '?(\w+)'?\s+(\d+) bytes stack frame, (\d+) bytes spill stores",
        said,
    )
    spilled = sum(int(stores) for name, _, stores in frames if name == entry or name not in entries)
    (stack,) = (int(size) for name, size, _ in frames if name == entry)
    own = said[said.index(f"Compiling entry function '{entry}'") :]
    used = re.search(r"Used (\d+) registers(?:.*?(\d+) bytes cumulative stack size)?", own)
    assert used
    return Usage(int(used[1]), int(used[2] or stack), spilled, seconds)


@functools.cache
def _compiled(module: wp.Module) -> tuple[str, float]:
    """What the assembler says of a module, and the processor time to compile it [s]."""
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        (file,) = wp.compile_aot_module(module, arch=HOPPER, module_dir=folder, use_ptx=True)
        seconds = time.process_time() - begin
        # the assembler may be older than Warp's compiler, and want no terminator
        text = re.sub(r"\.version .*", ".version 8.4", Path(file).read_text()).rstrip("\0")
        Path(file).write_text(text)
        command = [_assembler(), "-v", f"-arch=sm_{HOPPER}", file, "-o", f"{folder}/kernel.cubin"]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    return said, seconds


def launched(model: newton.Model, **settings: Any) -> dict[str, wp.Kernel]:
    """Kernels that a step launches on a GPU, by name; none is compiled."""
    solver = SolverAVBD(model, **settings)
    solver._flags = dataclasses.replace(solver._flags, on_gpu=True)
    solver._flags_apart = solver._flags.without_contact()
    solver._at_once = False
    recorder = _Recorder(solver.device)
    solver._launch = recorder
    contacts = newton.CollisionPipeline(model).contacts() if model.shape_count else None
    solver.step(model.state(), model.state(), None, contacts, 0.01)
    return {kernel.func.__name__: kernel for kernel in recorder.kernels}


class _Recorder(Launcher):
    """Notes which kernels it is to launch, and launches none."""

    def __init__(self, device: wp.Device) -> None:
        super().__init__(device)
        self.kernels: list[wp.Kernel] = []

    def __call__(
        self,
        kernel: wp.Kernel | None,
        dim: int,
        arguments: list,
        workers: Workers | None = None,
        block: int = BLOCK,
    ) -> None:
        if kernel is not None:
            self.kernels.append(kernel)


def _assembler() -> str:
    """Path of ``ptxas``."""
    places = [shutil.which("ptxas"), *Path(newton.__file__).parents[1].glob("nvidia/*/bin/ptxas")]
    for place in filter(None, places):
        return str(place)
    raise SystemExit("There is no ptxas here: pip install nvidia-cuda-nvcc.")


def add_falling(builder: newton.ModelBuilder) -> None:
    """Add a body that nothing can touch."""
    builder.add_body(mass=1.0, inertia=wp.mat33(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))


def add_boxes(builder: newton.ModelBuilder, count: int) -> None:
    """Add cubes on the ground."""
    builder.add_ground_plane()
    for i in range(count):
        body = builder.add_body(xform=wp.transform(wp.vec3(2.0 * i, 0.0, 0.5), wp.quat_identity()))
        builder.add_shape_box(body, hx=0.5, hy=0.5, hz=0.5)


LARGE = {"parallel": "bodies"}
"""Settings that make a world a large one."""

SCENES: dict[str, tuple[Callable[[newton.ModelBuilder], None], dict[str, Any]]] = {
    "a body that falls": (add_falling, {}),
    "a box on the ground": (lambda builder: add_boxes(builder, 1), {}),
    "two boxes": (lambda builder: add_boxes(builder, 2), {}),
    "a quadruped": (add_quadruped, {}),
    "all effects": (add_everything, SETTINGS),
    "two boxes, large": (lambda builder: add_boxes(builder, 2), LARGE),
    "a quadruped, large": (add_quadruped, LARGE),
}
"""From the least to the most that a scene can call for, with settings; and of large worlds."""


def main() -> int:
    """Print a table; 0, or 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(description="what the kernels take on a GPU")
    parser.prog = "python -m newton_avbd.study.effects.registers"
    parser.add_argument("scenes", nargs="*", choices=[[], *SCENES], metavar="SCENE")
    rows = [("scene", "kernel", "registers", "stack [B]", "spilled [B]", "compiled [s]")]
    names = parser.parse_args().scenes or list(SCENES)
    with interruptible() as interruption:
        for name in progress(names, len(names), "scenes", str):
            builder = newton.ModelBuilder()
            add, settings = SCENES[name]
            add(builder)
            for label, kernel in launched(builder.finalize(device="cpu"), **settings).items():
                used = usage(kernel)
                seconds = f"{used.seconds:.0f}"
                sizes = (str(used.registers), str(used.stack), str(used.spilled))
                rows.append((name, label, *sizes, seconds))
                say(" ".join(rows[-1]))
    print(f"\n{table(rows)}")
    return interruption.status(0)


if __name__ == "__main__":
    sys.exit(main())
