# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd growth``: how time and memory grow with bodies, contacts, joints and worlds."""

import argparse
import json

from newton_avbd.io.errors import require
from newton_avbd.study.bench import growth
from newton_avbd.study.bench.run import chosen, describe_machine, pinned

from ..io.options import make_folder, use_device
from ..io.output import table, writing
from ..io.terminal import interruptible, progress


def catalog() -> dict[str, dict[str, str]]:
    """The scenes that grow, and what they are."""
    return {"scenes": {name: family.summary for name, family in growth.FAMILIES.items()}}


def main(args: argparse.Namespace) -> int:
    """Measure, print a table, write plots and numbers.

    Returns:
        Exit status: 0, or 130 after Ctrl-C.

    Raises:
        UserError: A scene does not exist, or the folder cannot be written.
    """
    if args.output:
        require("matplotlib")
    make_folder(args.output)
    names = chosen("scene that grows", args.scenes, tuple(growth.FAMILIES))
    use_device(args.device)
    with pinned() as core:
        machine = describe_machine(core)
        pairs = [(name, size) for name in names for size in growth.sizes(name, args.most)]
        points = []
        with interruptible() as interruption:
            for name, size in progress(pairs, len(pairs), "scenes", _named):
                points.append(growth.measure(name, size))
    print(table(growth.rows(points)))
    print(f"\nGrowth from {growth.LARGE:,} bodies on, as a power of the bodies:")
    print(table(growth.exponents(points)))
    if args.output:
        with writing(args.output):
            text = json.dumps(growth.as_json(machine, points), indent=1)
            (args.output / "growth.json").write_text(text + "\n")
            for quantity in growth.QUANTITIES:
                growth.write_plot(points, quantity, args.output / f"{quantity}.svg")
    return interruption.status(0)


def _named(scene: tuple[str, int]) -> str:
    return f"{scene[0]} of {scene[1]:,} bodies"
