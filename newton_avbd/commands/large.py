# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd large``: time of one large world, color by color, against its size."""

import argparse
from dataclasses import asdict

import warp as wp

from newton_avbd.study.bench.large import LARGE_SCENES, measure
from newton_avbd.study.bench.run import chosen, describe_machine

from ..io.options import check_writable, use_device
from ..io.output import length, table, tables_beside, write_json
from ..io.terminal import interruptible, progress


def catalog() -> dict[str, dict[str, str]]:
    """The scenes of any size, and what they are."""
    return {"scenes": {name: summary for name, (summary, _) in LARGE_SCENES.items()}}


def main(args: argparse.Namespace) -> int:
    """Measure, print a line for each world.

    Returns:
        Exit status: 0, or 130 after Ctrl-C.

    Raises:
        UserError: A scene or the device does not exist, or the file cannot be written.
    """
    names = chosen("scene of a large world", args.scenes, tuple(LARGE_SCENES))
    check_writable(args.json)
    use_device(args.device)
    with tables_beside(args.json):
        machine = describe_machine(None) | {"device": wp.get_device().name}
        print(
            "\n".join(f"{name}: {value}" for name, value in machine.items()), end="\n\n", flush=True
        )
        pairs = [(name, bodies) for name in names for bodies in args.bodies]
        results = []
        with interruptible() as interruption:
            for name, bodies in progress(pairs, len(pairs), "scenes", lambda pair: pair[0]):
                results.append(
                    measure(
                        name,
                        bodies,
                        iterations=args.iterations,
                        steps=args.steps,
                        parallel=args.parallel,
                    )
                )
        heads = ["", "bodies", "contacts", "colors", "clashes", "step", "detection", "memory"]
        rows = [[*heads, "sunk", "fastest"]]
        for result in results:
            rows.append(
                [
                    result.scene,
                    f"{result.bodies:,}",
                    f"{result.contacts:,}",
                    str(result.colors),
                    str(result.clashes),
                    f"{result.step:.3g} ms",
                    f"{result.detection:.3g} ms",
                    f"{result.memory:.3g} MB",
                    length(result.sunk),
                    f"{result.speed:.2g} m/s",
                ]
            )
        print(table(rows))
    if args.json is not None:
        record = {
            "machine": machine,
            "iterations": args.iterations,
            "results": [asdict(result) for result in results],
        }
        write_json(args.json, record)
    return interruption.status(0)
