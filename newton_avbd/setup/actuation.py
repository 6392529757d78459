# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The arrays of MuJoCo's actuators and of gravity compensation, and what is launched for them."""

from collections.abc import Iterator
from typing import Any

import newton
import numpy as np
import warp as wp

from .. import data
from ..drivers.launch import Launcher
from ..model.actuators import (
    Actuators,
    compensating_axes,
    has_damping_ratio,
    is_limited,
    passed_limits,
)
from ..model.inertia import mobility_along, reference_mobility, reference_moments
from ..model.topology import Topology
from ..rows import actuator as rules
from ..rows.motor import MOTOR
from ..rows.path import JOINT
from ..step import actuation as kernels
from ..step import adhesion
from ..step import body_actuators as pushes
from ..step.actuator_force import clear_force
from .tendons import KEPT, TendonArrays
from .transmission import Coasting, Transmission
from .views import AllJoints, coordinates_of, indices, lists

_COMPENSATING = frozenset({"actuators", "gravity_compensation"})
"""Effects by which actuators compensate gravity."""
_LIMITS = ("lower", "upper")
_SAME = (
    *("dynprm", "gainprm", "biasprm", "gear", "ctrlrange", "forcerange", "actrange"),
    *("actearly", "damping", "dampingpoly"),
)
"""Attributes of actuators that kernels read as they are."""


class Actuation:
    """The arrays by which actuators and gravity compensation act, and what a step launches."""

    def __init__(
        self,
        model: newton.Model,
        solved: Any,
        topology: Topology,
        joints: Any,
        wanted: frozenset[str],
        activation: wp.array,
        before: "Actuation | None" = None,
    ) -> None:
        """Makes the arrays.

        Args:
            model: The user's model.
            solved: The model as the solver solves it.
            topology: How joints link its bodies.
            joints: The joints as kernels see them.
            wanted: Which of the effects :data:`ACTING` there are, and of ``effort_limits``,
                ``force_ranges``, ``compliance`` and ``second_order``.
            activation: Activations of all actuators, the solver's.
            before: What there was before the model changed, whose motors and tendons go on.

        Raises:
            ValueError: If a muscle has no length range, or a damping ratio or the peak force of a
                muscle goes by an inertia that is not known.
        """
        self._model, self._joints = model, joints
        self._has_limits = "effort_limits" in wanted
        found = Actuators.of_model(model)
        axes = found.axes if "actuators" in wanted else {}
        drives = self._drives = found.drives if "actuators" in wanted else []
        items = [(dof, row, int(rules.BY_CONTROL)) for row, dof in axes.items()]
        items += [(drive.dof, drive.row, drive.kind) for drive in drives]
        bodies = found.bodies if "body_actuators" in wanted else {}
        cords = topology.tendons
        pulling = found.tendons if cords else {}
        adhesive = found.adhesive if "adhesion" in wanted else {}
        has_control = {*axes, *bodies, *pulling, *adhesive}
        self.rows = sorted(has_control | {drive.row for drive in drives if drive.row >= 0})
        self.control_count = len(found.labels) if has_control else 0
        with wp.ScopedDevice(model.device):
            self.law = data.ActuatorModel()
            self.tendons = data.TendonModel()
            self.beside_tendons = wp.zeros(len(cords), dtype=wp.vec2)
            self.tendon_inertia = None
            if cords:
                self._cords = TendonArrays(model, solved, topology, wanted, pulling)
                self.tendons = self._cords.arrays
                self.tendon_inertia = self._cords.inertia()
                if before is not None and before.tendons.row is not None:
                    self._cords.take_on(before.tendons)
            if self.rows:
                self._make_law(found)
                self.law.activation = activation
                if before is not None and before.law.motor is not None:
                    if before.law.motor.size == self.law.motor.size:
                        self.law.motor = before.law.motor
            carried = compensating_axes(model) if _COMPENSATING <= wanted else {}
            self.compensates = frozenset(carried if self._has_limits else ())
            bounds = self._has_limits and "actuators" in wanted and bool(bodies or pulling)
            passed = passed_limits(model) if bounds else []
            carried |= {dof: [] for dof in passed if dof not in carried}
            self._make_axes(items, carried)
            acts = bool(axes or drives)
            armature = found.armature(model) if acts else np.zeros(model.joint_dof_count)
            self._make_reading(armature, [drive.dof for drive in drives])
            count = self.axes.rows.size if "force_ranges" in wanted else 0
            self.ranged = wp.zeros(count, dtype=data.ActuatorLaw)
            self._keeps_pushes = "second_order" in wanted or self.ranged.size > 0
            if before is not None and before.pushes.size == self.pushes.size > 0:
                self._keep_ranged(before)
            servos = found.servos(model) if "servos" in wanted else {}
            self._make_bodies(bodies, servos, solved, wanted)
            if before is not None and before._keeps_servos and self._keeps_servos:
                if before.servos.input.size == self.servos.input.size:
                    self.servos.input = before.servos.input
                    self.servos.slopes = before.servos.slopes
            self.axes.transmitted = wp.zeros(model.joint_dof_count if passed else 0, dtype=float)
            self._transmission = Transmission(model, self) if passed else None
            if self.rows:
                self._weigh(found, list(bodies))
            self._compensation = wp.empty(0, dtype=float)
            if "gravity_compensation" in wanted:
                self._compensation = model.mujoco.gravcomp
            self._adhesion = data.Adhesion()
            if adhesive:
                self._adhesion.row = indices(np.array(list(adhesive)))
                self._adhesion.link = indices(np.array(list(adhesive.values())))
                self._adhesion.force = wp.zeros(len(adhesive), dtype=float)
            # servos are part of the drag of their bodies
            self._pushes_bodies = bodies.keys() != servos.keys()
            self.pushes_links = self._pushes_bodies or bool(adhesive)
            self.pushes_links |= "gravity_compensation" in wanted
            self._pushed = wp.zeros(
                model.body_count if self.pushes_links else 0, dtype=wp.spatial_vector
            )

    def launch(
        self,
        launch: Launcher,
        state: Any,
        ctrl: wp.array | None,
        control: data.ControlInput,
        contacts: Any,
        dt: float,
    ) -> wp.array:
        """What actuators push axes and links with in a step; returns the wrenches on links.

        Args:
            launch: Launches kernels.
            state: State at the start of the step.
            ctrl: Controls of actuators; None without any.
            control: Has the targets of drives, and gets what pushes axes.
            contacts: The contacts that adhesion sees, a :class:`.data.ContactInput`; None for none.
            dt: Time step [s].
        """
        model = self._model
        if self._is_measured:
            self._all_joints.measure(launch, state, self._joint_q, self._joint_qd)
        if self._measures_tendons:
            motion = [state.body_q, state.body_qd, self._joint_q, self._joint_qd]
            count = self.tendons.row.size
            launch(kernels.measure_tendons, count, [model.body_com, *motion, self.tendons])
            if self._coasting is not None:
                self._coasting.measure(launch, state, self._joint_q, self._joint_qd)
            launch(
                kernels.pull_tendons, count, [self.law, ctrl, dt, self.tendons, self.beside_tendons]
            )
        if self.bodies.row is not None:
            count, motion = self.bodies.row.size, [state.body_q, state.body_qd]
            given = [self.law, model.body_com, *motion, ctrl, dt, self.bodies]
            launch(pushes.find_pushes, count, given)
        if self._pushes_bodies:
            bodies = [model.body_com, model.body_inv_mass, model.body_inv_inertia, state.body_q]
            items = [self.link_start, self.items]
            launch(pushes.push_bodies, count, [*bodies, dt, *items, self.bodies])
        wrench = self._push_links(launch, state, ctrl, contacts, dt)
        if self._transmission is not None:
            if self.servos.start is not None:
                launch(pushes.begin_servos, self.bodies.row.size, [self.bodies])
            launch(clear_force, self.axes.transmitted.size, [self.axes.transmitted])
            self._transmission.add(launch, state.body_q, self._joint_q, self.axes.transmitted)
        if self._carried is not None:
            found = [self.axes.dof, *self._carried, self._compensated]
            compensate_axes(launch, model, state, self._joint_q, found)
        if self.axes.dof.size:
            launch(
                kernels.push_axes,
                max(self.axes.dof.size, self.axes.mode.size, self.axes.armature.size),
                [
                    self.law,
                    self._joints,
                    model.mujoco.dof_ref,
                    *(self.axes, self._joint_q, self._joint_qd, ctrl, self._has_limits, dt),
                    *(self._compensated, control, self.beside),
                ],
            )
        return wrench

    def _push_links(
        self, launch: Launcher, state: Any, ctrl: wp.array | None, contacts: Any, dt: float
    ) -> wp.array:
        """Wrenches on links, with those of actuators and of what compensates their weight."""
        model = self._model
        if not self.pushes_links:
            return state.body_f
        launch(
            kernels.push_links,
            model.body_count,
            [
                *(model.body_com, model.body_mass, model.body_world, model.gravity),
                *(self._compensation, state.body_q, state.body_f),
                *(self.bodies, self.link_start, self.items, self._pushed),
            ],
        )
        if self._adhesion.row is not None and contacts is not None:
            touching = [model.shape_body, state.body_q, contacts]
            given = [self.law, *touching, ctrl, dt, self._adhesion]
            launch(adhesion.share_adhesion, self._adhesion.row.size, given)
            given = [model.shape_body, model.body_com, *touching[1:], self._adhesion, self._pushed]
            launch(adhesion.adhere, model.body_count, given)
        return self._pushed

    def reset(self, launch: Launcher, mask: wp.array) -> None:
        """Forgets the motors, tendons and servos of the selected worlds."""
        if self._keeps_motors:
            world = self._model.mujoco.actuator_world
            launch(kernels.reset_motors, world.size, [world, mask, self.law.motor])
        if self.tendons.row is not None:
            launch(kernels.forget_tendons, self.tendons.row.size, [mask, self.tendons])
        if self._keeps_servos:
            given = [mask, self._servo_world, self.servos]
            launch(kernels.forget_servos, self.servos.input.size, given)

    @property
    def _keeps_motors(self) -> bool:
        """Whether there are DC motors, whose state goes on."""
        return self.law.motor is not None and self.law.motor.size > 0

    @property
    def _keeps_servos(self) -> bool:
        """Whether a step needs to know what servos pushed with in the last one."""
        return self.servos.input is not None and self.servos.input.size > 0

    def bind(self, joints: Any, bodies: Any) -> None:
        """Adds the armature of actuators to that of their axes, and servos to their bodies; drives
        that are actuators are no drives."""
        bodies.servos = self.servos
        if not self.axes.dof.size:
            return
        self.axes.mode_in = self._model.joint_target_mode
        self.axes.armature_in = self._model.joint_armature
        if self.axes.mode.size:
            joints.target_mode = self.axes.mode
        if self.axes.armature.size:
            joints.armature = self.axes.armature

    def has_other_drives(self) -> bool:
        """Whether other drives are actuators by now, or by other modes, on the host."""
        return bool(self._drives) and Actuators.of_model(self._model).drives != self._drives

    def remembered(self) -> Iterator[tuple[str, wp.array]]:
        """Arrays that a step leaves to the next one, by name."""
        if self._keeps_motors:
            yield "actuators.motor", self.law.motor
        if self._keeps_servos:
            yield "actuators.servos", self.servos.input
            yield "actuators.slopes", self.servos.slopes
        if self._keeps_pushes and self.pushes.size > 0:
            yield "actuators.pushes", self.pushes
        if self.ranged.size > 0:
            yield "actuators.ranged", self.ranged
        if self.tendons.row is not None:
            for name in KEPT:
                if getattr(self.tendons, name).size:
                    yield f"tendons.{name}", getattr(self.tendons, name)

    def _make_law(self, found: Actuators) -> None:
        mujoco: Any = self._model.mujoco
        law = self.law
        for name, attribute in (
            ("dynamics", "dyntype"),
            ("gain", "gaintype"),
            ("bias", "biastype"),
            *((same, same) for same in _SAME),
        ):
            setattr(law, name, getattr(mujoco, f"actuator_{attribute}"))
        limits = np.zeros(len(found.labels), dtype=int)
        for name, bit in (
            ("ctrl", rules.LIMITS_CONTROL),
            ("force", rules.LIMITS_FORCE),
            ("act", rules.LIMITS_ACTIVATION),
        ):
            limits += int(bit) * is_limited(mujoco, name)
        data.allocate(law, limits.size, "is_reported")
        is_motor = mujoco.actuator_gaintype.numpy() == int(MOTOR)
        data.allocate(law, limits.size if np.any(is_motor) else 0, "motor")
        for name, attribute in (("inputs", "ctrlspec"), ("crank", "cranklength")):
            setattr(law, name, getattr(mujoco, f"actuator_{attribute}", None))
        data.fill(law, limits=limits, lengthrange=self._length_ranges(found))

    def _make_axes(self, items: list[tuple[int, int, int]], carried: dict[int, list[int]]) -> None:
        """Lists actuators by degree of freedom.

        Args:
            items: Degree of freedom, row and kind of each.
            carried: Links whose weight actuators compensate, by degree of freedom.
        """
        model = self._model
        dofs = np.unique(np.array([*(dof for dof, *_ in items), *carried], dtype=int))
        place = {dof: i for i, dof in enumerate(dofs.tolist())}
        rows: list[list[int]] = [[] for _ in place]
        kinds: list[list[int]] = [[] for _ in place]
        for dof, row, kind in items:
            rows[place[dof]].append(row)
            kinds[place[dof]].append(kind)
        # Axes without actuators keep the effort limit of their own drives.
        push = data.AxisPush()
        push.least, push.most = -np.inf, np.inf
        count = model.joint_dof_count if dofs.size else 0
        self.pushes = wp.full(count, push, dtype=data.AxisPush)
        self.beside = wp.zeros(count, dtype=wp.vec2)
        self.axes = data.AxisActuation()
        self.axes.dof, self.axes.coordinate = indices(dofs), indices(coordinates_of(model, dofs))
        self.axes.start, self.axes.rows = lists(rows)
        self.axes.kind = lists(kinds)[1]
        self._carried, self._compensated = None, wp.empty(0, dtype=float)
        if carried:
            joint = np.searchsorted(model.joint_qd_start.numpy(), dofs, side="right") - 1
            links = lists([carried.get(dof, []) for dof in dofs.tolist()])
            self._carried = (indices(joint), self.axes.coordinate, *links)
            self._compensated = wp.zeros(dofs.size, dtype=float)
        self._measures_tendons = self.tendons.row is not None and self._cords.is_measured
        combines = self._measures_tendons and bool(np.any(self.tendons.kind.numpy() == int(JOINT)))
        self._coasting = None
        if self._measures_tendons and self._cords.coasts:
            self._coasting = Coasting(model, self.tendons)
            combines = combines or Coasting.needs_coordinates(model)
        self._is_measured = (
            combines or bool(carried) or (bool(items) and self._needs_motion(items, rows))
        )
        measures = int(self._is_measured)
        self._joint_q = wp.zeros(measures * model.joint_coord_count, dtype=float)
        self._joint_qd = wp.zeros(measures * model.joint_dof_count, dtype=float)
        if self._is_measured:
            self._all_joints = AllJoints(model)

    def _keep_ranged(self, before: "Actuation") -> None:
        """Goes on from the laws of the last step, if the same actuators push the same axes."""
        lists = ((a.dof, a.rows, a.kind) for a in (self.axes, before.axes))
        same = all(np.array_equal(a.numpy(), b.numpy()) for a, b in zip(*lists, strict=True))
        if same and self.ranged.size == before.ranged.size:
            self.pushes, self.ranged = before.pushes, before.ranged
        else:
            pushes = self.pushes.numpy()
            pushes["level"] = before.pushes.numpy()["level"]
            self.pushes.assign(pushes)

    def _make_reading(self, armature: np.ndarray, driven: list[int]) -> None:
        """Arrays for what a step reads of axes that actuators change.

        Args:
            armature: What actuators add to that of degrees of freedom [kg or kg m^2].
            driven: Degrees of freedom whose drives are actuators.
        """
        axes, count = self.axes, self._model.joint_dof_count
        is_drive = np.zeros(count if driven else 0, dtype=bool)
        is_drive[driven] = True
        data.fill(axes, is_drive=is_drive)
        data.allocate(axes, is_drive.size, "mode")
        if driven:
            modes = self._model.joint_target_mode.numpy()
            axes.mode.assign(np.where(is_drive, int(newton.JointTargetMode.NONE), modes))
        adds = bool(np.any(armature))
        data.fill(axes, added=armature if adds else armature[:0])
        data.allocate(axes, axes.added.size, "armature")
        if adds:
            axes.armature.assign(self._model.joint_armature.numpy() + armature)

    def _make_bodies(
        self,
        bodies: dict[int, tuple[int, int, Any, int, Any]],
        held: dict[int, int],
        solved: Any,
        wanted: frozenset[str],
    ) -> None:
        """Lists actuators that push bodies, and by link those that push it; servos by body."""
        work = self.bodies = data.BodyActuation()
        self.servos = data.Servos()
        self.link_start = self.items = wp.empty(0, dtype=wp.int32)
        if not bodies:
            return
        axes, link, frame, against, reference = zip(*bodies.values(), strict=True)
        data.fill(work, row=list(bodies), axes=axes, link=link, against=against)
        data.fill(work, frame=np.array(frame), reference=np.array(reference))
        data.fill(work, is_servo=[row in held for row in bodies])
        data.allocate(work, len(bodies), "pushes")
        items: list[list[int]] = [[] for _ in range(self._model.body_count)]
        for i in range(len(bodies)):
            items[link[i]].append(2 * i)
            if against[i] >= 0:
                items[against[i]].append(2 * i + 1)
        self.link_start, self.items = lists(items)
        if held:
            chosen = [i for i, row in enumerate(bodies) if row in held]
            self._make_servos(chosen, link, solved, wanted)

    def _make_servos(
        self, chosen: list[int], link: tuple[int, ...], solved: Any, wanted: frozenset[str]
    ) -> None:
        """Lists servos by the body that the solver makes of their link."""
        servos, body = self.servos, np.arange(self._model.body_count)
        data.allocate(servos, body.size, "arms")
        if hasattr(solved, "body_of_link"):
            servos.arms, body = solved.links.arm, solved.body_of_link
        of: list[list[int]] = [[] for _ in range(solved.body_count)]
        for i in chosen:
            if body[link[i]] >= 0:
                of[body[link[i]]].append(i)
        servos.start, servos.items = lists(of)
        data.fill(servos, links=[link[i] for items in of for i in items])
        servos.pushes = self.bodies.pushes
        kept = servos.items.size if "second_order" in wanted else 0
        data.allocate(servos, kept, "input", "slopes")
        self._servo_world = wp.array(
            self._model.mujoco.actuator_world.numpy()[self.bodies.row.numpy()], dtype=wp.int32
        )

    def _needs_motion(self, items: list[tuple[int, int, int]], rows: list[list[int]]) -> bool:
        """Whether a force takes length and velocity at the start of the step."""
        mujoco: Any = self._model.mujoco
        used = [row for _, row, kind in items if kind == rules.BY_CONTROL]
        gain, bias = (getattr(mujoco, f"actuator_{n}prm").numpy()[used] for n in ("gain", "bias"))
        curved = [getattr(mujoco, f"actuator_{n}type").numpy()[used] > 0 for n in ("gain", "bias")]
        needs = np.any(gain[:, 1:3] != 0.0, axis=1) & curved[0]
        needs |= np.any(bias[:, 1:3] > 0.0, axis=1) & curved[1]
        needs |= np.isin(
            mujoco.actuator_gaintype.numpy()[used], (int(rules.MUSCLE_GAIN), int(MOTOR))
        )
        needs |= mujoco.actuator_biastype.numpy()[used] == int(rules.MUSCLE_BIAS)
        authored = [row for _, row, _ in items if row >= 0]
        curls = np.any(mujoco.actuator_dampingpoly.numpy()[authored] != 0.0)
        limited = (self.law.limits.numpy() & int(rules.LIMITS_FORCE)) > 0
        several = any(
            len(of_dof) > 1 and any(row >= 0 and limited[row] for row in of_dof) for of_dof in rows
        )
        driven = self._model.joint_target_mode.numpy() > 0
        driven[[dof for dof, _, kind in items if kind != rules.BY_CONTROL]] = False
        shared = any(row >= 0 and limited[row] and driven[dof] for dof, row, _ in items)
        return bool(np.any(needs)) or bool(curls) or several or shared

    def _length_ranges(self, found: Actuators) -> np.ndarray:
        """Length range of each actuator; of a muscle without one that of its joint's limits.

        Raises:
            ValueError: If a muscle has neither.
        """
        mujoco: Any = self._model.mujoco
        ranges = mujoco.actuator_lengthrange.numpy().copy()
        kinds = (mujoco.actuator_gaintype.numpy(), mujoco.actuator_biastype.numpy())
        is_muscle = (kinds[0] == int(rules.MUSCLE_GAIN)) | (kinds[1] == int(rules.MUSCLE_BIAS))
        for row in np.flatnonzero(is_muscle & (ranges[:, 0] >= ranges[:, 1])).tolist():
            if row in found.left:
                continue
            dof = found.axes.get(row, -1)
            limits = [getattr(self._model, f"joint_limit_{end}").numpy() for end in _LIMITS]
            if dof < 0 or limits[0][dof] <= -newton.MAXVAL or limits[1][dof] >= newton.MAXVAL:
                what = "joint without limits" if dof >= 0 else "tendon"
                what = "body" if row in found.bodies else what
                raise ValueError(
                    f"The muscle actuator {row} ('{found.labels[row]}') pulls a {what} and has no "
                    "length range (lengthrange in MJCF). MuJoCo's compiler finds it; before the "
                    "solver is made: model.mujoco.actuator_lengthrange.assign("
                    "mujoco.MjModel.from_xml_path(FILE).actuator_lengthrange)"
                )
            gear = mujoco.actuator_gear.numpy()[row][0]
            ends = [gear * (limit[dof] + mujoco.dof_ref.numpy()[dof]) for limit in limits]
            ranges[row] = sorted(ends)
        return ranges

    def _weigh(self, found: Actuators, pushing: list[int]) -> None:
        """What damping ratios and the peak forces of muscles come to in the reference pose.

        MuJoCo takes a ``biasprm[2]`` above zero of a position actuator for a damping ratio, of the
        mass 1/(J M^-1 J^T) along the transmission, and a muscle's ``force`` below zero for
        ``scale`` over the acceleration by a unit force.

        Args:
            found: What actuators push.
            pushing: Rows of those that push bodies.

        Raises:
            ValueError: If an actuator pushes what has no inertia of its own in that pose.
        """
        mujoco: Any = self._model.mujoco
        gain, bias = (getattr(mujoco, f"actuator_{n}prm").numpy() for n in ("gain", "bias"))
        velocity_bias, acc0 = bias[:, 2].copy(), np.zeros(len(bias))
        stiffness, axes = gain[:, 0].copy(), dict(found.axes)
        is_servo = (bias[:, 2] > 0.0) & (gain[:, 0] == -bias[:, 1])
        gear = np.abs(mujoco.actuator_gear.numpy()[:, 0].astype(float))
        drives = [drive for drive in found.drives if drive.row >= 0]
        if drives:
            rows, dofs = np.array([(drive.row, drive.dof) for drive in drives]).T
            velocity_bias[rows] = 0.0
            is_servo[rows] = has_damping_ratio(self._model, rows, dofs)
            stiffness[rows] = self._model.joint_target_ke.numpy()[dofs]
            gear[rows] = 1.0
            axes |= dict(zip(rows.tolist(), dofs.tolist(), strict=True))
        muscle = (gain[:, 2] < 0.0) & (mujoco.actuator_gaintype.numpy() == int(rules.MUSCLE_GAIN))
        needed = is_servo | muscle
        # how a unit force moves the transmission, and how it accelerates all, by row
        moved: dict[int, tuple[float, float]] = {}
        if np.any(needed[list(axes)]):
            known = reference_mobility(self._model, self.tendon_inertia)
            for row, dof in axes.items():
                if needed[row] and dof not in known:
                    raise _no_inertia(found, row)
                along, norm = known.get(dof, (0.0, 0.0))
                moved[row] = (gear[row] ** 2 * along, gear[row] * norm)
        if self.tendons.row is not None and np.any(needed[list(found.tendons)]):
            number = {cord: i for i, cord in enumerate(self.tendons.row.numpy().tolist())}
            moments = self._cords.moments()
            mobility, norms, lost = mobility_along(self._model, moments, self.tendon_inertia)
            for row, cord in found.tendons.items():
                i = number[cord]
                if needed[row] and lost[i]:
                    raise _no_inertia(found, row)
                moved[row] = (gear[row] ** 2 * mobility[i], gear[row] * norms[i])
        if np.any(needed[pushing]):
            moments = reference_moments(self._model, self._push_rates)
            mobility, norms, lost = mobility_along(self._model, moments, self.tendon_inertia)
            for i, row in enumerate(pushing):
                if needed[row] and lost[i]:
                    raise _no_inertia(found, row)
                moved[row] = (mobility[i], norms[i])
        for row, (along, norm) in moved.items():
            if is_servo[row]:
                mass = 1.0 / along if along > 0.0 else 0.0
                velocity_bias[row] = -2.0 * bias[row, 2] * np.sqrt(stiffness[row] * mass)
            acc0[row] = norm
        data.fill(self.law, velocity_bias=velocity_bias, acc0=acc0)

    def _push_rates(self, state: newton.State) -> np.ndarray:
        """Rates of the transmissions that push bodies, in a state."""
        motion = [self._model.body_com, state.body_q, state.body_qd]
        none = wp.empty(0, dtype=float)
        given = [self.law, *motion, none, 0.0, self.bodies]
        wp.launch(pushes.find_pushes, dim=self.bodies.row.size, inputs=given)
        return self.bodies.pushes.numpy()["velocity"].copy()


def _no_inertia(found: Actuators, row: int) -> ValueError:
    """What to say of an actuator whose strength goes by an inertia that is not known."""
    return ValueError(
        f"MuJoCo actuator {row} ('{found.labels[row]}') has a damping ratio, or is a muscle whose "
        "peak force is to be found. Both go by the inertia of what it pushes, which a joint of no "
        "articulation lacks. Write the damping (actuator_biasprm[2] below zero, joint_target_kd) "
        "or the force (actuator_gainprm[2]). Or put the joint into an articulation with "
        "builder.add_articulation(), unless it closes a loop."
    )


def compensate_axes(
    launch: Launcher, model: newton.Model, state: newton.State, joint_q: wp.array, found: list[Any]
) -> None:
    """Launches what finds the compensation of gravity along axes.

    Args:
        launch: Launches kernels.
        model: The user's model.
        state: Has the poses of bodies.
        joint_q: Joint coordinates there.
        found: Degrees of freedom, for each its joint, its coordinate and the links that it carries,
            and where to write [N or N m].
    """
    launch(
        kernels.compensate_axes,
        found[0].size,
        [
            *(model.joint_parent, model.joint_child, model.joint_X_p, model.joint_X_c),
            *(model.joint_qd_start, model.joint_dof_dim, model.joint_axis),
            *(model.body_com, model.body_mass, model.body_world),
            *(model.gravity, model.mujoco.gravcomp, state.body_q, joint_q),
            *found,
        ],
    )
