# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Solvers whose accuracy is measured, and the settings that buy it."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import newton
from newton.solvers import SolverBase

from newton_avbd.study.peers import MJ_STEP

SMOOTH = ("avbd", "vbd", "xpbd", MJ_STEP, "mujoco_warp", "kamino", "featherstone")
"""Solvers for scenes without contacts."""

CONTACT = ("avbd", "vbd", "xpbd", MJ_STEP, "mujoco_warp", "kamino")
"""Solvers for scenes with contacts, those that hold them by more than explicit springs."""

RESTITUTION = ("avbd", "xpbd", "kamino")
"""Solvers that honour the shapes' restitution."""


@dataclass(frozen=True)
class Setting:
    """What a user chooses between speed and accuracy.

    Attributes:
        substeps: Steps in a frame of 1/60 s.
        iterations: Iterations of a step; None for the solver's own number.
        tolerance: Where iterations end early, in the solver's own units; None for its own.
        scheme: Time integration, or MuJoCo's contacts, where there is a choice; None for its own.
        accuracy: Error a second that inner steps are to keep to [m/s]; None for steps as they are.
    """

    substeps: int
    iterations: int | None = None
    tolerance: float | None = None
    scheme: str | None = None
    accuracy: float | None = None

    def __str__(self) -> str:
        parts = [f"{self.substeps}x"]
        parts += [] if self.iterations is None else [f"{self.iterations} it"]
        parts += [] if self.tolerance is None else [f"tol {self.tolerance:.0e}"]
        parts += [] if self.scheme is None else [self.scheme]
        parts += [] if self.accuracy is None else [f"accuracy {self.accuracy:.0e}"]
        return " ".join(parts)

    def given(self, **names: str) -> dict[str, Any]:
        """Arguments of a constructor, those that are set, by what it calls them."""
        values = {argument: getattr(self, name) for name, argument in names.items()}
        return {argument: value for argument, value in values.items() if value is not None}


@dataclass(frozen=True)
class Sweep:
    """Values of settings, all of which are tried with each other.

    Attributes:
        substeps: Steps a frame.
        iterations: Iterations a step.
        tolerances: Tolerances.
        schemes: Time integrations.
    """

    substeps: tuple[int, ...]
    iterations: tuple[int | None, ...] = (None,)
    tolerances: tuple[float | None, ...] = (None,)
    schemes: tuple[str | None, ...] = (None,)

    def settings(self) -> list[Setting]:
        """All of them, those with the fewest iterations in a frame first."""
        every = itertools.product(self.substeps, self.iterations, self.tolerances, self.schemes)
        return sorted((Setting(*values) for values in every), key=_effort)


def is_coarse(setting: Setting) -> bool:
    """Whether a setting is of the grid that is tried first."""
    is_on_grid = setting.substeps in COARSE_SUBSTEPS and setting.iterations in QUICK_ITERATIONS
    return is_on_grid and setting.tolerance is None


def _effort(setting: Setting) -> tuple[float, int]:
    return setting.substeps * (setting.iterations or 1), setting.substeps


SUBSTEPS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
ITERATIONS = (2, 3, 5, 10, 20, 40)
QUICK_SUBSTEPS, QUICK_ITERATIONS = (1, 4, 16, 64, 256), (None, 2, 10, 40)
"""Those of a quick run."""
COARSE_SUBSTEPS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
"""Those that come first in a full run, with the iterations of a quick one: where a scene takes long
the time does not go to settings that are all alike."""


@dataclass(frozen=True)
class MeasuredSolver:
    """A solver and what is tried with it.

    Attributes:
        title: What plots call it.
        make: Constructs it for a model; None for MuJoCo's own ``mj_step``.
        smooth: Settings to try where nothing touches.
        contact: Settings to try where bodies touch.
        stiff: Whether it takes :attr:`AccuracyScene.vbd_ke`.
    """

    title: str
    make: Callable[[newton.Model, Setting], SolverBase] | None
    smooth: tuple[Sweep, ...]
    contact: tuple[Sweep, ...]
    stiff: bool = False

    def settings(self, *, touching: bool, sweeps: bool, quick: bool) -> list[Setting]:
        """Settings to try, cheapest first, and the coarse grid of them before the rest.

        Args:
            touching: Whether bodies touch.
            sweeps: Whether iterations make a difference.
            quick: Only a few, of the first sweep and those of other schemes.
        """
        chosen = self.contact if touching else self.smooth
        if not sweeps:
            chosen = tuple(
                Sweep(s.substeps, s.iterations[:1], schemes=s.schemes) for s in chosen[:1]
            )
        if quick:
            first = chosen[0]
            chosen = tuple(
                Sweep(
                    tuple(n for n in sweep.substeps if n in QUICK_SUBSTEPS),
                    tuple(n for n in sweep.iterations if n in QUICK_ITERATIONS),
                    schemes=sweep.schemes,
                )
                for sweep in chosen
                if sweep is first or sweep.schemes != first.schemes
            )
        found = {setting: None for sweep in chosen for setting in sweep.settings()}
        return sorted(found, key=lambda setting: (not is_coarse(setting), _effort(setting)))


def _avbd(model: newton.Model, setting: Setting) -> SolverBase:
    from newton_avbd import SolverAVBD

    names = ("iterations", "tolerance", "scheme", "accuracy")
    return SolverAVBD(model, **setting.given(**{name: name for name in names}))


def _vbd(model: newton.Model, setting: Setting) -> SolverBase:
    return newton.solvers.SolverVBD(model, **setting.given(iterations="iterations"))


def _xpbd(model: newton.Model, setting: Setting) -> SolverBase:
    bouncy = bool((model.shape_material_restitution.numpy() > 0.0).any())
    return newton.solvers.SolverXPBD(
        model, enable_restitution=bouncy, **setting.given(iterations="iterations")
    )


STIFF, SOFT = "stiff", "soft"
"""Contacts of MuJoCo: as stiff as they stay calm, or as MuJoCo has them by default."""

MUJOCO_CONTACTS = {
    STIFF: ((5.0, 1.0), (0.99, 0.999, 0.001, 0.5, 2.0)),
    SOFT: (None, (0.9, 0.95, 0.001, 0.5, 2.0)),
}
"""``solref``, its time constant in steps (None: 20 ms), and ``solimp``. At two steps, the least
that MuJoCo allows, a box put on the ground hops by 2 cm."""

MUJOCO_OPTIONS: dict[str, Any] = {"cone": "elliptic", "impratio": 10.0}
"""The round friction cone, its rows ten times as hard as the normal ones."""


def _mujoco_warp(model: newton.Model, setting: Setting) -> SolverBase:
    # Told to use Newton's contacts it insists on some, also where nothing can collide.
    return newton.solvers.SolverMuJoCo(
        model,
        use_mujoco_contacts=not model.shape_contact_pair_count,
        integrator=setting.scheme if setting.scheme in INTEGRATORS else None,
        **MUJOCO_OPTIONS,
    )


def _kamino(model: newton.Model, setting: Setting) -> SolverBase:
    del setting
    return newton.solvers.SolverKamino(model)


def _featherstone(model: newton.Model, setting: Setting) -> SolverBase:
    del setting
    return newton.solvers.SolverFeatherstone(model, angular_damping=0.0)


AVBD_SCHEMES = ("euler", "generalized_alpha")
"""Time integrations of SolverAVBD."""

FOURTH_ORDER = "runge_kutta"
"""The one that is tried where joints hold bodies and nothing touches."""

INTEGRATORS = ("implicitfast", "rk4")
"""Time integrations of MuJoCo that are tried where nothing touches."""

_MUJOCO_SMOOTH = (Sweep(SUBSTEPS, schemes=INTEGRATORS),)
_MUJOCO_CONTACT = (Sweep(SUBSTEPS, schemes=(SOFT, STIFF)),)
# It takes seconds for a simulated second: a few points show where it stands.
_KAMINO = (Sweep((1, 4)),)

MEASURED: dict[str, MeasuredSolver] = {
    "avbd": MeasuredSolver(
        "SolverAVBD",
        _avbd,
        smooth=(
            Sweep((*SUBSTEPS, 128, 256), (10, 2, 40), schemes=AVBD_SCHEMES),
            Sweep(SUBSTEPS, (10,), schemes=(FOURTH_ORDER,)),
        ),
        contact=(
            Sweep(SUBSTEPS, ITERATIONS, schemes=AVBD_SCHEMES),
            Sweep(SUBSTEPS, (40,), (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), AVBD_SCHEMES),
        ),
    ),
    "vbd": MeasuredSolver(
        "SolverVBD",
        _vbd,
        smooth=(Sweep(SUBSTEPS, ITERATIONS),),
        contact=(Sweep(SUBSTEPS, ITERATIONS),),
        stiff=True,
    ),
    "xpbd": MeasuredSolver(
        "SolverXPBD",
        _xpbd,
        smooth=(Sweep(SUBSTEPS, ITERATIONS),),
        contact=(Sweep(SUBSTEPS, ITERATIONS),),
    ),
    MJ_STEP: MeasuredSolver("mj_step", None, _MUJOCO_SMOOTH, _MUJOCO_CONTACT),
    "mujoco_warp": MeasuredSolver(
        "SolverMuJoCo Warp", _mujoco_warp, _MUJOCO_SMOOTH, _MUJOCO_CONTACT
    ),
    "kamino": MeasuredSolver("SolverKamino", _kamino, _KAMINO, _KAMINO),
    "featherstone": MeasuredSolver(
        "SolverFeatherstone", _featherstone, (Sweep((*SUBSTEPS, 128, 256)),), ()
    ),
}
"""Solvers by name, ours first."""

PRESETS: dict[str, Setting] = {
    "resting": Setting(1, 40, scheme="euler"),
    "default": Setting(4, 10, scheme="generalized_alpha"),
    "euler": Setting(4, 10, scheme="euler"),
}
"""Settings of SolverAVBD that are measured on all scenes: what is recommended, and the default by
backward Euler."""
