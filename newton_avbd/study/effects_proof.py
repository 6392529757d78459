# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Whether absent effects cost anything: a scene with all effects, and what it is without each.

Run as ``python -m newton_avbd.study.effects_proof [EFFECT ...]``: for each (default: all that can
be left out) prints the size of the generated kernels, whether they are the same as those of a
package in which the effect's code never existed, and with ``--registers`` what the solve takes on a
GPU of compute capability 9.0, which needs ``ptxas`` and no GPU.
"""

import argparse
import re
import subprocess
import tempfile
from pathlib import Path

import newton
import warp as wp

from newton_avbd import Effects, SolverAVBD
from newton_avbd.commands.output import table
from newton_avbd.effects import CAUSES
from newton_avbd.execute.world import make_solve

from .effects_full import SETTINGS, add_everything
from .effects_stripped import real_and_stripped

HOPPER = 90
"""Compute capability that registers are counted for."""


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description="whether absent effects cost anything")
    parser.add_argument("effects", nargs="*", metavar="EFFECT")
    parser.add_argument("--registers", action="store_true")
    args = parser.parse_args()
    builder = newton.ModelBuilder()
    add_everything(builder)
    whole = SolverAVBD(builder.finalize(device="cpu"), **SETTINGS).effects.flags
    bare = Effects(contact=True, friction=False, gyroscopic=False, joint_force=False)
    names = args.effects or [name for name, cause in CAUSES.items() if not cause.remedy]
    variants = {"(all effects)": whole, "(bare contact)": bare}
    variants |= {name: whole.leaving_out(frozenset({name})) for name in names}
    rows = [("without", "code", "as if never written", *(["GPU"] if args.registers else []))]
    for name, effects in variants.items():
        real, stripped = real_and_stripped(effects)
        size = sum(len(function) for kernel in real.values() for function in kernel)
        same = "yes" if real == stripped else "NO"
        gpu = [registers(effects)] if args.registers else []
        rows.append((name, f"{size / 1000:.0f} kB", same, *gpu))
        print(*rows[-1], flush=True)
    print(f"\n{table(rows)}")


def registers(effects: Effects) -> str:
    """Registers, stack and spills of the solve kernel, as ``ptxas`` says."""
    with tempfile.TemporaryDirectory() as folder:
        module = make_solve(effects).module
        (file,) = wp.compile_aot_module(module, arch=HOPPER, module_dir=folder, use_ptx=True)
        # the assembler may be older than Warp's compiler, and want no terminator
        text = re.sub(r"\.version .*", ".version 8.4", Path(file).read_text()).rstrip("\0")
        Path(file).write_text(text)
        command = ["ptxas", "-v", f"-arch=sm_{HOPPER}", str(file), "-o", f"{folder}/solve.cubin"]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    used = re.search(r"Used (\d+) registers", said)
    spilled = re.search(r"(\d+) bytes stack frame, (\d+) bytes spill stores", said)
    assert used and spilled
    return f"{used[1]} registers, {spilled[1]} B stack, {spilled[2]} B spilled"


if __name__ == "__main__":
    main()
