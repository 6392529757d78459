# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Names that a user types and the command line knows; this module imports nothing."""

SOLVERS = ("avbd", "vbd", "xpbd", "mujoco", "kamino")
"""Names of the solvers, ours first."""

TIMED = (
    *("avbd", "vbd", "xpbd", "mujoco", "mujoco_warp", "steel", "kamino", "semi_implicit"),
    *("featherstone", "mj_step"),
)
"""Names of those that ``newton-avbd bench`` measures; ``mj_step`` is MuJoCo without Newton."""

REFINED = ("avbd", "vbd", "xpbd", "mj_step", "mujoco_warp", "kamino", "featherstone")
"""Names of those whose error ``newton-avbd accuracy`` measures."""

ACTUATED = ("avbd", "mujoco")
"""Names of those that read ``control.mujoco.ctrl``, and that take links of next to no mass."""

CONTROLS = ("sine", "random", "keyframe")
"""What ``--ctrl`` takes; ``keyframe`` holds those of the file's first."""

SUFFIXES = (".usd", ".usda", ".usdc", ".urdf", ".xml")
"""Endings of the files that can be read."""

VIEWERS = ("null", "gl", "usd", "rerun", "viser")
"""Names of the viewers; ``null`` shows nothing."""

AUTO = "auto"
"""Stands for the viewer that works here."""
