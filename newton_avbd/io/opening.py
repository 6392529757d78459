# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Finding what is to be simulated by its name, and putting a solver into it."""

from pathlib import Path

import newton
import warp as wp

from newton_avbd.scenes import named as scenes
from newton_avbd.scenes.finalize import finalized
from newton_avbd.scenes.scene import FRAMES_PER_SECOND, GivenScene, Scene

from . import examples, robots, solvers
from .assets import FRAMES, open_asset, set_up_asset
from .errors import UserError, meant, missing_of
from .names import SUFFIXES
from .simulation import ModelSimulation, Request, Simulation
from .terminal import showing

EXAMPLE_PREFIX = "newton:"
"""Put before a name that a Newton example shares with a scene of ours."""


def open_scene(name: str, request: Request) -> Simulation:
    """Open a scene by name.

    Args:
        name: A scene of :mod:`newton_avbd.scenes.named`, an installed Newton example, with or
            without :data:`EXAMPLE_PREFIX`, a robot of an installed package with the prefix
            ``robot:``, or the path of a USD, URDF or MJCF file.
        request: Solver and settings.

    Returns:
        The simulation, at its start.

    Raises:
        UserError: There is no such scene, or it cannot be simulated as requested.
    """
    if request.solver == "kamino" and request.iterations is not None:
        raise UserError("solver kamino has no iterations to set")
    try:
        with showing(f"reading {name}"):
            return _open(name, request)
    except ImportError as error:
        raise missing_of(error) from error
    except (NotImplementedError, ValueError) as error:
        # such as an accuracy below what float32 can tell
        raise UserError(f"{name} cannot run with {request.solver}: {error}") from error


def read_scene(name: str) -> tuple[Scene, tuple[str, ...]]:
    """Read a scene by name, as studies take it, without a solver, and what to know of it.

    Of a Newton example this is its model, without what its program does between steps. Names and
    errors are those of :func:`open_scene`.
    """
    try:
        with showing(f"reading {name}"):
            return _read_scene(name)
    except ImportError as error:
        raise missing_of(error) from error


def _read_scene(name: str) -> tuple[Scene, tuple[str, ...]]:
    if name in scenes.SCENES:
        return scenes.SCENES[name], ()
    # no light links: studies ask other solvers about it, too
    if name.startswith(robots.PREFIX):
        robot, builder, notes = robots.set_up_robot(name, "avbd", light_links=False)
        return _given(robot.name, builder, notes), notes
    if name.removeprefix(EXAMPLE_PREFIX) not in examples.names() and _is_asset(name):
        builder, notes = set_up_asset(Path(name), "avbd", light_links=False)
        return _given(Path(name).name, builder, notes), notes
    # studies run on the CPU, for which a model that is there already cannot be made anew
    with wp.ScopedDevice("cpu"):
        simulation = open_scene(name, Request())
    model, start = simulation.model, simulation.state
    # most examples move their bodies where the joints' coordinates put them, in the state alone
    for part in ("body_q", "body_qd", "joint_q", "joint_qd"):
        array = getattr(start, part)
        if array is not None:
            wp.copy(getattr(model, part), array)
    frames = round(simulation.frames * simulation.frame_dt * FRAMES_PER_SECOND)
    scene = GivenScene(simulation.name, frames=frames, finalize=lambda device: model)
    note = f"{simulation.name}: only its model is taken; what its program sets meanwhile is not"
    return scene, (*simulation.notes, note)


def _given(name: str, builder: newton.ModelBuilder, notes: tuple[str, ...]) -> GivenScene:
    """A scene of a filled builder; notes say why it may be empty."""
    if builder.body_count == 0:
        raise UserError("\n".join([f"cannot simulate {name}: it holds no rigid bodies", *notes]))
    if not builder.body_color_groups:
        builder.color()
    return GivenScene(
        name, frames=FRAMES, finalize=lambda device: finalized(builder, device=device)
    )


def _is_asset(name: str) -> bool:
    """Whether a name is that of a file, there or not."""
    return Path(name).suffix.lower() in SUFFIXES or Path(name).is_file()


def catalog() -> dict[str, dict[str, str]]:
    """Scenes, examples and robots by name, as :func:`open_scene` takes them, and what they are."""
    newtons = [
        EXAMPLE_PREFIX + name if name in scenes.SCENES else name for name in examples.names()
    ]
    return {
        "scenes": {scene.name: scene.summary for scene in scenes.SCENES.values()},
        "Newton examples": dict.fromkeys(newtons, ""),
        "robots of installed packages": {
            robots.PREFIX + robot.name: robot.package for robot in robots.robots()
        },
    }


def _open(name: str, request: Request) -> Simulation:
    example = name.removeprefix(EXAMPLE_PREFIX)
    if request.ctrl is not None and not Path(name).is_file():
        raise UserError(f"--ctrl drives the actuators of a file; {name} is none")
    if name not in scenes.SCENES and example in examples.names():
        return examples.ExampleSimulation(example, request)
    if request.arguments:
        raise UserError(f"{name} is no Newton example: {' '.join(request.arguments)} has no reader")
    if name.startswith(robots.PREFIX):
        return robots.open_robot(name, request)
    if name in scenes.SCENES:
        return _open_own(scenes.SCENES[name], request)
    if _is_asset(name):
        return open_asset(Path(name), request)
    close = meant(name, [*scenes.SCENES, *examples.names()])
    told = f"there is no scene {name!r}, and no such file."
    if Path(name).is_dir():
        told = f"{name} is a folder; name a file in it."
    if close:
        told += f" Did you mean {' or '.join(close)}?"
    raise UserError(f"{told} `newton-avbd run --list` names all.")


def _open_own(scene: scenes.Scene, request: Request) -> ModelSimulation:
    builder = newton.ModelBuilder()
    solvers.prepare(request.solver, builder)
    if request.solver == "vbd" and scene.vbd_ke is not None:
        builder.default_shape_cfg.ke = scene.vbd_ke
    scene.build(builder)
    frame_dt = 1.0 / scenes.FRAMES_PER_SECOND
    return ModelSimulation(
        scene.name, builder, request, dt=scene.dt, frame_dt=frame_dt, frames=scene.frames
    )
