# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Progress, Ctrl-C, and what other libraries print, on a terminal."""

import ctypes
import os
import re
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TextIO, TypeVar

from tqdm import tqdm

from . import INTERRUPTED

Item = TypeVar("Item")

FIRST = "the first may compile kernels"
"""Shown until the first item is done: it can take a minute, once on a machine."""

_NO_DRIVER = "Could not find or load the NVIDIA CUDA driver"
_PARTICULAR = re.compile(r"'[^']*'|\"[^\"]*\"|\d+")
"""What tells apart two warnings of one kind: names in quotes, and numbers."""


def progress(
    items: Iterable[Item], total: int | None, label: str, name: Callable[[Item], str] | None = None
) -> Iterator[Item]:
    """Yield ``items`` and show on standard error how far they are, if that is a terminal.

    Args:
        items: What is worked through.
        total: How many there are; None where nobody knows.
        label: What they are.
        name: Names the item that is being worked on; None for no name.
    """
    with tqdm(
        total=total, desc=label, file=sys.stderr, disable=None, leave=False, postfix=FIRST
    ) as bar:
        for item in items:
            if name is not None:
                bar.set_description_str(f"{label}, {name(item)}")
            yield item
            if bar.n == 0:
                bar.set_postfix_str("", refresh=False)
            bar.update()


def say(text: str, file: TextIO | None = None) -> None:
    """Print a line above the bar of :func:`progress`, at once."""
    file = file or sys.stdout
    tqdm.write(text, file=file)
    file.flush()


def say_notes(notes: Sequence[str]) -> None:
    """Write what the user should know to standard error."""
    for note in notes:
        say(f"newton-avbd: {note}", sys.stderr)


@contextmanager
def showing(what: str) -> Iterator[None]:
    """Show what the block does, until it ends, on standard error if that is a terminal."""
    show(f"{what} ...")
    try:
        yield
    finally:
        show("")


def show(text: str) -> None:
    """Show a line in the place of the last one so shown, if standard error is a terminal."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


class Interruption:
    """Whether Ctrl-C ended a block.

    Attributes:
        happened: Whether it did.
    """

    happened = False

    def status(self, status: int) -> int:
        """The command's exit status: ``status``, or :data:`~newton_avbd.io.INTERRUPTED`."""
        return INTERRUPTED if self.happened else status


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Let Ctrl-C end the block and not the command, so that the command reports what is done."""
    interruption = Interruption()
    try:
        yield interruption
    except KeyboardInterrupt:
        interruption.happened = True
        say_notes(["stopped by Ctrl-C; this is what was done until then"])


@contextmanager
def gathered_warnings() -> Iterator[None]:
    """Print the warnings of the block at its end, those that differ in names only in one line.

    With ``python -W`` or ``PYTHONWARNINGS`` they are printed as Python does it.
    """
    if sys.warnoptions:
        yield
        return
    kinds: dict[str, list[str]] = {}

    def gather(message: Warning | str, *details: object, **options: object) -> None:
        text = " ".join(str(message).split())
        kinds.setdefault(_PARTICULAR.sub("", text), []).append(text)

    try:
        with warnings.catch_warnings():
            warnings.showwarning = gather
            yield
    finally:
        for texts in kinds.values():
            different = len(set(texts)) - 1
            more = f" (and {different} more of this kind: PYTHONWARNINGS=default shows all)"
            say_notes([f"warning: {texts[0]}{more if different else ''}"])


@contextmanager
def gathered_prints() -> Iterator[None]:
    """Print what the kernels of solvers print in the block at its end, to standard error.

    Lines that differ in numbers only are printed once. Standard output is left to the answer.
    """
    kinds: dict[str, list[str]] = {}
    sys.stdout.flush()
    kept = os.dup(1)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 1)
        try:
            yield
        finally:
            sys.stdout.flush()
            # kernels print by the C library, which keeps lines back where this is no terminal
            ctypes.CDLL("msvcrt" if os.name == "nt" else None).fflush(None)
            os.dup2(kept, 1)
            os.close(kept)
            file.seek(0)
            for text in filter(None, file.read().decode(errors="replace").splitlines()):
                kinds.setdefault(_PARTICULAR.sub("", text), []).append(text)
            for texts in kinds.values():
                more = f" (and {len(texts) - 1} more of this kind)" if len(texts) > 1 else ""
                say_notes([f"{texts[0]}{more}"])


def start_warp() -> None:
    """Initialize Warp without its greeting and without its warning where there is no GPU."""
    import warp as wp  # here, so that what prints without Warp does not wait for it

    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        file.seek(0)
        printed = file.read().decode(errors="replace").splitlines()
    for line in printed:
        if _NO_DRIVER not in line:
            print(line, file=sys.stderr)
