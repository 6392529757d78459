# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd effects``: which effects a scene calls for, why, and what they cost."""

import argparse

from newton_avbd import SolverAVBD
from newton_avbd.io.errors import UserError
from newton_avbd.io.opening import open_scene
from newton_avbd.io.simulation import Request
from newton_avbd.study.bench.run import pinned
from newton_avbd.study.effects.cost import Stepper, difference

from ..io.options import use_device
from ..io.output import table
from ..io.terminal import gathered_warnings, interruptible, progress


def main(args: argparse.Namespace) -> int:
    """Print the table of effects, and what each costs in time; returns the exit status."""
    use_device(args.device)
    request = Request(
        iterations=args.iterations, dt=args.dt, arguments=args.arguments, accuracy=args.accuracy
    )
    with gathered_warnings():
        simulation = open_scene(args.scene, request)
    solver = simulation.solver
    if not isinstance(solver, SolverAVBD):
        raise UserError(f"{args.scene} has no SolverAVBD in it, but a {type(solver).__name__}")
    simulation.advance()  # with the first contacts come their buffers
    print(solver.effects)
    if not args.measure:
        return 0
    frames = args.frames or simulation.frames
    with interruptible() as interruption:
        for _ in progress(range(1, frames), frames, simulation.name):
            simulation.advance()
    if interruption.happened:
        return interruption.status(0)
    with pinned():
        whole = Stepper(simulation, {})
        rows = [("without", "a step saves", "of it", "sweeps")]
        with interruptible() as interruption:
            for name in progress(whole.removable, len(whole.removable), "without", str):
                stripped = Stepper(simulation, {name: False})
                saved, share = difference(whole, stripped)
                cells = f"{1e6 * saved:.1f} us", f"{100 * share:.0f} %", f"{stripped.sweeps:.3g}"
                rows.append((name, *cells))
    print(
        f"\nA step after {frames} frames, replayed from a graph: {1e6 * whole.seconds():.1f} us, "
        f"{whole.sweeps:.3g} sweeps in the mean world. Without an effect it may sweep more or less."
    )
    print(table(rows))
    return interruption.status(0)
