# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A batch in shards by Ray moves as in one process, to the bit, though one of them is lost."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parent.parent / "examples" / "ray" / "sharded_ants.py"


def test_shards_move_as_one_batch_though_one_is_killed() -> None:
    """The example compares each rollout with one of all worlds in a process of its own."""
    pytest.importorskip("ray")
    pytest.importorskip("mujoco")
    command = [sys.executable, EXAMPLE, "--worlds", "5", "--shards", "2", "--rollouts", "2"]
    quiet = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0"}
    done = subprocess.run([*command, "--test"], capture_output=True, text=True, env=quiet)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the same bits" in done.stdout
