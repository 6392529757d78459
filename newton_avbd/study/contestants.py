# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Running one solver on one scene: how well it does, and how long a step takes.

Time is the CPU time of this process (``time.process_time``), so that what else the machine does
counts as little as possible. Collision detection is outside of what is timed, or taken out of it,
unless it is asked for.
"""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial

import newton
import numpy as np
import warp as wp

from newton_avbd.measure import state as measure
from newton_avbd.measure.joints import JointProbe, JointQuality
from newton_avbd.measure.state import Array
from newton_avbd.scenes.named import Scene
from newton_avbd.study.peers import Peer

SAMPLES = 10
"""States of a run that are measured, evenly spread; the last one is its end."""

GRAPH_STEPS = 4
"""Steps in a captured graph: a frame's. Even, so that a replay ends in the state it began with."""
FRAMES_IN_ONE_GO = 16
"""Of those that are replayed at once where nothing collides, as ``mj_step`` makes as many steps in
a call: reading a clock and launching from Python take as long as the steps of a cartpole."""


@dataclass(frozen=True)
class Quality:
    """How well a run went.

    Attributes:
        seconds: Simulated time [s].
        contacts: Contacts that Newton's collision detection reports at the end.
        penetration: Deepest penetration in any sample [m].
        drift: Largest distance of a body's center of mass from where it belongs [m]: its start,
            or without gravity a straight line.
        speed: Largest speed of a center of mass at the end [m/s].
        momentum: Without gravity: largest change of a body's angular momentum, relative to its
            size; otherwise None.
        joints: What joints have shown; None without joints.
        apart: Where worlds are compared: largest distance of a body's center of mass, at the
            end, from where the world alone has it [m]; otherwise None.
    """

    seconds: float
    contacts: int
    penetration: float
    drift: float
    speed: float
    momentum: float | None
    joints: JointQuality | None = None
    apart: float | None = None

    def value(self, quantity: str) -> float | None:
        """An attribute of this or of its joints, by name; None where there is none."""
        return getattr(self, quantity, getattr(self.joints, quantity, None))

    def failed(self) -> "Quality":
        """The same run, but nothing that it shows is worth anything."""
        joints = self.joints and JointQuality(*[math.nan] * len(fields(JointQuality)))
        nan = math.nan
        return replace(self, penetration=nan, drift=nan, speed=nan, joints=joints)


class Contestant(ABC):
    """A solver at work on a scene.

    Attributes:
        scene: The scene.
        model: Its model, one per contestant.
        state: The current state, measured between steps.
    """

    def __init__(self, scene: Scene, model: newton.Model):
        self.scene = scene
        self.model = model
        self.state = model.state()
        self._probe = measure.Probe(model)

    @property
    def is_uninterrupted(self) -> bool:
        """Whether nothing can collide, so that nothing happens between steps."""
        return self.model.shape_contact_pair_count == 0

    @abstractmethod
    def advance(self) -> float:
        """Make one step; return its CPU time, collision detection taken out [s]."""

    @abstractmethod
    def observe(self) -> newton.State:
        """The state after the last step."""

    @abstractmethod
    def replay(self, *, collide: bool = False) -> float:
        """CPU time of a step without Python and launches around it [s]; NaN if there is no way.

        With ``collide`` it includes finding the collisions.
        """

    def run(self, seconds: float, budget: float) -> Quality:
        """Simulate, measure quality, and end in a state in which steps can be timed.

        Args:
            seconds: Time to simulate [s].
            budget: Wall-clock time after which to stop early [s].

        Returns:
            The quality of what was simulated.
        """
        bodies = self._probe.bodies
        steps = max(2, round(seconds / self.scene.dt))
        joints = JointProbe(self.model)
        sampled = {steps * (i + 1) // SAMPLES for i in range(SAMPLES)}
        free = not bodies.gravity.any()
        start_q, start_qd = _copy(self.observe())
        center = measure.transform(start_q, bodies.com)
        if joints.watching:
            joints.watch(start_q, self._probe.energy(self.state))
        # The first step loads kernels, which does not count towards the budget.
        self.advance()
        begin, done, late, penetration = time.monotonic(), 1, False, 0.0
        while done < steps and not late:
            self.advance()
            done += 1
            late = time.monotonic() - begin > budget
            if joints.watching and done % GRAPH_STEPS == 0:
                # Joints open for moments, in which a heavy end turns around or a foot lands.
                joints.watch(_copy(self.observe())[0], self._probe.energy(self.state))
            if late or done in sampled:
                gaps = self._probe.separations(self.observe())
                penetration = float(np.maximum(penetration, measure.deepest_penetration(gaps)))
        body_q, body_qd = _copy(self.observe())
        belongs = center + (done * self.scene.dt * start_qd[:, :3] if free else 0.0)
        offset = np.linalg.norm(measure.transform(body_q, bodies.com) - belongs, axis=1)
        momentum = _momentum_error(bodies, (start_q, start_qd), (body_q, body_qd))
        quality = Quality(
            seconds=done * self.scene.dt,
            contacts=len(gaps),
            penetration=penetration,
            drift=float(np.max(offset)),
            speed=self._probe.speed(self.observe()),
            momentum=momentum if free else None,
            joints=joints.worst if joints.watching else None,
        )
        # Solvers may keep the poses of a state whose velocities are not finite.
        return quality if math.isfinite(quality.speed) and not self.gave_up() else quality.failed()

    def gave_up(self) -> bool:
        """Whether the solver says that it could not go on."""
        return False

    def centers(self) -> Array:
        """Where every body has its center of mass [m], shape [bodies, 3]."""
        return measure.transform(_copy(self.observe())[0], self._probe.bodies.com)

    def eager(self, seconds: float) -> float:
        """Median CPU time of a plain step over about ``seconds`` of steps [s]."""
        return _median(self.advance, seconds)

    def replayed(self, seconds: float) -> float:
        """Median CPU time of a replayed step over about ``seconds`` of steps [s], or NaN."""
        return _median(self.replay, seconds)

    def collided(self, seconds: float) -> float:
        """The same with the collision detection of each step; NaN where nothing can collide."""
        if self.is_uninterrupted:
            return math.nan
        return _median(partial(self.replay, collide=True), seconds)


class NewtonContestant(Contestant):
    """One of Newton's solvers, through ``SolverBase.step``.

    Contacts are detected anew before every eager step and before every replay of a frame, outside
    of what is timed. Within the frame they are marked as new before each step, so that no solver
    saves the work of matching them.
    """

    def __init__(self, scene: Scene, peer: Peer):
        """Set ``peer`` up on ``scene``."""
        super().__init__(scene, peer.model(scene))
        self._peer = peer
        self.solver = peer.make(self.model)
        self._control = self.model.control()
        self._next = self.model.state()
        self._pipeline: newton.CollisionPipeline | None = None
        self._contacts: newton.Contacts | None = None
        # Where nothing can collide, a user passes no contacts.
        if self.model.shape_contact_pair_count and not peer.detects:
            self._pipeline = newton.CollisionPipeline(self.model)
            self._contacts = self._pipeline.contacts()
        self._graphs: dict[bool, wp.Graph] = {}

    def observe(self) -> newton.State:
        return self.state

    def gave_up(self) -> bool:
        # SolverAVBD holds a world still where it would blow up, which must not look like rest.
        status = getattr(self.solver, "status", None)
        return bool(np.any(getattr(status, "held_steps", 0)))

    def advance(self) -> float:
        self._collide()
        begin = time.process_time()
        self._step()
        return time.process_time() - begin - self._detection()

    def replay(self, *, collide: bool = False) -> float:
        if not self._peer.captures:
            return math.nan
        if collide not in self._graphs:
            self._graphs[collide] = self._capture(collide)
        self._collide()
        begin = time.process_time()
        wp.capture_launch(self._graphs[collide])
        return (time.process_time() - begin) / self._steps(collide)

    def _collide(self) -> None:
        if self._pipeline is not None:
            self._pipeline.collide(self.state, self._contacts)

    def _step(self) -> None:
        self.solver.step(self.state, self._next, self._control, self._contacts, self.scene.dt)
        self.state, self._next = self._next, self.state

    def _steps(self, collide: bool) -> int:
        """Steps in a captured graph."""
        return GRAPH_STEPS * (FRAMES_IN_ONE_GO if self.is_uninterrupted or collide else 1)

    def _capture(self, collide: bool) -> wp.Graph:
        """Record a frame of steps, or as many frames as nothing interrupts."""
        with wp.ScopedCapture(device="cpu") as capture:
            for _ in range(self._steps(collide)):
                if collide:
                    self._collide()
                elif self._contacts is not None:
                    generation = self._contacts.contact_generation
                    wp.launch(_renew, 1, inputs=[generation], device="cpu")
                self._step()
        return capture.graph

    def _detection(self) -> float:
        """CPU time of the collision detection inside the last step [s]."""
        if not self._peer.detects:
            return 0.0
        import mujoco

        begin = time.process_time()
        mujoco.mj_collision(self.solver.mj_model, self.solver.mj_data)
        return time.process_time() - begin


@wp.kernel(enable_backward=False)
def _renew(generation: wp.array[wp.int32]) -> None:
    """Tell solvers that the contacts have been detected anew."""
    generation[0] = generation[0] + 1


def _median(timed: Callable[[], float], seconds: float) -> float:
    """Median of what ``timed`` returns, called for about ``seconds``, at most 50 times."""
    begin = time.process_time()
    times: list[float] = []
    while not times or (time.process_time() - begin < seconds and len(times) < 50):
        times.append(timed())
    return float(np.median(times))


def _copy(state: newton.State) -> tuple[Array, Array]:
    """Poses, shape [n, 7], and velocities, shape [n, 6], of ``state``, in double precision."""
    return state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)


def _momentum_error(
    bodies: measure.Bodies, start: tuple[Array, Array], end: tuple[Array, Array]
) -> float:
    """Largest change of a body's angular momentum about its center of mass, relative to it."""
    before, after = (measure.spin_momenta(bodies, *state) for state in (start, end))
    size = np.maximum(np.linalg.norm(before, axis=1), 1e-12)
    return float(np.max(np.linalg.norm(after - before, axis=1) / size))
