# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""SolverAVBD: what a user calls, and what a step launches.

Its arrays are in ``setup``, the kernels in ``step`` and ``drivers``, the physics in ``rows`` and
``blocks``.
"""

import dataclasses
import functools
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, Literal

import newton
import numpy as np
import warp as wp
from newton import ModelFlags, StateFlags
from newton.solvers import SolverBase

from . import data
from .attributes import register_joint_attributes
from .checks import check_model, report_ignored, report_open_joints
from .coupling import RigidCoupling
from .drivers.barrier import WARP
from .drivers.launch import Compiler, Launcher
from .drivers.sorting import sort_at_once
from .drivers.workers import Workers
from .drivers.world import make_solve, make_step, make_step_links
from .effects import Effects, SceneEffects, left_out
from .report import CAUSES_OF_ERROR, InnerReport, Report, Status, missed
from .settings import Settings, register_scene_settings
from .setup.actuator_force import ActuatorForce
from .setup.arrays import SolverArrays
from .setup.cables import CableViews
from .setup.inner_steps import smallest_accuracy
from .setup.joined import JoinedModel
from .setup.joint_state import JointState
from .setup.memory import bytes_by_effect, members
from .setup.solved import BodyState, SolvedModel
from .step.actuation import reset_activations
from .step.adapting import export_mean_force
from .step.bodies import BODIES_PER_THREAD, make_integrate, make_predict, push_more, report_freed
from .step.breaking import enable_joints
from .step.contacts import make_sort_contacts
from .step.links import (
    gather_bodies,
    load_by_contacts,
    load_by_joints,
    load_links,
    load_welds,
    refer_contact_force,
    reset_links,
    scatter_links,
)
from .step.observables import export_acceleration, export_contact_force, make_export_parent_force
from .step.resetting import reset_bodies
from .step.sleeping import make_end_islands, make_form_islands
from .step.sleeping_contacts import export_sleeping_force
from .step.watching import make_watch_bodies, watch_joints, watch_tendons


class SolverAVBD(SolverBase, SolverArrays, CableViews, RigidCoupling):
    """Rigid bodies, joints and contacts by Augmented Vertex Block Descent.

    An implicit step in pose increments, of second order in time where the motion is smooth,
    minimised block by block. A free body is a 6x6 block; the
    bodies that joints link into a tree, an articulation, are one block, solved exactly in time
    proportional to their number, so that accuracy does not depend on the length of a chain or on
    mass ratios along it. Contacts with Coulomb friction, and joints that close loops, are enforced
    by multipliers and a penalty scaled by the masses they couple. A step is a pure function of
    ``state_in``, ``control``, ``contacts`` and what the solver has stored of the last step.

    Contacts and joints are rigid, as in :class:`newton.solvers.SolverXPBD` and ``SolverMuJoCo``;
    with ``compliant_contacts`` contacts and joint limits give way by the stiffness and damping
    that the model authors. Supported: all types of joints, drives, limits, kinematic bodies, all
    shapes that Newton's collision pipeline handles, any number of worlds.

    Sources: Giles, Diaz, Yuksel, "Augmented Vertex Block Descent", 2025; Chen, "Rigid Body Dynamics
    with VBD, Section I: Free Bodies", 2026, the seed document; Featherstone, "Rigid Body Dynamics
    Algorithms", 2008; ``docs/`` says where this solver departs from them, and why.

    Example:
        As any of Newton's solvers::

            solver = SolverAVBD(model)
            pipeline.collide(state_0, contacts)
            solver.step(state_0, state_1, control, contacts, 1.0 / 240.0)
    """

    supports_collision_pipeline = True
    supports_body_pair_reduced_contacts = True

    class ObservableKind(SolverBase.ObservableKind):
        """Names of the arrays that a step can fill."""

        QFRC_ACTUATOR = "qfrc_actuator"
        """What drives and MuJoCo's actuators push joints with; the same name as of SolverMuJoCo."""

    @dataclasses.dataclass(eq=False)
    class Observables(SolverBase.Observables):
        """Arrays that a step can fill."""

        qfrc_actuator: wp.array[wp.float32] | None = SolverBase.Observables.field(  # noqa: RUF009
            dtype=wp.float32, frequency=newton.Model.AttributeFrequency.JOINT_DOF
        )
        """Generalized forces of drives and MuJoCo's actuators at the end of the step [N or N m],
        shape (joint_dof_count,), ``joint_f`` aside. Layout and frames are those of ``joint_f``."""

    SUPPORTED_OBSERVABLES = frozenset(
        {
            ObservableKind.BODY_QDD,
            ObservableKind.BODY_PARENT_F,
            ObservableKind.CONTACT_F,
            ObservableKind.QFRC_ACTUATOR,
        }
    )
    """``body_qdd``, ``body_parent_f``, ``contact_f`` and ``qfrc_actuator``."""

    def __init__(
        self,
        model: newton.Model,
        *,
        iterations: int | None = None,
        tolerance: float | None = None,
        compliant_contacts: bool | None = None,
        friction_mix_mode: Literal["geometric_average", "average", "multiply", "min", "max"]
        | None = None,
        angular_friction: bool | None = None,
        formulation: Literal["augmented", "ramp"] | None = None,
        scheme: Literal["euler", "generalized_alpha", "runge_kutta"] | None = None,
        blocks: Literal["articulation", "body"] | None = None,
        parallel: Literal["worlds", "bodies"] | None = None,
        sleeping: bool | None = None,
        accuracy: float | None = None,
        inner_steps: int | None = None,
        effects: Mapping[str, bool] | None = None,
        update_joint_state: bool = False,
        strict: bool = False,
        workers: int | None = None,
        collision_pipeline: newton.CollisionPipeline | None = None,
        collision_frequency: Mapping[SolverBase.CollisionSlot, int] | None = None,
        collision_frequency_type: Mapping[
            SolverBase.CollisionSlot, SolverBase.CollisionFrequencyType
        ]
        | None = None,
    ) -> None:
        """Prepare to simulate a model.

        Settings that default to None are the scene's where it authors them (see
        :meth:`register_custom_attributes`), and otherwise as said here.

        Args:
            model: The model. Its arrays are read live in every step; after a change that calls for
                something new, as other bodies that move, call :meth:`notify_model_changed`.
            iterations: Most sweeps over the bodies in each step, 10 by default, with ``accuracy``
                40: more for taller stacks and larger mass ratios. The first three steps after a
                reset, and those in which impacts or drives at their limits do not settle, take up
                to eight times as many; the first one, if the world starts from rest, up to twelve
                times, and so do those of piles that should come to rest and do not. Twice as many
                take worlds in which a link of an articulation pushes something that moves.
            tolerance: A world's sweeps end early when one moves no body by more than this [m]; a
                rotation counts by the radius of gyration. Penetration up to a tenth of it is left
                alone. With 0, the default, they end only when nothing moves any more.
            compliant_contacts: Contacts give way by the shapes' ``ke`` [N/m] and ``kd`` [N s/m]
                (their means over the two shapes) instead of being rigid, which is the default, and
                joint limits by their ``limit_ke`` and ``limit_kd``.
            friction_mix_mode: How the friction coefficients of two shapes make that of their
                contact. ``"geometric_average"``, the default, as in ``SolverVBD``, ``"average"``
                as in ``SolverXPBD``, ``"max"``. None is the geometric average, but where one of the
                shapes is of an MJCF file, or has a ``mujoco:condim`` or ``mujoco:geom_priority``
                other than MuJoCo's default, that of the higher priority, or the larger one.
                Restitution is always the average.
            angular_friction: Contacts resist twisting and rolling by the shapes' ``mu_torsional``
                and ``mu_rolling`` [m]. Newton gives some to every shape, and importers copy what
                MuJoCo ignores by default, so that this is for the user to ask for. None, the
                default, takes MuJoCo's word where a shape has it, a ``mujoco:condim`` of 4
                (twisting) or 6 (rolling, too); for the others it leaves it out and warns where a
                shape has other values than Newton's default.
            formulation: ``"augmented"`` (multipliers), the default, or ``"ramp"``: the seed
                document's growing penalty up to the shapes' ``ke``, for comparison.
            scheme: ``"generalized_alpha"``, the default, of second order in time where the motion
                is smooth; steps in which a velocity of a world jumps are backward Euler. Or
                ``"runge_kutta"``, of fourth order in steps in which nothing but trees of joints
                holds the bodies of a world (no contact, no stop, nothing too stiff), for motion
                that is to be exact; other steps are those of the default. Or ``"euler"``, backward
                Euler in all steps, to compare with ``SolverVBD`` or the seed document.
                ``formulation="ramp"`` is backward Euler, too.
            blocks: What is solved at once: ``"articulation"``, the default, the tree that joints
                make of bodies, or ``"body"``, each body by itself, for comparison.
            parallel: What the threads of a device share: ``"worlds"``, one thread a world, or
                ``"bodies"``, all blocks of a color at once, for large worlds; a block is then a
                free body or an articulation. Scenes without contacts have no colors, and are solved
                by worlds. None, the default, takes bodies on a GPU where a world has at least 64
                and there are at most 100 worlds, and neither ``sleeping`` nor
                ``formulation="ramp"`` is asked for.
            sleeping: Islands, what contacts and joints link, are not solved any more once all their
                bodies have been at rest for half a second, until something touches or drives them
                or their state, forces or gravity change; see :attr:`status`. Each is solved for
                itself. None for not.
            accuracy: Error that a second of simulated time may add [m/s]; None, the default, for
                steps as long as ``dt``. A call of ``step`` then divides itself into as few inner
                steps as each world needs. Over a time T, the estimated errors of the worst body add
                up to at most ``accuracy`` x (T + 1/4 s); a rotation counts by the radius of
                gyration. ``docs/algorithm.md`` has the estimate, ``docs/accuracy_control.md`` how
                far it is right. Contacts are those of the call, and so are forces and controls.
            inner_steps: Most inner steps of a call with ``accuracy``, repeated ones included, 100
                by default. :meth:`report` says where they did not do.
            effects: Effects of the scene to leave out, as ``{"friction": False}``; True for those
                that are to be there, which raises where nothing calls for them. For their names
                and what calls for each see :attr:`effects`.
            update_joint_state: Joint coordinates are part of the state, as for ``SolverMuJoCo`` and
                ``SolverFeatherstone``. Each step writes ``state_out.joint_q`` and ``joint_qd``,
                with the revolutions of hinges counted. An articulation whose ``state_in.joint_q``
                or ``joint_qd`` the user has written since the last step, but not its bodies, starts
                from these: the step writes its ``body_q`` and ``body_qd`` to ``state_in`` first. If
                both were written the bodies count. The first step starts from the joint
                coordinates unless the bodies are elsewhere than in the model. Without this setting
                joint coordinates are neither read nor written, as in ``SolverVBD``.
            strict: What the model holds and this solver does not simulate (particles, cloth,
                ...) is an error instead of a warning.
            workers: Most threads that share the worlds of a step on a CPU, to the same bits; None
                for one a core. Those that pay are used: one below some 0.6 ms of work, and where a
                graph is captured.
            collision_pipeline: A pipeline that the solver runs at the start of each step, on
                ``state_in``; ``step`` then takes ``contacts=None``.
            collision_frequency: See :class:`newton.solvers.SolverBase`.
            collision_frequency_type: ``NONE`` or ``PRE_INIT``, by slot.

        Raises:
            NotImplementedError: If the ramped formulation is asked for and the model has joints, if
                ``parallel="bodies"`` and the model calls for what that does not do, or if
                ``strict`` and the model holds what the solver does not simulate.
            ValueError: If a setting or a number in the model makes no sense, or an effect is asked
                for that nothing calls for.
        """
        settings = Settings.resolve(
            model,
            iterations=iterations,
            tolerance=tolerance,
            compliant_contacts=compliant_contacts,
            friction_mix_mode=friction_mix_mode,
            angular_friction=angular_friction,
            formulation=formulation,
            scheme=scheme,
            blocks=blocks,
            sleeping=sleeping,
            accuracy=accuracy,
            inner_steps=inner_steps,
        )
        if parallel not in (None, "worlds", "bodies"):
            raise ValueError(f"parallel must be 'worlds', 'bodies' or None, got {parallel!r}.")
        check_model(model, ramp=settings.ramp)
        if settings.accuracy is not None and settings.accuracy < smallest_accuracy(model):
            raise ValueError(
                f"accuracy={settings.accuracy:.1e} m/s is below what single precision leaves room "
                f"for in a model of this size; the smallest is {smallest_accuracy(model):.1e} m/s."
            )
        self._without = left_out(effects or {})
        self._report_ignored = functools.partial(
            report_ignored,
            strict=strict,
            rigid_contacts=not (settings.ramp or settings.compliant_contacts),
            angular_friction=settings.angular_friction,
            without=self._without,
        )
        self._joined = JoinedModel(model)
        self._report_ignored(model, own_rows=self._joined.own_rows)
        super().__init__(
            model,
            collision_pipeline=collision_pipeline,
            collision_frequency=collision_frequency,
            collision_frequency_type=collision_frequency_type,
        )
        self._launch = Launcher(self.device)
        self._retired = []
        actuators = model.custom_frequency_counts.get("mujoco:actuator", 0)
        self._activations = wp.zeros(actuators, dtype=float, device=self.device)
        self._predictors, self._workers = Workers(workers), Workers(workers)
        self.settings = settings
        """What the arguments and the scene say, as arguments of a solver that does the same."""
        self.iterations = settings.iterations
        self.tolerance = float(settings.tolerance)
        self._parallel = parallel
        self._is_told = False
        self._is_placed = update_joint_state
        self.writes_joint_state = update_joint_state and model.joint_count > 0
        """Whether ``step`` writes the joint coordinates of ``state_out``."""
        if self.writes_joint_state:
            self._joint_state = JointState(model)
        self._make_arrays()
        if self._flags.adaptive:
            self._list_memory()
        self._callers.require((name for name, on in (effects or {}).items() if on), self._flags)

    # What a step does, top to bottom.

    def step(
        self,
        state_in: newton.State,
        state_out: newton.State,
        control: newton.Control | None,
        contacts: newton.Contacts | None,
        dt: float,
        *,
        observables: SolverBase.Observables | None = None,
    ) -> None:
        """Advance the bodies by one time step.

        Args:
            state_in: State to start from, of which three arrays of shape (body_count,) are read:
                poses ``body_q`` [m], velocities ``body_qd`` [m/s, rad/s] and forces ``body_f`` [N,
                N m]; with ``update_joint_state`` the joint coordinates, too. A kinematic body moves
                at its ``body_qd``; where that is zero, friction sees how its pose has been written
                since the last step.
            state_out: State to write ``body_q`` and ``body_qd`` to, and the joint coordinates with
                ``update_joint_state``; may be ``state_in``.
            control: ``joint_f`` [N or N m] and ``joint_target_qd`` [m/s or rad/s], shape
                (joint_dof_count,), ``joint_target_q`` [m or rad], shape (joint_coord_count,), and
                ``mujoco.ctrl`` where the model has MuJoCo's actuators; None for the model's own.
            contacts: Contacts of this or an earlier collision pass, or None for no contacts
                (or where the solver owns a pipeline).
            dt: Time step [s].
            observables: Arrays to fill, from :meth:`newton.solvers.SolverBase.observables` of this
                solver; None for none.

        Raises:
            ValueError: If an argument does not fit the model, or ``dt`` is not positive.
        """
        contacts = self._resolve_step_contacts(contacts)
        self.validate_observables(observables, contacts)
        self._check_step(state_in, state_out, contacts, dt)
        if self.model.body_count == 0:
            return
        # model.control() would build a whole object for three arrays
        control_input = self._control_input(self.model if control is None else control)
        if self.writes_joint_state:
            self._joint_state.read(self._launch, state_in, self._history)
        if not self._is_placed and not self.device.is_capturing:
            self._is_placed = True
            report_open_joints(self.model, state_in.body_q.numpy())
        if self._owns_detection:
            self._run_rigid_collision(state_in, dt)
        accelerations = _requested(observables and observables.body_qdd, state_out.body_qdd)
        for body_qdd in accelerations:
            wp.copy(body_qdd, state_in.body_qd)

        if not self._flags.contact:
            contacts = None
        elif contacts is None and not self._is_told:
            self._is_told = True
            warnings.warn(
                "SolverAVBD steps without contacts though the model has shapes that can collide: "
                "they pass through each other. Pass the contacts of a newton.CollisionPipeline to "
                "step(), or the pipeline to the solver.",
                stacklevel=2,
            )
        if contacts is None:
            self._forget_contacts()
        start = self._actuate(state_in, control, control_input, contacts, dt)
        if self._cables is not None:
            self._cables.begin(self._launch, state_in)
        flags = self._flags
        needs_solve = flags.joints or flags.sleeping or flags.drag or flags.adaptive
        is_free = contacts is None and not needs_solve
        # one kernel makes the whole step of a single world, links and all
        is_apart = self._flags.welds and (is_free or not self._at_once)
        if isinstance(self._solved, SolvedModel) and (is_apart or not flags.welds):
            self._solved.weigh(self._launch)
            if not flags.welds:
                self._solved.follow_joints(self._launch)
        given: newton.State | BodyState = start
        result: newton.State | BodyState = state_out
        if is_apart:
            given, result = self._gather_bodies(start, control_input)
        if is_free:
            self._integrate(given, result, control_input, dt)
        else:
            self._solve(given, result, control_input, contacts, dt)
        if is_apart:
            self._scatter_links(state_in, state_out)
        if self._cables is not None:
            self._cables.end(self._launch, state_out, dt)
        if contacts is None and self._work.put_from is not None:
            self._work.put_from.zero_()

        for body_qdd in accelerations:
            self._launch_links(export_acceleration, [state_out.body_qd, dt, body_qdd])
        for contact_f in _requested(
            observables and observables.contact_f, contacts and contacts.force
        ):
            self._export_contact_force(contact_f, contacts)
        for body_parent_f in _requested(
            observables and observables.body_parent_f, state_out.body_parent_f
        ):
            if self._flags.welds:
                self._export_weld_force(body_parent_f, start, contacts, dt)
            else:
                self._export_parent_force(body_parent_f, contacts)
        if self.writes_joint_state:
            joints, count = self._joints, self._solved.joint_count
            self._joint_state.write(self._launch, state_out, joints, count, self._history)
        actuator_forces = _requested(
            observables and observables.qfrc_actuator,
            getattr(getattr(state_out, "mujoco", None), "qfrc_actuator", None),
        )
        if actuator_forces and self.model.joint_count:
            self._export_actuator_force(actuator_forces[0], state_out, control_input)
            for copy in actuator_forces[1:]:
                wp.copy(copy, actuator_forces[0])

    def _actuate(
        self,
        state_in: newton.State,
        control: newton.Control | None,
        control_input: data.ControlInput,
        contacts: newton.Contacts | None,
        dt: float,
    ) -> newton.State | BodyState:
        """State with what actuators and gravity compensation add to the wrenches on bodies."""
        if self._actuation is None:
            return state_in
        ctrl = self._actuator_control(control)
        source = None if contacts is None else self._contact_input(contacts)
        body_f = self._actuation.launch(self._launch, state_in, ctrl, control_input, source, dt)
        return BodyState(state_in.body_q, state_in.body_qd, body_f)

    def _gather_bodies(
        self, state_in: newton.State | BodyState, control: data.ControlInput
    ) -> tuple[BodyState, BodyState]:
        """States of the bodies that welds make of links, before and after the step."""
        solved = self._solved
        assert isinstance(solved, SolvedModel)
        self._launch(
            gather_bodies,
            max(solved.body_count, solved.joint_count),
            [
                self._bodies,
                solved.links,
                control,
                state_in.body_q,
                state_in.body_qd,
                state_in.body_f,
            ],
        )
        return solved.given, solved.result

    def _scatter_links(self, state_in: newton.State, state_out: newton.State) -> None:
        """States of the links, by those of their bodies."""
        self._launch_links(
            scatter_links,
            [
                self._solved.links,
                state_in.body_q,
                state_in.body_qd,
                state_out.body_q,
                state_out.body_qd,
            ],
        )

    def _integrate(
        self,
        state_in: newton.State | BodyState,
        state_out: newton.State | BodyState,
        control: data.ControlInput,
        dt: float,
    ) -> None:
        """The step where nothing touches: one kernel, exact."""
        self._step = self._step_of(state_in, state_out, control, self._no_contacts, dt)
        self._launch_bodies(make_integrate(self._flags), [self._step, self._context()])

    def _solve(
        self,
        state_in: newton.State | BodyState,
        state_out: newton.State | BodyState,
        control: data.ControlInput,
        contacts: newton.Contacts | None,
        dt: float,
    ) -> None:
        """The step with constraints: predict, sort the contacts by owner, solve each world."""
        source = self._no_contacts if contacts is None else self._contact_input(contacts)
        effects = self._flags_with(contacts)
        if effects.breaking:
            self._launch(
                enable_joints,
                self._solved.joint_count,
                [self._solved.joint_enabled, self._history.broken, self._joints.enabled],
            )
        if effects.adaptive and not self._is_listed:
            self._list_memory()
        whole, seen = self._context(), self._seen_context()
        if self._at_once and effects.welds:
            solved = self._solved
            self._step = self._step_of(solved.given, solved.result, control, source, dt)
            given = [state_in.body_q, state_in.body_qd, state_in.body_f]
            result = [state_out.body_q, state_out.body_qd]
            self._launch(make_step_links(effects), 1, [*given, *result, self._step, seen])
            return
        self._step = step = self._step_of(state_in, state_out, control, source, dt)
        if self._at_once:
            self._launch(make_step(effects), 1, [step, seen])
            return
        if effects.sleeping:
            self._form_islands(effects, control)
        each = BODIES_PER_THREAD if self.device.is_cpu else 1
        self._launch(
            make_predict(self._flags, each),
            -(-self._solved.body_count // each),
            [0, step, whole],
            self._predictors if self._world_count > 1 else None,
        )
        if effects.reaction:
            self._launch(push_more, 1, [self._pushing, step, whole])
        if self._large is not None:
            self._large.solve(
                self._launch, effects, step, seen, source.capacity, dt, self.iterations
            )
            return
        if contacts is not None:
            if effects.on_gpu and not effects.sleeping:
                sort_at_once(self._launch, step, seen, source.capacity)
            else:
                self._launch(make_sort_contacts(effects.sleeping), 1, [step, seen])
        threads = self._world_count
        if effects.sleeping:
            threads = seen.worlds.threads
        elif effects.on_gpu:
            threads = seen.worlds.turn.shape[0]
        workers = None if effects.sleeping else self._workers
        self._launch(make_solve(effects), threads, [0, step, seen], workers, WARP)
        if effects.sleeping:
            self._launch(
                make_end_islands(effects),
                self._world_count,
                [self._worlds, seen.worlds, self._history, seen.history],
            )

    def _form_islands(self, effects: Effects, control: data.ControlInput) -> None:
        """Finds out what sleeps, passes it on, and lists the rest island by island."""
        whole, seen = self._context(), self._seen_context()
        self._launch_bodies(make_watch_bodies(self._flags), [self._step, whole])
        if effects.joints:
            self._launch(
                watch_joints,
                self._solved.joint_count,
                [self._joints, control, self._worlds, self._sleep],
            )
        if effects.tendons:
            tendons = self._tree.tendons
            given = [tendons, self._worlds, self._sleep]
            self._launch(watch_tendons, tendons.row.size, given)
        self._launch(make_form_islands(effects), 1, [seen.worlds, seen.history, self._step, whole])

    # What a user may do besides stepping.

    @classmethod
    def register_custom_attributes(cls, builder: newton.ModelBuilder) -> None:
        """Declare what a scene may author for this solver, in the namespace ``avbd``.

        Call it before ``builder.add_usd``, which reads from the stage's PhysicsScene prim, into
        arrays or lists of one value in ``model.avbd``:

        - ``newton:maxSolverIterations``, ``max_solver_iterations``: ``iterations``; -1 for unset.
        - ``newton:avbd:tolerance``, ``tolerance``: the argument of that name [m].
        - ``newton:avbd:compliantContacts``, ``compliant_contacts``: likewise.
        - ``newton:avbd:frictionMixMode``, ``friction_mix_mode``: likewise.
        - ``newton:avbd:angularFriction``, ``angular_friction``: likewise.
        - ``newton:avbd:formulation``, ``formulation``: likewise.
        - ``newton:avbd:scheme``, ``scheme``: likewise.
        - ``newton:avbd:blocks``, ``blocks``: likewise.
        - ``newton:avbd:sleeping``, ``sleeping``: likewise.
        - ``newton:avbd:accuracy``, ``accuracy``: likewise [m/s].
        - ``newton:avbd:innerSteps``, ``inner_steps``: likewise.

        and from its joints, into arrays of one value a joint:

        - ``joint_break_force`` [N], ``joint_break_torque`` [N m] of a joint, in USD
          ``physics:breakForce`` and ``physics:breakTorque``: it breaks when it carries more, at
          its anchor and along what it locks, and stays broken until :meth:`reset`.

        Args:
            builder: The builder; may be registered more than once.
        """
        register_scene_settings(builder)
        register_joint_attributes(builder)

    @classmethod
    def precompile(
        cls, model: newton.Model, *, contacts: newton.Contacts | None = None, **settings: Any
    ) -> SceneEffects:
        """Compile what a solver launches into Warp's kernel cache, and step nothing.

        For containers that are to start without a compiler's wait, with ``wp.config``'s
        ``kernel_cache_dir`` in the image. The effects decide what is compiled, no numbers do: any
        model with the same effects will do. Compiled are a step with contacts, its observables and
        a reset, on the model's device.

        Args:
            model: The model, or a small one that calls for the same effects.
            contacts: A contact buffer as the steps will have it; None for that of a
                :class:`newton.CollisionPipeline` of the model.
            settings: As of the constructor.

        Returns:
            The effects that were compiled.

        Raises:
            ValueError: As the constructor does.
        """
        solver = cls(model, **settings)
        solver._launch = Compiler(solver.device)
        state = model.state()
        if contacts is None and not solver._owns_detection:
            contacts = newton.CollisionPipeline(model).contacts()
        buffer = solver.contacts if contacts is None else contacts
        observables = solver.observables(cls.SUPPORTED_OBSERVABLES, contacts=buffer)
        solver.step(state, model.state(), None, contacts, 1.0, observables=observables)
        solver.reset(state)
        return solver.effects

    @property
    def effects(self) -> SceneEffects:
        """Every effect, on or off, why, and what memory it takes [bytes]; ``print`` it for a table.

        What a contact buffer calls for is on once a step had such a buffer.
        """
        buffers = [self._flags_with(contacts) for contacts in self._inputs]
        by_buffer: dict[str, Any] = {
            name: any(getattr(flags, name) for flags in buffers)
            for name in ("matching", "moving_surfaces", "contact_materials")
        }
        return SceneEffects.of_solver(
            dataclasses.replace(self._flags, **by_buffer),
            self._callers,
            self._without,
            bytes_by_effect(self),
        )

    @property
    def activations(self) -> wp.array:
        """Activation of each of MuJoCo's actuators at the end of the last step.

        Shape (actuators,), float32, on the device, in the order of ``control.mujoco.ctrl``. It is
        the solver's own array, the same one for good: the next step starts from what is written to
        it, also in a captured graph. :meth:`reset` writes zeros, :meth:`checkpoint` includes it.
        Zero, or what was written to it, for actuators without dynamics, for those that are joint
        drives and where no actuator acts; DC motors keep states of their own.
        """
        return self._activations

    @property
    def joint_sigma_prev(self) -> wp.array:
        """Torque of Dahl friction about the bends and the twist of each rod [N m].

        Shape (joint_count,), vec3, on the device. As in :class:`newton.solvers.SolverVBD`: at the
        end of the last step. Zero for other joints.
        """
        return self._by_joint(self._history.dahl_sigma)

    @property
    def joint_kappa_prev(self) -> wp.array:
        """Bends and twist of each rod at the end of the last step [rad].

        Shape (joint_count,), vec3, on the device. In scenes with Dahl friction; infinite before the
        first step, zero for other joints.
        """
        return self._by_joint(self._history.dahl_kappa)

    def _by_joint(self, values: wp.array | None) -> wp.array:
        """Vectors of the joints that the solver knows, by joint of the model."""
        count = self.model.joint_count
        if values is not None and values.shape[0] == count:
            return values
        every = np.zeros((count, 3), dtype=np.float32)
        if values is not None:
            known = self._welds.joint < count
            every[self._welds.joint[known]] = values.numpy()[known]
        return wp.array(every, dtype=wp.vec3, device=self.device)

    @property
    def parallel(self) -> Literal["worlds", "bodies"]:
        """What the threads of the device share, as asked for or chosen by the constructor."""
        return "worlds" if self._large is None else "bodies"

    @property
    def status(self) -> Status:
        """What happened since the construction or the last reset.

        Each access waits for the device and copies the counters from it: not for a captured graph.
        """
        colors, clashes = (0, 0) if self._large is None else self._large.found()
        return Status(
            colors=colors,
            clashes=clashes,
            held_steps=self._worlds.held.numpy().copy(),
            repaired_poses=self._worlds.repaired.numpy().copy(),
            sweeps=self._worlds.sweeps.numpy().copy(),
            update=self._worlds.update.numpy().copy(),
            bounded_steps=self._worlds.bounded.numpy().copy(),
            bounded_energy=self._worlds.excess.numpy().copy(),
            unbounded_steps=self._worlds.unbounded.numpy().copy(),
            sleeping_bodies=self._count_sleeping(),
            broken_joints=self._welds.joint[
                [] if self._history.broken is None else np.flatnonzero(self._history.broken.numpy())
            ],
            missed_accuracy=(
                self._worlds.inner.missed.numpy().copy()
                if self._flags.adaptive
                else np.zeros_like(self._worlds.sweeps.numpy())
            ),
            contact_overflow=int(self._worlds.overflow.numpy()[0]),
            dropped_contacts=int(self._worlds.dropped.numpy()[0]),
        )

    def _count_sleeping(self) -> int:
        """How many bodies of the model sleep."""
        if self._worlds.island is None:
            return 0
        sleeps = self._worlds.island.numpy()[:-1] >= 0
        return int(np.sum(sleeps[self._welds.body[self._welds.body >= 0]]))

    def report(self) -> Report:
        """Sweeps and residual of each world in the last step.

        Print it for a table, for instance to choose ``iterations`` and ``tolerance``. Each call
        waits for the device and copies from it: not for a captured graph.

        Returns:
            Copies, which later steps do not change.
        """
        if self._worlds.sweeps is None:
            # every link is part of the static world
            none = np.zeros(max(1, self.model.world_count))
            sweeps = none.astype(np.int32)
            return Report(sweeps, none, none + self.tolerance, sweeps + 1, {}, None)
        sweeps, update = self._worlds.sweeps.numpy(), self._worlds.update.numpy()
        h, order = self._history.step.numpy(), np.ones_like(sweeps)
        if self.settings.second_order:
            order += self._worlds.step.numpy() < h
        if self._flags.fourth_order:
            order[self._tree.runge_kutta.is_known.numpy() != 0] = 4
        allowed = np.maximum(self.tolerance, self._worlds.settled.numpy())
        worst = self._worst_contacts(np.flatnonzero(update > allowed))
        return Report(sweeps.copy(), update.copy(), allowed, order, worst, self._inner_report())

    def _inner_report(self) -> InnerReport | None:
        """How accurate the last call was; None where no accuracy was asked for."""
        if not self._flags.adaptive:
            return None
        inner = self._worlds.inner
        links = self._welds.body.tolist()
        bodies = [
            self.model.body_label[links.index(body)] if body >= 0 else ""
            for body in inner.worst.numpy().tolist()
        ]
        return InnerReport(
            asked=inner.accuracy,
            estimated=inner.estimate.numpy().copy(),
            steps=inner.steps.numpy().copy(),
            rejected=inner.rejected.numpy().copy(),
            worst=bodies,
            why=[CAUSES_OF_ERROR[cause] for cause in inner.cause.numpy().tolist()],
            total=inner.spent.numpy().copy(),
            missed=inner.missed.numpy().copy(),
        )

    def _worst_contacts(self, worlds: np.ndarray) -> dict[int, str]:
        """The contact that misses most in each of some worlds, in words."""
        if self._rows.rows is None:
            return {}
        of_body, side = self._worlds.of_body.numpy(), self._history.parity.numpy()
        starts, ends = self._rows.owned_start.numpy(), self._rows.owned_end.numpy()
        rows, records = self._rows.rows.numpy(), self._history.records.numpy()
        increment, com = self._work.increment.numpy(), self._work.com.numpy()
        worst = {}
        for world in worlds:
            bodies = np.flatnonzero(of_body[: self._solved.body_count] == world)
            owned = [np.arange(starts[body], ends[body]) for body in bodies]
            indices = np.concatenate(owned) if owned else np.empty(0, dtype=int)
            if indices.size:
                apart = missed(rows[indices], increment, com)
                record = records[side[world], indices[np.argmax(apart)]]
                names = [repr(self.model.shape_label[record[f"shape{i}"]]) for i in (0, 1)]
                worst[int(world)] = f"{names[0]} on {names[1]} misses by {apart.max():.1e} m"
        return worst

    def reset(
        self,
        state: newton.State,
        world_mask: wp.array | None = None,
        flags: StateFlags | int | None = None,
    ) -> None:
        """Reset worlds to the model's initial poses, and drop their warm start, on the device.

        Args:
            state: State to modify: ``body_q`` and ``body_qd``, and with ``update_joint_state``
                ``joint_q`` and ``joint_qd``, as ``flags`` say.
            world_mask: Which worlds, shape (world_count + 1,), bool, on the solver's device; the
                last entry is for global bodies. None for all.
            flags: What to reset; None for all, 0 for poses and velocities that the caller has
                written. Multipliers are always dropped.

        Raises:
            TypeError: If the mask is no array of booleans.
            ValueError: If the mask has another shape or is on another device.
        """
        mask = self._normalize_reset_world_mask(world_mask)
        if self.model.body_count == 0:
            return
        selected = self._no_mask if mask is None else mask
        wanted = int(StateFlags.ALL if flags is None else flags)
        model = self._solved
        if self._large is not None:
            self._large.forget(self._launch, model.body_world, selected)
        if self._activations.size:
            world = self.model.mujoco.actuator_world
            self._launch(reset_activations, world.size, [world, selected, self._activations])
        if self._actuation is not None:
            self._actuation.reset(self._launch, selected)
        if self._cables is not None:
            self._cables.reset(self._launch, state, selected)
        if self.writes_joint_state:
            self._joint_state.reset(self._launch, state, selected, wanted)
        bodies: newton.State | BodyState = state
        if isinstance(model, SolvedModel) and self._flags.welds:
            bodies = model.given
            rest = [self.model.body_world, self.model.body_q, self.model.body_qd]
            self._launch_links(reset_links, [*rest, selected, wanted, state.body_q, state.body_qd])
        self._launch_bodies(
            reset_bodies,
            [
                model.body_q,
                model.body_qd,
                selected,
                wanted,
                self._rest_angle,
                bodies.body_q,
                bodies.body_qd,
                self._context(),
            ],
        )

    def checkpoint(self) -> dict[str, np.ndarray]:
        """What the solver has stored of the last step, on the host.

        Together with the state that the step wrote, a run can go on from it to the same bits, in
        this solver or in another one of an equal model with equal settings and contact buffers.
        Waits for the device, so that it cannot be part of a captured graph.

        Returns:
            Copies of the solver's arrays, by name. Names, shapes and dtypes, some of them
            structured, depend on the effects of the model and are no part of the interface.
            ``numpy.savez`` can store them.
        """
        return {name: array.numpy().copy() for name, array in self._remembered()}

    def restore(self, checkpoint: Mapping[str, np.ndarray]) -> None:
        """Go on from what :meth:`checkpoint` returned, instead of the last step.

        The state is not part of it: the next step has to start from the one that was the last
        step's ``state_out`` when the checkpoint was taken.

        Args:
            checkpoint: Arrays by name, with the names and sizes [bytes] of this solver's own.

        Raises:
            ValueError: If they are those of a solver of another model, with other settings or for
                other contact buffers; names the arrays that do not fit. Nothing is changed then.
        """
        arrays = dict(self._remembered())
        own = {name: array.capacity for name, array in arrays.items()}
        given = {name: array.nbytes for name, array in checkpoint.items()}
        other = [name for name in {**own, **given} if own.get(name) != given.get(name)]
        if other:
            raise ValueError(
                f"The checkpoint does not fit this solver: {', '.join(other)}. Construct it with "
                "the model and settings of the other, and its collision pipeline before it."
            )
        for name, array in arrays.items():
            array.assign(checkpoint[name])
        if self._large is not None:
            self._large.may_be_cold = True

    def _remembered(self) -> Iterator[tuple[str, wp.array]]:
        """Arrays that a step leaves to the next one, by name."""
        for name, array in members("history", self._history):
            if array.ptr:
                yield name, array
        if self.settings.second_order:
            yield "worlds.step", self._worlds.step
        if self._work.put_from is not None:
            yield "work.put_from", self._work.put_from
        for name, joints in (("tree", self._tree), ("loops", self._loops)):
            # where joints to kinematic bodies were before those are put elsewhere
            if joints.coordinate is not None:
                yield f"{name}.coordinate", joints.coordinate
        if self._flags.fourth_order:
            for name in ("is_known", "waits", "left_q", "left_qd", "ball_start", "rate"):
                yield f"tree.runge_kutta.{name}", getattr(self._tree.runge_kutta, name)
        if self._flags.welds:
            yield "links.body_q_out", self._solved.links.body_q_out
            yield "links.body_qd_out", self._solved.links.body_qd_out
            yield "links.left_qd", self._solved.links.left_qd
        if self._large is not None:
            yield "colors.color", self._large.colors.color
        if self._activations.size:
            yield "actuators.activation", self._activations
        if self._actuation is not None:
            yield from self._actuation.remembered()
        if self._cables is not None:
            yield from self._cables.remembered()
        if self.writes_joint_state:
            yield from self._joint_state.remembered()

    def notify_model_changed(self, flags: ModelFlags | int) -> None:
        """Look again at what the model calls for.

        Arrays of the model are read live, so changing their values needs no call, except where
        bodies sleep, which this call wakes, and where it calls for what the scene did without: an
        effect that the kernels were not compiled with (friction, restitution, unequal moments of
        inertia, drives, limits, ...), or a body that starts or stops to move. New arrays in the
        place of old ones, and new initial joint coordinates, need one, too, and so do coefficients
        of mimic joints, frames of welds, modes of drives that are MuJoCo's actuators, armature that
        actuators add, masses by which a fluid drags, and COMs of links that Newton's tendons hang
        on. The call checks the model as the constructor does and copies its arrays to the host.

        While a graph is being captured the call reads nothing: it compiles in all effects that
        values can call for, save restitution, friction by written poses, force ranges of several
        actuators of an axis and the impedance of limits of MJCF files, which need buffers.
        Bodies that start to move at joints then need another call outside of the capture, and a new
        capture; a replay says so where it happens.

        Args:
            flags: What changed; every flag leads to the same, unknown bits are ignored.

        Raises:
            NotImplementedError: If the model now holds what the solver does not simulate and the
                solver is strict.
            ValueError: If a number in the model makes no sense.
        """
        if not int(flags) & int(ModelFlags.ALL):
            return
        if not self.device.is_capturing:
            if self._has_other_bodies():
                self._check_again(flags)
                self._make_arrays_anew()
                return
            if isinstance(self._solved, SolvedModel):
                self._solved.reread()
        self._refresh_solved()
        self._bind_model()
        if self._flags.fourth_order:
            self._tree.runge_kutta.is_known.zero_()
        if self._flags.sleeping:
            for array, value in ((self._sleep.still, 0.0), (self._sleep.woken, 1)):
                array.fill_(value)
            self._sleep.stirred.fill_(1)
        if self.device.is_capturing:
            self._flags = self._flags.for_any_values().leaving_out(self._without)
            self._flags_apart = self._flags.without_contact()
            if self._solved.body_count:
                self._launch_bodies(report_freed, [self._bodies, self._taken_as_fixed])
            return
        self._check_again(flags)
        if self._cables is not None:
            self._cables.refresh(self._solved, self._launch)
        self._rest_angle.assign(self._initial_angles())
        self._group_worlds()

    def _check_again(self, flags: ModelFlags | int) -> None:
        """Refuses what makes no sense, and names what the solver leaves out of what is new."""
        check_model(self.model, ramp=self.settings.ramp)
        if int(flags) & int(ModelFlags.CONSTRAINT_PROPERTIES | ModelFlags.ACTUATOR_PROPERTIES):
            self._report_ignored(self.model, own_rows=self._joined.own_rows)

    def unnoticed_changes(self) -> list[str]:
        """What of the model has changed and no step will see before :meth:`notify_model_changed`.

        Looks at the model as the constructor does, on the host: for when a result is in doubt.

        Returns:
            Names of effects that the kernels do not hold, ``"actuators"`` also where drives that
            are actuators have other modes, ``"topology"`` where other bodies move or other joints
            hold, and arrays of the model that stand in the place of others.
        """
        if self._has_other_bodies():
            return ["topology"]
        solved: Any = self._solved
        if isinstance(solved, SolvedModel):
            if solved.has_other_masses():
                return ["topology"]
            solved = solved.weighed()
        _, topology, flags, _ = self._look_at_model(solved)
        missing = self._flags.missing(flags)
        if self._actuation is not None and self._actuation.has_other_drives():
            missing.append("actuators")
        return [
            *missing,
            *(["topology"] if topology != self._topology else []),
            *(
                f"model.{name}"
                for name, array in self._bound.items()
                if getattr(self.model, name) is not array
            ),
        ]

    def set_collision_frequency(
        self,
        *,
        collision_frequency: Mapping[SolverBase.CollisionSlot, int] | None = None,
        collision_frequency_type: Mapping[
            SolverBase.CollisionSlot, SolverBase.CollisionFrequencyType
        ]
        | None = None,
    ) -> None:
        """As in :class:`newton.solvers.SolverBase`; the owned pipeline runs once a step or never.

        Raises:
            NotImplementedError: If detection is to run inside the iterations.
        """
        Frequency = SolverBase.CollisionFrequencyType
        rigid = (collision_frequency_type or {}).get(SolverBase.CollisionSlot.RIGID, Frequency.AUTO)
        if rigid in (Frequency.PRE_POST_INIT, Frequency.ITERATIONS):
            raise NotImplementedError(
                f"SolverAVBD detects collisions at the start of a step (PRE_INIT) or not at all "
                f"(NONE), not {Frequency(rigid).name}."
            )
        super().set_collision_frequency(
            collision_frequency=collision_frequency,
            collision_frequency_type=collision_frequency_type,
        )

    def update_contacts(self, contacts: newton.Contacts, state: newton.State | None = None) -> None:
        """Write the contact forces of the last step to ``contacts.force``.

        Deprecated in Newton in favour of the observable ``contact_f``.

        Args:
            contacts: The contacts of the last step, with ``force`` allocated: [N, N m], shape
                (rigid_contact_max + soft_contact_max,), spatial_vector.
            state: Not used.

        Raises:
            ValueError: If ``contacts.force`` was not requested.
        """
        del state
        if contacts.force is None:
            raise ValueError(
                "contacts.force is not allocated; call model.request_contact_attributes('force') "
                "before creating the contacts, or use the observable 'contact_f'."
            )
        self._export_contact_force(contacts.force, contacts)

    @property
    def _owns_detection(self) -> bool:
        """Whether this step runs the owned pipeline."""
        scheduled = self._resolved_collision_frequency_type(SolverBase.CollisionSlot.RIGID)
        return scheduled == SolverBase.CollisionFrequencyType.PRE_INIT

    def _check_step(
        self,
        state_in: newton.State,
        state_out: newton.State,
        contacts: newton.Contacts | None,
        dt: float,
    ) -> None:
        if not (dt > 0.0 and np.isfinite(dt)):
            raise ValueError(f"dt must be a positive number of seconds, got {dt}.")
        count = self.model.body_count
        for name, arrays in (
            ("state_in", (state_in.body_q, state_in.body_qd, state_in.body_f)),
            ("state_out", (state_out.body_q, state_out.body_qd)),
        ):
            for array in arrays if count else ():
                if array is None or array.shape[0] != count:
                    raise ValueError(
                        f"{name} holds no bodies or those of another model; the solver's model has "
                        f"{count}. Create it with model.state()."
                    )
                if array.device is not self.device:
                    raise ValueError(
                        f"{name} is on device {array.device}, the solver on {self.device}."
                    )
        if contacts is not None and contacts.device != self.device:
            raise ValueError(
                f"contacts are on device {contacts.device}, the solver on {self.device}."
            )

    def _export_contact_force(
        self,
        contact_f: wp.array,
        contacts: newton.Contacts | None,
        *,
        of_last_inner_step: bool = False,
    ) -> None:
        """Wrenches of contacts over the call, or with error control of its last inner step."""
        contact_f.zero_()
        if self._capacity and self._flags.adaptive and not of_last_inner_step:
            self._launch_bodies(export_mean_force, [contact_f, self._context()])
        elif self._capacity:
            self._launch_bodies(export_contact_force, [self._work, self._rows, contact_f])
        if self._flags.sleeping and contacts is not None:
            source = self._contact_input(contacts)
            self._launch(
                export_sleeping_force, source.capacity, [source, contact_f, self._context()]
            )
        if self._flags.welds and contacts is not None:
            source = self._contact_input(contacts)
            links, pose = self._solved.links, self._work.pose
            self._launch(
                refer_contact_force,
                source.capacity,
                [links, self.model.shape_body, source, pose, contact_f],
            )

    def _export_weld_force(
        self,
        body_parent_f: wp.array,
        state_in: newton.State | BodyState,
        contacts: newton.Contacts | None,
        dt: float,
    ) -> None:
        """The wrench that each link gets through its inbound joints, welds among them."""
        model, solved = self._joined.whole, self._solved
        assert isinstance(solved, SolvedModel)
        if self._weld_loads is None:
            with wp.ScopedDevice(self.device):
                self._weld_loads = solved.loads()
                self._weld_joint_f = wp.zeros(solved.joint_count, dtype=wp.spatial_vector)
        loads, links = self._weld_loads, solved.links
        self._weld_joint_f.zero_()
        self._export_parent_force(self._weld_joint_f, contacts)
        given = [model.body_world, model.gravity, state_in.body_f, dt, self._worlds]
        self._launch_links(load_links, [links, *given, loads, body_parent_f])
        if contacts is not None:
            source = self._contact_input(contacts)
            if self._weld_contact_f is None or self._weld_contact_f.shape[0] < source.capacity:
                self._retired.append((self._weld_contact_f,))
                with wp.ScopedDevice(self.device):
                    shape = (source.capacity,)
                    self._weld_contact_f = wp.zeros(shape, dtype=wp.spatial_vector)
            contact_f = self._weld_contact_f
            self._export_contact_force(contact_f, contacts, of_last_inner_step=True)
            pose = self._work.pose
            self._launch(
                load_by_contacts,
                source.capacity,
                [links, model.shape_body, source, pose, contact_f, loads],
            )
        pose = solved.result.body_q
        ends = [model.joint_parent, model.joint_child]
        self._launch(
            load_by_joints,
            solved.joint_count,
            [*ends, pose, self._weld_joint_f, loads, body_parent_f, self._step, self._context()],
        )
        self._launch(
            load_welds, 1, [links, model.joint_child, pose, self._worlds, loads, body_parent_f]
        )

    def _export_parent_force(
        self, body_parent_f: wp.array, contacts: newton.Contacts | None
    ) -> None:
        if not self._flags.sleeping:
            body_parent_f.zero_()
        if not self._flags.joints:
            return
        self._launch(
            make_export_parent_force(self._flags_with(contacts)),
            self._solved.body_count if self._flags.sleeping else self._world_count,
            [body_parent_f, self._step, self._seen_context()],
        )

    def _export_actuator_force(
        self, force: wp.array, state_out: newton.State, control: data.ControlInput
    ) -> None:
        if self._actuator_force is None:
            self._actuator_force = ActuatorForce(
                self.model,
                self._actuation,
                self._flags,
                self._joints.target_mode,
                self._history.joint_angle,
            )
        coordinates = None
        if self.writes_joint_state:
            coordinates = (state_out.joint_q, state_out.joint_qd)
        self._actuator_force.export(
            self._launch,
            state_out,
            coordinates,
            control,
            self._joints,
            self._solved.joint_count,
            self._history,
            force,
        )

    def _launch_bodies(self, kernel: wp.Kernel, arguments: list) -> None:
        """Launches a kernel with one thread a body."""
        self._launch(kernel, self._solved.body_count, arguments)

    def _launch_links(self, kernel: wp.Kernel, arguments: list) -> None:
        """Launches a kernel with one thread a link, that is a body of the model."""
        self._launch(kernel, self.model.body_count, arguments)


def _requested(*arrays: wp.array | None) -> list[wp.array]:
    """The arrays that exist: an observable's, and the deprecated one beside it."""
    return [array for array in arrays if array is not None]
