# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``python -m newton_avbd.study.accuracy.swing [NAME ...]``: robots that swing, beside MuJoCo.

A NAME is part of the name of a file of dm_control's suite or of gymnasium, or the path of an MJCF
file. Robots swing for 0.4 s from their pose, with random rates of their joints, without contacts,
joint limits and controls. SolverAVBD's steps are replayed from a graph, ``mj_step`` runs on what
SolverMuJoCo makes of the model; all on one core. Errors are the largest of a body's position at the
end, beside ``mj_step`` with RK4 at 20,000 steps a second.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverMuJoCo

from newton_avbd import SolverAVBD
from newton_avbd.io.mjcf import add_mjcf
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.measure.state import Array
from newton_avbd.study.bench.run import pinned
from newton_avbd.study.mujoco.files import files
from newton_avbd.study.mujoco.native import silence

SECONDS = 0.4
"""Simulated time [s]."""
RATES = (60, 120, 240, 480)
"""Steps a second."""
FINE = 20_000
"""Those of the reference."""
SCHEMES = ("runge_kutta", "generalized_alpha")
SPEED = 1.0
"""Largest rate of a joint at the start [rad/s or m/s]."""
FREE = 1.0e10
"""A limit that nothing meets."""
REPEATS = 7
REPLAYED = 32
"""Steps of a graph."""
NAMES = ("walker", "half_cheetah", "humanoid", "ant", "hopper", "acrobot")


def read(path: Path) -> newton.Model:
    """The model of a file, without limits and contacts, in motion."""
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    add_mjcf(builder, path)
    builder.shape_flags[:] = [
        int(flags) & ~int(newton.ShapeFlags.COLLIDE_SHAPES) for flags in builder.shape_flags
    ]
    dofs = len(builder.joint_qd)
    builder.joint_limit_lower[:] = [-FREE] * dofs
    builder.joint_limit_upper[:] = [FREE] * dofs
    speed = np.random.default_rng(0).uniform(-SPEED, SPEED, dofs)
    if builder.joint_type[0] == newton.JointType.FREE:
        speed[:6] = 0.0
    builder.joint_qd[:] = speed.tolist()
    model = builder.finalize(device="cpu")
    newton.eval_fk(model, model.joint_q, model.joint_qd, model)
    return model


def swung_by_mujoco(model: newton.Model, rate: int) -> tuple[Array, float]:
    """Where bodies are at the end [m], and the time of a step [s]; by ``mj_step`` with RK4."""
    import mujoco

    state, after = model.state(), model.state()
    solver = SolverMuJoCo(model, use_mujoco_cpu=True, integrator="rk4", disable_contacts=True)
    # a step of next to no time writes the start state down
    solver.step(state, after, model.control(), None, 1.0e-12)
    native, now = solver.mj_model, solver.mj_data
    native.opt.timestep = 1.0 / rate
    steps = round(SECONDS * rate)
    mujoco.mj_step(native, now, steps)
    mujoco.mj_kinematics(native, now)
    owners = solver.mjc_body_to_newton.numpy()[0]
    known = np.flatnonzero(owners >= 0)
    places = np.zeros((model.body_count, 3))
    places[owners[known]] = now.xpos[known]
    if rate == FINE:
        return places, 0.0

    def restart() -> None:
        mujoco.mj_resetData(native, now)

    return places, _time(restart, lambda: mujoco.mj_step(native, now, REPLAYED))


def swung(model: newton.Model, scheme: str, rate: int) -> tuple[Array, float, int]:
    """The same by SolverAVBD, and the order of its last step."""
    settings: dict[str, Any] = {"scheme": scheme}
    solver = SolverAVBD(model, **settings)
    state, after, control = model.state(), model.state(), model.control()
    for _ in range(round(SECONDS * rate)):
        solver.step(state, after, control, None, 1.0 / rate)
        state, after = after, state
    places, order = state.body_q.numpy()[:, :3].astype(float), int(solver.report().order[0])
    with wp.ScopedCapture(device="cpu") as capture:
        for _ in range(REPLAYED // 2):
            solver.step(state, after, control, None, 1.0 / rate)
            solver.step(after, state, control, None, 1.0 / rate)

    start = model.state()

    def restart() -> None:
        state.assign(start)

    return places, _time(restart, lambda: wp.capture_launch(capture.graph)), order


def _time(restart: Callable[[], None], run: Callable[[], None]) -> float:
    """Least processor time of a step [s]; the ``restart`` is not timed."""
    times = []
    for _ in range(REPEATS):
        restart()
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return min(times) / REPLAYED


def main(names: list[str]) -> int:
    """Print a table of errors and costs for each robot; 0, or 130 after Ctrl-C."""
    warnings.simplefilter("ignore")
    silence()
    rates = " | ".join(f"{rate} Hz" for rate in RATES)
    print(f"| error [m], ms a simulated second | {rates} |")
    print("| --- " * (1 + len(RATES)) + "|")
    robots = list(files(names or list(NAMES)))
    with pinned(), interruptible() as interruption:
        for name, path in progress(robots, len(robots), "robots", lambda robot: robot[0]):
            model = read(path)
            belongs = swung_by_mujoco(model, FINE)[0]
            for solver in ("mj_step RK4", *SCHEMES):
                cells = []
                for rate in RATES:
                    order = 4
                    if solver in SCHEMES:
                        places, cost, order = swung(model, solver, rate)
                    else:
                        places, cost = swung_by_mujoco(model, rate)
                    off = float(np.abs(places - belongs).max())
                    mark = "" if order == 4 or solver == SCHEMES[1] else f" (order {order})"
                    error = f"{off:.0e}" if off < 1.0 else "unstable"
                    cells.append(f"{error}, {1e3 * rate * cost:.2f}{mark}")
                say(f"| {name}, {solver} | {' | '.join(cells)} |")
    return interruption.status(0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m newton_avbd.study.accuracy.swing")
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of a file's name, or a path")
    sys.exit(main(parser.parse_args().names))
