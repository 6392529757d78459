# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Runs of a million steps: what creeps, heats up or piles up shows only then.

Detection and steps are recorded in a graph that is replayed, so that a million of them take
minutes.
"""

import math
import resource
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import newton
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.measure import state as measure
from newton_avbd.measure.joints import Joints
from newton_avbd.measure.state import Array
from newton_avbd.scenes.named import add_pyramid
from newton_avbd.study.stability.case import DT, G
from newton_avbd.study.stability.joints import add_link, at
from newton_avbd.study.stability.piles import add_box

IN_GRAPH = 120
"""Steps of a replay, an even number, after which the scene is looked at."""

WARM = 2_400
"""Steps in which a scene settles before it is watched, a multiple of :data:`IN_GRAPH`."""

PERIOD = 2 * IN_GRAPH
"""Steps in which the motor of the four-bar goes to and fro."""

SWING = wp.constant(1.0)
"""How far it goes [rad]."""

MOTOR = {"target_ke": 1e4, "target_kd": 1e2, "actuator_mode": newton.JointTargetMode.POSITION}
"""Drive of the crank."""


@wp.kernel(enable_backward=False)
def swing_motor(clock: wp.array[wp.int32], target_q: wp.array[float]) -> None:
    """Moves the target of the first joint to and fro; one thread."""
    clock[0] = (clock[0] + 1) % PERIOD
    target_q[0] = SWING * wp.sin(wp.static(2.0 * math.pi / PERIOD) * float(clock[0]))


def add_pile(builder: newton.ModelBuilder) -> None:
    """Add a pyramid of six boxes and a plank that leans on its foot at 50 degrees, by friction."""
    add_pyramid(builder, rows=3, edge=0.4)
    tilt = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), math.radians(50.0))
    add_box(builder, (0.7215, 0.0, 0.3258), (0.8, 0.3, 0.06), tilt)


def add_four_bar(builder: newton.ModelBuilder) -> None:
    """Add a crank, a coupler and a rocker in a vertical plane, a loop with the ground."""
    crank, coupler, rocker, ground = 0.2, 0.9, 0.7, 1.0
    # the crank points to +x; the joint between coupler and rocker is where their circles meet
    span = ground - crank
    along = (span**2 + coupler**2 - rocker**2) / (2.0 * span)
    joint = np.array([crank + along, math.sqrt(coupler**2 - along**2)])
    ends = (np.zeros(2), np.array([crank, 0.0]), joint, np.array([ground, 0.0]))
    axis = (0.0, 1.0, 0.0)
    parent, joints = -1, []
    before = at()
    for i, length in enumerate((crank, coupler, rocker)):
        middle, (x, z) = 0.5 * (ends[i] + ends[i + 1]), ends[i + 1] - ends[i]
        turn = wp.quat_from_axis_angle(wp.vec3(*axis), -math.atan2(z, x))
        frame = at(float(middle[0]), 0.0, 2.0 + float(middle[1]), turn)
        link = add_link(builder, frame, (length, 0.05, 0.05))
        near, far = at(-0.5 * length), at(0.5 * length)
        # all joints are at 0 as built: anchors of both sides are parallel to the child
        hung = at(0.0, 0.0, 2.0, turn) if parent < 0 else before * wp.transform(wp.vec3(), turn)
        joints.append(
            builder.add_joint_revolute(
                parent,
                link,
                axis=axis,
                parent_xform=hung,
                child_xform=near,
                **(MOTOR if parent < 0 else {}),
            )
        )
        before, parent = far * wp.transform(wp.vec3(), wp.quat_inverse(turn)), link
    builder.add_articulation(joints)
    builder.add_joint_revolute(
        -1, parent, axis=axis, parent_xform=at(ground, 0.0, 2.0, turn), child_xform=far
    )


LONG_RUNS: dict[str, Callable[[newton.ModelBuilder], None]] = {
    "resting_pile": add_pile,
    "driven_four_bar": add_four_bar,
}
"""Scenes of long runs by name."""


MOST_MOVED = 1e-4
"""Drift, gained energy as a height, and distance of anchors that a long run may reach [m]."""

MOST_MEMORY = 4 * 2**20
"""Growth of memory that is none: what Python keeps of what was looked at [bytes]."""


@dataclass(frozen=True)
class LongRun:
    """What became of a scene between :data:`WARM` steps and the end.

    Attributes:
        steps: Steps of the run.
        drift: Farthest that a center of mass was from where it was, seen once in
            :data:`IN_GRAPH` steps; a driven scene is compared with where it was at the same point
            of the period [m].
        final_drift: The same at the end [m].
        speed: Largest speed of a center of mass, of a scene at rest, in the last of them [m/s].
        energy: Largest change of energy, as a height to which it would lift all bodies [m].
        separation: Largest distance between the anchors of a joint [m].
        penetration: Deepest penetration at the end [m].
        contacts: Fewest and most contacts in the buffer.
        memory: Growth of the largest resident set of the process [bytes].
        held: Steps in which the world was held still.
        microseconds: Mean time of a step, collision detection included [us].
        stopped: Whether Ctrl-C ended it before all its steps.
    """

    steps: int
    drift: float
    final_drift: float
    speed: float
    energy: float
    separation: float
    penetration: float
    contacts: tuple[int, int]
    memory: int
    held: int
    microseconds: float
    stopped: bool = False

    def failures(self) -> list[str]:
        """What is not as it must be; empty for a pass."""
        most = dict.fromkeys(("drift", "energy", "separation", "penetration"), MOST_MOVED)
        most |= {"memory": MOST_MEMORY, "held": 0}
        failures = [name for name, bound in most.items() if not getattr(self, name) <= bound]
        return failures + (["contacts"] if self.contacts[0] != self.contacts[1] else [])


def run_long(
    name: str,
    steps: int,
    iterations: int | None = None,
    watch: Callable[[range], Iterable[int]] = iter,
) -> LongRun:
    """Run one of :data:`LONG_RUNS`. After Ctrl-C it returns what was found until then.

    Args:
        name: Its name.
        steps: How many steps, rounded up to a multiple of :data:`IN_GRAPH`.
        iterations: Sweeps a step; None for the solver's own.
        watch: Yields the numbers of the replays as they are worked through, as a bar of progress
            does.
    """
    builder = newton.ModelBuilder()
    LONG_RUNS[name](builder)
    model = builder.finalize()
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    solver = SolverAVBD(model, iterations=iterations)
    state, other = model.state(), model.state()
    control, clock = model.control(), wp.zeros(1, dtype=wp.int32)
    is_driven = model.joint_target_ke is not None and bool(model.joint_target_ke.numpy().any())

    def step_twice() -> None:
        for first, second in ((state, other), (other, state)):
            if is_driven:
                wp.launch(swing_motor, dim=1, inputs=[clock, control.joint_target_q])
            pipeline.collide(first, contacts)
            solver.step(first, second, control, contacts, DT)

    step_twice()
    with wp.ScopedCapture(device=model.device) as capture:
        for _ in range(IN_GRAPH // 2):
            step_twice()

    def replay() -> None:
        wp.capture_launch(capture.graph)

    bodies, joints = measure.Bodies.of(model), Joints.of(model)
    for _ in range(WARM // IN_GRAPH):
        replay()

    def look() -> tuple[Array, float, float, int]:
        poses = state.body_q.numpy().astype(float)
        open_by = float(np.max(joints.separation(poses), initial=0.0))
        count = int(contacts.rigid_contact_count.numpy()[0])
        return (
            measure.transform(poses, bodies.com),
            measure.total_energy(bodies, state),
            open_by,
            count,
        )

    weight = G * float(np.sum(bodies.mass))
    # a period of the drive is two replays
    starts = []
    for _ in range(2):
        replay()
        starts.append(look())
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    drifts, energies, opened, counts = [0.0], [0.0], [0.0], []
    begin = time.perf_counter()
    done, stopped = 0, False
    try:
        for i in watch(range(math.ceil(steps / IN_GRAPH))):
            replay()
            (center, energy, open_by, count), start = look(), starts[i % 2]
            drifts.append(float(np.linalg.norm(center - start[0], axis=1).max()))
            energies.append(abs(energy - start[1]) / weight)
            opened.append(open_by)
            counts.append(count)
            done = i + 1
    except KeyboardInterrupt:
        if not done:
            raise
        stopped = True
    seconds = time.perf_counter() - begin
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    gaps = measure.Probe(model).separations(state)
    return LongRun(
        steps=done * IN_GRAPH,
        drift=max(drifts) if np.isfinite(drifts).all() else math.nan,
        final_drift=drifts[-1],
        speed=measure.largest_speed(bodies, state),
        energy=max(energies) if np.isfinite(energies).all() else math.nan,
        separation=max(opened),
        penetration=measure.deepest_penetration(gaps),
        contacts=(min(counts), max(counts)),
        memory=grown,
        held=int(solver.status.held_steps.sum()),
        microseconds=1e6 * seconds / (done * IN_GRAPH),
        stopped=stopped,
    )
