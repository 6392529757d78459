# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Links that no joint can part are found, named, and told apart from penetration."""

import newton
import numpy as np
import pytest
import warp as wp

from newton_avbd.measure.overlaps import describe_overlaps
from newton_avbd.measure.state import Probe, deepest_penetration

INERTIA = wp.mat33(np.eye(3) * 0.01)
# The gap of two spheres of known places; the model holds float32.
ROUNDING = 1.0e-6


class Arm:
    """Links in a row along x, each 0.3 m from the last, with a sphere each."""

    def __init__(self) -> None:
        self.builder = newton.ModelBuilder()
        self.builder.default_shape_cfg.gap = 0.01
        self.joints: list[int] = []
        self.last = -1

    def add(self, name: str, radius: float, joint: str, distance: float = 0.3, **options) -> None:
        builder, parent = self.builder, self.last
        link = builder.add_link(mass=1.0, inertia=INERTIA, label=name)
        builder.add_shape_sphere(link, radius=radius)
        frame = wp.transform(wp.vec3(distance if parent >= 0 else 0.0, 0.0, 0.0))
        make = getattr(builder, f"add_joint_{joint}")
        self.joints.append(make(parent, link, parent_xform=frame, **options))
        self.last = link

    def probe(self) -> tuple[Probe, newton.State]:
        self.builder.add_articulation(self.joints)
        model = self.builder.finalize(device="cpu")
        newton.eval_fk(model, model.joint_q, model.joint_qd, model)
        return Probe(model), model.state()


def test_links_welded_together_overlap_for_good():
    """Two welded links that overlap are direct neighbors, which Newton filters; a third is not."""
    arm = Arm()
    arm.add("base", 0.2, "fixed")
    arm.add("tube", 0.05, "fixed", 0.1)
    arm.add("tip", 0.15, "fixed", 0.1)
    (overlap,) = arm.probe()[0].overlaps
    assert overlap.bodies == ("base", "tip")
    assert "welded together" in overlap.reason
    assert overlap.depth == pytest.approx(0.2 + 0.15 - 0.2, abs=ROUNDING)


def test_neighbors_through_a_weld_overlap_for_good():
    arm = Arm()
    arm.add("base", 0.2, "revolute", axis=wp.vec3(0.0, 0.0, 1.0))
    arm.add("arm", 0.05, "revolute", 0.25, axis=wp.vec3(0.0, 0.0, 1.0))
    arm.add("flange", 0.1, "fixed", 0.02)
    probe, _ = arm.probe()
    (overlap,) = probe.overlaps
    assert overlap.bodies == ("base", "flange")
    assert "neighbors through welds" in overlap.reason


def test_links_that_no_pose_parts_overlap_for_good_and_are_no_penetration():
    """The end turns about a point 0.1 m from the base's center: its 0.15 m never leave 0.2 m."""
    arm = Arm()
    axis = {"axis": wp.vec3(0.0, 0.0, 1.0)}
    arm.add("base", 0.2, "revolute", **axis)
    arm.add("middle", 0.02, "revolute", 0.1, **axis)
    arm.add("end", 0.15, "revolute", 0.1, **axis)
    probe, state = arm.probe()
    (overlap,) = probe.overlaps
    assert overlap.bodies == ("base", "end")
    assert overlap.depth == pytest.approx(0.2 + 0.15 - 0.2, abs=ROUNDING)
    assert probe.overlap(state) == pytest.approx(overlap.depth, abs=ROUNDING)
    assert deepest_penetration(probe.separations(state)) == 0.0
    a, b = overlap.shapes
    (note,) = describe_overlaps(probe.overlaps)
    assert f"add_shape_collision_filter_pair({a}, {b})" in note
    assert "base and end overlap by 150 mm" in note


def test_limits_decide_whether_joints_part_links():
    """At 0.35 m from the base 0.2 m and 0.1 m are apart; folded back, at 0.05 m, they are not."""
    for limit, count in ((np.pi, 0), (0.1, 1)):
        arm = Arm()
        axis = {"axis": wp.vec3(0.0, 0.0, 1.0)}
        arm.add("base", 0.2, "revolute", **axis)
        arm.add("middle", 0.02, "revolute", 0.2, **axis)
        arm.add("end", 0.1, "revolute", -0.15, limit_lower=-limit, limit_upper=limit, **axis)
        # The hinge of the middle link is what folds; the end's own does not move its center.
        middle = arm.builder.joint_qd_start[1]
        arm.builder.joint_limit_lower[middle] = -limit
        arm.builder.joint_limit_upper[middle] = limit
        assert len(arm.probe()[0].overlaps) == count


def test_bodies_that_no_joint_connects_penetrate():
    builder = newton.ModelBuilder()
    for x in (0.0, 0.15):
        builder.add_shape_sphere(builder.add_body(xform=wp.transform((x, 0.0, 0.0))), radius=0.1)
    model = builder.finalize(device="cpu")
    probe = Probe(model)
    assert probe.overlaps == ()
    gaps = probe.separations(model.state())
    assert deepest_penetration(gaps) == pytest.approx(0.05, abs=ROUNDING)
