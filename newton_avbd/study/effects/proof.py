# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Whether absent effects cost anything: a scene with all effects, and what it is without each.

Run as ``python -m newton_avbd.study.effects.proof [EFFECT ...]``: for each (default: all that can
be left out) prints the size of the generated kernels, whether they are the same as those of a
package in which the effect's code never existed, and with ``--registers`` what the solve takes on a
GPU, see :mod:`newton_avbd.study.effects.registers`.
"""

import argparse
import sys

import newton

from newton_avbd import Effects, SolverAVBD
from newton_avbd.drivers.world import make_solve
from newton_avbd.effects import CAUSES
from newton_avbd.io.output import table
from newton_avbd.io.terminal import interruptible, progress, say

from .full import SETTINGS, add_everything
from .registers import usage
from .stripped import real_and_stripped


def main() -> int:
    """Print a table; 0, or 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(description="whether absent effects cost anything")
    parser.prog = "python -m newton_avbd.study.effects.proof"
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
    with interruptible() as interruption:
        for name, effects in progress(variants.items(), len(variants), "effects", lambda v: v[0]):
            real, stripped = real_and_stripped(effects)
            size = sum(len(function) for kernel in real.values() for function in kernel)
            same = "yes" if real == stripped else "NO"
            gpu = [on_gpu(effects)] if args.registers else []
            rows.append((name, f"{size / 1000:.0f} kB", same, *gpu))
            say(" ".join(rows[-1]))
    print(f"\n{table(rows)}")
    return interruption.status(0)


def on_gpu(effects: Effects) -> str:
    """What the solve takes."""
    used = usage(make_solve(effects))
    return f"{used.registers} registers, {used.stack} B stack, {used.spilled} B spilled"


if __name__ == "__main__":
    sys.exit(main())
