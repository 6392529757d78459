# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""All that a step does with the trees of joints, compiled for the effects of a scene.

Each part has a file: how joints stand at the start of a step (:mod:`.step.joint_start`), a sweep
(:mod:`.step.sweep_tree`), coordinates (:mod:`.step.coordinates`), and what comes after the sweeps
(:mod:`.step.spin_alignment`, :mod:`.step.forward_kinematics`).
"""

import warp as wp

from ..effects import Effects
from ..functions import Functions, together
from .coordinates import make_coordinates
from .forward_kinematics import make_forward_kinematics
from .gathering import ContactLaw
from .joint_start import make_joint_start
from .kernels import absent
from .spin_alignment import make_align_spins
from .sweep_tree import make_sweep_tree
from .trapezoid import make_trapezoid


def make_trees(
    effects: Effects,
    law: ContactLaw,
    gather: wp.Function,
    begin_rows: wp.Function,
    keep_forces: wp.Function,
    settle_tendons: wp.Function,
) -> Functions:
    """Device functions: how joints stand, and one Newton iteration on a tree.

    Args:
        effects: What the kernel is compiled with.
        law: What contacts push with.
        gather: Device function that sums the inertial and contact wrench of a body.
        begin_rows: Device function that starts the closures of a block.
        keep_forces: Device function that keeps what they push with.
        settle_tendons: Device function that measures what tendons are off by.
    """
    coordinates = make_coordinates(effects)
    start = make_joint_start(effects)
    forward = make_forward_kinematics(effects)
    sweep_tree = make_sweep_tree(effects, law, gather, begin_rows, keep_forces, settle_tendons)
    move_by_trapezoid = make_trapezoid(effects, forward) if effects.trapezoidal else absent
    return together(
        start,
        coordinates,
        forward,
        align_spins=make_align_spins(effects),
        sweep_tree=sweep_tree,
        move_by_trapezoid=move_by_trapezoid,
    )
