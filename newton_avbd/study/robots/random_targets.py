# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Robots whose drives get random targets: ``python -m newton_avbd.study.robots.random_targets``.

Ten times a second each drive of an imported robot gets another target anywhere within its limits.
Most drives are at their effort limits or joints at their stops then, legs hit the ground and each
other. Joints must stay closed and limits must hold, at 240 and at 60 steps a second.
"""

import argparse
import itertools
import sys
import warnings

import newton
import numpy as np

from newton_avbd.io import solvers
from newton_avbd.io.names import SOLVERS
from newton_avbd.io.options import add_solvers
from newton_avbd.io.output import table
from newton_avbd.io.robots import find_robot, read_robot
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.measure.joints import Joints
from newton_avbd.scenes.finalize import finalized
from newton_avbd.scenes.pose import Pose, dofs_of, stand

ROBOTS = ("g1_29dof_rev_1_0", "go2", "icub", "panda", "anymal_c", "talos_full_v2", "laikago")
RATES = (240, 60)
"""Steps a second."""
CHANGES = 10
"""New targets a second."""
SECONDS = 2.0
HEAD = ("", "solver", "Hz", "joints open", "turned", "limit passed", "iterations", "bounded")


def run(name: str, pose: Pose, solver_name: str, rate: int, seed: int = 0) -> tuple[str, ...]:
    """Simulate a robot, and say how its joints held.

    Args:
        name: What to call it.
        pose: The robot.
        solver_name: One of :data:`newton_avbd.io.names.SOLVERS`.
        rate: Steps a second.
        seed: Of the targets.

    Returns:
        A row of the table below :data:`HEAD`.
    """
    model = finalized(pose.builder, device="cpu")
    solver = solvers.construct(solver_name, model)
    state, following, control = model.state(), model.state(), model.control()
    pipeline = None if solvers.detects_collisions(solver) else newton.CollisionPipeline(model)
    contacts = None if pipeline is None else pipeline.contacts()
    joints, rng = Joints.of(model), np.random.default_rng(seed)
    lower = np.maximum(model.joint_limit_lower.numpy(), -np.pi)
    upper = np.minimum(model.joint_limit_upper.numpy(), np.pi)
    at = _coordinates(pose.builder)
    targets = control.joint_target_q.numpy()
    worst, sweeps, is_finite = np.zeros(3), [], True
    for step in range(round(SECONDS * rate)):
        if step % (rate // CHANGES) == 0:
            for dof in pose.driven:
                if lower[dof] < upper[dof]:
                    targets[at[dof]] = rng.uniform(lower[dof], upper[dof])
            control.joint_target_q.assign(targets)
        if pipeline is not None:
            pipeline.collide(state, contacts)
        solver.step(state, following, control, contacts, 1.0 / rate)
        state, following = following, state
        poses = state.body_q.numpy().astype(float)
        is_finite = is_finite and bool(np.isfinite(poses).all())
        if not is_finite:
            break
        measures = (joints.separation, joints.misalignment, joints.limit_violation)
        worst = np.maximum(worst, [measure(poses).max() for measure in measures])
        if solver_name == "avbd":
            sweeps.append(solver.report().sweeps.max())
    if not is_finite:
        return (name, solver_name, str(rate), "not finite", *[""] * 4)
    status = getattr(solver, "status", None)
    return (
        *(name, solver_name, str(rate), f"{1e3 * worst[0]:.2g} mm"),
        *(f"{worst[1]:.2g} rad", f"{worst[2]:.2g}", f"{np.mean(sweeps):.1f}" if sweeps else ""),
        "" if status is None else str(int(np.sum(status.bounded_steps))),
    )


def _coordinates(builder: newton.ModelBuilder) -> dict[int, int]:
    """Joint coordinate of each degree of freedom with an axis."""
    return {
        dof: builder.joint_q_start[joint] + i
        for joint in range(builder.joint_count)
        for i, dof in enumerate(dofs_of(builder, joint))
    }


def main() -> int:
    """Run the robots and print a table; 0, or 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.prog = "python -m newton_avbd.study.robots.random_targets"
    parser.add_argument("robots", nargs="*", default=list(ROBOTS), metavar="ROBOT")
    add_solvers(parser, SOLVERS, ("avbd",))
    args = parser.parse_args()
    rows: list[tuple[str, ...]] = [HEAD]
    trials = list(itertools.product(args.robots, args.solvers, RATES))
    with interruptible() as interruption:
        for name, solver, rate in progress(trials, len(trials), "trials", lambda trial: trial[0]):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                pose = stand(read_robot(find_robot(name), solver)[0])
                rows.append(run(name, pose, solver, rate))
            say("  ".join(rows[-1]))
    print(table(rows))
    return interruption.status(0)


if __name__ == "__main__":
    sys.exit(main())
