# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Whether drives push as their law says, judged by Newton's second law.

Two simulators of one robot need not make the same motion of it: it falls over earlier in one of
them, or a foot sticks that slips in the other. The force along an axis is known all the same: it is
what the links beyond the axis gain in momentum, less gravity and contact forces. It has to be the
force of the drive's law at the coordinate and speed that the robot has at the end of the step, as
by backward Euler, or between that and the force at its start, whose mean a scheme of second order
gives.
"""

from typing import NamedTuple

import newton
import numpy as np
from numpy.typing import NDArray

from newton_avbd.measure.state import Array, Bodies, spin_momenta
from newton_avbd.model.rotations import transform
from newton_avbd.setup.views import coordinates_of

AT_LIMIT = 1.0e-3
"""Distance from a limit within which the limit may push [rad or m]."""

LEAST = 1.0e-12
"""Force that stands for none where it is divided by [N or N m]."""

LAW = (
    "target_ke",
    "target_kd",
    "effort_limit",
    "damping",
    "stiffness",
    "armature",
    "friction",
    "limit_lower",
    "limit_upper",
    "velocity_limit",
)
"""What of an axis the law of its drive reads."""

BRAKED = 0.99
"""Share of an axis's velocity limit from which on its brake may push."""


class Start(NamedTuple):
    """What a robot is like before a step.

    Attributes:
        momenta: Linear and angular momentum of each body, shape [bodies, 6].
        centers: Centers of mass [m], shape [bodies, 3].
    """

    momenta: Array
    centers: Array


class Torques:
    """Sums, over the steps of a run, what the axes of a robot push and by how much that is wrong.

    Attributes:
        told: Whether the forces along the axes are told: not where joints close loops.
        pushed: Sum of the absolute forces [N or N m], shape [dofs].
        wrong: Sum of what is not the law's, without what friction, limits and brakes may push,
            shape [dofs].
    """

    def __init__(self, model: newton.Model, dt: float):
        self._model, self._dt, self._bodies = model, dt, Bodies.of(model)
        self.told = bool(np.all(model.joint_articulation.numpy() >= 0))
        self.pushed = np.zeros(model.joint_dof_count)
        self.wrong = np.zeros(model.joint_dof_count)
        self._speed = np.zeros(model.joint_dof_count)
        self._last: Array | None = None
        self._mimics = _mimics(model)
        self._coordinate = coordinates_of(model, np.arange(model.joint_dof_count))
        # Solvers need not keep the joint coordinates of their states, which Jacobians read.
        self._at = model.state()
        self._law = {name: getattr(model, f"joint_{name}").numpy().astype(float) for name in LAW}
        self._rest = model.joint_rest_q.numpy().astype(float)[self._coordinate]

    def start(self, state: newton.State) -> Start:
        """What :meth:`add` has to know of the state before a step."""
        centers = transform(state.body_q.numpy().astype(float), self._bodies.com)
        return Start(self._momenta(state), centers)

    def _momenta(self, state: newton.State) -> Array:
        """Linear and angular momentum of each body, shape [bodies, 6]."""
        body_q, body_qd = state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
        spin = spin_momenta(self._bodies, body_q, body_qd)
        return np.hstack([self._bodies.mass[:, None] * body_qd[:, :3], spin])

    def add(
        self,
        start: Start,
        state: newton.State,
        targets: Array,
        contacts: newton.Contacts,
        observables: newton.solvers.SolverBase.Observables,
    ) -> None:
        """Take a step in.

        Args:
            start: Of the state before the step.
            state: The state after it.
            targets: What the drives were to reach, shape [coordinates].
            contacts: Contacts of the step.
            observables: Their forces.
        """
        model = self._model
        wrench = (self._momenta(state) - start.momenta) / self._dt
        wrench[:, :3] -= self._bodies.mass[:, None] * self._bodies.gravity
        wrench -= self._pushes(start.centers, contacts, observables)
        self._at.body_q.assign(state.body_q)
        newton.eval_ik(model, state, self._at.joint_q, self._at.joint_qd)
        at = self._at.joint_q.numpy().astype(float)[self._coordinate]
        speed = self._at.joint_qd.numpy().astype(float)
        law, target = self._law, targets[self._coordinate]
        told = self._along_axes(wrench)
        rotors = law["armature"] * (speed - self._speed) / self._dt
        last = at if self._last is None else self._last
        end, begin = (
            self._through_mimics(told + rotors - self._force(target, *motion))
            for motion in ((at, speed), (last, self._speed))
        )
        self._last, self._speed = at, speed
        error = np.where(begin * end < 0.0, 0.0, np.where(np.abs(begin) < np.abs(end), begin, end))
        error = np.sign(error) * np.maximum(np.abs(error) - law["friction"], 0.0)
        # A limit pushes away from itself only; limits and brakes of an axis that mimics push its
        # leader, too.
        braked = np.abs(speed) >= BRAKED * law["velocity_limit"]
        low, high = at < law["limit_lower"] + AT_LIMIT, at > law["limit_upper"] - AT_LIMIT
        for leading, following, share in self._mimics:
            up, down = (low, high) if share > 0.0 else (high, low)
            low[leading] |= up[following]
            high[leading] |= down[following]
            braked[leading] |= braked[following]
        error = np.where(low, np.minimum(error, 0.0), error)
        error = np.where(high, np.maximum(error, 0.0), error)
        self.wrong += np.where(braked, 0.0, np.abs(error))
        self.pushed += np.abs(self._through_mimics(told))

    def _force(self, target: Array, at: Array, speed: Array) -> Array:
        """Force of the law along each axis [N or N m], but for rotors and friction."""
        law = self._law
        drive = law["target_ke"] * (target - at) - law["target_kd"] * speed
        force = np.clip(drive, -law["effort_limit"], law["effort_limit"])
        return force - law["damping"] * speed - law["stiffness"] * (at - self._rest)

    def shares(self, builder: newton.ModelBuilder, driven: list[int]) -> dict[str, float]:
        """Share of the force along each driven axis that is not its law's, by joint and axis."""
        found = {}
        for dof in driven:
            joint = int(np.searchsorted(builder.joint_qd_start, dof, side="right")) - 1
            name = f"{builder.joint_label[joint]}:{dof - builder.joint_qd_start[joint]}"
            found[name] = float(self.wrong[dof] / max(self.pushed[dof], LEAST))
        return found

    def _pushes(
        self,
        center: Array,
        contacts: newton.Contacts,
        observables: newton.solvers.SolverBase.Observables,
    ) -> Array:
        """Contact wrench on each body about its center of mass, shape [bodies, 6].

        A contact acts where it was at the start of the step, so the two centers of mass that its
        force has lever arms to are those at the start, too.

        Args:
            center: Centers of mass at the start of the step [m], shape [bodies, 3].
            contacts: Contacts of the step.
            observables: Their forces.
        """
        count = min(int(contacts.rigid_contact_count.numpy()[0]), contacts.rigid_contact_max)
        body = np.append(self._model.shape_body.numpy(), -1)
        first = body[contacts.rigid_contact_shape0.numpy()[:count]]
        second = body[contacts.rigid_contact_shape1.numpy()[:count]]
        wrench = observables.contact_f.numpy()[:count].astype(float)
        # Row -1 is the world.
        center = np.vstack([center, np.zeros(3)])
        total = np.zeros((self._model.body_count + 1, 6))
        np.add.at(total, first, wrench)
        moved = np.cross(center[first] - center[second], wrench[:, :3])
        np.add.at(total, second, -wrench - np.hstack([np.zeros_like(moved), moved]))
        return total[:-1]

    def _along_axes(self, wrench: Array) -> Array:
        """Generalized forces of wrenches on bodies, shape [dofs]."""
        model = self._model
        found = np.zeros(model.joint_dof_count)
        jacobians = newton.eval_jacobian(model, self._at)
        if jacobians is None:
            return found
        gathered = jacobians.numpy().astype(float)
        child, dofs = model.joint_child.numpy(), model.joint_qd_start.numpy()
        for row, (start, end) in enumerate(
            zip(model.articulation_start.numpy(), model.articulation_end.numpy(), strict=False)
        ):
            count = dofs[end] - dofs[start]
            motion = gathered[row, : 6 * (end - start), :count]
            found[dofs[start] : dofs[end]] = motion.T @ wrench[child[start:end]].ravel()
        return found

    def _through_mimics(self, force: Array) -> Array:
        """Forces with those of axes that mimic others added to what leads them."""
        summed = force.copy()
        for leading, following, share in self._mimics:
            summed[leading] += share * force[following]
        return summed


def _mimics(model: newton.Model) -> list[tuple[NDArray[np.int64], NDArray[np.int64], float]]:
    """Axes that lead, those of a joint that mimics them, and its factor, followed to the root."""
    leader = model.joint_mimic_joint.numpy()
    factor, start = model.joint_mimic_coeffs.numpy(), model.joint_qd_start.numpy()
    found = []
    for joint in np.flatnonzero(leader >= 0):
        axes = np.arange(start[joint], start[joint + 1])
        at, share = int(leader[joint]), float(factor[joint, 1])
        while leader[at] >= 0:
            at, share = int(leader[at]), share * float(factor[at, 1])
        found.append((start[at] + axes - start[joint], axes, share))
    return found
