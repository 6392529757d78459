# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Tables and progress on a terminal."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

Item = TypeVar("Item")


def table(rows: Sequence[Sequence[str]]) -> str:
    """Lay rows of cells out in columns: the first to the left, the others to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def length(value: float) -> str:
    """Write a length [m] in millimeters, as small as float32 makes sense."""
    return f"{1e3 * value + 0.0:.4g} mm"


def say_notes(notes: Sequence[str]) -> None:
    """Write what the user should know of a scene to standard error."""
    for note in notes:
        print(f"newton-avbd: {note}", file=sys.stderr)


def progress(frames: Iterable[Item], total: int, label: str) -> Iterator[Item]:
    """Yield ``frames`` and show on standard error how far they are, if that is a terminal."""
    shown = sys.stderr.isatty()
    for frame, item in enumerate(frames):
        if shown:
            filled = "#" * (30 * frame // total)
            print(f"\r{label} [{filled:<30}] {frame}/{total}", end="", file=sys.stderr, flush=True)
        yield item
    if shown:
        print("\r\033[K", end="", file=sys.stderr, flush=True)
