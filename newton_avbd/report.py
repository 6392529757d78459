# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What the last step cost each world and how far it got, and what happened since a reset."""

from dataclasses import dataclass

import numpy as np

_SHOWN = 20
"""Worlds that the table lists."""


CAUSES_OF_ERROR = (
    "smooth motion",
    "a step of first order",
    "a velocity that jumps",
    "sweeps that did not settle",
)
"""What led a body astray, as :mod:`.step.local_error` counts it."""


@dataclass(frozen=True)
class InnerReport:
    """How accurate the last call of a solver with ``accuracy`` was, by its estimate.

    All arrays and lists have an entry for each world, shape (world_count,), as those of
    :class:`Report`. Lengths and velocities are float32, counts int32.
    """

    asked: float
    """The solver's ``accuracy`` [m/s]."""
    estimated: np.ndarray
    """Local errors of the call, of the body that was off most in each inner step, by time [m/s].
    Above ``asked`` it is also where a call may spend what earlier ones have left over."""
    steps: np.ndarray
    """Inner steps that the world took; those that were repeated are not among them."""
    rejected: np.ndarray
    """Inner steps that were not accurate enough, so that the world repeated them shorter."""
    worst: list[str]
    """Label of the body that was off most, compared with what was allowed; empty where nothing
    moved."""
    why: list[str]
    """What led it astray, ``"smooth motion"``, ``"a step of first order"``, ``"a velocity that
    jumps"`` or ``"sweeps that did not settle"``."""
    total: np.ndarray
    """Sum of all estimated errors since the last reset [m]."""
    missed: np.ndarray
    """Calls since the last reset for which ``inner_steps`` did not do."""

    def __str__(self) -> str:
        count = self.steps.size
        # those that miss most, then those that cost most
        listed = np.lexsort((np.arange(count), -self.steps, -self.missed))[:_SHOWN]
        lines = [
            f"asked: {self.asked:.1e} m/s; {int(np.sum(self.missed > 0))} of {count} worlds missed "
            "it in some call",
            f"{'world':>6} {'estimated [m/s]':>15} {'steps':>5} {'repeated':>8} {'missed':>6} "
            " most",
        ]
        for world in listed:
            most = f"{self.worst[world]!r}, {self.why[world]}" if self.worst[world] else ""
            lines.append(
                f"{world:6d} {self.estimated[world]:15.1e} {self.steps[world]:5d} "
                f"{self.rejected[world]:8d} {self.missed[world]:6d}  {most}"
            )
        return "\n".join(lines)


@dataclass(frozen=True)
class Report:
    """Sweeps and residual of each world in the last step; printed, a table.

    All arrays have shape (world_count,), or (1,) where all bodies are solved as one world: then
    world 0 is all of them. They are copies on the host; lengths are float32, counts int32.
    :attr:`SolverAVBD.status` has the same sweeps and updates.
    """

    sweeps: np.ndarray
    """Sweeps that the world took, or accelerations in a step of fourth order; 0 where nothing
    touched and no joint held."""
    update: np.ndarray
    """How far the last sweep still moved a body [m]; rotations by the radius of gyration."""
    allowed: np.ndarray
    """The ``update`` [m] at which the world's sweeps end, ``tolerance`` or where nothing moves any
    more."""
    order: np.ndarray
    """Order of the step in time, 4 or 2 where a scheme of that order could be kept, otherwise 1; at
    rest there is no difference."""
    worst: dict[int, str]
    """For the index of each world that has not settled and has contacts, the two shapes of the
    contact with the largest error, and that error [m], in words."""
    inner: InnerReport | None
    """How accurate the last call was, where an ``accuracy`` was asked for. What is said of sweeps
    and of the order is then that of the last inner step."""

    @property
    def settled(self) -> np.ndarray:
        """Whether each world's sweeps ended because no body moved any more than allowed, shape
        (world_count,), bool."""
        return self.update <= self.allowed

    def __str__(self) -> str:
        count = self.sweeps.size
        # the worlds that cost or lack most come first
        listed = np.lexsort((np.arange(count), -self.update, -self.sweeps))[:_SHOWN]
        lines = [
            f"{count} worlds, {int(np.sum(self.settled))} settled, "
            f"{int(np.sum(self.sweeps))} sweeps",
            f"{'world':>6} {'sweeps':>6} {'update [m]':>10} {'allowed [m]':>11} {'order':>5}",
        ]
        for world in listed:
            mark = "" if self.settled[world] else "  not settled"
            if world in self.worst:
                mark += f": {self.worst[world]}"
            lines.append(
                f"{world:6d} {self.sweeps[world]:6d} {self.update[world]:10.1e} "
                f"{self.allowed[world]:11.1e} {self.order[world]:5d}{mark}"
            )
        if count > _SHOWN:
            rest = np.setdiff1d(np.arange(count), listed)
            lines.append(f"{rest.size} more, at most {int(self.sweeps[rest].max())} sweeps each")
        if self.inner is not None:
            lines.append(str(self.inner))
        return "\n".join(lines)


def missed(rows: np.ndarray, increment: np.ndarray, com: np.ndarray) -> np.ndarray:
    """How far contacts are from what they ask for at the end of a step [m].

    That is no more overlap, and no gap where they push and there was no overlap to recover.

    Args:
        rows: Rows of the contacts, as :class:`~newton_avbd.data.ContactRow`, shape [rows].
        increment: How bodies moved in the step, dx [m] and dtheta [rad], shape [slots, 6].
        com: Their centers of mass at its start [m], shape [slots, 3].
    """
    a, b, normal = rows["a"], rows["b"], rows["normal"]
    shift, turn = increment[b, :3] - increment[a, :3], increment[b, 3:] - increment[a, 3:]
    slip = shift + np.cross(increment[b, 3:], com[a] - com[b]) + np.cross(turn, rows["arm"])
    gap = np.maximum(rows["gap"], 0.0) + np.sum(normal * slip, axis=1)
    pushes = (np.sum(normal * rows["force"], axis=1) > 0.0) & (rows["gap"] >= 0.0)
    return np.where(pushes, np.abs(gap), np.maximum(-gap, 0.0))


@dataclass(frozen=True)
class Status:
    """What happened in a solver since its construction or the last reset; read on request.

    Arrays by world have shape (world_count,), or (1,) where all bodies are solved as one world.
    All are copies on the host: counts are int32, :attr:`update` and :attr:`bounded_energy` float32.
    """

    held_steps: np.ndarray
    """How often a world, or a body that touches nothing, was frozen because its state, or what acts
    on it, was not finite; by Newton world, where worlds are solved apart."""
    repaired_poses: np.ndarray
    """How often a body came with a quaternion that was not of unit length, and was normalised; by
    world as above."""
    sweeps: np.ndarray
    """Sweeps of the last step with contacts, by world as above."""
    update: np.ndarray
    """How far the last of these still moved a body [m]; rotations by the radius of gyration."""
    bounded_steps: np.ndarray
    """How often the energy of an island was bounded after a step that did not settle, because it
    had more than before the step and was given in it; by world as above."""
    bounded_energy: np.ndarray
    """Energy that this took away [J], by world as above."""
    unbounded_steps: np.ndarray
    """How often that was left alone because a joint or a tendon links the island to something that
    the user moves. What that gives is not known; by world as above."""
    broken_joints: np.ndarray
    """Indices of the model's joints that broke, shape (count,), int64."""
    sleeping_bodies: int
    """Bodies that sleep."""
    missed_accuracy: np.ndarray
    """Calls for which ``inner_steps`` did not do to be as accurate as asked; by world as above."""
    contact_overflow: int
    """Most contacts by which a buffer overflowed [contacts]; those were not simulated."""
    colors: int
    """Colors of the blocks in the last step, where they are solved color by color; else 0."""
    clashes: int
    """Blocks that found no color in it, and so moved one after the other."""
    dropped_contacts: int
    """Contacts of all steps that were left out because they made no sense (numbers that are not
    finite, shapes that do not exist, or bodies of different worlds)."""
