# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Time of one large world, color by color, against its size."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import newton
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.scenes.named import (
    add_brick_ring,
    add_net,
    add_pyramid,
    add_ragdoll_heap,
    add_sphere_heap,
)
from newton_avbd.setup.memory import bytes_by_effect

DT = 1.0 / 240.0
CONTACTS_A_BODY = 24
"""Room in the contact buffer: a brick of a wall has four at each of six neighbors, shared by two;
pairs that do not touch take places, too."""


def _add_pyramid(builder: newton.ModelBuilder, bodies: int) -> None:
    add_pyramid(builder, rows=max(1, round(math.sqrt(2.0 * bodies))))


def _add_ragdolls(builder: newton.ModelBuilder, bodies: int) -> None:
    add_ragdoll_heap(builder, ragdolls=max(1, round(bodies / 5)))


LARGE_SCENES: dict[str, tuple[str, Callable[[newton.ModelBuilder, int], None]]] = {
    "ring": ("a round wall of bricks", add_brick_ring),
    "spheres": ("spheres fall into a heap", add_sphere_heap),
    "pyramid": ("a pyramid of boxes", _add_pyramid),
    "ragdolls": ("ragdolls of five bodies fall into a heap", _add_ragdolls),
    "net": ("spheres fall into a net of strings", add_net),
}
"""What they are and how they are built, with about so many bodies."""


@dataclass(frozen=True)
class LargeResult:
    """What was measured on one world.

    Attributes:
        scene: Name of the scene.
        bodies: Bodies.
        contacts: Contacts in the last step.
        colors: Colors of the blocks in it; 0 where one thread takes the world.
        clashes: Blocks that found none.
        step: Time of a step without detection, replayed [ms].
        detection: Time of a detection, replayed [ms].
        memory: Memory of the solver's arrays [MB].
        sunk: How far the highest body has come down [m].
        speed: Speed of the fastest body [m/s].
    """

    scene: str
    bodies: int
    contacts: int
    colors: int
    clashes: int
    step: float
    detection: float
    memory: float
    sunk: float
    speed: float


def measure(
    scene: str,
    bodies: int,
    *,
    device: str | None = None,
    iterations: int = 4,
    steps: int = 60,
    repeats: int = 20,
    parallel: Literal["worlds", "bodies"] | None = "bodies",
) -> LargeResult:
    """Simulate a world for some steps, then time steps and detections that graphs replay.

    Args:
        scene: Name in :data:`LARGE_SCENES`.
        bodies: About how many bodies.
        device: Warp device; None for the current one.
        iterations: Sweeps a step.
        steps: Steps of 1/240 s before the time is taken.
        repeats: Replays that the time is the mean of.
        parallel: As of :class:`newton_avbd.SolverAVBD`.
    """
    with wp.ScopedDevice(device):
        builder = newton.ModelBuilder()
        LARGE_SCENES[scene][1](builder, bodies)
        model = builder.finalize()
        pipeline = newton.CollisionPipeline(
            model,
            broad_phase="sap",
            rigid_contact_max=CONTACTS_A_BODY * model.body_count,
            shape_pairs_max=CONTACTS_A_BODY * model.body_count,
        )
        contacts = pipeline.contacts()
        solver = SolverAVBD(model, iterations=iterations, parallel=parallel)
        state, other = model.state(), model.state()
        top = state.body_q.numpy()[:, 2].max()

        def step() -> None:
            solver.step(state, other, None, contacts, DT)
            solver.step(other, state, None, contacts, DT)

        for _ in range(steps // 2):
            pipeline.collide(state, contacts)
            step()
        status = solver.status
        return LargeResult(
            scene=scene,
            bodies=model.body_count,
            contacts=int(contacts.rigid_contact_count.numpy()[0]),
            colors=status.colors,
            clashes=status.clashes,
            sunk=float(top - state.body_q.numpy()[:, 2].max()),
            speed=float(np.linalg.norm(state.body_qd.numpy()[:, :3], axis=1).max()),
            memory=sum(bytes_by_effect(solver).values()) / 1e6,
            detection=_replayed(lambda: pipeline.collide(state, contacts), repeats),
            step=0.5 * _replayed(step, repeats),
        )


def _replayed(call: Callable[[], None], repeats: int) -> float:
    """Mean time of what a graph replays [ms]; processor time on a CPU."""
    clock = time.process_time if wp.get_device().is_cpu else time.perf_counter
    with wp.ScopedCapture() as capture:
        call()
    wp.capture_launch(capture.graph)
    wp.synchronize()
    start = clock()
    for _ in range(repeats):
        wp.capture_launch(capture.graph)
    wp.synchronize()
    return 1e3 * (clock() - start) / repeats
