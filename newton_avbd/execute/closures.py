# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Equations between the bodies of a tree, solved with it: joints that close loops, and mimics.

The tree alone would move by delta_0, the minimum of its quadratic model. Rows J delta = -r, with
the multipliers mu that hold them, add

    delta = delta_0 - T^-1 J^T mu,   (J T^-1 J^T) mu = J delta_0 + r,

where T is the tree's matrix, factored by elimination from the leaves to the root. A row goes down
the same way, from the bodies that it names to the root, and meets the axes that were eliminated:
with y_a what it meets of axis a and D_a the axis' pivot,

    J T^-1 J^T = sum_a y_a y_a^T / D_a,   J delta_0 = sum_a y_a p_a / D_a + ...,

and the multipliers push an axis by -y_a mu (Featherstone, "Rigid Body Dynamics Algorithms",
chapter 8: loop closure on top of the articulated-body recursion). A row that the others imply
already, as most are in a planar mechanism, or that nothing can move, is left out by the Cholesky
factorisation.
"""

from dataclasses import dataclass

import warp as wp

from ..algebra.block import half_solve
from ..blocks.tree import handed_down
from ..data import (
    BodyModel,
    BodyWork,
    Closure,
    ClosureBlock,
    ClosureWork,
    History,
    JointModel,
    LoopWork,
    TreeWork,
    WorldWork,
)
from ..effects import Effects
from ..rows import joint as joint_rows
from ..rows.contact import PENALTY
from .loops import loop_geometry, parent_slot
from .trees import ROUNDING, is_linked

IMPLIED = wp.constant(1.0e-4)
"""Pivot from which a row says nothing new, as a share of what it had before elimination: above what
rounding leaves of it after hundreds of others."""
HARDLY_MOVED = wp.constant(1.0e-6)
"""A row says nothing that moves less than this share of what the joint's others do, each taken
against how it would move were its bodies free."""
IMMOVABLE = wp.constant(1.0e-10)
"""Nor one that moves less than this share of how it would move were its bodies free."""


@wp.func
def mimic_misfit(
    closure: Closure,
    dof: int,
    coordinate: wp.array[float],
    joints: JointModel,
    tree: TreeWork,
) -> float:
    """q - (offset + multiplier q_leader) of a mimic joint [m or rad]."""
    coefficients = joints.mimic_coefficients[closure.joint]
    leader = coordinate[tree.axis_start[closure.leader_body] + dof]
    follower = coordinate[tree.axis_start[closure.body] + dof]
    return follower - (coefficients[0] + coefficients[1] * leader)


@wp.func
def row_push(at: int, block: ClosureBlock, columns: int, closures: ClosureWork) -> float:
    """y_a mu of the axis whose column in the block's first row of ``met`` lies at ``at``."""
    push = float(0.0)
    for row in range(block.rows):
        push += closures.met[at + row * columns] * closures.multiplier[block.row + row]
    return push


@wp.func
def is_mimicking(closure: Closure, joints: JointModel, tree: TreeWork) -> bool:
    """Whether a mimic joint and its leader are enabled."""
    return is_linked(joints, tree, closure.body) and is_linked(joints, tree, closure.leader_body)


@wp.func
def axis_of_projection(lock: wp.mat33, count: int) -> wp.vec3:
    """The one direction that a projection to ``count`` keeps, or the one that it does not."""
    kept = lock
    if count != 1:
        kept = wp.identity(n=3, dtype=float) - lock
    longest = int(0)
    for k in range(1, 3):
        if kept[k, k] > kept[longest, longest]:
            longest = k
    return wp.normalize(wp.vec3(kept[0, longest], kept[1, longest], kept[2, longest]))


@wp.func
def direction_about(axis: wp.vec3, i: int) -> wp.vec3:
    """Direction 0, 1 or 2 of a frame whose last direction is ``axis``."""
    if i == 2:
        return axis
    least = int(0)
    for k in range(1, 3):
        if wp.abs(axis[k]) < wp.abs(axis[least]):
            least = k
    direction = wp.vec3(0.0)
    direction[least] = 1.0
    direction = wp.normalize(wp.cross(axis, direction))
    if i == 1:
        direction = wp.cross(axis, direction)
    return direction


@dataclass(frozen=True)
class ClosureFunctions:
    """Device functions of closures, compiled for the joints of a scene."""

    begin_closures: wp.Function
    close_tree: wp.Function


def make_closures(effects: Effects) -> ClosureFunctions:
    """Device functions: how mimics stand at the start of the step, and the solve of all rows."""
    joint_functions = joint_rows.make_joint(effects.kinds)
    linear_count = joint_functions.linear_count
    angular_count = joint_functions.angular_count
    linear_misfit = joint_functions.linear_misfit
    linear_lock = joint_functions.linear_lock
    angular_misfit = joint_functions.angular_misfit
    angular_lock = joint_functions.angular_lock

    @wp.func
    def begin_closures(first: int, joints: JointModel, tree: TreeWork) -> bool:
        """Misfit of the mimics of a block, which starts at ``first``, at the start of the step.

        Returns whether one is beyond rounding.
        """
        closures = tree.closures
        number = closures.block_of[first]
        if number < 0:
            return False
        is_open = bool(False)
        block = closures.blocks[number]
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            if closure.loop < 0 and is_mimicking(closure, joints, tree):
                for dof in range(closure.rows):
                    misfit = mimic_misfit(closure, dof, tree.start_coordinate, joints, tree)
                    closures.misfit[closure.row + dof] = misfit
                    reach = tree.start_coordinate[tree.axis_start[closure.body] + dof]
                    rounding = tree.rounding[closure.body] + 2.0 * ROUNDING * (2.0 + wp.abs(reach))
                    if wp.abs(misfit) > rounding:
                        is_open = True
        return is_open

    @wp.func
    def axis_count(body: int, joints: JointModel, tree: TreeWork) -> int:
        """Axes of the joint that links a body to its parent."""
        joint = tree.joint[body]
        return linear_count(joints, joint) + angular_count(joints, joint)

    @wp.func
    def go_down(
        y: int,
        slot: int,
        wrench: wp.spatial_vector,
        other_slot: int,
        other_wrench: wp.spatial_vector,
        joints: JointModel,
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
    ) -> float:
        """Takes a row down to the root from the two bodies that it names; returns J delta_0.

        What it meets is added to the row of ``closures.met`` that starts at ``y``, where a mimic's
        coefficients lie already.
        """
        closures = tree.closures
        moved = float(0.0)
        a = slot
        b = other_slot
        w = wrench
        w_b = other_wrench
        if work.inv_mass[a] == 0.0:
            a = -1
        if work.inv_mass[b] == 0.0:
            b = -1
        while a >= 0 or b >= 0:
            if a == b:
                w += w_b
                b = -1
            if b >= 0:
                is_deeper = bool(True)
                if a >= 0:
                    is_deeper = worlds.rank[b] > worlds.rank[a]
                if is_deeper:
                    swapped = a
                    a = b
                    b = swapped
                    swapped_w = w
                    w = w_b
                    w_b = swapped_w
            start = y + closures.column[a]
            if not is_linked(joints, tree, a):
                half = half_solve(work.factor[a], wp.spatial_top(w), wp.spatial_bottom(w))
                for i in range(6):
                    closures.met[start + i] = half[i]
                moved += wp.dot(half, tree.update[a])
                a = -1
            else:
                moved += wp.dot(w, tree.closing[a])
                for dof in range(axis_count(a, joints, tree)):
                    axis = tree.axes[tree.axis_start[a] + dof]
                    met = closures.met[start + dof]
                    met += wp.dot(axis.linear, wp.spatial_top(w))
                    met += wp.dot(axis.angular, wp.spatial_bottom(w))
                    closures.met[start + dof] = met
                    moved += met * (axis.inv_pivot * axis.push + axis.step)
                    w -= (met * axis.inv_pivot) * wp.spatial_vector(axis.force, axis.torque)
                w = handed_down(tree.span[a], w)
                a = tree.parent[a]
                if work.inv_mass[a] == 0.0:
                    a = -1
        return moved

    @wp.func
    def loop_rows(
        block: ClosureBlock,
        columns: int,
        closure: Closure,
        recovery: float,
        h: float,
        model: BodyModel,
        joints: JointModel,
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        loops: LoopWork,
    ):
        """The rows of a joint that closes a loop: what it locks, linear rows first."""
        closures = tree.closures
        i = closure.loop
        if loops.k_l[i] == 0.0:
            return
        joint = loops.joints[i]
        static_slot = work.inv_mass.shape[0] - 1
        child = joints.child[joint]
        parent = parent_slot(joints, joint, static_slot)
        q_p, q_c, arm_p, arm_c, offset = loop_geometry(i, model, joints, work, tree, loops)
        shift = linear_misfit(joints, joint, q_p, offset)
        arm_p += offset - shift
        turn = angular_misfit(joints, joint, q_p, q_c)
        if recovery == 0.0:
            shift -= wp.spatial_top(loops.misfit[i])
            turn -= wp.spatial_bottom(loops.misfit[i])
        linear = 3 - linear_count(joints, joint)
        angular = closure.rows - linear
        lock_l = linear_lock(joints, joint, q_p)
        lock_a = angular_lock(joints, joint, q_p, q_c)
        # along the axis of a hinge, too: in a planar mechanism the others imply just that row
        axis_a = wp.quat_rotate(q_p, wp.vec3(0.0, 0.0, 1.0))
        if angular == 1 or angular == 2:
            axis_a = axis_of_projection(lock_a, angular)
        axis_l = axis_a
        if linear == 1 or linear == 2:
            axis_l = axis_of_projection(lock_l, linear)
        mobility = float(0.0)
        for k in range(closure.rows):
            row = closure.row + k
            y = block.met + (row - block.row) * columns
            push_c = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            push_p = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
            left = float(0.0)
            n = wp.vec3(0.0)
            if k < linear:
                n = direction_about(axis_l, wp.where(linear == 1, 2, k))
                push_c = wp.spatial_vector(n, wp.cross(arm_c, n))
                push_p = -wp.spatial_vector(n, wp.cross(arm_p, n))
                left = wp.dot(n, shift)
                closures.least[row] = PENALTY / loops.k_l[i]
            else:
                n = direction_about(axis_a, wp.where(angular == 1, 2, k - linear))
                push_c = wp.spatial_vector(wp.vec3(0.0), n)
                push_p = -push_c
                left = wp.dot(n, turn)
                closures.least[row] = PENALTY / loops.k_a[i]
            closures.direction[row] = n
            moved = go_down(y, child, push_c, parent, push_p, joints, worlds, work, tree)
            closures.multiplier[row] = moved + left
            whole = float(0.0)
            for column in range(columns):
                met = closures.met[y + column]
                whole += met * met * closures.inverse[block.axis + column]
            mobility = wp.max(mobility, whole / closures.least[row])
        least = wp.max(HARDLY_MOVED * mobility, IMMOVABLE)
        for row in range(closure.row, closure.row + closure.rows):
            closures.least[row] = least * closures.least[row]

    @wp.func
    def mimic_rows(
        block: ClosureBlock,
        columns: int,
        closure: Closure,
        recovery: float,
        joints: JointModel,
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
    ):
        """The rows of a mimic joint, one for each of its coordinates."""
        closures = tree.closures
        if not is_mimicking(closure, joints, tree):
            return
        none = wp.spatial_vector(wp.vec3(0.0), wp.vec3(0.0))
        multiplier = joints.mimic_coefficients[closure.joint][1]
        for dof in range(closure.rows):
            row = closure.row + dof
            y = block.met + (row - block.row) * columns
            closures.met[y + closures.column[closure.body] + dof] = 1.0
            closures.met[y + closures.column[closure.leader_body] + dof] = -multiplier
            left = mimic_misfit(closure, dof, tree.coordinate, joints, tree)
            if recovery == 0.0:
                left -= closures.misfit[row]
            moved = go_down(
                y, closure.body, none, closure.leader_body, none, joints, worlds, work, tree
            )
            closures.least[row] = 0.0
            closures.multiplier[row] = moved + left

    @wp.func
    def solve_rows(block: ClosureBlock, columns: int, closures: ClosureWork):
        """Multipliers of a block's rows: Cholesky factorisation of J T^-1 J^T, and substitution.

        Rows that the ones before them imply are left out, with multipliers of zero. Row p of the
        factor is that of row ``kept[p]``, and holds the inverse of its diagonal.
        """
        n = block.rows
        count = int(0)
        for i in range(n):
            y_i = block.met + i * columns
            # a row meets the axes on its way to the root only
            axes = int(0)
            whole = float(0.0)
            for k in range(columns):
                met = closures.met[y_i + k]
                if met != 0.0:
                    share = met * closures.inverse[block.axis + k]
                    closures.share[block.axis + axes] = share
                    closures.on_way[block.axis + axes] = k
                    whole += met * share
                    axes += 1
            left = float(whole)
            l_i = block.gram + count * n
            for p in range(count):
                y_p = block.met + closures.kept[block.row + p] * columns
                l_p = block.gram + p * n
                x = float(0.0)
                for k in range(axes):
                    met = closures.met[y_p + closures.on_way[block.axis + k]]
                    x += met * closures.share[block.axis + k]
                for q in range(p):
                    x -= closures.gram[l_i + q] * closures.gram[l_p + q]
                x *= closures.gram[l_p + p]
                closures.gram[l_i + p] = x
                left -= x * x
            if left > wp.max(IMPLIED * whole, closures.least[block.row + i]):
                closures.gram[l_i + count] = 1.0 / wp.sqrt(left)
                closures.kept[block.row + count] = i
                count += 1
            else:
                closures.multiplier[block.row + i] = 0.0
        for p in range(count):
            i = block.row + closures.kept[block.row + p]
            l_p = block.gram + p * n
            x = closures.multiplier[i]
            for q in range(p):
                j = block.row + closures.kept[block.row + q]
                x -= closures.gram[l_p + q] * closures.multiplier[j]
            closures.multiplier[i] = x * closures.gram[l_p + p]
        for m in range(count):
            p = count - 1 - m
            i = block.row + closures.kept[block.row + p]
            x = closures.multiplier[i]
            for q in range(p + 1, count):
                j = block.row + closures.kept[block.row + q]
                x -= closures.gram[block.gram + q * n + p] * closures.multiplier[j]
            closures.multiplier[i] = x * closures.gram[block.gram + p * n + p]

    @wp.func
    def close_tree(
        first: int,
        end: int,
        recovery: float,
        h: float,
        model: BodyModel,
        joints: JointModel,
        worlds: WorldWork,
        work: BodyWork,
        tree: TreeWork,
        loops: LoopWork,
        history: History,
    ):
        """Between elimination and substitution: what the rows push the axes of a block by."""
        closures = tree.closures
        number = closures.block_of[first]
        if number < 0:
            return
        block = closures.blocks[number]
        columns = int(0)
        for i in range(first, end):
            body = worlds.bodies[i]
            closures.column[body] = columns
            if is_linked(joints, tree, body):
                for k in range(axis_count(body, joints, tree)):
                    axis = tree.axis_start[body] + k
                    closures.inverse[block.axis + columns] = tree.axes[axis].inv_pivot
                    columns += 1
            elif work.inv_mass[body] > 0.0:
                for _ in range(6):
                    closures.inverse[block.axis + columns] = 1.0
                    columns += 1
        for k in range(block.rows * columns):
            closures.met[block.met + k] = 0.0
        for row in range(block.row, block.row + block.rows):
            closures.multiplier[row] = 0.0
        for c in range(block.first, block.end):
            closure = closures.closures[c]
            if closure.loop >= 0:
                if wp.static(effects.loops):
                    loop_rows(
                        block,
                        columns,
                        closure,
                        recovery,
                        h,
                        model,
                        joints,
                        worlds,
                        work,
                        tree,
                        loops,
                    )
            elif wp.static(effects.mimics):
                mimic_rows(block, columns, closure, recovery, joints, worlds, work, tree)
        solve_rows(block, columns, closures)
        for i in range(first, end):
            body = worlds.bodies[i]
            column = block.met + closures.column[body]
            if is_linked(joints, tree, body):
                for k in range(axis_count(body, joints, tree)):
                    axis = tree.axis_start[body] + k
                    push = row_push(column + k, block, columns, closures)
                    tree.axes[axis].push = tree.axes[axis].push - push
            elif work.inv_mass[body] > 0.0:
                pushed = tree.update[body]
                for k in range(6):
                    pushed[k] -= row_push(column + k, block, columns, closures)
                tree.update[body] = pushed
        if wp.static(effects.loops):
            for c in range(block.first, block.end):
                closure = closures.closures[c]
                if closure.loop >= 0:
                    linear = 3 - linear_count(joints, loops.joints[closure.loop])
                    force = wp.vec3(0.0)
                    torque = wp.vec3(0.0)
                    for k in range(closure.rows):
                        row = closure.row + k
                        along = closures.multiplier[row] * closures.direction[row]
                        if k < linear:
                            force += along
                        else:
                            torque += along
                    i = closure.loop
                    history.loop_force[i] = history.loop_force[i] - force
                    history.loop_torque[i] = history.loop_torque[i] - torque

    return ClosureFunctions(begin_closures, close_tree)
