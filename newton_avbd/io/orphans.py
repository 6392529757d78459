# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""USD files whose joints belong to no articulation.

Newton's importer makes an articulation where a prim says that it is the root of one, and a model
with a joint between bodies of no articulation is not finalized. USD asks for no root: here the
joints without one get it.
"""

from pathlib import Path
from typing import Any

import newton


def find_orphans(builder: newton.ModelBuilder) -> list[int]:
    """Joints of bodies in no articulation, if one is among them that ``finalize`` refuses.

    It refuses those between two bodies; one that holds a lone body to the world may stay alone.
    """
    owner = builder.joint_articulation
    articulated = {
        body
        for joint, articulation in enumerate(owner)
        if articulation >= 0
        for body in (builder.joint_parent[joint], builder.joint_child[joint])
    }
    orphans = [
        joint
        for joint, articulation in enumerate(owner)
        if articulation < 0 and builder.joint_child[joint] not in articulated
    ]
    return orphans if any(builder.joint_parent[joint] >= 0 for joint in orphans) else []


def rooted_stage(path: Path, builder: newton.ModelBuilder, orphans: list[int]) -> Any:
    """Open a USD file and give the joints ``orphans`` a root for every group that they join.

    The root is a body that a joint holds to the world, or else the first. A joint that closes a
    loop is excluded from the articulation, as the importer demands.

    Args:
        path: The file.
        builder: What the importer made of it; its labels are the paths of prims.
        orphans: Joints that :func:`find_orphans` returned.

    Returns:
        The stage, flattened; the file stays as it is.
    """
    from pxr import Usd, UsdPhysics

    stage = Usd.Stage.Open(Usd.Stage.Open(str(path)).Flatten())
    ends = {joint: (builder.joint_parent[joint], builder.joint_child[joint]) for joint in orphans}
    to_world = {child for parent, child in ends.values() if parent < 0}
    bodies = sorted({body for pair in ends.values() for body in pair if body >= 0})
    reached: set[int] = set()
    left = dict(ends)
    for root in sorted(bodies, key=lambda body: body not in to_world):
        if root in reached:
            continue
        reached.add(root)
        prim = stage.GetPrimAtPath(builder.body_label[root])
        UsdPhysics.ArticulationRootAPI.Apply(prim)
        front = [-1, root] if root in to_world else [root]
        left = {joint: pair for joint, pair in left.items() if pair != (-1, root)}
        for body in front:
            for joint, pair in list(left.items()):
                if body < 0 or body not in pair:
                    continue
                del left[joint]
                other = pair[1] if pair[0] == body else pair[0]
                if other in reached or other < 0:
                    closing = UsdPhysics.Joint(stage.GetPrimAtPath(builder.joint_label[joint]))
                    closing.CreateExcludeFromArticulationAttr(True)
                else:
                    reached.add(other)
                    front.append(other)
    return stage
