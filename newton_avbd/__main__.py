# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""The command line, ``newton-avbd`` or ``python -m newton_avbd``."""

import sys
from collections.abc import Sequence

from newton_avbd.io import INTERRUPTED


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; without one, list them.

    Args:
        argv: Arguments without the program's name; None for those of the process. What follows
            ``--`` goes to a Newton example.

    Returns:
        Exit status: 0, 1 where a scene fails its own test, 2 where the command cannot be done,
        130 after Ctrl-C.
    """
    try:
        # here, so that Ctrl-C ends an import as it ends a command
        from newton_avbd.commands.program import dispatch

        return dispatch(argv)
    except KeyboardInterrupt:
        print("\nnewton-avbd: stopped by Ctrl-C", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
