# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The step of large worlds: the kernels that :class:`.large.LargeWorlds` launches.

What ``world.solve_world`` does in one thread, a kernel does here for one phase and all bodies: the
mathematics is the same functions. A tree of joints is one thread's work, as in a world. A
sweep takes a launch for each color, and as blocks of a color share no contact and no joint, that is
what a sweep of one thread in the order of the colors computes. Where nothing moves any more, the
launches that are left return at once.
"""

import functools
import hashlib
from types import SimpleNamespace

from ..effects import Effects
from ..step.kernels import in_module, uncollected
from .colored_energy import make_colored_energy
from .colored_impacts import make_colored_impacts
from .colored_joints import make_colored_joints
from .colored_motion import make_colored_motion
from .colored_recovery import make_colored_recovery
from .colored_rows import make_colored_rows
from .colored_second_order import make_colored_second_order
from .colored_sweeps import make_colored_sweeps
from .joining import join_at_once
from .stages import make_stages


@functools.cache
@uncollected()
def make_colored(effects: Effects) -> SimpleNamespace:
    """The kernels of a large world by name, in one module, which compiles at once.

    None stands for those of effects that the scene does without; of a file that is all for an
    effect there are none at all.
    """
    stages = make_stages(effects, join_at_once)
    digest = hashlib.sha256(repr(effects).encode()).hexdigest()[:8]
    kernel, kernels = in_module(f"{__name__}_{digest}")
    if effects.restitution:
        make_colored_impacts(stages.impacts, kernel)
    if effects.second_order:
        make_colored_second_order(effects, stages, kernel)
    if effects.balanced:
        make_colored_energy(effects, stages.energy, kernel)
    make_colored_rows(effects, kernel)
    make_colored_joints(effects, stages, kernel)
    make_colored_sweeps(effects, stages, kernel)
    make_colored_motion(effects, stages, kernel)
    make_colored_recovery(effects, stages, kernel)
    return kernels
