# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Simulating USD, URDF and MJCF files."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import newton
import numpy as np
import warp as wp

from newton_avbd.measure.overlaps import filter_neighbors
from newton_avbd.scenes.finalize import ROUNDED, finalized
from newton_avbd.scenes.pose import grounds, lowest_points
from newton_avbd.scenes.robots import place

from . import solvers
from .controls import Controls
from .errors import UserError, missing, require
from .masses import check_usd_masses
from .meshes import broken_mesh, find_asset, read_urdf, remedy
from .mjcf import add_mjcf
from .names import ACTUATED, SUFFIXES
from .orphans import find_orphans, rooted_stage
from .simulation import ModelSimulation, Request
from .urdf import free_crossed, massless_root, take_empty_root

DT = 1.0 / 240.0
"""Solver step for an asset [s]; files rarely say."""

FRAME_DT = 1.0 / 60.0
FRAMES = 240

_MESH = re.compile(r"Mesh file '(.+?)' ([^;]+)")

GROUND_CLEARANCE = 0.01
"""Gap left between an asset that reaches below z = 0 and the ground put under it [m]."""


def open_asset(path: Path, request: Request) -> ModelSimulation:
    """Open a file as a simulation.

    Bodies start as authored; the root of a URDF robot, which the format leaves open, floats if it
    has mass. An asset without a ground gets a plane at z = 0, or just under its lowest point where
    that is deeper, so that nothing falls forever.

    Raises:
        UserError: The file is missing, is no such asset or holds no bodies.
    """
    if request.ctrl is not None:
        _check_asset(path)
        return _open_driven(path, request)
    builder, notes = set_up_asset(path, request.solver, light_links=request.light_links)
    return simulate(path.name, path, builder, request, notes)


def set_up_asset(
    path: Path, solver: str, *, light_links: bool = True
) -> tuple[newton.ModelBuilder, tuple[str, ...]]:
    """Read a file as :func:`read_asset`, and put a ground under what it holds.

    Raises:
        UserError: The file is missing, is no such asset or cannot be read.
    """
    _check_asset(path)
    builder, notes = read_asset(path, solver, floating=True, light_links=light_links)
    add_ground(builder)
    return builder, notes


def _check_asset(path: Path) -> None:
    """Raise a :class:`UserError` unless ``path`` is a file with one of :data:`SUFFIXES`."""
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"cannot read {path}: not one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise UserError(f"cannot read {path}: no such file")


def _open_driven(path: Path, request: Request) -> ModelSimulation:
    """An MJCF file as it is, without a ground beside its own, driven by controls.

    Raises:
        UserError: It is no MJCF file, cannot be read or has no actuators.
    """
    if path.suffix.lower() != ".xml":
        raise UserError(f"--ctrl drives the actuators of MJCF files (.xml), not {path}")
    try:
        builder, notes = read_driven(path, request.solver)
    except Exception as error:
        # The importer fails in as many ways as files can be wrong.
        raise UserError(f"cannot read {path}: {_reason(error)}") from error
    simulation = simulate(path.name, path, builder, request, notes)
    assert request.ctrl is not None
    simulation.controls = Controls(request.ctrl, simulation.model, path)
    return simulation


def read_driven(
    path: Path, solver: str = "avbd", *, light_links: bool = True
) -> tuple[newton.ModelBuilder, tuple[str, ...]]:
    """Read an MJCF file as :func:`read_asset`, with its actuators on ``control.mujoco.ctrl``.

    Raises:
        Exception: Whatever Newton's importer raises.
    """
    return _read_mjcf(path, solver, light_links=light_links, ctrl_direct=True)


def _read_mjcf(
    path: Path, solver: str, *, light_links: bool, **options: Any
) -> tuple[newton.ModelBuilder, tuple[str, ...]]:
    """Read an MJCF file; further options are those of ``builder.add_mjcf``."""
    builder = _prepared(solver)
    if "ctrl_direct" in options:
        newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    takes_them = solver in ACTUATED
    notes = add_mjcf(builder, path, light_links=light_links and takes_them, **options)
    _collide_by_hulls(builder, of_world=True)
    filter_neighbors(builder)
    return builder, notes


def simulate(
    name: str, path: Path, builder: newton.ModelBuilder, request: Request, notes: tuple[str, ...]
) -> ModelSimulation:
    """Make a simulation of what was read from a file.

    Raises:
        UserError: It holds no bodies, or the solver refuses what it holds.
    """
    if builder.body_count == 0:
        raise UserError("\n".join([f"cannot simulate {path}: it holds no rigid bodies", *notes]))
    try:
        return ModelSimulation(
            name, builder, request, dt=DT, frame_dt=FRAME_DT, frames=FRAMES, notes=notes
        )
    except (NotImplementedError, ValueError) as error:
        refusal = f"{path} cannot run with {request.solver}: {_reason(error)}"
        raise UserError("\n".join([refusal, *notes])) from error


def read_asset(
    path: Path, solver: str, *, floating: bool, light_links: bool = True
) -> tuple[newton.ModelBuilder, tuple[str, ...]]:
    """Read what a file holds, as Newton's importers do.

    Args:
        path: A file with one of :data:`~newton_avbd.io.names.SUFFIXES`.
        solver: The solver for which the builder is prepared.
        floating: Whether the root of a URDF robot floats if it has mass, or is fixed to the world;
            the other formats say it themselves.
        light_links: Whether joints of MJCF files may get links of their own, of next to no mass, if
            the solver takes such.

    Returns:
        A builder, and what the user should know of it, a sentence each.

    Raises:
        UserError: The file cannot be read.
    """
    try:
        if path.suffix.lower() == ".xml":
            return _read_mjcf(path, solver, light_links=light_links)
        return _read(path, solver, floating)
    except UserError:
        raise
    except ModuleNotFoundError as error:
        raise missing(error.name or "newton") from error
    except ImportError as error:
        # Newton's importers say themselves what they miss, without a module's name.
        raise missing("pxr" if path.suffix.lower().startswith(".usd") else "trimesh") from error
    except Exception as error:
        # The importers fail in as many ways as files can be wrong.
        raise UserError(f"cannot read {path}: {_reason(error)}") from error


def _read(path: Path, solver: str, floating: bool) -> tuple[newton.ModelBuilder, tuple[str, ...]]:
    suffix = path.suffix.lower()
    if suffix == ".urdf":
        return _read_urdf(path, solver, floating)
    builder = _prepared(solver)
    check_usd_masses(path)
    builder.add_usd(str(path))
    orphans = find_orphans(builder)
    if orphans:
        stage = rooted_stage(path, builder, orphans)
        builder = _prepared(solver)
        builder.add_usd(stage)
    return builder, ()


def _prepared(solver: str) -> newton.ModelBuilder:
    builder = newton.ModelBuilder()
    solvers.prepare(solver, builder)
    return builder


def _read_urdf(
    path: Path, solver: str, floating: bool
) -> tuple[newton.ModelBuilder, tuple[str, ...]]:
    """Read a URDF file without the meshes that are not there or that cannot be read.

    A root that has no mass does not float, though others would.
    """
    unreadable: dict[str, str] = {}
    while True:
        builder = _prepared(solver)
        root, absent = read_urdf(path, unreadable)
        start = take_empty_root(root)
        rooted = massless_root(root) if floating else None
        freed = free_crossed(root)
        text = ElementTree.tostring(root, encoding="unicode")
        try:
            builder.add_urdf(text, floating=floating and rooted is None)
        except ValueError as error:
            # The importer names the file: "Mesh file '/a/b.dae' contains no triangles; ...".
            named = _MESH.search(str(error))
            if named is None or named[1] in unreadable:
                raise
            unreadable[named[1]] = named[2]
            continue
        except ImportError:
            raise
        except Exception as error:
            # Readers of meshes fail in as many ways as files can be wrong, and name none.
            broken = broken_mesh(root)
            if broken is None:
                raise
            unreadable[broken] = f"cannot be loaded: {_reason(error)}"
            continue
        _collide_by_hulls(builder)
        filter_neighbors(builder)
        if start is not None and builder.joint_type[0] == newton.JointType.FREE:
            builder.joint_q[:7] = [*start[0], *np.array(wp.quat_rpy(*start[1]))]
        # Newton's importer leaves all links at the origin.
        place(builder)
        bad = [f"{path.name} goes on without {name}: it {why}" for name, why in unreadable.items()]
        lost = [
            f"{path.name} goes on without {name}: {remedy(name)}"
            for name in absent
            if str(find_asset(name, path)) not in unreadable
        ]
        fixed = [f"{path.name}: its root {rooted!r} has no mass, so it is fixed to the world"]
        free = [
            f"{path.name}: joint {name!r} has its lower limit above its upper one: it goes on "
            "without limits"
            for name in freed
        ]
        weighed = (*_weighed_by_shapes(path, root, builder), *_negative_moments(path, builder))
        notes = (*bad, *lost, *weighed, *free)
        return builder, (*notes, *(fixed if rooted else ()))


def _weighed_by_shapes(
    path: Path, root: ElementTree.Element, builder: newton.ModelBuilder
) -> Iterator[str]:
    """Says which mass Newton's importer gives to links without ``<inertial>``, which have none."""
    bare = {link.get("name") for link in root.iter("link") if link.find("inertial") is None}
    named = zip(builder.body_label, builder.body_mass, strict=True)
    masses = [mass for label, mass in named if label.rpartition("/")[2] in bare and mass > 0.0]
    if masses:
        yield (
            f"{path.name}: {len(masses)} links without <inertial> get {sum(masses):.3g} of "
            f"{sum(builder.body_mass):.3g} kg, as Newton's importer weighs their shapes; "
            "builder.default_shape_cfg.density = 0.0 before add_urdf leaves them without mass"
        )


def _negative_moments(path: Path, builder: newton.ModelBuilder) -> Iterator[str]:
    """Says which links have negative principal moments of inertia, which nothing can have."""
    for label, inertia in zip(builder.body_label, builder.body_inertia, strict=True):
        moments = np.linalg.eigvalsh(np.array(inertia, dtype=float).reshape(3, 3))
        if moments[0] < -ROUNDED * np.abs(moments).max():
            yield (
                f"{path.name}: link {label.rpartition('/')[2]!r} has a negative moment of inertia, "
                f"{moments[0]:.3g} kg m^2: Newton raises all three until none is"
            )


def _collide_by_hulls(builder: newton.ModelBuilder, *, of_world: bool = False) -> None:
    """Let meshes of bodies collide as their convex hulls.

    MuJoCo and PyBullet read URDF and MJCF so. Triangles of one link against those of another take
    seconds a step and find more contacts than buffers hold.

    Args:
        builder: Holds the meshes.
        of_world: Whether those that no body has do, too, as in MuJoCo and not in PyBullet.
    """
    meshes = [
        shape
        for shape, (kind, flags) in enumerate(
            zip(builder.shape_type, builder.shape_flags, strict=True)
        )
        if kind == newton.GeoType.MESH
        and flags & newton.ShapeFlags.COLLIDE_SHAPES
        and (of_world or builder.shape_body[shape] >= 0)
    ]
    if meshes:
        require("scipy")
        builder.approximate_meshes("convex_hull", shape_indices=meshes)


def _reason(error: Exception) -> str:
    """First line of an importer's message, without the place in its source that USD puts first."""
    lines = str(error).strip().splitlines()
    return lines[0].rpartition(" : ")[2].strip("'") if lines else type(error).__name__


def add_ground(builder: newton.ModelBuilder) -> None:
    """Put a plane under everything unless the asset has a plane or a terrain of its own."""
    if grounds(builder):
        return
    lowest = float(np.min(lowest_points(finalized(builder)), initial=np.inf))
    builder.add_ground_plane(height=0.0 if lowest >= 0.0 else lowest - GROUND_CLEARANCE)
