# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The step of one world in one kernel, one thread a world: read ``solve_world`` top to bottom."""

import functools

import warp as wp

from ..data import Solver, Step
from ..effects import Effects
from ..rows.contact import RECOVERY
from ..step.adapting import make_adapt_world
from ..step.bodies import make_predict_body
from ..step.contacts import make_sort_by_owner
from ..step.denormals import flush_denormals, restore_denormals
from ..step.energy import keep_start
from ..step.finite import hold_world, is_solution_finite, make_is_world_finite
from ..step.islands import join_islands
from ..step.kernels import KERNEL, absent, uncollected
from ..step.links import (
    are_links_known,
    are_links_quiet,
    gather_body,
    gather_joint,
    know_links,
    place_fixed_links,
    scatter_body,
    weigh_body,
)
from ..step.scale import (
    COLD_STEPS,
    RESTLESS_FACTOR,
    STRUCK_FACTOR,
    farthest_move,
    is_restless,
    is_struck,
    is_unsettled,
    most_rounds,
    stiffens,
)
from ..step.sides import make_written_side
from .stages import make_stages
from .world_motion import make_world_motion
from .world_recovery import make_world_recovery
from .world_smooth import make_world_smooth
from .world_start import make_world_start
from .world_sweeps import make_sweep_to_rest, stiffen_impacts


@functools.cache
def make_solve_worlds(effects: Effects) -> wp.Function:
    """Device function: the whole step of the world of a thread, after prediction."""
    is_world_finite = make_is_world_finite(effects)
    written_side = make_written_side(effects)
    stages = make_stages(effects, join_islands)
    begin_second_order = stages.second_order.begin_step
    gains_settled = stages.energy.gains_settled
    start = make_world_start(effects, stages)
    begin_world, build_rows = start.begin_world, start.build_rows
    begin_joints, begin_sweeps = start.begin_joints, start.begin_sweeps
    sweep_to_rest = make_sweep_to_rest(effects, stages)
    motion = make_world_motion(effects, stages)
    keep_forces, break_joints = motion.keep_forces, motion.break_joints
    end_velocities = motion.end_velocities
    after = make_world_recovery(effects, stages)
    begin_recovery, end_recovery = after.begin_recovery, after.end_recovery
    end_poses = after.end_poses
    step_smoothly = absent
    if effects.fourth_order:
        step_smoothly = make_world_smooth(effects, end_poses)

    @wp.func
    def solve_world(
        world: int,
        body_qd: wp.array[wp.spatial_vector],
        h: float,
        tolerance: float,
        step: wp.ref[Step],
        s: wp.ref[Solver],
    ):
        """The step of one world, phase by phase; what is not finite is held still."""
        if not is_world_finite(world, step, s):
            hold_world(world, body_qd, step, s)
            return

        # Before the sweeps: contacts, then joints, then the blocks of both.
        scale = begin_world(world, h, tolerance, s)
        deepest = float(0.0)
        has_impacts = bool(False)
        if wp.static(effects.contact):
            deepest, has_impacts = build_rows(world, scale, body_qd, step, s)
        if wp.static(effects.fourth_order):
            # where nothing but joints holds the bodies that is all
            if step_smoothly(world, scale, body_qd, step, s):
                return
        if wp.static(effects.second_order):
            scale = begin_second_order(world, has_impacts, scale, body_qd, s)
        is_open = bool(False)
        if wp.static(effects.joints):
            is_open = begin_joints(world, scale, body_qd, step, s)

        # Rounds of sweeps by one call, which is most of the code: the motion, again and with
        # stiffer contacts where impacts go on, and on where a world does not come to rest; and the
        # recovery.
        most = int(0)
        sweeps = int(0)
        update = float(0.0)
        recovery = float(0.0)
        has_islands = bool(False)
        has_not_settled = bool(False)
        goes_on = bool(False)
        rounds = int(wp.static(most_rounds(effects)))
        for _round in range(rounds):
            if recovery == 0.0 and not goes_on:
                most = begin_sweeps(world, scale, step, s)
                if sweeps > 0:
                    most = step.iterations
            taken, update = sweep_to_rest(world, most, recovery, scale, step, s)
            if recovery > 0.0:
                break
            sweeps += taken
            goes_on = False
            if wp.static(effects.switching and not effects.ramp):
                is_cut_off = taken >= step.iterations and sweeps < STRUCK_FACTOR * step.iterations
                if is_cut_off and is_struck(sweeps, update, scale):
                    if wp.static(effects.contact and not effects.compliance):
                        if stiffens(update, scale):
                            stiffen_impacts(world, scale, s)
                    continue
            if wp.static(effects.piles):
                if taken >= most and sweeps < RESTLESS_FACTOR * most:
                    goes_on = is_restless(update, farthest_move(world, s), scale)
                if goes_on:
                    continue

            # After the motion: forces and velocities.
            has_islands = keep_forces(world, sweeps, update, scale, body_qd, s)
            if not is_solution_finite(world, s):
                hold_world(world, body_qd, step, s)
                return
            if wp.static(effects.breaking):
                break_joints(world, scale.step, step, s)
            s.history.parity[world] = written_side(world, s.history)
            s.history.age[world] = wp.min(s.history.age[world] + 1, COLD_STEPS)
            if wp.static(effects.balanced):
                has_not_settled = is_unsettled(update, scale)
                if wp.static(effects.joints or effects.gaining):
                    if gains_settled(world, s):
                        has_not_settled = True
                if has_not_settled:
                    keep_start(world, body_qd, s)
            end_velocities(world, has_impacts, has_islands, scale, body_qd, step, s)

            # Recovery: old errors go, without entering the velocity.
            if wp.static(not effects.ramp):
                # rebounds have moved what joints hold
                is_open = is_open or has_impacts
                most = begin_recovery(world, sweeps, update, deepest, is_open, scale, s)
                recovery = RECOVERY
                if most == 0:
                    break

        # After the recovery: poses.
        end_recovery(world, update, has_impacts, has_islands, scale, step, s)
        end_poses(world, has_islands, has_not_settled, scale, step, s)

    # the same arguments, so that either can stand for the step
    step_once = solve_world
    if effects.adaptive:
        step_once = make_adapt_world(effects, solve_world)

    @wp.func
    def solve_worlds(thread: int, step: wp.ref[Step], s: wp.ref[Solver]):
        """The world of a thread; what is awake is solved island by island, as worlds are."""
        end = int(thread + 1)
        stride = int(1)
        if wp.static(effects.sleeping):
            end = s.worlds.island_start[s.worlds.island_start.shape[0] - 1]
            stride = s.worlds.threads
        for turn in range(thread, end, stride):
            world = int(turn)
            if wp.static(effects.on_gpu and not effects.sleeping):
                world = s.worlds.turn[turn]
                if world < 0:
                    return
            step_once(world, step.body_qd, step.h, step.tolerance, step, s)

    return solve_worlds


@functools.cache
@uncollected()
def make_solve(effects: Effects) -> wp.Kernel:
    """Kernel, one thread a world: what :func:`make_solve_worlds` does for each."""
    solve_worlds = make_solve_worlds(effects)

    @wp.kernel(**KERNEL)
    def solve(first: int, step: Step, s: wp.array[Solver]):
        """The worlds from ``first`` on."""
        mode = flush_denormals()
        solve_worlds(first + wp.tid(), step, s[0])
        restore_denormals(mode)

    return solve


@functools.cache
def make_step_world(effects: Effects) -> wp.Function:
    """Device function: the whole step of a single world, by one thread."""
    predict_body = make_predict_body(effects)
    sort_by_owner = make_sort_by_owner()
    solve_worlds = make_solve_worlds(effects)

    @wp.func
    def step_world(thread: int, step: wp.ref[Step], s: wp.ref[Solver]):
        for body in range(step.body_q.shape[0]):
            predict_body(body, step.body_q, step.body_qd, step.body_f, step.h, step, s)
            if wp.static(effects.adaptive):
                s.worlds.inner.wrench[body] = step.body_f[body]
        if wp.static(effects.contact):
            sort_by_owner(step, s)
        solve_worlds(thread, step, s)

    return step_world


@functools.cache
@uncollected()
def make_step(effects: Effects) -> wp.Kernel:
    """Kernel, one thread: the whole step of a single world on a CPU, where launches cost most."""
    step_world = make_step_world(effects)

    @wp.kernel(**KERNEL)
    def step(step: Step, s: wp.array[Solver]):
        mode = flush_denormals()
        step_world(wp.tid(), step, s[0])
        restore_denormals(mode)

    return step


@functools.cache
@uncollected()
def make_step_links(effects: Effects) -> wp.Kernel:
    """Kernel, one thread: as :func:`make_step`, of links that welds make bodies of."""
    step_world = make_step_world(effects)

    @wp.kernel(**KERNEL)
    def step_links(
        link_q: wp.array[wp.transform],
        link_qd: wp.array[wp.spatial_vector],
        link_f: wp.array[wp.spatial_vector],
        link_q_out: wp.array[wp.transform],
        link_qd_out: wp.array[wp.spatial_vector],
        step: Step,
        s: wp.array[Solver],
    ):
        mode = flush_denormals()
        for joint in range(s[0].links.joint.shape[0]):
            gather_joint(joint, s[0].links)
        are_known = are_links_known(s[0].links)
        for body in range(s[0].links.leader.shape[0]):
            weigh_body(body, False, are_known, s[0].links, s[0].model)
        if not are_known:
            know_links(s[0].links)
        is_quiet = are_links_quiet(s[0].links, link_qd, link_f)
        for body in range(s[0].links.leader.shape[0]):
            # a body may be pushed by the arm of another one's link
            gather_body(
                body, s[0].model, s[0].links, step.control, link_q, link_qd, link_f, is_quiet
            )
        step_world(wp.tid(), step, s[0])
        for body in range(s[0].links.leader.shape[0]):
            scatter_body(body, s[0].links, link_q, link_qd, link_q_out, link_qd_out)
        place_fixed_links(s[0].links, link_q_out, link_qd_out)
        restore_denormals(mode)

    return step_links
