# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What absent effects cost a step: instructions and time, against a solver without their code.

Run as ``python -m newton_avbd.study.effects_cost [EFFECT ...]``: the scene with all effects, and
without each of those, steps by this package and by a copy of it in which the code of absent effects
never existed (:mod:`newton_avbd.study.effects_stripped`). Instructions are counted by ``valgrind``,
of replayed steps alone; times are medians of replays in turn, in one process. The first run
compiles for minutes.
"""

import argparse
import ctypes
import importlib
import mmap
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from types import ModuleType

import newton
import warp as wp

import newton_avbd
from newton_avbd.commands.output import table

from .effects_full import SETTINGS, add_everything
from .effects_stripped import strip

FLAGS = (
    "-target-cpu x86-64-v3 -mllvm=-inline-threshold=9000"
    " -mllvm=-inline-cold-callsite-threshold=3000 -mllvm=-slp-recursion-max-depth=4"
)
"""Warp's CPU compiler flags, for a processor that ``valgrind`` knows."""
STEPS = 8
"""Steps in a captured graph."""
ROUNDS = 200
"""Replays that are timed of each of two solvers."""
DUMP, ZERO, START, STOP = 0x43540000, 0x43540001, 0x43540004, 0x43540005
"""What ``valgrind/callgrind.h`` calls its requests."""


MAGIC = bytes.fromhex("4889f831d2 48c1c703 48c1c70d 48c1c73d 48c1c733 4887db 4889d0 c3")
"""Machine code of a request, which is none but where valgrind runs the program: mov rax, rdi; xor
edx, edx; rol rdi by 3, 13, 61, 51; xchg rbx, rbx; mov rax, rdx; ret."""


def ask_valgrind(code: int) -> None:
    """Ask valgrind for something; nothing happens without it."""
    with mmap.mmap(-1, len(MAGIC), prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC) as page:
        page.write(MAGIC)
        start = ctypes.c_char.from_buffer(page)
        function = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p)(ctypes.addressof(start))
        request = (ctypes.c_uint64 * 6)(code)
        function(ctypes.addressof(request))
        del start


class Replay:
    """Steps of the scene without an effect, captured in a graph."""

    def __init__(self, package: ModuleType, without: str) -> None:
        """Capture steps by the solver of a package; ``without`` is empty for all effects."""
        builder = newton.ModelBuilder()
        add_everything(builder)
        model = builder.finalize(device="cpu")
        effects = {without: False} if without else {}
        self.solver = package.SolverAVBD(model, effects=effects, **SETTINGS)
        state, after = model.state(), model.state()
        pipeline = newton.CollisionPipeline(model)
        contacts = pipeline.contacts()
        pipeline.collide(state, contacts)
        for _ in range(STEPS):  # the first after a reset sweep more
            self.solver.step(state, after, None, contacts, 1.0 / 240.0)
        self._graphs = []
        for steps in (STEPS, 2 * STEPS):
            with wp.ScopedCapture("cpu") as capture:
                for _ in range(steps):
                    self.solver.step(state, after, None, contacts, 1.0 / 240.0)
            self._graphs.append(capture.graph)
            wp.capture_launch(capture.graph)

    def seconds(self) -> float:
        """Processor time of a step [s]."""
        begin = time.process_time()
        wp.capture_launch(self._graphs[0])
        return (time.process_time() - begin) / STEPS

    def count(self) -> None:
        """Have valgrind write down the instructions of two replays, the second twice as long."""
        for graph in self._graphs:
            for code in (START, ZERO):
                ask_valgrind(code)
            wp.capture_launch(graph)
            for code in (DUMP, STOP):
                ask_valgrind(code)


def stripped(folder: Path, without: str) -> ModuleType:
    """The package without the code of effects that the scene without ``without`` does not have."""
    name = f"stripped_{without}"
    if not (folder / name).is_dir():
        builder = newton.ModelBuilder()
        add_everything(builder)
        effects = {without: False} if without else {}
        model = builder.finalize(device="cpu")
        flags = newton_avbd.SolverAVBD(model, effects=effects, **SETTINGS).effects.flags
        strip(flags, folder)
        (folder / "newton_avbd").rename(folder / name)
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    return importlib.import_module(name)


def measure(folder: str, names: list[str], *, count: bool) -> None:
    """Print times of both packages' steps [us] by effect, or count their instructions."""
    wp.config.log_level = wp.LOG_WARNING
    for name in names:
        real, other = (
            Replay(package, name) for package in (newton_avbd, stripped(Path(folder), name))
        )
        if count:
            real.count()
            other.count()
        else:
            pairs = [(real.seconds(), other.seconds()) for _ in range(ROUNDS)]
            print("times", *(1e6 * median(column) for column in zip(*pairs, strict=True)))


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description="what absent effects cost a step")
    parser.add_argument("effects", nargs="*", metavar="EFFECT", help="default: friction, limits")
    names = ["", *(parser.parse_args().effects or ("friction", "limits"))]
    with tempfile.TemporaryDirectory() as folder:
        said = _run([], folder, names, count=False)
        times = [line.split()[1:] for line in said.splitlines() if line.startswith("times")]
        tool = ("--tool=callgrind", "--instr-atstart=no")
        _run(["valgrind", *tool, f"--callgrind-out-file={folder}/out"], folder, names, count=True)
        counts = [
            int(re.findall(r"^totals: (\d+)", file.read_text(), re.M)[-1])
            for file in sorted(Path(folder).glob("out.*"), key=lambda file: int(file.suffix[1:]))
        ]
    rows = [("without", "instructions", "never written", "", "time [us]", "never written", "")]
    for i, name in enumerate(names):
        once, twice, other_once, other_twice = counts[4 * i : 4 * i + 4]
        instructions = _compared((twice - once) / STEPS, (other_twice - other_once) / STEPS)
        rows.append((name or "(nothing)", *instructions, *_compared(*map(float, times[i]))))
    print(table(rows))


def _compared(a: float, b: float) -> tuple[str, str, str]:
    """Two numbers, and by how much the first is larger."""
    return f"{a:,.1f}", f"{b:,.1f}", f"{100.0 * (a / b - 1.0):+.2f} %"


def _run(prefix: list[str], folder: str, names: list[str], *, count: bool) -> str:
    """Run :func:`measure` in a new process, where all is compiled with :data:`FLAGS`."""
    program = (
        f"import warp; warp.config.cpu_compiler_flags = {FLAGS!r}\n"
        f"from newton_avbd.study.effects_cost import measure\n"
        f"measure({folder!r}, {names!r}, count={count})"
    )
    command = [*prefix, sys.executable, "-c", program]
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout


if __name__ == "__main__":
    main()
