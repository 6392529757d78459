# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Which effects a scene calls for; kernels hold code for those and no others."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Effects:
    gyroscopic: bool
    friction: bool
    compliance: bool
    ramp: bool
    single_world: bool
    matching: bool
