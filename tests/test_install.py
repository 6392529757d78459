# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What an install brings: versions that go together."""

import importlib.metadata
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parent.parent


def mujoco_of(requirements: list[str]) -> dict[str, Requirement]:
    """Requirements of MuJoCo and MuJoCo Warp, by name."""
    found = [Requirement(text) for text in requirements]
    return {item.name: item for item in found if item.name in ("mujoco", "mujoco-warp")}


def test_mujoco_is_pinned_as_newton_pins_it() -> None:
    """The extra ``scenes`` allows what newton[sim] allows, and with it no MuJoCo 4."""
    newton_sim = mujoco_of(
        [text for text in importlib.metadata.requires("newton") if "extra == 'sim'" in text]
    )
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    scenes = mujoco_of(project["optional-dependencies"]["scenes"])
    assert scenes.keys() == {"mujoco", "mujoco-warp"}
    for name, pin in scenes.items():
        assert pin.specifier == newton_sim[name].specifier
        assert not pin.specifier.contains("4.0.0")
        assert pin.specifier.contains(importlib.metadata.version(name))
