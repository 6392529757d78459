# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Putting another solver into scripts that were written for one of Newton's.

A script makes its solver with ``newton.solvers.SolverX(model, ...)`` when it runs. While
:func:`swapped` is active, each of those names holds a :class:`StandIn`, which makes the wanted
solver when called and is the original class in all else: ``SolverX.Config``,
``SolverX.register_custom_attributes`` and ``isinstance(solver, SolverX)`` keep working. What a
script then asks of its solver that only the original has is answered by :data:`_ADAPTERS`.
"""

import inspect
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest import mock

import newton
import numpy as np
import warp as wp

from . import solvers
from .errors import UserError
from .simulation import Request
from .timing import StepTimer

_SWAPPABLE = (
    "SolverFeatherstone",
    "SolverKamino",
    "SolverMuJoCo",
    "SolverSemiImplicit",
    "SolverVBD",
    "SolverXPBD",
)
"""Newton's solvers of rigid bodies; those of cloth, soft bodies and grains stay."""

_JOINT_SPACE = ("SolverFeatherstone", "SolverMuJoCo")
"""Solvers that start from ``state.joint_q``, whatever the poses of the bodies."""

_WRITES_JOINTS = (*_JOINT_SPACE, "SolverKamino")
"""Solvers that write ``state.joint_q`` and ``joint_qd``; their scripts read these after a step."""

_SWEEPING = ("SolverVBD", "SolverXPBD")
"""Solvers whose ``iterations`` mean what they mean to ours: sweeps over bodies or constraints."""

_NOT_BY_VBD = ("armature", "effort_limits", "joint_friction", "velocity_limits")
"""Effects that SolverVBD says it does not simulate; scenes for it author them without effect."""

_ADAPTERS = {
    # None lets a collision pipeline choose its own capacity.
    "get_max_contact_count": lambda: None,
    "set_rigid_history_update": lambda update: None,
}
"""Methods of single solvers that scripts call, with answers that hold for every other solver."""


class StandIn:
    """Stands in for a solver class in ``newton.solvers``; see the module."""

    def __init__(self, original: type, request: Request, timer: StepTimer, made: list[Any]):
        """Stand in for a class; ``timer`` watches the solvers made, ``made`` receives them."""
        self._original, self._request, self._timer, self._made = original, request, timer, made

    def __call__(self, model: newton.Model, *args: Any, **options: Any) -> Any:
        wanted = solvers.solver_class(self._request.solver)
        if model.particle_count and self._request.solver not in solvers.DEFORMABLE:
            return self._original(model, *args, **options)
        if wanted is self._original:
            if self._request.iterations is not None:
                options["iterations"] = self._request.iterations
            solver = wanted(model, *args, **options)
        else:
            kept = self._understood(wanted, options)
            own = kept.pop("iterations", None)
            iterations = self._request.iterations or own
            if self._original.__name__ in _WRITES_JOINTS and "update_joint_state" in (
                inspect.signature(wanted).parameters
            ):
                kept["update_joint_state"] = True
            if self._original.__name__ == "SolverVBD" and self._request.solver == "avbd":
                kept["effects"] = dict.fromkeys(_NOT_BY_VBD, False)
            if self._original.__name__ in _JOINT_SPACE and model.joint_count:
                newton.eval_fk(model, model.joint_q, model.joint_qd, model)
            kept.update(self._request.options)
            solver = solvers.construct(self._request.solver, model, iterations, **kept)
            for name, answer in _ADAPTERS.items():
                if hasattr(self._original, name) and not hasattr(solver, name):
                    setattr(solver, name, answer)
            if self._original.__name__ == "SolverKamino":
                _reset_as_kamino(solver, model)
        self._timer.watch_solver(solver)
        if wanted is not self._original and self._collides(args, options):
            _collide_before_step(solver, model, self._timer)
        self._made.append(solver)
        return solver

    def __getattr__(self, name: str) -> Any:
        return getattr(self._original, name)

    def __instancecheck__(self, instance: Any) -> bool:
        return isinstance(instance, self._original)

    def _understood(self, wanted: type, options: dict[str, Any]) -> dict[str, Any]:
        """The options that the wanted solver has too, and that mean the same to it."""
        known = inspect.signature(wanted).parameters
        kept = {name: value for name, value in options.items() if name in known}
        if not {self._original.__name__, wanted.__name__} <= {*_SWEEPING, "SolverAVBD"}:
            kept.pop("iterations", None)
        return kept

    def _collides(self, args: tuple[Any, ...], options: dict[str, Any]) -> bool:
        """Whether the original would have detected collisions itself."""
        if self._original.__name__ == "SolverMuJoCo":
            native = options.get("use_mujoco_contacts", True)
            return native and not options.get("disable_contacts")
        if self._original.__name__ == "SolverKamino":
            config = args[0] if args else options.get("config")
            return bool(getattr(config, "use_collision_detector", False))
        return False


def _collide_before_step(solver: Any, model: newton.Model, timer: StepTimer) -> None:
    """Let ``solver.step`` detect collisions first, for a script that leaves that to its solver."""
    pipeline = newton.CollisionPipeline(model, publish_capacity=False)
    timer.watch_pipeline(pipeline)
    own, step = pipeline.contacts(), solver.step

    def colliding_step(
        state_in: newton.State,
        state_out: newton.State,
        control: newton.Control | None,
        contacts: newton.Contacts | None,
        dt: float,
        **options: Any,
    ) -> None:
        contacts = own if contacts is None else contacts
        pipeline.collide(state_in, contacts)
        step(state_in, state_out, control, contacts, dt, **options)

    solver.step = colliding_step


def _reset_as_kamino(solver: Any, model: newton.Model) -> None:
    """Let ``solver.reset`` take the ``config`` that Kamino's takes, as far as bodies carry it."""
    reset = solver.reset

    def configured_reset(
        state: newton.State,
        world_mask: Any = None,
        flags: Any = None,
        *,
        config: Any = None,
        **options: Any,
    ) -> None:
        if config is None:
            return reset(state, world_mask, flags, **options)
        how = {
            part: type(getattr(config, part)).__name__
            for part in ("body_poses", "body_velocities", "base_pose", "base_velocity")
        }
        kept = {how["body_poses"], how["body_velocities"]}
        based = how["base_pose"] == "FromBaseQ"
        if len(kept) > 1 or not kept <= {"ToDefault", "Preserve"} or "FromBaseU" in how.values():
            raise UserError(f"only Kamino can reset like this: {how}")
        reset(state, world_mask, 0 if "Preserve" in kept else flags)
        if based:
            _place(state, model, config.base_pose.base_q.numpy(), world_mask)

    solver.reset = configured_reset


def _place(state: newton.State, model: newton.Model, base_q: np.ndarray, world_mask: Any) -> None:
    """Carry the bodies of each world along with its first, which goes to ``base_q``."""
    poses, start = state.body_q.numpy(), model.body_world_start.numpy()
    mask = np.ones(model.world_count, bool) if world_mask is None else world_mask.numpy()
    for world in np.flatnonzero(mask[: model.world_count]):
        move = wp.transform(*base_q[world]) * wp.transform_inverse(
            wp.transform(*poses[start[world]])
        )
        for body in range(start[world], start[world + 1]):
            poses[body] = move * wp.transform(*poses[body])
    state.body_q.assign(poses)


@contextmanager
def swapped(request: Request, timer: StepTimer) -> Iterator[list[Any]]:
    """Make scripts that run inside this context get another solver than they name.

    Builders are made ready for that solver too when they are finalized.

    Args:
        request: The solver to give them.
        timer: Watches the solvers.

    Yields:
        The solvers made so far.
    """
    made: list[Any] = []
    solvers.solver_class(request.solver)  # before newton.solvers is patched
    finalize = newton.ModelBuilder.finalize

    def prepared_finalize(builder: newton.ModelBuilder, *args: Any, **options: Any) -> newton.Model:
        solvers.prepare(request.solver, builder)
        solvers.complete(request.solver, builder)
        return finalize(builder, *args, **options)

    with ExitStack() as patches:
        for name in _SWAPPABLE:
            stand_in = StandIn(getattr(newton.solvers, name), request, timer, made)
            patches.enter_context(mock.patch.object(newton.solvers, name, stand_in))
        patches.enter_context(mock.patch.object(newton.ModelBuilder, "finalize", prepared_finalize))
        yield made
