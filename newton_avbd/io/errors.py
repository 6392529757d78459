# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Errors that are the user's to mend, told in a sentence instead of a traceback."""

import importlib.util

EXTRAS = {
    "mujoco": "scenes",
    "mujoco_warp": "scenes",
    "pxr": "scenes",
    "trimesh": "scenes",
    "PIL": "view",
    "imgui_bundle": "view",
    "pyglet": "view",
    "rerun": "view",
    "viser": "view",
    "matplotlib": "study",
    "scipy": "study",
    "gymnasium": "learning",
}
"""Which extra of this package brings an importable module."""

BESIDE = {"dm_control": "'newton-avbd[learning]' dm_control"}
"""What to install for modules that no extra brings, with the versions that go with them."""


class UserError(Exception):
    """What was asked for cannot be done; the message says why and what would help."""


def missing(module: str) -> UserError:
    """Error for a module that is not installed, with the command that installs it."""
    top = module.partition(".")[0]
    extra = f"'newton-avbd[{EXTRAS[top]}]'" if top in EXTRAS else "'newton[examples]'"
    what = BESIDE.get(top, extra)
    return UserError(f"this needs the Python package {top}: pip install {what}")


def missing_of(error: ImportError) -> UserError:
    """Error for what could not be imported; Newton's importers wrap the one that names it."""
    cause = error if error.name else error.__cause__
    return missing(getattr(cause, "name", None) or "newton")


def require(*modules: str) -> None:
    """Check that modules are installed, without importing them.

    Raises:
        UserError: One of them is not.
    """
    for module in modules:
        if not is_installed(module):
            raise missing(module)


def is_installed(*modules: str) -> bool:
    """Whether all of these modules are installed, without importing them."""
    return all(importlib.util.find_spec(module) is not None for module in modules)
