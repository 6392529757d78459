# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Tables on a terminal, and numbers for programs."""

import contextlib
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from newton_avbd.io.errors import UserError

STANDARD_OUTPUT = Path("-")
"""What a user types to have JSON on standard output instead of in a file."""


def tables_beside(path: Path | None) -> contextlib.AbstractContextManager[object]:
    """Let a block print its tables to standard error if JSON goes to standard output."""
    if path == STANDARD_OUTPUT:
        return contextlib.redirect_stdout(sys.stderr)
    return contextlib.nullcontext()


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say which file or folder it is that a block cannot write.

    Raises:
        UserError: It cannot.
    """
    try:
        yield
    except OSError as error:
        to = "to " if path.is_dir() else ""
        raise UserError(f"cannot write {to}{path}: {error}") from error


def write_json(path: Path, document: Any) -> None:
    """Write what a command measured.

    Args:
        path: The file, or :data:`STANDARD_OUTPUT`.
        document: What JSON can hold.

    Raises:
        UserError: The file cannot be written.
    """
    text = f"{json.dumps(document, indent=1)}\n"
    if path == STANDARD_OUTPUT:
        sys.stdout.write(text)
        return
    with writing(path):
        path.write_text(text)


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
