# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What Newton's coupled solvers ask beside a step: how heavy bodies feel, and what pushed them.

A coupler gives each of its solvers a share of the model, and some of them *proxies*: bodies that
another solver moves, which push here and are pushed. What pushed them goes back as forces.
"""

import newton
import numpy as np
import warp as wp
from newton import ModelFlags
from newton.solvers.experimental.coupled import CouplingInterface

from .model.inertia import inertia_root
from .model.rotations import rotation_matrix
from .step.proxies import harvest_momentum

_HELD = 1.0e-4
"""Joints that leave a body less than this share of its own mobility hold it."""


class RigidCoupling(CouplingInterface):
    """Coupling hooks of a solver of rigid bodies that conserves angular momentum.

    Those that are not here are Newton's own: forces on proxies act as ``body_f``, and contacts
    between proxies, or of a proxy with what does not move, are left out.
    """

    model: newton.Model

    def coupling_effective_mass_refresh_flags(self) -> int:
        """What of a model :meth:`coupling_eval_effective_mass_block` depends on.

        Returns:
            Bits of :class:`newton.ModelFlags`.
        """
        return int(
            ModelFlags.BODY_PROPERTIES
            | ModelFlags.BODY_INERTIAL_PROPERTIES
            | ModelFlags.JOINT_PROPERTIES
            | ModelFlags.JOINT_DOF_PROPERTIES
            | ModelFlags.JOINT_DOF_INERTIAL_PROPERTIES
        )

    def coupling_eval_effective_mass(
        self,
        endpoint_kind: wp.array,
        endpoint_index: wp.array,
        endpoint_local_pos: wp.array,
        out: wp.array,
    ) -> None:
        """As :meth:`coupling_eval_effective_mass_block`, masses only.

        Args:
            endpoint_kind: Kinds of the endpoints, shape (endpoint_count,), int32.
            endpoint_index: Body or particle of each endpoint, same shape, int32.
            endpoint_local_pos: Offsets of the endpoints from the COM, body frame [m], same shape,
                vec3.
            out: Receives the effective masses [kg], same shape, float32.
        """
        self.coupling_eval_effective_mass_block(
            endpoint_kind, endpoint_index, endpoint_local_pos, out
        )

    def coupling_eval_effective_mass_block(
        self,
        endpoint_kind: wp.array,
        endpoint_index: wp.array,
        endpoint_local_pos: wp.array,
        out_mass: wp.array,
        out_inertia: wp.array | None = None,
    ) -> None:
        """How heavy points of bodies are to a push, with what hangs on their joints.

        A jointed body has the mass and the inertia of the directions in which it gives way most,
        so that a proxy is nowhere more than twice as heavy as what it stands for: forces that come
        back a step late swing up under a heavy load from four times the true mass on
        (``docs/coupling.md``). At the model's poses, without drives, limits, contacts and joints
        that close loops; a body that its joints hold counts with its own mass. Copies model arrays
        to the host.

        Args:
            endpoint_kind: Kinds of the endpoints, shape (endpoint_count,), int32.
            endpoint_index: Body or particle of each endpoint, same shape, int32.
            endpoint_local_pos: Offsets of the endpoints from the COM, body frame [m], same shape,
                vec3.
            out_mass: Receives the effective masses [kg], same shape, float32.
            out_inertia: Receives the effective inertias about the COM, body frame [kg m^2], same
                shape, mat33; None for masses only.
        """
        super().coupling_eval_effective_mass(
            endpoint_kind, endpoint_index, endpoint_local_pos, out_mass
        )
        known = body_mobility(self.model)
        mass, offset = out_mass.numpy().copy(), endpoint_local_pos.numpy().astype(float)
        inertia = np.zeros((mass.size, 3, 3), dtype=np.float32)
        bodies, own = endpoint_index.numpy(), self.model.body_inertia.numpy()
        for i in np.flatnonzero(endpoint_kind.numpy() == int(self.EndpointKind.BODY)):
            inertia[i] = own[bodies[i]]
            if bodies[i] not in known:
                continue
            rotation, mobility = known[bodies[i]]
            arm = np.hstack([np.eye(3), -_cross(rotation @ offset[i])])
            gives = np.linalg.eigvalsh(arm @ mobility @ arm.T)[-1]
            if gives * mass[i] > _HELD:
                mass[i] = 1.0 / gives
            turn = rotation @ inertia_root(inertia[i])
            gives = np.linalg.eigvalsh(turn.T @ mobility[3:, 3:] @ turn)[-1]
            if gives > _HELD:
                inertia[i] *= max(1.0 / gives, 1.0)
        out_mass.assign(mass)
        if out_inertia is not None:
            out_inertia.assign(inertia)

    def coupling_harvest_proxy_wrenches(
        self,
        body_local_to_proxy_global: wp.array,
        out_body_f: wp.array,
        *,
        body_qd_before: wp.array,
        state: newton.State,
        state_out: newton.State,
        contacts: newton.Contacts | None,
        dt: float,
    ) -> None:
        """Add what changed the momentum of each proxy, as a force that acted over the step.

        The change of the angular momentum, not of the angular velocity as in Newton's own hook: a
        body that turns freely is pushed by nothing, though its angular velocity changes.

        Args:
            body_local_to_proxy_global: Where each body's force goes, -1 for no proxy, shape
                (body_count,), int32.
            out_body_f: The forces [N] and torques about the COM [N m] are added to it, by where
                they go, spatial_vector.
            body_qd_before: Velocities of the bodies before the step [m/s, rad/s], shape
                (body_count,), spatial_vector.
            state: State that the step started from.
            state_out: State that it ended in.
            contacts: Not used.
            dt: Length of the step [s].
        """
        del contacts
        wp.launch(
            harvest_momentum,
            body_local_to_proxy_global.shape[0],
            inputs=[
                self.model.body_mass,
                self.model.body_inertia,
                body_local_to_proxy_global,
                state.body_q,
                body_qd_before,
                state_out.body_q,
                state_out.body_qd,
                dt,
            ],
            outputs=[out_body_f],
            device=self.model.device,
        )


def body_mobility(model: newton.Model) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """How the bodies of articulations answer a wrench at their COM, at the model's poses.

    Args:
        model: The model; its arrays are copied to the host.

    Returns:
        A pair for the index of each body that moves. The first is the rotation from the body's
        frame to the world's, shape (3, 3), the second the acceleration by a unit wrench, world
        axes, shape (6, 6), linear before angular [1/kg, 1/(kg m), 1/(kg m^2)]. Empty for a model
        without articulations.
    """
    state = model.state()
    jacobians = newton.eval_jacobian(model, state)
    if jacobians is None:
        return {}
    pose, mass = state.body_q.numpy().astype(float), model.body_mass.numpy()
    inertia, armature = model.body_inertia.numpy(), model.joint_armature.numpy()
    moves = (model.body_inv_mass.numpy() > 0.0) & (
        model.body_flags.numpy() & int(newton.BodyFlags.KINEMATIC) == 0
    )
    child, dofs = model.joint_child.numpy(), model.joint_qd_start.numpy()
    known = {}
    for jacobian, start, end in zip(
        jacobians.numpy().astype(float),
        model.articulation_start.numpy(),
        model.articulation_end.numpy(),
        strict=False,
    ):
        links = child[start:end]
        free = np.repeat(moves[links], np.diff(dofs[start : end + 1]))
        motion = jacobian[: 6 * links.size, : free.size][:, free]
        # rows of sqrt(M) J, so that the mass matrix of the joints is their Gram matrix
        weighted = [np.diag(np.sqrt(armature[dofs[start] : dofs[end]][free]))]
        rotations = [rotation_matrix(pose[link, 3:]) for link in links]
        for link, rotation in enumerate(rotations):
            if moves[links[link]]:
                rows = motion[6 * link : 6 * link + 6]
                root = rotation @ inertia_root(inertia[links[link]])
                weighted += [np.sqrt(mass[links[link]]) * rows[:3], root.T @ rows[3:]]
        response = motion @ np.linalg.pinv(np.vstack(weighted))
        for link, rotation in enumerate(rotations):
            if moves[links[link]]:
                rows = response[6 * link : 6 * link + 6]
                known[int(links[link])] = (rotation, rows @ rows.T)
    return known


def _cross(r: np.ndarray) -> np.ndarray:
    """Matrix of the cross product with ``r``."""
    return np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
