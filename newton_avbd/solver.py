# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""SolverAVBD: what a user calls. The physics is in ``rows`` and ``blocks``."""

import dataclasses
import warnings
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import newton
import numpy as np
import warp as wp
from newton import ModelFlags, StateFlags
from newton.solvers import SolverBase

from . import buffers, data, views
from .attributes import BREAK_LIMITS, break_limits, register_joint_attributes
from .checks import check_array, check_model, report_ignored
from .coupling import RigidCoupling
from .effects import Callers, Effects, SceneEffects, left_out, pushing_joints
from .execute.beginning import UNKNOWN
from .execute.bodies import (
    BODIES_PER_THREAD,
    make_integrate,
    make_predict,
    push_parents,
    report_freed,
)
from .execute.breaking import enable_joints
from .execute.contacts import make_sort_contacts, reset_bodies
from .execute.launch import Compiler, Launcher
from .execute.observables import (
    count_turns,
    export_acceleration,
    export_contact_force,
    make_export_parent_force,
)
from .execute.sleeping import (
    AWAKE,
    STILL,
    export_sleeping_force,
    make_end_islands,
    make_form_islands,
    make_watch_bodies,
    watch_joints,
)
from .execute.slopes import SCHEMES
from .execute.workers import Workers
from .execute.world import make_solve, make_step
from .large import LARGE, LargeWorlds, obstacles
from .memory import bytes_by_effect, members
from .report import Report, Status
from .rows.joint import KINDS, PUSHED_AT_COM
from .settings import Settings, register_scene_settings
from .topology import Topology, mimics

_BOUND = ("body_", "joint_", "shape_material_", "shape_body", "gravity")
"""How the arrays of a model begin that the kernels read."""
_CONTACT_ARRAYS = ("shape0", "shape1", "point0", "point1", "normal", "margin0", "margin1")
_EXTRA_CONTACT_ARRAYS = ("surface_velocity", "stiffness", "damping", "friction", "match_index")
"""Some buffers have these."""


class SolverAVBD(SolverBase, RigidCoupling):
    """Rigid bodies, joints and contacts by Augmented Vertex Block Descent.

    Backward Euler on pose increments, minimised block by block. A free body is a 6x6 block; the
    bodies that joints link into a tree, an articulation, are one block, solved exactly in time
    proportional to their number, so that accuracy does not depend on the length of a chain or on
    mass ratios along it. Contacts with Coulomb friction, and joints that close loops, are held by
    multipliers and a penalty scaled by the masses they couple. A step is a pure function of
    ``state_in``, ``control``, ``contacts`` and what is remembered of the last step.

    Contacts and joints are rigid, as in :class:`newton.solvers.SolverXPBD` and ``SolverMuJoCo``;
    with ``compliant_contacts`` contacts and joint limits give way by the stiffness and damping
    that the model authors. Supported: all types of joints, drives, limits, kinematic bodies, all
    shapes that Newton's collision pipeline handles, any number of worlds.

    Sources: Giles, Diaz, Yuksel, "Augmented Vertex Block Descent", 2025; "Rigid Body Dynamics with
    VBD, Section I: Free Bodies"; Featherstone, "Rigid Body Dynamics Algorithms", 2008; ``docs/``
    says where this solver departs from them, and why.
    """

    supports_collision_pipeline = True
    supports_body_pair_reduced_contacts = True
    SUPPORTED_OBSERVABLES = frozenset(
        {
            SolverBase.ObservableKind.BODY_QDD,
            SolverBase.ObservableKind.BODY_PARENT_F,
            SolverBase.ObservableKind.CONTACT_F,
        }
    )

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
        scheme: Literal["euler", "bdf2", "generalized_alpha"] | None = None,
        blocks: Literal["articulation", "body"] | None = None,
        parallel: Literal["worlds", "bodies"] | None = None,
        sleeping: bool | None = None,
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
            model: The model. Its arrays are read live in every step; after changing which bodies
                move, masses, or materials call :meth:`notify_model_changed`.
            iterations: Most sweeps over the bodies in each step, 10 by default: more for taller
                stacks and larger mass ratios. The first three steps after a reset, and those in
                which impacts go through piles of free bodies, take up to four times as many.
            tolerance: A world's sweeps end early when one moves no body by more than this [m], a
                turn counted by its radius of gyration; with 0, the default, only where nothing
                moves any more.
            compliant_contacts: Contacts give way by the shapes' ``ke`` [N/m] and ``kd`` [N s/m]
                (their means over the two shapes) instead of being rigid, which is the default, and
                joint limits by their ``limit_ke`` and ``limit_kd``.
            friction_mix_mode: How the friction coefficients of two shapes make that of their
                contact. ``"geometric_average"``, the default, as in ``SolverVBD``, ``"average"``
                as in ``SolverXPBD``, ``"max"`` as in MuJoCo. Restitution is always the average.
            angular_friction: Contacts resist twisting and rolling by the shapes' ``mu_torsional``
                and ``mu_rolling`` [m]. Newton gives some to every shape, and importers copy what
                MuJoCo ignores by default, so that this is for the user to ask for; None leaves it
                out and warns where a shape has other values than Newton's default.
            formulation: ``"augmented"`` (multipliers), the default, or ``"ramp"``: the seed
                document's growing penalty up to the shapes' ``ke``, for comparison.
            scheme: ``"euler"``, backward Euler, the default, or of second order in time where the
                motion is smooth, with far less numerical damping: ``"generalized_alpha"`` or
                ``"bdf2"``, which has three times its error and damps what is too fast for the step
                at once. Steps in which a velocity of a world jumps stay backward Euler.
            blocks: What is solved at once: ``"articulation"``, the default, the tree that joints
                make of bodies, or ``"body"``, each body by itself, for comparison.
            parallel: What the threads of a device share: ``"worlds"``, one thread a world, or
                ``"bodies"``, all blocks of a color at once, for large worlds; a block is then a
                free body or an articulation. None, the default, takes bodies on a GPU where a world
                has at least 256, no restitution and no joints that break, and neither ``sleeping``
                nor a ``scheme`` of second order is asked for.
            sleeping: Islands, what contacts and joints link, are not solved any more once all their
                bodies have been at rest for half a second, until something touches or drives them
                or their state, forces or gravity change; see :attr:`status`. Each is solved for
                itself. None for not.
            effects: Effects of the scene to leave out, as ``{"friction": False}``; True for those
                that are to be there, which raises where nothing calls for them. For their names
                and what calls for each see :attr:`effects`.
            update_joint_state: Each step writes ``state_out.joint_q`` and ``joint_qd``, too, with
                the turns of hinges counted; without it only poses and velocities of bodies.
            strict: What the model holds and this solver does not simulate (particles, cloth,
                tendons, ...) is an error instead of a warning.
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
        )
        if parallel not in (None, "worlds", "bodies"):
            raise ValueError(f"parallel must be 'worlds', 'bodies' or None, got {parallel!r}.")
        self._ramp = settings.formulation == "ramp"
        self._strict = strict
        check_model(model, ramp=self._ramp)
        report_ignored(
            model,
            strict=strict,
            rigid_contacts=not (self._ramp or settings.compliant_contacts),
            angular_friction=settings.angular_friction or angular_friction,
        )
        super().__init__(
            model,
            collision_pipeline=collision_pipeline,
            collision_frequency=collision_frequency,
            collision_frequency_type=collision_frequency_type,
        )
        self._launch = Launcher(self.device)
        self._predictors, self._workers = Workers(workers), Workers(workers)
        self.settings = settings
        """What the arguments and the scene say, as arguments of a solver that does the same."""
        self.iterations = settings.iterations
        self.tolerance = float(settings.tolerance)
        self._flags: Effects
        self._callers: Callers
        self._without = left_out(effects or {})
        self._compliance = settings.compliant_contacts
        self._scheme = settings.scheme
        self._bdf2 = settings.scheme in SCHEMES
        self._blocks = settings.blocks
        self._sleeping = settings.sleeping
        self._sleep = data.SleepWork()
        self._seen: _Seen | None = None
        self._seen_worlds = data.WorldWork()
        self._seen_history = data.History()
        self._friction_mix = settings.friction_mix_mode
        self._angular_friction = settings.angular_friction
        self.writes_joint_state = update_joint_state and model.joint_count > 0
        if self.writes_joint_state:
            self._all_joints = _AllJoints(model)
        """Whether ``step`` writes the joint coordinates of ``state_out``."""
        self._parallel = parallel
        self._large: LargeWorlds | None = None
        self._colors: data.ColorWork | None = None
        self._topology: Topology | None = None
        self._worlds: data.WorldWork
        self._retired: list[tuple] = []
        self._moving_surfaces = False
        self._is_told = False
        self._inputs: weakref.WeakKeyDictionary[newton.Contacts, data.ContactInput] = (
            weakref.WeakKeyDictionary()
        )
        self._buffer_count = 0
        self._capacity = 0
        self._allocate_bodies()
        self._bind_model()
        self._group_worlds()
        self._callers.require((name for name, on in (effects or {}).items() if on), self._flags)
        if self._flags.contact and self.contacts is not None:
            self._contact_input(self.contacts)
        elif self._flags.contact and model.rigid_contact_max:
            self._allocate_contacts(model.rigid_contact_max)

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
            state_in: State to start from; ``body_q``, ``body_qd`` and ``body_f`` are read. A
                kinematic body moves at its ``body_qd``; where that is zero, friction sees how its
                pose has been written since the last step.
            state_out: State to write ``body_q`` and ``body_qd`` to, and the joint coordinates with
                ``update_joint_state``; may be ``state_in``.
            control: ``joint_f``, ``joint_target_q`` and ``joint_target_qd``; None for the model's
                own.
            contacts: Contacts of this or an earlier collision pass, or None for no contacts
                (or where the solver owns a pipeline).
            dt: Time step [s].
            observables: Arrays of :meth:`observables` to fill.

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
        needs_solve = self._flags.joints or self._flags.bdf2 or self._flags.sleeping
        if contacts is None and not needs_solve:
            self._integrate(state_in, state_out, control_input, dt)
        else:
            self._solve(state_in, state_out, control_input, contacts, dt)
        if contacts is None and self._work.put_from is not None:
            self._work.put_from.zero_()

        for body_qdd in accelerations:
            self._launch_bodies(export_acceleration, [state_out.body_qd, dt, body_qdd])
        for contact_f in _requested(
            observables and observables.contact_f, contacts and contacts.force
        ):
            self._export_contact_force(contact_f, contacts)
        for body_parent_f in _requested(
            observables and observables.body_parent_f, state_out.body_parent_f
        ):
            self._export_parent_force(body_parent_f, state_out, control_input, contacts, dt)
        if self.writes_joint_state:
            self._write_joint_state(state_out)

    def _integrate(
        self,
        state_in: newton.State,
        state_out: newton.State,
        control: data.ControlInput,
        dt: float,
    ) -> None:
        """The step where nothing touches: one kernel, exact."""
        self._launch_bodies(
            make_integrate(self._flags),
            [
                self._bodies,
                state_in.body_q,
                state_in.body_qd,
                state_in.body_f,
                control,
                dt,
                self._worlds,
                state_out.body_q,
                state_out.body_qd,
            ],
        )

    def _solve(
        self,
        state_in: newton.State,
        state_out: newton.State,
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
                self.model.joint_count,
                [self.model.joint_enabled, self._history.broken, self._joints.enabled],
            )
        seen = self._see_worlds()
        after_prediction = [
            source,
            dt,
            self.iterations,
            self.tolerance,
            seen.worlds,
            self._work,
            self._rows,
            seen.tree,
            seen.loops,
            self._islands,
            seen.history,
            state_out.body_q,
            state_out.body_qd,
        ]
        model = [self._bodies, self._shapes, self._joints, control]
        if self._at_once:
            given = [state_in.body_q, state_in.body_qd, state_in.body_f]
            self._launch(make_step(effects), 1, [*model, *given, *after_prediction])
            return
        if effects.sleeping:
            self._form_islands(seen, effects, state_in, state_out, control, source, dt)
        each = BODIES_PER_THREAD if self.device.is_cpu else 1
        self._launch(
            make_predict(self._flags, each),
            -(-self.model.body_count // each),
            [
                0,
                self._bodies,
                state_in.body_q,
                state_in.body_qd,
                state_in.body_f,
                control,
                dt,
                self._worlds,
                self._history.falling,
                self._tree.joint,
                self._work,
            ],
            self._predictors if self._world_count > 1 else None,
        )
        if effects.reaction:
            self._launch(
                push_parents,
                1,
                [self._bodies, self._joints, control, dt, self._pushing, self._work],
            )
        arguments = [*model, self._work.pose, state_in.body_qd, *after_prediction]
        if self._large is not None:
            self._large.solve(self._launch, effects, arguments)
            return
        if contacts is not None:
            self._launch(
                make_sort_contacts(effects.sleeping),
                1,
                [self._shapes, source, seen.worlds, self._work, self._rows],
            )
        threads = seen.worlds.threads if effects.sleeping else self._world_count
        workers = None if effects.sleeping else self._workers
        self._launch(make_solve(effects), threads, [0, *arguments], workers)
        if effects.sleeping:
            self._launch(
                make_end_islands(effects),
                self._world_count,
                [self._worlds, seen.worlds, self._history, seen.history],
            )

    def _form_islands(
        self,
        seen: "_Seen",
        effects: Effects,
        state_in: newton.State,
        state_out: newton.State,
        control: data.ControlInput,
        contacts: data.ContactInput,
        dt: float,
    ) -> None:
        """Finds out what sleeps, passes it on, and lists the rest island by island."""
        self._launch_bodies(
            make_watch_bodies(self._flags),
            [
                self._bodies,
                state_in.body_q,
                state_in.body_qd,
                state_in.body_f,
                control,
                dt,
                self._worlds,
                self._sleep,
                state_out.body_q,
                state_out.body_qd,
            ],
        )
        if effects.joints:
            self._launch(
                watch_joints,
                self.model.joint_count,
                [self._joints, control, self._worlds, self._sleep],
            )
        self._launch(
            make_form_islands(effects),
            1,
            [
                self._bodies,
                self._shapes,
                state_in.body_q,
                contacts,
                self._worlds,
                seen.worlds,
                self._rows,
                self._sleep,
                self._history,
                seen.history,
                state_out.body_q,
                state_out.body_qd,
            ],
        )

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
        """Every effect: on or off, why, and what memory it takes; ``print`` it for a table.

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
    def parallel(self) -> Literal["worlds", "bodies"]:
        """What the threads of the device share."""
        return "worlds" if self._large is None else "bodies"

    @property
    def status(self) -> Status:
        """What happened so far; copies a few numbers from the device."""
        colors, clashes = (0, 0) if self._large is None else self._large.found()
        return Status(
            colors=colors,
            clashes=clashes,
            held_steps=self._worlds.held.numpy().copy(),
            repaired_poses=self._worlds.repaired.numpy().copy(),
            sweeps=self._worlds.sweeps.numpy().copy(),
            update=self._worlds.update.numpy().copy(),
            sleeping_bodies=int(
                0 if self._worlds.island is None else np.sum(self._worlds.island.numpy() >= 0)
            ),
            broken_joints=np.flatnonzero(
                [] if self._history.broken is None else self._history.broken.numpy()
            ),
            contact_overflow=int(self._worlds.overflow.numpy()[0]),
            dropped_contacts=int(self._worlds.dropped.numpy()[0]),
        )

    def report(self) -> Report:
        """Sweeps and residual of each world in the last step; copies them from the device.

        Print it for a table, for instance to choose ``iterations`` and ``tolerance``.
        """
        sweeps, update = self._worlds.sweeps.numpy(), self._worlds.update.numpy()
        h, order = self._history.step.numpy(), np.ones_like(sweeps)
        if self._bdf2:
            order += self._worlds.step.numpy() < h
        allowed = np.maximum(self.tolerance, self._worlds.settled.numpy())
        return Report(sweeps.copy(), update.copy(), allowed, order)

    def reset(
        self,
        state: newton.State,
        world_mask: wp.array | None = None,
        flags: StateFlags | int | None = None,
    ) -> None:
        """Put worlds back to the model's initial poses and forget their contacts, on the device.

        Args:
            state: State to modify: ``body_q`` and ``body_qd``, as ``flags`` say.
            world_mask: Which worlds, shape ``(world_count + 1,)``; the last entry is for global
                bodies. None for all.
            flags: What to put back; None for all. Multipliers are always forgotten.
        """
        mask = self._normalize_reset_world_mask(world_mask)
        if self.model.body_count == 0:
            return
        if self._large is not None:
            empty = self._no_mask if mask is None else mask
            self._large.forget(self._launch, self.model.body_world, empty)
        model = self.model
        self._launch_bodies(
            reset_bodies,
            [
                model.body_world,
                model.body_q,
                model.body_qd,
                self._no_mask if mask is None else mask,
                int(StateFlags.BODY_Q | StateFlags.BODY_QD) if flags is None else int(flags),
                self._worlds,
                self._joints,
                self._tree,
                self._loops,
                self._rest_angle,
                self._sleep,
                self._work,
                self._history,
                state.body_q,
                state.body_qd,
            ],
        )

    def checkpoint(self) -> dict[str, np.ndarray]:
        """What is remembered of the last step, on the host.

        With the state that the step wrote it is all that a run needs to go on to the same bits, in
        this solver or in another one of an equal model with equal settings and contact buffers.

        Returns:
            Copies of the solver's arrays, by name.
        """
        return {name: array.numpy().copy() for name, array in self._remembered()}

    def restore(self, checkpoint: Mapping[str, np.ndarray]) -> None:
        """Remember what :meth:`checkpoint` returned, instead of the last step.

        Args:
            checkpoint: Arrays by name.

        Raises:
            ValueError: If they are those of a solver of another model, with other settings or for
                other contact buffers.
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

    def _remembered(self) -> Iterator[tuple[str, wp.array]]:
        """Arrays that a step leaves to the next one, by name."""
        for name, array in members("history", self._history):
            if array.ptr:
                yield name, array
        if self._bdf2:
            yield "worlds.step", self._worlds.step
        if self._work.put_from is not None:
            yield "work.put_from", self._work.put_from
        if self._large is not None:
            yield "colors.color", self._large.colors.color

    def notify_model_changed(self, flags: ModelFlags | int) -> None:
        """Look again at what the model calls for.

        Arrays of the model are read live, so changing their values needs no call, except where
        bodies sleep, which this call wakes, and where it
        calls for what the scene did without: an effect that the kernels were not compiled with
        (friction, restitution, unequal moments of inertia, drives, limits, ...), or a body that
        starts or stops to move. New arrays in the place of old ones, and new initial joint
        coordinates, need one, too. The call checks the model as the constructor does and copies its
        arrays to the host.

        While a graph is being captured the call reads nothing: it compiles in all effects that
        values can call for, save restitution and friction by written poses, which need buffers.
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
        self._bind_model()
        if self._flags.sleeping:
            for array, value in ((self._sleep.still, 0.0), (self._sleep.woken, 1)):
                array.fill_(value)
            self._sleep.stirred.fill_(1)
        if self.device.is_capturing:
            self._flags = self._flags.for_any_values().leaving_out(self._without)
            self._flags_apart = self._flags.without_contact()
            if self.model.body_count:
                self._launch_bodies(report_freed, [self._bodies, self._taken_as_fixed])
            return
        check_model(self.model, ramp=self._ramp)
        if int(flags) & int(ModelFlags.CONSTRAINT_PROPERTIES | ModelFlags.ACTUATOR_PROPERTIES):
            report_ignored(self.model, strict=self._strict)
        self._rest_angle.assign(self._initial_angles())
        self._group_worlds()

    def unnoticed_changes(self) -> list[str]:
        """What of the model has changed and no step will see before :meth:`notify_model_changed`.

        Looks at the model as the constructor does, on the host: for when a result is in doubt.

        Returns:
            Names of effects that the kernels do not hold, ``"topology"`` where other bodies move or
            other joints hold, and arrays of the model that stand in the place of others.
        """
        _, topology, flags, _ = self._look_at_model()
        return [
            *self._flags.missing(flags),
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
            contacts: The contacts of the last step, with ``force`` allocated.
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

    # Buffers, and what the kernels see of the model.

    def _allocate_bodies(self) -> None:
        """Buffers by body slot; the last slot is the static world, which stays zero."""
        model = self.model
        slots = model.body_count + 1
        free_dof = np.full(model.body_count, -1, dtype=np.int32)
        if model.joint_count:
            kinds = model.joint_type.numpy()
            free = np.isin(kinds, [int(kind) for kind in PUSHED_AT_COM])
            free_dof[model.joint_child.numpy()[free]] = model.joint_qd_start.numpy()[:-1][free]
        self._no_contacts = data.ContactInput()
        self._control = data.ControlInput()
        self._control_arrays: tuple[wp.array | None, ...] = (None, None, None)
        with wp.ScopedDevice(self.device):
            self._no_mask = wp.empty(0, dtype=wp.bool)
            self._free_dof = wp.array(free_dof, dtype=wp.int32)
            self._pushing = wp.array(pushing_joints(model), dtype=wp.int32)
            self._work = buffers.body_work(slots, self._bdf2)
            self._islands = buffers.island_work(slots)
            self._rows = buffers.row_work(slots)
            self._history = buffers.history(model, self._bdf2)
            self._rest_angle = wp.array(self._initial_angles(), dtype=float)

    def _initial_angles(self) -> np.ndarray:
        """Coordinate of each joint axis in the model, with its turns, shape (joint_dof_count,)."""
        model = self.model
        angles = np.zeros(model.joint_dof_count, dtype=np.float32)
        if model.joint_count:
            joint_q, types = model.joint_q.numpy(), model.joint_type.numpy().tolist()
            q_start, qd_start = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
            for joint in np.flatnonzero([KINDS[kind].has_axes for kind in types]):
                count = qd_start[joint + 1] - qd_start[joint]
                angles[qd_start[joint] :][:count] = joint_q[q_start[joint] :][:count]
        return angles

    def _bind_model(self) -> None:
        """Points the kernels to the model's arrays."""
        self._forget_launches()
        model = self.model
        self._bound = {
            name: array
            for name, array in vars(model).items()
            if name.startswith(_BOUND) and isinstance(array, wp.array)
        }
        self._bodies = views.body_model(model, self._free_dof)
        self._joints = views.joint_model(model)
        self._shapes = views.shape_model(model)
        if model.constraint_mimic_count:
            if not self.device.is_capturing:
                _, coefficients = mimics(model)
                self._mimics = wp.array(coefficients, dtype=wp.vec2, device=self.device)
            self._joints.mimic_coefficients = self._mimics
        if model.joint_count:
            self._bind_break_limits()

    def _bind_break_limits(self) -> None:
        """Joints that can break are enabled by an array of the solver's own."""
        if not self.device.is_capturing:
            left = "breaking" in self._without
            self._break_limits = {} if left else break_limits(self.model)
        if not self._break_limits:
            return
        if self._history.broken is None:
            count = self.model.joint_count
            with wp.ScopedDevice(self.device):
                self._history.broken = wp.zeros(count, dtype=wp.bool)
                self._is_whole = wp.zeros(count, dtype=wp.bool)
                self._unbreakable = wp.full(count, float("inf"), dtype=float)
        names = list(BREAK_LIMITS)
        self._joints.break_force = self._break_limits.get(names[0], self._unbreakable)
        self._joints.break_torque = self._break_limits.get(names[1], self._unbreakable)
        self._joints.enabled = self._is_whole

    def _look_at_model(self) -> tuple[np.ndarray, Topology, Effects, Callers]:
        """Which world each body belongs to, what is solved together, and with which effects."""
        groups = _solver_worlds(self.model)
        topology = Topology.of_model(self.model, groups, trees=self._blocks == "articulation")
        flags, callers = Effects.of_model(
            self.model,
            topology,
            piles=self._blocks == "articulation",
            compliance=self._compliance,
            ramp=self._ramp,
            friction_mix=self._friction_mix,
            angular_friction=self._angular_friction,
            scheme=self._scheme,
            sleeping=self._sleeping,
            without=self._without,
        )
        if self._takes_bodies(groups, flags):
            flags = flags.leaving_out(frozenset({"piles"}))
        return groups, topology, flags, callers

    def _takes_bodies(self, groups: np.ndarray, flags: Effects) -> bool:
        """Whether the bodies are solved color by color, as one large world.

        Raises:
            NotImplementedError: If that is asked for and cannot be.
        """
        if self._parallel == "worlds" or not flags.contact:
            return False
        if self._parallel is None:
            largest = np.bincount(groups).max(initial=0)
            if not self.device.is_cuda or largest < LARGE:
                return False
        found = obstacles(flags)
        if found and self._parallel == "bodies":
            raise NotImplementedError(
                f"parallel='bodies' solves bodies and joints color by color, without "
                f"{' and '.join(found)}, which this model has. Leave parallel out."
            )
        return not found

    def _group_worlds(self) -> None:
        """Decides which bodies one thread solves, and with which effects.

        A group is a Newton world, or, where global bodies that move tie the worlds together, all
        bodies at once.
        """
        groups, topology, self._flags, self._callers = self._look_at_model()
        self._flags_apart = self._flags.without_contact()
        if self._flags.put_bodies and self._work.put is None:
            self._forget_launches()
            with wp.ScopedDevice(self.device):
                buffers.add_put_work(self._work)
        elif not self._flags.put_bodies and self._work.put is not None:
            self._work.put_from.zero_()
        if self._capacity:
            self._allocate_contact_effects()
        if not self._flags.armature and self._history.axis_velocity is not None:
            self._history.axis_velocity.fill_(UNKNOWN)
        is_large = self._takes_bodies(groups, self._flags)
        # one kernel makes the whole step of a single world, where launches cost most
        is_special = is_large or self._flags.sleeping or self._flags.reaction
        self._at_once = self.device.is_cpu and not (is_special or groups.any())
        if topology == self._topology and is_large == (self._large is not None):
            return
        if self._topology is not None:
            self._forget_contacts()
            # graphs that were captured before go on using the old arrays
            self._retired.append((self._worlds, self._history.parity))
            self._retired.append((self._history.filling, self._history.step, self._history.age))
            self._retired.append((self._tree, self._loops, self._history.smooth))
            self._retired.append((self._history.loop_force, self._history.loop_torque))
        self._forget_launches()
        self._topology = topology
        self._world_count = int(groups.max(initial=0)) + 1
        starts = np.searchsorted(groups[topology.order], np.arange(self._world_count + 1))
        with wp.ScopedDevice(self.device):
            self._worlds = data.WorldWork()
            self._worlds.body_start = wp.array(starts, dtype=wp.int32)
            self._worlds.bodies = wp.array(topology.order, dtype=wp.int32)
            self._worlds.block_end = wp.array(np.append(topology.block_end, -1), dtype=wp.int32)
            self._worlds.rank = wp.array(
                np.append(topology.rank, topology.rank.size), dtype=wp.int32
            )
            self._worlds.of_body = wp.array(np.append(groups, -1), dtype=wp.int32)
            self._worlds.held = wp.zeros(self._world_count, dtype=wp.int32)
            self._worlds.sweeps = wp.zeros(self._world_count, dtype=wp.int32)
            self._worlds.update = wp.zeros(self._world_count, dtype=float)
            self._worlds.settled = wp.zeros(self._world_count, dtype=float)
            self._worlds.overflow = wp.zeros(1, dtype=wp.int32)
            self._worlds.dropped = wp.zeros(1, dtype=wp.int32)
            self._worlds.repaired = wp.zeros(self._world_count, dtype=wp.int32)
            # bodies that would be grouped otherwise, and joints held, if these bodies moved
            self._taken_as_fixed = wp.array(
                topology.idle | (groups == self.model.world_count), dtype=wp.bool
            )
            self._history.parity = wp.zeros(self._world_count, dtype=wp.int32)
            self._history.filling = wp.zeros((self._world_count, 2), dtype=wp.int32)
            self._history.step = wp.zeros(self._world_count, dtype=float)
            self._history.age = wp.zeros(self._world_count, dtype=wp.int32)
            if self._bdf2:
                self._worlds.step = wp.zeros(self._world_count, dtype=float)
                self._history.smooth = wp.zeros(self._world_count, dtype=wp.int32)
                self._history.slope_age = wp.zeros(self._world_count, dtype=float)

        self._retired.append((self._large,))
        self._large, self._colors = None, None
        self._allocate_piles()
        self._allocate_trees(topology)
        self._allocate_loops(topology, groups)
        self._allocate_closures(topology)
        if is_large:
            self._large = LargeWorlds(
                self._worlds, self._loops, topology, self.iterations, self.device
            )
            self._colors = self._large.colors
        if self._capacity:
            self._allocate_large_contacts()
        self._allocate_sleep()

    def _allocate_piles(self) -> None:
        """Buffers for the piles of free bodies."""
        if self._flags.piles:
            slots = self.model.body_count + 1
            count = slots if self._sleeping else self._world_count
            with wp.ScopedDevice(self.device):
                self._rows.piles = buffers.pile_work(slots, count)

    def _allocate_trees(self, topology: Topology) -> None:
        """Buffers for the trees of joints."""
        self._tree = data.TreeWork()
        if self._flags.joints:
            with wp.ScopedDevice(self.device):
                self._tree = buffers.tree_work(self.model, topology)
                if self._history.joint_force is None:
                    buffers.add_joint_history(self._history, self.model, self._rest_angle)

    def _allocate_loops(self, topology: Topology, groups: np.ndarray) -> None:
        """Buffers for the joints outside of trees."""
        self._loops = data.LoopWork()
        if self._flags.loops:
            with wp.ScopedDevice(self.device):
                self._loops = buffers.loop_work(self.model, topology, groups)
                self._history.loop_force = wp.zeros(topology.loops.size, dtype=wp.vec3)
                self._history.loop_torque = wp.zeros(topology.loops.size, dtype=wp.vec3)

    def _allocate_closures(self, topology: Topology) -> None:
        """Buffers for the equations that are solved with trees."""
        if self._flags.closures:
            joints = self._loops.joints.numpy().tolist() if self._flags.loops else []
            with wp.ScopedDevice(self.device):
                buffers.add_closures(self._tree.closures, topology, joints)

    def _allocate_sleep(self) -> None:
        """Buffers for what sleeps; all bodies are awake afterwards."""
        if not self._flags.sleeping:
            return
        # graphs that were captured before go on using the old arrays
        self._retired.append((self._sleep, self._worlds.island, self._worlds.pace))
        self._retired.append((self._rows.awake, self._rows.awake_count))
        self._retired.append((self._seen_worlds, self._seen_history))
        model, topology = self.model, self._topology
        assert topology is not None
        slots, capacity = model.body_count + 1, self._capacity
        with wp.ScopedDevice(self.device):
            island = np.append(np.full(slots - 1, AWAKE), STILL)
            self._worlds.island = wp.array(island, dtype=wp.int32)
            self._worlds.pace = wp.zeros(self._world_count, dtype=float)
            self._rows.awake = wp.zeros(capacity, dtype=wp.int32)
            self._rows.awake_count = wp.zeros(1, dtype=wp.int32)
            self._sleep = buffers.sleep_work(
                model, topology, self._flags, capacity, self._loops, self._tree
            )
            self._seen_worlds, self._seen_history = buffers.seen_work(
                slots, self._world_count, self._bdf2
            )
        self._forget_launches()

    def _forget_launches(self) -> None:
        """Drops what was packed, after a struct changed its arrays."""
        self._launch.forget()
        self._seen = None

    def _see_worlds(self) -> "_Seen":
        """What the solve sees as worlds: with sleeping, the islands that are awake."""
        if self._seen is None:
            seen = _Seen(self._worlds, self._history, self._tree, self._loops)
            if self._flags.sleeping:
                seen.worlds = data.merged(seen.worlds, self._seen_worlds)
                seen.history = data.merged(seen.history, self._seen_history)
            if self._flags.sleeping and self._flags.loops:
                seen.loops = data.merged(seen.loops)
                seen.loops.world_start = self._sleep.seen_loop_start
            if self._flags.sleeping and self._flags.closures:
                seen.tree = data.merged(seen.tree)
                seen.tree.closures.block_of = self._sleep.seen_block_of
            self._seen = seen
        return self._seen

    def _allocate_contacts(self, capacity: int) -> None:
        """Buffers by contact. Nothing in them needs a start value: what is live is kept by body."""
        capture = self.device.is_capturing
        if capture and (self._capacity or self.device.is_cuda):
            raise RuntimeError(
                f"SolverAVBD needs buffers for {capacity} contacts, which cannot be allocated "
                "while a graph is captured: create the collision pipeline before the solver, or "
                "take one step with these contacts first."
            )
        if self._capacity:
            self._forget_contacts()
            self._history.age.zero_()
            self._history.filling.zero_()
            # graphs that were captured before go on using the old arrays
            self._retired.append((self._rows.rows, self._rows.owner, self._rows.contacts))
            self._retired.append((self._rows.other_rows,))
            self._retired.append((self._history.records, self._history.row_of_contact))
        self._capacity = capacity
        with wp.ScopedDevice(self.device):
            self._rows.owner = wp.empty(capacity, dtype=wp.int32)
            self._rows.contacts = wp.empty(capacity, dtype=wp.int32)
            self._rows.rows = wp.empty(capacity, dtype=data.ContactRow)
            self._rows.other_rows = wp.empty(capacity, dtype=wp.int32)
            # what sleeps keeps its records beyond those of the rows
            room = 2 * capacity if self._sleeping else capacity
            self._history.records = wp.empty((buffers.SIDES, room), dtype=data.ContactRecord)
            self._history.row_of_contact = wp.empty((buffers.SIDES, capacity), dtype=wp.int32)
        self._allocate_large_contacts()
        self._allocate_contact_effects()
        self._allocate_sleep()

    def _allocate_large_contacts(self) -> None:
        """Buffers by contact of a large world."""
        if self._large is not None:
            self._retired.append(self._large.allocate_contacts(self._capacity))
            self._retired.append((self._rows.other_rows,))
            size = 2 * self._capacity
            self._rows.other_rows = wp.empty(size, dtype=wp.int32, device=self.device)

    def _allocate_contact_effects(self) -> None:
        """Buffers by contact that only some effects need, where they are missing or too small."""
        effects, rows, history = self._flags, self._rows, self._history
        by_contact: tuple[tuple[Any, str, Any, bool], ...] = (
            (rows, "drift", wp.vec3, self._moving_surfaces or effects.drift),
            (rows, "impacts", data.Impact, effects.restitution),
            (rows, "spin", data.SpinRow, effects.angular_friction),
            (history, "torque", wp.vec3, effects.angular_friction),
            (rows, "share", float, effects.compliance),
            (rows, "stiffness", float, effects.ramp),
            (rows, "damping", float, effects.ramp),
        )
        with wp.ScopedDevice(self.device):
            for owner, name, dtype, is_wanted in by_contact:
                old = getattr(owner, name)
                of_history = owner is history
                room = self._history.records.shape[1] if of_history else self._capacity
                if is_wanted and (old is None or old.shape[-1] < room):
                    # graphs that were captured before go on using the old array
                    self._retired.append((old,))
                    shape = [buffers.SIDES, room] if of_history else [room]
                    setattr(owner, name, wp.zeros(shape, dtype=dtype))
            if effects.restitution and rows.struck_qd is None:
                rows.struck_qd = wp.zeros(self.model.body_count + 1, dtype=wp.spatial_vector)
                rows.struck_at = wp.zeros(self.model.body_count + 1, dtype=float)
        self._forget_launches()

    def _forget_contacts(self) -> None:
        """Drops all multipliers and rows, on the device."""
        if self._capacity:
            for array in (
                self._history.start,
                self._history.end,
                self._rows.owned_start,
                self._rows.owned_end,
            ):
                array.zero_()

    def _contact_input(self, contacts: newton.Contacts) -> data.ContactInput:
        """What the kernels see of a contact buffer; made once for each buffer."""
        source = self._inputs.get(contacts)
        if source is not None:
            return source
        surfaces = contacts.rigid_contact_surface_velocity
        if "moving_surfaces" in self._without:
            surfaces = None
        new_surfaces = surfaces is not None and not self._moving_surfaces
        if contacts.rigid_contact_max > self._capacity or new_surfaces:
            self._moving_surfaces |= new_surfaces
            self._allocate_contacts(max(contacts.rigid_contact_max, self._capacity))
        for name in (*_CONTACT_ARRAYS, *_EXTRA_CONTACT_ARRAYS):
            array = getattr(contacts, f"rigid_contact_{name}")
            if array is not None or name in _CONTACT_ARRAYS:
                count = contacts.rigid_contact_max
                check_array(f"contacts.rigid_contact_{name}", array, count, self.device)
        self._buffer_count += 1
        source = views.contact_input(contacts, self._buffer_count, surfaces)
        self._inputs[contacts] = source
        return source

    def _control_input(self, source: newton.Control | newton.Model) -> data.ControlInput:
        """What the kernels see of the control; made anew only where its arrays are others."""
        arrays = (source.joint_f, source.joint_target_q, source.joint_target_qd)
        if all(a is b for a, b in zip(arrays, self._control_arrays, strict=True)):
            return self._control
        for name in ("joint_f", "joint_target_q", "joint_target_qd") if self._flags.joints else ():
            count = getattr(self.model, name).shape[0]
            check_array(f"control.{name}", getattr(source, name), count, self.device)
        self._control_arrays = arrays
        self._control = data.ControlInput()
        if arrays[0] is not None:
            self._control.joint_f = arrays[0]
        if arrays[1] is not None:
            self._control.target_q, self._control.target_qd = arrays[1], arrays[2]
        return self._control

    def _flags_with(self, contacts: newton.Contacts | None) -> Effects:
        """The scene's effects, with those that a contact buffer adds."""
        if contacts is None:
            # kernels of a large world are many, and find no contacts in no time
            return self._flags_apart if self._large is None else self._flags
        # large worlds find contacts again by their anchors
        matching = contacts.rigid_contact_match_index is not None and self._large is None
        surfaces = contacts.rigid_contact_surface_velocity is not None
        materials = contacts.rigid_contact_friction is not None
        if not (matching or surfaces or materials):
            return self._flags
        return dataclasses.replace(
            self._flags,
            matching=matching,
            moving_surfaces=surfaces,
            contact_materials=materials,
        ).leaving_out(self._without)

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

    def _export_contact_force(self, contact_f: wp.array, contacts: newton.Contacts | None) -> None:
        contact_f.zero_()
        if self._capacity:
            self._launch_bodies(export_contact_force, [self._work, self._rows, contact_f])
        if self._flags.sleeping and contacts is not None:
            source = self._contact_input(contacts)
            self._launch(
                export_sleeping_force,
                source.capacity,
                [
                    self._bodies,
                    self._shapes,
                    source,
                    self._worlds,
                    self._work,
                    self._sleep,
                    self._history,
                    contact_f,
                ],
            )

    def _export_parent_force(
        self,
        body_parent_f: wp.array,
        state_out: newton.State,
        control: data.ControlInput,
        contacts: newton.Contacts | None,
        dt: float,
    ) -> None:
        if not self._flags.sleeping:
            body_parent_f.zero_()
        if not self._flags.joints:
            return
        seen = self._see_worlds()
        self._launch(
            make_export_parent_force(self._flags_with(contacts)),
            self.model.body_count if self._flags.sleeping else self._world_count,
            [
                self._bodies,
                self._joints,
                control,
                dt,
                seen.worlds,
                self._work,
                self._rows,
                seen.tree,
                seen.loops,
                seen.history,
                state_out.body_qd,
                body_parent_f,
            ],
        )

    def _write_joint_state(self, state_out: newton.State) -> None:
        """Coordinates of all joints by the poses of their bodies, turns counted."""
        newton.eval_ik(self._all_joints, state_out, state_out.joint_q, state_out.joint_qd)
        self._launch(
            count_turns,
            self.model.joint_count,
            [self._joints, self._history, state_out.joint_q],
        )

    def _launch_bodies(self, kernel: wp.Kernel, arguments: list) -> None:
        """Launches a kernel with one thread a body."""
        self._launch(kernel, self.model.body_count, arguments)


@dataclass
class _Seen:
    """What the solve sees of worlds."""

    worlds: data.WorldWork
    history: data.History
    tree: data.TreeWork
    loops: data.LoopWork


class _AllJoints:
    """A model whose joints all belong to one articulation, which is what ``eval_ik`` evaluates."""

    def __init__(self, model: newton.Model) -> None:
        self._model = model
        self.articulation_start = wp.array([0], dtype=wp.int32, device=model.device)
        self.articulation_end = wp.array([model.joint_count], dtype=wp.int32, device=model.device)
        self.articulation_count = 1
        self.max_joints_per_articulation = model.joint_count

    def __getattr__(self, name: str) -> Any:
        return getattr(self._model, name)


def _requested(*arrays: wp.array | None) -> list[wp.array]:
    """The arrays that exist: an observable's, and the deprecated one beside it."""
    return [array for array in arrays if array is not None]


def _solver_worlds(model: newton.Model) -> np.ndarray:
    """Which world, as the solver sees it, each body belongs to, shape (body_count,)."""
    if model.body_count == 0:
        return np.zeros(0, dtype=np.int32)
    world = model.body_world.numpy()
    is_global = world < 0
    if np.any(is_global & _moving(model)) or np.all(is_global):
        return np.zeros(model.body_count, dtype=np.int32)
    # global bodies that do not move get a world of their own, which only passes them through
    return np.where(is_global, model.world_count, world).astype(np.int32)


def _moving(model: newton.Model) -> np.ndarray:
    """Whether the solver moves each body, shape (body_count,)."""
    is_kinematic = model.body_flags.numpy() & int(newton.BodyFlags.KINEMATIC) != 0
    return (model.body_inv_mass.numpy() > 0.0) & ~is_kinematic
