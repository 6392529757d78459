# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""ROD joints that close loops, solved with a tree: a row of finite stiffness for each of six axes.

With the force f along an axis and its stiffness K, springs and dampers of the step together, a row
asks for A u - f/K = lambda/K: where that leaves the axis, the force is -lambda.
"""

import warp as wp

from ..data import Closure, Solver
from ..effects import Effects
from ..rows.contact import PENALTY
from ..rows.free_axes import make_free_axes
from ..rows.rod import rod_torque
from .anchors import loop_geometry
from .loop_axes import make_loop_axes
from .loop_rows import ends_of, row_about, row_along


def make_rod_rows(effects: Effects) -> wp.Function:
    """Device function: the rows of a ROD joint."""
    axis_of = make_free_axes(effects.kinds).axis_of
    loop_axes = make_loop_axes(effects)
    coordinate_of, rod_force = loop_axes.coordinate_of, loop_axes.rod_force

    @wp.func(inline=effects.inline)
    def rod_rows(closure: Closure, h: float, s: wp.ref[Solver]):
        """The rows of a ROD joint: stretch and shears, then bends and twist."""
        closures = s.tree.closures
        i = closure.loop
        if s.loops.k_l[i] == 0.0:
            return
        joint = s.loops.joints[i]
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, s)
        arm_p += offset
        s.loops.arms[2 * i] = arm_c
        s.loops.arms[2 * i + 1] = arm_p
        ends = ends_of(joint, arm_c, arm_p, s)
        for dof in range(6):
            row = closure.row + dof
            index = s.joints.dof_start[joint] + dof
            start = s.loops.start_coordinate[index]
            q = coordinate_of(i, dof, q_p, q_c, offset, start, s)
            force, stiffness = rod_force(joint, dof, q, wp.float32(q - start), h, s)
            if stiffness <= 0.0:
                continue
            if dof < 3:
                n = axis_of(s.joints, joint, dof, q_p, q_c, wp.vec3(0.0))
                row_along(row, n, ends, s)
                closures.least[row] = PENALTY / s.loops.k_l[i]
            else:
                answer = wp.vec3(0.0)
                answer[dof - 3] = 1.0
                n = rod_torque(q_p, q_c, answer)
                row_about(row, n, ends, s)
                closures.least[row] = PENALTY / s.loops.k_a[i]
            closures.gives[row] = 1.0 / stiffness
            closures.multiplier[row] = wp.float64(-force / stiffness)

    return rod_rows
