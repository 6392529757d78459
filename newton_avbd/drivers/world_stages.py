# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""The stages of a step of fourth order of a world."""

import warp as wp

from ..data import Solver, Step, WorldScale
from ..effects import Effects
from ..functions import Functions, together
from ..step.anchors import is_linked
from ..step.bodies import body_at
from ..step.runge_kutta import RESOLVED, SHARED

APART = wp.constant(1.0e-5)
"""How far from its pose a body may be placed by its coordinates [m a meter from the origin, or
rad]: ten times what rounds."""


def make_world_stages(
    effects: Effects, rk: Functions, forces: Functions, ending: Functions
) -> Functions:
    """Device functions of the stages, by those of a body."""
    place_body, advance_body, differs_by = rk.place_body, rk.advance_body, rk.differs_by
    eliminate_stage, substitute_stage = forces.eliminate_stage, forces.substitute_stage
    end_body = ending.end_body

    @wp.func(inline=effects.inline)
    def place_world(world: int, static_slot: int, s: wp.ref[Solver]):
        """Places the bodies of a world by their coordinates."""
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                place_body(body, static_slot, s)

    @wp.func(inline=effects.inline)
    def substitute_world(world: int, s: wp.ref[Solver]):
        """Accelerations of linked bodies by those of roots, or velocities."""
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                substitute_stage(body, s)

    @wp.func
    def is_tree_resolved(world: int, first: int, end: int, h: float, s: wp.ref[Solver]) -> bool:
        """Whether the step is short beside what the bodies of a tree do, by its third stage.

        Each is looked at by itself, beside its own motion and a share of that of them all.
        """
        mass = float(0.0)
        momentum = wp.vec3(0.0)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                mass += s.model.mass[body]
                velocity = wp.spatial_top(s.tree.runge_kutta.start_velocity[body])
                momentum += s.model.mass[body] * velocity
        if mass == 0.0:
            return True
        drift = momentum / mass
        changed = float(0.0)
        gained = float(0.0)
        motion = float(0.0)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                of_change, of_gain, of_motion = differs_by(body, drift, h, s)
                changed += of_change
                gained += of_gain
                motion += of_motion
        if wp.static(effects.adaptive):
            # of what gains nothing it says nothing
            turns = 2.0 * wp.pow(changed / wp.max(gained, 1.0e-30), 0.25)
            s.tree.runge_kutta.turns[world] = wp.max(s.tree.runge_kutta.turns[world], turns)
        least = SHARED * SHARED * (gained + motion)
        for i in range(first, end):
            body = body_at(i, s.worlds)
            if s.work.inv_mass[body] > 0.0:
                of_change, of_gain, of_motion = differs_by(body, drift, h, s)
                if of_change > RESOLVED * RESOLVED * (of_gain + of_motion) + least:
                    return False
        return True

    @wp.func
    def is_resolved(world: int, h: float, s: wp.ref[Solver]) -> bool:
        """Whether the step is short beside what the trees of a world do.

        Error control is told by how much: the two stages in the middle of the step differ by
        (h w)^2 / 4 of what an oscillation of frequency w gains in it.
        """
        if wp.static(effects.adaptive):
            s.tree.runge_kutta.turns[world] = 0.0
        first = int(s.worlds.body_start[world])
        while first < s.worlds.body_start[world + 1]:
            end = s.worlds.block_end[first]
            if not is_tree_resolved(world, first, end, h, s):
                return False
            first = end
        return True

    @wp.func
    def stand(world: int, scale: WorldScale, s: wp.ref[Solver]) -> bool:
        """Whether the coordinates have the bodies of a world where they are: joints may have been
        changed without a word."""
        for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
            body = body_at(i, s.worlds)
            end_body(body, scale.static_slot, s)
            if s.work.inv_mass[body] > 0.0 and is_linked(body, s):
                off = s.work.increment[body]
                far = APART * (1.0 + wp.length(s.work.com[body]))
                if wp.length(wp.spatial_top(off)) > far or wp.length(wp.spatial_bottom(off)) > far:
                    return False
        return True

    @wp.func
    def take_stages(world: int, scale: WorldScale, step: wp.ref[Step], s: wp.ref[Solver]) -> bool:
        """The four stages of a step, and where it ends; returns whether it is short enough."""
        h = scale.h
        for stage in range(5):
            place_world(world, scale.static_slot, s)
            if stage == 4:
                break
            if stage == 0 and not stand(world, scale, s):
                return False
            if not eliminate_stage(world, False, scale.static_slot, h, step, s):
                return False
            substitute_world(world, s)
            if stage == 2 and not is_resolved(world, h, s):
                return False
            weight = wp.where(stage == 0 or stage == 3, h / 6.0, h / 3.0)
            ahead = wp.where(stage < 2, 0.5 * h, wp.where(stage == 2, h, 0.0))
            for i in range(s.worlds.body_start[world], s.worlds.body_start[world + 1]):
                body = body_at(i, s.worlds)
                if s.work.inv_mass[body] > 0.0:
                    s.tree.runge_kutta.before[body] = s.tree.update[body]
                    if stage == 3:
                        s.tree.runge_kutta.before[body] = s.tree.runge_kutta.velocity[body]
                    advance_body(body, weight, ahead, s)
        return True

    return together(place_world, substitute_world, take_stages)
