# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Arguments that commands share."""

import argparse
import contextlib
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import warp as wp

from newton_avbd.io.errors import UserError
from newton_avbd.io.opening import list_scenes, scene_names
from newton_avbd.io.solvers import SOLVERS


def add_scene_arguments(parser: argparse.ArgumentParser, solvers: Sequence[str] = SOLVERS) -> None:
    """Add the scene, the solver and its settings."""
    offer(
        parser.add_argument("scene", metavar="SCENE", help="a scene or a file, see below"),
        scene_names,
        or_files=True,
    )
    parser.add_argument(
        "--solver", choices=solvers, default="avbd", help="solver (default: %(default)s)"
    )
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
    parser.add_argument("--device", help="Warp device, cpu or cuda:0 (default: CUDA if there)")
    parser.epilog = f"{list_scenes()}\nArguments after -- go to a Newton example."


def offer(
    action: argparse.Action, names: Callable[[], Iterable[str]], *, or_files: bool = False
) -> None:
    """Let the Tab key offer names for an argument that may be something else, too.

    Args:
        action: The argument.
        names: Finds them; called where the script for the Tab key is made, and nowhere else.
        or_files: Whether the argument may also be a file.
    """
    action.names = names  # type: ignore[attr-defined]
    action.or_files = or_files  # type: ignore[attr-defined]


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
    try:
        wp.set_device(name)
    except (RuntimeError, ValueError) as error:
        known = ", ".join(str(device) for device in wp.get_devices())
        raise UserError(f"there is no device {name!r}; there are: {known}") from error


def device_notes(name: str | None) -> list[str]:
    """What the user should know of the device that was not chosen, a sentence each."""
    if name is None and not wp.is_cuda_available():
        return ["there is no CUDA device, so it runs on the CPU"]
    return []


def check_writable(*paths: Path | None) -> None:
    """Check before the work that its results can be written; None is nothing to write.

    Raises:
        UserError: The folder of a file does not exist, or the file cannot be written.
    """
    for path in filter(None, paths):
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
