# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Names that a user types and the command line knows; this module imports nothing."""

SOLVERS = ("avbd", "vbd", "xpbd", "mujoco", "kamino")
"""Names of the solvers, ours first."""

CONTROLS = ("sine", "random", "keyframe")
"""What ``--ctrl`` takes; ``keyframe`` holds those of the file's first."""

SUFFIXES = (".usd", ".usda", ".usdc", ".urdf", ".xml")
"""Endings of the files that can be read."""

VIEWERS = ("null", "gl", "usd", "rerun", "viser")
"""Names of the viewers; ``null`` shows nothing."""

AUTO = "auto"
"""Stands for the viewer that works here."""
