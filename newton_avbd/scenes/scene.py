# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What a named scene is."""

from collections.abc import Callable
from dataclasses import dataclass, field

import newton

from newton_avbd.flags import heed_flags
from newton_avbd.scenes.finalize import finalized

FRAMES_PER_SECOND = 60
"""Rate at which a scene is watched [1/s]; :attr:`Scene.frames` counts these."""


@dataclass(frozen=True)
class Scene:
    """A named scene.

    Attributes:
        name: Key in :data:`SCENES`.
        summary: One line that says what the scene shows.
        build: Puts the scene into an empty builder.
        dt: Solver step [s]; a whole number of steps makes a frame.
        frames: Frames worth watching, at :data:`FRAMES_PER_SECOND`.
        vbd_ke: Contact stiffness [N/m] with which ``SolverVBD``'s bodies stand best; None where
            Newton's default does.
    """

    name: str
    summary: str
    build: Callable[[newton.ModelBuilder], None]
    dt: float = 1.0 / 240.0
    frames: int = 240
    vbd_ke: float | None = None

    @property
    def substeps(self) -> int:
        """Solver steps in a frame."""
        return round(1.0 / (FRAMES_PER_SECOND * self.dt))

    def model(self, *, ke: float | None = None, device: str | None = None) -> newton.Model:
        """Build and finalize the scene, colored so that every Newton solver accepts it.

        Args:
            ke: Contact stiffness [N/m] of all shapes; None keeps Newton's default.
            device: Warp device; None for the current one.

        Returns:
            The model.
        """
        builder = newton.ModelBuilder()
        if ke is not None:
            builder.default_shape_cfg.ke = ke
        self.build(builder)
        builder.color()
        return finalized(builder, device=device)


def _nothing(builder: newton.ModelBuilder) -> None:
    """Puts nothing into a builder."""


@dataclass(frozen=True)
class GivenScene(Scene):
    """A scene that was read from a file or made by somebody else's program.

    Attributes:
        finalize: Makes the model on a device, complete for every Newton solver. Materials are those
            that were read.
    """

    summary: str = ""
    build: Callable[[newton.ModelBuilder], None] = _nothing
    finalize: Callable[[str | None], newton.Model] = field(kw_only=True)

    def model(self, *, ke: float | None = None, device: str | None = None) -> newton.Model:
        """Make the model; see :class:`Scene`."""
        del ke
        model = self.finalize(device)
        heed_flags(model)
        return model
