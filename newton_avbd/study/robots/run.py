# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Letting a robot hold its first pose and then wave, with one solver, and recording it."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import newton
import numpy as np
from numpy.typing import NDArray

from newton_avbd.measure.joints import Joints
from newton_avbd.measure.state import Array, Bodies
from newton_avbd.model.equalities import may_hold
from newton_avbd.scenes.finalize import finalized
from newton_avbd.scenes.pose import Pose, can_fall
from newton_avbd.study.peers import PEERS
from newton_avbd.study.robots.torque import Torques
from newton_avbd.study.robots.wave import wave

DT = 1.0 / 240.0
"""Step [s]."""

HOLD = 480
"""Steps for which the first pose is held at least."""

HOLD_MOST = 960
"""Steps for which it is held at most: as long as the robot has not come to rest."""

REST = 0.01
"""Speed below which all bodies of a robot count as at rest [m/s]."""

MOVE = 360
"""Steps of the motion that follows."""

WEIGHED = 120
"""Steps at the end of the hold over which contact forces are weighed."""

WAVES = 0.75
"""Frequency of the motion [Hz]."""

REACH = 0.2
"""Largest displacement of a joint in the motion [rad]; a third of it in meters."""

EVERY = 4
"""Steps between two states that are measured."""


@dataclass
class Record:
    """What a robot did.

    Attributes:
        finite: Whether all states were, and the solver never had to freeze the world.
        separation: Largest distance of the anchors of a joint [m].
        misalignment: Largest rotation of a joint about what it locks [rad].
        joint: Name of the joint with the worst of the two.
        limit: Largest violation of a limit [rad or m].
        lag: Mean distance of each driven coordinate from its target over the motion [rad or m],
            by the name of the joint and the number of its axis.
        law: What the law of the drive alone gives for the same: its damping, and the joint's, over
            its stiffness, times the mean speed of the target [rad or m].
        stroke: Mean distance of each target from the first pose [rad or m].
        wrong: Share of what each drive pushes over the motion that is not its law's, by
            :class:`newton_avbd.study.robots.torque.Torques`; empty where that is not told.
        weight: Total weight of what can fall [N].
        support: Mean vertical contact force with the world at the end of the hold [N]; NaN where
            the solver does not say.
        demand: The vertical force that Newton's second law calls for, over the same time [N].
        speed: Largest speed of a body at the end of the hold [m/s].
        model: The model.
        state: Its last state.
    """

    finite: bool = True
    separation: float = 0.0
    misalignment: float = 0.0
    joint: str = ""
    limit: float = 0.0
    lag: dict[str, float] = field(default_factory=dict)
    law: dict[str, float] = field(default_factory=dict)
    stroke: dict[str, float] = field(default_factory=dict)
    wrong: dict[str, float] = field(default_factory=dict)
    weight: float = 0.0
    support: float = math.nan
    demand: float = math.nan
    speed: float = math.nan
    model: newton.Model | None = None
    state: newton.State | None = None


def run_robot(
    pose: Pose, solver_name: str, budget: float, shown: Callable[[int, int], None]
) -> Record:
    """Hold the first pose and wave.

    Args:
        pose: The robot, set up.
        solver_name: ``avbd`` or ``mujoco``, of :data:`newton_avbd.study.peers.PEERS`.
        budget: Wall-clock time after which to give up [s].
        shown: Called with the steps made and all steps.

    Returns:
        The record.

    Raises:
        TimeoutError: It took longer than ``budget``.
    """
    model = finalized(pose.builder, device="cpu")
    peer = PEERS[solver_name]
    solver = peer.make(model)
    state, following, control = model.state(), model.state(), model.control()
    pipeline = None if peer.detects else newton.CollisionPipeline(model, broad_phase="sap")
    contacts = None if pipeline is None else pipeline.contacts()
    kind = newton.solvers.SolverBase.ObservableKind.CONTACT_F
    observables = None if contacts is None else solver.observables([kind], contacts=contacts)
    seconds: Array = DT * np.arange(1.0, MOVE + 1.0)
    targets = wave(pose.builder, pose.driven, seconds, WAVES, REACH)
    bodies, joints, record = Bodies.of(model), Joints.of(model), Record()
    chosen = watched_joints(model)
    falling = falls(pose.builder)
    record.weight = float(bodies.mass[falling] @ -bodies.gravity[falling, 2])
    q = model.joint_q.numpy()
    joint_q, joint_qd = model.joint_q, model.joint_qd
    torques = None if observables is None else Torques(model, DT)
    lags: list[Array] = []
    hold, pushed, momentum, restless = HOLD, 0.0, 0.0, 0.0
    step = -1
    begin = time.monotonic()
    while step < hold + MOVE - 1:
        step += 1
        if step >= hold:
            control.joint_target_q.assign(targets[step - hold].astype(np.float32))
        if step == hold - WEIGHED:
            momentum, pushed, restless = vertical_momentum(bodies, falling, state), 0.0, 0.0
        start = None if torques is None or step < hold else torques.start(state)
        if pipeline is not None:
            pipeline.collide(state, contacts)
        if observables is None:
            solver.step(state, following, control, None, DT)
        else:
            solver.step(state, following, control, contacts, DT, observables=observables)
        state, following = following, state
        if torques is not None and start is not None:
            torques.add(start, state, targets[step - hold], contacts, observables)
        if hold - WEIGHED <= step < hold:
            restless = max(restless, largest_speed(state))
            if observables is not None:
                pushed += support(model, falling, contacts, observables)
        if step == hold - 1:
            if restless > REST and hold < HOLD_MOST:
                hold += WEIGHED
                continue
            gained = vertical_momentum(bodies, falling, state) - momentum
            record.demand = record.weight + gained / (WEIGHED * DT)
            record.support = math.nan if observables is None else pushed / WEIGHED
            record.speed = largest_speed(state)
        if step % EVERY == 0 or step == hold + MOVE - 1:
            shown(step, hold + MOVE)
            body_q = state.body_q.numpy().astype(float)
            if not np.isfinite(body_q).all() or not np.isfinite(state.body_qd.numpy()).all():
                record.finite = False
                break
            watch(record, joints, body_q, chosen)
            if step >= hold:
                newton.eval_ik(model, state, joint_q, joint_qd)
                q = joint_q.numpy()
                lags.append(np.abs(q - targets[step - hold]))
        if time.monotonic() - begin > budget:
            raise TimeoutError(f"gave up after {step + 1} of {hold + MOVE} steps in {budget:.0f} s")
    status = getattr(solver, "status", None)
    record.finite &= not np.any(getattr(status, "held_steps", 0))
    if lags:
        speed = np.mean(np.abs(np.diff(targets, axis=0)), axis=0) / DT
        stroke = np.mean(np.abs(targets - pose.builder.joint_q), axis=0)
        record.lag = by_name(pose.builder, pose.driven, np.mean(lags, axis=0))
        record.stroke = by_name(pose.builder, pose.driven, stroke)
        record.law = by_name(pose.builder, pose.driven, speed, delays(pose.builder))
        if torques is not None and torques.told:
            record.wrong = torques.shares(pose.builder, pose.driven)
    record.model, record.state = model, state
    return record


def largest_speed(state: newton.State) -> float:
    """Largest speed of a body [m/s]."""
    return float(np.max(np.linalg.norm(state.body_qd.numpy()[:, :3], axis=1)))


def watched_joints(model: newton.Model) -> list[str]:
    """Names of the joints that :class:`Joints` watches, in its order."""
    kind = model.joint_type.numpy()
    loose = (newton.JointType.FREE, newton.JointType.DISTANCE, newton.JointType.ROD)
    chosen = model.joint_enabled.numpy() & may_hold(model) & ~np.isin(kind, loose)
    return [model.joint_label[joint] for joint in np.flatnonzero(chosen)]


def watch(record: Record, joints: Joints, body_q: Array, names: list[str]) -> None:
    """Take the worst of a state into the record."""
    if not names:
        return
    apart, askew = joints.separation(body_q), joints.misalignment(body_q)
    if apart.max() > record.separation or askew.max() > record.misalignment:
        # In units of what is allowed, 0.1 mm and 1 mrad.
        record.joint = names[int(np.argmax(np.maximum(10.0 * apart, askew)))]
    record.separation = max(record.separation, float(apart.max()))
    record.misalignment = max(record.misalignment, float(askew.max()))
    record.limit = max(record.limit, float(joints.limit_violation(body_q).max()))


def falls(builder: newton.ModelBuilder) -> NDArray[np.bool_]:
    """Which bodies hang on a base that can fall, shape [bodies]."""
    free = np.zeros(builder.body_count, bool)
    for joint, (parent, child) in enumerate(
        zip(builder.joint_parent, builder.joint_child, strict=True)
    ):
        if builder.joint_articulation[joint] >= 0:
            free[child] = can_fall(builder, joint) if parent < 0 else free[parent]
    return free


def vertical_momentum(bodies: Bodies, chosen: NDArray[np.bool_], state: newton.State) -> float:
    """Momentum upwards of the chosen bodies [kg m/s]."""
    return float(bodies.mass[chosen] @ state.body_qd.numpy()[chosen, 2])


def support(
    model: newton.Model,
    falling: NDArray[np.bool_],
    contacts: newton.Contacts,
    observables: newton.solvers.SolverBase.Observables,
) -> float:
    """Vertical contact force of what does not fall on what does [N]."""
    count = min(int(contacts.rigid_contact_count.numpy()[0]), contacts.rigid_contact_max)
    body = np.append(model.shape_body.numpy(), -1)
    first = body[contacts.rigid_contact_shape0.numpy()[:count]]
    second = body[contacts.rigid_contact_shape1.numpy()[:count]]
    force = observables.contact_f.numpy()[:count, 2].astype(float)
    on = np.append(falling, False)
    return float(np.sum(force * (on[first].astype(int) - on[second].astype(int))))


def delays(builder: newton.ModelBuilder) -> Array:
    """Time by which a drive stays behind a steady motion [s], shape [dofs]; 0 without a drive."""
    stiffness, damping, passive = (
        np.array(values, float)
        for values in (builder.joint_target_ke, builder.joint_target_kd, builder.joint_damping)
    )
    return np.divide(
        damping + passive, stiffness, out=np.zeros_like(stiffness), where=stiffness > 0.0
    )


def by_name(
    builder: newton.ModelBuilder, driven: list[int], values: Array, factors: Array | None = None
) -> dict[str, float]:
    """Values of coordinates by joint and axis, for driven sliding and turning axes.

    Args:
        builder: The robot.
        driven: Degrees of freedom that are driven.
        values: Values, shape [coordinates].
        factors: What to multiply them with, shape [dofs]; None for nothing.
    """
    chosen, found = set(driven), {}
    for joint, kind in enumerate(builder.joint_type):
        if kind == newton.JointType.BALL:
            continue
        start = builder.joint_qd_start[joint]
        for i in range(sum(builder.joint_dof_dim[joint])):
            if start + i in chosen:
                factor = 1.0 if factors is None else factors[start + i]
                value = float(values[builder.joint_q_start[joint] + i] * factor)
                found[f"{builder.joint_label[joint]}:{i}"] = value
    return found
