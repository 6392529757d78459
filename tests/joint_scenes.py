# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What the joint tests share: scenes with joints, and how a test looks at them."""

from collections.abc import Callable, Sequence
from typing import Any

import newton
import numpy as np
import warp as wp
from helpers import Array, Simulation
from newton.solvers import SolverBase
from scipy.spatial.transform import Rotation

from newton_avbd import SolverAVBD

SOLVER: Callable[..., SolverBase] = SolverAVBD
"""The solver under test; a peer that supports a scene can be put here to judge the test."""

WORLD = -1

TENSOR = np.array([[0.03, 0.004, -0.002], [0.004, 0.05, 0.003], [-0.002, 0.003, 0.04]])
"""An inertia tensor without symmetry [kg m^2], that of a body of about 1 kg and 0.5 m."""


def simulate(builder: newton.ModelBuilder, *, collide: bool = False, **settings: Any) -> Simulation:
    """A simulation that starts at the builder's ``joint_q`` and ``joint_qd``."""
    return Simulation(builder, collide=collide, make_solver=_posed, **settings)


def add_contact(builder: newton.ModelBuilder, body: int) -> None:
    """Gives a body something to collide with, far away: a scene without is not colored."""
    weightless = newton.ModelBuilder.ShapeConfig(density=0.0)
    builder.add_shape_sphere(body, radius=0.02, cfg=weightless)
    builder.add_shape_plane(plane=(0.0, 0.0, 1.0, 50.0), width=0.0, length=0.0)


def _posed(model: newton.Model, **settings: Any) -> SolverBase:
    """The solver, once the model's bodies are where the joint coordinates put them."""
    if model.joint_count:
        newton.eval_fk(model, model.joint_q, model.joint_qd, model)
    return SOLVER(model, **settings)


def transform(position: Any = (0, 0, 0), rotation: Rotation | None = None) -> wp.transform:
    """A frame from a position [m] and a rotation."""
    turn = Rotation.identity() if rotation is None else rotation
    return wp.transform(wp.vec3(*map(float, position)), wp.quat(*turn.as_quat()))


def add_link(
    builder: newton.ModelBuilder,
    *,
    mass: float = 1.0,
    inertia: Any = TENSOR,
    com: Any = (0.0, 0.0, 0.0),
    **settings: Any,
) -> int:
    """Adds a body without a shape and without a joint; ``inertia`` as in ``helpers.add_mass``."""
    tensor = np.asarray(inertia, dtype=float)
    tensor = np.diag(tensor) if tensor.ndim == 1 else tensor
    return builder.add_link(
        mass=mass, inertia=wp.mat33(*tensor.ravel()), com=wp.vec3(*map(float, com)), **settings
    )


def set_coordinates(
    builder: newton.ModelBuilder, joint: int, q: Sequence[float] = (), qd: Sequence[float] = ()
) -> None:
    """Sets where a joint starts: coordinates [m or rad] and velocities [m/s or rad/s]."""
    start, start_d = builder.joint_q_start[joint], builder.joint_qd_start[joint]
    builder.joint_q[start : start + len(q)] = [float(x) for x in q]
    builder.joint_qd[start_d : start_d + len(qd)] = [float(x) for x in qd]


def add_hinge_chain(
    builder: newton.ModelBuilder,
    count: int,
    *,
    length: float = 0.1,
    masses: Sequence[float] | None = None,
    base: Any = (0.0, 0.0, 0.0),
    axis: Any = (0.0, 1.0, 0.0),
    **settings: Any,
) -> list[int]:
    """Adds rods of ``length`` [m] along +x, hinged end to end, the first at ``base``.

    Each is a box of cross section ``length / 4``; ``settings`` go to the hinges.
    """
    masses = [1.0] * count if masses is None else masses
    parent, joints = WORLD, []
    for mass in masses:
        thin, long = (length / 4) ** 2, length**2
        inertia = mass / 12 * np.array([2 * thin, thin + long, thin + long])
        link = add_link(builder, mass=mass, inertia=inertia)
        at = base if parent == WORLD else (0.5 * length, 0.0, 0.0)
        joints.append(
            builder.add_joint_revolute(
                parent,
                link,
                parent_xform=transform(at),
                child_xform=transform((-0.5 * length, 0.0, 0.0)),
                axis=axis,
                **settings,
            )
        )
        parent = link
    builder.add_articulation(joints)
    return joints


def anchor_frames(sim: Simulation) -> tuple[Array, Rotation, Array, Rotation]:
    """Anchors of all joints in the world: parent's position and rotation, then the child's."""
    model = sim.model
    pose = np.vstack([sim.pose, [0, 0, 0, 0, 0, 0, 1]])  # index -1: the world
    frames = []
    for bodies, locals_ in (
        (model.joint_parent.numpy(), model.joint_X_p.numpy()),
        (model.joint_child.numpy(), model.joint_X_c.numpy()),
    ):
        turn = Rotation.from_quat(pose[bodies, 3:])
        frames.append(pose[bodies, :3] + turn.apply(locals_[:, :3].astype(float)))
        frames.append(turn * Rotation.from_quat(locals_[:, 3:].astype(float)))
    return frames[0], frames[1], frames[2], frames[3]


def anchor_gaps(sim: Simulation) -> Array:
    """Distances between the two anchors of each joint [m]."""
    parent, _, child, _ = anchor_frames(sim)
    return np.linalg.norm(child - parent, axis=1)


def coordinates(sim: Simulation) -> tuple[Array, Array]:
    """Joint coordinates and velocities of the bodies' poses, by Newton's inverse kinematics."""
    q, qd = wp.empty_like(sim.model.joint_q), wp.empty_like(sim.model.joint_qd)
    newton.eval_ik(sim.model, sim.state, q, qd)
    return q.numpy().astype(float), qd.numpy().astype(float)


def set_control(sim: Simulation, **arrays: Any) -> None:
    """Sets arrays of the control: ``joint_f``, ``joint_target_q``, ``joint_target_qd``."""
    for name, values in arrays.items():
        getattr(sim.control, name).assign(np.asarray(values, dtype=np.float32))


def swing_period(angle: Array, dt: float) -> float:
    """Mean period [s] of a swing about zero, from its upward crossings."""
    before = np.flatnonzero((angle[:-1] < 0.0) & (angle[1:] >= 0.0))
    times = before + angle[before] / (angle[before] - angle[before + 1])
    return dt * (times[-1] - times[0]) / (len(times) - 1)


def euler_period(omega: float, dt: float) -> float:
    """Period [s] that backward Euler gives an oscillator of angular frequency ``omega`` [rad/s].

    One step multiplies the phase by 1/(1 - i omega dt): it turns by atan(omega dt).
    """
    return 2.0 * np.pi * dt / np.arctan(omega * dt)
