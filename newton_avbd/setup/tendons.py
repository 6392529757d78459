# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The arrays of MuJoCo's tendons, and what they come to in the reference pose."""

from typing import Any

import newton
import numpy as np
import warp as wp

from .. import data
from ..model.actuators import reflected_armature
from ..model.inertia import mobility_along, reference_moments, reference_state, spring_state
from ..model.limits import impedance_rates
from ..model.tendons import force_ranges, is_limited, tendon_count
from ..model.topology import Topology, solved_joints
from ..rows.path import JOINT
from ..step import actuation as kernels
from .views import coordinates_of, indices, lists

KEPT = ("piece", "force", "held_at", "motion", "rate", "input", "push", "velocity", "coasting")
"""Arrays that a step leaves to the next one."""
_RAW = 1
"""Mode of ``mujoco:tendon_solref_limit_mode``: authored."""
_DEFAULT_REFERENCE = (0.02, 1.0)


class TendonArrays:
    """The :class:`.data.TendonModel` of a model.

    Args:
        model: The user's model.
        solved: The model as the solver solves it.
        topology: How joints link its bodies, and the tendons.
        wanted: Effects; ``compliance`` and ``second_order`` matter.
        pulling: Row of the tendon of each actuator that pulls one, by the actuator's row.
    """

    def __init__(
        self,
        model: newton.Model,
        solved: Any,
        topology: Topology,
        wanted: frozenset[str],
        pulling: dict[int, int],
    ) -> None:
        self._model, self._cords = model, topology.tendons
        mujoco: Any = model.mujoco
        work = self.arrays = data.TendonModel()
        rows = [cord.row for cord in self._cords]
        count = len(rows)
        work.row = indices(np.array(rows))
        work.world = indices(mujoco.tendon_world.numpy()[rows])
        pulled = [[row for row, cord in pulling.items() if cord == known] for known in rows]
        work.row_start, work.rows = lists(pulled)
        for name in ("stiffness", "damping", "springlength", "armature", "range", "margin"):
            setattr(work, name, getattr(mujoco, f"tendon_{name}"))
        reflected = reflected_armature(model, pulling, tendon_count(model))
        if np.any(reflected):
            data.fill(work, armature=mujoco.tendon_armature.numpy() + reflected)
        work.friction = mujoco.tendon_frictionloss
        work.limit_impedance = mujoco.tendon_solimp_limit
        work.ref = mujoco.dof_ref
        data.fill(work, is_limited=is_limited(model, self._cords))
        data.fill(work, force_range=force_ranges(model, self._cords))
        self._make_paths(solved, topology)
        data.allocate(work, count, "velocity", "start_velocity", "limit_velocity", "force")
        data.allocate(work, count, "start_length", "length", "held_at", "coasting")
        push = data.AxisPush()
        push.least, push.most = -np.inf, np.inf
        data.fill(work, push=[push] * count)
        data.allocate(work, count, "law", "pull", "piece")
        moving = count if "second_order" in wanted else 0
        data.allocate(work, moving, "motion", "rate", "input")
        data.allocate(work, int(topology.axis_start[-1]), "curvature")
        data.allocate(work, solved.body_count + 1, "root_curvature")
        self._measure_reference()
        if "compliance" in wanted:
            self._make_limits(rows)
        knows_rate = work.armature.numpy()[rows] > 0.0
        if "compliance" in wanted:
            knows_rate |= work.is_limited.numpy()
        self.is_measured = bool(any(pulled) or np.any(knows_rate))
        is_spatial = np.array([not cord.is_fixed for cord in self._cords])
        self.coasts = bool(np.any(knows_rate & is_spatial))

    def take_on(self, before: Any) -> None:
        """Goes on with what other arrays of as many tendons have kept."""
        for name in KEPT:
            old, new = getattr(before, name), getattr(self.arrays, name)
            if old is not None and old.size == new.size:
                setattr(self.arrays, name, old)

    def moments(self) -> np.ndarray:
        """How each length changes with each degree of freedom in the reference pose.

        Returns:
            Derivatives, shape (tendons, joint_dof_count) [m/m, m/rad, ...].
        """
        found = np.zeros((len(self._cords), self._model.joint_dof_count))
        starts = self._model.joint_qd_start.numpy()
        spatial = [i for i, cord in enumerate(self._cords) if not cord.is_fixed]
        for i, cord in enumerate(self._cords):
            for element in cord.path if cord.is_fixed else ():
                found[i, starts[element.index]] += element.value
        if spatial:
            found[spatial] = reference_moments(self._model, self._rates)[spatial]
            self.arrays.velocity.zero_()
        return found

    def inertia(self) -> np.ndarray | None:
        """What armature adds to the mass matrix in the reference pose.

        Returns:
            Shape (joint_dof_count, joint_dof_count); None where no tendon has armature.
        """
        armature = self.arrays.armature.numpy()[[cord.row for cord in self._cords]].astype(float)
        if not np.any(armature):
            return None
        moments = self.moments()
        return (moments.T * armature) @ moments

    def _rates(self, state: newton.State) -> np.ndarray:
        self._measure(state)
        return self.arrays.velocity.numpy().copy()

    def _make_paths(self, solved: Any, topology: Topology) -> None:
        """Lists the elements of paths, and what holds each."""
        model, work = self._model, self.arrays
        path = [element for cord in self._cords for element in cord.path]
        work.start = indices(np.cumsum([0, *(len(cord.path) for cord in self._cords)]))
        work.kind = indices(np.array([element.kind for element in path]))
        data.fill(work, value=[element.value for element in path])
        index = np.array([element.index for element in path])
        is_joint = work.kind.numpy() == int(JOINT)
        is_shape = ~is_joint & (index >= 0)
        dof, axis = np.zeros(len(path), dtype=int), np.zeros(len(path), dtype=int)
        link, body = np.full(len(path), -1), np.full(len(path), -1)
        frames = np.tile(np.array([0, 0, 0, 0, 0, 0, 1.0], dtype=np.float32), (2, len(path), 1))
        if np.any(is_joint):
            number = np.array(solved_joints(solved))
            body_of = {int(joint): body for body, joint in enumerate(topology.joint)}
            dof[is_joint] = model.joint_qd_start.numpy()[index[is_joint]]
            body[is_joint] = [body_of[joint] for joint in number[index[is_joint]].tolist()]
            axis[is_joint] = topology.axis_start[body[is_joint]]
        if np.any(is_shape):
            shape = index[is_shape]
            link[is_shape] = model.shape_body.numpy()[shape]
            owner = solved.shape_body.numpy()[shape]
            body[is_shape] = np.where(owner < 0, solved.body_count, owner)
            frames[:, is_shape] = model.shape_transform.numpy()[shape]
            if hasattr(solved, "shape_frame"):
                inner = zip(solved.shape_frame.numpy()[shape], frames[0, is_shape], strict=True)
                frames[1, is_shape] = [
                    np.array(wp.transform(*outer) * wp.transform(*own)) for outer, own in inner
                ]
        work.dof, work.axis = indices(dof), indices(axis)
        work.coordinate = indices(coordinates_of(model, dof) if np.any(is_joint) else dof)
        work.link, work.body = indices(link), indices(body)
        work.link_frame, work.frame = (wp.array(each, dtype=wp.transform) for each in frames)
        # one more, so that a geom at the end of all may look for a side site
        data.allocate(work, len(path) + 1, "apart", "begun", "point", "rotation")
        data.allocate(work, len(path), "outside", "way", "spans")
        data.allocate(work, len(self._cords), "span_end")

    def _measure_reference(self) -> None:
        """Lengths in the reference pose, and where the springs of joints are at rest."""
        for name, state in (
            ("spring_rest", spring_state(self._model)),
            ("rest", reference_state(self._model)),
        ):
            self._measure(state, state.joint_q, state.joint_qd)
            lengths = self.arrays.length.numpy().astype(np.float32)
            data.fill(self.arrays, **{name: lengths})
        self.arrays.velocity.zero_()

    def _measure(self, state: newton.State, *coordinates: wp.array) -> None:
        """Measures lengths in a state, those of fixed tendons if joint_q and joint_qd are given."""
        known = coordinates or (wp.empty(0, dtype=float),) * 2
        wp.launch(
            kernels.measure_tendons,
            dim=len(self._cords),
            inputs=[self._model.body_com, state.body_q, state.body_qd, *known, self.arrays],
        )

    def _make_limits(self, rows: list[int]) -> None:
        """What MuJoCo's law of compliant limits takes."""
        mujoco: Any = self._model.mujoco
        reference = mujoco.tendon_solref_limit.numpy()[rows].astype(float)
        reference[mujoco.tendon_solref_limit_mode.numpy()[rows] != _RAW] = _DEFAULT_REFERENCE
        rates = impedance_rates(reference, mujoco.tendon_solimp_limit.numpy()[rows])
        data.fill(self.arrays, limit_rates=rates)
        mobility = mobility_along(self._model, self.moments(), self.inertia())[0]
        data.fill(self.arrays, limit_mobility=np.maximum(mobility, 1.0e-15))
