# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels hold code for the joints of the scene and for no others."""

import dataclasses
import re

import newton
import numpy as np
import pytest
import warp as wp

from newton_avbd import Effects, SolverAVBD
from newton_avbd.drivers.world import make_solve
from newton_avbd.rows.joint import JointKinds
from newton_avbd.study.effects.stripped import source


def effects_of(**joint: float) -> Effects:
    """Effects of two bodies on hinges whose second joint has these settings."""
    builder = newton.ModelBuilder()
    links = [builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3))) for _ in range(2)]
    joints = [
        builder.add_joint_revolute(-1, links[0]),
        builder.add_joint_revolute(links[0], links[1], **joint),
    ]
    builder.add_articulation(joints)
    return SolverAVBD(builder.finalize(device="cpu"), scheme="euler").effects.flags


HINGES = Effects(
    contact=False,
    friction=False,
    gyroscopic=False,
    joint_force=False,
    kinds=JointKinds(linear=(0,), angular=(1,)),
)


def test_a_chain_of_hinges_calls_for_hinges_alone() -> None:
    """No contacts, no drives, no limits, no other joints, no loops."""
    assert effects_of() == HINGES


@pytest.mark.parametrize(
    ("settings", "effect"),
    [
        ({"target_ke": 10.0}, "drives"),
        ({"target_kd": 1.0}, "drives"),
        ({"limit_lower": -1.0}, "limits"),
        ({"limit_upper": 1.0}, "limits"),
    ],
)
def test_what_one_joint_calls_for_is_one_effect(settings: dict[str, float], effect: str) -> None:
    """And nothing else comes with it."""
    assert effects_of(**settings) == dataclasses.replace(HINGES, **{effect: True})


def test_code_of_other_joints_is_not_compiled() -> None:
    """Inverse sines are for Euler angles, inverse tangents for coordinates: hinges need neither."""
    assert not {"asin", "angle_of"} & called(HINGES)
    limited = called(dataclasses.replace(HINGES, limits=True))
    assert {"asin", "angle_of"} & limited == {"angle_of"}
    euler = JointKinds(linear=(0,), angular=(2,), euler=True)
    universal = called(dataclasses.replace(HINGES, kinds=euler))
    assert "asin" in universal


def called(effects: Effects) -> set[str]:
    """Functions that the code of the solve kernel calls, as Warp generates and numbers them."""
    return set(re.findall(r"\b([a-z]\w*?)(?:_\d+)?\(", source(make_solve(effects))))
