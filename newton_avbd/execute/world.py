# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The step of one world in one kernel, one thread a world: read ``solve`` top to bottom."""

import functools

import warp as wp

from ..algebra.block import factor_block, solve_block
from ..data import (
    BodyModel,
    BodyWork,
    ContactInput,
    ContactRow,
    ControlInput,
    History,
    IslandWork,
    JointModel,
    LoopWork,
    RowWork,
    ShapeModel,
    TreeWork,
    WorldScale,
    WorldWork,
)
from ..effects import Effects
from ..rows import contact as contact_rows
from ..rows import ramp as ramp_rows
from ..rows import spin as spin_rows
from .bdf2 import make_bdf2
from .beginning import is_tree, make_begin, make_coasting
from .bodies import has_rows, make_predict_body, moved_by, report_held, vector_sum
from .breaking import make_break_joints
from .closures import make_closures
from .contacts import make_rows, make_sort_by_owner
from .denormals import flush_denormals, restore_denormals
from .ending import make_end
from .impacts import free_share, make_impacts
from .islands import join_islands, keep_momentum, keep_spin
from .launch import KERNEL, uncollected
from .loops import has_loops, make_loops, parent_slot
from .piles import in_pile, is_link, lasting_share, make_piles, stiffen_rows
from .trees import is_linked, make_trees, place_body
from .weights import make_weigh

SLOP_SHARE = wp.constant(0.05)
"""Penetration that is left alone, as a share of g h^2: touching contacts go on touching."""
SETTLED = wp.constant(5.0e-6)
"""Update from which a sweep is the last one, as a share of g h^2: a world at rest sweeps once."""
ROUNDED = wp.constant(1.0e-7)
"""Likewise without gravity, as a share of the farthest move: what float32 rounds of it."""
JOINT_PASSES = wp.constant(8)
"""Most sweeps that close open joints. In a tree one leaves the square of how far they were open."""
LOOP_PASSES = wp.constant(24)
"""Likewise where joints close loops: a four-bar that lands is not closed by fewer."""
COLD_STEPS = wp.constant(3)
"""Steps after a reset that sweep more, because the multipliers start from nothing."""
COLD_FACTOR = wp.constant(4)
"""How many times more those steps sweep: a stack of 20 boxes then starts without a wave. So do
those in which impacts go through piles."""
LONGER = wp.constant(1.5)
"""A step this many times as long as the last one is as the first after a reset."""


@wp.func
def is_same_block(worlds: wp.ref[WorldWork], a: int, b: int) -> bool:
    """Whether two bodies move at once."""
    return worlds.block_end[worlds.rank[a]] == worlds.block_end[worlds.rank[b]]


def make_is_world_finite(effects: Effects) -> wp.Function:
    """Device function: whether all bodies and joints of the world came with finite input."""

    @wp.func
    def joint_sum(joint: int, joints: wp.ref[JointModel], control: wp.ref[ControlInput]) -> wp.vec3:
        """Sums of the numbers that make a joint and drive it: finite when they are."""
        parent = joints.parent_frame[joint]
        child = joints.child_frame[joint]
        turn = wp.transform_get_rotation(parent) + wp.transform_get_rotation(child)
        frames = wp.transform_get_translation(parent) + wp.transform_get_translation(child)
        frames += wp.vec3(turn[0] + turn[3], turn[1], turn[2])
        total = float(0.0)
        for dof in range(joints.dof_start[joint], joints.dof_start[joint + 1]):
            frames += joints.axis[dof]
            if wp.static(effects.joint_force):
                total += control.joint_f[dof]
            if wp.static(effects.drives):
                total += joints.target_ke[dof] + joints.target_kd[dof] + control.target_qd[dof]
            if wp.static(effects.springs):
                total += joints.stiffness[dof] + joints.damping[dof]
            if wp.static(effects.armature):
                total += joints.armature[dof]
            if wp.static(effects.joint_friction):
                total += joints.friction[dof]
        if wp.static(effects.drives):
            for i in range(joints.coord_start[joint], joints.coord_start[joint + 1]):
                total += control.target_q[i]
        if wp.static(effects.mimics):
            total += joints.mimic_coefficients[joint][0] + joints.mimic_coefficients[joint][1]
        return frames + wp.vec3(total, 0.0, 0.0)

    @wp.func
    def is_world_finite(
        world: int,
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
    ) -> bool:
        total = wp.vec3(0.0)
        for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
            body = worlds.bodies[i]
            if work.finite[body] == 0:
                return False
            if wp.static(effects.joints):
                if tree.joint[body] >= 0:
                    total += joint_sum(tree.joint[body], joints, control)
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                total += joint_sum(loops.joints[i], joints, control)
        return wp.isfinite(total)

    return is_world_finite


@wp.func
def is_solution_finite(world: int, worlds: wp.ref[WorldWork], work: wp.ref[BodyWork]) -> bool:
    """Whether the sweeps ended in finite increments."""
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        if not wp.isfinite(vector_sum(work.increment[worlds.bodies[i]])):
            return False
    return True


@wp.func
def hold_world(
    world: int,
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    worlds: wp.ref[WorldWork],
    rows: wp.ref[RowWork],
    history: wp.ref[History],
    body_q_out: wp.array[wp.transform],
    body_qd_out: wp.array[wp.spatial_vector],
):
    """Passes a world through unchanged, counts it, and forgets its contacts."""
    report_held(worlds, worlds.of_body[worlds.bodies[worlds.body_start[world]]])
    for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
        body = worlds.bodies[i]
        body_q_out[body] = body_q[body]
        body_qd_out[body] = body_qd[body]
        rows.owned_end[body] = rows.owned_start[body]
        history.falling[body] = 0.0
        for side in range(2):
            history.start[side, body] = 0
            history.end[side, body] = 0
    history.age[world] = 0
    history.filling[world, 0] = 0
    # all worlds stay on the same side: their records lie in one array
    history.parity[world] = 1 - history.parity[world]


@wp.func
def settled_update(scale: WorldScale) -> float:
    """Update [m] from which a sweep is the last one."""
    if scale.gravity == 0.0:
        return 0.5 * ROUNDED * scale.reach
    return SETTLED * scale.gravity * scale.h * scale.h


@wp.func
def unsettled_update(scale: WorldScale) -> float:
    """Update [m] of a last sweep beyond which joints are closed again."""
    return wp.max(scale.slop, settled_update(scale))


@wp.func
def is_struck(update: float, scale: WorldScale) -> bool:
    """Whether the square of a sweep's update [m^2] is that of a world in which impacts go on."""
    expected = contact_rows.STRUCK * scale.gravity * scale.h * scale.h
    struck = wp.max(expected, settled_update(scale))
    return update > struck * struck


def make_count_passes(effects: Effects) -> wp.Function:
    """Device function: how many sweeps the recovery of a world takes at most."""

    @wp.func
    def count_passes(
        sweeps: int, update: float, deepest: float, is_open: bool, scale: WorldScale
    ) -> int:
        """Takes the sweeps of the motion, the square of their last update [m^2], the deepest
        penetration [m], and whether joints were open at the start of the step."""
        passes = int(0)
        if wp.static(not effects.compliance):
            if sweeps > 0 and deepest > scale.slop:
                passes = 1
        if wp.static(effects.joints):
            # joints close even where impacts keep the sweeps from settling
            unsettled = unsettled_update(scale)
            is_unsettled = update > unsettled * unsettled
            if is_unsettled:
                # what that leaves open in trees is put together after it
                passes = 1
            if is_open or (is_unsettled and wp.static(effects.loops)):
                passes = wp.static(LOOP_PASSES if effects.closures else JOINT_PASSES)
        return passes

    return count_passes


def make_measure_world(effects: Effects) -> wp.Function:
    """Device function: how far things may go in this step, and how much could rest on a contact."""

    @wp.func
    def measure_world(
        world: int,
        h: float,
        model: wp.ref[BodyModel],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
    ) -> WorldScale:
        scale = WorldScale()
        scale.h = h
        scale.step = h
        scale.blend = 1.0
        scale.lag = 0.5
        scale.static_slot = work.inv_mass.shape[0] - 1
        farthest = float(0.0)
        if wp.static(effects.sleeping):
            farthest = worlds.pace[world]
        for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
            body = worlds.bodies[i]
            gravity = float(0.0)
            if work.inv_mass[body] > 0.0:
                gravity = wp.length_sq(model.gravity[model.world[body]])
                scale.gravity = wp.max(scale.gravity, gravity)
            if wp.static(effects.contact) or gravity == 0.0:
                target = work.target[body]
                move = wp.length(wp.spatial_top(target))
                if work.inv_mass[body] > 0.0:
                    mass = model.mass[body]
                    scale.mass += mass
                    # radius of a solid body from its gyration, generously
                    radius = 2.0 * wp.sqrt(wp.trace(work.inertia[body]) / mass)
                    move += radius * wp.length(wp.spatial_bottom(target))
                farthest = wp.max(farthest, move)
        scale.gravity = wp.sqrt(scale.gravity)
        # an impact can at most double the speed of the faster body
        scale.reach = 2.0 * farthest
        scale.slop = SLOP_SHARE * scale.gravity * h * h
        return scale

    return measure_world


def make_gather(
    effects: Effects,
    contact_force: wp.Function,
    gap_of: wp.Function,
    loop_wrench: wp.Function,
) -> wp.Function:
    """Device function that sums what pulls a body: to its inertial target, and at its contacts.

    With ``has_dual`` the rows that the body owns start with the dual update lambda <- F that ends
    the sweep before: nothing has moved at them since. ``recovery`` is the share of the penetration
    beyond ``slop`` that is to go.
    """

    @wp.func(inline=effects.inline)
    def gather(
        body: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> wp.spatial_vector:
        increment = work.increment[body]
        away = work.target[body] - increment
        inv_h2 = 1.0 / (h * h)
        f = (model.mass[body] * inv_h2) * wp.spatial_top(away)
        tau = inv_h2 * (work.inertia[body] * wp.spatial_bottom(away))
        if wp.static(effects.tilting):
            # what tilts a spin has to turn its momentum
            tau += wp.cross(wp.spatial_bottom(away), work.spin_momentum[body]) / h
        if wp.static(effects.contact):
            # rows of the same two bodies follow each other and share their relative motion
            partner = int(-1)
            span = wp.vec3(0.0)
            shift = wp.vec3(0.0)
            turn = wp.vec3(0.0)
            for i in range(rows.owned_start[body], rows.owned_end[body]):
                row = rows.rows[i]
                if row.b != partner:
                    partner = row.b
                    span = work.com[body] - work.com[partner]
                    shift, turn = contact_rows.relative_motion(
                        increment, work.increment[partner], span
                    )
                u = shift + wp.cross(turn, row.arm)
                if wp.static(effects.drift):
                    u += rows.drift[i]
                gap = gap_of(row.gap, recovery, slop)
                push = contact_force(row, u, gap)
                if has_dual:
                    if wp.static(effects.compliance):
                        push = contact_rows.keep_share(row, push, rows.share[i])
                    row.force = push
                    rows.rows[i].force = push
                    push = contact_force(row, u, gap)
                f -= push
                tau -= wp.cross(row.arm, push)
                if wp.static(effects.angular_friction):
                    spin = rows.spin[i]
                    rolled = turn
                    if wp.static(effects.bdf2):
                        rolled -= wp.spatial_bottom(work.lead[partner] - work.lead[body])
                    if wp.static(effects.put_bodies):
                        rolled += wp.spatial_bottom(work.put[partner])
                    if has_dual:
                        held = wp.dot(row.normal, row.force)
                        spin.torque = spin_rows.torque(spin, row.normal, rolled, held)
                        rows.spin[i].torque = spin.torque
                    f_n = wp.dot(row.normal, push)
                    tau -= spin_rows.torque(spin, row.normal, rolled, f_n)
        if wp.static(effects.pairs):
            partner = int(-1)
            for i in range(rows.other_start[body], rows.other_end[body]):
                other = rows.other_rows[i]
                row = rows.rows[other]
                if row.a != partner:
                    partner = row.a
                    span = work.com[partner] - work.com[body]
                    shift, turn = contact_rows.relative_motion(
                        work.increment[partner], increment, span
                    )
                u = shift + wp.cross(turn, row.arm)
                if wp.static(effects.drift):
                    u += rows.drift[other]
                push = contact_force(row, u, gap_of(row.gap, recovery, slop))
                f += push
                tau += wp.cross(row.arm + span, push)
                if wp.static(effects.angular_friction):
                    f_n = wp.dot(row.normal, push)
                    rolled = turn
                    if wp.static(effects.bdf2):
                        rolled -= wp.spatial_bottom(work.lead[body] - work.lead[partner])
                    tau += spin_rows.torque(rows.spin[other], row.normal, rolled, f_n)
        if wp.static(effects.loops):
            for k in range(loops.body_start[body], loops.body_start[body + 1]):
                item = loops.items[k]
                force, torque, arm_c, arm_p = loop_wrench(
                    item / 2,
                    recovery,
                    h,
                    model,
                    joints,
                    control,
                    work,
                    tree,
                    loops,
                    history,
                    False,
                )
                if item % 2 == 0:
                    f += force
                    tau += torque + wp.cross(arm_c, force)
                else:
                    f -= force
                    tau -= torque + wp.cross(arm_p, force)
        return wp.spatial_vector(f, tau)

    return gather


def make_sweep(effects: Effects, gather: wp.Function) -> wp.Function:
    """Device function that moves one body to the minimum of its quadratic model (block descent)."""

    @wp.func
    def sweep(
        body: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> float:
        """Returns the square of how far that moved it [m^2], a turn by its radius of gyration."""
        wrench = gather(
            body,
            has_dual,
            recovery,
            slop,
            h,
            model,
            joints,
            control,
            work,
            rows,
            tree,
            loops,
            history,
        )
        update = solve_block(work.factor[body], wp.spatial_top(wrench), wp.spatial_bottom(wrench))
        work.increment[body] = work.increment[body] + update
        if wp.static(effects.loops):
            place_body(body, work, tree)
        return moved_by(body, update, work)

    return sweep


def make_sweep_block(
    effects: Effects, sweep_body: wp.Function, sweep_tree: wp.Function
) -> wp.Function:
    """Device function that moves one block: a tree, or a body that something holds."""

    @wp.func
    def sweep_block(
        first: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        body_q: wp.array[wp.transform],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> float:
        """Returns the square of how far one of its bodies moved [m^2]."""
        body = worlds.bodies[first]
        if wp.static(effects.joints):
            end = worlds.block_end[first]
            if is_tree(first, end, body, tree):
                return sweep_tree(
                    first,
                    end,
                    has_dual,
                    recovery,
                    slop,
                    h,
                    body_q,
                    model,
                    joints,
                    control,
                    worlds,
                    work,
                    rows,
                    tree,
                    loops,
                    history,
                )
        is_held = bool(False)
        if wp.static(effects.contact):
            is_held = has_rows(rows, body)
        if wp.static(effects.loops):
            is_held = is_held or has_loops(loops, body)
        if wp.static(effects.piles):
            is_held = is_held and not in_pile(rows, body)
        if work.inv_mass[body] > 0.0 and is_held:
            return sweep_body(
                body,
                has_dual,
                recovery,
                slop,
                h,
                model,
                joints,
                control,
                work,
                rows,
                tree,
                loops,
                history,
            )
        return 0.0

    return sweep_block


def make_assemble(effects: Effects, loop_curvature: wp.Function) -> wp.Function:
    """Device function: the block of a body, by its inertia and the curvature of its rows."""

    @wp.func
    def share_of(row: ContactRow, worlds: wp.ref[WorldWork], rows: wp.ref[RowWork]) -> float:
        """What the block of one of its bodies sees of a row's curvature.

        The link of a pile is solved for itself. Where both bodies move at once all the same, twice
        the curvature on each is an upper bound of what couples them: (u_b - u_a)^2 <= 2 u_a^2 +
        2 u_b^2.
        """
        if wp.static(effects.piles):
            if is_link(row, rows):
                return 0.0
            if in_pile(rows, row.a) and in_pile(rows, row.b):
                return 2.0
        if wp.static(effects.joints):
            if is_same_block(worlds, row.a, row.b):
                return 2.0
        return 1.0

    @wp.func(inline=effects.inline)
    def assemble_body(
        body: int,
        h: float,
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ):
        """A body's block: its inertia and the curvature of its rows, the same all step long."""
        inv_h2 = 1.0 / (h * h)
        h_ll = wp.diag(wp.vec3(model.mass[body] * inv_h2))
        h_al = wp.mat33(0.0)
        h_aa = work.inertia[body] * inv_h2
        if wp.static(effects.contact):
            for i in range(rows.owned_start[body], rows.owned_end[body]):
                row = rows.rows[i]
                share = share_of(row, worlds, rows)
                if share == 0.0:
                    continue
                row.k_n *= share
                row.k_t *= share
                h_ll, h_al, h_aa = contact_rows.curvature(row, row.arm, h_ll, h_al, h_aa)
                if wp.static(effects.angular_friction):
                    h_aa += share * spin_rows.curvature(rows.spin[i], row.normal)
        if wp.static(effects.pairs):
            for i in range(rows.other_start[body], rows.other_end[body]):
                row = rows.rows[rows.other_rows[i]]
                share = share_of(row, worlds, rows)
                if share == 0.0:
                    continue
                arm = row.arm + (work.com[row.a] - work.com[body])
                row.k_n *= share
                row.k_t *= share
                h_ll, h_al, h_aa = contact_rows.curvature(row, arm, h_ll, h_al, h_aa)
                if wp.static(effects.angular_friction):
                    spin = rows.spin[rows.other_rows[i]]
                    h_aa += share * spin_rows.curvature(spin, row.normal)
        if wp.static(effects.loops):
            for k in range(loops.body_start[body], loops.body_start[body + 1]):
                item = loops.items[k]
                joint = loops.joints[item / 2]
                parent = parent_slot(joints, joint, work.inv_mass.shape[0] - 1)
                ll, al, aa = loop_curvature(
                    item,
                    is_same_block(worlds, joints.child[joint], parent),
                    h,
                    model,
                    joints,
                    control,
                    work,
                    tree,
                    loops,
                    history,
                )
                h_ll += ll
                h_al += al
                h_aa += aa
        return h_ll, h_al, h_aa

    return assemble_body


def make_remember(
    effects: Effects, contact_force: wp.Function, gap_of: wp.Function, join: wp.Function
) -> wp.Function:
    """Device function that keeps what a body's rows push with for the next step.

    ``join`` notes that two bodies push each other.
    """
    coasting_increment = make_coasting(effects)

    @wp.func
    def remember_rows(
        body: int,
        side: int,
        scale: WorldScale,
        body_qd: wp.array[wp.spatial_vector],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        islands: wp.ref[IslandWork],
        history: wp.ref[History],
    ):
        """The last dual update of the rows that a body owns, kept for the next step."""
        h = scale.step
        history.start[side, body] = rows.owned_start[body]
        history.end[side, body] = rows.owned_end[body]
        joined = int(-1)
        for i in range(rows.owned_start[body], rows.owned_end[body]):
            row = rows.rows[i]
            span = work.com[body] - work.com[row.b]
            u = contact_rows.slip(row, work.increment[body], work.increment[row.b], span)
            if wp.static(effects.drift):
                u += rows.drift[i]
            if wp.static(effects.ramp):
                push, _k = ramp_rows.force_and_stiffness(row, u, rows.damping[i], h)
                history.records[side, i].penalty = row.k_n
                rows.rows[i].force = push
            else:
                push = contact_force(row, u, gap_of(row.gap, 0.0, 0.0))
                rows.rows[i].force = push
                if wp.static(effects.angular_friction):
                    f_n = wp.dot(row.normal, push)
                    turn = wp.spatial_bottom(work.increment[row.b] - work.increment[body])
                    if wp.static(effects.bdf2):
                        turn -= wp.spatial_bottom(work.lead[row.b] - work.lead[body])
                    if wp.static(effects.put_bodies):
                        turn += wp.spatial_bottom(work.put[row.b])
                    torque = spin_rows.torque(rows.spin[i], row.normal, turn, f_n)
                    rows.spin[i].torque = torque
                if wp.static(effects.pairs):
                    # a row that has let go by now may have pushed one of them in the last sweep
                    is_joining = wp.length_sq(push) > 0.0
                    is_joining = is_joining or (row.k_n > 0.0 and work.inv_mass[row.b] > 0.0)
                    if row.b != joined and is_joining:
                        joined = row.b
                        join(islands, worlds, work, body, joined)
                if wp.static(not effects.compliance):
                    coasting = contact_rows.slip(
                        row,
                        coasting_increment(work, body_qd, row.a, h),
                        coasting_increment(work, body_qd, row.b, h),
                        span,
                    )
                    change = wp.dot(row.normal, u - coasting)
                    if change > scale.slop:
                        mass = contact_rows.effective_mass(
                            row.normal,
                            row.arm,
                            row.arm + span,
                            work.inv_mass[row.a] + work.inv_mass[row.b],
                            work.inv_inertia[row.a],
                            work.inv_inertia[row.b],
                        )
                        push = contact_rows.lasting_force(row.normal, push, mass, change, h)
                    if wp.static(effects.piles):
                        f_n = wp.dot(row.normal, rows.rows[i].force)
                        most = f_n * lasting_share(row, work, rows)
                        kept = wp.dot(row.normal, push)
                        if kept > most:
                            push *= most / kept
                if wp.static(effects.restitution):
                    if rows.impacts[i].total > 0.0:
                        push = wp.vec3(0.0)
                if wp.static(effects.angular_friction):
                    lasting = wp.dot(row.normal, push) / wp.max(f_n, 1.0e-30)
                    history.torque[side, i] = lasting * rows.spin[i].torque
                history.records[side, i].force = push

    return remember_rows


@functools.cache
def make_solve_worlds(effects: Effects) -> wp.Function:
    """Device function: the whole step of the world of a thread, after prediction."""
    measure_world = make_measure_world(effects)
    is_world_finite = make_is_world_finite(effects)
    find_rows, penalise_rows = make_rows(effects)
    weigh_blocks = make_weigh(effects)
    impacts = make_impacts(effects)
    bdf2 = make_bdf2(effects)
    begin_bdf2, remember_motion = bdf2.begin_step, bdf2.remember_motion
    remember_loops, remember_state = bdf2.remember_loops, bdf2.remember_state
    find_impacts = impacts.find_impacts
    find_wait = impacts.find_wait
    release_impacts = impacts.release_impacts
    restore_impacts = impacts.restore_impacts
    loop_functions = make_loops(effects)
    loop_wrench = loop_functions.loop_wrench
    loop_curvature = loop_functions.loop_curvature
    contact_force = contact_rows.force if effects.friction else contact_rows.normal_force
    sweep_gap = contact_rows.whole_gap if effects.compliance else contact_rows.rigid_gap

    assemble_body = make_assemble(effects, loop_curvature)
    remember_rows = make_remember(effects, contact_force, sweep_gap, join_islands)
    gather = make_gather(effects, contact_force, sweep_gap, loop_wrench)
    sweep_body = make_sweep(effects, gather)
    piles = make_piles(effects, gather, make_coasting(effects))
    link_piles = piles.link_piles
    factor_piles = piles.factor_piles
    sweep_piles = piles.sweep_piles
    spend_impacts = piles.spend_impacts
    break_joints = make_break_joints(effects, gather)
    closures = make_closures(effects)
    trees = make_trees(effects, gather, closures.begin_rows, closures.keep_forces)
    sweep_block = make_sweep_block(effects, sweep_body, trees.sweep_tree)
    put_together = trees.put_together
    begin = make_begin(effects, trees, loop_functions, closures.begin_closures, assemble_body)
    measure_blocks = begin.measure_blocks
    measure_loop = begin.measure_loop
    place_blocks = begin.place_blocks
    begin_body = begin.begin_body
    end_velocity, end_armature, end_pose = make_end(effects)
    count_passes = make_count_passes(effects)

    @wp.func
    def sweep_body_ramped(
        body: int, h: float, model: wp.ref[BodyModel], work: wp.ref[BodyWork], rows: wp.ref[RowWork]
    ):
        """The seed document's body update: assemble at the current pose, factor, solve."""
        increment = work.increment[body]
        away = work.target[body] - increment
        inv_h2 = 1.0 / (h * h)
        f = (model.mass[body] * inv_h2) * wp.spatial_top(away)
        tau = inv_h2 * (work.inertia[body] * wp.spatial_bottom(away))
        h_ll = wp.diag(wp.vec3(model.mass[body] * inv_h2))
        h_al = wp.mat33(0.0)
        h_aa = work.inertia[body] * inv_h2
        for i in range(rows.owned_start[body], rows.owned_end[body]):
            row = rows.rows[i]
            span = work.com[body] - work.com[row.b]
            u = contact_rows.slip(row, increment, work.increment[row.b], span)
            if wp.static(effects.drift):
                u += rows.drift[i]
            push, k = ramp_rows.force_and_stiffness(row, u, rows.damping[i], h)
            f -= push
            tau -= wp.cross(row.arm, push)
            h_ll, h_al, h_aa = ramp_rows.add_stiffness(k, row.arm, h_ll, h_al, h_aa)
        if wp.static(effects.pairs):
            for j in range(rows.other_start[body], rows.other_end[body]):
                i = rows.other_rows[j]
                row = rows.rows[i]
                span = work.com[row.a] - work.com[body]
                u = contact_rows.slip(row, work.increment[row.a], increment, span)
                if wp.static(effects.drift):
                    u += rows.drift[i]
                push, k = ramp_rows.force_and_stiffness(row, u, rows.damping[i], h)
                f += push
                tau += wp.cross(row.arm + span, push)
                h_ll, h_al, h_aa = ramp_rows.add_stiffness(k, row.arm + span, h_ll, h_al, h_aa)
        work.increment[body] = increment + solve_block(factor_block(h_ll, h_al, h_aa), f, tau)

    @wp.func
    def sweep_duals_ramped(body: int, work: wp.ref[BodyWork], rows: wp.ref[RowWork]):
        """The seed document's dual update: the penalties of the rows that a body owns grow."""
        for i in range(rows.owned_start[body], rows.owned_end[body]):
            row = rows.rows[i]
            span = work.com[body] - work.com[row.b]
            u = contact_rows.slip(row, work.increment[body], work.increment[row.b], span)
            rows.rows[i].k_n = ramp_rows.grown_penalty(
                row.k_n, ramp_rows.penetration(row, u), rows.stiffness[i]
            )

    @wp.func(inline=effects.inline)
    def sweep_world(
        world: int,
        has_dual: bool,
        recovery: float,
        slop: float,
        h: float,
        body_q: wp.array[wp.transform],
        model: wp.ref[BodyModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        history: wp.ref[History],
    ) -> float:
        """Visits all blocks; returns the square of how far one of their bodies moved [m^2].

        With a ``recovery`` above zero what was wrong at the start of the step goes, too: that share
        of the penetration beyond ``slop``, and all misfit of joints.
        """
        farthest = float(0.0)
        first = int(worlds.body_start[world])
        while first < worlds.body_start[world + 1]:
            if wp.static(effects.ramp):
                body = worlds.bodies[first]
                if work.inv_mass[body] > 0.0 and has_rows(rows, body):
                    sweep_body_ramped(body, h, model, work, rows)
            else:
                farthest = wp.max(
                    farthest,
                    sweep_block(
                        first,
                        has_dual,
                        recovery,
                        slop,
                        h,
                        body_q,
                        model,
                        joints,
                        control,
                        worlds,
                        work,
                        rows,
                        tree,
                        loops,
                        history,
                    ),
                )
            first = worlds.block_end[first]
        if wp.static(effects.piles):
            farthest = wp.max(
                farthest,
                sweep_piles(
                    world,
                    has_dual,
                    recovery,
                    slop,
                    h,
                    model,
                    joints,
                    control,
                    worlds,
                    work,
                    rows,
                    tree,
                    loops,
                    history,
                ),
            )
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                loop_wrench(
                    i, recovery, h, model, joints, control, work, tree, loops, history, True
                )
        if wp.static(effects.ramp):
            for i in range(worlds.body_start[world], worlds.body_start[world + 1]):
                sweep_duals_ramped(worlds.bodies[i], work, rows)
        return farthest

    @wp.func
    def solve_world(
        world: int,
        # Model:
        model: wp.ref[BodyModel],
        shapes: wp.ref[ShapeModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        contacts: wp.ref[ContactInput],
        h: float,
        iterations: int,
        tolerance: float,
        # Work:
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        islands: wp.ref[IslandWork],
        history: wp.ref[History],
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        body_start = worlds.body_start[world]
        body_end = worlds.body_start[world + 1]
        if not is_world_finite(world, joints, control, worlds, work, tree, loops):
            hold_world(world, body_q, body_qd, worlds, rows, history, body_q_out, body_qd_out)
            return

        # Rows: linearised at state_in, warm-started from the last step.
        scale = measure_world(world, h, model, worlds, work)
        # forces that stopped something within a short step would push too long in a longer one
        if h > LONGER * history.step[world]:
            history.age[world] = 0
        if wp.static(effects.bdf2):
            if worlds.step[world] < history.step[world]:
                scale.lag = 0.0
        history.step[world] = h
        deepest = float(0.0)
        has_impacts = bool(False)
        if wp.static(effects.contact):
            contact_count = int(0)
            for i in range(body_start, body_end):
                body = worlds.bodies[i]
                contact_count += rows.owned_end[body] - rows.owned_start[body]
            if contact_count > 0:
                for i in range(body_start, body_end):
                    body = worlds.bodies[i]
                    find_rows(
                        world,
                        body,
                        scale,
                        body_q,
                        model,
                        shapes,
                        contacts,
                        worlds,
                        work,
                        rows,
                        history,
                    )
            if wp.static(effects.piles):
                link_piles(world, scale.slop, model, worlds, work, rows, tree)
            if contact_count > 0:
                if wp.static(effects.light_links):
                    weigh_blocks(
                        body_start, body_end, body_q, model, joints, worlds, work, rows, tree
                    )
                for i in range(body_start, body_end):
                    body = worlds.bodies[i]
                    depth = penalise_rows(
                        world, body, scale, shapes, contacts, work, rows, tree, history
                    )
                    deepest = wp.max(deepest, depth)
            if wp.static(effects.restitution):
                if contact_count > 0:
                    has_impacts = find_impacts(
                        world,
                        1 - history.parity[world],
                        scale,
                        body_qd,
                        shapes,
                        worlds,
                        work,
                        rows,
                        tree,
                        loops,
                        history,
                    )
            history.filling[world, 0] = 0
            if wp.static(effects.matching):
                history.filling[world, 0] = contacts.buffer
                history.filling[world, 1] = contacts.generation[0]
        if wp.static(effects.bdf2):
            scale = begin_bdf2(
                world,
                has_impacts,
                scale,
                body_q,
                body_qd,
                model,
                joints,
                worlds,
                work,
                rows,
                tree,
                loops,
                history,
            )
        step = scale.step
        is_open = bool(False)
        if wp.static(effects.joints):
            is_open = measure_blocks(
                body_start,
                body_end,
                scale,
                body_q,
                body_qd,
                model,
                joints,
                worlds,
                work,
                rows,
                tree,
                loops,
                history,
            )
            if wp.static(effects.loops):
                for i in range(loops.world_start[world], loops.world_start[world + 1]):
                    if measure_loop(
                        i, scale, body_q, body_qd, model, joints, work, tree, loops, history
                    ):
                        is_open = True
            if place_blocks(
                body_start, body_end, scale.static_slot, body_q, model, joints, worlds, work, tree
            ):
                is_open = True

        # Sweeps: a body that nothing touches is at its target at once.
        sweeps = int(0)
        for i in range(body_start, body_end):
            body = worlds.bodies[i]
            if work.inv_mass[body] > 0.0:
                if begin_body(
                    i,
                    step,
                    model,
                    joints,
                    control,
                    worlds,
                    work,
                    rows,
                    tree,
                    loops,
                    islands,
                    history,
                ):
                    sweeps = iterations
                if wp.static(effects.joints and effects.pairs):
                    if tree.joint[body] >= 0:
                        join_islands(islands, worlds, work, body, tree.parent[body])
        if wp.static(effects.piles):
            factor_piles(world, worlds, work, rows)
        if wp.static(not effects.ramp):
            if history.age[world] < COLD_STEPS:
                sweeps = COLD_FACTOR * sweeps
        settled = settled_update(scale)
        enough = wp.max(tolerance, settled)
        update = float(0.0)
        recovery = float(0.0)
        sweep = int(0)
        has_islands = bool(False)
        rounds = int(wp.static(1 if effects.ramp else 2))
        # Two rounds of sweeps, the motion and the recovery, by one call: it is most of the code.
        for _round in range(rounds):
            while sweep < sweeps:
                update = sweep_world(
                    world,
                    sweep > 0 and recovery == 0.0,
                    recovery,
                    scale.slop,
                    step,
                    body_q,
                    model,
                    joints,
                    control,
                    worlds,
                    work,
                    rows,
                    tree,
                    loops,
                    history,
                )
                sweep += 1
                if wp.static(not effects.ramp):
                    if update <= enough * enough:
                        sweeps = sweep
                if wp.static(effects.piles):
                    if sweep == iterations and recovery == 0.0 and is_struck(update, scale):
                        if rows.piles.end[world] > body_start:
                            # impacts through piles: levels knew too little of what they stop
                            sweeps = COLD_FACTOR * iterations
                            for i in range(body_start, rows.piles.end[world]):
                                stiffen_rows(rows.piles.order[i], scale, rows)
                            for i in range(body_start, body_end):
                                if in_pile(rows, worlds.bodies[i]):
                                    begin_body(
                                        i,
                                        step,
                                        model,
                                        joints,
                                        control,
                                        worlds,
                                        work,
                                        rows,
                                        tree,
                                        loops,
                                        islands,
                                        history,
                                    )
                            factor_piles(world, worlds, work, rows)
            if recovery > 0.0:
                break
            if wp.static(effects.bdf2):
                if update > enough * enough:
                    # what does not settle tells nothing of the next step
                    history.smooth[world] = 0
                remember_loops(world, scale, joints, loops, history)
            worlds.sweeps[world] = sweeps
            worlds.update[world] = wp.sqrt(update)
            worlds.settled[world] = settled
            side = 1 - history.parity[world]
            if wp.static(effects.contact):
                if wp.static(effects.piles):
                    spend_impacts(world, scale, body_qd, model, worlds, work, rows)
                for i in range(body_start, body_end):
                    remember_rows(
                        worlds.bodies[i], side, scale, body_qd, worlds, work, rows, islands, history
                    )
                if wp.static(effects.loops):
                    for i in range(loops.world_start[world], loops.world_start[world + 1]):
                        joint = loops.joints[i]
                        parent = parent_slot(joints, joint, scale.static_slot)
                        join_islands(islands, worlds, work, joints.child[joint], parent)
                if wp.static(effects.pairs and not effects.ramp):
                    if sweeps > 0:
                        has_islands = keep_momentum(world, model, worlds, work, islands)
            if not is_solution_finite(world, worlds, work):
                hold_world(world, body_q, body_qd, worlds, rows, history, body_q_out, body_qd_out)
                return
            if wp.static(effects.breaking):
                break_joints(
                    world, step, model, joints, control, worlds, work, rows, tree, loops, history
                )
            history.parity[world] = side
            history.age[world] = wp.min(history.age[world] + 1, COLD_STEPS)

            # Velocity, from the increments themselves.
            for i in range(body_start, body_end):
                body = worlds.bodies[i]
                velocity = body_qd[body]
                if work.inv_mass[body] > 0.0:
                    velocity = end_velocity(
                        i,
                        step,
                        body_q,
                        body_qd,
                        model,
                        worlds,
                        work,
                        rows,
                        tree,
                        loops,
                        islands,
                        history,
                    )
                    if wp.static(effects.bdf2):
                        remember_motion(
                            body, body_qd[body], scale, joints, work, rows, tree, history
                        )
                body_qd_out[body] = velocity

            if wp.static(effects.restitution):
                if has_impacts:
                    for i in range(body_start, body_end):
                        body = worlds.bodies[i]
                        rows.struck_at[body] = find_wait(body, worlds, rows, tree, loops)
                    for i in range(body_start, body_end):
                        release_impacts(worlds.bodies[i], h, work, rows)
                    for i in range(body_start, body_end):
                        body = worlds.bodies[i]
                        if rows.struck_at[body] >= 0.0:
                            history.falling[body] = free_share(body, scale, work)
            if wp.static(effects.armature):
                for i in range(body_start, body_end):
                    body = worlds.bodies[i]
                    if work.inv_mass[body] > 0.0 and tree.joint[body] >= 0:
                        end_armature(
                            tree.joint[body],
                            tree.axis_start[body],
                            tree.coordinate,
                            tree.start_coordinate,
                            scale,
                            body_qd,
                            body_qd_out,
                            joints,
                            work,
                            tree,
                            history,
                        )
                if wp.static(effects.loops):
                    for i in range(loops.world_start[world], loops.world_start[world + 1]):
                        joint = loops.joints[i]
                        end_armature(
                            joint,
                            joints.dof_start[joint],
                            loops.coordinate,
                            loops.start_coordinate,
                            scale,
                            body_qd,
                            body_qd_out,
                            joints,
                            work,
                            tree,
                            history,
                        )

            # Recovery: old errors go, without entering the velocity.
            if wp.static(not effects.ramp):
                sweeps = count_passes(sweeps, update, deepest, is_open, scale)
                recovery = contact_rows.RECOVERY
                sweep = 0
                if wp.static(effects.loops):
                    # what closes them now is no force of the motion
                    for i in range(loops.world_start[world], loops.world_start[world + 1]):
                        loops.kept_force[i] = history.loop_force[i]
                        loops.kept_torque[i] = history.loop_torque[i]

        if wp.static(effects.joints):
            unsettled = unsettled_update(scale)
            if update > unsettled * unsettled:
                # after impacts that no iteration settles joints are closed all the same
                for i in range(body_start, body_end):
                    body = worlds.bodies[i]
                    if work.inv_mass[body] > 0.0 and is_linked(joints, tree, body):
                        put_together(body, scale.static_slot, model, joints, work, tree)
        if wp.static(effects.loops):
            for i in range(loops.world_start[world], loops.world_start[world + 1]):
                history.loop_force[i] = loops.kept_force[i]
                history.loop_torque[i] = loops.kept_torque[i]

        if wp.static(effects.restitution):
            if has_impacts:
                for i in range(body_start, body_end):
                    restore_impacts(worlds.bodies[i], h, work, rows)

        # Poses.
        for i in range(body_start, body_end):
            body = worlds.bodies[i]
            pose = body_q[body]
            if work.inv_mass[body] > 0.0:
                pose = end_pose(i, body_q, model, worlds, work, rows, tree, loops, islands, history)
            body_q_out[body] = pose
        if wp.static(effects.gyroscopic and effects.contact):
            if has_islands:
                keep_spin(world, step, body_q_out, model, worlds, work, islands, body_qd_out)
        if wp.static(effects.bdf2):
            for i in range(body_start, body_end):
                body = worlds.bodies[i]
                if work.inv_mass[body] > 0.0:
                    remember_state(
                        body,
                        body_q_out[body],
                        body_qd_out[body],
                        scale,
                        body_q,
                        model,
                        work,
                        history,
                    )

    @wp.func
    def solve_worlds(
        thread: int,
        model: wp.ref[BodyModel],
        shapes: wp.ref[ShapeModel],
        joints: wp.ref[JointModel],
        control: wp.ref[ControlInput],
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        contacts: wp.ref[ContactInput],
        h: float,
        iterations: int,
        tolerance: float,
        worlds: wp.ref[WorldWork],
        work: wp.ref[BodyWork],
        rows: wp.ref[RowWork],
        tree: wp.ref[TreeWork],
        loops: wp.ref[LoopWork],
        islands: wp.ref[IslandWork],
        history: wp.ref[History],
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """The world of a thread; what is awake is solved island by island, as worlds are."""
        end = int(thread + 1)
        stride = int(1)
        if wp.static(effects.sleeping):
            end = worlds.island_start[worlds.island_start.shape[0] - 1]
            stride = worlds.threads
        for world in range(thread, end, stride):
            solve_world(
                world,
                model,
                shapes,
                joints,
                control,
                body_q,
                body_qd,
                contacts,
                h,
                iterations,
                tolerance,
                worlds,
                work,
                rows,
                tree,
                loops,
                islands,
                history,
                body_q_out,
                body_qd_out,
            )

    return solve_worlds


@functools.cache
@uncollected()
def make_solve(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a world: what :func:`make_solve_worlds` does for each."""
    solve_worlds = make_solve_worlds(effects)

    @wp.kernel(**KERNEL)
    def solve(
        first: int,
        # Model:
        model: wp.array[BodyModel],
        shapes: wp.array[ShapeModel],
        joints: wp.array[JointModel],
        control: ControlInput,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        contacts: ContactInput,
        h: float,
        iterations: int,
        tolerance: float,
        # Work:
        worlds: wp.array[WorldWork],
        work: wp.array[BodyWork],
        rows: wp.array[RowWork],
        tree: wp.array[TreeWork],
        loops: wp.array[LoopWork],
        islands: wp.array[IslandWork],
        history: wp.array[History],
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        """The worlds from ``first`` on."""
        mode = flush_denormals()
        solve_worlds(
            first + wp.tid(),
            model[0],
            shapes[0],
            joints[0],
            control,
            body_q,
            body_qd,
            contacts,
            h,
            iterations,
            tolerance,
            worlds[0],
            work[0],
            rows[0],
            tree[0],
            loops[0],
            islands[0],
            history[0],
            body_q_out,
            body_qd_out,
        )
        restore_denormals(mode)

    return solve


@functools.cache
@uncollected()
def make_step(effects: Effects) -> wp.Kernel:
    """Kernel, one thread: the whole step of a single world on a CPU, where launches cost most."""
    predict_body = make_predict_body(effects)
    sort_by_owner = make_sort_by_owner()
    solve_worlds = make_solve_worlds(effects)

    @wp.kernel(**KERNEL)
    def step(
        # Model:
        model: wp.array[BodyModel],
        shapes: wp.array[ShapeModel],
        joints: wp.array[JointModel],
        control: ControlInput,
        # State in:
        body_q: wp.array[wp.transform],
        body_qd: wp.array[wp.spatial_vector],
        body_f: wp.array[wp.spatial_vector],
        contacts: ContactInput,
        h: float,
        iterations: int,
        tolerance: float,
        # Work:
        worlds: wp.array[WorldWork],
        work: wp.array[BodyWork],
        rows: wp.array[RowWork],
        tree: wp.array[TreeWork],
        loops: wp.array[LoopWork],
        islands: wp.array[IslandWork],
        history: wp.array[History],
        # State out:
        body_q_out: wp.array[wp.transform],
        body_qd_out: wp.array[wp.spatial_vector],
    ):
        mode = flush_denormals()
        for body in range(body_q.shape[0]):
            predict_body(
                body,
                model[0],
                body_q,
                body_qd,
                body_f,
                control,
                h,
                worlds[0],
                history[0].falling,
                tree[0].joint,
                work[0],
            )
        if wp.static(effects.contact):
            sort_by_owner(shapes[0], contacts, worlds[0], work[0], rows[0])
        solve_worlds(
            0,
            model[0],
            shapes[0],
            joints[0],
            control,
            work[0].pose,
            body_qd,
            contacts,
            h,
            iterations,
            tolerance,
            worlds[0],
            work[0],
            rows[0],
            tree[0],
            loops[0],
            islands[0],
            history[0],
            body_q_out,
            body_qd_out,
        )
        restore_denormals(mode)

    return step
