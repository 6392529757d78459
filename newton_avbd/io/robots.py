# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The robots of installed packages, by name."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from importlib import metadata
from pathlib import Path

import newton

from newton_avbd.scenes.pose import stand

from .assets import read_asset, simulate
from .errors import UserError, meant
from .names import SUFFIXES
from .simulation import ModelSimulation, Request

PREFIX = "robot:"
"""Put before the name of a robot where a scene is expected."""


@dataclass(frozen=True)
class Robot:
    """A robot's file in an installed package.

    Attributes:
        name: What it is called: the shortest name that no other robot has.
        package: Name of the package, as pip knows it.
        path: The file.
        bolted: Whether its base is fixed to the world, where the file's format leaves that open.
        aliases: Further names that no other robot has.
    """

    name: str
    package: str
    path: Path
    bolted: bool
    aliases: tuple[str, ...] = ()


@dataclass(frozen=True)
class Source:
    """A package with robots.

    Attributes:
        package: Name of the package, as pip knows it.
        folder: Part of the path of every file that counts.
        suffix: Ending of every file that counts.
        only: Names of the files that hold a robot; all where empty.
        left_out: Names of the files that hold none.
    """

    package: str
    folder: str
    suffix: tuple[str, ...]
    only: frozenset[str] = frozenset()
    left_out: frozenset[str] = frozenset()

    @property
    def install(self) -> str:
        """The command that installs the package."""
        return f"pip install {self.package}"

    def holds(self, file: Path) -> bool:
        """Whether a file of the package holds a robot."""
        return (
            self.folder in file.as_posix()
            and file.suffix in self.suffix
            and file.name not in self.left_out
            and (not self.only or file.name in self.only)
        )


SOURCES = (
    Source("example-robot-data", "example-robot-data/robots/", (".urdf",)),
    Source(
        "dm_control",
        "dm_control/suite/",
        (".xml",),
        # The bodies of lqr.xml are made by its task.
        left_out=frozenset({"lqr.xml", "materials.xml", "skybox.xml", "visual.xml"}),
    ),
    Source("gymnasium", "gymnasium/envs/mujoco/assets/", (".xml",)),
    Source(
        "newton",
        "newton/examples/assets/",
        (".urdf", ".xml", ".usda"),
        only=frozenset(
            {
                "ant.usda",
                "boxes_fourbar.usda",
                "cartpole.urdf",
                "cartpole.usda",
                "cartpole_single_pendulum.usda",
                "humanoid.usda",
                "nv_ant.xml",
                "nv_humanoid.xml",
                "quadruped.urdf",
            }
        ),
    ),
)
"""Packages with robots, in the order in which they are shown."""

_BOLTED = frozenset(
    {
        "alex_description",
        "allegro_hand_description",
        "asr_twodof_description",
        "baxter_description",
        "double_pendulum_description",
        "finger_edu_description",
        "kinova_description",
        "panda_description",
        "so_arm_description",
        "ur_description",
        "xarm_description",
        "z1_description",
    }
)
"""Folders of example-robot-data whose robots are mounted: arms, hands, torsos without legs
and test benches."""

_BOLTED_FILES = frozenset({"cartpole.urdf", "talos_left_arm.urdf"})


def find_robot(name: str) -> Robot:
    """The robot called ``name``, with or without :data:`PREFIX`.

    Raises:
        UserError: There is none, or there are several; the message says which there are and what
            may have to be installed.
    """
    wanted = name.removeprefix(PREFIX)
    for robot in robots():
        if wanted == robot.name or wanted in robot.aliases:
            return robot
    close = meant(wanted, [robot.name for robot in robots()])
    hint = f" Did you mean {' or '.join(PREFIX + name for name in close)}?" if close else ""
    what = "robot or file" if wanted.endswith(SUFFIXES) else "robot"
    raise UserError(
        f"there is no {what} {wanted!r}.{hint} `newton-avbd robots --list` shows all."
        + "".join(f"\n{line}" for line in not_installed())
    )


def read_robot(
    robot: Robot, solver: str = "avbd", *, light_links: bool = True
) -> tuple[newton.ModelBuilder, tuple[str, ...]]:
    """Import a robot plainly, as :func:`.assets.read_asset` reads its file.

    A robot that would float, but has no colliding shape on which it could stand, is bolted down.
    """
    read = partial(read_asset, robot.path, solver, light_links=light_links)
    builder, notes = read(floating=not robot.bolted)
    if any(flags & newton.ShapeFlags.COLLIDE_SHAPES for flags in builder.shape_flags):
        return builder, notes
    return read(floating=False)


def set_up_robot(
    name: str, solver: str, *, light_links: bool = True
) -> tuple[Robot, newton.ModelBuilder, tuple[str, ...]]:
    """Read a robot as :func:`read_robot`, and stand it up or bolt it down; its drives hold its
    first pose. Its name may have the :data:`PREFIX`.

    Raises:
        UserError: There is no such robot, or it cannot be read.
    """
    robot = find_robot(name)
    builder, notes = read_robot(robot, solver, light_links=light_links)
    return robot, builder, (*notes, *describe_filtered(robot.name, stand(builder).filtered))


def describe_filtered(name: str, filtered: int) -> list[str]:
    """Says how many pairs of a robot's shapes are filtered since it stands; nothing for none."""
    what = f"{filtered} pairs of its shapes overlap in the first pose and are filtered"
    return [f"{name}: {what}"] if filtered else []


def open_robot(name: str, request: Request) -> ModelSimulation:
    """Open a robot as a simulation; names and errors are those of :func:`set_up_robot`."""
    robot, builder, notes = set_up_robot(name, request.solver, light_links=request.light_links)
    return simulate(robot.name, robot.path, builder, request, notes)


def not_installed() -> list[str]:
    """A sentence for each package of :data:`SOURCES` that is missing, with what installs it."""
    return [
        f"{source.package} is not installed; it brings more: {source.install}"
        for source in SOURCES
        if _files(source) is None
    ]


@cache
def robots() -> tuple[Robot, ...]:
    """The robots of all packages of :data:`SOURCES` that are installed."""
    found = [(source, path) for source in SOURCES for path in sorted(_files(source) or ())]
    lonely = Counter((source.package, path.parent) for source, path in found)
    names = [list(_names(source, path, lonely)) for source, path in found]
    # A name that several robots could have belongs to none, but where one has it first.
    count = Counter(name for candidates in names for name in dict.fromkeys(candidates))
    named = []
    for (source, path), candidates in zip(found, names, strict=True):
        own = [name for name in dict.fromkeys(candidates) if count[name] == 1]
        parts = set(path.parts)
        bolted = bool(parts & _BOLTED) or path.name in _BOLTED_FILES
        named.append(Robot(own[0], source.package, path, bolted, tuple(own[1:])))
    return tuple(named)


def catalog() -> dict[str, dict[str, str]]:
    """Packages and how each is installed, and the installed robots of each, by name."""
    packages = {source.package: source.install for source in SOURCES}
    groups: dict[str, dict[str, str]] = {"packages": packages}
    for robot in robots():
        groups.setdefault(f"robots of {robot.package}", {})[robot.name] = ""
    return groups


def _names(source: Source, path: Path, lonely: Counter[tuple[str, Path]]) -> Iterator[str]:
    """What a robot could be called, the shortest first."""
    if source.package == "example-robot-data":
        folder = path.parts[path.parts.index("robots") + 1]
        for ending in ("_description", "_data", "_simple"):
            folder = folder.removesuffix(ending)
        if lonely[source.package, path.parent] == 1:
            yield folder
            yield f"{source.package}/{folder}"
        yield path.stem
        yield f"{source.package}/{path.stem}"
        yield f"{folder}/{path.stem}"
        return
    # Only robots of their own package are called by a bare name there.
    if source.package == "newton":
        yield path.stem
    yield f"{source.package}/{path.stem}"
    yield f"{source.package}/{path.name}"


def _files(source: Source) -> list[Path] | None:
    """Files of the package that hold robots; None where it is not installed."""
    try:
        files = metadata.distribution(source.package).files or []
    except metadata.PackageNotFoundError:
        return None
    return [Path(str(file.locate())).resolve() for file in files if source.holds(Path(file))]
