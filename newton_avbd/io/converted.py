# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Robots as USD files, made by Newton's converters of URDF and MJCF files."""

import importlib.util
import subprocess
import sys
from dataclasses import replace
from importlib import metadata
from pathlib import Path

from .errors import UserError
from .robots import Robot

CONVERTERS = {".urdf": "urdf_usd_converter", ".xml": "mujoco_usd_converter"}
"""Module that converts files with each ending."""

_SCRIPT = "import sys, {module}; print({module}.Converter().convert(sys.argv[1], sys.argv[2]).path)"


def require_converters() -> None:
    """Check that the converters are installed, and that they can load USD.

    Raises:
        UserError: They are not, or cannot; the message has the commands that help.
    """
    absent = [name for name in CONVERTERS.values() if importlib.util.find_spec(name) is None]
    if absent:
        packages = " ".join(name.replace("_", "-") for name in CONVERTERS.values())
        raise UserError(f"this needs the Python package {absent[0]}: pip install {packages}")
    if {"usd-core", "usd-exchange"} <= _installed():
        # Both bring the modules of USD, of different builds: the converters end with a fault.
        raise UserError(
            "the converters bring USD themselves (usd-exchange), and usd-core is in their way: "
            "pip uninstall usd-core && pip install --force-reinstall --no-deps usd-exchange"
        )


def _installed() -> set[str]:
    return {str(package.metadata["Name"]).lower() for package in metadata.distributions()}


def can_convert(robot: Robot) -> bool:
    """Whether a converter takes the robot's file."""
    return robot.path.suffix in CONVERTERS


def as_usd(robot: Robot, folder: Path) -> Robot:
    """Convert a robot's file to USD.

    Args:
        robot: The robot; :func:`can_convert` takes it.
        folder: Where to write the USD file, in a folder of its own.

    Returns:
        The robot with the path of its USD file.

    Raises:
        UserError: The converter fails.
    """
    target = folder / robot.name.replace("/", "_")
    # In a process of its own: USD knows no schemas that are registered after its first stage.
    command = [sys.executable, "-c", _SCRIPT.format(module=CONVERTERS[robot.path.suffix])]
    done = subprocess.run(
        [*command, str(robot.path), str(target)], capture_output=True, text=True, check=False
    )
    if done.returncode < 0:
        raise UserError(f"cannot be converted: the converter ended by signal {-done.returncode}")
    if done.returncode:
        lines = done.stderr.strip().splitlines()
        raise UserError(f"cannot be converted: {lines[-1] if lines else done.returncode}")
    return replace(robot, path=Path(done.stdout.splitlines()[-1]))
