# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""All hard cases by name, and by what is hard about them."""

from newton_avbd.study.stability.bodies import BODIES
from newton_avbd.study.stability.case import Case, Catalog
from newton_avbd.study.stability.fast import FAST
from newton_avbd.study.stability.joints import JOINTS
from newton_avbd.study.stability.piles import PILES
from newton_avbd.study.stability.pushed import PUSHED
from newton_avbd.study.stability.steps import STEPS

GROUPS: dict[str, Catalog] = {
    "Piles": PILES,
    "Pushed piles": PUSHED,
    "Joints": JOINTS,
    "Bodies and contacts": BODIES,
    "Thin and fast bodies": FAST,
    "Steps and interventions": STEPS,
}
"""Cases by what is hard about them."""

CASES: dict[str, Case] = {**PILES, **PUSHED, **JOINTS, **BODIES, **FAST, **STEPS}
"""All cases by name."""
