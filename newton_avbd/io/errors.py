# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Errors that are the user's to mend, told in a sentence instead of a traceback."""

import difflib
import importlib.util
import re
import textwrap
from collections.abc import Iterable

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


def meant(name: str, known: Iterable[str]) -> list[str]:
    """At most three of ``known`` that a name may stand for: by a word, a part, or nearly."""
    words = {other: re.split(r"[_/. -]", other.lower()) for other in known}
    wanted = name.lower()
    close = (
        [other for other in words if wanted in words[other]]
        or [other for other in words if wanted and wanted in other.lower()]
        or difflib.get_close_matches(name, words)
        or [other for other in words if difflib.get_close_matches(wanted, words[other], 1, 0.8)]
    )
    return close[:3]


def unknown(kind: str, name: str, known: Iterable[str]) -> UserError:
    """Error for a name that is none of ``known``: which there are, and last which may be meant."""
    names = list(known)
    told = textwrap.fill(
        f"there is no {kind} {name!r}; there are: {', '.join(names)}",
        width=98,
        subsequent_indent="  ",
        break_on_hyphens=False,
    )
    close = meant(name, names)
    return UserError(f"{told}\nDid you mean {' or '.join(close)}?" if close else told)


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
