# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's adhesion: actuators that pull a body towards what it touches.

The force of an actuator is shared by the contacts that its body has at the start of the step, each
of which pulls both of its bodies together along its normal.
"""

import warp as wp

from ..data import ActuatorModel, Adhesion, ContactInput
from ..rows.actuator import law_in_step
from .kernels import KERNEL
from .routes import link_of

TOUCHING = wp.constant(1.0e-4)
"""How far apart what touches may be [m]: far above the gaps of contacts that hold."""


@wp.func
def carrier_of(shape: int, shape_body: wp.array[wp.int32]) -> int:
    """Link of a shape, -1 for the static world."""
    if shape < 0:
        return -1
    return shape_body[shape]


@wp.func
def touches(
    c: int, first: int, second: int, contacts: ContactInput, body_q: wp.array[wp.transform]
) -> bool:
    """Whether the two links of a contact touch there."""
    apart = wp.transform_point(link_of(second, body_q), contacts.point1[c])
    apart -= wp.transform_point(link_of(first, body_q), contacts.point0[c])
    gap = wp.dot(contacts.normal[c], apart) - contacts.margin0[c] - contacts.margin1[c]
    return first != second and gap < TOUCHING


@wp.kernel(**KERNEL)
def share_adhesion(
    # Model:
    actuators: ActuatorModel,
    shape_body: wp.array[wp.int32],
    # State in:
    body_q: wp.array[wp.transform],
    # In:
    contacts: ContactInput,
    ctrl: wp.array[float],
    h: float,
    # Out:
    work: Adhesion,
):
    """Force of each contact of a body that adheres [N]; one thread an actuator."""
    i = wp.tid()
    count = int(0)
    for c in range(wp.min(contacts.count[0], contacts.capacity)):
        first = carrier_of(contacts.shape0[c], shape_body)
        second = carrier_of(contacts.shape1[c], shape_body)
        if first == work.link[i] or second == work.link[i]:
            if touches(c, first, second, contacts, body_q):
                count += 1
    law = law_in_step(actuators, work.row[i], ctrl, 0.0, 0.0, h)
    force = actuators.gear[work.row[i]][0] * wp.clamp(law.force, law.least, law.most)
    work.force[i] = force / float(wp.max(count, 1))


@wp.kernel(**KERNEL)
def adhere(
    # Model:
    shape_body: wp.array[wp.int32],
    com: wp.array[wp.vec3],
    # State in:
    body_q: wp.array[wp.transform],
    # In:
    contacts: ContactInput,
    work: Adhesion,
    # Out:
    pushed: wp.array[wp.spatial_vector],
):
    """Adds what adhesion pulls each link with to its wrench; one thread a link."""
    link = wp.tid()
    wrench = pushed[link]
    for c in range(wp.min(contacts.count[0], contacts.capacity)):
        first = carrier_of(contacts.shape0[c], shape_body)
        second = carrier_of(contacts.shape1[c], shape_body)
        if first == link or second == link:
            total = float(0.0)
            for i in range(work.link.shape[0]):
                if first == work.link[i] or second == work.link[i]:
                    total += work.force[i]
            if total != 0.0 and touches(c, first, second, contacts, body_q):
                sign = wp.where(first == link, total, -total)
                own = wp.where(first == link, contacts.point0[c], contacts.point1[c])
                force = sign * contacts.normal[c]
                arm = wp.quat_rotate(wp.transform_get_rotation(body_q[link]), own - com[link])
                wrench += wp.spatial_vector(force, wp.cross(arm, force))
    pushed[link] = wrench
