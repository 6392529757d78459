# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Hard cases of what is asked of a simulation: far away, large and uneven steps, interventions."""

import math
from functools import partial
from typing import Any

import newton
import numpy as np
import warp as wp

from newton_avbd.measure.state import kinetic_energy
from newton_avbd.scenes.chains import add_chain
from newton_avbd.scenes.named import add_ground, add_pyramid, add_stack
from newton_avbd.study.stability.bodies import fastest
from newton_avbd.study.stability.case import Bounds, Catalog, Trial
from newton_avbd.study.stability.joints import OPEN, add_link, at
from newton_avbd.study.stability.piles import SUNK, add_box, block

STEPS = Catalog()
"""Cases of steps and interventions by name."""


def _add_pile_and_chain(builder: newton.ModelBuilder) -> None:
    """A pyramid of five rows and, beside it, ten hinged links that swing."""
    add_pyramid(builder, rows=5)
    chain = newton.ModelBuilder()
    chain.default_shape_cfg = builder.default_shape_cfg.copy()
    add_chain(chain, links=10)
    builder.add_builder(chain, xform=at(10.0, 5.0, 0.0))


def _add_far(builder: newton.ModelBuilder, distance: float) -> None:
    """The same, away from the origin by a distance along both horizontal axes [m]."""
    near = newton.ModelBuilder()
    near.default_shape_cfg = builder.default_shape_cfg.copy()
    _add_pile_and_chain(near)
    builder.add_builder(near, xform=at(distance, distance, 0.0))


def _pile_moved(trial: Trial) -> float:
    """Largest distance of a box of the pyramid from its start [m]."""
    return float(np.max(np.linalg.norm((trial.centers() - trial.start)[:15], axis=1)))


for kilometers in (10, 100):
    rounding = float(np.spacing(np.float32(1000.0 * kilometers)))
    STEPS.add(
        f"origin_{kilometers}_km",
        f"a pyramid of five rows and a swinging chain, {kilometers} km from the origin",
        partial(_add_far, distance=1000.0 * kilometers),
        # what a pose is rounded to, on both sides of a contact or joint and on two axes
        Bounds(penetration=SUNK, joint=2.0 * rounding, gain=1e-3, drift=4.0 * rounding),
        drift=_pile_moved,
        vbd_ke=4e6,
    )

for label, dt in (("10000", 1e-4), ("1000", 1e-3), ("60", 1 / 60), ("30", 1 / 30), ("20", 1 / 20)):
    STEPS.add(
        f"rate_{label}",
        f"a pyramid of five rows and a swinging chain at {label} steps a second",
        _add_pile_and_chain,
        Bounds(penetration=SUNK, joint=OPEN, gain=1e-3, drift=1e-3),
        drift=_pile_moved,
        dt=dt,
        own_rate="it is about its own rate",
        seconds=1.0 if dt < 5e-4 else 5.0,
        is_quick=dt > 5e-4,
        vbd_ke=4e6,
    )


# a tenth of an edge in impacts at 5 m/s, 24 cm a step, which detection must see coming
_LANDING: dict[str, Any] = {
    "bounds": Bounds(penetration=0.05, gain=1e-2),
    "dt": 1 / 20,
    "speculative": 1.0,
    "seconds": 10.0,
}


@STEPS.declare(
    "landing_20", "boxes, tilted, fall by a meter and more at 20 steps a second", **_LANDING
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.5, gap=0.1)
    rng = np.random.default_rng(5)
    for i in range(20):
        x, y, z, w = rng.normal(size=4)
        turn = wp.normalize(wp.quat(float(x), float(y), float(z), float(w)))
        position = (0.8 * (i % 3 - 1), 0.8 * (i // 3 % 3 - 1), 1.5 + 1.0 * (i // 9))
        add_box(builder, position, (0.5, 0.5, 0.5), turn, gap=0.1)


@STEPS.declare(
    "landing_20_balls",
    "balls fall likewise, which contacts found a step before say all about",
    **_LANDING,
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=0.5, gap=0.1)
    rng = np.random.default_rng(5)
    for i in range(20):
        x, y = rng.uniform(-0.15, 0.15, size=2)
        position = (0.8 * (i % 3 - 1) + x, 0.8 * (i // 3 % 3 - 1) + y, 1.5 + 1.0 * (i // 9))
        body = builder.add_body(xform=at(*map(float, position)))
        builder.add_shape_sphere(body, radius=0.25, cfg=block(builder, gap=0.1))


def _uneven(step: int) -> float:
    """A step between 1/1000 and 1/60 s, another one each time."""
    return float(np.exp(np.random.default_rng(step).uniform(math.log(1e-3), math.log(1 / 60))))


STEPS.add(
    "uneven_steps",
    "a pyramid of five rows and a swinging chain, every step of another length, 1 to 17 ms",
    _add_pile_and_chain,
    Bounds(penetration=SUNK, joint=OPEN, gain=1e-3, drift=1e-3),
    drift=_pile_moved,
    dt=_uneven,
    own_rate="it is about steps of different lengths",
    vbd_ke=4e6,
)

STEPS.add(
    "alternating_steps",
    "a stack of ten, steps of 1/60 and 1/1000 s in turn",
    partial(add_stack, count=10),
    Bounds(penetration=SUNK, gain=SUNK, drift=1e-3),
    dt=lambda step: 1e-3 if step % 2 else 1.0 / 60.0,
    own_rate="it is about steps of different lengths",
    vbd_ke=1e8,
)


def _switch(trial: Trial, step: int) -> bool:
    """Gravity off, up, sideways and down again, for half a second each."""
    period = round(0.5 / trial.case.step_size(step))
    if step % period:
        return False
    g = 9.81
    ways = ((0.0, 0.0, -g), (0.0, 0.0, 0.0), (0.0, 0.0, 0.5 * g), (g, 0.0, -g), (0.0, 0.0, -g))
    trial.set_gravity(ways[min(step // period, len(ways) - 1)])
    return True


STEPS.add(
    "gravity_switched",
    "a stack of ten while gravity goes off, up, aslant and down again",
    partial(add_stack, count=10),
    # impacts at some m/s
    Bounds(penetration=5e-3, gain=1e-3),
    act=_switch,
    vbd_ke=1e8,
)


def _teleport(trial: Trial, step: int) -> bool:
    """Put one box after the other on top of the pyramid, or half into another box."""
    period = round(0.25 / trial.case.step_size(step))
    if step == 0 or step % period:
        return False
    turn = step // period
    where = (0.0, 0.0, 4.5) if turn % 2 else (0.4, 0.2, 0.4)
    trial.place(turn % 15, (*where, 0.0, 0.0, 0.0, 1.0))
    return True


STEPS.add(
    "teleports",
    "boxes of a pyramid of five rows are put elsewhere, also into each other",
    partial(add_pyramid, rows=5),
    # no faster than a fall from the height of the pyramid
    Bounds(drift=math.sqrt(2.0 * 9.81 * 4.5)),
    drift=fastest,
    drift_unit="m/s",
    act=_teleport,
    vbd_ke=4e6,
)


class _Throws:
    """Sums up what the steps of a pile add to its kinetic energy beyond the work of gravity.

    Where boxes are put into others, a solver that parts them may lift some, which then fall. But no
    step may speed them up by more than gravity does, m g.v dt.
    """

    def __init__(self) -> None:
        self.kinetic = 0.0
        self.added = 0.0

    def act(self, trial: Trial, step: int) -> bool:
        """Put boxes elsewhere; forget what another run has left."""
        if step == 0:
            self.added = 0.0
        is_put = _teleport(trial, step)
        self.kinetic = self._kinetic(trial)
        return is_put

    def drift(self, trial: Trial) -> float:
        """Kinetic energy added in all steps so far, as the height to which it lifts all [m]."""
        bodies = trial.bodies
        weight = bodies.mass[:, None] * bodies.gravity
        work = np.sum(weight * trial.velocities()[:, :3]) * trial.case.step_size(0)
        added = self._kinetic(trial) - self.kinetic - work
        self.added += max(0.0, added) / np.sum(np.linalg.norm(weight, axis=1))
        return float(self.added)

    @staticmethod
    def _kinetic(trial: Trial) -> float:
        return float(np.sum(kinetic_energy(trial.bodies, trial.poses(), trial.velocities())))


_THROWS = _Throws()

STEPS.add(
    "teleports_energy",
    "the same: what is pushed out may fall, but is not thrown",
    partial(add_pyramid, rows=5),
    Bounds(drift=1e-3),
    drift=_THROWS.drift,
    act=_THROWS.act,
    vbd_ke=4e6,
)

CAR_WHEEL = 0.3
"""Radius of the wheels of the car [m]."""
CAR_SPEED = 400.0
"""Speed that its motors are to reach [rad/s]: 6.7 radians a step. It starts at half of it."""
CAR_DRIVE = 0.5
"""What each of its motors pushes with for a lack of speed [N m s/rad]."""


@STEPS.declare(
    "fast_car",
    "motors take the wheels of a car to more than a revolution a step, at 60 steps a second",
    # wheels that roll: as fast as they turn, where they touch
    Bounds(penetration=1e-4, joint=1e-3 * CAR_WHEEL, drift=1.001 * CAR_WHEEL * CAR_SPEED),
    drift=fastest,
    drift_unit="m/s",
    dt=1.0 / 60.0,
    seconds=30.0,
)
def _(builder: newton.ModelBuilder) -> None:
    add_ground(builder, mu=1.0, gap=0.02)
    chassis = add_link(builder, at(0.0, 0.0, CAR_WHEEL + 0.2), (1.6, 0.6, 0.2))
    joints = [builder.add_joint_free(chassis)]
    for x, y in ((-0.6, -0.5), (-0.6, 0.5), (0.6, -0.5), (0.6, 0.5)):
        wheel = builder.add_link(xform=at(x, y, CAR_WHEEL))
        cfg = block(builder, density=300.0, mu=1.0, gap=0.02)
        builder.add_shape_sphere(wheel, radius=CAR_WHEEL, cfg=cfg)
        joints.append(
            builder.add_joint_revolute(
                chassis,
                wheel,
                parent_xform=at(x, y, -0.2),
                axis=(0.0, 1.0, 0.0),
                target_kd=CAR_DRIVE,
                target_qd=CAR_SPEED,
                actuator_mode=newton.JointTargetMode.VELOCITY,
            )
        )
    builder.add_articulation(joints)
    spin = 0.5 * CAR_SPEED
    for body in range(chassis, chassis + 5):
        turning = 0.0 if body == chassis else spin
        builder.body_qd[body] = wp.spatial_vector(CAR_WHEEL * spin, 0.0, 0.0, 0.0, turning, 0.0)
    builder.joint_qd[:] = [CAR_WHEEL * spin, *5 * [0.0], *4 * [spin]]


class _Replays:
    """Resets a run every 100 steps and compares it with how it went first."""

    PERIOD = 100

    def __init__(self) -> None:
        self.first: list[np.ndarray] = []
        self.off = 0.0
        self.steps = 0

    def act(self, trial: Trial, step: int) -> bool:
        """Reset; forget what another run has left."""
        if step == 0:
            self.first, self.off, self.steps = [], 0.0, 0
        if step == 0 or step % self.PERIOD:
            return False
        trial.reset()
        return True

    def drift(self, trial: Trial) -> float:
        """Largest distance of a body from where it was as many steps after the start [m]."""
        centers = trial.centers()
        if self.steps < self.PERIOD:
            self.first.append(centers)
        else:
            apart = centers - self.first[self.steps % self.PERIOD]
            self.off = max(self.off, float(np.max(np.linalg.norm(apart, axis=1))))
        self.steps += 1
        return self.off


_REPLAYS = _Replays()


def _add_throw(builder: newton.ModelBuilder) -> None:
    """The pyramid and the chain, and a box that is thrown into the pyramid."""
    _add_pile_and_chain(builder)
    box = add_box(builder, (-5.0, 0.0, 2.0), (0.5, 0.5, 0.5))
    builder.body_qd[box] = wp.spatial_vector(12.0, 0.0, 0.0, 1.0, 2.0, 3.0)
    builder.joint_qd[-6:] = [12.0, 0.0, 0.0, 1.0, 2.0, 3.0]


STEPS.add(
    "resets",
    "a pyramid that a box hits, and a chain, are reset every 100 steps",
    _add_throw,
    # a reset run is the same run
    Bounds(joint=1e-3, drift=1e-6),
    act=_REPLAYS.act,
    drift=_REPLAYS.drift,
    vbd_ke=4e6,
)
