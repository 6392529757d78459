# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Arguments that commands share. Warp is imported only where a device is asked for."""

import argparse
import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

from newton_avbd.io.errors import UserError
from newton_avbd.io.names import SOLVERS, SUFFIXES
from newton_avbd.io.output import STANDARD_OUTPUT


def add_scene_arguments(parser: argparse.ArgumentParser, solvers: Sequence[str] = SOLVERS) -> None:
    """Add the scene, the solver where there is a choice, and its settings."""
    parser.add_argument(
        "scene",
        metavar="SCENE",
        help=f"a scene, a robot (robot:NAME), a Newton example, or a file ({', '.join(SUFFIXES)})",
    )
    parser.set_defaults(solver="avbd")
    if len(solvers) > 1:
        parser.add_argument("--solver", choices=solvers, help="solver (default: avbd)")
    parser.add_argument(
        "--frames", type=positive(int), help="frames to simulate (default: the scene's own)"
    )
    parser.add_argument(
        "--iterations", type=positive(int), help="iterations a step (default: the scene's, or 10)"
    )
    parser.add_argument(
        "--dt", type=positive(float), help="solver step in seconds (default: the scene's own)"
    )
    parser.add_argument(
        "--accuracy",
        type=positive(float),
        metavar="M/S",
        help="error that a second may add, in meters: SolverAVBD divides steps as that needs; --dt "
        "is a frame then, where it is not given",
    )
    add_device(parser)
    parser.epilog = "Arguments after -- go to a Newton example."


def add_solvers(
    parser: argparse.ArgumentParser, solvers: Sequence[str], default: Sequence[str] | None = None
) -> None:
    """Add the choice of several solvers; None, the default, is for all that apply."""
    parser.add_argument(
        "--solvers",
        nargs="+",
        choices=solvers,
        default=default,
        metavar="SOLVER",
        help=f"of {', '.join(solvers)} (default: {', '.join(default or ('all that apply',))})",
    )


def add_json(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Add the file for all numbers, for :func:`newton_avbd.io.output.write_json`."""
    parser.add_argument(
        "--json",
        nargs="?",
        type=Path,
        const=STANDARD_OUTPUT,
        metavar="FILE",
        help="write all numbers to a file; without one, or -: to standard output, and tables to "
        "standard error" + more,
    )


def add_device(parser: argparse.ArgumentParser) -> None:
    """Add the device, for :func:`use_device`."""
    parser.add_argument("--device", help="Warp device, cpu or cuda:0 (default: CUDA if there)")


def positive(kind: type[int] | type[float]) -> "type[int] | type[float]":
    """Reader of a positive number, for ``type=`` of an argument."""

    wanted = "a whole number" if kind is int else "a number"

    def read(text: str) -> int | float:
        with contextlib.suppress(ValueError):
            value = kind(text)
            if 0 < value < float("inf"):
                return value
        raise argparse.ArgumentTypeError(f"{text!r} is not {wanted} above zero")

    return read  # type: ignore[return-value]


def use_device(name: str | None) -> None:
    """Make a Warp device the current one.

    Raises:
        UserError: There is no such device.
    """
    if name is None:
        return
    import warp as wp

    try:
        wp.set_device(name)
    except (RuntimeError, ValueError) as error:
        known = ", ".join(str(device) for device in wp.get_devices())
        raise UserError(f"there is no device {name!r}; there are: {known}") from error


def device_notes(name: str | None) -> list[str]:
    """What the user should know of the device that was not chosen, a sentence each."""
    import warp as wp

    if name is None and not wp.is_cuda_available():
        return ["there is no CUDA device, so it runs on the CPU"]
    return []


def check_writable(*paths: Path | None) -> None:
    """Check before the work that its results can be written; None is nothing to write.

    :data:`~newton_avbd.io.output.STANDARD_OUTPUT` always can be.

    Raises:
        UserError: The folder of a file does not exist, or the file cannot be written.
    """
    for path in paths:
        if path is None or path == STANDARD_OUTPUT:
            continue
        folder = path.parent
        if not folder.is_dir():
            raise UserError(f"cannot write {path}: there is no folder {folder}: mkdir -p {folder}")
        if path.is_dir():
            raise UserError(f"cannot write {path}: it is a folder, name a file in it")
        if not os.access(path if path.exists() else folder, os.W_OK):
            raise UserError(f"cannot write {path}: permission denied")


def make_folder(folder: Path | None) -> None:
    """Make the folder for results; None is none.

    Raises:
        UserError: It cannot be made, or nothing can be written there.
    """
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot write to {folder}: {error.strerror or error}") from error
    if not os.access(folder, os.W_OK):
        raise UserError(f"cannot write to {folder}: permission denied")
