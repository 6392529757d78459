# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The MJCF files of dm_control and gymnasium in SolverAVBD and in MuJoCo C, passive and driven.

Run as ``python -m newton_avbd.study.mujoco_files [NAME ...]``: the same Newton model without
contacts for 0.4 s, both at 1/2000 s. A case holds if no body is off by more than 2 % of how far it
moved, or 1 mm.
"""

import argparse
import warnings
from typing import Any

import newton
import numpy as np
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD
from newton_avbd.io.controls import Controls
from newton_avbd.io.robots import Robot, robots

from .measure import Array

DT = 1.0 / 2000.0
STEPS = 800
SHARE = 0.02
"""Of how far a body moves, by which it may be off."""
LEAST = 1.0e-3
"""How far any body may be off [m]."""


def main() -> None:
    """Print a line for each file and way of driving it."""
    parser = argparse.ArgumentParser(description="MJCF files beside MuJoCo")
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of a file's name")
    parser.add_argument("--scheme", default="euler", help="of SolverAVBD (default: %(default)s)")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    held = {False: 0, True: 0}
    count = 0
    for robot in robots():
        is_wanted = not args.names or any(name in robot.name for name in args.names)
        if robot.package not in ("dm_control", "gymnasium") or not is_wanted:
            continue
        try:
            model = _read(robot)
        except Exception as error:  # the importer fails in as many ways as files can be wrong
            print(f"{robot.name:<36} cannot be read: {type(error).__name__}")
            continue
        count += 1
        for is_driven in (False, True):
            off, holds = compare(model, robot, is_driven, scheme=args.scheme)
            held[is_driven] += holds
            way = "driven" if is_driven else "passive"
            says = "holds" if holds else "FAILS"
            print(f"{robot.name:<36} {way:<8} {says} {1e3 * off:9.4f} mm", flush=True)
    print(f"of {count} files hold {held[False]} passive, {held[True]} driven")


def compare(
    model: newton.Model, robot: Robot, is_driven: bool, **settings: Any
) -> tuple[float, bool]:
    """How far the body that misses its bound by most, or comes next to it, is off [m], and whether
    all are within."""
    paths = [
        _path(model, solver, robot if is_driven else None)
        for solver in (
            SolverAVBD(model, **settings),
            SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True),
        )
    ]
    off = np.linalg.norm(paths[0][-1] - paths[1][-1], axis=1)
    motion = np.linalg.norm(paths[1] - paths[1][:1], axis=2).max(axis=0)
    worst = int(np.argmax(off / np.maximum(LEAST, SHARE * motion)))
    return float(off[worst]), bool(np.all(off <= np.maximum(LEAST, SHARE * motion)))


def _read(robot: Robot) -> newton.Model:
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(str(robot.path), ctrl_direct=True)
    return builder.finalize(device="cpu")


def _path(model: newton.Model, solver: newton.solvers.SolverBase, driven: Robot | None) -> Array:
    """Places of the bodies at the start and after each 40 steps, shape (times, bodies, 3)."""
    state, after, control = model.state(), model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    has_actuators = model.custom_frequency_counts.get("mujoco:actuator", 0) > 0
    controls = None
    if driven is not None and has_actuators:
        controls = Controls("sine", model, driven.path)
    path = [state.body_q.numpy()[:, :3].astype(float)]
    for step in range(STEPS):
        if controls is not None:
            control.mujoco.ctrl.assign(controls.at(step * DT))
        state.clear_forces()
        solver.step(state, after, control, None, DT)
        state, after = after, state
        if step % 40 == 39:
            path.append(state.body_q.numpy()[:, :3].astype(float))
    return np.array(path)


if __name__ == "__main__":
    main()
