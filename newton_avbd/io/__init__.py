# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What commands read and print: scenes, files and solvers by name, a terminal."""

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""
