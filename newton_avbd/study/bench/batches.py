# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Steps a second of batches of worlds, on a CPU or a GPU, and how well they were simulated.

Run as ``python -m newton_avbd.study.bench.batches [SCENE ...]``. Each frame of four steps of
1/240 s, its collision detections included, is one graph. The time is that of the whole run, in
which robots fall and land, so that no solver is timed in a state that suits it. *Solver alone* is
the time of a step without collision detection, from the state at the end.
"""

import argparse
import itertools
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import newton
import numpy as np
import warp as wp

from newton_avbd.io.options import add_json, add_solvers, check_writable, positive, use_device
from newton_avbd.io.output import table, tables_beside, write_json
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.measure.joints import Joints
from newton_avbd.measure.state import Bodies, largest_speed
from newton_avbd.scenes.named import add_pyramid_worlds
from newton_avbd.scenes.robots import add_ant_worlds, add_humanoid_worlds, add_quadruped_worlds
from newton_avbd.study.bench.run import chosen, describe_machine
from newton_avbd.study.peers import PEERS

DT = 1.0 / 240.0
"""Step [s]."""
STEPS = 4
"""Steps of a frame, which is a graph; even, so that a replay ends in the state it began with."""

SOLVERS = ("avbd", "vbd", "xpbd", "mujoco_warp")
"""Those that step many worlds at once."""

CONTACTS = {"ants": 64, "humanoids": 96, "quadrupeds": 64, "pyramids": 160}
"""Room for contacts in each world."""

BATCHES: dict[str, tuple[Callable[[newton.ModelBuilder, int], None], float]] = {
    "ants": (add_ant_worlds, 1e4),
    "humanoids": (add_humanoid_worlds, 1e5),
    "quadrupeds": (add_quadruped_worlds, 1e5),
    "pyramids": (add_pyramid_worlds, 4e6),
}
"""How the worlds are built, and SolverVBD's contact stiffness [N/m]."""


@dataclass(frozen=True)
class BatchResult:
    """What was measured of a solver on a batch.

    Attributes:
        scene: Name in :data:`BATCHES`.
        worlds: Worlds.
        solver: Name in :data:`~newton_avbd.study.peers.PEERS`.
        first: Time until the first frame was done, compilation included [s].
        step: Mean time of a step of all worlds with its collision detection [ms].
        alone: Time of a step of all worlds without collision detection, after the end [ms].
        joints: Largest distance between the anchors of a joint at the end [m].
        penetration: Deepest penetration at the end, by Newton's collision detection [m].
        speed: Speed of the fastest body at the end [m/s].
        finite: Whether all poses and velocities are finite at the end.
    """

    scene: str
    worlds: int
    solver: str
    first: float
    step: float
    alone: float
    joints: float
    penetration: float
    speed: float
    finite: bool

    @property
    def rate(self) -> float:
        """Steps a second of all worlds together, collision detection included."""
        return 1e3 * self.worlds / self.step


def build(scene: str, worlds: int, *, ke: float | None = None) -> newton.Model:
    """Build a batch on the current device.

    Args:
        scene: Name in :data:`BATCHES`.
        worlds: How many worlds.
        ke: Contact stiffness [N/m]; None for Newton's default.
    """
    builder = newton.ModelBuilder()
    if ke is not None:
        builder.default_shape_cfg.ke = ke
    BATCHES[scene][0](builder, worlds)
    builder.color()
    return builder.finalize()


def measure(scene: str, worlds: int, solver: str, *, seconds: float = 1.0) -> BatchResult:
    """Simulate a batch and time it, on the current device.

    Args:
        scene: Name in :data:`BATCHES`.
        worlds: How many worlds.
        solver: Name in :data:`~newton_avbd.study.peers.PEERS`.
        seconds: Time to simulate [s].
    """
    peer = PEERS[solver]
    model = build(scene, worlds, ke=BATCHES[scene][1] if peer.stiff else None)
    begin = time.perf_counter()
    pipeline = newton.CollisionPipeline(model, rigid_contact_max=CONTACTS[scene] * worlds)
    contacts, control = pipeline.contacts(), model.control()
    states = [model.state(), model.state()]
    engine = peer.make(model)

    def detect() -> None:
        pipeline.collide(states[0], contacts)

    def step() -> None:
        engine.step(states[0], states[1], control, contacts, DT)
        states.reverse()

    def frame() -> None:
        for _ in range(STEPS):
            detect()
            step()

    def steps() -> None:
        for _ in range(STEPS):
            step()

    frame()
    wp.synchronize()
    first = time.perf_counter() - begin
    whole = _replayed(frame, max(1, round(seconds / (STEPS * DT))))
    detect()
    body_q, body_qd = states[0].body_q.numpy(), states[0].body_qd.numpy()
    penetration = _deepest(model, states[0], contacts)
    open_by = Joints.of(model).separation(body_q.astype(float))
    speed = largest_speed(Bodies.of(model), states[0])
    alone = _replayed(steps, 5, detect)
    return BatchResult(
        scene=scene,
        worlds=worlds,
        solver=solver,
        first=first,
        step=1e3 * whole / STEPS,
        alone=1e3 * alone / STEPS,
        joints=float(open_by.max(initial=0.0)),
        penetration=penetration,
        speed=speed,
        finite=bool(np.isfinite(body_q).all() and np.isfinite(body_qd).all()),
    )


def _replayed(
    call: Callable[[], None], repeats: int, before: Callable[[], None] | None = None
) -> float:
    """Mean time of what a graph replays [s], without what goes before each replay."""
    with wp.ScopedCapture() as capture:
        call()
    passed, begin = 0.0, 0.0
    for i in range(repeats):
        if i == 0 or before is not None:
            if before is not None:
                before()
            wp.synchronize()
            begin = time.perf_counter()
        wp.capture_launch(capture.graph)
        if i == repeats - 1 or before is not None:
            wp.synchronize()
            passed += time.perf_counter() - begin
    return passed / repeats


@wp.kernel(enable_backward=False)
def _separations(
    count: wp.array[wp.int32],
    body_q: wp.array[wp.transform],
    shape_body: wp.array[wp.int32],
    shape0: wp.array[wp.int32],
    shape1: wp.array[wp.int32],
    point0: wp.array[wp.vec3],
    point1: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    margin0: wp.array[float],
    margin1: wp.array[float],
    deepest: wp.array[float],
) -> None:
    """How deep contacts are [m]."""
    i = wp.tid()
    if i >= count[0]:
        return
    a, b = shape_body[shape0[i]], shape_body[shape1[i]]
    p, q = wp.vec3(point0[i]), wp.vec3(point1[i])
    if a >= 0:
        p = wp.transform_point(body_q[a], p)
    if b >= 0:
        q = wp.transform_point(body_q[b], q)
    wp.atomic_max(deepest, 0, margin0[i] + margin1[i] - wp.dot(normal[i], q - p))


def _deepest(model: newton.Model, state: newton.State, contacts: newton.Contacts) -> float:
    """Deepest penetration of contacts [m]."""
    deepest = wp.zeros(1, dtype=float)
    wp.launch(
        _separations,
        contacts.rigid_contact_max,
        [
            contacts.rigid_contact_count,
            state.body_q,
            model.shape_body,
            contacts.rigid_contact_shape0,
            contacts.rigid_contact_shape1,
            contacts.rigid_contact_point0,
            contacts.rigid_contact_point1,
            contacts.rigid_contact_normal,
            contacts.rigid_contact_margin0,
            contacts.rigid_contact_margin1,
            deepest,
        ],
    )
    return float(deepest.numpy()[0])


def main() -> int:
    """Measure batches and print a table; 0, or 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.prog = "python -m newton_avbd.study.bench.batches"
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(BATCHES)}")
    parser.add_argument("--worlds", type=positive(int), nargs="+", default=[1024])
    add_solvers(parser, SOLVERS)
    parser.add_argument("--seconds", type=float, default=1.0, help="time to simulate [s]")
    parser.add_argument("--device", help="Warp device, cpu or cuda:0 (default: CUDA if there)")
    add_json(parser)
    args = parser.parse_args()
    check_writable(args.json)
    use_device(args.device)
    rows = [["scene", "worlds", "solver", "first s", "step ms", "solver alone ms", "steps/s"]]
    rows[0] += ["joints mm", "deep mm", "m/s", ""]
    results = []
    scenes = chosen("batch", args.scenes, tuple(BATCHES))
    trials = list(itertools.product(scenes, args.worlds, args.solvers or SOLVERS))
    with tables_beside(args.json):
        with interruptible() as interruption:
            for trial in progress(trials, len(trials), "batches", lambda trial: trial[0]):
                try:
                    result = measure(*trial, seconds=args.seconds)
                except Exception as error:  # what keeps one solver must not keep the others
                    say(f"{' '.join(map(str, trial))}: {type(error).__name__}: {error}")
                    continue
                results.append(result)
                rows.append(_row(result))
                say("  ".join(rows[-1]))
        print(table(rows))
    if args.json is not None:
        machine = describe_machine(None) | {"device": wp.get_device().name}
        entries = [asdict(result) for result in results]
        write_json(args.json, {"machine": machine, "results": entries})
    return interruption.status(0)


def _row(result: BatchResult) -> list[str]:
    return [
        result.scene,
        f"{result.worlds:,}",
        PEERS[result.solver].title,
        f"{result.first:.1f}",
        f"{result.step:.3f}",
        f"{result.alone:.3f}",
        f"{result.rate:,.0f}",
        f"{1e3 * result.joints:.3g}",
        f"{1e3 * result.penetration:.3g}",
        f"{result.speed:.3g}",
        "" if result.finite else "not finite",
    ]


if __name__ == "__main__":
    sys.exit(main())
