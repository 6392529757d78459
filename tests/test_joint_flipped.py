# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Joints whose child holds their parent: the tree goes the other way, the motion does not."""

import newton
import numpy as np
import pytest
import warp as wp

from newton_avbd import SolverAVBD

pytestmark = pytest.mark.usefixtures("shared_kernels")

DT = 1.0 / 240.0
ANCHOR = wp.transform(wp.vec3(0.1, -0.2, 0.3), wp.quat_rpy(0.3, 0.5, -0.4))
END = wp.transform(wp.vec3(-0.3, 0.1, 0.2), wp.quat_rpy(-0.2, 0.1, 0.6))
AXIS = (0.6, 0.0, 0.8)


def hanging(kind: str, *, flipped: bool, welds: bool = False) -> SolverAVBD:
    """A body on a kinematic one, joined from it or to it, by a joint that is no weld or one."""
    builder = newton.ModelBuilder()
    inertia = wp.mat33(0.02, 0.0, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 0.04)
    holder = builder.add_link(mass=1.0, inertia=inertia, is_kinematic=True)
    body = builder.add_link(mass=2.0, inertia=inertia, com=wp.vec3(0.1, 0.0, 0.05))
    pose = ANCHOR * wp.transform_inverse(END)
    builder.body_q[body] = pose
    sign = -1.0 if flipped else 1.0
    settings: dict = {"parent_xform": ANCHOR, "child_xform": END}
    if kind in ("revolute", "prismatic"):
        limits = (-0.8, 0.3)
        settings |= {
            "axis": AXIS,
            "target_pos": sign * 0.2,
            "target_ke": 4.0,
            "target_kd": 0.1,
            "limit_lower": min(sign * limit for limit in limits),
            "limit_upper": max(sign * limit for limit in limits),
        }
    ends = (holder, body)
    if flipped:
        settings |= {"parent_xform": END, "child_xform": ANCHOR}
        ends = (body, holder)
    getattr(builder, f"add_joint_{kind}")(*ends, **settings)
    model = builder.finalize(device="cpu", skip_all_validations=True)
    return SolverAVBD(model, effects={} if welds else {"welds": False})


@pytest.mark.parametrize("kind", ["fixed", "revolute", "prismatic", "ball"])
def test_a_joint_holds_the_same_from_either_end(kind: str) -> None:
    """With a drive and limits of opposite sign; within the rounding of 240 steps."""
    paths = []
    for flipped in (False, True):
        solver = hanging(kind, flipped=flipped)
        assert solver.effects.flags.flipped == flipped
        assert not solver.effects.flags.loops
        state, out = solver.model.state(), solver.model.state()
        path = []
        for _ in range(240):
            solver.step(state, out, None, None, DT)
            state, out = out, state
            path.append(state.body_q.numpy()[1].copy())
        paths.append(np.array(path))
    there, back = paths
    assert np.abs(there - back).max() < 2.0e-5
    if kind != "fixed":
        assert np.abs(there - there[0]).max() > 0.1


@pytest.mark.parametrize("welds", [False, True])
def test_a_held_joint_child_reads_what_holds_it(welds: bool) -> None:
    """The wrench from joint parent to joint child: the kinematic body is pulled by the weight."""
    solver = hanging("fixed", flipped=True, welds=welds)
    assert solver.effects.flags.welds == welds
    state, out = solver.model.state(), solver.model.state()
    observables = solver.observables([solver.ObservableKind.BODY_PARENT_F])
    solver.step(state, out, None, None, DT, observables=observables)
    wrench = observables.body_parent_f.numpy()
    assert wrench[0, :3] == pytest.approx([0.0, 0.0, -2.0 * 9.81], rel=1.0e-4, abs=1.0e-3)
    assert wrench[1] == pytest.approx(np.zeros(6))
