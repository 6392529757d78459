# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Simulating the examples that Newton installs, with any solver.

An example is a script: it parses its arguments, makes a viewer with ``newton.examples.init``,
constructs ``Example(viewer, args)`` and hands that to ``newton.examples.run``. It is executed as
just that, with ``init`` and ``run`` replaced so that we get the example instead of a window, and
with its solver swapped (:mod:`newton_avbd.io.swap`).
"""

import argparse
import contextlib
import runpy
import sys
from typing import Any
from unittest import mock

import newton
import newton.examples
import newton.viewer
import warp as wp

from .errors import UserError, missing
from .simulation import Request
from .swap import swapped
from .timing import StepTimer

FRAMES = {
    "adaptive_collision": 45,
    "basic_dzhanibekov": 230,
    "basic_heightfield": 120,
    "basic_mimic_joint": 120,
    "basic_shapes": 150,
    "basic_urdf": 200,
    "cable_cross_slide_table": 540,
    "cable_initial_rest_pose": 120,
    "controller_joint_impedance_heterogeneous": 120,
    "ik_cube_stacking": 2000,
    "kamino_basic_fourbar": 120,
    "kamino_basic_heterogeneous": 120,
    "kamino_earworm_flowers": 120,
    "pyramid": 120,
    "recording": 120,
    "robot_omniwheel": 500,
    "sensor_contact": 160,
    "sensor_imu": 200,
    "tendon_3d_routing": 60,
    "tendon_capstan_friction": 45,
    "tendon_mujoco_switch": 210,
    "tendon_pinhole": 30,
    "tendon_pulley": 30,
}
"""Frames after which Newton's own tests judge an example, where that is not its default."""

_PARTS = ("model", "state_0", "sim_dt", "frame_dt")
"""Attributes of an example that a simulation is made of."""


_CAPTURE_LAUNCH = wp.capture_launch


class _Eager:
    """Stands for a captured graph; as if there were none where an example asks, and launchable."""

    def __bool__(self) -> bool:
        return False


def names() -> list[str]:
    """Names of the installed examples."""
    return sorted(newton.examples.get_examples())


class ExampleSimulation:
    """A Newton example as a simulation; it steps, draws and tests itself."""

    def __init__(self, name: str, request: Request):
        """Construct the example ``name`` with the solver of ``request``.

        Args:
            name: One of :func:`names`.
            request: Solver and settings; ``request.arguments`` go to the example's own parser.

        Raises:
            UserError: The example cannot take the solver, or needs what is not installed.
        """
        self.name = name
        self.notes: tuple[str, ...] = ()
        self.timer = StepTimer()
        try:
            with contextlib.redirect_stdout(sys.stderr), swapped(request, self.timer) as made:
                self._example, self._args = _construct(name, request)
        except ModuleNotFoundError as error:
            raise missing(error.name or "newton") from error
        except UserError:
            raise
        except Exception as error:
            # With a solver, or on a machine, that it was not written for, an example may fail
            # in any way.
            raise UserError(
                f"{name} cannot run with {request.solver}: {_summary(error)}"
            ) from error
        model = getattr(self._example, "model", None)
        if model is not None and model.body_count == 0:
            raise UserError(f"{name} has no rigid bodies")
        if not made:
            raise UserError(f"{name} has no rigid-body solver that could be swapped")
        lacking = [part for part in _PARTS if not hasattr(self._example, part)]
        if lacking:
            raise UserError(f"{name} is not built as most examples are: it has no {lacking[0]}")
        self.model: newton.Model = self._example.model
        self.solver: newton.solvers.SolverBase = made[0]
        self.frames: int = self._args.num_frames
        self._set_dt(request.dt)
        self.dt: float = self._example.sim_dt
        self.frame_dt: float = self._example.frame_dt
        self._complaint: str | None = None
        # Beside this graph an example may have others, which do not simulate, as of its planner.
        has_own = isinstance(vars(self._example).get("graph"), wp.Graph)
        for attribute, value in vars(self._example).items():
            if isinstance(value, newton.CollisionPipeline):
                self.timer.watch_pipeline(value)
            elif isinstance(value, wp.Graph) and (attribute == "graph" or not has_own):
                # Stepped eagerly, so that solver and collision detection can be timed apart.
                eager = _Eager() if hasattr(self._example, "simulate") else None
                setattr(self._example, attribute, eager)

    @property
    def state(self) -> newton.State:
        return self._example.state_0

    def advance(self) -> None:
        launch = mock.patch.object(wp, "capture_launch", self._launch)
        with contextlib.redirect_stdout(sys.stderr), launch:
            self._example.step()
            if self._args.test and self._complaint is None:
                self._complaint = _failure(self._example, "test_post_step")

    def render(self) -> None:
        self._example.render()

    def verdict(self) -> str | None:
        if not self._args.test or not hasattr(self._example, "test_final"):
            return None
        complaint = self._complaint or _failure(self._example, "test_final")
        return "passed" if complaint is None else f"failed: {complaint}"

    def _launch(self, graph: Any, *args: Any, **options: Any) -> None:
        """What ``wp.capture_launch`` is while the example steps."""
        if isinstance(graph, _Eager):
            self._example.simulate()
        else:
            _CAPTURE_LAUNCH(graph, *args, **options)

    def _set_dt(self, dt: float | None) -> None:
        """Make the example step by ``dt``, as often as fills its frame."""
        if dt is None:
            return
        if not hasattr(self._example, "sim_substeps"):
            raise UserError(f"{self.name} has a fixed step: leave out --dt")
        self._example.sim_dt = dt
        self._example.sim_substeps = max(1, round(self._example.frame_dt / dt))
        self._example.frame_dt = self._example.sim_substeps * dt


def _construct(name: str, request: Request) -> tuple[Any, argparse.Namespace]:
    """Execute the example's script up to the point where it would run."""
    constructed: list[tuple[Any, argparse.Namespace]] = []

    def init(parser: argparse.ArgumentParser | None = None) -> tuple[Any, argparse.Namespace]:
        parser = parser or newton.examples.create_parser()
        parser.prog = f"newton-avbd run {name} --"
        # In test mode an example sets up what its own test judges.
        parser.set_defaults(test=True)
        if name in FRAMES:
            parser.set_defaults(num_frames=FRAMES[name])
        for action in parser._actions:
            # An example that was written for the wanted solver too knows best how to set it up.
            if action.dest == "solver" and request.solver in (action.choices or ()):
                action.default = request.solver
        args = parser.parse_args(request.arguments)
        viewer = request.viewer or (lambda: newton.viewer.ViewerNull(num_frames=args.num_frames))
        return viewer(), args

    with (
        # Some examples look at the command line before init does.
        mock.patch.object(sys, "argv", [name, "--test", *request.arguments]),
        mock.patch.object(newton.examples, "init", init),
        mock.patch.object(newton.examples, "run", lambda *pair: constructed.append(pair)),
    ):
        try:
            runpy.run_module(newton.examples.get_examples()[name], run_name="__main__")
        except SystemExit:
            # Its own end, or, before it is constructed, that of its parser.
            if not constructed:
                raise
    if not constructed:
        raise UserError(f"{name} does not run the way Newton's examples do")
    return constructed[0]


def _failure(example: Any, test: str) -> str | None:
    """What a test of the example complains about; None if it passes or is absent."""
    try:
        getattr(example, test, lambda: None)()
    except Exception as error:
        return _summary(error)
    return None


def _summary(error: Exception) -> str:
    """First line of an error's message."""
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__
