# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Device functions that belong together: what those who make them for a scene return."""

import warp as wp


class Functions:
    """Device functions by name."""

    def __init__(self, functions: dict[str, wp.Function]) -> None:
        vars(self).update(functions)


def together(*parts: "wp.Function | Functions", **renamed: wp.Function) -> Functions:
    """Device functions by their own names, all of other groups, and some by other names."""
    found: dict[str, wp.Function] = {}
    for part in parts:
        found |= vars(part) if isinstance(part, Functions) else {part.func.__name__: part}
    return Functions(found | renamed)
